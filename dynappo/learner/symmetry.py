"""Makes a policy symmetric: it treats left and right alike.

For a legged robot with equal left and right sides, the mirrored action in the mirrored state leads
to the mirrored next state, with the same reward. With M the mirror image of a vector
(tasks/velocity/mirror.py), the best policy and its value have

    policy(M o) = M policy(o)        value(M o) = value(o)

`policy_image` gives the weights of M policy(M o); the image of a hidden unit is the unit half a
layer away. A policy whose weights equal their image is symmetric. The weights start so (`tie`).
They stay so because each gradient is replaced by the mean of itself and its image (`mean`). This is
the gradient of the loss on all rows and their mirror images, at the cost of the rows alone. The
networks stay ordinary MLPs.

Why not train on rows and mirrored rows (Mittal et al. 2024, arXiv:2403.04359): the same gradient
takes twice the time. The transition model can be symmetric, too (`model.symmetry`): with 512 robots it learns
no faster (experiments/04_laptop); with few each row tells more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.types import Env, Mirror, Static

Image = Callable[[Any], Any]  # of a tree of weights, or of its gradient; its own inverse


def vector(mirror: Mirror, x: Any) -> Any:
    """The mirror image of `x` [..., K], of NumPy or JAX."""
    return mirror.sign.astype(x.dtype) * x[..., mirror.index]


def unchanged(size: int) -> Mirror:
    """The mirror of numbers that it leaves unchanged."""
    return Mirror(np.arange(size), np.ones(size))


def network_image(params, inputs: Mirror, outputs: Mirror):
    """Weights of the network `outputs f(inputs x)`, from those of the MLP f (networks.py)."""
    layers, before, out = params["params"], inputs, {}
    for i in range(len(layers)):
        layer = layers[f"Dense_{i}"]
        size = layer["bias"].shape[-1]
        half = Mirror(np.roll(np.arange(size), size // 2), np.ones(size))
        after = outputs if i == len(layers) - 1 else half
        kernel = vector(after, vector(before, layer["kernel"].T).T)
        out[f"Dense_{i}"] = {"kernel": kernel, "bias": vector(after, layer["bias"])}
        before = half
    return {"params": out}


def beside(one: Mirror, other: Mirror) -> Mirror:
    """The mirror of two vectors, one after the other."""
    index = np.concatenate([one.index, len(one.index) + other.index])
    return Mirror(index, np.concatenate([one.sign, other.sign]))


def part(mirror: Mirror, columns) -> Mirror:
    """The mirror of the numbers at `columns` alone; each must have its image among them."""
    place = np.full(len(mirror.index), -1)
    place[columns] = np.arange(len(columns))
    return Mirror(place[mirror.index[columns]], mirror.sign[columns])


def policy_image(static: Static, env: Env) -> Image | None:
    """The image of `{"actor", "critic", "std"}`, or None without `ppo.symmetry`.

    ValueError if the environment has no mirror image.
    """
    if not static.ppo.symmetry:
        return None
    if env.mirror is None:
        raise ValueError(
            "ppo.symmetry is True: this environment has no mirror image; set it to False"
        )
    of, action = input_mirrors(static, env), env.mirror[1]

    def image(params: dict) -> dict:
        actor = network_image(params["actor"], of["actor"], action)
        critic = network_image(params["critic"], of["critic"], unchanged(1))
        # what else there is, the moments that scale inputs, is its own image (scaling.py)
        return params | {
            "actor": actor,
            "critic": critic,
            "std": params["std"][action.index],
        }

    return image


def input_mirrors(static: Static, env: Env) -> dict[str, Mirror]:
    """The mirrors of what policy and value function see, of an environment that has one."""
    assert env.mirror is not None
    obs, views = env.mirror[0], env.views
    of_actor = obs if views is None else part(obs, views.actor)
    of_critic = of_actor
    if static.ppo.critic == "state" and views is not None:
        of_critic = part(obs, views.critic)
    return {"actor": of_actor, "critic": of_critic}


def numbered(params):
    """The numbers 1 to K in the place of the weights."""
    leaves, treedef = jax.tree.flatten(params)
    ends = np.cumsum([leaf.size for leaf in leaves])
    every = np.split(np.arange(1, ends[-1] + 1), ends[:-1])
    shaped = [n.reshape(x.shape) for n, x in zip(every, leaves, strict=True)]
    return jax.tree.unflatten(treedef, shaped)


def mean(grads, image: Image | None):
    """The mean of a gradient and its image; without an image, the gradient itself."""
    if image is None:
        return grads
    return jax.tree.map(lambda grad, other: (grad + other) / 2, grads, image(grads))


def tie(params, image: Image | None):
    """Weights made equal to their image: in each pair of images, the second copies the first."""
    if image is None:
        return params
    numbers = numbered(params)

    def one(number, other, x, y):  # a weight paired with itself becomes the mean of both values
        first = jnp.where(number < jnp.abs(other), x, y)
        return jnp.where(number == jnp.abs(other), (x + y) / 2, first)

    return jax.tree.map(one, numbers, image(numbers), params, image(params))

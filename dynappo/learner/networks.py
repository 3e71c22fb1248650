"""The networks: multilayer perceptrons and the diagonal Gaussian policy.

Initial weights and biases are uniform in +-1/sqrt(fan_in), PyTorch's default for linear layers,
because rsl_rl uses it (rsl_rl/networks/mlp.py) and early learning depends on it. The policy's
standard deviation is one free parameter per action, used as it is, without an exponential
(rsl_rl/modules/actor_critic.py, noise_std_type "scalar").

The mean action is clipped to +-10. Why: the last action is part of the observation, so the policy's
output feeds back into its input. In a pose that was rare in training, an ANYmal's actions grew by a
constant factor each step, with saturated motors and without a fall. One such episode had a return
of -1e14, and values overflowed. A policy that walks stays below 6; 10 is 2.5 rad of a Unitree joint,
more than the joint can turn.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo.learner import scaling
from dynappo.types import Env, Hyper, Static

LOG_2PI = 1.8378770664093453
# jax.lax.Precision for each value of a network's precision; bfloat16 also sets the layers' dtype
PRECISION = {"highest": "highest", "tf32": "tensorfloat32", "bfloat16": "default"}

# of `(obs, critic_obs)`: `(mean action, value)`
ActorCritic = Callable[..., tuple[Float[Array, "... A"], Float[Array, "..."]]]
MAX_SLICES = 8  # of an observation, for `columns`; more are not measured
MAX_MEAN = 10.0  # units of the action; policy/policy_file.py and the ONNX file clip there too


def elu(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """x above 0, exp(x) - 1 below: equal to flax's within 1e-7, in half the time on a CPU."""
    return jnp.where(x > 0, x, jnp.exp(jnp.minimum(x, 0)) - 1)


ACTIVATIONS = {"elu": elu, "relu": jax.nn.relu, "tanh": jnp.tanh, "swish": jax.nn.swish}


class MLP(NamedTuple):
    """Linear layers with an activation between them; parameters and output are float32."""

    sizes: tuple[int, ...]  # units of each layer, the output last
    activation: str = "elu"
    precision: str = "highest"


def init(network: MLP, inputs: int, key: PRNGKeyArray) -> dict:
    """Parameters of an untrained `network` that sees `inputs` numbers, named as flax names them.

    All weights are one draw, for the time to compile alone: a third of that of a draw for each array
    (experiments/03_speed/kernel.md).
    """
    fan_in = inputs, *network.sizes[:-1]
    ends = np.cumsum([(n + 1) * size for n, size in zip(fan_in, network.sizes, strict=True)])
    parts = jnp.split(jax.random.uniform(key, (ends[-1],), minval=-1.0, maxval=1.0), ends[:-1])
    layers = {}
    for i, (part, n) in enumerate(zip(parts, fan_in, strict=True)):
        rows = part.reshape(n + 1, -1) * n**-0.5
        layers[f"Dense_{i}"] = {"bias": rows[0], "kernel": rows[1:]}
    return {"params": layers}


def apply(network: MLP, params, x: Float[Array, "... in"]) -> Float[Array, "... out"]:
    """`network` with `params` on `x`. In bfloat16 the last product and its sum are float32: else it would
    round a value of 5 by up to 0.016, half the reward of a step."""
    layers = cast(network.precision, params["params"])
    *hidden, last = (layers[f"Dense_{i}"] for i in range(len(network.sizes)))
    dot = partial(jnp.matmul, precision=PRECISION[network.precision])
    x = cast(network.precision, x)
    for layer in hidden:
        x = ACTIVATIONS[network.activation](dot(x, layer["kernel"]) + layer["bias"])
    return dot(x, last["kernel"], preferred_element_type=jnp.float32) + last["bias"]


def actor(static: Static, action_size: int) -> MLP:
    """The network of the policy's mean."""
    return MLP((*static.ppo.hidden, action_size), static.ppo.activation, static.ppo.precision)


def critic(static: Static) -> MLP:
    """The network of the value function."""
    hidden = static.ppo.critic_hidden or static.ppo.hidden
    return MLP((*hidden, 1), static.ppo.activation, static.ppo.precision)


def init_policy(
    static: Static,
    hyper: Hyper,
    obs_size: int,
    action_size: int,
    key: PRNGKeyArray,
    critic_size: int | None = None,
) -> dict:
    """Parameters `{"actor", "critic", "std"}`; the value function sees `critic_size` or `obs_size`.

    With `ppo.normalize` also "inputs" (scaling.py).
    """
    actor_key, critic_key = jax.random.split(key)
    sizes = {"actor": obs_size, "critic": critic_size or obs_size}
    inputs = {"inputs": {name: scaling.init(size) for name, size in sizes.items()}}
    return (inputs if static.ppo.normalize else {}) | {
        "actor": init(actor(static, action_size), obs_size, actor_key),
        "critic": init(critic(static), critic_size or obs_size, critic_key),
        "std": jnp.full(action_size, hyper.ppo.init_std, jnp.float32),
    }


def policy(static: Static, params: dict, obs: Float[Array, "... O"]) -> Float[Array, "... A"]:
    """Mean action, clipped to +-`MAX_MEAN`. Its std, `params["std"]`, does not depend on `obs`."""
    obs = scaling.scaled(params, "actor", obs)
    mean = apply(actor(static, params["std"].shape[-1]), params["actor"], obs)
    return jnp.clip(mean, -MAX_MEAN, MAX_MEAN)


def value(static: Static, params: dict, obs: Float[Array, "... O"]) -> Float[Array, "..."]:
    """V(obs): the expected discounted return."""
    return apply(critic(static), params["critic"], scaling.scaled(params, "critic", obs))[..., 0]


def actor_critic(static: Static, params: dict) -> ActorCritic:
    """Both networks as one function, `(obs, critic_obs) -> policy(obs), value(critic_obs)`.

    Without `critic_obs` the value function sees `obs` too.
    """

    def both(obs, critic_obs=None):
        critic_obs = obs if critic_obs is None else critic_obs
        return policy(static, params, obs), value(static, params, critic_obs)

    return both


def inputs(static: Static, env: Env, obs: Float[Array, "... O"], prop: Float[Array, "... P"]):
    """What the policy and the value function see of an observation and its exact `prop`: two arrays, or
    one array twice."""
    of_actor = obs if env.views is None else columns(obs, env.views.actor)
    if static.ppo.critic == "obs":
        return of_actor, of_actor
    exact = jnp.concatenate([prop, obs[..., env.prop_size :]], -1)
    return of_actor, exact if env.views is None else columns(exact, env.views.critic)


def columns(x: Float[Array, "... O"], which: np.ndarray) -> Float[Array, "... K"]:
    """The columns `which` of x: neighbours as one slice, as XLA's gather reads and writes a column at a time
    (an H200 takes 4.7 us for 235 columns of 2048 robots, and 2.9 for slices)."""
    starts = np.flatnonzero(np.diff(which, prepend=-2) != 1)
    if not 0 < len(starts) <= MAX_SLICES:
        return x[..., which]
    runs = np.split(which, starts[1:])
    return jnp.concatenate([x[..., run[0] : run[-1] + 1] for run in runs], axis=-1)


def input_sizes(static: Static, env: Env) -> tuple[int, int]:
    """Numbers that the policy and the value function see."""
    views, size = env.views, env.obs_size
    if views is None:
        return size, size
    actor_size = len(views.actor)
    return actor_size, actor_size if static.ppo.critic == "obs" else len(views.critic)


def cast(precision: str, weights):
    """Weights, or an input, rounded as a network of this precision multiplies them."""
    dtype = jnp.bfloat16 if precision == "bfloat16" else jnp.float32
    return jax.tree.map(lambda w: w.astype(dtype), weights)


def log_prob(
    mean: Float[Array, "... A"], std: Float[Array, "... A"], action: Float[Array, "... A"]
) -> Float[Array, "..."]:
    """Log density of a diagonal Gaussian, summed over the action; no squashing."""
    z = (action - mean) / std
    return (-0.5 * z**2 - jnp.log(std) - 0.5 * LOG_2PI).sum(-1)


def entropy(std: Float[Array, "... A"]) -> Float[Array, "..."]:
    """Differential entropy of a diagonal Gaussian, summed over the action."""
    return (0.5 + 0.5 * LOG_2PI + jnp.log(std)).sum(-1)


def squashed_entropy(
    mean: Float[Array, "... A"], std: Float[Array, "... A"], noise: Float[Array, "... A"]
) -> Float[Array, "..."]:
    """Entropy of tanh(x), x = mean + std noise: that of x plus log(1 - tanh(x)^2), at one x a row.

    It has a maximum, where that of x grows with std for ever (brax/training/distribution.py).
    """
    x = mean + std * noise
    slope = 2 * (jnp.log(2.0) - x - jax.nn.softplus(-2 * x))
    return entropy(std) + slope.sum(-1)


def kl(
    old_mean: Float[Array, "... A"],
    old_std: Float[Array, "... A"],
    mean: Float[Array, "... A"],
    std: Float[Array, "... A"],
) -> Float[Array, "..."]:
    """KL(old || new) of diagonal Gaussians as rsl_rl computes it (algorithms/ppo.py).

        sum log(s_new / s_old + 1e-5) + (s_old^2 + (m_old - m_new)^2) / (2 s_new^2) - 1/2

    The 1e-5 is theirs; with it the learning-rate rule takes the same branch.
    """
    squares = (old_std**2 + (old_mean - mean) ** 2) / (2 * std**2)
    return (jnp.log(std / old_std + 1e-5) + squares - 0.5).sum(-1)

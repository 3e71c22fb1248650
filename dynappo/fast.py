"""The method's functions in a form that is fast on a GPU. Read the plain ones first: these give the same.

A GPU takes some microseconds to start a kernel, however small its arrays. The policy's networks and the
model's are small, so the number of kernels decides how long an update, a fit or a tail takes.

| here           | the plain one          | what is different                                            |
|----------------|------------------------|--------------------------------------------------------------|
| `actor_critic` | `networks.actor_critic`| a layer of both networks is one product                      |
| `update`       | `ppo.update`           | all weights are one vector, which Adam changes in one kernel |
| `fit`          | `dynamics.fit`         | the same, and a minibatch is read at once                    |
| `step`         | `dynamics.step`        | weights are rounded once, not for each row                   |
| `fill`         | `rollout.fill`         | a row's single numbers are written at once                   |

Each takes the arguments of its plain function and returns the same numbers, up to the order of sums
(tests/test_fast.py). `algorithm` and `bench` call these.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo import rollout
from dynappo.learner import networks, ppo, scaling, symmetry
from dynappo.learner import units as units_lib
from dynappo.model import dynamics
from dynappo.model.examples import Examples
from dynappo.types import Env, Hyper, Learner, Metrics, Mirror, ModelState, Static, Transition

# the fields of a row that are one number a robot
SCALARS = "log_prob value reward discount truncation valid episode_return episode_length".split()


def actor_critic(static: Static, params: dict) -> networks.ActorCritic:
    """`networks.actor_critic`, with one product for a layer of both networks.

    Half as many products, each larger: an update takes 9.0 ms in float32 (9.4 without), 6.4 in TF32, 5.0
    in bfloat16 (H200; experiments/03_speed/peers.md). The weights are put side by side here, before a
    loop over rows: in the loop that takes 7 kernels a row. Layers of two sizes are no one product: then it is
    the plain one.
    """
    if static.ppo.critic_hidden not in (None, static.ppo.hidden):
        return networks.actor_critic(static, params)
    precision = static.ppo.precision
    nets = [networks.cast(precision, params[name]["params"]) for name in ("actor", "critic")]
    first, *hidden, last = ([net[f"Dense_{i}"] for net in nets] for i in range(len(nets[0])))
    kernels = [jnp.stack([layer["kernel"] for layer in pair]) for pair in hidden]
    biases = [jnp.stack([layer["bias"] for layer in pair]) for pair in (first, *hidden)]
    first = [layer["kernel"] for layer in first]
    if static.ppo.critic == "obs":
        # one input, so one plain product; [B, 2, H] would be copied later
        first = jnp.concatenate(first, -1)
    act = networks.ACTIVATIONS[static.ppo.activation]
    dot = partial(jnp.einsum, precision=networks.PRECISION[precision])
    dot32 = partial(dot, "...i,io->...o", preferred_element_type=jnp.float32)

    def one(kernel, obs):
        return dot("...i,io->...o", networks.cast(precision, obs), kernel)

    def both(obs, critic_obs=None):
        obs = scaling.scaled(params, "actor", obs)
        if critic_obs is not None:
            critic_obs = scaling.scaled(params, "critic", critic_obs)
        if static.ppo.critic == "obs":
            x = one(first, obs)
            x = jnp.moveaxis(x.reshape(*x.shape[:-1], 2, -1), -2, 0)
        else:
            x = jnp.stack([one(first[0], obs), one(first[1], critic_obs)])
        bias, *others = (jnp.expand_dims(bias, range(1, x.ndim - 1)) for bias in biases)
        x = act(x + bias)
        for kernel, bias in zip(kernels, others, strict=True):
            x = act(dot("k...i,kio->k...o", x, kernel) + bias)
        mean, value = (dot32(x[i], net["kernel"]) + net["bias"] for i, net in enumerate(last))
        return jnp.clip(mean, -networks.MAX_MEAN, networks.MAX_MEAN), value[..., 0]

    return both


def update(
    static: Static,
    hyper: Hyper,
    learner: Learner,
    batch: ppo.Batch,
    key: PRNGKeyArray,
    image: symmetry.Image | None = None,
    units: units_lib.Units | None = None,
) -> tuple[Learner, Metrics]:
    """`ppo.update`, with all weights in one vector, `std` last: clipping and Adam take 4 kernels, not 33."""
    vector, unflatten = ravel_pytree(learner.params)
    old_std = learner.params["std"]
    is_std = jnp.arange(vector.size) >= vector.size - old_std.size
    with_image = mean_with_image(learner.params, image)
    in_units = None
    if units is not None:
        in_units = ravel_pytree(units(jax.tree.map(jnp.ones_like, learner.params)))[0]

    def loss(vector, rows):
        return ppo.loss(
            static, hyper, unflatten(vector), rows, old_std=old_std, actor_critic=actor_critic
        )

    def step(learner, rows):
        grads, metrics = jax.grad(loss, has_aux=True)(learner.params, rows)
        # a barrier: else XLA joins the layers' gradients again in each kernel that reads them
        grads = jax.lax.optimization_barrier(with_image(grads))
        grads = grads if in_units is None else grads * in_units
        rate = ppo.adapt(static, hyper, learner.learning_rate, metrics["kl"])
        updates, opt_state = ppo.optimizer(hyper).update(grads, learner.opt_state)
        updates = updates if in_units is None else updates * in_units
        params = learner.params - rate * updates
        params = jnp.where(is_std, jnp.maximum(params, hyper.ppo.min_std), params)
        metrics = jnp.stack([metrics[name] for name in ppo.STEP_METRICS])  # written at once
        return Learner(params=params, opt_state=opt_state, learning_rate=rate), metrics

    flat, means = ppo.steps(static, learner.replace(params=vector), batch=batch, key=key, step=step)
    metrics = dict(zip(ppo.STEP_METRICS, means, strict=True))
    metrics["learning_rate"] = flat.learning_rate
    return flat.replace(params=unflatten(flat.params)), metrics


def mean_with_image(params, image: symmetry.Image | None) -> Callable[[Array], Array]:
    """`symmetry.mean` of a gradient as one vector. An image is then one gather, by constants of the
    program, not 6 kernels."""
    if image is None:
        return lambda grads: grads
    leaves = jax.tree.leaves(image(symmetry.numbered(params)))
    numbers = np.concatenate([np.ravel(leaf) for leaf in leaves])
    index, sign = np.abs(numbers) - 1, np.sign(numbers).astype(np.float32)
    return lambda grads: (grads + sign * grads[index]) / 2


def fit(
    static: Static,
    hyper: Hyper,
    model: ModelState,
    rows: Examples,
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
    *,
    mirrors: tuple[Mirror, Mirror] | None = None,
    draw: Callable | None = None,
) -> tuple[ModelState, Metrics]:
    """`dynamics.fit`, with weights and moments of Adam as one vector each, and one array to draw from."""
    model = dynamics.with_moments_of(hyper, model, rows, epochs, mirrors)

    def minibatch(rows: Examples):
        x, y = dynamics.scaled(static, model, rows)
        return jnp.concatenate([x, y, rows.weight[..., None]], -1)

    data, past = minibatch(rows), None
    if draw is not None:
        past = lambda key, n: minibatch(draw(key, n))  # noqa: E731
    size = rows.x.shape[-1]
    with_image = mean_with_image(model.params, dynamics.image(mirrors))
    params, unflatten = ravel_pytree(model.params)
    adam = model.opt_state
    opt_state = adam._replace(mu=ravel_pytree(adam.mu)[0], nu=ravel_pytree(adam.nu)[0])

    def step(state, minibatch, counted):
        params, opt_state = state
        x, y, weight = minibatch[..., :size], minibatch[..., size:-1], minibatch[..., -1] * counted

        def loss(params):
            return dynamics.loss(static, hyper, unflatten(params), x=x, y=y, weight=weight)

        value, grads = jax.value_and_grad(loss)(params)
        updates, opt_state = dynamics.optimizer().update(with_image(grads), opt_state)
        return (params - hyper.model.learning_rate * updates, opt_state), value

    (params, opt_state), metrics = dynamics.passes(
        static,
        (params, opt_state),
        data,
        count=rows.count,
        epochs=epochs,
        key=key,
        step=step,
        past=past,
    )
    opt_state = opt_state._replace(mu=unflatten(opt_state.mu), nu=unflatten(opt_state.nu))
    return model.replace(params=unflatten(params), opt_state=opt_state), metrics


def step(static: Static, hyper: Hyper, env: Env, model: ModelState) -> Callable:
    """`dynamics.step`, with weights that are rounded once."""
    params = networks.cast(static.model.precision, model.params)
    return dynamics.step(static, hyper, env, model.replace(params=params))


def fill(
    rows: Transition,
    begin: Int[Array, ""],
    end: Int[Array, ""],
    state: Any,
    keys: Callable[..., PRNGKeyArray],
    *,
    act: Callable,
    step: Callable,
    metrics: tuple[str, ...] = (),
) -> tuple[Transition, Any, Metrics]:
    """`rollout.fill`, with 7 writes a row, not 14."""

    def write(every_row, t, row):
        # t is in bounds; skip the check
        put = lambda every, one: every.at[t].set(one, mode="promise_in_bounds")  # noqa: E731
        return jax.tree.map(put, every_row, scalars_and_rest(row))

    (scalars, rest), state, sums = rollout.fill(
        scalars_and_rest(rows),
        begin=begin,
        end=end,
        state=state,
        keys=keys,
        act=act,
        step=step,
        metrics=metrics,
        write=write,
    )
    fields = dict(zip(SCALARS, jnp.moveaxis(scalars, 1, 0), strict=True)) | rest
    return Transition(**fields), state, sums


def scalars_and_rest(rows: Transition) -> tuple[Float[Array, "... 8 R"], dict[str, Array]]:
    """The fields `SCALARS` as one array, and a dict of the other fields."""
    fields = {name: getattr(rows, name) for name in Transition.__dataclass_fields__}
    return jnp.stack([fields.pop(name) for name in SCALARS], -2), fields

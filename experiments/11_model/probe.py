"""Errors of k predictions in a row, by groups of numbers, on a rollout that the model has not seen."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm
from dynappo.model import dynamics, examples
from dynappo.tasks.velocity import observe

# of the predicted numbers; units as in observe.py
GROUPS = {
    "joint positions (rad)": "joint_position",
    "joint velocities (rad/s)": "joint_velocity",
    "gravity direction": "gravity",
    "linear velocity (m/s)": "linear_velocity",
    "angular velocity (rad/s)": "angular_velocity",
    "reward (1/s)": None,  # the last number, for a second
}
FRESH = 2**30  # in place of an iteration's number: random numbers that training does not use


def compiled(program) -> Callable:
    """`ask(state) -> (rmse, spread)`, each `[S, N, groups]`, of a run with several seeds."""
    env, static, hyper = program.env, program.static, program.hyper
    horizon = static.rollout.horizon

    def one(state):
        key = jax.random.fold_in(state.key, FRESH)
        every = jnp.int32(horizon)
        buffer, _, _ = algorithm.collect(env, hyper, state, every, key, static=static)
        start = examples.before_and_after(static, env, buffer)[0][0]
        return errors(static, hyper, env, state.model, buffer, start)

    return jax.jit(jax.vmap(one, spmd_axis_name="seed"))


def errors(static, hyper, env, model, rows, obs):
    """Root mean square error of the prediction from `obs` [R, O] to each row, and the truth's spread.

    Over robots that have not ended their episode by then, against the state without noise. The spread is
    the standard deviation over robots: what an error would be that knows the mean alone.
    """

    def predict(obs, action):
        obs, reward, _ = dynamics.predict(static, hyper, env, model, obs, action)
        return obs, jnp.concatenate([obs[:, : env.prop_size], reward[:, None] / env.dt], -1)

    _, predicted = jax.lax.scan(predict, obs, rows.action)
    truth = jnp.concatenate([rows.next_prop, rows.reward[..., None] / env.dt], -1)
    alive = jnp.cumprod(rows.discount * (1 - rows.truncation), axis=0)[..., None] > 0
    count = jnp.maximum(alive.sum(1), 1)  # [N, 1]

    def mean(x):
        return jnp.where(alive, x, 0.0).sum(1) / count

    wrong = mean((predicted - truth) ** 2)
    varied = mean((truth - mean(truth)[:, None]) ** 2)
    return tuple(
        jnp.stack([jnp.sqrt(x[:, part].mean(-1)) for part in _parts(env)], -1)
        for x in (wrong, varied)
    )


def _parts(env):
    """The groups; of an environment that is no legged robot, all predicted numbers and the reward."""
    reward = slice(env.prop_size, None)
    if env.prop_size != observe.prop_size(env.action_size):
        return slice(0, env.prop_size), reward
    at = observe.slices(env.action_size)
    return [at[name] if name else reward for name in GROUPS.values()]


def rows(iteration: int, seed: int, rmse: np.ndarray, spread: np.ndarray, steps) -> list[dict]:
    """Of one seed `[N, groups]`: a row a group and number of predictions, of those in `steps`."""
    return [
        {
            "iteration": iteration,
            "seed": seed,
            "group": group,
            "steps": k,
            "rmse": f"{rmse[k - 1, g]:.4g}",
            "spread": f"{spread[k - 1, g]:.4g}",
        }
        for g, group in enumerate(GROUPS)
        for k in steps
    ]

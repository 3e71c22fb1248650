"""Evaluates a policy in deterministic episodes: return, falls and tracking error.

These numbers compare runs. evaluate/trials.py has trials of one command after another, in C MuJoCo.

Each robot runs one episode of the nominal task: the policy's mean action, no observation noise, no
randomised physics, full-length episodes, commands drawn as in training. Tracking error is the root
mean square of the planar velocity error (m/s) after the first second, over all robots that still
stand; `yaw_error` is the same for the yaw rate (rad/s).

It uses the training environment; floats of the config alone make the task nominal.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo import algorithm
from dynappo.learner import networks
from dynappo.types import Env, Hyper, Metrics, Static

SETTLE = 1.0  # s, left out of the tracking error


def nominal(hyper: Hyper) -> Hyper:
    """`hyper` of a task without noise and pushes, with all physical parameters nominal."""
    task, r = hyper.task, hyper.task.randomize
    still = jax.tree.map(jnp.zeros_like, task.noise)
    bodies = jax.tree.map(jnp.zeros_like, r)  # what is not a share of something
    one, friction = jnp.ones(()), (r.friction[0] + r.friction[1]) / 2
    shares = dict.fromkeys(("kp_scale", "kd_scale", "strength", "armature"), (one, one))
    bodies = bodies._replace(friction=(friction, friction), **shares)
    push = task.push._replace(velocity=jnp.zeros(()))
    return hyper._replace(task=task._replace(noise=still, randomize=bodies, push=push))


def mean_actions(env: Env, static: Static, params: dict):
    """`act(state) -> mean action` of all robots, in full precision as when the policy is played, whatever it
    was trained in."""
    exact = static._replace(ppo=static.ppo._replace(precision="highest"))

    def act(state):
        obs, _ = networks.inputs(exact, env, state.obs, state.prop)
        return networks.policy(exact, params, obs)

    return act


def evaluate(
    env: Env,
    hyper: Hyper,
    params: dict,
    key: PRNGKeyArray,
    *,
    static: Static,
    num_envs: int,
    num_steps: int,
    randomize: bool = False,
    totals: tuple[str, ...] = (),
) -> Metrics:
    """Metrics of `num_envs` episodes of at most `num_steps` control steps.

    `return`, `length` (control steps), `fall_rate`, `tracking_error` (m/s), `yaw_error` (rad/s),
    `return_std` over episodes; on ground of tiles `crossed`, the share of robots that left theirs without a
    fall, which ends their episode. With `randomize`, on the training task: noise, pushes, and different
    physics for each robot; errors are still those of the true velocities. `totals` are metrics of the
    environment, such as terms of its reward, of which the sum over an episode is told as `total_NAME`.
    """
    hyper = hyper if randomize else nominal(hyper)
    hyper = hyper if env.evaluated is None else env.evaluated(hyper)
    key = jax.random.fold_in(key, algorithm.EPISODES)  # a run of this seed draws from the others
    body_keys, reset_keys, keys = (jax.random.split(k, num_envs) for k in jax.random.split(key, 3))
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, body_keys)
    state = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, reset_keys)
    if hasattr(state, "clock"):  # in training, episodes may start above age 0 and be shorter
        clock = min(0, env.episode_length - num_steps)
        state = state.replace(clock=jnp.full_like(state.clock, clock))
    settled = round(SETTLE / env.dt)
    errors = [name for name in env.metrics if name.endswith("_error_sq")]
    zero = jnp.zeros(num_envs)
    total = [f"total_{name}" for name in totals]
    tiles = [name for name in env.metrics if name == "crossings"]
    sums = dict.fromkeys(("return", "length", "falls", "rows", *errors, *total, *tiles), zero)

    advance = algorithm.physics_step(env, hyper, bodies)
    act = mean_actions(env, static, params)

    def step(carry, t):
        state, alive, sums = carry
        action = act(state)
        step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
        # robots whose episode ended continue from a reset, to keep numbers finite, but do not count
        state, outcome = advance(state, action, step_keys)
        rows = alive * (t >= settled) * outcome.discount
        row = {
            "return": alive * outcome.reward,
            "length": alive,
            "falls": alive * (1 - outcome.discount),
            "rows": rows,
        } | {name: rows * outcome.metrics[name] for name in errors}
        row |= {f"total_{name}": alive * outcome.metrics[name] for name in totals}
        row |= {name: alive * outcome.metrics[name] for name in tiles}
        alive = alive * outcome.discount * (1 - outcome.truncation)
        return (state, alive, jax.tree.map(jnp.add, sums, row)), None

    (_, _, sums), _ = jax.lax.scan(step, (state, zero + 1, sums), jnp.arange(num_steps))
    metrics: dict[str, Float[Array, ""]] = {
        "return": sums["return"].mean(),
        "return_std": sums["return"].std(),
        "length": sums["length"].mean(),
        "fall_rate": sums["falls"].mean(),
    } | {name: sums[name].mean() for name in total}
    if tiles:
        metrics["crossed"] = sums["crossings"].mean()
    names = {"velocity_error_sq": "tracking_error"}
    for name in errors:
        # NaN if all robots fell in the first second
        root = jnp.sqrt(sums[name].sum() / sums["rows"].sum())
        metrics[names.get(name, name.removesuffix("_sq"))] = root
    return metrics

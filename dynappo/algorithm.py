"""Learning to walk with less: PPO whose rollout tails are written by a learned model. Start here.

`iterate` is the paper's Algorithm 1, line by line; `run` repeats it over the schedule in one compiled
program; `init` makes the state it starts from. All are pure functions of an `Env`:

    config = config_lib.validate(config_lib.load("configs/go1.py"))
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot.load(config.robot), config.task, config.physics)
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    state, metrics = algorithm.run(env, hyper, state, schedule.columns(config), static=static)

Seeds are `jax.vmap(..., in_axes=(None, 0, None))` over `(hyper, state, columns)`: the columns stay
unbatched, because the number of real rows bounds a loop (rollout.py). sweep.py has that, and devices,
and the axis name "seeds" by which `schedule.by_error` asks the other seeds.

Anchoring: the tail starts at the observation after the last real row and never touches the state of
physics, from which the next iteration goes on.

Every random number comes from `fold_in` of the run's key with the iteration, a purpose, the row and
the robot's global index. So two chunks equal one run, and a row does not depend on N_r.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import Array, Int, PRNGKeyArray

from dynappo import (
    dynamics,
    first_order,
    gae,
    model_error,
    model_rows,
    networks,
    ppo,
    rollout,
    schedule,
    summary,
)
from dynappo.types import Env, Metrics, ModelState, TrainState, Transition

# purposes of random numbers
ROWS, FIT, UPDATE, ACTION, STEP, RESET = range(6)


def init(env: Env, hyper, key: PRNGKeyArray, *, static) -> TrainState:
    """Untrained networks and R robots, each with its own physical parameters, at their start."""
    policy_key, model_key, physics_key, reset_key, run_key = jax.random.split(key, 5)
    robot_index = jnp.arange(static.rollout.num_envs)
    per_robot = jax.vmap(jax.random.fold_in, (None, 0))
    params_physics = jax.vmap(env.randomize, (None, 0))(
        hyper.task, per_robot(physics_key, robot_index)
    )
    env_state = jax.vmap(env.reset, (None, 0, 0))(
        hyper.task, params_physics, per_robot(reset_key, robot_index)
    )
    model = past = None
    if schedule.uses_model(static):
        model = dynamics.init(static.model, env, model_key)
        if static.schedule.by_error:
            model = model.replace(error=jnp.full((), jnp.inf))
        kept = static.rollout.horizon - static.schedule.end_steps  # real in every iteration
        past = model_rows.forget(static.model, env, static.rollout.num_envs, kept)
    return TrainState(
        learner=ppo.init(static.ppo, hyper.ppo, env.obs_size, env.action_size, policy_key),
        model=model,
        env_state=env_state,
        params_physics=params_physics,
        past=past,
        robot_index=robot_index,
        returns=jnp.full(summary.RETURNS, jnp.nan),
        lengths=jnp.full(summary.RETURNS, jnp.nan),
        key=run_key,
    )


def iterate(
    env: Env, hyper, state: TrainState, columns: dict[str, Int[Array, ""]], *, static
) -> tuple[TrainState, Metrics]:
    """One iteration of the paper's Algorithm 1; `columns` is one row of `schedule.columns`."""
    horizon, num_envs = static.rollout.horizon, static.rollout.num_envs
    n_real, end = columns["n_real"], jnp.int32(horizon)
    if state.model is not None and static.schedule.by_error:
        n_real = end - trusted(static, hyper.schedule, state.model, end - n_real)
    key = jax.random.fold_in(state.key, columns["iteration"])
    rows_key = jax.random.fold_in(key, ROWS)

    # Collect N_r steps with physics, from where the last physics step ended
    buffer, env_state, sums = collect(env, hyper, state, n_real, rows_key, static=static)

    # Train the transition model on them, and let it write the tail of N_s = N - N_r steps
    model, past, slope, metrics = state.model, state.past, None, {}
    if model is not None:
        epochs, fit_key = columns["model_epochs"], jax.random.fold_in(key, FIT)
        model, past, metrics = learn(
            env, hyper, model, past, buffer, n_real, epochs, fit_key, static=static
        )
        act = policy(static.ppo, state.learner.params)
        keys = rollout.row_keys(rows_key, state.robot_index)
        tail = dynamics.tail(static.model, env, env_state, state.params_physics)
        step = model_step(env, hyper.task, model, static=static)
        buffer, _, _ = rollout.fill(buffer, n_real, end, tail, keys, act=act, step=step)

    # Update the policy by PPO on real and synthetic rows alike
    params, real = state.learner.params, (jnp.arange(horizon) < n_real)[:, None]
    bounded = model is not None and static.model.bounds
    batch = estimate(static.ppo, hyper.ppo, params, buffer, real, bounded)
    if model is not None:
        batch = batch._replace(weight=jnp.where(real, 1.0, hyper.ppo.tail_weight * buffer.valid))
        metrics |= summary.of_tail(buffer, real, env.dt)
        if static.ppo.first_order_steps:
            unit = batch.advantages.std()
            slope = first_order.gradient(
                static.ppo, hyper.ppo, params, step, tail, lambda k: keys(horizon + k), unit
            )
    update_key = jax.random.fold_in(key, UPDATE)
    learner, ppo_metrics = ppo.update(
        static.ppo, hyper.ppo, state.learner, batch, update_key, slope
    )

    returns, lengths = summary.finished(state, buffer, n_real)
    state = state.replace(learner=learner, model=model, past=past, env_state=env_state)
    metrics |= ppo_metrics | summary.of_rows(sums, n_real * num_envs)
    metrics |= summary.of_episodes(buffer, n_real)
    return state.replace(returns=returns, lengths=lengths), metrics | {
        "episode_return": jnp.nanmean(returns),
        "episode_length": jnp.nanmean(lengths),
        "policy_std": learner.params["std"].mean(),
        "nonfinite_robot": summary.nonfinite_robot(buffer),
    }


def learn(
    env: Env, hyper, model: ModelState, past, buffer: Transition, n_real, epochs, key, *, static
) -> tuple[ModelState, Any, Metrics]:
    """`(model, rows to keep, metrics)`: the fit of eq. 3, after the model's error on these new rows."""
    unrolled = min(4, static.rollout.horizon - static.schedule.end_steps)
    task = hyper.task
    metrics = model_error.errors(static.model, env, model, buffer, unrolled, task)
    if static.schedule.by_error:
        model = model.replace(error=metrics[f"model_error_{unrolled}"])
        metrics["n_real"] = n_real
    fit = partial(dynamics.fit, static.model, hyper.model, env)
    model, fit_metrics = fit(model, buffer, n_real, epochs, key, task, past)
    past = model_rows.remember(static.model, env, past, buffer, n_real, task)
    return model, past, metrics | fit_metrics


def trusted(static, hyper, model: ModelState, steps: Int[Array, ""]) -> Int[Array, ""]:
    """Of the `steps` that the schedule allows a tail, as many as `schedule.max_error` admits.

    floor(steps min(1, max_error / error)), with the error that the last iteration found before its fit; of
    several seeds the fewest, because the number of rows bounds a loop.
    """
    error = model.error
    assert error is not None  # with schedule.by_error it is there
    share = jnp.minimum(1.0, hyper.max_error / error)
    steps = jnp.floor(steps * share + 1e-4).astype(jnp.int32)
    return jax.lax.pmin(steps, "seeds") if static.run.num_seeds > 1 else steps


def collect(env: Env, hyper, state: TrainState, n_real, key: PRNGKeyArray, *, static):
    """Rows `t < n_real` of a rollout `[N, R]`, by the policy and physics.

    Returns the buffer, the robots after the last row, and the sums of `env.metrics` over all rows.
    """
    keys = rollout.row_keys(key, state.robot_index)
    act = policy(static.ppo, state.learner.params)
    model, body = static.model, state.params_physics
    step = physics_step(env, hyper.task, body, model.private)
    sizes = static.rollout.horizon, static.rollout.num_envs
    buffer = rollout.allocate(env, *sizes, model_rows.carried_size(model, env))
    return rollout.fill(
        buffer,
        jnp.int32(0),
        n_real,
        state.env_state,
        keys,
        act=act,
        step=step,
        carried=partial(model_rows.carried, model, env, body),
        metrics=env.metrics,
    )


def run(
    env: Env, hyper, state: TrainState, columns: dict[str, Int[Array, " I"]], *, static
) -> tuple[TrainState, Metrics]:
    """`iterate` over every row of the schedule; metrics have shape `[I]`."""
    columns = {name: jnp.asarray(column) for name, column in columns.items()}
    return jax.lax.scan(
        lambda state, row: iterate(env, hyper, state, row, static=static), state, columns
    )


def policy(static, params: dict):
    """`act(obs, keys)`: a Gaussian action of every robot, with what PPO must remember of it."""
    std = params["std"]

    def act(obs, keys):
        mean, value = networks.policy_and_value(static, params, obs)
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, ACTION)
        action = mean + std * jax.vmap(lambda k: jax.random.normal(k, std.shape))(keys)
        log_prob = networks.log_prob(mean, std, action)
        return action, mean, log_prob, value

    return act


def estimate(static, hyper, params: dict, buffer: Transition, real, bounded=False) -> ppo.Batch:
    """Advantages and returns of a rollout, bootstrapped from V(next_obs) wherever it is cut.

    That is at truncations and at row N-1; elsewhere the next row's value is the same number. If
    `bounded`, values of synthetic rows are kept in the range of the `real` ones [N, 1], so that a
    state that only the model has seen cannot lead values away in a circle.
    """
    with jax.default_matmul_precision("highest"):
        cut = (buffer.truncation == 1).at[-1].set(True)
        value, last = buffer.value, networks.value(static, params, buffer.next_obs)
        if bounded:
            low = jnp.where(real, value, jnp.inf).min()
            high = jnp.where(real, value, -jnp.inf).max()
            value, last = (jnp.where(real, x, jnp.clip(x, low, high)) for x in (value, last))
        bootstrap = jnp.where(cut, last, jnp.roll(value, -1, axis=0))
        advantages, returns = gae.gae(
            buffer.reward,
            buffer.discount,
            buffer.truncation,
            value,
            bootstrap,
            gamma=hyper.gamma,
            lambda_=hyper.lambda_,
        )
    return ppo.Batch(
        obs=buffer.obs,
        action=buffer.action,
        action_mean=buffer.action_mean,
        log_prob=buffer.log_prob,
        value=buffer.value,
        advantages=advantages,
        returns=returns,
    )


def physics_step(env: Env, hyper, params_physics, private=False):
    """`step(state, action, keys)` of all robots: the environment's step, then its autoreset.

    If `private`, `next_prop` goes on with the numbers of `env.private`, as they are before a reset.

    On a mesh (sweep.py) every device steps its own robots: an engine's call is opaque to
    JAX's partitioner, which would gather all robots on every device.
    """
    fold = jax.vmap(jax.random.fold_in, (0, None))

    def step(hyper, params_physics, state, action, keys):
        after, outcome = jax.vmap(env.step, (None, 0, 0, 0, 0))(
            hyper, params_physics, state, action, fold(keys, STEP)
        )
        if private:
            hidden = jax.vmap(env.private)(params_physics, after)
            outcome = outcome.replace(next_prop=jnp.concatenate([outcome.next_prop, hidden], -1))
        after = jax.vmap(env.autoreset, (None, 0, 0, 0, 0))(
            hyper, params_physics, after, outcome, fold(keys, RESET)
        )
        return after, outcome

    if env.mesh is not None and env.mesh.size > 1:
        one, robots = PartitionSpec(), PartitionSpec("env")
        specs = (one, robots, robots, robots, robots)
        step = jax.shard_map(step, mesh=env.mesh, in_specs=specs, out_specs=robots, check_vma=False)
    return partial(step, hyper, params_physics)


def model_step(env: Env, task, model, *, static):
    """`step(state, action, keys)` of all robots by the transition model; `task` is hyper.task."""
    fold = jax.vmap(jax.random.fold_in, (0, None))

    def step(state, action, keys):
        return dynamics.step(static.model, env, model, state, action, fold(keys, STEP), task)

    return step

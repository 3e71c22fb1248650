"""Learning to walk with less: PPO whose rollout tails are written by a learned model. Start here.

`iterate` is the paper's Algorithm 1, line by line; `run` repeats it over the schedule in one compiled
program; `init` makes the state it starts from. All are pure functions of an `Env`:

    config = config_lib.validate(config_lib.load("configs/go1.py"))
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot.load(config.robot), config.task, config.physics)
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    state, metrics = algorithm.run(env, hyper, state, schedule.columns(config), static=static)

Seeds are `jax.vmap(..., in_axes=(None, 0, None))` over `(hyper, state, columns)`: the columns stay
unbatched, because the number of real rows bounds a loop (rollout.py). sweep.py has that, and devices.

Anchoring: the tail starts at the observation after the last real row and never touches the state of
physics, from which the next iteration goes on.

Every random number comes from `fold_in` of the run's key with the iteration, a purpose, the row and
the robot's global index. So two chunks equal one run, and a row does not depend on N_r.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import Array, Int, PRNGKeyArray

from dynappo import dynamics, gae, model_error, networks, ppo, rollout, schedule
from dynappo.types import Env, Metrics, TrainState, Transition

# purposes of random numbers
ROWS, FIT, UPDATE, ACTION, STEP, RESET = range(6)
RETURNS = 100  # finished episodes in the mean return, as rsl_rl's on_policy_runner


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
    return TrainState(
        learner=ppo.init(static.ppo, hyper.ppo, env.obs_size, env.action_size, policy_key),
        model=dynamics.init(static.model, env, model_key) if schedule.uses_model(static) else None,
        env_state=env_state,
        params_physics=params_physics,
        robot_index=robot_index,
        returns=jnp.full(RETURNS, jnp.nan),
        lengths=jnp.full(RETURNS, jnp.nan),
        key=run_key,
    )


def iterate(
    env: Env, hyper, state: TrainState, columns: dict[str, Int[Array, ""]], *, static
) -> tuple[TrainState, Metrics]:
    """One iteration of the paper's Algorithm 1; `columns` is one row of `schedule.columns`."""
    horizon, num_envs = static.rollout.horizon, static.rollout.num_envs
    n_real, end = columns["n_real"], jnp.int32(horizon)
    key = jax.random.fold_in(state.key, columns["iteration"])
    rows_key = jax.random.fold_in(key, ROWS)

    # Collect N_r steps with physics, from where the last physics step ended
    buffer, env_state, sums = collect(env, hyper, state, n_real, rows_key, static=static)

    # Train the transition model on them, and let it write the tail of N_s = N - N_r steps
    model, model_metrics, model_errors = state.model, {}, {}
    if model is not None:
        unrolled = min(4, horizon - static.schedule.end_steps)
        model_errors = model_error.errors(static.model, env, model, buffer, unrolled, hyper.task)
        model, model_metrics = dynamics.fit(
            static.model,
            hyper.model,
            env,
            model,
            buffer,
            n_real,
            columns["model_epochs"],
            jax.random.fold_in(key, FIT),
            hyper.task,
        )
        act = policy(static.ppo, state.learner.params)
        keys = rollout.row_keys(rows_key, state.robot_index)
        tail = dynamics.tail(static.model, env, env_state)
        step = model_step(env, hyper.task, model, static=static)
        buffer, _, _ = rollout.fill(buffer, n_real, end, tail, keys, act=act, step=step)

    # Update the policy by PPO on real and synthetic rows alike
    real = (jnp.arange(horizon) < n_real)[:, None]
    bounded = model is not None and static.model.bounds
    batch = estimate(static.ppo, hyper.ppo, state.learner.params, buffer, real, bounded)
    if model is not None:
        batch = batch._replace(weight=jnp.where(real, 1.0, hyper.ppo.tail_weight * buffer.valid))
        model_errors |= summarise_tail(buffer, real, env.dt)
    learner, ppo_metrics = ppo.update(
        static.ppo, hyper.ppo, state.learner, batch, jax.random.fold_in(key, UPDATE)
    )

    returns, lengths = finished(state, buffer, n_real)
    state = state.replace(
        learner=learner, model=model, env_state=env_state, returns=returns, lengths=lengths
    )
    metrics = ppo_metrics | model_metrics | model_errors | summarise(sums, n_real * num_envs)
    return state, metrics | {
        "episode_return": jnp.nanmean(returns),
        "episode_length": jnp.nanmean(lengths),
        "policy_std": learner.params["std"].mean(),
        "nonfinite_robot": nonfinite_robot(buffer),
    }


def collect(env: Env, hyper, state: TrainState, n_real, key: PRNGKeyArray, *, static):
    """Rows `t < n_real` of a rollout `[N, R]`, by the policy and physics.

    Returns the buffer, the robots after the last row, and the sums of `env.metrics` over all rows.
    """
    keys = rollout.row_keys(key, state.robot_index)
    act = policy(static.ppo, state.learner.params)
    step = physics_step(env, hyper.task, state.params_physics)
    buffer = rollout.allocate(env, static.rollout.horizon, static.rollout.num_envs)
    start = jnp.int32(0)
    return rollout.fill(
        buffer, start, n_real, state.env_state, keys, act=act, step=step, metrics=env.metrics
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


def physics_step(env: Env, hyper, params_physics):
    """`step(state, action, keys)` of all robots: the environment's step, then its autoreset.

    On a mesh (sweep.py) every device steps its own robots: an engine's call is opaque to
    JAX's partitioner, which would gather all robots on every device.
    """
    fold = jax.vmap(jax.random.fold_in, (0, None))

    def step(hyper, params_physics, state, action, keys):
        after, outcome = jax.vmap(env.step, (None, 0, 0, 0, 0))(
            hyper, params_physics, state, action, fold(keys, STEP)
        )
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


def finished(state: TrainState, buffer: Transition, n_real):
    """The rings of returns and lengths with the episodes that physics finished, newest last."""
    real = (jnp.arange(buffer.reward.shape[0]) < n_real)[:, None]
    ended = (real & ((buffer.discount == 0) | (buffer.truncation == 1))).reshape(-1)
    # slot of each finished episode in ring + new ones, of which the last RETURNS are kept
    slot = RETURNS + jnp.cumsum(ended) - 1 - ended.sum()
    slot = jnp.where(ended & (slot >= 0), slot, RETURNS)  # out of bounds: dropped

    def push(ring, values):
        padded = jnp.concatenate([ring, jnp.full_like(ring, jnp.nan)])
        start = jnp.minimum(ended.sum(), RETURNS)
        kept = jax.lax.dynamic_slice(padded, (start,), (RETURNS,))
        return kept.at[slot].set(values.reshape(-1), mode="drop")

    return push(state.returns, buffer.episode_return), push(state.lengths, buffer.episode_length)


def nonfinite_robot(buffer: Transition) -> Int[Array, ""]:
    """Index of the first robot of a rollout with a reward or observation that is not finite; or -1.

    The host stops a run where a loss is not finite, and then wants to know whose row it was.
    """
    good = jnp.isfinite(buffer.reward) & jnp.isfinite(buffer.next_obs).all(-1)
    bad = ~good.all(axis=0)
    return jnp.where(bad.any(), jnp.argmax(bad), -1)


def summarise_tail(buffer: Transition, real, dt) -> Metrics:
    """`tail_bias`, mean reward of synthetic minus real rows (1/s), and `tail_falls`, as predicted."""
    tail, num_envs = 1.0 - real, buffer.reward.shape[1]
    mean = [
        (buffer.reward * part).sum() / jnp.maximum(part.sum() * num_envs, 1)
        for part in (tail, real)
    ]
    bias = jnp.where(tail.any(), (mean[0] - mean[1]) / dt, 0.0)
    return {"tail_bias": bias, "tail_falls": ((1 - buffer.discount) * tail).sum()}


def summarise(sums: Metrics, rows) -> Metrics:
    """Sums over real rows -> means; squared errors -> roots; events stay counts."""
    out = {}
    for name, total in sums.items():
        if name in ("falls", "timeouts", "blowups"):
            out[name] = total
        elif name.endswith("_error_sq"):
            out[name.removesuffix("_sq")] = jnp.sqrt(total / rows)
        else:
            out[name] = total / rows
    return out

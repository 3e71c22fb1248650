"""Learning to walk with less: PPO whose rollout tails are written by a learned model. Start here.

`iterate` is the paper's Algorithm 1, line by line; `run` repeats it over the schedule in one
compiled program; `init` makes the first state. All are pure functions of an `Env`:

    settings = config.validate(config.load("configs/go1.py"))
    static, hyper = config.split(settings)
    env = env_lib.make(robot.load(settings.robot), settings.task, settings.physics)
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    state, metrics = algorithm.run(env, hyper, state, schedule.columns(settings), static=static)

Anchoring: a tail starts from a state that physics reached in this iteration, the first one right
after the last real row. Tails never change the robots from which the next iteration continues.

Rounds of imagination (`schedule.rounds`; the paper has one): after its update, the policy acts in
new tails, which start from real rows drawn at random, and learns from these alone. This saves
simulator steps: with two, Go1 walks after two thirds of the steps (experiments/21_less).

Every random number comes from `fold_in` of the run's key with the iteration, a purpose, the row and
the robot's global index. So two chunks equal one run, and a row does not depend on N_r. A key is drawn
from once, or split once, or folded, and never two of these: `split(key)[i]` is `fold_in(key, i)`.
Many seeds and many devices: seeds.py.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo import rollout, schedule, stats
from dynappo.learner import gae, networks, ppo, symmetry
from dynappo.model import dynamics, errors
from dynappo.types import Columns, Env, Hyper, Metrics, Static, TrainState, Transition

# purposes of random numbers: of a seed, whose policy may be evaluated with the same; and of an iteration
NETWORKS, MODEL, BODIES, START, ITERATIONS, EPISODES = range(6)
ROWS, FIT, UPDATE, ACTION, STEP, RESET, ANCHOR = range(7)


def init(env: Env, hyper: Hyper, key: PRNGKeyArray, *, static: Static) -> TrainState:
    """Untrained networks, and R robots at their start, each with its own physical parameters."""
    robot_index = jnp.arange(static.rollout.num_envs)
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    keys = fold(key, jnp.arange(EPISODES))
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, fold(keys[BODIES], robot_index))
    env_state = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, fold(keys[START], robot_index))
    uses_model, image = schedule.uses_model(static), symmetry.policy_image(static, env)
    size, critic_size = networks.seen_sizes(static, env)
    return TrainState(
        learner=ppo.init(static, hyper, size, env.action_size, keys[NETWORKS], critic_size, image),
        model=dynamics.init(static, env, keys[MODEL]) if uses_model else None,
        env_state=env_state,
        params_physics=bodies,
        robot_index=robot_index,
        returns=jnp.full(stats.RETURNS, jnp.nan),
        lengths=jnp.full(stats.RETURNS, jnp.nan),
        key=keys[ITERATIONS],
    )


def iterate(
    env: Env, hyper: Hyper, state: TrainState, columns: Columns, *, static: Static
) -> tuple[TrainState, Metrics]:
    """One iteration of the paper's Algorithm 1; `columns` is one row of `schedule.columns`."""
    horizon, n_real = static.rollout.horizon, columns["n_real"]
    real = (jnp.arange(horizon) < n_real)[:, None]
    now = jax.random.fold_in(state.key, columns["iteration"])
    careful = jnp.where(schedule.late(static, columns["iteration"]), hyper.ppo.late_kl, 1.0)
    hyper = hyper._replace(ppo=hyper.ppo._replace(desired_kl=hyper.ppo.desired_kl * careful))

    def key(purpose, k=0):
        return jax.random.fold_in(now, purpose + (ANCHOR + 1) * k)

    # Collect N_r steps with physics, from where the last iteration left the robots
    buffer, env_state, sums = collect(env, hyper, state, n_real, key(ROWS), static=static)
    state = state.replace(env_state=env_state)
    metrics = stats.of_rows(sums, n_real * static.rollout.num_envs)

    # Train the transition model on them
    if state.model is not None:
        unrolled = min(4, horizon - static.schedule.end_steps)
        metrics |= errors.errors(static, hyper, env, state.model, buffer, unrolled)
        new = buffer, n_real, columns["model_epochs"], key(FIT)
        model, fitted = dynamics.fit(static, hyper, env, state.model, *new)
        state, metrics = state.replace(model=model), metrics | fitted

    # Let the model write the tail of N_s = N - N_r steps, then update the policy by PPO on real and
    # synthetic rows alike; in further rounds, on new tails of the new policy
    def imagine(k, carry):
        learner, buffer, _ = carry
        if state.model is not None:
            last = dynamics.tail(static, env, env_state)
            drawn = dynamics.anchors(static, env, buffer, n_real, key(ANCHOR, k))
            start = jax.tree.map(partial(jnp.where, k == 0), last, drawn)
            keys = rollout.row_keys(key(ROWS, k), state.robot_index)
            act = policy(static, env, learner.params)
            step = dynamics.step(static, hyper, env, state.model)
            part = n_real, jnp.int32(horizon)
            buffer = rollout.fill(buffer, *part, start, keys, act=act, step=step)[0]
        batch = estimate(static, hyper, env, learner.params, buffer, real, k)
        learner, learned = ppo.update(static, hyper, learner, batch, key(UPDATE, k), image)
        return learner, buffer, learned

    image = symmetry.policy_image(static, env)
    start = state.learner, buffer, dict.fromkeys(ppo.METRICS, jnp.zeros(()))
    learner, buffer, learned = jax.lax.fori_loop(0, columns.get("rounds", 1), imagine, start)
    if state.model is not None:
        metrics |= stats.of_tail(buffer, real, env.dt)

    returns, lengths = stats.finished(state, buffer, n_real)
    state = state.replace(learner=learner, returns=returns, lengths=lengths)
    return state, metrics | learned | stats.of_episodes(buffer, n_real) | {
        "episode_return": jnp.nanmean(returns),
        "episode_length": jnp.nanmean(lengths),
        "policy_std": learner.params["std"].mean(),
        "nonfinite_robot": stats.nonfinite_robot(buffer, real),
    }


def collect(env: Env, hyper: Hyper, state: TrainState, n_real, key, *, static: Static):
    """Rows `t < n_real` from physics: `(buffer, robots after them, sums of env.metrics)`."""
    return rollout.fill(
        rollout.allocate(env, static.rollout.horizon, static.rollout.num_envs),
        jnp.int32(0),
        n_real,
        state.env_state,
        rollout.row_keys(key, state.robot_index),
        act=policy(static, env, state.learner.params),
        step=physics_step(env, hyper, state.params_physics),
        metrics=env.metrics,
    )


def run(
    env: Env, hyper: Hyper, state: TrainState, columns: Columns, count=None, *, static: Static
) -> tuple[TrainState, Metrics]:
    """`iterate` over every row of the schedule; metrics have shape `[I]`.

    With a traced `count` over the first `count` rows alone, and the metrics of the others are 0: one
    compiled program then serves chunks of any length up to I.
    """
    columns = {name: jnp.asarray(column) for name, column in columns.items()}
    rows = len(columns["iteration"])
    # jit: traced once, for the shapes of its metrics and for the loop
    step = jax.jit(partial(iterate, env, static=static))

    def row(i, carry):
        state, table = carry
        state, metrics = step(hyper, state, {name: column[i] for name, column in columns.items()})
        return state, jax.tree.map(lambda column, x: column.at[i].set(x), table, metrics)

    first = {name: column[0] for name, column in columns.items()}
    _, shapes = jax.eval_shape(step, hyper, state, first)
    table = jax.tree.map(lambda x: jnp.zeros((rows, *x.shape), x.dtype), shapes)
    return jax.lax.fori_loop(0, rows if count is None else count, row, (state, table))


def policy(static: Static, env: Env, params: dict):
    """`act(state, keys) -> action, mean, log_prob, value` of every robot; the action is Gaussian."""
    std = params["std"]
    joined = networks.join(static, params)

    def act(state, keys):
        seen = networks.seen(static, env, state.obs, state.prop)
        mean, value = networks.of_joined(static, joined, *seen)
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, ACTION)
        action = mean + std * jax.vmap(lambda k: jax.random.normal(k, std.shape))(keys)
        return action, mean, networks.log_prob(mean, std, action), value

    return act


def physics_step(env: Env, hyper: Hyper, bodies):
    """`step(state, action, keys)` of all robots: the environment's step, then its autoreset.

    On a mesh (seeds.py) each device steps its own robots. JAX's partitioner cannot see into an
    engine's call, and would gather all robots on every device.
    """
    fold, robots = jax.vmap(jax.random.fold_in, (0, None)), (None, 0, 0, 0, 0)

    def step(hyper: Hyper, bodies, state, action, keys):
        after, outcome = jax.vmap(env.step, robots)(hyper, bodies, state, action, fold(keys, STEP))
        autoreset = jax.vmap(env.autoreset, robots)
        return autoreset(hyper, bodies, after, outcome, fold(keys, RESET)), outcome

    if env.mesh is not None and env.mesh.size > 1:
        one, own = PartitionSpec(), PartitionSpec("env")
        specs = (one, own, own, own, own)
        step = jax.shard_map(step, mesh=env.mesh, in_specs=specs, out_specs=own, check_vma=False)
    return partial(step, hyper, bodies)


def estimate(
    static: Static, hyper: Hyper, env: Env, params: dict, buffer: Transition, real, k=0
) -> ppo.Batch:
    """Advantages and returns of a rollout, bootstrapped by V(next_obs) at truncations and row N-1.

    Elsewhere the next row's value is the same number. In rounds `k` > 0 `real` rows [N, 1] have
    weight 0: an earlier policy chose their actions.
    """
    with jax.default_matmul_precision("highest"):
        cut = (buffer.truncation == 1).at[-1].set(True)
        seen = networks.seen(static, env, buffer.obs, buffer.prop)
        after = networks.seen(static, env, buffer.next_obs, buffer.next_prop)[1]
        value, last = buffer.value, networks.value(static, params, after)
        bootstrap = jnp.where(cut, last, jnp.roll(value, -1, axis=0))
        rows = buffer.reward, buffer.discount, buffer.truncation, value, bootstrap
        advantages, returns = gae.gae(*rows, gamma=hyper.ppo.gamma, lambda_=hyper.ppo.lambda_)
    weight = None
    if schedule.uses_model(static):
        weight = presence(buffer, real) * (~real | (k == 0))
    return ppo.batch(buffer, seen, advantages, returns, weight)


def presence(buffer: Transition, real) -> Float[Array, "N R"]:
    """The weight of each row in PPO: 1 if `real` [N, 1], else the probability of getting that far.

        w_t = product of discount_k over the tail's rows k < t

    A tail continues past a predicted fall, so rows after it count less. DreamerV3 does the same.
    """
    lived = jnp.cumprod(jnp.where(real, 1.0, buffer.discount), axis=0)
    return jnp.roll(lived, 1, axis=0).at[0].set(1.0)

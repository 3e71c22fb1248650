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

A memory (`model.memory`; the paper has none) keeps real rows of past iterations: the model learns from them,
too, and tails of later rounds begin there. So few robots are enough (experiments/27_few).

Every random number comes from `fold_in` of the run's key with the iteration, a purpose, the row and
the robot's global index. So two chunks equal one run, and a row does not depend on N_r. A key is used in
one way alone: drawn from once, split once, or folded. Two would give equal bits: `split(key)[i]` is
`fold_in(key, i)`.

Read next, in the order of `iterate`:

- rollout.py (`fill`) and types.py: the rows of a rollout, and the environment that writes them
- model/dynamics.py (`fit`, `step`): the transition model, which learns from the rows and writes more
- model/memory.py: rows of past iterations, and more imagined robots than real ones
- learner/ppo.py (`update`, `loss`), gae.py and networks.py: how the policy learns from them
- schedule.py: how many rows the model writes in each iteration; stats.py: an iteration's metrics
- fast.py: the same functions with fewer kernels, which `iterate` calls; seeds.py: many seeds and devices
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo import fast, rollout, schedule, stats
from dynappo.learner import gae, networks, ppo, scaling, symmetry, units
from dynappo.model import dynamics, errors, examples, memory
from dynappo.types import Columns, Env, Hyper, Learner, Metrics, Static, TrainState, Transition

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
    obs_size, critic_size = networks.input_sizes(static, env)
    return TrainState(
        learner=ppo.init(
            static,
            hyper,
            obs_size=obs_size,
            action_size=env.action_size,
            key=keys[NETWORKS],
            critic_size=critic_size,
            image=image,
            units=units.policy_units(static, env),
        ),
        model=dynamics.init(static, env, keys[MODEL]) if uses_model else None,
        env_state=env_state,
        params_physics=bodies,
        robot_index=robot_index,
        returns=jnp.full(stats.RETURNS, jnp.nan),
        lengths=jnp.full(stats.RETURNS, jnp.nan),
        key=keys[ITERATIONS],
        memory=memory.init(static, env) if uses_model and static.model.memory else None,
    )


def iterate(
    env: Env, hyper: Hyper, state: TrainState, counts: Columns, *, static: Static
) -> tuple[TrainState, Metrics]:
    """One iteration of the paper's Algorithm 1; `counts` is one row of `schedule.columns`."""
    iteration, n_real = counts["iteration"], counts["n_real"]
    horizon, num_envs = static.rollout.horizon, static.rollout.num_envs
    hyper = hyper_at(static, hyper, iteration)
    real = (jnp.arange(horizon) < n_real)[:, None]
    image, scales = symmetry.policy_image(static, env), units.policy_units(static, env)
    iteration_key = jax.random.fold_in(state.key, iteration)

    def key(purpose, k=0):
        return jax.random.fold_in(iteration_key, purpose + (ANCHOR + 1) * k)

    # Collect N_r rows with physics, from where the last iteration left the robots
    rows, env_state, sums = collect(env, hyper, state, n_real=n_real, key=key(ROWS), static=static)
    state = state.replace(env_state=env_state)
    metrics = stats.of_rows(sums, n_real * num_envs)

    # Train the transition model on them
    if state.model is not None:
        steps = min(4, horizon - static.schedule.end_steps)
        metrics |= errors.errors(static, hyper, env, model=state.model, rows=rows, steps=steps)
        new, past = examples.examples(static, hyper, env, rows=rows, n_real=n_real), state.memory
        if past is not None:
            past = memory.remember(past, new, dynamics.tail(static, env, rows), counts)
        model, losses = fast.fit(
            static,
            hyper,
            state.model,
            rows=new,
            epochs=counts["model_epochs"],
            key=key(FIT),
            mirrors=dynamics.mirrors(static, env),
            draw=memory.drawing(static, past, counts),
        )
        state, metrics = state.replace(model=model, memory=past), metrics | losses

    # Let the model write the tail of N_s = N - N_r rows, then update the policy by PPO on real and
    # synthetic rows alike; in further rounds, on new tails of the new policy
    def one_round(k, carry):
        learner, rows, _ = carry
        if state.model is not None:
            last = memory.branches(static, dynamics.tail(static, env, state.env_state), axis=0)
            drawn = memory.starts(
                static, hyper, env, state.memory, rows=rows, counts=counts, key=key(ANCHOR, k)
            )
            start = jax.tree.map(partial(jnp.where, k == 0), last, drawn)
            now = state.replace(learner=learner)
            rows = imagine(
                env,
                hyper,
                now,
                rows=rows,
                n_real=n_real,
                start=start,
                key=key(ROWS, k),
                static=static,
            )
        batch = estimate(
            static, hyper, env, params=learner.params, rows=rows, real=real, of_round=k
        )
        updated, learned = fast.update(
            static, hyper, learner, batch=batch, key=key(UPDATE, k), image=image, units=scales
        )
        return value_first(static, iteration, learner, updated), rows, learned

    nothing = dict.fromkeys(ppo.METRICS, jnp.zeros(()))
    rows = memory.branches(static, rows, axis=1) if state.model is not None else rows
    learner, rows, learned = jax.lax.fori_loop(
        0, counts.get("rounds", 1), one_round, (state.learner, rows, nothing)
    )
    if state.model is not None:
        metrics |= stats.of_tail(rows, real, env.dt)
        rows = memory.real_robots(static, rows, axis=1)

    if static.ppo.normalize:
        of_actor, of_critic = networks.inputs(static, env, rows.obs, rows.prop)
        seen = {"actor": of_actor, "critic": of_critic}
        mirrors = symmetry.input_mirrors(static, env) if static.ppo.symmetry else None
        learner = scaling.updated(learner, seen, weight=real * rows.valid, mirrors=mirrors)

    returns, lengths = stats.finished(state, rows, n_real)
    state = state.replace(learner=learner, returns=returns, lengths=lengths)
    return state, metrics | learned | stats.of_episodes(rows, n_real) | {
        "episode_return": jnp.nanmean(returns),
        "episode_length": jnp.nanmean(lengths),
        "policy_std": learner.params["std"].mean(),
        "nonfinite_robot": stats.nonfinite_robot(rows, real),
    }


def hyper_at(static: Static, hyper: Hyper, iteration) -> Hyper:
    """The floats of an iteration: after `schedule.late_from`, a smaller KL."""
    share = jnp.where(schedule.late(static, iteration), hyper.ppo.late_kl, 1.0)
    return hyper._replace(ppo=hyper.ppo._replace(desired_kl=hyper.ppo.desired_kl * share))


def collect(env: Env, hyper: Hyper, state: TrainState, n_real, key, *, static: Static):
    """Rows `t < n_real` from physics: `(rows [N, R], robots after them, sums of env.metrics)`."""
    return fast.fill(
        rollout.allocate(env, static.rollout.horizon, static.rollout.num_envs),
        begin=jnp.int32(0),
        end=n_real,
        state=state.env_state,
        keys=rollout.row_keys(key, state.robot_index),
        act=as_recorded(
            env, policy(static, env, state.learner.params), state.learner.params["std"]
        ),
        step=physics_step(env, hyper, state.params_physics),
        metrics=env.metrics,
    )


def imagine(
    env: Env,
    hyper: Hyper,
    state: TrainState,
    rows: Transition,
    n_real,
    start,
    key,
    *,
    static: Static,
) -> Transition:
    """`rows` with the rows `t >= n_real` from the model, each imagined robot's from its `start`."""
    assert state.model is not None, "plain PPO has no model"
    rows, _, _ = fast.fill(
        rows,
        begin=n_real,
        end=jnp.int32(static.rollout.horizon),
        state=start,
        keys=rollout.row_keys(key, memory.imagined_index(static, state.robot_index)),
        act=policy(static, env, state.learner.params),
        step=fast.step(static, hyper, env, state.model),
    )
    return rows


def run(
    env: Env, hyper: Hyper, state: TrainState, columns: Columns, *, static: Static
) -> tuple[TrainState, Metrics]:
    """`iterate` over every row of the schedule; metrics have shape `[I]`."""
    columns = {name: jnp.asarray(column) for name, column in columns.items()}

    def one(state, counts):
        return iterate(env, hyper, state, counts, static=static)

    return jax.lax.scan(one, state, columns)


def policy(static: Static, env: Env, params: dict):
    """`act(state, keys) -> action, mean, log_prob, value` of every robot; the action is Gaussian."""
    std, actor_critic = params["std"], fast.actor_critic(static, params)

    def act(state, keys):
        obs, critic_obs = networks.inputs(static, env, state.obs, state.prop)
        mean, value = actor_critic(obs, critic_obs)
        keys = jax.vmap(jax.random.fold_in, (0, None))(keys, ACTION)
        action = mean + std * jax.vmap(lambda k: jax.random.normal(k, std.shape))(keys)
        return action, mean, networks.log_prob(mean, std, action), value

    return act


def as_recorded(env: Env, act, std):
    """`act` with the actions of a record, in an environment that has one."""
    if (recorded := env.recorded) is None:
        return act

    def again(state, keys):
        _, mean, _, value = act(state, keys)
        action = jax.vmap(recorded)(state)
        return action, mean, networks.log_prob(mean, std, action), value

    return again


def value_first(static: Static, iteration, before: Learner, after: Learner) -> Learner:
    """`after` an update; in the first `ppo.value_first` iterations with the policy as it was `before`."""
    if not static.ppo.value_first:
        return after
    waits = partial(jnp.where, iteration <= static.ppo.value_first)
    held = {
        name: jax.tree.map(waits, before.params[name], after.params[name])
        for name in ("actor", "std")
    }
    return after.replace(params=after.params | held)


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
    static: Static, hyper: Hyper, env: Env, params: dict, rows: Transition, real, of_round=0
) -> ppo.Batch:
    """Advantages and returns of a rollout, bootstrapped by V(next_obs) at truncations and row N-1.

    Elsewhere the next row's value is the same number. `real` rows [N, 1] whose actions another policy chose
    have weight 0: in rounds after the first (`of_round` > 0), and where all are recorded.
    """
    with jax.default_matmul_precision("highest"):
        cut = (rows.truncation == 1).at[-1].set(True)
        obs, critic_obs = networks.inputs(static, env, rows.obs, rows.prop)
        _, critic_next_obs = networks.inputs(static, env, rows.next_obs, rows.next_prop)
        next_value = networks.value(static, params, critic_next_obs)
        advantages, returns = gae.gae(
            reward=rows.reward,
            discount=rows.discount,
            truncation=rows.truncation,
            value=rows.value,
            bootstrap=jnp.where(cut, next_value, jnp.roll(rows.value, -1, axis=0)),
            gamma=hyper.ppo.gamma,
            lambda_=hyper.ppo.lambda_,
        )
    weight = None
    if schedule.uses_model(static):
        own = of_round == 0 if env.recorded is None else False
        weight = presence(rows, real) * (~real | own)
    return ppo.Batch(
        obs=obs,
        action=rows.action,
        action_mean=rows.action_mean,
        log_prob=rows.log_prob,
        value=rows.value,
        advantages=advantages,
        returns=returns,
        weight=weight,
        critic_obs=critic_obs if static.ppo.critic == "state" else None,
    )


def presence(rows: Transition, real) -> Float[Array, "N R"]:
    """The weight of each row in PPO: 1 if `real` [N, 1], else the probability of getting that far.

        w_t = product of discount_k over the tail's rows k < t

    A tail continues past a predicted fall, so rows after it count less. DreamerV3 does the same.
    """
    lived = jnp.cumprod(jnp.where(real, 1.0, rows.discount), axis=0)
    return jnp.roll(lived, 1, axis=0).at[0].set(1.0)

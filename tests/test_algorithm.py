"""One iteration and the loop of them: anchoring, the seam, the compiled program, and learning."""

from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from toy_model import fit_rows
from toy_runs import (
    AS_USERS,
    ITERATIONS,
    N,
    R,
    advantages,
    assert_close,
    assert_same,
    columns,
    leaves,
    observe,
    row,
)

from dynappo import algorithm, schedule
from dynappo.learner import networks, ppo
from dynappo.model import dynamics, moments

LATE_FROM = 4  # the ramp ends in iteration 5: no row of the schedule changes


@pytest.fixture(scope="module")
def env():
    """The toy environment with noise, aged starts, falls and time limits."""
    return toy_env.make()


@pytest.fixture(scope="module")
def tail():
    """`(config, static, hyper)` with a ramp to 4 of 8 rows by the model, late once it is over."""
    return toy_env.settings(toy_env.TAIL | {"schedule.late_from": LATE_FROM})


@pytest.fixture(scope="module")
def plain():
    """`(config, static, hyper)` of plain PPO, otherwise the same."""
    return toy_env.settings()


@pytest.fixture(scope="module")
def first(env, tail, plain):
    """`first(seed, kind)`: the state before the first iteration, compiled once a kind."""
    inits = {
        name: jax.jit(partial(algorithm.init, env, static=static))
        for name, (_, static, _) in {"tail": tail, "plain": plain}.items()
    }
    hypers = {"tail": tail[2], "plain": plain[2]}
    return lambda seed=0, kind="tail": inits[kind](hypers[kind], jax.random.key(seed))


@pytest.fixture(scope="module")
def run(env, tail):
    """`run(hyper, state, columns)` of the program with a model; a second trace is an error."""
    static = tail[1]

    def once(hyper, state, columns):
        return algorithm.run(env, hyper, state, columns, static=static)

    return jax.jit(chex.assert_max_traces(once, n=1))


@pytest.fixture(scope="module")
def run_plain(env, plain):
    """`run(hyper, state, columns)` of plain PPO; the state is donated, as the trainer does."""
    return jax.jit(partial(algorithm.run, env, static=plain[1]), donate_argnums=1)


def inner(jaxpr):
    """Every equation of a jaxpr, those of its loops and branches included."""
    for equation in jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            for part in value if isinstance(value, (tuple, list)) else (value,):
                part = getattr(part, "jaxpr", part)
                if hasattr(part, "eqns"):
                    yield from inner(part)


@pytest.fixture(scope="module")
def observed(env, tail):
    """`observe` of the program with a model."""
    return observe(env, tail[1])


# ---- init


def test_a_state_of_plain_ppo_is_that_of_the_method_without_the_model(first):
    """The same key gives the same networks and robots, whether or not there is a model."""
    with_model, without = first(3), first(3, "plain")
    assert without.model is None and with_model.model is not None
    assert_same(with_model.replace(model=None), without)


def test_a_robot_is_itself_however_many_there_are(env, plain, first):
    """Physical parameters and start depend on key and index of the robot only."""
    static = plain[1]._replace(rollout=plain[1].rollout._replace(num_envs=2 * R))
    many = jax.jit(partial(algorithm.init, env, static=static))(plain[2], jax.random.key(0))
    few = first()
    for name in ("env_state", "params_physics", "robot_index"):
        part = jax.tree.map(lambda x: x[:R], getattr(many, name))
        assert_close(part, getattr(few, name), 1e-6)
    assert len(np.unique(many.params_physics)) == 2 * R
    assert len(np.unique(many.env_state.obs[:, 0])) == 2 * R


def test_before_the_first_episode_ends_there_is_no_return(first):
    """Both rings hold NaN, 100 each."""
    state = first()
    assert state.returns.shape == state.lengths.shape == (100,)
    assert np.isnan(state.returns).all() and np.isnan(state.lengths).all()


# ---- the rollout inside an iteration


@pytest.fixture(scope="module")
def iterated(observed, tail, first):
    """`iterated[n_real] -> (rollout, state, metrics)` of the first iteration."""
    config, _, hyper = tail
    state = first()
    return {n: observed(hyper, state, row(config, n_real=n)) for n in (N, 7, 5, 3)}


def test_rows_of_physics_do_not_depend_on_where_the_tail_begins(iterated):
    """Row t < N_r is the same to the bit for every N_r."""
    whole = iterated[N][0]
    for n in (7, 5, 3):
        assert_same(*(jax.tree.map(lambda x, n=n: x[:n], b) for b in (whole, iterated[n][0])))
        assert (whole.reward[n:] != iterated[n][0].reward[n:]).all()


def test_the_tail_starts_from_the_observation_that_physics_carries(iterated):
    """Row N_r observes what the last physics step, or the reset after it, left."""
    resets = 0
    for n in (7, 5, 3):
        buffer, state, _ = iterated[n]
        np.testing.assert_array_equal(buffer.obs[n], state.env_state.obs)
        ended = (buffer.discount[n - 1] == 0) | (buffer.truncation[n - 1] == 1)
        resets += int(ended.sum())
        fresh = state.env_state.clock[ended]
        np.testing.assert_array_equal(fresh, 0)
    assert resets > 0  # or the new episodes were not seen


@pytest.mark.parametrize("n_real", [N, 5])
def test_the_next_observation_is_the_next_rows_observation(iterated, n_real):
    """The same array, noise included, unless a reset lies between; then another."""
    buffer = jax.tree.map(np.asarray, iterated[n_real][0])
    ended = ((buffer.discount == 0) | (buffer.truncation == 1))[:-1]
    same = (buffer.next_obs[:-1] == buffer.obs[1:]).all(-1)
    np.testing.assert_array_equal(same, ~ended)
    assert 0 < ended.sum() < ended.size / 2


def test_no_row_of_a_tail_ends_an_episode(iterated):
    """Rows of the model have discount 1, truncation 0, and copy command and action exactly.

    Without `model.clean`, what it carries is what the policy sees.
    """
    buffer = jax.tree.map(np.asarray, iterated[3][0])
    np.testing.assert_array_equal(buffer.discount[3:], 1)
    np.testing.assert_array_equal(buffer.truncation[3:], 0)
    np.testing.assert_array_equal(buffer.next_obs[3:, :, 3], buffer.obs[3:, :, 3])
    np.testing.assert_array_equal(buffer.next_obs[3:, :, 4:], buffer.action[3:])
    assert (buffer.next_obs[3:, :, :3] != buffer.obs[3:, :, :3]).all()
    np.testing.assert_array_equal(buffer.next_obs[3:, :, :3], buffer.next_prop[3:])


def test_every_row_holds_what_the_policy_of_this_iteration_did(iterated, tail, first):
    """Mean, value and log probability of all rows, against NumPy on the recorded actions."""
    static, params = tail[1], first().learner.params
    buffer = iterated[5][0]
    mean = networks.policy(static, params, buffer.obs)
    np.testing.assert_allclose(buffer.action_mean, mean, 1e-5, 1e-5)
    np.testing.assert_allclose(buffer.value, networks.value(static, params, buffer.obs), 1e-5, 1e-5)
    z = np.asarray((buffer.action - mean) / params["std"])
    density = -0.5 * z**2 - np.log(np.asarray(params["std"])) - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(buffer.log_prob, density.sum(-1), 1e-4, 1e-4)
    assert abs(z.mean()) < 0.2 and 0.85 < z.std() < 1.15
    noise = z.reshape(N * R, 2)
    assert len(np.unique(noise.round(4), axis=0)) == N * R  # no row repeats another's noise


def test_the_tail_is_written_by_the_model_fitted_in_this_iteration(iterated, tail, env):
    """Rows after N_r are `dynamics.predict` of the new weights on their own observation."""
    _, static, hyper = tail
    predict = jax.jit(partial(dynamics.predict, static, hyper, env))
    for n in (5, 3):
        buffer, state, _ = iterated[n]
        obs, reward, _ = predict(state.model, buffer.obs, buffer.action)
        np.testing.assert_allclose(buffer.next_obs[n:], obs[n:], 1e-5, 1e-5)
        np.testing.assert_allclose(buffer.reward[n:], reward[n:], 1e-5, 1e-5)


@pytest.mark.parametrize("n_real", [N, 5])
def test_the_model_sees_real_rows_that_end_no_episode(iterated, n_real):
    """Its moments are those of rows t < N_r without falls and time limits, and of no others."""
    buffer, state, _ = iterated[n_real]
    buffer = jax.tree.map(lambda x: np.asarray(x)[:n_real], buffer)
    kept = (buffer.discount == 1) & (buffer.truncation == 0)
    assert 0 < kept.sum() < kept.size
    x = np.concatenate([buffer.obs, buffer.action], -1)[kept]
    y = np.concatenate(
        [(buffer.next_obs - buffer.obs)[..., :3], buffer.reward[..., None] / toy_env.DT], -1
    )[kept]
    for numbers, rows in ((state.model.inputs, x), (state.model.targets, y)):
        mean, std = moments.scale(numbers)
        np.testing.assert_allclose(mean, rows.mean(0), 1e-4, 1e-4)
        np.testing.assert_allclose(std, rows.std(0), 1e-3, 1e-4)


def test_the_model_is_fitted_to_real_rows_alone(iterated, tail, env, first):
    """Its new weights are those of a fit in which every other row holds nonsense."""
    _, static, hyper = tail
    fit = jax.jit(partial(fit_rows, dynamics.fit, static, hyper, env=env))
    key = jax.random.fold_in(jax.random.fold_in(first().key, 1), algorithm.FIT)
    for n in (N, 5):
        buffer, state, metrics = iterated[n]
        real = (jnp.arange(N) < n)[:, None]

        def keep(x, real=real):
            return jnp.where(real.reshape(N, 1, *[1] * (x.ndim - 2)), x, 1e3)

        rows = jax.tree.map(keep, buffer)
        expected, losses = fit(first().model, rows, n, static.model.epochs, key)
        assert_close(state.model, expected, 1e-5)
        assert_close({name: metrics[name] for name in losses}, losses, 1e-5)


def test_the_policy_learns_from_real_and_synthetic_rows_alike(iterated, tail, first):
    """The new learner is PPO's update with advantages that a NumPy loop computes of all rows."""
    _, static, hyper = tail
    learner = first().learner
    update = jax.jit(partial(ppo.update, static, hyper))
    for n in (N, 5):
        buffer, state, _ = iterated[n]
        rows = jax.tree.map(np.asarray, buffer)
        last = np.asarray(networks.value(static, learner.params, buffer.next_obs))
        gamma, lambda_ = hyper.ppo.gamma, hyper.ppo.lambda_
        found = advantages(rows, rows.value, last, gamma=gamma, lambda_=lambda_)
        batch = ppo.Batch(
            obs=buffer.obs,
            action=buffer.action,
            action_mean=buffer.action_mean,
            log_prob=buffer.log_prob,
            value=buffer.value,
            advantages=jnp.asarray(found, jnp.float32),
            returns=jnp.asarray(found + rows.value, jnp.float32),
        )
        key = jax.random.fold_in(jax.random.fold_in(first().key, 1), algorithm.UPDATE)
        expected, _ = update(learner, batch, key)
        assert_close(state.learner.params, expected.params, 1e-5)
        np.testing.assert_allclose(state.learner.learning_rate, expected.learning_rate, 1e-6)


def test_permuting_the_robots_permutes_their_rows(observed, iterated, tail, first):
    """A robot carries its index, state and physical parameters with it, and nothing else."""
    config, _, hyper = tail
    order = np.random.default_rng(0).permutation(R)
    state = first()
    moved = {
        name: jax.tree.map(lambda x: x[order], getattr(state, name))
        for name in ("env_state", "params_physics", "robot_index")
    }
    buffer, after, _ = observed(hyper, state.replace(**moved), row(config, n_real=N))
    assert_close(jax.tree.map(lambda x: x[:, order], iterated[N][0]), buffer, 1e-6)
    expected = jax.tree.map(lambda x: x[order], iterated[N][1].env_state)
    assert_close(expected, after.env_state, 1e-6)


def test_an_environment_that_is_its_model_has_a_tail_like_reality(iterated, tail, first):
    """Where the model is exact, N_r = N and N_r = N - 4 give the same rollout and learner."""
    # without normalisation and with no epochs of fitting, the model stays what the environment is
    config, static, hyper = tail
    static = static._replace(model=static.model._replace(normalize=False))
    state = first()
    call = observe(toy_env.like_model(static, state.model), static)
    (real, one, _), (short, other, _) = (
        call(hyper, state, row(config, n_real=n, epochs=0)) for n in (N, N - 4)
    )
    assert_close(real, short, 1e-5)
    assert_close(one.learner, other.learner, 1e-4)
    assert_same(one.model.params, state.model.params)
    elsewhere = [iterated[n][0].next_obs[-3:] for n in (N, N - 3)]
    assert np.abs(elsewhere[0] - elsewhere[1]).max() > 0.1


# ---- advantages and weights of a tail


@pytest.fixture(scope="module")
def soft(iterated, tail, first):
    """`(rows, real)`: a rollout whose tail after row 5 may fall and is cut, with values far out."""
    rng, real = np.random.default_rng(0), np.arange(N)[:, None] < 5
    rows = jax.tree.map(np.array, iterated[5][0])
    rows.discount[2, ::4] = 0  # falls of real rows
    far = np.where(real[..., None], 1.0, 5.0)
    rows = rows.replace(
        obs=far * rows.obs,
        next_obs=far * rows.next_obs,
        discount=np.where(real, rows.discount, rng.uniform(0.1, 1, (N, R))),
        truncation=np.where(real, rows.truncation, rng.random((N, R)) < 0.2),
    )
    value = networks.value(tail[1], first().learner.params, rows.obs)
    rows = rows.replace(value=np.where(real, rows.value, value))
    assert rows.truncation[5:-1].any() and (rows.discount[:5] == 0).any()
    return rows, real


def estimate(settings, first, rows, real):
    """`algorithm.estimate` of NumPy rows."""
    _, static, hyper = settings
    arrays = jax.tree.map(jnp.asarray, rows)
    return algorithm.estimate(static, hyper, toy_env.make(), first().learner.params, arrays, real)


def test_advantages_of_a_tail_weigh_falls_and_stop_at_cuts(soft, tail, first):
    """Against a loop: soft discounts, cuts inside the tail."""
    rows, real = soft
    value, params = rows.value, first().learner.params
    last = np.asarray(networks.value(tail[1], params, rows.next_obs))
    gamma, lambda_ = tail[2].ppo.gamma, tail[2].ppo.lambda_
    expected = advantages(rows, value, last, gamma=gamma, lambda_=lambda_)
    batch = estimate(tail, first, rows, real)
    np.testing.assert_allclose(batch.advantages, expected, 1e-4, 1e-5)
    np.testing.assert_allclose(batch.returns, expected + value, 1e-4, 1e-5)
    np.testing.assert_array_equal(batch.value, rows.value)


@pytest.mark.parametrize("n_real", [0, 1, 5, N])
def test_a_row_weighs_what_the_tail_before_it_survives(soft, n_real):
    """Against a double loop over the rows before each; real rows, falls among them, are not asked."""
    rng = np.random.default_rng(1)
    discount = np.where(rng.random((N, R)) < 0.2, 0.0, rng.uniform(0, 1, (N, R)))
    expected = np.ones((N, R))
    for r in range(R):
        for t in range(N):
            for k in range(n_real, t):
                expected[t, r] *= discount[k, r]
    rows, real = soft[0].replace(discount=jnp.asarray(discount)), jnp.arange(N)[:, None] < n_real
    found = algorithm.presence(rows, real)
    np.testing.assert_allclose(found, expected, 1e-5, 1e-7)
    np.testing.assert_array_equal(found[: n_real + 1], 1)
    assert (discount[:n_real] == 0).any() or n_real < 5


def test_rows_after_a_sure_predicted_fall_weigh_nothing_and_time_limits_nothing_else(
    soft, tail, first
):
    rows, real = soft
    discount = np.where(real, rows.discount, 1.0)
    discount[5, :4] = discount[6, 4:8] = 0
    batch = estimate(tail, first, rows.replace(discount=discount), real)
    expected = np.ones((N, R))
    expected[6:, :4] = expected[7:, 4:8] = 0
    np.testing.assert_array_equal(batch.weight, expected)


def test_where_the_model_predicts_no_falls_every_row_weighs_one(iterated, tail, plain, first):
    """As in the paper's variants, whatever falls there were in real rows; plain PPO has no weights."""
    for n in (N, 5, 3):
        rows, real = iterated[n][0], np.arange(N)[:, None] < n
        fallen = rows.replace(discount=rows.discount.at[2, ::4].set(0.0))
        np.testing.assert_array_equal(estimate(tail, first, fallen, real).weight, 1)
    assert estimate(plain, first, rows, real).weight is None


# ---- rounds of imagination


@pytest.fixture(scope="module")
def rounds(env, first):
    """`rounds(k, n_real) -> (static, hyper, rollout, state, metrics)` of the first iteration."""
    config, static, hyper = toy_env.settings(toy_env.TAIL | {"schedule.rounds": 3})
    call = observe(env, static)

    def iterated(k, n_real=5):
        columns = row(config, n_real=n_real) | {"rounds": jnp.int32(k)}
        return static, hyper, *call(hyper, first(), columns)

    return iterated


def test_one_round_of_several_is_the_iteration_without_rounds(rounds, iterated):
    for n_real in (N, 5):
        assert_close(rounds(1, n_real)[2:], iterated[n_real], 1e-5)


def test_a_second_round_learns_from_new_tails_of_the_new_policy_alone(rounds, iterated, env):
    """Against the parts by hand: anchors, rows, advantages by a NumPy loop, PPO with weights 0 and 1."""
    static, hyper, buffer, after, metrics = rounds(2)
    old, state, before = iterated[5]
    learner, n = state.learner, 5
    assert_close(*(jax.tree.map(lambda x: x[:n], rows) for rows in (buffer, old)), 1e-6)  # physics
    assert_close((after.env_state, after.returns), (state.env_state, state.returns), 1e-6)
    # each tail begins at an observation that its own robot had in this iteration, not all at one row
    same = np.asarray((buffer.obs[:n] == buffer.obs[n]).all(-1))
    assert same.any(0).all() and len(set(np.argmax(same, 0).tolist())) > 2
    # and is what the new policy does in the model
    mean = networks.policy(static, learner.params, buffer.obs[n:])
    np.testing.assert_allclose(buffer.action_mean[n:], mean, 1e-4, 1e-4)
    obs, reward, _ = dynamics.predict(
        static, hyper, env, state.model, buffer.obs[n:], buffer.action[n:]
    )
    np.testing.assert_allclose(buffer.next_obs[n:], obs, 1e-4, 1e-4)
    np.testing.assert_allclose(buffer.reward[n:], reward, 1e-4, 1e-4)
    noise = ((buffer.action - buffer.action_mean) / learner.params["std"])[n:]
    assert (np.abs(noise - ((old.action - old.action_mean) / 1.0)[n:]) > 1e-3).all()
    # of which alone it learns
    rows = jax.tree.map(np.asarray, buffer)
    last = np.asarray(networks.value(static, learner.params, buffer.next_obs))
    gamma, lambda_ = hyper.ppo.gamma, hyper.ppo.lambda_
    found = advantages(rows, rows.value, last, gamma=gamma, lambda_=lambda_)
    weight = np.broadcast_to(np.arange(N)[:, None] >= n, (N, R))
    batch = ppo.Batch(
        obs=buffer.obs,
        action=buffer.action,
        action_mean=buffer.action_mean,
        log_prob=buffer.log_prob,
        value=buffer.value,
        advantages=jnp.asarray(found),
        returns=jnp.asarray(found + rows.value),
        weight=jnp.asarray(weight, jnp.float32),
    )
    now = jax.random.fold_in(state.key, 1)
    key = jax.random.fold_in(now, algorithm.UPDATE + algorithm.ANCHOR + 1)
    expected, told = jax.jit(partial(ppo.update, static, hyper))(learner, batch, key)
    assert_close(after.learner, expected, 1e-4)
    assert_close({name: metrics[name] for name in told}, told, 1e-4)
    assert metrics["kl"] != before["kl"]


def test_every_round_is_another(rounds):
    """Other anchors, other noise, and the learner goes on from the round before."""
    two, three = rounds(2), rounds(3)
    starts = [np.asarray(r[2].obs[5]) for r in (two, three)]
    assert (starts[0] != starts[1]).any()
    steps = [r[3].learner.params["std"] for r in (rounds(1), two, three)]
    assert len({tuple(np.asarray(s).tolist()) for s in steps}) == 3


def test_there_are_rounds_where_there_is_a_tail():
    """The schedule's column: one round without a tail, and no column without rounds."""
    fields = toy_env.TAIL | {"schedule.rounds": 3}
    table = schedule.columns(toy_env.settings(fields)[0])
    tails = N - table["n_real"]
    assert 0 in tails and tails.max() == 4
    np.testing.assert_array_equal(table["rounds"], np.where(tails > 0, 3, 1))
    assert "rounds" not in schedule.columns(toy_env.settings(toy_env.TAIL)[0])
    without = toy_env.settings({"schedule.rounds": 3})[0]
    assert "rounds" not in schedule.columns(without)


# ---- late iterations


def test_the_kl_target_is_multiplied_after_late_from_and_not_before(observed, tail, first):
    """`ppo.late_kl` is a factor of `desired_kl`: the learning rate goes where a target far away leads it."""
    config, _, hyper = tail
    state, rate = first(), hyper.ppo.learning_rate

    def learner(iteration, **fields):
        changed = hyper._replace(ppo=hyper.ppo._replace(**fields))
        return observed(changed, state, row(config, n_real=5, first=iteration))[1].learner

    for iteration in (1, LATE_FROM):
        assert_same(learner(iteration, late_kl=1e-6), learner(iteration))
    for iteration in (LATE_FROM + 1, LATE_FROM + 2):
        low, high = (learner(iteration, late_kl=factor) for factor in (1e-6, 1e6))
        assert low.learning_rate < rate / 3 and high.learning_rate > rate * 3
        for late, factor in ((low, 1e-6), (high, 1e6)):
            assert_same(late, learner(iteration, desired_kl=hyper.ppo.desired_kl * factor))


# ---- what is carried on


def test_physics_goes_on_from_its_own_last_step(run, run_plain, tail, plain, first):
    """After a tail, robots and finished episodes are as if physics had done N_r rows alone."""
    # six iterations of 5 real rows, with a policy that stays what it is
    rates = {"learning_rate": 0.0, "min_learning_rate": 0.0, "max_learning_rate": 0.0}

    def still(call, kind, settings, n_real):
        config, _, hyper = settings
        state = first(0, kind)
        learner = state.learner.replace(learning_rate=jnp.zeros(()))
        hyper = hyper._replace(ppo=hyper.ppo._replace(**rates))
        return call(hyper, state.replace(learner=learner), columns(config, n_real=n_real))

    after, metrics = still(run, "tail", tail, 5)
    alone, expected = still(run_plain, "plain", plain, 5)
    assert_close(after.env_state, alone.env_state, 1e-5)
    assert_close((after.returns, after.lengths), (alone.returns, alone.lengths), 1e-5)
    for name in ("falls", "timeouts", "reward_x", "velocity_error", "episode_return"):
        np.testing.assert_allclose(metrics[name], expected[name], 1e-5, 1e-5)
    longer, _ = still(run_plain, "plain", plain, N)
    assert np.abs(longer.env_state.obs - alone.env_state.obs).max() > 0.1


def test_without_tails_the_program_with_a_model_is_plain_ppo(run, run_plain, tail, plain, first):
    """N_s = 0 throughout: learner, robots and returns are those of the program without model.

    To rounding: means over rows have weights there, all of them 1.
    """
    with_model, metrics = run(tail[2], first(), columns(tail[0], n_real=N))
    without, expected = run_plain(plain[2], first(0, "plain"), columns(plain[0]))
    assert_close(with_model.replace(model=None), without, 1e-5)
    only = {"model_loss", "model_loss_before", "model_error_1", "model_error_4"}
    only |= {"tail_bias", "tail_falls"}
    assert set(metrics) - set(expected) == only
    assert_close({name: metrics[name] for name in expected}, expected, 1e-5)


def one_by_one(call, tail, state):
    """`(state, metrics of each iteration)` of a loop over single iterations by `call`."""
    config, _, hyper = tail
    cols, found = columns(config), []
    for i in range(ITERATIONS):
        _, state, last = call(hyper, state, {name: c[i] for name, c in cols.items()})
        found.append(last)
    return state, {name: np.stack([m[name] for m in found]) for name in found[0]}


def test_run_is_iterate_again_and_again(run, observed, tail, first):
    """A loop over single iterations: nothing is remembered elsewhere, chunks are one run.

    To rounding, which grows; the two programs compiled as users have them agree to the bit (slow).
    """
    config, _, hyper = tail
    assert_close(one_by_one(observed, tail, first()), run(hyper, first(), columns(config)), 1e-3)


@pytest.fixture(scope="module")
def run_as_users(env, tail):
    """`run(hyper, state, columns)` whose bits are those of other programs that are compiled alike."""
    step = partial(algorithm.run, env, static=tail[1])
    return jax.jit(step, compiler_options=AS_USERS)


@pytest.mark.slow
def test_run_is_iterate_again_and_again_to_the_bit(run_as_users, env, tail, first):
    config, static, hyper = tail
    call = observe(env, static, as_users=True)
    assert_same(one_by_one(call, tail, first()), run_as_users(hyper, first(), columns(config)))


def test_the_key_of_the_run_never_changes_and_iterations_differ(run, tail, first):
    """Randomness comes from the number of the iteration: another number, other actions."""
    config, _, hyper = tail
    state, metrics = run(hyper, first(), columns(config))
    assert_same((state.key, state.robot_index), (first().key, first().robot_index))
    _, later = run(hyper, first(), columns(config, first=101))
    assert metrics["reward_x"][0] != later["reward_x"][0]


# ---- the compiled program


def test_the_whole_ramp_is_traced_once(run, tail, first):
    """Every N_r, every number of epochs and every float share one trace and one program."""
    config, _, hyper = tail
    state = first()
    assert len(set(columns(config)["n_real"].tolist())) > 3
    for n_real, epochs in ((None, None), (N, 1), (5, 0)):
        state, _ = run(hyper, state, columns(config, n_real=n_real, epochs=epochs))
    warmer = hyper._replace(ppo=hyper.ppo._replace(clip_epsilon=0.1))
    run(warmer, first(5), columns(config))
    with pytest.raises(AssertionError, match="traced"):  # a chunk of another length: a new program
        run(hyper, state, {name: c[:1] for name, c in columns(config).items()})


def loops_over_rows(env, static, hyper, seeds, cols):
    """Shapes of the predicates of all `while` loops under vmap over seeds, and of fill's only."""
    keys = jax.random.split(jax.random.key(0), seeds)
    init = jax.vmap(partial(algorithm.init, env, static=static), (None, 0))
    states = jax.eval_shape(init, hyper, keys)
    run = jax.vmap(partial(algorithm.run, env, static=static), (None, 0, None))
    program = jax.make_jaxpr(run)(hyper, states, cols).jaxpr
    loops = [e for e in inner(program) if e.primitive.name == "while"]
    fill = [e for e in loops if (seeds, N, R) in {v.aval.shape[:-1] for v in e.outvars}]
    return [[e.params["cond_jaxpr"].out_avals[0].shape for e in some] for some in (loops, fill)]


def test_under_vmap_over_seeds_the_trip_counts_stay_scalars(env, tail, plain):
    """No predicate is batched, so no seed pays for rows that its loop does not run."""
    every, fill = loops_over_rows(env, *tail[1:], 3, columns(tail[0]))
    assert fill == [(), ()] and set(every) == {()}
    every, fill = loops_over_rows(env, *plain[1:], 3, columns(plain[0]))
    assert fill == [()] and set(every) == {()}


def widths(env, static, hyper, cols):
    """All sizes of all operands of matrix products in the program of `run`."""
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    program = jax.make_jaxpr(partial(algorithm.run, env, static=static))(hyper, state, cols)
    dots = [e for e in inner(program.jaxpr) if e.primitive.name == "dot_general"]
    return {size for e in dots for v in e.invars for size in v.aval.shape}


def test_plain_ppo_has_no_model_in_its_program(env, tail, plain):
    """No matrix product is as wide as the model's layers; with a tail there are some."""
    width = 24
    assert tail[1].model.hidden == plain[1].model.hidden == (width, width)
    assert width in widths(env, *tail[1:], columns(tail[0]))
    assert width not in widths(env, *plain[1:], columns(plain[0]))


def test_an_iteration_calls_nothing_on_the_host(env, tail, run, first):
    """No callback is in the program, and no array crosses to or from the device in a call."""
    config, static, hyper = tail
    state, cols = first(), columns(config)
    program = jax.make_jaxpr(partial(algorithm.run, env, static=static))(hyper, state, cols)
    names = {e.primitive.name for e in inner(program.jaxpr)}
    assert "while" in names and not [n for n in names if "callback" in n or "feed" in n]
    hyper = jax.tree.map(jnp.asarray, hyper)
    run(hyper, state, cols)
    with jax.transfer_guard("disallow"):
        after, _ = jax.block_until_ready(run(hyper, state, cols))
        with pytest.raises(Exception, match="host-to-device"):
            run(hyper, state, schedule.columns(config))


def test_a_state_can_be_donated(run_plain, plain, first):
    """The trainer hands its state over: the old one is gone, the new one can be handed over."""
    state = first(0, "plain")
    after, _ = run_plain(plain[2], state, columns(plain[0]))
    gone = leaves_deleted(state)
    assert gone["learner"] and gone["env_state"] and gone["returns"]
    again, _ = run_plain(plain[2], after, columns(plain[0], first=7))
    assert np.isfinite(again.learner.params["std"]).all()


def leaves_deleted(state):
    """`{field: whether all its arrays are deleted}` of a TrainState."""
    parts = {name: jax.tree.leaves(value) for name, value in vars(state).items()}
    return {name: all(x.is_deleted() for x in part) for name, part in parts.items()}


# ---- episodes that ended


def test_the_mean_return_is_over_the_episodes_that_ended(iterated):
    """`episode_return` and `episode_length` of an iteration, against the rollout's real rows."""
    for n in (N, 5):
        buffer, _, metrics = iterated[n]
        rows = jax.tree.map(lambda x, n=n: np.asarray(x)[:n], buffer)
        ended = (rows.discount == 0) | (rows.truncation == 1)
        assert 0 < ended.sum() <= 100
        mean = rows.episode_return[ended].mean()
        np.testing.assert_allclose(metrics["episode_return"], mean, 1e-5, 1e-6)
        mean = rows.episode_length[ended].mean()
        np.testing.assert_allclose(metrics["episode_length"], mean, 1e-5)


def test_no_return_before_the_first_episode_ends(observed, tail, first):
    """The mean of an empty ring is NaN, which the log leaves empty, not 0."""
    config, _, hyper = tail
    state = first()
    young = state.env_state.replace(clock=jnp.zeros_like(state.env_state.clock))
    _, _, metrics = observed(hyper, state.replace(env_state=young), row(config, n_real=1))
    assert np.isnan(metrics["episode_return"]) and np.isnan(metrics["episode_length"])
    assert all(np.isfinite(v) for n, v in metrics.items() if not n.startswith("episode_"))


def test_metrics_describe_the_real_rows(observed, tail, first):
    """Means a row and robot, roots of mean squares, counts of events; rows of the tail do not count."""
    config, _, hyper = tail
    noiseless = hyper.task._replace(noise=hyper.task.noise._replace(joint_pos=0.0))
    for n in (N, 5):
        buffer, _, metrics = observed(
            hyper._replace(task=noiseless), first(), row(config, n_real=n)
        )
        rows = jax.tree.map(lambda x, n=n: np.asarray(x)[:n], buffer)
        error = (rows.next_obs[..., 0] - rows.next_obs[..., 3]) ** 2
        effort = -0.01 * (rows.action**2).sum(-1)
        np.testing.assert_allclose(metrics["velocity_error"], np.sqrt(error.mean()), 1e-5)
        np.testing.assert_allclose(metrics["reward_x"], (1 - error).mean(), 1e-5)
        np.testing.assert_allclose(metrics["reward_effort"], effort.mean(), 1e-5)
        assert metrics["falls"] == (rows.discount == 0).sum()
        assert metrics["timeouts"] == (rows.truncation == 1).sum() > 0
        assert metrics["blowups"] == 0


# ---- robots whose physics diverges


def test_a_blown_up_robot_enters_neither_model_nor_policy(observed, tail, first):
    """States of NaN in every iteration: they are counted, and every number elsewhere is finite."""
    config, _, hyper = tail
    wild = hyper._replace(task=hyper.task._replace(effort_limit=1.2))
    buffer, state, metrics = observed(wild, first(), row(config, n_real=5))
    assert metrics["blowups"] > 3
    rows = jax.tree.map(np.asarray, buffer)
    blown = rows.action[:5, :, 0] > 1.2
    assert blown.sum() == metrics["blowups"]
    np.testing.assert_array_equal(rows.reward[:5][blown], 0)
    np.testing.assert_array_equal(rows.discount[:5][blown], 0)
    np.testing.assert_array_equal(rows.next_obs[:5][blown], rows.obs[:5][blown])
    # the last real row blew some up: their state is a new episode's
    assert blown[4].any()
    for name, x in leaves((buffer, state.replace(returns=0, lengths=0), metrics)).items():
        assert np.isfinite(x).all(), name
    kept = (rows.discount == 1) & (rows.truncation == 0) & (np.arange(N) < 5)[:, None]
    mean, _ = moments.scale(state.model.inputs)
    np.testing.assert_allclose(mean[:6], rows.obs[kept].mean(0), 1e-4, 1e-4)


# ---- learning


def returns_over(run, config, hyper, state, rounds):
    """Mean return after each of `rounds` calls of `run`, the schedule going on."""
    out = []
    for i in range(rounds):
        n_real = None if i == 0 else int(schedule.columns(config)["n_real"][-1])
        state, metrics = run(hyper, state, columns(config, n_real=n_real, first=1 + i * ITERATIONS))
        out.append(float(metrics["episode_return"][-1]))
    return np.array(out), metrics


def test_plain_ppo_learns(run_plain, plain, first):
    """The toy robot's return rises from below 1 to above 1.6, of at most 2, in 96 iterations."""
    returns, metrics = returns_over(run_plain, plain[0], plain[2], first(0, "plain"), 16)
    assert returns[0] < 1 and returns[-1] > 1.6
    assert metrics["velocity_error"][-1] < 0.4


def test_ppo_with_synthetic_tails_learns(run, tail, first):
    """The same with half of the rows from the model, which learns too."""
    returns, metrics = returns_over(run, tail[0], tail[2], first(), 16)
    assert returns[0] < 1 and returns[-1] > 1.6
    assert metrics["velocity_error"][-1] < 0.4
    assert metrics["model_loss"][-1] < 0.15


GAMMA = 0.5
PROBES = {
    "constant": toy_env.Case(each=1.0),
    "observed": toy_env.Case(random=1.0, gain=1.0),
    "discounted": toy_env.Case(steps=2, time=1.0, ending=1.0),
    "falls": toy_env.Case(steps=3, time=1.0, each=1.0),
    "time_limit": toy_env.Case(steps=3, timeout=1.0, random=1.0, gain=1.0),
    "action": toy_env.Case(cost=1.0, aim=0.5),
    "follow": toy_env.Case(random=1.0, cost=1.0, follow=0.5),
}


@pytest.fixture(scope="module")
def probes():
    """`probes(name, obs) -> (value, mean action)` after training on all probes at once."""
    config, static, hyper = toy_env.settings(
        {
            "run.num_iterations": 150,
            "rollout.num_envs": 32,
            "ppo.gamma": GAMMA,
            "ppo.learning_rate": 3e-3,
            "ppo.adaptive": False,
            "ppo.entropy_coef": 0.0,
        }
    )
    cases = jax.tree.map(lambda *x: jnp.asarray(x), *PROBES.values())
    env = toy_env.probe()
    axes = type(hyper)(**{name: 0 if name == "task" else None for name in hyper._fields})

    def train(hyper):
        state = algorithm.init(env, hyper, jax.random.key(0), static=static)
        return algorithm.run(env, hyper, state, schedule.columns(config), static=static)[0]

    state = jax.jit(jax.vmap(train, (axes,)))(hyper._replace(task=cases))

    def answer(name, obs):
        params = jax.tree.map(lambda x: x[list(PROBES).index(name)], state.learner.params)
        obs = jnp.asarray([obs])
        return (
            float(networks.value(static, params, obs)),
            float(networks.policy(static, params, obs)[0]),
        )

    return answer


@pytest.mark.parametrize(
    "name, obs, value",
    [
        ("constant", 0.0, 1.0),
        ("observed", 1.0, 1.0),
        ("observed", -1.0, -1.0),
        ("discounted", 0.0, GAMMA),
        ("discounted", 1.0, 1.0),
        ("falls", 0.0, 1 + GAMMA + GAMMA**2),
        ("falls", 2.0, 1.0),
        ("time_limit", 1.0, 1 / (1 - GAMMA)),
        ("time_limit", -1.0, -1 / (1 - GAMMA)),
    ],
)
def test_values_that_are_known_are_learned(probes, name, obs, value):
    """Constant and observed rewards, the discount, falls that end for good, limits that do not."""
    assert probes(name, obs)[0] == pytest.approx(value, abs=0.1)


@pytest.mark.parametrize(
    "name, obs, action", [("action", 0.0, 0.5), ("follow", 1.0, 0.5), ("follow", -1.0, -0.5)]
)
def test_actions_that_are_best_are_learned(probes, name, obs, action):
    """An action that pays, and one whose sign the observation tells."""
    assert probes(name, obs)[1] == pytest.approx(action, abs=0.15)

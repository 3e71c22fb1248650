"""One iteration and the loop of them: anchoring, the seam, the compiled program, and learning."""

from collections import deque
from functools import partial
from types import SimpleNamespace

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from jax.extend import core as jax_core

from dynappo import algorithm, rollout, schedule, stats, sweep, train
from dynappo.learner import networks, ppo
from dynappo.model import dynamics, moments
from dynappo.types import Transition

N, R, ITERATIONS = 8, 16, 6
FIELDS = len(Transition.__dataclass_fields__)


@pytest.fixture(scope="module")
def env():
    """The toy environment with noise, aged starts, falls and time limits."""
    return toy_env.make()


@pytest.fixture(scope="module")
def tail():
    """`(config, static, hyper)` with a ramp to 4 of 8 rows by the model."""
    return toy_env.settings(toy_env.TAIL)


@pytest.fixture(scope="module")
def plain():
    """`(config, static, hyper)` of plain PPO, otherwise the same."""
    return toy_env.settings()


def columns(config, n_real=None, epochs=None, first=1):
    """The schedule on the device; `n_real` and `epochs` replace it, `first` is the iteration."""
    out = schedule.columns(config)
    out["iteration"] = out["iteration"] + np.int32(first - 1)
    if n_real is not None:
        out["n_real"] = np.broadcast_to(np.int32(n_real), out["n_real"].shape)
    if epochs is not None:
        out["model_epochs"] = np.broadcast_to(np.int32(epochs), out["n_real"].shape)
    return {name: jnp.asarray(column, jnp.int32) for name, column in out.items()}


def row(config, **kwargs):
    """The first row of `columns`."""
    return {name: column[0] for name, column in columns(config, **kwargs).items()}


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


def leaves(tree):
    """`{path: NumPy array}` of a pytree; keys as their data."""
    out = {}
    for path, x in jax.tree.leaves_with_path(tree):
        is_key = hasattr(x, "dtype") and jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)
        out[jax.tree_util.keystr(path)] = np.asarray(jax.random.key_data(x) if is_key else x)
    return out


def assert_same(one, other):
    """Two pytrees are equal to the bit; NaN equals NaN."""
    one, other = leaves(one), leaves(other)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)


def assert_close(one, other, tolerance):
    """Two pytrees agree within `tolerance`, relative or absolute."""
    one, other = leaves(one), leaves(other)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], tolerance, tolerance, err_msg=name)


def inner(jaxpr):
    """Every equation of a jaxpr, those of its loops and branches included."""
    for equation in jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            for part in value if isinstance(value, (tuple, list)) else (value,):
                part = getattr(part, "jaxpr", part)
                if hasattr(part, "eqns"):
                    yield from inner(part)


def carries_a_rollout(equation, seeds=()):
    """Whether an equation is a `while` over the rollout buffer: the loop of `rollout.fill`."""
    shapes = [v.aval.shape for v in equation.outvars]
    return equation.primitive.name == "while" and shapes.count((*seeds, N, R, 6)) >= 2


def observe(env, static):
    """`f(hyper, state, row) -> (rollout, state, metrics)`: `iterate`, and the rollout inside it.

    The rollout is what the last loop of `rollout.fill` leaves in the program of `iterate`: the
    program itself is asked for it.
    """

    def call(hyper, state, row):
        closed, shape = jax.make_jaxpr(
            partial(algorithm.iterate, env, static=static), return_shape=True
        )(hyper, state, row)
        program = closed.jaxpr
        carried = [e for e in program.eqns if carries_a_rollout(e)][-1].outvars
        begin = [v.aval.shape for v in carried].index((N, R, 6))
        program = program.replace(
            outvars=[*carried[begin : begin + FIELDS], *program.outvars],
            debug_info=program.debug_info.with_unknown_names(),
        )
        out = jax_core.jaxpr_as_fun(closed.replace(jaxpr=program))(
            *jax.tree.leaves((hyper, state, row))
        )
        return Transition(*out[:FIELDS]), *jax.tree.unflatten(
            jax.tree.structure(shape), out[FIELDS:]
        )

    return jax.jit(call)


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
    """Rows of the model have discount 1, truncation 0, and copy command and action exactly."""
    buffer = jax.tree.map(np.asarray, iterated[3][0])
    np.testing.assert_array_equal(buffer.discount[3:], 1)
    np.testing.assert_array_equal(buffer.truncation[3:], 0)
    np.testing.assert_array_equal(buffer.next_obs[3:, :, 3], buffer.obs[3:, :, 3])
    np.testing.assert_array_equal(buffer.next_obs[3:, :, 4:], buffer.action[3:])
    assert (buffer.next_obs[3:, :, :3] != buffer.obs[3:, :, :3]).all()


def test_every_row_holds_what_the_policy_of_this_iteration_did(iterated, tail, first):
    """Mean, value and log probability of all rows, against NumPy on the recorded actions."""
    static, params = tail[1].ppo, first().learner.params
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
    static = tail[1].model
    for n in (5, 3):
        buffer, state, _ = iterated[n]
        obs, reward, _ = dynamics.predict(
            static, env, state.model, buffer.obs[n:], buffer.action[n:]
        )
        np.testing.assert_allclose(buffer.next_obs[n:], obs, 1e-5, 1e-5)
        np.testing.assert_allclose(buffer.reward[n:], reward, 1e-5, 1e-5)


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
    static, hyper = tail[1].model, tail[2].model
    fit = jax.jit(partial(dynamics.fit, static, hyper, env))
    key = jax.random.fold_in(jax.random.fold_in(first().key, 1), algorithm.FIT)
    for n in (N, 5):
        buffer, state, metrics = iterated[n]
        real = (jnp.arange(N) < n)[:, None]

        def keep(x, real=real):
            return jnp.where(real.reshape(N, 1, *[1] * (x.ndim - 2)), x, 1e3)

        rows = jax.tree.map(keep, buffer)
        expected, losses = fit(first().model, rows, n, static.epochs, key)
        assert_close(state.model, expected, 1e-5)
        assert_close({name: metrics[name] for name in losses}, losses, 1e-5)


def test_the_policy_learns_from_real_and_synthetic_rows_alike(iterated, tail, first):
    """The new learner is PPO's update with advantages that a NumPy loop computes of all rows."""
    # next value: V(next_obs) at a time limit and in the last row, the next row's value elsewhere
    config, static, hyper = tail
    learner = first().learner
    for n in (N, 5):
        buffer, state, _ = iterated[n]
        rows = jax.tree.map(np.asarray, buffer)
        last = np.asarray(networks.value(static.ppo, learner.params, buffer.next_obs))
        advantages, later = np.zeros((N, R)), np.zeros(R)
        for t in reversed(range(N)):
            for r in range(R):
                cut = rows.truncation[t, r] == 1
                after = last[t, r] if cut or t == N - 1 else rows.value[t + 1, r]
                alive = rows.discount[t, r] * hyper.ppo.gamma
                delta = rows.reward[t, r] + alive * after - rows.value[t, r]
                later[r] = delta + alive * hyper.ppo.lambda_ * (not cut) * later[r]
            advantages[t] = later
        batch = ppo.Batch(
            obs=buffer.obs,
            action=buffer.action,
            action_mean=buffer.action_mean,
            log_prob=buffer.log_prob,
            value=buffer.value,
            advantages=jnp.asarray(advantages, jnp.float32),
            returns=jnp.asarray(advantages + rows.value, jnp.float32),
        )
        key = jax.random.fold_in(jax.random.fold_in(first().key, 1), algorithm.UPDATE)
        update = jax.jit(partial(ppo.update, static.ppo, hyper.ppo))
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
    call = observe(toy_env.like_model(static.model, state.model), static)
    (real, one, _), (short, other, _) = (
        call(hyper, state, row(config, n_real=n, epochs=0)) for n in (N, N - 4)
    )
    assert_close(real, short, 1e-5)
    assert_close(one.learner, other.learner, 1e-4)
    assert_same(one.model.params, state.model.params)
    elsewhere = [iterated[n][0].next_obs[-3:] for n in (N, N - 3)]
    assert np.abs(elsewhere[0] - elsewhere[1]).max() > 0.1


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


def test_two_chunks_are_one_run(run, env, tail, first):
    """Three iterations and three more leave the bits of six: nothing is remembered elsewhere."""
    config, static, hyper = tail
    cols = columns(config)
    chunk = jax.jit(partial(algorithm.run, env, static=static))
    whole, metrics = run(hyper, first(), cols)
    half, early = chunk(hyper, first(), {name: c[:3] for name, c in cols.items()})
    end, late = chunk(hyper, half, {name: c[3:] for name, c in cols.items()})
    assert_same(whole, end)
    assert_same(metrics, jax.tree.map(lambda a, b: jnp.concatenate([a, b]), early, late))


def test_run_is_iterate_again_and_again(run, observed, tail, first):
    """The same numbers as a Python loop over single iterations, and always the same metrics."""
    config, _, hyper = tail
    cols = columns(config)
    after, metrics = run(hyper, first(), cols)
    state = first()
    for i in range(ITERATIONS):
        _, state, last = observed(hyper, state, {name: c[i] for name, c in cols.items()})
        assert set(last) == set(metrics)
        for name, value in last.items():
            np.testing.assert_allclose(metrics[name][i], value, 1e-4, 1e-4, err_msg=name)
    assert_close(state, after, 1e-4)


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


def loops_over_rows(env, static, hyper, seeds, cols, axes):
    """Shapes of the predicates of all `while` loops under vmap over seeds, and of fill's only."""
    keys = jax.random.split(jax.random.key(0), seeds)
    init = jax.vmap(partial(algorithm.init, env, static=static), (None, 0))
    states = jax.eval_shape(init, hyper, keys)
    run = jax.vmap(partial(algorithm.run, env, static=static), (None, 0, axes))
    program = jax.make_jaxpr(run)(hyper, states, cols).jaxpr
    loops = [e for e in inner(program) if e.primitive.name == "while"]
    fill = [e for e in loops if carries_a_rollout(e, (seeds,))]
    return [[e.params["cond_jaxpr"].out_avals[0].shape for e in some] for some in (loops, fill)]


def test_under_vmap_over_seeds_the_trip_counts_stay_scalars(env, tail, plain):
    """No predicate is batched, so no seed pays for rows that its loop does not run."""
    every, fill = loops_over_rows(env, *tail[1:], 3, columns(tail[0]), None)
    assert fill == [(), ()] and set(every) == {()}
    every, fill = loops_over_rows(env, *plain[1:], 3, columns(plain[0]), None)
    assert fill == [()] and set(every) == {()}


def test_a_column_with_a_seed_axis_would_batch_the_loops(env, tail):
    """What the test above would see if the number of real rows were part of a seed's state."""
    cols = columns(tail[0])
    cols["n_real"] = jnp.stack([cols["n_real"]] * 3)
    axes = dict.fromkeys(cols, None) | {"n_real": 0}
    _, fill = loops_over_rows(env, *tail[1:], 3, cols, axes)
    assert fill == [(3,), (3,)]


def test_seeds_together_are_the_seeds_alone(run, env, tail, first):
    """Two seeds under vmap agree with each alone to 1e-5 over six iterations, in every leaf."""
    config, static, hyper = tail
    cols = columns(config)
    states = [first(seed) for seed in (0, 7)]
    together = jax.jit(jax.vmap(partial(algorithm.run, env, static=static), (None, 0, None)))
    after, metrics = together(hyper, jax.tree.map(lambda *x: jnp.stack(x), *states), cols)
    for i, state in enumerate(states):
        alone, expected = run(hyper, state, cols)
        assert_close(jax.tree.map(lambda x, i=i: x[i], after), alone, 1e-5)
        assert_close(jax.tree.map(lambda x, i=i: x[i], metrics), expected, 1e-5)


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


def reference_rings(discount, truncation, values, n_real, history):
    """The last 100 of `history` and of what ended in rows t < n_real, row by row."""
    ring = deque(history, maxlen=100)
    for t in range(n_real):
        for r in range(discount.shape[1]):
            if discount[t, r] == 0 or truncation[t, r] == 1:
                ring.append(values[t, r])
    return [np.nan] * (100 - len(ring)) + list(ring)


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.5, 1.0])
def test_the_rings_are_those_of_a_deque(env, rate):
    """Over many rollouts with random ends: order, overflow in one call, rows of the tail ignored."""
    rng = np.random.default_rng(round(100 * rate))
    blank = rollout.allocate(env, N, 40)

    @jax.jit
    def push(returns, lengths, buffer, n_real):
        state = SimpleNamespace(returns=returns, lengths=lengths)
        return stats.finished(state, buffer, n_real)

    returns = lengths = jnp.full(100, jnp.nan)
    expected_returns, expected_lengths, most = [], [], 0
    for n_real in (N, 3, 0, 5, N):
        end = rng.random((N, 40)) < rate
        fall = rng.random((N, 40)) < 0.5
        columns = {
            "discount": 1.0 - (end & fall),
            "truncation": 1.0 * (end & ~fall),
            "episode_return": rng.normal(size=(N, 40)).astype(np.float32),
            "episode_length": rng.integers(1, 1000, (N, 40)).astype(np.float32),
        }
        buffer = blank.replace(**{n: jnp.asarray(x, jnp.float32) for n, x in columns.items()})
        returns, lengths = push(returns, lengths, buffer, n_real)
        ends = columns["discount"], columns["truncation"]
        args = [x for x in expected_returns if x == x]
        expected_returns = reference_rings(*ends, columns["episode_return"], n_real, args)
        args = [x for x in expected_lengths if x == x]
        expected_lengths = reference_rings(*ends, columns["episode_length"], n_real, args)
        np.testing.assert_array_equal(returns, np.float32(expected_returns))
        np.testing.assert_array_equal(lengths, np.float32(expected_lengths))
        most = max(most, end[:n_real].sum())
    assert most > 100 or rate < 0.4


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


def test_summaries_are_means_roots_and_counts():
    """Sums over 8 rows: a term, a squared error, an event."""
    sums = {"reward_x": 4.0, "yaw_error_sq": 72.0, "falls": 3.0, "timeouts": 2.0, "blowups": 1.0}
    out = stats.of_rows({n: jnp.asarray(v) for n, v in sums.items()}, 8)
    expected = {"reward_x": 0.5, "yaw_error": 3.0, "falls": 3.0, "timeouts": 2.0, "blowups": 1.0}
    assert {n: float(v) for n, v in out.items()} == expected


# ---- robots whose physics diverges


def test_a_blown_up_robot_enters_neither_model_nor_policy(tail, first):
    """States of NaN in every iteration: they are counted, and every number elsewhere is finite."""
    config, static, hyper = tail
    wild = toy_env.make(blowup_action=1.2)
    buffer, state, metrics = observe(wild, static)(hyper, first(), row(config, n_real=5))
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
            float(networks.value(static.ppo, params, obs)),
            float(networks.policy(static.ppo, params, obs)[0]),
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


# ---- a ramp by the model's error


@pytest.mark.parametrize("steps", [0, 1, 4, 16])
def test_a_tail_is_as_long_as_the_models_error_admits(steps):
    """floor(steps min(1, max_error / error)); none where nothing is known of the model yet."""
    _, static, hyper = toy_env.settings({"schedule.max_error": 0.25})
    for error in (0.1, 0.25, 0.26, 0.4, 0.5, 1.0, 7.0, np.inf):
        model = SimpleNamespace(error=jnp.float32(error))
        found = algorithm.trusted(static, hyper.schedule, model, jnp.int32(steps))
        assert found == int(np.floor(steps * min(1.0, 0.25 / error) + 1e-4))


def test_a_ramp_by_error_is_one_for_all_seeds_and_counted_as_it_was(env):
    """Against the errors that the metrics tell: those of an iteration shorten the next one's tail."""
    on = {"schedule.by_error": True, "schedule.max_error": 0.3, "run.num_seeds": 3}
    steps = {"schedule.start_steps": 4, "schedule.end_iteration": 0, "schedule.start_iteration": 0}
    config, static, hyper = toy_env.settings(toy_env.TAIL | steps | on | {"run.num_iterations": 12})
    state = sweep.init(env, hyper, sweep.keys(0, 3), static=static)
    call = jax.jit(partial(sweep.run, env, static=static))
    state, metrics = call(hyper, state, columns(config, epochs=10))
    n_real, errors = np.asarray(metrics["n_real"]), np.asarray(metrics["model_error_4"]).max(1)
    assert (n_real == n_real[:, :1]).all()  # [I, S]
    assert n_real[0, 0] == N and len(np.unique(n_real)) > 2
    expected = N - np.floor(4 * np.minimum(1, 0.3 / errors[:-1]) + 1e-4)
    np.testing.assert_array_equal(n_real[1:, 0], expected)
    np.testing.assert_allclose(state.model.error, metrics["model_error_4"][-1], 1e-6)
    shared = train._shared(config, schedule.columns(config), metrics, 1000)
    np.testing.assert_array_equal(shared["n_real"] + shared["n_synthetic"], N)
    counted = 1000 + np.cumsum([R * n for n in n_real[:, 0]])
    np.testing.assert_array_equal(shared["sim_steps"], counted)


def test_a_loop_over_seeds_keeps_one_bound_with_a_ramp_by_error(env):
    """Under vmap the trip count of the physics loop has no seed axis."""
    on = {"schedule.by_error": True, "run.num_seeds": 2}
    config, static, hyper = toy_env.settings(toy_env.TAIL | on)
    state = jax.eval_shape(partial(sweep.init, env, static=static), hyper, sweep.keys(0, 2))
    jaxpr = jax.make_jaxpr(partial(sweep.run, env, static=static))(hyper, state, columns(config))
    loops = [e for e in inner(jaxpr.jaxpr) if e.primitive.name == "while"]
    assert loops
    for loop in loops:
        (test,) = loop.params["cond_jaxpr"].jaxpr.outvars
        assert test.aval.shape == ()

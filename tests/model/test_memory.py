"""A memory of real rows: what is kept, what the fit draws of it, where tails begin, whose they are."""

from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from jax.sharding import PartitionSpec
from toy_runs import N, R, assert_close, assert_same, columns, leaves, observe, row

from dynappo import algorithm, fast, schedule, seeds
from dynappo.learner import symmetry
from dynappo.model import dynamics, examples, memory
from dynappo.types import Mirror

M, MANY = 13, 3  # rows that are kept: no multiple of an iteration's; imagined robots for a real one
KEPT = {"schedule.rounds": 2, "model.memory": M, "model.remembered": 2, "schedule.anchors": 6}
CLEAN = {"model.clean": True, "model.falls": True, "model.known_reward": True}
FEW = toy_env.TAIL | KEPT | CLEAN


def settings(fields=None):
    """`(config, static, hyper)` of the toy with a memory, clean states and `fields`."""
    return toy_env.settings(FEW | (fields or {}))


@pytest.fixture(scope="module")
def env():
    return toy_env.make()


@pytest.fixture(scope="module")
def history(env):
    """`[(rollout, state, metrics)]` of six iterations with a memory, and the setting."""
    config, static, hyper = settings()
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    call, table, out = observe(env, static), columns(config), []
    for i in range(len(table["iteration"])):
        rows, state, metrics = call(hyper, state, {n: c[i] for n, c in table.items()})
        out.append(jax.device_get((rows, state, metrics)))
    return config, static, hyper, out


# ---- the ring


def test_the_memory_holds_the_newest_rows_of_each_robot_in_turn(history, env):
    """Against a list to which every iteration appends its real rows, as the model learned from them."""
    config, static, hyper, out = history
    learned_of = jax.jit(partial(examples.examples, static, hyper, env))
    xs, ys, weights, obs, props = [], [], [], [], []
    for n, (rows, state, _) in zip(schedule.columns(config)["n_real"], out, strict=True):
        kept = jax.device_get(learned_of(rows, jnp.int32(n)))
        for list_, array in zip(
            (xs, ys, weights, obs, props),
            (kept.x, kept.y, kept.weight, rows.obs, rows.prop),
            strict=True,
        ):
            list_.extend(np.asarray(array[:n]))
        total = len(xs)
        for t in range(max(0, total - M), total):
            ring = state.memory
            np.testing.assert_allclose(ring.x[t % M], xs[t], 1e-5, 1e-6)
            np.testing.assert_allclose(ring.y[t % M], ys[t], 1e-4, 1e-4)
            np.testing.assert_array_equal(ring.weight[t % M], weights[t])
            np.testing.assert_array_equal(ring.obs[t % M], obs[t])
            np.testing.assert_array_equal(ring.prop[t % M], props[t])
        if total < M:
            assert not state.memory.weight[total:].any()
    assert total > 2 * M  # it has begun anew


def test_the_schedule_says_where_the_ring_begins_and_how_full_it_is():
    """Against a count in Python, also where it is larger than 32 bits: 10 billion rows."""
    config = settings({"run.num_iterations": 9, "run.log_every": 9})[0]
    table, before = schedule.columns(config), 0
    for i, n in enumerate(table["n_real"].tolist()):
        assert table["memory_begin"][i] == before % M
        before += n
        assert table["memory_count"][i] == min(before, M)
    assert "memory_begin" not in schedule.columns(toy_env.settings(toy_env.TAIL)[0])
    long = {"run.num_iterations": 1_000_000, "run.log_every": 1, "rollout.horizon": 10_000}
    long |= {"model.memory": 10_007, "schedule.end_steps": 1, "schedule.end_iteration": 1}
    last = {name: int(column[-1]) for name, column in schedule.columns(settings(long)[0]).items()}
    assert last["n_real"] == 9999 and last["memory_count"] == 10_007
    assert last["memory_begin"] == 9999 * 999_999 % 10_007


@pytest.mark.parametrize("fields", [{"schedule.end_steps": 0}, {"model.memory": 0}])
def test_without_a_tail_or_a_memory_there_is_no_ring(env, fields):
    off = {"model.remembered": 0, "schedule.anchors": 0} | fields
    config, static, hyper = settings(off) if "model.memory" in fields else settings(fields)
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    assert state.memory is None and "memory_begin" not in schedule.columns(config)


# ---- what is drawn of it


def ring(count):
    """A memory whose every row says which it is: 100 t + robot."""
    says = 100.0 * jnp.arange(M)[:, None] + jnp.arange(R)
    wide = jnp.repeat(says[..., None], 8, -1)
    of = memory.Memory(x=wide, y=wide[..., :4], weight=says, obs=wide[..., :6], prop=wide[..., :3])
    return of, {name: jnp.int32(x) for name, x in count.items()}


def test_remembered_rows_are_drawn_of_all_that_is_there_each_robots_its_own():
    of, counts = ring({"memory_count": 5})
    drawn = memory.draw(of, counts, jax.random.key(0), rows=400)
    t, robot = np.divmod(np.asarray(drawn.weight), 100)
    np.testing.assert_array_equal(robot, np.broadcast_to(np.arange(R), robot.shape))
    share = np.bincount(t.astype(int).ravel(), minlength=M) / t.size
    np.testing.assert_allclose(share[:5], 0.2, atol=0.03)
    assert not share[5:].any()
    assert (drawn.x == drawn.weight[..., None]).all() and (drawn.y == drawn.x[..., :4]).all()


@pytest.mark.parametrize(
    ("begin", "n", "count", "anchors", "expected"),
    [
        (0, 4, 4, 6, {0, 1, 2, 3}),  # a ring that is hardly begun
        (4, 4, 8, 6, {2, 3, 4, 5, 6, 7}),  # the newest six
        (11, 4, M, 6, {9, 10, 11, 12, 0, 1}),  # round the end
        (11, 4, M, M, set(range(M))),
    ],
)
def test_tails_begin_in_the_newest_rows_of_their_own_robot(begin, n, count, anchors, expected):
    _, static, _ = settings({"schedule.anchors": anchors, "rollout.imagined": MANY})
    of, counts = ring({"memory_begin": begin, "n_real": n, "memory_count": count})
    starts = memory.anchors(static, of, counts, jax.random.key(1))
    many = [memory.anchors(static, of, counts, jax.random.key(k)).obs[:, 0] for k in range(40)]
    t, robot = np.divmod(np.asarray(many), 100)
    np.testing.assert_array_equal(robot, np.broadcast_to(np.repeat(np.arange(R), MANY), t.shape))
    assert set(t.ravel().astype(int).tolist()) == expected
    assert starts.obs.shape == (R * MANY, 6) and (starts.prop == starts.obs[:, :3]).all()


def test_a_fit_takes_remembered_rows_beside_each_new_one(env):
    """One step on two of a robot's rows: the loss is the mean over them and four of the ring."""
    _, static, hyper = settings({"model.memory": M, "model.epochs": 1})
    rng = np.random.default_rng(0)

    def some(length):
        return examples.Examples(
            x=rng.normal(size=(length, R, 8)).astype(np.float32),
            y=rng.random((length, R, 5)).astype(np.float32),
            weight=np.ones((length, R), np.float32),
            count=np.int32(2),
        )

    new, old, asked = some(N), some(2), []
    model = jax.jit(partial(dynamics.init, static, env))(jax.random.key(0))
    size = N // static.model.minibatches
    new = new._replace(count=jnp.int32(size))

    def draw(weight, key, n):
        asked.append(n)
        x, y, ones = (jnp.concatenate([a] * (n // 2)) for a in old[:3])
        return examples.Examples(x=x, y=y, weight=weight * ones, count=jnp.int32(n))

    @jax.jit
    def mean_loss(after, rows):
        x, y = dynamics.scaled(static, after, rows)
        weight = jnp.ones(x.shape[:2])
        return dynamics.loss(static, hyper, model.params, x=x, y=y, weight=weight)

    given = model, new, jnp.int32(1), jax.random.key(0)
    for fit in (dynamics.fit, fast.fit):
        run = jax.jit(lambda w, fit=fit: fit(static, hyper, *given, draw=partial(draw, w)))
        for weight, share in ((1.0, 2.0), (0.0, 0.0)):  # remembered rows for each new one
            after, found = run(weight)
            of_new = mean_loss(after, new._replace(x=new.x[:size], y=new.y[:size]))
            expected = (of_new + share * mean_loss(after, old)) / (1 + share)
            np.testing.assert_allclose(found["model_loss"], expected, rtol=1e-5)
    assert set(asked) == {2 * size}


# ---- more imagined robots than real ones


@pytest.fixture(scope="module")
def branched(env):
    """`(static, hyper, start, (state, metrics), rollout of R x MANY)` of an iteration with two rounds."""
    config, static, hyper = settings({"rollout.imagined": MANY, "task.noise.joint_pos": 0.0})
    start = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    counts = row(config, n_real=5)
    counts |= {"rounds": jnp.int32(1), "memory_count": jnp.int32(5)}
    rows, *out = observe(env, static)(hyper, start, counts)
    return static, hyper, start, out, rows


def test_each_imagined_robot_has_the_rows_of_its_real_one_and_a_tail_of_its_own(branched):
    _, _, _, (state, _), rows = branched
    assert rows.reward.shape == (N, R * MANY)
    by_robot = jax.tree.map(lambda x: np.asarray(x).reshape(N, R, MANY, *x.shape[2:]), rows)
    for name, x in vars(by_robot).items():
        np.testing.assert_array_equal(x[:5, :, 0], x[:5, :, 1], name)
        np.testing.assert_array_equal(x[:5, :, 0], x[:5, :, 2], name)
    for j in range(MANY):  # all begin where physics left their robot
        np.testing.assert_array_equal(by_robot.obs[5, :, j], state.env_state.obs)
    assert (by_robot.action[5:, :, 0] != by_robot.action[5:, :, 1]).all()  # noise of their own
    noise = np.asarray(rows.action - rows.action_mean)[5:].reshape(-1, 2)
    assert len(np.unique(noise.round(6), axis=0)) == len(noise)


def test_what_is_told_of_real_robots_counts_each_once(branched, env):
    """Episodes, returns and the ring are those of the same iteration with one imagined robot."""
    static, hyper, start, (state, metrics), _ = branched
    one = static._replace(rollout=static.rollout._replace(imagined=1))
    config = settings({"task.noise.joint_pos": 0.0})[0]
    counts = row(config, n_real=5) | {"rounds": jnp.int32(1), "memory_count": jnp.int32(5)}
    _, alone, expected = observe(env, one)(hyper, start, counts)
    assert_close(
        (state.env_state, state.memory, state.returns, state.lengths),
        (alone.env_state, alone.memory, alone.returns, alone.lengths),
        1e-5,
    )
    for name in ("episodes", "episode_return_sum", "episode_return", "falls", "nonfinite_robot"):
        np.testing.assert_allclose(metrics[name], expected[name], 1e-5, err_msg=name)
    assert (
        metrics["value_loss"] != expected["value_loss"]
    )  # but the policy learned from other tails


def test_tails_under_a_new_command_begin_in_the_same_states(env):
    """All but the command is that of the row, and each tail hears another."""
    _, static, hyper = settings({"schedule.new_commands": True, "task.heading": False})
    of, counts = ring({"memory_begin": 0, "n_real": 4, "memory_count": 4})
    state = memory.starts(static, hyper, env, of, None, counts, jax.random.key(0))
    np.testing.assert_array_equal(state.obs[:, :3], state.prop)
    np.testing.assert_array_equal(state.obs[:, 4:], np.repeat(state.prop[:, :1], 2, 1))
    assert len(np.unique(state.obs[:, 3])) == R and np.abs(state.obs[:, 3]).max() <= 1


# ---- seeds, chunks


@pytest.fixture(scope="module")
def together(history, env):
    """`(state, metrics)` of the runs of seeds 0 and 1 in one program, with the setting of `history`."""
    config, static, hyper, _ = history
    start = jax.jit(partial(seeds.init, env, static=static))(hyper, seeds.keys(0, 2))
    run = jax.jit(partial(seeds.run, env, static=static))
    return jax.device_get(run(hyper, start, columns(config)))


@pytest.fixture(scope="module")
def everything(env):
    """All options at once: `(config, static, hyper, run of one seed)`."""
    fields = {"rollout.imagined": MANY}
    config, static, hyper = settings(fields)

    def run(hyper, state, columns):
        return algorithm.run(env, hyper, state, columns, static=static)

    return config, static, hyper, jax.jit(chex.assert_max_traces(run, n=1))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_seed_of_several_is_its_run_alone(history, together, env, seed):
    """Every metric of six iterations, and all of the state behind them: the ring, what the model and the
    policy have learned of it. The run alone is by the program of `history`."""
    config, static, hyper, out = history
    state, metrics = together
    state, alone = jax.tree.map(lambda x: x[seed], state), out
    if seed:
        call, table = observe(env, static), columns(config)
        one = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(seed))
        alone = []
        for i in range(len(table["iteration"])):
            rows, one, told = call(hyper, one, {n: c[i] for n, c in table.items()})
            alone.append((rows, one, told))
    assert np.asarray(state.memory.weight).all()
    assert_close(state, alone[-1][1], 2e-3)
    for i, (_, _, told) in enumerate(alone):
        assert_close({name: x[i, seed] for name, x in metrics.items()}, told, 1e-3)


@pytest.mark.slow  # compiles twice; the test above is of one imagined robot for a real one
def test_a_seed_of_several_remembers_what_it_would_alone(everything, env):
    """Learner, model and ring under vmap."""
    config, static, hyper, run = everything
    table = columns(config)
    start = seeds.init(env, hyper, seeds.keys(3, 2), static=static)
    state, metrics = jax.jit(partial(seeds.run, env, static=static))(hyper, start, table)
    for s in range(2):
        alone = algorithm.init(env, hyper, jax.random.key(3 + s), static=static)
        expected, told = run(hyper, alone, table)
        one = jax.tree.map(lambda x, s=s: x[s], state)
        assert_close(one.memory, expected.memory, 1e-3)
        assert_close(one.learner.params, expected.learner.params, 2e-3)
        np.testing.assert_allclose(metrics["model_loss"][:, s], told["model_loss"], 1e-3)


def test_with_a_memory_no_trip_count_is_batched(everything, env):
    config, static, hyper, _ = everything
    table = columns(config)
    start = jax.eval_shape(partial(seeds.init, env, static=static), hyper, seeds.keys(3, 2))
    program = jax.make_jaxpr(partial(seeds.run, env, static=static))(hyper, start, table)
    assert set(trip_counts(program.jaxpr)) == {()}


def trip_counts(jaxpr):
    """The shapes of the predicates of all `while` loops."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "while":
            yield equation.params["cond_jaxpr"].out_avals[0].shape
        for value in equation.params.values():
            for part in value if isinstance(value, (tuple, list)) else (value,):
                part = getattr(part, "jaxpr", part)
                if hasattr(part, "eqns"):
                    yield from trip_counts(part)


def test_a_ring_lies_on_the_devices_of_its_robots(everything, env):
    """Its second axis is spread as the robots are; behind the seeds, its third."""
    _, static, hyper, _ = everything
    mesh = seeds.mesh(1, 1)
    one = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    two = jax.eval_shape(partial(seeds.init, env, static=static), hyper, seeds.keys(0, 2))
    assert seeds.shardings(mesh, one, 1).memory.x.spec == PartitionSpec(None, "env")
    assert seeds.shardings(mesh, two, 2).memory.obs.spec == PartitionSpec("seed", None, "env")
    assert seeds.shardings(mesh, two, 2).robot_index.spec == PartitionSpec("seed", "env")


# ---- a symmetric model

OBS = Mirror(np.array([0, 2, 1, 3, 5, 4]), np.array([-1.0, 1, 1, 1, -1, -1]))
ACTION = Mirror(np.array([1, 0]), np.array([1.0, 1]))


@pytest.fixture(scope="module")
def tied(env):
    """`(static, hyper, env with a mirror, rows, model before)`."""
    _, static, hyper = settings({"model.symmetry": True, "ppo.symmetry": True})
    env = env._replace(mirror=(OBS, ACTION))
    rng = np.random.default_rng(0)
    rows = examples.Examples(
        x=jnp.asarray(rng.normal(1.0, 2.0, size=(N, R, 8)), jnp.float32),
        y=jnp.asarray(rng.normal(1.0, 2.0, size=(N, R, 5)), jnp.float32).at[..., -1].set(0.0),
        weight=jnp.asarray(rng.random((N, R)) < 0.8, jnp.float32),
        count=jnp.int32(N),
    )
    return static, hyper, env, rows, dynamics.init(static, env, jax.random.key(0))


def test_a_symmetric_model_predicts_the_mirror_image_in_the_mirror(tied):
    """Before and after a fit, by both fits; rewards and falls are the same there."""
    static, hyper, env, rows, model = tied
    obs, action = np.random.default_rng(1).normal(size=(2, 9, 6)).astype(np.float32)
    action = action[:, :2]
    mirrors = dynamics.mirrors(static, env)
    assert [len(m.index) for m in mirrors] == [8, 5]
    models = [model]
    for fit in (dynamics.fit, fast.fit):
        run = jax.jit(partial(fit, static, mirrors=mirrors))
        models.append(run(hyper, model, rows, jnp.int32(2), jax.random.key(2))[0])
    assert_close(models[1], models[2], 1e-4)
    assert np.abs(leaves(models[1].params)[list(leaves(models[1].params))[0]]).max() > 0
    for one in models:
        x = np.concatenate([obs, action], -1)
        inputs, outputs = jax.jit(partial(dynamics.scales, static))(one)
        net = dynamics.network(static, 3)
        f = jax.jit(
            lambda x, net=net, one=one, i=inputs, o=outputs: (
                dynamics.networks.apply(net, one.params, (x - i[0]) / i[1]) * o[1] + o[0]
            )
        )
        expected = symmetry.vector(mirrors[1], f(x))
        np.testing.assert_allclose(f(symmetry.vector(mirrors[0], x)), expected, 1e-4, 1e-4)


def test_a_symmetric_fit_is_a_fit_to_rows_and_mirrored_rows(tied):
    """Moments, weights and losses against a fit of twice the robots, without ties."""
    static, hyper, env, rows, model = tied
    mirrors = dynamics.mirrors(static, env)
    both = rows._replace(
        x=jnp.concatenate([rows.x, symmetry.vector(mirrors[0], rows.x)], 1),
        y=jnp.concatenate([rows.y, symmetry.vector(mirrors[1], rows.y)], 1),
        weight=jnp.concatenate([rows.weight] * 2, 1),
    )
    # one minibatch an epoch, so that the order of the robots' rows makes no difference
    static = static._replace(model=static.model._replace(minibatches=1))
    key = jax.random.key(2)
    fit = partial(dynamics.fit, static)
    one, losses = jax.jit(partial(fit, mirrors=mirrors))(hyper, model, rows, jnp.int32(2), key)
    other, expected = jax.jit(fit)(hyper, model, both, jnp.int32(2), key)
    assert_close((one.inputs, one.targets), (other.inputs, other.targets), 1e-4)
    # a bias of 0 is its own image: its gradient is 0 there and rounding here, which Adam makes a step
    other = jax.tree.map(lambda a, b: jnp.where(a == 0, 0.0, b), one.params, other.params)
    assert_close(one.params, other, 2e-3)
    assert_close(losses, expected, 1e-4)


def test_off_it_is_the_program_of_before(env):
    """No ring, no copies of rows and no more draws: with every field at 0 each helper changes nothing."""
    config, static, hyper = toy_env.settings(toy_env.TAIL | {"schedule.rounds": 2})
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    counts = row(config, n_real=5)
    assert static.rollout.imagined == 1 and state.memory is None
    rows = jax.tree.map(jnp.ones_like, state.env_state)
    assert memory.branches(static, rows, 0) is rows and memory.real_robots(static, rows, 0) is rows
    assert memory.imagined_index(static, state.robot_index) is state.robot_index
    assert memory.drawing(static, None, counts) is None
    key = jax.random.key(1)
    real = fast.rollout.allocate(env, N, R).replace(
        obs=jax.random.normal(key, (N, R, 6)), prop=jax.random.normal(key, (N, R, 3))
    )
    starts = jax.jit(partial(memory.starts, static, hyper, env, None))(real, counts, key)
    anchors = jax.jit(partial(dynamics.anchors, static, env))(real, counts["n_real"], key)
    assert_same(starts, anchors)

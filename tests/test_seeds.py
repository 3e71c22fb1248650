"""Seeds by vmap and devices by a mesh: the numbers are those of one seed on one device."""

import math
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from jax.sharding import NamedSharding, PartitionSpec
from toy_runs import leaves

from dynappo import algorithm, schedule, scores, seeds

SEEDS, SHAPE = 4, (2, 4)  # two seeds, and a quarter of their robots, on each of 2 x 4 devices
VALUES = (1e-3, 3e-4, 1e-4, 3e-3)


@pytest.fixture(scope="module")
def toy():
    """`(env, static, hyper, columns)`: 64 robots with a tail, an adaptive learning rate."""
    fields = toy_env.TAIL | {"rollout.num_envs": 64, "ppo.shuffle_blocks": 8}
    config, static, hyper = toy_env.settings(fields, "dyna4")
    return toy_env.make(), static, hyper, schedule.columns(config)


@pytest.fixture(scope="module")
def single(toy):
    """`f(seed, hyper) -> (state, metrics)` of a run without vmap, by one program."""
    env, static, default, columns = toy
    init, step = (jax.jit(partial(f, env, static=static)) for f in (algorithm.init, algorithm.run))

    def run(seed=0, hyper=default):
        hyper = jax.tree.map(jnp.asarray, hyper)
        return jax.device_get(step(hyper, init(hyper, jax.random.key(seed)), columns))

    return run


@pytest.fixture(scope="module")
def start(toy):
    """The first states of four seeds."""
    env, static, hyper, _ = toy
    return jax.jit(partial(seeds.init, env, static=static))(hyper, seeds.keys(0, SEEDS))


@pytest.fixture(scope="module")
def together(toy, start):
    """`(state, metrics)` of four seeds on one device."""
    env, static, hyper, columns = toy
    return jax.jit(partial(seeds.run, env, static=static))(hyper, start, columns)


@pytest.fixture(scope="module")
def swept(toy):
    """`(hyper, [hyper of each seed])`: two fields with a value for each of four seeds."""
    hyper = toy[2]
    fields = ("model.learning_rate", "ppo.entropy_coef")
    alone = []
    for value in VALUES:
        model, ppo = hyper.model._replace(learning_rate=value), hyper.ppo
        alone.append(hyper._replace(model=model, ppo=ppo._replace(entropy_coef=value)))
    for field in fields:
        hyper = seeds.vary(hyper, field, VALUES)
    return hyper, alone


def on_a_mesh(toy, shape, step, hyper, state, num_seeds):
    """`(state, metrics, text of the program)` of a run on a mesh."""
    env, static, _, columns = toy
    mesh = seeds.mesh(*shape)
    spread = seeds.shardings(mesh, state, num_seeds)
    out = (spread, NamedSharding(mesh, PartitionSpec()))
    step = partial(step, env._replace(mesh=mesh), static=static)
    state = jax.device_put(state, spread)
    program = jax.jit(step, out_shardings=out).lower(hyper, state, columns).compile()
    state, metrics = program(hyper, state, columns)
    return state, jax.device_get(metrics), program.as_text()


@pytest.fixture(scope="module")
def mesh_of_robots(toy):
    """One seed whose robots lie on eight devices."""
    env, static, hyper, _ = toy
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    return on_a_mesh(toy, (1, 8), algorithm.run, hyper, state, 1)


@pytest.fixture(scope="module")
def mesh_of_both(toy, swept, start):
    """Four seeds, each with values of its own, on 2 x 4 devices."""
    return on_a_mesh(toy, SHAPE, seeds.run, swept[0], start, SEEDS)


def same(found, expected, rtol=1e-4, atol=2e-5):
    """Every number, to float tolerance; a learning rate that took another step is 50 % off."""
    found, expected = leaves(found), leaves(expected)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol, atol, err_msg=name, equal_nan=True)


def one_of(tree, seed, axis=0):
    """The part of one seed."""
    return jax.tree.map(
        lambda x: x.take(seed, axis) if isinstance(x, np.ndarray) else x[seed], tree
    )


@pytest.mark.slow  # as a sweep on a mesh, without seeds
def test_robots_on_eight_devices_compute_what_one_device_computes(mesh_of_robots, single):
    """E devices with R robots each are one device with E R robots, over six iterations: every
    metric, the learning rate's path, and every array of the state."""
    (state, metrics, _), (expected_state, expected) = mesh_of_robots, single()
    assert len(np.unique(expected["learning_rate"])) > 2  # the path has turns to get wrong
    same(metrics, expected)
    same(state, expected_state, 2e-3, 2e-4)


@pytest.mark.slow  # compiles twice
def test_a_memory_and_imagined_robots_on_several_devices_are_those_of_one():
    """Two seeds, a quarter of their robots on each of 2 x 4 devices: the ring, and who learned of it."""
    fields = {"rollout.num_envs": 64, "ppo.shuffle_blocks": 8, "rollout.imagined": 2}
    fields |= {"schedule.rounds": 2, "model.memory": 11, "model.remembered": 2}
    config, static, hyper = toy_env.settings(toy_env.TAIL | fields | {"schedule.anchors": 7})
    env, columns = toy_env.make(), schedule.columns(config)
    first = jax.jit(partial(seeds.init, env, static=static))(hyper, seeds.keys(0, 2))
    expected, told = jax.jit(partial(seeds.run, env, static=static))(hyper, first, columns)
    of = env, static, hyper, columns
    state, metrics, _ = on_a_mesh(of, SHAPE, seeds.run, hyper, first, 2)
    same(metrics, told)
    same(state, expected, 2e-3, 2e-4)
    assert state.memory.x.sharding.spec == PartitionSpec("seed", None, "env")


@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_seed_of_a_sweep_on_a_mesh_is_its_run_alone(mesh_of_both, swept, single, seed):
    """With values of its own for two fields: every metric, and every array of the state."""
    state, metrics, _ = mesh_of_both
    expected_state, expected = single(seed, swept[1][seed])
    assert len(np.unique(expected["learning_rate"])) > 2  # the path has turns to get wrong
    same(one_of(metrics, seed, 1), expected)
    same(one_of(state, seed), expected_state, 2e-3, 2e-4)
    assert len(np.unique(metrics["model_loss"][-1])) == SEEDS


@pytest.mark.slow  # what a mesh of seeds does above, on one device
@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_seed_among_others_is_the_run_of_that_seed(single, together, seed):
    """Metrics to 1e-5 over five iterations, with the same learning rates."""
    state, metrics = jax.device_get(together)
    expected_state, expected = single(seed)
    same(*(jax.tree.map(lambda x: x[:5], m) for m in (one_of(metrics, seed, 1), expected)), 1e-5)
    same(one_of(state, seed), expected_state, 2e-3, 2e-4)


def test_an_evaluation_of_a_sweep_is_that_of_each_seed_in_the_same_episodes(
    toy, mesh_of_both, swept
):
    env, static, hyper, _ = toy
    sizes = dict(static=static, num_envs=8, num_steps=15)
    params, key = jax.device_get(mesh_of_both[0].learner.params), jax.random.key(3)
    found = jax.jit(partial(seeds.evaluate, env, **sizes))(swept[0], params, key)
    one = jax.jit(partial(scores.evaluate, env, **sizes))
    for seed in range(SEEDS):
        same(one_of(jax.device_get(found), seed), one(hyper, one_of(params, seed), key), 1e-5)
    assert len(np.unique(found["return"])) == SEEDS


@pytest.mark.slow
def test_a_tail_with_everything_on_is_the_same_on_a_mesh():
    """Noise, falls and their weights, known rewards."""
    names = ("clean", "known_reward", "falls")
    fields = {f"model.{name}": True for name in names}
    fields |= toy_env.TAIL | {"rollout.num_envs": 64, "ppo.shuffle_blocks": 8}
    config, static, hyper = toy_env.settings(fields)
    toy = toy_env.make(), static, hyper, schedule.columns(config)
    state = jax.jit(partial(seeds.init, toy[0], static=static))(hyper, seeds.keys(0, 2))
    _, expected = jax.jit(partial(seeds.run, toy[0], static=static))(hyper, state, toy[3])
    _, found, _ = on_a_mesh(toy, SHAPE, seeds.run, hyper, state, 2)
    assert expected["tail_falls"][-1].min() > 0
    same(found, jax.device_get(expected))


def test_robots_lie_on_their_devices_and_networks_on_all(mesh_of_both):
    """After a run each of 2 x 4 devices holds two seeds, a quarter of their robots, whole networks."""
    state, _, _ = mesh_of_both
    shards = state.env_state.obs.addressable_shards
    assert len(shards) == 8 and {s.data.shape for s in shards} == {
        (2, 16, state.env_state.obs.shape[-1])
    }
    for x in (state.params_physics, state.robot_index):
        assert {s.data.shape for s in x.addressable_shards} == {(2, 16)}
    std = state.learner.params["std"]
    assert {s.data.shape for s in std.addressable_shards} == {(2, *std.shape[1:])}


def messages(text):
    """`(kind, elements, line)` of what devices send each other inside loops of a program."""
    for line in text.splitlines():
        found = re.search(r" = (.*?) (all-\w+|collective-permute|reduce-scatter)(-start)?\(", line)
        if found and "while/body" in line:
            shapes = re.findall(r"\w+\[([\d,]*)\]", found[1])
            sizes = [int(np.prod([int(n) for n in s.split(",") if n])) for s in shapes]
            yield found[2], sum(sizes), line


def talking(line):
    """The groups of devices of a message, in either way that XLA writes them."""
    mesh = re.search(r"replica_groups=mesh\[(.*?)\] \{(.*?)\}", line)
    if mesh:
        axes = {name: int(size) for name, size in re.findall(r"'(\w+)'=(\d+)", mesh[1])}
        used = [list(axes).index(name) for name in re.findall(r"'(\w+)'", mesh[2])]
        grid = np.moveaxis(np.arange(8).reshape(*axes.values()), used, range(-len(used), 0))
        return grid.reshape(-1, math.prod(grid.shape[-len(used) :]))
    rows, size = re.search(r"replica_groups=\[(\d+),(\d+)\]<=\[8\][^T]", line).groups()
    return np.arange(8).reshape(int(rows), int(size))


def test_seeds_on_devices_of_their_own_send_each_other_nothing(mesh_of_both):
    """In loops every message stays among the four devices of one row of the mesh."""
    groups = [group for *_, line in messages(mesh_of_both[2]) for group in talking(line)]
    assert len(groups) > 10 and all(len({device // 4 for device in group}) == 1 for group in groups)
    assert any(len(group) == 4 for group in groups)


@pytest.mark.parametrize("mesh", ["both", pytest.param("robots", marks=pytest.mark.slow)])
def test_robots_on_devices_of_their_own_send_sums_and_finished_episodes_only(mesh, request, toy):
    """No row of a rollout travels: gradients and moments are sums, and of rows only reward-sized
    numbers [N, R] of each seed are gathered, for the mean return of the last 100 episodes."""
    env, static, _, _ = toy
    rows = static.rollout.horizon * static.rollout.num_envs
    rows *= SEEDS // SHAPE[0] if mesh == "both" else 1
    sent = [message[:2] for message in messages(request.getfixturevalue(f"mesh_of_{mesh}")[2])]
    assert any(kind == "all-reduce" for kind, _ in sent)
    assert all(kind in ("all-reduce", "all-gather") for kind, _ in sent)
    assert max(size for kind, size in sent if kind == "all-gather") <= rows
    assert rows * env.obs_size > max(size for _, size in sent)


@pytest.mark.parametrize(
    ("field", "word"),
    [
        ("ppo.epochs", "ppo.epochs is not a float"),
        ("ppo.learning_rte", "ppo.learning_rte is not a float"),
        ("task.command_x", "several numbers"),
        ("task.noise", "several numbers"),
        ("task", "several numbers"),
        ("task.randomize", "several numbers"),
        ("physics.timestep", "compiled program"),
        ("run.seed", "compiled program"),
    ],
)
def test_what_cannot_be_swept_is_refused(toy, field, word):
    with pytest.raises(ValueError, match=word):
        seeds.vary(toy[2], field, (0.1, 0.2))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([0.9, 7.0], "ppo.gamma is 7.0, expected 0 to 1"),
        ([math.nan], "ppo.gamma is nan, expected finite numbers"),
        ([], "ppo.gamma: [], expected a list of a number for each seed"),
        (0.9, "ppo.gamma: 0.9, expected a list"),
        ([[0.9]], "ppo.gamma: [[0.9]], expected a list"),
        (["a"], "ppo.gamma: ['a'], expected a list"),
    ],
)
def test_a_value_that_the_field_may_not_hold_is_refused(toy, values, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        seeds.vary(toy[2], "ppo.gamma", values)


def test_a_mesh_of_more_devices_than_there_are_is_refused():
    with pytest.raises(ValueError, match="3 x 4 devices, but JAX sees 8"):
        seeds.mesh(3, 4)

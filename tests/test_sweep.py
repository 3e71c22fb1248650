"""Seeds by vmap and devices by a mesh: the numbers are those of one seed on one device."""

import functools
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from jax.sharding import NamedSharding, PartitionSpec

from dynappo import algorithm, schedule, sweep

SEEDS = 4


@pytest.fixture(scope="module")
def toy():
    """`(env, static, hyper, columns)`: 64 robots with a tail, an adaptive learning rate."""
    fields = toy_env.TAIL | {"rollout.num_envs": 64, "ppo.shuffle_blocks": 8}
    config, static, hyper = toy_env.settings(fields, "dyna4")
    return toy_env.make(), static, hyper, schedule.columns(config)


@pytest.fixture(scope="module")
def train(toy):
    """`f(shape of a mesh, seeds, hyper) -> (state, metrics, text of the program)`, six iterations."""
    env, static, default, columns = toy

    @functools.cache
    def run(shape=None, seeds=1, hyper=default):
        mesh = shape and sweep.mesh(*shape)
        many, placed = seeds > 1, env._replace(mesh=mesh)
        init = partial((sweep if many else algorithm).init, placed, static=static)
        step = partial((sweep if many else algorithm).run, placed, static=static)
        key = sweep.keys(0, seeds) if many else jax.random.key(0)
        if mesh is None:
            program = jax.jit(step).lower(hyper, jax.eval_shape(init, hyper, key), columns)
            state = jax.jit(init)(hyper, key)
        else:
            spread = sweep.shardings(mesh, jax.eval_shape(init, hyper, key), seeds)
            state = jax.jit(init, out_shardings=spread)(hyper, key)
            out = (spread, NamedSharding(mesh, PartitionSpec()))
            program = jax.jit(step, out_shardings=out).lower(hyper, state, columns)
        program = program.compile()
        state, metrics = program(hyper, state, columns)
        return state, jax.device_get(metrics), program.as_text()

    return run


@pytest.fixture(scope="module")
def single(toy):
    """`f(seed, hyper) -> (state, metrics)` of a run without vmap, by one program."""
    env, static, default, columns = toy
    program = jax.jit(partial(algorithm.run, env, static=static))

    def run(seed=0, hyper=default):
        state = algorithm.init(env, hyper, jax.random.key(seed), static=static)
        return jax.device_get(program(jax.tree.map(jnp.asarray, hyper), state, columns))

    return run


@pytest.fixture(scope="module")
def alone(train, single):
    """One seed, and four seeds, on one device."""
    return {1: single(), SEEDS: train(seeds=SEEDS)[:2]}


def same(found, expected, rtol=1e-4):
    """Every number, to float tolerance; a learning rate that took another step is 50 % off."""
    for name, value in expected.items():
        np.testing.assert_allclose(
            found[name], value, rtol=rtol, atol=2e-5, err_msg=name, equal_nan=True
        )


@pytest.mark.parametrize(("seeds", "shape"), [(1, (1, 8)), (SEEDS, (4, 1)), (SEEDS, (2, 4))])
def test_a_mesh_computes_what_one_device_computes(train, alone, seeds, shape):
    """E devices with R robots each are one device with E R robots, over six iterations: every
    metric, the learning rate's path, and every array of the state."""
    state, metrics, _ = train(shape, seeds)
    expected_state, expected = alone[seeds]
    assert len(np.unique(expected["learning_rate"])) > 2  # the path has turns to get wrong
    same(metrics, expected)
    for leaf, value in zip(jax.tree.leaves(state), jax.tree.leaves(expected_state), strict=True):
        if not jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            np.testing.assert_allclose(leaf, value, rtol=2e-3, atol=2e-4, equal_nan=True)


@pytest.mark.slow
def test_a_tail_with_everything_on_is_the_same_on_a_mesh():
    """Noise, bounds (a minimum over robots), falls, known rewards and weights: 2 x 4 devices."""
    names = ("clean", "known_reward", "falls", "bounds")
    fields = {f"model.{name}": True for name in names} | {"ppo.tail_weight": 0.5}
    fields |= toy_env.TAIL | {"rollout.num_envs": 64, "ppo.shuffle_blocks": 8}
    config, static, hyper = toy_env.settings(fields)
    env, columns = toy_env.make(), schedule.columns(config)
    init, run = (partial(f, env, static=static) for f in (sweep.init, sweep.run))
    state = jax.jit(init)(hyper, sweep.keys(0, 2))
    expected = jax.jit(run)(hyper, state, columns)[1]
    mesh = sweep.mesh(2, 4)
    with jax.set_mesh(mesh):
        spread = sweep.shardings(mesh, state, 2)
        state = jax.jit(init, out_shardings=spread)(hyper, sweep.keys(0, 2))
        out = (spread, NamedSharding(mesh, PartitionSpec()))
        found = jax.jit(run, out_shardings=out)(hyper, state, columns)[1]
    assert expected["tail_falls"][-1].min() > 0
    same(jax.device_get(found), jax.device_get(expected))


def test_robots_lie_on_their_devices_and_networks_on_all(train):
    """After a run each of 2 x 4 devices holds two seeds, a quarter of their robots, whole networks."""
    state, _, _ = train((2, 4), SEEDS)
    shards = state.env_state.obs.addressable_shards
    assert len(shards) == 8 and {s.data.shape for s in shards} == {
        (2, 16, state.env_state.obs.shape[-1])
    }
    std = state.learner.params["std"]
    assert {s.data.shape for s in std.addressable_shards} == {(2, *std.shape[1:])}


def messages(text):
    """`(kind, elements)` of what devices send each other inside loops of a program."""
    out = []
    for line in text.splitlines():
        found = re.search(r" = (.*?) (all-\w+|collective-permute|reduce-scatter)(-start)?\(", line)
        if found and "while/body" in line:
            shapes = re.findall(r"\w+\[([\d,]*)\]", found[1])
            out.append(
                (found[2], sum(int(np.prod([int(n) for n in s.split(",") if n])) for s in shapes))
            )
    return out


def test_seeds_on_devices_of_their_own_send_nothing(train):
    """No message in any loop: four seeds on four devices are four runs."""
    assert not messages(train((4, 1), SEEDS)[2])


def test_robots_on_devices_of_their_own_send_sums_and_finished_episodes_only(train, toy):
    """No row of a rollout travels: gradients and moments are sums, and of rows only reward-sized
    numbers [N, R] are gathered, for the mean return of the last 100 episodes."""
    env, static, _, _ = toy
    rows = static.rollout.horizon * static.rollout.num_envs
    sent = messages(train((1, 8), 1)[2])
    assert any(kind == "all-reduce" for kind, _ in sent)
    assert all(kind in ("all-reduce", "all-gather") for kind, _ in sent)
    assert max(size for kind, size in sent if kind == "all-gather") <= rows
    assert rows * env.obs_size > max(size for _, size in sent)


def test_seed_k_of_a_sweep_is_the_run_of_that_seed(single, alone):
    """To 1e-5 over five iterations, with the same learning rates."""
    for k in range(SEEDS):
        five = {name: value[:5] for name, value in single(k)[1].items()}
        same({name: value[:5, k] for name, value in alone[SEEDS][1].items()}, five, rtol=1e-5)


def test_a_float_of_the_config_can_differ_between_seeds(toy, train, single):
    """Two fields with a value for each of four seeds: each is the run with those values."""
    hyper = toy[2]
    values = (1e-3, 3e-4, 1e-4, 3e-3)
    swept = sweep.vary(sweep.vary(hyper, "model.learning_rate", values), "ppo.entropy_coef", values)
    _, metrics, _ = train.__wrapped__(seeds=SEEDS, hyper=swept)
    model = hyper.model._replace(learning_rate=values[2])
    one = hyper._replace(model=model, ppo=hyper.ppo._replace(entropy_coef=values[2]))
    same({name: value[:, 2] for name, value in metrics.items()}, single(2, one)[1])
    assert len(np.unique(metrics["model_loss"][-1])) == SEEDS


@pytest.mark.parametrize(
    ("field", "word"),
    [
        ("ppo.epochs", "ppo.epochs is no float"),
        ("ppo.learning_rte", "ppo.learning_rte is no float"),
        ("task.command_x", "several numbers"),
        ("task.noise", "several numbers"),
        ("physics.timestep", "compiled program"),
        ("run.seed", "compiled program"),
    ],
)
def test_what_cannot_be_swept_is_refused(toy, field, word):
    with pytest.raises(ValueError, match=word):
        sweep.vary(toy[2], field, (0.1, 0.2))


def test_a_mesh_of_more_devices_than_there_are_is_refused():
    with pytest.raises(ValueError, match="3 x 4 devices, but JAX sees 8"):
        sweep.mesh(3, 4)

"""Memory: a hopeless run is refused at once, all else by what the compiler itself has counted."""

import os
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from answers import refused

from dynappo import algorithm, rollout
from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.program import memory
from dynappo.tasks.velocity import env as env_lib

GIB = 2**30


def config(**fields):
    """A valid config with `group__field` set."""
    config = config_lib.load("configs/go1.py:dyna4")
    for name, value in fields.items():
        group, _, leaf = name.partition("__")
        config[group][leaf] = value
    return config_lib.validate(config)


def size(tree):
    """Bytes of the arrays of a tree, or of their shapes."""
    return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(tree))


def test_the_least_is_the_rollout_buffer_and_the_robots():
    """Of the velocity task, to 16 bytes a robot; less of each where devices share them."""
    run = config(rollout__num_envs=64)
    static, hyper = config_lib.split(run)
    robot = robot_lib.load("go1")
    env = env_lib.make(robot, run.task, run.physics)
    buffer = jax.eval_shape(partial(rollout.allocate, env, 16, 64))
    init = partial(algorithm.init, env, static=static)
    state = jax.eval_shape(init, hyper, jax.random.key(0))
    whole = size(buffer) + size((state.env_state, state.params_physics))
    assert abs(whole - memory.least(run, robot)) <= 64 * 16
    assert memory.least(config(rollout__num_envs=64, run__num_seeds=4), robot) == 4 * memory.least(
        run, robot
    )
    spread = dict(run__num_seeds=4, run__mesh_seed=2, run__mesh_env=2)
    assert memory.least(config(rollout__num_envs=64, **spread), robot) == memory.least(run, robot)


def test_the_least_has_a_memory_and_the_rows_of_all_imagined_robots():
    """What more it is than without: the ring, to a tenth, and the rollout of four robots for one."""
    without = memory.least(config(rollout__num_envs=64), robot_lib.load("go1"))
    many = config(rollout__num_envs=64, rollout__imagined=4)
    kept = config(rollout__num_envs=64, model__memory=300, model__remembered=1, model__clean=True)
    robot = robot_lib.load("go1")
    static, hyper = config_lib.split(kept)
    env = env_lib.make(robot, kept.task, kept.physics)
    buffer = jax.eval_shape(partial(rollout.allocate, env, 16, 64))
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    assert memory.least(many, robot) - without == pytest.approx(3 * size(buffer), rel=0.01)
    ring = size(state.memory)
    assert 0.5 * ring < memory.least(kept, robot) - without <= ring


@pytest.mark.parametrize("donated", [False, True])
def test_what_is_needed_are_the_compilers_own_figures(donated):
    """Arguments and results, of which donated ones count once, and scratch: a matrix of 1 MiB and 4."""
    x = jnp.ones((512, 512))

    def step(x):
        y = jnp.concatenate([x @ x, x @ x.T]) @ jnp.concatenate([x, x.T], 1)  # 2 and 4 MiB
        return x + y[:512, :512]

    compiled = jax.jit(step, donate_argnums=(0,) * donated).lower(x).compile()
    sizes, needed = compiled.memory_analysis(), memory.needed(compiled)
    assert sizes.temp_size_in_bytes >= 2**20
    assert needed == (1 if donated else 2) * x.nbytes + sizes.temp_size_in_bytes


def test_a_run_that_does_not_fit_is_one_line():
    """What it needs, what is there, what can be lowered; without a limit nothing is refused."""
    run, robot = config(rollout__num_envs=32768, run__num_seeds=8), robot_lib.load("go1")
    least = memory.least(run, robot)
    for check, text in (
        (
            partial(memory.check, run, robot),
            "the rollout alone needs 3.2 GiB on each device, which has 1.0",
        ),
        (
            partial(memory.check_compiled, run, 5 * GIB),
            "the compiled program needs 5.0 GiB on each device, which has 1.0 GiB",
        ),
    ):
        line = refused(check, GIB)
        assert line.startswith("rollout.num_envs x run.num_seeds is 32768 x 8: ") and text in line
        assert line.endswith("lower one of them, or use more devices (run.mesh_seed, run.mesh_env)")
        check(5 * GIB)
        check(None)
    memory.check(run, robot, least)
    assert "which has" in refused(memory.check, run, robot, least - 1)


def test_the_limit_of_a_device(monkeypatch):
    """JAX's own on a GPU, an equal share of this machine's memory on a CPU, None where nobody says."""

    def device(platform, stats):
        return SimpleNamespace(platform=platform, memory_stats=lambda: stats)

    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for here, count, expected in (
        (device("gpu", {"bytes_limit": 60 * GIB}), 8, 60 * GIB),
        (device("cpu", None), 1, machine),
        (device("cpu", None), 4, machine // 4),
        (device("other", None), 1, None),
    ):
        monkeypatch.setattr(jax, "local_device_count", lambda *_, count=count: count)
        assert memory.limit(here) == expected

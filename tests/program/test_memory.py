"""The memory a run needs: against the arrays of both engines and against what XLA allots."""

import dataclasses
import itertools
import os
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from flax import struct

from dynappo import algorithm, schedule, sweep
from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.physics import contacts as contacts_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import robot as robot_lib
from dynappo.program import memory
from dynappo.task import env as env_lib
from dynappo.types import Env, Outcome

ROBOTS = ("go1", "go2", "anymal_c", "anymal_d")
GIB = 2**30


def config(spec="configs/go1.py:dyna4", **fields):
    """A valid config with `group__field` set."""
    config = config_lib.load(spec)
    for name, value in fields.items():
        group, _, leaf = name.partition("__")
        config[group][leaf] = value
    return config_lib.validate(config)


# ---- the engine's data


@pytest.mark.parametrize("robot, contacts", itertools.product(ROBOTS, ("feet", "full")))
def test_the_data_of_mjx_are_counted_to_the_byte(robot, contacts):
    """mjx.Data of MJX-JAX, and the Jacobian and two vectors of rows that the solver holds beside it."""
    run = config(f"configs/{robot}.py", physics__contacts=contacts)
    data = engine_lib.make(robot_lib.load(robot), run.physics, frozenset(), "jax").data
    solver = data._impl.efc_J.nbytes + 2 * data._impl.efc_pos.nbytes
    whole = sum(leaf.nbytes for leaf in jax.tree.leaves(data))
    assert memory.physics(run, "jax") == whole + solver


@pytest.mark.parametrize("robot, contacts", itertools.product(ROBOTS, ("feet", "full")))
def test_the_data_of_warp_are_counted_to_the_byte(robot, contacts):
    """What each robot more takes of the arrays that Warp keeps, its share of the contacts included."""
    pytest.importorskip("warp")
    from mujoco.mjx.third_party import mujoco_warp

    run = config(f"configs/{robot}.py", physics__contacts=contacts)
    model = robot_lib.physics_model(robot_lib.load(robot), run.physics)
    most, rows = contacts_lib.most(model)

    def size(node):
        if dataclasses.is_dataclass(node):
            return sum(size(getattr(node, f.name)) for f in dataclasses.fields(node))
        return getattr(node, "capacity", 0)

    def kept(worlds):
        return size(mujoco_warp.make_data(model, nworld=worlds, naconmax=worlds * most, njmax=rows))

    assert abs(memory.beside(run) - (kept(32) - kept(16)) // 16) <= 16


@pytest.mark.slow
@pytest.mark.parametrize("contacts", ["feet", "full"])
def test_a_physics_step_takes_what_is_estimated(contacts):
    """XLA's temporaries of one step of 64 robots."""
    run = config("configs/go1.py:ppo16", physics__contacts=contacts)
    _, hyper = config_lib.split(run)
    env = env_lib.make(robot_lib.load("go1"), run.task, run.physics)
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), 64))
    body = jax.eval_shape(jax.vmap(env.randomize, (None, 0)), hyper.task, keys)
    state = jax.eval_shape(jax.vmap(env.reset, (None, 0, 0)), hyper.task, body, keys)
    action = jax.ShapeDtypeStruct((64, env.action_size), jnp.float32)

    def step(task, body, state, action, keys):
        return algorithm.physics_step(env, task, body)(state, action, keys)

    lowered = jax.jit(step).lower(hyper.task, body, state, action, keys)
    temporary = lowered.compile().memory_analysis().temp_size_in_bytes
    assert 0.8 < temporary / (64 * memory.physics(run, "jax")) < 1.1


# ---- rollout, advantages, update and fit


@struct.dataclass
class Dot:
    """A robot that is nothing but its observation."""

    obs: jax.Array

    @property
    def prop(self):
        return self.obs[..., : memory.PROP]


def walker() -> Env:
    """The velocity task's sizes without its physics: what is left is the learner's memory."""
    sizes = dict(obs_size=memory.OBS, prop_size=memory.PROP, action_size=memory.ACTION)
    zero = jnp.zeros(())

    def step(hyper, body, state, action, key):
        obs = 0.9 * state.obs + 0.1 * jnp.tile(action, 4)
        names = ("reward", "truncation", "episode_return", "episode_length")
        outcome = Outcome(
            discount=zero + 1,
            next_obs=obs,
            next_prop=obs[: memory.PROP],
            valid=zero + 1,
            metrics={},
            **dict.fromkeys(names, zero),
        )
        return state.replace(obs=obs), outcome

    return Env(
        randomize=lambda hyper, key: zero,
        reset=lambda hyper, body, key: Dot(jax.random.normal(key, (memory.OBS,))),
        step=step,
        autoreset=lambda hyper, body, state, outcome, key: state,
        context=lambda obs, action: jnp.concatenate([obs[..., 33:36], action], -1),
        noise=lambda hyper, key: jnp.zeros(memory.PROP),
        known_reward=lambda hyper, obs, action, next_prop: zero,
        metrics=(),
        private=lambda body, state: jnp.zeros(memory.PRIVATE),
        private_size=memory.PRIVATE,
        dt=0.02,
        episode_length=1000,
        **sizes,
    )


def temporaries(run) -> int:
    """Bytes that XLA allots to the iterations of `run` on a CPU, beside the state."""
    static, hyper = config_lib.split(run)
    lib, key = algorithm, jax.random.key(0)
    if run.run.num_seeds > 1:
        lib, key = sweep, sweep.keys(0, run.run.num_seeds)
    state = jax.eval_shape(partial(lib.init, walker(), static=static), hyper, key)
    columns = {name: jnp.asarray(column[:2]) for name, column in schedule.columns(run).items()}
    step = jax.jit(partial(lib.run, walker(), static=static), donate_argnums=1)
    return step.lower(hyper, state, columns).compile().memory_analysis().temp_size_in_bytes


CASES = {
    "update": ("ppo16", {"ppo__minibatches": 1}),
    "advantages": (
        "ppo16",
        {"run__num_seeds": 4, "ppo__hidden": (256, 128), "ppo__minibatches": 8},
    ),
    "fit": ("dyna4", {}),
    "fit, private inputs": ("dyna4", {"model__clean": True, "model__private": True}),
    "fit, rows of earlier iterations": ("dyna4", {"model__history": 3}),
    "fit, bfloat16": ("fast", {"rollout__horizon": 32, "model__minibatches": 4}),
}


@pytest.mark.parametrize("name", CASES)
def test_an_iteration_takes_what_is_estimated(name):
    """The estimate of the part that needs most is within 15 % of XLA's own, and not below by 5."""
    spec, fields = CASES[name]
    run = config(f"configs/go1.py:{spec}", rollout__num_envs=1024, **fields)
    parts = memory.phases(run, "jax") | {"rollout": 0}
    largest = max(parts, key=lambda part: parts[part])
    assert largest == name.split(",")[0]
    robots = run.rollout.num_envs * run.run.num_seeds
    assert 0.85 < temporaries(run) / (robots * parts[largest]) < 1.05


# ---- what is said before anything is compiled


def test_more_of_anything_needs_more_memory():
    """Robots, seeds, rows, widths, contacts; minibatches and devices share it."""
    base = memory.total(config())
    for change in (
        {"rollout__num_envs": 8192},
        {"run__num_seeds": 2},
        {"rollout__horizon": 32},
        {"ppo__hidden": (1024, 1024)},
        {"model__hidden": (256, 256, 256, 512)},
        {"physics__contacts": "full"},
        {"run__eval_envs": 16384},
    ):
        assert memory.total(config(**change)) > base, change
    two = dict(run__num_seeds=2, rollout__num_envs=8192)
    for change in (
        {"model__minibatches": 4},
        {"schedule__end_steps": 0, "schedule__end_iteration": 0},
    ):
        assert memory.total(config(**change)) < base, change
    spread = config(**two, run__mesh_seed=2, run__mesh_env=2)
    robot = memory.estimate(config()).robot
    assert memory.total(spread) == base < memory.total(config(**two)) - 3 * 4096 * robot


def test_the_total_is_the_sum_of_its_parts():
    """Robots of all seeds, networks of each, what is there anyway; an evaluation may be larger."""
    run = config("configs/go1.py:ppo16", rollout__num_envs=2048, run__num_seeds=3)
    e = memory.estimate(run, "jax")
    assert memory.total(run, "jax") == e.fixed + 3 * (e.seed + 2048 * e.robot)
    judged = config("configs/go1.py:ppo16", rollout__num_envs=16, run__eval_envs=1000)
    state = memory.STATES * memory.STATE
    assert memory.total(judged, "jax") == e.fixed + e.seed + 16 * state + 1000 * e.judged


def test_the_networks_of_a_seed_are_those_that_are_made():
    """Parameters and Adam's moments of policy, value and model, and as much while they change."""
    run = config("configs/go1.py:dyna4")
    static, hyper = config_lib.split(run)
    state = jax.eval_shape(
        partial(algorithm.init, walker(), static=static), hyper, jax.random.key(0)
    )
    trees = (state.learner, state.model)
    whole = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(trees))
    assert memory.estimate(run).seed == pytest.approx(2 * whole, rel=0.01)


def test_the_state_of_a_robot_is_that_of_the_task():
    """EnvState and the physical parameters of one robot, in bytes."""
    run = config()
    _, hyper = config_lib.split(run)
    env = env_lib.make(robot_lib.load("go1"), run.task, run.physics)
    body = jax.eval_shape(env.randomize, hyper.task, jax.random.key(0))
    state = jax.eval_shape(env.reset, hyper.task, body, jax.random.key(0))
    whole = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves((body, state)))
    assert 0 <= memory.STATE - whole < 32


@pytest.mark.parametrize(
    "fields",
    [
        {"rollout__num_envs": 65536, "run__num_seeds": 16},
        {"rollout__num_envs": 65536, "run__num_seeds": 16, "run__mesh_seed": 4, "run__mesh_env": 2},
        {"rollout__num_envs": 90_000, "ppo__minibatches": 5, "rollout__horizon": 12},
    ],
    ids=["one device", "mesh", "five minibatches"],
)
def test_what_it_says_would_fit_fits_and_no_more(fields):
    """Valid configs of these sizes fit; of the next larger ones, they do not."""
    run = config(**fields)
    size = 8 * GIB
    pairs = memory.fits(run, size)
    assert pairs and len(pairs) <= 2
    changed = 0
    for robots, seeds in pairs:
        assert memory.total(config(**fields | sizes(robots, seeds)), "auto") <= size
        more = (
            [(robots + n, seeds) for n in range(8, 8 * 40, 8)],
            [(robots, seeds + n) for n in (1, 2, 4)],
        )
        for larger in more[robots == run.rollout.num_envs]:
            try:
                beyond = config(**fields | sizes(*larger))
            except ConfigError:
                continue  # minibatches or mesh do not divide it
            assert memory.total(beyond) > size
            changed += 1
    assert changed
    with pytest.raises(ConfigError) as refused:
        memory.check(run, size)
    robots, seeds = pairs[0]
    assert f"{robots} x {seeds}" in str(refused.value)


def sizes(robots, seeds):
    return {"rollout__num_envs": robots, "run__num_seeds": seeds}


def test_a_run_that_fits_passes_and_one_that_does_not_is_one_line():
    """What it needs, what is there, what would fit, which fields to change."""
    run = config(rollout__num_envs=32768, run__num_seeds=8)
    needs = memory.total(run)
    memory.check(run, needs)
    memory.check(run, None)
    assert memory.fits(run, needs) == [(32768, 8), (32768, 8)]
    with pytest.raises(ConfigError) as refused:
        memory.check(run, needs - 1)
    line = str(refused.value)
    assert "rollout.num_envs x run.num_seeds is 32768 x 8" in line and "\n" not in line
    assert f"about {needs / GIB:.1f} GiB on each device, which has {needs / GIB:.1f}" in line
    assert "at most 32760 x 8 or 32768 x 7 fit" in line and len(line) < 380
    for field in ("model.minibatches", "run.mesh_seed", "run.mesh_env"):
        assert field in line
    plain = config("configs/go1.py:ppo16", rollout__num_envs=32768, ppo__minibatches=1)
    with pytest.raises(ConfigError, match="raise ppo.minibatches, or use more devices"):
        memory.check(plain, GIB)
    with pytest.raises(ConfigError, match=r"at most \d+ x 1 fit\. "):
        memory.check(config(rollout__num_envs=1 << 20, run__num_seeds=4096), 2 * GIB)
    judged = config(rollout__num_envs=64, run__eval_envs=1 << 20)
    with pytest.raises(ConfigError, match="no number of robots fits.*lower run.eval_envs, or use"):
        memory.check(judged, 2 * GIB)
    with pytest.raises(ConfigError, match="no number of robots fits"):
        memory.check(run, GIB // 100)


def test_auto_counts_as_both_engines():
    """What JAX will find is not known before it is imported."""
    for spec in ("configs/go1.py:ppo16", "configs/go1.py:dyna4"):
        run = config(spec, physics__contacts="full", rollout__num_envs=32768)
        assert memory.total(run) == max(memory.total(run, impl) for impl in ("jax", "warp"))
        assert memory.physics(run) == memory.physics(run, "jax") > memory.physics(run, "warp")


def test_warps_own_arrays_must_fit_into_what_jax_leaves():
    """A third of JAX's share; for the robots that train, those of an evaluation, and those of one seed."""
    fields = dict(physics__contacts="full", rollout__num_envs=65536, run__eval_envs=1000)
    run = config("configs/go1.py:ppo16", **fields)
    two = config("configs/go1.py:ppo16", **fields, run__num_seeds=2)
    e, own = memory.estimate(run, "warp"), memory.beside(run)
    assert memory.total(run, "warp") == e.fixed + 3 * 66536 * own
    assert memory.total(two, "warp") == e.fixed + 3 * 3 * 66536 * own
    assert memory.estimate(run, "jax").engine == 0
    with pytest.raises(ConfigError, match="them, lower run.eval_envs, or use more"):
        memory.check(run, memory.total(run, "warp") - 1, "warp")


def test_the_limit_of_a_device(monkeypatch):
    """JAX's own on a GPU, this machine's memory on a CPU less the process's own, None where nobody says."""

    def device(platform, stats):
        return SimpleNamespace(platform=platform, memory_stats=lambda: stats)

    pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") - memory.PROCESS
    for here, count, expected in (
        (device("gpu", {"bytes_limit": 60 * GIB}), 8, 60 * GIB),
        (device("cpu", None), 1, pages),
        (device("cpu", None), 4, pages // 4),
        (device("other", None), 1, None),
    ):
        monkeypatch.setattr(jax, "local_devices", lambda here=here: [here])
        monkeypatch.setattr(jax, "local_device_count", lambda count=count: count)
        assert memory.limit() == expected


def test_it_is_counted_without_jax():
    """The first line of a run says it, before anything heavy is imported."""
    code = (
        "import sys; from dynappo import config, memory;"
        "run = config.validate(config.load('configs/go1.py:dyna4'));"
        "memory.check(run, memory.total(run));"
        "print(sorted({'jax', 'jaxlib', 'flax', 'mujoco.mjx'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\n", done.stderr

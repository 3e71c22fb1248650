"""MuJoCo Warp called with few arrays, against `mjx.step` with all of them; where Warp is installed.

On a CPU equal bit by bit. On GPUs sums of Warp have no fixed order.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import PartitionSpec

from dynappo import config as config_lib
from dynappo import sweep
from dynappo.physics import contacts as contacts_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import randomize, warp_engine
from dynappo.physics import robot as robot_lib
from dynappo.physics.warp_engine import Moved

pytest.importorskip("warp")

SEEDS, ROBOTS, STEPS = 2, 4, 6
WIDE = dict(base_mass=(-1.0, 3.0), base_com=(0.05, 0.05, 0.01), friction=(0.4, 1.2))


class World:
    """Robots [SEEDS, ROBOTS] low enough to touch the floor, pushed, with torques; bodies [ROBOTS]."""

    def __init__(self, name, contacts, varied):
        config = config_lib.load(f"configs/{name}.py")
        config.physics.contacts = contacts
        config.task.randomize.update(WIDE)
        config = config_lib.validate(config)
        robot = robot_lib.load(name)
        self.mj_model = robot_lib.physics_model(robot, config.physics)
        self.engine = engine_lib.make(robot, config.physics, frozenset(varied), "warp")
        rng, shape = np.random.default_rng(0), (SEEDS, ROBOTS)
        qpos = np.tile(robot.home_qpos, (*shape, 1)).astype(np.float32)
        qpos[..., 2] -= rng.uniform(0, 0.15, shape)
        qpos[..., 7:] += rng.normal(0, 0.2, (*shape, 12))
        qvel = rng.normal(0, 0.5, (*shape, 18)).astype(np.float32)
        torque = rng.normal(0, 5, (*shape, 12)).astype(np.float32)
        self.start = qpos, qvel, np.zeros_like(qvel), torque
        mass, com = (
            getattr(robot.mj_model, n)[robot.base_body] for n in ("body_mass", "body_ipos")
        )
        keys = jax.random.split(jax.random.key(0), ROBOTS)
        draw = jax.vmap(randomize.draw, (None, None, None, 0))
        self.bodies = draw(config.task.randomize, mass, jnp.asarray(com, jnp.float32), keys)

    def merge(self, body):
        e = self.engine
        return randomize.merge(e.model, body, e.robot.base_body, e.robot.feet, e.varied)

    def few(self, body, qpos, qvel, warm, torque) -> Moved:
        """`STEPS` steps of one robot as `engine_lib.simulate` takes them."""
        model, first = self.merge(body), self.engine.data
        first = first.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warm)
        return jax.lax.fori_loop(
            0, STEPS, lambda _, data: self.engine.step(model, data, torque), first
        )

    def whole(self, body, qpos, qvel, warm, torque) -> Moved:
        """The same by `mjx.step`."""
        touching, rows = contacts_lib.most(self.mj_model)
        worlds = SEEDS * ROBOTS
        data = engine_lib.mjx.make_data(
            self.mj_model, impl="warp", naconmax=worlds * touching, njmax=rows
        )
        data = data.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warm, ctrl=torque)
        model = self.merge(body)
        data = jax.lax.fori_loop(0, STEPS, lambda _, data: engine_lib.mjx.step(model, data), data)
        return Moved(**{name: getattr(data, name) for name in vars(self.engine.data)})


@pytest.fixture(scope="module", params=["go1", "anymal_c"])
def world(request):
    """Every field of the model varied and feet only; none varied and every contact."""
    if request.param == "go1":
        return World("go1", "feet", ("base_mass", "base_com", "friction"))
    return World("anymal_c", "full", ())


@pytest.fixture(scope="module")
def expected(world):
    """By `mjx.step`, all robots along one axis."""
    bodies = jax.tree.map(lambda x: jnp.tile(x, (SEEDS, *[1] * (x.ndim - 1))), world.bodies)
    found = jax.jit(jax.vmap(world.whole))(
        bodies, *(x.reshape(-1, x.shape[-1]) for x in world.start)
    )
    return jax.tree.map(lambda x: np.asarray(x).reshape(SEEDS, ROBOTS, *x.shape[1:]), found)


def compare(found, expected):
    for name, value in vars(expected).items():
        close = (
            dict(rtol=0, atol=0) if jax.default_backend() == "cpu" else dict(rtol=1e-2, atol=1e-3)
        )
        np.testing.assert_allclose(getattr(found, name), value, err_msg=name, **close)


def test_seeds_of_robots_with_the_same_bodies(world, expected):
    """Two axes, one of which the parameters of the bodies do not have."""
    assert np.abs(expected.qvel).max() > 1 and np.abs(expected.qacc_warmstart).max() > 10
    robots = jax.vmap(world.few)
    compare(jax.jit(jax.vmap(robots, (None, 0, 0, 0, 0)))(world.bodies, *world.start), expected)


def test_another_number_of_robots_in_the_same_process(world, expected):
    """As training and an evaluation: each program with arrays of its own, in any order."""
    one, some = jax.jit(world.few), jax.jit(jax.vmap(world.few))
    for seed in (0, 1, 0):
        first = jax.tree.map(lambda x, seed=seed: x[seed], expected)
        compare(some(world.bodies, *(x[seed] for x in world.start)), first)
        alone = one(jax.tree.map(lambda x: x[1], world.bodies), *(x[seed, 1] for x in world.start))
        compare(alone, jax.tree.map(lambda x: x[1], first))


def test_nothing_is_left_of_robots_that_blew_up(world, expected):
    """What Warp keeps of a call with numbers that are not finite does not reach the next."""
    some = jax.jit(jax.vmap(world.few))
    start = [x[0] for x in world.start]
    some(
        world.bodies,
        *(np.full_like(x, bad) for x, bad in zip(start, [np.nan, 1e20] * 2, strict=True)),
    )
    compare(some(world.bodies, *start), jax.tree.map(lambda x: x[0], expected))


@pytest.mark.skipif(jax.device_count() < 2, reason="one device")
def test_every_device_of_a_mesh_steps_its_own_robots(world, expected):
    """As `algorithm.physics_step`, under the `vmap` over seeds of `sweep`."""
    mesh, spec = sweep.mesh(1, 2), PartitionSpec("env")
    robots = jax.shard_map(
        jax.vmap(world.few), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False
    )
    seeds = jax.vmap(robots, (None, 0, 0, 0, 0), spmd_axis_name="seed")
    found = jax.jit(seeds)(world.bodies, *world.start)
    assert len(found.qpos.sharding.device_set) == 2
    compare(found, expected)


def test_environments_of_one_model_share_what_warp_keeps():
    """Each more would stay in memory while the process lives: a batch of runs has dozens."""
    before = set(warp_engine._TOGETHER)
    kept = []
    for iterations in (4, 4, 5):
        config = config_lib.load("configs/go1.py")
        config.physics.iterations = iterations
        config = config_lib.validate(config)
        engine_lib.make(robot_lib.load("go1"), config.physics, frozenset(), "warp")
        kept.append(len(set(warp_engine._TOGETHER) - before))
    assert kept[1] == kept[0] and kept[2] == kept[1] + 1

"""A control step in one call of MuJoCo Warp, against a scan over `mjx.step`; where Warp is installed.

Both are `engine.simulate`. Sums of Warp have no fixed order on GPUs, and XLA rounds the motors
otherwise than Warp does.
"""

import concurrent.futures
import threading
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from answers import PATIENCE
from jax.sharding import PartitionSpec
from mujoco import mjx

from dynappo import config as config_lib
from dynappo import seeds
from dynappo.description import contacts as contacts_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import randomize
from dynappo.tasks.velocity import env as env_lib

pytest.importorskip("warp")

from dynappo.physics.warp import building, scope  # noqa: E402
from dynappo.physics.warp import call as warp_call  # noqa: E402

SEEDS, ROBOTS, STEPS = 2, 4, 3
WIDE = dict(base_mass=(-1.0, 3.0), base_com=(0.05, 0.05, 0.01), friction=(0.4, 1.2))
HARDWARE = dict(
    kp_scale=(0.8, 1.2),
    kd_scale=(0.8, 1.2),
    strength=(0.7, 1.3),
    armature=(0.5, 2.0),
    joint_friction=(0.1, 0.6),
    delay=(0.0, 0.03),
    lag=(0.005, 0.03),
    encoder_bias=0.03,
)


class World:
    """Robots [SEEDS, ROBOTS] low enough to touch the floor, pushed; bodies [ROBOTS]."""

    def __init__(self, name, contacts, hardware, dry=0.0):
        config = config_lib.load(f"configs/{name}.py" + ":deploy" * hardware)
        config.physics.update(contacts=contacts, iterations=20, ls_iterations=20)  # to the end
        config.task.randomize.update(WIDE | (HARDWARE if hardware else {}))
        if hardware:
            own = 1 + 0.1 * np.arange(12)
            for field in ("kp", "kd", "effort_limit", "saturation_effort", "velocity_limit"):
                config.task[field] = tuple((config.task[field] * own).tolist())
        config.task.actuator = "lag" if hardware else "pd"
        config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(name))
        _, self.hyper = config_lib.split(config)
        self.config = config
        if dry:
            spec = robot_lib.physics_spec(robot.xml)
            for joint in spec.joints[1:]:
                joint.frictionloss = dry
            robot = robot._replace(mj_model=spec.compile())
        varied = randomize.varied(config.task.randomize)
        made = [robot, config.physics, varied]
        self.engine = engine_lib.make(
            *made, "warp", every_substep=contacts == "full", lags=hardware
        )
        mj_model = robot_lib.physics_model(robot, config.physics)
        impl, room = "jax", {}
        if not fits(self.engine, config):  # MuJoCo Warp's step itself: its result to the digit
            touching, rows = contacts_lib.most(mj_model)
            impl, room = "warp", dict(naconmax=SEEDS * ROBOTS * touching, njmax=rows)
        self.scanned = self.engine._replace(
            impl="jax",
            model=mjx.put_model(mj_model, impl=impl),
            data=mjx.make_data(mj_model, impl=impl, **room),
            step=engine_lib._mjx_step,
        )
        rng, shape = np.random.default_rng(0), (SEEDS, ROBOTS)
        mass, com = (
            getattr(robot.mj_model, n)[robot.base_body] for n in ("body_mass", "body_ipos")
        )
        keys = jax.random.split(jax.random.key(0), ROBOTS)
        draw = jax.vmap(
            lambda k: randomize.draw(
                self.hyper.task.randomize, mass, jnp.asarray(com, jnp.float32), k, varied, 12
            )
        )
        self.bodies = jax.jit(draw)(keys)
        env = env_lib.make(robot, config.task, config.physics, impl="warp")
        resets = jax.vmap(env.reset, (None, 0, 0))
        state = jax.jit(jax.vmap(resets, (None, None, 0)))(
            self.hyper, self.bodies, jax.random.split(jax.random.key(1), shape)
        )
        qpos, qvel = np.array(state.qpos), rng.normal(0, 0.5, (*shape, 18)).astype(np.float32)
        qpos[..., 2] -= rng.uniform(0.05, 0.2, shape)
        qpos[..., 7:] += rng.normal(0, 0.2, (*shape, 12))
        kept = dict(qpos=jnp.asarray(qpos), qvel=jnp.asarray(qvel))
        if hardware:
            kept["torque"] = jnp.asarray(rng.normal(0, 5, (*shape, 12)), jnp.float32)
        self.state = state.replace(**kept)
        self.actions = jnp.asarray(rng.normal(0, 1, (*shape, STEPS, 12)), jnp.float32)

    def step(self, engine, body, state, action):
        """A control step of one robot: its state, and the step's numbers."""
        after = engine_lib.simulate(engine, self.hyper, body, state, action)
        names = set(after._fields) & set(vars(state))
        state = state.replace(
            last_action=action,
            older_action=state.last_action,
            **{n: getattr(after, n) for n in names if getattr(state, n) is not None},
        )
        return state, after

    def few(self, body, state, actions):
        """`STEPS` control steps of one robot; the last one's numbers."""
        for action in actions:
            state, after = self.step(self.engine, body, state, action)
        return after


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("go1", "anymal_c", "dry")]


@pytest.fixture(scope="module", params=["hardware", *SLOW])
def world(request):
    """Feet only; all that `deploy` varies, and a motor of its own at each joint; damping and every contact,
    in every physics step; as the second, on a file with dry friction."""
    made = {
        "go1": ("go1", "feet", False),
        "hardware": ("go1", "feet", True),
        "anymal_c": ("anymal_c", "full", False),
        "dry": ("go1", "feet", True, 0.2),
    }
    return World(*made[request.param])


@pytest.fixture(scope="module")
def expected(world):
    """By `mjx.step`, all robots along one axis."""
    bodies = jax.tree.map(lambda x: jnp.tile(x, (SEEDS, *[1] * (x.ndim - 1))), world.bodies)

    def flat(x):
        return x.reshape(-1, *x.shape[2:])

    step = jax.jit(jax.vmap(partial(world.step, world.scanned)))
    state = jax.tree.map(flat, world.state)
    for k in range(STEPS):  # a program of one step: MJX takes long to compile
        state, found = step(bodies, state, flat(world.actions)[:, k])
    return jax.tree.map(lambda x: np.asarray(x).reshape(SEEDS, ROBOTS, *x.shape[1:]), found)


def compare(found, expected):
    close = (
        dict(rtol=1e-3, atol=1e-4) if jax.default_backend() == "cpu" else dict(rtol=2e-2, atol=2e-3)
    )
    for name, value in expected._asdict().items():
        scale = 100.0 if name in ("qacc_warmstart", "torque") else 1.0
        np.testing.assert_allclose(
            getattr(found, name),
            value,
            err_msg=name,
            rtol=close["rtol"],
            atol=scale * close["atol"],
        )


def one(tree, *at):
    return jax.tree.map(lambda x: x[at], tree)


def test_dry_friction_and_contacts_of_all_parts_are_left_to_mujoco_warp(world, request):
    kind = request.node.name.partition("[")[2]
    assert fits(world.engine, world.config) == (kind in ("go1]", "hardware]"))


def fits(engine, config):
    model = robot_lib.physics_model(engine.robot, config.physics)
    return bool(scope.kernel(model, engine.robot.feet, engine.every_substep))


def test_seeds_of_robots_with_the_same_bodies(world, expected):
    """Two axes, one of which the parameters of the bodies do not have."""
    assert np.abs(expected.qvel).max() > 1 and np.abs(expected.qacc_warmstart).max() > 10
    assert (expected.contact_steps > 0).any() and (expected.air_steps > 0).any()
    assert (expected.last_air_steps > 0).any() and np.isfinite(expected.lowest).all()
    robots = jax.vmap(world.few)
    found = jax.jit(jax.vmap(robots, (None, 0, 0)))(world.bodies, world.state, world.actions)
    compare(found, expected)


def test_another_number_of_robots_in_the_same_process(world, expected):
    """As training and an evaluation: each program with arrays of its own, in any order."""
    alone, some = jax.jit(world.few), jax.jit(jax.vmap(world.few))
    for seed in (0, 1, 0):
        given = one((world.state, world.actions), seed)
        compare(some(world.bodies, *given), one(expected, seed))
        first = alone(one(world.bodies, 1), *one((world.state, world.actions), seed, 1))
        compare(first, one(expected, seed, 1))


def test_nothing_is_left_of_robots_that_blew_up(world, expected):
    """What Warp keeps of a call with numbers that are not finite does not reach the next, and such
    numbers are seen."""
    some = jax.jit(jax.vmap(world.few))
    state, actions = one((world.state, world.actions), 0)
    bad = jnp.array([np.nan, 1e20] * 2)[:, None]
    found = some(world.bodies, state.replace(qpos=state.qpos * bad), actions)
    assert not np.isfinite(found.qpos).all(-1).any()
    found = some(world.bodies, state, actions.at[0, -1, 0].set(np.nan))
    assert np.isnan(found.qpos[0]).any() and np.isfinite(found.qpos[1:]).all()
    compare(some(world.bodies, state, actions), one(expected, 0))


@pytest.mark.skipif(jax.device_count() < 2, reason="one device")
def test_every_device_of_a_mesh_steps_its_own_robots(world, expected):
    """As `algorithm.physics_step`, under the `vmap` of `seeds`."""
    mesh, spec = seeds.mesh(1, 2), PartitionSpec("env")
    robots = jax.shard_map(
        jax.vmap(world.few), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False
    )
    every = jax.vmap(robots, (None, 0, 0), spmd_axis_name="seed")
    found = jax.jit(every)(world.bodies, world.state, world.actions)
    assert len(found.qpos.sharding.device_set) == 2
    compare(found, expected)


def test_environments_of_one_model_share_what_warp_keeps():
    """Each more would stay in memory while the process lives: a batch of runs has dozens."""
    before = set(warp_call._TOGETHER)
    kept = []
    for iterations in (4, 4, 5):
        config = config_lib.load("configs/go1.py")
        config.physics.iterations = iterations
        config.physics.ls_iterations = 7
        config = config_lib.validate(config)
        engine_lib.make(robot_lib.load("go1"), config.physics, frozenset(), "warp")
        kept.append(len(set(warp_call._TOGETHER) - before))
    assert kept == [1, 1, 2]


def test_all_kernels_of_a_step_are_found_before_it(world, expected, monkeypatch):
    """What a real step asks Warp to load is what `launched` has found without a launch."""
    import warp as wp

    found, loaded = set(), set()
    start, load = building.start, wp.Module.load

    def noted(modules, places):
        found.update((module.name, size) for module, size in modules)
        start(modules, places)()  # and wait
        loaded.clear()
        return lambda: None

    def watched(module, device, block_dim=None, *more, **given):
        loaded.add((module.name, block_dim or module.options["block_dim"]))
        return load(module, device, block_dim, *more, **given)

    monkeypatch.setattr(building, "start", noted)
    monkeypatch.setattr(wp.Module, "load", watched)
    monkeypatch.setattr(warp_call, "_TOGETHER", {})
    engine = world.engine
    model = robot_lib.physics_model(engine.robot, world.config.physics)
    step = warp_call.make(model, engine.robot, engine.substeps, engine.every_substep)
    again = engine._replace(step=step)
    given = one(world.bodies, 0), one(world.state, 0, 0), world.actions[0, 0, 0]
    jax.block_until_ready(jax.jit(partial(world.step, again))(*given))
    own = {(warp_call.__name__, size) for _, size in loaded}  # Warp's for a function of JAX's
    ours = fits(engine, world.config)
    assert (len(found) == 1 if ours else len(found) > 20) and loaded - own == found - own


def test_a_programs_first_call_finds_its_kernels_built(monkeypatch):
    """Those of all steps that were traced: `wait` returns when the last is loaded, or raises what it did."""
    monkeypatch.setattr(building, "_LOADS", [])
    done, go = [], threading.Event()

    class Module:
        def __init__(self, name):
            self.name = name

        def load(self, device, block_dim):
            assert go.wait(PATIENCE)
            if self.name == "broken":
                raise RuntimeError("no such file")
            done.append((self.name, device, block_dim))

    first = building.start({(Module("a"), 1), (Module("b"), 2)}, ["x", "y"])
    building.start({(Module("c"), 3)}, ["x"])
    waiting = concurrent.futures.ThreadPoolExecutor(1).submit(building.wait)
    with pytest.raises(TimeoutError):
        waiting.result(0.05)
    go.set()
    waiting.result(PATIENCE)
    of_two = {(name, device, size) for name, size in (("a", 1), ("b", 2)) for device in "xy"}
    assert {*done} == {*of_two, ("c", "x", 3)} and len(done) == 5
    first()
    building.wait()  # nothing is left
    building.start({(Module("broken"), 1)}, ["x"])
    with pytest.raises(RuntimeError, match="^no such file$"):
        building.wait()


def test_launches_are_only_noted():
    """Not one kernel runs, and those without threads are left out."""
    import warp as wp

    from dynappo.physics.warp import kernels

    there = wp.zeros(12, dtype=float)

    @wp.kernel
    def fill(to: wp.array(dtype=float)):  # pyright: ignore
        to[wp.tid()] = 1.0

    def call():
        wp.launch(fill, dim=12, inputs=[there])
        wp.launch(kernels.keep, dim=(2, 13), inputs=[1])
        wp.launch_tiled(kernels.motors, dim=(0, 4), inputs=[], block_dim=32)

    found = building.launched(call)
    assert {module.name for module, _ in found} == {kernels.__name__, fill.module.name}
    assert not there.numpy().any() and wp.launch.__module__.startswith("warp")

"""Robots of other feet and limbs than the bundled ones: engines against a plain loop in C MuJoCo, the lowest
points of feet against points on their surfaces, and the room for their contacts.

No test names a device for Warp: its kernels run on the GPU if there is one, as those of test_warp_call.py.
"""

import copy
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import other_robots
import pytest
from mujoco import mjx

from dynappo import config as config_lib
from dynappo.description import contacts
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators, engine_contract, randomize
from dynappo.physics import engine as engine_lib
from dynappo.physics.warp import scope

ROBOTS, STEPS, SUBSTEPS = 6, 5, 4
CLOCKS = ("air_steps", "contact_steps", "last_air_steps")
CARRIED = ("qpos", "qvel", "qacc_warmstart", *CLOCKS, "peak", "last_peak")
KINDS = {
    "box": partial(other_robots.biped, other_robots.BOX),
    "capsules": partial(other_robots.biped, other_robots.CAPSULES),
    "mixed": partial(other_robots.biped, other_robots.MIXED, other_robots.BOX),
    "hexapod": other_robots.hexapod,
}
POSES = 400


def settings(touching="full"):
    config = config_lib.load("configs/go1.py:ppo16")  # its motors are the same at every joint
    config.physics.update(contacts=touching, iterations=40, ls_iterations=40, threads=1)
    return config_lib.validate(config)


@pytest.fixture(scope="module", params=KINDS)
def robot(request):
    return KINDS[request.param]()


def place(robot):
    """Robots that come down on the floor, a little tilted, every other one turned any way, and actions."""
    rng, model = np.random.default_rng(0), robot.mj_model
    joints, feet = len(robot.joint_names), len(robot.foot_names)
    qpos = np.tile(robot.home_qpos, (ROBOTS, 1))
    qpos[:, 7:] += rng.normal(0, 0.15, (ROBOTS, joints))
    qpos[:, 4:7] += rng.normal(0, 0.1, (ROBOTS, 3))
    qpos[::3, 3:7] = rng.normal(size=(len(qpos[::3]), 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    geoms = np.concatenate([robot.feet, robot.parts])
    for row in qpos:
        low = other_robots.lowest_points(model, row, geoms).min()
        row[2] -= low + rng.uniform(-0.01, 0.01)
    qvel = rng.normal(-0.2, 0.5, (ROBOTS, 6 + joints))
    clocks = rng.integers(0, 9, (3, ROBOTS, feet), np.int32)
    clocks[1] *= clocks[0] == 0  # a foot is in the air or on the ground
    peaks = rng.uniform(0, 0.1, (2, ROBOTS, feet)).astype(np.float32)
    start = dict(zip(CARRIED, (qpos, qvel, qvel * 0, *clocks, *peaks), strict=True))
    start = {n: x.astype(np.float32) if x.dtype == float else x for n, x in start.items()}
    actions = rng.normal(0, 1.5, (STEPS, ROBOTS, joints)).astype(np.float32)
    return SimpleNamespace(robot=robot, start=start, actions=actions, config=settings())


def runs(world, impl):
    """`(start, action) -> Substeps` of all robots."""
    friction = np.linspace(0.4, 1.2, ROBOTS, dtype=np.float32)
    bodies = randomize.Body(1.0, jnp.zeros(3), friction, 1.0, 1.0)
    axes = randomize.Body(None, None, 0, None, None)
    hyper = config_lib.split(world.config)[1]
    engine = engine_lib.make(world.robot, world.config.physics, frozenset({"friction"}), impl, True)
    simulate = partial(engine_lib.simulate, engine, hyper)

    def one(body, s, action):
        s = s | dict(last_action=action * 0, older_action=action * 0)
        return simulate(body, SimpleNamespace(**s, torque=None), action)

    step = jax.jit(jax.vmap(one, (axes, 0, 0)))
    # C MuJoCo's call is there for CPUs alone
    device = jax.devices("cpu" if impl == "c" else None)[0]

    def run(start, action):
        with jax.default_device(device):
            return jax.device_get(step(bodies, start, action))

    return run


def by_hand(world, i):
    """Robot `i` after each control step, by C MuJoCo a physics step at a time, in double precision."""
    robot, task, feet = world.robot, world.config.task, range(len(world.robot.foot_names))
    model = robot_lib.physics_model(robot, world.config.physics)
    model.geom_friction[robot.feet, 0] = np.linspace(0.4, 1.2, ROBOTS)[i]
    data = mujoco.MjData(model)
    start = {name: value[i].copy() for name, value in world.start.items()}
    data.qpos[:], data.qvel[:] = start["qpos"], start["qvel"]
    limits = {n: task[n] for n in ("effort_limit", "saturation_effort", "velocity_limit")}
    air, contact, last, peak, last_peak = (start[name] for name in CARRIED[3:])
    for action in world.actions[:, i].astype(float):
        depths = []
        for _ in range(SUBSTEPS):
            low = other_robots.lowest_points(model, data.qpos, robot.feet)
            depths.append(other_robots.lowest_points(model, data.qpos, robot.parts))
            target, qd = robot.default_pose + task.action_scale * action, data.qvel[6:].copy()
            torque = actuators.pd(target, data.qpos[7:], qd, task.kp, task.kd)
            data.ctrl[:] = actuators.clip_dc_motor(torque, qd, **limits)
            mujoco.mj_step(model, data)
            for foot in feet:
                height = min(low[k] for k in range(len(low)) if robot.foot_of[k] == foot)
                if height < 0:
                    if air[foot] > 0:
                        last[foot], last_peak[foot] = air[foot] + 1, peak[foot]
                    air[foot], contact[foot], peak[foot] = 0, contact[foot] + 1, 0
                else:
                    air[foot], contact[foot] = air[foot] + 1, 0
                    peak[foot] = max(peak[foot], height)
        found = data.qpos, data.qvel, air, contact, last, peak, last_peak, np.min(depths, 0)
        names = "qpos", "qvel", *CARRIED[3:], "lowest"
        yield {name: np.copy(value) for name, value in zip(names, found, strict=True)}


@pytest.fixture(scope="module")
def world(robot):
    return place(robot)


@pytest.fixture(scope="module")
def in_c(world):
    """`(start, found)` of each control step in C MuJoCo."""
    run, start, rows = runs(world, "c"), world.start, []
    for action in world.actions:
        rows.append((start, run(start, action)))
        start = {name: getattr(rows[-1][1], name) for name in CARRIED}
    return rows


def test_what_mjx_simplifies_is_told_of_boxes_alone(robot):
    """The slow tests of engines measure it: MJX lets only some corners of a box touch."""
    boxes = contacts.BOX in robot.mj_model.geom_type[robot.feet]
    assert ("its corners within 1 mm" in engine_contract.coarse(robot)) == boxes


def test_steps_in_c_are_those_of_a_plain_loop(world, in_c):
    """All feet's timers and peaks, and the parts' lowest points."""
    hands, touched = [list(by_hand(world, i)) for i in range(ROBOTS)], np.zeros(2)
    close = dict(qpos=1e-5, qvel=2e-4, lowest=1e-5, peak=1e-5, last_peak=1e-5)
    for t, (_, found) in enumerate(in_c):
        for name in (*close, *CLOCKS):
            hand = np.array([row[t][name] for row in hands])
            atol = close.get(name, 0)
            np.testing.assert_allclose(getattr(found, name), hand, 0, atol, err_msg=name)
        touched += (found.contact_steps > 0).sum(), (found.contact_steps == 0).sum()
    assert (touched > 5).all(), touched
    assert np.ptp(np.array([row["contact_steps"] for hand in hands for row in hand])) > 3


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_other_engines_make_the_same_steps(world, in_c, impl):
    """Each from the state that C MuJoCo has reached. Measured: median 1e-7 m or rad and 7e-6 rad/s, four
    fifths below 2e-7 and 2e-5; but in MJX only those corners of a box touch that are within 1 mm of the
    deepest."""
    if impl == "warp":
        pytest.importorskip("warp")
    run, errors = runs(world, impl), {}
    for (start, expected), action in zip(in_c, world.actions, strict=True):
        found = run(start, action)
        for name in ("qpos", "qvel", "lowest", "peak", "last_peak", *CLOCKS):
            error = np.abs(getattr(found, name) - getattr(expected, name)).max(-1)
            errors.setdefault(name, []).extend(error)
    found = {name: np.quantile(error, [0.5, 0.8]) for name, error in errors.items()}
    bounds = dict.fromkeys(("qpos", "lowest", "peak", "last_peak"), (1e-6, 2e-6))
    bounds |= dict(qvel=(5e-5, 2e-4)) | dict.fromkeys(CLOCKS, (0, 0))
    if impl == "jax" and contacts.BOX in world.robot.mj_model.geom_type[world.robot.feet]:
        bounds = {name: (bound[0], np.inf) for name, bound in bounds.items()}
    for name, bound in bounds.items():
        assert (found[name] <= bound).all(), (name, found[name])


def poses(robot, rng):
    """[POSES, nq]: any attitude and angles, the lowest point of a foot within 2 cm of the floor."""
    model, out = robot.mj_model, np.zeros((POSES, robot.mj_model.nq))
    out[:, 3:7] = rng.normal(size=(POSES, 4))
    out[:, 3:7] /= np.linalg.norm(out[:, 3:7], axis=1, keepdims=True)
    out[:, 7:] = rng.uniform(*model.jnt_range[1:].T, size=(POSES, model.nq - 7))
    low = np.array([other_robots.lowest_points(model, row, robot.feet) for row in out])
    out[:, 2] = rng.uniform(-0.02, 0.02, POSES) - low[np.arange(POSES), rng.integers(low.shape[1])]
    return out.astype(np.float32)


def test_in_mjx_a_foot_is_as_low_as_the_lowest_of_its_shapes():
    """With kinematics instead of a step, so that nothing moves, against points on the surfaces."""
    robot, config = KINDS["mixed"](), settings()
    engine = engine_lib.make(robot, config.physics, frozenset(), "jax")
    hyper, body = config_lib.split(config)[1], randomize.Body(1.0, jnp.zeros(3), 0.8, 1.0, 1.0)

    def read(qpos):
        rest = dict.fromkeys(("qvel", "qacc_warmstart"), jnp.zeros(18))
        rest |= dict.fromkeys(CLOCKS, jnp.zeros(2, jnp.int32))
        rest |= dict.fromkeys(("peak", "last_peak"), jnp.full(2, -1.0))
        state: Any = SimpleNamespace(qpos=qpos, **rest)
        after = engine_lib.simulate(engine, hyper, body, state, jnp.zeros(12))
        return after.peak, after.contact_steps > 0

    given = poses(robot, np.random.default_rng(0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mjx, "step", mjx.kinematics)
        peak, down = jax.device_get(jax.jit(jax.vmap(read))(given))
    low = np.array([other_robots.lowest_points(robot.mj_model, row, robot.feet) for row in given])
    assert len(set(low[:, :3].argmin(1))) == 3  # of three shapes each is the lowest somewhere
    low = np.stack([low[:, :3].min(1), low[:, 3]], 1)
    sure = np.abs(low) > 1e-6
    np.testing.assert_array_equal(down[sure], (low < 0)[sure])
    assert 0.1 < down.mean() < 0.9
    np.testing.assert_allclose(peak[~down], low[~down], atol=1e-6)


def test_in_warp_a_foot_is_as_low_as_the_lowest_of_its_shapes():
    """The kernel that `general` has beside MuJoCo Warp's own, alone."""
    wp = pytest.importorskip("warp")
    from dynappo.physics.warp import arrays, kernels

    robot = KINDS["mixed"]()
    model, feet, parts = robot.mj_model, len(robot.foot_names), len(robot.parts)
    shape = arrays.shape(model, robot, 1, False)
    given, data = poses(robot, np.random.default_rng(1)), mujoco.MjData(model)
    place = np.zeros((POSES, model.ngeom, 3), np.float32)
    turn = np.zeros((POSES, model.ngeom, 3, 3), np.float32)
    for i, row in enumerate(given):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        place[i], turn[i] = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
    out = {name: wp.zeros((POSES, feet), dtype=int) for name in CLOCKS}
    out |= {name: wp.full((POSES, feet), -1.0, dtype=float) for name in ("peak", "last_peak")}
    out["lowest"] = wp.zeros((POSES, parts), dtype=float)
    numbers = [shape.first, shape.feet, shape.soles, shape.parts, shape.floor]
    kinds = int, int, float, int, float
    given_geoms = [wp.array(x, dtype=k) for x, k in zip(numbers, kinds, strict=True)]
    geoms = [wp.array(place, dtype=wp.vec3), wp.array(turn, dtype=wp.mat33)]
    wp.launch(
        kernels.keep,
        dim=(POSES, feet + parts),
        inputs=[0, 0, 0, *given_geoms, *geoms],
        outputs=[*out.values()],
    )
    found = {name: value.numpy() for name, value in out.items()}
    ids = np.concatenate([robot.feet, robot.parts])
    low = np.array([other_robots.lowest_points(model, row, ids) for row in given])
    foot = np.stack([low[:, :3].min(1), low[:, 3]], 1)
    sure, down = np.abs(foot) > 1e-6, found["contact_steps"] > 0
    np.testing.assert_array_equal(down[sure], (foot < 0)[sure])
    np.testing.assert_array_equal(found["air_steps"], ~down)
    np.testing.assert_allclose(found["peak"][~down], foot[~down], atol=1e-6)
    np.testing.assert_allclose(found["lowest"], low[:, 4:], atol=1e-6)


# ---- room for contacts


@pytest.mark.slow
@pytest.mark.parametrize("touching", ["feet", "full"])
def test_there_is_room_for_all_contacts_and_no_more(robot, touching):
    """Deep under the floor every shape has all the contacts that MuJoCo Warp can find for it."""
    wp = pytest.importorskip("warp")
    from mujoco.mjx.third_party import mujoco_warp as mjw

    model = robot_lib.physics_model(robot, settings(touching).physics)
    room, rows = contacts.most(model)
    made = mjw.put_model(model)
    data = mjw.make_data(model, nworld=2, naconmax=20 * room, njmax=20 * rows)
    sunk = np.tile(robot.home_qpos, (2, 1))
    sunk[:, 2] -= 3
    data.qpos = wp.array(sunk, dtype=float)
    mjw.forward(made, data)
    assert data.nacon.numpy()[0] == 2 * room
    assert (data.nefc.numpy() <= rows).all() and (data.nefc.numpy() > rows / 3).all()


# ---- which robots the kernel computes


def test_the_kernel_of_quadrupeds_declines_other_feet():
    """Of four legs of three joints: a foot of a box, a foot of two spheres, two feet on one leg."""
    robot = robot_lib.load("go1")
    physics = config_lib.validate(config_lib.load("configs/go1.py")).physics
    model = robot_lib.physics_model(robot, physics)
    assert not scope.no_quadruped(model, robot.feet, False)
    boxed = copy.copy(model)
    boxed.geom_type[robot.feet[2]] = contacts.BOX
    assert "feet that are no spheres" in scope.no_quadruped(boxed, robot.feet, False)
    five = np.concatenate([robot.feet, robot.parts[:1]])
    assert "a sphere as foot" in scope.no_quadruped(model, five, False)
    swapped = robot.feet[[1, 0, 2, 3]]
    assert "a sphere as foot" in scope.no_quadruped(model, swapped, False)


def test_the_kernel_of_trees_declines_cylinders(robot):
    model = robot_lib.physics_model(robot, settings("feet").physics)
    odd = contacts.CYLINDER in model.geom_type[robot.feet]
    assert ("geom_type" in scope.declines(model, robot.feet)) == odd
    assert scope.kernel(model, robot.feet, True) == ("" if odd else "tree")

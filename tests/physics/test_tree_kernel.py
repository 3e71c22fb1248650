"""Our kernel of a tree's control step against C MuJoCo in double precision, solved to the end.

No test names a device for Warp: on a GPU a robot has a warp there, on a CPU a thread.
"""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo.description import robot as robot_lib
from dynappo.physics import actuators

pytest.importorskip("warp")

from kernel_case import (  # noqa: E402
    ROBOTS,
    a_physics_step,
    drive,
    physics,
    rounds_stop,
    several_steps,
)
from tree_robots import made  # noqa: E402

from dynappo.physics.warp import arrays, general, scope, tree  # noqa: E402
from dynappo.physics.warp import call as warp_call  # noqa: E402

LIMITED = dict(g1=20, biped=3, mine=0)  # joints that are beyond their range
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("hexapod", "biped")]


@pytest.fixture(scope="module", params=["g1", "damped", "turned", *SLOW])
def case(request, tmp_path_factory):
    case = made(request.param, tmp_path_factory.mktemp("robot"))
    assert scope.kernel(case.model, case.robot.feet, False) == "tree"
    return case


@pytest.fixture(scope="module")
def g1():
    return made("g1", "")


def test_a_physics_step_is_that_of_c_mujoco(case):
    """Whole feet touch, edges, corners, one foot, all feet, none; joints beyond their range; and every robot
    has masses, armature and friction of its own."""
    touching, limited, feet = a_physics_step(case)
    assert touching > 60 and limited >= LIMITED.get(case.robot.name, 0)
    points = len(case.robot.feet) // len(case.robot.foot_names)
    points *= scope.TOUCHING[int(case.model.geom_type[case.robot.feet[0]])]
    assert set(range(1 + points)) <= set(feet.ravel().tolist())
    down = (feet > 0).sum(1)
    assert down.min() < 2 and down.max() == feet.shape[1] and len(set(down.tolist())) > 2


@pytest.mark.parametrize("every", [False, True])
def test_several_physics_steps_are_one_after_the_other(g1, every):
    """As calls of one physics step each, with the target of each; and the parts' lowest points of the last
    step, or of all."""
    several = made("g1", "", substeps=3, every=every)
    several.before["air_steps"][:], several.before["peak"][:] = 5, 0.01
    found = several_steps(g1, several)
    assert (found["contact_steps"] > 1).any() and (found["last_air_steps"] > 0).any()


def test_timers_and_peaks_are_those_of_a_plain_loop(g1):
    """Of feet that land, that have left the ground, that stay down."""
    rng, shape = np.random.default_rng(0), g1.before["air_steps"].shape
    air = rng.integers(0, 3, shape)
    start = {"air_steps": air, "contact_steps": (air == 0) * rng.integers(0, 9, shape)}
    start |= {"last_air_steps": np.full(shape, 7), "peak": rng.uniform(0, 0.01, shape)}
    start |= {"last_peak": np.full(shape, 0.3)}
    found = g1.step(g1.before | start)
    fresh = g1.step(g1.before)  # its peak is the height, or 0
    landed = (fresh["contact_steps"] > 0) & (air > 0)
    down = fresh["contact_steps"] > 0
    assert landed.any() and (down & ~landed).any() and (~down & (air == 0)).any()
    expected = {
        "air_steps": np.where(down, 0, air + 1),
        "contact_steps": np.where(down, start["contact_steps"] + 1, 0),
        "last_air_steps": np.where(landed, air + 1, 7),
        "peak": np.where(down, 0, np.maximum(start["peak"], fresh["peak"])),
        "last_peak": np.where(landed, start["peak"], 0.3),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-6, err_msg=name)


def test_rounds_stop_at_the_answer(g1):
    """With the six of the config the answer is hardly another."""
    rounds_stop(g1, few=(6, 10), worst=0.2)


@pytest.mark.slow  # a step, and several one after the other, are those of C MuJoCo
def test_a_drop_is_that_of_c_mujoco(g1):
    """Half a second: G1 falls on its feet, and its motors hold it."""
    steps, motors = made("g1", "", substeps=20), g1.motors.copy()
    motors[:, 1] *= 0.3  # with half of its armature a joint would chatter
    before = steps.before | {"motor": np.float32(np.broadcast_to(motors, (ROBOTS, 29, 8)))}
    home = steps.robot.home_qpos
    before["target"] = np.float32(np.broadcast_to(home[7:], (ROBOTS, 20, 29)))
    before["qpos"][:] = home
    before["qpos"][:, 2] += np.linspace(0.01, 0.05, ROBOTS)
    before["qvel"][:] = 0
    after = before
    for _ in range(5):
        after = steps.step(after)
    limits = ("effort_limit", "saturation_effort", "velocity_limit"), motors[:, 2:5].T
    limits = dict(zip(*limits, strict=True))
    for i in range(0, ROBOTS, 16):
        model, data = steps.of_robot(i)
        data.qpos[:], data.qvel[:] = before["qpos"][i], 0
        for _ in range(100):
            qd = data.qvel[6:].copy()
            torque = actuators.pd(home[7:], data.qpos[7:], qd, *motors[:, :2].T)
            drive(data, motors[:, 5] * actuators.clip_dc_motor(torque, qd, **limits), motors)
            mujoco.mj_step(model, data)
        assert data.ncon > 3
        np.testing.assert_allclose(after["qpos"][i], data.qpos, atol=1e-3)


def test_jax_calls_it(g1):
    """Fields of the model are one for all robots, or one a robot."""
    step = warp_call.make(g1.model, g1.robot, 1, False)
    fields = warp_call.model(g1.model)
    expected = g1.step(g1.before | {n: np.asarray(getattr(fields, n))[None] for n in arrays.MODEL})
    state = {n: jnp.asarray(g1.before[n], expected[n].dtype) for n in arrays.IN_OUT}

    def one(state, target, motor):
        return step(fields, SimpleNamespace(**state), target, motor)

    found = jax.jit(jax.vmap(one))(state, g1.before["target"], g1.before["motor"])
    for name in ("qpos", "qvel", "lowest", "peak", "contact_steps"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-5, err_msg=name)


def test_robots_of_one_size_share_a_kernel(g1):
    """What differs is in tables; so Warp's cache has it, and nothing is built again."""
    robot = g1.robot
    spec = mujoco.MjSpec.from_file(str(robot.xml))
    spec.body("left_knee_link").pos = [-0.08, 0, -0.2]
    other = robot_lib.physics_model(
        robot_lib.load_text(spec.to_xml(), "longer", robot.xml), physics("g1")
    )
    one, two = (tree.allocate(model, g1.shape).step for model in (g1.model, other))
    smaller = made("hexapod", "")
    three = tree.allocate(smaller.model, smaller.shape).step
    assert one is two and one.module is not three.module


def test_a_robot_that_blew_up_leaves_the_others_alone(g1):
    before = {name: value.copy() for name, value in g1.before.items()}
    before["qpos"][::2, 7] = np.nan
    found, expected = g1.step(before), g1.step(g1.before)
    assert np.isnan(found["qpos"][::2]).any(1).all()
    for name in ("qpos", "qvel", "torque", "lowest"):
        np.testing.assert_array_equal(found[name][1::2], expected[name][1::2])


@pytest.mark.slow
def test_mujoco_warps_own_step_is_the_same(g1):
    found, expected = g1.step(g1.before), g1.step(g1.before, general)
    for name, atol in dict(qpos=5e-6, qvel=1e-3, torque=1e-4, lowest=1e-5, peak=1e-5).items():
        np.testing.assert_allclose(found[name], expected[name], atol=atol, err_msg=name)
    np.testing.assert_array_equal(found["contact_steps"], expected["contact_steps"])

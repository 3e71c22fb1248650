"""Our kernel of a quadruped's control step against C MuJoCo in double precision, solved to the end."""

import copy

import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.physics import contacts
from dynappo.physics import robot as robot_lib

wp = pytest.importorskip("warp")

from dynappo.physics.warp import arrays, quadruped  # noqa: E402

ROBOTS = 64
MOTOR = (20.0, 0.5, 23.7, 28.0, 30.0, 0.9, 0.3, 1.0)  # arrays.MOTOR


class Case:
    """Robots near the floor, tilted, pushed, some joints beyond their range; and their numbers."""

    def __init__(self, name, substeps=1):
        config = config_lib.load(f"configs/{name}.py")
        config.physics.update(iterations=30, ls_iterations=30)
        self.robot = robot = robot_lib.load(name)
        self.model = model = robot_lib.physics_model(robot, config.physics)
        floor = np.column_stack(contacts.floor_distance(model, robot.parts))
        radius, parts = robot.foot_radius, robot.parts
        self.shape = arrays.Shape(substeps, False, robot.feet, radius, parts, floor)
        rng = np.random.default_rng(0)
        qpos = np.tile(model.key("home").qpos, (ROBOTS, 1))
        qpos[:, 2] -= rng.uniform(0, 0.05, ROBOTS)
        qpos[:, 3:7] += rng.normal(0, 0.2, (ROBOTS, 4))
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, 7:] += rng.normal(0, 0.3, (ROBOTS, 12))
        base = (np.arange(14) == 1)[:, None]
        scale = rng.uniform(0.8, 1.2, (ROBOTS, 14))
        self.fields = {
            "body_mass": model.body_mass * scale,
            "body_inertia": model.body_inertia * scale[..., None],
            # the base's only: C MuJoCo's search for contacts keeps boxes around the links' centres
            "body_ipos": model.body_ipos + rng.normal(0, 0.02, (ROBOTS, 1, 3)) * base,
            "geom_friction": model.geom_friction * rng.uniform(0.3, 1.5, (ROBOTS, 1, 1)),
            "dof_armature": model.dof_armature * rng.uniform(0.5, 2, (ROBOTS, 1)),
        }
        self.before = {name: np.zeros((ROBOTS, *size)) for name, size in self.sizes().items()}
        qvel = rng.normal(0, 0.7, (ROBOTS, 18))
        target = model.key("home").qpos[7:] + rng.normal(0, 0.3, (ROBOTS, substeps, 12))
        motor = np.tile(MOTOR, (ROBOTS, 1))
        given = self.fields | dict(qpos=qpos, qvel=qvel, target=target, motor=motor)
        self.before |= {name: np.asarray(x, np.float32) for name, x in given.items()}

    def sizes(self):
        return arrays.sizes(self.model, self.shape)

    def step(self, before):
        """What the kernel makes of the numbers `before`."""
        a = {}
        for name, size in self.sizes().items():
            kind = wp.vec3 if name in arrays.MODEL and len(size) == 2 else float
            a[name] = wp.array(before[name], dtype=int if name in arrays.COUNTS else kind)
        quadruped.control_step(quadruped.kept(self.model, self.shape), self.shape, a)
        return {name: x.numpy() for name, x in a.items()}

    def of_robot(self, i):
        """MuJoCo's model and data of robot i, its solver run to the end."""
        model = copy.copy(self.model)
        model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 200, 200, 0.0
        for name, values in self.fields.items():
            getattr(model, name)[:] = np.asarray(values[i], np.float32)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self.before["qpos"][i], self.before["qvel"][i]
        return model, data


@pytest.fixture(scope="module", params=["go1", "go2", "anymal_c", "anymal_d"])
def case(request):
    return Case(request.param)


def test_a_physics_step_is_that_of_c_mujoco(case):
    assert quadruped.fits(case.model, case.shape)
    found, touching, limits, seen = case.step(case.before), 0, 0, []
    for i in range(ROBOTS):
        model, data = case.of_robot(i)
        data.ctrl[:] = found["torque"][i]
        mujoco.mj_step(model, data)
        touching, limits = touching + data.ncon, limits + data.nl
        qacc = data.qacc_warmstart
        np.testing.assert_allclose(found["qacc_warmstart"][i], qacc, atol=3e-5 * abs(qacc).max())
        np.testing.assert_allclose(found["qvel"][i], data.qvel, atol=1e-4)
        np.testing.assert_allclose(found["qpos"][i], data.qpos, atol=1e-6)
        fixed, linear, ring = contacts.floor_distance(model, case.robot.parts)
        row = data.geom_xmat[case.robot.parts][:, 6:]
        drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(1 - row[:, 2] ** 2)
        low = data.geom_xpos[case.robot.parts, 2] - drop
        np.testing.assert_allclose(found["lowest"][i], low, atol=1e-6)
        height = data.geom_xpos[case.robot.feet, 2] - case.robot.foot_radius
        np.testing.assert_array_equal(found["contact_steps"][i], height < 0)
        np.testing.assert_array_equal(found["air_steps"][i], height >= 0)
        np.testing.assert_allclose(found["peak"][i], np.maximum(height, 0), atol=1e-6)
        seen.append((height < 0).sum())
    assert touching > 60 and limits > 0 and {0, 2} <= set(seen)


def test_several_physics_steps_are_one_after_the_other(case):
    """As calls of one physics step each; and the target of each."""
    several = Case(case.robot.name, substeps=3)
    found, after = several.step(several.before), several.before
    for substep in range(3):
        target = several.before["target"][:, substep : substep + 1]
        after = case.step(after | {"target": np.ascontiguousarray(target)})
    for name in (*arrays.KEPT, *arrays.TOLD):
        atol = 2e-2 if name == "qacc_warmstart" else 1e-4  # rad/s2: contacts are stiff
        np.testing.assert_allclose(found[name], after[name], atol=atol, err_msg=name)


def test_rounds_stop_at_the_answer(case):
    """Ten times the rounds change nothing, and the four of the configs hardly."""
    found = case.step(case.before)["qacc_warmstart"]
    case.model.opt.iterations = 300
    np.testing.assert_allclose(
        case.step(case.before)["qacc_warmstart"], found, rtol=1e-4, atol=1e-3
    )
    case.model.opt.iterations, case.model.opt.ls_iterations = 4, 8
    few = case.step(case.before)["qacc_warmstart"]
    off = abs(few - found).max(1) / abs(found).max(1)
    assert np.median(off) < 1e-5 and off.max() < 0.1


@pytest.mark.parametrize(
    "change",
    ["integrator", "disableflags", "density", "noslip_iterations", "jnt_margin", "jnt_stiffness"],
)
def test_what_the_kernel_does_not_compute_is_left_to_mujoco_warp(change):
    case = Case("go1")
    other = copy.copy(case.model)
    assert quadruped.fits(other, case.shape)
    if hasattr(other.opt, change):
        setattr(other.opt, change, 1)
    else:
        getattr(other, change)[1:] = 0.01
    assert not quadruped.fits(other, case.shape)

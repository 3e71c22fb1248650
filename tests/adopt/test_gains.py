"""Gains and limits of an adopted robot, against what the files say and a simulation by hand."""

import copy

import mujoco
import numpy as np
import published
import pytest
from toy_policy import ROBOTS

from dynappo.adopt import gains, source
from dynappo.physics import robot as robot_lib

NONE = source.Published(*np.full((4, 12), np.nan), np.zeros(12, bool))


def test_a_servo_s_numbers_are_read(tmp_path):
    """kp and forcerange of the servo; its kd is the joint's damping."""
    read = source.read(published.write(tmp_path))
    names = "FR_hip_joint", "FL_calf_joint"
    found, _ = source.published(read, names)
    np.testing.assert_allclose(found.kp, 100)
    np.testing.assert_allclose(found.kd, 2)
    np.testing.assert_allclose(found.effort, [23.7, 35.5])
    assert found.servo.all() and np.isnan(found.velocity).all()


@pytest.mark.parametrize(
    ("actuator", "kp", "kd", "effort"),
    [
        ('<motor joint="a" ctrlrange="-2 2" gear="10"/>', np.nan, np.nan, 20),
        ('<motor joint="a"/>', np.nan, np.nan, 7),
        ('<position joint="a" kp="3" kv="0.5" gear="2" forcerange="-1 1"/>', 12, 2.1, 2),
        ('<general joint="a" biastype="affine" gainprm="50" biasprm="0 -50 -0.5"/>', 50, 0.6, 7),
        ("", np.nan, np.nan, 7),
    ],
)
def test_numbers_of_each_kind_of_actuator(actuator, kp, kd, effort, tmp_path):
    """The joint has damping 0.1 and lets 7 N m through, if nothing smaller comes before; here 100."""
    limit = 7 if effort == 7 else 100
    file = tmp_path / "a.xml"
    file.write_text(
        '<mujoco><worldbody><body><freejoint/><geom size="1"/><body><joint name="a" damping="0.1" '
        f'actuatorfrcrange="-{limit} {limit}"/><geom size="1"/></body></body></worldbody>'
        f"<actuator>{actuator}</actuator></mujoco>"
    )
    found, _ = source.published(source.read(file), ("a",))
    np.testing.assert_allclose([*found.kp, *found.kd, *found.effort], [kp, kd, effort])


@pytest.mark.parametrize("name", ROBOTS)
def test_by_rule_every_robot_here_stands_and_is_stable(name):
    """Without a word on its motors: no joint is damped by more than half in a step, by the eigenvalues of the
    linear map; a simulation by hand sinks by less than 15 %; exploration asks for a third at most."""
    robot = robot_lib.load(name)
    found, told = gains.choose(robot, NONE, 0.5)
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    damped = np.linalg.eigvals(np.linalg.inv(inertia)[6:, 6:] @ np.diag(found.kd)).real * 0.005
    assert damped.max() < 0.5
    for _ in range(400):
        error = robot.default_pose - data.qpos[7:]
        torque = found.kp * error - found.kd * data.qvel[6:]
        data.ctrl[:] = np.maximum(np.minimum(torque, found.effort_limit), -found.effort_limit)
        mujoco.mj_step(model, data)
    assert data.qpos[2] > (1 - 0.15) * robot.home_qpos[2]
    assert (found.kp * found.action_scale * 0.5 <= found.effort_limit * 0.35).all()
    assert (found.action_scale <= 0.5).all()
    mass = model.body_mass.sum()
    ruled = 0.45 * mass * 9.81 * robot.home_qpos[2]
    np.testing.assert_allclose(found.effort_limit, ruled, rtol=0.01)
    assert len(told) == 5 and told[0].startswith("effort: no limit in the file")


def test_light_rotors_get_less_damping():
    """A calf without armature: kp x 0.025 s would be unstable in a step of 5 ms."""
    robot = robot_lib.load("go1")
    model = copy.copy(robot.mj_model)
    model.dof_armature[:] = 0
    found, _ = gains.choose(robot._replace(mj_model=model), NONE, 1.0)
    assert robot_lib.damping_rate(robot._replace(mj_model=model), found.kd, 0.005) < 0.45
    assert found.kd[2] < found.kp[2] * 0.02 and found.kd[0] > found.kd[2]


def published_go1(kp, kd, effort):
    nan = np.full(12, np.nan)
    return source.Published(
        np.full(12, kp), np.full(12, kd), np.full(12, effort), nan, np.ones(12, bool)
    )


def test_a_servo_s_gains_are_kept_only_if_a_policy_can_use_them():
    robot = robot_lib.load("go1")
    found, told = gains.choose(robot, published_go1(30.0, 0.6, 23.7), 1.0)
    assert set(found.kp) == {30.0} and set(found.kd) == {0.6} and "of the file" in told[1]
    for kp, kd, why in ((100.0, 0.5, "whole effort"), (30.0, 2.0, "in a step"), (9.0, 0.3, "hold")):
        found, told = gains.choose(robot, published_go1(kp, kd, 23.7), 1.0)
        assert why in told[1] and kp not in found.kp


def test_an_effort_that_no_motor_has_is_not_believed():
    robot = robot_lib.load("go1")
    found, told = gains.choose(robot, published_go1(30.0, 0.6, 1000.0), 1.0)
    assert found.effort_limit.max() < 30 and "the file's 1000 N m is more than" in told[0]

"""Gains and limits of an adopted robot, against what the files say and a simulation by hand."""

import copy

import mujoco
import numpy as np
import published
import pytest
from toy_policy import ROBOTS

from dynappo.adopt import gains, normal, source
from dynappo.description import complete, feet, text
from dynappo.description import robot as robot_lib

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
        ('<velocity joint="a" kv="3" ctrlrange="-2 2"/>', np.nan, np.nan, 7),
        (
            '<motor joint="a" ctrlrange="-2 2"/><motor joint="a" ctrlrange="-3 3"/>',
            *[np.nan] * 2,
            5,
        ),
        ('<motor joint="a" ctrlrange="-2 2"/><motor joint="a"/>', np.nan, np.nan, 7),
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
    ruled = mass * 9.81 * robot.home_qpos[2] * 0.45
    np.testing.assert_allclose(found.effort_limit, ruled, rtol=0.01)
    assert len(told) == 5 and told[0].startswith("effort: no limit in the file")


SHARES = {  # of m g l, by the names that a G1's joints have
    "hip": 0.45, "knee": 0.45, "ankle": 0.15, "waist": 0.3, "shoulder": 0.08, "elbow": 0.08, "wrist": 0.08,
}  # fmt: skip


def test_a_humanoid_without_limits_has_weaker_motors_in_ankles_and_arms():
    robot = robot_lib.load("g1")
    none = source.Published(*np.full((4, 29), np.nan), np.zeros(29, bool))
    found, told = gains.efforts(robot, none)
    whole = robot.mj_model.body_mass.sum() * 9.81 * robot.home_qpos[2]
    shares = [next(s for word, s in SHARES.items() if word in name) for name in robot.joint_names]
    np.testing.assert_allclose(found, np.array(shares) * whole, rtol=0.01)
    for part in ("hips and knees 0.45 m g l = 111.4", "ankles 0.15", "waists 0.3", "others 0.08"):
        assert part in told[0]


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
    assert set(found.kp) == {30.0} and set(found.kd) == {0.6}
    assert told[1:3] == ["kp: 30 N m/rad, of the file", "kd: 0.6 N m s/rad, of the file"]
    for kp, kd, why in ((100.0, 0.5, "whole effort"), (9.0, 0.3, "do not hold the robot up")):
        found, told = gains.choose(robot, published_go1(kp, kd, 23.7), 1.0)
        assert why in told[1] and kp not in found.kp


def test_a_servo_s_damping_is_lowered_until_it_is_stable():
    """By the eigenvalues; the stiffness stays the file's."""
    robot = robot_lib.load("go1")
    found, told = gains.choose(robot, published_go1(30.0, 2.0, 23.7), 1.0)
    assert set(found.kp) == {30.0} and found.kd.min() > 0.2
    assert robot_lib.damping_rate(robot, found.kd, 0.005) < 0.45
    assert "not the file's 2, with which kd takes" in told[2] and "of the file" in told[1]


def test_each_kind_of_joint_keeps_its_own_servo_or_not():
    """The calves' kp of 100 would be at the limit after 0.24 rad; one hip has no servo."""
    robot = robot_lib.load("go1")
    given = published_go1(30.0, 0.6, 23.7)
    given.kp[2::3], given.servo[0] = 100.0, False
    found, told = gains.choose(robot, given, 1.0)
    assert set(found.kp[1::3]) == {30.0} and set(found.kd[1::3]) == {0.6}
    assert 100.0 not in found.kp and 30.0 not in found.kp[::3]
    said = "\n".join(told)
    assert "kp: 30 N m/rad at thigh_joint, of the file" in said
    assert "N m/rad at hip_joint, calf_joint" in said


def test_what_the_file_says_of_some_joints_only_is_said_so():
    """Limits at the hips, none at the thighs, and one that no motor has at the calves."""
    robot, nan = robot_lib.load("go1"), np.full(12, np.nan)
    effort, speed = np.tile([20.0, np.nan, 1e9], 4), np.tile([np.nan, 25.0, 1e9], 4)
    found, told = gains.choose(
        robot, source.Published(nan, nan, effort, speed, np.zeros(12, bool)), 1.0
    )
    whole = robot.mj_model.body_mass.sum() * 9.81 * robot.home_qpos[2]
    rule = round(0.45 * whole, 1)
    np.testing.assert_allclose(found.effort_limit, np.tile([20.0, rule, rule], 4))
    np.testing.assert_allclose(found.velocity_limit, np.tile([30.0, 25.0, 30.0], 4))
    assert "effort: 20 N m at hip_joint, of the file" in told
    assert f"effort: no limit in the file at thigh_joint; 0.45 m g l = {rule:g} N m" in told
    odd = [line for line in told if line.startswith("effort: the file's 1e+09 N m at calf_joint")]
    assert len(odd) == 1 and odd[0].endswith(f"; 0.45 m g l = {rule:g} N m")
    assert "speed: no limit in the file at hip_joint; 30 rad/s" in told
    assert "speed: 25 rad/s at thigh_joint, of the file" in told


def test_springs_that_lift_a_robot_and_motors_that_do_not_hold_it_are_told():
    robot = robot_lib.load("go1")
    lifted = copy.copy(robot.mj_model)
    lifted.jnt_stiffness[1:], lifted.qpos_spring[7:] = 12.0, 0.2
    _, told = gains.choose(robot._replace(mj_model=lifted), NONE, 1.0)
    assert any("it rises by" in line for line in told), told
    weak = source.Published(*np.full((2, 12), np.nan), np.full(12, 2.0), np.full(12, np.nan),
                            np.zeros(12, bool))  # fmt: skip
    _, told = gains.choose(robot, weak, 1.0)
    assert any("the robot does not stand: it sinks by" in line for line in told)


def test_parts_that_would_touch_the_ground_are_shortened():
    """A capsule along a thigh that touches the ground as the robot sinks: it ends 1 cm above it then."""
    robot = robot_lib.load("anymal_c")
    spec = mujoco.MjSpec.from_file(str(robot.xml))
    thigh = robot.mj_model.body(robot.mj_model.jnt_bodyid[2]).name
    spec.body(thigh).add_geom(name="long", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.02, 0.25, 0],
                              pos=[0, 0, -0.25], mass=0, contype=0, conaffinity=1)  # fmt: skip
    spec = mujoco.MjSpec.from_string(text.self_contained(complete.complete(spec).spec))
    spec.compile()
    robot = robot_lib.load_text(spec.to_xml(), "long", robot.xml)
    sunk = robot.home_qpos - np.eye(1, robot.mj_model.nq, 2)[0] * 0.09
    assert feet.lowest_points(robot.mj_model, sunk, [robot.mj_model.geom("long").id]) < 0
    assert normal.clear(spec, robot, robot.home_qpos[None]) == []
    told = normal.clear(spec, robot, np.stack([robot.home_qpos, sunk]))
    assert [line for line in told if line.endswith("stands: long")]
    assert [line for line in told if line.endswith("LF_shank, RF_shank, LH_shank, RH_shank")]
    model = spec.compile()
    part = model.geom("long").id
    assert feet.lowest_points(model, sunk, [part]) == pytest.approx(0.01, abs=1e-6)
    sunk[2] = 0.3 * robot.home_qpos[2]
    assert normal.clear(spec, robot, sunk[None]) == []  # it lies


def test_an_effort_that_no_motor_has_is_not_believed():
    robot = robot_lib.load("go1")
    found, told = gains.choose(robot, published_go1(30.0, 0.6, 1000.0), 1.0)
    assert found.effort_limit.max() < 30 and "the file's 1000 N m is more than" in told[0]

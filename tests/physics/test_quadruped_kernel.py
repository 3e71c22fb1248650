"""Our kernel of a quadruped's control step against C MuJoCo in double precision, solved to the end."""

import mujoco
import numpy as np
import pytest

from dynappo.description import contacts
from dynappo.physics import actuators
from dynappo.physics.warp import arrays

pytest.importorskip("warp")

from kernel_case import MOTOR, ROBOTS, Case, drive  # noqa: E402

# a motor of its own at each joint [12, 8]; the share, 1, is without lag
EACH = np.array(MOTOR) * (1 + 0.1 * np.arange(12)[:, None] * (np.arange(8) < 7))


@pytest.fixture(scope="module", params=["go1", "go2", "anymal_c", "anymal_d", "go1 each"])
def case(request):
    name, _, each = request.param.partition(" ")
    case = Case(name, motors=EACH if each else MOTOR)
    case.motors = EACH if each else MOTOR
    return case


def test_a_physics_step_is_that_of_c_mujoco(case):
    kp, kd, effort, stall, speed, strength, *_ = np.transpose(case.motors)
    found, touching, limited, seen = case.step(case.before), 0, 0, []
    for i in range(ROBOTS):
        model, data = case.of_robot(i)
        before = data.qvel[6:].copy()
        pd = actuators.pd(case.before["target"][i, 0], data.qpos[7:], before, kp, kd)
        limits = dict(effort_limit=effort, saturation_effort=stall, velocity_limit=speed)
        torque = strength * actuators.clip_dc_motor(pd, before, **limits)
        np.testing.assert_allclose(found["torque"][i], torque, atol=2e-5)
        drive(data, torque, case.motors)
        mujoco.mj_step(model, data)
        touching, limited = touching + data.ncon, limited + data.nl
        qacc = data.qacc_warmstart
        np.testing.assert_allclose(found["qacc_warmstart"][i], qacc, atol=3e-5 * abs(qacc).max())
        np.testing.assert_allclose(found["qvel"][i], data.qvel, atol=1e-4)
        np.testing.assert_allclose(found["qpos"][i], data.qpos, atol=1e-6)
        fixed, linear, ring = contacts.floor_distance(model, case.robot.parts)
        row = data.geom_xmat[case.robot.parts][:, 6:]
        drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(1 - row[:, 2] ** 2)
        low = data.geom_xpos[case.robot.parts, 2] - drop
        np.testing.assert_allclose(found["lowest"][i], low, atol=1e-6)
        height = data.geom_xpos[case.robot.feet, 2] - model.geom_size[case.robot.feet, 0]
        np.testing.assert_array_equal(found["contact_steps"][i], height < 0)
        np.testing.assert_array_equal(found["air_steps"][i], height >= 0)
        np.testing.assert_allclose(found["peak"][i], np.maximum(height, 0), atol=1e-6)
        seen.append((height < 0).sum())
    assert touching > 60 and limited > 0 and {0, 2} <= set(seen)


def test_several_physics_steps_are_one_after_the_other(case):
    """As calls of one physics step each; and the target of each."""
    several = Case(case.robot.name, substeps=3, motors=case.motors)
    found, after = several.step(several.before), several.before
    for substep in range(3):
        target = several.before["target"][:, substep : substep + 1]
        after = case.step(after | {"target": np.ascontiguousarray(target)})
    for name in (*arrays.IN_OUT, *arrays.RESULTS):
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


def test_the_motors_of_mujoco_warps_own_step_are_a_loop_over_joints():
    """kernels.motors, with numbers for all joints and for each, of every robot its own."""
    import warp as wp

    from dynappo.physics.warp import kernels

    rng, robots = np.random.default_rng(0), 5
    qpos, qvel = rng.normal(size=(robots, 19)), rng.normal(size=(robots, 18)) * 20
    target, before = rng.normal(size=(robots, 2, 12)), rng.normal(size=(robots, 12))
    for width in (1, 12):
        motor = np.array(MOTOR) * rng.uniform(0.5, 1, (robots, width, 8))  # they lag too
        given = (1, *(wp.array(x, dtype=float) for x in (target, motor, qpos, qvel)))
        found = [wp.array(before, dtype=float), wp.zeros((robots, 18)), wp.zeros((robots, 12))]
        wp.launch(kernels.motors, dim=(robots, 12), inputs=[*given], outputs=found)
        torque, applied, qd_before = (x.numpy() for x in found)
        for robot in range(robots):
            for joint in range(12):
                kp, kd, effort, stall, speed, strength, friction, share = motor[
                    robot, joint if width > 1 else 0
                ]
                qd = qvel[robot, 6 + joint]
                wanted = kp * (target[robot, 1, joint] - qpos[robot, 7 + joint]) - kd * qd
                held = min(max(qd, -speed * (1 + effort / stall)), speed * (1 + effort / stall))
                upper = min(stall * (1 - held / speed), effort)
                lower = max(stall * (-1 - held / speed), -effort)
                wanted = strength * min(max(wanted, lower), upper)
                old = before[robot, joint]
                assert torque[robot, joint] == pytest.approx(old + share * (wanted - old), abs=1e-4)
                rubs = -friction * np.tanh(qd / 0.2)
                assert applied[robot, 6 + joint] == pytest.approx(rubs, abs=1e-5)
                assert qd_before[robot, joint] == pytest.approx(qd, rel=1e-6)
        assert np.abs(applied[:, :6]).max() == 0

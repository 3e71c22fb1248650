"""Our kernel of a quadruped's control step against C MuJoCo in double precision, solved to the end."""

import numpy as np
import pytest

pytest.importorskip("warp")

from kernel_case import MOTOR, Case, a_physics_step, rounds_stop, several_steps  # noqa: E402

# a motor of its own at each joint [12, 8]; the share, 1, is without lag
EACH = np.array(MOTOR) * (1 + 0.1 * np.arange(12)[:, None] * (np.arange(8) < 7))

# of the same size as one of the others
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("go1", "go2", "anymal_d")]


@pytest.fixture(scope="module", params=["anymal_c", "go1 each", *SLOW])
def case(request):
    name, _, each = request.param.partition(" ")
    return Case(name, motors=EACH if each else MOTOR)


def test_a_physics_step_is_that_of_c_mujoco(case):
    touching, limited, feet = a_physics_step(case)
    assert touching > 60 and limited > 0 and {0, 2} <= set(feet.sum(1))


def test_several_physics_steps_are_one_after_the_other(case):
    """As calls of one physics step each; and the target of each."""
    several_steps(case, Case(case.robot.name, substeps=3, motors=case.motors))


def test_rounds_stop_at_the_answer(case):
    """With the four of the configs the answer is hardly another."""
    rounds_stop(case, few=(4, 8))


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

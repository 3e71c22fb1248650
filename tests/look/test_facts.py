"""What is said of a robot before training, against the linear map of its PD and an episode by hand."""

import mujoco
import numpy as np
import pytest
from toy_policy import ROBOTS, described

from dynappo.look import facts
from dynappo.policy import episode, policy_file


def radius(robot, kp, kd, dt):
    """The largest eigenvalue of one step of the whole robot, base free, about its default pose."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    motors = np.diag(np.arange(model.nv) >= 6).astype(float)
    pull, one = dt * np.linalg.solve(inertia, motors), np.eye(model.nv)
    gains = [np.concatenate([np.zeros(6), np.broadcast_to(gain, 12)]) for gain in (kp, kd)]
    speed = np.hstack([-pull * gains[0], one - pull * gains[1]])
    return np.abs(
        np.linalg.eigvals(np.vstack([np.hstack([one, 0 * one]) + dt * speed, speed]))
    ).max()


EACH = np.linspace(10.0, 400.0, 12), np.linspace(2.0, 0.1, 12)  # a number of each joint


@pytest.mark.parametrize(
    ("kp", "kd"),
    [(None, None), (400.0, 0.3), (10.0, 20.0), (0.0, 1.0), EACH],
    ids=["own", "stiff", "damped", "no kp", "each"],
)
@pytest.mark.parametrize("name", ROBOTS)
def test_the_longest_step_is_where_an_eigenvalue_leaves_the_circle(name, kp, kd):
    """The base is free: its own eigenvalues are one, doubled, so that they are so only about."""
    config, robot = described(name)
    kp, kd = config.task.kp if kp is None else kp, config.task.kd if kd is None else kd
    found = facts.pd(robot, kp, kd, 0.005)
    assert radius(robot, kp, kd, found.longest * 0.99) < 1 + 1e-5
    assert radius(robot, kp, kd, found.longest * 1.01) > 1 + 1e-3
    assert facts.pd(robot, kp, kd, found.longest).bound == pytest.approx(2)


def test_each_torque_is_a_share_of_its_own_motors_limit():
    config, robot = described("go2")
    policy = policy_file.describe(config, robot)
    limits = np.where(np.arange(12) % 3 == 2, 3.0, 30.0)  # weak calves
    body = episode.load(
        robot.xml, policy._replace(effort_limit=limits, saturation_effort=limits), 0.005
    )
    _, found = facts.stand(body)
    assert found["share"].max() == 1.0 and found["share"].argmax() % 3 == 2
    np.testing.assert_allclose(found["share"], np.abs(found["torque"]) / limits)


def test_a_robot_stands_as_by_hand():
    """Height and torques of the last second, by the steps that every episode takes."""
    config, robot = described("go2")
    body = episode.load(robot.xml, policy_file.describe(config, robot), 0.005)
    rows, found = facts.stand(body)
    data, heights, torques = mujoco.MjData(body.model), [], []
    episode.reset(body, data)
    for _ in range(250):
        episode.step(body, data, np.zeros(12))
        heights.append(data.qpos[2])
        torques.append(data.qfrc_applied[6:].copy())
    assert len(rows["qpos"]) == 250 and found["fall"] is None
    assert found["rest"] == pytest.approx(heights[-1], abs=1e-6)
    assert found["moved"] == pytest.approx(np.ptp(heights[-50:]), abs=1e-6)
    np.testing.assert_allclose(found["torque"], np.mean(torques[-50:], 0), atol=0.05)
    assert np.abs(found["torque"]).max() > 1

"""Measures a robot before training: whether its PD is stable, and how it stands."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dynappo.physics import robot as robot_lib
from dynappo.policy import episode as episode_lib
from dynappo.policy.episode import Body

SECONDS = 5.0  # of standing
LAST = 1.0  # s at its end, over which it should be at rest


class PD(NamedTuple):
    """How the explicit PD of a config does at its time step, at the joints' fastest mode.

    A joint of inverse inertia `l` (1/(kg m^2)) does v += -dt l (kp q + kd v), q += dt v. With
    a = dt kd l and b = dt^2 kp l it is stable where a + b / 2 < 2, and its speed keeps its sign
    where a < 1. Damping in the MJCF is computed implicitly, and only adds to this.
    """

    damping: float  # a: the share of a joint's speed that damping takes off in a step
    bound: float  # a + b / 2, of 2
    longest: float  # s, the time step at which it would be 2


def pd(robot: robot_lib.Robot, kp: float, kd: float, timestep: float) -> PD:
    """The PD of gains `kp` (N m/rad) and `kd` (N m s/rad) in the robot's default pose."""
    fastest = robot_lib.damping_rate(robot, 1.0, 1.0)  # 1/(kg m^2)
    a, b = timestep * kd * fastest, timestep**2 * kp * fastest
    # kd l t + kp l t^2 / 2 = 2, written so that kp = 0 is no division by zero
    longest = 4 / (kd * fastest + np.sqrt((kd * fastest) ** 2 + 4 * kp * fastest))
    return PD(a, a + b / 2, float(longest))


def stand(body: Body) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """`(episode, numbers)` of five seconds under zero action: the PD holds the default pose.

    `rest` (m): height of the base at the end; `moved` (m): how much it changed in the last second;
    `torque [A]` (N m): what each motor holds then, kp times the joint's mean error; `fall` (s): when
    a part that is no foot touched the ground, or None.
    FloatingPointError if the physics blows up.
    """
    p, count = body.policy, len(body.policy.joint_names)
    episode = episode_lib.play(body, lambda obs: np.zeros(count), lambda t: np.zeros(3), SECONDS)
    last = slice(-max(1, round(LAST / episode_lib.period(body))), None)
    heights = episode["qpos"][:, body.root[0] + 2]
    error = (p.default_pose - episode["qpos"][last][:, body.joint_q]).mean(0)
    numbers = {
        "rest": float(heights[-1]),
        "moved": float(np.ptp(heights[last])),
        "torque": np.clip(p.kp * error, -p.effort_limit, p.effort_limit),
        "fall": episode_lib.measures(body, episode)["fall"],
    }
    return episode, numbers

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

    Joints of mass matrix M do v += -dt M^-1 (K q + D v), q += dt v, with gains K and D on the diagonal.
    That is stable where no eigenvalue of M^-1 (dt D + dt^2 K / 2) reaches 2: there a mode turns round at
    every step with the same size. The speed keeps its sign where those of dt M^-1 D are below 1. Damping
    in the MJCF is computed implicitly, and only adds to this.
    """

    damping: float  # the share of a joint's speed that damping takes off in a step
    bound: float  # the largest eigenvalue, of 2
    longest: float  # s, the time step at which it would be 2


def pd(robot: robot_lib.Robot, kp, kd, timestep: float) -> PD:
    """The PD of gains `kp` (N m/rad) and `kd` (N m s/rad), numbers or arrays [A], in the default pose."""
    both = timestep * np.asarray(kd) + timestep**2 * np.asarray(kp) / 2
    bound = robot_lib.damping_rate(robot, both, 1.0)
    # 2 is an eigenvalue at dt = 1 / w: 2 w^2 x = M^-1 (w D + K / 2) x, of which the largest w counts
    mobility, count = robot_lib.joint_mobility(robot), len(robot.joint_names)
    companion = np.zeros((2 * count, 2 * count))
    companion[:count, count:] = np.eye(count)
    companion[count:, :count] = mobility * np.broadcast_to(kp, count) / 4
    companion[count:, count:] = mobility * np.broadcast_to(kd, count) / 2
    longest = 1 / np.linalg.eigvals(companion).real.max()
    return PD(robot_lib.damping_rate(robot, kd, timestep), bound, float(longest))


def stand(body: Body) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """`(episode, numbers)` of five seconds under zero action: the PD holds the default pose.

    `rest` (m): height of the base at the end; `moved` (m): how much it changed in the last second;
    `torque [A]` (N m): what each motor holds then, kp times the joint's mean error, and `share [A]` of its
    limit; `fall` (s): when
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
        "torque": (torque := np.clip(p.kp * error, -p.effort_limit, p.effort_limit)),
        "share": np.abs(torque) / p.effort_limit,
        "fall": episode_lib.measures(body, episode)["fall"],
    }
    return episode, numbers

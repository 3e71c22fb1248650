"""Measures a robot before training: whether its PD is stable, and how it stands."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from dynappo.description import feet
from dynappo.description import robot as robot_lib
from dynappo.policy import episode as episode_lib
from dynappo.policy.episode import Player

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
    joint: str  # the one that damping slows most


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
    slowed = robot.joint_names[int(np.argmax(np.diag(mobility) * np.broadcast_to(kd, count)))]
    return PD(robot_lib.damping_rate(robot, kd, timestep), bound, float(longest), slowed)


def stand(body: Player) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """`(episode, numbers)` of five seconds under zero action: the PD holds the default pose.

    - `fall` (s): when the part `fell_on` touched the ground, or None
    - `rest` (m): height of the base at the end; if a robot on one or two feet falls, halfway to its fall
    - `moved` (m): how much the height changed in the last second
    - `slid` (m): how far the feet went after the first second, until a fall
    - `sunk` (m): how deep the lowest foot is in the floor then
    - `torque [A]` (N m): what each motor holds in the last second, kp times the joint's mean error
    - `share [A]`: the share of the motor's limit that this is

    FloatingPointError if the physics blows up.
    """
    p, count = body.policy, len(body.policy.joint_names)
    episode = episode_lib.play(body, lambda obs: np.zeros(count), lambda t: np.zeros(3), SECONDS)
    fall = episode_lib.measures(body, episode)["fall"]
    last, end = max(1, round(LAST / episode_lib.period(body))), len(episode["qpos"])
    if fall is not None and balances(body):
        end = max(1, round(fall / 2 / episode_lib.period(body)))
    shown = slice(max(0, end - last), end)
    heights = episode["qpos"][:, body.root[0] + 2]
    error = (p.default_pose - episode["qpos"][shown][:, body.joint_q]).mean(0)
    most = limit(p)
    torque = np.clip(p.kp * error, -most, most)
    until = end if fall is None else max(1, round(fall / episode_lib.period(body)))
    begun, ended = (_feet(body, episode["qpos"][i]) for i in (min(last, until) - 1, until - 1))
    numbers = {
        "fall": fall,
        "fell_on": "" if fall is None else _lowest_part(body, episode["qpos"][until - 1]),
        "rest": float(heights[end - 1]),
        "moved": float(np.ptp(heights[shown])),
        "slid": float(np.linalg.norm((ended - begun)[:, :2], axis=1).max()),
        "sunk": float(-ended[:, 2].min()),
        "torque": torque,
        "share": np.abs(torque) / most,
    }
    return episode, numbers


def limit(motors) -> np.ndarray:
    """The largest torque (N m) of the motors of a config's group `task`, or a policy: one number or one for
    each joint. A motor that stands gives no more than `saturation_effort` (actuators.clip_dc_motor)."""
    return np.minimum(motors.effort_limit, motors.saturation_effort)


def balances(body: Player) -> bool:
    """Whether a robot must balance: one on one or two feet falls over without a policy."""
    return len(body.foot_names) < 3


def _feet(body: Player, qpos: np.ndarray) -> np.ndarray:
    """x and y of each foot's first shape, and the height of its lowest point (m), [F, 3]."""
    data = mujoco.MjData(body.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(body.model, data)
    first = [np.flatnonzero(body.foot_of == foot)[0] for foot in range(len(body.foot_names))]
    places = data.geom_xpos[first]
    places[:, 2] = episode_lib.foot_heights(body, data)
    return places


def _lowest_part(body: Player, qpos: np.ndarray) -> str:
    """The name of the lowest part."""
    parts = np.flatnonzero(body.parts)
    if not len(parts):
        return "a part"
    model, low = body.model, feet.lowest_points(body.model, qpos, parts).argmin()
    return model.geom(parts[low]).name or model.body(model.geom_bodyid[parts[low]]).name or "a part"


def explores(robot: robot_lib.Robot, config) -> np.ndarray:
    """Share [A] of each motor's `limit` that exploration asks for: kp x action_scale x ppo.init_std /
    limit."""
    task = config.task
    asked = np.multiply(task.kp, task.action_scale) * config.ppo.init_std
    return np.broadcast_to(asked / limit(task), len(robot.joint_names))


def low_parts(robot: robot_lib.Robot, below: float) -> list[str]:
    """The parts lower than `below` (m) in the default pose, each with its height in mm."""
    heights = feet.lowest_points(robot.mj_model, robot.home_qpos, robot.parts)
    names = [
        robot.mj_model.geom(g).name or robot.mj_model.body(robot.mj_model.geom_bodyid[g]).name
        for g in robot.parts
    ]
    low = [(h, n) for h, n in zip(heights, names, strict=True) if h < below]
    return [f"{name} {height * 1e3:.0f} mm" for height, name in sorted(low)]

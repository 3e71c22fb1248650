"""A policy's walk on C MuJoCo, and what it is like: tracking, air time of the feet, tilt."""

import itertools

import mujoco
import numpy as np

from dynappo.description import robot as robot_lib
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, walks


def walk(policy: policy_file.Policy, speed: float, seconds: float):
    """Measures of a walk ahead at `speed` m/s from standing, until it falls."""
    robot = robot_lib.load(policy.robot)
    body = episode_lib.load(robot.xml, policy, policy.timestep)
    act = policy_file.actor(policy.params, policy.activation)
    command = np.array([speed, 0.0, 0.0])
    every = episode_lib.rows(body, mujoco.MjData(body.model), act, lambda _: command)
    some = []
    for row in itertools.islice(every, round(seconds / episode_lib.period(body))):
        some.append(row)
        if row["fell"]:
            break
    episode = episode_lib.stack(body, some)
    names = ("tracking_error", "yaw_error", "fall", "distance", "cost_of_transport")
    measures = episode_lib.measures(body, episode)
    return {name: measures[name] for name in names} | style(body, episode)


def style(body: episode_lib.Player, episode) -> dict:
    """After the first second: mean air time (s) of a swing of a foot, swings of a foot in a second,
    tilt (degrees, root mean square), forward speed (m/s). None where it walked no longer than that."""
    dt = float(episode["dt"])
    qpos = episode["qpos"][round(walks.SETTLE / dt) :]
    names = ("air_time", "swings_per_second", "tilt", "speed_ahead")
    if len(qpos) < 2:
        return dict.fromkeys(names)
    data, heights = mujoco.MjData(body.model), []
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(body.model, data)
        heights.append(episode_lib.foot_heights(body, data))
    swings = air_phases(np.array(heights) > 0)
    upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)  # of the quaternion: cosine of the tilt
    tilt = np.degrees(np.arccos(np.clip(upright, -1, 1)))
    ahead = episode["velocity"][-len(qpos) :, 0].mean()
    values = (
        np.mean(swings) * dt if len(swings) else None,
        len(swings) / len(body.foot_names) / (len(qpos) * dt),
        float(np.sqrt((tilt**2).mean())),
        float(ahead),
    )
    return dict(zip(names, values, strict=True))


def air_phases(air: np.ndarray) -> np.ndarray:
    """Lengths in rows of all swings of `air` [T, F], bool, that begin and end within it."""
    lengths = []
    for foot in air.T.astype(int):
        change = np.flatnonzero(np.diff(foot))
        begins = change[foot[change] == 0]  # the last row on the ground
        for begin in begins:
            ends = change[change > begin]
            if len(ends):
                lengths.append(ends[0] - begin)
    return np.array(lengths, int)

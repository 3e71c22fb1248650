"""The left-right mirror image of observations and actions: `images(robot, layout)`.

It is computed from the robot's model: the partner of a joint is the joint at the mirrored place in
the home pose; the two axes decide the sign. NumPy and C MuJoCo only.
"""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.config import ConfigError, per_joint
from dynappo.physics.robot import Robot
from dynappo.tasks.velocity import observe, view
from dynappo.types import Mirror

CLOSE = 5e-3  # m; of axes, no unit; of the home pose, rad
# the mirror has the base's y axis as its normal
MOVES, TURNS = np.array(observe.MOVES, float), np.array(observe.TURNS, float)


def joints(robot: Robot) -> Mirror:
    """Mirror of joint positions, velocities, actions [A]; ConfigError if a joint has no partner."""
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_forward(robot.mj_model, data)
    place, axis = data.xanchor[1:] - robot.home_qpos[:3], data.xaxis[1:]
    index = np.linalg.norm((place * MOVES)[:, None] - place, axis=-1).argmin(-1)
    sign = np.sign((axis * TURNS * axis[index]).sum(-1))
    apart = np.abs(place * MOVES - place[index]).max(-1)
    apart = np.maximum(apart, np.abs(axis * TURNS - sign[:, None] * axis[index]).max(-1))
    apart = np.maximum(apart, np.abs(robot.default_pose - sign * robot.default_pose[index]))
    if (apart > CLOSE).any():
        names = ", ".join(np.array(robot.joint_names)[apart > CLOSE])
        raise ConfigError(f"robot {robot.name} is not its own mirror image: no partner of {names}")
    return Mirror(index, sign)


def check_motors(task, robot: Robot) -> None:
    """ConfigError if a robot is not its own mirror image, its motors included; `task` is the config's group,
    its numbers of joints resolved."""
    partners = joints(robot).index
    for name in per_joint.names():
        value = task[name]
        for joint, partner in enumerate(partners) if isinstance(value, tuple) else ():
            if value[joint] != value[partner]:
                one, other = robot.joint_names[joint], robot.joint_names[partner]
                raise ConfigError(
                    f"task.{name} is {value[joint]:g} at {one} and {value[partner]:g} at {other}, expected "
                    "the same left and right where ppo.symmetry is True"
                )


def images(robot: Robot, layout: view.View) -> tuple[Mirror, Mirror] | None:
    """Of an observation (view.py) and of an action; None if the robot is not its own image."""
    try:
        own = joints(robot)
    except ConfigError:
        return None
    index, sign, start = [], [], 0
    for signs in view.parts(layout):
        count = len(own.index) if signs is None else len(signs)
        index.append(start + (own.index if signs is None else np.arange(count)))
        sign.append(own.sign if signs is None else np.array(signs, float))
        start += count
    return Mirror(np.concatenate(index), np.concatenate(sign)), own

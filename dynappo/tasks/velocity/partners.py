"""The mirror image of a robot's joints, and a check that its motors are symmetric. NumPy and C MuJoCo.

The partner of a joint is the joint at the mirrored place, about the mirrored axis, in the home pose; the
two axes decide the sign. A joint on the middle plane is its own partner.
"""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.config import ConfigError, per_joint
from dynappo.description import kinematics
from dynappo.description.robot import Robot
from dynappo.tasks.velocity import observe

CLOSE = 5e-3  # m; of axes, no unit; of the home pose, rad
PER_JOINT = 1e-3  # m: of joints at one place, the one as many joints from the base is the partner
# the mirror has the base's y axis as its normal
MOVES, TURNS = np.array(observe.MOVES, float), np.array(observe.TURNS, float)


def joints(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """`(partner, sign)` [A] of each joint; ConfigError if one has no partner.

    A hinge is a line: its place along the axis changes no motion, but tells left from right.
    """
    model = robot.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_forward(model, data)
    place, axis = data.xanchor[1:] - robot.home_qpos[:3], data.xaxis[1:]
    depth = np.array([len(kinematics.joints_to(model, b)) for b in model.jnt_bodyid[1:]])
    depth -= model.body_jntadr[model.jnt_bodyid[1:]] + model.body_jntnum[model.jnt_bodyid[1:]]
    depth += np.arange(1, model.njnt)
    away = np.linalg.norm((place * MOVES)[:, None] - place, axis=-1)
    along = (axis * TURNS) @ axis.T
    unlike = 1 - abs(along) + PER_JOINT * abs(depth[:, None] - depth)
    index = (away + unlike).argmin(-1)
    sign = np.sign(along[np.arange(len(index)), index])
    off = place * MOVES - place[index]
    off -= (off * axis[index]).sum(-1, keepdims=True) * axis[index]
    apart = np.abs(off).max(-1)
    apart = np.maximum(apart, np.abs(axis * TURNS - sign[:, None] * axis[index]).max(-1))
    apart = np.maximum(apart, np.abs(robot.default_pose - sign * robot.default_pose[index]))
    alone = index[index] != np.arange(len(index))
    if (alone | (apart > CLOSE)).any():
        names = ", ".join(np.array(robot.joint_names)[alone | (apart > CLOSE)])
        raise ConfigError(f"robot {robot.name} is not its own mirror image: no partner of {names}")
    return index, sign


def check_motors(task, robot: Robot) -> None:
    """ConfigError if a robot is not its own mirror image, its motors included; `task` is the config's group,
    its numbers of joints resolved."""
    partners, _ = joints(robot)
    for name in per_joint.names():
        value = task[name]
        for joint, partner in enumerate(partners) if isinstance(value, tuple) else ():
            if value[joint] != value[partner]:
                one, other = robot.joint_names[joint], robot.joint_names[partner]
                raise ConfigError(
                    f"task.{name} is {value[joint]:g} at {one} and {value[partner]:g} at {other}, expected "
                    "the same left and right where ppo.symmetry is True"
                )

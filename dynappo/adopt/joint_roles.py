"""Which joint is a hip, a knee, a wrist: by the tree of joints and their axes, whatever they are called.

An axis is about x (roll), y (pitch) or z (yaw) of the base, whichever is nearest in the default pose.

    hip       of a leg, up to its first pitch; other axes up to the knee
    knee      of a leg: its second pitch, and all pitches between hip and ankle
    ankle     of a leg: its last pitch, if it has three or more; other axes below the knee
    waist     carries several feet, or in the middle several limbs
    shoulder  of a limb at the side without a foot: its first pitch
    arm       the limb's other joints, up to the fourth
    wrist     from the fifth on, fingers too
    other     a head, for example
"""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.description import kinematics
from dynappo.description import robot as robot_lib

HAND = 4  # joints of an arm before its wrist
MIDDLE = 0.02  # m aside, up to which a joint is in the middle
X, Y, Z = range(3)


def roles(robot: robot_lib.Robot) -> tuple[np.ndarray, np.ndarray]:
    """`(roles [A], axes [A])` of the joints: words of the table above, and X, Y or Z."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(model, data)
    axis = np.abs(data.xaxis[1:]).argmax(1)
    aside = np.abs(data.xanchor[1:, 1] - robot.home_qpos[1]) > MIDDLE
    legs = [kinematics.joints_to(model, body) for body in _ends(robot)]
    chains = _chains(model)
    out = np.full(len(axis), "other", dtype="<U8")
    for joint in range(len(axis)):
        on = [leg for leg in legs if joint in leg]
        path = kinematics.joints_to(model, model.jnt_bodyid[joint + 1])
        arm = [j for j in path[: path.index(joint) + 1] if aside[j]]
        limbs = sum(joint in chain for chain in chains)
        if len(on) == 1:
            own = [j for j in on[0] if sum(j in leg for leg in legs) == 1]
            out[joint] = _of_leg(axis[own])[own.index(joint)]
        elif on or (not arm and limbs > 1):
            out[joint] = "waist"
        elif arm:
            out[joint] = _of_arm(axis[arm])
    return out, axis


def footless(robot: robot_lib.Robot) -> list[str]:
    """The names of the joints that lead to no foot, as those of an arm or a head."""
    lead = {j for body in _ends(robot) for j in kinematics.joints_to(robot.mj_model, body)}
    return [name for j, name in enumerate(robot.joint_names) if j not in lead]


def _ends(robot: robot_lib.Robot) -> list[int]:
    """The body of each foot."""
    bodies = robot.mj_model.geom_bodyid[robot.feet]
    return [int(bodies[robot.foot_of == foot][0]) for foot in range(len(robot.foot_names))]


def _chains(model: mujoco.MjModel) -> list[list[int]]:
    """The joints from the base to each end of the tree."""
    parents = set(model.body_parentid[2:])
    return [kinematics.joints_to(model, i) for i in range(2, model.nbody) if i not in parents]


def _of_leg(axis: np.ndarray) -> list[str]:
    """Of a leg's joints from the base to the foot."""
    pitch = np.flatnonzero(axis == Y)
    knees = [*pitch[1:2], *pitch[2:-1]]
    last = pitch[2:][-1:]
    below = knees[0] if knees else len(axis)
    return [
        "knee" if i in knees else "ankle" if i > below or i in last else "hip"
        for i in range(len(axis))
    ]


def _of_arm(axis: np.ndarray) -> str:
    """Of the last of an arm's joints, of the axes from the first to it."""
    if len(axis) > HAND:
        return "wrist"
    return "shoulder" if axis[-1] == Y and (axis == Y).sum() == 1 else "arm"

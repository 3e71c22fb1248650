"""What a biped's config sets beside `configs/biped.py`: from the tree of its joints, its height and mass.

How far a joint may be from the default pose in the reward `posture` (rad): mjlab's numbers for a Unitree G1,
walking; the shoulder's pitch is that of `configs/g1.py`. No names of joints: a joint has its place between
base and foot, and an axis, which is nearest to the base's x (roll), y (pitch) or z (yaw) in the default pose.

    leg    pitch: first 0.3 (hip), last 0.25 (ankle), between them 0.35 (knee); other axes 0.15 above the
           knee, 0.1 below
    waist  carries both feet, or several limbs: roll 0.08, pitch 0.1, yaw 0.2
    arm    first joint about y 0.5; others up to the fourth 0.15, yaw 0.1; from the fifth on (wrist) 0.3
    others heads, for example: 0.15

Lengths and times: those of a G1, whose base is 0.76 m above the ground, at the same Froude number. With the
base's height l, heights of steps go with l, strides a second with 1 / sqrt(l).
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.adopt import gains
from dynappo.physics import kinematics
from dynappo.physics import robot as robot_lib

HIP, KNEE, ANKLE, ABOVE, BELOW = 0.3, 0.35, 0.25, 0.15, 0.1
WAIST = 0.08, 0.1, 0.2  # about x, y, z
SHOULDER, ARM, ARM_YAW, WRIST = 0.5, 0.15, 0.1, 0.3
OTHER = 0.15
HAND = 4  # joints of an arm before its wrist
MIDDLE = 0.02  # m aside, up to which a joint is in the middle
X, Y, Z = range(3)
G1 = 0.757, 33.3  # m, kg: height of the base, mass
STRIDES, STEP = (1.25, 1.5), 0.15  # Hz, m: of Playground's G1
TORQUES = 2e-6  # weight of squared torques, of a G1
APART = 0.2  # m, of the reward `feet_distance`


class Task(NamedTuple):
    """Fields of the config's group `task` that depend on a biped."""

    posture_std: np.ndarray  # [A] rad
    gait_frequency: tuple[float, float]  # Hz
    gait_foot_height: float  # m
    joint_torques: float  # the term's weight
    feet_distance: bool  # whether the term can be had: feet stand apart by more than 0.2 m


def is_biped(robot: robot_lib.Robot) -> bool:
    return len(robot.foot_names) == 2


def choose(robot: robot_lib.Robot) -> tuple[Task, list[str]]:
    """A biped's `Task`, and a line on each thing that was assumed."""
    std, unknown = posture(robot)
    height = gains.reach(robot) / G1[0]
    slow, fast = (round(one / height**0.5, 2) for one in STRIDES)
    step = float(f"{STEP * height:.2g}")
    weight = -float(f"{TORQUES * (G1[1] / robot.mj_model.body_mass.sum()) ** 1.5:.2g}")
    apart = stance_width(robot)
    told = [
        "task: a biped's, with which a Unitree G1 walks (configs/biped.py); torques are weighted by "
        f"{weight:g}, by mass^-1.5",
        f"gait: {slow:g} to {fast:g} strides a second, steps {step:g} m high: a G1's {STRIDES[0]:g} to "
        f"{STRIDES[1]:g} and {STEP:g} for a base at {gains.reach(robot):.2f} m",
        f"posture: joints may leave the default pose by {gains.span(std)} rad, by their place and axis"
        + f"; {OTHER:g} rad{gains.at(robot.joint_names, unknown)}, no leg's, waist's or arm's"
        * bool(unknown.any()),
    ]
    if apart < APART:
        told.append(
            f"feet: {apart:.2f} m apart in the default pose, so the reward feet_distance (of {APART:g} m) is "
            "off"
        )
    return Task(std, (slow, fast), step, weight, apart >= APART), told


def stance_width(robot: robot_lib.Robot) -> float:
    """How far apart the middles of two feet are in the default pose, across the base's x axis (m)."""
    data = _home(robot)
    aside = data.geom_xpos[robot.feet, 1]
    return float(abs(aside[robot.foot_of == 0].mean() - aside[robot.foot_of == 1].mean()))


def posture(robot: robot_lib.Robot) -> tuple[np.ndarray, np.ndarray]:
    """`(std [A] in rad, unknown [A])`: of each joint, and whether no rule but the last is for it."""
    model, data = robot.mj_model, _home(robot)
    axis = np.abs(data.xaxis[1:]).argmax(1)
    aside = np.abs(data.xanchor[1:, 1] - robot.home_qpos[1]) > MIDDLE
    chains = _chains(model)
    legs = {foot: kinematics.joints_to(model, body) for foot, body in _ends(robot).items()}
    both = set(legs[0]) & set(legs[1])
    std, known = np.full(len(axis), OTHER), np.zeros(len(axis), bool)
    for leg in legs.values():
        own = [joint for joint in leg if joint not in both]
        std[own], known[own] = _leg(axis[own]), True
    for joint in np.flatnonzero(~known):
        path = kinematics.joints_to(model, model.jnt_bodyid[joint + 1])
        arm = [j for j in path[: path.index(joint) + 1] if aside[j]]
        limbs = sum(joint in chain for chain in chains)
        if joint in both or (not arm and limbs > 1):
            std[joint], known[joint] = WAIST[axis[joint]], True
        elif arm:
            std[joint], known[joint] = _arm(axis[arm]), True
    return std, ~known


def _home(robot: robot_lib.Robot) -> mujoco.MjData:
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(robot.mj_model, data)
    return data


def _ends(robot: robot_lib.Robot) -> dict[int, int]:
    """The body of each foot."""
    bodies = robot.mj_model.geom_bodyid[robot.feet]
    return {foot: int(bodies[robot.foot_of == foot][0]) for foot in range(len(robot.foot_names))}


def _chains(model: mujoco.MjModel) -> list[list[int]]:
    """The joints from the base to each end of the tree."""
    parents = set(model.body_parentid[2:])
    return [kinematics.joints_to(model, i) for i in range(2, model.nbody) if i not in parents]


def _leg(axis: np.ndarray) -> np.ndarray:
    """rad, of a leg's joints from the base to the foot, of their axes."""
    pitch = np.flatnonzero(axis == Y)
    knee = pitch[min(1, len(pitch) - 1)] if len(pitch) else len(axis)
    std = np.where(np.arange(len(axis)) < knee, ABOVE, BELOW)
    std[pitch] = KNEE
    std[pitch[2:][-1:]] = ANKLE
    std[pitch[:1]] = HIP
    return std


def _arm(axis: np.ndarray) -> float:
    """rad, of the last of an arm's joints, of the axes from the shoulder to it."""
    if len(axis) > HAND:
        return WRIST
    if axis[-1] == Y and (axis == Y).sum() == 1:
        return SHOULDER
    return ARM_YAW if axis[-1] == Z else ARM

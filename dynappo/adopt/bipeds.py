"""What of a biped's config follows from its joints, its height and mass; the rest is `configs/biped.py`.

How far a joint may be from the default pose in the reward `posture` (rad): mjlab's numbers for a Unitree G1,
walking; the shoulder's is that of `configs/g1.py`. Of pitch, and of other axes:

    hip 0.3, 0.15   knee 0.35   ankle 0.25, 0.1   waist 0.1, roll 0.08, yaw 0.2
    shoulder 0.5    arm 0.15, yaw 0.1    wrist 0.3    others (heads) 0.15

Times and lengths are those of a G1, whose base is 0.76 m above the ground, at the same Froude number. With l
the base's height, the stride rate scales as 1 / sqrt(l). The height of steps, how far a foot must lift and
how far feet must be apart scale as l; feet need not be further apart than in the default pose.
"""

from __future__ import annotations

from decimal import ROUND_DOWN, Context
from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.adopt import gains, joint_roles
from dynappo.description import robot as robot_lib

POSTURE = {  # rad, about x, y, z
    "hip": (0.15, 0.3, 0.15),
    "knee": (0.35, 0.35, 0.35),
    "ankle": (0.1, 0.25, 0.1),
    "waist": (0.08, 0.1, 0.2),
    "shoulder": (0.5, 0.5, 0.5),
    "arm": (0.15, 0.15, 0.1),
    "wrist": (0.3, 0.3, 0.3),
    "other": (0.15, 0.15, 0.15),
}
G1_HEIGHT, G1_MASS = 0.757, 33.3  # m of the base, kg
G1_STRIDES, G1_STEP = (1.25, 1.5), 0.15  # Hz, m: Playground's
G1_TORQUE_WEIGHT = 2e-6  # of squared torques
G1_CLEARANCE, G1_FEET_APART = 0.06, 0.2  # m, of the rewards `foot_clearance` and `feet_distance`


class Task(NamedTuple):
    """Fields of the config's group `task` that depend on a biped."""

    posture_std: np.ndarray  # [A] rad
    gait_frequency: tuple[float, float]  # Hz
    gait_foot_height: float  # m
    clearance_height: float  # m
    feet_apart: float  # m
    joint_torques: float  # the term's weight


def is_biped(robot: robot_lib.Robot) -> bool:
    return len(robot.foot_names) == 2


def choose(robot: robot_lib.Robot) -> tuple[Task, list[str]]:
    """A biped's `Task`, and a line on each thing that was assumed."""
    std, unknown = posture(robot)
    height = gains.reach(robot) / G1_HEIGHT
    slow, fast = (round(one / height**0.5, 2) for one in G1_STRIDES)
    step, lift, wide = (
        float(f"{one * height:.2g}") for one in (G1_STEP, G1_CLEARANCE, G1_FEET_APART)
    )
    base = f"for a base at {gains.reach(robot):.2f} m"
    weight = -float(f"{G1_TORQUE_WEIGHT * (G1_MASS / robot.mj_model.body_mass.sum()) ** 1.5:.2g}")
    stance = stance_width(robot)
    apart = min(wide, _down(stance))
    notes = [
        "task: a biped's, with which a Unitree G1 walks (configs/biped.py); torques are weighted by "
        f"{weight:g}, by mass^-1.5",
        f"gait: {slow:g} to {fast:g} strides a second, steps {step:g} m high: a G1's {G1_STRIDES[0]:g} to "
        f"{G1_STRIDES[1]:g} and {G1_STEP:g} {base}",
        f"feet: lifted by at least {lift:g} m in foot_clearance: a G1's {G1_CLEARANCE:g} {base}",
        f"feet: at least {apart:g} m apart in feet_distance: "
        + f"{stance:.3g} in the default pose, which is less than " * (apart < wide)
        + f"a G1's {G1_FEET_APART:g} {base}"
        + f", {wide:g}" * (apart < wide),
        f"posture: joints may leave the default pose by {gains.span(std)} rad, by their place and axis"
        + f"; {POSTURE['other'][1]:g} rad{gains.at_joints(robot.joint_names, unknown)}, no leg's, waist's or "
        "arm's" * bool(unknown.any()),
    ]
    return Task(std, (slow, fast), step, lift, apart, weight), notes


def stance_width(robot: robot_lib.Robot) -> float:
    """How far apart the middles of two feet are in the default pose, across the base's x axis (m)."""
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(robot.mj_model, data)
    aside = data.geom_xpos[robot.feet, 1]
    return float(abs(aside[robot.foot_of == 0].mean() - aside[robot.foot_of == 1].mean()))


def _down(length: float) -> float:
    """Two digits of a length in m, rounded down; what is less than a micrometre short is not."""
    return float(Context(prec=2, rounding=ROUND_DOWN).create_decimal(f"{length:.6f}"))


def posture(robot: robot_lib.Robot) -> tuple[np.ndarray, np.ndarray]:
    """`(std [A] in rad, unknown [A])`: of each joint, and whether its role is "other"."""
    roles, axis = joint_roles.roles(robot)
    std = [POSTURE[role][along] for role, along in zip(roles, axis, strict=True)]
    return np.array(std), roles == "other"

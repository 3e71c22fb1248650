"""The arrays that JAX and Warp exchange for a control step: names, order, shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynappo.description import contacts
from dynappo.terrain.height_map import HeightMap

PER_ROBOT = 11  # so many arrays, a call's first, have a row for each robot
IN_OUT = (  # changed in place
    "qpos",
    "qvel",
    "qacc_warmstart",
    "torque",
    "air_steps",
    "contact_steps",
    "last_air_steps",
    "peak",
    "last_peak",
)
COUNTS = "air_steps", "contact_steps", "last_air_steps"
RESULTS = "qd_before", "lowest"
# the numbers of a robot's motors, for all joints or for each, [1 or A, 8]: a thread of the kernel has a
# leg, and finds the numbers of its joints side by side. `share`: actuators.lag's, 1 where torques do not lag
MOTOR = ("kp", "kd", "effort", "saturation", "speed", "strength", "friction", "share")
MODEL = ("body_mass", "body_inertia", "body_ipos", "geom_friction", "dof_armature")


class Shape(NamedTuple):
    """The sizes and options that a control step is compiled for."""

    substeps: int
    every_substep: bool  # parts at the ground in every physics step, not only in the last
    feet: np.ndarray  # [S] geoms, foot by foot
    first: np.ndarray  # [F + 1] where each foot's shapes begin, and the last's end
    soles: np.ndarray  # [S, 5] contacts.floor_distance of the feet's shapes
    parts: np.ndarray  # [G] geoms
    floor: np.ndarray  # [G, 5] of the parts
    ground: HeightMap | None = None  # None: flat


def shape(
    mj_model, robot, substeps: int, every_substep: bool, ground: HeightMap | None = None
) -> Shape:
    """Of `robot`, in its compiled model on the `ground`."""
    soles, floor = (
        np.column_stack(contacts.floor_distance(mj_model, geoms))
        for geoms in (robot.feet, robot.parts)
    )
    first = np.searchsorted(robot.foot_of, np.arange(len(robot.foot_names) + 1))
    return Shape(substeps, every_substep, robot.feet, first, soles, robot.parts, floor, ground)


def map_numbers(ground: HeightMap) -> np.ndarray:
    """A height map as the array that ground.h reads: cell, corner, X, Y, then the heights."""
    head = [ground.cell, *ground.corner, *ground.heights.shape]
    return np.concatenate([head, ground.heights.ravel()]).astype(np.float32)


def sizes(mj_model, shape: Shape) -> dict[str, tuple[int, ...]]:
    """The arrays of a call, in its order, and their shapes behind the robots' axis."""
    joints, foot, parts = (mj_model.nu,), (len(shape.first) - 1,), (len(shape.parts),)
    return {
        "qpos": (mj_model.nq,),
        "qvel": (mj_model.nv,),
        "qacc_warmstart": (mj_model.nv,),
        "torque": joints,
        **dict.fromkeys(IN_OUT[4:], foot),
        "target": (shape.substeps, *joints),
        "motor": (1, len(MOTOR)),  # or (A, ...)
        **{name: getattr(mj_model, name).shape for name in MODEL},
        "qd_before": joints,
        "lowest": parts,
    }

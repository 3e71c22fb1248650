"""A robot's motors, joint by joint: their numbers in a config, and their inertia in the compiled model."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np

from dynappo.config import per_joint
from dynappo.description.robot import Robot


def fitted(config, robot: Robot) -> tuple[Any, Robot]:
    """`(config, robot)` for a program: the fields of joints as one number or a tuple of a number a joint, the
    model with `task.armature`. ConfigError where they do not fit this robot's joints."""
    config = per_joint.resolved(config, robot.joint_names, robot.name)
    if config.task.armature is None:
        return config, robot
    model = copy.copy(robot.mj_model)
    set_armature(model, np.arange(6, model.nv), config.task.armature)
    return config, robot._replace(mj_model=model)


def set_armature(model: mujoco.MjModel, dofs: np.ndarray, armature) -> None:
    """Give the joints of `dofs` this `armature` (kg m^2), as if the model's file had it."""
    if np.all(model.dof_armature[dofs] == armature):
        return
    computed = model.stat.meaninertia == _mean_inertia(model)  # not given by the file
    model.dof_armature[dofs] = armature
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what the solver takes from inertias
    if computed:  # which MuJoCo computes in its compiler alone
        model.stat.meaninertia = _mean_inertia(model)


def _mean_inertia(model: mujoco.MjModel) -> float:
    """Mean of the diagonal of the mass matrix, as MuJoCo's compiler has it in `stat.meaninertia`."""
    data, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    return sum(np.diag(inertia).tolist()) / model.nv

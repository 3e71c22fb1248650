"""Rotation matrices and quaternions (w, x, y, z), by MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np


def matrix(quat) -> np.ndarray:
    """The rotation matrix [3, 3] of a quaternion [4]."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.asarray(quat, np.float64))
    return out.reshape(3, 3)


def quaternion(matrix) -> np.ndarray:
    """The quaternion [4] of a rotation matrix [3, 3]."""
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(matrix, np.float64).ravel())
    return out

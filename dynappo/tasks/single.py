"""One robot of another package's environment, a control step at a time: for films, pages and the live page.

`by_name.single` makes it, and evaluate/task_steps.py steps it. Whatever the package's physics are, the robot
is drawn as a MuJoCo model.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np


class Seen(NamedTuple):
    """The robot after a reset or a control step."""

    obs: Any  # [O] as the policy sees it
    qpos: Any  # [nq] of the model that is drawn
    qvel: Any  # [nv]
    ctrl: Any  # [nu]
    pose: Any = None  # [nbody, 7] m, quaternions of the bodies; None: where qpos puts them
    command: Any = (0.0, 0.0, 0.0)  # m/s, m/s, rad/s that it followed
    reward: Any = 0.0
    fell: Any = 0.0  # 1 where the environment ended the episode
    ok: Any = 1.0  # 0 where a number was not finite


class Single(NamedTuple):
    """One robot, and what steps it; both functions are compiled."""

    model: mujoco.MjModel  # as it is drawn
    observed: int  # O
    actions: int  # A
    dt: float  # s, a control step
    episode_length: int  # control steps
    ranges: np.ndarray | None  # [3, 2] commands that the task asks for; None: it has none
    about: str  # a line on its physics or its meshes
    first: Callable[[int], tuple[Any, Seen]]  # (seed) -> state
    # (state, command, velocity that the base gets [3] m/s, force on it [3] N, action [A]) -> state; NaN in a
    # command is the task's own
    step: Callable[..., tuple[Any, Seen]]


def base(model: mujoco.MjModel) -> int:
    """The body that a camera follows and that is pushed: that of the first joint."""
    return int(model.jnt_bodyid[0])


def jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """[3, nv] m/s of the base's origin for each number of qvel; `data` has its kinematics."""
    found = np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, found, None, base(model))
    return found

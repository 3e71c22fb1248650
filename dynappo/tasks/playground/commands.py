"""A task's command: vx, vy (m/s) and yaw rate (rad/s) in `info["command"]`, and its ranges."""

from __future__ import annotations

import inspect
from typing import Any

import jax
import numpy as np

from dynappo.tasks.playground import swapped

DRAWS = 64  # in which each number of a command is drawn, and not left or zero


def in_info(info: dict[str, Any]) -> bool:
    """Whether these numbers of a task have such a command."""
    return "command" in info and np.shape(info["command"]) == (3,)


def ranges(task: Any, info: dict[str, Any]) -> np.ndarray | None:
    """[3, 2] lowest and highest command that the task draws; None where it has no command.

    Tasks name their ranges in many ways. But all draw by `jax.random.uniform`, so it is asked for its ends.
    """
    if not in_info(info):
        return None
    last = len(inspect.signature(task.sample_command).parameters) > 1  # the command before
    found = []
    for end in (0.0, 1.0):
        with swapped.uniform(end):
            for key in range(DRAWS):
                more = (np.zeros(3, np.float32),) if last else ()
                found.append(np.array(task.sample_command(jax.random.PRNGKey(key), *more), float))
    return np.stack([np.min(found, 0), np.max(found, 0)], 1).round(6)

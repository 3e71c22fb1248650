"""From which speed on does a robot that stands follow a command? In C MuJoCo and NumPy, without noise.

A step costs reward, and a slow command that is not followed costs little of it. So a policy may stand where
it is asked to walk slowly, which the grid of `trials.py`, whose commands are faster, does not show.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from dynappo.evaluate.spread import spread
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy
from dynappo.policy.walks import SETTLE

# axis of the command and sign
DIRECTIONS = {"ahead": (0, 1), "back": (0, -1), "left": (1, 1), "turning left": (2, 1)}
SPEEDS = (0.5, 0.4, 0.3, 0.2, 0.1)  # m/s or rad/s, from the fastest on
SECONDS = 4.0  # of an episode; the first second is left out
FOLLOWED = 0.5  # of the speed asked for


def run(player: Player) -> dict[str, float | None]:
    """For each of `DIRECTIONS`, the slowest of `SPEEDS` (m/s, rad/s) from which on the robot follows all.

    It follows one if it does not fall and its mean speed along the command is at least `FOLLOWED` of it.
    None: it does not follow the fastest. Speeds that training did not ask for are left out, and so is a
    direction that has no other.
    """
    policy = player.policy
    act = policy_file.actor(policy.params, policy.activation)
    asked = {name: speeds for name in DIRECTIONS if (speeds := within(policy, name))}
    found = spread(lambda name: slowest(player, act, name, asked[name]), [*asked])
    return dict(zip(asked, found, strict=True))


def within(policy: Policy, direction: str) -> list[float]:
    """Those of `SPEEDS` that training asked for in a direction."""
    axis, sign = DIRECTIONS[direction]
    low, high = (policy.command_x, policy.command_y, policy.command_yaw)[axis]
    return [speed for speed in SPEEDS if low <= sign * speed <= high]


def slowest(player: Player, act: Callable, direction: str, speeds: list[float]) -> float | None:
    """The slowest of `speeds`, the fastest first, from which on all are followed in a direction."""
    axis, sign = DIRECTIONS[direction]
    last = None
    for speed in speeds:
        command = np.zeros(3)
        command[axis] = sign * speed
        if sign * went(player, act, command)[axis] < FOLLOWED * speed:
            return last
        last = speed
    return last


def went(player: Player, act: Callable, command: np.ndarray) -> np.ndarray:
    """Mean velocity [3] (m/s, m/s, rad/s, base frame) from standing under `command`; zeros after a fall."""
    dt, velocities = episode_lib.period(player), []
    rows = episode_lib.rows(player, mujoco.MjData(player.model), act, lambda t: command)
    for k in range(round(SECONDS / dt)):
        try:
            row = next(rows)
        except FloatingPointError:
            return np.zeros(3)
        if row["fell"]:
            return np.zeros(3)
        if k * dt >= SETTLE:
            velocities.append(row["velocity"])
    return np.mean(velocities, axis=0)


def line(numbers: dict[str, Any]) -> str:
    """What `run` found, in a sentence."""
    told = []
    for name, speed in numbers.items():
        unit = "rad/s" if DIRECTIONS[name][0] == 2 else "m/s"
        told.append(f"{name} none" if speed is None else f"{name} {speed:g} {unit}")
    return f"slowest commands that it follows from standing, of {SPEEDS[-1]:g} and up: {', '.join(told)}"

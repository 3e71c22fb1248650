"""The commands that `--command` gives: three numbers, a script, or without the flag a tour."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo.config import ConfigError, files
from dynappo.policy import episode as episode_lib
from dynappo.policy.policy_file import Policy

SECONDS = episode_lib.FILM_SECONDS
AFTER_SCRIPT = 2.0  # s, how long the last row of a command script lasts
LONGEST = 3600  # s that can be played
MAX_SCRIPT = 2**24  # bytes of a command script; a row each 0.02 s of an hour has less
FASTEST = 100  # m/s or rad/s that can be asked for
AXES = ("vx", "vy", "wz")


class Commands(NamedTuple):
    """The commands of an episode."""

    at: Callable[[float], np.ndarray]  # t (s) -> vx, vy, yaw rate
    rows: np.ndarray  # [K, 3] all that occur
    text: str
    seconds: float  # how long to play where nothing else is said


def commands(text: str | None, seconds: float | None) -> Commands:
    """What `--command=TEXT` means; without it the tour, over `seconds`."""
    if text is None:
        length = seconds or SECONDS
        rows = np.array([row for _, row in episode_lib.TOUR])
        named = "a tour: ahead, a turn, sideways, fast ahead"
        return Commands(episode_lib.tour(length), rows, named, length)
    if text.endswith(".csv") or os.path.isfile(text):  # False where the name is too long
        return script(Path(text))
    values = [number(part) for part in text.split(",")]
    if len(values) != 3 or None in values:
        raise ConfigError(
            f"--command={text!r}: expected three numbers VX,VY,WZ (m/s, m/s, rad/s) as in "
            "--command=0.8,0,0, or a FILE.csv with rows t,vx,vy,wz"
        )
    command = np.array(values, float)
    if np.abs(command).max() > FASTEST:
        raise ConfigError(f"--command={text!r}: expected numbers from -{FASTEST} to {FASTEST}")
    said = "{:g}, {:g} m/s, {:g} rad/s".format(*command)
    return Commands(lambda t: command, command[None], said, SECONDS)


def script(path: Path) -> Commands:
    """The commands of a file with rows `t,vx,vy,wz`; before the first row the robot stands."""

    def wrong(reason):
        return ConfigError(f"--command={path}: {reason}")

    try:
        files.check_regular(path)
        with path.open("rb") as file:
            content = file.read(MAX_SCRIPT + 1)
        lines = content.decode("utf-8-sig").splitlines()  # spreadsheets write a mark first
    except OSError as error:
        raise wrong(f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise wrong("not a text file; expected rows t,vx,vy,wz") from None
    if len(content) > MAX_SCRIPT:
        raise wrong(f"more than {MAX_SCRIPT} bytes; expected rows t,vx,vy,wz of an hour at most")
    rows: list[list[float]] = []
    for count, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or line.startswith("#") or cells == ["t", *AXES]:
            continue
        row = [value for cell in cells if (value := number(cell)) is not None]
        if len(row) != 4 or len(cells) != 4:
            raise wrong(f"line {count} is {line[:80]!r}, expected four numbers t,vx,vy,wz")
        if row[0] < 0 or (rows and row[0] <= rows[-1][0]):
            raise wrong(f"line {count}: t is {row[0]:g}, expected times from 0 on that increase")
        if row[0] > LONGEST:
            raise wrong(f"line {count}: t is {row[0]:g}, expected at most {LONGEST} s")
        if max(map(abs, row[1:])) > FASTEST:
            raise wrong(f"line {count} is {line[:80]!r}, expected commands up to {FASTEST}")
        rows.append(row)
    if not rows:
        raise wrong("has no rows; expected t,vx,vy,wz")
    table = np.array([[-math.inf, 0, 0, 0], *rows])
    # k x dt may lie a rounding error before the time of a row
    at = lambda t: table[np.searchsorted(table[:, 0], t + 1e-9, "right") - 1, 1:]  # noqa: E731
    seconds = min(rows[-1][0] + AFTER_SCRIPT, LONGEST)
    return Commands(at, table[1:, 1:], f"commands of {path}", seconds)


def ranges_of(policy: Policy) -> np.ndarray:
    """[3, 2] the commands that the policy was trained for."""
    return np.array([policy.command_x, policy.command_y, policy.command_yaw])


def within(ranges: np.ndarray, tour: Commands) -> Commands:
    """The tour, with each number in `ranges` [3, 2] of training: a biped on rough ground was never told to
    walk aside."""
    rows = np.clip(tour.rows, *ranges.T)
    if (rows == tour.rows).all():
        return tour
    text = f"{tour.text}, as far as it was trained"
    return tour._replace(at=episode_lib.tour(tour.seconds, ranges), rows=rows, text=text)


def outside(ranges: np.ndarray, wanted: Commands) -> str:
    """A line on a command that was not trained, outside of `ranges` [3, 2], or ""."""
    for axis, (low, high), column in zip(AXES, ranges, wanted.rows.T, strict=True):
        worst = column[np.argmax(np.maximum(column - high, low - column))]
        if not low <= worst <= high:
            return f"note: {axis} = {worst:g} was not trained; it was from {low:g} to {high:g}"
    return ""


def number(text: str) -> float | None:
    """A finite number, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None

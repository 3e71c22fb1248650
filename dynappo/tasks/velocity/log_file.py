"""A log: what a robot's controller recorded while it walked, as an .npz file (robots/DEPLOY.md). NumPy only.

One entry a control step: the readings before it, and the action that followed from them. Of A joints, F feet:

| array | shape | content |
|---|---|---|
| `time` | [T] | s; a step that is not `control_dt` long begins a new episode |
| each predicted quantity of observe.py | [T, ...] | as there: `joint_position` is minus `default_pose` |
| `command` | [T, 3] | as the policy saw it |
| `action` | [T, A] | as the policy gave it, exploration included |
| `fell` | [T] | True: it has fallen, or was stopped because it would; the episode's last entry |
| `contact` | [T, F] | True: this foot is on the ground. May be absent |

`about` is a text in JSON with the entries `ABOUT`, as the metadata of an exported policy.onnx has them; with
`contact` also `foot_names`. A `robot` is compared where there is one. Others are not read.
"""

from __future__ import annotations

import io
import json
import reprlib
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo.config import ConfigError, files
from dynappo.description import robot as robot_lib
from dynappo.description.robot import Robot
from dynappo.tasks.velocity import observe, reward_sum
from dynappo.terrain import map_file

OF_POLICY = "joint_names", "default_pose", "action_scale", "kp", "kd"  # as in a policy.npz
ABOUT = (*OF_POLICY, "control_dt")
SEEN = (*observe.PREDICTED, "command")  # an observation begins with these
READINGS = (*SEEN, "action")
# fields of rewards.Measured that the readings tell (logged.py), and those that `contact` tells
ALWAYS = {"torque", "joint_velocity_before", "timestep", "older_action", "over_limit"}
OF_CONTACT = {"contact", "touchdown", "last_air_time"}
MOST_BYTES = 2**31  # of all arrays together
LEAST = 10.0  # s
CLOSE = 1e-3  # of numbers that must be the same
BEYOND = 0.3  # rad that a joint may be beyond its range: encoders are a bit off, stops are soft
NO_VELOCITY = (
    "; no sensor tells it, so have an estimator of the robot's state log it, or motion capture"
)


class Log(NamedTuple):
    """A log in the robot's order of joints and feet; `[T, ...]`, float32."""

    readings: dict[str, np.ndarray]  # by the names in `READINGS`
    goes_on: np.ndarray  # [T] bool: the next entry is the control step after this one
    fell: np.ndarray  # [T] bool
    contact: np.ndarray | None  # [T, F] bool
    control_dt: float  # s


def save(path: Path, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write a log, whole or not at all."""
    with files.replacing(path) as part, part.open("wb") as file:
        entries: dict[str, Any] = {"about": json.dumps(about, allow_nan=False), **arrays}
        np.savez_compressed(file, **entries)


def digest(path: str) -> str:
    """What tells a log from another; ConfigError if it cannot be read."""
    return map_file.hashed(_read(path))


def load(path: str, robot: Robot, config, digest: str = "") -> Log:
    """The log in a file, for `robot` and a config whose numbers a joint are resolved (`motors.fitted`).

    ConfigError, in one line, if it is not as this module says, of another robot or other motors, or not the
    file with this `digest`.
    """
    expect = partial(_expect, path)
    data = _read(path)
    same = not digest or map_file.hashed(data) == digest
    expect(
        same, "is another file than the run began with; put that back, or choose another --workdir"
    )
    arrays = _arrays(path, data)
    about = _about(path, arrays)
    dt = config.physics.substeps * config.physics.timestep
    name = about.get("robot", robot.name)  # joints and gains of two robots may be the same
    expect(
        name == robot.name,
        f"it is of the robot {_said(name)}, expected {robot.name}; train with a --config of that "
        "one, or correct `robot` in its text `about`",
    )
    joints = _order(expect, "joint_names", about["joint_names"], robot.joint_names)
    _check_motors(expect, about, joints, robot, config.task)
    found = about["control_dt"]
    expect(
        _close(found, dt), f"its control_dt is {_said(found)}, expected {dt:g} s as in the config"
    )
    wide = {name: (observe.QUANTITIES[name].size or len(joints),) for name in SEEN}
    shapes = {"time": (), "fell": (), "action": (len(joints),)} | wide
    feet: list[int] = []
    if "contact" in arrays:
        feet = _order(expect, "foot_names", about.get("foot_names"), robot.foot_names)
        shapes["contact"] = (len(feet),)
    _check_arrays(expect, arrays, shapes)

    period, fell = np.diff(arrays["time"].astype(float)), arrays["fell"] != 0
    goes_on = np.append(abs(period - dt) < dt / 2, False) & ~fell
    apart = float(np.median(period)) if len(period) else 0.0
    time = arrays["time"]
    hint = f"; time is {time.dtype} of {time[0]:.0f} s: subtract its first, or save float64"
    coarse = apart == 0 and time.dtype != float  # seconds since 1970 have no hundredths in float32
    expect(
        abs(apart - dt) < dt / 10,
        f"its entries are {apart:g} s apart, expected control_dt = {dt:g}" + hint * coarse,
    )
    seconds = float(goes_on.sum() * dt)
    expect(seconds >= LEAST, f"it has {seconds:g} s of control steps, expected at least {LEAST:g}")
    length = float(np.median(np.linalg.norm(arrays["gravity"], axis=1)))
    expect(
        abs(length - 1) < 0.1, f"gravity has the length {length:g}, expected 1: it is a direction"
    )

    readings = {name: np.asarray(arrays[name], np.float32) for name in READINGS}
    for name in ("joint_position", "joint_velocity", "action"):
        readings[name] = readings[name][:, joints]
    _check_signs(expect, readings, fell, robot)
    contact = arrays["contact"][:, feet] != 0 if "contact" in arrays else None
    return Log(readings, goes_on, fell, contact, dt)


def _expect(path: str, ok, text: str) -> None:
    if not ok:
        raise ConfigError(f"--logs={path}: {text}")


def _about(path: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the text in a log says; it is taken out of `arrays`."""
    about: Any = None
    try:
        about = json.loads(str(arrays.pop("about", "{}")))
    except (ValueError, RecursionError):
        _expect(path, False, "its text `about` is not JSON; robots/DEPLOY.md says what it holds")
    lacks = [name for name in ABOUT if not isinstance(about, dict) or name not in about]
    text = f"its text `about` lacks {', '.join(lacks)}; robots/DEPLOY.md says what it holds"
    _expect(path, not lacks, text)
    return about


def _order(expect, what: str, there: Any, here: tuple[str, ...]) -> list[int]:
    """Where each name of the robot is among those of the log."""
    same = isinstance(there, list) and sorted(map(str, there)) == sorted(here)
    names = set(map(str, there)) if isinstance(there, list) else set()
    apart = {"lack": set(here) - names, "have too many:": names - set(here)}
    told = " and ".join(
        f"{how} {' '.join(sorted(which)[:6])}" for how, which in apart.items() if which
    )
    found = f"its {what} {told}" if names & set(here) and told else f"its {what} are {_said(there)}"
    expect(same, f"{found}, expected {' '.join(here)} in any order")
    return [there.index(name) for name in here]


def _check_motors(expect, about: dict[str, Any], joints: list[int], robot: Robot, task) -> None:
    """An action must have meant what it means in the config."""
    numbers = {name: task[name] for name in ("action_scale", "kp", "kd")}
    for name, here in ({"default_pose": robot.default_pose} | numbers).items():
        there = about[name]
        if isinstance(there, list) and len(there) == len(joints):
            there = [there[i] for i in joints]
        said = _said(np.asarray(here).tolist())
        expect(
            _close(there, here), f"its {name} is {_said(there)}, expected {said} as in the config"
        )


def _check_arrays(expect, arrays: dict[str, np.ndarray], shapes: dict[str, tuple]) -> None:
    """All of `shapes` are there, as long as `time`, and finite numbers."""
    count = len(np.atleast_1d(arrays.get("time", 0)))
    expect(count > 0, "it has no entries")
    for name, shape in shapes.items():
        hint = NO_VELOCITY * (name == "linear_velocity")
        there, shape = name in arrays, (count, *shape)
        like = "numbers of the shape " + ("[T], s" if name == "time" else str(shape))
        expect(there, f"it has no array `{name}`, expected {like}{hint}")
        found = arrays[name]
        expect(found.shape == shape, f"{name} has the shape {found.shape}, expected {shape}")
        expect(found.dtype.kind in "fiub", f"{name} holds {found.dtype}, expected numbers")
        bad = np.flatnonzero(~np.isfinite(found.reshape(count, -1)).all(1)).tolist()
        first = f"{len(bad)} of {count} entries, the first is entry {bad[0] if bad else 0}"
        expect(not bad, f"{name} is not finite in {first}; leave these out")


def _check_signs(expect, readings: dict[str, np.ndarray], fell: np.ndarray, robot: Robot) -> None:
    """A robot that walks has its joints where they can be, and is upright, at most entries."""
    low, high = robot_lib.joint_ranges(robot).T
    position = readings["joint_position"] + np.asarray(robot.default_pose)
    inside = ((position > low - BEYOND) & (position < high + BEYOND)).mean(0)
    worst = int(inside.argmin())
    found = f"is {np.median(position[:, worst]):g} in the median, expected {low[worst]:g} to {high[worst]:g}"
    expect(
        inside[worst] > 0.5,
        f"joint_position plus default_pose of {robot.joint_names[worst]} {found}; is it in degrees, or of "
        "another sign or zero?",
    )
    up = float(np.median(readings["gravity"][~fell, 2]))
    expect(
        up < 0,
        f"gravity has z = {up:g} in the median, expected about -1 of a robot that stands; its sign?",
    )


def episodes(log: Log) -> list[slice]:
    """The entries of each episode: the last has no row of its own."""
    ends = np.flatnonzero(~log.goes_on) + 1
    starts = [0, *ends[:-1].tolist()]
    return [slice(a, b) for a, b in zip(starts, ends.tolist(), strict=True)]


def in_words(log: Log, config) -> str:
    """How long a log is, what happens in it, and what it does not tell."""
    each = [one for one in episodes(log) if one.stop - one.start > 1]
    falls = int((log.fell[1:] & log.goes_on[:-1]).sum())
    seconds = log.goes_on.sum() * log.control_dt
    text = f"{config.run.logs}: {seconds:.0f} s of one robot, {len(each)} episodes, {falls} falls"
    lacks = left_out(config.task, log)
    return text + f"; it does not tell {', '.join(lacks)}: left out of the reward" * bool(lacks)


def left_out(task, log: Log) -> list[str]:
    """The terms of the reward that have a weight and cannot be computed from a log."""
    terms = reward_sum.terms_of(task)
    known = reward_sum.known(
        terms, task, ALWAYS | (OF_CONTACT if log.contact is not None else set())
    )
    return [name for name in terms if name not in known and task.weights[name]]


def _read(path: str) -> bytes:
    try:
        files.check_regular(Path(path))
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"--logs={path}: cannot be read ({error.strerror})") from None


def _arrays(path: str, data: bytes) -> dict[str, np.ndarray]:
    """The arrays by name. It cannot run code: nothing is unpickled."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            if sum(entry.file_size for entry in file.zip.infolist()) > MOST_BYTES:
                raise ConfigError(
                    f"--logs={path}: more than 2 GiB unpacked, expected hours of one robot at most"
                )
            return {name: file[name] for name in file.files}
    except ConfigError:
        raise
    except (*map_file.DAMAGE, AttributeError):  # np.load returns an array where the file is no npz
        raise ConfigError(
            f"--logs={path}: not an .npz of arrays, or damaged; robots/DEPLOY.md says what it holds"
        ) from None


def _said(value) -> str:
    return reprlib.repr(value)


def _close(there, here) -> bool:
    """Whether two numbers, or lists of a number a joint, are the same."""
    try:
        there, here = np.asarray(there, float), np.asarray(here, float)
        return (
            bool(np.all(abs(there - here) <= CLOSE * np.maximum(1e-2, abs(here))))
            and there.ndim < 2
        )
    except (TypeError, ValueError):
        return False

"""Show a policy walking: `dynappo play NAME_OR_DIR --command=0.8,0,0 --out=walk.html`.

C MuJoCo and NumPy, without JAX. With `--out` it writes a film, a picture or an HTML page; without,
it opens MuJoCo's viewer, where keys steer the robot. `--robot-xml` runs the policy in another file of
the same robot (sim-to-sim): `policy/episode.py` says what such a file must have.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, files
from dynappo.config import flags as flags_lib
from dynappo.physics import robot as robot_lib
from dynappo.play import film, page, viewer
from dynappo.policy import choice, policy_file
from dynappo.policy import episode as episode_lib
from dynappo.policy.policy_file import Policy

FILES = {".mp4": "a film", ".gif": "a film", ".png": "its last moment", ".html": "a page"}
SECONDS = 12.0
AFTER_SCRIPT = 2.0  # s, how long the last row of a command script lasts
LONGEST = 3600  # s that can be played
MAX_SCRIPT = 2**24  # bytes of a command script; a row each 0.02 s of an hour has less
FASTEST = 100  # m/s or rad/s that can be asked for
AXES = ("vx", "vy", "wz")
USAGE = f"""\
NAME_OR_DIR is a workdir (while it trains: its newest checkpoint), a checkpoint folder, a policy.npz,
or the name of a robot with a bundled policy
  python -m dynappo.play runs/quick --out=walk.html
  python -m dynappo.play go1 --command=0.8,0,0.3 --seconds=6 --out=turn.mp4
  python -m dynappo.play go1 --command=drill.csv --robot-xml=other/scene.xml --out=drill.gif
  python -m dynappo.play anymal_c --policy=random
  python -m dynappo.play runs/sweep --run-seed=3 --out=walk.html
a command script has rows t,vx,vy,wz (s, m/s, m/s, rad/s); a row holds until the next one
without --out MuJoCo's viewer opens, with these keys
  {viewer.KEYS}
"""


class Commands(NamedTuple):
    """What the robot is asked for."""

    at: Callable[[float], np.ndarray]  # t (s) -> vx, vy, yaw rate
    rows: np.ndarray  # [K, 3] all that occur
    text: str
    seconds: float  # how long to play where nothing else is said


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    what = "Show a policy walking: in a page, a film, or a viewer with keys to steer."
    parser = flags_lib.parser("play", what, USAGE)
    flag = parser.add_argument
    choice.add_flags(parser)
    flag(
        "--command",
        metavar="VX,VY,WZ|FILE.csv",
        help="velocities to follow: m/s, m/s, rad/s; default: a short tour",
    )
    flag("--seconds", metavar="N", help=f"how long; default: {SECONDS:g}, or until the script ends")
    names = "FILE.html, .mp4, .gif, or .png (the last moment)"
    flag("--out", metavar="FILE", type=flags_lib.path, help=names)
    flag(
        "--size",
        metavar="WIDTHxHEIGHT",
        help="pixels; default: 640x360 for a film, 1280x720 for a picture",
    )
    flag("--policy", metavar="zero|random", help="zero or random actions instead of the policy's")
    flag("--seed", metavar="N", default="0", help="random seed of --policy=random; default: 0")
    flag(
        "--keep-joints",
        action="store_true",
        help="with --robot-xml: keep its damping and friction of the joints",
    )
    flags = flags_lib.read(parser, argv)
    if not flags.what:
        raise ConfigError(
            "nothing to play; name a workdir, as in: python -m dynappo.play runs/quick"
        )
    if flags.keep_joints and flags.robot_xml is None:
        raise ConfigError("--keep-joints needs --robot-xml=FILE")
    if flags.policy not in (None, "zero", "random"):
        raise ConfigError(f"--policy={flags.policy!r}: expected zero or random")
    choice.check(flags)
    if flags.policy and flags.run_seed is not None:
        raise ConfigError(
            f"--run-seed={flags.run_seed}: --policy={flags.policy} plays none of a run"
        )
    flags.seed = flags_lib.whole("seed", flags.seed, 0)
    flags.size = None if flags.size is None else film.size(flags.size, flags.out)
    if flags.seconds is not None:
        seconds = _number(flags.seconds)
        if seconds is None or not 0 < seconds <= LONGEST:
            raise ConfigError(
                f"--seconds={flags.seconds!r}: expected a number above 0, at most {LONGEST}"
            )
        flags.seconds = seconds
    return flags


def _number(text: str) -> float | None:
    """A finite number, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def commands(text: str | None, seconds: float | None) -> Commands:
    """What `--command=TEXT` means; without it the tour, over `seconds`."""
    if text is None:
        length = seconds or SECONDS
        rows = np.array([row for _, row in episode_lib.TOUR])
        named = "a tour: ahead, a turn, sideways, fast ahead"
        return Commands(episode_lib.tour(length), rows, named, length)
    if text.endswith(".csv") or os.path.isfile(text):  # False where the name is too long
        return script(Path(text))
    values = [_number(part) for part in text.split(",")]
    if len(values) != 3 or None in values:
        raise ConfigError(
            f"--command={text!r}: expected three numbers VX,VY,WZ (m/s, m/s, rad/s) as in "
            "--command=0.8,0,0, or a FILE.csv with rows t,vx,vy,wz"
        )
    asked = np.array(values, float)
    if np.abs(asked).max() > FASTEST:
        raise ConfigError(f"--command={text!r}: expected numbers from -{FASTEST} to {FASTEST}")
    said = f"{asked[0]:g}, {asked[1]:g} m/s, {asked[2]:g} rad/s"
    return Commands(lambda t: asked, asked[None], said, SECONDS)


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
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or line.startswith("#") or cells == ["t", *AXES]:
            continue
        row = [value for cell in cells if (value := _number(cell)) is not None]
        if len(row) != 4 or len(cells) != 4:
            raise wrong(f"line {number} is {line[:80]!r}, expected four numbers t,vx,vy,wz")
        if row[0] < 0 or (rows and row[0] <= rows[-1][0]):
            raise wrong(f"line {number}: t is {row[0]:g}, expected times from 0 on that increase")
        if row[0] > LONGEST:
            raise wrong(f"line {number}: t is {row[0]:g}, expected at most {LONGEST} s")
        if max(map(abs, row[1:])) > FASTEST:
            raise wrong(f"line {number} is {line[:80]!r}, expected commands up to {FASTEST}")
        rows.append(row)
    if not rows:
        raise wrong("has no rows; expected t,vx,vy,wz")
    table = np.array([[-math.inf, 0, 0, 0], *rows])
    # k x dt may lie a rounding error before the time of a row
    at = lambda t: table[np.searchsorted(table[:, 0], t + 1e-9, "right") - 1, 1:]  # noqa: E731
    seconds = min(rows[-1][0] + AFTER_SCRIPT, LONGEST)
    return Commands(at, table[1:, 1:], f"commands of {path}", seconds)


def outside(policy: Policy, asked: Commands) -> str:
    """A line on a command that the policy was not trained for, or ""."""
    ranges = (policy.command_x, policy.command_y, policy.command_yaw)
    for axis, (low, high), column in zip(AXES, ranges, asked.rows.T, strict=True):
        worst = column[np.argmax(np.maximum(column - high, low - column))]
        if not low <= worst <= high:
            return f"note: {axis} = {worst:g} was not trained; it was from {low:g} to {high:g}"
    return ""


def choose(flags) -> tuple[Policy, Callable[[np.ndarray], np.ndarray], str]:
    """`(policy, act, text)` of the command line; `text` says what acts."""
    if flags.policy is None:
        policy, _, text = choice.find(flags)
        return policy, policy_file.actor(policy.params, policy.activation), text
    if flags.what in files.robots():
        name = f"{flags.what}.py"
        if files.find("configs", name) is None:
            raise ConfigError(f"{flags.what}: there is no configs/{name} with its gains")
        config = config_lib.validate(config_lib.load(f"configs/{name}"))
        policy = policy_file.describe(config, robot_lib.load(flags.what))._replace(mjcf="")
    else:
        policy, _, _ = choice.find(flags)
    size = len(policy.joint_names)
    if flags.policy == "zero":
        return policy, lambda obs: np.zeros(size), "zero actions"
    draw = np.random.default_rng(flags.seed)
    return policy, lambda obs: draw.normal(size=size), f"random actions, seed {flags.seed}"


def check_out(out: Path) -> None:
    """ConfigError if nothing can be written at `out`; leaves no file behind."""
    if out.suffix not in FILES:
        raise ConfigError(f"--out={out}: expected a file named {', '.join(FILES)}")
    flags_lib.check_writable(out)


def table(body: episode_lib.Body, episode: dict) -> list[tuple[str, str]]:
    """What an episode came to, as (name, value) for a person."""
    m = episode_lib.measures(body, episode)

    def value(name, text, otherwise):
        return otherwise if m[name] is None else text.format(m[name])

    short = "only after a second"
    return [
        ("played", f"{m['seconds']:.1f} s"),
        ("distance", f"{m['distance']:.1f} m"),
        ("tracking error", value("tracking_error", "{:.2f} m/s", short)),
        ("yaw rate error", value("yaw_error", "{:.2f} rad/s", short)),
        ("fall", value("fall", "after {:.1f} s", "none")),
        ("cost of transport", value("cost_of_transport", "{:.2f}", "did not go anywhere")),
    ]


def write(body: episode_lib.Body, episode: dict, out: Path, acts: str, rows, pixels=None) -> None:
    """The file that `--out` asks for; ConfigError if something that it needs is not there."""
    if out.suffix == ".html":
        page.write(body, episode, out, body.policy.robot, acts, rows)
        return
    problem = film.write(body, episode, out, pixels)
    if problem:
        raise ConfigError(f"--out={out}: {problem}; a page needs neither: --out={out.stem}.html")


def run(flags) -> None:
    """Play as the flags say, and tell what came out."""
    out = flags.out
    if out is not None:
        check_out(out)
    asked = commands(flags.command, flags.seconds)
    policy, act, acts = choose(flags)
    body, other = choice.body(policy, flags.robot_xml, flags.keep_joints)
    seconds = flags.seconds or asked.seconds
    if out is None:
        viewer.check_display()
        if flags.command is None:  # to be steered from standing
            asked = asked._replace(at=lambda t: np.zeros(3), text=viewer.KEYS)
    notes = [other, outside(policy, asked)]
    print(f"dynappo plays {policy.robot}: {acts}; {asked.text}")
    if flags.robot_xml:
        ms = body.model.opt.timestep * 1e3
        motors = "motors, joint damping and friction are the policy's"
        if flags.keep_joints or not policy.joint_damping:
            motors = "motors are the policy's, joint damping and friction its own"
        print(f"in {body.xml}: {body.substeps} steps of {ms:g} ms between two actions; {motors}")
    for note in filter(None, notes):
        print(note)
    if out is None:
        episode = viewer.watch(body, act, asked.at, flags.seconds)
    else:
        episode = episode_lib.play(body, act, asked.at, seconds)
    rows = table(body, episode)
    if out is not None:
        write(body, episode, out, acts, rows, flags.size)
        rows.append(("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB)"))
    for name, text in rows:
        print(f"{name:18s} {text}")


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

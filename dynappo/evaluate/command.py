"""The command `dynappo evaluate`: its flags, what it computes, prints and writes.

It runs two kinds of episodes, both with the policy's mean action:

- `trials.sweep`, a grid of commands in C MuJoCo: where it tracks well, what walking costs, how the
  feet move;
- `episodes`, the task it was trained on, on MJX (`evaluation.py`): return, falls and tracking error,
  the numbers to compare runs by. `--fast` leaves these out; then JAX is not imported.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mujoco

from dynappo.config import ConfigError, files
from dynappo.config import flags as flags_lib
from dynappo.evaluate import episodes, figures, trials
from dynappo.physics.robot import Robot
from dynappo.policy import choice
from dynappo.policy.episode import Body
from dynappo.policy.policy_file import Policy
from dynappo.program import devices

UNITS = {
    "return": "sum of rewards of an episode",
    "length": "control steps",
    "command": "m/s, m/s, rad/s",
    "tracking_error": "m/s",
    "yaw_error": "rad/s",
    "speed": "m/s",
    "power": "W",
    "positive_power": "W",
    "torque": "N m",
    "action_rate": "rad/s",
    "air_time": "s",
    "stride_frequency": "1/s",
    "fall": "s",
}
ROWS = (  # of the table of a sweep: name, label, format
    ("speed", "speed", "{:.2f} m/s"),
    ("tracking_error", "tracking error", "{:.2f} m/s"),
    ("yaw_error", "yaw rate error", "{:.2f} rad/s"),
    ("cost_of_transport", "cost of transport", "{:.2f}"),
    ("positive_cost_of_transport", "  of positive work alone", "{:.2f}"),
    ("torque", "mean torque of a joint", "{:.1f} N m"),
    ("action_rate", "action rate", "{:.1f} rad/s"),
    ("air_time", "foot air time", "{:.3f} s"),
    ("duty_factor", "duty factor", "{:.2f}"),
    ("stride_frequency", "stride frequency", "{:.2f} /s"),
)
MAX_EPISODES = 10**6  # of which each is a robot in memory
USAGE = """\
NAME_OR_DIR is a workdir (while it trains: its newest checkpoint), a checkpoint folder, a policy.npz,
or the name of a robot with a bundled policy
  python -m dynappo.evaluate runs/quick
  python -m dynappo.evaluate go1 --fast
  python -m dynappo.evaluate runs/go1 --randomize --episodes=200 --out=hard
  python -m dynappo.evaluate runs/sweep --run-seed=3 --out=third
  python -m dynappo.evaluate go1 --fast --robot-xml=other/scene.xml
with --robot-xml the episodes on MJX need a file that keeps the rules of robots/README.md; --fast does not
it writes evaluation.json, tracking.png (error by command) and gait.png
"""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    what = "Measure a policy: return, falls, tracking, effort and gait."
    parser = flags_lib.parser("evaluate", what, USAGE)
    flag = parser.add_argument
    choice.add_flags(parser)
    default = "default: {gpu} on a GPU, {cpu} on a CPU".format(**episodes.NUMBER)
    flag("--episodes", metavar="N", help=f"episodes of the training task, on MJX; {default}")
    flag("--randomize", action="store_true", help="MJX episodes with noise, pushes, random physics")
    flag("--seed", metavar="N", help="random seed of their commands and starts; default: 0")
    flag("--fast", action="store_true", help="no MJX episodes: C MuJoCo only, takes seconds")
    flag(
        "--out",
        metavar="DIR",
        type=flags_lib.path,
        help="folder for the results; default: WORKDIR/evaluation, or evaluation-NAME",
    )
    flags = flags_lib.read(parser, argv)
    if not flags.what:
        raise ConfigError(
            "nothing to evaluate is named; try a workdir, as in: "
            "python -m dynappo.evaluate runs/quick"
        )
    choice.check(flags)
    for name, *bounds in (("episodes", 1, MAX_EPISODES), ("seed", 0)):
        text = getattr(flags, name)
        if text is not None:
            setattr(flags, name, flags_lib.whole(name, text, *bounds))
    for name in ("episodes", "randomize", "seed"):
        value = getattr(flags, name)
        if flags.fast and value is not None and value is not False:
            raise ConfigError(f"--{name} is for the episodes on MJX, which --fast leaves out")
    return flags


def folder(what: str, path: Path) -> Path:
    """Where the evaluation of `what`, found at `path`, goes by default."""
    if what in files.robots():
        return Path(f"evaluation-{what}")
    workdir = path.parent.parent if path.is_dir() else path.parent
    if (workdir / "config.json").is_file():
        return workdir / "evaluation"
    return Path(f"evaluation-{path.stem}")


def open_folder(out: Path) -> None:
    """Make the folder; ConfigError if nothing can be written there."""
    probe = out / ".evaluation"
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(f"--out={out}: cannot write there ({error.strerror})") from None


def what(flags) -> tuple[Policy, Body, Robot | None, Path, tuple[str, str]]:
    """`(policy, body, robot, path, (source, note))` of the flags; `robot` is None with --fast.

    ConfigError for all that can be wrong, before anything is written or takes time.
    """
    policy, path, source = choice.find(flags)
    body, note = choice.body(policy, flags.robot_xml)
    robot = None
    if not flags.fast:
        episodes.settings(policy)
        robot, _ = choice.robot(policy, flags.robot_xml)
        episodes.check_robot(policy, robot)
    return policy, body, robot, path, (source, note)


def run(flags) -> None:
    """Evaluate as the flags say, tell a person what came out, and write it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    policy, body, robot, path, (source, note) = what(flags)
    out = flags.out or folder(flags.what, path)
    open_folder(out)
    screen = Console(highlight=False)
    inside = f" in {body.xml}" if flags.robot_xml else ""
    screen.print(
        f"dynappo evaluates {policy.robot}: {source}{inside}", soft_wrap=True, markup=False
    )
    if note:
        screen.print(note, soft_wrap=True, markup=False)
    columns = (TextColumn("commands"), BarColumn(24), TextColumn("{task.completed}/{task.total}"))
    with Progress(
        *columns,
        TimeRemainingColumn(),
        console=screen,
        transient=True,
        disable=not screen.is_terminal,
    ) as bar:
        task = bar.add_task("")
        numbers, recordings = trials.sweep(
            policy,
            tell=lambda done, total: bar.update(task, completed=done, total=total),
            body=body,
        )
    show_sweep(screen, numbers)
    on_mjx = None
    if not flags.fast:
        import jax

        devices.own_process()
        device = jax.default_backend()
        number = flags.episodes or episodes.NUMBER.get(device, episodes.NUMBER["cpu"])
        told = f"{number} episodes of the training task"
        if device == "cpu":
            told += ", a minute or two on two cores (--episodes=N; a GPU's default is 1000)"
        screen.print(told, soft_wrap=True)
        with screen.status("compiling and running"):
            on_mjx = episodes.run(policy, number, flags.randomize, flags.seed or 0, robot)
        show_episodes(screen, on_mjx)
    about = {"robot": policy.robot, "policy": source, "mujoco": mujoco.__version__}
    about |= {"robot_xml": flags.robot_xml} if flags.robot_xml else {}
    result = about | {"episodes": on_mjx, "sweep": numbers, "units": UNITS}
    files.write_json(out / "evaluation.json", result)
    problem = figures.write(out, policy.robot, numbers, recordings, policy.timestep)
    names = "evaluation.json" if problem else "evaluation.json, tracking.png, gait.png"
    screen.print(f"written to {out}: {names}", soft_wrap=True, markup=False)
    if problem:
        screen.print(problem, soft_wrap=True, markup=False, style="yellow")


def show_sweep(screen, numbers: dict[str, Any]) -> None:
    """The table of a sweep: over all commands, and at each speed ahead."""
    from rich.table import Table

    every, ahead = numbers["all"], numbers["ahead"]
    screen.print(
        f"{every['episodes']} commands, {numbers['seconds']:g} s each, in C MuJoCo without noise; "
        f"the first second is left out",
        soft_wrap=True,
    )
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("")
    for heading in ("all commands", *(f"{row['command'][0]:g} m/s ahead" for row in ahead)):
        table.add_column(heading, justify="right", no_wrap=True)
    falls = ["none" if row["fall"] is None else f"after {row['fall']:.1f} s" for row in ahead]
    table.add_row("falls", f"{every['falls']} of {every['episodes']}", *falls)
    for name, label, text in ROWS:
        values = [row[name] for row in (every, *ahead)]
        table.add_row(label, *("-" if v is None else text.format(v) for v in values))
    screen.print(table)
    for line in notes(numbers["commands"]):
        screen.print(line, soft_wrap=True)


def notes(rows: list[dict[str, Any]]) -> list[str]:
    """Lines on the commands tracked worst and turned worst, and on those that made the robot fall."""

    def asked(row):
        x, y, turn = row["command"]
        return f"asked for {x:g}, {y:g} m/s, {turn:g} rad/s"

    stood = [row for row in rows if not figures.gone(row)]
    fell = [row for row in rows if row["fall"] is not None]
    lines = [f"fell after {row['fall']:.1f} s, {asked(row)}" for row in fell[:5]]
    if len(fell) > 5:
        lines.append(f"fell on {len(fell) - 5} other commands: see evaluation.json")
    if stood:
        for name, label, unit in (
            ("tracking_error", "worst tracked", "m/s"),
            ("yaw_error", "worst turned", "rad/s"),
        ):
            worst = max(stood, key=lambda row, name=name: row[name])
            lines.append(f"{label}: {worst[name]:.2f} {unit}, {asked(worst)}")
    return lines


def show_episodes(screen, numbers: dict[str, Any]) -> None:
    """The table of the episodes of the task."""
    from rich.table import Table

    task = "noise, pushes, randomised physics" if numbers["randomize"] else "no noise"
    engine = devices.ENGINES[numbers["impl"]]
    screen.print(
        f"{numbers['seconds']:g} s each, commands as in training, {task}; "
        f"{engine} on {numbers['device']}",
        soft_wrap=True,
    )
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    rows = (
        ("return", "return", "{:.2f}", 1),
        ("return_std", "  standard deviation", "{:.2f}", 1),
        ("fall_rate", "episodes with a fall", "{:.1f} %", 100),
        ("length", "length", "{:.0f} control steps", 1),
        ("tracking_error", "tracking error", "{:.2f} m/s", 1),
        ("yaw_error", "yaw rate error", "{:.2f} rad/s", 1),
    )
    for name, label, text, scale in rows:
        value = numbers.get(name)
        table.add_row(
            label, "nobody stood for a second" if value is None else text.format(value * scale)
        )
    screen.print(table)


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)), "stopped; nothing is written")

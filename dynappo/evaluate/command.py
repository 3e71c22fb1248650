"""The command `dynappo evaluate`: its flags, what it computes, prints and writes.

It runs three kinds of episodes, all with the policy's mean action:

- `trials.run`, a grid of commands in C MuJoCo: where it tracks well, what walking costs, how the
  feet move; and from which speed on it follows a command from standing (`slow.py`);
- `changes`, in C MuJoCo too: whether it falls when its command changes, and on the tours of the film and
  the live page;
- `episodes`, the task it was trained on (`scores.py`): return, falls and tracking error,
  the numbers to compare runs by. `--fast` leaves these out; then JAX is not imported.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
from pathlib import Path
from typing import Any

from dynappo.config import ConfigError, files, shell
from dynappo.config import flags as flags_lib
from dynappo.description import robot as robot_lib
from dynappo.description.robot import Robot
from dynappo.evaluate import (
    changes,
    crossing,
    episodes,
    figures,
    recording,
    report,
    stairs,
    stress,
    tables,
    task_episodes,
    trials,
)
from dynappo.policy import policy_source
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy
from dynappo.program import devices
from dynappo.tasks.velocity import log_file

UNITS = {
    "return": "sum of rewards of an episode",
    "length": "control steps",
    "command": "m/s, m/s, rad/s",
    "before": "m/s, m/s, rad/s",
    "tracking_error": "m/s",
    "yaw_error": "rad/s",
    "slow": "m/s; turning left: rad/s",
    "speed": "m/s",
    "power": "W",
    "positive_power": "W",
    "torque": "N m",
    "action_rate": "rad/s",
    "air_time": "s",
    "stride_frequency": "1/s",
    "clearance": "m",
    "slip": "m/s",
    "joint_speed": "rad/s",
    "tilt": "rad",
    "height": "m",
    "fall": "s",
    "after": "s",
    "every": "s",
    "fell_at": "s",
}
RESULTS = "evaluation.json", "stress.json", "crossing.json"
STRESS_UNITS = {name: UNITS[name] for name in ("tracking_error", "yaw_error")}
FEW_CHANGES = 48  # with --fast
MAX_EPISODES = 10**6  # of which each is a robot in memory
RECORDED, MOST_SECONDS = 80, 36_000  # s of a log
MOST_NOISE = 10.0
USAGE = """\
NAME_OR_DIR is a workdir (while it trains: its newest checkpoint), a checkpoint folder, a policy.npz,
or the name of a robot with a bundled policy
  python -m dynappo.evaluate runs/laptop
  python -m dynappo.evaluate go1 --fast
  python -m dynappo.evaluate go1_deploy --stress
  python -m dynappo.evaluate runs/rough --crossing
  python -m dynappo.evaluate runs/go1 --randomize --episodes=200 --out=hard
  python -m dynappo.evaluate runs/seeds --run-seed=3
  python -m dynappo.evaluate go1 --fast --robot-xml=other/scene.xml
  python -m dynappo.evaluate go1 --record=example.npz --seconds=80 --noise=0.2
with --robot-xml the task's episodes need a file that keeps the rules of robots/README.md; --fast does not
it writes evaluation.json, report.html (tables, maps, the robot under each command), tracking.png and
gait.png; with --stress only stress.json, with --record only FILE.npz
"""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    what = "Measure a policy: return, falls, tracking, effort and gait."
    parser = flags_lib.parser("evaluate", what, USAGE)
    flag = parser.add_argument
    policy_source.add_flags(parser)
    default = "default: {gpu} on a GPU, {cpu} on a CPU".format(**episodes.NUMBER)
    flag("--episodes", metavar="N", help=f"episodes of the training task; {default}")
    flag(
        "--randomize", action="store_true", help="those episodes with noise, pushes, random physics"
    )
    flag("--seed", metavar="N", help="random seed of all episodes' commands and starts; default: 0")
    flag("--stress", action="store_true", help="robustness: delays, loads, pushes, other physics")
    flag("--crossing", action="store_true", help="rough ground: which tiles it crosses")
    flag(
        "--record",
        metavar="FILE.npz",
        type=flags_lib.path,
        help="write a log as the robot's controller would, to learn from (train --logs), and nothing else",
    )
    flag("--seconds", metavar="S", help=f"with --record: how long; default: {RECORDED}")
    flag("--noise", metavar="STD", help="with --record: of each action, in its units; default: 0")
    flag(
        "--fast",
        action="store_true",
        help="no episodes of the task, few changes of command: takes seconds",
    )
    flag(
        "--out",
        metavar="DIR",
        type=flags_lib.path,
        help="folder for the results; default: WORKDIR/evaluation (with --run-seed=K: evaluation-seed-K), "
        "or evaluation-NAME",
    )
    flag("--command", nargs="?", const="0.5,0,0", help=argparse.SUPPRESS)  # which is `play`'s
    flags = flags_lib.read(parser, argv)
    if flags.command is not None:
        raise ConfigError(
            "--command: no such flag; evaluate measures a grid of commands; to see the policy under one: "
            f"{shell.line('play', flags.what or 'NAME_OR_DIR', f'--command={flags.command}')}"
        )
    if not flags.what:
        raise ConfigError(
            "nothing to evaluate; name a workdir, as in: python -m dynappo.evaluate runs/laptop"
        )
    policy_source.check_flags(flags)
    for name, *bounds in (("episodes", 1, MAX_EPISODES), ("seed", 0)):
        text = getattr(flags, name)
        if text is not None:
            setattr(flags, name, flags_lib.whole(name, text, *bounds))
    if flags.crossing and (flags.stress or flags.fast or flags.randomize):
        raise ConfigError("--crossing: expected no --stress, --fast or --randomize beside it")
    if flags.stress and flags.fast:
        raise ConfigError("--stress: expected no --fast beside it, there is no faster one")
    for name in ("episodes", "randomize", "seed"):
        value, without = getattr(flags, name), "stress" if flags.stress else "fast"
        if name == "seed" and without == "fast":  # of the changes of command too
            continue
        if (flags.fast or flags.stress) and value is not None and value is not False:
            raise ConfigError(
                f"--{name} is for the episodes of the task, which --{without} leaves out"
            )
    _check_record(flags)
    flags.fast |= flags.stress or flags.record is not None
    return flags


def _check_record(flags) -> None:
    """Make numbers of the flags of `--record`; ConfigError if they are none, or without it."""
    if flags.record is None:
        for name in ("seconds", "noise"):
            if getattr(flags, name) is not None:
                raise ConfigError(f"--{name} is for --record=FILE.npz, which is not there")
        return
    others = [
        n
        for n in ("stress", "crossing", "fast", "randomize", "episodes", "out")
        if getattr(flags, n)
    ]
    if others or flags.record.suffix != ".npz":
        found = f"--{others[0]} beside it" if others else f"--record={flags.record}"
        raise ConfigError(
            f"{found}: expected --record=FILE.npz, with --seconds, --noise, --seed, --run-seed and "
            "--robot-xml alone"
        )
    if flags.record.exists():  # a robot's own log cannot be had again
        raise ConfigError(f"--record={flags.record}: is there already; name a new file, or move it")
    flags_lib.check_writable(flags.record, "record")
    seconds = flags.seconds or str(RECORDED)
    flags.seconds = flags_lib.whole("seconds", seconds, round(log_file.LEAST), MOST_SECONDS)
    try:
        noise = float(flags.noise or 0)
    except ValueError:
        noise = -1.0
    if not 0 <= noise <= MOST_NOISE:
        raise ConfigError(
            f"--noise={flags.noise}: expected 0 to {MOST_NOISE:g}, units of the action"
        )
    flags.noise = noise


def workdir(what: str, path: Path) -> Path | None:
    """The folder of the run or sweep that `what`, found at `path`, is of; else None."""
    found = path.parent.parent if path.is_dir() else path.parent
    written = any((found / name).is_file() for name in ("config.json", "sweep.json"))
    return found if written and what not in files.bundled() else None


def folder(what: str, path: Path, seed: int | None = None) -> Path:
    """The default folder for the evaluation of `what`, found at `path`, and of `--run-seed`: a seed's results
    replace no other's."""
    of_seed = "" if seed is None else f"-seed-{seed}"
    run = workdir(what, path)
    if run is not None:
        return run / f"evaluation{of_seed}"
    return Path(f"evaluation-{what if what in files.bundled() else path.stem}{of_seed}")


def check_folder(out: Path) -> None:
    """ConfigError if nothing can be written there; leaves nothing behind."""
    flags_lib.check_writable(out / "evaluation.json")


def rough_note(policy: Policy, flags) -> str:
    """A line on what the numbers of a policy of rough ground are of; else ""."""
    if policy.config.get("task", {}).get("terrain") != "rough" or flags.crossing or flags.record:
        return ""
    told = "note: trained on rough ground; "
    if flags.stress:
        stairs = "" if flags.robot_xml else ", and flights of stairs follow"
        return f"{told}disturbances are on a flat floor{stairs}"
    told += "commands and their changes are on a flat floor, "
    if not flags.fast:
        told += (
            "and an episode of the task ends where the robot leaves its tile, so its return is smaller than "
            "on a floor; "
        )
    return f"{told}--crossing tells which tiles it crosses"


def of_one(before: dict[str, Any], about: dict[str, Any]) -> bool:
    """Whether two results are of one policy and one robot. Names have paths as they were typed, which depend
    on the folder one is in: the policy's counts only where neither has a hash."""
    hashed = "policy_sha256" in before or "policy_sha256" in about
    name = "policy_sha256" if hashed else "policy"
    return before.get(name) == about.get(name) and of_one_robot(before, about)


def of_one_robot(before: dict[str, Any], about: dict[str, Any]) -> bool:
    """By the hash of the model, which is of a version of MuJoCo; else by the file as it was typed."""
    hashed = "robot_sha256" in before and "robot_sha256" in about
    hashed = hashed and before.get("mujoco") == about.get("mujoco")
    name = "robot_sha256" if hashed else "robot_xml"
    return before.get(name) == about.get(name)


def others(
    out: Path, about: dict[str, Any], names: tuple[str, ...] = RESULTS
) -> dict[str, Any] | None:
    """The first results in a folder that are of another policy than `about`, or in another robot's file."""
    for name in names:
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
            before = json.loads((out / name).read_bytes())
            if before["policy"] and not of_one(before, about):
                return before
    return None


def settle(flags, path: Path, about: dict[str, Any]) -> tuple[Path, str]:
    """`(folder, note)` of the results. Where another policy has the default folder they go beside it; in that
    of a run, whose policy goes on, and in `--out` they replace the old ones, and the note says so."""
    first = out = flags.out or folder(flags.what, path, flags.run_seed)
    written = "stress.json" if flags.stress else "crossing.json" if flags.crossing else RESULTS[0]
    replaced = others(out, about, (written,))
    before = replaced or others(out, about)
    if before is None:
        return out, ""
    whose = before["policy"] + f" in {before.get('robot_xml')}" * bool(before.get("robot_xml"))
    if flags.out or (of_one_robot(before, about) and workdir(flags.what, path) is not None):
        if replaced is None:
            return out, f"note: {out} also holds results of {whose}; --out=DIR keeps them apart"
        return out, f"note: replaces in {out} the results of {whose}; --out=DIR keeps both"
    numbers = itertools.count(2)
    while others(out, about) is not None:
        out = first.with_name(f"{first.name}-{next(numbers)}")
    return out, f"note: {first} holds results of {whose}; these go to {out}"


def kept_episodes(out: Path, about: dict[str, Any]) -> dict[str, Any] | None:
    """The task's episodes of the same policy that the folder has: `--fast` measures none, and loses none.
    They say which code they are of."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        before = json.loads((out / RESULTS[0]).read_bytes())
        if before["episodes"] and of_one(before, about):
            tables.episodes_text(before["episodes"])  # whether it can be shown
            tables.episodes_rows(before["episodes"])
            return {name: before[name] for name in ("commit", "mujoco")} | before["episodes"]
    return None


def inputs(flags) -> tuple[Policy, Player, Robot | None, Path, tuple[str, str]]:
    """`(policy, player, robot, path, (named, note))` of the flags; `robot` is None with --fast.

    ConfigError for all that can be wrong, before anything is written or takes time.
    """
    policy, path, named = policy_source.of_flags(flags)
    player, note = policy_source.player(policy, flags.robot_xml)
    robot = None
    if not flags.fast:
        episodes.settings(policy)
        robot, _ = policy_source.robot(policy, flags.robot_xml)
        episodes.check_robot(policy, robot)
        note = "\n".join(filter(None, (note, episodes.left_out(policy))))
    note = "\n".join(filter(None, (note, rough_note(policy, flags))))
    return policy, player, robot, path, (named, note)


def run(flags) -> None:
    """Evaluate as the flags say; print the results and write them."""
    from rich.console import Console

    if (other := policy_source.other(flags)) is not None:
        theirs, path, named = other
        config = task_episodes.check(theirs, flags)
        out, other_results = settle(flags, path, episodes.measured(theirs.params, named))
        check_folder(out)
        if other_results:
            print(other_results)
        return task_episodes.run(theirs, config, flags, named, out)
    policy, player, robot, path, (named, note) = inputs(flags)
    if flags.record:
        return _record(flags, player, named)
    about = {"robot": policy.robot, **episodes.measured(policy.params, named)}
    about["robot_sha256"] = robot_lib.digest(player.model)[:16]  # a policy may be in another's body
    about |= {"robot_xml": flags.robot_xml} if flags.robot_xml else {}
    out, other_results = settle(flags, path, about)
    check_folder(out)
    screen = Console(highlight=False, emoji=False)
    inside = f" in {player.xml}" if flags.robot_xml else ""
    text = shell.pasted(f"dynappo evaluates {policy.robot}: {named}{inside}")
    screen.print(text, soft_wrap=True, markup=False)
    for line in filter(None, (note, other_results)):
        screen.print(line, soft_wrap=True, markup=False)
    if flags.crossing:
        return _crossing(flags, screen, policy, robot, about, out)
    if flags.stress:
        with tables.progress(screen, "disturbances") as tell:
            rows = stress.run(policy, player, tell)
        tables.stress(screen, rows)
        about |= {"seconds": stress.SECONDS, "rows": rows, "units": STRESS_UNITS}
        task = policy.config.get("task", {})
        if task.get("terrain") == "rough" and not flags.robot_xml:
            with tables.progress(screen, "flights of stairs") as tell:
                about["stairs"] = stairs.run(policy, tell)
            tables.stairs(screen, about["stairs"])
        files.write_json(out / "stress.json", about)
        return screen.print(f"written to {out}: stress.json", soft_wrap=True, markup=False)
    with tables.progress(screen, "commands") as tell:
        numbers, recordings = trials.run(policy, tell=tell, player=player)
    tables.trials(screen, numbers)
    with tables.progress(screen, "changes of command") as tell:
        number = FEW_CHANGES if flags.fast else changes.NUMBER
        changed = changes.run(player, number, flags.seed or 0, tell)
        changed["tours"] = changes.tours(player)
    tables.changes(screen, changed)
    of_task = None
    if not flags.fast:
        import jax

        devices.own_process()
        device = jax.default_backend()
        number = flags.episodes or episodes.NUMBER.get(device, episodes.NUMBER["cpu"])
        told = f"evaluates {number} episodes of the training task"
        if device == "cpu":
            told += ": it compiles and runs for a minute or two on two cores"
            told += " (--episodes=N; a GPU's default is 1000)"
        screen.print(told, soft_wrap=True)
        with screen.status("compiling and running"):
            of_task = episodes.run(policy, number, flags.randomize, flags.seed or 0, robot)
        tables.episodes(screen, of_task)
    elif of_task := kept_episodes(out, about):
        told = f"keeps the {of_task['episodes']} episodes of the training task that {out} holds"
        screen.print(told, soft_wrap=True, markup=False)
    result = about | {"episodes": of_task, "sweep": numbers, "changes": changed, "units": UNITS}
    problem = figures.write(out, policy.robot, numbers, recordings, policy.timestep)
    report.write(out, named, player, numbers, recordings, changed, of_task)
    # the last: beside new numbers there is no old report
    files.write_json(out / "evaluation.json", result)
    names = "evaluation.json, report.html" + ("" if problem else ", tracking.png, gait.png")
    screen.print(f"written to {out}: {names}", soft_wrap=True, markup=False)
    if problem:
        screen.print(problem, soft_wrap=True, markup=False, style="yellow")


def _record(flags, player: Player, named: str) -> None:
    """Write what a controller would have recorded."""
    from rich.console import Console

    recording.check(player)
    screen = Console(highlight=False, emoji=False)
    with tables.progress(screen, "control steps") as tell:
        arrays = recording.record(
            player, flags.seconds, flags.noise, seed=flags.seed or 0, tell=tell
        )
    recording.save(flags.record, player, arrays)
    falls = int(arrays["fell"].sum())
    text = f"{player.policy.robot}: {named}; {flags.seconds} s, {falls} falls, written to {flags.record}"
    screen.print(f"dynappo records {text}", soft_wrap=True, markup=False)


def _crossing(flags, screen, policy: Policy, robot: Robot | None, about, out: Path) -> None:
    """Which tiles of a rough ground the policy crosses: printed, and written as crossing.json."""
    devices.own_process()
    screen.print("compiles, and tries the tiles; on a CPU minutes", soft_wrap=True)
    with screen.status("compiling and running"):
        numbers = crossing.run(policy, flags.episodes, flags.seed or 0, robot)
    tables.crossing(screen, numbers)
    files.write_json(out / "crossing.json", about | numbers)
    screen.print(f"written to {out}: crossing.json", soft_wrap=True, markup=False)


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

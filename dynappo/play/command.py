"""Show a policy walking: `dynappo play NAME_OR_DIR --command=0.8,0,0 --out=walk.html`.

C MuJoCo and NumPy, without JAX. With `--out` it writes a film, a picture or an HTML page; without,
it opens MuJoCo's viewer, where keys steer the robot. `--robot-xml` runs the policy in another file of
the same robot (sim-to-sim): `policy/episode.py` says what such a file must have.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, files, shell
from dynappo.config import flags as flags_lib
from dynappo.description import robot as robot_lib
from dynappo.page import episode_page
from dynappo.play import command_script, film, serve, task_episode, viewer
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, policy_source
from dynappo.policy.policy_file import Other, Policy

FILES = {".mp4": "a film", ".gif": "a film", ".png": "its last moment", ".html": "a page"}
USAGE = f"""\
NAME_OR_DIR is a workdir (while it trains: its newest checkpoint), a checkpoint folder, a policy.npz,
or the name of a robot with a bundled policy
  python -m dynappo.play runs/laptop --out=walk.html
  python -m dynappo.play go1 --command=0.8,0,0.3 --seconds=6 --out=turn.mp4
  python -m dynappo.play go2_rough --ground=pit_stairs:0.3 --command=0.8,0,0 --out=stairs.html
  python -m dynappo.play go1 --command=drill.csv --robot-xml=other/scene.xml --out=drill.gif
  python -m dynappo.play anymal_c --policy=random
  python -m dynappo.play runs/seeds --run-seed=3 --out=walk.html
  python -m dynappo.play runs/go1 --serve
  python -m dynappo.play go2 --serve --ground=boxes:0.3
a command script has rows t,vx,vy,wz (s, m/s, m/s, rad/s); a row holds until the next one
without --out MuJoCo's viewer opens, with these keys
  {viewer.KEYS}
"""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    what = "Show a policy walking: in a page, a film, or a viewer with keys to steer."
    parser = flags_lib.parser("play", what, USAGE)
    flag = parser.add_argument
    policy_source.add_flags(parser)
    flag(
        "--command",
        metavar="VX,VY,WZ|FILE.csv",
        help="velocities to follow: m/s, m/s, rad/s; default: a short tour",
    )
    flag(
        "--seconds",
        metavar="N",
        help=f"how long; default: {command_script.SECONDS:g}, or until the script ends",
    )
    names = "FILE.html, .mp4, .gif, or .png (the last moment)"
    flag("--out", metavar="FILE", type=flags_lib.path, help=names)
    flag(
        "--serve",
        metavar="PORT",
        nargs="?",
        const="",
        help="look and steer in a browser; default: port 8080, for this machine alone",
    )
    flag("--until-eof", action="store_true", help=argparse.SUPPRESS)  # of `train --serve`
    flag(
        "--size",
        metavar="WIDTHxHEIGHT",
        help="pixels; default: 640x360 for a film, 1280x720 for a picture",
    )
    flag("--policy", metavar="zero|random", help="zero or random actions instead of the policy's")
    flag("--seed", metavar="N", help="random seed of --policy=random; default: 0")
    flag(
        "--keep-joints",
        action="store_true",
        help="with --robot-xml: keep its damping and friction of the joints",
    )
    flag(
        "--ground",
        metavar="KIND:DIFFICULTY|FILE",
        help="a tile of rough ground, as pit_stairs:0.5, or a map, .npy or .png, in the place of the floor, "
        f"or {policy_source.FLOOR}; default: as in the policy's training",
    )
    flags = flags_lib.read(parser, argv)
    if flags.serve and not flags.what and not re.fullmatch(r"(.*:)?\d+", flags.serve):
        flags.what, flags.serve = flags.serve, ""  # --serve NAME
    if not flags.what:
        raise ConfigError(
            "nothing to play; name a workdir, as in: python -m dynappo.play runs/laptop"
        )
    if flags.keep_joints and flags.robot_xml is None:
        raise ConfigError("--keep-joints needs --robot-xml=FILE")
    if flags.policy not in (None, "zero", "random"):
        raise ConfigError(f"--policy={flags.policy!r}: expected zero or random")
    if flags.serve is not None and flags.out is not None:
        raise ConfigError("--serve and --out: expected one of them")
    policy_source.check_flags(flags)
    if flags.policy and flags.run_seed is not None:
        raise ConfigError(
            f"--run-seed={flags.run_seed}: --policy={flags.policy} plays none of a run"
        )
    if flags.seed is not None:
        flags.seed = flags_lib.whole("seed", flags.seed, 0)
    flags.size = None if flags.size is None else film.size(flags.size, flags.out)
    if flags.seconds is not None:
        seconds = command_script.number(flags.seconds)
        if seconds is None or not 0 < seconds <= command_script.LONGEST:
            raise ConfigError(
                f"--seconds={flags.seconds!r}: expected a number above 0, at most {command_script.LONGEST}"
            )
        flags.seconds = seconds
    return flags


def choose(flags) -> tuple[Policy, Callable[[np.ndarray], np.ndarray], str]:
    """`(policy, act, text)` of the command line; `text` names what acts."""
    if flags.policy is None:
        policy, _, text = policy_source.of_flags(flags)
        return policy, policy_file.actor(policy.params, policy.activation), text
    if flags.what in files.robots():
        name = f"{flags.what}.py"
        if files.find("configs", name) is None:
            raise ConfigError(f"{flags.what}: there is no configs/{name} with its gains")
        config = config_lib.validate(config_lib.load(f"configs/{name}"))
        policy = policy_file.describe(config, robot_lib.load(flags.what))._replace(mjcf="")
    else:
        policy, _, _ = policy_source.of_flags(flags)
    size = len(policy.joint_names)
    if flags.policy == "zero":
        return policy, lambda obs: np.zeros(size), "zero actions"
    draw = np.random.default_rng(
        (flags.seed, 1)
    )  # not the stream of `episode.reset`, that of seed 0
    return policy, lambda obs: draw.normal(size=size), f"random actions, seed {flags.seed}"


def check_out(flags) -> None:
    """ConfigError if nothing can be written at `--out`, or it is read; leaves no file behind."""
    if flags.out.suffix not in FILES:
        raise ConfigError(f"--out={flags.out}: expected a file named {', '.join(FILES)}")
    names = "robot_xml", "ground", "command", "terms"
    read = {f"--{name.replace('_', '-')}": getattr(flags, name) for name in names}
    flags_lib.check_kept(flags.out, {"the policy": flags.what, **read})
    flags_lib.check_writable(flags.out)


def check_seed(flags, theirs: bool) -> None:
    """Make `flags.seed` a number; ConfigError if it is given and nothing is drawn: an episode of another
    package's environment (`theirs`) begins at random."""
    drawn = flags.policy == "random" or (theirs and flags.serve is None)
    if flags.seed is not None and not drawn:
        raise ConfigError(f"--seed={flags.seed}: is for --policy=random")
    flags.seed = flags.seed or 0


def table(player: episode_lib.Player, episode: dict) -> list[tuple[str, str]]:
    """The measures of an episode as (name, value), for printing; after a fall, what they are of."""
    m = episode_lib.measures(player, episode)
    until = "" if m["fall"] is None else " until the fall"

    def value(name, text, otherwise):
        return otherwise if m[name] is None else text.format(m[name])

    played, told = f"{m['seconds']:.1f} s", episode["command"]
    short = "fell in the first second" if until else "only after a second"
    near = f"went less than {episode_lib.WAY} m{until}"
    changing = ", every change of command counted" * bool((told != told[:1]).any())
    return [
        ("played", value("fall", f"{{:.1f}} s{until}, {played} in all", played)),
        ("distance", f"{m['distance']:.1f} m{until}"),
        ("tracking error", value("tracking_error", f"{{:.2f}} m/s{until}{changing}", short)),
        ("yaw rate error", value("yaw_error", f"{{:.2f}} rad/s{until}", short)),
        ("fall", value("fall", "after {:.1f} s", "none")),
        ("cost of transport", value("cost_of_transport", f"{{:.2f}}{until}", near)),
    ]


def write(
    player: episode_lib.Player, episode: dict, out: Path, acts: str, rows, pixels=None
) -> None:
    """The file that `--out` asks for; ConfigError if something that it needs is not there."""
    if out.suffix == ".html":
        episode_page.write(player, episode, out, player.policy.robot, acts, rows)
        return
    problem = film.write(player, episode, out, pixels)
    if problem:
        raise ConfigError(f"--out={out}: {problem}; a page needs neither: --out={out.stem}.html")


def _other(flags) -> tuple[Other, str] | None:
    """`(policy, text)` where the policy is of another package's environment."""
    if flags.what in files.robots():
        return None
    try:
        found = policy_source.other(flags)
    except ConfigError:
        if flags.serve is None:
            raise
        return None  # a run that has no policy yet is served, too
    if found is None:
        return None
    policy, _, named = found
    task_episode.check(policy, flags)
    return policy, named


def on_its_floor(policy: Policy, flags) -> str:
    """A line where a policy of rough ground walks on the floor of `--robot-xml`; else ""."""
    rough = policy.config.get("task", {}).get("terrain") == "rough"
    if not rough or not flags.robot_xml or flags.ground:
        return ""
    told = f"note: trained on rough ground, here it is on the floor of {flags.robot_xml}"
    return f"{told}; --ground takes another"


def run(flags) -> None:
    """Play as the flags say, and print the measures."""
    out = flags.out
    if out is not None:
        check_out(flags)
    theirs = _other(flags)
    check_seed(flags, theirs is not None)
    commands = command_script.commands(flags.command, flags.seconds)
    if flags.serve is not None:
        serve.run(flags, theirs, choose, commands if flags.command else None)
        return
    if theirs is not None:
        return task_episode.run(*theirs, flags, commands if flags.command else None)
    policy, act, acts = choose(flags)
    # a file of the user's own has its ground
    asked = policy_source.FLOOR if flags.robot_xml and not flags.ground else flags.ground
    field, on = policy_source.ground_or_own(policy, asked)
    player, other = policy_source.player(policy, flags.robot_xml, flags.keep_joints, field)
    ranges = command_script.ranges_of(policy)
    if flags.command is None:
        commands = command_script.within(ranges, commands)
    seconds = flags.seconds or commands.seconds
    if out is None:
        viewer.check_display()
        if flags.command is None:  # to be steered from standing
            commands = commands._replace(at=lambda t: np.zeros(3), text=viewer.KEYS)
    notes = [on_its_floor(policy, flags), other, command_script.outside(ranges, commands)]
    print(shell.pasted(f"dynappo plays {policy.robot}: {acts}{on}; {commands.text}"))
    if flags.robot_xml:
        ms = player.model.opt.timestep * 1e3
        motors = "motors, joint damping and friction are the policy's"
        if flags.keep_joints or not policy.joint_damping:
            motors = "motors are the policy's, joint damping and friction its own"
        print(
            f"in {player.xml}: {player.substeps} steps of {ms:g} ms between two actions; {motors}"
        )
    for note in filter(None, notes):
        print(note)
    if out is None:
        episode = viewer.watch(player, act, commands.at, flags.seconds)
    else:
        episode = episode_lib.play(player, act, commands.at, seconds)
    rows = table(player, episode)
    if out is not None:
        write(player, episode, out, acts, rows, flags.size)
        rows.append(("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB)"))
    for name, text in rows:
        print(f"{name:18s} {text}")


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

"""Which policy, from where, and with which robot: names, paths and the flags of `play`, `evaluate`, `export`.

A policy is named by a bundled robot, a workdir, a checkpoint or a file (`locate`). Checkpoints and
`policy.npz` contain their robot's MJCF, so they can be played anywhere. If robots/ has a different robot
of the same name, the policy's own is used, and a note says so (`robot`).
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import json
import os
import re
from pathlib import Path
from typing import Any

from dynappo import config as config_lib
from dynappo.config import ConfigError, fields, files, ground_map, terms, validation
from dynappo.config import flags as flags_lib
from dynappo.description import mjcf
from dynappo.description import robot as robot_lib
from dynappo.description.robot import Robot
from dynappo.policy import checkpoint_file, policy_file, render
from dynappo.policy import episode as episode_lib
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import own as own_lib
from dynappo.terrain import map_file
from dynappo.terrain import tiles as tiles_lib
from dynappo.terrain.height_map import HeightMap

FLOOR = "floor"  # as --ground: none that is rough

# ---- the policy


def meant(text: str) -> Path:
    """The file of the bundled policy of this name, or the path; ConfigError of a robot that has no policy."""
    return policy_file.bundled(text) if text in files.bundled() else Path(text)


def locate(text: str, seed: int | None = None) -> Path:
    """The policy.npz or checkpoint folder that a name, a workdir or a path means.

    `go1` is the bundled policy, `go1_deploy` the one for hardware, `./go1` a folder. In a workdir it
    is the policy.npz, or, while the run trains, the newest checkpoint. With a `seed` it is a
    checkpoint: only checkpoints hold all seeds.
    """
    path = meant(text)
    if os.path.isfile(path):  # False, not an error, if the name is too long
        if seed is not None:
            raise ConfigError(
                f"--run-seed={seed}: {path} holds one policy; name the workdir of a run, or a checkpoint"
            )
        return path
    if not os.path.isdir(path):
        raise ConfigError(f"{text}: no such file or folder; {expected(text)}")
    if (path / checkpoint_file.STATE).is_dir():
        return path
    if seed is None and (path / "policy.npz").is_file():
        return path / "policy.npz"
    _check_no_sweep(text, path, seed)
    folder = path / "checkpoints" if (path / "checkpoints").is_dir() else path
    saved = checkpoint_file.iterations(folder)
    if not saved:
        lacks = "neither a policy.npz nor checkpoints/" if seed is None else "no checkpoints/"
        runs = [run.parent for run in sorted(path.glob("*/config.json"))]
        then = "expected a workdir of `dynappo train`" + ", or a policy.npz" * (seed is None)
        if runs:
            then = f"name one of the runs in it: {mjcf.listed(runs)}"
        raise ConfigError(f"{text}: holds {lacks}; {then}")
    return folder / str(saved[0])


def _check_no_sweep(text: str, path: Path, seed: int | None) -> None:
    """ConfigError for the folder of a sweep: it holds no seeds, and without an end no policy."""
    if not (path / "sweep.json").is_file():
        return
    runs = sorted(config.parent for config in path.glob("*/config.json"))
    some = (run for run in runs if checkpoint_file.iterations(run / "checkpoints"))
    such = next(some, None)
    lacks = "has not ended, or is not ranked, so it has no policy.npz"
    if seed is not None:
        lacks = f"has no seed {seed} itself"
    then = (
        f"name one of its runs, such as {such}" if such else "none of its runs has a checkpoint yet"
    )
    raise ConfigError(f"{text}: is a sweep, which {lacks}; {then}")


def expected(text: str) -> str:
    """Words on the bundled policy whose name is near `text`, which is none; else on all that can be named."""
    name = re.sub("[:-]", "_", text.lower())  # train's go1:deploy, too
    if near := difflib.get_close_matches(name, files.bundled(), 1, 0.75):
        return f"did you mean {near[0]}?"
    return f"expected a workdir, a checkpoint, a policy.npz or one of {', '.join(files.bundled())}"


def load(text: str, seed: int | None = None) -> tuple[Policy, Path]:
    """`(policy, path)` of what `text` means (see `locate`), of several seeds number `seed`."""
    path = locate(text, seed)
    if path.is_dir():
        return policy_file.load_checkpoint(path, seed), path
    return policy_file.load(path), path


def named(what: str, path: Path) -> str:
    """The policy that `what` means, found at `path`, for printing: a relative path as it is, of an absolute
    one folder and file; a bundled one begins with robots/, and a file or folder of its name that is here is
    told apart."""
    bundled = what in files.bundled()
    apart = f", not that of ./{what}" if bundled and os.path.exists(what) else ""
    if not bundled and not path.is_absolute():
        return path.as_posix()
    return "/".join(path.resolve().parts[-3 if bundled else -2 :]) + apart


def with_terms(policy: Policy, file: Path | None) -> tuple[Policy, str]:
    """`(policy, text)` with the terms of a file that the user has named; `text` says so, "" without a file.

    The file may have changed since the training, but not in what the policy sees: ConfigError then, and where
    the policy has no terms of one's own.
    """
    if file is None:
        return policy, ""
    task = policy.config.get("task", {})
    if not task.get("terms_hash"):
        raise ConfigError(f"--terms={file}: the policy was trained without terms of one's own")
    if not file.is_file():
        raise ConfigError(f"--terms={file}: no such file")
    config = config_lib.from_json(json.dumps(policy.config))
    terms.use(config, terms.read(file))
    here = config.to_dict()["task"]
    names = "terms", "terms_hash", "terms_about", "own", "weights", "noise"
    now = policy.config | {"task": task | {name: here[name] for name in names}}
    new = policy._replace(config=now)
    if new.own != policy.own:
        before, after = (", ".join(each.name for each in x.own) or "none" for x in (policy, new))
        raise ConfigError(
            f"--terms={file}: its quantities of an observation are {after}, those of the policy {before}, or "
            "of other sizes; name the file as it was"
        )
    since = ", which has changed since the training" * (here["terms_hash"] != task["terms_hash"])
    return new, f", with {file.name}{since}"


def other(flags: argparse.Namespace) -> tuple[policy_file.Other, Path, str] | None:
    """`(policy, path, text)` of the flags where it is one of another package's environment; else None."""
    path = locate(flags.what, flags.run_seed)
    found = policy_file.load_other(path, flags.run_seed)
    if found is None:
        return None
    if flags.robot_xml is not None:
        raise ConfigError(
            f"--robot-xml={flags.robot_xml}: {path} is a policy of {found.config.env}"
        )
    seed = f", seed {flags.run_seed}" if flags.run_seed is not None else ""
    return found, path, named(flags.what, path) + seed + _how_far(found.iteration, found.sim_steps)


def _how_far(iteration: int | None, sim_steps: int | None) -> str:
    """Words on how far a policy's run was, named as in metrics.csv; "" where that is not known."""
    text = f", iteration {iteration}" if iteration is not None else ""
    return text + (f", {sim_steps:,} simulator steps" if sim_steps is not None else "")


def _recorded(what: str, path: Path) -> str:
    """As `_how_far`, of a bundled policy whose file does not say it: what the record beside it says."""
    record = path.with_suffix(".json")
    if what not in files.bundled() or not record.is_file():
        return ""
    known = json.loads(record.read_bytes())
    far = _how_far(*(known.get(name) for name in policy_file.TRAINED))
    return far and f"{far} by {record.name}"


# ---- its robot


def robot(policy: Policy, xml: str | None = None) -> tuple[Robot, str]:
    """`(robot, note)`: the policy's own, or `--robot-xml`, which must keep the contract.

    `note` says if robots/ has a different robot of that name, else it is "". If both are the same, the
    one in robots/ is returned: its file may have meshes and textures, which a policy cannot contain.
    """
    if xml is not None:
        return _of_flag(xml, lambda path: robot_lib.load_xml(path)._replace(name=policy.robot)), ""
    if not policy.mjcf:
        return robot_lib.load(policy.robot), ""
    own = robot_lib.load_text(policy.mjcf, policy.robot, Path(f"{policy.robot}.xml"))
    try:
        here = robot_lib.load(policy.robot)
    except ConfigError:  # there is none, or it cannot be used
        return own, ""
    if robot_lib.same(own, here):
        return here, ""
    return own, (
        f"note: {here.xml} is another robot than the {policy.robot} that the policy carries; that one is "
        f"used (--robot-xml={here.xml} takes yours)"
    )


def player(
    policy: Policy,
    xml: str | None = None,
    keep_joints: bool = False,
    field: HeightMap | None = None,
) -> tuple[episode_lib.Player, str]:
    """`(player, note)` in C MuJoCo, as `robot`; here `--robot-xml` needs only the policy's joints. `field` is
    the ground; None: the floor of the file."""
    if xml is None:
        own, note = robot(policy)
        text = own.played
        found = episode_lib.load(own.xml, policy, policy.timestep, text=text, field=field)
        return found, "; ".join(filter(None, [note, _not_ended(found)]))
    other = _of_flag(
        xml, lambda path: episode_lib.load(path, policy, keep_joints=keep_joints, field=field)
    )
    note = f"note: {xml} has no floor; one is added" * mjcf.floor_added(other.model)
    return other, "; ".join(filter(None, [note, _not_ended(other)]))


def _not_ended(player: episode_lib.Player) -> str:
    """A note on ends of one's own that this player does not know; or ""."""
    known = episode_lib.ends(player)
    lacks = [
        name
        for name in own_lib.told_ends(player.policy.config.get("task", {}))
        if name not in known
    ]
    why = (
        "they ask for what play does not know"
        if player.own.terms.path
        else "name their file: --terms"
    )
    return f"note: nothing ends here by {', '.join(lacks)} ({why})" if lacks else ""


def ground(policy: Policy, text: str) -> HeightMap | None:
    """The ground of `--ground=KIND:DIFFICULTY`, a tile of those that the policy's config has, or of
    `--ground=FILE`, with the config's `cell` and `map_level`. None: `--ground=floor`, that of the file.

    ConfigError if there is no such kind or file, the map is smaller than a tile, or the config's tiles cannot
    be made.
    """
    if text == FLOOR:
        return None
    if text.lower().endswith(map_file.SUFFIXES):
        group = tiles(policy)
        try:
            found = map_file.load(text, group.map_level, group.cell)
            ground_map.room(group, found, text)
        except (map_file.BadMap, ConfigError) as error:
            raise ConfigError(f"--ground: {error}") from None
        return found
    kind, _, hard = text.partition(":")
    try:
        difficulty = float(hard)
    except ValueError:
        difficulty = -1.0
    if kind not in tiles_lib.KINDS or not 0 <= difficulty <= 1:
        raise ConfigError(
            f"--ground={text}: expected a kind and its difficulty, 0 to 1, as pit_stairs:0.5, or a file, "
            f".npy or .png, or {FLOOR}; kinds are {', '.join(tiles_lib.KINDS)}"
        )
    return tiles_lib.single(tiles(policy), kind, difficulty)


def ground_or_own(policy: Policy, text: str | None) -> tuple[HeightMap | None, str]:
    """`(ground, ", on what")` of `--ground`, or where there is none what the policy was trained for: a tile
    as in its run's film, or the run's map. None: a floor."""
    if text or policy.config.get("task", {}).get("terrain") != "rough":
        field = ground(policy, text) if text else None
    else:
        own = tiles(policy)
        try:
            field, text = render.filmed(own), own.map or "{}:{}".format(*render.FILMED)
        except ConfigError as error:  # a map that is not on this machine
            raise ConfigError(f"{error}; --ground={FLOOR} takes a floor") from None
    if not text or field is None:
        return field, ""
    size = ""
    if text.lower().endswith(map_file.SUFFIXES):
        x, y = (field.cell * (count - 1) for count in field.heights.shape)
        size = f" ({x:.3g} x {y:.3g} m, cells of {field.cell:g} m)"
    return field, f", on {Path(text).name}{size}"


def tiles(policy: Policy) -> Any:
    """The group `task.tiles` of the policy's config, checked; of an older policy the default's."""
    group, found = fields.defaults().task.tiles, policy.config.get("task", {}).get("tiles", {})
    for name in group if isinstance(found, dict) else ():
        field, full = fields.every()[f"task.tiles.{name}"], f"task.tiles.{name}"
        value = fields.convert(field, found.get(name, group[name]))
        if value is None:
            raise ConfigError(f"the policy's config has {full} = {found[name]!r}")
        fields.check(full, value)
        group[name] = value
    validation.check_tiles(group)
    return group


def _of_flag(xml: str, load):
    """`load(path)` of `--robot-xml`; errors name the flag."""
    if not os.path.isfile(xml):
        found = "it is a folder" if os.path.isdir(xml) else "no such file"
        raise ConfigError(f"--robot-xml={xml}: {found}, expected an MJCF")
    with contextlib.suppress(OSError), open(xml, "rb") as file:
        start = file.read(2**16).removeprefix(b"\xef\xbb\xbf").lstrip()
        if not start.startswith(b"<"):  # else MuJoCo speaks of decoders, or of a parser's error 8
            raise ConfigError(f"--robot-xml={xml}: it is no XML, expected an MJCF")
    try:
        return load(Path(xml))
    except ConfigError as error:  # its text begins with the path
        raise ConfigError(f"--robot-xml={error}") from None


def carried(about: dict[str, Any], name: str, folder: Path) -> Robot | None:
    """The robot in a checkpoint's `about`; None where it holds none, as old ones."""
    text = about.get("mjcf", "")
    return robot_lib.load_text(text, name, folder) if isinstance(text, str) and text else None


def of_name(name: str) -> Robot | None:
    """The robot of a run; None in another environment, or where its file cannot be used."""
    try:
        return robot_lib.load(name) if name else None
    except ConfigError:
        return None


def check_same_robot(workdir: Path, about: dict[str, Any], name: str) -> None:
    """ConfigError if robots/NAME is a different robot from the one that the run in `workdir`
    trains.

    `about` is that of its newest checkpoint. Old checkpoints that store no robot are not checked.
    """
    there = carried(about, name, workdir / "checkpoints")
    if there is None:
        return
    here = robot_lib.load(name)
    if not robot_lib.same(there, here):
        raise ConfigError(
            f"--workdir={workdir}: {here.xml} is another robot than the run began with; choose another "
            "folder, --fresh to start over, or put the old file back: dynappo export "
            f"{workdir} --out={name}.xml writes it"
        )


# ---- the flags


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Add the policy's name, `--run-seed`, `--robot-xml` and `--terms`."""
    what = "workdir, checkpoint, policy.npz or robot"
    parser.add_argument("what", nargs="?", metavar="NAME_OR_DIR", help=what)
    parser.add_argument(
        "--run-seed",
        metavar="K|best",
        default="best",
        help="of a run of several seeds: number K, 0 to run.num_seeds - 1, or the best in the last "
        "evaluation (the first if there was none); default: best",
    )
    parser.add_argument(
        "--robot-xml", metavar="FILE", help="another MJCF with the same joint names"
    )
    parser.add_argument(
        "--terms",
        metavar="FILE",
        type=flags_lib.path,
        help="of a policy with terms of your own: their file, which runs as Python",
    )


def check_flags(flags: argparse.Namespace) -> None:
    """Make `flags.run_seed` a number, or None for the best; ConfigError if it is neither."""
    if flags.run_seed == "best":
        flags.run_seed = None
        return
    try:
        flags.run_seed = flags_lib.whole("run-seed", flags.run_seed, 0)
    except ConfigError as error:
        raise ConfigError(f"{error}; or best") from None


def of_flags(flags: argparse.Namespace) -> tuple[Policy, Path, str]:
    """`(policy, path, text)` of the flags; `text` names the file and the seed, for printing."""
    policy, path = load(flags.what, flags.run_seed)
    policy, own = with_terms(policy, flags.terms)
    text = named(flags.what, path)
    run = policy.config.get("run", {})
    seeds = run.get("num_seeds") if isinstance(run, dict) else None
    if policy.seed is not None:
        text += f", seed {policy.seed}" + (f" of 0 to {seeds - 1}" if type(seeds) is int else "")
    far = _how_far(policy.iteration, policy.sim_steps) or _recorded(flags.what, path)
    return policy, path, text + far + own

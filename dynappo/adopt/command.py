"""Make a robot of a published MJCF or URDF: `dynappo adopt FILE --name=NAME`.

It writes robots/NAME/ (the MJCF in the form that dynappo trains, the published looks, a README with source,
licence and every assumption) and configs/NAME.py, and prints the next command. What `look` or `train` would
refuse is refused before anything is kept. It asks nothing, and overwrites nothing without --force. C MuJoCo
and NumPy, without JAX; it takes a few seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import NamedTuple

import mujoco

from dynappo import config as config_lib
from dynappo.adopt import gains, looks, normal, pose, source, writing
from dynappo.config import ConfigError, files, interpreter, shell
from dynappo.config import flags as flags_lib
from dynappo.description import collision, complete, faults, mjcf, motors, robot_contract
from dynappo.description import robot as robot_lib
from dynappo.description import text as text_lib
from dynappo.physics import engine_contract
from dynappo.tasks.velocity import gait, partners, reward_sum

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
NEEDS_ACTION = "EDIT NEEDED: ", "note: "  # how lines begin that ask for something
GPUS = "/dev/nvidia[0-9]*", "/dev/dxg"  # of Linux, of Windows' Linux
USAGE = """\
FILE is an MJCF or a URDF, as it was published; MuJoCo reads both
  python -m dynappo.adopt mujoco_menagerie/unitree_go1/go1.xml --name=my_go1
  python -m dynappo.look configs/my_go1.py --out=look.png
  python -m dynappo.train --config=configs/my_go1.py
what it assumes, and how to change it: robots/README.md
"""


class Adopted(NamedTuple):
    """What is written, and a line on each thing that was assumed."""

    mjcf: str
    config: str
    readme: str
    notes: list[str]


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    what = "Make a robot of a published MJCF or URDF: robots/NAME/ and configs/NAME.py."
    parser = flags_lib.parser("adopt", what, USAGE)
    flag = parser.add_argument
    flag("file", nargs="?", metavar="FILE", type=flags_lib.path, help="an MJCF or a URDF")
    flag(
        "--name", metavar="NAME", help="the robot's name here; else the file's, without its suffix"
    )
    flag("--force", action="store_true", help="write anew what is there already")
    _, rest = flags_lib.read_known(parser, argv)
    if rest and not rest[0].startswith("-"):
        raise ConfigError(
            f"{rest[0]}: expected one FILE; the robot's name is a flag: --name={rest[0]}"
        )
    flags = flags_lib.read(parser, argv)
    if flags.file is None:
        raise ConfigError("no file given; try: python -m dynappo.adopt FILE.xml --name=NAME")
    flags.notes = []
    if flags.name is None:
        flags.name = name_of(flags.file)
        if flags.name != flags.file.stem and flags.file.is_file():  # else that is what is wrong
            flags.notes.append(
                f"name: {flags.name}, for a name has letters, digits and _, a letter first; --name=NAME "
                "takes another"
            )
    if not NAME.fullmatch(flags.name):
        raise ConfigError(
            f"--name={flags.name}: expected letters, digits and _, a letter first, as in --name=my_robot"
        )
    return flags


def name_of(file: Path) -> str:
    """A robot's name by its file: `my_robot` of my-robot.xml, `robot_3` of 3.xml."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", file.stem)
    return name if name[:1].isalpha() else f"robot_{name.lstrip('_')}"


def check_free(name: str, force: bool) -> tuple[Path, Path]:
    """`(folder, config file)` that will be written, in the working directory; ConfigError if they are
    taken."""
    folder, config = Path("robots") / name, Path("configs") / f"{name}.py"
    robot, _, kind = name.rpartition("_")
    theirs = ("configs", f"{name}.py"), ("robots", f"{name}/{name}.xml")
    theirs += (("robots", f"{robot}/{kind}.npz"),) * (kind in files.MORE)
    found = [files.find(*path, own=True) for path in theirs]
    # in a clone, robots that were adopted before lie among dynappo's own
    if any(path and writing.ADOPTED.encode() not in path.read_bytes() for path in found):
        raise ConfigError(f"--name={name}: dynappo has that itself; take another name")
    for path in (folder, config):
        if path.exists() and not force:
            raise ConfigError(f"{path} is there already; take another --name, or add --force")
    return folder, config


def make(file: source.Source, name: str, part: Path) -> Adopted:
    """The texts of an adopted robot; its looks' files are copied to `part`/assets.

    ConfigError if the file cannot be completed, with its path.
    """
    notes = list(file.notes)
    with mjcf.one_line(file.xml):
        spec, robot, more = completed(file, name)
        notes += more
        published, more = source.published(file, robot.joint_names)
        notes += more
        effort, _ = gains.efforts(robot, published)
        notes += normal.joints(spec, robot.joint_names, published, effort)
        robot = loaded(spec, name, file)
        chosen, more = gains.choose(robot, published, writing.init_std(robot))
        if len(robot.foot_names) > 2:
            poses = gains.stance(robot, chosen.kp, chosen.kd, chosen.effort_limit)
            notes += normal.clear(spec, robot, poses)
            robot = loaded(spec, name, file)
        notes += [*more, *writing.assumed(robot)]
        base = robot.mj_model.body(robot.base_body).name
        shown, copied = looks.draw(spec, file, base, part / "assets")
        if shown:
            notes.append(f"looks: {shown} shapes as published" + f", {copied} files" * bool(copied))
        else:
            notes.append(
                "looks: the shapes that touch the floor are drawn; the published ones are not there"
            )
        normal.scene(spec, float(robot.home_qpos[2]))
        spec.modelfiledir = str(part)
        spec.modelname = name
        spec.compile()
        text = writing.mjcf(spec, name, file)
        licence = source.licence(file.xml)
        where = f"found at {licence[0]}: check that it is of this robot" if licence[0] else ""
        notes.append(f"licence: {where or 'none found; ask before you share this robot'}")
        return Adopted(
            mjcf=text,
            config=writing.config(robot, file, chosen),
            readme=writing.readme(robot, file, notes, licence, shown),
            notes=notes,
        )


def completed(file: source.Source, name: str) -> tuple[mujoco.MjSpec, robot_lib.Robot, list[str]]:
    """`(spec, robot, lines)`, with the first default pose in which the robot stands; the first one's error if
    there is none."""
    problem: Exception | None = None
    for spec, notes in pose.candidates(file.spec, file.model, file.xml):
        try:
            done = complete.complete(spec)
            # written and read again: no classes, frames or fromto are left that hold what is set below
            spec = mujoco.MjSpec.from_string(text_lib.self_contained(done.spec))
            notes += [*done.notes, *normal.solver(spec, float(done.model.body_mass.sum()))]
            notes += [*normal.feet(spec), *normal.frames(spec, spec.compile())]
            robot = loaded(spec, name, file)
            notes += normal.round_feet(spec, robot)
            notes += normal.shanks(spec, loaded(spec, name, file))
            return spec, loaded(spec, name, file), notes
        except (ValueError, ConfigError) as error:
            problem = problem or error
    assert problem
    said = faults.of_spec(file.fresh, pose=bool(file.spec.keys))
    if said and not any(collision.NO_FOOT in one for one in said):
        raise ValueError(robot_contract.in_words(said))
    if collision.NO_FOOT in str(problem):
        raise ValueError(
            "no legs found: no limb without wheels ends near the robot's lowest point in the home pose; "
            "only robots on feet are adopted. If it has feet, name their shapes NAME_foot, NAME_foot1, "
            "... in the file"
        )
    raise problem


def loaded(spec: mujoco.MjSpec, name: str, file: source.Source) -> robot_lib.Robot:
    """The robot of a spec; a ConfigError names the file that the spec was made from."""
    spec.compile()
    try:
        return robot_lib.load_text(spec.to_xml(), name, file.xml)
    except ConfigError as error:
        raise ConfigError(str(error).replace("the robot that it carries: ", "")) from None


@contextlib.contextmanager
def new_folder(folder: Path):
    """Yields a folder beside `folder`; at the end it becomes `folder`, or its files replace those there
    and the looks of an earlier adoption. After an error nothing is left."""
    part = folder.with_name(f".{folder.name}.part")
    missing = [above for above in part.parents if not above.exists()]
    try:
        shutil.rmtree(part, ignore_errors=True)  # of a process that was killed
        part.mkdir(parents=True)
        yield part
        if folder.exists():  # what somebody else put there stays
            old = looks.written(folder / "assets")
            shutil.copytree(part, folder, dirs_exist_ok=True)
            looks.remove([path for path in old if not (part / "assets" / path.name).exists()])
            shutil.rmtree(part)
        else:
            part.rename(folder)
    except BaseException as error:
        shutil.rmtree(part, ignore_errors=True)
        for above in missing:
            with contextlib.suppress(OSError):
                above.rmdir()
        if isinstance(error, OSError) and str(part) in str(error.filename):
            error.filename = str(folder)  # a name that somebody knows
        raise


def check_writable(folder: Path, config: Path) -> None:
    """ConfigError if robots/NAME/ or configs/NAME.py cannot be written."""
    for path in (folder / "README.md", config):
        above = next(one for one in path.parents if os.path.lexists(one))
        if not above.is_dir():
            raise ConfigError(f"{path} cannot be written: {above} is no folder; move it away")
        if not os.access(above, os.W_OK | os.X_OK):
            raise ConfigError(
                f"{path} cannot be written: no permission to write in {above.resolve()}; "
                "work in another folder"
            )
        if path.is_dir():
            raise ConfigError(f"{path} cannot be written: it is a folder; move it away")


def run(flags) -> None:
    """Adopt the robot as the flags say; print each assumption, then what needs action, then what is next."""
    if flags.file.suffix.lower() not in source.SUFFIXES:
        source.read(flags.file)  # what it is not comes before what its name is not
    folder, config = check_free(flags.name, flags.force)
    check_writable(folder, config)
    notes: list[str] = flags.notes
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numbers in the file that overflow
            file = source.read(flags.file, notes)
            with new_folder(folder) as part:
                made = made_of(file, flags.name, part)
                engine, seen = check(part, flags.name, made, file.xml)
    except (ConfigError, FloatingPointError):
        for line in notes:  # what was found before the error may explain it
            print(line)
        raise
    files.write_text(config, made.config)
    written = f"written {folder / f'{flags.name}.xml'}, {config}, {folder / 'README.md'}"
    lines = [*made.notes, written, "", *seen]
    action = [line for line in lines if line.startswith(NEEDS_ACTION)]
    print("\n".join(line for line in lines if line not in action))
    if action:
        print("\n".join(["", *action]))
    train = f"python -m dynappo.train --config={config}{'' if has_gpu() else ':laptop'}"
    print(f"\nnext    {shell.pasted(train)}{engine and f' --config.physics.impl={engine}'}")


def has_gpu() -> bool:
    """Whether `train` would find an NVIDIA GPU, without JAX: a device of the driver, unless JAX is kept from
    it."""
    platforms = os.environ.get("JAX_PLATFORMS", "")
    if platforms and not re.search("cuda|gpu", platforms):
        return False
    return any(glob.glob(pattern) for pattern in GPUS)


def made_of(file: source.Source, name: str, part: Path) -> Adopted:
    """`make`; every error that a file causes is a ConfigError."""
    try:
        return make(file, name, part)
    except (ConfigError, OSError, MemoryError):
        raise
    except Exception as error:  # a file may have anything: no command ends in a traceback for it
        what = " ".join(str(error).split())
        raise ConfigError(
            f"{file.xml}: it cannot be adopted ({type(error).__name__}: {what})"
        ) from error


def check(part: Path, name: str, made: Adopted, xml: Path) -> tuple[str, list[str]]:
    """Write the robot's files to `part`, and do what `look` and `train` do before they accept a robot.

    The result is the engine to name to `train` ("" if what it chooses itself can simulate the robot), and
    what `look` says. An error, as they have it, if they would refuse the robot.
    """
    files.write_text(part / f"{name}.xml", made.mjcf)
    files.write_text(part / "README.md", made.readme)
    robot = robot_lib.load_xml(part / f"{name}.xml")
    with tempfile.TemporaryDirectory() as folder:
        above = Path(folder)  # a working directory that has the robot
        files.write_text(above / "configs" / f"{name}.py", made.config)
        shutil.copytree(part, above / "robots" / name)
        file = str(above / "configs" / f"{name}.py")
        config = config_lib.validate(config_lib.load(file), robot_here=False)
        engine = check_trainable(config, robot, xml)
        seen = look(above, name)
        picture = above / "robots" / name / "look.png"
        if picture.exists():
            shutil.copyfile(picture, part / picture.name)
    return engine, seen


def check_trainable(config, robot: robot_lib.Robot, xml: Path) -> str:
    """ConfigError if `train` would refuse the robot; the engine to name to it, or ""."""
    config, robot = motors.fitted(config, robot)
    robot_lib.check_base_mass(robot, config.task.randomize.base_mass)
    gait.check(config.task.gait_frequency, robot.name, len(robot.foot_names))
    reward_sum.terms_of(config.task)
    if config.ppo.symmetry:
        hint = "correct places, axes and default angles of its joints: left and right must be alike"
        try:
            partners.joints(robot)
            hint = "make these numbers alike in the file"
            partners.check_motors(config.task, robot)
        except ConfigError as error:
            raise ConfigError(f"{xml}: {error}; {hint}") from None
    robot = robot._replace(xml=xml)  # errors name the file that can be edited
    warp = has_gpu() and importlib.util.find_spec("warp")
    for impl in ("warp", "jax") if warp else ("jax",) if has_gpu() else ("jax", "c"):
        if not engine_contract.lacks(robot, config.physics, impl):
            return "" if impl == ("warp" if warp else "jax") else impl
    engine_contract.check(robot, config.physics, "warp" if warp else "jax")
    return ""


def look(folder: Path, name: str) -> list[str]:
    """What the command `look` says in the working directory `folder`, which gets its picture.

    Without OpenGL it draws nothing, which is a note; what it refuses is an error.
    """
    config, picture = Path("configs") / f"{name}.py", Path("robots") / name / "look.png"
    command = [*interpreter.command("dynappo.look"), str(config), f"--out={picture}"]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", cwd=folder)
    here = done.stdout.replace(str(folder.resolve()), str(Path.cwd()))
    here = here.replace(str(folder), str(Path.cwd()))
    said = done.stderr.strip().removeprefix("dynappo: ")
    lines = here.splitlines()
    if said.startswith("--out="):
        return [*lines, f"note: {said}"]
    if done.returncode:
        raise (ConfigError if done.returncode == 2 else FloatingPointError)(
            f"{name} is not kept, for look refuses it: {said.splitlines()[-1] if said else done.returncode}"
        )
    if said:
        print(said, file=sys.stderr)
    return lines


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

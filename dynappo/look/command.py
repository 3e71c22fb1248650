"""Check a robot before training: `dynappo look CONFIG --out=look.png`.

It shows what the MJCF and the config add up to: mass, joints, whether the PD is stable, and how the
robot stands with it. C MuJoCo and NumPy, without JAX; it takes a second or two.
"""

from __future__ import annotations

import argparse

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, per_joint
from dynappo.config import flags as flags_lib
from dynappo.look import facts
from dynappo.physics import motors
from dynappo.physics import robot as robot_lib
from dynappo.physics.warp import scope
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, render

SINKS = 0.2  # of its height: more is no sag
RESTS = 0.02  # m in the last second: more is not at rest
USAGE = """\
CONFIG is a robot's name, or its config file; you can set any field
  python -m dynappo.look go1
  python -m dynappo.look configs/mine.py --out=look.png
  python -m dynappo.look configs/mine.py --config.task.kp=60 --config.task.kd=2
how to add a robot, and how to fix what you see: robots/README.md
"""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line, its config loaded; ConfigError if it cannot be understood."""
    what = "Check a robot before training: mass, joints, stability, how it stands."
    parser = flags_lib.parser("look", what, USAGE)
    flag = parser.add_argument
    flag(
        "what",
        nargs="?",
        metavar="CONFIG",
        help="a robot or a config file: NAME[:VARIANT] or FILE.py[:VARIANT]",
    )
    flag("--out", metavar="FILE.png", type=flags_lib.path, help="a picture of the robot after 5 s")
    flags, rest = flags_lib.read_known(parser, argv)
    if not flags.what:
        raise ConfigError("no config given; try: python -m dynappo.look go1")
    if flags.out is not None and flags.out.suffix != ".png":
        raise ConfigError(f"--out={flags.out}: expected a file named .png")
    flags.config = config_lib.validate(flags_lib.load(flags.what, rest))
    return flags


def about(robot: robot_lib.Robot, config, pd: facts.PD) -> list[tuple[str, str]]:
    """What can be said before it stands, as (name, text) for a person."""
    task, dt = config.task, config.physics.timestep
    kp, kd = (per_joint.in_words(x, robot.joint_names) for x in (task.kp, task.kd))
    verdict = "stable" if pd.damping < 1 else "the joints chatter"
    verdict = "unstable" if pd.bound >= 2 else verdict
    return [
        ("robot", f"{robot.name}, {robot.xml}"),
        ("mass", f"{robot.mj_model.body_mass.sum():.2f} kg"),
        ("PD", f"kp {kp} N m/rad, kd {kd} N m s/rad, a step of {dt * 1e3:g} ms"),
        (
            "  is",
            f"{verdict}: damping takes {pd.damping:.2f} of a joint's speed in a step (below 1; "
            f"better below 0.5), stable below steps of {pd.longest * 1e3:.1f} ms",
        ),
    ]


def standing(robot: robot_lib.Robot, config, stood: dict) -> list[tuple[str, str]]:
    """How it stood, as (name, text) for a person."""
    home, rest, share = robot.home_qpos[2], stood["rest"], stood["share"]
    worst = int(share.argmax())
    most, name = abs(stood["torque"][worst]), robot.joint_names[worst]
    limit = np.broadcast_to(config.task.effort_limit, len(share))[worst]
    return [
        (
            "sag",
            f"{(home - rest) * 1e3:.0f} mm in {facts.SECONDS:g} s: the base at {home:.3f} m, then "
            f"{rest:.3f} m; in the last second it moved by {stood['moved'] * 1e3:.1f} mm",
        ),
        ("torque", f"up to {most:.1f} N m, at {name}: {share[worst]:.0%} of the limit {limit:g}"),
    ]


def joints(robot: robot_lib.Robot, torque: np.ndarray) -> list[str]:
    """A line a joint: default pose, range, and the torque that it holds when standing."""
    width = max(map(len, robot.joint_names))
    lines = [f"{'joint':{width}}  default    range (rad)       torque standing (N m)"]
    for name, angle, held in zip(robot.joint_names, robot.default_pose, torque, strict=True):
        low, high = robot.mj_model.joint(name).range
        lines.append(f"{name:{width}}  {angle:7.3f}  {low:7.3f} to {high:6.3f}  {held:8.2f}")
    return lines


def notes(robot: robot_lib.Robot, config, pd: facts.PD, stood: dict) -> list[str]:
    """A line on each thing that should be changed before it is trained."""
    home, out = robot.home_qpos[2], []
    if pd.damping >= 1 or pd.bound >= 2:
        out.append(
            "lower task.kd or task.kp, raise armature, damp in the file, or shorten the step"
        )
    if stood["fall"] is not None:
        out.append(f"a part that is no foot touches the ground after {stood['fall']:.2f} s")
    if home - stood["rest"] > SINKS * home:
        out.append("it kneels or lies: raise task.kp, or look at the feet and the centres of mass")
    if stood["moved"] > RESTS:
        out.append("it does not come to rest")
    if stood["share"].max() >= 1:
        out.append("a motor is at task.effort_limit: it cannot hold the robot")
    if slow := scope.slower(robot, config.physics, config.task.remember_ground):
        out.append(slow)
    return [f"note: {line}" for line in out]


def run(flags) -> None:
    """Look at the robot as the flags say, and tell what there is to see."""
    if flags.out is not None:
        flags_lib.check_writable(flags.out)
    config = flags.config
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    described = policy_file.describe(config, robot)
    pd = facts.pd(robot, config.task.kp, config.task.kd, config.physics.timestep)
    body = episode_lib.load(robot.xml, described, described.timestep)
    show(about(robot, config, pd))  # before it stands: physics may blow up
    episode, stood = facts.stand(body)
    show(standing(robot, config, stood))
    for line in joints(robot, stood["torque"]):
        print(line)
    for line in notes(robot, config, pd, stood):
        print(line)
    if flags.out is not None:
        problem = render.film(robot, episode, flags.out)
        if problem:
            raise ConfigError(f"--out={flags.out}: {problem.replace('video', 'picture')}")
        show([("picture", f"{flags.out}, after {facts.SECONDS:g} s")])


def show(rows: list[tuple[str, str]]) -> None:
    """Print (name, text) in two columns."""
    for name, text in rows:
        print(f"{name:8s}{text}")


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

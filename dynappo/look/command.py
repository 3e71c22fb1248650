"""Check a robot before training: `dynappo look CONFIG --out=look.png`.

It shows what robot the MJCF and the config make: mass, joints, whether the PD is stable, and how the robot
stands with it. C MuJoCo and NumPy, without JAX; it takes a second or two.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.config import flags as flags_lib
from dynappo.description import joints as joints_lib
from dynappo.description import kinds, motors
from dynappo.description import robot as robot_lib
from dynappo.look import facts, ground, picture
from dynappo.physics import engine_contract
from dynappo.physics.ground import of_tiles, under
from dynappo.physics.warp import scope
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import partners
from dynappo.terrain import map_file

SINKS = 0.25  # of its height: more is no sag
RESTS = 0.02  # m in the last second: more is not at rest
SLIDES, SUNK = 0.2, 0.005  # of its height, and m: feet that slide or sink in while it stands
LOW = 0.01  # m: parts lower than this in the default pose touch the ground in walking
EXPLORES = 0.37  # of a motor's limit; a third is the rule
LOAD = 0.4  # of the robot's mass, that its base's may vary by
TORQUES, AT = (
    2e-4,
    13.0,
)  # the weight of squared torques that Isaac Lab has for a Go1, and its mass (kg)
USAGE = """\
CONFIG is a robot's name, or its config file; you can set any field
  python -m dynappo.look go1
  python -m dynappo.look configs/mine.py --out=look.png
  python -m dynappo.look configs/mine.py --config.task.kp=60 --config.task.kd=2
  python -m dynappo.look go2:rough --ground=tiles.png
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
    flag("--out", metavar="FILE.png", type=flags_lib.path, help="a picture: looks, feet and parts")
    flag("--ground", metavar="FILE.png", type=flags_lib.path, help="a picture of a rough ground")
    flags, rest = flags_lib.read_with_fields(parser, argv)
    if not flags.what:
        raise ConfigError("no config given; try: python -m dynappo.look go1")
    for name, out in (("out", flags.out), ("ground", flags.ground)):
        if out is not None and out.suffix != ".png":
            raise ConfigError(f"--{name}={out}: expected a file named .png")
    flags.config = config_lib.validate(flags_lib.load(flags.what, rest, flag=""))
    if not flags.config.robot:
        raise ConfigError(
            f"{flags.what}: expected a robot; that of a Playground task is shown by dynappo play WORKDIR "
            "--policy=zero --out=FILE.html, with the workdir of a run"
        )
    if flags.ground is not None and flags.config.task.terrain == "flat":
        raise ConfigError(
            f"--ground={flags.ground}: task.terrain is 'flat' in {flags.what}, expected 'rough'; set "
            "--config.task.terrain=rough --config.task.carry_on=False"
        )
    if flags.ground is not None and _is_a_map(flags.ground):
        raise ConfigError(
            f"--ground={flags.ground}: it could be a map of yours, and look would write over it; name "
            f"another file; to see that map: --config.task.tiles.map={flags.ground}"
        )
    return flags


def _is_a_map(path: Path) -> bool:
    """Whether the file could be a ground of one's own: what look writes has colours."""
    try:
        map_file.load(str(path), level=1e-3, cell=1.0)
    except map_file.BadMap:
        return False
    return True


def about(robot: robot_lib.Robot, config, pd: facts.PD) -> list[tuple[str, str]]:
    """What is known before the robot stands, as (name, text) for printing."""
    task, dt = config.task, config.physics.timestep
    kp, kd = (_span(np.atleast_1d(x), None) for x in (task.kp, task.kd))
    verdict = "stable" if pd.damping < 1 else "stable, but the joints chatter"
    verdict = "unstable" if pd.bound >= 2 else verdict
    feet = ", ".join(robot.foot_names)
    return [
        ("robot", f"{robot.name}, {robot.xml}"),
        ("mass", f"{robot.mj_model.body_mass.sum():.2f} kg"),
        ("limbs", f"{len(robot.joint_names)} joints, feet {feet}, {len(robot.parts)} other shapes"),
        ("PD", f"kp {kp} N m/rad, kd {kd} N m s/rad, a step of {dt * 1e3:g} ms"),
        (
            "  is",
            f"{verdict}: damping takes {pd.damping:.2f} of a joint's speed in a step (below 1; "
            f"better below 0.5), most at {pd.joint}; stable below steps of {pd.longest * 1e3:.1f} ms",
        ),
    ]


def standing(robot: robot_lib.Robot, config, stood: dict) -> list[tuple[str, str]]:
    """How the robot stood, as (name, text) for printing."""
    home, rest, share = robot.home_qpos[2], stood["rest"], stood["share"]
    asked = facts.explores(robot, config)
    if stood["fall"] is not None and len(robot.foot_names) < 3:
        when = f"halfway to its fall, {stood['fall'] / 2:.2f} s (on so few feet it must balance)"
    else:
        when = f"in {facts.SECONDS:g} s"
    return [
        (
            "sag",
            f"{(home - rest) * 1e3:.0f} mm {when}: the base at {home:.3f} m, then "
            f"{rest:.3f} m; in the last second it moved by {stood['moved'] * 1e3:.1f} mm",
        ),
        ("torque", f"up to {_of_limit(robot, config, share)}"),
        ("explore", f"kp x action_scale x ppo.init_std is up to {_of_limit(robot, config, asked)}"),
    ]


def _of_limit(robot: robot_lib.Robot, config, share: np.ndarray) -> str:
    """The largest of some shares of the motors' limits, in words."""
    worst = int(share.argmax())
    limit = np.broadcast_to(facts.limit(config.task), len(share))[worst]
    name = robot.joint_names[worst]
    return f"{share[worst] * limit:.1f} N m, at {name}: {share[worst]:.0%} of the limit {limit:g}"


def joints(robot: robot_lib.Robot, config, stood: dict) -> list[str]:
    """A line for each kind of joint: how many, default pose, range, the motor's limit (N m), and shares
    of it that standing and exploring take."""
    names, count = robot.joint_names, len(robot.joint_names)
    asked = facts.explores(robot, config)
    fields = config.task.kp, config.task.kd, facts.limit(config.task)
    numbers = [np.broadcast_to(field, count) for field in fields]
    head = "default (rad)", "range (rad)", "kp", "kd", "limit", "stand", "explore"
    rows: list[tuple[str, ...]] = [("joints", "", *head)]
    for kind, some in kinds.kinds(names).items():
        limited = [robot.mj_model.joint(names[i]).range for i in some if _limited(robot, names[i])]
        low, high = np.array(limited).T if limited else ([], [])
        rows.append(
            (
                kind,
                f"x {len(some)}" if len(some) > 1 else "",
                _span(robot.default_pose[some], 2),
                f"{min(low):.2f} to {max(high):.2f}" if limited else "none",
                *(_span(each[some], None) for each in numbers),
                f"{stood['share'][some].max():.0%}",
                f"{asked[some].max():.0%}",
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def _limited(robot: robot_lib.Robot, joint: str) -> bool:
    return bool(robot.mj_model.joint(joint).limited[0])


def _span(values: np.ndarray, digits: int | None) -> str:
    """`3` or `3 to 5`, with so many digits after the point, or as many as it takes."""
    kind = "g" if digits is None else f".{digits}f"
    low, high = (f"{value + 0.0:{kind}}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def notes(robot: robot_lib.Robot, config, pd: facts.PD, stood: dict) -> list[str]:
    """A line on each thing to change before training."""
    out = [*_wrong_pd(pd), *_wrong_standing(robot, stood), *_wrong_config(robot, config)]
    out += _wrong_engine(robot, config)
    if slow := scope.slower(robot, config.physics, under(config.task)):
        out.append(slow)
    if coarse := engine_contract.coarse(robot):
        out.append(coarse)
    return [f"note: {line}" for line in out]


def _wrong_pd(pd: facts.PD) -> list[str]:
    fix = "lower task.kd or task.kp, raise armature, damp in the file, or shorten the step"
    return [fix] if pd.damping >= 1 or pd.bound >= 2 else []


def _wrong_engine(robot: robot_lib.Robot, config) -> list[str]:
    """The engines that cannot simulate the file, where the machine chooses one (`physics.impl=auto`)."""
    lines, physics = [], config.physics
    for impl, name in engine_contract.ENGINES.items() if physics.impl == "auto" else ():
        with contextlib.suppress(ImportError):  # MuJoCo Warp is not installed
            if reason := engine_contract.lacks(robot, physics, impl, under(config.task)):
                lines.append(f"{name} (physics.impl={impl}) cannot simulate the file: {reason}")
    return lines


def _wrong_standing(robot: robot_lib.Robot, stood: dict) -> list[str]:
    home, fall, out = robot.home_qpos[2], stood["fall"], []
    steady = len(robot.foot_names) > 2
    if fall is not None and steady:
        out.append(
            f"{stood['fell_on']}, a part that is no foot, touches the ground after {fall:.2f} s"
        )
    if home - stood["rest"] > SINKS * home:
        out.append("it kneels or lies: raise task.kp, or look at the feet and the centres of mass")
    if stood["moved"] > RESTS and steady:
        out.append("it does not come to rest")
    if stood["share"].max() >= 1:
        out.append("a motor is at task.effort_limit or saturation_effort: it cannot hold the robot")
    if fall is None and stood["slid"] > SLIDES * home:
        out.append(
            f"its feet slide by {stood['slid'] * 1e3:.0f} mm while it stands: give them solimp "
            "0.9 0.95, or the file impratio 3"
        )
    if stood["sunk"] > SUNK:
        out.append(
            f"its feet sink into the floor by {stood['sunk'] * 1e3:.0f} mm: give them solimp 0.9 0.95"
        )
    if low := facts.low_parts(robot, LOW):
        out.append(f"no feet, but close to the floor in the default pose: {', '.join(low[:6])}")
    return out


def _wrong_config(robot: robot_lib.Robot, config) -> list[str]:
    task, out = config.task, []
    mass = robot.mj_model.body_mass.sum()
    count = len(robot.joint_names)
    effort, stall = (np.broadcast_to(x, count) for x in (task.effort_limit, task.saturation_effort))
    if (effort > stall).any():
        i = int((effort - stall).argmax())
        out.append(
            f"task.effort_limit is {effort[i]:g} N m at {robot.joint_names[i]}, which its motor cannot "
            f"reach: task.saturation_effort, of a motor that stands, is {stall[i]:g}"
        )
    out += _wrong_ranges(robot, np.broadcast_to(task.action_scale, count))
    asked = facts.explores(robot, config)
    if asked.max() > EXPLORES:
        name = robot.joint_names[int(asked.argmax())]
        out.append(
            f"exploration asks {name} for {asked.max():.0%} of its motor: lower task.action_scale or "
            f"ppo.init_std "
            "until it is a third"
        )
    if note := robot_lib.spawn_note(robot, task.reset.spawn_height):
        out.append(note)
    low, high = task.randomize.base_mass
    if max(-low, high) > LOAD * mass:
        out.append(
            f"task.randomize.base_mass is {low:g} to {high:g} kg, of a robot of {mass:.1f} kg: a "
            "tenth is usual"
        )
    weight, usual = -task.weights.joint_torques, TORQUES * (AT / mass) ** 1.5
    if mass > AT and weight > 4 * usual:
        out.append(
            f"task.weights.joint_torques is {-weight:g}; for {mass:.0f} kg {-usual:.2g} is usual, or it "
            f"will not move"
        )
    friction = robot.mj_model.geom_friction[robot.feet, 0]
    low, high = task.randomize.friction
    if friction.min() < low or friction.max() > high:
        out.append(
            f"the feet's friction is {_span(friction, 2)} in the file, but {low:g} to {high:g} in training "
            "(task.randomize.friction)"
        )
    return out


def _wrong_ranges(robot: robot_lib.Robot, scale: np.ndarray) -> list[str]:
    """Joints that an action of 1 (`scale` [A], rad) takes through their whole range."""
    width = np.ptp(robot_lib.joint_ranges(robot), axis=1)
    narrow = width < scale
    if (width < joints_lib.TURN_AS_DEGREES).all():
        return [
            f"no joint turns by more than {width.max():.2g} rad: in the file that they are from, angles seem "
            'to be radians that are read as degrees, for want of <compiler angle="radian"/>'
        ]
    if not narrow.any():
        return []
    names = [robot.joint_names[i] for i in np.flatnonzero(narrow)]
    more = f" and {len(names) - 6} more" * (len(names) > 6)
    return [
        f"the whole range of {', '.join(names[:6])}{more} is {_span(width[narrow], 2)} rad, less than "
        "task.action_scale: correct the range, or lower the scale"
    ]


def run(flags) -> None:
    """Check the robot as the flags say, and print the findings."""
    for name in ("out", "ground"):
        if (out := getattr(flags, name)) is not None:
            flags_lib.check_writable(out, name)
    config = flags.config
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    robot_lib.check_base_mass(robot, config.task.randomize.base_mass)
    if config.ppo.symmetry:
        partners.check_motors(config.task, robot)
    if config.physics.impl != "auto":
        with contextlib.suppress(ImportError):  # MuJoCo Warp is not installed; train says so
            impl = config.physics.impl
            engine_contract.check(robot, config.physics, impl, under(config.task))
    described = policy_file.describe(config, robot)
    pd = facts.pd(robot, config.task.kp, config.task.kd, config.physics.timestep)
    body = episode_lib.load(robot.xml, described, described.timestep, text=robot.played)
    show(about(robot, config, pd))  # before it stands: physics may blow up
    for line in robot.notes:
        show([("  file", line)])
    _, stood = facts.stand(body)
    show(standing(robot, config, stood))
    for line in (*joints(robot, config, stood), *notes(robot, config, pd, stood)):
        print(line)
    if flags.out is not None:
        problem = picture.draw(robot, flags.out)
        if problem:
            raise ConfigError(f"--out={flags.out}: {problem.replace('video', 'picture')}")
        show(
            [
                (
                    "picture",
                    f"{flags.out}: its looks, feet (orange) and parts (blue), and from the front",
                )
            ]
        )
    if flags.ground is not None:
        tiles = config.task.tiles
        made = of_tiles(tiles)
        problem = ground.write(tiles, made, flags.ground)
        if problem:
            raise ConfigError(f"--ground={flags.ground}: {problem}")
        show([("ground", f"{flags.ground}: {ground.words(tiles, made)}, from above")])


def show(rows: list[tuple[str, str]]) -> None:
    """Print (name, text) in two columns."""
    for name, text in rows:
        print(f"{name:8s}{text}")


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))

"""The texts of an adopted robot: its MJCF, its config, its README."""

from __future__ import annotations

import json
import re
import textwrap
from xml.etree import ElementTree

import mujoco

from dynappo.adopt import bipeds, joint_roles
from dynappo.adopt.gains import Motors
from dynappo.adopt.source import Source, origin
from dynappo.description import kinds
from dynappo.description import robot as robot_lib
from dynappo.description import text as text_lib

LIGHT_MASS = 25.0  # kg, up to which the reward weights of the Unitree tasks hold; above, those of the ANYmals
GO1_TORQUE_WEIGHT, GO1_MASS = 2e-4, 13.0  # of squared torques; kg
START_HEIGHT = 0.05  # m over the default pose, where episodes start
MASS_VARIES = 0.1  # of the robot's mass, by which the base's varies
BASE_VARIES_MOST = 0.3  # of the base's own mass
ADOPTED = "adopted from"  # in what adopt writes, and in no other robot's files
HEAD = '''"""{name} on flat ground, adopted from {file}.

    python -m dynappo.look configs/{name}.py
    python -m dynappo.train --config=configs/{name}.py

robots/{name}/README.md says what was assumed. What is not set here is of `{base}.py`, as are the variants.
"""

import runpy

from dynappo.config import files

{base} = runpy.run_path(str(files.find("configs", "{base}.py")))


def get_config(variant=""):
    """The defaults with this robot's differences."""
    config = {base}["defaults"]()
    config.robot = {name!r}
    task = config.task
'''
HEAVIER = """\
    # a heavy robot: as the ANYmals here
    config.ppo.init_std = 0.5
    task.weights.update(track_linear_velocity=1.0, track_yaw_rate=0.5, flat_orientation=-5.0)
    task.weights.feet_air_time = 0.5
    task.reset.update(velocity=0.5, joint_scale=(0.5, 1.5), soft_limit=0.95)
    task.randomize.base_com = (0.05, 0.05, 0.01)
    task.push.velocity = 0.5
"""
END = """\
    return {base}["apply_variant"](config, variant)
"""
HEAVIER_END = """\
    config = default["apply_variant"](config, variant)
    if variant in ("", "best"):  # heavy robots fall in the first two seconds: begin more episodes
        task.episode_length, config.schedule.last_iteration = 75, 110
    return config
"""


def light(robot: robot_lib.Robot) -> bool:
    return float(robot.mj_model.body_mass.sum()) < LIGHT_MASS


def init_std(robot: robot_lib.Robot) -> float:
    """ppo.init_std: that of `default.py` and `biped.py`, or of `HEAVIER`."""
    return 1.0 if light(robot) or bipeds.is_biped(robot) else 0.5


def load(robot: robot_lib.Robot) -> float:
    """By how many kg the base's mass varies in training."""
    model = robot.mj_model
    return float(
        min(
            MASS_VARIES * model.body_mass.sum(), BASE_VARIES_MOST * model.body_mass[robot.base_body]
        )
    )


def torque_weight(mass: float) -> float:
    """Weight of the sum of squared torques: -2e-4 at 13 kg, -2.5e-5 at 52 kg, as Isaac Lab has them."""
    return -float(f"{GO1_TORQUE_WEIGHT * (GO1_MASS / mass) ** 1.5:.2g}")


def config(robot: robot_lib.Robot, source: Source, motors: Motors) -> str:
    """The text of configs/NAME.py."""
    mass = float(robot.mj_model.body_mass.sum())
    names, on_two = robot.joint_names, bipeds.is_biped(robot)
    base = "biped" if on_two else "default"
    file = re.sub(r'["\\]', "_", source.xml.name)  # it stands in a docstring
    lines = [HEAD.format(name=robot.name, file=file, base=base)]
    lines.append("    # N m/rad, N m s/rad; rad for an action of 1\n")
    for field in ("kp", "kd", "action_scale"):
        lines.append(_field(field, kinds.patterns(names, getattr(motors, field))))
    lines.append("    # N m, N m at standstill, rad/s\n")
    lines.append(_field("effort_limit", kinds.patterns(names, motors.effort_limit)))
    lines.append("    task.saturation_effort = task.effort_limit\n")
    lines.append(_field("velocity_limit", kinds.patterns(names, motors.velocity_limit)))
    spawn, more = robot.home_qpos[2] + START_HEIGHT, load(robot)
    lines.append(
        f"    task.reset.spawn_height = {spawn:.2f}  # m, of the base: default pose and 5 cm\n"
    )
    lines.append(
        f"    task.randomize.base_mass = ({-more:.1f}, {more:.1f})  # kg, of a robot of {mass:.1f}\n"
    )
    if on_two:
        return "".join([*lines, _of_two_feet(robot), END.format(base=base)])
    if not light(robot):
        lines.append(HEAVIER)
    lines.append(f"    task.weights.joint_torques = {torque_weight(mass):g}  # by mass^-1.5\n")
    lines.append(END.format(base=base) if light(robot) else HEAVIER_END)
    return "".join(lines)


def _of_two_feet(robot: robot_lib.Robot) -> str:
    """The lines of a biped's config beside those of every robot."""
    task, _ = bipeds.choose(robot)
    posture = kinds.patterns(robot.joint_names, task.posture_std)
    return (
        f"    # Hz and m of steps; m that feet must lift, and be apart; rad, from the default pose\n"
        f"    task.gait_frequency = {task.gait_frequency}\n"
        f"    task.gait_foot_height = {task.gait_foot_height:g}\n"
        f"    task.clearance_height = {task.clearance_height:g}\n"
        f"    task.feet_apart = {task.feet_apart:g}\n"
        f"{_field('posture_std', posture)}"
        f"    task.weights.joint_torques = {task.joint_torques:g}  # by mass^-1.5\n"
    )


def assumed(robot: robot_lib.Robot) -> list[str]:
    """Lines on the numbers that the config derives from the robot's mass and feet."""
    mass = float(robot.mj_model.body_mass.sum())
    starts = (
        f"base mass +-{load(robot):.1f} kg; starts {START_HEIGHT * 100:g} cm above the default pose"
    )
    if bipeds.is_biped(robot):
        return [*bipeds.choose(robot)[1], f"task: {starts}"]
    like = "the Unitree tasks'" if light(robot) else "the ANYmal tasks'"
    notes = [
        f"task: {like} reward weights for {mass:.1f} kg (up to {LIGHT_MASS:g} kg those of light robots), "
        f"torques weighted by {torque_weight(mass):g}; {starts}"
    ]
    if arm := joint_roles.footless(robot):
        notes.append(
            f"note: {len(arm)} joints lead to no foot ({', '.join(arm)}); they are actions too, and nothing "
            "rewards what an arm does: to hold them still, take these joints out of the file, adopt it anew"
        )
    if len(robot.foot_names) != 4:
        notes.append(
            f"task: the rewards are those of four legs; no robot of {len(robot.foot_names)} feet was "
            f"trained with them"
        )
    return notes


def _field(name: str, value: float | dict[str, float]) -> str:
    """A line, or a table with a line for each pattern."""
    if not isinstance(value, dict):
        return f"    task.{name} = {value!r}\n"
    items = [f"{json.dumps(key, ensure_ascii=False)}: {number!r}" for key, number in value.items()]
    short = f"    task.{name} = {{{', '.join(items)}}}\n"
    if len(short) <= 100:
        return short
    rows = "".join(f"        {item},\n" for item in items)
    return f"    task.{name} = {{\n{rows}    }}\n"


def mjcf(spec: mujoco.MjSpec, robot_name: str, source: Source) -> str:
    """The text of a compiled spec, with a comment on its origin."""
    root = ElementTree.fromstring(text_lib.self_contained(spec))
    file = re.sub("-(?=-)", "- ", source.xml.name)  # an XML comment has no "--"
    about = (
        f"\n    {robot_name}, adopted from {file} by `dynappo adopt`: README.md has source, "
        f"licence and"
        "\n    every assumption. Geom groups: 2 = looks only, 3 = contact with the floor.\n  "
    )
    root.insert(0, ElementTree.Comment(about))
    ElementTree.indent(root)
    return ElementTree.tostring(root, "unicode") + "\n"


def readme(
    robot: robot_lib.Robot,
    source: Source,
    notes: list[str],
    licence: tuple[str, str],
    looks: int,
) -> str:
    """The text of robots/NAME/README.md."""
    model = robot.mj_model
    where, text = licence
    rows = [
        ("total mass", f"{model.body_mass.sum():.2f} kg"),
        ("joints, in file order", ", ".join(robot.joint_names)),
        ("feet", ", ".join(robot.foot_names)),
        ("parts that must not touch the ground", f"{len(robot.parts)} shapes"),
        ("base height in the default pose", f"{robot.home_qpos[2]:.4f} m"),
    ]
    table = "".join(f"| {name} | {value} |\n" for name, value in rows)
    lines = textwrap.TextWrapper(  # no break inside paths
        100,
        initial_indent="- ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    assumed = "".join(lines.fill(line) + "\n" for line in notes)
    legal = (
        f"From {where}; check that it is of this robot:\n\n"
        + textwrap.indent(text, "    ").rstrip()
        if text
        else "No licence was found beside the file or in it. Ask its owner before you share this robot."
    )
    return (
        f"# {robot.name}\n\n"
        f"`{robot.name}.xml` is made by `dynappo adopt` from `{source.xml.name}`"
        f"{', its looks included' if looks else ''}\n({origin(source.xml)}).\n"
        f"Gains, limits and what else depends on the robot are in "
        f"`configs/{robot.name}.py`.\n\n"
        f"| what | value |\n|---|---|\n{table}\n"
        f"## What was assumed\n\n{assumed}\n"
        f"## Licence of the source\n\n{legal}\n"
    )

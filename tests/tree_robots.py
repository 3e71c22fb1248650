"""Robots that are trees, for the kernel of tree.py: ours, other people's, and one that is damped."""

from pathlib import Path

import mujoco
import numpy as np
import other_robots
import robot_files
from kernel_case import MOTOR, Case, load

from dynappo import config as config_lib
from dynappo.description import motors as motors_lib
from dynappo.description import robot as robot_lib
from dynappo.physics.warp import tree


def file(text, folder):
    """A robot of somebody else's file."""
    path = Path(folder) / "mine.xml"
    path.write_text(text)
    return robot_lib.load_xml(path)


def damped():
    """Feet of boxes, arms, damping in the joints; three joints of a leg are in one body."""
    robot = other_robots.biped(other_robots.BOX, arms=True)
    spec = mujoco.MjSpec.from_string(robot.alone)
    for i, joint in enumerate(spec.joints[1:]):
        joint.damping = [0.2 + 0.1 * i, 0, 0]
    return robot_lib.load_text(spec.to_xml(), "biped", robot.xml)


def of_config():
    """[29, 8] arrays.MOTOR: a motor of its own at each of G1's joints, as in its config."""
    task = motors_lib.fitted(config_lib.load("configs/g1.py"), load("g1"))[0].task
    limits = task.effort_limit, task.saturation_effort, task.velocity_limit
    return np.column_stack([task.kp, task.kd, *limits, [MOTOR[5:]] * 29])


ROBOT = {
    "g1": lambda _: load("g1"),
    "damped": lambda _: damped(),
    # joints beside their body's origin, one without a range, a waist, armature of the base
    "biped": lambda folder: file(robot_files.biped(), folder),
    "turned": lambda folder: file(
        robot_files.turned(), folder
    ),  # frames too; and joints with a `ref`
    "hexapod": lambda _: other_robots.hexapod(),
}


def made(name, folder, **given):
    motors = of_config() if name == "g1" else MOTOR
    robot = ROBOT[name](folder)
    return Case("g1", robot=robot, way=tree, calm=0.02, motors=motors, **given)

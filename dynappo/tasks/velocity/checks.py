"""Whether a robot can learn the velocity task as a config has it. Needs no JAX."""

from __future__ import annotations

from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import gait, own, partners, reward_sum


def check(config, robot: robot_lib.Robot) -> None:
    """ConfigError where the robot's masses, feet or motors do not fit the config's group `task`, or terms
    of the reward their weights."""
    task = config.task
    robot_lib.check_base_mass(robot, task.randomize.base_mass)
    gait.check(task.gait_frequency, robot.name, len(robot.foot_names))
    own.check(task, config.ppo.symmetry)
    reward_sum.terms_of(task)
    if config.ppo.symmetry:
        partners.check_motors(task, robot)

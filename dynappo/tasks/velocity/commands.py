"""Velocity commands: forward, sideways and yaw velocity in the base frame.

The paper draws a command uniformly and keeps it for the episode. Isaac Lab's tasks
(isaaclab/envs/mdp/commands/velocity_command.py, 2.2.1), chosen by
`task.formulation = isaaclab_exact`, do three more things, each with its own field:

- `task.heading`: a world heading is drawn, and the yaw rate is `task.heading_gain` times the angle that is
  left to turn, inside the range `command_yaw`; it changes at every step and fades as the robot turns;
- `task.resample_steps`: the command is drawn again after this number of control steps (0: never);
- `task.standing`: the probability, at each draw, of the command to stand still.

`task.slow_commands` is the probability, at each draw, of a slow command: all of it times a share that is
uniform from 0 to `SLOWEST`. A robot for hardware that hears few of them stands where it is asked to walk
slowly, for a step costs reward, and a slow command that is not followed costs little of it
(experiments/22_deploy/gait.md).

A command of one's own (config/terms.py) is drawn in the place of the uniform one; all else holds for it, too.

A tail keeps the command of its first row; on a ground that is not flat it knows the robot's heading, and so
the yaw rate (surroundings.py).
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo.tasks.velocity import observe
from dynappo.tasks.velocity.state import Goal
from dynappo.types import Hyper

Sampler = (
    tuple[int, Callable] | None
)  # how many numbers one of one's own draws, and of these a command
SLOWEST = 0.5  # the largest share of a command that is slow


def draw(
    task, hyper: Hyper, qpos, key: PRNGKeyArray, own: Sampler = None
) -> tuple[Float[Array, " 3"], Goal]:
    """A fresh `(command, goal)` for a robot at `qpos`; m/s, m/s, rad/s."""
    ranges = hyper.task.command_x, hyper.task.command_y, hyper.task.command_yaw
    if own is not None:
        key, own_key = jax.random.split(key)
    if hyper.task.slow_commands is not None:
        key, slow_key = jax.random.split(key)
    *velocity, heading, standing = jax.random.uniform(key, (5,))
    command = [low + (high - low) * u for u, (low, high) in zip(velocity, ranges, strict=True)]
    if own is not None:
        count, sample = own
        command = [*sample(jax.random.uniform(own_key, (count,)))]
    command = jnp.stack(command)
    if hyper.task.slow_commands is not None:
        coin, share = jax.random.uniform(slow_key, (2,))
        command *= jnp.where(coin < hyper.task.slow_commands, SLOWEST * share, 1.0)
    goal = Goal(
        heading=(2 * heading - 1) * jnp.pi,
        standing=(standing < hyper.task.standing).astype(jnp.float32),
        steps_left=jnp.int32(task.resample_steps),
    )
    return follow(task, hyper, command, goal, qpos), goal


def follow(task, hyper: Hyper, command, goal: Goal, qpos):
    """The command now: the yaw rate turns towards the heading; zero if the robot should stand."""
    if task.heading:
        return turned(hyper, command, goal, observe.heading(qpos[3:7]))
    return command * (1 - goal.standing)


def turned(hyper: Hyper, command, goal: Goal, heading):
    """The command of a robot that is to turn to its goal's heading from `heading` (rad, world)."""
    left = goal.heading - heading
    left = (left + jnp.pi) % (2 * jnp.pi) - jnp.pi  # the shorter way round
    low, high = hyper.task.command_yaw
    command = command.at[2].set(jnp.clip(hyper.task.heading_gain * left, low, high))
    return command * (1 - goal.standing)


def advance(task, hyper: Hyper, command, goal: Goal, qpos, key: PRNGKeyArray, own: Sampler = None):
    """`(command, goal)` of the next control step, for a robot now at `qpos`."""
    command = follow(task, hyper, command, goal, qpos)
    if not task.resample_steps:
        return command, goal
    goal = goal.replace(steps_left=goal.steps_left - 1)
    fresh = draw(task, hyper, qpos, key, own)
    due = goal.steps_left <= 0
    return jax.tree.map(lambda new, old: jnp.where(due, new, old), fresh, (command, goal))

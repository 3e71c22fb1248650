"""Checks whether a run fits into a device's memory.

XLA says what a program needs only after half a minute of compiling. So `check` refuses at once a rollout
buffer and robots that do not fit even alone; `check_compiled` uses the compiler's count. MuJoCo Warp
(physics/warp/general.py) keeps its own arrays outside JAX's memory; neither counts them.
"""

from __future__ import annotations

import os
from typing import Any

from dynappo import schedule
from dynappo.config import ConfigError
from dynappo.description.robot import Robot
from dynappo.tasks.velocity import observe
from dynappo.terrain import scan

CURE = "lower one of them, or use more devices (run.mesh_seed, run.mesh_env)"


def bytes_per_row(config, joints: int, feet: int) -> int:
    """Bytes of a types.Transition, at least: without what obs tells of a robot's body."""
    task, clock = config.task, config.task.gait_frequency is not None
    own = observe.own(task.terms_about)
    name = observe.name(task.observation, joints, clock, own)
    past = (task.history - 1) * len(observe.columns(name, own))
    if task.terrain != "flat":
        past += sum(scan.sizes(feet, task.scan == "grid", bool(task.heading)).values())
    numbers = observe.size(joints, clock, own) + past, joints, observe.prop_size(joints, own)
    return 4 * (2 * sum(numbers) + 8)


def bytes_per_robot(joints: int, feet: int) -> int:
    """Bytes of a state of the velocity task (state.py) and of the robot's own body, at least."""
    physics = (7 + joints) + 2 * (6 + joints)
    seen = observe.size(joints) + observe.prop_size(joints)
    command, actions, timers, clocks, body = 6, 2 * joints, 5 * feet, 4, 7
    return 4 * (physics + seen + command + actions + timers + clocks + body)


def least(config, robot: Robot) -> int:
    """The least bytes that a run needs on each device: the buffer, a memory, and the robots of every seed."""
    run, joints = config.run, len(robot.joint_names)
    robots = config.rollout.num_envs * run.num_seeds // (run.mesh_seed * run.mesh_env)
    row = bytes_per_row(config, joints, len(robot.foot_names))
    kept = config.model.memory * row // 2  # a row's states before it, not those after it
    rows = config.rollout.horizon * row
    if schedule.uses_model(config):
        rows = rows * config.rollout.imagined + kept
    return robots * (rows + bytes_per_robot(joints, len(robot.foot_names)))


def check(config, robot: Robot, limit: int | None) -> None:
    """ConfigError if a run cannot fit into a device's `limit` bytes, whatever the compiler does."""
    _check(config, "the rollout alone needs", least(config, robot), limit)


def check_compiled(config, size: int, limit: int | None) -> None:
    """ConfigError if the compiler's count, `size` bytes, is more than a device has."""
    _check(config, "the compiled program needs", size, limit)


def _check(config, what: str, size: int, limit: int | None) -> None:
    if limit is not None and size > limit:
        raise ConfigError(
            f"rollout.num_envs x run.num_seeds is {config.rollout.num_envs} x {config.run.num_seeds}: "
            f"{what} {text(size)} on each device, which has {text(limit)}; {CURE}"
        )


def needed(compiled: Any) -> int:
    """Bytes that a compiled program uses on each device: arguments, results, temporary arrays."""
    sizes = compiled.memory_analysis()
    kept = sizes.argument_size_in_bytes + sizes.output_size_in_bytes - sizes.alias_size_in_bytes
    return kept + sizes.temp_size_in_bytes


def limit(device: Any) -> int | None:
    """Bytes of a device that JAX may use; None if unknown.

    On a GPU JAX's own limit; on a CPU the machine's memory, divided equally among JAX's CPU
    devices.
    """
    import jax

    stats = device.memory_stats() or {}
    if "bytes_limit" in stats:
        return stats["bytes_limit"]
    if device.platform != "cpu" or "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", ()):
        return None
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return whole // jax.local_device_count("cpu")


def text(size: int) -> str:
    """A number of bytes, in words."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"

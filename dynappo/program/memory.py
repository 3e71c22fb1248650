"""Does a run fit into a device's memory? Before compilation a bound, after it the compiler's own count.

What XLA needs beside the arrays that a program must hold is known only when it has compiled
(`compiled.memory_analysis()`), which takes half a minute. `check` therefore refuses at once only what is
hopeless: the rollout buffer and the robots alone, which no compiler can make smaller. MuJoCo Warp keeps
arrays of its own outside of JAX's memory; they are not counted.
"""

from __future__ import annotations

import os
from typing import Any

from dynappo.config import ConfigError
from dynappo.task import observe

OBS, ACTION = observe.PROP_SIZE + observe.CONTEXT_SIZE, 12
ROW = 4 * (2 * OBS + 2 * ACTION + 2 * observe.PROP_SIZE + 8)  # bytes of a types.Transition
STATE = 4 * 177  # bytes of an EnvState, and of the robot's own body
CURE = "lower one of them, or use more devices (run.mesh_seed, run.mesh_env)"


def least(config) -> int:
    """Bytes on each device that a run cannot do without: the buffer, and the robots of every seed."""
    run = config.run
    robots = config.rollout.num_envs * run.num_seeds // (run.mesh_seed * run.mesh_env)
    return robots * (config.rollout.horizon * ROW + STATE)


def check(config, limit: int | None) -> None:
    """ConfigError if a run cannot fit into the `limit` bytes of a device, whatever the compiler does."""
    if limit is not None and least(config) > limit:
        raise ConfigError(
            f"rollout.num_envs x run.num_seeds is {config.rollout.num_envs} x {config.run.num_seeds}: "
            f"the rollout alone needs {text(least(config))} on each device, which has {text(limit)}; {CURE}"
        )


def needed(compiled: Any) -> int:
    """Bytes on each device that a compiled program uses at most: arguments, results, scratch."""
    sizes = compiled.memory_analysis()
    kept = sizes.argument_size_in_bytes + sizes.output_size_in_bytes - sizes.alias_size_in_bytes
    return kept + sizes.temp_size_in_bytes


def check_compiled(config, size: int, limit: int | None) -> None:
    """ConfigError if the `size` bytes that the compiler counted are more than a device has."""
    if limit is not None and size > limit:
        raise ConfigError(
            f"rollout.num_envs x run.num_seeds is {config.rollout.num_envs} x {config.run.num_seeds}: "
            f"the compiled program needs {text(size)} on each device, which has {text(limit)}; {CURE}"
        )


def limit(device: Any) -> int | None:
    """Bytes that JAX may use of a device; None where it does not say.

    On a GPU its own limit; on a CPU the machine's memory, in equal shares of the devices.
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
    """A number of bytes for a person."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"

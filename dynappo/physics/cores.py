"""How many cores this process may use: fewer than the machine has under taskset, Slurm or Docker."""

import contextlib
import math
import os

QUOTA = (
    "/sys/fs/cgroup/cpu.max"  # of cgroup v2: microseconds of CPU time in a period, and the period
)


def cores(threads: int = 0) -> int:
    """`threads`, as `physics.threads` has it; 0 means every core that this process may use."""
    if threads:
        return threads
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS
    return _quota(len(affinity(0)) if affinity else os.cpu_count() or 1)


def _quota(most: int) -> int:
    """The cores, of `most`, that a quota allows, as `docker run --cpus` sets it; a part of one is one."""
    with contextlib.suppress(
        OSError, ValueError, ZeroDivisionError
    ):  # no Linux, no quota ("max"), cgroup v1
        with open(QUOTA) as file:
            time, period = map(int, file.read().split())
        return min(most, max(1, math.ceil(time / period)))
    return most

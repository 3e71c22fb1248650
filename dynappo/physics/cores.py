"""How many cores this process may use: fewer than the machine has under taskset, Slurm or Docker."""

import os


def cores(threads: int = 0) -> int:
    """`threads`, as `physics.threads` has it; 0 means every core that this process may use."""
    if threads:
        return threads
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS
    return len(affinity(0)) if affinity else os.cpu_count() or 1

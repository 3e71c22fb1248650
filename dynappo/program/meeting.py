"""Where the processes of one run meet, from the flags of `train` or Slurm's variables."""

from __future__ import annotations

import re
import socket
from typing import Any

from dynappo.config import ConfigError


def find(
    coordinator: str | None, count: int | None, index: int | None, environment
) -> tuple[dict[str, Any], int, int] | None:
    """`(arguments of jax.distributed.initialize, processes, index of this one)`; None for one
    process.

    ConfigError if flags or variables are incomplete, or the address cannot be reached.
    """
    flags = {"--coordinator": coordinator, "--processes": count, "--process": index}
    if set(flags.values()) == {None}:
        if not in_slurm(environment):
            return None
        return dict(local_device_ids=slurm_devices(environment)), *_of_slurm(environment)
    if count == 1:
        return None
    missing = [name for name, value in flags.items() if value is None]
    if missing:
        given = ", ".join(name for name in flags if name not in missing)
        raise ConfigError(f"{missing[0]} is missing; {given} needs it, see --help")
    assert coordinator is not None and count is not None and index is not None
    if not 0 <= index < count:
        raise ConfigError(f"--process is {index}, expected 0 to {count - 1} (--processes={count})")
    _check_address(coordinator)
    where = dict(coordinator_address=coordinator, num_processes=count, process_id=index)
    return where, count, index


def _check_address(text: str) -> None:
    """ConfigError if HOST:PORT is not a usable address; JAX would wait until its timeout."""
    host, _, port = text.rpartition(":")
    if not host or not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise ConfigError(
            f"--coordinator is {text!r}, expected HOST:PORT of process 0, a port from 1 to 65535"
        )
    try:
        socket.getaddrinfo(host.strip("[]"), int(port))
    except (OSError, UnicodeError):  # no such host, or not a valid host name
        raise ConfigError(
            f"--coordinator is {text!r}, but no host {host!r} is known here"
        ) from None


def in_slurm(environment) -> bool:
    """Whether this is one of several tasks of a Slurm step (`srun`), not its batch script."""
    if "SLURM_PROCID" not in environment or "SLURM_STEP_NUM_TASKS" not in environment:
        return False
    return _of_slurm(environment)[0] > 1


def _of_slurm(environment) -> tuple[int, int]:
    """`(processes, index of this one)`; ConfigError if the variables are not as Slurm sets them."""
    names = "SLURM_STEP_NUM_TASKS", "SLURM_PROCID"
    for name in names:
        if not re.fullmatch("[0-9]{1,9}", environment[name]):
            raise ConfigError(
                f"{name} is {environment[name]!r}, expected a number as Slurm sets it; "
                "with --processes=1 this is a run of its own"
            )
    count, index = (int(environment[name]) for name in names)
    return count, index


def slurm_devices(environment) -> list[int] | None:
    """The GPUs of this task; None: JAX takes the one with the task's number on its machine."""
    tasks = environment.get("SLURM_STEP_TASKS_PER_NODE", "").split("(")[0].split(",")[0]
    visible = environment.get("CUDA_VISIBLE_DEVICES", "").split(",")
    if tasks == "1" or visible != [""] and len(visible) == 1:  # all GPUs, or the task's only one
        return list(range(len(visible)))
    return None

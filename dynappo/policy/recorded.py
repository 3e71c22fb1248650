"""What only a process with JAX can tell of a policy of another package's environment, as files.

`evaluate/record.py` and `evaluate/task_facts.py` are such processes; who starts them needs no JAX.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from dynappo.config import interpreter


def episode(policy: Path, out: Path, seed: int, acts: str, seconds: float) -> int:
    """Write OUT.npz and OUT.mjb of an episode; the exit status of the process, which has said why."""
    return _run("record", policy, out, seed, acts, f"{seconds:g}")


def facts(policy: Path, out: Path) -> int:
    """Write OUT.json of the policy's task; the exit status, likewise."""
    return _run("task_facts", policy, out)


def _run(module: str, *arguments) -> int:
    command = [*interpreter.command(f"dynappo.evaluate.{module}"), *map(str, arguments)]
    return subprocess.run(command, check=False).returncode

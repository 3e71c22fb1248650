"""What only a process with JAX can tell of a policy of another package's environment, as a file.

`evaluate/task_facts.py` is such a process; who starts it needs no JAX.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from dynappo.config import interpreter


def facts(policy: Path, out: Path) -> int:
    """Write OUT.json of the policy's task; the exit status of the process, which has said why."""
    command = [*interpreter.command("dynappo.evaluate.task_facts"), str(policy), str(out)]
    return subprocess.run(command, check=False).returncode

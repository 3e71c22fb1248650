"""Writes what a controller needs to know of another package's environment beside its policy, for `export`.

    python -m dynappo.evaluate.task_facts POLICY OUT.json

A process of its own, because the environment needs JAX and `export` does not.
"""

from __future__ import annotations

import sys
from pathlib import Path

from dynappo.config import ConfigError, files, flags
from dynappo.policy import policy_file
from dynappo.program import devices
from dynappo.tasks import by_name


def main(argv: list[str]) -> None:
    """The process; exit statuses are those of `flags.answer`."""

    def action():
        policy = policy_file.load_other(Path(argv[0]))
        if policy is None:
            raise ConfigError(f"{argv[0]}: no policy of another package's environment")
        devices.own_process("cpu")
        files.write_json(Path(argv[1]), by_name.facts(policy.config.env))

    flags.answer(action)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Starts a module of this package in a Python of its own, and ends it. It imports nothing from the working
directory.

`python -m` looks for modules in the working directory first, and would run a `tempfile.py` that lies
there. `python -P` does not look there, but would miss this package if only the working directory has it.
So the new Python runs this file, which loads the package from its own folder.

As a script this file may use only Python's own modules, because it has not imported the package yet.
"""

from __future__ import annotations

import contextlib
import importlib.util
import runpy
import subprocess
import sys
from pathlib import Path


def command(module: str) -> list[str]:
    """What starts `module` (its full name) of this package; arguments may follow."""
    return [sys.executable, "-P", str(Path(__file__).resolve()), module]


def end(process: subprocess.Popen, patience: float) -> None:
    """End a process that does so when its stdin closes; kill it if it is there after `patience` seconds."""
    assert process.stdin
    with contextlib.suppress(OSError):  # it may have ended
        process.stdin.close()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _run(module: str) -> None:
    """Load the package that this file is in, then `module` of it, as `python -m` does."""
    init = Path(__file__).resolve().parents[1] / "__init__.py"
    spec = importlib.util.spec_from_file_location(init.parent.name, init)
    assert spec and spec.loader
    package = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    sys.argv[:2] = ["-m"]
    spec.loader.exec_module(package)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _run(sys.argv[1])

"""What a command answers: its exit status, the one line of a refusal, and what a fresh Python says."""

import os
import pathlib
import subprocess
import sys
import time

import pytest

from dynappo.config import ConfigError

ROOT = pathlib.Path(__file__).parents[1]
# s to wait for what must come: only what hangs takes as long, however busy the machine
PATIENCE = 300.0


def until(true):
    """Wait until `true()` is, and return what it says."""
    end = time.monotonic() + PATIENCE
    while not (got := true()):
        assert time.monotonic() < end, f"not true after {PATIENCE:g} s"
        time.sleep(0.05)
    return got


def refused(function, *arguments, **options) -> str:
    """The one line of the ConfigError that a call raises."""
    with pytest.raises(ConfigError) as caught:
        function(*arguments, **options)
    text = str(caught.value)
    assert text and "\n" not in text
    return text


def status(main, *arguments) -> int:
    """The exit status of a command's `main`, called with these arguments."""
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def mistake(main, arguments, capsys) -> str:
    """The one line with which `main` answers a mistake: status 2, and nothing on stdout."""
    assert status(main, *arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("dynappo: ") and said.err.count("\n") == 1
    assert len(said.err) < 400
    return said.err


def shell(*arguments, cwd=ROOT, timeout=PATIENCE, first=ROOT):
    """A fresh Python with these arguments; environment and package as here. In `first` it looks for modules
    before anywhere else."""
    path = os.pathsep.join(filter(None, [str(first), str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=timeout,
    )

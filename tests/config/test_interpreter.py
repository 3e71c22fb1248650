"""No file of the working directory is run: by a process that dynappo starts, nor by its command."""

import os
import shutil
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import numpy as np
import pytest
from answers import PATIENCE, ROOT
from toy_policy import GO1, described

from dynappo.config import interpreter
from dynappo.policy import render
from dynappo.web import child

NAMES = ("tempfile.py", "numpy.py", "json.py", "dynappo/__init__.py", "viser.py")


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """The working directory: modules that everybody imports, and that write `ran` when they are run."""
    here = tmp_path / "hostile"
    for name in NAMES:
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_text(f"open({str(here / 'ran')!r}, 'a').write(__name__)\nraise OSError")
    monkeypatch.chdir(here)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    yield here
    assert not (here / "ran").exists(), (here / "ran").read_text()


def test_a_film_is_made_without_it(hostile, tmp_path):
    config, _ = described()
    few = render.simulate(GO1, config, lambda obs: np.zeros(12), render.tour(0.1), 0.1)
    said = render.film(GO1, few, tmp_path / "still.png", (160, 90))
    assert said in ("", render.NO_OPENGL) or "pillow" in said


def test_the_page_of_a_training_starts_without_it(hostile, capfd):
    """There is no such run, which it says when it has imported all."""
    end, said = time.monotonic() + PATIENCE, ""
    with child.serving(hostile / "nothing", "8520"):
        while not said and time.monotonic() < end:
            time.sleep(0.2)
            said = capfd.readouterr().err
    assert said.startswith("dynappo: ") and "nothing" in said


def test_the_command_starts_without_it(hostile):
    program = Path(sysconfig.get_path("scripts")) / "dynappo"
    if not program.exists():
        pytest.skip("dynappo is not installed as a command")
    done = subprocess.run([program, "export", "--help"], capture_output=True, text=True)
    assert done.returncode == 0 and "usage: dynappo export" in done.stdout, done.stderr


def test_the_package_is_the_one_of_the_file_also_where_no_path_has_it(hostile, tmp_path):
    """As `python -m` in a folder that holds the package starts it, with its arguments."""
    package = tmp_path / "clone" / "dynappo"
    (package / "config").mkdir(parents=True)
    shutil.copy(ROOT / "dynappo" / "__init__.py", package)
    shutil.copy(interpreter.__file__, package / "config")
    (package / "said.py").write_text(
        "import sys, dynappo\nprint(__name__, dynappo.__file__, *sys.argv[1:])"
    )
    command = [*interpreter.command("dynappo.said"), "a", "b c"]
    assert command[:2] == [sys.executable, "-P"]
    command[2] = str(package / "config" / "interpreter.py")
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, capture_output=True, text=True, env=bare)
    assert done.stdout == f"__main__ {package / '__init__.py'} a b c\n", done.stderr


def test_no_module_starts_python_in_another_way():
    """Each call of `sys.executable` in the package has `-P`."""
    calls = [
        line.strip()
        for file in (ROOT / "dynappo").rglob("*.py")
        for line in file.read_text().splitlines()
        if "[sys.executable" in line
    ]
    assert len(calls) == 1 and all('[sys.executable, "-P", ' in line for line in calls), calls

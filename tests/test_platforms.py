"""A Mac and native Windows, as far as Linux can play them: what they lack is neither imported nor called."""

import ast
import subprocess
import sys
import time
from pathlib import Path

import pytest
import workdirs
from answers import PATIENCE, ROOT, refused, shell
from other_system import MODULES

from dynappo.config import files, flags
from dynappo.config import shell as shell_lib
from dynappo.policy import render

OTHER = ROOT / "tests" / "other_system.py"


@pytest.mark.slow  # no file imports what is missing, and a robot is played there
def test_every_module_can_be_imported():
    done = shell(OTHER, "imports")
    assert done.returncode == 0, done.stderr
    found = {p.relative_to(ROOT) for p in (ROOT / "dynappo").rglob("*.py")}
    expected = [".".join(p.with_suffix("").parts) for p in found if p.stem != "__main__"]
    expected = {name.removesuffix(".__init__") for name in expected} - {"dynappo"}
    assert set(done.stdout.split()) == expected


def test_what_is_hidden_is_missed():
    """The system that the tests play is one on which such an import or call fails."""
    code = "import other_system, os; other_system.hide(); assert not hasattr(os, 'sysconf')\n"
    code += "exec('import fcntl', {'__name__': 'dynappo.config.files'})"
    done = shell("-c", code, cwd=OTHER.parent)
    assert done.returncode and "No module named 'fcntl'" in done.stderr


def test_a_robot_walks_there_on_a_page(tmp_path):
    out = tmp_path / "walk.html"
    done = shell(OTHER, "play", "go1", "--seconds=1.5", f"--out={out}")
    assert done.returncode == 0, done.stderr
    assert "fall               none" in done.stdout and out.stat().st_size > 50_000


@pytest.mark.slow
def test_a_run_is_trained_there_and_goes_on(tmp_path):
    """The same command again evaluates it anew; the lock is that of a system without fcntl."""
    run = tmp_path / "run"
    done = shell(OTHER, "toy", f"--workdir={run}", "--config.run.num_iterations=4")
    assert done.returncode == 0, done.stderr
    first, _, again = done.stdout.replace("\n", " ").partition("written to")
    assert first and "is complete (4 iterations)" in again and "is complete" not in first
    assert {"metrics.csv", "summary.json", "policy.npz"} <= {p.name for p in run.iterdir()}
    assert workdirs.steps(run) == {"4"}


def test_no_file_imports_what_is_missing_there():
    """Also inside of functions, which no test may have called."""
    found = set()
    for file in [*(ROOT / "dynappo").rglob("*.py"), *(ROOT / "configs").glob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            found |= {f"{file}: {name}" for name in names if name.split(".")[0] in MODULES}
    assert not found


# ---- Windows: locks, folders, shells, text


def windows_lock(monkeypatch):
    """There nobody reads or writes a file that is locked, not even who holds it."""

    def refuse(self, *_, **__):
        raise PermissionError(13, "Permission denied", str(self))

    for name in ("read_text", "write_text"):
        shipped = getattr(Path, name)

        def method(self, *a, shipped=shipped, **k):
            return (refuse if self.name == "lock" else shipped)(self, *a, **k)

        monkeypatch.setattr(Path, name, method)


def test_a_lock_that_cannot_be_read_holds_all_the_same(tmp_path, monkeypatch):
    windows_lock(monkeypatch)
    other = "import filelock, sys; "
    other += "lock = filelock.FileLock(sys.argv[1]); lock.acquire(); print(flush=True); input()"
    command = [sys.executable, "-c", other, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        line = refused(workdirs.opened, tmp_path, workdirs.config())
        process.communicate(b"\n")
    assert "another run is writing in this folder (its process is unknown)" in line
    assert workdirs.opened(tmp_path, workdirs.config()) == tmp_path


def test_a_run_is_moved_aside_when_nothing_in_it_is_open(tmp_path, monkeypatch):
    """Windows moves no folder with an open file in it."""
    run, rename, held = tmp_path / "run", Path.rename, []
    workdirs.opened(run, workdirs.config())
    (run / "metrics.csv").write_text("iteration\n1\n")
    locked = files.locked

    def watched(path):
        held.append(locked(path))
        return held[-1]

    def moved(self, target):
        with locked(run / "lock"):  # nobody holds it
            pass
        return rename(self, target)

    monkeypatch.setattr(files, "locked", watched)
    monkeypatch.setattr(Path, "rename", moved)
    monkeypatch.setattr(sys, "platform", "win32")
    workdirs.opened(run, workdirs.config(), fresh=True)
    assert (tmp_path / "run.old-1" / "metrics.csv").exists() and len(held) == 2


@pytest.mark.parametrize(
    ("word", "there"),
    [
        (r".venv\Scripts\python.exe", r".venv\Scripts\python.exe"),
        (r"C:\Users\Ann Lee\python.exe", r'"C:\Users\Ann Lee\python.exe"'),
        (".[video]", '".[video]"'),
        ("onnx>=1.20", '"onnx>=1.20"'),
    ],
)
def test_words_are_quoted_as_the_shell_of_windows_reads_them(monkeypatch, word, there):
    monkeypatch.setattr(sys, "platform", "win32")
    assert shell_lib.quoted(word) == there


def test_a_clone_on_another_drive_has_its_whole_path(monkeypatch):
    def relpath(path):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(shell_lib.os.path, "relpath", relpath)
    # the environment of these tests may be active
    monkeypatch.setattr(shell_lib.shutil, "which", lambda name: None)
    assert str(ROOT / "constraints.txt") in shell_lib.install("video")
    assert shell_lib.command_line().startswith(sys.executable)


def test_a_text_has_the_same_bytes_everywhere(tmp_path):
    files.write_text(tmp_path / "a", "höher\n")
    assert (tmp_path / "a").read_bytes() == "höher\n".encode()


def test_without_pthread_kill_ctrl_c_reaches_the_main_thread(monkeypatch):
    monkeypatch.delattr(flags.signal, "pthread_kill")
    with pytest.raises(KeyboardInterrupt):
        flags._interrupt()
        time.sleep(PATIENCE)


@pytest.mark.parametrize(
    ("system", "first"), [("darwin", "cgl"), ("win32", "wgl"), ("linux", "egl")]
)
def test_films_are_rendered_by_what_the_system_has(system, first):
    """In a fresh Python, because it is decided once."""
    code = f"import sys; from dynappo.description import robot; sys.platform = {system!r}; "
    code += "from dynappo.policy import render; print(*render.BACKENDS, render.NO_OPENGL)"
    done = shell("-c", code)
    assert done.stdout.startswith(first), done.stderr
    assert ("apt install" in done.stdout) == (system == "linux")
    assert render.BACKENDS == ("egl", "osmesa")

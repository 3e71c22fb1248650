"""A fault at every file operation of a run, one after the other: it goes on to the same bits.

Python's file operations in the workdir are counted, and the n-th one fails. (The arrays of a checkpoint
are written by tensorstore, in C++: a disk that is full there is `test_run.py`'s.)
"""

import builtins
import contextlib
import errno
import io
import os
import pathlib
import shutil
import threading

import numpy as np
import pytest
from toy_runs import assert_same
from workdirs import loop, table

from dynappo.config import ConfigError
from dynappo.run import workdir as workdir_lib

CALLS = ("open", "rename", "replace", "unlink", "mkdir", "rmdir", "truncate", "scandir", "listdir")
FAULTS = {
    "EIO": OSError(errno.EIO, "Input/output error"),
    "ENOSPC": OSError(errno.ENOSPC, "No space left on device"),
    "EMFILE": OSError(errno.EMFILE, "Too many open files"),
    "memory": MemoryError("cannot allocate"),
    "short": OSError(
        errno.ENOSPC, "No space left on device"
    ),  # after half of what is to be written
}


class Disk:
    """The file operations in a folder: counted, and the one of number `bad` fails with `fault`."""

    def __init__(self, folder, bad=None, kind="EIO"):
        self.folder, self.bad, self.kind, self.count, self.hit = str(folder), bad, kind, 0, ""

    def due(self, name, path) -> bool:
        if not isinstance(path, (str, pathlib.Path)) or not str(path).startswith(self.folder):
            return False
        self.count += 1
        if self.count - 1 == self.bad:
            self.hit = f"{name} {str(path).removeprefix(self.folder)}"
        return self.count - 1 == self.bad

    @contextlib.contextmanager
    def here(self):
        with pytest.MonkeyPatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, self.wrapped(name, getattr(os, name)))
            file = self.wrapped("file", io.open)
            patch.setattr(io, "open", file)
            patch.setattr(builtins, "open", file)
            yield self

    def wrapped(self, name, real):
        def call(path=".", *args, **kwargs):
            if not self.due(name, path):
                return real(path, *args, **kwargs)
            mode = args[0] if args else kwargs.get("mode", "r")
            if self.kind == "short" and name == "file" and set(str(mode)) & set("wax"):
                return short(real(path, *args, **kwargs))
            raise FAULTS[self.kind]

        return call


def short(file):
    """A file that takes half of what it is given and then has no room."""
    write = file.write

    def half(data):
        write(data[: len(data) // 2])
        raise FAULTS["short"]

    with contextlib.suppress(AttributeError):
        file.write = half
    return file


def go(config, program, workdir, said):
    """Open the folder and train to the end, as the command does."""
    with workdir_lib.open_workdir(workdir, config):
        return loop(config, program(), workdir, say=said.append)[0]


@pytest.fixture(scope="module")
def half(config, program, whole, tmp_path_factory):
    """A run that has done half of its iterations."""
    folder = tmp_path_factory.mktemp("half") / "run"
    shutil.copytree(whole.workdir, folder)
    shutil.rmtree(folder / "checkpoints" / "4")
    return folder


def survives(config, program, half, whole, workdir, kind, n) -> bool:
    """The run with its n-th operation failing, and then again without; False where it has fewer.

    It ends in one line, or tells of the fault and trains on; afterwards state and rows are those of the run
    that met no fault.
    """
    shutil.rmtree(workdir, ignore_errors=True)
    shutil.copytree(half, workdir)
    said, disk = [], Disk(workdir, n, kind)
    with contextlib.suppress(ConfigError, OSError, MemoryError), disk.here():
        go(config, program, workdir, said)
    assert not any("\n" in line for line in said)
    assert not [t for t in threading.enumerate() if "ch_save" in t.name], disk.hit  # orbax's
    assert_same(go(config, program, workdir, []), whole.state)
    assert table(workdir) == table(whole.workdir), f"{kind} at {disk.hit}"
    # what was being written may be damaged (orbax goes on without its own texts); what was there is not
    assert {path.name for path in workdir.glob("*damaged*")} <= {"damaged-4"}
    return bool(disk.hit)


@pytest.mark.parametrize(  # those three are an OSError of the same operations
    "kind",
    [pytest.param(k, marks=[pytest.mark.slow] if k in ("EIO", "EMFILE") else []) for k in FAULTS],
)
def test_some_faults(config, program, half, whole, tmp_path, kind):
    """The first three operations, which a folder is opened with, and some of the others."""
    some = {0, 2, 4, *np.random.default_rng(len(kind)).integers(5, 50, 2).tolist()}
    assert all(survives(config, program, half, whole, tmp_path / "run", kind, n) for n in some)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_every_fault(config, program, half, whole, tmp_path, kind):
    """More than fifty operations a run."""
    n = 0
    while survives(config, program, half, whole, tmp_path / "run", kind, n):
        n += 1
    print(f"{n} operations")
    assert n > 50

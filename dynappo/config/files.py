"""Find configs/ and robots/, write small files (whole or not at all), lock a workdir."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # of some file systems
MORE = "deploy", "rough"  # policies that a robot may have beside its first


class Locked(Exception):
    """Another process holds a lock; the text says which."""


def roots() -> tuple[Path, ...]:
    """Where configs/ and robots/ are looked for: working directory, clone, installed package."""
    return Path.cwd(), PACKAGE.parent, PACKAGE


def find(folder: str, name: str, own: bool = False) -> Path | None:
    """The first `folder/name` of `roots`, with `own` not of the working directory; None if there is none."""
    paths = (root / folder / name for root in roots()[own:])
    return next((path for path in paths if os.path.exists(path)), None)  # also of a name too long


def robots() -> list[str]:
    """Names of all robots in the folders robots/ of `roots`."""
    files = [path for root in roots() for path in root.glob("robots/*/*.xml")]
    return sorted({path.stem for path in files if path.stem == path.parent.name})


def bundled() -> list[str]:
    """Names of bundled policies: of each robot, and where it has them `ROBOT_deploy`, for hardware, and
    `ROBOT_rough`, for rough ground."""
    more = [
        f"{name}_{kind}"
        for name in robots()
        for kind in MORE
        if find("robots", f"{name}/{kind}.npz")
    ]
    return sorted([*robots(), *more])


def check_regular(path: Path) -> None:
    """OSError for a pipe or a device: reading one may block, or never end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "Not a regular file", str(path))


@contextlib.contextmanager
def without_stderr() -> Iterator[None]:
    """What C and C++ libraries write to stderr is lost meanwhile."""
    try:
        before = os.dup(2)
    except OSError:  # there is none
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(nowhere)


def holder() -> str:
    """What this process writes into its locks."""
    return f"pid {os.getpid()} on {socket.gethostname()}\n"


@contextlib.contextmanager
def locked(path: Path) -> Iterator[Any]:
    """Yields the lock `path`, which this process holds until the `with` ends; Locked if another one does.

    The lock ends with the process, however that ends: a file that a killed run leaves behind holds
    nobody up. File systems without locks go without.
    """
    import filelock

    lock = filelock.FileLock(path)
    try:
        lock.acquire(blocking=False)
    except filelock.Timeout:
        other = "its process is unknown"
        with contextlib.suppress(PermissionError):
            other = path.read_text().strip()
        raise Locked(other) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
    try:
        with contextlib.suppress(PermissionError):  # Windows locks what the file holds, too
            path.write_text(holder())
        yield lock
    finally:
        lock.release()


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields a file beside `path` that becomes `path` at the end, whole; after an error it is gone."""
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.unlink(missing_ok=True)  # of a process that was killed
        yield part
        os.replace(part, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:  # a full disk does not name it
            error.filename = str(path)
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write whole or not at all, with the same bytes on every system."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value) -> None:
    """Write whole or not at all."""
    write_text(path, json.dumps(value, indent=2) + "\n")

"""The arrays of a checkpoint, read without JAX: its hash is checked, and nothing in the folder is changed.

With tensorstore, because orbax would import JAX, and JAX would take a GPU that trains. Python reads the
files, and tensorstore only what is then in memory. So the two ways to fail are never confused: what the
machine cannot give now is an OSError or a MemoryError, and what it gave but cannot be right is `Damaged`.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import numpy as np

from dynappo.config import ConfigError

STATE = "state"  # where a checkpoint has its arrays
LOST = (FileNotFoundError, NotADirectoryError, IsADirectoryError)  # they will not come back


class Damaged(ConfigError):
    """A checkpoint without what belongs to it, or whose numbers are not those that were saved."""

    def __init__(self, folder: Path, reason: str):
        super().__init__(f"{folder}: not a checkpoint, or damaged ({reason})")
        self.reason = reason


def about(folder: Path) -> dict:
    """What was saved beside the arrays: iteration, config, the shape of every array, a hash of all."""
    found = read_json(folder, "about/metadata")
    if not isinstance(found.get("arrays"), dict) or not isinstance(found.get("sha256"), str):
        raise Damaged(folder, "its `about` lacks shapes or hash")
    return found


def read_json(folder: Path, name: str) -> dict:
    """The JSON object in a file of a checkpoint."""
    try:
        found = json.loads((folder / name).read_bytes())
    except (*LOST, ValueError, RecursionError) as error:
        raise Damaged(folder, _reason(error)) from None
    if not isinstance(found, dict):
        raise Damaged(folder, f"{name} holds no JSON object")
    return found


def read(folder: Path) -> dict[str, np.ndarray]:
    """All arrays of an orbax checkpoint by name, as `learner.params.std`; nothing there is changed.

    They are some MB, and all are read because the hash that was saved with them is one of all.
    """
    import tensorstore

    expected, context = about(folder), tensorstore.Context()
    files, arrays, found = _files(folder), {}, hashlib.sha256()
    try:
        memory = tensorstore.KvStore.open({"driver": "memory"}, context=context).result()
        for name, content in files.items():
            memory.write(name, content).result()
        store = {"driver": "ocdbt", "base": "memory://"}
        names = tensorstore.KvStore.open(store, context=context).result().list().result()
        for name in {n.decode().rpartition("/")[0] for n in names}:
            spec = {"driver": "zarr", "kvstore": store | {"path": f"{name}/"}}
            opened = tensorstore.open(spec, open=True, read=True, context=context).result()
            arrays[name] = np.asarray(opened.read().result())
        for name in expected["arrays"]:  # in the order of `checkpoint.digest`
            found.update(arrays[name.replace("/", ".")].tobytes())
        if found.hexdigest() != expected["sha256"]:
            raise ValueError("its numbers are not those that were saved")
    except MemoryError:
        raise
    except Exception as error:  # tensorstore raises ValueError, KeyError and others of its own
        raise Damaged(folder, _reason(error)) from None
    return arrays


def _files(folder: Path) -> dict[str, bytes]:
    """The bytes of every file of the arrays, by its path."""
    state = folder / STATE
    try:
        walk = os.walk(state, onerror=_raise)  # rglob would leave out what it may not read
        paths = [Path(where) / name for where, _, names in walk for name in names]
        files = {path.relative_to(state).as_posix(): path.read_bytes() for path in paths}
    except LOST as error:
        raise Damaged(folder, _reason(error)) from None
    if not files:
        raise Damaged(folder, "its arrays are missing")
    return files


def _raise(error: OSError):
    raise error


def _reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:80]


def iterations(folder: Path) -> list[int]:
    """Iterations of the checkpoints in `folder` that are complete, newest first."""
    names = (path.name for path in folder.glob("[0-9]*"))
    return sorted((int(name) for name in names if name.isdigit()), reverse=True)

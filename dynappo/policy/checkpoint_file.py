"""The arrays of a checkpoint, read without JAX: its hash is checked, and nothing in the folder is changed.

With tensorstore, because orbax would import JAX, and JAX would take a GPU that trains.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from dynappo.config import ConfigError

STATE = "state"  # where a checkpoint has its arrays


class Damaged(ConfigError):
    """A checkpoint that cannot be read, or whose numbers are not those that were saved."""

    def __init__(self, folder: Path, reason: str):
        super().__init__(f"{folder}: not a checkpoint, or damaged ({reason})")
        self.reason = reason


def about(folder: Path) -> dict:
    """What was saved beside the arrays: iteration, config, the shape of every array, a hash of all."""
    try:
        found = json.loads((folder / "about" / "metadata").read_text())
        if not isinstance(found["arrays"], dict) or not isinstance(found["sha256"], str):
            raise ValueError("its `about` lacks shapes or hash")
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise Damaged(folder, _reason(error)) from None
    return found


def read(folder: Path) -> dict[str, np.ndarray]:
    """All arrays of an orbax checkpoint by name, as `learner.params.std`; nothing there is changed.

    They are some MB, and all are read because the hash that was saved with them is one of all.
    """
    import tensorstore

    expected = about(folder)
    store = {"driver": "ocdbt", "base": f"file://{(folder / STATE).resolve()}/"}
    arrays, found = {}, hashlib.sha256()
    try:
        names = tensorstore.KvStore.open(store).result().list().result()
        for name in {n.decode().rpartition("/")[0] for n in names}:
            spec = {"driver": "zarr", "kvstore": store | {"path": f"{name}/"}}
            array = tensorstore.open(spec, open=True, read=True).result().read().result()
            arrays[name] = np.asarray(array)
        for name in expected["arrays"]:  # in the order of `checkpoint.digest`
            found.update(arrays[name.replace("/", ".")].tobytes())
        if found.hexdigest() != expected["sha256"]:
            raise ValueError("its numbers are not those that were saved")
    except Exception as error:  # tensorstore raises ValueError, KeyError and others of its own
        raise Damaged(folder, _reason(error)) from None
    return arrays


def _reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:80]


def iterations(folder: Path) -> list[int]:
    """Iterations of the checkpoints in `folder` that are complete, newest first."""
    names = (path.name for path in folder.glob("[0-9]*"))
    return sorted((int(name) for name in names if name.isdigit()), reverse=True)

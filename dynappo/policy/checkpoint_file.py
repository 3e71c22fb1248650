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


def read(folder: Path) -> dict[str, np.ndarray]:
    """All arrays of an orbax checkpoint by name, as `learner.params.std`; nothing there is changed.

    They are some MB, and all are read because the hash that was saved with them is one of all.
    ConfigError if anything is damaged.
    """
    import tensorstore

    store = {"driver": "ocdbt", "base": f"file://{(folder / STATE).resolve()}/"}
    arrays = {}
    try:
        names = tensorstore.KvStore.open(store).result().list().result()
        for name in {n.decode().rpartition("/")[0] for n in names}:
            spec = {"driver": "zarr", "kvstore": store | {"path": f"{name}/"}}
            array = tensorstore.open(spec, open=True, read=True).result().read().result()
            arrays[name] = np.asarray(array)
        about, found = json.loads((folder / "about" / "metadata").read_text()), hashlib.sha256()
        for name in about["arrays"]:  # in the order of `checkpoint.digest`
            found.update(arrays[name.replace("/", ".")].tobytes())
        if found.hexdigest() != about["sha256"]:
            raise ValueError("its numbers are not those that were saved")
    except Exception as error:  # tensorstore raises ValueError, KeyError and others of its own
        reason = (str(error).splitlines() or [type(error).__name__])[0][:80]
        raise ConfigError(f"{folder}: not a checkpoint, or damaged ({reason})") from None
    return arrays


def steps(folder: Path) -> list[int]:
    """Iterations of the checkpoints in `folder` that are complete, newest first."""
    names = (path.name for path in folder.glob("[0-9]*"))
    return sorted((int(name) for name in names if name.isdigit()), reverse=True)

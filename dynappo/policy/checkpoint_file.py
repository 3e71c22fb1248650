"""Reads a checkpoint's arrays without JAX. It checks the hash and changes nothing in the folder.

It uses tensorstore, because orbax would import JAX, and JAX would occupy a GPU that is training.
Python reads the files, and tensorstore decodes them in memory. This keeps two kinds of failure
apart: if the machine cannot read a file now, that is an OSError or a MemoryError; if the contents
are wrong, that is `Damaged`.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from pathlib import Path

import numpy as np

from dynappo.config import ConfigError

STATE = "state"  # the folder of a checkpoint's arrays
JSON = 2**24  # bytes of a JSON file, at most
SQUEEZED = 100  # arrays are at most so many times larger than their compressed files
ROOM = 2**26  # bytes of a checkpoint's files beside those of its arrays, at most
LOST = (FileNotFoundError, NotADirectoryError, IsADirectoryError)  # trying again does not help
MEMORY = 2**36  # bytes, assumed if the system does not tell its memory


class Damaged(ConfigError):
    """A checkpoint with missing parts, or with numbers other than those saved."""

    def __init__(self, folder: Path, reason: str):
        super().__init__(f"{folder}: not a checkpoint, or damaged ({reason})")
        self.reason = reason


def about(folder: Path) -> dict:
    """The metadata saved with the arrays: iteration, config, every array's shape, a hash of all."""
    found = read_json(folder, "about/metadata")
    if folder.name.isdecimal() and found.get("iteration", int(folder.name)) != int(folder.name):
        raise Damaged(folder, f"it says that it is of iteration {found['iteration']}")
    if not isinstance(found.get("arrays"), dict) or not isinstance(found.get("sha256"), str):
        raise Damaged(folder, "its `about` lacks shapes or hash")
    return found


def read_json(folder: Path, name: str) -> dict:
    """The JSON object in a file of a checkpoint."""
    try:
        if (folder / name).exists() and not (folder / name).is_file():
            raise ValueError(f"{name} is not a file")
        size = (folder / name).stat().st_size
        if size > JSON:
            raise ValueError(f"{name} has {size / 1e6:.0f} MB")
        found = json.loads((folder / name).read_bytes())
    except (*LOST, ValueError, RecursionError) as error:
        raise _wrong(folder, error) from None
    if not isinstance(found, dict):
        raise Damaged(folder, f"{name} holds no JSON object")
    return found


def read(folder: Path) -> dict[str, np.ndarray]:
    """All arrays of an orbax checkpoint by name, like `learner.params.std`; changes nothing there.

    All are read, some MB, because the saved hash is over all of them.
    """
    import tensorstore

    expected, context = about(folder), tensorstore.Context()
    files, arrays, found = _files(folder, expected["arrays"]), {}, hashlib.sha256()
    try:
        memory = tensorstore.KvStore.open({"driver": "memory"}, context=context).result()
        for name, content in files.items():
            memory.write(name, content).result()
        store = {"driver": "ocdbt", "base": "memory://"}
        names = tensorstore.KvStore.open(store, context=context).result().list().result()
        stored = {}
        for name in {n.decode().rpartition("/")[0] for n in names}:
            spec = {"driver": "zarr", "kvstore": store | {"path": f"{name}/"}}
            stored[name] = tensorstore.open(spec, open=True, read=True, context=context).result()
        held = sum(map(len, files.values()))
        _check_sizes(folder, stored, expected["arrays"], SQUEEZED * held + ROOM)
        for name, array in stored.items():
            arrays[name] = np.asarray(array.read().result())
        for name in expected["arrays"]:  # in the order of `checkpoint.digest`
            found.update(arrays[name.replace("/", ".")].tobytes())
        if found.hexdigest() != expected["sha256"]:
            raise ValueError("its numbers are not those that were saved")
    except (MemoryError, ConfigError):  # too large for this machine, but not damaged
        raise
    except Exception as error:  # tensorstore raises ValueError, KeyError and others of its own
        raise Damaged(folder, _reason(error)) from None
    return arrays


def _files(folder: Path, arrays: dict[str, str]) -> dict[str, bytes]:
    """The bytes of every file of the `arrays`, by path; their size is limited by the arrays'."""
    state = folder / STATE
    sizes = (re.findall(r"\d{1,18}", str(text).rpartition("[")[2])[:8] for text in arrays.values())
    most = 8 * sum(math.prod(map(int, size)) for size in sizes) + ROOM
    try:
        walk = os.walk(state, onerror=_raise)  # rglob would skip what it may not read
        paths = [Path(where) / name for where, _, names in walk for name in names]
        if not all(path.is_file() for path in paths):  # a pipe, a device, a link to nothing
            raise Damaged(folder, "it holds something that is not a file")
        size = sum(path.stat().st_size for path in paths)
        if size > most:
            raise Damaged(
                folder, f"its files have {size / 1e6:.0f} MB, its arrays {most / 1e6:.0f}"
            )
        files = {path.relative_to(state).as_posix(): path.read_bytes() for path in paths}
    except LOST as error:
        raise _wrong(folder, error) from None
    if not files:
        raise Damaged(folder, "its arrays are missing")
    return files


def _raise(error: OSError):
    raise error


def _check_sizes(folder: Path, stored: dict, expected: dict[str, str], most: int) -> None:
    """Check the sizes that arrays claim before reading them: terabytes would kill the process.

    Chunks that are not stored are zero, so a small file can claim large arrays; at most `most`
    bytes are accepted.

    ValueError if an array is not what `about` says; ConfigError if all do not fit into memory.
    """
    total = 0
    for name, array in stored.items():
        size, chunk = math.prod(array.shape), math.prod(array.chunk_layout.read_chunk.shape or ())
        total += size * array.dtype.numpy_dtype.itemsize
        if chunk > max(size, 1):
            raise ValueError(f"{name} is stored in pieces of {chunk} numbers, and has {size}")
    for name, known in expected.items():
        array = stored[name.replace("/", ".")]
        found = f"{array.dtype.name}{list(array.shape)}".replace(" ", "")
        if found != known and not known.startswith("key<"):  # random keys are stored as integers
            raise ValueError(f"{name} is {found}, its `about` says {known}")
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # not every system tells its memory
        memory = MEMORY
    if most < total <= memory:
        raise ValueError(f"its arrays are {total / 1e6:.0f} MB, too much for its files")
    if total > memory:
        raise ConfigError(
            f"{folder}: its arrays are {total / 1e9:.0f} GB, this machine has {memory / 1e9:.0f} GB"
        )


def _wrong(folder: Path, error: Exception) -> ConfigError:
    """`Damaged`, unless the whole folder is gone."""
    if folder.exists():
        return Damaged(folder, _reason(error))
    return ConfigError(f"{folder}: no such checkpoint; a run keeps its newest ones and the best")


def _reason(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:80]


def iterations(folder: Path) -> list[int]:
    """Iterations of the complete checkpoints in `folder`, newest first."""
    names = (path.name for path in folder.glob("[0-9]*") if path.is_dir())
    return sorted((int(name) for name in names if name.isdecimal()), reverse=True)

"""Reads a checkpoint's arrays without JAX. It checks the hash and changes nothing in the folder.

It uses tensorstore, with which orbax writes them: orbax itself would start JAX, and JAX would occupy a
GPU that is training. Python reads the files, and tensorstore decodes them in memory. This keeps three
kinds of failure apart:

- OSError, MemoryError: the machine cannot read a file now;
- `Damaged`: the files are proven wrong (missing, cut, a checksum that fails);
- `Unread`: anything else, perhaps a fault of this program or of another version of its libraries.

A run moves only what is `Damaged` out of its way.
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
MERGED = "manifest.ocdbt"  # in it, where its arrays begin
WRITTEN = "ocdbt.process_0"  # and the folder to which process 0 has written them
LOST = (FileNotFoundError, NotADirectoryError, IsADirectoryError)  # trying again does not help
# what tensorstore says of bytes that are missing or wrong; of a format it does not know it speaks
# as of wrong bytes, but names the version (and `version_tree_arity` is a number of the format it knows)
PROOF = re.compile(
    "DATA_LOSS|OUT_OF_RANGE|NOT_FOUND|checksum|ZSTD_|Zstd-|Not enough data|Error decoding"
)
OURS = re.compile(r"\bversion\b|support", re.IGNORECASE)


class Damaged(ConfigError):
    """A checkpoint that is proven to have missing parts, or numbers other than those saved."""

    def __init__(self, folder: Path, reason: str):
        super().__init__(f"{folder}: not a checkpoint, or damaged ({reason})")
        self.reason = reason


class Unread(ConfigError):
    """A checkpoint that cannot be read here and now, which proves no damage."""

    def __init__(self, folder: Path, reason: str):
        super().__init__(
            f"{folder}: cannot be read here, which is no proof that it is damaged ({reason}); nothing "
            "was changed. Read it with the versions that wrote it; to do without it, move it away"
        )


def iterations(folder: Path) -> list[int]:
    """Iterations of the complete checkpoints in `folder`, newest first."""
    try:
        names = os.listdir(folder)  # `glob` would find nothing in a folder that it may not read
    except LOST:
        return []
    found = (int(name) for name in names if name.isdecimal() and (folder / name).is_dir())
    return sorted(found, reverse=True)


def is_one(folder: Path) -> bool:
    """Whether a folder is a checkpoint, perhaps a damaged one."""
    return os.path.isdir(folder / STATE) and os.path.isdir(folder / "about")


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
        found = json.loads((folder / name).read_bytes())
    except (*LOST, ValueError, RecursionError) as error:
        raise _wrong(folder, error) from None
    if not isinstance(found, dict):
        raise Damaged(folder, f"{name} holds no JSON object")
    return found


def read(folder: Path) -> dict[str, np.ndarray]:
    """The arrays of an orbax checkpoint by path, like `learner/params/std`; changes nothing there.

    All are read, some MB, because the saved hash is over all of them. Arrays of size 0 are not in
    it: their shapes in `about` say all. Random keys are integers, and types that tensorstore does
    not know are bytes.
    """
    import tensorstore

    expected, context = about(folder), tensorstore.Context()
    sizes = {name: _sizes(text) for name, text in expected["arrays"].items()}
    wanted = [name for name, axes in sizes.items() if math.prod(axes)]
    arrays, found = {}, hashlib.sha256()
    files = _files(folder, bool(wanted))
    try:
        memory = tensorstore.KvStore.open({"driver": "memory"}, context=context).result()
        for name, content in files.items():
            memory.write(name, content).result()
        # orbax merges what process 0 has written, but did not in folders with `[` in their names
        part = "" if MERGED in files else f"{WRITTEN}/"
        store = {"driver": "ocdbt", "base": f"memory://{part}"}
        names = tensorstore.KvStore.open(store, context=context).result().list().result()
        keys = {n.decode().rpartition("/")[0] for n in names}
        dotted = {key.replace("/", "."): key for key in keys}  # once, they were stored so
        for name in wanted:  # in the order of `checkpoint.digest`
            key = name if name in keys else dotted.get(name.replace("/", "."))
            if key is None:
                raise Unread(folder, f"{name} is not in it")
            spec = {"driver": "zarr", "kvstore": store | {"path": f"{key}/"}}
            stored = tensorstore.open(spec, open=True, read=True, context=context).result()
            _check_type(folder, name, stored, expected["arrays"][name], sizes[name])
            arrays[name] = np.asarray(stored.read().result())
            found.update(arrays[name].tobytes())
    except (MemoryError, ConfigError):  # too large for this machine, but not damaged
        raise
    except Exception as error:  # tensorstore raises ValueError, KeyError and others of its own
        raise _judged(folder, error) from None
    if found.hexdigest() != expected["sha256"]:
        raise Damaged(folder, "its numbers are not those that were saved")
    return arrays


def _sizes(text: str) -> list[int]:
    """The sizes in `float32[4,3]`; of a text that makes none, some."""
    return [int(n) for n in re.findall(r"\d{1,18}", str(text).rpartition("[")[2])]


def _check_type(folder: Path, name: str, stored, known: str, sizes: list[int]) -> None:
    """Compare what an array claims with what `about` says of it, before it takes memory."""
    if known.startswith("key<"):  # random keys are stored as integers, of one axis more
        return
    found = f"{name} is {stored.dtype.name}{list(stored.shape)}, its `about` says {known}"
    if list(stored.shape) != sizes:
        raise Damaged(folder, found)
    if known.rpartition("[")[0] != stored.dtype.name and stored.dtype.name != "uint8":
        raise Unread(folder, found)


def _judged(folder: Path, error: Exception) -> Exception:
    """What an error of tensorstore's says of a checkpoint whose files Python has read."""
    text = (str(error).splitlines() or [type(error).__name__])[0]
    if "RESOURCE_EXHAUSTED" in text or "bad_alloc" in text:
        return MemoryError(f"{folder}: {text[:80]}")
    proven = PROOF.search(text) and not OURS.search(text)
    return Damaged(folder, text[:160]) if proven else Unread(folder, text[:160])


def _files(folder: Path, arrays: bool) -> dict[str, bytes]:
    """The bytes of every file of a checkpoint's arrays, by path."""

    def fail(error: OSError):
        raise error

    state = folder / STATE
    try:
        walk = os.walk(state, onerror=fail)  # rglob would skip what it may not read
        paths = [Path(where) / name for where, _, names in walk for name in names]
        files = {path.relative_to(state).as_posix(): path.read_bytes() for path in paths}
    except LOST as error:
        raise _wrong(folder, error) from None
    if arrays and not files.keys() & {MERGED, f"{WRITTEN}/{MERGED}"}:
        raise Damaged(folder, "its arrays are missing")
    return files


def _wrong(folder: Path, error: Exception) -> ConfigError:
    """`Damaged`, unless the whole folder is gone."""
    if folder.exists():
        return Damaged(folder, (str(error).splitlines() or [type(error).__name__])[0][:80])
    return ConfigError(f"{folder}: no such checkpoint; a run keeps its newest ones and the best")

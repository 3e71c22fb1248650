"""Reads the arrays of an untrusted npz file safely.

The file's claims are checked before memory is allocated: kind and size of every entry, type and
shape of every array. The file cannot run code (`allow_pickle=False`).
"""

from __future__ import annotations

import math
import reprlib
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from dynappo.config import ConfigError

MAX_BYTES = 2**27  # of all arrays together; a policy has less than 1 MiB
MAX_TEXT = 2**22  # bytes of `about`, four per character
MAX_NAME = 100  # characters
MAX_TABLE = 2**18  # bytes of the list of entries at the end of a zip file, about 50 per entry
END = struct.Struct(
    "<4s4H2LH"
)  # the end record of a zip file; the sixth number is the size of the list of entries
BIG_END = b"PK\6\7"  # comes before it in a zip file of more than 4 GiB or 65,535 entries
DAMAGE = (ValueError, EOFError, KeyError, RuntimeError, MemoryError)  # NumPy's and the parser's too
DAMAGE += (zipfile.BadZipFile, zlib.error, struct.error, SyntaxError, tokenize.TokenError)


def read(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an npz file by name: `about` is a text, all others hold real numbers.

    A one-line ConfigError names the file and the entry that is wrong.
    """
    try:
        with Path(path).open("rb") as file:
            _check_end(path, file)
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
                _check_entries(path, entries)
                return {_name(e): _array(path, archive, e) for e in entries}
    except ConfigError:
        raise
    except OSError as error:
        reason = error.strerror or "it is not an npz file"
        raise ConfigError(f"{path}: cannot be read ({reason})") from None
    except DAMAGE:
        raise ConfigError(f"{path}: not a policy.npz, or damaged") from None


def _name(entry: zipfile.ZipInfo) -> str:
    return entry.filename.removesuffix(".npy")


def _check_end(path: Path, file) -> None:
    """ConfigError unless it ends like NumPy's files; a list of a million entries takes seconds."""
    size = file.seek(0, 2)
    file.seek(max(0, size - END.size - 20))
    last = file.read()
    first, *_, table, _, comment = END.unpack(last[-END.size :].rjust(END.size))
    if first != b"PK\5\6" or comment or last.startswith(BIG_END):
        raise ConfigError(f"{path}: not a policy.npz, or damaged (it does not end as an npz file)")
    if table > MAX_TABLE:
        raise ConfigError(
            f"{path}: not a policy.npz, or damaged (a list of entries of {table} bytes, "
            f"expected at most {MAX_TABLE})"
        )


def _check_entries(path: Path, entries: list[zipfile.ZipInfo]) -> None:
    """ConfigError for entries that are packed as NumPy never does, duplicate or too large."""
    seen, total = set(), 0
    for entry in entries:
        name, how = _name(entry), entry.compress_type
        total += entry.file_size
        if len(name) > MAX_NAME or not name.isprintable():
            raise ConfigError(f"{path}: an entry is named {reprlib.repr(name)}: not a policy.npz")
        reason = ""
        if entry.flag_bits & 1:
            reason = "is encrypted"
        elif how not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            reason = f"is compressed by method {how}, expected none or deflate"
        elif name in seen:
            reason = "appears twice"
        elif total > MAX_BYTES:
            reason = f"brings it to {total} bytes unpacked, expected at most {MAX_BYTES}"
        if reason:
            raise ConfigError(f"{path}: its entry `{name}` {reason}")
        seen.add(name)


def _array(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array; ConfigError if its header does not match the number of bytes."""
    name = _name(entry)

    def expect(ok, text):
        if not ok:
            raise ConfigError(f"{path}: its entry `{name}` {text}")

    try:
        with archive.open(entry) as file:
            version = npy.read_magic(file)
            head = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
            expect(version in head, f"is damaged (array format {version})")
            shape, _, dtype = head[version](file)
            held = entry.file_size - file.tell()
        claims = math.prod(shape) * dtype.itemsize
        known = f"is damaged (shape {str(shape)[:60]} of {dtype.name[:20]}"
        fits = all(n >= 0 for n in shape) and claims == held
        expect(fits, f"{known} would be {claims} bytes, it has {held})")
        if name == "about":
            expect(dtype.kind == "U" and shape == (), f"is {dtype.name}, expected a text")
            expect(held <= MAX_TEXT, f"has {held} bytes, expected at most {MAX_TEXT}")
        else:
            expect(dtype.kind == "f", f"holds {dtype.name[:20]}, expected real numbers (float32)")
        with archive.open(entry) as file:
            return npy.read_array(file, allow_pickle=False)
    except ConfigError:
        raise
    except DAMAGE:
        raise ConfigError(f"{path}: its entry `{name}` is damaged") from None


def nested(arrays: dict[str, np.ndarray]) -> dict:
    """`{"actor/params": x}` as `{"actor": {"params": x}}`; ValueError if a name does not fit."""
    tree: dict = {}
    for name, value in arrays.items():
        *groups, leaf = name.split("/")
        node = tree
        for group in groups[:10]:
            node = node.setdefault(group, {})
            if not isinstance(node, dict):
                break
        if not isinstance(node, dict) or leaf in node or len(groups) > 10:
            raise ValueError(f"its entry `{name}` lies inside of another, or too deep")
        node[leaf] = value
    return tree

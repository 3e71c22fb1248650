"""A ground from a file: an array of heights (.npy), or a picture whose grey is the height.

A row of the array, or of the picture's points, is one x, the first the lowest; along it is y. The middle of
the map is the world's origin. Heights in an array are in m; a picture's are levels, 0 is black, of `level` m.
"""

from __future__ import annotations

import hashlib
import io
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from dynappo.terrain.height_map import HeightMap

SUFFIXES = (".npy", ".png")
HIGHEST = 100.0  # m, of a height above or below 0
MOST = 10**8  # points
# what NumPy says of an .npy or .npz that is none, or damaged. Here, because the readers of logs and policies
# may import this module, and it none of theirs
DAMAGE = (OSError, ValueError, TypeError, EOFError, KeyError, RuntimeError, MemoryError)
DAMAGE += (SyntaxError, OverflowError, zipfile.BadZipFile, zlib.error, tokenize.TokenError)
SIGNATURE, GREY = b"\x89PNG\r\n\x1a\n", 0  # of a PNG: how it begins, and its kind of colours


class BadMap(ValueError):
    """A file that is no ground, in one line: what was found, and what was expected."""


def load(path: str, level: float, cell: float, digest: str = "") -> HeightMap:
    """The ground in a file, `cell` m between two points. With a `digest` it must be that file: where there is
    none at `path`, one of its name in the working directory is taken."""
    file = Path(path)
    if digest and not file.is_file():
        file = Path(file.name)
    try:
        data = _read(file if file.is_file() else Path(path))
    except BadMap as error:
        here = f", nor is there a {file.name} here: expected the map that the run began with"
        raise BadMap(f"{error}{here}" if digest else str(error)) from None
    if digest and hashed(data) != digest:
        raise BadMap(
            f"{file} is another file ({hashed(data)}), expected the one that the run began with ({digest})"
        )
    heights = _heights(file, data, level)
    shape = heights.shape
    if heights.ndim != 2 or min(shape) < 2 or heights.size > MOST:
        raise BadMap(
            f"{file}: an array of {shape}, expected two axes of at least 2 points, 100 million together"
        )
    expected = f"expected m from {-HIGHEST:g} to {HIGHEST:g}"
    wrong = ~np.isfinite(heights)
    if wrong.any():
        first = ", ".join(map(str, np.argwhere(wrong)[0]))
        raise BadMap(
            f"{file}: {wrong.sum()} of {wrong.size} heights are no numbers, first that at [{first}], "
            f"{expected}"
        )
    if abs(heights).max() > HIGHEST:
        grey = f"; a level of its grey is {level:g} m" * (file.suffix.lower() == ".png")
        raise BadMap(
            f"{file}: heights from {heights.min():g} to {heights.max():g} m, {expected}{grey}"
        )
    corner = [-cell * (count - 1) / 2 for count in shape]
    return HeightMap(heights.astype(np.float32), float(cell), (corner[0], corner[1]))


def digest(path: str) -> str:
    """What tells a file from another."""
    return hashed(_read(Path(path)))


def hashed(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _read(file: Path) -> bytes:
    if file.suffix.lower() not in SUFFIXES:
        raise BadMap(f"{file}: expected a file that ends in {' or '.join(SUFFIXES)}")
    try:
        return file.read_bytes()
    except OSError as error:
        raise BadMap(f"{file} cannot be read ({error.strerror})") from None


def _heights(file: Path, data: bytes, level: float) -> np.ndarray:
    if file.suffix.lower() == ".npy":
        try:
            found = np.load(io.BytesIO(data), allow_pickle=False)
        except DAMAGE:
            found = None
        if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiub":
            raise BadMap(f"{file}: expected an array of numbers, as numpy.save writes it")
        return found.astype(float)
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError:
        raise BadMap(
            f"{file}: a picture needs Pillow: pip install pillow; or save a .npy"
        ) from None
    _check_depth(file, data)
    try:
        picture = Image.open(io.BytesIO(data))
        if picture.mode.startswith("I"):  # 16 bits
            return level * np.asarray(picture, float)
        red, green, blue, alpha = np.moveaxis(np.asarray(picture.convert("RGBA")), -1, 0)
    except Image.DecompressionBombError:  # it is a picture; Pillow's limit is above ours
        wide, high = struct.unpack(">II", data[16:24])
        raise BadMap(
            f"{file}: a picture of {wide} x {high} points, expected at most 100 million"
        ) from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError):
        raise BadMap(f"{file}: expected a picture in the format PNG") from None
    if (red != green).any() or (red != blue).any():
        raise BadMap(
            f"{file}: a picture with colours, expected levels of grey; what look --ground writes is no map"
        )
    if (alpha < 255).any():
        raise BadMap(
            f"{file}: {(alpha < 255).sum()} of {alpha.size} points are transparent, expected a height at "
            "each; save it without an alpha channel"
        )
    return level * red.astype(float)


def _check_depth(file: Path, data: bytes) -> None:
    """BadMap for a PNG whose levels Pillow does not give as they are: it cuts or stretches them to 8 bits."""
    if len(data) < 26 or data[:8] != SIGNATURE or data[12:16] != b"IHDR":
        raise BadMap(f"{file}: expected a picture in the format PNG")
    depth, kind = data[24], data[25]
    if depth == 16 and kind != GREY:
        raise BadMap(
            f"{file}: a picture of 16 bits with colours or an alpha channel, expected grey alone; save it "
            "without them"
        )
    if depth < 8 and kind == GREY:
        raise BadMap(f"{file}: a picture of {depth} bits, expected 8 or 16; save it with more")

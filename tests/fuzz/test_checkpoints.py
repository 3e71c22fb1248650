"""Checkpoints wherever a run's folder is and whatever its state holds: they come back to the bit.

Folders have names of any characters, of up to 255 bytes, and links on the way; states are trees as
environments of one's own have them: nested dicts, tuples and dataclasses of arrays of any type, empty ones
and random keys among them. A seeded generator. `-m fuzz` tries 200.
"""

import random
import tempfile
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import workdirs

from dynappo.run import checkpoint

FEW, MANY = 10, 200
TYPES = (
    "bool int8 uint8 int16 int32 uint32 float16 bfloat16 float32 int4 uint4 float8_e4m3fn".split()
)
LETTERS = "".join(map(chr, range(32, 127))).replace("/", "") + "éß☃漢🤖\t\n\x7f\u202e"
NAMES = ["", ".", "a.b", "a/b", "+", "0", "é", "[*?", "\\", "state", "about", "d", '""', "x" * 80]


@flax.struct.dataclass
class Node:
    """A state as a user writes it."""

    left: Any
    right: Any


def name(rng: random.Random) -> str:
    """A folder's name."""
    letters = LETTERS if rng.random() < 0.7 else "[]{}*?\\:~'\"$ .-%#@!"
    text = "".join(rng.choice(letters) for _ in range(rng.choice((1, 2, 5, 30, 200))))
    while len(text.encode()) > 255:
        text = text[:-1]
    return text if text.strip(".") else "x"


def leaf(rng: random.Random) -> Any:
    """An array, or a key."""
    shape = tuple(rng.choice((0, 1, 1, 2, 3, 7)) for _ in range(rng.choice((0, 1, 1, 2, 3))))
    if rng.random() < 0.15:
        impl = rng.choice(("threefry2x32", "rbg"))
        return jax.random.split(jax.random.key(rng.randrange(99), impl=impl), shape or 2)
    kind = jnp.dtype(rng.choice(TYPES))
    bits = np.random.default_rng(rng.randrange(2**31)).integers(0, 2, (*shape, 8))
    if kind == jnp.dtype(bool):
        return jnp.asarray(bits.any(-1) if bits.size else np.zeros(shape, bool))
    return jnp.asarray(bits.sum(-1)).astype(kind)


def tree(rng: random.Random, depth: int = 4) -> Any:
    """A state: nodes of any kind."""
    kind = rng.random()
    if depth == 0 or kind < 0.2:
        return leaf(rng) if kind > 0.02 else None
    parts = [tree(rng, depth - 1) for _ in range(rng.choice((0, 1, 2, 3)))]
    if kind < 0.6:
        return dict(zip(rng.sample(NAMES, len(parts)), parts, strict=True))
    if kind < 0.8:
        return tuple(parts) if kind < 0.7 else parts
    return Node(*(tree(rng, depth - 1) for _ in range(2)))


def raw(x) -> np.ndarray:
    key = jnp.issubdtype(x.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(x) if key else x)


def place(rng: random.Random, home):
    """A folder for a run, perhaps behind a link whose name is as odd."""
    folder = home
    for _ in range(rng.choice((1, 1, 2))):
        folder = folder / name(rng)
    folder.mkdir(parents=True, exist_ok=True)
    if rng.random() < 0.3:
        link = home / name(rng)
        if not link.exists():
            link.symlink_to(folder)
            return link
    return folder


def tried(count: int, tmp_path, monkeypatch) -> None:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    for number in range(count):
        rng = random.Random(f"55 {number}")
        home = tmp_path / str(number)
        home.mkdir()
        state = {"env": tree(rng), "one": leaf(rng), "more": jnp.ones(3)}
        workdir, said = place(rng, home), []
        what = f"number {number}: {str(workdir)!r} {jax.tree.map(lambda x: x.dtype, state)}"
        with checkpoint.opened(workdir, said.append) as checkpoints:
            checkpoint.save(checkpoints, 7, state, sim_steps=1)
        checkpoint.read_back(workdir / "checkpoints" / "7", state)
        before = workdirs.everything(workdir)
        blank = jax.tree.map(
            lambda x: x if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else jnp.zeros_like(x),
            state,
        )
        with checkpoint.opened(workdir, said.append) as checkpoints:
            found = checkpoint.newest(checkpoints, blank, said.append)
        assert found is not None and found[0] == 7 and not said, what
        assert jax.tree.structure(found[1]) == jax.tree.structure(state), what
        for ours, theirs in zip(*map(jax.tree.leaves, (found[1], state)), strict=True):
            assert ours.dtype == theirs.dtype and ours.shape == theirs.shape, what
            assert raw(ours).tobytes() == raw(theirs).tobytes(), what
        assert workdirs.everything(workdir).keys() == before.keys(), what  # nothing was moved
        assert not list((tmp_path / "tmp").iterdir()), what


def test_some_states_come_back_from_some_folders(tmp_path, monkeypatch):
    tried(FEW, tmp_path, monkeypatch)


@pytest.mark.fuzz
@pytest.mark.timeout(900)
def test_two_hundred_states_come_back_from_as_many_folders(tmp_path, monkeypatch):
    tried(MANY, tmp_path, monkeypatch)

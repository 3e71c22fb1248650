"""Checkpoints of a run (orbax): the whole `TrainState`, saved beside training, atomic.

The state holds no `mjx.Data` (orbax refuses its empty arrays, and it depends on the engine), so a
checkpoint made with MJX-Warp on a GPU goes on with MJX-JAX on a CPU.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

from dynappo.config import ConfigError

KEEP = 3


def manager(workdir: Path) -> ocp.CheckpointManager:
    """Keeps the newest checkpoints of `workdir/checkpoints`, named by iteration."""
    logging.getLogger("absl").setLevel(logging.ERROR)  # orbax logs every step of every save
    options = ocp.CheckpointManagerOptions(max_to_keep=KEEP)
    return ocp.CheckpointManager((workdir / "checkpoints").resolve(), options=options)


def save(checkpoints: ocp.CheckpointManager, iteration: int, state: Any) -> None:
    """Start saving; the arrays are copied off the device before this returns."""
    checkpoints.save(iteration, args=ocp.args.StandardSave(state))


def restore(checkpoints: ocp.CheckpointManager, like: Any) -> tuple[int, Any] | None:
    """`(iteration, state)` of the newest checkpoint, or None; `like` is a state of the same run."""
    newest = checkpoints.latest_step()
    if newest is None:
        return None
    shapes = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
    try:
        return newest, checkpoints.restore(newest, args=ocp.args.StandardRestore(shapes))
    except Exception as error:  # orbax raises many kinds: of shape, structure, missing file
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise ConfigError(
            f"{checkpoints.directory / str(newest)}: not a checkpoint of this config ({reason}); "
            "choose another --workdir, or remove it"
        ) from None

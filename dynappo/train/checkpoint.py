"""Checkpoints of a run (orbax): the whole `TrainState`, saved while training goes on, atomic.

Each holds two things: `state`, and `about`, a JSON text with the iteration, the
simulator steps, the config, the shape of every array and a hash of their bytes. The hash finds a
damaged file; the shapes explain why a checkpoint of another run does not fit.

Orbax writes them; they are read array by array (policy/checkpoint_file.py), so that a checkpoint of a
version with other options still loads. The state holds no `mjx.Data` (orbax refuses its empty arrays, and it
depends on the engine), so one made with Warp on a GPU goes on with MJX-JAX on a CPU.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import logging
import shutil
import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from orbax.checkpoint import checkpoint_managers

from dynappo.config import ConfigError
from dynappo.policy import checkpoint_file
from dynappo.program import distributed
from dynappo.train import log

KEEP = 3  # newest ones, and the one with the highest return in an evaluation


@contextlib.contextmanager
def opened(workdir: Path, say: Callable[[str], None] = print):
    """Yields what keeps the newest checkpoints of `workdir/checkpoints`, named by iteration, and the best.

    Orbax reads the small JSON texts of all of them at once and fails if one is damaged: such a
    checkpoint is moved out of the way first, and `say` tells so in one line. What cannot be read now is an
    OSError, and nothing is moved: a disk may come back. At the end a save under way
    is waited for. Meanwhile orbax's loggers are silent: they log every step of every save.
    """
    for step in (workdir / "checkpoints").glob("[0-9]*"):
        if step.name.isdecimal() and step.exists():  # not a link to nothing
            try:
                for text in ("about/metadata", "_CHECKPOINT_METADATA"):
                    checkpoint_file.read_json(step, text)
                if (step / "metrics").exists() and not _worth(step):
                    raise checkpoint_file.Damaged(step, "its metrics are not a number")
            except checkpoint_file.Damaged as error:
                _move_aside(step, error.reason, say)
    with _quiet():
        checkpoints = None
        try:
            checkpoints = manager(workdir)
            yield checkpoints
        finally:
            if checkpoints:
                log.attempt("the last checkpoint", partial(wait, checkpoints), say)
                with contextlib.suppress(Exception):  # it raises once more what `wait` has told
                    checkpoints.close()


@contextlib.contextmanager
def _quiet():
    """Meanwhile orbax logs nothing. Of a failed save, which `wait` tells in one line, its threads and what
    they leave behind say nothing later either: it would be hundreds of lines.
    """
    orbax, told = logging.getLogger("absl"), sys.unraisablehook
    level = orbax.level

    def hook(lost):
        if "Event loop is closed" not in str(lost.exc_value):
            told(lost)

    orbax.setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_of_others)
    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = told
        orbax.setLevel(level)


def _of_others(record: logging.LogRecord) -> bool:
    """Whether a record of asyncio is of no write of orbax's."""
    trace = record.exc_info[2] if record.exc_info else None
    return "orbax" not in record.getMessage() + "".join(traceback.format_tb(trace))


def _worth(step: Path) -> bool:
    """Whether what orbax chooses the best by is there."""
    found = checkpoint_file.read_json(step, "metrics/metrics").values()
    return bool(found) and all(type(x) in (int, float) for x in found)


def manager(workdir: Path) -> ocp.CheckpointManager:
    """Orbax's manager of `workdir/checkpoints`; use `opened`."""

    def worth(metrics):  # checkpoints from before evaluations were kept have another number
        return metrics.get("eval_return", -np.inf)

    keep = checkpoint_managers.AnyPreservationPolicy(
        [
            checkpoint_managers.LatestN(KEEP),
            checkpoint_managers.BestN(
                get_metric_fn=worth, n=1, keep_checkpoints_without_metrics=False
            ),
        ]
    )
    alone = {}
    if distributed.several():  # process 0 alone saves, and waits for no other
        (workdir / "checkpoints").mkdir(exist_ok=True)
        processes = ocp.options.MultiprocessingOptions(
            primary_host=0, active_processes={0}, barrier_sync_key_prefix="first"
        )
        alone = dict(multiprocessing_options=processes, create=False)
    options = ocp.CheckpointManagerOptions(
        **alone,
        preservation_policy=keep,
        best_fn=worth,
        cleanup_tmp_directories=True,  # of a save that was killed
        # else a thread of orbax waits five minutes for a folder that could not be made
        async_options=ocp.AsyncOptions(create_directories_asynchronously=False),
    )
    handlers = {"state": ocp.StandardCheckpointHandler(), "about": ocp.JsonCheckpointHandler()}
    registry = ocp.handlers.DefaultCheckpointHandlerRegistry()
    registry.add("state", ocp.args.StandardSave, handlers["state"])
    registry.add("about", ocp.args.JsonSave, handlers["about"])
    return ocp.CheckpointManager(
        (workdir / "checkpoints").resolve(), options=options, handler_registry=registry
    )


def save(
    checkpoints: ocp.CheckpointManager,
    iteration: int,
    state: Any,
    eval_return: float | None = None,
    **about,
) -> None:
    """Start saving; the arrays are copied off the device before this returns.

    `eval_return` is its return where it was evaluated: the highest one is kept.
    `about` (JSON: `sim_steps`, `config`) is kept beside the state. The save goes on in threads:
    `wait` does for it, and raises what went wrong. A disk that is too full for it is an OSError
    before anything is written: orbax's threads would print a traceback an array.
    """
    needed = 1.5 * sum(x.nbytes for x in jax.tree.leaves(state))
    free = shutil.disk_usage(Path(checkpoints.directory)).free
    if free < needed:
        text = f"No space left on device: {needed / 1e6:.0f} MB needed, {free / 1e6:.0f} MB free"
        raise OSError(errno.ENOSPC, text)
    about |= {"iteration": iteration, "arrays": shapes(state), "sha256": digest(state)}
    raw = _raw(state)
    args = ocp.args.Composite(state=ocp.args.StandardSave(raw), about=ocp.args.JsonSave(about))
    metrics = None if eval_return is None else {"eval_return": eval_return}
    checkpoints.save(iteration, args=args, metrics=metrics, force=True)


def wait(checkpoints: ocp.CheckpointManager) -> None:
    """Wait for a save under way; if it failed, take away what is there of it, and raise."""
    try:
        checkpoints.wait_until_finished()
    except Exception:
        for part in Path(checkpoints.directory).glob("*.orbax-checkpoint-tmp*"):
            shutil.rmtree(part, ignore_errors=True)
        raise


def newest(
    checkpoints: ocp.CheckpointManager, like: Any, say: Callable[[str], None] = print
) -> tuple[int, Any] | None:
    """`(iteration, state)` of the newest good checkpoint, or None; `like` is a state of this run.

    A damaged one is moved out of the way and `say` tells so in one line. ConfigError if a checkpoint
    is of another run, or if all are damaged; OSError or MemoryError, and nothing moved, where the machine
    cannot read one now.
    """
    folder = Path(checkpoints.directory)
    for iteration in sorted(checkpoints.all_steps(), reverse=True):
        try:
            return iteration, _read(folder / str(iteration), like)
        except checkpoint_file.Damaged as error:
            _move_aside(folder / str(iteration), error.reason, say)
            checkpoints.reload()
    damaged = sorted(folder.parent.glob("damaged-*"))
    if damaged:
        raise ConfigError(
            f"{folder}: no checkpoint can be read any more; the damaged ones are {damaged[0]} ...; "
            "start over with --fresh, or in another --workdir"
        )
    return None


def _move_aside(step: Path, reason: str, say) -> None:
    """`checkpoints/400` becomes `damaged-400`: the run will write its own 400 again."""
    names = (f"damaged-{step.name}" + (f".{n}" if n else "") for n in itertools.count())
    aside = next(p for p in (step.parent.parent / n for n in names) if not p.exists())
    step.rename(aside)
    say(f"checkpoint {step.name} is damaged ({reason}); it is now {aside}, an older one is taken")


def _read(folder: Path, like):
    """The state in a checkpoint, lying over the devices as `like` does."""
    found, expected = checkpoint_file.about(folder)["arrays"], shapes(like)
    for name in found | expected:
        if found.get(name) != expected.get(name):
            raise ConfigError(
                f"{folder} is not a checkpoint of this run: {name} is {found.get(name, 'absent')} "
                f"there, {expected.get(name, 'absent')} here; choose another --workdir"
            )
    arrays, (raw, wrap) = checkpoint_file.read(folder), distributed.raw_keys(like)
    leaves = [
        jax.device_put(arrays[name.replace("/", ".")], getattr(leaf, "sharding", None))
        for name, leaf in paths(raw).items()
    ]
    return wrap(jax.tree.unflatten(jax.tree.structure(raw), leaves))


def _raw(state: Any):
    """`distributed.raw_keys`, as orbax takes it: of several processes, no array of one of them."""
    raw, _ = distributed.raw_keys(state)
    return jax.device_get(raw) if distributed.several() else raw


def shapes(state: Any) -> dict[str, str]:
    """Type and shape of every array of a state, by its path: `learner/params/std: float32[12]`."""
    return {
        name: f"{leaf.dtype}{list(leaf.shape)}".replace(" ", "")
        for name, leaf in paths(state).items()
    }


def digest(state: Any) -> str:
    """SHA-256 of all numbers of a state."""
    leaves = [
        jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x
        for x in jax.tree.leaves(state)
    ]
    out = hashlib.sha256()
    for leaf in jax.device_get(leaves):
        out.update(np.ascontiguousarray(leaf).tobytes())
    return out.hexdigest()


def paths(tree: Any) -> dict[str, Any]:
    """The arrays of a tree by their paths, as `learner/params/std`."""
    import jax

    def name(path):
        return "/".join(
            str(getattr(k, "name", getattr(k, "key", getattr(k, "idx", k)))) for k in path
        )

    return {name(path): leaf for path, leaf in jax.tree.leaves_with_path(tree)}

"""Checkpoints of a run (orbax): the whole `TrainState`, saved while training goes on, atomic.

Each holds two things: `state`, and `about`, a JSON text with the iteration, the
simulator steps, the config, the shape of every array and a hash of their bytes. The hash finds a
damaged file; the shapes explain why a checkpoint of another run does not fit.

Orbax writes them; policy/checkpoint_file.py reads them array by array, so a checkpoint of a version with
other options still loads. The velocity task's state holds no `mjx.Data`, which depends on the engine: a run
begun with Warp on a GPU resumes with MJX-JAX on a CPU.

Why orbax gets a flat dict of arrays by their paths, not the tree: it refuses arrays of size 0, joins the
names of nested ones with a dot, so that two may become one, and does not know every kind of node. Why it gets
a path of plain names (`_plain`): etils' `glob` takes `[` in a folder's name for a pattern, tensorstore takes
a backslash for a slash, and both fail in silence.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import logging
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from orbax.checkpoint import checkpoint_managers

from dynappo.config import ConfigError
from dynappo.policy import checkpoint_file
from dynappo.program import distributed
from dynappo.run import log, worth

EVALUATED = "eval_"  # begins the names of metrics of an evaluation
TEXTS = {"metrics": "metrics/metrics", "_CHECKPOINT_METADATA": "_CHECKPOINT_METADATA"}
KEEP = 3  # newest ones, and the best in an evaluation (run/worth.py)


class Checkpoints(NamedTuple):
    """The checkpoints of one run, while it trains (`opened`)."""

    folder: Path  # WORKDIR/checkpoints
    manager: ocp.CheckpointManager


@contextlib.contextmanager
def opened(workdir: Path, say: Callable[[str], None] = print) -> Iterator[Checkpoints]:
    """The checkpoints in `workdir/checkpoints`, named by iteration; the newest and the best are kept.

    Orbax reads two small texts of all of them at once (`TEXTS`), and fails if one is damaged, but not if it
    is absent. So a damaged text is moved aside first, and `say` reports it. A text that cannot be read now is
    an OSError, and nothing is moved: a disk may come back. At the end of the `with` a save in progress is
    finished. Within it orbax's loggers are silent: they log every step of every save.

    What a killed save has left is removed here. Orbax would do so in a thread of its own, which may outlast
    the `with` and remove the save of the next one.
    """
    folder = workdir / "checkpoints"
    folder.mkdir(parents=True, exist_ok=True)
    _remove_unfinished(folder)
    for iteration in checkpoint_file.iterations(folder):
        for part in TEXTS:
            _check_text(folder / str(iteration), part, say)
    with _quiet(), _plain(workdir.resolve()) as plain:
        checkpoints = None
        try:
            checkpoints = Checkpoints(folder, manager(plain / "checkpoints"))
            yield checkpoints
        finally:
            if checkpoints:
                log.attempt("the last checkpoint", partial(wait, checkpoints), say)
                with contextlib.suppress(Exception):  # it raises once more what `wait` has told
                    checkpoints.manager.close()


@contextlib.contextmanager
def _plain(folder: Path) -> Iterator[Path]:
    """A path of `folder` that no library misreads as a pattern: its own, or a link to it."""
    if _is_plain(folder):
        yield folder
        return
    aside = next((d for d in (tempfile.gettempdir(), "/tmp") if _is_plain(Path(d))), None)
    if aside is None:
        raise ConfigError(
            f"{folder}: orbax cannot save in a folder of this name, and the one for temporary files has "
            "no plainer one; choose another --workdir, or set TMPDIR"
        )
    own = Path(tempfile.mkdtemp(prefix="dynappo-", dir=aside)).resolve()
    link = own / "run"
    try:
        link.symlink_to(folder, target_is_directory=True)
        yield link
    finally:  # not `rmtree`: nothing of the run can be meant
        link.unlink(missing_ok=True)
        own.rmdir()


def _is_plain(path: Path) -> bool:
    """Whether no part of a path is a pattern to `glob`, a slash to tensorstore, a scheme, or no text."""
    name = path.relative_to(path.anchor).as_posix()
    return name.isprintable() and not set(name) & set("[]*?\\:")


@contextlib.contextmanager
def _quiet():
    """Silence orbax within the `with`, and what its threads say later of a failed save.

    `wait` reports a failed save in one line; orbax's own report has hundreds.
    """
    orbax, before = logging.getLogger("absl"), sys.unraisablehook
    level = orbax.level

    def hook(lost):
        if "Event loop is closed" not in str(lost.exc_value):
            before(lost)

    orbax.setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_of_others)
    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
        orbax.setLevel(level)


def _of_others(record: logging.LogRecord) -> bool:
    """Whether a record of asyncio is of no write of orbax's."""
    trace = record.exc_info[2] if record.exc_info else None
    return "orbax" not in record.getMessage() + "".join(traceback.format_tb(trace))


def _check_text(step: Path, part: str, say) -> None:
    """Move a damaged text of a checkpoint aside: its metadata, or the return that ranks it."""
    path = step / part
    try:
        if path.exists():
            found = checkpoint_file.read_json(step, TEXTS[part]).values()
            numbers = bool(found) and all(type(x) in (int, float) for x in found)
            if part == "metrics" and not numbers:
                raise checkpoint_file.Damaged(step, "no number is in it")
    except checkpoint_file.Damaged as error:
        aside = _move_aside(path, step.parent.parent, f"{step.name}-{part.strip('_')}")
        say(f"{part} of checkpoint {step.name} is damaged ({error.reason}); it is now {aside}")


def manager(folder: Path) -> ocp.CheckpointManager:
    """Orbax's manager of the checkpoints in `folder`; use `opened`."""

    def worth_of(metrics):  # checkpoints from before evaluations were kept have another number
        return worth.worth({name.removeprefix(EVALUATED): x for name, x in metrics.items()})

    keep = checkpoint_managers.AnyPreservationPolicy(
        [
            checkpoint_managers.LatestN(KEEP),
            checkpoint_managers.BestN(
                get_metric_fn=worth_of, n=1, keep_checkpoints_without_metrics=False
            ),
        ]
    )
    alone = {}
    if distributed.several():  # process 0 alone saves, and waits for no other
        processes = ocp.options.MultiprocessingOptions(
            primary_host=0, active_processes={0}, barrier_sync_key_prefix="first"
        )
        alone = dict(multiprocessing_options=processes, create=False)
    options = ocp.CheckpointManagerOptions(
        **alone,
        preservation_policy=keep,
        best_fn=worth_of,
        # else a thread of orbax waits five minutes for a folder that could not be made
        async_options=ocp.AsyncOptions(create_directories_asynchronously=False),
    )
    handlers = {"state": ocp.StandardCheckpointHandler(), "about": ocp.JsonCheckpointHandler()}
    registry = ocp.handlers.DefaultCheckpointHandlerRegistry()
    registry.add("state", ocp.args.StandardSave, handlers["state"])
    registry.add("about", ocp.args.JsonSave, handlers["about"])
    return ocp.CheckpointManager(folder, options=options, handler_registry=registry)


def save(
    checkpoints: Checkpoints,
    iteration: int,
    state: Any,
    evaluation: Mapping[str, float] | None = None,
    **about,
) -> None:
    """Start saving; the arrays are copied off the device before this returns.

    `evaluation` has what was evaluated of it (`worth.MEASURES`), if it was: the best checkpoint is kept.
    `about` (JSON: `sim_steps`, `config`) is kept beside the state. Threads do the writing: `wait` waits for
    them, and raises what went wrong. A disk that is too full is an OSError before anything is written:
    orbax's threads would print a traceback for every array.
    """
    needed = 1.5 * sum(x.nbytes for x in jax.tree.leaves(state))
    free = shutil.disk_usage(checkpoints.folder).free
    if free < needed:
        text = f"No space left on device: {needed / 1e6:.0f} MB needed, {free / 1e6:.0f} MB free"
        raise OSError(errno.ENOSPC, text)
    about |= {"iteration": iteration, "arrays": shapes(state), "sha256": digest(state)}
    args = ocp.args.Composite(
        state=ocp.args.StandardSave(_flat(state)), about=ocp.args.JsonSave(about)
    )
    metrics = evaluation and {EVALUATED + name: value for name, value in evaluation.items()}
    checkpoints.manager.save(iteration, args=args, metrics=metrics, force=True)


def wait(checkpoints: Checkpoints) -> None:
    """Wait for a save in progress; if it failed, remove what it has written, and raise."""
    try:
        checkpoints.manager.wait_until_finished()
    except Exception:
        _remove_unfinished(checkpoints.folder)
        raise


def _remove_unfinished(folder: Path) -> None:
    """Remove what is left of saves; more than once, for a thread of one that failed may still write there."""
    for pause in (0.0, 0.05, 0.2, 0.5):  # s
        time.sleep(pause)
        left = list(folder.glob("*.orbax-checkpoint-tmp*"))
        if not left:
            return
        for part in left:
            shutil.rmtree(part, ignore_errors=True)


def read_back(folder: Path, state: Any) -> None:
    """ConfigError unless the checkpoint in `folder` holds `state`, to the bit.

    Libraries that write can fail in silence: better found now than when the run is to go on.
    """
    try:
        problem = "" if digest(_read(folder, state)) == digest(state) else "other numbers come back"
    except ConfigError as error:
        problem = getattr(error, "reason", str(error))
    if problem:
        raise ConfigError(f"{folder} has been saved, and cannot be read back: {problem}")


def newest(
    checkpoints: Checkpoints, like: Any, say: Callable[[str], None] = print
) -> tuple[int, Any] | None:
    """`(iteration, state)` of the newest good checkpoint, or None; `like` is a state of this run.

    One that is proven damaged is moved aside, and `say` reports it in one line. ConfigError if a checkpoint
    is of another run, if it cannot be read for a reason that proves no damage, or if all are damaged;
    OSError or MemoryError if the machine cannot read one now. Then nothing is moved.
    """
    folder = checkpoints.folder
    for iteration in checkpoint_file.iterations(folder):
        try:
            return iteration, _read(folder / str(iteration), like)
        except checkpoint_file.Damaged as error:
            aside = _move_aside(folder / str(iteration), folder.parent, str(iteration))
            checkpoints.manager.reload()
            say(
                f"checkpoint {iteration} is damaged ({error.reason}); it is now {aside}, "
                "an older one is taken"
            )
    damaged = sorted(folder.parent.glob("damaged-*"))
    if damaged:
        raise ConfigError(
            f"{folder}: no checkpoint can be read any more; the damaged ones are {damaged[0]} ...; "
            "start over with --fresh, or in another --workdir"
        )
    return None


def _move_aside(path: Path, workdir: Path, name: str) -> Path:
    """Rename `checkpoints/400` to `damaged-400`, and return that: the run will write a 400 again."""
    names = (f"damaged-{name}" + (f".{n}" if n else "") for n in itertools.count())
    return path.rename(next(p for p in (workdir / n for n in names) if not p.exists()))


def _read(folder: Path, like):
    """The state in a checkpoint, on the devices that `like` is on."""
    found, expected = checkpoint_file.about(folder)["arrays"], shapes(like)
    for name in found | expected:
        if found.get(name) != expected.get(name):
            raise ConfigError(
                f"{folder} is not a checkpoint of this run: {name} is {found.get(name, 'absent')} "
                f"there, {expected.get(name, 'absent')} here; choose another --workdir"
            )
    arrays, (raw, wrap) = checkpoint_file.read(folder), distributed.raw_keys(like)
    leaves = [
        jax.device_put(arrays[name].view(leaf.dtype), getattr(leaf, "sharding", None))
        if name in arrays
        else leaf  # of size 0
        for name, leaf in paths(raw).items()
    ]
    return wrap(jax.tree.unflatten(jax.tree.structure(raw), leaves))


def _flat(state: Any) -> dict[str, Any]:
    """The arrays that orbax gets: those that are not empty, by their paths, random keys as integers.

    Types that tensorstore does not know, such as uint4, become bytes. With several processes, all
    are arrays of NumPy.
    """
    raw, _ = distributed.raw_keys(state)
    flat = {name: leaf for name, leaf in paths(raw).items() if leaf.size}
    if distributed.several():
        flat = jax.device_get(flat)
    return {
        name: leaf if _is_stored(leaf.dtype) else np.array(leaf).view(np.uint8)
        for name, leaf in flat.items()
    }


def _is_stored(dtype) -> bool:
    """Whether tensorstore has this type: all of NumPy's own, but not all of JAX's of one byte."""
    return np.dtype(dtype).isbuiltin == 1 or dtype.itemsize > 1


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
    """The arrays of a tree by their paths, as `learner/params/std`; of two with one path, one is `PATH+`."""
    found: dict[str, Any] = {}
    for path, leaf in jax.tree.leaves_with_path(tree):
        keys = (getattr(k, "name", getattr(k, "key", getattr(k, "idx", k))) for k in path)
        name = "/".join(str(key) or '""' for key in keys)
        while name in found:
            name += "+"
        found[name] = leaf
    return found

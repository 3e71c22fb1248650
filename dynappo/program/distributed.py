"""One run over several processes: thin wrappers of `jax.distributed` and `multihost_utils`.

Every process runs the same command, and JAX treats all their devices as one machine. This module
makes the processes take the same steps together. Files belong to process 0, so only it needs to see
the workdir. With one process, nothing here has any effect.

If a process dies, JAX ends the others and says so: at once if it was process 0, which hosts JAX's
service, else after `HEARTBEAT`, or when a message to the dead process fails.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from dynappo.config import ConfigError

HEARTBEAT = 30  # s without a message after which JAX considers a process dead
CONNECTING = 300  # s in which all processes must connect
GONE = (
    "process {} of {} stops, because another one is gone or cannot be reached; "
    "the same command goes on from the last checkpoint ({})"
)


def join(coordinator: str | None, count: int | None, index: int | None) -> None:
    """Connect to the other processes, before JAX computes anything.

    Uses the flags `--coordinator=HOST:PORT --processes=N --process=I`, or, without them, what JAX
    finds of a Slurm step with several tasks. With `--processes=1`, each Slurm task is a run of its
    own. ConfigError if the flags are wrong, or if not all processes connect.
    """
    flags = {"--coordinator": coordinator, "--processes": count, "--process": index}
    missing = [name for name, value in flags.items() if value is None]
    if count == 1 or (len(missing) == 3 and os.environ.get("SLURM_STEP_NUM_TASKS", "1") == "1"):
        return
    if missing and len(missing) < 3:
        raise ConfigError(f"{missing[0]} is missing; several processes need {', '.join(flags)}")
    address = re.fullmatch(".+:([0-9]{1,5})", coordinator or "")
    if not missing and not (address and 0 < int(address[1]) < 65536):
        raise ConfigError(
            f"--coordinator is {coordinator!r}, expected HOST:PORT of process 0, a port from 1 to 65535"
        )
    if count is not None and index is not None and not 0 <= index < count:
        raise ConfigError(f"--process is {index}, expected 0 to {count - 1} (--processes={count})")
    import jax

    # JAX's own SIGTERM handler would replace ours, and the run would not save
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(
            coordinator,
            count,
            index,
            local_device_ids=slurm_devices(os.environ) if missing else None,
            initialization_timeout=CONNECTING,
            heartbeat_timeout_seconds=HEARTBEAT,
        )
    except Exception as error:
        reason = str(error).splitlines()[0][:160]
        raise ConfigError(
            f"the processes of this run cannot meet at {coordinator or 'the first Slurm task'} "
            f"({reason}); expected all of them within {CONNECTING} s"
        ) from None


def slurm_devices(environment) -> list[int] | None:
    """The GPUs of this task; None: JAX takes the one with the task's number on its machine."""
    tasks = environment.get("SLURM_STEP_TASKS_PER_NODE", "").split("(")[0].split(",")[0]
    visible = environment.get("CUDA_VISIBLE_DEVICES", "").split(",")
    if tasks == "1" or visible != [""] and len(visible) == 1:  # all GPUs, or the task's only one
        return list(range(len(visible)))
    return None


@contextlib.contextmanager
def together():
    """Wrap a whole command: if it fails, this process exits at once, and JAX ends the others.

    Otherwise, after an error in one process, that one would wait for the others to leave, and the
    others for it to take part.
    """
    try:
        yield
    except SystemExit as error:
        if several() and error.code:
            _end(int(error.code))
        raise
    except Exception:
        if not several():
            raise
        traceback.print_exc()
        _end(1)


@contextlib.contextmanager
def watched():
    """A one-line ConnectionError if a collective operation fails because a process is gone."""
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0][:200]
        lost = re.search("gloo|nccl|unavailable|coordination|connection", reason, re.IGNORECASE)
        if several() and lost:
            import jax

            where = jax.process_index(), jax.process_count()
            raise ConnectionError(GONE.format(*where, reason)) from None
        raise


def leave() -> None:
    """Wait for the other processes at the end of a run that finished or was stopped by a signal."""
    import jax

    if several():
        jax.distributed.shutdown()


def _end(status: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def barrier() -> None:
    """Wait for the other processes: compiling may take them minutes longer, and the first message
    between two processes times out after half a minute."""
    from jax.experimental import multihost_utils

    if several():
        multihost_utils.sync_global_devices("dynappo")


def several() -> bool:
    """Whether this is one of several processes; asking does not initialise JAX's devices."""
    if "jax" not in sys.modules:
        return False
    import jax

    return jax.distributed.is_initialized() and jax.process_count() > 1


def first() -> bool:
    """Whether this is process 0, the one that writes and prints."""
    import jax

    return not several() or jax.process_index() == 0


def on_first(action: Callable[[], Any]) -> Any:
    """Run `action` in process 0 and return its result (JSON) in all processes.

    A ConfigError is raised in all of them. After any other error, the others raise an OSError that
    quotes it; otherwise they would wait for ever.
    """
    from jax.experimental import multihost_utils

    if not several():
        return action()
    text, failed = b"", None
    if first():
        try:
            text = json.dumps({"value": action()}).encode()
        except Exception as error:
            failed = error
            kind = "error" if isinstance(error, ConfigError) else "fault"
            text = json.dumps({kind: str(error)}).encode()
    size = int(multihost_utils.broadcast_one_to_all(np.int32(len(text))))  # all send as much
    message = np.frombuffer(text.ljust(size)[:size], np.uint8)
    message = np.asarray(multihost_utils.broadcast_one_to_all(message)).tobytes()
    if failed:
        raise failed
    answer = json.loads(message)
    if "error" in answer:
        raise ConfigError(answer["error"])
    if "fault" in answer:
        raise OSError(f"process 0 has stopped: {answer['fault']}")
    return answer["value"]


def any_of(flag: bool) -> bool:
    """Whether `flag` is true in any process."""
    from jax.experimental import multihost_utils

    if not several():
        return flag
    return bool(np.any(multihost_utils.process_allgather(np.array(flag))))


def whole(tree: Any) -> Any:
    """A tree with every array whole, as NumPy, in all processes; random keys stay JAX keys."""
    from jax.experimental import multihost_utils

    if not several():
        return tree
    raw, wrap = raw_keys(tree)
    return wrap(multihost_utils.process_allgather(raw, tiled=True))


def from_first(change: Callable[[Any], tuple[Any, Any]], state: Any) -> tuple[Any, Any]:
    """Run `change(state) -> (value, state)` in process 0 only; all processes get its results.

    `change` sees the whole state in NumPy. The state returned is on the devices as before.
    """
    if not several():
        return change(state)
    host = whole(state)

    def act():
        nonlocal host
        value, host = change(host)
        return value

    value = on_first(act)
    return value, _spread(host, state)


def _spread(tree: Any, like: Any) -> Any:
    """The arrays of process 0's `tree`, with the shardings of `like`."""
    import jax
    from jax.experimental import multihost_utils

    raw, wrap = raw_keys(like)
    there = (
        raw_keys(tree)[0] if first() else jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), raw)
    )
    there = multihost_utils.broadcast_one_to_all(there)

    def lay(array, like):
        array = np.asarray(array, like.dtype)
        return jax.make_array_from_callback(like.shape, like.sharding, lambda part: array[part])

    return wrap(jax.tree.map(lay, there, raw))


def raw_keys(tree: Any):
    """`(raw, wrap)`: the tree with random keys as integers, and the function that restores them."""
    import jax

    def kind(x):  # threefry, or one of an environment's own choice
        is_key = jax.numpy.issubdtype(x.dtype, jax.dtypes.prng_key)
        return jax.random.key_impl(x) if is_key else ""

    kinds = jax.tree.map(kind, tree)
    raw = jax.tree.map(lambda x, impl: jax.random.key_data(x) if impl else x, tree, kinds)

    def wrap(raw):
        def back(x, impl):
            return jax.random.wrap_key_data(x, impl=impl) if impl else x

        return jax.tree.map(back, raw, kinds)

    return raw, wrap

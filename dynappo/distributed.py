"""One run over several processes, by `jax.distributed`: how they meet, agree, and end.

Every process runs the same command, and JAX makes one machine of them; what is here is that they
take the same turns. Files belong to process 0 alone, so nothing but it needs to see the workdir.

Where a process dies, JAX ends the others: at once if it was the first, which hosts its service, else
after `HEARTBEAT`, or when a message to the dead one fails. It does so by an abort with a trace of
C++; `_last_words` adds the line that says what to do. With one process nothing here does anything.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from dynappo.config import ConfigError

HEARTBEAT = 30  # s without a sign of life after which JAX takes a process for dead
MEETING = 300  # s for all processes to come
GONE = (
    "dynappo: process {} of {} stops, because another one is gone or cannot be reached; "
    "the same command goes on from the last checkpoint"
)
MESSAGE = 4096  # bytes


def join(
    coordinator: str | None, count: int | None, index: int | None, device: str = "auto"
) -> None:
    """Meet the other processes, before JAX computes anything.

    By the flags `--coordinator=HOST:PORT --processes=N --process=I`, or, without them, by the
    variables of a Slurm step with several tasks; `--processes=1` says that those are runs of their
    own. ConfigError if flags are wrong, or not all processes come.
    """
    flags = {"--coordinator": coordinator, "--processes": count, "--process": index}
    slurm = all(value is None for value in flags.values()) and in_slurm(os.environ)
    if not slurm and (count == 1 or set(flags.values()) == {None}):
        return
    where: dict[str, Any] = {}
    if not slurm:
        missing = [name for name, value in flags.items() if value is None]
        if missing:
            given = ", ".join(name for name in flags if name not in missing)
            raise ConfigError(f"{missing[0]} is missing; {given} needs it, see --help")
        assert coordinator and count is not None and index is not None
        if not coordinator.rpartition(":")[2].isdigit() or not coordinator.rpartition(":")[0]:
            raise ConfigError(f"--coordinator is {coordinator!r}, expected HOST:PORT of process 0")
        if not 0 <= index < count:
            raise ConfigError(
                f"--process is {index}, expected 0 to {count - 1} (--processes={count})"
            )
        where = dict(coordinator_address=coordinator, num_processes=count, process_id=index)
    import jax

    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    # JAX's own handler of SIGTERM would take the place of ours, and the run would not save
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(
            **where, initialization_timeout=MEETING, heartbeat_timeout_seconds=HEARTBEAT
        )
    except Exception as error:
        reason = str(error).splitlines()[0][:160]
        raise ConfigError(
            f"the processes of this run cannot meet at {coordinator or 'the first Slurm task'} "
            f"({reason}); expected all of them within {MEETING} s"
        ) from None


def in_slurm(environment) -> bool:
    """Whether this is one of several tasks of a Slurm step (`srun`), not its batch script."""
    return int(environment.get("SLURM_STEP_NUM_TASKS", 1)) > 1 and "SLURM_PROCID" in environment


@contextlib.contextmanager
def together():
    """What is done inside, the processes do together: where one is lost, this one says so and ends."""
    import jax

    if not several():
        yield
        return
    line = GONE.format(jax.process_index(), jax.process_count())
    pipe = _last_words(line)
    try:
        yield
        pipe.write(b"done")
    except (
        ConfigError,
        FloatingPointError,
        OSError,
        KeyboardInterrupt,
    ):  # known to all, or our own
        pipe.write(b"done")
        raise
    except Exception as error:
        pipe.write(b"done")
        pipe.close()
        reason = str(error).splitlines()[0][:200]
        if re.search("gloo|nccl|unavailable|coordination|connection", reason, re.IGNORECASE):
            print(f"{line} ({reason})", file=sys.stderr, flush=True)
        else:
            traceback.print_exc()
        os._exit(1)  # JAX would wait for the others
    finally:
        if not pipe.closed:
            pipe.close()


def _last_words(line: str):
    """A pipe to a small process that prints `line` if this one ends without writing to the pipe."""
    code = "import sys; sys.stdin.read() or print(sys.argv[1], file=sys.stderr, flush=True)"
    child = subprocess.Popen(
        [sys.executable, "-S", "-c", code, line], stdin=subprocess.PIPE, start_new_session=True
    )
    assert child.stdin
    return child.stdin


def several() -> bool:
    """Whether this is one of several processes; JAX is not made to look at its devices for it."""
    import jax

    return jax.distributed.is_initialized() and jax.process_count() > 1


def first() -> bool:
    """Whether this is process 0, which writes and prints."""
    import jax

    return not several() or jax.process_index() == 0


def on_first(action: Callable[[], Any]) -> Any:
    """What `action` returns in process 0 (JSON), in all of them; its ConfigError is raised in all."""
    from jax.experimental import multihost_utils

    if not several():
        return action()
    text = b""
    if first():
        try:
            text = json.dumps({"value": action()}).encode()
        except ConfigError as error:
            text = json.dumps({"error": str(error)[: MESSAGE // 2]}).encode()
    padded = np.zeros(MESSAGE, np.uint8)
    padded[: len(text)] = np.frombuffer(text, np.uint8)
    message = np.asarray(multihost_utils.broadcast_one_to_all(padded)).tobytes().rstrip(b"\0")
    answer = json.loads(message)
    if "error" in answer:
        raise ConfigError(answer["error"])
    return answer["value"]


def any_of(flag: bool) -> bool:
    """Whether it is so in any process."""
    from jax.experimental import multihost_utils

    if not several():
        return flag
    return bool(np.any(multihost_utils.process_allgather(np.array(flag))))


def whole(tree: Any) -> Any:
    """Every array of a tree as NumPy, in all processes; keys of random numbers stay JAX's."""
    from jax.experimental import multihost_utils

    if not several():
        return tree
    raw, wrap = raw_keys(tree)
    return wrap(multihost_utils.process_allgather(raw, tiled=True))


def from_first(change: Callable[[Any], tuple[Any, Any]], state: Any) -> tuple[Any, Any]:
    """`change(state) -> (value, state)`, done in process 0 alone; its results in all of them.

    There the state is whole, in NumPy; afterwards it lies over the devices as before.
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
    """The arrays that `tree` has in process 0, lying over all devices as those of `like`."""
    import jax
    from jax.experimental import multihost_utils

    raw, wrap = raw_keys(like)
    there = raw_keys(tree)[0] if first() else jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), raw)
    there = multihost_utils.broadcast_one_to_all(there)

    def lay(array, like):
        array = np.asarray(array, like.dtype)
        return jax.make_array_from_callback(like.shape, like.sharding, lambda part: array[part])

    return wrap(jax.tree.map(lay, there, raw))


def raw_keys(tree: Any):
    """`(the tree with keys of random numbers as integers, the way back)`."""
    import jax

    def is_key(x):
        return jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)

    keys = jax.tree.map(is_key, tree)
    raw = jax.tree.map(lambda x, key: jax.random.key_data(x) if key else x, tree, keys)

    def wrap(raw):
        return jax.tree.map(lambda x, key: jax.random.wrap_key_data(x) if key else x, raw, keys)

    return raw, wrap

"""One run over several processes, by `jax.distributed`: how they meet, agree, and end.

Every process runs the same command, and JAX makes one machine of them; what is here is that they
take the same turns. Files belong to process 0 alone, so nothing but it needs to see the workdir.

Where a process dies, JAX ends the others: at once if it was the first, which hosts its service, else
after `HEARTBEAT`, or when a message to the dead one fails. It does so by an abort with a trace of
C++; `_last_words` adds the line that says what to do. The same where the processes do not meet. With
one process nothing here does anything.
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
from dynappo.program import meeting

HEARTBEAT = 30  # s without a sign of life after which JAX takes a process for dead
MEETING = 300  # s for all processes to come
GONE = (
    "process {} of {} stops, because another one is gone or cannot be reached; "
    "the same command goes on from the last checkpoint"
)
MESSAGE = 4096  # bytes


def join(coordinator: str | None, count: int | None, index: int | None) -> None:
    """Meet the other processes, before JAX computes anything.

    By the flags `--coordinator=HOST:PORT --processes=N --process=I`, or, without them, by the
    variables of a Slurm step with several tasks; `--processes=1` says that those are runs of their
    own. ConfigError if flags are wrong, or not all processes come.
    """
    found = meeting.find(coordinator, count, index, os.environ)
    if found is None:
        return
    where, count, index = found
    import jax

    _last_words(GONE.format(index, count))
    # JAX's own handler of SIGTERM would take the place of ours, and the run would not save
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(
            **where, initialization_timeout=MEETING, heartbeat_timeout_seconds=HEARTBEAT
        )
    except Exception as error:
        _say("done")
        reason = str(error).splitlines()[0][:160]
        raise ConfigError(
            f"the processes of this run cannot meet at {coordinator or 'the first Slurm task'} "
            f"({reason}); expected all of them within {MEETING} s"
        ) from None


@contextlib.contextmanager
def together():
    """The whole of a command; where it ends badly, this process ends at once, and JAX the others.

    Without that, an error in one process would leave it waiting for the others to leave, and them for
    it to take part.
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
    """ConnectionError of one line where another process is lost, as a collective operation finds."""
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0][:200]
        lost = re.search("gloo|nccl|unavailable|coordination|connection", reason, re.IGNORECASE)
        if several() and lost:
            raise ConnectionError(f"{_line} ({reason})") from None
        raise


def leave() -> None:
    """Wait for the others, at the end of a run that went well or was stopped by a signal."""
    import jax

    if several():
        jax.distributed.shutdown()
    _say("done")


def _end(status: int) -> None:
    _say("done")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


_line, _pipe = "", None


def _last_words(line: str) -> None:
    """Start a small process that prints `line` if this one is ended by JAX, which aborts it."""
    global _line, _pipe
    code = "import sys; sys.stdin.read() or print(sys.argv[1], file=sys.stderr, flush=True)"
    command = [sys.executable, "-S", "-c", code, f"dynappo: {line}"]
    _line = line
    _pipe = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True).stdin


def _say(word: str) -> None:
    """Tell that process that nothing is to be told."""
    if _pipe and not _pipe.closed:
        with contextlib.suppress(BrokenPipeError):  # somebody has ended it
            _pipe.write(word.encode())
            _pipe.close()


def meet() -> None:
    """Wait here for the others: what they compiled may have taken minutes longer, and a first message
    between two processes waits for half a minute only."""
    from jax.experimental import multihost_utils

    if several():
        multihost_utils.sync_global_devices("meet")


def several() -> bool:
    """Whether this is one of several processes; JAX is not made to look at its devices for it."""
    if "jax" not in sys.modules:
        return False
    import jax

    return jax.distributed.is_initialized() and jax.process_count() > 1


def first() -> bool:
    """Whether this is process 0, which writes and prints."""
    import jax

    return not several() or jax.process_index() == 0


def on_first(action: Callable[[], Any]) -> Any:
    """What `action` returns in process 0 (JSON), in all of them; its error too.

    A ConfigError is one in all of them. Of any other the others raise an OSError that quotes it, because
    they would wait for ever.
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
            text = json.dumps({kind: str(error)[: MESSAGE // 2]}).encode()
    padded = np.zeros(MESSAGE, np.uint8)
    padded[: len(text)] = np.frombuffer(text, np.uint8)
    message = np.asarray(multihost_utils.broadcast_one_to_all(padded)).tobytes().rstrip(b"\0")
    if failed:
        raise failed
    answer = json.loads(message)
    if "error" in answer:
        raise ConfigError(answer["error"])
    if "fault" in answer:
        raise OSError(f"process 0 has stopped: {answer['fault']}")
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
    there = (
        raw_keys(tree)[0] if first() else jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), raw)
    )
    there = multihost_utils.broadcast_one_to_all(there)

    def lay(array, like):
        array = np.asarray(array, like.dtype)
        return jax.make_array_from_callback(like.shape, like.sharding, lambda part: array[part])

    return wrap(jax.tree.map(lay, there, raw))


def raw_keys(tree: Any):
    """`(the tree with keys of random numbers as integers, the way back)`."""
    import jax

    def is_key(x):
        return jax.numpy.issubdtype(x.dtype, jax.dtypes.prng_key)

    keys = jax.tree.map(is_key, tree)
    raw = jax.tree.map(lambda x, key: jax.random.key_data(x) if key else x, tree, keys)

    def wrap(raw):
        return jax.tree.map(lambda x, key: jax.random.wrap_key_data(x) if key else x, raw, keys)

    return raw, wrap

"""Does independent work on all cores, without JAX: `spread(work, items)`.

Most of a control step in NumPy is Python, so threads would take turns on one core. Processes do the work
instead, copies of this one (fork): they start in milliseconds, and nothing need be picklable but what comes
back. Where copies are not safe this process works alone: without fork, and once JAX has begun threads.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from multiprocessing import connection
from typing import Any

from dynappo.physics.cores import cores

MOST = 2**14  # items, whose numbers of two bytes a pipe has room for


def spread(
    work: Callable[[Any], Any],
    items: Sequence,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> list:
    """`[work(item) for item in items]`, with the same numbers on any number of cores.

    `tell(done, total)` comes first and after each item. What a copy did not do, because `work` failed there
    or the copy was killed, is done here, so an error is the one that `work` raises.
    """
    found: dict[int, Any] = {}
    tell(0, len(items))
    for i, result in _of_copies(work, items):
        found[i] = result
        tell(len(found), len(items))
    for i, item in enumerate(items):
        if i not in found:
            found[i] = work(item)
            tell(len(found), len(items))
    return [found[i] for i in range(len(items))]


def _of_copies(work, items):
    """`(i, work(items[i]))` as copies of this process finish them; nothing where there can be none."""
    count = min(cores(), len(items))
    if count < 2 or len(items) > MOST or sys.platform != "linux" or "jax" in sys.modules:
        return
    fork, copies, results = multiprocessing.get_context("fork"), [], []
    numbers, end = os.pipe()  # of the items that none does yet; a read takes one
    os.write(end, b"".join(i.to_bytes(2, "big") for i in range(len(items))))
    os.close(end)
    try:
        for _ in range(count):
            receives, sends = fork.Pipe(duplex=False)
            results.append(receives)
            given = work, items, numbers, sends, results
            copy = fork.Process(target=_work, args=given, daemon=True)
            with warnings.catch_warnings():  # that there are threads: copies use none of theirs
                warnings.simplefilter("ignore", DeprecationWarning)
                copy.start()
            sends.close()
            copies.append(copy)
        while results:
            arrived: list[Any] = connection.wait(results)
            for one in arrived:
                try:
                    yield one.recv()
                except (EOFError, OSError):
                    results.remove(one)
    finally:
        os.close(numbers)
        for copy in copies:
            copy.kill()
            copy.join()


def _work(work, items, numbers: int, sends, results) -> None:
    """In a copy: do the next item that none does, until there is none; an error ends it without a word, and
    where nobody reads the results any more."""
    with contextlib.suppress(BaseException):
        for one in results:  # the first process's; if it is killed, none may be left
            one.close()
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # ctrl-C is the first process's, which ends this
        while number := os.read(numbers, 2):
            i = int.from_bytes(number, "big")
            sends.send((i, work(items[i])))
    os._exit(0)  # nothing that the first process has yet to do or to print is done here

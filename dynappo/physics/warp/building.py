"""Builds Warp's kernels side by side, while JAX traces and XLA compiles.

Why: Warp builds a module when one of its kernels is first launched. The first physics step would build
forty modules, one after the other, after XLA is done: most of the first start. Here the step runs once
without its launches, to see which kernels it has. `wait` comes before a program's first call: a call is
captured as a CUDA graph, and one that waited for its kernels would keep the capture open meanwhile.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.physics.cores import cores

_LOADS: list[concurrent.futures.Future] = []  # of all modules, until `wait`


def launched(call: Callable[..., None], *arrays) -> set[tuple[Any, int]]:
    """`(module, threads of a block)` of all kernels that `call(*arrays)` would launch; none is."""
    found, cpu = set(), wp.get_device().is_cpu

    def note(kernel, dim=(), *_, block_dim=256, **__):
        if np.prod(dim):
            found.add((kernel.module, 1 if cpu else block_dim))

    def suggest(kernel, *_, **__):
        """Warp's answer loads the kernel, on a GPU, with its module's own number of threads."""
        if not cpu:
            found.add((kernel.module, kernel.module.options["block_dim"]))
        return 1, 1

    def once(_, while_body, **given):
        while_body(**given)

    with _replaced(
        launch=note, launch_tiled=note, capture_while=once, get_suggested_block_size=suggest
    ):
        call(*arrays)
    return found


@contextlib.contextmanager
def _replaced(**functions: Callable) -> Iterator[None]:
    """Warp with other functions of these names."""
    own = {name: getattr(wp, name) for name in functions}
    try:
        for name, function in functions.items():
            setattr(wp, name, function)
        yield
    finally:
        for name, function in own.items():
            setattr(wp, name, function)


def start(modules: set[tuple[Any, int]], devices: list[Any]) -> Callable[[], None]:
    """Build the modules in threads and load them on `devices` (Warp's); the result waits for that."""
    ordered = sorted(modules, key=lambda one: one[0].name)
    pool = concurrent.futures.ThreadPoolExecutor(cores())
    loads = [
        pool.submit(module.load, device, block_dim=size)
        for module, size in ordered
        for device in devices
    ]
    pool.shutdown(wait=False)
    _LOADS.extend(loads)
    return lambda: _wait_for(loads)


def wait() -> None:
    """Wait for all modules that were started in this process."""
    _wait_for(_LOADS)
    _LOADS.clear()


def _wait_for(loads: list[concurrent.futures.Future]) -> None:
    for load in loads:
        load.result()

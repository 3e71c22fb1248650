"""C MuJoCo in the place of MJX for a Playground task on a CPU: for one robot, to look at it, and for those of
an evaluation (by_name.py).

MJX takes a minute to compile for a CPU, and some tasks are slower than real time there. The task's own code
stays as it is; its physics call back. Same model and options, so the same physics but for rounding
(tests/tasks/test_playground.py). Engines of training are loading.py's.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from dynappo.tasks.playground import parts, swapped

NAMES = (*parts.FIELDS, "qacc_warmstart")


@contextlib.contextmanager
def physics(
    task: Any, data: mujoco.MjData | None = None, force: np.ndarray | None = None
) -> Iterator[None]:
    """Inside, a traced task has C MuJoCo's physics: its steps, and the data that a reset completes.

    They run in `data`. `force` [nbody, 6] (N, N m, in the world's frame), as it is when the traced function
    runs, is added to the task's own.
    """
    model = task.mj_model
    one = mujoco.MjData(model) if data is None else data
    more = np.zeros((model.nbody, 6)) if force is None else force

    def run(n, *inputs):
        found = []
        for qpos, qvel, warmstart, ctrl, own in zip(*map(np.asarray, inputs), strict=True):
            one.qpos[:], one.qvel[:], one.ctrl[:] = qpos, qvel, ctrl
            one.qacc_warmstart[:], one.xfrc_applied[:] = warmstart, own + more
            for _ in range(n):
                mujoco.mj_step(model, one)
            if n == 0:
                mujoco.mj_forward(model, one)
            found.append([np.array(getattr(one, name), np.float32) for name in NAMES])
        return [np.stack(x) for x in zip(*found, strict=True)]

    @functools.cache
    def compiled(n):
        """Of one robot, as a batch of one; under `vmap` one call for all."""

        @jax.custom_batching.custom_vmap
        def call(*inputs):
            return [x[0] for x in of_all(1, None, *(x[None] for x in inputs))[0]]

        @call.def_vmap
        def of_all(size, in_batched, *inputs):
            shapes = [
                jax.ShapeDtypeStruct((size, *getattr(one, name).shape), np.float32)
                for name in NAMES
            ]
            inputs = [
                x if in_batched is None or in_batched[i] else jnp.broadcast_to(x, (size, *x.shape))
                for i, x in enumerate(inputs)
            ]
            return jax.pure_callback(functools.partial(run, n), shapes, *inputs), [True] * len(
                NAMES
            )

        return call

    def after(data, ctrl, n):
        given = data.qpos, data.qvel, data.qacc_warmstart, jnp.asarray(ctrl), data.xfrc_applied
        found: dict[str, Any] = dict(zip(NAMES, compiled(int(n))(*given), strict=True))
        return parts.with_fields(data.replace(ctrl=ctrl), found)

    with swapped.physics(after, lambda data: after(data, data.ctrl, 0)):
        yield

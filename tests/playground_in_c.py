"""C MuJoCo in the place of MJX for a Playground task: the task's own code compiles in a few seconds."""

import contextlib
import functools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from dynappo.tasks.playground import parts, swapped

NAMES = (*parts.FIELDS, "qacc_warmstart")


@contextlib.contextmanager
def physics(task):
    """Inside, a traced task has C MuJoCo's physics: its steps, and the data that a reset completes."""
    model = task.mj_model

    one = mujoco.MjData(model)

    def run(n, *inputs):
        found = []
        for qpos, qvel, warmstart, ctrl in zip(*map(np.asarray, inputs), strict=True):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
            data.qacc_warmstart[:] = warmstart
            for _ in range(n):
                mujoco.mj_step(model, data)
            if n == 0:
                mujoco.mj_forward(model, data)
            found.append([np.array(getattr(data, name), np.float32) for name in NAMES])
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
        found = compiled(int(n))(data.qpos, data.qvel, data.qacc_warmstart, jnp.asarray(ctrl))
        found: dict[str, Any] = dict(zip(NAMES, found, strict=True))
        return parts.with_fields(data.replace(ctrl=ctrl), found)

    with swapped.physics(after, lambda data: after(data, data.ctrl, 0)):
        yield

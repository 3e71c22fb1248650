"""A task's own step, with physics or noise replaced.

A Playground task has one `step`: control, physics, then everything that follows from the new state and the
task's own numbers (`info`): observation, reward, timers, clocks, the next command. To compute that last part
alone, exactly as the task does, its step is traced while `mjx_env.step` is a function that returns a state
we have. XLA removes what is not asked for.

The names are replaced in Playground's and JAX's modules, while a function is traced and never while it runs.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
from mujoco import mjx
from mujoco_playground._src import mjx_env  # pyright: ignore[reportMissingImports]

LOCK = threading.RLock()  # of the modules whose names are replaced


@contextlib.contextmanager
def physics(
    step: Callable[[Any, Any, int], Any], forward: Callable[[Any], Any] = lambda data: data
) -> Iterator[None]:
    """Inside, physics are `step(data, ctrl, n) -> data` of n physics steps, and `forward(data) -> data`
    completes a reset's data; by default it does not."""

    def replaced(model, data, action, n_substeps=1):
        return step(data, action, n_substeps)

    completed = mock.patch.object(mjx, "forward", lambda model, data: forward(data))
    with LOCK, mock.patch.object(mjx_env, "step", replaced), completed:
        yield


@contextlib.contextmanager
def reset_to(data: Any) -> Iterator[None]:
    """Inside, a reset ends in these data, whatever it draws."""
    with physics(lambda _, ctrl, n: data, lambda _: data):
        yield


@contextlib.contextmanager
def uniform(at: float) -> Iterator[None]:
    """Inside, `jax.random.uniform` gives its interval's point `at`: 0.5 where noise is 0, 1 its largest."""

    def replaced(key, shape=(), dtype=float, minval=0.0, maxval=1.0, **_):
        low, high = jnp.asarray(minval, jnp.float32), jnp.asarray(maxval, jnp.float32)
        return jnp.broadcast_to(
            low + at * (high - low), shape or jnp.broadcast_shapes(low.shape, high.shape)
        )

    with LOCK, mock.patch.object(jax.random, "uniform", replaced):
        yield


def step(task: Any, state: Any, action, after: Any):
    """`task.step(state, action)` where physics end in the data `after`."""
    with physics(lambda data, ctrl, n: after.replace(ctrl=ctrl)):
        return task.step(state, action)


def steps_of_a_reset(task: Any) -> int:
    """Physics steps in the task's reset; a call that completes data is one."""
    counted = []

    def step(data, ctrl, n):
        counted.append(int(n))
        return data

    def forward(data):
        counted.append(1)
        return data

    with physics(step, forward):
        jax.eval_shape(task.reset, jax.random.PRNGKey(0))
    return sum(counted)


def state(data, obs, info, metrics) -> Any:
    """A Playground state, in dicts of its own: a task's step writes into them."""
    zero = jnp.zeros(())
    return mjx_env.State(data, obs, zero, zero, dict(metrics), dict(info))

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
def physics(step: Callable[[Any, Any], Any]) -> Iterator[None]:
    """Inside, physics are `step(data, ctrl) -> data`, and a reset's data are not completed."""

    def replaced(model, data, action, n_substeps=1):
        return step(data, action)

    forward = mock.patch.object(mjx, "forward", lambda model, data: data)
    with LOCK, mock.patch.object(mjx_env, "step", replaced), forward:
        yield


@contextlib.contextmanager
def reset_to(data: Any) -> Iterator[None]:
    """Inside, a reset ends in these data, whatever it draws."""
    forward = mock.patch.object(mjx, "forward", lambda model, _: data)
    with physics(lambda _, ctrl: data), forward:
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
    with physics(lambda data, ctrl: after.replace(ctrl=ctrl)):
        return task.step(state, action)


def state(data, obs, info, metrics) -> Any:
    """A Playground state, in dicts of its own: a task's step writes into them."""
    zero = jnp.zeros(())
    return mjx_env.State(data, obs, zero, zero, dict(metrics), dict(info))

"""Checks an environment of your own against the contract of `types.Env`.

Everything except the first numbers of `reset` is checked by shapes (`jax.eval_shape`), within a
second and before anything is compiled or written. An error is one line: what was found, what was
expected.
"""

from __future__ import annotations

import reprlib
import textwrap
import traceback
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.types import Env, Mirror, Outcome, Views

SCALARS = "reward discount truncation episode_return episode_length valid".split()
SIZES = "obs_size prop_size action_size dt episode_length".split()


def check(env: Any, config, tail: bool) -> None:
    """ConfigError for the first thing in which `env` breaks the contract of `types.Env`.

    `tail`: whether the config's schedule has rows that the model writes.
    """
    check_kind(env)
    hyper, key = config_lib.split(config)[1], jax.random.key(0)
    o, p, a = env.obs_size, env.prop_size, env.action_size
    action = jax.ShapeDtypeStruct((a,), jnp.float32)
    body = _shapes("randomize", env.randomize, hyper, key)
    state = _shapes("reset", env.reset, hyper, body, key)
    _check_state(env, state)
    found = _shapes("step", env.step, hyper, body, state, action, key)
    _check_step(env, state, found)
    again = _shapes("autoreset", env.autoreset, hyper, body, *found, key)
    _check_same("autoreset", again, state)
    if env.views is not None:
        _check_views(env)
    if env.recorded is not None:
        found = _shapes("recorded", env.recorded, state)
        _check_shape("recorded(state)", found, (a,), f"action_size = {a}")
    if env.evaluated is not None:
        found = _shapes("evaluated", env.evaluated, hyper)
        if not isinstance(found, type(hyper)):
            raise _wrong(f"evaluated(hyper) is {_kind(found)}", "hyper, with other numbers in it")
    if config.ppo.symmetry:
        _check_mirror(env)
    if config.ppo.scale_inputs and np.shape(env.input_scale) != (env.obs_size,):
        raise _wrong(
            f"input_scale has the shape {np.shape(env.input_scale)} where ppo.scale_inputs is True",
            f"a number for each of obs, ({env.obs_size},), or ppo.scale_inputs=False",
        )
    if not tail:
        return
    context, prop = (jax.ShapeDtypeStruct((size,), jnp.float32) for size in (o - p, p))
    found = _shapes("advance", env.advance, hyper, context, prop, action, prop)
    row = "advance(hyper, context, prop, action, next_prop)"
    _check_shape(row, found, (o - p,), "[obs_size - prop_size]")
    if config.model.clean:
        found = _shapes("sense", env.sense, hyper, prop, context, key)
        _check_shape("sense(hyper, prop, context, key)", found, (p,), "[prop_size]")
    if env.sense_context is not None:
        found = _shapes("sense_context", env.sense_context, hyper, context, key)
        row = "sense_context(hyper, context, key)"
        _check_shape(row, found, (o - p,), "[obs_size - prop_size]")
    if env.known_end is not None:
        found = _shapes("known_end", env.known_end, hyper, prop, context)
        _check_shape("known_end(hyper, prop, context)", found, (), "one number")
    if config.model.falls and env.fall_reward is not None:
        found = _shapes("fall_reward", env.fall_reward, hyper)
        _check_shape("fall_reward(hyper)", found, (), "one number")
    if config.schedule.new_commands:
        if env.retell is None:
            raise _wrong(
                "retell is None where schedule.new_commands is True",
                "a function, or schedule.new_commands=False",
            )
        found = _shapes("retell", env.retell, hyper, context, key)
        _check_shape("retell(hyper, context, key)", found, (o - p,), "[obs_size - prop_size]")
    if config.model.known_reward:
        obs = jax.ShapeDtypeStruct((o,), jnp.float32)
        known = _shapes("known_reward", env.known_reward, hyper, obs, action, prop)
        _check_shape("known_reward(hyper, obs, action, next_prop)", known, (), "one number")


def check_start(state: Any) -> None:
    """ConfigError if the first observations [..., O] are not finite."""
    for name in ("obs", "prop"):
        if not bool(jnp.isfinite(getattr(state, name)).all()):
            raise _wrong(f"reset's {name} is not finite", "finite numbers")


def _wrong(found: str, expected: str) -> ConfigError:
    return ConfigError(
        f"the environment: {found}, expected {expected}; docs/environment.md has the contract"
    )


def check_kind(env: Any) -> None:
    if not isinstance(env, Env):
        raise _wrong(f"it is {_kind(env)}", "a dynappo.types.Env")
    for name in SIZES:
        value = getattr(env, name)
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        real = name == "dt" and isinstance(value, (float, np.floating))
        if not (whole or real) or not value > 0:
            kind = "seconds" if name == "dt" else "an integer"
            raise _wrong(f"{name} is {value!r}", f"{kind} above 0")
    if env.prop_size > env.obs_size:
        raise _wrong(f"prop_size is {env.prop_size}", f"at most obs_size = {env.obs_size}")


def _kind(value: Any) -> str:
    return "None" if value is None else type(value).__name__


def _shapes(name: str, function: Any, *arguments) -> Any:
    """`jax.eval_shape`; an error in the user's function is one line that names the place."""
    try:
        return jax.eval_shape(function, *arguments)
    except ConfigError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        theirs = [f for f in frames if "-packages" not in f.filename and f.filename != __file__]
        place = f" ({_file(theirs[-1])}, line {theirs[-1].lineno})" if theirs else ""
        text = textwrap.shorten(str(error), 240, placeholder=" ...")
        raise _wrong(
            f"{name} cannot be run{place}: {type(error).__name__}: {text}",
            "a function that JAX traces",
        ) from None


def _file(frame: traceback.FrameSummary) -> str:
    return frame.filename.replace("\\", "/").rpartition("/")[2]


def _check_shape(name: str, value: Any, shape: tuple[int, ...], meaning: str) -> None:
    if getattr(value, "shape", None) != shape:
        found = f"of shape {value.shape}" if hasattr(value, "shape") else _kind(value)
        raise _wrong(f"{name} is {found}", f"{shape} ({meaning})")


def _check_state(env: Any, state: Any) -> None:
    for name, size in (("obs", env.obs_size), ("prop", env.prop_size)):
        if not hasattr(state, name):
            raise _wrong(
                f"reset returns {_kind(state)} without {name}", "a state with obs and prop"
            )
        value = getattr(state, name)
        _check_shape(f"reset's {name}", value, (size,), f"{name}_size = {size}")
        if not jnp.issubdtype(value.dtype, jnp.floating):
            raise _wrong(f"reset's {name} is {value.dtype}", "real numbers")
    if hasattr(state, "clock") and not hasattr(state, "replace"):
        raise _wrong(f"{_kind(state)} has a clock and no replace", "a flax.struct.dataclass")


def _check_step(env: Any, state: Any, found: Any) -> None:
    if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], Outcome)):
        parts = ", ".join(map(_kind, found)) if isinstance(found, tuple) else _kind(found)
        raise _wrong(f"step returns ({parts})", "(state, dynappo.types.Outcome)")
    after, outcome = found
    _check_same("step", after, state)
    for name in SCALARS:
        _check_shape(f"Outcome.{name}", getattr(outcome, name), (), "one number")
    sizes = (("next_obs", env.obs_size, "obs_size"), ("next_prop", env.prop_size, "prop_size"))
    for name, size, meant in sizes:
        _check_shape(f"Outcome.{name}", getattr(outcome, name), (size,), f"{meant} = {size}")
    for name in env.metrics:
        if name not in outcome.metrics:
            raise _wrong(f"Outcome.metrics has no {name!r}", "all names of Env.metrics")
        _check_shape(f"Outcome.metrics[{name!r}]", outcome.metrics[name], (), "one number")


def _check_same(name: str, after: Any, state: Any) -> None:
    """ConfigError unless `after` has the same arrays as reset's `state`."""

    def arrays(tree):
        return {jax.tree_util.keystr(path): x for path, x in jax.tree.leaves_with_path(tree)}

    one, other = arrays(after), arrays(state)
    if jax.tree.structure(after) != jax.tree.structure(state):
        differ = sorted(one.keys() ^ other.keys())
        what = f", they differ in {differ[0]}" if differ else ""
        raise _wrong(f"{name} returns {_kind(after)}{what}", f"a state as reset's, {_kind(state)}")
    for path, x in one.items():
        like = other[path]
        if (x.shape, x.dtype) != (like.shape, like.dtype):
            found, expected = (f"{v.dtype}{list(v.shape)}" for v in (x, like))
            raise _wrong(f"{name} returns a state with {path} {found}", f"{expected} as reset's")


def _check_views(env: Any) -> None:
    if not isinstance(env.views, Views):
        raise _wrong(f"views is {_kind(env.views)}", "a dynappo.types.Views")
    for name, of in env.views._asdict().items():
        columns, size = np.asarray(of), env.obs_size
        if columns.ndim != 1 or columns.dtype.kind not in "iu":
            found = f"{columns.dtype} of shape {columns.shape}"
            raise _wrong(f"views.{name} is {found}", "[K] integers, the columns that it sees")
        if wrong := columns[(columns < 0) | (columns >= size)].tolist():
            raise _wrong(
                f"views.{name} has the column {wrong[0]}", f"0 to {size - 1}, those of obs"
            )


def _check_mirror(env: Any) -> None:
    if env.mirror is None:
        raise _wrong(
            "mirror is None where ppo.symmetry is True",
            "the mirror images of obs and action (types.Mirror), or ppo.symmetry=False",
        )
    pair = env.mirror if isinstance(env.mirror, (tuple, list)) else (env.mirror,)
    if len(pair) != 2 or not all(isinstance(one, Mirror) for one in pair):
        kinds = ", ".join(map(_kind, pair))
        raise _wrong(f"mirror is ({kinds})", "two dynappo.types.Mirror, of obs and of action")
    sizes = env.obs_size, env.action_size
    for name, one, size in zip(("obs", "action"), pair, sizes, strict=True):
        for part in one._fields:
            words = f"the mirror's {part} of {name}"
            _check_shape(words, getattr(one, part), (size,), f"{name}_size")
        index, sign = map(np.asarray, one)
        if index.dtype.kind not in "iu" or (np.sort(index) != np.arange(size)).any():
            words = f"the mirror's index of {name} is {_few(index)}"
            raise _wrong(words, f"each of 0 to {size - 1} once")
        if (abs(sign) != 1).any():
            raise _wrong(f"the mirror's sign of {name} is {_few(sign)}", "each 1 or -1")
        again = (index[index] != np.arange(size)) | (sign[index] != sign)
        if again.any():
            i = int(np.argmax(again))
            found = f"the mirror of {name} takes number {i} to {index[i]}, and that to {index[index[i]]}"
            raise _wrong(found, "its own inverse, with the same sign for both")


def _few(values: np.ndarray) -> str:
    return reprlib.repr(values.tolist())

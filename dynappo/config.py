"""From a config file to what the compiled program takes: load, override, validate, split.

`Static` (ints, strings, bools) is hashable and part of the compiled program; `Hyper` (floats) is a
pytree argument, so a changed learning rate costs no compilation and a sweep is a `jax.vmap` over
its leaves. Both are nested named tuples with the config's own names: `hyper.ppo.clip_epsilon`.

Why not absl's `config_flags`: it answers a missing file with an object that fails later, and an
unknown field with a traceback. Every error here is a `ConfigError` of one line, raised before JAX
is imported.
"""

from __future__ import annotations

import ast
import functools
import json
import math
import pathlib
import runpy
from collections import namedtuple
from typing import Any

from ml_collections import config_dict

from dynappo import schedule

PACKAGE = pathlib.Path(__file__).resolve().parent
# What task.formulation decides where the field itself is None (sources: configs/README.md).
FORMULATIONS = {
    "isaaclab": dict(tracking_std=0.5, air_time="touchdown"),
    "paper_text": dict(tracking_std=1.0, air_time="indicator"),
}
CHOICES = {
    "physics.impl": ("auto", "jax", "warp"),
    "physics.contacts": ("feet", "full"),
    "run.device": ("auto", "cpu", "gpu"),
    "task.formulation": tuple(FORMULATIONS),
    "task.air_time": ("touchdown", "indicator"),
    "model.precision": ("highest", "tf32", "bfloat16"),
    "ppo.precision": ("highest", "tf32"),
    "model.activation": ("elu", "relu", "tanh", "swish"),
    "ppo.activation": ("elu", "relu", "tanh", "swish"),
}
POSITIVE = (
    "run.num_seeds run.num_iterations run.log_every rollout.num_envs rollout.horizon model.epochs "
    "model.minibatches model.huber_delta model.learning_rate ppo.epochs ppo.minibatches "
    "ppo.shuffle_blocks ppo.init_std ppo.min_std ppo.learning_rate ppo.desired_kl "
    "ppo.clip_epsilon ppo.max_grad_norm task.episode_length task.tracking_std "
    "task.action_scale task.effort_limit task.saturation_effort task.velocity_limit "
    "physics.timestep physics.substeps physics.iterations physics.ls_iterations"
).split()


class ConfigError(ValueError):
    """A setting that cannot be run; the message names the field, what was found and expected."""


def find(folder: str, name: str) -> pathlib.Path | None:
    """`folder/name` beside the sources, or inside the installed package; None if in neither."""
    for root in (PACKAGE.parent, PACKAGE):
        if (root / folder / name).exists():
            return root / folder / name
    return None


def load(spec: str) -> config_dict.ConfigDict:
    """The config of `FILE.py` or `FILE.py:VARIANT`, looked up in the working directory first."""
    name, _, variant = spec.partition(":")
    path = pathlib.Path(name)
    if not path.is_file():
        path = find("configs", path.name) or path
    if not path.is_file():
        raise ConfigError(f"--config: no file {name!r} here or among dynappo's own configs")
    get_config = runpy.run_path(str(path)).get("get_config")
    if get_config is None:
        raise ConfigError(f"--config: {path} defines no function get_config(variant)")
    try:
        return get_config(variant)
    except ValueError as error:
        raise ConfigError(f"--config={spec}: {error}") from None


def override(config: config_dict.ConfigDict, field: str, text: str) -> None:
    """Set `field` (dotted) from the text of a command line, with the type of its default."""
    group, _, leaf = field.rpartition(".")
    try:
        node = functools.reduce(lambda c, k: c[k], filter(None, group.split(".")), config)
        old = node[leaf]
    except (KeyError, TypeError, AttributeError):
        raise ConfigError(f"--config.{field}: no such field; {_near(config, field)}") from None
    if isinstance(old, config_dict.ConfigDict):
        raise ConfigError(f"--config.{field} is a group, expected one of {', '.join(old)}")
    kind = node.get_type(leaf)
    try:
        value = text if kind is str else ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        raise ConfigError(_wrong(field, text, old, kind)) from None
    if isinstance(old, tuple):
        value = _tuple(old, value)
    elif kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ConfigError(_wrong(field, text, old, kind))
    node[leaf] = value


def _tuple(old: tuple, value) -> tuple | None:
    """`value` with the element type of `old`, and its length unless those are sizes; else None."""
    if not isinstance(value, (tuple, list)) or not value:
        return None
    if type(old[0]) is float:
        numbers = all(type(v) in (int, float) for v in value)
        return tuple(map(float, value)) if numbers and len(value) == len(old) else None
    return tuple(value) if all(type(v) is int and v > 0 for v in value) else None


def _wrong(field, text, old, kind):
    what = f"tuple like {old}" if isinstance(old, tuple) else kind.__name__
    return f"--config.{field}={text!r}: expected {what}"


def _near(config, field):
    import difflib

    close = difflib.get_close_matches(field, _flat(config), 1, 0.4)
    return f"did you mean {close[0]}?" if close else "configs/default.py lists all fields"


def _flat(config, prefix="") -> dict[str, Any]:
    out = {}
    for name, value in config.items():
        if hasattr(value, "items"):
            out |= _flat(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def validate(config: config_dict.ConfigDict) -> config_dict.FrozenConfigDict:
    """Resolve `task.formulation` and check every number that can be wrong; returns it frozen."""
    config = config_dict.ConfigDict(config).copy_and_resolve_references()
    formulation = config.task.formulation
    if formulation not in FORMULATIONS:
        raise ConfigError(
            f"task.formulation is {formulation!r}, expected one of {', '.join(FORMULATIONS)}"
        )
    for name, value in FORMULATIONS[formulation].items():
        if config.task[name] is None:
            config.task[name] = value
    config.run.log_every = min(config.run.log_every, config.run.num_iterations)
    _settle_tuples(config)
    flat = _flat(config)
    for field, choices in CHOICES.items():
        if flat[field] not in choices:
            raise ConfigError(f"{field} is {flat[field]!r}, expected one of {', '.join(choices)}")
    for field in POSITIVE:
        if not flat[field] > 0:
            raise ConfigError(f"{field} is {flat[field]}, expected more than 0")
    for field, value in flat.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if any(isinstance(v, float) and not math.isfinite(v) for v in numbers):
            raise ConfigError(f"{field} is {value}, expected finite numbers")
        is_range = len(numbers) == 2 and type(numbers[0]) is float
        if is_range and numbers[0] > numbers[-1]:
            raise ConfigError(f"{field} is {value}, expected (low, high) with low <= high")
    for field in ("run.eval_envs", "run.video_seconds", "task.push.velocity"):
        if flat[field] < 0:
            raise ConfigError(f"{field} is {flat[field]}, expected 0 or more")
    for field in ("ppo.gamma", "ppo.lambda_", "model.stats_decay"):
        if not 0 <= flat[field] <= 1:
            raise ConfigError(f"{field} is {flat[field]}, expected a number from 0 to 1")
    if config.ppo.min_learning_rate > config.ppo.max_learning_rate:
        raise ConfigError(
            f"ppo.min_learning_rate is {config.ppo.min_learning_rate}, expected at most "
            f"ppo.max_learning_rate = {config.ppo.max_learning_rate}"
        )
    _validate_schedule(config)
    _validate_sizes(config)
    if not find("robots", f"{config.robot}/{config.robot}.xml"):
        root = find("robots", "")
        known = sorted(p.name for p in root.iterdir() if p.is_dir()) if root else []
        raise ConfigError(f"robot is {config.robot!r}, expected one of {', '.join(known)}")
    return config_dict.FrozenConfigDict(config)


def _settle_tuples(config, prefix=""):
    """Layer sizes become ints above 0, every other tuple floats; in place."""
    for name, value in config.items():
        if isinstance(value, config_dict.ConfigDict):
            _settle_tuples(value, f"{prefix}{name}.")
        elif isinstance(value, (tuple, list)):
            sizes = name == "hidden"
            settled = _tuple((1,) if sizes else (0.0,) * len(value), value)
            if settled is None:
                what = "one or more sizes above 0" if sizes else "numbers"
                raise ConfigError(f"{prefix}{name} is {value}, expected {what}")
            with config.ignore_type():
                config[name] = settled


def _validate_schedule(config):
    s, horizon = config.schedule, config.rollout.horizon
    if min(s.start_steps, s.end_steps) < 0:
        raise ConfigError(
            f"schedule.start_steps, end_steps are {s.start_steps}, {s.end_steps}, expected 0 or more"
        )
    if s.end_steps < s.start_steps:
        raise ConfigError(
            f"schedule.end_steps is {s.end_steps}, expected at least "
            f"schedule.start_steps = {s.start_steps}"
        )
    if s.end_iteration < s.start_iteration:
        raise ConfigError(
            f"schedule.end_iteration is {s.end_iteration}, expected at least "
            f"schedule.start_iteration = {s.start_iteration}"
        )
    if s.end_steps >= horizon:
        raise ConfigError(
            f"schedule.end_steps is {s.end_steps}, expected less than rollout.horizon = {horizon}: "
            "a rollout needs at least one real row"
        )


def _validate_sizes(config):
    run, rollout, ppo = config.run, config.rollout, config.ppo
    rows = rollout.num_envs * rollout.horizon
    if rollout.num_envs % ppo.shuffle_blocks:
        raise ConfigError(
            f"rollout.num_envs is {rollout.num_envs}, expected a multiple of "
            f"ppo.shuffle_blocks = {ppo.shuffle_blocks}"
        )
    if rows // ppo.shuffle_blocks % ppo.minibatches:
        raise ConfigError(
            f"rollout.num_envs x rollout.horizon / ppo.shuffle_blocks is "
            f"{rows // ppo.shuffle_blocks}, expected a multiple of ppo.minibatches = "
            f"{ppo.minibatches}"
        )
    for name in ("checkpoint_every", "eval_every", "num_iterations"):
        if run[name] < 0 or (run[name] % run.log_every and run[name] <= run.num_iterations):
            raise ConfigError(
                f"run.{name} is {run[name]}, expected a multiple of run.log_every = {run.log_every}"
            )
    late = config.model.late_epochs
    if late is not None and late < 0:
        raise ConfigError(f"model.late_epochs is {late}, expected 0 or more")
    if schedule.uses_model(config):
        if rows % config.model.minibatches:
            raise ConfigError(
                f"rollout.num_envs x rollout.horizon is {rows}, expected a multiple of "
                f"model.minibatches = {config.model.minibatches}"
            )
        fewest = int(schedule.columns(config)["n_real"].min()) * rollout.num_envs
        if fewest < rows // config.model.minibatches:
            raise ConfigError(
                f"model.minibatches is {config.model.minibatches}: a minibatch has "
                f"{rows // config.model.minibatches} rows, expected at most the {fewest} real rows "
                "of the longest tail; raise model.minibatches or lower schedule.end_steps"
            )


def split(config) -> tuple[Any, Any]:
    """`(static, hyper)` of a validated config; floats go to `hyper`, all else to `static`."""
    return _take(config, "Static", False), _take(config, "Hyper", True)


def _take(config, name, floats):
    fields = {}
    for key, value in config.items():
        if hasattr(value, "items"):
            value = _take(value, f"{name}_{key}", floats)
            if value._fields:
                fields[key] = value
        elif (type(value[0] if isinstance(value, tuple) else value) is float) == floats:
            fields[key] = value
    return _record(name, tuple(fields))(**fields)


@functools.cache
def _record(name: str, fields: tuple[str, ...]):
    """One class per set of fields, so that two splits of equal configs have equal tree types."""
    return namedtuple(name, fields)


def to_json(config) -> str:
    """The config as indented JSON, as `config.json` holds it."""
    return json.dumps(config.to_dict(), indent=2)


def difference(old: str, new: str) -> str:
    """The first field in which two `to_json` texts differ, as "ppo.epochs 5 there, 4 here"; or ""."""

    try:
        before = _flat(json.loads(old))
    except (ValueError, AttributeError):
        return "its config.json cannot be read"
    after = _flat(json.loads(new))
    for name in before | after:
        if before.get(name) != after.get(name):
            return f"{name} {before.get(name)} there, {after.get(name)} here"
    return ""

"""Which settings can be run: every number that can be wrong is checked before JAX is imported."""

from __future__ import annotations

import math
import pathlib
from typing import Any

from ml_collections import config_dict

from dynappo import schedule

PACKAGE = pathlib.Path(__file__).resolve().parent
# What task.formulation decides where the field itself is None (sources: configs/README.md).
PAPER_TASK = dict(
    heading=False,
    resample_steps=0,
    standing=0.0,
    termination="parts",
    undesired="parts",
    remember_ground=False,
)
FORMULATIONS = {
    "isaaclab": dict(tracking_std=0.5, air_time="touchdown", **PAPER_TASK),
    "paper_text": dict(tracking_std=1.0, air_time="indicator", **PAPER_TASK),
    "isaaclab_exact": dict(
        tracking_std=0.5,
        air_time="touchdown",
        heading=True,
        resample_steps=500,
        standing=0.02,
        termination="base",
        undesired="thighs",
        remember_ground=True,
    ),
}
CHOICES = {
    "physics.impl": ("auto", "jax", "warp"),
    "physics.contacts": ("feet", "full"),
    "run.device": ("auto", "cpu", "gpu"),
    "task.formulation": tuple(FORMULATIONS),
    "task.air_time": ("touchdown", "indicator"),
    "task.termination": ("parts", "base"),
    "task.undesired": ("parts", "thighs"),
    "model.precision": ("highest", "tf32", "bfloat16"),
    "ppo.precision": ("highest", "tf32", "bfloat16"),
    "model.activation": ("elu", "relu", "tanh", "swish"),
    "ppo.activation": ("elu", "relu", "tanh", "swish"),
}
POSITIVE = (
    "run.num_seeds run.mesh_seed run.mesh_env run.num_iterations run.log_every rollout.num_envs "
    "rollout.horizon schedule.max_error model.epochs model.minibatches model.ensemble model.unroll "
    "model.huber_delta model.learning_rate ppo.epochs ppo.minibatches "
    "ppo.shuffle_blocks ppo.init_std ppo.min_std ppo.learning_rate ppo.desired_kl "
    "ppo.clip_epsilon ppo.max_grad_norm task.episode_length task.tracking_std "
    "task.action_scale task.effort_limit task.saturation_effort task.velocity_limit "
    "physics.timestep physics.substeps physics.iterations physics.ls_iterations"
).split()


class ConfigError(ValueError):
    """A setting that cannot be run; the message names the field, what was found and expected."""


def roots() -> tuple[pathlib.Path, ...]:
    """Where configs/ and robots/ are looked for: working directory, clone, installed package."""
    return pathlib.Path.cwd(), PACKAGE.parent, PACKAGE


def find(folder: str, name: str) -> pathlib.Path | None:
    """The first `folder/name` of `roots`; None if there is none."""
    return next((root / folder / name for root in roots() if (root / folder / name).exists()), None)


def robots() -> list[str]:
    """Names of all robots in the folders robots/ of `roots`."""
    files = [path for root in roots() for path in root.glob("robots/*/*.xml")]
    return sorted({path.stem for path in files if path.stem == path.parent.name})


def flat(config, prefix="") -> dict[str, Any]:
    out = {}
    for name, value in config.items():
        if hasattr(value, "items"):
            out |= flat(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def settle(old: tuple, value) -> tuple | None:
    """`value` with the element type of `old`, and its length unless those are sizes; else None."""
    if not isinstance(value, (tuple, list)) or not value:
        return None
    if type(old[0]) is float:
        numbers = all(type(v) in (int, float) for v in value)
        return tuple(map(float, value)) if numbers and len(value) == len(old) else None
    return tuple(value) if all(type(v) is int and v > 0 for v in value) else None


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
    fields = flat(config)
    for field, choices in CHOICES.items():
        if fields[field] not in choices:
            raise ConfigError(f"{field} is {fields[field]!r}, expected one of {', '.join(choices)}")
    for field in POSITIVE:
        if not fields[field] > 0:
            raise ConfigError(f"{field} is {fields[field]}, expected more than 0")
    for field, value in fields.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if any(isinstance(v, float) and not math.isfinite(v) for v in numbers):
            raise ConfigError(f"{field} is {value}, expected finite numbers")
        is_range = len(numbers) == 2 and type(numbers[0]) is float
        if is_range and numbers[0] > numbers[-1]:
            raise ConfigError(f"{field} is {value}, expected (low, high) with low <= high")
    counts = (
        "run.eval_envs run.video_seconds ppo.tail_weight ppo.first_order_steps "
        "ppo.first_order_weight model.history task.push.velocity task.resample_steps"
    )
    for field in counts.split():
        if fields[field] < 0:
            raise ConfigError(f"{field} is {fields[field]}, expected 0 or more")
    if not -(2**31) <= config.run.seed <= 2**31 - config.run.num_seeds:
        raise ConfigError(f"run.seed is {config.run.seed}, expected an integer of 32 bits")
    if config.task.termination == "base" and config.physics.contacts != "full":
        raise ConfigError(
            f"physics.contacts is {config.physics.contacts}, expected full where only the base ends an "
            "episode (task.termination=base, task.formulation=isaaclab_exact): knees would sink "
            "through the floor; set --config.physics.contacts=full"
        )
    if config.run.time_phases and config.run.num_seeds > 1:
        raise ConfigError(
            f"run.time_phases is True with run.num_seeds = {config.run.num_seeds}: "
            "phases are measured on one seed only"
        )
    if config.run.time_phases and config.schedule.by_error:
        raise ConfigError(
            "run.time_phases is True with schedule.by_error = True: phases are differences between "
            "numbers of rows, which the model's error would change"
        )
    for field in ("ppo.gamma", "ppo.lambda_", "model.stats_decay", "task.standing"):
        if not 0 <= fields[field] <= 1:
            raise ConfigError(f"{field} is {fields[field]}, expected a number from 0 to 1")
    if config.ppo.min_learning_rate > config.ppo.max_learning_rate:
        raise ConfigError(
            f"ppo.min_learning_rate is {config.ppo.min_learning_rate}, expected at most "
            f"ppo.max_learning_rate = {config.ppo.max_learning_rate}"
        )
    _validate_schedule(config)
    _validate_tail(config)
    _validate_sizes(config)
    _validate_mesh(config)
    if not find("robots", f"{config.robot}/{config.robot}.xml"):
        raise ConfigError(f"robot is {config.robot!r}, expected one of {', '.join(robots())}")
    return config_dict.FrozenConfigDict(config)


def _settle_tuples(config, prefix=""):
    """Layer sizes become ints above 0, every other tuple floats; in place."""
    for name, value in config.items():
        if isinstance(value, config_dict.ConfigDict):
            _settle_tuples(value, f"{prefix}{name}.")
        elif isinstance(value, (tuple, list)):
            sizes = name == "hidden"
            settled = settle((1,) if sizes else (0.0,) * len(value), value)
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


def _validate_tail(config):
    model = config.model
    if model.private and not model.clean:
        raise ConfigError(
            "model.private is True, expected model.clean=True too: it goes with the state without noise"
        )
    if model.history and model.unroll > 1:
        raise ConfigError(
            f"model.history is {model.history}, expected 0 with model.unroll = {model.unroll}: an unrolled "
            "loss needs rows that follow each other"
        )
    if config.ppo.first_order_steps and not schedule.uses_model(config):
        raise ConfigError(
            f"ppo.first_order_steps is {config.ppo.first_order_steps}, expected 0 without a tail "
            "(schedule.end_steps = 0): there is no model to differentiate"
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
        if rollout.horizon % config.model.minibatches:
            raise ConfigError(
                f"rollout.horizon is {rollout.horizon}, expected a multiple of model.minibatches = "
                f"{config.model.minibatches}: a minibatch has as many rows of every robot"
            )
        drawn = rollout.horizon // config.model.minibatches
        fewest = int(schedule.columns(config)["n_real"].min())
        if fewest < config.model.unroll:
            raise ConfigError(
                f"model.unroll is {config.model.unroll}, expected at most the {fewest} real rows of "
                "the longest tail"
            )
        if fewest < drawn:
            raise ConfigError(
                f"model.minibatches is {config.model.minibatches}: a minibatch has {drawn} rows of "
                f"every robot, expected at most the {fewest} real rows of the longest tail; raise "
                "model.minibatches or lower schedule.end_steps"
            )


def _validate_mesh(config):
    run, envs = config.run, config.run.mesh_env
    for field, value, over, devices in (
        ("run.num_seeds", run.num_seeds, "run.mesh_seed", run.mesh_seed),
        ("rollout.num_envs", config.rollout.num_envs, "run.mesh_env", envs),
        ("ppo.shuffle_blocks", config.ppo.shuffle_blocks, "run.mesh_env", envs),
        ("run.eval_envs", run.eval_envs, "run.mesh_env", envs),
    ):
        if value % devices:
            raise ConfigError(f"{field} is {value}, expected a multiple of {over} = {devices}")

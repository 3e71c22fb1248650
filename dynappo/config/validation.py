"""Which settings can run: checks every number that can be wrong, before JAX is imported."""

from __future__ import annotations

import math
from typing import Any

from ml_collections import config_dict

from dynappo import schedule
from dynappo.config.fields import ConfigError, flat, typed
from dynappo.config.files import find, robots

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
    "physics.impl": ("auto", "jax", "warp", "c"),
    "physics.contacts": ("feet", "full"),
    "run.device": ("auto", "cpu", "gpu"),
    "task.formulation": tuple(FORMULATIONS),
    "task.air_time": ("touchdown", "indicator"),
    "task.termination": ("parts", "base"),
    "task.undesired": ("parts", "thighs"),
    "task.observation": ("full", "onboard"),
    "task.actuator": ("pd", "lag"),
    "ppo.critic": ("obs", "state"),
    "model.precision": ("highest", "tf32", "bfloat16"),
    "ppo.precision": ("highest", "tf32", "bfloat16"),
    "model.activation": ("elu", "relu", "tanh", "swish"),
    "ppo.activation": ("elu", "relu", "tanh", "swish"),
}
INTEGER = "an integer of 32 bits"  # as the compiled program counts
# (what is expected, whether a number is that, fields); of a tuple it holds for each number. The upper
# bounds are far above what is of use: beyond them memory, an int32 or a lifetime does not suffice
RANGES = (
    (
        "more than 0",
        lambda v: v > 0,
        "run.num_seeds run.mesh_seed run.mesh_env run.num_iterations run.log_every rollout.num_envs "
        "rollout.horizon schedule.rounds schedule.late_rounds "
        "model.epochs model.minibatches model.huber_delta model.learning_rate "
        "ppo.epochs ppo.minibatches ppo.shuffle_blocks ppo.init_std ppo.min_std ppo.learning_rate "
        "ppo.max_learning_rate ppo.desired_kl ppo.late_kl ppo.clip_epsilon ppo.max_grad_norm "
        "task.episode_length task.tracking_std task.action_scale task.effort_limit task.saturation_effort "
        "task.velocity_limit task.history physics.substeps physics.iterations "
        "physics.ls_iterations",
    ),
    (
        "0 or more",
        lambda v: v >= 0,
        "run.checkpoint_every run.eval_every run.eval_envs run.eval_steps run.video_seconds "
        "schedule.start_steps schedule.end_steps schedule.last_iteration "
        "schedule.late_from schedule.late_steps model.late_epochs "
        "ppo.min_learning_rate ppo.value_coef task.push.velocity task.push.interval task.resample_steps "
        "task.kp task.kd task.noise.joint_pos task.noise.joint_vel task.noise.gravity "
        "task.noise.linear_velocity task.noise.angular_velocity task.reset.foot_clearance "
        "task.reset.position task.reset.yaw task.reset.velocity task.randomize.base_com "
        "task.randomize.friction task.randomize.kp_scale task.randomize.kd_scale "
        "task.randomize.strength task.randomize.armature task.randomize.joint_friction task.randomize.delay "
        "task.randomize.lag task.randomize.encoder_bias task.randomize.imu_tilt physics.threads",
    ),
    (
        "a number from 0 to 1",
        lambda v: 0 <= v <= 1,
        "ppo.gamma ppo.lambda_ model.stats_decay task.standing task.start_anew task.keep_command "
        "task.reset.soft_limit",
    ),
    ("a number from 0.0001 to 0.1", lambda v: 1e-4 <= v <= 0.1, "physics.timestep"),
    (
        "a number from -100 to 100",
        lambda v: -100 <= v <= 100,
        "task.action_scale task.command_x task.command_y task.command_yaw task.heading_gain "
        "task.reset.spawn_height task.reset.foot_clearance task.reset.yaw task.reset.velocity "
        "task.reset.joint_scale task.push.velocity",
    ),
    ("at most 100", lambda v: v <= 100, "task.history"),
    ("at most 600", lambda v: v <= 600, "run.video_seconds"),
    ("at most 100,000", lambda v: v <= 1e5, "task.kp task.kd"),
    (
        "at most 1,000",
        lambda v: v <= 1_000,
        "physics.substeps physics.threads physics.iterations physics.ls_iterations schedule.rounds",
    ),
    (
        "at most 10,000",
        lambda v: v <= 10_000,
        "run.num_seeds rollout.horizon model.hidden model.epochs model.late_epochs ppo.hidden "
        "ppo.epochs",
    ),
    (
        "at most 1,000,000",
        lambda v: v <= 1_000_000,
        "run.num_iterations run.eval_envs task.resample_steps task.push.interval",
    ),
    ("at most 100,000", lambda v: v <= 100_000, "run.eval_steps task.episode_length"),
    ("at most 100,000,000", lambda v: v <= 100_000_000, "rollout.num_envs"),
)
LAYERS = 32  # of a network, at most
AT_LEAST = (  # field, another that it must not be below
    ("schedule.end_steps", "schedule.start_steps"),
    ("schedule.end_iteration", "schedule.start_iteration"),
    ("ppo.max_learning_rate", "ppo.min_learning_rate"),
)
MULTIPLES = (  # field, another that must divide it
    ("rollout.num_envs", "ppo.shuffle_blocks"),
    ("run.num_seeds", "run.mesh_seed"),
    ("rollout.num_envs", "run.mesh_env"),
    ("ppo.shuffle_blocks", "run.mesh_env"),
    ("run.eval_envs", "run.mesh_env"),
)


def validate(
    config: config_dict.ConfigDict, robot_here: bool = True
) -> config_dict.FrozenConfigDict:
    """Resolve `task.formulation` and check every number that can be wrong; returns it frozen.

    `robot_here`: also that robots/ has its robot, which a policy may carry instead.
    """
    config = typed(config)
    formulation = config.task.formulation
    _expect(formulation in FORMULATIONS, "task.formulation", formulation, _one_of(FORMULATIONS))
    for name, value in FORMULATIONS[formulation].items():
        if config.task[name] is None:
            config.task[name] = value
    config.run.log_every = min(config.run.log_every, config.run.num_iterations)
    fields = flat(config)
    _check_fields(fields)
    _check_pairs(config, fields)
    _check_hardware(config)
    if schedule.uses_model(config):
        _check_model(config)
    _expect(
        # "" is that of an environment of one's own (program/environment.py)
        not (robot_here and config.robot) or find("robots", f"{config.robot}/{config.robot}.xml"),
        "robot",
        config.robot,
        _one_of(robots()),
    )
    return config_dict.FrozenConfigDict(config)


def _expect(ok, field: str, value, expected: str) -> None:
    """Raise the ConfigError of a field: what was found, and what was expected."""
    if not ok:
        shown = repr(value) if isinstance(value, str) else value
        raise ConfigError(f"{field} is {shown}, expected {expected}")


def _one_of(choices) -> str:
    return f"one of {', '.join(choices)}"


def _check_fields(fields: dict[str, Any]) -> None:
    """Each field by itself."""
    for field, choices in CHOICES.items():
        _expect(fields[field] in choices, field, fields[field], _one_of(choices))
    for expected, right, names in RANGES:
        for field in names.split():
            value = fields[field]
            numbers = value if isinstance(value, tuple) else (value,)
            _expect(value is None or all(map(right, numbers)), field, value, expected)
    for field, value in fields.items():
        numbers = value if isinstance(value, tuple) else (value,)
        for v in numbers:
            if isinstance(v, float):
                _expect(math.isfinite(v), field, value, "finite numbers")
                _expect(
                    v == 0 or 1e-12 <= abs(v) <= 1e9, field, value, "0, or 1e-12 to 1e9 in size"
                )
            _expect(type(v) is not int or abs(v) < 2**31, field, value, INTEGER)
        is_range = len(numbers) == 2 and type(numbers[0]) is float
        ordered = not is_range or numbers[0] <= numbers[-1]
        _expect(ordered, field, value, "(low, high) with low <= high")


def _check_pairs(config, fields: dict[str, Any]) -> None:
    """Fields that must fit each other."""
    for field, other in AT_LEAST:
        expected = f"at least {other} = {fields[other]}"
        _expect(fields[field] >= fields[other], field, fields[field], expected)
    for field, other in MULTIPLES:
        expected = f"a multiple of {other} = {fields[other]}"
        _expect(fields[field] % fields[other] == 0, field, fields[field], expected)
    run, rollout, ppo = config.run, config.rollout, config.ppo
    for name in ("checkpoint_every", "eval_every", "num_iterations"):
        fits = run[name] % run.log_every == 0 or run[name] > run.num_iterations
        _expect(fits, f"run.{name}", run[name], f"a multiple of run.log_every = {run.log_every}")
    sensible = run.eval_envs or not run.eval_every
    _expect(sensible, "run.eval_every", run.eval_every, "0 where run.eval_envs is 0")
    _expect(run.seed <= 2**31 - run.num_seeds, "run.seed", run.seed, INTEGER)
    rows = rollout.num_envs * rollout.horizon
    _expect(rows < 2**31, "rollout.num_envs x rollout.horizon", rows, INTEGER)
    rows = rollout.num_envs * rollout.horizon // ppo.shuffle_blocks
    _expect(
        rows % ppo.minibatches == 0,
        "rollout.num_envs x rollout.horizon / ppo.shuffle_blocks",
        rows,
        f"a multiple of ppo.minibatches = {ppo.minibatches}",
    )
    for name in ("model.hidden", "ppo.hidden"):
        _expect(len(fields[name]) <= LAYERS, name, fields[name], f"at most {LAYERS} layers")
    seconds = config.physics.substeps * config.physics.timestep
    text = "a control step of 0.001 to 1 s"
    _expect(0.001 <= seconds <= 1, "physics.substeps x physics.timestep", seconds, text)
    halves = not ppo.symmetry or all(size % 2 == 0 for size in ppo.hidden)
    _expect(halves, "ppo.hidden", ppo.hidden, "even sizes where ppo.symmetry is True")
    _expect(
        config.schedule.end_steps < rollout.horizon,
        "schedule.end_steps",
        config.schedule.end_steps,
        f"less than rollout.horizon = {rollout.horizon}: a rollout needs at least one real row",
    )
    s = config.schedule
    text = f"at most schedule.end_steps = {s.end_steps}"
    _expect((s.late_steps or 0) <= s.end_steps, "schedule.late_steps", s.late_steps, text)
    text = f"at most schedule.rounds = {s.rounds}"
    _expect((s.late_rounds or 1) <= s.rounds, "schedule.late_rounds", s.late_rounds, text)
    text = f"at most 1 - task.start_anew = {1 - config.task.start_anew:g}"
    fits = config.task.start_anew + config.task.keep_command <= 1 + 1e-9
    _expect(fits, "task.keep_command", config.task.keep_command, text)
    _expect(
        config.task.termination == "parts" or config.physics.contacts == "full",
        "physics.contacts",
        config.physics.contacts,
        "full where only the base ends an episode (task.termination=base, "
        "task.formulation=isaaclab_exact): knees would sink through the floor; set "
        "--config.physics.contacts=full",
    )


def _check_hardware(config) -> None:
    """What of `task.randomize` the observation, the actuator and the engine can have."""
    task, ranges = config.task, config.task.randomize
    seconds = config.physics.substeps * config.physics.timestep
    late, longest = ranges.delay[1], 2 * seconds
    text = f"at most two control steps, {longest:g} s"
    _expect(late <= longest + 1e-9, "task.randomize.delay", ranges.delay, text)
    for name in ("encoder_bias", "imu_tilt"):
        fits = task.observation == "onboard" or not ranges[name]
        text = "0 where task.observation is full: its 48 numbers are those of the state"
        _expect(fits, f"task.randomize.{name}", ranges[name], text)
    if task.actuator == "pd":
        text = "(0, 0) where task.actuator is pd; set task.actuator=lag"
        _expect(tuple(ranges.lag) == (0, 0), "task.randomize.lag", ranges.lag, text)
    else:
        text = "above 0 where task.actuator is lag"
        _expect(ranges.lag[1] > 0, "task.randomize.lag", ranges.lag, text)
        _expect(config.physics.impl != "c", "physics.impl", "c", "jax or warp where torques lag")


def _check_model(config) -> None:
    """Whether the value function can see a tail's states, and a minibatch of the model has real rows
    enough."""
    told = config.ppo.critic == "obs" or config.model.clean
    text = "obs where model.clean is False: a tail then has no exact state; or set model.clean=True"
    _expect(told, "ppo.critic", config.ppo.critic, text)
    horizon, minibatches = config.rollout.horizon, config.model.minibatches
    expected = f"a multiple of model.minibatches = {minibatches}: a minibatch has as many rows of every robot"
    _expect(horizon % minibatches == 0, "rollout.horizon", horizon, expected)
    drawn, fewest = horizon // minibatches, int(schedule.columns(config)["n_real"].min())
    if fewest < drawn:
        raise ConfigError(
            f"model.minibatches is {minibatches}: a minibatch has {drawn} rows of every robot, expected at "
            f"most the {fewest} real rows of the longest tail; raise model.minibatches or lower "
            "schedule.end_steps"
        )

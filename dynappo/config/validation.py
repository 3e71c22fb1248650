"""Which settings can run together, without JAX. `fields` says what one field may hold."""

from __future__ import annotations

import math
from typing import Any

from ml_collections import config_dict

from dynappo import schedule
from dynappo.config.fields import ConfigError, check, copied, expect, flat
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
    """The config frozen, with `task.formulation` resolved; ConfigError where it cannot run.

    `robot_here`: also that robots/ has its robot, which a policy may carry instead.
    """
    config = copied(config)
    for name, value in flat(config).items():
        check(name, value)
    for name, value in FORMULATIONS[config.task.formulation].items():
        if config.task[name] is None:
            config.task[name] = value
    config.run.log_every = min(config.run.log_every, config.run.num_iterations)
    _check_pairs(config, flat(config))
    _check_hardware(config)
    check_tiles(config.task.tiles)
    text = "a file that has been read: --config.task.terms=FILE, or terms.use(config, terms.read(FILE))"
    expect(
        bool(config.task.terms) == bool(config.task.terms_hash),
        "task.terms",
        config.task.terms,
        text,
    )
    for name, none in (("scan", "none"), ("ground_in_tail", "known")):
        value, text = config.task[name], f"{none} where task.terrain is flat"
        expect(config.task.terrain == "rough" or value == none, f"task.{name}", value, text)
    stays = config.task.carry_on
    text = "False where task.terrain is rough: who has left its tile and stays would time out in every row"
    expect(config.task.terrain == "flat" or not stays, "task.carry_on", stays, text)
    own = config.task.tiles.map
    text = "'' where task.terrain is flat; rough ground: --config=ROBOT:rough"
    expect(config.task.terrain == "rough" or not own, "task.tiles.map", own, text)
    text = "'' where no robot of dynappo's is trained: terms are of its velocity task"
    expect(bool(config.robot) or not config.task.terms, "task.terms", config.task.terms, text)
    if schedule.uses_model(config):
        _check_model(config)
    _check_logs(config)
    expect(not (config.env and config.robot), "env", config.env, "'' where a robot is named")
    expect(
        # "" is that of another environment (program/environment.py)
        not (robot_here and config.robot) or find("robots", f"{config.robot}/{config.robot}.xml"),
        "robot",
        config.robot,
        f"one of {', '.join(robots())}",
    )
    return config_dict.FrozenConfigDict(config)


def _check_pairs(config, fields: dict[str, Any]) -> None:
    """Fields that must fit each other."""
    for field, other in AT_LEAST:
        expected = f"at least {other} = {fields[other]}"
        expect(fields[field] >= fields[other], field, fields[field], expected)
    for field, other in MULTIPLES:
        expected = f"a multiple of {other} = {fields[other]}"
        expect(fields[field] % fields[other] == 0, field, fields[field], expected)
    run, rollout, ppo = config.run, config.rollout, config.ppo
    for name in ("checkpoint_every", "eval_every", "num_iterations"):
        fits = run[name] % run.log_every == 0 or run[name] > run.num_iterations
        expect(fits, f"run.{name}", run[name], f"a multiple of run.log_every = {run.log_every}")
    sensible = run.eval_envs or not run.eval_every
    expect(sensible, "run.eval_every", run.eval_every, "0 where run.eval_envs is 0")
    expect(run.seed <= 2**31 - run.num_seeds, "run.seed", run.seed, "an integer of 32 bits")
    rows = rollout.num_envs * rollout.horizon
    expect(rows < 2**31, "rollout.num_envs x rollout.horizon", rows, "an integer of 32 bits")
    rows = rollout.num_envs * rollout.horizon // ppo.shuffle_blocks
    expect(
        rows % ppo.minibatches == 0,
        "rollout.num_envs x rollout.horizon / ppo.shuffle_blocks",
        rows,
        f"a multiple of ppo.minibatches = {ppo.minibatches}",
    )
    for name in ("model.hidden", "ppo.hidden", "ppo.critic_hidden"):
        fits = fields[name] is None or len(fields[name]) <= LAYERS
        expect(fits, name, fields[name], f"at most {LAYERS} layers")
    seconds = config.physics.substeps * config.physics.timestep
    text = "a control step of 0.001 to 1 s"
    expect(0.001 <= seconds <= 1, "physics.substeps x physics.timestep", seconds, text)
    for name in ("ppo.hidden", "ppo.critic_hidden"):
        halves = not ppo.symmetry or all(size % 2 == 0 for size in fields[name] or ())
        expect(halves, name, fields[name], "even sizes where ppo.symmetry is True")
    expect(
        config.schedule.end_steps < rollout.horizon,
        "schedule.end_steps",
        config.schedule.end_steps,
        f"less than rollout.horizon = {rollout.horizon}: a rollout needs at least one real row",
    )
    text = "False where ppo.normalize is True, which scales each input by itself"
    expect(not (ppo.normalize and ppo.scale_inputs), "ppo.scale_inputs", ppo.scale_inputs, text)
    text = "0 where ppo.normalize is True, whose moments move the policy in every iteration"
    expect(not (ppo.normalize and ppo.value_first), "ppo.value_first", ppo.value_first, text)
    late_from, late_kl = config.schedule.late_from, config.ppo.late_kl
    text = f"an iteration where ppo.late_kl is {late_kl:g}: it holds after that"
    expect(late_from is not None or late_kl == 1, "schedule.late_from", late_from, text)
    text = f"at most 1 - task.start_anew = {1 - config.task.start_anew:g}"
    fits = config.task.start_anew + config.task.keep_command <= 1 + 1e-9
    expect(fits, "task.keep_command", config.task.keep_command, text)
    expect(
        config.task.termination == "parts" or config.physics.contacts == "full",
        "physics.contacts",
        config.physics.contacts,
        "full where only the base ends an episode (task.termination=base, "
        "task.formulation=isaaclab_exact): knees would sink through the floor; set "
        "--config.physics.contacts=full",
    )


def check_tiles(tiles) -> None:
    """Checks that tiles consist of whole cells and have room for what is in them."""
    if tiles.map:  # the file's
        text = "one that a command line has set: --config.task.tiles.map=FILE"
        expect(bool(tiles.map_hash), "task.tiles.map", tiles.map, text)
        return
    for name in ("size", "border"):
        count = tiles[name] / tiles.cell
        text = f"a multiple of task.tiles.cell = {tiles.cell:g}"
        expect(abs(count - round(count)) < 1e-6, f"task.tiles.{name}", tiles[name], text)
    low, high = tiles.random
    count = (high - low) / tiles.random_step
    text = f"one that divides what is between task.tiles.random = ({low:g}, {high:g})"
    expect(abs(count - round(count)) < 1e-6, "task.tiles.random_step", tiles.random_step, text)
    expect(sum(tiles.shares) > 0, "task.tiles.shares", tiles.shares, "one or more above 0")
    sides = (n * tiles.size + 2 * tiles.border for n in (tiles.rows, tiles.columns))
    count = math.prod(round(side / tiles.cell) for side in sides)
    text = (
        "at most 100 million cells: those of task.tiles.rows x columns tiles of its size, with its border "
        f"around all, are {count / 1e6:.0f}"
    )
    expect(count <= 10**8, "task.tiles.cell", tiles.cell, text)
    for name, edge in (("stairs_platform", "stairs_border"), ("platform", "margin")):
        room = tiles.size - 2 * tiles[edge]
        text = f"at most {room:g}, which is task.tiles.size less twice task.tiles.{edge} = {tiles[edge]:g}"
        expect(tiles[name] <= room, f"task.tiles.{name}", tiles[name], text)


def _check_hardware(config) -> None:
    """Rejects randomisation that the observation, actuator or engine cannot support."""
    task, ranges = config.task, config.task.randomize
    seconds = config.physics.substeps * config.physics.timestep
    late, longest = ranges.delay[1], 2 * seconds
    text = f"at most two control steps, {longest:g} s"
    expect(late <= longest + 1e-9, "task.randomize.delay", ranges.delay, text)
    for name in ("encoder_bias", "imu_tilt"):
        fits = task.observation == "onboard" or not ranges[name]
        text = "0 where task.observation is full: its 48 numbers are those of the state"
        expect(fits, f"task.randomize.{name}", ranges[name], text)
    if task.actuator == "pd":
        text = "(0, 0) where task.actuator is pd; set task.actuator=lag"
        expect(tuple(ranges.lag) == (0, 0), "task.randomize.lag", ranges.lag, text)
    else:
        text = "above 0 where task.actuator is lag"
        expect(ranges.lag[1] > 0, "task.randomize.lag", ranges.lag, text)
        expect(config.physics.impl != "c", "physics.impl", "c", "jax or warp where torques lag")


def _check_model(config) -> None:
    """Checks that the value function can see a tail's states, and that the model's minibatches find
    enough real rows."""
    seen = config.ppo.critic == "obs" or config.model.clean
    text = "obs where model.clean is False: a tail then has no exact state; or set model.clean=True"
    expect(seen, "ppo.critic", config.ppo.critic, text)
    _check_memory(config)
    horizon, minibatches = config.rollout.horizon, config.model.minibatches
    expected = f"a multiple of model.minibatches = {minibatches}: a minibatch has as many rows of every robot"
    expect(horizon % minibatches == 0, "rollout.horizon", horizon, expected)
    drawn, fewest = horizon // minibatches, int(schedule.columns(config)["n_real"].min())
    if fewest < drawn:
        raise ConfigError(
            f"model.minibatches is {minibatches}: a minibatch has {drawn} rows of every robot, expected at "
            f"most the {fewest} real rows of the longest tail; raise model.minibatches or lower "
            "schedule.end_steps"
        )


def _check_logs(config) -> None:
    """Checks that a policy can learn where all real rows are recorded: from tails, of what a log tells."""
    if not config.run.logs:
        return
    task = config.task
    fits = bool((schedule.table(config) > 0).all()) and schedule.uses_model(config)
    text = "'' where an iteration has no tail: PPO learns from the model's rows alone; try --config=go1:logs"
    expect(fits, "run.logs", config.run.logs, text)
    alone = task.terrain == "flat" and not (task.heading or task.gait_frequency or config.env)
    text = (
        "'' with rough ground, headings, a gait clock or another package's task, which no log tells"
    )
    expect(alone, "run.logs", config.run.logs, text)


def _check_memory(config) -> None:
    """Checks that a memory holds an iteration and is read, and that nothing reads one that is not there."""
    memory, horizon, robots = config.model.memory, config.rollout.horizon, config.rollout.num_envs
    anchors, remembered = config.schedule.anchors, config.model.remembered
    text = f"0, or at least rollout.horizon = {horizon}: the rows of an iteration"
    expect(memory == 0 or memory >= horizon, "model.memory", memory, text)
    text = "0 where neither model.remembered nor schedule.anchors reads the memory"
    expect(memory == 0 or remembered or anchors, "model.memory", memory, text)
    text = "0 where model.memory is 0"
    expect(memory or not remembered, "model.remembered", remembered, text)
    expect(anchors <= memory, "schedule.anchors", anchors, f"at most model.memory = {memory}")
    expect(
        not anchors or config.schedule.rounds > 1,
        "schedule.anchors",
        anchors,
        "0 where schedule.rounds is 1: the first round goes on from the last row",
    )
    told, task = config.schedule.new_commands, config.task
    text = "False where schedule.rounds is 1: the first round goes on from the last row"
    expect(not told or config.schedule.rounds > 1, "schedule.new_commands", told, text)
    alone = task.terrain == "flat" and not (task.heading or task.gait_frequency or config.env)
    text = "False with rough ground, headings, a gait clock or another package's task"
    expect(not told or alone, "schedule.new_commands", told, text)
    most = robots * max(memory, config.rollout.imagined * horizon)
    name = "rollout.num_envs x rollout.imagined x rollout.horizon, or x model.memory"
    expect(most < 2**31, name, most, "an integer of 32 bits")
    tied, text = config.model.symmetry, "False where ppo.symmetry is False"
    expect(config.ppo.symmetry or not tied, "model.symmetry", tied, text)
    text = "even sizes where model.symmetry is True"
    halves = not tied or all(size % 2 == 0 for size in config.model.hidden)
    expect(halves, "model.hidden", config.model.hidden, text)

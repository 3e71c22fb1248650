"""Crossings of runs on rough ground, on the way: which tiles a policy crosses after how many simulator steps.

    python experiments/28_rough/run.py OUT_FOLDER JOBS.txt [--workers 4] [--policies]

A line of JOBS.txt is as for 21_less/run.py. OUT_FOLDER/NAME.csv has a row an evaluation and seed: `TRIES`
tries on tiles of another seed (`dynappo evaluate --crossing`), and of each kind the shares crossed, row by
row from easy to hard. `--policies` and `--late` are as there.
"""

import importlib
import math
import time
from functools import partial
from pathlib import Path

import jax
import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.evaluate import crossing
from dynappo.program import build, devices
from dynappo.tasks.velocity import env as env_lib

less = importlib.import_module("experiments.21_less.run")

TRIES = 2000


def run(to: Path, job: str, fields: list[str], policies: bool = False, late=None) -> None:
    """Train, and write TO.csv, and with `policies` TO.K.npz."""
    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    for field in fields:
        config_lib.override(config, *field.split("=", 1))
    ends = config.run.num_iterations, config.run.eval_every or config.run.num_iterations
    config.run.log_every = math.gcd(*ends, *(late or ()))
    config = config_lib.validate(config)
    build.check(config)
    measure = tries(config)
    program, seeds = build.program(config), config.run.num_seeds
    state, steps, seconds, first, rows = program.state, schedule.sim_steps(config), 0.0, 0, []
    for last in less.evaluations(config, late):
        chunk = {name: column[first:last] for name, column in program.columns.items()}
        began = time.perf_counter()
        state, metrics = jax.block_until_ready(program.step(program.hyper, state, chunk))
        seconds, first = seconds + time.perf_counter() - began, last
        params, levels = state.learner.params, np.asarray(metrics["terrain_row"])
        for k in range(seeds):
            one = jax.tree.map(lambda x, k=k: x[k] if seeds > 1 else x, params)
            row = dict(job=" ".join([job, *fields]), seed=config.run.seed + k, iteration=last)
            row |= dict(sim_steps=int(steps[last - 1]), seconds=f"{seconds:.4g}")
            level = levels.reshape(seeds, -1)[k] if seeds > 1 else levels
            rows.append(row | dict(terrain_row=f"{level.ravel()[-1]:.3g}") | measure(one))
        less.write(to.with_name(f"{to.name}.csv.part"), rows)
    if policies:
        less.save_policies(to, state, config)
    to.with_name(f"{to.name}.csv.part").replace(to.with_name(f"{to.name}.csv"))


def tries(config):
    """`f(params) -> columns` of the crossings of one policy; compiled once."""
    config = crossing.on_other_ground(config)
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    static, hyper = config_lib.split(config)
    impl = devices.engine(config)
    env = env_lib.make(robot, config.task, config.physics, impl=impl)
    steps = config.task.episode_length
    measure = partial(crossing.tries, env, static=static, num_envs=TRIES, num_steps=steps)
    measure = jax.jit(measure)

    def of(params):
        found = jax.device_get(measure(hyper, params, jax.random.key(0)))
        counts = crossing.counted(config.task.tiles, found)
        told = {what: counts["all"][what] / TRIES for what in ("crossed", "fell")}
        for kind, each in counts["rows"].items():
            told[kind] = " ".join(f"{row['crossed'] / max(row['tries'], 1):.3f}" for row in each)
        return told

    return of


if __name__ == "__main__":
    less.main(__doc__, __file__, run)

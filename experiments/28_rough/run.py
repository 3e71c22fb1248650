"""Crossings of runs on rough ground, on the way: which tiles a policy crosses after how many simulator steps.

    python experiments/28_rough/run.py OUT_FOLDER JOBS.txt [--workers 4] [--policies]

All is as in 21_less/run.py, jobs and flags, too, but the evaluation: `TRIES` tries on tiles of another seed
(`dynappo evaluate --crossing`), and of each kind the shares crossed, row by row from easy to hard.
"""

import importlib
from functools import partial

import jax

from dynappo import config as config_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.evaluate import crossing
from dynappo.program import devices
from dynappo.tasks.velocity import env as env_lib

less = importlib.import_module("experiments.21_less.run")

TRIES = 2000


def of_seeds(config):
    """`f(state) -> columns [S]` of the crossings of each seed's policy."""
    measure = tries(config)

    def of(state):
        found = [measure(params) for params in less.each_seeds(state.learner.params, config)]
        return {name: [one[name] for one in found] for name in found[0]}

    return of


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
    less.main(__doc__, __file__, of_seeds)

"""How good is the model of a robot that walks, by setting: no learning of the policy, two CPU cores.

    python experiments/20_tail/offline.py OUT.csv [FIELD=VALUE[:FIELD=VALUE] ...] [--robots 256] [--seeds 3]

The bundled Go1 walks by its policy and that policy's noise; each iteration has eight real rows, and the
model is fitted to them as `best` does after iteration 50 (5 epochs, float32). Before each fit its error is
measured on those rows, which it has not seen: of 1, 4 and 8 predictions in a row, as a share of that of
repeating the state (errors.py). Written is a row a setting and seed: means over the last 20 of 60
iterations.
"""

import argparse
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm
from dynappo import config as config_lib
from dynappo.config import files
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.task import env as env_lib
from experiments import paper

SETTINGS = (
    "",
    "model.unroll=3",
    "model.unroll=6",
    "model.history=3",
    "model.private=True",
    "model.ensemble=2",
    "model.clean=False",
    "model.predict_change=False",
)
ROWS, WARM, ITERATIONS, LAST, EPOCHS = 8, 25, 60, 20, 5


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("settings", nargs="*", default=SETTINGS)
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    rows = []
    for setting in args.settings:
        rows += measure(setting, args.robots, args.seeds)
        paper.write(args.out, rows)
        print(rows[-1], flush=True)


def configure(setting: str, robots: int):
    config = config_lib.load("configs/go1.py:best")
    config.rollout.num_envs = robots
    config.model.precision = config.ppo.precision = "highest"
    for text in filter(None, setting.split(":")):
        config_lib.override(config, *text.split("=", 1))
    return config_lib.validate(config)


def measure(setting: str, robots: int, seeds: int) -> list[dict]:
    """A row a seed."""
    config = configure(setting, robots)
    static, hyper = config_lib.split(config)
    robot = robot_lib.load(config.robot)
    env = env_lib.make(robot, config.task, config.physics)
    path = files.find("robots", f"{config.robot}/policy.npz")
    walker = {name: jax.tree.map(jnp.asarray, part) for name, part in policy_of(path).items()}
    step = jax.jit(partial(iterate, env, static=static))
    rows = []
    for seed in range(seeds):
        state = algorithm.init(env, hyper, jax.random.key(seed), static=static)
        params = state.learner.params | walker
        state = state.replace(learner=state.learner.replace(params=params))
        found = []
        for i in range(WARM + ITERATIONS):
            epochs = EPOCHS if i >= WARM else 0  # first the robots start to walk
            state, errors = step(hyper, state, jnp.int32(i), jnp.int32(epochs))
            found.append(jax.device_get(errors))
        last = {n: np.mean([errors[n] for errors in found[-LAST:]]) for n in found[-1]}
        rows.append({"setting": setting or "best", "seed": seed, "robots": robots} | last)
    return rows


def policy_of(path) -> dict:
    params = policy_file.load_params(path)
    return {name: params[name] for name in ("actor", "std")}


def iterate(env, hyper, state, iteration, epochs, *, static):
    """`algorithm.iterate` without tail and without PPO: rows, errors, fit."""
    key = jax.random.fold_in(state.key, iteration)
    n_real = jnp.int32(ROWS)
    buffer, env_state, sums = algorithm.collect(env, hyper, state, n_real, key, static=static)
    errors = {}
    for steps in (1, 4, ROWS):
        errors |= errors.errors(static.model, env, state.model, buffer, steps, hyper.task)
    fit_key = jax.random.fold_in(key, algorithm.FIT)
    model, past, metrics = algorithm.learn(
        env, hyper, state.model, state.past, buffer, n_real, epochs, fit_key, static=static
    )
    errors |= {"falls": sums["falls"], "loss": metrics["model_loss_before"]}
    return state.replace(model=model, past=past, env_state=env_state), errors


if __name__ == "__main__":
    main()

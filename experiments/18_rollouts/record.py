"""Rollouts of `best` as they are, tails included: the bundled robot walks by its policy and that policy's
noise, and a model learns; PPO never runs."""

import datetime
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import plot
from plot import KEPT, REAL

from dynappo import algorithm, fast
from dynappo import config as config_lib
from dynappo.config import files, versions
from dynappo.model import dynamics, examples
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

WARM, EPOCHS = 25, 5  # iterations until the robots walk; passes of a fit
# a tail of 16 behind REAL rows, as `best` had until 2026-11-22; today 4 are real
ROLLOUT = f"rollout.horizon={REAL + 16}", "model.minibatches=6"


def measure(folder: Path, robots: int, fits: int) -> None:
    """Write rows.csv, the last rollouts of one robot, and distance.csv, of all; `fits` of the model."""
    config = configure(robots, ROLLOUT)
    walk = walker(config, iterate)
    kept = list(walk(0, WARM + fits + KEPT))[-KEPT:]
    dt = config.physics.substeps * config.physics.timestep
    paper.write(folder / "rows.csv", plot.rows(kept, dt))
    paper.write(folder / "distance.csv", plot.distance(kept))
    about = {"device": jax.devices()[0].device_kind, "commit": versions.commit(), "robots": robots}
    files.write_json(
        folder / "about.json", about | {"fits": fits, "date": f"{datetime.date.today()}"}
    )


def iterate(env, hyper, state, iteration, epochs, *, static):
    """`algorithm.iterate` without PPO: the policy stays; returns the rows too."""
    key, real = jax.random.fold_in(state.key, iteration), jnp.int32(REAL)
    rows_key, fit_key = (jax.random.fold_in(key, n) for n in (algorithm.ROWS, algorithm.FIT))
    rows, env_state, _ = algorithm.collect(env, hyper, state, real, rows_key, static=static)
    learned = examples.examples(static, hyper, env, rows, real)
    model, _ = fast.fit(static, hyper, state.model, learned, epochs, fit_key)
    state, start = (
        state.replace(model=model, env_state=env_state),
        dynamics.tail(static, env, env_state),
    )
    return state, algorithm.imagine(env, hyper, state, rows, real, start, rows_key, static=static)


def configure(robots: int, fields=()):
    """`best` in float32 with so many robots, and `fields` (FIELD=VALUE) set."""
    config = config_lib.load("configs/go1.py:best")
    config.rollout.num_envs = robots
    config.model.precision = config.ppo.precision = "highest"
    for text in fields:
        config_lib.override(config, *text.split("=", 1))
    return config_lib.validate(config)


def walker(config, iterate):
    """`walk(seed, iterations)`, which yields what `iterate(env, hyper, state, iteration, epochs, static)`
    finds beside the next state. In the first `WARM` iterations there are no epochs."""
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot_lib.load(config.robot), config.task, config.physics)
    bundled = policy_file.load_params(files.find("robots", f"{config.robot}/policy.npz"))
    bundled = jax.tree.map(jnp.asarray, {name: bundled[name] for name in ("actor", "std")})
    step = jax.jit(partial(iterate, env, static=static))

    def walk(seed: int, iterations: int):
        state = algorithm.init(env, hyper, jax.random.key(seed), static=static)
        params = state.learner.params | bundled
        state = state.replace(learner=state.learner.replace(params=params))
        for i in range(iterations):
            epochs = EPOCHS if i >= WARM else 0
            state, found = step(hyper, state, jnp.int32(i), jnp.int32(epochs))
            yield jax.device_get(found)

    return walk

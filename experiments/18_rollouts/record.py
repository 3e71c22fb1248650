"""Rollouts of `best` as they are, tails included, of a robot that walks: no learning of the policy."""

import datetime
from pathlib import Path

import jax
import jax.numpy as jnp
import plot
from plot import KEPT, REAL

from dynappo import algorithm, fast
from dynappo.config import files, versions
from dynappo.model import dynamics, examples
from experiments import paper, walking

# a tail of 16 behind REAL rows, as `best` had until 2026-11-22; today 4 are real
ROLLOUT = f"rollout.horizon={REAL + 16}", "model.minibatches=6"


def measure(folder: Path, robots: int, fits: int) -> None:
    """Write rows.csv, the last rollouts of one robot, and distance.csv, of all; `fits` of the model."""
    config = walking.configure(robots, ROLLOUT)
    walk = walking.walker(config, iterate)
    kept = list(walk(0, walking.WARM + fits + KEPT))[-KEPT:]
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

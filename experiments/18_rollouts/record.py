"""Rollouts of `best` as they are, tails included, of a robot that walks: no learning of the policy."""

import datetime
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import plot
from plot import KEPT, REAL

from dynappo import algorithm, rollout
from dynappo import config as config_lib
from dynappo.config import files, versions
from dynappo.model import dynamics
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.task import env as env_lib
from experiments import paper

WARM, EPOCHS = 25, 5  # iterations until the robots walk; passes of a fit


def measure(folder: Path, robots: int, fits: int) -> None:
    """Write rows.csv, the last rollouts of one robot, and distance.csv, of all; `fits` of the model."""
    config = config_lib.load("configs/go1.py:best")
    config.rollout.num_envs = robots
    config.model.precision = config.ppo.precision = "highest"
    config = config_lib.validate(config)
    static, hyper = config_lib.split(config)
    robot = robot_lib.load(config.robot)
    env = env_lib.make(robot, config.task, config.physics)
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    walker = policy_file.load_params(files.find("robots", f"{config.robot}/policy.npz"))
    walker = jax.tree.map(jnp.asarray, {name: walker[name] for name in ("actor", "std")})
    state = state.replace(learner=state.learner.replace(params=state.learner.params | walker))
    step, kept = jax.jit(partial(iterate, env, hyper, static=static)), []
    for i in range(WARM + fits + KEPT):
        state, buffer = step(state, jnp.int32(i), jnp.int32(EPOCHS if i >= WARM else 0))
        kept = [*kept, jax.device_get(buffer)][-KEPT:]
    paper.write(folder / "rows.csv", plot.rows(kept, env.dt))
    paper.write(folder / "distance.csv", plot.distance(kept))
    about = {"device": jax.devices()[0].device_kind, "commit": versions.commit(), "robots": robots}
    files.write_json(
        folder / "about.json", about | {"fits": fits, "date": f"{datetime.date.today()}"}
    )


def iterate(env, hyper, state, iteration, epochs, *, static):
    """`algorithm.iterate` without PPO: the policy stays; returns the buffer too."""
    key = jax.random.fold_in(state.key, iteration)
    rows_key, real = jax.random.fold_in(key, algorithm.ROWS), jnp.int32(REAL)
    buffer, env_state, _ = algorithm.collect(env, hyper, state, real, rows_key, static=static)
    fit_key = jax.random.fold_in(key, algorithm.FIT)
    model, past, _ = algorithm.learn(
        env, hyper, state.model, state.past, buffer, real, epochs, fit_key, static=static
    )
    buffer, _, _ = rollout.fill(
        buffer,
        real,
        jnp.int32(static.rollout.horizon),
        dynamics.tail(static.model, env, env_state, state.params_physics),
        rollout.row_keys(rows_key, state.robot_index),
        act=algorithm.policy(static.ppo, state.learner.params),
        step=algorithm.model_step(env, hyper.task, model, static=static),
    )
    return state.replace(model=model, past=past, env_state=env_state), buffer

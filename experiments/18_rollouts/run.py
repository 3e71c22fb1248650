"""Figures 1 to 3: what a rollout with a tail is, from the schedule and from rollouts of the code itself.

    python experiments/18_rollouts/run.py [--quick] [--out DIR]

The bundled Go1 walks by its policy and that policy's noise, PPO never runs, and `best`'s model is fitted to
four real rows an iteration; then eleven iterations are kept as they are, tails included, in DIR/results
(skipped where about.json is). Then figures, as plot.py.
"""

import datetime
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import plot
from plot import KEPT, LENGTH, REAL

from dynappo import algorithm, fast
from dynappo import config as config_lib
from dynappo.config import files, versions
from dynappo.description import robot as robot_lib
from dynappo.model import dynamics, examples
from dynappo.policy import policy_file
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

WARM, EPOCHS = 50, 5  # iterations until the robots walk; passes of a fit


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    if not (args.out / "results" / "about.json").exists():
        robots, fits = (32, 2) if args.quick else (1024, 40)
        measure(args.out / "results", robots, fits)
    plot.make(args.out)


def measure(folder: Path, robots: int, fits: int) -> None:
    """Write rows.csv, the last rollouts of one robot, and distance.csv, of all; `fits` of the model."""
    config = config_lib.load("configs/go1.py:best")
    config.rollout.num_envs = robots
    config.model.precision = config.ppo.precision = "highest"
    config = config_lib.validate(config)
    assert config.rollout.horizon == REAL + LENGTH
    kept = list(rollouts(config, WARM + fits + KEPT))[-KEPT:]
    dt = config.physics.substeps * config.physics.timestep
    paper.write(folder / "rows.csv", plot.rows(kept, dt))
    paper.write(folder / "distance.csv", plot.distance(kept))
    about = {"device": jax.devices()[0].device_kind, "commit": versions.commit(), "robots": robots}
    about |= {"fits": fits, "date": f"{datetime.date.today()}"}
    files.write_json(folder / "about.json", about)


def rollouts(config, iterations: int):
    """Yield the rows of each iteration. In the first `WARM` the model is not fitted."""
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot_lib.load(config.robot), config.task, config.physics)
    bundled = policy_file.load(files.find("robots", f"{config.robot}/policy.npz")).params
    bundled = jax.tree.map(jnp.asarray, {name: bundled[name] for name in ("actor", "std")})
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    learner = state.learner.replace(params=state.learner.params | bundled)
    state, step = state.replace(learner=learner), jax.jit(partial(iterate, env, static=static))
    for i in range(iterations):
        epochs = EPOCHS if i >= WARM else 0
        state, found = step(hyper, state, jnp.int32(i), jnp.int32(epochs))
        yield jax.device_get(found)


def iterate(env, hyper, state, iteration, epochs, *, static):
    """`algorithm.iterate` without PPO: the policy stays; returns the rows too."""
    key, real = jax.random.fold_in(state.key, iteration), jnp.int32(REAL)
    rows_key, fit_key = (jax.random.fold_in(key, n) for n in (algorithm.ROWS, algorithm.FIT))
    rows, env_state, _ = algorithm.collect(env, hyper, state, real, rows_key, static=static)
    learned = examples.examples(static, hyper, env, rows, real)
    model, _ = fast.fit(static, hyper, state.model, learned, epochs, fit_key)
    state = state.replace(model=model, env_state=env_state)
    start = dynamics.tail(static, env, env_state)
    return state, algorithm.imagine(env, hyper, state, rows, real, start, rows_key, static=static)


if __name__ == "__main__":
    main()

"""How good is the model of a robot that walks, by setting: no learning of the policy, two CPU cores.

    python experiments/20_tail/offline.py OUT.csv [FIELD=VALUE[:FIELD=VALUE] ...] [--robots 256] [--seeds 3]

The bundled Go1 walks by its policy and that policy's noise; each iteration has eight real rows, and the
model is fitted to them as `best` does after iteration 50 (5 epochs, float32). Before each fit its error is
measured on those rows, which it has not seen: of 1, 4 and 8 predictions in a row, as a share of that of
repeating the state (dynappo/model/errors.py). Written is a row a setting and seed: means over the last 20
of 60 iterations.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm, fast
from dynappo.model import errors, examples
from dynappo.program import devices
from experiments import paper, walking

SETTINGS = ("", "model.clean=False", "model.predict_change=False")
ROWS, ITERATIONS, LAST = 8, 60, 20


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("settings", nargs="*", default=SETTINGS)
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    devices.own_process()
    rows = []
    for setting in args.settings:
        rows += measure(setting, args.robots, args.seeds)
        paper.write(args.out, rows)
        print(rows[-1], flush=True)


def measure(setting: str, robots: int, seeds: int) -> list[dict]:
    """A row a seed."""
    config = walking.configure(robots, filter(None, setting.split(":")))
    walk, rows = walking.walker(config, iterate), []
    for seed in range(seeds):
        found = list(walk(seed, walking.WARM + ITERATIONS))[-LAST:]
        last = {name: float(np.mean([each[name] for each in found])) for name in found[-1]}
        rows.append({"setting": setting or "best", "seed": seed, "robots": robots} | last)
    return rows


def iterate(env, hyper, state, iteration, epochs, *, static):
    """`algorithm.iterate` without tail and without PPO: rows, errors, fit."""
    key, real = jax.random.fold_in(state.key, iteration), jnp.int32(ROWS)
    buffer, env_state, sums = algorithm.collect(env, hyper, state, real, key, static=static)
    found = {}
    for steps in (1, 4, ROWS):
        found |= errors.errors(static, hyper, env, state.model, buffer, steps)
    fit_key = jax.random.fold_in(key, algorithm.FIT)
    learned = examples.examples(static, hyper, env, buffer, real)
    model, fitted = fast.fit(static, hyper, state.model, learned, epochs, fit_key)
    found |= {"falls": sums["falls"], "loss": fitted["model_loss_before"]}
    return state.replace(model=model, env_state=env_state), found


if __name__ == "__main__":
    main()

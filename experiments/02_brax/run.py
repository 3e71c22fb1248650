"""Others' tasks under our trainer, by PPO and by Dyna: brax's hopper and Playground's Go1.

    python experiments/02_brax/run.py OUT [--tasks hopper,go1_joystick] [--set FIELD=VALUE ...]

Writes OUT/TASK_METHOD.csv, one row an iteration; one that is there is skipped.
"""

import time
from functools import partial
from pathlib import Path

import jax
import tasks

from dynappo import algorithm, schedule
from dynappo import config as config_lib
from dynappo.program import devices
from dynappo.run import log
from experiments import paper

KEEP = """iteration sim_steps seconds episode_return episode_length reward falls timeouts blowups
policy_std learning_rate n_real model_loss model_loss_before""".split()


def train(task: str, method: str, changes: list[str]):
    """Yields the rows of one run; `seconds` are without compilation."""
    config = config_lib.load("configs/default.py:dyna4")
    tail = ["schedule.start_steps=0", f"schedule.end_steps={4 if method == 'dyna' else 0}"]
    for text in tasks.SMALL + tasks.FIELDS[task] + tail + changes:
        config_lib.override(config, *text.split("=", 1))
    config, env, seconds = config_lib.validate(config), tasks.MAKE[task](), 0.0
    static, hyper = config_lib.split(config)
    steps, columns = schedule.sim_steps(config), schedule.columns(config)
    init, run = (jax.jit(partial(f, env, static=static)) for f in (algorithm.init, algorithm.run))
    state, size = init(hyper, jax.random.key(0)), config.run.log_every
    run = run.lower(hyper, state, {n: column[:size] for n, column in columns.items()}).compile()
    for first in range(0, config.run.num_iterations, size):
        rows = slice(first, first + size)
        chunk = {name: column[rows] for name, column in columns.items()}
        began = time.perf_counter()
        state, metrics = jax.device_get(run(hyper, state, chunk))
        seconds += time.perf_counter() - began
        for row in log.rows(metrics | chunk | {"sim_steps": steps[rows]}):
            yield {name: (row | {"seconds": seconds}).get(name, float("nan")) for name in KEEP}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tasks", default=",".join(tasks.MAKE))
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    args = parser.parse_args()
    devices.own_process()
    args.out.mkdir(exist_ok=True)
    for task in args.tasks.split(","):
        for method in ("ppo", "dyna"):
            if not (path := args.out / f"{task}_{method}.csv").exists():
                log.append_csv(path, list(train(task, method, args.set)))
                print(path.stem, *[f"{n} {c[-1]:.5g}" for n, c in log.read_csv(path).items()][:7])


if __name__ == "__main__":
    main()

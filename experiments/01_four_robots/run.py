"""Train robots one after another in one process; see the README for the commands.

    python experiments/01_four_robots/run.py OUT go1:ppo16 go1:dyna4 ... [--set FIELD=VALUE ...]

Writes OUT/ROBOT_VARIANT.csv.xz (every 10th row of the metrics), .json (summary with 1000 evaluated
episodes, mean terms of the last 10 iterations) and .npz (policy), and prints a table. `--name` adds
to the file names.
"""

import time
from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.policy import policy_file
from dynappo.program import build, devices
from dynappo.run import finish, training, workdir
from experiments import paper
from experiments import run as runs

EVERY = 10  # rows of the metrics to one of the CSV


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="+", metavar="ROBOT:VARIANT")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--name", default="")
    parser.add_argument("--model", action="store_true", help="keep the transition model too")
    args = parser.parse_args()
    devices.own_process()
    args.out.mkdir(parents=True, exist_ok=True)
    for job in args.jobs:
        began = time.perf_counter()
        robot, variant = job.split(":")
        path = args.out / f"{robot}_{variant}{args.name}.json"
        config = config_lib.load(f"configs/{robot}.py:{variant}")
        for text in args.set:
            config_lib.override(config, *text.split("=", 1))
        config = config_lib.validate(config)
        program = build.program(config)
        trained = training.resume_and_loop([training.Run(config)], program)
        state, metrics = trained.state, trained.runs[0].metrics()
        summary = finish.summarise(config, program, metrics, program.evaluate(state))
        judged = np.array(summary["evaluation"]["return"], float)
        params = workdir.best_params(config, state.learner.params, judged)
        policy_file.save(path.with_suffix(".npz"), params, config, program.robot)
        if args.model and state.model is not None:
            keep_model(path.with_suffix(".model.npz"), state.model)
        thin = {n: m[EVERY - 1 :: EVERY] for n, m in metrics.items()}
        runs.write_csv(path.with_suffix(".csv"), thin)
        summary["set"] = args.set
        summary["last_10"] = {
            n: np.mean(m[-10:], axis=0).tolist() for n, m in metrics.items() if m.dtype != np.int32
        }
        files.write_json(path, summary)
        print(row(path.stem, summary), f"{time.perf_counter() - began:6.1f}", flush=True)


def keep_model(path: Path, model) -> None:
    """Write a transition model's weights and moments."""
    import jax

    leaves = jax.tree.leaves((model.params, model.inputs, model.targets))
    np.savez(path, *[np.asarray(leaf) for leaf in leaves])


def row(name, summary):
    """Return, best; evaluation: return, share of falls, tracking, yaw; seconds: training, set-up."""
    e = summary["evaluation"]
    numbers = [summary["return"], summary["return_max"]]
    numbers += [e[n] for n in ("return", "fall_rate", "tracking_error", "yaw_error")]
    numbers += [summary["seconds"], summary["compile_seconds"]]
    return f"{name:24s}" + " ".join(f"{np.mean(np.array(n, float)):8.3f}" for n in numbers)


if __name__ == "__main__":
    main()

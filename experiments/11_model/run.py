"""Table II and figures 5 and 6: how the transition model learns while the policy changes; dyna4.

    python experiments/11_model/run.py [--robot go2] [--policies DIR] [--quick] [--out DIR]

Writes loss.csv, errors.csv and about.json into DIR/results/ROBOT, and skips a robot that is there. Then
tables and figures of all robots, as plot.py. At the iterations `AT` every robot goes on for a rollout by
physics, from its state of training and with its noise, and the model follows with the same actions: rows
that it has not seen. --policies keeps the actors of `paper.CHECKPOINTS`: the runs of 16_gaits are the same.
"""

import datetime
import time
from pathlib import Path

import numpy as np
import plot
import probe

from dynappo.config import files, versions
from experiments import paper, run

SEEDS, EVERY = 5, 5
AT = (5, 10, 15, 20, 30, 40, 50, 75, 100, 150, 200, 250, 300, 350, 400, 450, 500)
SETTINGS = (f"run.log_every={EVERY}", "run.eval_envs=0", "run.checkpoint_every=0", "run.seed=500")
SETTINGS += paper.TAILS


def main():
    of = paper.parser(__doc__)
    of.add_argument("--robot", default="go1", choices=paper.ROBOTS)
    of.add_argument("--policies", type=Path, help="where to keep policies, as those of 16_gaits")
    args = paper.options(Path(__file__).parent, of)
    if not (args.out / "results" / args.robot / "about.json").exists():
        measure(args)
    plot.make(args.out)


def measure(args) -> None:
    seeds, settings = (2, paper.QUICK) if args.quick else (SEEDS, SETTINGS)
    checkpoints = (5, 10) if args.quick else paper.CHECKPOINTS
    job, folder = f"{args.robot}:dyna4", args.out / "results" / args.robot
    config = run.configure(job, seeds, settings)
    losses, errors, began, program, ask = [], [], time.perf_counter(), None, None
    for program, done, state, metrics in run.chunks(config, args.lock):
        for i in range(EVERY):
            for s, values in enumerate(zip(*(metrics[n][i] for n in plot.LOSSES), strict=True)):
                row = {"iteration": done - EVERY + i + 1, "seed": s}
                losses.append(
                    row | {n: f"{v:.4g}" for n, v in zip(plot.LOSSES, values, strict=True)}
                )
        if done in AT:
            ask = ask or probe.compiled(program)
            for s, (rmse, spread) in enumerate(zip(*map(np.asarray, ask(state)), strict=True)):
                errors += probe.rows(done, s, rmse, spread, plot.STEPS)
        if args.policies and done in checkpoints:
            run.keep_actors(args.policies, job, done, config, program, state)
    if program is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    paper.write(folder / "loss.csv", losses)
    paper.write(folder / "errors.csv", errors)
    about = {"device": program.device, "impl": program.impl, "commit": versions.commit()}
    about |= {"date": f"{datetime.date.today()}", "first_seed": config.run.seed, "seeds": seeds}
    about |= {"robots": config.rollout.num_envs, "iterations": config.run.num_iterations}
    files.write_json(folder / "about.json", about | {"seconds": time.perf_counter() - began})


if __name__ == "__main__":
    main()

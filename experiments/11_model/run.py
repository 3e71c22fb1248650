"""Table II and figures 5 and 6: how the transition model learns while the policy changes; Go1, dyna4.

    python experiments/11_model/run.py [--quick] [--out DIR]

Writes DIR/results/{loss,errors}.csv and about.json, and skips that where they are. Then tables and
figures, as plot.py. At the iterations `AT` every robot goes on for a rollout by physics, from its state of
training and with its noise, and the model follows with the same actions: rows that it has not seen.
"""

import datetime
import time
from pathlib import Path

import numpy as np
import plot
import probe

from dynappo.config import files, versions
from experiments import paper, run

SEEDS, EVERY = 3, 5
AT = (5, 10, 15, 20, 30, 40, 50, 75, 100, 150, 200, 250, 300, 350, 400, 450, 500)


def main():
    args = paper.options(Path(__file__).parent, __doc__)
    if not (args.out / "results" / "about.json").exists():
        measure(args.out / "results", args.quick, args.lock)
    plot.make(args.out)


def measure(folder: Path, quick: bool, lock: Path | None) -> None:
    settings = (f"run.log_every={EVERY}", "run.eval_envs=0", "run.checkpoint_every=0")
    config = run.configure("go1:dyna4", 2 if quick else SEEDS, paper.QUICK if quick else settings)
    losses, errors, began, program, ask = [], [], time.perf_counter(), None, None
    for program, done, state, metrics in run.chunks(config, lock):
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
    if program is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    paper.write(folder / "loss.csv", losses)
    paper.write(folder / "errors.csv", errors)
    about = {"device": program.device, "impl": program.impl, "commit": versions.commit()}
    about["date"] = f"{datetime.date.today()}"
    about |= {"robots": config.rollout.num_envs, "iterations": config.run.num_iterations}
    files.write_json(folder / "about.json", about | {"seconds": time.perf_counter() - began})


if __name__ == "__main__":
    main()

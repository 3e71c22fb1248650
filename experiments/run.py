"""Runs of several seeds, one after another in one process: what the experiments' folders are made of.

    python experiments/run.py OUT ROBOT:VARIANT[:FIELD=VALUE[:FIELD=VALUE...]] ... [--seeds 5]

`go1:fast:schedule.end_steps=8` is configs/go1.py:fast with that field set. Each run writes
OUT/NAME.csv, one row an iteration and seed with the columns of `KEPT`, and OUT/NAME.json (summary with
the evaluation of each seed, the config's differences, hardware). NAME is the job with `_` for `:` and
`=`. A job whose JSON is there is skipped, so a batch that was cut off goes on with the same command.
"""

import argparse
import datetime
import re
import time
from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo import log, train

KEPT = (
    "iteration sim_steps seconds episode_return episode_length velocity_error policy_std "
    "learning_rate kl value_loss model_loss model_error_1 model_error_4 falls "
    "surrogate_loss tail_bias tail_falls"
).split()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="+", metavar="ROBOT:VARIANT[:FIELD=VALUE]")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="in all")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for job in args.jobs:
        path = args.out / (re.sub(r"[:=]", "_", job) + ".json")
        if path.exists():
            continue
        began = time.perf_counter()
        robot, variant, *fields = job.split(":")
        config = config_lib.load(f"configs/{robot}.py:{variant}")
        config.run.num_seeds = args.seeds
        for text in args.set + fields:
            config_lib.override(config, *text.split("=", 1))
        config = config_lib.validate(config)
        program = train.setup(config)
        try:
            state, metrics = train.loop(config, program, None)
        except FloatingPointError as error:  # a result too: this setting diverges
            log.write_json(path, {"job": job, "set": args.set, "diverged": str(error)})
            print(f"{job:44s} {error}", flush=True)
            continue
        kept = {name: metrics[name] for name in KEPT if name in metrics}
        path.with_suffix(".csv").unlink(missing_ok=True)
        log.append_csv(path.with_suffix(".csv"), log.rows(kept))
        summary = train.summarise(config, program, state, metrics)
        summary |= {"job": job, "set": args.set, "date": f"{datetime.date.today()}"}
        log.write_json(path, summary)
        print(row(job, summary), f"{time.perf_counter() - began:6.0f}", flush=True)


def row(job, summary):
    """Of all seeds: return, its spread, best; evaluated return, falls, tracking; seconds, set-up."""
    numbers = np.array(summary["return"], float), np.array(summary["return_max"], float)
    text = f"{job:44s} {numbers[0].mean():7.2f} +-{numbers[0].std():5.2f} {numbers[1].mean():7.2f}"
    evaluation = summary.get("evaluation", {})
    for name in ("return", "fall_rate", "tracking_error"):
        if name in evaluation:
            text += f" {np.mean(np.array(evaluation[name], float)):7.3f}"
    return text + f" {summary['seconds']:6.1f} {summary['compile_seconds']:6.1f}"


if __name__ == "__main__":
    main()

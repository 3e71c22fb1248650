"""First light: the paper's five variants on one robot, one seed each, and the time of each phase.

    python experiments/00_first_light/run.py OUT [--variants ppo16,dyna4] [--set FIELD=VALUE ...]

Writes OUT/VARIANT.csv.xz (metrics), OUT/VARIANT.json (summary, evaluation of 1000 episodes, ms of each
phase) and OUT/VARIANT.npz (the policy), and prints a table. A variant that is there is skipped.
"""

from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from dynappo.bench import phases
from dynappo.config import files
from dynappo.policy import policy_file
from dynappo.program import build, devices
from dynappo.run import finish, training, workdir
from experiments import paper
from experiments import run as runs

VARIANTS = "ppo12,ppo16,dyna2,dyna4_noschedule,dyna4"


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--variants", default=VARIANTS)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    args = parser.parse_args()
    devices.own_process()
    args.out.mkdir(parents=True, exist_ok=True)
    for variant in args.variants.split(","):
        path = args.out / f"{variant}.json"
        if path.exists():
            continue
        config = config_lib.load(f"configs/{args.robot}.py:{variant}")
        for text in args.set:
            config_lib.override(config, *text.split("=", 1))
        config = config_lib.validate(config)
        program = build.program(config)
        trained = training.resume_and_loop([training.Run(config)], program)
        state, metrics = trained.state, trained.runs[0].metrics()
        runs.write_csv(path.with_suffix(".csv"), metrics)
        summary = finish.summarise(config, program, metrics, program.evaluate(state))
        judged = np.array(summary["evaluation"]["return"], float)
        params = workdir.best_params(config, state.learner.params, judged)
        policy_file.save_params(path.with_suffix(".npz"), params)
        summary["phases_ms"] = phases.measure(config, program, state)
        files.write_json(path, summary)
        print(row(variant, summary), flush=True)


def row(variant, summary):
    """One row of the table: return, best, seconds, compile; evaluation; ms of each phase."""
    e, ms = summary["evaluation"], summary["phases_ms"]
    numbers = [summary[n] for n in ("return", "return_max", "seconds", "compile_seconds")]
    numbers += [e[n] for n in ("return", "fall_rate", "tracking_error", "yaw_error")]
    text = " ".join(f"{np.mean(n):8.3f}" for n in numbers)
    return f"{variant:18s}{text}  " + " ".join(f"{n} {v:.2f}" for n, v in ms.items())


if __name__ == "__main__":
    main()

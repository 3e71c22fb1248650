"""The best of tuned settings, as a list of jobs on fresh seeds. The rule for a walk is older than the runs.

    python experiments/21_less/choose.py FOLDER JOBS.txt FRESH.txt [--seed 1200] [--num-seeds 10] [--level]
        [--beyond LATER.txt]

FOLDER is what run.py made of JOBS.txt; every job must have run. Of the settings of a robot, the best is the
one with the fewest simulator steps until it walks (dynappo/policy/walks.py), mean over seeds; a seed that
never walks counts with twice all its steps. FRESH.txt gets that setting of each robot, as `walks-NAME`,
with other seeds, and an evaluation of 1000 episodes twice as often. `--level`: steps to the level decide,
whatever the falls, and the name is `level-NAME`. `--beyond`: settings that ran later compete with those of
JOBS.txt, and FRESH.txt gets the best of a robot only if it is one of them.
"""

import importlib
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper

table = importlib.import_module("experiments.21_less.table")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("fresh", type=Path)
    parser.add_argument("--seed", type=int, default=1200)
    parser.add_argument("--num-seeds", type=int, default=10)
    parser.add_argument("--level", action="store_true")
    parser.add_argument("--beyond", type=Path, metavar="LATER.txt")
    args = parser.parse_args()
    later = paper.jobs(args.beyond) if args.beyond else {}
    jobs = paper.jobs(args.jobs) | later
    found = table.read(args.folder)
    if missing := [name for name in jobs if name not in found]:
        raise SystemExit(f"{args.folder} lacks {', '.join(missing)}; run them first")
    if other := [name for name, line in jobs.items() if found[name][0]["job"] != line]:
        raise SystemExit(
            f"{args.folder} has other settings of {', '.join(other)} than were asked for"
        )
    goal = "level" if args.level else "walks"
    costs = {name: cost(found[name], goal) for name in jobs}
    lines = []
    for robot in dict.fromkeys(line.split()[0] for line in jobs.values()):
        mine = [name for name, line in jobs.items() if line.split()[0] == robot]
        for name in sorted(mine, key=costs.get):
            print(f"{name}: {costs[name] / 1e6:.2f} M")
        name = min(mine, key=costs.get)
        if not later or name in later:
            lines.append(fresh(f"{goal}-{name}", jobs[name], args.seed, args.num_seeds))
    args.fresh.write_text("".join(lines))


def cost(job: list[dict], goal: str = "walks") -> float:
    """Mean steps of the seeds to the `goal`, a field of `stats.Reached`; twice all steps where one never
    gets there."""
    runs = table.seeds(job)
    steps = getattr(table.reached(runs, walks.level(table.best(job))), goal)
    never = [2 * run[-1]["sim_steps"] for run in runs]
    return float(np.mean(np.where(np.isnan(steps), never, steps)))


def fresh(name: str, line: str, seed: int, num_seeds: int) -> str:
    """The job with other seeds, evaluated on more episodes, twice as often."""
    fields = dict(field.split("=", 1) for field in line.split()[1:])
    every = int(fields["run.eval_every"])
    fields |= {"run.seed": seed, "run.num_seeds": num_seeds}
    fields |= {"run.eval_envs": 1000, "run.eval_every": every // 2}
    return " ".join([name, line.split()[0], *(f"{k}={v}" for k, v in fields.items())]) + "\n"


if __name__ == "__main__":
    main()

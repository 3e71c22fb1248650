"""The best of tuned settings, as a list of jobs on fresh seeds. The rule for a walk is older than the runs.

    python experiments/21_less/choose.py FOLDER JOBS.txt FRESH.txt [--seed 1200] [--num-seeds 10] [--level]
        [--returns 30 20] [--beyond LATER.txt] [--episodes 1000] [--as-often]

FOLDER is what run.py made of JOBS.txt; every job must have run. Of the settings of a robot, the best is the
one with the fewest simulator steps until it walks (dynappo/policy/walks.py), mean over seeds; a seed that
never walks counts with twice all its steps. FRESH.txt gets that setting of each robot, as `walks-NAME`, with
other seeds, and an evaluation of 1000 episodes twice as often. `--level`: steps to the level decide, whatever
the falls, and the name is `level-NAME`. `--returns`: with `--level`, that of a return of 45, and of one of
30. `--beyond`: settings that ran later compete with those of JOBS.txt, and FRESH.txt gets the best of a robot
only if it is one of them. `--as-often`: evaluated as often as in tuning. Runs that compete must be equally
long, and evaluated as often: a seed that never gets there counts with its own run.
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
    parser.add_argument("--returns", type=float, nargs=2, metavar=("OF_45", "OF_30"))

    parser.add_argument("--beyond", type=Path, metavar="LATER.txt")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--as-often", action="store_true")
    args = parser.parse_args()
    if args.returns and not args.level:
        raise SystemExit(
            "--returns is given without --level, by which alone returns decide; add it"
        )
    later = paper.jobs(args.beyond) if args.beyond else {}
    jobs, found = paper.jobs(args.jobs) | later, table.read(args.folder)

    if missing := [name for name in jobs if name not in found]:
        raise SystemExit(f"{args.folder} lacks {', '.join(missing)}; run them first")
    if other := [name for name, line in jobs.items() if found[name][0]["job"] != line]:
        raise SystemExit(
            f"{args.folder} has other settings of {', '.join(other)} than were asked for"
        )
    goal = "level" if args.level else "walks"
    costs = {name: cost(found[name], goal, args.returns) for name in jobs}
    lines = []
    for robot in dict.fromkeys(line.split()[0] for line in jobs.values()):
        mine = [name for name, line in jobs.items() if line.split()[0] == robot]
        for name in sorted(mine, key=costs.get):
            print(f"{name}: {costs[name] / 1e6:.2f} M")
        name = min(mine, key=costs.get)
        if not later or name in later:
            more = {"run.seed": args.seed, "run.num_seeds": args.num_seeds}
            more["run.eval_envs"] = args.episodes
            lines.append(fresh(f"{goal}-{name}", jobs[name], more, 1 if args.as_often else 2))
    args.fresh.write_text("".join(lines))


def cost(job: list[dict], goal: str = "walks", returns=None) -> float:
    """Mean steps of the seeds to the `goal`, a field of `stats.Reached`; twice all steps where one never
    gets there. `returns`: what is asked of a return of 45, and of one of 30, in place of the level."""
    runs, best = table.seeds(job), table.best(job)
    least = walks.level(best) if returns is None else returns[best != 45]
    steps = getattr(table.reached(runs, least), goal)
    never = [2 * run[-1]["sim_steps"] for run in runs]
    return float(np.mean(np.where(np.isnan(steps), never, steps)))


def fresh(name: str, line: str, more: dict[str, int], often: int) -> str:
    """The job with other seeds and episodes, evaluated so many times as often."""
    fields = dict(field.split("=", 1) for field in line.split()[1:])
    every = int(fields["run.eval_every"])
    fields |= more | {"run.eval_every": every // often}
    return " ".join([name, line.split()[0], *(f"{k}={v}" for k, v in fields.items())]) + "\n"


if __name__ == "__main__":
    main()

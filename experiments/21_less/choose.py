"""The best of tuned settings, as a list of jobs on fresh seeds. The rule for a walk is older than the runs.

    python experiments/21_less/choose.py FOLDER JOBS.txt [...] FRESH.txt [--seed 1200] [--num-seeds 10]
        [--level] [--returns 30 20] [--beyond LATER.txt] [--episodes 1000] [--often 2] [--times 1]
        [--also PATH]

FOLDER is what run.py made of all JOBS.txt, or a file of pack.py; `--also` has those that FOLDER lacks. Of the
settings of a robot, the best is the one with the fewest simulator steps until it walks
(dynappo/policy/walks.py), mean over seeds; a seed that never walks counts with twice all its steps. Of equal
ones it is the one with the highest last return, and a line says so. A robot of which no seed of any setting
gets there is left out, which a line says, too. FRESH.txt gets the best of each robot, as `walks-NAME`, with
other seeds and 1000 episodes an evaluation. `--level`: steps to the level decide, whatever the falls, and the
name is `level-NAME`. `--returns`: with `--level`, that of a return of 45, and of one of 30. `--beyond`:
settings that ran later compete with those of JOBS.txt, and FRESH.txt gets the best of a robot only if it is
one of them. `--often`, `--times`: evaluated so many times as often as in tuning, and so many times as long.
Runs that compete must be equally long, and evaluated as often: a seed that never gets there counts with its
own run.
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
    parser.add_argument("jobs", type=Path, nargs="+")
    parser.add_argument("fresh", type=Path)
    parser.add_argument("--seed", type=int, default=1200)
    parser.add_argument("--num-seeds", type=int, default=10)
    parser.add_argument("--level", action="store_true")
    parser.add_argument("--returns", type=float, nargs=2, metavar=("OF_45", "OF_30"))
    parser.add_argument("--beyond", type=Path, metavar="LATER.txt")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--often", type=int, default=2)
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--also", type=Path, metavar="PATH")
    args = parser.parse_args()
    if args.returns and not args.level:
        raise SystemExit(
            "--returns is given without --level, by which alone returns decide; add it"
        )
    later = paper.jobs(args.beyond) if args.beyond else {}
    jobs = {name: line for path in args.jobs for name, line in paper.jobs(path).items()} | later
    found = (table.read(args.also) if args.also else {}) | table.read(args.folder)
    place = f"{args.folder} and {args.also} lack" if args.also else f"{args.folder} lacks"
    if missing := [name for name in jobs if name not in found]:
        raise SystemExit(f"{place} {', '.join(missing)}; run them first")
    if other := [name for name, line in jobs.items() if found[name][0]["job"] != line]:
        raise SystemExit(f"{', '.join(other)} ran with other settings than were asked for")
    goal = "level" if args.level else "walks"
    costs = {name: cost(found[name], goal, args.returns) for name in jobs}
    lines = []
    for robot in dict.fromkeys(line.split()[0] for line in jobs.values()):
        mine = [name for name, line in jobs.items() if line.split()[0] == robot]
        for name in sorted(mine, key=costs.get):
            print(f"{name}: {costs[name] / 1e6:.2f} M")
        if not any(arrive(found[name], goal, args.returns) for name in mine):
            print(f"{robot}: no seed of any setting gets there, so none is chosen")
            continue
        if len(equal := [name for name in mine if costs[name] == min(map(costs.get, mine))]) > 1:
            print(
                f"{robot}: {', '.join(equal)} are equal; of these the highest last return is taken"
            )
        name = max(equal, key=lambda name: last_return(found[name]))
        if not later or name in later:
            more = {"run.seed": args.seed, "run.num_seeds": args.num_seeds}
            more["run.eval_envs"] = args.episodes
            lines.append(fresh(f"{goal}-{name}", jobs[name], more, args.often, args.times))
    args.fresh.write_text("".join(lines))


def cost(job: list[dict], goal: str = "walks", returns=None) -> float:
    """Mean steps of the seeds to the `goal`, a field of `stats.Reached`; twice all steps where one never
    gets there. `returns`: what is asked of a return of 45, and of one of 30, in place of the level."""
    steps = steps_to(job, goal, returns)
    never = [2 * run[-1]["sim_steps"] for run in table.seeds(job)]
    return float(np.mean(np.where(np.isnan(steps), never, steps)))


def arrive(job: list[dict], goal: str, returns=None) -> bool:
    """Whether any seed gets to the `goal`."""
    return bool(np.isfinite(steps_to(job, goal, returns)).any())


def steps_to(job: list[dict], goal: str, returns) -> np.ndarray:
    """Of each seed, NaN where it never gets there."""
    best = table.best(job)
    least = walks.level(best) if returns is None else returns[best != 45]
    return getattr(table.reached(table.seeds(job), least), goal)


def last_return(job: list[dict]) -> float:
    """Mean over seeds."""
    return float(np.mean([run[-1]["return"] for run in table.seeds(job)]))


def fresh(name: str, line: str, more: dict[str, int], often: int, times: int = 1) -> str:
    """The job with other seeds and episodes, evaluated so many times as often, and so many times as long."""
    fields = dict(field.split("=", 1) for field in line.split()[1:])
    fields |= more | {"run.eval_every": int(fields["run.eval_every"]) // often}
    if times > 1:
        fields["run.num_iterations"] = times * int(fields["run.num_iterations"])
    return " ".join([name, line.split()[0], *(f"{k}={v}" for k, v in fields.items())]) + "\n"


if __name__ == "__main__":
    main()

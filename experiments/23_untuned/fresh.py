"""What the rule for fresh seeds says of fresh.txt and ppo_more_fresh.txt (README.md), with its numbers.

    python experiments/23_untuned/fresh.py FOLDER_OR_PACKED_FILE [--batch BATCH]

Of each robot: million steps to the level and to a walk, `best` and the PPO chosen for it; how many times
the steps of `best` PPO needs to the level (Fieller's 95 %), how many it needs more to a walk (Welch's),
Welch's p of the difference by Holm over all four, and the same with `EARLIER` taken off the steps of PPO's
seeds that get there. Shown is what is shown both ways.
"""

import importlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo.policy import walks
from experiments import paper, stats

runs = importlib.import_module("experiments.21_less.table")

ROBOTS = {"anymal_b": "ANYmal-B", "spot": "Spot"}
GOALS = {"level": "to the level", "walks": "to a walk"}
NOT_SHOWN = {
    "level": "no saving to the level is shown",
    "walks": "no difference in the mean is shown",
}
# to the level these of all fourteen settings stand, better or worse; else the one with the fewest steps
WINNERS = "level-anymal_b-grid-128-kl5", "level-spot-grid-128-kl4"
EARLIER = 0.03e6  # half of what lies between PPO's evaluations
LEVEL = walks.level(30)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("--batch")
    args = parser.parse_args()
    print(*told(runs.read(args.path, args.batch)), sep="\n")


class Goal(NamedTuple):
    """Steps of each seed to a goal on a robot; those that never get there count with twice the end."""

    robot: str
    goal: str
    ppo: np.ndarray
    best: np.ndarray
    never: tuple[int, int]  # seeds of PPO and of `best`
    end: float


def told(jobs: dict) -> list[str]:
    goals = [steps(jobs, robot, goal) for robot in ROBOTS for goal in GOALS]
    tries = []
    for less in (0.0, EARLIER):
        cut = [
            one._replace(ppo=np.where(one.ppo > one.end, one.ppo, one.ppo - less)) for one in goals
        ]
        p = stats.holm([stats.welch_of(one.ppo, one.best) for one in cut])
        tries.append([(around(one), float(x)) for one, x in zip(cut, p, strict=True)])
    lines = []
    for one, *both in zip(goals, *tries, strict=True):
        alike = 1.0 if one.goal == "level" else 0.0
        shown = all(p < stats.ALPHA and (x.low > alike or x.high < alike) for x, p in both)
        lines += [
            f"{ROBOTS[one.robot]}, {GOALS[one.goal]}: PPO {million(one.ppo, one.never[0])}, `best` "
            f"{million(one.best, one.never[1])}",
            *(f"  {number(one.goal, x)}, Holm's p {p:.2g}" for x, p in both),
            f"  {verdict(one.goal, both[0][0].value) if shown else NOT_SHOWN[one.goal]}",
        ]
    return lines


def steps(jobs: dict, robot: str, goal: str) -> Goal:
    """Of the PPO that stands for the goal and of `best`, up to where PPO ends."""
    if not (asked := chosen(jobs, robot, goal)) or f"{robot}-best" not in jobs:
        raise SystemExit(
            f"{robot}: no {goal}- job, or no {robot}-best, expected those of fresh.txt"
        )
    of_each = {name: beside(jobs, robot, goal, name) for name in asked}
    new = [of_each[name] for name in WINNERS if name in of_each]
    return new[0] if new else min(of_each.values(), key=lambda one: one.ppo.mean())


def chosen(jobs: dict, robot: str, goal: str) -> list[str]:
    """The PPO chosen for the goal; those for a walk where none was chosen for the level alone."""
    asked = [name for name in jobs if name.startswith(f"{goal}-{robot}-")]
    return asked or [name for name in jobs if name.startswith(f"walks-{robot}-")]


def beside(jobs: dict, robot: str, goal: str, name: str) -> Goal:
    mine = runs.seeds(jobs[name])
    end = mine[0][-1]["sim_steps"]
    other = [[r for r in run if r["sim_steps"] <= end] for run in runs.seeds(jobs[f"{robot}-best"])]
    each = [getattr(runs.reached(some, LEVEL), goal) for some in (mine, other)]
    never = tuple(int(np.isnan(x).sum()) for x in each)
    return Goal(robot, goal, *(np.nan_to_num(x, nan=2 * end) for x in each), never, end)


def around(one: Goal) -> stats.Around:
    """How many times the steps of `best` (to the level), or how many more, 95 %."""
    return (stats.ratio if one.goal == "level" else stats.difference)(one.ppo, one.best)


def million(values: np.ndarray, never: int) -> str:
    return f"{values.mean() / 1e6:.2f} M" + f" ({never} never)" * bool(never)


def number(goal: str, x: stats.Around) -> str:
    if goal == "level":
        return f"{x.value:.2f} times the steps ({x.low:.2f} to {x.high:.2f})"
    return f"{x.value / 1e6:+.2f} M steps ({x.low / 1e6:.2f} to {x.high / 1e6:.2f})"


def verdict(goal: str, value: float) -> str:
    """As the page will say it, where a difference is shown."""
    if goal == "level":
        return "PPO needs so many times the steps of `best`" if value > 1 else "PPO needs fewer"
    return "PPO needs so many steps more" if value > 0 else "PPO walks sooner"


if __name__ == "__main__":
    main()

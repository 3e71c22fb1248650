"""What the rule for CrossQ's fresh seeds says of the jobs of fresh.txt (README.md), printed with its numbers.

    python experiments/24_off_policy/fresh.py [FOLDER]

FOLDER has what 27_few/peers.py wrote: results/fresh, if none is given. Of each setting: thousand steps to
the level, beside `best` or `few`; how many times their steps, with Fieller's 95 %; falls and return in the
last evaluation.
"""

import importlib
import re
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper, stats

peers = importlib.import_module("experiments.27_few.peers_table")
few = importlib.import_module("experiments.27_few.table")

HERE = Path(__file__).parent
RUNS = HERE / "results/fresh"
BEFORE = HERE / "results/crossq.csv"  # three more seeds of crossq-256, to 0.41 M steps
SETTINGS = {  # job of fresh.txt -> seeds that the rule asks for, with those of BEFORE; beside what; robot
    "crossq-256": (8, "best", "g"),
    "crossq-256-symmetric": (5, "best", "g"),
    "crossq-64-symmetric": (3, "few", "g"),
    "crossq-256-symmetric-c": (5, "best", "c"),
}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=RUNS)
    args = parser.parse_args()
    for name in SETTINGS:
        print(told(name, runs_of(args.folder, name), beside(*SETTINGS[name][1:])))


def runs_of(folder: Path, name: str) -> list:
    """Rows of each seed: of NAME-103-107.csv; of a run that was cut off there is no such file."""
    files = [x for x in sorted(folder.glob("*.csv")) if re.fullmatch(rf"{name}-\d+-\d+", x.stem)]
    found = [run for path in files for run in few.runs.seeds(peers.of_run(path))]
    if found and name == "crossq-256":
        with BEFORE.open(newline="") as file:
            found += few.runs.seeds(few.runs.rows(file))
    return found


def level(letter: str) -> float:
    return walks.level(45 if letter in "gh" else 30)


def beside(kind: str, letter: str) -> np.ndarray:
    """Steps to the level of a robot's ten seeds of `best`, or all fresh ones of `few`."""
    if kind == "few":
        rows = few.fresh(HERE.parent / "27_few/results/gpu.csv.xz")[few.ROBOTS[letter]]
    else:
        rows = few.runs.read(HERE.parent / "21_less/results/headline.csv.xz")[f"best-{letter}"]
    return few.runs.reached(few.runs.seeds(rows), level(letter)).level


def told(name: str, seeds: list, base: np.ndarray) -> str:
    """The setting's line; that it is open where seeds are missing."""
    count, kind, letter = SETTINGS[name]
    if len(seeds) != count:
        return f"{name}: {len(seeds)} of {count} seeds, so the rule is open"
    steps = few.runs.reached(seeds, level(letter)).level
    never = np.isnan(steps)
    steps = np.where(never, [2 * run[-1]["sim_steps"] for run in seeds], steps)
    found = stats.ratio(steps, base)
    end = [np.mean([run[-1][x] for run in seeds]) for x in ("return", "fall_rate")]
    line = f"{name}, {count} seeds: first at {level(letter):g} after {steps.mean() / 1e3:.1f} k steps (last"
    line += f" {steps.max() / 1e3:.1f})" + f", {never.sum()} never" * bool(never.any())
    line += (
        f"; ends at {end[0]:.1f}, {100 * end[1]:.1f} % falls\n  `{kind}` {base.mean() / 1e3:.1f} k:"
    )
    line += f" {found.value:.2f} times its steps ({found.low:.2f} to {found.high:.2f})"
    return f"{line}: {verdict(found, kind)}"


def verdict(found: stats.Around, kind: str) -> str:
    """As the page will say it."""
    if found.low > 1:
        return "CrossQ needs so many times the steps"
    return "CrossQ needs fewer" if found.high < 1 else f"no saving of `{kind}` is shown"


if __name__ == "__main__":
    main()

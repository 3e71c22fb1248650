"""Settings of CrossQ and SAC for 64 robots: the tables of peers.md, and the best of each method.

    python experiments/27_few/peers_table.py              # tuning seeds: peers_tune.csv, which peers.py wrote
    python experiments/27_few/peers_table.py --fresh      # on fresh seeds: peers_fresh.csv, and LATER

A row a setting: return and episodes with a fall, means of its seeds, at the nearest evaluation; the first
evaluation at 30 and at 38, thousand steps, mean of the seeds and the last of them.

**The rule of the choice**, older than any fresh seed: the fewest simulator steps until first at 38, mean of
both seeds; a seed that never gets there counts with twice all steps that are asked for, 204,800. Of equals
the one with the higher return counts, mean of a seed's last three evaluations. A setting counts if both seeds
get there or have nine tenths of their steps; all others in peers_tune.txt must run first, but for one that
cannot be first any more: with the steps so far of each seed that is not there, its mean is above that of the
best that counts. The best of each method then runs on seeds 100 to 102: all others have run, and
peers_fresh.csv has them. CrossQ's best with symmetric networks in place of mirrored batches ran later, by
another rule (24_off_policy/README.md).
"""

import csv
import importlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo.policy import walks
from experiments import paper

runs = importlib.import_module("experiments.21_less.table")

HERE = Path(__file__).parent
RUNS, JOBS, FRESH = HERE / "peers_tune.csv", HERE / "peers_tune.txt", HERE / "peers_fresh.csv"
LATER = HERE.parent / "24_off_policy/results/fresh/crossq-64-symmetric-103-105.csv"
AT = 13e3, 26e3, 38e3, 51e3, 102e3
NEAR = 0.11  # of the steps: an evaluation that is farther is not shown
EARLY, LEVEL = 30, walks.level(45)
STEPS, WHOLE = 204_800, 0.9  # asked for; the share of its steps with which a setting counts
SEEDS = 2
METHODS = {"crossq": "CrossQ", "sac": "SAC"}
COLUMNS = "seed", "sim_steps", "return", "fall_rate"
WORDS = {
    "crossq": "64 updates a step, width 1024",
    "crossq-u128": "128 updates",
    "crossq-u256": "256 updates",
    "crossq-u512": "512 updates",
    "crossq-w512": "width 512",
    "crossq-w2048": "width 2048",
    "crossq-gain1": "gain 1",
    "crossq-gain05": "gain 0.5",
    "crossq-gamma97": "gamma 0.97",
    "crossq-64-symmetric": "gamma 0.97, symmetric networks",
    "crossq-gamma95": "gamma 0.95",
    "crossq-first1k": "1024 random transitions first",
    "crossq-b1024": "batches of 1024",
    "crossq-scale10": "rewards x 10",
    "crossq-scale100": "rewards x 100",
    "sac": "64 updates, batches of 256",
    "sac-u16": "16 updates, batches of 2048",
    "sac-u256": "256 updates, batches of 256",
    "sac-b512": "64 updates, batches of 512",
    "sac-gain1": "batches of 512, gain 1",
    "sac-gain05": "batches of 512, gain 0.5",
    "sac-lr3e4": "batches of 512, a rate of 3e-4",
    "sac-first1k": "batches of 512, 1024 random transitions first",
    "sac-gamma95": "batches of 512, gamma 0.95",
    "sac-symmetric": "batches of 512, symmetric networks",
}


class Setting(NamedTuple):
    """What is known of one; `[S]` are its seeds."""

    seeds: list  # rows of each
    level: np.ndarray  # [S] steps until first at 38; NaN: never
    counts: bool  # in the choice
    cost: float  # of the rule
    end: float  # mean return of the last three evaluations


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--fresh", action="store_true", help="on fresh seeds")
    if parser.parse_args().fresh:
        print(table(fresh()))
        return
    found = settings()
    print(table(found))
    for method, name in METHODS.items():
        soonest, first = best(found, paper.jobs(JOBS), method)
        if soonest:
            one = found[soonest]
            best_of = f"{name} so far" if first else name
            print(f"{best_of}: {soonest}, {one.cost / 1e3:.1f} k; at the end {one.end:.1f}")
        print(f"  must run first: {', '.join(first) or 'none'}")


def settings(folder: Path | None = None, jobs: Path = JOBS) -> dict[str, Setting]:
    """Of peers_tune.csv; and of what peers.py wrote into a folder, cut off or not, where it got farther."""
    rows = read(RUNS)
    tries: dict[str, list] = {}
    for one in sorted(folder.glob("*.csv*") if folder else ()):  # .csv, .csv.part, .csv.new
        run, some = one.name.partition(".csv")[0], of_run(one)
        tries[run] = max(tries.get(run, []), some, key=far)
    later: dict[str, list] = {}
    for run, some in tries.items():
        later.setdefault(re.sub(r"(-\d+)+$", "", run), []).extend(some)
    for name, some in later.items():
        if far(some) > far(rows.get(name, [])):
            rows[name] = some
    return each(rows, jobs)


def fresh() -> dict[str, Setting]:
    """Of peers_fresh.csv, and the one that came later."""
    return each(read(FRESH) | {LATER.stem.removesuffix("-103-105"): of_run(LATER)}, JOBS)


def each(rows: dict[str, list], jobs: Path) -> dict[str, Setting]:
    lines = paper.jobs(jobs)
    return {
        name: setting(runs.seeds(some), asked(lines.get(name, ""))) for name, some in rows.items()
    }


def far(rows: list) -> tuple[int, float]:
    """How many seeds there are, and to how many steps all of them got."""
    last: dict[float, float] = {}
    for row in rows:
        last[row["seed"]] = max(row["sim_steps"], last.get(row["seed"], 0.0))
    return len(last), min(last.values(), default=0.0)


def read(path: Path) -> dict[str, list]:
    """Rows by name, in a file without names those of ""."""
    rows: dict[str, list] = {}
    text = path.read_text()
    text = text[: text.rfind("\n") + 1]  # a line that does not end was cut off as it was written
    for row in csv.DictReader(text.splitlines()):
        kept = {key: float(row[key]) for key in COLUMNS}
        rows.setdefault(row.get("name", ""), []).append(kept)
    return rows


def of_run(path: Path) -> list:
    """Rows of a file that a run wrote."""
    return read(path).get("", [])


def of_each_method(folder: Path, jobs: Path, methods: Iterable[str] = ()) -> list[str]:
    """The best of each method, or of `methods`, with the runs of a folder; SystemExit if others must run
    before, or a method is none."""
    found, names = settings(folder, jobs), []
    for method in methods or METHODS:
        if method not in METHODS:
            raise SystemExit(f"{method}: no method, expected one of {', '.join(METHODS)}")
        name, first = best(found, paper.jobs(jobs), method)
        if first:
            raise SystemExit(f"{', '.join(first)} must run before the best {method} is chosen")
        names.append(name)
    return names


def asked(job: str) -> int:
    words = job.split()
    return int(words[words.index("--steps") + 1]) if "--steps" in words else STEPS


def setting(seeds: list, steps: int) -> Setting:
    level = runs.reached(seeds, LEVEL).level
    whole = min(run[-1]["sim_steps"] for run in seeds) >= WHOLE * steps
    cost = float(np.mean(np.where(np.isnan(level), 2 * STEPS, level)))
    end = float(np.mean([row["return"] for run in seeds for row in run[-3:]]))
    counts = len(seeds) >= SEEDS and (whole or np.isfinite(level).all())
    return Setting(seeds, level, bool(counts), cost, end)


def best(found: dict[str, Setting], jobs: dict[str, str], method: str) -> tuple[str, list[str]]:
    """The best of the method's settings that count, "" if none does, and those that must run before it is
    chosen."""
    mine = [name for name, job in jobs.items() if job.split()[0] == method]
    count = [name for name in mine if name in found and found[name].counts]
    soonest = min(count, key=lambda name: order(found[name]), default="")
    cost = found[soonest].cost if soonest else np.inf
    lost = [name for name in mine if name in found and least(found[name]) > cost]
    return soonest, [name for name in mine if name not in count + lost]


def least(one: Setting) -> float:
    """The least cost that a setting can still have: a seed that is not at the level needs more steps than it
    has used, and one that has not run may need none."""
    used = [rows[-1]["sim_steps"] for rows in one.seeds]
    return float(np.where(np.isnan(one.level), used, one.level).sum()) / max(SEEDS, len(used))


def order(one: Setting) -> tuple:
    return not one.counts, one.cost, -one.end


def table(found: dict[str, Setting]) -> str:
    """Markdown: each method's settings, those that count first and by the rule."""
    head = ["setting", "seeds", *(f"{at / 1e3:.0f} k" for at in AT), "the last evaluation"]
    head[2] += " steps"
    head += [f"first at {EARLY}", f"first at {LEVEL:g}"]
    lines = []
    for method, label in METHODS.items():
        mine = {name: one for name, one in found.items() if name.split("-")[0] == method}
        for name in sorted(mine, key=lambda name: order(mine[name])):
            cells = [f"{label}, {WORDS.get(name, name)} (`{name}`)", *row(mine[name])]
            lines.append(cells)
    return paper.markdown(head, lines)


def row(one: Setting) -> list[str]:
    shared = sorted(set.intersection(*({r["sim_steps"] for r in run} for run in one.seeds)))
    cells = [str(len(one.seeds))]
    for at in AT:
        near = min(shared, key=lambda steps: abs(steps - at))
        cells.append(shown(one.seeds, near) if abs(near - at) < NEAR * at else "")
    cells.append(f"{shared[-1] / 1e3:.0f} k: {shown(one.seeds, shared[-1])}")
    early = np.array([runs.first(run, EARLY) for run in one.seeds])
    return [*cells, when(early, shared[-1]), when(one.level, shared[-1])]


def shown(seeds: list, steps: float) -> str:
    values = [
        (r["return"], r["fall_rate"]) for run in seeds for r in run if r["sim_steps"] == steps
    ]
    returns, falls = np.mean(values, 0)
    return f"{returns:.1f}, {100 * falls:.0f} %"


def when(steps: np.ndarray, end: float) -> str:
    """Thousand steps, mean and last seed, or that some are not there by the end of their rows."""
    there = steps[np.isfinite(steps)] / 1e3
    if len(there) == len(steps):
        return f"{there.mean():.1f} ({there.max():.1f})"
    gone = "no seed" if not len(there) else f"{len(there)} of {len(steps)}, {there.mean():.1f}"
    return f"{gone} by {end / 1e3:.0f}"


if __name__ == "__main__":
    main()

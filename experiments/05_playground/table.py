"""The tables of README.md and returns.md, from results/*.csv.

    python experiments/05_playground/table.py

brax's PPO has run with Playground's resets of all robots, ten or so between two evaluations, with one, and on
Go1Getup with twice as many. The reference of a task is the most that any of these has in an evaluation, in
the mean over runs; where there is none, what our PPO with Playground's settings has. The first table tells
when it is reached: where a run first has 90 % and 100 % of it, on a straight line between two evaluations, in
millions of simulator steps and in seconds of training, in the mean over the runs that get there. The second
compares `best` with brax's PPO at equal returns: at each evaluation of `best` that is above all before it,
what brax's PPO needs for as much, on such a line, with those resets that get there first; a return that one
of them has in its first evaluation has no row. The last column is our PPO's. Then returns and falls, by
steps.

Some of brax's runs were cut off (`whole`): what they would have had later is not known. So each kind counts
twice, with these runs and without them, and what is better for brax holds: the higher reference, and at an
equal return the fewer steps.

A seed that ran twice counts as two runs, as runs of a seed differ on a GPU.

Means over runs are of the evaluations that two seeds have, or the only one. Those of brax's PPO and of ours
are also of those that one has while another is on its way, on a straight line between evaluations at most
`LINE` apart. Runs named -steps and -shared share a card, so their seconds are left out. Those of brax's PPO
are its steps times what a step takes in runs of the same task alone, in their mean (`rates`); one named
-brax-alone is there for that only. The seconds to 90 % and 100 % are told only where all runs that get there
have seconds.
"""

import csv
from itertools import compress
from pathlib import Path

import numpy as np

RESULTS, JOBS = Path(__file__).parent / "results", Path(__file__).with_name("jobs.txt")
KINDS = {  # variant -> what the page calls it
    "brax": "brax's PPO",
    "brax1": "brax's PPO, one reset",
    "brax10": "brax's PPO, twice as many resets",
    "ppo": "our PPO, Playground's settings",
    "best": "`best`",
}
BRAX = "brax", "brax1", "brax10"
SHARES = 0.9, 1.0  # of the reference
LINE = 12.0  # M steps: a return that bends between two evaluations further apart is not on a line


def main():
    found = runs()
    if not found:
        print(f"nothing was run: no CSV in {RESULTS}")
        return
    heads = [f"{share:.0%}: {unit}" for share in SHARES for unit in ("M steps", "seconds")]
    print(f"| task | | runs | last return | falls | M steps | seconds | {' | '.join(heads)} |")
    print("|---" * (7 + len(heads)) + "|")
    for task in tasks(found):
        level = reference(found, task)
        for kind in KINDS:
            some = found.get((task, kind))
            if not some:
                continue
            last = [[float(row[k]) for k in ("return", "fall_rate")] for *_, row in some]
            back, falls = np.mean(last, 0)
            cut = len(some) - len(whole(some))
            size, took = zip(*(when(rows[-1]) for rows in some), strict=True)
            cells = [
                task,
                KINDS[kind],
                f"{len(some)}" + (f", {cut} cut off" if cut else ""),
                f"{back:.1f}",
                f"{falls:.1%}",
                f"{np.mean(size):.1f}",
            ]
            cells += [average(took)]
            cells += [cell for share in SHARES for cell in first_cells(some, share * level)]
            print("| " + " | ".join(map(str, cells)) + " |")
    print()
    beside(found)
    for task in tasks(found):
        returns(found, task)


def runs() -> dict[tuple[str, str], list[list[dict]]]:
    """`{(task, variant): runs}`; a run are the rows of a seed, by step."""
    out: dict[tuple[str, str], list[list[dict]]] = {}
    a_step = rates()
    for path in sorted(RESULTS.glob("*.csv")):
        if "-brax-alone" in path.stem:
            continue
        rows = read(path)
        task, kind = named(rows[0]["job"])
        if "-steps" in path.stem or "-shared" in path.stem:
            rate = a_step.get(task, np.nan) if kind.startswith("brax") else np.nan
            rows = [row | {"seconds": f"{rate * float(row['sim_steps'])}"} for row in rows]
        for seed in dict.fromkeys(row["seed"] for row in rows):
            of_seed = [row for row in rows if row["seed"] == seed]
            out.setdefault((task, kind), []).append(of_seed)
    return out


def rates() -> dict[str, float]:
    """Seconds of a simulator step of brax's PPO, by task, in the mean over its runs alone on a card."""
    alone = [path for path in sorted(RESULTS.glob("*-brax-*.csv")) if "-shared" not in path.stem]
    each: dict[str, list[float]] = {}
    for path in alone:  # between the first evaluation and the last: the first step is slower
        (first, *_, last), numbers = read(path), ("seconds", "sim_steps")
        took, steps = (float(last[name]) - float(first[name]) for name in numbers)
        each.setdefault(named(last["job"])[0], []).append(took / steps)
    return {task: float(np.mean(some)) for task, some in each.items()}


def read(path: Path) -> list[dict]:
    with path.open() as file:
        return [*csv.DictReader(file)]


def named(job: str) -> tuple[str, str]:
    """`(task, variant)` of `playground:TASK:VARIANT FIELD=VALUE ...` or `brax:TASK NAME=VALUE ...`."""
    of, *about = job.split()
    kind, task, *variant = of.split(":")
    resets = next((text.partition("=")[2] for text in about if text.startswith("resets=")), "")
    if kind == "brax" and f"brax{resets}" in BRAX:
        kind += resets
    return task, variant[0] if variant else kind


def tasks(found) -> list[str]:
    """In the order of jobs.txt."""
    asked = [line.split()[1].split(":")[1] for line in JOBS.read_text().splitlines()]
    return sorted(dict.fromkeys(task for task, _ in found), key=asked.index)


def whole(some) -> list[list[dict]]:
    """The runs that were not cut off: they have the evaluations that their job asks for, if it says so."""

    def asked(rows):
        fields = dict(text.split("=", 1) for text in rows[0]["job"].split() if "=" in text)
        return int(fields.get("evals", 0))

    return [rows for rows in some if len(rows) >= asked(rows)]


def both_ways(some) -> list[list[list[dict]]]:
    """All runs of a kind, and without those that were cut off, where that is another choice."""
    return [some] + ([rest] if (rest := whole(some)) and len(rest) < len(some) else [])


def reference(found, task: str) -> float:
    """The most that brax's PPO has, or ours, in the mean over runs; NaN without either."""
    kinds = [found[task, kind] for kind in BRAX if (task, kind) in found]
    some = [runs for kind in kinds for runs in both_ways(kind)]
    some = some or [found[task, "ppo"]] if (task, "ppo") in found else some
    most = [np.mean([max(float(row["return"]) for row in rows) for rows in runs]) for runs in some]
    return float(max(most, default=np.nan))


def when(row: dict) -> tuple[float, float]:
    """Millions of simulator steps, seconds."""
    return float(row["sim_steps"]) / 1e6, float(row["seconds"])


def first(rows: list[dict], level: float) -> tuple[float, float]:
    """M steps and seconds until a run first has `level`: on a straight line between two evaluations, or those
    of its first evaluation; NaN if it never has it."""
    curve = np.array([(*when(row), float(row["return"])) for row in rows])
    steps, took = curve[0, :2] if curve[0, 2] >= level else to_return(curve, level)
    return float(steps), float(took)


def first_cells(some, level: float) -> list[str]:
    if np.isnan(level):
        return ["-", "-"]
    each = np.array([first(rows, level) for rows in some])
    never = int(np.isnan(each[:, 0]).sum())
    if never == len(each):
        return ["never", "never"]
    there = each[~np.isnan(each[:, 0])]
    steps = f"{there[:, 0].mean():.1f}" + (f", {never} never" if never else "")
    return [steps, average(there[:, 1]) if np.isfinite(there).all() else "-"]


def average(numbers) -> str:
    """Of those that are there, without decimals."""
    there = [x for x in numbers if np.isfinite(x)]
    return f"{np.mean(there):.0f}" if there else "-"


def mean(some, between: bool = False) -> np.ndarray:
    """M steps, seconds (NaN where no run was alone), return and falls in the mean over runs, `[E, 4]`.

    At evaluations that two seeds have, or the only one; with `between` at those of any run, where two seeds
    are on their way: on a straight line between two evaluations of a run, at most `LINE` apart.
    """
    names = "return", "fall_rate"
    curves = [
        np.array([(*when(row), *(float(row[k]) for k in names)) for row in rows]) for rows in some
    ]
    seeds = [rows[0]["seed"] for rows in some]
    enough, out = min(2, len(set(seeds))), []
    for at in np.unique(np.concatenate([curve[:, 0] for curve in curves])):
        there = [apart(curve[:, 0], at) <= LINE * between for curve in curves]
        if len({*compress(seeds, there)}) >= enough:
            each = [[np.interp(at, x[:, 0], y) for y in x.T] for x in compress(curves, there)]
            each = np.array(each)
            alone = each[np.isfinite(each[:, 1]), 1]
            out.append([at, alone.mean() if len(alone) else np.nan, *each[:, 2:].mean(0)])
    return np.array(out)


def apart(points: np.ndarray, at: float) -> float:
    """How far apart those two of the rising `points` are that `at` is between: 0 if it is one, else inf."""
    if at in points:
        return 0.0
    after = np.searchsorted(points, at)
    return points[after] - points[after - 1] if 0 < after < len(points) else np.inf


def to_return(curve: np.ndarray, level: float) -> np.ndarray:
    """M steps and seconds `[2]` where a curve of `mean` first has `level`, on a straight line between two
    evaluations; NaN where it never has, or has it in its first evaluation."""
    above = curve[:, 2] >= level
    if not above.any() or above[0]:
        return np.full(2, np.nan)
    (*low, less), (*high, more) = curve[above.argmax() - 1, :3], curve[above.argmax(), :3]
    return low + (level - less) / (more - less) * (np.array(high) - low)


def beside(found) -> None:
    """Steps and seconds of `best` and of brax's PPO at equal returns, how many times those of `best`, and the
    steps of our PPO."""
    heads = (
        "`best`: M steps, s | brax's PPO | times the steps | times the seconds | our PPO: M steps"
    )
    print(f"| task | return | {heads} |")
    print("|---" * 7 + "|")
    for task in tasks(found):
        kinds = [found[task, kind] for kind in BRAX if (task, kind) in found]
        theirs = [mean(some, True) for runs in kinds for some in both_ways(runs)]
        if (task, "best") not in found or not theirs:
            continue
        ours = mean(found[task, "best"])
        ppo = mean(found[task, "ppo"], True) if (task, "ppo") in found else None
        for *mine, level, _ in ours[ours[:, 2] == np.maximum.accumulate(ours[:, 2])]:
            if any(curve[0, 2] >= level for curve in theirs):
                continue  # it got there sooner than anybody looked
            others = [to_return(curve, level) for curve in theirs]
            other = min(others, key=lambda x: np.nan_to_num(x[0], nan=np.inf))
            if np.isfinite(other[0]):
                both = [f"{steps:.1f}, {average([took])}" for steps, took in (mine, other)]
                third = np.nan if ppo is None else to_return(ppo, level)[0]
                numbers = [f"{x:.1f}" if np.isfinite(x) else "-" for x in (*(other / mine), third)]
                print(f"| {task} | {level:.1f} | {' | '.join(both + numbers)} |")
    print()


def returns(found, task: str) -> None:
    """Returns and falls in the mean over runs, in every evaluation of `mean`."""
    print(f"{task}: M steps: return, falls\n")
    for kind, name in KINDS.items():
        some = found.get((task, kind))
        if some:
            curve = mean(some, kind != "best")
            cells = (f"{at:.1f}: {back:.1f}, {fell:.0%}" for at, _, back, fell in curve)
            print(f"- {name}:", "; ".join(cells))
    print()


if __name__ == "__main__":
    main()

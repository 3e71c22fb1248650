"""Seconds and simulator steps to the level and to a walk, `best` beside PPO, by what a simulated row costs.

    python experiments/30_row_cost/table.py                          # the tables of README.md and runs.md
    python experiments/30_row_cost/table.py --add BATCH FOLDER ...   # adds or replaces jobs of run.py

Runs are those of results/alone.csv.xz, one at a time on their device, and those of 25_humanoid and 04_laptop
that were. A name is PLACE.METHOD: a place is a robot, task and engine; METHOD is `best`, one with settings
for seconds (`tune-`: on the seeds among which they are chosen), or `ppo` with its robots, at some places x
its rows (`-walk`: tuned to walk, `-often`: evaluated as often as `best` for seconds, beside which alone it
stands). A job `again-METHOD` is that setting on new seeds, by a rule set before. BATCH says card and date;
the clock of a seed that ran more than once is the median. What the level is, and a walk:
dynappo/policy/walks.py.

Computed: `later` gives a run's seconds if its rows cost more, from its own clock and rows. `break_even` is
the cost at which `best` and the fastest PPO take equally long; "for seconds": a setting for seconds and PPO.
"""

import collections
import csv
import importlib
import lzma
import math
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo.policy import walks
from dynappo.terrain import tiles
from experiments import paper, stats

humanoid = importlib.import_module("experiments.25_humanoid.table")
rough = importlib.import_module("experiments.28_rough.table")
laptop = importlib.import_module("experiments.04_laptop.table")

RESULTS = Path(__file__).parent / "results/alone.csv.xz"
COUNTED = ("iteration", "sim_steps", "seconds")
COLUMNS = (
    "batch name job device commit seed run row_ms tail_ms fit_ms ppo_ms iteration sim_steps seconds return "
    "fall_rate tracking_error yaw_error crossed fell"
).split() + [*tiles.KINDS]
H100, H200, G1, CORES = (
    "H100, 2026-11-25",
    "H200, 2026-11-25",
    "H200, 2026-11-26",
    "two cores, 2026-11-22",
)
ROWS = {  # ms of a row of 1024 robots where runs do not have it; runs.md says from where
    ("go1.kernel", H100): 0.18,
    ("go1.kernel", H200): 0.18,
    ("g1.kernel", G1): 0.54,
    ("g1.warp", G1): 4.46,
    ("go1.laptop", CORES): 2 * 16.3,
}
BUSY = {("PPO, 256", "900"), ("PPO, 2048", "900"), ("PPO, 2048", "901")}  # left out there, too
# a row of R robots costs (R / 1024) ** POWER times one of 1024
POWERS = {"a GPU": math.log(2.98 / 2.2) / math.log(4), "two cores": 1.0}
MANY, OFTEN = 3, 5  # seeds of a choice, and of an interval
TUNING = "tune-"  # so begin settings of `best` on seeds 0 to 2, among which one is chosen
AGAIN = "again-"  # so begin jobs that run a setting once more, on new seeds
# so end PPO's that were evaluated as often in seconds as `best` for seconds, not as `best`
FOR_SECONDS = "-often"
# where walks are not compared: they hang on how often and how long one is evaluated
NO_WALKS = {"go2.rough"}
# of a Go1 whose feet were not lifted, before commands were mended; CORES too, whose PPO has two seeds
TASK_BEFORE = (H100, H200)
COSTS = np.geomspace(0.1, 100, 601)  # ms


class Run(NamedTuple):
    """Seeds of a setting at a place."""

    place: str
    batch: str
    method: str
    robots: int
    level: np.ndarray  # [S, 3]: iteration, simulator steps, seconds; NaN: never
    walks: np.ndarray
    row: float  # ms, of a row of its robots; NaN: not measured
    end: float = math.nan  # simulator steps of a whole run
    last: float = math.nan  # and its seconds, in the mean


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--add", metavar="BATCH")
    args = parser.parse_args()
    if args.add:
        add(args.add, args.folders)
    found = runs()
    print(table(found), compared(found), sep="\n\n")


# ---- files


def read() -> list[dict]:
    with lzma.open(RESULTS, "rt", newline="") as file:
        return list(csv.DictReader(file))


def add(batch: str, folders: list[Path]) -> None:
    """Into results/alone.csv.xz, in place of jobs of that batch with the same names."""
    new = []
    for path in sorted(path for folder in folders for path in folder.glob("*.csv")):
        if "." not in path.stem:  # 27_few/table.py --pack takes those
            raise SystemExit(
                f"{path} is not added: expected a name PLACE.METHOD, as go1.kernel.best"
            )
        with path.open(newline="") as file:
            new += [{"batch": batch, "name": path.stem} | row for row in csv.DictReader(file)]
    again = {(row["batch"], row["name"]) for row in new}
    kept = [row for row in read() if (row["batch"], row["name"]) not in again]
    of_rows(kept + new)  # before the file is touched
    with lzma.open(RESULTS, "wt", newline="", preset=9) as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept + new)


# ---- runs


def runs() -> list[Run]:
    """All of them, place by place."""
    found = [*of_rows(read()), *of_humanoid(), *of_laptop()]
    return sorted(found, key=lambda run: (cost(found, run), run.place, run.batch))


def of_rows(rows: list[dict]) -> list[Run]:
    """The runs of results/alone.csv.xz."""
    jobs = collections.defaultdict(lambda: collections.defaultdict(list))
    for row in rows:
        jobs[row["batch"], row["name"]][row["seed"], row.get("run", "")].append(row)
    found = [of_job(key[0], key[1], list(job.values())) for key, job in jobs.items()]
    counts = collections.Counter(run[:3] for run in found)
    for (place, batch, method), count in counts.items():
        if count > 1:
            raise SystemExit(
                f"{place}.{method} is twice in {batch}, once as {AGAIN}: expected one of them a batch"
            )
    return found


def of_job(batch: str, name: str, each: list[list[dict]]) -> Run:
    place, _, method = name.rpartition(".")
    if method.startswith(AGAIN):
        method = method.removeprefix(AGAIN)
        method = method if method.startswith(("best", "ppo")) else f"best-{method}"
    by_seed = collections.defaultdict(list)
    for rows in each:
        by_seed[rows[0]["seed"]].append(reached(rows))
    level, walking = np.array([np.median(again, 0) for again in by_seed.values()]).transpose(
        1, 0, 2
    )
    first = each[0][0]
    rows_ms = {rows[0].get("row_ms") or "nan" for rows in each}  # each process measured its own
    row = float(np.mean([float(ms) for ms in rows_ms]))
    end = max(float(row["sim_steps"]) for rows in each for row in rows)
    last = float(np.mean([float(rows[-1]["seconds"]) for rows in each]))
    return Run(place, batch, method, robots(first["job"]), level, walking, row, end, last)


def robots(job: str) -> int:
    given = dict(field.split("=", 1) for field in job.split()[1:])
    of_variant = {"laptop": 512, "rough": 2048}.get(job.split()[0].partition(":")[2], 1024)
    return int(given.get("rollout.num_envs", of_variant))


def reached(rows: list[dict]) -> np.ndarray:
    """`[2, 3]`: iteration, simulator steps and seconds to the level, and until it walks; NaN: never.

    Of a G1 the level is one of errors, on rough ground one of crossings, whatever falls; there a robot
    walks from where on it is at the level.
    """
    job = rows[0]["job"]

    def column(name):
        return [float(row[name]) for row in rows]

    if rows[0].get("crossed"):
        good = [2.0 * rough.at_level(rough.shares(row)) for row in rows]
        measured = partial(stats.reached, returns=good, fall_rates=[0.0] * len(rows), least=1)
    elif job.startswith("g1"):
        names = {"errors": "tracking_error", "yaw_errors": "yaw_error", "fall_rates": "fall_rate"}
        errors = {argument: column(name) for argument, name in names.items()}
        measured = partial(stats.reached_by_tracking, **errors)
    else:
        least = walks.level(45 if job.startswith("go") else 30)
        returns, falls = column("return"), column("fall_rate")
        measured = partial(stats.reached, returns=returns, fall_rates=falls, least=least)
    found = [measured(column(name)) for name in COUNTED]
    return np.array([[one.level for one in found], [one.walks for one in found]])


def of_humanoid() -> list[Run]:
    """The runs of 25_humanoid that had a card alone."""
    jobs = collections.defaultdict(list)
    for engine, name, rows in humanoid.runs_alone():
        if (name, rows[0]["seed"]) not in BUSY or engine != "kernel":
            jobs["kernel" if engine == "kernel" else "warp", name].append(rows)
    found = []
    for (engine, name), each in jobs.items():
        method = name.replace("PPO, ", "ppo").replace(" x ", "x")  # as jobs.txt names them
        run = of_job(G1, f"g1.{engine}.{method}", each)
        count = int(name.split()[1].strip(",")) if "PPO" in name else 1024
        found.append(run._replace(robots=count))
    return found


def of_laptop() -> list[Run]:
    """The runs of 04_laptop; seconds are iterations by those of two idle cores."""
    found = []
    for name in ("go1", "ppo16", "ppo24"):
        each = [
            [row | {"sim_steps": row["steps"], "job": run["job"], "seed": k} for row in run["rows"]]
            for k, run in enumerate(laptop.runs(name))
        ]
        method = "best" if name == "go1" else f"ppo512x{name[3:]}"
        found.append(of_job(CORES, f"go1.laptop.{method}", each))
    return found


# ---- what a row costs


def cost(found: list[Run], run: Run) -> float:
    """ms of a simulated row of 1024 robots at a run's place, in its batch: measured with that many, or with
    the number that is nearest."""
    own = [one for one in found if (one.place, one.batch) == (run.place, run.batch)]
    some = [one for one in own if one.row == one.row]
    if not some:
        return ROWS.get((run.place, run.batch), math.nan)
    near = min(abs(math.log(one.robots / 1024)) for one in some)
    some = [one for one in some if abs(math.log(one.robots / 1024)) == near]
    power = power_of(run.place)
    return float(np.mean([one.row * (1024 / one.robots) ** power for one in some]))


def power_of(place: str) -> float:
    return POWERS["two cores" if place.endswith("laptop") else "a GPU"]


def later(run: Run, before: float, after, power: float) -> np.ndarray:
    """Seconds to the level, `[S, ...]`, if a row of 1024 robots cost `after` ms `[...]`, not `before`.

    seconds + rows (after - before) (robots / 1024) ^ power
    """
    after = np.asarray(after, float)
    rows, seconds = run.level[:, 1] / run.robots, run.level[:, 2]
    more = (after - before) * (run.robots / 1024) ** power / 1e3
    return seconds.reshape(-1, *[1] * after.ndim) + rows.reshape(-1, *[1] * after.ndim) * more


def at_cost(found: list[Run], run: Run, ms: float) -> Run:
    """A run as if its rows had cost `ms`, as those of another host do; all else as its own host took it."""
    seconds = later(run, cost(found, run), ms, power_of(run.place))
    return run._replace(level=np.column_stack([run.level[:, :2], seconds]))


def there(run: Run) -> float:
    """The share of its seeds that get to the level."""
    return float(np.isfinite(run.level[:, 0]).mean())


def steps(run: Run) -> np.ndarray:
    """Simulator steps to the level, `[S]`; of a seed that does not get there those of its whole run, which
    are too few."""
    return np.where(np.isfinite(run.level[:, 1]), run.level[:, 1], run.end)


def settings(found: list[Run], place: str) -> tuple[Run, list[Run]] | None:
    """`(best, PPO's)` of a place. Of the runs of `best` all of whose seeds get to the level, in this order:

    - one of five seeds or more, else of most;
    - beside it, on its host, five seeds of a setting of PPO that all get to the level. One of another host
      may be cheaper or dearer, and beside it fewer settings of PPO may have run;
    - the last day;
    - on its host most settings of PPO.

    Of PPO the settings of which more than half of the seeds get there. None where `best` or PPO has not been
    run, or no setting of PPO always gets there."""
    here = [run for run in found if run.place == place]
    mine = [run for run in here if run.method == "best" and there(run) == 1]
    both = [(run, [ppo for ppo in beside(here, run) if there(ppo) > 0.5]) for run in mine]
    both = [pair for pair in both if any(there(ppo) == 1 for ppo in pair[1])]

    def worth(pair):
        best, ppos = pair
        whole = [ppo for ppo in ppos if there(ppo) == 1 and len(ppo.level) >= OFTEN]
        often = any(ppo.batch == best.batch for ppo in whole)
        own = [ppo for ppo in ppos if ppo.batch == best.batch]
        return min(len(best.level), OFTEN), often, day(best)[1], len(own)

    return max(both, key=worth, default=None)


def fewest(found: list[Run], best: Run, ppos: list[Run]) -> Run:
    """The setting of PPO of fewest steps: of `ppos`, and of those that ran on other days alone, at the place
    of `best` and on its kind of card, with as many seeds as an interval needs, more than half of which get
    there; the oftener one was evaluated, the fewer. Not where the task was another."""
    named = {ppo.method for ppo in ppos}
    some = [run for run in found if run.place == best.place and day(run)[0] == day(best)[0]]
    some = [run for run in some if run.method.startswith("ppo") and run.method not in named]
    some = [run for run in some if len(run.level) >= OFTEN and there(run) > 0.5]
    return sparing([*ppos, *(run for run in some if run.batch not in TASK_BEFORE)])


def is_ppo(run: Run) -> bool:
    """One of PPO that may stand beside `best`."""
    return run.method.startswith("ppo") and not run.method.endswith(FOR_SECONDS)


def beside(some: list[Run], best: Run) -> list[Run]:
    """The settings of PPO on the kind of card and the day of `best`, else on that kind of card: of each the
    host of `best` if it has as many seeds as an interval needs, else that with most; of equals one on which
    `best` with settings for seconds ran, too."""
    ppos = near([run for run in some if is_ppo(run)], best)
    quick = {run.batch for run in some if run.method.startswith("best-")}

    def worth(run):
        count = len(run.level)
        return min(count, OFTEN), run.batch == best.batch, count, run.batch in quick

    found = {}
    for run in sorted(ppos, key=worth):
        found[run.method] = run
    return [*found.values()]


def near(some: list[Run], best: Run) -> list[Run]:
    """Those on the kind of card of `best`: of its day, or of all days if none is."""
    some = [run for run in some if day(run)[0] == day(best)[0]]
    return [run for run in some if day(run) == day(best)] or some


def day(run: Run) -> list[str]:
    """The kind of card and the date of its batch; what else is there says which host."""
    return run.batch.split(", ")[:2]


def host_beside(run: Run, best: Run) -> str:
    """What of its batch is not that of `best`: the host, and the day if it is another."""
    if run.batch == best.batch:
        return ""
    same = 2 if day(run) == day(best) else 1
    return "".join(f", {part}" for part in run.batch.split(", ")[same:])


def variants(found: list[Run], best: Run) -> list[Run]:
    """`best`, and its settings for seconds at the same place, on the same kind of card and day (else on
    others), with as many seeds as say something; those that were tuned, `tune-`, only where none has run on
    fresh seeds."""
    here = [run for run in found if run.place == best.place and len(run.level) >= MANY]
    some = [run for run in here if there(run) == 1]
    fresh = near([run for run in some if run.method.startswith("best-")], best)
    return [best, *(fresh or near([run for run in some if run.method.startswith(TUNING)], best))]


def fastest(some: list[Run]) -> Run:
    """With the fewest seconds in the mean, of those that always get there, and of these of those with `MANY`
    seeds or more, if there are any."""
    some = [run for run in some if there(run) == 1]
    many = [run for run in some if len(run.level) >= MANY]
    return min(many or some, key=lambda run: run.level[:, 2].mean())


def fastest_beside(best: Run, ppos: list[Run]) -> Run:
    """PPO's fastest setting of those that ran on the host of `best` with as many seeds as an interval needs,
    all of which get there; of all of them where there is none."""
    own = [ppo for ppo in ppos if ppo.batch == best.batch and len(ppo.level) >= OFTEN]
    return fastest([ppo for ppo in own if there(ppo) == 1] or ppos)


def sparing(some: list[Run]) -> Run:
    """With the fewest simulator steps in the mean, of those with two seeds or more, if there are any."""
    several = [run for run in some if len(run.level) > 1]
    return min(several or some, key=lambda run: steps(run).mean())


def walking(run: Run, ppos: list[Run], column: int) -> Run:
    """`run` of PPO, if all its seeds walk, else that of its settings with `OFTEN` seeds of which most do; of
    equals that with the smaller mean of `column` until then, and `run` where none does."""
    if np.isfinite(run.walks).all():
        return run

    def worth(one):
        known = one.walks[np.isfinite(one.walks[:, column]), column]
        return -len(known) / len(one.walks), known.mean() if len(known) else one is not run

    return min([one for one in ppos if len(one.walks) >= OFTEN] or [run], key=worth)


def break_even(
    best: Run, ppos: list[Run], before: float, power: float
) -> tuple[float, float, float]:
    """ms of a row of 1024 robots at which `best` and the fastest PPO take equally long; from which and up to
    which Welch's 95 % interval of the difference has a 0 in it."""
    at = {run.method: later(run, before, COSTS, power) for run in ppos}
    mine = later(best, before, COSTS, power)
    means = np.array([times.mean(0) for times in at.values()])
    named = [*at]
    even, equal = math.nan, []
    for k, ms in enumerate(COSTS):
        other = at[named[means[:, k].argmin()]][:, k]
        gain = stats.difference(other, mine[:, k])
        even = ms if math.isnan(even) and gain.value > 0 else even
        if gain.low <= 0 <= gain.high:
            equal.append(ms)
    return even, min(equal, default=math.nan), max(equal, default=math.nan)


# ---- tables


def table(found: list[Run]) -> str:
    head = ["place", "ms a row", "where", "run", "seeds", "level: iterations", "M steps", "seconds"]
    head += ["walks: seeds", "M steps", "seconds"]
    lines = []
    for run in found:
        reached, steps, seconds = cells(run.walks)
        total, (_, *level) = len(run.level), cells(run.level)
        known = run.level[np.isfinite(run.level[:, 0]), 0]
        iterations = f"{known.mean():.0f}" if len(known) else "-"
        seeds = f"{total}" if len(known) == total else f"{len(known)} of {total}"
        lines.append(
            [run.place, f"{cost(found, run):.3g}", run.batch, run.method, seeds, iterations, *level]
            + [reached, steps, seconds]
        )
    return paper.markdown(head, lines)


def cells(reached: np.ndarray) -> list[str]:
    """How many of the seeds `[S, 3]` got there; million steps and seconds of these."""
    _, steps, seconds = reached.T
    count = int(np.isfinite(seconds).sum())
    some = str(count) if count == len(reached) else f"{count} of {len(reached)}"
    return [some, interval(steps / 1e6), interval(seconds)] if count else [some, "-", "-"]


def interval(values) -> str:
    """Mean, and of three or more half of its t interval."""
    found = stats.moments(values)
    return f"{found.mean:.2f}" + (f" ± {stats.half_of(found):.2f}" if found.n >= MANY else "")


def compared(found: list[Run]) -> str:
    """A line a place: `best` beside PPO's fastest and its most sparing setting; where they break even."""
    head = ["place", "ms a row", "`best`, s", "`best` for seconds", "PPO, s", "s, PPO / `best`"]
    head += ["steps, PPO / `best`", "break-even, ms", "to a walk, ms"]
    lines = []
    for place in dict.fromkeys(run.place for run in found):
        if not (pair := settings(found, place)):
            continue
        best, ppos = pair
        fast, ms = fastest_beside(best, ppos), cost(found, best)
        few = fewest(found, best, ppos)
        times = [run.level[:, 2] for run in (fast, best)]
        more = "at least " * (there(few) < 1) + ratio(steps(few), steps(best))
        quick = fastest(variants(found, best))
        cells = [place, f"{ms:.3g}", interval(times[1])]
        named = quick.method + ", tuning seeds" * quick.method.startswith(TUNING)
        named += host_beside(quick, best)
        cells += ["-" if quick is best else f"{interval(quick.level[:, 2])} ({named})"]
        cells += [f"{interval(times[0])} ({fast.method})"]
        cells += [ratio(*times), f"{more} ({few.method}{host_beside(few, best)})"]
        here = [at_cost(found, ppo, ms) for ppo in ppos]
        equal = even(best, here, ms) + for_seconds(found, quick, ppos) * (quick is not best)
        walking = [at_cost(found, to_walk(ppo), ms) for ppo in ppos]
        walk = "-" if place in NO_WALKS else even(to_walk(best), walking, ms)
        lines.append([*cells, equal, walk])
    return paper.markdown(head, lines)


def for_seconds(found: list[Run], quick: Run, ppos: list[Run]) -> str:
    """Where a setting of `best` for seconds and PPO break even: `ppos`, or where PPO was evaluated as often,
    that; of these those that ran on its own host with as many seeds as an interval needs, if the fastest is
    one of them, else all. All rows are at the cost of its host, or of that of the fastest."""
    often = [run for run in found if run.place == quick.place and run.method.endswith(FOR_SECONDS)]
    ppos = near(often, quick) or ppos
    fast, named = fastest(ppos), {ppo.method for ppo in ppos}
    own = [run for run in found if run[:2] == quick[:2] and run.method in named]
    own = [run for run in own if len(run.level) >= OFTEN]
    alike = fast.method in {run.method for run in own}
    ms = cost(found, quick if alike else fast)
    ppos = [at_cost(found, ppo, ms) for ppo in (own if alike else ppos)]
    return f"; for seconds {even(at_cost(found, quick, ms), ppos, ms)}"


def to_walk(run: Run) -> Run:
    """One that counts to a walk, not to the level."""
    return run._replace(level=run.walks)


def even(best: Run, ppos: list[Run], ms: float) -> str:
    """`break_even` of runs with `MANY` seeds, all of which get there."""
    able = [run for run in (best, *ppos) if len(run.level) >= MANY and there(run) == 1]
    if len(able) < 2 or able[0] is not best:
        return "-"
    at, low, high = break_even(best, able[1:], ms, power_of(best.place))
    # no smaller cost is computed, and no larger one
    at, low = ("below 0.1" if ms == COSTS[0] else f"{ms:.2g}" for ms in (at, low))
    return f"{at} ({low} to {'over 100' if high == COSTS[-1] else f'{high:.2g}'})"


def ratio(one, other) -> str:
    """Of means, with Fieller's 95 % interval where both have three seeds or more."""
    found = stats.ratio(one, other)
    if min(len(one), len(other)) < MANY:
        return f"{found.value:.2g}"
    return f"{found.value:.2g} ({found.low:.2g} to {found.high:.2g})"


if __name__ == "__main__":
    main()

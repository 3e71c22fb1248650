"""`fast`, the paper's tail with a cheap fit, `dyna4` and PPO-16: seconds until the return is first 38.

    python experiments/13_step_time/fast.py

The runs of fast.txt in results/fast, one at a time on one GPU. It prints what they took to the level and to
a walk, the ratios to PPO-16 on the same engine, what an iteration takes by phase and on the clock, and the
seconds of `dyna4` if its fit took as long as in TF32 (results.csv), computed. A seed that is not at the level
by its end counts with its whole run.
"""

import csv
import importlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo import schedule
from experiments import paper, run, stats

plot = importlib.import_module("experiments.13_step_time.plot")
row_cost = importlib.import_module("experiments.30_row_cost.table")

HERE = Path(__file__).parent
ENGINES = {"kernel": "our kernel", "warp": "MuJoCo Warp"}
METHODS = ("ppo16", "fast", "dyna4")

LATE = 100  # from this iteration on the schedule of a tail changes nothing


class Timed(NamedTuple):
    """The seeds of a job."""

    level: np.ndarray  # [S, 3] as row_cost.COUNTED; the whole run of a seed that never gets there
    there: np.ndarray  # [S] whether it does
    walks: np.ndarray  # [S, 3]; NaN: never
    clock: np.ndarray  # [S, E + 1, 2]: iteration and seconds, from 0 on
    phases: dict[str, float]  # ms, as row_cost's run.py names them


def main():
    paper.parser(__doc__).parse_args()
    found = read(HERE / "results/fast")
    print(table(found), compared(found), phases(found), tf32(found), sep="\n\n")


def read(folder: Path) -> dict[tuple[str, str], Timed]:
    """`(engine, method) -> Timed`, in the order of the tables."""
    found = {}
    for engine in ENGINES:
        for method in METHODS:
            path = folder / f"go1.{engine}.{method}.csv"
            if path.exists():
                with path.open(newline="") as file:
                    found[engine, method] = timed(list(csv.DictReader(file)))
    return found


def timed(rows: list[dict[str, str]]) -> Timed:
    names = dict.fromkeys(row["seed"] for row in rows)
    seeds = [[row for row in rows if row["seed"] == name] for name in names]
    level, walks = np.array([row_cost.reached(each) for each in seeds]).transpose(1, 0, 2)
    ends = np.array([[float(each[-1][name]) for name in row_cost.COUNTED] for each in seeds])
    clock = [
        [(0.0, 0.0), *((float(row["iteration"]), float(row["seconds"])) for row in each)]
        for each in seeds
    ]
    there = np.isfinite(level[:, 0])
    phases = {name: float(rows[0][name] or 0) for name in ("row_ms", "tail_ms", "fit_ms", "ppo_ms")}
    return Timed(np.where(there[:, None], level, ends), there, walks, np.array(clock), phases)


def ms(one: Timed, first: int = 0) -> np.ndarray:
    """Of an iteration after `first`, a mean a seed, `[S]`."""
    begin = list(one.clock[0, :, 0]).index(first)
    iterations, seconds = (one.clock[:, -1] - one.clock[:, begin]).T
    return 1e3 * seconds / iterations


def table(found) -> str:
    head = ["engine", "", "ms an iteration", f"after {LATE}", "at 38: seeds", "iterations"]
    head += ["M steps", "seconds", "walks: seeds", "seconds"]
    lines = []
    for (engine, method), one in found.items():
        iterations, steps, seconds = one.level.T
        _, _, walks = row_cost.cells(one.walks)
        walk = int(np.isfinite(one.walks[:, 0]).sum())
        cells = [ENGINES[engine], f"`{method}`", half(ms(one), 1), half(ms(one, LATE), 1)]
        cells += [f"{one.there.sum()} of {len(one.there)}", half(iterations, 0)]
        cells += [half(steps / 1e6, 1), half(seconds, 2)]
        lines.append([*cells, f"{walk} of {len(one.walks)}", walks])
    return paper.markdown(head, lines)


def half(values, digits: int) -> str:
    """Mean and half of its t interval."""
    one = stats.moments(values)
    return f"{one.mean:.{digits}f} ± {stats.half_of(one):.{digits}f}"


def compared(found) -> str:
    """Ratios to PPO-16 on the same engine."""
    head = ["ratio to `ppo16`", "", "seconds", "iterations", "steps", "seconds, seed by seed"]
    lines = []
    for (engine, method), one in found.items():
        if method != "ppo16":
            other = found[engine, "ppo16"].level
            iterations, steps, seconds = (
                stats.ratio(one.level[:, k], other[:, k]) for k in range(len(row_cost.COUNTED))
            )
            every = [seconds, iterations, steps, paired(one.level[:, 2], other[:, 2])]
            lines.append([ENGINES[engine], f"`{method}`", *map(around, every)])
    return paper.markdown(head, lines)


def around(one: stats.Around) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*one)


def paired(one, other) -> stats.Around:
    """Geometric mean of ratios of the same seed, and its interval by Student's t of their logarithms."""
    logs = stats.moments(np.log(one / other))
    wide = stats.half_of(logs)
    return stats.Around(*(float(np.exp(logs.mean + x)) for x in (0, -wide, wide)))


def phases(found) -> str:
    """ms of an iteration with the longest tail: each phase, their sum, and the clock after LATE."""
    head = ["ms", "", "real rows", "tail", "fit", "PPO", "sum", f"clock, after {LATE}"]
    lines = []
    for (engine, method), one in found.items():
        config, p = configured(method, one), one.phases
        real = int(schedule.columns(config)["n_real"][-1])
        tail = config.rollout.horizon - real
        every = [real * p["row_ms"], tail * p["tail_ms"], p["fit_ms"], p["ppo_ms"]]
        cells = [f"{x:.2f}" if x else "" for x in every]
        clock = f"{ms(one, LATE).mean():.2f}"
        lines.append([ENGINES[engine], f"`{method}`", *cells, f"{sum(every):.2f}", clock])
    return paper.markdown(head, lines)


def configured(method: str, one: Timed):
    return run.configure(f"go1:{method}", 1, [f"run.num_iterations={one.clock[0, -1, 0]:.0f}"])


def tf32(found) -> str:
    """`dyna4` by our kernel, if its fit took as long as that of results.csv."""
    cells = paper.pick(paper.rows(HERE / "results.csv"), simulator="kernel", variant="dyna4")
    one, base = found["kernel", "dyna4"], found["kernel", "ppo16"]
    seconds, mean = cheaper(one, configured("dyna4", one), cells["fit_mean"])
    times = around(stats.ratio(seconds, base.level[:, 2]))
    told = f"`dyna4` with a fit of {cells['fit_mean']:.1f} ms: {mean:.1f} ms an iteration, "
    return told + f"{half(seconds, 2)} s to the level, {times} times PPO-16's"


def cheaper(one: Timed, config, fit: float) -> tuple[np.ndarray, float]:
    """Seconds to the level `[S]`, and the mean ms of an iteration, if a fit of the last iteration took `fit`
    ms; earlier ones by their minibatches."""
    fits = plot.fits(config)
    less = np.cumsum(fits / fits[-1] * (one.phases["fit_ms"] - fit))
    seconds = one.level[:, 2] - less[one.level[:, 0].astype(int) - 1] / 1e3
    return seconds, float(ms(one).mean() - less[-1] / len(less))


if __name__ == "__main__":
    main()

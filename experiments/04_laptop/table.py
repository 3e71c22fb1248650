"""Tables in Markdown from the runs of walk.py in results/; curves.png from those of 30_row_cost.

    python experiments/04_laptop/table.py

Intervals are Student's t over seeds, 95 %. Many runs shared their machine, so seconds in the tables are
those of two idle cores: iterations times the time of one (`results/ms.json`, by walk.py), of `:laptop` those
of a whole run (`IDLE`). The picture has later runs, one at a time, each with its own clock.
"""

import importlib
import json
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from dynappo.run import learning_curves
from experiments import paper, pictures, stats

row_cost = importlib.import_module("experiments.30_row_cost.table")

HERE = Path(__file__).parent
RESULTS = HERE / "results"
SECONDS = (30, 45, 60, 90)  # of training
LEVEL = 35  # of 45
IDLE = "go1-103"  # a run that had the machine to itself
METHODS = {  # files -> label
    "go1": "`:laptop`: 8 simulated rows, a tail of 16",
    "ppo16": "PPO alone, 16 rows",
    "ppo24": "PPO alone, 24 rows",
}
DRAWN = {  # runs of 30_row_cost -> label, colour, dashes
    "go1.laptop.best": (":laptop, 512 robots, 8 of 24 rows simulated", pictures.BEST, "-"),
    "go1.laptop.ppo512": ("PPO alone, 512 robots, 24 rows", pictures.PPO, "-"),
    "go1.laptop.ppo256": ("PPO alone, 256 robots, 24 rows", pictures.PPO, (0, (5, 2))),
}


def main():
    paper.parser(__doc__).parse_args()
    print(robots(), in_time(), cores(), sep="\n\n")
    draw(HERE / "curves.png")


def runs(name: str) -> list[dict]:
    """The runs `results/seeds/NAME-SEED.json`, by seed."""
    ms = json.loads((RESULTS / "ms.json").read_text()).get(name)
    idle = json.loads((RESULTS / "seeds" / f"{IDLE}.json").read_text())["rows"]
    clock = [[row[n] for row in idle] for n in ("iteration", "seconds")]
    found = [json.loads(p.read_text()) for p in sorted((RESULTS / "seeds").glob(f"{name}-*.json"))]
    for run in found:
        for row in run["rows"]:
            i = row["iteration"]
            row["seconds"] = i * ms / 1000 if ms else float(np.interp(i, *clock))
    return found


def mean(values) -> str:
    """Mean and half of its interval."""
    if len(values) == 1:
        return f"{values[0]:.1f}"
    return f"{np.mean(values):.1f} ± {learning_curves.half_width(values):.1f}"


def walk(rows: list[dict], least: float) -> bool:
    """Whether a run's robot walks at its end: at the level `least`, with falls in at most 1 %."""
    columns = ([row[name] for row in rows] for name in ("steps", "return", "fall_rate"))
    return bool(np.isfinite(stats.reached(*columns, least).walks))


def robots() -> str:
    """The last evaluation of each robot's seeds."""
    lines = []
    for name, label in paper.ROBOTS.items():
        found = runs(name)
        if not found:
            continue
        last, least = [run["rows"][-1] for run in found], walks.level(45 if "go" in name else 30)
        keys = ("return", "fall_rate", "tracking_error", "yaw_error")
        total, falls, error, yaw = ([row[key] for row in last] for key in keys)
        cells = [label, f"{len(last)}", f"{sum(walk(run['rows'], least) for run in found)}"]
        cells += [mean(total), f"{100 * np.mean(falls):.1f} %, {100 * max(falls):.1f} %"]
        cells += [f"{np.mean(error):.2f} m/s, {max(error):.2f}"]
        lines.append([*cells, f"{np.mean(yaw):.2f} rad/s, {max(yaw):.2f}"])
    head = "robot|seeds|walk|evaluated|falls: mean, worst|tracking error|yaw error"
    return paper.markdown(head.split("|"), lines)


def at(run, key: str, seconds) -> np.ndarray:
    """A number of the evaluations between which `seconds` of training lie."""
    return np.interp(
        seconds, [row["seconds"] for row in run["rows"]], [row[key] for row in run["rows"]]
    )


def in_time() -> str:
    """The tail beside PPO alone after the same seconds of training."""
    lines = []
    for name, label in METHODS.items():
        if found := runs(name):
            total, falls = (
                np.mean([at(run, key, SECONDS) for run in found], 0)
                for key in ("return", "fall_rate")
            )
            cells = [f"{a:.1f}; {100 * b:.1f} %" for a, b in zip(total, falls, strict=True)]
            lines.append([label, f"{len(found)}", *cells])
    return paper.markdown(["evaluated; falls", "seeds", *(f"{s} s" for s in SECONDS)], lines)


def cores() -> str:
    """An iteration by the number of cores, and what a run came to."""
    lines, folder = [], RESULTS / "cores"
    for count in sorted(int(path.stem[5:]) for path in folder.glob("bench*.json")):
        (bench,) = json.loads((folder / f"bench{count}.json").read_text())["configs"].values()
        rows = json.loads((folder / f"walk{count}.json").read_text())["rows"]
        found = next(i for i, row in enumerate(rows) if row["return"] >= LEVEL)
        near = rows[found - 1 : found + 1]  # between two evaluations
        seconds = np.interp(LEVEL, *([row[n] for row in near] for n in ("return", "seconds")))
        ms, speed = bench["ms"], bench["control_steps_per_second"]
        cells = [f"{count}", f"{ms['iteration']:.0f} ms", f"{ms['physics']:.1f} ms"]
        lines.append([*cells, f"{ms['ppo']:.0f} ms", f"{speed:,.0f}", f"{seconds:.0f} s"])
    head = f"cores|iteration|a row of physics|PPO|control steps/s|{LEVEL} of 45 after"
    return paper.markdown(head.split("|"), lines)


def alone() -> dict[str, list[list[dict[str, float]]]]:
    """The runs of `DRAWN`: their seeds, and of each its evaluations."""
    found: dict[str, dict[str, list]] = {name: {} for name in DRAWN}
    for row in row_cost.read():
        if row["name"] in DRAWN:
            numbers = {
                key: float(row[key]) for key in ("sim_steps", "seconds", "return", "fall_rate")
            }
            found[row["name"]].setdefault(row["seed"], []).append(numbers)
    return {name: [*some.values()] for name, some in found.items()}


def draw(path: Path) -> None:
    """Evaluated return and falls over seconds and over simulator steps: means over seeds, and intervals."""
    page, axes = pictures.figure(2, 2, 5.4, sharex="col", sharey="row")
    found = alone()
    for column, (unit, scale) in zip(axes.T, (("seconds", 1), ("sim_steps", 1e6)), strict=True):
        for name, (label, colour, dash) in DRAWN.items():
            ends = [[run[i][unit] / scale for run in found[name]] for i in (0, -1)]
            grid = np.linspace(max(ends[0]), min(ends[1]), 60)
            for axis, (key, times) in zip(column, (("return", 1), ("fall_rate", 100)), strict=True):
                each = [
                    np.interp(scale * grid, [row[unit] for row in run], [row[key] for row in run])
                    for run in found[name]
                ]
                values = times * np.array(each).T
                pictures.band(axis, grid, values, colour, label, most=60, dash=dash)
        column[0].axhline(walks.level(45), color="0.4", lw=1, ls=":")
        pictures.falls(column[1])
    axes[0, 0].set(ylim=(0, 45), ylabel="evaluated return (of 45)", xlim=(0, 200))
    axes[1, 0].set(ylabel="episodes with a fall, %", xlabel="seconds of training, two cores")
    axes[1, 1].set(xlabel="million simulator steps", xlim=(0, 3.7))
    seeds = {len(some) for some in found.values()}
    text = f"Band: {pictures.covers(seeds)}. Dotted: follows its commands (38), and 1 % falls"
    pictures.head(page, text)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


if __name__ == "__main__":
    main()

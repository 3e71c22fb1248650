"""Table VI: how many simulator steps and iterations a return takes. results.csv and figure.

    python experiments/14_efficiency/plot.py [--quick] [--out DIR]

Trains nothing: reads the runs of 12_platforms and the best cell of 10_ablation (with --quick, those that
their --quick made).

README.md says what the thresholds are. `p_steps` is Welch's against PPO-16, `p_steps_rank` counts "never" as
last, and `p_steps_holm` is Holm's, over all comparisons to one threshold, of the first, or of the second
where a seed never gets there. "pooled" is against PPO-16 with the seeds of its earlier batches too.
"falls_there_pct" are those of a seed's first evaluation at the threshold "evaluated".
"""

from pathlib import Path
from typing import Any

import numpy as np

from dynappo.policy import walks
from experiments import batches, paper, pictures, stats

HERE = Path(__file__).parent
SHARED = ("seconds", "with_setup")  # clocks of processes that shared a GPU
# evaluated return
LEVEL = {robot: walks.level(45 if robot.startswith("go") else 30) for robot in paper.ROBOTS}
COLUMNS = (
    "robot threshold limit variant status seeds success_rate_pct sim_steps_M_mean sim_steps_M_low "
    "sim_steps_M_high share_of_ppo16_pct share_of_ppo16_low share_of_ppo16_high share_of_ppo16_bound "
    "p_steps p_steps_holm p_steps_rank pooled_pct pooled_low pooled_high pooled_p pooled_p_holm "
    "iterations_mean paper_sim_steps_M paper_iterations"
).split()


def main():
    args = paper.options(HERE, paper.parser(__doc__))
    make(args.out, Path("runs/quick") if args.quick else HERE.parent)


def make(out: Path, others: Path = HERE.parent) -> None:
    rows = build(others / "12_platforms" / "results", ablation_peak(others / "10_ablation"))
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(rows, out / "efficiency")


def ablation_peak(folder: Path) -> float | None:
    """The best cell's mean over seeds of the best return; None until it is measured."""
    cells = [row["max_reward_mean"] for row in paper.rows(folder / "results.csv")]
    return max(filter(None, cells), default=None)


def thresholds(robot: str, runs: dict, ablation: float | None) -> dict[str, float | None]:
    """Returns to be reached; None where it rests on runs that are not there."""
    base = runs["ppo16"]
    top = 0.8 * float(paper.peak(base).mean()) if base and base.columns else None
    last = {"80 % of PPO-16": top, "evaluated": LEVEL[robot]}
    if robot != "go1":  # the paper's table is of Go1
        return last
    best = None if ablation is None else 0.8 * ablation
    return {"paper, 30.5": paper.LIMIT, "80 % of the ablation's best": best} | last


def build(folder: Path, ablation: float | None) -> list[dict]:
    """A row a robot, threshold and variant."""
    rows = []
    for robot in paper.ROBOTS:
        runs = {name: paper.load(folder, f"{robot}_{name}") for name in paper.variants(robot)}
        for label, limit in thresholds(robot, runs, ablation).items():
            base = runs["ppo16"]
            some = [row(robot, label, limit, name, run, base) for name, run in runs.items()]
            if label != "evaluated":  # the earlier batches were not evaluated on the way
                add_pooled(some, runs, batches.earlier(folder, f"{robot}_ppo16"))
            for cells in some:
                if label.startswith("paper"):
                    cells |= theirs(cells["variant"])
            rows += some
    for label in dict.fromkeys(cells["threshold"] for cells in rows):
        tested = [r for r in rows if r["threshold"] == label and "p_steps_rank" in r]
        adjusted = stats.holm([cells.get("p_steps", cells["p_steps_rank"]) for cells in tested])
        for cells, p in zip(tested, adjusted, strict=True):
            cells["p_steps_holm"] = float(p)
        stats.adjust([r for r in rows if r["threshold"] == label], "pooled_p")
    return rows


def row(robot: str, label: str, limit: float | None, variant: str, run, base) -> dict:
    """What it took a variant to get to `limit`."""
    cells = {"robot": robot, "threshold": label, "limit": limit, "variant": variant}
    cells["status"] = paper.status(run)
    if limit is None and not cells["status"]:
        cells["status"] = "no threshold yet"
    if limit is None or not (run and run.columns):
        return cells
    how = paper.evaluated if label == "evaluated" else paper.reached
    cells |= {"seeds": len(paper.peak(run))} | paper.effort(run, limit, how)
    if label == "evaluated" and "eval_fall_rate" in run.columns:
        cells |= stats.spread("falls_there_pct", falls_there(run, limit))
    if base and base.columns and run is not base:
        cells |= paper.against(run, base, limit, how)
    return {name: value for name, value in cells.items() if not name.startswith(SHARED)}


def falls_there(run: paper.Run, limit: float) -> list[float]:
    """Per cent of episodes with a fall in the first evaluation at `limit`, of seeds that get there."""
    returns, falls = (run.columns[name] for name in ("eval_return", "eval_fall_rate"))
    rows = np.isfinite(returns).all(1)
    there = returns[rows] >= limit
    return [100 * falls[rows][at.argmax(), s] for s, at in enumerate(there.T) if at.any()]


def add_pooled(rows: list[dict], runs: dict, earlier) -> None:
    """To rows of one threshold: the same against PPO-16 with the seeds of its earlier batches."""
    if not earlier:
        return
    base = batches.pool([runs["ppo16"], earlier])
    for cells in rows:
        if "p_steps_rank" in cells:
            found = paper.against(runs[cells["variant"]], base, cells["limit"])
            names = {f"pooled_{n}": f"share_of_ppo16_{n}" for n in ("pct", "low", "high")}
            cells |= {ours: found.get(theirs) for ours, theirs in names.items()}
            cells["pooled_p"] = found.get("p_steps", found["p_steps_rank"])


def theirs(variant: str) -> dict:
    """The paper's row, and its steps as they follow from its iterations by our schedule."""
    printed = paper.pick(paper.table("efficiency"), variant=variant)
    if not printed:
        return {}
    names = ("success_rate_pct", "sim_steps_M", "iterations")
    cells = {f"paper_{name}": printed[name] for name in names}
    if printed["iterations"]:
        steps = paper.sim_steps(f"configs/go1.py:{variant}", int(printed["iterations"]))
        cells["paper_sim_steps_M_by_schedule"] = steps / 1e6
    return cells


def draw(rows, path: Path) -> None:
    """Go1: M simulator steps to each threshold, ours as marks with intervals, the paper's as diamonds; beside
    the last the falls of the first evaluation there.
    """
    labels = list(dict.fromkeys(r["threshold"] for r in rows if r["robot"] == "go1"))
    names = paper.variants("go1")
    page, axes = pictures.figure(2, 3, 5.6, sharey=True)
    for axis, label in zip(axes.flat, labels, strict=False):
        some = [r for r in rows if r["robot"] == "go1" and r["threshold"] == label]
        for y, variant in enumerate(names):
            cells = paper.pick(some, variant=variant)
            note, x = cells["status"], 0.3
            if "sim_steps_M_mean" in cells:
                pictures.bar(axis, cells, "sim_steps_M", y, look(cells))
                x = cells["sim_steps_M_high"] + 0.8
            if cells.get("success_rate_pct", 100) < 100:
                there = round(cells["success_rate_pct"] * cells["seeds"] / 100)
                note = f"{there} of {cells['seeds']}"
            axis.text(x, y, note, color="0.4", va="center")
            if cells.get("paper_sim_steps_M"):
                steps = cells["paper_sim_steps_M"]
                axis.plot(steps, y, "D", color="white", markeredgecolor="0.4", markersize=5)
        limit = some[0]["limit"]
        title = label + (f": {limit:.1f}" if limit and not label.startswith("paper") else "")
        axis.set_title(title, loc="left", fontsize=9.5)
        axis.set_xlabel("simulator steps (M)")
    pictures.variants(axes, names, 33)
    fell = axes[1, 1]  # beside the steps to it
    for y, variant in enumerate(names):
        cells = paper.pick(rows, robot="go1", threshold="evaluated", variant=variant)
        pictures.bar(fell, cells, "falls_there_pct", y, look(cells))
    fell.set_title("falls of the first evaluation at 38", loc="left", fontsize=9.5)
    fell.set(xlabel="% of episodes", xlim=(0, 3))
    axes[1, 2].set_visible(False)
    seeds = [r["seeds"] for r in rows if r["robot"] == "go1" and "seeds" in r]
    text = "Go1. White diamond: the paper. Hollow, with numbers: not all seeds get there; of those that do"
    if seeds:
        text = f"Bar: {pictures.covers(seeds)}.\n{text}"
    pictures.head(page, text, fontsize=9.5, color="0.35")
    pictures.save(page, path)


def look(cells) -> dict[str, Any]:
    """Of a variant's mark: hollow where not all seeds get there."""
    style = pictures.mark(cells["variant"])
    return style | {"mfc": "white"} if cells.get("success_rate_pct", 100) < 100 else style


if __name__ == "__main__":
    main()

"""Figures 7, 8 and 10: return, falls, policy std and learning rate over training, of all variants.

    python experiments/15_curves/plot.py [--quick] [--out DIR]

Trains nothing: reads the runs of 12_platforms (with --quick, those that its --quick made). Writes
results.csv, numbers at some iterations, rates.csv, each variant's learning rate as a share of PPO-16's in
`WINDOWS`, with Welch's p and Holm's over all of a window, and ROBOT.png of every robot that has a run; Go1's
always.
"""

from pathlib import Path

import numpy as np

from experiments import paper, pictures, stats

HERE = Path(__file__).parent
AT = (50, 100, 200, 300, 400, 500)  # iterations of the table
PANELS = (  # of a row of the page: x, y, title
    ("iteration", "episode_return", "return\n(figure 7)"),
    ("sim_steps", "episode_return", "return,\nby data"),
    ("iteration", "eval_fall_rate", "falls of\nevaluations, %"),
    ("iteration", "policy_std", "policy std\n(figure 8)"),
    ("iteration", "learning_rate", "learning rate\n(figure 10)"),
)
WINDOWS = {"early": (1, 100), "end": (461, 500)}  # iterations; early: the ramp of `dyna4`
METRICS = ("episode_return", "policy_std", "learning_rate", "velocity_error")


def main():
    args = paper.options(HERE, paper.parser(__doc__))
    make(args.out, Path("runs/quick") if args.quick else HERE.parent)


def make(out: Path, others: Path = HERE.parent) -> None:
    rows, rates, folder = [], [], others / "12_platforms" / "results"
    for robot, title in paper.ROBOTS.items():
        runs = {name: paper.load(folder, f"{robot}_{name}") for name in paper.variants(robot)}
        rows += [row for name, run in runs.items() for row in build(robot, name, run)]
        rates += beside(robot, runs)
        if robot == "go1" or any(run and run.columns for run in runs.values()):
            draw(runs, title, out / robot)
    paper.write(out / "results.csv", rows)
    for window in WINDOWS:
        stats.adjust([row for row in rates if row["window"] == window], "p")
    if rates:
        paper.write(out / "rates.csv", rates)


def build(robot: str, variant: str, run: paper.Run | None) -> list[dict]:
    """A row at every iteration of `AT` that the run has; one row in words if it has none."""
    cells = {"robot": robot, "variant": variant, "status": paper.status(run)}
    if not (run and run.columns):
        return [cells]
    iteration, rows = run.columns["iteration"][:, 0], []
    for i in np.flatnonzero(np.isin(iteration, AT)):
        row = cells | {"iteration": int(iteration[i])}
        row["sim_steps_M"] = run.columns["sim_steps"][i, 0] / 1e6
        for name in METRICS:
            row |= stats.spread(name, run.columns[name][i])
        rows.append(row)
    return rows


def beside(robot: str, runs: dict) -> list[dict]:
    """The learning rate of each variant as a share of PPO-16's. A seed's is its geometric mean."""
    some = {name: run for name, run in runs.items() if run and run.columns}
    if "ppo16" not in some:
        return []

    def logs(run, first, last):
        at = run.columns["iteration"][:, 0]
        return np.nanmean(np.log(run.columns["learning_rate"][(first <= at) & (at <= last)]), 0)

    rows = []
    for window, ends in WINDOWS.items():
        base = logs(some["ppo16"], *ends)
        for name in some.keys() - {"ppo16"}:
            own = logs(some[name], *ends)
            share = np.exp(stats.difference(own, base))
            cells = dict(zip(("share", "share_low", "share_high"), map(float, share), strict=True))
            about = {"robot": robot, "variant": name, "window": window}
            rows.append(about | cells | {"p": stats.welch_of(own, base)})
    order = list(some)
    return sorted(rows, key=lambda row: (row["window"], order.index(row["variant"])))


def draw(runs: dict, title: str, path: Path) -> None:
    """A row a variant beside PPO-16, so that no more than two bands lie over each other."""
    some = {name: run for name, run in runs.items() if run and run.columns}
    names = [name for name in some if name != "ppo16"] or ["none"]
    page, axes = pictures.figure(
        len(names), len(PANELS), 1.25 * len(names) + 1.1, sharex="col", sharey="col"
    )
    for row, name in zip(axes, names, strict=True):
        for axis, panel in zip(row, PANELS, strict=True):
            for variant in filter(some.get, ("ppo16", name)):
                draw_line(axis, some[variant], variant, panel)
            if not axis.lines:
                pictures.missing(axis)
            axis.set_xlim(left=0)
        if name in some:
            label = (paper.VARIANTS | paper.OURS)[name].replace(", ", ",\n").replace(" (", "\n(")
            row[0].set_ylabel(label, color=pictures.COLOURS[name], fontweight="bold")
    for axis, (x, y, text) in zip(axes[0], PANELS, strict=True):
        axis.set_title(text, loc="left", fontsize=10)
        if y == "learning_rate" and axis.lines:
            pictures.log(axis, (1,))
            axis.set_ylim(2e-5, 2e-2)
        elif y == "policy_std":
            axis.set_ylim(bottom=0)
        elif y == "eval_fall_rate":
            for below in axes[:, PANELS.index((x, y, text))]:
                pictures.falls(below)
    for axis, (x, _, _) in zip(axes[-1], PANELS, strict=True):
        axis.set_xlabel("simulator steps (M)" if x == "sim_steps" else x)
    lacks = [v for v in paper.VARIANTS if v not in some]
    note = f"     not run: {', '.join(lacks)}" if lacks else ""
    if some:
        seeds = [len(paper.peak(run)) for run in some.values()]
        note = f". Black: PPO-16. Band: {pictures.covers(seeds)}" + note
    pictures.head(page, title + note)
    pictures.save(page, path)


def draw_line(axis, run: paper.Run, variant: str, panel) -> None:
    """A variant's mean and its band."""
    x, y, _ = panel
    if y not in run.columns:
        return
    scale = 100 if y == "eval_fall_rate" else 1
    at = run.columns[x][:, 0] / (1e6 if x == "sim_steps" else 1)
    dash = pictures.DASHES.get(variant, "-")
    pictures.band(axis, at, scale * run.columns[y], pictures.COLOURS[variant], dash=dash)


if __name__ == "__main__":
    main()

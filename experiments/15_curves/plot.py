"""What run.py writes: numbers at some iterations, and a page of curves a robot."""

from pathlib import Path

import numpy as np

from experiments import paper, pictures, stats

HERE = Path(__file__).parent
AT = (50, 100, 200, 300, 400, 500)  # iterations of the table
METRICS = ("episode_return", "policy_std", "learning_rate", "velocity_error")


def make(out: Path, others: Path = HERE.parent) -> None:
    rows, folder = [], others / "12_platforms" / "results"
    for robot, title in paper.ROBOTS.items():
        runs = {name: paper.load(folder, f"{robot}_{name}") for name in paper.variants(robot)}
        rows += [row for name, run in runs.items() for row in build(robot, name, run)]
        if robot == "go1" or any(run and run.columns for run in runs.values()):
            draw(runs, title, out / robot)
    paper.write(out / "results.csv", rows)


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


def draw(runs: dict, title: str, path: Path) -> None:
    """Mean over seeds and its 95 % interval; five variants and ours."""
    page, axes = pictures.figure(2, 3, (12, 6.6))
    some = {name: run for name, run in runs.items() if run and run.columns}
    panels = (
        ("iteration", "episode_return", "iteration", "episode return", "Fig. 7: return"),
        ("sim_steps", "episode_return", "simulator steps (M)", "episode return", "return, by data"),
        (
            "seconds",
            "episode_return",
            "seconds, all seeds at once",
            "episode return",
            "return, by time",
        ),
        (
            "iteration",
            "policy_std",
            "iteration",
            "policy std (units of action)",
            "Fig. 8: policy std",
        ),
        ("iteration", "learning_rate", "iteration", "learning rate", "Fig. 10: learning rate"),
        ("iteration", "velocity_error", "iteration", "velocity error (m/s)", "velocity error"),
    )
    for axis, (x, y, x_label, y_label, name) in zip(axes.flat, panels, strict=True):
        for variant, run in some.items():
            at = run.columns[x][:, 0] / (1e6 if x == "sim_steps" else 1)
            label = (paper.VARIANTS | paper.OURS)[variant]
            pictures.band(axis, at, run.columns[y], pictures.COLOURS[variant], label)
        if not axis.lines:
            pictures.missing(axis)
        elif y == "learning_rate":
            pictures.log(axis)
        elif y != "episode_return":
            axis.set_ylim(bottom=0)
        axis.set_title(name, loc="left", fontsize=10)
        axis.set(xlabel=x_label, ylabel=y_label, xlim=(0, None))
    lacks = [v for v in paper.VARIANTS if v not in some]
    note = f"     not run: {', '.join(lacks)}" if lacks else ""
    seeds = max((len(paper.peak(run)) for run in some.values()), default=0)
    pictures.head(page, f"{title}: mean of {seeds} seeds, band: its 95 % interval{note}")
    pictures.legend(page, axes[0, 0], 7)
    pictures.save(page, path)

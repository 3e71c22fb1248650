"""What a tail saves against PPO-16: tables in Markdown and CSV, and curves as PNG and SVG.

    python experiments/20_tail/compare.py

Reads the runs of `experiments/run.py` here and in 12_platforms. The threshold is 80 % of the mean over
seeds of the best return of the first run of a group, PPO-16; a seed that never reaches it counts as
none. The paired difference is that of the returns, seed by seed, with its 95 % interval.
"""

from pathlib import Path

import numpy as np

from dynappo import curves
from experiments import paper

HERE = Path(__file__).parent
FOLDERS = (HERE / "results", HERE.parent / "12_platforms" / "results")
# group -> (first, and what is compared with it); a group is of one batch unless the README says otherwise
GROUPS = {
    "Go1": (
        "go1_ppo16",
        "go1_best",
        "go1_best_float32",
        "go1_24of32",
        "go1_fast",
        "go1_ppo16_bfloat16",
    ),
    "Go1, ramp": ("go1_ppo16", "go1_ramp0", "go1_ramp20", "go1_ramp50"),
    "Go1, 1024 robots": ("go1_ppo16_1024", "go1_best_1024"),
    "Go2": ("go2_ppo16", "go2_best_float32"),
    "ANYmal-C": ("anymal_c_ppo16", "anymal_c_best_float32"),
}
COLUMNS = (
    "group run return_mean return_low return_high difference_low difference_high evaluation falls_pct "
    "policy_std steps_M_mean steps_M_low steps_M_high share_pct iterations seeds"
).split()
DRAWN = {
    "Go1": {"PPO-16": "go1_ppo16", "best": "go1_best", "24 of 32": "go1_24of32"},
    "ANYmal-C": {"PPO-16": "anymal_c_ppo16", "best": "anymal_c_best_float32"},
}


def main():
    rows = [row for group, names in GROUPS.items() for row in table(group, names)]
    paper.write(HERE / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(HERE / "steps")


def find(name: str):
    """The run, wherever it is; None if it is not there."""
    return next(filter(None, (paper.load(folder, name) for folder in FOLDERS)), None)


def table(group: str, names) -> list[dict]:
    """A row a run."""
    base, rows = find(names[0]), []
    limit = 0.8 * float(paper.peak(base).mean()) if base else None
    for name in names:
        run = find(name)
        row = {"group": group, "run": name}
        rows.append(row)
        if run is None:
            continue
        row |= paper.spread("return", paper.final(run)) | {
            "policy_std": paper.policy_std(run).mean()
        }
        if base and name != names[0]:
            difference = paper.final(run) - paper.final(base)
            row["difference_low"], row["difference_high"] = map(float, curves.interval(difference))
        if "evaluation" in run.summary:
            row["evaluation"] = np.mean(run.summary["evaluation"]["return"])
            row["falls_pct"] = 100 * np.mean(run.summary["evaluation"]["fall_rate"])
        if limit is None:
            continue
        took = paper.reached(run, limit)
        there = np.isfinite(took["iteration"])
        row |= {"limit": limit, "seeds": f"{there.sum()} of {len(there)}"}
        if there.any():
            row |= paper.spread("steps_M", took["sim_steps"][there] / 1e6)
            row["iterations"] = took["iteration"][there].mean()
            row["share_pct"] = 100 * row["steps_M_mean"] / rows[0].get("steps_M_mean", np.nan)
    return rows


def draw(path: Path) -> None:
    """Return over simulator steps, mean of the seeds and its interval, and the threshold."""
    page, axes = paper.figure(1, len(DRAWN), (12, 4.2))
    for axis, (group, runs) in zip(axes[0], DRAWN.items(), strict=True):
        for (label, name), colour in zip(
            runs.items(), ("0.35", "#7a4fa3", "#c8481f"), strict=False
        ):
            run = find(name)
            if run is None:
                continue
            columns = run.columns
            paper.band(
                axis, columns["sim_steps"][:, 0] / 1e6, columns["episode_return"], colour, label
            )
        limit = 0.8 * float(paper.peak(find(GROUPS[group][0])).mean())  # all is measured against it
        axis.axhline(limit, color="0.6", linewidth=0.8, linestyle="--")
        axis.text(
            33, limit, "80 % of PPO-16's best", ha="right", va="bottom", color="0.4", fontsize=8
        )
        axis.set(xlabel="simulator steps (M)", ylabel="episode return", xlim=(0, 33.5), title=group)
        axis.legend(frameon=False, loc="lower right")
    paper.save(page, path)


if __name__ == "__main__":
    main()

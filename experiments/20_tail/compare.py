"""What a tail saves against PPO-16: tables in Markdown and CSV, and curves.

    python experiments/20_tail/compare.py

Reads the runs of `experiments/run.py` here and in 12_platforms. The threshold is 80 % of the mean over
seeds of the best return of the first run of a group, PPO-16 or, among the ideas, `best`; a seed that never
reaches it counts as none. Shares are of the first run's simulator steps and seconds to the threshold. Paired
differences are those of returns, seed by seed, with their 95 % intervals: of the training return (the
last ten iterations), of `all` (every episode that ended in the last 1000 control steps, where the run says
so), and of the evaluation.
"""

from pathlib import Path

import numpy as np

from dynappo.train import curves
from experiments import paper, pictures, stats

HERE = Path(__file__).parent
FOLDERS = (HERE / "results", HERE.parent / "12_platforms" / "results")
ROBOTS = {"go1": "Go1", "go2": "Go2", "anymal_c": "ANYmal-C", "anymal_d": "ANYmal-D"}
WITHOUT = ("clean", "known_reward", "falls", "bounds")
# group -> (first, and what is compared with it); a group is of one batch unless the README says otherwise
GROUPS = {
    label: tuple(f"{robot}_{run}" for run in ("ppo16", "best", "24of32", "dyna4", "ppo24"))
    for robot, label in ROBOTS.items()
}
GROUPS["Go1"] = GROUPS["Go1"][:-1]  # PPO-24 of Go1 is in 17_regimes
GROUPS |= {
    f"{label}, 1024 robots": tuple(f"{robot}_{run}_1024" for run in ("ppo16", "best"))
    for robot, label in ROBOTS.items()
}
GROUPS |= {
    f"{ROBOTS[robot]}, seeds 5 to 9": tuple(f"{robot}_{run}_seed5" for run in ("ppo16", "best"))
    for robot in ("anymal_c", "anymal_d")
}
GROUPS |= {
    "ideas, 1024 Go1": (
        "go1_best_1024",
        "go1_best_1024_seed5",
        *(f"idea_no_{name}" for name in WITHOUT),
        "idea_none",
        *(f"idea_only_{name}" for name in WITHOUT),
        "idea_private",
        "idea_history_3",
        "idea_unroll_3",
        "idea_ensemble_2",
        "idea_tail_weight_0",
        "idea_by_error",
        "idea_first_order_4",
        "idea_first_order_8",
        "idea_first_order_weight_0.1",
        "idea_first_order_weight_0.01",
    ),
    "ideas, 4096 Go1": (
        "go1_best",
        "go1_first_order_4",
        "go1_private",
        "go1_unroll_3",
        "go1_by_error",
    ),
    "second batch": tuple(
        f"second/go1_{run}"
        for run in "ppo16 best best_float32 24of32 fast ppo16_bfloat16 ramp0 ramp20 ramp50".split()
    ),
    "second batch, 1024 Go1": ("second/go1_ppo16_1024", "second/go1_best_1024"),
    "second batch, ANYmal-C": ("second/anymal_c_ppo16", "second/anymal_c_best_float32"),
}
COLUMNS = (
    "group run return_mean return_low return_high difference_low difference_high all_low all_high "
    "evaluation evaluated_low evaluated_high falls_pct policy_std steps_M_mean steps_M_low steps_M_high "
    "share_pct iterations seconds seconds_share_pct seeds"
).split()
DRAWN = {label: GROUPS[label][:2] for label in ROBOTS.values()}


def main():
    make(HERE)


def make(out: Path) -> None:
    rows = [row for group, names in GROUPS.items() for row in table(group, names)]
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(out / "steps")


def find(name: str):
    """The run, wherever it is; None if it is not there."""
    return next(filter(None, (paper.load(folder, name) for folder in FOLDERS)), None)


def table(group: str, names) -> list[dict]:
    """A row a run; only its name if it is not there."""
    base, rows = find(names[0]), []
    limit = 0.8 * float(paper.peak(base).mean()) if base else None
    for name in names:
        run, row = find(name), {"group": group, "run": name}
        rows.append(row)
        if run is None:
            continue
        if not run.columns:
            row["status"] = "diverged"
            continue
        row |= stats.spread("return", paper.final(run))
        row["policy_std"] = paper.policy_std(run).mean()
        returns = {"difference": paper.final, "all": of_all, "evaluated": evaluated}
        for label, of in returns.items():
            if base and name != names[0] and ("seed5" in name) == ("seed5" in names[0]):
                low, high = curves.interval(of(run) - of(base))
                row |= {f"{label}_low": float(low), f"{label}_high": float(high)}
        if "evaluation" in run.summary:
            row["evaluation"] = evaluated(run).mean()
            row["falls_pct"] = 100 * np.mean(run.summary["evaluation"]["fall_rate"])
        if limit is None:
            continue
        took = paper.reached(run, limit)
        there = np.isfinite(took["iteration"])
        row |= {"limit": limit, "seeds": f"{there.sum()} of {len(there)}"}
        if there.any():
            row |= stats.spread("steps_M", took["sim_steps"][there] / 1e6)
            row["iterations"] = took["iteration"][there].mean()
            row["seconds"] = took["seconds"][there].mean()
            row["share_pct"] = 100 * row["steps_M_mean"] / rows[0].get("steps_M_mean", np.nan)
            row["seconds_share_pct"] = 100 * row["seconds"] / rows[0].get("seconds", np.nan)
    return rows


def of_all(run) -> np.ndarray:
    """Return of every episode that ended in the last 1000 control steps, each seed; NaN if unknown."""
    return np.array(run.summary.get("return_of_all", np.full(len(paper.final(run)), np.nan)), float)


def evaluated(run) -> np.ndarray:
    """Return of the evaluation, each seed; NaN if there was none."""
    nothing = {"return": np.full(len(paper.final(run)), np.nan)}
    return np.array(run.summary.get("evaluation", nothing)["return"], float)


def draw(path: Path) -> None:
    """Return over simulator steps, mean of the seeds and its interval, and the threshold."""
    page, axes = pictures.figure(2, 2, (12, 7.6))
    colours = ("0.35", "#7a4fa3")
    for axis, (group, names) in zip(axes.flat, DRAWN.items(), strict=True):
        for name, colour, label in zip(names, colours, ("PPO-16", "best"), strict=True):
            run = find(name)
            if run is None:
                continue
            steps = run.columns["sim_steps"][:, 0] / 1e6
            pictures.band(axis, steps, run.columns["episode_return"], colour, label)
        limit = 0.8 * float(paper.peak(find(names[0])).mean())  # all is measured against it
        axis.axhline(limit, color="0.6", linewidth=0.8, linestyle="--")
        axis.text(
            33, limit, "80 % of PPO-16's best", ha="right", va="bottom", color="0.4", fontsize=8
        )
        axis.set(xlabel="simulator steps (M)", ylabel="episode return", xlim=(0, 33.5))
        axis.set_title(group, loc="left", fontsize=10)
        axis.legend(frameon=False, loc="lower right")
    pictures.save(page, path)


if __name__ == "__main__":
    main()

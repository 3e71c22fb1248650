"""What a tail saves against PPO-16: tables in Markdown and CSV, and curves.

    python experiments/20_tail/compare.py

Reads the runs of `experiments/run.py` here and in 12_platforms/earlier: all batches of a setting pooled
(`experiments/batches.py`), except in the groups whose names say which batch they are. The threshold is 80 %
of the mean over seeds of the best return of the first run of a group, PPO-16 or, among the ideas, `best`.
Shares are of the first run's simulator steps and seconds to the threshold; seeds that never reach it count
as `stats.share` says. "with_setup" counts the seconds before the first iteration too. Differences are
Welch's, with p and Holm's p over the group: of the training return (the last ten iterations), of `all` (every
episode that ended in the last 1000 control steps, where the run says so), and of the evaluation.

batches.csv has every batch by itself.
"""

from pathlib import Path
from typing import Any

import numpy as np

from experiments import batches, paper, pictures, stats

HERE = Path(__file__).parent
FOLDERS = (HERE / "results", HERE.parent / "12_platforms" / "earlier")
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
BATCHES = ("second", "seeds 5")  # groups of one batch
COLUMNS = (
    "group run return_mean return_low return_high difference difference_low difference_high "
    "difference_p_holm all_low all_high evaluation evaluated evaluated_low evaluated_high evaluated_p_holm "
    "evaluated_p_equal falls_pct policy_std steps_M_mean steps_M_low steps_M_high share_pct share_low "
    "share_high share_bound iterations seconds seconds_share_pct with_setup with_setup_share_pct seeds"
).split()
DRAWN = {"ppo16": "PPO-16", "ppo24": "PPO-24", "best": "best until 2026-11-22"}
PPO24 = ("10_ablation", "go1_ppo16_rollout.num_envs_4096_rollout.horizon_24")  # Go1's


def main():
    make(HERE)


def make(out: Path) -> None:
    rows = [row for group, names in GROUPS.items() for row in table(group, names)]
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    named = [row for name in batches.MORE for row in batch_rows(name)]
    paper.write(out / "batches.csv", named)
    paper.show(named, list(named[0]))
    draw(out / "steps")


def find(name: str, load=paper.load):
    """The run, wherever it is; None if it is not there."""
    return next(filter(None, (load(folder, name) for folder in FOLDERS)), None)


def batch_rows(name: str) -> list[dict]:
    """A row a batch of one setting, then one of all its seeds."""
    folder, run = (HERE.parent / name).parent, Path(name).name
    others = batches.others_of(folder, run)
    every = {name.replace("/results", ""): paper.load(folder, run)}
    for path in others:
        every[str(path.relative_to(HERE.parent)).replace("/results", "")] = find_path(path)
    rows = []
    for batch, found in [*every.items(), ("all", batches.load(folder, run))]:
        if found is None:
            continue
        cells = {"setting": run, "batch": batch, "date": found.summary.get("date")}
        cells |= {"commit": found.summary.get("commit"), "seeds": len(paper.peak(found))}
        if batch == "all":
            cells |= {"date": None, "commit": None}
        cells |= stats.spread("max_reward", paper.peak(found))
        rows.append(cells | stats.spread("evaluated", evaluated(found)))
    return rows


def find_path(path: Path):
    """The run whose files are PATH.json and PATH.csv.xz."""
    return paper.load(path.parent, path.name)


def table(group: str, names) -> list[dict]:
    """A row a run; only its name if it is not there."""
    load = paper.load if any(word in group for word in BATCHES) else batches.load
    base, rows = find(names[0], load), []
    limit = 0.8 * float(paper.peak(base).mean()) if base else None
    for name in names:
        run, row = find(name, load), {"group": group, "run": name}
        rows.append(row)
        if run is None:
            continue
        if not run.columns:
            row["status"] = "diverged"
            continue
        row |= stats.spread("return", paper.final(run))
        row["policy_std"] = paper.policy_std(run).mean()
        own = name == names[0] or ("seed5" in name and "seed5" not in names[0])  # part of the base
        if base and not own:
            row |= differences(run, base, group)
        if "evaluation" in run.summary:
            row["evaluation"] = stats.moments(evaluated(run)).mean
            row["falls_pct"] = 100 * np.mean(run.summary["evaluation"]["fall_rate"])
        if limit is not None:
            row |= took(run, None if own else base, limit)
    for name in ("difference", "evaluated"):
        stats.adjust(rows, f"{name}_p")
    return rows


def differences(run, base, group: str) -> dict:
    """Cells: of the three returns, less those of `base`; of the evaluation equivalence too."""
    cells = {}
    margin = stats.MARGIN["anymal_c" if "ANYmal" in group else "go1"]
    for label, of in {"difference": paper.final, "all": of_all, "evaluated": evaluated}.items():
        found = stats.compare(of(run), of(base), margin)
        cells[label] = found["difference"]
        ends = ("low", "high")
        cells |= {f"{label}_{end}": found[f"difference_{end}"] for end in ends}
        cells |= {f"{label}_{n}": found[n] for n in ("p", "p_equal")}
    return cells


def took(run, base, limit: float) -> dict:
    """Cells: what it took the seeds that reach `limit`, and the shares of what it took `base`."""
    found = paper.reached(run, limit)
    there = np.isfinite(found["iteration"])
    cells: dict = {"limit": limit, "seeds": f"{there.sum()} of {len(there)}"}
    if there.any():
        cells |= stats.spread("steps_M", found["sim_steps"] / 1e6)
        cells |= {n: stats.moments(found[n]).mean for n in ("seconds", "with_setup")}
        cells["iterations"] = stats.moments(found["iteration"]).mean
    if base is None:
        return cells
    shares = paper.against(run, base, limit).items()
    return cells | {n.replace("share_of_ppo16", "share"): v for n, v in shares}


def of_all(run) -> np.ndarray:
    """Return of every episode that ended in the last 1000 control steps, each seed; NaN if unknown."""
    return np.array(run.summary.get("return_of_all", np.full(len(paper.final(run)), np.nan)), float)


def evaluated(run) -> np.ndarray:
    """Return of the evaluation, each seed; NaN if there was none."""
    nothing = {"return": np.full(len(paper.final(run)), np.nan)}
    return np.array(run.summary.get("evaluation", nothing)["return"], float)


def draw(path: Path) -> None:
    """Return over simulator steps, mean of the seeds and its interval, and the threshold."""
    page, axes = pictures.figure(2, 2, 6.6)
    seeds = []
    for axis, (robot, label) in zip(axes.flat, ROBOTS.items(), strict=True):
        base = find(f"{robot}_ppo16", batches.load)
        for variant, text in DRAWN.items():
            run = find(f"{robot}_{variant}", batches.load)
            if run is None and (robot, variant) == ("go1", "ppo24"):
                run = batches.load(HERE.parent / PPO24[0] / "results", PPO24[1])
            if run is None or base is None:
                continue
            steps, dash = run.columns["sim_steps"][:, 0] / 1e6, pictures.DASHES.get(variant, "-")
            style: dict[str, Any] = dict(colour=pictures.COLOURS[variant], label=text, dash=dash)
            pictures.band(axis, steps, run.columns["episode_return"], **style)
            seeds.append(len(paper.peak(run)))
        limit = 0.8 * float(paper.peak(base).mean()) if base else np.nan
        axis.axhline(limit, color="0.4", linewidth=1, linestyle=":")
        axis.set(xlim=(0, 50), ylim=(-3, None))
        axis.set_title(label, loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("simulator steps (M)")
    for row in axes:
        row[0].set_ylabel("episode return")
    text = f"Band: {pictures.covers(seeds)}. Dotted: 80 % of PPO-16's best return"
    pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 3)
    pictures.save(page, path)


if __name__ == "__main__":
    main()

"""settings.csv (Table III), results.csv (Table V) and figure of the runs in results/.

    python experiments/12_platforms/plot.py

"max_reward" is the paper's: the best return of a run, over all iterations. "return" is the mean of the
last ten. p is Welch's, two-sided, of the best returns of the seeds. "difference" is that of the returns
to PPO-16, seed by seed; "not worse" means that its interval's lower end is above -`MARGIN`.
"""

from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from experiments import paper

COLUMNS = (
    "robot variant status max_reward_mean max_reward_sd paper_max_reward_mean paper_max_reward_sd "
    "p_vs_ppo16 paper_p_vs_ppo16 p_vs_ppo12 paper_p_vs_ppo12 evaluated_return_mean p_evaluated "
    "return_mean return_low return_high "
    "difference_low verdict policy_std_mean paper_policy_std_mean"
).split()
MARGIN = {"go1": 1.0, "go2": 1.0, "anymal_c": 0.7, "anymal_d": 0.7}


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    paper.write(out / "settings.csv", settings())
    rows = build(out / "results")
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(rows, out / "platforms")


def settings() -> list[dict]:
    """Table III: the five settings as configs/ has them, beside the paper's; 0 for its dashes."""
    rows = []
    for theirs in paper.table("training_configs"):
        variant = theirs["variant"]
        config = config_lib.load(f"configs/go1.py:{variant}")
        s = config.schedule
        ours = {"N": config.rollout.horizon, "a": s.start_iteration, "b": s.end_iteration}
        ours |= {"x": s.start_steps, "y": s.end_steps}
        printed = {f"paper_{name}": int(theirs[name] or 0) for name in ours}
        steps = paper.sim_steps(f"configs/go1.py:{variant}", 500) / 1e6
        rows.append({"variant": variant} | ours | printed | {"sim_steps_M_of_500": steps})
    return rows


def build(folder: Path) -> list[dict]:
    """A row a robot and variant; minutes are of all seeds, which train at once."""
    printed, rows = paper.table("platforms"), []
    for robot in paper.ROBOTS:
        runs = {name: paper.load(folder, f"{robot}_{name}") for name in paper.variants(robot)}
        for variant, run in runs.items():
            row: dict = {"robot": robot, "variant": variant, "status": paper.status(run)}
            if run and run.columns:
                row |= measures(run)
                for base in ("ppo16", "ppo12"):
                    other = runs[base]
                    if other and other.columns and base != variant:
                        row[f"p_vs_{base}"] = paper.welch_of(paper.peak(run), paper.peak(other))
                        if base == "ppo16":
                            row |= difference(paper.final(run), paper.final(other), MARGIN[robot])
                            pair = [
                                r.summary.get("evaluation", {"return": []}) for r in (run, other)
                            ]
                            row["p_evaluated"] = paper.welch_of(*(e["return"] for e in pair))
            rows.append(row | theirs(printed, robot, variant))
    return rows


def difference(ours, base, margin: float) -> dict:
    """Of returns, paired by seed, and whether `ours` are worse by more than `margin`, not worse, or neither
    is shown; {} if unpaired."""
    if len(ours) != len(base) or len(ours) < 2:
        return {}
    cells = paper.spread("difference", ours - base)
    if cells["difference_high"] < -margin:
        return cells | {"verdict": "worse"}
    return cells | {"verdict": "not worse" if cells["difference_low"] > -margin else "not shown"}


def measures(run: paper.Run) -> dict:
    """What a run came to: over seeds."""
    summary, evaluation = run.summary, run.summary.get("evaluation", {})
    row = paper.returns(run)
    if evaluation:
        row |= paper.spread("evaluated_return", evaluation["return"])
        for name in ("fall_rate", "tracking_error"):
            row[f"evaluated_{name}"] = float(np.mean(evaluation[name]))
    row |= {"sim_steps_M": summary["sim_steps"] / 1e6, "minutes": summary["seconds"] / 60}
    return row | {"device": summary["device"], "impl": summary["impl"], "date": summary["date"]}


def theirs(printed, robot: str, variant: str) -> dict:
    """The paper's cells, and Welch's p from its means, deviations and three seeds."""
    row = paper.pick(printed, robot=robot, variant=variant)
    if not row:
        return {}
    out = {f"paper_{name}": row[name] for name in row if name not in ("robot", "variant")}
    for base in ("ppo16", "ppo12"):
        other = paper.pick(printed, robot=robot, variant=base)
        if base != variant:
            pair = [
                (r["max_reward_mean"], r["max_reward_sd"], paper.PAPER_SEEDS) for r in (row, other)
            ]
            out[f"paper_p_vs_{base}"] = paper.welch(*pair)[2]
    return out


def draw(rows, path: Path) -> None:
    """Best return of every variant: ours with its 95 % interval, the paper's with its deviation."""
    page, axes = paper.figure(1, 4, (12, 3.8), sharey=True)
    names = [*paper.VARIANTS, *paper.OURS]
    for axis, (robot, title) in zip(axes[0], paper.ROBOTS.items(), strict=True):
        for y, variant in enumerate(names):
            row = paper.pick(rows, robot=robot, variant=variant)
            colour = paper.COLOURS[variant]
            if "max_reward_mean" in row:
                mean = row["max_reward_mean"]
                axis.plot(
                    [row["max_reward_low"], row["max_reward_high"]], [y - 0.12] * 2, color=colour
                )
                axis.plot(mean, y - 0.12, "o", color=colour, markersize=6)
            elif row.get("status"):
                axis.text(0.5, y - 0.12, row["status"], color="0.6", fontsize=8, va="center")
            if row.get("paper_max_reward_mean"):
                mean, sd = row["paper_max_reward_mean"], row["paper_max_reward_sd"]
                axis.plot([mean - sd, mean + sd], [y + 0.18] * 2, color="0.6", linewidth=1)
                axis.plot(mean, y + 0.18, "D", color="white", markeredgecolor="0.45", markersize=5)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set(xlabel="best return", xlim=(0, None), ylim=(len(names) - 0.5, -0.5))
    labels = [(paper.VARIANTS | paper.OURS)[name] for name in names]
    axes[0, 0].set_yticks(range(len(names)), labels)
    text = "dots: this repository, bar: 95 % interval of the mean     diamonds: paper, bar: ± sd of 3 seeds"
    paper.head(page, text, fontsize=9, color="0.35")
    paper.save(page, path)


if __name__ == "__main__":
    main()

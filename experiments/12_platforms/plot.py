"""settings.csv (Table III), results.csv (Table V) and figure of the runs in results/.

    python experiments/12_platforms/plot.py

"max_reward" is the paper's: the best return of a run, over all iterations. "return" is the mean of the
last ten. A row compares all three, evaluated return among them, with PPO-16's of the same robot: the
difference with Welch's 95 % interval, p of Welch's test and of equivalence (`stats.MARGIN`), both by Holm
over all comparisons of that measure in the table, and the verdict of the latter. batches.csv compares PPO
with its earlier batches, of MuJoCo Warp instead of our kernel (folder earlier/).
"""

from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from experiments import batches, paper, pictures, stats

COLUMNS = (
    "robot variant status seeds max_reward_mean max_reward_sd p_vs_ppo12 paper_max_reward_mean "
    "paper_max_reward_sd paper_p_vs_ppo16 paper_p_vs_ppo12 "
    "evaluated_return_mean return_mean policy_std_mean paper_policy_std_mean"
).split()
MEASURES = ("max_reward", "evaluated_return", "return")
BATCHES = (
    "robot variant measure seeds earlier_seeds mean earlier_mean difference difference_low "
    "difference_high p p_holm p_equal p_equal_holm"
).split()


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    paper.write(out / "settings.csv", settings())
    rows = build(out / "results")
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    for name in MEASURES:
        paper.show(rows, ["robot", "variant", *(f"{name}_{cell}" for cell in stats.COMPARED)])
    both = [row for measure in MEASURES[:2] for row in with_earlier(out / "results", measure)]
    if both:
        paper.write(out / "batches.csv", both)
        paper.show(both, BATCHES)
    draw(rows, out / "platforms")


def with_earlier(folder: Path, measure: str) -> list[dict]:
    """PPO's runs of `folder` beside all earlier batches of the same setting: a row a robot and variant."""
    rows = []
    for robot in paper.ROBOTS:
        for variant in ("ppo12", "ppo16"):
            name = f"{robot}_{variant}"
            run, earlier = paper.load(folder, name), batches.earlier(folder, name)
            if not (run and earlier):
                continue
            new, old = seeds_of(run, measure), seeds_of(earlier, measure)
            row = {"robot": robot, "variant": variant, "measure": measure}
            row |= {"seeds": len(new), "earlier_seeds": len(old)}
            row |= {"mean": new.mean(), "earlier_mean": old.mean()}
            rows.append(row | stats.compare(new, old, stats.MARGIN[robot]))
    stats.correct(rows)
    return rows


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
    """A row a robot and variant."""
    printed, rows = paper.table("platforms"), []
    for robot in paper.ROBOTS:
        runs = {name: paper.load(folder, f"{robot}_{name}") for name in paper.variants(robot)}
        for variant, run in runs.items():
            row: dict = {"robot": robot, "variant": variant, "status": paper.status(run)}
            if run and run.columns:
                row |= measures(run) | differences(run, variant, runs, stats.MARGIN[robot])
            rows.append(row | theirs(printed, robot, variant))
    for name in MEASURES:
        stats.correct(rows, f"{name}_")
    return rows


def differences(run, variant: str, runs, margin: float) -> dict:
    """Cells: every measure against PPO-16's (`stats.compare`), and the best return against PPO-12's."""
    cells = {}
    for base in ("ppo16", "ppo12"):
        other = runs[base]
        if base == variant or not (other and other.columns):
            continue
        if base == "ppo12":
            cells["p_vs_ppo12"] = stats.welch_of(paper.peak(run), paper.peak(other))
            continue
        for name in MEASURES:
            pair = seeds_of(run, name), seeds_of(other, name)
            cells |= stats.compare(*pair, margin, f"{name}_")
    return cells


def seeds_of(run, name: str) -> np.ndarray:
    """A measure of each seed; of the evaluation none where there was none."""
    if name == "evaluated_return":
        return np.array(run.summary.get("evaluation", {"return": []})["return"], float)
    return paper.peak(run) if name == "max_reward" else paper.final(run)


def measures(run: paper.Run) -> dict:
    """What a run came to: over seeds."""
    summary, evaluation = run.summary, run.summary.get("evaluation", {})
    row = paper.returns(run)
    if evaluation:
        row |= stats.spread("evaluated_return", evaluation["return"])
        row |= stats.spread("evaluated_falls_pct", 100 * np.array(evaluation["fall_rate"]))
        for name in ("fall_rate", "tracking_error"):
            row[f"evaluated_{name}"] = float(np.mean(evaluation[name]))
    row["sim_steps_M"] = summary["sim_steps"] / 1e6
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
            out[f"paper_p_vs_{base}"] = stats.welch(*pair)[2]
    return out


def draw(rows, path: Path) -> None:
    """Of every variant the evaluated return, its falls, and the best return, ours and the paper's: a column a
    robot. A bar is the t interval of its seeds.
    """
    page, axes = pictures.figure(3, 4, 6.6, sharey=True)
    names, seeds = paper.variants("go1"), []
    for column, (robot, title) in zip(axes.T, paper.ROBOTS.items(), strict=True):
        for y, variant in enumerate(names):
            row, style = paper.pick(rows, robot=robot, variant=variant), pictures.mark(variant)
            evaluated, fell, best = column
            if "seeds" in row:
                seeds.append(row["seeds"])
                pictures.bar(evaluated, row, "evaluated_return", y, style)
                pictures.bar(fell, row, "evaluated_falls_pct", y, style)
                pictures.bar(best, row, "max_reward", y - 0.14, style)
            elif row.get("status"):
                for axis in column:
                    axis.text(0.5, y - 0.14, row["status"], color="0.5", va="center")
            if row.get("paper_max_reward_mean"):
                mean, low, high = printed_interval(row)
                best.plot([low, high], [y + 0.2] * 2, color="0.6", linewidth=1.2, clip_on=True)
                best.plot(mean, y + 0.2, "D", color="white", markeredgecolor="0.4", markersize=4.5)
        column[0].set_title(title, loc="left")
    pictures.variants(axes, names, 4)
    axes[1, 1].set_xlim(0, 15)  # Go2's PPO-12
    for column, robot in zip(axes.T, paper.ROBOTS, strict=True):
        few, most = ((28, 44), (0, 44)) if robot.startswith("go") else ((18, 29), (0, 29))
        column[0].set_xlim(few)
        column[2].set_xlim(most)
    under = (
        "evaluated return",
        "falls of the evaluation, % of episodes",
        "best return of 500 iterations in training, which the paper has too",
    )
    for line, text in zip(axes, under, strict=True):
        line[1].set_xlabel(text, x=1.0)
    counted = " or ".join(map(str, sorted(set(map(int, seeds))))) or "no"
    text = f"Bars: 95 % t interval of the mean. Filled: this repository, {counted} seeds. "
    text += f"White diamonds: the paper, {paper.PAPER_SEEDS} seeds"
    pictures.head(page, text, fontsize=9.5, color="0.35")
    pictures.save(page, path)


def printed_interval(row) -> tuple[float, float, float]:
    """Mean of the paper's three seeds and the t interval that follows from its deviation."""
    mean, sd = row["paper_max_reward_mean"], row["paper_max_reward_sd"]
    half = stats.half_of(stats.Moments(mean, sd, paper.PAPER_SEEDS))
    return mean, mean - half, mean + half


if __name__ == "__main__":
    main()

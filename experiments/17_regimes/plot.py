"""results.csv and figure of the runs in results/ and of other folders' runs of the same settings.

    python experiments/17_regimes/plot.py

"limit" is 80 % of the mean over seeds of PPO-16's best return: with 4096 robots for Isaac Lab's task, and
with as many as the regime has for another task, whose returns are another number. "to_ppo24_limit" is 80 %
of PPO-24's own best return in that regime. "p_vs_ppo16_holm" is Holm's over all of the table's. Equal to
PPO-24 is meant within 1.0 of return (`stats.MARGIN`). "ppo12_difference" is what a 4-step tail has more than
PPO without these four rows; "ppo12_p_holm" is over all tails.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import batches, paper, pictures, run, stats

PPO = {"ppo12": 12, "ppo16": 16, "ppo24": 24}
TAILS = ("dyna4_noschedule", "dyna4")
OWN_ROWS = PPO | {"dyna4": 16, "dyna4_noschedule": 16, "best": 24}
VARIANTS = ("ppo12", "ppo16", "dyna4_noschedule", "dyna4", "best", "ppo24")
NAMES = paper.VARIANTS | paper.OURS | {"ppo24": "PPO, 24 steps"}
COLUMNS = (
    "regime variant status seeds max_reward_mean max_reward_low max_reward_high p_vs_ppo16 p_vs_ppo16_holm "
    "ppo12_difference ppo12_difference_low ppo12_difference_high ppo12_p ppo12_p_holm "
    "ppo24_difference ppo24_difference_low ppo24_difference_high ppo24_p ppo24_p_equal ppo24_share_pct "
    "ppo24_share_low ppo24_share_high evaluated_return limit success_rate_pct sim_steps_M_mean "
    "share_of_ppo16_pct share_of_ppo16_low share_of_ppo16_high share_of_ppo16_bound policy_std_mean "
    "to_ppo24_limit to_ppo24_success_rate_pct to_ppo24_sim_steps_M_mean"
).split()


class Regime(NamedTuple):
    """A task and a number of robots."""

    label: str
    envs: int
    fields: str = ""  # of the task, as in a job of run.py


ROBOTS = (512, 1024, 2048, 4096)
TASKS = {
    "the paper's words": "task.formulation=paper_text",
    # the mass is the only parameter of a robot that Isaac Lab varies; this noise is the largest by far
    "less randomness": "task.randomize.base_mass=(0.0,0.0):task.noise.joint_vel=0.0",
}
REGIMES = [Regime(f"R = {envs}", envs) for envs in ROBOTS]
REGIMES += [Regime(f"R = 1024, {label}", 1024, fields) for label, fields in TASKS.items()]


def main():
    make(Path(__file__).parent)


def make(out: Path, regimes=REGIMES) -> None:
    rows = build(out / "results", regimes)
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(rows, regimes, out / "regimes")


def job(regime: Regime, variant: str, rows: int | None = None) -> str:
    """As run.py takes it; `rows` of a rollout, if not the variant's; PPO's are named as in 10_ablation."""
    fields, rows = [f"rollout.num_envs={regime.envs}"], rows or OWN_ROWS[variant]
    if variant in PPO or rows != OWN_ROWS[variant]:
        fields.append(f"rollout.horizon={rows}")
    variant = "ppo16" if variant in PPO else variant
    return ":".join(["go1", variant, *fields, *filter(None, [regime.fields])])


def found(folder: Path, regime: Regime, variant: str, rows: int | None = None) -> paper.Run | None:
    """A run, in `folder` or where another folder has the same settings, that with five seeds first."""
    others, own = Path(__file__).parent.parent, run.name(job(regime, variant, rows))
    places = [(folder, own)]
    if not regime.fields:
        places.append((others / "10_ablation" / "results", own))
        if rows in (None, OWN_ROWS[variant]):
            places.insert(1, (others / "20_tail" / "results", f"go1_{variant}_{regime.envs}"))
            if regime.envs == 4096:
                places.insert(1, (others / "12_platforms" / "earlier", f"go1_{variant}"))
    return next((one for path, name in places if (one := batches.load(path, name))), None)


def build(folder: Path, regimes) -> list[dict]:
    """A row a regime and variant."""
    rows, usual = [], found(folder, Regime("", 4096), "ppo16")
    for regime in regimes:
        runs = {name: found(folder, regime, name) for name in VARIANTS}
        base = runs["ppo16"]
        known = base if regime.fields else usual
        limit = 0.8 * float(paper.peak(known).mean()) if known and known.columns else None
        some = [row(regime, name, one, runs, limit) for name, one in runs.items()]
        if (longest := runs["ppo24"]) and longest.columns:
            high = 0.8 * float(paper.peak(longest).mean())
            for cells, one in zip(some, runs.values(), strict=True):
                if one and one.columns:
                    took = {"limit": high} | paper.effort(one, high, paper.tenth)
                    cells |= {f"to_ppo24_{name}": value for name, value in took.items()}
        rows += some
    for name in ("p_vs_ppo16", "ppo12_p"):
        stats.adjust(rows, name)
    return rows


def row(regime: Regime, variant: str, one, runs, limit: float | None) -> dict:
    """What a variant came to, and what it took to get to `limit`."""
    cells = {"regime": regime.label, "envs": regime.envs, "variant": variant}
    cells["status"] = paper.status(one)
    shortest, base, longest = (runs[name] for name in PPO)
    if not (one and one.columns):
        return cells
    cells |= paper.returns(one)
    if base and base.columns and one is not base:
        cells["p_vs_ppo16"] = stats.welch_of(paper.peak(one), paper.peak(base))
    if shortest and shortest.columns and variant in TAILS:
        some = stats.compare(paper.peak(one), paper.peak(shortest), stats.MARGIN["go1"])
        cells |= {f"ppo12_{name}": v for name, v in some.items() if "equal" not in name}
    if evaluation := one.summary.get("evaluation"):
        cells["evaluated_return"] = float(np.mean(evaluation["return"]))
    if longest and longest.columns and variant == "best":
        cells |= beside(one, longest)
    if limit is not None:
        cells |= {"limit": limit} | paper.effort(one, limit, paper.tenth)
        if base and base.columns and one is not base:
            cells |= paper.against(one, base, limit, paper.tenth)
    return cells | {"device": one.summary["device"], "date": one.summary["date"]}


def beside(one, longest) -> dict:
    """Cells: best returns and simulator steps of `best` against PPO-24's, to 80 % of PPO-24's best."""
    cells = stats.compare(paper.peak(one), paper.peak(longest), stats.MARGIN["go1"])
    high = 0.8 * float(paper.peak(longest).mean())
    share = paper.against(one, longest, high, paper.tenth).items()
    cells |= {n.replace("share_of_ppo16", "share"): v for n, v in share if "share_of" in n}
    return {f"ppo24_{name}": value for name, value in cells.items()}


def draw(rows, regimes, path: Path) -> None:
    """Best return and simulator steps to the limit, a column of marks a variant, a panel a regime."""
    regimes = [r for r in regimes if any("seeds" in c for c in rows if c["regime"] == r.label)]
    page, axes = pictures.figure(2, 1, 7.4, sharex=True)
    wide = 0.84 / len(VARIANTS)
    for axis, name in zip(axes[:, 0], ("max_reward", "sim_steps_M"), strict=True):
        for v, variant in enumerate(VARIANTS):
            style = pictures.mark(variant)
            axis.plot([], [], linestyle="", markersize=6, label=NAMES[variant], **style)
            for g, regime in enumerate(regimes):
                cells = paper.pick(rows, regime=regime.label, variant=variant)
                x = g + (v - (len(VARIANTS) - 1) / 2) * wide
                marks(axis, x, name, cells, style)
        for g in range(len(regimes) - 1):
            axis.axvline(g + 0.5, color="0.85", linewidth=0.8)
        axis.grid(axis="x", visible=False)
    labels = [r.label.replace(", ", ",\n") for r in regimes]
    axes[1, 0].set_xticks(range(len(regimes)), labels)
    axes[1, 0].set_xlim(-0.5, len(regimes) - 0.5)
    axes[0, 0].set(ylim=(0, 58), ylabel="best return of 500 iterations")
    axes[1, 0].set(ylim=(0, 28), ylabel="simulator steps (M) to the\nthreshold of the task")
    seeds = [cells["seeds"] for cells in rows if "seeds" in cells]
    text = (
        "Threshold: 80 % of PPO-16's best return with 4096 robots, of the other tasks with 1024.\n"
    )
    text += "Hollow, with a number: so many seeds get there, the others never; a number alone: none does"
    if seeds:
        text = f"Go1. Bar: {pictures.covers(seeds)}.\n{text}"
    pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 3)
    pictures.save(page, path)


def marks(axis, x: float, name: str, cells, style) -> None:
    """A mean and its interval; how many seeds got there, where not all did."""
    there = cells.get("success_rate_pct", 100) if name == "sim_steps_M" else 100
    if f"{name}_mean" in cells:
        ends = cells[f"{name}_low"], cells[f"{name}_high"]
        axis.vlines(x, *ends, style["color"], linewidth=1.5)
        face = "white" if there < 100 else style["color"]
        axis.plot(x, cells[f"{name}_mean"], markersize=6, **style, mfc=face)
    if there < 100:
        ends = [cells.get(f"{name}_{end}", 0) for end in ("mean", "high")]
        note = f"{round(there * cells['seeds'] / 100)} of {cells['seeds']}"
        how = dict(rotation=90, ha="center", va="bottom", color=style["color"])
        axis.text(x, np.nanmax(ends) + 0.8, note, fontsize=9, **how)
    elif cells["status"]:
        axis.text(x, 0.6, cells["status"], rotation=90, ha="center", va="bottom", fontsize=9)


if __name__ == "__main__":
    main()

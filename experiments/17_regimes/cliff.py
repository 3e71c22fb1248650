"""Do four synthetic rows stand in for four real ones where these matter? cliff.csv and cliff.png.

    python experiments/17_regimes/cliff.py

The paper's cliff lies between 12 and 16 rows of 4096 robots, ours between 16 and 24 of 1024
(10_ablation). So the paper's tails there, in rollouts of 16, 20 and 24 rows, beside PPO with all rows
simulated and PPO without the rows that a tail writes. "p_equal_all": equal to all rows simulated, within
1.0 of return (`stats.MARGIN`). Holm's p are over the six tails.
"""

from pathlib import Path

import numpy as np
import plot

from experiments import paper, pictures, stats

TAIL, ENVS, ROWS = 4, 1024, (16, 20, 24)
TAILS = ("dyna4_noschedule", "dyna4")
PPO_ROWS = (12, 16, 20, 24, 28, 32)
BEST = (8, 24)  # real rows, all rows
SEEDS = 5
LINE: dict = {"color": pictures.COLOURS["ppo16"], "linewidth": 1.3}
COLUMNS = (
    "rows variant status seeds max_reward_mean max_reward_low max_reward_high evaluated_return p_vs_fewer "
    "p_vs_fewer_holm p_vs_all p_vs_all_holm p_equal_all difference_to_all difference_to_all_low "
    "difference_to_all_high limit success_rate_pct sim_steps_M_mean"
).split()


def main():
    make(Path(__file__).parent)


def jobs(folder: Path) -> list[str]:
    """The runs of this question that nobody has."""
    here = plot.Regime("", ENVS)
    cells = [(here, name, rows) for rows in ROWS for name in TAILS]
    return [plot.job(*cell) for cell in cells if not plot.found(folder, *cell)]


def make(out: Path, robots=plot.ROBOTS) -> None:
    rows = build(out / "results")
    paper.write(out / "cliff.csv", rows)
    paper.show(rows, COLUMNS)
    draw(out / "results", robots, out / "cliff")


def run(folder: Path, envs: int, variant: str, rows: int) -> paper.Run | None:
    """A tail, or "ppo", in rollouts of so many rows."""
    if variant == "ppo":
        variant = {n: name for name, n in plot.PPO.items()}.get(rows, "ppo16")
    return plot.found(folder, plot.Regime("", envs), variant, rows)


def build(folder: Path) -> list[dict]:
    """Four rows a length: PPO with fewer rows, the tails, PPO with all rows."""
    usual = plot.found(folder, plot.Regime("", 4096), "ppo16")
    limit = 0.8 * float(paper.peak(usual).mean()) if usual and usual.columns else None
    out = [
        cells(folder, name, rows, limit)
        for rows in ROWS
        for name in (f"ppo{rows - TAIL}", *TAILS, f"ppo{rows}")
    ]
    for name in ("p_vs_fewer", "p_vs_all"):
        stats.adjust(out, name)
    return out


def cells(folder: Path, name: str, rows: int, limit: float | None) -> dict:
    """What PPO or a tail came to, and a tail's p against PPO with fewer and with all rows."""
    is_tail, known = name in TAILS, {n: run(folder, ENVS, "ppo", n) for n in (rows - TAIL, rows)}
    found = run(folder, ENVS, name, rows) if is_tail else known[int(name.removeprefix("ppo"))]
    out = {"envs": ENVS, "rows": rows, "variant": name, "status": paper.status(found)}
    if not (found and found.columns):
        return out
    out |= paper.returns(found)
    if evaluation := found.summary.get("evaluation"):
        out["evaluated_return"] = float(np.mean(evaluation["return"]))
    for column, other in zip(("p_vs_fewer", "p_vs_all"), known.values(), strict=True):
        if is_tail and other and other.columns:
            out[column] = stats.welch_of(paper.peak(found), paper.peak(other))
            if column == "p_vs_all":
                some = stats.compare(paper.peak(found), paper.peak(other), stats.MARGIN["go1"])
                out |= {"p_equal_all": some["p_equal"], "difference_to_all": some["difference"]}
                out |= {f"difference_to_all_{n}": some[f"difference_{n}"] for n in ("low", "high")}
    if limit is not None:
        out |= {"limit": limit} | paper.effort(found, limit, paper.tenth)
    return out


def draw(folder: Path, robots, path: Path) -> None:
    """Best return over simulated rows, a panel for each R; a thin line to all rows, synthetic ones too."""
    across = min(2, len(robots))
    page, axes = pictures.figure(-(-len(robots) // across), across, 6.4, sharey=True, sharex=True)
    names = plot.NAMES | {
        "ppo": "PPO",
        "best": "best at c27cee7: 8 simulated rows, 16 of the model",
    }
    seeds = []
    for axis, envs in zip(axes.flat, robots, strict=True):
        some = [(n, found) for n in PPO_ROWS if (found := run(folder, envs, "ppo", n))]
        seeds += points(axis, [n for n, _ in some], [found for _, found in some], "ppo16")
        axis.plot([n for n, _ in some], [paper.peak(r).mean() for _, r in some], **LINE)
        for name, shift in zip(TAILS, (-0.3, 0.3), strict=True):  # beside each other
            some = [(n, found) for n in ROWS if (found := run(folder, envs, name, n))]
            x = [n - TAIL for n, _ in some]
            seeds += points(axis, x, [found for _, found in some], name, TAIL, shift)
        if found := run(folder, envs, "best", BEST[1]):
            seeds += points(axis, [BEST[0]], [found], "best", BEST[1] - BEST[0])
        axis.set_title(f"{envs} robots", loc="left")
        axis.set(xticks=(8, *PPO_ROWS), ylim=(0, 46))
    for axis in axes[-1]:
        axis.set_xlabel("simulated rows of a rollout")
    for row in axes:
        row[0].set_ylabel("best return of 500 iterations")
    for name, variant in (("ppo", "ppo16"), *((name, name) for name in (*TAILS, "best"))):
        style = pictures.mark(variant) | {"linestyle": "-" if name == "ppo" else ""}
        axes[0, 0].plot([], [], label=names[name], markersize=5, **style)
    text = "Go1. A thin line goes from the simulated rows to all rows, the model's too: where it meets\n"
    text += (
        "PPO's, they do what simulated rows would. Tails of 20 and 24 rows with 1024 robots only."
    )
    if seeds:
        text += f"\nBar: {pictures.covers(seeds)}"
    pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def points(axis, x, runs, variant: str, synthetic: int = 0, shift: float = 0.0) -> list[int]:
    """Best returns at `x` rows, with intervals, moved by `shift`, and a line over the `synthetic` rows.

    Returns how many seeds each has.
    """
    style = pictures.mark(variant)
    for n, found in zip(x, runs, strict=True):
        best = stats.spread("best", paper.peak(found))
        axis.vlines(n + shift, best["best_low"], best["best_high"], style["color"], linewidth=1.3)
        ends = (n + shift, n + synthetic)
        axis.hlines(best["best_mean"], *ends, style["color"], linewidth=0.9)
        axis.plot(n + shift, best["best_mean"], markersize=5, **style)
    return [len(paper.peak(found)) for found in runs]


if __name__ == "__main__":
    main()

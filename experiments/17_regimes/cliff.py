"""Do four synthetic rows stand in for four real ones where these matter? cliff.csv and cliff.png.

    python experiments/17_regimes/cliff.py

The paper's cliff lies between 12 and 16 rows of 4096 robots, ours between 16 and 24 of 1024
(10_ablation). So the paper's tails there, in rollouts of 16, 20 and 24 rows, beside PPO with all rows
simulated and PPO without the rows that a tail writes.
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
COLUMNS = (
    "rows variant status seeds max_reward_mean max_reward_low max_reward_high evaluated_return p_vs_fewer "
    "p_vs_all limit success_rate_pct sim_steps_M_mean"
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
    return [
        cells(folder, name, rows, limit)
        for rows in ROWS
        for name in (f"ppo{rows - TAIL}", *TAILS, f"ppo{rows}")
    ]


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
    if limit is not None:
        out |= {"limit": limit} | paper.effort(found, limit, paper.EVERY)
    return out


def draw(folder: Path, robots, path: Path) -> None:
    """Best return over simulated rows, a panel for each R; a thin line to all rows, synthetic ones too."""
    size = 2.6 * len(robots) + 0.6, 4.1
    page, axes = pictures.figure(1, len(robots), size, sharey=True, sharex=True)
    names = plot.NAMES | {
        "ppo": "PPO",
        "best": "best at c27cee7: 8 simulated rows, 16 of the model",
    }
    colours = plot.COLOURS | {"ppo": plot.COLOURS["ppo16"]}
    for axis, envs in zip(axes[0], robots, strict=True):
        line = [(n, found) for n in PPO_ROWS if (found := run(folder, envs, "ppo", n))]
        points(axis, [n for n, _ in line], [found for _, found in line], colours["ppo"], line="-")
        for name, shift in zip(TAILS, (-0.25, 0.25), strict=True):  # beside each other
            some = [(n, found) for n in ROWS if (found := run(folder, envs, name, n))]
            x = [n - TAIL for n, _ in some]
            points(axis, x, [found for _, found in some], colours[name], TAIL, shift)
        if found := run(folder, envs, "best", BEST[1]):
            points(axis, [BEST[0]], [found], colours["best"], BEST[1] - BEST[0])
        axis.set_title(f"{envs} robots", loc="left", fontsize=10)
        axis.set(xticks=(8, *PPO_ROWS), xlabel="simulated rows of a rollout")
    for name in ("ppo", *TAILS, "best"):
        style = dict(color=colours[name], marker="o", markersize=4)
        line = "-" if name == "ppo" else ""
        axes[0, 0].plot([], [], label=names[name], linestyle=line, **style)
    axes[0, 0].set_ylabel("best return of 500 iterations")
    text = (
        "Go1. A thin line goes from the simulated rows to all rows, the model's too: where it meets PPO's,\n"
        "they do what simulated rows would. Mean of 3 or 5 seeds, bar: its 95 % interval; tails in rollouts\n"
        "of 20 and 24 rows with 1024 robots only"
    )
    pictures.head(page, text, fontsize=9)
    pictures.legend(page, axes[0, 0], 4)
    pictures.save(page, path)


def points(
    axis, x, runs, colour: str, synthetic: int = 0, shift: float = 0.0, line: str = ""
) -> None:
    """Best returns at `x` rows, with intervals moved by `shift`, and a line over the `synthetic` rows."""
    for n, found in zip(x, runs, strict=True):
        best = stats.spread("best", paper.peak(found))
        axis.vlines(n + shift, best["best_low"], best["best_high"], colour, linewidth=1.2)
        axis.hlines(best["best_mean"], n, n + synthetic, colour, linewidth=0.8)
    axis.plot(
        x, [paper.peak(found).mean() for found in runs], "o" + line, color=colour, markersize=4
    )


if __name__ == "__main__":
    main()

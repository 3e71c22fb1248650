"""Do four synthetic rows stand in for four real ones where these matter? cliff.csv and cliff.png.

    python experiments/17_regimes/cliff.py

The paper's cliff lies between 12 and 16 rows of 4096 robots, ours between 16 and 24 of 1024
(10_ablation). So the paper's tails there, in rollouts of 16, 20 and 24 rows, beside PPO with all rows
simulated and PPO without the rows that a tail writes.
"""

from pathlib import Path

import plot

from experiments import paper

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
    make(Path(__file__).parent, plot.ROBOTS)


def jobs(folder: Path) -> list[str]:
    """The runs of this question that nobody has."""
    here = plot.Regime("", ENVS)
    cells = [(name, rows if rows != 16 else None) for rows in ROWS for name in TAILS]
    return [plot.job(here, *cell) for cell in cells if not plot.found(folder, here, *cell)]


def make(out: Path, robots) -> None:
    rows = build(out / "results")
    paper.write(out / "cliff.csv", rows)
    paper.show(rows, COLUMNS)
    draw(out / "results", robots, out / "cliff")


def ppo(folder: Path, envs: int, rows: int) -> paper.Run | None:
    """Plain PPO with so many rows."""
    named = {n: name for name, n in plot.PPO.items()}
    variant = named.get(rows)
    regime = plot.Regime("", envs)
    return (
        plot.found(folder, regime, variant)
        if variant
        else plot.found(folder, regime, "ppo16", rows)
    )


def tail(folder: Path, envs: int, variant: str, rows: int) -> paper.Run | None:
    """One of the paper's tails in rollouts of so many rows."""
    return plot.found(folder, plot.Regime("", envs), variant, rows if rows != 16 else None)


def build(folder: Path) -> list[dict]:
    """Four rows a length: PPO with fewer rows, the tails, PPO with all rows."""
    usual = plot.found(folder, plot.Regime("", 4096), "ppo16")
    limit = 0.8 * float(paper.peak(usual).mean()) if usual and usual.columns else None
    out = []
    for rows in ROWS:
        fewer, every = ppo(folder, ENVS, rows - TAIL), ppo(folder, ENVS, rows)
        runs = {f"ppo{rows - TAIL}": fewer}
        runs |= {name: tail(folder, ENVS, name, rows) for name in TAILS} | {f"ppo{rows}": every}
        for name, one in runs.items():
            cells = {"envs": ENVS, "rows": rows, "variant": name, "status": paper.status(one)}
            if one and one.columns:
                cells |= paper.returns(one)
                if evaluation := one.summary.get("evaluation"):
                    cells["evaluated_return"] = sum(evaluation["return"]) / len(
                        evaluation["return"]
                    )
                for column, other in (("p_vs_fewer", fewer), ("p_vs_all", every)):
                    if name in TAILS and other and other.columns:
                        cells[column] = paper.welch_of(paper.peak(one), paper.peak(other))
                if limit is not None:
                    cells |= {"limit": limit} | paper.effort(one, limit, paper.EVERY)
            out.append(cells)
    return out


def draw(folder: Path, robots, path: Path) -> None:
    """Best return over simulated rows, a panel for each R; a thin line to all rows, synthetic ones too."""
    page, axes = paper.figure(
        1, len(robots), (2.6 * len(robots) + 0.6, 3.9), sharey=True, sharex=True
    )
    names = plot.NAMES | {"ppo16": "PPO"}
    for axis, envs in zip(axes[0], robots, strict=True):
        line = [
            (n, paper.spread("", paper.peak(one)))
            for n in PPO_ROWS
            if (one := ppo(folder, envs, n))
        ]
        point(axis, line, "ppo16", "-")
        for name in TAILS:
            known = ((rows, tail(folder, envs, name, rows)) for rows in ROWS)
            some = [(rows, paper.spread("", paper.peak(one))) for rows, one in known if one]
            shift = 0.25 if name == "dyna4" else -0.25  # beside each other
            point(axis, [(rows - TAIL + shift, cells) for rows, cells in some], name)
            for rows, cells in some:
                axis.hlines(cells["_mean"], rows - TAIL, rows, plot.COLOURS[name], linewidth=0.8)
        if one := plot.found(folder, plot.Regime("", envs), "best"):
            cells = paper.spread("", paper.peak(one))
            point(axis, [(BEST[0], cells)], "best")
            axis.hlines(cells["_mean"], *BEST, plot.COLOURS["best"], linewidth=0.8)
        axis.set_title(f"{envs} robots", loc="left", fontsize=10)
        axis.set(xticks=(8, *PPO_ROWS), xlabel="simulated rows of a rollout")
    for name in ("ppo16", *TAILS, "best"):
        style = dict(color=plot.COLOURS[name], marker="o", markersize=4)
        axes[0, 0].plot(
            [], [], label=names[name], linestyle="-" if name == "ppo16" else "", **style
        )
    axes[0, 0].set_ylabel("best return of 500 iterations")
    text = "Go1: mean of 3 or 5 seeds, bar: its 95 % interval; thin line to the right: the model's rows"
    paper.head(page, text)
    paper.legend(page, axes[0, 0], 4)
    paper.save(page, path)


def point(axis, some, name: str, line: str = "") -> None:
    """Means with their intervals."""
    if some:
        x, cells = zip(*some, strict=True)
        colour, mean = plot.COLOURS[name], [c["_mean"] for c in cells]
        axis.plot(x, mean, "o" + line, color=colour, markersize=4, linewidth=1.4)
        axis.vlines(
            x, [c["_low"] for c in cells], [c["_high"] for c in cells], colour, linewidth=1.2
        )


if __name__ == "__main__":
    main()

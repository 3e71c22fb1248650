"""results.csv, batches.csv and figure of all runs of the map's settings, beside the paper's Table I.

    python experiments/10_ablation/plot.py

All seeds of a cell count, whichever folder they were trained for; batches.csv names each batch. In
results.csv "kernel_difference" is what the seeds by our kernel have more than those by MuJoCo Warp, with
Welch's 95 % interval; "kernel_p_holm" is Holm's over all cells that have both.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import batches, paper, pictures, run, stats

ENVS, HORIZONS = (512, 1024, 2048, 4096, 8192), (12, 16, 20, 24, 28, 32)
# what decides most comes first: the paper's 4096 robots, and its best cell
GRID = [(envs, n) for envs in (4096, 8192, 2048, 1024, 512) for n in HORIZONS]
FIVE = ((1024, 12), (1024, 20), (1024, 24))  # five seeds where the return rises most, as WARP
OTHERS = Path(__file__).parent.parent
WARP = {  # runs of the same setting by MuJoCo Warp
    (4096, 12): ("12_platforms/earlier/go1_ppo12",),
    (4096, 16): (
        "12_platforms/earlier/go1_ppo16",
        "20_tail/results/first/go1_ppo16",
        "20_tail/results/second/go1_ppo16",
    ),
    (1024, 16): ("20_tail/results/go1_ppo16_1024", "20_tail/results/second/go1_ppo16_1024"),
}
KERNEL = {  # and by our kernel; those of 17_regimes are named as here
    (4096, 12): ("12_platforms/results/go1_ppo12",),
    (4096, 16): ("12_platforms/results/go1_ppo16",),
}
REGIMES = ("17_regimes/results", "17_regimes/results/more")
MARKS = "ovsD^"
COLUMNS = (
    "envs horizon status seeds max_reward_mean max_reward_low max_reward_high paper_max_reward "
    "policy_std_mean paper_policy_std to_30.5_success_rate_pct to_30.5_sim_steps_M_mean kernel_seeds "
    "kernel_difference kernel_p kernel_p_holm"
).split()


class Batch(NamedTuple):
    """Seeds of one setting that trained at once."""

    path: Path  # without suffix
    kernel: bool  # physics by our kernel, not by MuJoCo Warp's own step
    run: paper.Run


def job(envs: int, horizon: int) -> str:
    return f"go1:ppo16:rollout.num_envs={envs}:rollout.horizon={horizon}"


def main():
    make(Path(__file__).parent)


def make(out: Path, grid=GRID) -> None:
    rows = build(out / "results", grid)
    paper.write(out / "results.csv", rows)
    paper.write(out / "batches.csv", named(out / "results", grid))
    paper.show(rows, COLUMNS)
    for line in findings(rows):
        print(line)
    draw(rows, out / "ablation")


def build(folder: Path, grid) -> list[dict]:
    """A row a cell, R and N rising; minutes are of all seeds of its first batch, which train at once."""
    printed, rows = paper.table("ablation"), []
    for envs, horizon in sorted(grid):
        found = load(folder, envs, horizon)
        row = {"envs": envs, "horizon": horizon, "status": paper.status(found)}
        if found and found.columns:
            row |= paper.returns(found) | engines(batches_of(folder, envs, horizon))
            took = paper.effort(found, paper.LIMIT, paper.tenth)
            row |= {f"to_{paper.LIMIT}_{name}": value for name, value in took.items()}
            row["minutes"] = found.summary["seconds"] / 60
            row["sim_steps_M"] = found.summary["sim_steps"] / 1e6
            row["device"] = found.summary["device"]
        theirs = paper.pick(printed, envs=float(envs), horizon=float(horizon))
        names = {"max_reward": "max_reward", "policy_std": "policy_std", "minutes": "time_min"}
        rows.append(row | {f"paper_{ours}": theirs.get(name) for ours, name in names.items()})
    stats.adjust(rows, "kernel_p")
    return rows


def batches_of(folder: Path, envs: int, horizon: int) -> list[Batch]:
    """All runs of a cell's setting that have not diverged, those by MuJoCo Warp first."""
    name = run.name(job(envs, horizon))
    warp = [folder / name, *(OTHERS / path for path in WARP.get((envs, horizon), ()))]
    kernel = [folder / "more" / name, *(OTHERS / path / name for path in REGIMES)]
    kernel += [OTHERS / path for path in KERNEL.get((envs, horizon), ())]
    found = [(p, p in kernel, paper.load(p.parent, p.name)) for p in [*warp, *kernel]]
    return [Batch(path, by, one) for path, by, one in found if one and one.columns]


def engines(some: list[Batch]) -> dict:
    """Cells: a cell's seeds by our kernel against those by MuJoCo Warp."""
    fast, slow = ([v for b in some if b.kernel == by for v in paper.peak(b.run)] for by in (1, 0))
    if not (fast and slow):
        return {}
    found = stats.difference(fast, slow)
    cells = {"kernel_difference": found.value, "kernel_low": found.low, "kernel_high": found.high}
    return {"kernel_seeds": len(fast)} | cells | {"kernel_p": stats.welch_of(fast, slow)}


def named(folder: Path, grid) -> list[dict]:
    """A row a batch: where it is, what trained it, and its best return."""
    rows = []
    for envs, horizon in sorted(grid):
        for path, kernel, one in batches_of(folder, envs, horizon):
            where = folder.parent if path.is_relative_to(folder) else OTHERS
            row = {"envs": envs, "horizon": horizon, "batch": path.relative_to(where).parent}
            row |= {"engine": "kernel" if kernel else "MuJoCo Warp", "seeds": len(paper.peak(one))}
            row |= stats.spread("max_reward", paper.peak(one))
            rows.append(
                row | {name: one.summary.get(name) for name in ("device", "commit", "date")}
            )
    return rows


def load(folder: Path, envs: int, horizon: int) -> paper.Run | None:
    """A cell's seeds of all batches, every tenth iteration."""
    some = [tenths(batch.run) for batch in batches_of(folder, envs, horizon)]
    return batches.pool(some) if some else paper.load(folder, run.name(job(envs, horizon)))


def tenths(one: paper.Run) -> paper.Run:
    """Every tenth iteration of a run, which is all that some keep; its policy std is of all rows."""
    rows = one.columns["iteration"][:, 0] % paper.EVERY == 0
    std = {"policy_std": paper.policy_std(one).tolist()}
    return paper.Run({name: c[rows] for name, c in one.columns.items()}, one.summary | std)


def best(rows, name: str = "max_reward_mean") -> dict:
    """The cell of the highest `name`, or {}."""
    return max((row for row in rows if row.get(name)), key=lambda row: row[name], default={})


def findings(rows) -> list[str]:
    """What the paper says of its table, for both; how far the maps are apart; whether batches agree."""
    out, maps = [], {}
    for who, reward, std in (
        ("ours", "max_reward_mean", "policy_std_mean"),
        ("paper", "paper_max_reward", "paper_policy_std"),
    ):
        cells = {(row["envs"], row["horizon"]): row[reward] for row in rows if row.get(reward)}
        if not cells:
            continue
        maps[who], top = cells, best(rows, reward)
        line = f"{who}: best {top[reward]:.1f} at R={top['envs']}, N={top['horizon']}; 80 % of it "
        line += f"{0.8 * top[reward]:.2f}"
        pairs = np.array([(row[reward], row[std]) for row in rows if row.get(reward)])
        if len(pairs) > 2:
            correlation = np.corrcoef(pairs.T)[0, 1]
            line += f"; correlation of policy std and reward {correlation:.2f}"
        out += [line, *steepest(rows, cells, who == "ours"), rows_to(cells)]
    if len(maps) == 2:
        out += [line for times in (1, 2) if (line := apart(maps, times))]
    return out + agree(rows)


def steepest(rows, cells, ours: bool) -> list[str]:
    """The largest gains by four and by eight rows more; of ours with Welch's interval and p, and Holm's p."""
    out = []
    for more in (4, 8):
        gains = []
        for (envs, n), at in cells.items():
            if (envs, n + more) in cells:
                gains.append({"envs": envs, "n": n, "gain": cells[envs, n + more] - at})
                if ours:
                    ends = [paper.pick(rows, envs=envs, horizon=m) for m in (n + more, n)]
                    some = [best_return(end) for end in ends]
                    gains[-1] |= {"ends": stats.difference(*some), "p": stats.welch_of(*some)}
        stats.adjust(gains, "p")
        for row in sorted(gains, key=lambda row: -row["gain"])[:3]:
            line = f"  R={row['envs']}, N {row['n']} to {row['n'] + more}: {row['gain']:+.1f}"
            if ours:
                line += f" ({row['ends'].low:.1f} to {row['ends'].high:.1f})"
                line += f", p {row['p']:.2g}, Holm {row['p_holm']:.2g}"
            out.append(line)
    return out


def best_return(row) -> stats.Moments:
    """Of a cell, over its seeds."""
    return stats.Moments(row["max_reward_mean"], row["max_reward_sd"], row["seeds"])


def rows_to(cells, limit: float = paper.LIMIT) -> str:
    """At how many rows the line through the means of R robots first is at `limit`."""
    out = []
    for envs in sorted({r for r, _ in cells}):
        x = [n for r, n in sorted(cells) if r == envs]
        y = [cells[envs, n] for n in x]
        k = next((k for k, at in enumerate(y) if at >= limit), None)
        if k:
            out.append(f"R={envs}: {np.interp(limit, y[k - 1 : k + 1], x[k - 1 : k + 1]):.1f}")
        else:
            out.append(f"R={envs}: " + ("never" if k is None else f"{x[0]} or fewer"))
    return f"  rows to {limit}: " + ", ".join(out)


def apart(maps, times: int) -> str:
    """How far ours at R robots is from the paper's at `times` R; nothing without a cell in both."""
    ours, theirs = maps["ours"], maps["paper"]
    by = [at - theirs[times * r, n] for (r, n), at in ours.items() if (times * r, n) in theirs]
    if not by:
        return ""
    line = f"ours at R less the paper's at {times} R, {len(by)} cells: mean {np.mean(by):+.1f}, "
    return line + f"mean size {np.mean(np.abs(by)):.1f}"


def agree(rows) -> list[str]:
    """Whether seeds by our kernel differ from those by MuJoCo Warp."""
    some = [row for row in rows if "kernel_p" in row]
    if not some:
        return []
    low, lower = (
        sum(row[name] < stats.ALPHA for row in some) for name in ("kernel_p", "kernel_p_holm")
    )
    mean = stats.spread("by", [row["kernel_difference"] for row in some])
    line = f"kernel against MuJoCo Warp, {len(some)} cells: {low} differ by p below {stats.ALPHA:.2f}, "
    ends = f"({mean['by_low']:.2f} to {mean['by_high']:.2f} over cells)"
    return [f"{line}{lower} by Holm; mean difference {mean['by_mean']:+.2f} {ends}"]


def draw(rows, path: Path) -> None:
    """Figure 4: best return against N, a line for each R; ours beside the paper's."""
    page, axes = pictures.figure(1, 2, 4.6, sharey=True)
    every = sorted({row["envs"] for row in rows})
    shades, marks = pictures.SHADES[-len(every) :], MARKS[-len(every) :]
    for axis, who, mean in zip(
        axes[0], ("ours", "paper"), ("max_reward_mean", "paper_max_reward"), strict=True
    ):
        for k, (envs, colour, mark) in enumerate(zip(every, shades, marks, strict=True)):
            cells = [row for row in rows if row["envs"] == envs and row.get(mean) is not None]
            if not cells:
                continue
            aside = 0.64 * (k - (len(every) - 1) / 2) * (who == "ours")  # bars side by side
            x, y = [row["horizon"] + aside for row in cells], [row[mean] for row in cells]
            style = dict(color=colour, marker=mark, markersize=5.5, linewidth=1.1)
            axis.plot(x, y, label=f"R = {envs}", **style)
            if who == "ours":
                ends = ([row[f"max_reward_{end}"] for row in cells] for end in ("low", "high"))
                axis.vlines(x, *ends, color=colour, linewidth=1.8)
        if not axis.lines:
            pictures.missing(axis)
        axis.set_title("this repository" if who == "ours" else "paper", loc="left")
        axis.set(xlabel="rows of a rollout N (control steps)", xticks=HORIZONS, xlim=(10.3, 33.7))
    axes[0, 0].set_ylim(0, 50)
    axes[0, 0].set_ylabel("best return of 500 iterations,\nmean over seeds")
    seeds = [row["seeds"] for row in rows if "seeds" in row]
    if seeds:
        pictures.head(page, f"Bar: {pictures.covers(seeds)}. R: robots", fontsize=9.5, color="0.35")
    handles, labels = axes[0, 1 if axes[0, 1].lines else 0].get_legend_handles_labels()
    page.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    pictures.save(page, path)


if __name__ == "__main__":
    main()

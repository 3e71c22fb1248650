"""results.csv (Table IV), split.csv (the time of Table V) and figure of the runs in results/.

    python experiments/13_step_time/plot.py

results/kernel has the runs of run.py, results/mujoco_warp one run a variant by MuJoCo Warp's own step.
"""

import json
from pathlib import Path

import numpy as np

from dynappo import schedule
from experiments import paper, pictures, run, stats

# folder of results/ -> what simulates, and its variants
SIMULATORS = {
    "kernel": ("our kernel", ("ppo12", "ppo16", "dyna4", "best")),
    "mujoco_warp": ("MuJoCo Warp's own step", ("ppo16", "dyna4", "best")),
}
VARIANTS = SIMULATORS["kernel"][1]
# folder -> its `best`; all else has 4096 robots
BEST = {"kernel": "best,\n1024 robots", "mujoco_warp": "best of then"}
# phase of dynappo.bench -> the paper's name
PHASES = {
    "physics": "Ground-truth Simulation (p)",
    "tail": "Synthetic Generation (p_hat)",
    "fit": "Model Training (L_model)",
    "ppo": "Policy Training (L_CLIP)",
}
SUMS = ("ppo12_sum", "ppo16_sum", "tail_sum", "saved_pct")
COLUMNS = (
    "simulator variant status runs physics_mean physics_sd physics_again_mean physics_again_sd tail_mean "
    "tail_sd tail_share_pct_mean fit_mean fit_sd ppo_mean ppo_sd iteration_mean iteration_sd "
    "ppo16_sum_mean tail_sum_mean saved_pct_mean saved_pct_sd pays_from pays_from_low pays_from_high "
    "break_even_mean break_even_low break_even_high"
).split()
PARTS = ("physics", "synthetic", "fit", "ppo")
SPLIT = (
    "variant status times_of runs physics_min synthetic_min fit_min ppo_min rest_min total_min_mean "
    "total_min_sd paper_total_min"
).split()
THEIRS = ("sim_collection_min", "synthetic_gen_min", "policy_learning_min", "total_min")
SHADES = (pictures.BLACK, pictures.ORANGE, pictures.BLUE, "#b9b9b9")
LABELS = ("physics", "synthetic steps", "fit of the model", "PPO update")
# real rows, synthetic rows of all rounds, fits, updates of an iteration as the tail is longest
ROWS = {
    "ppo16": (16, 0, 0, 1),
    "dyna4": (12, 4, 1, 1),
    "best": (8, 16, 1, 1),
}  # `best` of mujoco_warp


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    reports = {
        folder: {name: load(out / "results" / folder, name) for name in names}
        for folder, (_, names) in SIMULATORS.items()
    }
    rows = build(reports)
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    times = split(reports["kernel"])
    paper.write(out / "split.csv", times)
    paper.show(times, SPLIT)
    draw(rows, reports, out / "step_time")


def load(folder: Path, name: str) -> list[dict]:
    """The reports of `dynappo.bench` on a variant, one a run."""
    paths = sorted(folder.glob(f"go1_{name}_[0-9].json"))
    return [one for p in paths for one in json.loads(p.read_text())["configs"].values()]


def build(reports) -> list[dict]:
    """A row a simulator and variant, of one iteration in ms; and the paper's."""
    rows = []
    for folder, some in reports.items():
        for variant, runs in some.items():
            row: dict = {"simulator": folder, "variant": variant}
            if runs:
                every = [one["ms"] for one in runs]
                # `best` has another rollout than PPO-16: its own iteration says it all
                row |= {"status": "", "runs": len(runs)}
                row |= measures(every, variant != "best", counts(variant, runs))
                if variant in ("ppo12", "ppo16"):
                    row |= again(every, int(variant[3:]))
                row |= {name: runs[0].get(name) for name in ("device", "commit")}
            rows.append(row if runs else row | {"status": "not run"})
    printed = paper.table("step_time")
    theirs = {ours: paper.pick(printed, phase=name)["avg_time_ms"] for ours, name in PHASES.items()}
    cells = measures([theirs], True, ROWS["dyna4"])
    cells = {name: value for name, value in cells.items() if value == value}
    return [*rows, {"simulator": "paper", "device": "NVIDIA A40"} | cells]


def measures(every: list[dict], sums: bool, some: tuple[int, ...]) -> dict:
    """Cells over runs: ms of each phase, sums of them, from how many steps a tail pays, `break_even`.

    `some` as in `ROWS`.
    """
    cells = {}
    for name in (*PHASES, "iteration"):
        if all(name in ms for ms in every):
            cells |= stats.spread(name, [ms[name] for ms in every])
    if all("fit" in ms for ms in every):
        shares = [100 * ms["tail"] / ms["physics"] for ms in every]
        cells |= stats.spread("tail_share_pct", shares)
        if some[3] == 1:  # further rounds cost updates, too
            cells |= pays([ms["fit"] for ms in every], [ms["physics"] - ms["tail"] for ms in every])
        if some[1]:  # a short run ends before its schedule has a tail
            cells |= stats.spread("break_even", [break_even(ms, some) for ms in every])
    found = [derived(ms) for ms in every] if sums else [{}]
    for name in SUMS:
        if all(name in one for one in found):
            cells |= stats.spread(name, [one[name] for one in found])
    return cells


def again(every: list[dict], horizon: int) -> dict:
    """Cells: a step of physics from `iteration`, which without a model is the call of `physics` once more."""
    found = [(ms["iteration"] - ms["ppo"]) / horizon for ms in every]
    return stats.spread("physics_again", found)


def derived(ms: dict) -> dict:
    """Iterations as sums of phases, and the share of PPO-16's that a tail of 4 steps saves."""
    out = {f"ppo{n}_sum": n * ms["physics"] + ms["ppo"] for n in (12, 16)}
    if "fit" in ms:
        out["tail_sum"] = 12 * ms["physics"] + 4 * ms["tail"] + ms["fit"] + ms["ppo"]
        out["saved_pct"] = 100 * (1 - out["tail_sum"] / out["ppo16_sum"])
    return out


def pays(fits, gains) -> dict:
    """Cells: synthetic steps from which a tail pays, where N_s (physics - synthetic) is the fit, in ms.

    "never" where a synthetic step takes no less than one of physics: then no number of them pays for a
    fit. No interval where that is not excluded (`stats.ratio`).
    """
    if np.mean(gains) <= 0:
        return {"pays_from": "never"}
    found = stats.ratio(fits, gains)
    return {"pays_from": found.value, "pays_from_low": found.low, "pays_from_high": found.high}


def break_even(ms: dict, some: tuple[int, ...]) -> float:
    """ms of a step of physics above which an iteration with a tail is shorter than one with all steps real.

    (fit + N_s M p_hat + (M - 1) u) / N_s, with M rounds of N_s synthetic steps p_hat and an update u each.
    """
    _, synthetic, _, rounds = some
    return (ms["fit"] + synthetic * ms["tail"] + (rounds - 1) * ms["ppo"]) / (synthetic / rounds)


def split(reports) -> list[dict]:
    """A row a variant: minutes of a whole training by phase, means over runs, and of one on the clock.

    Where only `dyna4` is measured, its times are those of the other tails, and nothing is left over.
    """
    rows, printed = [], paper.table("platforms")
    for variant in (*paper.VARIANTS, "best"):
        source = variant if variant in VARIANTS else "dyna4"
        runs = [one for one in reports[source] if "training_seconds" in one]
        row: dict = {"variant": variant, "status": "" if runs else "not run"}
        if runs:
            row |= {"times_of": source, "runs": len(runs)}
            every = []
            for one in runs:
                ours, timed = (
                    run.configure(f"go1:{v}", 1, one["settings"]) for v in (variant, source)
                )
                every.append(parts(ours, timed, one["ms"]))
            row |= {f"{name}_min": np.mean([one[name] for one in every]) for name in PARTS}
            total = [sum(one.values()) for one in every]
            if source == variant:
                clock = np.array([one["training_seconds"] / 60 for one in runs])
                row["rest_min"], total = np.mean(clock - total), clock
            row |= stats.spread("total_min", total)
        theirs = paper.pick(printed, robot="go1", variant=variant)
        rows.append(row | {f"paper_{name}": theirs.get(name) for name in THEIRS})
    return rows


def parts(config, timed, ms: dict) -> dict[str, float]:
    """Minutes of a training by phase, from what a step, a fit and an update of `timed` take as its tail is
    longest."""
    columns, horizon = schedule.columns(config), config.rollout.horizon
    real = columns["n_real"].astype(float)
    rounds = columns.get("rounds", np.ones_like(real))
    took = {"physics": real.sum() * ms["physics"], "ppo": rounds.sum() * ms["ppo"]}
    took["synthetic"] = ((horizon - real) * rounds).sum() * ms["tail"]
    if "model_epochs" in columns:
        longest = fits(timed)[: timed.schedule.last_iteration][-1]
        took["fit"] = fits(config).sum() / longest * ms["fit"]
    return {name: took.get(name, 0.0) / 60e3 for name in PARTS}


def fits(config) -> np.ndarray:
    """Minibatches of each iteration's fit."""
    columns = schedule.columns(config)
    drawn = config.rollout.horizon // config.model.minibatches
    return np.ceil(columns["model_epochs"] * columns["n_real"].astype(float) / drawn)


def counts(variant: str, runs: list[dict]) -> tuple[int, ...]:
    """As `ROWS`, of what was measured."""
    last = runs[0].get("last") if runs else None
    if not last:
        return ROWS[variant]
    config = run.configure(f"go1:{variant}", 1, runs[0]["settings"])
    rounds, real = last.get("rounds", 1), last["n_real"]
    return real, (config.rollout.horizon - real) * rounds, int("model_epochs" in last), rounds


def draw(rows, reports, path: Path) -> None:
    """Bars: an iteration by phase, a panel a simulator that has run, on one scale, and the paper's."""
    shown = [folder for folder, some in reports.items() if any(some.values())] or ["kernel"]
    page, axes = pictures.figure(1, len(shown) + 1, 2.7)
    widest = 0.0
    for axis, folder in zip(axes[0], [*shown, "paper"], strict=True):
        title = "paper (another scale)" if folder == "paper" else SIMULATORS[folder][0]
        axis.set_title(title, loc="left")
        names = ("ppo16", "dyna4") if folder == "paper" else tuple(ROWS)
        axis.set(xlabel="ms an iteration", yticks=range(len(names)))
        axis.set_ylim(len(ROWS) - 0.4, -0.6)
        labels = []
        for y, variant in enumerate(names):
            runs = reports.get(folder, {}).get(variant, [])
            some = counts(variant, runs)
            labels.append(label(folder, variant, some))
            wanted = {} if folder == "paper" else {"variant": variant}
            row = paper.pick(rows, simulator=folder, **wanted)
            if "ppo_mean" not in row:
                axis.text(0, y, " not run yet", va="center", color="0.5")
                continue
            widths = [
                n * row.get(f"{phase}_mean", 0.0) for n, phase in zip(some, PHASES, strict=True)
            ]
            end = bar(axis, y, widths, row.get("iteration_mean"))
            widest = max(widest, end if folder != "paper" else 0.0)
        axis.set_yticklabels(labels)
        axis.margins(x=0.18)
    for axis in axes[0, :-1]:
        axis.set_xlim(0, 1.2 * widest or 1)
        axis.locator_params(axis="x", nbins=5)
    for colour, text in zip(SHADES, LABELS, strict=True):  # for the legend
        axes[0, -1].barh(0, 0, color=colour, label=text)
    axes[0, -1].plot([], [], color=pictures.VERMILION, label="iteration as measured")
    pictures.legend(page, axes[0, -1], 5)
    pictures.save(page, path)


def label(folder: str, variant: str, some: tuple[int, ...]) -> str:
    """What a bar is; of `best` also which one, and its steps, real and of each round."""
    if variant != "best":
        return paper.VARIANTS[variant]
    rounds = f"{some[3]} x " if some[3] > 1 else ""
    return f"{BEST[folder]}\n({some[0]} + {rounds}{some[1] // some[3]} steps)"


def bar(axis, y: int, widths: list[float], measured: float | None) -> float:
    """One iteration, its phases side by side; a line and a number where it ends on the clock, or else
    the phases' sum. Returns the wider of both."""
    left = 0.0
    for width, colour in zip(widths, SHADES, strict=True):
        axis.barh(y, width, left=left, color=colour, height=0.55)
        left += width
    if measured is not None:
        axis.plot([measured] * 2, [y - 0.36, y + 0.36], color=pictures.VERMILION, linewidth=1.6)
    end = max(left, measured or 0.0)
    text = f"  {measured or left:.3g}"
    if measured and left > 1.05 * measured:
        text += f"\n  (phases: {left:.3g})"
    axis.text(end, y, text, va="center")
    return end


if __name__ == "__main__":
    main()

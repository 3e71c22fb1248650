"""results.csv (Table IV) and figure of what `dynappo.bench` wrote into results/.

python experiments/13_step_time/plot.py
"""

import json
from pathlib import Path

from experiments import paper, pictures

VARIANTS = ("ppo16", "dyna4", "best")
# phase of dynappo.bench -> the paper's name
PHASES = {
    "physics": "Ground-truth Simulation (p)",
    "tail": "Synthetic Generation (p_hat)",
    "fit": "Model Training (L_model)",
    "ppo": "Policy Training (L_CLIP)",
}
SHADES = (pictures.BLACK, pictures.ORANGE, pictures.BLUE, "#b9b9b9")
NAMES = paper.VARIANTS | paper.OURS
# real rows, synthetic rows, fits of an iteration as the schedule ends
ROWS = {"ppo16": (16, 0, 0), "dyna4": (12, 4, 1), "best": (8, 16, 1)}
LABELS = ("physics", "synthetic steps", "fit of the model", "PPO update")


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    reports = {name: load(out / "results" / f"go1_{name}.json") for name in VARIANTS}
    rows = build(reports)
    paper.write(out / "results.csv", rows)
    paper.show(rows, list(rows[0]))
    for name, report in reports.items():
        print(f"{name}: {report['device']}, MJX-{report['impl']}" if report else f"{name}: not run")
    draw(rows, out / "step_time")


def load(path: Path) -> dict | None:
    """The report of the one config that `dynappo.bench` measured; None if it has not."""
    if not path.exists():
        return None
    (report,) = json.loads(path.read_text())["configs"].values()
    return report


def build(reports: dict[str, dict | None]) -> list[dict]:
    """ms a phase, and what follows from them for every variant: see `derived`."""
    printed = paper.table("step_time")
    theirs = {ours: paper.pick(printed, phase=name)["avg_time_ms"] for ours, name in PHASES.items()}
    rows = []
    for phase in PHASES:
        unit = "ms a step" if phase in ("physics", "tail") else "ms an iteration"
        row = {"phase": phase, "unit": unit, "paper": theirs[phase]}
        rows.append(row | {name: r["ms"].get(phase) if r else None for name, r in reports.items()})
    measured = {"phase": "iteration, as the schedule ends", "unit": "ms", "paper": None}
    rows.append(measured | {n: r["ms"]["iteration"] if r else None for n, r in reports.items()})
    columns = {"paper": derived(theirs)}
    for name, report in reports.items():  # `best` has another rollout: its row above says it all
        columns[name] = derived(report["ms"]) if report and name != "best" else {}
    for label, unit in DERIVED:
        row = {"phase": label, "unit": unit}
        rows.append(row | {name: cells.get(label) for name, cells in columns.items()})
    return rows


DERIVED = (
    ("PPO-12, sum", "ms an iteration"),
    ("PPO-16, sum", "ms an iteration"),
    ("4-step tail of 16, sum", "ms an iteration"),
    ("saved by it of PPO-16", "%"),
    ("steps from which a tail pays", "steps"),
)


def derived(ms: dict) -> dict:
    """Iterations as sums of phases; and where a tail pays: N_s (physics - tail) = fit."""
    out = {f"PPO-{n}, sum": n * ms["physics"] + ms["ppo"] for n in (12, 16)}
    if ms.get("fit"):
        with_tail = 12 * ms["physics"] + 4 * ms["tail"] + ms["fit"] + ms["ppo"]
        out["4-step tail of 16, sum"] = with_tail
        out["saved by it of PPO-16"] = 100 * (1 - with_tail / out["PPO-16, sum"])
        gain = ms["physics"] - ms["tail"]
        out["steps from which a tail pays"] = ms["fit"] / gain if gain > 0 else None
    return out


def bars(ms: dict, ours: bool) -> dict[str, list[float] | None]:
    """Label -> ms of an iteration by phase, of every bar of a panel; None where it is not measured."""
    if not ours:
        wanted = {
            "PPO, 16 steps": ("paper", ROWS["ppo16"]),
            "4-step tail": ("paper", ROWS["dyna4"]),
        }
    else:
        wanted = {NAMES[name]: (name, rows) for name, rows in ROWS.items()}
    out: dict[str, list[float] | None] = {}
    for label, (column, (real, tail, fit)) in wanted.items():
        if ms["ppo"][column] is None:
            out[label] = None
            continue
        counts = dict(zip(PHASES, (real, tail, fit, 1), strict=True))
        out[label] = [count * (ms[phase][column] or 0.0) for phase, count in counts.items()]
    return out


def draw(rows, path: Path) -> None:
    """Bars: an iteration by phase, of what is measured; each panel has its own scale."""
    page, axes = pictures.figure(1, 2, 2.6)
    ms = {row["phase"]: row for row in rows}
    panels = ((True, "this repository, 4096 robots"), (False, "paper (A40)"))
    for axis, (ours, title) in zip(axes[0], panels, strict=True):
        found = bars(ms, ours)
        axis.set_title(title, loc="left")
        axis.set(xlabel="ms an iteration", yticks=range(len(found)), yticklabels=found)
        axis.set_ylim(len(found) - 0.4, -0.6)
        for y, widths in enumerate(found.values()):
            if widths is None:
                axis.text(0, y, " not run yet", va="center", color="0.5")
                continue
            left = 0.0
            for width, colour in zip(widths, SHADES, strict=True):
                axis.barh(y, width, left=left, color=colour, height=0.55)
                left += width
            axis.text(left, y, f" {left:.0f}", va="center")
        axis.margins(x=0.12)
    for colour, label in zip(SHADES, LABELS, strict=True):  # for the legend
        axes[0, 1].barh(0, 0, color=colour, label=label)
    pictures.legend(page, axes[0, 1], 4)
    pictures.save(page, path)


if __name__ == "__main__":
    main()

"""Tables in Markdown and curves.png from the runs of walk.py in results/.

    python experiments/04_laptop/table.py

Intervals are Student's t over seeds, 95 %. Many runs shared their machine, so seconds are those of two
idle cores: iterations times the time of one (`results/ms.json`, by walk.py), of `:laptop` those of a whole
run (`IDLE`).
"""

import json
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from dynappo.run import learning_curves
from experiments import paper, pictures

HERE = Path(__file__).parent
RESULTS = HERE / "results"
SECONDS = (30, 45, 60, 90)  # of training
LEVEL = 35  # of 45
IDLE = "go1-103"  # a run that had the machine to itself
METHODS = {  # files -> label, colour
    "go1": ("`:laptop`: 8 simulated rows, a tail of 16", pictures.BLUE),
    "ppo8": ("PPO alone, 8 rows", pictures.ORANGE),
    "ppo16": ("PPO alone, 16 rows", pictures.BLACK),
    "ppo24": ("PPO alone, 24 rows", pictures.GREY),
}


def main():
    paper.parser(__doc__).parse_args()
    print(robots(), in_time(), cores(), sep="\n\n")
    draw(HERE / "curves.png")


def runs(name: str) -> list[dict]:
    """The runs `results/seeds/NAME-SEED.json`, by seed."""
    ms = json.loads((RESULTS / "ms.json").read_text()).get(name)
    idle = json.loads((RESULTS / "seeds" / f"{IDLE}.json").read_text())["rows"]
    clock = [[row[n] for row in idle] for n in ("iteration", "seconds")]
    found = [json.loads(p.read_text()) for p in sorted((RESULTS / "seeds").glob(f"{name}-*.json"))]
    for run in found:
        for row in run["rows"]:
            i = row["iteration"]
            row["seconds"] = i * ms / 1000 if ms else float(np.interp(i, *clock))
    return found


def mean(values) -> str:
    """Mean and half of its interval."""
    if len(values) == 1:
        return f"{values[0]:.1f}"
    return f"{np.mean(values):.1f} ± {learning_curves.half_width(values):.1f}"


def walk(rows: list[dict], least: float) -> bool:
    """Whether a run's robot walks at its end: at the level `least`, with falls in at most 1 %."""
    columns = ([row[name] for row in rows] for name in ("steps", "return", "fall_rate"))
    return bool(np.isfinite(walks.reached(*columns, least).walks))


def robots() -> str:
    """The last evaluation of each robot's seeds."""
    lines = [
        "| robot | seeds | walk | evaluated | falls: mean, worst | tracking error | yaw error |"
    ]
    lines += ["|---|---|---|---|---|---|---|"]
    for name, label in paper.ROBOTS.items():
        found = runs(name)
        if not found:
            continue
        rows, least = [run["rows"][-1] for run in found], walks.level(45 if "go" in name else 30)
        walking = sum(walk(run["rows"], least) for run in found)
        falls, error, yaw = (
            [row[key] for row in rows] for key in ("fall_rate", "tracking_error", "yaw_error")
        )
        lines.append(
            f"| {label} | {len(rows)} | {walking} "
            f"| {mean([row['return'] for row in rows])} "
            f"| {100 * np.mean(falls):.1f} %, {100 * max(falls):.1f} % "
            f"| {np.mean(error):.2f} m/s, {max(error):.2f} | {np.mean(yaw):.2f} rad/s, {max(yaw):.2f} |"
        )
    return "\n".join(lines)


def at(run, key: str, seconds) -> np.ndarray:
    """A number of the evaluations between which `seconds` of training lie."""
    return np.interp(
        seconds, [row["seconds"] for row in run["rows"]], [row[key] for row in run["rows"]]
    )


def in_time() -> str:
    """The tail beside PPO alone after the same seconds of training."""
    lines = ["| evaluated; falls | seeds | " + " | ".join(f"{s} s" for s in SECONDS) + " |"]
    lines += ["|" + "---|" * (2 + len(SECONDS))]
    for name, (label, _) in METHODS.items():
        found = runs(name)
        if not found:
            continue
        cells = [
            f"{np.mean([at(run, 'return', s) for run in found]):.1f}; "
            f"{100 * np.mean([at(run, 'fall_rate', s) for run in found]):.1f} %"
            for s in SECONDS
        ]
        lines.append(f"| {label} | {len(found)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def cores() -> str:
    """An iteration by the number of cores, and what a run came to."""
    lines = [
        f"| cores | iteration | a row of physics | PPO | control steps/s | {LEVEL} of 45 after |"
    ]
    lines += ["|---|---|---|---|---|---|"]
    for path in sorted(
        (RESULTS / "cores").glob("bench*.json"), key=lambda path: int(path.stem[5:])
    ):
        count = path.stem[5:]
        (bench,) = json.loads(path.read_text())["configs"].values()
        walk = json.loads((RESULTS / "cores" / f"walk{count}.json").read_text())["rows"]
        found = next(i for i, row in enumerate(walk) if row["return"] >= LEVEL)
        near = walk[found - 1 : found + 1]  # between two evaluations
        seconds = np.interp(LEVEL, *([row[n] for row in near] for n in ("return", "seconds")))
        ms = bench["ms"]
        lines.append(
            f"| {count} | {ms['iteration']:.0f} ms | {ms['physics']:.1f} ms | {ms['ppo']:.0f} ms "
            f"| {bench['control_steps_per_second']:,.0f} | {seconds:.0f} s |"
        )
    return "\n".join(lines)


def draw(path: Path) -> None:
    """Evaluated return over seconds of training: every seed, and the mean of each method."""
    figure, ((axes,),) = pictures.figure(1, 1, 3.8)
    for name, (label, colour) in METHODS.items():
        found = runs(name)
        if not found:
            continue
        for run in found:
            rows = run["rows"]
            axes.plot(
                [row["seconds"] for row in rows],
                [row["return"] for row in rows],
                color=colour,
                lw=0.7,
                alpha=0.5,
                marker=".",
                markersize=4,
            )
        grid = np.linspace(
            max(run["rows"][0]["seconds"] for run in found),
            min(run["rows"][-1]["seconds"] for run in found),
        )
        level = np.mean([at(run, "return", grid) for run in found], 0)
        axes.plot(
            grid, level, color=colour, lw=2, label=f"{label.replace('`', '')}; {len(found)} seeds"
        )
    axes.set(
        xlabel="seconds of training on two idle cores: iterations x the time of one; points: evaluations",
        ylabel="evaluated return (of 45)",
        xlim=(0, 120),
        ylim=(0, 45),
    )
    axes.legend(frameon=False, loc="lower right")
    pictures.save(figure, path)


if __name__ == "__main__":
    main()

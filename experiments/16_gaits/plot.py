"""results.csv, figure and film strips (figure 9) of what run.py wrote into results/.

    python experiments/16_gaits/plot.py [--films]

--films renders each walk of seed 0 too, from policies/, into films/ (not committed; needs OpenGL). The strips
do without (drawing.py).
"""

import csv
import sys
from pathlib import Path

import drawing
import numpy as np

from experiments import paper, pictures, stats

VARIANTS, SPEEDS = ("ppo16", "dyna4"), (0.5, 1.0)
MEASURES = {
    "tracking_error": "tracking error (m/s)",
    "speed_ahead": "mean speed ahead (m/s)",
    "air_time": "air time of a swing (s)",
    "tilt": "tilt of the base (degrees, rms)",
}
COLUMNS = "variant speed iteration status tracking_error_mean air_time_mean tilt_mean falls".split()
SHOWN = (0, 2, 4, 6)  # frames of the poses, 60 ms apart
WINDOW = (-0.42, 0.82, -0.04, 0.53)  # m: of the strips, ahead of the first frame and up


def main():
    here = Path(__file__).parent
    make(here)
    strips(here)
    if "--films" in sys.argv:
        films(here)


def make(out: Path) -> None:
    episodes = load(out / "results" / "episodes.csv")
    rows = build(episodes)
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(episodes, out / "measures")


def key(variant: str, iteration: int, speed: float) -> str:
    return f"{variant}_{iteration}_{speed}"


def load(path: Path) -> list[dict]:
    """Rows of episodes.csv; [] if it is not there."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [dict(row) for row in csv.DictReader(file)]
    return [{n: v if n == "variant" else float(v or "nan") for n, v in row.items()} for row in rows]


def build(episodes) -> list[dict]:
    """A row a variant, speed and iteration: mean, deviation and interval over seeds."""
    rows = []
    for variant in VARIANTS:
        for speed in SPEEDS:
            some = [e for e in episodes if (e["variant"], e["speed"]) == (variant, speed)]
            row = {"variant": variant, "speed": speed, "status": "" if some else "not run"}
            rows += [] if some else [row]
            for iteration in sorted({e["iteration"] for e in some}):
                at = [e for e in some if e["iteration"] == iteration]
                cells = row | {"iteration": int(iteration), "seeds": len(at)}
                cells["falls"] = sum(np.isfinite(e["fall"]) for e in at)
                for name in (*MEASURES, "yaw_error", "swings_per_second", "distance"):
                    cells |= stats.spread(name, [e[name] for e in at])
                rows.append(cells)
    return rows


def draw(episodes, path: Path) -> None:
    """The measures over iterations: every seed, and their mean; solid 1.0 m/s, dashed 0.5."""
    page, axes = pictures.figure(2, 2, 5.8, sharex=True)
    for axis, (name, label) in zip(axes.flat, MEASURES.items(), strict=True):
        axis.set_title(label, loc="left")
        if not episodes:
            pictures.missing(axis)
            continue
        every = sorted({e["iteration"] for e in episodes})
        for v, variant in enumerate(VARIANTS):
            for k, (speed, line) in enumerate(zip(SPEEDS, ((0, (4, 1.5)), "-"), strict=True)):
                columns = [
                    [e[name] for e in episodes if (e["variant"], e["speed"], e["iteration"]) == at]
                    for at in ((variant, speed, iteration) for iteration in every)
                ]
                colour, mark = pictures.COLOURS[variant], "osPX"[2 * v + k]
                x = np.arange(len(every)) + 0.08 * (2 * v + k) - 0.12  # side by side
                style = dict(color=colour, marker=mark)
                for at, values in zip(x, columns, strict=True):
                    axis.plot([at] * len(values), values, ls="", alpha=0.4, ms=4, **style)
                mean = [stats.moments(values).mean for values in columns]
                text = f"{paper.VARIANTS[variant]}, {speed} m/s"
                style |= dict(linestyle=line, linewidth=1.6, markersize=6, label=text)
                axis.plot(x, mean, **style)
        axis.set_xticks(range(len(every)), [f"{i:.0f}" for i in every])
        axis.set_ylim(bottom=0)
    for axis in axes[-1]:
        axis.set_xlabel("iteration of the policy")
    if episodes:
        seeds = len({e["seed"] for e in episodes})
        pictures.head(page, f"Small: each of {seeds} seeds. Large, with lines: their mean")
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def strips(out: Path) -> None:
    """strips_SPEED.png: PPO-16 and the tail by turns, two rows a checkpoint, a camera that stands still."""
    import mujoco

    from dynappo.physics import robot as robot_lib

    with np.load(out / "results" / "poses.npz") as file:
        poses = {name: file[name] for name in file}
    model = mujoco.MjModel.from_xml_path(str(robot_lib.load("go1").xml))
    every = sorted({int(name.rsplit("_", 2)[1]) for name in poses})
    for speed in SPEEDS:
        rows = [(iteration, variant) for iteration in every for variant in VARIANTS]
        page, axes = pictures.figure(len(rows), len(SHOWN), 0.99 * len(rows) + 0.8)
        for row, (iteration, variant) in zip(axes, rows, strict=True):
            strip(row, model, poses[key(variant, iteration, speed)].astype(float))
            label = f"{iteration}\n" + {"ppo16": "PPO-16", "dyna4": "4-step\ntail"}[variant]
            row[0].set_ylabel(label, color=pictures.COLOURS[variant], fontweight="bold")
        for axis, frame in zip(axes[0], SHOWN, strict=True):
            axis.set_title(f"{60 * frame} ms", loc="left")
        text = f"Asked for {speed} m/s. The camera stands still, tiles are 10 cm; dotted: where the base"
        pictures.head(
            page, f"{text}\nwas at 0 ms; number: how far it has come since. Rows: iteration"
        )
        pictures.save(page, out / f"strips_{speed}.png", dpi=110)


def strip(axes, model, poses) -> None:
    """One walk: the frames `SHOWN`, in the world as it was at the first."""
    origin, (w, x, y, z) = poses[0, :2], poses[0, 3:7]
    heading = float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    for axis, frame in zip(axes, SHOWN, strict=True):
        left, right, bottom, top = WINDOW
        for tile in np.arange(-5, 9):
            colour = ("0.8", "0.93")[tile % 2]
            axis.fill_between([tile / 10, (tile + 1) / 10], bottom, 0, color=colour, linewidth=0)
        axis.axvline(0, color="0.4", linestyle=":", linewidth=1.2)
        drawing.draw(axis, model, poses[frame], origin, heading)
        gone = (poses[frame, :2] - origin) @ [np.cos(heading), np.sin(heading)]
        axis.text(left + 0.01, top - 0.01, f"{round(100 * gone)} cm", va="top")
        axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
        axis.grid(visible=False)


def films(out: Path, seconds: float = 6.0) -> None:
    """films/VARIANT_ITERATION_SPEED.mp4 of the policies of seed 0."""
    import gait

    from dynappo.physics import robot as robot_lib
    from dynappo.policy import policy_file, render

    (out / "films").mkdir(exist_ok=True)
    for path in sorted((out / "policies").glob("*_seed0.npz")):
        policy = policy_file.load(path)
        for speed in SPEEDS:
            film = out / "films" / f"{path.stem.removesuffix('_seed0')}_{speed}.mp4"
            episode, _ = gait.walk(policy, speed, seconds)
            print(render.film(robot_lib.load(policy.robot), episode, film) or film)


if __name__ == "__main__":
    main()

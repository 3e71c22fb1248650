"""results.csv, figure and film strips (figure 9) of the robots in results/.

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
COLUMNS = (
    "robot variant speed iteration status seeds walk falls tracking_error_mean air_time_mean tilt_mean"
).split()
SHOWN = (0, 2, 4, 6)  # frames of the poses, 60 ms apart
# iterations of the strips: the paper's; ANYmals walk by 200 with either method, so earlier ones
STRIPS = {"anymal_c": (150, 200, 300), "anymal_d": (150, 200, 300)}
PAPER_STRIPS = (300, 400, 500)
# m, ahead of the first frame and up; of a robot that stands 0.325 m high, a larger one has more
WINDOW, HEIGHT = np.array([-0.42, 0.82, -0.04, 0.53]), 0.325


def main():
    here = Path(__file__).parent
    make(here)
    strips(here)
    if "--films" in sys.argv:
        films(here)


def make(out: Path) -> None:
    every = {name: load(out / "results" / name / "episodes.csv") for name in paper.ROBOTS}
    rows = [row for robot, episodes in every.items() for row in build(robot, episodes)]
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw({robot: some for robot, some in every.items() if some} or {"go1": []}, out / "measures")


def key(variant: str, iteration: int, speed: float) -> str:
    return f"{variant}_{iteration}_{speed}"


def load(path: Path) -> list[dict]:
    """Rows of episodes.csv; [] if it is not there."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [dict(row) for row in csv.DictReader(file)]
    return [{n: v if n == "variant" else float(v or "nan") for n, v in row.items()} for row in rows]


def build(robot: str, episodes) -> list[dict]:
    """A row a variant, speed and iteration: mean, deviation and interval over seeds.

    Seeds that `walk` do not fall, and go ahead with at least half of the speed that they are asked for:
    that can be compared between robots, whose returns cannot.
    """
    rows = []
    for variant in VARIANTS:
        for speed in SPEEDS:
            some = [e for e in episodes if (e["variant"], e["speed"]) == (variant, speed)]
            row = {
                "robot": robot,
                "variant": variant,
                "speed": speed,
                "status": "" if some else "not run",
            }
            rows += [] if some else [row]
            for iteration in sorted({e["iteration"] for e in some}):
                at = [e for e in some if e["iteration"] == iteration]
                cells = row | {"iteration": int(iteration), "seeds": len(at)}
                cells["falls"] = sum(np.isfinite(e["fall"]) for e in at)
                half = 0.5 * speed
                cells["walk"] = sum(np.isnan(e["fall"]) and e["speed_ahead"] >= half for e in at)
                for name in (*MEASURES, "yaw_error", "swings_per_second", "distance"):
                    cells |= stats.spread(name, [e[name] for e in at])
                rows.append(cells)
    return rows


def draw(every, path: Path) -> None:
    """The measures over iterations, a column a robot; of one robot alone, in two rows of two."""
    many = len(every) > 1
    shape = (len(MEASURES), len(every), 8.6) if many else (2, 2, 5.8)
    page, axes = pictures.figure(*shape, sharex=True, sharey="row" if many else False)
    panels = [(name, robot) for name in MEASURES for robot in every]
    for axis, (name, robot) in zip(axes.flat, panels, strict=True):
        if not many:
            axis.set_title(MEASURES[name], loc="left")
        elif robot == panels[0][1]:
            axis.set_ylabel(MEASURES[name].replace(" (", "\n("))
        if every[robot]:
            panel(axis, every[robot], name, 4 if many else 6)
        else:
            pictures.missing(axis)
    for axis, robot in zip(axes[0], every if many else (), strict=False):
        axis.set_title(paper.ROBOTS[robot], loc="left")
    for axis in axes.flat:
        axis.set_ylim(bottom=0)
    for axis in axes[-1]:
        axis.set_xlabel("iteration of the policy")
    if seeds := sorted({len({e["seed"] for e in some}) for some in every.values() if some}):
        counted = " or ".join(map(str, seeds))
        pictures.head(page, f"Small: each of {counted} seeds. Large, with lines: their mean")
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def panel(axis, episodes, name: str, size: int) -> None:
    """A measure of one robot: every seed, and their mean; solid 1.0 m/s, dashed 0.5."""
    every = np.array(sorted({e["iteration"] for e in episodes}))
    apart = 0.08 * np.diff(every).min()  # side by side
    for v, variant in enumerate(VARIANTS):
        for k, (speed, line) in enumerate(zip(SPEEDS, ((0, (4, 1.5)), "-"), strict=True)):
            columns = [
                [e[name] for e in episodes if (e["variant"], e["speed"], e["iteration"]) == at]
                for at in ((variant, speed, iteration) for iteration in every)
            ]
            colour, mark = pictures.COLOURS[variant], "osPX"[2 * v + k]
            x = every + apart * (2 * v + k - 1.5)
            style = dict(color=colour, marker=mark)
            for at, values in zip(x, columns, strict=True):
                axis.plot([at] * len(values), values, ls="", alpha=0.4, ms=0.65 * size, **style)
            mean = [stats.moments(values).mean for values in columns]
            text = f"{paper.VARIANTS[variant]}, {speed} m/s"
            style |= dict(linestyle=line, linewidth=1.6, markersize=size, label=text)
            axis.plot(x, mean, **style)
    axis.set_xticks([i for i in every if i % 100 == 0] or every)


def strips(out: Path) -> None:
    """strips_ROBOT_SPEED.png of every robot that was run."""
    for robot in paper.ROBOTS:
        path = out / "results" / robot / "poses.npz"
        if path.exists():
            with np.load(path) as file:
                poses = {name: file[name] for name in file}
            for speed in SPEEDS:
                draw_strips(robot, poses, speed, out / f"strips_{robot}_{speed}")


def draw_strips(robot: str, poses, speed: float, path: Path) -> None:
    """PPO-16 and the tail by turns, two rows a checkpoint, a camera that stands still."""
    import mujoco

    from dynappo.physics import robot as robot_lib

    model = mujoco.MjModel.from_xml_path(str(robot_lib.load(robot).xml))
    window = WINDOW * max(1.0, model.keyframe("home").qpos[2] / HEIGHT)
    known = sorted({int(name.rsplit("_", 2)[1]) for name in poses})
    every = [i for i in STRIPS.get(robot, PAPER_STRIPS) if i in known] or known
    rows = [(iteration, variant) for iteration in every for variant in VARIANTS]
    page, axes = pictures.figure(len(rows), len(SHOWN), 0.99 * len(rows) + 0.8)
    for row, (iteration, variant) in zip(axes, rows, strict=True):
        strip(row, model, poses[key(variant, iteration, speed)].astype(float), window)
        label = f"{iteration}\n" + {"ppo16": "PPO-16", "dyna4": "4-step\ntail"}[variant]
        row[0].set_ylabel(label, color=pictures.COLOURS[variant], fontweight="bold")
    for axis, frame in zip(axes[0], SHOWN, strict=True):
        axis.set_title(f"{60 * frame} ms", loc="left")
    text = f"{paper.ROBOTS[robot]}, asked for {speed} m/s. The camera stands still, tiles are 10 cm; dotted: "
    text += "where the\nbase was at 0 ms; number: how far it has come since. Rows: iteration"
    pictures.head(page, text)
    pictures.save(page, path.with_name(path.name + ".png"), dpi=110)


def strip(axes, model, poses, window) -> None:
    """One walk: the frames `SHOWN`, in the world as it was at the first."""
    origin, (w, x, y, z) = poses[0, :2], poses[0, 3:7]
    heading = float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    for axis, frame in zip(axes, SHOWN, strict=True):
        left, right, bottom, top = window
        for tile in np.arange(np.floor(10 * left), np.ceil(10 * right)):
            colour = ("0.8", "0.93")[int(tile) % 2]
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

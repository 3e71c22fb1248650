"""results.csv, figure and film strips (figure 9) of what run.py wrote into results/.

    python experiments/16_gaits/plot.py [--films]

--films renders each walk of seed 0 too, from policies/, into films/ (not committed). Without OpenGL there
are no strips, and a line says so.
"""

import csv
import os
import subprocess
import sys
from pathlib import Path

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
SIZE = 165, 225  # pixels of a frame: height, width


def main():
    if sys.argv[1:2] == ["--strips"]:
        return strips(Path(sys.argv[2]))
    here = Path(__file__).parent
    make(here)
    make_strips(here)
    if "--films" in sys.argv:
        films(here)


def make(out: Path) -> None:
    episodes = load(out / "results" / "episodes.csv")
    rows = build(episodes)
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    draw(episodes, out / "measures")


def make_strips(out: Path) -> None:
    """The film strips, in a process of its own: MuJoCo chooses its OpenGL when it is imported, and a
    wrong one may end it."""
    command = [sys.executable, __file__, "--strips", str(out)]
    for backend in ("egl", "osmesa"):
        environment = os.environ | {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
        if subprocess.run(command, env=environment, stderr=subprocess.DEVNULL).returncode == 0:
            return
        print(f"no film strips with {backend}")


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
    page, axes = pictures.figure(1, len(MEASURES), (13, 3.4))
    for axis, (name, label) in zip(axes[0], MEASURES.items(), strict=True):
        axis.set_title(label, loc="left", fontsize=10)
        axis.set_xlabel("iteration of the policy")
        if not episodes:
            pictures.missing(axis)
            continue
        every = sorted({e["iteration"] for e in episodes})
        for v, variant in enumerate(VARIANTS):
            for speed, line in zip(SPEEDS, ("--", "-"), strict=True):
                columns = [
                    [e[name] for e in episodes if (e["variant"], e["speed"], e["iteration"]) == at]
                    for at in ((variant, speed, iteration) for iteration in every)
                ]
                x, colour = np.arange(len(every)) + 0.12 * v - 0.06, pictures.COLOURS[variant]
                for at, values in zip(x, columns, strict=True):
                    axis.plot(
                        [at] * len(values), values, ".", color=colour, alpha=0.35, markersize=5
                    )
                mean = [stats.spread("", values)["_mean"] for values in columns]
                text = f"{paper.VARIANTS[variant]}, {speed} m/s"
                axis.plot(x, mean, line, color=colour, linewidth=1.6, label=text)
        axis.set_xticks(range(len(every)), [f"{i:.0f}" for i in every])
        axis.set_ylim(bottom=0)
    pictures.legend(page, axes[0, 0], 4)
    pictures.save(page, path)


def strips(out: Path) -> None:
    """strips_SPEED.png: PPO-16 left, the tail right, a row a checkpoint, 60 ms from frame to frame."""
    with np.load(out / "results" / "poses.npz") as file:
        poses = {name: file[name] for name in file}
    every = sorted({int(name.rsplit("_", 2)[1]) for name in poses})
    for speed in SPEEDS:
        page, axes = pictures.figure(len(every), len(VARIANTS), (15, 0.88 * len(every) + 0.3))
        for row, iteration in zip(axes, every, strict=True):
            for axis, variant in zip(row, VARIANTS, strict=True):
                axis.imshow(np.hstack(list(frames(poses[key(variant, iteration, speed)]))))
                axis.set(xticks=[], yticks=[])
                axis.spines[:].set_visible(False)
                axis.grid(False)
                if iteration == every[0]:
                    text = f"{paper.VARIANTS[variant]}, asked for {speed} m/s, 60 ms apart"
                    axis.set_title(text, loc="left", fontsize=9)
            row[0].set_ylabel(f"iteration {iteration}", fontsize=8)
        path = out / f"strips_{speed}.png"
        page.savefig(path, dpi=130)
        pictures.palette(path)
        print(path)


def frames(poses: np.ndarray, name: str = "go1"):
    """RGB pictures of the robot from its side; the floor's squares show how far it gets."""
    import mujoco

    from dynappo.physics import robot as robot_lib

    model = mujoco.MjModel.from_xml_path(str(robot_lib.load(name).xml))
    data, view = mujoco.MjData(model), mujoco.MjvCamera()
    view.distance, view.elevation = 0.88, -8.0
    with mujoco.Renderer(model, *SIZE) as renderer:
        for qpos in poses.astype(float):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            w, x, y, z = qpos[3:7]
            view.azimuth = 90 + np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
            view.lookat[:] = [*qpos[:2], 0.19]
            renderer.update_scene(data, camera=view)
            yield renderer.render()


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

"""Draw curves.png from results/: return over simulator steps.

python experiments/01_four_robots/plot.py
"""

from pathlib import Path

import numpy as np
import walk

from experiments import paper, pictures

HERE = Path(__file__).parent
NAMES = {"go1": "Unitree Go1", "go2": "Unitree Go2", "anymal_c": "ANYmal-C", "anymal_d": "ANYmal-D"}
VARIANTS = "ppo16", "dyna4", "fast"
GOAL = {"go1": 36, "go2": 36, "anymal_c": 22, "anymal_d": 22}
# folder of results/, line style, what is said of it
SETS = (
    ("before", ":", "500 iterations, earlier commit"),
    ("long", "--", "1000 iterations"),
    ("", "-", "500 iterations"),
)


def find(folder, name, variant):
    """The CSV of a run; Go1's earlier ones are those of 00_first_light."""
    if (folder, name) == ("before", "go1"):
        return HERE.parent / "00_first_light" / "results" / f"{variant}.csv.xz"
    return HERE / "results" / folder / f"{name}_{variant}.csv.xz"


def curve(axis, path, **style):
    """Return over simulator steps of every 10th iteration, as a mean of three rows."""
    run = paper.read_one(path)
    tenth = run["iteration"] % 10 == 0
    run = {n: c[tenth] for n, c in run.items()}
    smooth = np.convolve(run["episode_return"], np.ones(3) / 3, "valid")
    axis.plot(run["sim_steps"][1:-1] / 1e6, smooth, **style)


def main():
    make(HERE)


def make(out: Path) -> None:
    figure, axes = pictures.figure(2, 2, 6.4)
    for axis, name in zip(axes.flat, walk.ROBOTS, strict=True):
        for folder, dash, _ in SETS:
            for variant in VARIANTS:
                path = find(folder, name, variant)
                if path.exists():
                    faint = dict(lw=1.0, alpha=0.6) if folder else dict(lw=1.8)
                    curve(axis, path, color=pictures.COLOURS[variant], ls=dash, **faint)
        axis.axhline(GOAL[name], color="0.55", lw=0.8, ls=(0, (6, 3)))
        axis.set(xlim=0, ylim=(-1, 40 if name.startswith("go") else 26), title=NAMES[name])
    for axis in axes[:, 0]:
        axis.set_ylabel("episode return")
    for axis in axes[-1]:
        axis.set_xlabel("simulator steps (M)")
    line = axes[0, 0].plot
    for variant in VARIANTS:
        line([], [], color=pictures.COLOURS[variant], label=variant)
    for _, dash, text in SETS[::-1]:
        line([], [], color="0.3", ls=dash, label=text)
    line([], [], color="0.55", lw=0.8, ls=(0, (6, 3)), label="36 of 45, 22 of 30")
    pictures.legend(figure, axes[0, 0], 4)
    pictures.save(figure, out / "curves")


if __name__ == "__main__":
    main()

"""Draw curves.png from results/: return over iterations and over simulator steps.

python experiments/01_four_robots/plot.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import walk

from experiments import paper, pictures

HERE = Path(__file__).parent
NAMES = {"go1": "Unitree Go1", "go2": "Unitree Go2", "anymal_c": "ANYmal-C", "anymal_d": "ANYmal-D"}
COLOURS = {"ppo16": "#1b5e9b", "dyna4": "#d1662a", "fast": "#3b8f5a"}
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


def curve(axis, path, x, **style):
    """Return over column `x` of every 10th iteration, as a mean of three rows."""
    run = paper.read_one(path)
    tenth = run["iteration"] % 10 == 0
    run = {n: c[tenth] for n, c in run.items()}
    smooth = np.convolve(run["episode_return"], np.ones(3) / 3, "valid")
    axis.plot(run[x][1:-1] / (1e6 if x == "sim_steps" else 1), smooth, **style)


def main():
    make(HERE)


def make(out: Path) -> None:
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(2, 4, figsize=(13, 6), layout="constrained", sharey="col")
    for column, name in zip(axes.T, walk.ROBOTS, strict=True):
        columns = ("iteration", "sim_steps"), ("iteration", "simulator steps (M)")
        for axis, x, label in zip(column, *columns, strict=True):
            for folder, line, _ in SETS:
                for variant, colour in COLOURS.items():
                    path = find(folder, name, variant)
                    if path.exists():
                        faint = dict(lw=1.0, alpha=0.6) if folder else dict(lw=1.8)
                        curve(axis, path, x, color=colour, ls=line, **faint)
            axis.axhline(GOAL[name], color="0.55", lw=0.8, ls=(0, (6, 3)))
            axis.set_xlabel(label)
            axis.grid(alpha=0.25)
            axis.set_xlim(left=0)
            axis.set_ylim(-1, 40 if name.startswith("go") else 26)
        column[0].set_title(NAMES[name])
    for row in axes:
        row[0].set_ylabel("episode return")
    lines = [plt.Line2D([], [], color=c, label=v) for v, c in COLOURS.items()]
    lines += [plt.Line2D([], [], color="0.3", ls=line, label=text) for _, line, text in SETS[::-1]]
    lines.append(
        plt.Line2D([], [], color="0.55", lw=0.8, ls=(0, (6, 3)), label="36 of 45, 22 of 30")
    )
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), frameon=False)
    pictures.save(figure, out / "curves")


if __name__ == "__main__":
    main()

"""Draw curves.png from the CSV files of results/.

python experiments/00_first_light/plot.py
"""

import json
from pathlib import Path

import numpy as np

from experiments import paper, pictures

HERE = Path(__file__).parent


def main():
    make(HERE)


def make(out: Path) -> None:
    names = ("ppo12", "ppo16", "dyna2", "dyna4_noschedule", "dyna4", "fast")
    runs = {n: paper.read_one(HERE / "results" / f"{n}.csv.xz") for n in names}
    figure, (axes,) = pictures.figure(1, 3, 3.4, sharey=True)
    labels = ("iteration", "simulator steps (M)", "training time (s)")
    for axis, column, label in zip(
        axes, ("iteration", "sim_steps", "seconds"), labels, strict=True
    ):
        for name, run in runs.items():
            x = run[column] / (1e6 if column == "sim_steps" else 1)
            smooth = np.convolve(run["episode_return"], np.ones(10) / 10, "valid")
            axis.plot(x[9:], smooth, label=name, lw=1.4, **pictures.line(name))
        axis.set_xlabel(label)
    axes[0].set_ylabel("episode return")
    pictures.legend(figure, axes[0], 6)
    device = json.loads((HERE / "results" / "ppo16.json").read_text())["device"]
    pictures.head(figure, f"Go1, 4096 robots, one seed, {device}")
    pictures.save(figure, out / "curves")


if __name__ == "__main__":
    main()

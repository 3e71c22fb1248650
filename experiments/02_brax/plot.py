"""Draw curves.png from the CSV files of results/: python experiments/02_brax/plot.py"""

from pathlib import Path

import matplotlib.pyplot as plt

from experiments import paper, pictures

HERE = Path(__file__).parent
TITLES = {"hopper": "hopper", "go1_joystick": "Go1"}
PANELS = {
    "episode_return": "episode return (last 100)",
    "reward": "reward of a step",
    "model_loss_before": "model loss on rows not yet seen",
}


def main():
    make(HERE)


def make(out: Path) -> None:
    figure, axes = plt.subplots(2, 3, figsize=(12, 6), constrained_layout=True)
    for row, (task, title) in zip(axes, TITLES.items(), strict=True):
        for method in ("ppo", "dyna"):
            run = paper.read_one(HERE / "results" / f"{task}_{method}.csv")
            for axis, name in zip(row, PANELS, strict=True):
                axis.plot(run["sim_steps"] / 1e6, run[name], label=method, lw=1.4)
        for axis, label in zip(row, PANELS.values(), strict=True):
            axis.set_title(f"{title}: {label}", fontsize=9)
            axis.grid(alpha=0.3)
            axis.set_xlabel("simulator steps (M)")
        row[0].legend(frameon=False)
    pictures.save(figure, out / "curves", dpi=110)


if __name__ == "__main__":
    main()

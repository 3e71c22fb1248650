"""Draw curves.png from the CSV files of results/: python experiments/02_brax/plot.py"""

from pathlib import Path

from experiments import paper, pictures

HERE = Path(__file__).parent
TITLES = {"hopper": "hopper", "go1_joystick": "Go1"}
LOOKS = {  # method -> colour, dashes
    "ppo": (pictures.PPO, "-"),
    "dyna": (pictures.GREEN, (0, (4, 1.2))),
}
PANELS = {
    "episode_return": "episode return (last 100)",
    "reward": "reward of a step",
    "model_loss_before": "model loss on rows not yet seen",
}


def main():
    make(HERE)


def make(out: Path) -> None:
    figure, axes = pictures.figure(2, 3, 4.6)
    for row, (task, title) in zip(axes, TITLES.items(), strict=True):
        for method, (colour, dash) in LOOKS.items():
            run = paper.read_one(HERE / "results" / f"{task}_{method}.csv")
            for axis, name in zip(row, PANELS, strict=True):
                line = {"label": method, "lw": 1.4, "color": colour, "ls": dash}
                axis.plot(run["sim_steps"] / 1e6, run[name], **line)
        for axis, label in zip(row, PANELS.values(), strict=True):
            axis.set_title(label, fontsize=9.5)
        row[0].set_ylabel(title)
    pictures.outer(axes, "simulator steps (M)")
    pictures.head(figure, "One seed a line")
    pictures.legend(figure, axes[0, 0], 2)
    pictures.save(figure, out / "curves")


if __name__ == "__main__":
    main()

"""A picture and a film of a trained policy on C MuJoCo: walking.png, walking.mp4.

python experiments/00_first_light/picture.py [VARIANT]
"""

import sys
from pathlib import Path

from dynappo import config as config_lib
from dynappo.physics import robot as robot_lib
from dynappo.policy import render

HERE = Path(__file__).parent
SECONDS, MOMENT = 8.0, 2.3  # s of film, and of the picture


def main():
    variant = sys.argv[1] if len(sys.argv) > 1 else "dyna4"
    config = config_lib.validate(config_lib.load(f"configs/go1.py:{variant}"))
    robot = robot_lib.load(config.robot)
    params = render.load_params(HERE / "results" / f"{variant}.npz")
    act = render.policy(params, config.ppo.activation)
    episode = render.simulate(robot, config, act, render.tour(SECONDS), SECONDS)
    until = round(MOMENT / float(episode["dt"]))
    still = {name: rows if name == "dt" else rows[:until] for name, rows in episode.items()}
    for name, content in (("walking.png", still), ("walking.mp4", episode)):
        print(HERE / name, render.film(robot, content, HERE / name))


if __name__ == "__main__":
    main()

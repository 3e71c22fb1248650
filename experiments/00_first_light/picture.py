"""A picture and a film of a trained policy on C MuJoCo: walking.png, walking.mp4.

python experiments/00_first_light/picture.py [POLICY.npz]
"""

import sys
from pathlib import Path

from dynappo import config as config_lib
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file, render
from experiments import pictures

HERE = Path(__file__).parent
SECONDS, MOMENT = 8.0, 2.3  # s of film, and of the picture


def main():
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "results" / "dyna4.npz"
    config = config_lib.validate(config_lib.load("configs/go1.py:dyna4"))
    robot = robot_lib.load(config.robot)
    act = policy_file.actor(policy_file.load_params(path), config.ppo.activation)
    episode = render.simulate(robot, config, act, render.tour(SECONDS), SECONDS)
    until = round(MOMENT / float(episode["dt"]))
    still = {name: rows if name == "dt" else rows[:until] for name, rows in episode.items()}
    for name, content in (("walking.png", still), ("walking.mp4", episode)):
        print(HERE / name, render.film(robot, content, HERE / name))
    pictures.palette(HERE / "walking.png")


if __name__ == "__main__":
    main()

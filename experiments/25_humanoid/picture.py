"""A biped that walks, from the side and from the front: walk.png.

    MUJOCO_GL=egl python experiments/25_humanoid/picture.py RUN.npz OUT.png [--command 1,0,0]

Ten frames 0.08 s apart, after three seconds in C MuJoCo: a stride at 1.4 strides a second.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from dynappo.policy import episode, policy_file, policy_source
from experiments import pictures

SIZE = 420, 240  # pixels, height and width of a frame
VIEWS = (90.0, 180.0)  # degrees from the heading: from the robot's right, from ahead
START, APART, FRAMES = 3.0, 0.08, 10


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("policy", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--command", default="1,0,0", help="m/s, m/s, rad/s")
    args = parser.parse_args()
    command = np.array([float(x) for x in args.command.split(",")])
    policy = policy_file.load(args.policy)
    body = policy_source.player(policy)[0]
    act = policy_file.actor(policy.params, policy.activation)
    poses = episode.play(body, act, lambda t: command, START + APART * FRAMES + 0.1)["qpos"]
    each = [round((START + APART * k) / episode.period(body)) for k in range(FRAMES)]
    look: dict[str, Any] = dict(distance=2.2, height=0.68, elevation=-6.0)
    rows = [
        np.concatenate([*pictures.poses(body.model, poses[each], SIZE, azimuth=view, **look)], 1)
        for view in VIEWS
    ]
    Image.fromarray(np.concatenate(rows)).quantize(128).save(args.out)


if __name__ == "__main__":
    main()

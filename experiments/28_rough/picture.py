r"""A robot that climbs stairs: stairs.png, stairs_g1.png.

    MUJOCO_GL=egl python experiments/28_rough/picture.py POLICY.npz OUT.png [--ground pit_stairs:0.45] \
        [--distance 1.9]

Four moments 0.5 s apart of a climb at 0.8 m/s, in C MuJoCo, seen from its right.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from dynappo.policy import episode, policy_file, policy_source

SIZE = 420, 480  # pixels, height and width of a moment
START, APART, MOMENTS, SPEED = 2.7, 0.5, 4, 0.8  # s, s, -, m/s
AZIMUTH, ELEVATION, BELOW = 68.0, -13.0, 0.12  # degrees, degrees, m under the base that it looks at


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("policy", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--ground", default="pit_stairs:0.45", help="of `dynappo play`")
    parser.add_argument("--distance", type=float, default=1.9, help="m, of the camera")
    args = parser.parse_args()
    policy = policy_file.load(args.policy)
    body = policy_source.player(policy, field=policy_source.ground(policy, args.ground))[0]
    act = policy_file.actor(policy.params, policy.activation)
    ahead, seconds = np.array([SPEED, 0, 0]), START + APART * MOMENTS
    poses = episode.play(body, act, lambda t: ahead, seconds)["qpos"]
    model, data = body.model, mujoco.MjData(body.model)
    model.vis.global_.offwidth, model.vis.global_.offheight = SIZE[1], SIZE[0]
    model.vis.quality.shadowsize, model.vis.map.shadowclip = 16384, 0.4
    view, pictures = mujoco.MjvCamera(), []
    view.azimuth, view.elevation, view.distance = AZIMUTH, ELEVATION, args.distance
    with mujoco.Renderer(model, *SIZE) as renderer:
        for k in range(MOMENTS):
            data.qpos[:] = poses[round((START + APART * k) / episode.period(body))]
            mujoco.mj_forward(model, data)
            view.lookat[:] = data.qpos[:3] - [0, 0, BELOW]
            renderer.update_scene(data, view)
            pictures.append(renderer.render())
    Image.fromarray(np.concatenate(pictures, 1)).quantize(160).save(args.out)


if __name__ == "__main__":
    main()

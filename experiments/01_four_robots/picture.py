"""One picture of the bundled robots walking: walking.png.

    MUJOCO_GL=egl python experiments/01_four_robots/picture.py [OUT.png] [--frames VX POLICY ...]

Each walks ahead at 0.8 m/s on C MuJoCo and is caught in mid-stride. With --frames, a row of frames of each
policy (a name or a file) at VX m/s, from the side, 60 ms apart, to look at its gait.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from dynappo.policy import episode, policy_file, policy_source
from experiments import paper, pictures

NAMES = {"go1": "Unitree Go1", "go2": "Unitree Go2", "anymal_c": "ANYmal-C", "anymal_d": "ANYmal-D"}
HUMANOID = "g1"
SIZE, TALL = (440, 720), (888, 500)  # pixels, height and width of one robot; of the humanoid
SPEED = 0.8  # m/s
# distance from the base (m), height looked at (m), time after which a stride is looked for (s)
FRAMING = {
    "go1": (0.97, 0.200, 3.0),
    "go2": (0.97, 0.185, 3.0),
    "anymal_c": (1.68, 0.355, 3.0),
    "anymal_d": (1.68, 0.335, 3.0),
    "g1": (1.95, 0.655, 3.0),
}


def walks(name, command, seconds=6.0):
    """`(qpos [T, nq], height of each foot [T, F])` of a walk, one row a control step."""
    policy = policy_source.load(name)[0]
    body = policy_source.player(policy)[0]
    act = policy_file.actor(policy.params, policy.activation)
    poses = episode.play(body, act, lambda t: command, seconds)["qpos"]
    data, heights = mujoco.MjData(body.model), np.empty((len(poses), len(body.foot_names)))
    for row, pose in zip(heights, poses, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(body.model, data)
        row[:] = episode.foot_heights(body, data)
    return poses, heights


def stride(feet, start):
    """The row after `start` where a diagonal pair, or one of two feet, is highest and the other is down."""
    one, other = (feet[:, [0, 3]], feet[:, [1, 2]]) if feet.shape[1] == 4 else np.split(feet, 2, 1)
    lifted = one.min(1) - 2 * np.maximum(other.max(1), 0)
    return start + int(lifted[start : start + 100].argmax())


def render(name, poses, size=SIZE, azimuth=128.0, elevation=-9.0):
    """RGB frames of the robot in `poses`, seen from its front left."""
    model = mujoco.MjModel.from_xml_path(str(Path("robots") / name / f"{name}.xml"))
    distance, height, _ = FRAMING[name]
    look: dict[str, Any] = dict(
        distance=distance, height=height, azimuth=azimuth, elevation=elevation
    )
    return pictures.poses(model, poses, size, **look)


def sheet(frames, labels, columns, out, dpi=100):
    """Write pictures in a grid, each with its label in the corner."""
    height, width = frames[0].shape[:2]
    rows = -(-len(frames) // columns)
    gap = 8
    size = (width * columns + gap * (columns - 1)) / dpi, (height * rows + gap * (rows - 1)) / dpi
    figure, axes = plt.subplots(rows, columns, figsize=size, dpi=dpi, squeeze=False)
    figure.subplots_adjust(0, 0, 1, 1, wspace=gap / width, hspace=gap / height)
    for axis in axes.flat:
        axis.axis("off")
    for axis, frame, label in zip(axes.flat, frames, labels, strict=False):
        axis.imshow(frame)
        style = dict(fontsize=width / 46, color="0.15", va="top", transform=axis.transAxes)
        axis.text(0.03, 0.945, label, **style)
    figure.savefig(out, dpi=dpi)
    pictures.palette(out)


def beside(left, frame, label, out, dpi=100):
    """Write the picture file `left` and, right of it, a tall one with its label."""
    grid, gap = plt.imread(left)[..., :3], 8
    rows, columns = max(grid.shape[0], frame.shape[0]), grid.shape[1] + gap + frame.shape[1]
    whole = np.ones((rows, columns, 3))
    whole[: grid.shape[0], : grid.shape[1]] = grid
    whole[: frame.shape[0], grid.shape[1] + gap :] = frame / 255
    figure = plt.figure(figsize=(columns / dpi, rows / dpi), dpi=dpi)
    axis = figure.add_axes((0, 0, 1, 1))
    axis.imshow(whole)
    axis.axis("off")
    style = dict(fontsize=SIZE[1] / 46, color="0.15", va="top")
    axis.text(grid.shape[1] + gap + 0.03 * SIZE[1], 0.055 * SIZE[0], label, **style)
    figure.savefig(out, dpi=dpi)
    pictures.palette(out)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parent / "walking.png")
    parser.add_argument("--frames", nargs="+", metavar="VX POLICY")
    args = parser.parse_args()
    if args.frames:
        speed, *names = args.frames
        if not names:
            parser.error("--frames: expected a speed and at least one policy, as 0.5 go1")
        frames, labels = [], []
        for name in names:
            poses, _ = walks(name, np.array([float(speed), 0.0, 0.0]))
            robot = policy_source.load(name)[0].robot
            frames += render(robot, poses[200:215:3], (230, 340), azimuth=90.0, elevation=-4.0)
            labels += [f"{Path(name).stem}, {60 * i} ms" for i in range(5)]
        sheet(frames, labels, 5, args.out)
        return
    frames = []
    for name in NAMES:
        poses, feet = walks(name, np.array([SPEED, 0.0, 0.0]))
        k = stride(feet, round(FRAMING[name][2] / 0.02))
        frames += render(name, [poses[k]])
    sheet(frames, list(NAMES.values()), 2, args.out)
    poses, feet = walks(HUMANOID, np.array([SPEED, 0.0, 0.0]))
    k = stride(feet, round(FRAMING[HUMANOID][2] / 0.02))
    (frame,) = render(HUMANOID, [poses[k]], TALL)
    beside(args.out, frame, "Unitree G1", args.out)


if __name__ == "__main__":
    main()

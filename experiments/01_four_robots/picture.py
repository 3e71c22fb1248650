"""One picture of the bundled robots walking: walking.png.

    MUJOCO_GL=egl python experiments/01_four_robots/picture.py [OUT.png] [--frames VX POLICY ...]

Each walks ahead at 0.8 m/s on C MuJoCo and is shown at four moments, a quarter of its stride apart, by a
camera that goes with it. With --frames, a row of frames of each policy (a name or a file) at VX m/s, from
the side, 60 ms apart, to look at its gait.
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
LABELS = NAMES | {HUMANOID: "Unitree G1"}
SIZE, TALL = (216, 296), (440, 222)  # pixels, height and width of a moment; of the humanoid
SPEED = 0.8  # m/s
PERIOD = 0.02  # s, a control step of every bundled robot
START = 150  # control steps, before which no stride is looked for
MOMENTS = 4  # of a stride
GAP = 4  # pixels between two moments; twice that between two robots
# distance from the base (m), height looked at (m)
FRAMING = {
    "go1": (0.93, 0.170),
    "go2": (0.93, 0.165),
    "anymal_c": (1.62, 0.315),
    "anymal_d": (1.62, 0.310),
    "g1": (2.15, 0.69),
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


def stride(feet):
    """The row where a diagonal pair, or one of two feet, is highest and the other is down."""
    one, other = (feet[:, [0, 3]], feet[:, [1, 2]]) if feet.shape[1] == 4 else np.split(feet, 2, 1)
    lifted = one.min(1) - 2 * np.maximum(other.max(1), 0)
    return START + int(lifted[START : START + 100].argmax())


def lasts(feet):
    """Control steps of a stride: the first shift from 0.2 s on by which the feet nearly repeat."""
    moved = feet[START:] - feet[START:].mean(0)
    shifts = range(round(0.2 / PERIOD), round(1.2 / PERIOD))
    alike = np.array([(moved[k:] * moved[:-k]).sum(1).mean() for k in shifts])
    return shifts[int(np.flatnonzero(alike > 0.97 * alike.max())[0])]


def render(name, poses, size, azimuth=128.0, elevation=-9.0):
    """RGB frames of the robot in `poses`, seen from its front left."""
    model = mujoco.MjModel.from_xml_path(str(Path("robots") / name / f"{name}.xml"))
    distance, height = FRAMING[name]
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


def moments(name, size):
    """Frames of a stride at `SPEED`, and how far apart they are, in seconds."""
    poses, feet = walks(name, np.array([SPEED, 0.0, 0.0]))
    first, steps = stride(feet), lasts(feet)
    rows = [first + round(steps * i / MOMENTS) for i in range(MOMENTS)]
    return list(render(name, poses[rows], size)), steps * PERIOD / MOMENTS


def tiled(grid, gap):
    """One picture of a `grid` [rows][columns] of them, with white gaps (down, across) between."""
    height, width = grid[0][0].shape[:2]
    down, across = height + gap[0], width + gap[1]
    whole = np.full((len(grid) * down - gap[0], len(grid[0]) * across - gap[1], 3), 255, np.uint8)
    for r, line in enumerate(grid):
        for c, frame in enumerate(line):
            whole[r * down : r * down + height, c * across : c * across + width] = frame
    return whole


def draw(out, dpi=100):
    """Quadrupeds left, a row each; the humanoid right of them, two moments a row."""
    found = {name: moments(name, SIZE) for name in NAMES}
    tall, apart = moments(HUMANOID, TALL)
    left = tiled([frames for frames, _ in found.values()], (2 * GAP, GAP))
    right = tiled([tall[:2], tall[2:]], (2 * GAP, GAP))
    whole = np.full((len(left), left.shape[1] + 3 * GAP + right.shape[1], 3), 255, np.uint8)
    whole[:, : left.shape[1]] = left
    whole[:, -right.shape[1] :] = right
    figure = plt.figure(figsize=(whole.shape[1] / dpi, whole.shape[0] / dpi), dpi=dpi)
    axis = figure.add_axes((0, 0, 1, 1))
    axis.imshow(whole)
    axis.axis("off")
    for r, (name, (_, seconds)) in enumerate(found.items()):
        bottom = (r + 1) * SIZE[0] + r * 2 * GAP
        text = f"{LABELS[name]}, {seconds:.2f} s apart"
        axis.text(10, bottom - 9, text, fontsize=15, color="0.1", va="bottom")
    text = f"{LABELS[HUMANOID]},\n{apart:.2f} s apart"
    axis.text(left.shape[1] + 3 * GAP + 10, 9, text, fontsize=15, color="0.1", va="top")
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
    draw(args.out)


if __name__ == "__main__":
    main()

"""The observation: the 48 numbers that a policy of the velocity task sees.

The code works with NumPy and jax.numpy, so that a policy can be played without JAX. It uses only
qpos and qvel, because after `mjx.step` every derived quantity is one substep old.

| part       | rows  | content                                             | unit  |
|------------|-------|-----------------------------------------------------|-------|
| prop (33)  | 0-11  | joint positions minus the default pose              | rad   |
|            | 12-23 | joint velocities                                    | rad/s |
|            | 24-26 | direction of gravity in the base frame              |       |
|            | 27-29 | velocity of the base's centre of mass, base frame   | m/s   |
|            | 30-32 | angular velocity, base frame                        | rad/s |
| ctx (15)   | 33-35 | command vx, vy, yaw rate                            | m/s, rad/s |
|            | 36-47 | previous action                                     |       |

The order is the paper's, o = [q, qd, g, v, w] and [c, a]: the transition model predicts prop and
copies ctx. `PREDICTED` and `COPIED` define the parts; noise, mirror image, the tables of ONNX files
and what a reward term can ask for follow from them. To add a part, add an entry there and a value
in `observe`, and for `COPIED` also one in `context` (docs/task.md).
"""

from collections.abc import Callable
from itertools import accumulate
from typing import NamedTuple

import numpy as np

# by `task.observation`; of policy files: a policy that sees other numbers is refused by this name, so
# change it with them
NAMES = {"full": "velocity-48", "onboard": "onboard-45"}


class Part(NamedTuple):
    """Numbers of an observation that belong together."""

    size: int
    unit: str
    content: str
    noise: str = ""  # the field of task.noise with its half width; "": none
    # of each number in the left-right mirror image; None: one number per joint, mirrored as joints
    signs: tuple[int, ...] | None = None


MOVES, TURNS = (
    (1, -1, 1),
    (-1, 1, -1),
)  # signs of vectors; rotations are mirrored with the opposite sign
# the state at the end of a row: the transition model predicts it
PREDICTED = dict(
    joint_position=Part(12, "rad", "minus default_pose", "joint_pos"),
    joint_velocity=Part(12, "rad/s", "of each joint", "joint_vel"),
    gravity=Part(3, "1", "its direction, base frame (0 0 -1 upright)", "gravity", MOVES),
    linear_velocity=Part(
        3, "m/s", "of the base's centre of mass (base_com), base frame", "linear_velocity", MOVES
    ),
    angular_velocity=Part(3, "rad/s", "base frame", "angular_velocity", TURNS),
)
# what follows from the row before (`context`): the model copies it
COPIED = dict(
    command=Part(3, "m/s, m/s, rad/s", "vx, vy, yaw rate, base frame", signs=(1, -1, -1)),
    previous_action=Part(12, "1", "action of the step before; zero at first"),
)
PARTS = PREDICTED | COPIED
PROP_SIZE, CONTEXT_SIZE = (sum(p.size for p in group.values()) for group in (PREDICTED, COPIED))
ROWS = {
    name: slice(stop - part.size, stop)
    for (name, part), stop in zip(
        PARTS.items(), accumulate(part.size for part in PARTS.values()), strict=True
    )
}
SENSED = PROP_SIZE + CONTEXT_SIZE
UNSEEN = {NAMES["full"]: (), NAMES["onboard"]: ("linear_velocity",)}  # parts that no sensor tells
GRAVITY, LINEAR_VELOCITY = ROWS["gravity"], ROWS["linear_velocity"]
ANGULAR_VELOCITY, COMMAND = ROWS["angular_velocity"], ROWS["command"]
JOINT_POS, JOINT_VEL = ROWS["joint_position"], ROWS["joint_velocity"]
LAST_ACTION = ROWS["previous_action"]


def shown(name: str) -> tuple[str, ...]:
    """The parts that a policy of observation `name` sees."""
    return tuple(part for part in PARTS if part not in UNSEEN[name])


def columns(name: str) -> np.ndarray:
    """Of the 48 numbers those that a policy of observation `name` sees."""
    return np.concatenate([np.arange(SENSED)[ROWS[part]] for part in shown(name)])


def reading(name: str) -> dict[str, slice]:
    """Where each part is in what a policy of observation `name` sees of one step."""
    sizes = [PARTS[part].size for part in shown(name)]
    stops = accumulate(sizes)
    return {
        part: slice(stop - size, stop)
        for part, size, stop in zip(shown(name), sizes, stops, strict=True)
    }


def memory(name: str, history: int) -> Callable[[np.ndarray], np.ndarray]:
    """`see(48 numbers) -> what the policy sees`, step after step of one episode: its readings, newest first.

    Before the first there was nothing else: it stands for all before it.
    """
    seen, kept = columns(name), []

    def see(obs):
        now = obs[seen]
        kept.insert(0, now)
        kept[history:] = []
        kept.extend([now] * (history - len(kept)))
        return np.concatenate(kept)

    return see


def rotate_inverse(quat, vector):
    """World `vector` [3] in the frame of the unit quaternion `quat` (w, x, y, z)."""
    xp = vector.__array_namespace__()
    w, u = quat[0], quat[1:]
    # v' = v + 2 u x (u x v) - 2 w (u x v)
    uv = xp.stack(_cross(u, vector))
    return vector + 2 * xp.stack(_cross(u, uv)) - 2 * w * uv


def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def heading(quat):
    """Direction of the base's x axis in the world's plane, rad from the world's x axis."""
    xp = quat.__array_namespace__()
    w, x, y, z = (quat[i] for i in range(4))
    return xp.atan2(2 * (x * y + w * z), 1 - 2 * (y**2 + z**2))


def base_motion(qpos, qvel, base_com):
    """`(gravity, linear, angular)`, each [3], in the base frame.

    `gravity` is the unit direction; `linear` (m/s) is the velocity of the base's centre of mass,
    `base_com` (m) in the base frame. A MuJoCo free joint has world linear velocity of the frame's
    origin in qvel[0:3] and local angular velocity in qvel[3:6].
    """
    xp = qpos.__array_namespace__()
    quat, angular = qpos[3:7], qvel[3:6]
    # the third row of the rotation matrix, negated: where "down" points in the base frame
    w, x, y, z = (quat[i] for i in range(4))
    gravity = -xp.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)))
    linear = rotate_inverse(quat, qvel[0:3]) + xp.stack(_cross(angular, base_com))
    return gravity, linear, angular


def observe(qpos, qvel, base_com, default_pose, command, last_action):
    """The observation [48] of one robot, without noise; see the module's table."""
    xp = qpos.__array_namespace__()
    gravity, linear, angular = base_motion(qpos, qvel, base_com)
    values = dict(
        joint_position=qpos[7:] - default_pose,
        joint_velocity=qvel[6:],
        gravity=gravity,
        linear_velocity=linear,
        angular_velocity=angular,
        command=command,
        previous_action=last_action,
    )
    return xp.concat([values[name] for name in PARTS])


def context(obs, action):
    """The copied part [15] of the observation that follows `obs` [..., 48] and `action`."""
    xp = obs.__array_namespace__()
    values = dict(
        command=obs[..., COMMAND],
        previous_action=action,
    )
    return xp.concat([values[name] for name in COPIED], axis=-1)


def split(obs):
    """The parts of observations [..., 48], by name."""
    return {name: obs[..., rows] for name, rows in ROWS.items()}


def noise_scale(noise, xp):
    """Half widths [48] of the uniform observation noise; `noise` is the config's group."""
    scales = [
        getattr(noise, p.noise) if p.noise else 0.0 for p in PARTS.values() for _ in range(p.size)
    ]
    return xp.stack([xp.asarray(v) for v in scales])

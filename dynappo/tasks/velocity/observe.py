"""The observation: what a policy of the velocity task sees, 48 numbers on a robot of 12 joints.

The code works with NumPy and jax.numpy, so that a policy can be played without JAX. It uses only
qpos and qvel, because after `mjx.step` every derived quantity is one substep old.

| part             | rows, of 12 joints | content                                     | unit       |
|------------------|-------|----------------------------------------------------------|------------|
| predicted (prop) | 0-11  | joint positions minus the default pose                   | rad        |
|                  | 12-23 | joint velocities                                         | rad/s      |
|                  | 24-26 | direction of gravity in the base frame                   |            |
|                  | 27-29 | velocity of the base's centre of mass, base frame        | m/s        |
|                  | 30-32 | angular velocity, base frame                             | rad/s      |
| known (context)  | 33-35 | command vx, vy, yaw rate                                 | m/s, rad/s |
|                  | 36-47 | previous action                                          |            |

The order is the paper's, o = [q, qd, g, v, w] and [c, a]: the transition model predicts the first,
and `advance` computes the second. `PREDICTED` and `KNOWN` define the parts; from them follow sizes, noise,
mirror image, the tables of ONNX files and what a reward term can ask for. To add a part, add an entry there
and a value in `observe`, and for `KNOWN` also one in `advance` (docs/task.md).
"""

import re
from collections.abc import Callable
from functools import cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np

# by `task.observation`, with the count of numbers behind it the name in policy files ("velocity-48"): a
# policy that sees other numbers is refused by its name, so change it with them
NAMES = {"full": "velocity", "onboard": "onboard"}
UNSEEN = {"full": (), "onboard": ("linear_velocity",)}  # parts that no sensor tells


class Part(NamedTuple):
    """One part of an observation: numbers that belong together."""

    size: int | None  # None: one number a joint
    unit: str
    content: str
    noise: str = ""  # the field of task.noise with its half width; "": none
    # of each number in the left-right mirror image; None: mirrored as the joints
    signs: tuple[int, ...] | None = None
    scale: float = 1.0  # of what networks learn from, with `ppo.scale_inputs`; as in legged_gym


# signs of vectors in the mirror image; rotations have the opposite sign
MOVES, TURNS = (1, -1, 1), (-1, 1, -1)
# the state at the end of a row: the transition model predicts it
PREDICTED = dict(
    joint_position=Part(None, "rad", "minus default_pose", "joint_pos"),
    joint_velocity=Part(None, "rad/s", "of each joint", "joint_vel", scale=0.05),
    gravity=Part(3, "1", "its direction, base frame (0 0 -1 upright)", "gravity", MOVES),
    linear_velocity=Part(
        3, "m/s", "of the base's centre of mass (base_com), base frame", "linear_velocity", MOVES
    ),
    angular_velocity=Part(3, "rad/s", "base frame", "angular_velocity", TURNS, 0.25),
)
# what follows from the row before: `advance` computes it
KNOWN = dict(
    command=Part(3, "m/s, m/s, rad/s", "vx, vy, yaw rate, base frame", signs=(1, -1, -1)),
    previous_action=Part(None, "1", "action of the step before; zero at first"),
)
PARTS = PREDICTED | KNOWN


def _places(names, joints: int) -> dict[str, slice]:
    sizes = [joints if (size := PARTS[name].size) is None else size for name in names]
    ends = zip(names, sizes, accumulate(sizes), strict=True)
    return {name: slice(stop - size, stop) for name, size, stop in ends}


@cache
def rows(joints: int) -> dict[str, slice]:
    """Where each part is in the observation of a robot of so many joints."""
    return _places([*PARTS], joints)


def size(joints: int) -> int:
    """Numbers of an observation."""
    return [*rows(joints).values()][-1].stop


def prop_size(joints: int) -> int:
    """Numbers of its predicted parts, which come first."""
    return rows(joints)[[*PREDICTED][-1]].stop


def name(observation: str, joints: int) -> str:
    """The name, in policy files, of one step's reading with `task.observation`."""
    count = sum(rows(joints)[part].stop - rows(joints)[part].start for part in _seen(observation))
    return f"{NAMES[observation]}-{count}"


def _seen(observation: str) -> list[str]:
    return [part for part in PARTS if part not in UNSEEN[observation]]


@cache
def _named(name: str) -> tuple[str, int]:
    """`(task.observation, joints)` of a name; ValueError if it is none."""
    for observation, text in NAMES.items():
        found = re.fullmatch(rf"{re.escape(text)}-(\d{{1,4}})", name)
        sizes = [PARTS[part].size for part in _seen(observation)]
        joints, rest = divmod(
            int(found[1]) - sum(filter(None, sizes)) if found else -1, sizes.count(None)
        )
        if found and joints > 0 and not rest:
            return observation, joints
    raise ValueError(f"no observation has the name {name!r}")


def shown(name: str) -> tuple[str, ...]:
    """The parts that a policy of observation `name` sees."""
    return tuple(_seen(_named(name)[0]))


def columns(name: str) -> np.ndarray:
    """The columns of an observation that a policy of observation `name` sees."""
    places = rows(_named(name)[1])
    return np.concatenate(
        [np.arange(places[part].start, places[part].stop) for part in shown(name)]
    )


def reading(name: str) -> dict[str, slice]:
    """Where each part is in one step's reading of a policy of observation `name`."""
    return _places(shown(name), _named(name)[1])


def memory(name: str, history: int) -> Callable[[np.ndarray], np.ndarray]:
    """`see(observation) -> what the policy sees`, step after step of one episode: its readings, newest first.

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
    w, u = quat[0], quat[1:]
    # v' = v + 2 u x (u x v) - 2 w (u x v)
    uv = cross(u, vector)
    return vector + 2 * cross(u, uv) - 2 * w * uv


def cross(a, b):
    """The cross product of vectors [..., 3]."""
    (ax, ay, az), (bx, by, bz) = ([v[..., i] for i in range(3)] for v in (a, b))
    products = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return a.__array_namespace__().stack(products, axis=-1)


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
    linear = rotate_inverse(quat, qvel[0:3]) + cross(angular, base_com)
    return gravity, linear, angular


def observe(qpos, qvel, base_com, default_pose, command, last_action):
    """The observation [O] of one robot, without noise; see the module's table."""
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


def advance(context, action):
    """The known parts [..., C] of the observation after `action`, from those before."""
    xp = context.__array_namespace__()
    before = split_context(context, action.shape[-1])
    values = dict(
        command=before["command"],
        previous_action=action,
    )
    return xp.concat([values[name] for name in KNOWN], axis=-1)


def split(obs, joints: int):
    """The parts of observations [..., O] of a robot of so many joints, by name."""
    return {name: obs[..., where] for name, where in rows(joints).items()}


def split_context(context, joints: int):
    """As `split`, of the known parts [..., C] alone."""
    return {name: context[..., where] for name, where in _places([*KNOWN], joints).items()}


def noise_scale(noise, xp, joints: int):
    """Half widths [O] of the uniform observation noise; `noise` is the config's group."""
    scales = [
        getattr(noise, PARTS[name].noise) if PARTS[name].noise else 0.0
        for name, where in rows(joints).items()
        for _ in range(where.start, where.stop)
    ]
    return xp.stack([xp.asarray(v) for v in scales])

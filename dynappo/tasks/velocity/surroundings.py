"""Where a robot is on a ground that is not flat, and that ground: the last part of an observation.

    [ pose | rate | goal | shift | feet | scan ]          terrain/scan.py defines the quantities

All of it is known in a tail (`advance`): the pose moves with the velocities that the model predicts, and the
ground is looked up there. So a height scan is never predicted.

| part  | numbers | content                                                           | seen by       |
|-------|---------|-------------------------------------------------------------------|---------------|
| pose  | 4       | x, y, z of the base's origin in the world (m), yaw (rad)          | none          |
| rate  | 4       | its change (m/s, rad/s)                                           | none          |
| goal  | 2       | heading (rad, world), 1 where told to stand; with `task.heading`  | none          |
| shift | 3       | m, by how much the robot's map is off; with a scan                | none          |
| feet  | 5 F     | m, of each foot above the ground under it and around it           | value, model  |
| scan  | 187     | m, base above the ground - 0.5, with noise; with `task.scan=grid` | policy, value |

The yaw rate of a heading command follows from the pose, so a tail computes it too, and that a part which ends
an episode is in the ground (`touches`): the model need not foresee it. `task.ground_in_tail` has three
controls, each without one thing: with "no_end" a tail does not know that it ends there, "frozen" keeps feet
and scan as they were in the tail's first row, and with "blind" the model does not see the feet's part.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.description import kinematics
from dynappo.description.robot import Robot
from dynappo.tasks.velocity import observe
from dynappo.terrain import height_map, scan
from dynappo.terrain.height_map import HeightMap
from dynappo.types import Hyper

APART = 0.02  # m: a foot whose image is no nearer to a foot has no partner


class Surroundings(NamedTuple):
    """What the functions here need; constants of the program."""

    ground: HeightMap
    scan: bool  # whether there is one
    heading: bool  # whether commands turn to a heading
    tail: str  # as in `task.ground_in_tail`
    feet: kinematics.Legs  # [F] middles
    partner: np.ndarray  # [F] the foot that is each one's mirror image
    base_com: np.ndarray  # [3] m, base frame, of the nominal body
    default_pose: np.ndarray  # [A] rad
    dt: float  # s, a control step
    substeps: int
    parts: kinematics.Legs | None  # probes of those that end an episode; None: not known in a tail


def make(
    robot: Robot, task: Any, physics: Any, ground: HeightMap, fatal: np.ndarray | None = None
) -> Surroundings:
    """Of the config's groups `task` and `physics`, on `ground`; `fatal` [G] are the parts that end an
    episode there, if that is to be known."""
    middles = kinematics.middles(robot.mj_model, robot.feet, robot.foot_of)
    return Surroundings(
        ground=ground,
        scan=task.scan == "grid",
        heading=task.heading,
        tail=task.ground_in_tail,
        feet=middles,
        partner=_partners(kinematics.feet_in_base(middles, robot.default_pose)),
        base_com=robot.mj_model.body_ipos[robot.base_body],
        default_pose=robot.default_pose,
        dt=physics.substeps * physics.timestep,
        substeps=physics.substeps,
        parts=(
            kinematics.probed(robot.mj_model, robot.parts[fatal])
            if task.ground_in_tail != "no_end" and fatal is not None and fatal.any()
            else None
        ),
    )


def _partners(feet: np.ndarray) -> np.ndarray:
    """The foot nearest to each one's image, its own number if that is no foot's place."""
    away = np.linalg.norm((feet * [1, -1, 1])[:, None] - feet, axis=-1)
    return np.where(away.min(-1) < APART, away.argmin(-1), np.arange(len(feet)))


def places(s: Surroundings) -> dict[str, slice]:
    """Where each part is."""
    out, start = {}, 0
    for name, count in scan.sizes(len(s.partner), s.scan, s.heading).items():
        out[name] = slice(start, start + count)
        start += count
    return out


def size(s: Surroundings | None) -> int:
    """Numbers of all parts; 0 on flat ground."""
    return 0 if s is None else sum(scan.sizes(len(s.partner), s.scan, s.heading).values())


def columns(s: Surroundings | None, network: str) -> np.ndarray:
    """The columns of these that "actor", "critic" or "model" sees."""
    if s is None:
        return np.zeros(0, int)
    seen = {"actor": ["scan"], "critic": ["feet", "scan"], "model": ["feet"]}[network]
    if network == "model" and s.tail == "blind":
        seen = []
    every, where = np.arange(size(s)), places(s)
    return np.concatenate([every[:0], *(every[where[name]] for name in seen)])


def mirror(s: Surroundings) -> tuple[np.ndarray, np.ndarray]:
    """`(index, sign)` of their mirror image; those that no network sees stay as they are."""
    index, where = np.arange(size(s)), places(s)
    around = np.array([0, 1, 2, 4, 3])  # left and right of a foot
    feet = (s.partner[:, None] * len(around) + around).ravel()
    index[where["feet"]] = where["feet"].start + feet
    if s.scan:
        index[where["scan"]] = where["scan"].start + scan.mirror()
    return index, np.ones(size(s))


def height(s: Surroundings):
    """The height of the ground at world x and y (m), as a function."""
    return lambda x, y: height_map.height(*s.ground, x, y)


def exact(s: Surroundings, qpos, qvel, goal, shift):
    """The numbers of a state, without noise. `goal` is a state's; `shift` [3] m is None without a scan."""
    gravity, _, angular = observe.base_motion(qpos, qvel, jnp.zeros(3))
    pose = jnp.concatenate([qpos[:3], observe.heading(qpos[3:7])[None]])
    rate = jnp.concatenate([qvel[:3], scan.yaw_rate(gravity, angular)[None]])
    parts = [pose, rate]
    if s.heading:
        parts.append(jnp.stack([goal.heading, goal.standing]))
    return jnp.concatenate([*parts, *_looked_up(s, pose, gravity, qpos[7:], shift)])


def _looked_up(s: Surroundings, pose, gravity, joints, shift) -> list[Any]:
    """The shift, and the ground at `pose`: at the feet, and the scan."""
    feet = kinematics.feet_in_base(s.feet, joints)
    at_feet = scan.at_feet(height(s), pose, gravity, feet)
    return [shift, at_feet, scan.scan(height(s), pose, shift)] if s.scan else [at_feet]


def foot_heights(s: Surroundings, numbers):
    """[F] m, of the middle of each foot above the ground under it, of the numbers of a state."""
    return numbers[places(s)["feet"]].reshape(len(s.partner), -1)[:, 0]


def touches(s: Surroundings, numbers, prop):
    """Whether a part that ends an episode is in the ground, of the numbers of a state and its predicted
    ones."""
    assert s.parts is not None
    seen = observe.split_prop(prop, len(s.default_pose))
    joints = seen["joint_position"] + jnp.asarray(s.default_pose, jnp.float32)
    points = kinematics.feet_in_base(s.parts, joints)
    there = scan.in_world(numbers[places(s)["pose"]], seen["gravity"], points)
    if s.parts.rim.any():  # the lowest points of cylinders' rims, as contacts.probe_points
        axis = there - there[s.parts.other]
        axis /= jnp.maximum(jnp.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)
        up = jnp.array([0.0, 0.0, 1.0]) - axis[:, 2:] * axis
        size = jnp.sqrt(jnp.maximum((up**2).sum(-1, keepdims=True), 1e-12))
        there -= jnp.float32(s.parts.rim)[:, None] * up / size
    return (height_map.gap(*s.ground, there, jnp.float32(s.parts.radius)) < 0).any()


def draw_shift(hyper: Hyper, draws):
    """A shift [3] m of the map, of `draws` [3] from 0 to 1."""
    half = jnp.stack([hyper.task.noise.scan_shift] * 2 + [hyper.task.noise.scan_lift])
    return (2 * draws - 1) * half


def sense(s: Surroundings, hyper: Hyper, numbers, key):
    """The numbers as they are sensed: the scan with noise, and with points that are missing, which read 0."""
    if not s.scan:
        return numbers
    where, noise = places(s)["scan"], hyper.task.noise
    exact = numbers[where]
    # 16 bits for each are enough; a row of 2048 robots takes 3 us less (H200, 28_rough/kernels.py)
    bits = jax.random.bits(key, exact.shape, jnp.uint32)
    unit, coin = ((half + 0.5) / 2**16 for half in (bits >> 16, bits & 0xFFFF))
    sensed = exact + (2 * unit - 1) * noise.scan
    sensed = jnp.where(coin < noise.scan_dropout, 0.0, sensed)
    return jnp.concatenate([numbers[: where.start], sensed])


def advance(s: Surroundings, before, next_prop):
    """The numbers, exact, a control step after `before`, where the robot is as `next_prop` says."""
    where = places(s)
    parts = observe.split_prop(next_prop, len(s.default_pose))
    gravity, angular = parts["gravity"], parts["angular_velocity"]
    com = jnp.asarray(s.base_com, jnp.float32)
    linear = parts["linear_velocity"] - observe.cross(angular, com)  # of the base's origin
    pose, rate = scan.moved(
        before[where["pose"]], before[where["rate"]], gravity, linear, angular, s.dt, s.substeps
    )
    if s.tail == "frozen":
        return jnp.concatenate([pose, rate, before[where["rate"].stop :]])
    joints = parts["joint_position"] + jnp.asarray(s.default_pose, jnp.float32)
    shift = before[where["shift"]]
    ground = _looked_up(s, pose, gravity, joints, shift)
    return jnp.concatenate([pose, rate, before[where["goal"]], *ground])

"""A task's mirror image, left for right, found by trying: `find(task, layout, probed)`.

Where each joint has a partner (tasks/velocity/partners.py), random states are reflected, and so are the
task's own numbers, by the table of `_image`. Of both the task's step is asked, without physics and noise.
Each number that a network sees must then be one of the unreflected ones, up to its sign, and the reward and
each of its terms must be the same. What fails is named in a line, and the task has no mirror image: a term
that knows left from right, a robot of two unlike sides, a history that the table does not know.
"""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import jax
import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.tasks.playground import parts
from dynappo.tasks.playground.parts import Layout, Probed
from dynappo.tasks.velocity import partners
from dynappo.types import Mirror

# positions and quaternion, linear and angular velocity of the base
QPOS, QVEL = np.array([1, -1, 1, 1, -1, 1, -1.0]), np.array([1, -1, 1, -1, 1, -1.0])
MOVES, TURNS, COMMAND = (np.array(x, float) for x in ([1, -1, 1], [-1, 1, -1], [1, -1, -1]))
VECTORS = {"command": COMMAND, "ang_vel": TURNS, "filtered_angvel": TURNS}  # of three; others move
CLOSE, MOST = 0.1, 0.95  # share of a number's spread, and of the states, that must agree


def find(task: Any, layout: Layout, probed: Probed) -> tuple[Mirror, Mirror] | str:
    """The mirror of `obs` and of an action, or why there is none."""
    try:
        joints = _joints(task)
    except ConfigError as error:
        return str(error)
    actions = _actions(task.mj_model, joints)
    draw, model = np.random.default_rng(1), _flat(task.mj_model)
    (before, before_image), (after, after_image) = (
        _states(model, layout.home, joints, actions, draw) for _ in range(2)
    )
    unlike = _unlike(after, after_image, joints)
    if unlike > CLOSE:
        return f"the robot's two sides differ: accelerations by {unlike:.0%}"
    raw = probed.raw
    action = draw.uniform(-1, 1, (parts.PROBES, task.action_size)).astype(np.float32)
    nothing = jax.tree.map(
        np.zeros_like, raw.obs
    )  # a history in it is not reflected, so none is there
    one = raw._replace(obs=nothing)
    feet = _feet(task, layout)
    info = {name: _image(name, x, joints, actions, feet) for name, x in one.info.items()}
    other = one._replace(info=info, ctrl=_turned(actions, one.ctrl))
    _, (x, *_), reward, terms, ended = _asked(probed, one, action, before, after)
    _, (y, *_), reward_image, terms_image, ended_image = _asked(
        probed, other, _turned(actions, action), before_image, after_image
    )
    going = ~(ended | ended_image)
    if going.sum() < 50:
        return "most random states end the episode"
    last = x.shape[1] - raw.unseen.shape[1]
    ctrl = slice(last - raw.ctrl.shape[1], last)
    if not _same(_turned(actions, x[going, ctrl]), y[going, ctrl]).all():
        return "mirrored actions are not mirrored controls"
    for name in terms:
        if not _same(terms[name][going], terms_image[name][going]).all():
            return f"{name} tells left from right"
    if not _same(reward[going], reward_image[going]).all():
        return "the reward tells left from right"
    found = _matched(layout, x[going][:, layout.source], y[going][:, layout.source])
    return found if isinstance(found, str) else (found, actions)


def with_rest(image: tuple[Mirror, Mirror], layout: Layout) -> tuple[Mirror, Mirror]:
    """The image with the number of `parts.with_rest`, which it leaves as it is."""
    (obs, action), at = image, layout.prop_size - 1
    index = np.insert(obs.index + (obs.index >= at), at, at)
    return Mirror(index, np.insert(obs.sign, at, 1.0)), action


def _asked(probed: Probed, raw, action, before, after):
    return jax.device_get(probed.ask(raw, action, before, after, before, after))


def _turned(table: Mirror, x: Any) -> np.ndarray:
    return (table.sign * x[..., table.index]).astype(x.dtype)


def _joints(task: Any) -> Mirror:
    model = task.mj_model
    pose = np.asarray(getattr(task, "_init_q", model.qpos0), float)
    names = tuple(model.joint(i).name for i in range(1, model.njnt))
    robot: Any = SimpleNamespace(
        mj_model=model, home_qpos=pose, default_pose=pose[7:], joint_names=names, name="of the task"
    )
    if model.nq - 7 != model.njnt - 1:
        raise ConfigError("it is not one robot of hinges")
    return Mirror(*partners.joints(robot))


def _actions(model: mujoco.MjModel, joints: Mirror) -> Mirror:
    """The joints' mirror in the order of the motors."""
    joint = model.actuator_trnid[:, 0] - 1
    motor = np.full(len(joints.index), 0)
    motor[joint] = np.arange(len(joint))
    return Mirror(motor[joints.index[joint]], joints.sign[joint])


def _flat(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model on even ground: rough ground is no image of itself."""
    model = copy.deepcopy(model)
    model.hfield_data[:] = 0
    return model


def _states(model, home, joints: Mirror, actions: Mirror, draw) -> tuple[dict, dict]:
    """Data of random states about the first pose, near the ground, and of their images, by C MuJoCo."""
    low, high = model.jnt_range[1:].T
    found: tuple[list, list] = [], []
    for _ in range(parts.PROBES):
        qpos, qvel = home["qpos"].astype(float), draw.normal(0, 0.3, model.nv)
        qpos[:2] = 0
        turn = np.zeros(4)
        mujoco.mju_euler2Quat(turn, draw.normal(0, [0.1, 0.1, 1.0]), "xyz")
        mujoco.mju_mulQuat(qpos[3:7], turn, home["qpos"][3:7].astype(float))
        qpos[2] += draw.uniform(-0.04, 0.03)
        spread = qpos[7:] + draw.normal(0, 0.12, len(qpos) - 7)
        qpos[7:] = np.where(model.jnt_limited[1:] > 0, np.clip(spread, low, high), spread)
        ctrl = home["ctrl"] + draw.normal(0, 0.1, model.nu)
        image = (
            np.concatenate([qpos[:7] * QPOS, _turned(joints, qpos[7:])]),
            np.concatenate([qvel[:6] * QVEL, _turned(joints, qvel[6:])]),
            _turned(actions, ctrl),
        )
        for rows, state in zip(found, ((qpos, qvel, ctrl), image), strict=True):
            rows.append(state)
    one, other = (parts.data_of_states(model, rows) for rows in found)
    return one, other


def _unlike(one: dict, other: dict, joints: Mirror) -> float:
    """How far the joints' accelerations are from their images', a share."""
    x, y = _turned(joints, one["qacc"][:, 6:]), other["qacc"][:, 6:]
    return float(np.median(np.linalg.norm(x - y, axis=-1) / np.linalg.norm(x, axis=-1)))


def _feet(task: Any, layout: Layout) -> np.ndarray:
    """The image of each foot, [] where the task names none."""
    sites = getattr(task, "_feet_site_id", np.zeros(0, int))
    if not len(sites):
        return np.zeros(0, int)
    place = layout.home["site_xpos"][sites] - layout.home["qpos"][:3]
    return np.linalg.norm((place * MOVES)[:, None] - place, axis=-1).argmin(-1)


def _image(name: str, x: np.ndarray, joints: Mirror, actions: Mirror, feet: np.ndarray):
    """The image of one of the task's own numbers [K, ...]: its name and its size say what it is."""
    shape = x.shape[1:]
    if shape == (3,):
        return (x * VECTORS.get(name, MOVES)).astype(x.dtype)
    if shape == (2,) and name == "push":
        return (x * MOVES[:2]).astype(x.dtype)
    size = len(joints.index)
    if len(shape) == 1 and shape[0] % size == 0 and shape[0] > 0:
        table = joints if "vel" in name else actions
        blocks = x.reshape(len(x), -1, size)
        return _turned(table, blocks).reshape(x.shape)
    if shape and shape[0] == len(feet):
        return x[:, feet]
    return x


def _spread(x: np.ndarray) -> np.ndarray:
    return CLOSE * x.std(0) + 1e-4


def _same(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of each column, whether it is the same in most states."""
    return (np.abs(x - y) <= _spread(x)).mean(0) >= MOST


def _matched(layout: Layout, x: np.ndarray, y: np.ndarray) -> Mirror | str:
    """The mirror of obs, of its numbers `x` [K, O] and those of the images `y`; or which has no partner."""
    size = x.shape[1]
    index, sign = np.full(size, -1), np.ones(size)
    seen = np.zeros((size, 2), bool)
    seen[layout.views.actor, 0] = seen[layout.views.critic, 1] = True
    noise = np.zeros(size)
    noise[: layout.prop_size] = layout.noise
    # [2, O, O]: whether the image of i is +j or -j
    may = np.stack(
        [
            np.stack(
                [(np.abs(y[:, [i]] - s * x) <= _spread(x)).mean(0) >= MOST for i in range(size)]
            )
            for s in (1, -1)
        ]
    )
    alike = (seen[:, None] == seen).all(-1) & (np.abs(noise[:, None] - noise) < 1e-4)
    may &= alike & (may & may.transpose(0, 2, 1))
    own = np.eye(size, dtype=bool)
    for i in np.flatnonzero(seen.any(1)).tolist():
        if index[i] >= 0:
            continue
        if x[:, i].std() < 1e-6:
            return f"{_name(layout, i)} is the same in all random states"
        free = index < 0
        # itself, then another, each before its negative; two phases half a turn apart are both
        options = [(1, may[0, i] & own[i]), (1, may[0, i] & free), (-1, may[1, i] & free)]
        chosen = next(((s, j) for s, ok in options for j in np.flatnonzero(ok)), None)
        if chosen is None:
            return f"{_name(layout, i)} has no partner"
        s, j = chosen
        index[[i, j]], sign[[i, j]] = (j, i), s
    unseen = index < 0
    index[unseen] = np.flatnonzero(unseen)
    return Mirror(index, sign)


def _name(layout: Layout, i: int) -> str:
    at = np.flatnonzero(layout.views.actor == i)
    if len(at):
        return f"number {at[0]} of the observation"
    return (
        f"number {int(np.flatnonzero(layout.views.critic == i)[0])} of what the value function sees"
    )

"""How the feet move in recorded trials, for any number of feet. NumPy only.

For each foot, and their mean; contacts and swings shorter than a control step are bounces and do not count:

- `duty_factor`: share of time on the ground; `air_time` (s): mean duration of its swings;
  `stride_frequency`: touch-downs a second
- `clearance` (m): the greatest height of its lowest point in a swing, mean over swings
- `slip` (m/s): horizontal speed of the points that touch the ground, mean weighted with their load. A
  foot that rolls over its edge does not slip

For all feet together:

- `flight`: share of time with every foot in the air
- `asymmetry`: difference between the mean swings of the left and the right feet, as a share of their mean.
  The default pose says which feet are left
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np

from dynappo.policy import episode as episode_lib
from dynappo.policy.episode import Player

# of swings; the others are of all time, and of a robot that stands, too
OF_STRIDES = frozenset("air_time stride_frequency clearance asymmetry".split())


def at_ground(player: Player, data) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`(contact, load, slide)` [F] of the last physics step in `data`, as it began.

    `contact`: whether a foot touches the ground; `load` (N): sum of the normal forces on it; `slide` (m/s):
    horizontal speed of its points of contact, weighted with these forces, 0 without load.
    """
    count, force = len(player.foot_names), np.zeros(6)
    touching = np.flatnonzero(data.contact.dist < 0)
    pairs = data.contact.geom[touching]
    foot = player.foot_of[pairs].max(-1)  # -1 of what is no foot
    kept = (foot >= 0) & player.ground[pairs].any(-1)
    touching, foot, shape = (
        touching[kept],
        foot[kept],
        pairs[kept][player.foot_of[pairs[kept]] >= 0],
    )
    normal = np.zeros(len(touching))
    for k, i in enumerate(touching):
        mujoco.mj_contactForce(player.model, data, i, force)
        normal[k] = force[0]
    moving = player.model.geom_bodyid[shape]
    x, y, z = (data.contact.pos[touching] - data.subtree_com[player.base_body]).T
    turn_x, turn_y, turn_z, move_x, move_y, _ = data.cvel[moving].T
    speed = np.hypot(move_x + turn_y * z - turn_z * y, move_y + turn_z * x - turn_x * z)
    contact = np.bincount(foot, minlength=count) > 0
    load, moved = (np.bincount(foot, each, count) for each in (normal, normal * speed))
    return contact, load, np.divide(moved, load, out=np.zeros(count), where=load > 0)


def intervals(contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(first rows, rows after the last)` of the stretches of `contact [P]` that are True."""
    edges = np.diff(np.concatenate([[0], contact.astype(int), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def stances(contact: np.ndarray, brief: int) -> tuple[np.ndarray, np.ndarray]:
    """`intervals` of one foot's `contact [P]` without bounces, which belong to what is around them.

    A bounce is a contact or a swing of fewer than `brief` rows. One that the recording cuts is no bounce.
    """
    on, off = intervals(contact)
    long = (on == 0) | (off == len(contact)) | (off - on >= brief)
    on, off = on[long], off[long]
    if not len(on):
        return on, off
    parts = on[1:] - off[:-1] >= brief
    return on[np.r_[True, parts]], off[np.r_[parts, True]]


def strides(contact: np.ndarray, brief: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`(lifts, lands, touchdowns)` of one foot's `contact [P]`: the rows where each swing begins, where it
    ends, and where each step begins.

    Bounces as in `stances`. Swings that the recording cuts are left out.
    """
    on, off = stances(contact, brief)
    return off[:-1], on[1:], on[on > 0]


def measures(player: Player, parts: Iterable[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """The measures of the module's docstring over several recordings together, and of each foot in `feet`.

    A recording has a row for each physics step: `contact`, `load`, `slide` and `height` (of the lowest point,
    m), all `[P, F]`. None where one cannot be computed.
    """
    parts = [part for part in parts if len(part["contact"])]
    timestep, each = player.model.opt.timestep, {}
    for j, name in enumerate(player.foot_names):
        found = [strides(part["contact"][:, j], player.substeps) for part in parts]
        lasts = np.concatenate([np.zeros(0), *[lands - lifts for lifts, lands, _ in found]])
        tops = [
            part["height"][a:b, j].max()
            for part, (lifts, lands, _) in zip(parts, found, strict=True)
            for a, b in zip(lifts, lands, strict=True)
        ]
        steps = [begins for *_, begins in found if len(begins) > 1]
        lasted = sum(int(begins[-1] - begins[0]) for begins in steps) * timestep
        count = sum(len(begins) - 1 for begins in steps)
        load = sum(part["load"][:, j].sum() for part in parts)
        moved = sum((part["load"][:, j] * part["slide"][:, j]).sum() for part in parts)
        down = np.concatenate([part["contact"][:, j] for part in parts]) if parts else None
        each[name] = {
            "duty_factor": None if down is None else float(down.mean()),
            "air_time": float(lasts.mean() * timestep) if len(lasts) else None,
            "stride_frequency": count / lasted if count else None,
            "clearance": float(np.mean(tops)) if tops else None,
            "slip": float(moved / load) if load else None,
        }
    mean = {name: _mean(foot[name] for foot in each.values()) for name in [*each.values()][0]}
    mean["flight"] = _flight([part["contact"] for part in parts], player.substeps)
    sides = left_or_right(player)
    swings = [
        _mean(each[name]["air_time"] for name, s in zip(each, sides, strict=True) if s == side)
        for side in (1, -1)
    ]
    left, right = swings
    mean["asymmetry"] = None
    if left is not None and right is not None:
        mean["asymmetry"] = 2 * abs(left - right) / (left + right)
    return mean | {"feet": each}


def left_or_right(player: Player) -> np.ndarray:
    """[F] 1 for a foot left of the base in the default pose, -1 right of it, 0 on the middle plane."""
    data = mujoco.MjData(player.model)
    data.qpos[player.root[0] + 3 : player.root[0] + 7] = [1, 0, 0, 0]
    data.qpos[player.joint_q] = player.policy.default_pose
    mujoco.mj_kinematics(player.model, data)
    across = data.geom_xpos[:, 1] - data.xpos[player.base_body, 1]
    feet = range(len(player.foot_names))
    middle = np.array([across[player.foot_of == foot].mean() for foot in feet])
    return np.sign(np.where(np.abs(middle) < 1e-3, 0.0, middle))


def heights(player: Player, height: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Heights [P, F] (m) of the feet's lowest points, from those of the geoms of `shapes(player)` [P, G] and
    the third rows of their rotation matrices [P, G, 3]."""
    ids = shapes(player)
    low = episode_lib.lowest(player.model, ids, height, row)
    feet = range(len(player.foot_names))
    return np.stack([low[:, player.foot_of[ids] == foot].min(-1) for foot in feet], -1)


def shapes(player: Player) -> np.ndarray:
    """The ids of the feet's geoms [G]."""
    return np.flatnonzero(player.foot_of >= 0)


def _flight(contacts: list[np.ndarray], brief: int) -> float | None:
    """Share of rows of `contacts` [P, F] in which every foot is in a swing."""
    if not contacts:
        return None
    up = 0
    for contact in contacts:
        down = np.zeros(len(contact), bool)
        for foot in contact.T:
            for on, off in zip(*stances(foot, brief), strict=True):
                down[on:off] = True
        up += (~down).sum()
    return float(up / sum(map(len, contacts)))


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None

"""A default pose for a file that has none: of a scene beside it, else legs bent by a rule."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

BENT = 0.85  # of the longest reach, from the leg's second joint to its end
GRID = 41  # angles of each joint that are tried
WIDEST = 1.6  # rad from the joint's zero
ASIDE = 0.02  # of the reach: how far ahead of the joint the foot may stand
HINGE = mujoco.mjtJoint.mjJNT_HINGE


def candidates(
    spec: mujoco.MjSpec, model: mujoco.MjModel, xml: Path
) -> Iterator[tuple[mujoco.MjSpec, list[str]]]:
    """Copies of a spec with a keyframe, the best first, each with a line on where that is from.

    The file's own; that of a scene beside it; bent legs. The next is for a file whose robot cannot stand
    in the one before.
    """
    if spec.keys:
        yield spec.copy(), []
    for scene in sorted(xml.parent.glob("*.xml")) if not spec.keys else []:
        found = _of_scene(scene, model) if scene != xml else None
        if found is not None:
            yield (
                _with_home(spec, found),
                [f"home: the file has no keyframe; that of {scene.name} beside it"],
            )
            break
    qpos, bent = _bent(model)
    if bent:
        why = "the robot does not stand in the file's keyframe" if spec.keys else "no keyframe"
        yield (
            _with_home(spec, qpos),
            [
                f"home: {why}; {bent} legs bent to {BENT:.0%} of their reach, feet below their joints"
            ],
        )
    if not spec.keys:
        yield spec.copy(), []


def _with_home(spec: mujoco.MjSpec, qpos: np.ndarray) -> mujoco.MjSpec:
    out = spec.copy()
    for key in list(out.keys):
        out.delete(key)
    out.add_key(name="home", qpos=qpos)
    return out


def _of_scene(scene: Path, model: mujoco.MjModel) -> np.ndarray | None:
    """The first keyframe of a file beside the robot's that has the same joints."""
    try:
        spec = mujoco.MjSpec.from_file(str(scene))
    except (ValueError, RuntimeError, mujoco.FatalError):
        return None
    joints = [model.joint(i).name for i in range(model.njnt)]
    if [joint.name for joint in spec.joints] != joints or len(spec.bodies) < 2:
        return None
    keys = sorted(spec.keys, key=lambda key: key.name != "home")
    fits = [np.array(key.qpos) for key in keys if len(key.qpos) == model.nq]
    return fits[0] if fits else None


def _bent(model: mujoco.MjModel) -> tuple[np.ndarray, int]:
    """`(qpos, legs)`: the pose at rest, with the last two joints of each leg of three joints bent.

    A leg is a chain of three bodies with a hinge each, the last without children. Of the angles that put its
    end below its second joint, at `BENT` of the farthest, those are taken that bend the knee in the middle of
    its range; where the range says nothing, so that the knee points to the base's middle.
    """
    data, qpos, count = mujoco.MjData(model), model.qpos0.copy(), 0
    if model.njnt and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        qpos[3:7] = [1, 0, 0, 0]
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] == HINGE]
    moved = {int(model.jnt_bodyid[j]): j for j in hinges}
    for joint in hinges:
        chain = _chain(model, moved, int(model.jnt_bodyid[joint]))
        if len(chain) != 3:
            continue
        angles = _angles(model, data, qpos, chain)
        if angles is not None:
            qpos[model.jnt_qposadr[chain[1:]]] = angles
            count += 1
    return qpos, count


def _chain(model, moved: dict[int, int], last: int) -> list[int]:
    """The joints from the base to body `last`, if no joint is below it; else none."""
    parents = {_above(model, moved, body) for body in moved}
    if last in parents:
        return []
    chain = []
    while last in moved:
        chain.insert(0, moved[last])
        last = _above(model, moved, last)
    return chain


def _above(model, moved, body: int) -> int:
    """The next body above that a hinge moves; 0 if there is none."""
    body = int(model.body_parentid[body])
    while body > 0 and body not in moved:
        body = int(model.body_parentid[body])
    return body


def _angles(model, data, qpos, chain: list[int]) -> np.ndarray | None:
    """Angles (rad) of the chain's second and third joint; None if its end cannot come below them."""
    tries = []
    for joint in chain[1:]:
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        tries.append(np.linspace(max(low, -WIDEST), min(high, WIDEST), GRID))
        if not tries[-1][0] < tries[-1][-1]:
            tries[-1] = np.linspace(low, high, GRID)
    adr, end = model.jnt_qposadr[chain[1:]], _end(model, data, qpos, chain)
    pairs, ends, knees = np.stack(np.meshgrid(*tries), -1).reshape(-1, 2), [], []
    pose = qpos.copy()
    for pair in pairs:
        pose[adr] = pair
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        body = model.jnt_bodyid[chain[2]]
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ end
        ends.append(tip - data.xanchor[chain[1]])
        knees.append(data.xanchor[chain[2]][0] - data.xanchor[chain[1]][0])
    ends, ahead = np.array(ends), np.sign(data.xanchor[chain[1]][0] - data.xpos[1][0])
    longest = -ends[:, 2].min()
    off = np.abs(ends[:, 0]) / longest + np.abs(-ends[:, 2] / longest - BENT)
    near = off < off.min() + ASIDE
    if off.min() > 5 * ASIDE:
        return None
    wide = tries[1][-1] - tries[1][0] >= 2 * WIDEST - 1e-6
    cost = ahead * np.array(knees) / longest if wide else np.abs(pairs[:, 1] - tries[1].mean())
    return np.round(pairs[near][(cost + off)[near].argmin()], 2)


def _end(model, data, qpos, chain: list[int]) -> np.ndarray:
    """The point of the last link, in its frame, that is farthest from its joint: of its shapes' centres."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    body = int(model.jnt_bodyid[chain[2]])
    inside = [g for g in range(model.ngeom) if body in _line(model, int(model.geom_bodyid[g]))]
    points = np.array([data.geom_xpos[g] for g in inside] or [data.xipos[body]])
    far = points[np.linalg.norm(points - data.xanchor[chain[2]], axis=1).argmax()]
    return data.xmat[body].reshape(3, 3).T @ (far - data.xpos[body])


def _line(model, body: int) -> list[int]:
    """A body and all above it."""
    line = [body]
    while (body := int(model.body_parentid[body])) > 0:
        line.append(body)
    return line

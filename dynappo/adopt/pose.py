"""A default pose for a file without one: that of a scene beside it, else legs bent by a rule."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from dynappo.description import complete, home_pose, kinematics

BENT = 0.85  # of the longest reach, from the leg's second joint to its end
GRID = 41  # angles of each joint that are tried
WIDEST = 1.6  # rad from the joint's zero
ASIDE = 0.02  # of the reach: how far ahead of the joint the foot may stand
# rad: a biped's knee is straight up to the first, and then bent by the second, about as in mjlab's G1
STRAIGHT, KNEE = 0.25, 0.66
LEVEL = 0.02  # m, by which the ends of two legs may differ in height
ALONG = 0.9  # of an axis' unit length
HINGE = mujoco.mjtJoint.mjJNT_HINGE


def candidates(
    spec: mujoco.MjSpec, model: mujoco.MjModel, xml: Path
) -> Iterator[tuple[mujoco.MjSpec, list[str]]]:
    """Copies of a spec with a keyframe, the best first, each with a line on its source.

    The file's own keyframe; that of a scene beside the file; bent legs; all joints at rest. Each is for a
    robot that cannot stand in the one before. Straight knees of two legs are bent first.
    """
    if spec.keys:
        key = next((key for key in spec.keys if key.name == "home"), spec.keys[0])
        home_pose.check_finite(key.name, np.array(key.qpos))
        yield from _knees(spec, model, np.array(key.qpos), "the file's keyframe")
        yield spec.copy(), []
    for scene in sorted(xml.parent.glob("*.xml")) if not spec.keys else []:
        found = _of_scene(scene, model) if scene != xml and scene.is_file() else None
        if found is not None:
            what = f"the file has no keyframe; that of {scene.name} beside it"
            yield from _knees(spec, model, found, what)
            yield _with_home(spec, found), [f"home: {what}"]
            break
    why = "the robot does not stand in the file's keyframe" if spec.keys else "no keyframe"
    qpos, bent = _bent(model)
    if bent:
        how = f"{bent} legs bent to {BENT:.0%} of their reach, feet below their joints"
        yield _with_home(spec, qpos), [f"home: {why}; {how}"]
    if not spec.keys:
        what = "no keyframe; all joints are at rest"
        yield from _knees(spec, model, _at_rest(model), what)
        yield _with_home(spec, model.qpos0), [f"home: {what}"]


def _knees(spec, model, qpos: np.ndarray, what: str) -> Iterator[tuple[mujoco.MjSpec, list[str]]]:
    """A candidate with bent knees, if two legs are straight in the pose `qpos`."""
    bent = _bent_knees(model, qpos) if len(qpos) == model.nq else None
    if bent is not None:
        how = f"straight knees are bent by {KNEE:g} rad, hips and ankles turn back by half of that"
        yield _with_home(spec, bent), [f"home: {what}, but {how}"]


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
        complete.drop_bodies_without_limbs(spec, [])
        joints = [model.joint(i).name for i in range(model.njnt)]
        names = [joint.name or f"joint{i}" for i, joint in enumerate(spec.joints)]  # source.read's
        if names != joints or len(spec.bodies) < 2:
            return None
        keys = sorted(spec.keys, key=lambda key: key.name != "home")
        poses = [np.array(key.qpos) for key in keys]
    except (ValueError, RuntimeError, mujoco.FatalError):  # names may not be UTF-8
        return None
    return next((x for x in poses if len(x) == model.nq and np.isfinite(x).all()), None)


def _bent(model: mujoco.MjModel) -> tuple[np.ndarray, int]:
    """`(qpos, legs)`: the pose at rest, with the last two joints of each leg of three joints bent.

    A leg is a chain of three bodies with a hinge each, the last without children. Of the pairs of angles
    that put its end below its second joint, at `BENT` of the longest reach, it takes the one whose knee is
    nearest to the middle of its range. Without a limited range it takes one whose knee points to the base's
    middle.
    """
    data, qpos, count = mujoco.MjData(model), _at_rest(model), 0
    for chain in _limbs(model):
        if len(chain) != 3 or any(model.jnt_type[joint] != HINGE for joint in chain):
            continue
        angles = _angles(model, data, qpos, chain)
        if angles is not None:
            qpos[model.jnt_qposadr[chain[1:]]] = angles
            count += 1
    return qpos, count


def _bent_knees(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray | None:
    """A pose with the knees of two legs bent, the feet turned as they were; None if there are not two that
    reach lowest, or their knees are bent already.

    Hip, knee and ankle are the joints about the y axis of a limb that has three. The knee goes forward;
    backward if ranges allow only that.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    across, legs = data.xaxis[:, 1], []
    for chain in _limbs(model):
        pitch = [j for j in chain if model.jnt_type[j] == HINGE and abs(across[j]) > ALONG]
        if len(pitch) == 3:
            legs.append((data.xpos[model.jnt_bodyid[chain[-1]], 2], pitch))
    legs = [pitch for low, pitch in legs if low < min(low for low, _ in legs) + LEVEL]
    if len(legs) != 2 or max(_bend(data.xanchor[pitch]) for pitch in legs) > STRAIGHT:
        return None
    joints = np.concatenate(legs)
    where = model.jnt_qposadr[joints]
    low, high = model.jnt_range[joints].T
    for forward in (1, -1):
        bent = qpos.copy()
        bent[where] += forward * KNEE * np.sign(across[joints]) * np.tile([-0.5, 1, -0.5], 2)
        inside = (low <= bent[where]) & (bent[where] <= high)
        if (inside | ~model.jnt_limited[joints].astype(bool)).all():
            return bent
    return None


def _bend(places: np.ndarray) -> float:
    """The angle (rad) of a knee, from the places [3, 3] of hip, knee and ankle, seen from the side."""
    thigh, shank = np.diff(places[:, ::2], axis=0)
    cosine = thigh @ shank / np.linalg.norm(thigh) / np.linalg.norm(shank)
    return float(np.arccos(np.clip(cosine, -1, 1)))


def _at_rest(model: mujoco.MjModel) -> np.ndarray:
    """All joints at rest, the base upright."""
    qpos = model.qpos0.copy()
    if model.njnt and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        qpos[3:7] = [1, 0, 0, 0]
    return qpos


def _limbs(model: mujoco.MjModel) -> list[list[int]]:
    """The joints from the base to the end of each limb."""
    chains = [_joints_to(model, int(body)) for body in np.flatnonzero(model.body_jntnum)]
    chains = [chain for chain in chains if chain]
    return [c for c in chains if not any(c[-1] in other for other in chains if other is not c)]


def _joints_to(model: mujoco.MjModel, body: int) -> list[int]:
    """The ids of the joints between the base and a body; `kinematics` has none for the free joint."""
    return [joint + 1 for joint in kinematics.joints_to(model, body)]


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
    bodies = model.geom_bodyid
    inside = [g for g, of in enumerate(bodies) if chain[2] in _joints_to(model, int(of))]
    points = np.array([data.geom_xpos[g] for g in inside] or [data.xipos[body]])
    far = points[np.linalg.norm(points - data.xanchor[chain[2]], axis=1).argmax()]
    return data.xmat[body].reshape(3, 3).T @ (far - data.xpos[body])

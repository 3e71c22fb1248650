"""The home pose in a file that `complete` completes: a keyframe that fits, upright and in the joints' ranges,
with the feet on the floor."""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.description import feet, joints, mjcf

ON_FLOOR = 0.01  # m that the lowest foot may be from the floor in the home pose


def keys(spec: mujoco.MjSpec, poses: list[np.ndarray], freed: bool, notes: list[str]) -> None:
    """Delete keyframes that do not fit; the first of the others becomes `home` if none is.

    `poses` are their `qpos`, without numbers of the base if that was not free before (`freed`).
    """
    size = sum(count for _, count in joints.sizes(spec.worldbody))
    kept = []
    for key, pose in zip(list(spec.keys), poses, strict=True):
        if not len(pose):
            pass  # joints at rest, as MuJoCo writes a pose that is `qpos0`
        elif freed and len(pose) == size - 7:
            key.qpos, key.qvel = np.concatenate([[0, 0, 0, 1, 0, 0, 0], pose]), []
        elif len(pose) != size:
            if key.name == "home":
                notes.append(
                    f"the keyframe home is left out: it has {len(pose)} numbers, not {size}"
                )
            spec.delete(key)
            continue
        kept.append((key, pose))
        if len(key.mpos):
            key.mpos, key.mquat = [], []  # of bodies of a scene
    if not kept:
        return
    key, pose = next((one for one in kept if one[0].name == "home"), kept[0])
    check_finite(key.name, pose)
    if key.name != "home":
        notes.append(f"the home pose is the keyframe {key.name or 'without a name'}")
        key.name = "home"


def check_finite(name: str, pose: np.ndarray) -> None:
    """ValueError if a keyframe has a number with which no robot stands anywhere."""
    if not np.isfinite(pose).all():
        raise ValueError(
            f"the keyframe {name or 'without a name'} has a number that is not finite; correct it"
        )


def pose(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The home pose is upright, and within the joints' ranges."""
    key = next((key for key in spec.keys if key.name == "home"), None)
    home = np.array(model.qpos0 if key is None or not len(key.qpos) else key.qpos)
    if key is None:
        key = spec.add_key(name="home")
        notes.append("no keyframe fits: the home pose has all joints at rest")
    before = np.array(key.qpos)  # as compiled
    low, high = joints.ranges(model).T
    inside = np.clip(home[7:], low, high)
    far = np.flatnonzero(home[7:] != inside)
    if len(far):
        names = mjcf.listed(model.joint(1 + i).name for i in far)
        notes.append(f"in the home pose, brought into their range: {names}")
        home[7:] = inside
    if not np.allclose(home[3:7], [1, 0, 0, 0]):
        notes.append("in the home pose, the base is set upright")
        home[3:7] = [1, 0, 0, 0]
    if np.array_equal(before, home):
        return False
    key.qpos = home
    return True


def on_the_floor(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The lowest foot of the home pose is at the floor."""
    home = model.key("home").qpos.copy()
    lowest = feet.lowest_points(model, home, feet.named(feet.geom_names(spec))[0]).min()
    if abs(lowest) < ON_FLOOR:
        return False
    home[2] -= lowest
    spec.key("home").qpos = home
    notes.append(f"in the home pose, the base is at {home[2]:.4g} m, with the feet on the floor")
    return True

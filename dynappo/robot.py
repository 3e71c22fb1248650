"""A robot folder -> `Robot`: the compiled physics model and everything the task must know of it.

The contract of `robots/NAME/NAME.xml`, checked here:

- one top-level body with a free joint: the base; twelve hinge joints, leg by leg, hip to knee;
- one `motor` actuator a joint, in joint order, gear 1 (PD and limits are `actuators.py`'s);
- four sphere geoms named `LEG_foot`, in the order of the legs, each in the last body of its leg;
- every other geom with `conaffinity` is a part that must not touch the ground: box, sphere,
  capsule or cylinder; geoms of group 2 are looks and are left out of physics;
- a plane named `floor` at height 0, a camera `track`, a keyframe `home` with the default pose.

NumPy and C MuJoCo only, so that a policy can be played without JAX.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from dynappo import config as config_lib

BOX, SPHERE, CAPSULE, CYLINDER = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("BOX", "SPHERE", "CAPSULE", "CYLINDER")
)
VISUAL_GROUP = 2


class Robot(NamedTuple):
    """`F` = 4 feet, `A` = 12 joints, `G` parts that must not touch the ground."""

    name: str
    xml: Path
    mj_model: mujoco.MjModel  # without the geoms of group 2
    default_pose: np.ndarray  # [A] rad, from the keyframe
    home_qpos: np.ndarray  # [7 + A], feet on the floor
    joint_names: tuple[str, ...]
    feet: np.ndarray  # [F] geom ids
    foot_radius: np.ndarray  # [F] m
    parts: np.ndarray  # [G] geom ids
    base_body: int


def load(name: str) -> Robot:
    """The robot of folder `robots/NAME`; a ConfigError names what its file lacks."""
    xml = config_lib.find("robots", f"{name}/{name}.xml")
    if xml is None:
        raise config_lib.ConfigError(f"robot is {name!r}: there is no robots/{name}/{name}.xml")
    return load_xml(xml)


def load_xml(xml: Path) -> Robot:
    """As `load`, from any file that keeps the contract."""
    try:
        spec = mujoco.MjSpec.from_file(str(xml))
        for geom in [g for g in spec.geoms if g.group == VISUAL_GROUP]:
            spec.delete(geom)
        model = spec.compile()
    except ValueError as error:
        raise config_lib.ConfigError(f"{xml}: {str(error).splitlines()[0]}") from None
    _check(xml, model)
    feet = np.array([i for i in range(model.ngeom) if model.geom(i).name.endswith("_foot")])
    floor = model.geom("floor").id
    touches = [i for i in range(model.ngeom) if model.geom_conaffinity[i] and i != floor]
    home = model.key("home").qpos.copy()
    return Robot(
        name=xml.stem,
        xml=xml,
        mj_model=model,
        default_pose=home[7:],
        home_qpos=home,
        joint_names=tuple(model.joint(i).name for i in range(1, model.njnt)),
        feet=feet,
        foot_radius=model.geom_size[feet, 0],
        parts=np.array([i for i in touches if i not in feet]),
        base_body=int(model.jnt_bodyid[0]),
    )


def _check(xml: Path, model: mujoco.MjModel) -> None:
    """Raise a ConfigError naming the first rule of the contract that the file breaks."""

    def names(count, get):
        return [get(i).name for i in range(count)]

    def expect(ok, text):
        if not ok:
            raise config_lib.ConfigError(f"{xml}: expected {text}")

    geoms, joints = names(model.ngeom, model.geom), names(model.njnt, model.joint)
    expect(
        model.njnt and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE,
        "a free joint on the base, before all other joints",
    )
    expect((model.body_parentid[1:] == 0).sum() == 1, "one top-level body, the base")
    hinges = (model.jnt_type[1:] == mujoco.mjtJoint.mjJNT_HINGE).all()
    expect(
        model.njnt == 13 and hinges,
        f"12 hinge joints after the free one, found {model.njnt - 1}",
    )
    motors = names(model.nu, model.actuator) == joints[1:]
    motors = motors and (model.actuator_trnid[:, 0] == np.arange(1, 13)).all()
    motors = motors and (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE).all()
    motors = motors and (model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0] == 1).all()
    expect(motors, "one motor of gear 1 a joint, named and ordered as the joints")
    feet = [model.geom(name) for name in geoms if name.endswith("_foot")]
    found = ", ".join(foot.name for foot in feet) or "none"
    expect(len(feet) == 4, f"4 sphere geoms named LEG_foot, found {found}")
    expect(all(foot.type[0] == SPHERE for foot in feet), "the feet to be spheres")
    expect(all(foot.conaffinity[0] for foot in feet), "the feet to touch the floor (conaffinity)")
    expect(
        all(foot.bodyid[0] == model.jnt_bodyid[3 * i + 3] for i, foot in enumerate(feet)),
        "the foot geoms in the last body of each leg, in the order of the legs",
    )
    expect("floor" in geoms, "a geom named floor")
    floor = model.geom("floor")
    expect(
        floor.type[0] == mujoco.mjtGeom.mjGEOM_PLANE and floor.pos[2] == 0,
        "the geom floor to be a plane at height 0",
    )
    touching = [i for i in range(model.ngeom) if model.geom_conaffinity[i] and i != floor.id]
    odd = [
        geoms[i] or f"geom {i}"
        for i in touching
        if model.geom_type[i] not in (BOX, SPHERE, CAPSULE, CYLINDER)
    ]
    expect(not odd, f"parts of type box, sphere, capsule or cylinder, not {', '.join(odd)}")
    expect(model.nkey and model.key(0).name == "home", "a keyframe named home")
    expect("track" in names(model.ncam, model.camera), "a camera named track")


def physics_model(robot: Robot, physics) -> mujoco.MjModel:
    """A copy of the robot's model with the solver and contacts of the config's group `physics`.

    `contacts="feet"`: only the feet touch the floor. Enough wherever any other part at the ground
    ends the episode, and fewer constraints. Cone, impratio and integrator are the file's.
    """
    model = copy.copy(robot.mj_model)
    model.opt.timestep = physics.timestep
    model.opt.iterations = physics.iterations
    model.opt.ls_iterations = physics.ls_iterations
    if physics.contacts == "feet":
        model.geom_conaffinity[robot.parts] = 0
    return model


def floor_distance(model: mujoco.MjModel, geoms: np.ndarray):
    """Constants `(fixed [G], linear [G, 3], ring [G])` of how far each geom reaches down.

    With r the third row of a geom's rotation matrix, its lowest point lies below its centre by

        fixed + linear . |r| + ring sqrt(1 - r_z^2)

    (sphere: radius; capsule: radius + half |r_z|; box: half sizes . |r|; cylinder: half |r_z| +
    radius sqrt(1 - r_z^2)), which holds for MuJoCo's conventions of size and axis.
    """
    size, kind = model.geom_size[geoms], model.geom_type[geoms]
    round_end = np.isin(kind, (SPHERE, CAPSULE))
    axial = np.isin(kind, (CAPSULE, CYLINDER))
    box = kind == BOX
    fixed = np.where(round_end, size[:, 0], 0.0)
    linear = np.where(box[:, None], size, 0.0)
    linear[axial, 2] = size[axial, 1]
    ring = np.where(kind == CYLINDER, size[:, 0], 0.0)
    return fixed, linear, ring


def leg_chains(robot: Robot):
    """`(pos [F, 4, 3], axis [F, 3, 3])` of each leg: offsets hip, thigh, calf, foot; joint axes.

    Used to place a reset robot with its feet above the floor without a physics call; needs the
    contract's aligned frames (identity body quaternions).
    """
    m = robot.mj_model
    bodies = m.jnt_bodyid[1:].reshape(4, 3)
    if not np.allclose(m.body_quat[bodies], [1, 0, 0, 0]):
        raise config_lib.ConfigError(
            f"{robot.xml}: expected leg bodies with frames parallel to the base's (no quat)"
        )
    pos = np.concatenate([m.body_pos[bodies], m.geom_pos[robot.feet][:, None]], axis=1)
    return pos, m.jnt_axis[1:].reshape(4, 3, 3)


def feet_in_base(legs, joints):
    """Foot centres [F, 3] (m) in the base frame at joint angles [A], by the chains of each leg."""
    offsets, axes = legs
    xp = joints.__array_namespace__()
    offsets, axes = xp.asarray(offsets, dtype=joints.dtype), xp.asarray(axes, dtype=joints.dtype)
    angles = joints.reshape(axes.shape[:2])
    position = offsets[:, 3]
    for i in (2, 1, 0):  # from the foot up to the hip: rotate about the joint, add the offset
        axis, angle = axes[:, i], angles[:, i, None]
        turned = xp.linalg.cross(axis, position)
        position = (
            position * xp.cos(angle)
            + turned * xp.sin(angle)
            + axis * (axis * position).sum(-1, keepdims=True) * (1 - xp.cos(angle))
        )
        position = offsets[:, i] + position
    return position

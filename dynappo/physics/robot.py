"""Loads a robot's folder as a `Robot`: the compiled physics model, and what a task needs to know of it.

robot_contract.py has the rules for the file. NumPy and C MuJoCo only, so that a policy can be played
without JAX.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.config import ConfigError, files
from dynappo.physics import mjcf, robot_contract

VISUAL_GROUP = 2
# prefixes of a model's arrays that decide how it moves, and suffixes of those that do not
MOVES = ("body_", "jnt_", "dof_", "geom_", "qpos", "key_", "actuator_", "eq_", "tendon_")
LOOKS = ("_group", "_rgba", "_matid", "_user", "_bvhadr", "_bvhnum")


class Robot(NamedTuple):
    """`F` feet of `S` shapes in all, `A` joints, `G` parts that must not touch the ground."""

    name: str
    xml: Path
    mj_model: mujoco.MjModel  # without the geoms of group 2
    default_pose: np.ndarray  # [A] rad, from the keyframe
    home_qpos: np.ndarray  # [7 + A], feet on the floor
    joint_names: tuple[str, ...]
    feet: np.ndarray  # [S] geom ids of the feet's shapes, foot by foot
    foot_of: np.ndarray  # [S] the number of the foot that a shape belongs to
    foot_names: tuple[str, ...]  # [F] as FL of the geom FL_foot
    parts: np.ndarray  # [G] geom ids
    base_body: int
    text: str  # its MJCF, if it comes from a policy or a checkpoint; else ""
    alone: str  # its MJCF as one text that needs no other file; "" if there is none


def load(name: str) -> Robot:
    """The robot of folder `robots/NAME`; a ConfigError names what its file lacks."""
    plain = isinstance(name, str) and not {"/", "\\"} & set(name)  # no path out of robots/
    xml = files.find("robots", f"{name}/{name}.xml") if plain else None
    if xml is None:
        raise ConfigError(f"robot is {name!r}: there is no robots/{name}/{name}.xml")
    return load_xml(xml)


def load_xml(xml: Path) -> Robot:
    """As `load`, from any file that keeps the contract."""
    with mjcf.one_line(xml):
        return _robot(xml.stem, xml, "", alone(xml))


def load_text(text: str, name: str, source: Path) -> Robot:
    """As `load`, for an MJCF that the file `source` contains; a ConfigError begins with its path.

    The text is untrusted: it may name no other file, and is checked before MuJoCo reads it.
    """
    with mjcf.one_line(source, "the robot that it carries: "):
        mjcf.check_alone(text)
        return _robot(name, source, text, text)


def _robot(name: str, xml: Path, text: str, alone: str) -> Robot:
    spec = physics_spec(xml, text)
    robot_contract.check_file(spec)
    model = mjcf.check_model(spec.compile())
    feet, parts = robot_contract.check(model)
    home = model.key("home").qpos.copy()
    return Robot(
        name=name,
        xml=xml,
        mj_model=model,
        default_pose=home[7:],
        home_qpos=home,
        joint_names=tuple(robot_contract.names(model.njnt, model.joint)[1:]),
        feet=feet,
        foot_of=np.arange(len(feet)),
        foot_names=tuple(model.geom(i).name.removesuffix("_foot") for i in feet),
        parts=parts,
        base_body=int(model.jnt_bodyid[0]),
        text=text,
        alone=alone,
    )


def alone(xml: Path) -> str:
    """A robot's MJCF as one text that needs no other file.

    If the file names no other file, it is the file's own text. Else includes are merged and the
    looks (meshes and textures) removed; collision shapes are drawn instead. "" if the result still
    names files (plugins, height fields) or is too long.
    """
    with contextlib.suppress(ValueError):
        text = xml.read_bytes().decode()
        mjcf.check_alone(text)
        return text
    with contextlib.suppress(ValueError, mujoco.FatalError):
        spec = physics_spec(xml)
        for geom in list(spec.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:  # the contract lets none touch
                spec.delete(geom)
            elif geom.group > VISUAL_GROUP:
                geom.group = 0
        for mesh in list(spec.meshes):
            spec.delete(mesh)
        spec.compile()
        text = spec.to_xml()
        mjcf.check_alone(text)
        return text
    return ""


def same(one: Robot, other: Robot) -> bool:
    """Whether two robots move alike: equal to six digits, except for looks, names and comments."""
    if not one.alone or not other.alone:
        return False
    if one.alone == other.alone:
        return True
    first, second = (load_text(robot.alone, one.name, robot.xml) for robot in (one, other))
    here, there = _motion(first.mj_model), _motion(second.mj_model)
    return first.joint_names == second.joint_names and all(
        here[name].shape == there[name].shape and np.allclose(here[name], there[name], 1e-6, 2e-8)
        for name in here
    )


def _motion(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The arrays and options of a model that decide how it moves."""
    names = [n for n in dir(model) if n.startswith(MOVES) and not n.endswith(LOOKS)]
    arrays = {name: np.asarray(getattr(model, name)) for name in names}
    options = {n: np.asarray(getattr(model.opt, n)) for n in dir(model.opt) if n[0] != "_"}
    return arrays | options


def physics_spec(xml: Path, text: str = "") -> mujoco.MjSpec:
    """A robot's file, or its `text`, without looks: geoms of group 2, materials, textures."""
    spec = mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(xml))
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.group == VISUAL_GROUP:
            spec.delete(geom)
    for look in (*spec.materials, *spec.textures):
        spec.delete(look)
    return spec


def physics_model(robot: Robot, physics) -> mujoco.MjModel:
    """A copy of the robot's model with the solver and contacts of the config's group `physics`.

    `contacts="feet"`: only the feet touch the floor. That is enough if any other part at the ground
    ends the episode, and needs fewer constraints. Cone, impratio and integrator are the file's.
    """
    return with_settings(copy.copy(robot.mj_model), physics, robot.parts)


def with_settings(model: mujoco.MjModel, physics, parts: np.ndarray) -> mujoco.MjModel:
    """`model` itself, with the settings of `physics_model`."""
    model.opt.timestep = physics.timestep
    model.opt.iterations = physics.iterations
    model.opt.ls_iterations = physics.ls_iterations
    if physics.contacts == "feet":
        model.geom_conaffinity[parts] = 0
    return model


def digest(model: mujoco.MjModel) -> str:
    """A hash of everything in a compiled model."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).hexdigest()


class Legs(NamedTuple):
    """The joints between the base and each foot; `F` legs of `L` joints each."""

    joints: np.ndarray  # [F, L] numbers of the joints, from the base to the foot
    offsets: np.ndarray  # [F, L + 1, 3] m: each joint's body in the one before, then the foot
    axes: np.ndarray  # [F, L, 3]


def legs(robot: Robot) -> Legs:
    """The chains of joints that move the feet.

    A reset uses them to place the feet above the floor without a physics call. They need the
    contract's aligned frames (identity body quaternions) and legs of equally many joints.
    """
    m = robot.mj_model
    chains = [_chain(m, m.geom_bodyid[foot]) for foot in robot.feet]
    bodies = np.array(chains)
    offsets = np.concatenate([m.body_pos[bodies], m.geom_pos[robot.feet][:, None]], axis=1)
    joints = m.body_jntadr[bodies]
    return Legs(joints - 1, offsets, m.jnt_axis[joints])


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    """The bodies that joints move between the base and `body`, which is the last."""
    chain = []
    while model.body_parentid[body] != 0:
        chain.insert(0, int(body))
        body = model.body_parentid[body]
    return chain


def feet_in_base(legs: Legs, joints):
    """Foot centres [F, 3] (m) in the base frame at joint angles [A], by the chains of each leg."""
    xp = joints.__array_namespace__()
    offsets, axes = (xp.asarray(x, dtype=joints.dtype) for x in (legs.offsets, legs.axes))
    angles, count = joints[legs.joints], legs.joints.shape[1]
    position = offsets[:, count]
    for i in reversed(range(count)):  # from the foot up to the hip: rotate, add the offset
        axis, angle = axes[:, i], angles[:, i, None]
        turned = xp.linalg.cross(axis, position)
        position = (
            position * xp.cos(angle)
            + turned * xp.sin(angle)
            + axis * (axis * position).sum(-1, keepdims=True) * (1 - xp.cos(angle))
        )
        position = offsets[:, i] + position
    return position


def damping_rate(robot: Robot, kd: float, timestep: float) -> float:
    """`timestep kd lambda_max(M^-1)` over the joints, base free, in the default pose.

    The share of a joint's speed that explicit damping removes in one physics step: above 1 the
    speed changes sign (joints chatter), above 2 it diverges.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return timestep * kd * float(np.linalg.eigvalsh(np.linalg.inv(inertia)[6:, 6:]).max())

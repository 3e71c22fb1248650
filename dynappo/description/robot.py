"""Loads a robot's folder as a `Robot`: the compiled physics model, and what a task needs to know of it.

complete.py puts in place what a file lacks; robot_contract.py has the rules that remain. NumPy and C
MuJoCo only, so that a policy can be played without JAX.
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
from dynappo.description import collision, complete, faults, feet, joints, mjcf, robot_contract
from dynappo.description import text as text_lib

# the base's start below and above the default pose: of its height, in m, of its height
DROP = 0.3, 0.15, 0.3

# prefixes and suffixes of a model's arrays that do not decide how it moves: shapes that touch are no meshes,
# and a file's own sensors are not read. All others do, also those that a later MuJoCo adds
LOOKS = (
    "bvh_",
    "cam_",
    "light_",
    "mat_",
    "mesh_",
    "name",
    "numeric_",
    "oct_",
    "sensor_",
    "skin_",
    "tex",
)
LOOKS += ("tuple_", "signature")
OF_LOOKS = ("_group", "_rgba", "_matid", "_user", "_bvhadr", "_bvhnum")


class Robot(NamedTuple):
    """`F` feet of `S` shapes in all, `A` joints, `G` parts that must not touch the ground."""

    name: str
    xml: Path
    mj_model: mujoco.MjModel  # without looks
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
    played: str  # the MJCF that C MuJoCo plays and draws; "" if that is the file as it is
    # what was changed in the file when it was read, and its unusual options, a line each (complete.py)
    notes: tuple[str, ...] = ()


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
        return _robot(xml.stem, xml)


def load_text(text: str, name: str, source: Path) -> Robot:
    """As `load`, for an MJCF that the file `source` contains; a ConfigError begins with its path.

    The text is untrusted: it may name no other file, and is checked before MuJoCo reads it.
    """
    with mjcf.one_line(source, "the robot that it carries: "):
        mjcf.check_alone(text)
        return _robot(name, source, text)


def _robot(name: str, xml: Path, text: str = "") -> Robot:
    try:
        spec, model, notes = complete.complete(_spec(xml, text))
        robot_contract.check(model)
    except ValueError as error:
        raise ValueError(faults.of_file(xml, text, error)) from None
    shapes, foot_of, foot_names = feet.named(robot_contract.names(model.ngeom, model.geom))
    home = model.key("home").qpos.copy()
    options = complete.options(spec)
    alone = text or _alone(xml, spec, bool(notes))
    return Robot(
        name=name,
        xml=xml,
        mj_model=model,
        default_pose=home[7:],
        home_qpos=home,
        joint_names=tuple(robot_contract.names(model.njnt, model.joint)[1:]),
        feet=shapes,
        foot_of=foot_of,
        foot_names=foot_names,
        parts=robot_contract.parts_of(model),
        base_body=int(model.jnt_bodyid[0]),
        text=text,
        alone=alone,
        played=text or (alone if notes else ""),
        notes=(*notes, *options),
    )


def _alone(xml: Path, spec: mujoco.MjSpec, changed: bool) -> str:
    """A robot's MJCF as one text that needs no other file; `spec` is the completed file, and is changed.

    The file's own text if `complete` has not `changed` it and it names no other file. Else that of the
    completed file, with collision shapes in place of looks; "" if an unchanged file cannot be written so.
    """
    if not changed:
        with contextlib.suppress(ValueError):
            text = xml.read_bytes().decode()
            mjcf.check_alone(text)
            return text
    with (
        contextlib.nullcontext() if changed else contextlib.suppress(ValueError, mujoco.FatalError)
    ):
        for geom in spec.geoms:
            if geom.group > collision.VISUAL_GROUP:
                geom.group = 0
        spec.compile()
        text = text_lib.self_contained(spec)
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
    names = [n for n in dir(model) if not n.startswith(("_", *LOOKS)) and not n.endswith(OF_LOOKS)]
    found = {name: getattr(model, name) for name in names}
    arrays = {name: x for name, x in found.items() if isinstance(x, np.ndarray)}
    options = {n: np.asarray(getattr(model.opt, n)) for n in dir(model.opt) if n[0] != "_"}
    return arrays | options


def physics_spec(xml: Path, text: str = "") -> mujoco.MjSpec:
    """A robot's file, or its `text`, completed and without looks."""
    return complete.complete(_spec(xml, text)).spec


def _spec(xml: Path, text: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(xml))


def joint_ranges(robot: Robot) -> np.ndarray:
    """The range [A, 2] of each joint, rad; infinite where it has no limits."""
    return joints.ranges(robot.mj_model)


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


def check_base_mass(robot: Robot, kilograms: tuple[float, float]) -> None:
    """ConfigError if the base's mass could vary to 0 or less."""
    base = robot.mj_model.body_mass[robot.base_body]
    if kilograms[0] <= -base:
        raise ConfigError(
            f"task.randomize.base_mass is {kilograms}, expected more than -{base:.2f} kg, the mass of the "
            f"base of {robot.name}"
        )


def digest(model: mujoco.MjModel) -> str:
    """A hash of everything in a compiled model."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).hexdigest()


def spawn_note(robot: Robot, height: float) -> str:
    """A line on episodes that begin far above or below the default pose; "" if they do not."""
    home = robot.home_qpos[2]
    if home - DROP[0] * home <= height <= home + max(DROP[1], DROP[2] * home):
        return ""
    return (
        f"task.reset.spawn_height is {height:g} m, the base of the default pose at {home:.3f} m: "
        f"{home + 0.05:.2f} is 5 cm more"
    )


def damping_rate(robot: Robot, kd, timestep: float) -> float:
    """`timestep lambda_max(M^-1 kd)` over the joints, base free, in the default pose; `kd` is one number, or
    one for each joint [A].

    The share of a joint's speed that explicit damping removes in one physics step: above 1 the
    speed changes sign (joints chatter), above 2 it diverges.
    """
    # M^-1 D has the eigenvalues of the symmetric D^1/2 M^-1 D^1/2
    root = np.sqrt(np.broadcast_to(kd, len(robot.joint_names)))
    mobility = root[:, None] * joint_mobility(robot) * root
    return timestep * float(np.linalg.eigvalsh(mobility).max())


def joint_mobility(robot: Robot) -> np.ndarray:
    """Joint accelerations by joint torques [A, A] (1/(kg m^2)), base free, in the default pose."""
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    inertia = np.zeros((model.nv, model.nv))
    with mjcf.one_line(robot.xml):
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
    return np.linalg.inv(inertia)[6:, 6:]

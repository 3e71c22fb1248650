"""Checks what a robot is, after `complete` has put in place what a file may lack.

- one top-level body with a free joint: the base; below it any tree of hinge joints, each with a name;
- at least one foot, not in the base: one or several shapes `NAME_foot`, `NAME_foot1`, ..., all in one
  body, which has no other foot;
- feet and all other shapes are boxes, spheres, capsules or cylinders, on the robot; they touch the floor
  (`conaffinity`), and nothing else: only the floor has a `contype`, so the robot never collides with itself;
- feet have a higher priority than the floor, so that their friction holds;
- one `motor` per joint, named and ordered as the joints, gear 1; `actuators.py` has PD and limits;
- gravity points down; contacts, limits, gravity, constraints and motors are not disabled;
- the state is positions and velocities: no activations, no delays; no plugins, no flexes;
- a plane `floor` at height 0, a camera `track`, a keyframe `home`: the default pose, upright, within the
  joints' ranges, the lowest foot on the floor and no other shape at it.

Frames may be turned, joints may have a place and a `ref`, several may share a body, and need no range.

A file may have more (equalities, tendons, springs, ...): an engine simulates it or says that it cannot
(engine_contract.py). On a GPU a control step then takes several times as long (warp/scope.py).
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator

import mujoco
import numpy as np

from dynappo.description import contacts, feet, mjcf

AT_FLOOR = 1e-3  # m above the lowest foot
NAME = 100  # characters of a robot's or a joint's name
MOST = 3  # joints that are named of those that break a rule
FLAGS = mujoco.mjtDisableBit
Broken = Iterator[str]  # of a rule: a text for each thing that breaks it, empty where it is kept
MOTORS = "one motor of gear 1 a joint, named and ordered as the joints"
NEEDED = {  # without these there is nothing to train
    "constraint": FLAGS.mjDSBL_CONSTRAINT,
    "contact": FLAGS.mjDSBL_CONTACT,
    "limit": FLAGS.mjDSBL_LIMIT,
    "gravity": FLAGS.mjDSBL_GRAVITY,
    "actuation": FLAGS.mjDSBL_ACTUATION,
}


def check(model: mujoco.MjModel) -> None:
    """A ValueError, in a line, for a compiled file that breaks rules: of each what was found, what to do."""
    _check_all(broken(model))


def broken(model: mujoco.MjModel, pose: bool = True) -> list[str]:
    """What breaks the rules of a compiled file, in words; those of the default pose unless not `pose`."""
    rules = _check_flags, _check_gravity, _check_motors, _check_state, _check_floor, _check_contype
    rules += _check_whole_feet, _check_one_foot, _check_moving_feet, _check_hold, _check_parts
    rules += (_check_touching, *[_check_home] * pose, _check_camera, _check_names)
    return _all(*(rule(model) for rule in rules))


def _all(*rules: Broken) -> list[str]:
    return list(dict.fromkeys(text for rule in rules for text in rule if text))


def _check_all(broken: list[str]) -> None:
    if broken:
        raise ValueError(in_words(broken))


def in_words(broken: list[str]) -> str:
    """Several faults in a line, with their number, so that a file is mended at once."""
    if len(broken) == 1:
        return broken[0]
    return f"{len(broken)} faults: " + "; ".join(f"({i}) {one}" for i, one in enumerate(broken, 1))


def _expect(ok, rule: str, found="") -> str:
    """A rule of the contract, and what breaks it; empty if it is kept."""
    return "" if ok else f"expected {rule}" + f", found {found}" * bool(found)


def names(count: int, get) -> list[str]:
    """The names of `count` items of a model, from `get(i)`; an item without one is `number I`."""
    return [get(i).name or f"number {i}" for i in range(count)]


def check_tree(spec: mujoco.MjSpec) -> None:
    """A free joint, hinges below it, and options; before anything is compiled."""
    _check_all(broken_tree(spec) + broken_options(spec))


def broken_tree(spec: mujoco.MjSpec) -> list[str]:
    """What is wrong with the joints of a file, in words."""
    return _all(_check_joints(spec))


def broken_options(spec: mujoco.MjSpec) -> list[str]:
    """What is wrong with a file's options, and what it has that no option allows, in words."""
    rules = _check_rigid, _check_flags, _check_gravity, _check_timestep
    return _all(*(rule(spec) for rule in rules))


def _check_joints(spec: mujoco.MjSpec) -> Broken:
    kinds = [mujoco.mjtJoint(j.type).name.removeprefix("mjJNT_").lower() for j in spec.joints]
    found = [
        f"{j.name or j.parent.name} ({kind})" for j, kind in zip(spec.joints, kinds, strict=True)
    ]
    rule = "a free joint on the base, before all other joints"
    yield _expect(kinds[:1] == ["free"], rule, [*found, "no joint"][0])
    odd = ", ".join(text for text in found[1:] if not text.endswith("(hinge)"))
    yield _expect(
        not odd, "hinge joints after the free one; make hinges of, or fix, all others", odd
    )
    yield _expect(len(found) > 1, "hinge joints", "none")


def _check_rigid(spec: mujoco.MjSpec) -> Broken:
    yield _expect(not spec.flexes, "rigid bodies only", f"{len(spec.flexes)} flex")
    yield _expect(not spec.plugins, "no plugins", f"{len(spec.plugins)}")


def _check_flags(of: mujoco.MjModel | mujoco.MjSpec) -> Broken:
    """A robot falls, stands on its feet and has joints with limits and motors."""
    off = _options(of).disableflags
    odd = [word for word, flag in NEEDED.items() if off & int(flag)]
    yield _expect(not odd, "no <flag> in <option> that disables what a robot needs", ", ".join(odd))


def _check_gravity(of: mujoco.MjModel | mujoco.MjSpec) -> Broken:
    gravity = _options(of).gravity
    rule = "gravity that points down (option gravity)"
    yield _expect(gravity[2] < 0, rule, " ".join(f"{x:g}" for x in gravity))


def _check_timestep(of: mujoco.MjModel | mujoco.MjSpec) -> Broken:
    (low, high), found = mjcf.TIMESTEP, _options(of).timestep
    yield _expect(low <= found <= high, f"a timestep of {low:g} to {high:g} s", f"{found:g}")


def _options(of: mujoco.MjModel | mujoco.MjSpec):
    return of.opt if isinstance(of, mujoco.MjModel) else of.option


def _check_state(model: mujoco.MjModel) -> Broken:
    """A robot's state is what the trainer keeps of it from one control step to the next."""
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    more = size - 1 - model.nq - model.nv
    rule = "no state beside positions and velocities (delays, activations)"
    yield _expect(not more, rule, f"{more} more numbers")
    yield _expect(not model.nplugin, "no plugins", f"{model.nplugin}")
    yield _expect(not model.nflex, "rigid bodies only", f"{model.nflex} flex")


def check_motors(model: mujoco.MjModel) -> None:
    """ValueError unless each joint has one plain motor."""
    _check_all(_all(_check_motors(model)))


def _check_motors(model: mujoco.MjModel) -> Broken:
    broken: dict[str, list[str]] = {}
    for i, joint in enumerate(names(model.njnt, model.joint)[1:]):
        for rule, found in _motor(model, i, joint):
            broken.setdefault(rule, []).append(found)
    for rule, every in broken.items():
        more = f" and {len(every) - MOST} more" * (len(every) > MOST)
        yield _expect(False, rule, ", ".join(every[:MOST]) + more)
    if MOTORS not in broken:
        yield _expect(model.nu == model.njnt - 1, MOTORS, f"{model.nu} actuators")
    yield _expect(
        not model.opt.disableactuator, "no motor disabled", "the option actuatorgroupdisable"
    )


def _motor(model: mujoco.MjModel, i: int, joint: str) -> Iterator[tuple[str, str]]:
    """`(rule, found)` of what is wrong with motor `i`, which should be that of `joint`."""
    if i >= model.nu:
        yield MOTORS, f"none for {joint}"
        return
    motor, to_joint = model.actuator(i), model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    on = names(model.njnt, model.joint)[motor.trnid[0]] if to_joint else "no joint"
    plain = motor.gear[0] * motor.gainprm[0] == 1 and not motor.dyntype[0]
    plain = plain and motor.biastype[0] == mujoco.mjtBias.mjBIAS_NONE
    if not motor.name == on == joint:
        yield MOTORS, f"{motor.name} on {on} as number {i + 1} where {joint} should be"
    elif not plain:
        yield MOTORS, f"{joint} of another gear, gain or kind"
    if model.actuator_history[i].any():
        yield "motors without a delay", f"one at {joint}"
    more = model.actuator_armature[i] or model.actuator_damping[i]
    if more or model.actuator_dampingpoly[i].any():
        yield "armature and damping at the joints, not at motors", f"some at {joint}"
    if motor.ctrllimited[0] or motor.forcelimited[0] or model.jnt_actfrclimited[i + 1]:
        yield "motors without limits, which are the config's", f"one at {joint}"


def _listed(model: mujoco.MjModel, ids) -> str:
    geoms = names(model.ngeom, model.geom)
    return ", ".join(geoms[i] for i in ids)


def _touching(model: mujoco.MjModel) -> np.ndarray:
    """The geoms that can touch the floor."""
    return np.flatnonzero(model.geom_conaffinity & 1)


def _shapes(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    return feet.named(names(model.ngeom, model.geom))


def _check_floor(model: mujoco.MjModel) -> Broken:
    floor = model.geom("floor")
    kind = mujoco.mjtGeom(floor.type[0]).name.removeprefix("mjGEOM_").lower()
    flat = kind == "plane" and not (floor.quat[1:3].any() or floor.pos[2] or floor.bodyid[0])
    found = f"type {kind}, pos {floor.pos}, quat {floor.quat}"
    yield _expect(flat, "the geom floor to be a plane at height 0 of the world", found)


def _check_contype(model: mujoco.MjModel) -> Broken:
    odd = [i for i in np.flatnonzero(model.geom_contype) if i != model.geom("floor").id]
    yield _expect(not odd, "contype 0 at every geom but the floor", _listed(model, odd))


def _check_whole_feet(model: mujoco.MjModel) -> Broken:
    shapes, foot_of, titles = _shapes(model)
    for foot, name in enumerate(titles):
        inside = {model.body(i).name for i in model.geom_bodyid[shapes[foot_of == foot]]}
        rule = f"the shapes of the foot {name} in one body; name the others differently"
        yield _expect(len(inside) == 1, rule, ", ".join(sorted(inside)))


def _check_one_foot(model: mujoco.MjModel) -> Broken:
    shapes, foot_of, _ = _shapes(model)
    bodies = model.geom_bodyid[shapes]
    crowded = [i for i in np.unique(bodies) if len(np.unique(foot_of[bodies == i])) > 1]
    found = ", ".join(f"more in {model.body(i).name}" for i in crowded)
    rule = "one foot in a body; the shapes of a foot are NAME_foot1, NAME_foot2, ..."
    yield _expect(not crowded, rule, found)


def _check_moving_feet(model: mujoco.MjModel) -> Broken:
    shapes = _shapes(model)[0]
    odd = _listed(model, shapes[model.geom_bodyid[shapes] <= model.jnt_bodyid[0]])
    yield _expect(not odd, "feet in bodies that joints move, not in the base", odd)


def _check_hold(model: mujoco.MjModel) -> Broken:
    """What lets feet stand."""
    shapes = _shapes(model)[0]
    weak = shapes[model.geom_priority[shapes] <= model.geom("floor").priority]
    yield _expect(not len(weak), "the feet of higher priority than the floor", _listed(model, weak))
    yield _expect(
        np.isin(shapes, _touching(model)).all(), "feet that touch the floor (conaffinity 1)"
    )


def _check_parts(model: mujoco.MjModel) -> Broken:
    touching = _touching(model)
    odd = _listed(model, touching[~np.isin(model.geom_type[touching], list(contacts.MOST))])
    yield _expect(not odd, f"parts of type box, sphere, capsule or cylinder, not {odd}")


def _check_touching(model: mujoco.MjModel) -> Broken:
    touching = _touching(model)
    odd = _listed(model, touching[model.geom_bodyid[touching] == 0])
    yield _expect(not odd, "what touches the floor (conaffinity) to be on the robot", odd)
    odd = _listed(model, touching[model.geom_condim[touching] > 3])
    yield _expect(not odd, "condim 1 or 3 where something touches the floor", odd)


def parts_of(model: mujoco.MjModel) -> np.ndarray:
    """The geoms [G] of a robot that must not touch the ground: all that can touch it, but the feet."""
    return np.setdiff1d(_touching(model), _shapes(model)[0])


def is_plain(name: str) -> bool:
    """Whether a policy's file may have this name of a robot or a joint."""
    return 0 < len(name) <= NAME and name.isprintable()


def _check_names(model: mujoco.MjModel) -> Broken:
    odd = [name for name in names(model.njnt, model.joint)[1:] if not is_plain(name)]
    rule = f"names of joints of at most {NAME} plain characters"
    yield _expect(not odd, rule, ", ".join(map(reprlib.repr, odd[:2])))


def _check_camera(model: mujoco.MjModel) -> Broken:
    yield _expect("track" in names(model.ncam, model.camera), "a camera named track")


def _check_home(model: mujoco.MjModel) -> Broken:
    """The default pose: on its feet, and on nothing else."""
    home, shapes, parts = model.key("home").qpos, _shapes(model)[0], parts_of(model)
    geoms = names(model.ngeom, model.geom)
    lowest = feet.lowest_points(model, home, shapes).min()
    yield _expect(abs(lowest) < 0.01, "the keyframe home with the lowest foot on the floor")
    under = feet.lowest_points(model, home, parts) < max(lowest, 0) + AT_FLOOR
    under = [geoms[i] for i in parts[under]]
    rule = "no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe home"
    yield _expect(not under, rule, ", ".join(under))

"""Checks the rules for a robot's file `robots/NAME/NAME.xml`; robots/README.md says how to keep them.

- one top-level body with a free joint: the base; on it four legs, each a chain of three bodies
  with one hinge joint each, named `LEG_...`, leg by leg, hip to knee, every joint with a range;
- at joint angles zero all frames are parallel: no `quat` in a leg, no `pos` at a joint;
- every body has its `inertial`; geoms of group 2 are looks and are left out of physics;
- one `motor` per joint, named and ordered as the joints, gear 1; `actuators.py` has PD and limits;
- four sphere geoms named `LEG_foot`, each in the last body of its leg, of higher priority than
  the floor, so that their friction holds;
- every other geom with `conaffinity` is a part that must not touch the ground: box, sphere,
  capsule or cylinder, on the robot; only the floor has a `contype`, so the robot never collides with
  itself, but for pairs in `contact`; a foot has none, for its friction is the geom's;
- the state is positions and velocities: no activations, no delays; no plugins, no flexes;
- a plane `floor` at height 0, a camera `track`, a keyframe `home`: the default pose, upright,
  the feet on the floor.

What else a file may have (equalities, tendons, springs, ...) is simulated by every engine that has it;
an engine that lacks it says so (engine.py). On a GPU it takes several times as long (warp/scope.py).
"""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.physics import contacts

LEGS, LEG_JOINTS = 4, 3
JOINTS = LEGS * LEG_JOINTS


def check(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """`(feet [F], parts [G])`, geom ids, of a compiled file that keeps the contract; else a
    ValueError that names the broken rule, and what was found."""
    _check_legs(model)
    _check_motors(model)
    _check_state(model)
    feet, parts = _check_geoms(model)
    _check_home(model, feet, parts)
    _expect("track" in names(model.ncam, model.camera), "a camera named track")
    return feet, parts


def _expect(ok, rule: str, found="") -> None:
    """Raise a ValueError naming the rule of the contract, and what breaks it."""
    if not ok:
        raise ValueError(f"expected {rule}" + f", found {found}" * bool(found))


def names(count: int, get) -> list[str]:
    """The names of `count` items of a model, from `get(i)`; an item without one is `number I`."""
    return [get(i).name or f"number {i}" for i in range(count)]


def check_file(spec: mujoco.MjSpec) -> None:
    """Check what MuJoCo's compiler accepts, or reports only by a consequence."""
    kinds = [mujoco.mjtJoint(j.type).name.removeprefix("mjJNT_").lower() for j in spec.joints]
    found = [f"{joint.name} ({kind})" for joint, kind in zip(spec.joints, kinds, strict=True)]
    rule = "a free joint on the base, before all other joints"
    _expect(kinds[:1] == ["free"], rule, [*found, "no joint"][0])
    top = [body.name for body in spec.worldbody.bodies]
    _expect(len(top) == 1, "one top-level body, the base", ", ".join(top))
    odd = ", ".join(text for text in found[1:] if not text.endswith("(hinge)"))
    rule = f"{JOINTS} hinge joints after the free one"
    _expect(not odd and len(found) == 1 + JOINTS, rule, odd or str(len(found) - 1))
    legs = [joint.name.partition("_")[0] for joint in spec.joints[1:]]
    each = [{*legs[i : i + LEG_JOINTS]} for i in range(0, JOINTS, LEG_JOINTS)]
    same = all(len(leg) == 1 for leg in each) and len({*legs}) == LEGS
    rule = "the three joints LEG_... of each of four legs in turn"
    _expect(same, rule, " ".join(joint.name for joint in spec.joints[1:]))
    for body in spec.bodies[1:]:
        _expect(body.joints, "links without a joint merged into their parent", body.name)
        _expect(body.explicitinertial, "an inertial in every body", f"none in {body.name}")
    keys = {key.name: len(key.qpos) for key in spec.keys}
    _expect("home" in keys, "a keyframe named home", ", ".join(keys) or "none")
    size = 7 + JOINTS
    _expect(keys["home"] == size, f"{size} numbers in the keyframe home", str(keys["home"]))


def _check_legs(model: mujoco.MjModel) -> None:
    """Each leg is three bodies in a chain, with the frames that `robot.legs` relies on."""
    for i in range(1, 1 + JOINTS):
        joint, body = model.joint(i), model.body(model.jnt_bodyid[i])
        parent = model.body(model.jnt_bodyid[0 if i % LEG_JOINTS == 1 else i - 1])
        rule = "each leg to be a chain of three bodies from the base, hip to knee"
        found = f"{body.name} in {model.body(body.parentid[0]).name}, not in {parent.name}"
        _expect(body.parentid[0] == parent.id, rule, found)
        rule = "leg bodies with frames parallel to the base's (no quat, no euler)"
        _expect(np.allclose(body.quat, [1, 0, 0, 0]), rule, f"{body.name} turned")
        rule = "joints without pos and ref: at their body's origin, zero where frames are parallel"
        _expect(not joint.pos.any() and not joint.qpos0[0], rule, joint.name)
        _expect(joint.limited[0], "a range at every joint", f"none at {joint.name}")


def _check_state(model: mujoco.MjModel) -> None:
    """A robot's state is what the trainer keeps of it from one control step to the next."""
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    more = size - 1 - model.nq - model.nv
    rule = "no state beside positions and velocities (delays, activations)"
    _expect(not more, rule, f"{more} more numbers")
    _expect(not model.nplugin, "no plugins", f"{model.nplugin}")
    _expect(not model.nflex, "rigid bodies only", f"{model.nflex} flex")


def _check_motors(model: mujoco.MjModel) -> None:
    joints = names(model.njnt, model.joint)
    rule = "one motor of gear 1 a joint, named and ordered as the joints"
    for i, joint in enumerate(joints[1:]):
        _expect(i < model.nu, rule, f"none for {joint}")
        motor, to_joint = model.actuator(i), model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        on = joints[motor.trnid[0]] if to_joint else "no joint"
        found = f"{motor.name} on {on} as number {i + 1} where {joint} should be"
        _expect(motor.name == on == joint, rule, found)
        plain = motor.gear[0] * motor.gainprm[0] == 1 and not motor.dyntype[0]
        plain = plain and motor.biastype[0] == mujoco.mjtBias.mjBIAS_NONE
        _expect(plain, rule, f"{joint} of another gear, gain or kind")
        more = model.actuator_armature[i] or model.actuator_damping[i]
        more = more or model.actuator_dampingpoly[i].any()
        _expect(not more, "armature and damping at the joints, not at motors", f"some at {joint}")
        limited = motor.ctrllimited[0] or motor.forcelimited[0] or model.jnt_actfrclimited[i + 1]
        _expect(not limited, "motors without limits, which are the config's", f"one at {joint}")
    _expect(model.nu == JOINTS, rule, f"{model.nu} actuators")
    _expect(not model.opt.disableactuator, "no motor disabled", "the option actuatorgroupdisable")


def _check_geoms(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """`(feet [F], parts [G])`: what touches the floor."""
    geoms = names(model.ngeom, model.geom)

    def listed(ids):
        return ", ".join(geoms[i] for i in ids)

    planes = listed(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE))
    _expect("floor" in geoms, "a geom named floor, not in group 2", planes or "no plane")
    floor = model.geom("floor")
    kind = mujoco.mjtGeom(floor.type[0]).name.removeprefix("mjGEOM_").lower()
    flat = kind == "plane" and not (floor.quat[1:3].any() or floor.pos[2] or floor.bodyid[0])
    found = f"type {kind}, pos {floor.pos}, quat {floor.quat}"
    _expect(flat, "the geom floor to be a plane at height 0 of the world", found)
    found = f"{floor.contype[0]} and {floor.conaffinity[0]}"
    _expect(found == "1 and 0", "the geom floor with contype 1 and conaffinity 0", found)
    odd = [i for i in np.flatnonzero(model.geom_contype) if i != floor.id]
    _expect(not odd, "contype 0 at every geom but the floor", listed(odd))

    touching = np.flatnonzero(model.geom_conaffinity & 1)
    feet = np.array([i for i, name in enumerate(geoms) if name.endswith("_foot")], int)
    rule = f"{LEGS} sphere geoms named LEG_foot"
    _expect(len(feet) == LEGS, rule, listed(feet) or "none outside group 2")
    for rule, kept in (
        ("the feet to be spheres", model.geom_type[feet] == contacts.SPHERE),
        ("the feet to touch the floor (conaffinity 1)", np.isin(feet, touching)),
        ("the feet of higher priority than the floor", model.geom_priority[feet] > floor.priority),
    ):
        _expect(kept.all(), rule, f"another {listed(feet[~kept])}")
    for joint in map(model.joint, range(LEG_JOINTS, 1 + JOINTS, LEG_JOINTS)):
        body, foot = model.body(joint.bodyid[0]), joint.name.partition("_")[0] + "_foot"
        inside = listed(feet[model.geom_bodyid[feet] == body.id])
        rule = "the foot geoms in the last body of each leg, in the order of the legs"
        _expect(inside == foot, rule, f"{inside or 'none'} in {body.name} where {foot} should be")

    odd = listed(
        touching[
            ~np.isin(
                model.geom_type[touching],
                (contacts.BOX, contacts.SPHERE, contacts.CAPSULE, contacts.CYLINDER),
            )
        ]
    )
    _expect(not odd, f"parts of type box, sphere, capsule or cylinder, not {odd}")
    odd = listed(touching[model.geom_bodyid[touching] == 0])
    _expect(not odd, "what touches the floor (conaffinity) to be on the robot", odd)
    paired = np.concatenate([model.pair_geom1, model.pair_geom2])
    odd = listed(feet[np.isin(feet, paired)])
    _expect(not odd, "no contact pair with a foot, whose friction is the geom's", odd)
    odd = listed(touching[model.geom_condim[touching] > 3])
    _expect(not odd, "condim 1 or 3 where something touches the floor", odd)
    return feet, np.setdiff1d(touching, feet)


def _check_home(model: mujoco.MjModel, feet: np.ndarray, parts: np.ndarray) -> None:
    """The default pose: within the joints' ranges, upright, on its feet."""
    home = model.key("home").qpos
    for i, angle in enumerate(home[7:], 1):
        joint, (low, high) = model.joint(i), model.jnt_range[i]
        found = f"{joint.name} at {angle:g}, outside {low:g} to {high:g}"
        _expect(low <= angle <= high, "the keyframe home within the joints' ranges", found)
    _expect(np.allclose(home[3:7], [1, 0, 0, 0]), "the keyframe home upright", f"quat {home[3:7]}")
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    lowest = (data.geom_xpos[feet, 2] - model.geom_size[feet, 0]).min()
    found = f"it at {lowest:.4f} m; the base belongs at {home[2] - lowest:.6g} m"
    _expect(abs(lowest) < 0.01, "the keyframe home with the lowest foot on the floor", found)
    fixed, linear, ring = contacts.floor_distance(model, parts)
    row = data.geom_xmat[parts][:, 6:]
    drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(np.maximum(1 - row[:, 2] ** 2, 0))
    under = [model.geom(i).name for i in parts[data.geom_xpos[parts, 2] < drop]]
    _expect(not under, "no part but the feet at the floor in the keyframe home", ", ".join(under))

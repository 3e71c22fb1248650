"""Which of our kernels computes a model whole, quadruped.py's or tree.py's, or why neither does.

An allow-list: MuJoCo's compiler makes a second model of only what the kernel of trees reads. A kernel takes
the given model if the two are equal, field by field, but for those of `HARMLESS`. So nothing is dropped in
silence: a tendon, a spring, a flag, and what a later MuJoCo adds, make the two differ. Such a model takes
MuJoCo Warp's own step (general.py), about seven times as long (1024 Go1 on an H200). The kernel of quadrupeds
is faster, and takes less. NumPy and C MuJoCo only, so `dynappo look` can ask where there is no GPU.
"""

from __future__ import annotations

import fnmatch
import re
from typing import Any

import mujoco
import numpy as np

from dynappo.description import contacts
from dynappo.description import robot as robot_lib
from dynappo.physics import ground as ground_lib
from dynappo.terrain.height_map import HeightMap

LEGS, LINKS = 4, 12  # of a quadruped: a base, and legs of three links, each with a hinge
JOINTS, POINTS = 32, 64  # of a tree, at most: a thread of a warp each; what fits into its memory
TOUCHING = {contacts.SPHERE: 1, contacts.CAPSULE: 2, contacts.BOX: 4}  # points of a tree's feet
# fields without a say in how a robot moves, as patterns
HARMLESS = (
    # looks, names, notes, what is only measured, poses to start from; and their sizes
    "cam_* light_* mat_* tex_* mesh_* hfield_* skin_* oct_* site_* text_* numeric_* tuple_* key_* name_* "
    "sensor_* *_user *_group *_rgba *_matid names names_map paths signature ncam nlight nmat ntex* nmesh* "
    "nhfield* nskin* noct npolygonmax nsite nnumeric* nuser* ntuple* nkey nname* npaths nsensor* "
    # where MuJoCo looks for contacts, and the memory that it takes
    "bvh_* *_bvhadr *_bvhnum nbvh* body_contype body_conaffinity narena nbuffer nconmax njmax "
    # of springs, dry friction, muscles, wind, overrides and sleep, which are looked at themselves
    "qpos_spring dof_solref dof_solimp actuator_lengthrange opt.wind opt.o_* opt.sleep_tolerance dof_length "
    "opt.noslip_tolerance opt.magnetic "
    # how MuJoCo finds its answer; our line search is exact, and shapes on a plane need none
    "opt.ls_tolerance opt.jacobian opt.ccd_* opt.sdf_* "
    # shortcuts where two frames are the same
    "*_sameframe body_simple dof_simplenum "
    # links that must not touch one another do not (robot_contract.py); `_rules` looks for the floor's
    "exclude_* nexclude"
).split()
OF_ALL_GEOMS = "geom_contype", "geom_conaffinity", "geom_bodyid"
# what a person calls it; the first that differs is the reason
WORDS = {
    "neq": "equality constraints",
    "ntendon": "tendons",
    "npair": "contact pairs",
    "geom_adhesion": "adhesion",
    "geom_surfacevel": "moving surfaces",
    "body_gravcomp": "gravity compensation",
    "jnt_stiffness": "springs at joints",
    "jnt_stiffnesspoly": "springs at joints",
    "jnt_margin": "margins of joint limits",
    "dof_frictionloss": "dry friction",
    "dof_damping": "damping of the base",
    "dof_dampingpoly": "nonlinear damping",
    "geom_type": "feet that are no spheres, capsules or boxes",
    "geom_condim": "feet of another condim",
    "geom_margin": "contact margins",
    "geom_gap": "contact gaps",
    "geom_conaffinity": "contacts of parts that are no feet, as with physics.contacts=full",
    "actuator_gear": "a gear",
    "opt.gravity": "gravity that is not vertical",
    "opt.density": "air or water",
    "opt.viscosity": "air or water",
    "opt.integrator": "another integrator than Euler",
    "opt.cone": "another cone than the pyramidal one",
    "opt.solver": "another solver than Newton",
    "opt.noslip_iterations": "the noslip solver",
    "opt.disableflags": "flags that disable",
    "opt.enableflags": "flags that enable",
}


def kernel(model: mujoco.MjModel, feet: np.ndarray, every_substep: bool) -> str:
    """Which kernel computes a model that keeps the contract: "quadruped", "tree", or "" for neither.

    `feet` are the geom ids of their shapes. `every_substep`: parts at the ground are wanted
    of each physics step.
    """
    if declines(model, feet):
        return ""
    return "tree" if no_quadruped(model, feet, every_substep) else "quadruped"


def declines(model: mujoco.MjModel, feet: np.ndarray) -> str:
    """What no kernel of ours computes of a model that keeps the contract; "" if nothing."""
    if model.njnt - 1 > JOINTS:
        return f"more than {JOINTS} joints"
    kinds = model.geom_type[feet].tolist()
    if sum(TOUCHING.get(kind, 0) for kind in kinds) > POINTS:
        return f"feet with more than {POINTS} points of contact"
    base = model.body_weldid[model.jnt_bodyid[0]]
    if (model.body_weldid[model.geom_bodyid[feet]] == base).any():
        return "feet that no joint moves"
    touching = [model.geom("floor").id, *feet]  # of other geoms it matters only that they do not
    expects = fields(_plain(model, feet))
    for name, found in fields(model).items():
        expected = expects[name]
        if name.startswith("geom_") and name not in OF_ALL_GEOMS:
            found, expected = found[touching], expected[touching]
        if not _equal(found, expected):
            return f"{WORDS[name]} ({name})" if name in WORDS else name
    return _rules(model, feet)


def no_quadruped(model: mujoco.MjModel, feet: np.ndarray, every_substep: bool) -> str:
    """What the kernel of trees computes of a model, but that of quadrupeds does not; "" if nothing."""
    last = np.arange(1 + LINKS // LEGS, 2 + LINKS, LINKS // LEGS)  # bodies of the legs, leg by leg
    parents = [0 if i == 1 else 1 if i % 3 == 2 else i - 1 for i in range(1, 2 + LINKS)]
    same = (model.nbody, model.njnt) == (2 + LINKS, 1 + LINKS)
    same = same and np.array_equal(model.body_parentid[1:], parents)
    same = same and np.array_equal(model.jnt_bodyid, np.arange(1, 2 + LINKS))
    if not (same and np.array_equal(model.geom_bodyid[feet], last)):
        return f"other limbs than {LEGS} legs of {LINKS // LEGS} joints, with a sphere as foot"
    odd = {
        "turned frames": not _equal(model.body_quat[2:], np.eye(4)[[0] * LINKS]),
        "joints beside their link's origin": model.jnt_pos.any(),
        "a joint's ref": model.qpos0[7:].any(),
        "joints without a range": not model.jnt_limited[1:].all(),
        "armature of the base": model.dof_armature[:6].any(),
        "feet that are no spheres": (model.geom_type[feet] != contacts.SPHERE).any(),
        "contacts of parts, wanted of each physics step (task.remember_ground)": every_substep,
    }
    return next((words for words, found in odd.items() if found), "")


def slower(robot: robot_lib.Robot, physics, ground: HeightMap | None = None) -> str:
    """A line on a robot that on a GPU needs MuJoCo Warp's own step on a `ground`, and why; "" if a kernel of
    ours does it. `physics` is the config's group."""
    reason = declines(ground_lib.model(robot, physics, ground), robot.feet)
    return reason and (
        f"{robot.xml}: because of {reason}, physics on a GPU are MuJoCo Warp's own step, which takes "
        "several times as long as a kernel of ours"
    )


def fields(model: mujoco.MjModel) -> dict[str, Any]:
    """All of a model that may decide how it moves, `WORDS` first: counts, flags, arrays, options."""
    found = {
        f"{prefix}{name}": getattr(of, name)
        for prefix, of in (("", model), ("opt.", model.opt))
        for name in dir(of)
        if not name.startswith("_")
    }
    harmless = re.compile("|".join(map(fnmatch.translate, HARMLESS))).match
    found = {
        n: value
        for n, value in found.items()
        if not callable(value) and n not in ("opt", "vis", "stat") and not harmless(n)
    }
    return {name: found[name] for name in (*(n for n in WORDS if n in found), *found)}


def _equal(found, expected) -> bool:
    """Whether two arrays are equal, up to the rounding of a quaternion that is compiled twice."""
    found, expected = np.asarray(found), np.asarray(expected)
    if found.dtype.kind not in "biuf" or found.shape != expected.shape:
        return found.shape == expected.shape and bool((found == expected).all())
    return np.allclose(found, expected, rtol=1e-6, atol=1e-9)


def _plain(model: mujoco.MjModel, feet: np.ndarray) -> mujoco.MjModel:
    """A model of what tree.py reads of `model`, and of nothing else."""
    spec, floor = mujoco.MjSpec(), model.geom("floor").id
    spec.compiler.degree = False
    for name in ("timestep", "tolerance", "impratio", "iterations", "ls_iterations"):
        setattr(spec.option, name, getattr(model.opt, name))
    spec.option.gravity = [0, 0, model.opt.gravity[2]]
    bodies = [spec.worldbody]
    for i in range(1, model.nbody):
        body = bodies[model.body_parentid[i]].add_body(
            pos=model.body_pos[i],
            quat=model.body_quat[i],
            mass=model.body_mass[i],
            ipos=model.body_ipos[i],
            iquat=model.body_iquat[i],
            inertia=model.body_inertia[i],
            explicitinertial=True,
        )
        bodies.append(body)
        first = model.body_jntadr[i]
        for joint in range(first, first + model.body_jntnum[i]):
            _add_joint(spec, body, model, joint)
    sphere, ground = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_PLANE
    if _rough(model):  # whatever its heights, which are in an array of the kernel's own (ground.h)
        ground, (rows, columns) = (
            mujoco.mjtGeom.mjGEOM_HFIELD,
            (model.hfield_nrow[0], model.hfield_ncol[0]),
        )
        heights = np.zeros(rows * columns)
        spec.add_hfield(
            name="floor", nrow=rows, ncol=columns, size=model.hfield_size[0], userdata=heights
        )
    for i, body in enumerate(model.geom_bodyid):
        geom = bodies[body].add_geom(
            type=ground if i == floor else sphere, size=[1, 1, 1], mass=0, contype=0, conaffinity=0
        )
        if i == floor and _rough(model):
            geom.hfieldname = "floor"
        if i != floor and i not in feet:
            continue
        if model.geom_type[i] in TOUCHING:
            geom.type = mujoco.mjtGeom(model.geom_type[i])
        # the feet's priority is higher (robot_contract.py): of the floor's numbers none counts
        geom.contype, geom.conaffinity = int(i == floor), int(i != floor)
        geom.condim = model.geom_condim[i] if i == floor else 3
        for name in ("pos", "quat", "size", "friction", "solref", "solimp", "solmix", "priority"):
            setattr(geom, name, getattr(model, f"geom_{name}")[i])
    return spec.compile()


def _add_joint(spec: mujoco.MjSpec, body, model: mujoco.MjModel, joint: int) -> None:
    """To the plain model: the base's free joint, or a hinge with its motor."""
    dof = model.jnt_dofadr[joint]
    if joint == 0:
        body.add_joint(type=mujoco.mjtJoint.mjJNT_FREE, armature=model.dof_armature[dof])
        return
    limits = mujoco.mjtLimited
    body.add_joint(
        name=str(joint),
        type=mujoco.mjtJoint.mjJNT_HINGE,
        pos=model.jnt_pos[joint],
        axis=model.jnt_axis[joint],
        ref=model.qpos0[model.jnt_qposadr[joint]],
        range=model.jnt_range[joint],
        limited=limits.mjLIMITED_TRUE if model.jnt_limited[joint] else limits.mjLIMITED_FALSE,
        armature=model.dof_armature[dof],
        damping=[model.dof_damping[dof], 0, 0],
        solref_limit=model.jnt_solref[joint],
        solimp_limit=model.jnt_solimp[joint],
    )
    motor = spec.add_actuator(name=str(joint), target=str(joint), trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_motor()


def _rules(model: mujoco.MjModel, feet: np.ndarray) -> str:
    """As `declines`, for numbers that a kernel reads, but of which it takes only some values."""
    if _rough(model) and (model.geom_type[feet] == contacts.BOX).any():
        return "feet that are boxes, on ground that is not flat"  # an edge of the ground between its corners
    if (model.jnt_solref[1:] <= 0).any() or (model.geom_solref[feet] <= 0).any():
        return "solref as stiffness and damping (negative)"
    if ((model.exclude_signature >> 16) * (model.exclude_signature & 0xFFFF) == 0).any():
        return "an exclude of the floor (exclude_signature)"
    return ""


def _rough(model: mujoco.MjModel) -> bool:
    """Whether the floor is a height map (ground.py)."""
    return model.geom_type[model.geom("floor").id] == mujoco.mjtGeom.mjGEOM_HFIELD

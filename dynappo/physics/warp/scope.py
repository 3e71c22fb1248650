"""Which models the kernel of quadruped.py computes whole; `declines` names what it cannot compute.

An allow-list: MuJoCo's compiler makes a second model of only what the kernel reads. The kernel takes the
given model if the two are equal, field by field, but for those of `HARMLESS`. So it drops nothing in
silence: a tendon, a spring, a flag, and what a later MuJoCo adds, make the two differ. Such a model takes
MuJoCo Warp's own step (general.py), about seven times as long (1024 Go1 on an H200). NumPy and C MuJoCo
only, so `dynappo look` can ask where there is no GPU.
"""

from __future__ import annotations

import fnmatch
import re
from typing import Any

import mujoco
import numpy as np

from dynappo.description import robot as robot_lib

LEGS, LINKS = 4, 12  # of the kernel's robot: a base, and legs of three links, each with a hinge
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
    # how MuJoCo finds its answer; the kernel's line search is exact, and a sphere on a plane needs none
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
    "body_parentid": "limbs that are not chains of three links from the base",
    "jnt_bodyid": "several joints in a link",
    "body_quat": "turned frames",
    "jnt_pos": "joints beside their link's origin",
    "qpos0": "a joint's ref",
    "jnt_limited": "joints without a range",
    "geom_adhesion": "adhesion",
    "geom_surfacevel": "moving surfaces",
    "body_gravcomp": "gravity compensation",
    "jnt_stiffness": "springs at joints",
    "jnt_stiffnesspoly": "springs at joints",
    "jnt_margin": "margins of joint limits",
    "dof_frictionloss": "dry friction",
    "dof_damping": "damping of the base",
    "dof_dampingpoly": "nonlinear damping",
    "dof_armature": "armature of the base",
    "geom_type": "feet that are no spheres",
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


def declines(model: mujoco.MjModel, feet: np.ndarray, every_substep: bool) -> str:
    """What the kernel does not compute of a model that keeps the contract; "" if nothing.

    `feet` are the geom ids of their shapes. `every_substep`: parts at the ground are wanted
    of each physics step.
    """
    last = np.arange(1 + LINKS // LEGS, 2 + LINKS, LINKS // LEGS)  # bodies of the legs, leg by leg
    same = (model.nbody, model.njnt) == (2 + LINKS, 1 + LINKS)
    if not (same and np.array_equal(model.geom_bodyid[feet], last)):
        return f"other limbs than {LEGS} legs of {LINKS // LEGS} joints, with a sphere as foot"
    touching = [model.geom("floor").id, *feet]  # of other geoms it matters only that they do not
    expects = fields(_plain(model, feet))
    for name, found in fields(model).items():
        expected = expects[name]
        if name.startswith("geom_") and name not in OF_ALL_GEOMS:
            found, expected = found[touching], expected[touching]
        if not _equal(found, expected):
            return f"{WORDS[name]} ({name})" if name in WORDS else name
    return _rules(model, feet, every_substep)


def slower(robot: robot_lib.Robot, physics, every_substep: bool) -> str:
    """A line on a robot that on a GPU needs MuJoCo Warp's own step, and why; "" if the kernel
    does it. `physics` is the config's group."""
    reason = declines(robot_lib.physics_model(robot, physics), robot.feet, every_substep)
    return reason and (
        f"{robot.xml}: because of {reason}, physics on a GPU are MuJoCo Warp's own step, which takes "
        "several times as long as the kernel for quadrupeds"
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
    """A model of what the kernel reads of `model`, and of nothing else (quadruped.constants)."""
    spec, floor = mujoco.MjSpec(), model.geom("floor").id
    spec.compiler.degree = False
    for name in ("timestep", "tolerance", "impratio", "iterations", "ls_iterations"):
        setattr(spec.option, name, getattr(model.opt, name))
    spec.option.gravity = [0, 0, model.opt.gravity[2]]
    bodies = [spec.worldbody]
    for i in range(1, 2 + LINKS):
        parent = bodies[0 if i == 1 else 1 if i % 3 == 2 else i - 1]
        body = parent.add_body(
            pos=model.body_pos[i],
            mass=model.body_mass[i],
            ipos=model.body_ipos[i],
            iquat=model.body_iquat[i],
            inertia=model.body_inertia[i],
            explicitinertial=True,
        )
        bodies.append(body)
        if i == 1:
            body.quat = model.body_quat[i]
            body.add_freejoint()
            continue
        joint, dof = i - 1, i + 4
        body.add_joint(
            name=str(joint),
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=model.jnt_axis[joint],
            range=model.jnt_range[joint],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            armature=model.dof_armature[dof],
            damping=[model.dof_damping[dof], 0, 0],
            solref_limit=model.jnt_solref[joint],
            solimp_limit=model.jnt_solimp[joint],
        )
        spec.add_actuator(
            name=str(joint), target=str(joint), trntype=mujoco.mjtTrn.mjTRN_JOINT
        ).set_to_motor()
    sphere, plane = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_PLANE
    for i, body in enumerate(model.geom_bodyid):
        geom = bodies[body].add_geom(
            type=plane if i == floor else sphere, size=[1, 1, 1], mass=0, contype=0, conaffinity=0
        )
        if i != floor and i not in feet:
            continue
        # the feet's priority is higher (robot_contract.py): of the floor's numbers none counts
        geom.contype, geom.conaffinity = int(i == floor), int(i != floor)
        geom.condim = model.geom_condim[i] if i == floor else 3
        for name in ("pos", "quat", "size", "friction", "solref", "solimp", "solmix", "priority"):
            setattr(geom, name, getattr(model, f"geom_{name}")[i])
    return spec.compile()


def _rules(model: mujoco.MjModel, feet: np.ndarray, every_substep: bool) -> str:
    """As `declines`, for numbers that the kernel reads, but of which it takes only some values."""
    if (model.jnt_solref[1:] <= 0).any() or (model.geom_solref[feet] <= 0).any():
        return "solref as stiffness and damping (negative)"
    if ((model.exclude_signature >> 16) * (model.exclude_signature & 0xFFFF) == 0).any():
        return "an exclude of the floor (exclude_signature)"
    return "contacts of parts, wanted of each physics step (task.remember_ground)" * every_substep

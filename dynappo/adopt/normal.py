"""Brings a completed robot into the form that dynappo trains: solver, feet, joints, frames, a scene."""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.adopt import gains
from dynappo.adopt.source import Published
from dynappo.description import feet as feet_lib
from dynappo.description import joints as joints_lib
from dynappo.description import robot as robot_lib
from dynappo.description.rotation import matrix, quaternion

HEAVY_MASS = 30.0  # kg, from which on feet creep apart with impratio 1
FOOT_FRICTION = 0.8  # of the feet, which `task.randomize.friction` assumes
FIRM_SOLIMP = 0.9, 0.95  # solimp of the feet: with Menagerie's 0.015 they sink in and slide apart
SOFTEST_SOLIMP = 0.8  # its first number; feet that have less are made firm
UNLIMITED_RANGE = 9.42  # rad to both sides, of a joint without a range
SHANK_CLEARANCE = 1.1  # of a foot's radius: shanks end so far above its middle
PART_HEIGHT = 0.01  # m above the ground, where parts end that would touch it
LYING_BELOW = 0.7  # of its height in the default pose: a lower robot lies
JOINTS, JOINT = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtWrap.mjWRAP_JOINT
BOX, SPHERE, CAPSULE = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
)


def solver(spec: mujoco.MjSpec, mass: float) -> list[str]:
    """Set the solver of the bundled robots; a line on each option that was different."""
    option, notes = spec.option, []
    wanted = dict(
        integrator=mujoco.mjtIntegrator.mjINT_EULER,
        cone=mujoco.mjtCone.mjCONE_PYRAMIDAL,
        solver=mujoco.mjtSolver.mjSOL_NEWTON,
        impratio=3.0 if mass > HEAVY_MASS else 1.0,
    )
    changed = [name for name, value in wanted.items() if getattr(option, name) != value]
    for name, value in wanted.items():
        setattr(option, name, value)
    option.timestep, option.iterations, option.ls_iterations = gains.TIMESTEP, 4, 8
    if changed:
        ratio = f", impratio {wanted['impratio']:g}"
        notes.append(
            f"solver: Newton, Euler, pyramidal cone{ratio}; the file has another {', '.join(changed)}"
        )
    return notes


def joints(
    spec: mujoco.MjSpec, names: tuple[str, ...], published: Published, effort: np.ndarray
) -> list[str]:
    """Take out dry friction and a servo's damping, add the inertia of rotors; a line on each."""
    notes, dry, servo, rotors, endless = [], [], [], [], []
    widths = [float(np.ptp(spec.joint(name).range)) for name in names]
    if 0 < max(widths) < joints_lib.TURN_AS_DEGREES:
        notes.append(
            f"EDIT NEEDED: no joint turns by more than {max(widths):.2g} rad, so the file's angles seem to "
            'be radians that are read as degrees; write <compiler angle="radian"/> into it, and adopt it '
            "again with --force"
        )
    for name, is_servo, most in zip(names, published.servo, effort, strict=True):
        joint = spec.joint(name)
        if joint.frictionloss:
            dry.append(float(joint.frictionloss))
            joint.frictionloss = 0.0
        if is_servo and np.any(joint.damping):
            servo.append(float(joint.damping[0]))
            joint.damping = np.zeros_like(joint.damping)
        if joint.limited == mujoco.mjtLimited.mjLIMITED_FALSE or not np.any(joint.range):
            joint.range, joint.limited = (
                [-UNLIMITED_RANGE, UNLIMITED_RANGE],
                mujoco.mjtLimited.mjLIMITED_TRUE,
            )
            endless.append(name)
        joint.actfrcrange, joint.margin = [0, 0], 0
        if not joint.armature:
            rotors.append(float(f"{gains.ROTOR_INERTIA * most:.2g}"))
            joint.armature = rotors[-1]
    if dry:
        notes.append(
            f"joints: dry friction of {gains.span(np.array(dry))} N m left out, which takes a slower engine; "
            "task.randomize.joint_friction has it for real robots"
        )
    if servo:
        notes.append(
            f"joints: damping of {gains.span(np.array(servo))} N m s/rad left out; in a file for "
            "servos it is the servo's, and kd takes its place"
        )
    if endless:
        notes.append(
            f"joints: no range at {len(endless)} of {len(names)}; +-{UNLIMITED_RANGE:g} rad"
        )
    if rotors:
        notes.append(
            f"joints: no armature in the file; {gains.span(np.array(rotors))} kg m^2, "
            f"{gains.ROTOR_INERTIA:g} for each N m of effort"
        )
    return notes


def frames(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """Turn the links' frames until all are parallel to the base's where the joints are at rest; a line if
    any was turned.

    It changes no motion, and the one-kernel physics needs it. With R the rotation of a link's frame in
    the base's: offsets, axes and inertias x become R x, and what is in the link is turned by R. Frames stay
    where spatial tendons or equality constraints have places in them; no such robot takes that physics
    anyway. Fixed tendons are sums of joint angles, which stay.
    """
    held = [
        tendon.name or "a tendon"
        for tendon, first in zip(spec.tendons, model.tendon_adr, strict=True)
        if model.wrap_type[first] != JOINT
    ]
    held += [e.name or "an equality" for e in spec.equalities if e.type != JOINTS]
    if held:
        return [f"frames: as in the file, for {', '.join(held[:4])} has places in them"]
    turned, rotation = False, {1: np.eye(3)}
    for i in range(1, model.nbody):
        body, parent = spec.body(model.body(i).name), int(model.body_parentid[i])
        if i > 1:
            rotation[i] = rotation[parent] @ matrix(model.body_quat[i])
            body.pos = rotation[parent] @ model.body_pos[i]
            turned |= not np.allclose(rotation[i], np.eye(3), atol=1e-9)
        body.quat = [1, 0, 0, 0]
        if np.allclose(rotation[i], np.eye(3), atol=1e-9):
            continue
        body.explicitinertial, body.mass = True, model.body_mass[i]
        body.ipos = rotation[i] @ model.body_ipos[i]
        body.iquat = quaternion(rotation[i] @ matrix(model.body_iquat[i]))
        body.inertia, body.fullinertia = model.body_inertia[i], np.full(6, np.nan)
        for joint in body.joints:
            joint.pos, joint.axis = rotation[i] @ joint.pos, rotation[i] @ joint.axis
        for geom in body.geoms:
            geom.pos = rotation[i] @ model.geom_pos[geom.id]
            geom.quat = quaternion(rotation[i] @ matrix(model.geom_quat[geom.id]))
        for thing in (*body.sites, *body.cameras, *body.lights):
            spec.delete(thing)
    return ["frames: turned until all are parallel to the base's, which changes no motion"] * turned


def feet(spec: mujoco.MjSpec) -> list[str]:
    """Make feet firm, with the friction of training and no margins; a line on what was different."""
    soft, slippery, margins = [], [], []
    for geom in spec.geoms:
        if geom.margin or geom.gap:
            margins.append(float(geom.margin))
            geom.margin = geom.gap = 0.0
        if not feet_lib.NAME.fullmatch(geom.name):
            continue
        if geom.solimp[0] < SOFTEST_SOLIMP:
            soft.append(float(geom.solimp[0]))
            geom.solimp = [*FIRM_SOLIMP, max(float(np.max(geom.size)), 0.01), 0.5, 2.0]
            geom.solref = [0.02, 1.0]
        if geom.friction[0] != FOOT_FRICTION:
            slippery.append(float(geom.friction[0]))
            geom.friction = [FOOT_FRICTION, *geom.friction[1:]]
    notes = []
    if margins:
        notes.append(f"shapes: contact margins of {gains.span(np.array(margins))} m left out")
    if soft:
        notes.append(
            f"feet: solimp {FIRM_SOLIMP[0]:g} {FIRM_SOLIMP[1]:g} instead of {gains.span(np.array(soft))}, "
            "with which they sink in"
        )
    if slippery:
        notes.append(
            f"feet: friction {FOOT_FRICTION:g}, which task.randomize.friction assumes; in the file "
            f"{gains.span(np.array(slippery))}"
        )
    return notes


def round_feet(spec: mujoco.MjSpec, robot: robot_lib.Robot) -> list[str]:
    """Short capsules that are a foot alone become spheres, for the fastest engine; a line if any did.

    The sphere is the capsule's end that is lower in the default pose, so the foot stands where it stood.
    """
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(model, data)
    geoms, done = {geom.id: geom for geom in spec.geoms}, 0
    for foot in robot.feet:
        radius, half, _ = model.geom_size[foot]
        if (
            model.geom_type[foot] != CAPSULE
            or half > radius
            or len(robot.feet) > len(robot.foot_names)
        ):
            continue
        down = -half if data.geom_xmat[foot][8] > 0 else half
        geom, axis = geoms[int(foot)], matrix(model.geom_quat[foot])[:, 2]
        geom.type, geom.size = SPHERE, [radius, 0, 0]
        geom.pos = model.geom_pos[foot] + down * axis
        done += 1
    return [f"feet: {done} short capsules are spheres, which the fastest engine has"] * bool(done)


def shanks(spec: mujoco.MjSpec, robot: robot_lib.Robot) -> list[str]:
    """Shorten shapes that reach down to a foot's middle; a line if any was.

    A foot gives way under load, and these shapes must not touch the ground before it. If the feet are
    spheres: a capsule, cylinder or box in the foot's body, along its longest axis.
    """
    model, cut = robot.mj_model, []
    geoms = {geom.id: geom for geom in spec.geoms}
    for foot in robot.feet:
        if model.geom_type[foot] != SPHERE:
            return []
        middle, radius = model.geom_pos[foot], model.geom_size[foot, 0]
        for part in robot.parts:
            kind, size = model.geom_type[part], model.geom_size[part].copy()
            if model.geom_bodyid[part] != model.geom_bodyid[foot] or kind == SPHERE:
                continue
            along = int(size.argmax()) if kind == BOX else 2
            half = size[along] if kind == BOX else size[1]
            axis = matrix(model.geom_quat[part])[:, along]
            axis = axis * (1 if axis @ (middle - model.geom_pos[part]) > 0 else -1)
            cap = size[0] if kind == CAPSULE else 0.0
            end = axis @ (model.geom_pos[part] - middle) + half + cap  # past the foot's middle
            less = end + SHANK_CLEARANCE * radius
            aside = np.linalg.norm(
                (middle - model.geom_pos[part]) - axis * (axis @ (middle - model.geom_pos[part]))
            )
            if less <= 0 or aside > 2 * radius or less >= 2 * half - 0.01:
                continue
            size[along if kind == BOX else 1] = half - less / 2
            geoms[part].size, geoms[part].pos = size, model.geom_pos[part] - axis * less / 2
            geoms[part].quat = model.geom_quat[part]
            cut.append(less)
    if not cut:
        return []
    return [
        f"shapes: {len(cut)} that reach a foot end {SHANK_CLEARANCE:g} of its radius above its middle"
    ]


def clear(spec: mujoco.MjSpec, robot: robot_lib.Robot, poses: np.ndarray) -> list[str]:
    """Shorten parts that touch the ground in the standing robot's `poses` [T, nq]; a line on each.

    A capsule, cylinder or box loses what is below `PART_HEIGHT` at the end of its longest axis. A part that
    would lose more than half stays, and its line says so. A robot that lies down stays as it is.
    """
    if poses[:, 2].min() < LYING_BELOW * robot.home_qpos[2]:
        return []
    model, data, notes = robot.mj_model, mujoco.MjData(robot.mj_model), []
    geoms, alike = {geom.id: geom for geom in spec.geoms}, {}
    heights = np.array([feet_lib.lowest_points(model, qpos, robot.parts) for qpos in poses])
    for i, part in enumerate(robot.parts):
        shape = int(model.geom_type[part]), tuple(model.geom_size[part].round(6))
        alike.setdefault(shape, []).append(i)
    for (kind, _), those in alike.items():  # legs stay alike
        i = those[heights[:, those].min(0).argmin()]
        low, data.qpos[:] = heights[:, i].min(), poses[heights[:, i].argmin()]
        if low > 0:
            continue
        mujoco.mj_kinematics(model, data)
        size, ends = model.geom_size[robot.parts[i]].copy(), {}
        along = int(size.argmax()) if kind == BOX else 1
        for part in robot.parts[those]:
            axis = matrix(model.geom_quat[part])[:, along if kind == BOX else 2]
            ends[part] = axis, data.xmat[model.geom_bodyid[part]].reshape(3, 3)[2] @ axis
        less = (PART_HEIGHT - low) / max(abs(ends[robot.parts[i]][1]), 1e-6)
        names = [model.geom(p).name or model.body(model.geom_bodyid[p]).name for p in ends]
        if kind == SPHERE or less > size[along]:
            notes.append(
                f"EDIT NEEDED: {names[those.index(i)]}, a part that is no foot, touches the ground as the "
                "robot stands; raise task.kp, make it smaller, or change the default pose"
            )
            continue
        size[along] -= less / 2
        for part, (axis, down) in ends.items():
            geoms[part].size, geoms[part].quat = size, model.geom_quat[part]
            geoms[part].pos = model.geom_pos[part] + np.sign(down) * axis * less / 2
        notes.append(
            f"shapes: {less * 1e3:.0f} mm shorter, for they touch the ground as the robot stands: "
            f"{', '.join(names)}"
        )
    return notes


def scene(spec: mujoco.MjSpec, height: float) -> None:
    """Sky, light and a floor of tiles, as the robots here have them; `height` (m) is the base's."""
    for light in list(spec.lights):
        spec.delete(light)
    look = spec.visual
    look.global_.offwidth, look.global_.offheight = 1280, 720
    look.headlight.ambient, look.headlight.diffuse = [0.42, 0.42, 0.44], [0.26, 0.26, 0.26]
    look.headlight.specular = [0.05, 0.05, 0.05]
    look.quality.shadowsize, look.quality.offsamples = 4096, 8
    look.map.znear, look.map.zfar, look.map.shadowclip = 0.02, 50, 4
    look.rgba.haze = [0.80, 0.85, 0.90, 1]
    spec.stat.center, spec.stat.extent = [0, 0, 0.75 * height], 2.5 * height
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2, sky.width, sky.height = [0.86, 0.90, 0.94], [0.42, 0.55, 0.70], 256, 1536
    tiles = spec.add_texture(name="checker", type=mujoco.mjtTexture.mjTEXTURE_2D)
    tiles.builtin, tiles.mark = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, mujoco.mjtMark.mjMARK_EDGE
    tiles.rgb1, tiles.rgb2 = [0.80, 0.82, 0.84], [0.74, 0.76, 0.78]
    tiles.markrgb, tiles.width, tiles.height = [0.87, 0.89, 0.91], 512, 512
    floor = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True)
    floor.specular, floor.shininess = 0.1, 0.1
    floor.textures = ["", "checker", *[""] * 8]  # the second is the colour
    for geom in spec.worldbody.geoms:
        if geom.name == "floor":
            geom.material = "floor"
    light = spec.worldbody.add_light(name="sun", pos=[1.5, -1, 3.5], dir=[-0.4, 0.25, -1])
    light.type, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, True
    light.diffuse, light.specular = [0.55, 0.55, 0.52], [0.2, 0.2, 0.2]

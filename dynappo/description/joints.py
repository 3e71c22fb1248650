"""A robot's joints in a file that `complete` completes: their names, numbers and ranges, and their motors."""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.description import robot_contract

OFF = mujoco.mjtLimited.mjLIMITED_FALSE
FREE, HINGE = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE
TURN_AS_DEGREES = 2 * np.pi * np.pi / 180  # rad: a whole turn in radians that is read as degrees


def names(spec: mujoco.MjSpec) -> None:
    """Every hinge has a name."""
    taken = {joint.name for joint in spec.joints}
    for body in spec.bodies:
        for i, joint in enumerate(body.joints):
            if joint.type != HINGE or joint.name:
                continue
            name = f"{body.name or 'body'}_joint" + f"{i}" * (len(body.joints) > 1)
            while name in taken:
                name += "_"
            joint.name = name
            taken.add(name)


def sizes(body) -> list[tuple[str, int]]:
    """`(joint, numbers in qpos)` of a body and all below, in the order of a keyframe."""
    size = {FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    found = [(joint.name, size.get(joint.type, 1)) for joint in body.joints]
    return found + [one for child in body.bodies for one in sizes(child)]


def ranges(model: mujoco.MjModel) -> np.ndarray:
    """The range [A, 2] of each hinge, rad; infinite where it has no limits."""
    limited = model.jnt_limited[1:, None].astype(bool)
    return np.where(limited, model.jnt_range[1:], [-np.inf, np.inf])


def motors(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """One plain motor for each joint; an actuator's share of a joint's inertia and damping stays."""
    try:
        robot_contract.check_motors(model)
        return False
    except ValueError:
        pass
    had = len(spec.actuators)
    for i, actuator in enumerate(model.actuator_trnid[:, 0]):
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint, gear = spec.joint(model.joint(actuator).name), model.actuator_gear[i, 0]
        joint.armature += gear**2 * model.actuator_armature[i]
        damping = [model.actuator_damping[i], *model.actuator_dampingpoly[i]]
        joint.damping = joint.damping + gear**2 * np.array(damping)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for key in spec.keys:
        key.ctrl, key.act = [], []
    for i in range(1, model.njnt):
        name = model.joint(i).name
        joint = spec.joint(name)
        joint.actfrclimited, joint.actfrcrange = OFF, [0, 0]
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.gear, motor.armature, motor.damping = [1, 0, 0, 0, 0, 0], 0, [0, 0, 0]
        # of the file's defaults
        motor.ctrllimited = motor.forcelimited = motor.actlimited = OFF
        motor.ctrlrange, motor.forcerange, motor.actrange = [0, 0], [0, 0], [0, 0]
        motor.delay, motor.nsample, motor.group = 0, 0, 0
    spec.option.disableactuator = 0
    what = f"{had} actuators are replaced by" if had else "there are no actuators, but now"
    notes.append(f"{what} one motor a joint; gains and limits are the config's")
    return True

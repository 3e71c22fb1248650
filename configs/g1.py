"""Unitree G1 with 29 joints, flat ground, velocity commands.

    python -m dynappo.train --config=configs/g1.py

Differences from `biped.py` only; task and variants are described there.
"""

import math
import pathlib
import runpy

biped = runpy.run_path(str(pathlib.Path(__file__).with_name("biped.py")))

# joints of each kind of motor: armature (kg m^2), effort limit (N m), speed limit (rad/s); mjlab 1.6.0
MOTORS = {
    ".*(hip_pitch|hip_yaw|waist_yaw)_joint": (0.01017752, 88.0, 32.0),
    ".*(hip_roll|knee)_joint": (0.02510193, 139.0, 20.0),
    ".*(ankle_pitch|ankle_roll|waist_roll|waist_pitch)_joint": (0.00721945, 50.0, 37.0),
    ".*(shoulder_pitch|shoulder_roll|shoulder_yaw|elbow|wrist_roll)_joint": (
        0.00360972,
        25.0,
        37.0,
    ),
    ".*(wrist_pitch|wrist_yaw)_joint": (0.00425, 5.0, 22.0),
}
FREQUENCY, DAMPING_RATIO = 10.0, 2.0  # Hz; of a motor alone under its PD (mjlab)


# rad, how far a joint may be from the default pose: mjlab's, walking, but for the shoulder's pitch (0.15
# there): with 0.5 the arms swing against the legs, with 0.15 hardly
POSTURE = {
    ".*_hip_pitch_joint": 0.3,
    ".*_hip_(roll|yaw)_joint": 0.15,
    ".*_knee_joint": 0.35,
    ".*_ankle_pitch_joint": 0.25,
    ".*_ankle_roll_joint": 0.1,
    "waist_yaw_joint": 0.2,
    "waist_roll_joint": 0.08,
    "waist_pitch_joint": 0.1,
    ".*_shoulder_pitch_joint": 0.5,
    ".*_(shoulder_roll|elbow)_joint": 0.15,
    ".*_shoulder_yaw_joint": 0.1,
    ".*_wrist_.*_joint": 0.3,
}


def get_config(variant=""):
    """A biped's config with this robot's differences."""
    config = biped["defaults"]()
    config.robot = "g1"
    task, w = config.task, 2 * math.pi * FREQUENCY
    kp = {joint: inertia * w**2 for joint, (inertia, _, _) in MOTORS.items()}
    effort = {joint: limit for joint, (_, limit, _) in MOTORS.items()}
    task.update(kp=kp, effort_limit=effort, saturation_effort=effort)
    task.kd = {joint: 2 * DAMPING_RATIO * inertia * w for joint, (inertia, _, _) in MOTORS.items()}
    task.velocity_limit = {joint: speed for joint, (_, _, speed) in MOTORS.items()}
    task.action_scale = {joint: 0.25 * effort[joint] / kp[joint] for joint in MOTORS}
    task.posture_std = POSTURE
    task.reset.spawn_height = 0.81
    task.randomize.base_mass = (-3.0, 3.0)
    return biped["apply_variant"](config, variant)

"""Unitree G1 with 29 joints, flat ground, velocity commands. A draft: robot, motors and physics; rewards and
variants are still those of the quadrupeds.

Differences from `default.py` only; variants as there.
"""

import math
import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))

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


def get_config(variant=""):
    """The defaults with this robot's differences."""
    config = default["defaults"]()
    config.robot = "g1"
    task, w = config.task, 2 * math.pi * FREQUENCY
    kp = {joint: inertia * w**2 for joint, (inertia, _, _) in MOTORS.items()}
    effort = {joint: limit for joint, (_, limit, _) in MOTORS.items()}
    task.update(kp=kp, effort_limit=effort, saturation_effort=effort)
    task.kd = {joint: 2 * DAMPING_RATIO * inertia * w for joint, (inertia, _, _) in MOTORS.items()}
    task.velocity_limit = {joint: speed for joint, (_, _, speed) in MOTORS.items()}
    task.action_scale = {joint: 0.25 * effort[joint] / kp[joint] for joint in MOTORS}
    task.reset.spawn_height = 0.81
    task.randomize.update(base_mass=(-3.0, 3.0))
    # with 4 and 8 one step in ten is off by 0.2 rad/s or more in a joint
    config.physics.update(iterations=6, ls_iterations=10)
    return default["apply_variant"](config, variant)

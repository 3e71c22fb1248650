"""Spot on flat ground, on the settings of ANYmal-C: what depends on the robot, by robots/README.md.

    cd experiments/23_untuned && dynappo look configs/spot.py --out=look.png

No number was chosen by what a training did.
"""

from dynappo import config as config_lib


def get_config(variant=""):
    """The config of ANYmal-C with this robot."""
    config = config_lib.load(f"configs/anymal_c.py:{variant}")
    config.robot = "spot"
    # Isaac Lab's gains, 60 and 1.5, times three: with 60 it kneels (sag 25 cm), with 180 it sags by
    # a tenth of its height. MuJoCo Playground has 300 and 1.
    config.task.update(kp=180.0, kd=4.5)
    # kp x action_scale x ppo.init_std = 36 N m, a third of the limit. Isaac Lab: 0.2 rad, of std 1
    config.task.action_scale = 0.4
    # Isaac Lab: hips 45, knees 30 to 113 N m, by their angle; here one number holds for all joints.
    # It is that of the knees near the default pose, which carry the robot. Speed: unknown
    config.task.update(effort_limit=113.0, saturation_effort=113.0, velocity_limit=30.0)
    config.task.reset.spawn_height = 0.57  # home and 5 cm
    return config

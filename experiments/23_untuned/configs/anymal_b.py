"""ANYmal-B on flat ground: ANYmal-C's settings on another body, as in Isaac Lab.

    cd experiments/23_untuned && dynappo look configs/anymal_b.py --out=look.png

Isaac Lab gives both the same drives (80 N m, 7.5 rad/s; also in the URDF: 80), so only what follows
from height and mass differs, by the rules of robots/README.md.
"""

from dynappo import config as config_lib


def get_config(variant=""):
    """The config of ANYmal-C with this robot."""
    config = config_lib.load(f"configs/anymal_c.py:{variant}")
    config.robot = "anymal_b"
    config.task.reset.spawn_height = 0.55  # home and 5 cm
    # a tenth of the robot, ANYmal-C's range times 0.66; `:deploy` has doubled that by now
    config.task.randomize.base_mass = tuple(0.66 * m for m in config.task.randomize.base_mass)
    return config

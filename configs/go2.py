"""Unitree Go2, flat ground, velocity commands (Isaac-Velocity-Flat-Unitree-Go2-v0).

    python -m dynappo.train --config=configs/go2.py

Differences from `default.py` only (Isaac Lab 2.2.1); variants as there.
"""

import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))

# N m and rad/s of hip, thigh and calf, of four legs: the vendor's URDF. The calf has another gear
EFFORT = (23.7, 23.7, 45.43) * 4
SPEED = (30.1, 30.1, 15.7) * 4


def get_config(variant=""):
    """The defaults with this robot's differences."""
    config = default["defaults"]()
    config.robot = "go2"
    if variant in default["OF_THE_PAPER"]:  # one kind of motor, as in Isaac Lab
        config.task.update(effort_limit=23.5, saturation_effort=23.5)
    else:
        config.task.update(effort_limit=EFFORT, saturation_effort=EFFORT, velocity_limit=SPEED)
    # rough ground (Isaac Lab's rough task): smaller than the defaults of `Tiles`
    config.task.tiles.update(boxes=(0.025, 0.1), random=(0.01, 0.06), random_step=0.01)
    if variant in default["ROUGH"]:
        config.task.weights.feet_air_time = 0.01
        config.task.tiles.cell = 0.05  # m, the width of a wall: with 0.1 stairs are slopes
    config = default["apply_variant"](config, variant)
    # feet 3 cm high at 0.5 m/s, and 5 cm in `deploy`
    default["lift_feet"](config, variant, best=-0.2, laptop=-0.3, deploy=(-1.2, 0.08))
    return config

"""Unitree Go1, flat ground, velocity commands (Isaac-Velocity-Flat-Unitree-Go1-v0).

    python -m dynappo.train --config=configs/go1.py

`:laptop` is for two CPU cores; `default.py` lists the paper's variants
and ours.
"""

import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))

# N m and rad/s of hip, thigh and calf, of four legs: the vendor's URDF. The calf has another gear
EFFORT = (23.7, 23.7, 35.55) * 4
SPEED = (30.1, 30.1, 20.06) * 4


def get_config(variant=""):
    """The defaults are Go1's; the paper's variants keep their one kind of motor, of Isaac Lab 2.2.1."""
    config = default["defaults"]()
    config.robot = "go1"
    if variant not in default["OF_THE_PAPER"]:
        config.task.update(effort_limit=EFFORT, saturation_effort=EFFORT, velocity_limit=SPEED)
    # rough ground (Isaac Lab's rough task): smaller than the defaults of `Tiles`
    config.task.tiles.update(boxes=(0.025, 0.1), random=(0.01, 0.06), random_step=0.01)
    if variant in default["ROUGH"]:
        config.task.weights.feet_air_time = 0.01
        config.task.tiles.cell = 0.05  # m, the width of a wall: with 0.1 stairs are slopes
    config = default["apply_variant"](config, variant)
    # feet 3 cm high at 0.5 m/s, and 5 cm in `deploy`
    default["lift_feet"](config, variant, best=-0.2, laptop=-0.3, deploy=(-1.5, 0.08))
    return config

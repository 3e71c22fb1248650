"""Unitree Go2, flat ground, velocity commands (Isaac-Velocity-Flat-Unitree-Go2-v0).

    python -m dynappo.train --config=configs/go2.py

Differences from `default.py` only (Isaac Lab 2.2.1); variants as there.
"""

import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))


def get_config(variant=""):
    """The defaults with this robot's differences."""
    config = default["defaults"]()
    config.robot = "go2"
    config.task.update(effort_limit=23.5, saturation_effort=23.5)
    return default["apply_variant"](config, variant)

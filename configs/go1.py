"""Unitree Go1, flat ground, velocity commands (Isaac-Velocity-Flat-Unitree-Go1-v0).

    python -m dynappo.train --config=configs/go1.py

`:laptop` walks after a minute of training on two CPU cores; `default.py` lists the paper's variants
and ours.
"""

import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))


def get_config(variant=""):
    """The defaults are Go1's."""
    config = default["defaults"]()
    config.robot = "go1"
    return default["apply_variant"](config, variant)

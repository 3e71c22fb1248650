"""ANYmal-D, flat ground, velocity commands (Isaac-Velocity-Flat-Anymal-D-v0).

    python -m dynappo.train --config=configs/anymal_d.py

ANYmal-C's settings on another body, as in Isaac Lab 2.2.1; variants as in `default.py`.
"""

import pathlib
import runpy

anymal_c = runpy.run_path(str(pathlib.Path(__file__).with_name("anymal_c.py")))


def get_config(variant=""):
    """The config of ANYmal-C with this robot."""
    config = anymal_c["get_config"](variant)
    config.robot = "anymal_d"
    return config

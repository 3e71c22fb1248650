"""The ground: a plane at height 0 of the world.

All JAX code of task and engines asks here how high a point is above the ground, and how high to place one.
On flat ground the answer is the point's own height, and nothing is computed for it. An uneven ground comes
here: its height map as an argument of both functions, read at `place()`.

What knows on its own that the ground is flat, and would follow:

- description/robot_contract.py: the geom `floor` is a plane at height 0
- physics/c_mujoco.py: of geoms a control step gives heights alone (`Moved`), without their place
- physics/warp/kernels.py and quadruped.h: heights and contacts inside a control step on a GPU
- description/contacts.py: how far a geom reaches down is not how far it is from a slope
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

# x and y [..., 2] (m, in the world) of the points; a function, so that flat ground computes nothing
Place = Callable[[], Any]


def height_above(z, place: Place | None):
    """Heights [...] (m) above the ground of points at the heights `z` [...] in the world."""
    return z


def world_height(above, place: Place | None):
    """Heights [...] (m) in the world of points that are so high `above` [...] the ground."""
    return above

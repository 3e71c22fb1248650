"""The left-right mirror image of observations and actions: `images(robot, layout)`.

It is computed from the robot's model: partners.py says which joint is another's image.
"""

from __future__ import annotations

import numpy as np

from dynappo.config import ConfigError
from dynappo.description.robot import Robot
from dynappo.tasks.velocity import partners, surroundings, view
from dynappo.types import Mirror


def joints(robot: Robot) -> Mirror:
    """Mirror of joint positions, velocities, actions [A]; ConfigError if a joint has no partner."""
    return Mirror(*partners.joints(robot))


def images(robot: Robot, layout: view.View) -> tuple[Mirror, Mirror] | None:
    """Of an observation (view.py) and of an action; None if the robot is not its own image."""
    try:
        own = joints(robot)
    except ConfigError:
        return None
    index, sign, start = [], [], 0
    for quantity in view.quantities(layout):
        if quantity.size is None and quantity.signs is None:
            image = own
        elif quantity.signs is None:  # one's own, of which nobody has said it
            return None
        else:
            order = np.arange(len(quantity.signs)) if quantity.order is None else quantity.order
            image = Mirror(np.array(order), np.array(quantity.signs, float))
        index.append(start + image.index)
        sign.append(image.sign)
        start += len(image.index)
    if layout.around is not None:
        around, signs = surroundings.mirror(layout.around)
        index.append(start + around)
        sign.append(signs)
    return Mirror(np.concatenate(index), np.concatenate(sign)), own

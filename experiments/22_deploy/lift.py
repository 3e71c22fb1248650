"""Terms for `task.terms`: higher feet, asked for by and by.

`foot_clearance` with a weight that lifts ANYmals' feet by 5 cm keeps a seed in two from walking at all, for a
robot that cannot walk touches down at every turn. Here each robot pays a share of that weight, which grows
with every episode in which it does not fall. Jobs `ramp` of gaits.txt.
"""

from dynappo import terms


@terms.curriculum(start=0.2, evaluated=1.0, numbers={"lift_step": 0.05})
def lift_share(lift_share, fell, lift_step):
    """Share of the weight of `high_feet` that a robot pays."""
    xp = lift_share.__array_namespace__()
    return xp.clip(xp.where(fell, lift_share - lift_step, lift_share + lift_step), 0.0, 1.0)


@terms.reward(weight=-1.0, numbers={"lift_height": 0.1})
def high_feet(swing_height, touchdown, command, lift_share, lift_height):
    """`foot_clearance` of rewards.py, of `lift_height` (m), times the robot's share."""
    moving = (command**2).sum() > 0.1**2
    short = 1 - swing_height / lift_height
    return lift_share * (short**2 * (short > 0) * touchdown).sum() * moving

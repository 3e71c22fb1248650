"""Two of five commands are slow: all of it times a share of 0 to 0.5. For `--config.task.terms`.

A robot for hardware stands where it is asked to walk slowly (gait.md). One command in ten is to stand, and
one in 37 is below 0.3 on all three axes.
"""

from dynappo import terms


@terms.command(draws=5)
def some_slow(draw, command_x, command_y, command_yaw):
    """[3] m/s, m/s, rad/s."""
    ranges = command_x, command_y, command_yaw
    velocity = [low + (high - low) * u for u, (low, high) in zip(draw[:3], ranges, strict=True)]
    slow = (draw[3] < 0.4) * 1.0
    share = 1 - slow * (1 - 0.5 * draw[4])
    return share * draw.__array_namespace__().stack(velocity)

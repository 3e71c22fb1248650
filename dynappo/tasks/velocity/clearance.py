"""A curriculum of the reward `foot_clearance`: the share of its weight that a robot pays.

`task.clearance_start` at first; after each episode `task.clearance_ramp` more, after a fall as much less,
from 0 to 1. Why: a policy that cannot walk yet touches down all the time, so a large weight keeps an ANYmal
from walking at all (experiments/22_deploy/feet.md). Each robot has its own share, so those that fall again
pay less.

Not a term of one's own (own.py): a run has one file of these, and that is the user's.
"""

import jax.numpy as jnp


def start(hyper):
    """The share [] of a robot that has had no episode; None without `task.clearance_ramp`."""
    if hyper.task.clearance_ramp is None:
        return None
    return jnp.asarray(hyper.task.clearance_start, jnp.float32)


def after(hyper, share, fell):
    """The share after an episode, which ended with a fall or not; None stays None."""
    ramp = hyper.task.clearance_ramp
    if ramp is None:
        return None
    return jnp.clip(share + jnp.where(fell, -ramp, ramp), 0.0, 1.0)


def whole(hyper):
    """The config's floats of an evaluation: each robot pays all of it."""
    task = hyper.task
    if task.clearance_ramp is None:
        return hyper
    # times 0: a float stays what it is in the program, an array of several seeds or a number
    start, ramp = task.clearance_start * 0 + 1.0, task.clearance_ramp * 0
    return hyper._replace(task=task._replace(clearance_start=start, clearance_ramp=ramp))

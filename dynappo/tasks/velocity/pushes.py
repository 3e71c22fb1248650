"""Pushes: sudden changes of the base's horizontal velocity, from time to time.

As in Isaac Lab (isaaclab/envs/mdp/events.py, push_by_setting_velocity), after the reward and before
the observation. `settings` is the config's group `task.push`, `dt` the seconds of a control step.
"""

import jax
import jax.numpy as jnp


def wait(settings, dt: float, share):
    """Control steps until the next push; `share`, 0 to 1, says where in the interval."""
    low, high = settings.interval
    return jnp.round((low + (high - low) * share) / dt).astype(jnp.int32)


def push(settings, dt: float, qvel, push_in, key):
    """`(qvel, push_in)` after one control step: a kick in world x and y when `push_in` runs out."""
    due = push_in <= 1
    unit = jax.random.uniform(key, (3,))
    kick = (2 * unit[:2] - 1) * settings.velocity
    qvel = qvel.at[:2].add(jnp.where(due, kick, 0.0))
    return qvel, jnp.where(due, wait(settings, dt, unit[2]), push_in - 1)

"""Each robot's own physical parameters: drawn once at the start, merged into the model at every
step.

Ranges are those of Isaac Lab (2.2.1, velocity_env_cfg.py, events at start-up): added base mass with
the inertia scaled in proportion, centre of mass, foot friction, PD gains. Ranges of the last three
are single values on Go1. A range that is just the file's value costs nothing, because that field of
the model stays one array for all robots.

MuJoCo's `*_invweight0` (the solver's estimate of inverse inertia at the contacts) stays nominal: it
only scales the regularisation of the constraints.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, PRNGKeyArray

# what a robot's file has: the feet of all robots have friction 0.8
NOMINAL = {"base_mass": 0.0, "friction": 0.8, "kp_scale": 1.0, "kd_scale": 1.0}


@struct.dataclass
class Body:
    """A robot's own physical parameters; in `TrainState` every shape has `[R]` in front."""

    mass_scale: Float[Array, "..."]  # of the base's mass and inertia
    base_com: Float[Array, "... 3"]  # m, in the base frame
    friction: Float[Array, "..."]
    kp_scale: Float[Array, "..."]
    kd_scale: Float[Array, "..."]


def draw(ranges, base_mass, base_com, key: PRNGKeyArray) -> Body:
    """One robot's parameters; `ranges` is the config's group `task.randomize`."""
    keys = jax.random.split(key, 5)

    def uniform(key, bounds, shape=()):
        return jax.random.uniform(key, shape, minval=bounds[0], maxval=bounds[1])

    offset = jax.random.uniform(keys[1], (3,), minval=-1.0, maxval=1.0)
    return Body(
        mass_scale=1 + uniform(keys[0], ranges.base_mass) / base_mass,
        base_com=base_com + offset * jnp.stack([jnp.asarray(w) for w in ranges.base_com]),
        friction=uniform(keys[2], ranges.friction),
        kp_scale=uniform(keys[3], ranges.kp_scale),
        kd_scale=uniform(keys[4], ranges.kd_scale),
    )


def merge(model, body: Body, base_body: int, feet, varied: frozenset[str]):
    """The mjx model of one robot; only fields whose range is in `varied` are replaced."""
    fields = {}
    # masks, because a `where` is one kernel and an `.at` three
    base = (np.arange(model.nbody) == base_body)[:, None]
    foot = np.isin(np.arange(model.ngeom), feet)[:, None] & (np.arange(3) == 0)
    if "base_mass" in varied:
        scale = body.mass_scale
        mass, inertia = model.body_mass, model.body_inertia
        fields["body_mass"] = jnp.where(base[:, 0], mass * scale, mass)
        fields["body_inertia"] = jnp.where(base, inertia * scale, inertia)
    if "base_com" in varied:
        fields["body_ipos"] = jnp.where(base, body.base_com, model.body_ipos)
    if "friction" in varied:
        fields["geom_friction"] = jnp.where(foot, body.friction, model.geom_friction)
    return model.tree_replace(fields) if fields else model


def varied(ranges) -> frozenset[str]:
    """Names of the ranges that are not collapsed to the value that the robot's file has."""
    names = {"base_com"} if any(ranges.base_com) else set()
    for name, nominal in NOMINAL.items():
        if tuple(getattr(ranges, name)) != (nominal, nominal):
            names.add(name)
    return frozenset(names)

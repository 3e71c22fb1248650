"""Each robot's own physical parameters: drawn once at the start, merged into the model at every
step.

Ranges are those of Isaac Lab (2.2.1, velocity_env_cfg.py, events at start-up): added base mass with
the inertia scaled in proportion, centre of mass, foot friction, PD gains. Ranges of the last three
are single values on Go1. A range that is just the file's value costs nothing, because that field of
the model stays one array for all robots.

Real robots differ in more: weak motors, friction and inertia in the joints, actions that come late, torques
that lag, sensors that are a little off. Each is None in a `Body` unless its range says otherwise.

Why one delay, and not one for the sensors and one for the motors: only their sum matters. Observations that
are d_o seconds old and motors that obey d_a seconds later have the same effect as fresh observations and
motors that obey after d_o + d_a; only the clock is d_o late.

MuJoCo's `*_invweight0` (the solver's estimate of inverse inertia at the contacts) stays nominal: it
only scales the regularisation of the constraints.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, PRNGKeyArray

# what a robot's file has: the feet of all robots have friction 0.8
NOMINAL = {"base_mass": 0.0, "friction": 0.8, "kp_scale": 1.0, "kd_scale": 1.0}
NOMINAL |= {"strength": 1.0, "armature": 1.0, "joint_friction": 0.0, "delay": 0.0, "lag": 0.0}
AROUND = "base_com", "encoder_bias", "imu_tilt"  # half widths around the file's value


class Trait(NamedTuple):
    """A field of a `Body` as a network sees it: (value - nominal) x scale, about -2 to 2."""

    nominal: float
    scale: float
    # of each number in the mirror image, left for right; None: a number a joint
    signs: tuple[int, ...] | None = (1,)


TRAITS = dict(
    mass_scale=Trait(1.0, 4.0),
    base_com=Trait(0.0, 20.0, (1, -1, 1)),
    friction=Trait(0.8, 2.0),
    kp_scale=Trait(1.0, 5.0),
    kd_scale=Trait(1.0, 5.0),
    strength=Trait(1.0, 5.0),
    armature=Trait(1.0, 1.0),
    joint_friction=Trait(0.0, 5.0),
    delay=Trait(0.0, 50.0),
    lag=Trait(0.0, 100.0),
    encoder_bias=Trait(0.0, 20.0, None),
    imu_tilt=Trait(0.0, 20.0, (-1, 1, -1)),
)
# those that are None where their range is nominal
HARDWARE = "strength armature joint_friction delay lag encoder_bias imu_tilt".split()


@struct.dataclass
class Body:
    """A robot's own physical parameters; in `TrainState` every shape has `[R]` in front."""

    mass_scale: Float[Array, "..."]  # of the base's mass and inertia
    base_com: Float[Array, "... 3"]  # m, in the base frame
    friction: Float[Array, "..."]
    kp_scale: Float[Array, "..."]
    kd_scale: Float[Array, "..."]
    strength: Any = None  # [...] share of the motors' torque that arrives
    armature: Any = None  # [...] of the joints, times the file's
    joint_friction: Any = None  # [...] N m
    delay: Any = None  # [...] s, from what is seen to what the motors do about it
    lag: Any = None  # [...] s, time constant of the torque
    encoder_bias: Any = None  # [..., A] rad, of what is read less what is
    imu_tilt: Any = None  # [..., 3] rad, turn of the sensor in the base


def draw(
    ranges, base_mass, base_com, key: PRNGKeyArray, varied=frozenset(), joints: int = 0
) -> Body:
    """The parameters of one robot of so many joints; `ranges` is the config's group `task.randomize`,
    `varied` names those of `HARDWARE` that it has."""
    own = [name for name in HARDWARE if name in varied]
    sizes = [1, 3, 1, 1, 1, *[size_of(name, joints) if name in AROUND else 1 for name in own]]
    shares = jnp.split(jax.random.uniform(key, (sum(sizes),)), np.cumsum(sizes)[:-1])

    def drawn(bounds):
        low, high = bounds
        return low + (high - low) * shares.pop(0)[0]

    def around(width):
        return (2 * shares.pop(0) - 1) * width

    widths = jnp.stack([jnp.asarray(w) for w in ranges.base_com])
    return Body(
        mass_scale=1 + drawn(ranges.base_mass) / base_mass,
        base_com=base_com + around(widths),
        friction=drawn(ranges.friction),
        kp_scale=drawn(ranges.kp_scale),
        kd_scale=drawn(ranges.kd_scale),
        **{name: (around if name in AROUND else drawn)(getattr(ranges, name)) for name in own},
    )


def traits(varied) -> list[str]:
    """The fields that a `Body` has where `varied` are the ranges that are not nominal."""
    return [name for name in TRAITS if name not in HARDWARE or name in varied]


def size_of(trait: str, joints: int) -> int:
    """Numbers of a trait of a robot with so many joints."""
    signs = TRAITS[trait].signs
    return joints if signs is None else len(signs)


def numbers(body: Body, base_com, varied) -> Float[Array, " B"]:
    """A body as a network sees it: its `traits`, scaled. `base_com` is that of the file."""
    out = []
    for name in traits(varied):
        trait, value = TRAITS[name], getattr(body, name)
        nominal = base_com if name == "base_com" else trait.nominal
        out.append(jnp.atleast_1d((value - nominal) * trait.scale))
    return jnp.concatenate(out)


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
    if "armature" in varied:
        joints = np.arange(model.nv) >= 6  # the first six are the base's
        fields["dof_armature"] = model.dof_armature * jnp.where(joints, body.armature, 1.0)
    return model.replace(**fields) if fields else model


def varied(ranges) -> frozenset[str]:
    """Names of the ranges that hold more than the value in the robot's file."""
    names = {name for name in AROUND if np.any(getattr(ranges, name))}
    for name, nominal in NOMINAL.items():
        if tuple(getattr(ranges, name)) != (nominal, nominal):
            names.add(name)
    return frozenset(names)

"""What the policy, the value function and the transition model see of a robot.

    task.observation = "full"      the 48 numbers of observe.py, as the paper and Isaac Lab have them
                       "onboard"   45 of them: a robot does not measure its linear velocity

With `task.history` = h the policy also sees the readings of the h - 1 steps before. With "onboard" the
robot's own body (physics/randomize.py), which physics knows and no sensor tells, comes last:

    obs = [ 48 numbers, as sensed | readings before, the newest first | body ]

All but the first 33 follow from the row before (`context`), so the transition model writes tails of these
as of the 48. Each network has its columns (`views`): the policy the readings, a value function with
`ppo.critic = "state"` and the model all but the readings before, of which the model takes one, because with
it comes the action that a delay may still hold back.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.physics import randomize
from dynappo.physics.robot import Robot
from dynappo.task import observe
from dynappo.types import EnvState, Hyper, Views

SENSED = observe.SENSED


class View(NamedTuple):
    """The layout of an observation."""

    name: str  # of observe.NAMES
    history: int
    varied: frozenset[str]  # ranges of the body, where it is part of obs
    body: int  # numbers of the body in obs


def find(observation: str, history: int, varied: frozenset[str] = frozenset()) -> View:
    """The layout for `task.observation` and `task.history`; `varied` are the ranges of the body."""
    onboard = observation == "onboard"
    body = sum(map(randomize.size_of, randomize.traits(varied))) * onboard
    return View(observe.NAMES[observation], history, varied, body)


def reading(view: View) -> np.ndarray:
    """Columns [K] of observe.py that the policy sees."""
    return observe.columns(view.name)


def size(view: View) -> int:
    """Numbers of an observation."""
    return SENSED + (view.history - 1) * len(reading(view)) + view.body


def past_size(view: View) -> int:
    """Numbers of the readings before."""
    return (view.history - 1) * len(reading(view))


def views(view: View) -> Views | None:
    """The columns of each network; None where all see all."""
    if size(view) == SENSED and len(reading(view)) == SENSED:
        return None
    everything, past = np.arange(size(view)), past_size(view)
    before, body = everything[SENSED : SENSED + past], everything[SENSED + past :]
    state = np.concatenate([everything[:SENSED], body])
    return Views(
        actor=np.concatenate([reading(view), before]),
        critic=state,
        model=np.concatenate([state, before[: len(reading(view))]]),
    )


def exact(robot: Robot, body: randomize.Body, state: EnvState):
    """The 48 numbers of a state, without noise or error."""
    default = jnp.asarray(robot.default_pose, jnp.float32)
    seen = state.command, state.last_action
    return observe.observe(state.qpos, state.qvel, body.base_com, default, *seen)


def sense(view: View, robot: Robot, hyper: Hyper, body: randomize.Body, state, past, key):
    """`(prop, obs)` of a state: the predicted part as it is, and the whole as it is sensed.

    `past` is what follows the 48 numbers; None where an episode begins.
    """
    clean, told = exact(robot, body, state), jnp.zeros(0)
    unit = jax.random.uniform(key, clean.shape, minval=-1.0, maxval=1.0)
    sensed = clean + unit * observe.noise_scale(hyper.task.noise, jnp)
    if view.body:
        com = robot.mj_model.body_ipos[robot.base_body]
        told = randomize.numbers(body, com, view.varied)
        whole = jnp.concatenate([clean, jnp.zeros(past_size(view)), told])
        sensed = sensed.at[: observe.PROP_SIZE].add(bias(view, whole))
    past = first(view, sensed, told) if past is None else past
    return clean[: observe.PROP_SIZE], jnp.concatenate([sensed, past])


def noise(hyper: Hyper, key):
    """`Env.noise`: a draw of the noise on `prop`, [33]; uniform, as `sense` adds it."""
    scale = observe.noise_scale(hyper.task.noise, jnp)[: observe.PROP_SIZE]
    return jax.random.uniform(key, scale.shape, minval=-1.0, maxval=1.0) * scale


def first(view: View, sensed, body):
    """What follows the 48 numbers where an episode begins: the first reading, again and again; body."""
    xp = sensed.__array_namespace__()
    return xp.concat([*[sensed[reading(view)]] * (view.history - 1), body])


def later(view: View, obs):
    """What follows the 48 numbers one step after `obs` [..., O]: its reading, those before, its body."""
    if view.history == 1:
        return obs[..., SENSED:]
    xp, end = obs.__array_namespace__(), SENSED + past_size(view)
    kept = obs[..., SENSED : end - len(reading(view))]
    return xp.concat([obs[..., reading(view)], kept, obs[..., end:]], axis=-1)


def context(view: View, obs, action):
    """`Env.context`: what follows from `obs` [..., O] and `action`."""
    xp = obs.__array_namespace__()
    copied = observe.context(obs[..., :SENSED], action)
    return xp.concat([copied, later(view, obs)], axis=-1)


def bias(view: View, obs):
    """`Env.bias`: what the sensors of an `obs` [..., O] without errors add to its prop, [..., 33].

    Encoders are off by a constant. A tilted IMU reads x + tilt cross x of gravity and angular velocity,
    for small tilts.
    """
    xp = obs.__array_namespace__()
    off = dict.fromkeys(observe.PREDICTED)
    start = SENSED + past_size(view)
    for name in randomize.traits(view.varied) if view.body else ():
        stop = start + randomize.size_of(name)
        value, start = obs[..., start:stop] / randomize.TRAITS[name].scale, stop
        if name == "encoder_bias":
            off["joint_position"] = value
        elif name == "imu_tilt":
            for part in ("gravity", "angular_velocity"):
                off[part] = xp.linalg.cross(value, obs[..., observe.ROWS[part]])
    parts = [
        xp.zeros_like(obs[..., observe.ROWS[name]]) if value is None else value
        for name, value in off.items()
    ]
    return xp.concat(parts, axis=-1)


def parts(view: View) -> list[tuple[int, ...] | None]:
    """The signs of each part of an observation in the mirror image, part by part (observe.Part)."""
    rows = [part.signs for part in observe.PARTS.values()]
    seen = [observe.PARTS[name].signs for name in observe.shown(view.name)]
    body = [randomize.TRAITS[name].signs for name in randomize.traits(view.varied)]
    return rows + seen * (view.history - 1) + (body if view.body else [])

"""What the policy, the value function and the transition model see of a robot.

    task.observation = "full"      the numbers of observe.py, as the paper and Isaac Lab have them
                       "onboard"   all but the linear velocity, which a robot does not measure

With `task.history` = h the policy also sees the readings of the h - 1 steps before. With "onboard" the
robot's own body (physics/randomize.py), which physics knows and no sensor tells, comes last:

    obs = [ numbers of observe.py, as sensed | readings before, the newest first | body ]

On a ground that is not flat, where the robot is and the ground there come after that (surroundings.py).

The predicted numbers come first; all others follow from the row before (`advance`), so the transition model
can write tails of this observation, too. Each network sees its own columns (`views`):

- the policy: the readings;
- a value function with `ppo.critic = "state"`: all but the readings before;
- the model: the same and one reading before, whose action a delay may still hold back.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.description.robot import Robot
from dynappo.physics import ground as ground_lib
from dynappo.physics import randomize
from dynappo.tasks.velocity import commands, observe, surroundings
from dynappo.tasks.velocity import own as own_lib
from dynappo.tasks.velocity.state import Goal, State
from dynappo.tasks.velocity.surroundings import Surroundings
from dynappo.types import Hyper, Views

ERRORS = {"encoder_bias", "imu_tilt"}  # of sensors


class View(NamedTuple):
    """The layout of an observation."""

    observation: str  # as in `task.observation`
    joints: int
    history: int
    varied: frozenset[str]  # ranges of the body, where it is part of obs
    body: int  # numbers of the body in obs
    clock: bool  # whether it has the quantities of a gait clock
    around: Surroundings | None  # None: the ground is flat
    own: own_lib.Own = own_lib.NONE  # terms of one's own, some of which are part of obs


def make(
    observation: str,
    history: int,
    joints: int,
    varied: frozenset[str] = frozenset(),
    clock: bool = False,
    around: Surroundings | None = None,
    own: own_lib.Own = own_lib.NONE,
) -> View:
    """The layout for `task.observation` and `task.history`; `varied` are the ranges of the body, `clock`
    is whether `task.gait_frequency` is set."""
    onboard = observation == "onboard"
    sizes = [randomize.size_of(name, joints) for name in randomize.traits(varied)]
    body = sum(sizes) * onboard
    return View(observation, joints, history, varied, body, clock, around, own)


def name(view: View) -> str:
    """The name, in policy files, of what the policy sees of one step."""
    return observe.name(view.observation, view.joints, view.clock, view.own.seen)


def reading(view: View) -> np.ndarray:
    """Columns [K] of observe.py that the policy sees."""
    return observe.columns(name(view), view.own.seen)


def current_size(view: View) -> int:
    """Numbers of observe.py, which an observation begins with."""
    return observe.size(view.joints, view.clock, view.own.seen)


def prop_size(view: View) -> int:
    """Numbers that the model predicts, with which an observation begins."""
    return observe.prop_size(view.joints, view.own.seen)


def size(view: View) -> int:
    """Numbers of an observation."""
    return own_size(view) + surroundings.size(view.around)


def own_size(view: View) -> int:
    """Those before the surroundings."""
    return current_size(view) + past_size(view) + view.body


def past_size(view: View) -> int:
    """Numbers of the readings before."""
    return (view.history - 1) * len(reading(view))


def views(view: View) -> Views | None:
    """The columns of each network; None where all see all."""
    sensed, past = current_size(view), past_size(view)
    if size(view) == sensed == len(reading(view)):
        return None
    everything = np.arange(own_size(view))
    before, body = everything[sensed : sensed + past], everything[sensed + past :]
    state = np.concatenate([everything[:sensed], body])
    actor, critic, model = (
        own_size(view) + surroundings.columns(view.around, network) for network in Views._fields
    )
    return Views(
        actor=np.concatenate([reading(view), before, actor]),
        critic=np.concatenate([state, critic]),
        model=np.concatenate([state, before[: len(reading(view))], model]),
    )


def exact(view: View, robot: Robot, hyper: Hyper, body: randomize.Body, state: State):
    """The numbers of observe.py of a state, without noise or error."""
    default = jnp.asarray(robot.default_pose, jnp.float32)
    clock = None if state.gait is None else (state.gait.angle, state.gait.turn)
    seen = state.command, state.last_action, clock, view.own.seen

    def of_own(values):
        field = view.around.ground if view.around is not None else None
        placed = own_lib.Placed(
            qpos=state.qpos,
            qvel=state.qvel,
            height=ground_lib.height_above(state.qpos[2], lambda: state.qpos[:2], field),
            contact=state.contact_steps > 0,
        )
        facts = own_lib.numbers(hyper) | values | placed._asdict()
        return own_lib.predicted(view.own, facts) | (state.own or {})

    return observe.observe(state.qpos, state.qvel, body.base_com, default, *seen, of_own=of_own)


def split(view: View, obs) -> dict[str, Any]:
    """The numbers of observe.py [..., O] by name; a curriculum's as one number."""
    parts = observe.split(obs, view.joints, view.clock, view.own.seen)
    return own_lib.scalars(view.own, parts)


def following(view: View, hyper: Hyper, known, action, next_prop) -> dict[str, Any]:
    """The known quantities of one's own after `known`, those of observe.py before `action`."""
    before = observe.split_context(known, view.joints, view.clock, view.own.seen)
    facts = own_lib.numbers(hyper) | observe.split_prop(next_prop, view.joints, view.own.seen)
    return own_lib.following(view.own, before, facts | {"action": action})


def observation(view: View, robot: Robot, hyper: Hyper, body: randomize.Body, state, past, key):
    """`(prop, obs)` of a state: the predicted numbers as it is, and the whole as it is sensed.

    `past` is what follows the numbers of observe.py; None where an episode begins.
    """
    clean, told, predicted = exact(view, robot, hyper, body, state), jnp.zeros(0), prop_size(view)
    ground = []
    if view.around is not None:
        key, ground_key = jax.random.split(key)
        there = state.qpos, state.qvel, state.goal, state.scan_shift
        there = surroundings.exact(view.around, *there)
        ground = [surroundings.sense(view.around, hyper, there, ground_key)]
    unit = jax.random.uniform(key, clean.shape, minval=-1.0, maxval=1.0)
    of = view.joints, view.clock, view.own.seen
    sensed = clean + unit * observe.noise_scale(hyper.task.noise, jnp, *of)
    if view.body:
        com = robot.mj_model.body_ipos[robot.base_body]
        told = randomize.numbers(body, com, view.varied)
        whole = jnp.concatenate([clean, jnp.zeros(past_size(view)), told])
        sensed = sensed.at[:predicted].add(bias(view, whole))
    past = rest_at_start(view, sensed, told) if past is None else past
    return clean[:predicted], jnp.concatenate([sensed, past, *ground])


def sense(view: View, hyper: Hyper, prop, context, key):
    """`Env.sense`: `prop` with errors and noise, drawn uniformly, as `observation` adds them."""
    if view.body and view.varied & ERRORS:
        prop = prop + bias(view, jnp.concatenate([prop, context]))
    scale = observe.noise_scale(hyper.task.noise, jnp, view.joints, own=view.own.seen)[: prop.size]
    return prop + jax.random.uniform(key, scale.shape, minval=-1.0, maxval=1.0) * scale


def sense_context(view: View, hyper: Hyper, context, key):
    """`Env.sense_context`: the ground as it is sensed. All before it is known as it is."""
    around, own = view.around, own_size(view) - prop_size(view)
    assert around is not None
    return jnp.concatenate([context[:own], surroundings.sense(around, hyper, context[own:], key)])


def rest_at_start(view: View, sensed, body):
    """What follows observe.py's numbers at the start of an episode: the first reading, repeated; body."""
    xp = sensed.__array_namespace__()
    return xp.concat([*[sensed[reading(view)]] * (view.history - 1), body])


def rest_after(view: View, obs):
    """What follows the numbers of observe.py one step after `obs` [..., O]: its reading, those before,
    its body."""
    sensed, own = current_size(view), own_size(view)
    if view.history == 1:
        return obs[..., sensed:own]
    xp, end = obs.__array_namespace__(), sensed + past_size(view)
    kept = obs[..., sensed : end - len(reading(view))]
    return xp.concat([obs[..., reading(view)], kept, obs[..., end:own]], axis=-1)


def advance(view: View, hyper: Hyper, context, prop, action, next_prop):
    """`Env.advance`: command, last action, gait clock, what was sensed before (`prop`), the body, and the
    ground."""
    xp = context.__array_namespace__()
    known = context[..., : current_size(view) - prop.shape[-1]]

    def of_own(before):
        return following(view, hyper, known, action, next_prop)

    now = observe.advance(known, action, view.clock, view.own.seen, of_own)
    rest = rest_after(view, xp.concat([prop, context], axis=-1))
    if view.around is None:
        return xp.concat([now, rest], axis=-1)
    around = context[..., own_size(view) - prop.shape[-1] :]
    around = surroundings.advance(view.around, around, next_prop)
    return xp.concat([_turning(view, hyper, now, around), rest, around], axis=-1)


def _turning(view: View, hyper: Hyper, known, around):
    """The known quantities, in which a heading command has the yaw rate of the pose in `around`."""
    assert view.around is not None
    if not view.around.heading:
        return known
    where = surroundings.places(view.around)
    heading, standing = around[where["goal"]]
    goal = Goal(heading=heading, standing=standing, steps_left=jnp.int32(0))
    command = commands.turned(hyper, known[:3], goal, around[where["pose"]][3])
    return jnp.concatenate([command, known[3:]])


def bias(view: View, obs):
    """What the sensors of an `obs` [..., O] without errors add to its prop, [..., P].

    Encoders are off by a constant. A tilted IMU reads x + tilt cross x of gravity and angular velocity,
    for small tilts.
    """
    xp, where = obs.__array_namespace__(), observe.slices(view.joints, own=view.own.seen)
    off = dict.fromkeys(observe.predicted(view.own.seen))
    start = current_size(view) + past_size(view)
    for name in randomize.traits(view.varied) if view.body else ():
        stop = start + randomize.size_of(name, view.joints)
        value, start = obs[..., start:stop] / randomize.TRAITS[name].scale, stop
        if name == "encoder_bias":
            off["joint_position"] = value
        elif name == "imu_tilt":
            for sensed in ("gravity", "angular_velocity"):
                off[sensed] = observe.cross(value, obs[..., where[sensed]])
    errors = [
        xp.zeros_like(obs[..., where[name]]) if value is None else value
        for name, value in off.items()
    ]
    return xp.concat(errors, axis=-1)


def scale(view: View) -> np.ndarray:
    """`Env.input_scale`: the scale of each number of an observation (observe.Quantity)."""
    every = np.ones(current_size(view))
    for name, where in observe.slices(view.joints, view.clock, view.own.seen).items():
        every[where] = observe.quantity(name, view.own.seen).scale
    before = [every[reading(view)]] * (view.history - 1)
    rest = np.ones(view.body + surroundings.size(view.around))
    return np.concatenate([every, *before, rest]).astype(np.float32)


def quantities(view: View) -> list[observe.Quantity]:
    """The quantities of an observation before the surroundings, one after the other."""
    own = view.own.seen
    current = [*observe.quantities(view.clock, own).values()]
    seen = [observe.quantity(each, own) for each in observe.shown(name(view), own)]
    traits = randomize.traits(view.varied) if view.body else ()
    body = [observe.Quantity(None, "", "", signs=randomize.TRAITS[trait].signs) for trait in traits]
    return current + seen * (view.history - 1) + body

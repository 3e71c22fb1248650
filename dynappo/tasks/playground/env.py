"""A Playground task as a `types.Env`: the task's own reset and step, with little carried from row to row.

- **Carried** are qpos, qvel, the solver's warm start and the task's own numbers (ctrl where a task reads it).
  MJX's data are rebuilt from an empty template in each step. Why: they are hundreds of numbers a robot, and
  MJX-Warp's contacts have no axis of robots, so neither `where` nor `vmap` over seeds can take them along.
- **Resets** are the task's own. A first observation needs a call of physics, and Warp's call takes long for
  few robots too. So each robot carries a first state made ahead and starts from that (`restart`). All of them
  are drawn anew at once, every 10 resets' worth of rows: 10 for a reset of one call, 260 for a getup task's,
  which lets the robot settle for 125 physics steps. An episode that is longer never sees a first state twice;
  after a shorter one it may be the same, with another random key.
- **Actions** end in a tanh, as those of brax's policies. It is part of the environment: the policy is a
  Gaussian before it. The density of tanh cancels in PPO's ratio, but not in the entropy (`ppo.squashed`).
- **Noise** is the task's own. `prop` is without: the task's step once more, with physics already done and
  noise 0 (swapped.py), which is a few kernels.
- **Tails** compute what is known by the task's own step too (`advance`). What it draws at random, such as the
  next command, is drawn by a key made of the row's numbers.

`hyper` is not read: weights, noise and ranges are the task's own.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int

from dynappo.config import ConfigError
from dynappo.tasks.playground import commands, known, mirrored, parts, swapped
from dynappo.tasks.playground.parts import Layout, Raw
from dynappo.tasks.velocity import observe
from dynappo.types import Env, Hyper, Outcome

RENEWAL = 10  # spares are drawn anew in so many times a reset's cost, which is at least 1 row
EVENTS = ("reward", "falls", "timeouts", "blowups")  # metrics beside the task's own
ERRORS = ("velocity_error_sq", "yaw_error_sq")  # and those of a task with a command


# Warp's flags of a world (mujoco_warp's OverflowType): what had no room, and these bits
OVERFLOWS = {"overflow_constraints": 0b11, "overflow_contacts": 0b111_1100}


class Spare(struct.PyTreeNode):
    """A first state made ahead."""

    state: State  # which has no spare
    rows: Int[Array, "..."]  # control steps of all episodes


class State(struct.PyTreeNode):
    """One robot of a task."""

    qpos: Float[Array, "..."]
    qvel: Float[Array, "..."]
    qacc_warmstart: Float[Array, "..."]
    ctrl: Float[Array, "..."] | None  # None where no step reads it
    info: dict[str, Any]  # the task's own numbers, and its random key
    obs: Float[Array, "... O"]
    prop: Float[Array, "... P"]
    clock: Int[Array, "..."]  # age of the episode in control steps; the first may start aged
    episode_steps: Int[Array, "..."]  # control steps since the reset
    episode_return: Float[Array, "..."]
    spare: Spare | None = None  # None in a spare's own state


class Constants(NamedTuple):
    """What the functions below need; constants of the program."""

    task: Any  # Playground's MjxEnv
    layout: Layout
    like: Raw  # shapes and types of what a reset gives
    metrics: dict[str, Any]  # zeros
    episode_length: int  # control steps
    random_clock: bool
    every: int  # rows, in which all spares are drawn anew once
    known: known.Known | None  # of rewards and end in a tail


def make(
    task: Any,
    episode_length: int | None = None,
    random_clock: bool = True,
    symmetry: bool = False,
    known_reward: bool = False,
) -> Env:
    """The `Env` of a loaded task (loading.py). It probes the task, which takes some seconds.

    `episode_length` is in control steps; None: the task's. `random_clock` ends the first episode of each
    robot at a random age, so that later ones do not end together. `symmetry` asks for the mirror image;
    ConfigError where there is none. With `known_reward` a tail computes the terms of the reward that follow
    from what is predicted, and the end (known.py).
    """
    layout, probed = parts.layout(task)
    fall = _fall_reward(task, layout)
    found = known.find(task, layout, probed, fall is not None) if known_reward else None
    image = mirrored.find(task, layout, probed) if symmetry else None
    if isinstance(image, str):
        raise ConfigError(f"ppo.symmetry is True, but this task has no mirror image: {image}")

    if found is not None:
        layout = parts.with_rest(layout)
        image = image and mirrored.with_rest(image, layout)

    def start(key):
        with swapped.physics(lambda data, ctrl, n: data):  # shapes need none
            out = task.reset(key)
        return parts.after_step(task, out, found and found.rest), out.metrics

    like, metrics = jax.eval_shape(start, jax.random.PRNGKey(0))
    metrics = {name: np.zeros(x.shape, x.dtype) for name, x in metrics.items()}
    scalars = [name for name, x in metrics.items() if x.shape == ()]
    steered = ERRORS if commands.in_info(like.info) else ()
    told = (*EVENTS, *steered, *(OVERFLOWS if task.mjx_model.impl.value == "warp" else ()))
    length = episode_length or int(task._config.episode_length)
    cost = -(-swapped.steps_of_a_reset(task) // task.n_substeps)
    const = Constants(task, layout, like, metrics, length, random_clock, RENEWAL * cost, found)
    return Env(
        reset=partial(reset, const),
        step=partial(step, const),
        autoreset=partial(autoreset, restart(const)),
        advance=partial(advance, const),
        sense=partial(sense, const),
        views=layout.views,
        known_reward=nothing_known if found is None else partial(reward_known, const),
        known_end=partial(end_known, const) if found is not None and found.end else None,
        fall_reward=None if fall is None else lambda hyper: fall,
        mirror=image,
        metrics=(*map(column_name, scalars), *told),
        obs_size=len(layout.source),
        prop_size=layout.prop_size,
        action_size=task.action_size,
        dt=float(task.dt),
        episode_length=length,
    )


def column_name(metric: str) -> str:
    """The name in metrics.csv of a task's metric: reward/pose is reward_pose there."""
    return metric.replace("/", "_")


def _fall_reward(task: Any, layout: Layout) -> float | None:
    """What a fall pays, where it is known: a task that clips its rewards at 0 pays what is left."""
    scales = getattr(task._config.get("reward_config"), "scales", {})
    cost = scales.get("termination", 0.0) * task.dt
    return None if layout.clipped or cost == 0 else float(cost)


def squashed(action: Float[Array, "A"]) -> Float[Array, "A"]:
    """The task's action for one of the policy."""
    return jnp.tanh(action)


def reset(const: Constants, hyper: Hyper, body, key) -> State:
    """The start of an episode: the task's own reset, with a call of physics."""
    first_key, clock_key = jax.random.split(key)
    clock = jax.random.randint(clock_key, (), 0, const.episode_length, jnp.int32)
    state = first(const, first_key)
    spare = Spare(state, clock * 0)  # at first it is the state itself
    return state.replace(clock=clock * const.random_clock, spare=spare)


def first(const: Constants, key) -> State:
    """A first state of age 0."""
    raw_key, zero = jax.random.key_data(key), jnp.zeros((), jnp.int32)
    out = const.task.reset(raw_key)
    with swapped.uniform(0.5), swapped.reset_to(out.data):
        exact = const.task.reset(raw_key)
    return _state(const, out, exact).replace(
        clock=zero, episode_steps=zero, episode_return=0.0 * zero
    )


def after_step(const: Constants, out: Any) -> Raw:
    """The `Raw` of a Playground state."""
    return parts.after_step(const.task, out, const.known and const.known.rest)


def _state(const: Constants, out: Any, exact: Any) -> State:
    """The state after `out`, a Playground state; `exact` is the same without noise."""
    layout = const.layout
    now, quiet = (after_step(const, x) for x in (out, exact))
    raw = jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), now, const.like)
    numbers, quiet = parts.vector(layout.names, raw), parts.vector(layout.names, quiet)
    obs, prop = parts.pack(layout, numbers, quiet)
    data, zero = out.data, jnp.zeros((), jnp.int32)
    return State(
        qpos=data.qpos,
        qvel=data.qvel,
        qacc_warmstart=data.qacc_warmstart,
        ctrl=data.ctrl if layout.reads_ctrl else None,
        info=raw.info,
        obs=obs,
        prop=prop,
        clock=zero,
        episode_steps=zero,
        episode_return=jnp.zeros(()),
    )


def before_step(const: Constants, state: State) -> Any:
    """The Playground state of a `State`, with MJX's data rebuilt."""
    data = parts.template(const.task).replace(
        qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.qacc_warmstart
    )
    if state.ctrl is not None:
        data = data.replace(ctrl=state.ctrl)
    numbers = parts.unpack(const.layout, state.obs, state.prop)
    obs = parts.unvector(const.layout.names, numbers, const.like).obs
    return swapped.state(data, obs, state.info, const.metrics)


def step(const: Constants, hyper: Hyper, body, state: State, action, key):
    """One control step -> `(State, Outcome)`; never resets. The task has its own random key in `info`.

    If a number is not finite, the episode ends with reward 0 and counts in `blowups`.
    """
    acts = squashed(action)
    out = const.task.step(before_step(const, state), acts)
    with swapped.uniform(0.5):
        exact = swapped.step(const.task, before_step(const, state), acts, out.data)
    after = _state(const, out, exact)
    ok = jnp.isfinite(out.reward) & jnp.isfinite(after.obs).all() & jnp.isfinite(after.prop).all()
    ok &= jnp.isfinite(after.qpos).all() & jnp.isfinite(after.qvel).all()
    reward, clock = jnp.where(ok, out.reward, 0.0), state.clock + 1
    fell = (out.done > 0) | ~ok
    timeout = (clock >= const.episode_length) & ~fell
    after = after.replace(
        obs=jnp.where(ok, after.obs, state.obs),
        prop=jnp.where(ok, after.prop, state.prop),
        clock=clock,
        episode_steps=state.episode_steps + 1,
        episode_return=state.episode_return + reward,
        spare=state.spare and state.spare.replace(rows=state.spare.rows + 1),
    )
    told = {
        column_name(n): jnp.where(ok, x, 0.0) for n, x in out.metrics.items() if jnp.ndim(x) == 0
    }
    told |= dict(zip(EVENTS, (reward, fell * 1.0, timeout * 1.0, ~ok * 1.0), strict=True))
    told |= errors(state, after, ok)
    told |= overflows(out.data)
    outcome = Outcome(
        reward=reward,
        discount=1.0 - fell,
        truncation=timeout * 1.0,
        next_obs=after.obs,
        next_prop=after.prop,
        valid=ok * 1.0,
        episode_return=after.episode_return,
        episode_length=after.episode_steps * 1.0,
        metrics=told,
    )
    return after, outcome


def errors(before: State, after: State, ok) -> dict[str, Float[Array, ""]]:
    """Squared errors of the velocity (m/s) and the yaw rate (rad/s) that were asked for; {} of a task without
    command. Of the base's frame and its origin, whatever a task's rewards are of."""
    if not commands.in_info(before.info):
        return {}
    _, linear, angular = observe.base_motion(after.qpos, after.qvel, jnp.zeros(3))
    off = before.info["command"] - jnp.stack((linear[0], linear[1], angular[2]))
    off = jnp.where(ok, off, 0.0)
    return dict(zip(ERRORS, ((off[:2] ** 2).sum(), off[2] ** 2), strict=True))


def overflows(data: Any) -> dict[str, Float[Array, ""]]:
    """1 where Warp had no room for some contacts or constraints of this robot; the run ends if one is
    (run/overflow.py). {} of another engine, which has room for all."""
    flags = getattr(data._impl, "overflow", None)
    if flags is None:
        return {}
    flags = jnp.asarray(flags).reshape(-1)[0]
    return {name: ((flags & bits) > 0) * 1.0 for name, bits in OVERFLOWS.items()}


def autoreset(restarted, hyper: Hyper, body, state: State, outcome: Outcome, key) -> State:
    """`state`, or the first one of a new episode where `outcome` ended one."""
    ended = (outcome.discount == 0) | (outcome.truncation == 1)
    return restarted(ended, jax.random.key_data(key), state)


def restart(const: Constants):
    """`f(ended, raw key, state)`: the spare where `ended`, with a random key of its own, else `state`.

    When their time has come, all spares are drawn anew, under `vmap` in one call of physics. Robots of all
    seeds have the same rows, so the loop below runs once in all of them or in none.
    """

    def taken(ended, key, state):
        fresh = state.spare.state
        if "rng" in fresh.info:
            fresh = fresh.replace(info=fresh.info | {"rng": key})
        return jax.tree.map(partial(jnp.where, ended), fresh.replace(spare=state.spare), state)

    def drawn(key, old):
        new = first(const, jax.random.wrap_key_data(key))
        ok = [jnp.isfinite(x).all() for x in (new.obs, new.prop, new.qpos, new.qvel)]
        return jax.tree.map(partial(jnp.where, jnp.all(jnp.stack(ok))), new, old)

    @jax.custom_batching.custom_vmap
    def one(ended, key, state):
        several = jax.tree.map(lambda x: x[None], (ended, key, state))
        return jax.tree.map(lambda x: x[0], of_some(*several))

    def of_some(ended, keys, states):
        keys = jax.vmap(jax.random.split)(jax.random.wrap_key_data(keys))
        keys = jax.random.key_data(keys)
        states = jax.vmap(taken)(ended, keys[:, 0], states)

        def draw(carry):
            return jnp.zeros((), bool), jax.vmap(drawn)(keys[:, 1], carry[1])

        due = states.spare.rows[0] % const.every == 0
        # not `cond`: under the `vmap` of seeds that would draw in each row
        _, spares = jax.lax.while_loop(lambda carry: carry[0], draw, (due, states.spare.state))
        return states.replace(spare=states.spare.replace(state=spares))

    @one.def_vmap
    def of_all(axis_size, in_batched, *arguments):
        arguments = jax.tree.map(
            lambda x, batched: x if batched else jnp.broadcast_to(x, (axis_size, *jnp.shape(x))),
            arguments,
            tuple(in_batched),
        )
        states = of_some(*arguments)
        return states, jax.tree.map(lambda _: True, states)

    return one


def advance(const: Constants, hyper: Hyper, context, prop, action, next_prop):
    """`Env.advance`: what the task's step computes without physics."""
    data = parts.with_fields(parts.template(const.task), const.layout.home)
    numbers = parts.vector(
        const.layout.names, after_step(const, _in_tail(const, prop, context, action, data))
    )
    return numbers[const.layout.source[const.layout.prop_size :]]


def nothing_known(hyper: Hyper, obs, action, next_prop):
    """`Env.known_reward` of a task of which no term is."""
    return jnp.zeros(())


def reward_known(const: Constants, hyper: Hyper, obs, action, next_prop):
    """`Env.known_reward`: all of it, of a state that the model predicts (known.py)."""
    assert const.known is not None
    prop, context = jnp.split(obs, [const.layout.prop_size])
    out = _in_tail(const, prop, context, action, _filled(const, next_prop))
    return known.reward(const.layout, const.known, out.metrics, next_prop)


def end_known(const: Constants, hyper: Hyper, prop, context):
    """`Env.known_end`: 1 where the task ends the episode in a state that the model predicts."""
    still = jnp.zeros(const.task.action_size)
    return _in_tail(const, prop, context, still, _filled(const, prop)).done


def _filled(const: Constants, prop):
    assert const.known is not None
    return known.filled(const.layout, const.known, parts.template(const.task), prop)


def _in_tail(const: Constants, prop, context, action, after):
    """Playground's state after a step whose physics end in the data `after`."""
    layout, names = const.layout, const.layout.names
    obs = jnp.concatenate([prop, context])
    raw = parts.unvector(names, parts.unpack(layout, obs, prop), const.like)
    info = (
        raw.info | {"rng": parts.key_of(prop, context, action)} if "rng" in raw.info else raw.info
    )
    before = parts.with_fields(parts.template(const.task), layout.home)
    before = before.replace(ctrl=raw.ctrl) if layout.reads_ctrl else before
    start = swapped.state(before, raw.obs, info, const.metrics)
    return swapped.step(const.task, start, squashed(action), after)


def sense(const: Constants, hyper: Hyper, prop, context, key):
    """`Env.sense`: uniform noise, as wide as the task's, and the same where the task draws it once."""
    draws = jax.random.uniform(key, prop.shape, minval=-1.0, maxval=1.0)
    return prop + const.layout.noise * draws[const.layout.draw]

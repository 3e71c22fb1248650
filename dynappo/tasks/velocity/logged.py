"""The environment of a log: robots that live again what one robot recorded (log_file.py).

`make` changes the velocity task's `Env` so that a step is that of the log. So training knows nothing of logs:
its real rows are recorded ones, the model learns from them, tails begin in them. But PPO gives them no weight
(`Env.recorded`), because another policy chose their actions.

Each of the R robots of a rollout begins at a place of the log drawn at random and goes on from there; where
the episode ends, at another. So every iteration has rows of all of the log, and needs no memory beside it.

What is sensed is all that is known: `prop`, elsewhere the state without noise, is the reading.

The reward is computed from the rows, by the terms of rewards.py. What a term asks of physics (`Measured`)
comes from the readings:

- `torque`: what the PD asks for at the reading after, within the motors' limits
- `joint_velocity_before`, `timestep`: of the reading before, so accelerations are means over a control step
- `older_action`, `over_limit`: as in the task
- `contact`, `touchdown`, `last_air_time`: of the array `contact`, if there is one

Other terms are left out (`log_file.left_out`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int

from dynappo.description.robot import Robot
from dynappo.physics import actuators, engine, randomize
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import log_file, observe, view
from dynappo.tasks.velocity.log_file import Log
from dynappo.types import Env, Hyper, Outcome, autoreset


class Place(struct.PyTreeNode):
    """A robot's state: an entry of the log, and what it has lived through since it was put somewhere."""

    entry: Int[Array, "..."]
    obs: Float[Array, "... O"]
    prop: Float[Array, "... P"]
    episode_return: Float[Array, "..."]
    episode_steps: Int[Array, "..."]


class Entries(struct.PyTreeNode):
    """The entries of a log; `[T, ...]`."""

    obs: Any  # [O] as the networks see them
    action: Any  # [A]
    older_action: Any  # [A], that of two steps before
    fell: Any  # 1 or 0
    goes_on: Any  # 1 or 0: the next entry is the step after this one
    contact: dict[str, Any]  # the fields `log_file.OF_CONTACT`; empty where nothing is known


def make(env: Env, log: Log, robot: Robot, task) -> Env:
    """`env` of `robot` and the config's group `task`, whose every row is one of the log."""
    layout = view.make(
        task.observation,
        task.history,
        len(robot.joint_names),
        randomize.varied(task.randomize),
    )
    entries = jax.tree.map(jnp.asarray, of_log(log, layout))
    starts = jnp.asarray(np.flatnonzero(log.goes_on), jnp.int32)

    def at(entry):
        obs = entries.obs[entry]
        return Place(entry, obs, obs[: env.prop_size], jnp.zeros(()), jnp.int32(0))

    def reset(hyper, body, key):
        return at(starts[jax.random.randint(key, (), 0, len(starts))])

    return env._replace(
        randomize=lambda hyper, key: None,
        reset=reset,
        step=partial(step, env, robot, entries, at),
        autoreset=autoreset(reset),
        recorded=lambda state: entries.action[state.entry],
        metrics=(),
    )


def step(
    env: Env, robot: Robot, entries: Entries, at, hyper: Hyper, body, state: Place, action, key
):
    """The row of the log that begins in `state`; `action` is the recorded one (`Env.recorded`)."""
    after, done = at(state.entry + 1), entries.action[state.entry]
    measured = _measured(env, robot, entries, hyper, state, after)
    reward = env.known_reward(hyper, state.obs, done, after.prop, measured)
    fell = entries.fell[after.entry]
    if env.fall_reward is not None:
        reward += fell * env.fall_reward(hyper)
    after = after.replace(
        episode_return=state.episode_return + reward, episode_steps=state.episode_steps + 1
    )
    outcome = Outcome(
        reward=reward,
        discount=1.0 - fell,
        truncation=(1.0 - fell) * (1.0 - entries.goes_on[after.entry]),
        next_obs=after.obs,
        next_prop=after.prop,
        episode_return=after.episode_return,
        episode_length=after.episode_steps * 1.0,
        valid=jnp.ones(()),
    )
    return after, outcome


def _measured(env: Env, robot: Robot, entries: Entries, hyper: Hyper, state: Place, after: Place):
    """What a reward term may ask for beyond the observation, of the row from `state` to `after`, by name."""
    joints, task = len(robot.joint_names), engine.per_joint_arrays(hyper)
    default = jnp.asarray(robot.default_pose, jnp.float32)
    before, now = (observe.split_prop(place.prop, joints) for place in (state, after))
    angle, speed = now["joint_position"] + default, now["joint_velocity"]
    target = actuators.target(entries.action[state.entry], default, task.action_scale)
    torque = actuators.clip_dc_motor(
        actuators.pd(target, angle, speed, task.kp, task.kd),
        speed,
        effort_limit=task.effort_limit,
        saturation_effort=task.saturation_effort,
        velocity_limit=task.velocity_limit,
    )
    return dict(
        torque=torque,
        joint_velocity_before=before["joint_velocity"],
        timestep=env.dt,
        older_action=entries.older_action[state.entry],
        over_limit=env_lib.over_limit(robot, hyper, angle),
        **{name: x[after.entry] for name, x in entries.contact.items()},
    )


def of_log(log: Log, layout: view.View) -> Entries:
    """What the networks see of each entry, and what of it is known. Nothing was done before an episode."""
    parts, older = log.readings, np.zeros_like(log.readings["action"])
    previous, obs = np.zeros_like(older), []
    body = np.zeros(layout.body, np.float32)  # one robot's: the networks see the same in every row
    for episode in log_file.episodes(log):
        actions = parts["action"][episode]
        previous[episode][1:], older[episode][2:] = actions[:-1], actions[:-2]
        now = np.concatenate(
            [*(parts[name][episode] for name in log_file.SEEN), previous[episode]], 1
        )
        rest = view.rest_at_start(layout, now[0], body)
        for reading in now:
            obs.append(np.concatenate([reading, rest]))
            rest = view.rest_after(layout, obs[-1])
    return Entries(
        obs=np.stack(obs),
        action=parts["action"],
        older_action=older,
        fell=log.fell.astype(np.float32),
        goes_on=log.goes_on.astype(np.float32),
        contact={} if log.contact is None else _of_contact(log, log.contact),
    )


def _of_contact(log: Log, contact: np.ndarray) -> dict[str, np.ndarray]:
    """The fields `log_file.OF_CONTACT` of each entry; a swing is counted from the episode's start."""
    touchdown, lasted = np.zeros_like(contact), np.zeros(contact.shape, np.float32)
    for episode in log_file.episodes(log):
        steps, last = np.zeros(contact.shape[1]), np.zeros(contact.shape[1])
        for t in range(episode.start + 1, episode.stop):
            touchdown[t] = contact[t] & ~contact[t - 1]
            last = np.where(touchdown[t], steps * log.control_dt, last)
            steps = np.where(contact[t], 0, steps + 1)
            lasted[t] = last
    return dict(contact=contact, touchdown=touchdown, last_air_time=lasted)

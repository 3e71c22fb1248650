"""Environments without MuJoCo, small enough to be computed by hand and compiled at once.

`make` has every part of the velocity task's contract: predicted and copied observations, noise,
bodies of their own, falls, time limits, blow-ups, aged starts. `like_model` is an environment that
equals a transition model. `probe` makes environments whose values are known in closed form.
`settings` is a small valid config for them, split; toy_runs.py runs them.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from dynappo import config as config_lib
from dynappo.model import dynamics
from dynappo.types import Env, Outcome

DT = 0.1  # s, so that the first second, which evaluation leaves out, is 10 steps
START, LIMIT = 0.3, 1.5  # half width of the start; beyond the limit the tilt is a fall
A = ((0.8, 0.0, 0.0), (0.05, 1.1, 0.0), (0.5, -0.5, 0.5))  # speed, tilt (unstable), a trace of both
B = ((0.4, 0.0), (0.0, 0.2), (0.0, 0.0))
METRICS = ("reward_x", "reward_effort", "velocity_error_sq", "falls", "timeouts", "blowups")


@struct.dataclass
class State:
    """One toy robot."""

    prop: jax.Array  # without noise
    obs: jax.Array
    command: jax.Array
    last_action: jax.Array
    clock: jax.Array
    episode_steps: jax.Array
    episode_return: jax.Array


def configure(fields, spec):
    """The valid config of `spec` with `fields` (dotted names) set."""
    config = config_lib.load(spec)
    for name, value in (fields or {}).items():
        group, _, leaf = name.rpartition(".")
        functools.reduce(lambda node, key: node[key], group.split("."), config)[leaf] = value
    return config_lib.validate(config)


def settings(fields=None, variant="ppo12"):
    """`(config, static, hyper)`: 16 robots, 8 rows, narrow networks, and `fields` set."""
    small = {
        "rollout.num_envs": 16,
        "rollout.horizon": 8,
        "run.num_iterations": 6,
        "run.log_every": 3,
        "run.checkpoint_every": 0,
        "model.hidden": (24, 24),
        "model.epochs": 2,
        "ppo.hidden": (16, 16),
        "ppo.epochs": 2,
        "ppo.minibatches": 2,
        "ppo.shuffle_blocks": 2,
        "task.episode_length": 20,
    }
    config = configure(
        small | (fields or {}), "configs/go1.py" + (f":{variant}" if variant else "")
    )
    return config, *config_lib.split(config)


TAIL = {  # from no tail to half of the rows within the six iterations
    "schedule.start_iteration": 1,
    "schedule.end_iteration": 5,
    "schedule.start_steps": 0,
    "schedule.end_steps": 4,
}


@functools.cache
def make(*, episode_length: int = 20, aged: bool = True) -> Env:
    """A robot with a speed to hold and an unstable tilt.

    Of `hyper.task` it reads `command_x`, `noise.joint_pos`, `randomize.base_mass`, and `effort_limit`:
    a first action above that leaves a state of NaN behind, as a diverged solver does.
    """
    a, b = jnp.asarray(A), jnp.asarray(B)

    def randomize(hyper, key):
        low, high = hyper.task.randomize.base_mass
        return 10.0 / (10.0 + jax.random.uniform(key, (), minval=low, maxval=high))

    def observe(hyper, prop, command, last_action, key):
        noise = jax.random.uniform(key, prop.shape, minval=-1.0, maxval=1.0)
        noisy = prop + noise * hyper.task.noise.joint_pos
        return jnp.concatenate([noisy, command[None], last_action])

    def fresh(hyper, key):
        start_key, command_key, noise_key = jax.random.split(key, 3)
        prop = jax.random.uniform(start_key, (3,), minval=-START, maxval=START)
        low, high = hyper.task.command_x
        command = jax.random.uniform(command_key, (), minval=low, maxval=high)
        return State(
            prop=prop,
            obs=observe(hyper, prop, command, jnp.zeros(2), noise_key),
            command=command,
            last_action=jnp.zeros(2),
            clock=jnp.zeros((), jnp.int32),
            episode_steps=jnp.zeros((), jnp.int32),
            episode_return=jnp.zeros(()),
        )

    def retell(hyper, context, key):
        low, high = hyper.task.command_x
        return context.at[0].set(jax.random.uniform(key, (), minval=low, maxval=high))

    def reset(hyper, body, key):
        key, clock_key = jax.random.split(key)
        clock = jax.random.randint(clock_key, (), 0, episode_length) * aged
        return fresh(hyper, key).replace(clock=clock.astype(jnp.int32))

    def step(hyper, body, state, action, key):
        prop = a @ state.prop + body * (b @ action)
        prop = jnp.where(action[0] > hyper.task.effort_limit, jnp.nan, prop)
        ok = jnp.isfinite(prop).all()
        error = jnp.where(ok, (prop[0] - state.command) ** 2, 0.0)
        tracking, effort = jnp.where(ok, 1.0 - error, 0.0), -0.01 * (action**2).sum() * ok
        reward = DT * (tracking + effort)
        fell = (jnp.abs(prop[1]) > LIMIT) | ~ok
        clock = state.clock + 1
        timeout = (clock >= episode_length) & ~fell
        obs = jnp.where(ok, observe(hyper, prop, state.command, action, key), state.obs)
        after = state.replace(
            prop=prop,
            obs=obs,
            last_action=action,
            clock=clock,
            episode_steps=state.episode_steps + 1,
            episode_return=state.episode_return + reward,
        )
        terms = (tracking, effort, error, fell * 1.0, timeout * 1.0, ~ok * 1.0)
        return after, _outcome(after, reward, fell, timeout, dict(zip(METRICS, terms, strict=True)))

    def autoreset(hyper, body, state, outcome, key):
        return _choose(outcome, fresh(hyper, key), state)

    return Env(
        randomize=randomize,
        reset=reset,
        step=step,
        autoreset=autoreset,
        advance=lambda hyper, context, prop, action, next_prop: jnp.concatenate(
            [context[:1], action]
        ),
        sense=lambda hyper, prop, context, key: (
            prop
            + hyper.task.noise.joint_pos * jax.random.uniform(key, (3,), minval=-1.0, maxval=1.0)
        ),
        known_reward=lambda hyper, obs, action, prop: DT * (1.0 - (prop[0] - obs[3]) ** 2),
        retell=retell,
        metrics=METRICS,
        obs_size=6,
        prop_size=3,
        action_size=2,
        dt=DT,
        episode_length=episode_length,
    )


def _outcome(state, reward, fell, timeout, metrics):
    return Outcome(
        next_prop=jnp.where(metrics["blowups"], 0.0, state.prop),
        valid=1.0 - metrics["blowups"],
        reward=reward,
        discount=1.0 - fell,
        truncation=timeout * 1.0,
        next_obs=state.obs,
        episode_return=state.episode_return,
        episode_length=state.episode_steps * 1.0,
        metrics=metrics,
    )


def _choose(outcome, fresh, state):
    ended = (outcome.discount == 0) | (outcome.truncation == 1)
    return jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, state)


def like_model(static, model) -> Env:
    """An environment that is the transition model: no noise, no end."""
    env = make(aged=False)

    def step(hyper, body, state, action, key):
        obs, reward, _ = dynamics.predict(static, hyper, env, model, state.obs, action)
        after = state.replace(prop=obs[:3], obs=obs, last_action=action)
        none = jnp.zeros(())
        return after, _outcome(after, reward, none, none, dict.fromkeys(METRICS, none))

    return env._replace(step=step)


class Case(NamedTuple):
    """One probe; each is a number, so that `jax.vmap` over `hyper.task` runs several at once.

    The observation is `random` x (-1 or 1) + `time` x step; the reward `each` + `gain` x obs
    - `cost` x (action - `aim` - `follow` x obs)^2, plus `ending` at the last of `steps` steps. The
    episode ends for good, or by the time limit if `timeout`.
    """

    steps: int = 1
    timeout: float = 0.0
    random: float = 0.0
    time: float = 0.0
    each: float = 0.0
    ending: float = 0.0
    gain: float = 0.0
    cost: float = 0.0
    aim: float = 0.0
    follow: float = 0.0


class ProbeState(NamedTuple):
    """State of a probe: what it shows, the step of the episode, the reward so far."""

    obs: jax.Array
    steps: jax.Array
    total: jax.Array

    prop = property(lambda self: self.obs)


def probe() -> Env:
    """The environment whose `hyper.task` is a `Case`; observation and action are one number."""

    def reset(hyper, body, key):
        sign = 1.0 - 2.0 * jax.random.bernoulli(key)
        start = (hyper.task.random * sign)[None]
        return ProbeState(start, jnp.zeros((), jnp.int32), jnp.zeros(()))

    def step(hyper, body, state, action, key):
        case, count = hyper.task, state.steps + 1
        end = (count == case.steps) * 1.0
        obs, error = state.obs[0], action[0] - case.aim - case.follow * state.obs[0]
        reward = case.each + case.ending * end + case.gain * obs - case.cost * error**2
        after = ProbeState(state.obs + case.time, count, state.total + reward)
        outcome = Outcome(
            reward=reward,
            discount=1.0 - end * (1.0 - case.timeout),
            truncation=end * case.timeout,
            next_obs=after.obs,
            next_prop=after.obs,
            valid=jnp.ones(()),
            episode_return=after.total,
            episode_length=count * 1.0,
            metrics={},
        )
        return after, outcome

    return Env(
        randomize=lambda hyper, key: jnp.zeros(()),
        reset=reset,
        step=step,
        autoreset=lambda h, b, state, outcome, key: _choose(outcome, reset(h, b, key), state),
        metrics=(),
        obs_size=1,
        prop_size=1,
        action_size=1,
        dt=1.0,
        episode_length=1,
    )

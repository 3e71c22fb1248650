"""brax adapters: our task as a brax environment, and a brax or Playground one under our trainer.

    brax_env = to_brax(env, hyper)                            # then brax.envs.wrappers.training.wrap
    env = from_brax(envs.get_environment("hopper", backend="spring"), prop_size=11)

The second is a `types.Env` like any other:

    config = config_lib.load("configs/default.py")            # zero the schedule for plain PPO
    static, hyper = config_lib.split(config_lib.validate(config))
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    state, metrics = algorithm.run(env, hyper, state, schedule.columns(config), static=static)

`from_brax` needs `reset(rng)`, `step(state, action)`, `action_size` and a state with
`obs, reward, done, metrics, info`, which brax 0.14.2 and MuJoCo Playground 0.2.0 share. brax's own
trainers call `jax.device_put_replicated` and its swimmer `jnp.clip(a_min=)`, which JAX 0.10 lacks;
its wrappers, `acting.generate_unroll` and `acting.Evaluator` work.

Playground's locomotion tasks have a module of their own (`playground`), which computes what is known of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from brax import envs
from flax import struct
from jaxtyping import Array, Float, Int

from dynappo.config import ConfigError
from dynappo.types import Env, Hyper, Outcome

RESETTING = {"steps", "first_obs", "AutoResetWrapper_first_obs"}  # what wrappers leave in `info`
EVENTS = ("reward", "falls", "timeouts", "blowups")  # metrics beside brax's own


def to_brax(env: Env, hyper: Hyper, backend: str = "mjx") -> envs.Env:
    """`env` behind brax's protocol; `backend` is only a label.

    `done` is a fall and nothing else: brax's EpisodeWrapper counts the time itself and writes
    `info["truncation"] = 1 - done` at its limit. If an environment set `done` there too, time
    limits would be learned as falls. Give the wrappers the task's own `episode_length`; without
    them, `info["truncation"]` is 1 from that age on.

    `pipeline_state` is the whole state of the episode: it is what AutoResetWrapper puts back. What
    stays with the robot is in `info`: "body", its physical parameters, and "rng", the key of its
    next step, so that no two episodes see the same noise. Episodes start at age 0.
    """
    return _Task(env, hyper, backend)


class _Task(envs.Env):
    """A class because brax's protocol is one; it holds constants only."""

    def __init__(self, env: Env, hyper: Hyper, backend: str):
        self._env, self._hyper, self._backend = env, hyper, backend

    def reset(self, rng) -> envs.State:
        """A robot of its own body; keys of `split(rng, 3)`: body, first state, later steps."""
        body_key, reset_key, run_key = jax.random.split(_typed(rng), 3)
        body = self._env.randomize(self._hyper, body_key)
        state = self._env.reset(self._hyper, body, reset_key)
        if hasattr(state, "clock"):  # first episodes of a training environment may be aged
            state = state.replace(clock=jnp.zeros_like(state.clock))
        zero = jnp.zeros(())
        return envs.State(
            pipeline_state=state,
            obs=state.obs,
            reward=zero,
            done=zero,
            metrics=dict.fromkeys(self._env.metrics, zero),
            info={"rng": jax.random.key_data(run_key), "body": body, "truncation": zero},
        )

    def step(self, state: envs.State, action) -> envs.State:
        """`env.step` with the second key of `split(info["rng"])`; the first is kept."""
        run_key, key = jax.random.split(_typed(state.info["rng"]))
        after, outcome = self._env.step(
            self._hyper, state.info["body"], state.pipeline_state, action, key
        )
        metrics = {name: outcome.metrics[name] for name in self._env.metrics}
        info = {"rng": jax.random.key_data(run_key), "truncation": outcome.truncation}
        new = state.replace(
            pipeline_state=after,
            obs=outcome.next_obs,
            reward=outcome.reward,
            done=1.0 - outcome.discount,
            metrics={**state.metrics, **metrics},  # wrappers add their own to both
            info={**state.info, **info},
        )
        return _typed_as(state, new)

    observation_size = property(lambda self: self._env.obs_size)
    action_size = property(lambda self: self._env.action_size)
    backend = property(lambda self: self._backend)
    dt = property(lambda self: self._env.dt)  # s, one control step


def _typed(rng):
    """A typed key of either kind: brax hands over raw ones."""
    return rng if jnp.issubdtype(rng.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(rng)


class BraxState(struct.PyTreeNode):
    """One robot of a brax environment, and what brax leaves to its wrappers."""

    brax: Any  # the environment's own state
    obs: Float[Array, "... O"]
    prop: Float[Array, "... P"]  # its leading numbers: which noise brax added is not known
    clock: Int[Array, "..."]  # age of the episode in control steps; the first may start aged
    episode_steps: Int[Array, "..."]  # control steps since the reset
    episode_return: Float[Array, "..."]


def from_brax(
    brax_env: Any,
    prop_size: int | None = None,
    episode_length: int = 1000,
    *,
    advance: Callable | None = None,
    observe: Callable | None = None,
    action_limit: float = 1.0,
    starts: int = 4,
    random_clock: bool = True,
) -> Env:
    """A bare brax or Playground environment, seen as a `types.Env`; `hyper` is not read.

    `observe(state, action) -> [O]` is the observation, of brax's state and the action that led to
    it (zeros after a reset); default `state.obs`. The leading `prop_size` numbers of it are
    predicted, the rest is known: `advance(hyper, context, prop, action, next_prop)` is its next
    value, [O - P]. Without `prop_size`, plain PPO only. Actions are clipped to +-`action_limit`
    before the step: brax's policies end in a tanh.

    A `done` is a fall, `episode_length` control steps a truncation; `random_clock` ends the first
    episodes at random, so that time-outs spread. A step with an observation or reward that is not
    finite ends its episode with reward 0, counted in `blowups` and `falls`.

    An episode starts from one of `starts` states that each robot drew with `brax_env.reset` at
    first: under vmap a reset would run in every row for every robot. brax's wrapper keeps one, but
    puts back physics and observation only: last actions and air times in `info` leak into the next
    episode. Here all comes back but the random keys in `info`: no episode repeats another's noise.

    ConfigError for an environment that resets itself, or for sizes that do not fit.
    """
    observe = observe or (lambda state, action: state.obs)
    name, action_size = type(brax_env).__name__, brax_env.action_size
    first = jax.eval_shape(lambda: brax_env.reset(jax.random.key_data(jax.random.key(0))))
    obs_size = _obs_size(name, first, observe, action_size)
    if prop_size is None:
        prop_size, known = obs_size, partial(_no_split, name)
    else:
        known = advance or Env._field_defaults["advance"]
        _check_split(name, prop_size, obs_size, action_size, known)
    sizes = {"episode_length": episode_length, "starts": starts, "action_limit": action_limit}
    for field, value in sizes.items():
        if not value > 0:
            raise ConfigError(f"from_brax: {field} is {value}, expected more than 0")
    names = tuple(n for n, value in first.metrics.items() if value.shape == ())
    limits = action_limit, episode_length, starts, random_clock
    const = BraxConstants(brax_env, observe, prop_size, *limits, names)
    return Env(
        randomize=partial(_starts, const),
        reset=partial(_reset, const),
        step=partial(_step, const),
        autoreset=partial(_autoreset, const),
        advance=known,
        metrics=(*names, *EVENTS),
        obs_size=obs_size,
        prop_size=prop_size,
        action_size=action_size,
        dt=float(getattr(brax_env, "dt", 1.0)),  # it only scales what the model predicts
        episode_length=episode_length,
    )


class BraxConstants(NamedTuple):
    """What the functions of a brax environment need; constants of the program."""

    brax_env: Any
    observe: Callable
    prop_size: int
    action_limit: float
    episode_length: int  # control steps
    starts: int
    random_clock: bool
    names: tuple[str, ...]  # of brax's metrics


def _starts(const: BraxConstants, hyper: Hyper, key):
    """The robot's `body`: the brax states that its episodes start from, `[starts]`."""
    keys = jax.random.key_data(jax.random.split(key, const.starts))
    return jax.vmap(const.brax_env.reset)(keys)


def _reset(const: BraxConstants, hyper: Hyper, body, key) -> BraxState:
    key, clock_key = jax.random.split(key)
    clock = jax.random.randint(clock_key, (), 0, const.episode_length, jnp.int32)
    return _fresh(const, body, key).replace(clock=clock * const.random_clock)


def _fresh(const: BraxConstants, body, key) -> BraxState:
    index = jax.random.randint(key, (), 0, const.starts)
    first = jax.tree.map(lambda x: x[index], body)
    obs, zero = (
        const.observe(first, jnp.zeros(const.brax_env.action_size)),
        jnp.zeros((), jnp.int32),
    )
    prop = obs[: const.prop_size]
    return BraxState(first, obs, prop, clock=zero, episode_steps=zero, episode_return=zero * 1.0)


def _autoreset(
    const: BraxConstants, hyper: Hyper, body, state: BraxState, outcome: Outcome, key
) -> BraxState:
    ended = (outcome.discount == 0) | (outcome.truncation == 1)
    new = _fresh(const, body, key)
    info = jax.tree.map(lambda x, now: now if _is_key(now) else x, new.brax.info, state.brax.info)
    new = new.replace(brax=new.brax.replace(info=info))
    return jax.tree.map(lambda x, now: jnp.where(ended, x, now), new, state)


def _step(const: BraxConstants, hyper: Hyper, body, state: BraxState, action, key):
    """One control step -> `(BraxState, Outcome)`; never resets."""
    before = jax.tree.map(lambda x: x, state.brax)  # brax's steps write into the dicts they get
    after = const.brax_env.step(before, jnp.clip(action, -const.action_limit, const.action_limit))
    obs = const.observe(after, action)
    ok = jnp.isfinite(obs).all() & jnp.isfinite(after.reward)
    obs = jnp.where(ok, obs, state.obs)
    reward, clock = jnp.where(ok, after.reward, 0.0), state.clock + 1
    fell = (after.done > 0) | ~ok
    timeout = (clock >= const.episode_length) & ~fell
    steps, total = state.episode_steps + 1, state.episode_return + reward
    brax, prop = _typed_as(state.brax, after), obs[: const.prop_size]
    next_state = BraxState(brax, obs, prop, clock, steps, total)
    metrics = {name: jnp.where(ok, after.metrics[name], 0.0) for name in const.names}
    metrics |= dict(zip(EVENTS, (reward, fell * 1.0, timeout * 1.0, ~ok * 1.0), strict=True))
    outcome = Outcome(
        reward=reward,
        discount=1.0 - fell,
        truncation=timeout * 1.0,
        next_obs=obs,
        next_prop=prop,
        valid=ok * 1.0,
        episode_return=total,
        episode_length=steps * 1.0,
        metrics=metrics,
    )
    return next_state, outcome


def _typed_as(old, new):
    """`new` with the types of `old`: a step may return Python numbers, bools, weak types."""
    return jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), new, old)


def _is_key(x):
    """Whether a leaf of one robot's `info` is a random key, typed or raw."""
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key) or (x.dtype, x.shape) == (jnp.uint32, (2,))


def _obs_size(name, first, observe, action_size) -> int:
    """O, of the shapes of a first state; ConfigError if it is not one flat vector."""
    wraps = sorted(RESETTING & set(first.info))
    if wraps:
        raise ConfigError(
            f"from_brax: {name} counts or resets episodes itself (info[{wraps[0]!r}]), expected the "
            "bare environment: brax.envs.get_environment, not brax.envs.create"
        )
    obs = jax.eval_shape(observe, first, jnp.zeros(action_size))
    if len(getattr(obs, "shape", ())) != 1:
        shapes = jax.tree.map(lambda x: x.shape, obs)
        raise ConfigError(
            f"from_brax: the observation of {name} is {shapes}, expected one vector; give observe"
        )
    return obs.shape[0]


def _no_split(name, *row):
    """`advance` of an environment without prop_size; only a tail asks for it."""
    raise ConfigError(
        f"the schedule asks for a tail, but from_brax({name}) was given no prop_size: say how many "
        "leading numbers of the observation are predicted, or set the schedule to zero"
    )


def _check_split(name, prop_size, obs_size, action_size, advance):
    if not 0 < prop_size <= obs_size:
        raise ConfigError(f"from_brax: prop_size is {prop_size}, {name} needs 1 to {obs_size}")
    context, prop, action = map(jnp.zeros, (obs_size - prop_size, prop_size, action_size))
    found = jax.eval_shape(partial(advance, None), context, prop, action, prop).shape
    if found != context.shape:
        raise ConfigError(
            f"from_brax: advance gives {found}, expected {context.shape}: of the {obs_size} numbers "
            f"that {name} shows, prop_size = {prop_size} are predicted"
        )

"""Rows of a linear world without physics, and transition models of it that need no training."""

import functools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import toy_env

from dynappo import config as config_lib
from dynappo import fast, rollout
from dynappo.model import dynamics, examples
from dynappo.types import Env, Moments

PROP, COMMAND, ACTIONS = 4, 2, 2
OBS = PROP + COMMAND + ACTIONS  # predicted part, then the command and the previous action
DT, HORIZON, ROBOTS = 0.02, 8, 32
FIELDS = {"hidden": (32, 32), "minibatches": 4}  # of group model; the rest is `dyna4`'s

ENV = Env(
    randomize=None,
    reset=None,
    step=None,
    autoreset=None,
    advance=lambda hyper, context, prop, action, next_prop: jnp.concatenate(
        [context[..., :COMMAND], action], -1
    ),
    known_reward=lambda hyper, obs, action, prop: (
        hyper.task.tracking_std * prop[0] * obs[PROP] + action[0]
    ),
    metrics=(),
    obs_size=OBS,
    prop_size=PROP,
    action_size=ACTIONS,
    dt=DT,
    episode_length=1000,
)


def settings(horizon=HORIZON, **fields):
    """`(static, hyper)` with fields of group model set: a small network, 4 minibatches."""
    sizes = {"rollout.num_envs": ROBOTS, "rollout.horizon": horizon, "schedule.end_steps": 1}
    fields = {f"model.{name}": value for name, value in (FIELDS | fields).items()}
    return config_lib.split(toy_env.configure(sizes | fields, "configs/go1.py:dyna4"))


@functools.cache
def fit(static):
    """`fit(hyper, model, rows, n_real, epochs, key)` of a rollout's rows, compiled once for each setting."""
    return jax.jit(partial(fit_rows, fast.fit, static))


def fit_rows(fit, static, hyper, model, rows, n_real, epochs, key, env=ENV):
    """`fit`, `fast.fit` or `dynamics.fit`, of the rows `t < n_real` of a rollout."""
    rows = examples.examples(static, hyper, env, rows, n_real)
    return fit(static, hyper, model, rows, epochs, key)


def linear_rows(seed, horizon=HORIZON):
    """Rows [N, R] of a world whose change of state and reward are linear, of unlike sizes."""
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 10.0, 0.1, 1.0] + [1.0] * (OBS - PROP))
    shift = np.array([5.0, 0.0, 0.0, -3.0] + [0.0] * (OBS - PROP))
    obs = shift + size * rng.normal(size=(horizon, ROBOTS, OBS))
    action = rng.normal(size=(horizon, ROBOTS, ACTIONS))
    world = np.random.default_rng(99)  # the same for every seed
    matrix = world.normal(size=(OBS + ACTIONS, PROP + 1))
    y = (np.concatenate([(obs - shift) / size, action], -1) @ matrix) / 3
    change = 0.1 * size[:PROP] * y[..., :PROP]
    rows = jax.tree.map(np.asarray, rollout.allocate(ENV, horizon, ROBOTS))
    next_obs = np.concatenate(
        [obs[..., :PROP] + change, ENV.advance(None, obs[..., PROP:], None, action, None)], -1
    )
    ones = np.ones((horizon, ROBOTS))
    rows = rows.replace(
        obs=obs, action=action, next_obs=next_obs, reward=DT * y[..., PROP], discount=ones
    )
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)


@functools.cache
def start(static, env=ENV):
    """An untrained model, the same for all tests of a setting."""
    return jax.jit(partial(dynamics.init, static, env))(jax.random.key(0))


def that_says(output, model):
    """`model` whose network says `output` whatever it is asked."""
    layers = dict(model.params["params"])
    last = f"Dense_{len(layers) - 1}"
    kernel = jnp.zeros_like(layers[last]["kernel"])
    layers[last] = {"kernel": kernel, "bias": jnp.asarray(output, jnp.float32)}
    return model.replace(params={"params": layers})


def constant_model(static, output, mean, std):
    """A model whose network says `output` whatever it is asked; targets have this mean and std."""
    targets = Moments(
        mean=0.5 * jnp.asarray(mean), var=0.5 * jnp.asarray(std) ** 2, weight=jnp.float32(0.5)
    )
    return that_says(output, start(static)).replace(targets=targets)

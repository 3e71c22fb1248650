"""What is known of the next state: a phase, the place along a track, the ground there, the last action.

A tail of an untrained model is compared with a NumPy loop over the model's own predictions.
"""

import jax
import jax.numpy as jnp
import numpy as np
import toy_model

from dynappo.learner import networks
from dynappo.model import dynamics, examples
from dynappo.types import Env, Transition, Views

DT, ROBOTS, ROWS = 0.1, 5, 6
PROP, OBS = 2, 6  # speed and height are predicted | phase, place, ground, last action
PHASE, PLACE, GROUND, LAST = range(4)


def ground(place, xp):
    return 0.3 * xp.sin(2 * place)


def advance(hyper, context, prop, action, next_prop):
    place = context[PLACE] + DT * next_prop[0]
    return jnp.stack([(context[PHASE] + DT) % 1.0, place, ground(place, jnp), action[0]])


def sense(hyper, prop, context, key):
    """A height is read above the ground, and a little off."""
    return prop - jnp.array([0.0, 1.0]) * context[GROUND] + 0.01 * jax.random.normal(key, (PROP,))


def known_reward(hyper, obs, action, next_prop):
    return DT * (next_prop[0] - obs[PROP + PLACE])


UNSEEN = PROP + PLACE  # no network is told where it is
SEEN = np.delete(np.arange(OBS), UNSEEN)
ENV = Env(
    reset=lambda *_: None,
    step=lambda *_: None,
    autoreset=lambda *_: None,
    obs_size=OBS,
    prop_size=PROP,
    action_size=1,
    dt=DT,
    episode_length=10,
    advance=advance,
    sense=sense,
    known_reward=known_reward,
    views=Views(actor=SEEN, critic=SEEN, model=SEEN),
)


def start(rng):
    """Rows as physics would have written them, of which tails begin."""
    obs = rng.normal(size=(ROWS, ROBOTS, OBS)).astype(np.float32)
    obs[..., PROP + GROUND] = ground(obs[..., PROP + PLACE], np)
    names = Transition.__dataclass_fields__
    blank = dict.fromkeys(names, jnp.zeros((ROWS, ROBOTS)))
    return Transition(**blank).replace(obs=jnp.asarray(obs), prop=jnp.asarray(obs[..., :PROP]))


def test_a_tail_computes_what_is_known_from_what_it_predicts():
    """Phase, place and ground follow the predicted speeds to the last digit; anchors are rows' own."""
    static, hyper = toy_model.settings(clean=True, known_reward=True)
    model = dynamics.init(static, ENV, jax.random.key(0))
    rng = np.random.default_rng(0)
    anchors = dynamics.anchors(static, ENV, start(rng), jnp.int32(ROWS), jax.random.key(1))
    state, step = anchors, jax.jit(dynamics.step(static, hyper, ENV, model))
    place, phase = (np.array(state.obs[:, PROP + i]) for i in (PLACE, PHASE))
    for t in range(8):
        action = jnp.asarray(rng.normal(size=(ROBOTS, 1)), jnp.float32)
        keys = jax.random.split(jax.random.key(t), ROBOTS)
        before, (state, outcome) = state, step(state, action, keys)
        reward = _rest(static, model, before, action)
        reward += DT * (np.asarray(outcome.next_prop[:, 0]) - place)
        np.testing.assert_allclose(outcome.reward, reward, rtol=1e-4, atol=1e-5)
        place, phase = place + DT * np.asarray(outcome.next_prop[:, 0]), (phase + DT) % 1.0
        expected = np.stack([phase, place, ground(place, np), action[:, 0]], -1)
        np.testing.assert_allclose(state.obs[:, PROP:], expected, atol=1e-5)
        read = np.asarray(state.prop) - np.array([0, 1]) * expected[:, [GROUND]]
        np.testing.assert_allclose(state.obs[:, :PROP], read, atol=0.06)
        assert (state.obs[:, :PROP] != read).all()
        np.testing.assert_array_equal(outcome.next_obs, state.obs)
    assert np.ptp(place - np.asarray(anchors.obs[:, PROP + PLACE])) > 0.01


def _rest(static, model, state, action):
    """The share of the reward that the model learns."""
    seen = jnp.concatenate([state.prop, state.obs[:, PROP:]], -1)
    (mean, std), (y_mean, y_std) = dynamics.scales(static, model)
    x = (examples.inputs(ENV, seen, action) - mean) / std
    y = networks.apply(dynamics.network(static, PROP), model.params, x) * y_std + y_mean
    return np.asarray(y[:, PROP]) * DT


def test_what_no_network_should_see_none_sees():
    """Another place changes neither what the model predicts nor what a policy is given."""
    static, hyper = toy_model.settings(clean=True)
    model = dynamics.init(static, ENV, jax.random.key(0))
    obs = jnp.asarray(np.random.default_rng(1).normal(size=(ROBOTS, OBS)), jnp.float32)
    moved = obs.at[:, UNSEEN].add(3.0)
    action = jnp.ones((ROBOTS, 1))
    one, other = (dynamics.predict(static, hyper, ENV, model, x, action)[0] for x in (obs, moved))
    np.testing.assert_array_equal(one[:, :PROP], other[:, :PROP])
    np.testing.assert_allclose(other[:, UNSEEN] - one[:, UNSEEN], 3.0, rtol=1e-5)
    one, other = (networks.inputs(static, ENV, x, x[:, :PROP])[0] for x in (obs, moved))
    np.testing.assert_array_equal(one, other)

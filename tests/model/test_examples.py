"""Rows that the model learns from: what it carries beside the observation, and earlier iterations."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from test_algorithm import N, R, observe, row
from test_tail import ON, moved, settings

from dynappo import algorithm
from dynappo.model import dynamics, examples

DT = toy_env.DT


@pytest.fixture(scope="module")
def env():
    """The toy environment; private there are the body b and its square."""
    return toy_env.make()


def grown(env, fields, iterations=3):
    """`(static, hyper, state, rows)` of some iterations, of the last with five real rows."""
    config, static, hyper = settings(ON | {"task.randomize.base_mass": (-5.0, 5.0)} | fields)
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    call, rows = observe(env, static), None
    for i in range(1, iterations + 1):
        n_real = 5 if i == iterations else N
        rows, state, _ = call(hyper, state, row(config, first=i, n_real=n_real, epochs=20))
    return static, hyper, state, jax.device_get(rows)


@pytest.fixture(scope="module")
def private(env):
    """A run whose model carries the body, too."""
    return grown(env, {"model.private": True})


# ---- what no observation shows


def test_real_rows_hold_the_private_numbers_before_and_after(private):
    _, _, state, rows = private
    body = np.broadcast_to(np.asarray(state.params_physics), (N, R))[:5]
    assert rows.prop.shape == (N, R, 5) and body.std() > 0.1
    for prop in (rows.prop, rows.next_prop):
        np.testing.assert_allclose(prop[:5, ..., 3], body, 1e-6)
        np.testing.assert_allclose(prop[:5, ..., 4], body**2, 1e-6)
    expected = moved(state.params_physics, rows.prop[..., :3], rows.action)
    np.testing.assert_allclose(rows.next_prop[:5, ..., :3], expected[:5], 1e-5, 1e-5)


def test_a_tail_carries_private_numbers_and_hides_them_from_the_policy(private):
    _, _, state, rows = private
    np.testing.assert_array_equal(rows.prop[5, :, :3], state.env_state.prop)
    np.testing.assert_array_equal(rows.prop[5, :, 3], state.params_physics)
    np.testing.assert_array_equal(rows.prop[6:], rows.next_prop[5:-1])
    assert not np.array_equal(rows.prop[6:, :, 3], rows.prop[5:-1, :, 3])  # predicted, not copied
    assert rows.obs.shape == (N, R, 6)
    np.testing.assert_array_equal(rows.obs[6:], rows.next_obs[5:-1])
    np.testing.assert_array_equal(rows.next_obs[5:, :, 3], rows.obs[5:, :, 3])  # the command
    np.testing.assert_array_equal(rows.next_obs[5:, :, 4:], rows.action[5:])
    noise = (rows.next_obs[..., :3] - rows.next_prop[..., :3])[5:]
    assert 0 < np.abs(noise).max() <= 0.3 + 1e-5


def test_the_known_reward_reads_the_policys_observation_and_not_the_private_numbers(env, private):
    static, hyper, _, rows = private
    rest = examples.targets(static.model, env, rows, hyper.task)[..., 5]
    effort = -0.01 * (rows.action**2).sum(-1)
    np.testing.assert_allclose(rest[:5], effort[:5], 1e-3, 1e-5)


def test_a_model_that_knows_the_body_predicts_its_robot_better(env):
    """b multiplies the action in the toy's physics; without it the model can only know the mean."""
    rng, count, errors = np.random.default_rng(0), 256, {}
    prop, action = (rng.normal(size=(N, count, k)) for k in (3, 2))
    body = rng.uniform(0.5, 2.0, count)
    after, own = (
        moved(body, prop, action),
        np.broadcast_to(np.stack([body, body**2], -1), (N, count, 2)),
    )
    for name in (False, True):
        _, static, hyper = settings(ON | {"model.private": name, "model.bounds": False})
        rows = algorithm.rollout.allocate(env, N, count)
        carried = [np.concatenate([x, own], -1) if name else x for x in (prop, after)]
        numbers = dict(prop=carried[0], next_prop=carried[1], action=action)
        rows = rows.replace(**{n: jnp.asarray(x, jnp.float32) for n, x in numbers.items()})
        rows = rows.replace(valid=rows.valid + 1, discount=rows.discount + 1)
        model = dynamics.init(static.model, env, jax.random.key(0))
        fit = jax.jit(partial(dynamics.fit, static.model, hyper.model, env))
        model, _ = fit(model, rows, jnp.int32(N), jnp.int32(120), jax.random.key(1), hyper.task)
        obs = examples.before_and_after(static.model, env, rows)[0]
        call = partial(dynamics.predict, static.model, env, model, task=hyper.task)
        found = jax.vmap(call)(obs, rows.action)[0][..., :2]
        errors[name] = np.abs(np.asarray(found) - after[..., :2]).mean()
    assert errors[True] < 0.5 * errors[False]


# ---- rows of earlier iterations


def numbers(static, env, rows, hyper, n_real=N):
    x, y, weight = examples.examples(static.model, env, rows, n_real, hyper.task)
    return np.concatenate([x, y, np.asarray(weight)[..., None]], -1)


def test_the_first_rows_of_the_last_iterations_are_kept(env):
    """By hand: four of eight rows are real in every iteration, of two iterations."""
    config, static, hyper = settings(ON | {"model.history": 2})
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    call, seen = observe(env, static), []
    np.testing.assert_array_equal(state.past, np.zeros((R, 8, state.past.shape[-1])))
    for i, n_real in enumerate((N, 5, 6), start=1):
        rows, state, _ = call(hyper, state, row(config, first=i, n_real=n_real))
        seen.insert(0, numbers(static, env, rows, hyper, n_real)[:4])
        kept = np.concatenate(seen[:2]).swapaxes(0, 1)
        np.testing.assert_allclose(state.past[:, : kept.shape[1]], kept, 1e-5, 1e-6)


def test_the_fit_draws_as_many_rows_of_each_iteration(env):
    """A model that says 0, targets 1 now and 3 in both earlier iterations: the mean loss is known."""
    fields = {"model.history": 2, "model.normalize": False, "model.huber_delta": 1e9}
    _, static, hyper = settings(ON | fields | {"model.falls": False, "model.known_reward": False})
    rows = algorithm.rollout.allocate(env, N, 4096)
    rows = rows.replace(valid=rows.valid + 1, discount=rows.discount + 1)
    rows = rows.replace(reward=rows.reward + DT, next_prop=rows.next_prop + 1)
    model = dynamics.init(static.model, env, jax.random.key(0))
    model = model.replace(params=jax.tree.map(jnp.zeros_like, model.params))
    past = jnp.zeros((4096, 8, 8 + 4 + 1)).at[..., 8:12].set(3.0).at[..., 12].set(1.0)
    fit = jax.jit(partial(dynamics.fit, static.model, hyper.model, env))
    ask = partial(fit, model, rows, jnp.int32(N), jnp.int32(1), jax.random.key(1), hyper.task)
    expected = 0.5 * (1 / 3 * 1.0 + 2 / 3 * 9.0)
    np.testing.assert_allclose(ask(past)[1]["model_loss_before"], expected, rtol=0.02)
    # rows that were never written weigh nothing
    np.testing.assert_allclose(ask(0 * past)[1]["model_loss_before"], 0.5, rtol=1e-4)


def test_the_model_learns_from_earlier_rows_where_this_iteration_has_none(env):
    config, static, hyper = settings(ON | {"model.history": 1})
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    rows, state, _ = observe(env, static)(hyper, state, row(config, n_real=N))
    none = rows.replace(valid=0 * rows.valid)
    fit = jax.jit(partial(dynamics.fit, static.model, hyper.model, env))
    found = {}
    for name, past in (("kept", state.past), ("forgotten", 0 * state.past)):
        args = jnp.int32(N), jnp.int32(30), jax.random.key(2), hyper.task, past
        model, _ = fit(state.model, none, *args)
        found[name] = np.abs(numbers(static, env, rows, hyper)[..., :8]).sum(), model
    before, kept = state.model, found["kept"][1]
    x, y, weight = examples.examples(static.model, env, rows, N, hyper.task)

    def loss(model):
        (x_mean, x_std), (y_mean, y_std) = dynamics._scales(static.model, before)
        batch = (x - x_mean) / x_std, (y - y_mean) / y_std, weight
        return float(dynamics.loss(static.model, model.params, [batch], 1.0))

    assert loss(kept) < 0.9 * loss(before)
    assert loss(kept) < loss(found["forgotten"][1])

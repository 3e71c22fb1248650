"""The slope of the return through the model: against differences, and what the update makes of it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from test_algorithm import N, R, leaves, observe, row
from test_tail import ON, settings

from dynappo import algorithm, dynamics, first_order, networks, ppo, rollout

STEPS = 3


@pytest.fixture(scope="module")
def learned():
    """`(env, config, static, hyper, state)` after some iterations, with the slope on."""
    env = toy_env.make()
    config, static, hyper = settings(
        ON | {"ppo.first_order_steps": STEPS, "ppo.first_order_weight": 0.7}
    )
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    call = observe(env, static)
    for i in (1, 2):
        _, state, _ = call(hyper, state, row(config, first=i, n_real=5, epochs=20))
    return env, config, static, hyper, state


def ingredients(learned):
    """`(step, tail, keys, draws)`: of the tail after the state, and the actions' noise [STEPS, R, A]."""
    env, _, static, hyper, state = learned
    step = algorithm.model_step(env, hyper.task, state.model, static=static)
    tail = dynamics.tail(static.model, env, state.env_state)
    keys = rollout.row_keys(jax.random.key(7), state.robot_index)
    draws = [[jax.random.normal(k, (2,)) for k in keys(t)] for t in range(STEPS)]
    return step, tail, keys, np.array(draws)


def expected_return(learned, params):
    """J by a loop: the policy's actions, the model's rewards and discounts, the value at the end."""
    _, _, static, hyper, state = learned
    step, now, keys, draws = ingredients(learned)
    alive, total = np.ones(R), np.zeros(R)
    for k in range(STEPS):
        mean = networks.policy(static.ppo, params, now.obs)
        now, outcome = step(now, mean + params["std"] * draws[k], keys(k))
        total += hyper.ppo.gamma**k * alive * np.asarray(outcome.reward, float)
        alive = alive * np.asarray(outcome.discount, float)
    value = networks.value(static.ppo, state.learner.params, now.obs)
    return (total + hyper.ppo.gamma**STEPS * alive * np.asarray(value, float)).mean()


def test_the_gradient_is_the_difference_quotient_of_the_return(learned):
    """Along random directions of actor and std; -0.7 / (3 x 2) of it, the unit being 2."""
    _, _, static, hyper, state = learned
    params = state.learner.params
    step, tail, keys, _ = ingredients(learned)
    ask = jax.jit(lambda p: first_order.gradient(static.ppo, hyper.ppo, p, step, tail, keys, 2.0))
    slope = ask(params)
    for leaf in jax.tree.leaves(slope["critic"]):
        np.testing.assert_array_equal(leaf, 0)
    size = 1e-3
    for seed in range(4):
        draw = np.random.default_rng(seed).normal
        shift = jax.tree.map(lambda x, draw=draw: jnp.asarray(draw(size=x.shape), x.dtype), params)
        shift["critic"] = jax.tree.map(jnp.zeros_like, shift["critic"])
        if seed == 3:  # std alone
            shift["actor"] = jax.tree.map(jnp.zeros_like, shift["actor"])
        there = []
        for e in (size, -size):
            end = jax.tree.map(lambda p, s, e=e: p + e * s, params, shift)
            there.append(expected_return(learned, end))
        quotient = -0.7 / (STEPS * 2) * (there[0] - there[1]) / (2 * size)
        found = sum(
            (a * b).sum() for a, b in zip(*map(jax.tree.leaves, (slope, shift)), strict=True)
        )
        assert abs(quotient) > 1e-4
        np.testing.assert_allclose(found, quotient, rtol=0.03, atol=1e-5)


def test_an_update_with_a_slope_is_that_of_a_loss_with_the_linear_term(learned):
    env, config, static, hyper, state = learned
    rows, _, _ = observe(env, static)(hyper, state, row(config, first=3, n_real=5))
    real = (np.arange(N) < 5)[:, None]
    batch = algorithm.estimate(static.ppo, hyper.ppo, state.learner.params, rows, real, True)
    params, key = state.learner.params, jax.random.key(3)
    rng = np.random.default_rng(0)
    slope = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape) * 0.1, x.dtype), params)
    update = partial(ppo.update, static.ppo, hyper.ppo, state.learner, batch, key)
    found, _ = jax.jit(lambda: update(slope))()
    plain, _ = jax.jit(lambda: update())()
    loss = ppo.loss

    def with_term(static, hyper, params, batch, old_std):
        total, metrics = loss(static, hyper, params, batch, old_std)
        terms = jax.tree.map(lambda p, s: (p * s).sum(), params, slope)
        return total + sum(jax.tree.leaves(terms)), metrics

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo, "loss", with_term)
        expected, _ = jax.jit(lambda: update())()
    one, other = leaves(found.params), leaves(expected.params)
    for name in one:
        np.testing.assert_allclose(one[name], other[name], 1e-4, 1e-5, err_msg=name)
    assert any(np.abs(one[n] - x).max() > 1e-3 for n, x in leaves(plain.params).items())


def test_an_iteration_hands_the_update_the_slope_of_its_own_tail(learned):
    """From where physics ended, in units of the advantages, at the parameters that made the rollout."""
    env, config, static, hyper, state = learned
    seen, update = {}, ppo.update

    def spy(static, hyper, learner, batch, key, slope=None):
        seen.update(slope=slope, unit=batch.advantages.std())
        return update(static, hyper, learner, batch, key, slope)

    def call(hyper, state, columns):
        after, _ = algorithm.iterate(env, hyper, state, columns, static=static)
        return after, seen["slope"], seen["unit"]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo, "update", spy)
        after, slope, unit = jax.jit(call)(hyper, state, row(config, first=3, n_real=5))
    step = algorithm.model_step(env, hyper.task, after.model, static=static)
    tail = dynamics.tail(static.model, env, after.env_state)
    rows_key = jax.random.fold_in(jax.random.fold_in(state.key, 3), algorithm.ROWS)
    keys = rollout.row_keys(rows_key, state.robot_index)
    beyond, params = lambda k: keys(N + k), state.learner.params
    expected = first_order.gradient(static.ppo, hyper.ppo, params, step, tail, beyond, unit)
    one, other = leaves(slope), leaves(expected)
    for name in one:
        np.testing.assert_allclose(one[name], other[name], 1e-3, 1e-6, err_msg=name)
    assert max(np.abs(x).max() for x in one.values()) > 1e-4

"""The error of the model's predictions against loops over robots."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toy_model import ENV, HORIZON, PROP, ROBOTS, constant_model, fit, linear_rows, settings, start

from dynappo.model import dynamics, errors, moments


def test_the_error_of_several_steps_is_that_of_a_loop_over_robots():
    """Robots that ended an episode on the way are left out of the number they had not reached."""
    static, hyper = settings()
    rows = linear_rows(5)
    model, _ = fit(static)(hyper, start(static), rows, HORIZON, 3, jax.random.key(0))
    discount, truncation = np.array(rows.discount), np.array(rows.truncation)
    discount[0, 3] = discount[2, 4] = truncation[1, 5] = 1
    discount[0, 3] = discount[2, 4] = 0
    rows = rows.replace(discount=discount, truncation=truncation)
    found = errors.errors(static, hyper, ENV, model, jax.tree.map(jnp.asarray, rows), 4)
    assert found.keys() == {"model_error_1", "model_error_4"}
    std = np.array(moments.scale(model.inputs)[1])[:PROP]
    predict = jax.jit(partial(dynamics.predict, static, hyper, ENV))
    for steps, left_out in ((1, {3}), (4, {3, 4, 5})):
        wrong, still = 0.0, 0.0
        for i in sorted(set(range(ROBOTS)) - left_out):
            obs = rows.obs[0, i]
            for k in range(steps):
                obs = predict(model, obs, rows.action[k, i])[0]
            truth = rows.next_obs[steps - 1, i, :PROP]
            wrong += (((obs[:PROP] - truth) / std) ** 2).sum()
            still += (((rows.obs[0, i, :PROP] - truth) / std) ** 2).sum()
        np.testing.assert_allclose(found[f"model_error_{steps}"], np.sqrt(wrong / still), 1e-4)


def test_a_perfect_model_has_error_0_and_one_that_repeats_the_state_1():
    static, hyper = settings()
    rows = jax.tree.map(jnp.asarray, linear_rows(6))
    repeats = constant_model(static, np.zeros(PROP + 1), np.zeros(PROP + 1), np.ones(PROP + 1))
    assert errors.errors(static, hyper, ENV, repeats, rows, 1)["model_error_1"] == pytest.approx(1)
    known = rows.replace(next_obs=rows.next_obs.at[0, :, :PROP].set(rows.obs[0, :, :PROP]))
    assert errors.errors(static, hyper, ENV, repeats, known, 1)["model_error_1"] == 0

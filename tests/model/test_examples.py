"""What the model learns from, against NumPy row by row, for every combination of its options."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toy_model import ACTIONS, DT, ENV, HORIZON, OBS, PROP, ROBOTS, settings

from dynappo import rollout
from dynappo.model import examples

PAID = -2.5  # a fall pays this once
PAYING = ENV._replace(fall_reward=lambda hyper: 5 * PAID * hyper.task.tracking_std)
OPTIONS = ("clean", "known_reward", "falls", "predict_change")


@pytest.fixture(scope="module")
def rows():
    """Random numbers in every field; a tenth of the rows fell, timed out, or blew up, each."""
    rng = np.random.default_rng(0)
    blank = rollout.allocate(ENV, HORIZON, ROBOTS)
    found = jax.tree.map(lambda x: rng.normal(size=x.shape).astype(np.float32), blank)
    event = rng.random((HORIZON, ROBOTS))
    return found.replace(
        discount=np.float32(event > 0.2),
        truncation=np.float32((event > 0.2) & (event < 0.3)),
        valid=np.float32(event > 0.1),
    )


def example(hyper, row, clean, known_reward, falls, predict_change, paid=0.0):
    """`(input, target, weight)` of one real row."""
    before, after = row.obs[:PROP], row.next_obs[:PROP]
    if clean:
        before, after = row.prop, row.next_prop
    reward = row.reward
    if known_reward:
        seen = np.concatenate([before, row.obs[PROP:]])
        reward = reward - ENV.known_reward(hyper, seen, row.action, after)
    if falls and row.discount == 0:
        reward = reward - paid
    target = [*(after - before if predict_change else after), reward / DT]
    target += [row.discount == 0] * falls
    on = clean or falls  # then fallen rows count, and only those that blew up do not
    weight = row.valid if on else row.discount == 1 and row.truncation == 0
    return np.concatenate([before, row.obs[PROP:], row.action]), np.array(target), weight


@pytest.mark.parametrize("options", [(True, True, True, True), (False,) * 4], ids=str)
def test_the_reward_of_a_fall_is_no_target_where_falls_are_predicted(rows, options):
    """By a loop over rows; without `falls` it is a part of the reward as any other."""
    static, hyper = settings(**dict(zip(OPTIONS, options, strict=True)))
    hyper = hyper._replace(task=hyper.task._replace(tracking_std=0.2))
    found = examples.examples(static, hyper, PAYING, jax.tree.map(jnp.asarray, rows), HORIZON)
    fallen = 0
    for t, r in np.ndindex(HORIZON, ROBOTS):
        row = jax.tree.map(lambda a, t=t, r=r: a[t, r], rows)
        _, y, valid = example(hyper, row, *options, paid=PAID)
        fallen += valid and row.discount == 0
        np.testing.assert_allclose(found.y[t, r], y if valid else 0 * y, 1e-4, 1e-4)
    assert fallen > 5 or not options[2]


@pytest.mark.parametrize("options", itertools.product((False, True), repeat=4), ids=str)
def test_examples_are_those_of_a_loop_over_rows(rows, options):
    """Change of state or next state, reward per second or its unknown rest, falls; zeros elsewhere."""
    static, hyper = settings(**dict(zip(OPTIONS, options, strict=True)))
    n_real, used = 5, 0
    found = examples.examples(static, hyper, ENV, jax.tree.map(jnp.asarray, rows), n_real)
    assert found.count == n_real
    x, y, weight = map(np.asarray, found[:3])
    assert x.shape == (HORIZON, ROBOTS, OBS + ACTIONS)
    assert y.shape == (HORIZON, ROBOTS, PROP + 1 + options[2])
    for t, r in np.ndindex(HORIZON, ROBOTS):
        row = jax.tree.map(lambda a, t=t, r=r: a[t, r], rows)
        *expected, valid = example(hyper, row, *options)
        used += t < n_real and valid
        assert weight[t, r] == (t < n_real and valid)
        for found, numbers in zip((x, y), expected, strict=True):
            np.testing.assert_allclose(found[t, r], numbers * weight[t, r], 1e-4, 1e-5)
    assert 0.5 * n_real * ROBOTS < used < n_real * ROBOTS


def test_no_number_of_a_row_of_weight_0_is_left(rows):
    """However wild: nothing times 0 would be 0 for one that is not finite."""
    for clean in (False, True):
        static, hyper = settings(clean=clean)
        weight = examples.row_weight(static, jax.tree.map(jnp.asarray, rows), 5)

        def spoil(x, out=weight == 0):
            return jnp.where(out.reshape(*out.shape, *[1] * (x.ndim - 2)), jnp.nan, x)

        names = ("obs", "next_obs", "prop", "next_prop", "action", "reward")
        spoilt = rows.replace(**{name: spoil(getattr(rows, name)) for name in names})
        for found in examples.examples(static, hyper, ENV, spoilt, 5)[:3]:
            assert np.isfinite(found).all()

"""Running means and variances against NumPy averages over calls."""

import jax.numpy as jnp
import numpy as np
from toy_runs import assert_same

from dynappo.model import moments


def test_moments_are_the_weighted_average_of_each_calls_mean_and_variance(typed):
    rng, decay, calls = np.random.default_rng(0), 0.9, 5
    found, means, variances = moments.init(3), [], []
    for k in range(calls):
        x = 2.0 + k + rng.normal(size=(4, 6, 3)).astype(np.float32) * [1, 10, 0.1]
        weight = (rng.random((4, 6)) < 0.7).astype(np.float32)
        kept = [x[t, r] for t in range(4) for r in range(6) if weight[t, r] == 1]
        means.append(np.mean(kept, axis=0))
        variances.append(np.var(kept, axis=0))
        found = typed(moments.update)(
            found, jnp.asarray(x, jnp.float32), jnp.asarray(weight), decay
        )
        share = [decay ** (k - j) for j in range(k + 1)]  # of each call so far, the newest 1
        mean, std = typed(moments.scale)(found)
        np.testing.assert_allclose(mean, np.average(means, 0, share), rtol=1e-5)
        np.testing.assert_allclose(std**2, np.average(variances, 0, share), rtol=1e-4)
    np.testing.assert_allclose(found.weight, 1 - decay**calls, rtol=1e-5)


def test_a_call_without_valid_rows_leaves_the_moments_as_they_are():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6, 3)), jnp.float32)
    before = moments.update(moments.init(3), x, jnp.ones((4, 6)), 0.9)
    after = moments.update(before, 5 * x, jnp.zeros((4, 6)), 0.9)
    assert_same(after, before)


def test_a_number_that_never_changes_is_scaled_by_1e_minus_4_and_not_by_0():
    found = moments.update(moments.init(2), jnp.full((4, 6, 2), 0.5), jnp.ones((4, 6)), 0.9)
    mean, std = moments.scale(found)
    np.testing.assert_allclose(mean, 0.5, rtol=1e-5)
    np.testing.assert_allclose(std, 1e-4, rtol=1e-5)

"""Advantages and returns against sums written out, hand arithmetic and rsl_rl's own numbers."""

import jax.numpy as jnp
import numpy as np
import pytest

from dynappo.learner import gae


def random_rollout(seed, horizon=12, num_envs=7):
    """Rewards, discounts, truncations, values and bootstraps [N, R] with falls and time-outs."""
    rng = np.random.default_rng(seed)
    reward, value, bootstrap = rng.normal(size=(3, horizon, num_envs))
    event = rng.random((horizon, num_envs))
    discount, truncation = 1.0 - (event < 0.15), 1.0 * ((event >= 0.15) & (event < 0.3))
    discount[-1, 0], truncation[-1, 0] = 0.0, 0.0  # a fall and a time-out in the last row
    discount[-1, 1], truncation[-1, 1] = 1.0, 1.0
    return [x.astype(np.float32) for x in (reward, discount, truncation, value, bootstrap)]


def by_double_loop(reward, discount, truncation, value, bootstrap, gamma, lambda_):
    """A_t = sum over k of (gamma lambda)^k delta_{t+k}, until the episode of row t ends."""
    horizon, num_envs = reward.shape
    advantages = np.zeros((horizon, num_envs))
    for r in range(num_envs):
        for t in range(horizon):
            for k in range(t, horizon):
                fell, timed_out = discount[k, r] == 0, truncation[k, r] == 1
                after = 0.0 if fell else float(bootstrap[k, r])
                delta = float(reward[k, r]) + gamma * after - float(value[k, r])
                advantages[t, r] += (gamma * lambda_) ** (k - t) * delta
                if fell or timed_out:
                    break
    return advantages


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("gamma", "lambda_"), [(0.99, 0.95), (0.9, 0.0), (1.0, 1.0)])
def test_advantages_equal_the_sum_of_discounted_deltas_up_to_the_end_of_the_episode(
    typed, seed, gamma, lambda_
):
    rollout = random_rollout(seed)
    assert (rollout[1] == 0).sum() > 3 and (rollout[2] == 1).sum() > 3
    advantages, returns = typed(gae.gae)(*map(jnp.asarray, rollout), gamma=gamma, lambda_=lambda_)
    expected = by_double_loop(*rollout, gamma, lambda_)
    np.testing.assert_allclose(advantages, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(returns, expected + rollout[3], rtol=1e-5, atol=1e-5)


# three rows of rewards 1, 2, 3 and values 0.5, 1.0, 1.5, the last bootstrapped with 2:
#     delta_2 = 3 + 0.9 x 2.0 - 1.5 = 3.30          A_2 = 3.30
#     delta_1 = 2 + 0.9 x   b - 1.0                 A_1 = delta_1 + 0.72 x A_2, if nothing ended there
#     delta_0 = 1 + 0.9 x 1.0 - 0.5 = 1.40          A_0 = 1.40 + 0.72 x A_1
BY_HAND = {
    # b = 1.5: delta_1 = 2.35
    "no end": ([1, 1, 1], [0, 0, 0], 1.5, [4.80272, 4.726, 3.30]),
    # delta_1 = 2 - 1: nothing comes after it, V = 99 is unused
    "a fall": ([1, 0, 1], [0, 0, 0], 99.0, [2.12, 1.00, 3.30]),
    # delta_1 = 4.60: V(next_obs) = 4 counts, A_2 of the next episode does not
    "a time limit": ([1, 1, 1], [0, 1, 0], 4.0, [4.712, 4.60, 3.30]),
}


@pytest.mark.parametrize("case", BY_HAND)
def test_three_rows_give_the_numbers_computed_by_hand(case):
    discount, truncation, bootstrap, expected = BY_HAND[case]
    columns = [1.0, 2.0, 3.0], discount, truncation, [0.5, 1.0, 1.5], [1.0, bootstrap, 2.0]
    rows = [jnp.asarray(column, jnp.float32)[:, None] for column in columns]
    advantages, returns = gae.gae(*rows, gamma=0.9, lambda_=0.8)
    np.testing.assert_allclose(advantages[:, 0], expected, rtol=1e-6)
    np.testing.assert_allclose(returns[:, 0], np.add(expected, [0.5, 1.0, 1.5]), rtol=1e-6)


def test_advantages_and_returns_are_those_of_rsl_rl_with_its_bootstrap(peer):
    z = peer("gae")
    assert z["time_out"].sum() > 3 and (z["done"] - z["time_out"]).sum() > 3
    after = np.concatenate([z["value"][1:], z["last_value"][None]])
    # rsl_rl adds gamma V(o_t), not gamma V(o_{t+1}), to the reward of a time-out
    bootstrap = np.where(z["time_out"] == 1, z["value"], after)
    advantages, returns = gae.gae(
        z["reward"],
        1 - (z["done"] - z["time_out"]),
        z["time_out"],
        z["value"],
        bootstrap,
        gamma=float(z["gamma"]),
        lambda_=float(z["lam"]),
    )
    np.testing.assert_allclose(advantages, z["advantage_raw"], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(returns, z["returns"], rtol=1e-5, atol=1e-5)


def test_with_lambda_1_the_return_is_the_discounted_sum_of_rewards_and_of_the_last_value():
    reward, discount, truncation, value, _ = random_rollout(5)
    truncation[:-1] = 0  # a time limit would restart the sum at its own bootstrap
    rng = np.random.default_rng(6)
    last = rng.normal(size=reward.shape[1]).astype(np.float32)
    bootstrap = np.concatenate([value[1:], last[None]])  # consistent values: they telescope
    _, returns = gae.gae(reward, discount, truncation, value, bootstrap, gamma=0.9, lambda_=1.0)
    for r in range(reward.shape[1]):
        for t in range(len(reward)):
            total, factor = 0.0, 1.0
            for k in range(t, len(reward)):
                total += factor * reward[k, r]
                factor *= 0.9 * discount[k, r]
            total += factor * last[r]
            np.testing.assert_allclose(returns[t, r], total, rtol=1e-4, atol=1e-5)


def test_shapes_that_differ_are_refused_instead_of_broadcast():
    one = jnp.ones((3, 2))
    with pytest.raises(AssertionError):
        gae.gae(one, one, one, one, one[:1], gamma=0.9, lambda_=0.8)

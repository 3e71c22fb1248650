"""What an iteration tells of its rows: finished episodes, the tail, sums, the first row that is wrong."""

from collections import deque
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from toy_runs import N

from dynappo import rollout, stats

R = 40


def rows(rate, seed=0):
    """A rollout [N, R] of NumPy arrays in which a share of rows ends its episode, half by falls."""
    rng = np.random.default_rng(seed)
    end, fall = rng.random((N, R)) < rate, rng.random((N, R)) < 0.5
    return rollout.allocate(toy_env.make(), N, R).replace(
        discount=np.float32(~(end & fall)),
        truncation=np.float32(end & ~fall),
        reward=rng.normal(size=(N, R)).astype(np.float32),
        episode_return=rng.normal(size=(N, R)).astype(np.float32),
        episode_length=rng.integers(1, 1000, (N, R)).astype(np.float32),
    )


def ended(buffer, n_real):
    """`(t, r)` of the real rows that ended an episode, in the order of time."""
    end = (buffer.discount == 0) | (buffer.truncation == 1)
    return [tuple(at) for at in np.argwhere(end) if at[0] < n_real]


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.5, 1.0])
def test_the_rings_are_those_of_a_deque(rate):
    """Over many rollouts with random ends: order, overflow in one call, rows of the tail ignored."""

    @jax.jit
    def push(returns, lengths, buffer, n_real):
        state = SimpleNamespace(returns=returns, lengths=lengths)
        return stats.finished(state, buffer, n_real)

    names, most = ("episode_return", "episode_length"), 0
    found = (jnp.full(100, jnp.nan),) * 2
    expected = [deque([np.nan] * 100, maxlen=100) for _ in names]
    for seed, n_real in enumerate((N, 3, 0, 5, N)):
        buffer = rows(rate, seed)
        found = push(*found, buffer, n_real)
        for ring, name, values in zip(expected, names, found, strict=True):
            ring.extend(getattr(buffer, name)[at] for at in ended(buffer, n_real))
            np.testing.assert_array_equal(values, np.float32(ring), name)
        most = max(most, len(ended(buffer, n_real)))
    assert most > 100 or rate < 0.4


@pytest.mark.parametrize("n_real", [N, 3, 0])
def test_episodes_are_counted_and_their_returns_added(n_real):
    buffer = rows(0.3)
    found = stats.of_episodes(jax.tree.map(jnp.asarray, buffer), n_real)
    which = ended(buffer, n_real)
    assert found["episodes"] == len(which) and (len(which) > 10) == (n_real > 0)
    total = sum(float(buffer.episode_return[at]) for at in which)
    assert found["episode_return_sum"] == pytest.approx(total, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("n_real", [N, 5, 1])
def test_a_tail_tells_its_falls_and_how_much_better_it_looks(n_real):
    """Rewards a second of synthetic rows above real ones; falls expected; 0 without a tail."""
    buffer = rows(0.3)
    buffer = buffer.replace(discount=np.random.default_rng(1).uniform(0, 1, (N, R)))
    real = np.arange(N)[:, None] < n_real
    found = stats.of_tail(jax.tree.map(jnp.asarray, buffer), jnp.asarray(real), 0.1)
    bias = buffer.reward[n_real:].mean() - buffer.reward[:n_real].mean() if n_real < N else 0.0
    np.testing.assert_allclose(found["tail_bias"], bias / 0.1, 1e-4, 1e-4)
    np.testing.assert_allclose(found["tail_falls"], (1 - buffer.discount[n_real:]).sum(), 1e-5)


def test_sums_become_means_and_roots_and_events_stay_counts():
    """Sums over 8 rows: a term, a squared error, events."""
    sums = {"reward_x": 4.0, "yaw_error_sq": 72.0, "falls": 3.0, "timeouts": 2.0, "blowups": 1.0}
    out = stats.of_rows({n: jnp.asarray(v) for n, v in sums.items()}, 8)
    expected = {"reward_x": 0.5, "yaw_error": 3.0, "falls": 3.0, "timeouts": 2.0, "blowups": 1.0}
    assert {n: float(v) for n, v in out.items()} == expected


def test_the_first_robot_with_a_number_that_is_not_finite_is_named():
    """In a reward or anywhere in the next observation, in any real row; -1 where all are finite."""
    buffer = jax.tree.map(jnp.asarray, rows(0.3))
    real = jnp.ones((len(buffer.reward), 1), bool)
    assert stats.nonfinite_robot(buffer, real) == -1
    wrong = buffer.replace(reward=buffer.reward.at[6, 30].set(jnp.inf))
    assert stats.nonfinite_robot(wrong, real) == 30
    wrong = wrong.replace(next_obs=wrong.next_obs.at[2, 17, 3].set(jnp.nan))
    assert stats.nonfinite_robot(wrong, real) == 17
    assert stats.nonfinite_robot(wrong, real.at[2:].set(False)) == -1  # a tail blames no robot

"""What a sweep came to: its interval."""

import numpy as np
import pytest
from scipy import stats

from dynappo.sweeps import table


@pytest.mark.parametrize("seeds", [2, 3, 5, 10, 40])
def test_the_interval_is_students(seeds):
    """As scipy has it."""
    values = np.random.default_rng(seeds).normal(3.0, 2.0, seeds)
    low, high = stats.t.interval(0.95, seeds - 1, values.mean(), stats.sem(values))
    np.testing.assert_allclose(table.half_width(values), (high - low) / 2, rtol=1e-4)


def test_one_seed_and_a_seed_without_a_number_have_no_interval():
    assert np.isnan(table.half_width([1.0])) and np.isnan(table.half_width([1.0, np.nan, 2.0]))

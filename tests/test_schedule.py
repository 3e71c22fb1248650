"""The schedule against the step counts of the paper's Table VI and exact rational arithmetic."""

import math
import random
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo import schedule


def config_of(a, b, x, y, iterations, horizon=16):
    """What the schedule reads of a config."""
    return SimpleNamespace(
        schedule=SimpleNamespace(
            start_iteration=a,
            end_iteration=b,
            start_steps=x,
            end_steps=y,
            last_iteration=None,
            rounds=1,
            late_from=None,
        ),
        run=SimpleNamespace(num_iterations=iterations),
        rollout=SimpleNamespace(num_envs=4096, horizon=horizon),
        model=SimpleNamespace(epochs=25, late_epochs=None, late_from=50, memory=0),
    )


def variant(name, iterations=500):
    """The validated config of a variant of Go1 that runs for so many iterations."""
    config = config_lib.load(f"configs/go1.py:{name}")
    config.run.update(num_iterations=iterations, log_every=1)
    return config_lib.validate(config)


def exact(a, b, x, y, i):
    """Equation 5 for one iteration in rational numbers, halves rounded up."""
    if a == b:
        return y
    steps = x + Fraction(i - a, b - a) * (y - x)
    return math.floor(min(max(steps, x), y) + Fraction(1, 2))


@pytest.mark.parametrize(
    ("name", "iterations", "steps"),
    [
        ("dyna4", 383, 19_636_224),  # 19.64 M
        ("dyna2", 398, 22_822_912),  # 22.82 M
        ("ppo16", 420, 27_525_120),  # 27.53 M
    ],
)
def test_simulator_steps_are_those_of_table_6(name, iterations, steps):
    config = variant(name, iterations)
    assert schedule.sim_steps(config)[-1] == steps
    assert steps == 4096 * (16 * iterations - schedule.table(config).sum())


def test_the_tail_of_dyna4_grows_at_iterations_13_38_63_and_88():
    table = schedule.table(variant("dyna4"))
    assert table[0] == 0 and table[-1] == 4
    grows = np.flatnonzero(np.diff(table)) + 2  # iterations count from 1
    np.testing.assert_array_equal(grows, [13, 38, 63, 88])
    np.testing.assert_array_equal(np.unique(np.diff(table)), [0, 1])


@pytest.mark.parametrize(
    ("name", "tail"), [("ppo12", 0), ("ppo16", 0), ("dyna2", 2), ("dyna4_noschedule", 4)]
)
def test_variants_without_a_ramp_have_the_same_tail_throughout(name, tail):
    np.testing.assert_array_equal(schedule.table(variant(name, 30)), np.full(30, tail))


def test_a_ramp_of_no_length_means_the_last_number_from_the_first_iteration_on():
    for a in (0, 1, 7):
        np.testing.assert_array_equal(schedule.table(config_of(a, a, 1, 3, 5)), [3] * 5)


def test_a_ramp_longer_than_the_run_is_cut_and_not_squeezed():
    long, short = (schedule.table(config_of(0, 100, 0, 4, n)) for n in (120, 40))
    np.testing.assert_array_equal(short, long[:40])
    assert short[-1] == 2


def test_before_the_ramp_the_tail_is_its_first_number_and_after_it_the_last():
    table = schedule.table(config_of(5, 10, 2, 6, 20))
    # i = 1 ... 5 is 2; 2.8, 3.6, 4.4, 5.2, 6 round to 3, 4, 4, 5, 6; then 6
    np.testing.assert_array_equal(table, [2] * 5 + [3, 4, 4, 5, 6] + [6] * 10)


def test_the_table_is_equation_5_in_exact_arithmetic_with_halves_rounded_up():
    draw = random.Random(0)
    ties = 0
    for _ in range(400):
        a = draw.randint(0, 60)
        b = a + draw.randint(0, 120)
        x = draw.randint(0, 8)
        y = x + draw.randint(0, 30)
        expected = [exact(a, b, x, y, i) for i in range(1, 151)]
        table = schedule.table(config_of(a, b, x, y, 150, 64))
        assert table.tolist() == expected, (a, b, x, y)
        if b > a:
            fractions = [Fraction((i - a) * (y - x), b - a) for i in range(max(a, 1), b)]
            ties += sum(f.denominator == 2 for f in fractions)
    assert ties > 100  # the rounding of halves was exercised


@pytest.mark.parametrize(("b", "y", "i"), [(22, 11, 15), (26, 13, 15), (46, 23, 13), (50, 25, 29)])
def test_an_exact_half_rounds_up_where_dividing_first_falls_short_of_it(b, y, i):
    assert 2 * i * y % (2 * b) == b  # i y / b is a whole number and a half
    assert schedule.table(config_of(0, b, 0, y, b, 64))[i - 1] == exact(0, b, 0, y, i)


def test_tables_and_columns_are_int32_and_simulator_steps_are_int64():
    for name in ("dyna4", "dyna2", "ppo16", "fast"):
        config = variant(name, 60)
        columns = schedule.columns(config)
        for column in (schedule.table(config), *columns.values()):
            assert column.dtype == np.int32 and column.shape == (60,)
        assert schedule.sim_steps(config).dtype == np.int64


def test_columns_of_plain_ppo_have_no_model_epochs():
    plain, dyna = variant("ppo16", 20), variant("dyna4", 20)
    assert schedule.columns(plain).keys() == {"iteration", "n_real"}
    assert schedule.columns(dyna).keys() == {"iteration", "n_real", "model_epochs"}
    assert not schedule.uses_model(plain) and schedule.uses_model(dyna)


def test_a_ramp_to_zero_from_zero_uses_no_model_and_any_tail_uses_it():
    assert not schedule.uses_model(config_of(0, 100, 0, 0, 10))
    assert schedule.uses_model(config_of(0, 100, 0, 1, 10))
    assert schedule.uses_model(config_of(400, 500, 0, 1, 10))


def test_real_rows_and_tail_add_up_to_the_horizon_and_iterations_count_from_1():
    config = variant("dyna4", 120)
    columns = schedule.columns(config)
    np.testing.assert_array_equal(columns["n_real"] + schedule.table(config), 16)
    np.testing.assert_array_equal(columns["iteration"], np.arange(1, 121))


def test_simulator_steps_are_the_running_total_over_robots_and_pass_2_to_the_31():
    config = config_of(0, 0, 0, 2, 100_000)
    steps = schedule.sim_steps(config)
    np.testing.assert_array_equal(steps[:3], [4096 * 14, 4096 * 28, 4096 * 42])
    assert steps[-1] == 4096 * 14 * 100_000 > 2**31


def test_late_epochs_replace_epochs_after_iteration_late_from():
    config = config_of(0, 100, 0, 4, 8)
    np.testing.assert_array_equal(schedule.columns(config)["model_epochs"], [25] * 8)
    config.model.late_epochs, config.model.late_from = 5, 3
    np.testing.assert_array_equal(
        schedule.columns(config)["model_epochs"], [25, 25, 25, 5, 5, 5, 5, 5]
    )
    config.model.late_epochs = 0  # not the same as None
    assert schedule.columns(config)["model_epochs"][-1] == 0


def test_after_the_last_iteration_of_a_tail_rows_are_real_and_no_model_is_fitted():
    """Rows, epochs and rounds of a run against a list by hand; the simulator steps follow."""
    config = config_of(0, 4, 0, 8, 8)
    config.schedule.last_iteration, config.schedule.rounds = 5, 3
    columns = schedule.columns(config)
    np.testing.assert_array_equal(columns["n_real"], [14, 12, 10, 8, 8, 16, 16, 16])
    np.testing.assert_array_equal(columns["model_epochs"], [25] * 5 + [0] * 3)
    np.testing.assert_array_equal(columns["rounds"], [3] * 5 + [1] * 3)
    assert schedule.sim_steps(config)[-1] == 4096 * (52 + 48)
    config.schedule.last_iteration = 8
    assert (schedule.table(config)[4:] == 8).all()
    config.schedule.last_iteration = 0
    assert not schedule.uses_model(config) and (schedule.table(config) == 0).all()


def test_a_tail_of_one_length_ends_after_the_last_iteration_too():
    config = config_of(0, 0, 0, 2, 6)
    config.schedule.last_iteration = 2
    np.testing.assert_array_equal(schedule.table(config), [2, 2, 0, 0, 0, 0])


def test_a_model_is_fitted_before_a_tail_that_comes_late():
    config = config_of(6, 8, 0, 2, 8)
    np.testing.assert_array_equal(schedule.columns(config)["model_epochs"], [25] * 8)


@pytest.mark.parametrize("late_from", [None, 0, 3, 7])
def test_late_iterations_have_the_rows_epochs_and_rounds_of_the_others(late_from):
    """Only PPO's KL is another (`algorithm.hyper_at`); a ramp that is not over goes on."""
    config, other = config_of(2, 6, 1, 8, 10), config_of(2, 6, 1, 8, 10)
    config.schedule.rounds = other.schedule.rounds = 3
    config.schedule.late_from = late_from
    for name, column in schedule.columns(other).items():
        np.testing.assert_array_equal(schedule.columns(config)[name], column)


def test_late_is_said_of_each_iteration_alike_in_the_table_and_in_the_program():
    config = config_of(0, 100, 0, 4, 8)
    i = np.arange(1, 9)
    assert not schedule.late(config, i).any() and not schedule.late(config, 2)
    config.schedule.late_from = 3
    np.testing.assert_array_equal(schedule.late(config, i), [0, 0, 0, 1, 1, 1, 1, 1])
    assert [bool(schedule.late(config, int(k))) for k in i] == [k > 3 for k in i]


def test_the_variant_fast_fits_fewer_epochs_in_later_iterations():
    epochs = schedule.columns(variant("fast", 500))["model_epochs"]
    assert epochs[0] > epochs[-1] > 0
    assert np.count_nonzero(np.diff(epochs)) == 1

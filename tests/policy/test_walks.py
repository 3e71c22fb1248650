"""Whether a robot walks: against a plain loop over evaluations, and at every edge; in words."""

import itertools
import math

import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.policy import walks

NAN = math.nan


def by_hand(steps, returns, falls, least):
    """`(walks, level, careful)` of one seed, read as the definition is written."""

    def good(k):
        return returns[k] >= least and falls[k] <= 0.01

    count = range(len(steps))
    return (
        next((steps[k] for k in count if all(good(j) for j in count[k:])), NAN),
        next((steps[k] for k in count if returns[k] >= least), NAN),
        next((steps[k] for k in count if good(k)), NAN),
    )


CASES = {  # returns, fall rates of evaluations after 1, 2, 3, 4 steps -> walks, at the level, with few falls
    "at once": ([40, 40, 40, 40], [0, 0, 0, 0], (1, 1, 1)),
    "exactly": ([30, 38, 38, 38], [0, 0.01, 0.01, 0.01], (2, 2, 2)),
    "falls at first": ([39, 39, 40, 40], [0.05, 0.02, 0.01, 0], (3, 1, 3)),
    "relapse of the return": ([39, 37, 39, 40], [0, 0, 0, 0], (3, 1, 1)),
    "relapse of the falls": ([39, 39, 39, 40], [0, 0, 0.02, 0], (4, 1, 1)),
    "lost at the end": ([39, 39, 39, 37], [0, 0, 0, 0], (NAN, 1, 1)),
    "falls at the end": ([39, 39, 39, 39], [0, 0, 0, 0.011], (NAN, 1, 1)),
    "never at both": ([39, 30, 39, 30], [0.5, 0, 0.5, 0], (NAN, 1, NAN)),
    "never": ([1, 2, 3, 4], [0, 0, 0, 0], (NAN, NAN, NAN)),
    "at the last only": ([1, 2, 3, 38], [1, 1, 1, 0], (4, 4, 4)),
    "nan between": ([39, NAN, 39, 39], [0, 0, 0, 0], (3, 1, 1)),
    "nan falls": ([39, 39, 39, 39], [0, 0, NAN, 0], (4, 1, 1)),
    "all nan": ([NAN] * 4, [NAN] * 4, (NAN, NAN, NAN)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_robot_walks_from_where_it_never_relapses(name):
    returns, falls, expected = CASES[name]
    np.testing.assert_array_equal(walks.reached([1, 2, 3, 4], returns, falls, 38), expected)
    np.testing.assert_array_equal(by_hand([1, 2, 3, 4], returns, falls, 38), expected)


def test_seeds_are_judged_each_by_itself():
    """Random evaluations of 200 seeds, against the loop; steps of each seed, or of all."""
    rng = np.random.default_rng(0)
    returns = rng.choice([30.0, 37.9, 38.0, 41.0, NAN], (6, 200), p=[0.1, 0.1, 0.3, 0.45, 0.05])
    falls = rng.choice([0.0, 0.005, 0.01, 0.02], (6, 200), p=[0.5, 0.3, 0.1, 0.1])
    common, own = np.arange(1, 7) * 10, np.cumsum(rng.integers(1, 9, (6, 200)), 0)
    for steps in (common, own):
        found = walks.reached(steps, returns, falls, 38)
        for s in range(200):
            mine = steps if steps.ndim == 1 else steps[:, s]
            expected = by_hand(mine, returns[:, s], falls[:, s], 38)
            np.testing.assert_array_equal([x[s] for x in found], expected)
    assert 20 < np.isnan(found.walks).sum() < 180 and (found.walks > found.careful).any()


def test_rounding_of_float32_is_no_fall():
    """10 of 1000 and 1 of 100 episodes are 1 % however they are summed; 11 are more; 38 is 38."""
    for count, episodes in ((10, 1000), (1, 100), (2, 200)):
        share = np.float32(count) * np.float32(1 / episodes)
        for value in (share, np.nextafter(share, np.float32(1)), np.float32(count) / episodes):
            assert walks.holds(np.float32(38.0), value, walks.level(45.0))
    assert not walks.holds(38.0, 11 / 1000, 38) and not walks.holds(37.99, 0, 38)


def test_without_evaluations_nobody_walks():
    assert np.isnan(walks.reached([], [], [], 38)).all()
    found = walks.reached([], np.zeros((0, 3)), np.zeros((0, 3)), 38)
    assert np.isnan(found).all() and np.shape(found) == (3, 3)
    for shapes in (((3,), (4,), (4,)), ((4,), (4, 2), (4,)), ((2,), (4, 2), (4, 2))):
        with pytest.raises(ValueError, match="expected one shape"):
            walks.reached(*map(np.zeros, shapes), 38)


LEVELS = {"go1": 38, "go2": 38, "anymal_c": 24, "anymal_d": 24}


@pytest.mark.parametrize("name", LEVELS)
def test_the_level_follows_from_the_weights_and_the_time(name):
    """38 of 45 and 24 of 30; half of it in 10 s; with other weights 0.8 of what tracking can earn."""
    weights = config_lib.load(f"{name}:best").task.weights
    for seconds in (20.0, 10.0):
        most = walks.best(weights, seconds)
        assert most == {38: 45, 24: 30}[LEVELS[name]] * seconds / 20
        assert walks.level(most, seconds) == pytest.approx(LEVELS[name] * seconds / 20)
    weights.track_linear_velocity = 4.0
    most = walks.best(weights)
    assert walks.level(most) == pytest.approx(0.8 * (4.0 + weights.track_yaw_rate) * 20)


SAID = {  # (return, tracking error, yaw error, fall rate) of commands from -1 to 1: what is said
    "stands": ((26.0, 0.8, 0.57, 0.0), "stands, does not walk yet; return 26.00 < 38"),
    "falls often": (
        (9.0, 0.8, 0.57, 0.7),
        "does not walk yet; return 9.00 < 38; falls 70.0 % > 1 %",
    ),
    "begins": ((34.0, 0.5, 0.4, 0.005), "begins to walk; return 34.00 < 38"),
    "walks": ((42.0, 0.05, 0.05, 0.001), "walks, turns, does not fall"),
    "one of a hundred": ((38.0, 0.1, 0.5, 0.01), "walks, does not turn yet, seldom falls"),
    "two of a hundred": ((42.0, 0.05, 0.05, 0.02), "almost walks; falls 2.0 % > 1 %"),
    "nearly": ((37.99, 0.1, 0.1, 0.0), "almost walks; return 37.99 < 38"),
    "falls": ((-1.0, NAN, NAN, 1.0), "falls at once"),
    "no return": ((None, 0.1, 0.1, 0.0), "almost walks; return nan < 38"),
    "all seeds": (([39.0, 38.0], [0.1, 0.1], [0.1, 0.1], [0.0, 0.01]), "2 of 2 seeds walk"),
    "seeds": (
        ([39.0, 26.0, 40.0], [0.05, 0.8, 0.1], [0.1, 0.5, 0.1], [0.0, 0.0, 0.02]),
        "1 of 3 seeds walk; return < 38: 1; falls > 1 %: 1",
    ),
    "nobody": (
        ([-1.0, 20.0], [None, 0.8], [None, 0.5], [1.0, 1.0]),
        "0 of 2 seeds walk; return < 38: 2; falls > 1 %: 2",
    ),
}


def test_a_biped_walks_by_its_errors_and_falls():
    """Against the definition read as it is written; exactly at the level counts, NaN does not."""
    rng, steps = np.random.default_rng(0), [10, 20, 30, 40]
    errors = rng.choice([0.1, 0.2, 0.21, NAN], (4, 300), p=[0.3, 0.5, 0.1, 0.1])
    yaw = rng.choice([0.1, 0.25, 0.26], (4, 300), p=[0.4, 0.5, 0.1])
    falls = rng.choice([0.0, 0.01, 0.011], (4, 300), p=[0.5, 0.4, 0.1])
    found = walks.reached_by_tracking(steps, errors, yaw, falls)
    for s in range(300):
        level = [
            1.0 if e <= 0.2 and y <= 0.25 else 0.0
            for e, y in zip(errors[:, s], yaw[:, s], strict=True)
        ]
        expected = by_hand(steps, level, falls[:, s], 1.0)
        np.testing.assert_array_equal([x[s] for x in found], expected)
    assert 20 < np.isnan(found.walks).sum() < 280
    assert walks.tracks(np.float32(0.2), np.float32(0.25)) and not walks.tracks(0.2, 0.251)
    with pytest.raises(ValueError, match="expected one shape"):
        walks.reached_by_tracking(steps, errors, yaw[:, :1], falls)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((3.0, 0.2, 0.25, 0.01), "walks, turns, seldom falls"),
        (
            (99.0, 0.21, 0.2, 0.0),
            "almost walks; errors 0.21 m/s, 0.20 rad/s > 0.20 m/s, 0.25 rad/s",
        ),
        ((99.0, 0.2, 0.2, 0.02), "almost walks; falls 2.0 % > 1 %"),
        ((99.0, NAN, NAN, 1.0), "falls at once"),
        (
            ([9.0, 9.0], [0.1, 0.3], [0.1, 0.1], [0.0, 0.0]),
            "1 of 2 seeds walk; errors > 0.20 m/s, 0.25 rad/s: 1",
        ),
    ],
)
def test_of_a_g1_errors_are_said_and_not_its_return(numbers, said):
    assert walks.in_words(config_lib.load("g1"), evaluation(*numbers)) == said


def evaluation(*numbers):
    return dict(zip(("return", "tracking_error", "yaw_error", "fall_rate"), numbers, strict=True))


@pytest.mark.parametrize("name", SAID)
def test_what_a_policy_does_is_said_in_words(name):
    """A robot that stands still under these commands errs by 0.816 m/s and 0.577 rad/s."""
    numbers, said = SAID[name]
    assert walks.in_words(config_lib.load("go1:best"), evaluation(*numbers)) == said


def test_the_words_know_the_robot_and_the_time():
    """A return of 30 is far for a Go1, enough for an ANYmal, and for a Go1 that is evaluated for 10 s."""
    good = evaluation(30.0, 0.1, 0.1, 0.0)
    go1 = config_lib.load("go1:best")
    assert walks.in_words(go1, good) == "almost walks; return 30.00 < 38"
    assert walks.in_words(config_lib.load("anymal_d:best"), good).startswith("walks")
    for fields in ({"eval_steps": 500}, {"eval_steps": 0}):
        go1.run.update(fields)
        go1.task.episode_length = 500
        assert walks.in_words(go1, good).startswith("walks")
    go1.task.weights.update(track_linear_velocity=0.0, track_yaw_rate=0.0)
    assert walks.in_words(go1, good) == ""
    assert walks.in_words(go1, {"return": 1.0}) == ""


def test_what_is_turned_and_walked_is_judged_by_the_commands_that_were_given():
    """0.2 m/s is little where robots are asked for 1 m/s, and all where they are asked for 0.2 m/s."""
    config = config_lib.load("go1:best")
    slow = evaluation(20.0, 0.2, 0.1, 0.0)
    assert walks.in_words(config, slow).startswith("almost walks")
    config.task.update(command_x=(0.2, 0.2), command_y=(0.0, 0.0))
    assert walks.in_words(config, slow).startswith("stands")
    for low, high in itertools.product((-1.0, 0.0, 0.5), (0.5, 1.0)):
        drawn = np.linspace(low, high, 100_001)
        assert walks.still((low, high)) == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=1e-4)

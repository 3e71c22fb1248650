"""Whether a robot walks, at every edge; in words."""

import itertools
import math

import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo import scores
from dynappo.policy import walks

NAN = math.nan


def test_rounding_of_float32_is_no_fall():
    """10 of 1000 and 1 of 100 episodes are 1 % however they are summed; 11 are more; 38 is 38."""
    for count, episodes in ((10, 1000), (1, 100), (2, 200)):
        share = np.float32(count) * np.float32(1 / episodes)
        for value in (share, np.nextafter(share, np.float32(1)), np.float32(count) / episodes):
            assert walks.seldom(value)
    assert walks.at(np.float32(38.0), walks.level(45.0)) and not walks.at(37.99, 38)
    assert not walks.seldom(11 / 1000)
    assert walks.tracks(np.float32(0.2), np.float32(0.25)) and not walks.tracks(0.2, 0.251)


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
    "walks": ((42.0, 0.05, 0.05, 0.0), "walks, turns, does not fall"),
    "one of a thousand": ((42.0, 0.05, 0.05, 0.001), "walks, turns, seldom falls"),
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


def test_nothing_is_said_of_the_first_second():
    """No error is measured in it; a robot that is evaluated for so long has not fallen at once."""
    go1 = config_lib.load("go1:best")
    for steps, said in ((50, ""), (51, "falls at once")):
        go1.run.eval_steps = steps
        assert walks.in_words(go1, evaluation(1.5, NAN, NAN, 0.0)) == said
        assert (
            walks.unmeasured(walks.evaluated_seconds(go1)) == "nobody stood for a second"
        ) == bool(said)
    assert walks.SETTLE == scores.SETTLE


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

"""Whether a robot walks, at every edge; in words."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo import scores, terms
from dynappo.policy import asked, walks

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


def valid(spec="go1:best", **task):
    """A valid config with fields of `task` set."""
    config = config_lib.load(spec)
    weights = task.pop("weights", {})
    config.task.weights.update(weights)
    config.task.update(task)
    return config_lib.validate(config)


def evaluation(*numbers) -> dict[str, Any]:
    return dict(zip(("return", "tracking_error", "yaw_error", "fall_rate"), numbers, strict=True))


def said(numbers, spec="go1:best", **task):
    return walks.in_words(valid(spec, **task), evaluation(*numbers))


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
    "half of a hundred": ((42.0, 0.05, 0.05, 0.5), "begins to walk; falls 50.0 % > 1 %"),
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
    ("numbers", "words"),
    [
        ((3.0, 0.2, 0.25, 0.01), "walks, turns, seldom falls"),
        (
            (99.0, 0.21, 0.2, 0.0),
            "almost walks; error 0.21 m/s > 0.20 m/s",
        ),
        ((99.0, 0.2, 0.2, 0.02), "almost walks; falls 2.0 % > 1 %"),
        ((99.0, NAN, NAN, 1.0), "falls at once"),
        (
            ([9.0, 9.0], [0.1, 0.3], [0.1, 0.1], [0.0, 0.0]),
            "1 of 2 seeds walk; errors > 0.20 m/s, 0.25 rad/s: 1",
        ),
    ],
)
def test_of_a_g1_errors_are_said_and_not_its_return(numbers, words):
    assert said(numbers, "g1") == words


@pytest.mark.parametrize("name", SAID)
def test_what_a_policy_does_is_said_in_words(name):
    """A robot that stands still under these commands errs by 0.816 m/s and 0.577 rad/s."""
    numbers, words = SAID[name]
    assert said(numbers) == words


def test_the_words_know_the_robot_and_the_time():
    """A return of 30 is far for a Go1, enough for an ANYmal, and for a Go1 that is evaluated for 10 s."""
    good = evaluation(30.0, 0.1, 0.1, 0.0)
    assert walks.in_words(valid(), good) == "almost walks; return 30.00 < 38"
    assert walks.in_words(valid("anymal_d:best"), good).startswith("walks")
    go1 = config_lib.load("go1:best")
    for fields in ({"eval_steps": 500}, {"eval_steps": 0}):
        go1.run.update(fields)
        go1.task.episode_length = 500
        assert walks.in_words(config_lib.validate(go1), good).startswith("walks")
    unpaid = {"track_linear_velocity": 0.0, "track_yaw_rate": 0.0}
    assert walks.in_words(valid(weights=unpaid), good) == ""
    assert walks.in_words(valid(), {"return": 1.0}) == ""


def test_of_few_episodes_their_number_is_said():
    """Behind what it does, in each form; the run's own where none is given."""
    config, words = valid(), "walks, turns, does not fall"
    own = config_lib.load("go1:best")
    good, bad = evaluation(42.0, 0.05, 0.05, 0.0), evaluation(26.0, 0.8, 0.57, 0.0)
    for episodes, few in ((1, " (of 1 episode)"), (99, " (of 99 episodes)"), (100, ""), (1000, "")):
        assert walks.in_words(config, good, episodes) == words + few
        stands = f"stands, does not walk yet{few}; return 26.00 < 38"
        assert walks.in_words(config, bad, episodes) == stands
        own.run.eval_envs = episodes
        assert walks.in_words(config_lib.validate(own), good) == words + few
    seeds = evaluation([42.0, 26.0], [0.05, 0.8], [0.05, 0.57], [0.0, 0.0])
    expected = "1 of 2 seeds walk (of 64 episodes each); return < 38: 1"
    assert walks.in_words(config, seeds, 64) == expected
    at_once = evaluation(-1.0, NAN, NAN, 1.0)
    assert walks.in_words(config, at_once, 2) == "falls at once (of 2 episodes)"


def test_nothing_is_said_of_the_first_second():
    """No error is measured in it; a robot that is evaluated for so long has not fallen at once."""
    go1 = config_lib.load("go1:best")
    for steps, words in ((50, ""), (51, "falls at once")):
        go1.run.eval_steps = steps
        config = config_lib.validate(go1)
        assert walks.in_words(config, evaluation(1.5, NAN, NAN, 0.0)) == words
        short = walks.unmeasured(walks.evaluated_seconds(config)) != "nobody stood for a second"
        assert short == (not words)
    assert walks.SETTLE == scores.SETTLE


OWN_TASKS = {  # fields of the task, numbers, what is said where return or fixed errors would be wrong
    "a cost": (
        {"weights": {"joint_torques": -1e-3}},
        (32.4, 0.08, 0.1, 0.0),
        "walks, turns, does not fall",
    ),
    "a bonus": (
        {"weights": {"feet_air_time": 3.0}},
        (44.0, 0.8, 0.57, 0.0),
        "stands, does not walk yet; error 0.80 m/s > 0.20 m/s; yaw rate error 0.57 rad/s > 0.25 rad/s",
    ),
    "a width": (
        {"tracking_std": 3.0},
        (44.0, 0.5, 0.2, 0.0),
        "begins to walk; error 0.50 m/s > 0.20 m/s",
    ),
    "slow": (
        {"command_x": (-0.2, 0.2), "command_y": (0.0, 0.0), "command_yaw": (0.0, 0.0)},
        (43.0, 0.115, 0.0, 0.0),
        "stands, does not walk yet; error 0.12 m/s > 0.058 m/s",
    ),
    "slow, walks": (
        {"command_x": (-0.2, 0.2), "command_y": (0.0, 0.0), "command_yaw": (0.0, 0.0)},
        (43.0, 0.05, 0.01, 0.0),
        "walks, does not fall",
    ),
    "fast": (
        {"command_x": (0.0, 3.0), "command_y": (0.0, 0.0)},
        (30.0, 0.34, 0.2, 0.0),
        "walks, turns, does not fall",
    ),
    "on the spot": (
        {"command_x": (0.0, 0.0), "command_y": (0.0, 0.0)},
        (40.0, 0.05, 0.1, 0.0),
        "turns on the spot, does not fall",
    ),
    "on no spot": (
        {"command_x": (0.0, 0.0), "command_y": (0.0, 0.0)},
        (40.0, 0.05, 0.57, 0.0),
        "stands, does not turn yet; yaw rate error 0.57 rad/s > 0.25 rad/s",
    ),
    "told to stand": ({"standing": 1.0}, (40.0, 0.01, 0.01, 0.0), "stands still, does not fall"),
    "turns unpaid": (
        {"weights": {"track_yaw_rate": 0.0}},
        (20.0, 0.1, 0.57, 0.0),
        "walks, does not fall",
    ),
}


@pytest.mark.parametrize("name", OWN_TASKS)
def test_with_rewards_or_commands_of_ones_own_errors_tell_and_not_the_return(name):
    task, numbers, words = OWN_TASKS[name]
    assert said(numbers, **task) == words


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n in ("go2", "anymal_c") else []) for n in LEVELS],
)
def test_the_return_tells_where_it_was_measured(name):
    """Of the four robots' own flat tasks, with either width of tracking, and of nothing else."""
    for variant in ("best", "few", "ppo16", "dyna4", "fast", "laptop", "quick", "logs"):
        assert walks.by_return(valid(f"{name}:{variant}"))
    for variant in ("deploy", "rough", "rough_deploy"):
        assert not walks.by_return(valid(f"{name}:{variant}"))
    for field, value in {
        "formulation": "paper_text",
        "command_y": (-0.5, 0.5),
        "fall_reward": -1.0,
        "max_tilt": 1.0,
        "standing": 0.1,
        "slow_commands": 0.4,
    }.items():
        assert not walks.by_return(valid(name, **{field: value}))
    assert not walks.by_return(valid(name, weights={"energy": -1e-4}))
    for weight in (0.0, -0.2, -0.3, -0.31, -0.5, 0.1):
        told = -0.3 <= weight <= 0  # feet that are lifted cost little
        assert walks.by_return(valid(name, weights={"foot_clearance": weight})) == told
    assert not walks.by_return(valid(name, clearance_height=0.1))
    adopted = config_lib.load(name)
    adopted.robot = "mydog"  # the same weights are others for a robot of another size
    assert not walks.by_return(config_lib.validate(adopted, robot_here=False))


def test_of_other_packages_tasks_nothing_is_said():
    """A return of 38 means nothing there."""
    theirs = config_lib.load("go1:best")
    theirs.robot, theirs.env = "", "playground:Go1JoystickFlatTerrain"
    theirs = config_lib.validate(theirs)
    for numbers in ((14.95, 0.1, 0.1, 0.0), ([14.95, 40.0], [0.1, 0.1], [0.1, 0.1], [0.0, 0.0])):
        assert walks.in_words(theirs, evaluation(*numbers)) == ""
        assert walks.walking(theirs, evaluation(*numbers)) is None


TERMS = """
from dynappo import terms

@terms.reward(weight=-0.5)
def rent(dt):
    return 1.0 + 0 * dt

@terms.curriculum(start=0.1, evaluated=1.0, numbers={"step_up": 0.05})
def level(level, fell, step_up):
    return level + step_up * ~fell

@terms.command(draws=1)
def ahead(draw, level, command_x):
    xp = draw.__array_namespace__()
    low, high = command_x
    return xp.stack([level * (low + (high - low) * draw[0]), 0 * draw[0], 0 * draw[0]])
"""


def test_a_command_of_ones_own_is_drawn_to_know_what_is_asked(tmp_path):
    """0.3 to 1.2 m/s ahead with the curriculum at its end, no turn: who stands does not walk."""
    (tmp_path / "mine.py").write_text(TERMS)
    config = config_lib.load("go1:laptop")
    terms.use(config, terms.read(tmp_path / "mine.py"))
    config.task.command_x = (0.3, 1.2)
    config.task.standing = 0.19
    config = config_lib.validate(config)
    speed, turn = asked.of(config) or (NAN, NAN)
    assert speed == pytest.approx(0.9 * np.sqrt((0.3**2 + 0.3 * 1.2 + 1.2**2) / 3), rel=0.02)
    assert turn == 0
    stands = walks.in_words(config, evaluation(38.5, speed, 0.0, 0.0))
    assert stands.startswith("stands, does not walk yet; error 0.73 m/s > 0.20 m/s")
    assert walks.in_words(config, evaluation(28.0, 0.1, 0.05, 0.0)) == "walks, does not fall"
    unread = config_lib.load("go1:laptop")
    unread.task.update(terms="gone.py", terms_hash="0" * 64)
    unread = config_lib.validate(unread)
    assert walks.in_words(unread, evaluation(28.0, 0.1, 0.05, 0.0)) == ""


def test_what_is_turned_and_walked_is_judged_by_the_commands_that_were_given():
    """0.2 m/s is little where robots are asked for 1 m/s, and all where they are asked for 0.2 m/s."""
    slow = (20.0, 0.2, 0.1, 0.0)
    assert said(slow).startswith("almost walks")
    assert said(slow, command_x=(0.2, 0.2), command_y=(0.0, 0.0)).startswith("stands")
    for low, high in itertools.product((-1.0, 0.0, 0.5), (0.5, 1.0)):
        drawn = np.linspace(low, high, 100_001)
        assert asked.uniform((low, high)) == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=1e-4)


def test_slow_commands_ask_for_less():
    """Of 40 %, a uniform share from 0 to 0.5 of the command."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (100_000, 3))
    share = np.random.default_rng(1).uniform(0, 0.5, 100_000)
    drawn[:40_000] *= share[:40_000, None]
    speed, turn = asked.of(valid("go1", slow_commands=0.4)) or (NAN, NAN)
    assert speed == pytest.approx(np.sqrt(np.mean((drawn[:, :2] ** 2).sum(1))), rel=0.01)
    assert turn == pytest.approx(np.sqrt(np.mean(drawn[:, 2] ** 2)), rel=0.01)


def test_a_heading_asks_for_turns_inside_the_range():
    """Of a robot that turns to none: half of the angle, at most 1 rad/s."""
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, 100_000)
    _, turn = asked.of(valid("go2:rough")) or (NAN, NAN)
    expected = np.sqrt(0.98 * np.mean(np.clip(0.5 * angles, -1, 1) ** 2))
    assert turn == pytest.approx(expected, rel=0.01)
    assert (asked.of(valid("go2:rough", command_yaw=(0.0, 0.0))) or (NAN, NAN))[1] == 0

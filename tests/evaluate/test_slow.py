"""From which speed on a robot follows a command: made-up robots, and a bundled one by a loop over steps."""

import mujoco
import numpy as np
import pytest

from dynappo.evaluate import slow
from dynappo.policy import episode, policy_file, policy_source


@pytest.fixture(scope="module")
def player():
    return policy_source.player(policy_source.load("go2_deploy")[0])[0]


def goes(monkeypatch, share):
    """Robots whose mean velocity is `share(command)` times the command."""
    monkeypatch.setattr(
        slow, "went", lambda player, act, command: share(command) * np.asarray(command)
    )


@pytest.mark.parametrize(
    "share, expected",
    [
        (lambda c: 1.0, (0.1, 0.1, 0.1, 0.1)),
        (lambda c: 0.0, (None, None, None, None)),
        # walks from 0.3 on, backwards from 0.4, never sideways
        (lambda c: (c[0] >= 0.3 or c[0] <= -0.4 or c[2] > 0.15) * 1.0, (0.3, 0.4, None, 0.2)),
        # half of the speed is enough, less is not
        (lambda c: 0.5 if c[0] else 0.49, (0.1, 0.1, None, None)),
        # one that is followed below one that is not does not count
        (lambda c: (abs(c).max() != 0.4) * 1.0, (0.5, 0.5, 0.5, 0.5)),
        # the other way does not count either
        (lambda c: -1.0, (None, None, None, None)),
    ],
)
def test_it_is_the_slowest_from_which_on_all_are_followed(monkeypatch, player, share, expected):
    goes(monkeypatch, share)
    assert tuple(slow.run(player).values()) == expected


def test_what_training_did_not_ask_for_is_left_out(monkeypatch, player):
    """No direction that has no speed of the list in its range, no speed beyond it."""
    told = []
    monkeypatch.setattr(slow, "went", lambda p, a, command: told.append(command) or command)
    some = player._replace(
        policy=player.policy._replace(
            command_x=(0.0, 0.3), command_y=(0.0, 0.0), command_yaw=(-0.2, 0.05)
        )
    )
    assert list(slow.run(some)) == ["ahead"]
    assert [command[0] for command in told] == [0.3, 0.2, 0.1]
    fast = some._replace(policy=some.policy._replace(command_x=(0.3, 1.0)))
    told.clear()
    assert slow.run(fast) == {"ahead": 0.3} and [command[0] for command in told] == [0.5, 0.4, 0.3]


def test_a_bundled_policy_goes_as_a_loop_over_its_episode_says(player):
    """Mean velocity after the first second, from the base's own velocity in MuJoCo."""
    act = policy_file.actor(player.policy.params, player.policy.activation)
    command = np.array([0.5, 0.0, 0.0])
    found = slow.went(player, act, command)
    data, seen = mujoco.MjData(player.model), []
    rows = episode.rows(player, data, act, lambda t: command)
    for k in range(200):  # 4 s
        next(rows)
        if k >= 50:
            turn = data.xmat[player.base_body].reshape(3, 3)
            seen.append([*(turn.T @ data.qvel[:3])[:2], data.qvel[5]])
    np.testing.assert_allclose(found, np.mean(seen, axis=0), atol=0.01)
    assert found[0] > 0.4


def test_a_robot_that_falls_or_blows_up_follows_nothing(monkeypatch, player):
    def ends(last):
        def rows(*_):
            for _ in range(60):
                yield {"velocity": np.array([0.5, 0, 0]), "fell": False}
            if last:
                raise FloatingPointError
            yield {"velocity": np.array([0.5, 0, 0]), "fell": True}

        return rows

    for last in (True, False):
        monkeypatch.setattr(episode, "rows", ends(last))
        assert not slow.went(player, None, np.array([0.5, 0, 0])).any()


def test_the_line_has_units_and_says_where_nothing_is_followed():
    line = slow.line({"ahead": 0.3, "back": None, "turning left": 0.2})
    assert line.endswith("of 0.1 and up: ahead 0.3 m/s, back none, turning left 0.2 rad/s")

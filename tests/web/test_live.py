"""The robot that is looked at: real time, steering, pushes, pulls, falls; without a browser."""

import itertools

import mujoco
import numpy as np
import pytest
from toy_policy import described

from dynappo.policy import episode, policy_file, policy_source
from dynappo.web import live as live_lib


@pytest.fixture(scope="module")
def trained():
    """The bundled Go1: `(player, act)`."""
    policy, _ = policy_source.load("go1")
    return policy_source.player(policy)[0], policy_file.actor(policy.params, policy.activation)


@pytest.fixture
def live(trained):
    return live_lib.Live(*trained)


def walk(live, seconds):
    for _ in range(round(seconds / episode.period(live.player))):
        live_lib.step(live)


def test_it_walks_as_an_episode_does(live, trained):
    """The same commands give the same states, bit for bit."""
    live_lib.steer(live, [0.6, 0.1, -0.3])
    live_lib.reset(live)
    walk(live, 0.98)
    expected = episode.play(*trained, lambda t: np.array([0.6, 0.1, -0.3]), 1.0)
    np.testing.assert_array_equal(live.row["qpos"], expected["qpos"][-1])
    history = np.array([velocity for _, _, velocity, _ in live.history])
    np.testing.assert_array_equal(history, expected["velocity"])


def test_a_command_stays_in_what_was_trained(live):
    live_lib.steer(live, [9, -9, 9])
    np.testing.assert_array_equal(live.command, live_lib.ranges(live.player)[[0, 1, 2], [1, 0, 1]])


def test_a_tour_goes_round_until_somebody_steers(live):
    live_lib.tour(live, True)
    walk(live, 1.0)
    np.testing.assert_array_equal(live.row["command"], episode.TOUR[0][1])
    again = live_lib.command_at(live, live_lib.TOUR + 1.0)
    np.testing.assert_array_equal(again, live_lib.command_at(live, 1.0))
    live_lib.steer(live, [0.1, 0, 0])
    np.testing.assert_array_equal(live_lib.command_at(live, 1.0), [0.1, 0, 0])
    live_lib.tour(live, True)
    live_lib.tour(live, False)
    assert not live_lib.command_at(live, 1.0).any()


def test_a_push_is_a_velocity_in_the_heading_of_the_base(live):
    """Turned by 90 degrees, ahead is the world's y and left its -x."""
    q, v = live.player.root
    live.data.qpos[q + 3 : q + 7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    mujoco.mj_kinematics(live.player.model, live.data)
    before = live.data.qvel.copy()
    live_lib.push(live, 0.5, 0.2)
    change = live.data.qvel - before
    np.testing.assert_allclose(change[v : v + 2], [-0.2, 0.5], atol=1e-12)
    assert not np.delete(change, [v, v + 1]).any()


def test_a_pull_is_a_spring_with_a_limit(live):
    model, base = live.player.model, live.player.base_body
    weight = model.body_subtreemass[base] * 9.81
    live.pull = np.array([0.0, 0.1, 0.0])
    live_lib.step(live)
    expected = [0, live_lib.STIFF * 0.1 * weight, 0]
    np.testing.assert_allclose(live.data.xfrc_applied[base, :3], expected, rtol=1e-6)
    walk(live, 0.3)
    assert live.row["velocity"][1] > 0.1
    live.pull = np.array([0.0, 9.0, 0.0])
    live_lib.step(live)
    strongest = live_lib.STRONGEST * weight
    assert np.linalg.norm(live.data.xfrc_applied[base]) == pytest.approx(strongest)
    live.pull = None
    live_lib.step(live)
    assert not live.data.xfrc_applied.any()


def test_after_a_fall_it_lies_and_stands_up():
    policy = policy_file.describe(*described())
    player = policy_source.player(policy._replace(mjcf=""), None)[0]
    live = live_lib.Live(player, lambda obs: np.full(12, 6.0))
    for _ in range(200):
        live_lib.step(live)
        if live.fell is not None:
            break
    assert live.fell is not None
    live.act = lambda obs: np.zeros(12)
    walk(live, live_lib.LIE - 0.1)
    assert live.fell is not None
    walk(live, 0.3)
    assert live.fell is None and live.t < 0.5


def test_after_a_fall_the_tour_goes_on_and_after_a_reset_it_starts_anew(live):
    live_lib.tour(live, True)
    walk(live, 1.0)
    live.fell = live.t - live_lib.LIE
    second = next(t for t, _ in episode.TOUR if t) * live_lib.TOUR
    walk(live, second)
    assert live.t < second + 0.2, "it stood up"
    np.testing.assert_array_equal(live.row["command"], episode.TOUR[1][1])
    live_lib.reset(live)
    np.testing.assert_array_equal(live.row["command"], episode.TOUR[0][1])


def test_a_policy_that_always_blows_up_ends_nothing(live):
    live_lib.wish(live, live_lib.take_policy, lambda obs: np.full(12, np.nan))
    live.wishes.popleft()()
    walk(live, 1.0)
    assert np.isfinite(live.data.qpos).all() and "finite" in live.note


def test_physics_that_blows_up_starts_again_and_is_told(live):
    live.data.qvel[:] = np.nan
    live_lib.step(live)
    assert np.isfinite(live.data.qpos).all() and "not finite" in live.note


def clock(monkeypatch, drawing=0.0):
    """A clock that only `sleep` and what is drawn move on; returns its reading."""
    now = [0.0]
    monkeypatch.setattr(live_lib.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(live_lib.time, "sleep", lambda s: now.__setitem__(0, now[0] + s))
    return now, lambda: now.__setitem__(0, now[0] + drawing)


@pytest.mark.parametrize("speed", [1.0, 0.25])
def test_it_keeps_time(live, monkeypatch, speed):
    """Four seconds of a clock are four of the robot, or one in slow motion."""
    now, draw = clock(monkeypatch, 0.003)
    live.speed, began = speed, live.t
    live_lib.run(live, draw, lambda: now[0] >= 4)
    assert live.t - began == pytest.approx(4 * speed, abs=0.05)
    assert live.rate == pytest.approx(50 * speed, abs=2)


def test_what_cannot_be_caught_up_is_let_go(live, monkeypatch):
    """A picture that takes 0.3 s: at most CATCH_UP steps between two of them."""
    now, draw = clock(monkeypatch, 0.3)
    counts, began = [live.t], live.t
    live_lib.run(live, lambda: (counts.append(live.t), draw()), lambda: now[0] >= 4)
    steps = np.diff(counts) / episode.period(live.player)
    assert steps.max() <= live_lib.CATCH_UP + 1.5 and live.t > began


def test_wishes_are_granted_between_steps_also_while_it_is_paused(live, monkeypatch):
    now, draw = clock(monkeypatch)
    live.paused = True
    began, ticks = live.t, itertools.count()

    def after():
        if next(ticks) == 5:
            live_lib.wish(live, live_lib.steer, [0.3, 0, 0])

    live_lib.run(live, after, lambda: now[0] >= 1)
    assert live.t == began and live.command[0] == 0.3

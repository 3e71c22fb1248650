"""How feet move: drawn contacts, known feet, and a Go1 in C MuJoCo against points on its soles."""

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from toy_policy import GO1, actor, described, trot

from dynappo.evaluate import foot_motion, trials
from dynappo.policy import episode, policy_file

NAMES = ("FL", "FR", "RL", "RR")


@pytest.fixture(scope="module")
def player():
    """A Go1 whose actor always gives zero: it stands at the default pose."""
    policy = policy_file.describe(*described(), actor(size=0.0))
    return episode.load(GO1.xml, policy, policy.timestep)


CONTACTS = {  # contact, swings, touch-downs; shorter than 3 is a bounce
    "steps": ("####.....####.....####", [5, 5], [9, 18]),
    "cut at both ends": ("...####....####..", [4], [3, 11]),
    "a bounce at landing": ("####.....#.#####....###", [5 + 2, 4], [11, 20]),
    "a scuff in a swing": ("####...##...####", [8], [12]),
    "a short swing in a stance": ("####..####.....###", [5], [15]),
    "a step that the recording cuts": ("#....####....#", [4, 4], [5, 13]),
    "always": ("##########", [], []),
    "never": ("..........", [], []),
    "one step": ("...####...", [], [3]),
    "nothing": ("", [], []),
}


@pytest.mark.parametrize("name", CONTACTS)
def test_strides_of_drawn_contacts(name):
    drawing, swings, touchdowns = CONTACTS[name]
    lifts, lands, steps = foot_motion.strides(np.array([c == "#" for c in drawing], bool), 3)
    assert [(lands - lifts).tolist(), steps.tolist()] == [swings, touchdowns]
    assert all(drawing[a] == "." and drawing[a - 1] == "#" for a in lifts)
    assert all(drawing[b] == "#" and drawing[b - 1] == "." for b in lands)


def known(on=(24, 20, 12, 30), late=(0, 20, 20, 0), rows=1000, period=40):
    """Feet that are on the ground in the first `on` rows of each period, each `late` by some rows."""
    phase = (np.arange(rows)[:, None] - np.array(late)) % period
    contact = phase < np.array(on)
    swung = np.clip((phase - np.array(on)) / np.maximum(period - np.array(on), 1), 0, 1)
    load = np.array([100.0, 50, 50, 100]) * contact
    slide = np.where(phase < 10, 0.3, 0.1) * contact
    height = np.array([0.04, 0.06, 0.08, 0.1]) * np.sin(np.pi * swung)
    part: dict[str, Any] = dict(contact=contact, load=load, slide=slide, height=height)
    return part


def test_the_gait_of_known_feet(player):
    """Periods of 40 physics steps (0.2 s), each foot with its own share on the ground, height and slip."""
    on = np.array([24, 20, 12, 30])
    found = foot_motion.measures(player, [known(), known()])
    assert list(found["feet"]) == list(NAMES)
    tops = np.array([0.04, 0.06, 0.08, 0.1])
    slips = (10 * 0.3 + (on - 10) * 0.1) / on
    for j, (name, share) in enumerate(zip(NAMES, on / 40, strict=True)):
        foot = found["feet"][name]
        assert foot["duty_factor"] == pytest.approx(share)
        assert foot["air_time"] == pytest.approx(0.2 * (1 - share))
        assert foot["stride_frequency"] == pytest.approx(5.0)
        assert foot["clearance"] == pytest.approx(tops[j], rel=0.03)  # the top is between two rows
        assert foot["slip"] == pytest.approx(slips[j])
    assert found["duty_factor"] == pytest.approx((on / 40).mean())
    assert found["air_time"] == pytest.approx(0.2 * (1 - on / 40).mean())
    assert found["stride_frequency"] == pytest.approx(5.0)
    assert found["clearance"] == pytest.approx(tops.mean(), rel=0.03)
    assert found["slip"] == pytest.approx(slips.mean())
    # left: FL and RL, swings of 16 and 28 rows; right: 20 and 10
    assert found["asymmetry"] == pytest.approx((22 - 15) / 18.5)


def test_slip_counts_where_the_load_is(player):
    """A foot that slides with a tenth of its load slips a tenth."""
    part = known(on=(40,) * 4)
    part["load"], part["slide"] = np.full((1000, 4), 10.0), np.zeros((1000, 4))
    part["load"][:500], part["slide"][500:] = 90.0, 0.5
    assert foot_motion.measures(player, [part])["slip"] == pytest.approx(0.05)
    part["load"] = np.zeros((1000, 4))
    assert foot_motion.measures(player, [part])["slip"] is None


@pytest.mark.parametrize(
    "late, flight", [((0, 20, 20, 0), 0.0), ((0, 0, 0, 0), 0.4), ((0, 4, 0, 4), 0.3)]
)
def test_flight_is_the_time_with_every_foot_in_the_air(player, late, flight):
    """24 of 40 rows on the ground each: in turn, all at once, and 4 rows apart."""
    part = known(on=(24,) * 4, late=late)
    assert foot_motion.measures(player, [part])["flight"] == pytest.approx(flight, abs=0.005)
    part["contact"][:, 2] |= np.arange(1000) % 40 == 35  # a bounce is no landing
    assert foot_motion.measures(player, [part])["flight"] == pytest.approx(flight, abs=0.005)


def test_a_robot_that_stands_swings_no_foot(player):
    recording = trials.record(player, lambda obs: np.zeros(12), (0, 0, 0), 2.0)
    found = trials.gait(player, [recording])
    assert found["duty_factor"] == 1.0 and found["flight"] == 0.0 and found["slip"] < 0.02
    assert [found[name] for name in ("air_time", "stride_frequency", "clearance", "asymmetry")] == [
        None
    ] * 4
    weight = 9.81 * sum(player.model.body_mass)
    assert recording["load"][200:].sum(-1).mean() == pytest.approx(weight, rel=1e-3)


def test_a_foot_slides_as_fast_as_the_robot_that_stands_on_it(player):
    """The whole robot moves as one, ahead and about the vertical: the speed of each foot is v + w x r."""
    data = mujoco.MjData(player.model)
    episode.reset(player, data)
    for _ in range(200):
        episode.physics_step(player, data, player.policy.default_pose)
    data.qvel[:] = 0
    data.qvel[:6] = [0.3, 0.1, 0, 0, 0, 0.5]
    feet = [data.geom(f"{name}_foot").xpos[:2].copy() for name in NAMES]
    base = data.qpos[:2].copy()
    episode.physics_step(player, data, player.policy.default_pose)
    contact, load, slide = foot_motion.at_ground(player, data)
    assert contact.all() and (load > 1).all()
    for j, foot in enumerate(feet):
        x, y = foot - base
        assert slide[j] == pytest.approx(math.hypot(0.3 - 0.5 * y, 0.1 + 0.5 * x), abs=2e-3)


def test_the_feet_of_a_trot_are_those_of_a_loop(player):
    """Contacts and heights from the raw episode; the trot steps 2.5 times a second."""
    walked = trials.record(player, trot(), (0.4, 0, 0.3), 2.0)
    data, act, heights = mujoco.MjData(player.model), trot(), []
    episode.reset(player, data)
    for _ in range(100):
        target = 0.25 * act(None) + player.policy.default_pose
        for _ in range(4):
            episode.physics_step(player, data, target)
            heights.append(episode.foot_heights(player, data))
    heights = np.array(heights)
    np.testing.assert_allclose(walked["height"], heights, atol=1e-9)
    found = trials.gait(player, [walked])
    for j, name in enumerate(NAMES):
        down = heights[200:, j] < 0
        assert found["feet"][name]["duty_factor"] == pytest.approx(down.mean())
        tops, top, was = [], None, False
        for low, on in zip(heights[200:, j], down, strict=True):
            if not on and (was or top is not None):
                top = low if top is None else max(top, low)
            if on and top is not None:
                tops, top = [*tops, top], None
            was = on
        tall = [t for t in tops if t > 0.005]
        assert found["feet"][name]["clearance"] == pytest.approx(np.mean(tall), rel=0.05)
    assert found["stride_frequency"] == pytest.approx(2.5, abs=0.1)
    assert 0.05 < found["air_time"] < 0.3 and found["flight"] < 0.2

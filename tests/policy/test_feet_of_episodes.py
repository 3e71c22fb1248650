"""Which geoms of a file are feet, where it names them and where it does not; walks of other robots."""

import itertools
import re

import mujoco
import numpy as np
import other_robots
import pytest
from answers import refused
from toy_policy import GO1, actor, described, other_file

from dynappo.evaluate import figures, trials
from dynappo.policy import episode, policy_file

ROBOTS = {
    "mixed": (lambda: other_robots.biped(other_robots.MIXED, other_robots.BOX, arms=True), 2),
    "hexapod": (other_robots.hexapod, 6),
}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    make, feet = ROBOTS[request.param]
    made = make()
    assert len(made.foot_names) == feet
    return made


def body_of(robot, folder, change=lambda text: text):
    """As its file, changed, loads."""
    xml = folder / f"{robot.name}.xml"
    xml.write_text(change(robot.text))
    return episode.load(xml, other_robots.policy(robot))


def unnamed(text):
    return re.sub(r' name="\w+_foot\w*"', "", text)


def shapes(player):
    """The geoms of each foot."""
    return [np.flatnonzero(player.foot_of == k).tolist() for k in range(len(player.foot_names))]


def test_the_shapes_of_feet_are_known_by_their_names(robot, tmp_path):
    player = body_of(robot, tmp_path)
    assert player.foot_names == robot.foot_names
    expected = [robot.feet[robot.foot_of == k].tolist() for k in range(len(robot.foot_names))]
    assert shapes(player) == expected
    np.testing.assert_array_equal(np.flatnonzero(player.parts), robot.parts)


def test_without_names_they_are_the_limbs_that_reach_the_ground(robot, tmp_path):
    """Hands are none; what moves with a last link is of its foot."""
    player, model = body_of(robot, tmp_path, unnamed), robot.mj_model
    last = [int(model.geom_bodyid[i]) for i in robot.feet]
    assert player.foot_names == tuple(dict.fromkeys(model.body(b).name for b in last))
    touching = np.concatenate([robot.feet, robot.parts])
    expected = [[i for i in sorted(touching) if model.geom_bodyid[i] == b] for b in sorted({*last})]
    assert shapes(player) == expected
    hands = [i for i in robot.parts if model.body(model.geom_bodyid[i]).name.endswith("_arm")]
    assert player.parts[hands].all() and (len(hands) == 2) == (robot.name == "biped")


def test_the_order_of_bodies_and_the_base_in_the_file_do_not_matter(robot, tmp_path):
    """The base may lie on its side where the file places it."""
    aside = lambda text: unnamed(text).replace('pos="0 0 1"', 'pos="0 0 1" quat="0.7 0.7 0 0"')  # noqa: E731
    assert aside(robot.text) != unnamed(robot.text)
    assert len(body_of(robot, tmp_path, aside).foot_names) == len(robot.foot_names)


def test_a_geom_that_only_a_pair_lets_touch_is_a_foot(tmp_path):
    """As in files in which nothing but listed pairs collides."""
    robot = other_robots.biped()

    def paired(text):
        text = re.sub(r' con(type|affinity)="1"', "", text)
        pairs = "".join(f'<pair geom1="floor" geom2="{n}_foot"/>' for n in ("left", "right"))
        return text.replace("</mujoco>", f"<contact>{pairs}</contact></mujoco>")

    player = body_of(robot, tmp_path, paired)
    assert player.foot_names == ("left", "right") and not player.parts.any()


def test_a_file_without_feet_is_one_line(tmp_path):
    """Whose last links are looks alone."""
    robot = other_robots.biped()
    xml = tmp_path / "odd.xml"
    xml.write_text(re.sub(r"<geom[^>]*_foot[^>]*/>", "", robot.text))
    line = refused(episode.load, xml, other_robots.policy(robot))
    assert line.startswith(f"{xml}: expected feet: geoms named LEG_foot")


def test_heights_of_feet_are_those_of_points_on_their_surfaces(robot, tmp_path):
    player, rng = body_of(robot, tmp_path), np.random.default_rng(0)
    data = mujoco.MjData(player.model)
    for _ in range(20):
        data.qpos[:] = rng.normal(size=len(data.qpos))
        mujoco.mj_kinematics(player.model, data)
        low = other_robots.lowest_points(player.model, data.qpos, robot.feet)
        feet = range(len(robot.foot_names))
        expected = [low[robot.foot_of == k].min() for k in feet]
        np.testing.assert_allclose(episode.foot_heights(player, data), expected, atol=1e-6)


def test_a_recording_has_the_contacts_of_each_foot(robot, tmp_path):
    """Of any of its shapes, by heights; a gait and its picture have a row a foot."""
    player, count = body_of(robot, tmp_path), len(robot.foot_names)
    flail = lambda obs: np.sin(np.arange(len(robot.joint_names)) + 9 * obs[0])  # noqa: E731
    recording = trials.record(player, flail, [0.3, 0, 0], 1.0)
    data, contacts = mujoco.MjData(player.model), []
    episode.reset(player, data)
    for action in recording["action"]:
        target = player.policy.default_pose + player.policy.action_scale * action
        for _ in range(player.substeps):
            episode.physics_step(player, data, target)
            contacts.append(episode.foot_heights(player, data) < 0)
    found, contacts = recording["contact"], np.array(contacts)
    assert found.shape[1] == count and 0.05 < found.mean() < 0.95
    assert (found == contacts).mean() > 0.99  # heights that end at the floor aside
    np.testing.assert_array_equal([*trials.gait(player, [recording])["feet"]], robot.foot_names)


def test_a_policy_is_evaluated_on_a_file_that_names_no_foot(tmp_path):
    """As Menagerie's Go1, whose feet are FL, FR, RL, RR: the limbs are called as their last bodies."""
    policy = policy_file.describe(*described(), actor(size=0.0))
    player = episode.load(other_file(tmp_path / "other.xml"), policy)
    own = episode.load(GO1.xml, policy)
    assert [name[:2] for name in player.foot_names] == ["RR", "FL", "RL", "FR"]
    gaits = []
    for robot in (own, player):
        recording = trials.record(robot, trot(), [0.4, 0, 0], 2.0)
        gaits.append(trials.gait(robot, [recording]))
    expected, found = gaits[0]["feet"], gaits[1]["feet"]
    assert 0.2 < expected["FL"]["duty_factor"] < 0.9
    for name, foot in found.items():
        for measure, value in expected[name[:2]].items():
            assert foot[measure] == pytest.approx(value, abs=1e-6), (name, measure)


def trot():
    """A new policy that lifts diagonal legs in turn, 2.5 times a second, whatever it sees."""
    count = itertools.count()

    def act(obs):
        swing = np.sin(2 * np.pi * 2.5 * 0.02 * next(count))
        lift = np.array([max(0, swing), max(0, -swing), max(0, -swing), max(0, swing)])
        return np.stack([0 * lift, 2.0 * lift + 0.3, -4.0 * lift], 1).ravel()

    return act


def test_the_diagram_has_one_colour_for_feet_that_walk_together(tmp_path):
    """Diagonals of four, tripods of six, one foot of two."""
    pytest.importorskip("matplotlib")
    from matplotlib import colors

    blue = {2: "L", 4: "FL RR", 6: "FL MR RL"}
    for names in ("L R", "FL FR RL RR", "FL FR ML MR RL RR"):
        each = dict.fromkeys(names.split(), {"duty_factor": 0.5})
        row = {"command": [0.5, 0, 0], "feet": each, "fall": None, "speed": None}
        row |= {"stride_frequency": None, "duty_factor": None}
        shown = {"contact": np.ones((100, len(each)), bool)}
        panel = figures.gait("", {"ahead": [row]}, {(0.5, 0, 0): shown}, 0.01).axes[0]
        bars = [colors.to_hex(c.get_facecolor()[0]) for c in panel.collections[1::2]]
        found = [name for name, color in zip(each, bars, strict=True) if color == "#1f4e79"]
        assert found == blue[len(each)].split()

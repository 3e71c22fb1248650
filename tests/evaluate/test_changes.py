"""Falls when the command changes: against a loop of its own in C MuJoCo, and counted by hand."""

import mujoco
import numpy as np
import pytest
from toy_policy import ROBOTS

from dynappo.config import loading
from dynappo.evaluate import changes, tables
from dynappo.play import command_script
from dynappo.policy import episode, policy_file, policy_source
from dynappo.web import live

BUNDLED = (*ROBOTS, *(f"{name}_deploy" for name in ROBOTS))


def bundled(name):
    return policy_source.player(policy_source.load(name)[0])[0]


@pytest.fixture(scope="module")
def bodies():
    return {name: bundled(name) for name in ("go1", "go1_deploy")}


def network(policy):
    """The policy's mean action, written out: swish between its layers."""
    layers = policy.params["actor"]["params"]

    def act(x):
        for i in range(len(layers)):
            x = x @ layers[f"Dense_{i}"]["kernel"] + layers[f"Dense_{i}"]["bias"]
            x = x / (1 + np.exp(-x)) if i < len(layers) - 1 else x
        return np.clip(x, -10, 10)

    assert policy.activation == "swish"
    return act


def plain_loop(player, command, seconds):
    """Times of falls, in steps of 20 ms: observation, history, motors and contacts without our functions."""
    p, m = player.policy, player.model
    data, act, dt = mujoco.MjData(m), network(p), 0.02
    q, v = 7 + np.arange(12), 6 + np.arange(12)  # the robot's own file: base first, then the joints
    assert [m.joint(1 + i).name for i in range(12)] == list(p.joint_names)
    found, fresh = [], True
    action, seen = np.zeros(12), []
    for k in range(round(seconds / dt)):
        if fresh:
            episode.reset(player, data)
            action, seen, fresh = np.zeros(12), [], False
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        down = rotation.reshape(3, 3).T
        turning = data.qvel[3:6]
        ahead = down @ data.qvel[:3] + np.cross(turning, m.body_ipos[player.base_body])
        sensed = [data.qpos[q] - p.default_pose, data.qvel[v], down @ [0, 0, -1.0]]
        sensed += [ahead] if p.observation == "velocity-48" else []
        now = np.concatenate([*sensed, turning, command(k * dt), action])
        seen = [now, *(seen or [now] * p.history)][: p.history]
        action = act(np.concatenate(seen))
        fell = False
        for _ in range(4):
            speed = data.qvel[v]
            torque = p.kp * (p.default_pose + p.action_scale * action - data.qpos[q]) - p.kd * speed
            limit = p.saturation_effort * (1 - np.abs(speed) / p.velocity_limit)
            limit = np.minimum(limit, p.effort_limit)  # with the motion; all of it against
            top = np.where(speed > 0, limit, p.effort_limit)
            low = np.where(speed < 0, -limit, -p.effort_limit)
            data.qfrc_applied[v] = np.clip(torque, low, top)
            mujoco.mj_step(m, data)
            for contact in data.contact:
                names = [m.geom(g).name for g in (contact.geom1, contact.geom2)]
                at_floor = 0 in m.geom_bodyid[[contact.geom1, contact.geom2]]
                feet = any(name.endswith("_foot") for name in names)
                fell |= contact.dist < 0 and at_floor and not feet
        if fell:
            found.append((k + 1) * dt)
            fresh = True
    return found


HARD = np.array([[0.5, 0, 0], [-3.0, 0, 0], [3.0, 2.0, 2.0], [0, -3.0, 0], [2.0, 0, 3.0]])


@pytest.mark.parametrize("name", ["go1", "go1_deploy"])
def test_falls_are_those_of_a_plain_loop(bodies, name):
    """Commands far beyond what was trained, one every second: it falls, stands up, goes on, falls again."""
    player = bodies[name]
    command = lambda t: HARD[int((t + 1e-9) // 1.0)]  # noqa: E731
    expected = plain_loop(player, command, len(HARD))
    act = policy_file.actor(player.policy.params, player.policy.activation)
    found = changes.falls(player, act, command, len(HARD))
    assert len(expected) >= 2
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_blow_up_is_a_fall(bodies):
    """Each control step from standing has one; nothing is raised."""
    act = lambda obs: np.full(12, np.nan)  # noqa: E731
    found = changes.falls(bodies["go1"], act, lambda t: np.zeros(3), 0.1)
    np.testing.assert_allclose(found, [0.02, 0.04, 0.06, 0.08, 0.1])


def test_commands_are_drawn_from_the_ranges_that_were_trained(bodies):
    """Every 2 to 3 s, at whole control steps; uniform, to four standard errors."""
    policy = bodies["go1"].policy._replace(command_x=(-0.5, 2.0), command_yaw=(0.25, 0.25))
    drawn = [changes.script(policy, 0.02, 8, np.random.default_rng(s)) for s in range(300)]
    times = np.stack([t for t, _ in drawn])
    commands = np.concatenate([c for _, c in drawn])
    assert times.shape == (300, 10) and (times[:, 0] == 0).all()
    between = np.diff(times)
    assert between.min() >= 2.0 - 1e-9 and between.max() <= 3.0 + 1e-9
    np.testing.assert_allclose(between / 0.02, np.round(between / 0.02), atol=1e-6)
    lows, highs = np.array([[-0.5, -1.0, 0.25], [2.0, 1.0, 0.25]])
    assert (commands >= lows).all() and (commands <= highs).all()
    error = 4 * (highs - lows) / np.sqrt(12 * len(commands))
    assert (np.abs(commands.mean(0) - (lows + highs) / 2) <= error + 1e-12).all()
    assert abs(between.mean() - 2.5) < 4 / np.sqrt(12 * between.size)


def test_a_fall_belongs_to_the_last_change_and_counts_once(bodies, monkeypatch):
    """10 changes are walks of 8 and of 2. Made-up falls, in control steps around the changes."""
    player, rng = bodies["go1"], np.random.default_rng
    (first, one), (second, two) = (
        changes.script(player.policy, 0.02, n, rng([7, walk])) for walk, n in enumerate((8, 2))
    )
    made_up = iter(
        [
            [
                0.5,  # under the first command
                first[1],  # in the step that ends as the command changes: the first command's
                first[2] + 0.02,  # in the first step of the second change
                first[2] + 0.4,  # once more
                first[3] - 0.02,
                first[9],  # in the very last step, of the eighth change
            ],
            [second[1] + 1.0],
        ]
    )
    given = []

    def falls(player, act, command, seconds):
        given.append([command(t) for t in np.arange(0, seconds - 0.01, 0.02)])
        return next(made_up)

    monkeypatch.setattr(changes, "falls", falls)
    told = []
    found = changes.run(player, 10, 7, lambda *count: told.append(count))
    assert told == [(0, 10), (8, 10), (10, 10)]
    numbers = {name: found[name] for name in ("changes", "falls", "walks", "start_falls", "seed")}
    assert numbers == {"changes": 10, "falls": 3, "walks": 2, "start_falls": 1, "seed": 7}
    expected = [(one, 2, 0.02), (one, 8, first[9] - first[8]), (two, 1, 1.0)]
    for row, (commands, i, after) in zip(found["fell"], expected, strict=True):
        assert row["before"] == list(commands[i - 1]) and row["command"] == list(commands[i])
        assert row["after"] == pytest.approx(after)
    for asked_for, (times, commands) in zip(given, ((first, one), (second, two)), strict=True):
        steps = np.round(np.diff(times) / 0.02).astype(int)
        np.testing.assert_array_equal(asked_for, np.repeat(commands, steps, 0))


def test_a_seed_gives_the_same_falls_and_more_changes_the_same_first(bodies, monkeypatch):
    """Real walks, with changes every 0.3 s from one end of what nobody trained to the other."""
    monkeypatch.setattr(changes, "EVERY", (0.3, 0.5))
    monkeypatch.setattr(changes, "PER_WALK", 3)
    player = bodies["go1"]
    wild = player._replace(policy=player.policy._replace(command_x=(-4, 4), command_y=(-3, 3)))
    found, again, more = (changes.run(wild, number, 3) for number in (6, 6, 8))
    assert found == again and 0 < found["falls"] <= 6
    assert more["fell"][: len(found["fell"])] == found["fell"]
    assert changes.run(wild, 6, 4)["fell"] != found["fell"]


def test_the_tours_are_those_that_are_shown(bodies, monkeypatch):
    """What `play` films, what a run films, and what the live page asks for, within what was trained."""
    player = bodies["go1"]
    narrow = player._replace(policy=player.policy._replace(command_x=(-0.7, 0.7)))
    given = []

    def falls(player, act, command, seconds):
        given.append((np.array([command(t) for t in np.arange(0, seconds, 0.02)]), seconds))
        return [1.0, 2.0]

    monkeypatch.setattr(changes, "falls", falls)
    film, page = changes.tours(narrow)
    assert film == {"tour": "film", "seconds": 12.0, "fell_at": [1.0]}
    assert page == {"tour": "live page", "seconds": 32.0, "fell_at": [1.0, 2.0]}
    plain = command_script.commands(None, None)
    assert command_script.within(command_script.ranges_of(player.policy), plain) is plain
    played = command_script.within(command_script.ranges_of(narrow.policy), plain)
    assert (
        played.text == f"{plain.text}, as far as it was trained" and played.rows[:, 0].max() == 0.7
    )
    assert played.seconds == 12.0 == loading.load("go1:best").run.video_seconds
    shown = live.Live(narrow, lambda obs: np.zeros(12))
    live.tour(shown, True)
    for (commands, seconds), at in zip(
        given, (played.at, lambda t: live.command_at(shown, t)), strict=True
    ):
        np.testing.assert_array_equal(commands, [at(t) for t in np.arange(0, seconds, 0.02)])
    assert given[1][0][:, 0].max() == 0.7


def test_falls_are_told_in_lines():
    row = {"before": [0.5, 0.0, 0.0], "command": [1.0, -0.25, 0.125], "after": 0.62}
    about = {"changes": 200, "falls": 7, "walks": 25, "start_falls": 2, "every": [2.0, 3.0]}
    tours = [{"tour": "film", "seconds": 12.0, "fell_at": []}]
    tours += [{"tour": "live page", "seconds": 32.0, "fell_at": [8.44, 24.46]}]
    lines = tables.changes_lines(about | {"fell": [row] * 7, "tours": tours})
    assert "one every 2 to 3 s" in lines[0] and lines[0].endswith("falls after 7 of 200")
    said = "fell 0.6 s after 0.50, 0.00 m/s, 0.00 rad/s became 1.00, -0.25 m/s, 0.12 rad/s"
    assert lines[1:6] == [said] * 5
    assert lines[6:] == [
        "fell after 2 other changes: see evaluation.json",
        "fell before any change in 2 of 25 walks",
        "the tour of the film, 12 s: no fall",
        "the tour of the live page, 32 s: fell after 8.4, 24.5 s",
    ]
    for falls, ends in (
        (5, "4.0, 5.0 s"),
        (6, "4.0, 5.0 s, and 1 more time"),
        (31, "4.0, 5.0 s, and 26 more times"),
    ):
        tours[1]["fell_at"] = [float(t) for t in range(1, falls + 1)]
        last = tables.changes_lines(about | {"fell": [], "tours": tours})[-1]
        assert last == f"the tour of the live page, 32 s: fell after 1.0, 2.0, 3.0, {ends}"


@pytest.mark.slow
@pytest.mark.parametrize("name", BUNDLED)
def test_no_bundled_policy_falls_when_its_command_changes(name):
    found = changes.run(bundled(name))
    assert (found["changes"], found["falls"], found["start_falls"]) == (200, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", BUNDLED)
def test_every_bundled_policy_walks_the_tours(name):
    assert [tour["fell_at"] for tour in changes.tours(bundled(name))] == [[], []]

"""A policy of a Playground task on the live page, without a browser: its process, commands, pushes, falls."""

import itertools

import mujoco
import numpy as np
import pytest
from answers import refused, until
from toy_policy import actor

from dynappo import config as config_lib
from dynappo.policy import policy_file, task_player
from dynappo.web import live as live_lib
from dynappo.web import policies

pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")
server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")

from live_page import joined, serving, update  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402

ENV = "playground:Go1JoystickFlatTerrain"
COMMAND = slice(45, 48)  # of the 48 numbers that its policy sees


def params(size=0.1):
    """Networks for 48 numbers and 12 joints, which hardly move the robot."""
    return actor(0, (8,), size)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A policy.npz of the task."""
    path = tmp_path_factory.mktemp("task") / "policy.npz"
    config = config_lib.validate(config_lib.load(f"{ENV}:ppo"))
    policy_file.save(path, params(), config, None)
    return path


@pytest.fixture(scope="module")
def player():
    """The task's robot; its process is started once."""
    yield policies.task(ENV)
    policies.close()


@pytest.fixture
def live(player):
    return live_lib.Live(player, task_player.still(player))


def walk(live, seconds):
    for _ in range(round(seconds / live.player.dt)):
        live_lib.step(live)


def rows(player, count, act=None, **options):
    data = mujoco.MjData(player.model)
    every = task_player.rows(player, data, act or task_player.still(player), **options)
    return list(itertools.islice(every, count))


def test_an_episode_is_the_tasks_own_and_depends_on_its_seed(player):
    """Without a command from here the task draws its own; the same seed begins in the same place."""
    one, same, other = (rows(player, 20, seed=seed) for seed in (3, 3, 4))
    for name in ("qpos", "command", "velocity", "reward"):
        np.testing.assert_array_equal(*([row[name] for row in some] for some in (one, same)))
    assert np.abs(one[0]["qpos"][:2] - other[0]["qpos"][:2]).max() > 1e-3
    assert any(row["command"].any() for some in (one, other) for row in some)
    assert all(0.1 < row["qpos"][2] < 0.4 and not row["fell"] for row in one)


def test_a_command_is_what_the_policy_sees_and_the_reward_is_of(player):
    seen, wanted = [], np.array([0.5, -0.25, 0.75])

    def act(obs):
        seen.append(obs[COMMAND])
        return np.zeros(12)

    found = rows(player, 10, act, command=lambda t: wanted)
    np.testing.assert_allclose(seen[1:], np.tile(wanted, (9, 1)), atol=1e-6)
    np.testing.assert_allclose([row["command"] for row in found], np.tile(wanted, (10, 1)))
    # it stands, and is paid for the velocity that is asked for: exp(-error^2 / 0.25), times the step
    asked, still = (
        rows(player, 50, command=lambda t, v=v: np.array(v)) for v in ([1.5, 0, 0], [0.05, 0, 0])
    )
    assert 0.8 * player.dt < still[-1]["reward"] - asked[-1]["reward"] < 1.2 * player.dt


def test_a_push_and_a_pull_move_the_robot(live):
    """A push is a velocity at once, a pull a force in each step."""
    walk(live, 0.4)
    before = live.data.qvel[:2].copy()
    live_lib.push(live, 1.0, 0.0)
    live_lib.step(live)
    assert 0.3 < live.data.qvel[0] - before[0] < 1.2
    live_lib.reset(live)
    walk(live, 0.4)
    where = live.data.qpos[1]
    live.pull = np.array([0.0, 0.3, 0.0])
    walk(live, 0.3)
    assert live.data.qpos[1] - where > 0.02
    live.pull = None
    live_lib.step(live)
    assert not live.data.xfrc_applied.any()


def test_contacts_and_torques_are_those_of_a_robot_that_stands(live):
    """Four feet bear its weight, with torques of the task's own motors."""
    walk(live, 1.0)
    model, data, force = live.player.model, live.data, np.zeros(6)
    total = 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += force[0]
    weight = model.body_subtreemass[live.player.base_body] * 9.81
    assert data.ncon == 4 and total == pytest.approx(weight, rel=0.1)
    torque = np.array([row[3] for row in live.history])
    assert torque.shape == (len(live.history), 12) and 1 < np.abs(torque[-1]).max() < 30


def test_who_falls_lies_and_begins_again_elsewhere(live):
    first = live.data.qpos[:2].copy()
    live.act = lambda obs: np.tile([3.0, 3.0, -3.0], 4)  # the legs let it down, on a side
    live.data.qvel[0:3] = [0, 3.0, 2.0]
    for _ in range(200):
        live_lib.step(live)
        if live.fell is not None:
            break
    assert live.fell is not None
    live.act = task_player.still(live.player)
    walk(live, live_lib.LIE + 0.2)
    assert live.fell is None and live.t < 0.5
    assert np.abs(live.data.qpos[:2] - first).max() > 1e-3


def test_actions_that_are_no_numbers_end_nothing(live):
    live_lib.take_policy(live, lambda obs: np.full(12, np.nan))
    live_lib.step(live)
    assert "not finite" in live.note
    live_lib.step(live)
    assert live.paused and np.isfinite(live.data.qpos).all()
    live_lib.take_policy(live, task_player.still(live.player))
    live_lib.reset(live)
    walk(live, 0.2)
    assert live.t > 0.2 and np.isfinite(live.data.qpos).all()


def test_a_task_without_command_just_runs_and_begins_again(player):
    """As one: the same process, of which we say that it has none, and a short episode."""
    alone = player._replace(ranges=None, episode_length=10)
    live = live_lib.Live(alone, task_player.still(player))
    live_lib.steer(live, [1.0, 0, 0])
    assert not live.command.any() and live_lib.ranges(alone).shape == (0, 2)
    times = []
    for _ in range(25):
        live_lib.step(live)
        times.append(live.t)
    assert max(times) == pytest.approx(9 * player.dt) and min(times) == pytest.approx(player.dt)


def test_networks_of_another_size_are_refused(player, saved):
    policy = policy_file.load_other(saved)
    assert policy is not None
    assert task_player.actor(player, policy)(np.zeros(48)).shape == (12,)
    wrong = actor(0, (8,))
    wrong["actor"]["params"]["Dense_0"]["kernel"] = np.zeros((47, 8), np.float32)
    assert ENV in refused(task_player.actor, player, policy._replace(params=wrong))
    policy.config.ppo.activation = "print"
    assert "activation" in refused(task_player.actor, player, policy)


def test_a_process_that_ends_is_one_line(capfd):
    assert "expected playground:TASK or brax:NAME" in refused(task_player.start, "gym:Ant")
    assert "there is Go1Joystick" in refused(task_player.start, "playground:Go1Joystick")
    assert "dynappo:" not in capfd.readouterr().err


def test_the_page_of_a_policy(saved, player):
    """It walks in real time; sliders have the task's ranges, and steer; nobody else is let in."""
    with serving(port=8520, what=saved) as served:
        page, live = served.page, served.page.live
        assert live.player is player
        sliders = page.panels.sliders
        assert page.panels.steering.visible
        assert [s.max for s in sliders] == [1.5, 0.8, 1.2] and sliders[0].min == -1.5
        until(lambda: live.t > 0.3)
        with joined(served) as it:
            it.send(update(sliders[0], 0.7))
            until(lambda: live.row["command"][0] == pytest.approx(0.7))
            it.send(update(sliders[0], 9.0))  # no slider gives that
            it.send(update(sliders[1], 0.2))
            until(lambda: live.row["command"][1] == pytest.approx(0.2))
            assert live.command[0] == pytest.approx(0.7)
            until(lambda: ENV in page.panels.status.content and "Hz" in page.panels.status.content)
        with pytest.raises(InvalidStatus), joined(served, origin="http://evil.test"):
            pass
        # a robot of ours, and back: the task's process is still there
        for name, robot in (("go2", "go2"), (str(saved), ENV)):
            found = policies.load(page.offer, name)
            live_lib.wish(live, lambda _, f=found, n=name: server.play(page, f, n))
            until(lambda r=robot: live_lib.name(live.player) == r and live.t > 0.1)
        alone = player._replace(ranges=None)
        found = policies.Chosen(alone, task_player.still(alone), "alone")
        live_lib.wish(live, lambda _: server.play(page, found, "alone"))
        until(lambda: live.player is alone and live.t > 0.1)
        assert not page.panels.steering.visible


def test_a_run_that_has_no_policy_yet_shows_the_tasks_robot(player, tmp_path, saved):
    """And its newest policy when it has one."""
    config = config_lib.validate(config_lib.load(f"{ENV}:ppo"))
    (tmp_path / "config.json").write_text(config_lib.to_json(config))
    offer = policies.Offer(str(tmp_path), None, None, False)
    found = policies.load(offer, policies.NEWEST)
    assert found.player is player and "no policy yet" in found.text
    (tmp_path / "policy.npz").write_bytes(saved.read_bytes())
    found = policies.load(offer, policies.NEWEST)
    assert found.player is player and found.act(np.ones(48)).any()


def test_the_process_ends_with_the_page(player):
    """The last test here: closed by who started it. It ends by itself, because its stdin does."""
    assert player.process.poll() is None
    policies.close()
    assert player.process.returncode == 0 and not policies.STARTED
    assert "has ended" in refused(rows, player, 1)

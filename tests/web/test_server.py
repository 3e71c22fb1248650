"""The page of a run, without a browser: the newest policy by itself, and what is listed."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import other_robots
import pytest
from answers import PATIENCE, until
from toy_policy import described, save

from dynappo import config as config_lib
from dynappo.policy import episode, policy_file
from dynappo.web import address, policies

server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")

panels = pytest.importorskip("dynappo.web.panels")


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The page of a run that has just begun; `page.folder` is its folder."""
    monkeypatch.setattr(policies, "EVERY", 0.05)
    config, _ = described()
    (tmp_path / "config.json").write_text(config_lib.to_json(config))
    offer, stop, told = policies.Offer(str(tmp_path), None, None, False), threading.Event(), []
    args = offer, address.Address("127.0.0.1", 8470), policies.load(offer, policies.NEWEST)
    how = {"ready": lambda page, url: told.append(page), "stop": stop}
    thread = threading.Thread(target=server.serve, args=args, kwargs=how)
    thread.start()
    until(lambda: told)
    yield told[0]
    stop.set()
    thread.join(PATIENCE)


def test_a_new_policy_of_the_run_acts_while_the_robot_goes_on(page, tmp_path):
    live = page.live
    assert "no policy yet" in page.text
    until(lambda: live.t > 0.3)
    first, data = live.act, live.data
    save(tmp_path / "policy.npz", seed=3)
    until(lambda: live.act is not first)
    second = live.act
    assert live.t > 0.3 and live.data is data, "it was not put back to its feet"
    assert page.text == f"{tmp_path.name}/policy.npz (no checkpoint)"
    obs = np.linspace(-1, 1, 48)
    save(tmp_path / "policy.npz", seed=4)
    until(lambda: live.act is not second)
    assert not np.allclose(live.act(obs), second(obs))


def test_who_chose_another_policy_keeps_it(page, tmp_path):
    live = page.live
    found = policies.load(page.offer, "go2")
    page.live.wishes.append(lambda: server.play(page, found, "go2"))
    until(lambda: live.player.policy.robot == "go2")
    assert live.t < 1 and page.panels.sliders[0].max == pytest.approx(
        live.player.policy.command_x[1]
    )
    save(tmp_path / "policy.npz")
    time.sleep(0.5)
    assert live.player.policy.robot == "go2" and page.text == "robots/go2/policy.npz"


class Sets:
    """A slider or a box as `panels` sees it."""

    value = 0.0


def test_what_somebody_has_just_set_is_not_taken_back_before_it_is_heard():
    """A slider follows keys and the tour; one that nobody heard goes back, a moment later."""
    shown = SimpleNamespace(sliders=[Sets(), Sets(), Sets()], tour=Sets(), seen=[])
    slider = shown.sliders[0]
    panels._follow(shown, [0.0, 0.0, 0.0, False])
    slider.value = 0.3  # by hand; the wish is on its way
    panels._follow(shown, [0.0, 0.0, 0.0, False])
    assert slider.value == 0.3
    panels._follow(shown, [0.3, 0.0, 0.0, False])
    panels._follow(shown, [0.4, 0.0, 0.0, True])  # by a key
    assert slider.value == 0.4 and shown.tour.value
    slider.value = 0.9  # nobody heard it
    panels._follow(shown, [0.4, 0.0, 0.0, True])
    panels._follow(shown, [0.4, 0.0, 0.0, True])
    assert slider.value == 0.4
    slider.value = 0.9  # the same again, at once
    panels._follow(shown, [0.4, 0.0, 0.0, True])
    assert slider.value == 0.9


def test_torques_of_any_robot_are_drawn_a_plot_for_each_kind_of_joint(page, tmp_path):
    """A biped with arms: seven kinds, a line for left and right; then a hexapod: three kinds, six lines."""
    live, shown = page.live, page.panels
    assert [plot.title for plot in shown.torque] == ["hip, N m", "thigh, N m", "calf, N m"]
    biped, hexapod = other_robots.biped(arms=True), other_robots.hexapod()
    for robot, kinds, lines in (
        (biped, 7, ["left", "right"]),
        (hexapod, 3, [*other_robots.HEXAPOD]),
    ):
        xml = tmp_path / f"{robot.name}.xml"
        xml.write_text(robot.text)
        policy = other_robots.policy(robot)
        act = policy_file.actor(policy.params, policy.activation)
        chosen = policies.Chosen(episode.load(xml, policy), act, robot.name)
        live.wishes.append(lambda chosen=chosen: server.play(page, chosen, "other"))
        until(lambda name=robot.name: live.player.policy.robot == name and len(live.history) > 2)
        live.wishes.append(lambda: panels.draw(shown, live))
        until(lambda: len(shown.torque[-1].data[0]) > 3)
        assert len(shown.torque) == kinds
        for plot in shown.torque:
            assert [line["label"] for line in plot.series[1:]] == lines
            assert len(plot.data) == len(plot.series)

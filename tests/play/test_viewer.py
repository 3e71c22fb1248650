"""The viewer: keys that steer within what was trained, a window that starts again, no display."""

import contextlib
import sys
import types

import mujoco
import numpy as np
import pytest
from answers import refused
from toy_policy import GO1, actor, described

from dynappo.play import viewer
from dynappo.policy import episode, policy_file


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor())


def test_the_keys_are_not_those_of_mujocos_viewer():
    """No shortcut of a flag (letters and signs), nor a key that its source handles."""
    taken = {entry[2] for entry in (*mujoco.mjVISSTRING, *mujoco.mjRNDSTRING)}
    taken |= set("[]-=012345")  # cameras, speed, groups of geoms (simulate.cc)
    assert not taken & {chr(key) for key in viewer.STEER if key < 256}
    page_up, escape, tab, function_keys = 266, 256, 258, range(290, 302)
    others = {page_up, escape, tab, *function_keys}
    assert not others & {viewer.STOP, *viewer.STEER}


def test_keys_change_the_command_within_what_was_trained(policy):
    command = np.zeros(3)
    for key, times in ((265, 5), (263, 2), (57, 3)):
        for _ in range(times):
            command = viewer.steer(command, key, policy)
    np.testing.assert_allclose(command, [0.5, -0.3, 0.2])
    for _ in range(20):
        command = viewer.steer(command, 264, policy)
    np.testing.assert_allclose(command, [-1.0, -0.3, 0.2])
    np.testing.assert_array_equal(viewer.steer(command, ord("Q"), policy), command)
    np.testing.assert_array_equal(viewer.steer(command, viewer.STOP, policy), np.zeros(3))


def test_the_viewer_steers_and_starts_again(policy, monkeypatch):
    """A window that presses keys: they take over from the script; backspace begins a new episode."""
    player = episode.load(GO1.xml, policy, policy.timestep)
    act = policy_file.actor(policy.params, policy.activation)
    seen, texts = [], []

    class Window:
        def __init__(self, data, press):
            self.data, self.press = data, press
            self.user_scn = mujoco.MjvScene(player.model, 20)

        def is_running(self):
            return len(seen) < 12

        def lock(self):
            return contextlib.nullcontext()

        def set_texts(self, rows):
            texts.append(rows)

        def sync(self):
            seen.append((self.data.time, self.user_scn.ngeom))
            if len(seen) == 4:
                for key in (265, 265, 263, ord("Q")):
                    self.press(key)
            if len(seen) == 8:
                mujoco.mj_resetData(player.model, self.data)

    @contextlib.contextmanager
    def window(player, data, press):
        yield Window(data, press)

    monkeypatch.setattr(viewer, "window", window)
    rows = viewer.watch(player, act, lambda t: np.array([0.3, 0.0, 0.0]), None)
    times = [t for t, _ in seen]
    assert times[:8] == sorted(times[:8]) and times[8] < times[7]
    np.testing.assert_allclose(rows["command"], np.tile([0.5, 0.0, 0.1], (len(rows["command"]), 1)))
    assert len(rows["qpos"]) >= 5 and rows["qpos"][0, 2] > 0.2
    assert max(count for _, count in seen) >= 1
    assert "+0.30" in texts[0][0][3] and "+0.50" in texts[-1][0][3]
    seen.clear()
    assert 3 <= len(viewer.watch(player, act, lambda t: np.zeros(3), 0.06)["qpos"]) < 12


def test_a_display_that_is_not_there_is_one_line(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "--out=walk.html" in refused(viewer.check_display)
    monkeypatch.setenv("DISPLAY", ":0")
    fake = types.SimpleNamespace(glfw=types.SimpleNamespace(init=lambda: False))
    monkeypatch.setitem(sys.modules, "mujoco.viewer", fake)
    monkeypatch.setattr(mujoco, "viewer", fake, raising=False)
    assert "cannot be opened" in refused(viewer.check_display)

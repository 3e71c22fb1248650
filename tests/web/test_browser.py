"""The live page in Chromium: what is seen, and what mouse, keys and sliders do to the robot."""

import contextlib
import threading
import time
import urllib.request
from types import SimpleNamespace

import browser
import numpy as np
import pytest
from answers import until

from dynappo.web import address, policies
from dynappo.web import live as live_lib

viser = pytest.importorskip("viser", reason="viser is not installed (extra web)")
server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")
pytestmark = browser.needed
SIZE = (1200, 800)  # pixels: panels on both sides leave the robot half of it


@contextlib.contextmanager
def serving(port, ground=None):
    """The bundled Go1 on a page: `page`, `url`."""
    offer, stop, told = policies.Offer("go1", None, None, False, ground), threading.Event(), []
    args = offer, address.Address("127.0.0.1", port), policies.load(offer, "go1")

    def ready(page, url):
        scene = page.server.scene  # a CPU draws it, so without shadows and reflections
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        scene.configure_environment_map = lambda *_, **__: None  # another robot would turn it on
        told.append(SimpleNamespace(page=page, url=url))

    thread = threading.Thread(target=server.serve, args=args, kwargs={"ready": ready, "stop": stop})
    thread.start()
    try:
        yield until(lambda: told)[0]
    finally:
        stop.set()
        thread.join(browser.PATIENCE)
        assert not thread.is_alive()


@pytest.fixture(scope="module")
def served():
    with serving(8480) as it:
        yield it


@pytest.fixture(scope="module")
def tab(served, tmp_path_factory):
    """The page in a wide window, when the robot is there."""
    with browser.chromium(tmp_path_factory.mktemp("wide"), SIZE) as open_:
        yield shown(open_(served.url))


VISIBLE = (
    "[...document.querySelectorAll('input[type=checkbox]')]"
    ".filter(e => e.getBoundingClientRect().width > 0)"
)


def shown(tab):
    """Wait for the canvas and the numbers."""
    tab.until("!!document.querySelector('canvas')")
    tab.until("document.body.innerText.includes('asked')")
    time.sleep(2)
    return tab


def robot(pixels):
    """The middle of the canvas of a wide window, where the robot is."""
    return pixels[250:550, 400:780].astype(int)


def dark(pixels, most=130):
    """The share of pixels that are parts of a robot; a page becomes clear while it opens."""
    return (pixels.astype(int).mean(-1) < most).mean()


def test_the_robot_is_seen_and_walks(served, tab, tmp_path):
    """Dark and light parts of a Go1 on a white ground; the picture changes when it walks."""
    live = served.page.live
    until(lambda: dark(robot(tab.pixels(tmp_path / "wide.png"))) > 0.005)
    still = robot(tab.pixels())
    assert (still.mean(-1) > 240).mean() > 0.2
    tab.key("i", "KeyI", 73)
    tab.key("i", "KeyI", 73)
    until(lambda: live.command[0] == pytest.approx(0.2))
    until(lambda: live.row["velocity"][0] > 0.1)
    until(lambda: np.abs(robot(tab.pixels()) - still).mean() > 0.5)
    tab.key(" ", "Space", 32)
    until(lambda: not live.command.any())


def test_keys_pause_and_go_on(served, tab):
    live = served.page.live
    tab.key("p", "KeyP", 80)
    until(lambda: live.paused)
    t, seen = live.t, [robot(tab.pixels())]

    def rests():  # a slow machine still draws what came before
        time.sleep(0.5)
        seen.append(robot(tab.pixels()))
        return np.abs(seen[-1] - seen[-2]).mean() < 0.2

    try:
        until(rests)
        assert live.t == t
    finally:
        tab.press("go on")  # or the tests that follow wait for it
    until(lambda: live.t > t)


def test_a_slider_asks_for_a_turn(served, tab):
    """The number beside the slider and the slider itself are one value of the command."""
    live = served.page.live
    field = "[...document.querySelectorAll('input')].filter(e => e.inputMode === 'decimal')[2]"
    tab.click(*tab.middle(field))
    tab.value(f"{field}.select()")
    tab.call("Input.insertText", text="0.5")
    tab.key("Enter", "Enter", 13)
    until(lambda: live.command[2] == pytest.approx(0.5))
    until(lambda: live.row["velocity"][2] > 0.3)

    def stops():  # on a busy machine the page may move under a click
        tab.press("stop")
        time.sleep(1)
        return not live.command.any()

    until(stops)
    tab.until(f"Number({field}.value) === 0", "the slider follows the command")


def test_a_drag_on_the_robot_pulls_it_and_beside_it_turns_the_view(served, tab):
    live = served.page.live
    time.sleep(1)
    camera = next(iter(served.page.server.get_clients().values())).camera
    before = camera.position.copy()
    with tab.drag((590, 400), (720, 380)):
        until(lambda: live.pull is not None)
        assert np.linalg.norm(live.pull) > 0.05
        moved = until(lambda: np.linalg.norm(live.row["velocity"][:2]) > 0.15)
    assert moved and np.allclose(camera.position, before, atol=1e-6)
    until(lambda: live.pull is None)
    with tab.drag((420, 650), (560, 650)):
        until(lambda: np.linalg.norm(camera.position - before) > 0.1)


def test_a_push_moves_it(served, tab):
    """It stands anew first: it may have been pulled over."""
    live = served.page.live

    def sideways():
        return max((abs(velocity[1]) for _, _, velocity, _ in list(live.history)[-40:]), default=0)

    def anew():
        if live.t > 5:  # a busy machine may take seconds between the click and a look at the clock
            tab.press("reset")
        return live.fell is None and 1 < live.t < 5

    tab.press("reset")
    until(anew)
    assert sideways() < 0.15
    tab.key("x", "KeyX", 88)
    until(lambda: sideways() > 0.25)


PLOTTED = (
    "Object.values(__viserTestpoints.uplots).map(p => [p.chart.scales.x.min, p.chart.scales.x.max])"
)


def test_plots_end_now_also_after_a_reset(served, tab):
    """The last 8 s of motion are seen, and those of a robot that has just stood up."""

    def window():
        return tab.value(PLOTTED)[:3]

    until(lambda: window() == [[-live_lib.HISTORY, 0]] * 3)
    tab.press("reset")
    until(lambda: served.page.live.t < 1)
    time.sleep(2)
    assert window() == [[-live_lib.HISTORY, 0]] * 3


LEGEND = "document.querySelector('.uplot .u-legend').innerText"  # what is seen of it


def test_a_legend_has_values_only_where_the_mouse_is(tab):
    """Names alone, without the dashes of no value, until the mouse is in the plot."""
    alone = f"/^\\s*s\\s*command\\s*robot\\s*$/.test({LEGEND})"
    tab.mouse("mouseMoved", 590, 100)
    tab.until(alone, "names alone")
    tab.mouse("mouseMoved", *tab.middle("document.querySelector('.uplot .u-over')"))
    tab.until(f"/command\\s*-?[0-9]/.test({LEGEND})", "values")
    tab.mouse("mouseMoved", 590, 100)
    tab.until(alone, "names alone again")


def test_a_gamepad_steers_and_stops(served, tab):
    """Its left stick held ahead, then its first button."""
    live = served.page.live
    pad = "{index: 0, axes: [0, %s, 0, 0], buttons: [{pressed: %s}]}"
    give = "navigator.getGamepads = () => [%s]; true"
    tab.value(give % pad % (-1, "false"))
    until(lambda: live.command[0] >= 0.3)
    tab.value(give % pad % (0, "true"))
    until(lambda: not live.command.any())
    tab.value(give % "null")


def test_contacts_and_forces_are_drawn(served, tab):
    def red():
        seen = robot(tab.pixels())
        return ((seen[..., 0] - seen[..., 1:].max(-1)) > 60).sum()

    assert red() < 20
    for name, more in (
        ("forces", True),
        ("forces", False),
        ("contacts", True),
        ("contacts", False),
    ):
        # after those of the tour and of following
        number = 2 + ("contacts", "forces").index(name)
        tab.click(*tab.middle(f"{VISIBLE}[{number}]"))
        until(lambda name=name, more=more: served.page.panels.look[name].value == more)
        if name == "forces":
            until(lambda more=more: (red() > 50) == more)


def test_another_policy_is_another_robot(served, tab):
    page = served.page
    page.panels.policy.value = "go1"
    tab.click(*tab.middle("[...document.querySelectorAll('input')].find(e => e.value === 'go1')"))
    option = "[...document.querySelectorAll('[role=option]')].find(e => e.innerText === 'anymal_c')"
    tab.click(*tab.middle(option))
    until(lambda: page.live.player.policy.robot == "anymal_c")
    tab.until("document.body.innerText.includes('anymal_c/policy.npz')")
    until(lambda: dark(robot(tab.pixels())) > 0.005)
    until(lambda: tab.value(PLOTTED)[:3] == [[-live_lib.HISTORY, 0]] * 3)
    assert page.panels.sliders[0].max == pytest.approx(page.live.player.policy.command_x[1])


NO_NOTE = "!document.querySelector('.mantine-Notification-root')"
ABOVE = """(() => {
  const panel = document.querySelector('.mantine-Paper-root[style*="position: fixed"]');
  const [a, b] = [panel, document.querySelector('canvas')].map(e => e.getBoundingClientRect());
  return a.left === 0 && a.width === innerWidth && a.height <= innerHeight / 2
    && Math.abs(b.bottom - a.top) < 1 && b.top === 0 && b.width === innerWidth;
})()"""


def test_notes_go_away(tab):
    """viser's, that there is no graphics card."""
    tab.until(NO_NOTE)


@pytest.mark.slow
def test_a_narrow_screen_and_a_second_viewer(served, tab, tmp_path):
    """Both see the same robot; the one who goes leaves the other, and the robot, as they are."""
    count = len(served.page.server.get_clients())
    with browser.chromium(tmp_path / "profile", browser.NARROW) as open_, tab.at_rest():
        other = shown(open_(served.url))
        assert len(served.page.server.get_clients()) == count + 1
        until(lambda: dark(other.pixels(tmp_path / "narrow.png")[80:310], 200) > 0.02)
        other.until(ABOVE, "the robot above, the panel below")
        other.until(NO_NOTE, "notes go away")
        other.key("i", "KeyI", 73)
        until(lambda: served.page.live.command[0] > 0)
        assert not other.errors
    until(lambda: len(served.page.server.get_clients()) == count)
    tab.press("stop")
    until(lambda: not served.page.live.command.any())


@pytest.mark.slow
def test_a_lost_connection_comes_back_by_itself(tmp_path):
    """The server goes, and another comes on its port: the same tab shows the new robot.

    Nobody looks at the tab while no server is there. viser asks every second while somebody does,
    and Chromium delays every attempt by more than that after some thirty in vain, a time that a
    busy machine needs for a new server.
    """
    with browser.chromium(tmp_path / "profile", SIZE) as open_:
        with serving(8490) as first:
            tab = shown(open_(first.url))
            tab.watched(False)
        with serving(8490) as second:
            assert second.url == first.url
            tab.watched(True)
            until(second.page.server.get_clients)
            live = second.page.live
            until(lambda: tab.key("i", "KeyI", 73) or live.command[0] > 0)


def test_nothing_was_wrong_in_the_console(tab):
    """The last test of this page. What viser's own sliders say of touch screens does no harm."""
    assert not [e for e in tab.errors if "preventDefault inside passive" not in e]


@pytest.mark.slow  # what the page is sent is the map (test_ground.py)
def test_stairs_are_seen_and_their_walls_are_darker(tmp_path):
    """A robot in a pit: around it are treads and, less of them, walls, each of one grey."""
    with (
        serving(8560, "pit_stairs:1") as at,
        browser.chromium(tmp_path / "profile", SIZE) as open_,
    ):
        tab = shown(open_(at.url))

        def seen():
            pixels = robot(tab.pixels(tmp_path / "stairs.png"))
            grey = pixels.mean(-1)[np.ptp(pixels, axis=-1) < 40]
            treads = ((grey > 150) & (grey < 200)).mean()
            walls = ((grey > 85) & (grey < 140)).mean()
            return treads > 0.3 and 0.05 < walls < treads

        until(seen)
        assert at.page.live.fell is None
        assert not [e for e in tab.errors if "preventDefault inside passive" not in e]


def test_only_this_machine_is_let_in(served):
    port = int(served.url.rpartition(":")[2])
    with urllib.request.urlopen(served.url, timeout=browser.PATIENCE) as answer:
        assert b"<html" in answer.read(2000)
    from dynappo.web.server import start

    with pytest.raises(Exception, match="cannot listen there"):
        start(address.Address("203.0.113.7", port))

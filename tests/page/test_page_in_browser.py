"""The page in one file, opened from the disk in Chromium."""

import time

import browser
import numpy as np
import pytest
from answers import until

from dynappo.page import episode_page
from dynappo.policy import episode, policy_file, policy_source

pytestmark = browser.needed
CHANGED = 1.0  # mean difference of two pictures, of 255


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Six seconds of the bundled Go1."""
    policy, _ = policy_source.load("go1")
    player, _ = policy_source.player(policy)
    act = policy_file.actor(policy.params, policy.activation)
    played = episode.play(player, act, episode.tour(6.0), 6.0)
    out = tmp_path_factory.mktemp("page") / "walk.html"
    episode_page.write(player, played, out, "go1", "the bundled policy", [("fall", "none")])
    assert out.stat().st_size < 4e6
    return out


SIZES = [browser.WIDE, pytest.param(browser.NARROW, marks=pytest.mark.slow)]


@pytest.fixture(scope="module", params=SIZES, ids=["wide", "narrow"])
def tab(request, written, tmp_path_factory):
    with browser.chromium(tmp_path_factory.mktemp("profile"), request.param) as open_:
        tab = open_(written.as_uri())
        tab.until("document.readyState === 'complete' && !!document.getElementById('time')")
        tab.size = request.param
        yield tab


def clock(tab):
    """The time (s) that the page shows."""
    return float(tab.value("document.getElementById('time').textContent").split()[0])


def playing(tab):
    return tab.value("document.getElementById('play').classList.contains('on')")


def play(tab, on):
    if playing(tab) != on:
        tab.click(*tab.middle("document.getElementById('play')"))
        tab.until(f"document.getElementById('play').classList.contains('on') === {str(on).lower()}")


def stage(tab):
    """The middle of the picture, without the cards at its edges."""
    width, height = tab.size
    return tab.pixels()[int(0.35 * height) : int(0.75 * height), width // 6 : -width // 6].astype(
        int
    )


def changed(one, other):
    return np.abs(one - other).mean() > CHANGED


def test_the_robot_is_drawn(tab, tmp_path):
    play(tab, False)
    seen = stage(tab)
    tab.pixels(tmp_path / "page.png")
    assert (seen.mean(-1) < 90).mean() > 0.003, "dark parts of a Go1"
    assert seen.std() > 10 and not tab.value("!document.getElementById('note').hidden")


def test_it_plays_and_stops_by_button_and_key(tab):
    play(tab, False)
    t, still = clock(tab), stage(tab)
    time.sleep(0.3)
    assert clock(tab) == t and not changed(stage(tab), still)
    play(tab, True)
    tab.until(f"parseFloat(document.getElementById('time').textContent) !== {t}")
    tab.key(" ", "Space", 32)
    tab.until("!document.getElementById('play').classList.contains('on')")
    tab.key(" ", "Space", 32)
    tab.until("document.getElementById('play').classList.contains('on')")
    play(tab, False)


def test_a_page_at_rest_draws_nothing(tab):
    """A notebook may hold many pages."""
    play(tab, False)
    tab.value(
        "(() => { const p = WebGL2RenderingContext.prototype, clear = p.clear; window.cleared = 0;"
        " p.clear = function (bits) { window.cleared++; return clear.call(this, bits); }; })()"
    )
    frames = "new Promise(r => { let n = 3; const on = () => n-- ? requestAnimationFrame(on) : r(0); on(); })"
    tab.value(frames)  # what was still to be drawn
    tab.value("window.cleared = 0")
    tab.value(frames)
    assert tab.value("window.cleared") == 0
    play(tab, True)
    tab.until("window.cleared > 1")
    play(tab, False)


def test_a_drag_along_the_chart_moves_in_time(tab):
    play(tab, False)
    x, y, width = tab.value(
        "(() => { const b = document.getElementById('chart').getBoundingClientRect();"
        " return [b.x, b.y + b.height / 2, b.width]; })()"
    )
    for share in (0.1, 0.5, 0.9):
        with tab.drag((x + 0.3 * width, y), (x + share * width, y)):
            pass
        tab.until(
            f"Math.abs(parseFloat(document.getElementById('time').textContent) - {6 * share}) < 0.6"
        )
    commands = tab.value("document.getElementById('vx-command').textContent")
    assert float(commands) == pytest.approx(1.0), "the tour ends fast ahead"


def test_a_drag_turns_the_view_and_the_wheel_goes_near(tab):
    play(tab, False)
    width, height = tab.size
    first = stage(tab)
    with tab.drag((width / 2, height / 2), (width / 2 + 120, height / 2 + 20)):
        pass
    until(lambda: changed(stage(tab), first))
    turned = stage(tab)
    at = {"x": width / 2, "y": height / 2, "deltaX": 0, "deltaY": -300}
    tab.call("Input.dispatchMouseEvent", type="mouseWheel", **at)
    until(lambda: changed(stage(tab), turned))


def test_the_buttons_change_the_speed_and_whether_it_follows(tab):
    text = "document.getElementById('speed').textContent"
    before = tab.value(text)
    tab.click(*tab.middle("document.getElementById('speed')"))
    tab.until(f"{text} !== {before!r}")
    pressed = "document.getElementById('follow').getAttribute('aria-pressed')"
    assert tab.value(pressed) == "true"
    tab.key("f", "KeyF", 70)
    tab.until(f"{pressed} === 'false'")


def test_of_a_task_without_commands_none_are_shown(tab):
    """Neither numbers nor a green line; the velocity stays."""
    shown = "getComputedStyle(document.getElementById('{}')).display !== 'none'"
    green = """[...document.getElementById('chart').getContext('2d').getImageData(0, 0, 600, 60).data]
        .some((x, i, all) => i % 4 === 1 && all[i + 2] > 60 && x > all[i - 1] + 40 && x > all[i + 1] + 20)"""
    told = [shown.format(one) for one in ("vx-command", "legend-command", "vx-velocity")]
    seen = []
    for asked in ("false", "true"):
        scene = f"{{...JSON.parse(document.getElementById('scene').textContent), asked: {asked}}}"
        tab.value(f"(postMessage({{scene: {scene}, subtitle: '', measures: []}}, '*'), 0)")
        tab.until(f"document.body.classList.contains('unasked') !== {asked}")
        seen.append([tab.value(one) for one in (*told, green)])
    assert seen == [[False, False, True, False], [True, True, True, True]]


def test_nothing_was_wrong_in_the_console_and_nothing_was_fetched(tab):
    """The last test of each window."""
    assert not tab.errors
    assert tab.value("performance.getEntriesByType('resource').length") == 0


def test_no_card_covers_another(tab):
    """Also on a phone, where facts and buttons have no room side by side."""
    boxes = tab.value(
        "['facts', 'tools', 'bar'].map(id => document.getElementById(id).getBoundingClientRect())"
        ".map(b => [b.left, b.top, b.right, b.bottom])"
    )
    for i, (left, top, right, bottom) in enumerate(boxes):
        for x, y, far, low in boxes[i + 1 :]:
            assert far <= left or right <= x or low <= top or bottom <= y, boxes

"""In Chromium: what a page of another site, a foreign name and a foreign policy can do to the live page.

Nothing. `evil.test` is a name that Chromium is told to look up as this machine.
"""

import contextlib
import http.server
import json
import threading
import time
from types import SimpleNamespace
from xml.sax.saxutils import escape

import browser
import pytest
from answers import until
from toy_policy import actor, described

from dynappo.description import robot as robot_lib
from dynappo.policy import episode, policy_file, policy_source

pytest.importorskip("mjviser", reason="mjviser is not installed (extra web)")

import msgspec  # noqa: E402
from live_page import CAMERA, PROTOCOL, serving, update  # noqa: E402
from websockets.sync import server as websocket_server  # noqa: E402

pytestmark = browser.needed
# what would run, were a text taken for HTML
RUNS = "<img src=x onerror=top.ran=1>"
RUNS_TOO = "<b onmouseover=a>{(()=>{top.ran=2})()}"


def hostile(path):
    """A policy.npz whose robot, joints and bodies have names that are scripts."""
    config, robot = described()
    text = robot.xml.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        text = text.replace(f"{leg}_", escape(f"{leg}{RUNS}_"))
    named = robot_lib.load_text(text, RUNS + RUNS_TOO, path)
    assert named.joint_names[0] == f"FL{RUNS}_hip_joint"
    policy_file.save(path, actor(), config, named)
    return path


@contextlib.contextmanager
def site(**pages):
    """Another web site: `index` and other pages; yields its port."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(pages.get(self.path[1:] or "index", "").encode())

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as it:
        threading.Thread(target=it.serve_forever, daemon=True).start()
        yield it.server_address[1]
        it.shutdown()


@contextlib.contextmanager
def evil_server():
    """A WebSocket server that has code run in whatever viser page connects; yields its port and guests."""
    guests = []

    def handler(line):
        guests.append(line.request.headers.get("Origin"))
        with contextlib.suppress(Exception):
            for _ in line:
                pass

    pick = lambda _, offered: offered[0] if offered else None  # noqa: E731
    with websocket_server.serve(handler, "127.0.0.1", 0, select_subprotocol=pick) as it:
        threading.Thread(target=it.serve_forever, daemon=True).start()
        yield SimpleNamespace(port=it.socket.getsockname()[1], guests=guests)
        it.shutdown()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The hostile policy on a page."""
    with serving(what=hostile(tmp_path_factory.mktemp("hostile") / "policy.npz")) as it:
        scene = it.page.server.scene  # a CPU draws it
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)
        yield it


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    flags = ("--host-resolver-rules=MAP evil.test 127.0.0.1",)
    with browser.chromium(tmp_path_factory.mktemp("profile"), browser.WIDE, *flags) as it:
        yield it


@pytest.fixture
def open_(window, served):
    """`open_(url) -> Tab`; after the test none is left that draws, or that the next one counts."""
    tabs = []
    yield lambda url: tabs.append(window(url)) or tabs[-1]
    for tab in tabs:
        tab.close()
    until(lambda: not served.page.server.get_clients())


def test_scripts_in_the_names_of_a_policy_do_not_run(served, open_):
    """Of its robot, joints and bodies, and in what the page notes: all are shown as they are."""
    served.page.live.note = f"note {RUNS} {RUNS_TOO}"
    tab = open_(served.url)
    tab.until("!!document.querySelector('canvas')")
    tab.until("document.body.innerText.includes('asked')")
    text = tab.value("document.body.innerText")
    assert RUNS + RUNS_TOO in text and f"note {RUNS} {RUNS_TOO}" in text
    tab.press("torques")
    tab.until(f"document.body.innerText.includes({json.dumps('FL' + RUNS)})", "names of the legs")
    time.sleep(1)
    assert tab.value("window.ran") is None
    assert tab.value("document.querySelectorAll('img[src=x]').length") == 0


STEER = """<script>
const line = new WebSocket("ws://%s", "%s");
window.got = [];
line.onopen = () => { got.push("open"); for (const m of %s) line.send(new Uint8Array(m)); };
line.onerror = () => got.push("error");
fetch("http://%s").then(a => a.text()).then(t => got.push(t), () => got.push("no answer"));
</script>"""


@pytest.mark.parametrize("name", ["127.0.0.1", "evil.test"])
def test_a_page_of_another_site_can_neither_steer_nor_read(served, open_, name):
    """It may be on another port of this machine, too."""
    live, slider = served.page.live, served.page.panels.sliders[0]
    asked = [list(msgspec.msgpack.encode(m)) for m in (CAMERA, update(slider, 0.3))]
    there = f"127.0.0.1:{served.port}"
    with site(index=STEER % (there, PROTOCOL, json.dumps(asked), there)) as port:
        tab = open_(f"http://{name}:{port}")
        tab.until("window.got && got.length == 2")
        time.sleep(1)
        assert sorted(tab.value("got")) == ["error", "no answer"]
    assert not live.command.any() and slider.value == 0


def test_a_foreign_name_that_leads_here_shows_nothing(served, open_):
    """DNS rebinding: the page of evil.test would have the same origin as the server."""
    tab = open_(f"http://evil.test:{served.port}")
    tab.until("document.readyState === 'complete' && document.body.innerText.length > 0")
    assert "the page has another address" in tab.value("document.body.innerText")
    assert tab.value("document.querySelector('canvas')") is None


def test_another_server_is_never_asked_what_to_show(served, open_):
    """Neither by a link with `?websocket=` nor by a script in the page."""
    with evil_server() as evil:
        tab = open_(f"{served.url}/?websocket=ws://127.0.0.1:{evil.port}")
        tab.until("document.readyState === 'complete' && document.body.innerText.length > 0")
        time.sleep(2)
        assert evil.guests == [] and tab.value("document.querySelector('canvas')") is None
        guests = len(served.page.server.get_clients())
        tab = open_(served.url)
        tab.until("!!document.querySelector('canvas')")
        until(lambda: len(served.page.server.get_clients()) > guests)
        tab.value(
            f"new Promise(done => {{ const line = new WebSocket('ws://127.0.0.1:{evil.port}', "
            f"'{PROTOCOL}'); line.onopen = line.onerror = () => done(1); }}).catch(() => 0)"
        )
        assert evil.guests == []


def test_no_other_site_has_the_page_in_a_frame(served, open_):
    """Clicks there would be clicks here. A notebook on this machine may."""
    frame = f"<iframe src='{served.url}' width=800 height=500></iframe>"
    count = len(served.page.server.get_clients())
    with site(index=frame) as port:
        tab = open_(f"http://evil.test:{port}")
        until(lambda: tab.value("1") and any("frame-ancestors" in line for line in tab.errors))
        assert len(served.page.server.get_clients()) == count
        open_(f"http://127.0.0.1:{port}")
        until(lambda: len(served.page.server.get_clients()) > count)


# ---- the page in one file

SENDS = """<iframe id=it src="/page"></iframe><script>
addEventListener("load", () => { for (const measures of %s)
  it.contentWindow.postMessage({scene: %s, subtitle: %s, measures}, "*"); window.sent = 1; });
</script>"""


def test_scripts_in_names_do_not_run_in_a_page_of_one_file(open_, tmp_path):
    from dynappo.page import episode_page
    from dynappo.play import command

    out = tmp_path / "walk.html"
    saved = hostile(tmp_path / "policy.npz")
    command.main([str(saved), "--seconds=0.2", f"--out={out}"])
    tab = open_(out.as_uri())
    tab.until("document.readyState === 'complete' && !!document.getElementById('time')")
    assert RUNS in tab.value("document.querySelector('h1').textContent")
    time.sleep(0.5)
    assert tab.value("window.ran") is None
    # whoever has the page in a frame may send another recording, which is no HTML either
    policy, _ = policy_source.load(str(saved))
    player, _ = policy_source.player(policy)
    act = policy_file.actor(policy.params, policy.activation)
    data = episode_page.scene(player, episode.play(player, act, episode.tour(0.2), 0.2))
    row = f"<tr><td>{RUNS}</td></tr>"
    measures = json.dumps([[[RUNS, RUNS]], row])
    sends = SENDS % (measures, json.dumps(data), json.dumps(RUNS))
    with site(index=sends, page=out.read_text()) as port:
        tab = open_(f"http://127.0.0.1:{port}/")
        tab.until("window.sent")
        shown = "document.getElementById('it').contentDocument.querySelector('#%s').textContent"
        tab.until(f"{shown % 'subtitle'}.includes('<img')")
        tab.until(f"{shown % 'measures'}.includes('<img')", "the measures, as they are")
        time.sleep(1)
        assert tab.value("window.ran") is None

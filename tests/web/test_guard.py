"""Who is let in to the page, over sockets, and what of all that a client may send is taken."""

import contextlib
import gzip
import math
import os
import socket
import time
import urllib.request

import numpy as np
import pytest
from answers import PATIENCE, refused, until
from ml_collections import config_dict
from toy_policy import actor, described, save

from dynappo.policy import policy_file
from dynappo.web import address, policies
from dynappo.web import live as live_lib

server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")

import msgspec  # noqa: E402  (viser brings both)
from live_page import CAMERA, DRAG, PROTOCOL, joined, serving, update  # noqa: E402
from websockets import exceptions  # noqa: E402
from websockets.datastructures import Headers  # noqa: E402

from dynappo.web import guard  # noqa: E402

FOREIGN = "http://evil.example"


@pytest.fixture(scope="module")
def served():
    with serving() as it:
        yield it


def asked(port, *lines, path="/", to="127.0.0.1"):
    """The head of the answer to a request with these header lines, and the first bytes after it."""
    with socket.create_connection((to, port), timeout=PATIENCE) as line:
        head = f"GET {path} HTTP/1.1\r\n" + "".join(f"{text}\r\n" for text in lines) + "\r\n"
        line.sendall(head.encode())
        answer = b""
        while b"\r\n\r\n" not in answer or len(answer) < 400:
            if not (more := line.recv(4096)):
                break
            answer += more
    return answer.decode(errors="replace")


def status(*args, **kwargs):
    return int(asked(*args, **kwargs).split()[1])


# ---- who is let in


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["Host: 127.0.0.1:{port}"], 200),
        (["Host: localhost:{port}"], 200),
        (["Host: LOCALHOST"], 200),
        (["Host: [::1]:9000"], 200),  # through a tunnel that has another port
        (["Host: evil.example:{port}"], 403),
        (["Host: 127.0.0.1.evil.example:{port}"], 403),
        (["Host: 192.0.2.1:{port}"], 403),
        (["Host: localhost@evil.example"], 403),
        (["Host: "], 403),
        ([], 403),
        (["Host: localhost", "Host: evil.example"], 403),
        (["Host: localhost:{port}", "Origin: http://localhost:{port}"], 200),
        (["Host: localhost:{port}", "Origin: http://localhost:1"], 403),
        (["Host: localhost:{port}", "Origin: http://127.0.0.1:{port}"], 403),
        (["Host: localhost:{port}", "Origin: null"], 403),
        (["Host: localhost:{port}", f"Origin: {FOREIGN}"], 403),
        (["Host: localhost:{port}", "Origin: chrome-extension://localhost:{port}"], 403),
        (["Host: localhost:{port}", "Origin: http://localhost:{port}", f"Origin: {FOREIGN}"], 403),
    ],
)
def test_a_request_needs_a_host_of_the_server_and_the_pages_own_origin(served, lines, expected):
    assert status(served.port, *(line.format(port=served.port) for line in lines)) == expected


def test_the_page_may_not_be_told_to_use_another_server(served):
    """viser's page takes `?websocket=`; the answer's policy forbids every other server once more."""
    here = f"Host: localhost:{served.port}"
    for path in ("/?websocket=wss://evil.example", "/index.html?a", "/?%77ebsocket=ws://evil"):
        assert status(served.port, here, path=path) == 403
    answer = asked(served.port, here)
    assert f"connect-src 'self' ws://localhost:{served.port} " in answer
    assert "frame-ancestors 'self' " in answer


def test_a_foreign_host_gets_no_websocket(served):
    """DNS rebinding: the connection comes here, under another name; so does its Origin."""
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"
    up = "Upgrade: websocket", "Connection: Upgrade", f"Sec-WebSocket-Protocol: {PROTOCOL}"
    for host, expected in (("evil.example", 403), ("localhost", 101)):
        named = f"Host: {host}:{served.port}", f"Origin: http://{host}:{served.port}"
        assert status(served.port, *named, *up, *key) == expected


@pytest.mark.parametrize(("origin", "value"), [("http://127.0.0.1:{}", 0.3), (None, 0.2)])
def test_the_page_itself_and_who_is_no_browser_are_let_in(served, origin, value):
    with joined(served, origin=origin and origin.format(served.port)) as it:
        it.send(update(served.page.panels.sliders[0], value))
        until(lambda: served.page.live.command[0] == pytest.approx(value))
        live_lib.wish(served.page.live, live_lib.steer, np.zeros(3))
        until(lambda: served.page.panels.sliders[0].value == 0)


def test_each_kind_of_refusal_is_said_once(capfd):
    with serving() as served:
        for _ in range(3):
            asked(served.port, f"Host: localhost:{served.port}", f"Origin: {FOREIGN}")
            asked(served.port, "Host: evil.example")
            asked(served.port, "Host: \x1b[31m" + 999 * "e")
            with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE) as line:
                line.sendall(b"no HTTP at all\r\n\r\n")
                line.recv(100)
    said = capfd.readouterr().err
    assert said.count("\n") == 2 and max(map(len, said.splitlines())) < 250 and "\x1b" not in said
    assert said.count("dynappo: refused: ") == 2 and "'evil.example'" in said and FOREIGN in said


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_server_that_listens_everywhere_has_all_its_addresses_and_no_foreign_name(host):
    """Names can be made to lead here; numbers cannot."""
    to = "::1" if ":" in host else "127.0.0.1"
    with serving(host) as served:
        for name in ("192.0.2.7:80", "[2001:db8::7]", socket.gethostname(), "localhost"):
            assert status(served.port, f"Host: {name}", to=to) == 200
        for name in ("evil.example", "1.evil.example", "[evil]", "192.0.2.7.", "::1"):
            assert status(served.port, f"Host: {name}", to=to) == 403


def test_the_name_that_was_given_is_a_name_of_the_server():
    it = guard.for_address("Robot.lab", {"192.0.2.7"})
    for host, kind in (("robot.lab:8080", ""), ("192.0.2.7", ""), ("robot.lab.evil", "host")):
        assert guard.refusal(it, Headers({"Host": host}))[0] == kind


def test_where_the_guard_cannot_be_put_in_nothing_is_served(monkeypatch):
    monkeypatch.setattr(guard, "watching", lambda _: contextlib.nullcontext())
    line = refused(server.start, address.Address("127.0.0.1", 8510))
    assert "dynappo cannot protect" in line
    with pytest.raises(OSError), socket.create_connection(("127.0.0.1", 8510), timeout=2):
        pass


# ---- the port


def test_the_last_port_may_be_taken():
    """There is none above it. The next free one is taken elsewhere."""
    with socket.socket() as last, socket.socket() as other:
        with contextlib.suppress(OSError):  # another process may hold it: as good
            last.bind(("127.0.0.1", 65535))
            last.listen()
        line = refused(server.start, address.Address("127.0.0.1", 65535))
        assert "every port from there on is taken" in line
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        if taken < 65000:
            it, port = server.start(address.Address("127.0.0.1", taken), "a <robot>")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}") as plain:
                page = plain.read()
            asked = {"Accept-Encoding": "gzip"}
            asked = urllib.request.Request(f"http://127.0.0.1:{port}", headers=asked)
            with urllib.request.urlopen(asked) as packed:
                assert gzip.decompress(packed.read()) == page
            it.stop()
            assert taken < port < taken + 50
            assert b"<title>a &lt;robot&gt;</title>" in page and page.count(b"<title>") == 1


# ---- what is taken


@pytest.fixture(scope="module")
def stranger(served):
    """A client that counts, and whose every message the server has read when `send` returns."""
    panels, live = served.page.panels, served.page.live
    with joined(served) as it:

        def send(message, raw=None):
            it.line.send(raw) if raw is not None else it.send(message)
            value = 0.1 if panels.sliders[2].value != pytest.approx(0.1) else 0.2
            it.send(update(panels.sliders[2], value))  # messages of a client are read in order
            until(lambda: live.command[2] == pytest.approx(value))
            live_lib.wish(live, live_lib.steer, np.zeros(3))
            until(lambda: not live.command.any() and panels.sliders[2].value == 0)

        yield send


@pytest.mark.parametrize(
    "value",
    [math.nan, "nan", math.inf, -math.inf, 1e300, 99, True, None, "", [0.1], {"a": 1}, b"x"],
)
def test_a_slider_takes_numbers_within_its_ends(served, stranger, value):
    slider, live = served.page.panels.sliders[0], served.page.live
    t = live.t
    stranger(update(slider, value))
    assert slider.value == 0 and not live.paused and not live.note
    until(lambda: live.t > t + 0.1)


@pytest.mark.parametrize("name", ["nothing", "removed", "props", "update_cb", "uuid", "sync_cb"])
def test_nothing_but_a_value_is_taken(served, stranger, name):
    """viser would set any field, and pass it on to the browsers of all others."""
    box = served.page.panels.tour
    before = dict(vars(box._impl))
    stranger(update(box, "stranger", name))
    stranger({**update(box, True), "updates": {"value": True, name: "stranger"}})
    after = dict(vars(box._impl))
    assert {n: after[n] for n in after if n != "update_timestamp"} == {
        n: before[n] for n in before if n != "update_timestamp"
    }


def test_only_a_policy_of_the_list_can_be_chosen(served, stranger, tmp_path):
    """Whether there is such a file is not told either."""
    panels, live, notes = served.page.panels, served.page.live, set()
    there = save(tmp_path / "policy.npz")
    for name in (there, tmp_path, tmp_path / "none.npz", "/etc/passwd", "iteration ../.."):
        stranger(update(panels.policy, str(name)))
        time.sleep(0.2)
        notes.add(live.note)
        assert panels.policy.value == "go1" and served.page.text == "robots/go1/policy.npz"
    assert notes == {""}
    said = {refused(policies.load, served.page.offer, str(n)) for n in (there, tmp_path, "none")}
    assert said == {"no such policy in the list"}


def test_nobody_but_the_owner_can_publish_the_page(served, stranger, monkeypatch):
    """viser opens a public tunnel for whoever asks."""
    asked_for = []
    monkeypatch.setattr(served.page.server, "request_share_url", lambda: asked_for.append(1))
    stranger({"type": "ShareUrlRequest"})
    time.sleep(0.3)
    assert not asked_for


JUNK = {
    "text": "hello",
    "no message": b"\xc1",
    "nothing": b"",
    "no such type": msgspec.msgpack.encode({"type": "Nothing"}),
    "deep": b"\x91" * 5000 + b"\xc0",
}
# changed fields of messages that are taken otherwise
CAMERAS = (
    {"position": [math.nan, 0, 0]},
    {"position": [0, 0, 0]},  # looks at itself
    {"look_at": [1e300, 0, 0]},
    {"look_at": [1, 2]},
    {"look_at": "abc"},
    {"up_direction": [0, 0, 0]},
    {"image_height": 0},
    {"image_width": "x"},
    {"wxyz": []},
    {"fov": None},
    {"more": 1},
)
DRAGS = (
    {"end_position": [math.nan, 0, 0]},
    {"end_position": [1e300, 0, 0]},
    {"end_position": [1, 2]},
    {"end_position": ["a", "b", "c"]},
    {"name": []},
    {"name": "x" * 9999},
)


def test_junk_changes_nothing_and_is_said_once(capfd, caplog):
    """No traceback, no lost connection, and the robot walks on."""
    with serving() as served, joined(served) as it:
        live, page = served.page.live, served.page
        camera = next(iter(page.server.get_clients().values())).camera
        until(lambda: not np.allclose(camera.position, CAMERA["position"]))  # the page's first view
        before = camera.position.copy()
        for raw in JUNK.values():
            it.line.send(raw)
        for change in CAMERAS:
            it.send(CAMERA | change)
        for change in DRAGS:
            it.send(DRAG | change)
        for uuid in ([], None, 3, "none", {"a": 1}):
            it.send({"type": "CommandTriggerMessage", "uuid": uuid})
            it.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": 1}})
        it.send({**update(page.panels.tour, 1), "updates": []})
        it.send(update(page.panels.sliders[0], 0.3))
        until(lambda: live.command[0] == pytest.approx(0.3))
        assert live.pull is None and not live.note
        np.testing.assert_array_equal(camera.position, before)
        live_lib.wish(live, lambda live: server.view(page, {n: False for n in page.panels.look}))
        t = live.t  # the camera is moved by that
        until(lambda: live.t > t + 0.2)
        it.send(DRAG)
        until(lambda: live.pull is not None)
    said = capfd.readouterr().err
    assert said.count("\n") == 1 and "a message that the page does not send" in said
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def test_a_message_without_end_ends_one_connection(served):
    with joined(served) as it, pytest.raises(exceptions.ConnectionClosed):
        for _ in range(100):
            it.line.send(os.urandom(2**20))
    with joined(served):
        pass


# ---- the loop


def test_a_step_that_takes_longer_than_its_period_leaves_time_for_wishes(monkeypatch):
    """A policy may ask for a control step of 1e-5 s, which no machine keeps."""
    found = policies.load(policies.Offer("go1", None, None, False), "go1")
    live = live_lib.Live(found.player, found.act, None)
    monkeypatch.setattr(live_lib.episode_lib, "period", lambda player: 1e-5)
    rounds, end = [], time.monotonic() + PATIENCE
    enough = lambda: len(rounds) > 3 or time.monotonic() > end  # noqa: E731
    live_lib.run(live, lambda: rounds.append(1), enough, 2)
    assert len(rounds) > 3


def test_commands_may_exclude_zero(tmp_path):
    """Sliders then begin at the end that is nearest to it."""
    frozen, robot = described()
    config = config_dict.ConfigDict(frozen)
    config.task.command_x, config.task.command_y = (0.5, 1.0), (0.0, 0.0)
    policy_file.save(tmp_path / "fast.npz", actor(), config, robot)
    with serving(what=tmp_path / "fast.npz") as served:
        until(lambda: served.page.live.t > 0.1)
        assert served.page.panels.sliders[0].value == 0.5
        np.testing.assert_allclose(served.page.live.command[:2], [0.5, 0])

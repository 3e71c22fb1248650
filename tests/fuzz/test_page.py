"""The live page under whatever browsers and others send: it goes on, and says each kind of refusal once.

Messages are those of the page with fields changed, left out or added, any msgpack, and any bytes; clients are
many, slow to read, or gone without a word. A seeded generator: `message(rng, page)`. `-m fuzz` tries 3000.
"""

import contextlib
import random
import socket
import struct
import threading
import time

import msgspec
import numpy as np
import pytest
from answers import PATIENCE, status, until

server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")

from live_page import CAMERA, DRAG, client, joined, serving, update  # noqa: E402
from websockets import exceptions  # noqa: E402

from dynappo.config import ConfigError  # noqa: E402
from dynappo.play import command as play_command  # noqa: E402
from dynappo.web import address  # noqa: E402

FEW, MANY = 150, 3000
VALUES = [
    None,
    True,
    False,
    0,
    -1,
    3,
    2**31,
    2**63,
    0.5,
    -1e-300,
    1e300,
    float("nan"),
    float("inf"),
]
VALUES += ["", "a", "go1", "../x", "<b>", "\x00", "é" * 300, "x" * 5000, b"", b"\xff" * 9, [], {}]
VALUES += [[0, 0, 0], [1e300, 0, 0], ["a"] * 3, [[[[[1]]]]], {"value": 1}, list(range(100))]
KINDS = (
    "GuiUpdateMessage SceneNodeDragMessage ViewerCameraMessage CommandTriggerMessage GuiCloseModal "
)
KINDS += "ShareUrlRequest GetRenderResponseMessage FileTransferStartUpload NotificationMessage RunJavascript"


def message(rng: random.Random, page) -> bytes:
    """A message: often one of the page's own with something wrong in it, sometimes right, sometimes none."""
    handles = [*page.panels.sliders, page.panels.tour, page.panels.policy]
    kind = rng.random()
    if kind < 0.15:
        return rng.randbytes(rng.choice((0, 1, 7, 100, 5000)))
    if kind < 0.25:
        return msgspec.msgpack.encode(rng.choice(VALUES))
    whole = dict(
        rng.choice((CAMERA, DRAG, update(rng.choice(handles), rng.choice(VALUES)), {"type": "?"}))
    )
    for _ in range(rng.choice((0, 1, 1, 2, 5))):
        name = rng.choice([*whole, "more"])
        how = rng.random()
        if how < 0.3:
            whole.pop(name, None)
        elif how < 0.9:
            whole[name] = rng.choice(VALUES)
        else:
            whole["type"] = rng.choice(KINDS.split())
    text = msgspec.msgpack.encode(whole)
    if rng.random() < 0.1 and text:  # damaged on its way
        at = rng.randrange(len(text))
        text = text[:at] + rng.randbytes(rng.choice((0, 1, 4))) + text[at + 1 :]
    return text


def still_there(served) -> None:
    """The robot walks on, and a slider that somebody moves is heard."""
    live, slider = served.page.live, served.page.panels.sliders[0]
    t = live.t
    until(lambda: live.t != t and not live.paused)
    with joined(served) as it:
        for value in (0.31, 0.17):
            it.send(update(slider, value))
            until(lambda value=value: live.command[0] == pytest.approx(value))


def quiet(capfd, caplog) -> None:
    """Each kind of refusal was one line, and nothing was an error of the server's."""
    said = capfd.readouterr().err
    lines = said.splitlines()
    assert "Traceback" not in said and len({*lines}) == len(lines) <= 3, said
    errors = [record for record in caplog.records if record.levelname == "ERROR"]
    assert not [record for record in errors if record.name != "websockets.client"]  # our own


def tried(count: int, capfd, caplog) -> None:
    rng = random.Random(55)
    with serving() as served:
        first = served.page.panels.policy.value
        sent = 0
        while sent < count:
            with joined(served) as it, contextlib.suppress(exceptions.ConnectionClosed):
                for _ in range(rng.choice((1, 20, 100))):
                    it.line.send(message(rng, served.page))
                    sent += 1
        assert np.isfinite(served.page.live.command).all()
        assert served.page.panels.policy.value in served.page.panels.policy.options
        until(lambda: not served.page.live.paused or _go_on(served))
        still_there(served)
        assert first
    said = capfd.readouterr().err
    assert "Traceback" not in said and said.count("a message that the page does not send") <= 1, (
        said
    )
    assert said.count("\n") <= 3, said
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def _go_on(served) -> bool:
    """A message that is allowed may have paused the robot, as its owner may; then it goes on."""
    served.page.live.paused = False
    return True


def test_a_hundred_messages_change_nothing_that_they_may_not(capfd, caplog):
    tried(FEW, capfd, caplog)


@pytest.mark.fuzz
@pytest.mark.timeout(900)
def test_three_thousand_messages_change_nothing_that_they_may_not(capfd, caplog):
    tried(MANY, capfd, caplog)


def lost(served) -> None:
    """A viewer whose machine goes away in the middle: no closing words, and the line is reset."""
    with contextlib.suppress(exceptions.ConnectionClosed), client(served) as it:
        it.send(CAMERA)
        reset = struct.pack("ii", 1, 0)
        it.line.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
        it.line.socket.close()


def slow(served) -> socket.socket:
    """A viewer that shakes hands and then reads nothing of all that it is sent."""
    line = socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    from live_page import PROTOCOL

    head = f"GET / HTTP/1.1|Host: 127.0.0.1:{served.port}|Upgrade: websocket|Connection: Upgrade|"
    head += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==|Sec-WebSocket-Version: 13|"
    head += f"Sec-WebSocket-Protocol: {PROTOCOL}||"
    line.sendall(head.replace("|", "\r\n").encode())
    assert b"101" in line.recv(64)
    return line


def half(served) -> socket.socket:
    """Somebody who begins to ask, and never ends."""
    line = socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE)
    line.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1")
    return line


def crowd(count: int, capfd, caplog) -> None:
    with serving() as served, contextlib.ExitStack() as held:
        for i in range(count):
            for make in (slow, half):
                held.callback(make(served).close)
            lost(served)
            if i % 3 == 0:
                held.enter_context(joined(served))
        threads = [threading.Thread(target=lost, args=(served,)) for _ in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        time.sleep(0.5)  # some frames for those who do not read
        still_there(served)
    quiet(capfd, caplog)


def test_slow_and_lost_viewers_stop_nobody(capfd, caplog):
    crowd(3, capfd, caplog)


@pytest.mark.fuzz
@pytest.mark.timeout(600)
def test_a_crowd_of_slow_and_lost_viewers_stops_nobody(capfd, caplog):
    crowd(25, capfd, caplog)


def test_whatever_is_given_as_a_port_is_an_address_or_one_line(capsys):
    """Also one that is taken, and one that only root may have: status 2 or another port, and no traceback."""
    rng, ends = random.Random(3), [0, 0]
    letters = "0123456789:[].-+ abxé\x00"
    for _ in range(2000):
        text = "".join(rng.choice(letters) for _ in range(rng.choice((1, 2, 4, 6, 9))))
        try:
            host, port, _ = address.read(text)
            assert host and 1 <= port <= 65535
            ends[0] += 1
        except ConfigError as error:
            assert "\n" not in str(error)
            ends[1] += 1
    assert min(ends) > 50
    for text in ("0", "65536", "-1", "a", "1.5", "8080:", ":"):
        assert status(play_command.main, "go1", f"--serve={text}", "--seconds=0.1") == 2
        said = capsys.readouterr().err
        assert said.startswith("dynappo: --serve=") and said.count("\n") == 1

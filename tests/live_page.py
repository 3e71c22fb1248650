"""The live page as a test serves it, and a client that speaks to it as viser's page does."""

import contextlib
import threading
from types import SimpleNamespace

import msgspec
import viser
from answers import PATIENCE, until
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from dynappo.web import address, policies, server

PROTOCOL = f"viser-v{viser.__version__}"


@contextlib.contextmanager
def serving(host="127.0.0.1", port=8500, what="go1"):
    """A policy on a page: `page`, `port`."""
    offer, stop, told = policies.Offer(str(what), None, None, False), threading.Event(), []
    args = offer, address.Address(host, port), policies.load(offer, str(what))
    how = {"ready": lambda page, url: told.append((page, url)), "stop": stop}
    thread = threading.Thread(target=server.serve, args=args, kwargs=how)
    thread.start()
    try:
        page, url = until(lambda: told)[0]
        yield SimpleNamespace(page=page, url=url, port=int(url.rpartition(":")[2]))
    finally:
        stop.set()
        thread.join(PATIENCE)
        assert not thread.is_alive()


@contextlib.contextmanager
def client(served, **options):
    """A WebSocket that says what viser's page says; yields `send(message)`."""
    url = f"ws://127.0.0.1:{served.port}"
    with connect(url, subprotocols=[Subprotocol(PROTOCOL)], max_size=None, **options) as line:
        reader = threading.Thread(target=lambda: all(True for _ in line), daemon=True)
        reader.start()
        yield SimpleNamespace(
            send=lambda message: line.send(msgspec.msgpack.encode(message)), line=line
        )


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [2, 0, 1],
    "fov": 1.0,
    "near": 0.01,
    "far": 100,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
DRAG = {
    "type": "SceneNodeDragMessage",
    "phase": "start",
    "name": "/hand",
    "instance_index": None,
    "start_position": [0, 0, 0],
    "start_screen_pos": [0, 0],
    "end_position": [0.1, 0, 0],
    "end_screen_pos": [0, 0],
    "button": "left",
    "modifier": None,
}


def update(handle, value, name="value"):
    return {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": {name: value}}


@contextlib.contextmanager
def joined(served, **options):
    """A client that counts: its camera is known."""
    before = set(served.page.server.get_clients())
    with client(served, **options) as it:
        it.send(CAMERA)
        until(lambda: set(served.page.server.get_clients()) - before)
        yield it

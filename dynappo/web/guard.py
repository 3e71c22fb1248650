"""Protects the page from other web sites: which requests are answered, which messages are allowed.

viser answers any request, and believes what a browser sends. But any web site that somebody opens may connect
to a server on their machine, under the server's name or by DNS rebinding. So here, for each request:

- `Host` must be a name of this server (`names`), so that no foreign name leads here;
- `Origin`, where there is one, must be that same host: a page of another site is refused;
- the address must have no query: viser's page connects to whatever server `?websocket=` names, and
  runs the code that it sends. A Content-Security-Policy in each answer forbids it, too.

From a browser it takes only what this page can send: a camera, the value of a slider, box, button or list
within its limits, a key, a pull. viser itself would take any field of any element, files, and the request to
open a public tunnel to this server.

viser has no hook for such checks. It starts its server with `websockets.asyncio.server.serve`, which has two
(`process_request`, `create_connection`); `watching` puts the checks there. If a version of viser starts its
server in another way, `Guard.on` stays false, and nothing is served (`server.start`).
"""

from __future__ import annotations

import contextlib
import gzip
import html
import http
import ipaddress
import logging
import math
import re
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import viser
from viser import _messages as messages
from websockets.asyncio import server as websockets_server

HERE = {"localhost", "127.0.0.1", "[::1]"}
HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(:\d{1,5})?")
LONGEST = 2**16  # bytes of a message; those of the page have less than 1 KiB
FARTHEST = 1e6  # the largest number in one
TEXT = 1000  # characters of a name in one
VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}  # of a camera
LENGTHS = "fov", "near", "far", "image_height", "image_width"
# who may show the page in a frame: itself, and a notebook on this machine
FRAMES = "'self' http://localhost:* http://127.0.0.1:* vscode-webview:"
LOGGER = logging.getLogger(__name__)
LOGGER.addFilter(lambda record: record.getMessage() != "opening handshake failed")  # no HTTP at all


@dataclass
class Guard:
    """Which requests a server answers."""

    names: set[str]  # hosts, as a browser writes them
    any_number: bool  # and all that are numbers, not names: no one can turn those elsewhere
    gui: viser.GuiApi | None = None  # what the page consists of, once it is there
    title: str = "dynappo"  # of the browser's tab, which viser calls Viser
    on: bool = False  # whether the server asks this guard
    told: set[str] = field(default_factory=set)


def for_address(host: str, found: set[str]) -> Guard:
    """The guard of a server at `host`, whose addresses are `found`.

    A server that listens everywhere has many names. It answers to its own, and to every address
    that is a number: DNS rebinding needs a name.
    """
    everywhere = any(ipaddress.ip_address(number).is_unspecified for number in found)
    own = {host, *found}
    if everywhere:
        own |= {socket.gethostname(), f"{socket.gethostname()}.local"}
    return Guard(HERE | {f"[{n}]" if ":" in n else n.lower() for n in own}, everywhere)


def refusal(guard: Guard, headers, path: str = "/") -> tuple[str, str]:
    """`(kind, what was found)` if a request must not be answered, else `("", "")`."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    host = hosts[0].lower() if len(hosts) == 1 else ""
    found = HOST.fullmatch(host)
    if not found or not (found[1] in guard.names or guard.any_number and _number(found[1])):
        return "host", ", ".join(hosts)
    scheme, _, site = ",".join(origins).lower().partition("://")
    if origins and (scheme not in ("http", "https") or site != host):
        return "origin", ", ".join(origins)
    if "?" in path:
        return "query", path
    return "", ""


def _number(name: str) -> bool:
    try:
        return bool(ipaddress.ip_address(name.strip("[]")))
    except ValueError:
        return False


ANSWERS = {
    "host": "the page has another address; --serve=NAME:PORT serves it under another name",
    "origin": "only the page itself may talk to this server",
    "query": "the address of the page ends with the port",
}


def tell_once(guard: Guard, kind: str, line: str) -> None:
    """Print the first refusal of each kind."""
    if kind not in guard.told:
        guard.told.add(kind)
        print(
            f"dynappo: {line}. Further refusals of this kind are not printed.",
            file=sys.stderr,
            flush=True,
        )


@contextlib.contextmanager
def watching(guard: Guard) -> Iterator[None]:
    """Have the viser server that is made inside of the `with` ask `guard`."""
    plain = websockets_server.serve

    def serve(handler, host, port, *, process_request, **options):
        def request(connection, wanted):
            kind, found = refusal(guard, wanted.headers, wanted.path)
            if kind:
                tell_once(guard, kind, f"refused: {kind} {found[:100]!r}: {ANSWERS[kind]}")
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{ANSWERS[kind]}\n")
            response = process_request(connection, wanted)
            if response is not None:
                response.headers["Content-Security-Policy"] = _policy(wanted.headers["Host"])
                _entitle(guard, response)
            return response

        def connect(*args, **given):
            connection = websockets_server.ServerConnection(*args, **given)
            receive = connection.recv

            async def recv(*_, **__):
                while not allowed(guard, said := await receive()):
                    tell_once(guard, "message", "ignored: a message that the page does not send")
                return said

            connection.recv = recv  # pyright: ignore[reportAttributeAccessIssue]
            return connection

        guard.on = True
        options |= {"create_connection": connect, "max_size": LONGEST, "logger": LOGGER}
        return plain(handler, host, port, process_request=request, **options)

    websockets_server.serve = serve
    try:
        yield
    finally:
        websockets_server.serve = plain


def _entitle(guard: Guard, response) -> None:
    """Give viser's page our title; viser has no option for it."""
    packed = response.headers.get("Content-Encoding") == "gzip"
    if not response.headers.get("Content-Type", "").startswith("text/html"):
        return
    body = gzip.decompress(response.body) if packed else response.body
    body = body.replace(
        b"<title>Viser</title>", f"<title>{html.escape(guard.title)}</title>".encode()
    )
    response.body = gzip.compress(body, 1) if packed else body
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


def _policy(host: str) -> str:
    """What a browser lets the page do: connect to this server, and to no other."""
    return f"connect-src 'self' ws://{host} wss://{host} data: blob:; frame-ancestors {FRAMES}"


def allowed(guard: Guard, said: Any) -> bool:
    """Whether a browser's message is one that this page sends, with numbers within its limits."""
    try:
        message = messages.Message.deserialize(said)
        if not _plain(list(vars(message).values())):
            return False
        if isinstance(message, messages.ViewerCameraMessage):
            return _camera(message)
        if isinstance(message, messages.GuiUpdateMessage):
            return guard.gui is not None and _fits(guard.gui, message)
        if isinstance(message, messages.SceneNodeDragMessage):
            ends = message.start_position, message.end_position
            return isinstance(message.name, str) and all(_numbers(end, 3) for end in ends)
        return isinstance(message, messages.CommandTriggerMessage) and isinstance(message.uuid, str)
    except Exception:  # whatever viser's reader makes of bytes that are no message
        return False


def _plain(value: Any, depth: int = 4) -> bool:
    """Whether all in it are short texts and finite numbers that are not huge."""
    if isinstance(value, dict):
        value = [*value, *value.values()]
    if isinstance(value, list | tuple):
        return bool(depth) and len(value) <= 20 and all(_plain(part, depth - 1) for part in value)
    if isinstance(value, int | float):
        return math.isfinite(value) and abs(value) <= FARTHEST
    return value is None or isinstance(value, str) and len(value) <= TEXT


def _numbers(value: Any, count: int) -> bool:
    """Whether a value is a list of that many numbers; `_plain` has checked that they are finite."""
    return (
        isinstance(value, list | tuple)
        and [type(n) in (int, float) for n in value] == [True] * count
    )


def _camera(message: messages.ViewerCameraMessage) -> bool:
    """Whether a camera has a direction, an up and a size, without which viser cannot move it."""
    if not all(_numbers(getattr(message, name), size) for name, size in VECTORS.items()):
        return False
    if not _numbers([getattr(message, name) for name in LENGTHS], len(LENGTHS)):
        return False
    away = math.dist(message.look_at, message.position) > 1e-9
    up = math.hypot(*message.up_direction) > 1e-9
    return away and up and message.image_height > 0 and message.image_width > 0


def _fits(gui: viser.GuiApi, message: messages.GuiUpdateMessage) -> bool:
    """Whether a user can give that element that value."""
    handle = gui._gui_input_handle_from_uuid.get(message.uuid)
    if set(message.updates) != {"value"}:
        return False
    value = message.updates["value"]
    if isinstance(handle, viser.GuiSliderHandle):
        number = type(value) in (int, float)
        return number and handle.min - 1e-6 <= value <= handle.max + 1e-6
    if isinstance(handle, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        return type(value) is bool
    if isinstance(handle, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        return isinstance(value, str) and value in handle.options
    return False

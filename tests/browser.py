"""Chromium without a screen, driven by its DevTools protocol, for the tests of pages."""

import base64
import contextlib
import io
import itertools
import json
import os
import shutil
import subprocess
import time
import urllib.request
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from answers import PATIENCE

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PROGRAM = next(filter(None, map(shutil.which, NAMES)), None)
needed = pytest.mark.skipif(
    PROGRAM is None, reason="no Chromium on this machine (Debian: apt-get install chromium)"
)
FLAGS = (
    "--headless=new --no-sandbox --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --use-gl=angle --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --remote-debugging-port=0"
).split()
WIDE, NARROW = (800, 500), (390, 700)  # pixels
SHARP = 0.5  # pixels drawn for one of the page: a CPU draws them all
# A CPU draws every frame, and takes the time from what is tested: fewer frames, without smooth edges. The
# first three come with times seconds apart, so that a page finds at once that it has no graphics card.
SELDOM = """
window.rest = 250;
let slow = 3, later = 0;
const soon = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = call => setTimeout(() => soon(now => {
  if (slow-- > 0) later += 3000;
  call(now + later);
}), window.rest);
window.cancelAnimationFrame = clearTimeout;
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return context.call(this, kind, { ...options, antialias: false });
};
"""


@dataclass
class Tab:
    """A page that is open; `errors` are the lines in its console that say so."""

    socket: Any
    numbers: Any = field(default_factory=lambda: itertools.count(1))
    errors: list[str] = field(default_factory=list)

    def call(self, method, **values):
        """A command of the DevTools protocol, and what it returns."""
        number = next(self.numbers)
        self.socket.send(json.dumps({"id": number, "method": method, "params": values}))
        while True:
            said = json.loads(self.socket.recv(timeout=PATIENCE))
            if said.get("id") == number:
                assert "error" not in said, said
                return said["result"]
            self._note(said)

    def _note(self, said):
        what, values = said.get("method"), said.get("params", {})
        if what == "Runtime.exceptionThrown":
            self.errors.append(str(values["exceptionDetails"].get("exception", values))[:500])
        elif what == "Runtime.consoleAPICalled" and values["type"] in ("error", "assert"):
            self.errors.append(str(values["args"])[:500])
        elif what == "Log.entryAdded" and values["entry"]["level"] == "error":
            self.errors.append(str(values["entry"])[:500])

    def value(self, script):
        """The value of a JavaScript expression."""
        got = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in got, got
        return got["result"].get("value")

    def until(self, script, what=""):
        """Wait until a JavaScript expression is true, and return it."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if got := self.value(script):
                return got
            time.sleep(0.1)
        raise AssertionError(f"after {PATIENCE:g} s not true: {what or script}")

    def pixels(self, path=None):
        """[H, W, 3] what is seen; also as a file, if `path` is given."""
        from PIL import Image

        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path:
            path.write_bytes(content)
        image = Image.open(io.BytesIO(content)).convert("RGB")
        return np.asarray(image.resize([round(n / SHARP) for n in image.size]))

    def mouse(self, kind, x, y, buttons=0):
        button = "left" if buttons or kind == "mouseReleased" else "none"
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button=button,
            buttons=buttons,
            clickCount=1,
        )

    def click(self, x, y):
        """Press and let go."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, 1)
        self.mouse("mouseReleased", x, y)

    @contextlib.contextmanager
    def drag(self, start, end, steps=4):
        """Hold the mouse at `start`, move it to `end`, and let go after the `with`."""
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, 1)
        for i in range(1, steps + 1):
            x, y = (a + (b - a) * i / steps for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, 1)
            time.sleep(0.03)
        yield
        self.mouse("mouseReleased", *end)

    def key(self, name, code=None, number=0):
        """Press a key and let go, as `KeyboardEvent` names it."""
        for kind in ("rawKeyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=name,
                code=code or name,
                windowsVirtualKeyCode=number,
            )

    def resize(self, size):
        """Width and height of the window; a narrow one is a phone's."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=SHARP,
            mobile=size[0] < 600,
        )

    def close(self):
        """Close the page, which otherwise goes on drawing."""
        self.call("Page.close")

    @contextlib.contextmanager
    def at_rest(self):
        """Draw next to nothing, and leave the processor to another page."""
        self.value("window.rest = 5000")
        yield
        self.value("window.rest = 250")

    def watched(self, yes):
        """Whether the page believes that a person looks at it."""
        self.call("Emulation.setFocusEmulationEnabled", enabled=yes)

    def middle(self, script):
        """Where the element that a JavaScript expression finds has its middle."""
        box = (
            f"(() => {{ const e = {script}; if (!e) return null; "
            "e.scrollIntoView({block: 'center'}); "
            "const b = e.getBoundingClientRect(); "
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        return self.until(box, script)

    def press(self, text):
        """Click the button with this text."""
        self.click(
            *self.middle(
                "[...document.querySelectorAll('button, label, [role=tab]')]"
                f".find(e => e.textContent.trim() === {json.dumps(text)})"
            )
        )


@contextlib.contextmanager
def chromium(folder, size=WIDE, *more):
    """Chromium with its profile in `folder`, and `more` flags; yields `open(url) -> Tab`."""
    from websockets.sync.client import connect

    args = [
        PROGRAM,
        *FLAGS,
        *more,
        f"--user-data-dir={folder}",
        f"--window-size={size[0]},{size[1]}",
        "about:blank",
    ]
    process = subprocess.Popen(args, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with contextlib.ExitStack() as held:
        try:
            yield lambda url: _open(held, connect, _port(folder, process), url, size)
        finally:  # asked to end, it first draws all that the tabs still want
            process.kill()
            process.wait()


def _port(folder, process):
    file, end = os.path.join(folder, "DevToolsActivePort"), time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        with contextlib.suppress(OSError, IndexError):
            with open(file) as lines:
                return int(lines.read().split()[0])
        time.sleep(0.1)
    raise AssertionError("Chromium does not start")


def _open(held, connect, port, url, size):
    request = urllib.request.Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        where = json.load(answer)["webSocketDebuggerUrl"]
    # while a test waits for something else, answers to pings are stuck behind unread lines
    # and so is the answer to a goodbye
    line = connect(where, max_size=2**26, ping_interval=None, close_timeout=0.1)
    tab = Tab(held.enter_context(line))
    for domain in ("Runtime", "Log", "Page"):
        tab.call(f"{domain}.enable")
    tab.resize(size)
    tab.watched(True)  # viser waits without
    tab.call("Page.addScriptToEvaluateOnNewDocument", source=SELDOM)
    tab.call("Page.navigate", url=url)
    return tab

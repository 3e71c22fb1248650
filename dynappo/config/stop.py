"""How a command is asked to stop: by ctrl-C, by SIGTERM, or because its terminal is closed (SIGHUP)."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import stat
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

AGAIN = 1.0  # s after which a signal is a second one: what hands a signal on may send the first one twice
PATIENCE = 1.5  # s in which an interrupted command must end, or hear that it is interrupted
LAST = 0.5  # s in which the line on its end must be found


class Stop:
    """Catches these signals while it is entered. Never entered, it asks for nothing.

    A signal interrupts. While the loop of a run trains, it is `patient` instead: the first signal asks the
    loop to save and stop, and a second one interrupts. `status` is the exit status that it means. `waits` is
    what is said at once of that first signal, since the loop may hear of it much later; "": nothing.

    Python calls a handler only between two of its own instructions, not while XLA compiles or computes in
    the main thread; and a library may catch the KeyboardInterrupt. So a thread ends the process if it is
    there `PATIENCE` after an interruption, with the line that `ended` gives. That is no worse than kill -9:
    what is saved stays whole. Where a module is imported the process ends so at once: jaxlib's own crashes
    (a segmentation fault, or an abort) if a KeyboardInterrupt is raised while it is loaded.
    """

    def __init__(self):
        self.status, self.patient, self.waits = 0, False, ""
        self.ended: Callable[[], str] = lambda: "stopped"
        self.first: float | None = None  # when the first signal came
        self.interrupted, self.over = threading.Event(), threading.Event()

    def __enter__(self):
        self.over.clear()
        self.old = {s: signal.signal(s, self._handle) for s in _signals()}
        # Python writes the signal's number there at once, wherever the main thread is
        theirs, self.ours = socket.socketpair()
        self.ours.setblocking(False)
        self.woken = signal.set_wakeup_fd(self.ours.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(theirs,), daemon=True).start()
        return self

    def __exit__(self, *_):
        self.over.set()
        signal.set_wakeup_fd(self.woken)
        self.ours.close()  # which ends the thread
        for number, handler in self.old.items():
            signal.signal(number, handler)

    def _interrupts(self) -> bool:
        """Whether a signal that comes now interrupts; the first one is noted."""
        now = time.monotonic()
        self.first = self.first or now
        return not self.patient or now - self.first > AGAIN

    def _handle(self, number, frame):
        self.status = 128 + number
        if number == getattr(signal, "SIGHUP", None):
            _print_nowhere()
        if self._interrupts():
            self.interrupted.set()
            if _imports(frame):
                _flush()
                _end(self.status, self.ended)
            raise KeyboardInterrupt(self.status)

    def _watch(self, signals: socket.socket) -> None:
        with signals:
            while numbers := signals.recv(100):
                # a patient one is given the time to finish what it saves
                done = self.interrupted if self.patient else self.over
                if not self._interrupts():
                    self._say()
                elif not done.wait(PATIENCE) and not self.over.is_set():
                    _end(128 + numbers[-1], self.ended)

    def _say(self) -> None:
        """Print `waits`, once; in a thread, for the main one may hold the locks of the streams."""
        text, self.waits = self.waits, ""

        def printed():
            with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
                print(f"dynappo: {text}", file=sys.stderr, flush=True)

        if text and not self.over.is_set():
            threading.Thread(target=printed, daemon=True).start()


def leave(status: int) -> None:
    """End the process at once: no thread that still compiles is waited for, as Python would do."""
    _flush()
    os._exit(status)


def _flush() -> None:
    """What was printed is written; not where this thread is just doing so (RuntimeError)."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, AttributeError, ValueError, RuntimeError):
            stream.flush()


def _imports(frame: FrameType | None) -> bool:
    """Whether this frame, or one that has called it, imports a module."""
    while frame is not None:
        if "importlib._bootstrap" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


def _signals() -> list[signal.Signals]:
    """Those that this system has; not a SIGHUP that `nohup` has made harmless."""
    found = [signal.SIGINT, signal.SIGTERM]
    hangup: signal.Signals | None = getattr(signal, "SIGHUP", None)
    if hangup and signal.getsignal(hangup) is not signal.SIG_IGN:
        found.append(hangup)
    return found


def _print_nowhere() -> None:
    """What is printed from now on is lost, instead of an error: the terminal is gone."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        if stat.S_ISCHR(os.fstat(number).st_mode):  # a terminal that is gone is none for isatty
            os.dup2(nowhere, number)


def _end(status: int, line: Callable[[], str]) -> None:
    """`leave` with a line, where the main thread may hold the locks of the streams, and others, for which
    `line` would wait."""
    found = ["stopped"]

    def find():
        with contextlib.suppress(Exception):
            found.append(line())

    finding = threading.Thread(target=find, daemon=True)
    finding.start()
    finding.join(LAST)
    with contextlib.suppress(OSError):
        if os.isatty(1):
            os.write(1, b"\x1b[?25h\n")  # the cursor, which a progress bar hides
        os.write(2, f"dynappo: {found[-1]}\n".encode(errors="backslashreplace"))
    os._exit(status)

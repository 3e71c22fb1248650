"""How a run is asked to stop: by ctrl-C, or by SIGTERM."""

from __future__ import annotations

import signal


class Stop:
    """Catches ctrl-C and SIGTERM while it is entered. Never entered, it asks for nothing.

    While the loop runs it is `patient`: the first signal asks the loop to save and stop, and `status` is the
    exit status that it means. Before the loop runs, after it, and at the second signal, it interrupts.
    """

    def __init__(self):
        self.status, self.patient = 0, False

    def __enter__(self):
        self.old = {s: signal.signal(s, self._handle) for s in (signal.SIGINT, signal.SIGTERM)}

    def __exit__(self, *_):
        for number, handler in self.old.items():
            signal.signal(number, handler)

    def _handle(self, number, _):
        again, self.status = self.status, 128 + number
        if again or not self.patient:
            raise KeyboardInterrupt(self.status)

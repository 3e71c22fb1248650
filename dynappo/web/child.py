"""`train --serve`: a page on the run, in a process of its own that reads what the run writes."""

from __future__ import annotations

import contextlib
import subprocess
from pathlib import Path

from dynappo.config import interpreter

PATIENCE = 5.0  # s, for the page to close


@contextlib.contextmanager
def serving(workdir: Path, serve: str | None, terms: str = ""):
    """Serve the run in `workdir` as `dynappo play WORKDIR --serve` does, until the `with` ends.

    `serve` is what the flag says; None: nothing is started. `terms` is the file of the run's terms of one's
    own. A page that fails stops no training.
    """
    if serve is None:
        yield
        return
    command = [*interpreter.command("dynappo.play"), str(workdir.resolve()), f"--serve={serve}"]
    command += [f"--terms={terms}"] * bool(terms)
    # it ends when its stdin does, so also after a SIGKILL here; ctrl-C goes to the training alone
    process = subprocess.Popen(
        [*command, "--until-eof"], stdin=subprocess.PIPE, start_new_session=True
    )
    try:
        yield
    finally:
        interpreter.end(process, PATIENCE)

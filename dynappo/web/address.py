"""The address of the page: what `--serve[=PORT]` means. Without viser, so any command may import it."""

from __future__ import annotations

import importlib.util
import re
from typing import NamedTuple

from dynappo.config import ConfigError, shell

HOST, PORT = "127.0.0.1", 8080
NEEDED = ("viser", "mjviser")


class Address(NamedTuple):
    """The address of the page."""

    host: str
    port: int


def read(text: str) -> Address:
    """The address of `--serve=TEXT`: a port, or HOST:PORT, or "" for port 8080 of this machine alone."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not text:
        port = str(PORT)
    if not re.fullmatch(r"\d{1,5}", port, re.ASCII) or not 1 <= int(port) <= 65535:
        raise ConfigError(
            f"--serve={text!r}: expected a port, 1 to 65535, or HOST:PORT, as in --serve=8080 (this machine "
            "alone) or --serve=0.0.0.0:8080 (whoever reaches this machine)"
        )
    return Address(host or HOST, int(port))


def check() -> None:
    """ConfigError if the packages that serve pages are not installed."""
    lacks = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if lacks:
        raise ConfigError(f"--serve needs {' and '.join(lacks)}: {shell.install('web')}")

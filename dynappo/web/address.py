"""The address of the page: what `--serve[=PORT]` means. Without viser, so any command may import it."""

from __future__ import annotations

import errno
import importlib.util
import os
import re
import socket
from typing import NamedTuple

from dynappo.config import ConfigError, shell

HOST, PORT = "127.0.0.1", 8080
NEEDED = ("viser", "mjviser")


class Address(NamedTuple):
    """The address of the page."""

    host: str
    port: int
    named: bool = False  # by the user: then no other port will do


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
    return Address(host or HOST, int(port), bool(text))


def check(address: Address) -> None:
    """ConfigError if the packages that serve pages are not installed, or the port cannot be had."""
    lacks = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if lacks:
        raise ConfigError(f"--serve needs {' and '.join(lacks)}: {shell.install('web')}")
    free(address)


def free(address: Address) -> tuple[set[str], int]:
    """`(numbers, port)`: the host's addresses, and the port, free there: the address's own, or the first one
    from there on if nobody has named it. ConfigError if there is none."""
    host, first, named = address
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        places = {(family, str(place[0])) for family, *_, place in found}
        for port in (first,) if named else range(first, 65536):
            if all(_binds(family, number, port) for family, number in places):
                return {number for _, number in places}, port
    except OSError as error:
        raise ConfigError(
            f"--serve={host}:{first}: this machine cannot listen there ({error.strerror}); "
            f"--serve={max(first, 1024)} listens on 127.0.0.1"
        ) from None
    if named:
        raise taken(address)
    raise ConfigError(
        f"--serve={host}:{first}: every port from there on is taken; choose a lower one"
    )


def taken(address: Address) -> ConfigError:
    """Somebody else's page must not be taken for ours."""
    return ConfigError(
        f"--serve: port {address.port} is taken, perhaps by somebody else's page; name another port, or "
        "leave it out: --serve alone takes a free one"
    )


def _binds(family: int, number: str, port: int) -> bool:
    """Whether the port is free; OSError if it cannot be used."""
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as asyncio does
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        try:
            probe.bind((number, port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            return False
    return True

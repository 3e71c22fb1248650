"""What every command shares: how its flags are read, and how it ends."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path

from dynappo import config as config_lib
from dynappo.config import ConfigError


def parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """A parser of `python -m dynappo.COMMAND`; `epilog` is printed as it stands."""
    return argparse.ArgumentParser(
        prog=f"python -m dynappo.{command}",
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        exit_on_error=False,
    )


def read_known(
    of: argparse.ArgumentParser, argv: list[str] | None
) -> tuple[argparse.Namespace, list[str]]:
    """`(flags, the rest)` of `argv`, or of the command line; ConfigError if one cannot be understood."""
    try:
        return of.parse_known_args(argv)
    except argparse.ArgumentError as error:
        hint = "; write it as --flag=VALUE" if "expected one argument" in str(error) else ""
        raise ConfigError(str(error).removeprefix("argument ") + hint) from None


def read(of: argparse.ArgumentParser, argv: list[str] | None) -> argparse.Namespace:
    """The flags; ConfigError also where there are others."""
    flags, rest = read_known(of, argv)
    if rest:
        raise ConfigError(f"{rest[0]}: no such flag; {of.prog} --help lists them")
    return flags


def load(spec: str | None, rest: list[str]):
    """The config `--config=SPEC` with every `--config.GROUP.FIELD=VALUE` of `rest`; not validated."""
    if not spec:
        raise ConfigError("--config is missing; try --config=configs/go1.py:quick")
    config = config_lib.load(spec)
    more = iter(rest)
    for flag in more:
        if not flag.startswith("--config."):
            raise ConfigError(f"{flag}: no such flag; expected --config.GROUP.FIELD=VALUE")
        field, equals, text = flag.removeprefix("--config.").partition("=")
        config_lib.override(config, field, text if equals else next(more, ""))
    return config


def check_writable(out: Path) -> None:
    """ConfigError if no file can be written at `out`; leaves none behind."""
    try:
        fresh = not out.exists()  # raises where the name is too long
        out.open("ab").close()
    except OSError as error:
        raise ConfigError(f"--out={out}: cannot write there ({error.strerror})") from None
    if fresh:
        out.unlink()


def start(command: str) -> None:
    """Run `dynappo.COMMAND`, whatever MUJOCO_GL is.

    MuJoCo reads it when it is imported, and fails where it names what is not there. No command draws
    in its own process: films are made in another (policy/render.py), the viewer has its own window.
    """
    os.environ["MUJOCO_GL"] = "disable"
    importlib.import_module(f"dynappo.{command}.command").main()


def answer(action: Callable[[], None], stopped: str = "stopped") -> None:
    """Do `action`; what ends it is one line and an exit status.

    2: it cannot be done as asked; 1: numbers blew up, or a file cannot be written; 130 where it is
    interrupted, with the line `stopped`. What a stream cannot show (names in ASCII) it shows as `\\xe4`.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # not what a notebook or a test has put there
            stream.reconfigure(errors="backslashreplace")
    try:
        return action()
    except ConfigError as error:
        line, code = str(error), 2
    except FloatingPointError as error:
        line, code = str(error), 1
    except OSError as error:
        full = f"{error.filename or 'a file'} cannot be written ({error.strerror})"
        line, code = full if error.strerror else str(error), 1  # without: a library, not a file
    except KeyboardInterrupt:
        line, code = stopped, 130
    shown = "".join(
        c if c.isprintable() else ascii(c)[1:-1] for c in line
    )  # names may hold anything
    print(f"dynappo: {shown}", file=sys.stderr)
    sys.exit(code)

"""Shell commands in messages, written so that they work when pasted.

The reader may be in another folder, without an activated environment, or with a wheel instead of a clone.
"""

import os
import re
import shlex
import shutil
import string
import sys
from importlib import metadata
from pathlib import Path

from dynappo.config import files, versions


def command_line() -> str:
    """What starts dynappo here: `dynappo` if the shell finds that of this Python, or its path if it was
    started so, else its full call."""
    found, home = shutil.which("dynappo"), Path(sys.executable).parent.resolve()
    if found and Path(found).parent.resolve() == home:  # also by a link, such as a .venv
        return "dynappo"
    started = Path(sys.argv[0] if sys.argv else "")
    if started.stem == "dynappo" and started.is_file() and started.parent.resolve() == home:
        short = relative(str(started.absolute()))
        return quoted(str(started.absolute()) if short.startswith("..") else short)
    return f"{_python()} -m dynappo"


def line(command: str, *words) -> str:
    """`dynappo COMMAND WORDS` as it can be typed here, whatever is in the words."""
    return " ".join([command_line(), command, *(quoted(str(word)) for word in words)])


def pasted(text: str) -> str:
    """`text` with every `python -m dynappo.COMMAND` as it can be typed here, and every file of configs/ and
    robots/ by its full path where that is in a wheel."""
    text = re.sub(r"python -m dynappo\.(\w+)", lambda m: f"{command_line()} {m[1]}", text)
    return re.sub(r"(?<![\w./\\=-])(configs|robots)/[\w./]*\w", lambda m: _located(m[0]), text)


def _located(name: str) -> str:
    """A file of configs/ or robots/ as it can be opened: in a clone it is in sight."""
    ours = files.PACKAGE / name
    return str(ours) if ours.is_file() and not os.path.exists(name) else name


def install(extra: str) -> str:
    """What installs `dynappo[EXTRA]` into this Python: from the clone, else the extra's own packages.

    Not every index has dynappo itself.
    """
    pip = f"{_python()} -m pip install"
    if (versions.ROOT / "constraints.txt").exists():
        root, short = str(versions.ROOT), relative(str(versions.ROOT))
        root = short if len(short) < len(root) else root
        pinned = quoted(os.path.join(root, "constraints.txt"))
        return f"{pip} -c {pinned} -e {quoted(f'{root}[{extra}]')}"
    try:
        requirements = metadata.requires("dynappo") or []
    except metadata.PackageNotFoundError:
        requirements = []
    of = [
        re.split(r"\s*;", text)[0]
        for text in requirements
        if re.search(rf"extra == .{extra}\b", text)
    ]
    return f"{pip} {' '.join(map(quoted, of or [f'dynappo[{extra}]']))}"


def quoted(word: str) -> str:
    """A word as the shell here reads it: Windows has no single quotes, and a path there needs none."""
    if sys.platform != "win32":
        return shlex.quote(word)
    return f'"{word}"' if set(word) - _PLAIN else word


_PLAIN = set(string.ascii_letters + string.digits + "._-:=\\/")


def relative(path: str) -> str:
    """From the working directory; as it is where it lies on another drive."""
    try:
        return os.path.relpath(path)
    except ValueError:
        return path


def _python() -> str:
    """This Python, by the shortest path."""
    short = relative(sys.executable)
    return quoted(sys.executable if short.startswith("..") else short)

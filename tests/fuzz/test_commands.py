"""Whatever is asked of a command: one line and status 2, or it goes on to where it would compile.

Each input (inputs.py) is given to the command's `main` in this process. It must end in seconds, without a
traceback, and must have changed no file where it is refused. `-m fuzz` tries 2000 of them.
"""

import collections
import contextlib
import importlib
import io
import os
import shutil
import signal
import socket
import time
import traceback
from pathlib import Path

import inputs
import jax
import pytest
import workdirs

from dynappo import config as config_lib
from dynappo.adopt import command as adopt_command
from dynappo.config import flags
from dynappo.evaluate import episodes, trials
from dynappo.export import command as export_command
from dynappo.export import onnx_file
from dynappo.play import viewer
from dynappo.policy import episode
from dynappo.program import build, devices, memory

LIMIT = 5.0  # s of the processor for an input; the slowest takes a tenth of it
FEW, MANY = 100, 2000
FIRST = int(os.environ.get("FUZZ_FIRST", "0"))  # the number of the first input, for more than these


class Accepted(BaseException):
    """Here something would be compiled, simulated or written."""


class Hung(BaseException):
    """The time is up."""


@pytest.fixture
def nothing_is_compiled(monkeypatch):
    """What takes time, and what would reach beyond this process, says that it was reached."""

    def reached(*_, **__):
        raise Accepted

    def address(host, *_):
        if host != "localhost":
            raise socket.gaierror(-2, "Name or service not known")

    for module, name in (
        (build, "program"),
        (trials, "run"),
        (episodes, "run"),
        (episode, "play"),
        (viewer, "watch"),
        (onnx_file, "save"),
        (export_command, "save_robot"),
        (adopt_command, "check"),
        (jax.distributed, "initialize"),
    ):
        monkeypatch.setattr(module, name, reached)
    monkeypatch.setattr(devices, "own_process", lambda *_: None)
    monkeypatch.setattr(memory, "limit", lambda device: 8 * 2**30)
    monkeypatch.setattr(socket, "getaddrinfo", address)


def furnish(folder: Path) -> None:
    """A working directory with a file, somebody's folder, a run and one that has just begun."""
    folder.mkdir(parents=True)
    (folder / "taken").write_text("mine")
    (folder / "thesis").mkdir()
    (folder / "thesis" / "thesis.txt").write_text("years")
    (folder / "young" / "checkpoints").mkdir(parents=True)
    config = config_lib.validate(config_lib.load("configs/go1.py:dyna4"))
    (folder / "old").mkdir()
    (folder / "old" / "config.json").write_text(config_lib.to_json(config))
    (folder / "old" / "metrics.csv").write_text("iteration\n1\n")


@contextlib.contextmanager
def limited(seconds: float):
    """Raises Hung in the `with` when so much time of the processor is used, however busy the machine is."""

    def ring(*_):
        raise Hung

    handler = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, handler)


def end(case: inputs.Input) -> tuple[str, str]:
    """`(refused, accepted, hung or wrong; what was said)` of a command with these arguments."""
    main = importlib.import_module(f"dynappo.{case.command}.command").main
    out, err = io.StringIO(), io.StringIO()
    try:
        with limited(LIMIT), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main(case.argv)
        return "wrong", f"it ended well: {out.getvalue()[-200:]}"
    except Accepted:
        return "accepted", ""
    except Hung:
        return "hung", traceback.format_exc()
    except SystemExit as stop:
        line = err.getvalue()
        right = stop.code == 2 and line.startswith("dynappo: ") and line.count("\n") == 1
        right = right and len(line) < flags.LINE + 20
        return ("refused" if right else "wrong"), f"status {stop.code}: {line[-2000:]}"
    except BaseException:
        return "wrong", traceback.format_exc()


def tried(numbers, folder: Path, monkeypatch):
    """`({(command, end): how many}, [what is wrong])` of some inputs."""
    home, counts, wrong = folder / "a" / "b", collections.Counter(), []
    furnish(home)
    fresh = workdirs.everything(folder)
    for number in numbers:
        case = inputs.draw(number)
        monkeypatch.chdir(home)
        for name, data in case.files.items():
            (home / name).write_bytes(data)
        before = workdirs.everything(folder)
        how, said = end(case)
        after = workdirs.everything(folder)
        changed = {p for p in before.keys() | after.keys() if before.get(p, 0) != after.get(p, 0)}
        if how == "refused" and {p for p in changed if p.name != "lock"}:
            how, said = "wrong", f"refused, but written: {changed}; {said}"
        counts[case.command, how] += 1
        if how in ("hung", "wrong"):
            text = f"input {number}, {case.command} {case.argv} {case.files}"
            wrong.append(f"{text[:600]}\n... {said[-600:]}")
        if after != fresh:
            monkeypatch.chdir(folder.parent)
            shutil.rmtree(folder)
            furnish(home)
            fresh = workdirs.everything(folder)
    return counts, wrong


def table(counts) -> str:
    """How the inputs ended, by command."""
    ends = ("tried", "refused", "accepted", "hung", "wrong")
    lines = ["".join(f"{text:>10}" for text in ("", *ends))]
    for command in (*inputs.COMMANDS, "all"):
        row = [n for n in counts.items() if command in (n[0][0], "all")]
        cells = [sum(n for (_, how), n in row if how == name or name == "tried") for name in ends]
        lines.append("".join(f"{cell:>10}" for cell in (command, *cells)))
    return "\n".join(lines)


def check(count, tmp_path, monkeypatch, capsys):
    counts, wrong = tried(range(FIRST, FIRST + count), tmp_path / "home", monkeypatch)
    with capsys.disabled():
        print(f"\n{table(counts)}")
    assert not wrong, f"{len(wrong)} inputs:\n" + "\n\n".join(wrong[:10])
    for command in inputs.COMMANDS:  # the generator reaches both ends
        assert counts[command, "refused"] and counts[command, "accepted"]


def test_a_hundred_bad_inputs_are_one_line_each(nothing_is_compiled, tmp_path, monkeypatch, capsys):
    check(FEW, tmp_path, monkeypatch, capsys)


@pytest.mark.fuzz
@pytest.mark.timeout(1200)
def test_two_thousand_bad_inputs_are_one_line_each(
    nothing_is_compiled, tmp_path, monkeypatch, capsys
):
    began = time.monotonic()
    check(MANY, tmp_path, monkeypatch, capsys)
    assert time.monotonic() - began < 600

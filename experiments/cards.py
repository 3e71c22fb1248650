"""A plan of runs on the GPUs of one host: lanes side by side, the commands of a lane one after the other.

    python experiments/cards.py OUT_FOLDER experiments/next.txt a b [--seconds 560]

A line of the plan is `PART LANE SECONDS COMMAND ...`; those of the named parts run. A lane is a card's
number and a letter: 0a and 0b share card 0, and so do their cores, the host's divided by its cards. They
share its memory, too: each takes what it needs, where a lane alone takes most of it at once. Runs whose
seconds count have a card's only lane. `OUT` in a command is OUT_FOLDER. A command is ended after its
SECONDS, or when `--seconds` of all are over, with all that it started: a run that was cut off keeps the rows
that it has. OUT_FOLDER/LANE.log has what a lane's commands said, and OUT_FOLDER.tar.xz all of the folder,
written every minute and at the end. Ended by SIGTERM, it ends its commands, and writes that first.

A lane whose card nvidia-smi does not list is refused before anything runs, and JAX may not fall back to a
CPU then. Where there is no nvidia-smi, cards are not counted.
"""

import argparse
import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
import tarfile
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple

GRACE = 5.0  # s, for an ended command to write what it has
EVERY = 60.0  # s between two packed copies of the folder
LOOK = 0.2  # s between two looks whether a command shall end


class Line(NamedTuple):
    """A command of a plan."""

    part: str
    lane: str
    seconds: float
    command: str

    @property
    def card(self) -> int:
        return int(self.lane.rstrip("abcdefghijklmnopqrstuvwxyz"))


class Call(NamedTuple):
    """What all lanes share."""

    out: Path
    end: float  # of time.monotonic
    cards: int  # among which the cores are divided
    counted: bool  # by nvidia-smi
    stop: threading.Event  # set: the commands that run end, and none begins


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("plan", type=Path)
    parser.add_argument("parts", nargs="+")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of all")
    args = parser.parse_args()
    args.out = args.out.resolve()  # a command may run elsewhere
    every = list(read(args.plan))
    if missing := [part for part in args.parts if part not in {line.part for line in every}]:
        raise SystemExit(f"{args.plan} has no part {missing[0]!r}")
    lines = [line for line in every if line.part in args.parts]
    cards = max(line.card for line in lines) + 1
    known, stop, ended = counted(lines), threading.Event(), []
    args.out.mkdir(parents=True, exist_ok=True)
    call = Call(args.out, time.monotonic() + args.seconds, cards, known, stop)
    lanes = list(dict.fromkeys(line.lane for line in lines))
    each = [[line for line in lines if line.lane == lane] for lane in lanes]
    before = {
        number: signal.signal(number, lambda number, _: (ended.append(number), stop.set()))
        for number in (signal.SIGTERM, signal.SIGINT)
    }
    try:
        with ThreadPoolExecutor(len(lanes)) as pool:
            running = [pool.submit(run_lane, call, mine, shared(lines, mine)) for mine in each]
            while wait(running, EVERY).not_done:  # what is there counts if this process is killed
                packed(args.out)
        for lane in running:
            lane.result()  # what a lane raised
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        packed(args.out)
    if ended:
        raise SystemExit(128 + ended[0])


def read(plan: Path) -> Iterable[Line]:
    """The lines of a plan; empty ones and those that begin with # are left out."""
    for k, text in enumerate(plan.read_text().splitlines(), 1):
        if not text.strip() or text.startswith("#"):
            continue
        try:
            part, lane, seconds, command = text.split(maxsplit=3)
            line = Line(part, lane, float(seconds), command)
            line.card, shlex.split(command)  # noqa: B018, a number, and quotes that end
        except ValueError:
            raise SystemExit(
                f"{plan}:{k} is {text!r}, expected PART LANE SECONDS COMMAND, as `a 0a 300 ...`"
            ) from None
        yield line


def counted(lines: list[Line]) -> bool:
    """Whether nvidia-smi has counted the cards; SystemExit if a line names one that is not there."""
    try:
        listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True).stdout
    except OSError:  # a machine without NVIDIA's driver
        print("no nvidia-smi: cards are not counted, and JAX may compute on a CPU", flush=True)
        return False
    there = len(re.findall(r"^GPU \d", listed, re.MULTILINE))
    for line in lines:
        if not 0 <= line.card < there:
            raise SystemExit(
                f"lane {line.lane} is of card {line.card}, but nvidia-smi lists {there}"
            )
    return True


def packed(out: Path) -> None:
    """`pack`, and a line where the disk is full: the commands go on."""
    try:
        pack(out)
    except OSError as error:
        print(f"{out}.tar.xz is not written: {error}", flush=True)


def pack(out: Path) -> None:
    """OUT_FOLDER.tar.xz, whole or not at all; commands may write into the folder meanwhile. Policies (.npz)
    are left out: half a megabyte each, they would be too much to send every minute."""
    whole = Path(f"{out}.tar.xz.new")
    with tarfile.open(whole, "w:xz", preset=3) as tar:
        for path in [out, *sorted(path for path in out.rglob("*") if path.suffix != ".npz")]:
            with contextlib.suppress(FileNotFoundError):  # it was renamed since it was listed
                info = tar.gettarinfo(path, str(path.relative_to(out.parent)))
                data = path.read_bytes() if info.isreg() else b""
                info.size = len(data)  # it may have grown
                tar.addfile(info, io.BytesIO(data))
    whole.replace(f"{out}.tar.xz")


def shared(lines: list[Line], mine: list[Line]) -> bool:
    """Whether the card of a lane has other lanes, too."""
    return len({line.lane for line in lines if line.card == mine[0].card}) > 1


def run_lane(call: Call, lines: list[Line], shares: bool) -> None:
    """Run the commands of a lane, each until it is done, its seconds are over, or it is the call's end."""
    with (call.out / f"{lines[0].lane}.log").open("a") as log:
        for line in lines:
            left = min(line.seconds, call.end - time.monotonic())
            if left <= 0 or call.stop.is_set():
                tell(log, line, f"has not run: {'no time is left' if left <= 0 else 'all end'}")
                continue
            began = time.monotonic()
            try:
                code = run(call, line, log, left, shares)
            except OSError as error:  # no such program; the lane's other commands run
                tell(log, line, f"has not run: {error}")
                continue
            took = f"{time.monotonic() - began:.0f} s"
            tell(log, line, f"ended after {took}" if code is None else f"{took}, status {code}")


def run(call: Call, line: Line, log, seconds: float, shares: bool) -> int | None:
    """The command's exit status; None if it was ended."""
    env = os.environ | {"CUDA_VISIBLE_DEVICES": str(line.card)}
    if shares:  # else the first of JAX takes three quarters of the card, and the others end
        env["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    if call.counted:  # so JAX ends without its card; callbacks and Playground's models need the CPU
        env["JAX_PLATFORMS"] = "cuda,cpu"
    process = subprocess.Popen(
        shlex.split(re.sub(r"\bOUT\b", str(call.out), line.command)),
        stdout=log,
        stderr=subprocess.STDOUT,
        env=env,
        start_new_session=True,  # so that what it starts ends with it
    )
    with contextlib.suppress(OSError):  # it is over
        os.sched_setaffinity(process.pid, cores(line.card, call.cards))
    end = time.monotonic() + seconds
    while not call.stop.is_set() and time.monotonic() < end:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(max(0.0, min(LOOK, end - time.monotonic())))
    os.killpg(process.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(GRACE)
    with contextlib.suppress(ProcessLookupError):  # what it started, too
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return None


def cores(card: int, cards: int) -> list[int]:
    """A card's share of the cores that this process may use; all of them where there are fewer than cards."""
    every = sorted(os.sched_getaffinity(0))
    each = len(every) // cards
    return every[card * each : (card + 1) * each] or every


def tell(log, line: Line, what: str) -> None:
    text = f"[{line.lane}] {line.command}: {what}"
    print(text, flush=True)
    print(text, file=log, flush=True)


if __name__ == "__main__":
    sys.exit(main())

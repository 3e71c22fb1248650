"""A plan of runs on the GPUs of one host: lanes side by side, the commands of a lane one after the other.

    python experiments/cards.py OUT_FOLDER experiments/next.txt a b [--seconds 560]

A line of the plan is `PART LANE SECONDS COMMAND ...`; those of the named parts run. A lane is a card's
number and a letter: 0a and 0b share card 0, and so do their cores, the host's divided by its cards. They
share its memory, too: each takes what it needs, where a lane alone takes most of it at once. Runs whose
seconds count have a card's only lane. `OUT` in a command is OUT_FOLDER. A command is ended after its
SECONDS, or when `--seconds` of all are over, with all that it started: a run that was cut off keeps the rows
that it has. OUT_FOLDER/LANE.log has what a lane's commands said, and OUT_FOLDER.tar.xz all of the folder.
"""

import argparse
import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

GRACE = 5.0  # s, for an ended command to write what it has


class Line(NamedTuple):
    """A command of a plan."""

    part: str
    lane: str
    seconds: float
    command: str

    @property
    def card(self) -> int:
        return int(self.lane.rstrip("abcdefghijklmnopqrstuvwxyz"))


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
    args.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + args.seconds
    lanes = list(dict.fromkeys(line.lane for line in lines))
    cards = max(line.card for line in lines) + 1
    with ThreadPoolExecutor(len(lanes)) as pool:
        each = [[line for line in lines if line.lane == lane] for lane in lanes]
        # what a lane raises comes out when all have ended
        list(pool.map(lambda mine: run_lane(args.out, mine, end, cards, shared(lines, mine)), each))
    with tarfile.open(f"{args.out}.tar.xz", "w:xz", preset=3) as tar:
        tar.add(args.out, args.out.name)


def read(plan: Path) -> Iterable[Line]:
    """The lines of a plan; empty ones and those that begin with # are left out."""
    for k, text in enumerate(plan.read_text().splitlines(), 1):
        if not text.strip() or text.startswith("#"):
            continue
        try:
            part, lane, seconds, command = text.split(maxsplit=3)
            line = Line(part, lane, float(seconds), command)
            line.card  # noqa: B018, a number
        except ValueError:
            raise SystemExit(
                f"{plan}:{k} is {text!r}, expected PART LANE SECONDS COMMAND, as `a 0a 300 ...`"
            ) from None
        yield line


def shared(lines: list[Line], mine: list[Line]) -> bool:
    """Whether the card of a lane has other lanes, too."""
    return len({line.lane for line in lines if line.card == mine[0].card}) > 1


def run_lane(out: Path, lines: list[Line], end: float, cards: int, shares: bool) -> None:
    """Run the commands of a lane, each until it is done, its seconds are over, or it is `end`."""
    with (out / f"{lines[0].lane}.log").open("a") as log:
        for line in lines:
            left = min(line.seconds, end - time.monotonic())
            if left <= 0:
                tell(log, line, "has not run: no time is left")
                continue
            began = time.monotonic()
            code = run(line, out, log, left, cards, shares)
            took = f"{time.monotonic() - began:.0f} s"
            tell(log, line, f"ended after {took}" if code is None else f"{took}, status {code}")


def run(line: Line, out: Path, log, seconds: float, cards: int, shares: bool) -> int | None:
    """The command's exit status; None if it was ended."""
    env = os.environ | {"CUDA_VISIBLE_DEVICES": str(line.card)}
    if shares:  # else the first of JAX takes three quarters of the card, and the others end
        env["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    process = subprocess.Popen(
        shlex.split(re.sub(r"\bOUT\b", str(out), line.command)),
        stdout=log,
        stderr=subprocess.STDOUT,
        env=env,
        start_new_session=True,  # so that what it starts ends with it
    )
    with contextlib.suppress(ProcessLookupError):  # it is over
        os.sched_setaffinity(process.pid, cores(line.card, cards))
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
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

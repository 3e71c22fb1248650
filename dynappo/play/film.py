"""The films and pictures that `play` writes: their size and progress."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from dynappo.config import ConfigError
from dynappo.policy import render
from dynappo.policy.episode import Player

SMALLEST, WIDEST = 64, 3840  # pixels a side


def size(text: str, out: Path | None) -> tuple[int, int]:
    """Width and height of `--size=TEXT`; ConfigError if no film can have them, or `out` is none."""
    found = re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", text, re.ASCII)
    width, height = map(int, found.groups()) if found else (0, 0)
    if (
        width % 2
        or height % 2
        or not (SMALLEST <= width <= WIDEST and SMALLEST <= height <= WIDEST)
    ):
        raise ConfigError(
            f"--size={text!r}: expected WIDTHxHEIGHT, even numbers from {SMALLEST} to {WIDEST}, as in "
            "--size=1280x720"
        )
    if out is None or out.suffix not in (".mp4", ".gif", ".png"):
        raise ConfigError(f"--size={text}: is for films and pictures: --out=FILE.mp4, .gif or .png")
    return width, height


def write(
    player: Player | render.Shown, episode: dict, out: Path, pixels: tuple[int, int] | None = None
) -> str:
    """`render.film`, with its progress on a terminal; 12 s of film take half a minute on two cores."""

    def tell(share):
        doing = ", encoding" if share >= 1 else ""
        print(f"\r{f'rendering: {share:4.0%}{doing}':26}", end="", file=sys.stderr, flush=True)

    if not sys.stderr.isatty():
        if out.suffix != ".png":
            print(
                "rendering: on two cores about twice as long as the film",
                file=sys.stderr,
                flush=True,
            )
        return render.film(player, episode, out, pixels)
    tell(0.0)
    try:
        return render.film(player, episode, out, pixels, tell)
    finally:
        print(f"\r{'':26}\r", end="", file=sys.stderr, flush=True)

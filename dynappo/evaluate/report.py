"""Writes report.html: the results of an evaluation, and the robot under each command, in one file.

The tables come from `show`, the maps from `figures`, the player from the page of `dynappo play`. There is one
player: a click on a command loads that command's recording into it.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import files
from dynappo.evaluate import figures, tables
from dynappo.page import episode_page
from dynappo.policy import episode as episode_lib
from dynappo.policy.episode import Player

EVERY = 2  # control steps between two pictures, which the page joins: 45 commands are 2 MB so
OF_RECORDING = (
    "rows fall root position rotation command velocity".split()
)  # of a scene: what is a recording's


def write(
    out: Path,
    source: str,
    player: Player,
    numbers: dict[str, Any],
    recordings: dict[tuple, dict[str, Any]],
    changed: dict[str, Any],
    of_task: dict[str, Any] | None,
) -> None:
    """Write report.html into `out`, beside the pictures of `figures.write`, of which it shows one.

    `source` names the policy; `numbers` and `recordings` are those of `trials.run`, `changed` those
    of `changes.run` with `tours`, `of_task` those of `episodes.run`, or None. Raises OSError if the file
    cannot be written.
    """
    rows = [*numbers["commands"], *numbers["ahead"]]
    found = {name(row): row for row in reversed(rows)}  # one row for each command
    scenes = {
        key: scene(player, recordings[tuple(row["command"])])
        for key, row in found.items()
        if len(recordings[tuple(row["command"])]["qpos"])
    }
    clips = {
        key: {
            "subtitle": tables.command_text(found[key]),
            "measures": measures(found[key]),
            "scene": {part: some[part] for part in OF_RECORDING},
        }
        for key, some in scenes.items()
    }
    first: dict[str, Any] = next(iter(scenes.values()), {})
    shared = {part: value for part, value in first.items() if part not in OF_RECORDING}
    title = html.escape(f"{player.policy.robot}, dynappo")
    text = episode_page.filled(
        Path(__file__).with_suffix(".html").read_text(encoding="utf-8"),
        TITLE=title,
        HEADING=html.escape(f"How well {player.policy.robot} walks"),
        SOURCE=html.escape(source),
        EPISODES=_table(tables.episodes_text(of_task), tables.episodes_rows(of_task))
        if of_task
        else "",
        SWEEP=_table(tables.trials_text(numbers), tables.trials_rows(numbers)),
        CHANGES="".join(f"<li>{html.escape(line)}</li>" for line in tables.changes_lines(changed)),
        NOTES="".join(f"<li>{html.escape(line)}</li>" for line in tables.notes(numbers)),
        MAPS="".join(_map(*one) for one in figures.maps(numbers)),
        GAIT=_picture(out / "gait.png"),
        PAGE=_json(episode_page.content(first, player.policy.robot, "", [])) if first else '""',
        SHARED=_json(shared),
        CLIPS=_json(clips),
        FIRST=_json(name(numbers["ahead"][0])),
    )
    with files.replacing(out / "report.html") as part:
        part.write_bytes(text.encode(errors="backslashreplace"))


def name(row: dict[str, Any]) -> str:
    """The command of a row, as a key."""
    return ",".join(f"{value:g}" for value in row["command"])


def scene(player: Player, recording: dict[str, Any]) -> dict[str, Any]:
    """What the page plays of one command's recording."""
    some = slice((len(recording["qpos"]) - 1) % EVERY, None, EVERY)  # the last one is among them
    rows = recording["qpos"][some]
    fell = np.zeros(len(rows), bool)
    fell[-1] = recording["fall"] is not None
    return episode_page.scene(
        player,
        {
            "dt": np.asarray(EVERY * episode_lib.period(player)),
            "qpos": rows,
            "fell": fell,
            "command": np.tile(recording["command"], (len(rows), 1)),
            "velocity": recording["velocity"][some],
        },
    )


def measures(row: dict[str, Any]) -> list[tuple[str, str]]:
    """The measures that the page shows beside the player."""
    known = [
        (label.strip(), text.format(row[key]))
        for key, label, text in tables.ROWS
        if key in ("tracking_error", "yaw_error", "cost_of_transport") and row[key] is not None
    ]
    return [("fall", "none" if row["fall"] is None else f"after {row['fall']:.1f} s"), *known]


def _json(value) -> str:
    """JSON that can stand in a script of an HTML page."""
    return json.dumps(value, separators=(",", ":")).replace("</", "<\\/").replace("<!--", "<\\!--")


def _table(text: str, rows: list[list[str]]) -> str:
    return f"<p>{html.escape(text)}</p><table>{episode_page.cells(rows)}</table>"


def _picture(path: Path) -> str:
    if not path.is_file():  # no matplotlib
        return ""
    content = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="When which foot is on the ground" src="data:image/png;base64,{content}">'


def _map(title: str, label: str, across, ahead, cells) -> str:
    """A map of errors as a table of buttons, the fastest command ahead on top."""
    lines = ""
    for speed, line in reversed([*zip(ahead, cells, strict=True)]):
        lines += f"<tr><th>{speed:g}</th>" + "".join(map(_cell, line)) + "</tr>"
    foot = "<th></th>" + "".join(f"<th>{value:g}</th>" for value in across)
    return (
        f"<table class=map><caption>{html.escape(title)}</caption>{lines}<tr>{foot}</tr>"
        f"<tr><th></th><th colspan={len(across)}>{html.escape(label)}</th></tr></table>"
    )


def _cell(row: dict[str, Any]) -> str:
    if figures.unmeasured(row):
        kind, text = (
            "fell",
            "-" if row["fall"] is None else f"fell<small>{row['fall']:.1f} s</small>",
        )
    else:
        share = min(1.0, row["tracking_error"] / figures.PALE)
        kind = "dark" if share > 0.6 else ""
        text = f"{row['tracking_error']:.2f}<small>{row['yaw_error']:.2f}</small>"
        kind += f'" style="--error: {share:.2f}'
    return f'<td><button data-play="{name(row)}" class="{kind}">{text}</button></td>'

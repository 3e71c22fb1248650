"""The tables that `dynappo evaluate` prints, and its progress bar."""

from __future__ import annotations

import contextlib
import time
from typing import Any

from dynappo.evaluate import figures, slow
from dynappo.evaluate.stress import SECONDS
from dynappo.policy import walks
from dynappo.program import devices

PATIENCE = 15.0  # s without a line
ROWS = (  # of the table of the trials: name, label, format
    ("speed", "speed", "{:.2f} m/s"),
    ("tracking_error", "tracking error", "{:.2f} m/s"),
    ("yaw_error", "yaw rate error", "{:.2f} rad/s"),
    ("cost_of_transport", "cost of transport", "{:.2f}"),
    ("positive_cost_of_transport", "  of positive work alone", "{:.2f}"),
    ("torque", "mean torque of a joint", "{:.1f} N m"),
    ("torque_share", "  of the limit, at most", "{:.0%}"),
    ("action_rate", "action rate", "{:.1f} rad/s"),
    ("joint_speed", "joint speed", "{:.2f} rad/s"),
    ("tilt", "tilt of the base", "{:.3f} rad"),
    ("height", "height of the base", "{:.3f} m"),
    ("air_time", "foot air time", "{:.3f} s"),
    ("duty_factor", "duty factor", "{:.2f}"),
    ("stride_frequency", "stride frequency", "{:.2f} /s"),
    ("clearance", "foot clearance", "{:.3f} m"),
    ("slip", "foot slip", "{:.2f} m/s"),
    ("flight", "all feet in the air", "{:.0%}"),
    ("asymmetry", "left and right differ", "{:.0%}"),
)


@contextlib.contextmanager
def progress(screen, what: str):
    """Yields `tell(done, total)`, which moves a bar on a terminal; elsewhere a line says what begins, and
    others how far it is, where that takes long."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(24), TextColumn("{task.completed}/{task.total}"))
    hidden = not screen.is_terminal
    bar = Progress(*columns, TimeRemainingColumn(), console=screen, transient=True, disable=hidden)
    with bar:
        task, said = bar.add_task(""), time.monotonic()
        if hidden:
            screen.print(f"measures {what} in C MuJoCo", soft_wrap=True)

        def tell(done, total):
            nonlocal said
            bar.update(task, completed=done, total=total)
            if hidden and done < total and time.monotonic() - said >= PATIENCE:
                said = time.monotonic()
                screen.print(f"{what} {done}/{total}", soft_wrap=True)

        yield tell


def _table(screen, rows: list[list[str]], headings: list[str] | None = None) -> None:
    """Print rows in columns; numbers under headings are at the right."""
    from rich.table import Table

    table = Table(show_header=bool(headings), box=None, padding=(0, 2, 0, 0), header_style="bold")
    for i, heading in enumerate(headings or ()):
        table.add_column(heading, justify="right" if i else "left", no_wrap=bool(i))
    for row in rows:
        table.add_row(*row)
    screen.print(table)


def stress(screen, rows: list[dict[str, Any]]) -> None:
    """Print the table of disturbances."""
    count = rows[0]["episodes"]
    screen.print(
        f"{count} commands, {SECONDS:g} s each, in C MuJoCo; the first second is left out",
        soft_wrap=True,
    )
    cells = []
    for row in rows:
        errors = [(row["tracking_error"], "m/s"), (row["yaw_error"], "rad/s")]
        numbers = ["-" if v is None else f"{v:.2f} {unit}" for v, unit in errors]
        cells.append([row["stress"], f"{row['falls']} of {count}", *numbers])
    _table(screen, cells, ["", "falls", "tracking error", "yaw rate error"])


def stairs(screen, rows: list[dict[str, Any]]) -> None:
    """Print how many flights of stairs were climbed: a line a disturbance, a column a height."""
    if not rows:
        return
    heights = [f"{height:g} m" for height in rows[0]["heights"]]
    screen.print(
        f"stairs of boxes, up, {rows[0]['tries']} tries of each height of a step in C MuJoCo: climbed, "
        "falls, and those in which a shank or thigh touched a step",
        soft_wrap=True,
    )
    cells = [
        [row["stress"]]
        + [
            ", ".join(map(str, of))
            for of in zip(row["climbed"], row["falls"], row["bumped"], strict=True)
        ]
        for row in rows
    ]
    _table(screen, cells, ["", *heights])


def trials(screen, numbers: dict[str, Any]) -> None:
    """Print the table of the trials: over all commands, at each speed ahead, and standing."""
    headings, *rows = trials_rows(numbers)
    screen.print(trials_text(numbers), soft_wrap=True)
    _table(screen, rows, headings)
    for line in notes(numbers):
        screen.print(line, soft_wrap=True)


def trials_text(numbers: dict[str, Any]) -> str:
    """A line that says what the trials are."""
    return (
        f"{numbers['all']['episodes']} commands, {numbers['seconds']:g} s each, in C MuJoCo without noise; "
        "the first second is left out"
    )


def trials_rows(numbers: dict[str, Any]) -> list[list[str]]:
    """The table of the trials as texts, its headings first."""
    every, one = numbers["all"], [*numbers["ahead"]]
    headings = ["", "all commands", *(f"{row['command'][0]:g} m/s ahead" for row in one)]
    if numbers["standing"]:
        headings, one = [*headings, "standing"], [*one, numbers["standing"]]
    falls = ["none" if row["fall"] is None else f"after {row['fall']:.1f} s" for row in one]
    rows = [headings, ["falls", f"{every['falls']} of {every['episodes']}", *falls]]
    for name, label, text in ROWS:
        values = [row[name] for row in (every, *one)]
        rows += [[label, *("-" if v is None else text.format(v) for v in values)]]
    return rows


def notes(numbers: dict[str, Any]) -> list[str]:
    """Lines on the commands tracked worst and turned worst, those that made the robot fall, and slow ones."""
    rows = numbers["commands"]
    stood = [row for row in rows if not figures.unmeasured(row)]
    fell = [row for row in rows if row["fall"] is not None]
    lines = [f"fell after {row['fall']:.1f} s, {command_text(row)}" for row in fell[:5]]
    if len(fell) > 5:
        lines.append(f"fell on {len(fell) - 5} other commands: see evaluation.json")
    if stood:
        for name, label, unit in (
            ("tracking_error", "worst tracked", "m/s"),
            ("yaw_error", "worst turned", "rad/s"),
        ):
            worst = max(stood, key=lambda row, name=name: row[name])
            lines.append(f"{label}: {worst[name]:.2f} {unit}, {command_text(worst)}")
    return [*lines, slow.line(numbers["slow"])] if numbers["slow"] else lines


def command_text(row: dict[str, Any]) -> str:
    """The command of a row, in words."""
    x, y, turn = row["command"]
    return f"asked for {x:g}, {y:g} m/s, {turn:g} rad/s"


def changes(screen, numbers: dict[str, Any]) -> None:
    """Falls when the command changes, and on the tours."""
    for line in changes_lines(numbers):
        screen.print(line, soft_wrap=True)


def changes_lines(numbers: dict[str, Any]) -> list[str]:
    """What `changes` found, and the first five falls."""

    def said(command):
        return "{:.2f}, {:.2f} m/s, {:.2f} rad/s".format(*command)

    low, high = numbers["every"]
    lines = [
        f"changes of command, one every {low:g} to {high:g} s, in C MuJoCo without noise: "
        f"falls after {numbers['falls']} of {numbers['changes']}"
    ]
    lines += [
        f"fell {row['after']:.1f} s after {said(row['before'])} became {said(row['command'])}"
        for row in numbers["fell"][:5]
    ]
    if len(numbers["fell"]) > 5:
        lines.append(f"fell after {len(numbers['fell']) - 5} other changes: see evaluation.json")
    if numbers["start_falls"]:
        lines.append(
            f"fell before any change in {numbers['start_falls']} of {numbers['walks']} walks"
        )
    for tour in numbers["tours"]:
        times = ", ".join(f"{t:.1f}" for t in tour["fell_at"][:5])
        more = len(tour["fell_at"]) - 5
        often = f", and {more} more time{'s' * (more > 1)}" if more > 0 else ""
        ends = f"fell after {times} s{often}" if times else "no fall"
        lines.append(f"the tour of the {tour['tour']}, {tour['seconds']:g} s: {ends}")
    return lines


def crossing(screen, numbers: dict[str, Any]) -> None:
    """Print how many tiles of each kind and row were crossed."""
    own = "map" in numbers["kinds"]
    where = "its own map" if own else "tiles that training has not seen"
    screen.print(
        f"{numbers['tries']} tries of {numbers['seconds']:g} s, told {numbers['speed']:g} m/s, on {where}; "
        f"{devices.ENGINES[numbers['impl']]} on {numbers['device']}",
        soft_wrap=True,
    )
    _table(screen, crossing_rows(numbers))
    if not own:
        low, high = numbers["stairs"]
        steps = f"stairs of {low:g} to {high:g} m a step"
        screen.print(f"rows from the easiest to the hardest, {steps}; -: no try", soft_wrap=True)


def crossing_rows(numbers: dict[str, Any]) -> list[list[str]]:
    """The table as texts: a line for each kind, and of all; crossed, falls, and crossed in each row."""

    def share(one: dict[str, int], name: str) -> str:
        return f"{one[name] / one['tries']:.0%}" if one["tries"] else "-"

    out = []
    for kind, one in {**numbers["kinds"], "all": numbers["all"]}.items():
        rows = numbers["rows"].get(kind, [])
        each = ", ".join(share(row, "crossed") for row in rows)
        text = f"{share(one, 'crossed')} of {one['tries']}, falls {share(one, 'fell')}"
        out.append([kind.replace("_", " "), text + f"; rows {each}" * bool(rows)])
    return out


def episodes(screen, numbers: dict[str, Any]) -> None:
    """Print the table of the episodes of the task."""
    screen.print(episodes_text(numbers), soft_wrap=True)
    _table(screen, episodes_rows(numbers))


def episodes_text(numbers: dict[str, Any]) -> str:
    """A line that says what the episodes of the task are."""
    task = "noise, pushes, randomised physics" if numbers["randomize"] else "no noise"
    engine = devices.ENGINES[numbers["impl"]]
    return (
        f"{numbers['seconds']:g} s each, commands as in training, {task}; "
        f"{engine} on {numbers['device']}"
    )


def episodes_rows(numbers: dict[str, Any]) -> list[list[str]]:
    """The table of the episodes of the task as texts."""
    rows = (
        ("return", "return", "{:.2f}", 1),
        ("return_std", "  standard deviation", "{:.2f}", 1),
        ("fall_rate", "episodes with a fall", "{:.1f} %", 100),
        ("length", "length", "{:.0f} control steps", 1),
        ("tracking_error", "tracking error", "{:.2f} m/s", 1),
        ("yaw_error", "yaw rate error", "{:.2f} rad/s", 1),
    )
    rows += (("crossed", "tiles crossed", "{:.1f} %", 100),) * ("crossed" in numbers)
    known = ((label, numbers.get(name), text, scale) for name, label, text, scale in rows)
    none = walks.unmeasured(numbers["seconds"])
    out = [
        [label, none if v is None else text.format(v * scale)] for label, v, text, scale in known
    ]
    return out + [["the policy", words] for words in [numbers.get("policy")] if words]

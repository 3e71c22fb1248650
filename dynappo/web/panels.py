"""The page's controls: buttons, sliders, keys and plots.

viser calls back in its own threads; the callbacks only leave wishes for the loop (`live.wish`).
"""

from __future__ import annotations

import html
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import viser

from dynappo.web import live as live_lib
from dynappo.web.live import Live

COMMAND, VELOCITY = "#1a9e4d", "#216bed"
AXES = (("forward, m/s", 0), ("left, m/s", 1), ("turn, rad/s", 2))
SPEEDS = {"1x": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
NUDGE = 0.1  # m/s or rad/s of a key
KEYS = (  # viser's own move the view: arrows, W A S D, Q, E
    ("I", 0, 1, "faster ahead"),
    ("K", 0, -1, "slower, back"),
    ("J", 2, 1, "turn left"),
    ("L", 2, -1, "turn right"),
    ("U", 1, 1, "to the left"),
    ("O", 1, -1, "to the right"),
)
HELP = (
    "Drag the robot to pull it; drag beside it to turn the view.\n\n"
    "Keys: I, K ahead and back, J, L turn, U, O sideways, space stops, P pauses, R resets, "
    "X pushes, F follows. A gamepad: sticks steer, A stops, B pushes."
)
# HTML, not viser's Markdown, which has no way to write a text as it is: all in it is escaped
STATUS = '<div style="padding: 0 12px; font-size: 14px; overflow-wrap: anywhere">{}</div>'
PARAGRAPH = '<p style="margin: 0 0 8px">{}</p>'
POINTS = 160  # of a plot
LATE = 0.9  # of real time; below the page says so
STRIDES = 100  # control steps of torques, a few strides
COLOURS = "#216bed", "#e0762f", "#1a9e4d", "#a23bd0", "#c2185b", "#7a7a00"  # of legs and arms


class Run(NamedTuple):
    """Where the curves of a run are."""

    tab: Any
    text: viser.GuiMarkdownHandle


@dataclass
class Panels:
    """The handles that change while the robot walks."""

    status: viser.GuiHtmlHandle
    steering: viser.GuiFolderHandle  # with sliders and tour
    sliders: list[viser.GuiSliderHandle]
    tour: viser.GuiCheckboxHandle
    pause: viser.GuiButtonHandle
    policy: viser.GuiDropdownHandle
    look: dict[str, viser.GuiCheckboxHandle]
    motion: list[viser.GuiUplotHandle]
    torques: Any  # the tab of the plots `torque`, one for each kind of joint that the robot has
    run: Run | None
    torque: list[viser.GuiUplotHandle] = field(default_factory=list)
    seen: list = field(default_factory=list)  # value and wish of sliders and tour, when last told


def add(
    server: viser.ViserServer,
    live: Live,
    offered: list[str],
    choose: Callable[[str], None],
    look: Callable[[dict[str, bool]], None],
    of_run: bool,
) -> Panels:
    """Build the panels; `choose(name)` loads a policy, `look(flags)` follows and shows contacts.

    `of_run`: with the curves of a run.
    """
    gui = server.gui
    status = gui.add_html("")
    policy = gui.add_dropdown("policy", offered, initial_value=offered[0])
    policy.on_update(lambda event: _by_person(event, lambda: choose(policy.value)))
    steering, sliders, tour = _steering(server, live)
    with gui.add_folder("time"):
        pause = gui.add_button("pause")
        pause.on_click(lambda _: live_lib.wish(live, _pause))
        gui.add_button("reset").on_click(lambda _: live_lib.wish(live, live_lib.reset))
        speed = gui.add_button_group("speed", list(SPEEDS))
        speed.on_click(lambda _: live_lib.wish(live, _set, "speed", SPEEDS[speed.value]))
    _pushes(server, live)
    with gui.add_folder("view"):
        flags = {"follow": True, "contacts": False, "forces": False}
        checks = {name: gui.add_checkbox(name, on) for name, on in flags.items()}
        for check in checks.values():
            check.on_update(lambda _: look({name: c.value for name, c in checks.items()}))
        up = gui.add_checkbox("stand up after a fall", True)
        up.on_update(lambda _: live_lib.wish(live, _set, "stands_up", up.value))
    gui.add_markdown(HELP)
    _additions(server)
    key(
        server,
        "F",
        "follow",
        lambda: setattr(checks["follow"], "value", not checks["follow"].value),
    )
    plots = _plots(server, of_run)
    return Panels(status, steering, sliders, tour, pause, policy, checks, *plots)


def _additions(server: viser.ViserServer) -> None:
    """What viser's page lacks. A script in a page's HTML runs only as what a picture does on an error."""
    code = (Path(__file__).parent / "additions.js").read_text(encoding="utf-8")
    server.gui.add_html(f'<img src="data:," hidden onerror="{html.escape(code)}">')


def _by_person(event, action: Callable[[], None]) -> None:
    """Call `action` if a user caused the event: the program sets values, too."""
    if event.client is not None:
        action()


def _set(live: Live, name: str, value) -> None:
    setattr(live, name, value)


def _pause(live: Live) -> None:
    live.paused = not live.paused


def _steering(server: viser.ViserServer, live: Live):
    """Sliders and keys for the command, and the tour."""
    gui = server.gui
    steering = gui.add_folder("command")
    with steering:
        sliders = []
        for (name, _), (low, high) in zip(AXES, _ranges(live), strict=True):
            slider = gui.add_slider(name, low, high, 0.05, float(np.clip(0.0, low, high)))
            sliders.append(slider)

        def steered(event):
            command = [s.value for s in sliders]
            _by_person(event, lambda: live_lib.wish(live, live_lib.steer, command))

        for slider in sliders:
            slider.on_update(steered)
        stop = gui.add_button("stop")
        stop.on_click(lambda _: live_lib.wish(live, live_lib.steer, np.zeros(3)))
        tour = gui.add_checkbox("a tour, by itself", live.given is not None)
        tour.on_update(
            lambda event: _by_person(event, lambda: live_lib.wish(live, live_lib.tour, tour.value))
        )
    for name, axis, sign, text in KEYS:
        key(server, name, text, lambda a=axis, s=sign: live_lib.wish(live, nudge, a, s * NUDGE))
    key(server, "space", "stop", lambda: live_lib.wish(live, live_lib.steer, np.zeros(3)))
    key(server, "P", "pause", lambda: live_lib.wish(live, _pause))
    key(server, "R", "reset", lambda: live_lib.wish(live, live_lib.reset))
    return steering, sliders, tour


def _ranges(live: Live) -> np.ndarray:
    """[3, 2] the ranges of sliders and plots; some for a task without command, which shows no slider."""
    found = live_lib.ranges(live.player)
    return found if len(found) else np.tile([-1.0, 1.0], (3, 1))


def key(server: viser.ViserServer, name: Any, text: str, action: Callable[[], None]) -> None:
    """Bind a key to `action`; viser's list of commands shows it, too."""
    server.gui.add_command(text, hotkey=name).on_trigger(lambda _: action())


def nudge(live: Live, axis: int, change: float) -> None:
    """Add `change` to one number of the command."""
    command = live.command.copy()
    command[axis] = round(command[axis] + change, 6)
    live_lib.steer(live, command)


def _pushes(server: viser.ViserServer, live: Live) -> None:
    with server.gui.add_folder("push"):
        size = server.gui.add_slider("m/s", 0.1, 2.0, 0.1, 0.5)
        ways = {"ahead": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
        group = server.gui.add_button_group("to", list(ways))

        def pushed(way):
            live_lib.wish(live, live_lib.push, *(size.value * n for n in ways[way]))

        group.on_click(lambda _: pushed(group.value))
    key(server, "X", "push to the left", lambda: pushed("left"))


def _plots(server: viser.ViserServer, of_run: bool):
    """The curves of a run, command against velocity, and the torques, in a panel of their own."""
    panel = server.gui.add_panel()
    empty, motion, run = np.zeros(1), [], None
    if of_run:
        tab = panel.add_tab("run")
        with tab:
            run = Run(tab, server.gui.add_markdown("no iteration yet"))
    with panel.add_tab("motion"):
        for name, _ in AXES:
            series: tuple[Any, ...] = (
                {"label": "s"},
                {"label": "command", "stroke": COMMAND, "width": 2},
                {"label": "robot", "stroke": VELOCITY, "width": 2},
            )
            motion.append(
                server.gui.add_uplot(
                    (empty,) * 3, series, title=name, height=170, scales={"x": {"time": False}}
                )
            )
    torques = panel.add_tab("torques")
    panel.dock_left()
    return motion, torques, run


def show_robot(server: viser.ViserServer, panels: Panels, live: Live) -> None:
    """Set what depends on the robot: the ranges of the sliders, the plots of its joints."""
    panels.steering.visible = bool(len(live_lib.ranges(live.player)))
    for slider, (low, high) in zip(panels.sliders, _ranges(live), strict=True):
        slider.min, slider.max = low, high
    for handle, (low, high) in zip(panels.motion, _ranges(live), strict=True):
        room = 0.2 * (high - low)
        handle.scales = {"x": {"time": False}, "y": {"range": (low - room, high + room)}}
    for handle in panels.torque:
        handle.remove()
    panels.torque.clear()
    with panels.torques:
        for kind, joints in by_kind(live_lib.joint_names(live.player)).items():
            names = [live_lib.joint_names(live.player)[j].partition("_")[0] for j in joints]
            lines: tuple[Any, ...] = (
                {"label": "s"},
                *(
                    {"label": name, "stroke": colour, "width": 1}
                    for name, colour in zip(names, itertools.cycle(COLOURS), strict=False)
                ),
            )
            panels.torque.append(
                server.gui.add_uplot(
                    (np.zeros(1),) * len(lines),
                    lines,
                    title=f"{kind}, N m",
                    height=170,
                    scales={"x": {"time": False}},
                )
            )


def by_kind(joint_names: Sequence[str]) -> dict[str, list[int]]:
    """The joints of all legs and arms by what they move: `hip` -> FL_hip_joint, FR_hip_joint, ..."""
    kinds: dict[str, list[int]] = {}
    for i, name in enumerate(joint_names):
        kind = name.partition("_")[2].removesuffix("_joint") or name
        kinds.setdefault(kind, []).append(i)
    return kinds


def draw(panels: Panels, live: Live) -> None:
    """Fill the plots with the last seconds, now at their right end.

    They are always as long: viser's plots show nothing any more after time has jumped back.
    """
    if not live.history:
        return
    history = list(live.history)
    rows = history[:: max(1, len(history) // POINTS)]
    t, command, velocity, _ = (np.array(column) for column in zip(*rows, strict=True))
    for i, handle in enumerate(panels.motion):
        handle.data = _window(live_lib.HISTORY, t - live.t, command[:, i], velocity[:, i])
    t, _, _, torque = (np.array(column) for column in zip(*history[-STRIDES:], strict=True))
    seconds = STRIDES * live_lib.period(live.player)
    kinds = by_kind(live_lib.joint_names(live.player))
    for handle, joints in zip(panels.torque, kinds.values(), strict=True):
        handle.data = _window(seconds, t - live.t, *torque[:, joints].T)


def _window(seconds: float, t: np.ndarray, *columns: np.ndarray) -> tuple[np.ndarray, ...]:
    """A plot's data from `seconds` ago until now, with nothing where there are no rows."""
    nothing = [np.nan]
    ends = (np.concatenate([nothing, column, nothing]) for column in columns)
    return np.concatenate([[-seconds], t, [0.0]]), *ends


def show_status(panels: Panels, live: Live, text: str) -> None:
    """Show state, command and velocity, and set the sliders to the command."""
    state = "paused" if live.paused else f"{live.rate:.0f} Hz"
    share = live.rate * live_lib.period(live.player) / live.speed
    if not live.paused and 0 < share < LATE:
        state += f", slower than real time: {share:.1f} of it"
    if live.fell is not None:
        state += ", has fallen"
    command, moves = live.row["command"], live.row["velocity"]
    about = f"<b>{html.escape(live_lib.name(live.player))}</b>, {html.escape(text)}"
    lines = [f"asked {_numbers(command)}"] if len(live_lib.ranges(live.player)) else []
    lines.append(f"moves {_numbers(moves)}")
    if live.note:
        lines.append(f"<i>{html.escape(live.note)}</i>")
    parts = about, f"{live.t:.1f} s, {state}", "<br>".join(lines)
    panels.status.content = STATUS.format("".join(map(PARAGRAPH.format, parts)))
    _follow(panels, [*map(float, command), live.given is not None])
    panels.pause.label = "go on" if live.paused else "pause"


def _follow(panels: Panels, wanted: list) -> None:
    """Set sliders and tour to the command.

    A slider that somebody has just moved becomes the command a moment later: until the next call it
    is left alone.
    """
    handles = [*panels.sliders, panels.tour]
    before = panels.seen or [(None, value) for value in wanted]
    for handle, value, last in zip(handles, wanted, before, strict=True):
        now = handle.value
        if abs(now - value) > 1e-6 and ((now, value) == last or value != last[1]):
            handle.value = value
    panels.seen = [(handle.value, value) for handle, value in zip(handles, wanted, strict=True)]


def _numbers(values) -> str:
    return ", ".join(f"{value:+.2f}" for value in values)

"""MuJoCo's viewer, with keys that steer the robot.

The viewer is passive: this process steps the physics, its thread draws and reads the keyboard.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable

import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.policy import episode as episode_lib
from dynappo.policy import render
from dynappo.policy.policy_file import Policy

# Keys of the viewer (GLFW codes) that MuJoCo's own viewer leaves free: axis and step (m/s, rad/s)
STEER = {
    265: (0, 0.1),  # up
    264: (0, -0.1),  # down
    263: (2, 0.1),  # left
    262: (2, -0.1),  # right
    56: (1, 0.1),  # 8
    57: (1, -0.1),  # 9
}
STOP = 32  # space
CATCH_UP = 10  # control steps between two pictures at most, where drawing is slow
KEYS = "up, down: forward speed; left, right: turn; 8, 9: sideways; space: stop; backspace: reset"


def check_display() -> None:
    """ConfigError if no viewer can be opened here."""
    shown = sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)
    problem = "" if shown else "there is no display for the viewer"
    if shown:
        from mujoco import viewer

        # launched without a window system, the viewer's thread dies and its caller waits for ever
        with warnings.catch_warnings(action="ignore"):
            if sys.platform != "darwin" and not viewer.glfw.init():
                problem = "the display cannot be opened"
    if problem:
        raise ConfigError(f"{problem}; write a file instead: --out=walk.html (.mp4, .gif, .png)")


def steer(command: np.ndarray, key: int, policy: Policy) -> np.ndarray:
    """The command after a key (see KEYS), within what the policy was trained for."""
    if key == STOP:
        return np.zeros(3)
    if key not in STEER:
        return command
    axis, change = STEER[key]
    ranges = np.array([policy.command_x, policy.command_y, policy.command_yaw])
    after = command.copy()
    after[axis] = np.clip(round(command[axis] + change, 6), *ranges[axis])
    return after


@contextlib.contextmanager
def window(player: episode_lib.Player, data, press: Callable[[int], None]):
    """MuJoCo's viewer of `data`, following the robot; `press(key)` is called in its thread.

    At the end it waits for the viewer's thread: Python would crash if it ended first.
    """
    from mujoco import viewer

    others = set(threading.enumerate())
    try:
        handle = viewer.launch_passive(
            player.model, data, key_callback=press, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # of a Mac, where it needs mjpython
        raise ConfigError(f"the viewer cannot start: {str(error).splitlines()[0]}") from None
    handle.opt.geomgroup[:] = render.options(player.model, player.base_body).geomgroup
    camera = handle.cam
    camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, player.base_body
    camera.distance, camera.azimuth, camera.elevation = 2.5 * player.model.stat.extent, 142, -14
    try:
        with handle:
            yield handle
    finally:
        for thread in set(threading.enumerate()) - others:
            thread.join(timeout=5)


def watch(player: episode_lib.Player, act, given: Callable, seconds: float | None) -> dict:
    """Play in MuJoCo's viewer until it is closed, or for `seconds`; returns the last episode.

    The first key that steers takes over from the commands `given(t)`.
    """
    held: list[np.ndarray] = []  # the command of the keys, once one was pressed
    now = [given(0.0)]

    def press(key):
        if key == STOP or key in STEER:
            held[:] = [steer(held[0] if held else now[0], key, player.policy)]

    def command(t):
        now[0] = held[0] if held else given(t)
        return now[0]

    def fresh():
        every = episode_lib.rows(player, data, act, command)
        return every, [next(every)], time.perf_counter()

    data, period = mujoco.MjData(player.model), episode_lib.period(player)
    every, some, start = fresh()
    with window(player, data, press) as shown:
        while shown.is_running() and not (seconds and len(some) * period >= seconds):
            behind = time.perf_counter() - start - len(some) * period  # s
            start += max(0.0, behind - CATCH_UP * period)  # what cannot be caught up is let go
            with shown.lock():
                for _ in range(int(np.clip(behind / period, 1, CATCH_UP))):
                    some.append(next(every))
                clock, row = data.time, some[-1]
                shown.user_scn.ngeom = 0
                render.arrows(
                    shown.user_scn, data, player.base_body, row["command"], row["velocity"]
                )
            shown.set_texts(overlay(row))
            shown.sync()
            if data.time < clock:  # backspace, or the viewer's own button: it has reset the data
                every, some, start = fresh()
            time.sleep(max(0.0, start + len(some) * period - time.perf_counter()))
    return episode_lib.stack(player, some)


def overlay(row: dict) -> list:
    """The text of the viewer: command, velocity, and the keys."""
    numbers = [
        "\n".join(f"{value:+.2f}" for value in row[name]) for name in ("command", "velocity")
    ]
    grid, big = mujoco.mjtGridPos, mujoco.mjtFontScale.mjFONTSCALE_150
    left = "\nforward m/s\nleft m/s\nturn rad/s"
    pairs = "\n".join(
        f"{a}  {b}" for a, b in zip(numbers[0].split("\n"), numbers[1].split("\n"), strict=True)
    )
    return [
        (big, grid.mjGRID_TOPLEFT, left, f"asked  moves\n{pairs}"),
        (big, grid.mjGRID_BOTTOMLEFT, "\n".join(KEYS.split("; ")), ""),
    ]

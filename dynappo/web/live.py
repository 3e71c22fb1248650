"""A robot that walks in real time in C MuJoCo while others look, steer and push.

It is a `Player`, or a `TaskPlayer` of another package's environment.

`Live` holds all state, and one thread (`run`) changes it. Other threads put functions into
`Live.wishes` (`wish`); `run` calls them between two control steps, so no lock is needed.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import mujoco
import numpy as np

from dynappo.policy import episode as episode_lib
from dynappo.policy import task_player
from dynappo.policy.episode import Player
from dynappo.policy.task_player import TaskPlayer

HISTORY = 8.0  # s that the plots show
TOUR = episode_lib.PAGE_SECONDS
LIE = 2.0  # s on the ground after a fall, until it stands up
CATCH_UP = 5  # control steps at once at most; what is further behind is let go
EDGE = 0.5  # m from the end of a height map, beyond which there is no ground: it begins again
STIFF = 4.0  # times the robot's weight for each metre that it is pulled
STRONGEST = 1.5  # times its weight


@dataclass
class Live:
    """A robot, its commands and its last control steps; arrays of `A` joints are in the policy's order."""

    player: Player | TaskPlayer
    act: Callable[[np.ndarray], np.ndarray]
    given: Callable[[float], np.ndarray] | None = None  # t (s) -> command, until somebody steers
    command: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m/s, m/s, rad/s
    speed: float = 1.0  # times real time
    paused: bool = False
    stands_up: bool = True  # by itself after a fall
    pull: np.ndarray | None = None  # [3] m from where somebody holds it to where they pull it
    wishes: deque = field(default_factory=deque)  # functions of no argument
    data: mujoco.MjData = field(init=False)
    rows: Iterator[dict] = field(init=False)
    row: dict = field(init=False)  # the last one of `episode.rows`, or its velocity and command
    history: deque = field(init=False)  # of (t, command, velocity, torque)
    t: float = 0.0  # s since it stood up
    before: float = 0.0  # s that `given` had run until then
    fell: float | None = None  # when
    note: str = ""  # what went wrong last
    rate: float = 0.0  # control steps a second, of the last second
    work: float = 0.0  # share of that second which the control steps took
    starts: int = 0  # how often it stood up

    def __post_init__(self):
        take_robot(self, self.player, self.act)


def wish(live: Live, function: Callable, *values) -> None:
    """Have `function(live, *values)` called between two control steps; from any thread."""
    live.wishes.append(lambda: function(live, *values))


def take_robot(live: Live, player: Player | TaskPlayer, act: Callable) -> None:
    """Take another robot, standing, under the command of the last one."""
    live.player, live.act = player, act
    live.data = mujoco.MjData(player.model)
    live.command = within(player, live.command)
    reset(live)


def take_policy(live: Live, act: Callable) -> None:
    """Take another policy for the same robot, which goes on walking."""
    live.act = act


def reset(live: Live) -> None:
    """Put the robot on its feet at the origin; its commands start anew."""
    live.before = 0.0
    stand_up(live)


def stand_up(live: Live) -> None:
    """Put the robot on its feet at the origin; its commands go on."""
    live.rows = _rows(live)
    live.history = deque(maxlen=round(HISTORY / period(live.player)))
    live.t, live.fell, live.pull = 0.0, None, None
    live.row = {"command": command_at(live, live.before), "velocity": np.zeros(3), "fell": False}
    step(live)


def _rows(live: Live) -> Iterator[dict]:
    """The control steps from standing on; of a task from its reset on, each time another."""
    act, command = lambda obs: live.act(obs), lambda t: command_at(live, live.before + t)
    if isinstance(live.player, TaskPlayer):
        live.starts += 1
        steered = command if len(ranges(live.player)) else None
        return task_player.rows(live.player, live.data, act, steered, live.starts)
    return episode_lib.rows(live.player, live.data, act, command)


def command_at(live: Live, t: float) -> np.ndarray:
    """The command at time `t` (s) of `given`."""
    if live.given is not None:
        live.command = within(live.player, live.given(t))
    return live.command


def tour(live: Live, on: bool) -> None:
    """Walk the tour, again and again, or stop."""
    around = episode_lib.tour(TOUR)
    live.given = (lambda t: around(t % TOUR)) if on else None
    if not on:
        live.command = np.zeros(3)


def steer(live: Live, command) -> None:
    """Set the command (m/s, m/s, rad/s) from now on; one that is not finite is ignored."""
    if not np.isfinite(command).all():
        return
    live.given, live.command = None, within(live.player, np.asarray(command, float))


def name(player: Player | TaskPlayer) -> str:
    """What it is, for a person."""
    return player.env if isinstance(player, TaskPlayer) else player.policy.robot


def joint_names(player: Player | TaskPlayer) -> tuple[str, ...]:
    """In the order of the torques."""
    return player.joint_names if isinstance(player, TaskPlayer) else player.policy.joint_names


def period(player: Player | TaskPlayer) -> float:
    """Seconds between two actions."""
    return player.dt if isinstance(player, TaskPlayer) else episode_lib.period(player)


def ranges(player: Player | TaskPlayer) -> np.ndarray:
    """[3, 2]: the commands that the policy was trained for; [0, 2] of a task that has none."""
    if isinstance(player, TaskPlayer):
        return np.zeros((0, 2)) if player.ranges is None else player.ranges
    return np.array([player.policy.command_x, player.policy.command_y, player.policy.command_yaw])


def within(player: Player | TaskPlayer, command) -> np.ndarray:
    """The command, clipped to the ranges that the policy was trained for; 0 of a task that has none."""
    few = ranges(player)
    return np.clip(command, *few.T) if len(few) else np.zeros(3)


def torques(player: Player | TaskPlayer, data: mujoco.MjData) -> np.ndarray:
    """[A] N m, of the motors in the last control step."""
    if isinstance(player, TaskPlayer):
        return task_player.torques(player, data)
    return data.qfrc_applied[player.joint_v].copy()


def over(live: Live) -> bool:
    """Whether the episode of a task without command is at its end: a robot that has got up would stay so."""
    player = live.player
    if not isinstance(player, TaskPlayer) or player.ranges is not None:
        return False
    return live.t > (player.episode_length - 0.5) * player.dt


def at_the_end(live: Live) -> bool:
    """Whether the robot is at the end of its height map, or beyond it."""
    player = live.player
    if isinstance(player, TaskPlayer) or player.field is None:
        return False
    _, cell, corner = player.field
    half = cell * (np.array(player.field.heights.shape) - 1) / 2
    away = np.abs(live.data.xpos[player.base_body][:2] - corner - half)
    return bool((away > half - np.minimum(EDGE, half / 2)).any())


def push(live: Live, ahead: float, left: float) -> None:
    """Add a velocity (m/s, in the base's heading) to the base's, as `evaluate --stress` does."""
    x, y = live.data.xmat[live.player.base_body].reshape(3, 3)[:2, 0]
    turn = np.array([[x, -y], [y, x]]) / max(np.hypot(x, y), 1e-6)
    velocity = turn @ [ahead, left]
    if isinstance(live.player, TaskPlayer):
        task_player.push(live.player, live.data, [*velocity, 0.0])
    else:
        v = live.player.root[1]
        live.data.qvel[v : v + 2] += velocity


def step(live: Live) -> None:
    """One control step; physics that blows up starts anew, or at once pauses, and `note` says so."""
    model, data, base = live.player.model, live.data, live.player.base_body
    force = np.zeros(3)
    if live.pull is not None:
        weight = model.body_subtreemass[base] * np.linalg.norm(model.opt.gravity)
        force = STIFF * weight * live.pull
        force *= min(1.0, STRONGEST * weight / max(np.linalg.norm(force), 1e-9))
    data.xfrc_applied[base, :3] = force
    try:
        live.row = next(live.rows)
    except FloatingPointError as error:
        live.note = str(error).rpartition(": ")[2]
        if live.t == 0:  # it will do so again
            live.note += "; paused"
            live.paused, live.rows = True, _rows(live)
            _still(live)
        else:
            live.before += live.t
            stand_up(live)
        return
    live.t += period(live.player)
    torque = torques(live.player, data)
    live.history.append((live.t, live.row["command"], live.row["velocity"], torque))
    if live.row["fell"] and live.fell is None:
        live.fell = live.t
    lies = live.fell is not None and live.t - live.fell > LIE
    if at_the_end(live) or live.stands_up and (lies or over(live)):
        live.before += live.t
        stand_up(live)


def _still(live: Live) -> None:
    """Put a robot whose physics blow up at once on its feet, where it stays."""
    if isinstance(live.player, TaskPlayer):
        mujoco.mj_resetData(live.player.model, live.data)
        mujoco.mj_forward(live.player.model, live.data)
    else:
        episode_lib.reset(live.player, live.data)


def run(
    live: Live, after: Callable[[], None], stop: Callable[[], bool], seconds: float | None = None
):
    """Walk in real time, times `live.speed`, until `stop()`, or for `seconds`.

    `after()` is called when all control steps that were due are done, at most once a period.
    """
    every = period(live.player)
    start = due = second = time.perf_counter()
    steps, busy = 0, 0.0
    while not stop() and not (seconds and due - start >= seconds):
        while live.wishes:
            live.wishes.popleft()()
            every = period(live.player)
        before = time.perf_counter()
        due = max(due, before - CATCH_UP * every)
        for _ in range(CATCH_UP + 1):  # no more: steps may take longer than their period
            if live.paused or due > time.perf_counter():
                break
            step(live)
            steps, due = steps + 1, due + every / live.speed
        busy += time.perf_counter() - before
        after()
        now = time.perf_counter()
        if now - second >= 1:
            live.rate, live.work = steps / (now - second), busy / (now - second)
            steps, busy, second = 0, 0.0, now
        if live.paused:
            due = now + every
        time.sleep(min(max(0.0, due - now), every))

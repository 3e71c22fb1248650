"""Measures a policy under each command of a grid: tracking, effort and gait, in C MuJoCo and NumPy.

One episode for each command, with every contact, a solver that converges, and no noise. Definitions, over
the time after the first second and before a fall:

- `tracking_error`, `yaw_error`: root mean squares of the planar velocity and of the yaw rate, as in
  `dynappo/scores.py`;
- `speed`: length of the mean planar velocity in the base frame;
- `power`: sum over the joints of |torque x speed|; `positive_power` counts only what the motors give
  (torque and speed of one sign), as if braking cost nothing;
- `cost_of_transport`: power / (weight x speed), without commands where it is slower than 0.1 m/s;
- `torque`: mean over joints of |torque|; `action_rate`: root mean square over joints of the speed at
  which the policy moves the joints' targets;
- `torque_share`: the share of its limit that the most loaded joint stays below for 99 % of the time;
  `joint_speed`: root mean square over joints (rad/s);
- `tilt`: mean angle of the base from upright (rad); `height`: mean height of its frame (m);
- how the feet move: `foot_motion.py`; measures of strides are left out of a robot that neither goes nor
  turns: one that stands may have feet that chatter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np

from dynappo.evaluate import foot_motion, slow
from dynappo.evaluate.spread import spread
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, policy_source
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy
from dynappo.policy.walks import SETTLE

SECONDS = 6.0  # of an episode
POINTS = 5  # of a command's range
SPEEDS = (0.5, 1.0)  # m/s ahead, at which the gait is looked at
MIN_SPEED = 0.1  # m/s, from which on something is transported
MIN_RATE = 0.1  # rad/s, from which on a robot turns
FINE = "torque speed contact load slide centre up".split()  # of a physics step


def record(player: Player, act: Callable, command, seconds: float = SECONDS) -> dict[str, Any]:
    """An episode under one `command` (vx, vy, yaw rate), until it ends or the robot falls.

    A row a control step: `velocity [T, 3]` (as the command, in the base frame), `action [T, A]` and
    `qpos [T, nq]` after it. A row a physics step: `torque [P, A]` (N m), `speed [P, A]` (rad/s) at
    which it was applied, and of the feet `contact`, `load`, `slide` (`foot_motion.at_ground`) and
    `height` (m) of their lowest points, `[P, F]`. `fall` (s), or None.
    A blow-up of the physics is a fall, and its step has no rows.
    """
    data, dt = mujoco.MjData(player.model), episode_lib.period(player)
    joints, feet = len(player.policy.joint_names), len(player.foot_names)
    shapes, command, fall = foot_motion.shapes(player), np.asarray(command, float), None
    widths = dict(velocity=3, action=joints, qpos=player.model.nq, torque=joints, speed=joints)
    widths |= dict(contact=feet, load=feet, slide=feet, centre=len(shapes), up=3 * len(shapes))
    found: dict[str, list] = {name: [] for name in widths}
    inside = []  # of a control step, a row for each physics step

    def after(torque, speed):
        place = data.geom_xpos[shapes, 2], data.geom_xmat[shapes, 6:].ravel()
        inside.append((torque, speed, *foot_motion.at_ground(player, data), *place))

    rows = episode_lib.rows(player, data, act, lambda t: command, after=after)
    for k in range(round(seconds / dt)):
        try:
            row = next(rows)
        except FloatingPointError:
            fall = (k + 1) * dt
            break
        for name in ("velocity", "action", "qpos"):
            found[name].append(row[name])
        for fine in inside:
            for name, values in zip(FINE, fine, strict=True):
                found[name].append(values)
        inside.clear()
        if row["fell"]:
            fall = (k + 1) * dt
            break
    columns = {name: np.reshape(found[name], (-1, width)) for name, width in widths.items()}
    up = columns.pop("up").reshape(-1, len(shapes), 3)
    height = foot_motion.heights(player, columns.pop("centre"), up)
    return columns | {"height": height, "command": command, "fall": fall}


def measured_rows(player: Player, recording: dict[str, Any]) -> dict[str, np.ndarray]:
    """The rows that count: after the first second, before the control step of a fall.

    `change [T, A]` (rad/s) is the speed of the joints' targets, from the action before each row.
    """
    dt, first = episode_lib.period(player), round(SETTLE / episode_lib.period(player))
    last = len(recording["velocity"])
    if recording["fall"] is not None:
        last = min(last, round(recording["fall"] / dt) - 1)
    last = max(first, last)
    fine = slice(first * player.substeps, last * player.substeps)
    names = ("torque", "speed", "contact", "load", "slide", "height")
    cut = {name: recording[name][fine] for name in names} | {"qpos": recording["qpos"][first:last]}
    targets = player.policy.action_scale * recording["action"]
    change = np.diff(targets, axis=0, prepend=0 * targets[:1]) / dt
    velocity = recording["velocity"][first:last]
    error = velocity - recording["command"]
    return cut | {"velocity": velocity, "error": error, "change": change[first:last]}


def measures(player: Player, recordings: Iterable[dict[str, Any]]) -> dict[str, float | None]:
    """Measures over several episodes together; None where one cannot be computed."""
    parts = [part for r in recordings if len((part := measured_rows(player, r))["velocity"])]
    names = "tracking_error yaw_error speed power positive_power torque torque_share action_rate"
    names += " joint_speed tilt height"
    if not parts:
        return dict.fromkeys([*names.split(), "cost_of_transport", "positive_cost_of_transport"])
    weight = player.model.body_subtreemass[player.base_body] * np.linalg.norm(
        player.model.opt.gravity
    )
    steps = np.array([len(part["velocity"]) for part in parts])
    speed = np.array([np.linalg.norm(part["velocity"][:, :2].mean(0)) for part in parts])
    power = [part["torque"] * part["speed"] for part in parts]  # [P, A] each
    watts = np.array([np.abs(p).sum(-1).mean() for p in power])
    positive = np.array([np.clip(p, 0, None).sum(-1).mean() for p in power])
    error, change, torque, turning, qpos = (
        np.concatenate([part[name] for part in parts])
        for name in ("error", "change", "torque", "speed", "qpos")
    )
    x, y, z = qpos[:, player.root[0] + np.array([4, 5, 2])].T
    tilt = np.arccos(np.clip(1 - 2 * (x**2 + y**2), -1, 1))
    walks = speed > MIN_SPEED
    carried = weight * (speed * steps)[walks].sum()

    def cost(some):
        return float((some * steps)[walks].sum() / carried) if walks.any() else None

    return {
        "tracking_error": float(np.sqrt((error[:, :2] ** 2).sum(-1).mean())),
        "yaw_error": float(np.sqrt((error[:, 2] ** 2).mean())),
        "speed": float((speed * steps).sum() / steps.sum()),
        "power": float((watts * steps).sum() / steps.sum()),
        "positive_power": float((positive * steps).sum() / steps.sum()),
        "torque": float(np.abs(torque).mean()),
        "torque_share": float(
            np.quantile((np.abs(torque) / player.policy.effort_limit).max(-1), 0.99)
        ),
        "action_rate": float(np.sqrt((change**2).mean())),
        "joint_speed": float(np.sqrt((turning**2).mean())),
        "tilt": float(tilt.mean()),
        "height": float(z.mean()),
        "cost_of_transport": cost(watts),
        "positive_cost_of_transport": cost(positive),
    }


def gait(player: Player, recordings: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """How the feet move in the rows that count: `foot_motion.measures`."""
    return foot_motion.measures(player, [measured_rows(player, r) for r in recordings])


def moved(
    player: Player, recordings: list[dict[str, Any]], walks: list[dict[str, Any]]
) -> dict[str, Any]:
    """`measures` of `recordings` and `gait` of `walks`; who neither goes nor turns makes no strides."""
    found, feet = measures(player, recordings), gait(player, walks)
    rows = [measured_rows(player, r)["velocity"][:, 2] for r in recordings]
    turns = np.mean([abs(rate.mean()) for rate in rows if len(rate)] or 0.0) > MIN_RATE
    if found["cost_of_transport"] is None and not turns:
        for some in (feet, *feet["feet"].values()):
            some |= dict.fromkeys(some.keys() & foot_motion.OF_STRIDES)
    return found | feet


def axes(policy: Policy, points: int = POINTS) -> dict[str, np.ndarray]:
    """The commands of the grid on each axis, over the range of training."""
    ranges = {"vx": policy.command_x, "vy": policy.command_y, "wz": policy.command_yaw}
    return {
        name: np.unique(np.round(np.linspace(low, high, points), 6))
        for name, (low, high) in ranges.items()
    }


def speeds(policy: Policy) -> list[float]:
    """The speeds ahead (m/s) of the gait diagrams: `SPEEDS`, within the range of training."""
    low, high = policy.command_x
    return sorted({float(np.clip(speed, low, high)) for speed in SPEEDS})


def run(
    policy: Policy,
    seconds: float = SECONDS,
    points: int = POINTS,
    tell: Callable[[int, int], None] = lambda done, total: None,
    player: Player | None = None,
) -> tuple[dict[str, Any], dict[tuple, dict[str, Any]]]:
    """`(numbers, recordings)` of one episode a command; `recordings` by command.

    The grid is vx by vy without turning, and vx by yaw rate without going sideways (`held`); `all`
    is over these, its gait without the command to stand; `standing` is the row of that command, or None
    where it is not in the grid; `slow` is `slow.run`. `tell(done, total)` is called
    at first and after every episode. `player` is the robot; None: the policy's own.
    """
    player = player or policy_source.player(policy)[0]
    act, grid = policy_file.actor(policy.params, policy.activation), axes(policy, points)
    held = {name: float(np.clip(0.0, values[0], values[-1])) for name, values in grid.items()}
    cells = [(x, y, held["wz"]) for x in grid["vx"] for y in grid["vy"]]
    cells += [(x, held["vy"], turn) for x in grid["vx"] for turn in grid["wz"]]
    cells = [tuple(float(v) for v in cell) for cell in dict.fromkeys(cells)]
    ahead = [(speed, held["vy"], held["wz"]) for speed in speeds(policy)]
    every = [*dict.fromkeys([*cells, *ahead])]
    recordings = spread(lambda command: record(player, act, command, seconds), every, tell)
    found = dict(zip(every, recordings, strict=True))
    some = [found[command] for command in cells]
    walks = [r for r in some if np.linalg.norm(r["command"]) > MIN_SPEED]
    fallen = sum(r["fall"] is not None for r in some)
    stands = [r for r in some if not r["command"].any()]
    numbers = {
        "seconds": seconds,
        "axes": {name: values.tolist() for name, values in grid.items()},
        "held": {name: held[name] for name in ("vy", "wz")},
        "all": {"episodes": len(some), "falls": fallen} | moved(player, some, walks),
        "standing": _told(stands[0]) | moved(player, stands, stands) if stands else None,
        "ahead": [
            _told(r) | moved(player, [r], [r]) for r in (found[command] for command in ahead)
        ],
        "commands": [_told(r) | measures(player, [r]) for r in some],
        "slow": slow.run(player),
    }
    return numbers, found


def _told(recording: dict[str, Any]) -> dict[str, Any]:
    return {"command": recording["command"].tolist(), "fall": recording["fall"]}

"""Measures a policy under each command of a grid: tracking, effort and gait, in C MuJoCo and NumPy.

With every contact, a solver that converges, no noise, and one episode for each command. Definitions,
over the time after the first second and before a fall:

- `tracking_error`, `yaw_error`: root mean squares of the planar velocity and of the yaw rate, as in
  `dynappo/scores.py`;
- `speed`: length of the mean planar velocity in the base frame;
- `power`: sum over the joints of |torque x speed|; `positive_power` counts only what the motors give
  (torque and speed of one sign), as if braking cost nothing;
- `cost_of_transport`: power / (weight x speed), without commands where it is slower than 0.1 m/s;
- `torque`: mean over joints of |torque|; `action_rate`: root mean square over joints of the speed at
  which the policy moves the joints' targets;
- `duty_factor`: share of time a foot is on the ground; `air_time`: mean duration of its swings;
  `stride_frequency`: touch-downs a second. Contacts and swings shorter than a control step are
  bounces and do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np

from dynappo.physics import actuators
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, source
from dynappo.policy.episode import SETTLE, Body
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import observe

SECONDS = 6.0  # of an episode
POINTS = 5  # of a command's range
SPEEDS = (0.5, 1.0)  # m/s ahead, at which the gait is looked at
MIN_SPEED = 0.1  # m/s, from which on something is transported


def record(body: Body, act: Callable, command, seconds: float = SECONDS) -> dict[str, Any]:
    """An episode under one `command` (vx, vy, yaw rate), until it ends or the robot falls.

    A row a control step: `velocity [T, 3]` (as the command, in the base frame), `action [T, A]` and
    `qpos [T, nq]` after it. A row a physics step: `torque [P, A]` (N m), `speed [P, A]` (rad/s) at
    which it was applied, and `contact [P, F]`, whether a foot touches the ground. `fall` (s), or None.
    A blow-up of the physics is a fall, and its step has no rows.
    """
    mujoco.set_mju_user_warning(lambda message: None)  # else they go into a file in the folder
    data, dt = mujoco.MjData(body.model), episode_lib.period(body)
    com, action = body.model.body_ipos[body.base_body], np.zeros(len(body.policy.joint_names))
    joints, feet = len(action), np.arange(len(body.foot_names))
    widths = dict(velocity=3, action=joints, qpos=body.model.nq)
    widths |= dict(torque=joints, speed=joints, contact=len(feet))
    rows: dict[str, list] = {name: [] for name in widths}
    p, command, fall = body.policy, np.asarray(command, float), None
    see = observe.memory(p.observation, p.history)
    episode_lib.reset(body, data)
    for k in range(round(seconds / dt)):
        action = act(see(episode_lib.look(body, data, command, action)))
        target = actuators.target(action, p.default_pose, p.action_scale)
        fell, inside = False, []
        for _ in range(body.substeps):
            torque, speed, down = episode_lib.physics_step(body, data, target)
            fell |= down
            pairs = data.contact.geom[data.contact.dist < 0]
            touched = pairs[body.ground[pairs].any(1)]
            inside.append((torque, speed, np.isin(feet, body.foot_of[touched])))
        finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
        if finite:
            coordinates = episode_lib.coordinates(body, data)
            _, linear, angular = observe.base_motion(*coordinates, com)
            rows["velocity"].append([linear[0], linear[1], angular[2]])
            rows["action"].append(action)
            rows["qpos"].append(data.qpos.copy())
            for row in inside:
                for name, values in zip(("torque", "speed", "contact"), row, strict=True):
                    rows[name].append(values)
        if fell or not finite:
            fall = (k + 1) * dt
            break
    columns = {name: np.reshape(rows[name], (-1, width)) for name, width in widths.items()}
    return columns | {"command": command, "fall": fall}


def measured_rows(body: Body, recording: dict[str, Any]) -> dict[str, np.ndarray]:
    """The rows that count: after the first second, before the control step of a fall.

    `change [T, A]` (rad/s) is the speed of the joints' targets, from the action before each row.
    """
    dt, first = episode_lib.period(body), round(SETTLE / episode_lib.period(body))
    last = len(recording["velocity"])
    if recording["fall"] is not None:
        last = min(last, round(recording["fall"] / dt) - 1)
    last = max(first, last)
    fine = slice(first * body.substeps, last * body.substeps)
    cut = {name: recording[name][fine] for name in ("torque", "speed", "contact")}
    targets = body.policy.action_scale * recording["action"]
    change = np.diff(targets, axis=0, prepend=0 * targets[:1]) / dt
    velocity = recording["velocity"][first:last]
    error = velocity - recording["command"]
    return cut | {"velocity": velocity, "error": error, "change": change[first:last]}


def measures(body: Body, recordings: Iterable[dict[str, Any]]) -> dict[str, float | None]:
    """Measures over several episodes together; None where one cannot be computed."""
    parts = [part for r in recordings if len((part := measured_rows(body, r))["velocity"])]
    names = "tracking_error yaw_error speed power positive_power torque action_rate"
    if not parts:
        return dict.fromkeys([*names.split(), "cost_of_transport", "positive_cost_of_transport"])
    weight = body.model.body_subtreemass[body.base_body] * np.linalg.norm(body.model.opt.gravity)
    steps = np.array([len(part["velocity"]) for part in parts])
    speed = np.array([np.linalg.norm(part["velocity"][:, :2].mean(0)) for part in parts])
    power = [part["torque"] * part["speed"] for part in parts]  # [P, A] each
    watts = np.array([np.abs(p).sum(-1).mean() for p in power])
    positive = np.array([np.clip(p, 0, None).sum(-1).mean() for p in power])
    error, change, torque = (
        np.concatenate([part[name] for part in parts]) for name in ("error", "change", "torque")
    )
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
        "action_rate": float(np.sqrt((change**2).mean())),
        "cost_of_transport": cost(watts),
        "positive_cost_of_transport": cost(positive),
    }


def strides(contact: np.ndarray, brief: int) -> tuple[np.ndarray, np.ndarray]:
    """`(swings, touchdowns)` of one foot's `contact [P]`: their lengths, and when each step begins.

    A contact or a swing of fewer than `brief` rows is a bounce: it belongs to what is around it.
    Swings that the recording cuts are left out.
    """
    on, off = intervals(contact)
    cut = (on == 0) | (off == len(contact))
    on, off = on[cut | (off - on >= brief)], off[cut | (off - on >= brief)]
    swings = on[1:] - off[:-1]
    real = swings >= brief
    first = on[:1][on[:1] > 0]  # the end of a swing that had begun before
    return swings[real], np.concatenate([first, on[1:][real]])


def intervals(contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(first rows, rows after the last)` of the stretches of `contact [P]` that are True."""
    edges = np.diff(np.concatenate([[0], contact.astype(int), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def gait(body: Body, recordings: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """How the feet move: `duty_factor`, `air_time`, `stride_frequency`, and these of each foot."""
    contacts = [c for r in recordings if len(c := measured_rows(body, r)["contact"])]
    timestep, each = body.model.opt.timestep, {}
    for j, name in enumerate(body.foot_names):
        found = [strides(c[:, j], body.substeps) for c in contacts]
        swings = np.concatenate([np.zeros(0), *[swing for swing, _ in found]])
        steps = [begins for _, begins in found if len(begins) > 1]
        lasted = sum(int(begins[-1] - begins[0]) for begins in steps) * timestep
        count = sum(len(begins) - 1 for begins in steps)
        down = np.concatenate([c[:, j] for c in contacts]) if contacts else None
        each[name] = {
            "duty_factor": None if down is None else float(down.mean()),
            "air_time": float(swings.mean() * timestep) if len(swings) else None,
            "stride_frequency": count / lasted if count else None,
        }
    mean = {name: _mean(foot[name] for foot in each.values()) for name in [*each.values()][0]}
    return mean | {"feet": each}


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def axes(policy: Policy, points: int = POINTS) -> dict[str, np.ndarray]:
    """The commands of the grid on each axis, over the range that was trained."""
    ranges = {"vx": policy.command_x, "vy": policy.command_y, "wz": policy.command_yaw}
    return {
        name: np.unique(np.round(np.linspace(low, high, points), 6))
        for name, (low, high) in ranges.items()
    }


def speeds(policy: Policy) -> list[float]:
    """The speeds ahead (m/s) of the gait diagrams: `SPEEDS`, as far as they were trained."""
    low, high = policy.command_x
    return sorted({float(np.clip(speed, low, high)) for speed in SPEEDS})


def run(
    policy: Policy,
    seconds: float = SECONDS,
    points: int = POINTS,
    tell: Callable[[int, int], None] = lambda done, total: None,
    body: Body | None = None,
) -> tuple[dict[str, Any], dict[tuple, dict[str, Any]]]:
    """`(numbers, recordings)` of one episode a command; `recordings` by command.

    The grid is vx by vy without turning, and vx by yaw rate without going sideways (`held`); `all`
    is over these, its gait without the command to stand. `tell(done, total)` is called before every
    episode, and at the end. `body` is the robot; None: the policy's own.
    """
    body = body or source.body(policy)[0]
    act, grid = policy_file.actor(policy.params, policy.activation), axes(policy, points)
    held = {name: float(np.clip(0.0, values[0], values[-1])) for name, values in grid.items()}
    cells = [(x, y, held["wz"]) for x in grid["vx"] for y in grid["vy"]]
    cells += [(x, held["vy"], turn) for x in grid["vx"] for turn in grid["wz"]]
    cells = [tuple(float(v) for v in cell) for cell in dict.fromkeys(cells)]
    ahead = [(speed, held["vy"], held["wz"]) for speed in speeds(policy)]
    every, found = [*dict.fromkeys([*cells, *ahead])], {}
    for command in every:
        tell(len(found), len(every))
        found[command] = record(body, act, command, seconds)
    tell(len(every), len(every))
    some = [found[command] for command in cells]
    walks = [r for r in some if np.linalg.norm(r["command"]) > MIN_SPEED]
    fallen = sum(r["fall"] is not None for r in some)
    numbers = {
        "seconds": seconds,
        "axes": {name: values.tolist() for name, values in grid.items()},
        "held": {name: held[name] for name in ("vy", "wz")},
        "all": {"episodes": len(some), "falls": fallen} | measures(body, some) | gait(body, walks),
        "ahead": [_row(body, found[command]) | gait(body, [found[command]]) for command in ahead],
        "commands": [_row(body, r) for r in some],
    }
    return numbers, found


def _row(body: Body, recording: dict[str, Any]) -> dict[str, Any]:
    command, fall = recording["command"].tolist(), recording["fall"]
    return {"command": command, "fall": fall} | measures(body, [recording])

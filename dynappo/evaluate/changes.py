"""Measures whether a robot falls when its command changes, in C MuJoCo and NumPy.

`run` makes `NUMBER` changes of command. A walk is a first command and `PER_WALK` changes, each after `EVERY`
seconds, to a command drawn uniformly from the ranges of training. A robot that falls is put on its feet at
once and goes on with the same command, as on the live page, so every change takes place. A change counts as
a fall if the robot falls before the next one. Falls under the first command of a walk count apart
(`start_falls`).

`tours` plays the tours that the film and the live page show.

A blow-up of the physics is a fall.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from dynappo.evaluate.spread import spread
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy

NUMBER, PER_WALK = 200, 8
EVERY = (2.0, 3.0)  # s between two changes, uniform: so a change comes at any moment of a stride
ROUNDS = 2  # of the live page's tour, which has no end


def falls(player: Player, act: Callable, command: Callable, seconds: float) -> list[float]:
    """Times (s) of the robot's falls in `seconds` from standing; after each it stands up and goes on.

    `act(obs)` is the policy, `command(t)` its command, whose time goes on through falls. The time of a
    fall is the end of its control step.
    """
    dt, data = episode_lib.period(player), mujoco.MjData(player.model)
    steps, done, found = round(seconds / dt), 0, []
    while done < steps:
        stood_up = done * dt
        rows = episode_lib.rows(player, data, act, lambda t, since=stood_up: command(since + t))
        try:
            for row in itertools.islice(rows, steps - done):
                done += 1
                if row["fell"]:
                    found.append(done * dt)
                    break
        except FloatingPointError:
            done += 1
            found.append(done * dt)
    return found


def script(policy: Policy, dt: float, changes: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """A walk: `(times [C + 2], commands [C + 1, 3])`; command i is from times[i] to times[i + 1] (s)."""
    ranges = np.array([policy.command_x, policy.command_y, policy.command_yaw])
    commands = rng.uniform(*ranges.T, (PER_WALK + 1, 3))
    steps = np.round(rng.uniform(*EVERY, PER_WALK + 1) / dt)  # whole control steps
    times = np.concatenate([[0.0], np.cumsum(steps)]) * dt
    return times[: changes + 2], commands[: changes + 1]


def run(
    player: Player,
    number: int = NUMBER,
    seed: int = 0,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Make `number` changes of command: the number of `falls`, and a description of each in `fell`.

    `fell` has the command before, the new one (m/s, m/s, rad/s), and the time from the change to the fall
    (s). Equal seeds give equal results; with more changes, the first are the same. At first
    and after each walk `tell(done, total)` gets the number of changes.
    """
    policy, dt = player.policy, episode_lib.period(player)
    act = policy_file.actor(policy.params, policy.activation)
    walks = -(-number // PER_WALK)

    def walked(walk):
        """Whether it fell under the first command, and a description of each fall after a change."""
        changes = min(PER_WALK, number - walk * PER_WALK)
        times, commands = script(policy, dt, changes, np.random.default_rng([seed, walk]))

        def now(t):
            return int(np.searchsorted(times[1:-1], t + dt / 2, "right"))

        found: dict[int, float] = {}  # command that the robot fell under -> when first
        for t in falls(player, act, lambda t: commands[now(t)], times[-1]):
            found.setdefault(now(t - dt), t)  # it ends a step that began under its command
        at_start = found.pop(0, None) is not None
        return at_start, [
            {"before": commands[i - 1].tolist(), "command": commands[i].tolist()}
            | {"after": float(t - times[i])}
            for i, t in found.items()
        ]

    def told(done, _):
        tell(min(done * PER_WALK, number), number)

    every = spread(walked, range(walks), told)
    fell = [one for _, some in every for one in some]
    at_start = sum(first for first, _ in every)
    about = {"changes": number, "falls": len(fell), "walks": walks, "start_falls": at_start}
    return about | {"every": list(EVERY), "seed": seed, "fell": fell}


def tours(player: Player) -> list[dict[str, Any]]:
    """Play the tour of `play`'s film, and that of the live page, which repeats: when the robot `fell_at` (s).

    Both keep commands within the ranges of training. `fell_at` is empty if the robot never falls.
    """
    policy = player.policy
    act = policy_file.actor(policy.params, policy.activation)
    ranges = policy.command_x, policy.command_y, policy.command_yaw
    film, page = (
        episode_lib.tour(length, ranges)
        for length in (episode_lib.FILM_SECONDS, episode_lib.PAGE_SECONDS)
    )
    seconds = ROUNDS * episode_lib.PAGE_SECONDS
    round_and_round = lambda t: page(t % episode_lib.PAGE_SECONDS)  # noqa: E731
    both = (film, episode_lib.FILM_SECONDS), (round_and_round, seconds)
    for_film, for_page = spread(lambda one: falls(player, act, *one), both)
    return [
        {
            "tour": "film",
            "seconds": episode_lib.FILM_SECONDS,
            "fell_at": for_film[:1],
        },  # then it lies
        {"tour": "live page", "seconds": seconds, "fell_at": for_page},
    ]

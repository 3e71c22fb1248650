"""Records a robot in C MuJoCo as its controller would: a log to learn from (tasks/velocity/log_file.py).

The robot is told a command, drawn uniformly from the ranges of training, and after `changes.EVERY` seconds
another. One that falls is put on its feet, and the log goes on after a gap. Readings are exact, unless
`observed` disturbs them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo.config import ConfigError, versions
from dynappo.evaluate import changes, foot_motion
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import Player
from dynappo.tasks.velocity import log_file, observe

GAP = 1.0  # s, in which a robot is put on its feet


def check(player: Player) -> None:
    """ConfigError for a policy that sees what no log tells."""
    policy = player.policy
    seen = {
        "a height scan": policy.scan != "none",
        "a gait clock": policy.gait_frequency is not None,
        "quantities of one's own": bool(policy.own),
    }
    for what in (name for name, there in seen.items() if there):
        raise ConfigError(
            f"--record: {policy.robot}'s policy sees {what}, which a log does not hold; expected one without"
        )


def record(
    player: Player,
    seconds: float,
    exploration: float = 0.0,
    sensors: float = 0.0,
    seed: int = 0,
    strength: float = 1.0,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, np.ndarray]:
    """The arrays of a log of `seconds` of control steps.

    `exploration` is the standard deviation of the noise on each action, in units of the action; `sensors` is
    the half width of the noise on readings, times that of training. `strength`: as in episode.step.
    """
    policy, dt = player.policy, episode_lib.period(player)
    mean, data = policy_file.actor(policy.params, policy.activation), mujoco.MjData(player.model)
    rng, joints = np.random.default_rng((seed, 2)), len(policy.joint_names)
    parts = observe.slices(joints, observe.has_clock(policy.observation))
    noise = policy.config.get("task", {}).get("noise", {})
    scale = sensors * np.concatenate(
        [
            np.full(part.stop - part.start, noise.get(observe.QUANTITIES[name].noise, 0.0))
            for name, part in parts.items()
        ]
    )
    ranges = np.array([policy.command_x, policy.command_y, policy.command_yaw])
    total, entries = round(seconds / dt), []
    wanted, until, now = np.zeros(3), 0, 0.0  # until: a number of control steps

    def command(t):
        nonlocal wanted, until
        if len(entries) >= until:
            wanted = rng.uniform(*ranges.T)
            until = len(entries) + round(rng.uniform(*changes.EVERY) / dt)
        return wanted

    def sensed(k, told, last_action):
        obs = episode_lib.look(player, data, told, last_action)
        return obs + rng.uniform(-1, 1, len(obs)) * scale

    def entry(obs, action, fell):
        contact, _, _ = foot_motion.at_ground(player, data)
        seen = {name: obs[parts[name]] for name in log_file.SEEN}
        return seen | dict(action=action, time=now, fell=fell, contact=contact)

    def observed(k, told, last_action, kept):
        obs = sensed(k, told, last_action)
        entries.append(entry(obs, None, False))
        return obs

    def act(obs):
        action = mean(obs) + exploration * rng.standard_normal(joints)
        entries[-1]["action"] = action
        return action

    while len(entries) < total:
        tell(len(entries), total)
        rows = episode_lib.rows(player, data, act, command, observed, strength=strength)
        try:
            for row in rows:
                now += dt
                if row["fell"] or len(entries) >= total:
                    obs = sensed(0, wanted, row["action"])
                    entries.append(entry(obs, np.zeros(joints), row["fell"]))
                    break
        except FloatingPointError:  # its last entry is that of no row
            now += dt
        now += GAP
    tell(total, total)
    arrays = {name: np.stack([one[name] for one in entries]) for name in entries[0]}
    small = {
        n: x.astype(np.float32) for n, x in arrays.items() if n != "time" and x.dtype.kind == "f"
    }
    return arrays | small


def about(player: Player) -> dict[str, Any]:
    """What a log says of its robot."""
    policy = player.policy
    facts = {name: getattr(policy, name) for name in ("robot", "observation", *log_file.OF_POLICY)}
    listed = {n: x.tolist() if isinstance(x, np.ndarray) else x for n, x in facts.items()}
    more = dict(control_dt=policy.timestep * policy.substeps, foot_names=player.foot_names)
    return listed | more | {"dynappo": versions.of("dynappo")}


def save(path: Path, player: Player, arrays: dict[str, np.ndarray]) -> None:
    """Write what was recorded."""
    log_file.save(path, about(player), arrays)

"""Plays a policy of another package's environment (`config.env`): a film, a picture or a page."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynappo.config import ConfigError
from dynappo.page import episode_page
from dynappo.play import film
from dynappo.play.command_script import Commands, outside
from dynappo.policy import task_player
from dynappo.policy.policy_file import Other
from dynappo.policy.task_player import TaskPlayer

SECONDS = 12.0  # of a film
SETTLE = 1.0  # s, left out of errors


def check(policy: Other, flags) -> None:
    """ConfigError for flags that only robots have, and for an environment that cannot be drawn."""
    env = policy.config.env
    task_player.check(env)
    if flags.serve is None and flags.out is None:
        raise ConfigError(
            f"the policy is of {env}, which MuJoCo's viewer does not show: --serve opens it in a browser, "
            "--out=FILE.html, .mp4, .gif or .png writes it"
        )
    if flags.command is not None and env.startswith("brax:"):  # of Playground's only some have none
        raise ConfigError(f"--command: {env} has no command to follow")
    for name in ("keep_joints", "ground"):
        if getattr(flags, name):
            raise ConfigError(
                f"--{name.replace('_', '-')}: {env} has a robot and a ground of its own"
            )


def acts(policy: Other, player: TaskPlayer, flags, named: str) -> tuple[Any, str]:
    """`(act, text)`: the policy, or what `--policy` says."""
    if flags.policy == "zero":
        return task_player.still(player), "zero actions"
    if flags.policy == "random":
        return task_player.at_random(player, flags.seed), f"random actions, seed {flags.seed}"
    return task_player.actor(player, policy), named


def command_ranges(player: TaskPlayer) -> np.ndarray:
    """The ranges of the task's command; ConfigError where it asks for none, and so may not `--command`."""
    if player.ranges is None:
        raise ConfigError(f"--command: {player.env} has no command to follow")
    return player.ranges


def run(policy: Other, named: str, flags, commands: Commands | None) -> None:
    """Record an episode, and write and print what `flags` ask for; without `commands` it has its own."""
    env, out = policy.config.env, flags.out
    print(f"dynappo plays {env}: {flags.policy or named}; it starts in half a minute", flush=True)
    with task_player.playing(env) as player:
        act, told = acts(policy, player, flags, named)
        print(player.about)
        if commands is not None:
            note = outside(command_ranges(player), commands)
            print(note, end="\n" * bool(note))
        seconds = flags.seconds or (commands.seconds if commands else SECONDS)
        at = commands.at if commands else None
        episode = task_player.episode(player, act, seconds, at, flags.seed)
        rows = table(player, episode)
    if out.suffix == ".html":
        episode_page.write(player, episode, out, env, told, rows)
    else:
        with task_player.shown(player) as shown:
            problem = film.write(shown, episode, out, flags.size)
        if problem:
            raise ConfigError(
                f"--out={out}: {problem}; a page needs neither: --out={out.stem}.html"
            )
    rows.append(("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB)"))
    for name, text in rows:
        print(f"{name:18s} {text}")


def table(player: TaskPlayer, episode: dict) -> list[tuple[str, str]]:
    """The measures of an episode as (name, value), for printing."""
    seconds = len(episode["qpos"]) * player.dt
    rows = [
        ("played", f"{seconds:.1f} s"),
        ("return", f"{episode['reward'].sum():.2f}"),
        ("fall", f"after {seconds:.1f} s" if episode["fell"].any() else "none"),
    ]
    error = (episode["velocity"] - episode["command"])[round(SETTLE / player.dt) :]
    if player.ranges is not None and len(error):
        planar, yaw = np.sqrt((error[:, :2] ** 2).sum(1).mean()), np.sqrt((error[:, 2] ** 2).mean())
        rows += [("tracking error", f"{planar:.2f} m/s"), ("yaw rate error", f"{yaw:.2f} rad/s")]
    return rows

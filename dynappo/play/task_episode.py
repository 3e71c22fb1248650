"""Plays a policy of another package's environment (`config.env`): a film, a picture or a page of an episode.

The episode is recorded by evaluate/record.py, in a process of its own, because such a task needs JAX.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.page import episode_page
from dynappo.policy import recorded, render
from dynappo.policy.policy_file import Other

SECONDS = 12.0  # of a film


class Drawn(NamedTuple):
    """What a page draws."""

    model: mujoco.MjModel
    base_body: int
    ground: np.ndarray  # [ngeom] bool: fixed to the world


def check(policy: Other, flags) -> None:
    """ConfigError for flags that only robots have."""
    env = policy.config.env
    if flags.serve is not None or flags.out is None:
        raise ConfigError(
            f"the policy is of {env}: neither the live page nor the viewer shows it, whose robots move in C "
            "MuJoCo while the task needs MJX; it is played into a file: "
            "--out=FILE.html, .mp4, .gif or .png"
        )
    for name in ("command", "keep_joints"):
        if getattr(flags, name):
            raise ConfigError(
                f"--{name.replace('_', '-')}: {env} has commands and a robot of its own"
            )


def run(policy: Other, path: Path, flags, named: str) -> None:
    """Record an episode, and write and print what `flags` ask for."""
    acts, out = flags.policy or "policy", flags.out
    told = {"policy": named, "zero": "zero actions", "random": f"random actions, seed {flags.seed}"}
    print(
        f"dynappo plays {policy.config.env}: {told[acts]}; it compiles first, a minute or two",
        flush=True,
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "episode.npz"
        status = recorded.episode(path, file, flags.seed, acts, flags.seconds or SECONDS)
        if status:
            sys.exit(status)  # it has said why
        episode: dict[str, Any] = dict(np.load(file))
        base, seconds = int(episode["base"]), len(episode["qpos"]) * float(episode["dt"])
        fell = np.flatnonzero(episode["fell"])
        rows = [
            ("played", f"{seconds:.1f} s"),
            ("return", f"{episode['reward'].sum():.2f}"),
            ("fall", f"after {seconds:.1f} s" if len(fell) else "none"),
        ]
        if out.suffix == ".html":
            model = mujoco.MjModel.from_binary_path(str(file.with_suffix(".mjb")))
            ground = model.body_weldid[model.geom_bodyid] == 0
            heading = policy.config.env
            episode_page.write(Drawn(model, base, ground), episode, out, heading, told[acts], rows)
        else:
            shown = render.Shown(file.with_suffix(".mjb"), "", base)
            problem = render.film(shown, episode, out, flags.size)
            if problem:
                raise ConfigError(
                    f"--out={out}: {problem}; a page needs neither: --out={out.stem}.html"
                )
    rows.append(("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB)"))
    for name, text in rows:
        print(f"{name:18s} {text}")

"""Finds the policy that a name means: a bundled one, a workdir, a checkpoint or a file."""

from __future__ import annotations

import os
from pathlib import Path

from dynappo.config import ConfigError, files
from dynappo.policy import checkpoint_file, policy_file


def locate(text: str, seed: int | None = None) -> Path:
    """The policy.npz or checkpoint folder that a name, a workdir or a path means.

    `go1` is the bundled policy, `go1_deploy` the one for hardware, `./go1` a folder. In a workdir it
    is the policy.npz, or, while the run trains, the newest checkpoint. With a `seed` it is a
    checkpoint: only checkpoints hold all seeds.
    """
    path = _bundled(text) if text in files.bundled() else Path(text)
    if os.path.isfile(path):  # False, not an error, if the name is too long
        if seed is not None:
            raise ConfigError(
                f"--run-seed={seed}: {path} holds one policy; name the workdir of a run, or a checkpoint"
            )
        return path
    if not os.path.isdir(path):
        raise ConfigError(
            f"{text}: no such file or folder; expected a workdir, a checkpoint, a policy.npz or one "
            f"of {', '.join(files.robots())} (or ROBOT_deploy)"
        )
    if seed is None and (path / "policy.npz").is_file():
        return path / "policy.npz"
    if (path / checkpoint_file.STATE).is_dir():
        return path
    folder = path / "checkpoints" if (path / "checkpoints").is_dir() else path
    saved = checkpoint_file.iterations(folder)
    if not saved:
        lacks = "neither a policy.npz nor checkpoints/" if seed is None else "no checkpoints/"
        raise ConfigError(f"{text}: holds {lacks}")
    return folder / str(saved[0])


def _bundled(name: str) -> Path:
    if name not in files.robots():
        name = f"{name.removesuffix('_deploy')}/deploy"
        return files.find("robots", f"{name}.npz") or Path(f"{name}.npz")
    path = files.find("robots", f"{name}/policy.npz")
    if path is None:
        raise ConfigError(
            f"{name}: no policy is bundled with this robot (robots/{name}/policy.npz); "
            "train one, or see the robot with --policy=zero or --policy=random"
        )
    return path


def find(text: str, seed: int | None = None) -> tuple[policy_file.Policy, Path]:
    """`(policy, path)` of what `text` means (see `locate`), of several seeds number `seed`."""
    path = locate(text, seed)
    return (
        policy_file.load_checkpoint(path, seed) if path.is_dir() else policy_file.load(path)
    ), path

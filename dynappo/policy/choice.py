"""The flags that choose policy and robot, shared by `play`, `evaluate` and `export`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from dynappo.config import ConfigError
from dynappo.config import flags as flags_lib
from dynappo.physics import robot as robot_lib
from dynappo.policy import carried, source
from dynappo.policy import episode as episode_lib
from dynappo.policy.policy_file import Policy

WHAT = "workdir, checkpoint, policy.npz or robot"


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Add the policy's name, `--run-seed` and `--robot-xml`."""
    parser.add_argument("what", nargs="?", metavar="NAME_OR_DIR", help=WHAT)
    parser.add_argument(
        "--run-seed",
        metavar="K|best",
        default="best",
        help="of a run of several seeds: number K, 0 to run.num_seeds - 1, or the best in the last "
        "evaluation (the first if there was none); default: best",
    )
    parser.add_argument(
        "--robot-xml", metavar="FILE", help="another MJCF with the same joint names"
    )


def check(flags: argparse.Namespace) -> None:
    """Make `flags.run_seed` a number, or None for the best; ConfigError if it is neither."""
    if flags.run_seed == "best":
        flags.run_seed = None
        return
    try:
        flags.run_seed = flags_lib.whole("run-seed", flags.run_seed, 0)
    except ConfigError as error:
        raise ConfigError(f"{error}; or best") from None


def find(flags: argparse.Namespace) -> tuple[Policy, Path, str]:
    """`(policy, path, text)` of the flags; `text` names the file and the seed, for printing."""
    policy, path = source.find(flags.what, flags.run_seed)
    text = "/".join(path.resolve().parts[-2:])
    run = policy.config.get("run", {})
    seeds = run.get("num_seeds") if isinstance(run, dict) else None
    if policy.seed is not None:
        text += f", seed {policy.seed}" + (f" of 0 to {seeds - 1}" if type(seeds) is int else "")
    return policy, path, text


def robot(policy: Policy, xml: str | None) -> tuple[robot_lib.Robot, str]:
    """`(robot, note)`: the policy's robot, or `--robot-xml`, which must keep the contract."""
    if xml is None:
        return carried.robot(policy)
    return _of_flag(xml, lambda path: robot_lib.load_xml(path)._replace(name=policy.robot)), ""


def body(
    policy: Policy, xml: str | None, keep_joints: bool = False
) -> tuple[episode_lib.Body, str]:
    """`(body, note)` in C MuJoCo, as `robot`; here `--robot-xml` needs only the policy's joints."""
    if xml is None:
        own, note = carried.robot(policy)
        return episode_lib.load(own.xml, policy, policy.timestep, text=own.text), note
    return _of_flag(xml, lambda path: episode_lib.load(path, policy, keep_joints=keep_joints)), ""


def _of_flag(xml: str, load):
    """`load(path)` of `--robot-xml`; errors name the flag."""
    if not os.path.isfile(xml):
        raise ConfigError(f"--robot-xml={xml}: no such file")
    try:
        return load(Path(xml))
    except ConfigError as error:  # its text begins with the path
        raise ConfigError(f"--robot-xml={error}") from None

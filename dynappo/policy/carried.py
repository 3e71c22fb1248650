"""The robot of a policy: the one whose MJCF it carries, or the one of its name in a folder robots/.

A checkpoint and a `policy.npz` carry their robot, so that they can be played anywhere. Where robots/ has
one of the same name that differs, the policy's own is played, and a line says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dynappo.config import ConfigError
from dynappo.physics import robot as robot_lib
from dynappo.physics.robot import Robot
from dynappo.policy.policy_file import Policy


def robot(policy: Policy) -> tuple[Robot, str]:
    """`(robot, note)`: the policy's robot, and a line where the one of its name here is another, or "".

    Where both are the same it is the one here: its file may have looks that cannot be carried.
    """
    if not policy.mjcf:
        return robot_lib.load(policy.robot), ""
    own = robot_lib.load_text(policy.mjcf, policy.robot, Path(f"{policy.robot}.xml"))
    try:
        here = robot_lib.load(policy.robot)
    except ConfigError:  # there is none, or none that can be used
        return own, ""
    if robot_lib.same(own, here):
        return here, ""
    return own, (
        f"note: {here.xml} is another robot than the {policy.robot} that the policy carries; that one is "
        f"used (--robot-xml={here.xml} takes yours)"
    )


def check_same(workdir: Path, about: dict[str, Any], name: str) -> None:
    """ConfigError if robots/NAME is another robot than the one that the run in `workdir` trains.

    `about` is of its newest checkpoint; one from before robots were carried says nothing.
    """
    text = about.get("mjcf", "")
    if not isinstance(text, str) or not text:
        return
    there = robot_lib.load_text(text, name, workdir / "checkpoints")
    here = robot_lib.load(name)
    if not robot_lib.same(there, here):
        raise ConfigError(
            f"--workdir={workdir}: {here.xml} is another robot than the run began with; choose another "
            "folder, --fresh to start over, or put the old file back: dynappo export "
            f"{workdir} --out={name}.xml writes it"
        )

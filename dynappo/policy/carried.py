"""Chooses a policy's robot: the one stored in its file, or the one of that name in robots/.

Checkpoints and `policy.npz` contain their robot's MJCF, so they can be played anywhere. If robots/
has a different robot of the same name, the policy's own is used, and a line says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dynappo.config import ConfigError
from dynappo.physics import robot as robot_lib
from dynappo.physics.robot import Robot
from dynappo.policy.policy_file import Policy


def robot(policy: Policy) -> tuple[Robot, str]:
    """`(robot, note)`: the policy's robot; `note` says if robots/ has a different one, else it is
    "".

    If both are the same, the one in robots/ is returned: its file may have meshes and textures,
    which a policy cannot contain.
    """
    if not policy.mjcf:
        return robot_lib.load(policy.robot), ""
    own = robot_lib.load_text(policy.mjcf, policy.robot, Path(f"{policy.robot}.xml"))
    try:
        here = robot_lib.load(policy.robot)
    except ConfigError:  # there is none, or it cannot be used
        return own, ""
    if robot_lib.same(own, here):
        return here, ""
    return own, (
        f"note: {here.xml} is another robot than the {policy.robot} that the policy carries; that one is "
        f"used (--robot-xml={here.xml} takes yours)"
    )


def check_same(workdir: Path, about: dict[str, Any], name: str) -> None:
    """ConfigError if robots/NAME is a different robot from the one that the run in `workdir`
    trains.

    `about` is that of its newest checkpoint. Old checkpoints that store no robot are not checked.
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

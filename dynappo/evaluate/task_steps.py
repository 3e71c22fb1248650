"""Steps one robot of another package's environment, for policy/task_player.py, which starts this process.

    python -m dynappo.evaluate.task_steps playground:TASK MODEL.mjb

It writes the model, and a line of JSON to stdout when it is ready. Then it answers each `Ask` on stdin with a
`Told`, until stdin ends. A process of its own, because the robot needs JAX and those who play do not.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import BinaryIO

import mujoco
import numpy as np

from dynappo.config import ConfigError, flags
from dynappo.policy import task_player
from dynappo.policy.task_player import Ask, Told
from dynappo.program import devices
from dynappo.tasks import by_name, single


def serve(name: str, model_file: Path, asked: BinaryIO, told: BinaryIO) -> None:
    """Answer until `asked` ends; ConfigError where there is no such robot."""
    # MuJoCo would write warnings to a file in the working directory; what matters is told
    mujoco.set_mju_user_warning(lambda message: None)
    robot = by_name.single(name)
    data, sizes = mujoco.MjData(robot.model), task_player.asks(robot.actions)
    about = {name: getattr(robot, name) for name in task_player.ABOUT}
    about["ranges"] = None if robot.ranges is None else robot.ranges.tolist()
    mujoco.mj_saveModel(robot.model, str(model_file), None)
    _write(told, json.dumps(about).encode() + b"\n")
    state, seen = robot.first(0)
    while len(text := asked.read(8 * sum(sizes.values()))) == 8 * sum(sizes.values()):
        ask = task_player.unpacked(Ask, sizes, text)
        if ask.reset[0]:
            state, seen = robot.first(int(ask.seed[0]))
        else:
            state, seen = robot.step(state, ask.command, ask.push, ask.force, ask.action)
        velocity = _velocity(robot.model, data, seen.qpos, seen.qvel)
        if seen.pose is None:
            seen = seen._replace(pose=np.concatenate([data.xpos, data.xquat], -1))
        _write(told, task_player.packed(Told(velocity=velocity, **seen._asdict())))


def _velocity(model: mujoco.MjModel, data: mujoco.MjData, qpos, qvel) -> np.ndarray:
    """[3] vx, vy (m/s) and yaw rate (rad/s) of the base, in its frame."""
    data.qpos[:], data.qvel[:], found = qpos, qvel, np.zeros(6)
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
        compute(model, data)
    body, base = mujoco.mjtObj.mjOBJ_XBODY, single.base(model)
    mujoco.mj_objectVelocity(model, data, body, base, found, 1)
    return found[[3, 4, 2]]


def _write(file: BinaryIO, content: bytes) -> None:
    file.write(content)
    file.flush()


def main(argv: list[str]) -> None:
    """The process; exit statuses are those of `flags.answer`."""

    def action():
        env, model_file = argv
        # what libraries print must not come between the answers
        told = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
        devices.own_process("cpu")
        try:
            serve(env, Path(model_file), sys.stdin.buffer, told)
        except ConfigError as error:  # who started us says it, in one line
            _write(told, json.dumps({task_player.REFUSED: str(error)}).encode() + b"\n")
            sys.exit(2)

    flags.answer(action)


if __name__ == "__main__":
    main(sys.argv[1:])

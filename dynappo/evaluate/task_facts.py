"""Writes what a robot needs to know of a Playground task beside its policy, for `export`.

    python -m dynappo.evaluate.task_facts POLICY OUT.json

A process of its own, because Playground needs JAX and `export` does not.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import ConfigError, files, flags
from dynappo.policy import policy_file
from dynappo.program import devices


def facts(env: str) -> dict[str, Any]:
    """Of the task `env` = playground:TASK; ConfigError for an environment of another package."""
    package, _, name = env.partition(":")
    if package != "playground":
        raise ConfigError(
            f"{env}: export writes policies of dynappo's robots and Playground's tasks"
        )
    from dynappo.tasks.playground import loading

    task = loading.load(name).task
    model = task.mj_model
    joints = [model.joint(int(i)).name for i in model.actuator_trnid[:, 0]]
    pose, scale = getattr(task, "_default_pose", None), task._config.get("action_scale")
    return {
        "task": env,
        "joint_names": joints,
        "actuator_names": [model.actuator(i).name for i in range(model.nu)],
        "default_pose": None if pose is None else np.asarray(pose, float).tolist(),
        "action_scale": None if scale is None else np.asarray(scale, float).tolist(),
        "control_dt": float(task.dt),
        "timestep": float(task.sim_dt),
        "actuator_gain": model.actuator_gainprm[:, 0].tolist(),
        "actuator_bias": model.actuator_biasprm[:, :3].tolist(),
        "actuator_ctrlrange": model.actuator_ctrlrange.tolist(),
    }


def main(argv: list[str]) -> None:
    """The process; exit statuses are those of `flags.answer`."""

    def action():
        policy = policy_file.load_other(Path(argv[0]))
        if policy is None:
            raise ConfigError(f"{argv[0]}: no policy of another package's environment")
        devices.own_process("cpu")
        files.write_json(Path(argv[1]), facts(policy.config.env))

    flags.answer(action)


if __name__ == "__main__":
    main(sys.argv[1:])

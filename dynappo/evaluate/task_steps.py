"""Steps one robot of a Playground task in C MuJoCo, for policy/task_player.py, which starts this process.

    python -m dynappo.evaluate.task_steps playground:TASK MODEL.mjb

It writes the model, and a line of JSON to stdout when it is ready. Then it answers each `Ask` on stdin with a
`Told`, until stdin ends. A process of its own, because the task needs JAX and those who play do not.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from dynappo.config import ConfigError, flags
from dynappo.policy import task_player
from dynappo.policy.task_player import Ask, Told
from dynappo.program import devices


def serve(name: str, model_file: Path, asked: BinaryIO, told: BinaryIO) -> None:
    """Answer until `asked` ends; ConfigError where there is no such task."""
    import jax
    import jax.numpy as jnp
    import mujoco

    from dynappo.tasks.playground import c_physics, commands, env, loading

    # MuJoCo would write warnings to a file in the working directory; what matters is told
    mujoco.set_mju_user_warning(lambda message: None)
    loaded = loading.load(name)
    task, drawn = loaded.task, loading.drawn(loaded)
    of = env.make(task, random_clock=False)
    assert of.views is not None
    base, columns = int(drawn.jnt_bodyid[0]), of.views.actor
    data, force = mujoco.MjData(task.mj_model), np.zeros((drawn.nbody, 6))

    def first(seed):
        return of.reset(None, None, jax.random.key(seed))

    def step(state, ask):
        if commands.in_info(state.info):
            command = jnp.where(jnp.isnan(ask.command), state.info["command"], ask.command)
            state = state.replace(info=state.info | {"command": command})
        state = state.replace(qvel=state.qvel.at[:3].add(ask.push))
        # the row's command: a task may draw the next one at its end
        asked_for = state.info.get("command", jnp.zeros(3))
        return asked_for, *of.step(None, None, state, ask.action, jax.random.key(0))

    sizes = task_player.asks(of.action_size)
    with c_physics.physics(task, data, force):  # both are traced here
        first = jax.jit(first).lower(np.uint32(0)).compile()
        state = first(np.uint32(0))
        zeros = Ask(*(np.zeros(n, np.float32) for n in sizes.values()))
        step = jax.jit(step).lower(state, zeros).compile()
    ranges = commands.ranges(task, state.info)
    about: dict[str, Any] = {
        "dt": float(of.dt),
        "episode_length": of.episode_length,
        "base": base,
        "joints": [drawn.joint(int(i)).name for i in drawn.actuator_trnid[:, 0]],
        "observed": len(columns),
        "ranges": None if ranges is None else ranges.tolist(),
        "assets": loaded.assets,
    }
    mujoco.mj_saveModel(drawn, str(model_file), None)
    _write(told, json.dumps(about).encode() + b"\n")
    while len(text := asked.read(8 * sum(sizes.values()))) == 8 * sum(sizes.values()):
        ask = task_player.unpacked(Ask, sizes, text)
        force[base, :3] = ask.force
        command, reward, fell, ok = np.zeros(3), 0.0, 0.0, 1.0
        if ask.reset[0]:
            state = first(np.uint32(ask.seed[0]))
        else:
            command, state, outcome = step(state, Ask(*(x.astype(np.float32) for x in ask)))
            reward, fell, ok = outcome.reward, 1.0 - outcome.discount, outcome.valid
        qpos, qvel = np.asarray(state.qpos, float), np.asarray(state.qvel, float)
        moves = np.zeros(3)
        mujoco.mju_rotVecQuat(moves, qvel[:3], qpos[3:7] * [1.0, -1, -1, -1])
        velocity = *moves[:2], qvel[5]
        obs = np.asarray(state.obs)[columns]
        row = Told(obs, qpos, qvel, data.ctrl, command, velocity, reward, fell, ok)
        _write(told, task_player.packed(row))


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
            task_player.check(env)
            serve(env.partition(":")[2], Path(model_file), sys.stdin.buffer, told)
        except ConfigError as error:  # who started us says it, in one line
            _write(told, json.dumps({task_player.REFUSED: str(error)}).encode() + b"\n")
            sys.exit(2)

    flags.answer(action)


if __name__ == "__main__":
    main(sys.argv[1:])

"""One robot of a task in C MuJoCo, a control step at a time; and what a controller needs to know of it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from dynappo.tasks import single as single_lib
from dynappo.tasks.playground import c_physics, commands, env, loading
from dynappo.tasks.single import Seen, Single

HOW = (
    "obs is the task's own observation `state` (or its only one), as its step returns it. action is in "
    "[-1, 1], as its step takes it: in most tasks a motor's target is default_pose + action_scale * action, "
    "in the order of joint_names, rad; in getup tasks the joint's angle takes the place of default_pose. "
    "Observation, noise and reward are in the task's source, in mujoco_playground (`playground`, its version)"
)
UNITS = {"default_pose": "rad", "action_scale": "rad", "control_dt": "s", "timestep": "s"}


def make(name: str) -> Single:
    """The robot of the task `name`; ConfigError where there is no such task. It compiles for ten seconds."""
    loaded = loading.load(name)
    task, drawn = loaded.task, loading.drawn(loaded)
    of = env.make(task, random_clock=False)
    assert of.views is not None
    columns = of.views.actor
    data, forces = mujoco.MjData(task.mj_model), np.zeros((drawn.nbody, 6))

    def first(seed):
        return of.reset(None, None, jax.random.key(seed))

    def step(state, command, push, action):
        if commands.in_info(state.info):
            command = jnp.where(jnp.isnan(command), state.info["command"], command)
            state = state.replace(info=state.info | {"command": command})
        state = state.replace(qvel=state.qvel.at[:3].add(push))
        # the row's command: a task may draw the next one at its end
        asked_for = state.info.get("command", jnp.zeros(3))
        return asked_for, *of.step(None, None, state, action, jax.random.key(0))

    with c_physics.physics(task, data, forces):  # both are traced here
        first = jax.jit(first).lower(np.uint32(0)).compile()
        some = first(np.uint32(0))
        sizes = (3, 3, of.action_size)
        step = jax.jit(step).lower(some, *(np.zeros(n, np.float32) for n in sizes)).compile()

    def seen(state, **told):
        obs = np.asarray(state.obs)[columns]
        return state, Seen(obs, state.qpos, state.qvel, data.ctrl.copy(), **told)

    def stepped(state, command, push, force, action):
        forces[single_lib.base(drawn), :3] = force
        asked = (np.asarray(x, np.float32) for x in (command, push, action))
        command, state, outcome = step(state, *asked)
        told = dict(reward=outcome.reward, fell=1.0 - outcome.discount, ok=outcome.valid)
        return seen(state, command=command, **told)

    return Single(
        model=drawn,
        observed=len(columns),
        actions=of.action_size,
        dt=float(of.dt),
        episode_length=of.episode_length,
        ranges=commands.ranges(task, some.info),
        about=loaded.assets,
        first=lambda seed: seen(first(np.uint32(seed))),
        step=stepped,
    )


def facts(name: str) -> dict[str, Any]:
    """What a controller needs of the task beside a policy (export/task_onnx.py)."""
    task = loading.load(name).task
    model = task.mj_model
    pose, scale = getattr(task, "_default_pose", None), task._config.get("action_scale")
    return {
        "squash": "tanh",
        "joint_names": [model.joint(int(i)).name for i in model.actuator_trnid[:, 0]],
        "actuator_names": [model.actuator(i).name for i in range(model.nu)],
        "default_pose": None if pose is None else np.asarray(pose, float).tolist(),
        "action_scale": None if scale is None else np.asarray(scale, float).tolist(),
        "control_dt": float(task.dt),
        "timestep": float(task.sim_dt),
        "actuator_gain": model.actuator_gainprm[:, 0].tolist(),
        "actuator_bias": model.actuator_biasprm[:, :3].tolist(),
        "actuator_ctrlrange": model.actuator_ctrlrange.tolist(),
        "how": HOW,
        "units": UNITS,
    }

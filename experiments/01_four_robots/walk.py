"""A trained policy walking, on C MuJoCo and on MJX: what the other scripts of this folder share."""

from pathlib import Path

import mujoco
import numpy as np

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.physics import actuators, robot
from dynappo.policy import policy_file
from dynappo.tasks.velocity import observe

ROBOTS = ("go1", "go2", "anymal_c", "anymal_d")


def settings(name: str, variant: str = "ppo16", **fields):
    """The config of a robot, with `physics.FIELD=VALUE` for each of `fields`."""
    config = config_lib.load(f"configs/{name}.py:{variant}")
    config.physics.update(fields)
    return config_lib.validate(config)


def load(name: str, policies: Path | None = None):
    """`(config, robot, params)` of the bundled policy, or of `policies/NAME_ppo16.0.npz`."""
    bundled = files.find("robots", f"{name}/policy.npz")
    path = policies / f"{name}_ppo16.0.npz" if policies else bundled
    policy, config = policy_file.load(path), config_lib.load(f"configs/{name}.py:ppo16")
    config.ppo.activation = policy.activation
    return config_lib.validate(config), robot.load(name), policy.params


def converged(body: robot.Robot, config):
    """The model that trains, for C MuJoCo with a solver that runs until it has converged."""
    model = robot.physics_model(body, config.physics)
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    return model


def look(body: robot.Robot, data, command, last_action):
    """The observation without noise."""
    com = body.mj_model.body_ipos[body.base_body]
    return observe.observe(data.qpos, data.qvel, com, body.default_pose, command, last_action)


def substeps(model, data, body: robot.Robot, config, action):
    """One control step on C MuJoCo; yields `(torque asked for, torque, joint speed)` a substep."""
    task = config.task
    target = actuators.target(action, body.default_pose, task.action_scale)
    for _ in range(config.physics.substeps):
        speed = data.qvel[6:].copy()
        asked = actuators.pd(target, data.qpos[7:], speed, task.kp, task.kd)
        data.ctrl[:] = actuators.clip_dc_motor(
            asked,
            speed,
            effort_limit=task.effort_limit,
            saturation_effort=task.saturation_effort,
            velocity_limit=task.velocity_limit,
        )
        mujoco.mj_step(model, data)
        yield asked, data.ctrl.copy(), speed


def states(body: robot.Robot, config, params, episodes: int, seconds: float, every: int, seed=0):
    """States of walking under random commands: dict of `[K, ...]` arrays, float64.

    One every `every` control steps after the first half second, at another phase in each episode.
    """
    rng = np.random.default_rng(seed)
    model, act = converged(body, config), policy_file.actor(params, config.ppo.activation)
    data, rows = mujoco.MjData(model), []
    for _ in range(episodes):
        command, phase = rng.uniform(-1, 1, 3), rng.integers(every)
        mujoco.mj_resetData(model, data)
        data.qpos[:], action = body.home_qpos, np.zeros(12)
        for k in range(round(seconds / 0.02)):
            if k >= 25 and k % every == phase:
                parts = (data.qpos, data.qvel, data.qacc_warmstart, command, action)
                rows.append([np.array(part) for part in parts])
            action = act(look(body, data, command, action))
            for _ in substeps(model, data, body, config, action):
                pass
    names = ("qpos", "qvel", "qacc_warmstart", "command", "last_action")
    return {n: np.stack(c) for n, c in zip(names, zip(*rows, strict=True), strict=True)}


def nominal(body: robot.Robot, worlds: int):
    """`randomize.Body` of `worlds` robots as the file has them."""
    import jax.numpy as jnp

    from dynappo.physics import randomize

    one = jnp.ones(worlds)
    com = jnp.asarray(body.mj_model.body_ipos[body.base_body], jnp.float32)
    com = jnp.broadcast_to(com, (worlds, 3))
    return randomize.Body(
        mass_scale=one, base_com=com, friction=0.8 * one, kp_scale=one, kd_scale=one
    )


def on_mjx(engine, config, params, steps: int):
    """`walk(bodies, start, actions=None) -> (qpos, qvel, actions)`, each `[steps, K, ...]`, jitted.

    Every robot walks under its policy, or repeats `actions`; `start` is as `states` returns it.
    """
    import jax
    import jax.numpy as jnp

    from dynappo.learner import networks
    from dynappo.physics import engine as engine_lib

    static, hyper = config_lib.split(config)
    body = engine.robot
    default = jnp.asarray(body.default_pose, jnp.float32)
    params = jax.tree.map(jnp.asarray, params)
    observe_all = jax.vmap(observe.observe, (0, 0, 0, None, 0, 0))
    simulate = jax.vmap(engine_lib.simulate, (None, None, 0, 0, 0))

    def walk(bodies, start, actions=None):
        worlds = len(start["qpos"])
        feet, joints = jnp.zeros((worlds, 4), jnp.int32), jnp.zeros((worlds, 12))
        state = engine_lib.Substeps(
            start["qpos"],
            start["qvel"],
            start["qacc_warmstart"],
            *(feet, feet, feet, joints, joints),
            lowest=jnp.zeros((worlds, len(body.parts))),
        )

        def step(carry, action):
            state, last = carry
            if action is None:
                com = bodies.base_com
                obs = observe_all(state.qpos, state.qvel, com, default, start["command"], last)
                action = networks.policy(static, params, obs)
            state = simulate(engine, hyper, bodies, state, action)
            return (state, action), (state.qpos, state.qvel, action)

        return jax.lax.scan(step, (state, start["last_action"]), actions, length=steps)[1]

    return jax.jit(walk)

"""Records an episode of another package's environment, for `play` to draw.

    python -m dynappo.evaluate.record POLICY OUT.npz SEED ACTS SECONDS

OUT.npz has `qpos`, `velocity`, `command` (vx, vy in the base's frame, yaw rate), `fell`, `reward`, `dt` and
`base`, and OUT.mjb is the model. ACTS is policy, zero or random. A process of its own, because the task needs
JAX and `play` does not. The episode has the task's noise, and ends with a fall or the task's length.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dynappo.config import ConfigError, flags
from dynappo.policy import policy_file
from dynappo.program import devices
from dynappo.tasks import by_name


def record(policy: policy_file.Other, out: Path, seed: int, acts: str, seconds: float) -> None:
    """Write both files; ConfigError where the environment has no MuJoCo model."""
    import jax
    import jax.numpy as jnp
    import mujoco

    config = policy.config
    if not config.env.startswith("playground:"):
        raise ConfigError(
            f"{config.env}: no film, no page: only Playground's tasks have a MuJoCo model"
        )
    config.run.update(device="cpu", num_seeds=1, mesh_seed=1, mesh_env=1, eval_envs=0)
    config.rollout.num_envs, config.ppo.shuffle_blocks, config.run.mesh_env = 1, 1, 1
    config.physics.impl = "jax"
    devices.own_process("cpu")
    by_name.check(config)
    env, model = by_name.with_model(config)
    act = policy_file.actor(policy.params, config.ppo.activation)
    columns = slice(None) if env.views is None else env.views.actor
    step = jax.jit(lambda state, action, key: env.step(None, None, state, action, key))
    state = jax.jit(lambda key: env.reset(None, None, key))(jax.random.key(seed))
    draw, rows = np.random.default_rng(seed), []
    for _ in range(min(round(seconds / env.dt), env.episode_length)):
        action = {"policy": act, "zero": lambda obs: np.zeros(env.action_size)}.get(
            acts, lambda obs: draw.normal(size=env.action_size)
        )(np.asarray(state.obs)[columns])
        command = np.asarray(state.info.get("command", np.zeros(3)), float)
        state, outcome = step(state, jnp.asarray(action, jnp.float32), jax.random.key(0))
        fell = float(outcome.discount) == 0
        qpos, qvel = np.array(state.qpos), np.array(state.qvel)
        moves = np.zeros(3)
        mujoco.mju_rotVecQuat(moves, qvel[:3].astype(float), qpos[3:7] * [1.0, -1, -1, -1])
        rows.append((qpos, [*moves[:2], qvel[5]], command[:3], fell, float(outcome.reward)))
        if fell:
            break
    names = "qpos", "velocity", "command", "fell", "reward"
    episode = {name: np.array(x) for name, x in zip(names, zip(*rows, strict=True), strict=True)}
    base = int(model.jnt_bodyid[0])
    arrays: dict = episode | {"dt": env.dt, "base": base}
    np.savez(out, **arrays)
    mujoco.mj_saveModel(model, str(out.with_suffix(".mjb")), None)


def main(argv: list[str]) -> None:
    """The process; exit statuses are those of `flags.answer`."""

    def action():
        policy = policy_file.load_other(Path(argv[0]))
        if policy is None:
            raise ConfigError(f"{argv[0]}: no policy of another package's environment")
        record(policy, Path(argv[1]), int(argv[2]), argv[3], float(argv[4]))

    flags.answer(action)


if __name__ == "__main__":
    main(sys.argv[1:])

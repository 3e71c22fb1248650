"""brax's environments by their names, on its spring physics: trained, looked at, and what a controller needs.

brax's System keeps the MuJoCo model that it was read from, and its links are that model's bodies. They are
drawn where brax has them. Joints of these physics are springs: under load limbs part by some centimetres, and
the positions q of the joints put them up to a tenth of a metre elsewhere. Order and frames of q and of the
velocities qd are MuJoCo's.
"""

from __future__ import annotations

import copy
import functools
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax import envs

from dynappo.config import ConfigError
from dynappo.description import mjcf
from dynappo.tasks import brax_env
from dynappo.tasks import single as single_lib
from dynappo.tasks.single import Seen, Single
from dynappo.types import Env

BACKEND = "spring"
WORLD = [[0.0, 0, 0, 1, 0, 0, 0]]  # the pose of MuJoCo's first body, which is no link
HOW = (
    "obs is the environment's own observation, as its step returns it. action is in [-1, 1], as its step "
    "takes it, in the order of actuator_names. What they mean is in the environment's source, brax/envs"
)
UNITS = {"control_dt": "s", "timestep": "s"}


@functools.cache
def bare(name: str) -> envs.Env:
    """brax's own object; ConfigError for an environment that is not for these physics."""
    try:
        with mjcf.without_warnings():  # brax's files have what MuJoCo warns of
            return envs.get_environment(name, backend=BACKEND)
    except ValueError as error:
        raise ConfigError(
            f"brax:{name} cannot be trained: brax has it on other physics than {BACKEND} alone ({error})"
        ) from None


def make(name: str, episode_length: int, random_clock: bool) -> Env:
    """The `Env`; all of its observation is predicted."""
    env = bare(name)
    return brax_env.from_brax(env, env.observation_size, episode_length, random_clock=random_clock)


def model(name: str) -> mujoco.MjModel:
    """What is drawn, with brax's motors; ConfigError for an environment that brax made without MuJoCo."""
    system = getattr(bare(name), "sys", None)
    if system is None or system.mj_model is None:
        raise ConfigError(f"brax:{name}: no film, no page, no ONNX: it has no MuJoCo model")
    found = copy.copy(system.mj_model)
    found.actuator_gear[:, 0] = system.actuator.gear
    return found


def single(name: str) -> Single:
    """The robot of `brax:NAME`, on brax's physics. It compiles for ten seconds."""
    drawn, env = model(name), bare(name)
    of = brax_env.from_brax(env, random_clock=False, starts=1)
    data = mujoco.MjData(drawn)
    plain, taken = env.pipeline_step, []

    def pipeline_step(state, action):
        taken[:] = [action]  # an environment may scale the policy's
        return plain(state, action)

    def first(seed):
        key = jax.random.key(seed)
        return of.reset(None, of.randomize(None, key), key)

    def step(state, change, action):
        pushed = faster(env, state.brax.pipeline_state, change)
        state = state.replace(brax=state.brax.replace(pipeline_state=pushed))
        with mock.patch.object(env, "pipeline_step", pipeline_step):
            return *of.step(None, None, state, action, jax.random.key(0)), taken[-1]

    first = jax.jit(first).lower(np.uint32(0)).compile()
    some = first(np.uint32(0))
    zeros = (np.zeros(n, np.float32) for n in (drawn.nv, of.action_size))
    step = jax.jit(step).lower(some, *zeros).compile()

    def seen(state, ctrl, **told):
        now = state.brax.pipeline_state
        links = np.concatenate([now.x.pos, now.x.rot], -1)
        pose = np.concatenate([WORLD, links])
        return state, Seen(state.obs, now.q, now.qd, ctrl, pose, **told)

    def stepped(state, command, push, force, action):
        change = np.zeros(drawn.nv)
        if np.any(push) or np.any(force):
            data.qpos[:] = state.brax.pipeline_state.q
            change = _change(drawn, data, push, force, of.dt)
        state, outcome, ctrl = step(state, np.float32(change), np.float32(action))
        told = dict(reward=outcome.reward, fell=1.0 - outcome.discount, ok=outcome.valid)
        return seen(state, ctrl, **told)

    return Single(
        model=drawn,
        observed=of.obs_size,
        actions=of.action_size,
        dt=of.dt,
        episode_length=of.episode_length,
        ranges=None,
        about=f"brax's {BACKEND} physics, drawn by MuJoCo",
        first=lambda seed: seen(first(np.uint32(seed)), np.zeros(drawn.nu)),
        step=stepped,
    )


def faster(env: Any, state: Any, change) -> Any:
    """The pipeline's state with `change` added to qd, and to each number that qd decides; of these physics
    they are linear in it."""

    def at(qd):
        return env.pipeline_init(state.q, qd)

    some = jax.tree.map(lambda x, a, b: x + (a - b), state, at(state.qd + change), at(state.qd))
    some = some.replace(q=state.q, qd=state.qd + change)
    return jax.tree.map(lambda a, b: jnp.where(jnp.any(change != 0), a, b), some, state)


def _change(model: mujoco.MjModel, data: mujoco.MjData, push, force, dt: float) -> np.ndarray:
    """[nv] the change of qd by a push of the base (m/s), and by a force on it for `dt` s."""
    mujoco.mj_forward(model, data)
    jacobian, moved = single_lib.jacobian(model, data), np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, moved, (jacobian.T @ force)[None])
    return np.linalg.pinv(jacobian) @ push + moved[0] * dt


def facts(name: str) -> dict[str, Any]:
    """What a controller needs of the environment beside a policy (export/task_onnx.py)."""
    of, env = model(name), bare(name)
    return {
        "squash": "clip",
        "joint_names": [of.joint(int(i)).name for i in of.actuator_trnid[:, 0]],
        "actuator_names": [of.actuator(i).name for i in range(of.nu)],
        "control_dt": float(env.dt),
        "timestep": float(env.sys.opt.timestep),
        "actuator_gear": of.actuator_gear[:, 0].tolist(),
        "actuator_ctrlrange": of.actuator_ctrlrange.tolist(),
        "how": HOW,
        "units": UNITS,
    }

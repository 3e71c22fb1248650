"""Episodes of the task that a policy was trained on, measured by `scores.py`.

JAX is imported only when they run.
"""

from __future__ import annotations

import copy
import hashlib
from functools import partial
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, fields, per_joint, versions
from dynappo.description import motors
from dynappo.description.robot import Robot
from dynappo.physics import engine_contract
from dynappo.policy import checks, policy_file, policy_source, walks
from dynappo.policy.policy_file import Policy
from dynappo.program import devices
from dynappo.tasks.velocity import own

NUMBER = {"gpu": 1000, "cpu": 64}


def settings(policy: Policy):
    """The config that a policy was trained with, validated; device and engine are those that are here.

    Fields that are newer than the policy have their defaults.
    """
    config = fields.defaults()
    for name, value in config_lib.flat(policy.config).items():
        field = fields.field(name)
        if field is None or not _known(policy, name):
            continue
        group, _, leaf = name.rpartition(".")
        node = config[group] if group else config
        settled = None if value is None else fields.convert(field, value)
        if settled is None and value is not None:
            raise ConfigError(
                f"the policy's config has {name} = {value!r}, expected one like {field.default!r}"
            )
        with node.unlocked():
            node[leaf] = settled
    for name in per_joint.names():
        if isinstance(config.task[name], tuple) and name in policy_file.TASK:
            # the policy's own; `check_robot` compares its joints with the robot's
            value = getattr(policy, policy_file.TASK[name])
            config.task[name] = tuple(value.tolist()) if isinstance(value, np.ndarray) else value
    config.run.update(device="auto", mesh_seed=1, mesh_env=1)
    config.physics.update(impl="auto", threads=0)
    config = config_lib.validate(config, robot_here=False)  # the policy may carry it
    _check(config, policy)
    own.check(config.task)
    return config


def _known(policy: Policy, name: str) -> bool:
    """Whether a field of the policy's config is one of this version's, or of the policy's own terms."""
    own = fields.is_own(name) and policy.config["task"].get("terms")
    return bool(own) or name in fields.every()


def left_out(policy: Policy) -> str:
    """A line on what the task of the policy's training had and this version of dynappo has not; else ""."""
    found = {
        name: value
        for name, value in config_lib.flat(policy.config).items()
        if name.startswith(("task.", "physics.")) and not _known(policy, name) and value
    }
    names = ", ".join(f"{name} = {value!r}" for name, value in found.items())
    return names and (
        f"note: the policy's config has {names}, which this dynappo does not know: the task's episodes are "
        "without, and their return is another than in training"
    )


def _check(config, policy: Policy) -> None:
    """ConfigError where the config of a policy's file is that of another network."""
    layers = policy.params["actor"]["params"]
    sizes = tuple(len(layers[f"Dense_{i}"]["bias"]) for i in range(len(layers) - 1))
    if config.ppo.hidden != sizes:
        raise ConfigError(
            f"the policy's config has ppo.hidden = {config.ppo.hidden}, its network has {sizes}"
        )


def check_robot(policy: Policy, robot: Robot) -> None:
    """ConfigError where the task would read the joints of `robot` in another order than the policy."""
    if robot.joint_names != policy.joint_names:
        raise ConfigError(
            f"the policy's joints are {' '.join(policy.joint_names)}, those of {robot.xml} are "
            f"{' '.join(robot.joint_names)}; the task's episodes need the same order (--fast leaves them out)"
        )


def measured(params: dict, named: str) -> dict[str, Any]:
    """What was measured, and with which code: `policy`, its name; a hash of its parameters, which tells a
    policy from a later one in the same file; the commit and MuJoCo's version."""
    content = hashlib.sha256()
    for name, value in sorted(checks.leaves({"actor": params["actor"]})):
        content.update(name.encode() + np.ascontiguousarray(value).tobytes())
    about = {"policy": named, "policy_sha256": content.hexdigest()[:16]}
    return about | {"commit": versions.commit(), "mujoco": versions.of("mujoco")}


def driven(policy: Policy, robot: Robot) -> Robot:
    """`robot` with what is the policy's own, whatever file it comes from: the default pose, and damping and
    friction of the joints, as `policy/episode.py` has them."""
    own = robot._replace(
        default_pose=policy.default_pose,
        home_qpos=np.concatenate([robot.home_qpos[:7], policy.default_pose]),
    )
    if not policy.joint_damping:  # not known
        return own
    model = copy.copy(robot.mj_model)
    model.dof_damping[6:] = policy.joint_damping
    model.dof_frictionloss[6:] = policy.joint_friction
    return own._replace(mj_model=model)


def run(
    policy: Policy,
    number: int | None = None,
    randomize: bool = False,
    seed: int = 0,
    robot: Robot | None = None,
) -> dict[str, Any]:
    """`scores.evaluate` of `number` episodes on this machine's device, and what was run.

    Without a number: 1000 on a GPU, 64 on a CPU. `randomize`: the task as it trains. A CPU has C MuJoCo,
    which is faster there than MJX and has all of its contacts. Without `randomize`,
    `policy` says what the robot does in words. `robot`: None for the policy's own.
    """
    import jax

    from dynappo import scores
    from dynappo.tasks.velocity import env as env_lib

    config = settings(policy)
    number = number or NUMBER.get(jax.default_backend(), NUMBER["cpu"])
    robot = robot or policy_source.robot(policy)[0]
    in_c = jax.default_backend() == "cpu" and not engine_contract.lacks(robot, config.physics, "c")
    impl = "c" if in_c else devices.engine(config)
    check_robot(policy, robot)
    config, robot = motors.fitted(config, driven(policy, robot))
    static, hyper = config_lib.split(config)
    length = config.run.eval_steps or config.task.episode_length
    env = env_lib.make(robot, config.task, config.physics, impl=impl)
    assess = partial(
        scores.evaluate,
        env,
        static=static,
        num_envs=number,
        num_steps=length,
        randomize=randomize,
    )
    # of a policy file only the actor must be there; its size is read from std
    params = {"std": np.ones(len(policy.joint_names), np.float32)} | policy.params
    metrics = jax.device_get(jax.jit(assess)(hyper, params, jax.random.key(seed)))
    numbers: dict[str, Any] = {k: float(v) if np.isfinite(v) else None for k, v in metrics.items()}
    # what walking is, is said of the task without noise
    words = "" if randomize else walks.in_words(config, numbers, number)
    numbers |= {"policy": words} if words else {}
    return {
        "episodes": number,
        "seconds": length * env.dt,
        "randomize": randomize,
        "seed": seed,
        "device": jax.devices()[0].device_kind,
        "impl": impl,
    } | numbers

"""A trained policy as one file that can be shared: `policy.npz`.

Parameters under names like `actor/params/Dense_0/kernel`, and one JSON text, `about`, with all that
turns them into torques: robot, joints in the policy's order, default pose, gains, motor limits,
times, the ranges of its commands, and the config it was trained with. NumPy only.

A checkpoint is read in the same way, with the config that is saved in it (checkpoint_file.py).
"""

from __future__ import annotations

import json
import os
import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ml_collections import config_dict

from dynappo.config import ConfigError, files
from dynappo.physics import robot as robot_lib
from dynappo.policy import checkpoint_file, checks, npz_file
from dynappo.task import observe

FORMAT = 1  # of `about`
MAX_MEAN = 10.0  # of the mean action (learner/networks.py)
ACTIVATIONS = {
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
    "relu": lambda x: np.maximum(x, 0),
    "tanh": np.tanh,
    "swish": lambda x: x / (1 + np.exp(np.minimum(-x, 80))),  # float32 overflows at 88
}
TASK = (
    "action_scale kp kd effort_limit saturation_effort velocity_limit command_x command_y command_yaw"
).split()  # fields of the config's group `task` that a policy cannot be played without


class Policy(NamedTuple):
    """What `about` holds, and `params`; `A` joints."""

    robot: str
    observation: str
    activation: str
    joint_names: tuple[str, ...]  # [A], the order of observations and actions
    default_pose: np.ndarray  # [A] rad
    action_scale: float  # rad
    kp: float  # N m/rad
    kd: float  # N m s/rad
    effort_limit: float  # N m
    saturation_effort: float  # N m
    velocity_limit: float  # rad/s
    command_x: tuple[float, float]  # m/s
    command_y: tuple[float, float]  # m/s
    command_yaw: tuple[float, float]  # rad/s
    timestep: float  # s, of the physics
    substeps: int  # physics steps between two actions
    config: dict[str, Any]  # everything it was trained with
    params: dict[str, Any]
    joint_damping: tuple[float, ...] = ()  # [A] N m s/rad, in the MJCF; empty: not known
    joint_friction: tuple[float, ...] = ()  # [A] N m


def describe(config, robot: robot_lib.Robot, params: dict | None = None) -> Policy:
    """The policy of a run's config; ConfigError if the config lacks a field."""
    fields = config.to_dict()
    try:
        task, physics = fields["task"], fields["physics"]
        return Policy(
            robot=robot.name,
            observation=observe.NAME,
            activation=fields["ppo"]["activation"],
            joint_names=robot.joint_names,
            default_pose=robot.default_pose,
            timestep=physics["timestep"],
            substeps=physics["substeps"],
            config=fields,
            params=params or {},
            joint_damping=tuple(robot.mj_model.dof_damping[6:].tolist()),
            joint_friction=tuple(robot.mj_model.dof_frictionloss[6:].tolist()),
            **{name: task[name] for name in TASK},
        )
    except KeyError as error:
        raise ConfigError(f"the config lacks the field {error}, which a policy needs") from None


def actor(params: dict, activation: str) -> Callable[[np.ndarray], np.ndarray]:
    """The mean action of an actor's parameters, in NumPy; of one observation, or of a batch."""
    layers = params["actor"]["params"]
    weights = [
        (np.asarray(layers[f"Dense_{i}"]["kernel"]), np.asarray(layers[f"Dense_{i}"]["bias"]))
        for i in range(len(layers))
    ]
    act = ACTIVATIONS[activation]

    def mean(obs):
        with np.errstate(over="ignore", invalid="ignore"):  # told as a blow-up where it is played
            for i, (kernel, bias) in enumerate(weights):
                obs = obs @ kernel + bias
                obs = act(obs) if i < len(weights) - 1 else obs
        return np.clip(obs, -MAX_MEAN, MAX_MEAN)

    return mean


def save(path: Path, params: dict, config, robot: robot_lib.Robot | None) -> None:
    """Write `policy.npz`: the nested parameters, and what `config` and `robot` say of them.

    Without a robot, of an environment of one's own, only the config: `load_actor` reads that.
    """
    about: dict[str, Any] = {"robot": "", "config": config.to_dict(), "format": FORMAT}
    if robot is not None:
        about |= describe(config, robot)._asdict()
        del about["params"]
    save_params(path, params, about=to_json(about))


def to_json(value) -> str:
    """JSON of what a file says of a policy; ConfigError if a number in it is not finite."""
    try:
        return json.dumps(value, default=np.ndarray.tolist, allow_nan=False)
    except ValueError:
        raise ConfigError(
            "not written: a number in the description of the policy is not finite"
        ) from None


def save_params(path: Path, params: dict, **entries) -> None:
    """Write nested parameters as an npz, named by their path in it; the file appears at once, whole.

    ConfigError if a number is not finite: nothing is written then.
    """
    arrays: dict[str, Any] = dict(checks.leaves(params))
    for name, value in arrays.items():
        if not np.isfinite(value).all():
            raise ConfigError(f"{path}: not written, {name} is not finite: training had blown up")
    arrays |= entries
    with files.replacing(Path(path)) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def load_params(path: Path) -> dict:
    """The nested parameters that `save` or `save_params` wrote."""
    arrays = npz_file.read(path)
    return npz_file.nested({name: arrays[name] for name in arrays if name != "about"})


def load_actor(path: str | Path) -> Callable[[np.ndarray], np.ndarray]:
    """`act(obs [..., O]) -> mean action [..., A]` of any `policy.npz`, also of an environment of one's own.

    NumPy only. ConfigError where the file is none, or is damaged.
    """
    arrays = npz_file.read(Path(path))
    try:
        activation = json.loads(str(arrays.pop("about")))["config"]["ppo"]["activation"]
        act = actor(npz_file.nested(arrays), activation)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
        raise ConfigError(
            f"{path}: holds no actor, or does not say which activation it has; expected a policy.npz "
            "as training writes it"
        ) from None
    return act


def _not_a_robot(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: a policy of an environment of your own, which is not a robot of dynappo's; training has "
        "evaluated it, and policy_file.load_actor(POLICY_NPZ) acts with it: see docs/environment.md"
    )


def load(path: Path) -> Policy:
    """The policy of a `policy.npz` from anybody; a ConfigError of one line says what is wrong with it."""
    arrays = npz_file.read(path)
    text = arrays.pop("about", None)
    if text is None:
        raise ConfigError(f"{path}: no entry `about`: not a policy.npz as training writes it")
    try:
        params = npz_file.nested(arrays)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    try:
        about = json.loads(str(text))
        version = about.pop("format")
        if version != FORMAT:
            version = reprlib.repr(version)
            raise ConfigError(
                f"{path}: written in format {version}, this dynappo reads {FORMAT}; update dynappo"
            )
        if about.get("robot") == "":
            raise _not_a_robot(path)
        policy = Policy(**about, params=params)
    except ConfigError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        reason = str(error).removeprefix("Policy.__new__() ")[:200]
        raise ConfigError(f"{path}: its entry `about` is damaged ({reason})") from None
    return _checked(path, policy)


def _checked(path: Path, policy: Policy) -> Policy:
    """The policy, its lists as tuples and arrays, if all of it makes sense; else a ConfigError."""

    def expect(ok, text):
        if not ok:
            raise ConfigError(f"{path}: {text}")

    expect(
        policy.observation == observe.NAME,
        f"its observation is {reprlib.repr(policy.observation)}, this dynappo computes {observe.NAME!r}",
    )
    expect(
        policy.activation in tuple(ACTIVATIONS),
        f"its activation is {reprlib.repr(policy.activation)}, expected one of {', '.join(ACTIVATIONS)}",
    )
    try:
        checks.check(policy._asdict())
        checks.check_params(policy.params, len(policy.joint_names))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    return policy._replace(
        joint_names=tuple(policy.joint_names),
        default_pose=np.array(policy.default_pose, float),
        joint_damping=tuple(policy.joint_damping),
        joint_friction=tuple(policy.joint_friction),
    )


def load_checkpoint(folder: Path) -> Policy:
    """The policy of an orbax checkpoint `WORKDIR/checkpoints/ITERATION`; of several seeds the first."""
    try:
        config = config_dict.ConfigDict(checkpoint_file.about(folder)["config"])
        several, name = config.run.num_seeds > 1, config.robot
        if not isinstance(name, str):
            raise TypeError
        if not name:
            raise _not_a_robot(folder)
        policy = describe(config, robot_lib.load(name))
    except ConfigError:
        raise
    except (KeyError, AttributeError, TypeError, ValueError):
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no config)") from None
    prefix, arrays = "learner.params.", {}
    for name, array in checkpoint_file.read(folder).items():
        if name.startswith(prefix):
            first = array[0] if several and array.shape[:1] > (0,) else array
            arrays[name.removeprefix(prefix).replace(".", "/")] = first
    if not arrays:
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no networks)")
    try:
        params = npz_file.nested(arrays)
    except ValueError as error:
        raise ConfigError(f"{folder}: {error}") from None
    return _checked(folder, policy._replace(params=params))


def locate(text: str) -> Path:
    """The policy.npz or checkpoint folder that a name, a workdir or a path means.

    A bundled policy comes first, `./go1` is a folder; of a workdir its policy.npz, or, while it
    trains, its newest checkpoint.
    """
    if text in files.robots():
        path = files.find("robots", f"{text}/policy.npz")
        if path is None:
            raise ConfigError(
                f"{text}: no policy is bundled with this robot (robots/{text}/policy.npz); "
                "train one, or see the robot with --policy=zero or --policy=random"
            )
        return path
    path = Path(text)
    if os.path.isfile(path):  # False, not an error, where the name is too long
        return path
    if not os.path.isdir(path):
        raise ConfigError(
            f"{text}: no such file or folder; expected a workdir, a checkpoint, a policy.npz or one "
            f"of {', '.join(files.robots())}"
        )
    if (path / "policy.npz").is_file():
        return path / "policy.npz"
    if (path / checkpoint_file.STATE).is_dir():
        return path
    folder = path / "checkpoints" if (path / "checkpoints").is_dir() else path
    saved = checkpoint_file.iterations(folder)
    if not saved:
        raise ConfigError(f"{text}: holds neither a policy.npz nor checkpoints/")
    return folder / str(saved[0])


def find(text: str) -> tuple[Policy, Path]:
    """The policy that `text` means (see `locate`), and where it is."""
    path = locate(text)
    return (load_checkpoint if path.is_dir() else load)(path), path

"""A trained policy as one file that can be shared: `policy.npz`.

Parameters under names like `actor/params/Dense_0/kernel`, and one JSON text, `about`, with all that
turns them into torques: robot, joints in the policy's order, default pose, gains, motor limits,
times, the ranges of its commands, and the config it was trained with. NumPy only.

A checkpoint is read in the same way, with the config that is saved in it (checkpoint_file.py).
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ml_collections import config_dict

from dynappo.config import ConfigError, files
from dynappo.physics import robot as robot_lib
from dynappo.policy import checkpoint_file
from dynappo.task import observe

FORMAT = 1  # of `about`
OBSERVATION = (
    "velocity-48"  # the table of task/observe.py; a layout that differs needs another name
)
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
            observation=OBSERVATION,
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
        for i, (kernel, bias) in enumerate(weights):
            obs = obs @ kernel + bias
            obs = act(obs) if i < len(weights) - 1 else obs
        return obs

    return mean


def save(path: Path, params: dict, config, robot: robot_lib.Robot) -> None:
    """Write `policy.npz`: the nested parameters, and what `config` and `robot` say of them."""
    about = describe(config, robot)._asdict() | {"format": FORMAT}
    del about["params"]
    save_params(path, params, about=json.dumps(about, default=np.ndarray.tolist))


def save_params(path: Path, params: dict, **entries) -> None:
    """Write nested parameters as an npz, named by their path in it; the file appears at once, whole."""

    def flat(tree, prefix):
        for name, value in tree.items():
            if isinstance(value, dict):
                yield from flat(value, f"{prefix}{name}/")
            else:
                yield prefix + name, np.asarray(value)

    arrays: dict[str, Any] = dict(flat(params, "")) | entries
    path = Path(path)
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        np.savez(file, **arrays)
    os.replace(part, path)


def load_params(path: Path) -> dict:
    """The nested parameters that `save` or `save_params` wrote."""
    with np.load(path) as file:
        return _nested({name: file[name] for name in file if name != "about"})


def _nested(arrays: dict) -> dict:
    tree: dict = {}
    for name, value in arrays.items():
        *groups, leaf = name.split("/")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
        node[leaf] = value
    return tree


def load(path: Path) -> Policy:
    """The policy of a `policy.npz`; a ConfigError of one line says what the file lacks."""
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file}
    except OSError as error:
        reason = error.strerror or "it is not an npz file"
        raise ConfigError(f"{path}: cannot be read ({reason})") from None
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, AttributeError):
        raise ConfigError(f"{path}: not a policy.npz, or damaged") from None
    text = arrays.pop("about", None)
    if text is None:
        raise ConfigError(f"{path}: no entry `about`: not a policy.npz as training writes it")
    try:
        about = json.loads(str(text))
        version = about.pop("format")
        if version != FORMAT:
            raise ConfigError(
                f"{path}: written in format {version}, this dynappo reads {FORMAT}; update dynappo"
            )
        about["joint_names"] = tuple(about["joint_names"])
        about["default_pose"] = np.array(about["default_pose"], float)
        for name in ("joint_damping", "joint_friction"):
            about[name] = tuple(about.get(name, ()))
        policy = Policy(**about, params=_nested(arrays))
    except ConfigError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        reason = str(error).removeprefix("Policy.__new__() ")
        raise ConfigError(f"{path}: its entry `about` is damaged ({reason})") from None
    return _check(path, policy)


def _check(path: Path, policy: Policy) -> Policy:
    """The policy, if its numbers fit together; else a ConfigError."""

    def expect(ok, text):
        if not ok:
            raise ConfigError(f"{path}: {text}")

    inputs, outputs = observe.PROP_SIZE + observe.CONTEXT_SIZE, len(policy.joint_names)
    expect(
        policy.observation == OBSERVATION,
        f"its observation is {policy.observation!r}, this dynappo computes {OBSERVATION!r}",
    )
    expect(
        policy.activation in ACTIVATIONS,
        f"its activation is {policy.activation!r}, expected one of {', '.join(ACTIVATIONS)}",
    )
    expect(
        policy.default_pose.shape == (outputs,),
        f"{len(policy.default_pose)} angles of the default pose for {outputs} joints",
    )
    for name in ("joint_damping", "joint_friction"):
        count = len(getattr(policy, name))
        expect(count in (0, outputs), f"{count} values of {name} for {outputs} joints")
    try:
        arrays = [x for layer in policy.params["actor"]["params"].values() for x in layer.values()]
        shape = actor(policy.params, policy.activation)(np.zeros(inputs)).shape
    except (KeyError, TypeError, AttributeError, ValueError):
        raise ConfigError(
            f"{path}: not the layers of an actor of {inputs} observations (actor/params/Dense_0/...)"
        ) from None
    expect(shape == (outputs,), f"its actor gives {shape} actions for {outputs} joints")
    finite = all(np.isfinite(x).all() for x in arrays)
    expect(finite, "its parameters are not finite: training had blown up")
    return policy


def load_checkpoint(folder: Path) -> Policy:
    """The policy of an orbax checkpoint `WORKDIR/checkpoints/ITERATION`; of several seeds the first."""
    try:
        config = config_dict.ConfigDict(checkpoint_file.about(folder)["config"])
        robot, several = robot_lib.load(config.robot), config.run.num_seeds > 1
    except (KeyError, AttributeError, TypeError):
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no config)") from None
    prefix, arrays = "learner.params.", {}
    for name, array in checkpoint_file.read(folder).items():
        if name.startswith(prefix):
            arrays[name.removeprefix(prefix).replace(".", "/")] = array[0] if several else array
    if not arrays:
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no networks)")
    return _check(folder, describe(config, robot, _nested(arrays)))


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
    if path.is_file():
        return path
    if not path.is_dir():
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

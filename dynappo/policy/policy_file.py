"""Reads and writes `policy.npz`, a trained policy in one file that can be shared. NumPy only.

The file has parameters with names like `actor/params/Dense_0/kernel`, and one JSON text, `about`,
with everything needed to compute torques: robot, joints in the policy's order, default pose, gains,
motor limits, times, the ranges of its commands, the config it was trained with, and the robot's
MJCF. Beside them `trained/iteration` and `trained/sim_steps` are one number each: how far its run was, where
that is known. Older readers take these for parameters that no network asks for, so they are floats.

`load_checkpoint` reads the policy of a checkpoint, with the checkpoint's own config (checkpoint_file.py).
"""

from __future__ import annotations

import contextlib
import json
import reprlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import ConfigError, files, per_joint
from dynappo.config import fields as fields_lib
from dynappo.description import robot as robot_lib
from dynappo.policy import checkpoint_file, checks
from dynappo.tasks.velocity import observe
from dynappo.terrain import map_file
from dynappo.terrain import scan as scan_lib

# of `about`. 1 has no MJCF, and its robot is found by name; 3 has what 2 cannot say: numbers of each joint,
# armature, dry friction; 4 has a gait clock; 5 a height scan. What an older format can say is written in it,
# for older readers
READ = (1, 2, 3, 4, 5)
MAX_BYTES = 2**27  # of all arrays together; a policy has less than 1 MiB
MIN_STD = 1e-3  # of an input (learner/scaling.py)
MAX_MEAN = 10.0  # of the mean action (learner/networks.py)
ACTIVATIONS = {
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
    "relu": lambda x: np.maximum(x, 0),
    "tanh": np.tanh,
    "swish": lambda x: x / (1 + np.exp(np.minimum(-x, 80))),  # float32 overflows at 88
}
# fields of the config's group `task` that are needed to play a policy, and their names here
TASK = {
    name: name
    for name in (
        "action_scale kp kd effort_limit saturation_effort velocity_limit armature command_x command_y "
        "command_yaw gait_frequency scan"
    ).split()
} | {"joint_friction": "dry_friction"}  # `joint_friction` is the MJCF's
TRAINED = "iteration", "sim_steps"  # the names of how far its run was
# which older configs lack
NEWER = {"armature": None, "joint_friction": 0.0, "gait_frequency": None, "scan": "none"}


class Policy(NamedTuple):
    """The contents of `about`, and `params`; `A` joints."""

    robot: str
    observation: str
    activation: str
    joint_names: tuple[str, ...]  # [A], the order of observations and actions
    default_pose: np.ndarray  # [A] rad
    # one number for all joints, or an array [A]
    action_scale: float | np.ndarray  # rad
    kp: float | np.ndarray  # N m/rad
    kd: float | np.ndarray  # N m s/rad
    effort_limit: float | np.ndarray  # N m
    saturation_effort: float | np.ndarray  # N m
    velocity_limit: float | np.ndarray  # rad/s
    command_x: tuple[float, float]  # m/s
    command_y: tuple[float, float]  # m/s
    command_yaw: tuple[float, float]  # rad/s
    timestep: float  # s, of the physics
    substeps: int  # physics steps between two actions
    config: dict[str, Any]  # everything it was trained with
    params: dict[str, Any]
    joint_damping: tuple[float, ...] = ()  # [A] N m s/rad, in the MJCF; empty: not known
    joint_friction: tuple[float, ...] = ()  # [A] N m, frictionloss in the MJCF
    # as action_scale: inertia of the motors (kg m^2; None: the MJCF's), and the friction (N m) beside the
    # MJCF's that it was trained with (actuators.friction)
    armature: float | np.ndarray | None = None
    dry_friction: float | np.ndarray = 0.0
    mjcf: str = (
        ""  # the robot's, needs no other file; empty: the robot is found by name (policy_source.py)
    )
    history: int = 1  # readings that it sees, the newest first
    gait_frequency: tuple[float, float] | None = None  # Hz, the range of its gait clock; None: none
    # as `task.scan`: "grid" sees a height scan (terrain/scan.py) after its readings
    scan: str = "none"
    seed: int | None = None  # its number in a run of several seeds, from 0; None: unknown
    iteration: int | None = None  # of its run, the first is 1; None: unknown
    sim_steps: int | None = None  # that its run had taken by then, of one seed

    @property
    def own(self) -> observe.Own:
        """The quantities of one's own that it was trained with, as its config says (config/terms.py)."""
        return observe.own(self.config.get("task", {}).get("terms_about", ""))


def own_sizes(about: str | None) -> dict[str, int | None]:
    """The quantities of one's own that a policy sees, by a config's `task.terms_about`, with their sizes."""
    with contextlib.suppress(ValueError):
        return {one.name: one.quantity.size for one in observe.own(about or "") if one.shown}
    return {}


def describe(config, robot: robot_lib.Robot, params: dict | None = None) -> Policy:
    """The policy of a run's config; ConfigError if the config lacks a field, or its numbers of joints do not
    fit the robot's."""
    fields = config.to_dict()
    try:
        task, physics = fields["task"], fields["physics"]
        of_task = {own: _of_task(name, NEWER | task, robot) for name, own in TASK.items()}
        # by name: the policy's joints may get another order
        for name in set(per_joint.names()) & task.keys():
            task[name] = per_joint.by_name(task[name], robot.joint_names)
        return Policy(
            robot=robot.name,
            observation=observe.name(
                task.get("observation", "full"),
                len(robot.joint_names),
                task.get("gait_frequency") is not None,
                observe.own(task.get("terms_about", "")),
            ),
            history=task.get("history", 1),
            activation=fields["ppo"]["activation"],
            joint_names=robot.joint_names,
            default_pose=robot.default_pose,
            timestep=physics["timestep"],
            substeps=physics["substeps"],
            config=fields,
            params=params or {},
            joint_damping=tuple(robot.mj_model.dof_damping[6:].tolist()),
            joint_friction=tuple(robot.mj_model.dof_frictionloss[6:].tolist()),
            mjcf=robot.alone,
            **of_task,
        )
    except KeyError as error:
        raise ConfigError(f"the config lacks the field {error}, which a policy needs") from None


def _of_task(name: str, task: dict[str, Any], robot: robot_lib.Robot) -> Any:
    """A field of `task`; one of joints as one number, or an array [A] of the robot's."""
    value, full = task[name], f"task.{name}"
    field = fields_lib.every()[full]
    if not field.per_joint or not isinstance(value, (list, tuple)):
        return value
    found = fields_lib.convert(field, value)  # perhaps from a checkpoint, so checked
    if found is None:
        raise ConfigError(f"{full} is {value!r}, expected {fields_lib.expected(field)}")
    fields_lib.check(full, found)
    numbers = per_joint.numbers(full, found, robot.joint_names, robot.name)
    return np.array(numbers) if isinstance(numbers, tuple) else numbers


def about(policy: Policy) -> dict[str, Any]:
    """The entry `about` of a policy's file: all but `params`, and how far its run was."""
    entry = policy._asdict()
    for name in ("params", *TRAINED):
        del entry[name]
    if entry["scan"] != "none":
        return entry | {"format": 5}
    del entry["scan"]
    if entry["gait_frequency"] is not None:
        return entry | {"format": 4}
    del entry["gait_frequency"]
    new = {TASK[name]: nothing for name, nothing in NEWER.items() if TASK[name] in entry}
    several = any(
        isinstance(entry[TASK[name]], np.ndarray) for name in per_joint.names() if name in TASK
    )
    if several or any(entry[own] != nothing for own, nothing in new.items()):
        return entry | {"format": 3}
    return {name: value for name, value in entry.items() if name not in new} | {"format": 2}


def actor(params: dict, activation: str) -> Callable[[np.ndarray], np.ndarray]:
    """The function `obs -> mean action` of an actor's parameters, in NumPy, also for a batch."""
    layers = params["actor"]["params"]
    weights = [
        (np.asarray(layers[f"Dense_{i}"]["kernel"]), np.asarray(layers[f"Dense_{i}"]["bias"]))
        for i in range(len(layers))
    ]
    act = ACTIVATIONS[activation]

    def mean(obs):
        with np.errstate(over="ignore", invalid="ignore"):  # reported as a blow-up by the player
            for i, (kernel, bias) in enumerate(weights):
                obs = obs @ kernel + bias
                obs = act(obs) if i < len(weights) - 1 else obs
        return np.clip(obs, -MAX_MEAN, MAX_MEAN)

    return mean


def scaled(params: dict) -> dict:
    """The parameters of networks that see their inputs as they are: what `ppo.normalize` does to them
    (learner/scaling.py) is multiplied into the first layers."""
    if "inputs" not in params:
        return params
    out = {name: part for name, part in params.items() if name != "inputs"}
    for name, of in params["inputs"].items():
        layers = out[name]["params"]
        count, mean, m2 = (np.asarray(of[part], float) for part in ("count", "mean", "m2"))
        if count == 0:
            continue
        std = np.maximum(np.sqrt(m2 / count), MIN_STD)
        kernel = np.asarray(layers["Dense_0"]["kernel"], float) / std[:, None]
        bias = np.asarray(layers["Dense_0"]["bias"], float) - mean @ kernel
        first = {"kernel": kernel.astype(np.float32), "bias": bias.astype(np.float32)}
        out[name] = {"params": layers | {"Dense_0": first}}
    return out


def save(
    path: Path,
    params: dict,
    config,
    robot: robot_lib.Robot | None,
    seed: int | None = None,
    iteration: int | None = None,
    sim_steps: int | None = None,
) -> None:
    """Write `policy.npz`: the nested parameters, and their description from `config` and `robot`.

    `seed` is their number in a run of several seeds, which was at `iteration`, after `sim_steps` simulator
    steps of each seed. Without a robot (an environment of your own),
    the description is only the config; `load_actor` reads such a file.
    """
    entry: dict[str, Any] = {"robot": "", "config": config.to_dict(), "format": 2}
    if robot is not None:
        entry |= about(describe(config, robot)._replace(seed=seed))
    far = trained({"iteration": iteration, "sim_steps": sim_steps})
    save_params(path, scaled(params), about=to_json(entry), **far)


def trained(found: Mapping[str, int | None]) -> dict[str, np.ndarray]:
    """The entries of a file that say how far its run was: those of `TRAINED` that are known."""
    known = ((name, found[name]) for name in TRAINED)
    return {f"trained/{name}": np.array(x, np.float64) for name, x in known if x is not None}


def _pop_trained(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, int]:
    """Take what `trained` has written out of the arrays of a file; ConfigError if it is no whole number."""
    known = {name: arrays.pop(f"trained/{name}", None) for name in TRAINED}
    found = {}
    for name, value in known.items():
        if value is None:
            continue
        if value.shape != () or value.dtype != np.float64 or not value.item().is_integer():
            seen = reprlib.repr(value.tolist())
            raise ConfigError(f"{path}: trained/{name} is {seen}, expected a whole number")
        found[name] = int(value)
    return found


def to_json(value) -> str:
    """A policy's description as JSON; ConfigError if a number in it is not finite."""
    try:
        return json.dumps(value, default=np.ndarray.tolist, allow_nan=False)
    except ValueError:
        raise ConfigError(
            "not written: a number in the description of the policy is not finite"
        ) from None


def save_params(path: Path, params: dict, **entries) -> None:
    """Write nested parameters as an npz; each array is named by its path. The write is atomic.

    ConfigError if a number is not finite; then nothing is written.
    """
    arrays: dict[str, Any] = dict(checks.leaves(params))
    for name, value in arrays.items():
        if not np.isfinite(value).all():
            raise ConfigError(f"{path}: not written, {name} is not finite: training had blown up")
    arrays |= entries
    with files.replacing(Path(path)) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an npz file by name. It cannot run code: nothing is unpickled.

    ConfigError if it cannot be read, is damaged, or is far larger than a policy.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            size = sum(entry.file_size for entry in file.zip.infolist())
            if size > MAX_BYTES:
                raise ConfigError(f"{path}: {size} bytes unpacked, expected at most {MAX_BYTES}")
            return {name: file[name] for name in file.files}
    except OSError as error:
        reason = error.strerror or "it is not an npz file"
        raise ConfigError(f"{path}: cannot be read ({reason})") from None
    except map_file.DAMAGE as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{path}: not a policy.npz, or damaged; {_instead(path)}") from None


def _instead(path: Path) -> str:
    """What to name in place of a damaged file: the newest checkpoint of its run, if it is of one."""
    folder = path.parent / "checkpoints"
    if saved := checkpoint_file.iterations(folder):
        return f"name {folder / str(saved[0])}, a checkpoint of its run, which has the policy too"
    return "expected a policy.npz as training writes it"


def bundled(name: str) -> Path:
    """The file of a bundled policy, one of `files.bundled()`; ConfigError if the robot has none."""
    if name not in files.robots():
        robot, _, kind = name.rpartition("_")
        name = f"{robot}/{kind}.npz"
        return files.find("robots", name) or Path(name)
    path = files.find("robots", f"{name}/policy.npz")
    if path is None:
        raise ConfigError(
            f"{name}: no policy is bundled with this robot (robots/{name}/policy.npz); "
            "train one, or see the robot with --policy=zero or --policy=random"
        )
    return path


def load_actor(path: str | Path) -> Callable[[np.ndarray], np.ndarray]:
    """`act(obs [..., O]) -> mean action [..., A]` of any `policy.npz`, also of your own
    environment.

    `path` may be the name of a bundled policy, as "go1", or a workdir. NumPy only. ConfigError if the file is
    not a policy.npz, or is damaged; `act` raises ValueError for other than O numbers.
    """
    if not Path(path).exists() and str(path) in files.bundled():
        path = bundled(str(path))
    if Path(path).is_dir():
        path = Path(path) / "policy.npz"
    arrays = _arrays(Path(path))
    try:
        activation = json.loads(str(arrays.pop("about")))["config"]["ppo"]["activation"]
        params = checks.nested(arrays)
        act, size = actor(params, activation), len(params["actor"]["params"]["Dense_0"]["kernel"])
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
        raise ConfigError(
            f"{path}: holds no actor, or does not say which activation it has; expected a policy.npz "
            "as training writes it"
        ) from None

    def checked(obs):
        found = np.shape(obs)[-1:]
        if found != (size,):
            text = f"{found[0]} numbers" if found else "one number, without an axis"
            raise ValueError(f"obs has {text}, expected {size}: what the policy of {path} sees")
        return act(np.asarray(obs))

    return checked


def _no_number(text: str):
    raise ValueError(f"{text} is no number")


def _not_a_robot(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: a policy of an environment of your own, which is not a robot of dynappo's; training has "
        "evaluated it, and policy_file.load_actor(POLICY_NPZ) acts with it: see docs/environment.md"
    )


def load(path: Path) -> Policy:
    """The policy of a `policy.npz`, whoever made it; a one-line ConfigError says what is wrong."""
    arrays = _arrays(path)
    text, far = arrays.pop("about", None), _pop_trained(path, arrays)
    if text is None:
        raise ConfigError(f"{path}: no entry `about`: not a policy.npz as training writes it")
    try:
        params = checks.nested(arrays)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    try:
        about = json.loads(str(text), parse_constant=_no_number)
        version = about.pop("format")
        if version not in READ:
            version, newest = reprlib.repr(version), max(READ)
            raise ConfigError(
                f"{path}: written in format {version}, this dynappo reads {newest}; update dynappo"
            )
        if about.get("robot") == "":
            raise _not_a_robot(path)
        policy = Policy(**about | far, params=params)
    except ConfigError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        reason = str(error).removeprefix("Policy.__new__() ")[:200]
        raise ConfigError(f"{path}: its entry `about` is damaged ({reason})") from None
    return _checked(path, policy)


def _checked(path: Path, policy: Policy) -> Policy:
    """The policy with lists as tuples and arrays; ConfigError if something in it is wrong."""

    def expect(ok, text):
        if not ok:
            raise ConfigError(f"{path}: {text}")

    expect(
        policy.activation in tuple(ACTIVATIONS),
        f"its activation is {reprlib.repr(policy.activation)}, expected one of {', '.join(ACTIVATIONS)}",
    )
    try:
        entries = policy._asdict()  # of a file lists, of a checkpoint's config arrays
        checks.check(
            {n: x.tolist() if isinstance(x, np.ndarray) else x for n, x in entries.items()}
        )
        clock = policy.gait_frequency is not None
        joints, own = len(policy.joint_names), policy.own
        observations = [observe.name(kind, joints, clock, own) for kind in observe.NAMES]
        expect(
            policy.observation in observations,
            f"its observation is {reprlib.repr(policy.observation)}, this dynappo computes "
            + " and ".join(map(repr, observations))
            + f" of one with{'' if clock else 'out'} a gait clock",
        )
        inputs = len(observe.columns(policy.observation, own)) * policy.history
        inputs += len(scan_lib.points()) * (policy.scan == "grid")
        checks.check_params(policy.params, inputs, len(policy.joint_names))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    if policy.mjcf:
        robot = robot_lib.load_text(policy.mjcf, policy.robot, path)
        same = set(robot.joint_names) == set(policy.joint_names)
        lists = ", ".join(policy.joint_names), ", ".join(robot.joint_names)
        expect(same, "its joints are {}, those of the robot that it carries {}".format(*lists))
    of_joints = {own: getattr(policy, own) for own in checks.PER_JOINT}
    return policy._replace(
        joint_names=tuple(policy.joint_names),
        default_pose=np.array(policy.default_pose, float),
        joint_damping=tuple(policy.joint_damping),
        joint_friction=tuple(policy.joint_friction),
        **{own: np.array(x, float) for own, x in of_joints.items() if isinstance(x, list)},
    )


def load_checkpoint(folder: Path, seed: int | None = None) -> Policy:
    """The policy of an orbax checkpoint `WORKDIR/checkpoints/ITERATION`, of several seeds number
    `seed`.

    Without `seed`, the best seed in the last evaluation before the checkpoint, or the first if
    there was none.
    """
    try:
        about = checkpoint_file.about(folder)
        config = config_dict.ConfigDict(about["config"])
        seeds, name, text = config.run.num_seeds, config.robot, about.get("mjcf", "")
        if not isinstance(name, str) or not isinstance(text, str) or type(seeds) is not int:
            raise TypeError
        if not name:
            raise _not_a_robot(folder)
        robot = robot_lib.load_text(text, name, folder) if text else robot_lib.load(name)
        policy = describe(config, robot)._replace(mjcf=text)
    except ConfigError:
        raise
    except (KeyError, AttributeError, TypeError, ValueError):
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no config)") from None
    params, chosen = _of_seed(folder, about, seeds, seed)
    far = {name: about.get(name) for name in TRAINED}
    number = chosen if seeds > 1 else None
    return _checked(folder, policy._replace(params=params, seed=number, **far))


def _of_seed(folder: Path, about: dict, seeds: int, seed: int | None) -> tuple[dict, int]:
    """`(parameters, seed)` of a checkpoint of so many seeds: those of `seed`, or of the best."""
    chosen = seed if seed is not None else about.get("best_seed", 0)
    if type(chosen) is not int or not 0 <= chosen < seeds:
        expected = f"expected 0 to {seeds - 1}" if seeds > 1 else "expected 0: the run has one seed"
        raise ConfigError(f"{folder}: it holds no seed {reprlib.repr(chosen)}; {expected}")
    prefix, arrays = "learner/params/", {}
    for name, array in checkpoint_file.read(folder).items():
        if name.startswith(prefix):
            if seeds > 1 and array.shape[:1] != (seeds,):
                what = f"{name} has the shape {array.shape}, expected {seeds} seeds"
                raise ConfigError(f"{folder}: not a checkpoint of dynappo ({what})")
            one = array[chosen] if seeds > 1 else array
            arrays[name.removeprefix(prefix)] = one
    if not arrays:
        raise ConfigError(f"{folder}: not a checkpoint of dynappo (it holds no networks)")
    try:
        return scaled(checks.nested(arrays)), chosen
    except ValueError as error:
        raise ConfigError(f"{folder}: {error}") from None


class Other(NamedTuple):
    """A policy of another package's environment (`config.env`)."""

    config: config_dict.ConfigDict  # of its run, with every field; not validated
    params: dict[str, Any]
    iteration: int | None = None  # as in a `Policy`
    sim_steps: int | None = None


def load_other(path: Path, seed: int | None = None) -> Other | None:
    """The policy of a policy.npz or a checkpoint of another package's environment; None if it is a robot's.

    ConfigError where neither can be told.
    """
    if path.is_dir():
        about, arrays = checkpoint_file.about(path), {}
        far = {name: about.get(name) for name in TRAINED}
    else:
        arrays = _arrays(path)
        far = _pop_trained(path, arrays)
        text = str(arrays.pop("about", "{}"))
        try:
            about = json.loads(text, parse_constant=_no_number)
        except (ValueError, RecursionError):
            return None  # `load` says what is wrong
    of = about.get("config") if isinstance(about, dict) else None
    name = of.get("env") if isinstance(of, dict) else None
    if not name or not isinstance(name, str):
        return None
    config = config_lib.from_json(json.dumps(of))
    try:
        checks.check_counts(far)
        params = (
            checks.nested(arrays)
            if arrays
            else _of_seed(path, about, config.run.num_seeds, seed)[0]
        )
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    return Other(config, params, **far)

"""Checks a policy from a file: types, shapes, and ranges that make sense for a walking robot.

Ranges are generous: a value outside is a mistake or an attack.
"""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from dynappo.description.robot_contract import NAME, is_plain
from dynappo.tasks.velocity import observe

# field -> (low, high, unit)
RANGES = {
    "action_scale": (1e-6, 100, "rad"),
    "kp": (0, 1e5, "N m/rad"),
    "kd": (0, 1e4, "N m s/rad"),
    "effort_limit": (1e-6, 1e6, "N m"),
    "saturation_effort": (1e-6, 1e9, "N m"),
    "velocity_limit": (1e-6, 1e9, "rad/s"),
    "armature": (0, 1e4, "kg m2"),
    "dry_friction": (0, 1e4, "N m"),
    "timestep": (1e-5, 0.1, "s"),
    "substeps": (1, 1000, "physics steps"),
    "history": (1, 100, "readings"),
    "default_pose": (-100, 100, "rad"),
    "joint_damping": (0, 1e4, "N m s/rad"),
    "joint_friction": (0, 1e4, "N m"),
    "command_x": (-100, 100, "m/s"),
    "command_y": (-100, 100, "m/s"),
    "command_yaw": (-100, 100, "rad/s"),
    "gait_frequency": (0.01, 10, "Hz"),
}
SCANS = "none", "grid"
COUNTS = "substeps", "history"
PER_JOINT = (
    "action_scale kp kd effort_limit saturation_effort velocity_limit armature dry_friction".split()
)
OF_JOINTS = "default_pose", "joint_damping", "joint_friction"  # one number per joint
PAIRS = "command_x", "command_y", "command_yaw", "gait_frequency"  # (low, high)
MAY_BE_NONE = "armature", "gait_frequency"  # the MJCF's; no gait clock
WHERE = {"seed": 2**31, "iteration": 2**31, "sim_steps": 2**53}  # of a run it is from; or None
DEEPEST = 10  # groups in groups of parameters
PERIOD = 1.0  # s between two actions at most


def check(fields: dict[str, Any]) -> None:
    """ValueError if a field of a `Policy`, except `params`, has a wrong type or is out of range."""
    joints = _list(fields["joint_names"])
    for name in (fields["robot"], *joints):
        plain = isinstance(name, str) and is_plain(name)
        _expect(plain, f"a name is {reprlib.repr(name)}, expected at most {NAME} plain characters")
    robot = fields["robot"]
    _expect(not set(robot) & set("/\\") and robot != "..", f"robot is {robot!r}, expected a name")
    _expect(len(set(joints)) == len(joints), "its joint_names hold a joint more than once")
    for name, (low, high, unit) in RANGES.items():
        value = fields[name]
        several = name in OF_JOINTS + PAIRS
        if name in PER_JOINT and isinstance(value, list | np.ndarray):  # else one number for all
            several, count = True, len(value)
            _expect(count == len(joints), f"{count} values of {name} for {len(joints)} joints")
        if value is None and name in MAY_BE_NONE:
            continue
        for one in _list(value) if several else [value]:
            number = type(one) is int if name in COUNTS else type(one) in (int, float)
            kind = f"{'an integer of ' if name in COUNTS else ''}{low:g} to {high:g} {unit}"
            inside = number and low <= one <= high  # NaN is not
            _expect(inside, f"{name} is {reprlib.repr(one)}, expected {kind}")
    for name in OF_JOINTS:
        count = len(fields[name])
        fits = count == len(joints) or (name != "default_pose" and not count)
        _expect(fits, f"{count} values of {name} for {len(joints)} joints")
    for name in (name for name in PAIRS if fields[name] is not None or name not in MAY_BE_NONE):
        ends = _list(fields[name])
        ordered = len(ends) == 2 and ends[0] <= ends[1]
        _expect(ordered, f"{name} is {reprlib.repr(ends)}, expected (low, high)")
    period = fields["substeps"] * fields["timestep"]
    _expect(period <= PERIOD, f"{period:g} s lie between two actions, expected at most {PERIOD:g}")
    text = fields["mjcf"]
    _expect(isinstance(text, str), f"mjcf is {reprlib.repr(text)}, expected a text")
    check_counts({name: fields[name] for name in WHERE})
    scan = fields["scan"]
    _expect(scan in SCANS, f"scan is {reprlib.repr(scan)}, expected one of {', '.join(SCANS)}")
    _check_config(fields)


def check_counts(found: dict[str, Any]) -> None:
    """ValueError if one of these is neither None nor a whole number below its limit in `WHERE`."""
    for name, value in found.items():
        known = value is None or (type(value) is int and 0 <= value < WHERE[name])
        _expect(known, f"{name} is {reprlib.repr(value)}, expected a number from 0 on")


def _expect(ok, text: str) -> None:
    if not ok:
        raise ValueError(text)


def _list(value) -> list:
    """A list from JSON, or the array or tuple made from it, as a list."""
    found = value.tolist() if isinstance(value, np.ndarray) else value
    _expect(isinstance(found, list | tuple), f"{reprlib.repr(found)} found, expected a list")
    return list(found)


def _check_config(fields: dict[str, Any]) -> None:
    """The training config must agree with fields that `about` has too."""
    config = fields["config"]
    groups = isinstance(config, dict)
    _expect(groups, f"config is {reprlib.repr(config)}, expected groups of fields")
    for name in ("task", "physics", "ppo"):
        group = config.get(name, {})
        named = f"config.{name}"
        _expect(isinstance(group, dict), f"{named} is {reprlib.repr(group)}, expected a group")
        for field in ({*RANGES, "activation", "scan"} - {*OF_JOINTS}) & group.keys():
            _expect_same(field, fields[field], group[field], named)
    task = config.get("task", {})
    if "joint_friction" in task:  # `joint_friction` of `about` is the MJCF's
        _expect_same("dry_friction", fields["dry_friction"], task["joint_friction"], "config.task")
    for name in ("terms", "terms_hash", "terms_about"):
        text = task.get(name, "")
        _expect(
            isinstance(text, str), f"config.task.{name} is {reprlib.repr(text)}, expected a text"
        )
    if "observation" in task:
        seen = task["observation"]
        known = isinstance(seen, str) and seen in observe.NAMES
        joints, clock = len(fields["joint_names"]), fields["gait_frequency"] is not None
        own = observe.own(task.get("terms_about", ""))
        named = observe.name(seen, joints, clock, own) if known else seen
        _expect_same("observation", fields["observation"], named, "config.task")
    noise = config.get("task", {}).get("noise", {})
    named = f"config.task.noise is {reprlib.repr(noise)}"
    _expect(isinstance(noise, dict), f"{named}, expected a group")


def _expect_same(field: str, own, trained, where: str) -> None:
    """For numbers of joints: each must be one of the config's, whose patterns are not matched here."""
    own, trained = (list(x) if isinstance(x, tuple | np.ndarray) else x for x in (own, trained))
    same = own == trained
    if field in PER_JOINT and isinstance(trained, list):
        known = [x[-1] if isinstance(x, list | tuple) and x else x for x in trained]
        same = all(x in known for x in (own if isinstance(own, list) else [own]))
    said = f"{field} is {reprlib.repr(own)}, but {reprlib.repr(trained)} in {where}"
    _expect(same, said)


def check_params(params: dict, inputs: int, joints: int) -> None:
    """ValueError unless these are a policy's networks for `inputs` numbers and `joints` joints, all finite.

    The value function may see other numbers (ppo.critic).
    """
    for name, value in leaves(params):
        _expect(value.dtype.kind == "f", f"{name} holds {value.dtype}, expected real numbers")
        _expect(np.isfinite(value).all(), f"{name} is not finite: training had blown up")
    for name, outputs in (("actor", joints), ("critic", 1)):
        if name == "actor" or name in params:
            _check_layers(name, params.get(name), inputs if name == "actor" else None, outputs)
    std = params.get("std", np.zeros(joints))
    fits = getattr(std, "shape", None) == (joints,)
    _expect(fits, f"std has the shape {getattr(std, 'shape', None)}, expected ({joints},)")


def leaves(tree: dict, prefix: str = ""):
    """`(name, array)` of all arrays of nested parameters; names like `actor/params/Dense_0/bias`."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{name}/")
        else:
            yield prefix + name, np.asarray(value)


def nested(arrays: dict[str, np.ndarray]) -> dict:
    """`{"actor/params": x}` as `{"actor": {"params": x}}`; ValueError if a name does not fit."""
    tree: dict = {}
    for name, value in arrays.items():
        *groups, leaf = name.split("/")
        node = tree
        for group in groups:
            node = node.setdefault(group, {})
            if not isinstance(node, dict) or len(groups) > DEEPEST:
                raise ValueError(f"its entry `{name}` lies inside of another, or too deep")
        node[leaf] = value
    return tree


def _check_layers(network: str, tree, inputs: int | None, outputs: int) -> None:
    """ValueError unless each layer's inputs are the outputs of the layer before."""
    named = f"{'an' if network == 'actor' else 'a'} {network}"
    rule = f"not the layers of {named} of {inputs or 'some'} observations ({network}/params/Dense_0/...)"
    layers = tree.get("params", {}) if isinstance(tree, dict) else {}
    _expect(isinstance(layers, dict) and layers, rule)
    width = inputs
    for i in range(len(layers)):
        layer = layers.get(f"Dense_{i}", {})
        pair = isinstance(layer, dict) and set(layer) == {"kernel", "bias"}
        _expect(pair, f"{rule}: Dense_{i} has no kernel and bias")
        kernel, bias = (np.shape(layer[name]) for name in ("kernel", "bias"))
        width = kernel[0] if width is None and kernel else width
        chains = len(kernel) == 2 and kernel[0] == width and min(kernel) > 0
        found = f"Dense_{i} has a kernel {kernel} and a bias {bias} after {width} numbers"
        _expect(chains and bias == kernel[1:], f"{rule}: {found}")
        width = kernel[1]
    _expect(width == outputs, f"its {network} gives {width} numbers, expected {outputs} ({rule})")

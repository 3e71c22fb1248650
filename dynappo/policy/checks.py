"""Checks a policy from an untrusted file: types, ranges that make sense for a walking robot,
shapes.

Ranges are generous: a value outside is a mistake, or meant to harm.
"""

from __future__ import annotations

import math
import reprlib
from typing import Any

import numpy as np

NAME = 100  # characters of a robot's or a joint's name
# field -> (low, high, unit)
NUMBERS = {
    "action_scale": (1e-6, 100, "rad"),
    "kp": (0, 1e5, "N m/rad"),
    "kd": (0, 1e4, "N m s/rad"),
    "effort_limit": (1e-6, 1e6, "N m"),
    "saturation_effort": (1e-6, 1e9, "N m"),
    "velocity_limit": (1e-6, 1e9, "rad/s"),
    "timestep": (1e-5, 0.1, "s"),
}
LISTS = {  # one number per joint
    "default_pose": (-100, 100, "rad"),
    "joint_damping": (0, 1e4, "N m s/rad"),
    "joint_friction": (0, 1e4, "N m"),
}
COMMANDS = {"command_x": "m/s", "command_y": "m/s", "command_yaw": "rad/s"}
FASTEST = 100  # m/s or rad/s, of a command
WIDEST = 10_000  # units of a layer: with more, a second of an episode takes minutes
HISTORY = 100  # at most: readings that a policy sees
SUBSTEPS, PERIOD = 1000, 1.0  # at most: physics steps between two actions, and their time (s)


def check(fields: dict[str, Any]) -> None:
    """ValueError if a field of a `Policy`, except `params`, has a wrong type or is out of range."""
    names = _row(fields["joint_names"])
    for name in (fields["robot"], *names):
        plain = isinstance(name, str) and 0 < len(name) <= NAME and name.isprintable()
        _expect(plain, f"a name is {reprlib.repr(name)}, expected at most {NAME} plain characters")
    robot = fields["robot"]
    _expect(not set(robot) & set("/\\") and robot != "..", f"robot is {robot!r}, expected a name")
    _expect(len(set(names)) == len(names), "its joint_names hold a joint more than once")
    for name, (low, high, unit) in NUMBERS.items():
        _expect_number(name, fields[name], low, high, unit)
    for name, (low, high, unit) in LISTS.items():
        values = _row(fields[name])
        count = f"{len(values)} values of {name} for {len(names)} joints"
        _expect(len(values) == len(names) or (name != "default_pose" and not values), count)
        for value in values:
            _expect_number(name, value, low, high, unit)
    for name, unit in COMMANDS.items():
        values = _row(fields[name])
        for value in values:
            _expect_number(name, value, -FASTEST, FASTEST, unit)
        ordered = len(values) == 2 and values[0] <= values[1]
        _expect(ordered, f"{name} is {reprlib.repr(values)}, expected (low, high)")
    steps = fields["substeps"]
    _expect(type(steps) is int, f"substeps is {reprlib.repr(steps)}, expected an integer")
    _expect_number("substeps", steps, 1, SUBSTEPS, "physics steps")
    history = fields["history"]
    _expect(
        type(history) is int and 1 <= history <= HISTORY,
        f"history is {reprlib.repr(history)}, expected 1 to {HISTORY} readings",
    )
    text, seed = fields["mjcf"], fields["seed"]
    _expect(isinstance(text, str), f"mjcf is {reprlib.repr(text)}, expected a text")
    known = seed is None or (type(seed) is int and 0 <= seed < 2**31)
    _expect(known, f"seed is {reprlib.repr(seed)}, expected a number from 0 on")
    period = steps * fields["timestep"]
    _expect(period <= PERIOD, f"{period:g} s lie between two actions, expected at most {PERIOD:g}")
    _check_config(fields)


def _expect(ok, text: str) -> None:
    if not ok:
        raise ValueError(text)


def _row(value) -> list:
    """A list from JSON, or the array or tuple made from it, as a list."""
    found = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(found, list | tuple):
        raise ValueError(f"{reprlib.repr(found)} found, expected a list")
    return list(found)


def _expect_number(name: str, value, low: float, high: float, unit: str) -> None:
    inside = type(value) in (int, float) and low <= value <= high  # NaN is not
    _expect(inside, f"{name} is {reprlib.repr(value)}, expected {low:g} to {high:g} {unit}")


def _check_config(fields: dict[str, Any]) -> None:
    """The training config must be finite, and agree with fields that `about` has too."""
    config = fields["config"]
    todo = [("config", config)]
    while todo:  # no recursion: JSON may be deep
        name, value = todo.pop()
        if isinstance(value, dict):
            todo += [(f"{name}.{key}", part) for key, part in value.items()]
        elif isinstance(value, list | tuple):
            todo += [(name, part) for part in value]
        finite = not isinstance(value, float) or math.isfinite(value)
        _expect(finite, f"{name[:80]} is {value}, expected a finite number")
    _expect(
        isinstance(config, dict), f"config is {reprlib.repr(config)}, expected groups of fields"
    )
    for group in ("task", "physics", "ppo"):
        found = config.get(group, {})
        _expect(
            isinstance(found, dict), f"config.{group} is {reprlib.repr(found)}, expected a group"
        )
        for name in {*NUMBERS, *COMMANDS, "substeps", "activation"} & set(found):
            one, other = (
                list(v) if isinstance(v, tuple) else v for v in (found[name], fields[name])
            )
            text = f"{name} is {reprlib.repr(other)}, but {reprlib.repr(one)} in config.{group}"
            _expect(one == other, text)
    noise = config.get("task", {}).get("noise", {})
    _expect(
        isinstance(noise, dict), f"config.task.noise is {reprlib.repr(noise)}, expected a group"
    )


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
        _expect(width <= WIDEST, f"its {network} has a layer of {width} units, at most {WIDEST}")
    _expect(width == outputs, f"its {network} gives {width} numbers, expected {outputs} ({rule})")

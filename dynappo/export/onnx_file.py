"""A policy as an ONNX network, `obs [batch, O]` to `action [batch, A]`, with everything a robot needs.

A policy that sees the last h readings takes them part by part, and of each part the oldest first, as Isaac
Lab's observation manager and unitree_rl_lab's controllers do.

`export` makes the network from the parameters alone (no JAX, no torch); it computes in float32 whatever
`ppo.precision` is. Its metadata has the rest: observation table, joints, default pose, gains, limits, times.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import ConfigError, files, shell, versions
from dynappo.description import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import gait, observe
from dynappo.terrain import scan

# Everything used here is in opset 14 already, and ONNX Runtime reads opset 17 from its 1.12 (2022) on
OPSET, IR_VERSION = 17, 8
UNITS = {
    "default_pose": "rad",
    "joint_range": "rad",
    "joint_damping": "N m s/rad",
    "joint_friction": "N m",
    "action_scale": "rad",
    "kp": "N m/rad",
    "kd": "N m s/rad",
    "effort_limit": "N m",
    "saturation_effort": "N m",
    "velocity_limit": "rad/s",
    "armature": "kg m2",
    "dry_friction": "N m",
    "command_x": "m/s",
    "command_y": "m/s",
    "command_yaw": "rad/s",
    "gait_frequency": "Hz",
    "base_com": "m",
    "timestep": "s",
    "control_dt": "s",
    "control_rate": "Hz",
}
GAIT_CLOCK = (
    "gait_phase is computed, not measured: sine and cosine of 2 pi f t with f in gait_frequency (Hz) and t "
    "the seconds since the start; it may go on while the command is at most 0.1 in size, where the policy "
    "was trained on zeros: the file sets it to zero there"
)
SCAN = "height_scan"
HEIGHT_SCAN = observe.Quantity(
    None,
    "m",
    "height of the base's frame above the ground - 0.5, clipped to +-1, at 17 x 11 points 0.1 m apart around "
    "the base, turned with its yaw alone: x from -0.8 to 0.8, for each y from -0.5 (right) to 0.5. Once, not "
    "for each reading. How to fill it from a map, and what a missing point reads: robots/DEPLOY.md",
    "scan",
)
LICENCE = "dynappo and its bundled policies: Apache-2.0; a policy of your own: as you decide"


def table(policy: Policy) -> list[tuple[str, slice]]:
    """The parts of the file's `obs`, and where each is."""
    parts = observe.reading(policy.observation, policy.own)
    every = [
        (name, slice(rows.start * policy.history, rows.stop * policy.history))
        for name, rows in parts.items()
    ]
    if policy.scan == "grid":
        start = every[-1][1].stop
        every.append((SCAN, slice(start, start + len(scan.points()))))
    return every


def order(policy: Policy) -> np.ndarray:
    """The policy's own columns (newest reading first) in the order of the file."""
    parts = observe.reading(policy.observation, policy.own)
    width, ages = len(observe.columns(policy.observation, policy.own)), range(policy.history)[::-1]
    rows = [np.arange(p.start, p.stop) + age * width for p in parts.values() for age in ages]
    last = len(scan.points()) * (policy.scan == "grid")
    return np.concatenate([*rows, policy.history * width + np.arange(last)])


def observation_table(policy: Policy) -> list[dict[str, Any]]:
    """The observation as rows `name start stop unit content noise`; numbers [start, stop) of `obs`.

    `noise` is the half width of the uniform noise in training, None where the config lacks it.
    """
    noise, out = policy.config.get("task", {}).get("noise", {}), []
    for name, rows in table(policy):
        part = HEIGHT_SCAN if name == SCAN else observe.quantity(name, policy.own)
        half_width = noise.get(part.noise) if part.noise else 0.0
        facts = dict(name=name, start=rows.start, stop=rows.stop, unit=part.unit)
        out.append(facts | dict(content=part.content, noise=half_width))
    return out


def about(policy: Policy, robot: robot_lib.Robot) -> dict[str, Any]:
    """All that a robot needs beside the network: the policy's fields, and what follows from them."""
    model, control_dt = robot.mj_model, policy.timestep * policy.substeps
    fields = policy._asdict()
    config = fields.pop("config")
    for name in ("params", "mjcf", "seed", *policy_file.TRAINED):
        del fields[name]
    if policy.gait_frequency is not None:
        fields["gait_clock"] = GAIT_CLOCK
    return fields | {
        "default_pose": policy.default_pose.tolist(),
        "joint_range": [model.joint(name).range.tolist() for name in policy.joint_names],
        "base_com": model.body_ipos[robot.base_body].tolist(),
        "control_dt": control_dt,
        "control_rate": 1 / control_dt,
        "history_order": "of each quantity the oldest reading first",
        "observation_table": observation_table(policy),
        "units": UNITS,
        "dynappo": versions.of("dynappo"),
        "licence": LICENCE,
        "config": config,
    }


def _float32(name: str, value) -> np.ndarray:
    """As the network holds it; ConfigError where that is not finite."""
    with np.errstate(over="ignore"):
        array = np.asarray(value, np.float32, order="C")
    if not np.isfinite(array).all():
        raise ConfigError(f"not written: {name} is not finite in float32")
    return array


class Graph:
    """Nodes and constants of a network that is being put together; names are those of its outputs."""

    def __init__(self):
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def node(self, kind: str, *inputs: str, name: str, **attributes) -> str:
        from onnx import helper

        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def constant(self, name: str, value) -> str:
        return self.array(name, _float32(name, value))

    def array(self, name: str, value) -> str:
        from onnx import numpy_helper

        self.weights.append(numpy_helper.from_array(value, name))
        return name


def add_network(
    graph: Graph, params: dict, activation: str, x: str, name: str, rows: Any = slice(None)
) -> str:
    """The actor of `params` on `x`, whose numbers are the network's own in the order `rows`."""
    layers = params["actor"]["params"]
    for i in range(len(layers)):
        layer, last = layers[f"Dense_{i}"], i == len(layers) - 1
        kernel = layer["kernel"][rows] if i == 0 else layer["kernel"]
        kernel = graph.constant(f"kernel_{i}", kernel)
        bias = graph.constant(f"bias_{i}", layer["bias"])
        x = graph.node("Gemm", x, kernel, bias, name=f"linear_{i}")
        if last:
            limit = policy_file.MAX_MEAN
            ends = (
                graph.constant("lowest_action", -limit),
                graph.constant("highest_action", limit),
            )
            return graph.node("Clip", x, *ends, name=name)
        if activation == "swish":  # an operator of its own only from opset 24 on
            gate = graph.node("Sigmoid", x, name=f"gate_{i}")
            x = graph.node("Mul", x, gate, name=f"hidden_{i}")
        else:
            x = graph.node(activation.capitalize(), x, name=f"hidden_{i}")
    raise ValueError("a network without layers")


def values(name: str, size: int, text: str):
    """An input or output [batch, size]."""
    from onnx import TensorProto, helper

    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size], doc_string=text)


def checked(graph: Graph, inputs: list, outputs: list, facts: dict[str, Any], text: str):
    """The graph as an `onnx.ModelProto`; every metadata value is JSON."""
    import onnx
    from onnx import helper

    made = helper.make_graph(graph.nodes, "policy", inputs, outputs, initializer=graph.weights)
    model = helper.make_model(
        made,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="dynappo",
        producer_version=facts["dynappo"],
        doc_string=text,
    )
    helper.set_model_props(
        model, {name: policy_file.to_json(value) for name, value in facts.items()}
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def onnx_model(policy: Policy, facts: dict[str, Any], targets: bool = False):
    """The actor as an `onnx.ModelProto`, checked; every metadata value is JSON.

    `targets` adds an output: the joint position targets, `default_pose + action_scale * action` (rad).
    """
    from onnx import TensorProto

    graph, x = Graph(), "obs"
    node, constant, columns = graph.node, graph.constant, order(policy)
    if policy.gait_frequency is not None:  # a robot's clock goes on where the policy saw zeros
        places = {part: np.arange(rows.start, rows.stop) for part, rows in table(policy)}
        places["others"] = np.setdiff1d(np.arange(len(columns)), places["gait_phase"])
        others, phase, command = (
            node(
                "Gather",
                x,
                graph.array(f"{part}_places", np.asarray(places[part], np.int64)),
                name=part,
                axis=1,
            )
            for part in ("others", "gait_phase", "command")
        )
        of_reading = np.kron(np.eye(policy.history), np.ones((3, 2)))
        squares = node("Mul", command, command, name="command_squares")
        squares = node("MatMul", squares, constant("of_reading", of_reading), name="command_size")
        moves = node("Greater", squares, constant("still", gait.STILL**2), name="moves")
        moves = node("Cast", moves, name="moving", to=TensorProto.FLOAT)
        phase = node("Mul", phase, moves, name="gait_phase_moving")
        x = node("Concat", others, phase, name="seen", axis=1)
        columns = columns[np.concatenate([places["others"], places["gait_phase"]])]
    x = add_network(graph, policy.params, policy.activation, x, "action", columns)
    if targets:
        x = node("Mul", x, constant("action_scale", policy.action_scale), name="scaled")
        node("Add", x, constant("default_pose", policy.default_pose), name="targets")
    size, joints = len(columns), len(policy.joint_names)
    rows = [
        f"{r['start']}-{r['stop'] - 1} {r['name']} ({r['unit']})"
        for r in facts["observation_table"]
    ]
    outputs = [values("action", joints, "raw; it is also the previous_action of the next step")]
    if targets:
        outputs.append(values("targets", joints, "joint positions, rad"))
    text = (
        f"Walking policy of {policy.robot}. Joint position targets (rad) are default_pose + "
        "action_scale * action, followed by a PD of gains kp and kd at the motors; one action "
        "every control_dt. Each metadata value is JSON. How to use it: robots/DEPLOY.md of dynappo."
    )
    return checked(graph, [values("obs", size, "; ".join(rows))], outputs, facts, text)


def save(policy: Policy, robot: robot_lib.Robot, out: Path, targets: bool = False) -> None:
    """Write `policy` as `out` says by its suffix; the file appears at once, whole.

    ConfigError if onnx is not installed, or a number is not finite.
    """
    try:
        if out.suffix == ".npz":
            entry = policy_file.to_json(policy_file.about(policy))
            far = policy_file.trained(policy._asdict())
            policy_file.save_params(out, policy.params, about=entry, **far)
            return
        data = onnx_model(policy, about(policy, robot), targets).SerializeToString(
            deterministic=True
        )
        with files.replacing(out) as part:
            part.write_bytes(data)
    except ImportError as error:
        raise ConfigError(
            f"--out={out}: {error.name} is not installed; {shell.install('export')}"
        ) from None

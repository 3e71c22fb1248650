"""A policy of another package's environment as an ONNX network: its own observation in, its action out.

The scaling of observations is in the first layer, and the tanh at the end, of brax's the clip, is part of the
network. What one number of the observation is, and what an action does, its source says.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from dynappo.config import ConfigError, files, shell, versions
from dynappo.export import onnx_file
from dynappo.policy import recorded
from dynappo.policy.policy_file import Other
from dynappo.tasks import names


def check(policy: Other, path: Path, flags) -> None:
    """ConfigError for what is for dynappo's robots alone."""
    env = policy.config.env
    names.check(env)
    if flags.out.suffix != ".onnx":
        raise ConfigError(f"--out={flags.out}: a policy of {env} is written as FILE.onnx alone")
    for name in ("joint_order", "targets"):
        if getattr(flags, name):
            raise ConfigError(
                f"--{name.replace('_', '-')}: {env} has an order and targets of its own"
            )


def save(policy: Other, path: Path, out: Path) -> dict[str, Any]:
    """Write the network; its metadata, which are returned too."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "facts.json"
        status = recorded.facts(path, file)
        if status:
            sys.exit(status)  # it has said why
        facts = json.loads(file.read_text())
    package = facts.pop("package")
    facts |= {"dynappo": versions.of("dynappo"), package: versions.of(package)}
    facts |= {"config": policy.config.to_dict()}
    try:
        data = onnx_model(policy, facts).SerializeToString(deterministic=True)
    except ImportError as error:
        raise ConfigError(
            f"--out={out}: {error.name} is not installed; {shell.install('export')}"
        ) from None
    with files.replacing(out) as part:
        part.write_bytes(data)
    return facts


def onnx_model(policy: Other, facts: dict[str, Any]):
    """The network as an `onnx.ModelProto`, checked; every metadata value is JSON."""
    graph = onnx_file.Graph()
    activation = policy.config.ppo.activation
    mean = onnx_file.add_network(graph, policy.params, activation, "obs", "mean")
    if facts["squash"] == "tanh":
        graph.node("Tanh", mean, name="action")
    else:
        ends = (
            graph.constant(f"{end}_taken", x) for end, x in (("lowest", -1.0), ("highest", 1.0))
        )
        graph.node("Clip", mean, *ends, name="action")
    size = policy.params["actor"]["params"]["Dense_0"]["kernel"].shape[0]
    told = f"the observation of {facts['task']}"
    inputs = [onnx_file.values("obs", size, told)]
    outputs = [onnx_file.values("action", len(facts["actuator_names"]), "-1 to 1")]
    return onnx_file.checked(
        graph, inputs, outputs, facts, f"Policy of {facts['task']}. {facts['how']}"
    )


def table(facts: dict[str, Any], policy: Other, out: Path) -> list[tuple[str, str]]:
    """What was written, as (name, text) for printing."""
    size = policy.params["actor"]["params"]["Dense_0"]["kernel"].shape[0]
    kind = f"ONNX, float32, opset {onnx_file.OPSET}"
    return [
        ("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB, {kind})"),
        ("input", f"obs [batch, {size}]: its own observation, not scaled"),
        (
            "output",
            f"action [batch, {len(facts['actuator_names'])}]: -1 to 1, as its step takes it",
        ),
        ("joints", " ".join(facts["joint_names"])),
        ("every", f"{facts['control_dt']:g} s; all else is in the metadata"),
    ]

"""Networks that learn as if parts of an observation came in other units; `policy_units`.

Joint velocities are ten times larger than angles, and noisy. With `ppo.scale_inputs` policy and value
function learn as networks that see s x instead of x, where s is `Env.input_scale`. The first layer W of such
a network has

    W (s x) = U x,   U = s W:   grad_W = s grad_U,   and a step of W by d is a step of U by s d

So U starts as s times the initial W, and gradient and step are multiplied by s. The networks themselves see
x: policies, ONNX files and checkpoints know nothing of units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dynappo.types import Env, Static

# a tree of weights, gradients or steps, with those of the first layers times s
Units = Callable[[Any], Any]


def policy_units(static: Static, env: Env) -> Units | None:
    """The units of `{"actor", "critic", "std"}`, or None without `ppo.scale_inputs`.

    ValueError if the environment has no scale.
    """
    if not static.ppo.scale_inputs:
        return None
    scale, views = env.input_scale, env.views
    if scale is None:
        raise ValueError(
            "ppo.scale_inputs is True: this environment has no input_scale; set it to False"
        )
    actor = critic = scale if views is None else scale[views.actor]
    if static.ppo.critic == "state" and views is not None:
        critic = scale[views.critic]

    def scaled(network, by):
        first = network["params"]["Dense_0"]
        first = first | {"kernel": first["kernel"] * by[:, None]}
        return {"params": network["params"] | {"Dense_0": first}}

    def units(tree):
        actor_tree, critic_tree = tree["actor"], tree["critic"]
        return tree | {"actor": scaled(actor_tree, actor), "critic": scaled(critic_tree, critic)}

    return units


def apply(tree: Any, units: Units | None) -> Any:
    """`units` of a tree; without, the tree itself."""
    return tree if units is None else units(tree)

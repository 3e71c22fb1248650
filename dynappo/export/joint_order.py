"""The joint orders of robots and simulators, and policies permuted to them.

Rows and columns of a policy's first and last weights are permuted, so the robot need not reorder
anything.
"""

from __future__ import annotations

import collections
from typing import Any

import numpy as np

from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.policy import checks
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import observe
from dynappo.terrain import scan

ORDERS = ("mjcf", "isaaclab", "unitree")
# Motor numbers 0-11 of Go1 and Go2, each leg hip to calf: unitree_legged_sdk, quadruped.h (FR_0 = 0,
# FL_0 = 3, RR_0 = 6, RL_0 = 9) and unitree_sdk2, dds_wrapper/robots/go2/defines.h (JointIndex)
UNITREE_LEGS = ("FR", "FL", "RR", "RL")
# Motor numbers 0-28 of a G1: unitree_sdk2, example/g1/low_level/g1_ankle_swing_example.cpp (G1JointIndex)
_LEG = "hip_pitch hip_roll hip_yaw knee ankle_pitch ankle_roll".split()
_ARM = "shoulder_pitch shoulder_roll shoulder_yaw elbow wrist_roll wrist_pitch wrist_yaw".split()
UNITREE_G1 = (
    *(f"{side}_{name}_joint" for side in ("left", "right") for name in _LEG),
    *(f"waist_{name}_joint" for name in ("yaw", "roll", "pitch")),
    *(f"{side}_{name}_joint" for side in ("left", "right") for name in _ARM),
)


def parse(
    text: str | None, own: tuple[str, ...], robot: robot_lib.Robot
) -> tuple[tuple[str, ...], str]:
    """`(names, text)` of `--joint-order=TEXT`; without it the policy's own order, `own`.

    ConfigError if the robot has no such order, or the names are not its joints, once each.
    """

    def expect(ok, reason):
        if not ok:
            raise ConfigError(f"--joint-order={text}: {reason}")

    names = robot.joint_names
    legs = collections.defaultdict(list)
    for name in names:
        legs[name.partition("_")[0]].append(name)
    if text is None:
        return own, "mjcf" if own == names else "the policy's own"
    if text == "mjcf":
        return names, text
    if text == "isaaclab":
        return _breadth_first(robot), text
    if text == "unitree" and set(names) == set(UNITREE_G1):
        return UNITREE_G1, text
    if text == "unitree":
        expect(set(legs) == set(UNITREE_LEGS), f"{robot.name} has the legs {' '.join(legs)}")
        return tuple(name for leg in UNITREE_LEGS for name in legs[leg]), text
    given = tuple(name.strip() for name in text.split(","))
    unknown = [name for name in given if name not in names]
    known = f"expected {', '.join(ORDERS)} or the joints {','.join(names)}"
    expect(not unknown, f"{robot.name} has no joint {', '.join(unknown)}; {known}")
    twice = [name for name in names if given.count(name) > 1]
    expect(not twice, f"{', '.join(twice)} is there more than once")
    lacks = [name for name in names if name not in given]
    expect(not lacks, f"lacks {', '.join(lacks)}")
    return given, "as named"


def _breadth_first(robot: robot_lib.Robot) -> tuple[str, ...]:
    """The order of PhysX: by the number of joints above, and siblings by name.

    isaac-sim/IsaacLab .../velocity/mdp/symmetry/anymal.py lists ANYmal's; `joint_ids_map` of the deploy.yaml
    that unitree_rl_lab writes is for Go2 3 0 9 6, 4 1 10 7, 5 2 11 8 in motor numbers.
    """
    model, below = robot.mj_model, collections.defaultdict(list)
    for i, name in enumerate(robot.joint_names, 1):
        above, body = i - 1, model.jnt_bodyid[i]  # the joint before it, if that is in the same body
        if above < model.body_jntadr[body]:
            while (body := model.body_parentid[body]) and not model.body_jntnum[body]:
                pass
            above = model.body_jntadr[body] + model.body_jntnum[body] - 1
        below[above].append((name, i))
    order, level = [], [0]  # 0 is the base's free joint
    while level:
        found = [joint for above in level for joint in sorted(below[above])]
        order += [name for name, _ in found]
        level = [i for _, i in found]
    return tuple(order)


def permute(policy: Policy, names: tuple[str, ...]) -> Policy:
    """The same policy with its joints in the order `names`, in observations and actions alike.

    If the robot's joints are read and driven in that order, it does what it did before.
    """
    order = np.array([policy.joint_names.index(name) for name in names])
    one = np.arange(len(observe.columns(policy.observation, policy.own)))
    for name, part in observe.reading(policy.observation, policy.own).items():
        if observe.quantity(name, policy.own).size is None:  # a number a joint
            one[part] = one[part][order]
    rows = [one + age * len(one) for age in range(policy.history)]
    seen = len(scan.points()) * (policy.scan == "grid")  # the same in any order of joints
    rows = np.concatenate([*rows, policy.history * len(one) + np.arange(seen)])

    def layers(network):
        """The layers of a network, for observations in the new order."""
        first = network["params"]["Dense_0"]
        return network["params"] | {"Dense_0": first | {"kernel": first["kernel"][rows]}}

    params = dict(policy.params)
    params["actor"] = {"params": layers(params["actor"])}
    critic = params.pop("critic", None)
    if critic and len(critic["params"]["Dense_0"]["kernel"]) == len(rows):
        params["critic"] = {
            "params": layers(critic)
        }  # else it sees other numbers: no robot needs it
    actor = params["actor"]["params"]
    name = f"Dense_{len(actor) - 1}"
    last = actor[name]
    actor[name] = last | {"kernel": last["kernel"][:, order], "bias": last["bias"][order]}
    if "std" in params:
        params["std"] = params["std"][order]
    fields: dict[str, Any] = {}
    for field in ("joint_names", *checks.OF_JOINTS, *checks.PER_JOINT):
        value = getattr(policy, field)
        if isinstance(value, np.ndarray):
            fields[field] = value[order]
        elif isinstance(value, tuple) and value:  # else one number for all joints, or not known
            fields[field] = tuple(value[i] for i in order)
    return policy._replace(params=params, **fields)

"""A policy's settings as the `deploy.yaml` that unitree_rl_lab's controllers read beside an ONNX file.

The fields are those of its export_deploy_cfg.py: joints and gains, times, ranges of commands, the action, and
the observation term by term, in the order in which they follow each other in `obs`; of each term
`history_length` readings, the oldest first. The gait clock's `period` (s) is that of the middle of
`task.gait_frequency`. `joint_ids_map` gives the motor number of each joint of the
policy; `stiffness` and `damping` are in the order of the motors, `scale` and `offset` in that of the policy.
"""

from __future__ import annotations

import json

import numpy as np

from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.export import joint_order
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import observe

TERMS = dict(
    joint_position="joint_pos_rel",
    joint_velocity="joint_vel_rel",
    gravity="projected_gravity",
    angular_velocity="base_ang_vel",
    command="velocity_commands",
    previous_action="last_action",
    gait_phase="gait_phase",
)


def motors(robot: robot_lib.Robot) -> tuple[str, ...]:
    """The joints in the order of the motors: Unitree's, or that of the MJCF for other robots."""
    legs = {name.partition("_")[0] for name in robot.joint_names}
    theirs = legs == set(joint_order.UNITREE_LEGS)
    theirs |= set(robot.joint_names) == set(joint_order.UNITREE_G1)
    text = "unitree" if theirs else "mjcf"
    return joint_order.parse(text, robot.joint_names, robot)[0]


def text(policy: Policy, robot: robot_lib.Robot) -> str:
    """The file's content; ConfigError for a policy that sees what those controllers do not measure."""
    parts = observe.reading(policy.observation, policy.own)
    unknown = [name for name in parts if name not in TERMS] + ["height scan"] * (
        policy.scan != "none"
    )
    if unknown:
        raise ConfigError(
            f"a deploy.yaml has no {', '.join(unknown)}, which this policy of {policy.robot} sees; export "
            f"one trained with task.observation=onboard, as {policy.robot}_deploy"
        )
    order = motors(robot)
    of_motor = [policy.joint_names.index(name) for name in order]
    kp, kd, scale = (
        np.broadcast_to(np.asarray(x, float), len(order))
        for x in (policy.kp, policy.kd, policy.action_scale)
    )
    ranges = zip(
        ("lin_vel_x", "lin_vel_y", "ang_vel_z"),
        (policy.command_x, policy.command_y, policy.command_yaw),
        strict=True,
    )
    pose = policy.default_pose.tolist()
    lines = [
        f"joint_ids_map: {[order.index(name) for name in policy.joint_names]}",
        f"step_dt: {policy.timestep * policy.substeps:g}",
        f"stiffness: {kp[of_motor].tolist()}",
        f"damping: {kd[of_motor].tolist()}",
        f"default_joint_pos: {pose}",
        "commands:",
        "  base_velocity:",
        "    ranges:",
        *(f"      {name}: {list(values)}" for name, values in ranges),
        "      heading: null",
        "actions:",
        "  JointPositionAction:",
        "    clip: null",
        '    joint_names: [".*"]',
        f"    scale: {scale.tolist()}",
        f"    offset: {pose}",
        "    joint_ids: null",
        "observations:",
    ]
    params_of: dict[str, dict] = {"command": {"command_name": "base_velocity"}}
    if policy.gait_frequency is not None:
        params_of["gait_phase"] = {"period": 1 / float(np.mean(policy.gait_frequency))}
    for name, rows in parts.items():
        lines += [
            f"  {TERMS[name]}:",
            f"    params: {json.dumps(params_of.get(name, {}))}",
            "    clip: null",
            f"    scale: {[1.0] * (rows.stop - rows.start)}",
            f"    history_length: {policy.history}",
        ]
    return "\n".join(lines) + "\n"

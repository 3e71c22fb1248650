"""Joint orders: those of their sources, and policies that do the same in each of them."""

import json

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import other_robots
import pytest
from answers import refused
from toy_onnx import (
    ANYMAL_IN_ISAACLAB,
    GO2_IN_ISAACLAB,
    MOTORS,
    SHUFFLED,
    described,
    infer,
    observations,
    session,
)
from toy_policy import GO1, ROBOTS

from dynappo.description import robot as robot_lib
from dynappo.export import deploy_yaml, joint_order, onnx_file
from dynappo.learner import networks
from dynappo.physics import actuators


def order_of(text, name):
    """The names that `--joint-order=TEXT` means for a robot's policy in MJCF order."""
    robot = robot_lib.load(name)
    return joint_order.parse(text, robot.joint_names, robot)[0]


def test_named_orders_are_those_of_their_sources():
    for name in ("go1", "go2"):
        assert order_of("unitree", name) == MOTORS
        assert order_of("isaaclab", name) == GO2_IN_ISAACLAB
    for name in ("anymal_c", "anymal_d"):
        assert order_of("isaaclab", name) == ANYMAL_IN_ISAACLAB
    for name in ROBOTS:
        assert order_of(None, name) == order_of("mjcf", name) == robot_lib.load(name).joint_names
    assert order_of(", ".join(SHUFFLED), "go1") == SHUFFLED


def test_isaac_numbers_the_joints_of_a_humanoid_breadth_first():
    """The 29 joints of a G1 as policies that were trained in Isaac Lab have them, in motor numbers."""
    leg = "hip_pitch hip_roll hip_yaw knee ankle_pitch ankle_roll".split()
    arm = "shoulder_pitch shoulder_roll shoulder_yaw elbow wrist_roll wrist_pitch wrist_yaw".split()

    def chain(names, end=""):
        for name in reversed(names):
            end = f'<body><geom size=".1"/><joint name="{name}_joint"/>{end}</body>'
        return end

    arms = [chain([f"{side}_{name}" for name in arm]) for side in ("left", "right")]
    limbs = [chain([f"{side}_{name}" for name in leg]) for side in ("left", "right")]
    limbs += [chain(["waist_yaw", "waist_roll", "waist_pitch"], "".join(arms))]
    base = f'<body><freejoint/><geom size=".1"/>{"".join(limbs)}</body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{base}</worldbody></mujoco>")
    names = tuple(model.joint(i).name for i in range(1, 30))
    assert names[12] == "waist_yaw_joint" and names[22] == "right_shoulder_pitch_joint"
    robot = GO1._replace(mj_model=model, joint_names=names)
    expected = [0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11, 17, 24]
    expected += [18, 25, 19, 26, 20, 27, 21, 28]
    found = joint_order.parse("isaaclab", names, robot)[0]
    assert [names.index(name) for name in found] == expected


def test_isaac_takes_joints_of_one_body_one_after_the_other():
    robot = other_robots.biped()
    found = joint_order.parse("isaaclab", robot.joint_names, robot)[0]
    parts = "hip_yaw hip_roll hip_pitch knee ankle_pitch ankle_roll".split()
    assert found == tuple(f"{side}_{part}" for part in parts for side in ("left", "right"))


def test_an_order_that_a_robot_has_not_is_one_line():
    """A name that is no joint, one too few, one twice, motor numbers of another maker."""
    for text, name, expected in (
        ("x,FL_hip_joint", "go2", "go2 has no joint x; expected mjcf, isaaclab, unitree or"),
        ("", "go2", "expected mjcf, isaaclab, unitree or"),
        (",".join(MOTORS[:11]), "go2", "lacks RL_calf_joint"),
        (",".join(MOTORS + MOTORS[:1]), "go2", "FR_hip_joint is there more than once"),
        ("unitree", "anymal_c", "anymal_c has the legs LF RF LH RH"),
    ):
        line = refused(order_of, text, name)
        assert line.startswith(f"--joint-order={text}: ") and expected in line


@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("go1", MOTORS),
        ("go2", GO2_IN_ISAACLAB),
        ("anymal_c", ANYMAL_IN_ISAACLAB),
        ("go1", SHUFFLED),
    ],
)
def test_another_order_is_the_same_policy(name, names):
    """Observations of the same situations, joints reordered by name, give the reordered actions."""
    policy, robot, static = described(name)
    before = jax.tree.map(np.copy, policy.params)
    other = joint_order.permute(policy, names)
    there = [policy.joint_names.index(joint) for joint in names]
    assert there != list(range(12)) and other.joint_names == names
    obs, reordered = observations(policy.joint_names), observations(names)
    expected = infer(session(policy, robot), obs)
    net = session(other, robot, targets=True)
    np.testing.assert_allclose(infer(net, reordered), expected[:, there], atol=1e-6)
    targets = actuators.target(expected, policy.default_pose, policy.action_scale)
    np.testing.assert_allclose(infer(net, reordered, "targets"), targets[:, there], atol=1e-6)
    one, same = (
        networks.value(static, p.params, jnp.asarray(x))
        for p, x in ((policy, obs), (other, reordered))
    )
    np.testing.assert_allclose(one, same, atol=1e-5)
    np.testing.assert_array_equal(other.params["std"], policy.params["std"][there])
    for field in ("default_pose", "joint_damping", "joint_friction"):
        by_name = [
            dict(zip(p.joint_names, getattr(p, field), strict=True)) for p in (policy, other)
        ]
        assert by_name[0] == by_name[1], field
    # there and back is the same, and the policy that was given is as it was
    back = joint_order.permute(other, policy.joint_names)
    for params in (back.params, policy.params):
        jax.tree.map(np.testing.assert_array_equal, params, before)


def test_motors_of_each_joint_keep_their_joints_in_every_order():
    """Numbers of each joint follow their names: in the policy, the ONNX file and the deploy.yaml."""
    policy, robot, _ = described("go2")
    own = np.arange(12) + 1.0
    policy = policy._replace(
        observation="onboard-45", kp=own, kd=own / 10, action_scale=own / 100, effort_limit=3.0
    )
    policy.params["actor"]["params"]["Dense_0"]["kernel"] = np.ones((45, 32), np.float32)
    del policy.params["critic"]
    names = SHUFFLED
    other = joint_order.permute(policy, names)
    there = [policy.joint_names.index(joint) for joint in names]
    np.testing.assert_array_equal(other.kp, own[there])
    assert other.effort_limit == 3.0 and other.command_x == policy.command_x
    facts = onnx_file.about(other, robot)
    assert facts["kd"].tolist() == (own[there] / 10).tolist()
    text = yaml_of(deploy_yaml.text(other, robot))
    numbers = [text["stiffness"][i] for i in text["joint_ids_map"]]  # by motor, of each joint
    assert numbers == own[there].tolist()
    assert text["damping"] == [own[policy.joint_names.index(joint)] / 10 for joint in MOTORS]
    assert text["scale"] == (own[there] / 100).tolist()
    net, obs = session(other, robot, targets=True), np.zeros((2, 45), np.float32)
    action = net.run(["action"], {"obs": obs})[0]
    targets = other.default_pose + own[there] / 100 * action
    np.testing.assert_allclose(net.run(["targets"], {"obs": obs})[0], targets, atol=1e-6)


def yaml_of(text):
    """The lists of a deploy.yaml, by name."""
    lines = [line.strip().partition(": ") for line in text.splitlines() if "[" in line]
    # of `scale`, the first is that of the actions
    return {name: json.loads(value) for name, _, value in reversed(lines) if value[-1] == "]"}

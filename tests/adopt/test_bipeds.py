"""A robot on two feet gets a biped's config: by tree and axes, whatever its joints are called."""

import os
import re
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import other_robots
import pytest
from answers import status

from dynappo import config as config_lib
from dynappo.adopt import bipeds, command, gains, joint_roles, source
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.program import build

run = partial(status, command.main)
VARIANTS = "best", "ppo", "deploy", "quick", "laptop", "ppo16"
# rad, of the joints in the toy's order
LEG = dict(hip_yaw=0.15, hip_roll=0.15, hip_pitch=0.3, knee=0.35, ankle_pitch=0.25, ankle_roll=0.1)
TOY = [*LEG.values()] * 2 + [0.5] * 2


def symmetric(robot: robot_lib.Robot) -> str:
    """The toy's text with no roll in its pose, and joints j0, j1, ..."""
    spec = mujoco.MjSpec.from_string(robot.text)
    key, pose = spec.keys[0], np.array(spec.keys[0].qpos)
    pose[[8, 12, 14, 18]] = 0.0
    key.qpos = pose
    spec.compile()
    text = spec.to_xml()
    for i, name in enumerate(robot.joint_names):
        text = text.replace(f'"{name}"', f'"j{i}"')
    return text


@pytest.fixture(scope="module")
def adopted(tmp_path_factory):
    """`(robot, config)` of the toy with arms, its joints without names that say something."""
    folder, before = tmp_path_factory.mktemp("biped"), Path.cwd()
    os.chdir(folder)
    try:
        Path("toy.xml").write_text(symmetric(other_robots.biped(arms=True)))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(command, "look", lambda *_: [])
            assert run("toy.xml", "--name=mine") == 0
        yield robot_lib.load("mine"), config_lib.load("configs/mine.py")
    finally:
        os.chdir(before)


def test_the_rule_gives_the_g1_its_own_numbers():
    """Of every joint, those that configs/g1.py has by name."""
    robot = robot_lib.load("g1")
    config, _ = motors.fitted(config_lib.validate(config_lib.load("g1")), robot)
    chosen, _ = bipeds.choose(robot)
    np.testing.assert_array_equal(chosen.posture_std, config.task.posture_std)
    assert chosen.gait_frequency == config.task.gait_frequency
    for name in ("gait_foot_height", "clearance_height", "feet_apart"):
        assert getattr(chosen, name) == config.task[name]
    assert chosen.joint_torques == config.task.weights.joint_torques


def test_every_variant_of_an_adopted_biped_can_be_built(adopted):
    for variant in VARIANTS:
        build.check(config_lib.validate(config_lib.load(f"configs/mine.py:{variant}")))


def test_an_adopted_biped_has_the_task_of_the_g1(adopted):
    """But for what depends on the robot: at the same Froude number, its torques, its feet."""
    robot, config = adopted
    g1, mass = config_lib.load("g1"), robot.mj_model.body_mass.sum()
    fitted, _ = motors.fitted(config_lib.validate(config), robot)
    np.testing.assert_array_equal(fitted.task.posture_std, TOY)
    height = robot.home_qpos[2] / 0.757
    np.testing.assert_allclose(
        config.task.gait_frequency, np.array([1.25, 1.5]) / height**0.5, atol=0.01
    )
    lengths = dict(gait_foot_height=0.15, clearance_height=0.06, feet_apart=0.2)
    for name, of_g1 in lengths.items():
        assert config.task[name] == pytest.approx(of_g1 * height, rel=0.05)
    weights = config.task.weights
    assert weights.joint_torques == pytest.approx(-2e-6 * (33.34 / mass) ** 1.5, rel=0.05)
    weights.joint_torques = g1.task.weights.joint_torques
    assert weights == g1.task.weights
    for group in ("ppo", "model", "schedule", "rollout", "run", "physics"):
        assert config[group] == g1[group]
    for name in (
        "command_x",
        "command_y",
        "max_tilt",
        "fall_reward",
        "posture_std_standing",
        "noise",
    ):
        assert config.task[name] == g1.task[name]
    assert config.task.reset.spawn_height == pytest.approx(robot.home_qpos[2] + 0.05, abs=0.006)
    payload = min(0.1 * mass, 0.3 * 8.0)
    np.testing.assert_allclose(config.task.randomize.base_mass, (-payload, payload), atol=0.06)
    high = config_lib.load("configs/mine.py:deploy").task.randomize.base_mass
    np.testing.assert_allclose(high, (-payload, 2 * payload), atol=0.2)


def sized(size: float, narrow: float = 1.0) -> robot_lib.Robot:
    """The toy at `size` times its lengths, its legs `narrow` times as far apart."""
    toy = other_robots.biped()
    model, home = toy.mj_model, toy.home_qpos.copy()
    for side in ("left", "right"):
        model.body(f"{side}_thigh").pos[1] *= narrow
    model.body_pos[:] *= size
    model.geom_pos[:] *= size
    home[:3] *= size
    return toy._replace(home_qpos=home)


@pytest.mark.parametrize(
    ("size", "narrow", "expected"),
    [
        (1.0, 1.0, (0.11, 0.044, 0.15)),  # a base at 0.555 m, feet 0.16 m apart
        (0.5, 1.0, (0.055, 0.022, 0.073)),
        (1.8, 1.0, (0.20, 0.079, 0.26)),
        (1.8, 0.7, (0.20, 0.079, 0.20)),  # 0.2016 m
        (0.5, 0.5, (0.055, 0.022, 0.04)),
        (1.0, 0.0, (0.11, 0.044, 0.0)),
    ],
)
def test_lengths_of_rewards_go_with_the_height_of_the_base(size, narrow, expected):
    """And feet that stand closer need not be further apart, so the default pose costs nothing."""
    task, told = bipeds.choose(sized(size, narrow))
    assert (task.gait_foot_height, task.clearance_height, task.feet_apart) == expected
    assert all(f" {length:g} m " in "".join(told) for length in expected)
    assert ("in the default pose, which is less" in "".join(told)) == (narrow < 1)


LINK = other_robots.inertial(0.3, 0.0)
UPPER = f"""<body name="torso" pos="0 0 .1"><joint name="w" axis="0 0 1" range="-1 1"/>{LINK}
  <body name="head" pos="0 0 .3"><joint name="h" axis="0 1 0" range="-1 1"/>{LINK}</body>"""
ARM = (
    ("0 {} .2", 0, "0 1 0"),
    ("0 0 0", 1, "1 0 0"),
    ("0 0 0", 2, "0 0 1"),
    ("0 0 -.2", 3, "0 1 0"),
)
ARM += (("0 0 -.2", 4, "1 0 0"),)


def arm(side, y):
    """Shoulder (pitch, roll, yaw), elbow, wrist, two fingers."""
    link = f"<body name='{side}{{1}}' pos='{{0}}'>{LINK}<joint name='{side}{{1}}' range='-1 1' axis='{{2}}'/>"
    fingers = [link.format(f"{x} 0 0", 5 + (x < 0), "0 1 0") + "</body>" for x in (0.02, -0.02)]
    chain = "".join(link.format(place.format(y), i, axis) for place, i, axis in ARM)
    return chain + "".join(fingers) + "</body>" * len(ARM)


def test_a_waist_arms_with_fingers_and_a_head():
    """A hand's fingers branch as arms do from a waist, but at the side."""
    upper = UPPER + arm("l", 0.2) + arm("r", -0.2) + "</body>"
    text = other_robots.biped().text
    text = text.replace('<body name="left_thigh"', upper + '<body name="left_thigh"')
    zeros = " ".join(["0"] * 16)
    text = re.sub(r'qpos="(\S+ \S+ \S+ \S+ \S+ \S+ \S+) ', rf'qpos="\1 {zeros} ', text)
    text = re.sub(r"<actuator>.*</actuator>", "", text, flags=re.S)
    robot = robot_lib.load_text(text, "toy", Path("toy.xml"))
    std, unknown = bipeds.posture(robot)
    found = dict(zip(robot.joint_names, std, strict=True))
    assert found["w"] == 0.2 and found["h"] == 0.15
    for side in "lr":
        assert [found[f"{side}{i}"] for i in range(7)] == [0.5, 0.15, 0.1, 0.15, 0.3, 0.3, 0.3]
    assert [name for name, is_so in zip(robot.joint_names, unknown, strict=True) if is_so] == ["h"]
    arms = {f"{side}{i}" for side in "lr" for i in range(7)}
    assert set(joint_roles.footless(robot)) == arms | {"h", "w"}
    assert joint_roles.footless(robot_lib.load("go1")) == []
    assert "0.15 rad at h, no leg's" in "".join(bipeds.choose(robot)[1])


def test_damping_is_alike_left_and_right_where_links_are_not():
    """Else `best`, whose policy is symmetric, refuses the robot."""
    toy = other_robots.biped(arms=True)
    count = len(toy.joint_names)
    toy.mj_model.body_inertia[toy.mj_model.body("left_arm").id] *= 0.5
    toy.mj_model.dof_armature[:] = 1e-4
    none = source.Published(*np.full((4, count), np.nan), np.zeros(count, bool))
    found, _ = gains.choose(toy, none, 1.0)
    left, right = (toy.joint_names.index(f"{side}_shoulder") for side in ("left", "right"))
    assert found.kd[left] == found.kd[right] < found.kp[left] * gains.KD_PER_KP * 0.9


def test_a_pose_of_a_scene_is_found_where_the_free_joint_has_no_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    toy = other_robots.biped()
    spec = mujoco.MjSpec.from_string(toy.text)
    assert not spec.joints[0].name
    spec.delete(spec.keys[0])
    spec.compile()
    Path("toy.xml").write_text(spec.to_xml())
    pose = " ".join(map(str, [0, 0, 1, 1, 0, 0, 0, *[0, 0, -0.3, 0.6, -0.3, 0] * 2]))
    key = f'<mujoco><include file="toy.xml"/><keyframe><key name="home" qpos="{pose}"/></keyframe></mujoco>'
    Path("scene.xml").write_text(key)
    assert run("toy.xml") == 0
    assert "that of scene.xml beside it" in capsys.readouterr().out
    assert robot_lib.load("toy").default_pose[3] == 0.6


@pytest.mark.parametrize(
    ("signs", "limits"), [((1, 1), "0 2.3"), ((1, -1), "-3 3"), ((1, 1), "-2.3 0")]
)
def test_without_a_pose_knees_are_bent_and_feet_stay_flat(signs, limits, tmp_path, monkeypatch):
    """Forward, where the knee's range allows it, whatever the signs of the axes left and right are."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    spec = mujoco.MjSpec.from_string(other_robots.biped().text)
    spec.delete(spec.keys[0])
    for side, sign in zip(("left", "right"), signs, strict=True):
        for joint in ("hip_pitch", "knee", "ankle_pitch"):
            one = spec.joint(f"{side}_{joint}")
            one.axis = [0, sign, 0]
            one.range = [-3, 3] if joint != "knee" else np.array(limits.split(), float)
    spec.compile()
    Path("toy.xml").write_text(spec.to_xml())
    assert run("toy.xml") == 0
    robot = robot_lib.load("toy")
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(robot.mj_model, data)
    ahead = -1 if limits.endswith(" 0") else 1
    for side in ("left", "right"):
        knee, hip = (data.joint(f"{side}_{name}").xanchor for name in ("knee", "hip_pitch"))
        assert ahead * (knee - hip)[0] == pytest.approx(np.sin(0.33) * 0.25, abs=1e-6)
        np.testing.assert_allclose(data.geom(f"{side}_foot").xmat, np.eye(3).ravel(), atol=1e-9)


@pytest.mark.parametrize(("knee", "expected"), [(0.1, 0.76), (0.4, 0.4)])
def test_straight_knees_of_a_pose_are_bent_and_others_stay(knee, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    spec = mujoco.MjSpec.from_string(other_robots.biped().text)
    spec.keys[0].qpos = [0, 0, 1, 1, 0, 0, 0, *[0, 0, -knee / 2, knee, -knee / 2, 0] * 2]
    spec.compile()
    Path("toy.xml").write_text(spec.to_xml())
    assert run("toy.xml") == 0
    pose = robot_lib.load("toy").default_pose
    np.testing.assert_allclose(pose, [0, 0, -expected / 2, expected, -expected / 2, 0] * 2)

"""Robots of other limbs: the task's sizes, resets, steps and mirror image follow from their models."""

import re
from pathlib import Path
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
import robot_files

from dynappo import config as config_lib
from dynappo.description import kinematics
from dynappo.description import robot as robot_lib
from dynappo.physics.warp import scope
from dynappo.program import memory
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import mirror

LEGS = robot_files.HEXAPOD_LEGS
ROBOTS, ACTIONS = 4, 18


@pytest.fixture(scope="module")
def hexapod():
    return robot_lib.load_text(robot_files.hexapod(), "hexapod", Path("hexapod.xml"))


@pytest.fixture(scope="module")
def biped():
    return robot_lib.load_text(robot_files.biped(), "biped", Path("biped.xml"))


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    path = tmp_path_factory.mktemp("turned") / "turned.xml"
    path.write_text(robot_files.turned())
    return robot_lib.load_xml(path)


@pytest.fixture(scope="module")
def world(hexapod):
    """A few rows of four hexapods on C MuJoCo, with all that is a number a joint."""
    config = config_lib.load("configs/go1.py")
    config.task.update(termination="base", undesired="thighs", observation="onboard", history=2)
    config.task.update(effort_limit=23.7, saturation_effort=23.7, velocity_limit=30.0)
    config.task.randomize.update(encoder_bias=0.02)
    config.physics.update(contacts="full", threads=1)
    config.ppo.critic = "state"
    config = config_lib.validate(config)
    hyper = config_lib.split(config)[1]
    env = env_lib.make(hexapod, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    first = state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    step, outcomes = jax.jit(jax.vmap(env.step, (None, 0, 0, None, 0))), []
    for _ in range(10):
        state, outcome = step(hyper, body, state, np.zeros(ACTIONS, np.float32), keys)
        outcomes.append(jax.device_get(outcome))
    return SimpleNamespace(env=env, body=body, first=first, state=state, outcomes=outcomes)


def test_sizes_follow_from_the_joints(world):
    env, (now, reading, body) = world.env, (12 + 3 * ACTIONS, 9 + 3 * ACTIONS, 7 + ACTIONS)
    assert (env.action_size, env.prop_size) == (ACTIONS, 9 + 2 * ACTIONS)
    assert env.obs_size == now + reading + body and len(env.views.actor) == 2 * reading
    assert world.body.encoder_bias.shape == (ROBOTS, ACTIONS)
    assert world.state.air_steps.shape == (ROBOTS, 6)


def test_a_reset_places_the_lowest_foot_at_the_ground_and_the_robot_then_stands(world, hexapod):
    data = mujoco.MjData(hexapod.mj_model)
    for qpos in np.asarray(world.first.qpos, float):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(hexapod.mj_model, data)
        assert (data.geom_xpos[hexapod.feet, 2] - 0.025).min() > 0.009
    assert all((outcome.discount == 1).all() for outcome in world.outcomes)
    assert np.isfinite(world.state.obs).all() and (np.asarray(world.state.qpos)[:, 2] > 0.2).all()


def test_what_is_known_of_the_next_row_is_computed(world):
    size, obs = world.env.prop_size, np.asarray(world.state.obs)
    action = np.ones((ROBOTS, ACTIONS), np.float32)
    found = world.env.advance(None, obs[:, size:], obs[:, :size], action, None)
    np.testing.assert_array_equal(found[:, :3], obs[:, size : size + 3])  # command
    np.testing.assert_array_equal(found[:, 3 : 3 + ACTIONS], action)
    reading = np.delete(obs[:, : 12 + 3 * ACTIONS], np.arange(3) + 2 * ACTIONS + 3, axis=1)
    np.testing.assert_array_equal(found[:, 3 + ACTIONS :][:, : reading.shape[1]], reading)


def test_its_mirror_image_swaps_left_and_right(world, hexapod):
    index, sign = world.env.mirror[1]
    names = np.array(hexapod.joint_names)
    assert [n[1] for n in names[index]] == [{"L": "R", "R": "L"}[n[1]] for n in names]
    assert (sign == np.where(np.char.endswith(names, "hip"), -1, 1)).all()


def test_legs_are_the_chains_from_the_base_to_each_foot(hexapod):
    legs = kinematics.legs(hexapod.mj_model, hexapod.feet)
    np.testing.assert_array_equal(legs.joints, np.arange(ACTIONS).reshape(6, 3))
    fatal, undesired = env_lib.ground_rules(
        hexapod, SimpleNamespace(termination="base", undesired="thighs")
    )
    bodies = [hexapod.mj_model.body(i).name for i in hexapod.mj_model.geom_bodyid[hexapod.parts]]
    assert [np.array(bodies)[row].tolist() for row in undesired] == [
        [f"{n}_thigh"] for n, *_ in LEGS
    ]
    assert np.array(bodies)[fatal].tolist() == ["base"]


def test_the_kernel_of_trees_takes_it(hexapod, biped):
    for robot in (hexapod, biped):
        model = robot_lib.physics_model(robot, config_lib.load("configs/go1.py").physics)
        assert scope.kernel(model, robot.feet, False) == "tree"
        assert "other limbs" in scope.no_quadruped(model, robot.feet, False)


# a biped with a waist and arms, several hinges in a body, box feet


def test_a_reset_of_a_biped_places_its_soles_above_the_ground(biped):
    config = config_lib.load("configs/go1.py")
    config.task.reset.spawn_height, config.task.reset.joint_scale = 0.0, (0.5, 1.5)
    config.physics.threads = 1
    config = config_lib.validate(config)
    # a pose of its own: its home is straight
    pose = np.random.default_rng(0).uniform(-0.4, 0.4, len(biped.default_pose))
    posed = biped._replace(default_pose=pose)
    hyper = config_lib.split(config)[1]
    env = env_lib.make(posed, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), 16)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    kept = sum(x.nbytes for x in jax.tree.leaves((state, body))) / 16
    assert abs(kept - memory.bytes_per_robot(len(pose), 2)) <= 16
    model, lowest = biped.mj_model, []
    assert state.air_steps.shape == (16, 2)
    low, high = robot_lib.joint_ranges(biped).T
    for qpos in np.asarray(state.qpos, float):
        assert np.isfinite(qpos).all() and (qpos[7:] > low).all() and (qpos[7:] < high).all()
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        floor = model.geom("floor").id
        lowest.append(
            min(mujoco.mj_geomDistance(model, data, floor, i, 9.0, None) for i in biped.feet)
        )
    np.testing.assert_allclose(lowest, config.task.reset.foot_clearance, atol=1e-5)
    free = ~np.isfinite(low)
    assert [biped.joint_names[i] for i in np.flatnonzero(free)] == ["left_swing", "right_swing"]
    scale = np.asarray(state.qpos)[:, 7:][:, free] / pose[free]  # as drawn, nothing clipped
    assert (scale > 0.5).all() and (scale < 1.5).all() and np.ptp(scale) > 0.2


def test_thighs_of_a_biped_are_the_links_between_hip_and_foot(biped):
    task = SimpleNamespace(termination="base", undesired="thighs")
    fatal, undesired = env_lib.ground_rules(biped, task)
    bodies = np.array(
        [biped.mj_model.body(i).name for i in biped.mj_model.geom_bodyid[biped.parts]]
    )
    assert [set(bodies[row]) for row in undesired] == [
        {"left_thigh"},
        {"left_shin"},
        {"right_thigh"},
        {"right_shin"},
    ]
    assert set(bodies[fatal]) == {"pelvis"}


def test_of_a_leg_of_two_links_the_thigh_is_the_first(hexapod):
    text = re.sub(r'<(joint|motor) name="\w\w_hip"[^>]*/>', "", robot_files.hexapod())
    pose = " ".join(map(str, robot_files.HEXAPOD_POSE))
    text = text.replace(" ".join([pose] * 6), " ".join(["0.6 -1.2"] * 6))
    robot = robot_lib.load_text(text, "hexapod", Path("hexapod.xml"))
    _, undesired = env_lib.ground_rules(
        robot, SimpleNamespace(termination="base", undesired="thighs")
    )
    bodies = [robot.mj_model.body(i).name for i in robot.mj_model.geom_bodyid[robot.parts]]
    assert [np.array(bodies)[row].tolist() for row in undesired] == [
        [f"{n}_thigh"] for n, *_ in LEGS
    ]


def test_joints_at_one_place_are_told_apart_by_axis_and_depth():
    """A waist of two hinges at a point; there, too, a neck that turns as the waist, and a tail."""
    waist = '<joint name="waist" axis="0 0 1" range="-1 1"/>'
    neck = """<body name="head" pos="0 0 0"><joint name="neck" axis="0 0 1" range="-1 1"/>
        <geom size="0.05" pos="0 0 0.4" mass="1"/></body>
        <body name="tail" pos="0 0 0"><joint name="tail" axis="0 1 0" range="-1 1"/>
        <geom size="0.05" pos="-0.3 0 0.1" mass="1"/></body>"""
    lean = '<joint name="lean" axis="1 0 0" range="-1 1"/>'
    text = robot_files.biped()
    assert waist in text
    text = text.replace(waist, waist + lean + neck)
    robot = robot_lib.load_text(text, "biped", Path("biped.xml"))
    table, names = mirror.joints(robot), list(robot.joint_names)
    for name, sign in (("waist", -1), ("lean", -1), ("neck", -1), ("tail", 1)):
        joint = names.index(name)
        assert table.index[joint] == joint and table.sign[joint] == sign
    assert (table.index[table.index] == np.arange(len(names))).all()


def test_joints_on_the_middle_plane_are_their_own_partners(biped):
    table, names = mirror.joints(biped), np.array(biped.joint_names)
    swapped = [
        n.replace("left", "\0").replace("right", "left").replace("\0", "right") for n in names
    ]
    assert names[table.index].tolist() == swapped
    turns = [n for n, sign in zip(names, table.sign, strict=True) if sign < 0]
    sides = "left", "right"
    across = "hip_yaw", "hip_roll", "ankle_roll", "swing"
    assert set(turns) == {"waist"} | {f"{s}_{a}" for s in sides for a in across}


@pytest.mark.parametrize("name", ["hexapod", "biped", "turned"])
def test_the_mirrored_robot_makes_the_mirrored_steps(name, request):
    """In the air, under any torques: twenty steps of C MuJoCo."""
    robot = request.getfixturevalue(name)
    table, model, rng = mirror.joints(robot), robot.mj_model, np.random.default_rng(0)
    qpos, qvel = robot.home_qpos.copy(), rng.normal(0, 0.3, model.nv)
    qpos[2] += 3
    qpos[7:] += rng.uniform(-0.1, 0.1, model.nu)
    torque = rng.normal(0, 1, model.nu)

    def image(x, base):
        flipped = x[: len(base)] * base
        return np.concatenate([flipped, table.sign * x[len(base) :][table.index]])

    def ends(qpos, qvel, torque):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, torque
        mujoco.mj_step(model, data, 20)
        return data

    places, turns = np.array([1, -1, 1, 1, -1, 1, -1]), np.array([1, -1, 1, -1, 1, -1])
    one = ends(qpos, qvel, torque)
    other = ends(image(qpos, places), image(qvel, turns), image(torque, places[:0]))
    assert np.abs(one.qpos - qpos)[7:].max() > 0.01
    np.testing.assert_allclose(other.qpos, image(one.qpos, places), atol=1e-6)
    np.testing.assert_allclose(other.qvel, image(one.qvel, turns), atol=1e-5)

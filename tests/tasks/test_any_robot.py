"""A robot of other limbs: the task's sizes, resets, steps and mirror image follow from its model.

A hexapod, which `robot_contract` does not let in; all else takes it as it is.
"""

from pathlib import Path
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.physics import robot as robot_lib
from dynappo.physics.warp import scope
from dynappo.tasks.velocity import env as env_lib

LEGS = ("FL", 0.3, 0.15), ("FR", 0.3, -0.15), ("ML", 0.0, 0.2)
LEGS += ("MR", 0.0, -0.2), ("RL", -0.3, 0.15), ("RR", -0.3, -0.15)
POSE = 0.0, 0.6, -1.2  # rad: hip, thigh, calf
ROBOTS, ACTIONS = 4, 18


def leg(name, x, y):
    inertial = '<inertial pos="0 0 -0.05" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
    link = f'<geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" conaffinity="1"/>{inertial}'
    foot = f'<geom name="{name}_foot" size="0.025" pos="0 0 -0.2" priority="1" conaffinity="1"/>'
    return f"""
    <body name="{name}_hip" pos="{x} {y} 0">{inertial}
      <joint name="{name}_hip" axis="1 0 0" range="-1 1"/>
      <body name="{name}_thigh" pos="0 {np.sign(y) * 0.05} 0">{link}
        <joint name="{name}_thigh" axis="0 1 0" range="-1.5 2"/>
        <body name="{name}_calf" pos="0 0 -0.2">{link}{foot}
          <joint name="{name}_calf" axis="0 1 0" range="-2.5 -0.3"/>
        </body></body></body>"""


@pytest.fixture(scope="module")
def hexapod():
    names = [f"{name}_{joint}" for name, *_ in LEGS for joint in ("hip", "thigh", "calf")]
    height = 0.2 * np.cos(POSE[1]) + 0.2 * np.cos(POSE[1] + POSE[2]) + 0.025
    text = f"""<mujoco><option timestep="0.005"/><default><geom contype="0" conaffinity="0"/></default>
    <worldbody><geom name="floor" type="plane" size="0 0 1" contype="1"/>
    <body name="base" pos="0 0 {height}"><freejoint/><geom type="box" size="0.3 0.1 0.05" conaffinity="1"/>
    <inertial pos="0 0 0" mass="8" diaginertia="0.1 0.3 0.3"/>{"".join(leg(*one) for one in LEGS)}
    </body></worldbody>
    <actuator>{"".join(f'<motor name="{n}" joint="{n}"/>' for n in names)}</actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    feet = np.array([model.geom(f"{name}_foot").id for name, *_ in LEGS])
    parts = np.setdiff1d(np.flatnonzero(model.geom_conaffinity), feet)
    return robot_lib.Robot(
        name="hexapod",
        xml=Path("hexapod.xml"),
        mj_model=model,
        default_pose=np.tile(POSE, 6),
        home_qpos=np.concatenate([[0, 0, height, 1, 0, 0, 0], np.tile(POSE, 6)]),
        joint_names=tuple(names),
        feet=feet,
        foot_of=np.arange(6),
        foot_names=tuple(name for name, *_ in LEGS),
        parts=parts,
        base_body=1,
        text=text,
        alone=text,
    )


@pytest.fixture(scope="module")
def world(hexapod):
    """A few rows of four hexapods on C MuJoCo, with all that is a number a joint."""
    config = config_lib.load("configs/go1.py")
    config.task.update(termination="base", undesired="thighs", observation="onboard", history=2)
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
    legs = robot_lib.legs(hexapod)
    np.testing.assert_array_equal(legs.joints, np.arange(ACTIONS).reshape(6, 3))
    fatal, undesired = env_lib.ground_rules(
        hexapod, SimpleNamespace(termination="base", undesired="thighs")
    )
    bodies = [hexapod.mj_model.body(i).name for i in hexapod.mj_model.geom_bodyid[hexapod.parts]]
    assert [np.array(bodies)[row].tolist() for row in undesired] == [
        [f"{n}_thigh"] for n, *_ in LEGS
    ]
    assert np.array(bodies)[fatal].tolist() == ["base"]


def test_the_kernel_for_quadrupeds_declines_it(hexapod):
    assert "other limbs" in scope.declines(hexapod.mj_model, hexapod.feet, False)

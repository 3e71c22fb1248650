"""Task and engines ask `ground` for every height."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.physics import ground
from dynappo.policy import episode
from dynappo.tasks.velocity import env as env_lib
from dynappo.terrain import height_map
from dynappo.terrain.height_map import HeightMap

RAISED = 1.0  # m


def world(impl):
    """Go1, without randomisation of where it starts."""
    config = config_lib.load("configs/go1.py:ppo16")
    config.task.reset.joint_scale = (1.0, 1.0)
    config = config_lib.validate(config)
    robot, hyper = robot_lib.load("go1"), config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl=impl)
    key = jax.random.key(0)
    return SimpleNamespace(
        env=env, hyper=hyper, robot=robot, key=key, body=env.randomize(hyper, key)
    )


def test_flat_ground_gives_heights_back_and_does_not_look_at_the_place():
    z = jnp.arange(3.0)
    assert ground.height_above(z, None) is z and ground.world_height(z, None) is z


def test_a_robot_starts_as_high_above_a_raised_ground(monkeypatch):
    w = world("c")
    flat = w.env.reset(w.hyper, w.body, w.key)
    monkeypatch.setattr(ground, "world_height", lambda above, place: above + RAISED)
    up = w.env.reset(w.hyper, w.body, w.key)
    assert float(up.qpos[2] - flat.qpos[2]) == pytest.approx(RAISED, abs=1e-6)
    np.testing.assert_array_equal(up.qpos[3:], flat.qpos[3:])


STEPS = np.repeat(0.1 * np.floor(np.arange(40) / 3)[:, None], 30, 1).astype(np.float32)
DRAWN = {
    "flat": np.zeros((9, 7), np.float32),
    "raised": np.full((2, 2), 1.5, np.float32),
    "stairs": STEPS,
    "random": np.random.default_rng(0).uniform(0, 1, (20, 30)).astype(np.float32),
}


@pytest.mark.parametrize("name", DRAWN)
def test_what_a_film_draws_is_the_height_field_where_it_is(name):
    """A ray from above meets the mesh and MuJoCo's height field at one height; nothing touches the mesh."""
    field = HeightMap(DRAWN[name], 0.2, (-1.3, 0.7))
    robot, heights = robot_lib.load("go1"), []
    size = field.cell * (np.array(field.heights.shape) - 1)
    points = field.corner + np.random.default_rng(1).uniform(0.01, 0.99, (200, 2)) * size
    for drawn in (False, True):
        model = episode.compiled(robot.xml, robot.text, field, drawn=drawn)
        floor, data = model.geom("floor").id, mujoco.MjData(model)
        kind = mujoco.mjtGeom.mjGEOM_MESH if drawn else mujoco.mjtGeom.mjGEOM_HFIELD
        assert model.geom_type[floor] == kind
        assert (model.geom_contype[floor] + model.geom_conaffinity[floor] == 0) == drawn
        data.qpos[:] = robot.home_qpos
        data.qpos[2] += 50  # out of the way
        mujoco.mj_kinematics(model, data)
        ray = mujoco.mj_rayMesh if drawn else mujoco.mj_rayHfield
        down = np.array([0.0, 0.0, -1.0])
        found = [ray(model, data, floor, np.array([*p, 9.0]), down, None) for p in points]
        heights.append(9 - np.array(found))
    np.testing.assert_allclose(*heights, atol=1e-4)
    at = height_map.height(*field, *points.T)
    np.testing.assert_allclose(heights[1], at, atol=1e-4)

"""Task and engines ask `ground` for every height."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.physics import ground
from dynappo.tasks.velocity import env as env_lib

RAISED = 1.0  # m: all of a robot that stands on the floor is below such a ground


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


@pytest.fixture
def raised(monkeypatch):
    """A ground at `RAISED`; the list gets the shape of x and y at each question, or None."""
    asked = []

    def height_above(z, place, ground=None):
        asked.append(place and place().shape)
        return z - RAISED

    monkeypatch.setattr(ground, "height_above", height_above)
    monkeypatch.setattr(ground, "world_height", lambda above, place: above + RAISED)
    return asked


def test_flat_ground_gives_heights_back_and_does_not_look_at_the_place():
    z = jnp.arange(3.0)
    assert ground.height_above(z, None) is z and ground.world_height(z, None) is z


def test_a_robot_starts_as_high_above_a_raised_ground(request):
    w = world("c")
    flat = w.env.reset(w.hyper, w.body, w.key)
    request.getfixturevalue("raised")
    up = w.env.reset(w.hyper, w.body, w.key)
    assert float(up.qpos[2] - flat.qpos[2]) == pytest.approx(RAISED, abs=1e-6)
    np.testing.assert_array_equal(up.qpos[3:], flat.qpos[3:])


def test_c_mujoco_measures_heights_from_the_ground(request):
    """A robot on the floor, and then the ground is said to be above it."""
    w = world("c")
    state = w.env.reset(w.hyper, w.body, w.key)
    action = jnp.zeros(w.env.action_size)
    after, outcome = w.env.step(w.hyper, w.body, state, action, w.key)
    assert outcome.discount == 1 and not (after.contact_steps > 0).all()
    request.getfixturevalue("raised")
    after, outcome = w.env.step(w.hyper, w.body, state, action, w.key)
    assert outcome.discount == 0 and (after.contact_steps > 0).all()


def test_mjx_tells_the_place_of_each_point(raised):
    """Of feet and parts in a physics step, and of the base; traced, not run."""
    w = world("jax")
    state = jax.eval_shape(w.env.reset, w.hyper, w.body, w.key)
    action = jnp.zeros(w.env.action_size)
    jax.eval_shape(w.env.step, w.hyper, w.body, state, action, w.key)
    assert set(raised) == {(len(w.robot.feet), 2), (len(w.robot.parts), 2), (2,)}

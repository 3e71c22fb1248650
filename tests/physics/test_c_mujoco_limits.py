"""What C MuJoCo is not given: files that it would compute otherwise, states that it would log."""

import os
from pathlib import Path

import jax
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.physics import c_mujoco
from dynappo.program import build

ROBOTS = 2
NUMBERS = [1.0, 0.0, 0.0, 0.0, 0.8, 25.0, 0.5, 23.7, 23.7, 30.0, 1.0, 0.0]


def physics(**fields):
    config = config_lib.load("configs/go1.py:laptop")
    config.physics.update(threads=1, **fields)
    return config_lib.validate(config).physics


def changed(folder: Path, old: str, new: str) -> robot_lib.Robot:
    """The Go1 with one thing of its file changed."""
    text = robot_lib.load("go1").xml.read_text()
    assert old in text
    file = folder / "other.xml"
    file.write_text(text.replace(old, new, 1))
    return robot_lib.load_xml(file)


def inputs(robot):
    qpos = np.tile(robot.home_qpos, (ROBOTS, 1))
    speeds = np.zeros((ROBOTS, 18))
    target = np.tile(robot.default_pose, (ROBOTS, 4, 1))
    arrays = qpos, speeds, speeds, target, np.tile(NUMBERS, (ROBOTS, 1))
    return [np.float32(x) for x in arrays]


def moved(robot, *arguments):
    step = jax.jit(jax.vmap(c_mujoco.make(robot, physics(), frozenset())))
    return jax.device_get(step(*arguments))


@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_an_integrator_that_takes_motors_otherwise_is_refused(integrator, tmp_path, monkeypatch):
    robot = changed(tmp_path, "</mujoco>", f'<option integrator="{integrator}"/></mujoco>')
    rule = f"physics.impl is c, but .*other.xml has the integrator {integrator.lower()}.*=jax"
    with pytest.raises(ConfigError, match=rule):
        c_mujoco.make(robot, physics(), frozenset())
    monkeypatch.setattr(robot_lib, "load", lambda name: robot)
    with pytest.raises(ConfigError, match=rule):
        build.check(config_lib.validate(config_lib.load("configs/go1.py:laptop")))


def test_sensors_of_the_file_change_nothing(tmp_path):
    robot = robot_lib.load("go1")
    other = changed(tmp_path, "</mujoco>", '<sensor><clock name="time"/></sensor></mujoco>')
    assert other.mj_model.nsensor == 0
    for one, two in zip(moved(robot, *inputs(robot)), moved(other, *inputs(other)), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("argument, column", [(0, 2), (0, 9), (1, 4), (1, 8), (3, 5)])
def test_what_is_given_to_mujoco_is_not_logged(argument, column, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where it would write MUJOCO_LOG.TXT
    robot = robot_lib.load("go1")
    for value in (100.0, 0.999 * c_mujoco.FAR):
        arguments = inputs(robot)
        arguments[argument][0, ..., column] = value
        assert np.isfinite(moved(robot, *arguments).qpos[1]).all()
    assert not os.listdir()


def test_a_robot_far_from_the_origin_moves_as_at_it():
    """As in the other engines; one in no place is a blow-up, and alone."""
    robot = robot_lib.load("go1")
    arguments = inputs(robot)
    arguments[0][:, :2] = [[0, 0], [-700, 900]]
    here, there = moved(robot, *arguments).qpos
    np.testing.assert_allclose(there[:2] + [700, -900], here[:2], atol=1e-3)
    np.testing.assert_allclose(there[2:], here[2:], atol=1e-4)
    for nowhere in (np.nan, np.inf, 2 * c_mujoco.AWAY):
        arguments[0][1, 1] = nowhere
        found = moved(robot, *arguments).qpos
        np.testing.assert_array_equal(found[0], here)
        assert np.isnan(found[1]).all()


def test_a_body_of_no_numbers_ends_the_program():
    robot = robot_lib.load("go1")
    arguments = inputs(robot)
    arguments[-1][0, 0] = np.nan
    with pytest.raises(jax.errors.JaxRuntimeError, match="numbers that are not finite"):
        moved(robot, *arguments)

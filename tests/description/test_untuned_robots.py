"""The robots of experiments/23_untuned: the contract, the masses of their sources, the mirror image."""

import pathlib

import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import mirror

FOLDER = pathlib.Path(__file__).parents[2] / "experiments" / "23_untuned"
# base, hip, thigh and shank of MuJoCo Menagerie, kg
MASSES = {
    "anymal_b": [19.2035, 1.42462, 1.63498, 0.472163],
    "spot": [32.86, 1.68, 2.34, 0.35],
}
QPOS, QVEL = np.array([1, -1, 1, 1, -1, 1, -1]), np.array([1, -1, 1, -1, 1, -1])


@pytest.fixture(params=MASSES)
def robot(request):
    return robot_lib.load_xml(FOLDER / "robots" / request.param / f"{request.param}.xml")


def test_bodies_weigh_what_their_source_says(robot):
    base, *leg = MASSES[robot.name]
    np.testing.assert_allclose(robot.mj_model.body_mass[1:], [base, *(4 * leg)])


def test_the_folder_is_found_from_inside_and_its_pd_is_stable(robot, monkeypatch):
    monkeypatch.chdir(FOLDER)
    config = config_lib.validate(config_lib.load(f"configs/{robot.name}.py:laptop"))
    assert robot_lib.load(config.robot).xml.samefile(robot.xml)
    assert config.task.reset.spawn_height == pytest.approx(robot.home_qpos[2] + 0.05, abs=0.005)
    assert robot_lib.damping_rate(robot, config.task.kd, config.physics.timestep) < 0.5


def test_the_mirrored_robot_makes_the_mirrored_steps(robot):
    table = mirror.joints(robot)
    rng, model = np.random.default_rng(0), robot.mj_model
    model.opt.iterations = 50
    qpos, qvel = robot.home_qpos.copy(), rng.normal(0, 0.3, model.nv)
    qpos[7:] += rng.uniform(-0.1, 0.1, 12)
    torque = rng.normal(0, 10, 12)

    def image(x, base):
        flipped = x[: len(base)] * base
        return np.concatenate([flipped, table.sign * x[len(base) :][table.index]])

    def ends(qpos, qvel, torque):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, torque
        mujoco.mj_step(model, data, 20)
        return data

    one = ends(qpos, qvel, torque)
    other = ends(image(qpos, QPOS), image(qvel, QVEL), image(torque, QPOS[:0]))
    assert np.abs(one.qpos - robot.home_qpos)[7:].max() > 0.1  # it has moved
    np.testing.assert_allclose(other.qpos, image(one.qpos, QPOS), atol=2e-3)
    np.testing.assert_allclose(other.qvel, image(one.qvel, QVEL), atol=2e-2)

"""Feet at any joint angles, against C MuJoCo: frames turned, joints with a place and a `ref`, chains of
different lengths, feet of every primitive."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import robot_files

from dynappo.description import kinematics, robot

SOLE = '<geom type="box" size="0.1 0.04 0.015" mass="0.5"/>'
SHAPES = {
    "box": SOLE,
    "sphere": '<geom size="0.05" mass="0.5"/>',
    "capsule": '<geom type="capsule" size="0.03 0.08" euler="0 1.6 0.2" mass="0.5"/>',
    "cylinder": '<geom type="cylinder" size="0.07 0.02" euler="0.1 0.05 0" mass="0.5"/>',
    "several": SOLE + '<geom type="cylinder" size="0.04 0.02" mass="0.1"/>'
    '<geom type="capsule" fromto="0.1 -0.04 0 0.1 0.04 0" size="0.02" mass="0.1"/>',
}
LAME = '<joint name="right_ankle_roll" axis="1 0 0" range="-0.5 0.5"/>'


def uneven(shape):
    """The biped with other feet, its right leg a joint shorter."""
    text = robot_files.biped()
    assert SOLE in text and LAME in text
    return text.replace(SOLE, SHAPES[shape]).replace(LAME, "")


TEXTS = {name: uneven(name) for name in SHAPES}
TEXTS |= dict(turned=robot_files.turned(), hexapod=robot_files.hexapod())


@pytest.fixture(params=TEXTS)
def loaded(request, tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(TEXTS[request.param])
    return robot.load_xml(path)


def poses(loaded, count=20):
    """Joint angles, and C MuJoCo's data with the base upright high above the floor."""
    rng, data = np.random.default_rng(5), mujoco.MjData(loaded.mj_model)
    low, high = np.clip(robot.joint_ranges(loaded).T, -np.pi, np.pi)
    for _ in range(count):
        joints = rng.uniform(low, high)
        data.qpos[:] = [0, 0, 2, 1, 0, 0, 0, *joints]
        mujoco.mj_kinematics(loaded.mj_model, data)
        yield joints, data


def test_the_lowest_point_of_all_feet_is_mujocos_distance_to_the_floor(loaded):
    model, legs = loaded.mj_model, kinematics.legs(loaded.mj_model, loaded.feet)
    floor, in_jax = model.geom("floor").id, jax.jit(lambda q: kinematics.lowest(legs, q))
    found = []
    for joints, data in poses(loaded):
        expected = (
            min(mujoco.mj_geomDistance(model, data, floor, i, 9.0, None) for i in loaded.feet) - 2
        )
        found.append(kinematics.lowest(legs, joints))
        assert found[-1] == pytest.approx(expected, abs=1e-6)
        assert in_jax(jnp.asarray(joints, jnp.float32)) == pytest.approx(expected, abs=1e-5)
    assert np.ptp(found) > 0.05


def test_points_are_at_mujocos_places(loaded):
    """A shape's middle is that of its points; the radius is a ball's, the rim a cylinder's."""
    model, legs = loaded.mj_model, kinematics.legs(loaded.mj_model, loaded.feet)
    counts = np.array([{2: 1, 3: 2, 5: 2, 6: 8}[kind] for kind in model.geom_type[loaded.feet]])
    ends = np.cumsum(counts)
    for joints, data in poses(loaded, 5):
        points = kinematics.feet_in_base(legs, joints)
        assert len(points) == ends[-1]
        for geom, start, end in zip(loaded.feet, ends - counts, ends, strict=True):
            expected = data.geom_xpos[geom] - [0, 0, 2]
            np.testing.assert_allclose(points[start:end].mean(0), expected, atol=1e-12)


def test_chains_are_the_joints_from_the_base_to_the_foot(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(uneven("sphere"))
    loaded = robot.load_xml(path)
    legs = kinematics.legs(loaded.mj_model, loaded.feet)
    names = np.array(loaded.joint_names)
    chains = [
        names[row[real > 0]].tolist() for row, real in zip(legs.joints, legs.real, strict=True)
    ]
    parts = "hip_yaw hip_roll hip_pitch knee ankle_pitch ankle_roll".split()
    assert chains == [[f"left_{p}" for p in parts], [f"right_{p}" for p in parts[:-1]]]
    assert kinematics.joints_to(loaded.mj_model, loaded.mj_model.body("torso").id) == [
        loaded.joint_names.index("waist")
    ]

"""Every robot file against published numbers, its mirror image and C MuJoCo; the geometry helpers.

`facts/robots.json` holds the numbers and where they are published.
"""

import json
import pathlib
import re
from types import SimpleNamespace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config
from dynappo.config import files
from dynappo.description import collision, contacts, kinematics, robot
from dynappo.physics import actuators, randomize

FACTS = json.loads((pathlib.Path(__file__).parents[1] / "facts" / "robots.json").read_text())
ROBOTS = [name for name in files.robots() if name in FACTS]  # a fifth one has no facts here
LEGS = dict(go1="FL FR RL RR", go2="FL FR RL RR", anymal_c="LF RF LH RH", anymal_d="LF RF LH RH")
PARTS = {"go1": "hip thigh calf", "go2": "hip thigh calf"}
PARTS |= {"anymal_c": "HAA HFE KFE", "anymal_d": "HAA HFE KFE"}
PHYSICS = dict(timestep=0.005, iterations=4, ls_iterations=8)


@pytest.fixture(scope="module", params=ROBOTS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def loaded(name):
    return robot.load(name)


@pytest.fixture(scope="module")
def facts(name):
    """The published numbers; of Go2 with the calves that its README chooses."""
    found = FACTS[name]
    bodies = {b["name"]: b for b in found["bodies"]}
    total = found["total_mass"]
    if "alternative_calf" in found:
        bodies |= {b["name"]: b for b in found["alternative_calf"]["bodies"]}
        total = found["alternative_calf"]["total_mass_with_it"]
    return found | dict(bodies=bodies, total_mass=total)


def tensor(model, body):
    """Inertia about the centre of mass in the axes of the body frame, [3, 3]."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(model.body_inertia[body]) @ rotation.T


def physics(**changes):
    return SimpleNamespace(**(PHYSICS | dict(contacts="feet") | changes))


def in_pose(model, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def test_the_four_robots_of_the_paper_are_here():
    assert set(ROBOTS) == set(FACTS) - {"about"} and len(ROBOTS) == 4


def test_bodies_have_the_published_mass_centre_and_place(loaded, facts):
    model = loaded.mj_model
    assert model.nbody == 1 + len(facts["bodies"])
    for name, expected in facts["bodies"].items():
        body = model.body(name)
        assert body.mass[0] == pytest.approx(expected["mass"], abs=1e-6)
        np.testing.assert_allclose(body.ipos, expected["com"], atol=1e-6, err_msg=name)
        if expected["parent"]:
            assert model.body(body.parentid[0]).name == expected["parent"]
            np.testing.assert_allclose(body.pos, expected["pos"], atol=1e-6, err_msg=name)
        else:
            assert body.id == loaded.base_body
            assert body.parentid[0] == 0


def test_bodies_have_the_published_inertia_tensor(loaded, facts):
    for name, expected in facts["bodies"].items():
        xx, yy, zz, xy, xz, yz = expected["inertia"]
        found = tensor(loaded.mj_model, loaded.mj_model.body(name).id)
        by_rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        np.testing.assert_allclose(found, by_rows, atol=1e-6, err_msg=name)


def test_the_total_mass_is_the_published_one(loaded, facts):
    assert loaded.mj_model.body_mass.sum() == pytest.approx(facts["total_mass"], abs=1e-6)


def test_go1_weighs_12_743_and_go2_loses_the_excess_calf_mass():
    assert robot.load("go1").mj_model.body_mass.sum() == pytest.approx(12.743448, abs=1e-6)
    go2 = FACTS["go2"]
    assert go2["total_mass"] - go2["alternative_calf"]["total_mass_with_it"] == pytest.approx(
        4 * 0.047352
    )


def test_joints_have_the_published_axis_range_and_body(loaded, facts):
    for expected in facts["joints"]:
        joint = loaded.mj_model.joint(expected["name"])
        np.testing.assert_allclose(joint.axis, expected["axis"], atol=1e-6)
        np.testing.assert_allclose(joint.range, expected["range"], atol=1e-6)
        assert joint.limited[0]
        assert loaded.mj_model.body(joint.bodyid[0]).name == expected["body"]


def test_joints_have_the_armature_damping_and_friction_of_the_motor_model(loaded, facts, name):
    for expected in facts["joints"]:
        joint = loaded.mj_model.joint(expected["name"])
        assert joint.armature[0] == facts["joint_model"]["armature"]
        assert joint.armature[0] == (expected["armature"] or 0.0675)
        assert joint.damping[0] == facts["joint_model"]["damping"]
        assert joint.frictionloss[0] == facts["joint_model"]["frictionloss"]
    if name.startswith("go"):
        assert not loaded.mj_model.dof_damping.any()
        assert not loaded.mj_model.dof_frictionloss.any()


def test_joints_come_leg_by_leg_from_hip_to_knee(loaded, facts, name):
    separator = "_joint" if name.startswith("go") else ""
    expected = [
        f"{leg}_{part}{separator}" for leg in LEGS[name].split() for part in PARTS[name].split()
    ]
    assert list(loaded.joint_names) == expected
    assert {j["name"] for j in facts["joints"]} == set(expected)


def test_feet_have_the_published_radius_and_centre_in_the_order_of_the_legs(loaded, facts, name):
    model = loaded.mj_model
    assert [model.geom(i).name for i in loaded.feet] == [f"{g}_foot" for g in LEGS[name].split()]
    np.testing.assert_allclose(model.geom_size[loaded.feet, 0], facts["foot"]["radius"], atol=1e-6)
    for foot, leg in zip(loaded.feet, LEGS[name].split(), strict=True):
        centre = facts["foot"]["centre_in_last_body"][leg]
        np.testing.assert_allclose(model.geom_pos[foot], centre, atol=1e-6)


def test_feet_alone_have_friction_and_it_is_the_one_that_randomisation_takes_for_nominal(loaded):
    model = loaded.mj_model
    np.testing.assert_array_equal(model.geom_friction[loaded.feet, 0], 0.8)
    assert randomize.NOMINAL["friction"] == 0.8
    assert (model.geom_priority[loaded.feet] > model.geom("floor").priority[0]).all()
    assert (model.geom_condim[loaded.feet] == 3).all()
    assert (model.geom_condim[loaded.parts] == 1).all()


def test_the_default_pose_is_the_named_tasks(loaded, facts):
    expected = facts["isaaclab_default"]["joint_pos"]
    found = dict(zip(loaded.joint_names, loaded.default_pose, strict=True))
    assert found == pytest.approx(expected, abs=1e-9)
    np.testing.assert_array_equal(loaded.home_qpos[7:], loaded.default_pose)


def test_in_the_default_pose_the_feet_are_where_published_and_the_lowest_touch_the_floor(
    loaded, facts, name
):
    published = facts["isaaclab_default"]["kinematics"]
    data = in_pose(loaded.mj_model, loaded.home_qpos)
    centres = data.geom_xpos[loaded.feet]
    base = data.xpos[loaded.base_body]
    for centre, leg in zip(centres, LEGS[name].split(), strict=True):
        expected = published["feet_centres_in_base_frame"][leg]
        np.testing.assert_allclose(centre - base, expected, atol=1e-6, err_msg=leg)
    height = published["base_height_with_lowest_foot_on_ground"]
    assert loaded.home_qpos[2] == pytest.approx(height, abs=1e-5)
    radius = loaded.mj_model.geom_size[loaded.feet, 0]
    assert (centres[:, 2] - radius).min() == pytest.approx(0, abs=1e-5)
    np.testing.assert_array_equal(loaded.home_qpos[[0, 1, 3, 4, 5, 6]], [0, 0, 1, 0, 0, 0])


def test_no_part_but_the_feet_is_at_the_floor_in_the_default_pose(loaded):
    data = in_pose(loaded.mj_model, loaded.home_qpos)
    floor = loaded.mj_model.geom("floor").id
    for part in loaded.parts:
        distance = mujoco.mj_geomDistance(loaded.mj_model, data, floor, part, 1.0, None)
        assert distance > 0.03, loaded.mj_model.geom(part).name


def test_the_floor_is_a_plane_at_height_zero(loaded):
    floor = loaded.mj_model.geom("floor")
    assert floor.type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    assert not floor.pos.any() and floor.bodyid[0] == 0
    np.testing.assert_array_equal(floor.quat, [1, 0, 0, 0])


def test_looks_are_left_out_and_weigh_nothing(loaded):
    with_looks = mujoco.MjModel.from_xml_path(str(loaded.xml))
    looks = with_looks.geom_group == collision.VISUAL_GROUP
    assert looks.any() and not (loaded.mj_model.geom_group == collision.VISUAL_GROUP).any()
    assert loaded.mj_model.ngeom == (~looks).sum()
    np.testing.assert_array_equal(with_looks.body_mass, loaded.mj_model.body_mass)


def test_controls_are_the_joint_torques(loaded):
    model, rng = loaded.mj_model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = loaded.home_qpos, rng.normal(size=18)
    data.ctrl[:] = rng.normal(size=12) * 100
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator[6:], data.ctrl, rtol=1e-12)
    assert not data.qfrc_actuator[:6].any()


def motor(facts, name):
    """Gains and Isaac Lab's motor limits: the config's where the robot has one, else the published ones."""
    path = files.find("configs", f"{name}.py")
    return config.load(f"{name}.py:ppo16").task if path else SimpleNamespace(**facts["pd"])


def test_a_config_has_the_published_gains_and_limits(facts, name):
    task = motor(facts, name)
    for field in ("kp", "kd", "effort_limit", "saturation_effort", "velocity_limit"):
        assert getattr(task, field) == facts["pd"][field], field


def test_it_stands_for_five_seconds_under_its_own_motors(loaded, facts, name):
    """C MuJoCo, zero action. Explicit PD has no integral: with the tasks' soft gains the robots
    sag, by 5.2 (Go1), 7.0 (Go2), 6.4 and 6.7 cm (ANYmal-C and -D, still sinking 7 mm/s)."""
    task, model = motor(facts, name), robot.physics_model(loaded, physics())
    limits = {f: getattr(task, f) for f in ("effort_limit", "saturation_effort", "velocity_limit")}
    data = mujoco.MjData(model)
    data.qpos[:] = loaded.home_qpos
    heights, tilts = [], []
    for _ in range(1000):
        torque = actuators.pd(loaded.default_pose, data.qpos[7:], data.qvel[6:], task.kp, task.kd)
        data.ctrl[:] = actuators.clip_dc_motor(torque, data.qvel[6:], **limits)
        mujoco.mj_step(model, data)
        heights.append(data.qpos[2])
        tilts.append(np.arccos(data.xmat[loaded.base_body][8]))
    heights = np.array(heights)
    assert np.abs(heights - loaded.home_qpos[2]).max() < 0.08
    assert max(tilts) < 0.1
    assert np.abs(heights[-200:] - heights[-1]).max() < 0.01  # at rest but for a slow creep
    assert np.abs(data.qvel).max() < 0.03  # no chatter


def with_armature(loaded, armature):
    """The robot with another armature at every joint."""
    model = loaded.mj_model.__copy__()
    model.dof_armature[6:] = armature
    return loaded._replace(mj_model=model)


def test_the_damping_rate_is_that_of_a_single_pendulum_on_a_heavy_base(loaded):
    """With huge armatures M is nearly diagonal: dt kd / armature."""
    rate = robot.damping_rate(with_armature(loaded, 1e6), kd=2e6, timestep=0.005)
    assert rate == pytest.approx(0.01, rel=1e-5)


def test_explicit_damping_is_stable_at_the_physics_step(loaded, facts, name):
    kd = motor(facts, name).kd
    assert robot.damping_rate(loaded, kd, 0.005) < 0.2
    # MuJoCo takes the joints' own damping implicitly; even counted as explicit it is stable
    assert robot.damping_rate(loaded, kd + facts["joint_model"]["damping"], 0.005) < 1


def test_the_stability_bound_rejects_isaac_labs_gains_without_armature():
    """40 / 5 and no armature, the simple motor model of Isaac Lab: ANYmal-C's joints chatter."""
    assert robot.damping_rate(with_armature(robot.load("anymal_c"), 0.0), 5.0, 0.005) > 1


def test_foot_positions_by_the_leg_chains_are_mujocos_at_any_joint_angles(loaded):
    rng, data = np.random.default_rng(5), mujoco.MjData(loaded.mj_model)
    low, high = np.clip(loaded.mj_model.jnt_range[1:].T, -np.pi, np.pi)
    legs = kinematics.legs(loaded.mj_model, loaded.feet)
    for _ in range(10):
        joints = rng.uniform(low, high)
        data.qpos[:] = [0, 0, 0, 1, 0, 0, 0, *joints]
        mujoco.mj_kinematics(loaded.mj_model, data)
        expected = data.geom_xpos[loaded.feet]
        np.testing.assert_allclose(kinematics.feet_in_base(legs, joints), expected, atol=1e-12)
        in_jax = kinematics.feet_in_base(legs, jnp.asarray(joints))
        np.testing.assert_allclose(in_jax, expected, atol=2e-6)


def colliding(loaded, contacts):
    """Names of the pairs of geoms that make contacts, in many poses deep under the floor."""
    model = robot.physics_model(loaded, physics(contacts=contacts))
    rng, pairs = np.random.default_rng(1), set()
    data = mujoco.MjData(model)
    low, high = np.clip(model.jnt_range[1:].T, -np.pi, np.pi)
    for _ in range(20):
        quat = rng.normal(size=4)
        data.qpos[:] = [0, 0, -2, *quat / np.linalg.norm(quat), *rng.uniform(low, high)]
        mujoco.mj_forward(model, data)
        pairs |= {frozenset(model.geom(g).name for g in c.geom) for c in data.contact}
    return pairs


def test_with_feet_contacts_only_the_feet_meet_the_floor(loaded):
    feet = {loaded.mj_model.geom(i).name for i in loaded.feet}
    assert colliding(loaded, "feet") == {frozenset({"floor", foot}) for foot in feet}


def test_with_full_contacts_every_part_meets_the_floor_and_no_other_part(loaded):
    ids = (*loaded.feet, *loaded.parts)
    expected = {frozenset({"floor", loaded.mj_model.geom(i).name}) for i in ids}
    assert colliding(loaded, "full") == expected


def test_every_geom_is_the_floor_a_foot_or_a_part(loaded):
    ids = [loaded.mj_model.geom("floor").id, *loaded.feet, *loaded.parts]
    assert sorted(ids) == list(range(loaded.mj_model.ngeom))


def test_the_physics_model_takes_its_numbers_from_the_config_and_leaves_the_robot_alone(loaded):
    model = robot.physics_model(loaded, physics(timestep=0.002, iterations=7, ls_iterations=9))
    assert (model.opt.timestep, model.opt.iterations, model.opt.ls_iterations) == (0.002, 7, 9)
    assert loaded.mj_model.geom_conaffinity[loaded.parts].all()
    assert loaded.mj_model.opt.timestep != 0.002


# --- left and right ---


def mirrored(loaded, qpos):
    """The pose that is the mirror image (y to -y) of `qpos`.

    The mirror keeps a turn about y and reverses those about x and z: the hips' roll and two parts
    of the base's quaternion; and it swaps the legs of each pair.
    """
    legs = qpos[7:].reshape(4, 3)[[1, 0, 3, 2]] * [-1, 1, 1]
    return np.concatenate([qpos[:7] * [1, -1, 1, 1, -1, 1, -1], legs.ravel()])


def twins(loaded):
    """For each part and foot the geom id of the one on the other side; itself in the middle."""
    model, pairs = loaded.mj_model, {"left": "right", "right": "left"}
    left, right = (LEGS[loaded.name].split()[i::2] for i in (0, 1))
    pairs |= dict(zip(left + right, right + left, strict=True))

    def twin(geom):
        words = model.geom(geom).name.split("_")
        return model.geom("_".join(pairs[w] if w in pairs else w for w in words)).id

    return {geom: twin(geom) for geom in (*loaded.parts, *loaded.feet)}


def test_right_legs_mirror_the_left_in_offsets_axes_ranges_masses_and_contacts(loaded):
    """Not in inertias and centres of mass, which are the real robots' and differ."""
    model = loaded.mj_model
    joints = np.arange(1, 13).reshape(4, 3)
    left, right = joints[[0, 2]], joints[[1, 3]]
    bodies = model.jnt_bodyid
    np.testing.assert_array_equal(
        model.body_pos[bodies[right]], model.body_pos[bodies[left]] * [1, -1, 1]
    )
    np.testing.assert_array_equal(model.body_mass[bodies[right]], model.body_mass[bodies[left]])
    assert model.body_mass[bodies[left]].all()
    # the same axes: x at the hips, whose turns the mirror reverses, and y, whose turns it keeps
    np.testing.assert_array_equal(model.jnt_axis[right], model.jnt_axis[left])
    np.testing.assert_array_equal(model.jnt_axis[left], [[[1, 0, 0], [0, 1, 0], [0, 1, 0]]] * 2)
    expected = model.jnt_range[left].copy()
    expected[:, 0] = -expected[:, 0, ::-1]
    np.testing.assert_array_equal(model.jnt_range[right], expected)
    for geom, twin in twins(loaded).items():
        text = f"{model.geom(geom).name} and {model.geom(twin).name}"
        assert model.geom_type[twin] == model.geom_type[geom], text
        for field in ("size", "friction", "solref", "solimp", "condim", "priority"):
            values = getattr(model, f"geom_{field}")
            np.testing.assert_array_equal(values[twin], values[geom], err_msg=text)
    np.testing.assert_allclose(mirrored(loaded, loaded.home_qpos), loaded.home_qpos, atol=1e-12)


def test_in_the_mirrored_pose_every_part_and_foot_is_at_its_mirror_image(loaded):
    """Places of all parts, and by the height of their lowest points, at any attitude, their
    turns."""
    model, rng = loaded.mj_model, np.random.default_rng(2)
    geoms, others = (np.array(ids) for ids in zip(*twins(loaded).items(), strict=True))
    assert (geoms != others).sum() >= 4 * 4  # of each leg three parts and the foot at least
    for _ in range(50):
        quat = rng.normal(size=4)
        joints = rng.uniform(*model.jnt_range[1:].T)
        pose = np.concatenate([rng.normal(size=3), quat / np.linalg.norm(quat), joints])
        here, there = in_pose(model, pose), in_pose(model, mirrored(loaded, pose))
        expected = here.geom_xpos[geoms] * [1, -1, 1]
        np.testing.assert_allclose(there.geom_xpos[others], expected, atol=1e-12)
        np.testing.assert_allclose(
            lowest_points(model, there, others), lowest_points(model, here, geoms), atol=1e-12
        )


# --- how far a primitive reaches down ---


def random_primitives(seed, count=40):
    """A model of `count` geoms of all four kinds, random in size, place and attitude."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE)
    floor.size = [0, 0, 1]
    kinds = (contacts.BOX, contacts.SPHERE, contacts.CAPSULE, contacts.CYLINDER)
    for i in range(count):
        body = spec.worldbody.add_body(pos=rng.uniform(-0.5, 0.5, 3))
        body.add_freejoint()
        quat = rng.normal(size=4)
        body.add_geom(
            type=mujoco.mjtGeom(kinds[i % 4]),
            size=rng.uniform(0.02, 0.4, 3),
            quat=quat / np.linalg.norm(quat),
        )
    model = spec.compile()
    return model, in_pose(model, model.qpos0)


def surface(kind, size):
    """Points on a primitive that hold its lowest point, in its own frame; finely sampled."""
    if kind == contacts.BOX:
        return np.stack(np.meshgrid(*[[-s, s] for s in size]), -1).reshape(-1, 3)
    angle = np.linspace(0, 2 * np.pi, 361)
    if kind == contacts.CYLINDER:
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1) * size[0]
        return np.concatenate([ring + [0, 0, z] for z in (-size[1], size[1])])
    polar, around = np.meshgrid(np.linspace(0, np.pi, 181), angle)
    ball = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1
    )
    ball = ball.reshape(-1, 3) * size[0]
    ends = (-size[1], size[1]) if kind == contacts.CAPSULE else (0.0,)
    return np.concatenate([ball + [0, 0, z] for z in ends])


def lowest_points(model, data, geoms):
    """World height of the lowest point of each geom, by the formula of `floor_distance`."""
    fixed, linear, ring = contacts.floor_distance(model, geoms)
    row = data.geom_xmat[geoms][:, 6:]
    sine = np.sqrt(np.maximum(1 - row[:, 2] ** 2, 0))
    return data.geom_xpos[geoms, 2] - (fixed + (linear * np.abs(row)).sum(-1) + ring * sine)


def test_the_lowest_point_is_that_of_many_points_on_the_surface():
    model, data = random_primitives(seed=0)
    geoms = np.arange(1, model.ngeom)
    found = lowest_points(model, data, geoms)
    for geom, lowest in zip(geoms, found, strict=True):
        kind = model.geom_type[geom]
        points = surface(kind, model.geom_size[geom])
        heights = data.geom_xpos[geom, 2] + points @ data.geom_xmat[geom][6:]
        tolerance = 1e-12 if kind == contacts.BOX else 1e-4
        assert lowest == pytest.approx(heights.min(), abs=tolerance)
        assert lowest <= heights.min() + 1e-12


def test_the_lowest_point_is_mujocos_distance_to_the_floor():
    model, data = random_primitives(seed=1)
    geoms = np.arange(1, model.ngeom)
    expected = [mujoco.mj_geomDistance(model, data, 0, geom, 10.0, None) for geom in geoms]
    assert min(expected) < -0.1 and max(expected) > 0.1
    np.testing.assert_allclose(lowest_points(model, data, geoms), expected, atol=1e-6)


def test_an_unknown_robot_is_refused_by_name(tmp_path, monkeypatch):
    """A name that is too long for a folder too, and one that is a path out of robots/."""
    monkeypatch.chdir(tmp_path)
    for folder in ("robots", "mine"):
        (tmp_path / folder).mkdir()
    (tmp_path / "mine.xml").write_text(robot.load("go1").xml.read_text())
    for name in ("go7", "n" * 256, "../mine"):
        with pytest.raises(config.ConfigError, match=f"robot is '{re.escape(name)}'"):
            robot.load(name)

"""robots/g1/g1.xml against published numbers, its mirror image, published soles and PD gains in C MuJoCo.

`facts/g1.json` holds the numbers and where they are published.
"""

import json
import pathlib

import mujoco
import numpy as np
import pytest

from dynappo import config
from dynappo.config import files, per_joint
from dynappo.description import contacts, robot

FACTS = json.loads((pathlib.Path(__file__).parents[1] / "facts" / "g1.json").read_text())
XML = files.find("robots", "g1/g1.xml")
JOINTS = [joint["name"] for joint in FACTS["joints"]]
EFFORT = np.array([joint["effort_limit"] for joint in FACTS["joints"]])
MIRROR = np.array([1, -1, 1])
KINDS = {
    name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}") for name in ("box", "capsule", "sphere")
}


@pytest.fixture(scope="module")
def model():
    return robot.physics_spec(XML).compile()


def turned(quat):
    """The rotation matrix of a quaternion w x y z."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quat) / np.linalg.norm(quat))
    return matrix.reshape(3, 3)


def published(name):
    """A body's numbers; where ours `differs`, the mirror image of the left one's."""
    bodies = {body["name"]: body for body in FACTS["bodies"]}
    body = bodies[name.replace("right", "left") if name in FACTS["differs"] else name]
    axes = turned(body["inertia_quat"])
    inertia, place = axes @ np.diag(body["inertia"]) @ axes.T, turned(body["quat"])
    found = dict(mass=body["mass"], pos=body["pos"], com=body["com"], inertia=inertia, turn=place)
    if name in FACTS["differs"]:
        found |= {key: found[key] * MIRROR for key in ("pos", "com")}
        found |= {key: MIRROR[:, None] * found[key] * MIRROR for key in ("inertia", "turn")}
    return found


def ours(model, name):
    body = model.body(name)
    axes = turned(body.iquat)
    inertia = axes @ np.diag(body.inertia) @ axes.T
    return dict(
        mass=body.mass[0], pos=body.pos, com=body.ipos, inertia=inertia, turn=turned(body.quat)
    )


def in_pose(model, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def lowest(model, data, geoms):
    """Height of the lowest point of each geom, m."""
    fixed, linear, ring = contacts.floor_distance(model, np.array(geoms))
    row = data.geom_xmat[geoms][:, 6:]
    sine = np.sqrt(np.maximum(1 - row[:, 2] ** 2, 0))
    return data.geom_xpos[geoms, 2] - (fixed + (linear * np.abs(row)).sum(-1) + ring * sine)


def soles(model):
    return [i for i in range(model.ngeom) if "_foot" in model.geom(i).name]


# --- numbers ---


def test_bodies_have_the_published_masses_inertias_and_places_to_a_ten_thousandth(model):
    assert model.nbody == 1 + len(FACTS["bodies"])
    for body in FACTS["bodies"]:
        name, parent = body["name"], body["parent"]
        assert model.body(model.body(name).parentid[0]).name == parent
        expected, found = published(name), ours(model, name)
        for key in ("mass", "com", "inertia", "pos", "turn"):
            if key == "pos" and parent == "world":
                continue  # the height of the pose, below
            size = max(np.abs(expected[key]).max(), 1e-6)
            np.testing.assert_allclose(
                found[key], expected[key], rtol=0, atol=1e-4 * size, err_msg=f"{name} {key}"
            )
    assert model.body_mass.sum() == pytest.approx(FACTS["total_mass"], rel=1e-6)


def test_what_differs_from_the_published_numbers_differs_by_no_more_than_it_says(model):
    knee = {body["name"]: body for body in FACTS["bodies"]}["right_knee_link"]
    axes = turned(knee["inertia_quat"])
    apart = ours(model, "right_knee_link")["inertia"] - axes @ np.diag(knee["inertia"]) @ axes.T
    sides = np.zeros((3, 3))
    sides[0, 2] = sides[2, 0] = 2 * 4.49e-5
    np.testing.assert_allclose(apart, -sides, atol=3e-7)
    shoulder = ours(model, "right_shoulder_pitch_link")["pos"][1]
    assert shoulder == pytest.approx(-0.10021, abs=1.01e-5) and shoulder != -0.10021


def test_joints_are_unitrees_in_unitrees_order_with_the_published_axes_ranges_and_armatures(model):
    assert [model.joint(i).name for i in range(1, model.njnt)] == JOINTS and len(JOINTS) == 29
    assert [model.actuator(i).name for i in range(model.nu)] == JOINTS
    for expected in FACTS["joints"]:
        joint = model.joint(expected["name"])
        assert model.body(joint.bodyid[0]).name == expected["body"]
        np.testing.assert_array_equal(joint.axis, expected["axis"])
        np.testing.assert_array_equal(joint.range, expected["range"])
        assert joint.armature[0] == expected["armature"]
        assert not joint.pos.any() and not joint.damping[0] and not joint.frictionloss[0]


def test_a_sole_stands_on_the_four_points_of_unitrees_foot(model):
    expected = FACTS["feet"]["unitree"]
    for side in ("left", "right"):
        geoms = [model.geom(f"{side}_foot{k}").id for k in (1, 2)]
        ends = [
            model.geom_pos[i] + s * model.geom_size[i, 1] * turned(model.geom_quat[i])[:, 2]
            for i in geoms
            for s in (-1, 1)
        ]
        apart = np.linalg.norm(np.array(ends)[:, None] - expected["points"], axis=-1)
        assert apart.min(0).max() < 1e-6 and apart.min(1).max() < 1e-6
        assert (model.geom_size[geoms, 0] == expected["radius"]).all()
        assert {model.body(model.geom_bodyid[i]).name for i in geoms} == {f"{side}_ankle_roll_link"}


def test_parts_are_published_contact_shapes(model):
    """The capsules and spheres of mjlab, without those of hips, ankles and wrists."""
    left_out = {"hip", "linkage_brace", "wrist"}
    shapes = [
        shape
        for shape in FACTS["parts"]
        if not {shape["name"].partition("_")[2].removesuffix("_collision")} & left_out
    ]
    parts = [i for i in range(1, model.ngeom) if i not in soles(model)]
    assert len(parts) == len(shapes)
    for i, shape in zip(parts, shapes, strict=True):
        text = f"{model.geom(i).name} and {shape['name']}"
        assert model.body(model.geom_bodyid[i]).name == shape["body"], text
        assert model.geom_type[i] == KINDS[shape["type"]], text
        near = dict(atol=6e-4, err_msg=text)
        np.testing.assert_allclose(model.geom_size[i, 0], shape["size"][0], **near)
        np.testing.assert_allclose(model.geom_pos[i], shape["pos"], **near)
        if shape["type"] == "capsule":
            np.testing.assert_allclose(model.geom_size[i, 1], shape["size"][1], **near)
            axis = turned(model.geom_quat[i])[:, 2] @ turned(shape["quat"])[:, 2]
            assert abs(axis) > 0.9999, text


def test_only_the_soles_have_friction_and_nothing_meets_anything_but_the_floor(model):
    floor, feet = model.geom("floor").id, soles(model)
    assert len(feet) == 4
    assert (model.geom_priority[feet] > model.geom_priority[floor]).all()
    assert (model.geom_friction[feet, 0] == 0.8).all()
    assert (model.geom_condim[feet] == 3).all()
    parts = np.setdiff1d(np.arange(model.ngeom), [floor, *feet])
    assert (model.geom_condim[parts] == 1).all()
    assert model.geom_contype.nonzero()[0].tolist() == [floor]
    assert (np.delete(model.geom_conaffinity, floor) == 1).all()


def test_the_home_pose_is_the_tasks_with_both_soles_on_the_floor(model):
    home, pose = model.key("home").qpos, FACTS["home"]["joints"]
    for name, angle in zip(JOINTS, home[7:], strict=True):
        plain = name.removesuffix("_joint")
        side_free = plain.removeprefix("left_").removeprefix("right_")
        assert angle == pose.get(plain, pose.get(side_free, 0)), name
    np.testing.assert_array_equal(home[[0, 1, 3, 4, 5, 6]], [0, 0, 1, 0, 0, 0])
    assert home[2] == pytest.approx(FACTS["home"]["pos"][2], abs=0.005)
    assert model.body("pelvis").pos[2] == home[2]
    data = in_pose(model, home)
    heights = lowest(model, data, soles(model))
    np.testing.assert_allclose(heights, 0, atol=1e-6)  # of the published pose the toes are 1 mm up
    parts = [i for i in range(1, model.ngeom) if i not in soles(model)]
    assert lowest(model, data, parts).min() > 0.1
    middle = data.subtree_com[1]
    feet = data.geom_xpos[soles(model)]
    assert feet[:, 0].mean() == pytest.approx(middle[0], abs=0.01)  # it stands above its soles
    assert middle[1] == pytest.approx(0, abs=5e-4)


# --- left and right ---


def other_side(name):
    """left_... for right_..., and the other way round."""
    side, _, rest = name.partition("_")
    return {"left": "right_", "right": "left_"}[side] + rest


def mirrored(qpos):
    """The mirror image (y to -y) of a pose: sides swapped, turns about x and z reversed."""
    image = qpos.copy()
    image[:7] *= [1, -1, 1, 1, -1, 1, -1]
    for i, joint in enumerate(FACTS["joints"]):
        name = joint["name"]
        twin = name if name.startswith("waist") else other_side(name)
        image[7 + JOINTS.index(twin)] = qpos[7 + i] * (1 if joint["axis"][1] else -1)
    return image


def spread(turn, moments):
    """The tensor with `moments` along the axes `turn`: it forgets the axes' signs, [..., 3, 3]."""
    return np.einsum("...ij,...j,...kj->...ik", turn, moments, turn)


def test_each_right_limb_is_the_exact_mirror_image_of_the_left_one_with_its_looks():
    """In any pose: centres of mass, inertia tensors, and the places, turns and sizes of all shapes."""
    model, rng = mujoco.MjModel.from_xml_path(str(XML)), np.random.default_rng(0)
    lefts = [i for i in range(model.nbody) if model.body(i).name.startswith("left")]
    rights = [model.body(other_side(model.body(i).name)).id for i in lefts]
    assert len(lefts) == 13

    def shapes(bodies):
        return [i for body in bodies for i in np.flatnonzero(model.geom_bodyid == body)]

    left, right = shapes(lefts), shapes(rights)
    assert len(left) > 60
    np.testing.assert_array_equal(model.geom_type[right], model.geom_type[left])
    np.testing.assert_array_equal(model.geom_matid[right], model.geom_matid[left])
    np.testing.assert_array_equal(model.geom_size[right], model.geom_size[left])
    np.testing.assert_array_equal(model.body_mass[rights], model.body_mass[lefts])
    for _ in range(10):
        quat = rng.normal(size=4)
        joints = rng.uniform(*model.jnt_range[1:].T)
        pose = np.concatenate([rng.normal(size=3), quat / np.linalg.norm(quat), joints])
        here, there = in_pose(model, pose), in_pose(model, mirrored(pose))
        near = dict(rtol=0, atol=1e-9)
        np.testing.assert_allclose(there.xipos[rights], here.xipos[lefts] * MIRROR, **near)
        np.testing.assert_allclose(there.geom_xpos[right], here.geom_xpos[left] * MIRROR, **near)
        for now, then, moments, ids, twins in (
            (here.ximat, there.ximat, model.body_inertia, lefts, rights),
            (here.geom_xmat, there.geom_xmat, model.geom_size, left, right),
        ):
            image = MIRROR[:, None] * spread(now[ids].reshape(-1, 3, 3), moments[ids]) * MIRROR
            found = spread(then[twins].reshape(-1, 3, 3), moments[twins])
            np.testing.assert_allclose(found, image, **near)


def test_ranges_and_the_home_pose_are_mirror_images(model):
    low, high = model.jnt_range[1:].T
    home = model.key("home").qpos
    np.testing.assert_array_equal(mirrored(home), home)
    base = np.zeros(7)
    image = np.stack([mirrored(np.concatenate([base, bound]))[7:] for bound in (low, high)])
    np.testing.assert_array_equal(np.sort(image, axis=0), [low, high])


# --- C MuJoCo ---


def gains(publisher):
    return (np.array(FACTS["pd"][publisher][name], float) for name in ("kp", "kd"))


def on_a_rail(timestep):
    """The robot whose pelvis can only move up and down: no PD alone keeps a biped from tipping over."""
    spec = robot.physics_spec(XML)
    home = spec.compile().key("home").qpos
    pelvis = spec.body("pelvis")
    spec.delete(pelvis.joints[0])
    spec.delete(spec.keys[0])
    pelvis.pos = [0, 0, 0]
    pelvis.add_joint(name="rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    model = spec.compile()
    model.opt.timestep = timestep
    data = mujoco.MjData(model)
    data.qpos[:] = home[[2, *range(7, home.size)]]
    return model, data


@pytest.mark.parametrize("timestep", [0.005, 0.002])
@pytest.mark.parametrize("publisher", FACTS["pd"])
def test_its_legs_carry_it_for_five_seconds_under_every_published_pd(publisher, timestep):
    """Explicit PD in steps of 5 and 2 ms: no chatter, no joint near its limit, soles that hold."""
    model, data = on_a_rail(timestep)
    kp, kd = gains(publisher)
    height, pose = data.qpos[0], data.qpos[1:].copy()
    feet = soles(model)
    mujoco.mj_forward(model, data)
    before, most, late = data.geom_xpos[feet].copy(), 0.0, 0.0
    steps = round(5 / timestep)
    for step in range(steps):
        torque = kp * (pose - data.qpos[1:]) - kd * data.qvel[1:]
        most = max(most, (np.abs(torque) / EFFORT).max())
        data.ctrl[:] = np.clip(torque, -EFFORT, EFFORT)
        mujoco.mj_step(model, data)
        if step > 0.8 * steps:
            late = max(late, np.abs(data.qvel).max())
    assert most < 0.2  # of the effort limit
    assert late < 0.01  # m/s and rad/s
    assert 0.005 < height - data.qpos[0] < 0.03
    assert np.abs(data.geom_xpos[feet] - before).max() < 0.01
    assert -0.001 < lowest(model, data, feet).min() < 0
    weight = FACTS["total_mass"] * 9.81
    carried = sum(data.efc_force[c.efc_address : c.efc_address + 4].sum() for c in data.contact)
    assert carried == pytest.approx(weight, rel=0.01)


def with_published_soles(publisher):
    """The robot on the shapes of another's feet, and as high as they need."""
    spec = robot.physics_spec(XML)
    for geom in [geom for geom in spec.geoms if "_foot" in geom.name]:
        spec.delete(geom)
    for shape in FACTS["feet"][publisher]:
        geom = spec.body(shape["body"]).add_geom(
            spec.find_default("foot"), name=shape["name"], type=KINDS[shape["type"]]
        )
        geom.size, geom.pos, geom.quat = shape["size"], shape["pos"], shape["quat"]
    model = spec.compile()
    data = in_pose(model, model.key("home").qpos)
    model.key_qpos[0, 2] -= lowest(model, data, soles(model)).min()
    return model


def tips_over(model):
    """Track of the pelvis under the PD of mjlab until it is below 0.4 m, every 2 ms, [T, 7]."""
    kp, kd = gains("mjlab")
    model.opt.timestep, model.opt.iterations, model.opt.ls_iterations = 0.002, 100, 50
    home = model.key("home").qpos
    data, track = in_pose(model, home), []
    while data.qpos[2] > 0.4:
        torque = kp * (home[7:] - data.qpos[7:]) - kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -EFFORT, EFFORT)
        mujoco.mj_step(model, data)
        track.append(data.qpos[:7] - [0, 0, home[2], 0, 0, 0, 0])
    return np.array(track)


@pytest.mark.parametrize("publisher", ["mjlab", "playground"])
def test_on_two_capsules_it_tips_over_as_on_published_soles(model, publisher):
    one, other = tips_over(model.__copy__()), tips_over(with_published_soles(publisher))
    assert len(one) == pytest.approx(len(other), rel=0.03)
    np.testing.assert_allclose(one[:500], other[:500], atol=0.01)  # 1 s
    assert np.abs(one[500]).max() > 0.1


def test_a_foot_of_capsules_needs_the_fewest_contacts_and_rows(model):
    """Room that MuJoCo Warp must keep for the soles alone."""

    def room(model):
        model.geom_conaffinity[:] = 0
        model.geom_conaffinity[soles(model)] = 1
        count, rows = contacts.most(model)
        return count, rows - 29  # limits of the joints

    assert room(model.__copy__()) == (8, 32)
    assert room(with_published_soles("mjlab")) == (28, 112)
    assert room(with_published_soles("playground")) == (16, 64)


def test_the_config_has_mjlabs_motors():
    task = config.load("g1.py").task
    kp, kd = gains("mjlab")

    def numbers(field):
        return per_joint.numbers(f"task.{field}", task[field], JOINTS, "g1")

    np.testing.assert_allclose(numbers("kp"), kp, rtol=1e-5)
    np.testing.assert_allclose(numbers("kd"), kd, rtol=1e-5)
    np.testing.assert_array_equal(numbers("effort_limit"), EFFORT)
    np.testing.assert_array_equal(numbers("saturation_effort"), EFFORT)
    np.testing.assert_array_equal(
        numbers("velocity_limit"), [joint["velocity_limit"] for joint in FACTS["joints"]]
    )
    np.testing.assert_allclose(numbers("action_scale"), 0.25 * EFFORT / kp, rtol=1e-5)
    assert kd.size == 29

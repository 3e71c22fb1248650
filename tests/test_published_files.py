"""Files as people publish them, from `look` to a played policy: nothing refuses what `look` lets pass."""

from functools import partial
from pathlib import Path

import jax
import mujoco
import numpy as np
import published
import pytest
import robot_files
from answers import refused, status
from toy_policy import GO1, save

from dynappo import config as config_lib
from dynappo.description import mjcf, motors, robot
from dynappo.look import command as look_command
from dynappo.physics import c_mujoco
from dynappo.play import command as play_command
from dynappo.policy import policy_file
from dynappo.program import build

look, play = partial(status, look_command.main), partial(status, play_command.main)
CONFIG = """
from dynappo import config as config_lib
def get_config(variant=""):
    config = config_lib.load("configs/default.py:laptop")
    config.robot = "mine"
    config.ppo.symmetry = False
    config.physics.impl = "{impl}"
    config.physics.threads = 1
    return config
"""
EULER = published.mjcf().replace(' integrator="implicitfast"', "")
TOE = '<geom type="sphere" size="0.023" priority="1" condim="6"'
EQUALITY = '<equality><connect body1="FL_thigh" body2="FL_calf" anchor="0.03 0 -.2"/></equality>'
TENDON = '<tendon><fixed class="toy" stiffness="20"><joint joint="FL_thigh_joint" coef="1"/></fixed></tendon>'


def ended(more):
    return EULER.replace("</mujoco>", f"{more}</mujoco>")


def floor_gone(text):
    start = text.index('<geom name="floor"')
    return text[:start] + text[text.index("/>", start) + 2 :]


KINDS = {
    "no floor, classes with materials, servos, turned frames": EULER,
    "collides as looks that have a class with a material": EULER.replace(
        '<geom type="box" size="0.15 0.06 0.05" group="3"/>',
        '<geom class="look" mesh="cube" contype="1" conaffinity="1" group="3"/>',
    ),
    "a material of all shapes": EULER.replace("<default>", '<default><geom material="dark"/>', 1),
    "an equality": ended(EQUALITY),
    "a tendon of a class": ended(TENDON),
    "a pose without numbers": published.mjcf('<keyframe><key name="home"/></keyframe>')
    .replace(' integrator="implicitfast"', "")
    .replace('range="-2.8 -0.5"', 'range="-2.8 0.5"'),
    "gravity of the moon": EULER.replace("<option", '<option gravity="0 0 -1.62"'),
    "masses from shapes, several hinges in a body": robot_files.biped(),
    "a scene, a mesh and a picture that are not there": robot_files.turned(),
    "only the floor is missing": floor_gone(robot_files.hexapod()),
}


def mine(text, monkeypatch, folder, impl="c") -> Path:
    """A folder with the robot `mine` and its config, in which the commands are called."""
    monkeypatch.chdir(folder)
    for name in ("robots/mine", "configs"):
        Path(name).mkdir(parents=True)
    published.write(Path("robots/mine"), text).rename("robots/mine/mine.xml")
    Path("configs/mine.py").write_text(CONFIG.format(impl=impl))
    return Path("robots/mine/mine.xml")


def checked():
    """The config and the robot, after all that `train` asks before it compiles."""
    config = config_lib.validate(config_lib.load("configs/mine.py"))
    build.check(config)
    return motors.fitted(config, robot.load("mine"))


def actor(count):
    """Of zero actions."""
    layers = {
        f"Dense_{i}": {"kernel": np.zeros(size, "f4"), "bias": np.zeros(size[1], "f4")}
        for i, size in enumerate([(12 + 3 * count, 8), (8, count)])
    }
    return {"actor": {"params": layers}, "std": np.ones(count, "f4")}


# what is read and told of the others is tested without a run (description/, look/, physics/)
SLOW = {
    "collides as looks that have a class with a material",
    "a material of all shapes",
    "a tendon of a class",
    "gravity of the moon",
    "only the floor is missing",
}


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.slow] if kind in SLOW else []) for kind in KINDS],
)
def test_what_look_lets_pass_trains_and_plays(kind, tmp_path, monkeypatch, capsys):
    """A control step of C MuJoCo, a second of play, in the robot that the policy carries too."""
    mine(KINDS[kind], monkeypatch, tmp_path)
    assert look("mine") == 0, capsys.readouterr().err
    config, found = checked()
    step = jax.jit(jax.vmap(c_mujoco.make(found, config.physics, frozenset())))
    numbers = [1.0, 0.0, 0.0, 0.0, 0.8, 1.0, 25.0, 0.5, 20.0, 20.0, 30.0, 0.0]
    speeds = np.zeros(found.mj_model.nv)
    one = found.home_qpos, speeds, speeds, np.tile(found.default_pose, (4, 1)), numbers
    moved = step(*[np.asarray(x, np.float32)[None] for x in one])
    assert np.isfinite(moved.qpos).all() and (moved.qpos[:, 2] > 0.1).all()
    policy_file.save(Path("mine.npz"), actor(len(found.joint_names)), config, found)
    assert play("mine.npz", "--seconds=1", "--out=here.html") == 0, capsys.readouterr().err
    Path("robots/mine/mine.xml").unlink()
    assert play("mine.npz", "--seconds=1", "--out=carried.html") == 0, capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_the_text_of_a_completed_robot_is_that_robot(kind, tmp_path, monkeypatch):
    """It needs no completion, and moves as the file does, to the six digits that MuJoCo writes."""
    found = robot.load_xml(mine(KINDS[kind], monkeypatch, tmp_path))
    assert found.notes and found.played == found.alone
    again = robot.load_text(found.alone, "mine", Path("mine.xml"))
    assert set(again.notes) <= {note for note in found.notes if "options" in note}
    assert again.joint_names == found.joint_names and again.foot_names == found.foot_names
    rng, speeds = np.random.default_rng(0), []
    pose = found.home_qpos + np.r_[np.zeros(7), rng.normal(0, 0.1, len(found.joint_names))]
    for model in (found.mj_model, again.mj_model):
        data = mujoco.MjData(model)
        data.qpos[:] = pose
        data.ctrl[:] = np.linspace(-1, 1, model.nu)
        mujoco.mj_step(model, data, 4)
        speeds.append(data.qvel.copy())
    np.testing.assert_allclose(speeds[1], speeds[0], atol=5e-3)
    assert np.abs(speeds[0]).max() > 0.1


def test_a_file_in_another_encoding_than_utf8_is_one_line(tmp_path):
    file = tmp_path / "mine.xml"
    text = robot_files.biped().replace("<mujoco>", '<mujoco model="s\xfdn">')
    file.write_bytes(text.encode("latin-1"))
    assert refused(robot.load_xml, file).startswith(f"{file}: expected a text in UTF-8: ")


@pytest.mark.parametrize("name", ["go1", "g1"])
def test_a_file_that_lacks_nothing_is_played_as_it_is(name):
    found = robot.load(name)
    assert not found.played and not found.notes and found.alone == found.xml.read_text()


def test_an_engine_that_cannot_is_refused_by_look_as_by_train(tmp_path, monkeypatch, capsys):
    """Where the config chooses it; where the machine does, a note says so."""
    mine(published.mjcf(), monkeypatch, tmp_path)
    assert look("mine") == 2
    said = capsys.readouterr()
    line = refused(checked)
    assert said.err == f"dynappo: {line}\n" and not said.out
    assert line.startswith("physics.impl is c, but ") and "the integrator implicitfast" in line
    Path("configs/mine.py").write_text(CONFIG.format(impl="auto"))
    assert look("mine") == 0
    told = "note: C MuJoCo (physics.impl=c) cannot simulate the file: the integrator implicitfast"
    assert told in capsys.readouterr().out.splitlines()
    checked()


def test_what_mjx_lacks_is_refused_by_look_as_by_train(tmp_path, monkeypatch, capsys):
    option = EULER.replace("<option", '<option noslip_iterations="3"')
    mine(option, monkeypatch, tmp_path, impl="jax")
    assert look("mine") == 2
    said = capsys.readouterr()
    assert said.err == f"dynappo: {refused(checked)}\n" and "opt.noslip_iterations" in said.err


def test_motors_that_are_not_their_mirror_image_are_refused_by_look_as_by_train(
    tmp_path, monkeypatch, capsys
):
    mine(EULER, monkeypatch, tmp_path)
    text = CONFIG.format(impl="c").replace("symmetry = False", "symmetry = True")
    gains = "config.task.kp = {'FL_.*': 20.0, '.*': 25.0}"
    Path("configs/mine.py").write_text(text.replace("    return", f"    {gains}\n    return"))
    assert look("mine") == 2
    said = capsys.readouterr()
    assert said.err == f"dynappo: {refused(checked)}\n" and "task.kp is 25" in said.err


# ---- another file, as it is


@pytest.mark.parametrize("own", ["", '<geom contype="4" conaffinity="8"/>'])
def test_another_file_without_a_floor_gets_one_and_nothing_else(own, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    save(Path("policy.npz"))
    text = GO1.xml.read_text()
    bare = floor_gone(text)
    if own:  # it touches what has these bits
        bare = bare.replace('contype="0" conaffinity="1"', 'contype="4" conaffinity="8"')
    Path("bare.xml").write_text(bare)
    assert play("policy.npz", "--robot-xml=bare.xml", "--seconds=1", "--out=a.html") == 0
    assert "note: bare.xml has no floor; one is added" in capsys.readouterr().out
    one, other = mujoco.MjModel.from_xml_string(bare), mjcf.model(Path("bare.xml"))
    assert other.ngeom == one.ngeom + 1 and other.nq == one.nq and other.nu == one.nu
    np.testing.assert_array_equal(other.body_mass, one.body_mass)
    np.testing.assert_array_equal(other.geom_friction[1:], one.geom_friction)
    data = mujoco.MjData(other)
    data.qpos[:] = GO1.home_qpos
    mujoco.mj_step(other, data, 100)
    assert data.ncon and 0.05 < data.qpos[2] < 0.4
    whole = mjcf.model(GO1.xml)
    assert robot.digest(whole) == robot.digest(mujoco.MjModel.from_xml_path(str(GO1.xml)))


# ---- options


def test_options_that_are_not_mujocos_are_simulated_and_told(tmp_path):
    text = GO1.xml.read_text().replace(
        "</mujoco>",
        '<option gravity="0 0 -1.62" wind="3 0 0" density="2"><flag eulerdamp="disable"/></option></mujoco>',
    )
    file = tmp_path / "mine.xml"
    file.write_text(text)
    found = robot.load_xml(file)
    expected = "gravity 0 0 -1.62, wind 3 0 0, density 2, no eulerdamp"
    assert found.notes == (f"the file's options are simulated: {expected}",)
    assert found.mj_model.opt.gravity[2] == -1.62
    assert found.alone == text and not found.played  # nothing was changed


@pytest.mark.parametrize("flag", ["contact", "limit", "gravity", "constraint", "actuation"])
def test_flags_with_which_nothing_is_learned_are_refused(flag, tmp_path):
    file = tmp_path / "mine.xml"
    option = f'<option><flag {flag}="disable"/></option></mujoco>'
    file.write_text(GO1.xml.read_text().replace("</mujoco>", option))
    line = refused(robot.load_xml, file)
    assert line.startswith(f"{file}: expected no <flag> in <option> that disables ")
    assert line.endswith(f"found {flag}")


def test_gravity_that_points_up_is_refused(tmp_path):
    file = tmp_path / "mine.xml"
    option = '<option gravity="0 0 9.81"/></mujoco>'
    file.write_text(GO1.xml.read_text().replace("</mujoco>", option))
    assert "expected gravity that points down" in refused(robot.load_xml, file)


def test_a_motor_that_stands_gives_no_more_than_its_saturation(capsys):
    """kp x action_scale x init_std is 6.2 N m."""
    fields = ["--config.task.saturation_effort=10", "--config.task.effort_limit=40"]
    assert look("go1", *fields) == 0
    said = capsys.readouterr().out
    assert "6.2 N m, at FL_hip_joint: 62% of the limit 10" in said
    told = "note: task.effort_limit is 40 N m at FL_hip_joint, which its motor cannot reach"
    assert told in said

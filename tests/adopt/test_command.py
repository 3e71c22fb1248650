"""`dynappo adopt`: what it writes of a published robot, that the robot moves as published, every mistake."""

import hashlib
import os
import re
import warnings
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import published
import pytest
from answers import mistake, refused, shell, status

from dynappo import config as config_lib
from dynappo.adopt import command, source
from dynappo.config import files, versions
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.physics.warp import scope

run = partial(status, command.main)


@pytest.fixture(scope="module")
def adopted(tmp_path_factory):
    """`(folder, robot, config, printed)` of the toy after one `adopt`, which looks at it, too."""
    folder, before = tmp_path_factory.mktemp("adopted"), Path.cwd()
    published.write(folder / "from")
    os.chdir(folder)
    printed = []
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "builtins.print", lambda *what: printed.extend(" ".join(what).split("\n"))
            )
            patch.setattr(command, "look", lambda folder, name: [f"look {name}", "note: this"])
            assert run("from/toy.xml", "--name=mine") == 0
        config = config_lib.validate(config_lib.load("configs/mine.py"))
        robot = robot_lib.load("mine")
        yield folder, robot, config, printed
    finally:
        os.chdir(before)


def test_it_writes_a_robot_that_needs_nothing_more(adopted):
    """No line is left to be said of the file, and the one-kernel physics takes it."""
    folder, robot, config, printed = adopted
    assert robot.notes == () and robot.xml == folder / "robots/mine/mine.xml"
    assert robot.foot_names == ("FR", "FL", "RR", "RL") and len(robot.joint_names) == 12
    assert robot.mj_model.body_mass.sum() == pytest.approx(6 + 4 * (0.7 + 1 + 0.2 + 0.05))
    assert scope.slower(robot, config.physics) == ""
    assert sorted(p.name for p in (folder / "robots/mine").iterdir()) == [
        "README.md",
        "assets",
        "mine.xml",
    ]
    assert (folder / "robots/mine/assets/cube.obj").read_text() == published.CUBE
    assert not [*folder.glob("robots/.*")]
    # what asks for something comes last, before what is next
    assert printed[-6:-1] == ["", "look mine", "", "note: this", ""]
    assert "train --config=configs/mine.py" in printed[-1]


def test_it_moves_as_published(adopted):
    """Accelerations of both models for the same state and torques, without contacts, servos, friction and
    damping."""
    folder, robot, _, _ = adopted
    theirs = mujoco.MjModel.from_xml_path(str(folder / "from/toy.xml"))
    theirs.dof_damping[:], theirs.dof_frictionloss[:] = 0, 0
    mine, both = robot.mj_model, []
    rng = np.random.default_rng(1)
    qpos, qvel = rng.normal(size=(2, 12)) * 0.3 + [[0.5], [0]]
    torque, base = rng.normal(size=12), rng.normal(size=6)
    for model in (theirs, mine):
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        data = mujoco.MjData(model)
        data.qpos[:7] = [0, 0, 0.5, 0.9, 0.1, 0.3, 0.2] / np.array([1, 1, 1, *[0.95**0.5] * 4])
        order = [model.joint(name).id - 1 for name in robot.joint_names]
        data.qvel[:6] = base
        data.qpos[7:][order], data.qvel[6:][order] = qpos, qvel
        data.qfrc_applied[6:][order] = torque
        mujoco.mj_forward(model, data)
        both.append(np.concatenate([data.qacc[:6], data.qacc[6:][order]]))
    np.testing.assert_allclose(both[1], both[0], rtol=1e-4, atol=1e-3 * np.abs(both[0]).max())


def test_looks_are_where_they_were(adopted):
    """The corners of every mesh in the world, in the same pose."""
    folder, robot, _, _ = adopted
    clouds = []
    for file in (folder / "from/toy.xml", robot.xml):
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        data.qpos[:] = [0, 0, 0.3, 1, 0, 0, 0, *[0.2, 0.8, -1.5] * 4]
        mujoco.mj_kinematics(model, data)
        points = []
        for geom in np.flatnonzero(model.geom_group == 2):
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            corners = model.mesh_vert[start : start + count]
            points.append(corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        points = np.concatenate(points)
        clouds.append(points[np.lexsort(np.round(points, 4).T)])
    assert clouds[0].shape == (5 * 8, 3)
    np.testing.assert_allclose(clouds[1], clouds[0], atol=1e-4)


def test_the_config_has_its_motors_and_its_mass(adopted):
    _, robot, config, _ = adopted
    fitted, _ = motors.fitted(config, robot)
    task = fitted.task
    assert task.effort_limit == tuple([23.7, 23.7, 35.5] * 4) == task.saturation_effort
    assert task.reset.spawn_height == pytest.approx(robot.home_qpos[2] + 0.05, abs=0.006)
    assert task.randomize.base_mass == (-1.4, 1.4)
    assert robot.mj_model.dof_damping[6:].any() == robot.mj_model.dof_frictionloss.any() == False  # noqa: E712
    assert config_lib.load("configs/mine.py:laptop").run.num_iterations == 400


def test_the_readme_has_source_licence_and_every_line(adopted):
    folder, _, _, printed = adopted
    text = " ".join((folder / "robots/mine/README.md").read_text().split())
    assert "from `toy.xml`" in text and "BSD-3-Clause, Copyright 2026 Somebody" in text
    for line in printed[:-7]:
        assert " ".join(line.split()) in text
    said = "\n".join(printed)
    for part in (
        "solver: Newton",
        "dry friction of 0.2",
        "damping of 2",
        "frames: turned",
        "feet: solimp",
    ):
        assert part in said


def test_a_urdf_is_adopted_with_a_pose_of_bent_legs(tmp_path, monkeypatch, capsys):
    """Feet below the legs' second joints, by forward kinematics; limits of the file; the looks are not
    there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    Path("toy.urdf").write_text(published.urdf())
    assert run("toy.urdf") == 0
    said, robot = capsys.readouterr().out, robot_lib.load("toy")
    for part in ("camera.dae", "those of a ball of 2 cm", "4 legs bent to 85%", "speed: 21 rad/s"):
        assert part in said
    config = config_lib.load("configs/toy.py")
    assert (config.task.effort_limit, config.task.velocity_limit) == (30.0, 21.0)
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(robot.mj_model, data)
    for foot, name in zip(robot.feet, robot.foot_names, strict=True):
        hip = data.xanchor[robot.mj_model.joint(f"{name}_thigh_joint").id]
        ahead, _, down = data.geom_xpos[foot] - hip
        assert abs(ahead) < 0.03 and down == pytest.approx(-0.85 * 0.42, abs=0.02)
    assert robot.mj_model.body_mass.sum() == pytest.approx(6 + 0.1 + 4 * 1.95)


def test_nothing_is_written_over(adopted, tmp_path, monkeypatch, capsys):
    """But with --force, whole."""
    folder, *_ = adopted
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    file = folder / "from/toy.xml"
    Path("configs").mkdir()
    Path("configs/toy.py").write_text("mine")
    assert "configs/toy.py is there already" in mistake(command.main, [file], capsys)
    assert not Path("robots").exists() and Path("configs/toy.py").read_text() == "mine"
    assert run(file, "--force") == 0
    (Path("robots/toy/README.md")).write_text("old")
    assert "robots/toy is there already" in mistake_after(file, capsys)
    assert Path("robots/toy/README.md").read_text() == "old"
    assert run(file, "--force") == 0 and "old" != Path("robots/toy/README.md").read_text()
    monkeypatch.setattr(files, "PACKAGE", tmp_path / "dynappo")  # as in a clone of dynappo
    assert command.check_free("toy", force=True) == (Path("robots/toy"), Path("configs/toy.py"))
    assert "there already" in refused(command.check_free, "toy", force=False)
    Path("configs/toy.py").write_text("dynappo's own")
    assert "dynappo has that itself" in refused(command.check_free, "toy", force=True)


def mistake_after(file, capsys):
    capsys.readouterr()
    return mistake(command.main, [file], capsys)


BALL = (  # an arm on a base that lies on the floor
    '<mujoco><worldbody><body name="a"><freejoint/><geom size="1"/><body pos="0 0 2"><joint/>'
    '<geom size=".1"/></body></body></worldbody></mujoco>'
)
XACRO = '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arg name="a"/></robot>'
UNBOUND = '<robot><xacro:arg name="a"/></robot>'
COMPUTED = '<robot name="a"><link name="b"><inertial><mass value="${m}"/></inertial></link></robot>'
MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "no file given; try: "),
    "no file": (["no.xml"], "no.xml: there is no such file"),
    "a name": (["toy.xml", "--name=a/b"], "--name=a/b: expected letters"),
    "ours": (["toy.xml", "--name=go1"], "--name=go1: dynappo has that itself"),
    "default": (["toy.xml", "--name=default"], "dynappo has that itself"),
    "no XML": (["text.xml"], "text.xml: XML parse error"),
    "other XML": (["page.xml"], "expected an MJCF or a URDF, found the element html"),
    "no legs": (["ball.xml"], "ball.xml: no legs found"),
    "a folder": (["assets"], "assets: it is a folder; name the MJCF"),
    "a xacro": (["macro.xml"], "macro.xml: it is a xacro; make a URDF of it first: xacro FILE > "),
    "no namespace": (
        ["unbound.xml"],
        "it is a xacro and no XML (unbound prefix: line 1, column 7); make",
    ),
    "cut": (
        ["cut.xacro"],
        "cut.xacro: it is a xacro and no XML (no element found: line 1, column 7); make",
    ),
    "values": (
        ["computed.xacro"],
        "computed.xacro: it is a xacro; make a URDF of it first: xacro FILE > ",
    ),
    "biped": (["toy.xml", "--name=biped"], "dynappo has that itself"),
    **{
        f"of {name}": (["toy.xml", f"--name={name}"], f"--name={name}: dynappo has that itself")
        for name in ("brax", "playground", "go1_deploy", "go1_rough")
    },
    "a picture": (
        ["map.png"],
        "map.png: it is not text in UTF-8; expected an MJCF or a URDF, saved in",
    ),
    "a policy": (["go1.npz"], "go1.npz: it is not text in UTF-8; expected an MJCF or a URDF"),
    "UTF-16": (["wide.xml"], "wide.xml: it is not text in UTF-8"),
    "no number": (
        ["nan.xml"],
        "nan.xml: the keyframe home has a number that is not finite; correct it",
    ),
    "unlike motors": (
        ["unlike.xml"],
        "effort_limit is 31 at FR_calf_joint and 35.5 at FL_calf_joint, expected the same left and right "
        "where ppo.symmetry is True; make these numbers alike in the file",
    ),
    "a flag": (["toy.xml", "--nam=x"], "--nam=x: no such flag"),
}


@pytest.mark.parametrize("name", [".", "3.xml"])
def test_no_name_is_chosen_for_what_is_no_file(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert mistake(command.main, [name], capsys).startswith(f"dynappo: {name}: ")
    assert command.parse([name]).notes == []


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)
    texts = {"text": "no", "page": "<html/>", "ball": BALL, "macro": XACRO, "unbound": UNBOUND}
    for file, text in texts.items():
        Path(f"{file}.xml").write_text(text)
    Path("cut.xacro").write_text("<robot>")
    Path("computed.xacro").write_text(COMPUTED)
    Path("map.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff")
    Path("go1.npz").write_bytes(b"PK\x03\x04\xff")
    Path("wide.xml").write_text(published.mjcf(), encoding="utf-16")
    Path("nan.xml").write_text(published.mjcf().replace("0 0 0.3 1", "0 0 nan 1"))
    calf = '<position class="calf" name="FR_calf"'
    Path("unlike.xml").write_text(published.mjcf().replace(calf, calf + ' forcerange="-31 31"'))
    before = sorted(tmp_path.rglob("*"))
    arguments, expected = MISTAKES[name]
    assert expected in mistake(command.main, arguments, capsys)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_robot_that_look_and_train_refuse_is_not_kept(tmp_path, monkeypatch, capsys):
    """One that is not its own mirror image; one without an engine; what `look` alone finds."""
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    text = published.mjcf()
    hip = '<joint name="FR_hip_joint" axis="1 0 0"'
    assert hip in text
    Path("toy.xml").write_text(text.replace(hip, hip.replace("1 0 0", "0.8 0 0.6")))
    said = mistake(command.main, ["toy.xml"], capsys)
    assert "toy.xml: robot toy is not its own mirror image: no partner of FR_hip_joint" in said
    Path("toy.xml").write_text(text)
    with monkeypatch.context() as patch:
        patch.setattr(command.engine_contract, "lacks", lambda *_: "magic")
        said = mistake(command.main, ["toy.xml"], capsys)
        assert "toy.xml: MJX cannot simulate it (magic)" in said
        calls = iter(["magic", ""])
        patch.setattr(command.engine_contract, "lacks", lambda *_: next(calls))
        patch.setattr(command, "has_gpu", lambda: False)
        patch.setattr(command, "look", lambda *_: [])
        assert run("toy.xml") == 0
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.endswith("--config=configs/toy.py:laptop --config.physics.impl=c")
        for folder in ("robots", "configs"):
            command.shutil.rmtree(folder)
    for code, kind in ((2, "refused"), (1, "blown up")):
        done = command.subprocess.CompletedProcess([], code, "", f"dynappo: {kind}\n")
        with monkeypatch.context() as patch:
            patch.setattr(command.subprocess, "run", lambda *_, done=done, **__: done)
            assert status(command.main, "toy.xml") == code
        assert f"toy is not kept, for look refuses it: {kind}" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_radians_that_are_read_as_degrees_are_told_last(tmp_path, monkeypatch, capsys):
    """By `adopt` and by `look`, which it runs; without a GPU `next` trains on the CPU."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "has_gpu", lambda: False)
    published.write(tmp_path, published.mjcf().replace(' angle="radian"', ""))
    assert run("toy.xml") == 0
    lines = capsys.readouterr().out.splitlines()
    rest = [line for line in lines[lines.index("", lines.index("") + 1) :] if line]
    assert len(rest) == 3
    assert rest[0].startswith("EDIT NEEDED: no joint turns by more than 0.065 rad, so the file's")
    assert rest[1].startswith("note: no joint turns by more than 0.065 rad: in the file")
    assert rest[2].startswith("next ") and rest[2].endswith("train --config=configs/toy.py:laptop")


def test_whether_there_is_a_gpu(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setattr(command, "GPUS", [f"{tmp_path}/nvidia[0-9]*"])
    (tmp_path / "nvidiactl").touch()
    assert not command.has_gpu()
    (tmp_path / "nvidia0").touch()
    assert command.has_gpu()
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert not command.has_gpu()
    monkeypatch.setenv("JAX_PLATFORMS", "cuda,cpu")
    assert command.has_gpu()


@pytest.mark.parametrize(
    ("file", "name"),
    [("my-robot.v2", "my_robot_v2"), ("3-legs", "robot_3_legs"), ("\xe9", "robot_")],
)
def test_a_name_is_made_of_the_files(file, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    published.write(tmp_path).rename(f"{file}.xml")
    assert run(f"{file}.xml") == 0
    assert capsys.readouterr().out.startswith(f"name: {name}, for a name has letters")
    assert robot_lib.load(name).name == name and Path(f"configs/{name}.py").is_file()


MASSES = {  # (file, what is replaced, by what): what the line must say
    (
        "toy.xml",
        'mass="0.2"',
        'mass="nan"',
    ): "the inertial of FR_calf has mass='nan', expected a number",
    ("toy.xml", "0.0005 0.0006", "inf 0.0006"): "the inertial of FR_hip has diaginertia='inf",
    ("toy.xml", 'size="0.02"', 'size="0.02" mass="nan"'): "the geom of FR_thigh has mass='nan'",
    ("toy.urdf", 'mass value="0.2"', 'mass value="nan"'): "the mass of FR_calf has value='nan'",
    ("toy.urdf", 'ixx="0.0006"', 'ixx="x"'): "the inertia of FR_hip has ixx='x', expected a number",
}


@pytest.mark.parametrize("case", MASSES)
def test_a_mass_that_is_no_number_is_one_line(case, tmp_path):
    """MuJoCo would take the mass of the shapes for it."""
    file, old, new = case
    text = published.urdf() if file.endswith("urdf") else published.mjcf()
    assert old in text
    published.write(tmp_path)
    (tmp_path / "a").write_text(text)
    path = tmp_path / file
    path.write_text(text.replace(old, new, 1))
    assert MASSES[case] in refused(source.read, path)
    include = tmp_path / "scene.xml"
    if file.endswith("xml"):
        include.write_text('<mujoco><include file="toy.xml"/></mujoco>')
        assert MASSES[case] in refused(source.read, include)


@pytest.mark.parametrize(("lower", "upper"), [("2.8", "-2.8"), ("nan", "2.8"), ("-2.8", "x")])
def test_limits_of_a_urdf_that_limit_nothing_are_one_line(lower, upper, tmp_path):
    """MuJoCo would turn the joint without end."""
    before, joint, after = published.urdf().partition('name="FL_calf_joint"')
    old = 'lower="-2.8" upper="2.8"'
    assert joint and old in after
    path = tmp_path / "toy.urdf"
    path.write_text(before + joint + after.replace(old, f'lower="{lower}" upper="{upper}"', 1))
    expected = (
        f"the limits of FL_calf_joint are {lower} to {upper}, expected numbers, lower below upper"
    )
    assert refused(source.read, path) == f"{path}: {expected}"


@pytest.mark.parametrize("kind", ["toy.xml", "toy.urdf"])
def test_a_robot_of_next_to_no_mass_is_one_line(kind, tmp_path, monkeypatch, capsys):
    """Whose limits would all be rounded to nothing."""
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)
    text = published.mjcf() if kind == "toy.xml" else published.urdf()
    text = re.sub(r'(mass(?: value)?=)"[^"]*"', r'\1"1e-5"', text)
    Path(kind).write_text(
        re.sub(
            r'<link name="camera">.*?</link>|\s*<joint name="on".*?</joint>', "", text, flags=re.S
        )
    )
    assert status(command.main, kind) == 2
    line = capsys.readouterr().err
    assert re.search(
        r"has a mass of 0.000\d+ kg, expected 0.05 kg or more: its heaviest body, \w+, has [12]e-05 kg",
        line,
    )
    assert not Path("robots").exists()


def test_a_placeholder_beside_the_robot_is_left_out(tmp_path, monkeypatch, capsys):
    """As Unitree's files have it, and the keyframe of the scene, with a number for it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    parked = '<body name="not_use" pos="0 0 20"><joint name="not_use"/><geom size="0.1" mass="1"/></body>'
    text = published.mjcf(home="").replace("</worldbody>", parked + "</worldbody>")
    published.write(tmp_path, text)
    home = published.HOME.replace('-1.5"', '-1.5 0.7"')
    Path("scene.xml").write_text(f'<mujoco><include file="toy.xml"/>{home}</mujoco>')
    assert run("toy.xml") == 0
    said = capsys.readouterr().out
    assert "left out, for nothing moves on them: not_use\n" in said
    assert "that of scene.xml beside it" in said
    robot = robot_lib.load("toy")
    assert robot.mj_model.nbody == 14 and robot.default_pose[2] == -1.5
    assert "5 shapes as published" in said  # not the placeholder's


def test_a_folder_that_fails_halfway_is_gone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match="full"), command.new_folder(Path("robots/mine")) as part:
        (part / "a").write_text("a")
        raise OSError("full")
    assert not [*tmp_path.iterdir()]


def test_a_licence_is_found_up_to_the_package_or_in_the_file(tmp_path):
    """Further up it is that of something else; and our own comment is none."""
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    file = inside / "toy.xml"
    file.write_text("<mujoco><!-- Copyright 2020 Me, MIT License --></mujoco>")
    (tmp_path / "COPYING.txt").write_text("GPL\n")
    assert source.licence(file) == ("comments in toy.xml", "Copyright 2020 Me, MIT License")
    (tmp_path / "a" / "package.xml").touch()
    assert source.licence(file)[0] == "comments in toy.xml"
    (tmp_path / "a" / "package.xml").rename(tmp_path / "package.xml")
    assert source.licence(file) == ("../../COPYING.txt", "GPL")
    (inside / "LICENSE").write_text("BSD")
    assert source.licence(file)[1] == "BSD"
    (inside / "LICENSE").unlink()
    (tmp_path / "COPYING.txt").unlink()
    file.write_text(
        "<mujoco><!-- x, adopted by `dynappo adopt`: README.md has the licence --></mujoco>"
    )
    assert source.licence(file) == ("", "")


@pytest.mark.parametrize("folder", [".", "mine/spider"])
def test_in_a_clone_our_licence_is_not_the_robots(folder, tmp_path, monkeypatch):
    """Whoever works in one would publish their robot under it; one of their own counts, beside ours, too."""
    ours = tmp_path / "clone"
    (ours / ".git").mkdir(parents=True)
    (ours / "LICENSE").write_text("Apache-2.0\n")
    (ours / folder).mkdir(parents=True, exist_ok=True)
    monkeypatch.chdir(ours)
    file = Path(folder) / "toy.xml"
    file.write_text("<mujoco/>")
    assert source.licence(file)[1] == "Apache-2.0"  # another repository's
    said = source.origin(file)
    (ours / "dynappo").mkdir()
    (ours / "dynappo/algorithm.py").touch()  # a clone, wherever the package is that runs
    assert source.licence(file) == ("", "") and source.origin(file) == said.partition(";")[0]
    (ours / "dynappo/algorithm.py").unlink()
    monkeypatch.setattr(versions, "ROOT", ours)
    assert source.licence(file) == ("", "")
    (ours / "LICENSE.spider").write_text("BSD\n")
    assert source.licence(file)[1] == "BSD"


@pytest.mark.parametrize("file", ["my--robot.xml", "my---robot.xml", 'tri"""q.xml', "b\\x.urdf"])
def test_any_file_name_and_joint_name_can_be_written(file, tmp_path, monkeypatch):
    """In a comment of XML, a docstring and the patterns of a config."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    text = published.urdf() if file.endswith("urdf") else published.mjcf()
    text = re.sub(r"(F[LR])_(hip|thigh|calf)_joint", r"\1-\2&quot;joint", text)
    published.write(tmp_path)
    Path(file).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert run(file, "--name=mine") == 0
        compile(Path("configs/mine.py").read_text(), "mine.py", "exec")
    task = motors.fitted(config_lib.load("configs/mine.py"), robot_lib.load("mine"))[0].task
    assert len(np.unique(task.effort_limit)) == (1 if file.endswith("urdf") else 2)


def test_what_is_no_scene_beside_the_robot_is_left_alone(tmp_path, monkeypatch, capsys):
    """Names that are not UTF-8; a pipe, which nobody writes to; a keyframe that is no number."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    published.write(tmp_path, published.mjcf(home=""))
    joint = published.mjcf().replace("FR_hip_joint", "h\xfcfte")
    Path("latin1.xml").write_text(joint, encoding="latin1")
    Path("nan.xml").write_text(published.mjcf().replace("0 0 0.3 1", "0 0 nan 1"))
    os.mkfifo("pipe.xml")
    assert run("toy.xml") == 0
    assert "home: no keyframe; 4 legs bent" in capsys.readouterr().out


def test_where_a_file_is_from_is_read_from_its_checkout(tmp_path, monkeypatch):
    file = tmp_path / "robots/toy.xml"
    file.parent.mkdir()
    file.write_text("<mujoco/>")
    only = "sha256 " + hashlib.sha256(b"<mujoco/>").hexdigest()
    assert source.origin(file) == only
    git = tmp_path / ".git"
    git.mkdir()
    (git / "config").write_text('[remote "origin"]\n\turl = https://me:word@host.org/some/robots\n')
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    (git / "packed-refs").write_text("# pack-refs\nab12 refs/heads/main\n")
    expected = f"{only}; `robots/toy.xml` of https://host.org/some/robots, commit ab12"
    assert source.origin(file) == expected
    (git / "HEAD").write_text("cd34\n")
    assert source.origin(file) == expected.replace("ab12", "cd34")
    monkeypatch.setattr(
        source.versions, "ROOT", tmp_path
    )  # a clone of dynappo: not where it is from
    assert source.origin(file) == only


def test_looks_that_are_not_there_are_left_out(tmp_path):
    file = published.write(tmp_path)
    (tmp_path / "assets/cube.obj").unlink()
    read = source.read(file)
    assert read.notes == ("looks are left out, their meshes are not found: cube.obj",)
    assert read.lost == 5
    assert "there is no such file" in refused(source.read, tmp_path / "no.urdf")


CUBE_FILES = " ".join(f'file{side}="gone.png"' for side in "right left up down front back".split())


@pytest.mark.parametrize("files", ['type="2d" file="gone.png"', f'type="cube" {CUBE_FILES}'])
def test_pictures_that_are_not_there_are_left_out(files, tmp_path):
    file = published.write(tmp_path)
    name = "gone" if 'file="' in files else "t"  # by its file, where it has none
    named = f'name="{name}"' * (name == "t")
    dark = f'<texture {named} {files}/><material texture="{name}" name="dark"'
    file.write_text(published.mjcf().replace('<material name="dark"', dark))
    read = source.read(file)
    assert read.notes == ("pictures are left out, not found: gone.png",) and read.lost == 0
    assert read.model.ntex == 0 and read.model.mat_rgba[0] == pytest.approx([0.2, 0.2, 0.3, 1])


LOOKS = {  # an asset, a look of it: whether it is kept
    '<mesh name="a" vertex="0 0 0 .1 0 0 0 .2 0 0 0 .3"/>': ('type="mesh" mesh="a"', True),
    '<mesh name="a" builtin="sphere" params="2" scale=".1 .2 .3"/>': ('type="mesh" mesh="a"', True),
    '<hfield name="a" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 1 2 3"/>': (
        'type="hfield" hfield="a"',
        False,
    ),
}


@pytest.mark.parametrize("asset", LOOKS)
def test_looks_without_a_file_are_copied_and_those_of_no_shape_left_out(
    asset, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    shape, kept = LOOKS[asset]
    look = f'<geom {shape} contype="0" conaffinity="0" group="2" pos="0.1 0.2 0.3" quat="0.9 0.1 0.2 0.3"/>'
    text = published.mjcf().replace("<mesh file", asset + "<mesh file")
    published.write(tmp_path, re.sub(r'<geom class="look" mesh="cube" pos="0.02.*?/>', look, text))
    assert run("toy.xml") == 0
    clouds = []
    for file in ("toy.xml", "robots/toy/toy.xml"):
        model = mujoco.MjModel.from_xml_path(file)
        data = mujoco.MjData(model)
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        mujoco.mj_kinematics(model, data)
        trunk = model.body("trunk").id
        drawn = [
            g
            for g in range(model.ngeom)
            if model.geom_group[g] == 2 and model.geom_bodyid[g] == trunk
        ]
        if file.startswith("robots"):
            assert len(drawn) == kept
        for geom in drawn if kept else ():
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[start : start + count] @ data.geom_xmat[geom].reshape(3, 3).T
            clouds.append(points + data.geom_xpos[geom] - data.xpos[trunk])
    if kept:
        np.testing.assert_allclose(clouds[1], clouds[0], atol=1e-5)


def test_a_limb_without_its_colliding_meshes_is_refused(tmp_path, monkeypatch, capsys):
    """Its thighs would not touch the ground in a fall; of one that keeps a shape, and of the base, as well.
    Looks may be missing, also where they collide by the file's defaults."""
    shape = '<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" group="3"/>'
    mesh = '<geom type="mesh" mesh="lost" group="3"/>'
    asset = '<mesh name="lost" file="lost.obj"/><mesh file="cube.obj"'
    text = published.mjcf().replace('<mesh file="cube.obj"', asset)
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path, text.replace(shape, mesh))
    assert status(command.main, "toy.xml") == 2
    said = capsys.readouterr()
    assert "shapes that collide are missing on FL_thigh, FR_thigh, RL_thigh, RR_thigh" in said.err
    assert "not found (lost.obj); get them" in said.err
    assert said.err.count("\n") == 1 and not Path("robots").exists()
    published.write(tmp_path, text.replace(shape, shape + mesh))
    assert "missing on FL_thigh, FR_thigh" in refused(source.read, Path("toy.xml"))
    box = '<geom type="box" size="0.15 0.06 0.05" group="3"/>'
    published.write(tmp_path, text.replace(box, box + mesh))
    assert "missing on trunk: their meshes are" in refused(source.read, Path("toy.xml"))
    published.write(tmp_path, text.replace(box, box + mesh.replace('"3"', '"2"')))
    assert source.read(Path("toy.xml")).notes == (
        "looks are left out, their meshes are not found: lost.obj",
    )


def test_meshes_of_a_urdf_are_found_in_its_meshdir(tmp_path):
    """Or they are said to be absent, or of another kind."""
    rod = '<cylinder radius="0.015" length="0.15"/>'
    seen = "<visual><geometry><mesh filename='{}'/></geometry></visual></link>"
    text = published.urdf().replace("</link>", seen.format("cube.obj"), 1)
    text = text.replace("</link>\n  <joint", seen.format("a.dae") + "\n  <joint", 1)
    head = "<mujoco><compiler meshdir='../far'/></mujoco>"
    (tmp_path / "urdf").mkdir()
    (tmp_path / "far").mkdir()
    file = tmp_path / "urdf/toy.urdf"
    file.write_text(text.replace('<robot name="toy">', '<robot name="toy">' + head))
    assert "not found: a.dae, camera.dae, cube.obj" in source.read(file).notes[0]
    (tmp_path / "far/cube.obj").write_text(published.CUBE)
    (tmp_path / "far/a.dae").touch()
    notes = source.read(file).notes
    assert "are not found: camera.dae" in notes[0]
    assert "of a kind that MuJoCo cannot read: a.dae" in notes[1]
    (tmp_path / "far/cube.obj").unlink()
    (tmp_path / "urdf/assets").mkdir()
    (tmp_path / "urdf/assets/cube.obj").write_text(published.CUBE)
    notes = source.read(file).notes
    assert notes[0] == "meshes are taken from a folder beside the URDF: assets/cube.obj"
    mesh = '<mesh filename="a.dae"/>'
    file.write_text(file.read_text().replace(rod, mesh))
    assert "cannot read (a.dae); convert them to .obj" in refused(source.read, file)


def test_feet_of_a_urdf_are_not_called_as_its_exporter_called_their_meshes(tmp_path, monkeypatch):
    """`mesh_collision_lower_leg_4_foot_1` would be the foot `mesh_collision_lower_leg_4`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    text, ball = published.urdf(), '<collision><origin xyz="0 0 0"/><geometry><sphere'
    assert text.count(ball) == 4
    for i in range(4):
        text = text.replace(
            ball, ball.replace(">", f' name="mesh_collision_leg_{i}_foot_1">', 1), 1
        )
    Path("toy.urdf").write_text(text)
    assert run("toy.urdf") == 0
    assert set(robot_lib.load("toy").foot_names) == {"FR", "FL", "RR", "RL"}


def test_joints_that_nothing_drives_are_told(tmp_path):
    file = tmp_path / "toy.xml"
    published.write(tmp_path)
    motor = '<position class="calf" name="FR_calf" joint="FR_calf_joint"/>'
    file.write_text(file.read_text().replace(motor, ""))
    _, told = source.published(source.read(file), ("FR_hip_joint", "FR_calf_joint"))
    assert len(told) == 1 and "nothing in the file drives FR_calf_joint;" in told[0]
    assert source.published(source.read(file), ("FR_hip_joint",))[1] == []


@pytest.mark.parametrize(
    ("moments", "now", "how"),
    [
        # 0.08 % off: a third of that from each
        ((0.03, 0.0912, 0.1213), (0.03003333, 0.09123333, 0.12126667), "the nearest that are"),
        ((0.01, 0.02, 0.2), None, "no body has"),
        ((0.0, 0.0, 0.0), None, "no body has"),
    ],
)
def test_an_inertia_that_is_rounded_gets_the_nearest_and_a_wrong_one_is_refused(
    moments, now, how, tmp_path
):
    """Of the base, 6 kg; turned, so that the matrix is full."""
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    full = turn @ np.diag(moments) @ turn.T
    numbers = [full[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    entry = 'ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"'
    file = tmp_path / "toy.urdf"
    even = entry.format(0.06, 0.06, 0.06, 0, 0, 0)
    assert even in published.urdf()
    file.write_text(published.urdf().replace(even, entry.format(*numbers)))
    if now is None:
        assert "link base of 6 kg has the principal moments" in refused(source.read, file)
        return
    # the camera, which is fixed to the base, has little of its mass
    file.write_text(file.read_text().replace('<mass value="0.1"/>', '<mass value="1e-9"/>'))
    read = source.read(file)
    told = [note for note in read.notes if "inertia of base" in note]
    assert how in told[0] and "0.03, 0.0912, 0.1213" in told[0] and "0.03003" in told[0]
    np.testing.assert_allclose(sorted(read.model.body("base").inertia), now, rtol=1e-4)


TIES = {
    "connect": '<equality><connect body1="RR_thigh" body2="RR_calf" anchor="0.03 0.01 -0.2"/></equality>',
    "weld": '<equality><weld body1="RR_hip" body2="trunk" relpose="0.1 0.2 0.3 0.9 0.3 0.1 0"/></equality>',
    "tendon": '<tendon><spatial class="soft" springlength="0.1"><site site="a"/><site site="b"/></spatial>'
    "</tendon>",
    "fixed": '<tendon><fixed class="soft"><joint joint="RR_hip_joint" coef="2"/></fixed></tendon>',
}


@pytest.mark.parametrize("name", TIES)
def test_ties_between_links_stay_what_they_are(name, tmp_path, monkeypatch, capsys):
    """What the constraints miss, lengths of tendons and what they do to the joints, in the same state of both
    models; the hind legs' frames are turned in the file, and only those of a fixed tendon are turned back."""
    text = published.mjcf().replace("<actuator>", TIES[name] + "<actuator>")
    text = text.replace('<geom friction="0.6"', '<tendon damping="1"/><geom friction="0.6"')
    text = text.replace('<default class="calf">', '<default class="soft"><tendon stiffness="70"/></default>'
                        '<default class="calf">')  # fmt: skip
    at = '<body name="RR_hip" '
    text = text.replace(at, '<site name="a" pos="0.1 0 0"/>' + at)
    at = '<body name="RR_calf" '
    text = text.replace(at, '<site name="b" pos="0.03 0.01 -0.1"/>' + at)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    published.write(tmp_path, text)
    assert run("toy.xml", "--name=mine") == 0
    frames = "turned until" if name == "fixed" else "as in the file"
    assert f"frames: {frames}" in capsys.readouterr().out
    found = []
    for file in ("toy.xml", "robots/mine/mine.xml"):
        model = mujoco.MjModel.from_xml_path(file)
        model.dof_damping[:] = 0  # the servo's, in the file
        data = mujoco.MjData(model)
        data.qpos[:7] = [0, 0, 0.5, 1, 0, 0, 0]
        order = [model.joint(f"{leg}_{joint}_joint").qposadr[0] for leg, *_ in published.LEGS
                 for joint in ("hip", "thigh", "calf")]  # fmt: skip
        order = np.array(order)
        data.qpos[order], data.qvel[order - 1] = np.linspace(-0.5, 0.5, 12), np.linspace(1, 0.3, 12)
        mujoco.mj_forward(model, data)
        equal = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        missed = data.efc_pos[equal] if model.neq else np.zeros(0)
        pull = data.qfrc_passive[order - 1] * (model.ntendon > 0)
        found.append(np.concatenate([missed, data.ten_length, model.tendon_stiffness, pull]))
        assert len(found[-1]) == {"connect": 3, "weld": 6}.get(name, 2) + 12
        assert pull.any() == (name in ("tendon", "fixed"))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_force_leaves_what_is_not_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    published.write(tmp_path)
    assert run("toy.xml") == 0
    Path("robots/toy/notes.txt").write_text("mine")
    Path("robots/toy/README.md").write_text("old")
    assert run("toy.xml", "--force") == 0
    assert Path("robots/toy/notes.txt").read_text() == "mine"
    assert Path("robots/toy/README.md").read_text() != "old"
    assert not [*tmp_path.glob("robots/.*")]


def test_force_removes_the_looks_of_the_adoption_before_and_only_them(tmp_path, monkeypatch):
    """Neither what somebody put beside them nor what somebody changed; nor what a list with paths names."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    published.write(tmp_path / "with")
    without = re.sub(r'<geom class="look".*?/>', "", published.mjcf())
    published.write(tmp_path / "without", without)
    assets = Path("robots/toy/assets")
    assert run("with/toy.xml") == 0 and (assets / "cube.obj").is_file()
    assert run("without/toy.xml", "--force") == 0 and not assets.exists()
    assert run("with/toy.xml", "--force") == 0
    (assets / "mine.obj").write_text("mine")
    (assets / "cube.obj").write_text(published.CUBE + "# mine")
    Path("robots/toy/kept").write_text("kept")
    digest = hashlib.sha256(b"kept").hexdigest()
    with (assets / "SHA256SUMS").open("a") as sums:
        sums.write(f"{digest}  ../kept\n")
    assert run("without/toy.xml", "--force") == 0
    assert sorted(path.name for path in assets.iterdir()) == ["cube.obj", "mine.obj"]
    assert Path("robots/toy/kept").read_text() == "kept"


@pytest.mark.parametrize("taken", ["robots", "configs"])
def test_where_nothing_can_be_written_is_said_first(taken, tmp_path, monkeypatch, capsys):
    """A file where the folder would be; a folder that may not be written (root may write everywhere)."""
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)
    Path(taken).write_text("x")
    said = mistake(command.main, ["toy.xml"], capsys)
    assert f"cannot be written: {taken} is no folder" in said and ".part" not in said
    Path(taken).unlink()
    Path(taken).mkdir()
    real = os.access
    monkeypatch.setattr(os, "access", lambda path, *how: path != Path(taken) and real(path, *how))
    said = mistake(command.main, ["toy.xml"], capsys)
    assert f"{taken}/toy" in said and "no permission" in said and ".part" not in said
    assert not [*Path(taken).iterdir()]


def test_no_file_ends_in_a_traceback(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)

    def broken(*_):
        np.multiply(1e300, np.array([1e300]))  # a warning would be a line more
        raise AttributeError("no such thing")

    monkeypatch.setattr(command.looks, "draw", broken)
    said = mistake(command.main, ["toy.xml"], capsys)
    assert "toy.xml: it cannot be adopted (AttributeError: no such thing)" in said
    assert not Path("robots").exists()


def test_the_readme_breaks_no_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "look", lambda *_: [])
    file = published.write(tmp_path / "a-folder-with-a-name-of-many-words" / ("another-one-" * 6))
    assert run(file, "--name=mine") == 0
    text = Path("robots/mine/README.md").read_text()
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert "found at LICENSE: check" in " ".join(text.split()) and digest in text


def test_no_path_of_this_machine_is_in_what_is_written(tmp_path, monkeypatch):
    """Of the file, its licence further up, the checkout that it is in, the working directory."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(command, "look", lambda *_: [])
    file = published.write(tmp_path / "secret" / "checkout" / "toy")
    file.with_name("LICENSE").rename(tmp_path / "secret/checkout/LICENSE")
    git = tmp_path / "secret/checkout/.git"
    git.mkdir()
    (git / "config").write_text("")
    (git / "HEAD").write_text("ab12")
    assert run(file) == 0
    written = [path for path in Path.cwd().rglob("*") if path.suffix in (".md", ".xml", ".py")]
    text = "".join(path.read_text() for path in written)
    assert len(written) == 3 and "found at ../LICENSE: check" in " ".join(text.split())
    assert "`toy/toy.xml` of checkout, commit ab12" in " ".join(text.split())
    assert "secret" not in text and str(tmp_path) not in text and str(Path.home()) + "/" not in text


SMALL = (
    "run.num_iterations=2 run.log_every=2 run.checkpoint_every=0 run.eval_envs=2 run.eval_steps=20 "
)
SMALL += "run.video_seconds=0.2 rollout.num_envs=16 schedule.end_iteration=1"


@pytest.mark.slow
@pytest.mark.parametrize("legs", [2, 4])
def test_what_is_adopted_trains(adopted, tmp_path, legs):
    """Two iterations of 16 robots in C MuJoCo, and its policy is played; as a stranger would do it."""
    folder, name = adopted[0], "mine"
    if legs == 2:  # the bundled one, as if it were somebody's
        folder = tmp_path
        file = Path(__file__).parents[2] / "robots/g1/g1.xml"
        done = shell("-m", "dynappo.adopt", file, "--name=two_legs", cwd=folder)
        assert done.returncode == 0, done.stderr
        name = "two_legs"
    run_it = ["-m", "dynappo.train", f"--config=configs/{name}.py:laptop"]
    small = [f"--config.{field}" for field in SMALL.split()]
    done = shell(*run_it, *small, f"--workdir={tmp_path}/run", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run/policy.npz").exists()
    play = ["-m", "dynappo.play", tmp_path / "run", "--seconds=1", f"--out={tmp_path}/walk.html"]
    assert shell(*play, cwd=folder).returncode == 0


def test_a_second_word_is_a_name_that_lacks_its_flag_and_a_page_is_no_robot(tmp_path, capsys):
    page = tmp_path / "README.md"
    page.write_text("# a robot\n")
    for argv, said in (
        (["a.xml", "spot5"], "spot5: expected one FILE; the robot's name is a flag: --name=spot5"),
        ([str(page), "--name=spot5"], f"{page}: expected an MJCF or a URDF, found no XML ("),
    ):
        assert said in mistake(command.main, argv, capsys)

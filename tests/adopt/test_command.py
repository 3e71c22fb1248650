"""`dynappo adopt`: what it writes of a published robot, that the robot moves as published, every mistake."""

import os
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import published
import pytest
from answers import mistake, refused, shell, status

from dynappo import config as config_lib
from dynappo.adopt import command, source
from dynappo.physics import motors
from dynappo.physics import robot as robot_lib
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
                "builtins.print", lambda *what, **_: printed.append(" ".join(map(str, what)))
            )
            patch.setattr(command, "look", lambda config, picture: printed.append(f"look {config}"))
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
    assert scope.slower(robot, config.physics, False) == ""
    assert sorted(p.name for p in (folder / "robots/mine").iterdir()) == [
        "README.md",
        "assets",
        "mine.xml",
    ]
    assert (folder / "robots/mine/assets/cube.obj").read_text() == published.CUBE
    assert not [*folder.glob("robots/.*")] and printed[-2] == "look configs/mine.py"
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
    assert "from/toy.xml" in text and "BSD-3-Clause, Copyright 2026 Somebody" in text
    for line in printed[:-3]:
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
    monkeypatch.setattr(command, "look", lambda *_: None)
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
    monkeypatch.setattr(command, "look", lambda *_: None)
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


def mistake_after(file, capsys):
    capsys.readouterr()
    return mistake(command.main, [file], capsys)


BALL = '<mujoco><worldbody><body name="a"><freejoint/><geom size="1"/></body></worldbody></mujoco>'
MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "no file given; try: "),
    "no file": (["no.xml"], "no.xml: there is no such file"),
    "a name": (["toy.xml", "--name=a/b"], "--name=a/b: expected letters"),
    "ours": (["toy.xml", "--name=go1"], "--name=go1: dynappo has that itself"),
    "default": (["toy.xml", "--name=default"], "dynappo has that itself"),
    "no XML": (["text.xml"], "text.xml: XML parse error"),
    "other XML": (["page.xml"], "expected an MJCF or a URDF, found the element html"),
    "no legs": (["ball.xml"], "ball.xml: "),
    "a flag": (["toy.xml", "--nam=x"], "--nam=x: no such flag"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    published.write(tmp_path)
    for file, text in {"text": "no", "page": "<html/>", "ball": BALL}.items():
        Path(f"{file}.xml").write_text(text)
    before = sorted(tmp_path.rglob("*"))
    arguments, expected = MISTAKES[name]
    assert expected in mistake(command.main, arguments, capsys)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_fails_halfway_is_gone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match="full"), command.new_folder(Path("robots/mine")) as part:
        (part / "a").write_text("a")
        raise OSError("full")
    assert not [*tmp_path.iterdir()]


def test_a_licence_is_found_above_the_file_or_in_it(tmp_path):
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    file = inside / "toy.xml"
    file.write_text("<mujoco><!-- Copyright 2020 Me, MIT License --></mujoco>")
    assert source.licence(file) == ("comments in toy.xml", "Copyright 2020 Me, MIT License")
    (tmp_path / "a" / "COPYING.txt").write_text("GPL\n")
    assert source.licence(file) == (str(tmp_path / "a" / "COPYING.txt"), "GPL")
    file.write_text("<mujoco/>")
    (tmp_path / "a" / "COPYING.txt").unlink()
    assert source.licence(file) == ("", "")


def test_a_mesh_that_is_no_longer_there_is_left_out(tmp_path):
    file = published.write(tmp_path)
    (tmp_path / "assets/cube.obj").unlink()
    read = source.read(file)
    assert read.notes == ("meshes that are not there are left out: cube",) and read.lost == 5
    assert "there is no such file" in refused(source.read, tmp_path / "no.urdf")


@pytest.mark.slow
def test_what_is_adopted_trains(adopted, tmp_path):
    """Two iterations of 16 robots in C MuJoCo, and its policy is played; as a stranger would do it."""
    folder, *_ = adopted
    run_it = ["-m", "dynappo.train", "--config=configs/mine.py:quick", f"--workdir={tmp_path}/run"]
    small = [
        "run.num_iterations=2",
        "rollout.num_envs=16",
        "run.eval_envs=2",
        "run.video_seconds=0.2",
    ]
    small += ["physics.impl=c", "schedule.end_iteration=1"]
    done = shell(*run_it, *[f"--config.{field}" for field in small], cwd=folder)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run/policy.npz").exists()
    play = ["-m", "dynappo.play", tmp_path / "run", "--seconds=1", f"--out={tmp_path}/walk.html"]
    assert shell(*play, cwd=folder).returncode == 0

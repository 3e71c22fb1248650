"""What a name or a path means; the robot that a policy carries: played anywhere, told where it differs."""

import json
import shutil
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from answers import mistake, refused, status
from ml_collections import config_dict
from toy_policy import GO1, actor, described, save

from dynappo.description import mjcf, robot
from dynappo.evaluate import changes, trials
from dynappo.evaluate import command as evaluate_command
from dynappo.export import command as export_command
from dynappo.play import command as play_command
from dynappo.policy import episode, policy_file, policy_source
from dynappo.run import restore
from dynappo.sweeps import folder as sweep_folder

TEXT = GO1.xml.read_text()
HEAVY = TEXT.replace('mass="5.204"', 'mass="7.5"', 1)
CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def spot(path, text=TEXT):
    """A policy.npz of a robot that no folder here has, with this MJCF."""
    config, loaded = described()
    policy_file.save(path, actor(), config, loaded._replace(name="spot", alone=text))
    return path


def carrying(path, **fields):
    """A policy.npz whose `about` says this."""
    save(path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file}
    arrays["about"] = json.dumps(json.loads(str(arrays["about"])) | fields)
    np.savez(path, allow_pickle=False, **arrays)
    return path


def moved(model, steps=200):
    """Where a robot is that falls for a second without motors."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, steps)
    return data.qpos.copy()


def test_a_policy_is_played_where_there_is_no_robot_of_its_name(tmp_path, monkeypatch, capsys):
    """By play, evaluate and export, from one file."""
    monkeypatch.chdir(tmp_path)
    spot(tmp_path / "spot.npz")
    found, note = policy_source.robot(policy_file.load(tmp_path / "spot.npz"))
    assert (found.name, note) == ("spot", "")
    np.testing.assert_array_equal(moved(found.mj_model), moved(GO1.mj_model))
    assert status(play_command.main, "spot.npz", "--seconds=0.2", "--out=walk.html") == 0
    assert "dynappo plays spot: " in capsys.readouterr().out
    sweep = partial(trials.run, seconds=0.1, points=1)
    monkeypatch.setattr(trials, "run", sweep)
    monkeypatch.setattr(changes, "EVERY", (0.02, 0.04))  # s, between changes of command
    for name in ("FILM_SECONDS", "PAGE_SECONDS"):
        monkeypatch.setattr(episode, name, 0.2)  # s
    assert status(evaluate_command.main, "spot.npz", "--fast") == 0
    assert "dynappo evaluates spot: " in capsys.readouterr().out
    assert status(export_command.main, "spot.npz", "--out=again.npz") == 0
    assert status(export_command.main, "again.npz", "--out=spot.xml") == 0
    assert Path("spot.xml").read_text() == TEXT
    assert not Path("robots").exists()


def test_a_robot_is_one_text_without_other_files(tmp_path):
    """Meshes as looks and an included file: what is carried moves as the file does."""
    (tmp_path / "cube.obj").write_text(CUBE)
    (tmp_path / "more.xml").write_text('<mujoco><option impratio="3"/></mujoco>')
    looks = '<geom type="mesh" mesh="cube" group="2"/>'
    text = TEXT.replace("<worldbody>", '<include file="more.xml"/><worldbody>', 1)
    text = text.replace("</asset>", '<mesh name="cube" file="cube.obj"/></asset>', 1)
    text = text.replace("<inertial", f"{looks}<inertial", 1)
    path = tmp_path / "mine.xml"
    path.write_text(text)
    loaded = robot.load_xml(path)
    assert "file=" not in loaded.alone and "mesh" not in loaded.alone
    back = robot.load_text(loaded.alone, "mine", Path("policy.npz"))
    assert back.mj_model.opt.impratio == loaded.mj_model.opt.impratio == 3
    np.testing.assert_allclose(moved(back.mj_model), moved(loaded.mj_model), atol=1e-6)
    assert robot.same(loaded, back) and back.joint_names == loaded.joint_names
    plain, more = tmp_path / "plain.xml", text.replace('file="more.xml"', 'file="none.xml"')
    (tmp_path / "none.xml").write_text("<mujoco><worldbody/></mujoco>")
    plain.write_text(more)
    assert robot.same(robot.load_xml(plain), GO1)  # but for looks, and the digits of a text
    assert not robot.same(loaded, GO1)
    drawn = mujoco.MjModel.from_xml_string(loaded.alone)
    assert (drawn.geom_group <= 2).all()  # the looks have gone: what touches is drawn
    assert GO1.alone == TEXT  # which is one text already


HOSTILE = {  # what `about` says, what the line must say
    "an include": ({"mjcf": '<mujoco><include file="/etc/passwd"/></mujoco>'}, "include file="),
    "too long": ({"mjcf": TEXT + " " * mjcf.MAX_CARRIED}, "an MJCF of at most 524288 bytes"),
    "no robot": ({"mjcf": "<mujoco/>"}, "expected"),
    "another robot": ({"mjcf": robot.load("anymal_c").alone}, "those of the robot that it carries"),
    "a list of entities": ({"mjcf": "<!DOCTYPE x>" + TEXT}, "a DOCTYPE, which MJCF does not have"),
    "a number that is none": ({"mjcf": TEXT.replace("5.204", "nan", 1)}, "mass and inertia"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_robot_is_one_line(tmp_path, monkeypatch, capfd, name):
    """It names the policy's file; nothing is read beside it or written, and MuJoCo says nothing."""
    fields, expected = HOSTILE[name]
    monkeypatch.chdir(tmp_path)
    path = carrying(tmp_path / "mine.npz", **fields)
    line = refused(policy_file.load, path)
    assert line.startswith(f"{path}: ") and expected in line and len(line) < 600
    assert [*tmp_path.iterdir()] == [path] and not any(capfd.readouterr())


def test_where_the_robot_here_is_another_a_line_says_so(tmp_path, monkeypatch, capsys):
    """The carried one is played; --robot-xml takes the one that is here."""
    folder = tmp_path / "robots" / "go1"
    folder.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "mine.npz")
    policy = policy_file.load(tmp_path / "mine.npz")
    mass = GO1.mj_model.body_mass.sum()

    def total(xml=None):
        return policy_source.player(policy, xml)[0].model.body_mass.sum()

    (folder / "go1.xml").write_text(HEAVY)
    assert total() == pytest.approx(mass) and total("robots/go1/go1.xml") == mass + 7.5 - 5.204
    assert policy_source.robot(policy, "robots/go1/go1.xml")[0].name == "go1"
    for main, out in ((play_command.main, "a.html"), (export_command.main, "a.npz")):
        assert status(main, "mine.npz", f"--out={out}", *["--seconds=0.1"] * (out[2] == "h")) == 0
        notes = [n for n in capsys.readouterr().out.splitlines() if n.startswith("note: ")]
        (line,) = notes
        assert line.startswith(f"note: {folder}/go1.xml is another robot than the go1 that")
    (folder / "go1.xml").write_text(TEXT + "<!-- a word -->")
    found, note = policy_source.robot(policy)
    assert (note, found.xml) == ("", folder / "go1.xml")  # the same: here it may have looks
    (folder / "go1.xml").write_text("<mujoco/>")  # no robot: the policy has its own
    assert policy_source.robot(policy)[1] == "" and total() == pytest.approx(mass)


def test_a_policy_of_before_is_played_in_the_robot_of_its_name(tmp_path):
    """Format 1, without MJCF, as the bundled ones were."""
    path = carrying(tmp_path / "old.npz", format=1)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file}
    about = json.loads(str(arrays["about"]))
    del about["mjcf"], about["seed"]
    np.savez(path, allow_pickle=False, **arrays | {"about": json.dumps(about)})
    found, note = policy_source.robot(policy_file.load(path))
    assert (found.xml, found.text, note) == (GO1.xml, "", "")


def test_a_robot_is_written_as_one_file(tmp_path, monkeypatch, capsys):
    """`--robot-xml` puts another into a policy.npz; one that breaks the contract is one line."""
    monkeypatch.chdir(tmp_path)
    Path("heavy.xml").write_text(HEAVY)
    arguments = ["go1", "--robot-xml=heavy.xml", "--out=policy.npz"]
    assert status(export_command.main, *arguments) == 0
    assert policy_file.load(Path("policy.npz")).mjcf == HEAVY
    said = "policy.npz is now that of heavy.xml, no longer that of its training\n"
    assert f"note: the robot in {said}" in capsys.readouterr().out
    Path("none.xml").write_text("<mujoco/>")
    line = mistake(export_command.main, ["go1", "--robot-xml=none.xml", "--out=b.npz"], capsys)
    assert "--robot-xml=none.xml: 2 faults: (1) expected a free joint on the base" in line
    assert not Path("b.npz").exists()
    line = mistake(export_command.main, ["go1", "--robot-xml=no.xml", "--out=b.npz"], capsys)
    assert "--robot-xml=no.xml: no such file" in line


def test_a_carried_robot_is_drawn(tmp_path):
    """By the process that renders, which is given its text; no file of it is anywhere."""
    from dynappo.policy import render

    policy = policy_file.load(spot(tmp_path / "spot.npz"))
    player, _ = policy_source.player(policy)
    rows = episode.play(player, lambda obs: np.zeros(12), lambda t: np.zeros(3), 0.02)
    failed = render.film(player, rows, tmp_path / "a.png")
    if failed and render.film(GO1, rows, tmp_path / "b.png"):
        pytest.skip("no pictures here")
    assert failed == ""
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_the_task_needs_no_robot_of_its_name_either(tmp_path, monkeypatch):
    """The settings of the episodes on MJX; an order of joints that is not the robot's is refused."""
    monkeypatch.chdir(tmp_path)
    config, loaded = described()
    fields = config_dict.ConfigDict(config)
    fields.robot, fields.ppo.hidden = "spot", (16, 16)
    policy_file.save(Path("spot.npz"), actor(), fields, loaded._replace(name="spot"))
    policy = policy_file.load(Path("spot.npz"))
    assert evaluate_command.episodes.settings(policy).robot == "spot"
    own, _ = policy_source.robot(policy)
    evaluate_command.episodes.check_robot(policy, own)
    turned = policy._replace(joint_names=policy.joint_names[::-1])
    line = refused(evaluate_command.episodes.check_robot, turned, own)
    assert "task's episodes need the same order (--fast leaves them out)" in line


@pytest.mark.parametrize("main", [play_command.main, evaluate_command.main, export_command.main])
def test_every_command_takes_a_seed_in_the_same_way(main, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out = ["--out=a.onnx"] if main is export_command.main else []
    for seed, expected in (
        ("3", "robots/go1/policy.npz holds one policy"),
        ("-1", "--run-seed='-1': expected an integer of 0 or more, at most 2,147,483,647; or best"),
        ("worst", "--run-seed='worst': expected an integer of 0 or more"),
    ):
        assert expected in mistake(main, ["go1", f"--run-seed={seed}", *out], capsys)
    assert status(main, "--help") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "--run-seed K|best" in text and "--robot-xml FILE" in text
    assert "number K, 0 to run.num_seeds - 1, or the best in the last evaluation" in text


# ---- what a name or a path means


def test_names_files_and_folders_are_told_apart(tmp_path, monkeypatch):
    """The policy of a robot's name first, `./spot` is a folder; a miss says what was expected."""
    monkeypatch.chdir(tmp_path)
    saved = save(tmp_path / "policy.npz")
    for folder in ("robots/spot", "spot"):
        Path(folder).mkdir(parents=True)
    Path("robots/spot/spot.xml").write_text("<mujoco/>")
    line = refused(policy_source.locate, "spot")
    assert "(robots/spot/policy.npz)" in line and "--policy=zero" in line
    shutil.copy(saved, "robots/spot/policy.npz")
    assert policy_source.locate("spot") == tmp_path / "robots" / "spot" / "policy.npz"
    assert "./spot: holds neither" in refused(policy_source.locate, "./spot")
    shutil.copy(saved, "spot/policy.npz")
    assert policy_source.locate("./spot") == Path("spot/policy.npz")
    checkpoint = Path("spot/checkpoints/40")  # where another run was begun in it
    (checkpoint / "state").mkdir(parents=True)
    shutil.copy(saved, checkpoint)
    assert policy_source.locate(str(checkpoint)) == checkpoint
    assert refused(policy_source.locate, "sptt").endswith("; did you mean spot?")
    Path("runs/b").mkdir(parents=True)
    Path("runs/b/config.json").touch()
    line = refused(policy_source.locate, "runs")
    told = "runs: holds neither a policy.npz nor checkpoints/; name one of the runs in it: runs/b"
    assert line == told.replace("runs/b", str(Path("runs/b")))
    line = refused(policy_source.locate, "wlk")
    assert line.startswith("wlk: no such file or folder") and "go2_rough, spot" in line


@pytest.mark.parametrize("ended", [False, True])
def test_a_sweep_is_told_from_a_run(ended, tmp_path):
    """It has no seeds; without an end, no policy; the run that is named can be played."""
    sweep, run = tmp_path / "lr", tmp_path / "lr" / "ppo.gamma=0.98"
    run.mkdir(parents=True)
    (sweep / sweep_folder.ABOUT).write_text("{}")
    (run / "config.json").write_text("{}")
    if ended:
        (sweep / "policy.npz").touch()
        assert policy_source.locate(str(sweep)) == sweep / "policy.npz"
    else:
        line = refused(policy_source.locate, str(sweep))
        assert line.startswith(f"{sweep}: is a sweep, which has not ended")
        assert line.endswith("none of its runs has a checkpoint yet")
    (run / "checkpoints" / "20" / "state").mkdir(parents=True)
    for seed in (1, *[None] * (not ended)):
        line = refused(policy_source.locate, str(sweep), seed)
        assert f"is a sweep, which has no{'t ended' if seed is None else ' seed 1'}" in line
        assert line.endswith(f"name one of its runs, such as {run}")
    assert policy_source.locate(str(run), 1) == run / "checkpoints" / "20"


def test_a_relative_path_is_told_as_it_was_given():
    for what in ("runs/laptop", "laptop"):
        path = Path(what) / "policy.npz"
        assert policy_source.named(what, path) == f"{what}/policy.npz"
    assert policy_source.named("/a/b/c", Path("/a/b/c/policy.npz")) == "c/policy.npz"


def test_a_file_of_terms_that_is_not_there_is_told_by_its_flag(tmp_path):
    save(tmp_path / "a.npz")
    policy = policy_file.load(tmp_path / "a.npz")
    task = policy.config["task"] | {"terms_hash": "a"}
    policy = policy._replace(config=policy.config | {"task": task})
    line = refused(policy_source.with_terms, policy, Path("no.py"))
    assert line == "--terms=no.py: no such file"


@pytest.mark.parametrize("text", ["go1_dploy", "GO1_deploy", "go1:deploy", "go1-deploy"])
def test_a_name_near_that_of_a_policy_is_told(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    assert refused(policy_source.locate, text).endswith("; did you mean go1_deploy?")
    line = refused(restore.saved, Path(text))
    assert line == f"--restore={text}: no such file or folder; did you mean go1_deploy?"

"""Numbers of a policy that could be of another: joint order, default pose, names, fields that are gone."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from answers import mistake, refused, status
from toy_policy import GO1, actor

from dynappo import config as config_lib
from dynappo.evaluate import command as evaluate_command
from dynappo.evaluate import episodes
from dynappo.export import command as export_command
from dynappo.export import joint_order
from dynappo.physics import c_mujoco
from dynappo.policy import episode, policy_file, policy_source
from dynappo.run import restore

ISAAC = ("--joint-order=isaaclab", "--out=isaac.npz")


def config(**fields):
    """A config whose networks are those of `toy_policy.actor`."""
    found = config_lib.load("go1:dyna4")
    found.ppo.hidden = (16, 16)
    for name, value in fields.items():
        found.task[name] = value
    return config_lib.validate(found)


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """A working directory with `mine.npz`, a policy of those networks."""
    monkeypatch.chdir(tmp_path)
    policy_file.save(tmp_path / "mine.npz", actor(), config(), GO1)
    return tmp_path


def test_a_run_does_not_start_from_another_joint_order(inside):
    """Its numbers fit, and each joint would be another's. Back in the order of the file it may."""
    restore.check(Path("mine.npz"), config())
    assert status(export_command.main, "mine.npz", *ISAAC) == 0
    line = refused(restore.check, Path("isaac.npz"), config())
    assert line.startswith("--restore=isaac.npz: its joints are FL_hip_joint FR_hip_joint")
    assert (
        "expected the order of go1, FL_hip_joint FL_thigh_joint" in line
        and "--joint-order=mjcf" in line
    )
    assert status(export_command.main, "isaac.npz", "--joint-order=mjcf", "--out=back.npz") == 0
    restore.check(Path("back.npz"), config())
    one, other = (
        policy_file.load(Path(f"{name}.npz")).params["actor"] for name in ("mine", "back")
    )
    for i in range(3):
        layer, again = (p["params"][f"Dense_{i}"] for p in (one, other))
        np.testing.assert_array_equal(layer["kernel"], again["kernel"])


def test_what_the_numbers_of_a_policy_mean_is_said_where_it_differs(inside):
    """Of another robot, another scale of actions, another default pose; nothing of the same."""
    assert restore.apart(Path("mine.npz"), config()) == ""
    line = restore.apart(Path("mine.npz"), config(action_scale=0.5, kp=50.0))
    assert (
        line
        == "--restore=mine.npz: task.action_scale is 0.25 there, 0.5 here; task.kp is 25.0 there, 50.0 here"
    )
    other = config_lib.validate(config_lib.load("anymal_c:dyna4"))
    line = restore.apart(Path("mine.npz"), other)
    assert "robot is go1 there, anymal_c here" in line and "its joints have other names" in line
    bent = GO1._replace(default_pose=GO1.default_pose + 0.1)
    policy_file.save(Path("bent.npz"), actor(), config(), bent)
    assert (
        restore.apart(Path("bent.npz"), config())
        == "--restore=bent.npz: its default pose is another"
    )


def test_both_halves_of_an_evaluation_have_the_policys_own_pose_and_joints(inside):
    """Grid and task's episodes, in a file with another keyframe, damping and friction."""
    pose = " 0.1 0.8 -1.5"
    text = GO1.xml.read_text()
    assert text.count(pose) == 1
    Path("other.xml").write_text(text.replace(pose, " 0.2 0.9 -1.6"))
    policy = policy_file.load(Path("mine.npz"))._replace(
        joint_damping=(0.7,) * 12, joint_friction=(0.3,) * 12
    )
    other, _ = policy_source.robot(policy, "other.xml")
    assert np.abs(other.default_pose - policy.default_pose).max() > 0.09
    driven = episodes.driven(policy, other)
    np.testing.assert_array_equal(driven.default_pose, GO1.default_pose)
    np.testing.assert_array_equal(driven.home_qpos[7:], GO1.default_pose)
    player, _ = policy_source.player(policy, "other.xml")
    engine = c_mujoco._model(driven, config().physics)  # of the task's episodes on a CPU
    for name in ("dof_damping", "dof_frictionloss"):
        of_grid, of_task = (getattr(model, name)[6:] for model in (player.model, engine))
        np.testing.assert_array_equal(of_grid, of_task)
        assert (getattr(other.mj_model, name)[6:] != of_task).any()
    data = mujoco.MjData(player.model)
    episode.reset(player, data)
    assert np.abs(data.qpos[player.joint_q] - driven.default_pose).max() <= episode.UNEVEN


def test_a_bundled_policy_is_told_from_a_folder_of_its_name(inside, capsys):
    """`go1` is the bundled one, whatever is here; the line says which was taken."""
    assert status(export_command.main, "go1", "--out=a.npz") == 0
    assert capsys.readouterr().out.startswith(
        "dynappo exports go1: robots/go1/policy.npz, iteration "
    )
    Path("go1").mkdir()
    shutil.copy("mine.npz", "go1/policy.npz")
    for what, said in (
        ("go1", "robots/go1/policy.npz, not that of ./go1, iteration "),
        ("./go1", "go1/policy.npz\n"),
    ):
        assert status(export_command.main, what, "--out=a.npz") == 0
        assert capsys.readouterr().out.startswith(f"dynappo exports go1: {said}")


def test_what_an_evaluation_leaves_out_of_a_policys_task_is_said(inside):
    """A weight that this version does not know, unless it was 0 or off."""
    policy = policy_file.load(Path("mine.npz"))
    assert episodes.left_out(policy) == ""
    for value, said in ((0.0, False), (None, False), (0.5, True)):
        task = policy.config["task"]
        weights = task["weights"] | {"alive": value}
        old = policy._replace(config=policy.config | {"task": task | {"weights": weights}})
        assert ("has task.weights.alive = 0.5, which this dyn" in episodes.left_out(old)) == said


def test_evaluations_of_two_sweeps_and_of_two_policies_do_not_mix(inside):
    """A sweep's is in its folder; where results of another policy are, a line says so."""
    for sweep in ("one", "two"):
        Path(sweep).mkdir()
        shutil.copy("mine.npz", f"{sweep}/policy.npz")
        Path(sweep, "sweep.json").write_text("{}")
        path = policy_source.locate(sweep)
        assert evaluate_command.folder(sweep, path) == Path(sweep) / "evaluation"
    flags, a, b = (
        SimpleNamespace(out=inside, stress=False, crossing=False),
        {"policy": "a/policy.npz"},
        {"policy": "b/policy.npz"},
    )
    assert evaluate_command.settle(flags, inside, a) == (inside, "")
    Path("evaluation.json").write_text(json.dumps(b))
    _, line = evaluate_command.settle(flags, inside, a)
    assert line == f"note: replaces in {inside} the results of b/policy.npz; --out=DIR keeps both"
    assert evaluate_command.settle(flags, inside, b) == (inside, "")


def test_a_policy_in_another_order_does_the_same_and_its_file_says_which(inside):
    """To float64; the task's episodes, which read the robot's own order, refuse it."""
    policy = policy_file.load(Path("mine.npz"))
    names = joint_order.parse("isaaclab", policy.joint_names, GO1)[0]
    turned = joint_order.permute(policy, names)
    assert turned.joint_names == names != policy.joint_names
    found = []
    for one in (policy, turned):
        player = episode.load(GO1.xml, one)
        act = policy_file.actor(one.params, one.activation)
        rows = episode.play(player, act, lambda t: np.array([0.5, 0.0, 0.2]), 0.3)
        found.append(np.asarray(rows["qpos"]))
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)
    assert "need the same order" in refused(episodes.check_robot, turned, GO1)


def test_an_evaluation_says_of_which_policy_and_which_code_it_is(inside):
    """The same parameters have the same hash in any file; one changed number another."""
    policy = policy_file.load(Path("mine.npz"))
    first = episodes.measured(policy.params, "run/policy.npz")
    assert first == episodes.measured(policy_file.load(Path("mine.npz")).params, "run/policy.npz")
    assert (
        first["policy"] == "run/policy.npz"
        and first["commit"]
        and first["mujoco"] == mujoco.__version__
    )
    policy.params["actor"]["params"]["Dense_1"]["bias"][3] += 1e-6
    assert (
        episodes.measured(policy.params, "run/policy.npz")["policy_sha256"]
        != first["policy_sha256"]
    )


def test_a_seed_that_is_not_in_a_file_is_refused(inside, capsys):
    """One policy has no seeds to choose from."""
    line = mistake(export_command.main, ["mine.npz", "--run-seed=1", "--out=a.npz"], capsys)
    assert "--run-seed=1: mine.npz holds one policy" in line

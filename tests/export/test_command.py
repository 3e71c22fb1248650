"""The command `python -m dynappo.export`: what it writes and says, and every mistake."""

import json
import shlex
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from answers import ROOT, mistake, shell, status
from toy_onnx import GO2_IN_ISAACLAB, MOTORS, described, onnx_file

from dynappo.config import shell as shell_lib
from dynappo.description import robot as robot_lib
from dynappo.export import command as export_command
from dynappo.policy import episode, policy_file

run = partial(status, export_command.main)


@pytest.fixture
def small(tmp_path):
    """The policy.npz of fresh networks of a Go2, and its policy."""
    policy, robot, _ = described("go2")
    path = tmp_path / "small" / "policy.npz"
    path.parent.mkdir()
    policy = policy._replace(iteration=7, sim_steps=123_456)
    onnx_file.save(policy, robot, path)
    return path, policy


def test_it_tells_what_it_wrote_and_the_line_to_try_works(small, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(small[0], "--out=policy.onnx", "--joint-order=unitree", "--targets") == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "dynappo exports go2: small/policy.npz, iteration 7, 123,456 simulator steps"
    told = {line[:12].strip(): line[12:] for line in lines}
    assert list(told) == ["written", "input", "output", "joints", "try", "on a robot"]
    kib = Path("policy.onnx").stat().st_size / 1024
    assert told["written"] == f"policy.onnx ({kib:.0f} KiB, ONNX, float32, opset 17)"
    assert told["input"].startswith("obs [batch, 48]")
    assert told["output"] == "action [batch, 12], targets [batch, 12] (rad)"
    assert told["joints"] == f"{' '.join(MOTORS)} (unitree)"
    assert (ROOT / told["on a robot"]).is_file()
    program, *arguments = shlex.split(told["try"])
    assert program == "python"
    done = shell(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("array(") == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["policy.onnx", "small"]


def test_an_npz_in_another_order_is_a_policy_file(small, tmp_path):
    """It says its order, and moves the robot as the first did, in its own file and by the same loader."""
    path, policy = small
    out = tmp_path / "other.npz"
    assert run(path, f"--out={out}", "--joint-order=isaaclab") == 0
    other = policy_file.load(out)
    assert other.joint_names == GO2_IN_ISAACLAB
    joints = {"joint_names", "default_pose", "joint_damping", "joint_friction"}
    for field in set(policy._fields) - joints - {"params", "config"}:
        assert np.array_equal(getattr(other, field), getattr(policy, field)), field
    assert json.dumps(other.config) == json.dumps(policy.config)
    walks, command = [], np.array([0.6, 0.0, 0.0])
    for p in (policy, other):
        body = episode.load(robot_lib.load("go2").xml, p, p.timestep)
        act = policy_file.actor(p.params, p.activation)
        walks.append(episode.play(body, act, lambda t: command, 0.4)["qpos"])
    assert np.abs(walks[0] - walks[0][0]).max() > 0.05
    np.testing.assert_allclose(*walks, atol=1e-4)
    assert run(out, f"--out={tmp_path}/back.npz", "--joint-order=mjcf") == 0
    back = policy_file.load(tmp_path / "back.npz")
    jax.tree.map(np.testing.assert_array_equal, back.params, policy.params)


# ---- mistakes

MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "nothing to export; name a workdir"),
    "unknown": (["wlk", "--out=a.onnx"], "wlk: no such file or folder; expected a workdir"),
    "no out": (["small"], "--out is missing; try --out=policy.onnx"),
    "suffix": (["small", "--out=a.pt"], "--out=a.pt: expected a file named .onnx, .npz"),
    "targets": (["small", "--out=a.npz", "--targets"], "--targets: only an .onnx has outputs"),
    "a folder": (["small", "--out=taken.npz"], "--out=taken.npz: cannot write there (Is a dir"),
    "itself": (["small", "--out=small/policy.npz"], "policy.npz: this would overwrite the policy"),
    "its robot": (
        ["small", "--robot-xml=mine.xml", "--out=mine.xml"],
        "--out=mine.xml: this would overwrite --robot-xml; choose another file",
    ),
    "order": (["small", "--out=a.onnx", "--joint-order=x"], "go2 has no joint x; expected mjcf"),
    "joints": (["spot.npz", "--out=a.onnx"], "its joints are LF_HAA"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(small, tmp_path, monkeypatch, capsys, name):
    """Nothing is written, nothing printed but the line, which names the flag."""
    arguments, expected = MISTAKES[name]
    monkeypatch.chdir(tmp_path)
    Path("taken.npz").mkdir()
    policy, robot, _ = described("anymal_c")  # its joints under the name of a Go1
    onnx_file.save(policy._replace(robot="go1", mjcf=""), robot, Path("spot.npz"))
    Path("mine.xml").write_text(small[1].mjcf)
    before = small[0].read_bytes()
    assert expected in mistake(export_command.main, arguments, capsys)
    assert {p.name for p in tmp_path.iterdir()} == {"mine.xml", "small", "spot.npz", "taken.npz"}
    assert Path("mine.xml").read_text() == small[1].mjcf
    assert small[0].read_bytes() == before and len(list(Path("small").iterdir())) == 1


def test_without_onnx_the_line_says_what_to_install(small, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    line = mistake(export_command.main, [small[0], f"--out={tmp_path}/a.onnx"], capsys)
    assert f"onnx is not installed; {shell_lib.install('export')}" in line
    assert run(small[0], f"--out={tmp_path}/a.npz") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "small"]


def test_help_explains_the_joint_orders(capsys):
    assert run("--help") == 0
    text = capsys.readouterr().out
    words = "--joint-order isaaclab unitree policy.npz DEPLOY.md".split()
    assert all(word in text for word in [*words, "FR FL RR RL"])


def test_a_word_comes_before_a_task_is_asked(tmp_path, monkeypatch, capsys):
    """Its process takes up to minutes."""
    said = []
    monkeypatch.setattr(export_command.task_onnx, "check", lambda *_: None)
    monkeypatch.setattr(export_command.task_onnx, "table", lambda *_: [])
    save = lambda *_: said.append(capsys.readouterr().out)  # noqa: E731
    monkeypatch.setattr(export_command.task_onnx, "save", save)
    policy = SimpleNamespace(config=SimpleNamespace(env="playground:Go1Getup"))
    export_command.of_task(
        policy,
        tmp_path / "a.npz",
        "runs/a",
        SimpleNamespace(out=tmp_path / "a.onnx", robot_xml=None, terms=None),
    )
    assert said[0].startswith("dynappo exports playground:Go1Getup: runs/a; ")

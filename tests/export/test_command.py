"""The command `python -m dynappo.export`: what it writes and says, and every mistake."""

import json
import shlex
import sys
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from answers import ROOT, mistake, shell, status
from toy_onnx import GO2_IN_ISAACLAB, MOTORS, described, onnx_file

from dynappo.config import shell as shell_lib
from dynappo.export import command as export_command
from dynappo.physics import robot as robot_lib
from dynappo.policy import episode, policy_file

run = partial(status, export_command.main)


@pytest.fixture
def small(tmp_path):
    """The policy.npz of fresh networks of a Go2, and its policy."""
    policy, robot, _ = described("go2")
    path = tmp_path / "small" / "policy.npz"
    path.parent.mkdir()
    onnx_file.save(policy, robot, path)
    return path, policy


def test_it_tells_what_it_wrote_and_the_line_to_try_works(small, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(small[0], "--out=policy.onnx", "--joint-order=unitree", "--targets") == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "dynappo exports go2: small/policy.npz"
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


def test_the_module_needs_neither_jax_nor_torch(small, tmp_path):
    """`python -m dynappo.export`, where none of them can be imported."""
    for package in ("jax", "torch", "onnxruntime"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"import runpy, sys; sys.path.insert(0, {str(tmp_path)!r}); "
    code += "runpy.run_module('dynappo.export', run_name='__main__', alter_sys=True)"
    done = shell("-c", code, small[0], f"--out={tmp_path}/a.onnx")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.onnx").stat().st_size > 10_000


# ---- mistakes

MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "nothing to export; name a workdir"),
    "unknown": (["wlk", "--out=a.onnx"], "wlk: no such file or folder; expected a workdir"),
    "two names": (["small", "go2", "--out=a.onnx"], "go2: no such flag"),
    "unknown flag": (["small", "--out=a.onnx", "--opset=9"], "--opset=9: no such flag"),
    "value missing": (["small", "--out", "--targets"], "--out: expected one argument"),
    "no out": (["small"], "--out is missing; try --out=policy.onnx"),
    "suffix": (["small", "--out=a.pt"], "--out=a.pt: expected a file named .onnx, .npz"),
    "no suffix": (["small", "--out=a"], "--out=a: expected a file named .onnx, .npz"),
    "targets": (["small", "--out=a.npz", "--targets"], "--targets: only an .onnx has outputs"),
    "no folder": (
        ["small", "--out=/proc/no/a.onnx"],
        "--out=/proc/no/a.onnx: cannot write there (No",
    ),
    "a long name": (["n" * 256, "--out=a.onnx"], f"{'n' * 256}: no such file or folder"),
    "a long out": (["small", f"--out={'n' * 256}.onnx"], "cannot write there (File name too long)"),
    "a folder": (["small", "--out=taken.npz"], "--out=taken.npz: cannot write there (Is a dir"),
    "itself": (["small", "--out=small/policy.npz"], "policy.npz: this would overwrite the policy"),
    "empty out": (["small", "--out="], "--out: is empty, expected a path"),
    "no name": (["", "--out=a.onnx"], "nothing to export; name"),
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
    before = small[0].read_bytes()
    assert expected in mistake(export_command.main, arguments, capsys)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small", "spot.npz", "taken.npz"]
    assert small[0].read_bytes() == before and len(list(Path("small").iterdir())) == 1


def test_without_onnx_the_line_says_what_to_install(small, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    line = mistake(export_command.main, [small[0], f"--out={tmp_path}/a.onnx"], capsys)
    assert f"onnx is not installed; {shell_lib.install('export')}" in line
    assert run(small[0], f"--out={tmp_path}/a.npz") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "small"]


def test_a_disk_that_is_full_is_one_line(small, tmp_path, monkeypatch, capsys):
    """The machine's fault: status 1, as in every command."""

    def full(part, out):
        raise OSError(28, "No space left on device", str(part))

    monkeypatch.setattr("os.replace", full)
    for name in ("a.onnx", "a.npz"):
        assert run(small[0], f"--out={tmp_path / name}") == 1
        line = capsys.readouterr().err
        assert (
            f"{name}.part cannot be read or written (No space left" in line
            and line.count("\n") == 1
        )
        assert not (tmp_path / name).exists()


def test_help_explains_the_joint_orders(capsys):
    assert run("--help") == 0
    text = capsys.readouterr().out
    words = "--joint-order isaaclab unitree policy.npz DEPLOY.md".split()
    assert all(word in text for word in [*words, "FR FL RR RL"])

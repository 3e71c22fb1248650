"""Commands that people are told: as they can be pasted where they are read."""

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from answers import ROOT, status

import dynappo
from dynappo.config import files, shell, versions
from dynappo.export import command as export
from dynappo.play import command as play
from dynappo.train import command as train


def test_the_program_is_one_word_where_the_shell_finds_that_of_this_python(tmp_path, monkeypatch):
    """Else the whole call: somebody has not activated the environment."""
    monkeypatch.setenv("PATH", str(tmp_path))
    assert shell.command_line().endswith(" -m dynappo")
    one = tmp_path / "dynappo"
    one.write_text("#!/bin/sh")
    one.chmod(0o755)
    assert shell.command_line().endswith(" -m dynappo")  # another Python's
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    assert shell.command_line() == "dynappo"
    monkeypatch.setenv("PATH", os.defpath)
    assert shell.command_line().endswith(" -m dynappo")
    monkeypatch.setattr(sys, "argv", [str(one), "play"])  # started by its path
    assert shell.command_line() == str(one)
    monkeypatch.chdir(tmp_path.parent)
    assert shell.command_line() == os.path.join(tmp_path.name, "dynappo")


@pytest.mark.parametrize("path", ["found", "started"])
def test_the_program_of_this_python_is_known_by_a_link_to_its_environment(
    path, tmp_path, monkeypatch
):
    """A worktree's .venv, whose scripts start the Python of the folder behind it."""
    (tmp_path / "real" / "bin").mkdir(parents=True)
    (tmp_path / "real" / "bin" / "dynappo").write_text("#!/bin/sh")
    (tmp_path / "real" / "bin" / "dynappo").chmod(0o755)
    (tmp_path / "real" / "bin" / "python").symlink_to(sys.executable)  # as in a venv
    (tmp_path / ".venv").symlink_to("real")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "real" / "bin" / "python"))
    monkeypatch.chdir(tmp_path)
    if path == "found":
        monkeypatch.setenv("PATH", str(tmp_path / ".venv" / "bin"))
        assert shell.command_line() == "dynappo"
        return
    monkeypatch.setenv("PATH", os.defpath)
    monkeypatch.setattr(sys, "argv", [".venv/bin/dynappo", "play"])
    assert shell.command_line() == ".venv/bin/dynappo"


@pytest.mark.parametrize("folder", [ROOT, ROOT / "configs", Path("/")])
def test_what_is_told_can_be_run_from_every_folder(folder, monkeypatch):
    """The line is given to a real shell."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PATH", os.defpath)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    line = shell.pasted("python -m dynappo.play --help")
    done = subprocess.run(line, shell=True, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("usage: dynappo play"), done.stderr


def test_what_is_in_the_words_does_not_change_what_is_told(tmp_path, monkeypatch):
    """Brackets, blanks, quotes and dollars of a folder's name; the line is given to a real shell."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PATH", os.defpath)
    for name in ("[a] b", "it's; $HOME"):
        line = shell.line("play", tmp_path / name, "--policy=zero")
        done = subprocess.run(line, shell=True, capture_output=True, text=True)
        assert done.returncode == 2 and f"{tmp_path / name}: " in done.stderr, done.stderr
    assert shell.line("play", "runs/x", "--out=a.html").endswith(" play runs/x --out=a.html")


def test_only_our_own_calls_are_written_anew():
    text = "python -m venv; python -m dynappo.play x; python -m dynappo.train"
    program = shell.command_line()
    assert shell.pasted(text) == f"python -m venv; {program} play x; {program} train"


def test_files_of_a_wheel_are_told_by_their_full_path(tmp_path, monkeypatch, capsys):
    """In helps, errors and what `play` says; in a clone, and of a file that is here, as it is."""
    wheel, here = tmp_path / "site" / "dynappo", tmp_path / "here"
    wheel.mkdir(parents=True)
    here.mkdir()
    for folder in ("configs", "robots"):
        (wheel / folder).symlink_to(ROOT / folder)
    assert shell.pasted("configs/default.py lists them") == "configs/default.py lists them"
    monkeypatch.setattr(files, "PACKAGE", wheel)
    monkeypatch.chdir(here)
    for main, words, name in (
        (train.main, ["--help"], "configs/default.py"),
        (train.main, ["--config=go1", "--config.zzzz=1"], "configs/default.py"),
        (export.main, ["--help"], "robots/DEPLOY.md"),
        (export.main, ["go1", "--out=go1.npz"], "robots/go1/policy.npz"),
        (play.main, ["go1", "--seconds=0.1", "--out=walk.html"], "robots/go1/policy.npz"),
    ):
        status(main, *words)
        said = "".join(capsys.readouterr())
        assert f"{wheel}/{name}" in said and said.count(name) == said.count(f"{wheel}/{name}"), said
    assert str(wheel) not in (here / "walk.html").read_text()  # which is shown to others
    (here / "configs").mkdir()
    (here / "configs" / "default.py").touch()
    text = (
        "configs/default.py robots/mine/mine.xml --config=configs/go1.py dynappo/robots/README.md"
    )
    assert shell.pasted(text) == text


@pytest.mark.parametrize("folder", [".", "tests"])
def test_in_a_clone_an_extra_is_installed_from_it_with_its_versions(folder, monkeypatch):
    monkeypatch.chdir(ROOT / folder)
    words = shell.install("export").split()
    pinned, source = words[words.index("-c") + 1], words[words.index("-e") + 1].strip("'")
    assert Path(pinned).samefile(ROOT / "constraints.txt")
    assert source.endswith("[export]") and Path(source.removesuffix("[export]")).samefile(ROOT)


def test_beside_a_wheel_an_extra_is_its_packages(tmp_path, monkeypatch):
    """dynappo itself may not be where pip looks."""
    monkeypatch.setattr(versions, "ROOT", tmp_path)
    asked = ["numpy>=2", "onnx>=1.20; extra == 'export'", 'wandb; extra == "wandb"']
    monkeypatch.setattr(metadata, "requires", lambda name: asked)
    assert shell.install("export").endswith("-m pip install 'onnx>=1.20'")
    assert shell.install("wandb").endswith("-m pip install wandb")
    assert shell.install("else").endswith("-m pip install 'dynappo[else]'")


def test_without_a_package_that_it_needs_every_command_says_what_to_do(tmp_path):
    """A Python that lacks one, as the system's: one line, status 2."""
    (tmp_path / "ml_collections.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'ml_collections'\", name='ml_collections')"
    )
    env = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    for module in ("dynappo", "dynappo.play"):
        command = [sys.executable, "-m", module, "play", "go1"]
        done = subprocess.run(command, env=env, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert done.stderr.startswith("dynappo: ml_collections is not installed for ")
        assert "pip install" in done.stderr or "activate" in done.stderr


def test_beside_a_wheel_a_missing_module_is_its_package(tmp_path, monkeypatch):
    monkeypatch.setattr(dynappo, "__file__", str(tmp_path / "dynappo" / "__init__.py"))
    asked = ["mujoco-mjx<4,>=3.17", "jax>=0.10; python_version>'3'", "ml-collections>=1"]
    monkeypatch.setattr(metadata, "requires", lambda name: asked)
    for module, package in (
        ("mujoco.mjx", "mujoco-mjx"),
        ("jax.numpy", "jax"),
        ("ml_collections", "ml-collections"),
        ("else_where.x", "else-where"),
    ):
        assert dynappo._remedy(module) == f"{sys.executable} -m pip install {package}"

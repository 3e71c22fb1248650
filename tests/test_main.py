"""The commands by one name: `dynappo COMMAND`, or `python -m dynappo COMMAND`."""

import tomllib

import pytest
from answers import ROOT, shell

from dynappo import __main__ as entry
from dynappo.config import versions


def test_a_command_is_given_the_rest_of_the_line(tmp_path):
    """It does what `python -m dynappo.COMMAND` does, and says so in the same words."""
    lines = [
        shell("-m", *start, "no_such_robot", f"--out={tmp_path}/a.html")
        for start in (("dynappo", "play"), ("dynappo.play",))
    ]
    assert lines[0].returncode == lines[1].returncode == 2
    assert lines[0].stderr == lines[1].stderr != ""


@pytest.mark.parametrize("argument", [[], ["--help"]])
def test_without_a_command_it_lists_them(argument):
    done = shell("-m", "dynappo", *argument)
    assert done.returncode == 0 and done.stderr == ""
    for name in entry.COMMANDS:
        assert f"\n  {name} " in done.stdout


def test_it_tells_its_version():
    done = shell("-m", "dynappo", "--version")
    assert done.returncode == 0 and done.stdout == f"dynappo {versions.of('dynappo')}\n"


def test_the_commands_are_the_folders_with_one():
    assert set(entry.COMMANDS) == {p.parent.name for p in (ROOT / "dynappo").glob("*/command.py")}


def test_another_word_is_one_line():
    done = shell("-m", "dynappo", "walk")
    assert done.returncode == 2 and done.stdout == ""
    expected = "dynappo: walk: no such command, expected one of "
    expected += "train, adopt, look, play, evaluate, export, bench\n"
    assert done.stderr == expected


def test_the_package_installs_it_as_a_command():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"dynappo": "dynappo.__main__:main"}
    assert callable(entry.main)

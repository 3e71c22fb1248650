"""What every command shares: flags in both spellings, and an end that is one line and a status."""

import pytest
from answers import refused, shell, status

from dynappo.config import ConfigError, flags

GO1 = "configs/go1.py:dyna4"
ENDS = {  # what an action raises, exit status, the line after "dynappo: "
    "wrong setting": (ConfigError("robot is 'x'"), 2, "robot is 'x'\n"),
    "ctrl-C": (KeyboardInterrupt(), 130, "stopped; nothing is written\n"),
    "blown up": (FloatingPointError("a loss is not finite"), 1, "a loss is not finite\n"),
    "disk full": (
        OSError(28, "No space left on device", "a.csv"),
        1,
        "a.csv cannot be written (No space left on device)\n",
    ),
    "a name of several lines": (ConfigError("a\n\x1b[2Jb\udcff"), 2, "a\\n\\x1b[2Jb\\udcff\n"),
    "no library": (OSError("libGL.so: cannot open"), 1, "libGL.so: cannot open\n"),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_ends_a_command_is_one_line_and_a_status(name, capsys):
    error, code, line = ENDS[name]

    def action():
        raise error

    assert status(lambda _: flags.answer(action, "stopped; nothing is written")) == code
    said = capsys.readouterr()
    assert said.err == f"dynappo: {line}" and said.out == ""


@pytest.mark.parametrize("command", "bench evaluate export play train".split())
def test_no_command_needs_the_opengl_that_is_asked_for(command, monkeypatch):
    """MuJoCo raises at its import where MUJOCO_GL names nothing that is there."""
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    done = shell("-m", f"dynappo.{command}", "--help")
    assert done.returncode == 0 and f"dynappo.{command}" in done.stdout, done.stderr


def test_an_error_of_ours_keeps_its_traceback():
    """A defect is not dressed up as a mistake of the user's."""
    with pytest.raises(ZeroDivisionError):
        flags.answer(lambda: 1 / 0)  # type: ignore


def test_fields_are_set_in_both_spellings_and_the_last_one_counts():
    """`--config.a.b=1` and `--config.a.b 1`."""
    more = ["--config.ppo.epochs", "3", "--config.ppo.gamma=1", "--config.ppo.epochs=2"]
    config = flags.load(GO1, [*more, "--config.ppo.hidden=(64,32)"])
    assert config.ppo.epochs == 2 and config.ppo.hidden == (64, 32) and config.ppo.gamma == 1.0
    assert "--config is missing" in refused(flags.load, None, [])
    assert "quick: no such flag" in refused(flags.load, GO1, ["quick"])
    assert "run.seed='': expected int" in refused(flags.load, GO1, ["--config.run.seed"])


def test_flags_are_written_out_and_complete():
    """No abbreviation, none that is not there, a value where one is needed."""
    parser = flags.parser("show", "Shows.", "")
    parser.add_argument("--workdir")
    assert flags.read(parser, ["--workdir=a"]).workdir == "a"
    for argv, expected in (
        (["--work=a"], "--work=a: no such flag; python -m dynappo.show --help lists them"),
        (["--workdir"], "--workdir: expected one argument; write it as --flag=VALUE"),
    ):
        assert refused(flags.read, parser, argv) == expected


def test_where_nothing_can_be_written_it_is_said_before_anything_is_done(tmp_path):
    """No file is left behind where there was none, and one that is there keeps its content."""
    flags.check_writable(tmp_path / "new.json")
    assert not list(tmp_path.iterdir())
    (tmp_path / "old.json").write_text("mine")
    flags.check_writable(tmp_path / "old.json")
    assert (tmp_path / "old.json").read_text() == "mine"
    for out, reason in (
        (tmp_path / "no" / "a.json", "No such file"),
        (tmp_path, "Is a directory"),
        (tmp_path / ("n" * 256), "File name too long"),
    ):
        assert f"--out={out}: cannot write there ({reason}" in refused(flags.check_writable, out)

"""What every command shares: flags in both spellings, and an end that is one line and a status."""

import argparse
import contextlib
import importlib
import io
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from answers import PATIENCE, ROOT, refused, shell, status

from dynappo.bench import command as bench
from dynappo.config import ConfigError, flags
from dynappo.look import command as look
from dynappo.train import command as train

GO1 = "configs/go1.py:dyna4"
ENDS = {  # what an action raises, exit status, the line after "dynappo: "
    "wrong setting": (ConfigError("robot is 'x'"), 2, "robot is 'x'\n"),
    "ctrl-C": (KeyboardInterrupt(), 130, "stopped; nothing is written\n"),
    "blown up": (FloatingPointError("a loss is not finite"), 1, "a loss is not finite\n"),
    "disk full": (
        OSError(28, "No space left on device", "a.csv"),
        1,
        "a.csv cannot be read or written (No space left on device)\n",
    ),
    "a name of several lines": (ConfigError("a\n\x1b[2Jb\udcff"), 2, "a\\n\\x1b[2Jb\\udcff\n"),
    "no library": (OSError("libGL.so: cannot open"), 1, "libGL.so: cannot open\n"),
    "SIGTERM": (KeyboardInterrupt(143), 143, "stopped; nothing is written\n"),
    "no memory": (
        MemoryError("Unable to allocate 4 TiB"),
        1,
        "out of memory (Unable to allocate 4 TiB); ask for less, or take a larger machine\n",
    ),
    "no memory of JAX's": (
        RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.\nand more"),
        1,
        "out of memory (RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.); ask for less, or take "
        "more devices\n",
    ),
    "another process lost": (ConnectionError("process 0 of 2 stops"), 1, "process 0 of 2 stops\n"),
    "a name that is no file's": (
        OSError(36, "File name too long", "aaa"),
        2,
        "aaa cannot be used (File name too long); name another file or folder\n",
    ),
    "not ours to read": (
        PermissionError(13, "Permission denied", "a"),
        2,
        "a cannot be used (Permission denied); name another file or folder\n",
    ),
    "very much of it": (ConfigError("x" * 9999), 2, "x" * 2000 + " ... " + "x" * 2000 + "\n"),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_ends_a_command_is_one_line_and_a_status(name, capsys):
    error, code, line = ENDS[name]

    def action():
        raise error

    assert status(lambda _: flags.answer(action, "stopped; nothing is written")) == code
    said = capsys.readouterr()
    assert said.err == f"dynappo: {line}" and said.out == ""


@pytest.mark.parametrize(
    "command",
    [
        *("evaluate", "train"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("bench", "export", "play")),
    ],
)
def test_no_command_needs_the_opengl_that_is_asked_for(command, monkeypatch):
    """MuJoCo raises at its import where MUJOCO_GL names nothing that is there."""
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    done = shell("-m", f"dynappo.{command}", "--help")
    assert done.returncode == 0 and f"usage: dynappo {command}" in done.stdout, done.stderr


def test_what_is_said_of_an_interruption_may_depend_on_when_it_is(capsys):
    said = []

    def action():
        said.append("at the second iteration")
        raise KeyboardInterrupt

    assert status(lambda _: flags.answer(action, lambda: f"stopped {said[0]}")) == 130
    assert capsys.readouterr().err == "dynappo: stopped at the second iteration\n"


def test_of_a_flag_that_is_given_twice_the_last_counts():
    """As of a script that ends in "$@"; --sweep takes several."""
    argv = ["--config=go2:laptop", "--config", GO1, "--fresh", "--fresh", "--config.run.seed=1"]
    argv += ["--config.run.seed", "2", "--sweep=ppo.gamma=0.9,0.95", "--sweep=ppo.epochs=3,4"]
    found = train.parse(argv)
    assert len(found.sweep.combinations) == 4  # pyright: ignore[reportOptionalMemberAccess]
    assert (found.config.robot, found.config.run.seed) == ("go1", 2)


class Dying:
    """Does something in its finalizer, where Python prints errors and goes on."""

    def __init__(self, does):
        self.does = does

    def __del__(self):
        self.does()


@pytest.fixture
def listening():
    """SIGINT interrupts, also where these tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_in_a_finalizer_interrupts_a_moment_later(capsys, listening):
    """It is not lost, as once in a callback of JAX's; another error there is told as ever."""

    def action():
        Dying(lambda: 1 / 0)
        Dying(lambda: signal.raise_signal(signal.SIGINT))
        said.append("goes on")
        time.sleep(PATIENCE)
        said.append("was never interrupted")

    said, before = [], sys.unraisablehook
    assert status(lambda _: flags.answer(action)) == 130
    assert said == ["goes on"]
    err = capsys.readouterr().err
    assert "ZeroDivisionError" in err and "KeyboardInterrupt" not in err
    assert err.endswith("dynappo: stopped\n") and sys.unraisablehook is before


def test_a_second_ctrl_c_in_that_moment_is_ignored(capfd, listening):
    """It comes while the first one is taken up: once it was an `Exception ignored in`, and both were lost."""

    class First(KeyboardInterrupt):
        @property
        def args(self):  # pyright: ignore[reportIncompatibleVariableOverride]
            more.append(None)
            if len(more) == 2:
                signal.raise_signal(signal.SIGINT)
            return ()

    def ctrl_c():
        raise First

    def action():
        Dying(ctrl_c)
        time.sleep(20)
        raise AssertionError("not interrupted")

    more = [None]
    assert status(lambda _: flags.answer(action)) == 130 and len(more) > 2
    assert capfd.readouterr().err == "dynappo: stopped\n"


COMMANDS = ("train", "adopt", "look", "play", "evaluate", "export", "bench")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_ends_so(name, monkeypatch, capsys):
    """By its own `main`: no command has an answer of its own to what may happen in it."""
    command = importlib.import_module(f"dynappo.{name}.command")

    def ends(error):
        def parse(argv):
            raise error

        monkeypatch.setattr(command, "parse", parse)
        return status(command.main), capsys.readouterr().err

    assert ends(ConfigError("wrong")) == (2, "dynappo: wrong\n")
    code, line = ends(MemoryError())
    assert code == 1 and line.startswith("dynappo: out of memory (Python)")
    code, line = ends(KeyboardInterrupt())
    assert code == 130 and line.startswith("dynappo: stopped") and line.count("\n") == 1
    with pytest.raises(ZeroDivisionError):
        ends(ZeroDivisionError())


PRINTS = "from dynappo.config import flags; flags.answer(lambda: print('Ünïcode ' * {}))"


@pytest.mark.parametrize(("count", "unbuffered"), [(1, ""), (99999, ""), (1, "1")])
def test_where_nobody_reads_any_more_a_command_ends_in_silence(count, unbuffered):
    """As under `| head`: no traceback, nor what Python says where it cannot write at its end."""
    read, write = os.pipe()
    os.close(read)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": unbuffered}
    command = [sys.executable, "-c", PRINTS.format(count)]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, b"")


def test_what_a_terminal_has_no_letter_for_is_printed_as_its_number():
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii", "LANG": "C"}
    command = [sys.executable, "-c", PRINTS.format(1)]
    done = subprocess.run(command, capture_output=True, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, rb"\xdcn\xefcode " + b"\n", b"")


def test_ctrl_c_while_a_command_is_imported_is_one_line():
    """Half a second in which nothing of ours could catch it; in another program nothing is changed."""
    code = "import sys; sys.argv[0] = '-m'; import dynappo; raise KeyboardInterrupt"
    done = shell("-c", code, "dynappo.play")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "dynappo: stopped\n")
    code = "import sys; import dynappo; assert sys.excepthook is sys.__excepthook__"
    assert shell("-c", code).returncode == 0
    code = "import sys; sys.argv[0] = '-m'; import dynappo; 1 / 0"
    assert "ZeroDivisionError" in shell("-c", code, "dynappo.play").stderr


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
        (["--workdir=--"], "--workdir: expected a value, not '--'"),
        (["--work=a"], "--work=a: no such flag; did you mean --workdir?"),
        (["workdir=a"], "workdir=a: no such flag; did you mean --workdir?"),
        (["--fast"], "--fast: no such flag; python -m dynappo.show --help lists them"),
        (["go1"], "go1: no such flag; python -m dynappo.show --help lists them"),
        (["--workdir"], "--workdir: expected one argument; write it as --flag=VALUE"),
    ):
        assert refused(flags.read, parser, argv) == expected


@pytest.mark.parametrize("name", COMMANDS)
def test_a_mistyped_flag_of_any_command_is_told_its_name(name):
    """Each of its flags with a letter less."""
    command = importlib.import_module(f"dynappo.{name}.command")
    with pytest.raises(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
        command.parse(["--help"])
    names = {*re.findall(r"--[a-z][a-z-]+", said.getvalue().partition("\n\n")[0])} - {"--help"}
    assert len(names) > 1
    for flag in names:
        line = refused(command.parse, [f"{flag[:3]}{flag[4:]}=x"])
        assert line.startswith(f"{flag[:3]}{flag[4:]}=x: no such flag; did you mean {flag}?"), line


def test_words_that_are_no_flags_say_what_may_be_meant(tmp_path, monkeypatch):
    """A config or a run without its flag, and with another flag mistyped; a robot that is not there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "g1-laptop").mkdir(parents=True)
    (tmp_path / "runs" / "g1-laptop" / "config.json").write_text("{}")
    for command, words, expected in (
        (train, ["spot:laptop"], "spot:laptop: no such flag; did you mean --config=spot:laptop?"),
        (train, ["own/dog.py"], "own/dog.py: no such flag; did you mean --config=own/dog.py?"),
        (train, ["runs/g1-laptop"], "did you mean --workdir=runs/g1-laptop?"),
        (train, ["--config=go1", "quick"], "quick: no such flag; expected --config.GROUP.FIELD"),
        (
            train,
            ["--workdir=runs/g1-lptop"],
            "did you mean --workdir=runs/g1-laptop? --config=NAME",
        ),
        (
            train,
            ["--workdir=runs/new"],
            "runs/new: no run there to go on with; --config=NAME, as go1:l",
        ),
        (
            train,
            ["--config=go3"],
            "--config: no file 'go3' here or among dynappo's own configs; robots",
        ),
        (bench, ["go1"], "go1: no such flag; did you mean --config=go1?"),
        (look, ["configs/spt.py"], "no file 'configs/spt.py' here"),
        (look, ["go1:nope"], "go1:nope: variant 'nope' is not"),
    ):
        line = refused(command.parse, words)
        assert expected in line and ("--config" in line) == ("--config" in expected), line
    assert "one are anymal_c, anymal_d, g1, go1, go2" in refused(train.parse, ["--config=go3"])


@pytest.mark.parametrize(
    ("name", "word", "said"),
    [
        ("train", "--task=go1", "here it is --config=NAME"),
        ("train", "--env=go1", "here it is --config=NAME"),
        ("train", "--env-name=go1", "here it is --config=NAME"),
        ("train", "--resume", "the same command goes on, and so does --workdir=DIR alone"),
        (
            "train",
            "--load_run=a",
            "--workdir=DIR goes on with a run, --restore=SOURCE starts from its",
        ),
        (
            "train",
            "--checkpoint=a",
            "--workdir=DIR goes on with a run, --restore=SOURCE starts from",
        ),
        ("train", "--max_iterations=9", "here it is --config.run.num_iterations=N"),
        ("train", "--num_timesteps=9", "here it is --config.run.num_iterations=N"),
        ("train", "--experiment_name=a", "here it is --workdir=DIR"),
        ("train", "--logdir=a", "here it is --workdir=DIR"),
        ("train", "--logger=wandb", "--config.run.wandb=PROJECT logs to"),
        ("train", "--headless", "expected --config.GROUP.FIELD=VALUE"),
        ("bench", "--task=go1", "here it is --config=NAME"),
        ("look", "--task=go1", "name the config without a flag"),
        ("play", "--checkpoint=a1", "name the policy, or the folder of its run, without a flag"),
        ("evaluate", "--load_run=a1", "name the policy, or the folder of its run, without a flag"),
        ("export", "--logger=wandb", "python -m dynappo.export --help lists them"),
    ],
)
def test_a_flag_of_another_trainer_is_told_what_is_here_in_its_place(name, word, said):
    command = importlib.import_module(f"dynappo.{name}.command")
    assert refused(command.parse, [word]).startswith(f"{word}: no such flag; {said}")


def test_an_empty_path_and_a_far_number_are_refused():
    parser = flags.parser("show", "Shows.", "")
    parser.add_argument("--workdir", type=flags.path)
    assert "--workdir: is empty, expected a path" in refused(flags.read, parser, ["--workdir="])
    deep = refused(flags.read, parser, ["--workdir=" + "a/" * 2000])
    assert deep == "--workdir: has 4000 characters, expected at most 600"
    assert flags.whole("seed", "7", 0) == 7
    for text in ("-1", "2147483648", "1" + "0" * 30, "9" * 9999, "1.5", "", "x"):
        line = refused(flags.whole, "seed", text, 0)
        assert line.endswith("expected an integer of 0 or more, at most 2,147,483,647")
        assert len(line) < 120


def test_a_name_that_is_not_utf_8_is_refused():
    """Orbax could not save below it, after a whole training."""
    with pytest.raises(argparse.ArgumentTypeError, match="which is not UTF-8"):
        flags.path("runs/w\udcff")
    assert flags.path("runs/ü b").name == "ü b"


def test_where_nothing_can_be_written_it_is_said_before_anything_is_done(tmp_path):
    """No file is left behind where there was none, and one that is there keeps its content."""
    flags.check_writable(tmp_path / "new.json")
    assert not list(tmp_path.iterdir())
    (tmp_path / "old.json").write_text("mine")
    flags.check_writable(tmp_path / "old.json")
    assert (tmp_path / "old.json").read_text() == "mine"
    flags.check_writable(tmp_path / "some" / "new" / "a.json")  # a folder is made when it is needed
    assert [path.name for path in tmp_path.iterdir()] == ["old.json"]
    link, pipe = tmp_path / "walk.html", tmp_path / "pipe.html"
    link.symlink_to("target.html")  # stays a link to nothing
    os.mkfifo(pipe)  # is not waited for
    flags.check_writable(link)
    assert not (tmp_path / "target.html").exists() and link.is_symlink()
    for out, reason in (
        (pipe, "Not a regular file"),
        (tmp_path / "old.json" / "a.json", "File exists"),
        (tmp_path, "Is a directory"),
        (tmp_path / ("n" * 256), "File name too long"),
    ):
        assert f"--out={out}: cannot write there ({reason}" in refused(flags.check_writable, out)


def test_what_is_read_is_not_written_over(tmp_path):
    """Also through a link or another spelling; what is no file, or is not there, is none."""
    mine, link = tmp_path / "mine.png", tmp_path / "link.png"
    mine.touch()
    link.symlink_to(mine)
    for out in (mine, link, tmp_path / "." / "mine.png"):
        line = refused(flags.check_kept, out, {"--command": None, "--ground": str(mine)})
        assert line == f"--out={out}: this would overwrite --ground; choose another file"
    for path in (None, "pit_stairs:0.3", "n" * 300, tmp_path):
        flags.check_kept(mine, {"--ground": path})
    flags.check_kept(tmp_path / "new.png", {"--ground": mine})

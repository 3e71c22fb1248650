"""The command `python -m dynappo.play`: what is asked of the robot, what it writes, every mistake."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pages
import pytest
from answers import mistake, refused, shell, status
from toy_policy import other_file, save

from dynappo.play import command as play_command
from dynappo.play import command_script, task_episode
from dynappo.policy import episode, policy_file, policy_source, render


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The policy.npz of an actor of the Go1."""
    return save(tmp_path_factory.mktemp("saved") / "policy.npz")


@pytest.fixture(scope="module")
def player(saved):
    return policy_source.player(policy_file.load(saved))[0]


# ---- commands


def test_a_constant_command_and_the_tour():
    one = command_script.commands("0.8,-0.1,0.25", None)
    for t in (0.0, 1e3):
        np.testing.assert_array_equal(one.at(t), [0.8, -0.1, 0.25])
    assert one.seconds == command_script.SECONDS
    for seconds in (None, 5.0):
        tour, length = command_script.commands(None, seconds), seconds or command_script.SECONDS
        assert tour.seconds == length
        for t in np.linspace(0, length, 50):
            np.testing.assert_array_equal(tour.at(t), episode.tour(length)(t))


def test_a_script_is_piecewise_constant(tmp_path):
    """Zero before its first row; a row holds from its own control step to that of the next."""
    path = tmp_path / "drill.csv"
    path.write_text("# ahead, then a turn\nt,vx,vy,wz\n0.06,1,0,0\n\n 0.30 , 0.5, -0.2, 0.1\n")
    script = command_script.commands(str(path), None)
    assert script.seconds == pytest.approx(0.30 + command_script.AFTER_SCRIPT)
    seen = [tuple(script.at(k * 0.02)) for k in range(20)]
    assert seen == [(0, 0, 0)] * 3 + [(1, 0, 0)] * 12 + [(0.5, -0.2, 0.1)] * 5
    np.testing.assert_array_equal(script.rows, [[1, 0, 0], [0.5, -0.2, 0.1]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "has no rows"),
        ("0,1,0\n", "line 1 is '0,1,0', expected four numbers"),
        ("t,vx,vy,wz\n0,1,0,0\n1,fast,0,0\n", "line 3 is '1,fast,0,0'"),
        ("0,1,0,0\n2,1,0,0\n1,0,0,0\n", "line 3: t is 1, expected times from 0 on that increase"),
        ("-1,1,0,0\n", "line 1: t is -1"),
        ("0,1,0,0\n1e9,1,0,0\n", "line 2: t is 1e+09, expected at most 3600 s"),
        ("0,nan,0,0\n", "line 1 is '0,nan,0,0', expected four numbers"),
        ("0,1e300,0,0\n", "line 1 is '0,1e300,0,0', expected commands up to 100"),
        ("0,1,0,0\n" + "9" * 10**6, "line 2 is '9999"),
        ("#" * (command_script.MAX_SCRIPT + 1), "more than 16777216 bytes"),
        ("\xff\xfe", "not a text file"),
    ],
)
def test_a_wrong_script_is_one_line(tmp_path, text, expected):
    path = tmp_path / "drill.csv"
    path.write_bytes(text.encode("latin-1"))
    line = refused(command_script.commands, str(path), None)
    assert line.startswith(f"--command={path}: ") and expected in line and len(line) < 300


def test_commands_outside_the_training_are_pointed_out(saved):
    ranges = command_script.ranges_of(policy_file.load(saved))
    for text, note in (
        ("1,-1,1", ""),
        ("1.5,0,0", "note: vx = 1.5 was not trained; it was from -1 to 1"),
        ("0,0,-2", "note: wz = -2 was not trained; it was from -1 to 1"),
    ):
        assert command_script.outside(ranges, command_script.commands(text, None)) == note


# ---- what it writes


def test_play_writes_a_page_and_tells_what_came_out(saved, tmp_path, monkeypatch, capsys):
    """A script in another file, from the command line: the table, the note, the file."""
    monkeypatch.chdir(tmp_path)
    other_file(tmp_path / "other.xml")
    Path("drill.csv").write_text("0,0.5,0,0\n0.4,1.4,0,0\n")
    flags = ["--command=drill.csv", "--seconds=1.5", "--robot-xml=other.xml", "--out=walk.html"]
    assert status(play_command.main, saved, *flags) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("/policy.npz; commands of drill.csv")
    assert lines[1].startswith("in other.xml: 4 steps of 5 ms between two actions; motors, joint")
    assert lines[2] == "note: vx = 1.4 was not trained; it was from -1 to 1"
    told = {line[:18].strip(): line[18:].strip() for line in lines[3:]}
    assert told["played"] == "1.5 s" and told["written"].startswith("walk.html (")
    names = "played|distance|tracking error|yaw rate error|fall|cost of transport|written"
    assert list(told) == names.split("|")
    command = pages.numbers(pages.read(Path("walk.html")), "command", "<f4", 3)
    np.testing.assert_allclose(command[:, 0], [0.5] * 20 + [1.4] * 55, atol=1e-6)


def test_after_a_fall_every_number_says_that_it_is_until_then(player):
    """A robot that goes 0.5 m/s until it lies, after 1.5 s or 0.5 s of 4."""
    qpos = np.zeros((200, 19))
    qpos[:, 0] = 0.01 * np.arange(200)
    rows = {"qpos": qpos, "work": np.ones(200), "dt": np.array(0.02), "fell": np.zeros(200, bool)}
    rows["velocity"], rows["command"] = (
        np.tile([0.5, 0, 0], (200, 1)),
        np.tile([0.6, 0, 0.1], (200, 1)),
    )
    stands = dict(play_command.table(player, rows))
    assert stands["played"] == "4.0 s" and stands["tracking error"] == "0.10 m/s"
    assert not any("until" in text for text in stands.values())
    rows["fell"][74:] = True
    fell = dict(play_command.table(player, rows))
    assert fell["played"] == "1.5 s until the fall, 4.0 s in all" and fell["fall"] == "after 1.5 s"
    assert fell["distance"] == "0.7 m until the fall"
    assert fell["tracking error"] == "0.10 m/s until the fall"
    assert fell["yaw rate error"] == "0.10 rad/s until the fall"
    assert fell["cost of transport"].endswith(" until the fall")
    rows["fell"][24:] = True
    fell = dict(play_command.table(player, rows))
    assert (
        fell["played"].startswith("0.5 s until")
        and fell["tracking error"] == "fell in the first second"
    )
    assert fell["distance"] == "0.2 m until the fall"  # so it did go somewhere
    assert fell["cost of transport"] == "went less than 0.5 m until the fall"
    rows["fell"][:], rows["qpos"] = False, 0.1 * qpos
    slow = dict(play_command.table(player, rows))
    assert (slow["distance"], slow["cost of transport"]) == ("0.2 m", "went less than 0.5 m")


def test_zero_stands_and_random_follows_its_seed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def joints(*flags):
        assert status(play_command.main, "go2", *flags, "--seconds=0.3", "--out=walk.html") == 0
        position, _ = pages.unpack(pages.read(Path("walk.html")))
        return position[:, 1:] - position[:, :1]

    zero = joints("--policy=zero")
    assert np.abs(zero - zero[0]).max() < 0.05
    one, same, other = (joints("--policy=random", f"--seed={s}") for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.01 and np.abs(one - one[0]).max() > 0.02


def test_random_actions_and_the_pose_at_the_start_are_drawn_from_two_streams(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    streams, make = [], np.random.default_rng

    def spy(seed):
        streams.append(str(make(seed).bit_generator.state))
        return make(seed)

    monkeypatch.setattr(np.random, "default_rng", spy)
    flags = "--policy=random", "--seed=0", "--seconds=0.1", "--out=walk.html"
    assert status(play_command.main, "go2", *flags) == 0
    assert len(set(streams)) == len(streams) == 2


def test_the_module_makes_a_page_without_jax_and_without_opengl(saved, tmp_path):
    """`python -m dynappo.play`, where neither can be imported."""
    for package in ("OpenGL", "glfw", "jax", "imageio_ffmpeg", "matplotlib"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"import runpy, sys; sys.path.insert(0, {str(tmp_path)!r}); "
    code += "runpy.run_module('dynappo.play', run_name='__main__', alter_sys=True)"
    out = tmp_path / "walk.html"
    done = shell("-c", code, saved, "--seconds=0.2", f"--out={out}")
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size > 50_000


def test_a_film_that_cannot_be_made_points_to_the_page(saved, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(render, "film", lambda *_: "no video: no such thing")
    out = tmp_path / "walk.mp4"
    assert status(play_command.main, saved, "--seconds=0.1", f"--out={out}") == 2
    said = capsys.readouterr().err
    assert "no video: no such thing" in said and "--out=walk.html" in said and not out.exists()


def test_a_full_disk_is_no_mistake_of_the_command(saved, tmp_path, monkeypatch, capsys):
    """Status 1, as all that the machine fails at; a page needs room, too."""

    def full(*_):
        raise OSError("cannot write walk.mp4 (No space left on device)")

    monkeypatch.setattr(render, "film", full)
    assert status(play_command.main, saved, "--seconds=0.1", f"--out={tmp_path}/walk.mp4") == 1
    said = capsys.readouterr().err
    assert said.endswith("dynappo: cannot write walk.mp4 (No space left on device)\n")


# ---- mistakes

MISTAKES = {  # flags, what the line must say
    "nothing": ([], "nothing to play; name a workdir"),
    "unknown": (["wlk"], "wlk: no such file or folder; expected a workdir"),
    "a folder of nothing": (
        ["taken.html"],
        "taken.html: holds neither a policy.npz nor checkpoints/; expected a workdir of `dynappo train`, or "
        "a policy.npz",
    ),
    "unknown flag": (["go1", "--speed=3"], "--speed=3: no such flag"),
    "two policies": (["go1", "go2"], "go2: expected one NAME_OR_DIR, and flags"),
    "policy": (["go1", "--policy=best"], "--policy='best': expected zero or random"),
    "seed": (["go1", "--policy=random", "--seed=one"], "--seed='one': expected an integer"),
    "seed of a policy": (["go1", "--seed=7", "--out=a.html"], "--seed=7: is for --policy=random"),
    "seed of zero": (["go1", "--seed=0", "--policy=zero"], "--seed=0: is for --policy=random"),
    "its robot": (
        ["go1", "--robot-xml=mine.png", "--out=mine.png"],
        "--out=mine.png: this would overwrite --robot-xml; choose another file",
    ),
    "its ground": (
        ["go1", "--ground=mine.png", "--out=./mine.png"],
        "this would overwrite --ground",
    ),
    "its commands": (["go1", "--command=mine.png", "--out=mine.png"], "would overwrite --command"),
    "its policy": (["mine.png", "--out=mine.png"], "this would overwrite the policy"),
    "seconds": (["go1", "--seconds=long"], "--seconds='long': expected a number above 0"),
    "two numbers": (["go1", "--command=1,2"], "--command='1,2': expected three numbers"),
    "not finite": (["go1", "--command=nan,0,0"], "expected three numbers"),
    "too fast": (["go1", "--command=1e300,0,0"], "expected numbers from -100 to 100"),
    "a long script": (["go1", f"--command={'n' * 256}.csv"], "cannot be read (File name too long"),
    "no script": (["go1", "--command=no.csv"], "--command=no.csv: cannot be read (No such file"),
    "suffix": (["go1", "--out=walk.avi"], "--out=walk.avi: expected a file named .mp4, .gif"),
    "a folder": (["go1", "--out=taken.html"], "--out=taken.html: cannot write there (Is a dir"),
    "no file": (["go1", "--robot-xml=no.xml"], "--robot-xml=no.xml: no such file"),
    "a folder as robot": (
        ["go1", "--robot-xml=taken.html"],
        "--robot-xml=taken.html: it is a folder, expected an MJCF",
    ),
    "no MJCF": (["go1", "--robot-xml=mine.png"], "mine.png: it is no XML, expected an MJCF"),
    "no robot": (["go1", "--robot-xml=empty.xml"], "--robot-xml=empty.xml: expected hinge joints"),
    "size": (
        ["go1", "--out=a.mp4", "--size=big"],
        "--size='big': expected WIDTHxHEIGHT, even numbers",
    ),
    "size of a page": (
        ["go1", "--out=a.html", "--size=64x64"],
        "--size=64x64: is for films and pictures",
    ),
    "size of no file": (["go1", "--size=64x64"], "--size=64x64: is for films and pictures"),
    "joints of no file": (["go1", "--keep-joints"], "--keep-joints needs --robot-xml=FILE"),
    "no display": (["go1"], "no display for the viewer; write a file instead: --out=walk.html"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, name):
    """Nothing is written, nothing printed but the line, which names the flag."""
    flags, expected = MISTAKES[name]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (tmp_path / "taken.html").mkdir()
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    (tmp_path / "mine.png").write_text("mine")
    named = any(flag.startswith("--policy") for flag in flags)
    acts = [] if named or not flags or "--seed=7" in flags else ["--policy=zero"]
    assert expected in mistake(play_command.main, [*flags, *acts], capsys)
    assert {p.name for p in tmp_path.iterdir()} == {"taken.html", "empty.xml", "mine.png"}
    assert (tmp_path / "mine.png").read_text() == "mine"


def test_a_name_that_a_stream_or_a_page_cannot_show_is_written_in_ascii(
    saved, tmp_path, monkeypatch
):
    """Streams of ASCII (PYTHONIOENCODING), and a file name that is no UTF-8."""
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    folder = tmp_path / "ü\udcff"
    folder.mkdir()
    shutil.copy(saved, folder)
    out = tmp_path / "walk.html"
    done = shell("-m", "dynappo.play", folder / "policy.npz", "--seconds=0.1", f"--out={out}")
    assert done.returncode == 0 and "\\xfc\\udcff/policy.npz" in done.stdout, done.stderr
    assert "ü\\udcff/policy.npz" in out.read_text(encoding="utf-8")
    done = shell("-m", "dynappo.play", folder / "no.npz", f"--out={out}")
    assert done.returncode == 2 and "\\xfc\\udcff/no.npz: no such file" in done.stderr


@pytest.mark.parametrize("backend", [pytest.param("osmesa", marks=pytest.mark.slow), "nonsense"])
def test_a_page_needs_no_opengl_whatever_is_asked_for(saved, tmp_path, monkeypatch, backend):
    """MuJoCo cannot be imported with a MUJOCO_GL that is not there; a page is written nevertheless."""
    monkeypatch.setenv("MUJOCO_GL", backend)
    out = tmp_path / "walk.html"
    done = shell("-m", "dynappo.play", saved, "--seconds=0.1", f"--out={out}")
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size > 50_000


def test_help_explains_what_can_be_played(capsys):
    assert status(play_command.main, "--help") == 0
    text = capsys.readouterr().out
    words = "--robot-xml policy.npz t,vx,vy,wz .html --policy=random".split()
    assert all(word in text for word in [*words, "space: stop"])


def test_a_task_without_a_command_refuses_one_before_its_process_starts(monkeypatch):
    monkeypatch.setattr(task_episode.task_player, "check", lambda env: None)
    policy = SimpleNamespace(config=SimpleNamespace(env="brax:hopper"))
    flags = SimpleNamespace(serve=None, out=Path("a.html"), command="0.5,0,0")
    line = refused(task_episode.check, policy, flags)
    assert line == "--command: brax:hopper has no command to follow"

"""The command `python -m dynappo.evaluate`: the file, the table, and every mistake."""

import io
import json
import re
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import toy_sweep
from answers import mistake, refused, shell, status
from ml_collections import config_dict
from rich.console import Console
from toy_policy import actor, described

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.evaluate import (
    changes,
    episodes,
    recording,
    slow,
    stairs,
    stress,
    task_episodes,
    trials,
)
from dynappo.evaluate import command as evaluate_command
from dynappo.evaluate import tables as evaluate_tables
from dynappo.policy import episode, policy_file, policy_source


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The policy.npz of a Go1 that moves its legs a little."""
    path = tmp_path_factory.mktemp("saved") / "mover.npz"
    config, robot = described()
    config = config_dict.ConfigDict(config)
    config.ppo.hidden = (16, 16)
    policy_file.save(path, actor(), config, robot)
    return path


@pytest.fixture
def short(monkeypatch):
    """Sweeps of 3 x 3 commands and 1.2 s, few changes of command, tours of a moment."""
    monkeypatch.setattr(trials, "run", partial(trials.run, seconds=1.2, points=3))
    monkeypatch.setattr(changes, "NUMBER", 9)
    monkeypatch.setattr(evaluate_command, "FEW_CHANGES", 3)
    monkeypatch.setattr(changes, "EVERY", (0.2, 0.3))
    for name in ("FILM_SECONDS", "PAGE_SECONDS"):
        monkeypatch.setattr(episode, name, 0.2)


run = partial(status, evaluate_command.main)


def test_the_command_writes_what_it_prints(saved, tmp_path, monkeypatch, capsys, short):
    """Numbers of trials and of episodes in one JSON; each is in the table; two pictures."""
    monkeypatch.chdir(tmp_path)
    of_task = dict(episodes=5, seconds=20.0, randomize=True, seed=0, device="cpu", impl="c")
    of_task |= {"return": 33.25, "return_std": 1.5, "length": 987.0, "fall_rate": 0.2}
    of_task |= {"tracking_error": 0.12, "yaw_error": None, "policy": "almost walks; falls > 1 %"}
    calls = []
    monkeypatch.setattr(episodes, "run", lambda *a: calls.append(a[1:4]) or of_task)
    monkeypatch.setattr(evaluate_command.devices, "own_process", lambda: calls.append("settings"))
    assert run(saved, "--episodes=5", "--randomize") == 0
    assert calls == ["settings", (5, True, 0)]
    lines = capsys.readouterr().out.splitlines()
    out = tmp_path / "evaluation-mover"
    assert lines[0] == f"dynappo evaluates go1: {saved.parent.name}/mover.npz"
    names = ["evaluation.json", "report.html", "tracking.png", "gait.png"]
    assert lines[-1] == "written to evaluation-mover: " + ", ".join(names)
    written = json.loads((out / "evaluation.json").read_text())
    assert written["episodes"] == of_task and written["robot"] == "go1"
    assert {path.name for path in out.iterdir()} == set(names)
    for name in ("tracking.png", "gait.png"):
        assert (out / name).read_bytes()[:4] == b"\x89PNG" and (out / name).stat().st_size > 20_000
    told = {}
    for line in lines:  # the table of the sweep comes first
        told.setdefault(line[:24].strip(), re.split(r"\s{2,}", line[24:].strip()))
    sweep = written["sweep"]
    for name, label, text in evaluate_tables.ROWS:
        columns = [sweep["all"], *sweep["ahead"], sweep["standing"]]
        expected = ["-" if c[name] is None else text.format(c[name]) for c in columns]
        assert told[label.strip()] == expected, label
    text = "\n".join(lines)
    changed = written["changes"]
    assert (changed["changes"], changed["seed"], len(changed["tours"])) == (9, 0, 2)
    assert set(evaluate_tables.changes_lines(changed)) <= set(lines)
    page = (out / "report.html").read_text()
    assert all(line in page for line in evaluate_tables.changes_lines(changed))
    for part in (
        "almost walks; falls > 1 %",
        "33.25",
        "1.50",
        "20.0 %",
        "987 control steps",
        "nobody stood for a second",
    ):
        assert part in text, part
    assert "noise, pushes, randomised physics; C MuJoCo on cpu" in text
    known = set(of_task) | set(sweep) | set(sweep["commands"][0]) | set(sweep["all"]) | set(changed)
    assert set(written["units"]) - known == {"before", "after", "fell_at"}  # of a fall, of a tour


def test_the_evaluation_of_a_workdir_is_in_it(saved, tmp_path, monkeypatch, capsys, short):
    """Without MJX; where there are files of an earlier one, they are replaced."""
    monkeypatch.setattr(episodes, "run", None)
    (tmp_path / "config.json").write_text(config_lib.to_json(described()[0]))
    (tmp_path / "policy.npz").write_bytes(saved.read_bytes())
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "evaluation.json").write_text("old")
    assert run(tmp_path, "--fast", "--seed=5") == 0
    written = json.loads((tmp_path / "evaluation" / "evaluation.json").read_text())
    assert (written["changes"]["changes"], written["changes"]["seed"]) == (3, 5)
    assert written["episodes"] is None and written["sweep"]["seconds"] == 1.2
    assert "MJX" not in capsys.readouterr().out


def test_stopped_after_a_table_it_leaves_nothing(saved, tmp_path, monkeypatch, capsys):
    """In the stairs; the disturbances before have been printed. The folder would be new."""
    row = dict(stress="none", episodes=4, falls=1, tracking_error=0.1, yaw_error=None)
    monkeypatch.setattr(stress, "run", lambda *_: [row])
    monkeypatch.setattr(evaluate_command.tables, "stairs", None)

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stairs, "run", stopped)
    policy = policy_file.load(saved)
    task = policy.config["task"] | {"terrain": "rough"}
    rough = policy._replace(config=policy.config | {"task": task})
    monkeypatch.setattr(policy_source, "load", lambda *_: (rough, saved))
    assert run(saved, "--stress", f"--out={tmp_path}/new/folder") == 130
    said = capsys.readouterr()
    assert "1 of 4" in said.out and said.err == "dynappo: stopped\n"
    assert not [*tmp_path.iterdir()]


def test_where_an_evaluation_goes(tmp_path):
    """Into the workdir, also of a checkpoint; else beside where one is, by name."""
    (tmp_path / "config.json").touch()
    checkpoint = tmp_path / "checkpoints" / "100"
    checkpoint.mkdir(parents=True)
    for what, path, expected in (
        (tmp_path, tmp_path / "policy.npz", tmp_path / "evaluation"),
        (tmp_path, checkpoint, tmp_path / "evaluation"),
        ("go1", Path("robots/go1/policy.npz"), Path("evaluation-go1")),
        ("go1", tmp_path / "policy.npz", Path("evaluation-go1")),  # whatever is beside it
        ("a/best.npz", Path("a/best.npz"), Path("evaluation-best")),
    ):
        assert evaluate_command.folder(str(what), path) == expected
        of_seed = expected.with_name(f"{expected.name}-seed-2")
        assert evaluate_command.folder(str(what), path, 2) == of_seed


def results(out, name="evaluation.json", **entries):
    """A folder with such a file."""
    out.mkdir(parents=True, exist_ok=True)
    (out / name).write_text(json.dumps(entries))


def test_results_of_another_policy_or_robot_are_not_written_over(tmp_path, monkeypatch):
    """In a default folder; in that of a run, whose policy goes on, and in --out a note says so."""
    monkeypatch.chdir(tmp_path)
    flags = SimpleNamespace(out=None, what="go1", run_seed=None, stress=False, crossing=False)
    path = Path("robots/go1/policy.npz")
    about, first = dict(policy="robots/go1/policy.npz", policy_sha256="a"), Path("evaluation-go1")
    settle = evaluate_command.settle
    assert settle(flags, path, about) == (first, "")
    results(first, "stress.json", **about)
    assert settle(flags, path, about) == (first, "")
    for other in (about | {"policy_sha256": "b"}, about | {"robot_xml": "go2.xml"}):
        out, note = settle(flags, path, other)
        assert (str(out), note) == (
            "evaluation-go1-2",
            f"note: {first} holds results of {path}; these go to evaluation-go1-2",
        )
    results(out, **other)
    assert settle(flags, path, other)[0] == out
    assert settle(flags, path, about | {"robot_xml": "x"})[0].name == "evaluation-go1-3"
    flags.out = out
    expected = f"note: replaces in {out} the results of {path} in go2.xml; --out=DIR keeps both"
    assert settle(flags, path, about) == (out, expected)
    flags.stress = True  # which writes another file
    expected = f"note: {out} also holds results of {path} in go2.xml; --out=DIR keeps them apart"
    assert settle(flags, path, about) == (out, expected)
    results(out, "stress.json", **about | {"policy_sha256": "b"})
    assert settle(flags, path, about)[1].startswith("note: replaces in ")
    results(Path("run/evaluation"), **about)
    Path("run/config.json").touch()
    flags.out, flags.what, flags.stress = None, "run", False
    later = about | {"policy_sha256": "b"}
    out, note = settle(flags, Path("run/policy.npz"), later)
    assert (str(out), note) == (
        "run/evaluation",
        f"note: replaces in run/evaluation the results of {path}; --out=DIR keeps both",
    )
    out, _ = settle(flags, Path("run/policy.npz"), about | {"robot_xml": "go2.xml"})
    assert str(out) == "run/evaluation-2"
    results(Path("run/evaluation-seed-1"), **about)
    flags.run_seed = 1  # whose policy goes on, too
    out, note = settle(flags, Path("run/policy.npz"), later)
    assert str(out) == "run/evaluation-seed-1" and note.startswith("note: replaces in ")
    flags.run_seed = 2
    assert settle(flags, Path("run/policy.npz"), later) == (Path("run/evaluation-seed-2"), "")


def test_a_policy_is_one_however_its_path_is_typed():
    """By its hash; by its name where no results have one. Of results with none nothing is known."""
    of_one, typed = evaluate_command.of_one, {"policy": "mine/runs/ci/policy.npz"}
    here = {"policy": "runs/ci/policy.npz"}
    assert of_one(here | {"policy_sha256": "a"}, typed | {"policy_sha256": "a"})
    assert not of_one(here | {"policy_sha256": "a"}, here | {"policy_sha256": "b"})
    assert of_one(here, here) and not of_one(here, typed)
    assert not of_one(here, here | {"policy_sha256": "a"})
    body = {"policy_sha256": "a", "robot_sha256": "b"}
    assert of_one(here | body, typed | body | {"robot_xml": "there/a.xml"})
    assert not of_one(here | body, here | body | {"robot_sha256": "c"})
    other = {"robot_sha256": "c", "mujoco": "4"}  # which hashes a model otherwise
    assert of_one(here | body | {"mujoco": "3"}, here | body | other)
    assert of_one(here | body, typed | {"policy_sha256": "a"})  # an older result
    xml = {"robot_xml": "a.xml"}
    assert not of_one(here | {"policy_sha256": "a"}, typed | {"policy_sha256": "a"} | xml)


def test_fast_keeps_the_episodes_of_the_same_policy(saved, tmp_path, monkeypatch, capsys):
    """They say which code they are of."""
    of_task = dict(episodes=5, seconds=20.0, randomize=True, device="cpu", impl="c")
    of_task |= {"return": 33.25, "return_std": 1.5, "length": 987.0, "fall_rate": 0.2}
    policy = policy_file.load(saved)
    named = policy_source.named(str(saved), saved)
    about = episodes.measured(policy.params, f"from/elsewhere/{named}") | {"commit": "old"}
    results(tmp_path, **about, episodes=of_task)
    monkeypatch.setattr(trials, "run", lambda *_, **__: (toy_sweep.numbers(), []))
    monkeypatch.setattr(changes, "run", lambda *_: toy_sweep.changes())
    monkeypatch.setattr(changes, "tours", lambda *_: [])
    monkeypatch.setattr(evaluate_command.figures, "write", lambda *_: "")
    shown = []
    monkeypatch.setattr(evaluate_command.report, "write", lambda *a: shown.append(a[-1]))
    expected = {"commit": "old", "mujoco": about["mujoco"]} | of_task
    for _ in range(2):
        assert run(saved, "--fast", f"--out={tmp_path}") == 0
        written = json.loads((tmp_path / "evaluation.json").read_text())
        assert written["episodes"] == expected == shown.pop() and written["commit"] != "old"
        assert f"keeps the 5 episodes of the training task that {tmp_path} holds" in "".join(
            capsys.readouterr().out.splitlines()
        )
    results(tmp_path, **about | {"policy_sha256": "b"}, episodes=of_task)
    assert run(saved, "--fast", f"--out={tmp_path}") == 0 and shown == [None]


def test_falls_are_named():
    """The first five, and how many more; the worst is one that stood."""
    numbers = toy_sweep.numbers()
    rows = numbers["commands"]
    turned = max(rows, key=lambda row: row["yaw_error"])
    x, y, turn = turned["command"]
    assert evaluate_tables.notes(numbers) == [
        "worst tracked: 0.43 m/s, asked for 1, 0 m/s, 1 rad/s",
        f"worst turned: {turned['yaw_error']:.2f} rad/s, asked for {x:g}, {y:g} m/s, {turn:g} rad/s",
        slow.line({"ahead": 0.3, "turning left": None}),
    ]
    fell = {tuple(row["command"]) for row in rows[-7:]}
    lines = evaluate_tables.notes(toy_sweep.numbers(fell))
    assert sum(line.startswith("fell after 1.5 s, asked for") for line in lines) == 5
    assert "fell on 2 other commands" in lines[5] and lines[6].startswith("worst tracked:")
    everything = toy_sweep.numbers({tuple(row["command"]) for row in rows})
    assert not any("worst" in line for line in evaluate_tables.notes(everything))
    assert evaluate_tables.notes(numbers | {"slow": {}}) == evaluate_tables.notes(numbers)[:-1]


@pytest.mark.slow  # test_house.py sees every import
def test_fast_needs_no_jax(saved, tmp_path):
    """`python -m dynappo.evaluate` and all it does with --fast, where JAX cannot be imported."""
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax" / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"""
import runpy, sys
from functools import partial
sys.path.insert(0, {str(tmp_path)!r})
from dynappo.evaluate import changes, trials
trials.run = partial(trials.run, seconds=0.1, points=2)
changes.EVERY = (0.02, 0.04)
runpy.run_module("dynappo.evaluate", run_name="__main__", alter_sys=True)
"""
    done = shell("-c", code, saved, "--fast", f"--out={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "evaluation.json").is_file()


def test_a_recording_is_one_file(tmp_path, monkeypatch, capsys):
    """Of the noise, seconds and seed that the flags say; the same again is the same."""
    monkeypatch.chdir(tmp_path)
    flags = "go1 --record=a.npz --seconds=11 --noise=0.1 --seed=3".split()
    assert run(*flags) == 0 and [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    assert capsys.readouterr().out.endswith("11 s, 0 falls, written to a.npz\n")
    player, _ = policy_source.player(policy_source.load("go1")[0])
    expected = recording.record(player, 11, 0.1, seed=3)
    with np.load("a.npz") as found:
        assert {*found.files} == {*expected, "about"}
        for name, array in expected.items():
            np.testing.assert_array_equal(found[name], array)


# ---- mistakes

MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "nothing to evaluate; name"),
    "unknown": (["wlk"], "wlk: no such file or folder; expected a workdir"),
    "no episodes": (["POLICY", "--episodes=0"], "--episodes='0': expected an integer of 1 or more"),
    "many": (["POLICY", "--episodes=1000000000"], "of 1 or more, at most 1,000,000"),
    "randomize": (
        ["POLICY", "--fast", "--randomize"],
        "--randomize is for the episodes of the task",
    ),
    "fast": (["POLICY", "--fast", "--episodes=9"], "--episodes is for the episodes of the task"),
    "seeded": (["POLICY", "--stress", "--seed=0"], "--seed is for the episodes of the task"),
    "a file": (["POLICY", "--fast", "--out=POLICY"], "cannot write there (File exists)"),
    "no policy": (["--fast", "CONFIG"], "config.json: not a policy.npz, or damaged"),
    "no robot": (["SPOT"], "spot"),
    "recorded": (["POLICY", "--record=a.txt"], "--record=a.txt: expected --record=FILE.npz"),
    "recorded with": (
        ["POLICY", "--record=a.npz", "--stress"],
        "--stress beside it: expected --rec",
    ),
    "recorded where": (["POLICY", "--record=POLICY/a.npz"], "cannot write there (File exists)"),
    "recorded over": (
        ["POLICY", "--record=POLICY"],
        "mover.npz: is there already; name a new file, or move it",
    ),
    "a short record": (["go1", "--record=a.npz", "--seconds=9"], "an integer of 10 or more"),
    "stress": (["POLICY", "--stress", "--fast"], "--stress: expected no --fast beside it"),
    "seconds": (
        ["POLICY", "--seconds=9"],
        "--seconds is for --record=FILE.npz, which is not there",
    ),
    "noise": (["POLICY", "--record=a.npz", "--noise=nan"], "--noise=nan: expected 0 to 10"),
    "play's command": (["POLICY", "--command=0.5,0,0"], "under one: "),
    "a clock": (
        ["g1", "--record=a.npz"],
        "g1's policy sees a gait clock, which a log does not hold",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(name, saved, tmp_path, monkeypatch, capsys):
    """Nothing is written, and nothing is computed before."""
    monkeypatch.chdir(tmp_path)
    Path("config.json").write_text("{}")
    spot = robot_lib.load("go1")._replace(name="spot", alone="")  # of before robots were carried
    policy_file.save(Path("spot.npz"), actor(), described()[0], spot)
    monkeypatch.setattr(trials, "run", None)
    arguments, expected = MISTAKES[name]
    places = {"POLICY": str(saved), "CONFIG": "config.json", "SPOT": "spot.npz"}
    filled = [re.sub("POLICY|CONFIG|SPOT", lambda m: places[m[0]], text) for text in arguments]
    assert expected in mistake(evaluate_command.main, filled, capsys)
    assert {path.name for path in tmp_path.iterdir()} == {"config.json", "spot.npz"}


def test_stopped_and_disk_full(saved, tmp_path, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(trials, "run", interrupt)
    assert run(saved, "--fast", f"--out={tmp_path}") == 130
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(trials, "run", lambda *_, **__: (toy_sweep.numbers(), []))
    monkeypatch.setattr(changes, "run", lambda *_: toy_sweep.changes())
    monkeypatch.setattr(changes, "tours", lambda *_: [])
    monkeypatch.setattr(evaluate_command.figures, "write", lambda *_: "")
    monkeypatch.setattr(evaluate_command.report, "write", interrupt)
    capsys.readouterr()
    assert run(saved, "--fast", f"--out={tmp_path}") == 130
    assert capsys.readouterr().err == "dynappo: stopped\n"
    assert not list(tmp_path.iterdir())  # no numbers beside the report of older ones
    monkeypatch.setattr(evaluate_command.report, "write", lambda *_: None)

    def full(path, value):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(evaluate_command.files, "write_json", full)
    assert run(saved, "--fast", f"--out={tmp_path}") == 1
    assert "evaluation.json cannot be read or written (No space left" in capsys.readouterr().err


def test_a_long_measurement_says_what_begins_and_how_far_it_is(monkeypatch):
    """Where no bar moves; of a short one only the first line."""
    for patience, more in ((0.0, "commands 1/3\ncommands 2/3\n"), (60.0, "")):
        monkeypatch.setattr(evaluate_tables, "PATIENCE", patience)
        text = io.StringIO()
        with evaluate_tables.progress(Console(file=text), "commands") as tell:
            assert text.getvalue() == "measures commands in C MuJoCo\n"
            for done in (1, 2, 3):
                tell(done, 3)
        assert text.getvalue() == "measures commands in C MuJoCo\n" + more


def test_a_log_of_another_packages_environment_is_refused_by_its_flag():
    policy = SimpleNamespace(config=SimpleNamespace(env="brax:hopper"))
    flags = SimpleNamespace(record=Path("a.npz"), fast=True)  # as --record sets both
    line = refused(task_episodes.check, policy, flags)
    assert line == "--record: the policy is of brax:hopper, which has its own episodes alone"

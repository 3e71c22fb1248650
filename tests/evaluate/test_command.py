"""The command `python -m dynappo.evaluate`: numbers, pictures, table, and every mistake."""

import json
import re
import types
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from test_console import shell
from test_play import actor, described, refused

from dynappo import config as config_lib
from dynappo import evaluation, train
from dynappo.evaluate import command as evaluate_command
from dynappo.evaluate import figures, trials
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file

FEET = ("FL", "FR", "RL", "RR")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The policy.npz of a Go1 that moves its legs a little."""
    path = tmp_path_factory.mktemp("saved") / "mover.npz"
    policy_file.save(path, actor(), *described())
    return path


@pytest.fixture(scope="module")
def policy(saved):
    return policy_file.load(saved)


@pytest.fixture
def short(monkeypatch):
    """Sweeps of 3 x 3 commands and 1.2 s."""
    monkeypatch.setattr(trials, "sweep", partial(trials.sweep, seconds=1.2, points=3))


def run(*arguments):
    """The exit status of the command."""
    try:
        evaluate_command.main([str(a) for a in arguments])
    except SystemExit as stop:
        return stop.code
    return 0


def foot(duty=0.5):
    return {"duty_factor": duty, "air_time": 0.2, "stride_frequency": 2.5}


def numbers_of(fallen=(), speeds=(0.5, 1.0)):
    """A sweep whose errors say which command they belong to: 0.1 + x/100 + y/1000 + yaw/500."""
    grid = {"vx": [-1.0, 0.0, 0.5, 1.0], "vy": [-0.5, 0.0, 0.5], "wz": [-1.0, 0.0, 1.0]}
    cells = [(x, y, 0.0) for x in grid["vx"] for y in grid["vy"]]
    cells += [(x, 0.0, turn) for x in grid["vx"] for turn in grid["wz"]]
    names = [name for name, *_ in evaluate_command.ROWS]
    rows = [
        dict.fromkeys(names, 1.0)
        | {
            "command": [x, y, turn],
            "fall": 1.5 if (x, y, turn) in fallen else None,
            "tracking_error": 0.3 + x / 10 + y / 25 + turn / 30,
            "yaw_error": 0.1 + x / 50,
        }
        for x, y, turn in dict.fromkeys(cells)
    ]
    gait = foot() | {"feet": {name: foot(0.2 + j / 10) for j, name in enumerate(FEET)}}
    ahead = [rows[0] | gait | {"command": [speed, 0.0, 0.0], "speed": speed} for speed in speeds]
    every = dict.fromkeys(names, 2.0) | gait | {"episodes": len(rows), "falls": len(fallen)}
    held = {"vy": 0.0, "wz": 0.0}
    return dict(seconds=6.0, axes=grid, held=held, all=every, ahead=ahead, commands=rows)


# ---- the pictures


def test_every_cell_of_the_maps_shows_its_command():
    """Colour and both numbers; a fall is said, and has no colour."""
    fell = {(-1.0, 0.5, 0.0), (0.5, 0.0, -1.0)}
    numbers = numbers_of(fell)
    panels = figures.tracking("go1", numbers).axes[:2]
    labels = [text.get_text() for text in panels[0].get_yticklabels()]
    assert labels == ["-1", "0", "0.5", "1"]
    for panel, axis in zip(panels, ("vy", "wz"), strict=True):
        across, ahead = numbers["axes"][axis], numbers["axes"]["vx"]
        assert [t.get_text() for t in panel.get_xticklabels()] == [f"{v:g}" for v in across]
        colors = panel.images[0].get_array().filled(np.nan)
        assert colors.shape == (4, 3) and panel.get_ylim()[0] < panel.get_ylim()[1]
        told = {}
        for text in panel.texts:
            x, y = text.get_position()
            told.setdefault((round(y), round(x)), []).append(text.get_text())
        for i, x in enumerate(ahead):
            for j, other in enumerate(across):
                y, turn = (other, 0.0) if axis == "vy" else (0.0, other)
                error = 0.3 + x / 10 + y / 25 + turn / 30
                if (x, y, turn) in fell:
                    assert told[i, j] == ["fell after\n1.5 s"] and np.isnan(colors[i, j])
                else:
                    assert colors[i, j] == pytest.approx(error)
                    assert told[i, j] == [f"{error:.2f}", f"{0.1 + x / 50:.2f}"]


def test_the_colours_begin_at_zero_and_end_at_the_largest_error():
    image = figures.tracking("go1", numbers_of()).axes[0].images[0]
    worst = max(row["tracking_error"] for row in numbers_of()["commands"])
    assert image.get_clim() == (0, pytest.approx(worst))


def test_the_bars_of_a_gait_are_the_contacts_of_its_last_two_seconds():
    """Every bar against a loop over the raw contacts, of a long and of a short episode."""
    rng = np.random.default_rng(0)
    recordings = [{"contact": np.repeat(rng.random((n, 4)) < 0.5, 20, 0)} for n in (40, 9)]
    panels, count = figures.gait("go1", numbers_of(), recordings, 0.005).axes, 0
    for panel, recording in zip(panels, recordings, strict=True):
        shown = recording["contact"][-400:]
        for j, name in enumerate(FEET):
            bars, begun = [], None
            for p, down in enumerate([*shown[:, j], False]):
                if down and begun is None:
                    begun = p
                if not down and begun is not None:
                    bars.append([begun * 0.005, p * 0.005])
                    begun = None
            paths = panel.collections[2 * j + 1].get_paths()
            drawn = [[path.vertices[:, 0].min(), path.vertices[:, 0].max()] for path in paths]
            np.testing.assert_allclose(drawn, bars)
            heights = [path.vertices[:, 1].mean() for path in paths]
            np.testing.assert_allclose(heights, j, atol=0.2)
            count += len(bars)
            assert panel.get_yticklabels()[j].get_text() == name
            assert f"{0.2 + j / 10:.2f}" in [text.get_text() for text in panel.texts]
    assert count > 20
    titles = [panel.get_title("left") for panel in panels]
    assert "asked for 0.5 m/s" in titles[0] and "asked for 1 m/s" in titles[1]
    assert all("2.50 strides/s" in title and "duty factor 0.50" in title for title in titles)


def test_no_pictures_without_matplotlib(tmp_path, monkeypatch):
    """The reason is one line, and nothing is written."""
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    problem = figures.write(tmp_path, "go1", numbers_of(), [], 0.005)
    assert problem == figures.NO_PICTURES and not list(tmp_path.iterdir())


# ---- the episodes of the task


def test_the_settings_are_those_of_training(policy):
    """Every field as it was, but for the device; newer fields have their defaults."""
    trained = config_lib.validate(config_lib.load("configs/go1.py")).to_dict()
    found = evaluate_command.settings(policy).to_dict()
    assert found == trained
    other = policy_file.describe(*described("anymal_d"))
    found = evaluate_command.settings(other).to_dict()
    assert found == config_lib.validate(config_lib.load("configs/anymal_d.py")).to_dict()
    old = json.loads(json.dumps(trained))
    old["run"]["device"], old["physics"]["impl"] = "gpu", "warp"
    old["task"]["kp"] = 33.0
    del old["run"]["video_seconds"], old["task"]["push"], old["model"]
    old["task"]["no_longer_there"] = 1
    found = evaluate_command.settings(policy._replace(config=old)).to_dict()
    trained["task"]["kp"] = 33.0
    assert found == trained


@pytest.mark.parametrize(
    "field, value", [("kp", "stiff"), ("command_x", [1.0]), ("formulation", "mine")]
)
def test_a_config_that_does_not_fit_is_one_line(policy, field, value):
    damaged = json.loads(json.dumps(policy.config))
    damaged["task"][field] = value
    assert f"task.{field}" in refused(evaluate_command.settings, policy._replace(config=damaged))


def test_episodes_evaluates_the_policy_on_its_task(policy, monkeypatch):
    """What `evaluation.evaluate` gets, and what is handed on; NaN is None."""
    import jax

    got = {}

    def spy(env, task, params, key, **options):
        got.update(env=env, task=task, params=params, key=key, **options)
        import jax.numpy as jnp

        return {"return": jnp.float32(3.5), "tracking_error": jnp.float32(jnp.nan)}

    monkeypatch.setattr(evaluation, "evaluate", spy)
    lone = policy._replace(params={"actor": policy.params["actor"]})
    found = evaluate_command.episodes(lone, 7, randomize=True, seed=3)
    assert (got["num_envs"], got["num_steps"], got["randomize"]) == (7, 1000, True)
    assert got["static"].ppo.hidden == (128, 128, 128) and got["env"].action_size == 12
    assert got["params"]["std"].shape == (12,)
    assert got["params"]["actor"].keys() == policy.params["actor"].keys()
    assert (
        got["task"]._fields == config_lib.split(evaluate_command.settings(policy))[1].task._fields
    )
    assert found == {
        "episodes": 7,
        "seconds": 20.0,
        "randomize": True,
        "seed": 3,
        "device": jax.devices()[0].device_kind,
        "impl": train.choose_impl(evaluate_command.settings(policy)),
        "return": 3.5,
        "tracking_error": None,
    }
    default = {"gpu": 1000, "cpu": 64}[jax.default_backend()]
    assert evaluate_command.episodes(policy)["episodes"] == default and got["randomize"] is False


@pytest.mark.slow
def test_a_robot_that_stands_is_evaluated_on_mjx(policy):
    """Two seconds of the real task: nobody falls, and the error is the command's size."""
    import jax

    from dynappo.task import env as env_lib

    config = json.loads(json.dumps(policy.config))
    config["task"]["episode_length"] = 100
    stands = policy._replace(config=config, params=actor(size=0.0, hidden=(128, 128, 128)))
    found = evaluate_command.episodes(stands, 4, seed=5)
    settings = evaluate_command.settings(stands)
    env = env_lib.make(robot_lib.load("go1"), settings.task, settings.physics)
    task = evaluation.nominal(config_lib.split(settings)[1].task)
    command = np.array(
        [
            env.reset(task, env.randomize(task, key), key).command
            for key in jax.random.split(jax.random.key(5), 4)
        ]
    )
    assert (found["episodes"], found["fall_rate"], found["length"]) == (4, 0, 100)
    expected = np.sqrt((command[:, :2] ** 2).sum(1).mean())
    assert found["tracking_error"] == pytest.approx(expected, abs=0.05)
    assert found["yaw_error"] == pytest.approx(np.sqrt((command[:, 2] ** 2).mean()), abs=0.05)


# ---- the command


def test_the_command_writes_what_it_prints(saved, tmp_path, monkeypatch, capsys, short):
    """Numbers of C MuJoCo and of MJX in one JSON; each is in the table; two pictures."""
    monkeypatch.chdir(tmp_path)
    on_mjx = dict(episodes=5, seconds=20.0, randomize=True, seed=0, device="cpu", impl="jax")
    on_mjx |= {"return": 33.25, "return_std": 1.5, "length": 987.0, "fall_rate": 0.2}
    on_mjx |= {"tracking_error": 0.12, "yaw_error": None}
    calls = []
    monkeypatch.setattr(evaluate_command, "episodes", lambda *a: calls.append(a[1:]) or on_mjx)
    assert run(saved, "--episodes=5", "--randomize") == 0
    assert calls == [(5, True, 0)]
    lines = capsys.readouterr().out.splitlines()
    out = tmp_path / "evaluation-mover"
    assert lines[0] == f"dynappo evaluates go1: {saved.parent.name}/mover.npz"
    assert lines[-1] == "written to evaluation-mover: evaluation.json, tracking.png, gait.png"
    written = json.loads((out / "evaluation.json").read_text())
    assert written["episodes"] == on_mjx and written["robot"] == "go1"
    assert {path.name for path in out.iterdir()} == {"evaluation.json", "tracking.png", "gait.png"}
    for name in ("tracking.png", "gait.png"):
        assert (out / name).read_bytes()[:4] == b"\x89PNG" and (out / name).stat().st_size > 20_000
    told = {}
    for line in lines:  # the table of the sweep comes first
        told.setdefault(line[:24].strip(), re.split(r"\s{2,}", line[24:].strip()))
    sweep = written["sweep"]
    for name, label, text in evaluate_command.ROWS:
        columns = [sweep["all"], *sweep["ahead"]]
        expected = ["-" if c[name] is None else text.format(c[name]) for c in columns]
        assert told[label.strip()] == expected, label
    text = "\n".join(lines)
    for part in ("33.25", "1.50", "20.0 %", "987 control steps", "nobody stood for a second"):
        assert part in text, part
    assert "noise, pushes, randomised physics; MJX-JAX on cpu" in text
    assert set(written["units"]) <= set(on_mjx) | set(sweep["commands"][0]) | set(sweep["all"])


def test_the_evaluation_of_a_workdir_is_in_it(saved, tmp_path, monkeypatch, capsys, short):
    """Without MJX; where there are files of an earlier one, they are replaced."""
    monkeypatch.setattr(evaluate_command, "episodes", None)
    (tmp_path / "config.json").write_text(config_lib.to_json(described()[0]))
    (tmp_path / "policy.npz").write_bytes(saved.read_bytes())
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "evaluation" / "evaluation.json").write_text("old")
    assert run(tmp_path, "--fast") == 0
    written = json.loads((tmp_path / "evaluation" / "evaluation.json").read_text())
    assert written["episodes"] is None and written["sweep"]["seconds"] == 1.2
    assert "MJX" not in capsys.readouterr().out


def test_where_an_evaluation_goes(tmp_path):
    """Into the workdir, also of a checkpoint; else beside where one is, by name."""
    (tmp_path / "config.json").touch()
    checkpoint = tmp_path / "checkpoints" / "100"
    checkpoint.mkdir(parents=True)
    assert (
        evaluate_command.folder(str(tmp_path), tmp_path / "policy.npz") == tmp_path / "evaluation"
    )
    assert evaluate_command.folder(str(tmp_path), checkpoint) == tmp_path / "evaluation"
    assert evaluate_command.folder("go1", Path("robots/go1/policy.npz")) == Path("evaluation-go1")
    assert evaluate_command.folder("a/best.npz", Path("a/best.npz")) == Path("evaluation-best")


def test_falls_are_named():
    """The first five, and how many more; the worst is one that stood."""
    rows = numbers_of()["commands"]
    turned = max(rows, key=lambda row: row["yaw_error"])
    x, y, turn = turned["command"]
    assert evaluate_command.notes(rows) == [
        "worst tracked: 0.43 m/s, asked for 1, 0 m/s, 1 rad/s",
        f"worst turned: {turned['yaw_error']:.2f} rad/s, asked for {x:g}, {y:g} m/s, {turn:g} rad/s",
    ]
    fell = {tuple(row["command"]) for row in rows[-7:]}
    lines = evaluate_command.notes(numbers_of(fell)["commands"])
    assert sum(line.startswith("fell after 1.5 s, asked for") for line in lines) == 5
    assert "fell on 2 other commands" in lines[5] and lines[6].startswith("worst tracked:")
    everything = {tuple(row["command"]) for row in rows}
    assert not any(
        "worst" in line for line in evaluate_command.notes(numbers_of(everything)["commands"])
    )


MISTAKES = {
    "nothing": ([], "nothing to evaluate is named"),
    "unknown": (["wlk"], "wlk: no such file or folder; expected a workdir"),
    "two names": (["POLICY", "go2"], "go2: no such flag"),
    "a flag": (["POLICY", "--quick"], "--quick: no such flag"),
    "no episodes": (["POLICY", "--episodes=0"], "--episodes='0': expected an integer of 1 or more"),
    "half": (["POLICY", "--episodes=1.5"], "--episodes='1.5': expected an integer"),
    "a seed": (["POLICY", "--seed=-1"], "--seed='-1': expected an integer of 0 or more"),
    "no value": (["POLICY", "--out"], "--out: expected one argument; write it as --flag=VALUE"),
    "randomize": (["POLICY", "--fast", "--randomize"], "--randomize is for the episodes on MJX"),
    "fast": (["POLICY", "--fast", "--episodes=9"], "--episodes is for the episodes on MJX"),
    "seeded": (["POLICY", "--fast", "--seed=0"], "--seed is for the episodes on MJX"),
    "a file": (["POLICY", "--fast", "--out=POLICY"], "cannot write there (File exists)"),
    "below it": (["POLICY", "--fast", "--out=POLICY/a"], "cannot write there (Not a directory)"),
    "no policy": (["--fast", "CONFIG"], "config.json: not a policy.npz, or damaged"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_every_mistake_is_one_line_and_status_2(name, saved, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("config.json").write_text("{}")
    monkeypatch.setattr(trials, "sweep", None)
    arguments, said = MISTAKES[name]
    places = {"POLICY": str(saved), "CONFIG": "config.json"}
    filled = [re.sub("POLICY|CONFIG", lambda m: places[m[0]], text) for text in arguments]
    assert run(*filled) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("dynappo: ") and said in captured.err
    assert captured.err.count("\n") == 1 and not captured.out
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_a_policy_of_a_robot_that_is_not_here_is_one_line(saved, tmp_path, capsys):
    path = tmp_path / "policy.npz"
    robot = robot_lib.load("go1")._replace(name="spot")
    policy_file.save(path, actor(), described()[0], robot)
    assert run(path, "--fast", f"--out={tmp_path}/out") == 2
    said = capsys.readouterr().err
    assert "spot" in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


def test_stopped_and_disk_full(saved, tmp_path, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(trials, "sweep", interrupt)
    assert run(saved, "--fast", f"--out={tmp_path}") == 130
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(trials, "sweep", lambda *_, **__: (numbers_of(), []))

    def full(path, value):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(evaluate_command, "log", types.SimpleNamespace(write_json=full))
    assert run(saved, "--fast", f"--out={tmp_path}") == 1
    assert "evaluation.json cannot be written (No space left" in capsys.readouterr().err


def test_fast_needs_no_jax(saved, tmp_path):
    """`python -m dynappo.evaluate` and all it does with --fast, where JAX cannot be imported."""
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax" / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"""
import runpy, sys
from functools import partial
sys.path.insert(0, {str(tmp_path)!r})
from dynappo.evaluate import trials
trials.sweep = partial(trials.sweep, seconds=0.1, points=2)
sys.argv = ["evaluate", {str(saved)!r}, "--fast", "--out={tmp_path}/out"]
runpy.run_module("dynappo.evaluate", run_name="__main__", alter_sys=True)
"""
    done = shell("-c", code)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "evaluation.json").is_file()
    helped = shell("-m", "dynappo.evaluate", "--help")
    assert helped.returncode == 0 and "--randomize" in helped.stdout

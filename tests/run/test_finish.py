"""What a run leaves: the summary, the policy of the best seed, the picture and the film or why not."""

import json
import sys
import time
from types import SimpleNamespace

import jax
import ml_collections
import numpy as np
import pytest
import workdirs
from toy_policy import params_in
from toy_runs import assert_same
from workdirs import N_REAL

from dynappo.config import shell, versions
from dynappo.policy import render
from dynappo.run import finish, learning_curves


def test_a_run_fills_its_folder(whole):
    """Settings, metrics, summary, policy, curves, events and checkpoints; no temporary file."""
    names = {p.name for p in whole.workdir.iterdir()} - {"lock"}
    events = {name for name in names if name.startswith("events.")}
    expected = "config.json metrics.csv summary.json policy.npz curves.png checkpoints".split()
    assert len(events) == 2 and names - events == set(expected)
    assert [name.endswith(".final") for name in sorted(events)] == [False, True]
    assert workdirs.steps(whole.workdir) == {"2", "4"}


def test_the_summary_says_what_the_run_came_to(whole):
    """Return over the last rows, cost, evaluation, machine and versions."""
    text = whole.files["summary.json"].decode()
    summary = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert summary["robot"] == "go1" and summary["num_envs"] == 16
    assert summary["iterations"] == 4 and summary["sim_steps"] == 16 * sum(N_REAL)
    returns = whole.metrics["episode_return"]
    assert summary["return"] == pytest.approx(returns.mean(), rel=1e-4)
    assert summary["return_max"] == pytest.approx(returns.max(), rel=1e-4)
    ended, total = (whole.metrics[n].sum() for n in ("episodes", "episode_return_sum"))
    assert ended > 0 and summary["return_of_all"] == pytest.approx(total / ended, rel=1e-4)
    assert summary["seconds"] == pytest.approx(whole.metrics["seconds"][-1], rel=1e-4)
    assert summary["compile_seconds"] > 0 and summary["impl"] == "jax"
    assert (
        summary["evaluation_seconds"] > 0 and "video_seconds" not in summary
    )  # no film was asked for
    size = sum(x.nbytes for x in jax.tree.leaves((whole.state.env_state, whole.state.learner)))
    assert summary["bytes_needed"] > size
    assert {"dynappo", "jax", "mujoco-mjx"} <= summary["versions"].keys()
    assert (summary["commit"] is None) == (versions.commit() is None)
    evaluation = summary["evaluation"]
    assert evaluation.keys() == {"return", "return_std", "length", "fall_rate", "tracking_error"}
    assert 0 <= evaluation["fall_rate"] <= 1 and 1 <= evaluation["length"] <= 20


def test_the_policy_is_in_a_plain_file(whole):
    """policy.npz holds the last parameters to the bit, and how far the run was."""
    with np.load(whole.workdir / "policy.npz") as file:
        found = file["trained/iteration"].item(), file["trained/sim_steps"].item()
    assert found == (4, 16 * sum(N_REAL))
    params = params_in(whole.workdir / "policy.npz")
    assert_same(params, jax.device_get(whole.state.learner.params))


def test_an_iteration_without_an_ended_episode_does_not_hide_the_others(config):
    program = SimpleNamespace(compile_seconds=1.0, bytes_needed=1, device="cpu", impl="c")
    metrics = dict(episode_return=np.array([np.nan, 0.01, np.nan]), episodes=np.array([0, 1, 0]))
    metrics |= dict(episode_return_sum=0.01 * metrics["episodes"], n_real=np.full(3, 5))
    metrics |= dict(iteration=np.arange(1, 4), sim_steps=80 * np.arange(1, 4), seconds=np.ones(3))
    metrics |= dict(blowups=np.zeros(3))
    summary = finish.summarise(config, program, metrics, {})
    assert summary["return"] == summary["return_max"] == 0.01


@pytest.mark.parametrize("seeds", [None, 2])
def test_the_return_of_all_is_that_of_the_episodes_of_the_last_episodes_length(config, seeds):
    """20 control steps are 4 iterations of 5; against a loop back from the end. Without any: none."""
    rng, shape = np.random.default_rng(0), (20, seeds) if seeds else (20,)
    count, total = rng.integers(0, 3, shape), rng.normal(size=shape)
    n_real = np.full(20, 8)
    n_real[-3:] = 5  # and one of 8
    metrics = {"n_real": n_real, "episodes": count, "episode_return_sum": total * (count > 0)}
    steps, ended, returns = 0, 0, 0.0
    for i in reversed(range(20)):
        if steps < 20:
            steps, ended = steps + n_real[i], ended + count[i]
            returns = returns + metrics["episode_return_sum"][i]
    assert config.task.episode_length == 20 and steps == 23
    np.testing.assert_allclose(finish._return_of_all(config, metrics), returns / ended, rtol=1e-6)
    metrics["episodes"] = 0 * count
    assert np.isnan(finish._return_of_all(config, metrics)).all()


# ---- several seeds


@pytest.mark.parametrize(
    ("at_the_end", "on_the_way", "best"),
    [
        ([1.0, 3.0], None, 1),
        ([3.0, 1.0], [1.0, 3.0], 0),  # the last one counts
        (None, [1.0, 3.0], 1),
        ([np.nan, -7.0], None, 1),
        (None, None, 0),
        ([3.0, 1.0, 0.25, 0.75], None, 1),  # on tiles, of which the second crosses more
    ],
)
def test_the_policy_of_the_best_seed_is_that_of_the_best_evaluation(
    program, whole, tmp_path, at_the_end, on_the_way, best, monkeypatch
):
    """Whatever the training episodes say: they favour the other one."""
    at_the_end, crossed = (at_the_end or [])[:2], (at_the_end or [])[2:]
    monkeypatch.setattr(learning_curves, "draw", lambda *_: "no picture")
    seeds = workdirs.config(run__num_seeds=2)
    state = jax.tree.map(lambda x: jax.numpy.stack([x, x]), whole.state)
    params = jax.tree.map(lambda x: np.stack([x[0], x[1] + 1]), state.learner.params)
    state = state.replace(learner=state.learner.replace(params=params))
    shared = ("iteration", "n_real", "n_synthetic", "sim_steps", "seconds")
    metrics = {
        name: column if name in shared else np.stack([column, column], 1)
        for name, column in whole.metrics.items()
    }
    metrics["episode_return"] = metrics["episode_return"] + [10 * best, 10 * (1 - best)]
    if on_the_way:
        metrics["eval_return"] = np.array([[np.nan] * 2, on_the_way, [np.nan] * 2, [np.nan] * 2])
    evaluation = {"return": np.array(at_the_end)} if at_the_end else {}
    evaluation |= {"crossed": np.array(crossed)} if crossed else {}
    run = workdirs.open_run(seeds, tmp_path, metrics)
    summary = finish.finish(run, program(), state, evaluation)
    kept = params_in(tmp_path / "policy.npz")
    assert_same(kept, jax.tree.map(lambda x: x[best], params))
    assert len(summary["return"]) == len(summary["return_max"]) == 2
    if at_the_end:
        none = [None if np.isnan(x) else x for x in at_the_end]
        assert json.loads((tmp_path / "summary.json").read_text())["evaluation"]["return"] == none


# ---- pictures


def test_there_is_a_film_or_the_reason(program, whole, tmp_path, monkeypatch):
    """The summary says which; without matplotlib too."""
    filmed = workdirs.config(run__video_seconds=0.1)
    run = workdirs.open_run(filmed, tmp_path, whole.metrics)
    monkeypatch.setattr(render, "simulate", lambda *_: time.sleep(0.05))
    for problem in ("", "no video: no OpenGL"):
        monkeypatch.setattr(render, "film", lambda *_, problem=problem: problem)
        summary = finish.finish(run, program(), whole.state, {})
        assert summary["video"] == (problem or str(tmp_path / "video.mp4"))
        assert 0.05 < summary["video_seconds"] < 60 and "evaluation_seconds" not in summary
        assert summary["curves"] == str(tmp_path / "curves.png") and "playable" not in summary

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(render, "film", interrupted)
    (tmp_path / "summary.json").unlink()
    with pytest.raises(KeyboardInterrupt):
        finish.finish(run, program(), whole.state, {"return": np.array(40.0)})
    kept = json.loads((tmp_path / "summary.json").read_text())
    assert kept["evaluation"] == {"return": 40.0} and "video" not in kept

    def full(*_):
        raise OSError("cannot write video.mp4 (No space left on device)")

    monkeypatch.setattr(render, "film", full)
    summary = finish.finish(run, program(), whole.state, {})
    assert summary["video"] == "no video: cannot write video.mp4 (No space left on device)"
    assert "playable" not in summary

    def blown_up(*_):
        raise FloatingPointError("its physics has blown up")

    monkeypatch.setattr(render, "simulate", blown_up)
    summary = finish.finish(run, program(), whole.state, {})
    assert summary["video"] == "no video: its physics has blown up"
    written = json.loads((tmp_path / "summary.json").read_text())
    assert summary["playable"] is written["playable"] is False
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    summary = finish.finish(run, program(), whole.state, {})
    assert summary["curves"].endswith(shell.install("video"))


@pytest.mark.parametrize(
    ("robot", "env", "title"),
    [
        ("go1", "", "go1: {} robots"),
        ("", "brax:hopper", "brax:hopper: {} copies"),
        ("", "", "my_run: {} copies"),
    ],
)
def test_the_curves_say_of_what_they_are(robot, env, title, program, whole, tmp_path, monkeypatch):
    """An environment of one's own has no name but its folder's."""
    config, titles = ml_collections.ConfigDict(workdirs.config(run__video_seconds=0)), []
    config.robot, config.env = robot, env
    (tmp_path / "my_run").mkdir()
    monkeypatch.setattr(
        finish.learning_curves, "draw", lambda metrics, path, title: titles.append(title) or ""
    )
    run = workdirs.open_run(config, tmp_path / "my_run", whole.metrics)
    finish.finish(run, program(), whole.state, {})
    assert titles == [title.format(config.rollout.num_envs)]


def test_a_film_of_an_earlier_policy_is_told(program, whole, tmp_path):
    said, film = [], tmp_path / "video.mp4"
    run = workdirs.open_run(workdirs.config(run__video_seconds=0), tmp_path, whole.metrics)
    finish.finish(run, program(), whole.state, {}, said.append)
    assert said == []
    film.touch()
    summary = finish.finish(run, program(), whole.state, {}, said.append)
    assert said == [f"{film} is of an earlier end of this run"]
    assert "video" not in summary


# ---- in the logs too


def logged(path):
    """`{tag: value}` of the one event in a file of TensorBoard's, and its step."""
    from tensorboardX.proto.event_pb2 import Event

    data, found, at = path.read_bytes(), [], 0
    while at < len(data):  # a record: length, its checksum, the event, its checksum
        size = int.from_bytes(data[at : at + 8], "little")
        found.append(Event.FromString(data[at + 12 : at + 12 + size]))
        at += size + 16
    (event,) = [event for event in found if event.summary.value]
    return {value.tag: value for value in event.summary.value}, event.step


def test_tensorboard_has_the_last_evaluation_and_the_curves(whole):
    """The numbers of summary.json, at the last iteration; the picture is the file's own bytes."""
    (path,) = whole.workdir.glob("events.*.final")
    values, step = logged(path)
    evaluation = json.loads(whole.files["summary.json"])["evaluation"]
    assert step == 4 and set(values) == {f"final/{name}" for name in [*evaluation, "curves"]}
    for name, number in evaluation.items():
        assert values[f"final/{name}"].simple_value == pytest.approx(number)
    picture = values["final/curves"].image
    assert picture.encoded_image_string == whole.files["curves.png"]
    assert (picture.width, picture.height) == (1800, 1125)  # 12 x 7.5 inches of 150 dots


def test_seeds_are_apart_and_what_is_not_finite_is_left_out():
    summary = {"evaluation": {"return": [1.0, None, 3.0], "length": [5.0, 6.0, 7.0]}}
    assert finish.final(summary) == {
        "final/return/seed0": 1.0,
        "final/return/seed2": 3.0,
        **{f"final/length/seed{s}": 5.0 + s for s in range(3)},
    }
    assert finish.final({"evaluation": {"return": 2.5}}) == {"final/return": 2.5}
    assert finish.final({}) == {}


@pytest.mark.parametrize("there", [True, False])
def test_weights_and_biases_has_them_and_the_film(tmp_path, monkeypatch, there):
    """A stand-in for the library; the run is that of the workdir, and is finished."""
    calls = []
    run = SimpleNamespace(log=calls.append, finish=lambda: calls.append("finished"))
    fake = SimpleNamespace(
        init=lambda **options: calls.append(options["id"]) or run,
        Image=lambda path: ("image", path),
        Video=lambda path, format: ("video", path, format),
        __spec__=object(),
    )
    monkeypatch.setitem(sys.modules, "wandb", fake)
    (tmp_path / "wandb_id").write_text("abcd")
    curves, film = str(tmp_path / "curves.png"), str(tmp_path / "video.mp4")
    summary = {
        "evaluation": {"return": 2.5},
        "curves": "no curves.png: ...",
        "video": "no video: ...",
    }
    summary |= {"curves": curves, "video": film} if there else {}
    finish.to_wandb(workdirs.config(run__wandb="walking"), tmp_path, summary)
    expected = {"final/return": 2.5}
    if there:
        expected |= {"final/curves": ("image", curves), "final/film": ("video", film, "mp4")}
    assert calls == ["abcd", expected, "finished"]


def test_logs_that_fail_are_told_and_the_run_ends_well(program, whole, tmp_path, monkeypatch):
    """An account that is gone, and a disk that is full: a line each; summary.json is there before."""

    def fail(error):
        assert (tmp_path / "summary.json").exists()
        raise error

    fake = SimpleNamespace(
        init=lambda **_: fail(RuntimeError("no account\nat all")), __spec__=object()
    )
    monkeypatch.setitem(sys.modules, "wandb", fake)
    monkeypatch.setattr(learning_curves, "draw", lambda *_: "no picture")
    full = OSError(28, "No space left on device")
    monkeypatch.setattr("tensorboardX.event_file_writer.EventsWriter", lambda *_, **__: fail(full))
    config, said = workdirs.config(run__wandb="walking"), []
    run = workdirs.open_run(config, tmp_path, whole.metrics)
    finish.finish(run, program(), whole.state, {}, said.append)
    assert said == [
        "TensorBoard's events could not be written (No space left on device); all else is there",
        "Weights & Biases could not be written (no account); all else is there",
    ]

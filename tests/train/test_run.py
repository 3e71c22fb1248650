"""A whole run on the Go1, tiny: what it writes, and that it goes on where it was stopped."""

import csv
import errno
import fcntl
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo import schedule, train
from dynappo.config import ConfigError, versions
from dynappo.policy import policy_file, render
from dynappo.train import checkpoint, finish, log
from dynappo.train import command as train_command
from dynappo.train import workdir as workdir_lib

FLAGS = [
    "--config=configs/go1.py:quick",
    "--config.rollout.num_envs=16",
    "--config.rollout.horizon=4",
    "--config.schedule.start_iteration=0",
    "--config.schedule.end_iteration=4",  # tails of 0, 1, 1 and 1 rows
    "--config.schedule.end_steps=1",
    "--config.model.hidden=(16,16)",
    "--config.model.minibatches=2",
    "--config.ppo.hidden=(16,16)",
    "--config.task.episode_length=60",  # the first second, which evaluation leaves out, is 50
    "--config.run.num_iterations=4",
    "--config.run.log_every=2",
    "--config.run.checkpoint_every=2",
    "--config.run.eval_envs=2",
    "--config.run.video_seconds=0.2",
]
N_REAL = [4, 3, 3, 3]


@pytest.fixture(scope="module")
def config():
    """The tiny config, as the command line makes it."""
    return train_command.parse(FLAGS).config


class Run:
    """A finished run: its folder, what `train` returned and what it told `progress_fn`."""

    def __init__(self, config, workdir):
        self.workdir, self.told = workdir, []
        self.state, self.metrics = train.train(
            config, workdir, lambda iteration, last: self.told.append((iteration, last))
        )
        self.files = {p.name: p.read_bytes() for p in workdir.iterdir() if p.is_file()}


@pytest.fixture(scope="module")
def whole(config, tmp_path_factory):
    """The run without interruption."""
    return Run(config, tmp_path_factory.mktemp("whole") / "deep" / "run")


@pytest.fixture(scope="module")
def program(config, whole):
    """`program()`: the same run once more, compiled and ready to start."""
    once = train.setup(config)
    return lambda: once._replace(state=jax.tree.map(lambda x: x.copy(), once.state))


def table(path):
    """The rows of a metrics.csv as they stand there, but for the seconds."""
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def assert_same(one, other):
    """Two states are equal to the bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for (path, x), y in zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True):
        if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        np.testing.assert_array_equal(x, y, jax.tree_util.keystr(path))


def opened(workdir, config, **how):
    """The folder of a run, opened and let go of."""
    with workdir_lib.open_workdir(workdir, config, **how) as path:
        return path


def everything(folder):
    """What is in a folder, with the bytes and the time of every file."""
    return {
        p.relative_to(folder): (p.read_bytes(), p.stat().st_mtime_ns) if p.is_file() else None
        for p in folder.rglob("*")
    }


def other_hash(step):
    """Makes the arrays of the checkpoint `step` others than those that were saved."""
    path = step / "about" / "metadata"
    about = json.loads(path.read_text())
    path.write_text(json.dumps(about | {"sha256": about["sha256"][::-1]}))


# ---- what a run leaves


def test_a_run_fills_its_folder(whole):
    """Settings, metrics, summary, policy and checkpoints; no temporary file."""
    expected = {
        "config.json",
        "metrics.csv",
        "summary.json",
        "policy.npz",
        "curves.png",
        "checkpoints",
    }
    names = {p.name for p in whole.workdir.iterdir()}
    events = {name for name in names if name.startswith("events.")}
    assert len(events) == 1 and names - {"video.mp4"} - events == expected
    steps = {p.name for p in (whole.workdir / "checkpoints").iterdir()}
    assert steps == {"2", "4"}


def test_the_settings_are_kept(whole, config):
    """config.json holds every field, resolved."""
    kept = json.loads(whole.files["config.json"])
    assert kept == json.loads(config_lib.to_json(config))
    assert kept["rollout"]["num_envs"] == 16 and kept["task"]["air_time"] == "touchdown"


def test_metrics_have_one_row_an_iteration_and_every_documented_column(whole, config):
    """Also a column for every term of the reward; counts are whole numbers."""
    rows = table(whole.workdir / "metrics.csv")
    assert [row["iteration"] for row in rows] == ["1", "2", "3", "4"]
    with (whole.workdir / "metrics.csv").open() as file:
        header = file.readline().strip().split(",")
    documented = (
        "iteration sim_steps seconds episode_return episode_length policy_std learning_rate kl "
        "n_real n_synthetic model_loss"
    ).split()
    assert header[: len(documented)] == documented
    terms = {f"reward_{name}" for name in config.task.weights}
    others = {"velocity_error", "yaw_error", "falls", "timeouts", "blowups", "value_loss"}
    assert terms | others <= set(header) and len(header) == len(set(header))
    for row in rows:
        for name, value in row.items():
            if not name.startswith("episode_"):
                assert np.isfinite(float(value)), name


def test_simulator_steps_are_exact(whole):
    """16 robots times the real rows of the schedule, cumulative."""
    rows = table(whole.workdir / "metrics.csv")
    assert [int(row["n_real"]) for row in rows] == N_REAL
    assert [int(row["n_synthetic"]) for row in rows] == [4 - n for n in N_REAL]
    assert [int(row["sim_steps"]) for row in rows] == list(16 * np.cumsum(N_REAL))
    seconds = whole.metrics["seconds"]
    assert (np.diff(seconds) > 0).all() and seconds[0] > 0


def test_the_file_holds_what_train_returns(whole):
    """The metrics of every iteration, to six digits."""
    back = log.read_csv(whole.workdir / "metrics.csv")
    assert back.keys() == whole.metrics.keys()
    for name, column in whole.metrics.items():
        assert column.shape == (4,)
        np.testing.assert_allclose(back[name], column, 1e-5, err_msg=name)


def test_progress_is_told_every_chunk(whole):
    """`progress_fn(iteration, metrics)` with numbers of that iteration."""
    assert [iteration for iteration, _ in whole.told] == [2, 4]
    for iteration, last in whole.told:
        for name, column in whole.metrics.items():
            np.testing.assert_array_equal(last[name], column[iteration - 1], name)


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
    assert {"dynappo", "jax", "mujoco-mjx"} <= summary["versions"].keys()
    assert summary["commit"] == versions.commit()
    evaluation = summary["evaluation"]
    names = {"return", "return_std", "length", "fall_rate", "tracking_error", "yaw_error"}
    assert evaluation.keys() == names
    assert 0 <= evaluation["fall_rate"] <= 1 and 1 <= evaluation["length"] <= 60


@pytest.mark.parametrize("seeds", [None, 2])
def test_the_return_of_all_is_that_of_the_episodes_of_the_last_episodes_length(config, seeds):
    """60 control steps are 12 iterations of 5; against a loop back from the end. Without any: none."""
    rng, shape = np.random.default_rng(0), (20, seeds) if seeds else (20,)
    count, total = rng.integers(0, 3, shape), rng.normal(size=shape)
    n_real = np.full(20, 5)
    n_real[:10] = 8  # 10 iterations of 5, and two of 8
    metrics = {"n_real": n_real, "episodes": count, "episode_return_sum": total * (count > 0)}
    steps, ended, returns = 0, 0, 0.0
    for i in reversed(range(20)):
        if steps < 60:
            steps, ended = steps + n_real[i], ended + count[i]
            returns = returns + metrics["episode_return_sum"][i]
    assert config.task.episode_length == 60 and steps == 66
    np.testing.assert_allclose(finish._return_of_all(config, metrics), returns / ended, rtol=1e-6)
    metrics["episodes"] = 0 * count
    assert np.isnan(finish._return_of_all(config, metrics)).all()


def test_the_policy_is_in_a_plain_file(whole, config):
    """policy.npz holds the last parameters to the bit, and acts with NumPy alone."""
    params = render.load_params(whole.workdir / "policy.npz")
    assert_same(params, jax.device_get(whole.state.learner.params))
    action = render.policy(params, config.ppo.activation)(np.zeros(48))
    assert action.shape == (12,) and np.isfinite(action).all()


def test_there_is_a_film_or_the_reason(whole):
    """video.mp4, or the line that names the package; the summary says which."""
    said = json.loads(whole.files["summary.json"])["video"]
    if "video.mp4" in whole.files:
        assert said == str(whole.workdir / "video.mp4") and len(whole.files["video.mp4"]) > 1000
    else:
        assert said in (render.NO_OPENGL, render.NO_FFMPEG)


def test_the_last_checkpoint_is_the_state_that_train_returns(whole):
    """To the bit, with the key; what `play` and others start from."""
    manager = checkpoint.manager(whole.workdir)
    iteration, state = checkpoint.restore(manager, whole.state)
    manager.close()
    assert iteration == 4
    assert_same(state, whole.state)


# ---- resuming


def test_the_same_command_again_trains_no_more(whole, tmp_path, capsys, monkeypatch):
    """The finished run is shown once more: the same metrics, policy and summary, status 0."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    train_command.main([*FLAGS, f"--workdir={workdir}"])
    out, err = capsys.readouterr()
    assert "trains go1: 16 robots, 4 rows" in out and "return (last 10 iterations)" in out
    assert f"the run in {workdir} is complete (4 iterations)" in out and err == ""
    assert "it is only evaluated and filmed again" in out
    assert (workdir / "metrics.csv").read_bytes() == whole.files["metrics.csv"]
    assert_same(*(render.load_params(w / "policy.npz") for w in (workdir, whole.workdir)))
    before, after = (json.loads((w / "summary.json").read_text()) for w in (whole.workdir, workdir))
    for name in ("return", "return_max", "seconds"):
        assert after[name] == pytest.approx(before[name], rel=1e-5)
    for name in ("iterations", "sim_steps", "evaluation"):
        assert after[name] == before[name]


def wait_for(path, seconds=60):
    """Returns once `path` exists."""
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, f"no {path.name}"
        time.sleep(0.02)


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(config, program, whole, tmp_path):
    """Stopped after two iterations and resumed: every bit of state and every row is the same."""
    workdir = opened(tmp_path / "run", config)

    def stop(iteration, last):
        assert iteration == 2
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.loop(config, program(), workdir, stop)
    wait_for(workdir / "checkpoints" / "2")
    assert table(workdir / "metrics.csv") == table(whole.workdir / "metrics.csv")[:2]
    told, said = [], []
    state, metrics = train.loop(
        config, program(), workdir, lambda i, last: told.append(i), say=said.append
    )
    assert told == [4] and said == [f"goes on from iteration 2 of {workdir}"]
    assert_same(state, whole.state)
    assert table(workdir / "metrics.csv") == table(whole.workdir / "metrics.csv")
    for name, column in whole.metrics.items():
        if name != "seconds":
            np.testing.assert_array_equal(metrics[name][2:], column[2:], name)
            np.testing.assert_allclose(metrics[name][:2], column[:2], 1e-5, err_msg=name)
    assert (np.diff(metrics["seconds"]) > 0).all()


def test_rows_after_the_last_checkpoint_are_written_anew(config, program, whole, tmp_path):
    """A run killed between its rows and their checkpoint repeats these rows, once."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    shutil.rmtree(workdir / "checkpoints" / "4")
    told = []
    state, _ = train.loop(config, program(), workdir, lambda i, last: told.append(i))
    assert told == [4]
    assert_same(state, whole.state)
    assert table(workdir / "metrics.csv") == table(whole.workdir / "metrics.csv")


def test_a_run_killed_before_its_first_checkpoint_starts_again(config, program, whole, tmp_path):
    """Rows without a checkpoint are nothing to go on from."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    shutil.rmtree(workdir / "checkpoints")
    state, _ = train.loop(config, program(), workdir)
    assert_same(state, whole.state)
    assert table(workdir / "metrics.csv") == table(whole.workdir / "metrics.csv")


def test_checkpoints_without_their_metrics_are_refused(config, program, whole, tmp_path):
    """Somebody removed metrics.csv: one line that says so, no traceback."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    (workdir / "metrics.csv").unlink()
    with pytest.raises(ConfigError) as error:
        train.loop(config, program(), workdir)
    assert "metrics.csv" in str(error.value) and "\n" not in str(error.value)


def test_a_folder_of_another_config_is_refused(whole, tmp_path):
    """The message names the field and both values; nothing in the folder changes."""
    other = train_command.parse([*FLAGS, "--config.ppo.clip_epsilon=0.3"]).config
    with pytest.raises(ConfigError, match=r"ppo\.clip_epsilon 0\.2 there, 0\.3 here") as error:
        train.train(other, whole.workdir)
    assert str(whole.workdir) in str(error.value) and "\n" not in str(error.value)
    assert (whole.workdir / "config.json").read_bytes() == whole.files["config.json"]


def test_without_a_folder_nothing_is_written(config, program, whole, tmp_path, monkeypatch):
    """In a notebook: the same numbers, no file, nobody told."""
    monkeypatch.chdir(tmp_path)
    state, metrics = train.loop(config, program(), None)
    assert_same(state, whole.state)
    np.testing.assert_array_equal(metrics["episode_return"], whole.metrics["episode_return"])
    assert list(tmp_path.iterdir()) == []


# ---- numbers that blow up


def poisoned(program, place):
    """The program with a NaN, or an absurd learning rate, at `place`."""
    h, state = program.hyper, program.state
    if place == "model":
        h = h._replace(model=h.model._replace(learning_rate=np.float32(1e30)))
    elif place == "policy":
        h = h._replace(ppo=h.ppo._replace(value_coef=np.float32(np.nan)))
    elif place == "reward":
        weights = h.task.weights._replace(action_rate=np.float32(np.nan))
        h = h._replace(task=h.task._replace(weights=weights))
    elif place == "moments":  # a parameter, not a loss: found in the state
        inputs = state.model.targets.replace(weight=jnp.float32(np.inf))
        state = state.replace(model=state.model.replace(targets=inputs))
    return program._replace(hyper=h, state=state)


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("model", "model_loss is not finite in iteration 1"),
        ("policy", "(value|surrogate)_loss is not finite in iteration 1"),
        ("reward", "reward_action_rate is not finite in iteration 1"),
        ("moments", "model.*is not finite in iteration 2"),
    ],
)
def test_a_training_that_blows_up_names_the_first_bad_number(
    config, program, tmp_path, place, name
):
    """No row of NaN is written, no checkpoint of it is kept; a bad robot is there for replay."""
    bad = poisoned(program(), place)
    with pytest.raises(FloatingPointError, match=name) as error:
        train.loop(config, bad, tmp_path)
    assert "\n" not in str(error.value) and "lower ppo.learning_rate" in str(error.value).lower()
    assert not (tmp_path / "metrics.csv").exists()
    assert not list((tmp_path / "checkpoints").iterdir())
    dumped = tmp_path / "nonfinite.npz"
    assert dumped.exists() == (place == "reward")
    if place == "reward":
        found = np.load(dumped)
        assert f"robot {found['robot']}, as it was before, is in {dumped}" in str(error.value)
        assert found["env_state/qpos"].shape == (19,) and np.isfinite(found["env_state/qpos"]).all()
        start = program().state
        np.testing.assert_array_equal(found["env_state/qpos"], start.env_state.qpos[found["robot"]])
        assert found["params_physics/base_com"].shape == (3,)


def test_a_robot_that_physics_cannot_compute_is_counted_and_training_goes_on(config, program):
    """NaN in the speed of one robot: its episode ends, the numbers of all others are as they were."""
    run = program()
    qvel = run.state.env_state.qvel.at[3, 8].set(np.nan)
    broken = run.state.replace(env_state=run.state.env_state.replace(qvel=qvel))
    state, metrics = train.loop(config, run._replace(state=broken), None)
    assert metrics["blowups"][0] == 1 and metrics["blowups"][1:].sum() == 0
    assert np.isfinite(state.env_state.qvel).all()
    assert log.nonfinite_leaf(state.learner) is None


# ---- files that cannot be written, and signals


def test_a_full_disk_is_told_and_training_goes_on(config, program, whole, tmp_path, monkeypatch):
    """Checkpoint 2 and the first rows cannot be written: later ones are, and no row is lost."""
    said, failing = [], [checkpoint.save, log._append]
    full = OSError(errno.ENOSPC, "No space left on device")

    def save(checkpoints, iteration, *args, **about):
        if iteration == 2:
            raise full
        return failing[0](checkpoints, iteration, *args, **about)

    def append(path, names, table, header):
        if len(table) == 2:  # of the first chunk; the second time there are four
            raise full
        return failing[1](path, names, table, header)

    monkeypatch.setattr(checkpoint, "save", save)
    monkeypatch.setattr(log, "_append", append)
    state, _ = train.loop(config, program(), tmp_path, say=said.append)
    assert_same(state, whole.state)
    assert [line.split(" could")[0] for line in said] == ["checkpoint 2", "metrics.csv"]
    assert all("No space left on device" in line and "\n" not in line for line in said)
    assert table(tmp_path / "metrics.csv") == table(whole.workdir / "metrics.csv")
    assert {p.name for p in (tmp_path / "checkpoints").iterdir()} == {"4"}


def test_a_run_that_is_asked_to_stop_saves_and_returns(config, program, whole, tmp_path):
    """Between two chunks, also where no checkpoint is due; it goes on as if never stopped."""
    seldom = config_dict.ConfigDict(config)
    seldom.run.checkpoint_every = 4
    workdir = opened(tmp_path / "run", config)
    state, metrics = train.loop(seldom, program(), workdir, should_stop=lambda: True)
    assert list(metrics["iteration"]) == [1, 2]
    assert {p.name for p in (workdir / "checkpoints").iterdir()} == {"2"}
    assert (workdir / "policy.npz").exists()
    state, _ = train.loop(config, program(), workdir)
    assert_same(state, whole.state)


def test_the_first_signal_asks_the_second_interrupts():
    """Ctrl-C or SIGTERM while the loop runs; before it, at once."""
    with train_command.Stop() as _, pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    stop = train_command.Stop()
    with stop:
        stop.patient = True
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        assert stop.status == 143
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
    assert stop.status == 130


def test_evaluations_on_the_way_are_columns_of_the_metrics(config, program, tmp_path):
    """Every `run.eval_every` iterations; empty in the rows between."""
    often = config_dict.ConfigDict(config)
    often.run.eval_every = 4
    worth = iter([{"return": np.float32(3.5), "fall_rate": np.float32(0.25)}])
    run = program()._replace(assess=lambda state: next(worth))
    told = []
    _, metrics = train.loop(often, run, tmp_path, lambda i, last: told.append(last))
    np.testing.assert_array_equal(metrics["eval_return"], [np.nan, np.nan, np.nan, 3.5])
    assert "eval_return" not in told[0] and told[1]["eval_fall_rate"] == 0.25
    cells = [row["eval_return"] for row in table(tmp_path / "metrics.csv")]
    assert cells == ["", "", "", "3.5"]


def test_the_time_of_each_phase_is_measured_if_asked(config, program):
    """On the run's own program; physics is most of it with a model this small."""
    ask = config_dict.ConfigDict(config)
    ask.run.update(time_phases=True, eval_envs=0)
    run = program()
    names = "iteration sim_steps seconds episode_return n_real episodes episode_return_sum"
    metrics = {n: np.ones(4) for n in names.split()}
    summary = finish.summarise(ask, run, run.state, metrics)
    assert summary["phases_ms"].keys() == {"iteration", "physics", "tail", "fit", "ppo"}
    assert 0 < summary["phases_ms"]["physics"] < summary["phases_ms"]["iteration"]


# ---- damaged and foreign checkpoints, other runs' weights


def test_a_damaged_checkpoint_is_moved_aside_and_the_one_before_is_taken(
    config, program, whole, tmp_path
):
    """Bits are flipped in the data; often orbax reads it without complaint."""
    workdir, said = tmp_path / "run", []
    shutil.copytree(whole.workdir, workdir)
    for path in (workdir / "checkpoints" / "4" / "state").rglob("*"):
        if path.parent.name == "d":  # some of the bytes are of no array
            data = bytearray(path.read_bytes())
            data[len(data) // 4 :: 256] = bytes(b ^ 1 for b in data[len(data) // 4 :: 256])
            path.write_bytes(data)
    state, _ = train.loop(config, program(), workdir, say=said.append)
    assert_same(state, whole.state)
    assert "checkpoint 4 is damaged" in said[0]
    assert said[1:] == [f"goes on from iteration 2 of {workdir}"]
    assert (workdir / "damaged-4").is_dir() and (workdir / "checkpoints" / "4").is_dir()


def test_where_every_checkpoint_is_damaged_the_run_says_so(config, program, whole, tmp_path):
    """Nothing is deleted and nothing starts over by itself."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    for step in ("2", "4"):
        shutil.rmtree(workdir / "checkpoints" / step / "state" / "d")
    for _ in range(2):
        with pytest.raises(ConfigError, match="no checkpoint can be read.*--fresh") as error:
            train.loop(config, program(), workdir)
        assert "\n" not in str(error.value)
    assert {"damaged-2", "damaged-4", "metrics.csv"} <= {p.name for p in workdir.iterdir()}


def test_a_checkpoint_of_another_shape_names_what_differs(whole):
    """The first array that differs, with both shapes."""
    manager = checkpoint.manager(whole.workdir)
    std = whole.state.learner.params | {"std": jnp.zeros(7)}
    other = whole.state.replace(learner=whole.state.learner.replace(params=std))
    with pytest.raises(ConfigError) as error:
        checkpoint.restore(manager, other)
    manager.close()
    assert "learner/params/std is float32[12] there, float32[7] here" in str(error.value)


def test_what_a_checkpoint_says_about_itself(whole, config):
    """Iteration, exact simulator steps, the config, and a hash that the arrays have."""
    about = json.loads((whole.workdir / "checkpoints" / "4" / "about" / "metadata").read_text())
    assert about["iteration"] == 4 and about["sim_steps"] == 16 * sum(N_REAL)
    assert about["config"]["rollout"]["num_envs"] == 16
    assert about["sha256"] == checkpoint.digest(whole.state)


def test_another_run_starts_from_the_networks(program, whole):
    """Policy, value function, model and its moments are that run's; all else is new."""
    fresh = program().state
    state = checkpoint.weights(whole.workdir, fresh)
    assert_same(state.learner.params, whole.state.learner.params)
    for part in ("params", "inputs", "targets"):
        assert_same(getattr(state.model, part), getattr(whole.state.model, part))
    assert_same(state.learner.opt_state, fresh.learner.opt_state)
    assert_same(state.env_state, fresh.env_state)
    plain = checkpoint.weights(whole.workdir, fresh.replace(model=None))
    assert plain.model is None
    assert_same(plain.learner.params, whole.state.learner.params)


def test_networks_of_another_size_or_none_are_refused(program, whole, tmp_path):
    """One line with the flag, what was found and what was expected."""
    fresh = program().state
    wide = fresh.learner.params | {"std": jnp.zeros(13)}
    other = fresh.replace(learner=fresh.learner.replace(params=wide))
    with pytest.raises(ConfigError, match=r"--restore=.*std is of shape \(12,\) there, .*\(13,\)"):
        checkpoint.weights(whole.workdir, other)
    with pytest.raises(ConfigError, match="no checkpoints/ there"):
        checkpoint.weights(tmp_path, fresh)


def test_the_run_that_another_starts_from_is_only_read(program, whole, tmp_path):
    """A save of it that is in progress stays, so does a damaged checkpoint; the one before is taken."""
    other, said = tmp_path / "other", []
    shutil.copytree(whole.workdir, other)
    folder = other / "checkpoints"
    shutil.copytree(folder / "4", folder / "6.orbax-checkpoint-tmp-0")
    shutil.copytree(folder / "4", folder / "6")
    (folder / "6" / "metrics" / "metrics").write_text("{")
    shutil.rmtree(folder / "6" / "state" / "d")
    shutil.copytree(folder / "4", folder / "5")
    other_hash(folder / "5")
    before = everything(other)
    state = checkpoint.weights(other, program().state, said.append)
    assert_same(state.learner.params, whole.state.learner.params)
    assert everything(other) == before
    assert [line.split(":")[0] for line in said] == [str(folder / "6"), str(folder / "5")]
    assert all(line.endswith("checkpoint 4 is taken") and "\n" not in line for line in said)
    assert "its numbers are not those that were saved" in said[1]
    for step in ("2", "4"):
        other_hash(folder / step)
    with pytest.raises(ConfigError, match="none of its 4 checkpoints can be read") as error:
        checkpoint.weights(other, program().state)
    assert "\n" not in str(error.value) and f"--restore={other}" in str(error.value)


def test_a_policy_is_not_read_from_a_checkpoint_with_other_numbers(whole, tmp_path):
    """By the hash of all arrays, as a run that goes on finds it."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    step = workdir / "checkpoints" / "4"
    params = jax.device_get(whole.state.learner.params)
    assert_same(policy_file.find(str(step))[0].params, params)
    other_hash(step)
    with pytest.raises(ConfigError, match=r"4: .* damaged \(its numbers are not those"):
        policy_file.find(str(step))


# ---- the folder


def test_a_folder_is_one_runs_at_a_time(config, tmp_path):
    """The line names the process; `fresh` moves nothing away; an end of any kind lets go."""
    workdir = tmp_path / "run"
    who = rf"in this folder \(pid {os.getpid()} on {socket.gethostname()}\); wait for it, or take"
    with pytest.raises(RuntimeError), workdir_lib.open_workdir(workdir, config):
        for fresh in (False, True):
            with pytest.raises(ConfigError, match=who) as error:
                opened(workdir, config, fresh=fresh)
            assert "\n" not in str(error.value) and f"--workdir={workdir}" in str(error.value)
        assert [p.name for p in tmp_path.iterdir()] == ["run"]
        assert {p.name for p in workdir.iterdir()} == {"config.json", "lock"}
        raise RuntimeError
    for fresh in (False, True, False):
        opened(workdir, config, fresh=fresh)
    for folder in tmp_path.iterdir():
        assert {p.name for p in folder.iterdir()} == {"config.json"}


def test_a_lock_that_a_killed_run_left_holds_nobody_up(config, tmp_path):
    """The file is there, nobody holds it."""
    (tmp_path / "lock").write_text("pid 1 on a machine far away, with a long name\n")
    with workdir_lib.open_workdir(tmp_path, config):
        assert (tmp_path / "lock").read_text() == f"pid {os.getpid()} on {socket.gethostname()}\n"


def test_a_lock_that_was_taken_away_meanwhile_is_taken_anew(config, tmp_path, monkeypatch):
    """Its run ended between the opening of the file and the locking: another could make a new one."""
    (tmp_path / "lock").write_text("")
    flock, removed = fcntl.flock, []

    def late(file, how):
        if not removed:
            removed.append((tmp_path / "lock").unlink())
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with (
        workdir_lib.open_workdir(tmp_path, config),
        pytest.raises(ConfigError, match="another run is writing"),
    ):
        opened(tmp_path, config)


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP, errno.EIO])
def test_a_file_system_without_locks_is_used_without(config, tmp_path, monkeypatch, number):
    """Any other error is one that the folder has."""

    def flock(file, how):
        raise OSError(number, "no")

    monkeypatch.setattr(fcntl, "flock", flock)
    if number == errno.EIO:
        with pytest.raises(ConfigError, match=r"cannot write there \(no\)"):
            opened(tmp_path, config)
    else:
        opened(tmp_path, config)
        assert (tmp_path / "config.json").exists()


def test_train_holds_its_folder_until_it_ends(config, tmp_path, monkeypatch):
    """Also where it is interrupted; then the next call in the same process trains there."""
    ends = []

    def setup(*_):
        with pytest.raises(ConfigError, match="another run is writing"):
            opened(tmp_path, config)
        ends.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "setup", setup)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            train.train(config, tmp_path)
    assert len(ends) == 2 and {p.name for p in tmp_path.iterdir()} == {"config.json"}


@pytest.mark.parametrize("begun", ["checkpoints/2", "damaged-2", "metrics.csv"])
def test_a_folder_in_which_nothing_was_computed_takes_another_config(config, tmp_path, begun):
    """After ctrl-C while it compiled; from the first checkpoint or row on it is a run."""
    other = train_command.parse([*FLAGS, "--config.ppo.clip_epsilon=0.3"]).config
    opened(tmp_path, other)
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "metrics.csv").write_text("iteration,seconds\n")
    opened(tmp_path, config)
    assert json.loads((tmp_path / "config.json").read_text())["ppo"]["clip_epsilon"] == 0.2
    if begun == "metrics.csv":
        (tmp_path / begun).write_text("iteration,seconds\n1,2\n")
    else:
        (tmp_path / begun).mkdir()
    with pytest.raises(ConfigError, match=r"ppo\.clip_epsilon 0\.2 there, 0\.3 here"):
        opened(tmp_path, other)


def test_fresh_moves_the_old_run_aside(config, whole, tmp_path):
    """Twice; nothing of either is lost."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    for number in (1, 2):
        opened(workdir, config, fresh=True)
        assert {p.name for p in workdir.iterdir()} == {"config.json"}
        assert (tmp_path / f"run.old-{number}" / "config.json").exists()
    assert (tmp_path / "run.old-1" / "metrics.csv").read_bytes() == whole.files["metrics.csv"]


def test_a_finished_run_can_be_made_longer(config, program, whole, tmp_path):
    """Only what does not change the iterations before may differ; fewer than are done is refused."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    longer = train_command.parse(
        [*FLAGS, "--config.run.num_iterations=6", "--config.run.eval_envs=3"]
    )
    opened(workdir, longer.config)
    columns = schedule.columns(longer.config)
    told = []
    train.loop(
        longer.config, program()._replace(columns=columns), workdir, lambda i, last: told.append(i)
    )
    assert told == [6]
    rows = table(workdir / "metrics.csv")
    assert [row["iteration"] for row in rows] == ["1", "2", "3", "4", "5", "6"]
    assert rows[:4] == table(whole.workdir / "metrics.csv")
    kept = (workdir / "config.json").read_bytes()
    with pytest.raises(ConfigError, match="num_iterations is 4, .* has done 6"):
        opened(workdir, config)  # before anything is compiled
    assert (workdir / "config.json").read_bytes() == kept


def test_a_float_can_be_changed_without_compiling(program, config):
    """Another learning rate goes into the same program and gives another policy."""
    run = program()
    hyper = run.hyper._replace(ppo=run.hyper.ppo._replace(clip_epsilon=0.05))
    one, _ = train.loop(config, program(), None)
    other, _ = train.loop(config, run._replace(hyper=hyper), None)
    one, other = (s.learner.params["actor"]["params"]["Dense_0"]["kernel"] for s in (one, other))
    assert np.abs(one - other).max() > 1e-6


# ---- several seeds, and a run killed by others


@pytest.mark.slow
def test_several_seeds_train_at_once(config, whole, tmp_path):
    """A row an iteration and seed; the first seed is the run alone, and the run resumes."""
    flags = [*FLAGS, "--config.run.num_seeds=2"]
    config = train_command.parse(flags).config
    state, metrics = train.train(config, tmp_path / "run")
    rows = table(tmp_path / "run" / "metrics.csv")
    assert [(row["iteration"], row["seed"]) for row in rows] == [
        (str(i), str(s)) for i in (1, 2, 3, 4) for s in (0, 1)
    ]
    assert [int(row["sim_steps"]) for row in rows[::2]] == list(16 * np.cumsum(N_REAL))
    assert metrics["episode_return"].shape == (4, 2) and metrics["sim_steps"].shape == (4,)
    returns = metrics["episode_return"]
    np.testing.assert_allclose(returns[:, 0], whole.metrics["episode_return"], 1e-3, 1e-3)
    assert (returns[:, 0] != returns[:, 1]).all()
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert len(summary["return"]) == len(summary["evaluation"]["return"]) == 2
    best = int(np.argmax(returns.mean(0)))
    params = render.load_params(tmp_path / "run" / "policy.npz")
    assert_same(params, jax.device_get(jax.tree.map(lambda x: x[best], state.learner.params)))
    again, back = train.train(config, tmp_path / "run")
    assert_same(again, state)
    np.testing.assert_allclose(back["episode_return"], returns, 1e-5)


@pytest.mark.slow
def test_a_run_can_be_killed_at_any_moment(tmp_path):
    """kill -9, ctrl-C, SIGTERM, and at last to the end: every iteration is there once, none is lost."""
    workdir = tmp_path / "run"
    flags = [*FLAGS, "--config.run.num_iterations=300", "--config.run.video_seconds=0.0"]
    command = [sys.executable, "-m", "dynappo.train", *flags, f"--workdir={workdir}"]
    root = os.path.dirname(os.path.dirname(train.__file__))

    def start():
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=root, stdout=pipe, stderr=pipe, text=True)

    def last():
        path = workdir / "metrics.csv"
        lines = path.read_text().splitlines() if path.exists() else []
        return int(lines[-1].split(",")[0]) if len(lines) > 1 else 0

    reached = 0
    kinds = {signal.SIGKILL: -signal.SIGKILL, signal.SIGINT: 130, signal.SIGTERM: 143}
    for kind, status in kinds.items():
        run = start()
        while last() < reached + 20:
            assert run.poll() is None, run.communicate()
            time.sleep(0.01)
        run.send_signal(kind)
        _, err = run.communicate(timeout=60)
        assert run.returncode == status
        reached = last()
        saved = max(int(p.name) for p in (workdir / "checkpoints").iterdir() if p.name.isdigit())
        assert saved >= reached - 4
        if kind != signal.SIGKILL:
            assert (
                err == f"dynappo: saved at iteration {saved} and stopped; {train_command.GOES_ON}\n"
            )
            assert saved == reached
    out, err = start().communicate(timeout=300)
    assert err == "" and "return (last 10 iterations)" in out
    # and as if nothing had happened: every number of every row, every bit of the last state
    never = tmp_path / "never"
    subprocess.run([*command[:-1], f"--workdir={never}"], cwd=root, check=True, timeout=300)
    assert table(workdir / "metrics.csv") == table(never / "metrics.csv")
    hashes = [
        json.loads((w / "checkpoints" / "300" / "about" / "metadata").read_text())["sha256"]
        for w in (workdir, never)
    ]
    assert hashes[0] == hashes[1]
    rows = table(workdir / "metrics.csv")
    assert [int(row["iteration"]) for row in rows] == list(range(1, 301))
    real = [int(row["n_real"]) for row in rows]
    assert [int(row["sim_steps"]) for row in rows] == list(16 * np.cumsum(real))

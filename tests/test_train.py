"""A whole run on the Go1, tiny: what it writes, and that it goes on where it was stopped."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

from dynappo import checkpoint, console, log, render, train
from dynappo import config as config_lib
from dynappo.config import ConfigError

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
    return console.parse(FLAGS)[0]


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


# ---- what a run leaves


def test_a_run_fills_its_folder(whole):
    """Settings, metrics, summary, policy and checkpoints; no temporary file."""
    expected = {"config.json", "metrics.csv", "summary.json", "policy.npz", "checkpoints"}
    names = {p.name for p in whole.workdir.iterdir()}
    assert names - {"video.mp4"} == expected
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
    assert summary["seconds"] == pytest.approx(whole.metrics["seconds"][-1], rel=1e-4)
    assert summary["compile_seconds"] > 0 and summary["impl"] == "jax"
    assert {"dynappo", "jax", "mujoco-mjx"} <= summary["versions"].keys()
    evaluation = summary["evaluation"]
    names = {"return", "return_std", "length", "fall_rate", "tracking_error", "yaw_error"}
    assert evaluation.keys() == names
    assert 0 <= evaluation["fall_rate"] <= 1 and 1 <= evaluation["length"] <= 60


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
    console.main([*FLAGS, f"--workdir={workdir}"])
    out, err = capsys.readouterr()
    assert "trains go1: 16 robots, 4 rows" in out and "return (last 10 iterations)" in out
    assert str(workdir) in out and err == ""
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
    workdir = train.open_workdir(tmp_path / "run", config)

    def stop(iteration, last):
        assert iteration == 2
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.loop(config, program(), workdir, stop)
    wait_for(workdir / "checkpoints" / "2")
    assert table(workdir / "metrics.csv") == table(whole.workdir / "metrics.csv")[:2]
    told = []
    state, metrics = train.loop(config, program(), workdir, lambda i, last: told.append(i))
    assert told == [4]
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
    other = console.parse([*FLAGS, "--config.ppo.clip_epsilon=0.3"])[0]
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


def test_a_training_that_blows_up_says_so(config, program, tmp_path):
    """FloatingPointError with the number, the iteration and what to change; no row of NaN."""
    wild = program()
    hyper = wild.hyper._replace(model=wild.hyper.model._replace(learning_rate=np.float32(1e30)))
    with pytest.raises(FloatingPointError, match="after iteration [24]: .* lower ppo.learning"):
        train.loop(config, wild._replace(hyper=hyper), tmp_path)
    if (tmp_path / "metrics.csv").exists():
        assert all("nan" not in row.values() for row in table(tmp_path / "metrics.csv"))


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
    config = console.parse(flags)[0]
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
    """kill -9, ctrl-C, and at last to the end: every iteration is there once, none is lost."""
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
    for kind, status in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
        run = start()
        while last() < reached + 20:
            assert run.poll() is None, run.communicate()
            time.sleep(0.01)
        run.send_signal(kind)
        _, err = run.communicate(timeout=60)
        assert run.returncode == status
        if kind == signal.SIGINT:
            assert err.count("\n") == 1 and "the same command goes on" in err
        reached = last()
        saved = max(int(p.name) for p in (workdir / "checkpoints").iterdir() if p.name.isdigit())
        assert saved >= reached - 4
    out, err = start().communicate(timeout=300)
    assert err == "" and "return (last 10 iterations)" in out
    rows = table(workdir / "metrics.csv")
    assert [int(row["iteration"]) for row in rows] == list(range(1, 301))
    real = [int(row["n_real"]) for row in rows]
    assert [int(row["sim_steps"]) for row in rows] == list(16 * np.cumsum(real))

"""docs/environment.md: its example, straight out of the page, trains by the command and acts."""

import contextlib
import csv
import json
import re
from pathlib import Path

import jax
import numpy as np
import pytest
import workdirs
from answers import ROOT, mistake, status

from dynappo import algorithm
from dynappo import config as config_lib
from dynappo.bench import command as bench
from dynappo.evaluate import command as evaluate
from dynappo.export import command as export
from dynappo.play import command as play
from dynappo.policy import checkpoint_file, policy_file
from dynappo.program import build, devices
from dynappo.train import command as train

PAGE = (ROOT / "docs" / "environment.md").read_text()
SHORT = """
--config.rollout.num_envs=16 --config.run.log_every=2 --config.ppo.hidden=(16,16)
--config.model.hidden=(16,16) --config.model.epochs=1 --config.run.eval_envs=64
--config.schedule.end_iteration=4
""".split()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the page's pendulum.py, and a short run of it."""
    folder = tmp_path_factory.mktemp("user")
    code = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    assert len(code) == 1 and len(code[0].split("\n")) < 75  # a page
    (folder / "pendulum.py").write_text(code[0])
    with pytest.MonkeyPatch.context() as patch:
        # a run that goes on has the program of the run before
        patch.setattr(build, "program", workdirs.compiled_once(build.program))
        patch.setattr(devices, "own_process", lambda device: None)
        with contextlib.chdir(folder):
            assert run(4) == 0
        yield folder


@pytest.fixture(autouse=True)
def inside(folder, monkeypatch):
    """Each test works where the user does."""
    monkeypatch.chdir(folder)


def run(iterations, *more):
    return status(
        train.main,
        "--config=pendulum.py",
        *SHORT,
        f"--config.run.num_iterations={iterations}",
        *more,
    )


def test_the_example_trains_and_leaves_what_every_run_does(folder):
    """Rows, checkpoints, curves, evaluation; the config says that it is no robot's."""
    workdir = folder / "runs" / "pendulum"
    names = {path.name for path in workdir.iterdir()}
    assert {"config.json", "metrics.csv", "summary.json", "policy.npz", "checkpoints"} <= names
    summary = json.loads((workdir / "summary.json").read_text())
    assert (
        summary["robot"] == ""
        and summary["impl"] == "own"
        and summary["sim_steps"] == 16 * (14 + 12 + 10 + 8)
    )
    assert -20 < summary["evaluation"]["return"] < 10 and summary["evaluation"]["fall_rate"] == 0
    assert "video" not in summary and summary["evaluation"]["length"] == 200
    with (workdir / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["n_synthetic"] for row in rows] == ["2", "4", "6", "8"]
    assert all(float(row["model_error_1"]) > 0 for row in rows)


def test_the_same_command_goes_on_and_tells_what_comes_out(capsys):
    """Four more iterations, from the checkpoint; then how to act with it."""
    assert run(8) == 0
    said = capsys.readouterr().out
    assert "trains an environment of your own: 16 copies, rollouts of 16 rows" in said
    assert "goes on from iteration 4 of runs/pendulum" in said and "cpu, JAX; compiled" in said
    assert "load_actor('runs/pendulum/policy.npz') acts" in said and "m/s" not in said


def test_the_policy_acts_as_it_was_evaluated():
    """The pendulum in NumPy from the evaluation's starts, by `load_actor`: the return of summary.json."""
    act = policy_file.load_actor("runs/pendulum/policy.npz")
    key = jax.random.fold_in(jax.random.key(0), algorithm.EPISODES)
    keys = jax.random.split(jax.random.split(key, 3)[1], 64)
    draw = jax.vmap(lambda key: jax.random.uniform(key, (), minval=-np.pi, maxval=np.pi))
    angle, speed, total = np.asarray(draw(keys), float), np.zeros(64), np.zeros(64)
    for _ in range(200):
        action = act(np.stack([np.cos(angle), np.sin(angle), speed / 8], -1))[:, 0]
        torque = 2 * np.clip(action, -1, 1)
        total += 0.05 * (np.cos(angle) - 0.02 * speed**2 - 0.002 * torque**2)
        speed = np.clip(speed + 0.05 * (15 * np.sin(angle) + 3 * torque), -8, 8)
        angle = angle + 0.05 * speed
    with open("runs/pendulum/summary.json") as file:
        assert abs(json.load(file)["evaluation"]["return"] - total.mean()) < 0.05


def test_what_needs_a_robot_says_in_one_line_that_it_is_none(capsys):
    """Of a workdir and of a checkpoint; nothing is written."""
    (newest, *_) = checkpoint_file.iterations(Path("runs/pendulum/checkpoints"))
    for what in ("runs/pendulum", f"runs/pendulum/checkpoints/{newest}"):
        for main, more in ((play, ["--out=x.html"]), (evaluate, []), (export, ["--out=x.onnx"])):
            assert "which is not a robot of dynappo's" in mistake(main.main, [what, *more], capsys)
    assert "only train knows others" in mistake(bench.main, ["--config=pendulum.py"], capsys)
    robot = mistake(train.main, ["--config=pendulum.py", "--config.robot=go1"], capsys)
    assert "robot is 'go1', but the config's file defines get_env" in robot
    assert not Path("x.html").exists() and not Path("x.onnx").exists()


MISTAKES = {  # what replaces the return of get_env, what the line says
    "return 1 / 0": "get_env cannot be run: ZeroDivisionError",
    "raise SystemExit": "get_env cannot be run: SystemExit",
    "return config": "it is FrozenConfigDict, expected a dynappo.types.Env",
    "pass": "it is None, expected a dynappo.types.Env",
    "return Env(reset, step)": "get_env cannot be run: TypeError: .*missing 6 required",
}


@pytest.mark.parametrize("code", MISTAKES)
def test_a_mistake_in_the_users_file_is_one_line(code, folder, capsys):
    """Status 2, and no folder of a run."""
    head, _, tail = (folder / "pendulum.py").read_text().partition("    return Env(")
    tail = tail[tail.index("\n\n\n") :]
    (folder / "wrong.py").write_text(f"{head}    {code}{tail}")
    assert status(train.main, "--config=wrong.py") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and re.search(MISTAKES[code], said), said
    assert not (folder / "runs" / "wrong").exists()


def test_every_field_of_the_contract_is_in_the_page():
    """Those of Env and of Outcome, each in a row of a table."""
    from dynappo.types import Env, Outcome

    rows = " ".join(line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `"))
    names = set(re.findall(r"`(\w+)", rows))
    assert names == (set(Env._fields) - {"mesh"}) | set(Outcome.__dataclass_fields__)


def test_a_file_without_get_env_is_a_robots():
    """Its robot stays; with one, it is no robot's."""
    config, get_env = config_lib.load_both("go1:quick")
    assert config.robot == "go1" and get_env is None
    config, get_env = config_lib.load_both("pendulum.py:ppo")
    assert config.robot == "" and get_env is not None and get_env(config).obs_size == 3

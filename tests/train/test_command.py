"""The command `python -m dynappo.train`: a first run, every mistake, what stops it."""

import csv
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import workdirs
from answers import PATIENCE, ROOT, mistake, refused, shell, status
from rich.progress import Progress

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.config import shell as shell_lib
from dynappo.description import robot as robot_lib
from dynappo.evaluate import recording
from dynappo.policy import policy_file, policy_source
from dynappo.program import build, devices, memory
from dynappo.run import finish as finish_lib
from dynappo.run import loop as loop_lib
from dynappo.run import training
from dynappo.train import command as train_command

GO1 = "--config=configs/go1.py:dyna4"


@pytest.fixture(autouse=True)
def not_our_process(monkeypatch):
    """What the command sets for its own process stays out of this one."""
    monkeypatch.setattr(devices, "own_process", lambda device: None)


# ---- a first run

FIRST = """
--config=configs/go1.py:quick --config.rollout.num_envs=16 --config.rollout.horizon=4
--config.schedule.end_iteration=4 --config.schedule.end_steps=1 --config.model.hidden=(16,16)
--config.model.minibatches=2 --config.ppo.hidden=(16,16) --config.task.episode_length=60
--config.run.num_iterations=4 --config.run.log_every=2 --config.run.eval_envs=0
--config.run.video_seconds=0 --config.physics.impl=c
""".split()
# N m: a Go1's own
CALF, OTHER = 35.55, 23.7
FIRST.append(f"--config.task.effort_limit={{'.*_calf_joint': {CALF}, '.*': {OTHER}}}")
FIRST.append(f"--config.task.saturation_effort={{'.*_calf_joint': {CALF}, '.*': {OTHER}}}")


def test_restore_takes_bundled_policies_by_their_names(monkeypatch, tmp_path):
    """`./go1_deploy` is a folder, and so is a robot that has none."""
    monkeypatch.setattr(files, "bundled", lambda: ["go1_deploy", "mine"])
    monkeypatch.setattr(files, "robots", lambda: ["go1", "mine"])

    def given(text):
        flags = ["--config=go1:laptop", f"--restore={text}", f"--workdir={tmp_path / 'run'}"]
        return train_command.parse(flags).restore

    assert given("go1_deploy") == policy_file.bundled("go1_deploy")
    assert given("go1_deploy").name == "deploy.npz"
    assert given("./go1_deploy") == pathlib.Path("go1_deploy")
    assert given("mine") == pathlib.Path("mine")


def test_a_first_run_on_the_go1(tmp_path, monkeypatch):
    """Status 0, nothing on stderr; metrics of every reward, a policy that can be played."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    workdir = tmp_path / "run"
    done = shell("-m", "dynappo.train", *FIRST, f"--workdir={workdir}")
    assert done.returncode == 0 and done.stderr == ""
    for words in (
        "dynappo trains go1: 16 robots, rollouts of 4 rows, the model writes 1 of them (0 to 1 over ",
        "iteration    4  return",
        "return (last 4 iterations)",
        f"see it: {shell_lib.command_line()} play {workdir} --out=walk.html",
    ):
        assert words in done.stdout, done.stdout
    with (workdir / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["iteration"] for row in rows] == ["1", "2", "3", "4"]
    config = config_lib.load("configs/go1.py")
    weights = config.task.weights.items()
    names = {f"reward_{name}" for name, weight in weights if weight is not None}
    assert names | {"velocity_error", "yaw_error", "falls", "timeouts", "blowups"} <= set(rows[0])
    for row in rows:
        some = {k: v for k, v in row.items() if not k.startswith("episode_")}
        assert all(np.isfinite(float(value)) for value in some.values()), some
    policy, path = policy_source.load(str(workdir))
    assert path == workdir / "policy.npz" and policy.robot == "go1"
    np.testing.assert_array_equal(policy.effort_limit, [OTHER, OTHER, CALF] * 4)
    assert np.isfinite(policy_file.actor(policy.params, policy.activation)(np.zeros(48))).all()
    assert any((tmp_path / "cache" / "dynappo" / "jax").iterdir())  # for the next process


LOGGED = """
--config=configs/go1.py:logs --config.rollout.num_envs=16 --config.model.hidden=(16,16)
--config.ppo.hidden=(16,16) --config.run.num_iterations=2 --config.run.log_every=2 --config.run.eval_envs=0
--config.run.video_seconds=0 --config.run.tensorboard=False --config.physics.impl=c
""".split()


def test_a_run_may_learn_from_a_log(tmp_path, monkeypatch, capsys):
    """It says what is in the log, and goes on with that file alone."""
    monkeypatch.chdir(tmp_path)
    player, _ = policy_source.player(policy_source.load("go1")[0])
    arrays = recording.record(player, 11)
    recording.save(pathlib.Path("walked.npz"), player, arrays)
    flags = [*LOGGED, "--workdir=run"]
    assert status(train_command.main, *flags, "--logs=walked.npz") == 0
    said = capsys.readouterr().out
    assert "2 iterations, 128 entries of the log" in said and "simulator steps" not in said
    assert f"{tmp_path}/walked.npz: 11 s of one robot, 1 episodes, 0 falls" in said.replace(
        "\n", ""
    )
    with open("run/metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[1]["model_error_1"]) < float(rows[0]["model_error_1"])
    policy = json.loads(str(np.load("run/policy.npz")["about"]))
    assert policy["config"]["run"]["logs"] == f"{tmp_path}/walked.npz"
    said = mistake(train_command.main, ["--workdir=run", "--logs=gone.npz"], capsys)
    assert f"--logs={tmp_path}/gone.npz: cannot be read" in said
    recording.save(pathlib.Path("walked.npz"), player, arrays | {"time": arrays["time"] + 1})
    for again, expected in (
        ([*flags, "--logs=walked.npz"], "run.logs_hash"),
        (["--workdir=run"], "walked.npz: is another file than the run began with"),
    ):
        assert status(train_command.main, *again) == 2
        assert expected in capsys.readouterr().err


# ---- mistakes

MISTAKES = {  # flags after the config file, what the line must say
    "unknown field": (["--config.ppo.learning_rat=1e-3"], "did you mean ppo.learning_rate?"),
    "wrong value": (["--config.ppo.epochs=2.5"], "ppo.epochs='2.5': expected int"),
    "value missing": (["--config.run.num_iterations"], "run.num_iterations=''"),
    "wrong setting": (["--config.run.num_iterations=0"], "expected 1 to 1,000,000"),
    "terms twice": (
        ["--terms=A.py", "--config.task.terms=B.py"],
        "--terms=A.py and --config.task.terms=B.py set one field; expected one of them",
    ),
    "swept and set": (
        ["--sweep=ppo.gamma=0.9,0.95", "--config.ppo.gamma=0.97"],
        "--config.ppo.gamma=0.97: ppo.gamma is swept over 0.9, 0.95; expected it in one of them",
    ),
    "unknown flag": (
        ["--learning_rate=3"],
        "--learning_rate=3: no such flag; expected --config.model.learning_rate or "
        "--config.ppo.learning_rate=VALUE",
    ),
    "abbreviated flag": (["--work=x"], "--work=x: no such flag"),
    "stray word": (["quick"], "quick: no such flag"),
    "workdir missing": (["--workdir"], "--workdir: expected one argument"),
    "no number": (["--processes=two"], "--processes: invalid int value: 'two'"),
    "workdir empty": (["--workdir="], "--workdir: is empty, expected a path"),
    "restore empty": (["--restore="], "--restore: is empty, expected a path"),
    "no log": (["--logs=none.npz"], "none.npz: cannot be read (No such file or directory)"),
    "log and no tail": (
        ["--logs=taken"],
        "an iteration has no tail: PPO learns from the model's rows",
    ),
    "long name": ([f"--workdir={'a' * 300}"], "cannot write there (File name too long)"),
    "two lines": (["--workdir=taken/a\nb"], "--workdir=taken/a\\nb: cannot write there (Not a dir"),
    "long line": (["--config.run.seed=" + "x" * 9999], "... "),
    "a folder of others": (
        ["--workdir=thesis", "--fresh"],
        "thesis holds thesis.txt, which no run",
    ),
    "here": (["--workdir=.", "--fresh"], "--fresh cannot move the folder that you are in"),
    "above": (["--workdir=..", "--fresh"], "--fresh cannot move the folder that you are in"),
    "restore and move": (["--workdir=old", "--restore=old", "--fresh"], "--restore=old: "),
    "lighter than nothing": (
        ["--config.task.randomize.base_mass=(-9,0)"],
        "task.randomize.base_mass is (-9.0, 0.0), expected more than -5.20 kg",
    ),
    "nobody to meet": (
        ["--coordinator=localhost:99999999", "--processes=2", "--process=0"],
        "--coordinator is 'localhost:99999999', expected HOST:PORT",
    ),
    "workdir is a file": (["--workdir=taken"], "--workdir=taken: cannot write there"),
    "another run": (["--config.ppo.epochs=4", "--workdir=old"], "ppo.epochs 5 there, 4 here"),
    "restore nothing": (
        ["--restore=none", "--fresh"],
        "--restore=none: no such file or folder; expected",
    ),
    "restore a young run": (["--restore=young", "--fresh"], "it holds no checkpoint yet"),
    "no GPU": (["--config.run.device=gpu"], "set run.device=cpu"),
    "no Warp": (["--config.physics.impl=warp"], "set physics.impl=jax"),
    "too large": (["--config.rollout.num_envs=4194304"], "the rollout alone needs"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(name, tmp_path, monkeypatch, capsys):
    """Nothing is written, nothing is compiled; no workdir stays behind that would refuse the cure."""
    monkeypatch.chdir(tmp_path)
    flags, expected = MISTAKES[name]
    (tmp_path / "taken").write_text("mine")
    (tmp_path / "young" / "checkpoints").mkdir(parents=True)
    old = config_lib.to_json(config_lib.validate(config_lib.load("configs/go1.py:dyna4")))
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "config.json").write_text(old)
    (tmp_path / "old" / "checkpoints" / "5").mkdir(parents=True)
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.txt").write_text("years")
    (tmp_path / "old" / "metrics.csv").write_text("iteration\n1\n")
    monkeypatch.setattr(build, "program", lambda *_, **__: pytest.fail("compiled"))
    before = workdirs.everything(tmp_path)
    monkeypatch.setattr(memory, "limit", lambda device: 8 * 2**30)
    assert status(train_command.main, GO1, *flags) == 2
    said = capsys.readouterr()
    assert said.err.startswith("dynappo: ") and expected in said.err and said.err.count("\n") == 1
    after = workdirs.everything(tmp_path)
    assert {str(p) for p in after if p not in before or after[p] != before[p]} <= {"old/lock"}


def test_a_config_file_that_is_not_there_is_one_line(capsys):
    for argv, expected in (
        ([], "--config is missing; try --config=go1:laptop"),
        (["--config=none.py"], "no file 'none.py'"),
        (["--config"], "--config: expected one argument"),
    ):
        assert expected in mistake(train_command.main, argv, capsys)


def test_a_mistake_is_answered_without_importing_jax():
    """Settings are checked before anything heavy is loaded; the module itself is the command."""
    code = (
        "import runpy, sys\n"
        "try:\n"
        "    runpy.run_module('dynappo.train', run_name='__main__', alter_sys=True)\n"
        "except SystemExit as stop:\n"
        "    heavy = {'jax', 'jaxlib', 'flax', 'optax', 'orbax', 'mujoco.mjx', 'brax'}\n"
        "    print(stop.code, sorted(heavy & set(sys.modules)))\n"
    )
    done = shell("-c", code, GO1, "--config.schedule.end_steps=16")
    assert done.stdout == "2 []\n", done.stderr
    assert done.stderr.startswith("dynappo: schedule.end_steps is 16, expected less than rollout")
    assert done.stderr.count("\n") == 1


def test_help_is_printed_and_is_no_mistake(capsys):
    assert status(train_command.main, "--help") == 0
    said = capsys.readouterr()
    words = "--config --workdir --fresh --restore --config.run.num_iterations=200 :dyna4".split()
    assert said.err == "" and all(word in said.out for word in words)


# ---- what it reads


@pytest.mark.parametrize(
    ("argv", "folder"),
    [
        (["--config=configs/go1.py"], "runs/go1"),
        (["--config", "configs/go1.py:quick"], "runs/go1-quick"),
        (["--config=configs/go1.py:ppo12", "--workdir=a/b"], "a/b"),
    ],
)
def test_a_run_has_a_folder_of_its_own(argv, folder):
    """Named after file and variant, unless `--workdir` says otherwise."""
    found = train_command.parse([*argv, "--config.run.seed=3"])
    assert found.workdir == pathlib.Path(folder) and found.config.run.seed == 3
    assert (found.fresh, found.restore, found.processes) == (False, None, (None,) * 3)
    assert "run.seed is" in refused(train_command.parse, [*argv, "--config.run.seed=99999999999"])


# ---- what stops it


@pytest.mark.parametrize(
    ("flags", "saved", "expected"),
    [
        ([], "4.tmp", "there is no checkpoint yet, the same command starts anew"),
        ([], "4", "the same command goes on from iteration 4"),
        (["--fresh"], "4", "the same command without --fresh goes on from iteration 4"),
        ([], "1000", "all iterations are done, the same command does what is left"),
        (
            ["--fresh"],
            "1000",
            "all iterations are done, the same command without --fresh does what is left",
        ),
    ],
)
def test_ctrl_c_promises_what_is_there(flags, saved, expected, monkeypatch, capsys, tmp_path):
    """While it compiles: it goes on from a checkpoint only where there is one."""

    def interrupted(command, stop):
        (tmp_path / "run" / "checkpoints" / saved).mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr(train_command, "train_and_show", interrupted)
    flags = [GO1, f"--workdir={tmp_path / 'run'}", *flags]
    assert status(train_command.main, *flags) == 130
    assert capsys.readouterr().err == f"dynappo: stopped; {expected}\n"


def compiles(monkeypatch, **about):
    """Compiling takes no time, and makes a program that nobody runs."""
    about |= {"compile_seconds": 0, "bytes_needed": 1, "state": {}}
    about.setdefault("robot", robot_lib.load("go1"))
    monkeypatch.setattr(build, "program", lambda *_, **__: SimpleNamespace(**about))


def finished(monkeypatch, when):
    """Runs the command with a loop that does all it should; ctrl-C comes `when` it says."""
    loops = []

    def loop(runs, program, state, start, **how):
        loops.append(how)
        (runs[0].workdir / "checkpoints" / "4").mkdir(parents=True)
        if when == "in the last iteration":
            signal.raise_signal(signal.SIGINT)
        runs[0].history.append({"iteration": np.array([runs[0].config.run.num_iterations])})
        return state, [0]

    def finish(*_):
        loops.append("finished")
        if when == "while it is evaluated":
            signal.raise_signal(signal.SIGINT)
        raise AssertionError("not stopped")

    compiles(monkeypatch, impl="c", device="cpu")
    monkeypatch.setattr(loop_lib, "loop", loop)
    monkeypatch.setattr(finish_lib, "finish", finish)
    return loops


@pytest.mark.parametrize(
    ("when", "line"),
    [
        (
            "in the last iteration",
            "saved at iteration 4 and stopped; all iterations are done, the same command does what is left",
        ),
        (
            "while it is evaluated",
            "stopped; all iterations are done, the same command does what is left",
        ),
    ],
)
def test_ctrl_c_at_the_end_of_a_run_is_one_line_too(when, line, monkeypatch, capsys, tmp_path):
    loops = finished(monkeypatch, when)
    assert status(train_command.main, *FIRST, f"--workdir={tmp_path / 'run'}") == 130
    said = capsys.readouterr().err.splitlines()  # the other line is that of a thread, at any time
    assert [each for each in said if "stopping after" not in each] == [f"dynappo: {line}"]
    assert ("finished" in loops) == (when == "while it is evaluated")


@pytest.mark.parametrize("engine", ["warp", "jax", "c"])
def test_it_says_what_one_waits_for(engine, monkeypatch, tmp_path):
    """On a terminal, and how long; less if the programs are cached."""
    said = []
    finished(monkeypatch, "in the last iteration")
    monkeypatch.setattr(Progress, "add_task", lambda _, text, **of: said.append(text) or 0)
    monkeypatch.setattr(Progress, "update", lambda *_, **of: None)
    monkeypatch.setattr(train_command.devices, "engine", lambda config: engine)
    assert status(train_command.main, *FIRST, f"--workdir={tmp_path / 'run'}") == 130
    assert re.fullmatch(r"compiling \(.*(minute|[0-9] s).* cached.*\)", said[0])
    assert all(len(text) < 100 for text in said)


@pytest.mark.parametrize("stiffness", [0, 40])
def test_it_says_why_physics_are_slow(stiffness, monkeypatch, capsys, tmp_path):
    """Where the kernel would have been used."""
    go1 = robot_lib.load("go1")
    spec = robot_lib.physics_spec(go1.xml)
    spec.joint("FL_thigh_joint").stiffness = [stiffness, 0, 0]
    robot = go1._replace(mj_model=spec.compile())
    finished(monkeypatch, "in the last iteration")
    compiles(monkeypatch, impl="warp", device="H100", robot=robot)
    assert status(train_command.main, *FIRST, f"--workdir={tmp_path / 'run'}") == 130
    said = capsys.readouterr().out
    assert said.count("because of springs at joints (jnt_stiffness)") == bool(stiffness)


def test_before_it_listens_ctrl_c_is_one_line_too(monkeypatch, capsys):
    def interrupted(argv):
        raise KeyboardInterrupt

    monkeypatch.setattr(train_command, "parse", interrupted)
    assert status(train_command.main) == 130
    assert capsys.readouterr().err == "dynappo: stopped\n"


@pytest.mark.slow
def test_a_run_can_be_killed_at_any_moment(tmp_path):
    """kill -9, ctrl-C, SIGTERM, and at last to the end: every iteration is there once, none is lost."""
    toy = [sys.executable, str(ROOT / "tests" / "toy_train.py"), "--config.run.num_iterations=400"]
    toy += ["--config.run.num_seeds=1", "--config.run.eval_envs=0"]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}

    def start(workdir):
        command = [*toy, f"--workdir={workdir}"]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment)

    def last(workdir):
        path = workdir / "metrics.csv"
        lines = path.read_text().splitlines() if path.exists() else []
        return int(lines[-1].split(",")[0]) if len(lines) > 1 else 0

    workdir, never, reached = tmp_path / "run", tmp_path / "never", 0
    asked = [(number, 128 + number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    for kind, code in ((signal.SIGKILL, -9), *asked):
        run = start(workdir)
        while last(workdir) < reached + 20:
            assert run.poll() is None, run.communicate()
            time.sleep(0.01)
        run.send_signal(kind)
        _, err = run.communicate(timeout=PATIENCE)
        assert run.returncode == code
        reached = last(workdir)
        saved = max(int(name) for name in workdirs.steps(workdir) if name.isdigit())
        assert saved >= reached - 8  # two checkpoints: the older of them was still being written
        if kind != signal.SIGKILL:
            goes_on = f"the same command goes on from iteration {saved}"
            line = f"dynappo: saved at iteration {saved} and stopped; {goes_on}"
            assert err.splitlines()[-1] == line
            assert err.splitlines()[:-1] in (
                [f"dynappo: {training.WAITS}"],
                [],
            )  # so soon it is saved
            assert saved == reached
    out, err = start(workdir).communicate(timeout=300)
    assert err == "" and "return (last 10 iterations)" in out
    # as if nothing had happened: every number of every row, every bit of the last state
    assert start(never).wait(timeout=300) == 0
    rows = workdirs.table(workdir)
    assert rows == workdirs.table(never)
    assert [int(row["iteration"]) for row in rows] == list(range(1, 401))
    real = [int(row["n_real"]) for row in rows]
    assert [int(row["sim_steps"]) for row in rows] == list(16 * np.cumsum(real))
    about = (w / "checkpoints" / "400" / "about" / "metadata" for w in (workdir, never))
    one, other = (json.loads(path.read_text())["sha256"] for path in about)
    assert one == other


# ---- a run that goes on by its folder alone


def saved_config(folder, **fields):
    """A folder with the config.json of a run of `:quick`."""
    config = config_lib.load("go1:quick")
    config.update(fields)
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(config_lib.to_json(config))
    return folder


def test_a_workdir_alone_is_enough_to_go_on(tmp_path):
    """Its settings, and those of the command line above them."""
    run = saved_config(tmp_path / "run")
    command = train_command.parse([f"--workdir={run}", "--config.run.num_iterations=80"])
    named = train_command.parse(["--config=go1:quick", f"--workdir={run}"])
    changed = config_lib.flat(command.config) | {"run.num_iterations": 70}
    assert changed == config_lib.flat(named.config) and command.config.run.num_iterations == 80
    assert command.workdir == run and command.get_env is None


def test_a_workdir_that_is_not_enough_says_what_else(tmp_path):
    """None there, one's own environment, a robot that is elsewhere, a config.json that is none."""
    empty = tmp_path / "empty"
    assert "no run there to go on with" in refused(train_command.parse, [f"--workdir={empty}"])
    own = saved_config(tmp_path / "own", robot="")
    assert "name its file too: --config=FILE.py" in refused(
        train_command.parse, [f"--workdir={own}"]
    )
    away = saved_config(tmp_path / "away", robot="mydog")
    line = refused(train_command.parse, [f"--workdir={away}"])
    assert f"export {away} --out=robots/mydog/mydog.xml" in line
    (own / "config.json").write_bytes(b"\xff{")
    assert "config.json: it is not text" in refused(train_command.parse, [f"--workdir={own}"])
    (own / "config.json").write_text("{")
    assert "not the JSON of a config" in refused(train_command.parse, [f"--workdir={own}"])

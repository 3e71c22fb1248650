"""What the train command answers: one line and status 2 for every mistake, and what it prints."""

import io
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console

from dynappo import config as config_lib
from dynappo.train import command as train_command

ROOT = pathlib.Path(config_lib.__file__).parent.parent
GO1 = "--config=configs/go1.py:dyna4"
NOWHERE = ["--workdir=taken"]  # a file: a mistake that goes unnoticed trains nothing
# name -> flags after the config file, what the line must say
SETTINGS = {
    "unknown field": (["--config.ppo.learning_rat=1e-3"], "did you mean ppo.learning_rate?"),
    "field of no group": (["--config.zzz=1"], "no such field"),
    "a group": (["--config.rollout=3"], "is a group"),
    "float for int": (["--config.ppo.epochs=2.5"], "ppo.epochs='2.5': expected int"),
    "text for float": (["--config.ppo.gamma=high"], "ppo.gamma='high': expected float"),
    "number for bool": (["--config.ppo.adaptive=1"], "expected bool"),
    "number for tuple": (["--config.ppo.hidden=64"], "ppo.hidden='64': expected"),
    "text in a tuple of ints": (["--config.ppo.hidden=('a','b')"], "ppo.hidden"),
    "text in a range": (["--config.task.command_x=('a',1)"], "task.command_x"),
    "empty network": (["--config.ppo.hidden=()"], "ppo.hidden"),
    "negative width": (["--config.model.hidden=(64,-3)"], "model.hidden"),
    "value missing": (["--config.run.num_iterations"], "run.num_iterations=''"),
    "unknown flag": (["--learning_rate=3"], "--learning_rate=3: no such flag"),
    "abbreviated flag": (["--work=x"], "--work=x: no such flag"),
    "stray word": (["quick"], "quick: no such flag"),
    "workdir missing": (["--workdir"], "--workdir: expected one argument"),
    "minibatches do not divide": (
        ["--config.ppo.minibatches=7"],
        "expected a multiple of ppo.minibatches = 7",
    ),
    "robots do not divide": (["--config.rollout.num_envs=100"], "ppo.shuffle_blocks = 8"),
    "tail as long as the rollout": (
        ["--config.schedule.end_steps=16"],
        "schedule.end_steps is 16, expected less than rollout.horizon = 16",
    ),
    "negative steps": (["--config.schedule.start_steps=-1"], "expected 0 or more"),
    "fewer steps at the end": (
        ["--config.schedule.start_steps=3", "--config.schedule.end_steps=2"],
        "schedule.end_steps is 2, expected at least schedule.start_steps = 3",
    ),
    "end before start": (
        ["--config.schedule.start_iteration=200"],
        "schedule.end_iteration is 100, expected at least schedule.start_iteration = 200",
    ),
    "no iterations": (["--config.run.num_iterations=0"], "expected more than 0"),
    "negative evaluation": (["--config.run.eval_envs=-1"], "run.eval_envs is -1"),
    "negative film": (["--config.run.video_seconds=-1.0"], "run.video_seconds is -1"),
    "infinite rate": (["--config.ppo.learning_rate=1e999"], "ppo.learning_rate is inf"),
    "seed of 70 bits": (["--config.run.seed=999999999999999999999"], "run.seed"),
    "unknown robot": (["--config.robot=spot"], "robot is 'spot', expected one of anymal_c"),
    "robot by a path": (["--config.robot=../go1"], "robot is '../go1'"),
    "unknown engine": (["--config.physics.impl=cuda"], "expected one of auto, jax, warp"),
    "unknown device": (["--config.run.device=tpu"], "expected one of auto, cpu, gpu"),
    "unknown formulation": (["--config.task.formulation=mine"], "expected one of isaaclab"),
}
# name -> text of a config file, what the line must say besides the file's name
FILES = {
    "no get_config": ("x = 1\n", "get_config"),
    "syntax error": ("def get_config(variant\n    return 1\n", "line 1"),
    "error at import": ("import no_such_package\n", "no_such_package"),
    "error inside": ('def get_config(variant=""):\n    return 1 / 0\n', "division by zero"),
    "missing key": ('def get_config(variant=""):\n    return {}["speed"]\n', "speed"),
    "missing attribute": ('def get_config(variant=""):\n    return variant.speed\n', "speed"),
    "no variant": ("def get_config():\n    return 1\n", "get_config"),
    "another type": ('def get_config(variant=""):\n    return 3\n', "get_config"),
    "fields missing": (
        "from ml_collections import config_dict\n\n\n"
        'def get_config(variant=""):\n    return config_dict.create(robot="go1")\n',
        "mine.py",
    ),
}


@pytest.fixture
def refusal(capsys, tmp_path, monkeypatch):
    """`refusal(argv)` is the one line that the command answers with status 2, nothing written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("mine")

    def call(argv, left):
        with pytest.raises(SystemExit) as stopped:
            train_command.main(argv)
        assert stopped.value.code == 2
        out, line = capsys.readouterr()
        assert line.count("\n") == 1 and line.endswith("\n"), line
        assert line.startswith("dynappo: ") and len(line) < 400
        assert "Traceback" not in out + line
        assert sorted(p.name for p in tmp_path.iterdir()) == sorted(left)
        return line

    return call


def shell(*arguments, cwd=ROOT):
    """A fresh Python with these arguments; environment and package as here."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("name", SETTINGS)
def test_a_wrong_setting_is_one_line_and_status_2(refusal, name):
    """The line names the field, what was found and what was expected."""
    flags, expected = SETTINGS[name]
    assert expected in refusal([GO1, *NOWHERE, *flags], left=["taken"])


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_config_file_is_one_line_and_status_2(refusal, tmp_path, name):
    """The line names the file and what is wrong in it; no traceback of ours."""
    text, expected = FILES[name]
    (tmp_path / "mine.py").write_text(text)
    line = refusal(["--config=mine.py", *NOWHERE], left=["mine.py", "taken"])
    assert "mine.py" in line and expected in line


@pytest.mark.parametrize(
    "argv, expected",
    [
        (["--config=none.py"], "no file 'none.py'"),
        (["--config=."], "no file '.'"),
        (["--config=configs/go1.py:ppo13"], "variant 'ppo13' is not one of ppo12, ppo16"),
        (["--config"], "--config: expected one argument"),
        ([], "--config"),
    ],
    ids=["missing", "folder", "variant", "no value", "no arguments"],
)
def test_without_a_config_file_the_answer_is_one_line(refusal, argv, expected):
    """A file that is not there, a variant that is not, no file at all."""
    assert expected in refusal(argv, left=["taken"])


def test_a_workdir_that_is_a_file_is_refused(refusal, tmp_path):
    """Nothing is written over it, nor under it."""
    for workdir in ("taken", "taken/below"):
        line = refusal([GO1, f"--workdir={workdir}"], left=["taken"])
        assert f"--workdir={workdir}" in line and "cannot write there" in line
    assert (tmp_path / "taken").read_text() == "mine"


def test_the_folder_of_another_run_is_refused_by_the_field_that_differs(refusal, tmp_path):
    """Its config.json stays as it is."""
    (tmp_path / "old").mkdir()
    config = config_lib.validate(config_lib.load("configs/go1.py:ppo12"))
    (tmp_path / "old" / "config.json").write_text(config_lib.to_json(config))
    (tmp_path / "old" / "metrics.csv").write_text("iteration\n1\n")
    argv = ["--config=configs/go1.py:ppo12", "--config.ppo.epochs=4", "--workdir=old"]
    assert "ppo.epochs 5 there, 4 here" in refusal(argv, left=["old", "taken"])
    assert (tmp_path / "old" / "config.json").read_text() == config_lib.to_json(config)
    assert {p.name for p in (tmp_path / "old").iterdir()} == {"config.json", "metrics.csv"}


def test_a_config_of_something_else_is_not_overwritten(refusal, tmp_path):
    """A folder whose config.json is no run's: of another program, or no JSON."""
    (tmp_path / "model").mkdir()
    for text in ('{"layers": 3}', "[1]", "{"):
        (tmp_path / "model" / "config.json").write_text(text)
        line = refusal([GO1, "--workdir=model"], left=["model", "taken"])
        assert "--workdir=model holds a config.json that is not of a run" in line
        assert (tmp_path / "model" / "config.json").read_text() == text


def test_a_run_to_start_from_is_looked_for_before_anything_is_written(refusal, tmp_path):
    """Nothing there, or nothing saved there yet: no workdir is made, none is moved aside."""
    argv = [GO1, "--workdir=new", "--fresh"]
    line = refusal([*argv, "--restore=none"], left=["taken"])
    assert "--restore=none: no checkpoints/ there" in line
    for folder in ("young/checkpoints", "new"):
        (tmp_path / folder).mkdir(parents=True)
    line = refusal([*argv, "--restore=young"], left=["new", "taken", "young"])
    assert "--restore=young: it holds no checkpoint yet" in line
    assert not list((tmp_path / "new").iterdir())


@pytest.fixture
def without_gpu():
    """Skips where JAX has a GPU, on which these settings can run."""
    import jax

    if jax.default_backend() == "gpu":
        pytest.skip("this machine has a GPU")


@pytest.mark.parametrize(
    "flag, cure",
    [("run.device=gpu", "run.device=cpu"), ("physics.impl=warp", "physics.impl=jax")],
)
def test_a_machine_that_cannot_run_it_says_so_and_what_to_do(refusal, without_gpu, flag, cure):
    """One line with the cure, and no workdir behind that would refuse the cure."""
    assert cure in refusal([GO1, f"--config.{flag}", "--workdir=run"], left=["taken"])


def test_the_command_itself_answers_in_one_line():
    """`python -m dynappo.train` with an unknown field: status 2, one line, nothing on stdout."""
    done = shell("-m", "dynappo.train", GO1, "--config.task.kq=30.0")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("dynappo: --config.task.kq: no such field; did you mean task.k")
    assert done.stderr.count("\n") == 1


def test_a_mistake_is_answered_without_importing_jax():
    """Settings are checked before anything heavy is loaded."""
    code = (
        "import sys\n"
        "from dynappo import console\n"
        "try:\n"
        f"    train_command.main(['{GO1}', '--config.schedule.end_steps=16'])\n"
        "except SystemExit as stop:\n"
        "    heavy = {'jax', 'jaxlib', 'flax', 'optax', 'orbax', 'mujoco', 'brax'}\n"
        "    print(stop.code, sorted(heavy & set(sys.modules)))\n"
    )
    done = shell("-c", code)
    assert done.stdout == "2 []\n", done.stderr
    assert "schedule.end_steps is 16" in done.stderr


@pytest.mark.parametrize(
    "error, status, expected",
    [
        (KeyboardInterrupt(), 130, "stopped\n"),
        (FloatingPointError("a loss is not finite"), 1, "a loss is not finite"),
        (OSError(28, "No space left on device", "a.csv"), 1, "a.csv cannot be written (No space"),
        (OSError("libGL.so: cannot open shared object"), 1, "libGL.so: cannot open"),
    ],
    ids=["ctrl-C before it listens", "blown up", "disk full", "no library"],
)
def test_what_ends_the_command_is_one_line_and_a_status(
    error, status, expected, monkeypatch, capsys
):
    def parse(_):
        raise error

    monkeypatch.setattr(train_command, "parse", parse)
    with pytest.raises(SystemExit) as stopped:
        train_command.main([])
    line = capsys.readouterr().err
    assert stopped.value.code == status
    assert line.startswith(f"dynappo: {expected}") and line.count("\n") == 1


@pytest.mark.parametrize(
    "flags, saved, expected",
    [
        ([], False, "there is no checkpoint yet, the same command starts anew"),
        ([], True, "the same command goes on from the last checkpoint"),
        (["--fresh"], True, "the same command without --fresh goes on from the last checkpoint"),
    ],
    ids=["nothing saved", "saved", "fresh"],
)
def test_ctrl_c_promises_what_is_there(flags, saved, expected, monkeypatch, capsys, tmp_path):
    """While it compiles: it goes on from a checkpoint only where there is one."""

    def interrupted(command, stop):
        (tmp_path / "run" / "checkpoints" / ("4" if saved else "4.tmp")).mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr(train_command, "train_and_show", interrupted)
    with pytest.raises(SystemExit) as stopped:
        train_command.main([GO1, f"--workdir={tmp_path / 'run'}", *flags])
    assert stopped.value.code == 130
    assert capsys.readouterr().err == f"dynappo: stopped; {expected}\n"


def test_help_is_printed_and_is_no_mistake():
    """`--help`: status 0, the two flags and how to set a field."""
    done = shell("-m", "dynappo.train", "--help")
    assert done.returncode == 0 and done.stderr == ""
    for word in ("--config", "--workdir", "--config.run.num_iterations=200", ":quick"):
        assert word in done.stdout


# ---- what it reads


@pytest.mark.parametrize(
    "argv, folder",
    [
        (["--config=configs/go1.py"], "runs/go1"),
        (["--config", "configs/go1.py:quick"], "runs/go1-quick"),
        (["--config=configs/go1.py:ppo12", "--workdir=a/b"], "a/b"),
    ],
)
def test_a_run_has_a_folder_of_its_own(argv, folder):
    """Named after file and variant, unless `--workdir` says otherwise."""
    assert train_command.parse(argv).workdir == pathlib.Path(folder)


def test_fields_are_set_in_both_spellings_and_the_last_one_counts():
    """`--config.a.b=1` and `--config.a.b 1`, with the type of the default."""
    flags = ["--config.ppo.epochs", "3", "--config.ppo.gamma=1", "--config.ppo.epochs=2"]
    config = train_command.parse([GO1, *flags, "--config.ppo.hidden=(64,32)"]).config
    assert config.ppo.epochs == 2 and config.ppo.hidden == (64, 32)
    assert config.ppo.gamma == 1.0 and type(config.ppo.gamma) is float


# ---- what it prints


def config(spec="configs/go1.py:dyna4", **fields):
    """A valid config with `group__field` set."""
    config = config_lib.load(spec)
    for name, value in fields.items():
        group, _, leaf = name.partition("__")
        config[group][leaf] = value
    return config_lib.validate(config)


def test_the_description_says_what_will_happen():
    """Robots, rows, tail, iterations, simulator steps and memory, in two lines."""
    lines = train_command.describe(config("configs/go1.py:dyna4")).split("\n")
    assert lines[0] == (
        "trains go1: 4096 robots, 16 rows an iteration, tail of 4, from 0 over iterations 0-100"
    )
    steps = sum(4096 * (16 - min(int(i / 25 + 0.5), 4)) for i in range(1, 501))
    assert lines[1].startswith(f"500 iterations, {steps / 1e6:.2f} M simulator steps; about ")
    assert lines[1].endswith(" GiB of memory") and len(lines) == 2


@pytest.mark.parametrize(
    "spec, expected",
    [
        ("configs/go1.py:ppo16", "4096 robots, 16 rows an iteration, plain PPO, no model"),
        ("configs/go1.py:dyna2", "4096 robots, 16 rows an iteration, tail of 2\n"),
        ("configs/go1.py:quick", "256 robots, 24 rows an iteration, tail of 4, from 0 over"),
    ],
)
def test_the_description_names_the_kind_of_tail(spec, expected):
    """None, one of constant length, or a ramp."""
    assert expected in train_command.describe(config(spec))
    seeds = train_command.describe(config(spec, run__num_seeds=5))
    assert "robots x 5 seeds," in seeds


LAST = {
    "episode_return": np.float32(12.345),
    "episode_length": np.float32(987.6),
    "velocity_error": np.float32(0.234),
    "policy_std": np.float32(0.5678),
}


def test_the_progress_line_shows_return_length_error_std_and_pace():
    """The pace is of the last chunks, not of the whole run."""
    begun = [(10.0 * i, 1e6 * i) for i in range(1, 4)]
    line = train_command.progress_line(LAST, begun)
    assert line == "return  12.35  length  988  error 0.23 m/s  std 0.57  100.0 k steps/s"
    slow = [(0.0, 0.0)] + [(1000.0 + i, 1e6 + 2000.0 * i) for i in range(10)]
    assert train_command.progress_line(LAST, slow).endswith("  2.0 k steps/s")
    assert train_command.progress_line(LAST, [(4.0, 8000.0)]).endswith("  2.0 k steps/s")


def test_the_progress_line_shows_the_mean_of_seeds_and_no_nan():
    """Before the first episode ends there is a dash."""
    seeds = {name: np.array([value - 0.1, value + 0.1]) for name, value in LAST.items()}
    begun = [(1.0, 1e3), (2.0, 2e3)]
    assert train_command.progress_line(seeds, begun) == train_command.progress_line(LAST, begun)
    line = train_command.progress_line(LAST | {"episode_return": np.float32("nan")}, begun)
    assert "nan" not in line and " - " in line


def shown(summary):
    """What is printed after training."""
    text = io.StringIO()
    out = Console(file=text, width=120)
    run = config("configs/go1.py:quick")
    train_command.show_summary(out, run, pathlib.Path("runs/x"), summary)
    return text.getvalue()


SUMMARY = {
    "return": 3.25,
    "return_max": 4.5,
    "sim_steps": 2_345_678,
    "seconds": 61.2,
    "compile_seconds": 20.0,
    "evaluation": {
        "return": 5.5,
        "fall_rate": 0.125,
        "tracking_error": 0.31,
        "yaw_error": 0.42,
        "length": 900.0,
    },
    "video": "runs/x/video.mp4",
}


def test_the_last_table_has_the_numbers_the_video_and_the_next_command():
    """Return, best return, cost, evaluation, where things are, what to try next."""
    text = shown(SUMMARY)
    for part in ("3.25", "4.50", "2.35 M", "61.2 s", "5.50", "12.50 %", "0.31 m/s", "0.42 rad/s"):
        assert part in text
    assert "runs/x/video.mp4" in text and "python -m dynappo.train --config=" in text


def test_the_last_table_of_several_seeds_shows_their_means():
    """Lists in the summary, one number a seed: the mean, and from where to where they go."""
    many = SUMMARY | {"return": [3.0, 3.5], "return_max": [4.0, 5.0]}
    many["evaluation"] = {name: [x - 0.01, x + 0.01] for name, x in SUMMARY["evaluation"].items()}
    text = shown(many)
    assert "3.25 (2 seeds: 3.00 to 3.50)" in text and "4.50 (2 seeds: 4.00 to 5.00)" in text
    assert "%" in shown(SUMMARY) and "seeds" not in shown(SUMMARY)


def test_a_run_in_which_no_episode_ended_is_shown_without_a_return():
    """The summary then holds None: a dash, no traceback and no "nan"."""
    text = shown(SUMMARY | {"return": float("nan"), "return_max": None})
    assert "best return" in text and "nan" not in text


def test_an_error_that_nobody_stood_long_enough_to_measure_is_shown():
    """The summary then holds None for it, of one seed or of all: no traceback and no "nan"."""
    for nothing in (None, [None, None]):
        lost = SUMMARY["evaluation"] | {"tracking_error": nothing, "yaw_error": nothing}
        text = shown(SUMMARY | {"evaluation": lost})
        assert "tracking error" in text and "nan" not in text and "None" not in text


def test_a_run_without_evaluation_and_film_is_shown():
    """Both are settings."""
    bare = {k: v for k, v in SUMMARY.items() if k not in ("evaluation", "video")}
    text = shown(bare)
    assert "evaluation" not in text and "3.25" in text

"""What the command says of a run, in words."""

import io
import math
import pathlib
import re
import shlex
from types import SimpleNamespace

import ml_collections
import numpy as np
import pytest
from answers import ROOT
from rich.console import Console

from dynappo import config as config_lib
from dynappo.config import files, flags
from dynappo.config import shell as shell_lib
from dynappo.description import robot as robot_lib
from dynappo.run import show
from dynappo.train import command as train_command


def config(spec="configs/go1.py:dyna4", **fields):
    """A valid config with fields of `run` set."""
    config = config_lib.load(spec)
    config.run.update(**fields)
    return config_lib.validate(config)


@pytest.mark.parametrize(
    ("spec", "tail"),
    [
        ("ppo16", "plain PPO, no model"),
        ("dyna2", "the model writes 2 of them"),
        ("dyna4", "the model writes 4 of them (0 to 4 over iterations 0-100)"),
    ],
)
def test_the_description_says_what_will_happen(spec, tail):
    """Robots, rows, tail, iterations and simulator steps, in two lines; seeds and devices if several."""
    run = config(f"configs/go1.py:{spec}")
    tails = [0] * 500 if spec == "ppo16" else [2] * 500
    if spec == "dyna4":
        tails = [min(int(i / 25 + 0.5), 4) for i in range(1, 501)]
    steps = sum(4096 * (16 - n) for n in tails) / 1e6
    first = f"trains go1: 4096 robots, rollouts of 16 rows, {tail}"
    second = f"500 iterations, {steps:.2f} M simulator steps"
    assert show.describe(run) == f"{first}\n{second}"
    many = config(f"configs/go1.py:{spec}", num_seeds=4, mesh_seed=4, mesh_env=2)
    first = first.replace("robots,", "robots x 4 seeds over 4 x 2 devices,")
    assert show.describe(many) == f"{first}\n{second}"


def test_a_learning_rate_that_the_kl_adapts_is_said_to_decide_little():
    """And with a fixed one what only an adaptive one reads."""
    adaptive = config()
    fixed = config_lib.load("configs/go1.py:dyna4")
    fixed.ppo.adaptive = False
    fixed = config_lib.validate(fixed)
    rate, kl = ("ppo.learning_rate", "ppo.gamma"), ("ppo.desired_kl", "ppo.gamma")
    assert "set or sweep that, or --config.ppo.adaptive=False" in show.of_little_effect(
        adaptive, rate
    )
    assert "so ppo.desired_kl changes nothing" in show.of_little_effect(fixed, kl)
    assert not show.of_little_effect(adaptive, kl) and not show.of_little_effect(fixed, rate)


def test_fields_of_a_tail_are_said_to_change_nothing_where_there_is_none():
    """Those that the user has set, alone."""
    plain, tails = config("configs/go1.py:ppo16"), config()
    given = ("rollout.imagined", "model.memory", "schedule.rounds", "ppo.gamma")
    said = "no row is written by the model, so rollout.imagined, model.memory, schedule.rounds change nothing"
    assert show.of_little_effect(plain, given).startswith(said)
    both = show.of_little_effect(plain, ("model.symmetry", "ppo.learning_rate"))
    assert (
        "so model.symmetry changes nothing" in both and ". ppo.learning_rate decides little" in both
    )
    assert not show.of_little_effect(tails, given)
    assert not show.of_little_effect(plain, ()) and not show.of_little_effect(
        plain, ["schedule.end_steps"]
    )


def test_the_progress_line_shows_return_length_error_std_and_pace():
    """The pace is of the last chunks; of seeds the mean; a dash before the first episode ends."""
    numbers = dict(episode_return=12.345, episode_length=987.6, velocity_error=0.234)
    last = {name: np.float32(value) for name, value in numbers.items()}
    last["policy_std"] = np.float32(0.5678)
    begun = [(10.0 * i, 1e6 * i) for i in range(1, 4)]
    line = "return  12.35  length  988  error 0.23 m/s  std 0.57  100.0 k steps/s"
    assert show.progress_line(last, begun) == line
    seeds = {name: np.array([value - 0.1, value + 0.1]) for name, value in last.items()}
    assert show.progress_line(seeds, begun) == line
    slow = [(0.0, 0.0)] + [(1000.0 + i, 1e6 + 2000.0 * i) for i in range(10)]
    for chunks in (slow, [(4.0, 8000.0)]):
        assert show.progress_line(last, chunks).endswith("  2.0 k steps/s")
    line = show.progress_line(last | {"episode_return": np.float32("nan")}, begun)
    assert "nan" not in line and line.startswith("return     -   length  988")


@pytest.mark.parametrize(("height", "said"), [(50.0, True), (0.37, False)])
def test_a_robot_that_is_dropped_from_far_above_is_told_before_training(height, said):
    settings = config_lib.load("go1:laptop")
    settings.task.reset.spawn_height = height
    program = SimpleNamespace(impl="c", robot=robot_lib.load("go1"), device="cpu", bytes_needed=0)
    program.compile_seconds, text = 7.0, io.StringIO()
    show.describe_program(Console(file=text, width=200), config_lib.validate(settings), program)
    line = "task.reset.spawn_height is 50 m, the base of the default pose at 0.325 m: 0.37 is 5 cm more"
    assert (line in text.getvalue()) == said


@pytest.mark.parametrize(("terminal", "every"), [(False, 1), (False, 4), (True, 1)])
def test_a_training_is_followed_from_compiling_to_filming(terminal, every):
    """Of two runs: their mean, one clock, the steps of both. Without a terminal ten lines, not a hundred,
    also where no chunk ends at a tenth of the run."""
    text = io.StringIO()
    kind = dict(force_terminal=terminal, force_interactive=terminal)
    out = Console(file=text, width=200, highlight=False, **kind)
    program = {"impl": "c", "device": "cpu", "compile_seconds": 7.2, "bytes_needed": 3 << 20}
    program |= {"evaluated_on": "jax", "ready": lambda: False, "robot": robot_lib.load("go1")}
    numbers = dict(episode_length=500.0, velocity_error=0.25, policy_std=0.5)
    with show.live(out, config("configs/go1.py:dyna4", num_iterations=100)) as callbacks:
        callbacks.opened()
        callbacks.compiled(SimpleNamespace(**program))
        callbacks.say("the disk is [nearly] full")
        for i in range(every, 101, every):
            one = numbers | {"seconds": 2.0 * i, "sim_steps": 1000 * i, "episode_return": 12.0}
            callbacks.progress(i, [one, one | {"episode_return": 14.0}])
        callbacks.finishing()
        callbacks.finished()
        print("the table", file=text)
    shown = text.getvalue()
    assert "cpu, C MuJoCo; compiled in 7 s, 3 MiB of memory" in shown
    assert "the disk is [nearly] full" in shown
    line = "return  13.00  length  500  error 0.25 m/s  std 0.50  1.0 k steps/s on C MuJoCo"
    assert line in shown and ("compiling (" in shown) == ("100/100" in shown) == terminal
    assert shown.endswith("the table\n")
    if not terminal:
        assert shown.index("compiles for MJX-JAX (") < shown.index("compiled in 7 s")
        end = "evaluates 1000 episodes of 1000 control steps on MJX-JAX, which compiles first"
        assert shown.count(line) == 10
        assert f"iteration  100  {line}\n{end} (on a CPU a while); then films 12 s\n" in shown


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({}, "evaluates 1000 episodes of 1000 control steps; then films 12 s\n"),
        (
            {"video_seconds": 0.0, "num_seeds": 2, "eval_steps": 50},
            "evaluates 1000 episodes of 50 control steps of each of 2 seeds\n",
        ),
        ({"eval_envs": 0}, "films 12 s\n"),
        ({"eval_envs": 0, "video_seconds": 0.0}, ""),
    ],
)
def test_nothing_is_announced_that_is_not_done(fields, said):
    text = io.StringIO()
    with show.live(
        Console(file=text, width=200), config("configs/go1.py:dyna4", **fields)
    ) as callbacks:
        callbacks.finishing()
    assert text.getvalue() == said


def test_of_runs_that_train_together_each_is_evaluated_and_filmed():
    text = io.StringIO()
    out = Console(file=text, width=200)
    with show.live(out, config("configs/go1.py:dyna4", num_seeds=2), runs=3) as callbacks:
        callbacks.finishing()
    assert text.getvalue() == (
        "evaluates 1000 episodes of 1000 control steps of each of 2 seeds of each of 3 runs; then films 12 s "
        "of each of 3 runs\n"
    )


def test_without_a_gpu_it_is_said_before_anything_is_compiled():
    """And what is made for a CPU; nothing of it where C MuJoCo steps the robots."""
    laptop = f"made for a CPU: {shell_lib.line('train', '--config=go1:laptop')}"
    text = io.StringIO()
    for spec, fields, said in (
        (
            "best",
            {},
            f"there is no GPU here, so this will be slow; on a CPU MJX compiles for minutes.*; {laptop}",
        ),
        ("best", {"device": "cpu"}, f"on a CPU MJX compiles .*; {laptop}"),
        ("laptop", {}, ""),
        (
            "playground:Go1Getup",
            {},
            "there is no GPU here, so .*; on a CPU MJX compiles for minutes; a small run: --config.*",
        ),
        (
            "brax:hopper",
            {},
            "there is no GPU here, so .*; on a CPU brax's physics compile for a minute or more; a .*",
        ),
    ):
        out = Console(file=text, width=200)
        spec = spec if ":" in spec else f"configs/go1.py:{spec}"
        with show.live(out, config(spec, **fields)) as callbacks:
            callbacks.opened()
            found, compiles = text.getvalue().strip().rsplit("compiles for ", 1)
            callbacks.finished()
        assert re.fullmatch(said, found.strip()), found
        engine = "C MuJoCo" if "laptop" in spec else "JAX" if "brax" in spec else "MJX-JAX"
        assert compiles.startswith(f"{engine} (") and "minutes" in compiles
        text.truncate(text.seek(0))


def test_on_rough_ground_no_other_task_is_proposed_without_a_gpu(monkeypatch):
    """`:laptop` is on a floor. It says what experiments/28_rough measured, and which policy there is."""
    those = [name for name in files.bundled() if name != "g1_rough"]
    monkeypatch.setattr(files, "bundled", lambda: those)
    for robot, bundled in (("go2", True), ("g1", False)):
        line = show.on_a_cpu(config(f"configs/{robot}.py:rough"), {"task.scan": "grid"})
        assert line.startswith(
            "there is no GPU here, so this will be slow; on a CPU MJX compiles for minutes"
        )
        assert "--config.physics.impl=c; no variant of rough ground is made for a CPU" in line
        assert "laptop" not in line and "docs/terrain.md" in line
        assert (f"play {robot}_rough --out=walk.html" in line) == bundled
    page = (ROOT / "docs" / "terrain.md").read_text()
    assert "## Without a GPU" in page
    assert show.on_a_cpu(config("configs/go2.py:rough", device="cpu"), {}).startswith(
        "on a CPU MJX"
    )


def test_what_is_proposed_without_a_gpu_keeps_the_users_task(tmp_path, monkeypatch):
    """Terms of one's own, and other fields of the task; not those of a run on a GPU."""
    monkeypatch.chdir(tmp_path)
    term = "@terms.reward(weight=1.0)\ndef lift(command): return 0.0\n"
    (tmp_path / "mine.py").write_text(f"from dynappo import terms\n\n{term}")
    words = [
        "--terms=mine.py",
        "--config.task.weights.lift=2",
        "--config.task.command_x=(0.0, 2.0)",
    ]
    command = train_command.parse(["--config=go1", *words, "--config.run.seed", "3"])
    assert command.given["run.seed"] == "3" and command.config.run.seed == 3
    text = io.StringIO()
    out = Console(file=text, width=400)
    with show.live(out, command.config, command.given) as callbacks:
        callbacks.opened()
    line = shell_lib.line("train", "--config=go1:laptop", *words)
    assert f"made for a CPU: {line}\n" in text.getvalue()
    _, _, *again = shlex.split(line.removeprefix(shell_lib.command_line()))
    found = train_command.parse(["--config=go1:laptop", *again]).config
    assert (found.task.weights.lift, found.task.command_x) == (2.0, (0.0, 2.0))


EVALUATION = {"return": 5.5, "fall_rate": 0.125, "tracking_error": 0.31, "yaw_error": 0.42}
COST = {"impl": "c", "sim_steps": 2_345_678, "seconds": 61.2, "compile_seconds": 20.0}
SUMMARY = COST | {"return": 3.25, "return_max": 4.5, "evaluation": EVALUATION, "video": "a.mp4"}
NOBODY = EVALUATION | {"tracking_error": None, "yaw_error": None}
TABLES = {  # what differs in the summary, what is shown, what is not
    "one seed": (
        {},
        "3.25 | 4.50 | 2.35 M on C MuJoCo | 61.2 s | 5.50 | 12.50 % | 0.31 m/s | a.mp4",
        "seeds",
    ),
    "two seeds": (
        {"return": [3.0, 3.5], "evaluation": {"fall_rate": [0.1, 0.3]}},
        "3.25 (2 seeds: 3.00 to 3.50) | 20.00 % (2 seeds: 10.00 to 30.00)",
        "nan",
    ),
    "no episode ended": (
        {"return": float("nan"), "return_max": None},
        "best return | no episode has ended",
        "nan",
    ),
    "nobody stood": ({"evaluation": NOBODY}, "tracking error | nobody stood for a second", "None"),
    "one of two stood": (
        {"evaluation": {"tracking_error": [None, 0.5]}},
        "0.50 m/s",
        "None",
    ),
    "what came after": (
        {"evaluation_seconds": 3.14, "video_seconds": 12.3},
        "after training | evaluation 3.1 s, film 12.3 s",
        "nan",
    ),
    "no film": ({"evaluation_seconds": 3.14}, "after training | evaluation 3.1 s", "film"),
    "no evaluation": ({"evaluation": {}}, "3.25 | runs/x: metrics.csv", "evaluation:"),
}


@pytest.mark.parametrize("name", TABLES)
def test_the_last_table_has_the_numbers_and_what_to_do_next(name):
    change, shown, hidden = TABLES[name]
    text = io.StringIO()
    out, run = Console(file=text, width=120), config("configs/go1.py:quick")
    show.summary(out, run, pathlib.Path("runs/x"), SUMMARY | change)
    found = text.getvalue()
    assert all(part in found for part in shown.split(" | ")) and hidden not in found
    assert f"see it: {shell_lib.command_line()} play runs/x --out=walk.html" in found
    assert f"next: {shell_lib.command_line()} train --config=go1" in found


@pytest.mark.parametrize(
    ("platform", "name", "iterations", "there", "said"),
    [
        (
            *("cpu", "go1:laptop", 20, ["go1-laptop"]),
            "--workdir=runs/x --config.run.num_iterations=400 --config.run.log_every=10  "
            "(goes on with this one)",
        ),
        ("cpu", "go1:quick", 20, [], "--config=go1:laptop  (made for a CPU)"),
        (
            *("cpu", "go1:quick", 20, ["go1-laptop", "go1-laptop-2"]),
            "--config=go1:laptop --workdir=runs/go1-laptop-3  (made for a CPU)",
        ),
        ("cpu", "go1:laptop", 400, [], "--config=go1  (on a GPU)"),
        ("gpu", "go1:laptop", 20, [], "--config=go1  (on a GPU)"),
        ("gpu", "go1:laptop", 20, ["go1"], "--config=go1 --workdir=runs/go1-2  (on a GPU)"),
    ],
)
def test_the_next_run_is_one_for_this_machine_and_is_not_refused(
    platform, name, iterations, there, said, monkeypatch, tmp_path
):
    """A short `:laptop` goes on; a new run has a folder that is free."""
    monkeypatch.chdir(tmp_path)
    for folder in there:
        pathlib.Path("runs", folder).mkdir(parents=True)
    monkeypatch.setattr(show.devices, "local", lambda _: SimpleNamespace(platform=platform))
    text, run = io.StringIO(), config(name, num_iterations=iterations)
    show.summary(Console(file=text, width=200), run, pathlib.Path("runs/x"), SUMMARY)
    assert f" train {said}\n" in text.getvalue()


@pytest.mark.parametrize("iterations", [2, 3, 7, 20, 190])
def test_a_short_run_is_told_a_command_that_goes_on(iterations, monkeypatch, tmp_path):
    """Which `train` takes for the run's own folder, however short the chunks of the first were."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(show.devices, "local", lambda _: SimpleNamespace(platform="cpu"))
    every = math.gcd(iterations, 10)
    text, run = io.StringIO(), config("go1:laptop", num_iterations=iterations, log_every=every)
    pathlib.Path("runs/x").mkdir(parents=True)
    pathlib.Path("runs/x/config.json").write_text(config_lib.to_json(run))
    show.summary(Console(file=text, width=200), run, pathlib.Path("runs/x"), SUMMARY)
    (line,) = [line for line in text.getvalue().splitlines() if line.startswith("next: ")]
    words = shlex.split(line.partition(" train ")[2].partition("  (goes on with this one)")[0])
    asked = train_command.parse(words)
    assert asked.workdir == pathlib.Path("runs/x") and asked.config.run.num_iterations == 400
    same = config_lib.validate(config_lib.load("go1:laptop"))
    assert all(asked.config[group] == same[group] for group in ("rollout", "schedule", "ppo"))


def test_where_a_longer_run_would_be_refused_a_new_one_is_told(monkeypatch):
    """`eval_every` of the short one is no multiple of the longer one's chunks."""
    monkeypatch.setattr(show.devices, "local", lambda _: SimpleNamespace(platform="cpu"))
    fields = dict(num_iterations=21, log_every=7, eval_every=7, checkpoint_every=7)
    text, run = io.StringIO(), config("go1:laptop", **fields)
    show.summary(Console(file=text, width=200), run, pathlib.Path("runs/x"), SUMMARY)
    assert " train --config=go1:laptop" in text.getvalue()


def test_a_robot_without_a_config_of_its_name_has_a_next_run(monkeypatch):
    monkeypatch.setattr(show.devices, "local", lambda _: SimpleNamespace(platform="cpu"))
    text, run = io.StringIO(), ml_collections.ConfigDict(config("go1:quick", num_iterations=20))
    run.robot = "nobody"
    show.summary(Console(file=text, width=200), run, pathlib.Path("runs/x"), SUMMARY)
    assert " train --config=nobody:laptop  (made for a CPU)\n" in text.getvalue()


def test_of_a_short_run_the_return_is_of_all_its_iterations():
    text, run = io.StringIO(), config("go1:quick", num_iterations=4)
    show.summary(Console(file=text, width=200), run, pathlib.Path("runs/x"), SUMMARY)
    assert "return (last 4 iterations)" in text.getvalue()


def test_the_pace_of_a_log_is_no_simulators(monkeypatch):
    monkeypatch.setattr(show, "describe_program", lambda *_: None)
    text, settings = io.StringIO(), config_lib.load("go1:laptop")
    settings.run.logs = "walked.npz"
    numbers = dict(episode_length=5.0, policy_std=0.5, episode_return=1.0, seconds=1.0, sim_steps=9)
    with show.live(Console(file=text, width=200), settings) as callbacks:
        callbacks.compiled(SimpleNamespace(impl="c"))
        callbacks.progress(400, [numbers])
    assert "k steps/s of the log\n" in text.getvalue()


@pytest.mark.parametrize("field", ["task.observation=onboard", "task.history=2"])
def test_where_the_policy_sees_something_else_no_other_task_is_proposed(field):
    text = io.StringIO()
    run = config_lib.validate(flags.load("go1:quick", [f"--config.{field}"]))
    show.summary(Console(file=text, width=120), run, pathlib.Path("runs/x"), SUMMARY)
    assert "see it: " in text.getvalue() and "next: " not in text.getvalue()


def test_a_second_of_evaluation_says_nothing_of_falls_or_standing():
    """No errors are measured in it: nobody fell, and nobody is said to have fallen."""
    text, short = io.StringIO(), config("configs/go1.py:quick", eval_steps=50)
    numbers = SUMMARY | {"evaluation": NOBODY | {"fall_rate": 0.0}}
    show.summary(Console(file=text, width=120), short, pathlib.Path("runs/x"), numbers)
    found = text.getvalue()
    assert "0.00 %" in found and found.count("not measured in the first second") == 2
    assert "stood" not in found and "falls" not in found


@pytest.mark.parametrize("spec", ["configs/go1.py:quick", "playground:Go1Getup"])
def test_a_policy_whose_film_has_failed_is_not_said_to_be_seen(spec):
    """`play` would fail alike. Where only the renderer is missing, a page can be written."""
    for change, seen in (({}, True), ({"playable": False}, False)):
        text, lacking = io.StringIO(), SUMMARY | {"video": "no video: ..."} | change
        show.summary(Console(file=text, width=120), config(spec), pathlib.Path("runs/x"), lacking)
        assert "no video: ..." in text.getvalue() and ("see it: " in text.getvalue()) == seen


def test_brackets_are_no_markup():
    """What installs an extra, and a folder's name."""
    text, lacking = io.StringIO(), SUMMARY | {"video": "no video: pip install -e '.[video]'"}
    folder = pathlib.Path("runs/[bold]x")
    show.summary(Console(file=text, width=120), config("configs/go1.py:quick"), folder, lacking)
    assert "'.[video]'" in text.getvalue() and "play 'runs/[bold]x' " in text.getvalue()

"""The command `python -m dynappo.bench`: what it reads, prints and writes."""

import json

import numpy as np
import pytest
from answers import mistake, status
from ml_collections import config_dict

from dynappo.bench import command as bench_command

GO1 = "--config=configs/go1.py:quick"


@pytest.mark.parametrize(
    ("argv", "text"),
    [
        ([], "--config is missing"),
        ([GO1, "--repeats=0"], "--repeats='0': expected an integer of 1 or more"),
        ([GO1, "--repeats=1000000000"], "at most 10,000"),
        ([GO1, "--fast"], "--fast: no such flag"),
        ([GO1, "--engines=c"], "--engines is c, expected two engines of one config"),
        ([GO1, "--engines=c,jax", f"--vs={GO1[9:]}"], "without --vs"),
        (
            [GO1, "--engines=c,cuda"],
            "--engines=c,cuda: physics.impl is 'cuda', expected one of auto, jax, warp, c",
        ),
        ([GO1, "--vs=go1:lap"], "--vs=go1:lap: "),
        ([GO1, "--out=b.csv"], "--out=b.csv: expected a file named .json"),
        ([GO1, "--out=/proc/no/b.json"], "--out=/proc/no/b.json: cannot write there"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(argv, text, capsys):
    assert text in mistake(bench_command.main, argv, capsys)


def test_flags_hold_for_both_configs_and_one_seed_is_measured():
    argv = [GO1, "--vs=configs/go2.py:ppo16", "--config.rollout.num_envs=64"]
    (one, other), names, repeats, out, compiles = bench_command.parse(
        [*argv, "--config.run.num_seeds=4"]
    )
    assert names == ["configs/go1.py:quick", "configs/go2.py:ppo16"]
    assert (one.robot, other.robot, repeats, out) == ("go1", "go2", 5, None) and not compiles
    assert one.rollout.num_envs == other.rollout.num_envs == 64
    assert one.run.num_seeds == other.run.num_seeds == 1


def test_engines_are_one_config_with_each_of_them():
    configs, names, *_ = bench_command.parse([GO1, "--engines=c,jax", "--config.ppo.epochs=3"])
    assert names == ["c", "jax"] == [config.physics.impl for config in configs]
    one, other = (config_dict.ConfigDict(config) for config in configs)
    assert one.ppo.epochs == 3 and one.rollout.num_envs == 256
    other.physics.impl = "c"
    assert one == other


class Program:
    """Of a run that is not compiled."""

    compile_seconds, device, impl, state = 4.0, "cpu", "jax", None
    columns = {"iteration": np.arange(1, 71), "n_real": np.full(70, 20)}


def test_it_prints_a_column_a_config_and_writes_the_same_numbers(tmp_path, monkeypatch, capsys):
    """Phases, rates from them, and the ratio of two configs."""
    asked = []
    for name in ("check", "program"):
        monkeypatch.setattr(
            bench_command.build, name, lambda config: asked.append(config) or Program()
        )
    monkeypatch.setattr(bench_command.devices, "own_process", asked.append)
    ms = {"iteration": 50.0, "physics": 1.5, "tail": 0.25, "fit": 8.0, "ppo": 11.0}
    monkeypatch.setattr(bench_command.phases, "measure", lambda *_: ms)
    ratio = {"ms": [[50.0, 25.0]], "ratio": 0.5, "ratio_min": 0.45, "ratio_max": 0.55}
    monkeypatch.setattr(bench_command.phases, "compare", lambda *_: ratio)
    monkeypatch.setattr(bench_command.phases, "compilation", lambda _: {"cold": 30.0, "warm": 6.0})
    vs, out = "configs/go2.py:quick", tmp_path / "bench.json"
    assert status(bench_command.main, GO1, f"--vs={vs}", "--compile", f"--out={out}") == 0
    text = capsys.readouterr().out
    rows = [line.rsplit(maxsplit=2) for line in text.splitlines() if len(line.split()) > 2]
    assert "cpu, MJX-JAX" in text
    for expected in (
        ["physics, ms a row", "1.50", "1.50"],
        ["ppo, ms", "11.00", "11.00"],
        ["iterations/s", "20.00", "20.00"],
        ["control steps/s", "102,400", "102,400"],  # 256 robots, 20 real rows, 20 times a second
        ["physics steps/s", "409,600", "409,600"],
        ["set-up, warm cache, s", "6.0", "6.0"],
    ):
        assert expected in rows
    assert "memory" not in text  # a CPU does not tell it
    said = f"an iteration of {vs} takes 0.500 of one of configs/go1.py:quick (0.450 to 0.550"
    assert said in " ".join(text.split())
    written = json.loads(out.read_text())
    assert written["versus"] == ratio and list(written["configs"]) == ["configs/go1.py:quick", vs]
    found = written["configs"][vs]
    assert found["ms"] == ms and found["control_steps_per_second"] == 102_400
    assert asked[0] == "auto" and [config.robot for config in asked[1:]] == ["go1", "go2"] * 2


def test_eighty_columns_hold_two_long_names(monkeypatch, capsys):
    """They break; nothing is cut."""
    monkeypatch.setenv("COLUMNS", "80")
    names = [f"configs/a_robot_of_a_long_name_{i}.py:dyna4_noschedule" for i in (1, 2)]
    rates = dict(control_steps_per_second=102_400, physics_steps_per_second=409_600)
    report = dict(device="cpu", impl="c", ms={"iteration": 50.0}, iterations_per_second=20.0)
    report |= rates | dict(peak_bytes=2**30, setup_seconds=6.0)
    bench_command.show(names, [report, report], None)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and not any("…" in line for line in lines)

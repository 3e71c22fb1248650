"""The numbers of the bench: differences of calls, ratios, work and shares; times are not tested."""

import os
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import algorithm, schedule
from dynappo import config as config_lib
from dynappo.bench import phases


def valid(variant):
    return config_lib.validate(config_lib.load(f"configs/go1.py:{variant}"))


def clockwork(monkeypatch, cost, columns):
    """A program whose chunk takes `cost(columns)` seconds an iteration, on a clock of our own."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    def step(hyper, state, given):
        table = {name: np.array(column) for name, column in given.items()}
        now[0] += sum(cost({n: int(c[i]) for n, c in table.items()}) for i in range(2))
        return state

    return SimpleNamespace(hyper=None, state=jnp.zeros(3), columns=columns, step=step)


@pytest.mark.parametrize("model", ["", "to the end", "physics alone at the end"])
def test_the_phases_are_those_of_a_clock_that_knows_them(monkeypatch, model):
    """3 ms a row of physics, 1 a row of the tail, 7 an epoch, 20 of PPO; the schedule ends at 5 of 8."""
    alone = model == "physics alone at the end"
    columns = {"iteration": np.arange(1, 5), "n_real": np.array([8, 7, 6, 8 if alone else 5])}
    columns |= {"model_epochs": np.array([4, 4, 2, 0 if alone else 2])} if model else {}

    def cost(row):
        real, tail = row["n_real"], (8 - row["n_real"]) * bool(model)
        return (3 * real + tail + 7 * row.get("model_epochs", 0) + 20) * 1e-3

    config = SimpleNamespace(
        run=SimpleNamespace(log_every=2), rollout=SimpleNamespace(horizon=8, num_envs=4)
    )
    monkeypatch.setattr(phases, "_tail_row", lambda *_: 1.0)
    program = clockwork(monkeypatch, cost, columns)
    found = phases.measure(config, program, program.state, 3)
    expected = {"iteration": 15 + 20.0, "physics": 3.0, "tail": 0.0, "ppo": 20.0}
    if alone:  # nothing is fitted in the last iterations
        expected = {"iteration": 24 + 20.0, "physics": 3.0, "tail": 1.0, "ppo": 20.0}
    elif model:
        expected = {
            "iteration": 15 + 3 + 14 + 20,
            "physics": 3.0,
            "tail": 1.0,
            "fit": 14,
            "ppo": 20,
        }
    assert found == pytest.approx(expected)


def test_two_configs_take_turns_and_the_ratio_is_of_an_iteration(monkeypatch):
    columns = {"iteration": np.arange(1, 5), "n_real": np.array([8, 7, 6, 5])}
    config = SimpleNamespace(run=SimpleNamespace(log_every=2))
    seen = []

    def cost(seconds):
        return lambda row: seen.append((seconds, row["n_real"])) or seconds

    slow = clockwork(monkeypatch, cost(0.2), columns)
    fast = clockwork(monkeypatch, cost(0.05), columns)
    monkeypatch.setattr(time, "perf_counter", lambda: sum(seconds for seconds, _ in seen))
    found = phases.compare([config, config], [slow, fast], 3)
    np.testing.assert_allclose(found["ms"], [[200.0, 50.0]] * 3)
    assert found["ratio"] == pytest.approx(0.25)
    assert found["ratio_min"] == pytest.approx(found["ratio_max"])
    assert {rows for _, rows in seen} == {5}  # as the schedule ends
    assert [seconds for seconds, _ in seen] == [0.2, 0.2, 0.05, 0.05] * 4


@pytest.mark.parametrize("clean", [False, True])
def test_a_row_of_the_tail_is_timed_on_the_runs_own_model(clean):
    _, static, hyper = toy_env.settings(toy_env.TAIL | {"model.clean": clean})
    env = toy_env.make()
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    program = SimpleNamespace(static=static, env=env, hyper=hyper)
    assert abs(phases._tail_row(program, state, rows=4)) < 1e3  # ms, of which nothing else is said


def test_work_is_that_of_the_products_of_every_layer_counted_one_by_one():
    """PPO: 5 x 4 steps of 16,384 rows through 48-128-128-128-12 and -1; the fit: 25 passes over the 12
    real rows of 4,096 robots, drawn 8 at a time, through 60-256-256-256-256-34. A product [a, b] x
    [b, c] takes 2abc; forward, and for the gradients of weights and input."""
    config = valid("dyna4")
    last = {name: int(column[-1]) for name, column in schedule.columns(config).items()}

    def step(rows, *sizes):
        total = 0
        for i, (a, b) in enumerate(zip(sizes, sizes[1:], strict=False)):
            total += 2 * rows * a * b * (2 if i == 0 else 3)
        return total

    found = phases.work(config, last)
    nets = step(16384, 48, 128, 128, 128, 12) + step(16384, 48, 128, 128, 128, 1)
    assert found["ppo"][0] == 20 * nets and 7.4e9 < nets < 7.42e9
    steps = -(-25 * 12 // 8)
    assert found["fit"][0] == steps * step(8 * 4096, 60, 256, 256, 256, 256, 34)
    assert set(phases.work(valid("ppo16"), {"n_real": 16})) == {"ppo"}


def test_shares_are_of_the_limits_of_the_device_that_is_there():
    """PPO in 9.14 ms on an H200: 17 TFLOP/s of 67 (experiments/03_speed/ppo.md); nothing on a CPU."""
    config = valid("ppo16")
    found = phases.shares(config, "NVIDIA H200", {"n_real": 16}, {"ppo": 9.14})
    assert found["ppo_arithmetic"] == pytest.approx(20 * 7.41e9 / 9.14e-3 / 67e12, rel=0.01)
    assert 0.2 < found["ppo_memory"] < 0.3 and len(found) == 2
    assert phases.shares(config, "cpu", {"n_real": 16}, {"ppo": 9.14}) == {}


def test_best_has_shares_though_its_last_iterations_fit_nothing():
    config = valid("best")
    last = {name: int(column[-1]) for name, column in schedule.columns(config).items()}
    found = phases.shares(config, "NVIDIA H100", last, {"iteration": 2.0, "ppo": 1.0})
    assert last["model_epochs"] == 0 and set(found) == {"ppo_arithmetic", "ppo_memory"}


def test_set_up_is_timed_with_a_cold_and_a_warm_cache_that_are_not_the_users(monkeypatch):
    """A folder of its own, which is gone afterwards; JAX's setting is put back."""
    before, folders = jax.config.jax_compilation_cache_dir, []

    def program(config):
        folders.append(jax.config.jax_compilation_cache_dir)
        return SimpleNamespace(compile_seconds=9.0 / len(folders))

    monkeypatch.setattr(phases.build, "program", program)
    assert phases.compilation(None) == {"cold": 9.0, "warm": 4.5}
    assert folders[0] == folders[1] != before and not os.path.exists(folders[0])
    assert jax.config.jax_compilation_cache_dir == before

"""The numbers of the bench: differences of calls, and ratios; times are not tested."""

import os
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import algorithm
from dynappo.bench import phases


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
    if alone:  # nothing is fitted in the last iterations: the fit is that of the third
        expected = {"iteration": 24 + 20.0, "physics": 3.0, "tail": 1.0, "fit": 14, "ppo": 20.0}
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

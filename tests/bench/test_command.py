"""What the bench reads and how it computes its numbers; times themselves are not tested."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import algorithm
from dynappo.bench import command as bench_command

GO1 = "--config=configs/go1.py:quick"


@pytest.mark.parametrize(
    ("argv", "text"),
    [
        ([], "--config is missing"),
        ([GO1, "--repeats=0"], "--repeats is 0"),
        ([GO1, "--repeats=many"], "invalid int value: 'many'"),
        ([GO1, "--fast"], "--fast: no such flag"),
        ([GO1, "--config.ppo.clip=1"], "--config.ppo.clip: no such field"),
        ([GO1, "--vs=configs/none.py"], "no file 'configs/none.py'"),
        ([GO1, "--out"], "--out: expected one argument; write it as --flag=VALUE"),
        ([GO1, "--out=/no/folder/b.json"], "--out=/no/folder/b.json: cannot write there"),
    ],
)
def test_a_wrong_flag_is_one_line_and_status_2(argv, text, capsys):
    with pytest.raises(SystemExit) as stopped:
        bench_command.main(argv)
    err = capsys.readouterr().err
    assert stopped.value.code == 2 and err.startswith("dynappo: ") and err.count("\n") == 1
    assert text in err


def test_flags_hold_for_both_configs_and_one_seed_is_measured():
    argv = [GO1, "--vs=configs/go2.py:ppo16", "--config.rollout.num_envs=64"]
    (one, other), names, repeats, out, compiles = bench_command.parse(
        [*argv, "--config.run.num_seeds=4"]
    )
    assert names == ["configs/go1.py:quick", "configs/go2.py:ppo16"]
    assert (one.robot, other.robot, repeats, out) == ("go1", "go2", 5, None) and not compiles
    assert one.rollout.num_envs == other.rollout.num_envs == 64
    assert one.run.num_seeds == other.run.num_seeds == 1


def clockwork(monkeypatch, seconds):
    """Programs whose chunk of 2 iterations takes `seconds[name]`, on a clock of our own."""
    now = [0.0]
    monkeypatch.setattr(bench_command.time, "perf_counter", lambda: now[0])

    def program(name):
        def step(hyper, state, columns):
            assert (np.array(columns["n_real"]) == 5).all()  # as the schedule ends
            now[0] += seconds[name]
            return state

        columns = {"iteration": np.arange(1, 5), "n_real": np.array([8, 7, 6, 5])}
        return SimpleNamespace(hyper=None, state=jnp.zeros(3), columns=columns, step=step)

    config = SimpleNamespace(run=SimpleNamespace(log_every=2))
    return [config, config], [program(name) for name in seconds]


def test_ramps_by_error_are_off_because_they_choose_their_own_rows():
    ((config,), *_) = bench_command.parse([GO1, "--config.schedule.by_error=True"])
    assert not config.schedule.by_error


@pytest.mark.parametrize("private", [False, True])
def test_a_row_of_the_tail_is_timed_with_what_the_model_carries(private):
    on = {"model.clean": True, "model.private": private}
    _, static, hyper = toy_env.settings(toy_env.TAIL | on)
    env = toy_env.make()
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    program = SimpleNamespace(static=static, env=env, hyper=hyper)
    assert (
        abs(bench_command._tail_row(program, state, rows=4)) < 1e3
    )  # ms, of which nothing else is said


def test_two_configs_take_turns_and_the_ratio_is_of_an_iteration(monkeypatch):
    configs, programs = clockwork(monkeypatch, {"slow": 0.4, "fast": 0.1})
    found = bench_command.compare(configs, programs, 3)
    np.testing.assert_allclose(found["ms"], [[200.0, 50.0]] * 3)
    assert found["ratio"] == pytest.approx(0.25)
    assert found["ratio_min"] == pytest.approx(found["ratio_max"])


def test_work_is_that_of_the_products_of_every_layer_counted_one_by_one():
    """PPO: 5 x 4 steps of 16,384 rows through 48-128-128-128-12 and -1; the fit: 25 steps of 32,768 rows
    through 60-256-256-256-256-34. A product [a, b] x [b, c] takes 2abc; forward, and for the gradients of
    weights and input."""
    from dynappo import config as config_lib
    from dynappo import schedule

    config = config_lib.validate(config_lib.load("configs/go1.py:dyna4"))
    last = {name: int(column[-1]) for name, column in schedule.columns(config).items()}

    def step(rows, *sizes):
        total = 0
        for i, (a, b) in enumerate(zip(sizes, sizes[1:], strict=False)):
            total += 2 * rows * a * b * (2 if i == 0 else 3)
        return total

    found = bench_command.work(config, last)
    nets = step(16384, 48, 128, 128, 128, 12) + step(16384, 48, 128, 128, 128, 1)
    assert found["ppo"][0] == 20 * nets and 7.4e9 < nets < 7.42e9
    assert found["fit"][0] == 25 * step(32768, 60, 256, 256, 256, 256, 34)
    plain = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
    assert set(bench_command.work(plain, {"n_real": 16})) == {"ppo"}


def test_shares_are_of_the_limits_of_the_device_that_is_there():
    """PPO in 9.14 ms on an H200: 17 TFLOP/s of 67 (experiments/03_speed/ppo.md); nothing on a CPU."""
    from dynappo import config as config_lib

    config = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
    found = bench_command.shares(config, "NVIDIA H200", {"n_real": 16}, {"ppo": 9.14})
    assert found["ppo_arithmetic"] == pytest.approx(20 * 7.41e9 / 9.14e-3 / 67e12, rel=0.01)
    assert 0.2 < found["ppo_memory"] < 0.3 and len(found) == 2
    assert bench_command.shares(config, "cpu", {"n_real": 16}, {"ppo": 9.14}) == {}

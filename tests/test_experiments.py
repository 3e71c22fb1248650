"""The scripts of the paper's tables and figures: their statistics and tables on numbers known by hand.

What trains is `-m slow`: every folder's `run.py --quick`, twice.
"""

import importlib
import itertools
import json
import pathlib
import subprocess
import sys
import types
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import matplotlib.colors as mcolors
import numpy as np
import pytest
import toy_env

from dynappo import algorithm
from dynappo import config as config_lib
from dynappo.policy import policy_file
from dynappo.train import log
from experiments import paper, run

ROOT = pathlib.Path(config_lib.__file__).parent.parent
FOLDERS = (
    "10_ablation 12_platforms 11_model 13_step_time 14_efficiency 15_curves 16_gaits 17_regimes "
    "18_rollouts"
).split()


def module(name):
    return importlib.import_module(f"experiments.{name}")


def keep(folder, name, returns, every=100, **more):
    """Write a run of these returns [I][S] as run.py does: 1000 steps and 2 s an iteration."""
    returns = np.array(returns, float)
    count = np.arange(1, len(returns) + 1)
    metrics = {"iteration": count, "sim_steps": 1000 * count, "seconds": 2.0 * count}
    metrics |= {"episode_return": returns, "policy_std": 1 / (1 + np.abs(np.nan_to_num(returns)))}
    metrics |= {"learning_rate": 0 * returns + 1e-3, "velocity_error": 0 * returns + 0.5} | more
    folder.mkdir(parents=True, exist_ok=True)
    log.append_csv(folder / f"{name}.csv", log.rows(run.kept(metrics)))
    summary: dict = dict(
        sim_steps=1000 * len(returns), seconds=2.0 * len(returns), device="none", impl="jax"
    )
    numbers = {"return": returns[-10:].mean(0), "return_max": np.nanmax(returns, 0)}
    summary |= {n: v.tolist() for n, v in numbers.items()} | {"date": "2026-01-01"}
    summary["policy_std"] = metrics["policy_std"][-10:].mean(0).tolist()
    summary["evaluation"] = {"return": [1.0, 3.0]} | dict.fromkeys(
        ("fall_rate", "tracking_error"), [0.0, 0.5]
    )
    (folder / f"{name}.json").write_text(json.dumps(summary))


# Statistics


def test_welch_is_that_of_scipy_and_of_the_paper():
    one, other = [1.0, 2.0, 4.0, 5.5], [2.0, 4.5, 6.0, 8.0, 10.0]
    assert paper.welch_of(one, other) == pytest.approx(0.12669223536266233)  # ttest_ind
    assert paper.welch_of(other, one) == paper.welch_of(one, other)
    t, df, p = paper.welch((33.35, 0.54, 3), (12.96, 2.68, 3))  # dyna4 and PPO-12 of Table V
    assert (round(t, 2), round(df, 2), round(p, 4)) == (12.92, 2.16, 0.0044)


def test_one_seed_says_nothing_of_the_next():
    cells = paper.spread("x", [2.0])
    assert cells["x_mean"] == 2 and all(np.isnan(cells[f"x_{n}"]) for n in ("sd", "low", "high"))
    assert np.isnan(paper.welch_of([2.0], [1.0, 3.0])) and np.isnan(
        paper.welch_of([2.0] * 3, [2.0] * 3)
    )
    assert np.isnan(paper.spread("x", [np.nan])["x_mean"])


def test_spread_is_over_the_seeds_that_have_a_number():
    cells = paper.spread("x", [1.0, 2.0, np.nan, 6.0])
    assert cells["x_mean"] == 3 and cells["x_sd"] == pytest.approx(np.sqrt(7.0))
    assert 1 <= cells["x_low"] < 3 < cells["x_high"] <= 6


def test_a_threshold_is_reached_where_the_return_first_is_there(tmp_path):
    nan = np.nan
    keep(tmp_path, "a", [[nan, nan, nan], [5, 9, 1], [9, 3, 2], [4, 12, 3]])
    found = paper.load(tmp_path, "a")
    assert found and paper.load(tmp_path, "b") is None
    took = paper.reached(found, 9.0)
    np.testing.assert_array_equal(took["iteration"], [3, 2, nan])
    np.testing.assert_array_equal(took["sim_steps"], [3000, 2000, nan])
    np.testing.assert_array_equal(took["seconds"], [6, 4, nan])
    every = paper.reached(found, 9.0, 2)  # iterations 2 and 4 only
    np.testing.assert_array_equal(every["iteration"], [nan, 2, nan])


@pytest.mark.parametrize(
    ("variant", "iteration", "steps", "printed"),
    [
        ("ppo16", 420, 27_525_120, 27.53),
        ("dyna2", 398, 22_822_912, 22.82),
        ("dyna4", 383, 19_636_224, 19.64),
    ],
)
def test_simulator_steps_of_table_6_follow_from_its_iterations(variant, iteration, steps, printed):
    row = paper.pick(paper.table("efficiency"), variant=variant)
    assert (row["iterations"], row["sim_steps_M"]) == (iteration, printed)
    assert paper.sim_steps(f"configs/go1.py:{variant}", iteration) == steps
    assert round(steps / 1e6, 2) == printed
    assert (
        module("14_efficiency.plot").theirs(variant)["paper_sim_steps_M_by_schedule"] == steps / 1e6
    )


# What a run leaves


def test_a_csv_of_500_iterations_and_5_seeds_is_small_and_exact_where_it_counts(tmp_path):
    rng, count = np.random.default_rng(0), np.arange(1, 501)
    metrics = {n: rng.normal(size=(500, 5)) * 10.0 ** rng.integers(-2, 2) for n in run.KEPT}
    metrics |= {"iteration": count, "sim_steps": 49152 * count, "seconds": 0.81234 * count}
    metrics["falls"] = rng.integers(0, 300, (500, 5))
    log.append_csv(tmp_path / "a.csv", log.rows(run.kept(metrics)))
    assert (tmp_path / "a.csv").stat().st_size < 150_000
    read = paper.read(tmp_path / "a.csv")
    np.testing.assert_array_equal(read["sim_steps"][:, 3], metrics["sim_steps"])
    np.testing.assert_allclose(read["episode_return"], metrics["episode_return"], rtol=6e-4)
    every = (count <= 20) | (count % 5 == 0)
    np.testing.assert_array_equal(read["falls"][every], metrics["falls"][every])
    assert np.isnan(read["falls"][~every]).all()
    thin = run.kept(metrics, thin=10)
    np.testing.assert_array_equal(thin["iteration"], np.arange(10, 501, 10))
    assert np.isfinite(thin["kl"]).all()


def test_a_run_that_is_done_is_not_run_again(tmp_path, monkeypatch):
    job = "go1:ppo16:rollout.num_envs=512"
    (tmp_path / "go1_ppo16_rollout.num_envs_512.json").write_text('{"diverged": "kl"}')
    monkeypatch.setattr(run.train, "setup", lambda *_: pytest.fail("trains"))
    run.batch(tmp_path, [job], seeds=3)
    assert run.configure(job, 3, ["rollout.num_envs=64"]).rollout.num_envs == 512
    found = paper.load(tmp_path, run.name(job))
    assert (
        paper.status(found) == "diverged" and paper.status(paper.load(tmp_path, "b")) == "not run"
    )


# Tables


def test_the_ablation_names_its_best_cell_and_what_the_paper_says_of_its_own(tmp_path, monkeypatch):
    ablation = module("10_ablation.plot")
    monkeypatch.setattr(ablation, "OTHERS", tmp_path)
    for n, top in ((12, 4.0), (16, 30.0)):
        returns = [[top, top + 2]] * 20
        keep(tmp_path, run.name(ablation.job(4096, n)), returns)
    rows = ablation.build(tmp_path, ablation.GRID)
    assert len(rows) == 30 and sum(row["status"] == "not run" for row in rows) == 28
    best = ablation.best(rows)
    assert (best["envs"], best["horizon"], best["max_reward_mean"], best["seeds"]) == (
        4096,
        16,
        31,
        2,
    )
    assert best["paper_max_reward"] == 33.3 and best["sim_steps_M"] == 0.02
    ours, printed = ablation.findings(rows)
    assert "largest step R=4096, N 12 to 16: +26.0" in ours
    assert "best 38.2 at R=8192, N=32; 80 % of it 30.56; correlation of policy std" in printed
    assert "-0.95; largest step R=4096, N 12 to 16: +20.4" in printed
    paper.write(tmp_path / "results.csv", rows)
    assert module("14_efficiency.plot").ablation_peak(tmp_path) == 31


def test_a_cell_that_another_folder_has_is_read_from_there(tmp_path, monkeypatch):
    """12_platforms has 4096 robots and 12 rows; not 2048 robots. An own run comes first."""
    ablation = module("10_ablation.plot")
    monkeypatch.setattr(ablation, "OTHERS", tmp_path)
    keep(tmp_path / "12_platforms" / "results", "go1_ppo12", [[7.0] * 5] * 12)
    cells = ablation.build(tmp_path / "own", [(2048, 12), (4096, 12)])
    assert [cell["status"] for cell in cells] == ["not run", ""]
    assert (cells[1]["seeds"], cells[1]["max_reward_mean"]) == (5, 7)
    other = run.configure("go1:ppo12", 5).to_dict()
    assert run.configure(ablation.job(4096, 12), 5).to_dict() == other  # the same setting
    keep(tmp_path / "own", run.name(ablation.job(4096, 12)), [[3.0] * 3] * 12)
    assert ablation.build(tmp_path / "own", [(4096, 12)])[0]["seeds"] == 3
    for cell, path in ablation.ELSEWHERE.items():
        known = paper.load((ROOT / "experiments" / path).parent, pathlib.Path(path).name)
        assert (
            known
            and len(paper.peak(known)) == 5
            and known.columns["sim_steps"][-1, 0] == (500 * np.prod(cell))
        )


def test_regimes_are_judged_by_the_threshold_of_their_task(tmp_path, monkeypatch):
    regimes = module("17_regimes.plot")
    few, usual = regimes.Regime("few", 64), regimes.Regime("usual", 4096)
    words = regimes.Regime("words", 64, "task.formulation=paper_text")
    monkeypatch.setattr(regimes, "__file__", str(tmp_path / "17_regimes" / "plot.py"))
    jobs = {
        (usual, "ppo16"): [[10, 10], [20, 30], [40, 40]],  # 80 % of 40 is 32
        (few, "ppo16"): [[1, 1], [31, 33], [31, 34]],
        (few, "dyna4"): [[33, 35], [34, 34], [34, 34]],
        (words, "ppo16"): [[1, 1], [6, 9], [10, 10]],  # of its own task: 8
    }
    for (regime, variant), returns in jobs.items():  # each return for ten iterations
        keep(tmp_path, run.name(regimes.job(regime, variant)), np.repeat(returns, 10, 0))
    rows = regimes.build(tmp_path, [few, usual, words])
    assert len(rows) == 3 * len(regimes.VARIANTS)
    one = paper.pick(rows, regime="few", variant="ppo16")
    assert (one["limit"], one["success_rate_pct"], one["sim_steps_M_mean"]) == (32, 50, 0.02)
    tail = paper.pick(rows, regime="few", variant="dyna4")
    assert (tail["success_rate_pct"], tail["share_of_ppo16_pct"]) == (100, 50)
    assert tail["p_vs_ppo16"] == paper.welch_of([34, 35], [31, 34])
    own = paper.pick(rows, regime="words", variant="ppo16")
    assert (own["limit"], own["sim_steps_M_mean"]) == (8, 0.025)
    regimes.draw(rows, [few, usual, words], tmp_path / "regimes")
    assert (tmp_path / "regimes.svg").exists()


def test_every_regime_is_a_valid_config_with_a_name_of_its_own():
    regimes = module("17_regimes.plot")
    jobs = [regimes.job(r, v) for r in regimes.REGIMES for v in regimes.VARIANTS]
    configs = [run.configure(job, 3) for job in jobs]
    assert len({run.name(job) for job in jobs}) == len(jobs) == len({str(c) for c in configs})
    task = configs[-1].task
    assert (task.randomize.base_mass, task.noise.joint_vel) == ((0.0, 0.0), 0.0)


def test_a_regime_is_read_from_the_folder_that_has_it(tmp_path, monkeypatch):
    regimes = module("17_regimes.plot")
    monkeypatch.setattr(regimes, "__file__", str(tmp_path / "17_regimes" / "plot.py"))
    cell = regimes.Regime("", 2048)
    ablation = module("10_ablation.plot")
    assert regimes.job(cell, "ppo12") == ablation.job(2048, 12)
    for folder, name in (
        ("10_ablation", run.name(ablation.job(2048, 12))),
        ("10_ablation", run.name(ablation.job(2048, 24))),
        ("20_tail", "go1_best_2048"),
        ("12_platforms", "go1_dyna4"),  # 4096 robots
    ):
        keep(tmp_path / folder / "results", name, [[1.0, 2.0]] * 12)
    have = [v for v in regimes.VARIANTS if regimes.found(tmp_path, cell, v)]
    assert have == ["ppo12", "best", "ppo24"]
    assert regimes.found(tmp_path, regimes.Regime("", 4096), "dyna4")
    other = regimes.Regime("", 2048, "task.formulation=paper_text")
    assert not any(regimes.found(tmp_path, other, v) for v in regimes.VARIANTS)


def test_tails_are_compared_with_the_real_rows_that_they_stand_for(tmp_path, monkeypatch):
    """24 rows of 1024 robots: 20 real and 4 of the model, against PPO with 20 and with 24."""
    regimes = module("17_regimes.plot")
    monkeypatch.setitem(sys.modules, "plot", regimes)  # as a script of the folder finds it
    cliff = module("17_regimes.cliff")
    monkeypatch.setattr(regimes, "__file__", str(tmp_path / "17_regimes" / "plot.py"))
    ablation, folder = tmp_path / "10_ablation" / "results", tmp_path / "17_regimes" / "results"
    assert len(cliff.jobs(folder)) == 6
    configs = [run.configure(job, 5) for job in cliff.jobs(folder)]
    assert sorted(c.rollout.horizon for c in configs) == [16, 16, 20, 20, 24, 24]
    assert {c.rollout.num_envs for c in configs} == {1024}
    returns = {20: [10.0, 14.0], 24: [30.0, 34.0]}
    for rows, last in returns.items():
        job = module("10_ablation.plot").job(1024, rows)
        keep(ablation, run.name(job), [last] * 10)
    keep(folder, "go1_dyna4_rollout.num_envs_1024_rollout.horizon_24", [[20.0, 28.0]] * 10)
    keep(tmp_path / "12_platforms" / "results", "go1_ppo16", [[30.0, 30.0]] * 10)  # limit 24
    assert len(cliff.jobs(folder)) == 5
    rows = cliff.build(folder)
    assert [row["status"] for row in rows].count("") == 4  # PPO-20 is in two groups
    tail = paper.pick(rows, variant="dyna4", rows=24)
    assert (tail["max_reward_mean"], tail["success_rate_pct"], tail["sim_steps_M_mean"]) == (
        24,
        50,
        0.01,
    )
    assert tail["p_vs_fewer"] == paper.welch_of([20, 28], returns[20])
    assert tail["p_vs_all"] == paper.welch_of([20, 28], returns[24])
    cliff.make(tmp_path / "17_regimes", [1024])
    assert (tmp_path / "17_regimes" / "cliff.svg").exists()
    pages = []
    monkeypatch.setattr(cliff.paper, "save", lambda page, path: pages.append(page))
    cliff.draw(folder, [1024], tmp_path)
    axis, colour = pages[0].axes[0], cliff.plot.COLOURS["dyna4"]
    drawn = [line for line in axis.lines if line.get_color() == colour and len(line.get_xdata())]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in drawn] == [(20, 24.0)]  # real rows
    ends = [
        line.get_segments()[0].tolist()
        for line in axis.collections
        if mcolors.same_color(line.get_color()[0], colour)
    ]
    assert [[20.0, 24.0], [24.0, 24.0]] in ends  # the model's four rows


def test_the_platforms_are_compared_with_both_baselines_and_the_paper(tmp_path):
    platforms = module("12_platforms.plot")
    keep(tmp_path, "go1_ppo12", [[1.0, 2.0, 4.0, 5.5]] * 12)
    keep(tmp_path, "go1_ppo16", [[30.0, 31.0, 32.0, 35.0]] * 12)
    keep(tmp_path, "go1_dyna4", [[30.5, 31.5, 31.5, 34.5]] * 12)
    rows = platforms.build(tmp_path)
    assert len(rows) == len({(row["robot"], row["variant"]) for row in rows}) == 7 + 3 * 6
    row = paper.pick(rows, robot="go1", variant="dyna4")
    assert (row["max_reward_mean"], row["difference_mean"], row["evaluated_return_mean"]) == (
        32,
        0,
        2,
    )
    assert row["p_evaluated"] == pytest.approx(1)
    assert row["verdict"] == "not worse" and row["difference_low"] == pytest.approx(-0.5, abs=0.1)
    expected = paper.welch_of([30.5, 31.5, 31.5, 34.5], [1.0, 2.0, 4.0, 5.5])
    assert row["p_vs_ppo12"] == expected and 0.9 < row["p_vs_ppo16"] <= 1
    assert round(row["paper_p_vs_ppo16"], 2) == 0.95 and round(row["paper_p_vs_ppo12"], 4) == 0.0044
    worse = platforms.difference(np.array([1.0, 2.0]), np.array([3.0, 4.0]), 1.0)
    assert worse["verdict"] == "worse"
    open_ = platforms.difference(np.array([1.0, 5.0]), np.array([3.0, 4.0]), 1.0)
    assert open_["verdict"] == "not shown"
    missing = paper.pick(rows, robot="anymal_d", variant="dyna2")
    assert missing["status"] == "not run" and missing["paper_max_reward_sd"] == 6.17


def test_our_settings_are_those_of_tables_2_and_3():
    for row in module("12_platforms.plot").settings():
        assert all(row[name] == row[f"paper_{name}"] for name in "Nabxy"), row["variant"]
    network, rate, epochs = module("11_model.plot").settings()
    assert network["ours"].replace(" ", "") == network["paper"].replace(" ", "")
    assert (rate["ours"], epochs["ours"]) == (rate["paper"], epochs["paper"]) == (3e-3, 25)


def test_phase_times_of_table_4_make_the_minutes_of_table_5(tmp_path):
    plot = module("13_step_time.plot")
    rows = plot.build({name: plot.load(tmp_path / "none.json") for name in plot.VARIANTS})
    cells = {row["phase"]: row for row in rows}
    minutes = {name: cells[name]["paper"] * 500 / 60e3 for name, _ in plot.DERIVED[:3]}
    assert [round(m, 2) for m in minutes.values()] == [3.91, 4.94, 4.35]
    assert round(cells["saved by it of PPO-16"]["paper"], 1) == 12.0
    assert cells["physics"]["dyna4"] is None
    ms = dict(physics=4.0, tail=0.5, fit=7.0, ppo=10.0)
    assert plot.derived(ms)["steps from which a tail pays"] == 2
    assert plot.derived(ms)["4-step tail of 16, sum"] == 67
    phases = {name: {"paper": cells[name]["paper"], "ppo16": None, "dyna4": None} for name in ms}
    for name, value in ms.items():
        phases[name] |= {"best": value}
    ours, theirs = plot.bars(phases, True), plot.bars(phases, False)
    assert [found is None for found in ours.values()] == [True, True, False]
    assert ours["best (16 of 24)"] == [8 * 4.0, 16 * 0.5, 7.0, 10.0]
    assert [round(sum(widths or ())) for widths in theirs.values()] == [593, 522]


def test_efficiency_counts_steps_and_success(tmp_path):
    plot = module("14_efficiency.plot")
    rising = np.arange(1, 41)[:, None]  # the return is the iteration
    keep(tmp_path, "go1_ppo16", rising * [1.0, 1.0])
    keep(tmp_path, "go1_dyna4", rising * [2.0, 0.5])
    rows = plot.build(tmp_path, None)
    assert {row["threshold"] for row in rows if row["robot"] == "go2"} == {"80 % of PPO-16"}
    base, dyna = (
        paper.pick(rows, threshold="80 % of PPO-16", variant=v) for v in ("ppo16", "dyna4")
    )
    assert base["limit"] == 32 and base["sim_steps_M_mean"] == 0.032 and base["seconds_mean"] == 64
    assert (dyna["iterations_mean"], dyna["share_of_ppo16_pct"]) == (16, 50)
    assert (base["success_rate_pct"], dyna["success_rate_pct"]) == (100, 50)
    printed = paper.pick(rows, threshold="paper, 30.5", variant="dyna4")
    assert printed["iterations_mean"] == 16 and printed["paper_iterations"] == 383
    best = paper.pick(rows, threshold="80 % of the ablation's best", variant="ppo16")
    assert best["status"] == "no threshold yet" and "seeds" not in best
    with_best = plot.build(tmp_path, 10.0)
    assert paper.pick(with_best, threshold="80 % of the ablation's best")["limit"] == 8


# Measurements


def test_errors_of_the_model_are_those_of_a_loop(monkeypatch):
    """Two predicted numbers of four robots, three rows; a robot that fell is not counted any more."""
    probe = module("11_model.probe")
    rng = np.random.default_rng(0)
    rows = SimpleNamespace(action=rng.normal(size=(3, 4, 1)), next_prop=rng.normal(size=(3, 4, 2)))
    rows.reward, rows.discount = rng.normal(size=(3, 4)), np.ones((3, 4))
    rows.truncation, start = np.zeros((3, 4)), rng.normal(size=(4, 3))
    rows.discount[1, 2] = 0
    rows.next_prop[2, 2] = np.nan  # whatever it does after

    def predict(static, env, model, obs, action, task):
        import jax.numpy as jnp

        return jnp.concatenate([0.5 * obs[:, :2], action], -1), 2 * obs[:, 0], None

    monkeypatch.setattr(probe.dynamics, "predict", predict)
    env = SimpleNamespace(prop_size=2, dt=0.1)
    rmse, spread = probe.errors(env, None, None, None, rows, start)
    obs, robots = start, [0, 1, 2, 3]
    for k in range(3):
        reward, prop = 2 * obs[:, 0] / 0.1, 0.5 * obs[:, :2]
        robots = [r for r in robots if rows.discount[k, r]]
        truth, real = rows.next_prop[k][robots], rows.reward[k][robots] / 0.1
        wrong = (
            np.sqrt(((prop[robots] - truth) ** 2).mean()),
            np.sqrt(((reward[robots] - real) ** 2).mean()),
        )
        np.testing.assert_allclose(rmse[k], wrong, rtol=1e-5)
        np.testing.assert_allclose(spread[k], (np.sqrt(truth.var(0).mean()), real.std()), rtol=1e-5)
        obs = np.concatenate([prop, rows.action[k]], -1)


def test_errors_become_a_table_and_curves():
    probe, plot = module("11_model.probe"), module("11_model.plot")
    rows = []
    for iteration, seed in itertools.product((10, 50), (0, 1)):
        rmse = np.full((16, 6), 1.0 + seed) * np.arange(1, 17)[:, None]
        rows += probe.rows(iteration, seed, rmse, np.full((16, 6), 4.0), plot.STEPS)
    columns = {n: np.array([row[n] for row in rows]) for n in rows[0]}
    columns = {n: c if n == "group" else c.astype(float) for n, c in columns.items()}
    row = paper.pick(plot.build(columns), group="reward (1/s)", steps=4, iteration=50)
    assert (row["rmse_mean"], row["share_of_spread_mean"]) == (6, 1.5)
    x, y = plot.curve(
        columns, "rmse", (columns["group"] == "gravity direction") & (columns["steps"] == 2)
    )
    np.testing.assert_array_equal(x, [10, 50])
    np.testing.assert_array_equal(y, [[2, 4], [2, 4]])
    assert plot.build({}) == [{"group": "all", "status": "not run"}]


def test_swings_are_those_that_begin_and_end():
    gait = module("16_gaits.gait")
    air = np.array([[1, 1, 0, 1, 1, 0, 0, 1, 0, 1], [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]], bool).T
    np.testing.assert_array_equal(gait.air_phases(air), [2, 1])
    poses = np.arange(40.0)[:, None]
    shown = gait.strip({"dt": 0.02, "qpos": poses})[:, 0]
    np.testing.assert_array_equal(np.diff(shown), [3] * (gait.FRAMES - 1))
    assert shown[-1] == 39  # of an episode that ended early, its end


def test_the_bundled_go1_walks_at_half_a_metre_a_second():
    gait = module("16_gaits.gait")
    episode, measures = gait.walk(policy_file.load(ROOT / "robots/go1/policy.npz"), 0.5, 3.0)
    assert len(episode["qpos"]) == 150 and measures["fall"] is None
    assert measures["tracking_error"] < 0.15 and abs(measures["speed_ahead"] - 0.5) < 0.1
    assert 0.05 < measures["air_time"] < 0.4 and measures["swings_per_second"] > 1
    assert 0 < measures["tilt"] < 10


def test_figures_are_made_of_what_is_there(tmp_path, monkeypatch):
    """All variants of Go1 for the pages of curves: no SVG is large. Nothing at all for the others."""
    rng, folder = np.random.default_rng(0), tmp_path / "12_platforms" / "results"
    for variant in (*paper.VARIANTS, *paper.OURS):
        keep(folder, f"go1_{variant}", rng.normal(20, 3, (500, 5)))
    module("15_curves.plot").make(tmp_path, folder)
    assert (tmp_path / "go1.png").exists() and (tmp_path / "go1.svg").stat().st_size < 300_000
    assert not (tmp_path / "go2.png").exists()
    rows = (tmp_path / "results.csv").read_text().splitlines()
    assert len(rows) == 1 + 7 * 6 + 3 * 6  # six iterations of the seven, and three robots not run
    module("16_gaits.plot").make(tmp_path / "none")
    assert "not run" in (tmp_path / "none" / "results.csv").read_text()
    assert (tmp_path / "none" / "measures.svg").exists()


def test_tails_begin_where_physics_ended_and_overlap_the_next_rollouts(monkeypatch, tmp_path):
    """By hand: numbers of a buffer; and in the committed rows the real ones are one curve."""
    plot = module("18_rollouts.plot")
    rng, buffers = np.random.default_rng(0), []
    for i in range(plot.KEPT):
        obs = np.zeros((24, 4, 48))
        obs[..., plot.observe.COMMAND.start] = [
            0.2,
            0.9,
            0.5,
            0.7 + (i == 3),
        ]  # the last is told anew
        one = np.ones((24, 4))
        one[3, 1] = 0  # the fastest falls
        one[20, 2] = 0  # in a tail, where physics does not
        buffer = dict(obs=obs, next_prop=rng.normal(size=(24, 4, 33)), reward=one, discount=one)
        buffers.append(types.SimpleNamespace(**buffer, truncation=0 * one))
    assert plot.steady(buffers).tolist() == [True, False, True, False]
    rows, k = plot.rows(buffers, 0.02), plot.CURVES["calf"][0]
    assert len(rows) == 24 * plot.KEPT
    for row, i, t in ((rows[30], 1, 6), (rows[40], 1, 16)):
        assert (row["rollout"], row["step"], row["synthetic"]) == (f"{i}", f"{t}", f"{int(t >= 8)}")
        assert float(row["time"]) == pytest.approx((8 * i + t + 1) * 0.02)
        assert float(row["calf"]) == pytest.approx(buffers[i].next_prop[t, 2, k], rel=1e-4)
    errors = plot.distance(buffers)
    assert [row["row"] for row in errors] == list(range(1, 17))
    for t, later, at in ((8, 1, 0), (15, 1, 7), (16, 2, 0), (23, 2, 7)):
        tail, still = [], []
        for i in range(plot.TAILS):
            for robot in (0, 2):
                went = buffers[i + later].next_prop[at, robot, k]
                tail.append(buffers[i].next_prop[t, robot, k] - went)
                still.append(buffers[i].next_prop[7, robot, k] - went)
        row = errors[t - 8]
        assert float(row["calf_tail"]) == pytest.approx(np.sqrt(np.mean(np.square(tail))), rel=1e-3)
        assert float(row["calf_still"]) == pytest.approx(
            np.sqrt(np.mean(np.square(still))), rel=1e-3
        )


def test_figures_1_to_3_are_drawn_from_the_schedule_and_the_rows(tmp_path, monkeypatch):
    """Tails start at the anchor, the last real row; `best` has 8 real rows from iteration 20 on."""
    plot, pages = module("18_rollouts.plot"), {}
    monkeypatch.setattr(plot.paper, "save", lambda page, path: pages.update({path.name: page}))
    folder = ROOT / "experiments" / "18_rollouts" / "results"
    plot.draw_tail(paper.read(folder / "rows.csv"), tmp_path / "tail")
    kept = {n: column[:, 0] for n, column in paper.read(folder / "rows.csv").items()}
    lines = pages["tail"].axes[2].lines[1:]
    assert len(lines) == 2 * plot.TAILS
    for i, (line, anchor) in enumerate(zip(lines[::2], lines[1::2], strict=True)):
        ((x,), (y,)) = anchor.get_data()
        last = (kept["rollout"] == i) & (kept["step"] == plot.REAL - 1)
        assert (x, y) == (kept["time"][last], kept["calf"][last])
        assert len(line.get_xdata()) == 17 and line.get_xdata()[0] == x
    plot.draw_overview(tmp_path / "overview")
    real, tail = pages["overview"].axes[2].collections
    assert real.get_paths()[0].contains_point((100, 7.9)) and tail.get_paths()[0].contains_point(
        (100, 8.1)
    )
    plot.draw_model(tmp_path / "model")
    assert set(pages) == {"tail", "overview", "model"}


def test_the_kept_rollouts_go_on_from_their_anchors():
    """The committed rows: the real ones are one curve, which tails leave without a jump."""
    plot = module("18_rollouts.plot")
    kept = paper.read(ROOT / "experiments" / "18_rollouts" / "results" / "rows.csv")
    kept = {name: column[:, 0] for name, column in kept.items()}
    real = kept["synthetic"] == 0
    np.testing.assert_allclose(np.diff(kept["time"][real]), 0.02, atol=1e-6)
    for name in ("thigh", "calf"):  # from row to row less than 10 rad/s, at anchors too
        assert np.abs(np.diff(kept[name][real])).max() < 0.2
        begins = kept["step"] == plot.REAL
        anchors = kept["step"] == plot.REAL - 1
        assert np.abs(kept[name][begins] - kept[name][anchors]).max() < 0.2


# All of it

TOY = (
    "run.device=cpu rollout.num_envs=16 rollout.horizon=8 run.num_iterations=4 run.log_every=2 "
    "run.checkpoint_every=0 run.eval_envs=0 model.hidden=(8,) model.epochs=1 ppo.hidden=(8,) "
    "ppo.epochs=1 ppo.minibatches=2 schedule.start_iteration=1 schedule.end_iteration=3"
).split()


def test_chunks_train_as_the_loop_does_and_hand_out_the_state(tmp_path, monkeypatch):
    """With the toy environment: run.py's CSV against `paper.chunks`, and the probe of its model."""
    import toy_env

    from dynappo.task import env as env_lib

    monkeypatch.setattr(env_lib, "make", lambda *_, **__: toy_env.make())
    run.batch(tmp_path, ["go1:dyna4"], 2, TOY)
    found = paper.load(tmp_path, "go1_dyna4")
    assert found and found.columns["sim_steps"][-1, 0] == 16 * np.sum([8, 6, 4, 4])
    assert len(found.summary["policy_std"]) == 2
    ask, done, std = None, [], []
    for program, iteration, state, metrics in paper.chunks(run.configure("go1:dyna4", 2, TOY)):
        done.append(iteration)
        std += metrics["policy_std"].tolist()
        ask = ask or module("11_model.probe").compiled(program)
        rmse, spread = map(np.asarray, ask(state))
        assert rmse.shape == spread.shape == (2, 8, 2) and np.isfinite(rmse).all()
        assert (rmse > 0).all() and (rmse[0] != rmse[1]).all()  # seeds differ
    assert done == [2, 4]
    np.testing.assert_allclose(found.columns["policy_std"], std, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_every_folder_runs_on_two_cores_and_again_from_what_is_there(tmp_path):
    """In the order in which they read each other's runs; in a working directory of its own."""
    for name in ("configs", "robots"):
        (tmp_path / name).symlink_to(ROOT / name)
    for folder in FOLDERS:
        command = [sys.executable, ROOT / "experiments" / folder / "run.py", "--quick"]
        out = tmp_path / "runs" / "quick" / folder
        subprocess.run(command, check=True, cwd=tmp_path, timeout=900)
        first = (out / "results.csv").read_bytes()
        trained = {p: p.stat().st_mtime_ns for p in out.glob("results/*")}
        subprocess.run(command, check=True, cwd=tmp_path, timeout=60)
        assert (out / "results.csv").read_bytes() == first
        assert {p: p.stat().st_mtime_ns for p in out.glob("results/*")} == trained
        assert list(out.glob("*.png")) and list(out.glob("*.svg"))


# 20_tail


def test_the_tail_table_counts_steps_seconds_and_pairs_seeds(tmp_path, monkeypatch):
    """Two runs of two seeds by hand; the second has the return of all episodes, the third nothing."""
    compare = module("20_tail.compare")
    monkeypatch.setattr(compare, "FOLDERS", (tmp_path,))
    keep(tmp_path, "base", [[0.0, 0.0], [4.0, 5.0], [9.0, 7.0], [10.0, 10.0]])
    keep(tmp_path, "tail", [[8.0, 1.0], [9.0, 8.5], [11.0, 12.0], [12.0, 12.0]])
    base, tail, none = compare.table("group", ("base", "tail", "missing"))
    assert none == {"group": "group", "run": "missing"}
    assert base["limit"] == tail["limit"] == 8.0 and tail["seeds"] == "2 of 2"
    assert base["steps_M_mean"] == pytest.approx((3000 + 4000) / 2 / 1e6)
    assert tail["steps_M_mean"] == pytest.approx((1000 + 2000) / 2 / 1e6)
    assert tail["share_pct"] == tail["seconds_share_pct"] == pytest.approx(100 * 1.5 / 3.5)
    difference = np.array([10.0, 8.375]) - [5.75, 5.5]
    assert difference.min() <= tail["difference_low"] <= tail["difference_high"] <= difference.max()
    assert np.isnan(tail["all_low"]) and tail["evaluated_low"] == tail["evaluated_high"] == 0


def test_the_model_is_measured_offline_on_rows_that_it_has_not_seen():
    """On the toy: the policy stays as it is, eight rows an iteration, and the error falls."""
    offline = module("20_tail.offline")
    config, static, hyper = toy_env.settings(
        toy_env.TAIL | {"rollout.horizon": 12, "model.clean": True, "model.minibatches": 3}
    )
    env = toy_env.make()
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    step = jax.jit(partial(offline.iterate, env, static=static))
    learner, errors = state.learner, []
    for i in range(12):
        state, found = step(hyper, state, jnp.int32(i), jnp.int32(5))
        errors.append({name: float(value) for name, value in found.items()})
    assert {"model_error_1", "model_error_4", "model_error_8", "falls", "loss"} == set(errors[0])
    assert errors[0]["model_error_1"] > 0.8 and errors[-1]["model_error_1"] < 0.5
    for one, other in zip(*map(jax.tree.leaves, (learner, state.learner)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert offline.configure("model.unroll=3:model.history=0", 64).model.unroll == 3

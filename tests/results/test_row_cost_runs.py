"""30_row_cost: how seconds are counted and computed, its jobs, and the command that runs them alone."""

import csv
import re
import shutil
import sys
import types

import jax.numpy as jnp
import numpy as np
import pytest
from result_files import (
    EXPERIMENTS,
    ROW_COST,
    script,
)

from dynappo import schedule
from dynappo.terrain import tiles
from experiments import paper


def test_what_ran_next_has_enough_iterations_to_get_to_the_level():
    """PPO with 4096 robots, by its runs with our kernel and those of half as many at the place."""
    table, measure = script(f"{ROW_COST}/table"), script(f"{ROW_COST}/run")
    lines = [
        line.split() for line in (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    ]
    jobs = {name: measure.read(job, fields) for name, job, *fields in lines}
    found = table.runs()
    kernel = [
        x for x in found if (x.place, x.method) == ("go1.kernel", "ppo4096") and len(x.level) > 1
    ]
    kernel_walks = max(one.walks[:, 0].max() for one in kernel)
    for place in ("go1.warp", "go1.exact", "anymal_c.exact", "go1.jax"):
        job, half = jobs[f"{place}.ppo4096"], jobs[f"{place}.ppo2048"]
        ran = [x.level[:, 0].max() for x in found if (x.place, x.method) == (place, "ppo2048")]
        assert measure.ends(job.config)[-1] >= max(kernel_walks, *ran)
        assert job.config.rollout.num_envs == 4096 and job.seeds == 5
        same = half.text.replace("num_envs=2048", "num_envs=4096").rpartition(" ")[0]
        assert job.text.rpartition(" ")[0] == same and job.episodes == half.episodes


def test_seconds_are_counted_to_the_level_and_until_it_walks(tmp_path, monkeypatch):
    table = script(f"{ROW_COST}/table")
    about = {"batch": "G, day", "name": "go1.kernel.best", "job": "go1:best rollout.num_envs=512"}
    found = []
    for seed, folder, clock in (("0", "a", 2.0), ("0", "b", 4.0), ("1", "a", 6.0)):
        for at, value in ((10, 20.0), (20, 38.5), (30, 37.0), (40, 39.0)):
            row = {"seed": seed, "run": folder, "iteration": at, "sim_steps": at * 1000}
            row |= {"seconds": clock * at, "return": value, "fall_rate": "0.01", "row_ms": "0.2"}
            found.append(about | row)
    (run,) = table.of_rows(found)
    assert run[:4] == ("go1.kernel", "G, day", "best", 512) and run.row == 0.2
    assert run.end == 40_000 and run.last == np.mean([80, 160, 240])  # of whole runs
    # a seed's clock is the median of its runs: 60 and 120; it walks after the relapse at 30
    np.testing.assert_allclose(run.level, [[20, 20_000, 60], [20, 20_000, 120]])
    np.testing.assert_allclose(run.walks, [[40, 40_000, 120], [40, 40_000, 240]])
    assert table.cells(run.walks) == ["2", "0.04", "180.00"]
    # once more, by a rule set before: the same setting
    for job, method in (
        ("best", "best"),
        ("ppo2048-walk", "ppo2048-walk"),
        ("n2048", "best-n2048"),
    ):
        (again,) = table.of_rows([row | {"name": f"go1.kernel.again-{job}"} for row in found])
        assert again.method == method and again.place == "go1.kernel"
    # both in one batch would be two runs with one name
    for name in ("go1.kernel.again-best", "go1.kernel.again-n2048"):
        both = [
            row | {"name": x} for x in (name, name.replace("again-n", "best-n")) for row in found
        ]
        both = [*found, *both]
        with pytest.raises(
            SystemExit, match=r"go1.kernel.best\S* is twice in G, day, once as again-"
        ):
            table.of_rows(both)
    # and is refused before the file is touched
    monkeypatch.setattr(table, "RESULTS", tmp_path / "alone.csv.xz")
    shutil.copy(table.Path(table.__file__).parent / "results/alone.csv.xz", tmp_path)
    columns = [name for name in found[0] if name not in ("batch", "name")]
    for job in ("best", "again-best"):
        with (tmp_path / f"go1.kernel.{job}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(found)
    was = table.RESULTS.read_bytes()
    with pytest.raises(SystemExit, match="is twice in a host, once as again-"):
        table.add("a host", [tmp_path])
    assert table.RESULTS.read_bytes() == was
    low = about | {"seed": "2", "iteration": 1, "sim_steps": 1, "seconds": 1}
    (run,) = table.of_rows([*found, low | {"return": 30.0, "fall_rate": 0.0}])
    assert np.isnan(run.walks[2]).all() and table.cells(run.walks)[0] == "2 of 3"
    assert table.cells(run.walks[2:]) == ["0 of 1", "-", "-"]
    # 90, 60 and 120: mean 90, t(2) 4.303 x 30 / sqrt(3)
    assert table.interval([90, 60, 120]) == "90.00 ± 74.52"


def test_a_job_without_a_place_is_not_added(tmp_path, monkeypatch):
    table, to = script(f"{ROW_COST}/table"), tmp_path / "alone.csv.xz"
    monkeypatch.setattr(table, "RESULTS", to)
    (tmp_path / "default-g.csv").write_text("job,seed\ngo1:few,1300\n")
    with pytest.raises(
        SystemExit, match="default-g.csv is not added: expected a name PLACE.METHOD"
    ):
        table.add("H200, today", [tmp_path])
    assert not to.exists()


def test_a_g1_counts_errors_and_rough_ground_crossings():
    table = script(f"{ROW_COST}/table")
    rows = [
        {"iteration": k, "sim_steps": k, "seconds": k / 2, "fall_rate": falls, "job": "g1:best"}
        | {"tracking_error": error, "yaw_error": 0.2}
        for k, (error, falls) in enumerate(((0.3, 0.0), (0.2, 0.1), (0.1, 0.0)), 1)
    ]
    np.testing.assert_allclose(table.reached(rows), [[2, 2, 1.0], [3, 3, 1.5]])
    rows = [
        {"iteration": k, "sim_steps": k, "seconds": k, "job": "go2:rough", "crossed": "0.5"}
        | dict.fromkeys(tiles.KINDS, " ".join([share] * 10))
        for k, share in enumerate(("0.9", "0.96", "0.9", "1.0"), 1)
    ]
    np.testing.assert_allclose(table.reached(rows), [[2, 2, 2], [4, 4, 4]])


def test_seconds_where_a_row_costs_more_and_where_two_runs_break_even():
    """`best`: 100 rows of 1024 robots and 2 s; PPO: 1000 rows of 2048 and 1 s, or 5000 of 256 and 5 s."""
    table = script(f"{ROW_COST}/table")
    noise = np.array([-0.01, 0, 0.01])[:, None]

    def run(method, robots, rows, seconds):
        level = np.array([[1, rows * robots, seconds]]) * (1 + noise * [0, 0, 1])
        return table.Run("go1.kernel", "G, day", method, robots, level, level, np.nan)

    best, fast = run("best", 1024, 100, 2.0), run("ppo2048", 2048, 1000, 1.0)
    few = run("ppo256", 256, 5000, 5.0)
    # 2 ms more a row: 0.2 s; 1000 rows of twice as many robots 2 ** power times 2 s
    np.testing.assert_allclose(table.later(best, 1.0, 3.0, 1.0).mean(), 2.2)
    np.testing.assert_allclose(table.later(fast, 1.0, [1.0, 3.0], 0.5).mean(0), [1, 1 + 2 * 2**0.5])
    # with a row as dear as its robots: 2 + 0.1 (c - 1) = 1 + 2 (c - 1) at c = 1 + 1 / 1.9
    even, low, high = table.break_even(best, [fast, few], 1.0, 1.0)
    assert even == pytest.approx(1 + 1 / 1.9, rel=0.02)
    assert 1.4 < low <= even <= high < 1.7
    assert table.fastest([fast, few]) is fast and table.sparing([fast, few]) is few
    # a run with a seed that never gets there says nothing
    assert table.even(best, [fast, few], 1.0) == "{:.2g} ({:.2g} to {:.2g})".format(
        *table.break_even(best, [fast, few], 1.0, table.POWERS["a GPU"])
    )
    never = table.to_walk(best._replace(walks=best.level * [[1], [1], [np.nan]]))
    assert table.even(never, [fast], 1.0) == "-" == table.even(best, [], 1.0)
    # the last batch with five seeds wins, else the one with most
    found = [best, fast, few]
    assert table.settings(found, "go1.kernel") == (best, [fast, few])
    assert table.settings([best], "go1.kernel") is None
    # the last day on which PPO has five seeds beside it, too, of a setting all of whose seeds get there
    five, two = np.concatenate([best.level] * 2), fast.level[:2]
    early, late = (best._replace(batch=f"G, day {k}", level=five, walks=five) for k in (1, 2))
    whole, cut = (
        fast._replace(batch=one.batch, level=level, walks=level)
        for one, level in ((early, np.concatenate([fast.level] * 2)), (late, two))
    )
    days = [early, late, whole, cut]
    assert table.settings(days, "go1.kernel") == (early, [whole])
    assert table.settings([early, late, cut], "go1.kernel") == (late, [cut])
    most = cut._replace(level=whole.level, walks=whole.level)
    assert table.settings([early, late, whole, most], "go1.kernel") == (late, [most])
    # a day without PPO is as one on which it was cut off; where no day has five seeds of it, the last
    assert table.settings([early, late, whole], "go1.kernel") == (early, [whole])
    # PPO of another host of that day is not beside it
    other_host = whole._replace(batch="G, day 2, second host", method="ppo4096")
    assert table.settings([*days, other_host], "go1.kernel") == (early, [whole])
    elsewhere = whole._replace(batch="G, day 3")
    assert table.settings([early, late, elsewhere], "go1.kernel") == (late, [elsewhere])
    assert table.settings([early, late, cut, elsewhere], "go1.kernel") == (late, [cut])
    never = whole.level * [[np.nan], [1], [1], [1], [1], [1]]
    most = cut._replace(method="ppo512", level=never, walks=never)
    assert table.settings([*days, most], "go1.kernel") == (early, [whole])
    # of a setting of PPO the host with most seeds, of the day of `best` if one has run then
    more = np.concatenate([fast.level, fast.level])
    other = fast._replace(batch="G, day, second host", level=more, walks=more)
    later = fast._replace(batch="G, later")
    assert table.beside([best, fast, few, other], best) == [other, few]
    assert table.beside([best, fast, later], best) == [fast]
    assert table.beside([best, later, few._replace(batch="H, day")], best) == [later]
    # but that of `best` if it has five; of equals that of `best` for seconds; a single seed is no mean
    five, ten = (np.concatenate([fast.level] * k) for k in (2, 4))
    own, there = fast._replace(level=five), other._replace(level=ten)
    assert table.beside([best, own, there], best) == [own]
    one, two = (other._replace(batch=f"G, later, host {k}", level=five) for k in (1, 2))
    quick = best._replace(method="best-r1", batch=one.batch)
    for order in ([one, two], [two, one]):
        assert table.beside([best, quick, *order], best) == [one]
    assert table.variants([best, quick], best) == [best, quick]
    assert table.host_beside(quick, best) == ", later, host 1"
    assert table.host_beside(other, best) == ", second host" and not table.host_beside(fast, best)
    single = fast._replace(level=fast.level[:1] * 0.1)
    assert table.sparing([few, fast, single]) is few and table.sparing([single]) is single
    # settings for seconds: those on tuning seeds only until others have run on fresh ones, both by name
    tuned, chosen = run("tune-r1", 1024, 100, 1.5), run("best-r1", 1024, 100, 1.6)
    assert table.variants([*found, tuned], best) == [best, tuned]
    assert table.variants([*found, tuned, chosen], best) == [best, chosen]
    assert "(tune-r1, tuning seeds) |" in table.compared([*found, tuned])
    assert "(best-r1) |" in table.compared([*found, tuned, chosen])
    # it ran on a second host, where a row costs 2 ms and not 1: 0.1 s less for its 100 rows on the first
    first = [best._replace(row=1.0), fast, few]
    there = chosen._replace(batch="G, day, second host", row=2.0)
    assert table.at_cost([*first, there], there, 1.0).level[:, 2].mean() == pytest.approx(1.5)
    # 1.5 + 0.1 (c - 1) = 1 + 1.16 (c - 1); beside PPO of its own host 1.6 + 0.1 (c - 2) = 1 + 1.16 (c - 2),
    # if five seeds of it ran there
    assert "; for seconds 1.5 (" in table.compared([*first, there])
    beside = fast._replace(batch=there.batch, level=five, walks=five)
    assert "; for seconds 2.6 (" in table.compared([*first, there, beside])
    cut = beside._replace(level=five[:2], walks=five[:2])
    assert "; for seconds 1.5 (" in table.compared([*first, there, cut])
    assert "; for seconds" not in table.compared(first)
    # unless the fastest PPO did not: 1.5 + 0.1 (c - 1) = 0.9 + 1.16 (c - 1)
    sooner = fast._replace(method="ppo2048-walk", level=fast.level * [1, 1, 0.9])
    slower = beside._replace(level=five * [1, 1, 3])
    assert "; for seconds 1.6 (" in table.compared([*first, sooner, there, slower])
    # no difference is shown at any cost, and from the least on `best` is sooner
    alike = run("ppo1024", 1024, 100, 2.01)
    assert table.even(best, [alike], 1.0) == "below 0.1 (below 0.1 to over 100)"
    # PPO of fewest steps may be of another day, with five seeds, but not of 2026-11-25, and says so
    spare = few._replace(batch="G, day 3", method="ppo128", level=five * [1, 0.1, 1])
    assert table.fewest([*found, spare], best, [fast, few]) is spare
    assert " (ppo128, day 3) |" in table.compared([*found, spare])
    for unfit in (
        spare._replace(level=five[:4]),
        spare._replace(batch="H, day 3"),
        spare._replace(place="go1.warp"),
        spare._replace(method="ppo256"),
        spare._replace(method="best-r2"),
        spare._replace(level=spare.level * [[1], [1], [np.nan], [np.nan], [np.nan], [1]]),
    ):
        assert table.fewest([*found, unfit], best, [fast, few]) is few
    for before in (table.H100, table.H200):
        then = [x._replace(batch=before) for x in (best, spare)]
        assert table.fewest(then, then[0], [few]) is few
    # PPO evaluated as often as `best` for seconds stands beside that alone
    often = fast._replace(method="ppo2048-often", level=five * [1, 1, 0.5])
    assert table.beside([best, fast, few, often], best) == [fast, few]
    assert table.settings([*found, often], "go1.kernel") == (best, [fast, few])
    spare = often._replace(batch="G, day 3", level=five * [1, 0.1, 1])
    assert table.fewest([*found, spare], best, [fast, few]) is spare  # for steps
    # its 1000 rows and 0.5 s: 1.5 + 0.1 (c - 1) = 0.5 + 1.16 (c - 1); of its cards alone
    assert "; for seconds 1.9 (" in table.compared([*first, there, often])
    # beside plain PPO on the host of the setting for seconds: that does not count there
    plain = beside._replace(method="ppo256", level=five * [1, 1, 0.1])
    both = [*first, there, often, often._replace(batch=there.batch), plain]
    assert "; for seconds 3.1 (" in table.compared(both[:-1])
    assert "; for seconds 3.1 (" in table.compared(both)
    other_card = often._replace(batch="H, day")
    assert "; for seconds 1.5 (" in table.compared([*first, there, other_card])
    # where walks are not compared
    rough = [x._replace(place="go2.rough") for x in found]
    assert table.compared(found).endswith(") |") and table.compared(rough).endswith("| - |")
    # of PPO the host with five seeds, though one of them does not get there: it counts with its whole run
    level = np.concatenate([few.level, few.level])
    level[0] = np.nan
    late = few._replace(batch="G, day, second host", level=level, end=3e6)
    assert table.there(late) == 5 / 6 and table.steps(late)[0] == 3e6
    assert table.settings([*found, late], "go1.kernel") == (best, [fast, late])
    assert table.fastest([late, fast]) is fast and table.sparing([late, fast]) is late
    assert "at least 15 (" in table.compared([*found, late])
    level[:3] = np.nan
    assert table.settings([*found, late], "go1.kernel") == (best, [fast])
    assert table.settings([best, late], "go1.kernel") is None
    # the fastest is of the host of `best` where a setting with five seeds ran there, though another is faster
    slow = fast._replace(method="ppo1024", level=five * [1, 1, 3])
    assert table.fastest_beside(best, [fast, slow]) is slow
    assert table.fastest_beside(best, [other, slow._replace(batch=other.batch)]) is other
    assert table.fastest_beside(best, [fast, few]) is fast


def test_jobs_of_the_row_costs_are_valid_and_of_places_that_have_a_name():
    measure = script(f"{ROW_COST}/run")
    places = script(f"{ROW_COST}/plot").LABELS
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    assert len({line.split()[0] for line in lines}) == len(lines) == 77
    for line in lines:
        name, job, *fields = line.split()
        place, _, method = name.rpartition(".")
        read = measure.read(job, fields)
        assert place in places and (read.engine == "mujoco_warp") == place.endswith("warp")
        assert 10 <= len(measure.ends(read.config)) <= (60 if method.endswith("-often") else 36)
        uses_model = schedule.uses_model(read.config)
        assert uses_model != re.sub("^(again|newer|new)-", "", method).startswith("ppo")
        assert read.seeds >= 5 or method.startswith("tune")
    with pytest.raises(SystemExit, match="engine is 'c', expected mujoco_warp"):
        measure.read("go1:best", ["engine=c"])
    with pytest.raises(SystemExit, match="warmup is 2, expected 0 to run.seed = 1"):
        measure.read("go1:best", ["warmup=2", "run.seed=1"])
    with pytest.raises(SystemExit, match="warmup is -1, expected"):
        measure.read("go1:best", ["warmup=-1"])
    assert measure.read("go1:best", []).warmup == 0


def test_jobs_of_fast_in_seconds_are_the_papers_and_what_its_page_says():
    """Variants as configs/ has them, 4096 robots, on fresh seeds; PPO-16 beside each on its engine."""
    measure, folder = script(f"{ROW_COST}/run"), EXPERIMENTS / "13_step_time"
    jobs = dict(line.split(maxsplit=1) for line in (folder / "fast.txt").read_text().splitlines())
    assert [*jobs] == [f"go1.kernel.{x}" for x in ("ppo16", "fast", "dyna4")] + [
        f"go1.warp.{x}" for x in ("ppo16", "fast")
    ]
    for name, line in jobs.items():
        job, *fields = line.split()
        read = measure.read(job, fields)
        place, _, variant = name.rpartition(".")
        assert job == f"go1:{variant}" and read.config.rollout.num_envs == 4096
        assert {field.split("=")[0] for field in fields} <= {
            *"seeds engine run.seed run.num_iterations run.log_every".split()
        }
        assert (read.engine == "mujoco_warp") == (place == "go1.warp")
        assert (read.seeds, read.config.run.seed) == (5, 1100)
        ends = measure.ends(read.config)
        assert [*ends] == [*range(20, 401, 20)]
    text = " ".join((folder / "README.md").read_text().split())
    assert (
        "five fresh seeds each (1100 to 1104)" in text
        and "400 iterations, evaluated every 20" in text
    )


def test_a_run_alone_is_timed_between_evaluations_and_keeps_its_policies(monkeypatch):
    measure = script(f"{ROW_COST}/run")
    job = measure.read("go1:best", ["run.num_iterations=20", "seeds=2", "rollout.num_envs=16"])
    clock = iter([1.0, 1.5, 7.0, 7.25])
    monkeypatch.setattr(measure.time, "perf_counter", lambda: next(clock))

    def step(hyper, state, columns):
        more = len(columns["iteration"])
        params = state.learner.params + more
        last = columns["iteration"][-1]
        metrics = {"policy_std": np.full(more, 1.0 if last < 20 else np.nan)}
        metrics["iteration"] = columns["iteration"]
        return types.SimpleNamespace(learner=types.SimpleNamespace(params=params)), metrics

    program = types.SimpleNamespace(step=step, hyper=0, columns=schedule.columns(job.config))
    state = types.SimpleNamespace(learner=types.SimpleNamespace(params=jnp.zeros(())))
    rows, policies, lost = measure.train(job.config, program, state, 7)
    steps = schedule.sim_steps(job.config)
    assert [row["seconds"] for row in rows] == ["0.5000", "0.7500"]
    assert [row["sim_steps"] for row in rows] == [steps[9], steps[19]]
    assert policies == [10, 20] and (job.seeds, job.episodes) == (2, 500)
    assert lost == "seed 7: policy_std is not finite in iteration 11\n"


def test_a_run_alone_that_was_cut_goes_on_after_its_whole_seeds(tmp_path, monkeypatch):
    """Of three seeds the second is cut off. Then it and the third run, and the log names each NaN once.
    Rows of another commit are refused."""
    measure, ran, commit = script(f"{ROW_COST}/run"), [], ["abc"]
    job = measure.read("go1:best", ["seeds=3", "run.seed=1300"])
    measured = stand_ins(measure, monkeypatch, ran, commit, stops=[1300, 1301])
    path = tmp_path / "best-g.csv"
    with pytest.raises(KeyboardInterrupt):
        measure.one(path, job)
    commit[0] = "xyz"
    with pytest.raises(SystemExit, match="best-g.part is of .*'abc'.*, expected .*'xyz'"):
        measure.one(path, job)
    commit[0] = "abc"
    measure.one(path, job)
    assert ran == [1300, 1301, 1301, 1302] and not path.with_suffix(".part").exists()
    assert measured == [1300, 1301, 1302]
    rows = paper.rows(path)
    assert [row["seed"] for row in rows] == [1300, 1301, 1302]
    assert [row["seconds"] for row in rows] == [1300.5, 1301.5, 1302.5]
    told = [line.split(":")[0] for line in path.with_suffix(".log").read_text().splitlines()]
    assert told == ["seed 1300", "seed 1301"]


def test_a_run_alone_throws_seeds_away_at_the_start_of_each_process(tmp_path, monkeypatch):
    """Those before the first one, trained and evaluated, of which neither CSV nor log has anything; again
    where it goes on."""
    measure, ran = script(f"{ROW_COST}/run"), []
    job = measure.read("go1:best", ["seeds=2", "run.seed=1301", "warmup=2"])
    measured = stand_ins(measure, monkeypatch, ran, ["abc"], stops=[1299, 1300, 1301, 1302])
    path = tmp_path / "best-g.csv"
    with pytest.raises(KeyboardInterrupt):
        measure.one(path, job)
    measure.one(path, job)
    assert ran == [1299, 1300, 1301, 1302, 1299, 1300, 1302]
    assert measured == [1299, 1300, 1301, 1299, 1300, 1302]
    rows = paper.rows(path)
    assert [row["seed"] for row in rows] == [1301, 1302]
    assert {row["job"] for row in rows} == {"go1:best seeds=2 run.seed=1301 warmup=2"}
    assert path.with_suffix(".log").read_text() == "seed 1301: kl is not finite\n"


def stand_ins(measure, monkeypatch, ran, commit, stops):
    """In place of training and evaluation: `ran` gets each seed that begins; it is cut off where `ran` is
    `stops`. Returns the seeds that are evaluated. Seeds below 1302 blow up."""
    program = types.SimpleNamespace(
        env=0, static=0, hyper=0, device="a card", place=lambda state: state
    )
    measured = []

    def train(config, program, state, seed):
        ran.append(seed)
        if ran == stops:
            raise KeyboardInterrupt
        row = {"iteration": 10, "sim_steps": 90, "seconds": f"{seed}.5"}
        return [row], [seed], f"seed {seed}: kl is not finite\n" * (seed < 1302)

    def scores(program, play, policies):
        measured.extend(policies)
        return {"return": [40.0]}

    for what, name, value in (
        (measure.devices, "own_process", lambda device: None),
        (measure.build, "check", lambda config: None),
        (measure.build, "program", lambda config: program),
        (measure.algorithm, "init", lambda env, hyper, key, static: hyper),
        (measure.versions, "commit", lambda: commit[0]),
        (measure, "parts", lambda *_: {"row_ms": "0.2"}),
        (measure, "scores", scores),
        (measure, "train", train),
    ):
        monkeypatch.setattr(what, name, value)
    return measured


def test_the_command_of_runs_alone_fails_with_one_of_them(tmp_path, monkeypatch):
    """The other runs; why is beside the log, and goes when it has run."""
    measure, jobs, codes = script(f"{ROW_COST}/run"), tmp_path / "jobs.txt", {"a": 1, "b": 0}
    jobs.write_text("a go1:best\nb go1:best\n")
    (tmp_path / "a.log").write_text("seed 3: kl is not finite\n")

    def run(command, **_):
        code = codes[command[-1]]
        return types.SimpleNamespace(returncode=code, stdout="", stderr="no memory\n" * code)

    monkeypatch.setattr(measure.subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["run.py", str(tmp_path), str(jobs)])
    with pytest.raises(SystemExit, match="^failed: a$"):
        measure.main()
    assert (tmp_path / "a.error").read_text() == "no memory\n"
    assert "not finite" in (tmp_path / "a.log").read_text()
    codes["a"] = 0
    measure.main()
    assert not (tmp_path / "a.error").exists()

"""The scripts of the paper's tables and figures: each on the results that are there, and their statistics
and tables on numbers known by hand. What trains is `-m slow`: every folder's `run.py --quick`, twice.
"""

import contextlib
import csv
import functools
import importlib
import io
import itertools
import json
import lzma
import pathlib
import re
import subprocess
import sys
import types
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import toy_env
from answers import refused
from toy_runs import assert_close

from dynappo import algorithm, schedule
from dynappo import config as config_lib
from dynappo.config import splitting
from dynappo.description import robot as robot_lib
from dynappo.learner import networks
from dynappo.model import dynamics
from dynappo.policy import policy_file, policy_source
from dynappo.tasks.velocity import env as env_lib
from dynappo.terrain import tiles
from dynappo.types import Outcome
from experiments import paper, pictures, run, stats

ROOT = pathlib.Path(config_lib.__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"
PLOTS = (
    "02_brax 10_ablation 11_model 12_platforms 13_step_time 14_efficiency "
    "15_curves 16_gaits 17_regimes/cliff 18_rollouts"
).split()
FOLDERS = (  # in the order in which they read each other's runs
    "10_ablation 12_platforms 11_model 13_step_time 14_efficiency 15_curves 16_gaits 17_regimes "
    "18_rollouts"
).split()


@functools.cache
def script(name):
    """The module FOLDER/NAME, imported as the script itself is: with its folder's other files."""
    folder, _, stem = name.partition("/")
    others = {path.stem for path in (EXPERIMENTS / folder).glob("*.py")}
    kept = {other: sys.modules.pop(other) for other in others & sys.modules.keys()}
    sys.path.insert(0, str(EXPERIMENTS / folder))
    try:
        return importlib.import_module(stem or "plot")
    finally:
        sys.path.pop(0)
        for other in others:
            sys.modules.pop(other, None)
        sys.modules.update(kept)


@pytest.fixture(scope="module", autouse=True)
def read_once():
    """The scripts read the same 300 runs 800 times. A caller gets a dictionary of its own."""
    shipped = paper.read
    read = functools.cache(lambda path, time: shipped(path))

    def columns(path):
        return dict(read(path.resolve(), path.stat().st_mtime_ns))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "read", columns)
        yield


@pytest.fixture
def drawn(monkeypatch):
    """Names of the pictures that a script has drawn; rendering them would take most of the time."""
    plt = pytest.importorskip("matplotlib.pyplot")
    names = []
    monkeypatch.setattr(pictures, "save", lambda page, path, **_: names.append(path.name))
    yield names
    plt.close("all")


def keep(folder, name, returns):
    """Write a run of these returns [I][S] as run.py does: 1000 steps and 2 s an iteration."""
    returns = np.array(returns, float)
    count = np.arange(1, len(returns) + 1)
    metrics = {"iteration": count, "sim_steps": 1000 * count, "seconds": 2.0 * count}
    metrics |= {"episode_return": returns, "policy_std": 1 / (1 + np.abs(np.nan_to_num(returns)))}
    folder.mkdir(parents=True, exist_ok=True)
    run.write_csv(folder / f"{name}.csv", run.kept(metrics))
    summary: dict = {"return": returns[-10:].mean(0), "return_max": np.nanmax(returns, 0)}
    summary["policy_std"] = metrics["policy_std"][-10:].mean(0)
    summary = {name: values.tolist() for name, values in summary.items()}
    summary |= dict(sim_steps=1000 * len(returns), seconds=2.0 * len(returns), date="2026-01-01")
    parts = dict.fromkeys(("fall_rate", "tracking_error"), [0.0, 0.5]) | {"return": [1.0, 3.0]}
    summary |= dict(device="none", impl="jax", evaluation=parts, compile_seconds=100.0)
    (folder / f"{name}.json").write_text(json.dumps(summary))


# On the results that are there


def test_a_name_asks_for_its_job_or_for_all_that_begin_so():
    jobs = ["go2-blind-model", "go2-blind", "go2-best", "go1-best"]
    assert paper.chosen(jobs, []) == jobs
    assert paper.chosen(jobs, ["go2-blind"]) == ["go2-blind"]
    assert paper.chosen(jobs, ["go1", "go2-b", "go2-blind"]) == ["go1-best", *jobs[:3]]
    with pytest.raises(SystemExit, match="anymal: no job"):
        paper.chosen(iter(jobs), ["go2", "anymal"])


@pytest.mark.parametrize("name", PLOTS)
def test_a_script_makes_the_tables_that_are_stored_and_draws_its_pictures(name, tmp_path, drawn):
    folder = EXPERIMENTS / name.partition("/")[0]
    if (folder / "results").exists():
        (tmp_path / "results").symlink_to(folder / "results")
    script(name).make(tmp_path)
    made = list(tmp_path.glob("*.csv"))
    assert made or name == "02_brax"  # its table is in words
    for table in made:
        assert table.read_text() == (folder / table.name).read_text(), table.name
    assert drawn and all((folder / f"{picture}.png").exists() for picture in drawn)


@pytest.mark.parametrize("script_of, table", [("lag", "lag"), ("table", "results")])
def test_the_tables_without_a_picture_are_those_that_are_stored(script_of, table, tmp_path):
    folder = EXPERIMENTS / "17_regimes"
    (tmp_path / "results").symlink_to(folder / "results")
    script(f"17_regimes/{script_of}").make(tmp_path)
    assert (tmp_path / f"{table}.csv").read_text() == (folder / f"{table}.csv").read_text()


def test_the_page_of_the_peers_has_the_numbers_of_its_runs(drawn, monkeypatch, capsys):
    """Of the earlier task and of today's, where SAC with symmetric networks is beside others."""
    monkeypatch.setattr(sys, "argv", ["plot.py"])
    peers = script("24_off_policy")
    peers.main()
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "")
    words = " ".join(page.split())
    printed = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    rows = {cells[0].strip("| "): cells for cells in printed if len(cells) > 9}
    assert drawn == ["peers"] and len(rows) == 11  # with the head, which both tables have
    said = [cells[0] for cells in printed if len(cells) == 1 and cells[0][0] != "|"]
    assert said[0] == "2.2 to 2.5 M steps: -2.4 (-2.9 to -1.9), p 1e-05; 41.4"
    assert "(1.9 to 2.9; PPO 41.4; p 1e-5)" in page
    for name, cells in rows.items():  # walks, first at 38, with few falls; 30, 35, 40
        assert " | ".join(cells[2:5] + cells[6:9]) in page, name
        if name in peers.TODAY:
            assert cells[1] in ("3", "10") and f"| {' | '.join(cells[1:5] + cells[6:9])} | " in page
            assert f" | {cells[10]} |" in page
    assert said[1:] == [
        "sac-symmetric and sac-today: to 30 -0.27 M (-0.41 to -0.12), 0.60 times, p 0.015; to 35 -0.50 M "
        "(-0.63 to -0.37), 0.49 times, p 0.00045; 0.9 to 1.25 M steps: 3.5 (1.3 to 5.7), p 2e-02; 35.4",
        "sac-symmetric and ppo-level-g: to 30 -0.46 M (-0.55 to -0.37), 0.47 times, p 7.8e-07; to 35 "
        "-0.51 M (-0.64 to -0.38), 0.48 times, p 6.8e-06; to 38 -0.40 M (-0.62 to -0.18), 0.65 times, "
        "p 0.0055; 0.9 to 1.25 M steps: 2.4 (0.8 to 4.0), p 9e-03; 36.6",
        "sac-symmetric and best-g: to 30 0.21 M (0.19 to 0.22), 2.03 times, p 4.4e-10; to 35 0.24 M (0.12 "
        "to 0.37), 2.07 times, p 0.01; to 38 0.47 M (0.22 to 0.72), 2.74 times, p 0.012; 0.9 to 1.25 M "
        "steps: -2.6 (-3.1 to -2.1), p 5e-07; 41.5",
    ]
    for told in (
        "to 30 in 0.60 times the steps (0.27 M fewer, 0.12 to 0.41, p 0.015) and to 35 in 0.49 times (0.50 M "
        "fewer, 0.37 to 0.63, p 0.0004)",
        "they return 3.5 more (1.3 to 5.7; without 35.4; p 0.02)",
        "at 38 0.40 M steps sooner (0.18 to 0.62, p 0.006)",
        "it returns 2.4 more (0.8 to 4.0, p 0.009)",
        "0.47 M more, 0.22 to 0.72, p 0.01)",
        "it returns 2.6 less (2.1 to 3.1, p 5e-7)",
    ):
        assert told in words
    jobs, table = peers.read(), peers.less.table
    runs = {name: table.seeds(jobs[name]) for name in (*peers.TODAY, "sac", "crossq-today")}
    reached = {name: table.reached(runs[name], 38) for name in peers.TODAY}
    level = {name: one.level for name, one in reached.items()}
    assert np.isnan(level["sac-today"]).all() and [x[0]["seed"] for x in runs["sac-today"]] == [
        100,
        101,
        102,
    ]
    told = "after {:.2f} M simulator steps, three seeds of three. Without them three seeds"
    assert told.format(level["sac-symmetric"].mean() / 1e6) in words
    told = "PPO, tuned and symmetric, needs {:.2f} M and `best` {:.2f} M, ten seeds each"
    assert told.format(*(level[x].mean() / 1e6 for x in ("ppo-level-g", "best-g"))) in words
    more = "{:.1f} times {}({:.1f} to {:.1f}"
    ratio = stats.ratio(level["sac-symmetric"], level["best-g"])
    assert more.format(ratio[0], "those of `best` ", *ratio[1:]) in words
    assert "{:.1f} times the steps to 38 ({:.1f} to {:.1f};".format(*ratio) in words
    told = "PPO needs {:.2f} times its steps ({:.2f} to {:.2f})"
    assert told.format(*stats.ratio(level["ppo-level-g"], level["sac-symmetric"])) in words
    pair = [reached[name].careful / 1e6 for name in ("sac-symmetric", "best-g")]
    gap, low, high = stats.difference(*pair)
    assert f"{pair[1].mean():.2f} M with `best`, {pair[0].mean():.2f} with SAC" in words and gap > 0
    assert f"({-low:.2f} M fewer to {high:.2f} more, p {stats.welch_of(*pair):.2f})" in words
    best = [max(row["return"] for row in run) for run in runs["sac-today"]]
    assert "of each is {:.2f}, {:.1f} and {:.1f}, so it misses".format(*best) in words
    symmetric = runs["sac-symmetric"]
    ends = [run[-1]["sim_steps"] / 1e6 for run in symmetric]
    assert "| {:.1f}, {:.1f}, {:.1f} |".format(*ends) in words and "off at 1.2 M" in words
    assert f"at {symmetric[0][-1]['return']:.1f} after 2.0 M" in words
    late = np.mean([table.between(jobs["sac-symmetric"], 1e6 * min(ends), "return")])
    assert (
        f"SAC has {late:.1f} after {min(ends):.1f} M; where it ends is open. PPO has 41.9 after 3.7 M."
        in words
    )
    means = [
        np.mean(
            [
                np.mean([r["return"] for r in run if 1.75e6 <= r["sim_steps"] <= 2.05e6])
                for run in runs[name]
            ]
        )
        for name in ("sac-today", "sac")
    ]
    assert "has {:.1f} there between 1.75 and 2.05 M steps, here {:.1f}".format(*means) in words
    end = max(run[-1]["sim_steps"] for run in runs["sac-today"]) / 1e6
    assert f"are not there by {end:.1f} M" in words and f"100 to 102, {end:.1f} M steps" in words
    assert [run[0]["seed"] for run in runs["sac-symmetric"]] == [100, 101, 102]
    window = "between {:g} and {:g} M".format(*(x / 1e6 for x in peers.WINDOW_TODAY))
    assert words.lower().count(window.lower()) == 3
    gaps = [
        (runs[x][0][5]["sim_steps"] - runs[x][0][4]["sim_steps"]) / 1e6
        for x in ("sac-today", "ppo-level-g", "best-g")
    ]
    told = "an evaluation every {:.1f} M steps (PPO every {:.2f}, `best` every {:.2f})"
    assert told.format(*gaps) in words
    assert (
        "rollout.num_envs=128 " in jobs["ppo-level-g"][0]["job"] and "robot, 128 robots," in words
    )
    late = rows["ppo-level-g"][10].split()[0], rows["ppo-level-g"][9]
    assert words.count("{} after {} M".format(*late)) == 2
    one = [run[0]["return"] for run in runs["crossq-today"]]
    assert {len(run) for run in runs["crossq-today"]} == {1}
    assert (
        f"one evaluation, at {runs['crossq-today'][0][0]['sim_steps'] / 1e3:.0f} k: {min(one):.1f}"
        in words
    )
    assert f"{min(one):.1f} to {max(one):.1f}. So how it" in words


ROW_COST = "30_row_cost"


def test_the_pages_of_seconds_have_the_tables_of_their_runs(monkeypatch, capsys):
    """All runs in runs.md, `best` beside PPO on the page; no row is left out, and none is there twice."""
    monkeypatch.setattr(sys, "argv", ["table.py"])
    script(f"{ROW_COST}/table").main()
    places = ("| go", "| g1", "| anymal")
    for name, printed in zip(
        ("runs", "README"), capsys.readouterr().out.strip().split("\n\n"), strict=True
    ):
        page = (EXPERIMENTS / ROW_COST / f"{name}.md").read_text().splitlines()
        rows = [line for line in printed.splitlines() if line.startswith(places)]
        assert len(rows) >= (84 if name == "runs" else 9)
        assert rows == [line for line in page if line.startswith(places)]


def test_what_the_pages_of_seconds_say_in_words_is_so():
    """The short tables of settings.md and computed.md; how many settings ran; what rows and the rest cost;
    how much sooner one is on a G1 and in the exact tasks, and which of these walk."""
    table, folder = script(f"{ROW_COST}/table"), EXPERIMENTS / ROW_COST
    found = table.runs()
    run = {(one.place, one.batch, one.method): one for one in found}
    pages = {
        name: " ".join((folder / f"{name}.md").read_text().split())
        for name in ("README", "runs", "settings", "computed")
    }
    assert f"all {len(found)} settings that ran" in pages["README"]
    own = "H200, 2026-11-27"
    for label, method in (
        ("two rounds, 2048 robots", "best-r2n2048"),
        ("one round, 2048 robots", "best-r1n2048"),
        ("`best`", "best"),
        ("PPO, 2048 robots", "ppo2048"),
    ):
        one = run["go1.kernel", f"{own}, second host", method]
        level, walks = np.nanmean(one.level[:, 2]), np.nanmean(one.walks[:, 2])
        never = int(np.isnan(one.walks[:, 2]).sum())
        more = {0: "", 2: " (two of five seeds do not)"}[never]
        assert f"| {label} | {level:.2f} | {walks:.2f}{more} |" in pages["settings"]
    sooner = stats.difference(
        *(run["go1.kernel", f"{own}, second host", m].level[:, 2] for m in ("best", "best-r2n2048"))
    )
    text = "two rounds are at the level {:.2f} s sooner ({:.2f} to {:.2f})"
    assert text.format(*sooner) in pages["settings"]
    power = table.power_of("go1.warp")
    dear = table.cost(found, run["go1.warp", own, "best"])
    for label, method in (("`best`", "best"), ("PPO, 2048 robots", "ppo2048")):
        measured = run["go1.warp", own, method]
        for goal, way in (("to the level", lambda one: one), ("to a walk", table.to_walk)):
            older, then = (
                f"{table.later(way(one), table.cost(found, one), dear, power).mean():.1f} "
                for one in (run["go1.kernel", batch, method] for batch in (table.H100, own))
            )
            older = older if goal == "to the level" else ""  # of then `best` does not walk yet
            slow = table.interval(way(measured).level[:, 2])
            assert f"| {label}, {goal} | {older}| {then}| {slow} |" in pages["computed"]
    rows = [
        (run["go1.kernel", own, m].level[:, 1] / run["go1.kernel", own, m].robots).mean()
        for m in ("best", "ppo2048", "ppo256")
    ]
    text = "needs {:.0f} rows of 1024 robots with `best`, and {:.0f} of 2048 or {:.0f} of 256"
    assert text.format(*rows) in pages["README"]
    newer, (g1, ppo) = "H200, 2026-11-28", ("g1.kernel", "ppo1024x12")
    pair = [run[g1, newer, method] for method in ("best", ppo)]
    (mine, its), (few, steps) = ([one.level[:, k] for one in pair] for k in (2, 1))
    assert [len(mine), len(its)] == [10, 7]
    text = "{:.2f} s ({:.2f} to {:.2f}), with".format(*stats.difference(mine, its))
    text += " {:.2f} times the seconds ({:.2f} to {:.2f})".format(*stats.ratio(its, mine))
    assert text + " and 5.1 times the steps" in pages["runs"]
    gain, most, least = (100 * (1 - part) for part in stats.ratio(its, mine))
    assert f"by {gain:.0f} % ({least:.0f} to {most:.0f})" in pages["README"]
    text = "difference is {:.2f} s ({:.2f} to {:.2f})"
    assert text.format(*stats.difference(*(one.walks[:, 2] for one in pair))) in pages["runs"]
    gains, longer, cut, needs, rest = [], [], [], [], []
    for place in ("go1.exact", "anymal_c.exact"):
        pair = [run[place, newer, method] for method in ("best", "ppo2048")]
        mine, its = (one.level[:, 2] for one in pair)
        gains.append(stats.difference(its, mine))
        longer.append(stats.ratio(its, mine))
        cut.append(len(run[place, newer, "ppo512"].level))
        rows = [one.level[:, 1] / one.robots for one in pair]
        needs.append([some.mean() for some in rows])
        rest.append(
            [
                np.mean((1e3 * one.level[:, 2] - some * one.row) / one.level[:, 0])
                for one, some in zip(pair, rows, strict=True)
            ]
        )
    text = "by {:.1f} s on a Go1 ({:.1f} to {:.1f}) and {:.1f} s on an ANYmal-C ({:.1f} to {:.1f})"
    assert text.format(*gains[0], *gains[1]) in pages["runs"]
    text = "takes {:.1f} ({:.1f} to {:.1f}) and {:.1f} times ({:.1f} to {:.1f}) as long"
    assert text.format(*longer[0], *longer[1]) in pages["README"]
    text = (
        "needs {:.0f} rows of 1024 robots on a Go1 and {:.0f} on an ANYmal-C, PPO {:.0f} and {:.0f}"
    )
    assert text.format(*np.transpose(needs).ravel()) in pages["computed"]
    text = "{:.1f} and {:.1f} ms an iteration with `best`, {:.1f} and {:.1f} with PPO"
    assert text.format(*np.transpose(rest).ravel()) in pages["computed"]
    walked = {
        (place, method): int(np.isfinite(run[place, newer, method].walks[:, 2]).sum())
        for place in ("go1.exact", "anymal_c.exact")
        for method in ("best", "ppo512", "ppo1024", "ppo2048")
    }
    assert cut == [2, 4] and {key: n for key, n in walked.items() if n} == {
        ("go1.exact", "best"): 2,
        ("anymal_c.exact", "best"): 5,
        ("anymal_c.exact", "ppo1024"): 1,
    }
    assert "All five ANYmal-C walk with `best`, two of five Go1" in pages["README"]


def test_what_the_pages_of_seconds_say_of_a_g1_on_other_hosts_is_so(humanoid):
    """`best` for seconds beside PPO of the first host, MuJoCo Warp's own step, and who walks by the end."""
    table, folder = script(f"{ROW_COST}/table"), EXPERIMENTS / ROW_COST
    found = table.runs()
    pages = {
        name: " ".join((folder / f"{name}.md").read_text().split())
        for name in ("README", "runs", "settings", "computed")
    }
    first, second, third = (
        f"H200, 2026-11-28{host}" for host in ("", ", second host", ", third host")
    )
    run = {(one.place, one.batch, one.method): one for one in found}
    best, ppo = (run["g1.kernel", first, method] for method in ("best", "ppo1024x12"))
    quick = run["g1.kernel", second, "best-kl4e3"]
    dear = [
        run["g1.warp", host, method] for host, method in ((second, "best"), (third, "ppo1024x12"))
    ]
    three = run["g1.warp", second, "ppo1024x12"]
    assert [len(one.level) for one in (quick, *dear, three)] == [10, 5, 5, 3]
    assert table.settings(found, "g1.warp") == (dear[0], [dear[1]])
    seconds, steps = ([one.level[:, k] for one in (best, quick, ppo, *dear)] for k in (2, 1))
    text = "takes {:.2f} s longer to the level ({:.2f} to {:.2f}), 1.01 times the seconds"
    assert text.format(*stats.difference(seconds[2], seconds[1])) in pages["runs"]
    text = "{:.2f} times as long ({:.2f} to {:.2f}), for {:.1f} times the steps: no difference"
    more = stats.ratio(steps[2], steps[1])
    assert text.format(*stats.ratio(seconds[2], seconds[1]), more.value) in pages["README"]
    assert "and {:.1f} times the steps ({:.1f} to {:.1f})".format(*more) in pages["runs"]
    text = "`best` takes {:.2f} s longer ({:.2f} to {:.2f}), for {:.2f} instead of {:.2f} M steps"
    means = [steps[k].mean() / 1e6 for k in (0, 1)]
    assert text.format(*stats.difference(seconds[0], seconds[1]), *means) in pages["runs"]
    for words, one in (
        ("three seeds take {:.1f} s longer to the level than `best`", three),
        ("takes {:.1f} s longer to the level than `best` on the second host", dear[1]),
    ):
        text = words + " ({:.1f} to {:.1f}), for {:.1f} times the steps ({:.1f} to {:.1f})"
        gain = stats.difference(one.level[:, 2], seconds[3])
        more = stats.ratio(one.level[:, 1], steps[3])
        assert text.format(*gain, *more) in pages["runs"]
    text = "{:.2f} and {:.2f} s, a difference of {:.1f} s ({:.1f} to {:.1f})"
    both = seconds[4], three.level[:, 2]
    told = text.format(*(some.mean() for some in both), *stats.difference(*both))
    assert told in pages["runs"]
    longer = stats.ratio(seconds[4], seconds[3])
    assert "{:.1f} times as long ({:.1f} to {:.1f})".format(*longer) in pages["README"]
    # computed from the runs with our kernel, and measured
    costs, power = [table.cost(found, one) for one in dear], table.power_of("g1.warp")
    later = [
        table.later(one, table.cost(found, one), ms, power)
        for one, ms in zip((best, ppo), costs, strict=True)
    ]
    for label, computed, measured in (
        (f"`best`, {costs[0]:.2f} ms a row, second host", later[0], seconds[3]),
        (f"PPO, 1024 robots, 12 rows, {costs[1]:.2f} ms, third host", later[1], seconds[4]),
    ):
        line = f"| {label} | {table.interval(computed)} | {table.interval(measured)} |"
        assert line in pages["computed"]
    assert "it is {:.1f} and {:.1f}.".format(*(one.mean() for one in later)) in pages["README"]
    text = "`best` took {:.2f} s longer than computed ({:.2f} to {:.2f}), PPO {:.2f} ({:.2f} to {:.2f})"
    slower = [x for pair in zip(seconds[3:], later, strict=True) for x in stats.difference(*pair)]
    assert text.format(*slower) in pages["computed"]
    some = (best, ppo, quick, *dear)
    rows = [(one.level[:, 1] / one.robots).mean() for one in some]
    rest = [
        np.mean((1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row) / one.level[:, 0])
        for one in some
    ]
    text = "{:.0f} rows of 1024 robots, and PPO {:.0f}. All else takes {:.1f} ms an iteration"
    text = text.format(rows[0], rows[1], rest[0]) + f" of 130, and {rest[1]:.1f} of 240."
    text += (
        f" With a KL of 0.04 and 3 epochs it is {rows[2]:.0f} rows, and {rest[2]:.1f} ms of 135."
    )
    text += " With MuJoCo Warp's step it is {:.0f} and {:.0f} rows, and".format(*rows[3:])
    text += " {:.1f} ms of 128 and {:.1f} of 236.".format(*rest[3:])
    assert text in pages["computed"]
    # who walks by iteration 160, and who still falls there
    known = [one.walks[:, 2] for one in (best, quick, *dear)]
    assert [int(np.isfinite(one).sum()) for one in known] == [10, 8, 2, 5]
    assert f"PPO's five walk, after {known[3].mean():.1f} s" in pages["README"]
    falls, errors, last, parts = {}, {}, {}, {}
    for row in table.read():
        key = row["batch"], row["name"]
        last.setdefault(key, {})[row["seed"]] = 1e3 * float(row["seconds"]) / int(row["iteration"])
        parts[key] = {name: float(row[name] or "nan") for name in ("ppo_ms", "tail_ms", "fit_ms")}
        if row["batch"] in (first, second) and row["iteration"] == "160":
            errors.setdefault((row["batch"], row["name"]), []).append(
                [float(row[name]) for name in ("tracking_error", "yaw_error")]
            )
            if float(row["fall_rate"]) > 0.01:
                falls[row["name"], row["seed"]] = float(row["fall_rate"])
    there, here = (first, "g1.kernel.best"), (second, "g1.kernel.best-kl4e3")
    low, high = min(last[here].values()), max(last[here].values())
    usual = {f"{ms:.0f}" for ms in last[there].values()}
    assert (f"{low:.0f} to {high:.0f} ms, of `best` there 28" in pages["runs"]) and usual == {"28"}
    text = "takes {:.1f} instead of {:.1f} ms, and there are three".format(
        *(parts[key]["ppo_ms"] for key in (here, there))
    )
    assert text in pages["settings"]
    less = [100 - 100 * parts[here][name] / parts[there][name] for name in ("tail_ms", "fit_ms")]
    assert "take {:.1f} and {:.0f} % less".format(*less) in pages["computed"]
    more = []
    for host, name in ((second, "best"), (second, "ppo1024x12"), (third, "ppo1024x12")):
        ms = last[host, f"g1.warp.{name}"]
        usual = np.mean([ms[seed] for seed in ms if seed not in ("1100", "1101")])
        more += [100 * (ms[seed] / usual - 1) for seed in ("1100", "1101")]
    text = "with `best` by {:.0f} and {:.0f} %, with PPO by {:.0f} and {:.0f} %"
    assert text.format(*sorted(more[:2]), *sorted(more[2:4])) in pages["runs"]
    text = "Seeds 1100 and 1101 take {:.0f} and {:.0f} % longer an iteration"
    assert text.format(*more[4:]) in pages["runs"]
    falls = {key: share for key, share in falls.items() if ".best" in key[0] and "g1" in key[0]}
    assert falls == {
        ("g1.kernel.best-kl4e3", "1100"): 0.04,
        ("g1.kernel.best-kl4e3", "1105"): 0.014,
        ("g1.warp.best", "1100"): 0.015,
        ("g1.warp.best", "1101"): 0.025,
        ("g1.warp.best", "1104"): 0.015,
    }
    three = [
        np.array(errors[key])
        for key in (
            (first, "g1.kernel.best"),
            (second, "g1.warp.best"),
            (second, "g1.kernel.best-kl4e3"),
        )
    ]
    assert all(table.walks.tracks(*some.T).all() for some in three)
    text = "{:.3f} m/s and {:.3f} rad/s in the mean with our kernel, {:.3f} and {:.3f} with MuJoCo"
    assert text.format(*three[0].mean(0), *three[1].mean(0)) in pages["runs"]
    assert "and {:.3f} and {:.3f} of `best-kl4e3`".format(*three[2].mean(0)) in pages["runs"]
    counts = []
    for batch in ("fresh-warp", "fresh-900", "fresh"):
        some = [
            row
            for row in humanoid.table.read("tuning.csv.xz")
            if row["batch"] == batch and row["name"].startswith("best")
        ]
        took, *scores = humanoid.table.evaluations(some)
        early = took[:, 0] <= 0.7e6
        reached = stats.reached_by_tracking(took[early], *(score[early] for score in scores))
        counts.append(int(np.isfinite(reached.walks).sum()))
    assert counts == [9, 10, 8]
    fisher = pytest.importorskip("scipy.stats").fisher_exact
    for (one, of), (other, among), p in (
        ((2, 5), (10, 10), "p 0.022 (Fisher"),
        ((2 + 9, 15), (10 + 10 + 8, 30), "11 of 15 and 28 of 30, p 0.16"),
        ((8 + 6, 20), (10, 10), "beside ten of ten of `best` p 0.074"),
        ((8 + 6, 20), (10 + 10 + 8, 30), "beside its 28 of 30 p 0.047"),
    ):
        value = fisher([[one, of - one], [other, among - other]]).pvalue
        assert p in pages["runs"] and shows(re.findall(r"p (0\.\d+)", p)[0], value)
    # `best` for seconds once more
    again = run["g1.kernel", third, "best-kl4e3"]
    there = again.level[np.isfinite(again.level[:, 2]), 2]
    assert (len(there), int(np.isfinite(again.walks[:, 2]).sum())) == (9, 6)
    for name in ("runs", "settings"):
        assert f"after {there.mean():.2f} s" in pages[name]
    rows = [row for row in table.read() if (row["batch"], row["name"]) == (third, here[1])]
    ends = {row["seed"]: row for row in rows if row["iteration"] == "160"}
    (late,) = np.flatnonzero(np.isnan(again.level[:, 2]))
    late = [*ends.values()][late]
    assert (
        f"seed {late['seed']} still turns with an error of {float(late['yaw_error']):.2f}"
        in pages["runs"]
    )
    every = [*seconds[1], *there, float(late["seconds"])]
    text = "19 are, after {:.2f} s, and with the last one counted up to its end it is {}: PPO takes"
    text = text.format(np.mean(every[:-1]), table.interval(every))
    text += " {:.2f} times as long ({:.2f} to {:.2f})".format(*stats.ratio(seconds[2], every))
    assert text in pages["runs"]
    falling = {seed: float(row["fall_rate"]) for seed, row in ends.items()}
    falling = {seed: share for seed, share in falling.items() if share > 0.01}
    assert falling == {"1102": 0.02, "1104": 0.026, "1106": 0.022}
    assert "three fall in 2.0 to 2.6 % of the episodes (1102, 1104, 1106)" in pages["runs"]


def test_what_the_pages_of_seconds_say_of_rough_ground_is_so():
    """`best`, `best` for seconds and PPO of the same card, and PPO of another host: to shares of tiles and to
    the level, at the end, and what would be if they were evaluated as seldom."""
    table, rough = script(f"{ROW_COST}/table"), script("28_rough/table")
    found = table.runs()
    best, (few, ppo) = table.settings(found, "go2.rough")
    quick = table.fastest(table.variants(found, best))
    day = "H200, 2026-11-28"
    assert quick[1:3] == (f"{day}, fifth host", "best-r1e3") and ppo[1:3] == (
        quick.batch,
        "ppo4096",
    )
    assert few[1:3] == (f"{day}, fourth host", "ppo2048") and len(few.level) == 1
    (other,) = [x for x in found if x[:3] == ("go2.rough", f"{day}, third host", "ppo4096")]
    kept = {}
    for row in table.read():
        key = row["batch"], row["name"].removeprefix("go2.rough."), row["seed"]
        kept.setdefault(key[:2], {}).setdefault(row["seed"], []).append(row)

    def of(one):
        return [*kept[one.batch, one.method].values()]

    def column(rows, name):
        return np.array([float(row[name]) for row in rows])

    def clocks(one, share, name="seconds"):
        return np.array(
            [rough.first(column(rows, name), column(rows, "crossed"), share) for rows in of(one)]
        )

    def crossed(one, after=np.inf):
        return 100 * np.array(
            [np.interp(after, column(x, "seconds"), column(x, "crossed")) for x in of(one)]
        )

    def around(one, digits=1):
        return "{:.{d}f} ({:.{d}f} to {:.{d}f})".format(*one, d=digits)

    def within(one, words, digits=1):  # 3.9 times the steps (2.1 to 5.9)
        return around(one, digits).replace(" (", f" {words} (")

    def line(label, values):
        return f"| {label} | " + " | ".join(values) + " |"

    four = best, quick, ppo, other
    level, steps = ([one.level[:, k] for one in four] for k in (2, 1))
    walked = [one.walks[np.isfinite(one.walks[:, 2]), 2] for one in four]
    last = [column([rows[-1] for rows in of(one)], "seconds").mean() for one in four]
    ends = [crossed(one) for one in four]
    falls = [100 * column([rows[-1] for rows in of(one)], "fell") for one in four]
    every = [int(of(one)[0][0]["iteration"]) for one in four]
    ms = [
        1e3 * np.mean([float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in of(one)])
        for one in four
    ]
    updates = [float(of(one)[0][0]["ppo_ms"]) for one in four]
    seventy, eighty = ([clocks(one, share) for one in four] for share in (0.7, 0.8))
    to_80 = [clocks(one, 0.8, "sim_steps") for one in four]

    def ten(some):
        return np.concatenate(some[2:])

    good = [[rough.at_level(rough.shares(row)) for row in rows] for one in four for rows in of(one)]
    counts = [sum(some) for some in good]
    assert {len(some) for some in good[5:10]} == {36} and {len(x) for x in good[10:]} == {15}
    seldom = np.array(  # [begin, seed]
        [[table.reached(rows[k::7])[0, 2] for rows in of(quick)] for k in range(7)]
    )
    assert round(every[2] * ms[2] / (every[1] * ms[1])) == 7  # "seven times as often"
    there = (~np.isnan(seldom)).sum(1)
    assert (there.min(), there.max()) == (2, 5)  # "two to five"
    seldom = np.nanmean(seldom, axis=1)
    rows = [(one.level[:, 1] / one.robots).mean() for one in four]
    rest = [
        np.mean((1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row) / one.level[:, 0])
        for one in four
    ]
    even = {}
    for mine, its in ((best, ppo), (best, other), (quick, ppo)):
        cost = table.cost(found, mine)
        here = [table.at_cost(found, its, cost)]
        for power in (table.power_of(mine.place), 1.0):
            even[mine.method, its.batch, power == 1] = table.break_even(mine, here, cost, power)
    points = stats.difference(crossed(ppo, last[1]), crossed(quick, last[1]))
    then = [crossed(one, last[0]) for one in four]
    assert f"{then[3].mean():.0f}" == f"{then[2].mean():.0f}"
    later, longer = stats.difference(level[2], level[1]), stats.ratio(level[2], level[1])
    more, default = stats.ratio(steps[2], steps[1]), stats.ratio(steps[2], steps[0])
    slower = stats.ratio(level[0], level[1])
    thirds = stats.ratio(steps[3], steps[0])
    said = {
        "30_row_cost/README.md": [
            f"after {level[2].mean():.1f} with PPO on the same card:"
            f" {within(longer, 'times as long', 2)}, for {within(more, 'times the steps')}",
            f"two to five of its five seeds are there, after {seldom.min():.1f} to {seldom.max():.1f} s",
            f"{ten(eighty).mean():.1f} s, in ten runs on two hosts, instead of {eighty[1].mean():.1f}",
            f"crosses {ends[1].mean():.0f} % of tiles, PPO {ends[2].mean():.0f} % after"
            f" {last[2] / last[1]:.1f} times as long",
            f"PPO with 2048 robots on rough ground one of five ({few.level[0, 2]:.1f} s)",
        ],
        "30_row_cost/runs.md": [
            line("70 % of all tiles, s", map(table.interval, seventy)),
            line("80 %", map(table.interval, eighty)),
            line(
                "first at the level, s (first to last seed)",
                (f"{x.mean():.2f} ({x.min():.2f} to {x.max():.2f})" for x in level),
            ),
            line("the same, M steps", (f"{x.mean() / 1e6:.2f}" for x in steps)),
            line(
                "at the level at the end, and from when on: seeds, s",
                (f"{len(x)}, {x.mean():.2f}" for x in walked),
            ),
            line(
                "at the end: of all tiles, s",
                (f"{x.mean():.0f} %, {s:.1f}" for x, s in zip(ends, last, strict=True)),
            ),
            line("falls at the end (seeds)", (f"{x.min():.0f} to {x.max():.0f} %" for x in falls)),
            line(
                "evaluated every: iterations, s",
                (
                    f"{n}, {n * x / 1e3:.{2 if n == 25 else 1}f}"
                    for n, x in zip(every, ms, strict=True)
                ),
            ),
            line("an iteration, ms", (f"{x:.1f}" for x in ms)),
            f"at the level by {within(later, 's').replace(')', '')},"
            f" Welch's p {stats.welch_of(level[2], level[1]):.2f}),"
            f" {within(longer, 'times the seconds', 2)} and {within(more, 'times the steps')}",
            f"all ten runs of PPO it is {within(stats.difference(ten(level), level[1]), 's')} and"
            f" {within(stats.ratio(ten(steps), steps[1]), 'times the steps')}",
            f"{175 * ms[1] / 1e3:.1f} s apart, two to five seeds of `best-r1e3` are there, after"
            f" {seldom.min():.1f} to {seldom.max():.1f} s",
            f"to 80 % by {within(stats.difference(eighty[1], eighty[2]), 's on that card')}, and by"
            f" {around(stats.difference(eighty[1], ten(eighty))).replace(' (', ' with all ten runs (')[:-1]},"
            f" p {stats.welch_of(eighty[1], ten(eighty)):.2f}), for"
            f" {within(stats.ratio(ten(to_80), to_80[1]), 'times the steps')}",
            f"After its {last[1]:.1f} s it crosses {crossed(quick, last[1]).mean():.0f} % of tiles, PPO"
            f" {crossed(ppo, last[1]).mean():.0f} % by then ({points.value:.1f} points more,"
            f" {points.low:.1f} to {points.high:.1f})",
            f"At its end PPO has {within(stats.difference(ends[2], ends[1]), 'points more')}, and the"
            f" default `best` {around(stats.difference(ends[0], ends[1]))}",
            f"in {min(counts[5:10])} to {max(counts[5:10])} of 36 evaluations, PPO's, in runs almost"
            " three times as long, in"
            f" {min(counts[10:])} to {max(counts[10:])} of 15 on both hosts",
            f"takes {within(slower, 'times the seconds of `best-r1e3` to the level')},"
            f" and `best-r1e3` {within(stats.ratio(steps[1], steps[0]), 'times its steps')}",
            f"default by {within(stats.difference(level[0], level[2]), 's')} on the fifth host, for"
            f" {within(default, 'times the steps')}, and by"
            f" {around(stats.difference(level[0], level[3]))} on the third, for"
            f" {within(thirds, 'times')}. After the {last[0]:.1f} s of `best` PPO crosses"
            f" {then[2].mean():.0f} % of tiles on both,"
            f" {within(stats.difference(ten(then), then[0]), 'points more with all ten runs')}",
            f"one seed before it was cut off: {few.level[0, 2]:.2f} s, {few.level[0, 1] / 1e6:.1f} M",
            f"0.36 ms on the second and fifth hosts, one of 4096 {ppo.row:.2f} on the fifth and"
            f" {other.row:.2f} on the third; so one of 1024"
            " {:.2f}, {:.2f} and {:.2f}".format(
                *(table.cost(found, x) for x in (best, ppo, other))
            ),
        ],
        "30_row_cost/computed.md": [
            f"{rows[0]:.0f} rows of 2048 robots with `best`, {rows[1]:.0f} with `best` for seconds and"
            f" {rows[2]:.0f} of 4096 with PPO on the same card. All else takes {rest[0]:.1f} ms an"
            f" iteration of 460, {rest[1]:.1f} of 620, and {rest[2]:.1f} of 420. Of `best` three updates"
            f" take {3 * updates[0]:.0f} of it, of `best` for seconds its one {updates[1]:.1f}.",
            "it would be {:.1f} ms on a Go2 ({:.2f} to {:.1f})".format(
                *even["best", ppo.batch, False]
            ),
            "{:.2f} ({:.2f} to {:.1f}) if a row costs as".format(*even["best", ppo.batch, True]),
            "it would be {:.1f} ({:.2f} to {:.1f}) and".format(*even["best", other.batch, False]),
            "and {:.2f} ({:.2f} to {:.2f}). `best` for".format(*even["best", other.batch, True]),
            "in the mean from {0:.2f} ms on, and up to {2:.1f} no".format(
                *even["best-r1e3", ppo.batch, False]
            ),
        ],
        "28_rough/README.md": [
            f"after {level[2].mean():.1f}, for {within(default, 'times the steps')}",
            f"`best` takes {level[1].mean():.1f} s on PPO's card",
            f"it was evaluated seven times as often, ends at {ends[1].mean():.0f} % of all tiles",
        ],
        "28_rough/time.md": [
            f"{eighty[0].mean():.1f} s for 80 % of tiles and {level[0].mean():.1f} to the level,"
            f" {last[0]:.1f} for the whole run; with one round, three epochs and a KL of 0.03 it takes"
            f" {eighty[1].mean():.1f}, {level[1].mean():.1f} and {last[1]:.1f}; with PPO and 4096 robots"
            f" on that same card {eighty[2].mean():.1f}, {level[2].mean():.1f} and {last[2]:.1f}.",
            f"for {more.value:.1f} times the steps with PPO. But PPO ends at {ends[2].mean():.0f} instead"
            f" of {ends[1].mean():.0f} % of tiles, and with ten runs on two hosts it is sooner at 80 %,"
            f" after {ten(eighty).mean():.1f} s",
            f"takes {ms[0]:.1f} ms, {3 * updates[0]:.0f} of them three updates; with one round and three"
            f" epochs {ms[1]:.1f}, {updates[1]:.1f} of them its one; one of PPO {ms[2]:.1f},"
            f" {updates[2]:.1f} of them its one",
        ],
        "../docs/results.md": [
            "a Go2 on rough ground from {:.2f} or {:.1f}, by".format(
                *(even["best", ppo.batch, alone][0] for alone in (True, False))
            )
        ],
        "28_rough/ppo.md": [
            f"they need {within(stats.ratio(to_80[2], to_80[0]), 'times the steps to 80 % of tiles')} and"
            f" {within(default, 'times to the level')}, on another"
            f" {around(stats.ratio(to_80[3], to_80[0]))} and {around(thirds)}",
            f"end at {ends[2].mean():.0f} and {ends[3].mean():.0f} % of tiles,"
            f" {around(stats.difference(ends[2], ends[0]))} and"
            f" {within(stats.difference(ends[3], ends[0]), 'points')} above these `best`",
        ],
    }
    labels = {
        "tune-r1e3": "one round, e3",
        "tune-r1": "one round",
        "tune-r2e3": "two rounds, e3",
        "tune-r2": "two rounds",
        "tune-e3": "three rounds, e3",
    }
    tuned = {x.method: x for x in found if x[:2] == ("go2.rough", f"{day}, fourth host")}
    assert {*tuned} == {*labels, "ppo2048"}
    lines = said["30_row_cost/settings.md"] = [
        f"takes {level[1].mean():.2f} s instead of the {level[0].mean():.2f} of `best`, and PPO"
        f" {level[2].mean():.2f} on the same card"
    ]
    for method, label in labels.items():
        one = tuned[method]
        seeds = of(one)
        took = np.mean([1e3 * float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in seeds])
        low, high = sorted(crossed(one), reverse=method == "tune-e3")  # as the seeds are
        cost = f"{took:.1f} | {one.level[:, 2].mean():.2f} | {one.level[:, 1].mean() / 1e6:.2f}"
        lines.append(
            f"| {label} | {cost} | {clocks(one, 0.8).mean():.2f} | {low:.0f} and {high:.0f} % |"
        )
    for name, texts in said.items():
        page = " ".join((EXPERIMENTS / name).read_text().split())
        for text in texts:
            assert text in page, (name, text)


def test_what_the_pages_of_seconds_say_of_a_g1s_ppo_on_the_fifth_host_is_so():
    """All its ten seeds beside the seven of the host of `best`, which the tables have."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    pages = {
        name: " ".join((EXPERIMENTS / f"{name}.md").read_text().split())
        for name in (f"{ROW_COST}/README", f"{ROW_COST}/runs", "25_humanoid/seconds")
    }
    best, (seven,) = table.settings(found, "g1.kernel")
    quick = table.fastest(table.variants(found, best))
    (ten,) = [
        x for x in found if x[:3] == ("g1.kernel", "H200, 2026-11-28, fifth host", "ppo1024x12")
    ]
    assert seven.batch == best.batch and [len(x.level) for x in (seven, ten)] == [7, 10]
    its, mine, fast, usual = (x.level[:, 2] for x in (ten, quick, seven, best))
    runs = pages[f"{ROW_COST}/runs"]
    for text in (
        f"PPO takes {table.interval(its)} s** to the level here",
        f"{table.interval(fast)}: "
        + "{:.2f} s more ({:.2f} to {:.2f})".format(*stats.difference(its, fast)),
        "host takes {:.2f} s longer ({:.2f} to {:.2f})".format(*stats.difference(usual, its)),
        "PPO {:.2f} times the seconds ({:.2f} to {:.2f})".format(*stats.ratio(its, usual)),
        "for {:.1f} times the steps ({:.1f} to {:.1f})".format(
            *stats.ratio(ten.level[:, 1], best.level[:, 1])
        ),
        "second takes {:.2f} s less ({:.2f} to {:.2f})".format(*stats.difference(its, mine)),
        "PPO {:.2f} times ({:.2f} to {:.2f})".format(*stats.ratio(its, mine)),
        "for {:.1f} times the steps ({:.1f} to {:.1f})".format(
            *stats.ratio(ten.level[:, 1], quick.level[:, 1])
        ),
        f"PPO takes {ten.walks[:, 2].mean():.2f} s, and so does `best`",
        "difference of {:.2f} s ({:.2f} to {:.2f})".format(
            *stats.difference(best.walks[:, 2], ten.walks[:, 2])
        ),
    ):
        assert text in runs, text
    ms = table.cost(found, best)
    here = table.at_cost(found, ten, ms)
    walks = table.to_walk(best), [table.to_walk(ten)]
    cells = (
        table.even(best, [here], ms),
        table.even(walks[0], [table.at_cost(found, walks[1][0], ms)], ms),
        table.for_seconds(found, quick, [ten]).removeprefix("; for seconds "),
    )
    text = "it would be {}, to a walk {}, and with settings for seconds {}."
    computed = " ".join((EXPERIMENTS / ROW_COST / "computed.md").read_text().split())
    assert text.format(*cells).replace("0.5 (", "0.50 (") in computed
    text = f"take {table.interval(its)} s: " + "{:.2f} times as long as `best` ({:.2f} to {:.2f})"
    assert text.format(*stats.ratio(its, usual)) in pages["25_humanoid/seconds"]


def test_what_the_pages_of_seconds_say_of_a_g1_with_settings_for_seconds_is_so():
    """`best-kl4e3` and PPO on the sixth host, and all runs of that day."""
    table = script(f"{ROW_COST}/table")
    found, day = table.runs(), "H200, 2026-11-28"
    ours, theirs = (
        {
            x.batch: x
            for x in found
            if (x.place, x.method) == ("g1.kernel", method) and day in x.batch
        }
        for method in ("best-kl4e3", "ppo1024x12")
    )
    assert [len(x.level) for x in ours.values()] == [10] * 3
    assert sorted(len(x.level) for x in theirs.values()) == [7, 10, 10]
    last = {}  # batch -> seed -> row
    for row in table.read():
        if row["name"] == "g1.kernel.best-kl4e3" and row["iteration"] == "160":
            last.setdefault(row["batch"], {})[row["seed"]] = row

    def counted(run, name, at):
        ends = [float(row[name]) for row in last[run.batch].values()]
        return np.where(np.isnan(run.level[:, at]), ends, run.level[:, at])

    pages = {
        name: " ".join((EXPERIMENTS / f"{name}.md").read_text().split())
        for name in (
            f"{ROW_COST}/README",
            f"{ROW_COST}/runs",
            f"{ROW_COST}/settings",
            "25_humanoid/seconds",
        )
    }
    host = f"{day}, sixth host"
    mine, ppo = ours[host], theirs[host]
    there = mine.level[np.isfinite(mine.level[:, 2]), 2]
    late = [[*last[host].values()][k] for k in np.flatnonzero(np.isnan(mine.level[:, 2]))]
    its, ends = ppo.level[:, 2], counted(mine, "seconds", 2)
    runs = pages[f"{ROW_COST}/runs"]
    errors = [float(row["yaw_error"]) for row in late]
    one = "PPO takes {:.2f} times as long ({:.2f} to {:.2f})".format(*stats.ratio(its, ends))
    for text in (
        f"PPO takes {table.interval(its)} s** to the level, and all ten walk, after"
        f" {table.interval(ppo.walks[:, 2])}",
        f"at the level by iteration 160, after {table.interval(there)} s; seeds {late[0]['seed']} and"
        f" {late[1]['seed']} turn with errors of {errors[0]:.2f} and {errors[1]:.2f} rad/s",
        f"it is {table.interval(ends)}: {one}, "
        + "{:.2f} s more ({:.2f} to {:.2f})".format(*stats.difference(its, ends)),
    ):
        assert text in runs, text
    assert (len(there), np.isfinite(mine.walks[:, 2]).sum()) == (
        8,
        6,
    )  # "Eight of ten", "Six of ten walk"
    assert one in pages[f"{ROW_COST}/README"]
    assert f"on a sixth host eight do, after {there.mean():.2f} s" in pages[f"{ROW_COST}/settings"]
    all_ours, all_theirs = (
        [np.concatenate([of(run, k) for run in some.values()]) for k in (2, 1)]
        for some, of in (
            (ours, lambda run, k: counted(run, {1: "sim_steps", 2: "seconds"}[k], k)),
            (theirs, lambda run, k: run.level[:, k]),
        )
    )
    assert sum(np.isfinite(x.level[:, 2]).sum() for x in ours.values()) == 27
    walk = [sum(np.isfinite(x.walks[:, 2]).sum() for x in some.values()) for some in (ours, theirs)]
    assert walk == [20, 27] and len(all_theirs[0]) == 27
    slower = "{:.2f} times as long ({:.2f} to {:.2f}".format(
        *stats.ratio(all_theirs[0], all_ours[0])
    )
    steps = "{:.1f} times the steps ({:.1f} to {:.1f})".format(
        *stats.ratio(all_theirs[1], all_ours[1])
    )
    more = "{:.2f} s more, {:.2f} to {:.2f}".format(*stats.difference(all_theirs[0], all_ours[0]))
    p = stats.welch_of(all_theirs[0], all_ours[0])
    both = table.interval(all_ours[0]), table.interval(all_theirs[0])
    text = "`best-kl4e3` takes {} s and PPO {}: ".format(*both)
    assert f"{text}{slower}; {more}, Welch's p {p:.2f}), for {steps}" in runs
    assert f"takes {slower}), for {steps.split(' (')[0]}" in pages[f"{ROW_COST}/README"]
    assert f"to their end it takes {all_ours[0].mean():.2f} s" in pages[f"{ROW_COST}/README"]
    text = (
        "it takes {} s, where runs that do not get there count with their last second, which is too"
    )
    text += " little, and PPO on three hosts {}: "
    assert text.format(*both) + slower + ")" in pages["25_humanoid/seconds"]
    # PPO, judged by when `best-kl4e3` ends
    least, soon = (
        np.mean([float(r["seconds"]) for some in last.values() for r in some.values()]),
        [],
    )
    for batch in theirs:
        each = {}
        for r in table.read():
            if (r["batch"], r["name"]) == (batch, "g1.kernel.ppo1024x12") and float(
                r["seconds"]
            ) <= 3.62:
                each.setdefault(r["seed"], []).append(r)
        soon += [np.isfinite(table.reached(rows)[:, 0]) for rows in each.values()]
    assert len(soon) == 27 and f"{least:.1f}" == "3.6"
    text = (
        "by the {:.1f} of `best-kl4e3` {:.0f} of its 27 are at the level, too, and {:.0f} walk if"
    )
    assert text.format(least, *np.sum(soon, 0)) in runs
    text = f"of a G1 {all_ours[0].mean():.2f}, 3.65 and {all_theirs[0].mean():.2f} on several"
    assert text in pages[f"{ROW_COST}/README"]


def around(one, digits=1, words=""):
    """4.8 times as long (3.7 to 7.0)"""
    return "{:.{d}f}{} ({:.{d}f} to {:.{d}f})".format(one[0], words, *one[1:], d=digits)


def of_host(table, host):
    """The rows of its jobs: name -> seed -> rows."""
    found = {}
    for row in table.read():
        if row["batch"] == host:
            found.setdefault(row["name"], {}).setdefault(row["seed"], []).append(row)
    return found


def test_what_the_pages_of_seconds_say_of_ppo_with_512_robots_in_the_exact_tasks_is_so():
    """All five seeds, on another host than `best`, and those that the call's end left of the first."""
    table, day = script(f"{ROW_COST}/table"), "H200, 2026-11-28"
    host = f"{day}, seventh host"
    found, jobs = table.runs(), of_host(table, host)
    run = {one[:3]: one for one in found}
    lines, between, few, falls = [], [], [], []
    for place, label, count in (("go1.exact", "Go1", 4), ("anymal_c.exact", "ANYmal-C", 5)):
        one, cut_off = (run[place, batch, "ppo512"] for batch in (host, day))
        clock = one.level[:, 2]
        known = clock[np.isfinite(clock)]
        assert (len(clock), len(known)) == (5, count) and np.isnan(one.walks).all()
        between.append(stats.difference(known, cut_off.level[:, 2]))
        few.append(stats.ratio(table.steps(one), run[place, day, "best"].level[:, 1]))
        told = ["never" if np.isnan(x) else f"{x:.2f}" for x in clock]
        lines.append(f"| {label}: s to the level | " + " | ".join(told) + " |")
        last = [rows[-1] for rows in jobs[f"{place}.ppo512"].values()]
        percent = [100 * float(row["fall_rate"]) for row in last]
        told = [
            f"{float(row['return']):.1f}, {x:.1f} %" for row, x in zip(last, percent, strict=True)
        ]
        lines.append("| return and falls at the end | " + " | ".join(told) + " |")
        falls.append(f"{min(percent):.1f} to {max(percent):.1f} % of the five")
    go1, anymal = (run[place, host, "ppo512"] for place in ("go1.exact", "anymal_c.exact"))
    rows = [
        f"{f(one):.2f}"
        for f in (lambda x: x.row, partial(table.cost, found))
        for one in (go1, anymal)
    ]
    highest = max(float(row["return"]) for row in jobs["go1.exact.ppo512"]["1102"])
    lines += [
        f"after {table.interval(go1.level[:, 2])} s. Seed 1102 does not: its highest return is"
        f" {highest:.1f}. With its whole run counted the five take"
        f" {table.interval(table.steps(go1) / 1e6)} M steps, which is too little, and at least"
        f" {around(few[0], words=' times those of `best`')}",
        f"after {table.interval(anymal.level[:, 2])} s, for {around(few[1], words=' times the steps')}",
        f"of a Go1's four and two seeds {around(between[0], words=' s')}, of an ANYmal-C's five and"
        f" four {around(between[1])}",
        f"it is {falls[1]} ANYmals and {falls[0]} Go1",
        "took {} and {} ms there; so one of 1024 {} and {} (computed)".format(*rows),
    ]
    slower = []
    for name in ("go1.exact.ppo512", "anymal_c.exact.ppo512"):
        ms = {seed: float(rows[-1]["seconds"]) for seed, rows in jobs[name].items()}
        usual = np.mean([ms[seed] for seed in ms if seed not in ("1100", "1101")])
        slower += [100 * (ms[seed] / usual - 1) for seed in ("1100", "1101")]
    lines.append(f"on the seventh host by {min(slower):.0f} to {max(slower):.0f} %")
    page = " ".join((EXPERIMENTS / ROW_COST / "runs.md").read_text().split())
    for text in lines:
        assert text in page, text


def test_what_the_pages_of_seconds_say_of_mjx_jax_is_so():
    """`best` and PPO with 2048 robots of one host, `best` and PPO with 1024 of two others, and what was
    computed from the runs with our kernel."""
    table, day = script(f"{ROW_COST}/table"), "H200, 2026-11-28"
    found, host = table.runs(), f"{day}, eighth host"
    run = {one[:3]: one for one in found}
    pages = {
        name: " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())
        for name in ("README", "runs", "computed")
    }
    best, ppo = run["go1.jax", host, "best"], run["go1.jax", host, "ppo2048"]
    before = run["go1.jax", f"{day}, sixth host", "best"]
    few = run["go1.jax", f"{day}, seventh host", "ppo1024"]
    assert table.settings(found, "go1.jax") == (best, [few, ppo])
    assert table.fastest_beside(best, [few, ppo]) is ppo and table.sparing([few, ppo]) is few
    assert table.fastest([few, ppo]) is few  # by 0.04 s, on another host
    both = [one.level[:, 2].mean() for one in (ppo, few)]
    assert "on one host: {:.2f} instead of {:.2f} s)".format(*both) in pages["README"]
    assert np.isfinite([ppo.walks, few.walks, before.walks]).all() and len(ppo.walks) == 5
    walked = best.walks[np.isfinite(best.walks[:, 2]), 2]
    jobs = of_host(table, host)
    last = {
        name: [rows[-1] for rows in jobs[f"go1.jax.{name}"].values()] for name in ("best", ppo[2])
    }
    (late,) = np.flatnonzero(np.isnan(best.walks[:, 2]))
    assert last["best"][late]["seed"] == "1103" and float(last["best"][late]["fall_rate"]) == 0.015
    # the first of the four: at the last evaluation alone
    assert [*jobs["go1.jax.best"]][0] == "1100" and best.walks[0, 0] == 150 and len(walked) == 4
    ended = float(last["best"][late]["seconds"])
    counted = [*walked, ended]
    every = [
        np.mean([10 * float(row["seconds"]) / int(row["iteration"]) for row in last[name]])
        for name in ("best", "ppo2048")
    ]
    both = np.concatenate([best.level, before.level])[:, 2]
    clocks = ppo.level[:, 2], best.level[:, 2]
    longer, more = stats.ratio(*clocks), around(stats.difference(*clocks), words=" s longer")
    least = "{:.0f} times the steps ({:.0f} to {:.0f})".format(
        *stats.ratio(ppo.level[:, 1], best.level[:, 1])
    )
    ours = {m: run["go1.kernel", "H200, 2026-11-27", m] for m in ("best", "ppo1024", "ppo2048")}
    steps = [stats.ratio(one.level[:, 1], ours[one.method].level[:, 1]) for one in (few, ppo)]
    at = table.at_cost(found, few, best.row).level[:, 2]
    gap = stats.difference(clocks[0], few.level[:, 2])
    cells = [table.interval(one.level[:, 2]) for one in (ppo, best, few)]
    for text in (
        f"PPO takes {cells[0]} s and `best` {cells[1]}: {more},"
        f" {around(longer, words=' times as long')}, for {least}. Beside all ten runs of `best`,"
        f" {table.interval(both)} s, it is {around(stats.ratio(clocks[0], both), words=' times')}",
        f"PPO takes {table.interval(ppo.walks[:, 2])} s, all five. Of `best` four walk, after"
        f" {walked.mean():.2f}; the first",
        f"is at the level from {best.level[late, 2]:.1f} s on, but falls in 3 of 200",
        f"up to its end, {ended:.1f} s, which is too little, `best` takes {np.mean(counted):.2f} s and PPO"
        f" {around(stats.ratio(ppo.walks[:, 2], counted), words=' times as long')}. On the sixth host all"
        f" five walk, after {before.walks[:, 2].mean():.2f}.",
        "which take {:.1f} s with `best` and {:.1f} with PPO. So its seconds may be {:.1f} too".format(
            *every, every[1]
        ),
        f"takes {cells[2]} s to the level; with 2048 it is no different ({gap.value:.1f} s more,"
        f" {gap.low:.1f} to {gap.high:.1f}). A row of 1024 took {few.row:.2f} ms there and"
        f" {best.row:.2f} on the eighth. If its rows had cost these {best.row:.2f}, it would have taken"
        f" {at.mean():.2f} s, {around(stats.ratio(at, clocks[1]), words=' times as long as `best`')}",
        "It needs {:.1f} times the steps ({:.1f} to {:.0f}), which".format(
            *stats.ratio(few.level[:, 1], best.level[:, 1])
        ),
        f"which is {steps[0].value:.2f} times those of the same setting with our kernel"
        f" ({steps[0].low:.2f} to {steps[0].high:.2f})",
        f"with 2048 robots it is {around(steps[1], 2, ' times')}",
    ):
        assert text in pages["runs"], text
    # computed from the runs with our kernel
    power, cost = table.power_of("go1.jax"), table.cost(found, ours["best"])
    mine, its = (table.later(ours[m], cost, best.row, power) for m in ("best", "ppo2048"))
    walk = table.later(table.to_walk(ours["ppo2048"]), cost, best.row, power)
    slow = table.later(ours["ppo1024"], cost, few.row, power)
    for measured, computed in ((best.level, mine), (ppo.level, its), (ppo.walks, walk)):
        gap = stats.difference(measured[:, 2], computed)
        assert gap.low < 0 < gap.high  # "Of none a difference is shown"
    text = (
        f"{best.row:.1f} ms a row, a Go1 is at its level after {clocks[1].mean():.2f} s with `best` and after"
        f" {clocks[0].mean():.2f} with PPO with 2048 robots, one after the other on one card:"
        f" {around(longer, words=' times as long')}, for {least}. PPO's five walk, after"
        f" {ppo.walks[:, 2].mean():.2f} s, of `best` [four by their end](runs.md#go1), after"
        f" {walked.mean():.2f}. On two other hosts it was {before.level[:, 2].mean():.2f} s with `best` and,"
        f" with 1024 robots, {few.level[:, 2].mean():.2f}; there all walked. Before PPO with 2048 robots ran,"
        " this page had computed 11.3 s for it from the runs with our kernel; at the cost of a row that was"
        f" measured then it is {its.mean():.1f}, for `best` {mine.mean():.1f}."
    )
    assert text in pages["README"]
    rows = [one.level[:, 1] / one.robots for one in (best, ppo)]
    rest = [
        f"{np.mean((1e3 * one.level[:, 2] - some * one.row) / one.level[:, 0]):.1f}"
        for one, some in zip((best, ppo), rows, strict=True)
    ]
    less = around(stats.difference(slow, few.level[:, 2]), words=" s less")
    even = table.even(best, [table.at_cost(found, one, best.row) for one in (few, ppo)], best.row)
    for text in (
        f"would take {mine.mean():.1f} s with `best` to the level, measured {cells[1]}, and"
        f" {its.mean():.1f} with PPO with 2048 robots, measured {cells[0]}; to a walk PPO would take"
        f" {walk.mean():.1f}, measured {table.interval(ppo.walks[:, 2])}. Of none",
        f"would take {slow.mean():.1f} s to the level, measured {cells[2]}: {less}, because it needed"
        f" {steps[0].value:.2f} times the steps.",
        f"needs {rows[0].mean():.0f} rows of 1024 robots with `best` and {rows[1].mean():.0f} of 2048 with"
        f" PPO. All else takes {rest[0]} ms an iteration of {best.level[:, 0].mean():.0f}, and {rest[1]} of"
        f" {ppo.level[:, 0].mean():.0f}.",
        f"alone, is {even.replace(' (', ' ms (')}, too, beside PPO with 1024 and 2048 robots.",
    ):
        assert text in pages["computed"], text


def test_what_the_pages_of_seconds_say_of_two_cores_is_so():
    """`best` of :laptop and PPO with 512 and 256 robots; also as if they had been evaluated all the time."""
    table, batch = script(f"{ROW_COST}/table"), "two cores, 2026-11-28"
    found, jobs = table.runs(), of_host(table, batch)
    run = {one.method: one for one in found if one[:2] == ("go1.laptop", batch)}
    pages = {
        name: " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())
        for name in ("README", "runs")
    }
    best, many, few = (run[name] for name in ("best", "ppo512", "ppo256"))
    assert table.settings(found, "go1.laptop") == (best, [many, few])
    assert table.fastest([many, few]) is many and table.sparing([many, few]) is few

    def at_38(name, column):
        """Read off a line between evaluations."""
        times = []
        for rows in jobs[f"go1.laptop.{name}"].values():
            returns, values = ([float(row[key]) for row in rows] for key in ("return", column))
            k = next(i for i, value in enumerate(returns) if value >= 38)
            times.append(np.interp(38, returns[k - 1 : k + 1], values[k - 1 : k + 1]))
        return np.array(times)

    last = {name: [seed[-1] for seed in jobs[f"go1.laptop.{name}"].values()] for name in run}
    ms = {
        name: [1e3 * float(row["seconds"]) / int(row["iteration"]) for row in rows]
        for name, rows in last.items()
    }
    each = {
        name: every * np.mean(ms[name]) / 1e3
        for name, every in (("ppo256", 40), ("best", 25), ("ppo512", 20))
    }
    clocks, steps = ({m: at_38(m, c) for m in run} for c in ("seconds", "sim_steps"))
    usual = ms["ppo256"][:4]
    seconds = [one.level[:, 2] for one in (best, many, few)]
    ratios = [stats.ratio(one.level[:, 1], best.level[:, 1]) for one in (many, few)]
    fewer = "1.1 times the steps ({1:.2f} to {2:.1f})"
    assert [f"{x.value:.1f}" for x in ratios] == ["1.8", "1.1"]
    for text in (
        f"it takes {seconds[2].mean():.1f} s, `best` {seconds[0].mean():.1f}:"
        f" {around(stats.difference(seconds[2], seconds[0]), words=' s more')}, for"
        f" {fewer.format(*ratios[1])}",
        "needs {:.2f} times the steps of PPO with 512 robots ({:.2f} to {:.2f})".format(
            *stats.ratio(few.level[:, 1], many.level[:, 1])
        ),
        "every {ppo256:.0f} s or so, `best` every {best:.0f} and `ppo512` every {ppo512:.0f}".format(
            **each
        ),
        "`best` takes {best:.1f} s, `ppo512` {ppo512:.1f} and `ppo256` {ppo256:.1f}: ".format(
            **{name: some.mean() for name, some in clocks.items()}
        )
        + around(stats.difference(clocks["ppo256"], clocks["best"]), words=" s more than `best`")
        + f", for {fewer.format(*stats.ratio(steps['ppo256'], steps['best']))}",
        f"an iteration of it takes {ms['ppo256'][4]:.0f} ms, of the other four {min(usual):.0f} to"
        f" {max(usual):.0f}, at whose mean it would be at the level after"
        f" {few.level[4, 0] * np.mean(usual) / 1e3:.1f} s, not {few.level[4, 2]:.1f}",
        f"256 robots took {few.row:.1f} ms, of 512 {many.row:.1f} (`ppo512`) and {best.row:.1f}",
    ):
        assert text in pages["runs"], text
    # who walks, and who but for the last evaluation would
    assert [f"{one.walks[:, 0]}" for one in (few,)] == ["[160. 160.  nan  nan 120.]"]
    for seed, since in (("1102", 160), ("1103", 120)):
        *rows, end = jobs["go1.laptop.ppo256"][seed]
        assert float(end["fall_rate"]) == 0.02 and table.reached(rows)[1, 0] == since
    ends = [float(last[name][0]["sim_steps"]) / 1e6 for name in ("best", "ppo256")]
    assert "ended at {:.1f} M steps, PPO at {:.1f} M".format(*ends) in pages["runs"]
    longer = [stats.ratio(some, seconds[0]) for some in seconds[1:]]
    text = "{:.1f} s with `best` of `:laptop` and {:.1f} with PPO with as many robots, 1.1 times as long"
    text += " ({:.2f} to {:.1f}), for 1.8 times the steps ({:.1f} to {:.1f}). PPO with 256 robots and its"
    text += " settings of the GPU takes {:.1f} s, 1.2 times as long ({:.2f} to {:.1f}), for "
    cells = seconds[0].mean(), seconds[1].mean(), *longer[0][1:], *ratios[0][1:]
    text = text.format(*cells, seconds[2].mean(), *longer[1][1:]) + fewer.format(*ratios[1])
    assert text in pages["README"]
    even = table.even(best, [many, few], table.cost(found, best)).partition(" (")
    assert f"[{even[0]} ms](runs.md#two-cores) ({even[2][:-1]}; computed)" in pages["README"]


def test_marks_of_rows_that_cost_nearly_the_same_stand_apart():
    plot = script(f"{ROW_COST}/plot")
    where = plot.apart([0.2, 2.2, 2.33, 2.44, 40.0])
    assert where[[0, 4]] == pytest.approx([0.2, 40.0])
    assert where[2:4] / where[1:3] == pytest.approx(plot.APART)
    assert np.prod(where[1:4]) == pytest.approx(2.2 * 2.33 * 2.44)  # about where they were


def test_seconds_and_steps_are_drawn_over_the_cost_of_a_row(drawn):
    script(f"{ROW_COST}/plot").main()
    assert drawn == ["row_cost"]


PLAYGROUND = "05_playground"


@pytest.fixture
def playground_runs(monkeypatch, tmp_path):
    """The table script of 05_playground on two runs of brax's PPO and three of ours, by hand."""
    table = script(f"{PLAYGROUND}/table")
    monkeypatch.setattr(table, "RESULTS", tmp_path)

    def run(name, job, seed, returns):
        head = "job,seed,iteration,sim_steps,seconds,return,fall_rate\n"
        rows = (f"{job},{seed},{i},{i}e6,{10 * i},{x},0.5\n" for i, x in enumerate(returns, 1))
        (tmp_path / f"{name}.csv").write_text(head + "".join(rows))

    run("a", "brax:Go1Getup", 0, [5, 12, 10])
    run("b", "brax:Go1Getup", 1, [5, 12, 12])
    run("c", "playground:Go1Getup:best run.seed=0", 0, [2, 11, 12])
    run("d", "playground:Go1Getup:best run.seed=1", 1, [11, 11, 11, 9])
    run("e", "playground:Go1Getup:ppo run.seed=1", 1, [1, 2])
    return table


def test_when_a_run_reaches_the_reference(playground_runs, capsys):
    """brax's highest return, 12 for both seeds; 90 % of it are 10.8, a line from 2 to 11 away: 8.8 / 9."""
    table, found = playground_runs, playground_runs.runs()
    assert table.reference(found, "Go1Getup") == 12
    assert table.first_cells(found["Go1Getup", "best"], np.nan) == ["-", "-"]
    best = found["Go1Getup", "best"]
    on_a_line = 1 + 8.8 / 9, 10 * (1 + 8.8 / 9)
    np.testing.assert_allclose([table.first(rows, 10.8) for rows in best], [on_a_line, (1, 10)])
    assert table.first_cells(best, 10.8) == ["1.5", "15"]
    assert table.first_cells(best, 12) == ["3.0, 1 never", "30"]
    assert table.first_cells(found["Go1Getup", "ppo"], 10.8) == ["never", "never"]
    assert np.isnan(table.reference({}, "Go1Getup"))
    assert table.reference({("Go1Getup", "ppo"): found["Go1Getup", "ppo"]}, "Go1Getup") == 2
    table.main()
    out = capsys.readouterr().out
    assert (
        "| Go1Getup | `best` | 2 | 10.5 | 50.0% | 3.5 | 35 | 1.5 | 15 | 3.0, 1 never | 30 |" in out
    )
    assert "- `best`: 1.0: 6.5, 50%; 2.0: 11.0, 50%; 3.0: 11.5, 50%\n" in out


def test_steps_and_seconds_to_equal_returns(playground_runs, tmp_path, capsys):
    """brax's mean is 5, 12, 11; that of `best` 6.5, 11, 11.5, a line each: of 7 from 5 to 12 they are 1.5, 6
    and 6.5. A level of the first evaluation, or one that is never reached, has no number. Our PPO, 1 and 2,
    has none of these levels; one with evaluations in other places is met between them."""
    table = playground_runs
    curve = table.mean(table.runs()["Go1Getup", "brax"])
    np.testing.assert_allclose(curve, [[1, 10, 5, 0.5], [2, 20, 12, 0.5], [3, 30, 11, 0.5]])
    np.testing.assert_allclose(table.to_return(curve, 6.5), [1 + 1.5 / 7, 10 + 15 / 7])
    assert np.isnan(table.to_return(curve, 5)).all() and np.isnan(table.to_return(curve, 13)).all()
    table.beside(table.runs())
    assert capsys.readouterr().out.splitlines()[2:5] == [
        "| Go1Getup | 6.5 | 1.0, 10 | 1.2, 12 | 1.2 | 1.2 | - |",
        "| Go1Getup | 11.0 | 2.0, 20 | 1.9, 19 | 0.9 | 0.9 | - |",
        "| Go1Getup | 11.5 | 3.0, 30 | 1.9, 19 | 0.6 | 0.6 | - |",
    ]
    # two runs, of 1 to 13 from 1 M to 3 M, and of 1 to 16 from 0.5 M to 3.5 M: both from 1 M on
    run = "job,seed,iteration,sim_steps,seconds,return,fall_rate\n"
    job, path = "playground:Go1Getup:ppo", tmp_path / "e.csv"
    path.write_text(f"{run}{job},0,1,1e6,9,1,0\n{job},0,3,3e6,9,13,0\n")
    (tmp_path / "g.csv").write_text(f"{run}{job},1,1,5e5,9,1,0\n{job},1,3,3.5e6,9,16,0\n")
    found = table.runs()
    np.testing.assert_allclose(
        table.mean(found["Go1Getup", "ppo"], between=True)[:, (0, 2)], [(1, 2.25), (3, 13.25)]
    )
    table.beside(found)
    told = [line.split(" | ")[-1] for line in capsys.readouterr().out.splitlines()[2:5]]
    expected = [1 + 2 * (level - 2.25) / 11 for level in (6.5, 11, 11.5)]
    assert told == [f"{x:.1f} |" for x in expected]
    # of two evaluations too far apart there is no line: at 3 M only the two others count
    far = 1e6 * (1 + table.LINE) + 1
    (tmp_path / "h.csv").write_text(f"{run}{job},2,1,1e6,9,2,0\n{job},2,9,{far},9,99,0\n")
    mean = table.mean(table.runs()["Go1Getup", "ppo"], between=True)[:, (0, 2)]
    np.testing.assert_allclose(mean, [(1, (2 * 2.25 + 2) / 3), (3, 13.25)])


def test_runs_that_share_a_card_have_no_seconds(playground_runs, tmp_path):
    """Two more seeds, in a file named -steps: means are of what two seeds have, seconds of runs alone."""
    head, job = "job,seed,iteration,sim_steps,seconds,return,fall_rate", "playground:Go1Getup:best"
    rows = [f"{job},{seed},{i},{i}e6,900,{5 * i},0" for seed in (8, 9) for i in (2, 3, 4)]
    (tmp_path / "f-steps.csv").write_text("\n".join([head, *rows, ""]))
    curve = playground_runs.mean(playground_runs.runs()["Go1Getup", "best"])
    expected = [[1, 10, 13 / 2], [2, 20, 42 / 4], [3, 30, 53 / 4], [4, 40, 49 / 3]]
    np.testing.assert_allclose(curve[:, :3], expected)
    # a seed that ran twice: both runs count, where another seed has an evaluation, too
    rows = [f"{job},1,{i},{i}e6,900,{x},0" for i, x in ((4, 15), (5, 99))]
    for name in ("h-steps", "i-steps"):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows, ""]))
    curve = playground_runs.mean(playground_runs.runs()["Go1Getup", "best"])
    np.testing.assert_allclose(curve[:, :3], [*expected[:3], [4, 40, 79 / 5]])


def test_braxs_runs_that_share_a_card_have_the_seconds_of_one_alone(
    playground_runs, tmp_path, capsys
):
    """A run alone takes 0.4 s a step after its first evaluation. Of the two kinds of resets that counts which
    is sooner at a return; which is higher is the reference."""
    for path in (tmp_path / "a.csv", tmp_path / "b.csv"):
        path.unlink()
    head = "job,seed,iteration,sim_steps,seconds,return,fall_rate"
    job = "brax:Go1Getup steps=9 evals=3 resets=1"

    def write(name, job, *rows):
        lines = [f"{job},0,{i},{i}e6,{took},{x},0" for i, took, x in rows]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *lines, ""]))

    write("x-brax-alone-0", job, (1, 2e5, 1), (2, 6e5, 99))
    write("x-brax-shared-0", "brax:Go1Getup", (1, 9e6, 6), (2, 9e6, 7), (8, 9e6, 12))
    write("x-brax-resets1-shared-0", job, (1, 9e6, 2), (4, 9e6, 14))
    found = playground_runs.runs()
    assert playground_runs.reference(found, "Go1Getup") == 14
    at = [playground_runs.when(row) for row in found["Go1Getup", "brax1"][0]]
    np.testing.assert_allclose(at, [(1, 4e5), (4, 16e5)])
    playground_runs.beside(found)
    told = [line.split(" | ")[1:4] for line in capsys.readouterr().out.splitlines()[2:5]]
    expected = ["1.5, 600000", "3.2, 1300000", "3.4, 1350000"]
    assert [cells[2] for cells in told] == expected
    # a return that one of the two has in its first evaluation: the other's steps say nothing
    write("x-brax-resets1-shared-0", job, (1, 9e6, 8), (4, 9e6, 14))
    playground_runs.beside(playground_runs.runs())
    told = [line.split(" | ")[1] for line in capsys.readouterr().out.splitlines()[2:] if line]
    assert told == ["11.0", "11.5"]
    # two runs alone: their mean
    write("y-brax-9", job, (1, 0, 1), (3, 4e5, 99))
    assert playground_runs.rates() == {"Go1Getup": pytest.approx(0.3)}


def test_of_braxs_runs_that_were_cut_off_what_is_better_for_brax_holds(
    playground_runs, tmp_path, capsys
):
    """Of three evaluations a run has two. With it the mean is at 6.5 sooner than the whole run, and never at
    11; its highest is under that of the whole run, or above it."""
    table = playground_runs
    (tmp_path / "a.csv").unlink()
    head, job = "job,seed,iteration,sim_steps,seconds,return,fall_rate", "brax:Go1Getup evals=3"

    def write(name, *returns):
        lines = [f"{job},0,{i},{i}e6,{10 * i},{x},0" for i, x in enumerate(returns, 1)]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *lines, ""]))

    write("b", 5, 6, 12)
    write("cut", 4, 9)
    found = table.runs()
    assert [len(rows) for rows in table.whole(found["Go1Getup", "brax"])] == [3]
    assert [len(runs) for runs in table.both_ways(found["Go1Getup", "brax"])] == [2, 1]
    assert table.reference(found, "Go1Getup") == 12  # not 10.5
    table.main()
    out = capsys.readouterr().out
    assert "| Go1Getup | brax's PPO | 2, 1 cut off | 10.5 |" in out
    told = [
        line.split(" | ")[1:4] for line in out.split("our PPO: M steps |\n")[1].splitlines()[1:4]
    ]
    # both: 4.5, 7.5; the whole one: 5, 6, 12
    assert told == [
        ["6.5", "1.0, 10", "1.7, 17"],
        ["11.0", "2.0, 20", "2.8, 28"],
        ["11.5", "3.0, 30", "2.9, 29"],
    ]
    write("cut", 4, 14)
    assert table.reference(table.runs(), "Go1Getup") == 13
    for name in ("b", "cut"):  # none is whole
        write(name, 4, 14)
    assert [len(runs) for runs in table.both_ways(table.runs()["Go1Getup", "brax"])] == [2]


def part_of(page, heading):
    """The text of a page under a heading, to the next one of its level."""
    head = f"\n## {heading}\n"
    text = (EXPERIMENTS / PLAYGROUND / page).read_text()
    assert text.count(head) == 1, heading
    return text.split(head)[1].split("\n## ")[0]


@pytest.fixture(scope="module")
def playground():
    """The table script of 05_playground, its runs, the task of a name on its pages, and its rows of equal
    returns."""
    table = script(f"{PLAYGROUND}/table")
    found, out = table.runs(), io.StringIO()
    with contextlib.redirect_stdout(out):
        table.beside(found)
    rows = [line.strip("| ").split(" | ") for line in out.getvalue().splitlines()[2:] if line]
    every = {x.split("Joy")[0].split("Flat")[0]: x for x in reversed(table.tasks(found))}
    names = {"Berkeley": "BerkeleyHumanoid"} | {
        name: f"Go1{name}" for name in ("Getup", "Handstand")
    }

    def task_of(name):
        return every[names.get(name, name)] if name != "Go1, rough" else "Go1JoystickRoughTerrain"

    return table, found, task_of, rows


def table_of(page, head):
    """Cells of each row of the table of 05_playground's `page` whose head begins with `head`."""
    text = (EXPERIMENTS / PLAYGROUND / page).read_text()
    assert text.count(head) == 1, head
    lines = text.split(head)[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]


def words_of(page):
    return " ".join((EXPERIMENTS / PLAYGROUND / page).read_text().split())


def test_equal_returns_on_playgrounds_pages_are_those_of_its_runs(playground):
    """Each row of a task; their range, and the highest returns; and what the page's head says of them."""
    table, found, task_of, rows = playground
    part = table_of("returns.md", "| task | return | `best`: M steps, s |")
    task, seen = "", set()
    for first, *row in part:
        task = task_of(first) if first else task
        assert [task, *row] in rows
        seen.add(task)
    assert len(seen) == 12 and f"{len(part)} rows at equal returns" in words_of("README.md")
    times = [float(row[4]) for row in rows]
    assert f"{max(times):.0f}, {np.median(times):.0f}" == "25, 12" and 2 < min(times) < 2.5
    words = words_of("README.md")
    assert "after a half to a twenty-fifth" in words
    assert "in the median of all evaluations a twelfth" in words
    # the range of all evaluations, and the highest return of each trainer
    part, half, below = table_of("README.md", "| task | times fewer steps |"), set(), 0
    for name, *shown in part:
        mine = [row for row in rows if row[0] == task_of(name)]
        for column, cell in zip((4, 5), shown, strict=False):
            numbers = [float(row[column]) for row in mine if row[column] != "-"]
            assert cell == f"{min(numbers):.1f} to {max(numbers):.1f}", name
        half |= {name} if min(numbers) > 2 else set()
        highest = table.reference(found, task_of(name))
        best = table.mean(found[task_of(name), "best"])[:, 2].max()
        assert [shown[2], shown[3].split(",")[0]] == [f"{highest:.1f}", f"{best:.1f}"], name
        below += best < highest
    assert len(part) == 12
    assert half == {"Go1", "Go1, rough", "Berkeley", "T1", "Apollo", "G1"}
    assert (
        "five tasks: Go1 on flat and on rough ground, Berkeley, T1, Apollo. (On G1, too," in words
    )
    assert below == 6 and "On six tasks it does not get to brax's highest return" in words
    # beside our PPO
    times = [float(row[6]) / float(row[2].split(",")[0]) for row in rows if row[6] != "-"]
    assert f"{max(times):.0f}, {min(times):.0f}, {np.median(times):.0f}" == "18, 2, 10"
    assert "2 to 18 times fewer steps, in the median 10" in words


def test_when_runs_have_braxs_highest_return_is_as_playgrounds_pages_say(playground):
    """90 % of it: each row, its seconds of `best` those of a run alone; and what the page says of all. All of
    it: the runs that get there."""
    table, found, task_of, _ = playground
    words, fewer, half = words_of("README.md"), [], set()

    def sooner(task, level):
        """The kind of brax's that is there first."""
        there = {k: [table.first(run, level)[0] for run in found[task, k]] for k in kinds(task)}
        there = {k: np.nanmean(x) for k, x in there.items() if not np.isnan(x).all()}
        return min(there, key=there.get), min(there.values())

    def kinds(task):
        return [kind for kind in table.BRAX if (task, kind) in found]

    def got(task, kind, level):
        """Of a kind: how many get there, of how many, and how many were cut off before."""
        some = found[task, kind]
        missing = [run for run in some if np.isnan(table.first(run, level)[0])]
        cut = sum(run not in table.whole(some) for run in missing)
        return f"{len(some) - len(missing)} of {len(some)}", cut

    part = table_of("README.md", "| task | 90 % are |")
    for name, level, *shown in part:
        task = task_of(name)
        share = 0.9 * table.reference(found, task)
        kind, mean = sooner(task, share)
        steps, took = table.first_cells(found[task, kind], share)
        runs, cut = got(task, kind, share)
        expected = f"{steps.split(',')[0]} ({runs}{f', {cut} cut off' if cut else ''})"
        assert [level, shown[1]] == [f"{share:.1f}", expected], name
        assert [shown[0], shown[2]] == [
            table.first_cells(found[task, kind], share)[0] for kind in ("best", "ppo")
        ]
        alone = table.average([table.first(run, share)[1] for run in found[task, "best"]])
        assert shown[3:] == [alone, took]
        if "never" not in shown[0]:
            fewer.append(
                mean / np.mean([table.first(run, share)[0] for run in found[task, "best"]])
            )
            half |= {name} if float(alone) < float(took) / 2 else set()
    assert len(part) == 12 and len(fewer) == 8 and "On eight tasks all seeds" in words
    assert f"{min(fewer):.0f} to {max(fewer):.0f} times fewer steps than brax" in words
    assert half == {"Go1", "Berkeley", "T1", "Handstand", "Go1, rough", "Apollo", "Barkour"}
    assert "on seven of these in less than half of its seconds" in words
    # its highest return
    part = table_of("returns.md", "| task | return | `best` | brax's PPO |")
    for name, level, best, brax in part:
        task = task_of(name)
        highest = table.reference(found, task)
        told = [f"{highest:.1f}"]
        for kind in ("best", sooner(task, highest)[0]):
            steps = table.first_cells(found[task, kind], highest)[0].split(",")[0]
            told.append(f"{steps} ({got(task, kind, highest)[0]})")
        assert [level, best, brax.split(", with")[0]] == told, name
    above = {
        task
        for task in table.tasks(found)
        if got(task, "best", table.reference(found, task))[0] != "0 of 4"
    }
    assert above == {task_of(name) for name, *_ in part} and len(above) == 6


def test_all_returns_on_playgrounds_page_are_those_of_its_runs(playground):
    """Each "M steps: return, falls", of the mean of a kind, or of one run where the text says so."""
    table, found, task_of, _ = playground
    kinds = {"brax": "brax", "one": "brax1", "twice": "brax10", "ppo": "ppo", "best": "best"}
    task, seen = "", 0
    entry = re.compile(r"([\d.]+)(?: (?:to|and) ([\d.]+))?: (-?[\d.]+)(?:, (no falls|\d+ %))?")
    for first, trainer, told, _ in table_of("returns.md", "| task | trainer | M steps: return, "):
        task = task_of(first) if first else task
        kind = kinds[trainer.split("`")[1]]
        some = found[task, kind]
        if kind in table.BRAX:
            seeds = re.search(r"\((\d) seeds", trainer)
            assert len({run[0]["seed"] for run in some}) == (int(seeds[1]) if seeds else 1)
        mean, each = table.mean(some, kind in table.BRAX), [table.mean([run]) for run in some]
        alone = False  # from here on one run's
        for text in re.sub(r"\([^)]*\)", "", told).split("; "):
            alone = alone or "alone" in text or "one seed" in text
            start, to, back, falls = entry.search(text).groups()
            for at in [start, to] if to else [start]:
                digits = len(at.partition(".")[2])
                shown = [
                    (f"{m:.{digits}f}", f"{r:.1f}", f"{f:.0%}".replace("%", " %"))
                    for curve in (each if alone else [mean])
                    for m, _, r, f in curve
                ]
                falls = "0 %" if falls == "no falls" else falls
                assert any(x[:2] == (at, back) and falls in (None, x[2]) for x in shown), (
                    task,
                    text,
                )
                seen += 1
    assert seen > 200


def test_what_a_range_for_predicted_states_does_is_as_playgrounds_page_says():
    """By how much computed and predicted rewards are worse than the real ones; and returns in the end."""
    worst, end, last = {}, {}, {}
    path = EXPERIMENTS / PLAYGROUND / "results" / "tuning.csv.xz"
    with lzma.open(path, "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] in ("stall", "bound") and row["name"].startswith("apollo"):
                name = row["name"].removeprefix("apollo-")
                at = f"{float(row['sim_steps']) / 1e6:.1f}"
                worst[name] = min(worst.get(name, 0), float(row["tail_bias"]))
                last.setdefault((name, at), []).append(float(row["return"]))
                end[name, row["seed"]] = row["return"]
    words = " ".join(part_of("parts.md", "Predicted states kept in a range").split())
    wide, narrow, base = (-worst[x] for x in ("known-bound20", "known-bound5", "base"))
    assert f"by {wide:.1f} a second at most then (within 5: {narrow:.1f})" in words
    assert f"by {-worst['known']:,.0f} without a range, and a predicted one by {base:.1f}" in words
    within = [last[f"known-bound{x}", "2.9"] for x in (5, 20)]
    assert "after 2.9 M steps all four of these seeds are below" in words
    assert max(map(max, within)) < min(last["base", "2.9"])
    ends = {name: [f"{float(end[name, x]):.1f}" for x in ("100", "101")] for name, _ in end}
    least, most = sorted(ends["known-bound5"], key=float)
    both = " and ".join(ends["known-bound20"])
    assert f"{least} to {most} within 5, {both} within 20" in words


def test_what_braxs_resets_do_is_as_playgrounds_page_says(playground):
    """Of its runs with one reset: mean, least and most after so many M steps; with Playground's on a line."""
    table, found, task_of, _ = playground
    words = words_of("baseline.md")

    def at(name, kind, steps):
        """`(mean, least, most)` of the runs of a kind that got so far."""
        curves = [table.mean([run]) for run in found[task_of(name), kind]]
        exact = [m for x in curves for m in x[:, 0] if abs(m - steps) < 0.05] or [steps]
        each = [np.interp(exact[0], x[:, 0], x[:, 2]) for x in curves if x[-1, 0] >= exact[0]]
        return f"{np.mean(each):.1f}", f"{min(each):.1f}", f"{max(each):.1f}"

    for text, name, kind, steps in (
        ("{0} after 41 M ({1} to {2}) instead of 28", "Spot", "brax1", 40.6),
        ("{0} after 61 M ({1} to {2}) instead of 53", "H1", "brax1", 60.9),
        ("Op3 at {0} after 41 M ({1} to {2}) instead of 22", "Op3", "brax1", 40.6),
        ("{0} after 51 M ({1} to {2}, four runs of three seeds)", "Berkeley", "brax1", 50.8),
        ("{0} after 41 M ({1} and {2}), where", "Go1, rough", "brax1", 40.6),
        ("{0} after 42 M ({1} to {2})", "Go1, rough", "brax", 41.9),
        ("G1 is at {0} with one ({1} to {2})", "G1", "brax1", 50.8),
        ("Playground's has {0} on a line", "G1", "brax", 50.8),
        ("T1 is at {0} after 61 M ({1} to {2}) where", "T1", "brax1", 60.9),
        ("where it has {0}. On Barkour", "T1", "brax", 60.9),
        ("instead of {0}. One of these", "Berkeley", "brax", 50.8),
        ("Spot is at {0} after 10 M", "Spot", "brax1", 10.2),
    ):
        assert text.format(*at(name, kind, steps)) in words.replace("steps ", ""), (name, kind)
    rises = [
        sorted(x for run in found["Go1Getup", kind] if np.isfinite(x := table.first(run, 16)[0]))
        for kind in ("brax10", "brax")
    ]
    told = (
        "two seeds are at 16 after {:.0f} and {:.0f} M steps, one with Playground's after {:.0f} M."
    )
    assert told.format(*rises[0], *rises[1]) in words


def test_our_ppo_beside_braxs_is_as_playgrounds_page_says(playground):
    """Its steps at equal returns, as a share of brax's."""
    _, _, task_of, rows = playground

    def shares(*names):
        tasks = [task_of(name) for name in names]
        mine = [
            (float(row[6]), float(row[3].split(",")[0]))
            for row in rows
            if row[0] in tasks and row[6] != "-"
        ]
        return [ours / brax for ours, brax in mine]

    words = words_of("baseline.md")
    for told, names in (
        (
            "as many steps on Go1 and Handstand ({:.1f} to {:.1f} times brax's)",
            ("Go1", "Handstand"),
        ),
        ("{:.1f} to {:.1f} times as many on Getup,", ("Getup",)),
        ("and {:.1f} to {:.1f} times on H1.", ("H1",)),
    ):
        assert told.format(min(shares(*names)), max(shares(*names))) in words
    spot = shares("Spot")
    assert f"{max(spot):.1f} to {min(spot):.1f} times on Spot" in words
    fewer = shares("G1", "Berkeley", "T1", "Go1, rough", "Apollo", "Barkour", "Op3")
    told = "on G1, Berkeley, T1, Go1's rough ground, Apollo, Barkour and Op3;"
    assert f"{100 - 100 * max(fewer):.0f} to {100 - 100 * min(fewer):.0f} % fewer {told}" in words
    every = [float(row[6]) / float(row[3].split(",")[0]) for row in rows if row[6] != "-"]
    assert f"which needs {min(every):.1f} to {max(every):.1f} times brax's steps" in words_of(
        "README.md"
    )
    some = shares("G1", "Op3")
    assert f"about on G1 and Op3 ({min(some):.1f} to {max(some):.1f} times the steps;" in words


def test_what_our_ppo_has_in_the_end_is_as_playgrounds_page_says(playground):
    """The run of ours with more than 40 M steps of each task, the last of its seed, beside brax's PPO."""
    table, found, task_of, _ = playground
    part = table_of("baseline.md", "| task | our PPO: return |")
    for name, *shown in part:
        task, seed = task_of(name), "0" if name == "G1" else "2"
        runs = [run for run in found[task, "ppo"] if run[0]["seed"] == seed]
        row = max((run[-1] for run in runs), key=table.when)
        level = float(row["return"])
        kinds = [found[task, kind] for kind in table.BRAX if (task, kind) in found]
        theirs = [table.mean(some, True) for runs in kinds for some in table.both_ways(runs)]
        needs = [x for curve in theirs if np.isfinite(x := table.to_return(curve, level)[0])]
        at_most = max(table.when(runs[-1])[0] for runs in found[task, "brax1"]) if not needs else 0
        needs = f"{min(needs):.0f}" if needs else f"not by {at_most:.0f}"
        highest = f"{needs} ({table.reference(found, task):.1f})"
        assert shown == [f"{level:.1f}", f"{table.when(row)[0]:.0f}", highest], name
    long = {
        task
        for task in table.tasks(found)
        if max(table.when(run[-1])[0] for run in found[task, "ppo"]) > 40
    }
    assert {task_of(name) for name, *_ in part} == long
    ends = {name: back for name, back, *_ in part}
    above = (
        "above the highest of `best` on Spot ({}), Barkour ({}) and H1 ({}), after 69 to 79 M, and "
        "on Handstand ({}), after 49."
    )
    names = "Spot", "Barkour", "H1", "Handstand"
    assert above.format(*(ends[name] for name in names)) in words_of("README.md")
    for name in ends:
        best = table.mean(found[task_of(name), "best"])[:, 2].max()
        assert (float(ends[name]) > best) == (name in names or name == "G1"), name


def test_runs_that_were_cut_off_and_seeds_that_ran_twice_are_counted(playground):
    """Of brax's, beside the three that no job says it of; and the tasks on which a seed ran twice."""
    table, found, task_of, _ = playground
    theirs = {key: runs for key, runs in found.items() if key[1] in table.BRAX}
    assert sum(len(runs) - len(table.whole(runs)) for runs in theirs.values()) == 18 - 3
    words = words_of("README.md")
    assert "Eighteen runs were cut off: the three above, and fifteen of those" in words
    twice = {
        task
        for (task, _), runs in theirs.items()
        if len({run[0]["seed"] for run in runs}) < len(runs)
    }
    assert twice == {*map(task_of, ("Berkeley", "G1", "Getup", "Apollo", "Op3"))}
    assert "On five tasks a seed ran twice" in words
    assert "ran twice on Berkeley, G1, Getup, Apollo and Op3" in words_of("returns.md")
    ours = {task: [run[0]["seed"] for run in found[task, "best"]] for task in table.tasks(found)}
    assert all(len({*seeds}) == 4 for seeds in ours.values())
    assert [task for task, seeds in ours.items() if len(seeds) > 4] == [
        *map(task_of, ("T1", "Op3"))
    ]
    assert "four; on T1 and Op3 one of them ran twice" in words
    assert all(len({run[0]["seed"] for run in found[task, "ppo"]}) == 3 for task in ours)


@pytest.mark.parametrize(
    ("batch", "tasks", "parts"),
    [
        (
            "one-thing",
            "",
            [
                ("stalls.md", "Where the tail harmed: Spot"),
                ("parts.md", "Rewards computed in a tail"),
            ],
        ),
        (
            "stall",
            ("op3", "h1", "barkour"),
            [("stalls.md", "Op3 and H1: why they stall")],
        ),
        ("stall bound", "apollo", [("parts.md", "Predicted states kept in a range")]),
    ],
    ids=["Spot and known rewards", "Op3 and H1", "a range"],
)
def test_playgrounds_runs_of_one_thing_at_a_time_are_those_of_the_pages(batch, tasks, parts):
    """Each line with two seeds' returns is that of a run, at the steps of its head."""
    folder, runs = EXPERIMENTS / PLAYGROUND, {}
    with lzma.open(folder / "results" / "tuning.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            mine = row["batch"] in batch.split() and row["name"].startswith(tasks)
            if mine and row["seed"] in ("100", "101") and "until400" not in row["name"]:
                at = f"{float(row['sim_steps']) / 1e6:.1f} M"
                seen = float(row["return"]), float(row["fall_rate"])
                runs.setdefault(row["name"], {}).setdefault(at, []).append(seen)

    def agrees(run, mine):
        for at, cell in mine.items():
            returns = ", ".join(f"{x:.1f}" for x, _ in run.get(at, []))
            falls = 100 * np.mean([falls for _, falls in run.get(at, [(0, 0)])])
            if cell not in (returns, f"{returns} ({falls:.0f} %)"):
                return False
        return True

    checked, head = [], []
    page = "\n".join(part_of(*part) for part in parts)
    for text in page.splitlines():
        line = [cell.strip() for cell in text.replace("**", "")[1:-1].split("|")]
        if line[-1] == "6.0 M" and line[-2] in ("3.5 M", "4.8 M"):
            head = line
        elif text[:1] != "|":
            head = []
        elif head and "---" not in text:
            mine = {at: cell for at, cell in zip(head, line, strict=True) if at.endswith(" M")}
            mine = {at: cell for at, cell in mine.items() if cell not in ("", "cut off")}
            of = [name for name, run in runs.items() if agrees(run, mine)]
            assert len(of) == 1, line
            checked += of
    assert {*checked} == {*runs} and len(checked) == len(runs)


def test_what_a_range_does_on_h1_and_berkeley_is_as_playgrounds_page_says():
    """Each cell of both seeds, and by how much computed rewards are worse than the real ones."""
    runs = {}
    path = EXPERIMENTS / PLAYGROUND / "results" / "tuning.csv.xz"
    with lzma.open(path, "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] in ("one-thing", "stall", "bound-2") and row["name"] != "apollo-known":
                at = f"{float(row['sim_steps']) / 1e6:.1f} M"
                seen = [float(row[x]) for x in ("return", "fall_rate", "tail_bias")]
                runs.setdefault(row["name"], {}).setdefault(at, []).append(seen)
    part = part_of("parts.md", "Predicted states kept in a range")
    head, _, *lines = part.split("| | 1.7 M")[1].split("\n\n")[0].splitlines()
    heads, checked, worst = ["1.7 M", *(x.strip() for x in head.split("|")[1:-1])], set(), {}
    for line in lines:
        name, *cells = (cell.strip() for cell in line.split("|")[1:-1])
        task, _, kind = name.partition(", ")
        known = (
            f"{task.lower()}-known{kind.replace('within ', '-bound') if 'within' in kind else ''}"
        )
        for at, cell in zip(heads, cells, strict=True):
            found = runs[known].get(at)
            if found is None:
                assert cell == ""
                continue
            falls = 100 * np.mean([x[1] for x in found])
            assert cell == ", ".join(f"{x[0]:.1f}" for x in found) + f" ({falls:.0f} %)", (name, at)
        checked.add(known)
        worst[known] = -min(x[2] for found in runs[known].values() for x in found)
    assert checked == {
        *("h1-known", "h1-known-bound5", "h1-known-bound20"),
        *("berkeley-known", "berkeley-known-bound5"),
    }
    assert {f"{worst[f'h1-known{x}']:.1f}" for x in ("", "-bound5")} == {"0.8"}
    late = [x[2] for name in checked if "h1" in name for x in runs[name]["2.9 M"]]
    assert {f"{-x:.1f}" for x in late} == {"0.1"} and worst["berkeley-known"] <= 0
    words = " ".join(part.split())
    assert (
        "worse than real ones by 0.8 a second at most on H1 (1.5 M steps; within 5 the same), by 0.1"
        in words
    )


def test_what_handstand_and_go1_had_again_is_on_playgrounds_pages():
    """Four seeds a cell; and Go1 after 2.5 M steps, in words."""
    folder, runs = EXPERIMENTS / PLAYGROUND, {}
    with lzma.open(folder / "results" / "tuning.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] == "again" or row["name"].startswith("hand-whole"):
                at = runs.setdefault((row["name"], f"{float(row['sim_steps']) / 1e6:.1f} M"), [])
                at.append(f"{float(row['return']):.1f}")
    part = part_of("stalls.md", "The control that Handstand adds up").split("\n\n")
    head, _, *lines = next(x for x in part if x.startswith("| | 1.9 M")).splitlines()
    heads = [cell.strip() for cell in head.split("|")[2:-1]]
    names = "again-old", "again-base", "again-known", "whole-base", "whole-known"
    for name, line in zip(names, lines, strict=True):
        cells = [cell.strip() for cell in line.split("|")[2:-1]]
        assert cells == [", ".join(runs[f"hand-{name}", at]) for at in heads]
    told = " ".join(part_of("parts.md", "Rewards computed in a tail").split())
    for name in ("base", "old"):
        assert f"({', '.join(runs[f'go1-again-{name}', '2.5 M'])})" in told
    known = sorted(runs["go1-again-known", "2.5 M"])
    assert f"({known[0]} to {known[-1]})" in told


def test_the_curves_of_playgrounds_tasks_are_drawn(playground_runs, drawn, monkeypatch):
    plot = script(f"{PLAYGROUND}/plot")
    monkeypatch.setattr(plot, "table", playground_runs)
    plot.main()
    assert drawn == ["curves"]


def test_playgrounds_jobs_are_valid_and_evaluated_ten_or_twenty_times():
    """Each in episodes as long as the task's; the name says what it is. No seed of `best` is another's, or
    one of tuning (0, 100, 101)."""
    pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")
    evaluations = script("21_less/run").evaluations
    lines = (EXPERIMENTS / PLAYGROUND / "jobs.txt").read_text().splitlines()
    assert len({line.split()[0] for line in lines}) == len(lines) == 72
    seeds = {"best-alone": [10], "best-steps": [11, 12, 13], "ppo-shared": [0, 1]}
    seeds |= {f"ppo-{k}": [k] for k in range(3)}
    for line in lines:
        name, job, *fields = line.split()
        config = config_lib.load(job)
        _, task, variant = job.split(":")
        for field in fields:
            config_lib.override(config, *field.split("=", 1))
        config = config_lib.validate(config)
        run = config.run
        assert name.startswith(f"{task}-{variant}-")
        assert [run.seed + k for k in range(run.num_seeds)] == seeds[name.split("-", 1)[1]]
        assert len(evaluations(config)) in (8, 10, 11, 20)
        assert config.run.eval_steps == config.task.episode_length


def test_a_seed_that_blew_up_is_told_with_its_first_iteration():
    """Not a loss in an iteration without a fit, nor returns before the first episode ends."""
    bad, nan = script("21_less/run").blown_up, np.nan
    losses = np.array([[1, 1, nan], [2, nan, nan], [nan, nan, nan]])  # iterations, seeds
    told = {"iteration": np.array([7, 8, 9]), "model_epochs": np.array([1, 1, 0])}
    returns = {"episode_return": np.full((3, 3), nan)}
    assert bad(told | returns | {"model_loss": losses}, 3) == {
        1: "seed 1: model_loss is not finite in iteration 8\n",
        2: "seed 2: model_loss is not finite in iteration 7\n",
    }
    assert bad(told | {"value_loss": np.array([1, nan, nan])}, 1) == {
        0: "seed 0: value_loss is not finite in iteration 8\n"
    }
    assert bad(told | {"value_loss": np.ones((3, 3))}, 3) == {}


def test_learning_rates_beside_ppo16s_are_geometric_means_with_welchs_p():
    """Two variants of three and four seeds, constant in each window but for NaN; and the page's numbers."""
    plot, rng = script("15_curves/plot"), np.random.default_rng(0)
    scipy_stats = pytest.importorskip("scipy.stats")
    count = np.arange(1.0, 501)[:, None]
    rates = {"ppo16": rng.uniform(1, 2, 3), "dyna4": rng.uniform(2, 4, 4)}
    runs = {"fast": None}
    for name, each in rates.items():
        late = np.where(count > 100, 10.0, 1.0) * each
        late[5] = np.nan
        columns = {"iteration": np.broadcast_to(count, late.shape), "learning_rate": late}
        runs[name] = types.SimpleNamespace(columns=columns)
    rows = plot.beside("go1", runs)
    assert [(row["variant"], row["window"]) for row in rows] == [
        ("dyna4", x) for x in ("early", "end")
    ]
    logs = [np.log(rates[name]) for name in ("dyna4", "ppo16")]
    for row in rows:
        assert row["share"] == pytest.approx(np.exp(logs[0].mean() - logs[1].mean()))
        assert row["p"] == pytest.approx(scipy_stats.ttest_ind(*logs, equal_var=False).pvalue)
        assert row["share_low"] < row["share"] < row["share_high"]
    assert plot.beside("go1", {"dyna4": runs["dyna4"]}) == []
    with (EXPERIMENTS / "15_curves/rates.csv").open(newline="") as file:
        told = [*csv.DictReader(file)]
    page = " ".join((EXPERIMENTS / "15_curves/README.md").read_text().split())
    for window, words in (
        ("early", "over the first 100 iterations {} to {} times PPO-16's (Holm 1 on"),
        (
            "end",
            "{} to {} times PPO-16's over the last 40 iterations, no difference shown (Holm 1;",
        ),
    ):
        tails = [row for row in told if row["window"] == window and "dyna" in row["variant"]]
        assert len(tails) == 12 and {row["p_holm"] for row in tails} == {"1"}
        shares = [float(row["share"]) for row in tails]
        assert words.format(f"{min(shares):.2f}", f"{max(shares):.2f}") in page
    early = {r["robot"]: r for r in told if (r["variant"], r["window"]) == ("ppo12", "early")}
    shares, holm = ({n: float(r[x]) for n, r in early.items()} for x in ("share", "p_holm"))
    words = "is lower on the ANYmals: {anymal_c:.2f} and {anymal_d:.2f} times (Holm "
    assert words.format(**shares) + "{anymal_c:.3f} and {anymal_d:.4f})".format(**holm) in page
    words = "{go1:.2f} and {go2:.2f} on Go1 and Go2 (Holm "
    assert words.format(**shares) + "{go1:.0f} and {go2:.2f})".format(**holm) in page


@pytest.mark.parametrize(
    "path", ["21_less/ppo_grid.txt", "21_less/ppo_others.txt", "23_untuned/ppo.txt"]
)
def test_jobs_that_tune_ppo_are_valid_plain_ppo_of_their_names(path, monkeypatch):
    """No model writes a row; robots and KL are those of the name; seeds are not the fresh ones."""
    monkeypatch.chdir((EXPERIMENTS / path).parent)
    names = set()
    for line in (EXPERIMENTS / path).read_text().splitlines():
        name, job, *fields = line.split()
        robot, _, variant = job.partition(":")
        config = config_lib.load(f"configs/{robot}.py:{variant}")
        for field in fields:
            config_lib.override(config, *field.split("=", 1))
        config = config_lib.validate(config)
        assert not schedule.uses_model(config) and config.run.seed == 0
        assert f"-{config.rollout.num_envs}-" in f"{name}-" and name not in names
        if "-kl" in name:
            assert f"kl{round(100 * config.ppo.desired_kl)}" in name
        assert len(schedule.sim_steps(config)) % config.run.eval_every == 0
        names.add(name)
    assert len(names) >= 8


def test_the_table_of_ppos_grid_is_that_of_its_runs():
    """Every setting of ppo_grid.txt is a cell of each robot; the best of each ran on fresh seeds."""
    choose, (table, _) = script("21_less/choose"), less("ppo")
    jobs = table.read(LESS / "results/ppo.csv.xz", "5")
    part = (LESS / "ppo.md").read_text().split("## The grid\n")[1].split("\n## ")[0]
    rows = [cells(line) for line in part.splitlines() if line.startswith("| ")]
    assert rows[0] == ["PPO", *LETTERS]
    names = (
        "64-kl3 128-kl2 128-kl3 128-kl3-gamma98 128-kl4 128-kl5 256-kl3 256-kl3-gamma98 256-kl3-lam95 "
        "256-kl3-ep10 256-kl3-mb8 256-kl4 512-kl3 512-kl5"
    ).split()
    asked = {line.split()[0] for line in (LESS / "ppo_grid.txt").read_text().splitlines()}
    assert {f"grid-{name}-{x}" for name in names for x in "ghcd"} == asked == jobs.keys()
    best = {x: min(names, key=lambda n, x=x: choose.cost(jobs[f"grid-{n}-{x}"])) for x in "ghcd"}
    level = {}
    for name, row in zip(names, rows[1:], strict=True):
        robots, kl = name.split("-")[:2]
        assert row[0].startswith("the same") or row[0] == f"{robots} robots, KL 0.0{kl[2:]}"
        for letter, cell in zip("ghcd", row[1:], strict=True):
            job = jobs[f"grid-{name}-{letter}"]
            found = table.reached(table.seeds(job), table.walks.level(table.best(job)))
            steps = f"{choose.cost(job) / 1e6:.2f}"
            assert cell == f"{steps}; {table.steps_of(found.level)}", (name, letter)
            bold = f"**{steps}**; {table.steps_of(found.level)}"
            assert (bold in part) == (best[letter] == name)
            level.setdefault(letter, {})[name] = choose.cost(job, "level") / 1e6
    _, head = less("headline")
    for letter, name in best.items():  # what ran on fresh seeds is what was chosen
        same = {
            "rollout.num_envs",
            "ppo.gamma",
            "ppo.lambda_",
            "ppo.desired_kl",
            "schedule.late_from",
        }
        fields = [
            {f for f in job[0]["job"].split() if f.split("=")[0] in same}
            for job in (jobs[f"grid-{name}-{letter}"], head[f"ppo-walk-{letter}"])
        ]
        assert fields[0] == fields[1] and len(fields[0]) == 5
        soon = min(level[letter], key=level[letter].__getitem__)
        fields = [
            {f for f in job[0]["job"].split() if f.split("=")[0] in same}
            for job in (jobs[f"grid-{soon}-{letter}"], head[f"ppo-level-{letter}"])
        ]
        assert fields[0] == fields[1]
    words = " ".join(part.split())
    soonest = [min(some.values()) for some in level.values()]
    text = "need {:.2f} (128 robots, KL 0.04), {:.2f} (KL 0.03), {:.2f} and {:.2f} (KL 0.05)"
    assert text.format(*soonest) in words
    fresh = [ours_of(f"ppo-level-{x}") for x in "ghcd"]
    text = "need {:.2f}, {:.2f}, {:.2f} and {:.2f} M"
    means = [x.level.mean() / 1e6 for x in fresh]
    assert f"seeds (1300 to 1309) {text.format(*means)}. So" in words
    assert text.replace("need", "needs").format(*means) in " ".join(
        (LESS / "README.md").read_text().split()
    )
    gained = [
        stats.difference(ours_of(f"ppo-{x}").level / 1e6, one.level / 1e6)
        for x, one in zip("ghcd", fresh, strict=True)
    ]
    assert "on a Go1 the grid gained {:.2f} M ({:.2f} to {:.2f})".format(*gained[0]) in words
    assert all(one.low < 0 for one in gained[1:])
    text = "after {:.2f} (one never), {:.2f}, {:.2f} (one never) and {:.2f} M (five never)"
    assert text.format(*(np.nanmean(x.walks) / 1e6 for x in fresh)) in words
    assert [int(np.isnan(x.walks).sum()) for x in fresh] == [1, 0, 1, 5]
    sooner = stats.difference(ours_of("ppo-walk-h").walks / 1e6, fresh[1].walks / 1e6)
    assert "by {:.2f} M ({:.2f} to {:.2f}, uncorrected)".format(*sooner) in words
    ours = [ours_of(f"ppo-walk-{x}") for x in "ghcd"]
    text = "after {:.2f} M (one of ten never), {:.2f}, {:.2f} (two never) and {:.2f} (one never)"
    assert text.format(*(np.nanmean(x.walks) / 1e6 for x in ours)) in words
    assert [int(np.isnan(x.walks).sum()) for x in ours] == [1, 0, 2, 1]
    text = "{:.2f}, {:.2f}, {:.2f} and {:.2f}"
    first = [
        text.format(*(ours_of(f"{n}-{x}").level.mean() / 1e6 for x in "ghcd"))
        for n in ("ppo-walk", "ppo")
    ]
    assert f"{first[0]} M, of the older PPO {first[1]}" in words
    with lzma.open(LESS / "results/ppo.csv.xz", "rt", newline="") as file:
        runs = {
            (r["batch"], r["name"], r["seed"])
            for r in csv.DictReader(file)
            if r["name"][0] not in "qw"
        }
    counts = [sum(batch in some for batch, *_ in runs) for some in ("123", "4", "5")]
    assert counts == [205, 120, 168] and "21 in 205 runs on two" in " ".join(
        (LESS / "ppo.md").read_text().split()
    )
    assert (
        "47 settings in 493 runs" in " ".join((LESS / "README.md").read_text().split())
        and sum(counts) == 493
    )


def test_the_table_of_ppo_on_hardware_and_the_exact_task_is_that_of_its_runs():
    """Every job of ppo_others.txt to its end; beside `best` of the exact task, and today's `deploy`."""
    choose, (table, jobs) = script("21_less/choose"), less("ppo")
    asked = paper.jobs(LESS / "ppo_others.txt")
    robot_of = {letter: robot for robot, letter in LETTERS.items()}
    part = (LESS / "ppo.md").read_text().split("## Hardware and the exact task\n")[1]
    shown = [
        cells(line) for line in part.splitlines() if line.startswith(("| exact", "| `deploy`"))
    ]
    assert len(shown) == len(asked) == 10
    for name, line in asked.items():
        job, (task, robots, letter) = jobs[name], name.split("-")
        assert job[0]["job"] == line and {row["batch"] for row in job} == {
            "7" if letter == "c" else "6"
        }
        assert job[-1]["iteration"] == float(re.search(r"num_iterations=(\d+)", line)[1])
        row = cells(table.table({name: job}, table.best(job)).splitlines()[-1])
        label = f"{task if task == 'exact' else '`deploy`'}, {robot_of[letter]}, {robots} robots"
        assert [label, *row[5:8], row[3], row[2], *row[9:11]] in shown, name
    words = " ".join(part.split())
    # the exact task
    costs = script(f"{ROW_COST}/table")
    mine = {
        one.place: one
        for one in costs.runs()
        if one[1:3] == ("H200, 2026-11-28", "best") and one.place.endswith("exact")
    }
    go1, anymal = mine["go1.exact"], mine["anymal_c.exact"]
    more = []
    for best, name, level in ((go1, "exact-256-g", 38), (anymal, "exact-256-c", 24)):
        more.append(stats.ratio(reached_of(jobs[name], level), best.level[:, 1]))
        assert choose.cost(jobs[name], "level") < choose.cost(
            jobs[name.replace("256", "512")], "level"
        )
    text = "{:.1f} times the steps of `best` on a Go1 ({:.1f} to {:.1f}) and {:.1f} times on an ANYmal-C"
    assert f"{text} ({{:.1f}} to {{:.1f}})".format(*more[0], *more[1]) in words
    steps = [one.level[:, 1].mean() / 1e6 for one in (go1, anymal)]
    assert "which need {:.2f} and {:.2f} M".format(*steps) in words
    other = " ".join((EXPERIMENTS / ROW_COST / "README.md").read_text().split())
    text = (
        "three tuning seeds, {:.1f} ({:.1f} to {:.1f}) and {:.1f} times ({:.1f} to {:.1f}) those of"
    )
    assert text.format(*more[0], *more[1]) in other
    fewest = [reached_of(jobs[f"exact-256-{x}"], y).mean() / 1e6 for x, y in (("g", 38), ("c", 24))]
    assert "it needs [{:.2f} and {:.2f} M".format(*fewest) in other
    for letter, robots in (("g", "256"), ("c", "512")):  # that the rule takes
        cost = {n: choose.cost(jobs[f"exact-{n}-{letter}"]) for n in ("256", "512")}
        assert min(cost, key=cost.get) == robots
    walked = table.reached(table.seeds(jobs["exact-512-c"]), 24).walks
    text = "after {:.1f} times the steps of `best` ({:.1f} to {:.1f})"
    assert text.format(*stats.ratio(walked, anymal.walks[:, 1])) in words
    assert np.isfinite(go1.walks[:, 1]).sum() == 2 and f"{go1.end / 1e6:.1f}" == "2.7"
    # hardware
    today = table.read(DEPLOY / "deploy.csv.xz", "4")
    again = table.read(DEPLOY / "tuning.csv.xz", "solver")["solver10-c"]
    then = table.read(DEPLOY / "deploy.csv.xz", "1")

    def on_a_line(job, level):
        found = []
        for rows in table.seeds(job):
            steps, returns = (
                [row[name] / scale for row in rows]
                for name, scale in (("sim_steps", 1e6), ("return", 1))
            )
            k = next(i for i, value in enumerate(returns) if value >= level)
            found.append(np.interp(level, returns[k - 1 : k + 1], steps[k - 1 : k + 1]))
        return np.mean(found)

    go1, anymal = today["go1-bundled"], today["anymal_c-bundled"]
    ends = sorted({row["sim_steps"] / 1e6 for row in anymal})
    assert "after {:.1f}, {:.1f}, {:.1f} and {:.1f} M steps".format(*ends[:4]) in words
    for job, level in ((go1, 30), (anymal, 15)):  # all between the first two evaluations
        assert {*(reached_of(job, level) / 1e6)} == {ends[1]}
    early = on_a_line(go1, 30), on_a_line(anymal, 15)
    assert "after {:.1f} and {:.1f}, and that line".format(*early) in words
    firsts, gaps = {}, {}
    for name in asked:
        top = 30 if name.endswith("g") else 15
        firsts[name] = reached_of(jobs[name], top) / 1e6
    for name in [name for name in asked if name.startswith("deploy")]:
        job = go1 if name[-1] == "g" else anymal
        for at in ends[:2]:
            mine, its = (table.between(one, at * 1e6, "return") for one in (job, jobs[name]))
            difference = stats.difference(mine, its), stats.welch_of(mine, its)
            gaps[name, at] = (mine.mean(), its.mean(), *difference)
    near = {x: [gaps[f"deploy-{n}-{x}", ends[0]] for n in (256, 512, 1024)] for x in "gc"}
    most = {x: max(some, key=lambda one: one[1]) for x, some in near.items()}
    assert all(one is near[x][0] for x, one in most.items())  # with 256 robots
    text = "a Go1 of `deploy` returns {:.1f}, PPO at most {:.1f} with any of the three numbers of robots"
    text += " ({:.1f} less, {:.1f} to {:.1f})"
    assert text.format(*most["g"][:2], *most["g"][2]) in words
    text = "an ANYmal-C {:.1f} and at most {:.1f} ({:.1f} less, {:.1f} to {:.1f}, p {:.3f}, uncorrected)"
    assert text.format(*most["c"][:2], *most["c"][2], most["c"][3]) in words
    assert all(one[2].low > 0 for some in near.values() for one in some)
    soonest = {
        x: min((256, 512, 1024), key=lambda n, x=x: np.nanmean(firsts[f"deploy-{n}-{x}"]))
        for x in "gc"
    }
    assert {*soonest.values()} == {256}
    ppo = [np.nanmean(firsts[f"deploy-256-{x}"]) for x in "gc"]
    assert [np.isfinite(firsts[f"deploy-256-{x}"]).sum() for x in "gc"] == [2, 2]
    assert "first there after {:.1f} and {:.1f} (two of three seeds".format(*ppo) in words
    later = [gaps[f"deploy-256-{x}", ends[1]][2] for x in "gc"]
    text = "returns {:.1f} and {:.1f} more than it, with 0 in both intervals"
    assert text.format(*(x.value for x in later)) in words and all(
        x.low < 0 < x.high for x in later
    )
    twenty = reached_of(anymal, 20) / 1e6
    text = "is at 20 after {:.1f} M steps (first to last seed {:.1f} to {:.1f}, of evaluations 8 M apart;"
    text += " {:.1f} by that line)"
    assert text.format(twenty.mean(), twenty.min(), twenty.max(), on_a_line(anymal, 20)) in words
    its = np.concatenate([reached_of(jobs[f"deploy-{n}-c"], 20) for n in (256, 512, 1024)]) / 1e6
    assert [np.isfinite(its[k : k + 3]).sum() for k in (0, 3, 6)] == [0, 1, 2]
    text = f"1024, after {np.nanmin(its):.1f} to {np.nanmax(its):.1f}; the other six do not"
    assert f"three of nine runs, one with 512 robots and two with {text}" in words
    gaps = {}
    for name in [name for name in asked if name.startswith("deploy")]:
        end = jobs[name][-1]["sim_steps"]
        pair = [
            table.between(job, end, "return")
            for job in (jobs[name], go1 if name[-1] == "g" else anymal)
        ]
        gaps[name] = (end / 1e6, *(x.mean() for x in pair), *stats.difference(*pair))
        assert name.endswith("c") or gaps[name][-2] < 0 < gaps[name][-1]
    text = "after {:.1f} M {:.1f}, `deploy` {:.1f} by that line, {:.2f} less ({:.2f} to {:.2f}, uncorrected)"
    assert text.format(*gaps["deploy-1024-c"]) in words
    at, its, mine, _, low, high = gaps["deploy-512-c"]
    assert f"no difference is shown, after {at:.1f} M {its:.1f} and {mine:.1f};" in words
    assert low < 0 < high
    at, its, *_ = gaps["deploy-256-c"]
    assert f"with 256 it ends lower in the mean, after {at:.1f} M at {its:.1f}." in words
    text = "is at 35 after {:.1f} M ({:.1f} by that line), PPO with 256 robots in two runs of three after"
    text += " {:.1f};"
    its = reached_of(jobs["deploy-256-g"], 35) / 1e6
    numbers = (reached_of(go1, 35) / 1e6).mean(), on_a_line(go1, 35), np.nanmean(its)
    assert text.format(*numbers) in words and np.isnan(its).sum() == 1
    text = "are at 15 after {:.1f} M and at 20 after {:.1f}, by that line"
    assert text.format(on_a_line(again, 15), on_a_line(again, 20)) in words
    old = reached_of(then["go1"], 30).mean() / 1e6, reached_of(then["anymal_c"], 20).mean() / 1e6
    assert "was at 30 after {:.1f} M, and an ANYmal-C at 20 after {:.1f}.".format(*old) in words
    config = config_lib.validate(config_lib.load("anymal_c:deploy"))
    thousand = config.rollout.num_envs * config.rollout.horizon / 1e3
    assert f"From iteration {config.schedule.last_iteration} on `deploy` has no tail" in words
    assert f"{thousand:.0f} thousand steps an iteration" in words
    assert config.ppo.late_kl == 1.0  # so no run of PPO halves its KL there
    ended = [
        np.mean([run[-1]["return"] for run in table.seeds(job)])
        for job in (anymal, then["anymal_c"])
    ]
    assert f"ends at {ended[0]:.1f} after {ends[-1]:.1f} M" in words
    assert f"ended at {ended[1]:.1f}" in words
    # the same on the page of hardware
    page = " ".join((DEPLOY / "README.md").read_text().split())
    results = " ".join((ROOT / "docs/results.md").read_text().split())
    early = most["g"][0], most["c"][0], most["g"][1], most["c"][1]
    text = "a Go1 returns {:.1f} and an ANYmal-C {:.1f}, with PPO at most {:.1f} and {:.1f}, with 256, 512"
    assert text.format(*early) in page
    text = "a Go1 returns {:.1f} and an ANYmal-C {:.1f}, with PPO alone at most {:.1f} and {:.1f}. Later"
    assert text.format(*early) in results
    assert (
        "is there after {:.1f} and {:.1f} (256 robots, two of three seeds each)".format(*ppo)
        in page
    )
    text = f"an ANYmal-C takes {twenty.mean():.0f} M steps to 20"
    assert text in page and text in results
    assert "three of nine runs take 14 to 19, and the others" in results
    assert "are not there by their ends, at 9.2 to 19.7 M" in page
    many = [np.nanmean(firsts[f"deploy-{n}-{x}"]) for x in "gc" for n in (256, 512, 1024)]
    text = "256 robots reach 30 after {:.1f} M steps, 512 after {:.1f}, 1024 after {:.1f}, in the mean of the"
    text += " seeds that get there. On an ANYmal-C they reach 15 after {:.1f} (one of three never), {:.1f}"
    text += " and {:.1f}"
    assert text.format(*many) in page


def test_a_run_that_was_stopped_goes_on_from_its_last_evaluation(tmp_path, monkeypatch):
    """Stopped after two of four chunks, with a random key in its state: the rows of one that was not."""
    run, stop_at, ran = script("21_less/run"), [None], []

    def step(hyper, state, columns):
        total, key = state
        if stop_at[0] == len(ran):
            raise KeyboardInterrupt
        ran.append(len(columns["sim_steps"]))
        key, noise = jax.random.split(key)
        return (total + jax.random.uniform(noise, (2,)), key), {"kl": np.ones((5, 2))}

    first = jnp.zeros(2), jax.random.key(7)
    program = types.SimpleNamespace(
        state=first,
        step=step,
        hyper=None,
        columns={"sim_steps": np.arange(20), "iteration": np.arange(20)},
        evaluate=lambda state: {"return": state[0], "fall_rate": state[0]},
    )
    monkeypatch.setattr(run.build, "program", lambda config: program)
    monkeypatch.setattr(run.overflow, "check", lambda metrics: None)
    fields = "run.num_iterations=20 run.eval_every=5 run.num_seeds=2 run.device=cpu".split()

    def rows(name, states=None):
        run.run(tmp_path / name, "go1:ppo16", fields, states=states)
        text = list(csv.DictReader((tmp_path / f"{name}.csv").open(newline="")))
        return [{k: v for k, v in row.items() if k != "seconds"} for row in text]

    whole = rows("whole")
    assert len(whole) == 8 and ran == [5] * 4
    ran.clear()
    stop_at[0] = 2
    with pytest.raises(KeyboardInterrupt):
        rows("cut", tmp_path / "states/cut")
    assert len((tmp_path / "cut.csv.part").read_text().splitlines()) == 5
    stop_at[0] = None
    before = (tmp_path / "states/cut").read_bytes()
    assert rows("cut", tmp_path / "states/cut") == whole and ran == [5] * 4
    assert not (tmp_path / "states/cut").exists()
    (tmp_path / "states/cut").write_bytes(before)
    fields[0] = "run.num_iterations=30"
    with pytest.raises(SystemExit, match="iterations=20.* expected .*iterations=30.*; remove it"):
        rows("cut", tmp_path / "states/cut")


def test_best_setting_is_the_one_that_walks_soonest_and_never_counts_twice(tmp_path, monkeypatch):
    """Setting `a` walks at 2 M and never (of 3 M): (2 + 6) / 2; `b` at 3 M twice. `c` is another robot's. The
    chosen settings have the fresh seeds, and a job that has not run is named."""
    choose = script("21_less/choose")
    good, bad = {"return": 40, "fall_rate": 0}, {"return": 40, "fall_rate": 0.5}
    fields = "run.seed=0 run.num_seeds=2 run.eval_every=20 run.eval_envs=200"
    jobs = {
        "a": f"go1:best {fields} ppo.gamma=0.9",
        "b": f"go1:best {fields}",
        "c": f"go2:best {fields}",
    }
    walked = {"a": (2, 4), "b": (3, 3), "c": (1, 1)}  # first M steps with few falls, of 3
    path, fresh = tmp_path / "jobs.txt", tmp_path / "fresh.txt"
    path.write_text("".join(f"{name} {job}\n" for name, job in jobs.items()))
    monkeypatch.setattr(sys, "argv", ["choose.py", *map(str, (tmp_path, path, fresh))])
    for name, firsts in walked.items():
        with pytest.raises(SystemExit, match=f"lacks .*{name}"):
            choose.main()
        rows = [
            {"job": jobs[name], "seed": seed, "iteration": m, "sim_steps": m * 1e6}
            | (good if m >= at else bad)
            for seed, at in enumerate(firsts)
            for m in (1, 2, 3)
        ]
        script("21_less/run").write(tmp_path / f"{name}.csv", rows)
    choose.main()
    lines = [line.split() for line in fresh.read_text().splitlines()]
    assert [line[:2] for line in lines] == [["walks-b", "go1:best"], ["walks-c", "go2:best"]]
    expected = {"run.seed=1200", "run.num_seeds=10", "run.eval_every=10", "run.eval_envs=1000"}
    assert all(set(line[2:]) == expected for line in lines)


def test_times_of_table_i_are_measured_once_a_cell_and_beside_the_papers(tmp_path, monkeypatch):
    """Two cells of three are there: only the third is measured. Minutes are the paper's."""
    times, path = script("10_ablation/times"), tmp_path / "times.csv"
    monkeypatch.setattr(times, "HERE", tmp_path)
    path.write_text("envs,horizon,ms,device,commit\n512,12,4,GPU,a\n8192,32,40,GPU,a\n")
    asked = []
    monkeypatch.setattr(times.run, "configure", lambda job, *_: asked.append(job))
    monkeypatch.setattr(times.build, "program", lambda _: types.SimpleNamespace(device="GPU"))
    monkeypatch.setattr(times, "iteration", lambda _: 12.5)
    (tmp_path / "first").mkdir()
    times.measure(tmp_path / "first/times.csv", [(512, 12), (8192, 32)])  # times.csv has both
    assert not asked and not (tmp_path / "first/times.csv").exists()
    times.measure(path, [(512, 12), (4096, 16), (8192, 32)])
    assert asked == ["go1:ppo16:rollout.num_envs=4096:rollout.horizon=16"]
    rows = paper.rows(path)
    assert [row["ms"] for row in rows] == [4, 40, 12.5]
    out = times.table(rows)
    for line in ("| R = 512 | 2.00 / 3.1 |", "| R = 4096 |  | 6.25 / 4.9 |", " | 20.00 / 12.3 |"):
        assert line in out
    minutes = {(r["envs"], r["horizon"]): r["time_min"] for r in paper.table("ablation")}
    both = np.log([[2, 20, 6.25], [minutes[512, 12], minutes[8192, 32], minutes[4096, 16]]])
    assert f"3 cells: {np.corrcoef(both)[0, 1]:.3f}" in out


def test_the_times_of_table_i_are_those_of_the_page():
    """Cell by cell; how many times as fast, and what robots cost."""
    page = (EXPERIMENTS / "10_ablation/README.md").read_text()
    rows = paper.rows(EXPERIMENTS / "10_ablation/times.csv")
    shown, _, said = script("10_ablation/times").table(rows).rpartition("\n")
    assert shown in page
    words = " ".join(page.split())
    assert f"is {float(said.split(': ')[1])} over these {len(rows)} cells" in words
    ours = {(row["envs"], row["horizon"]): row["ms"] / 2 for row in rows}
    theirs = {(row["envs"], row["horizon"]): row["time_min"] for row in paper.table("ablation")}
    faster = [60 * theirs[cell] / ours[cell] for cell in ours]
    assert f"{min(faster):.0f} to {max(faster):.0f} times as fast" in words
    few, many = ([of[8192, 16] / of[count, 16] for of in (ours, theirs)] for count in (512, 1024))
    text = (
        "it takes {:.1f} times as long, in the paper {:.1f} times; from 512, which ran on another"
    )
    text += " host, it is {:.1f} and {:.1f} times"
    assert text.format(*many, *few) in words
    first = [row for row in rows if row["commit"].startswith("71c94de1")]
    others = {(row["envs"], row["horizon"]) for row in rows if row not in first}
    assert others == {(512, 12), (512, 16), (512, 20), (1024, 28), (1024, 32)}
    last = script("10_ablation/times").table(first).rpartition(": ")[2]
    assert f"Without them the correlation is {last}." in words


def test_jobs_of_few_robots_are_valid_and_evaluated_on_the_way_to_45_thousand_steps():
    """Of 27_few: `robots-R` has R robots and a memory for all rows up to there. With up to 64 robots there
    are ten evaluations until 45 thousand steps, which every run reaches."""
    evaluations = script("21_less/run").evaluations
    for file in ("jobs", "laptop", "fresh"):
        lines = (EXPERIMENTS / f"27_few/{file}.txt").read_text().splitlines()
        assert len({line.split()[0] for line in lines}) == len(lines)
        for line in lines:
            name, job, *fields = line.split()
            robot, _, variant = job.partition(":")
            config = config_lib.load(f"configs/{robot}.py:{variant}")
            config.run.log_every = 1
            for field in fields:
                if not field.startswith("control="):
                    config_lib.override(config, *field.split("=", 1))
            config = config_lib.validate(config)
            steps = schedule.sim_steps(config)
            if name.startswith("robots-"):
                robots, memory = int(name.split("-")[1]), config.model.memory
                assert config.rollout.num_envs == robots
                assert memory * robots >= 45_000
            if file == "jobs":
                asked = [steps[i - 1] for i in evaluations(config)]
                many = config.rollout.num_envs > 64
                assert many or sum(s <= 45_000 for s in asked) >= 10, name
                assert steps[-1] > 42_000, name
                assert config.schedule.late_from is None


def test_fresh_seeds_of_few_pair_with_those_of_its_table():
    """In 27_few's jobs.txt, and what ran: the seeds and evaluations of fresh.txt."""
    folder = EXPERIMENTS / "27_few"
    jobs, fresh = (
        dict(line.split(None, 1) for line in (folder / f"{file}.txt").read_text().splitlines())
        for file in ("jobs", "fresh")
    )
    ran = few_jobs("feet")
    for robot in "ghcd":
        asked = f"{fresh[f'fresh-{robot}']} schedule.anchors=0"
        assert jobs[f"fresh-anchors-{robot}"] == asked
        assert jobs[f"fresh-spread-{robot}"] == f"{fresh[f'fresh-{robot}']} control=spread"
        no_late = "schedule.late_from=None ppo.late_kl=1.0"
        asked = f"{fresh[f'fresh-{robot}']} {no_late}"
        assert {row["job"] for row in few_jobs("late")[f"fresh-late-{robot}"]} == {asked}
        assert {row["job"] for row in ran[f"fresh-{robot}"]} == {fresh[f"fresh-{robot}"]}


def test_the_table_of_logs_is_that_of_its_seeds(tmp_path):
    """In logs.md; and by hand, of two seeds that gain 1 and 3: 2 with Student's 12.706 of one degree."""
    table, few = script("27_few/logs_table"), EXPERIMENTS / "27_few"
    page = [cells(line) for line in (few / "logs.md").read_text().splitlines() if "|" in line]
    rows = [cells(line) for line in table.table(table.SEEDS).splitlines()]
    assert len(rows) == 11 and all(row in page for row in [rows[0], *rows[2:]])
    head = "case,seed,sensors,iteration,log_seconds,return,fall_rate"
    some = [
        f"motors,{s},0.0,{i},80.0,{r},0.25"
        for s, r in ((0, 31), (1, 33))
        for i, r in ((0, 30), (15, r))
    ]
    (tmp_path / "a.csv").write_text("\n".join([head, *some, ""]))
    row = cells(table.table(tmp_path / "a.csv").splitlines()[-1])
    half = 12.706 * np.std([1, 3], ddof=1) / 2**0.5
    assert row == [
        *("motors", "80 s", "0.0", "2", "30.0, 25 %"),
        f"32.0 (31.0 to 33.0), 25 %; +2.0 ± {half:.1f}",
    ]


def test_the_tables_of_few_robots_are_those_of_their_runs():
    """Each line with returns is that of a job, by hand that of its name; no run on a CPU is left out,
    and they ran what laptop.txt says, less what `few` was then."""
    table, few = script("27_few/table"), EXPERIMENTS / "27_few"
    page = {
        name: [cells(line) for line in (few / f"{name}.md").read_text().splitlines() if "|" in line]
        for name in ("README", "model", "history")
    }

    def told(path, at):
        return [cells(line) for line in table.table(table.read(path), at).splitlines()[2:]]

    on_cpu, jobs = told(few / "results", [17.4, 27.6, 43]), table.read(few / "results")
    of_cpu = [row for row in page["history"] if len(row) == 8 and row[0][0] == "`"]
    found = {row[0].strip("`"): row[2:] for row in of_cpu}
    assert found == {row[0]: row[1:] for row in on_cpu} and len(jobs) >= 9
    laptop = [line.split() for line in (few / "laptop.txt").read_text().splitlines()]
    then = {"rollout.horizon=20", "schedule.end_steps=16", "model.minibatches=5"}
    then.add("run.num_iterations=160")
    assert {name: [f for f in job if f not in then] for name, *job in laptop if name in jobs} == {
        name: rows[0]["job"].split() for name, rows in jobs.items()
    }
    packed = few / "results" / "gpu.csv.xz"
    on_gpu = [tuple(row[2:8]) for row in told(packed, [10.0, 15.0, 20.0, 27.0, 43.0])]
    fresh = [row[2:8] for row in page["README"] if len(row) == 9 and row[2].endswith("%")]
    model, before = (
        [row[1:7] for row in page[name] if len(row) == 7 and row[1].endswith("%")]
        for name in ("model", "history")
    )
    never = ["never in 84 k" if "5 never" in row[-1] else row[-1] for row in on_gpu]
    known = {(*row[:-1], last) for row, last in zip(on_gpu, never, strict=True)}
    assert (len(fresh), len(model), len(before)) == (4, 17, 26)
    assert {tuple(row) for row in fresh + model + before} <= known


def shows(text, *values):
    """Whether the numbers in a cell are these, each to the digits that it has; what is halfway may go up or
    down."""
    numbers = re.findall(r"(?<![\w.])\d+(?:\.\d+)?", text)
    digits = [len(number.partition(".")[2]) for number in numbers]
    return len(numbers) == len(values) and all(
        abs(float(number) - value) <= 0.5 * 10.0**-count + 1e-9
        for number, count, value in zip(numbers, digits, values, strict=True)
    )


@functools.cache
def few_jobs(batch):
    """Jobs of a batch of 27_few by name."""
    return script("27_few/table").read(EXPERIMENTS / "27_few/results/gpu.csv.xz", batch)


@functools.cache
def few_of(batch, name):
    """Of a job of 27_few: seeds, and where each is first at its level and walks."""
    table = script("27_few/table")
    seeds = table.runs.seeds(few_jobs(batch)[name])
    return seeds, table.runs.reached(seeds, table.level_of(seeds[0]))


def first_of(batch, name):
    """Thousand steps to the level, mean and last seed, as the pages have them."""
    level = few_of(batch, name)[1].level / 1e3
    return f"{level.mean():.1f} ({level.max():.1f})"


def words_of_first(reached):
    """The same of what `few_of` found, as a sentence has it."""
    return (
        f"{reached.level.mean() / 1e3:.1f} k steps (the last seed {reached.level.max() / 1e3:.1f})"
    )


def falls_of(batch, name, least=0.0, most=np.inf):
    """Per cent of episodes with a fall in the last four evaluations, or in the four between these steps."""
    seeds = few_of(batch, name)[0]
    some = [[r["fall_rate"] for r in run if least <= r["sim_steps"] <= most][-4:] for run in seeds]
    assert {len(run) for run in some} == {4} and {len(run) for run in seeds} != {4}
    return 100 * np.mean(some)


def test_how_many_few_robots_need_which_steps_is_as_the_page_says():
    few, page = script("27_few/table"), (EXPERIMENTS / "27_few/README.md").read_text()
    text = " ".join(page.split())
    rows = {cells(line)[0]: cells(line)[1:] for line in page.splitlines() if "|" in line}
    jobs = {f"{count}": ("robots-3", f"robots-{count}-") for count in (16, 256, 1024)}
    jobs |= {"1": ("parts-2", "robots-1-"), "4": ("one-commit", "robots-4-")}
    jobs |= {"64": ("late", "fresh-late-"), "1024, `best`": ("rows", "best-")}
    for label, (batch, name) in jobs.items():
        first, minutes, iterations, anymal = rows[label]
        seeds, reached = few_of(batch, f"{name}g")
        assert (first, anymal) == tuple(first_of(batch, f"{name}{x}") for x in "gc"), label
        assert shows(minutes, reached.level.mean() / 3000)
        at = few.runs.reached(seeds, few.level_of(seeds[0]), "iteration").level
        assert shows(iterations, at.mean()), (label, at.mean())
        held = {"64": range(970, 980), "1024, `best`": range(5)}.get(label, range(3))
        for letter in "gc":
            assert [run[0]["seed"] for run in few_of(batch, f"{name}{letter}")[0]] == [*held]
    (go, go_at), (anymal, anymal_at) = (few_of("parts-2", f"robots-1-{x}") for x in "gc")
    assert f"after {words_of_first(go_at)}, which is four robot-minutes and a third" in text
    told = [1e2 * round(10 * float(rows[robots][0].split()[0])) for robots in ("1", "4", "16")]
    assert (
        "one Go1 is at the level after {:,.0f} steps, four are after {:,.0f}, sixteen".format(*told)
        in text
    )
    assert f"sixteen after {told[2]:,.0f} (three seeds each)" in text
    many = [1e2 * round(10 * float(rows[robots][0].split()[0])) for robots in ("256", "1024")]
    assert "256 Go1 need {:,.0f}, 1024 need {:,.0f}.".format(*many) in text
    last = (
        f"an ANYmal-C after {anymal_at.level.mean() / 1e3:.1f} ({anymal_at.level.max() / 1e3:.1f})"
    )
    assert f"{last}, seven. All three ANYmal-C walk, from" in text
    for words, of in (("4.33", go_at), ("6.9", anymal_at)):
        assert shows(words, of.level.mean() / 3000)
    first_walk, last_walk = anymal_at.walks.min() / 1e3, anymal_at.walks.max() / 1e3
    assert f"from {first_walk:.0f} to {last_walk:.0f} k on. Of three Go1 one walks" in text
    assert [int(x) for x in np.isnan(go_at.walks)] == [1, 0, 1]
    assert f"one walks, from {go_at.walks[1] / 1e3:.0f} k on" in text
    falls = [100 * r["fall_rate"] for r in go[2]]
    assert f"falls in {falls[-2]:.1f} and {falls[-1]:.1f} % of its episodes in the last two" in text
    assert (min(falls[-10:-2]), max(falls[-10:-2])) == (0.5, 1.0) and falls[-11] > 1
    assert "after 0.5 to 1 % in the eight before" in text
    finite = [r for r in go[0] if r["return"]]
    ends = finite[-1]["sim_steps"] / 1e3, go[0][len(finite)]["sim_steps"] / 1e3
    known = f"was at the level after {go_at.level[0] / 1e3:.1f} k, had returns of 42, and"
    assert known in text and f"between {ends[0]:.0f} and {ends[1]:.0f} k" in text
    known = " ".join((EXPERIMENTS / "27_few/model.md").read_text().split())
    assert f"between {ends[0]:.0f} and {ends[1]:.0f} k. Up to then its return is 42" in known
    late = [r for r in finite if r["sim_steps"] > 24.9e3]
    assert "at most 1.5 % falls since 25 k" in known
    assert max(r["fall_rate"] for r in late) == 0.015
    assert {round(r["return"]) for r in late} == {42}
    four = [few_of("one-commit", f"robots-4-{x}")[1] for x in "gc"]
    level = [f"{one.level.mean() / 1e3:.1f}" for one in four]
    last = [f"{one.level.max() / 1e3:.1f}" for one in four]
    assert (
        f"after {level[0]} k steps (the last seed {last[0]}), which is three robot-minutes" in text
    )
    assert f"and a quarter, ANYmal-C after {level[1]} ({last[1]}). All six walk." in text
    assert shows("3.25", four[0].level.mean() / 3000)
    assert np.isfinite([one.walks for one in four]).all()
    walk = {
        count: [few_of("robots-3", f"robots-{count}-{x}")[1].walks / 1e3 for x in "gc"]
        for count in (16, 256, 1024)
    }
    told = f"Go1 walk, from {min(walk[16][0]):.0f} to {max(walk[16][0]):.0f} k on, and two ANYmal-C"
    assert told in text and [np.isfinite(x).sum() for x in walk[16]] == [3, 2]
    last = few_of("robots-3", "robots-16-c")[0][int(np.isnan(walk[16][1]).argmax())][-1]
    assert f"the third falls in {100 * last['fall_rate']:.1f} % of its last episodes" in text
    told = (
        f"all walk, from {np.min(walk[256]):.0f} to {np.max(walk[256]):.0f} k on, as do five of six"
    )
    assert told in text and np.isfinite(walk[256]).all() and np.isfinite(walk[1024]).sum() == 5
    told = f"from {np.nanmin(walk[1024]):.0f} to {np.nanmax(walk[1024]):.0f} k on"
    assert told in text
    saved = []
    for x in "gc":
        mine, best = (
            few_of(*one)[1].level
            for one in (("robots-3", f"robots-1024-{x}"), ("rows", f"best-{x}"))
        )
        ratio = stats.ratio(mine, best)
        saved.append([100 * (1 - part) for part in (ratio.value, ratio.high, ratio.low)])
    told = "{:.0f} % fewer than the `best` of the table on a Go1 ({:.0f} to {:.0f}) and {:.0f} % fewer on"
    assert (told + " an ANYmal-C ({:.0f} to {:.0f})").format(*saved[0], *saved[1]) in text
    begin = []
    for robots, late in ((256, 53), (1024, 21)):
        run = few_jobs("robots-3")[f"robots-{robots}-g"][0]["job"]
        assert run.endswith(f" schedule.late_from={late}")
        every = few_of("robots-3", f"robots-{robots}-g")[0][0][:2]
        each = np.diff([[row[key] for row in every] for key in ("sim_steps", "iteration")], axis=1)
        after = (late - every[0]["iteration"]) * each[0] / each[1]
        begin.append((every[0]["sim_steps"] + after[0]) / 1e3)
    assert "with 256 and 1024 robots these begin at {:.0f} and {:.0f} k".format(*begin) in text
    memory = [
        few_of("rows", f"best-{x}")[1].level.mean() / 1e3 for x in ("memory-g", "memory-c", "c")
    ]
    assert "(`best-memory`: {:.1f} k, ANYmal-C {:.1f} instead of {:.1f} k)".format(*memory) in text


def test_what_anchors_are_worth_with_few_robots_is_as_the_page_says():
    """The rule was written before: pairs of fresh seeds, walks, and one and four robots."""
    page = (EXPERIMENTS / "27_few/README.md").read_text()
    part = (EXPERIMENTS / "27_few/parts.md").read_text().split("## Without anchors")[1]
    part = part.split("## Without smaller")[0]
    words = " ".join(part.split())
    few, rows = (
        script("27_few/table"),
        {cells(x)[0]: cells(x)[1:] for x in part.splitlines() if "|" in x},
    )
    names = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}
    pairs, walk = [], [0, 0]
    for robot, letter in names.items():
        told = few.line(
            "",
            few.runs.seeds(few_jobs("anchors")[f"fresh-anchors-{letter}"]),
            [10.0, 15.0, 20.0, 27.0, 43.0],
        )
        assert rows[robot] == told[1][1:]
        (with_seeds, with_), (seeds, without) = (
            few_of(batch, f"{name}-{letter}")
            for batch, name in (("feet", "fresh"), ("anchors", "fresh-anchors"))
        )
        assert [run[0]["seed"] for run in seeds] == [run[0]["seed"] for run in with_seeds]
        pairs.extend((without.level - with_.level) / 1e3)
        walk = [n + np.isfinite(x.walks).sum() for n, x in zip(walk, (without, with_), strict=True)]
    mean, p = np.mean(pairs), scipy.stats.ttest_1samp(pairs, 0).pvalue
    half = scipy.stats.t.ppf(0.975, 29) * np.std(pairs, ddof=1) / 30**0.5
    told = f"{mean:.1f} k steps later without anchors (95 % from {half - mean:.1f} sooner"
    told += f" to {mean + half:.1f} later, p {p:.2f})"
    assert f"{told}, so its end is not below 1.5 k" in words and mean + half > 1.5
    some = np.array(pairs[:10])
    half = scipy.stats.t.ppf(0.975, 9) * some.std(ddof=1) / 10**0.5
    text = "on Go1 alone {:.1f} k later ({:.1f} to {:.1f}, uncorrected)"
    assert text.format(some.mean(), some.mean() - half, some.mean() + half) in words
    assert f"on Go2 {-np.mean(pairs[10:15]):.1f} k sooner" in words
    assert f"{walk[0]} of 30 seeds walk, with anchors {walk[1]}." in words

    def level(name, letter):
        batch = {"robots-1": "parts-2", "robots-4": "one-commit"}.get(name, "robots-2")
        return few_of(batch, f"{name}-{letter}")[1].level / 1e3

    free, mine = level("free-robots-1", "c"), level("robots-1", "c")
    more = "{:.1f} k more, {:.1f} to {:.1f}".format(*stats.difference(free, mine))
    assert f"{free.mean():.1f} instead of {mine.mean():.1f} k steps ({more})" in words.replace(
        "k  m", "k m"
    )
    free, mine = level("free-robots-1", "g"), level("robots-1", "g")
    assert stats.difference(free, mine).low < 0
    assert f"shown, {free.mean():.1f} and {mine.mean():.1f} k" in words
    free, mine = level("free-robots-4", "c"), level("robots-4", "c")
    assert np.isnan(free).sum() == 1
    assert (
        f"after {np.nanmean(free):.1f} k, with anchors all three after {mine.mean():.1f}" in words
    )
    free, mine = level("free-robots-4", "g"), level("robots-4", "g")
    assert f"Go1: {free.mean():.1f} and {mine.mean():.1f} k" in words
    bound = [few_of("robots-2", f"bound50-robots-1-{x}")[1] for x in "gc"]
    text, ranges = " ".join(page.split()), [(x.walks / 1e3).round() for x in bound]
    told = "Go1 from {:.0f} to {:.0f} k on and ANYmal-C from {:.0f} to {:.0f} k on"
    assert told.format(*(f(x) for x in ranges for f in (min, max))) in text
    told = [
        words_of_first(bound[0]),
        "{:.1f} ({:.1f})".format(*(f(bound[1].level) / 1e3 for f in (np.mean, max))),
    ]
    assert "To the level they need {} and {}".format(*told) in text
    for x, of in zip("gc", bound, strict=True):
        assert stats.difference(of.level / 1e3, level("robots-1", x)).low < 0
        seeds = few_of("robots-2", f"bound50-robots-1-{x}")[0]
        assert [run[0]["seed"] for run in seeds] == [0, 1, 2] and all(
            run[-1]["return"] > 20 for run in seeds
        )


PARTS_OF_FEW = {  # what parts.md takes out -> its job
    "nothing: `few`": "whole",
    "imagined robots: 1 for each real one, not 64": "imagined1",
    "remembered rows in the fit": "remembered",
    "a memory": "memory",
    "rounds: 1, not 3 (so no anchors and no new commands)": "rounds1",
    "a symmetric model": "symmetry",
    "anchors: tails begin in rows of the iteration": "anchors",
    "old rows: only a robot's newest 100 are kept": "age100",
    "new commands": "commands",
    "smaller steps late (half of the KL)": "late",
}
OTHER_VALUES = {  # of a part, in parts.md -> its job
    "16 imagined robots for each real one, not 64": "part-imagined16",
    "4 real rows an iteration, not 2": "part-rows4",
    "tails of 16 rows, not 24": "part-tail16",
    "15 remembered rows beside each new one, not 3": "part-remembered15",
    "a weight decay of 0.01 in the model": "part-decay",
    "`spread`: a robot's commands follow each other evenly": "control-spread",
}


def batch_of_part(part, robot):
    """The batch of a cell of parts.md, as the page says."""
    if part == "age100":
        return "age"
    if part not in ("whole", "memory", "commands", "late"):
        return "parts-2"
    if robot in "gc":
        return "parts-cut"
    return "parts-3" if part in ("commands", "late") else "one-commit"


def when_nan(batch, name):
    """Thousand steps of the evaluation from which on all episodes of a seed are falls at no return; NaN."""
    seeds = few_of(batch, name)[0]
    bad = [
        [r["sim_steps"] for r in run if r["fall_rate"] == 1 and r["return"] == 0] for run in seeds
    ]
    return np.array([one[0] / 1e3 if one else np.nan for one in bad])


def test_the_table_of_the_parts_of_few_is_that_of_its_runs():
    """A cell: thousand steps to the level, falls, how many walk; where a policy became NaN, how many did."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    lines = page.split("## Other values")[0].splitlines()
    rows = {cells(line)[0]: cells(line)[1:] for line in lines if "|" in line}
    robots = rows.pop("without")
    rows.pop("---")
    assert robots == ["Go1", "Go2", "ANYmal-C", "ANYmal-D"] and rows.keys() == PARTS_OF_FEW.keys()
    for label, part in PARTS_OF_FEW.items():
        for robot, cell in zip("ghcd", rows[label], strict=True):
            batch, name = batch_of_part(part, robot), f"part-{part}-{robot}"
            cut = cell.endswith(" \\*")
            assert cut == (batch == "parts-cut")
            when, falls, walk = cell.removesuffix(" \\*").split("; ")
            seeds, reached = few_of(batch, name)
            assert [run[0]["seed"] for run in seeds] == [*range(5)], name
            ends = {run[-1]["sim_steps"] for run in seeds}
            assert ends == {44032} or (cut and 33.5e3 < min(ends) and max(ends) < 39e3)
            level = reached.level[np.isfinite(reached.level)] / 1e3
            told = [f"{level.mean():.1f} ({level.max():.1f})"] if len(level) else []
            told += [f"{5 - len(level)} never"] if len(level) < 5 else []
            assert when == ", ".join(told), (name, told)
            assert walk == str(np.isfinite(reached.walks).sum()), name
            if bad := int(np.isfinite(when_nan(batch, name)).sum()):
                assert falls == f"{bad} NaN", name
            else:
                least, most = (26e3, 34.2e3) if cut else (0, np.inf)
                assert shows(falls.removesuffix(" %"), falls_of(batch, name, least, most)), name


def test_what_the_parts_of_few_are_worth_is_as_the_page_says():
    """What parts.md says of its first table, and what took the last falls away, of how many of five walk."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    one, last = page.split("## Without anchors")[0].split("## What takes the last falls away")
    one = one.split("## Other values")[0]
    ends = {cells(line)[0]: cells(line)[1:] for line in last.splitlines() if "|" in line}
    words = " ".join(one.split())

    def level(part, robot):
        return few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[1].level / 1e3

    def falls(part, robot):
        return falls_of(batch_of_part(part, robot), f"part-{part}-{robot}", 26e3, 34.2e3)

    found = {
        part: [np.nan_to_num(level(part, x), nan=np.inf) - level("whole", x) for x in "ghcd"]
        for part in ("imagined1", "remembered", "rounds1", "symmetry", "anchors")
    }
    later = {part: np.sum(np.concatenate(one) > 0.01) for part, one in found.items()}
    assert "1 of 20 runs is at the level by 44 k" in words
    assert sum(np.isfinite(level("imagined1", x)).sum() for x in "ghcd") == 1
    assert later["remembered"] == 20 and "all 20 runs are later" in words
    assert later["symmetry"] == 18 and "in 18 of 20 pairs" in words
    assert all(level("remembered", x).mean() > level("memory", x).mean() for x in "gh")
    saved = [one.mean() for one in found["rounds1"]]
    assert f"**Rounds** save {min(saved):.0f} to {max(saved):.0f} k steps" in words
    anchors = np.concatenate(found["anchors"])
    half = scipy.stats.t.ppf(0.975, 19) * anchors.std(ddof=1) / 20**0.5
    told = (
        f"the level comes {-anchors.mean():.1f} k steps sooner, in the mean of 20 pairs of equal seeds"
        f" (95 % from {half - anchors.mean():.1f} sooner to {anchors.mean() + half:.1f} later,"
        f" p {scipy.stats.ttest_1samp(anchors, 0).pvalue:.2f};"
        f" {np.sum(anchors < -0.01)} sooner, {np.sum(abs(anchors) < 0.01)} the same,"
        f" {later['anchors']} later)"
    )
    assert told in words
    spread = sum(level(part, x).var(ddof=1) / 5 for part in ("whole", "anchors") for x in "ghcd")
    half = scipy.stats.t.ppf(0.975, 32) * spread**0.5 / 4
    told = f"it is {half - anchors.mean():.1f} sooner to {anchors.mean() + half:.1f} later"
    assert f"Unpaired, within robots, {told}" in words
    ten = np.concatenate(found["anchors"][2:])
    told = (
        f"it is {-ten.mean():.1f} k sooner (C {-ten[:5].mean():.1f}, D {-ten[5:].mean():.1f}; of pairs"
        f" p {scipy.stats.ttest_1samp(ten, 0).pvalue:.3f}, seen afterwards; unpaired it is shown on neither)"
    )
    assert told in words
    for one in "cd":
        assert scipy.stats.ttest_ind(level("whole", one), level("anchors", one)).pvalue > 0.05
    told = f"{few_of('one-commit', 'bound50-few-c')[1].level.mean() / 1e3:.1f} instead of"
    assert f"{told} {level('whole', 'c').mean():.1f} k, too" in words
    for part, told in (
        ("anchors", "From 26 to 34 k falls are {}, {}, {} and {} %, with anchors"),
        ("whole", "with anchors {}, {}, {} and {}."),
    ):
        told = re.search(re.escape(told).replace(r"\{\}", r"([\d.]+)"), words)
        assert told is not None
        assert all(shows(x, falls(part, y)) for x, y in zip(told.groups(), "ghcd", strict=True))
    lost = [when_nan("parts-2", f"part-remembered-{x}") for x in "cdh"]
    lost = [f"{np.nanmin(one):.0f} to {np.nanmax(one):.0f} k" for one in lost]
    told = f"at evaluations from {lost[0]} (ANYmal-C), {lost[1]} (ANYmal-D) and {lost[2]} (Go2) on"
    assert told in words
    gone = when_nan("one-commit", "part-memory-d")
    assert f"Five ANYmal-D: at evaluations from {min(gone):.0f} to {max(gone):.0f} k on" in words
    gone = [f"{k:.0f}" for k in when_nan("parts-cut", "part-memory-c")]
    assert [gone.count(k) for k in ("16", "24", "29")] == [1, 3, 1]
    assert "between 13 and 16 k (one), 21 and 24 k (three) and 26 and 29 k (one)" in words
    names = {
        "nothing (batch `wide`, tails of 16, at 45 to 53 k)": "i64rows2",
        "new commands, half of the KL after 160 iterations, as until 2026-11-28": "commands-late",
        "new commands": "end-commands",
        "five rounds, half of the KL": "end-rounds5late",
        "five rounds": "end-rounds5",
        "KL 0.03": "end-kl3",
        "entropy 0.005": "end-entropy5",
        "32 robots, 128 imagined": "end-robots32",
        "256 imagined": "end-imagined256",
        "half of the KL after 160 iterations": "end-late",
        "a quarter of the KL": "end-late4",
        "4 real rows, tails of 32": "end-rows4tail32",
        "episodes of 5 s": "end-episode250",
    }
    assert ends.keys() - {"`few` without new commands, and", "---"} == names.keys()
    for label, name in names.items():
        for letter, cell in zip("gc", ends[label], strict=True):
            job = "wide" if name == "i64rows2" else "end", f"{name}-{letter}"
            walk = [np.isfinite(few_of(*job)[1].walks).sum()] if job[0] == "end" else []
            assert shows(cell, falls_of(*job), *walk), (job, cell)
    text = " ".join(last.split())
    assert f"({few_of('end', 'end-rounds5-g')[1].level.mean() / 1e3:.1f} k on Go1)" in text
    best = [
        few_of("best-commands", f"best-{name}-{x}")[1].level.mean() / 1e3
        for x in "gc"
        for name in ("commands", "now")
    ]
    assert "{:.0f} instead of {:.0f} k (Go1) and {:.0f} instead of {:.0f} k".format(*best) in text


def around_of_pairs(pairs, robots=()):
    """Mean of differences, half of its 95 % interval and p; with `robots`, pairs of lists of seeds, those of
    the unpaired interval within robots."""
    pairs, n = np.asarray(pairs), len(pairs)
    df, error = n - 1, pairs.std(ddof=1) / n**0.5
    if robots:
        error = sum((np.var(x, ddof=1) + np.var(y, ddof=1)) / 5 for x, y in robots) ** 0.5 / 4
        df = 32
    p = 2 * scipy.stats.t.sf(abs(pairs.mean()) / error, df)
    return pairs.mean(), scipy.stats.t.ppf(0.975, df) * error, p


def test_other_values_of_the_parts_of_few_are_as_the_page_says():
    """The table, and pairs of equal seeds over four robots, of twelve tests by Holm."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    part = page.split("## Other values")[1].split("## What takes the last falls away")[0]
    words = " ".join(part.split())
    rows = {cells(line)[0]: cells(line)[1:] for line in part.splitlines() if "|" in line}
    assert rows.keys() - {"`few` with", "---"} == OTHER_VALUES.keys()
    tests = {}
    for label, name in OTHER_VALUES.items():
        batch, pairs = (
            "spread" if name.startswith("control") else "parts-4",
            {"level": [], "falls": []},
        )
        for robot, cell in zip("ghcd", rows[label], strict=True):
            job = batch, f"{name}-{robot}"
            seeds, reached = few_of(*job)
            assert [run[0]["seed"] for run in seeds] == [*range(5)] and seeds[0][-1][
                "sim_steps"
            ] > 42.9e3
            when, falls, walk = cell.split("; ")
            assert when == first_of(*job) and shows(falls.removesuffix(" %"), falls_of(*job))
            assert walk == str(np.isfinite(reached.walks).sum())
            whole = batch_of_part("whole", robot), f"part-whole-{robot}"
            pairs["level"].extend((reached.level - few_of(*whole)[1].level) / 1e3)
            mine, other = (
                [
                    np.mean([r["fall_rate"] for r in run if 26e3 <= r["sim_steps"] <= 34.2e3][-4:])
                    for run in few_of(*one)[0]
                ]
                for one in (job, whole)
            )
            pairs["falls"].extend(100 * (np.array(mine) - other))
        tests |= {(name, what): around_of_pairs(some) for what, some in pairs.items()}
    holm = dict(zip(tests, stats.holm([p for *_, p in tests.values()]), strict=True))
    assert [key for key, p in holm.items() if p < 0.05] == [("part-imagined16", "level")]
    mean, half, p = tests["part-imagined16", "level"]
    told = f"comes {mean:.1f} k steps later, in the mean of 20 pairs of equal seeds (95 % from"
    told += f" {mean - half:.1f} to {mean + half:.1f} later, p {p:.4f};"
    assert f"{told} {holm['part-imagined16', 'level']:.3f} by Holm" in words
    means = {
        what: [mean for (name, of), (mean, *_) in tests.items() if of == what and name[-2:] != "16"]
        + [tests["part-tail16", what][0]]
        for what in ("level", "falls")
    }
    told = "to the level {:.1f} k sooner (decay, `spread`) to {:.1f} k later (15 remembered"
    assert told.format(-min(means["level"]), max(means["level"])) in words
    told = "falls {:.1f} points fewer (`spread`) to {:.1f} more (15 remembered rows, where one"
    assert told.format(-min(means["falls"]), max(means["falls"])) in words
    mean, half, _ = tests["part-remembered15", "falls"]
    assert f"{half - mean:.1f} fewer to {mean + half:.1f} more)" in words
    assert min(means["level"]) == tests["part-decay", "level"][0]
    assert all(f"{tests[x, 'level'][0]:.1f}" == "-0.6" for x in ("part-decay", "control-spread"))
    walk = [few_of("spread", f"control-spread-{x}")[1].walks for x in "ghcd"]
    assert np.isfinite(walk).all() and "alone has all 20 seeds walking" in words
    assert all(line.count("; 5 |") < 4 for line in part.splitlines() if "spread" not in line)


def test_why_smaller_steps_late_have_gone_from_few_is_as_the_page_says():
    """The rule was written before: pairs of fresh seeds, falls at their end and walks."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text().split("## Without smaller steps late")[1]
    text = (EXPERIMENTS / "27_few/README.md").read_text()
    words, few = " ".join(page.split()), script("27_few/table")
    words_of_part = words
    names = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}
    fewer, later, walk, both, told_of = [], [], [[], []], [], []
    for of, batch, name in (
        (page, "feet", "fresh"),
        (text.split("## Fresh seeds")[1], "late", "fresh-late"),
    ):
        rows = {cells(x)[0]: cells(x)[1:] for x in of.splitlines()[:25] if "|" in x}
        for robot, letter in names.items():
            seeds = few_of(batch, f"{name}-{letter}")[0]
            assert rows[robot] == few.line("", seeds, [10.0, 15.0, 20.0, 27.0, 43.0])[1][1:]
    for letter in "ghcd":
        (with_seeds, with_), (seeds, without) = (
            few_of(*job) for job in (("feet", f"fresh-{letter}"), ("late", f"fresh-late-{letter}"))
        )
        assert [run[0]["seed"] for run in seeds] == [run[0]["seed"] for run in with_seeds]
        ends = [
            100 * np.mean([[r["fall_rate"] for r in run[-4:]] for run in some], 1)
            for some in (seeds, with_seeds)
        ]
        fewer.extend(ends[0] - ends[1])
        told_of.append(ends[0].mean())
        later.extend((without.level - with_.level) / 1e3)
        both.append(np.mean([*without.level, *with_.level]) / 1e3)
        for counts, one in zip(walk, (without, with_), strict=True):
            counts.append(int(np.isfinite(one.walks).sum()))
    mean, half, p = around_of_pairs(fewer)
    assert mean + half < 0.3 and sum(walk[0]) >= sum(walk[1]) - 1  # the rule
    told = f"{-mean:.2f} points fewer without it (95 % from {half - mean:.2f} fewer to {mean + half:.2f}"
    assert (
        f"{told} more, p {p:.2f}), and {sum(walk[0])} instead of {sum(walk[1])} seeds walk" in words
    )
    assert walk == [[9, 5, 10, 4], [10, 3, 9, 5]]
    mean, half, p = around_of_pairs(later)
    told = f"{mean:.1f} k steps later without it ({half - mean:.1f} sooner to"
    assert f"{told} {mean + half:.1f} later, p {p:.2f})" in words
    walk = [np.isfinite(few_of("commands", f"few-940-{x}")[1].walks).sum() for x in "ghcd"]
    assert f"{sum(walk)} of 30 other seeds walked without it" in words
    text = " ".join(text.split())
    told = "In the last four evaluations {:.1f}, {:.1f}, {:.1f} and {:.1f} % of the episodes have a fall"
    assert told.format(*told_of) in text
    assert "Over both it is {:.1f}, {:.1f}, {:.1f} and {:.1f} k".format(*both) in text
    hundreds = [100 * round(10 * both[k]) for k in (0, 2)]
    assert "same settings and seeds it is {:,.0f} and {:,.0f}.".format(*hundreds) in text
    mean, half, _ = around_of_pairs(fewer)
    assert f"worth at most {mean + half:.2f} points of falls (95 %), where 0.3 was allowed" in text
    mean, half, _ = around_of_pairs(later[:10])
    told = f"on Go1 alone {mean:.1f} k ({half - mean:.1f} sooner to {mean + half:.1f} later)"
    assert told in words_of_part
    at = [few_of("late", f"fresh-late-{x}")[1].walks / 1e3 for x in "ghcd"]
    told = (
        "from {:.0f} to {:.0f} k on (means: Go1 {:.0f} k, Go2 {:.0f} k, ANYmal-C {:.0f} k, ANYmal-D"
    )
    told += " {:.0f} k)"
    every = np.concatenate(at)
    assert told.format(np.nanmin(every), np.nanmax(every), *map(np.nanmean, at)) in text
    level = [few_of("late", f"fresh-late-{x}")[1].level for x in "gc"]
    words = "64 Go1 need {:,.0f} simulator steps (mean of ten fresh seeds; the last {:,.0f}), 64 ANYmal-C"
    words += " {:,.0f} (the last {:,.0f})."
    hundreds = [100 * round(f(x) / 100) for x in level for f in (np.mean, np.max)]
    assert words.format(*hundreds) in text
    last = [
        100 * run[-1]["fall_rate"]
        for x in "gd"
        for run, at in zip(
            *few_of("late", f"fresh-late-{x}")[:1],
            few_of("late", f"fresh-late-{x}")[1].walks,
            strict=True,
        )
        if np.isnan(at)
    ]
    assert len(last) == 2
    assert "fall in {:.1f} and {:.1f} % of their last episodes".format(*last) in text


def test_what_the_other_parts_of_few_are_worth_is_as_the_page_says():
    """Old rows, new commands, smaller steps late: pairs of equal seeds over four robots, and falls of the
    four evaluations from 26 to 34 k, which all have."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    words = " ".join(page.split("## Other values")[0].split())

    def seeds(part, robot, least=26e3, most=34.2e3):
        runs = few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[0]
        some = [
            [r["fall_rate"] for r in run if least <= r["sim_steps"] <= most][-4:] for run in runs
        ]
        return 100 * np.mean(some, 1)

    def level(part, robot):
        got = few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[1].level / 1e3
        return np.where(np.isnan(got), 44.032, got)

    parts, tests = ("age100", "commands", "late"), {}
    for part in parts:
        for of in (level, seeds):
            pairs = np.concatenate([of(part, x) - of("whole", x) for x in "ghcd"])
            tests[part, of] = around_of_pairs(pairs)
    holm = dict(zip(tests, stats.holm([p for *_, p in tests.values()]), strict=True))
    assert [key for key, p in holm.items() if p < 0.05] == [("commands", seeds)]

    def sooner(mean, half):
        return f"({half - mean:.1f} sooner to {mean + half:.1f} later)"

    mean, half, p = tests["commands", seeds]
    told = f"falls are {mean:.1f} points more without them, in the mean of 20 pairs of equal"
    told += f" seeds (95 % from {mean - half:.1f} to {mean + half:.1f} more, p {p:.3f})"
    assert f"From 26 to 34 k {told}." in words
    assert f"the one below, p is {holm['commands', seeds]:.3f}." in words
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    assert f"(without them falls are {mean:.1f} points more, over the four)" in text
    assert (
        "no difference to the level is shown for 19 of 20 seeds. One ANYmal-C is not there" in text
    )
    robots = [(seeds("commands", x), seeds("whole", x)) for x in "ghcd"]
    _, half, p = around_of_pairs(np.concatenate([x - y for x, y in robots]), robots)
    assert p < 0.05 and f"it is {mean - half:.1f} to {mean + half:.1f} more. Each robot" in words
    told = re.search(r"Each robot falls more, in (.+?) instead of (.+?), but on none", words)
    for text, column in zip(told.groups(), zip(*robots, strict=True), strict=True):
        assert shows(text, *(np.mean(x) for x in column))
    assert all(np.mean(x) > np.mean(y) and stats.welch_of(x, y) > 0.05 for x, y in robots)
    new = [seeds("commands", x, 0, np.inf) - seeds("whole", x, 0, np.inf) for x in "hd"]
    mean, half, _ = around_of_pairs(np.concatenate(new))
    told = f"evaluations {mean:.1f} points more (ten pairs, {half - mean:.1f} fewer to"
    told += f" {mean + half:.1f} more)"
    assert told in words
    mean, half, _ = tests["commands", level]
    assert f"{-mean:.1f} k steps sooner without {sooner(mean, half)}" in words

    mean, half, p = tests["late", seeds]
    told = f"falls are {-mean:.1f} points fewer without them (20 pairs, {half - mean:.1f} fewer"
    assert f"{told} to {mean + half:.1f} more, p {p:.2f})" in words
    steps = schedule.sim_steps(config_lib.validate(config_lib.load("configs/go1.py:few")))
    assert f"began at {steps[160 - 1] / 1e3:.1f} k" in words
    ends = {
        (part, x): [seeds(part, x, 0, np.inf), seeds("whole", x, 0, np.inf)]
        for part in parts
        for x in "hd"
    }
    corrected = dict(
        zip(ends, stats.holm([stats.welch_of(*pair) for pair in ends.values()]), strict=True)
    )
    got = stats.difference(*ends["late", "d"])
    told = f"({-got.high:.1f} to {-got.low:.1f} fewer, Welch's p {stats.welch_of(*ends['late', 'd']):.3f},"
    assert f"{told} {corrected['late', 'd']:.3f} by Holm of six such, seen afterwards)" in words
    got = stats.difference(*ends["late", "h"])
    assert f"({-got.low:.1f} fewer to {got.high:.1f} more). But fresh" in words
    told = re.search(r"ANYmal-D has ([\d.]+) instead of ([\d.]+) % without", words).groups()
    told += re.search(r"Go2 ([\d.]+) instead of ([\d.]+) \(", words).groups()
    means = [np.mean(x) for robot in "dh" for x in ends["late", robot]]
    assert all(shows(x, mean) for x, mean in zip(told, means, strict=True))
    assert f"*with* them have {falls_of('feet', 'fresh-d'):.1f} %, too" in words
    for robot in "ghcd":
        some = seeds("late", robot), seeds("whole", robot)
        assert stats.welch_of(*some) > 0.05 and np.mean(some[0]) < np.mean(some[1])

    mean, half, _ = tests["age100", level]
    assert f"it is {mean:.1f} k later {sooner(mean, half)}" in words
    raw = np.concatenate([few_of("age", f"part-age100-{x}")[1].level / 1e3 for x in "ghcd"])
    pairs = raw - np.concatenate([level("whole", x) for x in "ghcd"])
    assert np.isnan(pairs).nonzero()[0].tolist() == [10]
    mean, half, _ = around_of_pairs(pairs[np.isfinite(pairs)])
    told = (
        f"19 of 20 runs get to the level, {-mean:.1f} k steps sooner than the run of the same seed"
    )
    told += " (95 % from"
    assert f"{told} {half - mean:.1f} sooner to {mean + half:.1f} later)" in words
    mean, half, _ = tests["age100", seeds]
    told = f"in the mean {mean:.1f} points more than with all rows ({half - mean:.1f} fewer"
    assert f"{told} to {mean + half:.1f} more)" in words
    told = re.search(r"From 26 to 34 k ([^%]+) % of the episodes have a fall, in the mean", words)
    assert shows(told[1], *(np.mean(seeds("age100", x)) for x in "ghcd"))
    runs = {
        (x, i): run for x in "ghcd" for i, run in enumerate(few_of("age", f"part-age100-{x}")[0])
    }
    lost = {  # where all but one in a hundred fall
        key: [r["sim_steps"] / 1e3 for r in run if r["fall_rate"] >= 0.99 and r["sim_steps"] > 1e4]
        for key, run in runs.items()
    }
    lost = {key: [f"{k:.0f}" for k in at] for key, at in lost.items() if at}
    assert lost == {
        ("g", 4): ["11", "13", "16"],
        ("c", 0): ["13", "16", "18", "21", "34", "36", "39"],
    }
    assert (
        "two runs fall in 99 % of their episodes or more for a while: a Go1 from 11 to 16 k"
        in words
    )
    assert "the twentieth, an ANYmal-C, from 13 to 21 k and from 34 to 39 k. It is" in words
    last = few_of("age", "part-age100-c")[0][0][-1]["return"]
    assert shows(re.search(r"is at ([\d.]+) at the end, just below", words)[1], last)
    others = [
        run
        for x in "ghcd"
        for job in ((batch_of_part("whole", x), f"part-whole-{x}"), ("feet", f"fresh-{x}"))
        for run in few_of(*job)[0]
    ]
    mine, its = (
        np.array([max(r["fall_rate"] for r in run if r["sim_steps"] > 15e3) for run in some])
        for some in (runs.values(), others)
    )
    assert (len(its), max(its)) == (50, 0.12) and "at most 12 % in each of 50 runs" in words
    assert [np.sum(x > 0.9) for x in (mine, its)] == [2, 0]
    fisher = scipy.stats.fisher_exact([[2, 18], [0, 50]])[1]
    assert (
        f"(2 of 20 and 0 of 50 have more than 90: Fisher's p {fisher:.2f}, seen afterwards)"
        in words
    )


HUMANOID = EXPERIMENTS / "25_humanoid"


@pytest.fixture(scope="module")
def humanoid():
    """What the table script of 25_humanoid prints of each table: rows of cells by the first heading's cell,
    or by the heading above."""
    table, lines = script("25_humanoid/table"), io.StringIO()
    with contextlib.redirect_stdout(lines):
        table.main()
    found, title = {}, ""
    for block in lines.getvalue().strip().split("\n\n"):
        if not block.startswith("|"):
            title = block
            continue
        head, _, *rows = map(cells, block.splitlines())
        found[title or head[0] or head[1]] = rows
    return types.SimpleNamespace(table=table, printed=found)


def rows_on(page, heading=None):
    """Rows of the tables of a page of 25_humanoid, by their first cell; of a section alone."""
    text = (HUMANOID / f"{page}.md").read_text()
    if heading:
        text = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")]
    return {row[0]: row[1:] for row in lines if "---" not in row[0]}


def walks_in(text):
    """Lists of steps in a cell of walks: `2.58, 4.30; 2.70, never`."""
    return [part.split(", ") for part in text.split("; ")]


def test_the_tables_of_the_humanoid_are_those_of_its_runs(humanoid):
    """Ten seeds; what the model, and each part, is worth; how policies walk; the model's errors; what was
    tried before."""
    printed = humanoid.printed
    fresh = {tuple(row[:2]): row[2:] for row in printed["batch"]}
    page = rows_on("README", "Ten seeds")
    for label, key in (
        ("`best`", ("fresh", "`best`")),
        ("`ppo`", ("fresh", "`ppo`")),
        ("seeds 900 to 909: `best`", ("fresh-900", "`best`")),
        ("`ppo` with 8 minibatches", ("fresh-900", "`ppo`")),
    ):
        assert page.pop(label) == fresh[key], label
    assert len(page) == 1  # the head
    warp, own = fresh["fresh-warp", "`best`"], fresh["fresh-900", "`best`"]
    text = " ".join((HUMANOID / "README.md").read_text().split())
    assert f"after {warp[0]} M ({warp[1]}), on our kernel after {own[0].rstrip('0')}" in text
    runs = {row[0]: row[1:] for title in humanoid.table.PARTS for row in printed[title]}

    def agrees(name, walks, numbers):
        """`numbers`: m/s, rad/s and falls of the end; the script has more digits of each."""
        _, each, total, *ends = runs[name]
        bare, _, of = walks.partition(" in ")  # "never in 3.3 M"
        said = "never" if {*each.split(", ")} == {"never"} else each
        ends = [float(end.removesuffix(" %")) for end in ends]
        return bare == said and shows(numbers, *ends) and (not of or shows(of, float(total)))

    page = rows_on("README", "What the model is worth")
    for label, name in (
        ("the model, from the robots' last states", "control-last"),
        ("the simulator, from the last states, not counted", "control-simulator"),
        ("nothing, 5 epochs", "control-real4-5"),
        ("nothing, 15 epochs: as many updates", "control-real4-15"),
        ("24 real rows, 5 epochs", "control-real24-5"),
        ("24 real rows, 15 epochs", "control-real24-15"),
    ):
        assert agrees(name, *page.pop(label)), label
    assert page.pop("the model, from real rows drawn at random (`best`)") == [runs["whole"][1]]
    assert len(page) == 1
    page = rows_on("parts", "What each part is worth")
    for label, name in (
        ("`best`", "whole"),
        ("8 of 24 rows real", "real8"),
        ("16 real", "real16"),
        ("two rounds", "rounds2"),
        ("one round", "rounds1"),
        ("no clean states, and the critic sees what the actor sees", "no-clean"),
        ("the critic alone", "critic"),
        ("the reward is predicted as a whole", "no-known"),
        ("no symmetry", "no-symmetry"),
    ):
        assert agrees(name, *page.pop(label)), label
    assert page.pop("the model predicts no falls") == ["never", "all fall"]
    assert runs["no-falls"][1:] == ["never, never, never", "1.68", "nan", "nan", "100.0 %"]
    assert len(page) == 1
    errors = {
        row[0].partition(" (")[0]: row[1:] for row in printed["1, 4, 20 predictions in a row"]
    }
    assert rows_on("parts", "The model's error").items() >= errors.items() and len(errors) == 6
    gait = {row[0]: row[1:] for row in printed["policy"]}
    page = rows_on("gait", "Measures")
    assert page.pop("policy")[:2] == ["strides /s", "at 1 m/s"] and page == gait
    before = {row[0]: row[1:] for row in printed["What was tried before"]}
    before |= {"deploy-930": runs["deploy-930"]}
    page = rows_on("tried")
    assert page.pop("run") and page == {k: v for k, v in before.items() if k[:4] != "lap-"}


def test_the_grid_of_ppo_on_the_humanoid_is_that_of_its_runs(humanoid):
    """Each cell of walks, in the table's order: of the left columns, then of the right ones."""
    runs = {row[0]: row[2].split(", ") for row in humanoid.printed["PPO's settings"]}
    names = """r128 base+u-base r512 h12 r1024 r2048 r4096 r8192 mb2 mb8+u-mb8 u-mb12 u-mb16+u-mb24 u-mb8gam97
        v-p512mb8+v-p512mb12 v-p1024mb8+v-p1024mb12 v-p1024h12mb8 v-p2048mb8+v-p2048mb12ep3
        ep3 ep8+u-ep8 ep10+ep15 kl2+kl3+kl6 gam95+gam97 lam9+lam98 ent5 h16+u-h16 h32 u-h16mb8 u-h16gam97
        u-h16lam98 u-mb12ep3 u-mb12ep8 u-mb12kl3+u-mb12kl6 v-p1024mb8kl6+v-p1024mb8g97 v-p1024mb8ep3"""
    names = [
        [name if name[:2] in ("u-", "v-") else f"z-{name}" for name in cell.split("+")]
        for cell in names.split()
    ]
    text = (HUMANOID / "ppo.md").read_text()
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")][2:]
    shown = [row[1] for row in lines] + [row[3] for row in lines]
    assert {len(row) for row in lines} == {4}
    for mine, cell in zip(names, shown, strict=True):
        assert walks_in(cell) == [runs[name] for name in mine], mine
    assert sorted(sum(names, [])) == sorted(runs)
    assert {len(walks) for walks in runs.values()} <= {2, 4}


def test_the_tables_of_the_humanoid_for_hardware_are_those_of_its_files(humanoid):
    """Runs under disturbances by name; `--stress` of g1; what is said of g1_deploy and of five seeds."""
    runs = {row[0]: row[2:] for row in humanoid.printed["For hardware"]}
    checked = 0
    for label, row in rows_on("hardware", "For hardware").items():
        if found := re.match(r"`(\w+)`", label):
            walks, total, *ends = row[3:]
            all_walks, all_steps, *all_ends, _ = runs[found[1]]
            said = "never" if {*all_walks.split(", ")} == {"never"} else all_walks
            assert walks == said and shows(total, float(all_steps)), label
            for mine, value in zip(ends, all_ends, strict=True):
                assert shows(mine, float(value)), label
            checked += 1
    assert checked == 14
    rows = [row for row in humanoid.table.read("tuning.csv.xz") if row["name"] == "deploy-700"]
    steps, errors, yaw_errors, falls = humanoid.table.evaluations(rows)
    walks = stats.reached_by_tracking(steps, errors, yaw_errors, falls).walks
    page = " ".join((HUMANOID / "hardware.md").read_text().split())
    (at,) = {*walks}
    before = steps[steps[:, 0] < at][-1, 0]
    assert (
        f"after {at / 1e6:.1f} M steps, and none does at that before, after {before / 1e6:.1f} M"
        in page
    )
    assert f"{errors[-1].mean():.2f} m/s and {yaw_errors[-1].mean():.2f} rad/s off" in page
    assert not falls[-1].any() and f"tracks worst ({errors[-1].max():.3f} m/s)" in page
    assert errors[-1].argmax() == 2  # seed 702, which is bundled
    told = {}
    for name in ("stress", "stress_deploy"):
        told[name] = json.loads((HUMANOID / f"results/{name}.json").read_text())["rows"]
    mine = {x["stress"]: f"{x['falls']}; {x['tracking_error']:.2f}" for x in told["stress"]}
    text = (HUMANOID / "hardware.md").read_text().split("## Disturbances")[1]
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")][2:]
    shown = {row[k]: row[k + 1] for row in lines for k in (0, 2)}
    seen = []
    for label, names in (
        ("none; steps of 2 ms; other solvers and cones", None),
        ("actions, or sensors, 20 ms late", ["actions 20 ms late", "sensors 20 ms late"]),
        ("actions 0 to 40 ms late", ["actions 0 to 40 ms late"]),
        ("actions 40 ms late; both 20 ms late", ["actions 40 ms late", "both 20 ms late"]),
        ("noise of training", ["noise of training"]),
        ("steps of 10 ms", ["steps of 10 ms"]),
        ("friction 0.15, 0.3, 1.2", ["friction 0.15", "friction 0.3", "friction 1.2"]),
        ("5 kg more, less", ["5 kg more", "5 kg less"]),
        ("motors at 80, 120 %", ["motors at 80 %", "motors at 120 %"]),
        ("pushes of 0.5, 1 m/s", ["pushes of 0.5 m/s", "pushes of 1 m/s"]),
        ("its velocity read as zero, half", ["velocity read as zero", "velocity read as half"]),
        ("all together", ["all together"]),
    ):
        names = names or [
            "none",
            "steps of 2 ms",
            *(n for n in mine if "cone" in n or "solver" in n),
        ]
        asked = ", ".join(mine[name] for name in names)
        one = {mine[name] for name in names}
        assert shown.pop(label) in (asked, *(one if len(one) == 1 else ())), label
        seen += names
    assert not shown and sorted(seen) == sorted(mine)
    ours = {x["stress"]: x["falls"] for x in told["stress_deploy"]}
    assert len(ours) == 23 and {x: n for x, n in ours.items() if n} == {
        "pushes of 1 m/s": 1,
        "steps of 10 ms": 7,
    }
    rest = ours.keys() - {"pushes of 1 m/s", "steps of 10 ms"}
    fell = sum(x["falls"] for x in told["stress"] if x["stress"] in rest)
    assert f"falls {fell} times in these {len(rest)}" in page


def test_the_seconds_of_the_humanoid_are_those_of_its_runs(humanoid):
    """A row a line, from the runs alone on a card: where they walk, seconds, ms an iteration."""
    found = {}
    for engine, robots, seed, walks, seconds, ms in humanoid.printed["engine"]:
        found.setdefault((engine == "kernel", robots), {})[int(seed)] = walks, seconds, ms
    last = {}  # falls of the last evaluation, and after how many steps
    for engine, robots, rows in humanoid.table.runs_alone():
        told = f"{100 * float(rows[-1]['fall_rate']):.1f} %"
        steps = float(rows[-1]["sim_steps"]) / 1e6
        where = {(told, f"{steps:.{k}f} M") for k in (1, 2)} | {(told, "the end")}
        last.setdefault((engine == "kernel", robots), set()).update(where)
    page = rows_on("seconds", "Seconds")
    for label, own, name, seeds in (
        ("`best`, ten seeds (900 to 909)", True, "best", range(900, 910)),
        ("with 3 epochs and KL 0.04, seed 950", True, "best, 3 epochs", [950]),
        ("with 2 minibatches, seeds 950 to 954", True, "best, 2 minibatches", range(950, 955)),
        ("`ppo`, seeds 950, 951", True, "PPO, 256", [950, 951]),
        ("PPO, 8 minibatches, seed 900", True, "PPO, 512", [900]),
        ("PPO, 4 minibatches, seeds 900, 950, 951", True, "PPO, 1024", [900, 950, 951]),
        ("PPO, 12 rows, 8 minibatches, seeds 950 to 952", True, "PPO, 1024 x 12", range(950, 953)),
        ("the same, 3 epochs, seed 950", True, "PPO, 1024 x 12, 3 epochs", [950]),
        ("PPO, 12 rows, 8 minibatches, seed 950", True, "PPO, 2048 x 12", [950]),
        ("PPO, 4 minibatches, seed 900", True, "PPO, 4096", [900]),
        ("with MuJoCo Warp's own step: `best`, seeds 170 to 172", False, "best", range(170, 173)),
    ):
        some = [found[own, name][seed] for seed in seeds]
        _, walks, seconds, ms = page.pop(label)
        for falls, where in re.findall(r"([\d.]+ %) (?:falls )?at (the end|[\d.]+ M)", walks):
            assert (falls, where) in last[own, name], label
        for cell, column in ((walks, 0), (seconds, 1)):
            values = [run[column] for run in some if run[column] not in ("never", "-")]
            bare = re.sub(
                r"[\d.]+ % falls at (the end|[\d.]+ M)|; one falls .*|, -|; -|^-$", "", cell
            )
            bare = bare.strip(" ,;")
            ends = f"{min(values)} to {max(values)}" if values else ""
            once = [*dict.fromkeys(values)]
            assert bare in (ends, ", ".join(values), *(once if len(once) == 1 else ())), label
        assert shows(ms, np.mean([float(run[2]) for run in some])), label
    _, walks, seconds = page.pop("PPO, seed 170, evaluated two to five times: upper bounds")
    some = [found[False, f"PPO, {robots}"][170] for robots in (256, 512, 2048)]
    assert [walks, seconds] == ["; ".join(run[k] for run in some) for k in (0, 1)]
    assert len(page) == 1


def test_brax_gets_playgrounds_settings():
    """brax's trainer, with what JAX has removed put back; its state has an axis of devices."""
    pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")
    brax_ppo = script(f"{PLAYGROUND}/brax_ppo")
    placed = brax_ppo.replicated({"a": np.arange(3.0), "b": 2}, jax.local_devices()[:1])
    assert placed["a"].shape == (1, 3) and placed["b"].shape == (1,)
    np.testing.assert_array_equal(jax.pmap(lambda x: 2 * x)(placed["a"])[0], [0, 2, 4])
    whole = brax_ppo.asked("Go1JoystickFlatTerrain")
    assert (whole.num_timesteps, whole.num_envs, whole.num_evals) == (200_000_000, 8192, 10)
    assert (whole.batch_size, whole.num_minibatches, whole.num_resets_per_eval) == (256, 32, 10)
    few = brax_ppo.asked("Go1JoystickFlatTerrain", 640, 8, 2)
    assert (few.num_timesteps, few.num_envs, few.num_evals) == (640, 8, 3)
    assert few.batch_size * few.num_minibatches == 8
    # a robot is reset after as many steps of its own: 271 in Playground's
    assert brax_ppo.control_steps(whole) == pytest.approx(271, abs=1)
    for evals, resets in ((90, 1), (45, 2), (18, 5), (9, 10), (3, 30)):
        other = brax_ppo.asked("Go1JoystickFlatTerrain", evals=evals)
        assert other.num_resets_per_eval == resets
    half = brax_ppo.asked("Go1JoystickFlatTerrain", steps=100_000_000, evals=9)
    assert half.num_resets_per_eval == 5
    assert brax_ppo.asked("Go1Getup", evals=10, resets=1).num_resets_per_eval == 1
    assert brax_ppo.asked("G1JoystickFlatTerrain", evals=10).num_resets_per_eval == 2


LESS = EXPERIMENTS / "21_less"


def test_a_run_tells_what_its_task_has():
    """Errors of a task with commands of ours, none of Playground's; on rough ground the curriculum's row."""
    measured, ones = script("21_less/run").measured, np.ones(2)
    evaluated = {"return": 3 * ones, "return_std": ones, "length": ones, "fall_rate": 0 * ones}
    found = measured(evaluated, {"reward": np.ones((4, 2))})
    assert list(found) == ["return", "fall_rate"] and list(found["return"]) == [3, 3]
    errors = {"yaw_error": ones, "tracking_error": ones}
    rows = {"terrain_row": np.array([[0.0, 1.0], [1.0, 4.0]])}
    found = measured(evaluated | errors, rows)
    assert list(found) == ["return", "fall_rate", "tracking_error", "yaw_error", "terrain_row"]
    assert list(found["terrain_row"]) == [0.5, 2.5]
    assert measured({"return": 3.0}, {"terrain_row": np.ones(4)})["terrain_row"].shape == (1,)


RUNS = {
    "**`best`**": "best",
    "PPO": "ppo",
    "PPO, to the level": "ppo-level",
    "PPO, to walk": "ppo-walk",
}
LOW_FEET = {"**`best`**": "best", "PPO, same task": "ppo-task", "PPO, as before": "ppo"}
OLDER = {  # rows of the table of older runs -> names in fresh.csv.xz
    "`best` of then": "new",
    "PPO, tuned": "ppo-kl3",
    "PPO, 24 rows, 512 robots": "ppo-512x24",
    "PPO, 24 rows, 1024 robots": "ppo-1024x24",
    "PPO, 24 rows, 2048 robots": "ppo-2048x24",
    "PPO, 16 rows, 1024 robots": "ppo-1024x16",
    "PPO, 32 rows, 1024 robots": "ppo-1024x32",
    "PPO-16": "ppo16",
    "PPO-24": "ppo24",
}
LETTERS = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}


def cells(line):
    """Of a row of a Markdown table, without bold."""
    return [cell.strip() for cell in line.replace("**", "").strip("| ").split("|")]


def rows_of(page, names, columns):
    """Rows of tables with so many columns: `name in the results -> cells`, from what the page calls it."""
    names, found = {name.replace("**", ""): known for name, known in names.items()}, {}
    for line in page.splitlines():
        robot, _, what = cells(line)[0].partition(", ")
        if robot in LETTERS and what in names and len(cells(line)) == columns:
            assert found.setdefault(f"{names[what]}-{LETTERS[robot]}", cells(line)[1:])
    return found


@functools.cache
def less(name):
    """The table script of 21_less, and a packed file of its runs."""
    table = script("21_less/table")
    return table, table.read(LESS / f"results/{name}.csv.xz")


def test_the_tables_of_the_headline_are_those_of_its_runs():
    """Steps until it walks and to levels, falls; at equal steps; ratios; while the model writes tails."""
    (table, jobs), page = less("headline"), (LESS / "tables.md").read_text()
    assert {len(table.seeds(job)) for job in jobs.values()} == {10}
    found = rows_of(page, RUNS, 11)
    assert found.keys() == jobs.keys() and len(jobs) == 16
    for name, mine in found.items():
        first, fell = steps_and_falls(table, name, jobs[name])
        assert mine == [*first[:2], fell[1], first[2], fell[4], *first[5:]], name
    front = (LESS / "README.md").read_text()
    steps, beside = rows_of(page, RUNS, 5), rows_of(front, RUNS, 8)
    millions = (0.6, 1, 2, table.seeds(jobs["ppo-g"])[0][-1]["sim_steps"] / 1e6)
    assert {
        row[0]: row[1:] for row in map(cells, table.at(jobs, millions).splitlines()[2:])
    } == steps
    lines = map(cells, table.beside(jobs).splitlines()[2:])
    assert {row[0]: row[1:] for row in lines} == beside and len(beside) == 12
    short = {name: [*full[:3], steps[name][-1]] for name, full in found.items()}
    assert rows_of(front, RUNS, 5) == short  # the page's own table is of these columns
    mine = {f"best-{letter}": jobs[f"best-{letter}"] for letter in LETTERS.values()}
    phases = [cells(line)[1:] for line in table.phases(mine).splitlines()[2:]]
    falls = (LESS / "falls.md").read_text()
    shown = [cells(line) for line in falls.splitlines() if cells(line)[0] in LETTERS]
    assert [row[1:] for row in shown if len(row) == 6] == phases


def steps_and_falls(table, name, job):
    """The cells of a job in the table of steps, from `walks` on, and in that of falls."""
    steps = table.table({name: job}, table.best(job)).splitlines()[2]
    return cells(steps)[2:], cells(table.falls({name: job}).splitlines()[2])[1:]


def test_what_an_average_of_the_policys_weights_is_worth_is_as_the_page_says():
    words = " ".join((LESS / "falls.md").read_text().split())
    with (LESS / "results/averaged.csv").open(newline="") as file:
        rows = {
            (row["seed"], int(row["sim_steps"]), row["kept"]): row for row in csv.DictReader(file)
        }
    ends = [max(steps for seed, steps, _ in rows if seed == one) / 1e6 for one in "01"]
    assert "after {:.2f} and {:.2f} M steps".format(*ends) in words
    less = [
        float(rows[seed, steps, "0"]["return"]) - float(row["return"])
        for (seed, steps, kept), row in rows.items()
        if kept == "0.93" and 4e5 < steps < 6.6e5
    ]
    told = (
        f"From 0.4 to 0.65 M the average with 0.93 returns {min(less):.1f} to {max(less):.1f} less"
    )
    assert told in words
    late = {
        kept: 100
        * np.mean([float(x["fall_rate"]) for k, x in rows.items() if k[2] == kept and k[1] > 7e5])
        for kept in ("0", "0.8", "0.93")
    }
    assert sum(k[1] > 7e5 for k in rows) == 3 * 5 and {k[0] for k in rows if k[1] > 7e5} == {"0"}
    told = "fall in {:.1f} and {:.1f} % of the episodes, the policy itself in {:.1f}: five"
    assert told.format(late["0.8"], late["0.93"], late["0"]) in words


def test_what_the_page_says_of_feet_that_are_not_lifted_is_so():
    """The table, the factors of then, and what the weight costs, runs evaluated as seldom as then."""
    (table, old), page = less("low_feet"), (LESS / "task.md").read_text()
    found = rows_of(page, LOW_FEET, 6)
    assert found.keys() == old.keys() and len(old) == 12
    for name, mine in found.items():
        first, fell = steps_and_falls(table, name, old[name])
        assert mine == [*first[:2], fell[1], *first[-3:-1]], name
    page = " ".join(page.split())
    walk = {
        name: sum(np.isfinite(ours_of(f"{name}-{x}", "low_feet").walks).sum() for x in "cd")
        for name in LOW_FEET.values()
    }
    assert f"{walk['ppo-task']} of 20 seeds walk with it, {walk['ppo']} of 20 without" in page
    rows = {cells(line)[0]: cells(line)[1] for line in table.beside(old).splitlines()[2:]}
    then = [rows[f"ppo-{x}"].split()[0] for x in "ghcd"]
    assert "larger: {}, {}, {} and {}.".format(*then) in page
    _, new = less("headline")

    def steps(name):
        """Of the newer runs, at the evaluations that the older ones had, too."""
        runs = [
            [r for r in run if r["iteration"] <= 200 or r["iteration"] % 50 == 0]
            for run in table.seeds(new[name])
        ]
        return table.reached(runs, 38 if name[-1] in "gh" else 24)

    best, ppo = (
        [stats.ratio(steps(n).level, ours_of(n, "low_feet").level) for n in names]
        for names in ([f"{run}-{x}" for x in "ghcd"] for run in ("best", "ppo"))
    )
    cost = [f"{one.value:.2f} ({one.low:.2f} to {one.high:.2f})" for one in best]
    assert "{}, {}, {} and {} times those without".format(*cost) in page
    assert "{:.2f}, {:.2f}, {:.2f} and {:.2f} times".format(*(one.value for one in ppo)) in page
    walks = [steps(f"best-{x}").walks / 1e6 for x in "ghcd"]
    each = [f"{some.mean():.2f} ({some.max():.2f})" for some in walks]
    assert "as seldom as then {}, {}, {} and {} M".format(*each) in page
    older = (np.nan_to_num(ours_of(f"best-{x}", "low_feet").walks, nan=np.inf) for x in "ghcd")
    p = [stats.rank_sum(1e6 * a, b) for a, b in zip(walks, older, strict=True)]
    assert "p {:.2f}, {:.2f}, {:.1f} and {:.2f})".format(*p) in page
    lost = []
    for name in ("best-g", "best-h", "best-c", "best-d"):
        end = table.seeds(new["ppo-g"])[0][-1]["sim_steps"]
        some = stats.difference(*(table.between(jobs[name], end, "return") for jobs in (old, new)))
        interval = f" ({some.low:.1f} to {some.high:.1f})" if some.low > 0 else ""
        lost.append(f"{some.value:.1f}{interval}")
    assert "{}, {}, {} and {} lower".format(*lost) in page
    after = stats.difference(*(table.phase(jobs["best-d"])[:, 3] for jobs in (new, old)))
    assert f"{after.value:.2f} points ({after.low:.2f} to {after.high:.2f})" in page


def test_the_table_of_older_runs_is_that_of_its_runs():
    (table, jobs), page = less("fresh"), (LESS / "history.md").read_text()
    found = rows_of(page, OLDER, 6)
    assert len(found) == 24
    for name, mine in found.items():
        row = cells(table.table({name: jobs[name]}, table.best(jobs[name])).splitlines()[2])
        assert mine == [*row[2:4], *row[9:]], name


def test_the_tables_of_controls_are_those_of_their_runs(monkeypatch, capsys):
    """What writes a tail, today and before feet were lifted, and each part taken out: as printed."""
    page = (LESS / "model.md").read_text()
    monkeypatch.setattr(sys, "argv", ["table.py", str(LESS / "results/ablation.csv.xz"), "--model"])
    script("21_less/table").main()
    printed = capsys.readouterr().out.strip().split("\n\n")
    assert [len(table.splitlines()) - 2 for table in printed] == [5, 4, 14]
    assert all(f"\n\n{table}\n\n" in page for table in printed)


def test_what_the_page_of_controls_says_is_so():
    """Ratios to `best`, 20 real rows, falls with tails; with fewer episodes `best` walks no sooner."""
    (table, head), rng = less("headline"), np.random.default_rng(0)
    page = " ".join((LESS / "model.md").read_text().split())

    def of(batch, name):
        jobs = table.read(LESS / "results/ablation.csv.xz", batch)
        return [jobs[f"control-{name}-{x}"] for x in LETTERS.values()]

    def reached(jobs):
        return [table.reached(table.seeds(x), table.walks.level(table.best(x))) for x in jobs]

    def falls(jobs):
        return "{:.2f}, {:.2f}, {:.2f} and {:.2f}".format(
            *(table.phase(job)[:, 0].mean() for job in jobs)
        )

    short = [
        [row for row in head[f"best-{x}"] if row["iteration"] <= table.LAST]
        for x in LETTERS.values()
    ]
    best, simulator = reached(short), reached(of("3", "simulator"))
    found = [stats.ratio(a.level, b.level) for a, b in zip(simulator, best, strict=True)]
    text = "{:.2f} (95 %: {:.2f} to {:.2f}), {:.2f} ({:.2f} to {:.2f}), {:.2f} ({:.2f} to {:.2f})"
    text += " and {:.2f} ({:.2f} to {:.2f}) times the steps"
    assert text.format(*np.ravel(found)) in page
    p = [stats.rank_sum(a.level, b.level) for a, b in zip(simulator, best, strict=True)]
    assert "p {:.2f}, {:.2f}, {:.4f} and {:.3f})".format(*p) in page
    p = [stats.rank_sum(a.walks, b.walks) for a, b in zip(simulator, best, strict=True)]
    assert "p {0:.3f}, {2:.3f} and {3:.4f}, by Holm".format(*p) in page
    assert f"(p {p[1]:.2f})" in page and stats.holm(p)[[0, 2, 3]].max() < 0.0041
    assert f"in {falls(of('3', 'simulator'))} % of the episodes with the simulator" in page
    assert f"in {falls([head[f'best-{x}'] for x in LETTERS.values()])} % with" in page
    older = falls(of("2", "simulator")), falls(of("2", "last"))
    assert "fall in {} % of the episodes instead of {}.".format(*older) in page
    for job, whole in zip(short, best, strict=True):  # 200 of the 1000 episodes
        walks = []
        for _ in range(20):
            fell = rng.hypergeometric(
                many := [round(1000 * row["fall_rate"]) for row in job],
                1000 - np.array(many),
                200,
            )
            some = [row | {"fall_rate": x / 200} for row, x in zip(job, fell, strict=True)]
            walks.append(np.nan_to_num(reached([some])[0].walks, nan=job[-1]["sim_steps"]).mean())
        whole = np.nan_to_num(whole.walks, nan=job[-1]["sim_steps"]).mean()
        assert np.mean(walks) > 0.99 * whole
    real, epochs = reached(of("3", "real20-5")), reached(of("3", "real20-15"))
    times = [stats.share(a.level, b.level, 4.096e6, 0) for a, b in zip(real, best, strict=True)]
    text = (
        "needs {0:.1f} (Go1), {2:.1f} and {3:.1f} times (ANYmals) the steps of `best` to the level,"
    )
    text += " a Go2 at least {1:.1f} times"
    assert text.format(*(cells["pct"] / 100 for cells in times)) in page
    assert times[1]["bound"] == "at least"
    later = [np.mean(a.level - b.level) / 1e6 for a, b in zip(epochs, real, strict=True)]
    assert "by {:.2f} and {:.2f} M (rank tests, p 0.008 each)".format(*later[2:]) in page
    p = [stats.rank_sum(a.level, b.level) for a, b in zip(epochs, real, strict=True)]
    np.testing.assert_allclose(p, [0.67, 0.14, 0.008, 0.008], atol=5e-3)
    never = [[int(np.isnan(x.level).sum()) for x in some] for some in (epochs, real)]
    assert never == [[2, 3, 0, 0], [0, 1, 0, 0]]
    rows = table.seeds(of("3", "real4-15")[0])[0][-1]["sim_steps"]
    assert [round(rows / x.level.mean()) for x in best] == [9, 7, 7, 7]
    last, then = reached(of("2", "last")), reached(of("2", "simulator"))
    found = [b.level.mean() / a.level.mean() for a, b in zip(last, then, strict=True)]
    text = (
        "need {:.2f} and {:.2f} times the steps to the level on Go1 and Go2, {:.2f} and {:.2f} on"
    )
    assert text.format(*found) in page


def test_the_page_of_results_has_the_numbers_of_both():
    page = (ROOT / "docs/results.md").read_text()
    runs = {
        "`best`": "best",
        "PPO alone, to the level *": "ppo-level",
        "PPO alone, to walk †": "ppo-walk",
    }
    older = {"PPO-16, 4096 robots, older": "ppo16", "PPO-24, 4096 robots, older": "ppo24"}
    rows = [cells(line) for line in page.splitlines() if cells(line)[0] in LETTERS]
    assert len(rows) == 20
    for robot, what, *mine in rows:
        table, jobs = less("headline" if what in runs else "fresh")
        job = jobs[f"{(runs | older)[what]}-{LETTERS[robot]}"]
        row = cells(table.table({"": job}, table.best(job)).splitlines()[2])[-11:]
        total, fell = re.fullmatch(r"(.*) ± .*, (.* %)", row[9]).groups()
        end = f"{total} of {table.best(job)}, {row[8]}"
        assert mine == [row[1], row[2], end, fell, f"{float(row[10]):.2f} m/s"], (robot, what)


def test_the_table_of_what_was_tried_for_fewer_falls_is_that_of_its_runs():
    (table, jobs), page = less("falls"), (LESS / "falls.md").read_text()
    names = {name[:-2] for name in jobs}
    rows = [
        cells(line) for line in page.splitlines() if cells(line)[1:2] and cells(line)[1] in names
    ]
    assert rows
    # of batches 7 to 9, with ten seeds each, every setting has a row
    late = {name[:-2] for name, job in jobs.items() if job[0]["batch"] in "789"}
    assert late <= {row[1] for row in rows}
    assert {len(table.seeds(jobs[n])) for n in jobs if n[:-2] in late} == {10} and len(late) == 23
    for _, name, *mine in rows:
        keys = [f"{name}-{letter}" for letter in LETTERS.values()]
        found = [table.part(jobs[key]).replace("**", "") if key in jobs else "" for key in keys]
        assert mine + [""] * (4 - len(mine)) == found, name


def test_what_the_page_says_of_falls_is_so():
    """Ranges while tails are used, what physics alone leaves, and differences with p, by Welch."""
    table, jobs = less("falls")
    page = " ".join((LESS / "falls.md").read_text().split())
    found: dict[str, list] = {letter: [] for letter in "ghcd"}
    for name, job in jobs.items():
        if job[0]["batch"] in "789" and np.isfinite(phase := table.phase(job).mean(0)).all():
            found[name[-1]].append(phase)
    tails = {letter: np.array(some)[:, 0] for letter, some in found.items()}
    legs = np.concatenate([tails["g"], tails["h"]])
    heavy = np.concatenate([tails["c"], tails["d"]])
    assert f"less than {legs.min():.1f} % falls from iteration 70 on on Go1 or Go2" in page
    assert f"or more than {legs.max():.1f} %" in page
    assert f"have {heavy.min() - 0.05:.1f} to {heavy.max():.1f} %" in page
    means = {letter: np.mean(some, 0) for letter, some in found.items()}
    for top, below, text in (
        (2, 1, "leave {} to {} % of the falls of the last"),
        (2, 0, "and {} to {} % of the mean with tails"),
        (3, 0, "thirty leave {} to {} % of that"),
    ):
        shares = [100 * mean[top] / mean[below] for mean in means.values()]
        assert text.format(round(min(shares)), round(max(shares))) in page

    def difference(one, other, what):
        def values(job):
            if what == "return":
                return table.between(job, 1.5e6, "return")
            if what == "falls at 1.5 M":
                return 100 * table.between(job, 1.5e6, "fall_rate")
            return table.phase(job)[:, 0 if what == "tails" else 4]

        pair = [values(jobs[name]) for name in (one, other)]
        return stats.difference(*pair).value, stats.welch_of(*pair)

    early = [difference(f"L60ep125C-{x}", f"K1ep125C-{x}", "return") for x in "ghd"]
    assert max(p for _, p in early) < 0.004
    assert (
        f"{-max(early)[0]:.1f} to {-min(early)[0]:.1f} lower if it begins at iteration 60" in page
    )
    more, p = difference("L60ep125C-h", "K1ep125C-h", "falls at 1.5 M")
    assert f"Go2 falls {more:.1f} points more, p {p:.3f}" in page
    later = [difference(f"K1L110ep75C-{x}", f"K1ep75C-{x}", "return") for x in "ghcd"]
    text = f"{-max(later)[0]:.1f} to {-min(later)[0]:.1f} lower if at 110 (1.5 s; p {later[0][1]:.2f}, "
    assert text + ", ".join(f"{p:.2f}" for _, p in later[1:]) + ")" in page
    more = [difference(f"K1L110ep75C-{x}", f"K1ep75C-{x}", "falls at 1.5 M") for x in "gh"]
    text = "(+{:.1f} and +{:.1f} points, p {:.1f} and {:.1f}: not shown)"
    assert text.format(*(value for value, _ in more), *(p for _, p in more)) in page
    short = [
        difference(f"{kind}ep75C-{x}", f"{kind}ep125C-{x}", "after")
        for kind, letters in (("S1", "cd"), ("base", "d"), ("K1", "cd"))
        for x in letters
    ]
    text = "by {:.2f} points (p {:.3f}; C) and {:.2f} ({:.3f}; D) with S1, {:.2f} ({:.2f}; D) with KL 0.02, "
    numbers = [abs(number) for pair in short for number in pair]
    assert text.format(*numbers[:6]) in page
    last = [numbers[6], numbers[8], numbers[7], numbers[9]]
    assert "{:.2f} and {:.2f} ({:.2f}, {:.1f}) with K1".format(*last) in page
    halved = [
        difference(f"K1ep125C-{x}", f"baseep125C-{x}", w) for x in "ghd" for w in ("tails", "after")
    ]
    text = f"({min(halved)[0]:.1f} to {max(halved)[0]:.1f} points with tails or after, p "
    assert text + f"{min(p for _, p in halved):.2f} at least" in page
    for one, other, text in (
        ("K1ep125C", "baseep125C", "costs {:.1f} to {:.1f} of return at 1.5 M (p {:.2f} on Go1)"),
        ("K2ep75C", "K1ep75C", "KL 0.005 costs {:.1f} to {:.1f} (p {:.3f} at most)"),
    ):
        pairs = [difference(f"{one}-{x}", f"{other}-{x}", "return") for x in "ghd"]
        p = pairs[0][1]
        assert text.format(-max(pairs)[0], -min(pairs)[0], p) in page
        assert "at most" not in text or p == max(p for _, p in pairs)
    memory = ("M10a5", "M40a5", "M40a0r3", "M80a5r3", "M40a5r3L100")
    pairs = [(f"{n}-{x}", f"K1ep125C-{x}") for n in memory for x in "ghcd" if f"{n}-{x}" in jobs]
    lower = [
        (one, *found)
        for one, other in pairs
        if (found := difference(one, other, "tails"))[1] < 0.05
    ]
    ((name, value, p),) = lower
    assert name == "M40a0r3-h"
    text = f"One of {len(pairs)} comparisons of falls with tails is lower (Go2, 40 iterations, three for "
    assert text + f"one: {value:.1f} points, p {p:.3f})" in page
    value, p = difference("M40a0r3-d", "K1ep125C-d", "after")
    assert f"ANYmal-D more ({value:+.1f}, p {p:.2f})" in page
    steps = {}
    for pair in pairs:
        steps[pair] = [
            table.reached(table.seeds(jobs[n]), 38 if n[-1] in "gh" else 24).walks for n in pair
        ]
    assert f"p {min(stats.rank_sum(*two) for two in steps.values()):.2f} at least" in page
    early = {}
    for letter in "ghd":
        rows = [r for r in jobs[f"S1-{letter}"] if 0.6e6 <= r["sim_steps"] <= 1.9e6]
        fell = sum(r["fall_rate"] for r in rows)
        early[letter] = 100 * sum(r["early"] for r in rows if np.isfinite(r["early"])) / fell
    assert f"{early['d']:.0f} % of ANYmal-D's falls come in the first two seconds" in page
    assert f"{early['g']:.0f} % of Go1's, {early['h']:.0f} % of Go2's" in page
    last = [
        np.nanmax(table.reached(table.seeds(jobs[f"S1-{x}"]), 38 if x in "gh" else 24).walks) / 1e6
        for x in "ghd"
    ]
    assert "after {:.1f} (Go1), {:.1f} (Go2) and {:.1f} M (ANYmal-D)".format(*last) in page
    worse, p = difference("S1ep125C-c", "S1ep125B-c", "after")
    assert (
        f"ANYmal-C {worse:.1f} points more than with half, a quarter, a quarter, p {p:.2f}" in page
    )


def test_runs_of_two_batches_are_not_one_and_other_settings_of_a_name_are_apart(tmp_path):
    table = script("21_less/table")
    text = "batch,name,job,seed,sim_steps,return,fall_rate,early\n"
    text += "1,a-g,go1:best run.num_seeds=5 x=1,0,10,30,0.1,0.5\n2,a-g,go1:best x=1,0,10,40,0.1,\n"
    text += "3,a-g,go1:best x=2,0,10,50,0.1,\n"
    (tmp_path / "runs.csv.xz").write_bytes(lzma.compress(text.encode()))
    jobs = table.read(tmp_path / "runs.csv.xz")
    returns = {
        n: [[r["return"] for r in run] for run in table.seeds(job)] for n, job in jobs.items()
    }
    assert returns == {"a-g": [[30], [40]], "a-g of batch 3": [[50]]}
    assert np.isnan(jobs["a-g"][1]["early"])  # an empty cell


def test_a_robot_stays_from_the_evaluation_on_after_which_none_is_bad():
    reached = script("21_less/table").reached
    ends = ((39.0, 0.0), (41.0, 0.02), (37.9, 0.0), (38.0, 0.01), (42.0, 0.03))
    run = [{"return": a, "fall_rate": b, "sim_steps": 10.0 * i} for i, (a, b) in enumerate(ends)]

    def stays(rows, level, most):
        return reached([rows], level, most=most).walks[0]

    assert [stays(run, 38, most) for most in (1, 0.03)] == [30, 30]
    assert np.isnan(stays(run, 38, 0.01)) and np.isnan(stays(run, 43, 1))
    assert (stays(run[:4], 38, 0.01), stays(run[:4], 37, 0.02)) == (30, 0)


def test_the_readmes_table_says_what_the_runs_did():
    """Steps until it walks, and until it is first at its level; falls; PPO-16 of 14_efficiency; the end."""
    (table, jobs), page = less("headline"), (ROOT / "README.md").read_text()
    with (EXPERIMENTS / "14_efficiency/results.csv").open(newline="") as file:
        efficiency = list(csv.DictReader(file))
    for robot, label in (
        ("go1", "Go1"),
        ("go2", "Go2"),
        ("anymal_c", "ANYmal-C"),
        ("anymal_d", "ANYmal-D"),
    ):
        mine, ppo, to_walk = (
            jobs[f"{name}-{LETTERS[label]}"] for name in ("best", "ppo-level", "ppo-walk")
        )
        level = script("14_efficiency").LEVEL[robot]
        ours, theirs, walking = (
            table.reached(table.seeds(job), level) for job in (mine, ppo, to_walk)
        )
        assert not np.isnan([*ours.level, *theirs.level]).any()
        falls = 100 * np.mean([table.first(run, level, "fall_rate") for run in table.seeds(mine)])
        sixteen = paper.pick(efficiency, robot=robot, threshold="evaluated", variant="ppo16")
        assert sixteen["success_rate_pct"] == "100"
        mine_walk, walk = (np.isfinite(one.walks).sum() for one in (ours, walking))
        last = cells(table.table({"": mine}, table.best(mine)).splitlines()[2])[-2]
        end = re.sub(" ± [^,]*", f" of {table.best(mine)}", last)
        found = [
            f"{np.nanmean(ours.walks) / 1e6:.2f} ({np.nanmax(ours.walks) / 1e6:.2f}"
            + (f"; {mine_walk} of 10)" if mine_walk < 10 else ")"),
            f"{np.nanmean(walking.walks) / 1e6:.1f}" + (f" ({walk} of 10)" if walk < 10 else ""),
            f"{ours.level.mean() / 1e6:.2f}, {falls:.1f} %",
            f"{theirs.level.mean() / 1e6:.1f}",
            f"{float(sixteen['sim_steps_M_mean']):.1f}",
            end,
        ]
        line = next(line for line in page.splitlines() if line.startswith(f"| {label} "))
        plain = line.replace(" seeds)", ")").replace(" % falls", " %")
        assert cells(plain) == [label, *found]
        ratio = float(sixteen["sim_steps_M_mean"]) * 1e6 / ours.level.mean()
        assert 47 < ratio < 57  # "about a fiftieth"
        less_than = theirs.level.mean() / ours.level.mean()
        assert round(less_than) == (4 if robot.startswith("go") else 3)  # "a quarter", "a third"
        columns = paper.sim_steps(
            f"configs/{robot}.py:best", 150 if robot.startswith("go") else 110
        )
        assert columns < 0.1 * mine[-1]["sim_steps"]  # "over 90 % of them without the model"
    text = " ".join(page.split())
    first, walks = (np.mean(x) / 1e6 for x in (ours_of("best-g").level, ours_of("best-g").walks))
    assert f"commands after {first:.2f} million" in text and f"after {walks:.2f} million" in text
    steps = [np.mean(ours_of("ppo-level-g").level), np.nanmean(ours_of("ppo-walk-g").walks)]
    steps = [x / 1e6 for x in steps]
    text = " ".join(text.split())
    assert (
        "needs {:.1f} million to follow commands and {:.1f} million to walk".format(*steps) in text
    )


def reached_of(job, level):
    """Steps of each seed to a return."""
    table, _ = less("ppo")
    return table.reached(table.seeds(job), level).level


def ours_of(name, results="headline"):
    """Steps of a job of the headline, or of another file."""
    table, jobs = less(results)
    return table.reached(table.seeds(jobs[name]), 38 if name[-1] in "gh" else 24)


def test_at_equal_steps_and_in_ratios_the_headline_is_as_its_page_says():
    """The shipped tables, against NumPy and `stats` on the rows of the file."""
    table, jobs = less("headline")

    def column(name, what, at):
        out = []
        for seed in range(990, 1000):
            rows = [row for row in jobs[name] if row["seed"] == seed]
            (before,) = [r for r in rows if r["sim_steps"] <= at][-1:]
            (after,) = [r for r in rows if r["sim_steps"] >= at][:1]
            span = after["sim_steps"] - before["sim_steps"]
            share = (at - before["sim_steps"]) / span if span else 0.0
            out.append(before[what] + share * (after[what] - before[what]))
        return np.array(out)

    end = table.seeds(jobs["ppo-g"])[0][-1]["sim_steps"]
    rows = {cells(line)[0]: cells(line)[1:] for line in table.beside(jobs).splitlines()[2:]}
    for letter in "ghcd":
        row = rows[f"ppo-{letter}"]
        for place, what, at, scale in (
            (2, "return", 2e6, 1),
            (3, "return", end, 1),
            (5, "fall_rate", 2e6, 100),
            (6, "fall_rate", end, 100),
        ):
            pair = [scale * column(f"{run}-{letter}", what, at) for run in ("best", "ppo")]
            found = stats.difference(*pair)
            assert row[place] == f"{found.value:+.1f} ({found.low:.1f} to {found.high:.1f})"
        pair = [column(f"{run}-{letter}", "return", end) for run in ("best", "ppo")]
        p = stats.equivalence(*pair, 1.0 if letter in "gh" else 0.7)
        assert row[4] == f"{p:.1g}" and (p < 0.05) == (letter != "d")  # "equal within 1.0 (0.7)"
        one, other = (ours_of(f"{run}-{letter}") for run in ("ppo", "best"))
        found = stats.ratio(one.level, other.level)
        assert row[0] == f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"
        if np.isnan(other.walks).any():
            assert row[1] == f"`best`: {np.isnan(other.walks).sum()} never"
        elif np.isnan(one.walks).any():
            least = np.where(np.isnan(one.walks), end, one.walks).mean() / other.walks.mean()
            assert row[1] == f"at least {least:.1f}"
        else:
            found = stats.ratio(one.walks, other.walks)
            assert row[1] == f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"


def test_what_the_page_says_of_the_goal_and_of_single_seeds_is_so():
    front, page = (" ".join((LESS / n).read_text().split()) for n in ("README.md", "falls.md"))
    alone = {"g": 0.65e6, "h": 0.65e6, "c": 0.49e6, "d": 0.49e6}  # from there on
    late = {x: (~(ours_of(f"best-{x}").walks <= at)).sum() for x, at in alone.items()}
    assert late == {"g": 5, "h": 3, "c": 2, "d": 7}
    assert "so 5 Go1 and 3 Go2 of 10 do not walk before physics alone begins" in page
    assert "nor do 2 ANYmal-C and 7 ANYmal-D" in page
    assert f"So {sum(late.values())} of the 40 seeds do not walk before the simulator" in front
    ends = {x: ours_of(f"best-{x}").walks / 1e6 for x in "ghcd"}
    met = [x for x, some in ends.items() if some.mean() <= 0.6 and some.max() <= 1.0]
    assert met == ["c"] and ends["h"].mean() < 0.6 and ends["h"].max() > 1.0
    assert "It is met on ANYmal-C. Go2 misses it by its last seed (1.06 M)" in front
    assert np.isfinite([*ends.values()]).all() and "all 40 runs walk" in front
    second = [np.sort(ends[x])[-2] for x in "gd"]
    assert f"Nine of ten Go1 walk by {second[0]:.2f} M" in front
    assert f"Nine of ten ANYmal-D walk by {second[1]:.2f} M" in front
    text = "a Go1 walks after {:.2f} M simulator steps, a Go2 after {:.2f} M, "
    text += "ANYmal-C and -D after {:.2f} and {:.2f} M"
    assert text.format(*(some.mean() for some in ends.values())) in front
    level = [ours_of(f"best-{x}").level.mean() / 1e6 for x in "ghcd"]
    assert "after {:.2f}, {:.2f}, {:.2f} and {:.2f} M steps".format(*level) in front
    theirs = [ours_of(f"ppo-walk-{x}").walks / 1e6 for x in "ghcd"]
    text = "walks after {:.1f}, {:.1f}, {:.1f} and {:.1f} M, and {} of its 40 runs do not within"
    assert text.format(*map(np.nanmean, theirs), np.isnan(theirs).sum()) in front
    table, jobs = less("headline")
    last, late = (table.seeds(jobs[f"best-{x}"])[np.argmax(ends[x])] for x in "gd")
    some = [r["fall_rate"] for r in last if 0.8e6 < r["sim_steps"] < 5.4e6]
    assert (min(some), max(some)) == (0.002, 0.029) and some[-1] > 0.01
    assert "falls in 0.2 to 2.9 % of its episodes from 0.8 to 5.4 M" in front
    (bad,) = [r for r in late if r["sim_steps"] > 0.44e6 and r["fall_rate"] > 0.01]
    assert bad["fall_rate"] == 0.012 and f"{bad['sim_steps'] / 1e6:.1f}" == "4.6"
    assert "has 1.2 % at a single evaluation, at 4.6 M" in front
    table, jobs = less("low_feet")
    spread = [
        np.mean(
            [
                np.std([r["fall_rate"] for r in run if 70 <= r["iteration"] <= 150], ddof=1)
                for run in table.seeds(jobs[f"best-{x}"])
            ]
        )
        for x in "gh"
    ]
    assert "deviation {:.1f} and {:.1f} points".format(*(100 * s for s in spread)) in page


def test_the_table_of_feet_lifted_by_and_by_is_that_of_its_runs():
    """22_deploy: falls and returns of tuning.csv.xz, clearance and benchmark of ramp.txt; a laptop's run."""
    folder, runs = EXPERIMENTS / "22_deploy", {}
    with lzma.open(folder / "tuning.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] in ("heights", "ramp"):
                at = runs.setdefault((row["name"], int(row["iteration"])), [])
                at.append((100 * float(row["fall_rate"]), float(row["return"])))
    printed = (folder / "ramp.txt").read_text()
    page = (folder / "feet.md").read_text()
    part = page.split("## Higher feet, by and by")[1].split("\n## ")[0]
    lines = [
        cells(line)
        for line in part.splitlines()
        if line.startswith(("| A", "| -", "| ramp", "| **"))
    ]
    names = "lift0.7h8 lift0.5h10 ramp1h10 ramp1.5h12".split()
    names = [f"{name}-{robot}" for robot in "cd" for name in names]
    for name, line in zip(names, lines, strict=True):
        falls, (back, *rest) = line[1:4], line[4:]
        for at, cell in zip((100, 200, 700), falls, strict=True):
            assert cell == ", ".join(f"{x:.0f}" for x, _ in runs[name, at]), (name, at)
        assert back == ", ".join(f"{x:.1f}" for _, x in runs[name, 700])
        if name.startswith("ramp"):
            of = re.escape(name)
            found = re.findall(rf"{of}\.\d .*clearance cm ([\d.]+)", printed)
            assert (
                rest[0] == ", ".join(f"{float(x):.1f}" for x in found) + " cm" and len(found) == 3
            )
            found = re.findall(rf"{of}\.\d .* return ([\d.]+)", printed)
            assert rest[1] == ", ".join(f"{float(x):.1f}" for x in found)
    with open(folder / "laptop_ramp.csv", newline="") as file:
        told = {(x["clearance_ramp"], x["iteration"]): x for x in csv.DictReader(file)}
    for key, text in (
        (("0.05", "80"), "1.43 of 3.75"),
        (("None", "80"), "-0.19 without"),
        (("0.05", "400"), "2.56 and"),
        (("None", "400"), "2.55 in the end"),
    ):
        assert f"{float(told[key]['episode_return']):.2f}" == text.split()[0] and text in " ".join(
            page.split()
        )
    assert [round(float(told["0.05", at]["share"]), 2) for at in ("30", "370")] == [0.01, 1.0]


def test_the_pages_of_the_bundled_policies_and_of_a_still_robot_have_the_numbers_of_their_files():
    """gait.txt and benchmark.txt are what the scripts of those names printed."""
    page = (EXPERIMENTS / "22_deploy/gait.md").read_text()
    for line in (EXPERIMENTS / "22_deploy/gait.txt").read_text().splitlines():
        name, *values = re.findall(r"^\w+|[\d.]+(?=,|$)", line)
        row = next(cells(one) for one in page.splitlines() if one.startswith(f"| `{name}` |"))[1:]
        for shown, value in zip(row, values, strict=True):
            number = shown.split()[0]
            digits = len(number.partition(".")[2])
            # the file has three digits, so its last one may round either way
            assert abs(float(number) - float(value)) <= 0.51 * 10**-digits + 1e-9, (
                name,
                shown,
                value,
            )
    lines = (EXPERIMENTS / "22_deploy/benchmark.txt").read_text().splitlines()
    found = {line.split()[0]: re.search(r"return ([\d.]+)", line)[1] for line in lines}
    for robot, label in paper.ROBOTS.items():
        full, less = found[robot], found[f"{robot}_deploy"]
        lost = 100 * (1 - float(less) / float(full))
        assert f"| {label.removeprefix('Unitree ')} | {full} | {less} | {lost:.1f} % |" in page
    still = json.loads((EXPERIMENTS / "04_laptop/results/still.json").read_text())
    page = (ROOT / "docs/results.md").read_text()
    best, laptop = still["best"], still["laptop"]
    assert best["fall_rate"] == laptop["fall_rate"] == 0
    row = f"1000 episodes, tracking error {best['tracking_error']:.2f} m/s | "
    assert f"{row}{best['return']:.1f} | {laptop['return']:.1f} |" in page


DEPLOY = EXPERIMENTS / "22_deploy"


def tables_of(page):
    """Rows of cells of each table of a page of 22_deploy, the head first."""
    found, last = [], ""
    for line in (DEPLOY / f"{page}.md").read_text().splitlines():
        if line.startswith("|") and "|---" not in line:
            if not last.startswith("|"):
                found.append([])
            found[-1].append([cell.strip() for cell in line.replace("**", "").split("|")[1:-1]])
        last = line
    return found


@functools.cache
def packed(name):
    """`(batch, name) -> seed -> rows` of a packed file of 22_deploy."""
    found = {}
    with lzma.open(DEPLOY / f"{name}.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            job = found.setdefault((row["batch"], row["name"]), {})
            job.setdefault(row["seed"], []).append(row)
    return found


def column(job, name):
    """Of a job's seeds and evaluations, `[S, E]`."""
    return np.array([[float(row[name]) for row in rows] for rows in job.values()])


def test_the_disturbances_of_the_policies_for_hardware_are_those_of_their_files():
    """All of them in disturbances.md; some on the page and in DEPLOY.md; nothing falls, as the page says."""
    table = script("22_deploy/table")
    printed = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in table.table(table.NAMES).splitlines()
        if "|---" not in line
    ]
    (mine,) = tables_of("disturbances")
    assert mine == printed and len(mine) == 26
    rows = {row[0]: dict(zip(printed[0], row, strict=True)) for row in printed}
    head, *short = tables_of("README")[0]
    assert len(short) == 9
    for row in short:
        assert row == [rows[row[0]][name] for name in head], row
    guide = (ROOT / "robots/DEPLOY.md").read_text().split("## Under disturbances")[1]
    lines = [cells(line) for line in guide.split("\n## ")[0].splitlines() if line[:1] == "|"]
    assert len(lines) > 9
    g1 = json.loads((HUMANOID / "results/stress_deploy.json").read_text())["rows"]
    g1 = {row["stress"]: table.cell(row) for row in g1}
    for label, *some in lines[2:]:
        for policy, cell in zip(lines[0], some, strict=True):  # its first cell is empty
            known = g1[label] if policy == "g1_deploy" else rows[label][policy]
            assert cell.replace(" falls", "").replace(" fall", "") == known, (label, policy)
    of_four = [name for name in table.NAMES if name.endswith("_deploy")]
    assert {rows[x][name][:3] for x in rows if x for name in of_four} == {"0; ", ""}
    bare = [float(rows["none"][name].split("; ")[1]) for name in of_four]
    assert max(bare) == 0.06
    text = " ".join((DEPLOY / "README.md").read_text().split())
    assert (
        "any of 16 disturbances, nor in 6 other physics" in text
    )  # and the bare row, and go1's two
    assert len(rows) - 1 == 1 + 16 + 6 + 2


def test_the_steps_of_the_policies_for_hardware_are_those_of_their_runs():
    table = script("21_less/table")
    jobs = table.read(DEPLOY / "deploy.csv.xz")
    full = [row for part in tables_of("steps") for row in part]
    short = tables_of("README")[2]
    for label, name in (
        ("Go1, PPO", "go1-ppo"),
        ("Go1, `deploy`", "go1"),
        ("Go2, `deploy`", "go2"),
        ("ANYmal-C, PPO", "anymal_c-ppo"),
        ("ANYmal-C, `deploy`", "anymal_c"),
        ("ANYmal-D, `deploy`", "anymal_d"),
    ):
        mine = {name: jobs[name]}
        row = cells(table.table(mine, table.best(jobs[name])).splitlines()[2])[1:]
        row = [*row[:7], *row[8:]]  # the highest return is not on the page
        assert [label, *row] in full, label
        assert [label, *row[4:9]] in short, label
    assert len(full) == 8 and len(short) == 7
    steps = [
        f"{np.mean([table.first(run, 30) for run in table.seeds(jobs[name])]) / 1e6:.3g}"
        for name in ("go1", "go1-ppo")
    ]
    text = " ".join((DEPLOY / "README.md").read_text().split())
    text_of = "a Go1 is at 30 after {:.1f} M, PPO after {:.0f}."
    assert text_of.format(*map(float, steps)) in text
    go2 = column({"503": packed("deploy")["1", "go2"]["503"]}, "fall_rate")[0]
    at = column({"503": packed("deploy")["1", "go2"]["503"]}, "iteration")[0]
    assert not go2[(at >= 200) & (at <= 650)].any() and round(100 * go2[-1]) == 21


def test_the_fresh_seeds_for_hardware_fall_as_their_page_says():
    """With the ramp and in brackets without it, whose seeds that learn late are left out of the end."""
    rows, worst = tables_of("seeds")[1][1:], 0
    assert len(rows) == 4
    for robot, row in zip(paper.ROBOTS, rows, strict=True):
        shown = []
        for batch in "43":
            job = packed("deploy")[batch, f"{robot}-bundled"]
            falls, ends = 100 * column(job, "fall_rate"), column(job, "return")[:, -1]
            assert list(column(job, "iteration")[0]) == [100 * k for k in range(1, 8)]
            late = falls[:, 5] > 50
            shown.append(
                [
                    falls[:, 0].mean(),
                    falls[:, 1].mean(),
                    falls[:, 2:].max(),
                    ends[~late].mean(),
                    late.sum(),
                ]
            )
            worst = max(worst, falls[:, 1].max()) if batch == "4" else worst
            if late.any():
                assert f"{falls[late, -1][0]:.0f}" == {"go2": "12", "anymal_d": "27"}[robot]
                assert f"{falls[late, 4][0]:.0f}" == {"go2": "80", "anymal_d": "78"}[robot]
        for cell, values in zip(row[1:], zip(*shown, strict=True), strict=True):
            assert shows(cell.removesuffix(" of 5"), *values), (robot, cell, values)
    text = " ".join((DEPLOY / "README.md").read_text().split())
    assert f"more than {worst:.1f} % of its episodes after 200 iterations" in text
    job = packed("tuning")["ramped", "ramped1.2h12-c"]
    falls, ends = 100 * column(job, "fall_rate"), column(job, "return")[:, -1]
    told = " ".join((DEPLOY / "seeds.md").read_text().split())
    found = re.search(r"batch `ramped`\): (.*?)\. ##", told)
    assert shows(found[1], falls[:, 0].mean(), falls[:, 1].mean(), falls[:, 2:].max(), ends.mean())


def test_what_was_tried_for_hardware_is_as_its_pages_say():
    """What a policy sees; weights of feet of `best`; clearance and benchmark of the fresh seeds."""
    rows, jobs = tables_of("tried")[0][1:], packed("tuning")
    names = "full full-s h1-o h1-s h3-s h5-s h10-s h5-o h5-s-ppo".split()
    for name, (_, steps, end) in zip(names, rows, strict=True):
        job = jobs["observation", name]
        returns, at = column(job, "return"), column(job, "sim_steps")
        first = [x[y >= 20][0] / 1e6 for x, y in zip(at, returns, strict=True)]
        assert shows(steps, np.mean(first)) and shows(end, returns[:, -1].mean()), name
    with_best = tables_of("feet")[1]
    checked = 0
    for weight, *row in with_best[1:]:
        for letter, cell in zip("ghcd", row, strict=True):
            if cell:
                name = f"best{weight.removesuffix(' (before)').lstrip('-')}-{letter}"
                returns, at = (column(jobs["heights", name], x) for x in ("return", "sim_steps"))
                level = 38 if letter in "gh" else 24
                first = [x[y >= level][0] / 1e3 for x, y in zip(at, returns, strict=True)]
                end, thousand = cell.split(";")[0].split(", ")
                assert shows(end, returns[:, -1].mean()), (name, end, returns[:, -1].mean())
                assert shows(thousand, np.mean(first)), (name, thousand, np.mean(first))
                checked += 1
    assert checked == 12
    printed = (DEPLOY / "fresh.txt").read_text()
    names = "go1-bundled go2-bundled anymal_c-bundled ramped1.2h12-c anymal_d-bundled".split()
    for name, row in zip(names, tables_of("feet")[3][1:], strict=True):
        of = re.escape(name)
        found = re.findall(rf"^{of}\.\d .*clearance cm ([\d.]+)", printed, re.M)
        assert len(found) == 5 and shows(row[1], *map(float, found)), name
        found = re.findall(rf"^{of}\.\d(?:\.npz)? .* return ([\d.]+)", printed, re.M)
        assert sorted(row[2].split(", ")) == sorted(f"{float(x):.1f}" for x in found), name
    # what was asked for, of the bundled policies
    asked = {row[0]: row[2:] for row in tables_of("README")[1]}
    gait = {line.split()[0]: line for line in (DEPLOY / "gait.txt").read_text().splitlines()}
    lost = {row[0]: row[3] for row in tables_of("gait")[4]}
    for k, (robot, label) in enumerate(paper.ROBOTS.items()):
        ahead = {
            name: float(re.search(r"at 0.5 m/s cm ([\d.]+)", gait[name])[1])
            for name in (robot, f"{robot}_deploy")
        }
        printed = re.sub(r"clearance at .*?, ", "", gait[f"{robot}_deploy"])
        found = re.findall(r"([a-z /]+?) (?:cm |m/s )?([\d.]+)(?:,|$)", printed)
        mine = {key.strip(): float(value) for key, value in found}
        assert shows(asked["feet of `deploy`"][k], ahead[f"{robot}_deploy"])
        assert shows(asked["the same, median of seven commands"][k], mine["clearance"])
        assert f"{asked['return lost'][k]} %" == lost[label.removeprefix("Unitree ")]
        assert shows(asked["load of `deploy`, left over right feet"][k], mine["left"])
        fore = asked["front over hind feet (standing)"][k]
        assert shows(fore, mine["front"], mine["front of standing"])
        scuff = asked["feet below 4 mm"][k].removesuffix(" but for 20 ms")
        assert shows(scuff, mine["scuff"], mine["slide"]), scuff
        assert shows(asked["feet of the others: `go1`, `go2`, ..."][k], ahead[robot])


def test_more_of_high_feet_and_the_go2_of_more_changes_are_as_their_files_say():
    """Five seeds a row: clearances and benchmarks of fresh.txt, falls and returns of the batch `solver`."""
    jobs, printed = packed("tuning"), (DEPLOY / "fresh.txt").read_text()
    names = "solver4-c solver10-c ramped1.8h12-c ramped1.8h13-c ramped1.5h14-c solver10-d ramped1.3h12-d"
    last = lambda job, column_: column(job, column_)[:, -1].mean()  # noqa: E731
    for name, row in zip(names.split(), tables_of("feet")[4][1:], strict=True):
        of, job = re.escape(name), jobs["solver", name]
        cm = re.findall(rf"^{of}\.\d .*clearance cm ([\d.]+)", printed, re.M)
        assert len(cm) == 5 and shows(row[1], *map(float, cm)), name
        found = re.findall(rf"^{of}\.(\d) fall_rate .* return ([\d.]+)", printed, re.M)
        told = re.findall(r"([\d.]+) \(7\d(\d)", row[2])
        assert sorted((seed, float(x)) for x, seed in told) == sorted(
            (seed, float(x)) for seed, x in found
        )
        assert shows(row[3], 100 * last(job, "fall_rate")) and shows(row[4], last(job, "return"))
    bundled = json.loads((ROOT / "robots/go2/policy.json").read_text())
    rows = tables_of("seeds")[0][1:]
    for name, row in zip(
        ("best0.2-h-changes", "best0.2-h-long", "best0.2-h-bundled"), rows, strict=False
    ):
        of = re.escape(name)
        falls = dict(re.findall(rf"^{of}\.(\d) falls after (\d+) of 600", printed, re.M))
        cm = dict(re.findall(rf"^{of}\.(\d) .*clearance cm ([\d.]+)", printed, re.M))
        seeds = sorted(falls)
        assert shows(row[1], *(float(falls[seed]) for seed in seeds)), name
        assert shows(row[2], *(float(cm[seed]) for seed in seeds)), name
        batch = "ramped" if name.endswith("bundled") else "solver"
        assert shows(row[3], last(jobs[batch, name], "return")), name
        if name == "best0.2-h-changes":
            assert str(bundled["seed"]) == min(falls, key=lambda seed: int(falls[seed]))
    assert bundled["run_seed"] == 720 + bundled["seed"]


def test_what_makes_a_robot_stand_where_it_should_walk_slowly_is_as_its_file_says():
    with (DEPLOY / "slow.csv").open(newline="") as file:
        robots = list(csv.DictReader(file))
    for robot, row in zip(robots, tables_of("gait")[2][1:], strict=True):
        speeds = [robot[name] or "none" for name in "ahead back left turning_left".split()]
        assert row[1] == ", ".join(speeds)
        assert shows(row[2], float(robot["standing_joint_speed"]))
        falls = [100 * float(robot["fall_rate"])] * ("falls" in row[3])
        assert falls or not float(robot["fall_rate"])
        assert shows(row[3], float(robot["return"]), *falls)
        assert shows(row[4], float(robot["tracking_error"]))


DIRECTIONS = "ahead back left turning_left".split()
SLOWER = {  # jobs of a robot's letter -> their row on gait.md
    "slow40-{}": "two of five, 0.5",
    "slow-{}": "the same, `slow`",
    "slow40-s42-{}": "two of five, 0.42 (ANYmals: to 500)",
    "slow-narrow-{}": "two of five, 0.35",
    "slow25-{}": "one in four, 0.5 (to 400)",
    "narrow-{}": "none, 0.35",
    "stand5-{}": "none, 0.5, one in 20 to stand",
    "stand2-{}": "none, 0.5, one in 50 to stand",
}


@functools.cache
def slowest():
    """`policy -> row` of slowest.csv."""
    with (DEPLOY / "slowest.csv").open(newline="") as file:
        return {row["policy"]: row for row in csv.DictReader(file)}


def followed_by(name):
    """The slowest commands that a policy of slowest.csv follows, in each direction."""
    return [slowest()[name][direction] or "none" for direction in DIRECTIONS]


def test_five_seeds_that_hear_more_slow_commands_are_as_their_files_say():
    """The slowest that all follow, clearance, where runs ended; who moves standing; what seeds fell."""
    shown = {row[0]: row[1:] for row in tables_of("gait")[3][1:]}
    assert [*shown] == [*SLOWER.values()]
    still, jobs = [], packed("tuning")
    for pattern, label in SLOWER.items():
        for letter, cell in zip("ghcd", shown[label], strict=True):
            name = pattern.format(letter)
            seeds = [key for key in slowest() if key.rpartition(".")[0] == name]
            assert len(seeds) == (5 if cell else 0), name
            if not cell:
                continue
            assert cell.split("; ")[0] == max(max(followed_by(seed)) for seed in seeds), name
            heights = [float(slowest()[seed]["clearance"]) for seed in seeds]
            assert shows(cell.split("; ")[1], np.mean(heights), min(heights), max(heights)), name
            end = 400 if "25" in name else 500 if "s42" in name and letter in "cd" else 700
            job = jobs["slow40" if name.startswith(("slow40", "slow25")) else "slow", name]
            assert len(job) == 5 and set(column(job, "iteration")[:, -1]) == {end}, name
            if "stand" not in name and not name.startswith("narrow"):
                still += [float(slowest()[seed]["standing"]) for seed in seeds]
    page = " ".join((DEPLOY / "gait.md").read_text().split())
    *others, most = sorted(still)
    told = f"of the {len(still)} robots with slow commands the joints of one Go2 (0.35) move at"
    assert (
        f"{told} {most:.3f} rad/s" in page
        and f"those of the others at {max(others):.3f} at most" in page
    )
    # seeds that choose.py played, and what narrower kernels are worth on an ANYmal-D
    rows, benchmark = played(), (DEPLOY / "slow_chosen.txt").read_text()
    falls = [total_falls(row) for name, row in rows.items() if re.match(r"slow(40)?-\w\.", name)]
    fell = [count for count in falls if count]
    assert len(falls) == 18 and len(fell) == 12
    narrower = [total_falls(row) for name, row in rows.items() if name.startswith("slow40-s42-g.")]
    assert narrower == [0] * 4
    assert f"played twelve fall, {min(fell):.0f} to {max(fell):.0f} times" in page
    before = [row for name, row in rows.items() if "-bundled." in name]
    assert len(before) == 5 and not sum(map(total_falls, before))
    some = {
        job: [(name, row["error"]) for name, row in rows.items() if name.startswith(f"{job}.")]
        for job in ("slow-narrow-d", "slow40-d")
    }
    back = {
        job: [
            float(re.search(rf"^{re.escape(n)} .*? return ([\d.]+)", benchmark, re.M)[1])
            for n, _ in of
        ]
        for job, of in some.items()
    }
    (narrow, wide), (less, more) = some.values(), back.values()
    assert (len(narrow), len(wide)) == (3, 5)
    assert (
        "{:.3f} to {:.3f} m/s with 0.35 (three seeds), {:.3f} to {:.3f} with 0.5 (five".format(
            *(f(error for _, error in of) for of in (narrow, wide) for f in (min, max))
        )
        in page
    )
    assert f"for {min(less)} to {max(less)} instead of {min(more)} to {max(more)} on" in page
    # what it costs: of one seed each, and of what is bundled
    chosen = "slow40-s42-g.2", "slow-h.1", "slow40-c.1", "slow40-d.0"
    bundled = [f"{robot}_deploy" for robot in paper.ROBOTS]
    first = [
        re.search(rf"^{re.escape(one)} .*? return ([\d.]+)", benchmark, re.M)[1] for one in chosen
    ]
    assert "has {}, {}, {} and {} on the".format(*(f"{float(x):.1f}" for x in first)) in page
    energy = [f"{float(slowest()[one]['cost_of_transport']):.2f}" for one in [*chosen, *bundled]]
    told = "transport is {}, {}, {} and {}, of the bundled ones {}, {}, {} and {}."
    assert told.format(*energy) in page
    errors = [f"{rows[one]['error']:.3f}" for one in chosen]
    assert "track to {}, {}, {} and {} m/s".format(*errors) in page


def played():
    """`policy -> numbers` of choose.txt, and of slow_chosen.txt, by choose.py."""
    rows = {}
    for file in ("choose.txt", "slow_chosen.txt"):
        for line in (DEPLOY / file).read_text().splitlines():
            name, text = line.split(maxsplit=1)
            if " stress" in line:
                rows[name] = {key: float(value) for key, value in map(str.split, text.split(", "))}
    return rows


def total_falls(row):
    return sum(row[kind] for kind in script("22_deploy/choose").FALLS)


def test_more_changes_of_command_did_what_the_page_says():
    """Falls of the headline's seeds in 200 changes each, with and without; first steps at the level."""
    folder, falls = EXPERIMENTS / "21_less/results", {}
    for file, kind in (("changes_lifted.txt", "best"), ("changes_more.txt", "changes")):
        found = re.findall(
            rf"^seed 0 {kind}-(\w)\.\d: falls after (\d+) of 200", (folder / file).read_text(), re.M
        )
        for robot in "ghcd":
            falls[kind, robot] = [int(count) for of, count in found if of == robot]
    page = " ".join((EXPERIMENTS / "21_less/task.md").read_text().split())
    for robot, text in (("h", "on a Go2 ({} to {} in"), ("g", "on a Go1 ({} to {}, p")):
        old, new = falls["best", robot], falls["changes", robot]
        assert len(old) == len(new) == 10
        assert text.format(sum(old), sum(new)) in page
        p = stats.welch_of(old, new)
        assert (f"p {p:.3f})" if robot == "h" else f"p {p:.2f})") in page
    assert len(falls["changes", "c"] + falls["changes", "d"]) == 20
    assert not sum(falls["changes", "c"] + falls["changes", "d"])


BUNDLED = [f"{robot}{end}" for robot in paper.ROBOTS for end in ("", "_deploy")] + ["g1_deploy"]
SECONDS_EACH = pytest.mark.slow  # three; a default test plays one


@pytest.mark.parametrize(
    "name", [name if name == "go1" else pytest.param(name, marks=SECONDS_EACH) for name in BUNDLED]
)
def test_slow_commands_that_a_bundled_policy_follows_are_those_of_the_file(name):
    from dynappo.evaluate import slow
    from dynappo.policy import policy_source

    found = slow.run(policy_source.player(policy_source.load(name)[0])[0])
    assert [f"{x:g}" if x else "none" for x in found.values()] == followed_by(name)


@pytest.mark.parametrize("page", [DEPLOY / "gait.md", ROOT / "robots/DEPLOY.md"])
def test_slow_commands_that_bundled_policies_follow_are_as_the_pages_say(page):
    """A row a policy, or a column."""
    section = page.read_text().split("## Slow commands")[1].split("\n## ")[0]
    head, _, *rows = [cells(line) for line in section.splitlines() if line[:1] == "|"]
    if "ahead" in head:  # a row a policy; the table after it is of runs that are not here
        rows = rows[: [row[0] for row in rows].index("`go1:laptop`")]
        told = {row[0].strip("`"): ", ".join(row[1:]) for row in rows}
    else:
        told = {name: ", ".join(row[k] for row in rows) for k, name in enumerate(head) if k}
    assert len(told) >= 5
    for name, text in told.items():
        assert text == ", ".join(followed_by(name)), name


def test_jobs_of_fewer_steps_for_hardware_change_robots_and_tails_alone():
    """22_deploy/fewer.txt: the task is that of `deploy`, and PPO's and the model's settings are."""
    lines = (EXPERIMENTS / "22_deploy/fewer.txt").read_text().splitlines()
    assert len({line.split()[0] for line in lines}) == len(lines) == 8
    for line in lines:
        _, job, *fields = line.split()
        mine, asked = config_lib.load(f"configs/{job.replace(':', '.py:')}"), {}
        other = config_lib.flat(config_lib.validate(mine.copy_and_resolve_references()))
        mine.run.log_every = 1
        for field in fields:
            name, value = field.split("=", 1)
            config_lib.override(mine, name, value)
            asked[name] = value
        found = config_lib.flat(config_lib.validate(mine))
        changed = {name for name, x in found.items() if x != other[name] and name[:4] != "run."}
        assert changed <= {"rollout.num_envs", "schedule.last_iteration"} and changed
        assert schedule.sim_steps(mine)[-1] < 15e6  # PPO's are up to 20 M


def test_the_bundled_policies_for_hardware_are_the_best_rows_of_their_file():
    """choose.txt has seeds of the highest returns; deploy.json names the best of them."""
    choose = script("22_deploy/choose")
    rows, ends = {}, {}
    for line in (EXPERIMENTS / "22_deploy/choose.txt").read_text().splitlines():
        name, text = line.split(maxsplit=1)
        rows[name] = {key: float(value) for key, value in map(str.split, text.split(", "))}
    with lzma.open(EXPERIMENTS / "22_deploy/deploy.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] == "4":  # the last evaluation of a seed stays
                ends[f"{row['name']}.{int(row['seed']) - 710}"] = float(row["return"])
    for robot in paper.ROBOTS:
        mine = [name for name in rows if name.startswith(f"{robot}-bundled.")]
        seeds = sorted((name for name in ends if name.startswith(robot)), key=ends.get)
        assert len(seeds) == 5 and mine == seeds[::-1][: len(mine)]
        bundled = json.loads((ROOT / f"robots/{robot}/deploy.json").read_text())
        chosen = f"{robot}-bundled.{bundled['seed']}"
        assert chosen == choose.best({name: rows[name] for name in mine})[0]
        assert not sum(rows[chosen][kind] for kind in choose.FALLS)
        assert bundled["run_seed"] == 710 + bundled["seed"]


def test_a_seed_is_chosen_by_all_its_falls_and_then_by_its_error(monkeypatch):
    from dynappo.evaluate import changes, stress, trials

    choose = script("22_deploy/choose")
    row = lambda falls, error: {"falls": falls, "tracking_error": error}  # noqa: E731
    monkeypatch.setattr(stress, "run", lambda *_: [row(0, 0.1), row(8, None), row(1, 0.3)])
    walks = [{"fall": None, "tracking_error": 0.16, "yaw_error": 0.25}]
    walks += [{"fall": 0.5, "tracking_error": None, "yaw_error": None}]
    monkeypatch.setattr(trials, "run", lambda policy, player: ({"commands": walks}, None))
    told = {0: (1, 0), 1: (0, 2), 2: (0, 0)}
    monkeypatch.setattr(
        changes, "run", lambda _, seed: dict(zip(("falls", "start_falls"), told[seed], strict=True))
    )
    monkeypatch.setattr(changes, "tours", lambda _: [{"fell_at": []}, {"fell_at": [1.0, 4.0]}])
    found = choose.measure("go1")
    assert found.pop("error") == pytest.approx((0.2 + 0.16) / 2)
    assert found == {"stress": 9, "commands": 1, "worst": 0.25, "changes": 3, "tours": 2}
    rows = {
        name: dict.fromkeys(choose.FALLS, 0) | {kind: falls, "error": error}
        for name, kind, falls, error in (
            ("a", "changes", 1, 0.01),
            ("b", "tours", 1, 0.02),
            ("c", "stress", 0, 0.09),
            ("d", "commands", 2, 0.01),
            ("e", "stress", 0, 0.08),
        )
    }
    assert choose.best(rows) == ["e", "c", "a", "b", "d"]


def test_seconds_are_counted_to_the_level_and_until_it_walks():
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
    # a seed's clock is the median of its runs: 60 and 120; it walks after the relapse at 30
    np.testing.assert_allclose(run.level, [[20, 20_000, 60], [20, 20_000, 120]])
    np.testing.assert_allclose(run.walks, [[40, 40_000, 120], [40, 40_000, 240]])
    assert table.cells(run.walks) == ["2", "0.04", "180.00"]
    low = about | {"seed": "2", "iteration": 1, "sim_steps": 1, "seconds": 1}
    (run,) = table.of_rows([*found, low | {"return": 30.0, "fall_rate": 0.0}])
    assert np.isnan(run.walks[2]).all() and table.cells(run.walks)[0] == "2 of 3"
    assert table.cells(run.walks[2:]) == ["0 of 1", "-", "-"]
    # 90, 60 and 120: mean 90, t(2) 4.303 x 30 / sqrt(3)
    assert table.interval([90, 60, 120]) == "90.00 ± 74.52"


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
    # 1.5 + 0.1 (c - 1) = 1 + 1.16 (c - 1); beside PPO of its own host 1.6 + 0.1 (c - 2) = 1 + 1.16 (c - 2)
    assert "; for seconds 1.5 (" in table.compared([*first, there])
    beside = fast._replace(batch=there.batch)
    assert "; for seconds 2.6 (" in table.compared([*first, there, beside])
    assert "; for seconds" not in table.compared(first)
    # no difference is shown at any cost
    alike = run("ppo1024", 1024, 100, 2.01)
    assert table.even(best, [alike], 1.0) == "0.1 (below 0.1 to over 100)"
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
    assert len({line.split()[0] for line in lines}) == len(lines) == 49
    for line in lines:
        name, job, *fields = line.split()
        place, _, method = name.rpartition(".")
        read = measure.read(job, fields)
        assert place in places and (read.engine == "mujoco_warp") == place.endswith("warp")
        assert 10 <= len(measure.ends(read.config)) <= 36
        uses_model = schedule.uses_model(read.config)
        assert uses_model != method.startswith("ppo")
        assert read.seeds >= 5 or method.startswith("tune")
    with pytest.raises(SystemExit, match="engine is 'c', expected mujoco_warp"):
        measure.read("go1:best", ["engine=c"])


def test_a_run_alone_is_timed_between_evaluations_and_keeps_its_policies(monkeypatch):
    measure = script(f"{ROW_COST}/run")
    job = measure.read("go1:best", ["run.num_iterations=20", "seeds=2", "rollout.num_envs=16"])
    clock = iter([1.0, 1.5, 7.0, 7.25])
    monkeypatch.setattr(measure.time, "perf_counter", lambda: next(clock))

    def step(hyper, state, columns):
        more = len(columns["iteration"])
        params = state.learner.params + more
        metrics = {"policy_std": np.ones(more), "iteration": columns["iteration"]}
        return types.SimpleNamespace(learner=types.SimpleNamespace(params=params)), metrics

    program = types.SimpleNamespace(step=step, hyper=0, columns=schedule.columns(job.config))
    state = types.SimpleNamespace(learner=types.SimpleNamespace(params=jnp.zeros(())))
    rows, policies = measure.train(job.config, program, state)
    steps = schedule.sim_steps(job.config)
    assert [row["seconds"] for row in rows] == ["0.5000", "0.7500"]
    assert [row["sim_steps"] for row in rows] == [steps[9], steps[19]]
    assert policies == [10, 20] and (job.seeds, job.episodes) == (2, 500)


def test_steps_until_robots_walk_count_falls_and_relapses():
    """Three Go1: one walks at once, one after a relapse, one falls to the end; and an ANYmal."""
    table = script("21_less/table")
    runs = {  # returns, fall rates after 1, 2, 3, 4 M steps
        0.0: ([39, 40, 40, 40], [0, 0, 0, 0]),
        1.0: ([38, 37, 40, 40], [0.0, 0.0, 0.02, 0.01]),
        2.0: ([10, 40, 40, 40], [0.9, 0.5, 0.2, 0.05]),
    }

    def job(runs, text):
        return [
            {"job": text, "seed": seed, "sim_steps": (k + 1) * 1e6, "tracking_error": 0.05}
            | {"return": float(value), "fall_rate": falls}
            for seed, some in runs.items()
            for k, (value, falls) in enumerate(zip(*some, strict=True))
        ]

    go1 = job(runs, "new-g go1:best")
    head, _, line = table.table({"new-g": go1}, table.best(go1)).splitlines()
    told = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    assert told["walks: M steps"] == "2.50 (4.00), 1 never"
    assert told["first at 38"] == "1.33 (2.00)"
    assert told["first at 38, falls at most 1 %"] == "1.00 (1.00), 1 never"
    assert told["at the end: return, falls"].endswith(", 8.7 %")
    anymal = job({0.0: ([24, 24], [0, 0])}, "new-c anymal_c:best")
    head, _, line = table.table({"new-c": anymal}, table.best(anymal)).splitlines()
    assert "first at 24" in head and line.split(" | ")[2] == "1.00 (1.00)"
    rows = table.parts({"new-g": go1, "new-c": anymal}).splitlines()
    assert rows[2] == (
        "| new | **2.50 (1 never)**; 1.33; 39.7, 8.7 % |  | **1.00**; 1.00; 24.0, 0.0 % |  |"
    )


def test_a_laptop_run_walks_if_it_does_to_its_end():
    walk = script("04_laptop/table").walk
    rows = [{"steps": k, "return": 40.0, "fall_rate": f} for k, f in enumerate((0.02, 0.01, 0.005))]
    assert walk(rows, 38) and walk(rows[-1:], 38) and not walk(rows[:1], 38)
    assert not walk(rows[::-1], 38) and not walk(rows, 41)


def test_a_line_of_changes_has_the_falls_of_the_package(monkeypatch):
    from dynappo.evaluate import changes as package

    script_of = script("21_less/changes")
    assert len(script_of.BUNDLED) == 8 and {"go1", "anymal_d_deploy"} <= set(script_of.BUNDLED)
    tours = [{"tour": "film", "seconds": 12.0, "fell_at": [1.0]}]
    monkeypatch.setattr(package, "tours", lambda body: tours)
    found = {"falls": 3, "start_falls": 1, "walks": 2}
    given = []
    monkeypatch.setattr(package, "run", lambda body, *more: given.append(more) or found)
    assert script_of.line("go1", 16, 5) == (
        "go1: falls after 3 of 16 changes, in 1 of 2 walks before the first, 1 in the tour of the film"
    )
    assert given == [(16, 5)]


@pytest.mark.parametrize("name", ["11_model", "12_platforms", "13_step_time", "16_gaits"])
def test_a_table_says_what_has_not_been_run(name, tmp_path, drawn):
    script(name).make(tmp_path)
    assert drawn
    table = (tmp_path / "results.csv").read_text()
    assert "not run" in table or ",,,\n" in table  # of milliseconds, empty cells


# What a run came to


def test_a_threshold_is_reached_where_the_return_first_is_there(tmp_path):
    nan = np.nan
    keep(tmp_path, "a", [[nan, nan, nan], [5, 9, 1], [9, 3, 2], [4, 12, 3]])
    found = paper.load(tmp_path, "a")
    took = paper.reached(found, 9.0)
    np.testing.assert_array_equal(took["iteration"], [3, 2, nan])
    np.testing.assert_array_equal(took["sim_steps"], [3000, 2000, nan])
    np.testing.assert_array_equal(took["seconds"], [6, 4, nan])
    every = paper.reached(found, 9.0, 2)  # iterations 2 and 4 only
    np.testing.assert_array_equal(every["iteration"], [nan, 2, nan])


def test_simulator_steps_of_table_6_follow_from_its_iterations():
    for variant, steps in (("ppo16", 27_525_120), ("dyna2", 22_822_912), ("dyna4", 19_636_224)):
        row = paper.pick(paper.table("efficiency"), variant=variant)
        assert paper.sim_steps(f"configs/go1.py:{variant}", int(row["iterations"])) == steps
        assert round(steps / 1e6, 2) == row["sim_steps_M"]


# What a run leaves


def test_a_csv_of_500_iterations_and_5_seeds_is_small_and_exact_where_it_counts(tmp_path):
    rng, count = np.random.default_rng(0), np.arange(1, 501)
    metrics = {n: rng.normal(size=(500, 5)) * 10.0 ** rng.integers(-2, 2) for n in run.KEPT}
    metrics |= {"iteration": count, "sim_steps": 49152 * count, "seconds": 0.81234 * count}
    metrics["falls"] = rng.integers(0, 300, (500, 5))
    for name in ("eval_return", "eval_fall_rate", "eval_tracking_error"):
        metrics[name][count % 50 != 0] = np.nan  # of a run that is evaluated on the way
    run.write_csv(tmp_path / "a.csv", run.kept(metrics))
    (path,) = tmp_path.iterdir()
    assert path.name == "a.csv.xz" and path.stat().st_size < 40_000
    assert lzma.decompress(path.read_bytes()).startswith(b"iteration,sim_steps,seconds,")
    read = paper.read(path)
    np.testing.assert_array_equal(read["sim_steps"][:, 3], metrics["sim_steps"])
    np.testing.assert_allclose(read["episode_return"], metrics["episode_return"], rtol=6e-4)
    every = (count <= 20) | (count % 5 == 0)
    np.testing.assert_array_equal(read["falls"][every], metrics["falls"][every])
    assert np.isnan(read["falls"][~every]).all()
    np.testing.assert_allclose(read["eval_return"], metrics["eval_return"], rtol=6e-4)
    thin = run.kept(metrics, thin=10)
    np.testing.assert_array_equal(thin["iteration"], np.arange(10, 501, 10))
    assert np.isfinite(thin["kl"]).all()


TOY = (
    "run.device=cpu rollout.num_envs=16 rollout.horizon=8 run.num_iterations=4 run.log_every=2 "
    "run.checkpoint_every=0 run.eval_envs=0 model.hidden=(8,) model.epochs=1 ppo.hidden=(8,) "
    "ppo.epochs=1 ppo.minibatches=2 schedule.start_iteration=1 schedule.end_iteration=3"
).split()


@pytest.mark.slow
def test_a_batch_goes_on_where_it_was_cut_off_and_chunks_train_as_it_does(tmp_path, monkeypatch):
    """With the toy environment; and the probe of 11_model on the model of its run."""
    from dynappo.tasks.velocity import env as env_lib

    monkeypatch.setattr(env_lib, "make", lambda *_, **__: toy_env.make())
    made = run.build.program(run.configure("go1:dyna4", 2, TOY))  # compiled once
    state = jax.tree.map(jnp.copy, made.state)  # a run gives its own away
    programs = [made._replace(state=state), made]
    monkeypatch.setattr(run.build, "program", lambda _: programs.pop())
    (tmp_path / "go1_ppo16_run.seed_1.json").write_text('{"diverged": "kl"}')
    for _ in range(2):  # the second time there is nothing to do
        run.batch(tmp_path, ["go1:ppo16:run.seed=1", "go1:dyna4"], 2, TOY)
        assert len(programs) == 1
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"go1_ppo16_run.seed_1.json", "go1_dyna4.json", "go1_dyna4.csv.xz"}
    states = [paper.status(paper.load(tmp_path, n)) for n in ("go1_ppo16_run.seed_1", "b")]
    assert states == ["diverged", "not run"]
    found = paper.load(tmp_path, "go1_dyna4")
    assert found.columns["sim_steps"][-1, 0] == 16 * np.sum([8, 6, 4, 4])
    assert len(found.summary["policy_std"]) == 2
    ask, done, std = None, [], []
    for program, iteration, state, metrics in run.chunks(run.configure("go1:dyna4", 2, TOY)):
        done.append(iteration)
        std += metrics["policy_std"].tolist()
        ask = ask or script("11_model/probe").compiled(program)
        rmse, spread = map(np.asarray, ask(state))
        assert rmse.shape == spread.shape == (2, 8, 2) and np.isfinite(rmse).all()
        assert (rmse > 0).all() and (rmse[0] != rmse[1]).all()  # seeds differ
    assert done == [2, 4]
    np.testing.assert_allclose(found.columns["policy_std"], std, rtol=1e-3)


# Tables


def test_all_runs_of_a_cell_count_whichever_folder_has_them(tmp_path, monkeypatch):
    ablation, regimes = script("10_ablation"), script("17_regimes/table")
    monkeypatch.setattr(ablation, "OTHERS", tmp_path)
    own, name = tmp_path / "own", run.name(ablation.job(4096, 12))
    keep(tmp_path / "12_platforms/earlier", "go1_ppo12", [[7.0] * 5] * 12)
    cells = ablation.build(own, [(2048, 12), (4096, 12)])
    assert [cell["status"] for cell in cells] == ["not run", ""]
    assert (cells[1]["seeds"], cells[1]["max_reward_mean"]) == (5, 7)
    # every iteration of one, every tenth of another
    keep(own, name, [[3.0] * 3] * 20)
    keep(own / "more", name, [[4.0, 5.0]] * 20)
    keep(tmp_path / "17_regimes/results/more", name, [[6.0]] * 20)
    keep(tmp_path / "12_platforms/results", "go1_ppo12", [[8.0]] * 20)
    keep(tmp_path / "12_platforms/earlier", "go1_ppo12", [[7.0] * 5] * 20)
    (cell,) = ablation.build(own, [(4096, 12)])
    warp, kernel = [3.0] * 3 + [7.0] * 5, [4.0, 5.0, 6.0, 8.0]
    assert (cell["seeds"], cell["kernel_seeds"]) == (12, 4)
    assert cell["max_reward_mean"] == pytest.approx(np.mean(warp + kernel))
    assert cell["kernel_difference"] == pytest.approx(np.mean(kernel) - np.mean(warp))
    assert cell["kernel_p"] == stats.welch_of(kernel, warp)
    places = [(str(row["batch"]), row["seeds"]) for row in ablation.named(own, [(4096, 12)])]
    assert places[:2] == [("own", 3), ("12_platforms/earlier", 5)]
    jobs = [regimes.job(r, v) for r in regimes.REGIMES for v in regimes.VARIANTS]
    configs = {run.configure(job, 3).to_json_best_effort() for job in jobs}
    assert len({run.name(job) for job in jobs}) == len(jobs) == len(configs)
    assert regimes.job(regimes.Regime("", 2048), "ppo12") == ablation.job(2048, 12)


def test_no_stored_run_of_plain_ppo_on_go1_is_missing_in_the_map():
    """By what each run's JSON says of itself: job, settings, iterations."""
    plot = script("10_ablation")
    kept = {
        EXPERIMENTS / "03_speed/results/one_seed_ppo16"
    }  # one seed, for its time: the page says so
    for cell in plot.GRID:
        kept |= {
            batch.path for batch in plot.batches_of(EXPERIMENTS / "10_ablation/results", *cell)
        }
    about = ("rollout.num_envs", "rollout.horizon")  # what a cell is; all else is the variant's
    free = ("physics.impl", "run.")  # fields that do not change what is learned
    found = set()
    for path in EXPERIMENTS.rglob("*.json"):
        told = json.loads(path.read_text())
        job = told.get("job") if isinstance(told, dict) else None
        if not isinstance(job, str) or not job.startswith(("go1:ppo12", "go1:ppo16")):
            continue
        fields = [field.split("=")[0] for field in job.split(":")[2:]]
        fields += [one.split("=")[0] for one in told["set"] if not one.startswith(free)]
        if not set(fields) - set(about) and told["iterations"] == 500:
            found.add(path.with_suffix(""))
    assert found == kept


def test_the_page_of_the_map_has_the_numbers_of_its_runs():
    plot = script("10_ablation")
    page = (EXPERIMENTS / "10_ablation/README.md").read_text()
    rows = plot.build(EXPERIMENTS / "10_ablation/results", plot.GRID)
    for envs in plot.ENVS:
        some = [row for row in rows if row["envs"] == envs]
        cells = [f"{row['max_reward_mean']:.1f} / {row['paper_max_reward']:.1f}" for row in some]
        assert f"| R = {envs} | {' | '.join(cells)} |" in page
        assert f"| R = {envs} | {' | '.join(str(row['seeds']) for row in some)} |" in page
    lines = plot.findings(rows)
    gains = [line.split(": ")[1].split(", ")[0] for line in lines if line.startswith("  R=")][:6]
    assert len(gains) == 6 and all(gain in page.replace(",", "") for gain in gains)
    levels = next(line for line in lines if line.startswith("  rows to"))
    assert "R=1024: 19.6, R=2048: 14.4, R=4096: 12 or fewer" in levels and "19.6, 14.4, 12" in page
    batches = plot.named(EXPERIMENTS / "10_ablation/results", plot.GRID)
    seeds = {
        by: sum(b["seeds"] for b in batches if b["engine"] == by)
        for by in ("MuJoCo Warp", "kernel")
    }
    text = f"{sum(seeds.values())} seeds, {seeds['MuJoCo Warp']} by MuJoCo Warp's own step and "
    assert f"{text}{seeds['kernel']} by" in page and f"the {len(batches)} batches" in page


def test_the_pages_say_what_the_first_seeds_gave_alone_and_what_those_added_did():
    """17_regimes: evaluated gains of the tails of 20 rows over PPO-16, 1024 robots, by folder."""
    regimes, results = script("17_regimes/table"), EXPERIMENTS / "17_regimes/results"
    here = next(regime for regime in regimes.REGIMES if regime.label == "R = 1024")
    pages = [(EXPERIMENTS / f"{name}/README.md").read_text() for name in ("17_regimes", "paper")]
    for folder in (results, results / "more"):
        kinds = (("ppo16", None), *((name, 20) for name in regimes.TAILS))
        base, *tails = (
            regimes.values(paper.load(folder, run.name(regimes.job(here, *kind))))["evaluated"]
            for kind in kinds
        )
        for tail in tails:
            found, p = stats.difference(tail, base), stats.welch_of(tail, base)
            text = f"{found.value:+.1f} ({found.low:.1f} to {found.high:.1f}, p {p:.2g}"
            text = text.replace("p 0.0023", "p 0.002").replace("p 0.0089", "p 0.009")
            for page in pages:
                assert text in " ".join(page.split()), text


def test_tails_are_compared_with_the_real_rows_that_they_stand_for(tmp_path, monkeypatch):
    """24 rows of 1024 robots: 20 real and 4 of the model, against PPO with 20 and with 24."""
    cliff = script("17_regimes/cliff")
    monkeypatch.setattr(cliff.table, "__file__", str(tmp_path / "17_regimes" / "table.py"))
    folder, job = tmp_path / "17_regimes" / "results", script("10_ablation").job
    for rows, last in {20: [10.0, 14.0], 24: [30.0, 34.0]}.items():
        keep(folder, run.name(job(1024, rows)), [last] * 10)
    name = "go1_dyna4_rollout.num_envs_1024_rollout.horizon_24"
    keep(folder, name, [[20.0, 28.0]] * 10)
    keep(folder / "more", name, [[20.0, 22.0]] * 10)
    keep(tmp_path / "17_regimes" / "earlier", name, [[5.0, 7.0]] * 10)
    keep(tmp_path / "12_platforms" / "results", "go1_ppo16", [[30.0, 30.0]] * 10)  # limit 24
    table = cliff.build(folder)
    assert [row["status"] for row in table].count("") == 5  # PPO-20 is in two groups
    tail = paper.pick(table, batch="second", variant="dyna4", rows=24)
    got = [tail[n] for n in ("seeds", "best_mean", "success_rate_pct", "sim_steps_M_mean")]
    assert got == [4, 22.5, 25, 0.01]
    ours = [20, 28, 20, 22]
    assert tail["fewer_best_p"] == stats.welch_of(ours, [10, 14])
    assert tail["all_best_p"] == stats.welch_of(ours, [30, 34])
    assert tail["all_best_difference"] == 22.5 - 32 and tail["all_evaluated_difference"] == 0
    earlier = paper.pick(table, batch="first", variant="dyna4", rows=24)
    assert earlier["best_mean"] == 6 and "all_best_p" not in earlier  # never beside another batch


def test_more_seeds_of_a_cell_are_pooled_and_cells_that_differ_most_come_first(tmp_path):
    more, job = script("10_ablation/run"), script("10_ablation").job
    for cell, returns in {(16, 12): [1.0, 2.0, 3.0], (32, 12): [1.0, 5.0, 9.0]}.items():
        keep(tmp_path, run.name(job(*cell)), [returns] * 10)
    grid = [(16, 12), (32, 12), (32, 16)]
    assert more.few(tmp_path, grid, []) == [(32, 12), (16, 12)]
    assert more.few(tmp_path, grid, [16]) == [(16, 12)]
    keep(tmp_path / "more", run.name(job(32, 12)), [[7.0, 8.0]] * 10)
    assert more.few(tmp_path, grid, []) == [(16, 12)]
    row = paper.pick(more.plot.build(tmp_path, grid), envs=32, horizon=12)
    assert (row["seeds"], row["max_reward_mean"]) == (5, 6.0)


def test_a_tail_pays_where_its_steps_save_more_than_the_fit_takes():
    """And a training's minutes are those of its phases, and a rest."""
    plot = script("13_step_time")
    found = plot.pays([30.0, 34.0, 32.0], [2.0, 2.1, 1.9])
    assert found["pays_from"] == pytest.approx(16)
    assert found["pays_from_low"] < 16 < found["pays_from_high"]
    assert plot.pays([30.0], [2.0])["pays_from"] == 15
    assert plot.pays([30.0, 34.0], [0.1, -0.2]) == {"pays_from": "never"}
    assert np.isnan(plot.pays([30.0, 34.0], [0.1, 0.2])["pays_from_high"])  # or never
    ms = {"physics": 1.0, "tail": 0.5, "fit": 4.0, "ppo": 2.0, "iteration": 20.0}
    for real, synthetic, rounds in ((12, 4, 1), (4, 48, 3)):  # at this cost both take as long
        even = plot.break_even(ms, (real, synthetic, 1, rounds))
        tail = real * even + synthetic * ms["tail"] + ms["fit"] + rounds * ms["ppo"]
        assert tail == pytest.approx((real + synthetic / rounds) * even + ms["ppo"])
    settings = ["run.num_iterations=200"]
    report = {"ms": ms, "settings": settings, "training_seconds": 6.0}
    rows = plot.split({name: [report] for name in plot.VARIANTS})
    tail = paper.pick(rows, variant="dyna4")
    real = paper.sim_steps("configs/go1.py:dyna4", 500) / 4096 - 300 * 12
    assert tail["physics_min"] == pytest.approx(real / 60e3)
    assert tail["synthetic_min"] == pytest.approx(0.5 * (200 * 16 - real) / 60e3)
    assert tail["fit_min"] == pytest.approx(4 * real / 12 / 60e3, rel=0.01)  # in whole minibatches
    assert tail["ppo_min"] == pytest.approx(200 * 2 / 60e3) and tail["total_min_mean"] == 0.1
    assert tail["rest_min"] == pytest.approx(0.1 - sum(tail[f"{p}_min"] for p in plot.PARTS))
    assert paper.pick(rows, variant="dyna2")["times_of"] == "dyna4"


def test_efficiency_counts_steps_and_success(tmp_path):
    rising = np.arange(1, 41)[:, None]  # the return is the iteration
    keep(tmp_path, "go1_ppo16", rising * [1.0, 1.0])
    keep(tmp_path, "go1_dyna4", rising * [2.0, 0.5])
    rows, top = script("14_efficiency").build(tmp_path, 10.0), "80 % of PPO-16"
    base, tail = (paper.pick(rows, threshold=top, variant=v) for v in ("ppo16", "dyna4"))
    assert (base["limit"], base["sim_steps_M_mean"]) == (32, 0.032)
    assert tail["iterations_mean"] == 16 and not any(n.startswith("seconds") for n in tail)
    # the seed that never gets there counts with all of its 40 iterations
    assert (tail["share_of_ppo16_pct"], tail["share_of_ppo16_bound"]) == (100 * 28 / 32, "at least")
    assert "p_steps" not in tail and "share_of_ppo16_pct" not in base
    assert (base["success_rate_pct"], tail["success_rate_pct"]) == (100, 50)
    printed = paper.pick(rows, threshold="paper, 30.5", variant="dyna4")
    assert (printed["iterations_mean"], printed["paper_iterations"]) == (16, 383)
    assert paper.pick(rows, threshold="80 % of the ablation's best")["limit"] == 8


def test_efficiency_by_evaluation_and_against_earlier_batches_too(tmp_path):
    """On the line between two evaluations, the first for a seed that is there already."""
    count = np.arange(1, 7)
    columns = {"iteration": count, "sim_steps": 1000 * count, "seconds": 2.0 * count}
    columns = {name: np.stack([c, c, c], 1) for name, c in columns.items()}
    columns["episode_return"] = np.zeros((6, 3))
    columns["eval_return"] = np.full((6, 3), np.nan)
    columns["eval_return"][1::2] = [[10.0, 50.0, 0.0], [20.0, 50.0, 5.0], [40.0, 50.0, 37.9]]
    found = paper.evaluated(paper.Run(columns, {"compile_seconds": 100.0}), 38.0)
    np.testing.assert_allclose(found["sim_steps"], [4000 + 2000 * 18 / 20, 2000, np.nan])
    np.testing.assert_allclose(found["with_setup"], [100 + 8 + 4 * 0.9, 104, np.nan])
    del columns["eval_return"]
    never = paper.evaluated(paper.Run(columns, {}), 38.0)
    assert np.isnan(never["iteration"]).all()

    rising = np.arange(1, 41)[:, None]
    keep(tmp_path / "results", "go1_ppo16", rising * [1.0, 1.1])
    keep(tmp_path / "results", "go1_dyna2", rising * [2.0, 1.9])
    keep(tmp_path / "earlier", "go1_ppo16", rising * [0.9, 0.8])
    rows = script("14_efficiency").build(tmp_path / "results", None)
    tail = paper.pick(rows, threshold="paper, 30.5", variant="dyna2")
    ours, pooled = [16, 17], [31, 28, 34, 39]  # iterations, of 1000 steps
    assert tail["pooled_pct"] == pytest.approx(100 * np.mean(ours) / np.mean(pooled))
    assert tail["pooled_p"] == pytest.approx(stats.welch_of(ours, pooled))
    assert tail["share_of_ppo16_pct"] == pytest.approx(100 * np.mean(ours) / np.mean(pooled[:2]))
    evaluated = paper.pick(rows, threshold="evaluated", variant="dyna2")
    assert evaluated["success_rate_pct"] == 0 and "pooled_p" not in evaluated


# Measurements


@pytest.mark.slow
def test_the_update_that_is_timed_beside_rsl_rl_is_ours_on_the_same_rows(monkeypatch):
    """Returns by a loop; with them and without, one update is the same."""
    peers = script("03_speed/peers")
    monkeypatch.setattr(peers, "UPDATES", 1)
    config = config_lib.load("configs/go1.py:ppo16")
    config.rollout.update(num_envs=64, horizon=6)
    config.ppo.update(hidden=(8,), epochs=1, minibatches=2)
    groups, learner, rows = peers.learners(config)
    static, hyper = groups["highest"]
    calls, batch = peers.ours(static, hyper, learner, rows)
    later = np.append(rows.value[1:], networks.value(static, learner.params, rows.next_obs[-1:]), 0)
    advantage = np.zeros(64)
    for t in reversed(range(6)):
        left = rows.discount[t] * hyper.ppo.gamma
        delta = rows.reward[t] + left * later[t] - rows.value[t]
        advantage = delta + left * hyper.ppo.lambda_ * advantage
        np.testing.assert_allclose(batch.returns[t], advantage + rows.value[t], atol=1e-5)
    assert 0 < np.mean(rows.discount) < 1
    one, other = (call()[0].params for call in calls)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-6), one, other)
    assert (one["std"] != learner.params["std"]).any()


def test_the_simulators_tail_is_what_physics_would_have_written():
    """The control `simulator`, from row 3 on, against rows that are all real; `last` starts there, too."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    key, n_real = jax.random.key(1), jnp.int32(3)
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    whole, _, _ = collect(hyper, state, n_real=jnp.int32(static.rollout.horizon), key=key)
    rows, robots, _ = collect(hyper, state, n_real=n_real, key=key)
    now = state.replace(env_state=robots)
    given = dict(rows=rows, n_real=n_real, start=None, key=key)
    imagine = jax.jit(partial(controls.simulated, env, static=static))
    assert_close(imagine(hyper, now, **given), whole, 1e-6)
    model = jax.jit(partial(controls.from_last, env, static=static))(hyper, now, **given)
    np.testing.assert_allclose(model.obs[3], whole.obs[3], atol=1e-6)
    assert abs(model.obs[4] - whole.obs[4]).max() > 1e-3
    with pytest.raises(SystemExit, match="expected one of last, simulator, ensemble"):
        controls.put_in("first")


def test_commands_that_are_spread_follow_each_other_and_fill_the_ranges(monkeypatch):
    """The control `spread`, by the task's own resets: where the shipped reset tells a new command, the last
    one moved on by the same step, else the same; of 64 each eighth of a range has its share."""
    controls = script("21_less/controls")
    settings = config_lib.validate(config_lib.load("configs/go1.py:few"))
    _, hyper = splitting.split(settings)
    given = robot_lib.load("go1"), settings.task, settings.physics
    shipped = env_lib.make(*given)
    for module, name, other in controls.CONTROLS["spread"]:
        monkeypatch.setattr(module, name, other)
    env = env_lib.make(*given)
    body = env.randomize(hyper, jax.random.key(0))
    state = env.reset(hyper, body, jax.random.key(1))
    np.testing.assert_array_equal(
        state.command, shipped.reset(hyper, body, jax.random.key(1)).command
    )
    ends = Outcome(
        reward=jnp.zeros(()),
        discount=jnp.ones(()),
        truncation=jnp.ones(()),
        next_obs=state.obs,
        next_prop=state.prop,
        episode_return=jnp.zeros(()),
        episode_length=jnp.float32(125),
    )
    told, same = [state.command], 0
    for k in range(8):
        after, by_chance = (
            one.autoreset(hyper, body, state, ends, jax.random.key(10 + k))
            for one in (env, shipped)
        )
        if (by_chance.command == state.command).all():
            np.testing.assert_array_equal(after.command, state.command)
            same += 1
        else:
            step = (np.asarray(state.command) + 1) / 2 + np.array(controls.SPREAD)
            np.testing.assert_allclose(after.command, 2 * (step % 1) - 1, atol=1e-5)
            told.append(after.command)
        state = after
    assert same and len(told) > 3 and not controls.before
    every = (0.3 + np.outer(np.arange(64), controls.SPREAD)) % 1
    counts = [np.histogram(x, 8, (0, 1))[0] for x in every.T]
    assert all(6 <= n <= 10 for some in counts for n in some)  # 8 each; by chance 3 to 14


def test_members_of_an_ensemble_write_a_row_each_and_the_most_doubtful_tails_end():
    """Of three equal models: the row of one, whoever writes it, and nobody is in doubt. Of three others: each
    robot's row is that of one of them, and those that end are the ones in whom they differ most."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    start = dynamics.tail(static, env, state.env_state)
    keys = jax.random.split(jax.random.key(1), len(start.obs))
    action = jax.random.normal(jax.random.key(2), (len(keys), env.action_size))

    def written(model, end=False):
        step = controls.by_members(end, static, hyper, env, model)
        return jax.jit(step)(start, action, keys)[1]

    models = controls.inits(static, env, jax.random.key(3))
    ones = [jax.tree.map(lambda x, k=k: x[k], models) for k in range(controls.MEMBERS)]
    alone = [dynamics.step(static, hyper, env, one)(start, action, keys)[1] for one in ones]
    same = written(jax.tree.map(lambda x: jnp.stack([x[0]] * len(x)), models))
    np.testing.assert_allclose(same.next_prop, alone[0].next_prop, atol=1e-6)
    props = np.stack([row.next_prop for row in alone])
    found = written(models, end=True)
    near = abs(props - np.asarray(found.next_prop)).max(-1).argmin(0)
    np.testing.assert_allclose(found.next_prop, props[near, np.arange(len(near))], atol=1e-6)
    assert len(keys) < 8 or len(set(near)) > 1
    (_, (_, scale)) = dynamics.scales(static, ones[0])
    doubt = (props.std(0) / np.asarray(scale)[: env.prop_size]).mean(-1)
    ends = np.asarray(found.truncation) == 1
    assert ends.any() and doubt[ends].min() >= doubt[~ends].max()


def test_real_rows_learn_nothing_from_a_tail_that_begins_elsewhere():
    """The control `real-again`, 5 real rows of 8: in a later round advantages and returns of real rows are
    those of a rollout that ends with them, and they weigh 1; in the first all is as shipped."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL | {"schedule.rounds": 2})
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    rows, _, _ = collect(hyper, state, n_real=jnp.int32(8), key=jax.random.key(1))
    real = (jnp.arange(8) < 5)[:, None]
    rows = rows.replace(reward=jnp.where(real, rows.reward, 1e3))
    given = static, hyper, env, state.learner.params
    again, estimate = (
        jax.jit(partial(f, *given)) for f in (controls.of_the_first_round, algorithm.estimate)
    )
    later = again(rows=rows, real=real, of_round=jnp.int32(1))
    alone = estimate(rows=jax.tree.map(lambda x: x[:5], rows), real=real[:5])
    shipped = estimate(rows=rows, real=real, of_round=jnp.int32(1))
    for name in ("advantages", "returns"):
        np.testing.assert_allclose(getattr(later, name)[:5], getattr(alone, name), rtol=1e-5)
        np.testing.assert_array_equal(getattr(later, name)[5:], getattr(shipped, name)[5:])
    assert (abs(shipped.advantages[:5] - alone.advantages).max(0) > 10).any()
    assert (later.weight[:5] == 1).all() and (shipped.weight[:5] == 0).all()
    first = jnp.int32(0)
    one, other = (f(rows=rows, real=real, of_round=first) for f in (again, estimate))
    assert_close(one, other, 1e-6)


def test_a_fit_that_stops_sees_its_own_robots_alone_and_moves_the_moments_once():
    """The control `stopping`: every eighth robot's rows decide, and no weight depends on remembered ones of
    theirs. The moments are those of one update by the other robots."""
    controls, env, rng = script("21_less/controls"), toy_env.make(), np.random.default_rng(0)
    fields = {"model.epochs": 10, "model.memory": 8, "model.remembered": 1, "model.minibatches": 4}
    _, static, hyper = toy_env.settings(toy_env.TAIL | fields)
    model = dynamics.init(static, env, jax.random.key(0))
    sizes = dynamics.examples.input_size(env), env.prop_size + 1 + static.model.falls

    def rows(n):
        x, y = (jnp.float32(rng.normal(2.0, 3.0, (n, 16, size))) for size in sizes)
        return dynamics.examples.Examples(x=x, y=y, weight=jnp.ones((n, 16)), count=jnp.int32(n))

    new, past, unseen = rows(8), rows(2), np.arange(16) % 8 == 0

    def fitted(past):
        draw = lambda key, n: past  # noqa: E731
        return controls.stopped(
            static, hyper, model, new, jnp.int32(10), jax.random.key(1), draw=draw
        )[0]

    fit = jax.jit(fitted)
    found = fit(past)
    far = past._replace(y=past.y + 100.0 * unseen[:, None])
    jax.tree.map(np.testing.assert_array_equal, fit(far), found)
    near = fit(past._replace(y=past.y + 1.0 * ~unseen[:, None])).params
    both = zip(*map(jax.tree.leaves, (near, found.params)), strict=True)
    assert any((a != b).any() for a, b in both)
    shown = np.asarray(new.x[:, ~unseen]).reshape(-1, sizes[0])
    mean, std = dynamics.moments.scale(found.inputs)
    np.testing.assert_allclose(mean, shown.mean(0), rtol=1e-4)
    np.testing.assert_allclose(std, shown.std(0), rtol=1e-4)
    once = 1 - float(hyper.model.stats_decay)
    np.testing.assert_allclose(found.inputs.weight, once, rtol=1e-5)


def test_the_solver_of_an_anymal_on_varied_ground_has_as_many_iterations_as_it_needs(monkeypatch):
    """4 do not do, 10 do (01_four_robots, solver.txt): a few states of its experiment."""
    solver = script("01_four_robots/solver")
    monkeypatch.setattr(solver, "WALKS", 3)
    monkeypatch.setattr(solver, "STEPS", 40)
    few, _, most = solver.errors("anymal_c", (0.2, 0.4)).T
    assert (few > 0.01).any() and (most < 1e-9).all()
    for robot, variant in itertools.product(("anymal_c", "anymal_d"), ("deploy", "laptop")):
        physics = config_lib.load(f"{robot}:{variant}").physics
        assert physics.iterations == solver.ITERATIONS[-1]


def test_the_solvers_errors_are_those_of_its_file():
    page = (EXPERIMENTS / "01_four_robots/README.md").read_text()
    lines = (EXPERIMENTS / "01_four_robots/solver.txt").read_text().splitlines()
    assert len(lines) == 8
    for line in lines:
        robot, friction = re.match(r"(\w+) +friction ([^:]+):", line).groups()
        label = paper.ROBOTS[robot].removeprefix("Unitree ")
        row = next(x for x in page.splitlines() if x.strip().startswith(f"| {label}, {friction} |"))
        found = re.findall(r"iterations ([\d.]+) % ([\d.]+)", line)
        for cell, (share, worst) in zip(row.split("|")[2:-1], found, strict=True):
            shown = [float(x) for x in re.findall(r"[\d.]+", cell)]
            assert shown[0] == float(share) and abs(shown[1] - float(worst)) <= 0.006, line


def test_the_table_of_other_methods_with_few_robots_is_that_of_its_runs():
    found = {}
    with (EXPERIMENTS / "27_few/peers.csv").open() as file:
        for row in csv.DictReader(file):
            pair = float(row["return"]), 100 * float(row["fall_rate"])
            found.setdefault(row["method"], {}).setdefault(int(row["sim_steps"]), []).append(pair)
    lines = (EXPERIMENTS / "27_few/peers.md").read_text().splitlines()
    heads = [
        cell.strip() for cell in next(x for x in lines if x.startswith("| method")).split("|")
    ][3:-2]
    steps = [
        float(number) * {"k": 1e3, "M": 1e6}[unit] for number, unit, *_ in map(str.split, heads)
    ]
    for method, runs in found.items():
        _, _, seeds, *cells, end, _ = (
            cell.strip()
            for cell in next(x for x in lines if x.startswith(f"| {method} |")).split("|")
        )
        shared = [at for at, pairs in runs.items() if len(pairs) == int(seeds)]
        for at, cell in [*zip(steps, cells, strict=True), (max(shared), end.partition(": ")[2])]:
            if cell:
                near = min(shared, key=lambda x: abs(x - at))
                got, falls = np.mean(runs[near], 0)
                assert abs(near - at) < 0.1 * at and cell == f"{got:.1f}, {falls:.0f} %", (
                    method,
                    at,
                )
    best = {m: max(p[0] for pairs in r.values() for p in pairs) for m, r in found.items()}
    assert (
        best["PPO, 24 rows"]
        > best["PPO, 96 rows"]
        >= 38
        > 17.6
        > best["CrossQ"] - 0.1
        > best["SAC"]
    )


def settings_of_peers():
    """peers_table.py, its settings by name, and the words of peers.md."""
    few = EXPERIMENTS / "27_few"
    table = script("27_few/peers_table")
    found = table.settings()
    return table, found, (few / "peers.md").read_text()


def test_the_table_of_settings_of_other_methods_is_the_printed_one(monkeypatch, capsys):
    """And what is whole, cut off or not begun, and the best so far by the rule."""
    table, found, page = settings_of_peers()
    monkeypatch.setattr(sys, "argv", ["peers_table.py"])
    table.main()
    out = capsys.readouterr().out.splitlines()
    lines, said = ([x for x in out if (x[0] == "|") == is_table] for is_table in (True, False))
    part = page.split("## With settings for few robots")[1]
    assert lines == [x for x in part.splitlines() if x[0:1] == "|"] and len(lines) == 2 + len(found)
    assert said[0] == "CrossQ so far: crossq-gamma97, 118.4 k; at the end 39.5"
    assert said[2] == "SAC so far: sac-u16, 409.6 k; at the end 20.0"
    words = " ".join(part.split())
    assert "`crossq-gamma97` is first so far, and of SAC `sac-u16`" in words
    jobs = paper.jobs(EXPERIMENTS / "27_few/peers_tune.txt")
    assert found.keys() - jobs.keys() == {"crossq-u512"} and len(jobs) == 23
    ends = {
        name: {run[-1]["sim_steps"] for run in found[name].seeds} for name in found.keys() & jobs
    }
    assert {len(one.seeds) for name, one in found.items() if name in jobs} == {2}
    whole = [name for name, end in ends.items() if end == {table.asked(jobs[name])}]
    new = [name for name in jobs if name not in found]
    counts = ["", *"one two three four five six seven eight nine ten".split()]
    told = f"{counts[len(whole)].title()} are whole, {counts[len(ends) - len(whole)]} were cut off by the "
    told += f"end of a call, and {counts[len(new)]} have not begun: "
    told += ", ".join(f"`{name}`" for name in new[:-1]) + f" and `{new[-1]}`."
    assert told in words
    assert f"# {len(jobs)} settings, {len(new)} not begun" in page
    told = (
        "`peers_tune.txt` has {} settings of CrossQ and SAC for 64 robots, each to {:.0f} k steps "
    )
    told = told.format(len(jobs), table.STEPS / 1e3)
    told += f"(`crossq-u256` to {table.asked(jobs['crossq-u256']) / 1e3:.0f} k), on tuning seeds 0 and 1."
    assert told in words and {table.asked(job) for job in jobs.values()} == {204_800, 102_400}
    assert {run[0]["seed"] for one in found.values() for run in one.seeds} == {0, 1}
    assert f"counts with twice the {table.STEPS / 1e3:.0f} k steps" in words
    ends = [one.seeds[0][-1]["sim_steps"] / 1e3 for name, one in found.items() if name[:3] == "sac"]
    told = f"not there by its ends, {min(ends):.0f} to {max(ends):.0f} thousand, in any of five settings"
    assert told in " ".join(page.split()) and len(ends) == 5
    assert "then runs on seeds 100 to 102" in words and "runs on seeds 100 to 102" in table.__doc__
    given = (
        "64 updates a step with batches of 256, half of them mirrored, critics 1024 wide as its "
    )
    assert f"CrossQ has {given}authors', gamma 0.98 and a gain of 1.5," in words
    assert jobs["crossq"] == "crossq --updates 64 --batch 256 --mirror"
    source = (EXPERIMENTS / "24_off_policy/crossq.py").read_text()
    for flag in (("width", "int", 1024), ("gamma", "float", 0.98), ("gain", "float", 1.5)):
        assert 'add_argument("--{}", type={}, default={}'.format(*flag) in source
    first = [x for line in (said[1], said[3]) for x in line.partition(": ")[2].split(", ")]
    assert {*first} == {*new, "crossq-u256", "crossq-w2048", "sac-u256"}
    assert (
        "below the level before nine tenths of their steps: `crossq-u256`, `crossq-w2048` and"
        in words
    )


def test_the_rule_of_the_choice_among_settings_of_other_methods():
    """A seed that never gets there counts with twice all steps; a setting that was cut off does not count;
    of equals the higher return decides."""
    table = settings_of_peers()[0]

    def run(seed, *returns, last=204_800.0):
        steps = np.linspace(0, last, len(returns) + 1)[1:]
        rows = zip(steps, returns, strict=True)
        return [{"seed": seed, "sim_steps": k, "return": r, "fall_rate": 0.5} for k, r in rows]

    found = {
        "crossq": table.setting([run(0, 20, 38), run(1, 38, 20)], 204_800),
        "crossq-a": table.setting([run(0, 38, 20), run(1, 20, 20)], 204_800),
        "crossq-b": table.setting([run(0, 37, 37, last=180e3)] * 2, 204_800),
        "crossq-c": table.setting([run(0, 37, 38, last=180e3)] * 2, 204_800),
        "sac": table.setting([run(0, 9, 9, 9)] * 2, 204_800),
        "sac-a": table.setting([run(0, 20, 9, 8, 12, last=190e3)] * 2, 204_800),
        "sac-b": table.setting([run(0, 38, 38, 38)], 204_800),  # one seed
    }
    assert [one.cost / 204_800 for one in found.values()][:3] == [0.75, 1.25, 2]
    assert found["crossq-c"].cost == 180e3 and found["sac-a"].end == pytest.approx(29 / 3)
    assert [name for name, one in found.items() if not one.counts] == ["crossq-b", "sac-b"]
    jobs = dict.fromkeys([*(x for x in found if x[0] == "c"), "crossq-d"], "crossq --mirror")
    jobs |= {"sac": "sac", "sac-a": "sac --gain 1", "sac-b": "sac --gain 2"}
    assert table.best(found, jobs, "crossq") == ("crossq", ["crossq-b", "crossq-d"])
    assert table.best(found, jobs, "sac") == ("sac-a", ["sac-b"])
    assert table.best({}, jobs, "sac") == ("", ["sac", "sac-a", "sac-b"])
    assert table.asked("crossq --steps 102400 --evaluations 16") == 102_400


def test_the_best_settings_of_other_methods_are_chosen_with_a_folder_of_runs(tmp_path, monkeypatch):
    """Of both methods, when all have run: what peers.py then trains on fresh seeds. A run of the folder takes
    the place of an older one if it got farther; a part of one counts, a line or a seed that is not whole does
    not."""
    peers, jobs = script("27_few/peers"), EXPERIMENTS / "27_few/peers_tune.txt"
    head = "job,seed,sim_steps,seconds,return,fall_rate\n"

    def write(name, seed, last, back):
        path = tmp_path / f"runs/{name}-{seed}.csv"
        path.write_text(head + "".join(f"x,{seed},{s},1,{back},0\n" for s in (100e3, last)))

    (tmp_path / "runs").mkdir()
    with pytest.raises(SystemExit, match="crossq-u256, .* must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    for name in paper.jobs(jobs):
        for seed in (0, 1):
            write(name, seed, 204_800, 30)
    for seed in (0, 1):
        write("crossq-gain1", seed, 204_800, 39)
    (tmp_path / "runs/crossq-gain1-1.csv").rename(tmp_path / "runs/crossq-gain1-1.csv.part")
    write("sac-lr3e4", 0, 204_800, 38.5)
    with (tmp_path / "runs/crossq-gain1-1.csv.part").open("a") as file:
        file.write("x,1,2048")
    sooner = tmp_path / "runs/crossq-w2048-0.csv"
    whole = sooner.read_text()
    sooner.write_text(head + "x,0,6400,1,38,0\n")  # and its other seed is not there
    (tmp_path / "runs/crossq-w2048-1.csv").rename(tmp_path / "crossq-w2048-1.csv")
    with pytest.raises(SystemExit, match="crossq-w2048 must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    (tmp_path / "crossq-w2048-1.csv").rename(tmp_path / "runs/crossq-w2048-1.csv")
    sooner.write_text(whole)
    assert peers.table.of_each_method(tmp_path / "runs", jobs) == ["crossq-gain1", "sac-lr3e4"]
    ran = []
    monkeypatch.setattr(peers, "start", lambda to, *rest: ran.append(to.stem))
    words = ["peers.py", str(tmp_path / "fresh"), str(jobs), "--best", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", [*words, "--seeds", "100", "101", "102"])
    peers.main()
    assert ran == ["crossq-gain1-100-102", *(f"sac-lr3e4-{seed}" for seed in (100, 101, 102))]


def test_settings_of_other_methods_with_few_robots_are_as_the_page_says():
    """Beside `few`, beside each other by Welch's test, an earlier run of one, and what SAC forgets."""
    table, found, page = settings_of_peers()
    words = " ".join(page.split())
    level = {x: one.level for x, one in found.items() if np.isfinite(one.level).all()}
    early = {x: np.array([table.runs.first(r, 30) for r in one.seeds]) for x, one in found.items()}

    def at(name, steps):
        return [r["return"] for run in found[name].seeds for r in run if r["sim_steps"] == steps]

    first, tuned = (
        few_of("late", "fresh-late-g")[1].level,
        few_of("parts-cut", "part-whole-g")[1].level,
    )
    needs = sorted((one.mean(), name) for name, one in level.items())
    order = "crossq-gamma97 crossq-u128 crossq-b1024 crossq-scale10 crossq".split()
    assert [name for _, name in needs] == order
    told = "in five settings, after {:.0f} to {:.0f} thousand simulator steps. `few` is there after {:.1f}"
    assert told.format(needs[0][0] / 1e3, needs[-1][0] / 1e3, first.mean() / 1e3) in words
    times = [mean / first.mean() for mean, _ in needs]
    assert f"needs {times[0]:.0f} to {times[-1]:.0f} times its steps" in words
    best = level["crossq-gamma97"]
    told = f"needs {best.mean() / 1e3:.1f} k steps, {best.mean() / 3000:.0f} robot-minutes"
    assert told in words
    told = "That is {:.1f} times the {:.1f} k of `few` (ten fresh seeds, 1000 episodes an evaluation; the "
    told += "tuning seeds 0 to 4: {:.1f}, {:.1f} times)"
    both = first.mean() / 1e3, tuned.mean() / 1e3
    text = told.format(times[0], *both, best.mean() / tuned.mean())
    assert text in words
    told = "others need {:.1f}, {:.1f}, {:.1f} and {:.1f} times as many"
    shown = re.search(r"others need (.+?) times as many", words)[1]
    assert shows(shown, *times[1:])
    assert "need {:.1f} and {:.1f} k, so two say".format(*sorted(best / 1e3)) in words
    ends = [
        end / first.mean() for end in (min(map(min, level.values())), max(map(max, level.values())))
    ]
    assert "need {:.1f} to {:.0f} times the steps of `few`".format(*ends) in words
    last = [run[-1]["return"] for run in found["crossq-gamma97"].seeds]
    assert shows(
        re.search(r"At its end\*\* gamma 0.97 has (.+?)\. `few`", words)[1].replace(
            "gamma 0.97", ""
        ),
        *last,
    )
    text = re.search(r"to a return of 30 more updates .+? of these is shown", words)[0]
    few_30 = [
        next(r["sim_steps"] for r in run if r["return"] >= 30)
        for run in few_of("late", "fresh-late-g")[0]
    ]
    to_30 = [
        early[x].mean() / 1e3 for x in ("crossq-u128", "crossq-w2048", "crossq-scale10", "crossq")
    ]
    assert early["crossq-b1024"].mean() == early["crossq-u128"].mean()
    assert early["crossq-gamma97"].mean() == early["crossq-w2048"].mean()
    told = "bigger batches need {:.1f} k, wider critics and gamma 0.97 {:.1f}, rewards x 10 {:.1f}, the "
    told += "setting that all start from {:.1f} (`few` {:.1f})"
    assert told.format(*to_30, np.mean(few_30) / 1e3) in text
    better = "u128 b1024 w2048 gamma97 scale10".split()
    p30 = [stats.welch_of(early[f"crossq-{x}"], early["crossq"]) for x in better]
    p38 = [stats.welch_of(level[x], level["crossq"]) for x in order[:-1]]
    spans = min(p30), max(p30), min(p38), max(p38)
    assert "p {:.2f} to {:.2f}, to 38 {:.2f} to {:.2f}, uncorrected".format(*spans) in words
    at_102 = {x: np.mean(at(x, 102_400)) for x in found if len(at(x, 102_400)) == 2}
    told = "off at {:.1f} after 102 k, more than any other there; gamma 0.97 has {:.1f}"
    assert told.format(at_102["crossq-w2048"], at_102["crossq-gamma97"]) in words
    assert max(at_102, key=at_102.get) == "crossq-w2048"
    pair = at("crossq", 192_000), at("crossq-gain05", 192_000)
    told = f"stays at {np.mean(pair[1]):.1f} (after 192 k {np.subtract(*map(np.mean, pair)):.1f} less than"
    told += " with 1.5, p "
    assert told + f"{stats.welch_of(*pair):.4f})" in words
    rates = [r["fall_rate"] for run in found["crossq-gain05"].seeds for r in run]
    assert (
        np.median(rates) == 0 and np.mean(rates) < 0.01 and "CrossQ seldom falls and stays" in words
    )
    pair = at("crossq-w512", 204_800), at("crossq", 204_800)
    told = (
        "ends at {:.1f}, with 1024 at {:.1f}, which is not shown to differ (p {:.2f}, uncorrected)"
    )
    assert told.format(*map(np.mean, pair), stats.welch_of(*pair)) in words
    assert all(
        max(run[-1]["sim_steps"] for run in found[x].seeds) < 103e3
        for x in ("crossq-w2048", "crossq-u256", "crossq-u512")
    )
    with (EXPERIMENTS / "27_few/peers_tune_cut.csv").open() as file:
        rows = [(float(row["sim_steps"]), float(row["return"])) for row in csv.DictReader(file)]
    before = [np.mean([r for k, r in rows if k == steps]) for steps in (51_200, 121_600)]
    after = [np.mean(at("crossq", steps)) for steps in (51_200, 121_600)]
    assert max(rows)[0] == 121_600
    told = "had {:.1f} after 51 k, then {:.1f}; after 122 k {:.1f}, then {:.1f}."
    assert told.format(before[0], after[0], before[1], after[1]) in words
    sac = {name: one for name, one in found.items() if name[:3] == "sac"}
    assert len(sac) == 5 and not any(np.isfinite(early[name]).any() for name in sac)
    for rows in (rows for one in sac.values() for rows in one.seeds):
        assert min(r["return"] for r in rows if 26e3 <= r["sim_steps"] <= 51.2e3) < 5
    assert "Between 26 and 51 k each seed has less than 5 in some evaluation" in words
    assert "with 256 updates has nothing after 13 k" in words
    few_rows = few_of("late", "fresh-late-g")[0]
    gaps = [
        np.diff([r["sim_steps"] for r in rows]) / 1e3
        for rows in (found["crossq"].seeds[0], few_rows[0])
    ]
    assert all(np.ptp(gap) == 0 for gap in gaps)
    assert "every {:.1f} k steps, `few` every {:.1f} k".format(*(gap[0] for gap in gaps)) in words
    ended = np.mean([rows[-1]["return"] for rows in few_rows]), few_rows[0][-1]["sim_steps"] / 1e3
    assert "`few` is at {:.1f} after {:.0f} k.".format(*ended) in words
    at_13 = {name: np.mean([run[1]["return"] for run in one.seeds]) for name, one in sac.items()}
    assert at_13.pop("sac-u256") < 0 and min(at_13.values()) > 8
    ends = {name: [run[-1]["return"] for run in one.seeds] for name, one in sac.items()}
    means = {name: np.mean(end) for name, end in ends.items()}
    assert (
        f"to {min(means.values()):.1f} to {max(means.values()):.1f} (means of two seeds)" in words
    )
    assert f"it has {min(means.values()):.0f} to {max(means.values()):.0f} then." in words
    assert max(means, key=means.get) == "sac-u16"
    least = min(stats.welch_of(*pair) for pair in itertools.combinations(ends.values(), 2))
    assert f"(p {least:.2f} and more)" in words
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    spans = [f"{x:.0f}" for x in (needs[0][0] / 1e3, needs[-1][0] / 1e3, min(means.values()))]
    most = f"{max(means.values()):.0f}"
    told = (
        f"CrossQ is at 38 after {spans[0]},000 steps (the best setting so far, two tuning seeds), "
    )
    told += (
        f"{times[0]:.1f} times those of `few`, and SAC ends at {spans[2]} to {most}, after 162,000"
    )
    assert told in text
    told = f"at 38 after {spans[0]} to {spans[1]} k), SAC (2; in other settings {spans[2]} to {most} at"
    assert told in text and "9 of 23 settings of CrossQ and SAC have not begun" in text


def test_peers_have_the_task_of_a_config():
    """The robots of SAC, CrossQ and FastTD3: observations, rewards and ends are those of the environment."""
    sac = script("24_off_policy/sac")
    args = types.SimpleNamespace(config="go1:few", set=["physics.impl=c"], gain=1.5)
    trained, evaluated = sac.robots(args)
    assert (trained.observation_size, trained.action_size) == (48, 12)
    assert (
        float(trained._hyper.task.noise.joint_vel)
        > 0
        == float(evaluated._hyper.task.noise.joint_vel)
    )
    state = jax.eval_shape(trained.reset, jax.random.split(jax.random.PRNGKey(0), 3))
    after = jax.eval_shape(trained.step, state, jax.ShapeDtypeStruct((3, 12), jnp.float32))
    assert state.obs.shape == after.obs.shape == after.info["next_obs"].shape == (3, 48)
    assert after.reward.shape == after.done.shape == after.metrics["falls"].shape == (3,)


def test_symmetric_sac_treats_left_and_right_alike():
    """The mirrored observation has the mirrored mean, the spread of the other side, and the same values."""
    sac = script("24_off_policy/sac")
    args = types.SimpleNamespace(config="go1:few", set=["physics.impl=c"], gain=1.5)
    mirrors = sac.robots(args)[0].mirror
    obs, action = (
        jax.random.normal(jax.random.key(1), (5, 48)),
        jnp.linspace(-1, 1, 60).reshape(5, 12),
    )
    image = [
        np.asarray(m.sign) * np.asarray(x)[:, m.index]
        for m, x in zip(mirrors, (obs, action), strict=True)
    ]
    made, plain = sac.networks(mirrors, 48, 12), sac.networks(None, 48, 12)
    key = jax.random.key(0)
    policy, critics = (net.init(key) for net in (made.policy_network, made.q_network))
    logits, other = (
        np.asarray(made.policy_network.apply(None, policy, x)) for x in (obs, image[0])
    )
    np.testing.assert_allclose(
        other[:, :12], mirrors[1].sign * logits[:, :12][:, mirrors[1].index], atol=1e-5
    )
    np.testing.assert_allclose(other[:, 12:], logits[:, 12:][:, mirrors[1].index], atol=1e-5)
    values = [made.q_network.apply(None, critics, *x) for x in ((obs, action), image)]
    np.testing.assert_allclose(*values, atol=1e-5)
    assert np.ptp(logits) > 0.1 and np.ptp(values[0]) > 0.01
    before = [np.asarray(plain.policy_network.apply(None, policy, x)) for x in (obs, image[0])]
    assert np.abs(before[1][:, 12:] - before[0][:, 12:][:, mirrors[1].index]).max() > 0.05
    assert np.abs(before[0] - logits).max() > 0.01


def test_settings_of_other_methods_for_few_robots_are_flags_of_theirs_and_runs_are_whole(
    tmp_path, monkeypatch
):
    """Of two seeds one fails, and leaves what it wrote as a part; one that is there stays."""
    peers, names = script("27_few/peers"), set()
    files = "27_few/peers_tune.txt", "24_off_policy/jobs.txt"
    for line in "".join((EXPERIMENTS / file).read_text() for file in files).splitlines():
        name, method, *given = line.split()
        source = (peers.SCRIPTS / f"{method}.py").read_text()
        flags = [word for word in [*given, *peers.COMMON.split()] if word.startswith("--")]
        assert all(f'add_argument("{flag}"' in source for flag in flags), line
        names.add(name)
    assert len(names) == 23
    assert peers.groups("crossq --mirror", [0, 1]) == [(0, 2)]
    assert peers.groups("sac", [0, 1]) == [(0, 1), (1, 1)]
    with pytest.raises(SystemExit, match=r"--seeds is \[0, 2\], expected seeds that follow"):
        peers.groups("crossq", [0, 2])
    assert peers.command(tmp_path, "crossq --mirror", 5, 3)[-3:] == ["5", "--num-seeds", "3"]
    (tmp_path / "fake.py").write_text(
        "import sys; from pathlib import Path; given = ' '.join(sys.argv[2:])\n"
        "Path(sys.argv[1]).open('a').write(given); sys.exit(given.endswith('--seed 1'))\n"
    )
    (tmp_path / "jobs.txt").write_text("a fake --updates 3\nb fake\n")
    monkeypatch.setattr(peers, "SCRIPTS", tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    (out / "b-0.csv").write_text("before")
    (out / "a-0.csv.part").write_text("cut off")
    words = ["peers.py", str(out), str(tmp_path / "jobs.txt"), "--workers", "2"]
    monkeypatch.setattr(sys, "argv", words)
    peers.main()
    assert (out / "a-0.csv").read_text() == f"{peers.COMMON} --updates 3 --seed 0"
    assert not (out / "a-1.csv").exists() and (out / "a-1.csv.part").exists()
    assert (out / "b-0.csv").read_text() == "before" and not (out / "b-1.csv").exists()


@pytest.mark.slow  # compiles two programs
def test_seeds_of_crossq_side_by_side_are_each_as_alone(tmp_path, monkeypatch):
    """Robots of one number that drifts, and falls at 3; two seeds in one program, and the second alone. After
    a hundred updates more the last bit of a sum would tell."""
    crossq = script("24_off_policy/crossq")

    class Robots:
        observation_size, action_size, mirror = 2, 1, None

        def state(self, x, steps, reward, done, falls, before, truncation):
            metrics = {"falls": falls, "velocity_error_sq": x**2, "yaw_error_sq": x**2}
            info = {"next_obs": before, "steps": steps, "truncation": truncation}
            obs = jnp.stack([x, steps / 10], -1)
            return crossq.sac.envs.State(
                pipeline_state=None, obs=obs, reward=reward, done=done, metrics=metrics, info=info
            )

        def reset(self, keys):
            x = jax.vmap(jax.random.uniform)(keys)
            zero = jnp.zeros_like(x)
            return self.state(x, zero, zero, zero, zero, jnp.stack([x, zero], -1), zero)

        def step(self, state, action):
            x, steps = state.obs[:, 0] + 0.3 * action[:, 0] + 0.1, state.info["steps"] + 1
            falls, late = (abs(x) > 3).astype(float), (steps >= 20).astype(float)
            before, done = jnp.stack([x, steps / 10], -1), jnp.maximum(falls, late)
            x, steps = jnp.where(done > 0, 0.0, x), jnp.where(done > 0, 0.0, steps)
            return self.state(x, steps, -(before[:, 0] ** 2), done, falls, before, late)

    monkeypatch.setattr(crossq.sac, "robots", lambda _: (Robots(), Robots()))
    monkeypatch.setattr(crossq.sac, "LENGTH", 20)
    monkeypatch.setattr(crossq.devices, "own_process", lambda: None)

    def rows(name, *more):
        given = (
            "--config go1:few --robots 4 --updates 3 --batch 16 --width 8 --first 40 --steps 200"
        )
        words = ["crossq.py", str(tmp_path / name), *given.split(), "--evaluations", "2", *more]
        monkeypatch.setattr(sys, "argv", words)
        crossq.main()
        return paper.rows(tmp_path / name)

    both = rows("both.csv", "--seed", "5", "--num-seeds", "2")
    assert [row["seed"] for row in both] == [5, 6, 5, 6]
    assert [row["sim_steps"] for row in both] == [100, 100, 200, 200]
    alone = rows("alone.csv", "--seed", "6")
    for one, other in zip(both[1::2], alone, strict=True):
        assert one["return"] == pytest.approx(other["return"], rel=1e-3)
    assert both[2]["return"] != pytest.approx(both[3]["return"], rel=1e-3)


@pytest.mark.slow  # of an experiment that has been run
def test_crossq_renormalises_batches_and_knows_the_probability_of_its_actions():
    """In training a batch's own moments at first; later, while they are near the running ones, what an
    evaluation gives. The log-probability is that of the change of variables, by a numerical derivative."""
    crossq = script("24_off_policy/crossq")
    norm, rng = crossq.Renorm(), np.random.default_rng(0)
    x = rng.normal(3.0, 2.0, (64, 5)).astype(np.float32)
    start = norm.init(jax.random.key(0), x, False)
    out, after = norm.apply(start, x, True, mutable=["stats"])
    np.testing.assert_allclose(out, (x - x.mean(0)) / np.sqrt(x.var(0) + 1e-3), atol=1e-4)
    after = after["stats"]
    np.testing.assert_allclose(after["mean"], 0.01 * x.mean(0), rtol=1e-4)
    np.testing.assert_allclose(after["var"], 0.99 + 0.01 * x.var(0), rtol=1e-4)
    stats = {"mean": x.mean(0) + 0.3, "var": 1.2 * x.var(0), "steps": jnp.float32(crossq.WARM)}
    late = {"params": start["params"], "stats": stats}
    trained, _ = norm.apply(late, x, True, mutable=["stats"])
    np.testing.assert_allclose(trained, norm.apply(late, x, False), atol=1e-4)

    method = types.SimpleNamespace(actor=crossq.Network((8,), 4))
    obs, key = x[:6], jax.random.key(1)
    actor = method.actor.init(jax.random.key(2), obs, False)
    (action, log_prob), _ = crossq.act(method, actor, obs, key, train=False)
    mean, log_std = np.split(np.asarray(method.actor.apply(actor, obs, False), np.float64), 2, -1)
    std = np.exp(crossq.LOW + 0.5 * (crossq.HIGH - crossq.LOW) * (np.tanh(log_std) + 1))
    raw = np.arctanh(np.asarray(action, np.float64))
    slope = (np.tanh(raw + 1e-6) - np.tanh(raw - 1e-6)) / 2e-6
    density = np.exp(-0.5 * ((raw - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi)) / slope
    np.testing.assert_allclose(log_prob, np.log(density).sum(-1), atol=0.02)


def test_a_teacher_says_what_its_policy_does_in_the_exact_state():
    """The bundled Go1's, against its own NumPy function; noise is not in it, nor what comes later."""
    student, rng = script("29_student/student"), np.random.default_rng(0)
    teacher = policy_file.load(EXPERIMENTS.parent / "robots/go1/policy.npz")
    prop, obs = rng.normal(size=(7, 33)), rng.normal(size=(7, 240))
    robots = types.SimpleNamespace(prop=jnp.float32(prop), obs=jnp.float32(obs))
    said = student.labels(types.SimpleNamespace(prop_size=33), None, teacher)(robots)
    told = policy_file.actor(teacher.params, teacher.activation)
    wanted = told(np.concatenate([prop, obs[:, 33:48]], 1).astype(np.float32))
    np.testing.assert_allclose(said, wanted, atol=1e-4)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (
            "--teacher go1_deploy",
            "sees 225 numbers, onboard-45, 5 readings; expected one that sees the state, 1",
        ),
        (
            "--teacher go1_rough",
            "sees 235 numbers, velocity-48, a height scan; expected one that",
        ),
        ("--teacher go2", "--teacher=go2 is a policy of go2; expected one of go1"),
        (
            "--teacher go1 --config anymal_c:best",
            "is a policy of go1; expected one of anymal_c",
        ),
        (
            "--set task.action_scale=0.3",
            "--teacher=go1 was trained with task.action_scale 0.25 at FL_hip_joint, and the student has 0.3 "
            "and at 11 joints more: the same action would be another motion; --set task.action_scale=0.25",
        ),
        (
            "--set task.kp={'.*_calf_joint':30.0,'.*':25.0}",
            "with task.kp 25 at FL_calf_joint, and the student has 30 and at 3 joints more",
        ),
        (
            "--set task.kd=0.6",
            "was trained with task.kd 0.5 at FL_hip_joint, and the student has 0.6",
        ),
        (
            "--set physics.substeps=5",
            "acts every 0.02 s and the student every 0.025 s, by physics.timestep and physics.substeps",
        ),
        ("--teacher nothing", "nothing: no such file or folder; expected a workdir"),
        ("--config nope", "--config: no file 'nope'"),
        ("--set task.nothing=1", "--config.task.nothing: no such field"),
        ("--set task.history", "task.history=''"),
    ],
)
def test_a_student_without_a_fitting_teacher_is_refused_in_one_line(
    argv, said, capsys, monkeypatch
):
    """Before JAX has a device; the line names what was found and what is expected."""
    student = script("29_student/student")
    monkeypatch.setattr(student.devices, "own_process", lambda *_: pytest.fail("it begins"))
    monkeypatch.setattr(sys, "argv", ["student.py", "student.npz", *argv.split()])
    with pytest.raises(SystemExit) as end:
        student.main()
    line = capsys.readouterr().err
    assert end.value.code == 2 and said in line and line.count("\n") == 1, line


def test_a_teacher_of_another_default_pose_is_refused():
    student, robot = script("29_student/student"), robot_lib.load("go1")
    teacher, _ = policy_source.load("go1")
    bent = teacher._replace(default_pose=teacher.default_pose + 0.1 * np.eye(12)[4])
    said = refused(student.check, bent, "go1", config_lib.load("go1:best"), robot)
    assert (
        "was trained with default_pose 0.9 at FR_thigh_joint, and the student has 0.8: the" in said
    )


def test_the_bundled_policies_that_see_the_state_may_teach_their_robots():
    """A biped's has a gait clock."""
    student = script("29_student/student")
    for name in ("go1", "anymal_d", "g1"):
        config = config_lib.load(f"{name}:best")
        student.check(policy_source.load(name)[0], name, config, robot_lib.load(name))


@functools.cache
def of_one_iteration(name):
    """`(std of the policy, metrics)` after an iteration on the toy environment, under a control or none."""
    env, fields = toy_env.make(), {"schedule.rounds": 2, "model.epochs": 5}
    config, static, hyper = toy_env.settings(toy_env.TAIL | fields)
    counts = {k: jnp.asarray(v[-1]) for k, v in schedule.columns(config).items()}
    with pytest.MonkeyPatch.context() as patch:
        for module, function, other in script("21_less/controls").CONTROLS.get(name, []):
            patch.setattr(module, function, other)
        state = algorithm.init(env, hyper, jax.random.key(0), static=static)
        iterate = jax.jit(partial(algorithm.iterate, env, static=static))
        state, metrics = iterate(hyper, state, counts)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(state.learner.params))
    return state.learner.params["std"], metrics


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ensemble-end", "stopping", "real-again"])
def test_an_iteration_under_a_control_learns_and_is_not_the_shipped_one(name):
    """Finite, and another policy."""
    std, metrics = of_one_iteration(name)
    assert np.isfinite(metrics["model_loss"]) and (std != of_one_iteration("")[0]).any()


def test_errors_of_the_model_are_those_of_a_loop(monkeypatch):
    """Two predicted numbers of four robots, three rows; a robot that fell is not counted any more."""
    probe, rng = script("11_model/probe"), np.random.default_rng(0)
    rows = dict(action=rng.normal(size=(3, 4, 1)), next_prop=rng.normal(size=(3, 4, 2)))
    rows |= dict(reward=rng.normal(size=(3, 4)), discount=np.ones((3, 4)))
    rows = types.SimpleNamespace(**rows, truncation=np.zeros((3, 4)))
    rows.discount[1, 2], rows.next_prop[2, 2] = 0, np.nan  # whatever it does after

    def predict(static, hyper, env, model, obs, action):
        return jnp.concatenate([0.5 * obs[:, :2], action], -1), 2 * obs[:, 0], None

    monkeypatch.setattr(probe.dynamics, "predict", predict)
    env, obs = types.SimpleNamespace(prop_size=2, action_size=1, dt=0.1), rng.normal(size=(4, 3))
    rmse, spread = probe.errors(None, None, env, None, rows, obs)
    robots = [0, 1, 2, 3]
    for k in range(3):
        reward, prop = 2 * obs[:, 0] / 0.1, 0.5 * obs[:, :2]
        robots = [r for r in robots if rows.discount[k, r]]
        truth, real = rows.next_prop[k][robots], rows.reward[k][robots] / 0.1
        wrong = [((prop[robots] - truth) ** 2).mean(), ((reward[robots] - real) ** 2).mean()]
        np.testing.assert_allclose(rmse[k], np.sqrt(wrong), rtol=1e-5)
        np.testing.assert_allclose(spread[k], (np.sqrt(truth.var(0).mean()), real.std()), rtol=1e-5)
        obs = np.concatenate([prop, rows.action[k]], -1)


def test_swings_are_those_that_begin_and_end():
    gait = script("16_gaits/gait")
    air = np.array([[1, 1, 0, 1, 1, 0, 0, 1, 0, 1], [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]], bool).T
    np.testing.assert_array_equal(gait.air_phases(air), [2, 1])


def test_no_seed_that_falls_is_left_out_of_the_gaits(tmp_path):
    """Four seeds of each method walk, fall late, fall at once, creep; at 200 all of the tail walk."""
    plot, nan = script("16_gaits"), np.nan
    ends = [(0.1, nan, 0.9), (0.2, 5.0, 0.8), (nan, 0.6, nan), (0.7, nan, 0.49)]
    names = (
        "tracking_error fall speed_ahead air_time tilt swings_per_second yaw_error distance".split()
    )
    rows = []
    for variant, iteration in itertools.product(plot.VARIANTS, (100, 200)):
        for seed, end in enumerate(ends):
            good = (variant, iteration) == ("dyna4", 200)
            row = {"variant": variant, "iteration": iteration, "speed": 1.0, "seed": seed}
            numbers = (*(ends[0] if good else end), 0.1 + 0.01 * seed, 2.0, 3.0, 0.0, 9.0)
            rows.append(row | dict(zip(names, numbers, strict=True)))
    paper.write(tmp_path / "episodes.csv", rows)
    episodes = plot.load(tmp_path / "episodes.csv")
    some = plot.at(episodes, "ppo16", 1.0, 100)
    assert plot.numbers(some, "tracking_error") == [0.1, 0.2, 1.0, 0.7]  # 1.0: as if it stood still
    assert [e["walks"] for e in some] == [1, 0, 0, 0]
    np.testing.assert_array_equal(plot.numbers(some, "air_time"), [0.1, nan, nan, nan])
    first = plot.walkers(episodes, "go1", 1.0)
    assert (first["ppo16_first"], first["dyna4_first"]) == ("100 nan nan nan", "100 200 200 200")
    assert first["p"] == stats.rank_sum([100, nan, nan, nan], [100, 200, 200, 200])


def test_errors_that_fall_and_grow_are_ratios_of_one_run():
    """Two seeds, two iterations: an error halves, and four steps have three times that of one."""
    plot = script("11_model")
    rows = [(i, s, k) for i in (5, 100) for s in (0, 1) for k in plot.STEPS]
    iteration, seed, steps = np.array(rows, float).T
    errors = {
        "iteration": iteration,
        "seed": seed,
        "steps": steps,
        "group": np.full(len(rows), "a"),
    }
    errors["rmse"] = (1 + seed) * np.where(iteration == 5, 2, 1) * (1 + 2 * np.log2(steps) / 2)
    cells = paper.pick(plot.claims("go1", errors), steps=4)
    assert cells["at_100_by_first_mean"] == pytest.approx(0.5)
    assert cells["by_one_step_mean"] == pytest.approx(3)
    assert (cells["by_one_step_sd"], cells["grows_at"], cells["of"]) == (pytest.approx(0), 2, 2)


def test_tails_overlap_the_next_rollouts():
    """By hand, from numbers of a buffer: a tail's row is compared with where physics went."""
    plot, rng, buffers = script("18_rollouts"), np.random.default_rng(0), []
    for i in range(plot.KEPT):
        obs, one = np.zeros((24, 4, 48)), np.ones((24, 4))
        obs[..., plot.ROWS["command"].start] = [0.2, 0.9, 0.5, 0.7 + (i == 3)]  # the last anew
        one[3, 1] = one[20, 2] = 0  # the fastest falls; in a tail, where physics does not
        buffer = dict(obs=obs, next_prop=rng.normal(size=(24, 4, 33)), reward=one, discount=one)
        buffers.append(types.SimpleNamespace(**buffer, truncation=0 * one))
    assert plot.steady(buffers).tolist() == [True, False, True, False]
    row, k = plot.rows(buffers, 0.02)[40], plot.CURVES["calf"][0]
    assert float(row["time"]) == pytest.approx(0.5)  # 8 + 17 rows
    assert float(row["calf"]) == pytest.approx(buffers[1].next_prop[16, 2, k], rel=1e-4)
    went = [buffers[i + 2].next_prop[7, [0, 2], k] for i in range(plot.TAILS)]
    for name, t in (("calf_tail", 23), ("calf_still", 7)):
        said = [buffers[i].next_prop[t, [0, 2], k] for i in range(plot.TAILS)]
        expected = np.sqrt(np.mean(np.subtract(said, went) ** 2))
        assert float(plot.distance(buffers)[15][name]) == pytest.approx(expected, rel=1e-3)


def test_rollouts_are_kept_as_they_are_while_a_model_learns():
    """On the toy: eight real rows, a tail of four, and the policy stays."""
    record = script("18_rollouts/run")
    small = {"rollout.horizon": 12, "model.clean": True, "model.minibatches": 3}
    _, static, hyper = toy_env.settings(toy_env.TAIL | small)
    env = toy_env.make()
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    iterate, i = partial(record.iterate, env, static=static), jnp.int32(12)
    after, buffer = jax.eval_shape(iterate, hyper, state, i, i)
    assert jax.tree.structure(after) == jax.tree.structure(state)
    assert buffer.reward.shape == (12, 16)


# All of it


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_every_folder_runs_on_two_cores_and_again_from_what_is_there(tmp_path):
    """In a working directory of its own."""
    for name in ("configs", "robots"):
        (tmp_path / name).symlink_to(ROOT / name)
    for folder in FOLDERS:
        script = next(n for n in ("run.py", "plot.py") if (EXPERIMENTS / folder / n).exists())
        command = [sys.executable, EXPERIMENTS / folder / script, "--quick"]
        out = tmp_path / "runs" / "quick" / folder
        subprocess.run(command, check=True, cwd=tmp_path, timeout=900)
        first = (out / "results.csv").read_bytes()
        trained = {p: p.stat().st_mtime_ns for p in out.glob("results/*")}
        subprocess.run(command, check=True, cwd=tmp_path, timeout=60)
        assert (out / "results.csv").read_bytes() == first
        assert {p: p.stat().st_mtime_ns for p in out.glob("results/*")} == trained
        assert list(out.glob("*.png"))


def test_the_table_of_crossings_adds_tries_up():
    """By hand: rows of stairs, up and down, and of ground that has no size."""
    crossing = script("28_rough/crossing")
    sizes = ["0.05", "0.1", "0.18"]
    rows = [
        dict(policy=policy, kind=kind, row=row, size=size, tries=4, crossed=crossed, fell=fell)
        for policy, kind, crosses in (
            ("a.0", "pyramid_stairs", (4, 3, 0)),
            ("a.0", "pit_stairs", (2, 1, 2)),
            ("a.0", "random", (4, 0, 0)),
            ("b.0", "pyramid_stairs", (0, 0, 0)),
        )
        for row, (crossed, size) in enumerate(zip(crosses, sizes, strict=True))
        for size, fell in [("" if kind == "random" else size, 1)]
    ]
    _, heads, one, other = (line.split() for line in crossing.table(rows))
    assert heads == "policy all fell pyr_st pit_st random stairs>=0.10 stairs>=0.18".split()
    # 16 of 36; 7 of 12 and 3 of 4 in the middle; 5 of 12; 4 of 12; of the two steepest rows 6 of 16; 2 of 8
    assert one == "a.0 44 25 58/75 42/25 33/0 38 25".split()
    assert other == "b.0 0 25 0/0 -/- -/- 0 0".split()


def crossings(name, seed, steps, crossed, boxes, first_stairs=1.0):
    """A row of 28_rough's results: of all kinds but boxes, and of stairs above 0.10 m, all as told."""
    stairs = " ".join([str(first_stairs)] * 3 + ["0"] * 7)
    kinds = dict.fromkeys(("random", "pyramid_slope", "pit_slope"), " ".join(["1"] * 10))
    kinds |= dict(
        pit_stairs=stairs, pyramid_stairs=stairs, boxes=" ".join(["0"] * 4 + boxes + ["0"] * 4)
    )
    told = dict(name=name, seed=seed, job="go2:rough run.seed=0", sim_steps=str(steps))
    return told | kinds | dict(crossed=str(crossed), fell=str(round(1 - crossed, 3)))


def test_a_run_on_rough_ground_has_the_crossings_and_the_row_of_each_seed(tmp_path, monkeypatch):
    """A program of two calls by hand, three seeds: the row is the mean since the evaluation before, [I, S];
    the second seed's loss is not finite from iteration 3 on. With one seed nothing has an axis of seeds."""
    rough = script("28_rough/run")
    monkeypatch.setattr(rough.less.build, "check", lambda config: None)
    fields = "run.seed=5 run.num_iterations=4 run.eval_every=2 run.num_seeds=".split()
    shares = {"crossed": 0.0, "fell": 0.5, "boxes": "0.250 1.000"}

    def tries(config):
        return lambda params: shares | {"crossed": params["x"].item() / 8}

    def step(axes, hyper, state, chunk):
        row = 10.0 * np.arange(3) + chunk["iteration"][:, None]
        loss = np.where((np.arange(3) == 1) & (chunk["iteration"][:, None] > 2), np.nan, 1.0)
        told = {"terrain_row": row, "value_loss": loss}
        return state, {name: x if axes else x[:, 0] for name, x in told.items()}

    monkeypatch.setattr(rough, "tries", tries)
    for seeds in (3, 1):
        params = {"x": np.arange(1, 4) if seeds > 1 else np.array(1)}
        program = types.SimpleNamespace(
            state=types.SimpleNamespace(learner=types.SimpleNamespace(params=params)),
            hyper=None,
            step=partial(step, seeds > 1),
            columns={"iteration": np.arange(1, 5)},
            evaluate=None,
        )
        monkeypatch.setattr(rough.less.build, "program", lambda config, program=program: program)
        job = [*fields[:-1], f"{fields[-1]}{seeds}"]
        rough.less.run(tmp_path / str(seeds), "go2:rough", job, evaluation=rough.of_seeds)
        with (tmp_path / f"{seeds}.csv").open() as file:
            told = [*csv.DictReader(file)]
        assert [(row["iteration"], row["seed"]) for row in told] == [
            (str(i), str(5 + s)) for i in (2, 4) for s in range(seeds)
        ]
        rows = [i - 0.5 + 10 * s for i in (2, 4) for s in range(seeds)]
        assert [float(row["terrain_row"]) for row in told] == rows
        assert [float(row["crossed"]) for row in told] == [(1 + s) / 8 for s in range(seeds)] * 2
        assert {(row["fell"], row["boxes"]) for row in told} == {("0.5", "0.250 1.000")}
    assert not (tmp_path / "1.log").exists()
    line = "seed 1: value_loss is not finite in iteration 3\n"
    assert (tmp_path / "3.log").read_text() == line


ROUGH_CONTROLS = {  # jobs of 28_rough -> those of which they change one field, and that field
    "no-end": ("known", "task.ground_in_tail", "no_end"),
    "blind-model": ("known", "task.ground_in_tail", "blind"),
    "frozen": ("known", "task.ground_in_tail", "frozen"),
    "ppo-gamma": ("ppo-4096", "ppo.gamma", 0.99),
    "ppo-kl1": ("ppo-4096", "ppo.desired_kl", 0.01),
}


def test_jobs_on_rough_ground_are_valid_and_a_control_changes_one_thing():
    """No job is another's, but that `known` has seeds of its own; smaller steps begin after three fifths of a
    run."""
    found = {}
    for file in ("jobs", "tuning"):
        for line in (EXPERIMENTS / f"28_rough/{file}.txt").read_text().splitlines():
            name, job, *fields = line.split()
            config = config_lib.load(job)
            for field in fields:
                config_lib.override(config, *field.split("=", 1))
            config = config_lib.validate(config)
            late, steps = config.schedule.late_from, schedule.sim_steps(config)
            share = 0.35 if name == "anc-late200" else 0.6  # which asks whether sooner is better
            assert late is None or steps[late - 1] / steps[-1] == pytest.approx(share, abs=0.01), (
                name
            )
            task = {k: x for k, x in config_lib.flat(config).items() if not k.startswith("run.")}
            assert name not in found
            task["iterations"] = config.run.num_iterations
            same = [other for other, its in found.items() if its == task]
            robot, _, what = name.partition("-")
            assert same == ([f"{robot}-best"] if what == "known" else []), name
            found[name] = task
    for robot in ("go2", "anymal_c"):
        for name, (of, field, value) in ROUGH_CONTROLS.items():
            mine, other = found[f"{robot}-{name}"], found[f"{robot}-{of}"]
            assert {k: x for k, x in mine.items() if x != other[k]} == {field: value}, name


def test_the_row_in_training_is_kept_where_it_was_read_rightly():
    """Of runs of several seeds until 2026-11-27 that of the last one alone (28_rough/history.md)."""
    table, then = script("28_rough/table"), "first look-where-it-goes parts cell fresh".split()
    for file in ("fresh", "tuning"):
        rows = table.rows(EXPERIMENTS / f"28_rough/results/{file}.csv.xz")
        for row in (row for row in rows if row["batch"] in then):
            fields = dict(field.split("=", 1) for field in row["job"].split()[1:])
            last = int(fields["run.seed"]) + int(fields["run.num_seeds"]) - 1
            assert (row["terrain_row"] != "") == (int(row["seed"]) == last)


def test_the_tables_of_rough_ground_by_hand():
    """A level counts from where it is kept, on stairs up to 0.10 m and in the two middle rows."""
    table = script("28_rough/table")
    good, bad = ["1.0", "0.9"], ["1.0", "0.8"]
    rows = [
        crossings("a", "0", 1_000_000, 0.4, good),
        crossings("a", "0", 2_000_000, 0.5, bad),
        crossings("a", "0", 3_000_000, 0.8, good),
        crossings("a", "1", 1_000_000, 0.7, good),
        crossings("a", "1", 3_000_000, 0.6, good),
        crossings("a", "2", 3_000_000, 0.7, good, first_stairs=0.89),
    ]
    found = [*table.runs(rows)]
    assert [run.level for run in found] == [3.0, 1.0, np.inf]
    assert cells(table.by_seed(found)[2]) == (
        "a 0 2048 3.0 0.80 0.20 1.00 1.00 0.95 1.00 1.00 1.00 3.0".split()
    )
    assert cells(table.by_seed(found)[4])[-1] == "never"
    (mine,) = map(cells, table.by_robot(found)[2:])
    assert mine[:6] == ["a", "3", "0.70 (0.60)", "0.30 (0.40)", "0.96 (0.89)", "0.96 (0.89)"]
    assert mine[6:] == ["0.95 (0.95)", *["1.00 (1.00)"] * 3, "2.0 (3.0)", "2 of 3"]


def test_the_steps_of_ppo_on_rough_ground_by_hand(monkeypatch):
    """Straight lines from 0 at 0; the level first reached and kept; 90 % by one of two seeds of `best`."""
    table = script("28_rough/table")
    monkeypatch.setattr(table, "PPO", {"b": "a"})
    good, bad, million = ["1.0", "0.9"], ["1.0", "0.8"], 1_000_000
    mine = [
        crossings("a", "0", 1 * million, 0.60, bad),
        crossings("a", "0", 2 * million, 0.80, good),
        crossings("a", "0", 3 * million, 0.90, bad),
        crossings("a", "0", 4 * million, 0.88, good),
        crossings("a", "1", 1 * million, 0.80, good),
        crossings("a", "1", 4 * million, 0.86, good),
    ]
    best = table.pace("a", mine)
    assert (best.robots, best.steps) == ("2048", 4.0)
    nan = np.nan
    np.testing.assert_allclose(best.when, [[1.5, 2.0, 3.0, 2.0, 4.0], [0.875, 1.0, nan, 1.0, 1.0]])
    others = [crossings("b", str(s), 10 * million, c, good) for s, c in enumerate((0.7, 1.0, 0.9))]
    ppo = table.pace("b", others)
    np.testing.assert_allclose(ppo.when[0], [10.0, nan, nan, 10.0, 10.0])
    lines = table.beside_ppo({"a": best, "b": ppo})
    assert cells(lines[2])[3:6] == [
        "1.2 (0.9 to 1.5)",
        "1.5 (1.0 to 2.0)",
        "3.0 (3.0 to 3.0; 1 of 2)",
    ]
    name, seeds, at_70, at_80, at_90, level, kept = cells(lines[7])
    assert (name, seeds, at_90) == ("b", "3 and 2", "-")
    expected = stats.ratio(ppo.when[:, 0], best.when[:, 0])
    assert at_70.startswith(f"{expected.value:.1f}") and at_80 == "at least 6.0"
    assert (level, kept) == ("6.7", "4.0")


def test_two_seeds_of_ppo_have_no_interval():
    """Student's t of one degree of freedom says nothing."""
    table = script("28_rough/table")
    some = {"pct": 250.0, "low": -10.0, "high": 900.0}
    assert table.times(some, 2) == "2.5" and table.times(some, 3) == "2.5 (-0.1 to 9.0)"


ROUGH_PAGES = {  # batches of 28_rough -> the page with a line of each of their runs
    "cell": "heights",
    "parts": "history",
    "one-commit": "tail",
    "one-commit-4": "tail",
    "one-commit-5": "robots",
    "one-commit-6": "robots",
    "one-commit-7": "robots",
}


def test_the_pages_of_rough_ground_have_the_tables_of_their_runs():
    """Lines of PPO are in ppo.md, of whatever batch, those of tails in tail.md."""
    table, folder = script("28_rough/table"), EXPERIMENTS / "28_rough"
    page = {path.stem: path.read_text() for path in folder.glob("*.md")}
    packed = table.rows(folder / "results/fresh.csv.xz")
    fresh = [*table.runs([row for row in packed if row["batch"] == "fresh"])]
    assert len(fresh) == 30
    assert "\n".join(table.by_robot(fresh)) in page["README"]
    assert "\n".join(table.beside_ppo(table.paces())) in page["ppo"]
    ppo = table.by_robot([*table.runs([row for row in packed if row["batch"] == "fresh-ppo"])])[2:]
    assert len(ppo) == 2 and all(line in page["ppo"] for line in ppo)
    found, missing = 0, set()
    for batch, where in ROUGH_PAGES.items():
        kept = [row for row in table.rows() if row["batch"] == batch]
        for line in table.by_robot([*table.runs(kept)])[2:]:
            name = cells(line)[0]
            found += 1
            ends = {"ppo": "-ppo-", "tail": "-blind-model", "heights": "anc-"}
            ends = ends if batch == "one-commit-7" else ends | {"heights": "none"}
            if line not in page[next((at for at, end in ends.items() if end in name), where)]:
                missing.add(name)
    cut = "anc-cell5 anc-im2 anc-model512 anc-robots1536 anc-symmetry anymal_c-blind-model"
    assert missing == {*cut.split(), "go2-blind", "anymal_c-blind"}  # cut off, these two once
    assert found == 41 + len(missing)
    lines = {cells(line)[0]: line for line in table.by_robot(fresh)[2:]}
    blind = [row for row in table.rows() if row["batch"] == "one-commit-7"]
    blind = [row for row in blind if row["name"].endswith("-blind")]
    for line in table.by_robot([*table.runs(blind)])[2:]:
        robot = cells(line)[0].partition("-")[0]
        assert f"{line}\n{lines[f'{robot}-best']}\n" in page["robots"]
    first = table.by_seed([*table.runs([row for row in table.rows() if row["batch"] == "first"])])
    assert sum(line in page["history"] for line in first[2:]) == 10


def test_the_short_tables_of_rough_ground_are_those_of_its_pages():
    """PPO beside `best`, and what the tail knows: shares at the end, steps to 70 and 80 % of all tiles."""
    table, folder = script("28_rough/table"), EXPERIMENTS / "28_rough"
    lines = [cells(x) for x in (folder / "README.md").read_text().splitlines() if x[:1] == "|"]
    rows = [*table.rows(folder / "results/fresh.csv.xz"), *table.rows()]
    kept = {*table.TODAY, "one-commit"} - {"one-commit-6"}  # which has controls once more
    rows = [row for row in rows if row["batch"] in kept or "-ppo-" in row["name"]]
    ends = {row[0]: row for row in map(cells, table.by_robot([*table.runs(rows)])[2:])}
    paces = [cells(x) for x in table.beside_ppo(table.paces())]
    robots = {row[0]: row for row in paces if len(row) == 8}
    times = {row[0]: row for row in paces if len(row) == 7}
    five = times["go2-ppo-4096 and late"][3].replace(" (", " times with 4096 (")
    page = " ".join((folder / "README.md").read_text().split())
    assert five.replace(")", "; five seeds)") in page
    assert f"(1024 robots) to {five[:3]} times (4096)" in " ".join(
        (ROOT / "README.md").read_text().split()
    )
    runs = {
        "Go2, PPO": ("go2-ppo-1024", "go2-ppo-2048", "go2-ppo-4096"),
        "Go2, PPO, KL 0.01": ("go2-ppo-kl1",),
        "Go2, PPO, KL 0.006 from 88 M on": ("go2-ppo-late",),
        "Go2, PPO, gamma 0.99": ("go2-ppo-gamma",),
        "ANYmal-C, PPO": ("anymal_c-ppo-2048", "anymal_c-ppo-4096"),
        "ANYmal-C, PPO, KL 0.01": ("anymal_c-ppo-kl1",),
        "Go2, `best`": ("go2-best",),
        "ANYmal-C, `best`": ("anymal_c-best",),
    }
    for title, names in runs.items():
        shown = [row[1:] for row in lines if row[0] == title]
        for name, (many, seeds, steps, share, *when) in zip(names, shown, strict=True):
            assert [many, steps] == robots[name][1:3]
            assert [seeds, share] == [ends[name][1], ends[name][2].split()[0]]
            told = [x.split()[0] for x in robots[name][3:5]]
            told = [f"{x} M" for x in told] if name.endswith("best") else times[name][2:4]
            assert [x.removesuffix(" times") for x in when] == told
    for title, robot in (("Go2", "go2"), ("ANYmal-C", "anymal_c")):
        (shown,) = [row[1:] for row in lines if row[0] == title]
        mine = [ends[f"{robot}-{x}"] for x in ("known", "no-end", "frozen", "blind-model")]
        assert shown == [row[2].split()[0] for row in mine]
        assert ["seeds of each", *(row[1] for row in mine)] in lines


def test_the_errors_along_a_tail_are_those_of_the_page():
    folder = EXPERIMENTS / "28_rough"
    with open(folder / "results/scan.csv", newline="") as file:
        rows = {float(row["seconds"]): row for row in csv.DictReader(file)}
    part = (folder / "tail.md").read_text().split("| seconds of the tail |")[1].split("\n\n")[0]
    heads, _, *lines = (cells(line) for line in ("| |" + part).splitlines())
    at = [rows[float(x)] for x in heads]
    assert [row["step"] for row in at] == ["5", "10", "15", "20"]
    for line, names in zip(lines, ("scan", "frozen", "feet"), strict=False):
        for cell, row in zip(line[1:], at, strict=True):
            told = [float(x) for x in re.findall(r"[\d.]+", cell)]
            expected = [1e3 * float(row[names]), 1e3 * float(row[f"{names}_95"])]
            np.testing.assert_allclose(told, expected, atol=0.51, rtol=0.02)
    for cell, row in zip(lines[3][1:], at, strict=True):
        told = [float(x) for x in cell.split(";")]
        np.testing.assert_allclose(
            told, [1e3 * float(row["position"]), float(row["yaw"])], rtol=0.05
        )
    assert float(rows[0.32]["scan"]) == pytest.approx(0.4 * float(rows[0.32]["frozen"]), rel=0.1)
    assert float(rows[0.32]["scan_95"]) == pytest.approx(
        0.5 * float(rows[0.32]["frozen_95"]), rel=0.06
    )


def test_the_shares_by_kind_and_row_are_those_of_the_page():
    """Each row of the table, recomputed; columns are the heights of `STEPS`."""
    table, folder = script("28_rough/table"), EXPERIMENTS / "28_rough"
    page = (folder / "heights.md").read_text()
    part = page.split("## By kind and row")[1].split("## Finer ground")[0].splitlines()
    heads = cells(next(line for line in part if line.startswith("| run |")))[2:]
    np.testing.assert_allclose([float(x.split()[0]) for x in heads], table.STEPS)
    last = {}
    for row in table.rows(folder / "results/fresh.csv.xz"):
        if row["batch"] == "fresh":
            last[row["name"], row["seed"]] = row  # of several evaluations the last
    lines = [cells(line) for line in part if "-best |" in line]
    assert len(lines) == 16
    for name, kind, *shown in lines:
        each = [row[kind.replace(" ", "_")].split() for key, row in last.items() if key[0] == name]
        expected = np.nanmean(np.array(each, float), 0)
        np.testing.assert_allclose([float(x) for x in shown], expected, atol=0.00501)


def test_the_pages_of_rough_ground_say_what_their_runs_say():
    """What a known end is worth, the controls on the way, ANYmal-C's boxes, whether PPO is later."""
    table, folder = script("28_rough/table"), EXPERIMENTS / "28_rough"
    heights, ppo, tail = (
        " ".join((folder / f"{name}.md").read_text().split()) for name in ("heights", "ppo", "tail")
    )
    lines = (folder / "tail.md").read_text().splitlines()
    rows = [*table.rows(folder / "results/fresh.csv.xz"), *table.rows()]
    of = {}
    again = {}  # controls once more
    for row in rows:
        if row["batch"] in (*table.TODAY, "one-commit"):
            more = row["batch"] == "one-commit-6" and row["name"].endswith("-blind-model")
            runs = again if more else of
            runs.setdefault(row["name"], {}).setdefault(row["seed"], []).append(row)
    worth = {
        "go2": "4.3 points (95 %: 2.0 to 6.5; Welch, p 0.002, by Holm 0.005)",
        "anymal_c": "5.3 points on ANYmal-C (95 %: 1.8 to 8.7; Welch, p 0.011, also by Holm",
    }
    ends = {name: [float(s[-1]["crossed"]) for s in seeds.values()] for name, seeds in of.items()}
    p = []
    for robot, words in worth.items():
        both = ends[f"{robot}-known"], ends[f"{robot}-no-end"]
        assert words in tail
        told = [float(x) for x in re.findall(r"\d\.\d+", words)]
        p.append(stats.welch_of(*both))
        np.testing.assert_allclose(told[:3], 100 * np.array(stats.difference(*both)), atol=0.051)
        assert told[3] == pytest.approx(p[-1], abs=5e-4)
    np.testing.assert_allclose(stats.holm(p), [0.005, 0.011], atol=5e-4)
    # on the way
    found = 0
    for robot, title in (("go2", "Go2"), ("anymal_c", "ANYmal-C")):
        for what in ("known", "no-end", "frozen", "blind-model"):
            (line,) = [x for x in lines if x.startswith(f"| {title}, {what.replace('-', ' ')} |")]
            seeds = of[f"{robot}-{what}"].values()
            each = [np.mean([float(s[i]["crossed"]) for s in seeds]) for i in range(1, 12, 2)]
            each.append(np.mean([float(s[-1]["terrain_row"]) for s in seeds]))
            *shares, row = map(float, cells(line)[1:])
            np.testing.assert_allclose(shares, each[:-1], atol=0.00501)
            assert row == pytest.approx(each[-1], abs=0.0501)
            found += 1
    assert found == 8

    def by_row(name, kind, last=1):
        runs = of[name].values()
        shares = [[s[i][kind].split() for i in range(-last, 0)] for s in runs]
        return np.array(shares, float).mean((0, 1))

    for name, words in (
        ("anymal_c-best", "94, 86, 66, 52, 48 and 22 %"),
        ("anymal_c-ppo-4096", "90, 90, 71, 56, 45 and 26 %"),
        ("anymal_c-ppo-kl1", "98, 94, 82, 66, 56 and 41 %"),
    ):
        assert words in heights
        told = [int(x) for x in re.findall(r"\d+", words)]
        np.testing.assert_allclose(told, 100 * by_row(name, "boxes")[4:], atol=0.51)
    assert "91 % of the middle rows' boxes in the mean" in heights
    assert by_row("anymal_c-ppo-4096", "boxes", 10)[4:6].mean() == pytest.approx(0.91, abs=0.005)
    counts = {
        name: [sum(table.at_level(table.shares(row)) for row in s) for s in of[name].values()]
        for name in ("anymal_c-ppo-4096", "anymal_c-ppo-kl1")
    }
    assert [*counts.values()] == [[3, 4, 5], [14, 14]]
    assert "three to five of 30 evaluations" in heights and "in 14 of 30 evaluations" in heights
    # a KL of 0.01 on ANYmal-C, and one that is smaller late on Go2
    last = {
        what: [
            [np.mean([of_row(row) for row in s[-10:]]) for s in of[f"anymal_c-ppo-{name}"].values()]
            for name in ("kl1", "4096")
        ]
        for what, of_row in (
            ("boxes", lambda row: table.shares(row)["boxes"]),
            ("all", lambda row: float(row["crossed"])),
        )
    }
    means = [100 * np.mean(some) for k in (0, 1) for some in (last["boxes"][k], last["all"][k])]
    text = "they cross {:.0f} % of the middle rows' boxes and {:.0f} % of all tiles in the mean"
    text += ", where the three have {:.0f} and {:.0f} (Welch, p {:.2f} and {:.2f}, not corrected)"
    assert text.format(*means, *(stats.welch_of(*last[x]) for x in ("boxes", "all"))) in heights
    for text, one, other in (
        (
            "{:.1f} points more than with 0.02 and as many robots ({:.1f} to {:.1f}; Welch, p {:.2f})",
        )
        + ("anymal_c-ppo-kl1", "anymal_c-ppo-4096"),
        ("({:.1f} points more, {:.1f} to {:.1f}; Welch, p {:.2f})", "go2-ppo-late", "go2-ppo-4096"),
    ):
        found = 100 * np.array(stats.difference(ends[one], ends[other]))
        assert text.format(*found, stats.welch_of(ends[one], ends[other])) in ppo, text
    late = [
        [round(100 * float(s[i]["crossed"])) for i in (17, 21)] for s in of["go2-ppo-late"].values()
    ]
    assert late == [[94, 98]] * 2 and "go from 94 to 98 % within 20 M steps" in ppo
    told = [100 * float(s[-1]["crossed"]) for s in again["go2-blind-model"].values()]
    assert "cross {:.0f} and {:.0f} % instead of 47 and 41".format(*told) in tail
    told = [
        100 * float(s[5]["crossed"])
        for runs in (again, of)
        for s in runs["anymal_c-blind-model"].values()
    ]
    assert "with {:.0f} and {:.0f} %; before it was {:.0f} and {:.0f} %".format(*told) in tail
    # without a scan, and ANYmal-C with smaller steps
    robots = " ".join((folder / "robots.md").read_text().split())
    for row in rows:
        if row["batch"] == "one-commit-7":
            name = row["name"].replace("-blind", "-no-scan")
            of.setdefault(name, {}).setdefault(row["seed"], []).append(row)
    ends = {
        name: [100 * float(s[-1]["crossed"]) for s in seeds.values()] for name, seeds in of.items()
    }
    told = {
        robot: [*ends[f"{robot}-no-scan"], min(ends[f"{robot}-best"]), max(ends[f"{robot}-best"])]
        for robot in ("go2", "anymal_c")
    }
    text = "cross {:.0f} and {:.0f} % of all tiles, ten with a scan {:.0f} to {:.0f} %"
    assert text.format(*told["go2"]) in robots
    text = "{:.0f} and {:.0f} % of all tiles, every one of ten with a scan more, {:.0f} to {:.0f}"
    assert text.format(*told["anymal_c"]) in robots
    p = stats.rank_sum(ends["anymal_c-no-scan"], ends["anymal_c-best"])
    assert f"Whitney's p {p:.2f}" in robots
    five = [ends[f"{robot}-known"] for robot in ("go2", "anymal_c")]
    text = "cross {:.0f} to {:.0f} % (Go2) and {:.0f} to {:.0f} % (ANYmal-C); seeds 0 and 1 of them"
    text += " {:.0f} and {:.0f}, and {:.0f} and {:.0f} %"
    sides = [side(some) for some in five for side in (min, max)]
    assert text.format(*sides, *(some[k] for some in five for k in (0, 1))) in robots
    for text, robot, kind, row in (
        ("of 0.17 m they climb {:.0f} instead of {:.0f} %", "go2", "pit_stairs", 6),
        ("of 0.19 m {:.0f} instead of {:.0f}. - **An", "go2", "pit_stairs", 7),
        ("stairs up of 0.19 m, {:.0f} instead of {:.0f} %", "anymal_c", "pit_stairs", 7),
        ("of 0.23 m it goes in {:.0f} instead of {:.0f} %", "anymal_c", "pyramid_stairs", 9),
    ):
        pair = [100 * by_row(f"{robot}-{what}", kind)[row] for what in ("no-scan", "best")]
        assert text.format(*pair) in robots, text
    boxes = {
        name: [100 * table.shares(s[-1])["boxes"] for s in of[name].values()]
        for name in ("anymal_c-no-scan", "anymal_c-best", "anc-kl1", "anc-late200")
    }
    means = [np.mean(boxes[name]) for name in ("anymal_c-no-scan", "anymal_c-best")]
    assert "boxes, {:.0f} instead of {:.0f} % in the middle rows".format(*means) in robots
    text = "cross {:.0f} and {:.0f} % of these boxes, with the smaller one from iteration 200 on"
    text += " instead of 350 (`anc-late200`) {:.0f} and {:.0f} %, ten with `best` {:.0f} to {:.0f}."
    best = boxes["anymal_c-best"]
    assert text.format(*boxes["anc-kl1"], *boxes["anc-late200"], min(best), max(best)) in heights
    readme = " ".join((folder / "README.md").read_text().split())
    text = "Smaller steps do not bring `best` there in 10 M: {:.0f} and {:.0f} %"
    assert text.format(*(np.mean(boxes[name]) for name in ("anc-kl1", "anc-late200"))) in readme
    means = [np.mean(ends[f"{x}-{y}"]) for x in ("go2", "anymal_c") for y in ("no-scan", "best")]
    text = "two Go2 cross {0:.0f} % of all tiles, two ANYmal-C {2:.0f} %"
    assert text.format(*means) in readme
    text = "two Go2 crossed {:.0f} % of all tiles, where ten with it cross {:.0f}, and two ANYmal-C"
    text = (text + " {:.0f}, where ten cross {:.0f}").format(*means)
    assert text in " ".join((ROOT / "docs/terrain.md").read_text().split())
    assert "it climbs in 7 % at its end, with 4096 robots in 94 %; `best` in 49 %" in ppo
    for name, share in (("go2-ppo-1024", 7), ("go2-ppo-4096", 94), ("go2-best", 49)):
        assert 100 * by_row(name, "pit_stairs")[7] == pytest.approx(share, abs=0.51)
    # every seed of PPO after every seed of `best`
    paces = table.paces()
    for name, best in table.PPO.items():
        for i in (0, 1, 3) if best == "go2-best" else (0, 1):
            one, other = paces[name].when[:, i], paces[best].when[:, i]
            assert one.min() > other.max()
            p = {3: 0.007, 2: 0.03}[len(one)]
            assert stats.rank_sum(one, other) <= p + 5e-4


def test_the_picture_of_rough_ground_is_drawn_from_all_that_it_names(drawn, monkeypatch):
    plot, curves = script("28_rough/plot"), []
    monkeypatch.setattr(plot, "curve", lambda axis, mine, what, label, *_: curves.append(label))
    plot.main()
    assert drawn == ["crossed", "scan"] and (EXPERIMENTS / "28_rough/crossed.png").exists()
    assert len(curves) == 15 and set(curves) == {look[0] for look in plot.LOOKS.values()}


def test_a_kernel_is_told_by_its_line_and_operation(tmp_path):
    kernels = importlib.import_module("experiments.28_rough.kernels")

    def wave(x):
        return jnp.sin(x @ x)

    kept = jax.config.jax_traceback_in_locations_limit
    jax.config.update("jax_traceback_in_locations_limit", 10)  # conftest.py leaves places out
    try:
        compiled = jax.jit(wave).lower(jnp.ones((64, 64))).compile()
    finally:
        jax.config.update("jax_traceback_in_locations_limit", kept)
    said = kernels.computes(compiled.as_text())
    for operation in (
        "dot_general",
        "sin",
    ):  # lines are those of the run that compiled it (conftest.py)
        assert any(re.fullmatch(rf"test_experiments.py:\d+ {operation}", x) for x in said.values())
    with jax.profiler.trace(tmp_path):
        for _ in range(3):
            jax.block_until_ready(compiled(jnp.ones((64, 64))))
    took, launches = kernels.kernels(next(tmp_path.rglob("*.xplane.pb")))
    ran = [name for name in took if said.get(kernels.plain(name), "").endswith("dot_general")]
    assert ran and all(launches[name] == 3 and took[name] > 0 for name in ran)


def test_what_a_rough_row_costs_is_as_the_page_says():
    kernels = importlib.import_module("experiments.28_rough.kernels")
    folder = EXPERIMENTS / "28_rough"
    page = (folder / "time.md").read_text()
    assert kernels.table(paper.rows(folder / "results/kernels.csv")) in page
    words, readme = (" ".join(text.split()) for text in (page, (folder / "README.md").read_text()))
    for name in ("bench", "bench_blind"):
        measured = json.loads((folder / f"results/{name}.json").read_text())["configs"]
        rough, flat = (measured[config]["ms"] for config in ("go2:rough", "go2"))
        row = rough["physics"], flat["physics"]
        assert f"{row[0] / row[1]:.2f} times" in words and f"{row[0] / row[1]:.2f}" in readme
        assert (row[0] / row[1] < 1.5) == (name == "bench_blind")  # the goal
        assert {measured[config]["commit"] for config in measured} == {"a6010c447993-dirty"}
        assert "({:.3f} instead of {:.3f} ms)".format(*row) in words
    with_scan = json.loads((folder / "results/bench.json").read_text())["configs"]
    tails = (with_scan[config]["ms"]["tail"] for config in ("go2:rough", "go2"))
    assert "a row of the tail takes {:.3f} instead of {:.3f} ms".format(*tails) in words

"""10 to 18: the scripts of the paper's tables and figures, on the results that are there and on numbers known
by hand. What trains is `-m slow`: every folder's `run.py --quick`, twice.
"""

import csv
import itertools
import json
import lzma
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
from result_files import EXPERIMENTS, ROOT, script

from dynappo import algorithm, schedule
from dynappo import config as config_lib
from dynappo.learner import networks
from dynappo.tasks.velocity import env as env_lib
from experiments import paper, run, stats

PLOTS = (
    "02_brax 10_ablation 11_model 12_platforms 13_step_time 14_efficiency "
    "15_curves 16_gaits 17_regimes/cliff 18_rollouts"
).split()
FOLDERS = (  # in the order in which they read each other's runs
    "10_ablation 12_platforms 11_model 13_step_time 14_efficiency 15_curves 16_gaits 17_regimes "
    "18_rollouts"
).split()


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
    ours = {(row["envs"], row["horizon"]): row["ms"] / 2 for row in rows}
    theirs = {(row["envs"], row["horizon"]): row["time_min"] for row in paper.table("ablation")}
    both = stats.correlation(*np.log([[of[cell] for cell in ours] for of in (ours, theirs)]))
    r = said.split(": ")[1]
    assert f"{both.value:.3f}" == r and len(rows) == 30
    around = "({:.2f} to {:.2f})".format(*both[1:])
    assert f"is {r} over these 30 cells {around}. Training" in words
    faster = [60 * theirs[cell] / ours[cell] for cell in ours]
    assert f"{min(faster):.0f} to {max(faster):.0f} times as fast" in words
    few, many = ([of[8192, 16] / of[count, 16] for of in (ours, theirs)] for count in (512, 1024))
    text = (
        "it takes {:.1f} times as long, in the paper {:.1f} times; from 512, which ran on another"
    )
    text += " host, it is {:.1f} and {:.1f} times"
    assert text.format(*many, *few) in words
    hosts = [
        [row for row in rows if row["commit"][:8] == x]
        for x in ("71c94de1", "d4ea24ce", "8155a0a1")
    ]
    grids = [{(row["envs"], row["horizon"]) for row in some} for some in hosts]
    assert grids[1] == {(512, 12), (512, 16), (512, 20), (1024, 28), (1024, 32)}
    assert grids[2] == {(512, 24), (512, 28), (512, 32)}
    assert grids[0] == theirs.keys() - grids[1] - grids[2] and [*map(len, hosts)] == [22, 5, 3]
    first, both = (
        script("10_ablation/times").table(some).rpartition(": ")[2]
        for some in (hosts[0], sum(hosts[:2], []))
    )
    assert (
        f"Over the 22 of the first host the correlation is {first}, with the second's {both}."
        in words
    )
    told = next(
        line
        for line in (EXPERIMENTS / "paper/README.md").read_text().splitlines()
        if line.startswith("| times of Table I")
    )
    seconds = ours.values()
    assert f"| {min(seconds):.1f} to {max(seconds):.1f} s, {len(rows)} cells" in told
    text = f"{min(faster):.0f} to {max(faster):.0f} times as fast; correlation of logarithms"
    assert f"{text} {r} {around}. From" in told
    text = "From 1024 to 8192 robots (N = 16) {:.1f} times as long, there {:.1f} |"
    assert text.format(*many) in told


def row_on(page, begins):
    """The row of a table that begins so."""
    (line,) = [x for x in page.splitlines() if x.startswith(f"| {begins}")]
    return line


def test_the_claims_that_had_no_test_have_one():
    """Iterations by Welch, spreads by F, std in the end by Welch and Holm, correlations by Fisher."""
    names = "paper 10_ablation 12_platforms 14_efficiency 15_curves".split()
    pages = {name: (EXPERIMENTS / f"{name}/README.md").read_text() for name in names}
    words = {name: " ".join(page.split()) for name, page in pages.items()}
    # fewer iterations to the paper's return
    with (EXPERIMENTS / "14_efficiency/results.csv").open(newline="") as file:
        rows = [r for r in csv.DictReader(file) if r["threshold"] == "paper, 30.5"]
    some = {}
    for row in rows:
        numbers = (float(row[f"iterations_{x}"]) for x in ("mean", "sd"))
        some[row["variant"]] = stats.Moments(*numbers, int(row["seeds"]))
        assert row["robot"] == "go1"
        assert row["variant"] == "ppo12" or row["success_rate_pct"] == "100"
    two, ramp, none, ppo = (some[x] for x in ("dyna2", "dyna4", "dyna4_noschedule", "ppo16"))
    assert {one.n for one in (two, ramp, none, ppo)} == {10}
    p = [stats.welch_of(one, ppo) for one in (two, ramp, none)]
    text = "is not shown**: {:.0f} (2-step), {:.0f} (ramp) and {:.0f} (no ramp) beside {:.0f} of PPO-16, p "
    text = text.format(two.mean, ramp.mean, none.mean, ppo.mean)
    assert text + "{:.2f}, {:.2f} and {:.2f}, uncorrected".format(*p) in words["14_efficiency"]
    text = "| {:.0f}, {:.0f} ({:.0f} without ramp); PPO-16 {:.0f}; 10 seeds, p {:.2f}, {:.2f} ({:.2f}) | "
    text = text.format(two.mean, ramp.mean, none.mean, ppo.mean, *p) + "**not shown** |"
    assert text in row_on(pages["paper"], "fewer iterations")
    # spreads of the best return, and the policy's std in the end
    folder = EXPERIMENTS / "12_platforms/results"
    spreads, deviations, noise = {}, {}, {}
    for robot, name in itertools.product(paper.ROBOTS, ("dyna2", "dyna4_noschedule", "dyna4")):
        tail, real = (paper.load(folder, f"{robot}_{x}") for x in (name, "ppo16"))
        peaks = paper.peak(tail), paper.peak(real)
        spreads[name, robot] = stats.spreads(*peaks)
        deviations[name, robot] = [x.std(ddof=1) for x in peaks]
        ends = [x.summary["policy_std"] for x in (tail, real)]
        noise[name, robot] = stats.difference(*ends), stats.welch_of(*ends), np.mean(ends, 1)
    ramped, plain = ([spreads[x, r] for r in paper.ROBOTS] for x in ("dyna4", "dyna4_noschedule"))
    text = "(p {:.2f}, {:.2f}, {:.2f}, {:.2f} with the ramp, {:.2f} at least without)"
    assert text.format(*ramped, min(plain)) in words["12_platforms"]
    smaller = {key for key, (ours, theirs) in deviations.items() if ours < theirs}
    assert {robot for name, robot in smaller if name == "dyna4"} == {"go2"}
    found = {robot for name, robot in smaller if name == "dyna4_noschedule"}
    assert found == {"go2", "anymal_d"}
    theirs = []
    for robot in paper.ROBOTS:
        printed = [
            paper.pick(paper.table("platforms"), robot=robot, variant=x)["max_reward_sd"]
            for x in ("dyna4", "ppo16")
        ]
        theirs.append(stats.spreads(*(stats.Moments(0, sd, 3) for sd in printed)))
    sd = [[deviations[x, r] for r in paper.ROBOTS] for x in ("dyna4", "dyna4_noschedule")]
    sd = [*(x[0] for x in sd[0]), *(x[1] for x in sd[0]), *(x[0] for x in sd[1])]
    text = "sd {:.1f}, {:.1f}, {:.1f}, {:.1f} against {:.1f}, {:.1f}, {:.1f}, {:.1f}; F tests p ".format(
        *sd
    )
    text += "{:.2f}, {:.2f}, {:.2f}, {:.2f}; without ramp ".format(*ramped)
    text += "{:.1f}, {:.1f}, {:.1f}, {:.1f}".format(*sd[8:]) + f" ({min(plain):.2f} at least)"
    text += f"; the paper's by the same test {min(theirs):.2f} at least | **not shown** |"
    assert text in row_on(pages["paper"], "lower spread")
    holm = dict(zip(noise, stats.holm([p for _, p, _ in noise.values()]), strict=True))
    (shown,) = [key for key, p in holm.items() if p < 0.05]
    assert shown == ("dyna4", "go1")
    more, p, means = noise[shown]
    around = "{:.3f} ({:.3f} to {:.3f}".format(*more)
    other = min(p for key, p in holm.items() if key != shown)
    text = f"ramped tail: {around}; p {p:.4f}, Holm over all 12 {holm[shown]:.3f}; the others {other:.2f} at"
    assert text in words["15_curves"]
    text = "| {:.2f}; PPO-16 {:.2f} (Go1): ".format(*means)
    text += f"{around.replace(' (', ' higher (')}; Holm over 12 {holm[shown]:.3f}); "
    every = [noise["dyna4", r][0].value for r in paper.ROBOTS]
    text += f"{min(every):.2f} to {max(every):.2f} on all four, on the others not shown |"
    assert text in row_on(pages["paper"], "the policy becomes as certain")
    # std and return over the cells of Table I
    cells = paper.rows(EXPERIMENTS / "10_ablation/results.csv")
    ours, theirs = (
        stats.correlation([cell[x] for cell in cells], [cell[y] for cell in cells])
        for x, y in (
            ("policy_std_mean", "max_reward_mean"),
            ("paper_policy_std", "paper_max_reward"),
        )
    )
    assert len(cells) == 30
    told = ["{:.2f} ({:.2f} to {:.2f})".format(*r) for r in (ours, theirs)]
    z = (np.arctanh(ours.value) - np.arctanh(theirs.value)) / np.sqrt(2 / (30 - 3))
    closer = 2 * scipy.stats.norm.sf(abs(z))
    text = f"| {told[0]} | {told[1]}; it is closer there (p {closer:.3f}) |"
    assert text in row_on(pages["10_ablation"], "correlation of policy std")
    text = f"| correlation {theirs.value:.2f} | {told[0].replace(' (', ' over 30 cells (')} | **yes**, less"
    assert text in row_on(pages["paper"], "a policy's std falls")


def test_what_a_cheap_fit_saves_is_said_with_its_epochs():
    """`fast` beside PPO-16, taking turns; with 5 epochs instead of 3.3 by computation; equal on Go1."""
    pages = [(EXPERIMENTS / f"{name}/README.md").read_text() for name in ("paper", "13_step_time")]
    claim, page = row_on(pages[0], "less time"), " ".join(pages[1].split())
    bench = json.loads((EXPERIMENTS / "03_speed/results/bench_bfloat16.json").read_text())
    saved = 100 * (1 - bench["versus"]["ratio"])
    assert f"`fast`, bfloat16, -{saved:.1f} % there (one run with 3.3 epochs of fitting" in claim
    fit = bench["configs"]["configs/go1.py:fast"]["ms"]["fit"]
    real, tail = np.median(bench["versus"]["ms"], 0)
    longer = 100 * (1 - (tail + fit * (5 / (10 / 3) - 1)) / real)
    assert f"about -{longer:.0f} % with 5, computed" in claim
    assert f"takes {saved:.1f} % less time an iteration than PPO-16" in page
    assert f"fit of 3.3 epochs; with 5 about {longer:.0f} %, computed;" in page
    row = paper.pick(
        paper.rows(EXPERIMENTS / "12_platforms/results.csv"), robot="go1", variant="fast"
    )
    p, holm = (row[f"evaluated_return_p_equal{x}"] for x in ("", "_holm"))
    assert f"equal to PPO-16 on Go1 (p {p:.3f}, Holm {holm:.3f}). Its seconds" in claim
    config = config_lib.load("configs/go1.py:fast")
    assert config.model.late_epochs == 5 and row["impl"] == "warp"


def fast_jobs():
    """`(engine, method) -> column -> [S, E]` of 13_step_time's seconds to a return."""
    found = {}
    for path in (EXPERIMENTS / "13_step_time/results/fast").glob("*.csv"):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert {row["device"] for row in rows} == {"NVIDIA H200"}
        assert {row["commit"] for row in rows} == {"724e00dfb7aa"}
        names = "seed iteration sim_steps seconds return fall_rate row_ms tail_ms fit_ms ppo_ms"
        columns = {n: [float(row[n] or "nan") for row in rows] for n in names.split()}
        columns = {n: np.reshape(values, (5, 20)) for n, values in columns.items()}
        assert (columns["seed"] == np.arange(1100, 1105)[:, None]).all()
        assert (columns["iteration"] == np.arange(20, 401, 20)).all()
        found[tuple(path.stem.split(".")[1:])] = columns
    assert len(found) == 5
    return found


def first_of(job, name, true):
    """What `name` is at a seed's first True of `[S, E]`; NaN without one."""
    at = job[name][np.arange(len(true)), true.argmax(1)]
    return np.where(true.any(1), at, np.nan)


def milliseconds(job, first=0):
    """Of an iteration after `first`, `[S]`."""
    begin = job["seconds"][:, first // 20 - 1] if first else 0
    return 1e3 * (job["seconds"][:, -1] - begin) / (400 - first)


def t_half(values):
    values = np.asarray(values)[np.isfinite(values)]
    return scipy.stats.t.ppf(0.975, len(values) - 1) * scipy.stats.sem(values)


@pytest.fixture(scope="module")
def fast_page():
    return (EXPERIMENTS / "13_step_time/README.md").read_text()


@pytest.fixture
def fast_level():
    """`(engine, method) -> name -> [S]` at the first return of 38."""
    names = "iteration sim_steps seconds".split()
    return {
        key: {name: first_of(job, name, job["return"] >= 38) for name in names}
        for key, job in fast_jobs().items()
    }


def test_seconds_of_fast_to_a_return_are_those_of_its_runs(fast_page, fast_level):
    """Its three tables are what fast.py prints, and what NumPy makes of the runs."""
    table = script("13_step_time/fast")
    found = table.read(EXPERIMENTS / "13_step_time/results/fast")
    printed = [table.table(found), table.compared(found), table.phases(found)]
    assert all(f"\n\n{one}\n\n" in fast_page for one in printed)
    engines = {"kernel": "our kernel", "warp": "MuJoCo Warp"}
    reals = {"ppo16": 16, "fast": 12, "dyna4": 12}
    lines = []
    for (engine, method), job in fast_jobs().items():
        begin, level = f"| {engines[engine]} | `{method}` | ", fast_level[engine, method]
        falls = (job["return"] >= 38) & (job["fall_rate"] <= 0.01 + 1e-6)
        kept = np.logical_and.accumulate(falls[:, ::-1], 1)[:, ::-1]
        walks = first_of(job, "seconds", kept)
        assert np.isfinite(level["seconds"]).all()
        wanted = [(milliseconds(job), 1), (milliseconds(job, 100), 1), "5 of 5"]
        wanted += [(level["iteration"], 0), (level["sim_steps"] / 1e6, 1), (level["seconds"], 2)]
        some = int(np.isfinite(walks).sum())
        wanted += [f"{some} of 5", (walks, 2)]
        cells = [
            one if isinstance(one, str) else "{:.{d}f} ± {:.{d}f}".format(*one[0], d=one[1])
            for one in (
                x if isinstance(x, str) else ((np.nanmean(x[0]), t_half(x[0])), x[1])
                for x in wanted
            )
        ]
        lines.append(begin + " | ".join(cells) + " |")
        row, tail, fit, ppo = (
            float(np.nan_to_num(job[f"{name}_ms"][0, 0])) for name in "row tail fit ppo".split()
        )
        parts = [reals[method] * row, (16 - reals[method]) * tail, fit, ppo]
        cells = [f"{x:.2f}" if x else "" for x in parts]
        cells += [f"{sum(parts):.2f}", f"{milliseconds(job, 100).mean():.2f}"]
        lines.append(begin + " | ".join(cells) + " |")
        if method != "ppo16":
            base = fast_level[engine, "ppo16"]
            ratios = [stats.ratio(level[n], base[n]) for n in ("seconds", "iteration", "sim_steps")]
            logs = np.log(level["seconds"] / base["seconds"])
            half = t_half(logs)
            ratios.append(np.exp(logs.mean() + np.array([0, -half, half])))
            cells = ["{:.2f} ({:.2f} to {:.2f})".format(*one) for one in ratios]
            lines.append(begin + " | ".join(cells) + " |")
    assert len(lines) == 13 and all(line in fast_page.splitlines() for line in lines)


def test_what_the_page_says_of_fast_in_seconds_is_so(fast_page, fast_level):
    """Which expectation failed, by which test; why, by phases and first fits; which seeds are alike."""
    jobs, page = fast_jobs(), " ".join(fast_page.split())
    section = page.partition("## `fast` in seconds to a return")[2]
    claim = row_on((EXPERIMENTS / "paper/README.md").read_text(), "less time")
    names = ("seconds", "iteration", "sim_steps")
    ratios = {
        (engine, method): [
            stats.ratio(level[name], fast_level[engine, "ppo16"][name]) for name in names
        ]
        for (engine, method), level in fast_level.items()
        if method != "ppo16"
    }
    ours, tail, warp = (
        ratios[key][0] for key in (("kernel", "fast"), ("kernel", "dyna4"), ("warp", "fast"))
    )
    assert ours.low > 1 and warp.low < 0.85 < 1 < warp.high and tail.low > 3
    assert all(one.low < 1 < one.high for some in ratios.values() for one in some[1:])
    text = (
        "takes {:.2f} times the seconds of PPO-16 until a Go1 is first at 38 ({:.2f} to {:.2f}, by "
    )
    text += "the rule, uncorrected), `dyna4` {:.1f} times ({:.1f} to {:.1f}). "
    text += "With MuJoCo Warp's own step no difference is shown "
    text = text.format(*ours, *tail) + "({:.2f}, {:.2f} to {:.2f}). ".format(*warp)
    assert (
        f"{text}In iterations and in simulator steps no difference is shown with either" in section
    )
    text = "takes [{:.2f} times the seconds](#fast-in-seconds-to-a-return) ({:.2f} to {:.2f}, by the rule,"
    assert text.format(*ours) in page
    assert "no difference is shown ({:.2f}, {:.2f} to {:.2f}).**".format(*warp) in page
    text = "not so, by the rule. 0.85 times the seconds of PPO-16 by MuJoCo Warp, "
    text += "which five seeds may "
    text += f"not show: it is {warp.value:.2f}, and they do not. Of `dyna4` three times as "
    text += "many: **wrong**, it is "
    assert f"{text}{tail.value:.1f}." in section
    text = (
        "38 are {:.2f} times PPO-16's by our kernel ({:.2f} to {:.2f}; `dyna4` in float32 {:.2f}, "
    )
    text += "{:.2f} to {:.2f}), by MuJoCo Warp {:.2f} ({:.2f} to {:.2f}; H200, five fresh seeds, uncorrected)"
    assert text.format(*ours, *tail, *warp) in claim
    last = {key: level["iteration"] == 400 for key, level in fast_level.items()}
    assert sum(x.sum() for x in last.values()) == 2
    assert last["kernel", "fast"][0] and last["warp", "fast"][0]
    assert (
        "seed 1100 of `fast` only at the last evaluation (iteration 400 of 400), with both" in page
    )

    # the rule's correction
    order = (("kernel", "fast"), ("kernel", "dyna4"), ("warp", "fast"))
    took = {key: level["seconds"] for key, level in fast_level.items()}
    pairs = [(took[key], took[key[0], "ppo16"]) for key in order]
    welch = [scipy.stats.ttest_ind(*pair, equal_var=False).pvalue for pair in pairs]
    logs = [scipy.stats.ttest_ind(*np.log(pair), equal_var=False).pvalue for pair in pairs]
    ranks = [
        scipy.stats.permutation_test(
            [
                scipy.stats.rankdata(np.concatenate(pair))[:5],
                scipy.stats.rankdata(np.concatenate(pair))[5:],
            ],
            lambda one, other: one.sum() - other.sum(),
            n_resamples=np.inf,
        ).pvalue
        for pair in pairs
    ]
    np.testing.assert_allclose(ranks, [stats.rank_sum(*pair) for pair in pairs])
    text = f"has a p of {welch[0]:.3f} (Welch), {stats.holm(welch)[0]:.3f} by Holm over the three ratios "
    text += f"of seconds, and {ranks[0]:.3f} by the exact rank test (of logarithms {logs[0]:.3f} and, by "
    assert f"{text}Holm, {stats.holm(logs)[0]:.3f}). So it hangs on the test." in section
    text = (
        f"holds by any of them: by Holm {stats.holm(welch)[1]:.4f}, by ranks {ranks[1]:.3f} (Holm "
    )
    assert f"{text}{stats.holm(ranks)[1]:.3f})." in section and stats.holm(ranks)[1] < 0.05
    clock = {key: milliseconds(job) for key, job in jobs.items()}
    longer = stats.ratio(clock["kernel", "fast"], clock["kernel", "ppo16"])
    text = "takes {:.2f} times as long{} ({:.2f} to {:.2f}"
    assert text.format(longer.value, " as PPO-16's", *longer[1:]) + "). Until" in page
    assert text.format(longer.value, "", *longer[1:]) + "; all 400) is beyond doubt" in section

    # an iteration
    late = {key: milliseconds(job, 100) for key, job in jobs.items()}
    shorter = [
        100 * (1 - took["warp", "fast"].mean() / took["warp", "ppo16"].mean())
        for took in (clock, late)
    ]
    each = 100 * (1 - clock["warp", "fast"] / clock["warp", "ppo16"])
    text = f"{shorter[0]:.1f} % shorter in the mean of all 400 (single seeds {each.min():.1f} "
    text += f"to {each.max():.1f}), "
    assert f"{text}and {shorter[1]:.1f} % after the 100th" in page
    text = "{:.1f} % shorter in the mean of 400, {:.1f} % after the 100th"
    assert text.format(*shorter) in claim
    part = {
        key: {n: float(np.nan_to_num(job[f"{n}_ms"][0, 0])) for n in "row tail fit ppo".split()}
        for key, job in jobs.items()
    }
    fast, ppo = part["kernel", "fast"], part["kernel", "ppo16"]
    more = (late["kernel", "fast"] - late["kernel", "ppo16"]).mean()
    rows = 16 * ppo["row"] - 12 * fast["row"]
    update = fast["ppo"] - ppo["ppo"]
    explained = fast["fit"] + update + 4 * fast["tail"] - rows
    text = f"takes {more:.2f} ms longer than PPO-16's. By the phases it is {explained:.2f}: "
    text += f"the fit {fast['fit']:.2f}, "
    text += f"an update {update:.2f} more (why was not measured), the tail "
    text += f"{4 * fast['tail']:.2f}, less {rows:.2f} "
    text += (
        f"of real rows, now 12 instead of 16. The other {more - explained:.2f} they do not explain"
    )
    assert text in section
    sums = 16 * ppo["row"] + ppo["ppo"], sum(fast.values()) + 11 * fast["row"] + 3 * fast["tail"]
    text = f"PPO-16 sum to {sums[0] - late['kernel', 'ppo16'].mean():.2f} more than its "
    text += "clock, those of `fast` to "
    assert f"{text}{late['kernel', 'fast'].mean() - sums[1]:.2f} less" in section
    text = f"took {ppo['row']:.2f} ms in PPO-16's job and {fast['row']:.2f} in the other; "
    text += f"at {fast['row']:.2f}, four "
    assert f"{text}save {4 * fast['row']:.2f}." in section

    # the fit: dyna4's in TF32, and fast's first
    columns = schedule.columns(config_lib.load("configs/go1.py:dyna4"))
    real = columns["n_real"][:400].astype(int)
    fits = np.ceil(25 * real / 8) / np.ceil(25 * 12 / 8)
    then = paper.pick(
        paper.rows(EXPERIMENTS / "13_step_time/results.csv"), simulator="kernel", variant="dyna4"
    )["fit_mean"]
    fit = part["kernel", "dyna4"]["fit"]
    less, level = (fit - then) * fits, fast_level["kernel", "dyna4"]
    seconds = np.array(
        [
            s - less[: int(i)].sum() / 1e3
            for s, i in zip(level["seconds"], level["iteration"], strict=True)
        ]
    )
    mean = clock["kernel", "dyna4"].mean()
    times = stats.ratio(seconds, fast_level["kernel", "ppo16"]["seconds"])
    assert f"had the fit of {then:.1f} ms above, which is in TF32" in section
    text = f"its fit takes {fit:.1f} ms. Computed, with {then:.1f} ms (measured on an H100) "
    text += "an iteration would take "
    text += f"{mean - less.mean():.1f} instead of {mean:.1f} and the level {seconds.mean():.2f} s, "
    assert text + "{:.1f} times PPO-16's ({:.1f} to {:.1f}).".format(*times) in section
    assert paper.TAILS == ("model.precision=tf32",)
    assert config_lib.load("configs/go1.py:dyna4").model.precision == "highest"
    table = script("13_step_time/fast")
    told = table.tf32(table.read(EXPERIMENTS / "13_step_time/results/fast"))
    assert f"{mean - less.mean():.1f} ms an iteration, {seconds.mean():.2f} ± " in told
    model = config_lib.load("configs/go1.py:fast").model
    text = f"Until iteration {model.late_from} `fast` fits {model.epochs} epochs, on up to {real.max()} real"
    assert f"{text} rows: its first 100 iterations" in section
    text = f"{model.late_epochs} epochs from iteration {model.late_from} on, {model.epochs} before)"
    assert f"the runs of 2026-11-29 (PPO in float32, {text}" in page
    first = {
        engine: jobs[engine, "fast"]["seconds"][:, 4].mean() - late[engine, "fast"].mean() / 10
        for engine in ("kernel", "warp")
    }
    whole = {engine: fast_level[engine, "fast"]["seconds"].mean() for engine in first}
    text = f"take {first['kernel']:.2f} s longer than 100 later ones, of {whole['kernel']:.2f} in all. "
    text += f"With MuJoCo Warp it is {first['warp']:.2f} of {whole['warp']:.2f}; "
    one = part["warp", "fast"]
    still = (real[:100] - 12).sum() * (one["row"] - one["tail"]) / 1e3
    assert f"{text}{still:.2f} of it, by the phases," in section

    # seeds
    slow = [took[:2] / took[2:].mean() - 1 for (e, _), took in clock.items() if e == "warp"]
    text = f"took {100 * np.min(slow):.0f} to {100 * np.max(slow):.0f} % longer an iteration"
    assert text in section
    slow = {
        m: 100 * (t[:2].mean() / t[2:].mean() - 1) for (e, m), t in clock.items() if e != "warp"
    }
    text = f"here {slow['ppo16']:.1f} % in the mean (`ppo16`), {slow['fast']:.1f} (`fast`) and "
    assert f"{text}{slow['dyna4']:.1f} (`dyna4`)" in section
    every = [level["iteration"] for level in fast_level.values()]
    assert "1100 is the slowest and 1104 the fastest, or level with it." in section
    assert "One H200 with nothing else on it, 2026-11-29, commit 724e00df" in section
    assert all(np.argmax(x) == 0 and x[4] == x.min() for x in every)
    assert sum((x == x.min()).sum() > 1 for x in every) == 1
    r = np.corrcoef([level["iteration"] for level in fast_level.values()])
    r = r[np.triu_indices(5, 1)]
    assert f"correlate by {r.min():.2f} to {r.max():.2f}." in section
    pairs = {}
    for key in ratios:
        for name in names:
            logs = np.log(fast_level[key][name] / fast_level[key[0], "ppo16"][name])
            pairs[key, name] = np.exp(logs.mean() + t_half(logs) * np.array([0, -1, 1]))
    text = "It says the same: {:.2f} ({:.2f} to {:.2f}), {:.2f} ({:.2f} to {:.2f}) and, with MuJoCo Warp, "
    text += "{:.2f} ({:.2f} to {:.2f})."
    told = [
        x
        for key in (("kernel", "fast"), ("kernel", "dyna4"), ("warp", "fast"))
        for x in pairs[key, "seconds"]
    ]
    assert text.format(*told) in section
    beside = [x for (_, name), x in pairs.items() if name != "seconds"]
    assert len(beside) == 6 and sum(not x[1] < 1 < x[2] for x in beside) == 2
    assert "two of the six ratios of iterations and steps just exclude 1" in section


def test_equal_seeds_are_not_alike_in_other_jobs(fast_page):
    """Of a Go1 in 30_row_cost, seeds 1100 to 1104: iterations to 38, any two jobs, and `best` twice."""
    jobs = {}
    with lzma.open(EXPERIMENTS / "30_row_cost/results/alone.csv.xz", "rt") as file:
        for row in csv.DictReader(file):
            if row["name"].startswith(("go1.kernel.", "go1.warp.")):
                seeds = jobs.setdefault((row["batch"], row["name"]), {})
                seeds.setdefault(int(row["seed"]), []).append(row)
    level = {}
    for key, seeds in jobs.items():
        if sorted(seeds) == [*range(1100, 1105)]:
            level[key] = np.array(
                [
                    min(int(r["iteration"]) for r in seeds[k] if float(r["return"]) >= 38)
                    for k in range(1100, 1105)
                ]
            )
            assert all(int(r["iteration"]) % 10 == 0 for rows in seeds.values() for r in rows)
    level = {key: x for key, x in level.items() if x.std()}
    r = np.corrcoef([*level.values()])[np.triu_indices(len(level), 1)]
    page, names = " ".join(fast_page.split()), [*level]
    text = (
        f"{len(level)} jobs have the same seeds, a Go1, one of these two engines, and not the same "
    )
    text += f"number for all seeds: any two correlate by {r.min():.2f} to {r.max():.2f}, "
    assert f"{text}{np.median(r):.2f} in the median." in page
    twice = {}
    for engine in ("kernel", "warp"):
        pair = [level[key] for key in names if key[1] == f"go1.{engine}.best"]
        assert len(pair) == 2
        twice[engine] = np.corrcoef(pair)[0, 1]
    text = f"has {twice['kernel']:.2f} with our kernel (both 2026-11-27), {twice['warp']:.2f} with MuJoCo "
    assert f"{text}Warp (2026-11-27 and 2026-11-29)." in page
    least, most = (f(list(map(f, level.values()))) for f in (min, max))
    assert f"every 10 iterations and take {least} to {most}, so many" in page


def test_a_second_seed_on_a_cpu_evaluates_as_alone(fast_page):
    runs = {}
    for name in ("two", "second"):
        with (EXPERIMENTS / f"13_step_time/results/seeds/{name}.csv").open(newline="") as file:
            runs[name] = list(csv.DictReader(file))
    first, after = runs["two"][:3], runs["two"][3:]
    assert {row["device"] for rows in runs.values() for row in rows} == {"cpu"}
    for rows, seed in ((first, "1100"), (after, "1101"), (runs["second"], "1101")):
        assert [(row["seed"], row["iteration"]) for row in rows] == [(seed, k) for k in "246"]
        assert int(rows[-1]["sim_steps"]) == 6 * 16 * 16  # robots, and rows that are all real
        assert {row["job"].split()[0] for row in rows} == {"go1:dyna4"}
        assert all("physics.impl=jax rollout.num_envs=16 " in row["job"] for row in rows)
    found = [[row["return"] for row in rows] for rows in (after, runs["second"], first)]
    assert found[0] == found[1] != found[2]
    page = " ".join(fast_page.split())
    assert "seed 1101 after 1100 evaluates three times to the same digits as alone" in page
    assert "16 robots, 6 iterations with no tail yet, MJX-JAX, 2026-11-29" in page


def test_the_older_page_links_what_was_measured_since(fast_level):
    page = " ".join((EXPERIMENTS / "03_speed/README.md").read_text().split())
    ppo, fast = (fast_level["warp", name]["seconds"] for name in ("ppo16", "fast"))
    found = stats.difference(fast, ppo)
    assert found.low < 0 < found.high
    text = f"{ppo.mean():.1f} s for `ppo16` and {fast.mean():.1f} for `fast`, [no difference shown]"
    assert f"{text}(../13_step_time/README.md#fast-in-seconds-to-a-return)" in page


def test_a_seed_of_fast_that_is_never_at_the_level_counts_with_its_whole_run():
    """Two seeds of three evaluations, by hand; and with a fit that takes less from the first iteration on."""
    table = script("13_step_time/fast")
    rows = []
    for seed, returns in (("1", [10, 37, 39]), ("2", [10, 20, 37])):
        for k, number in enumerate(returns, 1):
            row = {"seed": seed, "job": "go1:dyna4", "iteration": 100 * k, "sim_steps": 1000 * k}
            row |= {"seconds": 2.0 * k + (k > 1), "return": number, "fall_rate": 0.001}
            row |= {"tracking_error": 0.1, "yaw_error": 0.1, "row_ms": 1, "tail_ms": 0.5}
            rows.append({n: str(x) for n, x in (row | {"fit_ms": 10, "ppo_ms": ""}).items()})
    one = table.timed(rows)
    np.testing.assert_array_equal(one.level, [[300, 3000, 7]] * 2)
    np.testing.assert_array_equal(one.there, [True, False])
    np.testing.assert_array_equal(one.walks, [[300, 3000, 7], [np.nan] * 3])
    np.testing.assert_allclose(table.ms(one), 7000 / 300)
    np.testing.assert_allclose(table.ms(one, 100), 5000 / 200)
    line = table.table({("kernel", "dyna4"): one}).splitlines()[-1]
    assert "| 1 of 2 | 300 ± 0 |" in line
    seconds, mean = table.cheaper(one, config_lib.load("configs/go1.py:dyna4"), 9.0)
    # 38 minibatches in the end; 50 to 41 during the ramp of 100 iterations
    assert all(7 - 0.4 < x < 7 - 0.3 for x in seconds)
    np.testing.assert_allclose(mean, 7000 / 300 - (7 - seconds[0]) * 1e3 / 500, rtol=0.02)


@pytest.mark.parametrize("name", ["11_model", "12_platforms", "13_step_time", "16_gaits"])
def test_a_table_says_what_has_not_been_run(name, tmp_path, drawn):
    script(name).make(tmp_path)
    assert drawn
    table = (tmp_path / "results.csv").read_text()
    assert "not run" in table or ",,,\n" in table  # of milliseconds, empty cells


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


def test_the_map_says_how_many_of_its_cells_were_evaluated():
    plot, folder = script("10_ablation"), EXPERIMENTS / "10_ablation"
    never = [
        cell
        for cell in plot.GRID
        if not any(
            b.run.summary.get("evaluation") for b in plot.batches_of(folder / "results", *cell)
        )
    ]
    page = " ".join((folder / "README.md").read_text().split())
    assert f"{len(never)} of the {len(plot.GRID)} were never evaluated" in page


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


def test_falls_of_the_first_evaluation_at_the_level_are_on_the_page(tmp_path):
    """Of a seed that is at 38 twice the first time counts, of one that never is none; then the page."""
    plot = script("14_efficiency")
    returns = np.array([[10.0, 39.0, 0.0], [np.nan] * 3, [40.0, 41.0, 37.9], [42.0, 20.0, 5.0]])
    falls = np.array([[0.5, 0.04, 0.9], [np.nan] * 3, [0.01, 0.0, 0.3], [0.0, 0.5, 0.2]])
    columns = {"eval_return": returns, "eval_fall_rate": falls}
    np.testing.assert_allclose(plot.falls_there(paper.Run(columns, {}), 38.0), [1.0, 4.0])
    rows = paper.rows(EXPERIMENTS / "14_efficiency/results.csv")
    page = " ".join((EXPERIMENTS / "14_efficiency/README.md").read_text().split())
    some = [r for r in rows if r["threshold"] == "evaluated" and r["robot"] == "go1"]
    told = [f"{paper.pick(some, variant=v)['falls_there_pct_mean']:.2f}" for v in paper.VARIANTS]
    assert "falls in {} % of the episodes with PPO-12, {} % with PPO-16".format(*told) in page
    assert "in the order of the table, in {}, {} and {} %".format(*told[2:]) in page
    folder = EXPERIMENTS / "12_platforms/results"
    there = {v: plot.falls_there(paper.load(folder, f"go1_{v}"), 38.0) for v in paper.VARIANTS}
    assert all(stats.welch_of(there[v], there["ppo16"]) > stats.ALPHA for v in there)


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
        obs, one = np.zeros((20, 4, 48)), np.ones((20, 4))
        obs[..., plot.ROWS["command"].start] = [0.2, 0.9, 0.5, 0.7 + (i == 3)]  # the last anew
        one[3, 1] = one[16, 2] = 0  # the fastest falls; in a tail, where physics does not
        buffer = dict(obs=obs, next_prop=rng.normal(size=(20, 4, 33)), reward=one, discount=one)
        buffers.append(types.SimpleNamespace(**buffer, truncation=0 * one))
    assert plot.steady(buffers).tolist() == [True, False, True, False]
    row, k = plot.rows(buffers, 0.02)[48], plot.CURVES["calf"][0]
    assert float(row["time"]) == pytest.approx(0.34)  # two rollouts of 4 and 9 rows
    assert float(row["calf"]) == pytest.approx(buffers[2].next_prop[8, 2, k], rel=1e-4)
    went = [buffers[i + 4].next_prop[3, [0, 2], k] for i in plot.TAILS]
    for name, t in (("calf_tail", 19), ("calf_still", 3)):
        said = [buffers[i].next_prop[t, [0, 2], k] for i in plot.TAILS]
        expected = np.sqrt(np.mean(np.subtract(said, went) ** 2))
        assert float(plot.distance(buffers)[15][name]) == pytest.approx(expected, rel=1e-3)


def test_the_page_of_the_rollouts_has_the_distances_of_its_tails():
    folder = EXPERIMENTS / "18_rollouts"
    page = (folder / "README.md").read_text()
    rows = paper.rows(folder / "results.csv")
    names = [f"{name}_{end}" for name in ("speed", "thigh", "calf") for end in ("tail", "still")]
    for row in rows:
        cells = " | ".join(f"{row[name]:.3f}" for name in names)
        assert f"| {row['row']:.0f} | {cells} |" in page
    words, half = " ".join(page.split()), paper.pick(rows, row=8.0)
    thigh, calf = (100 * half[f"{n}_tail"] / half[f"{n}_still"] for n in ("thigh", "calf"))
    assert f"joints are at {thigh:.0f} and {calf:.0f} % of the distance" in words
    about = json.loads((folder / "results/about.json").read_text())
    assert f"over {half['robots']:.0f} of {about['robots']} robots and four tails" in words
    assert f"one seed, {about['date']}" in words


def test_rollouts_are_kept_as_they_are_while_a_model_learns():
    """On the toy: four real rows, a tail of eight, and the policy stays."""
    record = script("18_rollouts/run")
    small = {"rollout.horizon": 12, "model.clean": True, "model.minibatches": 3}
    _, static, hyper = toy_env.settings(toy_env.TAIL | small)
    env = toy_env.make()
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, jax.random.key(0))
    iterate, i = partial(record.iterate, env, static=static), jnp.int32(12)
    after, buffer = jax.eval_shape(iterate, hyper, state, i, i)
    assert jax.tree.structure(after) == jax.tree.structure(state)
    assert buffer.reward.shape == (12, 16)


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

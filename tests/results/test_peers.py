"""Off-policy methods: pages of 24_off_policy and of 27_few/peers.md, and the scripts that train them."""

import argparse
import csv
import itertools
import re
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from result_files import EXPERIMENTS, few_of, script, shows

from dynappo.config import versions
from experiments import paper, stats

NUMBERS = EXPERIMENTS.parent / "docs/numbers.csv"


def test_the_page_of_the_peers_has_the_numbers_of_its_runs(drawn, monkeypatch, capsys):
    """Of the earlier task and of today's, where SAC with symmetric networks is beside others."""
    monkeypatch.setattr(sys, "argv", ["plot.py"])
    peers = script("24_off_policy")
    peers.main()
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "")
    words = " ".join(page.split())
    printed = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    rows = {cells[0].strip("| "): cells for cells in printed if len(cells) > 9}
    assert drawn == ["peers"] and len(rows) == 12  # with the head, which both tables have
    said = [cells[0] for cells in printed if len(cells) == 1 and cells[0][0] != "|"]
    assert said[0] == "2.2 to 2.5 M steps: -2.4 (-2.9 to -1.9), p 1e-05; 41.4"
    assert "(1.9 to 2.9; PPO 41.4; p 1e-5)" in page
    for name, cells in rows.items():  # walks, first at 38, with few falls; 30, 35, 40
        assert " | ".join(cells[2:5] + cells[6:9]) in page, name
        if name in peers.TODAY:  # ends are of the last three evaluations
            assert cells[1] in ("3", "10") and f"| {' | '.join(cells[1:5] + cells[6:11])} |" in page
    assert len(said) == 1 + len(peers.PAIRS)
    jobs, table = peers.read(), peers.less.table
    runs = {name: table.seeds(jobs[name]) for name in (*peers.TODAY, "sac", "sac-twice")}
    level = {name: table.reached(runs[name], 38).level / 1e6 for name in runs}
    assert np.isnan(level["sac-today"]).all()
    for name in ("crossq", "sac-symmetric", "sac-today"):
        assert [run[0]["seed"] for run in runs[name]] == [100, 101, 102]
    told = "M (ten seeds), with a fall in {:.1f} % of its episodes then"
    falls = [table.first(run, 38, "fall_rate") for run in runs["best-g"]]
    assert told.format(100 * np.mean(falls)) in words
    assert f"PPO, tuned and symmetric, needs {level['ppo-level-g'].mean():.2f} M" in words
    assert (
        " {} after {} M.".format(rows["ppo-level-g"][10].split()[0], rows["ppo-level-g"][9])
        in words
    )
    means = [np.mean(seed_means(runs[name], (1.75e6, 2.05e6))) for name in ("sac-today", "sac")]
    assert "has {:.1f} there between 1.75 and 2.05 M steps, here {:.1f}".format(*means) in words
    assert (
        "rollout.num_envs=128 " in jobs["ppo-level-g"][0]["job"] and "robot, 128 robots," in words
    )


def by_seed(runs, of):
    """`of` of each seed's run, a seed that ran twice with the mean of both."""
    seeds = sorted({run[0]["seed"] for run in runs})
    return np.array([np.mean([of(run) for run in runs if run[0]["seed"] == s]) for s in seeds])


def seed_means(runs, window):
    """Of each seed the mean return of its evaluations in a window of steps."""
    return [
        np.mean([r["return"] for r in run if window[0] <= r["sim_steps"] <= window[1]])
        for run in runs
    ]


def of_today():
    """plot.py of 24_off_policy, its runs by name, `[S]` million steps to 38, and the page's words. Steps of
    "sac-twice" are each seed's mean of two tries."""
    peers = script("24_off_policy")
    jobs, table = peers.read(), peers.less.table
    names = (*peers.TODAY, "sac-twice")
    runs = {name: table.seeds(jobs[name]) for name in names}
    level = {name: by_seed(runs[name], lambda run: table.first(run, 38)) / 1e6 for name in names}
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "")
    return peers, jobs, runs, level, " ".join(page.split())


def gap_of(text, one, other, *, digits=2):
    """`text`, filled with Welch's difference of `one` less `other`, its ends and p; if the interval includes
    zero, the ends are how much less `other` is at most, and how much more."""
    middle, low, high = stats.difference(one, other)
    ends = (high, -low) if low < 0 else (low, high)
    shown = (f"{x:.{digits}f}" for x in (middle, *ends))
    return text.format(*shown, stats.welch_of(one, other))


def part_of(words, head, tail):
    return words.split(head)[1].split(tail)[0]


def test_the_page_says_how_crossq_is_beside_best_ppo_and_sac():
    """With 256 robots: in steps, at equal steps, in seconds; and what its settings are."""
    peers, jobs, runs, level, words = of_today()
    table, mine = peers.less.table, part_of(words, "### CrossQ", "### Symmetric")
    best, crossq = level["best-g"], level["crossq"]
    times = stats.ratio(crossq, best)
    told = "after {:.2f} M simulator steps, three seeds of three, without a fall in 100 episodes of each. "
    assert (told + "`best` needs {:.2f} M").format(crossq.mean(), best.mean()) in words
    assert {table.first(run, 38, "fall_rate") for run in runs["crossq"]} == {0}
    shown = "saving of `best` beside it is not shown ({:.2f} to {:.2f} times".format(*times[1:])
    assert f"{shown} its steps, three seeds)" in words and times.low < 1 < times.high
    told = "no difference is shown ({} M fewer; {} fewer to {} more, p {:.2f}; "
    told = gap_of(told, best, crossq)
    assert told + "{:.2f} to {:.2f} times)".format(*times[1:]) in mine
    often = [
        (runs[x][0][5]["sim_steps"] - runs[x][0][4]["sim_steps"]) / 1e6
        for x in ("crossq", "best-g")
    ]
    told = "every {:.3f} M steps, `best` every {:.3f}, which makes CrossQ look {:.3f} M sooner"
    assert told.format(*often, (often[1] - often[0]) / 2) in mine
    pairs = {
        at: [by_seed(runs[x], lambda run: table.first(run, at)) / 1e6 for x in ("best-g", "crossq")]  # noqa: B023
        for at in (30, 35, 38)
    }
    early = [pairs[at][0].mean() - pairs[at][1].mean() for at in (30, 35)]
    assert "sooner to 30 by {:.2f} M and to 35 by {:.2f}. With".format(*early) in mine
    halves = {
        at: [x - step / 2 for x, step in zip(pair, often[::-1], strict=True)]
        for at, pair in pairs.items()
    }
    told = "{0} M fewer ({2} more to {1} fewer, p {3:.2f})"
    told = [gap_of(told, *halves[at], digits=3) for at in (30, 35)]
    assert "from each neither is shown: {} and {};".format(*told) in mine
    assert all(stats.difference(*halves[at]).low < 0 for at in (30, 35))
    told = "to 38 CrossQ then needs {:.2f} times the steps ({:.2f} to {:.2f})"
    assert told.format(*stats.ratio(*halves[38][::-1])) in mine
    careful = [table.reached(runs[x], 38).careful / 1e6 for x in ("best-g", "crossq")]
    assert f"it is {careful[1].mean():.2f} and {careful[0].mean():.2f} M" in mine
    assert gap_of("({1} M fewer to {2} more, p {3:.2f})", *careful) in mine
    end = runs["crossq"][0][-1]["sim_steps"]
    assert {run[-1]["sim_steps"] for run in runs["crossq"]} == {
        end
    } and f"after {end / 1e6:.2f} M" in mine
    ends = [table.between(jobs[x], end, "return") for x in ("crossq", "best-g")]
    assert (
        "After {:.2f} M it has {:.1f}, `best` {:.1f}".format(end / 1e6, *map(np.mean, ends))
        in words
    )
    told = "its end, CrossQ returns {} less than `best` ({} to {}, p {:.2f})"
    assert gap_of(told, ends[1], ends[0], digits=1) in mine
    falls = [100 * table.between(jobs[x], end, "fall_rate") for x in ("best-g", "crossq")]
    told = f"falls in {falls[0].mean():.1f} % of its episodes there, CrossQ in none of 300 "
    assert (
        not falls[1].any()
        and told + gap_of("({1} to {2} points less, p {3:.3f})", *falls, digits=1) in mine
    )
    then = {  # walks, at the level, and there with few falls, by the end of CrossQ
        x: np.isfinite(
            table.reached([[r for r in run if r["sim_steps"] <= end] for run in runs[x]], 38)
        )
        for x in ("crossq", "best-g")
    }
    walk, there, few_falls = then["best-g"].sum(1)
    assert then["crossq"].all() and "all three CrossQ are at 38, walk, and have no fall" in mine
    counts = "none one two three four five six seven eight nine ten".split()
    told = f"Of ten `best`, cut at the same {end / 1e6:.2f} M, {counts[there]} are at 38, "
    told += f"{counts[walk]} walk by"
    assert (
        told in mine and f"and {counts[few_falls]} have had at most 1 % falls at the level" in mine
    )
    told = f"By {end / 1e6:.2f} M all three CrossQ walk, "
    assert f"{told}and {counts[walk]} of ten `best`." in words
    fisher = pytest.importorskip("scipy.stats").fisher_exact
    p = [fisher([[3, 0], [n, 10 - n]]).pvalue for n in (walk, few_falls)]
    assert "Fisher's exact p is {:.2f} for walks, {:.2f} for few falls".format(*p) in mine
    last = np.mean([run[-1]["return"] for run in runs["crossq"]])
    assert f"last three evaluations; the last alone is {last:.1f} for CrossQ" in words
    pair = [seed_means(runs[x], peers.WINDOW_EARLY) for x in ("best-g", "crossq")]
    told = "it is {} less, which is not shown ({} less to {} more, p {:.2f})"
    assert gap_of(told, *pair, digits=1) in mine and stats.difference(*pair).low < 0
    assert "from {:.2f} to {:.2f} M".format(*(x / 1e6 for x in peers.WINDOW_EARLY)) in mine
    assert (
        max(r["return"] for run in runs["crossq"] for r in run) < 40
        and "No seed of CrossQ is at" in mine
    )
    ppo = level["ppo-level-g"]
    assert gap_of("{} M fewer to 38 ({} to {}, p {:.0e})", ppo, crossq).replace("e-0", "e-") in mine
    told = "PPO needs {:.1f} times the steps of CrossQ ({:.1f} to {:.1f})"
    assert told.format(*stats.ratio(ppo, crossq)) in mine
    names = "sac-twice", "crossq"
    pair = [by_seed(runs[x], lambda run: table.first(run, 35)) / 1e6 for x in names]
    assert gap_of("to 35 {} M fewer ({} to {}, p {:.4f})", *pair) in mine
    assert gap_of("to 38 {} M fewer ({} to {}, p {:.3f})", level["sac-twice"], crossq) in mine
    tries = [[], []]  # each has the seeds in order
    for row in jobs["sac_symmetric_cut"]:
        if row["name"] == "crossq":
            tries[len(tries[0]) >= 3].append(row)
    assert [len(x) / 3 for x in tries] == [1, 4] and "after one and four evaluations" in mine
    assert (
        tries[0][0]["sim_steps"] == 1e6 / 20 // 256 * 256
        and "1.0 M steps, with an evaluation" in mine
    )
    told = "the longer had {:.1f} after {:.3f} M steps.{}The runs above have {:.1f} after {:.3f} M"
    near = [(r["sim_steps"], r["return"]) for r in jobs["crossq"] if r["sim_steps"] == 204_800]
    last = [(r["sim_steps"], r["return"]) for r in tries[1][-3:]]
    both = [np.mean(x, 0) for x in (last, near)]
    between = part_of(mine, "0.200 M steps.", "The runs above")
    told = told.format(both[0][1], both[0][0] / 1e6, between, both[1][1], both[1][0] / 1e6)
    assert told in mine and f"shortened the job to {end / 1e6:.2f} M" in between
    clock = [table.first(run, 38, "seconds") for run in runs["crossq"]]
    assert f"they are there after {min(clock):.0f} to {max(clock):.0f} s." in mine
    alone = next(x for x in paper.rows(NUMBERS) if x["name"] == "go1 seconds to 38")["value"]
    told = "{:.1f} instead of {:.0f} to {:.0f} (three seeds"
    assert told.format(float(alone), min(clock), max(clock)) in words
    assert f"at 38 after {float(alone):.1f} s" in mine
    one = runs["crossq"][0]
    pace = (one[-1]["seconds"] - one[1]["seconds"]) / (one[-1]["sim_steps"] - one[1]["sim_steps"])
    assert f"The first {one[0]['seconds']:.0f} have the compilation in them" in mine
    assert f"later 100 k steps take {1e5 * pace:.0f} s" in mine
    assert {len({run[k]["seconds"] for run in runs["crossq"]}) for k in range(len(one))} == {1}
    alone_few = script("27_few/table").alone(EXPERIMENTS / "27_few/results/seconds.csv.xz")
    few = next(one for one in alone_few if one.robots == 256).level[:, 1] / 1e6
    tuned = few_of("robots-3", "robots-256-g")[1].level / 1e6
    assert len(few) == len(tuned) == 3
    fresh = (
        "{:.1f} k with 256 robots (three fresh seeds; {:.1f} k on three tuning seeds, with smaller"
    )
    assert "needs " + fresh.format(1e3 * few.mean(), 1e3 * tuned.mean()) in words
    told = "CrossQ takes {:.1f} times as many ({:.1f} to {:.1f}), with 64 robots"
    assert told.format(*stats.ratio(crossq, few)) in words
    job = paper.jobs(EXPERIMENTS / "24_off_policy/jobs.txt")["crossq"]
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("\\\n", " ")
    assert job.removeprefix("crossq ") in " ".join(page.split())
    assert "--robots 256 --updates 64 --batch 512 " in job and "64 gradient steps of 512" in mine
    docs = " ".join((EXPERIMENTS.parent / "docs/results.md").read_text().split())
    told = "is at 38 after {:.2f} M steps (three seeds, nothing tuned for them), `best` after {:.2f} M: a "
    assert told.format(crossq.mean(), best.mean()) in docs
    told = "saving of `best` beside it is not shown ({:.2f} to {:.2f} times, three seeds). By {:.2f} M all "
    assert (
        told.format(*times[1:], end / 1e6) + f"three CrossQ walk, {counts[walk]} of ten `best` do"
        in docs
    )
    told = "After {:.2f} M CrossQ has {:.1f}, `best` {:.1f};".format(end / 1e6, *map(np.mean, ends))
    assert told in docs
    told = f"trains for {min(clock):.0f} to {max(clock):.0f} s, three seeds at once, `best` for "
    assert (
        told + f"{float(alone):.1f}." in docs
        and f"needs {1e3 * few.mean():.1f} k steps with" in docs
        and f"fresh seeds; {1e3 * tuned.mean():.1f} k on tuning seeds, with smaller" in docs
    )
    few_page = " ".join((EXPERIMENTS / "27_few/peers.md").read_text().split())
    told = "CrossQ needs [{:.2f} M](../24_off_policy/README.md#crossq), where `few` needs {:.1f} k (three"
    told += " fresh seeds; {:.1f} k on tuning seeds, with smaller steps late, which it no longer has) and "
    told += "`best`, with 1024, {:.2f} M"
    told = told.format(crossq.mean(), 1e3 * few.mean(), 1e3 * tuned.mean(), best.mean())
    assert told in few_page


def test_the_page_says_how_sac_with_symmetric_networks_is_beside_others():
    """Steps are each seed's mean of two tries, ends those of the second, which is whole."""
    peers, jobs, runs, level, words = of_today()
    table, mine = peers.less.table, part_of(words, "### Symmetric", "## The earlier task")
    whole, sac, best, ppo = (
        level[x] for x in ("sac-symmetric", "sac-twice", "best-g", "ppo-level-g")
    )
    cut = [
        table.first(
            [
                r
                for r in jobs["sac_symmetric_cut"]
                if (r["name"], r["seed"]) == ("sac-symmetric", s)
            ],
            38,
        )
        / 1e6
        for s in (100, 101, 102)
    ]
    assert sac == pytest.approx((np.array(cut) + whole) / 2, rel=1e-12)
    told = (
        f"at 38 by then, after {min(cut):.2f} to {max(cut):.2f} M, in the mean {np.mean(cut):.2f}."
    )
    assert told in mine
    told = "The second is whole: {:.2f}, {:.2f} and {:.2f} M, in the mean {:.2f}."
    assert told.format(*sorted(whole), whole.mean()) in mine
    assert f"seed 100 differs most: {cut[0]:.2f}, then {whole[0]:.2f} M" in mine
    told = "each seed's mean of both tries: to 38 {:.2f}, {:.2f} and {:.2f} M, in the mean {:.2f}."
    assert np.argmax(abs(whole - cut)) == 0 and told.format(*sac, sac.mean()) in mine
    assert f"over [both](#symmetric-networks) it is at 38 after {sac.mean():.2f} M" in words
    ends = {
        seed: [r["sim_steps"] for r in jobs["sac_symmetric_cut"] if r["seed"] == seed]
        for seed in (101, 102)
    }
    assert {f"{max(x) / 1e6:.1f}" for x in ends.values()} == {
        "1.2"
    } and "two were cut off at 1.2 M" in mine
    last = {run[-1]["sim_steps"] for run in runs["sac-symmetric"]}
    assert last == {2_004_992} == {run[-1]["sim_steps"] for run in runs["sac-today"]}
    told = "is there after {:.2f} M (the last seed {:.2f}; each seed's mean of two tries, "
    told += "{:.2f} and {:.2f} M)."
    told = told.format(sac.mean(), sac.max(), np.mean(cut), whole.mean())
    assert told in words
    gap = stats.difference(ppo, sac)
    told = f"symmetric, needs {ppo.mean():.2f} M, " + "{:.2f} M more ({:.2f} to {:.2f})".format(
        *gap
    )
    assert told in words and gap.low > 0
    late = {x: seed_means(runs[x], peers.WINDOW_LATE) for x in peers.TODAY if x != "crossq"}
    end = np.mean(late["sac-symmetric"])
    assert f"SAC ends at {end:.1f}, after 2.0 M" in words
    assert (
        "{:.1f} between {:g} and {:g} M steps".format(end, *(x / 1e6 for x in peers.WINDOW_LATE))
        in mine
    )
    told = "{} more than without symmetric networks ({} to {}; p {:.3f})"
    assert gap_of(told, late["sac-symmetric"], late["sac-today"], digits=1) in mine
    told = "{} less than PPO there ({} to {}, p {:.2f})"
    assert gap_of(told, late["ppo-level-g"], late["sac-symmetric"], digits=1) in mine
    told = "{} less than `best` ({} to {}, p {:.3f})"
    assert gap_of(told, late["best-g"], late["sac-symmetric"], digits=1) in mine
    assert sum(max(r["return"] for r in run) >= 40 for run in runs["sac-symmetric"]) == 1
    assert "One seed of three gets to 40" in mine

    def to(at, name):
        return by_seed(runs[name], lambda run: table.first(run, at)) / 1e6

    for at, told in (
        (30, "to 30 in TIMES times the steps ({} M fewer, {} to {}, p {:.3f})"),
        (35, "to 35 in TIMES times ({} M fewer, {} to {}, p {:.4f})"),
    ):
        pair = to(at, "sac-today"), to(at, "sac-twice")
        told = told.replace("TIMES", f"{np.mean(pair[1]) / np.mean(pair[0]):.2f}")
        assert gap_of(told, *pair) in mine
    found = [max(row["return"] for row in run) for run in runs["sac-today"]]
    assert "of each is {:.2f}, {:.1f} and {:.1f}, so it misses".format(*found) in mine
    told = "to 35 symmetric SAC needs {} M fewer ({} to {}, p {:.0e})"
    assert gap_of(told, to(35, "ppo-level-g"), to(35, "sac-twice")).replace("e-0", "e-") in mine
    assert gap_of("to 38 {} M fewer ({} to {}, p {:.3f}).", ppo, sac) in mine
    assert f"alone the latter is not shown (p {stats.welch_of(ppo, whole):.2f})" in mine
    assert stats.difference(ppo, whole).low < 0
    told = "to 35 {} M more ({} to {}, p {:.4f})"
    assert gap_of(told, to(35, "sac-twice"), to(35, "best-g")) in mine
    told = gap_of("to 38 {} M more ({} to {}, p {:.3f}), which is ", sac, best)
    assert (
        told + "{:.1f} times the steps ({:.1f} to {:.1f})".format(*stats.ratio(sac, best)) in mine
    )
    careful = [
        by_seed(runs[x], lambda run: table.reached([run], 38).careful[0]) / 1e6
        for x in ("sac-twice", "best-g")
    ]
    told = "{:.2f} M with `best`, {:.2f} with SAC ".format(*(x.mean() for x in careful[::-1]))
    low, high = stats.difference(*careful)[1:]
    told += f"({-low:.2f} M fewer to {high:.2f} more, p {stats.welch_of(*careful):.2f})"
    assert told in mine
    often = [
        (runs[x][0][5]["sim_steps"] - runs[x][0][4]["sim_steps"]) / 1e6
        for x in ("sac-today", "ppo-level-g", "best-g")
    ]
    told = "an evaluation every {:.1f} M steps (PPO every {:.2f}, `best` every {:.2f})"
    assert told.format(*often) in mine
    docs = " ".join((EXPERIMENTS.parent / "docs/results.md").read_text().split())
    told = f"at 38 after {sac.mean():.2f} M steps (three seeds, each the mean of two tries, "
    told += f"{np.mean(cut):.2f} and {whole.mean():.2f}), PPO "
    told += "{:.2f} M later ({:.2f} to {:.2f})".format(*gap)
    assert told in docs


def test_the_page_says_what_fasttd3_does_on_a_g1():
    rows = paper.rows(EXPERIMENTS / "24_off_policy/results/fasttd3_g1.csv")
    words = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "").split())
    seeds = {seed: [r for r in rows if r["seed"] == seed] for seed in (100, 101, 102)}
    assert sum(map(len, seeds.values())) == len(rows)
    last = {seed: run[-1]["sim_steps"] / 1e6 for seed, run in seeds.items()}
    assert f"does not learn our task in {last[100]:.1f} M steps, with one seed" in words
    falls = [100 * row["fall_rate"] for row in seeds[100]]
    told = "highest evaluation is {:.1f} of 130, and {:.0f} to {:.0f} % of the episodes have a fall in every"
    assert told.format(max(r["return"] for r in seeds[100]), min(falls), max(falls)) in words
    told = "Two more seeds were cut off at {:.2f} M, with {:.1f} and {:.1f}"
    pair = sorted(seeds[seed][-1]["return"] for seed in (101, 102))
    assert told.format(last[101], *pair) in words and last[101] == last[102]
    walks = {
        x["name"]: float(x["value"]) for x in paper.rows(NUMBERS) if x["name"].startswith("g1")
    }
    told = "`best` walks there after {:.2f} M and PPO after {:.1f}. Nothing was tuned"
    assert told.format(walks["g1 walks"], walks["g1 PPO walks"]) in words


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
    assert found.keys() - jobs.keys() == {"crossq-u256", "crossq-u512", "sac-u256"}
    assert f"(`{'`, `'.join(sorted(found.keys() - jobs.keys()))}`;" in words
    assert [sum(job.startswith(x) for job in jobs.values()) for x in ("crossq ", "sac ")] == [12, 5]
    assert "Of the 17 twelve are CrossQ's and five SAC's." in words
    ends = {
        name: {run[-1]["sim_steps"] for run in found[name].seeds} for name in found.keys() & jobs
    }
    assert {len(one.seeds) for name, one in found.items() if name in jobs} == {2}
    whole = [name for name, end in ends.items() if end == {table.asked(jobs[name])}]
    new = [name for name in jobs if name not in found]
    counts = ["", *"one two three four five six seven eight nine ten".split()]
    told = f"{counts[len(whole)].title()} are whole, {counts[len(ends) - len(whole)]} were cut off by the "
    assert len(new) == 1 and f"{told}end of a call, and one has not begun: `{new[0]}`." in words
    assert f"# {len(jobs)} settings, {len(new)} not begun" in page
    told = (
        "`peers_tune.txt` has {} settings of CrossQ and SAC for 64 robots, each to {:.0f} k steps "
    )
    told = told.format(len(jobs), table.STEPS / 1e3)
    assert f"{told[:-1]}, on tuning seeds 0 and 1." in words
    assert {table.asked(job) for job in jobs.values()} == {204_800}
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
    assert {*first} - {"none"} == {*new, "crossq-w2048"}
    assert "below the level before nine tenths of its steps: `crossq-w2048`." in words


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
        "crossq-b": table.setting([run(0, 37, 37, last=150e3)] * 2, 204_800),
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
    # `crossq` needs 153.6 k; a seed that is there after 110 and one that is not by 198 need more in the mean
    there, late = run(0, 38, last=110e3), run(1, 37, last=198e3)
    found["crossq-b"] = table.setting([there, run(1, 37, last=196e3)], 409_600)
    assert table.least(found["crossq-b"]) == 153e3
    assert table.best(found, jobs, "crossq") == ("crossq", ["crossq-b", "crossq-d"])
    found["crossq-b"] = table.setting([there, late], 409_600)
    assert not found["crossq-b"].counts and table.least(found["crossq-b"]) == 154e3
    assert table.best(found, jobs, "crossq") == ("crossq", ["crossq-d"])
    assert table.least(table.setting([late], 409_600)) == 99e3  # the other seed has not run
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
        path.write_text(head + "".join(f"x,{seed},{s},1,{back},0\n" for s in (110e3, last)))

    (tmp_path / "runs").mkdir()
    with pytest.raises(SystemExit, match="crossq-w2048 must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    for name in paper.jobs(jobs):
        for seed in (0, 1):
            write(name, seed, 204_800, 30)
    for seed in (0, 1):
        write("crossq-u128", seed, 204_800, 39)
    (tmp_path / "runs/crossq-u128-1.csv").rename(tmp_path / "runs/crossq-u128-1.csv.part")
    write("sac-symmetric", 0, 204_800, 38.5)
    with (tmp_path / "runs/crossq-u128-1.csv.part").open("a") as file:
        file.write("x,1,204800,2,3")  # of 39
    found = peers.table.of_run(tmp_path / "runs/crossq-u128-1.csv.part")
    assert [row["return"] for row in found] == [39, 39]
    (tmp_path / "runs/crossq-u128-0.csv.new").write_text(head + "x,0,6400,1,38,0\nx,0,12800,1,,")
    sooner = tmp_path / "runs/crossq-w2048-0.csv"
    whole = sooner.read_text()
    sooner.write_text(head + "x,0,6400,1,38,0\n")  # and its other seed is not there
    (tmp_path / "runs/crossq-w2048-1.csv").rename(tmp_path / "crossq-w2048-1.csv")
    with pytest.raises(SystemExit, match="crossq-w2048 must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    (tmp_path / "crossq-w2048-1.csv").rename(tmp_path / "runs/crossq-w2048-1.csv")
    sooner.write_text(whole)
    assert peers.table.of_each_method(tmp_path / "runs", jobs) == ["crossq-u128", "sac-symmetric"]
    ran = []
    monkeypatch.setattr(peers, "start", lambda to, *rest: ran.append(to.stem))
    words = ["peers.py", str(tmp_path / "fresh"), str(jobs), "--best", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", [*words, "--seeds", "100", "101", "102"])
    peers.main()
    assert ran == ["crossq-u128-100-102", *(f"sac-symmetric-{seed}" for seed in (100, 101, 102))]
    ran.clear()
    (
        tmp_path / "runs/sac-symmetric-0.csv"
    ).unlink()  # of one method, what the other lacks does not matter
    words = ["peers.py", str(tmp_path / "fresh"), str(jobs), "crossq", "--seeds", "100", "101"]
    monkeypatch.setattr(sys, "argv", [*words, "--best", str(tmp_path / "runs")])
    peers.main()
    assert ran == ["crossq-u128-100-101"]
    with pytest.raises(SystemExit, match="ppo: no method, expected one of crossq, sac"):
        peers.table.of_each_method(tmp_path / "runs", jobs, ["ppo"])


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
    order = "gamma97 first1k u128 b1024 gamma95 scale10  scale100".split(" ")
    order = [f"crossq-{x}".rstrip("-") for x in order]
    assert [name for _, name in needs] == order
    told = "in eight settings, after {:.0f} to {:.0f} thousand simulator steps. `few` is there after {:.1f}"
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
    shown = re.search(r"others need (.+?) times as many", words)[1]
    assert shows(shown, *times[1:])
    assert "need {:.1f} and {:.1f} k, so two say".format(*sorted(best / 1e3)) in words
    ends = [
        end / first.mean() for end in (min(map(min, level.values())), max(map(max, level.values())))
    ]
    assert "need {:.1f} to {:.0f} times the steps of `few`".format(*ends) in words
    assert sum(map(len, level.values())) == 16 and "All sixteen runs of these" in words
    last = [run[-1]["return"] for run in found["crossq-gamma97"].seeds]
    assert shows(
        re.search(r"At its end\*\* gamma 0.97 has (.+?)\. `few`", words)[1].replace(
            "gamma 0.97", ""
        ),
        *last,
    )
    text = re.search(r"to a return of 30 more updates, .+? of these is shown", words)[0]
    few_30 = [
        next(r["sim_steps"] for r in run if r["return"] >= 30)
        for run in few_of("late", "fresh-late-g")[0]
    ]
    to_30 = [
        early[f"crossq-{x}".rstrip("-")].mean() / 1e3
        for x in ("u128", "scale100", "w2048", "scale10", "gamma95", "")
    ]
    for x in ("b1024", "first1k"):
        assert early[f"crossq-{x}"].mean() == early["crossq-u128"].mean()
    assert early["crossq-gamma97"].mean() == early["crossq-w2048"].mean()
    told = "fewer random transitions need {:.1f} k, rewards x 100 {:.1f}, wider critics and gamma 0.97 "
    told += (
        "{:.1f}, rewards x 10 {:.1f}, gamma 0.95 {:.1f}, the setting that all start from {:.1f} "
    )
    told += "(`few` {:.1f})"
    assert told.format(*to_30, np.mean(few_30) / 1e3) in text
    better = "u128 b1024 first1k scale100 w2048 gamma97 scale10 gamma95".split()
    p30 = [stats.welch_of(early[f"crossq-{x}"], early["crossq"]) for x in better]
    p38 = [stats.welch_of(level[x], level["crossq"]) for x in order if x != "crossq"]
    spans = min(p30), max(p30), min(p38), max(p38)
    assert "p {:.2f} to {:.2f}, to 38 {:.2f} to {:.2f}, uncorrected".format(*spans) in words
    at_102 = {x: np.mean(at(x, 102_400)) for x in found if len(at(x, 102_400)) == 2}
    told = "random transitions have {:.1f}, more than any other; the critics 2048 wide, cut off there, "
    told += "{:.1f}, gamma 0.97 {:.1f}."
    shown = [at_102[f"crossq-{x}"] for x in ("first1k", "w2048", "gamma97")]
    assert told.format(*shown) in words and max(at_102, key=at_102.get) == "crossq-first1k"
    pair = at("crossq-gain1", 204_800), at("crossq", 204_800)
    told = "gain of 1 it ends at {:.1f}, {:.1f} less than with 1.5, which is not shown (p {:.2f})"
    gap = np.mean(pair[1]) - np.mean(pair[0])
    assert told.format(np.mean(pair[0]), gap, stats.welch_of(*pair)) in words
    pair = at("crossq", 192_000), at("crossq-gain05", 192_000)
    told = f"stays at {np.mean(pair[1]):.1f} (after 192 k {np.subtract(*map(np.mean, pair)):.1f} less than"
    told += " with 1.5, p "
    assert told + f"{stats.welch_of(*pair):.4f})" in words
    rates = [r["fall_rate"] for run in found["crossq-gain05"].seeds for r in run]
    assert (
        np.median(rates) == 0 and np.mean(rates) < 0.01 and "CrossQ seldom falls and stays" in words
    )
    pair = at("crossq-w512", 204_800), at("crossq", 204_800)
    told = "ends at {:.1f}, with 1024 at {:.1f}, which is not shown, either (p {:.2f}, uncorrected)"
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
    assert told in text and "**Not run**: symmetric SAC with 64 robots" in text


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
    assert len(names) == 17
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
    head = "seed,sim_steps,return,fall_rate\n"
    longer, shorter = (f"{head}1,{steps},20,0\n" for steps in (900, 100))
    (out / "b-1.csv.part").write_text(shorter)
    (out / "b-1.csv.new").write_text(longer)  # a call was cut as it ran again
    words = ["peers.py", str(out), str(tmp_path / "jobs.txt"), "--workers", "2"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit, match="^failed: a-1, b-1$"):
        peers.main()
    assert (out / "a-0.csv").read_text() == f"{peers.COMMON} --updates 3 --seed 0"
    assert not (out / "a-1.csv").exists() and (out / "a-1.csv.part").exists()
    assert (out / "b-0.csv").read_text() == "before" and not (out / "b-1.csv").exists()
    # the last try has written nothing to compare, so the farther one of before stays
    assert (out / "b-1.csv.part").read_text() == longer and not (out / "a-0.csv.part").exists()
    assert not [*out.glob("*.new")]


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


def test_a_row_of_an_evaluation_has_its_means_and_where_it_ran():
    """By hand: ten steps; squared errors that add up to 0.9 and 3.6 are 0.3 and 0.6 in the mean."""
    sac = script("24_off_policy/sac")
    args = argparse.Namespace(config="go1:best", seed=7)
    row = sac.row("crossq", args, 2560.0, 12.3456, (40.123, 0.02, 0.9, 3.6, 10.0))
    assert (row["job"], row["seed"], row["sim_steps"]) == ("crossq go1:best", 7, 2560)
    numbers = [row[x] for x in ("seconds", "return", "fall_rate", "tracking_error", "yaw_error")]
    assert numbers == ["12.35", "40.12", "0.02", "0.3", "0.6"]
    assert row["device"] == "cpu" and row["commit"] == versions.commit()

"""Off-policy methods: pages of 24_off_policy and of 27_few/peers.md, and the scripts that train them."""

import argparse
import csv
import itertools
import lzma
import re
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from result_files import EXPERIMENTS, few_fresh, few_jobs, few_of, less, script

from dynappo.config import versions
from experiments import paper, stats

NUMBERS = EXPERIMENTS.parent / "docs/numbers.csv"
CUT = EXPERIMENTS / "27_few/peers_tune_cut.csv"


def test_the_page_of_the_peers_has_the_numbers_of_its_runs(drawn, monkeypatch, capsys):
    """Of the earlier task and of today's, where SAC with symmetric networks is beside others."""
    monkeypatch.setattr(sys, "argv", ["plot.py"])
    peers = script("24_off_policy")
    peers.main()
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "")
    words = " ".join(page.split())
    printed = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    rows = {cells[0].strip("| "): cells for cells in printed if len(cells) > 9}
    assert drawn == ["peers"] and len(rows) == 13  # with the head, which both tables have
    said = [cells[0] for cells in printed if len(cells) == 1 and cells[0][0] != "|"]
    assert said[0] == "2.2 to 2.5 M steps: -2.4 (-2.9 to -1.9), p 1e-05; 41.4"
    assert "(1.9 to 2.9; PPO 41.4; p 1e-5)" in page
    for name, cells in rows.items():  # walks, first at 38, with few falls; 30, 35, 40
        assert " | ".join(cells[2:5] + cells[6:9]) in page, name
        if name in peers.TODAY:  # ends are of the last three evaluations
            assert (
                cells[1] in ("3", "5", "8", "10")
                and f"| {' | '.join(cells[1:5] + cells[6:11])} |" in page
            )
    assert len(said) == 1 + len(peers.PAIRS)
    jobs, table = peers.read(), peers.less.table
    runs = {name: table.seeds(jobs[name]) for name in (*peers.TODAY, "sac", "sac-twice")}
    level = {name: table.reached(runs[name], 38).level / 1e6 for name in runs}
    assert np.isnan(level["sac-today"]).all()
    first, later = [100, 101, 102], [103, 104, 105, 106, 107]
    seeds = {name: [run[0]["seed"] for run in runs[name]] for name in runs}
    assert seeds["sac-symmetric"] == seeds["sac-today"] == first
    assert seeds["crossq-symmetric"] == later and seeds["crossq"] == later + first
    assert "SAC 100 to 102, CrossQ 103 to 107, with mirrored batches 100 to 107." in words
    assert (
        f"PPO, tuned for the level and symmetric, needs {level['ppo-level-g'].mean():.2f} M"
        in words
    )
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
    """With 256 robots: in steps, falls and walks, and at its end; beside `few`; with the rule's verdicts,
    which fresh.py prints of results/fresh."""
    peers, jobs, runs, level, words = of_today()
    table, mine = peers.less.table, part_of(words, "### CrossQ", "### Symmetric")
    best, crossq, mirrored = (level[x] for x in ("best-g", "crossq-symmetric", "crossq"))
    assert [len(x) for x in (best, crossq, mirrored)] == [10, 5, 8]
    fresh = script("24_off_policy/fresh")
    for name, steps in (("crossq-256-symmetric", crossq), ("crossq-256", mirrored)):
        run = fresh.runs_of(fresh.RUNS, name)
        assert sorted(table.reached(run, 38).level / 1e6) == sorted(steps)
        assert fresh.SETTINGS[name] == (len(steps), "best", "g")
    times, again = stats.ratio(crossq, best), stats.ratio(mirrored, best)
    assert fresh.verdict(times, "best") == "CrossQ needs fewer"
    assert fresh.verdict(again, "best") == "no saving of `best` is shown"
    told = "after {:.2f} M simulator steps (five fresh seeds, the last {:.2f}). `best` needs {:.2f} M (ten), "
    told = told.format(crossq.mean(), crossq.max(), best.mean())
    told += "so CrossQ takes {:.2f} times its steps (95 % by Fieller, {:.2f} to {:.2f})".format(
        *times
    )
    assert told in words and "beside it `best`, with its model, saves no steps to the" in words
    then = {
        x: [table.first(run, 38, "fall_rate") for run in runs[x]]
        for x in ("crossq-symmetric", "best-g")
    }
    told = f"None of its 500 episodes has a fall then; with `best` {100 * np.mean(then['best-g']):.1f} % have"
    assert told in words and {*then["crossq-symmetric"]} == {0}
    # steps to the level, and how often they were evaluated
    told = gap_of(
        "CrossQ needs fewer steps than `best`, {} M fewer to 38 (", best, crossq, digits=3
    )
    assert told + gap_of("{1} to {2}, ", best, crossq, digits=3) in mine
    assert f"p {stats.welch_of(best, crossq):.3f}). It was evaluated every" in mine
    often = [
        (runs[x][0][5]["sim_steps"] - runs[x][0][4]["sim_steps"]) / 1e6
        for x in ("crossq-symmetric", "best-g")
    ]
    told = "evaluated every {:.3f} M steps with 100 episodes, `best` every {:.3f} with 1000."
    assert told.format(*often) in mine
    half = {
        at: [
            by_seed(runs[x], lambda run: table.first(run, at)) / 1e6 - step / 2  # noqa: B023
            for x, step in zip(("crossq-symmetric", "best-g"), often, strict=True)
        ]
        for at in (38, 30, 35)
    }
    told = "{:.2f} times the steps ({:.2f} to {:.2f}), to 30 {:.2f} times ({:.2f} to {:.2f}) and to 35 "
    told += "{:.2f} times ({:.2f} to {:.2f})"
    assert told.format(*(x for pair in half.values() for x in stats.ratio(*pair))) in mine
    told = "no saving of `best` is shown ({:.2f} M, eight seeds; {:.2f} times its steps, {:.2f} to {:.2f})"
    assert told.format(mirrored.mean(), *again) in mine
    told = "need {:.2f} times the steps of mirrored batches to 38 ({:.2f} to {:.2f}), and have "
    longer = [run for run in runs["crossq"] if run[-1]["sim_steps"] == 614_400]
    pair = [seed_means(x, peers.WINDOW_EARLY) for x in (runs["crossq-symmetric"], longer)]
    told = told.format(*stats.ratio(crossq, mirrored)) + "{} more between {} and {} M ("
    told = told.format(
        f"{stats.difference(*pair).value:.1f}", *(x / 1e6 for x in peers.WINDOW_EARLY)
    )
    told += gap_of("{1} to {2}, p {3:.3f}, five seeds each)", *pair, digits=1)
    assert told in mine and [len(x) for x in pair] == [5, 5]
    # falls and walks
    end = runs["crossq-symmetric"][0][-1]["sim_steps"]
    assert {run[-1]["sim_steps"] for run in runs["crossq-symmetric"]} == {end} == {614_400}
    at = {
        (x, steps, what): table.between(jobs[x], steps, what)
        for x in ("crossq-symmetric", "best-g")
        for steps in (409_600, end)
        for what in ("return", "fall_rate")
    }

    def pair_at(steps, what, scale=1):
        return [scale * at[x, steps, what] for x in ("best-g", "crossq-symmetric")]

    early, late = (pair_at(steps, "fall_rate", 100) for steps in (409_600, end))
    told = f"after 0.41 M CrossQ falls in none of 500 episodes, `best` in {early[0].mean():.1f} % "
    told += gap_of("({1} to {2} points more, p {3:.3f}), ", *early, digits=1)
    told += f"after {end / 1e6:.2f} M in {late[1].mean():.1f} and {late[0].mean():.1f} % "
    told += gap_of("({1} to {2} points more, p {3:.3f}).", *late, digits=1)
    assert told in mine and not early[1].any()
    walk = [table.reached(runs[x], 38).walks / 1e6 for x in ("best-g", "crossq-symmetric")]
    assert all(np.isfinite(x).all() for x in walk)
    told = f"All five walk, from {walk[1].mean():.2f} M on in the mean, `best` from {walk[0].mean():.2f}, "
    ends = [runs[x][0][-1]["sim_steps"] / 1e6 for x in ("crossq-symmetric", "best-g")]
    told += "one of the ten from {:.1f} (by runs that end at {:.2f} and {:.1f} M, with 100 and 1000 episodes "
    told = told.format(walk[0].max(), *ends) + "an evaluation). This difference is not shown "
    assert told + gap_of("({0} M fewer; {1} fewer to {2} more, p {3:.2f})", *walk) in mine
    assert stats.difference(*walk).low < 0
    cut = {
        x: [[r for r in run if r["sim_steps"] <= end] for run in runs[x]]
        for x in ("crossq-symmetric", "best-g")
    }
    counts = "none one two three four five six seven eight nine ten".split()
    walked, high = (
        {x: sum(of(run) for run in cut[x]) for x in cut}
        for of in (
            lambda run: np.isfinite(table.reached([run], 38).walks[0]),
            lambda run: max(r["return"] for r in run) >= 40,
        )
    )
    assert walked["crossq-symmetric"] == high["crossq-symmetric"] == 5
    fisher = pytest.importorskip("scipy.stats").fisher_exact
    p = fisher([[5, 0], [walked["best-g"], 10 - walked["best-g"]]]).pvalue
    told = f"Judged at {end / 1e6:.2f} M, where CrossQ's runs end, five of five CrossQ and "
    told += (
        f"{counts[walked['best-g']]} of ten `best` walk, which is not shown to differ (p {p:.2f}); "
    )
    assert f"{told}all five and {counts[high['best-g']]} of the ten have been at 40." in words
    told = f"nor one in walks if both are judged at {end / 1e6:.2f} M, five of five and "
    told += f"{counts[walked['best-g']]} of ten (Fisher's exact p {p:.2f}; by all their later evaluations "
    still = counts[(walk[0] <= end / 1e6).sum()]
    assert f"{told}{still} of the ten walk from then on)" in mine and p > 0.05
    careful = [table.reached(runs[x], 38).careful / 1e6 for x in ("best-g", "crossq-symmetric")]
    told = f"nor one in steps to 38 with few falls, {careful[1].mean():.2f} and {careful[0].mean():.2f} M "
    assert told + gap_of("({0} M fewer; {1} fewer to {2} more, p {3:.2f})", *careful) in mine
    # later
    to_40 = [
        by_seed(runs[x], lambda run: table.first(run, 40)) / 1e6
        for x in ("best-g", "crossq-symmetric")
    ]
    told = f"to 40 it is {to_40[1].mean():.2f} and {to_40[0].mean():.2f} M "
    assert told + gap_of("({0} M fewer; {1} fewer to {2} more, p {3:.2f})", *to_40) in mine
    last = pair_at(end, "return")
    five = [run[-1]["return"] for run in longer]
    told = f"After {end / 1e6:.2f} M CrossQ has {last[1].mean():.1f}, `best` {last[0].mean():.1f} "
    told += gap_of("({0} less; {1} less to {2} more, p {3:.2f}), ", *last, digits=1)
    told += f"CrossQ with mirrored batches {np.mean(five):.1f} "
    assert told + gap_of("({0} less; {1} to {2}, p {3:.3f})", last[0], five, digits=1) in mine
    told = "There CrossQ has {:.1f} and `best` {:.1f}, which is not shown to differ, and `best` goes on to "
    final = np.mean([[r["return"] for r in run[-3:]] for run in runs["best-g"]])
    assert told.format(last[1].mean(), last[0].mean()) + f"{final:.1f}." in words
    assert f"goes on to the {final:.1f} of `best` is not known" in mine
    told = "three seeds of CrossQ end at 0.4 M; the other five have {:.1f} at {:.1f} M"
    ends = [run[-1]["sim_steps"] for run in runs["crossq"]]
    assert sorted(ends) == 3 * [409_600] + 5 * [end]
    its = runs["sac-symmetric"][0][-1]["sim_steps"]
    assert f"by runs that end at {end / 1e6:.1f} and {its / 1e6:.1f} M; those of" in words
    assert told.format(np.mean(five), end / 1e6) in words
    # others
    ppo, both = level["ppo-level-g"], level["sac-twice"]
    told = gap_of("{} M fewer to 38 ({} to {}, p {:.0e})", ppo, crossq).replace("e-0", "e-")
    told += "; PPO needs {:.1f} times the steps of CrossQ ({:.1f} to {:.1f})"
    assert told.format(*stats.ratio(ppo, crossq)) in mine
    pair = [
        by_seed(runs[x], lambda run: table.first(run, 35)) / 1e6
        for x in ("sac-twice", "crossq-symmetric")
    ]
    assert gap_of("to 35 {} M fewer ({} to {}, p {:.4f})", *pair) in mine
    assert gap_of("to 38 {} M fewer ({} to {}, p {:.3f})", both, crossq) in mine
    few = few_of("default", "default-g")[1].level / 1e6
    told = f"is there after {1e3 * few.mean():.1f} k (ten fresh seeds), and CrossQ takes "
    shown = stats.ratio(crossq, few)
    assert told + "{:.1f} times as many ({:.1f} to {:.1f})".format(*shown) in words
    assert "needs a fifth of that" in words and 0.17 < 1 / shown.value < 0.22
    few_page = " ".join((EXPERIMENTS / "27_few/peers.md").read_text().split())
    told = "CrossQ needs [{:.2f} M](../24_off_policy/README.md#crossq), where `few` needs {:.1f} k (ten"
    told += " fresh seeds) and `best`, with 1024, {:.2f} M"
    assert told.format(crossq.mean(), 1e3 * few.mean(), best.mean()) in few_page


def test_the_page_says_how_crossq_was_run_how_long_it_trains_and_what_was_predicted():
    """Settings, updates and seconds to 38, and what was cut off."""
    peers, jobs, runs, level, words = of_today()
    table, mine = peers.less.table, part_of(words, "### CrossQ", "### Symmetric")
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("\\\n", " ")
    job = paper.jobs(EXPERIMENTS / "24_off_policy/jobs.txt")["crossq"]
    assert job.removeprefix("crossq ") in " ".join(page.split())
    assert "--robots 256 --updates 64 --batch 512 " in job and "64 gradient steps of 512" in mine
    symmetric, few_steps = (
        level["crossq-symmetric"],
        crossq_of_few("crossq-64-symmetric").level / 1e3,
    )
    told = "We expected 0.20 M with 256 robots and symmetric networks, which was right ({:.2f}), and 90 "
    told += "thousand with 64, which was a little too low ({:.1f})"
    assert told.format(symmetric.mean(), few_steps.mean()) in mine and 90 < few_steps.mean() < 110
    with (EXPERIMENTS / "24_off_policy/results/fresh/crossq-256-103-107.csv").open() as file:
        where = {(row["device"], row["commit"]) for row in csv.DictReader(file)}
    assert where == {("NVIDIA H200", "94da69b834c4")} and "2026-11-29, commit 94da69b8" in mine
    # updates: each of 256 robots acts, then 64, but none while fewer than 5000 transitions are there
    crossq = 64 * (1e6 * symmetric.mean() / 256 - 5000 // 256)
    config = script("30_row_cost/run").read("go1:best", []).config
    model, ppo, rows = config.model, config.ppo, config.rollout.horizon - config.schedule.end_steps
    iterations = 1e6 * level["best-g"].mean() / (rows * config.rollout.num_envs)
    of_policy = iterations * config.schedule.rounds * ppo.epochs * ppo.minibatches
    late = iterations - model.late_from
    of_model = model.minibatches * (model.late_from * model.epochs + late * model.late_epochs)
    told = "until 38 CrossQ makes {:.0f} thousand updates of its critics and a third as many of its actor, "
    told += "`best` {:.0f} thousand of its policy and {:.0f} thousand of its model"
    assert told.format(crossq / 1e3, of_policy / 1e3, of_model / 1e3) in mine
    assert script("24_off_policy/crossq").DELAY == 3
    # seconds
    first = [run for run in runs["crossq"] if run[0]["seed"] < 103]
    clock = [table.first(run, 38, "seconds") for run in first]
    alone = next(x for x in paper.rows(NUMBERS) if x["name"] == "go1 seconds to 38")["value"]
    assert f"there after {float(alone):.1f} s ([30_row_cost]" in mine
    start = first[0][0]["seconds"]
    told = f"takes {min(clock):.0f} to {max(clock):.0f} s, of which the first {start:.0f} have the "
    assert f"{told}compilation." in mine
    clock = [table.first(run, 38, "seconds") for run in runs["crossq-symmetric"]]
    told = (
        f"With symmetric networks it is {min(clock):.0f} to {max(clock):.0f} s, five seeds at once"
    )
    assert told in mine
    told = f"`best` is far ahead: {float(alone):.1f} s to the level, CrossQ {min(clock):.0f} to "
    assert f"{told}{max(clock):.0f} s (five seeds at once on a shared card)." in words
    rows = paper.rows(EXPERIMENTS / "24_off_policy/results/fresh/crossq-64-symmetric-103-105.csv")
    clock = [
        table.first([r for r in rows if r["seed"] == s], 38, "seconds") for s in (103, 104, 105)
    ]
    assert f"with 64 robots {min(clock):.0f} to {max(clock):.0f} s, three at once, alone" in mine
    few_page = " ".join((EXPERIMENTS / "27_few/peers.md").read_text().split())
    table_of_few = script("27_few/table")
    path = EXPERIMENTS / "27_few/results/seconds.csv.xz"
    its = next(one.level[:, 2] for one in table_of_few.alone(path) if one.robots == 64)
    told = f"({min(clock):.0f} to {max(clock):.0f} s to 38, three seeds at once; `few` takes "
    assert f"{told}[{its.mean():.1f}](README.md#seconds)" in few_page
    # what was cut off
    tries = [[], []]  # each has the seeds in order
    for row in jobs["sac_symmetric_cut"]:
        if row["name"] == "crossq":
            tries[len(tries[0]) >= 3].append(row)
    assert [len(x) / 3 for x in tries] == [1, 4]
    last = np.mean([(r["sim_steps"], r["return"]) for r in tries[1][-3:]], 0)
    assert f"chosen after we had seen {last[1]:.1f} after {last[0] / 1e6:.3f} M" in mine
    end = first[0][-1]["sim_steps"] / 1e6
    seeds = [[run[0]["seed"] for run in some] for some in (runs["crossq"][:5], first)]
    assert f"Mirrored, seeds {seeds[0][0]:.0f} to {seeds[0][-1]:.0f}: the same card" in mine
    assert f"Seeds {seeds[1][0]:.0f} to {seeds[1][-1]:.0f} (`results/crossq.csv`): one H200" in mine
    assert f"their end at {end:.2f} M and the interval were" in mine


def test_the_page_of_results_says_how_crossq_is_beside_best():
    peers, _, runs, level, _ = of_today()
    table, end = peers.less.table, runs["crossq-symmetric"][0][-1]["sim_steps"]
    docs = " ".join((EXPERIMENTS.parent / "docs/results.md").read_text().split())
    crossq, best = level["crossq-symmetric"], level["best-g"]
    told = "is at 38 after {:.2f} M steps (five seeds, nothing tuned for them), {:.2f} times those of `best` "
    told += "({:.2f} to {:.2f}): it needs fewer."
    assert told.format(crossq.mean(), *stats.ratio(crossq, best)) in docs
    cut = [[r for r in run if r["sim_steps"] <= end] for run in runs["best-g"]]
    walk = np.isfinite(table.reached(cut, 38).walks).sum()
    assert np.isfinite(table.reached(runs["crossq-symmetric"], 38).walks).all() and walk == 6
    last = [
        np.mean([np.interp(end, *x) for x in curves(runs[k])])
        for k in ("crossq-symmetric", "best-g")
    ]
    fisher = pytest.importorskip("scipy.stats").fisher_exact([[5, 0], [walk, 10 - walk]]).pvalue
    told = f"Judged at {end / 1e6:.2f} M, where CrossQ's runs end, five of five CrossQ and six of ten `best` "
    told += f"walk, which is not shown to differ (p {fisher:.2f}); "
    then = f"there CrossQ has {last[0]:.1f}, `best` {last[1]:.1f}, which is not shown to differ"
    assert told + then in docs
    alone = next(x for x in paper.rows(NUMBERS) if x["name"] == "go1 seconds to 38")["value"]
    clock = [table.first(run, 38, "seconds") for run in runs["crossq-symmetric"]]
    told = f"CrossQ trains for {min(clock):.0f} to {max(clock):.0f} s to 38 (five seeds at once on a shared "
    assert f"{told}card), `best` alone for {float(alone):.1f}." in docs
    few = few_of("default", "default-g")[1].level / 1e3
    assert f"needs {few.mean():.1f} k steps with 256 robots (ten fresh seeds)" in docs


def curves(runs):
    """Steps and returns of each run."""
    return [([r["sim_steps"] for r in run], [r["return"] for r in run]) for run in runs]


def test_the_page_says_how_far_crossq_came_on_an_anymal_before_it_was_cut_off():
    """By no rule: where its rows end, and how many of `best` are at the level by then."""
    page = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().split())
    with (EXPERIMENTS / "24_off_policy/results/crossq_c_cut.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {(r["job"], r["commit"][:8], r["device"]) for r in rows} == {
        ("crossq anymal_c:best", "2a51cc3d", "NVIDIA H200")
    }
    end = max(int(r["sim_steps"]) for r in rows)
    last = [r for r in rows if int(r["sim_steps"]) == end]
    assert [r["seed"] for r in last] == [*map(str, range(103, 108))]
    back = [float(r["return"]) for r in last]
    assert max(float(r["return"]) for r in rows) < 24 and {float(r["fall_rate"]) for r in last} == {
        0
    }
    text = f"they have {min(back):.1f} to {max(back):.1f}, and no falls in 500 episodes."
    assert f"cut off at {end / 1e6:.2f} of 0.61 M steps" in page and text in page
    table, jobs = less("headline")
    best = table.reached(table.seeds(jobs["best-c"]), 24).level
    assert len(best) == 10 and (best <= end).sum() == 5 and "Of `best` five of ten are." in page
    assert f"({best.mean() / 1e6:.2f} M to its level of 24)" in page


def test_the_pages_say_how_much_the_methods_were_tuned():
    """Runs of PPO that chose its settings; settings for 64 robots, and how long they ran."""
    words = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().split())
    with lzma.open(EXPERIMENTS / "21_less/results/ppo.csv.xz", "rt", newline="") as file:
        ppo = {
            (row["batch"], row["name"], row["seed"])
            for row in csv.DictReader(file)
            if row["name"][0] not in "qw" and row["batch"] in {*"123458"}
        }
    page = " ".join((EXPERIMENTS / "21_less/ppo.md").read_text().split())
    ((total, part),) = re.findall(r"PPO was chosen in (\d+): (.*?) of these on fresh seeds\.", page)
    found = [[*map(int, x)] for x in re.findall(r"(\d+)(?: settings)? in (\d+)", part)]
    settings, runs = zip(*found, strict=True)
    assert len(ppo) == sum(runs[:-1]) and int(total) == sum(runs)  # the last are controls
    told = f"PPO was chosen among {sum(settings)} settings in {total} runs ([21_less](../21_less/ppo.md))."
    assert told in words
    page = " ".join((EXPERIMENTS / "27_few/peers.md").read_text().split())
    settings = paper.jobs(EXPERIMENTS / "27_few/peers_tune.txt")
    assert not any("symmetric" in x for x in settings.values() if x.startswith("crossq"))
    rows = [
        *paper.rows(EXPERIMENTS / "27_few/peers_tune.csv"),
        *paper.rows(EXPERIMENTS / "27_few/peers_fresh.csv"),
    ]
    end = max(row["sim_steps"] for row in rows) / 1e3
    told = f"More than {len(settings)} settings for 64 robots, symmetric CrossQ tuned by itself, or CrossQ "
    assert f"{told}and SAC beyond {end:.0f} k steps." in page


def crossq_of_few(name):
    """A setting of CrossQ with 64 robots on fresh seeds."""
    return script("27_few/peers_table").fresh()[name]


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
    names = [x for x in peers.TODAY if not x.startswith("crossq")]
    late = {x: seed_means(runs[x], peers.WINDOW_LATE) for x in names}
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
    _, head = less("headline")
    other = table.reached(table.seeds(head["ppo-walk-g"]), 38).level / 1e6
    more = stats.difference(other, sac)
    told = f"nor beside PPO tuned to walk, which is there after {other.mean():.2f} M ({more.value:.2f} more, "
    told += f"{-more.low:.2f} fewer to {more.high:.2f} more, p {stats.welch_of(other, sac):.2f})"
    assert (
        told in mine and f"that tuned to walk needs {other.mean():.2f}, which is not shown" in words
    )
    verdict = " ".join((EXPERIMENTS / "README.md").read_text().split())
    told = f"PPO for the level {gap.value:.2f} M more, {gap.low:.2f} to {gap.high:.2f}, beside PPO to walk"
    assert f"{told} no difference is shown" in verdict
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
    told += f"{np.mean(cut):.2f} and {whole.mean():.2f}), PPO tuned for the level "
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
    words = " ".join(" ".join(lines).split())
    last = {}  # mean return of the last evaluation that all seeds have
    for method, runs in found.items():
        most = max(map(len, runs.values()))
        last[method] = np.mean(
            [p[0] for p in runs[max(k for k, p in runs.items() if len(p) == most)]]
        )
    pair = last["PPO, 96 rows"], last["PPO, 24 rows"]
    assert "PPO alone, with 64, gets to {:.0f} and {:.0f}, in two settings,".format(*pair) in words
    told = "CrossQ is at a return of {:.0f}, which a robot that stands still has, FastTD3 at {:.0f} and "
    told += "SAC at {:.0f}."
    assert told.format(*(last[method] for method in ("CrossQ", "FastTD3", "SAC"))) in words
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


def printed(table, monkeypatch, capsys, *flags):
    """Of peers_table.py: the lines of its table, and the others."""
    monkeypatch.setattr(sys, "argv", ["peers_table.py", *flags])
    table.main()
    out = capsys.readouterr().out.splitlines()
    return tuple([x for x in out if (x[0] == "|") == is_table] for is_table in (True, False))


def test_the_table_of_settings_of_other_methods_is_the_printed_one(monkeypatch, capsys):
    """And what is whole or cut off, and the best by the rule."""
    table, found, page = settings_of_peers()
    lines, said = printed(table, monkeypatch, capsys)
    part = part_of(page, "## With settings for few robots", "## With settings for more")
    assert lines == [x for x in part.splitlines() if x[0:1] == "|"] and len(lines) == 2 + len(found)
    assert said[0] == "CrossQ: crossq-gamma97, 118.4 k; at the end 39.5"
    assert said[2] == "SAC: sac-symmetric, 409.6 k; at the end 36.9"
    assert said[1] == said[3] == "  must run first: none"
    words = " ".join(part.split())
    assert "`crossq-gamma97` is first, and of SAC `sac-symmetric`, by its return" in words
    jobs = paper.jobs(EXPERIMENTS / "27_few/peers_tune.txt")
    left = "`crossq-u256`, `crossq-u512` and `sac-u256`, which were cut off"
    assert found.keys() - jobs.keys() == {*re.findall("`(.+?)`", left)} and left in words
    assert [sum(job.startswith(x) for job in jobs.values()) for x in ("crossq ", "sac ")] == [12, 5]
    assert jobs.keys() < found.keys() and len(jobs) == 17
    ends = {name: {run[-1]["sim_steps"] for run in found[name].seeds} for name in jobs}
    assert {len(found[name].seeds) for name in jobs} == {2}
    whole = sum(end == {table.asked(jobs[name])} for name, end in ends.items())
    assert (whole, len(jobs) - whole) == (11, 6)
    told = "has 17 settings, twelve CrossQ's and five SAC's: eleven are whole, six were cut off by the end"
    assert told in words and "peers_tune.txt --workers 8    # 17 settings" in page
    assert f"Tuning seeds 0 and 1, each to {table.STEPS / 1e3:.0f} k steps." in words
    assert {table.asked(job) for job in jobs.values()} == {204_800}
    assert {run[0]["seed"] for one in found.values() for run in one.seeds} == {0, 1}
    assert f"counts with twice the {table.STEPS / 1e3:.0f} k steps" in words
    assert "runs on seeds 100 to 102" in words and "runs on seeds 100 to 102" in table.__doc__
    given = (
        "64 updates a step with batches of 256, half of them mirrored, critics 1024 wide as its "
    )
    assert f"CrossQ has {given}authors', gamma 0.98 and a gain of 1.5," in words
    assert jobs["crossq"] == "crossq --updates 64 --batch 256 --mirror"
    source = (EXPERIMENTS / "24_off_policy/crossq.py").read_text()
    for flag in (("width", "int", 1024), ("gamma", "float", 0.98), ("gain", "float", 1.5)):
        assert 'add_argument("--{}", type={}, default={}'.format(*flag) in source


def few_runs():
    """Of `few` on its thirty fresh seeds: the runs, and the steps to a return of 30 and to the level."""
    found, reached = few_fresh("g")
    first = script("21_less/table").first
    return found, np.array([first(run, 30) for run in found]), reached.level


def test_the_best_of_other_methods_on_fresh_seeds_are_those_of_the_rule(monkeypatch, capsys):
    """peers_fresh.csv has whole runs of what peers_table.py chooses, another file those of CrossQ with
    symmetric networks; their table is on the page."""
    table, found, page = settings_of_peers()
    fresh, jobs = table.fresh(), paper.jobs(table.JOBS)
    of_the_rule = [table.best(found, jobs, method)[0] for method in table.METHODS]
    assert [*fresh] == [*of_the_rule, "crossq-64-symmetric"]
    for name, one in fresh.items():
        first = 100 if name in of_the_rule else 103
        assert [run[0]["seed"] for run in one.seeds] == [first, first + 1, first + 2]
        assert {run[-1]["sim_steps"] for run in one.seeds} == {204_800}
    for path, commit in ((table.FRESH, "6000006171c7"), (table.LATER, "94da69b834c4")):
        with path.open(newline="") as file:
            where = {(row["device"], row["commit"]) for row in csv.DictReader(file)}
        assert where == {("NVIDIA H200", commit)}
    words = " ".join(page.split())
    assert "2026-11-29, commit 60000061, with 100 episodes" in words
    assert "alone on it, 2026-11-29, commit 94da69b8" in words
    later = paper.jobs(EXPERIMENTS / "24_off_policy/fresh.txt")["crossq-64-symmetric"]
    assert later not in jobs.values() and "which was not in the list, on 103 to 105 by" in words
    lines, said = printed(table, monkeypatch, capsys, "--fresh")
    part = part_of(page, "## Fresh seeds", "## With settings for few")
    assert lines == [x for x in part.splitlines() if x[0:1] == "|"] and len(lines) == 5 and not said


def test_the_page_says_how_the_best_of_other_methods_on_fresh_seeds_are_beside_few():
    table, tuned, page = settings_of_peers()
    page = page.replace("**", "")
    head = " ".join(page.split("## Fresh seeds")[0].split())
    words = " ".join(part_of(page, "## Fresh seeds", "## With settings for few").split())
    assert "on seeds 100 to 102, which chose nothing" in words
    names = "crossq-64-symmetric", "crossq-gamma97", "sac-symmetric"
    crossq, mirrored, sac = (table.fresh()[name] for name in names)
    few, few_30, few_38 = few_runs()
    need, its = crossq.level / 1e3, mirrored.level / 1e3
    times, again = (stats.ratio(one.level, few_38) for one in (crossq, mirrored))
    told = (
        "is at the level, 38 of 45, after {:.1f} thousand simulator steps, {:.0f} minutes of one "
    )
    told = told.format(need.mean(), need.mean() / 3)
    told += f"robot's time (mean of three fresh seeds, the last {need.max():.1f}). `few` is there after "
    told += f"{few_38.mean() / 1e3:.1f} (thirty fresh seeds), so CrossQ needs {times.value:.1f} times its "
    told += "steps (95 % by Fieller, three and thirty seeds: {:.1f} to {:.1f})".format(*times[1:])
    assert told in head and (len(need), len(few_38)) == (3, 30)
    verdict = script("24_off_policy/fresh").verdict(times, "few")
    assert verdict == "CrossQ needs so many times the steps"
    told = f"in the best of twelve settings, it needs {its.mean():.1f}, "
    told += "{:.1f} times ({:.1f} to {:.1f}); the two are not shown to differ".format(*again)
    assert told in head
    told = "at 38 after {:.1f}, {:.1f} and {:.1f} k, with mirrored batches after {:.1f}, {:.1f} and {:.1f} "
    told = told.format(*sorted(need), *sorted(its))
    assert (
        told + gap_of("({0} k fewer; {1} fewer to {2} more, p {3:.2f})", its, need, digits=1)
        in words
    )
    assert stats.difference(its, need).low < 0

    def ends(runs, name="return"):
        return np.array([run[-1][name] for run in runs])

    end, few_end, sac_end = ends(crossq.seeds), ends(few), ends(sac.seeds)
    counts = "no one two three".split()
    fell = counts[round(100 * ends(crossq.seeds, "fall_rate").sum())]
    told = "it ends at {:.1f} after {:.0f} k, with {} falls in its last 300 episodes. `few` has {:.1f} after "
    told += "{:.0f} k."
    step, few_step = (run[0][-1]["sim_steps"] / 1e3 for run in (crossq.seeds, few))
    assert told.format(end.mean(), step, fell, few_end.mean(), few_step) in head
    early = [
        np.array([table.runs.first(run, 30) for run in one.seeds])
        for one in (crossq, mirrored, sac)
    ]
    ratios = [stats.ratio(one, few_30) for one in early]
    told = "is at 30 after {:.1f} k, `few` after {:.1f}: {:.1f} times the steps ({:.1f} to {:.1f}, three and"
    assert told.format(early[2].mean() / 1e3, few_30.mean() / 1e3, *ratios[2]) in head
    told = "To 30 it is {:.1f} and {:.1f} k, {:.1f} and {:.1f} times the steps of `few` ({:.1f} to {:.1f}, "
    told += "{:.1f} to {:.1f})."
    told = told.format(
        *(x.mean() / 1e3 for x in early[:2]),
        *(x.value for x in ratios[:2]),
        *(x for one in ratios[:2] for x in one[1:]),
    )
    assert told in words
    assert np.isnan(sac.level).all() and "is not at 38 by 205 k, with any of three fresh" in head
    assert f"fresh seeds, and has {sac_end.mean():.1f} then" in head
    plain = {x: one for x, one in tuned.items() if x[:3] == "sac" and x != "sac-symmetric"}
    means = [ends(one.seeds).mean() for one in plain.values()]
    stops = [one.seeds[0][-1]["sim_steps"] / 1e3 for one in plain.values()]
    told = "ends at {:.0f} to {:.0f} in five settings, after {:.0f} to {:.0f} k (two tuning seeds each)"
    assert told.format(min(means), max(means), min(stops), max(stops)) in head and len(plain) == 5
    walk = [table.runs.reached(one.seeds, 38).walks / 1e3 for one in (crossq, mirrored)]
    late = ends(crossq.seeds, "fall_rate")[np.isnan(walk[0])]
    told = (
        "{} of three with symmetric networks walk, from {:.0f} and {:.0f} k on; the third falls in "
    )
    there = sorted(walk[0][np.isfinite(walk[0])])
    told = (
        told.format(counts[len(there)], *there)
        + f"{100 * late[0]:.0f} % of its last. With mirrored "
    )
    told += f"batches three walk, from {min(walk[1]):.0f} to {max(walk[1]):.0f} k on"
    assert told in words and len(late) == 1
    # how often
    often = [np.diff([row["sim_steps"] for row in runs[0]]) / 1e3 for runs in (crossq.seeds, few)]
    assert all(np.ptp(gap) == 0 for gap in often)
    often = [gap[0] for gap in often]
    told = "CrossQ every {:.1f} k steps with 100 episodes, `few` every {:.1f} with 1000."
    assert (
        told.format(*often) in words
        and " run.eval_envs=1000 " in few_jobs("late")["fresh-late-g"][0]["job"]
    )
    half = need - often[0] / 2, few_38 / 1e3 - often[1] / 2
    told = "it is {:.1f} and {:.1f} k, {:.1f} times ({:.1f} to {:.1f})"
    assert told.format(*map(np.mean, half), *stats.ratio(*half)) in words
    # the end
    high = sum(max(r["return"] for r in run) >= 40 for run in crossq.seeds)
    told = f"after 205 k symmetric CrossQ has {end.min():.1f} to {end.max():.1f}, and {counts[high]} seed "
    assert told + "has been at 40." in words
    gap = gap_of("`few` has {} more after 44 k ({} to {}, p {:.3f})", few_end, end, digits=1)
    assert gap in words and few_step / step == pytest.approx(0.2, abs=0.02)
    told = "`few` has {:.1f} after 10 k, {:.1f} after 27 k and {:.1f} after 44 k (thirty seeds)"
    curve = np.mean([[(r["sim_steps"], r["return"]) for r in run] for run in few], 0).T
    assert told.format(*np.interp([10e3, 27e3, 44e3], *curve)) in words
    # tuning seeds
    best, other = tuned["crossq-gamma97"], tuned["sac-symmetric"]
    told = (
        "needs {:.1f} k there (two seeds) and {:.1f} on fresh ones (three), so that is not shown "
    )
    p = stats.welch_of(best.level, mirrored.level)
    assert told.format(best.level.mean() / 1e3, its.mean()) + f"(p {p:.2f})" in words
    told = gap_of("ends {} lower on fresh seeds ({} to {})", ends(other.seeds), sac_end, digits=1)
    told += f", {sac_end.mean():.1f} instead of {ends(other.seeds).mean():.1f}."
    assert told in words
    # SAC
    least = [min(r["return"] for r in run if 26e3 <= r["sim_steps"] <= 51.2e3) for run in sac.seeds]
    assert max(least) < 3 and "between 26 and 51 k each of the three seeds has less than 3" in words
    told = "to 30 after {:.0f} to {:.0f} k. That is {:.1f} times the steps of symmetric CrossQ ({:.1f} to "
    found = min(early[2]) / 1e3, max(early[2]) / 1e3, *stats.ratio(early[2], early[0])
    assert told.format(*found[:-1]) + f"{found[-1]:.1f}, three seeds each)" in words
    assert gap_of("At the end that has {} more ({} to {})", end, sac_end, digits=1) in words
    # what symmetric networks change
    jobs, without = paper.jobs(table.JOBS), tuned["sac-b512"]
    assert jobs["sac-symmetric"] == jobs["sac-b512"] + " --symmetric"
    at_100 = [
        [r["return"] for run in one.seeds for r in run if r["sim_steps"] == 100_352]
        for one in (sac, without)
    ]
    told = "has {:.1f} after 100 k, the fresh seeds with them {:.1f}:".format(
        *map(np.mean, at_100[::-1])
    )
    assert told + gap_of(" {} more ({} to {}, p {:.2f}, uncorrected)", *at_100, digits=1) in words
    pair = ends(without.seeds), sac_end
    told = "At the end it is {:.1f} and {:.1f}; its two seeds differ by {:.1f}, so this gap is not shown "
    told += "(p {:.2f})"
    told = told.format(*map(np.mean, pair), np.ptp(pair[0]), stats.welch_of(*pair))
    assert told in words and stats.difference(*pair).high > 0
    high = {
        kind: [max(r["return"] for r in run) for one in some for run in one.seeds]
        for kind, some in (("without", plain.values()), ("with", (sac, other)))
    }
    assert max(high["without"]) < 30 < min(high["with"])
    assert (len(high["without"]), len(high["with"])) == (10, 5)
    assert "without them, ten in five settings, is at 30 at any evaluation; all five with" in words
    # 24_off_policy
    text = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().split())
    told = "[{:.1f} times](../27_few/peers.md#fresh-seeds) the steps of `few` ({:.1f} to {:.1f}, three and "
    assert told.format(*times) + "thirty fresh seeds)" in text
    told = "CrossQ needs {:.1f} times the steps of `few` ({:.1f} to {:.1f}, three and thirty seeds;"
    assert told.format(*times) in text
    told = gap_of("after 100 k steps SAC has {} more with them ({} to {}).", *at_100, digits=1)
    told += (
        f" It ends at {sac_end.mean():.1f} there, after 205 k (three fresh seeds), without them at "
    )
    assert f"{told}{pair[0].mean():.1f} (two tuning seeds)." in text


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
    before = "crossq-w2048,", "sac-symmetric,"  # not yet run
    lines = [x for x in peers.table.RUNS.read_text().splitlines() if not x.startswith(before)]
    (tmp_path / "peers_tune.csv").write_text("\n".join([*lines, ""]))
    monkeypatch.setattr(peers.table, "RUNS", tmp_path / "peers_tune.csv")
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
    """Beside `few`, beside each other by Welch's test, earlier tries of two, and what SAC forgets."""
    table, found, page = settings_of_peers()
    words = " ".join(part_of(page, "## With settings for few", "## With settings for more").split())
    level = {x: one.level for x, one in found.items() if np.isfinite(one.level).all()}
    early = {x: np.array([table.runs.first(r, 30) for r in one.seeds]) for x, one in found.items()}

    def at(name, steps):
        return [r["return"] for run in found[name].seeds for r in run if r["sim_steps"] == steps]

    few = few_runs()[2].mean()
    needs = [one.mean() for one in level.values()]
    told = "in the nine settings on top, with both seeds, after {:.0f} to {:.0f} thousand simulator steps: "
    told += "{:.1f} to {:.1f} times the {:.1f} of `few`, single seeds {:.1f} to {:.0f} times"
    every = np.concatenate([*level.values()])
    told = told.format(
        *(x / 1e3 for x in (min(needs), max(needs))),
        *(x / few for x in (min(needs), max(needs))),
        few / 1e3,
        *(x / few for x in (every.min(), every.max())),
    )
    assert told in words and len(level) == 9 and len(every) == 18
    gone = [max(run[-1]["sim_steps"] for run in found[f"crossq-u{x}"].seeds) for x in (256, 512)]
    assert max(gone) < 91e3 and "two settings were cut off before 91 k" in words
    for x in ("w512", "gain1", "gain05"):
        assert np.isnan(found[f"crossq-{x}"].level).all() and found[f"crossq-{x}"].counts
    soon = [early[f"crossq-{x}"].mean() / 1e3 for x in ("u128", "b1024", "first1k")]
    start = early["crossq"].mean() / 1e3
    told = "fewer random transitions need {:.1f} k, the setting that all start from {:.1f}, and the five"
    assert told.format(soon[0], start) in words and len({*soon}) == 1
    between = [
        early[x].mean() / 1e3 for x in level if x[7:] not in ("", "u128", "b1024", "first1k")
    ]
    assert len(between) == 5 and soon[0] < min(between) <= max(between) < start
    others = [x for x in level if x != "crossq"]
    spans = [[stats.welch_of(one[x], one["crossq"]) for x in others] for one in (early, level)]
    told = "Welch's p {:.2f} to {:.2f}, to 38 {:.2f} to {:.2f}, uncorrected"
    assert told.format(*(end for span in spans for end in (min(span), max(span)))) in words
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
    sac = {name: one for name, one in found.items() if name[:3] == "sac"}
    assert len(sac) == 6
    for rows in (rows for one in sac.values() for rows in one.seeds):
        assert min(r["return"] for r in rows if 26e3 <= r["sim_steps"] <= 51.2e3) < 5
    assert "Between 26 and 51 k each seed has less than 5 in some evaluation" in words
    assert "forgets in five settings, and with 256 updates has nothing after 13 k" in words
    at_13 = {name: np.mean([run[1]["return"] for run in one.seeds]) for name, one in sac.items()}
    assert at_13.pop("sac-u256") < 0 and min(at_13.values()) > 8
    ends = {name: [run[-1]["return"] for run in one.seeds] for name, one in sac.items()}
    means = {name: np.mean(end) for name, end in ends.items()}
    assert f"With them it has {means.pop('sac-symmetric'):.1f}." in words
    del ends["sac-symmetric"]
    told = f"to {min(means.values()):.1f} to {max(means.values()):.1f} (means of two seeds); none of these"
    assert told in words
    least = min(stats.welch_of(*pair) for pair in itertools.combinations(ends.values(), 2))
    assert f"(p {least:.2f} and more)" in words and least > 0.05


def test_the_readme_of_few_says_what_other_methods_need():
    table, tuned, _ = settings_of_peers()
    words = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    crossq, sac = (table.fresh()[name] for name in ("crossq-64-symmetric", "sac-symmetric"))
    end, sac_end = (np.mean([run[-1]["return"] for run in one.seeds]) for one in (crossq, sac))
    plain = [
        np.mean([run[-1]["return"] for run in one.seeds])
        for name, one in tuned.items()
        if name[:3] == "sac" and name != "sac-symmetric"
    ]
    need = crossq.level.mean() / 1e3
    told = f"CrossQ is at 38 after {need:.0f},000 steps (three fresh seeds), "
    told += "{:.1f} times those of `few` ({:.1f} to {:.1f}), ".format(
        *stats.ratio(crossq.level, few_runs()[2])
    )
    assert f"{told}and ends at {end:.1f} after 205,000" in words
    early = np.mean([table.runs.first(run, 30) for run in sac.seeds]) / 1e3
    told = f"is at 30 after {early:.0f},000 and has {sac_end:.1f} after 205,000 (three fresh seeds), without "
    assert f"{told}them {min(plain):.0f} to {max(plain):.0f} (five settings, two tuning" in words
    told = f"CrossQ (at 38 after {need:.0f} k steps, three fresh seeds), SAC (symmetric: {sac_end:.1f} after "
    assert f"{told}205 k; else {min(plain):.0f} to {max(plain):.0f})" in words


def test_the_page_says_how_much_two_tries_of_equal_seeds_differ():
    """Two settings ran again from their start, after a call had cut them off."""
    table, found, page = settings_of_peers()
    words = " ".join(page.split())
    cut = {name: table.runs.seeds(rows) for name, rows in table.read(CUT).items()}

    def mean(runs, steps):
        return np.mean([r["return"] for run in runs for r in run if r["sim_steps"] == steps])

    ends = {name: {run[-1]["sim_steps"] for run in runs} for name, runs in cut.items()}
    assert ends == {"crossq": {121_600}, "crossq-w2048": {102_400}}
    for name, told in (
        ("crossq", "had {:.1f} after 51 k, then {:.1f}; after 122 k {:.1f}, then {:.1f}."),
        ("crossq-w2048", "had {:.1f} after 51 k, then {:.1f}; after 102 k {:.1f}, then {:.1f}."),
    ):
        both = cut[name], found[name].seeds
        values = [mean(runs, steps) for steps in (51_200, *ends[name]) for runs in both]
        assert f"`{name}` {told.format(*values)}" in words
    told = "after 45 k its seed 0 has {:.1f}, then {:.1f}."
    told = told.format(*(mean(runs[:1], 44_800) for runs in both))
    assert told in words and [run[0]["seed"] for run in both[0]] == [0, 1]


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


def test_jobs_of_crossq_on_fresh_seeds_are_those_that_ran_with_symmetric_networks():
    """24_off_policy/fresh.txt: longer, or symmetric in place of mirrored; the seeds are those of the page."""
    jobs = paper.jobs(EXPERIMENTS / "24_off_policy/fresh.txt")
    ran = paper.jobs(EXPERIMENTS / "24_off_policy/jobs.txt")["crossq"]
    longer = ran.replace("--steps 409600 --evaluations 16", "--steps 614400 --evaluations 24")
    few = paper.jobs(EXPERIMENTS / "27_few/peers_tune.txt")["crossq-gamma97"]
    assert jobs == {
        "crossq-256": longer,
        "crossq-256-symmetric": longer.replace("--mirror", "--symmetric"),
        "crossq-64-symmetric": few.replace("--mirror", "--symmetric"),
        "crossq-256-symmetric-c": longer.replace("--mirror", "--symmetric").replace(
            "go1", "anymal_c"
        ),
    }
    assert longer != ran and few.count("--mirror") == 1
    words = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().split())
    assert (
        "fresh.txt crossq-256 crossq-256-symmetric \\ --seeds 103 104 105 106 107 # and crossq-64-symm"
        "etric, 103 104 105" in words
    )


def test_the_rule_for_crossq_on_fresh_seeds_says_what_it_was_written_to_say(
    tmp_path, monkeypatch, capsys
):
    """Synthetic runs by hand: at 38 after 100 and 200 k are 150; a seed that never is counts twice."""
    fresh = script("24_off_policy/fresh")

    def write(name, levels, end=400e3):
        rows = [
            f"{seed},{steps},{20 if steps < level else 40},0.01\n"
            for seed, level in enumerate(levels)
            for steps in (1e3, 100e3, 200e3, end)
        ]
        (tmp_path / name).write_text("seed,sim_steps,return,fall_rate\n" + "".join(rows))

    def said(base):
        monkeypatch.setattr(fresh, "beside", lambda *_: base)
        monkeypatch.setattr(sys, "argv", ["fresh.py", str(tmp_path)])
        fresh.main()
        return capsys.readouterr().out.splitlines()

    base = np.linspace(90e3, 110e3, 10)
    assert all(line.endswith("seeds, so the rule is open") for line in said(base))
    write("crossq-256-symmetric-103-107.csv", [100e3, 100e3, 200e3, 200e3, 1e9])
    write("crossq-256-103-107.csv.part", [100e3] * 5)
    write("crossq-64-symmetric-103-105.csv", [1e3] * 3)
    first, line, beside, few, its, later = said(base)
    assert later == "crossq-256-symmetric-c: 0 of 5 seeds, so the rule is open"
    assert first == "crossq-256: 0 of 8 seeds, so the rule is open"
    told = "crossq-256-symmetric, 5 seeds: first at 38 after 280.0 k steps (last 800.0), 1 never; ends at"
    assert line == told + " 36.0, 1.0 % falls"
    assert beside.endswith("no saving of `best` is shown") and "2.80 times its steps" in beside
    assert few.startswith("crossq-64-symmetric, 3 seeds: first at 38 after 1.0 k")
    assert its.endswith(": CrossQ needs fewer")
    write("crossq-256-symmetric-103-107.csv", [200e3] * 4 + [400e3])
    *_, line, _, _, _ = said(base)
    assert line.endswith("CrossQ needs so many times the steps") and " 2.40 times" in line
    write("crossq-256-103-107.csv", [200e3] * 5)
    assert said(base)[0].startswith("crossq-256, 8 seeds: first at 38 after 2")
    known = fresh.runs_of(tmp_path, "crossq-256")
    assert [run[0]["seed"] for run in known] == [0, 1, 2, 3, 4, 100, 101, 102]
    monkeypatch.undo()
    assert len(fresh.beside("best", "g")) == 10 and len(fresh.beside("few", "g")) == 30
    anymal = fresh.beside("best", "c")
    words = " ".join((EXPERIMENTS / "24_off_policy/README.md").read_text().split())
    assert (
        f"ten of `best` ({anymal.mean() / 1e6:.2f} M to its level of {fresh.level('c'):g})" in words
    )


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


def test_symmetric_crossq_treats_left_and_right_alike():
    """As SAC above, evaluated and in training, where a batch and its image have the same moments; without
    `--symmetric` it does not, and is what flax's module says."""
    crossq, sac = script("24_off_policy/crossq"), script("24_off_policy/sac")
    args = types.SimpleNamespace(config="go1:few", set=["physics.impl=c"], gain=1.5)
    of_obs, of_action = mirrors = sac.robots(args)[0].mirror
    rng = np.random.default_rng(0)
    obs, action = rng.normal(size=(6, 48)), rng.uniform(-1, 1, (6, 12))
    image = obs[:, of_obs.index] * of_obs.sign, action[:, of_action.index] * of_action.sign
    actor, critic = crossq.Network((8,), 24), crossq.Network((8,), 1)
    about = dict(actor=actor, critic=critic)
    method, plain = (types.SimpleNamespace(alike=x, **about) for x in (mirrors, None))
    learner = crossq.start(
        types.SimpleNamespace(
            robots=types.SimpleNamespace(observation_size=48, action_size=12), **about
        ),
        jax.random.key(0),
    )
    for train in (False, True):
        (out, stats), (other, again) = (
            crossq.policy(method, learner.actor, jnp.asarray(x), train) for x in (obs, image[0])
        )
        out, other = np.asarray(out), np.asarray(other)
        mirrored = out[:, :12][:, of_action.index] * of_action.sign
        np.testing.assert_allclose(other[:, :12], mirrored, atol=1e-5)
        np.testing.assert_allclose(other[:, 12:], out[:, 12:][:, of_action.index], atol=1e-5)
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-5), stats, again)
        assert (
            jax.tree.leaves(stats)[0] != jax.tree.leaves(learner.actor["stats"])[0]
        ).any() == train
        (q, _), (q_image, _) = (
            crossq.values(method, learner.critics, *map(jnp.asarray, x), train)
            for x in ((obs, action), image)
        )
        np.testing.assert_allclose(q, q_image, atol=1e-5)
        assert np.ptp(out) > 0.1 and np.ptp(q[0]) > 0.01 and q.shape == (2, 6)
    one, other = (
        crossq.policy(plain, learner.actor, jnp.asarray(x), False)[0] for x in (obs, image[0])
    )
    np.testing.assert_array_equal(one, actor.apply(learner.actor, jnp.asarray(obs), False))
    assert np.abs(other[:, 12:] - one[:, 12:][:, of_action.index]).max() > 0.05


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

    method = types.SimpleNamespace(actor=crossq.Network((8,), 4), alike=None)
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

"""30_row_cost: seconds over the cost of a row, its pages and its picture."""

import importlib
import json
import sys

import numpy as np
import pytest
from result_files import (
    EXPERIMENTS,
    LESS,
    ROW_COST,
    around,
    less,
    of_host,
    row_cost_words,
    script,
)

from experiments import paper, stats


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
        assert len(rows) >= (120 if name == "runs" else 12)
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
        assert len(one.level) == 5
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
    usual, slow = [  # of all seeds' iterations
        (1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row).sum()
        / one.level[:, 0].sum()
        for one in (run["go1.kernel", own, "best"], run["go1.warp", own, "best"])
    ]
    assert f"all but rows took {slow:.1f} ms of each, not {usual:.1f}." in pages["computed"]
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
    gains, longer, cut, needs, rest = [], [], [], [], []  # in the exact tasks
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


def test_where_the_time_of_a_go1_goes_is_as_the_pages_of_seconds_say():
    """By the runs of the newest day with our kernel: rows and all else, to the level and to a walk; where a
    row costs more, and if it costs as its robots do."""
    table, batch = script(f"{ROW_COST}/table"), "H200, 2026-11-30"
    found = table.runs()
    run = {one.method: one for one in found if one[:2] == ("go1.kernel", batch)}
    best, ppo = run["best"], run["ppo2048-walk"]
    chosen, ppos = table.settings(found, "go1.kernel")
    assert chosen is best and table.fastest_beside(best, ppos) is ppo
    rows, walk = (
        [(getattr(one, goal)[:, 1] / one.robots).mean() for one in (best, ppo, run["ppo2048"])]
        for goal in ("level", "walks")
    )
    rest = [
        np.mean((1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row) / one.level[:, 0])
        for one in (best, ppo)
    ]
    first = {
        key: float(value)
        for key, value in next(iter(of_host(table, batch)["go1.kernel.again-best"].values()))[
            0
        ].items()
        if key.endswith("_ms")
    }
    # five times the epochs in the first iterations, three rounds of 16 rows, three updates
    phases = 5 * first["fit_ms"], first["fit_ms"], 48 * first["tail_ms"], 3 * first["ppo_ms"]
    power, dear = table.POWERS["a GPU"], 10.0

    def at(one, power):
        return table.later(one, table.cost(found, one), dear, power).mean()

    mine, its, alike = at(best, power), at(ppo, power), at(ppo, 1.0)
    few = next(x for x in found if x[:3] == ("go1.kernel", "H200, 2026-11-27", "ppo256"))
    ends = [
        2**power * some[k] / some[0] for some, k in ((rows, 1), (walk, 2))
    ]  # where only rows count, of the sooner PPO
    walks = [at(table.to_walk(one), power) for one in (best, run["ppo2048"])]
    pages = {name: row_cost_words(name) for name in ("README", "computed")}
    for text in (
        "a Go1 needs {:.0f} rows of 1024 robots with `best` and {:.0f} of 2048 with PPO"
        " (2026-11-30).".format(*rows),
        f"All else takes {rest[0]:.1f} ms an iteration of {best.level[:, 0].mean():.0f}, and"
        f" {rest[1]:.1f} of {ppo.level[:, 0].mean():.0f}.",
        "it would be {:.1f}: {:.1f} of fitting in the first 50 iterations and {:.1f} later, {:.1f} of tails,"
        " {:.1f} of three updates.".format(phases[0] + phases[2] + phases[3], *phases),
        f"At 10 ms, by the runs of 2026-11-30, a Go1 would take {mine:.1f} (`best`) and {its:.0f} s (PPO with"
        f" 2048 robots): {its / mine:.1f} times as long. In the end it is the ratio of rows, not more:"
        f" {ends[0]:.0f}. If a row costs as its robots do, it would be {alike:.0f} s with 2048 robots, by the"
        f" runs of 2026-11-27 {at(few, 1.0):.0f} with 256.",
        f"by the runs of 2026-11-30 `best` needs {walk[0]:.0f} of 1024 robots, twice as many as to the level,"
        f" PPO {walk[1]:.0f} of 2048, the older one {walk[2]:.0f}.",
        f"about 4 times as fast, not {its / mine:.0f} to {ends[0]:.0f}.",
    ):
        assert text in pages["computed"], text
    assert f"{walk[0] / rows[0]:.0f}" == "2"
    assert f"{walks[1] / walks[0]:.1f} {ends[1]:.1f}" == "3.5 4.5"  # "about 4 times"
    assert f"{rows[1] / rows[0]:.0f} {rest[0] / rest[1]:.0f}" == "6 4"
    for text in (
        "a Go1 needs a sixth of the rows of PPO with 2048 robots, but all else in an iteration takes [four"
        " times as long]",
        f"`best` is {its / mine:.0f} to {ends[0]:.0f} times as fast to the level, about 4 times to a walk",
    ):
        assert text in pages["README"], text


def test_ppo_of_few_steps_in_the_exact_tasks_would_not_be_sooner():
    """From its rows alone, as if those of 128 robots cost what the power law says; those of 512 cost more."""
    table, few = script(f"{ROW_COST}/table"), less("ppo")[0]
    found, power = table.runs(), table.POWERS["a GPU"]
    pages = {name: row_cost_words(name) for name in ("README", "computed")}
    steps, rows, ms, least, mine, its = [], [], [], [], [], []
    for place, batch, name, level in (
        ("go1.exact", "exact", "level-exact-128-kl5-g", 38),
        ("anymal_c.exact", "exact 64", "level-exact-128-kl3-ep10-c", 24),
    ):
        seeds = few.seeds(few.read(LESS / "results/ppo_tasks.csv.xz", batch)[name])
        reached = few.reached(seeds, level).level
        assert len(reached) == 10 and " rollout.num_envs=128 " in f"{seeds[0][0]['job']} "
        best, ppos = table.settings(found, place)
        steps.append(reached.mean() / 1e6)
        rows.append(reached.mean() / 128)
        ms.append(table.cost(found, best) * (128 / 1024) ** power)
        least.append(rows[-1] * ms[-1] / 1e3)
        mine.append(best.level[:, 2].mean())
        its.append(table.fastest_beside(best, ppos).level[:, 2].mean())
        half = next(x for x in found if x[:3] == (place, best.batch, "ppo512"))
        law = table.cost(found, best) * 0.5**power
        assert half.row > law
        if place == "go1.exact":
            text = f"costs more than computed (on a Go1 {half.row:.2f} ms, not {law:.2f})."
            assert f"a row of 512 robots {text}" in pages["computed"]
        assert least[-1] > its[-1] > mine[-1]  # "more than all of PPO with 2048 robots"
    text = "It needs {:.2f} M steps on a Go1 and {:.2f} M on an ANYmal-C: {:.0f} and {:.0f} rows of 128"
    text += " robots. At {:.2f} and {:.2f} ms, on the hosts of `best`, these alone would take {:.1f} and"
    text += " {:.1f} s."
    assert text.format(*steps, *rows, *ms, *least) in pages["computed"]
    text = "`best` takes {:.2f} and {:.2f} s, and PPO with 2048 robots {:.2f} and {:.2f}."
    assert text.format(*mine, *its) in pages["computed"]
    text = "[its rows alone](computed.md#from-rows-alone) would take about {:.0f} and {:.0f} s, more than all"
    assert f"{text.format(*least)} of PPO with 2048 robots." in pages["README"]


def test_where_no_go1_ran_and_what_was_not_tuned_is_as_the_pages_of_seconds_say():
    """Where PPO's most or fewest robots are the fastest, and where 4096 ran on another host than 2048; what
    4096 would take, from the runs with our kernel; where `best` has no settings for seconds."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    pages = {
        name: " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())
        for name in ("README", "computed", "settings", "next")
    }
    best, ppos = table.settings(found, "go1.kernel")
    own = table.cost(found, best)
    level = table.break_even(best, ppos, own, table.POWERS["a GPU"])
    walk = table.even(table.to_walk(best), [table.to_walk(x) for x in ppos], own)
    for text in (
        "more than {:.2f} ms ({:.2f} to {:.2f})".format(*level),
        f"sooner from {walk.replace(' (', ' ms on (')}, though measured at 0.98 PPO walks sooner in the mean",
    ):
        assert text in pages["README"], text
    more = "go1.warp", "go1.exact", "anymal_c.exact", "go1.jax"
    for place, most in (
        *((place, 2048) for place in more),
        ("go1.laptop", 512),
    ):
        mine, its = table.settings(found, place)
        ran = [x.robots for x in found if x.place == place and x.method.startswith("ppo")]
        if place in more:  # which have run once with 4096, on a host without `best`
            assert ran.count(4096) == 1 and 4096 not in [x.robots for x in its]
            ran.remove(4096)
        assert max(ran) == most == table.fastest_beside(mine, its).robots
        # with MJX-JAX 1024 robots, on another host, take as long
        assert table.fastest(its).robots == (1024 if place == "go1.jax" else most)
        if place not in ("go1.laptop", "go1.warp"):
            assert not any(
                x.place == place and x.method.startswith(("best-", "tune-")) for x in found
            )
    assert not any(x.place == "g1.warp" and x.method.startswith("best-") for x in found)
    text = "at an edge** on two cores (512), where these are the most that ran, and on rough ground (2048),"
    text += " where these are the fewest; 4096 take as long there."
    assert text in pages["README"]
    mine, its = table.settings(found, "go2.rough")
    some = {x.robots for x in its}
    ran = [x for x in found if x.place == "go2.rough" and x.method.startswith("ppo")]
    assert {x.robots for x in ran} == {2048, 4096} and [x.method for x in its] == ["ppo2048"]
    assert some == {2048} and table.fastest_beside(mine, its) is its[0]
    both = [x.level[:, 2] for x in ran if x.method.endswith("-often")]
    gap = stats.difference(*both)
    assert len(both) == 2 and gap.low < 0 < gap.high
    text = "PPO's rows, epochs, lambda and KL on a Go1 and on rough ground, and `best` with MJX-JAX and in"
    assert f"{text} the exact tasks." in pages["README"]
    assert "With MJX-JAX and in the exact tasks no setting was tried" in pages["settings"]
    mine = [x.method for x in found if x.place == "go1.warp" and x.method.startswith("best-")]
    assert sorted(mine) == ["best-n2048", "best-n2048", "best-r2n2048"]
    # PPO with 4096 robots
    run, day = {one[:3]: one for one in found}, "H200, 2026-11-27"
    power = table.POWERS["a GPU"]
    jax = table.cost(found, table.settings(found, "go1.jax")[0])
    warp, own = (table.cost(found, run[x, day, "best"]) for x in ("go1.warp", "go1.kernel"))

    def both(host, ms, way=lambda one: one):
        """Seconds with 4096 and with 2048 robots, of which no difference is shown."""
        some = [way(run["go1.kernel", day + host, f"ppo{n}"]) for n in (4096, 2048)]
        took = [table.later(one, table.cost(found, one), ms, power) for one in some]
        gap = stats.difference(*took)
        assert gap.low < 0 < gap.high
        return [one.mean() for one in took]

    second = ", second host"
    first, other = both("", warp), both(second, warp)
    walks = *both("", warp, table.to_walk), *both(second, warp, table.to_walk)
    several = [run["go1.kernel", day, f"ppo{n}"] for n in (4096, 2048)]
    rows = [(one.level[:, 1] / one.robots).mean() for one in several]
    dear = [(one.robots / 1024) ** power for one in several]
    for text in (
        f"would take {first[0]:.1f} s to the level by the runs of 2026-11-27: {rows[0]:.0f} rows of"
        f" {dear[0]:.2f} times the cost of 1024 robots are {rows[0] * dear[0]:.0f} of these, {rows[1]:.0f} of"
        f" {dear[1]:.2f} with 2048 robots {rows[1] * dear[1]:.0f}.",
        "On the second host it is {:.1f} and {:.1f} s.".format(*other),
        "To a walk it would take {:.1f} s, with 2048 robots {:.1f}, on the second host {:.1f} and {:.1f}."
        " With MJX-JAX it is {:.1f} and {:.1f} s".format(*walks, *both("", jax)),
    ):
        assert text in pages["computed"], text
    assert "ppo4096" not in [x.method for x in ppos]  # "do not count it"
    gaps = []
    for place in ("go1.warp", "go1.jax"):
        one = run[place, "H200, 2026-11-29, fourth host", "ppo4096"]
        at = table.later(several[0], own, table.cost(found, one), power)
        gaps.append(stats.difference(one.level[:, 2], at))
    text = f"takes {around(gaps[0], 2, ' s more than computed there with MuJoCo Warp')},"
    text += f" {around(gaps[1], 2, ' with MJX-JAX')}."
    assert text in pages["computed"] and all(gap.low < 0 < gap.high for gap in gaps)


def test_what_the_pages_say_of_ppo_with_4096_robots_is_so():
    """Beside 2048 robots of other hosts, without a test; which seeds ran in which process."""
    table, host = script(f"{ROW_COST}/table"), "H200, 2026-11-29, fourth host"
    found, jobs = table.runs(), of_host(table, host)
    run = {one[:3]: one for one in found}
    page, shares, level, walk = (EXPERIMENTS / ROW_COST / "runs.md").read_text(), [], [], []
    newest, beside = [], []
    for label, place, day in (
        ("Go1, MuJoCo Warp", "go1.warp", "H200, 2026-11-27"),
        ("Go1, exact task", "go1.exact", "H200, 2026-11-28"),
        ("ANYmal-C, exact task", "anymal_c.exact", "H200, 2026-11-28"),
        ("Go1, MJX-JAX", "go1.jax", "H200, 2026-11-28, eighth host"),
    ):
        some = [run[place, day, "ppo2048"], run[place, host, "ppo4096"]]
        newest.append(table.fastest_beside(*table.settings(found, place)))
        beside.append(some)
        assert all(len(one.level) == 5 and table.there(one) == 1 for one in some)
        shares.append([some[1].level[:, k].mean() / some[0].level[:, k].mean() for k in (2, 1)])
        cells = [table.interval(one.level[:, 2]) for one in some]
        cells += [f"{share:.2f}" for share in shares[-1]]
        assert f"| {label} | " + " | ".join(cells) + " |" in page
        level.append([one.level[:, 2].mean() for one in some])
        walk.append([one.walks[:, 2].mean() for one in some])
        assert np.isnan(walk[-1]).all() == place.endswith("exact")
        seeds = jobs[f"{place}.ppo4096"]
        assert [*seeds] == [str(seed) for seed in range(1100, 1105)]
        rows = [row for each in seeds.values() for row in each]
        assert {row["commit"][:8] for row in rows} == {"05f6d8fb"}
    runs, readme = row_cost_words("runs"), row_cost_words("README")
    seconds, steps = np.transpose(shares)
    words = f"they take {min(seconds):.2f} to {max(seconds):.2f} times the seconds of 2048 on the same seeds,"
    words += f" on another host and day, for {min(steps):.1f} to {max(steps):.1f} times the steps."
    assert words in readme and (seconds < 1).tolist() == [False, False, True, False]
    # of a Go1 with MuJoCo Warp the row of README.md has newer ones, on other seeds
    (now, *others), (many, *_) = newest, beside[0][::-1]
    assert all(one is some[0] for one, some in zip(others, beside[1:], strict=True))
    assert now[:3] == ("go1.warp", "H200, 2026-11-30", "ppo2048") and now is not beside[0][0]
    more = stats.difference(many.level[:, 2], now.level[:, 2])
    times = stats.ratio(many.level[:, 2], now.level[:, 2]).value
    words = f"it is {times:.2f} times {around(more, 2, ' s more').replace(' (', ', ')}"
    words = words.replace("times ", "times (", 1) + "."
    assert f"Beside the newer {now.level[:, 2].mean():.2f} s of `go1.warp` {words}" in readme
    text = f"Beside the {now.level[:, 2].mean():.2f} s of 2026-11-30 with MuJoCo Warp, other seeds, {words}"
    assert text in runs and more.low > 0
    best = run["anymal_c.exact", "H200, 2026-11-28", "best"].level[:, 2].mean()
    processes = {}
    for seed, rows in jobs["go1.warp.ppo4096"].items():
        ms = 1e3 * float(rows[-1]["seconds"]) / int(rows[-1]["iteration"])
        processes.setdefault(rows[0]["row_ms"], {})[seed] = ms
    (alone,), after = (list(some.values()) for some in processes.values())
    assert [*processes.values()][0].keys() == {"1100"} and len(after) == 4
    assert {f"{ms:.0f}" for ms in (alone, *after[2:])} == {"79"}
    parts = {}
    for seed, rows in jobs["go1.jax.ppo4096"].items():
        parts.setdefault(rows[0]["row_ms"], []).append(seed)
    assert [len(seeds) for seeds in parts.values()] == [4, 1]
    slower = 100 * (np.mean(after[:2]) / np.mean(after[2:]) - 1)
    for words in (
        f"the mean is {level[2][0] - level[2][1]:.2f} s less, with spreads",
        f"Beside these {level[2][1]:.2f} s `best`, of another host, would be {level[2][1] / best:.1f} times"
        f" as fast, not {level[2][0] / best:.1f}.",
        f"it is {walk[0][1]:.2f} instead of {walk[0][0]:.2f} s with MuJoCo Warp, and {walk[3][1]:.2f}"
        f" instead of {walk[3][0]:.2f} with MJX-JAX.",
        f"are [slow](#go1), by {slower:.0f} %. 1100, alone in its process, was not: {alone:.0f}"
        " ms an iteration",
    ):
        assert words in runs, words


def test_the_lead_of_the_page_of_seconds_is_so():
    """At which costs which of the two is sooner on a Go1, and by how much; what no interval shows."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    page = " ".join((EXPERIMENTS / ROW_COST / "README.md").read_text().split())
    times, costs = {}, {}
    exact = "go1.exact", "anymal_c.exact"
    for place in ("go1.kernel", "go1.fine64", *exact, "go1.warp", "g1.warp", "go1.jax"):
        best, ppos = table.settings(found, place)
        clocks = [x.level[:, 2] for x in (table.fastest_beside(best, ppos), best)]
        times[place], costs[place] = stats.ratio(*clocks), table.cost(found, best)
    cheap = times.pop("go1.kernel")
    assert cheap.high < 1 and all(one.low > 1 for one in times.values())
    text = "at {:.1f} ms PPO is sooner, from {:.1f} to {:.1f} ms `best` is, {:.1f} to {:.1f} times."
    low = costs.pop("go1.kernel")
    values = [one.value for one in times.values()]
    text = text.format(low, min(costs.values()), max(costs.values()), min(values), max(values))
    fine = [table.settings(found, f"go1.fine{steps}") for steps in (16, 32, 64)]
    clocks = [(ppo.level[:, 2], best.level[:, 2]) for best, (ppo,) in fine]
    assert clocks[0][0].mean() < clocks[0][1].mean() and clocks[1][0].mean() > clocks[1][1].mean()
    p = stats.holm([stats.welch_of(*pair) for pair in clocks])
    around_it = (
        "PPO is sooner in the mean at {:.2f} ms, and `best` at {:.2f}; with five seeds neither"
        " difference is shown (p by Holm {:.2f} and {:.3f}). At {:.2f} ms `best` is sooner ({:.3f}). At"
    )
    at = [table.cost(found, best) for best, _ in fine]
    text = around_it.format(*at[:2], *p[:2], at[2], p[2]) + text[2:]
    assert min(p[:2]) > 0.05 > p[2] and {len(x) for pair in clocks for x in pair} == {5}
    cores = {x[2]: x.level[:, 2] for x in found if x[:2] == ("go1.laptop", "two cores, 2026-11-29")}
    longer = stats.ratio(cores["ppo512"], cores["best"])
    told = "On two CPU cores `best` is sooner than PPO with as many robots,"
    told += f" {longer.value:.2f} times, on ten seeds."
    assert f"Measured, to the level: {text} {told}" in page and longer.low > 1
    older = {x[2]: x for x in found if x[:2] == ("go1.laptop", "two cores, 2026-11-28")}
    for method in ("ppo512", "ppo256"):  # "no difference in seconds is shown to the level, either"
        gap = stats.difference(*(older[x].level[:, 2] for x in (method, "best")))
        assert gap.low < 0 < gap.high
    best, ppos = table.settings(found, "go1.kernel")
    even = table.break_even(best, ppos, table.cost(found, best), table.POWERS["a GPU"])[0]
    best, ppos = table.settings(found, "go1.warp")
    dear = [
        table.even(way(best), [way(x) for x in ppos], table.cost(found, best))
        for way in (lambda x: x, table.to_walk)
    ]
    text = f"2026-11-30 with MuJoCo Warp's step it is {dear[0]}, to a walk {dear[1]}."
    assert text in page and best.batch == "H200, 2026-11-30"
    most = float(dear[0].split()[0])
    text = f"**On a GPU a Go1 breaks even at about {even:.1f} to {most:.1f} ms a row (computed). Measured"
    assert text in page and "On a GPU a Go1 follows commands sooner" in page


def test_what_was_computed_beside_what_ppo_took_is_as_the_pages_say():
    """Every setting of PPO that ran with our kernel and where a row costs more."""
    table, newer, day = script(f"{ROW_COST}/table"), "H200, 2026-11-28", "H200, 2026-11-27"
    found = table.runs()
    pages = {
        name: " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())
        for name in ("README", "computed")
    }
    gaps = {}
    for own in found:
        if (own.place, own.batch) not in (("go1.kernel", day), ("g1.kernel", newer)):
            continue
        for other in found:
            robot = own.place.partition(".")[0]
            engines = "warp", "jax", "fine16", "fine32", "fine64"
            dear = other.place in [f"{robot}.{x}" for x in engines] and len(other.level) >= 5
            if dear and own.method == other.method and own.method.startswith("ppo"):
                ms = table.cost(found, other)
                took = table.later(own, table.cost(found, own), ms, table.power_of(other.place))
                gap = stats.difference(took, other.level[:, 2])
                gaps[other.place, other.method, other.batch] = gap, took, other
    third = ("g1.warp", "ppo1024x12", f"{newer}, third host")
    few = gaps.pop(("go1.jax", "ppo1024", f"{newer}, seventh host"))[0]
    again = gaps.pop(("go1.warp", "ppo2048", "H200, 2026-11-30"))[0]
    assert gaps.pop(third)[0].low < 0  # the same setting once more
    assert {key[:2] for key in gaps} == {
        ("go1.warp", "ppo1024"),
        ("go1.warp", "ppo2048"),
        ("go1.jax", "ppo2048"),
        ("g1.warp", "ppo1024x12"),
        ("go1.fine16", "ppo2048"),
        ("go1.fine32", "ppo2048"),
        ("go1.fine64", "ppo2048"),
        ("go1.warp", "ppo4096"),
        ("go1.jax", "ppo4096"),
    }
    assert len(gaps) == 9 and all(gap.low < 0 < gap.high for gap, _, _ in gaps.values())
    mine = [x for x in found if x[1:3] == (day, "best") and x.place in ("go1.kernel", "go1.warp")]
    ours, dear = sorted(mine, key=lambda one: one.place)
    at = table.later(
        ours, table.cost(found, ours), table.cost(found, dear), table.power_of(dear.place)
    )
    slower = stats.difference(dear.level[:, 2], at)
    text = (
        "to the level, from runs of 2026-11-27 and -28 with our kernel, of PPO no difference is shown in nine"
        f" of eleven cases. In two it took less than computed: {around(few, words=' s')[:-1]}; 1024 robots,"
        f" MJX-JAX) and {around(again, 2, ' s')[:-1]}; MuJoCo Warp, 2026-11-30). `best` took"
        f" {around(slower, 2, ' s longer with MuJoCo Warp on 2026-11-27')}"
    )
    assert text in pages["README"] and few.low > 0 and again.low > 0 and slower.low > 0
    # of 2026-11-30, from that day's runs with our kernel
    run = {one[:3]: one for one in found}
    words, day_30 = [], "H200, 2026-11-30"
    for method, more in (("best", " s longer"), ("ppo2048", " less")):
        own, other = (run[f"go1.{x}", day_30, method] for x in ("kernel", "warp"))
        ms = table.cost(found, run["go1.warp", day_30, "best"])
        took = table.later(own, table.cost(found, own), ms, table.power_of("go1.warp"))
        gap = stats.difference(*sorted((other.level[:, 2], took), key=np.mean, reverse=True))
        words += [table.interval(other.level[:, 2]), table.interval(took), around(gap, 2, more)]
        assert gap.low < 0 < gap.high  # "on 2026-11-30, no difference is shown"
    text = "on 2026-11-30, `best` took {} s, computed from that day's runs with our kernel {}: {}. PPO took"
    text += f" {{}}, computed {{}}: {{}}, from the runs of 2026-11-27 {around(again, 2, ' less')}."
    assert text.format(*words) in pages["computed"]
    gap, took, other = gaps["go1.warp", "ppo1024", day]
    text = (
        f"would take {took.mean():.1f} s to the level, measured {table.interval(other.level[:, 2])}:"
        f" {gap.value:.1f} s less ({gap.low:.1f} to {gap.high:.1f})."
    )
    assert f"nor with 1024 robots, which by the runs of 2026-11-27 {text}" in pages["computed"]


def test_marks_of_rows_that_cost_nearly_the_same_stand_apart():
    plot = script(f"{ROW_COST}/plot")
    where = plot.apart([0.2, 2.2, 2.33, 2.44, 40.0])
    assert where[[0, 4]] == pytest.approx([0.2, 40.0])
    assert where[2:4] / where[1:3] == pytest.approx(plot.APART)
    assert np.prod(where[1:4]) == pytest.approx(2.2 * 2.33 * 2.44)  # about where they were


def test_seconds_and_steps_are_drawn_over_the_cost_of_a_row(drawn, monkeypatch):
    """To the level and to a walk; of whom not all seeds walk, an open mark says how many do."""
    plot, pages = script(f"{ROW_COST}/plot"), []
    save = plot.pictures.save
    monkeypatch.setattr(
        plot.pictures, "save", lambda page, path: (pages.append(page), save(page, path))
    )
    plot.main()
    assert drawn == ["row_cost"]
    axes = pages[0].axes
    assert [axis.get_title(loc="left") for axis in axes] == [
        f"{what} to {goal}"
        for goal in ("the level", "a walk")
        for what in ("seconds of training", "million simulator steps")
    ]
    words = [[text.get_text() for text in axis.texts] for axis in axes]
    numbers = [*map(str, range(1, 13))]
    for k, few in enumerate(words):
        assert [x for x in few if x.isdigit()] == [
            x for x in numbers if k < 2 or x != "2"
        ]  # "without 2"
    some = [sorted(x for x in few if " of " in x) for few in words]
    assert some[:2] == [[], []]
    # ANYmal-C with PPO, then with `best` the exact Go1, with JAX, and on two cores
    assert some[2] == some[3] == ["1 of 5", "2 of 5", "4 of 5", "9 of 10"]
    even = [text for few in words for text in few if text.startswith("Go1 breaks even")]
    assert even == [
        "Go1 breaks even, computed:\n0.43 ms (0.25 to 0.62)",
        "Go1 breaks even, computed:\n0.74 ms (0.25 to 1.4)",
    ]
    marks = [[line.get_marker() for line in axis.lines] for axis in axes]
    # `best` for seconds; to a walk where all its seeds do
    assert [few.count("^") for few in marks] == [4, 4, 2, 2]
    heights = [
        [line.get_ydata()[0] for line in axis.lines if line.get_marker() == "^"]
        for axis in axes[2:]
    ]
    table = script(f"{ROW_COST}/table")
    every = {one[:3]: one for one in table.runs()}
    at = ("go1.kernel", "best-r2n4096"), ("go1.warp", "best-n2048")
    some = [every[place, "H200, 2026-11-30", method] for place, method in at]
    for found, column, unit in zip(heights, (2, 1), (1, 1e6), strict=True):
        expected = [one.walks[:, column].mean() / unit for one in some]
        np.testing.assert_allclose(found, expected)
    found = table.runs()
    for place, number in (("go1.kernel", 1), ("go2.rough", 2), ("g1.kernel", 4), ("go1.warp", 7)):
        best, _ = table.settings(found, place)
        quick = table.fastest(table.variants(found, best))
        assert (quick.batch == best.batch) == (number in (1, 7))
        assert np.isfinite(quick.walks).all() == (number in (1, 7))
    words = "Triangles: of 2 and 4 on other hosts; below where all seeds walk, so not of 4; that of 2 was"
    words += " evaluated oftener than its PPO."
    assert words in row_cost_words("README")
    assert [few.count(plot.NONE["marker"]) for few in marks] == [0, 0, 1, 1]  # no PPO walks
    # the caption's numbers, and which marks stand aside
    pairs = [table.settings(found, place) for place in dict.fromkeys(x.place for x in found)]
    pairs = [both for both in pairs if both]
    places = [best.place for best, _ in pairs]
    assert [places[k - 1] for k in (2, 4, 8, 10)] == [
        "go2.rough",
        *("g1.kernel go1.exact g1.warp".split()),
    ]
    costs = np.array([table.cost(found, best) for best, _ in pairs])
    moved = np.abs(plot.apart([*costs]) / costs - 1)
    aside = [number for number, share in enumerate(moved, 1) if share > 0.03]
    assert aside == [4, 5, 7, 9] and f"{max(moved):.1f}" == "0.2"
    below = [
        best.place
        for best, _ in pairs
        if np.isfinite(best.walks).all()
        and (one := stats.moments(best.walks[:, 1])).mean < stats.half_of(one)
    ]
    assert below == ["go1.fine64"]
    words = (
        "of 8 with one seed counted up to its end.",
        "most do; without 2, and of 10 the second run alone.",
        "Where a bar goes below 0, its number stands above.",
        "Marks 4, 5, 7 and 9 stand up to",
    )
    assert all(x in row_cost_words("README") for x in words)


def test_to_a_walk_ppo_is_drawn_with_the_setting_of_which_most_seeds_walk():
    table = script(f"{ROW_COST}/table")

    def run(method, *seconds):
        walks = np.array([[np.nan if x is None else x] * 3 for x in seconds], float)
        return table.Run("go1.warp", "G, day", method, 1024, walks, walks, 1.0)

    every, some = run("ppo512", 9, 9, 9, 9, 9), run("ppo256", 1, 1, 1, 1, None)
    slow, never = run("ppo1024", 10, 10, 10, 10, 10), run("ppo2048", *[None] * 5)
    assert table.walking(slow, [every, some, slow], 2) is slow  # all of its own
    assert table.walking(some, [slow, some, every], 2) is every
    assert table.walking(never, [never, some], 2) is some
    one = run("ppo64", 1)  # a single seed says little
    assert table.walking(some, [one, some], 2) is some
    also = run("ppo128", *[None] * 5)
    assert table.walking(never, [also, never], 2) is never


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

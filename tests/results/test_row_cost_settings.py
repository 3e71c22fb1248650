"""30_row_cost: `best` with settings for seconds, slow first seeds, and what runs next by which rules."""

import itertools
import re

import numpy as np
import pytest
from result_files import (
    EXPERIMENTS,
    ROW_COST,
    around,
    headline,
    of_host,
    ours_of,
    row_cost_words,
    script,
)
from scipy import special
from scipy import stats as scipy_stats

from dynappo.config import fields as config_fields
from experiments import paper, stats


def test_the_grid_of_rounds_and_robots_of_a_go1_is_as_the_page_of_settings_says():
    """`best` with our kernel on tuning seeds, on three hosts; two rounds with 4096 robots beside 2048, and
    beside PPO of two other hosts."""
    table = script(f"{ROW_COST}/table")
    run = {one[1:3]: one for one in table.runs() if one.place == "go1.kernel"}
    text, page = row_cost_words("settings"), (EXPERIMENTS / ROW_COST / "settings.md").read_text()
    first, last = "H200, 2026-11-27", "H200, 2026-11-29, second host"
    batches = {"A": first, "B": f"{first}, second host", "C": last}
    hosts = (
        "Host A is the first of 2026-11-27, B the second of that day, C the second of 2026-11-29."
    )
    assert hosts in text
    where = {"A": ("r1", "r2", "r1n2048", "r2n2048"), "B": ("n512", "n2048")}
    where["C"] = ("r1n512", "r2n512", "r1n4096", "r2n4096")
    lines, level = [], {}
    for host, names in where.items():
        for name in names:
            one = run[batches[host], f"tune-{name}"]
            rounds = {"r1": "one", "r2": "two"}.get(name[:2], "three")
            assert len(one.level) == 3 and (f"n{one.robots}" in name or one.robots == 1024)
            cells = [table.interval(x) for x in (one.level[:, 2], one.walks[:, 2])]
            if name == "r1n512":
                assert [np.isfinite(x[:, 2]).sum() for x in (one.level, one.walks)] == [2, 2]
                cells = [f"{cells[0]} (one of three never)", f"{cells[1]} (two of three)"]
            else:
                assert np.isfinite(one.level).all() and np.isfinite(one.walks).all()
            steps = table.interval(one.level[:, 1] / 1e6)
            lines.append(
                f"| {rounds} | {one.robots} | {host} | {cells[0]} | {cells[1]} | {steps} |"
            )
            level[name] = np.nanmean(one.level[:, 2])
    order = {"one": 1, "two": 2, "three": 3}
    lines.sort(key=lambda x: (order[x.split()[1]], int(x.split()[3])))
    assert "\n".join(lines) in page
    tuned = [one for key, one in run.items() if key[1].startswith("tune-")]
    assert (
        len(tuned) == len(lines) == 10
    )  # "three rounds with 1024 robots ... with 4096 they have not run"
    few = [level[name] for name in level if name.endswith("n512")]
    more = [level[name] for name in level if not name.endswith("n512")]
    many, half = run[last, "tune-r2n4096"], run[first, "tune-r2n2048"]
    small = run[last, "tune-r2n512"]
    slow, fast = (
        stats.difference(many.level[:, 2], run[batches[x], "ppo2048"].level[:, 2]) for x in "BA"
    )
    its = stats.difference(many.walks[:, 2], half.walks[:, 2])
    longer = stats.difference(small.level[:, 2], many.level[:, 2])
    level_gap = stats.difference(many.level[:, 2], half.level[:, 2])
    ppo = [run[batches[x], "ppo2048"].level[:, 2].mean() for x in "BA"]
    every = 10 * (many.level[:, 2] / many.level[:, 0]).mean()
    assert {*many.level[:, 0]} == {40} and its.low < 0 < its.high and level_gap.low < 0
    for words in (
        f"the means are {min(more):.2f} to {max(more):.2f} s to the level, with 512 {min(few):.2f} to"
        f" {max(few):.2f}.",
        f"With two rounds 512 take {longer.value:.2f} s longer than 4096 ({longer.low:.2f} to"
        f" {longer.high:.2f}, host C).",
        f"**Two rounds with 4096 robots** take {level['r2n4096']:.2f} s, with 2048 {level['r2n2048']:.2f} on"
        f" host A. No difference is shown ({level_gap.value:.2f} s more, {level_gap.low:.2f} to"
        f" {level_gap.high:.2f})",
        "for {}".format(
            around(stats.ratio(many.level[:, 1], half.level[:, 1]), 1, " times the steps")
        ),
        f"they take {many.walks[:, 2].mean():.2f} s, not {half.walks[:, 2].mean():.2f}, which shows none"
        f" either ({-its.value:.2f} less, {-its.high:.2f} to {-its.low:.2f})",
        f"at iteration 40, and an evaluation came every {every:.2f} s, which the ±"
        f" {stats.half_of(stats.moments(many.level[:, 2])):.2f} does not count",
        f"takes {ppo[0]:.2f} s to the level on host B and {ppo[1]:.2f} on host A (five fresh seeds):"
        f" {slow.value:.2f} s less than these {level['r2n4096']:.2f} ({slow.low:.2f} to {slow.high:.2f}), and"
        f" {fast.value:.2f} ({fast.low:.2f} to {fast.high:.2f}). To a walk it takes",
        "which is not shown. It did not run on host C.",
    ):
        assert words in text, words
    walks = [
        stats.difference(many.walks[:, 2], run[batches[x], "ppo2048"].walks[:, 2]) for x in "BA"
    ]
    its = [run[batches[x], "ppo2048"].walks[:, 2].mean() for x in "BA"]
    assert walks[0].low > 0 > walks[1].low
    own = many.walks[:, 2].mean()
    for words in (
        f"To a walk it takes {its[0]:.2f} and {its[1]:.2f} s: {walks[0].value:.2f} s less than these"
        f" {own:.2f} ({walks[0].low:.2f} to {walks[0].high:.2f}), and {walks[1].value:.2f}"
        f" ({walks[1].low:.2f} to {walks[1].high:.2f}), which is not shown.",
    ):
        assert words in text, words
    # beside PPO of both hosts, to the level and to a walk
    gaps = {
        one.method: [
            stats.difference(one.level[:, 2], run[batches[x], "ppo2048"].level[:, 2]) for x in "AB"
        ]
        for one in tuned
    }
    never = {one.method for one in tuned if np.isnan(one.level).any()}
    assert never == {"tune-r1n512"}
    shown = {name for name, pair in gaps.items() if all(gap.low > 0 for gap in pair)} - never
    assert shown == {
        one.method for one in tuned if one.robots > 512 or one.method.startswith("tune-r2")
    }
    assert len(shown) == 8 and all(gap.value > 0 for pair in gaps.values() for gap in pair)
    assert gaps["tune-n512"][1].low < 0
    words = "({:.2f} s, {:.2f} to {:.2f}, host A)".format(*gaps["tune-n512"][0])
    assert f"With 512 robots and three rounds it is not {words}; with one, a seed never" in text
    others = [x for x in run.values() if x.method.startswith(("best", "tune-"))]
    others = [x for x in others if x.batch in batches.values()]
    assert len(others) == 14
    assert all(np.nanmean(x.walks[:, 2]) > max(its) for x in others)
    assert all(np.nanmean(x.level[:, 2]) > max(ppo) for x in others)
    quick, beside = (run[batches["B"], x] for x in ("best-r2n2048", "ppo2048"))
    gap = stats.difference(quick.walks[:, 2], beside.walks[:, 2])
    words = f"walks {gap.value:.2f} s before two rounds ({gap.low:.2f} to {gap.high:.2f})."
    assert f"PPO with 2048 robots is sooner than both, and {words}" in text
    words = "No setting that ran, with one to three rounds and 512 to 4096 robots (but three rounds with"
    words += " 4096),"
    assert f"{words} makes a tail pay there." in row_cost_words("README")
    assert not any(key[0] == last and key[1].startswith("ppo") for key in run)
    assert not any(key[1].endswith(("best-n4096", "tune-n4096")) for key in run)
    assert (min(more), min(x.walks[:, 2].mean() for x in tuned if x.robots > 512)) == (
        level["r2n2048"],
        many.walks[:, 2].mean(),
    )
    (never,) = [
        row
        for row in table.read()
        if (row["batch"], row["name"], row["seed"], row["iteration"])
        == (last, "go1.kernel.tune-r1n512", "2", "300")
    ]
    last_return, falls = float(never["return"]), 100 * float(never["fall_rate"])
    words = f"by iteration 300: {last_return:.1f}, with falls in {falls:.1f} %."
    assert words in row_cost_words("runs")
    rows = {
        n: sorted({x.row for x in tuned if x.batch == last and x.robots == n}) for n in (512, 4096)
    }
    found = table.runs()
    for place, words in (
        ("go1.kernel", "- **Break-even** would be at {} (two rounds and 4096 robots)."),
        ("g1.kernel", "- **Break-even** on a G1 would be at {}, which is what its row costs."),
    ):
        best, ppos = table.settings(found, place)
        even = table.for_seconds(found, table.fastest(table.variants(found, best)), ppos)
        at, _, spread = even.removeprefix("; for seconds ").partition(" ")
        assert words.format(f"{float(at):.2f} ms {spread}") in text
    words = "took {:.2f} ms with 512 robots and {:.2f} to {:.2f} with 4096."
    assert words.format(rows[512][0], *rows[4096]) in row_cost_words("runs")
    assert f"the {table.cost(table.runs(), many):.3f} ms of the table" in row_cost_words("runs")


def test_settings_for_seconds_with_mujoco_warp_are_as_the_pages_say():
    """2026-11-29: two settings with 2048 robots beside `best` on one host. The faster ran again on new"
    " seeds."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    run = {one[1:3]: one for one in found if one.place == "go1.warp"}
    first, host, new = "H200, 2026-11-27", "H200, 2026-11-29, second host", "H200, 2026-11-30"
    best, three, two, cut = (
        run[host, x] for x in ("best", "best-n2048", "best-r2n2048", "ppo2048")
    )
    before = run[first, "best"]
    fresh = [run[new, x] for x in ("best-n2048", "best", "ppo2048", "ppo2048-walk")]
    assert [len(x.level) for x in (best, three, two, cut, before)] == [5, 5, 5, 2, 5]
    settings, page = (
        row_cost_words("settings"),
        (EXPERIMENTS / ROW_COST / "settings.md").read_text(),
    )
    lines = []
    for label, one in (
        ("2026-11-30: three rounds, 2048 robots", fresh[0]),
        ("`best`: three rounds, 1024 robots", fresh[1]),
        ("PPO, 2048 robots", fresh[2]),
        ("PPO, 2048 robots, tuned since", fresh[3]),
        ("2026-11-29: three rounds, 2048 robots", three),
        ("two rounds, 2048 robots", two),
        ("`best`", best),
        ("PPO, 2048 robots", cut),
    ):
        assert np.isfinite(one.walks).all()
        cells = [
            part
            for some in (one.level, one.walks)
            for part in (table.interval(some[:, 2]), f"{some[:, 1].mean() / 1e6:.2f}")
        ]
        lines.append(f"| {label} | {len(one.level)} | " + " | ".join(cells) + " |")
    assert "\n".join(lines) in page

    def gap(one, other, goal="level"):
        return stats.difference(*(getattr(x, goal)[:, 2] for x in (one, other)))

    def times(one, other, column=2):
        return stats.ratio(one.level[:, column], other.level[:, column])

    def p(one, other):
        return stats.welch_of(*(x.level[:, 2] for x in (one, other)))

    def span(one, digits=2):
        return "({:.{d}f} to {:.{d}f})".format(*one[1:], d=digits)

    sooner = [gap(best, x) for x in (three, two)]
    walk = gap(best, two, "walks")
    values = [p(best, x) for x in (three, two)]
    holm = 2 * min(values)
    assert values[0] < 0.05 < holm and max(values) > 0.05 and walk.low < 0 < walk.high
    many, usual, ppo, _ = fresh
    later = gap(usual, many), gap(usual, many, "walks")
    assert p(usual, many) < 0.05 and later[1].low < 0 < later[1].high
    every = [10 * (x.level[:, 2] / x.level[:, 0]).mean() for x in (many, usual)]
    rows = [(x.level[:, 1] / x.robots).mean() for x in (many, usual)]
    for words in (
        f"at the level {around(later[0], 2, ' s before it')[:-1]}, p {p(usual, many):.3f}),"
        f" {around(times(many, usual), 2, ' times the seconds')}, for"
        f" {around(times(many, usual, 1), 1, ' times the steps')}. On 2026-11-29 it was"
        f" {around(sooner[0], 2, ' s')}, with Holm's correction for the two settings p {holm:.3f}.",
        f"no difference is shown: {around(later[1], 1, ' s before `best`')}.",
        f"{sooner[1].value:.2f} s before `best` {span(sooner[1])[:-1]}, p {values[1]:.2f}), for"
        f" {around(times(two, best, 1), 1, ' times the steps')}. Three rounds were"
        f" {around(gap(two, three), 2, ' s before two')}. That fewer rounds walk sooner is not shown:"
        f" {around(walk, 1, ' s before `best`')}.",
        f"three rounds need {rows[0]:.0f} of 2048 robots, and `best` {rows[1]:.0f} of 1024.",
        f"takes {around(times(ppo, many), 1, ' times as long as three rounds with as many')}, for"
        f" {times(ppo, many, 1).value:.1f} times the steps ({times(ppo, many, 1).low:.1f} to"
        f" {times(ppo, many, 1).high:.0f}).",
        f"take {every[0]:.2f} s until then with 2048 robots and {every[1]:.2f} with `best`.",
        f"a row of 2048 takes {many.row:.1f} ms, one of 1024 {usual.row:.1f}.",
        f"{many.level[:, 2].mean():.2f} s to the level, not {usual.level[:, 2].mean():.2f}.",
    ):
        assert words in settings, words
    chosen, ppos = table.settings(found, "go1.warp")
    quick = table.fastest(table.variants(found, chosen))
    assert (chosen, quick) == (usual, many) and ppo in ppos
    even = table.for_seconds(found, quick, ppos).removeprefix("; for seconds ")
    even = even.replace("0.5 ", "0.50 ")
    assert f"- **Break-even** would be at {even.replace(' (', ' ms (')}." in settings
    again, walked = gap(before, best), gap(best, before, "walks")
    runs = row_cost_words("runs")
    for words in (
        f"**`best` again**: {table.interval(best.level[:, 2])} s to the level here,"
        f" {table.interval(before.level[:, 2])} on 2026-11-27: {around(again, 2, ' s less')}.",
        f"{best.walks[:, 2].mean():.2f} and {before.walks[:, 2].mean():.2f} s ({walked.value:.1f} s more,"
        f" {walked.low:.1f} to {walked.high:.1f})",
        "They take {:.2f} and {:.2f} s to the level.".format(*cut.level[:, 2]),
    ):
        assert words in runs, words
    kernel = next(x for x in found if x[:3] == ("go1.kernel", first, "best"))
    at = table.later(kernel, table.cost(found, kernel), best.row, table.power_of("go1.warp"))
    both = np.concatenate([best.level, before.level])[:, 2]
    slow, all_ten = (stats.difference(x, at) for x in (best.level[:, 2], both))
    text = f"it took {table.interval(best.level[:, 2])} s: {slow.value:.2f} longer than computed"
    text += f" {span(slow)}, and over all ten runs {all_ten.value:.2f} {span(all_ten)}."
    assert text in row_cost_words("computed")
    own = table.cost(found, usual)
    evens = [
        table.even(way(usual), [way(x) for x in ppos], own) for way in (lambda x: x, table.to_walk)
    ]
    text = f"of 2026-11-30 is higher, {evens[0].replace(' (', ' ms (')}; to a walk {evens[1]}. With three"
    assert f"{text} rounds and 2048 robots it would be {even}." in row_cost_words("computed")


def test_what_the_pages_say_of_the_new_seeds_of_2026_11_30_is_so():
    """By the rules set before: one Welch test with MuJoCo Warp, two with our kernel, by Holm, and which PPO
    has a row of README.md. How many such runs would show what five seeds had; that no first seed was slow."""
    table, batch = script(f"{ROW_COST}/table"), "H200, 2026-11-30"
    found, jobs = table.runs(), of_host(table, batch)
    asked = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    jobs = {name: seeds for name, seeds in jobs.items() if name.startswith("go1.")}
    assert {*jobs} == {line.split()[0] for line in asked if ".again-" in line}
    slower, ms = {}, {}  # % of the first two seeds; ms of an iteration, by seed
    for name, seeds in jobs.items():
        rows = [row for some in seeds.values() for row in some]
        count = 10 if name in ("go1.warp.again-best", "go1.warp.again-n2048") else 5
        assert [*map(int, seeds)] == [*range(1110, 1110 + count)]
        assert {f"{name} {row['job']}" for row in rows} <= {*asked}
        assert {(row["commit"][:8], row["device"]) for row in rows} == {("2a51cc3d", "NVIDIA H200")}
        assert all(int(row["iteration"]) % 10 == 0 for row in rows)
        ms[name] = [1e3 * float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in seeds.values()]
        slower[name] = 100 * (np.mean(ms[name][:2]) / np.mean(ms[name][2:]) - 1)
    warp, kernel = (
        {one.method: one for one in found if one[:2] == (f"go1.{x}", batch)}
        for x in ("warp", "kernel")
    )
    assert all(np.isfinite([x.level, x.walks]).all() for x in (*warp.values(), *kernel.values()))

    def gap(one, other, goal="level"):
        return stats.difference(*(getattr(x, goal)[:, 2] for x in (one, other)))

    def mean(one, goal="level"):
        return getattr(one, goal)[:, 2].mean()

    best, many, ppo, tuned = (warp[x] for x in ("best", "best-n2048", "ppo2048", "ppo2048-walk"))
    p = stats.welch_of(best.level[:, 2], many.level[:, 2])
    less, walk = gap(best, many), gap(best, many, "walks")
    times = [stats.ratio(many.level[:, k], best.level[:, k]) for k in (2, 1)]
    longer = [stats.ratio(ppo.level[:, 2], x.level[:, 2]) for x in (best, many)]
    steps = [stats.ratio(ppo.level[:, 1], x.level[:, 1]) for x in (best, many)]
    mine, quick, its, walker = (
        kernel[x] for x in ("best", "best-r2n4096", "ppo2048", "ppo2048-walk")
    )
    goals = "level", "walks"
    holm = stats.holm(
        [stats.welch_of(*(getattr(x, goal)[:, 2] for x in (quick, its))) for goal in goals]
    )
    assert p < 0.05 and max(holm) < 0.05
    sooner = [gap(quick, its, goal) for goal in goals]
    beside = [gap(mine, its, goal) for goal in goals]
    since = [gap(mine, walker, goal) for goal in goals]
    assert since[0].low > 0 > since[1].low  # "that it walks sooner is not shown"
    p_walks = [stats.welch_of(mine.walks[:, 2], x.walks[:, 2]) for x in (its, walker)]
    then = [
        next(x for x in found if x[:3] == ("go1.kernel", "H200, 2026-11-27", m)).walks[:, 2]
        for m in ("best", "ppo2048")
    ]
    earlier, p_earlier = stats.difference(*then), stats.welch_of(*then)
    assert beside[1].low > 0 and earlier.low > 0
    # which PPO has the row: by its mean to the level
    assert mean(walker) < mean(its) and mean(tuned) > mean(ppo)
    for place, usual, fast in (("go1.kernel", mine, walker), ("go1.warp", best, ppo)):
        chosen, ppos = table.settings(found, place)
        assert chosen is usual and table.fastest_beside(chosen, ppos) is fast
    # what is told of 2026-11-29, were it true
    last = "H200, 2026-11-29, second host"
    older = {one[1:3]: one for one in found if one.place == "go1.warp"}
    one, other = (older[last, x].level[:, 2] for x in ("best", "best-n2048"))
    more = (stats.moments(x)._replace(n=10) for x in (one, other))
    t, df, _ = stats.welch(*more)
    nct, least = scipy_stats.nct, special.stdtrit(df, 0.975)
    power = 1 - nct.cdf(least, df, t) + nct.cdf(-least, df, t)
    before = next(x for x in found if x[:3] == ("go1.kernel", "H200, 2026-11-27", "ppo2048"))
    on_tuning = next(x for x in found if x[:3] == ("go1.kernel", last, "tune-r2n4096"))
    every = [f"{x:.1f}" for x in ms["go1.warp.again-best"]]
    # "went on after three seeds": each process measured its own row
    parts = {x[0]["row_ms"] for x in [*jobs["go1.warp.again-n2048"].values()][:3]}
    assert [len({x[0]["row_ms"] for x in some.values()}) for some in jobs.values()].count(2) == 1
    assert len(parts) == 1 and parts != {jobs["go1.warp.again-n2048"]["1113"][0]["row_ms"]}
    again = table.break_even(mine, [walker, its], table.cost(found, mine), 1.0)
    walks = table.break_even(
        table.to_walk(mine), [*map(table.to_walk, (walker, its))], table.cost(found, mine), 1.0
    )
    usual, ppos = (
        next(x for x in found if x[:3] == ("go1.kernel", "H200, 2026-11-27", m))
        for m in ("best", "ppo2048")
    )
    cost = table.cost(found, usual)
    first_day = table.break_even(usual, [ppos], cost, table.POWERS["a GPU"])[0]
    settled = [
        x for x in found if x[:2] == ("go1.kernel", "H200, 2026-11-27") and "ppo" in x.method
    ]
    settled = [table.to_walk(x) for x in settled if np.isfinite(x.walks).all()]
    first_walk = table.break_even(table.to_walk(usual), settled, cost, table.POWERS["a GPU"])[0]
    shares = [
        stats.ratio(getattr(walker, goal)[:, 1], getattr(mine, goal)[:, 1]).value for goal in goals
    ]
    few = "{:.0f} ({:.0f} to {:.0f})"
    told = {
        "runs": [
            f"after {mean(many):.2f} instead of {mean(best):.2f} s: {around(less, 2, ' s less')[:-1]}, p"
            f" {p:.3f}), {around(times[0], 2, ' times the seconds')}, for"
            f" {around(times[1], words=' times the steps')}.",
            f"If the {(one - other).mean():.2f} s of 2026-11-29 were true, {100 * power:.0f} of 100 such runs"
            f" would show it. To a walk, told without a test, it is {mean(many, 'walks'):.2f} and"
            f" {mean(best, 'walks'):.2f} s: {around(walk, 2, ' less')}.",
            f"{mean(ppo):.2f} s to the level, {around(longer[0], words=' times as long as `best`')} and"
            f" {around(longer[1], words=' times as long as with 2048 robots')}, for {few.format(*steps[0])}"
            f" and {steps[1].value:.1f} times the steps ({steps[1].low:.1f} to {steps[1].high:.0f}). To a"
            f" walk {mean(ppo, 'walks'):.2f} s: {around(gap(ppo, best, 'walks'), 2, ' more than `best`')}.",
            f"To the level it is {mean(quick):.2f} and {mean(its):.2f} s,"
            f" {around(sooner[0], 2, ' more')[:-1]}, by Holm {holm[0]:.4f}); to a walk"
            f" {mean(quick, 'walks'):.2f} and {mean(its, 'walks'):.2f}, {around(sooner[1], 2, ' more')[:-1]},"
            f" by Holm {holm[1]:.3f}).",
            f"`best` takes {mean(mine):.2f} and {mean(mine, 'walks'):.2f} s: {around(beside[0], 2)} and"
            f" {around(beside[1], 2, ' more than `ppo2048`')[:-1]}, p {p_walks[0]:.3f}).",
            f"before `ppo2048` was at its level ({before.level[:, 0].mean():.0f})",
            f"it is lower, {mean(walker):.2f} instead of {mean(its):.2f} s"
            f" ({around(gap(its, walker), 2, ' less').replace(' (', ', ')[:-1]}; to a walk"
            f" {mean(walker, 'walks'):.2f} instead of {mean(its, 'walks'):.2f}); with MuJoCo Warp it is not,"
            f" {mean(tuned):.2f} instead of {mean(ppo):.2f}.",
            f"With our kernel `best` takes {around(since[0], 2, ' s more than it to the level')}, and"
            f" {around(since[1], 2, ' to a walk')[:-1]}, p {p_walks[1]:.3f}).",
            f"and walks {around(earlier, 2, ' s before')[:-1]}, p {p_earlier:.3f}; by no rule).",
            f"an iteration of `best` takes {', '.join(every[:-1])} and {every[-1]} ms, by seed. In all eight"
            f" jobs the first two take {min(slower.values()):.1f} to {max(slower.values()):.1f} % longer",
        ],
        "settings": [
            *(
                f"| {label} | {table.interval(x.level[:, 2])} | {table.interval(x.walks[:, 2])} |"
                for label, x in (
                    ("two rounds, 4096 robots", quick),
                    ("`best`", mine),
                    ("PPO, 2048 robots", its),
                    ("PPO, 2048 robots, tuned since", walker),
                )
            ),
            f"at the level (by Holm {holm[0]:.4f}) and at a walk ({holm[1]:.3f}). On three tuning seeds these"
            f" had taken {mean(on_tuning):.2f} and {mean(on_tuning, 'walks'):.2f} s.",
        ],
        "README": [
            f"{mean(walker):.2f} instead of {mean(mine):.2f} s to the level and {mean(walker, 'walks'):.2f}"
            f" instead of {mean(mine, 'walks'):.2f} to a walk, for {shares[0]:.0f} and {shares[1]:.0f} times"
            " the steps. To the level it is faster; that it walks sooner is not shown"
            f" ({around(since[1], 2, ' s').replace(' (', ', ')[:-1]}, p {p_walks[1]:.3f}). The older PPO of"
            f" the other places takes {mean(its):.2f} and {mean(its, 'walks'):.2f} s. It walks sooner than"
            f" `best`, by {around(beside[1], 2, ' s')[:-1]}, p {p_walks[0]:.3f}), and on 2026-11-27 by"
            f" {around(earlier, 2)[:-1]}, p {p_earlier:.3f}), neither by a rule. By a rule it is sooner than",
            f"two rounds with 4096 robots, which take {mean(quick):.2f} and {mean(quick, 'walks'):.2f} s ([p"
            f" by Holm](runs.md#go1) {holm[0]:.4f} and {holm[1]:.3f}).",
            f"`best` is faster: {mean(best):.2f} instead of {mean(ppo):.2f} s to the level and"
            f" {mean(best, 'walks'):.2f} instead of {mean(ppo, 'walks'):.2f} to a walk.",
            f"it takes {mean(many):.2f} s to the level: {around(less, 2, ' s less')[:-1]}, p {p:.3f}, by [a"
            f" rule set before](runs.md#go1)), for {times[1].value:.1f} times the steps. To a walk no"
            " difference is shown.",
            f"From runs of 2026-11-27 it is {first_day:.2f} and {first_walk:.2f} ms.",
            f"two rounds with 4096 robots {mean(quick):.2f} s, `best` {mean(mine):.2f}, PPO"
            f" {mean(walker):.2f}; with MuJoCo Warp {mean(many):.2f} and {mean(best):.2f};",
            f"{again[0]:.2f}, not 0.43 ms, if a row costs as its robots do",
        ],
        "computed": [
            "Go1 breaks even at {:.2f} ms ({:.2f} to {:.2f}), to a walk at {:.2f} ({:.2f} to {:.2f}), by the"
            " runs of"
            " 2026-11-30.".format(*again, *walks),
        ],
    }
    for name, texts in told.items():
        for text in texts:
            assert text in row_cost_words(name), (name, text)
    assert walk.low < 0 < walk.high
    text = "git show 2a51cc3d:experiments/30_row_cost/next.md"
    assert text in row_cost_words("runs")


def test_the_first_two_seeds_of_a_process_are_the_slow_ones_with_mujoco_warp():
    """Whichever they are: `best-n2048` went on in a second process, which timed a row again."""
    table = script(f"{ROW_COST}/table")
    jobs = {}
    for row in table.read():
        # `again-` begins each process with two that are thrown away
        if row["name"].split(".")[1] in ("warp", "exact") and " warmup=" not in row["job"]:
            process = row["batch"], row["name"], row["row_ms"]
            jobs.setdefault(process, {}).setdefault(row["seed"], []).append(row)
    ms = {
        key: {
            seed: 1e3 * float(rows[-1]["seconds"]) / int(rows[-1]["iteration"])
            for seed, rows in seeds.items()
        }
        for key, seeds in jobs.items()
    }
    some = {key: [*seeds.values()] for key, seeds in ms.items() if len(seeds) >= 3}
    assert all(min(each[:2]) > max(each[2:]) for each in some.values())
    more = {
        name: [
            100 * (np.mean(each[:2]) / np.mean(each[2:]) - 1)
            for key, each in some.items()
            if name in key[1]
        ]
        for name in (".best", ".ppo")
    }
    assert len(some) == sum(map(len, more.values()))
    spans = [f"{min(x):.0f} to {max(x):.0f} %" for x in more.values()]
    runs = row_cost_words("runs")
    hosts = {8: "eight"}[len({key[0] for key in some})]
    text = f"in all {len(some)} processes with that step and three seeds or more that threw none away first,"
    text += f" on {hosts} hosts:"
    assert f"{text} with `best` by {spans[0]}, with PPO by {spans[1]}." in runs
    last = "H200, 2026-11-29, second host"
    (alone,), again = (
        seeds
        for (batch, name, _), seeds in ms.items()
        if (batch, name) == (last, "go1.warp.best-n2048")
    )
    assert alone == "1100" and [*again] == ["1101", "1102", "1103", "1104"]
    values = [*again.values()]
    words = "1101 and 1102 are the slow ones ({:.0f} and {:.0f} ms; {:.0f} to {:.0f})"
    assert words.format(*values[:2], *sorted(values[2:])) in runs
    (own,) = [seeds for key, seeds in ms.items() if key[:2] == (last, "go1.warp.best")]
    values = [*own.values()]
    words = (
        "1100 and 1101 take {:.0f} and {:.0f} ms an iteration, the other three {:.0f} to {:.0f}."
    )
    assert words.format(*values[:2], min(values[2:]), max(values[2:])) in runs
    (older,) = [x for key, x in jobs.items() if key[:2] == ("H200, 2026-11-27", "go1.warp.best")]
    tails = []  # ms of iterations 11 to 150
    for rows in older.values():
        clock = {row["iteration"]: float(row["seconds"]) for row in rows}
        tails.append(f"{(clock['150'] - clock['10']) / 0.14:.0f}")
    words = "1100 and 1101 take {} and {} ms in each of the iterations 11 to 150, the other three {} to {}."
    assert words.format(*tails[:2], min(tails[2:]), max(tails[2:])) in row_cost_words("computed")


def test_the_first_two_seeds_are_a_little_slow_with_our_kernel_too():
    """Of processes on H200s with three seeds or more: our kernel in a Go1's, a Go2's and a G1's; MJX-JAX."""
    table, jobs = script(f"{ROW_COST}/table"), {}
    after = {}  # of those that begin with two that are thrown away
    for row in table.read():
        if row["device"] == "NVIDIA H200" and not row.get("run"):
            process = row["batch"], row["name"], row["row_ms"]
            some = after if " warmup=" in row["job"] else jobs
            some.setdefault(process, {})[row["seed"]] = (
                1e3 * float(row["seconds"]) / int(row["iteration"])
            )
    fine = [
        100 * (np.mean(ms[:2]) / np.mean(ms[2:]) - 1)
        for (_, name, _), seeds in after.items()
        if ".fine" in name and len(ms := [*seeds.values()]) >= 3
    ]
    assert len(fine) == 6 and sum(gain > 0 for gain in fine) == 5
    more = {}
    for (batch, name, _), seeds in jobs.items():
        ms, place = [*seeds.values()], name.rpartition(".")[0]
        if len(ms) >= 3:
            kind = "kernel" if place in ("go1.kernel", "g1.kernel", "go2.rough") else place
            gain = 100 * (np.mean(ms[:2]) / np.mean(ms[2:]) - 1)
            more.setdefault(kind, {})[batch, name] = gain
    ours, jax = ([*more[kind].values()] for kind in ("kernel", "go1.jax"))
    rough = "best-r1e3", "ppo2048-often", "ppo4096-often", "best", "ppo2048"
    slow = sum(gain > 0 for gain in ours)
    runs = row_cost_words("runs")
    for words in (
        f"in {slow} of {len(ours)} processes with three seeds or more that threw none away first, but less:"
        f" in the median by {np.median(ours):.1f} %, at most by {max(ours):.1f}. Of the six with more physics"
        " steps, which threw two away, it is five,"
        f" by at most {max(fine):.1f} %.",
        "The first two seeds of `best-r1e3`, `ppo2048-often` and `ppo4096-often` take {:.1f}, {:.1f} and"
        " {:.1f} % longer an iteration than the others, of `best` {:.1f} and of `ppo2048` {:.1f}.".format(
            *(more["kernel"]["H200, 2026-11-30", f"go2.rough.{x}"] for x in rough)
        ),
        f"With MJX-JAX it is {min(jax):.0f} to {max(jax):.0f} % (five processes).",
    ):
        assert words in runs, words
    assert len(jax) == 5
    day = "H200, 2026-11-27"
    both = more["kernel"][day, "go1.kernel.best"], more["go1.warp"][day, "go1.warp.best"]
    words = "take {:.0f} % longer an iteration than the others, here {:.0f}.".format(*both)
    assert f"the first two of `best` {words}" in row_cost_words("computed")
    # with that step by more than with our kernel, in the median
    dear = [x for kind in more if kind not in ("kernel", "go1.jax") for x in more[kind].values()]
    assert len(dear) == 25 and np.median(dear) > 2 * np.median(ours)


def test_ppo_for_seconds_is_an_older_setting_than_the_headlines():
    """Its flags in all jobs of a Go1 and an ANYmal-C on a GPU; the steps of both, and what `best` needs."""
    table, measure = script(f"{ROW_COST}/table"), script(f"{ROW_COST}/run")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    jobs = {name: measure.read(job, fields) for name, job, *fields in map(str.split, lines)}
    older = [
        job.config
        for name, job in jobs.items()
        if re.match(r"(go1|anymal_c)\..*ppo\d+$", name)
        and not re.match(r"go1\.laptop.*ppo512", name)
    ]
    assert len(older) == 25
    for config in older:
        own = config.ppo.gamma, config.ppo.lambda_, config.ppo.desired_kl, config.rollout.horizon
        assert own == (0.97, 0.9, 0.03, 24) and not config.task.carry_on
        assert config.task.episode_length == 250  # 5 s
        assert config.schedule.late_from > config.run.num_iterations  # its KL is never halved
    _, job, *fields = headline("ppo-g").split()  # "It is `PPO` of 21_less"
    pair = jobs["go1.kernel.ppo256"], measure.read(job, fields)
    own, then = (config_fields.flat(one.config) for one in pair)
    assert own == then | {key: own[key] for key in own if key.startswith("run.")}
    found = table.runs()
    best, ppos = table.settings(found, "go1.kernel")
    few = table.fewest(found, best, ppos)
    assert few[1:3] == ("H200, 2026-11-27", "ppo256")
    steps, share = few.level[:, 1].mean() / 1e6, stats.ratio(few.level[:, 1], best.level[:, 1])
    (own,) = [x for x in found if x[:3] == ("go1.kernel", few.batch, "best")]
    of_its_day = stats.ratio(few.level[:, 1], own.level[:, 1])
    head = {name: ours_of(f"{name}-g").level for name in ("best", "ppo-level", "ppo-walk")}
    ppo = [head[name].mean() / 1e6 for name in ("ppo-level", "ppo-walk")]
    ratios = [stats.ratio(head[name], head["best"]).value for name in ("ppo-level", "ppo-walk")]
    assert {len(some) for some in head.values()} == {10}
    assert all(" rollout.num_envs=128 " in headline(f"{x}-g") for x in ("ppo-level", "ppo-walk"))
    for words, page in (
        (
            f"need {ppo[1]:.1f} to {ppo[0]:.2f} M steps to the level on a Go1, this one {steps:.2f} with 256"
            f" robots. So the ratio of steps of {share.value:.1f} here is not the headline's"
            f" {ratios[1]:.1f} to {ratios[0]:.1f}.",
            "README",
        ),
        (
            f"need {ppo[0]:.2f} and {ppo[1]:.2f} M steps to the level on a Go1 (ten seeds each, 128 robots),"
            f" `ppo256` here {steps:.2f}. So here PPO needs {of_its_day.value:.1f} times the steps of `best`,"
            f" there [{ratios[0]:.1f} and {ratios[1]:.1f}]",
            "runs",
        ),
    ):
        assert words in row_cost_words(page), words
    # "the one to walk has run for seconds with 2048 robots", and no other of the two
    some = [x for x in found if x.place.startswith("go1.") and x.method.startswith("ppo")]
    assert {x.robots for x in some if x.method.endswith("-walk")} == {2048}
    assert {x.method for x in some if "-" in x.method} == {"ppo2048-walk"}


def test_what_runs_again_is_as_before_on_new_seeds_and_as_its_rules_say():
    """`again-` of 2026-11-30: the same settings but seeds and two that are thrown away; PPO to walk as the
    headline's but robots and iterations. PPO of a Go2 that is evaluated oftener. What has not run."""
    table, measure = script(f"{ROW_COST}/table"), script(f"{ROW_COST}/run")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    asked = {name: (job, fields) for name, job, *fields in map(str.split, lines)}
    again = [name for name in asked if ".again-" in name]
    assert len(again) == 8

    def told(name):
        job, fields = asked[name]
        skipped = ("seeds=", "run.seed=", "warmup=")
        return [job, *(x for x in fields if not x.startswith(skipped))]

    for name in again:
        read = measure.read(*asked[name])
        count = 10 if name in ("go1.warp.again-best", "go1.warp.again-n2048") else 5
        assert (read.seeds, read.warmup, read.config.run.seed) == (count, 2, 1110)
        assert read.episodes == measure.EPISODES
    for name, before in (
        ("go1.warp.again-best", "go1.warp.best"),
        ("go1.warp.again-n2048", "go1.warp.best-n2048"),
        ("go1.warp.again-ppo2048", "go1.warp.ppo2048"),
        ("go1.kernel.again-best", "go1.kernel.best"),
        ("go1.kernel.again-ppo2048", "go1.kernel.ppo2048"),
        ("go1.kernel.again-r2n4096", "go1.kernel.tune-r2n4096"),
    ):
        assert told(name) == told(before)
    _, job, *fields = headline("ppo-walk-g").split()
    then = config_fields.flat(measure.read(job, fields).config)
    for place in ("kernel", "warp"):
        read = measure.read(*asked[f"go1.{place}.again-ppo2048-walk"])
        now = config_fields.flat(read.config)
        other = {key for key in now if now[key] != then[key] and not key.startswith("run.")}
        assert other == {"rollout.num_envs", "schedule.late_from"}
        assert now["schedule.late_from"] >= now["run.num_iterations"]  # never halved
        assert then["schedule.late_from"] * 128 * 24 / 1e6 == pytest.approx(1.5, abs=0.03)
        half = then["schedule.late_from"] * 128 / 2048
        assert (now["ppo.lambda_"], now["ppo.desired_kl"]) == (0.85, 0.04)
    rows = table.read()
    had = {}
    for x in rows:
        if x["job"].startswith("go1") and x["device"] != "cpu":
            had.setdefault(x["name"], set()).add(int(x["seed"]))
    since = {name: some for name, some in had.items() if some & {*range(1110, 1120)}}
    fine = {f"go1.fine{steps}.{x}" for steps in (16, 32) for x in ("best", "ppo2048")}
    assert {*since} == {*fine, *again} and max(max(some) for some in had.values()) == 1124
    page = row_cost_words("next")
    assert "fresh seeds for a Go1 on a GPU begin at 1125." in page
    assert f"With 2048 that is iteration {half:.0f}, long before `ppo2048`" in row_cost_words(
        "runs"
    )
    # evaluated as often as `best` for seconds, and nothing else
    for count in (2048, 4096):
        names = f"go2.rough.ppo{count}-often", f"go2.rough.ppo{count}", "go2.rough.best-r1e3"
        often, once, quick = (measure.read(*asked[name]) for name in names)
        now, then = (config_fields.flat(x.config) for x in (often, once))
        assert {key for key in now if now[key] != then[key]} == {"run.log_every"}
        assert now["run.log_every"] == quick.config.run.log_every == 25 and often[2:] == once[2:]
    # all that has not run is named, and nothing else
    ran = {(x["name"], x["seed"]) for x in rows}
    left = set()
    for name, (job, fields) in asked.items():
        if name.startswith("go1.laptop.new"):  # in the rows as one, `again-`
            continue
        read = measure.read(job, fields)
        first = read.config.run.seed
        if any((name, str(seed)) not in ran for seed in range(first, first + read.seeds)):
            left.add(name)
    text = (EXPERIMENTS / ROW_COST / "next.md").read_text()
    commands = [x.split()[2:] for x in text.splitlines() if x.startswith("    python $J")]
    named = [name for some in commands for name in paper.chosen(asked, some)]
    assert len(named) == len(set(named)) and left <= {*named}
    assert {*named} == left == {"go2.rough.tune-r2n4096"}


def test_a_row_of_more_physics_steps_is_as_long():
    """`fine` of runs.md and next.md: the control step of `again-`, divided oftener, and nothing else, but
    that 64 steps are on seeds of their own."""
    measure = script(f"{ROW_COST}/run")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    asked = {name: measure.read(job, fields) for name, job, *fields in map(str.split, lines)}
    for steps, method in itertools.product((16, 32, 64), ("best", "ppo2048")):
        one, other = asked[f"go1.fine{steps}.{method}"], asked[f"go1.kernel.again-{method}"]
        now, then = (config_fields.flat(x.config) for x in (one, other))
        changed = {key for key in now if now[key] != then[key]}
        seed = now["run.seed"]
        assert seed == (1120 if steps == 64 else 1110)
        assert changed - {"run.seed"} == {"physics.substeps", "physics.timestep"}
        assert now["physics.substeps"] == steps and then["physics.substeps"] == 4
        length = [x["physics.substeps"] * x["physics.timestep"] for x in (now, then)]
        assert length == pytest.approx([0.02, 0.02])
        assert one[2:] == other[2:] and one.seeds == 5 and one.warmup == 2


def test_what_was_expected_of_64_physics_steps_was_computed_from_the_runs_with_4():
    """By the cost that 16 and 32 steps had; on seeds that no other job of a Go1 has."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    told = row_cost_words("runs")
    two = [table.cost(found, table.settings(found, f"go1.fine{n}")[0]) for n in (16, 32)]
    ms = two[1] + (64 - 32) * (two[1] - two[0]) / (32 - 16)
    day = "H200, 2026-11-27"
    best, ppo = (
        next(x for x in found if x[:3] == ("go1.kernel", day, method))
        for method in ("best", "ppo2048")
    )
    own, power = table.cost(found, best), table.power_of("go1.kernel")
    level, walk = (
        [table.later(way(x), own, ms, power) for x in (best, ppo)]
        for way in (lambda x: x, table.to_walk)
    )
    text = f"**We had expected** {ms:.2f} ms a row, {level[0].mean():.2f} s with `best` and"
    assert f"{text} {level[1].mean():.2f} with PPO, which five seeds show." in told
    last = f"We had expected {walk[1].mean():.1f} with PPO and {walk[0].mean():.1f} with `best`, and that no"
    assert f"{last} difference is shown. None is, but in the mean it is the other way." in told
    assert stats.welch_of(*level) < 0.001 and stats.welch_of(*walk) > 0.05
    ran = [row for row in table.read() if "laptop" not in row["name"]]
    names = {row["name"] for row in ran if int(row["seed"]) in range(1120, 1125)}
    assert names == {"go1.fine64.best", "go1.fine64.ppo2048"}


def test_what_the_pages_say_of_a_row_of_more_physics_steps_is_so():
    """By the rules set before them: Welch tests of the seconds to the level, by Holm; what had been
    expected, and what is computed from the runs with 4 physics steps."""
    table, day = script(f"{ROW_COST}/table"), "H200, 2026-11-29"
    found, jobs = table.runs(), of_host(table, f"{day}, third host")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    assert {*jobs} == {f"go1.fine{n}.{x}" for n in (16, 32) for x in ("best", "ppo2048")}
    last = of_host(table, f"{day}, fourth host")
    jobs |= {name: last[name] for name in ("go1.fine64.best", "go1.fine64.ppo2048")}
    slower, each = {}, []  # % of the first two seeds; s of ten iterations
    for name, seeds in jobs.items():
        rows = [row for some in seeds.values() for row in some]
        first, commit = (1120, "05f6d8fb5aa0") if "64" in name else (1110, "32eca1697358")
        assert [*map(int, seeds)] == [*range(first, first + 5)]
        assert {f"{name} {row['job']}" for row in rows} <= {*lines}
        assert {(row["commit"], row["device"]) for row in rows} == {(commit, "NVIDIA H200")}
        assert all(
            int(x["iteration"]) == 10 * k for some in seeds.values() for k, x in enumerate(some, 1)
        )
        ms = [1e3 * float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in seeds.values()]
        slower[name.partition(".")[2]] = 100 * (np.mean(ms[:2]) / np.mean(ms[2:]) - 1)
        each.append(np.mean(ms) / 100)
    pairs = [table.settings(found, f"go1.fine{steps}") for steps in (16, 32, 64)]
    both = [(best, ppo) for best, (ppo,) in pairs]
    costs = [table.cost(found, best) for best, _ in both]
    assert all(np.isfinite([x.level, x.walks]).all() for pair in both for x in pair)
    clocks = [[x.level[:, 2] for x in pair] for pair in both]
    walks = [[x.walks[:, 2] for x in pair] for pair in both]
    p = [stats.welch_of(*pair) for pair in clocks]
    holm = stats.holm(p)
    assert min(holm[:2]) > 0.05 > holm[2]  # "shown at neither", "`best` is sooner"
    assert costs[0] < 0.5 and costs[1] < 0.95  # "cheaper"
    assert stats.holm(p[:2]).tolist() == holm[:2].tolist()
    gain = stats.difference(*clocks[2][::-1])
    less, more = stats.difference(*clocks[0]), stats.difference(*clocks[1][::-1])
    sooner = [stats.difference(*pair) for pair in walks]
    # expected, and computed at the costs that rows had, from the runs with 4
    every = {x[1:3]: x for x in found if x.place == "go1.kernel"}
    best, ppo = (every["H200, 2026-11-27", method] for method in ("best", "ppo2048"))
    own, power = table.cost(found, best), table.power_of("go1.kernel")

    def at(ms, way=lambda one: one):
        return [table.later(way(x), own, ms, power) for x in (best, ppo)]

    expected = [x.mean() for ms in (0.5, 0.95) for x in at(ms)]
    levels, walking = ([at(ms, way) for ms in costs] for way in (lambda x: x, table.to_walk))
    early = []  # of twelve
    for measured, computed in ((clocks, levels), (walks, walking)):
        for some, others in zip(measured, computed, strict=True):
            gaps = [stats.difference(*x) for x in zip(others, some, strict=True)]
            early += [(k, gap) for k, gap in enumerate(gaps) if not gap.low < 0 < gap.high]
    ((who, early),) = early  # "to a walk of one of six"
    wide = stats.difference(walking[2][1], walks[2][1])
    assert who == 1 and early == wide
    # by the runs of 2026-11-30 none is
    newer = [every["H200, 2026-11-30", method] for method in ("best", "ppo2048")]
    since = []
    for way, measured in ((lambda x: x, clocks), (table.to_walk, walks)):
        for ms, some in zip(costs, measured, strict=True):
            took = [table.later(way(x), table.cost(found, x), ms, power) for x in newer]
            since += [stats.difference(*pair) for pair in zip(took, some, strict=True)]
    assert len(since) == 12 and all(gap.low < 0 < gap.high for gap in since)
    slow, *others = sorted(both[2][0].level[:, 2])[::-1]
    late = both[2][0].walks[:, 2].max()
    assert both[2][0].walks[:, 0].max() == 240 and int([*last["go1.fine64.best"]][1]) == 1121
    assert both[2][0].level[1, 2] == slow and both[2][0].walks[1, 2] == late
    even = [
        (table.even(one, [two], ms), table.even(table.to_walk(one), [table.to_walk(two)], ms))
        for (one, two), ms in zip(both, costs, strict=True)
    ]
    many = [pair[1].row for pair in both]
    shares = [row / ms for row, ms in zip(many, costs, strict=True)]
    rows = [[(x.level[:, 1] / x.robots).mean() for x in pair] for pair in both]
    rest = [
        [
            np.mean((1e3 * x.level[:, 2] - x.level[:, 1] / x.robots * x.row) / x.level[:, 0])
            for x in pair
        ]
        for pair in both
    ]

    def line(label, computed, measured, k):
        some = [table.interval(x[k]) for two in zip(computed, measured, strict=True) for x in two]
        return f"| {label} | " + " | ".join(some) + " |"

    pages = {name: row_cost_words(name) for name in ("README", "runs", "computed")}
    times = [stats.ratio(*pair[::-1]) for pair in clocks]
    steps = [stats.ratio(two.level[:, 1], one.level[:, 1]) for one, two in both]
    means = [[x.mean() for x in pair] for pair in (*clocks, *walks)]
    few = "{:.0f} times the steps ({:.2g} to {:.0f})"
    told = {
        "runs": [
            f"every 10 iterations, {min(each[:4]):.2f} to {max(each[:4]):.2f} s of training, on 500 episodes",
            "Evaluated every {:.2f} (`best`) and {:.2f} s (PPO).".format(*each[4:]),
            f"At {costs[2]:.3f} ms PPO takes {around(gain, 2, ' s more than `best`')[:-1]}, p {p[2]:.3f}, by"
            f" Holm {holm[2]:.3f}), {around(times[2], 2, ' times as long')[:-1]}; intervals are",
            f"1121 takes {slow:.2f} s, the other four {min(others):.2f} to {max(others):.2f}.",
            f"the rest right: {means[2][0]:.2f} and {means[2][1]:.2f} s. At {costs[2]:.3f} ms"
            f" {levels[2][0].mean():.2f} and {levels[2][1].mean():.2f} are computed.",
            f"PPO takes {means[5][1]:.2f} and `best` {means[5][0]:.2f} s: {around(sooner[2], 2, ' s less')}.",
            f"Seed 1121 of `best` walks after {late:.2f} s, in the last two of 25 evaluations.",
            f"is {even[2][0].replace(' (', ' ms (').replace('0.2 ', '0.20 ')}, to a walk {even[2][1][:-1]};"
            f" computed). A row of 2048 robots took {many[2]:.2f} ms, {shares[2]:.2f} times one of 1024.",
            f"At {costs[0]:.3f} ms PPO takes {around(less, 2, ' s less')[:-1]}, p {p[0]:.2f}, by Holm"
            f" {holm[0]:.2f}), at {costs[1]:.3f} ms {around(more, 2, ' s more than `best`')[:-1]}, p"
            f" {p[1]:.3f}, by Holm {holm[1]:.3f}).",
            "We had expected 0.5 and 0.95 ms. [By computation](computed.md) `best` takes {:.2f} s and PPO"
            " {:.2f} at 0.5 ms, which five seeds may not show, and {:.2f} and {:.2f} at 0.95 ms,".format(
                *expected
            ),
            f"16 physics steps more took {costs[1] - costs[0]:.2f} ms, not {0.95 - 0.5:.2f}.",
            f"PPO takes {means[3][1]:.2f} and `best` {means[3][0]:.2f} s at {costs[0]:.3f} ms:"
            f" {around(sooner[0], 2, ' s less')}; {means[4][1]:.2f} and {means[4][0]:.2f} s at"
            f" {costs[1]:.3f} ms: {around(sooner[1], 2, ' less')}.",
            f"is {even[0][0].replace(' (', ' ms (')} with 16 and {even[1][0]} with 32 physics steps; to"
            f" a walk {even[0][1]} and {even[1][1][:-1]}; all computed).",
            "took {:.2f} and {:.2f} ms, {:.2f} and {:.2f} times one of 1024; computed is {:.2f}.".format(
                *many[:2], *shares[:2], 2**power
            ),
            "of `best` take {:.1f} and {:.1f} % longer an iteration than the other three, though two were"
            " thrown away before them, those of PPO {:.1f} and {:.1f} %.".format(
                *(slower[f"fine{n}.{x}"] for x in ("best", "ppo2048") for n in (16, 32))
            ),
        ],
        "computed": [
            "| | computed at {:.3f} ms | measured, 16 | computed at {:.3f} ms | measured, 32 | computed at"
            " {:.3f} ms | measured, 64 |".format(*costs),
            line("`best`, to the level", levels, clocks, 0),
            line("PPO, 2048 robots, to the level", levels, clocks, 1),
            line("`best`, to a walk", walking, walks, 0),
            line("PPO, 2048 robots, to a walk", walking, walks, 1),
            f"with 64 physics steps PPO walks {around(early, 2, ' s sooner than computed')[:-1]}; not"
            f" corrected), and {around(since[-1], 2, ' s by the runs of 2026-11-30')}, from which of none of"
            " the twelve a difference is shown.",
            f"is {even[0][0].replace(' (', ' ms (')}, {even[1][0]} and {even[2][0].replace('0.2 ', '0.20 ')},"
            f" to a walk {even[0][1]}, {even[1][1]} and {even[2][1]}.",
            "needs {:.0f}, {:.0f} and {:.0f} rows of 1024 robots, PPO {:.0f}, {:.0f} and {:.0f} of 2048. All"
            " else takes {:.1f}, {:.1f} and {:.1f} ms an iteration with `best`, {:.1f}, {:.1f} and {:.1f}"
            " with PPO.".format(*np.transpose(rows).ravel(), *np.transpose(rest).ravel()),
        ],
        "README": [
            "a row costs {:.2f}, {:.2f} or {:.2f} ms. At {:.2f} ms a Go1".format(*costs, costs[0]),
            f"after {means[0][0]:.2f} s with `best` and {means[0][1]:.2f} with PPO, which takes"
            f" {around(times[0], 2, ' times as long')}, for {few.format(*steps[0])}.",
            f"At {costs[1]:.2f} ms it is {means[1][0]:.2f} and {means[1][1]:.2f} s: PPO takes"
            f" {around(times[1], 2, ' times as long')[:-1]}, not corrected), for"
            f" {few.format(*steps[1])}.",
            f"at neither cost (Welch's p by Holm {holm[0]:.2f} and {holm[1]:.3f}). At {costs[2]:.2f} ms it is"
            f" shown ({holm[2]:.3f}): {means[2][0]:.2f} and {means[2][1]:.2f} s, PPO takes"
            f" {around(times[2], 2, ' times as long')}, for {few.format(*steps[2])}. To a walk, told without"
            f" a test, PPO takes {means[3][1]:.2f} instead of {means[3][0]:.2f} s, {means[4][1]:.2f} instead"
            f" of {means[4][0]:.2f}, and {means[5][1]:.2f} instead of {means[5][0]:.2f}.",
            "it is {}, {} and {} ms, to a walk {}, {} and {}.".format(
                *(even[k][way].partition(" ")[0] for way in (0, 1) for k in range(3))
            ),
        ],
    }
    for name, texts in told.items():
        for text in texts:
            assert text in pages[name], (name, text)
    assert (
        "The rule, set before they ran**: seconds to the level, a Welch test at each cost"
        in pages["runs"]
    )
    for name, words in (
        ("docs/results.md", "at neither (p by Holm {:.2f} and {:.3f})"),
        (
            "experiments/README.md",
            "with five seeds neither difference is shown (Holm {:.2f} and {:.3f})",
        ),
        (
            "README.md",
            "follows commands sooner with `best`, after 1.25 instead of 2.11 s (p {2:.3f}, corrected)",
        ),
    ):
        page = " ".join((EXPERIMENTS.parent / name).read_text().split())
        assert words.format(*holm) in page, name
    plan = (EXPERIMENTS / "next.txt").read_text() + (EXPERIMENTS / "folders.md").read_text()
    assert "fine16" not in plan and "16 and 32 physics steps" not in plan


def test_how_the_second_host_of_2026_11_29_ran_is_as_the_page_of_runs_says():
    """Which jobs, seeds and commit; that all were evaluated as often."""
    table, last = script(f"{ROW_COST}/table"), "H200, 2026-11-29, second host"
    rows = [row for row in table.read() if row["batch"] == last]
    seeds, ends = {}, {}
    for row in rows:
        name = row["name"].removeprefix("go1.")
        seeds.setdefault(name, {})[int(row["seed"])] = None
        ends.setdefault(name, set()).add(int(row["iteration"]))
    few, fresh = [0, 1, 2], [*range(1100, 1105)]
    assert {name: [*some] for name, some in seeds.items()} == {
        **{f"kernel.tune-{x}": few for x in ("r1n4096", "r1n512", "r2n4096", "r2n512")},
        **{f"warp.{x}": fresh for x in ("best", "best-n2048", "best-r2n2048")},
        "warp.ppo2048": fresh[:2],
    }
    assert all(some == {*range(10, max(some) + 1, 10)} for some in ends.values())
    assert {row["commit"][:8] for row in rows} == {"724e00df"}
    assert {row["device"] for row in rows} == {"NVIDIA H200"}
    jobs = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    asked = {f"{row['name']} {row['job']}" for row in rows}
    assert asked <= {*jobs} and not any("episodes=" in job for job in asked)
    runs = row_cost_words("runs")
    for words in (
        "one and two rounds with 512 and 4096 robots (seeds 0 to 2)",
        "`best` with 2048 robots and three or two rounds (`best-n2048`, `best-r2n2048`), `best`, and PPO with"
        " 2048 robots (1100 to 1104).",
        "commit 724e00df. The flags are those of `jobs.txt`; evaluated every 10 iterations on 500 episodes",
        "**PPO was cut off** after two of five seeds",
    ):
        assert words in runs, words

"""30_row_cost: seconds over the cost of a row, its pages and its computations."""

import importlib
import itertools
import json
import re
import sys
import types
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from result_files import EXPERIMENTS, ROOT, ROW_COST, ours_of, script, shows
from scipy import special
from scipy import stats as scipy_stats

from dynappo import schedule
from dynappo.config import fields as config_fields
from dynappo.terrain import tiles
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
        assert len(rows) >= (95 if name == "runs" else 9)
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
        if method == "best-r2n2048":
            text = f"`best` takes {level:.2f} and {walks:.2f} s (five fresh seeds, another host)"
            assert text in pages["README"] and len(one.level) == 5
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
    text = "needs {:.0f} rows of 1024 robots with `best`, {:.0f} of 2048 or {:.0f} of 256 with PPO."
    assert text.format(*rows) in pages["computed"] and f"{rows[1] / rows[0]:.0f}" == "7"
    assert "a Go1 needs a seventh of the rows of PPO with 2048 robots" in pages["README"]
    some = [run["go1.kernel", own, m] for m in ("best", "ppo2048", "ppo256")]
    *rest, slow = [  # of all seeds' iterations
        (1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row).sum()
        / one.level[:, 0].sum()
        for one in (*some, run["go1.warp", own, "best"])
    ]
    assert f"all but rows took {slow:.1f} ms of each, not {rest[0]:.1f}." in pages["computed"]
    text = "{:.1f} ms an iteration of {:.0f}, and {:.1f} of {:.0f}, or {:.1f} of {:.0f}."
    each = [(ms, one.level[:, 0].mean()) for ms, one in zip(rest, some, strict=True)]
    assert text.format(*np.ravel(each)) in pages["computed"]
    assert "all else in an iteration takes [four times as long]" in pages["README"]
    assert f"{rest[0] / rest[1]:.0f}" == "4"
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
    """`best` for seconds beside PPO of the first host, the runs of 2026-11-28 with MuJoCo Warp's own step,
    and who walks by the end."""
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
    some = (best, ppo, quick)
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
    assert text in pages["computed"]
    # who walks by iteration 160, and who still falls there
    known = [one.walks[:, 2] for one in (best, quick, *dear)]
    assert [int(np.isfinite(one).sum()) for one in known] == [10, 8, 2, 5]
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
        ((2 + 5 + 9, 20), (10 + 10 + 8, 30), "16 of 20 and 28 of 30, p 0.20"),
        ((2, 5), (5, 5), "Fisher's p 0.17"),
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
            f" {within(longer, 'times as long', 2)}, for {within(more, 'times the steps')}. So no"
            " difference in seconds is shown; [`best` was evaluated oftener, and PPO crosses more tiles]",
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
            "`best-r1e3` was evaluated seven times as often",
            f"to 80 % after {ten(eighty).mean():.1f} s in all ten runs, instead of"
            f" {eighty[1].mean():.1f};"
            f" by {within(stats.difference(eighty[1], eighty[2]), 's on that card')}, and by"
            f" {around(stats.difference(eighty[1], ten(eighty))).replace(' (', ' with all ten runs (')[:-1]},"
            f" p {stats.welch_of(eighty[1], ten(eighty)):.2f}), for"
            f" {within(stats.ratio(ten(to_80), to_80[1]), 'times the steps')}",
            f"After its {last[1]:.1f} s it crosses {crossed(quick, last[1]).mean():.0f} % of tiles, PPO"
            f" {crossed(ppo, last[1]).mean():.0f} % by then ({points.value:.1f} points more,"
            f" {points.low:.1f} to {points.high:.1f})",
            f"At its end, after {last[2] / last[1]:.1f} times as long, PPO has"
            f" {within(stats.difference(ends[2], ends[1]), 'points more')}, and the"
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
    assert "([of 30 runs on three hosts 27 get there]" in pages[f"{ROW_COST}/README"]
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
    text = f"of a G1 {all_ours[0].mean():.2f}, 3.65 and PPO {all_theirs[0].mean():.2f} on several hosts"
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


def test_what_the_pages_of_seconds_say_of_a_g1_with_mujoco_warps_step_on_one_host_is_so():
    """`best` and PPO of one card, PPO with 2048 robots of the other; beside the two hosts before, and beside
    what follows from the runs with our kernel."""
    table, day = script(f"{ROW_COST}/table"), "H200, 2026-11-28"
    host = "H200, 2026-11-29"
    found, jobs = table.runs(), of_host(table, host)
    run = {one[:3]: one for one in found}
    pages = {
        name: " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())
        for name in ("README", "runs", "computed")
    }
    best, ppo, many = (run["g1.warp", host, m] for m in ("best", "ppo1024x12", "ppo2048"))
    chosen, ppos = table.settings(found, "g1.warp")
    assert chosen is best and sorted(one.method for one in ppos) == [ppo.method, many.method]
    assert table.fastest_beside(best, ppos) is ppo and table.sparing(ppos) is ppo
    assert [len(one.level) for one in (best, ppo, many)] == [5] * 3
    assert np.isfinite([best.walks, ppo.walks, many.walks]).all()  # "All five of both walk"
    np.testing.assert_array_equal(best.walks, best.level)
    before = run["g1.warp", f"{day}, second host", "best"]
    three, five = (
        run["g1.warp", f"{day}, {which} host", "ppo1024x12"] for which in ("second", "third")
    )
    asked = {}  # the same settings and seeds on all three hosts
    for row in table.read():
        if row["name"] in ("g1.warp.best", "g1.warp.ppo1024x12"):
            asked.setdefault(row["name"], set()).add((row["job"], row["device"]))
    assert [len(some) for some in asked.values()] == [1, 1]
    seconds, steps = ([one.level[:, k] for one in (best, ppo, many)] for k in (2, 1))
    longer, more = stats.ratio(seconds[1], seconds[0]), stats.ratio(steps[1], steps[0])
    walk = stats.ratio(ppo.walks[:, 2], best.walks[:, 2])
    ten = np.concatenate([best.level, before.level])
    every = np.concatenate([ppo.level, three.level, five.level])
    ms, slower = {}, []
    for name in ("best", "ppo1024x12", "ppo2048"):
        last = {seed: rows[-1] for seed, rows in jobs[f"g1.warp.{name}"].items()}
        each = {seed: 1e3 * float(x["seconds"]) / int(x["iteration"]) for seed, x in last.items()}
        ms[name] = np.mean([*each.values()])
        usual = np.mean([each[seed] for seed in each if seed not in ("1100", "1101")])
        slower += [100 * (each[seed] / usual - 1) for seed in ("1100", "1101")]
    often = (
        ms["ppo1024x12"] / 50,
        ms["ppo2048"] / 50,
        ms["best"] / 100,
    )  # s of 20, 20, 10 iterations
    gaps = [
        stats.difference(seconds[0], before.level[:, 2]),
        stats.difference(five.level[:, 2], seconds[1]),
    ]
    after = [16 - int(at / 10) + 1 for at in best.level[:, 0]]  # evaluations from there on
    assert (min(after), max(after)) == (3, 5)
    ends = {seed: rows[-1] for seed, rows in jobs["g1.warp.best"].items()}
    falls = {seed: round(200 * float(row["fall_rate"])) for seed, row in ends.items()}
    assert falls == {"1100": 0, "1101": 2, "1102": 1, "1103": 2, "1104": 1}
    errors = np.mean(
        [[float(row[key]) for key in ("tracking_error", "yaw_error")] for row in ends.values()], 0
    )
    for text in (
        f"PPO takes {around(stats.difference(seconds[1], seconds[0]), words=' s longer')},"
        f" {around(longer, words=' times the seconds of `best`')} and"
        f" {around(more, words=' times the steps')}; with 2048 robots"
        f" {around(stats.ratio(seconds[2], seconds[0]))} and"
        f" {around(stats.ratio(steps[2], steps[0]), 0, ' times')}.",
        "came every {:.1f} s, with 2048 robots every {:.1f}, with `best` every {:.1f};".format(
            *often
        ),
        "with `best` by {:.0f} and {:.0f} %, with PPO by {:.0f} and {:.0f} %.".format(*slower[:4]),
        f"PPO takes {around(walk, words=' times the seconds')} and"
        f" {around(stats.ratio(ppo.walks[:, 1], best.walks[:, 1]), words=' times the steps')}.",
        "at the last one seeds 1101 and 1103 fall in 2,",
        f"`best` takes {around(gaps[0], words=' s more here')}, PPO"
        f" {around(gaps[1], words=' less than on the third host')}.",
        f"it is {table.interval(ten[:, 2])} and {table.interval(every[:, 2])} s:"
        f" {around(stats.ratio(every[:, 2], ten[:, 2]), words=' times as long')}, for"
        f" {around(stats.ratio(every[:, 1], ten[:, 1]), words=' times the steps')}.",
        "{:.3f} and {:.3f} on 2026-11-29,".format(*errors),
    ):
        assert text in pages["runs"], text
    assert f"ten of `best` and {len(every)} of PPO" in pages["runs"] and len(ten) == 10
    commits = {x["commit"][:8] for job in jobs.values() for rows in job.values() for x in rows}
    assert f"commit {', '.join(commits)}, evaluated" in pages["runs"]
    # computed from the runs with our kernel
    cost = table.cost(found, best)
    kernel = [run["g1.kernel", day, method] for method in ("best", "ppo1024x12")]
    later, walked = (
        [
            table.later(way(one), table.cost(found, one), cost, table.power_of("g1.warp"))
            for one in kernel
        ]
        for way in (lambda one: one, table.to_walk)
    )
    gaps = [stats.difference(*pair) for pair in zip(seconds[:2], later, strict=True)]
    assert all(gap.low < 0 < gap.high for gap in gaps)  # "Of neither a difference is shown"
    here = [table.at_cost(found, one, cost) for one in ppos]
    to_walk = [table.at_cost(found, table.to_walk(one), cost) for one in ppos]
    evens = table.even(best, here, cost), table.even(table.to_walk(best), to_walk, cost)
    rows = [(one.level[:, 1] / one.robots).mean() for one in (best, ppo)]
    rest = [
        np.mean((1e3 * one.level[:, 2] - one.level[:, 1] / one.robots * one.row) / one.level[:, 0])
        for one in (best, ppo)
    ]
    iterations = [one.level[:, 0].mean() for one in (best, ppo)]
    own = "H200, 2026-11-27"
    clocks = []  # of 1024 robots the mean of `best` and PPO
    for place, batch in (("go1.warp", own), ("go1.exact", day), ("anymal_c.exact", day)):
        few, some, lots = (run[place, batch, f"ppo{count}"] for count in (512, 1024, 2048))
        clocks += [few.row, table.cost(found, some), lots.row]
    its = [run["go1.warp", own, method].walks[:, 2] for method in ("ppo2048", "best")]
    for text in (
        f"| `best`, {cost:.2f} ms a row | {table.interval(later[0])} | {table.interval(seconds[0])} |",
        f"| PPO, 1024 robots, 12 rows | {table.interval(later[1])} | {table.interval(seconds[1])} |",
        f"`best` took {around(gaps[0], 2, ' s longer than computed')}, PPO {around(gaps[1], 2)}. To a walk"
        f" it is {walked[0].mean():.1f} and {walked[1].mean():.1f} s computed,"
        f" {best.walks[:, 2].mean():.2f} and {ppo.walks[:, 2].mean():.2f} measured.",
        f"at {cost:.2f} ms alone, a G1 would break even at {evens[0].replace(' (', ' ms (')}, to a walk at"
        f" {evens[1]}, of the second run of `best` alone (7 of its 10 walk).",
        "it is {:.0f} and {:.0f} rows, and".format(*rows)
        + f" {rest[0]:.1f} ms of {iterations[0]:.0f} and {rest[1]:.1f} of {iterations[1]:.0f}.",
        "{:.2f}, {:.2f} and {:.2f} with 512, 1024 and 2048, in the exact tasks {:.2f}, {:.2f} and {:.2f}"
        " (Go1), {:.2f}, {:.2f} and {:.2f} (ANYmal-C), of a G1".format(*clocks)
        + f" {cost:.2f} and {many.row:.2f} with 1024 and 2048.",
        f"takes {around(stats.ratio(*its), words=' times as long on a Go1')},"
        f" {around(stats.difference(*its), words=' s more').removesuffix(')')}, Welch's p"
        f" {stats.welch_of(*its):.2f}), and {around(walk, words=' times on a G1').removesuffix(')')}; of the"
        " second run of `best` alone, 7 of its 10 walk).",
    ):
        assert text in pages["computed"], text
    text = (
        f"4.4 ms, a G1 takes {seconds[0].mean():.2f} s with `best` and {seconds[1].mean():.2f} with PPO on"
        f" the same card: {around(longer, words=' times as long')}, for"
        f" {around(more, words=' times the steps')}."
    )
    # of both runs of `best`, and of all three of PPO
    count = {
        name: [int(np.isfinite(one.walks[:, 2]).sum()) for one in some]
        for name, some in (("best", (before, best)), ("ppo", (three, five, ppo)))
    }
    assert count == {"best": [2, 5], "ppo": [3, 5, 5]} and len(before.walks) == 5
    text += (
        f" Of `best` {sum(count['best'])} of {len(ten)} walk (two runs of five seeds: [two, then all"
        f" five](runs.md#g1)), of PPO all {sum(count['ppo'])}. Of the second run alone: after"
        f" {best.walks[:, 2].mean():.2f} and {ppo.walks[:, 2].mean():.2f} s,"
        f" {around(walk, words=' times as long')}."
    )
    assert text in pages["README"] and len(every) == sum(count["ppo"])
    alone = evens[1].partition(" ")[0]
    assert f"The {alone} ms of `g1.warp` are of the second run alone." in pages["README"]
    assert "**Of `best` 7 of 10 walk, of PPO all 13**" in pages["runs"]
    assert "**To a walk**, in this second run alone, PPO takes" in pages["runs"]


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
    before_it_ran = table.later(ours["ppo2048"], cost, few.row, power)
    slow = table.later(ours["ppo1024"], cost, few.row, power)
    for measured, computed in ((best.level, mine), (ppo.level, its), (ppo.walks, walk)):
        gap = stats.difference(measured[:, 2], computed)
        assert gap.low < 0 < gap.high  # "Of none a difference is shown"
    text = (
        f"{best.row:.1f} ms a row, a Go1 is at its level after {clocks[1].mean():.2f} s with `best` and after"
        f" {clocks[0].mean():.2f} with PPO with 2048 robots, one after the other on one card:"
        f" {around(longer, words=' times as long')}, for {least}. PPO's five walk, after"
        f" {ppo.walks[:, 2].mean():.2f} s, of `best` [four by their end](runs.md#go1), after"
        f" {walked.mean():.2f}."
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
        f"Before PPO ran, README.md had computed {before_it_ran.mean():.1f} s for it, at the cost",
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
    text += ": beside it fewer steps are not shown, either"
    assert text in pages["README"]
    laptop = " ".join((EXPERIMENTS / "04_laptop/README.md").read_text().split())
    more = stats.difference(seconds[1], seconds[0])
    text = (
        "PPO alone takes {:.1f} times the steps to 38 of 45 with as many robots ({:.1f} to {:.1f}),"
    )
    text = (
        text.format(*ratios[0]) + f" with 256 robots {fewer.format(*ratios[1])}. So beside the best"
    )
    text = (
        text.replace("1.1 times the steps", "1.1 times")
        + " PPO that ran the tail is not shown to save"
    )
    text += " steps, nor seconds: {:.1f} s with it and {:.1f} without, {:.1f} s more ({:.1f} to {:.1f}).**"
    assert text.format(seconds[0].mean(), seconds[1].mean(), *more) in laptop
    assert more.low < 0 < more.high and ratios[1].low < 1 < ratios[1].high
    assert {len(one.level) for one in (best, many, few)} == {5} and table.fastest(
        [many, few]
    ) is many
    # today's, whose feet are lifted, and that of 2026-11-26
    assert np.isfinite(best.walks).all() and "walks with five of five fresh seeds" in laptop
    today = script(f"{ROW_COST}/run").read("go1:laptop", []).config.task.weights.foot_clearance
    assert f"pays for lifted feet (`foot_clearance` {today:.1f}," in laptop
    tours = (EXPERIMENTS / "04_laptop/results/tours.txt").read_text().partition("\n\n")[0]
    some = re.findall(r"^80\d return ([\d.]+), falls ([\d.]+) %", tours, re.MULTILINE)
    assert all(float(value) >= 38 and float(falls) <= 1 for value, falls in some)
    text = "that of 2026-11-26, whose feet were not lifted, with [ten of ten](#fewer-falls)."
    assert text in laptop and len(some) == 10 and "C MuJoCo, 2026-11-26" in tours
    run = (EXPERIMENTS / "04_laptop/results/make_train.txt").read_text()
    trained = float(re.search(r"^training +([\d.]+) s", run, re.MULTILINE)[1])
    assert f"the recorded run trained for {trained:.0f} s" in laptop
    minutes, rest = map(int, re.search(r"(\d+) min (\d+) s with the set-up", run).groups())
    makefile = (ROOT / "Makefile").read_text()
    for page, told in (
        (laptop, "takes three to seven minutes with the set-up"),
        (makefile, "three to seven"),
    ):
        assert told in page and 3 < minutes + rest / 60 < 7
    even = table.even(best, [many, few], table.cost(found, best)).partition(" (")
    text = f"which is how the break-even of {even[0]} ms ({even[2][:-1]}; computed) takes it"
    assert text in pages["runs"]
    # as if a row cost as those of PPO with 256 and 512 robots do
    twice = many.row / few.row
    half = np.mean([best.row, many.row])  # a row of 512 robots
    ms = {1.0: 2 * half, np.log2(twice): twice * half}
    assert (
        [f"{x:.0f}" for x in ms.values()]
        == [f"{table.cost(found, best):.0f}", "32"]
        == ["55", "32"]
    )
    of_both = [table.break_even(best, [many, few], before, power) for power, before in ms.items()]
    assert f"{of_both[0][0]:.2g}" == even[0]
    less = "{:.0f} ({:.0f} to {:.0f})".format(*of_both[1])
    at_512 = {f"{one[0] / 2**power:.1f}" for one, power in zip(of_both, ms, strict=True)}
    text = f"do, {twice:.2f} times for twice the robots, one of 1024 takes 32 ms, and the break-even is"
    text += f" {less}. In ms of 512 robots, which took {half:.0f} in the mean, it is {', '.join(at_512)} in"
    assert text in pages["runs"]


def test_where_no_go1_ran_and_what_was_not_tuned_is_as_the_pages_of_seconds_say():
    """Between which costs no Go1 ran; where PPO's most robots are the fastest; what 4096 would take, from the
    runs with our kernel; where `best` has no settings for seconds."""
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
    go1 = [table.cost(found, run) for run in found if run.place.startswith("go1.")]
    below, above = max(x for x in go1 if x < level[0]), min(x for x in go1 if x > level[0])
    for text in (
        "more than {:.2f} ms ({:.2f} to {:.2f})".format(*level),
        f"sooner from {walk.replace(' (', ' ms on (')}.",
        f"No Go1 ran between {below:.1f} and {above:.1f} ms.",
    ):
        assert text in pages["README"], text
    assert below < level[0] < float(walk.split()[0]) < above
    for place, most in (
        ("go1.warp", 2048),
        ("go1.exact", 2048),
        ("anymal_c.exact", 2048),
        ("go1.jax", 2048),
        ("go1.laptop", 512),
        ("go2.rough", 4096),
    ):
        mine, its = table.settings(found, place)
        ran = [x.robots for x in found if x.place == place and x.method.startswith("ppo")]
        assert max(ran) == most == table.fastest_beside(mine, its).robots
        # with MJX-JAX 1024 robots, on another host, take as long
        assert table.fastest(its).robots == (1024 if place == "go1.jax" else most)
        if place not in ("go1.laptop", "go2.rough", "go1.warp"):
            assert not any(
                x.place == place and x.method.startswith(("best-", "tune-")) for x in found
            )
    assert not any(x.place == "g1.warp" and x.method.startswith("best-") for x in found)
    text = "2048 are the most that ran on a Go1 and an ANYmal-C, and the fastest (with MJX-JAX as fast as"
    assert f"{text} 1024), on two cores 512; on rough ground 4096 are the most." in pages["README"]
    text = "and `best` with MJX-JAX and in the exact tasks. With MuJoCo Warp two settings ran,"
    assert text in pages["README"]
    assert "With MJX-JAX and in the exact tasks no setting was tried" in pages["settings"]
    mine = [x.method for x in found if x.place == "go1.warp" and x.method.startswith("best-")]
    assert mine == ["best-n2048", "best-r2n2048"]
    # PPO with 4096 robots
    run, day = {one[:3]: one for one in found}, "H200, 2026-11-27"
    power = table.POWERS["a GPU"]
    warp, jax = (table.cost(found, table.settings(found, x)[0]) for x in ("go1.warp", "go1.jax"))

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
    text = "4096 would [take as long](computed.md#computed-beside-measured) with MuJoCo Warp."
    assert text in pages["README"]
    for text in (
        f"would take {first[0]:.1f} s to the level by the runs of 2026-11-27: {rows[0]:.0f} rows of"
        f" {dear[0]:.2f} times the cost of 1024 robots are {rows[0] * dear[0]:.0f} of these, {rows[1]:.0f} of"
        f" {dear[1]:.2f} with 2048 robots {rows[1] * dear[1]:.0f}.",
        "On the second host it is {:.1f} and {:.1f} s.".format(*other),
        "To a walk it would take {:.1f} s, with 2048 robots {:.1f}, on the second host {:.1f} and {:.1f}."
        " With MJX-JAX it is {:.1f} and {:.1f} s".format(*walks, *both("", jax)),
    ):
        assert text in pages["computed"], text
    assert "ppo4096" in [x.method for x in ppos]  # "count PPO with 4096 robots, too"
    slowest = run["anymal_c.exact", "H200, 2026-11-28", "ppo2048"].level[:, 0].max()
    assert f"with 2048 robots is at the level at iteration {slowest:.0f}" in pages["next"]


def flat(name):
    return " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())


def test_the_grid_of_rounds_and_robots_of_a_go1_is_as_the_page_of_settings_says():
    """`best` with our kernel on tuning seeds, on three hosts; two rounds with 4096 robots beside 2048, and
    beside PPO of two other hosts."""
    table = script(f"{ROW_COST}/table")
    run = {one[1:3]: one for one in table.runs() if one.place == "go1.kernel"}
    text, page = flat("settings"), (EXPERIMENTS / ROW_COST / "settings.md").read_text()
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
        "(two rounds, 4096 robots, three tuning seeds) that is shown on one host of two.",
    ):
        assert words in text, words
    words = "takes {:.2f} s on three tuning seeds of a third host: {:.2f} s more than those {:.2f} ({:.2f} to"
    words += " {:.2f}), {:.2f} more than PPO on the second ({:.2f} to {:.2f})."
    words = words.format(own, walks[1].value, its[1], *walks[1][1:], *walks[0])
    assert f"To a walk the nearest, two rounds with 4096, {words}" in flat("README")
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
    assert "(but three rounds with 4096), makes a tail pay to the level there." in flat("README")
    assert not any(key[0] == last and key[1].startswith("ppo") for key in run)
    assert not any("4096" in key[1] and key[1].startswith("best-") for key in run)
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
    assert words in flat("runs")
    rows = {
        n: sorted({x.row for x in tuned if x.batch == last and x.robots == n}) for n in (512, 4096)
    }
    found = table.runs()
    for place, words in (
        ("go1.kernel", "- **Break-even** would be at {} (host B, two rounds and 2048 robots)."),
        ("g1.kernel", "- **Break-even** on a G1 would be at {}, which is what its row costs."),
    ):
        best, ppos = table.settings(found, place)
        even = table.for_seconds(found, table.fastest(table.variants(found, best)), ppos)
        at, _, spread = even.removeprefix("; for seconds ").partition(" ")
        assert words.format(f"{float(at):.2f} ms {spread}") in text
    words = "took {:.2f} ms with 512 robots and {:.2f} to {:.2f} with 4096."
    assert words.format(rows[512][0], *rows[4096]) in flat("runs")
    assert f"the {table.cost(table.runs(), many):.3f} ms of the table" in flat("runs")


def test_settings_for_seconds_with_mujoco_warp_are_as_the_pages_say():
    """Two settings with 2048 robots beside `best` on one host, PPO of two hosts; which day README.md has."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    run = {one[1:3]: one for one in found if one.place == "go1.warp"}
    first, host = "H200, 2026-11-27", "H200, 2026-11-29, second host"
    best, three, two, cut = (
        run[host, x] for x in ("best", "best-n2048", "best-r2n2048", "ppo2048")
    )
    before, ppo = run[first, "best"], run[first, "ppo2048"]
    assert [len(x.level) for x in (best, three, two, cut, before, ppo)] == [5, 5, 5, 2, 5, 5]
    settings, page = flat("settings"), (EXPERIMENTS / ROW_COST / "settings.md").read_text()
    lines = []
    for label, one in (
        ("three rounds, 2048 robots", three),
        ("two rounds, 2048 robots", two),
        ("`best`: three rounds, 1024 robots", best),
        ("PPO, 2048 robots (two seeds)", cut),
    ):
        assert np.isfinite(one.walks).all()
        cells = [
            part
            for some in (one.level, one.walks)
            for part in (table.interval(some[:, 2]), f"{some[:, 1].mean() / 1e6:.2f}")
        ]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    assert "\n".join(lines) in page

    def gap(one, other, goal="level"):
        return stats.difference(*(getattr(x, goal)[:, 2] for x in (one, other)))

    def times(one, other, column=2):
        return stats.ratio(one.level[:, column], other.level[:, column])

    def p(one, other, goal="level"):
        return stats.welch_of(*(getattr(x, goal)[:, 2] for x in (one, other)))

    def span(one, digits=2):
        return "({:.{d}f} to {:.{d}f})".format(*one[1:], d=digits)

    sooner = [gap(best, x) for x in (three, two)]
    walk = [gap(best, x, "walks") for x in (three, two)]
    values = [p(best, x) for x in (three, two)]
    holm = 2 * min(values)
    assert values[0] < 0.05 < holm and max(values) > 0.05 and sooner[0].low > 0 > sooner[1].low
    assert all(one.low < 0 < one.high for one in walk)
    both = before._replace(level=np.concatenate([best.level, before.level]))
    ten = [gap(both, x) for x in (three, two)]
    every = [10 * (x.level[:, 2] / x.level[:, 0]).mean() for x in (three, two, best)]
    assert f"{every[1]:.2f}" == f"{every[2]:.2f}"
    rows = [(x.level[:, 1] / x.robots).mean() for x in (three, two, best)]
    longer = [times(ppo, x) for x in (three, two, best)]
    more = times(ppo, three, 1)
    for words in (
        f"{sooner[0].value:.2f} s before `best` {span(sooner[0])[:-1]}, Welch's p {values[0]:.3f}):"
        f" {around(times(three, best), 2, ' times the seconds')}, for"
        f" {around(times(three, best, 1), 1, ' times the steps')}.",
        f"for the two settings p is {holm:.3f}, so that they are faster is not shown.",
        f"{sooner[1].value:.2f} s before `best` {span(sooner[1])[:-1]}, p {values[1]:.2f}):"
        f" {around(times(two, best), 2, ' times the seconds')}, for"
        f" {around(times(two, best, 1), 1, ' times the steps')}.",
        f"Three rounds are {around(gap(two, three), 2, ' s before two')}.",
        f"{ten[0].value:.2f} s sooner {span(ten[0])[:-1]}, p {p(both, three):.3f}) and two {ten[1].value:.2f}"
        f" {span(ten[1])[:-1]}, p {p(both, two):.3f})",
        f"on the first host of 2026-11-27, {both.level[:, 2].mean():.2f} s, three rounds",
        f"{walk[0].value:.1f} s before `best` {span(walk[0], 1)[:-1]}, p {p(best, three, 'walks'):.2f}) with"
        f" three rounds and {walk[1].value:.1f} {span(walk[1], 1)[:-1]}, p {p(best, two, 'walks'):.2f}) with"
        " two.",
        "three rounds need {:.0f} of 2048 robots, two {:.0f}, and `best` {:.0f} of 1024.".format(
            *rows
        ),
        f"takes {ppo.level[:, 2].mean():.2f} s on the first host of 2026-11-27 (five seeds):"
        f" {longer[0].value:.1f} times as long as three rounds with 2048 robots {span(longer[0], 1)}, for"
        f" {around(more, 1, ' times the steps')}, {longer[1].value:.1f} times as long as two"
        f" {span(longer[1], 1)} and {longer[2].value:.1f} times as long as `best` here {span(longer[2], 1)}.",
        f"cut off after two seeds, after {cut.level[:, 2].mean():.2f} s",
        f"take {every[0]:.2f} s until then with three rounds and 2048 robots, {every[1]:.2f} with two and"
        " with `best`.",
        f"a row of 2048 takes {two.row:.1f} ms, one of 1024 {best.row:.1f}.",
        f"it takes {three.level[:, 2].mean():.2f} s to the level with 2048 robots, not"
        f" {best.level[:, 2].mean():.2f}; corrected for both settings that ran, this is not shown to be"
        " faster.",
    ):
        assert words in settings, words
    assert f"so its {three.level[:, 2].mean():.2f} s are flattered a little." in settings
    # the table's row keeps the day on which PPO has five seeds; `best` for seconds is beside these
    chosen, ppos = table.settings(found, "go1.warp")
    quick = table.fastest(table.variants(found, chosen))
    assert (chosen, quick) == (before, three) and ppo in ppos and cut not in ppos
    even = table.for_seconds(found, quick, ppos).removeprefix("; for seconds ")
    assert (
        f"Break-even would be at {even.replace(' (', ' ms (')}, beside PPO of 2026-11-27."
        in settings
    )
    # seed by seed, by SciPy's test of pairs
    pairs = [scipy_stats.ttest_rel(best.level[:, 2], x.level[:, 2]) for x in (three, two)]
    spans = [one.confidence_interval(0.95) for one in pairs]
    corrected = stats.holm([one.pvalue for one in pairs])
    assert f"{corrected[0]:.3f}" == f"{corrected[1]:.3f}"
    kernel = [
        next(x for x in found if x[:3] == ("go1.kernel", batch, "best")).level[:, 2]
        for batch in (first, f"{first}, second host")
    ]
    alike = [
        np.corrcoef(*pair)[0, 1]
        for pair in (
            (before.level[:, 2], best.level[:, 2]),
            (before.level[:, 0], best.level[:, 0]),
            kernel,
        )
    ]
    words = "three rounds are {:.2f} s sooner ({:.2f} to {:.2f}, paired t test, p {:.3f}) and two {:.2f}"
    words += (
        " ({:.2f} to {:.2f}, p {:.3f}), which Holm's correction would call shown (both {:.3f})."
    )
    cells = [
        (gap.value, *span, one.pvalue) for gap, span, one in zip(sooner, spans, pairs, strict=True)
    ]
    assert words.format(*cells[0], *cells[1], corrected[0]) in settings
    words = (
        "(`best` twice on these: r {:.2f} of seconds, {:.2f} of iterations; with our kernel {:.2f};"
    )
    assert words.format(*alike) in settings
    readme = flat("README")
    words = "it takes {:.2f} s on another host, where `best` takes {:.2f}: {:.2f} s less {}, for {:.1f} times"
    means = [x.level[:, 2].mean() for x in (three, best)]
    ratio = times(three, best, 1).value
    assert words.format(*means, sooner[0].value, span(sooner[0]), ratio) in readme
    for words in (
        f"It is the faster of two settings. Corrected for both, p is {holm:.3f}, so a difference is not",
        f"on 2026-11-29 [PPO had two](runs.md#go1), and `best` took {means[1]:.2f} s.",
        f"of `best` for seconds two of five ({cut.level[:, 2].mean():.1f} s)",
        "two rounds with 2048 robots {:.2f} s, `best` {:.2f}, PPO {:.2f}; with MuJoCo Warp {:.2f} and"
        " {:.2f};".format(
            *(
                next(x for x in found if x[:3] == key).level[:, 2].mean()
                for key in (
                    ("go1.kernel", f"{first}, second host", method)
                    for method in ("best-r2n2048", "best", "ppo2048")
                )
            ),
            *means,
        ),
    ):
        assert words in readme, words
    again, walked = gap(before, best), gap(best, before, "walks")
    runs = flat("runs")
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
    slow, all_ten = (stats.difference(x.level[:, 2], at) for x in (best, both))
    text = f"it took {table.interval(best.level[:, 2])} s: {slow.value:.2f} longer than computed"
    text += f" {span(slow)}, and over all ten runs {all_ten.value:.2f} {span(all_ten)}."
    assert text in flat("computed")
    assert f"2048 robots (another host) it would be {even}." in flat("computed")


def test_the_first_two_seeds_of_a_process_are_the_slow_ones_with_mujoco_warp():
    """Whichever they are: `best-n2048` went on in a second process, which timed a row again."""
    table = script(f"{ROW_COST}/table")
    jobs = {}
    for row in table.read():
        if row["name"].split(".")[1] in ("warp", "exact"):
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
    runs = flat("runs")
    hosts = {7: "seven"}[len({key[0] for key in some})]
    text = f"in all {len(some)} processes with that step and three seeds or more, on {hosts} hosts:"
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
    assert words.format(*tails[:2], min(tails[2:]), max(tails[2:])) in flat("computed")


def test_the_first_two_seeds_are_a_little_slow_with_our_kernel_too():
    """Of processes on H200s with three seeds or more: our kernel in a Go1's, a Go2's and a G1's; MJX-JAX."""
    table, jobs = script(f"{ROW_COST}/table"), {}
    for row in table.read():
        if row["device"] == "NVIDIA H200" and not row.get("run"):
            process = row["batch"], row["name"], row["row_ms"]
            jobs.setdefault(process, {})[row["seed"]] = (
                1e3 * float(row["seconds"]) / int(row["iteration"])
            )
    more = {}
    for (batch, name, _), seeds in jobs.items():
        ms, place = [*seeds.values()], name.rpartition(".")[0]
        if len(ms) >= 3:
            kind = "kernel" if place in ("go1.kernel", "g1.kernel", "go2.rough") else place
            gain = 100 * (np.mean(ms[:2]) / np.mean(ms[2:]) - 1)
            more.setdefault(kind, {})[batch, name] = gain
    ours, jax = ([*more[kind].values()] for kind in ("kernel", "go1.jax"))
    slow = sum(gain > 0 for gain in ours)
    runs = flat("runs")
    for words in (
        f"in {slow} of {len(ours)} processes with three seeds or more, but less: in the median by"
        f" {np.median(ours):.1f} %, at most by {max(ours):.1f}.",
        f"With MJX-JAX it is {min(jax):.0f} to {max(jax):.0f} % (four processes).",
    ):
        assert words in runs, words
    assert len(jax) == 4
    day = "H200, 2026-11-27"
    both = more["kernel"][day, "go1.kernel.best"], more["go1.warp"][day, "go1.warp.best"]
    words = "take {:.0f} % longer an iteration than the others, here {:.0f}.".format(*both)
    assert f"the first two of `best` {words}" in flat("computed")
    # with that step by more than with our kernel, in the median
    dear = [x for kind in more if kind not in ("kernel", "go1.jax") for x in more[kind].values()]
    assert len(dear) == 22 and np.median(dear) > 2 * np.median(ours)


def test_ppo_for_seconds_is_an_older_setting_than_the_headlines():
    """Its flags in all jobs of a Go1 and an ANYmal-C on a GPU; the steps of both, and what `best` needs."""
    table, measure = script(f"{ROW_COST}/table"), script(f"{ROW_COST}/run")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    jobs = {name: measure.read(job, fields) for name, job, *fields in map(str.split, lines)}
    older = [
        job.config
        for name, job in jobs.items()
        if re.match(r"(go1|anymal_c)\..*ppo\d+$", name) and name != "go1.laptop.ppo512"
    ]
    assert len(older) == 24
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
    few = table.sparing(ppos)
    assert few.method == "ppo256"
    steps, share = few.level[:, 1].mean() / 1e6, stats.ratio(few.level[:, 1], best.level[:, 1])
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
            f" `ppo256` here {steps:.2f}. So here PPO needs {share.value:.1f} times the steps of `best`,"
            f" there [{ratios[0]:.1f} and {ratios[1]:.1f}]",
            "runs",
        ),
    ):
        assert words in flat(page), words
    assert not any(x.method.endswith("-walk") for x in found)  # "have not run"


def headline(name):
    """The line of a job of 21_less/headline.txt."""
    lines = (EXPERIMENTS / "21_less/headline.txt").read_text().splitlines()
    (line,) = [line for line in lines if line.split()[0] == name]
    return f"{line} "


def test_what_runs_again_is_as_before_on_new_seeds_and_as_its_rules_say():
    """`again-` of next.md: the same settings but seeds and two that are thrown away; PPO to walk as the
    headline's but robots and iterations; how likely what ran is to be shown; what no row takes."""
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
    had = {int(x["seed"]) for x in rows if x["job"].startswith("go1")}
    assert not had & {*range(1110, 1120)}
    page = flat("next")
    assert f"With 2048 robots that is iteration {half:.0f}, long before `ppo2048`" in page
    # all that has not run is named, and nothing else
    ran = {(x["name"], x["seed"]) for x in rows}
    left = set()
    for name, (job, fields) in asked.items():
        read = measure.read(job, fields)
        first = read.config.run.seed
        if any((name, str(seed)) not in ran for seed in range(first, first + read.seeds)):
            left.add(name)
    text = (EXPERIMENTS / ROW_COST / "next.md").read_text()
    commands = [x.split()[2:] for x in text.splitlines() if x.startswith("    python $J")]
    named = [name for some in commands for name in paper.chosen(asked, some)]
    assert len(named) == len(set(named)) and left <= {*named}
    # and on one host once more
    assert {*named} - left == {"go2.rough.best-r1e3", "go2.rough.best"}
    # how likely ten seeds are to show what five showed
    found = table.runs()
    run = {one[1:3]: one for one in found if one.place == "go1.warp"}
    last = "H200, 2026-11-29, second host"
    one, other = (run[last, x].level[:, 2] for x in ("best", "best-n2048"))
    more = (stats.moments(x)._replace(n=10) for x in (one, other))
    t, df, _ = stats.welch(*more)
    nct, least = scipy_stats.nct, special.stdtrit(df, 0.975)
    power = 1 - nct.cdf(least, df, t) + nct.cdf(-least, df, t)
    assert f"it is shown in {100 * power:.0f} of 100 such runs" in page
    ppo = next(x for x in found if x[:3] == ("go1.kernel", "H200, 2026-11-27", "ppo2048"))
    assert f"before `ppo2048` was at its level ({ppo.level[:, 0].mean():.0f})" in page
    # no row of README.md takes them
    day = "H200, 2026-12-24"
    new = [
        ppo._replace(batch=day, method=name.rpartition(".")[2], place=name.rpartition(".")[0])
        for name in again
    ]
    assert table.compared([*found, *new]) == table.compared(found)


def test_a_row_of_more_physics_steps_is_as_long_and_its_rule_expects_what_is_computed():
    """`fine` of next.md: the control step of `again-`, divided oftener; nothing else is otherwise."""
    table, measure = script(f"{ROW_COST}/table"), script(f"{ROW_COST}/run")
    lines = (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    asked = {name: measure.read(job, fields) for name, job, *fields in map(str.split, lines)}
    for steps, method in itertools.product((16, 32), ("best", "ppo2048")):
        one, other = asked[f"go1.fine{steps}.{method}"], asked[f"go1.kernel.again-{method}"]
        now, then = (config_fields.flat(x.config) for x in (one, other))
        changed = {key for key in now if now[key] != then[key]}
        assert changed == {"physics.substeps", "physics.timestep"}
        assert now["physics.substeps"] == steps
        length = [x["physics.substeps"] * x["physics.timestep"] for x in (now, then)]
        assert length == pytest.approx([0.02, 0.02])
        assert one[2:] == other[2:] and one.seeds == 5 and one.warmup == 2
    found = table.runs()
    best, ppos = table.settings(found, "go1.kernel")
    (ppo,) = [x for x in ppos if x.method == "ppo2048"]
    own, power = table.cost(found, best), table.power_of("go1.kernel")
    cheap, dear = (
        [table.later(x, own, ms, power).mean() for x in (best, ppo)] for ms in (0.5, 0.95)
    )
    told = "at 0.5 ms `best` takes {:.2f} s and PPO {:.2f}, which five seeds may not show, and at 0.95 ms "
    assert told.format(*cheap) + "{:.2f} and {:.2f}, which they do.".format(*dear) in flat("next")


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
    runs = flat("runs")
    for words in (
        "one and two rounds with 512 and 4096 robots (seeds 0 to 2)",
        "`best` with 2048 robots and three or two rounds (`best-n2048`, `best-r2n2048`), `best`, and PPO with"
        " 2048 robots (1100 to 1104).",
        "commit 724e00df. The flags are those of `jobs.txt`; evaluated every 10 iterations on 500 episodes",
        "**PPO was cut off** after two of five seeds",
    ):
        assert words in runs, words


def test_the_lead_of_the_page_of_seconds_is_so():
    """At which costs which of the two is sooner on a Go1, and by how much; what no interval shows."""
    table = script(f"{ROW_COST}/table")
    found = table.runs()
    page = " ".join((EXPERIMENTS / ROW_COST / "README.md").read_text().split())
    times, costs = {}, {}
    for place in ("go1.kernel", "go1.exact", "go1.warp", "anymal_c.exact", "g1.warp", "go1.jax"):
        best, ppos = table.settings(found, place)
        clocks = [x.level[:, 2] for x in (table.fastest_beside(best, ppos), best)]
        times[place], costs[place] = stats.ratio(*clocks), table.cost(found, best)
    cheap = times.pop("go1.kernel")
    assert cheap.high < 1 and all(one.low > 1 for one in times.values())
    text = "at {:.1f} ms PPO is sooner, from {:.1f} to {:.1f} ms `best` is, {:.1f} to {:.1f} times."
    low = costs.pop("go1.kernel")
    values = [one.value for one in times.values()]
    text = text.format(low, min(costs.values()), max(costs.values()), min(values), max(values))
    assert f"Measured, to the level: {text} On two CPU cores no difference is shown.**" in page
    best, ppos = table.settings(found, "go1.laptop")
    for ppo in ppos:
        gap = stats.difference(ppo.level[:, 2], best.level[:, 2])
        assert gap.low < 0 < gap.high
    best, ppos = table.settings(found, "go1.kernel")
    even = table.break_even(best, ppos, table.cost(found, best), table.POWERS["a GPU"])[0]
    text = f"**On a GPU a Go1 breaks even at about {even:.1f} ms a row (computed). Measured"
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
            dear = other.place in (f"{robot}.warp", f"{robot}.jax") and len(other.level) >= 5
            if dear and own.method == other.method and own.method.startswith("ppo"):
                ms = table.cost(found, other)
                took = table.later(own, table.cost(found, own), ms, table.power_of(other.place))
                gap = stats.difference(took, other.level[:, 2])
                gaps[other.place, other.method, other.batch] = gap, took, other
    third = ("g1.warp", "ppo1024x12", f"{newer}, third host")
    few = gaps.pop(("go1.jax", "ppo1024", f"{newer}, seventh host"))[0]
    assert gaps.pop(third)[0].low < 0  # the same setting once more
    assert {key[:2] for key in gaps} == {
        ("go1.warp", "ppo1024"),
        ("go1.warp", "ppo2048"),
        ("go1.jax", "ppo2048"),
        ("g1.warp", "ppo1024x12"),
    }
    assert len(gaps) == 4 and all(gap.low < 0 < gap.high for gap, _, _ in gaps.values())
    mine = [x for x in found if x[1:3] == (day, "best") and x.place in ("go1.kernel", "go1.warp")]
    ours, dear = sorted(mine, key=lambda one: one.place)
    at = table.later(
        ours, table.cost(found, ours), table.cost(found, dear), table.power_of(dear.place)
    )
    slower = stats.difference(dear.level[:, 2], at)
    text = (
        "of PPO no difference is shown in four of five cases; in the fifth (1024 robots, MJX-JAX) it took"
        f" {few.value:.1f} s less than computed ({few.low:.1f} to {few.high:.1f}). `best` took"
        f" {around(slower, 2, ' s longer with MuJoCo Warp')}"
    )
    assert text in pages["README"] and few.low > 0
    gap, took, other = gaps["go1.warp", "ppo1024", day]
    text = (
        f"would take {took.mean():.1f} s to the level, measured {table.interval(other.level[:, 2])}:"
        f" {gap.value:.1f} s less ({gap.low:.1f} to {gap.high:.1f})."
    )
    assert f"nor with 1024 robots, which by the runs of 2026-11-27 {text}" in pages["computed"]


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
    assert all([x for x in some if x.isdigit()] == [*"123456789"] for some in words)
    some = [sorted(x for x in few if " of " in x) for few in words]
    assert some[:2] == [[], []]
    # ANYmal-C with PPO, the exact Go1 with `best`, then PPO on rough ground and on two cores, `best` with JAX
    assert some[2] == some[3] == ["1 of 5", "2 of 5", *["4 of 5"] * 3]
    even = [text for few in words for text in few if text.startswith("Go1 breaks even")]
    assert even == [
        "Go1 breaks even:\n0.39 ms (0.29 to 0.49)",
        "Go1 breaks even:\n0.88 ms (0.59 to 1.3)",
    ]
    marks = [[line.get_marker() for line in axis.lines] for axis in axes]
    # `best` for seconds; to a walk where all its seeds do
    assert [few.count("^") for few in marks] == [4, 4, 2, 2]
    heights = [
        [line.get_ydata()[0] for line in axis.lines if line.get_marker() == "^"]
        for axis in axes[2:]
    ]
    table = script(f"{ROW_COST}/table")
    run = {(one.place, one.method): one for one in table.runs() if "-" in one.method}
    some = [run["go1.kernel", "best-r2n2048"], run["go1.warp", "best-n2048"]]
    for found, column, unit in zip(heights, (2, 1), (1, 1e6), strict=True):
        expected = [one.walks[:, column].mean() / unit for one in some]
        np.testing.assert_allclose(found, expected)
    never = [("go2.rough", "best-r1e3"), ("g1.kernel", "best-kl4e3")]
    assert all(np.isnan(run[key].walks).any() for key in never)
    assert "below where all seeds walk, so not of 2 and 3." in flat("README")
    assert [few.count(plot.NONE["marker"]) for few in marks] == [0, 0, 1, 1]  # no PPO walks


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
    assert run.end == 40_000 and run.last == np.mean([80, 160, 240])  # of whole runs
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
    assert len({line.split()[0] for line in lines}) == len(lines) == 69
    for line in lines:
        name, job, *fields = line.split()
        place, _, method = name.rpartition(".")
        read = measure.read(job, fields)
        assert place in places and (read.engine == "mujoco_warp") == place.endswith("warp")
        assert 10 <= len(measure.ends(read.config)) <= 36
        uses_model = schedule.uses_model(read.config)
        assert uses_model != method.removeprefix("again-").startswith("ppo")
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

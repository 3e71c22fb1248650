"""30_row_cost: what its pages say of a G1, of rough ground, the exact tasks, MJX-JAX and two cores."""

import re
from functools import partial

import numpy as np
import pytest
from result_files import (
    EXPERIMENTS,
    ROOT,
    ROW_COST,
    around,
    of_host,
    script,
    shows,
)

from experiments import stats


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


def test_what_the_pages_of_seconds_say_of_rough_ground_on_four_hosts_is_so():
    """2026-11-27 and -28: `best`, `best` for seconds and PPO of the same card, and PPO of another host: to
    shares of tiles and to the level, and at the end; what was tried on tuning seeds."""
    table, rough = script(f"{ROW_COST}/table"), script("28_rough/table")
    found = table.runs()
    day, run = "H200, 2026-11-28", {x[1:3]: x for x in found if x.place == "go2.rough"}
    best = run["H200, 2026-11-27, second host", "best"]
    quick, ppo = (run[f"{day}, fifth host", x] for x in ("best-r1e3", "ppo4096"))
    few, other = run[f"{day}, fourth host", "ppo2048"], run[f"{day}, third host", "ppo4096"]
    assert table.fastest(table.variants(found, table.settings(found, "go2.rough")[0])) is quick
    assert [len(x.level) for x in (best, quick, ppo, other, few)] == [5, 5, 5, 5, 1]
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
    last = [column([rows[-1] for rows in of(one)], "seconds").mean() for one in four]
    ends = [crossed(one) for one in four]
    every = [int(of(one)[0][0]["iteration"]) for one in four]
    ms = [
        1e3 * np.mean([float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in of(one)])
        for one in four
    ]
    eighty = [clocks(one, 0.8) for one in four]
    to_80 = [clocks(one, 0.8, "sim_steps") for one in four]

    def ten(some):
        return np.concatenate(some[2:])

    later, more = stats.difference(level[2], level[1]), stats.ratio(steps[2], steps[1])
    default, thirds = stats.ratio(steps[2], steps[0]), stats.ratio(steps[3], steps[0])
    said = {
        "30_row_cost/runs.md": [
            line("80 % of all tiles, s", map(table.interval, eighty)),
            line(
                "first at the level, s (first to last seed)",
                (f"{x.mean():.2f} ({x.min():.2f} to {x.max():.2f})" for x in level),
            ),
            line("the same, M steps", (f"{x.mean() / 1e6:.2f}" for x in steps)),
            line(
                "at the end: of all tiles, s",
                (f"{x.mean():.0f} %, {s:.1f}" for x, s in zip(ends, last, strict=True)),
            ),
            line(
                "evaluated every: iterations, s",
                (
                    f"{n}, {n * x / 1e3:.{2 if n == 25 else 1}f}"
                    for n, x in zip(every, ms, strict=True)
                ),
            ),
            f"PPO is later by {within(later, 's')[:-1]}, Welch's p"
            f" {stats.welch_of(level[2], level[1]):.2f}), for {within(more, 'times the steps')}.",
            f"by {within(stats.difference(eighty[1], eighty[2]), 's on that card')}, and by"
            f" {around(stats.difference(eighty[1], ten(eighty))).replace(' (', ' with all ten runs (')[:-1]},"
            f" p {stats.welch_of(eighty[1], ten(eighty)):.2f}).",
            f"one seed before it was cut off: {few.level[0, 2]:.2f} s, {few.level[0, 1] / 1e6:.1f} M",
            "0.36 ms on the second and fifth hosts, on 2026-11-30",
            f"one of 4096 {ppo.row:.2f} on the fifth, {other.row:.2f} on the third and",
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
        f"took {level[1].mean():.2f} s on 2026-11-28, and on 2026-11-30",
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


def test_what_the_pages_of_seconds_say_of_rough_ground_on_one_host_is_so():
    """2026-11-30: `best` beside PPO that was evaluated about as often in seconds, and with settings for
    seconds beside PPO that was evaluated as often as these; told without a test set before."""
    table, rough = script(f"{ROW_COST}/table"), script("28_rough/table")
    found, batch = table.runs(), "H200, 2026-11-30"
    run = {one.method: one for one in found if one[:2] == ("go2.rough", batch)}
    kept = {name: [*seeds.values()] for name, seeds in of_host(table, batch).items()}

    def of(one):
        return kept[f"go2.rough.{one.method}"]

    def column(rows, name):
        return np.array([float(row[name]) for row in rows])

    def clocks(one, share):
        some = [(column(rows, "seconds"), column(rows, "crossed")) for rows in of(one)]
        return np.array([rough.first(*pair, share) for pair in some])

    def crossed(one, after=np.inf):
        some = [(column(rows, "seconds"), column(rows, "crossed")) for rows in of(one)]
        return 100 * np.array([np.interp(after, *pair) for pair in some])

    def judged(one, every, until=np.inf):
        """Seconds to the level and from when on, `[S, 2]`, by some of the evaluations."""
        some = [
            [x for x in rows if int(x["iteration"]) % every == 0 and float(x["seconds"]) <= until]
            for rows in of(one)
        ]
        return np.array([table.reached(rows)[:, 2] for rows in some])

    def line(label, cells):
        return f"| {label} | " + " | ".join(cells) + " |"

    best, quick, ppo, more = four = [
        run[x] for x in ("best", "best-r1e3", "ppo2048-often", "ppo4096-often")
    ]
    seldom = run["ppo2048"]
    mine, its = table.settings(found, "go2.rough")
    assert mine is best and its == [
        seldom
    ]  # none that was evaluated as often as `best` for seconds
    assert seldom is table.fastest_beside(best, its) and ppo is table.fewest(found, best, its)
    assert {row["commit"][:8] for x in four for rows in of(x) for row in rows} == {"2a51cc3d"}
    assert all(
        [rows[0]["seed"] for rows in of(x)] == [*map(str, range(1100, 1105))] for x in run.values()
    )
    level = [one.level[np.isfinite(one.level[:, 2])] for one in four]
    assert [len(x) for x in level] == [5, 4, 5, 5] and np.isnan(quick.level[0]).all()
    walked = [one.walks[np.isfinite(one.walks[:, 2]), 2] for one in four]
    last = [column([rows[-1] for rows in of(one)], "seconds").mean() for one in four]
    falls = [100 * column([rows[-1] for rows in of(one)], "fell") for one in four]
    every = [int(of(one)[0][0]["iteration"]) for one in four]
    assert every == [50, 25, 25, 25] and int(of(seldom)[0][0]["iteration"]) == 100
    *ms, slow = [
        1e3 * np.mean([float(x[-1]["seconds"]) / int(x[-1]["iteration"]) for x in of(one)])
        for one in (*four, seldom)
    ]
    # "about as often in seconds", and "as often as these"
    gaps = slow / 10, ms[0] / 20, ms[2] / 40
    assert gaps[0] == pytest.approx(gaps[1], rel=0.15)
    assert ms[1] / 40 == pytest.approx(gaps[2], rel=0.15)
    # the same policies, evaluated more seldom
    for rows, often in zip(of(seldom), of(ppo), strict=True):
        at = {row["iteration"]: row for row in often}
        assert all(
            row[key] == at[row["iteration"]][key] for row in rows for key in ("return", "crossed")
        )
    seconds = [one[:, 2] for one in level]
    counted = np.where(np.isnan(quick.level[:, 2]), last[1], quick.level[:, 2])
    sooner = [stats.difference(one, seconds[2]) for one in (seconds[0], seconds[1], counted)]
    steps = [stats.ratio(level[2][:, 1], one[:, 1]) for one in level]
    p = [stats.welch_of(one, seconds[2]) for one in seconds[:2]]
    as_best = [judged(one, 50, last[0]) for one in (ppo, more)]
    assert all(np.isfinite(some).all() for some in as_best)
    good = [[sum(rough.at_level(rough.shares(row)) for row in x) for x in of(one)] for one in four]
    assert {len(rows) for one in (ppo, more) for rows in of(one)} == {60} and len(
        of(quick)[0]
    ) == 36
    then = [crossed(one, last[1]) for one in (ppo, more, quick)]
    late = [crossed(one, last[0]) for one in (ppo, more, best)]
    for some in then[:2]:
        gap = stats.difference(some, then[2])
        assert gap.low < 0 < gap.high  # "no difference is shown"
    before = {x[1:3]: x for x in found if x.place == "go2.rough"}
    older = before["H200, 2026-11-28, fifth host", "best-r1e3"].level[:, 2]
    usual = before["H200, 2026-11-27, second host", "best"].level[:, 2]
    days = stats.difference(seconds[1], older), stats.difference(usual, seconds[0])
    assert all(gap.low < 0 < gap.high for gap in days)
    three = [*zip(level[:2], four[:2], strict=True), (seldom.level, seldom)]
    rows = [(one[:, 1] / x.robots).mean() for one, x in three]
    rest = [
        np.mean((1e3 * one[:, 2] - one[:, 1] / x.robots * x.row) / one[:, 0]) for one, x in three
    ]
    own = table.cost(found, best)
    even = [table.break_even(best, its, own, x) for x in (table.power_of("go2.rough"), 1.0)]
    for_it = table.for_seconds(found, table.fastest(table.variants(found, best)), its)
    for_it = for_it.removeprefix("; for seconds ")
    updates = 3 * float(of(best)[0][0]["ppo_ms"]), float(of(quick)[0][0]["ppo_ms"])
    means, eighty = [x.mean() for x in seconds], [clocks(x, 0.8).mean() for x in four]
    costs = [x.row for x in run.values() if x.robots == 2048]
    never = crossed(quick)[0]
    words = ["", "; one of five never"]
    cells = [
        f"{x.mean():.2f} ({x.min():.2f} to {x.max():.2f}{words[len(x) == 4]})" for x in seconds
    ]
    ratio = stats.ratio(seconds[2], seconds[0])
    late_ratio = stats.ratio(seldom.level[:, 2], seconds[0])
    apart = [
        (int(of(x)[0][1]["sim_steps"]) - int(of(x)[0][0]["sim_steps"])) / 1e6 for x in (ppo, best)
    ]
    both = [table.at_cost(found, x, own) for x in (ppo, more)]
    oftener = [table.break_even(best, both, own, x) for x in (table.power_of("go2.rough"), 1.0)]
    late_gap = stats.difference(seconds[0], seldom.level[:, 2])
    late_p, late_mean = (
        f(seldom.level[:, 2]) for f in (partial(stats.welch_of, seconds[0]), np.mean)
    )
    as_often = "Judged about as often in seconds"
    said = {
        "30_row_cost/README.md": [
            f"With our kernel, {own:.2f} ms, a Go2 is at its level after {means[0]:.1f} s with `best`."
            f" {as_often} (every {gaps[0]:.1f} s; `best` every {gaps[1]:.1f}), PPO with 2048 robots on that"
            f" host takes {late_mean:.2f} s, {around(late_ratio, 2, ' times as long')}. Judged about as often"
            f" in steps (every {apart[0]:.1f} M; `best` every {apart[1]:.1f}) it needs"
            f" {around(steps[0], words=' times the steps')}, and is there after {means[2]:.2f} s,"
            f" {around(ratio, 2, ' times')}.",
            f"`best` takes {means[1]:.1f} s, and one of five seeds does not get there. PPO,"
            f" evaluated as often as these ({gaps[2]:.1f} s), is in the mean"
            f" {around(sooner[1], words=' s before the other four')[:-1]}, p {p[1]:.3f}, not corrected, no"
            f" rule before), for {around(steps[1], words=' times the steps')}. On another host all five got"
            f" there, [after {older.mean():.1f} s]",
            "On rough ground, 0.3 ms, PPO is sooner than `best`, and in the mean sooner than settings of it"
            f" for seconds ({sooner[1].value:.1f} s, p {p[1]:.3f}, uncorrected, no rule before).**",
            f"On the host of its row's PPO ({means[2]:.2f} s, evaluated as often) one of five seeds of",
            f"counted as they were, it would favour `best` ({walked[0].mean():.1f} s; PPO with 4096 robots"
            f" {walked[3].mean():.1f}).",
            "`best-r1e3` gets to the level on nine of ten runs of two days.",
        ],
        "30_row_cost/runs.md": [
            *(
                line(label, [table.interval(clocks(one, share)) for one in four])
                for label, share in (("70 % of all tiles, s", 0.7), ("80 %", 0.8))
            ),
            line("first at the level, s (first to last seed)", cells),
            line("the same, M steps", [f"{x[:, 1].mean() / 1e6:.2f}" for x in level]),
            line(
                "at the level at the end, and from when on: seeds, s",
                [f"{len(x)}, {x.mean():.2f}" for x in walked],
            ),
            line(
                "at the end: of all tiles, s",
                [f"{crossed(x).mean():.0f} %, {s:.1f}" for x, s in zip(four, last, strict=True)],
            ),
            line("falls at the end (seeds)", [f"{x.min():.0f} to {x.max():.0f} %" for x in falls]),
            line(
                "evaluated every: iterations, s",
                [
                    f"{n}, {n * x / 1e3:.{1 if n == 50 else 2}f}"
                    for n, x in zip(every, ms, strict=True)
                ],
            ),
            line("an iteration, ms", [f"{x:.1f}" for x in ms]),
            f"{as_often} (`ppo2048`, every {gaps[0]:.1f} s; `best` every {gaps[1]:.1f}) it takes"
            f" {late_mean:.2f} s ({seldom.level[:, 2].min():.2f} to {seldom.level[:, 2].max():.2f}):"
            f" {around(late_gap, words=' s less')[:-1]}, p {late_p:.3f}),"
            f" {around(late_ratio, 2, ' times the seconds')}. Judged about as often in steps"
            f" (`ppo2048-often`, the same policies, every {apart[0]:.1f} M and {gaps[2]:.1f} s; `best` every"
            f" {apart[1]:.1f} M) it needs {around(steps[0], words=' times the steps')}, and is there after"
            f" {means[2]:.2f} s: {around(sooner[0], words=' less')[:-1]}, p {p[0]:.3f}),"
            f" {around(ratio, 2, ' times')}.",
            f"by {around(sooner[1], words=' s')[:-1]}, p {p[1]:.3f}, not corrected), for"
            f" {around(steps[1], words=' times the steps')}.",
            f"With it counted up to its end it is {around(sooner[2], words=' s')}.",
            f"take {around(stats.difference(seconds[3], seconds[2]), 2, ' s longer than 2048')[:-1]}; their"
            " first two seeds were the slower ones, see above), for"
            f" {around(stats.ratio(level[3][:, 1], level[2][:, 1]), words=' times the steps')}.",
            "cross"
            f" {around(stats.difference(crossed(more), crossed(ppo)), words=' points more of all tiles')},"
            f" and are then {last[3] - last[2]:.1f} s older.",
            f"at it in {min(good[2])} to {max(good[2])} of 60 evaluations, with 4096 in {min(good[3])} to"
            f" {max(good[3])}, `best-r1e3` in {min(good[1])} to {max(good[1])} of 36.",
            f"Judged every 50 iterations ({ms[2] / 20:.1f} and {ms[3] / 20:.1f} s) and to the end of `best`,",
            "PPO stays from {:.1f} (2048) and {:.1f} s (4096) on, `best` from {:.1f} on.".format(
                *(x[:, 1].mean() for x in as_best), walked[0].mean()
            ),
            f"the {last[1]:.1f} s of `best-r1e3` PPO with 2048 robots crosses {then[0].mean():.0f} % and"
            f" with 4096 {then[1].mean():.0f} %, it {then[2].mean():.0f}: no difference is shown. After the"
            f" {last[0]:.1f} s of `best` it is {late[0].mean():.0f} and {late[1].mean():.0f} %, of `best`"
            f" {late[2].mean():.0f}.",
            f"nine get to the level; it takes {around(days[0], 2, ' s longer on 2026-11-30')[:-1]}, four and"
            f" five seeds), and `best` {around(days[1], 2, ' less')}.",
            f"on 2026-11-30 {min(costs):.2f} to {max(costs):.2f};",
            f"on the third and {more.row:.2f} on 2026-11-30.",
        ],
        "30_row_cost/computed.md": [
            f"at {own:.2f} ms, it would be {around(even[0], 2, ' ms on a Go2')}, beside PPO with 2048 robots"
            " on that host, judged about as often in seconds at that cost;",
            f"{around(even[1], 2)} if a row costs as its robots do. Beside PPO with 2048 and 4096 robots,"
            f" judged every {gaps[2]:.1f} and {25e-3 * ms[3]:.1f} s, it would be {around(oftener[0], 2)},"
            f" and {around(oftener[1], 2)} so.",
            f"`best` for seconds would be ahead from {for_it.replace(' (', ' ms on (')}",
            "needs {:.0f} rows of 2048 robots with `best`, {:.0f} with `best` for seconds (four of five"
            " seeds) and {:.0f} with PPO.".format(*rows),
            "All else takes {:.1f} ms an iteration of {:.0f}, {:.1f} of {:.0f}, and {:.1f} of {:.0f}.".format(
                *np.ravel([(x, one[:, 0].mean()) for x, (one, _) in zip(rest, three, strict=True)])
            ),
            "Of `best` three updates take {:.0f} of it, of `best` for seconds its one {:.1f}.".format(
                *updates
            ),
        ],
        "30_row_cost/settings.md": [
            f"on 2026-11-30 {means[1]:.2f} s, one of five seeds never, where `best` took {means[0]:.2f} and"
            f" PPO, evaluated as often as these, {means[2]:.2f}: [sooner in the mean](runs.md#rough-ground),"
            f" by {sooner[1].value:.1f} s (p {p[1]:.3f}, uncorrected, no rule before).",
        ],
        "28_rough/README.md": [
            f"Alone on an H200 a Go2 is first at the level after {means[0]:.1f} s of training, PPO with 2048"
            f" robots, judged about as often in seconds, after {late_mean:.2f}; judged about as often in"
            f" steps it needs {around(steps[0], words=' times the steps')}. With settings for seconds `best`"
            f" takes {means[1]:.1f} s on that host, and one of five seeds does not get there: PPO, evaluated"
            f" as often as these, is in the mean {around(sooner[1], words=' s before the other four')}, for"
            f" {around(steps[1], words=' times the steps')}.",
        ],
        "28_rough/time.md": [
            f"with `best` a Go2 takes {eighty[0]:.1f} s for 80 % of tiles and {means[0]:.1f} to the level,"
            f" {last[0]:.1f} for the whole run; with one round, three epochs and a KL of 0.03 it takes"
            f" {eighty[1]:.1f}, {means[1]:.1f} (four of five seeds) and {last[1]:.1f}; with PPO and 2048"
            f" robots {eighty[2]:.1f}, {means[2]:.1f} ({late_mean:.2f} judged about as often in seconds as"
            f" `best`) and {last[2]:.1f}, with 4096 {eighty[3]:.1f},"
            f" {means[3]:.1f} and {last[3]:.1f}.",
            f"takes {ms[0]:.1f} ms, {updates[0]:.0f} of them three updates; with one round and three epochs"
            f" {ms[1]:.1f}, {updates[1]:.1f} of them its one; one of PPO with 2048 robots {ms[2]:.1f},"
            f" {float(of(ppo)[0][0]['ppo_ms']):.1f} of them its one",
        ],
        "../docs/results.md": [
            f"a Go2 on rough ground from {even[1][0]:.2f} to {oftener[0][0]:.1f}, by what more robots cost"
        ],
    }
    assert f"{never:.0f}" == "80" and all(one.low > 0 for one in sooner)
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
    newest = "H200, 2026-11-30"
    its = [run["go1.warp", newest, method].walks[:, 2] for method in ("ppo2048", "best")]
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
        f" {stats.welch_of(*its):.4f}), and {around(walk, words=' times on a G1').removesuffix(')')}; of the"
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
    text = "On `go1.jax` PPO takes {:.2f} s, not the {:.2f} of another host."
    assert text.format(*both) in pages["README"]
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


def test_what_the_pages_say_of_ten_new_seeds_on_two_cores_is_so():
    """By the rule set before them: one Welch test of the seconds to the level, `best` beside PPO."""
    table, batch = script(f"{ROW_COST}/table"), "two cores, 2026-11-29"
    run = {one.method: one for one in table.runs() if one[:2] == ("go1.laptop", batch)}
    best, ppo = run["best"], run["ppo512"]
    jobs = of_host(table, batch)
    asked = dict(
        line.split(maxsplit=1)
        for line in (EXPERIMENTS / ROW_COST / "jobs.txt").read_text().splitlines()
    )
    for method in ("best", "ppo512"):
        seeds = jobs[f"go1.laptop.again-{method}"]
        assert [*map(int, seeds)] == [*range(1110, 1120)]
        for seed, rows in seeds.items():
            half = "new" if int(seed) < 1115 else "newer"
            assert {row["job"] for row in rows} == {asked[f"go1.laptop.{half}-{method}"]}
            assert {row["commit"] for row in rows} == {"215ed131133c"}
    seconds = [one.level[:, 2] for one in (ppo, best)]
    less, longer = stats.difference(*seconds), stats.ratio(*seconds)
    more = stats.ratio(ppo.level[:, 1], best.level[:, 1])
    p = stats.welch_of(*seconds)
    pages = {
        name: " ".join((EXPERIMENTS / name).read_text().split())
        for name in (
            f"{ROW_COST}/README.md",
            f"{ROW_COST}/runs.md",
            "04_laptop/README.md",
            "README.md",
        )
    }
    pages |= {name: " ".join((ROOT / name).read_text().split()) for name in ("docs/results.md",)}
    front = " ".join((ROOT / "README.md").read_text().split())
    times = f"{longer.value:.2f} times as long ({longer.low:.2f} to {longer.high:.2f}"
    steps = f"{more.value:.1f} times the steps ({more.low:.1f} to {more.high:.1f})"
    both = [one.mean() for one in seconds]
    text = (
        "A Go1 takes {1:.1f} s with `best` of `:laptop` and {0:.1f} with PPO with as many robots:"
    )
    text = f"{text.format(*both)} {times}, p {p:.3f}), for {steps}."
    assert text in pages[f"{ROW_COST}/README.md"]
    found = table.runs()
    cost = table.cost(found, best)
    even = "{:.0f} ms ({:.0f} to {:.0f}; computed".format(
        *table.break_even(best, [ppo], cost, table.POWERS["two cores"])
    )
    page = pages[f"{ROW_COST}/README.md"]
    assert (
        f"cores**, {cost:.0f} ms a row" in page and f"By these it breaks even at {even})." in page
    )
    runs_page = pages[f"{ROW_COST}/runs.md"]
    assert f"by these ten seeds is {even}" in runs_page
    text = f"after {both[1]:.1f} instead of {both[0]:.1f} s, {less.value:.1f} s fewer ({less.low:.1f} to"
    text += f" {less.high:.1f}, p {p:.3f}). PPO takes {times}), for {steps}."
    assert text in runs_page
    line, ms = {}, {}
    for method in ("best", "ppo512"):
        line[method], ms[method] = [], []
        for rows in jobs[f"go1.laptop.again-{method}"].values():
            back, clock = ([float(row[key]) for row in rows] for key in ("return", "seconds"))
            k = next(i for i, value in enumerate(back) if value >= 38)
            line[method].append(np.interp(38, back[k - 1 : k + 1], clock[k - 1 : k + 1]))
            ms[method].append(1e3 * clock[k] / int(rows[k]["iteration"]))
    text = "Read off a line between evaluations it is {:.1f} and {:.1f} s."
    assert text.format(*(np.mean(x) for x in line.values())) in runs_page
    text = "an iteration of `best` took {:.0f} to {:.0f} ms, of PPO {:.0f} to {:.0f},"
    assert text.format(*(f(x) for x in ms.values() for f in (min, max))) in runs_page
    halves = [stats.difference(*(x[some] for x in seconds)) for some in (slice(5), slice(5, 10))]
    text = "{:.1f} s fewer with the first five seeds ({:.1f} to {:.1f}),".format(*halves[0])
    value, low, high = halves[1]
    text += f" {value:.1f} with the others ({high:.1f} fewer to {-low:.1f} more)."
    assert text in runs_page
    walks = [one.walks[:, 2] for one in (best, ppo)]
    assert [np.isfinite(x).sum() for x in walks] == [9, 10]
    value, low, high = stats.difference(*walks[::-1])
    text = (
        f"Nine of ten walk with `best`, after {np.nanmean(walks[0]):.1f} s, with PPO all ten, after"
    )
    text += f" {walks[1].mean():.1f}: {value:.1f} s later ({-low:.1f} sooner to {high:.1f} later)."
    assert text in runs_page and low < 0 < high
    assert int(jobs["go1.laptop.again-best"]["1110"][-1]["iteration"]) == 252
    text = "On two CPU cores a Go1 takes {1:.1f} s with `best` and {0:.1f} with PPO with as many robots,"
    assert f"{text.format(*both)} {times}; ten seeds each)." in pages["docs/results.md"]
    text = "beside PPO with as many robots: {1:.1f} instead of {0:.1f} s, {2:.2f} times as long without it"
    text = text.format(*both, longer.value) + f" ({longer.low:.2f} to {longer.high:.2f}).**"
    assert text in pages["04_laptop/README.md"]
    told = f"takes {longer.value:.2f} times as long to its level ({longer.low:.2f} to {longer.high:.2f},"
    assert f"PPO with as many robots {told} ten seeds)" in pages["README.md"]
    assert (
        f"44 ms, PPO with as many robots takes {longer.value:.2f} times as long until a Go1"
        in front
    )
    text = f"On two CPU cores PPO takes {longer.value:.2f} times as long to follow commands "
    assert (
        f"{text}({longer.low:.2f} to {longer.high:.2f}); of walks no difference is shown." in front
    )
    text = f"({longer.value:.2f} times as long, {longer.low:.2f} to {longer.high:.2f}); to a walk"
    assert text in " ".join((ROOT / "docs/speed.md").read_text().split())


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
    mine, its = table.settings(found, "go1.laptop")
    assert {x.batch for x in (mine, *its)} == {"two cores, 2026-11-29"} and len(mine.level) == 10
    assert table.fewest(found, mine, its) is few and table.fastest([many, few]) is many
    more = stats.ratio(few.level[:, 1], mine.level[:, 1])
    apart = [
        k * one.robots * 24 / 1e6 for k, one in ((40, few), (18 / 3, mine))
    ]  # 8 of 24 rows are real
    text = f"the row of README.md has {more.value:.1f} times the steps ({more.low:.1f} to {more.high:.1f})."
    of_one_day = stats.ratio(few.level[:, 1], best.level[:, 1])
    told = f"The ratio of `go1.laptop` is of two days, and PPO was evaluated every {apart[0]:.2f} M steps,"
    told += f" `best` every {apart[1]:.2f}; on one day it is {around(of_one_day, 2)}."
    assert told in pages["README"]
    text += (
        f" That may be too much: `ppo256` was evaluated every {apart[0]:.2f} M steps, `best` every"
    )
    assert f"{text} {apart[1]:.2f}." in pages["runs"]

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
        f" {around(stats.difference(seconds[2], seconds[0]), words=' s more')}, 1.2 times as long",
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
    assert [f"{x.value:.1f}" for x in longer] == ["1.1", "1.2"] and all(x.low < 1 for x in longer)
    text = "{:.1f} s with `best`, {:.1f} with PPO, and {:.1f} with PPO with 256 robots and its settings of"
    text += f" the GPU. That one needs {fewer.format(*ratios[1])}: beside"
    assert (
        f"{text.format(*(x.mean() for x in seconds))} it fewer steps are not shown,"
        in pages["README"]
    )
    gap = around(stats.difference(*seconds[1::-1]), words=" more than `best`")
    text = f"PPO takes {seconds[1].mean():.1f} s, {gap}, 1.1 times as long"
    text += " ({:.2f} to {:.1f}), for 1.8 times the steps ({:.1f} to {:.1f})."
    assert text.format(*longer[0][1:], *ratios[0][1:]) in pages["runs"]
    text = "1.2 times as long ({:.2f} to {:.1f}), for".format(*longer[1][1:])
    assert f"{text} {fewer.format(*ratios[1])}" in pages["runs"]
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
        + " PPO that ran then the tail is not shown to save"
    )
    text += " steps, nor seconds: {:.1f} s with it and {:.1f} without, {:.1f} s more ({:.1f} to {:.1f})."
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

"""21_less/falls.md: when robots fall, and what was tried."""

import csv

import numpy as np
from result_files import LESS, LETTERS, cells, less

from experiments import stats


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

"""experiments/README.md: what is new, by the runs that it names."""

import numpy as np
from result_files import EXPERIMENTS, cells, few_fresh, few_of, script

from experiments import stats

PAGE = (EXPERIMENTS / "README.md").read_text()
TEXT = " ".join(PAGE.split())


def runs():
    """Label -> rows of each seed, of a Go1."""
    table, fresh = script("21_less/table"), script("24_off_policy/fresh")
    jobs = table.read(EXPERIMENTS / "21_less/results/headline.csv.xz")
    found = {name: table.seeds(jobs[f"{name}-g"]) for name in ("best", "ppo-level", "ppo-walk")}
    found["few"], _ = few_fresh("g")
    for count in (64, 256):
        name = f"crossq-{count}-symmetric"
        found[name] = fresh.runs_of(fresh.RUNS, name)
    return found


def falls_then(some):
    """% of episodes with a fall where each run is first at the level."""
    first = [next(row for row in run if row["return"] >= 38) for run in some]
    return 100 * np.mean([row["fall_rate"] for row in first])


def test_steps_falls_and_walks_of_a_go1_are_those_of_the_runs():
    """Level, falls then, walk and seeds: all that DESIGN asks for beside a number of steps."""
    table, of = script("21_less/table"), runs()
    rows = [
        cells(line) for line in PAGE.split("## Does the paper")[0].splitlines() if line[:1] == "|"
    ]
    assert len(rows) == 2 + 4
    second = table.reached(of["ppo-walk"], 38).level.mean() / 1e6
    assert f"(the second is at the level after {second:.2f} M)" in rows[-1][0]
    for row, (level, walk, unit, digits) in zip(
        rows[2:],
        (
            ("few", "few", 1e3, 1),
            ("crossq-256-symmetric", "crossq-256-symmetric", 1e6, 2),
            ("best", "best", 1e6, 2),
            ("ppo-level", "ppo-walk", 1e6, 2),
        ),
        strict=True,
    ):
        name = "k" if unit == 1e3 else "M"
        first = table.reached(of[level], 38).level
        walks = table.reached(of[walk], 38).walks
        there = ~np.isnan(walks)
        told = f"{np.nanmean(walks) / unit:.{digits if unit == 1e6 else 0}f} {name}"
        if not there.all():
            told += f", {there.sum()} of {len(walks)}"
        seeds = str(len(of[level])) if level == walk else f"{len(of[level])}, {len(of[walk])}"
        assert not np.isnan(first).any()
        assert row[1:] == [
            f"{first.mean() / unit:.{digits}f} {name}",
            f"{falls_then(of[level]):.1f} %",
            told,
            seeds,
        ]


def test_what_is_said_of_few_and_crossq_beside_it_is_so():
    table, of = script("21_less/table"), runs()
    level = {name: table.reached(some, 38).level for name, some in of.items()}
    crossq = stats.ratio(level["crossq-256-symmetric"], level["best"])
    many = stats.ratio(level["crossq-256-symmetric"], few_of("default", "default-g")[1].level)
    told = "It needs {:.2f} times the steps of `best` ({:.2f} to {:.2f}), {:.1f} times those of `few` with"
    assert (told + " 256 robots ({:.1f} to {:.1f})").format(*crossq, *many) in TEXT
    readme = " ".join((EXPERIMENTS.parent / "README.md").read_text().split())
    told = "{:.2f} times the steps of `best` ({:.2f} to {:.2f}, five seeds), and does not fall then"
    assert told.format(*crossq) in readme and falls_then(of["crossq-256-symmetric"]) == 0
    sixty = stats.ratio(level["crossq-64-symmetric"], level["few"])
    assert f"and {sixty.value:.1f} times with 64 ([{sixty.low:.1f} to {sixty.high:.1f}]" in TEXT
    walk = [(~np.isnan(few_fresh(letter)[1].walks)).sum() for letter in "gc"]
    assert "walks by 44 thousand on {} and {} of 30 seeds".format(*walk) in TEXT


def test_rows_on_short_tails_falls_and_symmetry_have_the_numbers_of_their_pages():
    """Those of tables that test_collapse.py and test_less_model.py hold against the runs."""
    collapse, model, paper_page = (
        (EXPERIMENTS / x).read_text()
        for x in ("19_collapse/README.md", "21_less/model.md", "paper/README.md")
    )

    def row_of(page, start):
        return next(cells(line) for line in page.splitlines() if line.startswith(start))

    falls = row_of(collapse, "| `dose16-falls` | `rows8` | Go1 ")
    end, more, holm = falls[4].split(",")[0], falls[6].split(" ")[0].strip("+"), falls[7]
    verdict, other = (row_of(x, "| tails must be short") for x in (PAGE, paper_page))
    assert f"16 of 24 end at {end} of 45 on a Go1" in verdict[2] and f"at {end} of 45" in other[2]
    assert f"{more} more than its real rows alone, Holm {holm}" in verdict[4]
    assert f"{more} more than their real rows alone (Holm {holm})" in other[2]
    for job in ("dose4", "dose8"):  # no harm shown
        for robot in ("Go1", "ANYmal-C"):
            shown = [
                line
                for line in collapse.splitlines()
                if line.startswith(f"| `{job}` | `rows") and f"| {robot} |" in line
            ]
            assert shown and not any("worse" in line for line in shown), (job, robot)
    whole, without, none = (
        row_of(model, f"| {x} |")
        for x in ("(all parts)", "symmetric policy", "predicted falls (`model.falls`)")
    )
    assert all(cell.split("; ")[1] == "never" for cell in none[1:])
    for page in (PAGE, paper_page):
        assert "no robot is at its level" in row_of(page, "| on flat ground falls")[2]
        told = "{}, {}, {} and {} instead of {}, {}, {} and {} M".format(
            *(cell.split("; ")[1] for line in (without, whole) for cell in line[1:])
        )
        assert told in row_of(page, "| symmetry can be used")[2]

"""05_playground and 02_brax: tasks of others, beside brax."""

import contextlib
import csv
import io
import lzma
import re

import jax
import numpy as np
import pytest
from result_files import EXPERIMENTS, script

from dynappo import config as config_lib

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
    assert drawn == ["falls", "curves"]
    assert all((EXPERIMENTS / PLAYGROUND / f"{name}.png").exists() for name in drawn)


def test_getup_ends_no_episode_as_the_caption_of_the_falls_says():
    found = script(f"{PLAYGROUND}/table").runs()
    fell = {task: False for task, _ in found}
    for (task, _), some in found.items():
        fell[task] |= any(float(row["fall_rate"]) > 0 for rows in some for row in rows)
    assert [task for task, any_ in fell.items() if not any_] == ["Go1Getup"]
    ends = {"best": [], "brax": [], "ppo": []}
    for (task, kind), some in found.items():
        if task.startswith(("G1", "Berkeley", "T1", "H1", "Apollo")):
            ends.get(kind.rstrip("12"), []).extend(
                100 * float(rows[-1]["fall_rate"]) for rows in some
            )
    told = [f"{min(x):.0f} to {max(x):.0f} %" for x in ends.values()]
    page = " ".join((EXPERIMENTS / PLAYGROUND / "README.md").read_text().split())
    assert "with `best` {}, with brax's PPO {}, our PPO {}.*".format(*told) in page


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

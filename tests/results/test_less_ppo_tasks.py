"""21_less/ppo_tasks.md: PPO tuned on the task for hardware and on the exact one."""

import functools
import math
import re

import numpy as np
import pytest
from result_files import (
    DEPLOY,
    EXPERIMENTS,
    LESS,
    LETTERS,
    ROOT,
    ROW_COST,
    cells,
    less,
    packed,
    reached_of,
    script,
)

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats

ROBOT_OF = {letter: robot for robot, letter in LETTERS.items()}
PAGE = LESS / "ppo_tasks.md"
# the page's words for what a name of ppo_deploy.txt says
SETTINGS = {
    "256-kl3": "256 robots, KL 0.03",
    "128-kl3": "128 robots",
    "128-kl5": "128 robots, KL 0.05",
    "512-kl3": "512 robots",
    "256-kl2": "KL 0.02",
    "256-kl4": "KL 0.04",
    "256-kl5": "KL 0.05",
    "256-kl3-gamma98": "gamma 0.98",
    "256-kl3-lam95": "lambda 0.95",
    "256-kl3-ep10": "10 epochs",
    "256-kl3-mb8": "8 minibatches",
}
ASKED = {"g": 30, "h": 30, "c": 15, "d": 15}  # the return that the grid's table is of


@functools.cache
def part(title, level="##"):
    """A section's text, without its first line."""
    return PAGE.read_text().split(f"\n{level} {title}\n")[1].split(f"\n{level} ")[0]


def words(text):
    return " ".join(text.split())


@functools.cache
def grid():
    return less("ppo")[0].read(LESS / "results/ppo.csv.xz", "9")


@functools.cache
def of_fresh(letter):
    """The three that are compared: PPO, `deploy`, longer tails."""
    table, _ = less("ppo")
    ppo = table.read(LESS / "results/ppo_tasks.csv.xz", "deploy")
    tails = table.read(DEPLOY / "fewer.csv.xz", "fresh")
    return (
        next(job for name, job in ppo.items() if name.endswith(f"-{letter}")),
        tails[f"fresh-deploy-{letter}"],
        tails[f"fresh-1024-{letter}"],
    )


def test_the_table_of_eleven_settings_for_hardware_is_that_of_their_runs():
    """Each job of ppo_deploy.txt, to its end; and what choose.py takes by the rule."""
    choose, (table, _) = script("21_less/choose"), less("ppo")
    asked = paper.jobs(LESS / "ppo_deploy.txt")
    assert asked.keys() == grid().keys() == {f"deploy-{n}-{x}" for n in SETTINGS for x in "ghcd"}
    text = part("Eleven settings", "###").split("\n### ")[0]
    shown = [cells(line) for line in text.splitlines() if line.startswith("| ")][1:]
    rows = []
    for name, label in SETTINGS.items():
        row = [label]
        for x, level in ASKED.items():
            job = grid()[f"deploy-{name}-{x}"]
            assert job[0]["job"] == asked[f"deploy-{name}-{x}"] and len(table.seeds(job)) == 3
            assert job[-1]["sim_steps"] == 9216000 and job[0]["commit"].startswith("23049457")
            steps = reached_of(job, level) / 1e6
            there = int(np.isfinite(steps).sum())
            end = np.mean([run[-1]["return"] for run in table.seeds(job)])
            first = f"{np.nanmean(steps):.2f} ({there})" if there else "none"
            row.append(f"{first}; {end:.1f}")
        rows.append(row)
    assert shown == rows
    cost = {n: choose.cost(job, "level", (30, 20)) for n, job in grid().items()}
    best = {x: min((n for n in cost if n[-1] == x), key=cost.get) for x in "ghcd"}
    assert (best["g"], best["h"]) == ("deploy-256-kl3-g", "deploy-256-kl3-gamma98-h")
    assert (
        "takes** 256 robots and a KL of 0.03 on a Go1, the same with gamma 0.98 on a Go2"
        in words(text)
    )
    for x in "cd":  # all tie
        assert not any(
            choose.arrive(grid()[f"deploy-{n}-{x}"], "level", (30, 20)) for n in SETTINGS
        )
        assert len({cost[f"deploy-{n}-{x}"] for n in SETTINGS}) == 1
        assert of_fresh(x)[0][0]["name"] == f"level-deploy-128-kl3-{x}"
    lasts = [
        reached_of(job, 30 if n[-1] in "gh" else 20).max() / 1e6
        for n, job in grid().items()
        if np.isfinite(reached_of(job, 30 if n[-1] in "gh" else 20)).all()
    ]
    assert min(lasts) > 4 and len(lasts) == 2
    told = "two are there on all three, both on a Go1, the last seeds after {:.2f} and {:.2f} M."
    assert told.format(*sorted(lasts)) in words(text)


def test_that_a_robot_of_which_none_gets_there_gets_no_setting(tmp_path, monkeypatch, capsys):
    """All tie there; the others' jobs are the same seeds of the best, as often and twice as long."""
    choose = script("21_less/choose")
    given = [
        str(LESS / "results/ppo.csv.xz"),
        str(LESS / "ppo_deploy.txt"),
        str(tmp_path / "fresh.txt"),
    ]
    flags = "--level --returns 30 20 --seed 1600 --episodes 200 --as-often".split()
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    said = capsys.readouterr().out
    for robot in ("anymal_c", "anymal_d"):
        assert f"{robot}:deploy: no seed of any setting gets there, so none is chosen\n" in said
    found = paper.jobs(tmp_path / "fresh.txt")
    assert list(found) == ["level-deploy-256-kl3-g", "level-deploy-256-kl3-gamma98-h"]
    assert all(found[of_fresh(x)[0][0]["name"]] == of_fresh(x)[0][0]["job"] for x in "gh")
    # the jobs of the ANYmals, by 15, twice as long
    flags = "--level --returns 30 15 --seed 1600 --episodes 200 --as-often --times 2".split()
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    found = paper.jobs(tmp_path / "fresh.txt")
    longer = paper.jobs(LESS / "ppo_deploy_longer.txt")
    assert {
        n.replace("level", "longer", 1): job for n, job in found.items() if n[-1] in "cd"
    } == longer
    for line in longer.values():
        config = config_of(line)
        assert f"{schedule.sim_steps(config)[-1] / 1e6:.1f}" == "18.4" and config.run.seed == 1600
    told = "256 robots with gamma 0.98 on an ANYmal-C and 512 robots on an ANYmal-D"
    assert list(longer) == ["longer-deploy-256-kl3-gamma98-c", "longer-deploy-512-kl3-d"]
    assert told in words(PAGE.read_text())


def config_of(line):
    job, *fields = line.split()
    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    for field in fields:
        config_lib.override(config, *field.split("=", 1))
    return config_lib.validate(config)


def test_a_choice_from_two_places_is_one_of_all_their_runs(tmp_path, monkeypatch, capsys):
    """`--also`: the same answer as from the whole file."""
    choose = script("21_less/choose")
    jobs = tmp_path / "jobs.txt"
    jobs.write_text("".join(x for x in open(LESS / "ppo_deploy.txt") if x.split()[0][-2:] == "-g"))
    folder, whole = tmp_path / "some", LESS / "results/ppo.csv.xz"
    folder.mkdir()
    (folder / "deploy-128-kl3-g.csv").write_text("job,seed,sim_steps,return,fall_rate,early\n")
    answers = []
    rows = grid()["deploy-256-kl3-g"]
    text = "job,seed,sim_steps,return,fall_rate,early\n" + "".join(
        f"{r['job']},{r['seed']},{r['sim_steps']},{r['return']},{r['fall_rate']},0\n" for r in rows
    )
    (folder / "deploy-128-kl3-g.csv").unlink()
    (folder / "deploy-256-kl3-g.csv").write_text(text)
    for more in ([str(whole)], [str(folder), "--also", str(whole)]):
        out = tmp_path / "fresh.txt"
        words = [
            "choose.py",
            more[0],
            str(jobs),
            str(out),
            "--level",
            "--returns",
            "30",
            "20",
            *more[1:],
        ]
        monkeypatch.setattr("sys.argv", words)
        choose.main()
        answers.append((out.read_text(), capsys.readouterr().out))
    assert answers[0] == answers[1]
    monkeypatch.setattr("sys.argv", ["choose.py", str(folder), str(jobs), str(out), "--level"])
    with pytest.raises(SystemExit, match="lacks deploy-128-kl3-g"):
        choose.main()


def test_the_tables_of_ppo_for_hardware_on_fresh_seeds_are_those_of_their_runs():
    """PPO's ten beside five of `deploy` and five with longer tails."""
    table, _ = less("ppo")
    text = part("On fresh seeds", "###").split("\n### ")[0]
    shown = [cells(line) for line in text.splitlines() if line.startswith(("| Go", "| ANY"))]

    def at(job, millions):
        back, fell = (table.between(job, millions * 1e6, c) for c in ("return", "fall_rate"))
        return f"{table.spread(back)}, {100 * fell.mean():.1f} %"

    rows = []
    ppo = {"g": "PPO, 256 robots", "h": "PPO, 256 robots, gamma 0.98"}
    for x in "ghcd":
        levels = (20, 30, 35) if x in "gh" else (15, 20)
        labels = ppo.get(x, "PPO, 128 robots"), "`deploy`", "longer tails"
        for label, job in zip(labels, of_fresh(x), strict=True):
            runs = table.seeds(job)
            row = [f"{ROBOT_OF[x]}, {label}", str(len(runs))]
            row += [table.steps_of([table.first(run, level) for run in runs]) for level in levels]
            rows.append([*row, at(job, 1.8), at(job, 9.2)])
    assert shown == rows
    # to 30
    told, all_p = words(PAGE.read_text()), []
    ratios = {}
    for x in "gh":
        its, *ours = (reached_of(job, 30) for job in of_fresh(x))
        assert len(its) == 10
        for mine in ours:
            assert len(mine) == 5 and mine.max() < np.nanmin(its)
            all_p.append(stats.rank_sum(its, mine))
        if x == "g":
            ratios = [stats.ratio(its, mine) for mine in ours]
            mean = its.mean() / 1e6
    # all of ten after all of five; ties make some of these smaller
    most = max(all_p)
    assert most == pytest.approx(2 / math.comb(15, 5))
    assert f"(rank tests, p at most {most:.4f}, Holm over these four {4 * most:.3f})" in told
    lead = f"at a return of 30 after {mean:.2f} M steps on a Go1: {ratios[0].value:.1f} times the steps of"
    assert f"{lead} `deploy` ({ratios[0].low:.1f} to {ratios[0].high:.1f}) and" in told
    longer = "{:.1f} times those of 1024 robots with longer tails ({:.1f} to {:.1f})"
    assert longer.format(*ratios[1]) in told
    its, mine, tails = (reached_of(job, 30) / 1e6 for job in of_fresh("h"))
    assert np.isfinite(its).sum() == 4
    assert f"with tails all, by {mine.max():.2f} and {tails.max():.2f}." in told
    twenty = [reached_of(of_fresh(x)[0], 20) for x in "cd"]
    twenty += [reached_of(job, 20) for name, job in grid().items() if name[-1] in "cd"]
    assert np.isnan(np.concatenate(twenty)).all() and sum(map(len, twenty)) == 66 + 20
    tails = np.concatenate([reached_of(of_fresh(x)[2], 20) / 1e6 for x in "cd"])
    assert f"With longer tails all ten are, by {tails.max():.1f}." in told
    assert [np.isfinite(reached_of(of_fresh(x)[0], 15)).sum() for x in "cd"] == [1, 1]
    # at equal steps
    more = {
        (x, at): [stats.difference(table.between(job, at * 1e6, "return"), its) for job in ours]
        for x in "gh"
        for at in (1.8, 9.2)
        for its, ours in [(table.between(of_fresh(x)[0], at * 1e6, "return"), of_fresh(x)[1:])]
    }
    fell = [100 * table.between(of_fresh(x)[0], 1.8e6, "fall_rate").mean() for x in "gh"]
    assert "{:.0f} and {:.0f} % of its Go1 and Go2 fall".format(*fell) in told
    text = "`deploy` returns {:.1f} more on a Go1 ({:.1f} to {:.1f}) and {:.1f} on a Go2 ({:.1f} to {:.1f}),"
    text = text.format(*more["g", 1.8][0], *more["h", 1.8][0])
    text += " longer tails {:.1f} and {:.1f}.".format(*(more[x, 1.8][1].value for x in "gh"))
    assert text in told
    value, low, high = more["g", 9.2][0]
    assert f"on a Go1 ({value:.1f} more; {-low:.1f} less to {high:.1f} more)" in told and low < 0
    assert "Longer tails return {:.1f} more ({:.1f} to {:.1f}).".format(*more["g", 9.2][1]) in told
    text = "On a Go2 it is {:.1f} ({:.1f} to {:.1f}) and {:.1f} more ({:.1f} to {:.1f})"
    assert text.format(*more["h", 9.2][0], *more["h", 9.2][1]) in told
    still = [run[-1]["fall_rate"] > 0.01 for run in table.seeds(of_fresh("h")[0])]
    assert sum(still) == 3 and "three of ten PPO runs still fall" in told


def test_other_pages_say_the_same_of_ppo_for_hardware():
    table, _ = less("ppo")
    page, steps, results, verdict = (
        words(path.read_text())
        for path in (
            DEPLOY / "README.md",
            DEPLOY / "steps.md",
            ROOT / "docs/results.md",
            EXPERIMENTS / "README.md",
        )
    )
    its, mine, tails = (reached_of(job, 30) / 1e6 for job in of_fresh("g"))
    one, other = stats.ratio(its, mine), stats.ratio(its, tails)
    text = (
        f"{one.value:.1f} times the steps on a Go1 ({one.low:.1f} to {one.high:.1f}; ten and five"
    )
    assert text in page
    assert f"({mine.mean():.1f} and {its.mean():.1f} M; {one.value:.1f} times as many" in results
    assert (
        f"needs {other.value:.1f} times their steps to 30 on a Go1 ({other.low:.1f} to" in results
    )
    assert f"({other.value:.1f} times as many, {other.low:.1f} to {other.high:.1f})" in steps
    assert 2.5 < one.value < 3.5 and "a third of tuned PPO's steps" in verdict
    assert 7.5 < other.value < 8.5 and "with longer tails an eighth" in verdict
    assert (
        6.5 < other.low and other.high < 9.5 and "a seventh to a ninth of the steps to 30" in page
    )
    its, mine, _ = (reached_of(job, 30) / 1e6 for job in of_fresh("h"))
    text = f"the soonest after {np.nanmin(its):.2f}, all five of `deploy` by {mine.max():.2f}."
    assert text in page and np.isfinite(its).sum() == 4
    at = {
        m: [table.between(job, m * 1e6, "return") for job in of_fresh("g")[:2]] for m in (1.8, 9.2)
    }
    assert f"a Go1 returns {at[1.8][1].mean():.1f}, with PPO {at[1.8][0].mean():.1f}." in page
    value, low, high = stats.difference(at[9.2][1], at[9.2][0])
    text = f"returns {at[9.2][1].mean():.1f}, with PPO {at[9.2][0].mean():.1f}"
    assert f"{text} ({value:.1f} more; {-low:.1f} less to {high:.1f} more)" in page
    assert f"it {text};" in results
    there = [np.isfinite(reached_of(of_fresh(x)[0], 35)).sum() for x in "gh"]
    last = max(reached_of(of_fresh(x)[2], 35).max() for x in "gh") / 1e6
    assert there == [2, 0]
    assert (
        f"Two of ten Go1 of PPO are at 35 by 9.2 M, and no Go2; these are all there by {last:.2f}."
        in steps
    )
    assert "with 1024 robots and tails to iteration 600" in results


def test_the_table_of_longer_runs_of_ppo_for_hardware_is_that_of_its_runs():
    """512 and 1024 robots, and 256, of ppo_others.txt, each to its end; beside `deploy`."""
    table, jobs = less("ppo")
    asked = {
        n: job for n, job in paper.jobs(LESS / "ppo_others.txt").items() if n.startswith("deploy")
    }
    text = part("Hardware").split("### Longer runs\n")[1]
    shown = [cells(line) for line in text.splitlines() if line.startswith("| `deploy`, ")]
    assert shown == rows_of({n: job for n, job in asked.items() if "-256-" not in n})
    told, anymal = words(text), [jobs[f"deploy-{n}-c"] for n in (256, 512, 1024)]
    levels = {"g": 38, "c": 24}
    assert all(np.isnan(reached_of(jobs[name], levels[name[-1]])).all() for name in asked)
    every = [*grid().items(), *((x, of_fresh(x)[0]) for x in "ghcd")]
    assert all(np.isnan(reached_of(job, 38 if n[-1] in "gh" else 24)).all() for n, job in every)
    mine = less("ppo")[0].read(DEPLOY / "fewer.csv.xz")["fresh-deploy-c"]
    twenty = reached_of(mine, 20) / 1e6
    text = "It is there after {:.1f} M steps (first to last seed {:.1f} to {:.1f})."
    assert text.format(twenty.mean(), twenty.min(), twenty.max()) in told
    its = [reached_of(job, 20) / 1e6 for job in anymal]
    assert [np.isfinite(x).sum() for x in its] == [0, 1, 2]
    its = np.concatenate(its)
    text = f"1024, after {np.nanmin(its):.1f} to {np.nanmax(its):.1f}; the other six do not"
    assert f"three of nine runs, one with 512 robots and two with {text}" in told
    gaps = {}
    for robots, job in zip((256, 512, 1024), anymal, strict=True):
        end = job[-1]["sim_steps"]
        pair = [table.between(one, end, "return") for one in (job, mine)]
        gaps[robots] = (end / 1e6, *(x.mean() for x in pair), *stats.difference(*pair))
        assert gaps[robots][-2] < 0 < gaps[robots][-1], robots
    at, one, other, value, low, high = gaps[1024]
    text = f"no difference is shown: with 1024 robots after {at:.1f} M {one:.1f}, `deploy` {other:.1f},"
    text += f" {value:.2f} less ({high:.2f} less to {-low:.2f} more);"
    for robots in (512, 256):
        text += " with {} after {:.1f} M {:.1f} and {:.1f};".format(robots, *gaps[robots][:3])
    assert text[:-1] + "." in told
    then, today = (table.read(DEPLOY / "deploy.csv.xz", batch) for batch in "14")
    older, end = today["anymal_c-bundled"], anymal[2][-1]["sim_steps"]
    pair = [table.between(job, end, "return") for job in (anymal[2], older)]
    value, low, high = stats.difference(*pair)
    assert (
        f"by the older five seeds, {value:.2f} less ({low:.2f} to {high:.2f}, uncorrected)" in told
    )
    ends = sorted({row["sim_steps"] / 1e6 for row in older})
    assert f"evaluations {ends[3] - ends[2]:.0f} M apart" in told
    # why, and then
    assert config_lib.load("anymal_c:deploy").physics.iterations == 10
    config = config_lib.validate(config_lib.load("anymal_c:deploy"))
    thousand = config.rollout.num_envs * config.rollout.horizon / 1e3
    assert f"From iteration {config.schedule.last_iteration} on `deploy` has no tail" in told
    assert f"{thousand:.0f} thousand steps an iteration" in told
    old = reached_of(then["go1"], 30).mean() / 1e6, reached_of(then["anymal_c"], 20).mean() / 1e6
    assert "was at 30 after {:.1f} M, and an ANYmal-C at 20 after {:.1f}.".format(*old) in told
    ended = [
        np.mean([run[-1]["return"] for run in table.seeds(x)]) for x in (mine, then["anymal_c"])
    ]
    assert f"ends at {ended[0]:.1f} after {mine[-1]['sim_steps'] / 1e6:.1f} M" in told
    assert f"ended at {ended[1]:.1f}" in told
    # the page of hardware, and results
    page, results = (
        words(path.read_text()) for path in (DEPLOY / "README.md", ROOT / "docs/results.md")
    )
    text = f"An ANYmal-C takes {twenty.mean():.1f} M steps to 20"
    assert f"{text} (five seeds, the soonest {twenty.min():.1f})." in page
    assert (
        f"a{text[1:]}, and of PPO, with fewer robots, three of nine runs take 14 to 19" in results
    )
    assert "are not there by their ends, at 9.2 to 19.7 M" in page


def rows_of(asked):
    """Of the tables that have all columns; the label is task, robot and number of robots."""
    table, jobs = less("ppo")
    rows = []
    for name, line in asked.items():
        job, (task, robots, letter) = jobs[name], name.split("-")
        assert job[0]["job"] == line and {x["batch"] for x in job} == {
            "7" if letter == "c" else "6"
        }
        assert job[-1]["iteration"] == float(re.search(r"num_iterations=(\d+)", line)[1])
        row = cells(table.table({name: job}, table.best(job)).splitlines()[-1])
        label = f"{task if task == 'exact' else '`deploy`'}, {ROBOT_OF[letter]}, {robots} robots"
        rows.append([label, *row[5:8], row[3], row[2], *row[9:11]])
    return rows


def test_the_table_of_ppo_on_the_exact_task_is_that_of_its_runs():
    """Three seeds to their end, beside five of `best`; the grid of that task has not run whole."""
    choose, (table, jobs) = script("21_less/choose"), less("ppo")
    asked = {
        n: job for n, job in paper.jobs(LESS / "ppo_others.txt").items() if n.startswith("exact")
    }
    text = part("The exact task")
    shown = [cells(line) for line in text.splitlines() if line.startswith("| exact")]
    assert shown == rows_of(asked)
    told = words(text)
    costs = script(f"{ROW_COST}/table")
    mine = {
        one.place: one
        for one in costs.runs()
        if one[1:3] == ("H200, 2026-11-28", "best") and one.place.endswith("exact")
    }
    go1, anymal = mine["go1.exact"], mine["anymal_c.exact"]
    more = []
    for best, name, level in ((go1, "exact-256-g", 38), (anymal, "exact-256-c", 24)):
        more.append(stats.ratio(reached_of(jobs[name], level), best.level[:, 1]))
        assert choose.cost(jobs[name], "level") < choose.cost(
            jobs[name.replace("256", "512")], "level"
        )
    words_of = "{:.1f} times the steps of `best` on a Go1 ({:.1f} to {:.1f}) and {:.1f} times on an ANYmal-C"
    assert f"{words_of} ({{:.1f}} to {{:.1f}})".format(*more[0], *more[1]) in told
    steps = [one.level[:, 1].mean() / 1e6 for one in (go1, anymal)]
    assert "which need {:.2f} and {:.2f} M".format(*steps) in told
    other = words((EXPERIMENTS / ROW_COST / "runs.md").read_text())
    text = (
        "three tuning seeds, {:.1f} ({:.1f} to {:.1f}) and {:.1f} times ({:.1f} to {:.1f}) those of"
    )
    assert text.format(*more[0], *more[1]) in other
    fewest = [reached_of(jobs[f"exact-256-{x}"], y).mean() / 1e6 for x, y in (("g", 38), ("c", 24))]
    assert "it needs [{:.2f} and {:.2f} M".format(*fewest) in other
    for letter, robots in (("g", "256"), ("c", "512")):  # that the rule takes
        cost = {n: choose.cost(jobs[f"exact-{n}-{letter}"]) for n in ("256", "512")}
        assert min(cost, key=cost.get) == robots
    walked = table.reached(table.seeds(jobs["exact-512-c"]), 24).walks
    text = "after {:.1f} times the steps of `best` ({:.1f} to {:.1f})"
    assert text.format(*stats.ratio(walked, anymal.walks[:, 1])) in told
    assert np.isfinite(go1.walks[:, 1]).sum() == 2 and f"{go1.end / 1e6:.1f}" == "2.7"
    # what comes next
    grid = paper.jobs(LESS / "ppo_exact.txt")
    ran = table.read(LESS / "results/ppo.csv.xz", "10")
    assert len(grid) == 22 and {n: grid[n] for n in ran} == {
        n: job[0]["job"] for n, job in ran.items()
    }
    assert f"{len(ran)} have run" in told
    assert grid.keys() - ran.keys() == {f"exact-{n}-kl3-{x}" for n in (256, 512) for x in "gc"}


def test_how_careful_the_page_says_that_each_was_tuned():
    """Runs and settings of PPO, of the longer tails, of `deploy`."""
    told, table = words(PAGE.read_text()), less("ppo")[0]
    runs = sum(len(table.seeds(job)) for job in grid().values())
    assert f"PPO has these {runs} runs, of eleven settings" in told and len(SETTINGS) == 11
    others = [n for n in paper.jobs(LESS / "ppo_others.txt") if n.startswith("deploy")]
    assert f"and {3 * len(others)} longer ones, of three" in told
    tails = {key: job for key, job in packed("fewer").items() if key[0] in ("fewer", "tails")}
    count = sum(map(len, tails.values()))
    settings = {name.split("-", 1)[1].removesuffix("-cut")[:-2] for _, name in tails}
    assert len(settings) == 5 and f"found in {count} tuning runs of five settings" in told
    shaped = sum(map(len, packed("tuning").values()))
    assert f"shaped in {shaped} runs" in told

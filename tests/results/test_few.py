"""27_few: few robots, their tables, parts and jobs."""

import csv
import lzma
import re
import sys

import numpy as np
import pytest
import scipy.stats
from result_files import EXPERIMENTS, cells, few_fresh, few_jobs, few_of, script, shows

from dynappo import config as config_lib
from dynappo import schedule
from experiments import stats


def test_jobs_of_few_robots_are_valid_and_evaluated_on_the_way_to_45_thousand_steps():
    """Of 27_few: `robots-R` has R robots and a memory for all rows up to there. With up to 64 robots there
    are ten evaluations until 45 thousand steps, which every run reaches."""
    evaluations = script("21_less/run").evaluations
    for file in ("jobs", "laptop", "fresh"):
        lines = (EXPERIMENTS / f"27_few/{file}.txt").read_text().splitlines()
        assert len({line.split()[0] for line in lines}) == len(lines)
        for line in lines:
            name, job, *fields = line.split()
            robot, _, variant = job.partition(":")
            config = config_lib.load(f"configs/{robot}.py:{variant}")
            config.run.log_every = 1
            for field in fields:
                if not field.startswith("control="):
                    config_lib.override(config, *field.split("=", 1))
            config = config_lib.validate(config)
            steps = schedule.sim_steps(config)
            if name.startswith("robots-"):
                robots, memory = int(name.split("-")[1]), config.model.memory
                assert config.rollout.num_envs == robots
                assert memory * robots >= 45_000
            if file == "jobs":
                asked = [steps[i - 1] for i in evaluations(config)]
                many = config.rollout.num_envs > 64
                assert many or sum(s <= 45_000 for s in asked) >= 10, name
                assert steps[-1] > 42_000, name
                assert config.schedule.late_from is None


def test_jobs_of_seconds_are_those_of_the_table_of_robots():
    """27_few/seconds.txt: the settings of `robots-` in jobs.txt, and of `few` itself, on other seeds."""
    measure, folder = script("30_row_cost/run"), EXPERIMENTS / "27_few"
    jobs, seconds = (
        dict(line.split(None, 1) for line in (folder / f"{file}.txt").read_text().splitlines())
        for file in ("jobs", "seconds")
    )
    assert [name.split("-")[1] for name in seconds] == "64 16 4 1 256 1024".split()
    for name, line in seconds.items():
        job, *fields = line.split()
        mine = measure.read(job, fields)
        other = config_lib.load("configs/go1.py:few")
        for field in jobs.get(name.replace("few", "robots"), f"{job} run.eval_every=20").split()[
            1:
        ]:
            config_lib.override(other, *field.split("=", 1))
        other.run.log_every = other.run.eval_every
        its = config_lib.flat(config_lib.validate(other))
        changed = {k: x for k, x in config_lib.flat(mine.config).items() if x != its[k]}
        known = {
            "run.seed",
            "run.num_seeds",
            "run.eval_envs",
            "run.eval_every",
            "run.checkpoint_every",
        }
        assert changed.keys() <= known and changed["run.seed"] == 1100, (name, changed)
        assert mine.config.rollout.num_envs == int(name.split("-")[1])


def test_what_may_be_the_default_has_the_settings_of_256_robots_in_both_files():
    """27_few/jobs.txt `default-` and default.txt: the `robots-256` that ran, without smaller steps late and
    with room for all rows; and the numbers of `best` in the rule."""
    measure, folder = script("30_row_cost/run"), EXPERIMENTS / "27_few"
    jobs, seconds = (
        dict(line.split(None, 1) for line in (folder / f"{file}.txt").read_text().splitlines())
        for file in ("jobs", "default")
    )
    longer = {"model.memory", "run.num_iterations", "run.log_every"}
    late = {"schedule.late_from", "ppo.late_kl"}
    (ran,) = {row["job"] for row in few_jobs("robots-3")["robots-256-g"]}
    runs = {f"run.{name}" for name in ("seed", "num_seeds", "eval_envs", "eval_every")}
    runs.add("run.checkpoint_every")

    def settings(line):
        job, *fields = line.split()
        return config_lib.flat(measure.read(job, fields).config)

    for robot in "ghcd":
        mine = settings(jobs[f"default-{robot}"])
        like = settings(" ".join([jobs[f"default-{robot}"].split()[0], *ran.split()[1:]]))
        assert {k for k in mine if mine[k] != like[k]} <= longer | runs | late
        assert mine["schedule.late_from"] is None
        job, *fields = jobs[f"default-{robot}"].split()
        rows = schedule.sim_steps(measure.read(job, fields).config)[-1] / 256
        assert rows <= mine["model.memory"] < rows + 20
    mine = settings(jobs["default-g"])
    for x, seed in (("g", 1300), ("g2", 1308)):  # in turn, sixteen seeds of each in all
        its, best = settings(seconds[f"default-{x}"]), settings(seconds[f"best-{x}"])
        assert {k for k in mine if mine[k] != its[k]} <= longer | runs
        assert its["run.seed"] == best["run.seed"] == seed
        assert best["rollout.num_envs"] == 1024 and not best["model.memory"]
    assert [*seconds] == [f"{name}-{x}" for x in ("g", "g2") for name in ("default", "best")]
    assert all(line.split()[1] == "seeds=8" for line in seconds.values())
    with (EXPERIMENTS.parent / "docs/numbers.csv").open(newline="") as file:  # the rule's of `best`
        known = {row["name"]: row["value"] for row in csv.DictReader(file)}
    robots = "go1 go2 anymal_c anymal_d".split()
    told = [known[f"{x} first at {38 if x[:2] == 'go' else 24}"] for x in robots]
    words = " ".join((folder / "README.md").read_text().split())
    assert f"({', '.join(f'{float(x):.2f}' for x in told)} M)" in words


def test_why_256_robots_are_not_the_default_is_as_the_page_says():
    """What rules.py and table.py print of the runs, in the page's table and words."""
    rules, table = script("27_few/rules"), script("27_few/table")
    page = (EXPERIMENTS / "27_few/README.md").read_text().split("## 256 robots: not the")[1]
    part, words = page.split("### The rule")[0], " ".join(page.split())
    rows = {cells(line)[0]: cells(line)[1:] for line in part.splitlines() if "|" in line}
    with rules.NUMBERS.open(newline="") as file:
        known = {row["name"]: row["value"] for row in csv.DictReader(file)}
    jobs, headline = few_jobs("default"), rules.runs.read(rules.HEADLINE)
    told = "\n".join(rules.default(jobs, headline, known))
    form = (
        r"(\w+), 10 seeds: first at \d+ after ([\d.]+) k \(last ([\d.]+)\), at most ([\d.]+); 0 not"
        r" finite: rule 1 is met\n.*\n +end: return ([\d.]+) \(`best` ([\d.]+), margin .*?\), falls"
        r" ([\d.]+) %.*error ([\d.]+) m/s \(`best` ([\d.]+), margin 0.02\): rule 3 is (not )?met"
    )
    found = re.findall(form, told)
    assert [one[-1] for one in found] == ["", "", "not ", ""] and len(rows) == 6
    assert "37 of 40 walk: rule 2 is not met\n  rules 1 to 3 are not all met" in told
    fewer, walks, lost, falls, best_walks = [], [], [], [], []
    for letter, (robot, first, last, most, back, best, fell, error, its, _) in zip(
        "ghcd", found, strict=True
    ):
        seeds, reached = few_of("default", f"default-{letter}")
        walk = int(np.isfinite(reached.walks).sum())
        cell = [f"{first} (last {last})", most, f"{walk}", f"{back} ({best})", f"{fell} %"]
        assert rows[table.ROBOTS[letter]] == [*cell, f"{error} ({its})"], robot
        runs = rules.runs.seeds(headline[f"best-{letter}"])
        fewer.append(
            rules.runs.reached(runs, table.level_of(runs[0])).level.mean() / reached.level.mean()
        )
        walks.append(np.nanmean(reached.walks) / 1e3)
        pairs = zip(seeds, reached.walks, strict=True)
        lost += [100 * run[-1]["fall_rate"] for run, at in pairs if np.isnan(at)]
        falls.append(100 * rules.ends(runs)[1])
        best_walks.append(float(known[f"{robot} walks"]))
        assert {row["job"] for row in jobs[f"default-{letter}"]} == {
            line.split(None, 1)[1]
            for line in (EXPERIMENTS / "27_few/jobs.txt").read_text().splitlines()
            if line.startswith(f"default-{letter} ")
        }
    assert "**Falls**" not in part and "**0.53 %**" in part  # the one above its limit is bold
    assert f"to the level {min(fewer):.1f} to {max(fewer):.1f} times fewer than `best`" in words
    told = "The three others fall in {:.1f} to {:.1f} % of their last episodes"
    assert len(lost) == 3 and told.format(min(lost), max(lost)) in words
    told = "The 37 walk after {:.0f}, {:.0f}, {:.0f} and {:.0f} thousand steps in the mean, `best` after"
    told = told.format(*walks) + f" {min(best_walks):.2f} to {max(best_walks):.2f} million"
    assert told in words
    ends = [max(row["sim_steps"] for row in headline[f"best-{x}"]) for x in "ghcd"]
    assert {f"{x / 1e6:.1f}" for x in ends} == {
        "7.8",
        "8.5",
    } and "until 7.8 or 8.5 million" in words
    assert min(ends) / 135_168 > 57 and "after 60 times the steps" in words
    assert f"`best` has {min(falls):.2f} to {max(falls):.2f} %" in words
    alone = table.alone(EXPERIMENTS / "27_few/results/default.csv.xz")
    (line,) = table.ratios(alone)
    ratio = re.search(r"16 and 16 seeds: (.*) \((.*) to (.*)\)", line).groups()
    assert float(ratio[2]) >= 1.25 and float(ratio[1]) > 1  # not met, and slower
    level, ms = {}, {}
    for kind in ("default", "best"):
        some = [one for one in alone if one.name.startswith(kind)]
        level[kind] = np.concatenate([one.level for one in some]).mean(0)
        ms[kind] = np.mean([1e3 * one.end[:, 2] / one.end[:, 0] for one in some])
    mine, best = level["default"], level["best"]
    told = f"{mine[2]:.2f} s to the level, `best` {best[2]:.2f}, {ratio[0]} times ({ratio[1]} to {ratio[2]})"
    assert told in words
    told = f"for a ninth of the steps ({mine[1] / 1e3:.1f} and {best[1] / 1e3:.1f} thousand)"
    assert told in words and 8.5 < best[1] / mine[1] < 9.5
    told = f"takes twice as long, {ms['default']:.0f} and {ms['best']:.0f} ms, and it needs"
    assert f"{told} {mine[0]:.0f}, not {best[0]:.0f}" in words
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    told = (
        f"On one host 256 take {mine[2]:.2f} s and `best` {best[2]:.2f}, for nine times the steps"
    )
    assert f"{told} ([sixteen seeds each]" in text
    told = (
        f"Sixteen more seeds take {mine[2]:.2f} s and {mine[1] / 1e3:.1f} k, and `best` beside them"
    )
    assert f"{told} on one card {best[2]:.2f} s" in text


def test_rules_that_were_written_before_their_runs_can_be_met_and_can_fail():
    """Pairs as on the page, of runs that it has; of the default each of its rules, broken alone."""
    rules = script("27_few/rules")
    late, spread = few_jobs("late"), few_jobs("fresh-spread")
    jobs = {f"more-few-{x}": late[f"fresh-late-{x}"] for x in "ghcd"}
    jobs |= {f"more-spread-{x}": spread[f"fresh-spread-{x}"] for x in "ghcd"}
    words = " ".join((EXPERIMENTS / "27_few/parts.md").read_text().split())
    more, asked = few_jobs("more"), ("more-spread", "more-few", rules.fewer_falls, 60, True)
    *_, every, verdict = rules.pairs(more, *asked)  # what it was written for
    assert every == "  all: +0.02 (-0.14 to 0.19, 60 pairs) points of falls; 56 and 55 walk"
    assert "0.02 points more with it (0.14 fewer to 0.19 more), and 56 instead of 55 seeds" in words
    assert verdict == "  a difference below 0 is not shown: the rule is not met"
    *_, every, _ = rules.pairs(more, *asked[:2], rules.sooner, 60)
    assert every.startswith("  all: -0.34 (-1.33 to 0.65, 60 pairs) thousand steps to the level")
    assert "0.3 k steps sooner (1.3 sooner to 0.7 later)" in words
    few, asked = few_jobs("parts-2")["robots-1-g"], ("more-spread", "more-few", rules.fewer_falls)
    assert any(rules.lost(row) for row in few) and not all(rules.lost(row) for row in few)
    assert not any(np.isnan(row["return"]) for row in few)  # one became NaN, and its robots fell
    *_, every, verdict = rules.pairs(jobs, *asked, 30, True)
    assert every == "  all: -0.15 (-0.31 to 0.01, 30 pairs) points of falls; 29 and 28 walk"
    assert "Falls were 0.15 points fewer (95 % from 0.31 fewer to 0.01 more" in words
    assert verdict == "  a difference below 0 is not shown: the rule is not met"
    for letter in "hd":
        del jobs[f"more-spread-{letter}"]
    *_, left, every, verdict = rules.pairs(jobs, *asked, 60, True)
    assert left == "  anymal_d: left out, no more-spread-d" and ", 20 pairs)" in every
    assert verdict == "  a difference below 0 is shown: the rule is open, with 20 of 60 pairs"
    *_, verdict = rules.pairs(jobs, *asked, 20, True)
    assert verdict == "  a difference below 0 is shown: the rule is met"
    jobs["more-few-g"], jobs["more-spread-g"] = jobs["more-spread-g"], jobs["more-few-g"]
    del jobs["more-few-c"]
    *_, verdict = rules.pairs(jobs, *asked, 10, True)
    assert verdict == "  a difference below 0 is not shown: the rule is not met"
    jobs["more-few-g"] = [row | {"commit": "another"} for row in jobs["more-few-g"]]
    with pytest.raises(SystemExit, match="have another commit, expected pairs"):
        rules.pairs(jobs, *asked, 10)

    def run(robot, seed, back, fell=0.0, error=0.04, steps=30e3, **other):
        job, begin = {"job": f"{robot}:few", "seed": float(seed)}, {"return": 1.0, "fall_rate": 0.9}
        row = {"return": back, "fall_rate": fell, "tracking_error": error} | other
        at = [steps / 2, *(steps + 1e4 * k for k in range(5))]
        rows = [begin | {"tracking_error": 0.5}, *[row] * 5]
        return [job | {"sim_steps": s} | one for s, one in zip(at, rows, strict=True)]

    def judge(**changed):
        """Ten seeds of each robot; the first of an ANYmal-C is changed."""
        jobs = {}
        for letter, robot in rules.ROBOTS.items():
            back = 42.5 if letter in "gh" else 26.5
            some = [changed if (letter, seed) == ("c", 0) else {} for seed in range(10)]
            rows = [run(robot, seed, **{"back": back} | one) for seed, one in enumerate(some)]
            jobs[f"default-{letter}"] = [row for one in rows for row in one]
        return rules.default(jobs, *known)

    with rules.NUMBERS.open(newline="") as file:
        known = (
            rules.runs.read(rules.HEADLINE),
            {r["name"]: r["value"] for r in csv.DictReader(file)},
        )
    assert judge()[-2:] == ["  40 of 40 walk: rule 2 is met", "  rules 1 to 3 are all met"]
    assert judge(fell=0.02)[-2:] == ["  39 of 40 walk: rule 2 is met", "  rules 1 to 3 are all met"]
    for broken, line, told in (
        (dict(steps=700e3), 7, "rule 1 is not met"),  # the mean is above a quarter of 0.34 M
        (dict(back=20.0), 7, "rule 1 is not met"),  # it never gets there
        (dict(policy_std=float("nan")), 7, "1 not finite: rule 1 is not met"),
        (dict(fell=0.06), 9, "falls 0.60 % (at most 0.5), error"),
        (dict(error=0.5), 9, "rule 3 is not met"),
    ):
        lines = judge(**broken)
        assert told in lines[line] and lines[-1] == "  rules 1 to 3 are not all met", broken
        assert lines[line].startswith("  anymal_c" if line == 7 else "    end")
    assert rules.default({}, *known)[1:] == [
        f"  {robot}: no default-{x}, so the rule is open" for x, robot in rules.ROBOTS.items()
    ]


def test_fresh_seeds_of_few_pair_with_those_of_its_table():
    """In 27_few's jobs.txt, and what ran: the seeds and evaluations of fresh.txt."""
    folder = EXPERIMENTS / "27_few"
    jobs, fresh = (
        dict(line.split(None, 1) for line in (folder / f"{file}.txt").read_text().splitlines())
        for file in ("jobs", "fresh")
    )
    ran = few_jobs("feet")
    for robot in "ghcd":
        asked = f"{fresh[f'fresh-{robot}']} schedule.anchors=0"
        assert jobs[f"fresh-anchors-{robot}"] == asked
        no_late = "schedule.late_from=None ppo.late_kl=1.0"
        asked = f"{fresh[f'fresh-{robot}']} {no_late}"
        assert {row["job"] for row in few_jobs("late")[f"fresh-late-{robot}"]} == {asked}
        assert {row["job"] for row in ran[f"fresh-{robot}"]} == {fresh[f"fresh-{robot}"]}
        asked = f"{fresh[f'fresh-{robot}']} control=spread"
        spread = few_jobs("fresh-spread")[f"fresh-spread-{robot}"]
        assert {row["job"] for row in spread} == {asked}
        more = fresh[f"fresh-{robot}"].replace("run.seed=970", "run.seed=1200")
        more = re.sub(r"(?<=num_seeds=)\d+", lambda found: f"{2 * int(found[0])}", more)
        assert jobs[f"more-few-{robot}"] == more
        for name, asked in (("few", more), ("spread", f"{more} control=spread")):
            rows = few_jobs("more")[f"more-{name}-{robot}"]
            assert {row["job"] for row in rows} == {asked}
            assert {row["commit"] for row in rows} == {"6000006171c7"}
        part = jobs[f"part-whole-{robot}"]
        for name, asked in (("part-whole", part), ("control-recent", f"{part} control=recent")):
            assert {row["job"] for row in few_jobs("recent")[f"{name}-{robot}"]} == {asked}


def test_the_table_of_logs_is_that_of_its_seeds(tmp_path):
    """In logs.md; and by hand, of two seeds that gain 1 and 3: 2 with Student's 12.706 of one degree."""
    table, few = script("27_few/logs_table"), EXPERIMENTS / "27_few"
    page = [cells(line) for line in (few / "logs.md").read_text().splitlines() if "|" in line]
    rows = [cells(line) for line in table.table(table.SEEDS).splitlines()]
    assert len(rows) == 11 and all(row in page for row in [rows[0], *rows[2:]])
    head = "case,seed,sensors,iteration,log_seconds,return,fall_rate"
    some = [
        f"motors,{s},0.0,{i},80.0,{r},0.25"
        for s, r in ((0, 31), (1, 33))
        for i, r in ((0, 30), (15, r))
    ]
    (tmp_path / "a.csv").write_text("\n".join([head, *some, ""]))
    row = cells(table.table(tmp_path / "a.csv").splitlines()[-1])
    half = 12.706 * np.std([1, 3], ddof=1) / 2**0.5
    assert row == [
        *("motors", "80 s", "0.0", "2", "30.0, 25 %"),
        f"32.0 (31.0 to 33.0), 25 %; +2.0 ± {half:.1f}",
    ]


def test_the_tables_of_few_robots_are_those_of_their_runs():
    """Each line with returns is that of a job, by hand that of its name; no run on a CPU is left out,
    and they ran what laptop.txt says, less what `few` was then."""
    table, few = script("27_few/table"), EXPERIMENTS / "27_few"
    page = {
        name: [cells(line) for line in (few / f"{name}.md").read_text().splitlines() if "|" in line]
        for name in ("README", "model", "history")
    }

    def told(path, at):
        return [cells(line) for line in table.table(table.read(path), at).splitlines()[2:]]

    on_cpu, jobs = told(few / "results", [17.4, 27.6, 43]), table.read(few / "results")
    of_cpu = [row for row in page["history"] if len(row) == 8 and row[0][0] == "`"]
    found = {row[0].strip("`"): row[2:] for row in of_cpu}
    assert found == {row[0]: row[1:] for row in on_cpu} and len(jobs) >= 9
    laptop = [line.split() for line in (few / "laptop.txt").read_text().splitlines()]
    assert "model.weight_decay" in jobs.pop("decay4")[0]["job"]  # a field that is gone
    then = {"rollout.horizon=20", "schedule.end_steps=16", "model.minibatches=5"}
    then.add("run.num_iterations=160")
    assert {name: [f for f in job if f not in then] for name, *job in laptop if name in jobs} == {
        name: rows[0]["job"].split() for name, rows in jobs.items()
    }
    packed = few / "results" / "gpu.csv.xz"
    on_gpu = [tuple(row[2:8]) for row in told(packed, [10.0, 15.0, 20.0, 27.0, 43.0])]
    fresh = [row[2:8] for row in page["README"] if len(row) == 9 and row[2].endswith("%")]
    model, before = (
        [row[1:7] for row in page[name] if len(row) == 7 and row[1].endswith("%")]
        for name in ("model", "history")
    )
    never = ["never in 84 k" if "5 never" in row[-1] else row[-1] for row in on_gpu]
    known = {(*row[:-1], last) for row, last in zip(on_gpu, never, strict=True)}
    pooled = table.table(table.fresh(packed), [10.0, 15.0, 20.0, 27.0, 43.0]).splitlines()[2:]
    known |= {tuple(cells(line)[2:8]) for line in pooled}
    assert (len(fresh), len(model), len(before)) == (4, 17, 26)
    assert {tuple(row) for row in fresh + model + before} <= known


def first_of(batch, name):
    """Thousand steps to the level, mean and last seed, as the pages have them."""
    return words_of_level(few_of(batch, name)[1].level)


def words_of_level(level):
    return f"{level.mean() / 1e3:.1f} ({level.max() / 1e3:.1f})"


def words_of_first(reached):
    """The same of what `few_of` found, as a sentence has it."""
    return (
        f"{reached.level.mean() / 1e3:.1f} k steps (the last seed {reached.level.max() / 1e3:.1f})"
    )


def falls_of(batch, name, least=0.0, most=np.inf):
    """Per cent of episodes with a fall in the last four evaluations, or in the four between these steps."""
    seeds = few_of(batch, name)[0]
    some = [[r["fall_rate"] for r in run if least <= r["sim_steps"] <= most][-4:] for run in seeds]
    assert {len(run) for run in some} == {4} and {len(run) for run in seeds} != {4}
    return 100 * np.mean(some)


def test_how_many_few_robots_need_which_steps_is_as_the_page_says():
    few, page = script("27_few/table"), (EXPERIMENTS / "27_few/README.md").read_text()
    text = " ".join(page.split())
    lines = page.split("### Seconds")[0].splitlines()
    rows = {cells(line)[0]: cells(line)[1:] for line in lines if "|" in line}
    jobs = {f"{count}": ("robots-3", f"robots-{count}-") for count in (16, 1024)}
    jobs |= {"1": ("parts-2", "robots-1-"), "4": ("one-commit", "robots-4-")}
    jobs |= {"256": ("default", "default-"), "1024, `best`": ("rows", "best-")}
    every = {
        label: [few_of(batch, name + x) for x in "gc"] for label, (batch, name) in jobs.items()
    }
    every["64"] = [few_fresh(x) for x in "gc"]
    for label, both in every.items():
        first, minutes, iterations, anymal = rows[label]
        seeds, reached = both[0]
        assert (first, anymal) == tuple(words_of_level(one.level) for _, one in both), label
        assert shows(minutes, reached.level.mean() / 3000)
        at = few.runs.reached(seeds, few.level_of(seeds[0]), "iteration").level
        assert shows(iterations, at.mean()), (label, at.mean())
        held = {
            "64": [*range(970, 980), *range(1200, 1220)],
            "256": range(1300, 1310),
            "1024, `best`": range(5),
        }.get(label, range(3))
        assert all([run[0]["seed"] for run in some] == [*held] for some, _ in both)
    (go, go_at), (anymal, anymal_at) = (few_of("parts-2", f"robots-1-{x}") for x in "gc")
    assert f"after {words_of_first(go_at)}, which is four robot-minutes and a third" in text
    told = [1e2 * round(10 * float(rows[robots][0].split()[0])) for robots in ("1", "4", "16")]
    assert (
        "On tuning seeds 1, 4 and 16 need {:,.0f}, {:,.0f} and {:,.0f}, and one".format(*told)
        in text
    )
    many = [1e2 * round(10 * float(rows[robots][0].split()[0])) for robots in ("256", "1024")]
    assert f"256 need {many[0]:,.0f} (ten), 1024 need" in text
    last = (
        f"an ANYmal-C after {anymal_at.level.mean() / 1e3:.1f} ({anymal_at.level.max() / 1e3:.1f})"
    )
    assert f"{last}, seven. All three ANYmal-C walk, from" in text
    for words, of in (("4.33", go_at), ("6.9", anymal_at)):
        assert shows(words, of.level.mean() / 3000)
    first_walk, last_walk = anymal_at.walks.min() / 1e3, anymal_at.walks.max() / 1e3
    assert f"from {first_walk:.0f} to {last_walk:.0f} k on. Of three Go1 one walks" in text
    assert [int(x) for x in np.isnan(go_at.walks)] == [1, 0, 1]
    assert f"one walks, from {go_at.walks[1] / 1e3:.0f} k on" in text
    falls = [100 * r["fall_rate"] for r in go[2]]
    assert f"falls in {falls[-2]:.1f} and {falls[-1]:.1f} % of its episodes in the last two" in text
    assert (min(falls[-10:-2]), max(falls[-10:-2])) == (0.5, 1.0) and falls[-11] > 1
    assert "after 0.5 to 1 % in the eight before" in text
    finite = [r for r in go[0] if r["return"]]
    ends = finite[-1]["sim_steps"] / 1e3, go[0][len(finite)]["sim_steps"] / 1e3
    known = f"was at the level after {go_at.level[0] / 1e3:.1f} k, had returns of 42, and"
    assert known in text and f"between {ends[0]:.0f} and {ends[1]:.0f} k" in text
    known = " ".join((EXPERIMENTS / "27_few/model.md").read_text().split())
    assert f"between {ends[0]:.0f} and {ends[1]:.0f} k. Up to then its return is 42" in known
    late = [r for r in finite if r["sim_steps"] > 24.9e3]
    assert "at most 1.5 % falls since 25 k" in known
    assert max(r["fall_rate"] for r in late) == 0.015
    assert {round(r["return"]) for r in late} == {42}
    four = [few_of("one-commit", f"robots-4-{x}")[1] for x in "gc"]
    level = [f"{one.level.mean() / 1e3:.1f}" for one in four]
    last = [f"{one.level.max() / 1e3:.1f}" for one in four]
    assert (
        f"after {level[0]} k steps (the last seed {last[0]}), which is three robot-minutes" in text
    )
    assert f"and a quarter, ANYmal-C after {level[1]} ({last[1]}). All six walk." in text
    assert shows("3.25", four[0].level.mean() / 3000)
    assert np.isfinite([one.walks for one in four]).all()
    walk = {
        count: [few_of("robots-3", f"robots-{count}-{x}")[1].walks / 1e3 for x in "gc"]
        for count in (16, 1024)
    }
    many = [np.isfinite(few_of("default", f"default-{x}")[1].walks).sum() for x in "gc"]
    assert (
        many == [9, 9] and "of 256 nine of ten Go1 and nine of ten ANYmal-C walk at 135 k" in text
    )
    assert np.isfinite(walk[1024]).sum() == 5 and "Of six times 1024 robots five walk, from" in text
    told = f"Go1 walk, from {min(walk[16][0]):.0f} to {max(walk[16][0]):.0f} k on, and two ANYmal-C"
    assert told in text and [np.isfinite(x).sum() for x in walk[16]] == [3, 2]
    last = few_of("robots-3", "robots-16-c")[0][int(np.isnan(walk[16][1]).argmax())][-1]
    assert f"the third falls in {100 * last['fall_rate']:.1f} % of its last episodes" in text
    told = f"from {np.nanmin(walk[1024]):.0f} to {np.nanmax(walk[1024]):.0f} k on"
    assert told in text
    saved = []
    for x in "gc":
        mine, best = (
            few_of(*one)[1].level
            for one in (("robots-3", f"robots-1024-{x}"), ("rows", f"best-{x}"))
        )
        ratio = stats.ratio(mine, best)
        saved.append([100 * (1 - part) for part in (ratio.value, ratio.high, ratio.low)])
    told = "{:.0f} % fewer than the `best` of the table on a Go1 ({:.0f} to {:.0f}) and {:.0f} % fewer on"
    assert (told + " an ANYmal-C ({:.0f} to {:.0f})").format(*saved[0], *saved[1]) in text
    run = few_jobs("robots-3")["robots-1024-g"][0]["job"]
    late = int(run.rpartition(" schedule.late_from=")[2])
    every = few_of("robots-3", "robots-1024-g")[0][0][:2]
    each = np.diff([[row[key] for row in every] for key in ("sim_steps", "iteration")], axis=1)
    after = (late - every[0]["iteration"]) * each[0] / each[1]
    begin = (every[0]["sim_steps"] + after[0]) / 1e3
    assert f"with 1024 robots these begin at {begin:.0f} k, before the level of every" in text
    assert all(few_of("robots-3", f"robots-1024-{x}")[1].level.min() > 1e3 * begin for x in "gc")
    memory = [
        few_of("rows", f"best-{x}")[1].level.mean() / 1e3 for x in ("memory-g", "memory-c", "c")
    ]
    assert "(`best-memory`: {:.1f} k, ANYmal-C {:.1f} instead of {:.1f} k)".format(*memory) in text


def test_what_anchors_are_worth_with_few_robots_is_as_the_page_says():
    """The rule was written before: pairs of fresh seeds, walks, and one and four robots."""
    page = (EXPERIMENTS / "27_few/README.md").read_text()
    part = (EXPERIMENTS / "27_few/parts.md").read_text().split("## Without anchors")[1]
    part = part.split("## Without smaller")[0]
    words = " ".join(part.split())
    few, rows = (
        script("27_few/table"),
        {cells(x)[0]: cells(x)[1:] for x in part.splitlines() if "|" in x},
    )
    names = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}
    pairs, walk = [], [0, 0]
    for robot, letter in names.items():
        told = few.line(
            "",
            few.runs.seeds(few_jobs("anchors")[f"fresh-anchors-{letter}"]),
            [10.0, 15.0, 20.0, 27.0, 43.0],
        )
        assert rows[robot] == told[1][1:]
        (with_seeds, with_), (seeds, without) = (
            few_of(batch, f"{name}-{letter}")
            for batch, name in (("feet", "fresh"), ("anchors", "fresh-anchors"))
        )
        assert [run[0]["seed"] for run in seeds] == [run[0]["seed"] for run in with_seeds]
        pairs.extend((without.level - with_.level) / 1e3)
        walk = [n + np.isfinite(x.walks).sum() for n, x in zip(walk, (without, with_), strict=True)]
    mean, p = np.mean(pairs), scipy.stats.ttest_1samp(pairs, 0).pvalue
    half = scipy.stats.t.ppf(0.975, 29) * np.std(pairs, ddof=1) / 30**0.5
    told = f"{mean:.1f} k steps later without anchors (95 % from {half - mean:.1f} sooner"
    told += f" to {mean + half:.1f} later, p {p:.2f})"
    assert f"{told}, so its end is not below 1.5 k" in words and mean + half > 1.5
    some = np.array(pairs[:10])
    half = scipy.stats.t.ppf(0.975, 9) * some.std(ddof=1) / 10**0.5
    text = "on Go1 alone {:.1f} k later ({:.1f} to {:.1f}, uncorrected)"
    assert text.format(some.mean(), some.mean() - half, some.mean() + half) in words
    assert f"on Go2 {-np.mean(pairs[10:15]):.1f} k sooner" in words
    assert f"{walk[0]} of 30 seeds walk, with anchors {walk[1]}." in words

    def level(name, letter):
        batch = {"robots-1": "parts-2", "robots-4": "one-commit"}.get(name, "robots-2")
        return few_of(batch, f"{name}-{letter}")[1].level / 1e3

    free, mine = level("free-robots-1", "c"), level("robots-1", "c")
    more = "{:.1f} k more, {:.1f} to {:.1f}".format(*stats.difference(free, mine))
    assert f"{free.mean():.1f} instead of {mine.mean():.1f} k steps ({more})" in words.replace(
        "k  m", "k m"
    )
    free, mine = level("free-robots-1", "g"), level("robots-1", "g")
    assert stats.difference(free, mine).low < 0
    assert f"shown, {free.mean():.1f} and {mine.mean():.1f} k" in words
    free, mine = level("free-robots-4", "c"), level("robots-4", "c")
    assert np.isnan(free).sum() == 1
    assert (
        f"after {np.nanmean(free):.1f} k, with anchors all three after {mine.mean():.1f}" in words
    )
    free, mine = level("free-robots-4", "g"), level("robots-4", "g")
    assert f"Go1: {free.mean():.1f} and {mine.mean():.1f} k" in words
    bound = [few_of("robots-2", f"bound50-robots-1-{x}")[1] for x in "gc"]
    text, ranges = " ".join(page.split()), [(x.walks / 1e3).round() for x in bound]
    told = "Go1 from {:.0f} to {:.0f} k on and ANYmal-C from {:.0f} to {:.0f} k on"
    assert told.format(*(f(x) for x in ranges for f in (min, max))) in text
    told = [
        words_of_first(bound[0]),
        "{:.1f} ({:.1f})".format(*(f(bound[1].level) / 1e3 for f in (np.mean, max))),
    ]
    assert "To the level they need {} and {}".format(*told) in text
    for x, of in zip("gc", bound, strict=True):
        assert stats.difference(of.level / 1e3, level("robots-1", x)).low < 0
        seeds = few_of("robots-2", f"bound50-robots-1-{x}")[0]
        assert [run[0]["seed"] for run in seeds] == [0, 1, 2] and all(
            run[-1]["return"] > 20 for run in seeds
        )


PARTS_OF_FEW = {  # what parts.md takes out -> its job
    "nothing: `few`": "whole",
    "imagined robots: 1 for each real one, not 64": "imagined1",
    "remembered rows in the fit": "remembered",
    "a memory": "memory",
    "rounds: 1, not 3 (so no anchors and no new commands)": "rounds1",
    "a symmetric model": "symmetry",
    "anchors: tails begin in rows of the iteration": "anchors",
    "old rows: only a robot's newest 100 are kept": "age100",
    "new commands": "commands",
    "smaller steps late (half of the KL)": "late",
}
OTHER_VALUES = {  # of a part, in parts.md -> its job
    "16 imagined robots for each real one, not 64": "part-imagined16",
    "4 real rows an iteration, not 2": "part-rows4",
    "tails of 16 rows, not 24": "part-tail16",
    "15 remembered rows beside each new one, not 3": "part-remembered15",
    "a weight decay of 0.01 in the model": "part-decay",
    "`spread`: a robot's commands follow each other evenly": "control-spread",
}


def batch_of_part(part, robot):
    """The batch of a cell of parts.md, as the page says."""
    if part == "age100":
        return "age"
    if part not in ("whole", "memory", "commands", "late"):
        return "parts-2"
    if robot in "gc":
        return "parts-cut"
    return "parts-3" if part in ("commands", "late") else "one-commit"


def when_nan(batch, name):
    """Thousand steps of the evaluation from which on all episodes of a seed are falls at no return; NaN."""
    seeds = few_of(batch, name)[0]
    bad = [
        [r["sim_steps"] for r in run if r["fall_rate"] == 1 and r["return"] == 0] for run in seeds
    ]
    return np.array([one[0] / 1e3 if one else np.nan for one in bad])


def test_the_table_of_the_parts_of_few_is_that_of_its_runs():
    """A cell: thousand steps to the level, falls, how many walk; where a policy became NaN, how many did."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    lines = page.split("## Other values")[0].splitlines()
    rows = {cells(line)[0]: cells(line)[1:] for line in lines if "|" in line}
    robots = rows.pop("without")
    rows.pop("---")
    assert robots == ["Go1", "Go2", "ANYmal-C", "ANYmal-D"] and rows.keys() == PARTS_OF_FEW.keys()
    for label, part in PARTS_OF_FEW.items():
        for robot, cell in zip("ghcd", rows[label], strict=True):
            batch, name = batch_of_part(part, robot), f"part-{part}-{robot}"
            cut = cell.endswith(" \\*")
            assert cut == (batch == "parts-cut")
            when, falls, walk = cell.removesuffix(" \\*").split("; ")
            seeds, reached = few_of(batch, name)
            assert [run[0]["seed"] for run in seeds] == [*range(5)], name
            ends = {run[-1]["sim_steps"] for run in seeds}
            assert ends == {44032} or (cut and 33.5e3 < min(ends) and max(ends) < 39e3)
            level = reached.level[np.isfinite(reached.level)] / 1e3
            told = [f"{level.mean():.1f} ({level.max():.1f})"] if len(level) else []
            told += [f"{5 - len(level)} never"] if len(level) < 5 else []
            assert when == ", ".join(told), (name, told)
            assert walk == str(np.isfinite(reached.walks).sum()), name
            if bad := int(np.isfinite(when_nan(batch, name)).sum()):
                assert falls == f"{bad} NaN", name
            else:
                least, most = (26e3, 34.2e3) if cut else (0, np.inf)
                assert shows(falls.removesuffix(" %"), falls_of(batch, name, least, most)), name


def test_what_the_parts_of_few_are_worth_is_as_the_page_says():
    """What parts.md says of its first table, and what took the last falls away, of how many of five walk."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    one, last = page.split("## Without anchors")[0].split("## What takes the last falls away")
    one = one.split("## Other values")[0]
    ends = {cells(line)[0]: cells(line)[1:] for line in last.splitlines() if "|" in line}
    words = " ".join(one.split())

    def level(part, robot):
        return few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[1].level / 1e3

    def falls(part, robot):
        return falls_of(batch_of_part(part, robot), f"part-{part}-{robot}", 26e3, 34.2e3)

    found = {
        part: [np.nan_to_num(level(part, x), nan=np.inf) - level("whole", x) for x in "ghcd"]
        for part in ("imagined1", "remembered", "rounds1", "symmetry", "anchors")
    }
    later = {part: np.sum(np.concatenate(one) > 0.01) for part, one in found.items()}
    assert "1 of 20 runs is at the level by 44 k" in words
    assert sum(np.isfinite(level("imagined1", x)).sum() for x in "ghcd") == 1
    assert later["remembered"] == 20 and "all 20 runs are later" in words
    assert later["symmetry"] == 18 and "in 18 of 20 pairs" in words
    assert all(level("remembered", x).mean() > level("memory", x).mean() for x in "gh")
    saved = [one.mean() for one in found["rounds1"]]
    assert f"**Rounds** save {min(saved):.0f} to {max(saved):.0f} k steps" in words
    anchors = np.concatenate(found["anchors"])
    half = scipy.stats.t.ppf(0.975, 19) * anchors.std(ddof=1) / 20**0.5
    told = (
        f"the level comes {-anchors.mean():.1f} k steps sooner, in the mean of 20 pairs of equal seeds"
        f" (95 % from {half - anchors.mean():.1f} sooner to {anchors.mean() + half:.1f} later,"
        f" p {scipy.stats.ttest_1samp(anchors, 0).pvalue:.2f};"
        f" {np.sum(anchors < -0.01)} sooner, {np.sum(abs(anchors) < 0.01)} the same,"
        f" {later['anchors']} later)"
    )
    assert told in words
    spread = sum(level(part, x).var(ddof=1) / 5 for part in ("whole", "anchors") for x in "ghcd")
    half = scipy.stats.t.ppf(0.975, 32) * spread**0.5 / 4
    told = f"it is {half - anchors.mean():.1f} sooner to {anchors.mean() + half:.1f} later"
    assert f"Unpaired, within robots, {told}" in words
    ten = np.concatenate(found["anchors"][2:])
    told = (
        f"it is {-ten.mean():.1f} k sooner (C {-ten[:5].mean():.1f}, D {-ten[5:].mean():.1f}; of pairs"
        f" p {scipy.stats.ttest_1samp(ten, 0).pvalue:.3f}, seen afterwards; unpaired it is shown on neither)"
    )
    assert told in words
    for one in "cd":
        assert scipy.stats.ttest_ind(level("whole", one), level("anchors", one)).pvalue > 0.05
    told = f"{few_of('one-commit', 'bound50-few-c')[1].level.mean() / 1e3:.1f} instead of"
    assert f"{told} {level('whole', 'c').mean():.1f} k, too" in words
    for part, told in (
        ("anchors", "From 26 to 34 k falls are {}, {}, {} and {} %, with anchors"),
        ("whole", "with anchors {}, {}, {} and {}."),
    ):
        told = re.search(re.escape(told).replace(r"\{\}", r"([\d.]+)"), words)
        assert told is not None
        assert all(shows(x, falls(part, y)) for x, y in zip(told.groups(), "ghcd", strict=True))
    lost = [when_nan("parts-2", f"part-remembered-{x}") for x in "cdh"]
    lost = [f"{np.nanmin(one):.0f} to {np.nanmax(one):.0f} k" for one in lost]
    told = f"at evaluations from {lost[0]} (ANYmal-C), {lost[1]} (ANYmal-D) and {lost[2]} (Go2) on"
    assert told in words
    gone = when_nan("one-commit", "part-memory-d")
    assert f"Five ANYmal-D: at evaluations from {min(gone):.0f} to {max(gone):.0f} k on" in words
    gone = [f"{k:.0f}" for k in when_nan("parts-cut", "part-memory-c")]
    assert [gone.count(k) for k in ("16", "24", "29")] == [1, 3, 1]
    assert "between 13 and 16 k (one), 21 and 24 k (three) and 26 and 29 k (one)" in words
    names = {
        "nothing (batch `wide`, tails of 16, at 45 to 53 k)": "i64rows2",
        "new commands, half of the KL after 160 iterations, as until 2026-11-28": "commands-late",
        "new commands": "end-commands",
        "five rounds, half of the KL": "end-rounds5late",
        "five rounds": "end-rounds5",
        "KL 0.03": "end-kl3",
        "entropy 0.005": "end-entropy5",
        "32 robots, 128 imagined": "end-robots32",
        "256 imagined": "end-imagined256",
        "half of the KL after 160 iterations": "end-late",
        "a quarter of the KL": "end-late4",
        "4 real rows, tails of 32": "end-rows4tail32",
        "episodes of 5 s": "end-episode250",
    }
    assert ends.keys() - {"`few` without new commands, and", "---"} == names.keys()
    for label, name in names.items():
        for letter, cell in zip("gc", ends[label], strict=True):
            job = "wide" if name == "i64rows2" else "end", f"{name}-{letter}"
            walk = [np.isfinite(few_of(*job)[1].walks).sum()] if job[0] == "end" else []
            assert shows(cell, falls_of(*job), *walk), (job, cell)
    text = " ".join(last.split())
    assert f"({few_of('end', 'end-rounds5-g')[1].level.mean() / 1e3:.1f} k on Go1)" in text
    best = [
        few_of("best-commands", f"best-{name}-{x}")[1].level.mean() / 1e3
        for x in "gc"
        for name in ("commands", "now")
    ]
    assert "{:.0f} instead of {:.0f} k (Go1) and {:.0f} instead of {:.0f} k".format(*best) in text


def around_of_pairs(pairs, robots=()):
    """Mean of differences, half of its 95 % interval and p; with `robots`, pairs of lists of seeds, those of
    the unpaired interval within robots."""
    pairs, n = np.asarray(pairs), len(pairs)
    df, error = n - 1, pairs.std(ddof=1) / n**0.5
    if robots:
        error = sum((np.var(x, ddof=1) + np.var(y, ddof=1)) / 5 for x, y in robots) ** 0.5 / 4
        df = 32
    p = 2 * scipy.stats.t.sf(abs(pairs.mean()) / error, df)
    return pairs.mean(), scipy.stats.t.ppf(0.975, df) * error, p


def test_other_values_of_the_parts_of_few_are_as_the_page_says():
    """The table, and pairs of equal seeds over four robots, of twelve tests by Holm."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    part = page.split("## Other values")[1].split("## What takes the last falls away")[0]
    words = " ".join(part.split())
    rows = {cells(line)[0]: cells(line)[1:] for line in part.splitlines() if "|" in line}
    assert rows.keys() - {"`few` with", "---"} == OTHER_VALUES.keys()
    tests = {}
    for label, name in OTHER_VALUES.items():
        batch, pairs = (
            "spread" if name.startswith("control") else "parts-4",
            {"level": [], "falls": []},
        )
        for robot, cell in zip("ghcd", rows[label], strict=True):
            job = batch, f"{name}-{robot}"
            seeds, reached = few_of(*job)
            assert [run[0]["seed"] for run in seeds] == [*range(5)] and seeds[0][-1][
                "sim_steps"
            ] > 42.9e3
            when, falls, walk = cell.split("; ")
            assert when == first_of(*job) and shows(falls.removesuffix(" %"), falls_of(*job))
            assert walk == str(np.isfinite(reached.walks).sum())
            whole = batch_of_part("whole", robot), f"part-whole-{robot}"
            pairs["level"].extend((reached.level - few_of(*whole)[1].level) / 1e3)
            mine, other = (
                [
                    np.mean([r["fall_rate"] for r in run if 26e3 <= r["sim_steps"] <= 34.2e3][-4:])
                    for run in few_of(*one)[0]
                ]
                for one in (job, whole)
            )
            pairs["falls"].extend(100 * (np.array(mine) - other))
        tests |= {(name, what): around_of_pairs(some) for what, some in pairs.items()}
    holm = dict(zip(tests, stats.holm([p for *_, p in tests.values()]), strict=True))
    assert [key for key, p in holm.items() if p < 0.05] == [("part-imagined16", "level")]
    mean, half, p = tests["part-imagined16", "level"]
    told = f"comes {mean:.1f} k steps later, in the mean of 20 pairs of equal seeds (95 % from"
    told += f" {mean - half:.1f} to {mean + half:.1f} later, p {p:.4f};"
    assert f"{told} {holm['part-imagined16', 'level']:.3f} by Holm" in words
    means = {
        what: [mean for (name, of), (mean, *_) in tests.items() if of == what and name[-2:] != "16"]
        + [tests["part-tail16", what][0]]
        for what in ("level", "falls")
    }
    told = "to the level {:.1f} k sooner (decay, `spread`) to {:.1f} k later (15 remembered"
    assert told.format(-min(means["level"]), max(means["level"])) in words
    told = "falls {:.1f} points fewer (`spread`) to {:.1f} more (15 remembered rows, where one"
    assert told.format(-min(means["falls"]), max(means["falls"])) in words
    mean, half, _ = tests["part-remembered15", "falls"]
    assert f"{half - mean:.1f} fewer to {mean + half:.1f} more)" in words
    assert min(means["level"]) == tests["part-decay", "level"][0]
    assert all(f"{tests[x, 'level'][0]:.1f}" == "-0.6" for x in ("part-decay", "control-spread"))
    walk = [few_of("spread", f"control-spread-{x}")[1].walks for x in "ghcd"]
    whole = [few_of(batch_of_part("whole", x), f"part-whole-{x}")[1].walks for x in "ghcd"]
    told = f"alone has all {np.size(walk)} seeds walking at the end, `few` {np.isfinite(whole).sum()} of 20"
    assert np.isfinite(walk).all() and told in words
    assert all(line.count("; 5 |") < 4 for line in part.splitlines() if "spread" not in line)


def test_why_smaller_steps_late_have_gone_from_few_is_as_the_page_says():
    """The rule was written before: pairs of fresh seeds, falls at their end and walks."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text().split("## Without smaller steps late")[1]
    text = (EXPERIMENTS / "27_few/README.md").read_text()
    words, few = " ".join(page.split()), script("27_few/table")
    names = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}
    fewer, later, walk, both, told_of = [], [], [[], []], [], []
    for of, runs in (
        (page, lambda x: few_of("feet", f"fresh-{x}")[0]),
        (text.split("## Fresh seeds")[1], lambda x: few_fresh(x)[0]),
    ):
        rows = {cells(x)[0]: cells(x)[1:] for x in of.splitlines()[:25] if "|" in x}
        for robot, letter in names.items():
            assert rows[robot] == few.line("", runs(letter), [10.0, 15.0, 20.0, 27.0, 43.0])[1][1:]
    for letter in "ghcd":
        (with_seeds, with_), (seeds, without) = (
            few_of(*job) for job in (("feet", f"fresh-{letter}"), ("late", f"fresh-late-{letter}"))
        )
        assert [run[0]["seed"] for run in seeds] == [run[0]["seed"] for run in with_seeds]
        ends = [
            100 * np.mean([[r["fall_rate"] for r in run[-4:]] for run in some], 1)
            for some in (seeds, with_seeds)
        ]
        fewer.extend(ends[0] - ends[1])
        told_of.append(ends[0].mean())
        later.extend((without.level - with_.level) / 1e3)
        both.append(np.mean([*without.level, *with_.level]) / 1e3)
        for counts, one in zip(walk, (without, with_), strict=True):
            counts.append(int(np.isfinite(one.walks).sum()))
    mean, half, p = around_of_pairs(fewer)
    assert mean + half < 0.3 and sum(walk[0]) >= sum(walk[1]) - 1  # the rule
    told = f"{-mean:.2f} points fewer without it (95 % from {half - mean:.2f} fewer to {mean + half:.2f}"
    assert (
        f"{told} more, p {p:.2f}), and {sum(walk[0])} instead of {sum(walk[1])} seeds walk" in words
    )
    assert walk == [[9, 5, 10, 4], [10, 3, 9, 5]]
    mean, half, p = around_of_pairs(later)
    told = f"{mean:.1f} k steps later without it ({half - mean:.1f} sooner to"
    assert f"{told} {mean + half:.1f} later, p {p:.2f})" in words
    walk = [np.isfinite(few_of("commands", f"few-940-{x}")[1].walks).sum() for x in "ghcd"]
    assert f"{sum(walk)} of 30 other seeds walked without it" in words
    text = " ".join(text.split())
    mean, half, _ = around_of_pairs(fewer)
    assert f"worth at most {mean + half:.2f} points of falls (95 %), where 0.3 was allowed" in text
    mean, half, _ = around_of_pairs(later[:10])
    told = f"on Go1 alone {mean:.1f} k ({half - mean:.1f} sooner to {mean + half:.1f} later)"
    assert told in words


def test_what_fresh_seeds_of_few_do_is_as_the_page_says():
    """All batches in its sentences; by hand, the two that table.py pools."""
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    both = [(few_of("more", f"more-few-{x}"), few_of("late", f"fresh-late-{x}")) for x in "ghcd"]
    all_of = [few_fresh(x) for x in "ghcd"]
    for pair, (seeds, reached) in zip(both, all_of, strict=True):
        assert len(seeds) == sum(len(one) for one, _ in pair)
        np.testing.assert_allclose(
            np.sort(reached.level), np.sort(np.concatenate([one.level for _, one in pair]))
        )
    ends = [
        100 * np.mean([[r["fall_rate"] for r in run[-4:]] for run in seeds]) for seeds, _ in all_of
    ]
    told = "In the last four evaluations {:.1f}, {:.1f}, {:.1f} and {:.1f} % of the episodes have a fall"
    assert told.format(*ends) in text
    level = [one.level.mean() / 1e3 for pair in both for _, one in pair]
    told = "reached after {:.1f} and {:.1f} k (Go1), {:.1f} and {:.1f} (Go2), {:.1f} and {:.1f} (ANYmal-C),"
    assert (told + " {:.1f} and {:.1f} (ANYmal-D)").format(*level) in text
    walk = [[int(np.isfinite(one.walks).sum()) for _, one in pair] for pair in both]
    assert walk == [[20, 9], [7, 5], [20, 10], [8, 4]]
    told = "Of the 60 seeds of `more` 55 walk, with all twenty Go1 and all twenty ANYmal-C, of the 30 of"
    assert f"{told} `late` 28." in text
    told = "29 of 30 Go1 and all 30 ANYmal-C walk, as do 12 of 15 Go2 and 12 of 15 ANYmal-D. The seven others"
    assert told in text
    held = [
        sum(row["sim_steps"] >= when for row in run)  # never, where it does not walk
        for seeds, one in all_of
        for run, when in zip(seeds, one.walks, strict=True)
    ]
    held = [n for n in held if n]
    told = f"Of the {len(held)} that walk {sum(n >= 4 for n in held)} do so in the last four evaluations or"
    assert f"{told} more, seven in the last alone" in text and held.count(1) == 7
    at = [one.walks / 1e3 for _, one in all_of]
    told = (
        "from {:.0f} to {:.0f} k on (means: Go1 {:.0f} k, Go2 {:.0f} k, ANYmal-C {:.0f} k, ANYmal-D"
    )
    every = np.concatenate(at)
    told = (told + " {:.0f} k)").format(np.nanmin(every), np.nanmax(every), *map(np.nanmean, at))
    assert told in text
    level = [all_of[k][1].level for k in (0, 2)]
    told = "64 Go1 need {:,.0f} simulator steps (mean of thirty fresh seeds, ten of which also [decided one"
    told += " setting](#fresh-seeds); the last {:,.0f}), 64 ANYmal-C {:,.0f} (the last {:,.0f})."
    hundreds = [100 * round(f(x) / 100) for x in level for f in (np.mean, np.max)]
    assert told.format(*hundreds) in text
    assert [round(x.mean() / 3000, 1) for x in level] == [5.1, 6.4]
    assert "That is five and six and a half minutes of one robot's time" in text
    last = [
        100 * run[-1]["fall_rate"]
        for seeds, reached in all_of
        for run, at in zip(seeds, reached.walks, strict=True)
        if np.isnan(at)
    ]
    far = [
        run[-1]["return"] / few_level
        for (seeds, reached), few_level in zip(all_of, (38, 38, 24, 24), strict=True)
        for run, at in zip(seeds, reached.walks, strict=True)
        if np.isnan(at)
    ]
    assert len(last) == 7 and min(far) > 1.05
    assert f"fall in {min(last):.1f} to {max(last):.1f} % of their last episodes" in text


def test_what_spread_commands_and_newer_rows_are_worth_is_as_the_page_says():
    """The tables, and the verdicts of rules that were written before; the first try by hand."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text().split("## Spread commands")[1]
    spread, recent = page.split("## Rows that weigh less with age")
    rules, table = script("27_few/rules"), script("27_few/table")
    rows = {cells(x)[0]: cells(x)[1:] for x in spread.splitlines() if "|" in x}
    fewer, walk = [], []
    for letter, robot in table.ROBOTS.items():
        first, its = (
            few_of(*x)
            for x in (("fresh-spread", f"fresh-spread-{letter}"), ("late", f"fresh-late-{letter}"))
        )
        again = few_of("more", f"more-spread-{letter}")
        seeds = [*first[0], *again[0]]
        assert rows[robot] == table.line("", seeds, [10.0, 15.0, 20.0, 27.0, 43.0])[1][1:]
        assert [run[0]["seed"] for run in first[0]] == [run[0]["seed"] for run in its[0]]
        ends = [[np.mean([r["fall_rate"] for r in run[-4:]]) for run in x] for x, _ in (first, its)]
        fewer.extend(100 * np.subtract(*ends))
        walk.append([int(np.isfinite(one.walks).sum()) for _, one in (first, its)])
    mean, half, p = around_of_pairs(fewer)
    told = (
        f"{-mean:.2f} points fewer (95 % from {half - mean:.2f} fewer to {mean + half:.2f} more, p"
    )
    total = np.sum(walk, 0)
    assert f"{told} {p:.3f}), and {total[0]} instead of {total[1]} seeds walked" in " ".join(
        spread.split()
    )
    rows = {cells(x)[0]: cells(x)[1:] for x in recent.splitlines() if "|" in x}
    for label, name in (
        ("all rows alike", "part-whole"),
        ("newer rows more often", "control-recent"),
    ):
        for letter, cell in zip("ghcd", rows[label], strict=True):
            seeds, reached = few_of("recent", f"{name}-{letter}")
            fell = 100 * np.mean([[r["fall_rate"] for r in run[-4:]] for run in seeds])
            told = (
                f"{words_of_level(reached.level)}; {fell:.1f} %; {np.isfinite(reached.walks).sum()}"
            )
            assert cell == told, (label, letter)
    *_, every, verdict = rules.pairs(
        few_jobs("recent"), "control-recent", "part-whole", rules.sooner, 20
    )
    assert every.startswith("  all: -0.13 (-1.66 to 1.40, 20 pairs)") and verdict.endswith(
        "not met"
    )
    assert "0.1 k steps sooner (1.7 sooner to 1.4 later)" in " ".join(recent.split())
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    assert "60 pairs of fresh seeds: falls 0.02 points more, 0.14 fewer to 0.19 more;" in text


def test_the_picture_has_other_methods_where_docs_numbers_has_them():
    """And seconds with those of both files, sixteen seeds of `best`."""
    plot = script("27_few")
    fresh, many = few_fresh("g")[0], few_jobs("default")["default-g"]
    few, best = plot.timed()
    found = dict(plot.level_of_each([row for run in fresh for row in run], many, few[4][:, 1]))
    with (EXPERIMENTS.parent / "docs/numbers.csv").open(newline="") as file:
        known = {
            row["name"]: float(row["value"]) for row in csv.DictReader(file) if "38" in row["name"]
        }
    names = {
        "few, 64": ("go1 few, first at 38", 1),
        "CrossQ, symmetric, 64": ("go1 CrossQ with 64 robots, first at 38", 1),
        "CrossQ, symmetric, 256": ("go1 CrossQ with 256 robots, first at 38", 1e3),
        "best, 1024": ("go1 first at 38", 1e3),
        "SAC, symmetric, 256": ("go1 symmetric SAC first at 38", 1e3),
        "PPO alone, 128": ("go1 PPO first at 38", 1e3),
    }
    for name, (of, unit) in names.items():
        np.testing.assert_allclose(found.pop(name).mean(), unit * known[of], rtol=1e-4)
    assert {name: len(x) for name, x in found.items()} == {"few, 4 robots": 3, "few, 256": 10}
    assert {n: len(x) for n, x in few.items()} == {1: 3, 4: 3, 16: 3, 64: 5, 256: 19, 1024: 3}
    assert len(best) == 16


def test_the_seconds_of_few_robots_are_those_of_their_runs():
    """The table is the script's; one line of it by hand; what the page says of it and of `best` beside it."""
    table, page = script("27_few/table"), (EXPERIMENTS / "27_few/README.md").read_text()
    cost, measure = script("30_row_cost/table"), script("30_row_cost/run")
    path = EXPERIMENTS / "27_few/results/seconds.csv.xz"
    found = {one.robots: one for one in table.alone(path)}
    part = page.split("### Seconds")[1].split("## How it works")[0]
    lines = [cells(line) for line in part.splitlines() if "|" in line]
    assert lines == [cells(line) for line in table.seconds([*found.values()]).splitlines()]
    with lzma.open(path, "rt", newline="") as file:
        runs = [row for row in csv.DictReader(file) if row["name"] == "few-64-g"]
    by_seed = [[r for r in runs if r["seed"] == f"{seed}"] for seed in range(1100, 1105)]
    there = [next(r for r in run if float(r["return"]) >= 38) for run in by_seed]
    steps, seconds = ([float(r[name]) for r in there] for name in ("sim_steps", "seconds"))
    mine = next(line for line in lines if line[0] == "64")
    told = f"{np.mean(steps) / 1e3:.1f} ({max(steps) / 1e3:.1f})"
    assert mine[1:3] == [told, f"{np.mean(seconds):.2f} ({max(seconds):.2f})"]
    ms = [1e3 * float(run[-1]["seconds"]) / int(run[-1]["iteration"]) for run in by_seed]
    some = [float(runs[0][f"{name}_ms"]) for name in ("row", "fit", "tail", "ppo")]
    some = [n * x for n, x in zip((2, 1, 3 * 24, 3), some, strict=True)]
    assert mine[4:6] == [f"{np.mean(ms):.1f}", " + ".join(f"{x:.1f}" for x in some)]

    text, words = " ".join(page.split()), " ".join(part.split())
    level = {robots: one.level.mean(0) for robots, one in found.items()}
    told = [f"{x[2]:.1f}" for x in level.values()]
    told = f"1024 Go1 are at the level after {', '.join(told[:-1])} and {told[-1]} s (three seeds; 64: five)."
    assert f"1, 4, 16, 64, 256 and {told}" in text and [*found] == [1, 4, 16, 64, 256, 1024]
    few = [100 * round(level[robots][1] / 100) for robots in found]
    told = (
        "1, 4 and 16 Go1 need {:,.0f}, {:,.0f} and {:,.0f} steps (three seeds each, all nine walk)"
    )
    assert told.format(*few) in text and f"timed alone on a card, need [{few[3]:,.0f}]" in text
    assert f"1024 need {few[5]:,.0f} (three)." in text
    readme = " ".join((EXPERIMENTS.parent / "README.md").read_text().split())
    walks = [np.isfinite(few_fresh(x)[1].walks) for x in "ghcd"]
    told = f"{sum(x.sum() for x in walks)} of {sum(map(len, walks))} fresh seeds of four robots walk (Go1"
    assert f"{told} {walks[0].sum()} of {len(walks[0])})" in readme
    for robots, one in found.items():
        count = 5 if robots == 64 else 3
        assert len(one.level) == count and np.isfinite(one.level).all()
        assert np.isfinite(one.walks[:, 0]).sum() == count - (robots == 1024)
    apart = stats.difference(found[64].level[:, 1] / 1e3, found[4].level[:, 1] / 1e3)
    told = f"four Go1 need {apart.value:.1f} k steps fewer than 64 (95 % from {apart.low:.1f} to"
    assert f"{told} {apart.high:.1f}, three and five seeds" in text and apart.low > 0

    ms = {n: (1e3 * one.end[:, 2] / one.end[:, 0]).mean() for n, one in found.items()}
    with lzma.open(path, "rt", newline="") as file:
        rows = [*csv.DictReader(file)]
    assert {row["commit"] for row in rows} == {"8155a0a11fe5-dirty"}
    first = {row["name"]: int(row["iteration"]) for row in reversed(rows)}
    every = {n: first[f"few-{n}-g"] * ms[n] / 1e3 for n in found}
    seldom = [every[n] for n in (1, 4, 16, 64)]
    told = f"every {min(seldom):.1f} to {max(seldom):.1f} s with up to 64 robots"
    assert f"{told}, {every[256]:.1f} with 256 and {every[1024]:.1f} with 1024" in words
    costs = [float(row["row_ms"]) for row in rows]
    told = (
        f"same**, {min(costs):.2f} to {max(costs):.2f} ms, for 1 to 1024 robots, and an iteration"
    )
    assert f"{told} takes {min(ms.values()):.0f} to {max(ms.values()):.0f} ms." in words
    told = "robots take {:.0f}, {:.0f}, {:.0f} and {:.0f} to the level, 256 and 1024 take {:.0f} and {:.0f}."
    assert told.format(*(x[0] for x in level.values())) in words
    over = [100 * (sum(one.parts) / ms[n] - 1) for n, one in found.items()]
    assert f"add up to {min(over):.0f} to {max(over):.0f} % more than an iteration took" in words
    share = np.array([100 * np.array(one.parts) / sum(one.parts) for one in found.values()])
    told = "{:.0f} to {:.0f} % of the parts, tails {:.0f} to {:.0f} %, the fit {:.0f} to {:.0f} %"
    ends = [f(share[:, k]) for k in (3, 2, 1) for f in (min, max)]
    assert told.format(*ends) in words
    told = (
        f"Real rows are {share[0, 0]:.0f} % with one robot, which has 64 of them an iteration, and"
    )
    assert f"{told} 1 % with 64 or more" in words
    assert {f"{x:.0f}" for x in share[3:, 0]} == {"1"}
    assert f"about {level[1][2]:.0f} s of training for {level[1][1] / 1e3:.0f} k steps" in words
    assert f"which are {level[1][1] / 3000:.1f} minutes of its own time" in words
    for n in (256, 1024):
        assert f"after {level[n][2]:.2f} s and {level[n][1] / 1e3:.1f} k steps" in words
    many = found[1024]
    assert len({*many.level[:, 1]}) == 1 and many.end[0, 1] in many.walks[:, 1]
    last = [row for row in rows if row["name"] == "few-1024-g" and row["iteration"] == "60"]
    last = [100 * float(row["fall_rate"]) for row in last]
    assert f"in {max(last):.1f} % of its episodes" in words
    assert np.isnan(many.walks[last.index(max(last)), 0])

    alone = [few_of("parts-2", f"robots-1-{x}")[0] for x in "gc"]
    ends = [run[-1]["return"] for seeds in alone for run in seeds]
    ends += [float(r["return"]) for r in rows if (r["name"], r["iteration"]) == ("few-1-g", "700")]
    assert (len(ends), ends.count(0)) == (9, 1) and "none of six did, without one of nine" in text

    hosts = "H200, 2026-11-27", "H200, 2026-11-27, second host"
    runs = {(run.batch, run.method): run for run in cost.runs() if run.place == "go1.kernel"}
    best, ppo = ([runs[host, name] for host in hosts] for name in ("best", "ppo2048"))
    told = "{} and {} s after {:.0f} and {:.0f} k steps, and {:.2f} and {:.2f} s to a walk"
    around = [table.runs.spread(one.level[:, 2], 2) for one in best]
    steps = [one.level[:, 1].mean() for one in best]
    walk = [one.walks[:, 2].mean() for one in best]
    assert told.format(*around, *(x / 1e3 for x in steps), *walk) in words
    told = "{:.2f} and {:.2f} s, after {:.1f} and {:.1f} M steps".format(
        *(one.level[:, 2].mean() for one in ppo), *(one.level[:, 1].mean() / 1e6 for one in ppo)
    )
    assert f"PPO alone with 2048 robots was sooner there: {told}" in words
    assert all(len(one.level) == 5 for one in [*best, *ppo])
    asked = [r for r in cost.read() if r["batch"] in hosts and r["name"] == "go1.kernel.best"]
    assert {r["seed"] for r in asked} == {f"{seed}" for seed in range(1100, 1105)}
    at = sorted({int(r["sim_steps"]) for r in asked})
    told = f"(seeds 1100 to 1104, {measure.EPISODES} episodes an evaluation, one every"
    assert f"{told} {(at[4] - at[3]) / 1e3:.0f} k steps;" in words
    assert all("episodes=" not in r["job"] for r in asked)


def test_seconds_of_few_robots_are_packed_as_the_file_has_them(tmp_path):
    """Out of seconds.csv.xz and in again; a job of the same name is replaced, the others stay."""
    table, path = script("27_few/table"), EXPERIMENTS / "27_few/results/seconds.csv.xz"
    text = lzma.decompress(path.read_bytes()).decode()
    head, *lines = text.splitlines(keepends=True)
    for line in lines:
        name, _, rest = line.partition(",")
        with (tmp_path / f"{name}.csv").open("a") as file:
            file.write(rest if file.tell() else head.removeprefix("name,") + rest)
    to = tmp_path / "seconds.csv.xz"
    for _ in range(2):
        table.pack(to, tmp_path)
        assert lzma.decompress(to.read_bytes()).decode() == text
    with pytest.raises(SystemExit, match="has no NAME.csv of 30_row_cost/run.py"):
        table.pack(to, tmp_path / "nothing")


def test_seconds_of_two_configs_are_told_apart_and_compared(tmp_path, monkeypatch, capsys):
    """default.txt's two on a Go1: at the level after 2, 3, 4 s and 1, 2, 3; then a seed is not there."""
    table, jobs = script("27_few/table"), EXPERIMENTS / "27_few/default.txt"
    jobs = dict(line.split(None, 1) for line in jobs.read_text().splitlines())
    head = "job,row_ms,tail_ms,fit_ms,ppo_ms,seed,iteration,sim_steps,seconds,return,fall_rate\n"

    def write(name, seconds, back=40):
        rows = [f"{jobs[name]},1,1,1,1,{s},9,99,{t},{back},0\n" for s, t in enumerate(seconds)]
        (tmp_path / f"{name}.csv").write_text(head + "".join(rows))

    def printed():
        words = ["table.py", str(tmp_path / "x.csv.xz"), "--seconds", "--pack", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", words)
        table.main()
        rows, *lines = capsys.readouterr().out.strip().split("\n\n")
        return [cells(line)[:2] for line in rows.splitlines()[2:]], lines

    write("default-g", (2, 3, 4))
    assert printed() == ([["256", "0.1 (0.1)"]], [])
    write("best-g", (1, 2, 3))
    found = stats.ratio([2, 3, 4], [1, 2, 3])
    line = "seconds to the level, default-g by best-g, {} and {} seeds: "
    assert printed() == (
        [["go1:few", "256"], ["go1:best", "1024"]],
        [f"{line.format(3, 3)}1.50 ({found.low:.2f} to {found.high:.2f})"],
    )
    write("default-g2", (5, 6))
    found = stats.ratio([2, 3, 4, 5, 6], [1, 2, 3])
    assert printed()[1] == [f"{line.format(5, 3)}2.00 ({found.low:.2f} to {found.high:.2f})"]
    write("best-g", (1, 2, 3), back=30)  # with all of its run, here one evaluation
    assert printed()[1] == [f"{line.format(5, 3)}2.00 ({found.low:.2f} to {found.high:.2f})"]
    write("default-g2", (5, 6), back=30)
    told = "3 of 5 seeds get there and 3 of 3 seeds get there"
    assert printed()[1] == [f"{line.format(5, 3)}{told}"]


def test_what_the_other_parts_of_few_are_worth_is_as_the_page_says():
    """Old rows, new commands, smaller steps late: pairs of equal seeds over four robots, and falls of the
    four evaluations from 26 to 34 k, which all have."""
    page = (EXPERIMENTS / "27_few/parts.md").read_text()
    words = " ".join(page.split("## Other values")[0].split())

    def seeds(part, robot, least=26e3, most=34.2e3):
        runs = few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[0]
        some = [
            [r["fall_rate"] for r in run if least <= r["sim_steps"] <= most][-4:] for run in runs
        ]
        return 100 * np.mean(some, 1)

    def level(part, robot):
        got = few_of(batch_of_part(part, robot), f"part-{part}-{robot}")[1].level / 1e3
        return np.where(np.isnan(got), 44.032, got)

    parts, tests = ("age100", "commands", "late"), {}
    for part in parts:
        for of in (level, seeds):
            pairs = np.concatenate([of(part, x) - of("whole", x) for x in "ghcd"])
            tests[part, of] = around_of_pairs(pairs)
    holm = dict(zip(tests, stats.holm([p for *_, p in tests.values()]), strict=True))
    assert [key for key, p in holm.items() if p < 0.05] == [("commands", seeds)]

    def sooner(mean, half):
        return f"({half - mean:.1f} sooner to {mean + half:.1f} later)"

    mean, half, p = tests["commands", seeds]
    told = f"falls are {mean:.1f} points more without them, in the mean of 20 pairs of equal"
    told += f" seeds (95 % from {mean - half:.1f} to {mean + half:.1f} more, p {p:.3f})"
    assert f"From 26 to 34 k {told}." in words
    assert f"the one below, p is {holm['commands', seeds]:.3f}." in words
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    assert f"(without them falls are {mean:.1f} points more, over the four)" in text
    assert (
        "no difference to the level is shown for 19 of 20 seeds. One ANYmal-C is not there" in text
    )
    robots = [(seeds("commands", x), seeds("whole", x)) for x in "ghcd"]
    _, half, p = around_of_pairs(np.concatenate([x - y for x, y in robots]), robots)
    assert p < 0.05 and f"it is {mean - half:.1f} to {mean + half:.1f} more. Each robot" in words
    told = re.search(r"Each robot falls more, in (.+?) instead of (.+?), but on none", words)
    for text, column in zip(told.groups(), zip(*robots, strict=True), strict=True):
        assert shows(text, *(np.mean(x) for x in column))
    assert all(np.mean(x) > np.mean(y) and stats.welch_of(x, y) > 0.05 for x, y in robots)
    new = [seeds("commands", x, 0, np.inf) - seeds("whole", x, 0, np.inf) for x in "hd"]
    mean, half, _ = around_of_pairs(np.concatenate(new))
    told = f"evaluations {mean:.1f} points more (ten pairs, {half - mean:.1f} fewer to"
    told += f" {mean + half:.1f} more)"
    assert told in words
    mean, half, _ = tests["commands", level]
    assert f"{-mean:.1f} k steps sooner without {sooner(mean, half)}" in words

    mean, half, p = tests["late", seeds]
    told = f"falls are {-mean:.1f} points fewer without them (20 pairs, {half - mean:.1f} fewer"
    assert f"{told} to {mean + half:.1f} more, p {p:.2f})" in words
    steps = schedule.sim_steps(config_lib.validate(config_lib.load("configs/go1.py:few")))
    assert f"began at {steps[160 - 1] / 1e3:.1f} k" in words
    ends = {
        (part, x): [seeds(part, x, 0, np.inf), seeds("whole", x, 0, np.inf)]
        for part in parts
        for x in "hd"
    }
    corrected = dict(
        zip(ends, stats.holm([stats.welch_of(*pair) for pair in ends.values()]), strict=True)
    )
    got = stats.difference(*ends["late", "d"])
    told = f"({-got.high:.1f} to {-got.low:.1f} fewer, Welch's p {stats.welch_of(*ends['late', 'd']):.3f},"
    assert f"{told} {corrected['late', 'd']:.3f} by Holm of six such, seen afterwards)" in words
    got = stats.difference(*ends["late", "h"])
    assert f"({-got.low:.1f} fewer to {got.high:.1f} more). But fresh" in words
    told = re.search(r"ANYmal-D has ([\d.]+) instead of ([\d.]+) % without", words).groups()
    told += re.search(r"Go2 ([\d.]+) instead of ([\d.]+) \(", words).groups()
    means = [np.mean(x) for robot in "dh" for x in ends["late", robot]]
    assert all(shows(x, mean) for x, mean in zip(told, means, strict=True))
    assert f"*with* them have {falls_of('feet', 'fresh-d'):.1f} %, too" in words
    for robot in "ghcd":
        some = seeds("late", robot), seeds("whole", robot)
        assert stats.welch_of(*some) > 0.05 and np.mean(some[0]) < np.mean(some[1])

    mean, half, _ = tests["age100", level]
    assert f"it is {mean:.1f} k later {sooner(mean, half)}" in words
    raw = np.concatenate([few_of("age", f"part-age100-{x}")[1].level / 1e3 for x in "ghcd"])
    pairs = raw - np.concatenate([level("whole", x) for x in "ghcd"])
    assert np.isnan(pairs).nonzero()[0].tolist() == [10]
    mean, half, _ = around_of_pairs(pairs[np.isfinite(pairs)])
    told = (
        f"19 of 20 runs get to the level, {-mean:.1f} k steps sooner than the run of the same seed"
    )
    told += " (95 % from"
    assert f"{told} {half - mean:.1f} sooner to {mean + half:.1f} later)" in words
    mean, half, _ = tests["age100", seeds]
    told = f"in the mean {mean:.1f} points more than with all rows ({half - mean:.1f} fewer"
    assert f"{told} to {mean + half:.1f} more)" in words
    told = re.search(r"From 26 to 34 k ([^%]+) % of the episodes have a fall, in the mean", words)
    assert shows(told[1], *(np.mean(seeds("age100", x)) for x in "ghcd"))
    runs = {
        (x, i): run for x in "ghcd" for i, run in enumerate(few_of("age", f"part-age100-{x}")[0])
    }
    lost = {  # where all but one in a hundred fall
        key: [r["sim_steps"] / 1e3 for r in run if r["fall_rate"] >= 0.99 and r["sim_steps"] > 1e4]
        for key, run in runs.items()
    }
    lost = {key: [f"{k:.0f}" for k in at] for key, at in lost.items() if at}
    assert lost == {
        ("g", 4): ["11", "13", "16"],
        ("c", 0): ["13", "16", "18", "21", "34", "36", "39"],
    }
    assert (
        "two runs fall in 99 % of their episodes or more for a while: a Go1 from 11 to 16 k"
        in words
    )
    assert "the twentieth, an ANYmal-C, from 13 to 21 k and from 34 to 39 k. It is" in words
    last = few_of("age", "part-age100-c")[0][0][-1]["return"]
    assert shows(re.search(r"is at ([\d.]+) at the end, just below", words)[1], last)
    others = [
        run
        for x in "ghcd"
        for job in ((batch_of_part("whole", x), f"part-whole-{x}"), ("feet", f"fresh-{x}"))
        for run in few_of(*job)[0]
    ]
    mine, its = (
        np.array([max(r["fall_rate"] for r in run if r["sim_steps"] > 15e3) for run in some])
        for some in (runs.values(), others)
    )
    assert (len(its), max(its)) == (50, 0.12) and "at most 12 % in each of 50 runs" in words
    assert [np.sum(x > 0.9) for x in (mine, its)] == [2, 0]
    fisher = scipy.stats.fisher_exact([[2, 18], [0, 50]])[1]
    assert (
        f"(2 of 20 and 0 of 50 have more than 90: Fisher's p {fisher:.2f}, seen afterwards)"
        in words
    )

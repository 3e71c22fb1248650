"""23_untuned: fresh seeds of `best` and tuned PPO by their rule, and the tables of the other runs."""

import re

import numpy as np
import pytest
from result_files import EXPERIMENTS, LESS, LETTERS, cells, less, script

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats

FOLDER = EXPERIMENTS / "23_untuned"
PAGE = (FOLDER / "README.md").read_text()
WORDS = " ".join(PAGE.split())
ROBOTS = {"anymal_b": "ANYmal-B", "spot": "Spot"}
FRESH = "Today's `best` beside tuned PPO"
TITLES = {  # jobs of fresh.txt and ppo_more_fresh.txt -> rows of the table
    "anymal_b-best": "ANYmal-B, `best`",
    "walks-anymal_b-grid-512-kl3": "ANYmal-B, PPO chosen to walk, 512 robots",
    "walks-anymal_b-grid-256-kl3-gamma98": "ANYmal-B, PPO chosen to walk, 256 robots, gamma 0.98",
    "level-anymal_b-grid-128-kl5": "ANYmal-B, PPO chosen for the level, 128 robots, KL 0.05",
    "level-anymal_b-grid-128-kl3": "ANYmal-B, PPO chosen for the level before, 128 robots",
    "spot-best": "Spot, `best`",
    "walks-spot-grid-256-kl3": "Spot, PPO chosen to walk, 256 robots",
    "level-spot-grid-128-kl4": "Spot, PPO chosen for the level, 128 robots, KL 0.04",
}
CHOSEN = {  # PPO that stands for a walk
    "anymal_b": "walks-anymal_b-grid-512-kl3",
    "spot": "walks-spot-grid-256-kl3",
}


def read(name, batch=None):
    """The table script of 21_less, and a packed file of this folder."""
    table = script("21_less/table")
    return table, table.read(FOLDER / f"results/{name}.csv.xz", batch)


def part(title):
    """Rows of the tables under a heading: name -> cells, without bold."""
    text = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = [cells(line) for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1:] for row in rows}


def row_of(table, job):
    """Cells of a job's line by table.py, without its name and count of seeds."""
    return cells(table.table({"x": job}, table.best(job)).splitlines()[2])[2:]


def head_of(table, job):
    """The line above it, the same way."""
    return cells(table.table({"x": job}, table.best(job)).splitlines()[0])[1:]


def falls_then(table, job):
    """Per cent of episodes with a fall when first at 24: mean, and the worst seed's."""
    then = [100 * table.first(run, 24, "fall_rate") for run in table.seeds(job)]
    return f"{np.mean(then):.1f} % (up to {max(then):.1f} %)"


def title_of(name):
    """A job of ppo.txt or ppo_more.txt, as the page's table calls it."""
    robot, _, robots, kl, *rest = name.split("-")
    more = {
        "gamma98": "gamma 0.98",
        "lam95": "lambda 0.95",
        "ep10": "10 epochs",
        "mb8": "8 minibatches",
    }
    return ", ".join(
        [ROBOTS[robot], f"{robots} robots", f"KL 0.0{kl[2:]}", *(more[r] for r in rest)]
    )


def costs(goal, robot, jobs):
    """By choose.py, each setting of a robot, the lowest first; of equal ones the highest last return."""
    choose = script("21_less/choose")
    mine = {n: choose.cost(job, goal) for n, job in jobs.items() if n.startswith(robot)}
    order = sorted(mine, key=lambda n: (mine[n], -choose.last_return(jobs[n])))
    return {name: mine[name] for name in order}


def soonest(goal):
    """Of each robot the one of ppo.txt with the lowest cost by choose.py: its name without the robot, its
    job."""
    choose, (_, jobs) = script("21_less/choose"), read("ppo", "2")
    found = {}
    for robot in ROBOTS:
        mine = {name: job for name, job in jobs.items() if name.startswith(robot)}
        name = min(mine, key=lambda n, mine=mine: choose.cost(mine[n], goal))
        found[robot] = name.removeprefix(f"{robot}-grid-"), mine[name]
    return found


def fresh_rule():
    """The script, and the packed fresh runs."""
    return script("23_untuned/fresh"), read("fresh")[1]


def test_the_table_of_fresh_seeds_is_that_of_its_runs():
    """Every job of both lists, whole, with its ten seeds once, of the host and commit that the page names."""
    table, jobs = read("fresh")
    more = paper.jobs(FOLDER / "ppo_more_fresh.txt")
    asked = paper.jobs(FOLDER / "fresh.txt") | more
    assert {name: job[0]["job"] for name, job in jobs.items()} == asked
    shown = part(FRESH)
    assert {row for row in shown if row.startswith(tuple(ROBOTS.values()))} == {
        *TITLES.values(),
        *(
            f"{robot}, {goal}"
            for robot in ROBOTS.values()
            for goal in fresh_rule()[0].GOALS.values()
        ),
    }
    for name, title in TITLES.items():
        job = jobs[name]
        first, *host = (1600, "more", "2a51cc3d") if name in more else (1200, "fresh", "60000061")
        assert sorted(run[0]["seed"] for run in table.seeds(job)) == [*range(first, first + 10)]
        (about,) = {(row["batch"], row["commit"][:8], row["device"]) for row in job}
        assert about == (*host, "NVIDIA H200")
        row = row_of(table, job)
        assert shown[title] == [*row[:2], falls_then(table, job), *row[2:]], name
    head = head_of(table, job)
    assert shown["of 30"] == [*head[:2], "falls then", *head[2:]]
    text = (
        "`fresh.txt` (seeds 1200 to 1209) ran on one of two H200 of one host, 2026-11-29, commit "
    )
    text += "60000061; `ppo_more_fresh.txt` (1600 to 1609), which has the three with a KL or gamma in their "
    assert text + "names, on one of two of another, 2026-11-30, commit 2a51cc3d." in WORDS
    assert {n for n in TITLES if " KL " in TITLES[n] or "gamma" in TITLES[n]} == more.keys()
    text = "NVIDIA H200, 2026-11-29 and -30, commits 60000061 and 2a51cc3d"
    assert text in WORDS.split("**In Isaac Lab")[0]


def of_level(one, whose=""):
    """How many times the steps of `best` PPO needs, as the lead says it."""
    found = fresh_rule()[0].around(one)
    return f"{found.value:.2f} times the steps{whose} to the level ({found.low:.2f} to {found.high:.2f}"


def of_walk(one, word=""):
    value, low, high = (x / 1e6 for x in fresh_rule()[0].around(one))
    return f"{value:.2f} M{word} more to a walk ({low:.2f} to {high:.2f}"


def test_the_verdict_on_fresh_seeds_is_what_the_rule_says():
    """The table under the runs, by the lines that fresh.py prints; the lead and the rule's own section."""
    fresh, jobs = fresh_rule()
    lines, shown, said = fresh.told(jobs), part(FRESH), []
    for title, *numbers, verdict in zip(*[iter(lines)] * 4, strict=True):
        where, told = title.split(": PPO ")
        ppo, best = told.split(", `best` ")
        (need, p), (less, p_less) = (x.strip().split(", Holm's p ") for x in numbers)
        need, less = (x.replace(" times the steps", " times") for x in (need, less))
        need, less = (x.replace(" M steps", " M") for x in (need, less))
        row = [ppo, best, need, p, f"{less}, p {p_less}", verdict.strip()]
        assert shown[where] == row, where
        said.append(verdict.strip())
    assert (
        said == ["PPO needs so many times the steps of `best`", "PPO needs so many steps more"] * 2
    )
    text = (
        f'all four are shown, both ways. To the level "{said[0]}", to a walk "{said[1]}", on both'
    )
    assert text in WORDS
    steps = {(r, g): fresh.steps(jobs, r, g) for r in ROBOTS for g in fresh.GOALS}
    assert [one.never for one in steps.values()] == [(0, 0), (1, 0), (0, 0), (0, 0)]
    head = WORDS.split("**In Isaac Lab")[0]
    (level_b, walk_b, level_s, walk_s) = steps.values()
    best = [f"{one.best.mean() / 1e6:.2f}" for one in steps.values()]
    ppo = [f"{one.ppo.mean() / 1e6:.2f}" for one in steps.values()]
    text = f"ANYmal-B is at 24 of 30 after {best[0]} M simulator steps and Spot after {best[2]} M, and they "
    text += (
        f"walk after {best[1]} and {best[3]} M: means of ten fresh seeds each, all of which walk."
    )
    assert text in head
    text = f"On ANYmal-B PPO without a model needs {of_level(level_b, ' of `best`')}; PPO {ppo[0]} M), and "
    text += f"{of_walk(walk_b, ' steps')}; PPO {ppo[1]} M, where the one seed of ten that never walks counts "
    assert text + "with twice its run)." in head
    text = (
        f"On Spot it needs {of_level(level_s)}; {ppo[2]} M), and {of_walk(walk_s)}; {ppo[3]} M).**"
    )
    assert text in head
    assert f"a seed that never walks counts with {2 * level_b.end / 1e6:.2f} M steps:" in WORDS
    times = [fresh.around(one) for one in (level_b, level_s)]
    more = [fresh.around(one) for one in (walk_b, walk_s)]
    others = {
        name: " ".join((EXPERIMENTS.parent / name).read_text().split())
        for name in (
            "README.md",
            "docs/results.md",
            "experiments/README.md",
            "experiments/21_less/ppo.md",
        )
    }
    text = " needs {:.1f} and {:.1f} times the steps to"
    for name in ("README.md", "docs/results.md"):
        assert text.format(*(one.value for one in times)) in others[name]
    around = ", ".join(f"{one.low:.2f} to {one.high:.2f}" for one in times)
    text = "the level ({}). To a walk it needs {:.1f} M more ({:.1f} to {:.1f}; one PPO seed never walks and"
    text += " counts with twice its run) and {:.1f} M more ({:.1f} to {:.1f}; ten fresh seeds each"
    both = [x / 1e6 for one in more for x in (one.value, one.low, one.high)]
    assert text.format(around, *both) in others["docs/results.md"]
    text = "needs {:.2f} and {:.2f} times its steps to the level ({}), and to a walk {:.2f} M and {:.2f} M"
    text = text.format(*(one.value for one in times), around, *(one.value / 1e6 for one in more))
    text += " more ({}; ten".format(
        ", ".join(f"{x.low / 1e6:.2f} to {x.high / 1e6:.2f}" for x in more)
    )
    assert text in others["experiments/README.md"]
    text = f"On ten fresh seeds those that stand need {ppo[1]} (one of ten never walks and counts with twice "
    text += f"its run) and {ppo[3]} M to a walk, and {ppo[0]} and {ppo[2]} M to the level."
    assert text in others["experiments/21_less/ppo.md"]
    tuned = part("PPO tuned on these robots")
    was = [tuned[f"{name}, KL 0.03"][1] for name in ("ANYmal-B, 512 robots", "Spot, 256 robots")]
    text = (
        f"did so after {was[0]} (ANYmal-B) and {was[1]} M (Spot), here after {ppo[1]} and {ppo[3]}."
    )
    assert text in WORDS


def test_what_the_page_says_of_single_fresh_seeds():
    """The last of `best` and the first of PPO, to both goals; the seed that never walks; those that fall."""
    (fresh, jobs), table = fresh_rule(), script("21_less/table")
    steps = {(r, g): fresh.steps(jobs, r, g) for r in ROBOTS for g in fresh.GOALS}
    soonest = {  # of every PPO of the table
        (r, g): min(fresh.beside(jobs, r, g, n).ppo.min() for n in TITLES if f"-{r}-" in n)
        for r, g in steps
    }
    assert all(one.best.max() < soonest[key] for key, one in steps.items())
    last = {key: f"{one.best.max() / 1e6:.2f}" for key, one in steps.items()}
    first = {key: f"{at / 1e6:.2f}" for key, at in soonest.items()}
    (at,) = {last[robot, "level"] for robot in ROBOTS}
    b, s = ROBOTS
    text = f"The last seeds of `best` are at the level after {at} M on both robots, the first of any PPO of "
    text += "the table after "
    text += f"{first[b, 'level']} (ANYmal-B) and {first[s, 'level']} M (Spot). They walk after "
    text += f"{last[b, 'walks']} and {last[s, 'walks']} M, the first of PPO after {first[b, 'walks']} and "
    assert text + f"{first[s, 'walks']} M." in WORDS
    runs = table.seeds(jobs[CHOSEN[b]])
    found = table.reached(runs, 24)
    later = [
        [row["fall_rate"] for row in run if row["sim_steps"] >= at]
        for run, at in zip(runs, found.level, strict=True)
    ]
    falling = sum(max(rates) > 0.01 for rates in later)
    assert falling == np.sum(~(found.walks == found.level)) == 5
    text = f"are at 24 by {found.level.max() / 1e6:.2f} M, but five go on falling in a little more than 1 % "
    text += f"of the episodes, at most {100 * max(map(max, later)):.1f} %, for a while."
    assert text in WORDS
    (never,) = np.flatnonzero(np.isnan(found.walks))
    text = f"never walks is at 24 after {found.level[never] / 1e6:.2f} M, and falls in "
    assert text + f"{100 * runs[never][-1]['fall_rate']:.1f} % of its last evaluation." in WORDS
    one = steps[b, "walks"]
    once = stats.difference(np.minimum(one.ppo, one.end), one.best)
    value, low, high = (x / 1e6 for x in once)
    text = f"If it counts with the {one.end / 1e6:.2f} M of its run, not twice that, PPO needs {value:.2f} M "
    assert text + f"more ({low:.2f} to {high:.2f}; looked at" in WORDS
    for kl in ("kl3", "kl5"):
        level = table.reached(table.seeds(jobs[f"level-anymal_b-grid-128-{kl}"]), 24)
        assert np.isnan(level.walks).sum() == 3
    assert "Of both PPO chosen for the level three of ten never walk." in WORDS
    other = fresh.beside(jobs, b, "walks", "walks-anymal_b-grid-256-kl3-gamma98")
    text = f"gamma 0.98 all ten walk, after {other.ppo.mean() / 1e6:.2f} M in the mean."
    assert other.never[0] == 0 and text in WORDS


def test_how_fresh_runs_end_at_equal_steps():
    """Where PPO ends: returns and falls of `best` less those of the PPO chosen to walk."""
    table, jobs = read("fresh")
    ends, falls, p = {}, {}, {}
    for robot, name in CHOSEN.items():
        end = table.seeds(jobs[name])[0][-1]["sim_steps"]
        assert f"**At equal steps**, {end / 1e6:.2f} M, where PPO ends" in WORDS
        best, ppo = (table.between(jobs[job], end, "return") for job in (f"{robot}-best", name))
        ends[robot], p[robot] = stats.difference(best, ppo), stats.equivalence(best, ppo, 0.7)
        few, many = (
            100 * table.between(jobs[job], end, "fall_rate") for job in (f"{robot}-best", name)
        )
        falls[robot] = many.mean(), few.mean(), *stats.difference(many, few)[1:]
    b, s = ROBOTS
    assert all(x[2] > 0 for x in falls.values()) and ends[s].low > 0 and max(p.values()) < 0.05
    assert abs(ends[b].value) < 0.05 and f"{-ends[b].low:.1f}" == f"{ends[b].high:.1f}"
    text = f"returns are equal within 0.7 (p of equivalence {p[b]:.0e} on ANYmal-B, {p[s]:.2f} on Spot). On "
    text += f"ANYmal-B they differ by 0.0 ({ends[b].high:.1f} either way), on Spot `best` has "
    assert text + f"{ends[s].value:.1f} more ({ends[s].low:.1f} to {ends[s].high:.1f})." in WORDS
    text = "PPO falls more: {:.1f} instead of {:.1f} % on ANYmal-B (difference {:.2f} to {:.2f} points), "
    text = text.format(*falls[b])
    assert (
        text + "{:.1f} instead of {:.1f} % on Spot ({:.2f} to {:.2f}).".format(*falls[s]) in WORDS
    )
    there, head = less("headline")
    levels = [
        there.reached(there.seeds(job), there.walks.level(there.best(job))).level.mean() / 1e6
        for job in (head[f"best-{letter}"] for letter in LETTERS.values())
    ]
    text = f"needs about as many steps to the level, {min(levels):.2f} to {max(levels):.2f} M"
    assert text in WORDS


def test_the_table_of_ppo_tuned_here_is_that_of_its_runs():
    """Every job of both lists, all to their ends, and the earlier one; bold is what choose.py takes."""
    choose, (table, first), (_, more) = (
        script("21_less/choose"),
        read("ppo", "2"),
        read("ppo", "3"),
    )
    every = read("ppo")[1]  # two batches of one job are one here, as for choose.py
    for name, jobs in (("ppo", first), ("ppo_more", more)):
        asked = paper.jobs(FOLDER / f"{name}.txt")
        assert {name: job[0]["job"] for name, job in jobs.items()} == asked
    (device,) = {(row["device"], row["commit"][:8]) for job in more.values() for row in job}
    assert device == ("NVIDIA H200", "05f6d8fb")
    assert "`ppo_more.txt`; four H200 of one host, 2026-11-29, commit 05f6d8fb; batch 3)" in WORDS
    earlier = {f"{title_of(name)}, earlier": job for name, job in read("ppo", "1")[1].items()}
    jobs = {title_of(name): job for name, job in (first | more).items()} | earlier
    shown = part("PPO tuned on these robots")
    assert len(jobs) == 14 * 2 + 1 and shown.keys() == {"walks: M steps", *jobs}
    walks, level = (
        {title_of(next(iter(costs(goal, robot, every)))) for robot in ROBOTS}
        for goal in ("walks", "level")
    )
    for title, job in jobs.items():
        runs = table.seeds(job)
        assert [run[0]["seed"] for run in runs] == [0, 1, 2]
        assert {run[-1]["sim_steps"] for run in runs} == {300 * 512 * 24}
        row, cost = row_of(table, job), f"{choose.cost(job) / 1e6:.2f}"
        mine = [row[0], cost, row[1], falls_then(table, job), row[2], *row[-2:]]
        assert shown[title] == mine, title
        cost = f"**{cost}**" if title in walks else cost
        then = f"**{row[1]}**" if title in level else row[1]
        assert f"| {title} | {row[0]} | {cost} | {then} |" in PAGE, title
    head = head_of(table, job)
    assert shown[head[0]] == ["by the rule", head[1], "falls then", head[2], *head[-2:]]


def test_the_settings_of_ppo_tuned_here_are_those_of_its_jobs():
    """And which of the first four were chosen."""
    told = set()
    for name, job in (read("ppo", "2")[1] | read("ppo", "3")[1]).items():
        asked = dict(field.split("=") for field in job[0]["job"].split()[1:])
        a_row = int(asked["rollout.num_envs"]) * int(asked["rollout.horizon"]) / 1e6
        end, late, every = (
            a_row * int(asked[name])
            for name in ("run.num_iterations", "schedule.late_from", "run.eval_every")
        )
        last = int(asked["run.seed"]) + int(asked["run.num_seeds"]) - 1
        gamma = "0.97" if name.endswith("-gamma98") else asked["ppo.gamma"]
        lambda_ = "0.9" if name.endswith("-lam95") else asked["ppo.lambda_"]
        text = f"gamma {gamma}, lambda {lambda_}, {asked['rollout.horizon']} rows, "
        text += f"today's task, half of the KL after {late:.1f} M steps, {end:.1f} M in all. Tuning seeds "
        text += f"{asked['run.seed']} to {last}, {asked['run.eval_envs']} episodes of 20 s every {every:.2f}"
        told.add(text)
    (settings,) = told
    assert settings in WORDS
    assert f"a seed that never walks counts with {2 * end:.1f} M" in WORDS
    walks, level = (
        [name.removesuffix("-kl3") for name, _ in soonest(goal).values()]
        for goal in ("walks", "level")
    )
    text = f"{walks[0]} robots on ANYmal-B, {walks[1]} on Spot, both with a KL of 0.03. Soonest at the level "
    text += f"were {level[0]} robots on ANYmal-B, which go on falling (one seed of three never walks), and "
    assert text + f"the same {level[1]} on Spot." in WORDS and walks[1] == level[1]


def test_the_jobs_of_the_new_winners_are_those_that_choose_takes(tmp_path, monkeypatch):
    """The file is what choose.py writes, to a walk and to the level; none is one of fresh.txt."""
    choose, text = script("21_less/choose"), ""
    for goal in ([], ["--level"]):
        given = ["results/ppo.csv.xz", "ppo.txt", "--beyond", "ppo_more.txt"]
        given = [str(FOLDER / x) if not x.startswith("--") else x for x in given]
        given[2:2] = [str(tmp_path / "jobs.txt")]
        monkeypatch.setattr("sys.argv", ["choose.py", *given, "--seed", "1600", *goal])
        choose.main()
        text += (tmp_path / "jobs.txt").read_text()
    assert (FOLDER / "ppo_more_fresh.txt").read_text() == text
    names = [line.split()[0] for line in text.splitlines()]
    assert names == [
        "walks-anymal_b-grid-256-kl3-gamma98",
        "level-anymal_b-grid-128-kl5",
        "level-spot-grid-128-kl4",
    ]
    assert "run.seed=1600 run.num_seeds=10 run.eval_envs=1000" in text
    assert "a new winner runs on ten fresh seeds (1600 to 1609)" in WORDS


def test_which_ppo_stands_on_fresh_seeds():
    """To the level the winners among all fourteen, whatever they need; to a walk the one with fewer steps."""
    fresh, jobs = fresh_rule()
    said, p = [], []
    for robot, new, old in (
        ("anymal_b", "level-anymal_b-grid-128-kl5", "level-anymal_b-grid-128-kl3"),
        ("spot", "level-spot-grid-128-kl4", "walks-spot-grid-256-kl3"),
    ):
        a, b = (fresh.beside(jobs, robot, "level", name).ppo / 1e6 for name in (new, old))
        assert np.allclose(fresh.steps(jobs, robot, "level").ppo, a * 1e6) and a.mean() < b.mean()
        less = stats.difference(b, a)
        said.append(
            f"{a.mean():.2f} instead of {b.mean():.2f} M on {ROBOTS[robot]} ({less.value:.2f} M less; "
            f"{less.high:.2f} less to {-less.low:.2f} more)"
        )
        p.append(f"{stats.welch_of(a, b):.2f}")
    text = f"take the place, by the rule, and are sooner in the mean: {said[0]} and {said[1]}. As expected, "
    assert f"{text}no difference" in WORDS
    assert f"is shown (p {p[0]} and {p[1]}, two hosts, other seeds)" in WORDS
    stays, other = (
        fresh.beside(jobs, "anymal_b", "walks", f"walks-anymal_b-grid-{name}")
        for name in ("512-kl3", "256-kl3-gamma98")
    )
    assert np.array_equal(fresh.steps(jobs, "anymal_b", "walks").ppo, stays.ppo)
    more = stats.difference(other.ppo / 1e6, stays.ppo / 1e6)
    text = f"512 robots stay: they need {stays.ppo.mean() / 1e6:.2f} M, where the one that never walks "
    text += f"counts with twice its run, 256 robots with gamma 0.98 {other.ppo.mean() / 1e6:.2f}, and all "
    text += f"ten walk ({more.value:.2f} M more; {-more.low:.2f} less to {more.high:.2f} more, p "
    assert f"{text}{stats.welch_of(other.ppo, stays.ppo):.2f})" in WORDS
    saved, now = (fresh.around(one) for one in (other, stays))
    text = (
        f"saves {saved.value / 1e6:.2f} M ({saved.low / 1e6:.2f} to {saved.high / 1e6:.2f}), not "
    )
    assert f"{text}{now.value / 1e6:.2f}." in WORDS


def test_what_the_page_says_of_ten_more_settings():
    """The winners among all fourteen, by both readings of the earlier batch."""
    choose = script("21_less/choose")
    (table, first), (_, more), (_, every) = read("ppo", "2"), read("ppo", "3"), read("ppo")
    level = {robot: costs("level", robot, every) for robot in ROBOTS}
    said, returns = [], []
    for robot, (new, old) in {
        "anymal_b": ("128-kl5", "128-kl3"),
        "spot": ("128-kl4", "256-kl3"),
    }.items():
        names = [f"{robot}-grid-{x}" for x in (new, old)]
        a, b, third = list(level[robot].values())[:3]
        assert list(level[robot])[:2] == names and a == b < third
        said.append(f"{a / 1e6:.2f}")
        returns.append("{:.1f}, not {:.1f}".format(*(choose.last_return(every[x]) for x in names)))
    assert "of fourteen settings on each" in WORDS.split("**In Isaac Lab")[0]
    text = f"On ANYmal-B 128 robots with a KL of 0.05 need {said[0]} M, as with 0.03; on Spot 128 robots "
    text += (
        f"with 0.04 need {said[1]} M, as 256 with 0.03. Of equal ones `choose.py` takes that with "
    )
    text += "the highest return at the last evaluation (the table's is the mean of three):"
    assert text + f" {returns[0]}, and {returns[1]}." in WORDS
    walks = {robot: costs("walks", robot, every) for robot in ROBOTS}
    alone = costs("walks", "anymal_b", first | more)
    assert [next(iter(x)) for x in (*walks.values(), alone)] == [
        "anymal_b-grid-256-kl3-gamma98",
        "spot-grid-256-kl3",
        "anymal_b-grid-512-kl3",
    ]
    least, then = list(walks["spot"].values())[:2]
    assert f"stays on Spot ({least / 1e6:.2f} M; the next needs {then / 1e6:.2f})" in WORDS
    both, new = (
        walks["anymal_b"][f"anymal_b-grid-{x}"] / 1e6 for x in ("512-kl3", "256-kl3-gamma98")
    )
    assert len(table.seeds(every["anymal_b-grid-512-kl3"])) == 6
    text = f"with {new:.2f} M: `choose.py` takes both batches of the 512 robots for one job of six runs, "
    text += f"which needs {both:.2f} M. By batch 2 alone, with which it was chosen, that needs "
    assert text + f"{alone['anymal_b-grid-512-kl3'] / 1e6:.2f} M and would stay." in WORDS
    # how much was tuned
    runs = [sum(len(table.seeds(job)) for job in read("ppo", k)[1].values()) for k in "123"]
    assert runs[1] + runs[2] == 2 * 14 * 3 and runs[0] == 3
    cut = table.read(FOLDER / "results/cut.csv.xz")
    assert sum(len(table.seeds(job)) for job in cut.values()) == 9
    text = f"PPO had {sum(runs)} whole runs on these two robots: fourteen settings on each with three seeds,"
    assert f"{text} and three runs earlier; nine were cut off." in WORDS
    page = " ".join((LESS / "ppo.md").read_text().split())
    assert "`best` had none here, and 2308 on four others, where PPO had [669]" in WORDS
    assert "in 669 runs" in page and "`best` was chosen in 2308 runs on four robots" in page
    text = "Two tie, with 128 robots and KL 0.05 (ANYmal-B) and 0.04 (Spot), and 256 robots with gamma 0.98 "
    assert f"{text}walk after {new:.2f} M on ANYmal-B." in page


def test_what_three_tuning_seeds_said():
    """The first four settings' winners, as ppo.md tells them, with the earlier batch of one."""
    table, (earlier,) = script("21_less/table"), read("ppo", "1")[1].values()
    assert [name for name, _ in soonest("walks").values()] == ["512-kl3", "256-kl3"]
    assert [name for name, _ in soonest("level").values()] == ["128-kl3", "256-kl3"]
    was = table.reached(table.seeds(earlier), 24).walks
    walks = [table.reached(table.seeds(job), 24).walks for _, job in soonest("walks").values()]
    level = [table.reached(table.seeds(job), 24).level for _, job in soonest("level").values()]
    assert len(read("cut")[1]) == 3 and "three jobs were cut off then" in WORDS
    page = " ".join((LESS / "ppo.md").read_text().split())
    b, early, s = (f"{x.mean() / 1e6:.2f}" for x in (walks[0], was, walks[1]))
    text = f"512 robots with KL 0.03 walk soonest on ANYmal-B, after {b} M ({early} M in an earlier batch of "
    text += f"the same job and seeds), and 256 with KL 0.03 on Spot, after {s} M; soonest at the level are "
    text += "128 and 256 robots, after {:.2f} and {:.2f} M."
    assert text.format(*(x.mean() / 1e6 for x in level)) in page


def test_the_tables_of_best_are_those_of_its_runs():
    """And the same jobs once more, to the level and, of `best`, to a walk."""
    table, jobs = read("best")
    shown = part("The older `best`, and PPO-16")
    kinds = {"best": "best", "ppo-1024x24": "PPO, its settings, 24 rows", "ppo16": "PPO-16"}
    robots = ROBOTS | {"anymal_c-exact": "ANYmal-C, exact task", "go1-exact": "Go1, exact task"}
    for robot, title in robots.items():
        for kind, called in kinds.items():
            job = jobs[f"{robot}-{kind}"]
            assert shown[f"{title}, {called}".replace("best", "`best`")] == row_of(table, job)
        assert shown[f"of {table.best(job)}"] == head_of(table, job)
    again = {
        robot: [table.reached(table.seeds(jobs[f"{robot}-{kind}-2"]), 24).level for kind in kinds]
        for robot in ROBOTS
    }
    means = {robot: [np.nanmean(x) / 1e6 for x in some] for robot, some in again.items()}
    text = "are at 24 after {:.2f} (`best`), {:.2f} (PPO) and {:.2f} M steps (PPO-16) on ANYmal-B"
    assert text.format(*means["anymal_b"]) in WORDS
    assert ", {:.2f}, {:.2f} and {:.2f} (3 of 5 never) on Spot".format(*means["spot"]) in WORDS
    later = [
        table.reached(table.seeds(jobs[f"{robot}-best-2"]), 24).walks.mean() / 1e6
        for robot in ROBOTS
    ]
    assert "Then `best` walks after {:.2f} and {:.2f} M".format(*later) in WORDS
    never = [[int(np.isnan(x).sum()) for x in some] for some in again.values()]
    assert never == [[0, 0, 0], [0, 0, 3]]
    whole = {
        name: np.nanmean(table.reached(table.seeds(job), table.walks.level(table.best(job))).level)
        for name, job in jobs.items()
    }
    more = [whole[f"{robot}-ppo-1024x24"] / whole[f"{robot}-best"] for robot in robots]
    assert f"It needs {min(more):.0f} to {max(more):.0f} times the steps of `best`" in WORDS


def test_the_older_best_and_ppo_16_of_the_exact_task():
    """To the level, those that walk, and how they end: `best` less PPO-16."""
    table, jobs = read("best")
    kinds = [(robot, kind) for robot in ("go1", "anymal_c") for kind in ("best", "ppo16")]
    jobs = {key: jobs["{}-exact-{}".format(*key)] for key in kinds}
    found = {
        key: table.reached(table.seeds(job), table.walks.level(table.best(job)))
        for key, job in jobs.items()
    }
    level = {key: np.nanmean(one.level) / 1e6 for key, one in found.items()}
    walk = {key: one.walks[np.isfinite(one.walks)] / 1e6 for key, one in found.items()}
    head = WORDS.split("cd experiments/23_untuned")[0]
    cost = script("30_row_cost/table")
    today = {
        run.place: run for run in cost.runs() if run.method == "best" and ".exact" in run.place
    }
    go1, anymal = (today[f"{robot}.exact"] for robot in ("go1", "anymal_c"))
    counts = [(len(one.level), int(np.isfinite(one.walks[:, 0]).sum())) for one in (go1, anymal)]
    assert counts == [(5, 2), (5, 5)] and len(today) == 2
    text = f"{go1.level[:, 1].mean() / 1e6:.2f} M steps (Go1) and {anymal.level[:, 1].mean() / 1e6:.2f} M"
    text += " (ANYmal-C), five fresh seeds each; all five ANYmal-C walk, after"
    text += f" {anymal.walks[:, 1].mean() / 1e6:.2f} M"
    ends = [int(row["sim_steps"]) for row in cost.read() if row["name"] == "go1.exact.best"]
    assert f"{text}, and two Go1 within {max(ends) / 1e6:.1f} M" in head
    text = f"is at 38 of 45 after {level['go1', 'best']:.2f} M and an ANYmal-C at 24 of 30 after "
    assert text + f"{level['anymal_c', 'best']:.2f} M, means of five fresh seeds each" in head
    text = f"PPO-16, the paper's, {level['go1', 'ppo16']:.1f} M and, of four of five seeds, "
    assert text + f"{level['anymal_c', 'ppo16']:.1f} M" in head
    never = [int(np.isnan(one.level).sum()) for one in found.values()]
    assert never == [0, 0, 0, 1] and [len(walk[key]) for key in kinds] == [0, 4, 3, 2]
    text = (
        f"three ANYmal-C with `best` ({walk['anymal_c', 'best'].mean():.2f} M) and two with PPO-16 "
    )
    text += f"({walk['anymal_c', 'ppo16'].mean():.1f} M), no Go1 with `best` and four with PPO-16 "
    assert text + f"({walk['go1', 'ppo16'].mean():.1f} M)" in head
    end = table.seeds(jobs["go1", "ppo16"])[0][-1]["sim_steps"]
    go1, anymal = (
        table.factor(found[robot, "ppo16"].level, found[robot, "best"].level, end)
        for robot in ("go1", "anymal_c")
    )
    value, low, high = (float(x) for x in re.findall(r"[\d.]+", go1))
    least = float(anymal.removeprefix("at least "))
    text = (
        f"needs {value:.0f} (Go1; Fieller's 95 % {low:.0f} to {high:.0f}) and at least {least:.0f} "
    )
    assert text + "times the steps of `best`" in WORDS

    def end_of(name, key):
        return np.array(
            [np.mean([row[name] for row in run[-3:]]) for run in table.seeds(jobs[key])]
        )

    g, c = (stats.difference(*(end_of("return", key) for key in kinds[k : k + 2])) for k in (0, 2))
    text = f"ends {c.value:.1f} lower on ANYmal-C (Welch's 95 % {c.low:.1f} to {c.high:.1f}) and "
    assert text + f"{g.value:.1f} on Go1 ({g.low:.1f} to {g.high:.1f})" in WORDS
    falls = [100 * end_of("fall_rate", key) for key in kinds[:2]]
    more = stats.difference(*falls)
    text = f"fewer episodes: {falls[1].mean():.1f} %, `best` {falls[0].mean():.1f} % (difference "
    assert text + f"{more.low:.1f} to {more.high:.1f})" in WORDS


def test_the_table_of_two_cpu_cores_is_that_of_its_runs():
    table, jobs = read("laptop")
    shown, kinds = part("On a CPU"), {"`:laptop`": "", "without its tail": "-ppo"}
    last, walked, apart = [], [], []
    for title, kind in kinds.items():
        job = jobs[f"spot-laptop{kind}"]
        assert shown[f"Spot, {title}"] == ["3", *row_of(table, job)]
        runs = table.seeds(job)
        assert shown["seeds"] == head_of(table, job)
        last.append(", ".join(f"{run[-1]['return']:.1f}" for run in runs))
        walked.append(table.reached(runs, 24).walks)
        apart.append(f"{(runs[0][1]['sim_steps'] - runs[0][0]['sim_steps']) / 1e6:.2f}")
    assert f"by seed: Spot with the tail {last[0]}; PPO {last[1]}." in WORDS
    assert "(returns count twice), every {} and {} M steps".format(*apart) in WORDS
    assert [int(np.isfinite(x).sum()) for x in walked] == [3, 1]
    end = runs[0][-1]["sim_steps"] / 1e6
    text = f"fresh seeds of Spot walk, after {walked[0].mean() / 1e6:.2f} M, without its tail one of three "
    assert text + f"by {end:.1f} M." in WORDS


def test_episodes_of_today_are_as_long_as_the_page_says(monkeypatch):
    monkeypatch.chdir(FOLDER)
    names = ("anymal_b.py", "spot.py", "go1.py")
    length = [config_lib.load(f"configs/{name}:best").task.episode_length / 50 for name in names]
    assert length[0] == length[1]
    assert f"lasted 5 s (today {length[1]:.1f}, of a Go1 {length[2]:.1f})" in WORDS


def test_jobs_on_fresh_seeds_are_those_that_choose_takes(monkeypatch):
    """PPO of both goals, a setting once a robot; `best` without a field that changes training."""
    more = {"run.seed": 1200, "run.num_seeds": 10, "run.eval_envs": 1000}
    monkeypatch.chdir(FOLDER)
    choose, asked = script("21_less/choose"), paper.jobs(FOLDER / "ppo.txt")
    lines, seen = [], set()
    for goal in ("walks", "level"):
        for robot, (setting, _) in soonest(goal).items():
            name = f"{robot}-grid-{setting}"
            if name not in seen:
                lines.append(choose.fresh(f"{goal}-{name}", asked[name], more, 2))
            seen.add(name)
    text = (FOLDER / "fresh.txt").read_text()
    assert text.startswith("".join(lines))
    rest = text.removeprefix("".join(lines)).splitlines()
    assert [line.split()[:2] for line in rest] == [[f"{r}-best", f"{r}:best"] for r in ROBOTS]
    for line in text.splitlines():
        _, job, *fields = line.split()
        config = config_lib.load(f"configs/{job.replace(':', '.py:')}")
        for field in fields:
            config_lib.override(config, *field.split("=", 1))
        config.run.log_every = config.run.eval_every  # as run.py sets it
        config = config_lib.validate(config)
        assert schedule.uses_model(config) == (line in rest)
        assert (config.run.seed, config.run.num_seeds, config.run.eval_envs) == (1200, 10, 1000)
        at = schedule.sim_steps(config)[config.run.eval_every - 1 :: config.run.eval_every] / 1e6
        if line in rest:
            late = 2 + np.flatnonzero(np.diff(at[2:]) > 0.02)[0]  # after the ramp of tails
            told = (
                f"`best` {at[4] - at[3]:.3f} M until {at[late]:.2f} M, then {at[-1] - at[-2]:.3f} M"
            )
            assert told in WORDS and f"`best` ends at {at[-1]:.2f} M" in WORDS
            assert np.allclose(np.diff(at[2 : late + 1]), at[4] - at[3])
            assert np.allclose(np.diff(at[late + 1 :]), at[-1] - at[-2])
        else:
            assert f"PPO's are {at[0]:.3f} M apart" in WORDS and np.allclose(np.diff(at), at[0])
            assert f"up to {at[-1]:.2f} M, where PPO ends" in WORDS
            assert f"counted with {2 * at[-1]:.2f} M on both sides" in WORDS
        assert line not in rest or all(field.startswith("run.") for field in fields)


def run_of(seed, level_at, walks_at, step=0.061, end=61):
    """Evaluations of a seed: first at 24 at one, from another on without falls; None: never."""
    return [
        {
            "job": "spot:best",
            "seed": float(seed),
            "sim_steps": 1e6 * step * k,
            "return": 25.0 if level_at is not None and k >= level_at else 9.0,
            "fall_rate": 0.0 if walks_at is not None and k >= walks_at else 0.5,
        }
        for k in range(1, end)
    ]


def test_the_rule_for_fresh_seeds_says_what_it_was_written_to_say():
    """By hand, of three seeds each: a difference, none, a seed that never walks (twice the end, whatever is
    taken off), and `best` after PPO's end, which counts for nothing."""
    fresh, _ = fresh_rule()
    late = [run_of(s, 20 + s, 30 + 5 * s) for s in range(3)]
    soon = [run_of(s, 4 + s, 8 + s, end=99) for s in range(3)]
    for run in soon:
        run[70]["fall_rate"] = 0.5  # after PPO's end
    lost = [*late[:2], run_of(2, 22, None)]
    jobs = {"level-anymal_b-a": late, "walks-anymal_b-b": lost, "anymal_b-best": soon}
    jobs |= {"walks-spot-c": soon, "spot-best": [*soon[:2], run_of(2, 7, 11)]}
    jobs = {name: [row for run in job for row in run] for name, job in jobs.items()}
    jobs["walks-spot-c"] = [row for row in jobs["walks-spot-c"] if row["sim_steps"] < 3.7e6]
    found = [fresh.steps(jobs, "anymal_b", goal) for goal in ("level", "walks")]
    unit = 0.061e6
    assert np.allclose(found[0].ppo, [20 * unit, 21 * unit, 22 * unit])
    assert np.allclose(found[1].ppo, [30 * unit, 35 * unit, 120 * unit])
    assert found[1].never == (1, 0) and np.allclose(found[1].best, [8 * unit, 9 * unit, 10 * unit])
    lines = fresh.told(jobs)
    ratio = stats.ratio([20, 21, 22], [4, 5, 6])
    less = stats.ratio([20 - 0.03 / 0.061, 21 - 0.03 / 0.061, 22 - 0.03 / 0.061], [4, 5, 6])
    p = stats.welch_of([20, 21, 22], [4, 5, 6])
    assert lines[0] == "ANYmal-B, to the level: PPO 1.28 M, `best` 0.30 M"
    for line, one in zip(lines[1:3], (ratio, less), strict=True):
        told = f"  {one.value:.2f} times the steps ({one.low:.2f} to {one.high:.2f}), Holm's p "
        assert line.startswith(told)
    assert lines[1].endswith(f"{4 * p:.2g}")
    assert lines[3] == "  PPO needs so many times the steps of `best`"
    assert lines[4] == "ANYmal-B, to a walk: PPO 3.76 M (1 never), `best` 0.55 M"
    more = stats.difference([30, 35, 120], [8, 9, 10])
    told = [f"{0.061 * x:.2f}" for x in (more.value, more.low, more.high)]
    assert lines[5].startswith("  +{} M steps ({} to {}), Holm's p ".format(*told))
    assert lines[7] == "  no difference in the mean is shown"
    assert lines[8].startswith("Spot, to the level: PPO 0.30 M, `best` 0.")
    assert lines[11] == "  no saving to the level is shown" == "  " + fresh.NOT_SHOWN["level"]
    page = WORDS.split("## The rule for fresh seeds ")[1].split(" ## ")[0]

    # PPO chosen later: to the level the new winner stands though it needs more, whatever the order; to a walk
    # only if it needs fewer
    def rows(each):
        return [row for run in each for row in run]

    (new,) = (name for name in fresh.WINNERS if "anymal_b" in name)
    both = {new: rows(run_of(s, 30 + s, 30 + s) for s in range(3)), **jobs}
    both["walks-anymal_b-z"] = rows(run_of(s, 20, 50 + s) for s in range(3))
    stands = [fresh.steps(both, "anymal_b", goal).ppo / unit for goal in ("level", "walks")]
    assert np.allclose(stands[0], [30, 31, 32]) and np.allclose(stands[1], [50, 51, 52])
    both["walks-anymal_b-z"] = rows(run_of(s, 20, 65) for s in range(3))  # never: 120
    assert np.allclose(fresh.steps(both, "anymal_b", "walks").ppo / unit, [30, 35, 120])
    every = [fresh.verdict(goal, x) for goal in ("level", "walks") for x in (-1, 2)]
    for words in [*every, *fresh.NOT_SHOWN.values()]:
        assert f'"{words}"' in page, words
    assert f"with {fresh.EARLIER / 1e6:.2f} M, half an interval" in page
    every = [run_of(s, 5, 9) for s in range(9)] + [run_of(9, None, None)]
    jobs["spot-best"] = [
        row for run in every for row in run
    ]  # its mean is hardly known, so no interval is
    never = [run_of(s, None, None) for s in range(10)]
    jobs["walks-spot-c"] = [row for run in never for row in run]
    lines = fresh.told(jobs)
    assert "(nan to nan)" in lines[9] and lines[11] == "  no saving to the level is shown"
    del jobs["spot-best"]
    with pytest.raises(SystemExit, match="no spot-best"):
        fresh.told(jobs)

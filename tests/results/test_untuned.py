"""23_untuned: the tables of a GPU, and PPO that was tuned on these robots."""

import re

import numpy as np
from result_files import EXPERIMENTS, LESS, cells, script

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats

FOLDER = EXPERIMENTS / "23_untuned"
PAGE = (FOLDER / "README.md").read_text()
WORDS = " ".join(PAGE.split())
ROBOTS = {"anymal_b": "ANYmal-B", "spot": "Spot"}


def read(name, batch=None):
    """The table script of 21_less, and a packed file of this folder."""
    table = script("21_less/table")
    return table, table.read(FOLDER / f"results/{name}.csv.xz", batch)


def part(title):
    """Rows of the tables under a heading: name -> cells, without bold."""
    text = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = [cells(line) for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1:] for row in rows}


def soonest(goal):
    """Of each robot the setting with the lowest cost by choose.py: its name without the robot, its job."""
    choose, (_, jobs) = script("21_less/choose"), read("ppo", "2")
    found = {}
    for robot in ROBOTS:
        mine = {name: job for name, job in jobs.items() if name.startswith(robot)}
        name = min(mine, key=lambda n, mine=mine: choose.cost(mine[n], goal))
        found[robot] = name.removeprefix(f"{robot}-grid-"), mine[name]
    return found


def test_the_tables_of_best_are_those_of_its_runs():
    """And the same jobs once more, to the level."""
    table, jobs = read("best")
    shown = part("`best` on a GPU")
    kinds = {"best": "best", "ppo-1024x24": "PPO, its settings, 24 rows", "ppo16": "PPO-16"}
    robots = ROBOTS | {"anymal_c-exact": "ANYmal-C, exact task", "go1-exact": "Go1, exact task"}
    for robot, title in robots.items():
        for kind, called in kinds.items():
            job = jobs[f"{robot}-{kind}"]
            row = cells(table.table({"x": job}, table.best(job)).splitlines()[2])
            assert shown[f"{title}, {called}".replace("best", "`best`")] == row[2:], (robot, kind)
    again = {
        robot: [table.reached(table.seeds(jobs[f"{robot}-{kind}-2"]), 24).level for kind in kinds]
        for robot in ROBOTS
    }
    means = {robot: [np.nanmean(x) / 1e6 for x in some] for robot, some in again.items()}
    text = "are at 24 after {:.2f} (`best`), {:.2f} (PPO) and {:.2f} M steps (PPO-16) on ANYmal-B"
    assert text.format(*means["anymal_b"]) in WORDS
    assert ", {:.2f}, {:.2f} and {:.2f} (3 of 5 never) on Spot".format(*means["spot"]) in WORDS
    never = [[int(np.isnan(x).sum()) for x in some] for some in again.values()]
    assert never == [[0, 0, 0], [0, 0, 3]]
    whole = {
        name: np.nanmean(table.reached(table.seeds(job), table.walks.level(table.best(job))).level)
        for name, job in jobs.items()
    }
    more = [whole[f"{robot}-ppo-1024x24"] / whole[f"{robot}-best"] for robot in robots]
    assert f"It needs {min(more):.0f} to {max(more):.0f} times the steps of `best`" in WORDS


def test_the_table_of_ppo_tuned_here_is_that_of_its_runs():
    """Every job of ppo.txt, all to their ends; bold is what choose.py takes."""
    choose, (table, jobs) = script("21_less/choose"), read("ppo", "2")
    asked = paper.jobs(FOLDER / "ppo.txt")
    assert {name: job[0]["job"] for name, job in jobs.items()} == asked
    shown = part("PPO tuned on these robots")
    assert len(shown) == 1 + len(asked) == 9
    least = [f"{robot}-grid-{setting}" for robot, (setting, _) in soonest("walks").items()]
    for name, job in jobs.items():
        robot, _, robots, kl = name.split("-")
        runs = table.seeds(job)
        assert len(runs) == 3 and {run[-1]["sim_steps"] for run in runs} == {300 * 512 * 24}
        row = cells(table.table({"x": job}, 30).splitlines()[2])[2:]
        then = [100 * table.first(run, 24, "fall_rate") for run in runs]
        cost = f"{choose.cost(job) / 1e6:.2f}"
        falls = f"{np.mean(then):.1f} % (up to {max(then):.1f} %)"
        mine = [row[0], cost, row[1], falls, row[2], *row[-2:]]
        assert shown[f"{ROBOTS[robot]}, {robots} robots, KL 0.0{kl[2:]}"] == mine, name
        assert (f"| {row[0]} | **{cost}** | {row[1]} |" in PAGE) == (name in least)


def test_beside_best_tuned_ppo_needs_what_the_page_says():
    """`best` in both batches; what ran before; what runs next; and the same in 21_less."""
    table, jobs = read("best")
    chosen, level = soonest("walks"), soonest("level")
    assert [name for name, _ in chosen.values()] == ["512-kl3", "256-kl3"]
    assert [name for name, _ in level.values()] == ["128-kl3", "256-kl3"]
    best, one, other = (
        {
            r: table.reached([run for n in names for run in table.seeds(jobs[f"{r}-best{n}"])], 24)
            for r in ROBOTS
        }
        for names in (("", "-2"), ("",), ("-2",))
    )
    ppo, soon = (
        {r: table.reached(table.seeds(job), 24) for r, (_, job) in some.items()}
        for some in (chosen, level)
    )
    ratios = [stats.ratio(soon[r].level, best[r].level) for r in ROBOTS]
    text = (
        "needs {:.1f} times the steps of `best` on ANYmal-B (Fieller's 95 % {:.1f} to {:.1f}) and "
    )
    assert (
        text.format(*ratios[0]) + "{:.1f} times on Spot ({:.1f} to {:.1f})".format(*ratios[1])
        in WORDS
    )
    first = [best[r].level.mean() / 1e6 for r in ROBOTS]
    assert "first there after {:.2f} and {:.2f} M in its two batches".format(*first) in WORDS
    more = [stats.difference(ppo[r].walks / 1e6, best[r].walks / 1e6) for r in ROBOTS]
    assert all(some.low < 0 < some.high for some in more)
    walks = [best[r].walks.mean() / 1e6 for r in ROBOTS]
    text = "{:.2f} M more on {} ({:.2f} fewer to {:.2f} more; `best` {:.2f} M"
    for found, name, mean in zip(more, ROBOTS.values(), walks, strict=True):
        assert text.format(found.value, name, -found.low, found.high, mean) in WORDS
    each = [some["spot"].walks.mean() / 1e6 for some in (one, other)]
    assert ", {:.2f} in the batch of the table and {:.2f} in the other".format(*each) in WORDS
    p = [stats.rank_sum(ppo[r].walks, best[r].walks) for r in ROBOTS]
    assert "(p {:.3f}; Spot {:.2f}; looked at".format(*p) in WORDS
    alone = stats.difference(ppo["spot"].walks / 1e6, one["spot"].walks / 1e6)
    assert "alone Spot's needs {:.2f} M more ({:.2f} to {:.2f})".format(*alone) in WORDS
    _, before = read("ppo", "1")
    (job,) = before.values()
    was = table.reached(table.seeds(job), 24)
    text = f"walked after {table.steps_of(was.walks).replace(' (', ' M (')}, and was at 24 after "
    assert text + table.steps_of(was.level) in WORDS
    both = np.concatenate([was.walks, ppo["anymal_b"].walks]).mean() / 1e6
    assert f"Both together take {both:.2f} M to a walk, as 256 robots with a KL of 0.03 do" in WORDS
    beside = table.reached(table.seeds(read("ppo", "2")[1]["anymal_b-grid-256-kl3"]), 24).walks
    assert round(beside.mean() / 1e6, 2) == round(both, 2)
    _, cut = read("cut")
    assert len(cut) == 3 and "Three jobs were cut off then" in WORDS
    fewest = [soon[r].level.mean() / 1e6 for r in ROBOTS]
    assert "needs {:.2f} and {:.2f} M, PPO-16".format(*fewest) in WORDS
    page = " ".join((LESS / "ppo.md").read_text().split())
    told = [ppo[r].walks.mean() / 1e6 for r in ROBOTS]
    text = "ANYmal-B walks after {:.2f} M (512 robots, KL 0.03), Spot after {:.2f} M (256 robots, KL 0.03); "
    text += "soonest at the level are 128 and 256 robots, after {:.2f} and {:.2f} M"
    assert text.format(*told, *fewest) in page


def test_ppo_of_the_exact_task_is_that_of_21_less():
    """Its soonest to the level there, 256 robots; those that walk."""
    table = script("21_less/table")
    jobs = table.read(LESS / "results/ppo.csv.xz")
    found = [
        table.reached(table.seeds(jobs[name]), level)
        for name, level in (("exact-256-g", 38), ("exact-256-c", 24))
    ]
    steps = [one.level.mean() / 1e6 for one in found]
    assert [int(np.isfinite(one.walks).sum()) for one in found] == [2, 2]
    (walks,) = {f"{np.nanmean(one.walks) / 1e6:.1f}" for one in found}
    assert f"of that PPO two of three on each robot ({walks} M)" in WORDS
    assert "after {:.2f} and {:.2f}, PPO-16 after".format(*steps) in WORDS
    assert "{:.2f} and {:.2f} M, 256 robots, three tuning seeds".format(*steps) in WORDS


def test_what_lifted_feet_cost_is_as_21_less_says():
    """Which the tests of 21_less hold to its runs: of Go1, Go2, ANYmal-C and -D the last two."""
    page = " ".join((LESS / "task.md").read_text().split())
    best = re.search(r"Steps of `best` to the level: (.*?) times those without", page)
    ppo = re.search(r"needs ([\d.]+), ([\d.]+), ([\d.]+) and ([\d.]+) times\. So", page)
    assert best and ppo
    mine = re.findall(r"[\d.]+ \([\d.]+ to [\d.]+\)", best[1])
    assert len(mine) == 4
    text = "`best` needed {} and {} times the steps to the level on ANYmal-C and -D, PPO {} and {} times"
    assert text.format(*mine[2:], *ppo.groups()[2:]) in WORDS


def test_jobs_on_fresh_seeds_are_those_that_choose_takes(monkeypatch):
    """PPO of both goals, a setting once a robot; `best` without a field that changes training."""
    monkeypatch.chdir(FOLDER)
    choose, asked = script("21_less/choose"), paper.jobs(FOLDER / "ppo.txt")
    lines, seen = [], set()
    for goal, seed in (("walks", 1200), ("level", 1300)):
        for robot, (setting, _) in soonest(goal).items():
            name = f"{robot}-grid-{setting}"
            if name not in seen:
                lines.append(choose.fresh(f"{goal}-{name}", asked[name], seed, 10))
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
        assert (config.run.num_seeds, config.run.eval_envs) == (10, 1000)
        assert line not in rest or all(field.startswith("run.") for field in fields)

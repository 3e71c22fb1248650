"""23_untuned: the tables of a GPU, and PPO that was tuned on these robots."""

import re

import numpy as np
import pytest
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


def million(job, goal, half=False, end=np.inf):
    """Million steps of each seed of one batch without evaluations after `end`; NaN: never. `half`: less half
    the interval before the evaluation where it gets there."""
    table = script("21_less/table")
    runs = {
        run[0]["seed"]: [row for row in run if row["sim_steps"] <= end] for run in table.seeds(job)
    }
    found = getattr(table.reached(list(runs.values()), 24), goal)
    if half:
        for k, run in enumerate(runs.values()):
            at = np.array([0, *(row["sim_steps"] for row in run)])
            found[k] -= np.diff(at)[at[1:] == found[k]].sum() / 2
    return {seed: x / 1e6 for seed, x in zip(runs, found, strict=True)}


def seed_means(batches, *how, **which):
    """A number a seed, the mean of its runs; and a number a run. Equal seeds are in all batches."""
    each = [million(job, *how, **which) for job in batches]
    assert all(one.keys() == each[0].keys() for one in each)
    runs = np.array([list(one.values()) for one in each])
    return runs.mean(0), runs.ravel()


def both_batches():
    """Of each robot: jobs of `best`, of PPO chosen to walk, of PPO soonest at the level; one a batch."""
    _, jobs = read("best")
    _, before = read("ppo", "1")
    found = {}
    for robot in ROBOTS:
        best = [jobs[f"{robot}-best"], jobs[f"{robot}-best-2"]]
        some = [soonest(goal)[robot] for goal in ("walks", "level")]
        ppo = [
            [*([old] if (old := before.get(f"{robot}-grid-{name}")) else []), job]
            for name, job in some
        ]
        found[robot] = best, *ppo
    return found


def around(found):
    """Ends of an interval of a difference, in words."""
    if found.low < 0:
        return f"{-found.low:.2f} fewer to {found.high:.2f} more"
    return f"{found.low:.2f} to {found.high:.2f}"


def test_beside_best_tuned_ppo_needs_what_the_page_says():
    """By means of seeds, whose runs of both batches count on both sides."""
    assert [name for name, _ in soonest("walks").values()] == ["512-kl3", "256-kl3"]
    assert [name for name, _ in soonest("level").values()] == ["128-kl3", "256-kl3"]
    jobs = both_batches()
    assert [list(map(len, some)) for some in jobs.values()] == [[2, 2, 1], [2, 1, 1]]
    best, ppo, soon, wide = {}, {}, {}, {}
    for robot, (mine, chosen, level) in jobs.items():
        best[robot] = {goal: seed_means(mine, goal)[0] for goal in ("walks", "level")}
        ppo[robot], soon[robot] = seed_means(chosen, "walks")[0], seed_means(level, "level")[0]
        wide[robot] = seed_means(chosen, "level")[0]
        assert len(best[robot]["walks"]) == 5 and len(ppo[robot]) == len(soon[robot]) == 3
    some = [stats.ratio(soon[r], best[r]["level"]) for r in ROBOTS]
    some.append(stats.ratio(wide["anymal_b"], best["anymal_b"]["level"]))
    text = "needs {:.1f} times the steps of `best` on ANYmal-B ({:.1f} to {:.1f}) and ".format(
        *some[0]
    )
    text += "{:.1f} times on Spot ({:.1f} to {:.1f}); ".format(*some[1])
    assert (
        text + "512 robots on ANYmal-B {:.1f} times ({:.1f} to {:.1f}).".format(*some[2]) in WORDS
    )
    first = [best[r]["level"].mean() for r in ROBOTS]
    assert "`best` is first there after {:.2f} and {:.2f} M.".format(*first) in WORDS
    one, other = (stats.difference(ppo[r], best[r]["walks"]) for r in ROBOTS)
    assert one.low > 0 > other.low
    p = stats.welch_of(ppo["anymal_b"], best["anymal_b"]["walks"])
    means = [x.mean() for r in ROBOTS for x in (ppo[r], best[r]["walks"])]
    text = f"needs {one.value:.2f} M more on ANYmal-B ({around(one)}, p {p:.3f}): "
    text += "{:.2f} M, `best` {:.2f}. On Spot no difference is shown, ".format(*means[:2])
    text += f"{other.value:.2f} M more ({around(other)}): " + "{:.2f} M, `best` {:.2f}.".format(
        *means[2:]
    )
    assert f"To a walk** the chosen PPO {text}" in WORDS
    head = WORDS.split("In `isaaclab_exact`")[0]
    text = f"needs {one.value:.2f} M more with the PPO chosen for that than with `best` ({around(one)}, "
    assert text in head
    fewest = [soon[r].mean() for r in ROBOTS]
    assert "needs {:.2f} and {:.2f} M, PPO-16".format(*fewest) in head


def test_other_ways_to_count_say_what_the_page_says():
    """Runs singly, one batch, a setting that ties; half an interval less; `best` cut off where PPO ends."""
    jobs = both_batches()
    mine, chosen, _ = jobs["anymal_b"]
    best, runs = seed_means(mine, "walks")
    mean, six = seed_means(chosen, "walks")
    assert (len(six), len(runs)) == (6, 10)
    singly = stats.difference(six, runs)
    assert f"each run counted singly, six and ten, gives {around(singly)} M more" in WORDS
    second = stats.difference(seed_means(chosen[1:], "walks")[0], best)
    tie = seed_means([read("ppo", "2")[1]["anymal_b-grid-256-kl3"]], "walks")[0]
    assert round(tie.mean(), 6) == round(mean.mean(), 6)
    tied = stats.difference(tie, best)
    assert singly.low > 0 > max(second.low, tied.low)
    assert f"512 robots were chosen, shows nothing ({around(second)}), nor do 256 robots" in WORDS
    assert f"which ran once and tie at {tie.mean():.2f} M ({around(tied)})" in WORDS
    mine, chosen, _ = jobs["spot"]
    one, other = (seed_means([job], "walks")[0] for job in mine)
    text = f"`best` walks after {one.mean():.2f} M in the batch of the table and {other.mean():.2f} in the"
    assert text in WORDS
    alone = stats.difference(seed_means(chosen, "walks")[0], one)
    assert f"first alone PPO needs {alone.value:.2f} M more ({around(alone)})" in WORDS
    ratios, later, cut, less = [], [], [], set()
    end = chosen[0][-1]["sim_steps"]
    for mine, chosen, soon in jobs.values():
        best, ppo = (seed_means(x, "level", half=True)[0] for x in (mine, soon))
        ratios.append(stats.ratio(ppo, best))
        plain = [seed_means(x, "level")[0].mean() for x in (soon, mine)]
        assert ratios[-1].low > 1 and ratios[-1].value > plain[0] / plain[1]
        less.add(round(plain[0] - plain[1] - stats.difference(ppo, best).value, 2))
        sides = [seed_means(x, "walks", half=True)[0] for x in (chosen, mine)]
        later.append(stats.difference(*sides))
        ppo, best = seed_means(chosen, "walks")[0], seed_means(mine, "walks", end=end)[0]
        cut.append(stats.difference(ppo, best))
    text = "are larger, {:.1f} ({:.1f} to {:.1f}) and ".format(*ratios[0])
    text += "{:.1f} ({:.1f} to {:.1f}), though the differences are ".format(*ratios[1])
    (shift,) = less
    assert text + f"{shift:.2f} M smaller." in WORDS
    assert later[0].low > 0 > later[1].low
    text = "To a walk PPO then needs {:.2f} M more on ANYmal-B ({}) and {:.2f} M more on Spot ({})."
    assert text.format(later[0].value, around(later[0]), later[1].value, around(later[1])) in WORDS
    mine, chosen, _ = jobs["anymal_b"]
    whole = stats.difference(*(seed_means(x, "walks")[0] for x in (chosen, mine)))
    assert cut[0] == whole and cut[1].low < 0
    text = f"on Spot PPO needs {cut[1].value:.2f} M more ({around(cut[1])})."
    assert f"nothing changes on ANYmal-B, and {text}" in WORDS
    at = [
        [row["sim_steps"] for row in script("21_less/table").seeds(x[0])[0]] for x in (chosen, mine)
    ]
    ppo, best = (np.diff(x) / 1e6 for x in at)
    soon = [f"{x:.2f}" for x in (*set(ppo), best[0], at[1][6] / 1e6, np.median(best[6:]))]
    text = (
        "PPO's are {} M steps apart. Those of `best` are {} M apart up to {} M, then mostly {} M."
    )
    assert text.format(*soon) in WORDS and len(set(best[:6])) == 1 < len(set(best[:7]))
    ends = at[1][-1] / 1e6, at[0][-1] / 1e6
    text = "must walk until {:.1f} M, on {} episodes an evaluation, PPO until {:.1f} M, on {}."
    first, last = (" ".join(x[0][0]["job"].split()[2:]) for x in (mine, chosen))
    assert "eval_envs" not in first and "evaluated every 20 iterations on 100 episodes" in WORDS
    assert "run.eval_envs=200" in last and "200 episodes of 20 s every 0.12 M steps" in WORDS
    assert text.format(ends[0], 100, ends[1], 200) in WORDS


def test_what_ran_before_and_what_21_less_says_of_it():
    """The chosen job of ANYmal-B in batch 1, alone and with batch 2."""
    table, (before,) = script("21_less/table"), read("ppo", "1")[1].values()
    was = table.reached(table.seeds(before), 24)
    text = f"walked after {table.steps_of(was.walks).replace(' (', ' M (')}, and was at 24 after "
    assert text + table.steps_of(was.level) in WORDS
    jobs = both_batches()
    both = seed_means(jobs["anymal_b"][1], "walks")[0].mean()
    assert f"Both together take {both:.2f} M to a walk, as 256 robots with a KL of 0.03 do" in WORDS
    _, cut = read("cut")
    assert len(cut) == 3 and "Three jobs were cut off then" in WORDS
    page = " ".join((LESS / "ppo.md").read_text().split())
    told = [seed_means(jobs[r][1][-1:], "walks")[0].mean() for r in ROBOTS]
    fewest = [seed_means(jobs[r][2], "level")[0].mean() for r in ROBOTS]
    text = f"ANYmal-B walks after {told[0]:.2f} M (512 robots, KL 0.03; {was.walks.mean() / 1e6:.2f} M in an "
    text += f"earlier batch of the same job and seeds; both together, {both:.2f} M, tie with 256 robots), "
    text += f"Spot after {told[1]:.2f} M (256 robots, KL 0.03); soonest at the level are 128 and 256 robots, "
    assert text + "after {:.2f} and {:.2f} M".format(*fewest) in page


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
    for goal in ("walks", "level"):
        for robot, (setting, _) in soonest(goal).items():
            name = f"{robot}-grid-{setting}"
            if name not in seen:
                lines.append(choose.fresh(f"{goal}-{name}", asked[name], 1200, 10))
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
            assert f"counts with {2 * at[-1]:.2f} M on both sides" in WORDS
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
    fresh = script("23_untuned/fresh")
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
    page = WORDS.split("## The rule for fresh seeds")[1]
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

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
    around,
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
# and of ppo_deploy_edges.txt
EDGES = {
    "256-kl1": "KL 0.01",
    "256-kl3-gamma99": "gamma 0.99",
    "256-kl2-gamma98": "gamma 0.98, KL 0.02",
    "256-kl2-gamma98-lam95": "gamma 0.98, lambda 0.95, KL 0.02",
    "128-kl3-gamma98": "128 robots, gamma 0.98",
    "512-kl3-gamma98": "512 robots, gamma 0.98",
}
# of ppo_deploy_anymals.txt
ANYMALS = {
    "512-kl3-gamma99": "512 robots, gamma 0.99",
    "1024-kl3": "1024 robots",
    "1024-kl3-gamma99": "1024 robots, gamma 0.99",
}
# and of ppo_exact_edges.txt
EXACT_EDGES = {
    "64-kl3": "64 robots",
    "64-kl5": "64 robots, KL 0.05",
    "128-kl3-ep10": "128 robots, 10 epochs",
}
# what the rule takes of them, as the page calls it
TAKEN = {
    "g": ("256-kl3", "PPO, 256 robots"),
    "h": ("256-kl2-gamma98-lam95", "PPO, 256 robots, gamma 0.98, lambda 0.95, KL 0.02"),
    "c": ("256-kl3-gamma99", "PPO, 256 robots, gamma 0.99"),
    "d": ("512-kl3", "PPO, 512 robots"),
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
    """All 17 settings on four robots."""
    return batches("9", "12")


def batches(*names):
    """Jobs of ppo.csv.xz by name; each is in one batch."""
    table, found = less("ppo")[0], {}
    for name in names:
        ran = table.read(LESS / "results/ppo.csv.xz", name)
        assert not ran.keys() & found.keys(), name
        found |= ran
    return found


@functools.cache
def of_fresh(letter):
    """The three that are compared: PPO, `deploy`, longer tails."""
    table, _ = less("ppo")
    ppo = table.read(LESS / "results/ppo_tasks.csv.xz", "edges")
    tails = table.read(DEPLOY / "fewer.csv.xz", "fresh")
    return (
        next(job for name, job in ppo.items() if name.endswith(f"-{letter}")),
        tails[f"fresh-deploy-{letter}"],
        tails[f"fresh-1024-{letter}"],
    )


def ends_of(job):
    return [run[-1]["return"] for run in less("ppo")[0].seeds(job)]


def test_the_table_of_settings_for_hardware_is_that_of_their_runs():
    """Each job of both files, to its end; and what choose.py takes by the rule, bold."""
    choose, (table, _) = script("21_less/choose"), less("ppo")
    lists = [paper.jobs(LESS / f"ppo_deploy{x}.txt") for x in ("", "_edges")]
    asked = lists[0] | lists[1]
    settings = SETTINGS | EDGES
    assert asked.keys() == grid().keys() == {f"deploy-{n}-{x}" for n in settings for x in "ghcd"}
    text = part("Settings", "###").split("\n### ")[0]
    lines = {cells(line)[0]: line for line in text.splitlines() if line.startswith("| ")}
    shown = [*map(cells, lines.values())][1:]
    cost = {n: choose.cost(job, "level", (30, 15)) for n, job in grid().items()}
    best = {x: sorted((n for n in cost if n[-1] == x), key=cost.get) for x in "ghcd"}
    rows = []
    for name, label in settings.items():
        row, commit = [label], "32eca169" if name in EDGES else "23049457"
        for x, level in ASKED.items():
            job = grid()[f"deploy-{name}-{x}"]
            assert job[0]["job"] == asked[f"deploy-{name}-{x}"] and len(table.seeds(job)) == 3
            assert job[-1]["sim_steps"] == 9216000 and job[0]["commit"].startswith(commit)
            steps = reached_of(job, level) / 1e6
            there = int(np.isfinite(steps).sum())
            first = f"{np.nanmean(steps):.2f} ({there})" if there else "none"
            cell = f"{first}; {np.mean(ends_of(job)):.1f}"
            row.append(cell)
            assert (f"**{cell}**" in lines[label]) == (TAKEN[x][0] == name)
        rows.append(row)
    assert shown == rows
    told = words(text)
    assert f"{len(asked)} jobs of three seeds (0 to 2) to 9.2 M steps" in told
    assert [len(x) for x in lists] == [44, 24] and "Six more lie beyond" in told
    every = {n: steps_between(j) for n, j in grid().items()}
    assert {f"{x / 1e6:.2f}" for n, x in every.items() if "512" not in n} == {"0.31"}
    assert {f"{x / 1e6:.2f}" for n, x in every.items() if "512" in n} == {"0.37"}
    assert "every 0.31 M steps (512 robots: 0.37 M)" in told
    for x, (name, _) in TAKEN.items():
        equal = [n for n in best[x] if cost[n] == cost[best[x][0]]]
        assert max(equal, key=lambda n: np.mean(ends_of(grid()[n]))) == f"deploy-{name}-{x}"
        assert len(equal) == (2 if x == "h" else 1)
    assert "On a Go2 two settings are equal" in told
    first, *more = (cost[n] / 1e6 for n in best["g"][:3])
    assert best["g"][1:3] == ["deploy-256-kl2-g", "deploy-256-kl2-gamma98-g"]
    later = [f"{x - first:.1f}" for x in more]
    text = f"a KL of 0.02 is {later[0]} M later by that measure, and with gamma 0.98 besides {later[1]} M."
    assert text in told
    gaps = {f"{(cost[best[x][1]] - cost[best[x][0]]) / 1e6:.1f}" for x in "cd"}
    assert gaps == {"0.8"} and "On an ANYmal-C the next is 0.8 M later, on an ANYmal-D, too" in told
    # what was expected: of the eleven, and of the six
    lasts = [
        reached_of(grid()[f"deploy-{n}-{x}"], 30 if x in "gh" else 20).max()
        for n in SETTINGS
        for x in "ghcd"
    ]
    assert np.nanmin(lasts) > 4e6 and "before 4 M steps. That was right." in told
    assert {x for x, (name, _) in TAKEN.items() if name in EDGES} == {"h", "c"}
    assert (
        "on a Go2 and on both ANYmals, none on a Go1. That was right but for the ANYmal-D." in told
    )
    # the ANYmals
    anymals = {n: job for n, job in grid().items() if n[-1] in "cd"}
    assert all(np.isnan(reached_of(job, 20)).all() for job in anymals.values())
    assert "no seed of any setting is at 20 by 9.2 M" in told
    each = np.concatenate([ends_of(job) for job in anymals.values()])
    text = (
        f"Of {len(each)} runs {sum(each >= 15)} return 15 or more at the end, {sum(each < 10)} less"
    )
    assert text in told
    at = [table.between(of_fresh(x)[1], 9.2e6, "return").mean() for x in "cd"]
    assert "as good there as `deploy` ({:.1f} and {:.1f})".format(*at) in told
    text = "with gamma 0.98 ANYmal-C return {:.1f}, {:.1f} and {:.1f}, with 512 robots ANYmal-D {:.1f},"
    six = ends_of(anymals["deploy-256-kl3-gamma98-c"]) + ends_of(anymals["deploy-512-kl3-d"])
    assert (text + " {:.1f} and {:.1f}.").format(*six) in told
    there = np.sort(reached_of(grid()["deploy-256-kl3-gamma98-c"], 15) / 1e6)
    mine = reached_of(of_fresh("c")[1], 15).mean() / 1e6
    text = f"at 15 after {there[0]:.1f} and {there[1]:.1f} M, `deploy` is after {mine:.1f}."
    assert text in told and np.isnan(there[2])
    three = reached_of(anymals["deploy-256-kl3-gamma99-c"], 15) / 1e6
    assert three.min() > there[1] and "gamma 0.99 all three ANYmal-C learn, but later" in told
    of_all = [n for n, job in anymals.items() if np.isfinite(reached_of(job, 15)).all()]
    assert of_all == ["deploy-256-kl3-gamma99-c"]


def steps_between(job):
    """Of the first two evaluations."""
    run = less("ppo")[0].seeds(job)[0]
    return run[1]["sim_steps"] - run[0]["sim_steps"]


@functools.cache
def older_fresh():
    """PPO's ten seeds by the rule of the eleven settings."""
    return less("ppo")[0].read(LESS / "results/ppo_tasks.csv.xz", "deploy")


def test_that_a_robot_of_which_none_gets_there_gets_no_setting(tmp_path, monkeypatch, capsys):
    """All tie there; of the others' jobs the first fresh ones were made."""
    choose = script("21_less/choose")
    given = [
        str(LESS / "results/ppo.csv.xz"),
        str(LESS / "ppo_deploy.txt"),
        str(tmp_path / "fresh.txt"),
    ]
    flags = "--level --returns 30 20 --seed 1600 --episodes 200 --often 1".split()
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    said = capsys.readouterr().out
    for robot in ("anymal_c", "anymal_d"):
        assert f"{robot}:deploy: no seed of any setting gets there, so none is chosen\n" in said
    found = paper.jobs(tmp_path / "fresh.txt")
    assert list(found) == ["level-deploy-256-kl3-g", "level-deploy-256-kl3-gamma98-h"]
    assert all(older_fresh()[name][0]["job"] == line for name, line in found.items())


def test_the_fresh_runs_are_what_the_rule_of_all_17_settings_makes(tmp_path, monkeypatch):
    choose, (table, _) = script("21_less/choose"), less("ppo")
    lists = [str(LESS / f"ppo_deploy{x}.txt") for x in ("", "_edges")]
    given = [str(LESS / "results/ppo.csv.xz"), *lists, str(tmp_path / "fresh.txt")]
    flags = "--level --returns 30 15 --times 2 --seed 1620 --episodes 200 --often 1".split()
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    found = paper.jobs(tmp_path / "fresh.txt")
    assert list(found) == [f"level-deploy-{name}-{x}" for x, (name, _) in TAKEN.items()]
    for name, line in found.items():
        job = of_fresh(name[-1])[0]
        assert job[0]["job"] == line and job[0]["commit"].startswith("32eca169")
        assert len(table.seeds(job)) == 10 and job[-1]["sim_steps"] == 18432000


def test_ten_seeds_before_are_told_as_they_ran():
    told, jobs = words(part("On fresh seeds", "###").split("\n### ")[0]), older_fresh()
    assert {job[0]["commit"][:8] for job in jobs.values()} == {"23049457"}
    go1, mine = jobs["level-deploy-256-kl3-g"], reached_of(of_fresh("g")[1], 30)
    its = reached_of(go1, 30)
    one = stats.ratio(its, mine)
    text = f"A Go1 had the same setting: {its.mean() / 1e6:.2f} M to 30, {one.value:.1f} times those of"
    text += f" `deploy` ({span(one)}); of both tens"
    both = np.concatenate([its, reached_of(of_fresh("g")[0], 30)]).mean() / 1e6
    assert f"{text} {both:.2f}." in told
    go2 = reached_of(jobs["level-deploy-256-kl3-gamma98-h"], 30)
    assert np.isfinite(go2).sum() == 4 and "On a Go2, gamma 0.98, four of ten were at 30." in told
    there = [np.isfinite(reached_of(jobs[f"level-deploy-128-kl3-{x}"], 15)).sum() for x in "cd"]
    assert there == [1, 1] and "128 robots: one of ten each was at 15." in told


def test_a_choice_from_two_places_and_two_lists_is_one_of_all_their_runs(
    tmp_path, monkeypatch, capsys
):
    """FOLDER has the later runs and `--also` the earlier ones; of a name that both have FOLDER's count. Of
    equal ones that with the highest last return is taken, and twice as long."""
    choose, run = script("21_less/choose"), script("21_less/run")
    line = "go1:best run.eval_every=20 run.num_iterations=100 ppo.epochs="
    jobs = {name: f"{line}{k}" for k, name in enumerate("abc")}

    def rows(name, first, last):
        """Two evaluations of two seeds, that are at 30 at the first or second, or never."""
        values = {1: (31.0, last), 2: (3.0, last), 0: (3.0, 4.0)}[first]
        return [
            {
                "job": jobs[name],
                "seed": seed,
                "sim_steps": 1e6 * (k + 1),
                "return": value,
                "fall_rate": 0.0,
                "early": 0.0,
            }
            for k, value in enumerate(values)
            for seed in (0, 1)
        ]

    places = {"early": {"a": (2, 35.0), "b": (1, 44.0)}, "late": {"b": (2, 33.0), "c": (2, 36.0)}}
    for folder, mine in places.items():
        (tmp_path / folder).mkdir()
        for name, given in mine.items():
            run.write(tmp_path / folder / f"{name}.csv", rows(name, *given))
    one, two, out = tmp_path / "one.txt", tmp_path / "two.txt", tmp_path / "fresh.txt"
    one.write_text(f"a {jobs['a']}\nb {jobs['b']}\n")
    two.write_text(f"c {jobs['c']}\n")
    flags = "--level --returns 30 15 --times 2 --seed 1620 --episodes 200 --often 1 --also".split()
    given = ["choose.py", str(tmp_path / "late"), str(one), str(two), str(out), *flags]
    monkeypatch.setattr("sys.argv", [*given, str(tmp_path / "early")])
    choose.main()
    assert (
        "go1:best: a, b, c are equal; of these the highest last return is taken"
        in capsys.readouterr().out
    )
    (line,) = out.read_text().splitlines()
    asked = "run.eval_every=20 run.num_iterations=200 ppo.epochs=2 run.seed=1620 run.num_seeds=10"
    asked += " run.eval_envs=200"
    assert line.split()[:2] == ["level-c", "go1:best"] and {*line.split()[2:]} == {*asked.split()}
    monkeypatch.setattr("sys.argv", given[:-1])
    with pytest.raises(SystemExit, match="late lacks a; run them first$"):
        choose.main()
    # in the other place b alone is at 30 at its first evaluation
    given[1] = str(tmp_path / "early")
    monkeypatch.setattr("sys.argv", [*given, str(tmp_path / "late")])
    choose.main()
    assert out.read_text().startswith("level-b ")


def test_settings_at_the_edges_of_the_grid_differ_in_what_the_page_says():
    """Each job of ppo_deploy_edges.txt beside 256 robots and a KL of 0.03 of the same robot."""
    told = words(PAGE.read_text())
    asked, base = (paper.jobs(LESS / f"ppo_deploy{x}.txt") for x in ("_edges", ""))
    mine = config_lib.validate(config_lib.load("go1:deploy")).ppo
    others = f"({mine.gamma}, {mine.lambda_}, {mine.desired_kl})"
    assert f"gamma, lambda and KL of `deploy` itself {others}" in told
    changes = {
        "256-kl1": {"ppo.desired_kl": 0.01},
        "256-kl3-gamma99": {"ppo.gamma": 0.99},
        "256-kl2-gamma98": {"ppo.gamma": 0.98, "ppo.desired_kl": 0.02},
        "128-kl3-gamma98": {"ppo.gamma": 0.98, "rollout.num_envs": 128},
        "512-kl3-gamma98": {"ppo.gamma": 0.98, "rollout.num_envs": 512},
        "256-kl2-gamma98-lam95": {
            "ppo.gamma": mine.gamma,
            "ppo.lambda_": mine.lambda_,
            "ppo.desired_kl": mine.desired_kl,
        },
    }
    assert changes.keys() == EDGES.keys()
    assert asked.keys() == {f"deploy-{n}-{x}" for n in changes for x in "ghcd"}
    for name, line in asked.items():
        one, other = config_of(line), config_of(base[f"deploy-256-kl3-{name[-1]}"])
        assert schedule.sim_steps(one)[-1] == schedule.sim_steps(other)[-1]
        pair = [flat(x) for x in (one, other)]
        differ = {key: pair[0][key] for key in pair[0] if pair[0][key] != pair[1][key]}
        scaled = {"run.num_iterations", "run.eval_every", "schedule.late_from"}
        assert {k: v for k, v in differ.items() if k not in scaled} == changes[name[7:-2]], name


def test_settings_beyond_the_edges_of_the_anymals_differ_in_what_the_page_says():
    """Each job of ppo_deploy_anymals.txt beside 512 robots of the same robot."""
    told = words(part("Three more on the ANYmals", "###"))
    asked, base = (paper.jobs(LESS / f"ppo_deploy{x}.txt") for x in ("_anymals", ""))
    more = {"rollout.num_envs": 1024}
    changes = {"512-kl3-gamma99": {}, "1024-kl3": more, "1024-kl3-gamma99": more}
    assert changes.keys() == ANYMALS.keys()
    assert asked.keys() == {f"deploy-{n}-{x}" for n in changes for x in "cd"}
    assert f"{len(asked)} jobs of seeds 0 to 2 (`ppo_deploy_anymals.txt`)" in told
    assert f"of all {len(SETTINGS | EDGES) + len(changes)} settings of a robot" in told
    for name, line in asked.items():
        both = line, base[f"deploy-512-kl3-{name[-1]}"]
        one, other = (config_of(f"{x} run.log_every=15") for x in both)  # as run.py has it
        steps = [schedule.sim_steps(x) for x in (one, other)]
        ends = [[steps[k][x.run.eval_every - 1], steps[k][-1]] for k, x in enumerate((one, other))]
        assert ends[0] == ends[1]
        pair = [flat(x) for x in (one, other)]
        differ = {key: pair[0][key] for key in pair[0] if pair[0][key] != pair[1][key]}
        scaled = {"run.num_iterations", "run.eval_every", "schedule.late_from"}
        gamma = {"ppo.gamma": 0.99} if "gamma99" in name else {}
        assert {k: v for k, v in differ.items() if k not in scaled} == changes[name[7:-2]] | gamma


@functools.cache
def more_anymals():
    """The three settings that ran later on the ANYmals."""
    return batches("14")


def test_the_table_of_three_more_settings_on_the_anymals_is_that_of_their_runs():
    table, asked = less("ppo")[0], paper.jobs(LESS / "ppo_deploy_anymals.txt")
    text, ran = part("Three more on the ANYmals", "###"), more_anymals()
    shown = [cells(line) for line in text.splitlines() if line.startswith("| ")][1:]
    assert asked.keys() == ran.keys()
    rows = []
    for name, label in ANYMALS.items():
        row = [label]
        for x in "cd":
            job = ran[f"deploy-{name}-{x}"]
            assert job[0]["job"] == asked[f"deploy-{name}-{x}"] and len(table.seeds(job)) == 3
            assert job[-1]["sim_steps"] == 9216000 and job[0]["commit"].startswith("05f6d8fb")
            steps = reached_of(job, ASKED[x]) / 1e6
            there = int(np.isfinite(steps).sum())
            first = f"{np.nanmean(steps):.2f} ({there})" if there else "none"
            row.append(f"{first}; {np.mean(ends_of(job)):.1f}")
        rows.append(row)
    assert shown == rows
    assert "05f6d8fb; batch 14 of `ppo.csv.xz`" in words(text)


def test_none_of_three_more_settings_wins_on_an_anymal(tmp_path, monkeypatch):
    """As choose.py has it, of all 20; and what the page says of them."""
    choose = script("21_less/choose")
    lists = [str(LESS / f"ppo_deploy{x}.txt") for x in ("", "_edges")]
    given = [str(LESS / "results/ppo.csv.xz"), *lists, str(tmp_path / "fresh.txt")]
    given += ["--beyond", str(LESS / "ppo_deploy_anymals.txt")]
    flags = "--level --returns 30 15 --times 2 --seed 1640 --episodes 200 --often 1".split()
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    assert (tmp_path / "fresh.txt").read_text() == ""
    told = words(part("Three more on the ANYmals", "###"))
    assert "None of the three is, on either robot. So none ran on fresh seeds" in told
    jobs = {n: job for n, job in (grid() | more_anymals()).items() if n[-1] in "cd"}
    cost = {n: choose.cost(job, "level", (30, 15)) / 1e6 for n, job in jobs.items()}
    first, later = set(), []
    for x in "cd":
        mine = sorted((n for n in cost if n[-1] == x), key=cost.get)
        assert len(mine) == 20 and mine[0] == f"deploy-{TAKEN[x][0]}-{x}"
        first.add(f"{cost[mine[1]] - cost[mine[0]]:.1f}")
        later.append(cost[f"deploy-1024-kl3-{x}"] - cost[mine[0]])
    (gap,) = first
    text = f"the choice above stands, on both {gap} M before the next. 1024 robots are"
    assert "{} {:.1f} and {:.1f} M later than it".format(text, *later) in told
    gamma = [job for n, job in more_anymals().items() if "gamma99" in n]
    assert len(gamma) == 4 and all(np.isnan(reached_of(job, 15)).all() for job in gamma)
    assert "and with gamma 0.99 no seed is at 15." in told
    assert "We expected** that one of them wins on both. That was wrong." in told
    # the same two settings in longer runs
    here = [less("ppo")[1][f"deploy-{n}-c"] for n in (512, 1024)]
    there = [(grid() | more_anymals())[f"deploy-{n}-kl3-c"] for n in (512, 1024)]
    few = [int((reached_of(job, 15) <= 9216000).sum()) for job in there + here]
    text = "of three ANYmal-C one each is at 15 by 9.2 M there, and two each here."
    assert few == [1, 1, 2, 2] and text in words(part("Hardware"))
    lines = (
        more_anymals()["deploy-1024-kl3-c"][0]["job"],
        less("ppo")[1]["deploy-1024-c"][0]["job"],
    )
    now, then = (config_of(f"{line} run.log_every=5") for line in lines)
    pair = [{k: v for k, v in flat(x).items() if k[:4] != "run."} for x in (now, then)]
    assert {k for k in pair[0] if pair[0][k] != pair[1][k]} == {"schedule.late_from"}
    assert now.ppo.late_kl == then.ppo.late_kl == 1  # so it does nothing
    page = words((DEPLOY / "README.md").read_text())
    text = "An ANYmal-C's best has gamma 0.99, the largest that ran, an ANYmal-D's 512 robots; 1024"
    text += " robots are later on both, and so is gamma 0.99 with 512 or 1024."
    assert (
        text in page and "17 settings were tried on four robots, three more on the ANYmals" in page
    )
    assert all(np.isnan(reached_of(job, 20)).all() for job in more_anymals().values())
    assert "No ANYmal is at 20 by 9.2 M with any." in page


def flat(config):
    """`group.field -> value`."""
    return {
        f"{g}.{k}": v
        for g, group in config.items()
        if hasattr(group, "items")
        for k, v in group.items()
    }


def config_of(line):
    job, *fields = line.split()
    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    for field in fields:
        config_lib.override(config, *field.split("=", 1))
    return config_lib.validate(config)


def span(one):
    return f"{one.low:.1f} to {one.high:.1f}"


def more_or_less(one):
    """Of an interval with zero in it: `value more, low less to high more`."""
    assert one.low < 0 < one.high
    return f"{one.value:.1f} more, {-one.low:.1f} less to {one.high:.1f} more"


def test_the_tables_of_ppo_for_hardware_on_fresh_seeds_are_those_of_their_runs():
    """PPO's ten beside five of `deploy` and five with longer tails."""
    table, _ = less("ppo")
    text = part("On fresh seeds", "###").split("\n### ")[0]
    shown = [cells(line) for line in text.splitlines() if line.startswith(("| Go", "| ANY"))]

    def at(job, millions):
        back, fell = (table.between(job, millions * 1e6, c) for c in ("return", "fall_rate"))
        return f"{table.spread(back)}, {100 * fell.mean():.1f} %"

    rows = []
    for x in "ghcd":
        levels = (20, 30, 35) if x in "gh" else (15, 20)
        labels = TAKEN[x][1], "`deploy`", "longer tails"
        for label, job in zip(labels, of_fresh(x), strict=True):
            runs = table.seeds(job)
            row = [f"{ROBOT_OF[x]}, {label}", str(len(runs))]
            row += [table.steps_of([table.first(run, level) for run in runs]) for level in levels]
            rows.append([*row, *(at(job, m) for m in (1.8, 9.2, 18.4))])
    assert shown == rows
    told = words(PAGE.read_text())
    # to 30, and an ANYmal-C to 15
    ratios, means, all_p = {}, {}, []
    for x, level in (("g", 30), ("h", 30), ("c", 15)):
        its, *ours = (reached_of(job, level) for job in of_fresh(x))
        assert len(its) == 10 and np.isfinite(its).all()
        for mine in ours:
            assert len(mine) == 5 and mine.max() < its.min()
            all_p.append(stats.rank_sum(its, mine))
        ratios[x], means[x] = [stats.ratio(its, mine) for mine in ours], its.mean() / 1e6
    # all of ten after all of five; ties make some of these smaller
    most = max(all_p)
    assert most == pytest.approx(2 / math.comb(15, 5)) and len(all_p) == 6
    assert f"(rank tests, p at most {most:.4f}, Holm over these six {6 * most:.3f})" in told
    g, h, c = (ratios[x] for x in "ghc")
    text = f"PPO needs {means['g']:.2f} M steps on a Go1 and {means['h']:.2f} M on a Go2: {g[0].value:.1f}"
    text += f" times those of `deploy` (95 %: {span(g[0])}) and {h[0].value:.1f} times"
    text += f" ({span(h[0])}), and {around(g[1])} and {h[1].value:.1f} times"
    assert f"{text} ({span(h[1])}) those of longer tails." in told
    text = "An ANYmal-C of PPO is at 15, a goal set after looking at tuning runs, after"
    text += f" {means['c']:.2f} M, {c[0].value:.1f} and {c[1].value:.1f}"
    text += f" times as many ({span(c[0])}; {span(c[1])})"
    assert text in told
    # to 35
    later = {x: [reached_of(job, 35) for job in of_fresh(x)] for x in "gh"}
    two = {x: [stats.ratio(its, mine) for mine in ours] for x, (its, *ours) in later.items()}
    assert all(one[0].low < 1 < one[0].high for one in two.values())
    text = f"PPO needs {two['g'][0].value:.2f} times the steps of `deploy` on a Go1"
    text += " ({:.2f} to {:.2f}) and {:.2f} on a Go2 ({:.2f} to {:.2f}), and".format(
        *two["g"][0][1:], *two["h"][0]
    )
    text += " {:.1f} ({:.1f} to {:.1f}) and {:.1f} times ({:.1f} to {:.1f}) those of longer tails."
    assert text.format(*two["g"][1], *two["h"][1]) in told
    fifth = [round(two[x][1].value) for x in "gh"]
    assert fifth == [5, 7] and "longer tails need a fifth and a seventh of PPO's steps" in told
    # the ANYmals to 15 and 20
    its, mine, tails = ([reached_of(of_fresh(x)[k], 20) / 1e6 for x in "cd"] for k in range(3))
    assert [int(np.isfinite(x).sum()) for x in its] == [0, 3]
    by_then = sum((x < 18.432).sum() for x in mine)
    assert (
        by_then == 1 and "At 20 three of these twenty are by then, of `deploy` one of ten," in told
    )
    text = f"with longer tails all ten by {np.concatenate(tails).max():.1f}"
    assert text in told and np.isfinite(np.concatenate(tails)).all()
    first, last = np.nanmin(its[1]), np.nanmax(its[1])
    text = f"no ANYmal-C is there by 18.4 M, and three of ten ANYmal-D after {first:.1f} to {last:.1f}."
    text += " `deploy` is after {:.1f} and {:.1f} M,".format(*(x.mean() for x in mine))
    text += " the soonest after {:.1f} and {:.1f}.".format(*(x.min() for x in mine))
    assert text in told
    six = np.isfinite(reached_of(of_fresh("d")[0], 15)).sum()
    assert six == 6 and "of ten ANYmal-D six are by 18.4 M" in told
    low = [run[-1] for run in table.seeds(of_fresh("d")[0]) if run[-1]["return"] < 4]
    fell = [100 * row["fall_rate"] for row in low]
    text = f"four return less than 4 at the end, and fall in {min(fell):.0f} to {max(fell):.0f} %"
    assert text in told and len(low) == 4
    nine = [np.isfinite(reached_of(of_fresh(x)[0], 20)) for x in "cd"]
    by_then = [reached_of(of_fresh(x)[0], 20)[k] for x, k in zip("cd", nine, strict=True)]
    assert np.concatenate(by_then).min() > 9.2e6
    assert "at 20 by 9.2 M, and most by 18.4. None and three of twenty are." in told
    # as the settings were tuned
    names = [f"deploy-{name}-{x}" for x, (name, _) in TAKEN.items()]
    then = [reached_of(grid()[n], ASKED[n[-1]]) / 1e6 for n in names]
    assert [int(np.isfinite(x).sum()) for x in then] == [3, 2, 3, 2]
    text = (
        "needed {:.2f} M (Go1), {:.2f} (Go2; two of three get there), {:.2f} (ANYmal-C) and {:.2f}"
    )
    text += " (ANYmal-D;"
    assert text.format(*map(np.nanmean, then)) in told
    # other settings, longer
    _, jobs = less("ppo")
    few, many = (reached_of(jobs[f"deploy-{n}-c"], 15) for n in (512, 1024))
    of_deploy = reached_of(of_fresh("c")[1], 15)
    shares = [stats.ratio(x, of_deploy).value for x in (few, many)]
    text = "with 512 and 1024 robots is at 15 sooner, after"
    text += f" {few.mean() / 1e6:.1f} and {many.mean() / 1e6:.1f} M (ANYmal-C;"
    assert f"{text} {shares[0]:.1f} and {shares[1]:.1f} times `deploy`)" in told
    ends = [table.between(x, 18.4e6, "return") for x in (jobs["deploy-1024-c"], of_fresh("c")[0])]
    value, low, high = stats.difference(*ends)
    assert (
        f"returns {value:.1f} more there than this PPO, {low:.1f} to {high:.1f}, on tuning seeds"
        in told
    )
    # at equal steps
    more = {
        (x, at): [stats.difference(table.between(job, at * 1e6, "return"), its) for job in ours]
        for x in "ghcd"
        for at in (1.8, 9.2, 18.4)
        for its, ours in [(table.between(of_fresh(x)[0], at * 1e6, "return"), of_fresh(x)[1:])]
    }
    fell = [100 * table.between(of_fresh(x)[0], 1.8e6, "fall_rate").mean() for x in "gh"]
    assert (
        "a robot of PPO falls in {:.0f} and {:.0f} % of its episodes (Go1, Go2)".format(*fell)
        in told
    )
    text = "`deploy` returns {:.1f} more on a Go1 ({:.1f} to {:.1f}) and {:.1f} on a Go2 ({:.1f} to {:.1f}),"
    text = text.format(*more["g", 1.8][0], *more["h", 1.8][0])
    text += " longer tails {:.1f} and {:.1f}.".format(*(more[x, 1.8][1].value for x in "gh"))
    assert text in told
    text = f"on a Go1 ({more_or_less(more['g', 9.2][0]).replace(',', ';')})"
    assert text in told
    assert "Longer tails return {:.1f} more ({:.1f} to {:.1f}).".format(*more["g", 9.2][1]) in told
    text = "On a Go2 `deploy` returns {:.1f} ({:.1f} to {:.1f}) and longer tails {:.1f} more ({:.1f} to"
    text += " {:.1f})"
    assert text.format(*more["h", 9.2][0], *more["h", 9.2][1]) in told
    text = "; ".join(more_or_less(more[x, 18.4][0]) for x in "gh")
    text = f"**After 18.4 M** none is shown on either ({text}). Longer tails return"
    text += " {:.1f} ({:.1f} to {:.1f}) and {:.1f} more ({:.1f} to {:.1f}), on ANYmals".format(
        *more["g", 18.4][1], *more["h", 18.4][1]
    )
    text += f" {around(more['c', 18.4][1])} and {around(more['d', 18.4][1])}, `deploy`"
    text += f" {around(more['c', 18.4][0])} and {around(more['d', 18.4][0])}."
    assert text in told
    # what is not equal
    every = [steps_between(job) / 1e6 for job in of_fresh("g")]
    run = [r["sim_steps"] / 1e6 for r in table.seeds(of_fresh("g")[1])[0]]
    text = "PPO is evaluated every {:.2f} M steps, `deploy` every {:.2f} and from {:.1f} M on every {:.1f},"
    text = text.format(*every[:2], run[6], run[9] - run[8])
    assert f"{text} longer tails every {every[2]:.2f};" in told
    its, *ours = (reached_of(job, 30) for job in of_fresh("g"))
    less_one = [stats.ratio(its - 1e6 * every[0], mine).value for mine in ours]
    assert "it still needs {:.1f} and {:.1f} times as many on a Go1.".format(*less_one) in told
    config = config_lib.validate(config_lib.load("go1:deploy"))
    task, robots = config.task, [config.rollout.num_envs, 1024, 256]
    lived = [x.mean() / n / task.episode_length for x, n in zip([*ours, its], robots, strict=True)]
    text = "a Go1 of `deploy` has had {:.1f}, one with longer tails {:.1f}, one of PPO {:.0f}."
    assert text.format(*lived) in told
    paid = [min(1, task.clearance_start + task.clearance_ramp * x) for x in lived]
    assert "at most {:.2f} and {:.2f} of that weight".format(*paid[:2]) in told and paid[2] == 1


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
    two = [
        stats.ratio(reached_of(of_fresh("h")[0], 30), reached_of(j, 30)) for j in of_fresh("h")[1:]
    ]
    text = f"{one.value:.1f} times the steps on a Go1 ({span(one)}; ten and five fresh"
    text += f" seeds) and {two[0].value:.1f} times on a Go2 ({span(two[0])})."
    assert text in page
    fifteen = [reached_of(job, 15) / 1e6 for job in of_fresh("c")[:2]]
    three = stats.ratio(*fifteen)
    text = "An ANYmal-C of PPO is at 15, a goal set after looking at tuning runs, after"
    text += f" {fifteen[0].mean():.1f} M steps, {three.value:.1f} times as"
    text += f" many ({span(three)}); of ten ANYmal-D six are by 18.4 M, all five of `deploy`"
    assert f"{text} by {reached_of(of_fresh('d')[1], 15).max() / 1e6:.2f}." in page
    text = f"a Go1 is at 30 after {mine.mean():.1f} M steps, with a PPO [tuned on this"
    text += f" task](../experiments/21_less/ppo_tasks.md) after {its.mean():.1f} ({one.value:.1f} times as"
    assert f"{text} many, {span(one)}; five and ten fresh seeds)" in results
    text = f"needs {other.value:.1f} times their steps to 30 on a Go1 ({span(other)})"
    assert text in results and text in page
    text = f"PPO needs {other.value:.1f} times the steps of 1024 robots with long tails to 30 on a Go1 ("
    text += f"{span(other)}), and {two[1].value:.1f} times on a Go2 ({two[1].low:.1f} to"
    assert f"{text} {two[1].high:.1f})" in steps
    text = f"needs {one.value:.1f} times the steps of `deploy` to a return of 30 on a Go1 ({one.low:.1f} to"
    text += f" {one.high:.1f}; ten and five fresh seeds), and {other.value:.1f} times those of longer tails"
    assert f"{text} ({span(other)})" in verdict
    at = {
        m: [table.between(job, m * 1e6, "return") for job in of_fresh("g")[:2]] for m in (1.8, 9.2)
    }
    assert f"a Go1 returns {at[1.8][1].mean():.1f}, with PPO {at[1.8][0].mean():.1f}." in page
    value, low, high = stats.difference(at[9.2][1], at[9.2][0])
    text = f"returns {at[9.2][1].mean():.1f}, with PPO {at[9.2][0].mean():.1f}"
    assert f"{text} ({value:.1f} more; {-low:.1f} less to {high:.1f} more)" in page
    assert (
        f"after 9.2 M it {text} ({value:.1f} more; {-low:.1f} less to {high:.1f} more);" in results
    )
    means = [reached_of(of_fresh(x)[0], 35).mean() / 1e6 for x in "gh"]
    last = max(reached_of(of_fresh(x)[2], 35).max() for x in "gh") / 1e6
    text = "At 35 its ten Go1 are after {:.1f} M in the mean and its ten Go2 after {:.1f},"
    assert f"{text.format(*means)} with these tails all by {last:.2f}." in steps
    twenty = [reached_of(of_fresh(x)[2], 20).max() / 1e6 for x in "cd"]
    text = f"three are at 20 by 18.4 M, of `deploy` one of ten, with these tails all by {max(twenty):.2f}."
    assert text in steps
    assert "Of ten of that PPO none is there by 18.4 M" in page
    anymal = [table.between(job, 18.4e6, "return") for job in of_fresh("c")[:2]]
    value, low, high = stats.difference(*anymal[::-1])
    text = f"returns {value:.1f} more than the tuned PPO after 18.4 M ({low:.1f} to {high:.1f})"
    assert text in page and text.replace("than the", "than with the") in results
    other = less("ppo")[1]["deploy-1024-c"]
    value, low, high = stats.difference(anymal[1], table.between(other, 18.4e6, "return"))
    text = f"({-value:.1f} less; {-low:.1f} less to {high:.1f} more; three tuning seeds)"
    assert text in page and high > 0


def test_the_table_of_longer_runs_of_ppo_for_hardware_is_that_of_its_runs():
    """512 and 1024 robots, and 256, of ppo_others.txt, each to its end; beside `deploy`."""
    table, jobs = less("ppo")
    asked = {
        n: job for n, job in paper.jobs(LESS / "ppo_others.txt").items() if n.startswith("deploy")
    }
    text = part("Hardware").split("### Longer runs\n")[1]
    shown = [cells(line) for line in text.splitlines() if line.startswith("| PPO, ")]
    assert shown == rows_of({n: job for n, job in asked.items() if "-256-" not in n})
    told, anymal = words(text), [jobs[f"deploy-{n}-c"] for n in (256, 512, 1024)]
    levels = {"g": 38, "c": 24}
    assert all(np.isnan(reached_of(jobs[name], levels[name[-1]])).all() for name in asked)
    every = [*grid().items(), *((x, of_fresh(x)[0]) for x in "ghcd")]
    assert all(np.isnan(reached_of(job, 38 if n[-1] in "gh" else 24)).all() for n, job in every)
    mine = less("ppo")[0].read(DEPLOY / "fewer.csv.xz")["fresh-deploy-c"]
    twenty = reached_of(mine, 20) / 1e6
    tails = reached_of(of_fresh("c")[2], 20).mean() / 1e6
    text = f"is there after {twenty.mean():.1f} M steps (first to last seed {twenty.min():.1f} to"
    assert f"{text} {twenty.max():.1f}), longer tails after {tails:.1f}." in told
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
    text = f"with 1024 robots after {at:.1f} M {one:.1f} and {other:.1f} ({value:.2f} more; {-low:.2f} less"
    text += f" to {high:.2f} more),"
    for robots in (512, 256):
        text += " with {} after {:.1f} M {:.1f} and {:.1f},".format(robots, *gaps[robots][:3])
    assert f"three seeds cannot tell it from `deploy`: {text[:-1]}." in told
    then, today = (table.read(DEPLOY / "deploy.csv.xz", batch) for batch in "14")
    older, end = today["anymal_c-bundled"], anymal[2][-1]["sim_steps"]
    pair = [table.between(job, end, "return") for job in (anymal[2], older)]
    value, low, high = stats.difference(*pair)
    text = f"ahead of the older five seeds of `deploy`, {value:.2f} more ({low:.2f} to {high:.2f},"
    assert f"{text} uncorrected)" in told
    ends = sorted({row["sim_steps"] / 1e6 for row in older})
    assert f"evaluations {ends[3] - ends[2]:.0f} M apart" in told
    # why, and then
    assert config_lib.load("anymal_c:deploy").physics.iterations == 10
    config = config_lib.validate(config_lib.load("anymal_c:deploy"))
    thousand = config.rollout.num_envs * config.rollout.horizon / 1e3
    assert f"From iteration {config.schedule.last_iteration} on it has no tail" in told
    assert f"{thousand:.0f} thousand steps an iteration" in told
    few, many = (config_of(asked[f"deploy-{n}-c"]).rollout for n in (512, 1024))
    rows = [x.num_envs * x.horizon / 1e3 for x in (few, many)]
    assert "PPO in this table takes {:.0f} and {:.0f} thousand.".format(*rows) in told
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
    text = f"It takes {twenty.mean():.1f} M steps to 20"
    assert f"{text} (five seeds, the soonest {twenty.min():.1f})." in page
    text = f"takes {twenty.mean():.1f} M steps to 20; of nine runs of PPO with few robots, not"
    assert f"{text} tuned on this task, three get there, after 14 to 19." in results
    assert "three of nine runs, with 512 and 1024 robots, take 14 to 19" in page


def rows_of(asked):
    """Of the tables that have all columns; the label is task, robot and number of robots."""
    table, jobs = less("ppo")
    rows = []
    for name, line in asked.items():
        job, (_, robots, letter) = jobs[name], name.split("-")
        assert job[0]["job"] == line and {x["batch"] for x in job} == {
            "7" if letter == "c" else "6"
        }
        assert job[-1]["iteration"] == float(re.search(r"num_iterations=(\d+)", line)[1])
        row = cells(table.table({name: job}, table.best(job)).splitlines()[-1])
        label = f"PPO, {ROBOT_OF[letter]}, {robots} robots"
        rows.append([label, *row[5:8], row[3], row[2], *row[9:11]])
    return rows


EXACT = {"g": ("go1.exact", 38), "c": ("anymal_c.exact", 24)}  # the place of 30_row_cost; the level


@functools.cache
def exact():
    """The grid of the exact task; `fresh runs -> letter -> job`; `best`."""
    table = less("ppo")[0]
    ran = batches("10", "11", "13")
    fresh = {}
    for batch in ("exact", "exact 64", "exact walks"):
        for name, job in table.read(LESS / "results/ppo_tasks.csv.xz", batch).items():
            fresh.setdefault(batch, {})[name[-1]] = job
    mine = {
        letter: one
        for one in script(f"{ROW_COST}/table").runs()
        for letter, (place, _) in EXACT.items()
        if one[:3] == (place, "H200, 2026-11-28", "best")
    }
    return ran, fresh, mine


def exact_reached(job, letter, until=np.inf):
    """`stats.Reached` of each seed, of the evaluations that are no later than `until`."""
    runs = [[row for row in run if row["sim_steps"] <= until] for run in less("ppo")[0].seeds(job)]
    return less("ppo")[0].reached(runs, EXACT[letter][1])


def test_the_grid_of_the_exact_task_is_that_of_its_runs():
    """22 jobs, four of them of a later host, and six of one later still."""
    table, ran = less("ppo")[0], exact()[0]
    first, later = (paper.jobs(LESS / f"ppo_exact{x}.txt") for x in ("", "_edges"))
    asked, settings = first | later, SETTINGS | EXACT_EDGES
    assert asked.keys() == ran.keys() == {f"exact-{n}-{x}" for n in settings for x in "gc"}
    text = part("The exact task").split("\n### ")[0]
    shown = [cells(line) for line in text.splitlines() if line.startswith("| ")][1:]
    rows, late = [], {f"exact-{n}-kl3-{x}" for n in (256, 512) for x in "gc"}
    for name, label in settings.items():
        row = [label]
        for x in EXACT:
            job = ran[full := f"exact-{name}-{x}"]
            assert job[0]["job"] == asked[full]
            commit = "05f6d8fb" if full in later else "32eca169" if full in late else "23049457"
            assert job[0]["commit"].startswith(commit)
            assert job[-1]["sim_steps"] == 3686400 and len(table.seeds(job)) == 3
            found = exact_reached(job, x)
            end = np.mean(ends_of(job))
            row.append(f"{table.steps_of(found.level)}; {table.steps_of(found.walks)}; {end:.1f}")
        rows.append(row)
    assert shown == rows
    told = words(text)
    assert f"{len(first)} jobs to 3.7 M" in told and f"{len(first) - len(late)} ran beside" in told
    assert f"are {len(later)} jobs (`ppo_exact_edges.txt`, batch 13;" in told
    assert {round(steps_between(job) / 1e6, 2) for job in ran.values()} == {0.25}
    assert "200 episodes of 20 s every 0.25 M" in told
    # what the rule takes of all 14, and what was expected
    choose = script("21_less/choose")
    cost = {n: choose.cost(job, "level") / 1e6 for n, job in ran.items()}
    order = {x: sorted((n for n in cost if n[-1] == x), key=cost.get) for x in EXACT}
    assert [order[x][0] for x in "gc"] == ["exact-64-kl3-g", "exact-128-kl3-ep10-c"]
    pairs = [f"{cost[order[x][0]]:.2f} {cost[order[x][1]]:.2f}".split() for x in "gc"]
    text = "Of all 14 it takes 64 robots on a Go1 ({} M; the next {}) and 128 with 10 epochs on an"
    text = text.format(*pairs[0]) + " ANYmal-C ({}; the next {}).".format(*pairs[1])
    assert text in told and {len(one) for one in order.values()} == {14}
    assert order["g"][1] == "exact-128-kl5-g" and order["g"][-1] == "exact-64-kl5-g"
    assert cost[order["g"][-2]] < cost[order["g"][-1]]
    text = "Both were wrong: 128 robots with 10 epochs are sooner, and those 64 are the last of the 14."
    assert text in told
    walked = [np.isfinite(exact_reached(job, x).walks).sum() for x, job in fresh_of_ppo()]
    text = "no PPO walks on all ten fresh seeds by 3.7 M: that was right, at most seven do."
    assert max(walked) == 7 and text in told


def fresh_of_ppo():
    """`letter, job` of the six that ran on ten seeds."""
    return [(x, job) for jobs in exact()[1].values() for x, job in jobs.items()]


@pytest.mark.parametrize(
    ("batch", "seed", "more", "names"),
    [
        ("exact", 1600, "--level", ["level-exact-128-kl5-g", "level-exact-256-kl3-ep10-c"]),
        ("exact 64", 1620, "--level", ["level-exact-64-kl3-g", "level-exact-128-kl3-ep10-c"]),
        ("exact walks", 1600, "", ["walks-exact-256-kl2-g", "walks-exact-128-kl5-c"]),
    ],
)
def test_fresh_runs_on_the_exact_task_are_what_the_rule_takes(
    batch, seed, more, names, tmp_path, monkeypatch, capsys
):
    choose, table = script("21_less/choose"), less("ppo")[0]
    given, later = [str(LESS / "ppo_exact.txt")], str(LESS / "ppo_exact_edges.txt")
    if batch == "exact walks":
        given.append(later)
    given = [str(LESS / "results/ppo.csv.xz"), *given, str(tmp_path / "fresh.txt")]
    flags = f"--seed {seed} --episodes 200 --often 4 {more}".split()
    if batch == "exact 64":
        flags += ["--beyond", later]
    monkeypatch.setattr("sys.argv", ["choose.py", *given, *flags])
    choose.main()
    found, ran = paper.jobs(tmp_path / "fresh.txt"), exact()[1][batch]
    assert [*found] == names
    for name, line in found.items():
        job = ran[name[-1]]
        assert job[0]["job"] == line
        assert job[0]["commit"].startswith("32eca169" if batch == "exact" else "05f6d8fb")
        assert len(table.seeds(job)) == 10 and f"{steps_between(job) / 1e6:.2f}" == "0.06"
        assert job[-1]["sim_steps"] == (3379200 if name == "level-exact-64-kl3-g" else 3686400)
    said = capsys.readouterr().out
    equal = {
        "exact": "exact-128-kl5-c, exact-256-kl3-ep10-c, exact-256-kl3-mb8-c are equal",
        "exact walks": "exact-128-kl5-c, exact-256-kl3-gamma98-c are equal",
    }
    assert said.count(" are equal") == (batch in equal) and equal.get(batch, "") in said


def test_the_table_of_fresh_runs_on_the_exact_task_is_that_of_its_runs():
    table, (_, fresh, mine) = less("ppo")[0], exact()
    text = part("On fresh seeds, exact", "###")
    shown = [cells(line) for line in text.splitlines() if line.startswith(("| Go1", "| ANY"))]
    labels = {
        "g": (
            "PPO, 128 robots, KL 0.05, to the level, of eleven",
            "PPO, 64 robots, to the level, of 14",
            "PPO, KL 0.02, to walk",
        ),
        "c": (
            "PPO, 10 epochs, to the level, of eleven",
            "PPO, 128 robots, 10 epochs, to the level, of 14",
            "PPO, 128 robots, KL 0.05, to walk",
        ),
    }
    all_rows = script(f"{ROW_COST}/table").read()
    rows = []
    for x, (place, _) in EXACT.items():
        best = mine[x]
        own = [r for r in all_rows if (r["name"], r["batch"]) == (f"{place}.best", best.batch)]
        last = {}  # three evaluations of each seed, as table.py has it
        for row in own:
            last[row["seed"]] = [*last.get(row["seed"], []), row][-3:]
        back, fell = (
            np.array([np.mean([float(row[k]) for row in three]) for three in last.values()])
            for k in ("return", "fall_rate")
        )
        first = [table.steps_of(getattr(best, k)[:, 1]) for k in ("level", "walks")]
        end = [f"{best.end / 1e6:.1f}", f"{table.spread(back)}, {100 * fell.mean():.1f} %"]
        rows.append([f"{ROBOT_OF[x]}, `best`", str(len(last)), *first, *end])
        for label, jobs in zip(labels[x], fresh.values(), strict=True):
            job, found = jobs[x], exact_reached(jobs[x], x)
            end = cells(table.table({"": job}, table.best(job)).splitlines()[-1])[-2]
            first = [table.steps_of(found.level), table.steps_of(found.walks)]
            if job[-1]["sim_steps"] < 3686400:  # cut off
                until = f"not by {job[-1]['sim_steps'] / 1e6:.2f}"
                first = [cell.replace("never", until) for cell in first]
            millions = f"{job[-1]['sim_steps'] / 1e6:.1f}"
            runs = str(len(table.seeds(job)))
            rows.append([f"{ROBOT_OF[x]}, {label}", runs, *first, millions, end])
    assert shown == rows


def test_what_the_page_says_of_ppo_to_the_level_on_the_exact_task():
    """To compare: 128 robots on both, a KL of 0.05 on a Go1 and 10 epochs on an ANYmal-C."""
    table, jobs = less("ppo")
    _, fresh, mine = exact()
    told, page = words(part("On fresh seeds, exact", "###")), words(PAGE.read_text())
    its = {"g": fresh["exact"]["g"], "c": fresh["exact 64"]["c"]}
    its = {x: exact_reached(job, x).level for x, job in its.items()}
    best = {x: mine[x].level[:, 1] for x in EXACT}
    go1, anymal = (stats.ratio(its[x], best[x]) for x in "gc")
    text = f"To the level** PPO needs {go1.value:.1f} times the steps of `best` on a Go1 ({span(go1)}) and"
    assert f"{text} {anymal.value:.1f} times on an ANYmal-C ({span(anymal)})." in told
    means = [its[x].mean() / 1e6 for x in "gc"]
    text = "to the level, PPO needs {:.2f} M on a Go1 and {:.2f} M on an ANYmal-C:".format(*means)
    text += f" {go1.value:.1f} times the steps of `best` ({span(go1)}) and {anymal.value:.1f} times"
    assert (
        f"{text} ({span(anymal)}), ten fresh seeds. On an ANYmal-C that is the first of 14" in page
    )
    slow, soon = np.sort(best["g"])[-2:] / 1e6, its["g"].min() / 1e6
    text = f"the two slowest of `best`, after {slow[0]:.2f} M, are later than the soonest of PPO, after"
    assert f"{text} {soon:.2f};" in told and slow[0] == slow[1] > soon
    assert its["c"].min() > best["c"].max()
    older = exact_reached(fresh["exact"]["c"], "c").level
    then = stats.ratio(older, best["c"])
    text = f"With the ANYmal-C's winner of eleven it is {then.value:.1f} times ({span(then)}); the new one"
    value, low, high = (x / 1e6 for x in stats.difference(its["c"], older))
    text += f" needs {-value:.2f} M less, which is not shown to differ ({-low:.2f} less to {high:.2f} more,"
    p = stats.welch_of(its["c"], older)
    assert f"{text} p {p:.3f};" in told and p > 0.05
    # 64 robots
    job = fresh["exact 64"]["g"]
    few = exact_reached(job, "g").level / 1e6
    tuned = exact_reached(exact()[0]["exact-64-kl3-g"], "g").level / 1e6
    there = np.isfinite(few)
    assert there.sum() == 4 and np.isfinite(tuned).all() and len(tuned) == 3
    text = f"All three tuning seeds were at the level, after {tuned.mean():.2f} M. Of ten fresh ones four"
    text += f" are, after {few[there].min():.2f} to {few[there].max():.2f} M; the other six return"
    back = np.array(ends_of(job))[~there]
    text += (
        f" {back.min():.0f} to {back.max():.0f} after {job[-1]['sim_steps'] / 1e6:.2f} of 3.69 M"
    )
    assert text in told and len(back) == 6
    by = f"four of ten fresh seeds are at the level by {job[-1]['sim_steps'] / 1e6:.2f} M."
    assert f"with the first, 64 robots, {by}" in page
    # before
    before = [reached_of(jobs[f"exact-256-{x}"], EXACT[x][1]) for x in "gc"]
    text = "PPO needed {:.2f} and {:.2f} M (`ppo_others.txt`".format(
        *(x.mean() / 1e6 for x in before)
    )
    more = [stats.ratio(x, best[k]).value for x, k in zip(before, "gc", strict=True)]
    assert (
        text in told and "{:.1f} and {:.1f} times the steps of `best`. That".format(*more) in told
    )
    worth = [stats.ratio(its[k], x) for x, k in zip(before, "gc", strict=True)]
    less_now = [100 * (1 - x) for x in (worth[0].high, worth[0].low)]
    text = "That is a quarter less now on a Go1 ({:.0f} to {:.0f} %) and a fifth on an ANYmal-C,".format(
        *less_now
    )
    p = stats.welch_of(its["c"], before[1])
    assert f"{text} where a difference is not shown (p {p:.2f};" in told
    assert np.allclose([1 - x.value for x in worth], (0.25, 0.2), atol=0.025)
    assert all(steps_between(jobs[f"exact-256-{x}"]) == 2 * 61440 for x in "gc")
    walked = [
        int(np.isfinite(exact_reached(some[name], name[-1]).walks).sum())
        for some, name in (
            (jobs, "exact-256-g"),
            (jobs, "exact-512-c"),
            (exact()[0], "exact-512-kl3-c"),
        )
    ]
    assert walked == [2, 3, 0] and "two of three Go1 with 256 robots walked, and all three" in told
    first = [row for row in script(f"{ROW_COST}/table").read() if row["batch"] == mine["g"].batch]
    for name, until in (("go1.exact.best", 0.65), ("anymal_c.exact.best", 0.48)):
        steps = [int(r["sim_steps"]) for r in first if (r["name"], r["seed"]) == (name, "1100")]
        wide = next(k for k, gap in enumerate(np.diff(steps)) if gap > 1e5)
        assert f"{steps[wide] / 1e6:.2f}" == f"{until:.2f}" and steps[-1] - steps[-2] == 204800
    assert "every 0.04 M steps until 0.65 M (ANYmal-C: 0.48), then every 0.2" in told
    runs = sum(len(table.seeds(job)) for job in exact()[0].values())
    assert f"PPO was tuned on this task, in {runs} runs" in told
    # other pages
    other = words((EXPERIMENTS / "23_untuned/README.md").read_text())
    both = "{:.2f} and {:.2f} M".format(*means)
    assert f"needs {both} (ten fresh seeds, today's task)" in other
    assert f"{both}, ten fresh seeds, today's task)" in other
    row_cost = words((EXPERIMENTS / ROW_COST / "runs.md").read_text())
    text = f"it needs [{both} steps](../21_less/ppo_tasks.md#the-exact-task) on ten fresh seeds,"
    text += f" {around(go1)} and {anymal.value:.1f} times ({span(anymal)}) those of `best`"
    assert text in row_cost
    results, verdict = (
        words(x.read_text()) for x in (ROOT / "docs/results.md", EXPERIMENTS / "README.md")
    )
    text = f"needs {around(go1)} and {anymal.value:.1f} times ({span(anymal)}) the steps of `best`"
    assert f"{text} to the level (" in results
    assert (
        "On a Go1 it is the second of 14 settings; with the first, 64 robots, four of ten seeds"
        in results
    )
    text = (
        f"needs {go1.value:.1f} times the steps of `best` to the level on a Go1 ({span(go1)}) and"
    )
    assert f"{text} {anymal.value:.1f} times on an ANYmal-C ({span(anymal)};" in verdict
    first = words((EXPERIMENTS / ROW_COST / "README.md").read_text())
    two = f"{go1.value:.1f} and {anymal.value:.1f} times"
    text = f"[{two}](../21_less/ppo_tasks.md#the-exact-task)"
    assert f"PPO tuned there for few steps, whose seconds were not measured, needs {text}" in first
    assert f"In the exact tasks one tuned there needs {two} those of `best`." in first
    assert "tuned there for steps (128 robots, on an ANYmal-C with 10 epochs)" in first
    other = words((LESS / "README.md").read_text())
    assert (
        f"PPO tuned on the exact task, where it needs {two} the steps of `best` to the level"
        in other
    )


def test_what_the_page_says_of_walks_on_the_exact_task():
    _, fresh, mine = exact()
    told, page = words(part("On fresh seeds, exact", "###")), words(PAGE.read_text())
    walked = {x: exact_reached(job, x).walks for x, job in fresh["exact walks"].items()}
    ours, whole = mine["c"].walks[:, 1], fresh["exact walks"]["c"][-1]["sim_steps"]
    least = np.where(np.isnan(walked["c"]), whole, walked["c"])
    assert np.isfinite(walked["c"]).sum() == 7 and np.isfinite(ours).all() and len(ours) == 5
    text = f"all five seeds, the last after {ours.max() / 1e6:.2f} M. Of PPO's ten chosen to walk seven do"
    text += f" by {whole / 1e6:.2f} M, none before {least.min() / 1e6:.2f}"
    p = stats.rank_sum(walked["c"], ours)
    assert p == pytest.approx(2 / math.comb(15, 5)) and least.min() > ours.max()
    assert f"{text} (rank test, p {p:.4f})." in told
    text = f"walked at the end, PPO would need {least.mean() / ours.mean():.1f} times the steps."
    assert f"If the other three had {text}" in told
    text = f"All five ANYmal-C of `best` walk, the last after {ours.max() / 1e6:.2f} M; of PPO's ten seven"
    assert f"{text} do by {whole / 1e6:.2f} M, none before {least.min() / 1e6:.2f}." in page
    cut = exact_reached(fresh["exact walks"]["c"], "c", mine["c"].end).walks
    text = f"Cut off at {mine['c'].end / 1e6:.2f} M, where `best` ends, four count as walking, none before"
    both = exact_reached(fresh["exact walks"]["c"], "c", 2703360).walks
    text += f" {np.nanmin(cut) / 1e6:.2f}; cut off at 2.70 M six, the first after"
    assert f"{text} {np.nanmin(both) / 1e6:.2f}." in told
    assert np.isfinite(cut).sum() == 4 and np.isfinite(both).sum() == 6
    table = less("ppo")[0]
    thin = [
        [row for i, row in enumerate(run, 1) if i % 4 == 0]
        for run in table.seeds(fresh["exact walks"]["c"])
    ]
    thin = table.reached(thin, EXACT["c"][1]).walks / 1e6
    text = f"with every fourth of PPO's alone its first ANYmal-C walks after {np.nanmin(thin):.2f} M, and the"
    text += f" mean of seven is {np.nanmean(thin):.2f}, still after the last of `best`."
    assert text in told and np.isfinite(thin).sum() == 7 and np.nanmin(thin) > ours.max() / 1e6
    # of a Go1
    assert np.isfinite(mine["g"].walks[:, 1]).sum() == 2
    text = f"With `best` two of five do by {mine['g'].end / 1e6:.2f} M, where their runs end."
    assert text in told
    both = [fresh[k]["g"] for k in ("exact", "exact walks")]
    cut = [exact_reached(job, "g", mine["g"].end).walks for job in both]
    end = [exact_reached(job, "g").walks for job in both]
    assert [np.isfinite(x).sum() for x in cut] == [2, 3]
    assert [np.isfinite(x).sum() for x in end] == [3, 2]
    assert all(np.nanmin(x) > mine["g"].end for x in end)  # so all five are undone
    text = "do on two of ten (128 robots) and three (KL 0.02). Later evaluations undo all five; by"
    assert f"{text} {whole / 1e6:.2f} M three and two walk." in told
    # the same seeds before
    before = less("ppo")[0].read(LESS / "results/ppo_tasks.csv.xz", "exact, cut off")
    assert before.keys() == {"walks-exact-256-kl2-g", "walks-exact-128-kl5-c"}
    before = {name[-1]: job for name, job in before.items()}
    assert {x: job[0]["job"] for x, job in before.items()} == {
        x: job[0]["job"] for x, job in fresh["exact walks"].items()
    }
    count = {x: np.isfinite(exact_reached(job, x).walks).sum() for x, job in before.items()}
    at = {x: f"{job[-1]['sim_steps'] / 1e6:.2f}" for x, job in before.items()}
    assert count == {"g": 5, "c": 2}
    text = (
        f"Five of ten Go1 and two of ten ANYmal-C walked where they were cut off, at {at['g']} and"
    )
    assert f"{text} {at['c']} M, the Go1 more than now." in told
    for x, job in before.items():  # no evaluation is the same
        pair = [
            {(r["seed"], r["iteration"]): (r["return"], r["kl"]) for r in rows}
            for rows in (job, fresh["exact walks"][x])
        ]
        assert pair[0].keys() <= pair[1].keys()
        assert not [k for k, value in pair[0].items() if value == pair[1][k]]
    # chosen for the level
    count = [
        np.isfinite(exact_reached(fresh[k][x], x).walks).sum()
        for k, x in (("exact", "g"), ("exact 64", "c"), ("exact", "c"))
    ]
    text = f"walks by {whole / 1e6:.2f} M on three of ten Go1 (128 robots) and on five of ten ANYmal-C (of"
    assert count == [3, 5, 4] and f"{text} eleven: four)." in told
    other = words((EXPERIMENTS / "23_untuned/README.md").read_text())
    assert "tuned for the level there three Go1 and five ANYmal-C of ten, by 3.7 M." in other


def test_later_settings_of_the_exact_task_are_what_the_page_says():
    """Three settings more, by the same rule, as long, with a KL that is halved as late."""
    asked, base = paper.jobs(LESS / "ppo_exact_edges.txt"), paper.jobs(LESS / "ppo_exact.txt")
    changes = {
        "64-kl3": {"rollout.num_envs": 64},
        "64-kl5": {"rollout.num_envs": 64, "ppo.desired_kl": 0.05},
        "128-kl3-ep10": {"rollout.num_envs": 128, "ppo.epochs": 10},
    }
    assert changes.keys() == EXACT_EDGES.keys()
    assert asked.keys() == {f"exact-{n}-{x}" for n in changes for x in EXACT}
    for name, line in asked.items():
        one, other = config_of(line), config_of(base[f"exact-256-kl3-{name[-1]}"])
        steps = [schedule.sim_steps(x) for x in (one, other)]
        assert steps[0][-1] == steps[1][-1]
        late = [x[config.schedule.late_from] for x, config in zip(steps, (one, other), strict=True)]
        assert late[0] == pytest.approx(late[1], rel=0.01)
        pair = [flat(x) for x in (one, other)]
        differ = {key: pair[0][key] for key in pair[0] if pair[0][key] != pair[1][key]}
        scaled = {"run.num_iterations", "run.eval_every", "schedule.late_from"}
        assert {k: v for k, v in differ.items() if k not in scaled} == changes[name[6:-2]], name


def test_how_careful_the_page_says_that_each_was_tuned():
    """Runs and settings of PPO, of the longer tails, of `deploy`."""
    told, table = words(PAGE.read_text()), less("ppo")[0]
    runs = sum(len(table.seeds(job)) for job in grid().values())
    more = sum(len(table.seeds(job)) for job in more_anymals().values())
    text = f"PPO has these {runs} runs, of 17 settings, and {more} of three more;"
    assert text in told and (len(SETTINGS | EDGES), len(ANYMALS)) == (17, 3)
    others = [n for n in paper.jobs(LESS / "ppo_others.txt") if n.startswith("deploy")]
    count = {n: sum(f"-{n}-" in name for name in others) * 3 for n in (256, 512, 1024)}
    assert (count[256], count[512] + count[1024]) == (6, 12)
    assert "six of 256 robots ran once more, and twelve of 512 and 1024 robots longer" in told
    tails = {key: job for key, job in packed("fewer").items() if key[0] in ("fewer", "tails")}
    count = sum(map(len, tails.values()))
    settings = {name.split("-", 1)[1].removesuffix("-cut")[:-2] for _, name in tails}
    cut = sum(len(job) for (_, name), job in tails.items() if name.endswith("-cut"))
    assert len(settings) == 5 and f"found in {count} tuning runs of five settings" in told
    assert cut == 12 and "twelve of them cut off" in told
    shaped = sum(map(len, packed("tuning").values()))
    assert f"shaped in {shaped} runs" in told

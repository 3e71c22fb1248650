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
    told = words(text)
    assert f"{len(asked)} jobs of three seeds (0 to 2) to 9.2 M steps" in told
    every = {n: steps_between(j) for n, j in grid().items()}
    assert {f"{x / 1e6:.2f}" for n, x in every.items() if "512" not in n} == {"0.31"}
    assert {f"{x / 1e6:.2f}" for n, x in every.items() if "512" in n} == {"0.37"}
    assert "every 0.31 M steps (512 robots: 0.37 M)" in told
    cost = {n: choose.cost(job, "level", (30, 20)) for n, job in grid().items()}
    best = {x: sorted((n for n in cost if n[-1] == x), key=cost.get) for x in "ghcd"}
    assert (best["g"][0], best["h"][0]) == ("deploy-256-kl3-g", "deploy-256-kl3-gamma98-h")
    assert (
        "takes** 256 robots and a KL of 0.03 on a Go1, the same with gamma 0.98 on a Go2." in told
    )
    first, second = (reached_of(grid()[f"deploy-256-{k}-g"], 30).mean() for k in ("kl3", "kl2"))
    assert round((second - first) / 307200) == 1 and "a KL of 0.02 is one evaluation later" in told
    some = [f"deploy-{n}-h" for n in ("256-kl3-gamma98", "128-kl3", "256-kl3-mb8")]
    assert best["h"][:3] == some and cost[some[2]] - cost[some[0]] < 0.21e6
    assert all(np.isfinite(reached_of(grid()[n], 30)).sum() == 1 for n in some)
    for x in "cd":  # all tie
        assert not any(
            choose.arrive(grid()[f"deploy-{n}-{x}"], "level", (30, 20)) for n in SETTINGS
        )
        assert len({cost[f"deploy-{n}-{x}"] for n in SETTINGS}) == 1
        assert of_fresh(x)[0][0]["name"] == f"level-deploy-128-kl3-{x}"
    assert "took the first of its list then, 128 robots" in told
    lasts = [
        reached_of(job, 30 if n[-1] in "gh" else 20).max() / 1e6
        for n, job in grid().items()
        if np.isfinite(reached_of(job, 30 if n[-1] in "gh" else 20)).all()
    ]
    assert min(lasts) > 4 and len(lasts) == 2
    text = "two are there on all three, both on a Go1, the last seeds after {:.2f} and {:.2f} M."
    assert text.format(*sorted(lasts)) in told
    # the ANYmals
    anymals = {n: job for n, job in grid().items() if n[-1] in "cd"}
    ends = {n: [run[-1]["return"] for run in table.seeds(job)] for n, job in anymals.items()}
    each = np.concatenate(list(ends.values()))
    text = (
        f"Of {len(each)} runs {sum(each >= 15)} return 15 or more at the end, {sum(each < 10)} less"
    )
    assert text in told
    at = [table.between(of_fresh(x)[1], 9.2e6, "return").mean() for x in "cd"]
    assert "as good there as `deploy` ({:.1f} and {:.1f})".format(*at) in told
    text = "with gamma 0.98 ANYmal-C return {:.1f}, {:.1f} and {:.1f}, with 512 robots ANYmal-D {:.1f},"
    six = ends["deploy-256-kl3-gamma98-c"] + ends["deploy-512-kl3-d"]
    assert (text + " {:.1f} and {:.1f}.").format(*six) in told
    there = np.sort(reached_of(grid()["deploy-256-kl3-gamma98-c"], 15) / 1e6)
    mine = [reached_of(of_fresh(x)[1], 15).mean() / 1e6 for x in "cd"]
    text = f"at 15 after {there[0]:.1f} and {there[1]:.1f} M, `deploy` is after {mine[0]:.1f}."
    assert text in told and np.isnan(there[2])
    soonest = min(np.nanmin(reached_of(j, 15), initial=np.inf) for j in anymals.values()) / 1e6
    page = words((DEPLOY / "README.md").read_text())
    text = (
        f"soonest of {len(each)}, on tuning seeds, is at 15 after {soonest:.1f} M, `deploy` after"
    )
    assert f"{text} {mine[0]:.1f} and {mine[1]:.1f} in the mean." in page


def steps_between(job):
    """Of the first two evaluations."""
    run = less("ppo")[0].seeds(job)[0]
    return run[1]["sim_steps"] - run[0]["sim_steps"]


def test_that_a_robot_of_which_none_gets_there_gets_no_setting(tmp_path, monkeypatch, capsys):
    """All tie there; of the others' jobs the fresh ones were made."""
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
    assert all(found[of_fresh(x)[0][0]["name"]] == of_fresh(x)[0][0]["job"] for x in "gh")


def test_a_choice_from_two_places_and_two_lists_is_one_of_all_their_runs(
    tmp_path, monkeypatch, capsys
):
    """As part b of next.txt asks: FOLDER has the later runs and `--also` the earlier ones; of a name that
    both have FOLDER's count. Of equal ones that with the highest last return is taken, and twice as long."""
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
    assert asked.keys() == {f"deploy-{n}-{x}" for n in changes for x in "ghcd"}
    assert (
        f"({len(asked)} jobs" not in told and f"`ppo_deploy_edges.txt`, {len(asked)} jobs" in told
    )
    for name, line in asked.items():
        one, other = config_of(line), config_of(base[f"deploy-256-kl3-{name[-1]}"])
        assert schedule.sim_steps(one)[-1] == schedule.sim_steps(other)[-1]
        pair = [flat(x) for x in (one, other)]
        differ = {key: pair[0][key] for key in pair[0] if pair[0][key] != pair[1][key]}
        scaled = {"run.num_iterations", "run.eval_every", "schedule.late_from"}
        assert {k: v for k, v in differ.items() if k not in scaled} == changes[name[7:-2]], name


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
        labels = ppo.get(x, "PPO, 128 robots, not chosen"), "`deploy`", "longer tails"
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
    text = f"**To a return of 30 PPO needs {mean:.2f} M steps on a Go1: {ratios[0].value:.1f} times those of"
    assert f"{text} `deploy` (95 %: {ratios[0].low:.1f} to {ratios[0].high:.1f}) and" in told
    longer = (
        "{:.1f} times those of longer tails ({:.1f} to {:.1f}). It has the best of eleven settings"
    )
    assert longer.format(*ratios[1]) in told
    its, mine, tails = (reached_of(job, 30) / 1e6 for job in of_fresh("h"))
    assert np.isfinite(its).sum() == 4 and "On a Go2 four of its ten are there by 9.2 M" in told
    text = "all five of `deploy` are by {:.2f}, all five with longer tails by {:.2f}."
    assert text.format(mine.max(), tails.max()) in told
    twenty = [reached_of(of_fresh(x)[0], 20) for x in "cd"]
    twenty += [reached_of(job, 20) for name, job in grid().items() if name[-1] in "cd"]
    assert np.isnan(np.concatenate(twenty)).all() and sum(map(len, twenty)) == 66 + 20
    deploys, tails = (
        np.concatenate([reached_of(of_fresh(x)[k], 20) for x in "cd"]) / 1e6 for k in (1, 2)
    )
    text = (
        "no seed of PPO is at 20 by 9.2 M, and none of `deploy`; all ten with longer tails are, by"
    )
    assert f"{text} {tails.max():.1f}." in told and len(tails) == 10 and deploys.min() > 9.2
    assert [np.isfinite(reached_of(of_fresh(x)[0], 15)).sum() for x in "cd"] == [1, 1]
    assert "one of ten each is at 15 by 9.2 M" in told
    tuning = reached_of(grid()["deploy-256-kl3-g"], 30).mean() / 1e6
    assert f"On tuning seeds this PPO of a Go1 had needed {tuning:.2f} M." in told
    # at equal steps
    more = {
        (x, at): [stats.difference(table.between(job, at * 1e6, "return"), its) for job in ours]
        for x in "gh"
        for at in (1.8, 9.2)
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
    value, low, high = more["g", 9.2][0]
    assert f"on a Go1 ({value:.1f} more; {-low:.1f} less to {high:.1f} more)" in told and low < 0
    assert "Longer tails return {:.1f} more ({:.1f} to {:.1f}).".format(*more["g", 9.2][1]) in told
    text = "On a Go2 `deploy` returns {:.1f} ({:.1f} to {:.1f}) and longer tails {:.1f} more ({:.1f} to"
    text += " {:.1f})"
    assert text.format(*more["h", 9.2][0], *more["h", 9.2][1]) in told
    still = [run[-1]["fall_rate"] > 0.01 for run in table.seeds(of_fresh("h")[0])]
    assert sum(still) == 3 and "three of ten seeds of PPO still fall" in told
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
    text = (
        f"{one.value:.1f} times the steps on a Go1 ({one.low:.1f} to {one.high:.1f}; ten and five"
    )
    assert text in page
    text = f"a Go1 is at 30 after {mine.mean():.1f} M steps, with a PPO tuned on this task after"
    text += f" {its.mean():.1f} ({one.value:.1f} times as many, {one.low:.1f} to {one.high:.1f};"
    assert text in results
    text = f"needs {other.value:.1f} times their steps to 30 on a Go1 ({other.low:.1f} to {other.high:.1f})"
    assert text in results and text in page
    text = f"{other.value:.1f} times the steps of 1024 robots with long tails to 30 ({other.low:.1f} to"
    assert f"{text} {other.high:.1f})" in steps
    text = f"needs {one.value:.1f} times the steps of `deploy` to a return of 30 on a Go1 ({one.low:.1f} to"
    text += f" {one.high:.1f}; ten and five fresh seeds), and {other.value:.1f} times those of longer tails"
    assert f"{text} ({other.low:.1f} to {other.high:.1f})" in verdict
    its, mine, _ = (reached_of(job, 30) / 1e6 for job in of_fresh("h"))
    text = "On a Go2 four of its ten seeds are there by 9.2 M, the soonest after"
    text += f" {np.nanmin(its):.2f}, all five of `deploy` by {mine.max():.2f}."
    assert text in page and np.isfinite(its).sum() == 4
    at = {
        m: [table.between(job, m * 1e6, "return") for job in of_fresh("g")[:2]] for m in (1.8, 9.2)
    }
    assert f"a Go1 returns {at[1.8][1].mean():.1f}, with PPO {at[1.8][0].mean():.1f}." in page
    value, low, high = stats.difference(at[9.2][1], at[9.2][0])
    text = f"returns {at[9.2][1].mean():.1f}, with PPO {at[9.2][0].mean():.1f}"
    assert f"{text} ({value:.1f} more; {-low:.1f} less to {high:.1f} more)" in page
    assert f"the Go1 {text} ({value:.1f} more; {-low:.1f} less to {high:.1f} more);" in results
    there = [np.isfinite(reached_of(of_fresh(x)[0], 35)).sum() for x in "gh"]
    last = max(reached_of(of_fresh(x)[2], 35).max() for x in "gh") / 1e6
    assert there == [2, 0]
    text = f"At 35 are two of its ten Go1 and no Go2 by 9.2 M, with these tails all by {last:.2f}."
    assert text in steps


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
    text = f"An ANYmal-C takes {twenty.mean():.1f} M steps to 20"
    assert f"{text} (five seeds, the soonest {twenty.min():.1f})." in page
    text = f"the ANYmal-C takes {twenty.mean():.1f} M steps to 20, and with a PPO of few robots, not tuned on"
    assert f"{text} this task, three of nine take 14 to 19." in results
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
    assert (
        f"of these PPO needs fewest with 256 robots, {words_of} ({{:.1f}} to {{:.1f}})".format(
            *more[0], *more[1]
        )
        in told
    )
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


def test_the_grid_of_the_exact_task_is_that_of_its_runs_so_far():
    """18 of 22 jobs; the other four were cut off."""
    table, jobs = less("ppo")
    asked, ran = paper.jobs(LESS / "ppo_exact.txt"), table.read(LESS / "results/ppo.csv.xz", "10")
    assert asked.keys() == {f"exact-{n}-{x}" for n in SETTINGS for x in "gc"}
    assert asked.keys() - ran.keys() == {f"exact-{n}-kl3-{x}" for n in (256, 512) for x in "gc"}
    text = part("What comes next: a grid", "###")
    shown = [cells(line) for line in text.splitlines() if line.startswith("| ")][1:]
    rows, level = [], {"g": 38, "c": 24}
    for name, label in SETTINGS.items():
        row = [label]
        for x, least in level.items():
            if (job := ran.get(f"exact-{name}-{x}")) is None:
                row.append("cut off")
                continue
            assert job[0]["job"] == asked[f"exact-{name}-{x}"]
            assert job[-1]["sim_steps"] == 3686400 and len(table.seeds(job)) == 3
            found = table.reached(table.seeds(job), least)
            end = np.mean([run[-1]["return"] for run in table.seeds(job)])
            row.append(f"{table.steps_of(found.level)}; {table.steps_of(found.walks)}; {end:.1f}")
        rows.append(row)
    assert shown == rows
    told = words(text)
    assert f"{len(ran)} have run" in told and f"{len(asked)} jobs to 3.7 M" in told
    mine = {x: reached_of(jobs[f"exact-256-{x}"], level[x]).mean() for x in "gc"}
    text = "sooner than the {:.2f} and {:.2f} M above".format(*(x / 1e6 for x in mine.values()))
    assert text in told
    sooner = {n[6:] for n, job in ran.items() if reached_of(job, level[n[-1]]).mean() < mine[n[-1]]}
    assert {n for n in sooner if n[-1] == "g"} == {"128-kl5-g", "256-kl5-g", "128-kl3-g"}
    assert "on a Go1 128 and 256 robots with a KL of 0.05, 128 with 0.03" in told
    every = {round(steps_between(job) / 1e6, 2) for job in ran.values()}
    assert every == {0.25} and "an evaluation every 0.25 M" in told


def test_how_careful_the_page_says_that_each_was_tuned():
    """Runs and settings of PPO, of the longer tails, of `deploy`."""
    told, table = words(PAGE.read_text()), less("ppo")[0]
    runs = sum(len(table.seeds(job)) for job in grid().values())
    assert f"PPO has these {runs} runs, of eleven settings" in told and len(SETTINGS) == 11
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

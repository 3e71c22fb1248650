"""21_less and what many pages have of it: the headline, falls, PPO tuned."""

import csv
import itertools
import json
import lzma
import re
import sys

import numpy as np
import pytest
from result_files import EXPERIMENTS, LESS, LETTERS, ROOT, cells, less, script

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats


@pytest.mark.parametrize(
    "path",
    [
        "21_less/ppo_grid.txt",
        "21_less/ppo_edges.txt",
        "21_less/ppo_others.txt",
        "23_untuned/ppo.txt",
    ],
)
def test_jobs_that_tune_ppo_are_valid_plain_ppo_of_their_names(path, monkeypatch):
    """No model writes a row; robots and KL are those of the name; seeds are not the fresh ones."""
    monkeypatch.chdir((EXPERIMENTS / path).parent)
    names = set()
    for line in (EXPERIMENTS / path).read_text().splitlines():
        name, job, *fields = line.split()
        robot, _, variant = job.partition(":")
        config = config_lib.load(f"configs/{robot}.py:{variant}")
        for field in fields:
            config_lib.override(config, *field.split("=", 1))
        config = config_lib.validate(config)
        assert not schedule.uses_model(config) and config.run.seed == 0
        assert f"-{config.rollout.num_envs}-" in f"{name}-" and name not in names
        if "-kl" in name:
            assert f"kl{round(100 * config.ppo.desired_kl)}" in name
        assert len(schedule.sim_steps(config)) % config.run.eval_every == 0
        names.add(name)
    assert len(names) >= 8


def test_the_table_of_ppos_grid_is_that_of_its_runs():
    """Every setting of ppo_grid.txt is a cell of each robot; the best of each ran on fresh seeds."""
    choose, (table, _) = script("21_less/choose"), less("ppo")
    jobs = table.read(LESS / "results/ppo.csv.xz", "5")
    part = (LESS / "ppo.md").read_text().split("## The grid\n")[1].split("\n### ")[0]
    rows = [cells(line) for line in part.splitlines() if line.startswith("| ")]
    assert rows[0] == ["PPO", *LETTERS]
    names = (
        "64-kl3 128-kl2 128-kl3 128-kl3-gamma98 128-kl4 128-kl5 256-kl3 256-kl3-gamma98 256-kl3-lam95 "
        "256-kl3-ep10 256-kl3-mb8 256-kl4 512-kl3 512-kl5"
    ).split()
    asked = {line.split()[0] for line in (LESS / "ppo_grid.txt").read_text().splitlines()}
    assert {f"grid-{name}-{x}" for name in names for x in "ghcd"} == asked == jobs.keys()
    best = {x: min(names, key=lambda n, x=x: choose.cost(jobs[f"grid-{n}-{x}"])) for x in "ghcd"}
    level = {}
    for name, row in zip(names, rows[1:], strict=True):
        robots, kl = name.split("-")[:2]
        assert row[0].startswith("the same") or row[0] == f"{robots} robots, KL 0.0{kl[2:]}"
        for letter, cell in zip("ghcd", row[1:], strict=True):
            job = jobs[f"grid-{name}-{letter}"]
            found = table.reached(table.seeds(job), table.walks.level(table.best(job)))
            steps = f"{choose.cost(job) / 1e6:.2f}"
            assert cell == f"{steps}; {table.steps_of(found.level)}", (name, letter)
            bold = f"**{steps}**; {table.steps_of(found.level)}"
            assert (bold in part) == (best[letter] == name)
            level.setdefault(letter, {})[name] = choose.cost(job, "level") / 1e6
    _, head = less("headline")
    for letter, name in best.items():  # what ran on fresh seeds is what was chosen
        same = {
            "rollout.num_envs",
            "ppo.gamma",
            "ppo.lambda_",
            "ppo.desired_kl",
            "schedule.late_from",
        }
        fields = [
            {f for f in job[0]["job"].split() if f.split("=")[0] in same}
            for job in (jobs[f"grid-{name}-{letter}"], head[chosen_to_walk(letter)])
        ]
        assert fields[0] == fields[1] and len(fields[0]) == 5
        soon = min(level[letter], key=level[letter].__getitem__)
        fields = [
            {f for f in job[0]["job"].split() if f.split("=")[0] in same}
            for job in (jobs[f"grid-{soon}-{letter}"], head[f"ppo-level-{letter}"])
        ]
        assert fields[0] == fields[1]
    words = " ".join(part.split())
    soonest = [min(some.values()) for some in level.values()]
    text = "need {:.2f} (128 robots, KL 0.04), {:.2f} (KL 0.03), {:.2f} and {:.2f} (KL 0.05)"
    assert text.format(*soonest) in words
    fresh = [ours_of(f"ppo-level-{x}") for x in "ghcd"]
    text = "need {:.2f}, {:.2f}, {:.2f} and {:.2f} M"
    means = [x.level.mean() / 1e6 for x in fresh]
    assert f"seeds (1300 to 1309) {text.format(*means)}. So" in words
    assert text.replace("need", "needs").format(*means) in " ".join(
        (LESS / "README.md").read_text().split()
    )
    gained = [
        stats.difference(ours_of(f"ppo-{x}").level / 1e6, one.level / 1e6)
        for x, one in zip("ghcd", fresh, strict=True)
    ]
    assert "on a Go1 the grid gained {:.2f} M ({:.2f} to {:.2f})".format(*gained[0]) in words
    assert all(one.low < 0 for one in gained[1:])
    text = "after {:.2f} (one never), {:.2f}, {:.2f} (one never) and {:.2f} M (five never)"
    assert text.format(*(np.nanmean(x.walks) / 1e6 for x in fresh)) in words
    assert [int(np.isnan(x.walks).sum()) for x in fresh] == [1, 0, 1, 5]
    sooner = stats.difference(ours_of("ppo-walk-grid-h").walks / 1e6, fresh[1].walks / 1e6)
    assert "by {:.2f} M ({:.2f} to {:.2f}, uncorrected)".format(*sooner) in words
    ours = [ours_of(chosen_to_walk(x)) for x in "ghcd"]
    text = "after {:.2f} M (one of ten never), {:.2f}, {:.2f} (two never) and {:.2f} (one never)"
    assert text.format(*(np.nanmean(x.walks) / 1e6 for x in ours)) in words
    assert [int(np.isnan(x.walks).sum()) for x in ours] == [1, 0, 2, 1]
    text = "{:.2f}, {:.2f}, {:.2f} and {:.2f}"
    first = [
        text.format(*(ours_of(name).level.mean() / 1e6 for name in names))
        for names in (map(chosen_to_walk, "ghcd"), [f"ppo-{x}" for x in "ghcd"])
    ]
    assert f"{first[0]} M, of the older PPO {first[1]}" in words
    with lzma.open(LESS / "results/ppo.csv.xz", "rt", newline="") as file:
        runs = {
            (r["batch"], r["name"], r["seed"])
            for r in csv.DictReader(file)
            if r["name"][0] not in "qw"
        }
    counts = [sum(batch in some for batch, *_ in runs) for some in ("123", "4", "5", "8")]
    front, page, fewer = (
        " ".join((LESS / f"{x}.md").read_text().split()) for x in ("README", "ppo", "falls")
    )
    text = (
        "PPO was chosen in {}: 21 settings in {} on two robots, 12 in {} on two, 14 in {} on four, "
        "[on each of which it was chosen by itself](#the-grid), and {} in {} [beyond the edges]"
    )
    beyond = {tuple(sorted(fields.items())) for _, fields in fields_of("ppo_edges.txt").values()}
    settings = 21 + 12 + 14 + len(beyond)
    assert text.format(sum(counts), *counts[:3], len(beyond), counts[3]) in page
    assert f"{settings} settings in {sum(counts)} runs, not " in front
    lead = " ".join((LESS / "ppo.md").read_text().split("\n    python ")[0].split())
    now = [ours_of(f"ppo-walk-{x}") for x in "ghcd"]
    numbers = [f"{x:.2f}" for x in (*means, *(np.nanmean(x.walks) / 1e6 for x in now))]
    told = "**{} settings were tried, in {} runs. On ten fresh seeds the best need {}, {}, {} and {} M steps"
    told += " to the level (Go1, Go2, ANYmal-C, -D), and {}, {}, {} and {} to a walk**"
    assert told.format(settings, sum(counts), *numbers) in lead
    assert {len(x.walks) for x in (*ours, *now)} == {10}
    assert [int(np.isnan(x.walks).sum()) for x in now] == [0, 2, 2, 1]
    assert "none, two, two and one of ten never do." in lead
    tuned = {name: chosen_in(name) for name in ("tuning", "falls")}
    text = "`best` was chosen in {} runs on four robots: {} settings in {} (`tuning.csv.xz`;"
    total = [sum(many) for many in zip(*tuned.values(), strict=True)]
    assert text.format(total[1], *tuned["tuning"]) in page
    assert "then {} in {} [for fewer falls]".format(*tuned["falls"]) in page
    assert "{} settings in {} runs, after `task.carry_on`".format(*tuned["falls"]) in fewer
    assert "not {} in {};".format(*total) in front


def chosen_to_walk(letter):
    """The job on fresh seeds of the setting that won the walk in the grid; of Go1 and Go2 one beyond it won
    later."""
    return f"ppo-walk-{'grid-' * (letter in 'gh')}{letter}"


def chosen_in(name):
    """Settings of `best` in a packed file, and their runs: PPO's, and what was asked of a finished `best`, do
    not count."""
    with lzma.open(LESS / f"results/{name}.csv.xz", "rt", newline="") as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if row["batch"].isdigit() and "ppo24" not in row["name"]
        ]
    settings = {
        frozenset(x for x in row["job"].split()[1:] if not x.startswith("run.")) for row in rows
    }
    if name == "falls":  # under one name one setting
        settings = {row["name"].rpartition("-")[0] for row in rows}
    return len(settings), len({(row["batch"], row["name"], row["seed"]) for row in rows})


def fields_of(path):
    """`name -> (robot, fields without those of run)` of a file of jobs."""
    found = {}
    for name, line in paper.jobs(LESS / path).items():
        robot, *fields = line.split()
        fields = dict(field.split("=", 1) for field in fields)
        found[name] = robot, {k: v for k, v in fields.items() if not k.startswith("run.")}
    return found


def test_jobs_of_208_robots_are_the_control_on_seeds_that_nothing_ran_on():
    """Of its settings; evaluated about as often as the headline's PPO, on as many episodes."""
    control, later = fields_of("updates.txt"), fields_of("ppo_208.txt")
    assert {name.replace("ppo-208-", "updates-208-5-"): one for name, one in later.items()} == {
        name: one for name, one in control.items() if "-208-5-" in name
    }
    asked, head = (paper.jobs(LESS / x) for x in ("ppo_208.txt", "headline.txt"))
    for name, line in asked.items():
        fields = dict(field.split("=", 1) for field in line.split()[1:])
        walk = dict(field.split("=", 1) for field in head[f"ppo-walk-{name[-1]}"].split()[1:])
        for key in ("run.num_seeds", "run.eval_envs"):
            assert fields[key] == walk[key]
        every = [
            int(x["rollout.num_envs"]) * int(x["rollout.horizon"]) * int(x["run.eval_every"])
            for x in (fields, walk)
        ]
        assert abs(every[0] / every[1] - 1) < 0.02 and fields["run.seed"] == "1500"
    used = [
        line for name in ("headline.txt", "fresh.txt") for line in paper.jobs(LESS / name).values()
    ]
    assert not any("run.seed=1500" in line for line in used)
    text = " ".join((LESS / "ppo.md").read_text().split())
    assert "**The rule, set on 2026-11-29**: it runs on ten fresh seeds of each robot (1500" in text


def won_in_the_grid(head, goal, letter):
    """The setting of `ppo_grid.txt` that won, as it ran on fresh seeds: robot and fields."""
    return head[chosen_to_walk(letter) if goal == "walk" else f"ppo-level-{letter}"]


def test_jobs_beyond_the_edges_change_one_thing_of_a_winner():
    """Of each robot's setting of the grid for the level or to walk; and they run as the grid's do."""
    edges, grid, head = map(fields_of, ("ppo_edges.txt", "ppo_grid.txt", "headline.txt"))
    ran = [*grid.values()]
    values = [tuple(sorted(fields.items())) for _, fields in edges.values()]
    assert len(edges) == len({*zip((x for x, _ in edges.values()), values, strict=True)}) == 32
    changed = {}
    for name, (robot, fields) in edges.items():
        assert (robot, fields) not in ran, name
        goal = "walk" if name.startswith("edge-walk-") else "level"
        was, winner = won_in_the_grid(head, goal, name[-1])
        assert was == robot and winner.keys() == fields.keys()
        other = {k: v for k, v in fields.items() if winner[k] != v}
        if name.startswith("edge-128-kl4-gamma98-"):  # of a Go1 its KL is that of the winner
            assert {k: v for k, v in other.items() if k != "ppo.desired_kl"} == {
                "ppo.gamma": "0.98"
            }
            assert fields["ppo.desired_kl"] == "0.04"
            continue
        ((key, value),) = other.items()
        changed.setdefault((goal, name[-1], key), set()).add(value)
    for letter in "ghcd":
        assert changed.pop(("level", letter, "ppo.gamma")) == {"0.95", "0.96"}
        for goal in ("level", "walk"):
            assert changed.pop((goal, letter, "ppo.lambda_")) == {"0.8", "0.85"}
    assert changed.pop(("level", "d", "ppo.desired_kl")) == {"0.06", "0.07"}
    assert changed == {("walk", x, "ppo.gamma"): {"0.99"} for x in "gc"}
    # runs are as long and as often evaluated as those of the grid, on its seeds
    mine, theirs = (paper.jobs(LESS / x) for x in ("ppo_edges.txt", "ppo_grid.txt"))

    def runs(jobs):
        found = {}
        for line in jobs.values():
            fields = dict(field.split("=", 1) for field in line.split()[1:])
            late = fields["schedule.late_from"]
            rest = {k: v for k, v in fields.items() if k.startswith("run.")}
            found.setdefault(fields["rollout.num_envs"], set()).add((late, *sorted(rest.items())))
        return found

    assert runs(mine).items() <= runs(theirs).items()


CHANGES = {  # rows of the table beyond the edges -> what is otherwise than in the winner
    "with gamma 0.95": {"ppo.gamma": "0.95"},
    "with gamma 0.96": {"ppo.gamma": "0.96"},
    "with gamma 0.98 and KL 0.04": {"ppo.gamma": "0.98", "ppo.desired_kl": "0.04"},
    "with gamma 0.99": {"ppo.gamma": "0.99"},
    "with lambda 0.8": {"ppo.lambda_": "0.8"},
    "with lambda 0.85": {"ppo.lambda_": "0.85"},
    "with KL 0.06": {"ppo.desired_kl": "0.06"},
    "with KL 0.07": {"ppo.desired_kl": "0.07"},
}


def test_what_ran_beyond_the_edges_of_the_grid_is_as_its_page_says(tmp_path, monkeypatch, capsys):
    """The table, the settings that won by `choose.py`, and how these did on fresh seeds."""
    choose, (table, jobs), (_, head) = script("21_less/choose"), less("ppo"), less("headline")
    text = (LESS / "ppo.md").read_text().split("### Beyond the edges")[1].split("### Other")[0]
    edges, grid, headline = map(fields_of, ("ppo_edges.txt", "ppo_grid.txt", "headline.txt"))
    rows = [cells(line) for line in text.splitlines() if line.startswith("| ")][1:]
    goal, seen = "", []
    # the page's bold cells are the winners to walk of both files
    for label, *line in rows:
        if label.startswith("the winner of the "):
            goal = label.rpartition(" ")[2]
        line += [""] * (4 - len(line))  # `cells` leaves empty ones at the end out
        for letter, cell in zip("ghcd", line, strict=True):
            robot, fields = won_in_the_grid(headline, goal, letter)
            wanted = robot, fields | CHANGES.get(label, {})
            prefix = "edge-walk-" if goal == "walk" else "edge-1"
            known = grid if label not in CHANGES else edges
            names = [
                name
                for name, one in known.items()
                if one == wanted and (known is grid or name.startswith(prefix))
            ]
            assert len(names) == bool(cell), (label, letter)
            if names:
                seen += names
                job = jobs[names[0]]
                found = table.reached(table.seeds(job), table.walks.level(table.best(job)))
                walks, first = f"{choose.cost(job) / 1e6:.2f}", table.steps_of(found.level)
                assert cell == f"{walks}; {first}", names
                if goal == "walk" or label in CHANGES:  # a winner of the level may be bold below
                    same = known[names[0]] == headline[f"ppo-walk-{letter}"]
                    assert (f"**{walks}**; {first}" in text) == same, names
    assert {*edges} == {name for name in seen if name.startswith("edge-")}
    # the rule, by the shipped script, on the packed runs
    for flags, name, winners in (
        (["--level", "--seed", "1500"], "ppo-level", ""),
        (["--seed", "1400"], "ppo-walk", "gh"),
    ):
        fresh = tmp_path / f"{name}.txt"
        words = [str(LESS / "results/ppo.csv.xz"), str(LESS / "ppo_grid.txt"), str(fresh)]
        words += ["--beyond", str(LESS / "ppo_edges.txt"), *flags]
        monkeypatch.setattr(sys, "argv", ["choose.py", *words])
        choose.main()
        capsys.readouterr()
        chosen = [line.split(" ", 1)[1] for line in fresh.read_text().splitlines()]
        asked = paper.jobs(LESS / "headline.txt")
        assert chosen == [asked[f"{name}-{letter}"] for letter in winners]
        for letter in winners:
            assert {row["job"] for row in head[f"{name}-{letter}"]} == {asked[f"{name}-{letter}"]}
    text = " ".join(text.split())
    now, before = ([ours_of(f"ppo-walk-{x}{y}") for y in "gh"] for x in ("", "grid-"))
    means = [[np.nanmean(one.walks) / 1e6 for one in some] for some in (now, before)]
    never = [[int(np.isnan(one.walks).sum()) for one in some] for some in (now, before)]
    assert never == [[0, 2], [1, 0]]
    assert "walk after {:.2f} and {:.2f} M; none and two of ten never do.".format(*means[0]) in text
    end = head["ppo-walk-g"][-1]["sim_steps"]
    later = [
        stats.difference(*(np.nan_to_num(one.walks, nan=end) / 1e6 for one in pair))
        for pair in zip(now, before, strict=True)
    ]
    assert "Those before needed {:.2f} (one never) and {:.2f}.".format(*means[1]) in text
    (one, two), most = (
        later,
        [[np.nan_to_num(x.walks, nan=end).mean() / 1e6 for x in some] for some in (now, before)],
    )
    told = (
        f"With a seed that never walks counted as {end / 1e6:.2f} M it is {most[0][0]:.2f} beside "
    )
    told += f"{most[1][0]:.2f} on Go1 ({-one.value:.2f} less; {-one.low:.2f} less to {one.high:.2f} more)"
    told += f" and {most[0][1]:.2f} beside {most[1][1]:.2f} on Go2 ({two.value:.2f} more; "
    told += f"{-two.low:.2f} less to "
    assert f"{told}{two.high:.2f} more): no difference is shown." in text
    pair = [ours_of(f"{name}-g").level / 1e6 for name in ("ppo-walk", "ppo-level")]
    told = "after {:.2f} M instead of {:.2f} of the one chosen for that"
    assert told.format(*(x.mean() for x in pair)) in text
    soon = stats.difference(*pair)
    told = f"{-soon.value:.2f} fewer ({-soon.low:.2f} fewer to {soon.high:.2f} more), so not shown"
    assert told in text
    most, least = (
        stats.ratio(ours_of(f"{name}-g").level, ours_of("best-g").level)
        for name in ("ppo-level", "ppo-walk")
    )
    told = "It needs {:.1f} times the steps of `best` ({:.1f} to {:.1f}), not {:.1f}"
    told = told.format(*least, most.value)
    assert told in text


def test_jobs_with_as_many_rows_and_updates_as_best_are_what_the_page_says():
    """PPO's setting for the level, in rollouts of 20 rows; an iteration has the updates of `best`."""
    jobs, head = fields_of("updates.txt"), fields_of("headline.txt")
    assert len(jobs) == 8
    for name, (job, fields) in jobs.items():
        robot, _, variant = job.partition(":")
        best, config = (config_lib.load(f"configs/{robot}.py:{variant}") for _ in range(2))
        for field in paper.jobs(LESS / "updates.txt")[name].split()[1:]:
            config_lib.override(config, *field.split("=", 1))
        config = config_lib.validate(config)
        assert not schedule.uses_model(config)
        assert (config.run.seed, config.run.num_seeds) == (100, 5)
        assert len(schedule.sim_steps(config)) % config.run.eval_every == 0
        rows = config.rollout.num_envs * config.rollout.horizon
        real = best.rollout.num_envs * (best.rollout.horizon - best.schedule.end_steps)
        assert real == 4096 and abs(rows / real - 1) < 0.02
        epochs = int(name.split("-")[2])
        assert config.ppo.epochs == epochs and config.ppo.minibatches == best.ppo.minibatches
        assert (epochs == best.schedule.rounds * best.ppo.epochs) == (epochs == 15)
        assert 1.4e6 < config.schedule.late_from * rows < 1.6e6
        _, level = head[f"ppo-level-{name[-1]}"]
        for key in ("ppo.gamma", "ppo.lambda_", "ppo.desired_kl", "schedule.end_steps"):
            assert fields[key] == level[key], (name, key)
        assert fields.keys() - level.keys() == {"ppo.epochs"}
    page = " ".join((LESS / "model.md").read_text().split())
    claims = script("19_collapse/table")
    short = claims.read(EXPERIMENTS / "19_collapse/results/gpu.csv.xz")
    returns = {
        f"{rows}-{x}": np.mean(claims.values(short, f"rows{rows}-{x}", 500))
        for rows in (8, 12, 16)
        for x in "gc"
    }
    assert all(
        (value < 0.65 * returns[f"16-{name[-1]}"]) == (name[:2] != "16")
        for name, value in returns.items()
    )
    assert "as 8 and 12 of 1024 robots are with the paper's PPO ([19_collapse]" in page
    table, _ = less("ppo")
    grid, found = table.read(LESS / "results/ppo.csv.xz", "5"), {}
    for epochs in ("-ep10", ""):
        jobs = [grid[f"grid-256-kl3{epochs}-{x}"] for x in "ghcd"]
        found[epochs] = [
            table.reached(table.seeds(job), table.walks.level(table.best(job))).level / 1e6
            for job in jobs
        ]
    p = [stats.welch_of(*pair) for pair in zip(*found.values(), strict=True)]
    assert f"nor with 256 and 24 rows, 10 beside 5 (three seeds, p {min(p):.2f} at least;" in page


def test_what_the_paper_is_told_of_branching_is_what_best_does():
    """Tails from real rows drawn at random and from the last states. The paper is told of 2026-11-26."""
    table, found = script("21_less/table"), {}
    jobs = table.read(LESS / "results/ablation.csv.xz", "2")
    for name in ("whole", "last"):
        some = [table.seeds(jobs[f"control-{name}-{x}"]) for x in "ghcd"]
        assert {len(seeds) for seeds in some} == {5}
        found[name] = [
            table.reached(seeds, 38 if x in "gh" else 24).level
            for x, seeds in zip("ghcd", some, strict=True)
        ]
    pairs = [*zip(*found.values(), strict=True)]
    text = "({:.2f} and {:.2f}, {:.2f} and {:.2f}, {:.2f} and {:.2f}, {:.2f} and {:.2f} M steps to the level"
    text = text.format(*(x.mean() / 1e6 for pair in pairs for x in pair))
    p = min(stats.rank_sum(*pair) for pair in pairs)
    text += f" on Go1, Go2, ANYmal-C, -D; five seeds, rank tests p {p:.2f} at least;"
    assert text in (EXPERIMENTS / "paper/README.md").read_text()
    page = " ".join((LESS / "model.md").read_text().split())
    worst = found["last"][2].max() / 1e6
    told = f"(to the level p {p:.2f} at least; one ANYmal-C is there after {worst:.2f} M)"
    assert told in page
    walk = pairs_of(*(controls_of("2", f"control-{name}") for name in ("last", "whole")), "walks")
    assert min(ranks_of(walk)[0]) > 0.05 and "In the `best` of 2026-11-26 neither was so" in page
    # today
    best, last = headline_of("best", table.LAST), controls_of("4", "control-last")
    level, walk = (pairs_of(last, best, what) for what in ("level", "walks"))
    least = min(ranks_of(level)[0])
    told = f"makes no difference to the level that is shown (rank tests, p {least:.2f} at least)"
    assert told in page
    steps = ", ".join("{1:.2f} and {0:.2f}".format(*(x.mean() / 1e6 for x in one)) for one in level)
    told = f"in today's `best` {steps}, p {least:.2f} at least, but a Go2 walks sooner from drawn rows, Holm "
    later = [x.mean() / 1e6 for x in walk[1]]
    holm = ranks_of(walk)[1][1]
    assert f"{told}{holm:.3f};" in (EXPERIMENTS / "paper/README.md").read_text()
    told = (
        f"(p {least:.2f} at least); a Go2 walks sooner from drawn rows ({later[1]:.2f} instead of "
    )
    assert f"{told}{later[0]:.2f} M, Holm {holm:.3f};" in (EXPERIMENTS / "README.md").read_text()
    p, holm = ranks_of(walk)
    assert [x < 0.05 for x in holm] == [False, True, False, False]
    assert f"a Go2 walks later (by Holm {holm[1]:.3f})" in page
    after = [table.phase(jobs[1])[:, 2] for jobs in (last, best)]
    told = (
        "ten iterations after its last tail it falls in {:.2f} instead of {:.2f} % of the episodes"
    )
    told = told.format(*(x.mean() for x in after)) + f" (p {stats.rank_sum(*after):.3f}"
    assert f"{told}; looked at afterwards)" in page
    told = f"That an ANYmal-D walks sooner is not shown (p {p[3]:.3f}, by Holm {holm[3]:.2f})"
    assert told in page and np.mean(walk[3][0]) < np.mean(walk[3][1])


@pytest.mark.parametrize("name", ["run", "table"])
def test_a_script_without_its_file_is_one_line_and_makes_nothing(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    argv = [name, *["out"] * (name == "run"), "nofile.txt"]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit, match=r"^nofile.txt: there is no such file"):
        script(f"21_less/{name}").main()
    assert not list(tmp_path.iterdir())


def test_best_setting_is_the_one_that_walks_soonest_and_never_counts_twice(tmp_path, monkeypatch):
    """Setting `a` walks at 2 M and never (of 3 M): (2 + 6) / 2; `b` at 3 M twice. `c` is another robot's. The
    chosen settings have the fresh seeds, and a job that has not run is named."""
    choose = script("21_less/choose")
    good, bad = {"return": 40, "fall_rate": 0}, {"return": 40, "fall_rate": 0.5}
    fields = "run.seed=0 run.num_seeds=2 run.eval_every=20 run.eval_envs=200"
    jobs = {
        "a": f"go1:best {fields} ppo.gamma=0.9",
        "b": f"go1:best {fields}",
        "c": f"go2:best {fields}",
    }
    walked = {"a": (2, 4), "b": (3, 3), "c": (1, 1)}  # first M steps with few falls, of 3
    path, fresh = tmp_path / "jobs.txt", tmp_path / "fresh.txt"
    path.write_text("".join(f"{name} {job}\n" for name, job in jobs.items()))
    monkeypatch.setattr(sys, "argv", ["choose.py", *map(str, (tmp_path, path, fresh))])
    for name, firsts in walked.items():
        with pytest.raises(SystemExit, match=f"lacks .*{name}"):
            choose.main()
        rows = [
            {"job": jobs[name], "seed": seed, "iteration": m, "sim_steps": m * 1e6}
            | (good if m >= at else bad)
            for seed, at in enumerate(firsts)
            for m in (1, 2, 3)
        ]
        script("21_less/run").write(tmp_path / f"{name}.csv", rows)
    choose.main()
    lines = [line.split() for line in fresh.read_text().splitlines()]
    assert [line[:2] for line in lines] == [["walks-b", "go1:best"], ["walks-c", "go2:best"]]
    expected = {"run.seed=1200", "run.num_seeds=10", "run.eval_every=10", "run.eval_envs=1000"}
    assert all(set(line[2:]) == expected for line in lines)
    # of later settings, a best one alone
    path.write_text(f"a {jobs['a']}\nc {jobs['c']}\n")
    (later := tmp_path / "later.txt").write_text(f"b {jobs['b']}\n")
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--beyond", str(later)])
    choose.main()
    assert [line.split()[0] for line in fresh.read_text().splitlines()] == ["walks-b"]


RUNS = {
    "**`best`**": "best",
    "PPO": "ppo",
    "PPO, to the level": "ppo-level",
    "PPO, to walk": "ppo-walk",
    "PPO, to walk, before": "ppo-walk-grid",
}
LOW_FEET = {"**`best`**": "best", "PPO, same task": "ppo-task", "PPO, as before": "ppo"}
OLDER = {  # rows of the table of older runs -> names in fresh.csv.xz
    "`best` of then": "new",
    "PPO, tuned": "ppo-kl3",
    "PPO, 24 rows, 512 robots": "ppo-512x24",
    "PPO, 24 rows, 1024 robots": "ppo-1024x24",
    "PPO, 24 rows, 2048 robots": "ppo-2048x24",
    "PPO, 16 rows, 1024 robots": "ppo-1024x16",
    "PPO, 32 rows, 1024 robots": "ppo-1024x32",
    "PPO-16": "ppo16",
    "PPO-24": "ppo24",
}


def rows_of(page, names, columns):
    """Rows of tables with so many columns: `name in the results -> cells`, from what the page calls it."""
    names, found = {name.replace("**", ""): known for name, known in names.items()}, {}
    for line in page.splitlines():
        robot, _, what = cells(line)[0].partition(", ")
        if robot in LETTERS and what in names and len(cells(line)) == columns:
            assert found.setdefault(f"{names[what]}-{LETTERS[robot]}", cells(line)[1:])
    return found


def test_the_tables_of_the_headline_are_those_of_its_runs():
    """Steps until it walks and to levels, falls; at equal steps; ratios; while the model writes tails."""
    (table, jobs), page = less("headline"), (LESS / "tables.md").read_text()
    assert {len(table.seeds(job)) for job in jobs.values()} == {10}
    found = rows_of(page, RUNS, 11)
    assert found.keys() == jobs.keys() and len(jobs) == 18
    for name, mine in found.items():
        first, fell = steps_and_falls(table, name, jobs[name])
        assert mine == [*first[:2], fell[1], first[2], fell[4], *first[5:]], name
    front = (LESS / "README.md").read_text()
    steps, beside = rows_of(page, RUNS, 5), rows_of(front, RUNS, 8)
    millions = (0.6, 1, 2, table.seeds(jobs["ppo-g"])[0][-1]["sim_steps"] / 1e6)
    assert {
        row[0]: row[1:] for row in map(cells, table.at(jobs, millions).splitlines()[2:])
    } == steps
    lines = map(cells, table.beside(jobs).splitlines()[2:])
    assert {row[0]: row[1:] for row in lines} == beside and len(beside) == 12
    short = {
        name: [*full[:3], steps[name][-1]] for name, full in found.items() if "grid" not in name
    }
    assert rows_of(front, RUNS, 5) == short  # the page's own table is of these columns
    mine = {f"best-{letter}": jobs[f"best-{letter}"] for letter in LETTERS.values()}
    phases = [cells(line)[1:] for line in table.phases(mine).splitlines()[2:]]
    falls = (LESS / "falls.md").read_text()
    shown = [cells(line) for line in falls.splitlines() if cells(line)[0] in LETTERS]
    assert [row[1:] for row in shown if len(row) == 6] == phases


def steps_and_falls(table, name, job):
    """The cells of a job in the table of steps, from `walks` on, and in that of falls."""
    steps = table.table({name: job}, table.best(job)).splitlines()[2]
    return cells(steps)[2:], cells(table.falls({name: job}).splitlines()[2])[1:]


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


def test_what_the_page_says_of_feet_that_are_not_lifted_is_so():
    """The table, the factors of then, and what the weight costs, runs evaluated as seldom as then."""
    (table, old), page = less("low_feet"), (LESS / "task.md").read_text()
    found = rows_of(page, LOW_FEET, 6)
    assert found.keys() == old.keys() and len(old) == 12
    for name, mine in found.items():
        first, fell = steps_and_falls(table, name, old[name])
        assert mine == [*first[:2], fell[1], *first[-3:-1]], name
    page = " ".join(page.split())
    walk = {
        name: sum(np.isfinite(ours_of(f"{name}-{x}", "low_feet").walks).sum() for x in "cd")
        for name in LOW_FEET.values()
    }
    assert f"{walk['ppo-task']} of 20 seeds walk with it, {walk['ppo']} of 20 without" in page
    rows = {cells(line)[0]: cells(line)[1] for line in table.beside(old).splitlines()[2:]}
    then = [rows[f"ppo-{x}"].split()[0] for x in "ghcd"]
    assert "larger: {}, {}, {} and {}.".format(*then) in page
    _, new = less("headline")

    def steps(name):
        """Of the newer runs, at the evaluations that the older ones had, too."""
        runs = [
            [r for r in run if r["iteration"] <= 200 or r["iteration"] % 50 == 0]
            for run in table.seeds(new[name])
        ]
        return table.reached(runs, 38 if name[-1] in "gh" else 24)

    best, ppo = (
        [stats.ratio(steps(n).level, ours_of(n, "low_feet").level) for n in names]
        for names in ([f"{run}-{x}" for x in "ghcd"] for run in ("best", "ppo"))
    )
    cost = [f"{one.value:.2f} ({one.low:.2f} to {one.high:.2f})" for one in best]
    assert "{}, {}, {} and {} times those without".format(*cost) in page
    assert "{:.2f}, {:.2f}, {:.2f} and {:.2f} times".format(*(one.value for one in ppo)) in page
    walks = [steps(f"best-{x}").walks / 1e6 for x in "ghcd"]
    each = [f"{some.mean():.2f} ({some.max():.2f})" for some in walks]
    assert "as seldom as then {}, {}, {} and {} M".format(*each) in page
    older = (np.nan_to_num(ours_of(f"best-{x}", "low_feet").walks, nan=np.inf) for x in "ghcd")
    p = [stats.rank_sum(1e6 * a, b) for a, b in zip(walks, older, strict=True)]
    assert "p {:.2f}, {:.2f}, {:.1f} and {:.2f})".format(*p) in page
    lost = []
    for name in ("best-g", "best-h", "best-c", "best-d"):
        end = table.seeds(new["ppo-g"])[0][-1]["sim_steps"]
        some = stats.difference(*(table.between(jobs[name], end, "return") for jobs in (old, new)))
        interval = f" ({some.low:.1f} to {some.high:.1f})" if some.low > 0 else ""
        lost.append(f"{some.value:.1f}{interval}")
    assert "{}, {}, {} and {} lower".format(*lost) in page
    after = stats.difference(*(table.phase(jobs["best-d"])[:, 3] for jobs in (new, old)))
    assert f"{after.value:.2f} points ({after.low:.2f} to {after.high:.2f})" in page


def test_the_table_of_older_runs_is_that_of_its_runs():
    (table, jobs), page = less("fresh"), (LESS / "history.md").read_text()
    found = rows_of(page, OLDER, 6)
    assert len(found) == 24
    for name, mine in found.items():
        row = cells(table.table({name: jobs[name]}, table.best(jobs[name])).splitlines()[2])
        assert mine == [*row[2:4], *row[9:]], name


def test_the_tables_of_controls_are_those_of_their_runs(monkeypatch, capsys):
    """What writes a tail, today and before feet were lifted, ratios, and each part taken out: as printed."""
    page = (LESS / "model.md").read_text()
    monkeypatch.setattr(sys, "argv", ["table.py", str(LESS / "results/ablation.csv.xz"), "--model"])
    script("21_less/table").main()
    printed = capsys.readouterr().out.strip().split("\n\n")
    assert [len(table.splitlines()) - 2 for table in printed] == [8, 16, 4, 14]
    assert all(f"\n\n{table}\n\n" in page for table in printed)


def list_of(words):
    """`A, B, C and D`."""
    *before, last = words
    return f"{', '.join(before)} and {last}"


def ratios_told():
    """The table of ratios on model.md: `(what is beside what, "level" or "walks") -> cells`, with bold."""
    text = (LESS / "model.md").read_text().split("| times the steps, to the level |")[1]
    found, label = {}, ""
    for line in text.split("\n\n")[0].splitlines()[2:]:
        name, *some = (cell.strip() for cell in line.strip("| ").split("|"))
        label = label if name == "… to a walk" else name
        found[label, "walks" if name == "… to a walk" else "level"] = some
    return found


def p_of(one, other):
    """Of the rank test, by all ways to name as many of the seeds `one`; who never gets there is last."""
    steps = np.nan_to_num(np.concatenate([one, other]), nan=np.inf)
    ranks = np.array([(steps < x).sum() + ((steps == x).sum() - 1) / 2 for x in steps])
    ways = np.array([*itertools.combinations(ranks, len(one))]).mean(axis=1) - ranks.mean()
    return np.mean(np.abs(ways) >= abs(ranks[: len(one)].mean() - ranks.mean()) - 1e-9)


def told_of(pairs):
    """Cells of that table."""
    p, least, found = [p_of(*pair) for pair in pairs], 0.0, [""] * 4
    for k, place in enumerate(np.argsort(p)):  # Holm
        least = max(least, (4 - k) * p[place])
        pair = pairs[place]
        value, low, high = stats.ratio(*pair)
        mark = "*" * bool(np.isnan([*pair[0], *pair[1]]).any())
        cell = f"{value:.2f}{mark} ({low:.2f} to {high:.2f})"
        found[place] = f"**{cell}**" if least < 0.05 else cell
    return found


def test_how_many_times_the_steps_of_another_each_control_needs():
    """Ratios and marks of the table, and by a test of all regroupings which are bold."""
    controls = {
        "simulator": controls_of("3", "control-simulator"),
        "last": controls_of("4", "control-last"),
        "15": controls_of("4", "updates-208-15"),
        "5": controls_of("4", "updates-208-5"),
        "best": headline_of("best", script("21_less/table").LAST),
        "tuned": headline_of("ppo-level"),
    }
    beside = {
        "the simulator's tails beside the model's from the same states": ("simulator", "last"),
        "the same beside `best`": ("simulator", "best"),
        "the model's tails from the last states beside `best`": ("last", "best"),
        "208 robots, 15 epochs, beside `best`": ("15", "best"),
        "208 robots, 5 epochs, beside `best`": ("5", "best"),
        "15 epochs beside 5": ("15", "5"),
        "15 epochs beside PPO tuned for the level": ("15", "tuned"),
        "5 epochs beside PPO tuned for the level": ("5", "tuned"),
    }
    told = ratios_told()
    assert {label for label, _ in told} == {*beside} and len(told) == 2 * len(beside)
    for (label, what), mine in told.items():
        one, other = (controls[name] for name in beside[label])
        assert mine == told_of(pairs_of(one, other, what)), (label, what)


def controls_of(batch, name):
    """Jobs of a control or of updates.txt on the four robots."""
    jobs = script("21_less/table").read(LESS / "results/ablation.csv.xz", batch)
    return [jobs[f"{name}-{x}"] for x in LETTERS.values()]


def headline_of(name, last=np.inf):
    """Jobs of the headline on the four robots, up to an iteration."""
    _, jobs = less("headline")
    return [
        [row for row in jobs[f"{name}-{x}"] if row["iteration"] <= last] for x in LETTERS.values()
    ]


def pairs_of(ours, others, what):
    """Steps until each seed is first at the level, or `walks`, of both on each robot."""
    table = script("21_less/table")
    found = [
        [
            getattr(table.reached(table.seeds(job), table.walks.level(table.best(job))), what)
            for job in jobs
        ]
        for jobs in (ours, others)
    ]
    return [*zip(*found, strict=True)]


def ranks_of(pairs):
    """p of rank tests of pairs, and by Holm over them."""
    p = [stats.rank_sum(*pair) for pair in pairs]
    return p, stats.holm(p)


def ends_of(jobs, column):
    """Of each seed on each robot: the mean of its last three evaluations."""
    table = script("21_less/table")
    return [
        np.array([np.mean([row[column] for row in run[-3:]]) for run in table.seeds(job)])
        for job in jobs
    ]


def test_what_the_page_says_of_as_many_updates_is_so():
    """PPO alone with as many real rows, with 15 and 5 epochs, beside `best` and PPO tuned for the level."""
    page, table = " ".join((LESS / "model.md").read_text().split()), script("21_less/table")
    best, tuned = headline_of("best", table.LAST), headline_of("ppo-level")
    many, few = (controls_of("4", f"updates-208-{n}") for n in (15, 5))
    assert {len(table.seeds(job)) for job in many + few} == {5}
    assert {len(table.seeds(job)) for job in tuned} == {10}
    soonest = min(x.min() for x, _ in pairs_of(many, best, "level")) / 1e6
    assert (
        f"level after 0.8 M or later. That held: no seed is before {soonest:.2f}, so they" in page
    )
    assert soonest > 0.8
    assert {(row["device"], row["commit"]) for job in many + few for row in job} == {
        ("NVIDIA H200", "34c7be27a05b-dirty")
    }
    assert (
        "2026-11-29, commit 34c7be27 with `experiments/next.txt` and `folders.md` changed" in page
    )
    level, walk = (pairs_of(many, best, what) for what in ("level", "walks"))
    lead = [stats.ratio(*pair).value for pair in level]
    times, holm = f"{min(lead):.1f} to {max(lead):.1f} times", ranks_of(level)[1].max()
    verdict, front, other = (
        " ".join((EXPERIMENTS / x / "README.md").read_text().split())
        for x in ("", "21_less", "23_untuned")
    )
    assert "The number of updates does not explain what `best` saves: " in verdict
    assert f"needs {times} the steps of `best` to the level (five seeds, Holm {holm:.3f}" in verdict
    assert f"with them PPO needs {times} the steps of `best` to the level" in other
    assert f"as many updates on as many real rows need {times} the steps to the level" in front
    assert min(stats.ratio(*pair).low for pair in level + walk) > 1.5
    assert sum(np.isnan(one).sum() for pair in walk for one in pair) == 1  # Go1 of `best`
    assert f"so they need {times} the steps of `best`" in page
    assert f"PPO alone needs {times} its steps to the level" in page

    def then(jobs):
        runs = [(table.seeds(job), table.walks.level(table.best(job))) for job in jobs]
        some = ([100 * table.first(run, at, "fall_rate") for run in mine] for mine, at in runs)
        return list_of([f"{np.mean(one):.1f}" for one in some])

    def end(jobs):
        return list_of([f"{100 * one.mean():.1f}" for one in ends_of(jobs, "fall_rate")])

    told = f"First at the level they fall in {then(many)} % of the episodes (`best`: {then(best)})"
    assert f"{told}, at the end in {end(many)} ({end(best)}, of ANYmals after 0.6 M more)" in page
    last = [[job[-1]["sim_steps"] / 1e6 for job in jobs] for jobs in (many, best, tuned)]
    np.testing.assert_allclose(np.subtract(last[1], last[0]), [0, 0, 0.63, 0.63], atol=0.03)
    assert "more at the end, after 3.7 M each" in page
    np.testing.assert_allclose(last[::2], 3.7, atol=0.05)
    p, holm = ranks_of([*zip(*(ends_of(x, "fall_rate") for x in (many, best)), strict=True)])
    assert f"more only on ANYmal-D (by Holm {holm[3]:.3f})" in page
    assert min(p[:3]) > 0.05 > holm[3]
    for ours, epochs in (many, 15), (few, 5):  # with the robots and settings of `best`
        for own in pairs_of(controls_of("3", f"control-real20-{epochs}"), ours, "level"):
            assert np.nanmean(own[0]) > 1.5 * own[1].max()
    # 15 epochs beside 5, and both beside PPO tuned for the level
    for ours, theirs, whats in (
        (many, few, ("level", "walks")),
        (many, tuned, ("level", "walks")),
        (few, tuned, ("level",)),
    ):
        assert min(ranks_of(pairs_of(ours, theirs, what))[1].min() for what in whats) > 0.05
    assert "neither with 208 robots, 15 epochs beside 5, nor" in page
    assert "**Beside PPO tuned for the level** no difference in steps to it is shown." in page
    more = [*zip(*(ends_of(x, "return") for x in (many, tuned)), strict=True)]
    told = list_of([f"{a.mean() - b.mean():.1f}" for a, b in more])
    holm = stats.holm([stats.welch_of(*pair) for pair in more]).max()
    told = f"With 15 epochs they return {told} more at the end, after 3.7 M each"
    assert f"{told} (Welch, by Holm {holm:.3f} at most; looked at afterwards)" in page
    whole, p = headline_of("best"), []
    for ours, theirs, margin in zip(many, whole, (1, 1, 0.7, 0.7), strict=True):
        at = [table.between(job, 3.6864e6, "return") for job in (theirs, ours)]
        p.append(stats.equivalence(*at, margin))
    told = "So they end as high as `best` does after 3.69 M (equal within 1.0, ANYmals 0.7; p "
    assert f"{told}{max(p):.3f} at most)" in page
    # a control of a Go2 that walks sooner than the PPO chosen for that
    mine, walk = few[1], pairs_of(few, headline_of("ppo-walk"), "walks")[1]
    late = stats.difference(np.nan_to_num(walk[1], nan=3.6864e6) / 1e6, walk[0] / 1e6)
    saved = stats.ratio(*pairs_of(few, best, "walks")[1])
    told = "walks on a Go2 after {:.2f} M, five of five seeds: {:.2f} M sooner than the one chosen to walk "
    told = told.format(walk[0].mean() / 1e6, late.value) + f"({late.low:.2f} to {late.high:.2f}, "
    told += f"looked at afterwards; `best` is still {saved.value:.1f} times as soon, {saved.low:.1f} to "
    assert f"{told}{saved.high:.1f};" in front and len(table.seeds(mine)) == 5
    # as many limits of KL, too: 64 robots of the grid
    jobs = table.read(LESS / "results/ppo.csv.xz", "5")
    grid = pairs_of([jobs[f"grid-64-kl3-{x}"] for x in LETTERS.values()], best, "level")
    value = [np.nan_to_num(a, nan=3.6864e6).mean() / b.mean() for a, b in grid]
    told = "It needs {0:.1f}, {2:.1f} and {3:.1f} times the steps to the level on Go1, ANYmal-C and -D, a "
    told = told.format(*value) + f"Go2 at least {value[1]:.1f} (three seeds each, Holm "
    assert f"{told}{max(ranks_of(grid)[1]):.3f};" in page
    assert [np.isnan(a).sum() for a, _ in grid] == [0, 2, 0, 0]
    config = config_lib.load("configs/go1.py:best")
    each = config.ppo.epochs * config.ppo.minibatches
    assert each == 20 and 4096 // config.schedule.rounds == 1365 and 64 * 24 == 1536
    assert (
        "has a limit and 20 updates each 1536 real rows, nearly as many as `best` (each 1365)"
        in page
    )
    walk = pairs_of(few, tuned, "walks")
    p, holm = ranks_of(walk)
    assert [x < 0.05 for x in holm] == [False, False, False, True]
    assert np.isnan(walk[3][1]).sum() == 5 and len(walk[3][1]) == 10
    told = "An ANYmal-D with 5 epochs walks sooner (five of ten never with the tuned; by Holm "
    told += f"{holm[3]:.3f};"
    p = stats.rank_sum(*pairs_of(few, headline_of("ppo-walk"), "walks")[3])
    assert f"{told} beside PPO tuned to walk not shown, p {p:.2f})" in page


def test_what_the_page_says_of_the_simulators_tails_is_so():
    """The simulator's tails beside the model's from the same states."""
    page, table = " ".join((LESS / "model.md").read_text().split()), script("21_less/table")
    last, simulator = controls_of("4", "control-last"), controls_of("3", "control-simulator")

    def seeds(jobs):
        return [[run[0]["seed"] for run in table.seeds(job)] for job in jobs]

    assert seeds(last) == seeds(simulator) == [[*range(100, 105)]] * 4
    level, walk = (pairs_of(simulator, last, what) for what in ("level", "walks"))
    (p, holm), times = ranks_of(walk), [stats.ratio(*pair) for pair in walk]
    assert f"model's tails from the same states (by Holm {max(holm):.3f} at most;" in page
    assert max(holm) < 0.05
    verdict, front = (
        " ".join((EXPERIMENTS / x / "README.md").read_text().split()) for x in ("", "21_less")
    )
    value = [one.value for one in times]
    told = f"robots walk after {min(value):.2f} to {max(value):.2f} times the steps of"
    told += " the model's tails from the same states"
    assert (
        f"{told} (Holm {max(holm):.3f}), and of those of `best` fewer on three of four." in verdict
    )
    own = pairs_of(simulator, headline_of("best", table.LAST), "walks")
    assert [x < 0.05 for x in ranks_of(own)[1]] == [True, False, True, True]
    own = [stats.ratio(*own[k]).value for k in (0, 2, 3)]
    span = f"{min(own):.2f} to {max(own):.2f} times"
    assert f"{told}, and after {span} those of `best` on three of four" in front
    told = told.replace("robots walk", "not counted, robots walk")
    assert (
        f"{told} (rank tests). Beside `best`, whose tails start elsewhere, it is {span} on" in page
    )
    assert times[0].high > 1 > max(x.high for x in times[1:])
    assert (
        f"Go1's interval is wide, for a last seed walks after {max(walk[0][1]) / 1e6:.2f} M" in page
    )
    assert all(1 / 3 < x.value < 2 / 3 for x in times)
    assert "would need a third to two thirds of the steps** of the model's tails" in page
    p, holm = ranks_of(level)
    assert f"it is not shown to need fewer** (by Holm {min(holm):.2f} at least)" in page
    assert min(holm) > 0.05
    assert f"is not shown beside the same states (Holm {min(holm):.2f}, five seeds)" in verdict
    assert all(stats.ratio(*pair).low < 1 < stats.ratio(*pair).high for pair in level)
    value = [stats.ratio(*pair).value for pair in level]
    told = f"the same states ({min(value):.2f} to {max(value):.2f} times, five seeds: too few"
    assert told in page
    falls = [
        *zip(*([table.phase(x)[:, 0] for x in jobs] for jobs in (simulator, last)), strict=True)
    ]
    more = [x.mean() for _, x in falls]
    told = "(with its tails from the same states as the simulator's it is {:.1f} to {:.1f} %;"
    assert told.format(min(more), max(more)) in " ".join((LESS / "falls.md").read_text().split())
    few, many = (list_of([f"{x.mean():.2f}" for x in some]) for some in zip(*falls, strict=True))
    told = f"in {few} % of the episodes with the simulator's tails, in {many} with the model's from the"
    holm = list_of([f"{x:.3f}" for x in ranks_of(falls)[1]])
    assert f"{told} same states (by Holm {holm}: shown on Go1)" in page
    assert all(4 * a.mean() < b.mean() for a, b in falls)  # most


def test_what_the_page_of_controls_says_is_so():
    """Ratios to `best`, 20 real rows, falls with tails; with fewer episodes `best` walks no sooner."""
    (table, head), rng = less("headline"), np.random.default_rng(0)
    page = " ".join((LESS / "model.md").read_text().split())

    def of(batch, name):
        jobs = table.read(LESS / "results/ablation.csv.xz", batch)
        return [jobs[f"control-{name}-{x}"] for x in LETTERS.values()]

    def reached(jobs):
        return [table.reached(table.seeds(x), table.walks.level(table.best(x))) for x in jobs]

    def falls(jobs):
        return "{:.2f}, {:.2f}, {:.2f} and {:.2f}".format(
            *(table.phase(job)[:, 0].mean() for job in jobs)
        )

    short = [
        [row for row in head[f"best-{x}"] if row["iteration"] <= table.LAST]
        for x in LETTERS.values()
    ]
    best = reached(short)
    assert "Beside `best` that is not shown on Go2." in page
    assert "Beside `best` it is on the ANYmals, but there" in page
    assert f"with those of `best` {falls([head[f'best-{x}'] for x in LETTERS.values()])}" in page
    few, many = (
        [table.phase(job)[:, 0].mean() for job in jobs]
        for jobs in (of("3", "simulator"), [head[f"best-{x}"] for x in LETTERS.values()])
    )
    assert all(2 * a < b for a, b in zip(few, many, strict=True))  # most
    more = " ".join((LESS / "falls.md").read_text().split())
    told = f"it is {min(few):.1f} to {max(few):.1f} %: most of these falls likely come from the model's "
    assert told + "errors (with its tails from the same states as the simulator's it is" in more
    assert "likely come from its errors.**" in page
    older = falls(of("2", "simulator")), falls(of("2", "last"))
    assert "fall in {} % of the episodes instead of {}.".format(*older) in page
    for job, whole in zip(short, best, strict=True):  # 200 of the 1000 episodes
        walks = []
        for _ in range(20):
            fell = rng.hypergeometric(
                many := [round(1000 * row["fall_rate"]) for row in job],
                1000 - np.array(many),
                200,
            )
            some = [row | {"fall_rate": x / 200} for row, x in zip(job, fell, strict=True)]
            walks.append(np.nan_to_num(reached([some])[0].walks, nan=job[-1]["sim_steps"]).mean())
        whole = np.nan_to_num(whole.walks, nan=job[-1]["sim_steps"]).mean()
        assert np.mean(walks) > 0.99 * whole
    # the lead
    alone = of("3", "real4-15")
    ends = {run[-1]["sim_steps"] for job in alone for run in table.seeds(job)}
    assert np.isnan([one.level for one in reached(alone)]).all() and len(ends) == 1
    told = "On four real rows alone, with as many updates, no robot is at its level in {:.1f} M."
    assert told.format(ends.pop() / 1e6) in page
    real, epochs = reached(of("3", "real20-5")), reached(of("3", "real20-15"))
    times = [stats.share(a.level, b.level, 4.096e6, 0) for a, b in zip(real, best, strict=True)]
    text = (
        "needs {0:.1f} (Go1), {2:.1f} and {3:.1f} times (ANYmals) the steps of `best` to the level,"
    )
    text += " a Go2 at least {1:.1f} times"
    assert text.format(*(cells["pct"] / 100 for cells in times)) in page
    assert times[1]["bound"] == "at least"
    later = [np.mean(a.level - b.level) / 1e6 for a, b in zip(epochs, real, strict=True)]
    assert "by {:.2f} and {:.2f} M (rank tests, p 0.008 each)".format(*later[2:]) in page
    p = [stats.rank_sum(a.level, b.level) for a, b in zip(epochs, real, strict=True)]
    np.testing.assert_allclose(p[2:], 0.008, atol=5e-4)
    assert f"miss the level within 4.1 M: not shown (p {p[0]:.2f}, {p[1]:.2f})" in page
    never = [[int(np.isnan(x.level).sum()) for x in some] for some in (epochs, real)]
    assert never == [[2, 3, 0, 0], [0, 1, 0, 0]]
    rows = table.seeds(of("3", "real4-15")[0])[0][-1]["sim_steps"]
    assert [round(rows / x.level.mean()) for x in best] == [9, 7, 7, 7]
    last, then = reached(of("2", "last")), reached(of("2", "simulator"))
    found = [b.level.mean() / a.level.mean() for a, b in zip(last, then, strict=True)]
    text = (
        "need {:.2f} and {:.2f} times the steps to the level on Go1 and Go2, {:.2f} and {:.2f} on"
    )
    assert text.format(*found) in page


def test_the_page_of_results_has_the_numbers_of_both():
    page = (ROOT / "docs/results.md").read_text()
    runs = {
        "`best`": "best",
        "PPO alone, to the level *": "ppo-level",
        "PPO alone, to walk †": "ppo-walk",
    }
    older = {"PPO-16, 4096 robots, older": "ppo16", "PPO-24, 4096 robots, older": "ppo24"}
    rows = [cells(line) for line in page.splitlines() if cells(line)[0] in LETTERS]
    assert len(rows) == 20
    for robot, what, *mine in rows:
        table, jobs = less("headline" if what in runs else "fresh")
        job = jobs[f"{(runs | older)[what]}-{LETTERS[robot]}"]
        row = cells(table.table({"": job}, table.best(job)).splitlines()[2])[-11:]
        total, fell = re.fullmatch(r"(.*) ± .*, (.* %)", row[9]).groups()
        end = f"{total} of {table.best(job)}, {row[8]}"
        assert mine == [row[1], row[2], end, fell, f"{float(row[10]):.2f} m/s"], (robot, what)


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


def test_runs_of_two_batches_are_not_one_and_other_settings_of_a_name_are_apart(tmp_path):
    table = script("21_less/table")
    text = "batch,name,job,seed,sim_steps,return,fall_rate,early\n"
    text += "1,a-g,go1:best run.num_seeds=5 x=1,0,10,30,0.1,0.5\n2,a-g,go1:best x=1,0,10,40,0.1,\n"
    text += "3,a-g,go1:best x=2,0,10,50,0.1,\n"
    (tmp_path / "runs.csv.xz").write_bytes(lzma.compress(text.encode()))
    jobs = table.read(tmp_path / "runs.csv.xz")
    returns = {
        n: [[r["return"] for r in run] for run in table.seeds(job)] for n, job in jobs.items()
    }
    assert returns == {"a-g": [[30], [40]], "a-g of batch 3": [[50]]}
    assert np.isnan(jobs["a-g"][1]["early"])  # an empty cell


def test_where_a_run_was_is_packed_and_no_number_to_the_table(tmp_path, monkeypatch):
    row = {"job": "go1:best", "device": "NVIDIA H200", "commit": "abc", "seed": 3, "iteration": 5}
    row |= {"sim_steps": 10, "seconds": 1.0, "return": 40, "fall_rate": 0.0}
    (tmp_path / "runs").mkdir()
    script("21_less/run").write(tmp_path / "runs/a-g.csv", [row])
    to, folder = tmp_path / "runs.csv.xz", tmp_path / "runs"
    monkeypatch.setattr(sys, "argv", ["pack.py", str(to), "7", str(folder)])
    script("21_less/pack").main()
    table = script("21_less/table")
    for path in (folder, to):
        ((found,),) = table.read(path).values()
        assert (found["device"], found["commit"], found["return"]) == ("NVIDIA H200", "abc", 40)
    assert "seconds" not in found and found["batch"] == "7"


def test_a_robot_stays_from_the_evaluation_on_after_which_none_is_bad():
    reached = script("21_less/table").reached
    ends = ((39.0, 0.0), (41.0, 0.02), (37.9, 0.0), (38.0, 0.01), (42.0, 0.03))
    run = [{"return": a, "fall_rate": b, "sim_steps": 10.0 * i} for i, (a, b) in enumerate(ends)]

    def stays(rows, level, most):
        return reached([rows], level, most=most).walks[0]

    assert [stays(run, 38, most) for most in (1, 0.03)] == [30, 30]
    assert np.isnan(stays(run, 38, 0.01)) and np.isnan(stays(run, 43, 1))
    assert (stays(run[:4], 38, 0.01), stays(run[:4], 37, 0.02)) == (30, 0)


def test_the_readmes_table_says_what_the_runs_did():
    """Steps until it walks, and until it is first at its level; falls; the end."""
    (table, jobs), page = less("headline"), (ROOT / "README.md").read_text()
    for robot, label in (
        ("go1", "Go1"),
        ("go2", "Go2"),
        ("anymal_c", "ANYmal-C"),
        ("anymal_d", "ANYmal-D"),
    ):
        mine, ppo, to_walk = (
            jobs[f"{name}-{LETTERS[label]}"] for name in ("best", "ppo-level", "ppo-walk")
        )
        level = script("14_efficiency").LEVEL[robot]
        ours, theirs, walking = (
            table.reached(table.seeds(job), level) for job in (mine, ppo, to_walk)
        )
        assert not np.isnan([*ours.level, *theirs.level]).any()
        falls = 100 * np.mean([table.first(run, level, "fall_rate") for run in table.seeds(mine)])
        mine_walk, walk = (np.isfinite(one.walks).sum() for one in (ours, walking))
        last = cells(table.table({"": mine}, table.best(mine)).splitlines()[2])[-2]
        end = re.sub(" ± [^,]*", f" of {table.best(mine)}", last)
        found = [
            f"{np.nanmean(ours.walks) / 1e6:.2f} ({np.nanmax(ours.walks) / 1e6:.2f}"
            + (f"; {mine_walk} of 10)" if mine_walk < 10 else ")"),
            f"{np.nanmean(walking.walks) / 1e6:.1f}" + (f" ({walk} of 10)" if walk < 10 else ""),
            f"{ours.level.mean() / 1e6:.2f}, {falls:.1f} %",
            f"{theirs.level.mean() / 1e6:.1f}",
            end,
        ]
        line = next(line for line in page.splitlines() if line.startswith(f"| {label} "))
        plain = line.replace(" seeds)", ")").replace(" % falls", " %")
        assert cells(plain) == [label, *found]
        less_than = theirs.level.mean() / ours.level.mean()
        assert round(less_than) == (4 if robot.startswith("go") else 3)  # "a quarter", "a third"
        columns = paper.sim_steps(
            f"configs/{robot}.py:best", 150 if robot.startswith("go") else 110
        )
        assert columns < 0.1 * mine[-1]["sim_steps"]  # "over 90 % of them without the model"
    text = " ".join(page.split())
    first, walks = (np.mean(x) / 1e6 for x in (ours_of("best-g").level, ours_of("best-g").walks))
    assert f"commands after {first:.2f} million" in text and f"after {walks:.2f} million" in text
    steps = [np.mean(ours_of("ppo-level-g").level), np.nanmean(ours_of("ppo-walk-g").walks)]
    steps = [x / 1e6 for x in steps]
    text = " ".join(text.split())
    assert (
        "needs {:.1f} million to follow commands and {:.1f} million to walk".format(*steps) in text
    )


def ours_of(name, results="headline"):
    """Steps of a job of the headline, or of another file."""
    table, jobs = less(results)
    return table.reached(table.seeds(jobs[name]), 38 if name[-1] in "gh" else 24)


def test_at_equal_steps_and_in_ratios_the_headline_is_as_its_page_says():
    """The shipped tables, against NumPy and `stats` on the rows of the file."""
    table, jobs = less("headline")

    def column(name, what, at):
        out = []
        for seed in sorted({row["seed"] for row in jobs[name]}):
            rows = [row for row in jobs[name] if row["seed"] == seed]
            (before,) = [r for r in rows if r["sim_steps"] <= at][-1:]
            (after,) = [r for r in rows if r["sim_steps"] >= at][:1]
            span = after["sim_steps"] - before["sim_steps"]
            share = (at - before["sim_steps"]) / span if span else 0.0
            out.append(before[what] + share * (after[what] - before[what]))
        return np.array(out)

    end = table.seeds(jobs["ppo-g"])[0][-1]["sim_steps"]
    rows = {cells(line)[0]: cells(line)[1:] for line in table.beside(jobs).splitlines()[2:]}
    equal = {"ppo": "ghc", "ppo-level": "ghc", "ppo-walk": "gd"}  # "equal within 1.0 (0.7)"
    for name, letter in itertools.product(equal, "ghcd"):
        row = rows[f"{name}-{letter}"]
        for place, what, at, scale in (
            (2, "return", 2e6, 1),
            (3, "return", end, 1),
            (5, "fall_rate", 2e6, 100),
            (6, "fall_rate", end, 100),
        ):
            pair = [scale * column(f"{run}-{letter}", what, at) for run in ("best", name)]
            found = stats.difference(*pair)
            assert row[place] == f"{found.value:+.1f} ({found.low:.1f} to {found.high:.1f})"
        pair = [column(f"{run}-{letter}", "return", end) for run in ("best", name)]
        p = stats.equivalence(*pair, 1.0 if letter in "gh" else 0.7)
        assert row[4] == f"{p:.1g}" and (p < 0.05) == (letter in equal[name])
        one, other = (ours_of(f"{run}-{letter}") for run in (name, "best"))
        found = stats.ratio(one.level, other.level)
        assert row[0] == f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"
        if np.isnan(other.walks).any():
            assert row[1] == f"`best`: {np.isnan(other.walks).sum()} never"
        elif np.isnan(one.walks).any():
            least = np.where(np.isnan(one.walks), end, one.walks).mean() / other.walks.mean()
            assert row[1] == f"at least {least:.1f}"
        else:
            found = stats.ratio(one.walks, other.walks)
            assert row[1] == f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"
    more = [cells[3].split(" ")[0] for cells in (rows["ppo-walk-h"], rows["ppo-walk-c"])]
    told = "tuned to walk `best` has {} and {} more there on Go2 and ANYmal-C; on Go1 and ANYmal-D they"
    told = told.format(*(x.removeprefix("+") for x in more))
    assert f"{told} are equal within 1.0 and 0.7." in " ".join(
        (ROOT / "docs/results.md").read_text().split()
    )


def test_what_the_page_says_of_the_goal_and_of_single_seeds_is_so():
    front, page = (" ".join((LESS / n).read_text().split()) for n in ("README.md", "falls.md"))
    alone = {"g": 0.65e6, "h": 0.65e6, "c": 0.49e6, "d": 0.49e6}  # from there on
    late = {x: (~(ours_of(f"best-{x}").walks <= at)).sum() for x, at in alone.items()}
    assert late == {"g": 5, "h": 3, "c": 2, "d": 7}
    assert "so 5 Go1 and 3 Go2 of 10 do not walk before physics alone begins" in page
    assert "nor do 2 ANYmal-C and 7 ANYmal-D" in page
    assert f"So {sum(late.values())} of the 40 seeds do not walk before the simulator" in front
    ends = {x: ours_of(f"best-{x}").walks / 1e6 for x in "ghcd"}
    met = [x for x, some in ends.items() if some.mean() <= 0.6 and some.max() <= 1.0]
    assert met == ["c"] and ends["h"].mean() < 0.6 and ends["h"].max() > 1.0
    assert "It is met on ANYmal-C. Go2 misses it by its last seed (1.06 M)" in front
    assert np.isfinite([*ends.values()]).all() and "all 40 runs walk" in front
    second = [np.sort(ends[x])[-2] for x in "gd"]
    assert f"Nine of ten Go1 walk by {second[0]:.2f} M" in front
    assert f"Nine of ten ANYmal-D walk by {second[1]:.2f} M" in front
    text = "a Go1 walks after {:.2f} M simulator steps, a Go2 after {:.2f} M, "
    text += "ANYmal-C and -D after {:.2f} and {:.2f} M"
    assert text.format(*(some.mean() for some in ends.values())) in front
    level = [ours_of(f"best-{x}").level.mean() / 1e6 for x in "ghcd"]
    assert "after {:.2f}, {:.2f}, {:.2f} and {:.2f} M steps".format(*level) in front
    theirs = [ours_of(f"ppo-walk-{x}").walks / 1e6 for x in "ghcd"]
    text = "walks after {:.1f}, {:.1f}, {:.1f} and {:.1f} M, and {} of its 40 runs do not within"
    assert text.format(*map(np.nanmean, theirs), np.isnan(theirs).sum()) in front
    end = less("headline")[1]["ppo-walk-g"][-1]["sim_steps"]
    later = [
        stats.difference(np.nan_to_num(one, nan=end / 1e6), ends[x])
        for one, x in zip(theirs, "ghcd", strict=True)
    ]
    told = "needs {:.2f} M more ({:.2f} fewer to {:.2f} more), because one seed of `best` needs {:.2f} M; by"
    told = told.format(later[0].value, -later[0].low, later[0].high, ends["g"].max())
    assert f"{told} ranks p {stats.rank_sum(theirs[0], ends['g']):.3f}" in front
    told = "it is {:.2f} M more ({:.2f} to {:.2f}, a seed that never walks counted with {:.2f} M), "
    told = told.format(*later[1], end / 1e6)
    assert told + "{:.2f} ({:.2f} to {:.2f}) and {:.2f} ({:.2f} to {:.2f})".format(
        *later[2], *later[3]
    ) in (front)
    found = stats.difference(ours_of("ppo-level-h").walks / 1e6, ends["h"])
    assert "needs {:.2f} M more on a Go2 ({:.2f} to {:.2f})".format(*found) in front
    # who walks by PPO's end
    other = [ours_of(f"ppo-level-{x}").walks for x in "ghcd"]
    walk = [[int(np.isfinite(x).sum()) for x in some] for some in (theirs, other)]
    table, jobs = less("headline")
    cut = [[row for row in jobs[f"best-{x}"] if row["sim_steps"] <= end] for x in "ghcd"]
    walked = [table.reached(table.seeds(x), table.walks.level(table.best(x))).walks for x in cut]
    ours = sum(int(np.isfinite(some).sum()) for some in walked)  # as if it had ended there
    better = sum(map(max, *walk))
    assert (sum(walk[0]), better, ours) == (35, 38, 39) and walk[1][1] == 10
    assert "on each robot, chosen afterwards, 2 do not; all ten Go2 then walk, after 2.0 M" in front
    results, verdict, readme = (
        " ".join((ROOT / x).read_text().split())
        for x in ("docs/results.md", "experiments/README.md", "README.md")
    )
    told = "35 of its 40 runs walk, with the better of two PPOs on each robot 38, and 39 of `best`"
    assert told in results and "tuned to walk on each robot, needs 1.9 to 3.1 M" in results
    means = [np.nanmean(x) for x in theirs]
    assert f"{min(means):.1f} to {max(means):.1f}" == "1.9 to 3.1"
    told = (
        "39 of 40 seeds within 3.7 M steps, PPO chosen by its rule on 35, the better of two on each"
    )
    assert f"{told} robot on 38" in verdict
    first = f"{np.mean(ours_of('ppo-walk-g').level) / 1e6:.1f}"
    told = (
        f"on a Go1 that to walk is at 38 after {first}, and that for 38 walks on all ten Go2, after"
    )
    assert f"{told} {np.mean(other[1]) / 1e6:.1f}." in readme
    (count,) = re.findall(r"(\d+ settings in \d+) runs, not (\d+) in (\d+)", front)
    assert f"was tuned with {count[0]} runs (`best` with {count[1]} in {count[2]})" in readme
    assert f"was tuned with {count[0]} runs, `best` with {count[1]} in {count[2]}" in results
    table, jobs = less("headline")
    last, late = (table.seeds(jobs[f"best-{x}"])[np.argmax(ends[x])] for x in "gd")
    some = [r["fall_rate"] for r in last if 0.8e6 < r["sim_steps"] < 5.4e6]
    assert (min(some), max(some)) == (0.002, 0.029) and some[-1] > 0.01
    assert "falls in 0.2 to 2.9 % of its episodes from 0.8 to 5.4 M" in front
    (bad,) = [r for r in late if r["sim_steps"] > 0.44e6 and r["fall_rate"] > 0.01]
    assert bad["fall_rate"] == 0.012 and f"{bad['sim_steps'] / 1e6:.1f}" == "4.6"
    assert "has 1.2 % at a single evaluation, at 4.6 M" in front
    table, jobs = less("low_feet")
    spread = [
        np.mean(
            [
                np.std([r["fall_rate"] for r in run if 70 <= r["iteration"] <= 150], ddof=1)
                for run in table.seeds(jobs[f"best-{x}"])
            ]
        )
        for x in "gh"
    ]
    assert "deviation {:.1f} and {:.1f} points".format(*(100 * s for s in spread)) in page


def test_steps_until_robots_walk_count_falls_and_relapses():
    """Three Go1: one walks at once, one after a relapse, one falls to the end; and an ANYmal."""
    table = script("21_less/table")
    runs = {  # returns, fall rates after 1, 2, 3, 4 M steps
        0.0: ([39, 40, 40, 40], [0, 0, 0, 0]),
        1.0: ([38, 37, 40, 40], [0.0, 0.0, 0.02, 0.01]),
        2.0: ([10, 40, 40, 40], [0.9, 0.5, 0.2, 0.05]),
    }

    def job(runs, text):
        return [
            {"job": text, "seed": seed, "sim_steps": (k + 1) * 1e6, "tracking_error": 0.05}
            | {"return": float(value), "fall_rate": falls}
            for seed, some in runs.items()
            for k, (value, falls) in enumerate(zip(*some, strict=True))
        ]

    go1 = job(runs, "new-g go1:best")
    head, _, line = table.table({"new-g": go1}, table.best(go1)).splitlines()
    told = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    assert told["walks: M steps"] == "2.50 (4.00), 1 never"
    assert told["first at 38"] == "1.33 (2.00)"
    assert told["first at 38, falls at most 1 %"] == "1.00 (1.00), 1 never"
    assert told["at the end: return, falls"].endswith(", 8.7 %")
    anymal = job({0.0: ([24, 24], [0, 0])}, "new-c anymal_c:best")
    head, _, line = table.table({"new-c": anymal}, table.best(anymal)).splitlines()
    assert "first at 24" in head and line.split(" | ")[2] == "1.00 (1.00)"
    rows = table.parts({"new-g": go1, "new-c": anymal}).splitlines()
    assert rows[2] == (
        "| new | **2.50 (1 never)**; 1.33; 39.7, 8.7 % |  | **1.00**; 1.00; 24.0, 0.0 % |  |"
    )


def test_a_laptop_run_walks_if_it_does_to_its_end():
    walk = script("04_laptop/table").walk
    rows = [{"steps": k, "return": 40.0, "fall_rate": f} for k, f in enumerate((0.02, 0.01, 0.005))]
    assert walk(rows, 38) and walk(rows[-1:], 38) and not walk(rows[:1], 38)
    assert not walk(rows[::-1], 38) and not walk(rows, 41)


def test_the_laptops_picture_and_page_are_of_the_runs_that_were_alone(drawn):
    """Five seeds each; the level's seconds and steps, as 30_row_cost has them."""
    table, cost = script("04_laptop/table"), script("30_row_cost/table")
    page = " ".join((EXPERIMENTS / "04_laptop/README.md").read_text().split())
    found = table.alone()
    assert {len(some) for some in found.values()} == {5}
    assert {len(run) for run in found["go1.laptop.best"]} == {16}
    table.draw(EXPERIMENTS / "04_laptop/curves.png")
    assert drawn == ["curves.png"] and "five fresh seeds each (1100 to 1104)" in page
    rows = [row for row in cost.read() if row["name"] in table.DRAWN]
    assert {row["seed"] for row in rows} == {str(n) for n in range(1100, 1105)}
    runs = {run.method: run.level for run in cost.of_rows(rows)}
    best, ppo = runs["best"][:, 1:].mean(0), runs["ppo512"][:, 1:].mean(0)
    text = f"PPO alone takes {ppo[0] / best[0]:.1f} times the steps to 38 of 45 with as many robots"
    assert text in page and [*found] == [
        f"go1.laptop.{name}" for name in ("best", "ppo512", "ppo256")
    ]
    assert f"nor seconds: {best[1]:.1f} s with it and {ppo[1]:.1f} without" in page


def test_a_memory_on_two_cores_is_told_as_it_ran():
    page = (EXPERIMENTS / "04_laptop/README.md").read_text()
    lines = [cells(line) for line in page.splitlines()]
    files = {
        "laptop-20": "`:laptop`",
        "pair-laptop-20": "`:laptop`, one core",
        "laptop-21": "`:laptop`",
        "memory-20": "a memory, eight epochs",
        "memory-21": "a memory, eight epochs",
        "try-b": "a memory, four epochs",
        "pair-memory-20": "a memory, four epochs, one core",
    }
    found = {
        name: json.loads((EXPERIMENTS / f"04_laptop/results/memory/{name}.json").read_text())
        for name in files
    }
    for name, label in files.items():
        seed = found[name]["fields"][0].removeprefix("run.seed=")
        at = {row["iteration"]: row for row in found[name]["rows"]}
        some = [at.get(k) for k in (100, 160, 200)]
        told = [f"{r['return']:.1f}, {100 * r['fall_rate']:.0f} %" if r else "" for r in some]
        assert [label, seed, *told, f"{at[200]['steps'] / 1e3:.0f}"] in lines, name
    told = [found[f"pair-{x}-20"]["rows"][-1]["seconds"] for x in ("memory", "laptop")]
    words = " ".join(page.split())
    assert "200 take {:.0f} s with four epochs, {:.0f} s as they are".format(*told) in words
    last = {name: one["rows"][-1] for name, one in found.items()}
    assert sum(row["fall_rate"] > 0.2 for row in last.values()) == 2
    assert all(row["return"] > 40 for name, row in last.items() if "laptop" in name)


def test_the_solvers_errors_are_those_of_its_file():
    page = (EXPERIMENTS / "01_four_robots/README.md").read_text()
    lines = (EXPERIMENTS / "01_four_robots/solver.txt").read_text().splitlines()
    assert len(lines) == 8
    for line in lines:
        robot, friction = re.match(r"(\w+) +friction ([^:]+):", line).groups()
        label = paper.ROBOTS[robot].removeprefix("Unitree ")
        row = next(x for x in page.splitlines() if x.strip().startswith(f"| {label}, {friction} |"))
        found = re.findall(r"iterations ([\d.]+) % ([\d.]+)", line)
        for cell, (share, worst) in zip(row.split("|")[2:-1], found, strict=True):
            shown = [float(x) for x in re.findall(r"[\d.]+", cell)]
            assert shown[0] == float(share) and abs(shown[1] - float(worst)) <= 0.006, line

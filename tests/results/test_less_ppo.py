"""21_less/ppo.md: how PPO alone was tuned, by the runs and by choose.py."""

import csv
import lzma
import sys

import numpy as np
import pytest
from result_files import EXPERIMENTS, LESS, LETTERS, cells, fields_of, less, ours_of, script

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats


@pytest.mark.parametrize(
    "path",
    [
        "21_less/ppo_grid.txt",
        "21_less/ppo_edges.txt",
        "21_less/ppo_others.txt",
        "21_less/ppo_exact.txt",
        "21_less/ppo_deploy.txt",
        "21_less/ppo_deploy_edges.txt",
        "23_untuned/ppo.txt",
        "23_untuned/ppo_more.txt",
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
    counts = [sum(batch in {*some} for batch, *_ in runs) for some in ("123", "4", "5", "8")]
    front, page, fewer = (
        " ".join((LESS / f"{x}.md").read_text().split()) for x in ("README", "ppo", "falls")
    )
    text = (
        "PPO was chosen in {}: 21 settings in {} on two robots, 12 in {} on two, 14 in {} on four, "
        "[on each of which it was chosen by itself](#the-grid), {} in {} [beyond the edges]"
        "(#beyond-the-edges) of these 14, and 2 in {} as [controls of the model]"
        "(model.md#what-the-model-is-worth), {} of these on fresh seeds."
    )
    beyond = {tuple(sorted(fields.items())) for _, fields in fields_of("ppo_edges.txt").values()}
    settings = 21 + 12 + 14 + len(beyond) + 2
    again = [f"ppo-208-{x}" if x in "gd" else f"ppo-walk-{x}" for x in "ghcd"]
    fresh_runs = sum(len(table.seeds(head[name])) for name in again)
    control = table.read(LESS / "results/ablation.csv.xz", "4")
    both = [name for name in control if name.startswith("updates-208-")]
    assert {name.split("-")[2] for name in both} == {"5", "15"}
    controls = fresh_runs + sum(len(table.seeds(control[name])) for name in both)
    total = sum(counts) + controls
    told = text.format(total, *counts[:3], len(beyond), counts[3], controls, fresh_runs)
    assert told in page
    assert f"{settings} settings in {total} runs, not " in front
    lead = " ".join((LESS / "ppo.md").read_text().split("\n    python ")[0].split())
    now = [ours_of(f"ppo-walk-{x}") for x in "ghcd"]
    numbers = [f"{x:.2f}" for x in (*means, *(np.nanmean(x.walks) / 1e6 for x in now))]
    told = "**{} settings were tried, in {} runs. On ten fresh seeds the best need {}, {}, {} and {} M steps"
    told += " to the level (Go1, Go2, ANYmal-C, -D), and {}, {}, {} and {} to a walk**"
    assert told.format(settings, total, *numbers) in lead
    assert {len(x.walks) for x in (*ours, *now)} == {10}
    assert [int(np.isnan(x.walks).sum()) for x in now] == [0, 0, 0, 1]
    assert "one ANYmal-D of ten never does." in lead
    tuned = {name: chosen_in(name) for name in ("tuning", "falls")}
    text = "`best` was chosen in {} runs on four robots: {} settings in {} (`tuning.csv.xz`;"
    both = [sum(many) for many in zip(*tuned.values(), strict=True)]
    assert text.format(both[1], *tuned["tuning"]) in page
    assert "then {} in {} [for fewer falls]".format(*tuned["falls"]) in page
    assert "{} settings in {} runs, after `task.carry_on`".format(*tuned["falls"]) in fewer
    assert "not {} in {};".format(*both) in front


def chosen_to_walk(letter):
    """The job on fresh seeds of the setting that won the walk in the grid; on all but ANYmal-D another won
    later."""
    return f"ppo-walk-{'grid-' * (letter != 'd')}{letter}"


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


def test_jobs_of_208_robots_are_the_control_and_ran_where_the_page_says():
    """Of its settings; evaluated about as often as the headline's PPO, on as many episodes."""
    control, later = fields_of("updates.txt"), fields_of("ppo_208.txt")
    assert {name.replace("ppo-208-", "updates-208-5-"): one for name, one in later.items()} == {
        name: one for name, one in control.items() if "-208-5-" in name
    }
    asked, head = (paper.jobs(LESS / x) for x in ("ppo_208.txt", "headline.txt"))
    for name, line in asked.items():
        robot, _, variant = line.split()[0].partition(":")
        config = config_lib.load(f"configs/{robot}.py:{variant}")
        for field in line.split()[1:]:
            config_lib.override(config, *field.split("=", 1))
        assert not schedule.uses_model(config_lib.validate(config))
        fields = dict(field.split("=", 1) for field in line.split()[1:])
        walk = dict(field.split("=", 1) for field in head[f"ppo-level-{name[-1]}"].split()[1:])
        for key in ("run.num_seeds", "run.eval_envs"):
            assert fields[key] == walk[key]
        every = [
            int(x["rollout.num_envs"]) * int(x["rollout.horizon"]) * int(x["run.eval_every"])
            for x in (fields, walk)
        ]
        assert abs(every[0] / every[1] - 1) < 0.02 and fields["run.seed"] == "1500"
        other = f"ppo-walk-{name[-1]}" if name[-1] in "hc" else name
        assert head[other] == line  # on Go2 and ANYmal-C it took that place
    used = [line for line in head.values() if "run.seed=1500" in line]
    assert sorted(used) == sorted(asked.values())
    assert not any("run.seed=1500" in x for x in paper.jobs(LESS / "fresh.txt").values())


def test_which_walks_the_control_of_208_robots_won_is_by_its_rule():
    """By the measure of choose.py, beside the PPO that was to walk until then; and what the page says."""
    choose, (table, jobs) = script("21_less/choose"), less("headline")
    text = " ".join((LESS / "ppo.md").read_text().split("### Other")[0].split())
    rule = "**The rule, set on 2026-11-29 before it ran**: it runs on ten fresh seeds of each robot (1500"
    assert rule in text
    mine = {x: f"ppo-walk-{x}" if x in "hc" else f"ppo-208-{x}" for x in "ghcd"}
    before = {
        "g": "ppo-walk-g",
        "h": "ppo-walk-edges-h",
        "c": "ppo-walk-grid-c",
        "d": "ppo-walk-d",
    }
    cost = {x: [choose.cost(jobs[some[x]]) / 1e6 for some in (mine, before)] for x in "ghcd"}
    assert [new < old for new, old in cost.values()] == [False, True, True, False]
    told = (
        "{:.2f} instead of {:.2f} M and {:.2f} instead of {:.2f}, by that measure. On Go1 it needs "
    )
    told += "{:.2f}, not {:.2f}, on ANYmal-D, where three of ten never walk, {:.2f}, not {:.2f}, so there"
    assert told.format(*cost["h"], *cost["c"], *cost["g"], *cost["d"]) in text
    never = {x: int(np.isnan(ours_of(mine[x]).walks).sum()) for x in "ghcd"}
    assert never == {"g": 0, "h": 0, "c": 0, "d": 3}

    def whole(name):
        return np.nan_to_num(ours_of(name).walks, nan=jobs[name][-1]["sim_steps"]) / 1e6

    go2, anymal = (stats.difference(*(whole(s[x]) for s in (mine, before))) for x in "hc")
    ranks = [stats.rank_sum(*(ours_of(s[x]).walks for s in (mine, before))) for x in "hc"]
    told = f"a Go2 needs {-go2.value:.2f} M fewer than before ({-go2.high:.2f} to {-go2.low:.2f}; by ranks p "
    told += f"{ranks[0]:.3f}; uncorrected). That an ANYmal-C needs fewer is not shown "
    told += f"({-anymal.value:.2f} fewer; {-anymal.low:.2f} fewer to {anymal.high:.2f} more; by ranks p "
    assert f"{told}{ranks[1]:.2f})" in text
    control = table.read(LESS / "results/ablation.csv.xz", "4")["updates-208-5-h"]
    first = table.reached(table.seeds(control), 38).walks
    assert len(first) == 5 and np.isfinite(first).all()
    assert f"five of five Go2 walk after {first.mean() / 1e6:.2f} M" in text
    again = ours_of(mine["h"]).walks
    told = (
        f"Ten Go2 walk after {again.mean() / 1e6:.2f} M, those five after {first.mean() / 1e6:.2f} "
    )
    assert f"{told}(rank test, p {stats.rank_sum(first, again):.2f})" in text
    level = ours_of("ppo-level-h").walks
    assert f"walks as soon on a Go2, after {level.mean() / 1e6:.2f} M" in text
    assert stats.rank_sum(level, again) > 0.3
    late = ours_of(mine["c"]).walks == jobs[mine["c"]][-1]["sim_steps"]
    assert (
        late.sum() == 2
        and "Two ANYmal-C walk from their last evaluation on alone, at 3.74 M" in text
    )
    assert (ours_of("ppo-walk-d").walks == jobs["ppo-walk-d"][-1]["sim_steps"]).sum() == 2
    assert "as two ANYmal-D of the PPO to walk do at 3.69;" in text
    short = [row for row in jobs[mine["c"]] if row["sim_steps"] <= 3.69e6]
    assert f"and it still costs less, {choose.cost(short) / 1e6:.2f}." in text
    few = table.read(LESS / "results/ablation.csv.xz", "4")["updates-208-5-d"]
    few, ten = table.reached(table.seeds(few), 24).walks, ours_of(mine["d"]).walks
    told = "Of ANYmal-D the five walked sooner than these ten (p {:.3f}), which are later than the PPO to "
    told += "walk (p {:.3f})"

    told = told.format(stats.rank_sum(few, ten), stats.rank_sum(ten, ours_of("ppo-walk-d").walks))
    assert told in text and np.nanmean(few) < np.nanmean(ten)
    steps = {x: ours_of(mine[x]).level / 1e6 for x in "ghcd"}
    told = "it needs {:.2f}, {:.2f}, {:.2f} and {:.2f} M: no fewer than the PPO tuned for that is shown"
    assert told.format(*(x.mean() for x in steps.values())) in text
    for x, some in steps.items():
        assert stats.rank_sum(some, ours_of(f"ppo-level-{x}").level / 1e6) > 0.05
    assert {
        (row["device"], row["commit"], row["batch"]) for name in mine.values() for row in jobs[name]
    } == {("NVIDIA H200", "724e00dfb7aa", "6")}


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


def won_to_walk(letter):
    """The job on fresh seeds of the winner to walk of the grid and beyond its edges."""
    names = {"g": "ppo-walk-g", "h": "ppo-walk-edges-h"}
    return names.get(letter, chosen_to_walk(letter))


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
                    same = known[names[0]] == headline[won_to_walk(letter)]
                    assert (f"**{walks}**; {first}" in text) == same, names
    assert {*edges} == {name for name in seen if name.startswith("edge-")}
    # the rule, by the shipped script, on the packed runs
    for flags, name, winners in (
        (["--level", "--seed", "1500"], "level", ""),
        (["--seed", "1400"], "walk", "gh"),
    ):
        fresh = tmp_path / f"{name}.txt"
        words = [str(LESS / "results/ppo.csv.xz"), str(LESS / "ppo_grid.txt"), str(fresh)]
        words += ["--beyond", str(LESS / "ppo_edges.txt"), *flags]
        monkeypatch.setattr(sys, "argv", ["choose.py", *words])
        choose.main()
        capsys.readouterr()
        chosen = [line.split(" ", 1)[1] for line in fresh.read_text().splitlines()]
        asked = paper.jobs(LESS / "headline.txt")
        assert chosen == [asked[won_to_walk(letter)] for letter in winners]
        for letter in winners:
            assert {row["job"] for row in head[won_to_walk(letter)]} == {asked[won_to_walk(letter)]}
    text = " ".join(text.split())
    now, before = ([ours_of(of(x)) for x in "gh"] for of in (won_to_walk, chosen_to_walk))
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
    # as often as in tuning; by another return
    path.write_text(f"b {jobs['b']}\n")
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--often", "1", "--episodes", "200"])
    choose.main()
    (line,) = fresh.read_text().splitlines()
    assert line.split()[0] == "walks-b" and "run.eval_every=20" in line
    assert "run.eval_envs=200" in line
    plain, job = sys.argv[:4], script("21_less/table").read(tmp_path)["b"]
    costs = [choose.cost(job, "level", asked) for asked in (None, (40.0, 99.0), (40.5, 0.0))]
    assert costs == [1e6, 1e6, 6e6]  # a return of 40 from 1 M steps on, of 3
    monkeypatch.setattr(sys, "argv", [*plain, "--returns", "41", "24"])
    with pytest.raises(SystemExit, match="^--returns is given without --level"):
        choose.main()
    monkeypatch.setattr(sys, "argv", plain)
    # of later settings, a best one alone
    path.write_text(f"a {jobs['a']}\nc {jobs['c']}\n")
    (later := tmp_path / "later.txt").write_text(f"b {jobs['b']}\n")
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--beyond", str(later)])
    choose.main()
    assert [line.split()[0] for line in fresh.read_text().splitlines()] == ["walks-b"]

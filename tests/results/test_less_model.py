"""21_less/model.md: what the model is worth, by its controls."""

import itertools
import sys

import numpy as np
from result_files import EXPERIMENTS, LESS, LETTERS, fields_of, less, ours_of, script

from dynappo import config as config_lib
from dynappo import schedule
from experiments import paper, stats


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


def test_the_tables_of_controls_are_those_of_their_runs(monkeypatch, capsys):
    """What writes a tail, today and before feet were lifted, ratios, and each part taken out: as printed."""
    page = (LESS / "model.md").read_text()
    monkeypatch.setattr(sys, "argv", ["table.py", str(LESS / "results/ablation.csv.xz"), "--model"])
    script("21_less/table").main()
    printed = capsys.readouterr().out.strip().split("\n\n")
    assert [len(table.splitlines()) - 2 for table in printed] == [8, 16, 4, 14]
    assert all(f"\n\n{table}\n\n" in page for table in printed)


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


def list_of(words):
    """`A, B, C and D`."""
    *before, last = words
    return f"{', '.join(before)} and {last}"


def test_what_the_page_says_of_as_many_updates_is_so():
    """PPO alone with as many real rows, with 15 and 5 epochs, beside `best` and PPO tuned for the level."""
    page, table = " ".join((LESS / "model.md").read_text().split()), script("21_less/table")
    best, tuned = headline_of("best", table.LAST), headline_of("ppo-level")
    many, few = (controls_of("4", f"updates-208-{n}") for n in (15, 5))
    assert {len(table.seeds(job)) for job in many + few} == {5}
    assert {len(table.seeds(job)) for job in tuned} == {10}
    soonest = min(x.min() for x, _ in pairs_of(many, best, "level")) / 1e6
    assert f"level after 0.8 M or later. That held: no seed is before {soonest:.2f}. They" in page
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
    assert f"They need {times} the steps of `best`" in page
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
    for ours, theirs, columns in (
        (many, few, ("level", "walks")),
        (many, tuned, ("level", "walks")),
        (few, tuned, ("level",)),
    ):
        assert min(ranks_of(pairs_of(ours, theirs, what))[1].min() for what in columns) > 0.05
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
    again, few = ours_of("ppo-208-d").walks, walk[3][0]
    told = "On ten fresh seeds it does not: three never walk, and beside the tuned p is {:.2f} "
    told = (
        told.format(stats.rank_sum(again, walk[3][1]))
        + "([ppo.md](ppo.md#beyond-the-edges)). They walk "
    )
    told += f"later than these five (p {stats.rank_sum(few, again):.3f}, looked at afterwards)"
    assert told in page and np.isnan(again).sum() == 3


def test_what_the_page_says_of_three_updates_on_real_rows_is_so():
    """The control `thrice` beside `best`, by its rule, and beside one update; what its jobs are."""
    table, page = script("21_less/table"), " ".join((LESS / "model.md").read_text().split())
    jobs = table.read(LESS / "results/thrice.csv.xz")
    asked = paper.jobs(LESS / "thrice.txt")
    assert {name: job[0]["job"] for name, job in jobs.items()} == asked
    once, thrice = (asked[f"{name}-208-g"] for name in ("once", "thrice"))
    assert thrice == f"{once} control=thrice"
    same = paper.jobs(LESS / "updates.txt")["updates-208-5-g"]
    assert once == same.replace("num_iterations=900", "num_iterations=360") + " physics.impl=c"
    for job in jobs.values():
        assert [run[0]["seed"] for run in table.seeds(job)] == [*range(100, 105)]
        assert {row["device"] for row in job} == {"cpu"}
    assert {row["commit"][:8] for row in jobs["thrice-208-g"]} == {"8caedd95"}
    few = [table.reached(table.seeds(jobs[f"{x}-208-g"]), 38).level for x in ("thrice", "once")]
    best = table.reached(table.seeds(less("headline")[1]["best-g"]), 38).level
    p = stats.rank_sum(few[0], best)
    ends = [table.seeds(jobs[f"{x}-208-g"]) for x in ("thrice", "once")]
    (end,) = {run[-1]["sim_steps"] for some in ends for run in some}
    back, falls = (
        [np.mean([run[-1][what] for run in some]) for some in ends]
        for what in ("return", "fall_rate")
    )
    assert np.isnan(few[0]).all() and p < 0.05 and best.max() < 0.5e6 < end
    text = f"At {end / 1e6:.1f} M no seed of five is at the level: rank test beside the ten of `best`, "
    assert f"{text}p {p:.1g}," in page
    text = "The return is {:.1f} there, and {:.0f} % of the episodes have a fall; {:.1f} and {:.0f} % with "
    told = text.format(*(x for pair in zip(back, 100 * np.array(falls), strict=True) for x in pair))
    assert f"{told}one update" in page
    count = int(np.isfinite(few[1]).sum())
    assert f"{['no', 'one', 'two', 'three', 'four', 'five'][count]} of five at the level)" in page


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

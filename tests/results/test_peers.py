"""Off-policy methods: pages of 24_off_policy and of 27_few/peers.md, and the scripts that train them."""

import csv
import itertools
import re
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from result_files import EXPERIMENTS, few_of, script, shows

from experiments import paper, stats


def test_the_page_of_the_peers_has_the_numbers_of_its_runs(drawn, monkeypatch, capsys):
    """Of the earlier task and of today's, where SAC with symmetric networks is beside others."""
    monkeypatch.setattr(sys, "argv", ["plot.py"])
    peers = script("24_off_policy")
    peers.main()
    page = (EXPERIMENTS / "24_off_policy/README.md").read_text().replace("*", "")
    words = " ".join(page.split())
    printed = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    rows = {cells[0].strip("| "): cells for cells in printed if len(cells) > 9}
    assert drawn == ["peers"] and len(rows) == 11  # with the head, which both tables have
    said = [cells[0] for cells in printed if len(cells) == 1 and cells[0][0] != "|"]
    assert said[0] == "2.2 to 2.5 M steps: -2.4 (-2.9 to -1.9), p 1e-05; 41.4"
    assert "(1.9 to 2.9; PPO 41.4; p 1e-5)" in page
    for name, cells in rows.items():  # walks, first at 38, with few falls; 30, 35, 40
        assert " | ".join(cells[2:5] + cells[6:9]) in page, name
        if name in peers.TODAY:
            assert cells[1] in ("3", "10") and f"| {' | '.join(cells[1:5] + cells[6:9])} | " in page
            assert f" | {cells[10]} |" in page
    assert said[1:] == [
        "sac-symmetric and sac-today: to 30 -0.27 M (-0.41 to -0.12), 0.60 times, p 0.015; to 35 -0.50 M "
        "(-0.63 to -0.37), 0.49 times, p 0.00045; 0.9 to 1.25 M steps: 3.5 (1.3 to 5.7), p 2e-02; 35.4",
        "sac-symmetric and ppo-level-g: to 30 -0.46 M (-0.55 to -0.37), 0.47 times, p 7.8e-07; to 35 "
        "-0.51 M (-0.64 to -0.38), 0.48 times, p 6.8e-06; to 38 -0.40 M (-0.62 to -0.18), 0.65 times, "
        "p 0.0055; 0.9 to 1.25 M steps: 2.4 (0.8 to 4.0), p 9e-03; 36.6",
        "sac-symmetric and best-g: to 30 0.21 M (0.19 to 0.22), 2.03 times, p 4.4e-10; to 35 0.24 M (0.12 "
        "to 0.37), 2.07 times, p 0.01; to 38 0.47 M (0.22 to 0.72), 2.74 times, p 0.012; 0.9 to 1.25 M "
        "steps: -2.6 (-3.1 to -2.1), p 5e-07; 41.5",
    ]
    for told in (
        "to 30 in 0.60 times the steps (0.27 M fewer, 0.12 to 0.41, p 0.015) and to 35 in 0.49 times (0.50 M "
        "fewer, 0.37 to 0.63, p 0.0004)",
        "they return 3.5 more (1.3 to 5.7; without 35.4; p 0.02)",
        "at 38 0.40 M steps sooner (0.18 to 0.62, p 0.006)",
        "it returns 2.4 more (0.8 to 4.0, p 0.009)",
        "0.47 M more, 0.22 to 0.72, p 0.01)",
        "it returns 2.6 less (2.1 to 3.1, p 5e-7)",
    ):
        assert told in words
    jobs, table = peers.read(), peers.less.table
    runs = {name: table.seeds(jobs[name]) for name in (*peers.TODAY, "sac", "crossq-today")}
    reached = {name: table.reached(runs[name], 38) for name in peers.TODAY}
    level = {name: one.level for name, one in reached.items()}
    assert np.isnan(level["sac-today"]).all() and [x[0]["seed"] for x in runs["sac-today"]] == [
        100,
        101,
        102,
    ]
    told = "after {:.2f} M simulator steps, three seeds of three. Without them three seeds"
    assert told.format(level["sac-symmetric"].mean() / 1e6) in words
    told = "PPO, tuned and symmetric, needs {:.2f} M and `best` {:.2f} M, ten seeds each"
    assert told.format(*(level[x].mean() / 1e6 for x in ("ppo-level-g", "best-g"))) in words
    more = "{:.1f} times {}({:.1f} to {:.1f}"
    ratio = stats.ratio(level["sac-symmetric"], level["best-g"])
    assert more.format(ratio[0], "those of `best` ", *ratio[1:]) in words
    assert "{:.1f} times the steps to 38 ({:.1f} to {:.1f};".format(*ratio) in words
    told = "PPO needs {:.2f} times its steps ({:.2f} to {:.2f})"
    assert told.format(*stats.ratio(level["ppo-level-g"], level["sac-symmetric"])) in words
    pair = [reached[name].careful / 1e6 for name in ("sac-symmetric", "best-g")]
    gap, low, high = stats.difference(*pair)
    assert f"{pair[1].mean():.2f} M with `best`, {pair[0].mean():.2f} with SAC" in words and gap > 0
    assert f"({-low:.2f} M fewer to {high:.2f} more, p {stats.welch_of(*pair):.2f})" in words
    best = [max(row["return"] for row in run) for run in runs["sac-today"]]
    assert "of each is {:.2f}, {:.1f} and {:.1f}, so it misses".format(*best) in words
    symmetric = runs["sac-symmetric"]
    ends = [run[-1]["sim_steps"] / 1e6 for run in symmetric]
    assert "| {:.1f}, {:.1f}, {:.1f} |".format(*ends) in words and "off at 1.2 M" in words
    assert f"at {symmetric[0][-1]['return']:.1f} after 2.0 M" in words
    late = np.mean([table.between(jobs["sac-symmetric"], 1e6 * min(ends), "return")])
    assert (
        f"SAC has {late:.1f} after {min(ends):.1f} M; where it ends is open. PPO has 41.9 after 3.7 M."
        in words
    )
    means = [
        np.mean(
            [
                np.mean([r["return"] for r in run if 1.75e6 <= r["sim_steps"] <= 2.05e6])
                for run in runs[name]
            ]
        )
        for name in ("sac-today", "sac")
    ]
    assert "has {:.1f} there between 1.75 and 2.05 M steps, here {:.1f}".format(*means) in words
    end = max(run[-1]["sim_steps"] for run in runs["sac-today"]) / 1e6
    assert f"are not there by {end:.1f} M" in words and f"100 to 102, {end:.1f} M steps" in words
    assert [run[0]["seed"] for run in runs["sac-symmetric"]] == [100, 101, 102]
    window = "between {:g} and {:g} M".format(*(x / 1e6 for x in peers.WINDOW_TODAY))
    assert words.lower().count(window.lower()) == 3
    gaps = [
        (runs[x][0][5]["sim_steps"] - runs[x][0][4]["sim_steps"]) / 1e6
        for x in ("sac-today", "ppo-level-g", "best-g")
    ]
    told = "an evaluation every {:.1f} M steps (PPO every {:.2f}, `best` every {:.2f})"
    assert told.format(*gaps) in words
    assert (
        "rollout.num_envs=128 " in jobs["ppo-level-g"][0]["job"] and "robot, 128 robots," in words
    )
    late = rows["ppo-level-g"][10].split()[0], rows["ppo-level-g"][9]
    assert words.count("{} after {} M".format(*late)) == 2
    one = [run[0]["return"] for run in runs["crossq-today"]]
    assert {len(run) for run in runs["crossq-today"]} == {1}
    assert (
        f"one evaluation, at {runs['crossq-today'][0][0]['sim_steps'] / 1e3:.0f} k: {min(one):.1f}"
        in words
    )
    assert f"{min(one):.1f} to {max(one):.1f}. So how it" in words


def test_the_table_of_other_methods_with_few_robots_is_that_of_its_runs():
    found = {}
    with (EXPERIMENTS / "27_few/peers.csv").open() as file:
        for row in csv.DictReader(file):
            pair = float(row["return"]), 100 * float(row["fall_rate"])
            found.setdefault(row["method"], {}).setdefault(int(row["sim_steps"]), []).append(pair)
    lines = (EXPERIMENTS / "27_few/peers.md").read_text().splitlines()
    heads = [
        cell.strip() for cell in next(x for x in lines if x.startswith("| method")).split("|")
    ][3:-2]
    steps = [
        float(number) * {"k": 1e3, "M": 1e6}[unit] for number, unit, *_ in map(str.split, heads)
    ]
    for method, runs in found.items():
        _, _, seeds, *cells, end, _ = (
            cell.strip()
            for cell in next(x for x in lines if x.startswith(f"| {method} |")).split("|")
        )
        shared = [at for at, pairs in runs.items() if len(pairs) == int(seeds)]
        for at, cell in [*zip(steps, cells, strict=True), (max(shared), end.partition(": ")[2])]:
            if cell:
                near = min(shared, key=lambda x: abs(x - at))
                got, falls = np.mean(runs[near], 0)
                assert abs(near - at) < 0.1 * at and cell == f"{got:.1f}, {falls:.0f} %", (
                    method,
                    at,
                )
    best = {m: max(p[0] for pairs in r.values() for p in pairs) for m, r in found.items()}
    assert (
        best["PPO, 24 rows"]
        > best["PPO, 96 rows"]
        >= 38
        > 17.6
        > best["CrossQ"] - 0.1
        > best["SAC"]
    )


def settings_of_peers():
    """peers_table.py, its settings by name, and the words of peers.md."""
    few = EXPERIMENTS / "27_few"
    table = script("27_few/peers_table")
    found = table.settings()
    return table, found, (few / "peers.md").read_text()


def test_the_table_of_settings_of_other_methods_is_the_printed_one(monkeypatch, capsys):
    """And what is whole, cut off or not begun, and the best so far by the rule."""
    table, found, page = settings_of_peers()
    monkeypatch.setattr(sys, "argv", ["peers_table.py"])
    table.main()
    out = capsys.readouterr().out.splitlines()
    lines, said = ([x for x in out if (x[0] == "|") == is_table] for is_table in (True, False))
    part = page.split("## With settings for few robots")[1]
    assert lines == [x for x in part.splitlines() if x[0:1] == "|"] and len(lines) == 2 + len(found)
    assert said[0] == "CrossQ so far: crossq-gamma97, 118.4 k; at the end 39.5"
    assert said[2] == "SAC so far: sac-u16, 409.6 k; at the end 20.0"
    words = " ".join(part.split())
    assert "`crossq-gamma97` is first so far, and of SAC `sac-u16`" in words
    jobs = paper.jobs(EXPERIMENTS / "27_few/peers_tune.txt")
    assert found.keys() - jobs.keys() == {"crossq-u512"} and len(jobs) == 23
    ends = {
        name: {run[-1]["sim_steps"] for run in found[name].seeds} for name in found.keys() & jobs
    }
    assert {len(one.seeds) for name, one in found.items() if name in jobs} == {2}
    whole = [name for name, end in ends.items() if end == {table.asked(jobs[name])}]
    new = [name for name in jobs if name not in found]
    counts = ["", *"one two three four five six seven eight nine ten".split()]
    told = f"{counts[len(whole)].title()} are whole, {counts[len(ends) - len(whole)]} were cut off by the "
    told += f"end of a call, and {counts[len(new)]} have not begun: "
    told += ", ".join(f"`{name}`" for name in new[:-1]) + f" and `{new[-1]}`."
    assert told in words
    assert f"# {len(jobs)} settings, {len(new)} not begun" in page
    told = (
        "`peers_tune.txt` has {} settings of CrossQ and SAC for 64 robots, each to {:.0f} k steps "
    )
    told = told.format(len(jobs), table.STEPS / 1e3)
    told += f"(`crossq-u256` to {table.asked(jobs['crossq-u256']) / 1e3:.0f} k), on tuning seeds 0 and 1."
    assert told in words and {table.asked(job) for job in jobs.values()} == {204_800, 102_400}
    assert {run[0]["seed"] for one in found.values() for run in one.seeds} == {0, 1}
    assert f"counts with twice the {table.STEPS / 1e3:.0f} k steps" in words
    ends = [one.seeds[0][-1]["sim_steps"] / 1e3 for name, one in found.items() if name[:3] == "sac"]
    told = f"not there by its ends, {min(ends):.0f} to {max(ends):.0f} thousand, in any of five settings"
    assert told in " ".join(page.split()) and len(ends) == 5
    assert "then runs on seeds 100 to 102" in words and "runs on seeds 100 to 102" in table.__doc__
    given = (
        "64 updates a step with batches of 256, half of them mirrored, critics 1024 wide as its "
    )
    assert f"CrossQ has {given}authors', gamma 0.98 and a gain of 1.5," in words
    assert jobs["crossq"] == "crossq --updates 64 --batch 256 --mirror"
    source = (EXPERIMENTS / "24_off_policy/crossq.py").read_text()
    for flag in (("width", "int", 1024), ("gamma", "float", 0.98), ("gain", "float", 1.5)):
        assert 'add_argument("--{}", type={}, default={}'.format(*flag) in source
    first = [x for line in (said[1], said[3]) for x in line.partition(": ")[2].split(", ")]
    assert {*first} == {*new, "crossq-u256", "crossq-w2048", "sac-u256"}
    assert (
        "below the level before nine tenths of their steps: `crossq-u256`, `crossq-w2048` and"
        in words
    )


def test_the_rule_of_the_choice_among_settings_of_other_methods():
    """A seed that never gets there counts with twice all steps; a setting that was cut off does not count;
    of equals the higher return decides."""
    table = settings_of_peers()[0]

    def run(seed, *returns, last=204_800.0):
        steps = np.linspace(0, last, len(returns) + 1)[1:]
        rows = zip(steps, returns, strict=True)
        return [{"seed": seed, "sim_steps": k, "return": r, "fall_rate": 0.5} for k, r in rows]

    found = {
        "crossq": table.setting([run(0, 20, 38), run(1, 38, 20)], 204_800),
        "crossq-a": table.setting([run(0, 38, 20), run(1, 20, 20)], 204_800),
        "crossq-b": table.setting([run(0, 37, 37, last=180e3)] * 2, 204_800),
        "crossq-c": table.setting([run(0, 37, 38, last=180e3)] * 2, 204_800),
        "sac": table.setting([run(0, 9, 9, 9)] * 2, 204_800),
        "sac-a": table.setting([run(0, 20, 9, 8, 12, last=190e3)] * 2, 204_800),
        "sac-b": table.setting([run(0, 38, 38, 38)], 204_800),  # one seed
    }
    assert [one.cost / 204_800 for one in found.values()][:3] == [0.75, 1.25, 2]
    assert found["crossq-c"].cost == 180e3 and found["sac-a"].end == pytest.approx(29 / 3)
    assert [name for name, one in found.items() if not one.counts] == ["crossq-b", "sac-b"]
    jobs = dict.fromkeys([*(x for x in found if x[0] == "c"), "crossq-d"], "crossq --mirror")
    jobs |= {"sac": "sac", "sac-a": "sac --gain 1", "sac-b": "sac --gain 2"}
    assert table.best(found, jobs, "crossq") == ("crossq", ["crossq-b", "crossq-d"])
    assert table.best(found, jobs, "sac") == ("sac-a", ["sac-b"])
    assert table.best({}, jobs, "sac") == ("", ["sac", "sac-a", "sac-b"])
    assert table.asked("crossq --steps 102400 --evaluations 16") == 102_400


def test_the_best_settings_of_other_methods_are_chosen_with_a_folder_of_runs(tmp_path, monkeypatch):
    """Of both methods, when all have run: what peers.py then trains on fresh seeds. A run of the folder takes
    the place of an older one if it got farther; a part of one counts, a line or a seed that is not whole does
    not."""
    peers, jobs = script("27_few/peers"), EXPERIMENTS / "27_few/peers_tune.txt"
    head = "job,seed,sim_steps,seconds,return,fall_rate\n"

    def write(name, seed, last, back):
        path = tmp_path / f"runs/{name}-{seed}.csv"
        path.write_text(head + "".join(f"x,{seed},{s},1,{back},0\n" for s in (100e3, last)))

    (tmp_path / "runs").mkdir()
    with pytest.raises(SystemExit, match="crossq-u256, .* must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    for name in paper.jobs(jobs):
        for seed in (0, 1):
            write(name, seed, 204_800, 30)
    for seed in (0, 1):
        write("crossq-gain1", seed, 204_800, 39)
    (tmp_path / "runs/crossq-gain1-1.csv").rename(tmp_path / "runs/crossq-gain1-1.csv.part")
    write("sac-lr3e4", 0, 204_800, 38.5)
    with (tmp_path / "runs/crossq-gain1-1.csv.part").open("a") as file:
        file.write("x,1,2048")
    sooner = tmp_path / "runs/crossq-w2048-0.csv"
    whole = sooner.read_text()
    sooner.write_text(head + "x,0,6400,1,38,0\n")  # and its other seed is not there
    (tmp_path / "runs/crossq-w2048-1.csv").rename(tmp_path / "crossq-w2048-1.csv")
    with pytest.raises(SystemExit, match="crossq-w2048 must run before the best crossq is"):
        peers.table.of_each_method(tmp_path / "runs", jobs)
    (tmp_path / "crossq-w2048-1.csv").rename(tmp_path / "runs/crossq-w2048-1.csv")
    sooner.write_text(whole)
    assert peers.table.of_each_method(tmp_path / "runs", jobs) == ["crossq-gain1", "sac-lr3e4"]
    ran = []
    monkeypatch.setattr(peers, "start", lambda to, *rest: ran.append(to.stem))
    words = ["peers.py", str(tmp_path / "fresh"), str(jobs), "--best", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", [*words, "--seeds", "100", "101", "102"])
    peers.main()
    assert ran == ["crossq-gain1-100-102", *(f"sac-lr3e4-{seed}" for seed in (100, 101, 102))]


def test_settings_of_other_methods_with_few_robots_are_as_the_page_says():
    """Beside `few`, beside each other by Welch's test, an earlier run of one, and what SAC forgets."""
    table, found, page = settings_of_peers()
    words = " ".join(page.split())
    level = {x: one.level for x, one in found.items() if np.isfinite(one.level).all()}
    early = {x: np.array([table.runs.first(r, 30) for r in one.seeds]) for x, one in found.items()}

    def at(name, steps):
        return [r["return"] for run in found[name].seeds for r in run if r["sim_steps"] == steps]

    first, tuned = (
        few_of("late", "fresh-late-g")[1].level,
        few_of("parts-cut", "part-whole-g")[1].level,
    )
    needs = sorted((one.mean(), name) for name, one in level.items())
    order = "crossq-gamma97 crossq-u128 crossq-b1024 crossq-scale10 crossq".split()
    assert [name for _, name in needs] == order
    told = "in five settings, after {:.0f} to {:.0f} thousand simulator steps. `few` is there after {:.1f}"
    assert told.format(needs[0][0] / 1e3, needs[-1][0] / 1e3, first.mean() / 1e3) in words
    times = [mean / first.mean() for mean, _ in needs]
    assert f"needs {times[0]:.0f} to {times[-1]:.0f} times its steps" in words
    best = level["crossq-gamma97"]
    told = f"needs {best.mean() / 1e3:.1f} k steps, {best.mean() / 3000:.0f} robot-minutes"
    assert told in words
    told = "That is {:.1f} times the {:.1f} k of `few` (ten fresh seeds, 1000 episodes an evaluation; the "
    told += "tuning seeds 0 to 4: {:.1f}, {:.1f} times)"
    both = first.mean() / 1e3, tuned.mean() / 1e3
    text = told.format(times[0], *both, best.mean() / tuned.mean())
    assert text in words
    told = "others need {:.1f}, {:.1f}, {:.1f} and {:.1f} times as many"
    shown = re.search(r"others need (.+?) times as many", words)[1]
    assert shows(shown, *times[1:])
    assert "need {:.1f} and {:.1f} k, so two say".format(*sorted(best / 1e3)) in words
    ends = [
        end / first.mean() for end in (min(map(min, level.values())), max(map(max, level.values())))
    ]
    assert "need {:.1f} to {:.0f} times the steps of `few`".format(*ends) in words
    last = [run[-1]["return"] for run in found["crossq-gamma97"].seeds]
    assert shows(
        re.search(r"At its end\*\* gamma 0.97 has (.+?)\. `few`", words)[1].replace(
            "gamma 0.97", ""
        ),
        *last,
    )
    text = re.search(r"to a return of 30 more updates .+? of these is shown", words)[0]
    few_30 = [
        next(r["sim_steps"] for r in run if r["return"] >= 30)
        for run in few_of("late", "fresh-late-g")[0]
    ]
    to_30 = [
        early[x].mean() / 1e3 for x in ("crossq-u128", "crossq-w2048", "crossq-scale10", "crossq")
    ]
    assert early["crossq-b1024"].mean() == early["crossq-u128"].mean()
    assert early["crossq-gamma97"].mean() == early["crossq-w2048"].mean()
    told = "bigger batches need {:.1f} k, wider critics and gamma 0.97 {:.1f}, rewards x 10 {:.1f}, the "
    told += "setting that all start from {:.1f} (`few` {:.1f})"
    assert told.format(*to_30, np.mean(few_30) / 1e3) in text
    better = "u128 b1024 w2048 gamma97 scale10".split()
    p30 = [stats.welch_of(early[f"crossq-{x}"], early["crossq"]) for x in better]
    p38 = [stats.welch_of(level[x], level["crossq"]) for x in order[:-1]]
    spans = min(p30), max(p30), min(p38), max(p38)
    assert "p {:.2f} to {:.2f}, to 38 {:.2f} to {:.2f}, uncorrected".format(*spans) in words
    at_102 = {x: np.mean(at(x, 102_400)) for x in found if len(at(x, 102_400)) == 2}
    told = "off at {:.1f} after 102 k, more than any other there; gamma 0.97 has {:.1f}"
    assert told.format(at_102["crossq-w2048"], at_102["crossq-gamma97"]) in words
    assert max(at_102, key=at_102.get) == "crossq-w2048"
    pair = at("crossq", 192_000), at("crossq-gain05", 192_000)
    told = f"stays at {np.mean(pair[1]):.1f} (after 192 k {np.subtract(*map(np.mean, pair)):.1f} less than"
    told += " with 1.5, p "
    assert told + f"{stats.welch_of(*pair):.4f})" in words
    rates = [r["fall_rate"] for run in found["crossq-gain05"].seeds for r in run]
    assert (
        np.median(rates) == 0 and np.mean(rates) < 0.01 and "CrossQ seldom falls and stays" in words
    )
    pair = at("crossq-w512", 204_800), at("crossq", 204_800)
    told = (
        "ends at {:.1f}, with 1024 at {:.1f}, which is not shown to differ (p {:.2f}, uncorrected)"
    )
    assert told.format(*map(np.mean, pair), stats.welch_of(*pair)) in words
    assert all(
        max(run[-1]["sim_steps"] for run in found[x].seeds) < 103e3
        for x in ("crossq-w2048", "crossq-u256", "crossq-u512")
    )
    with (EXPERIMENTS / "27_few/peers_tune_cut.csv").open() as file:
        rows = [(float(row["sim_steps"]), float(row["return"])) for row in csv.DictReader(file)]
    before = [np.mean([r for k, r in rows if k == steps]) for steps in (51_200, 121_600)]
    after = [np.mean(at("crossq", steps)) for steps in (51_200, 121_600)]
    assert max(rows)[0] == 121_600
    told = "had {:.1f} after 51 k, then {:.1f}; after 122 k {:.1f}, then {:.1f}."
    assert told.format(before[0], after[0], before[1], after[1]) in words
    sac = {name: one for name, one in found.items() if name[:3] == "sac"}
    assert len(sac) == 5 and not any(np.isfinite(early[name]).any() for name in sac)
    for rows in (rows for one in sac.values() for rows in one.seeds):
        assert min(r["return"] for r in rows if 26e3 <= r["sim_steps"] <= 51.2e3) < 5
    assert "Between 26 and 51 k each seed has less than 5 in some evaluation" in words
    assert "with 256 updates has nothing after 13 k" in words
    few_rows = few_of("late", "fresh-late-g")[0]
    gaps = [
        np.diff([r["sim_steps"] for r in rows]) / 1e3
        for rows in (found["crossq"].seeds[0], few_rows[0])
    ]
    assert all(np.ptp(gap) == 0 for gap in gaps)
    assert "every {:.1f} k steps, `few` every {:.1f} k".format(*(gap[0] for gap in gaps)) in words
    ended = np.mean([rows[-1]["return"] for rows in few_rows]), few_rows[0][-1]["sim_steps"] / 1e3
    assert "`few` is at {:.1f} after {:.0f} k.".format(*ended) in words
    at_13 = {name: np.mean([run[1]["return"] for run in one.seeds]) for name, one in sac.items()}
    assert at_13.pop("sac-u256") < 0 and min(at_13.values()) > 8
    ends = {name: [run[-1]["return"] for run in one.seeds] for name, one in sac.items()}
    means = {name: np.mean(end) for name, end in ends.items()}
    assert (
        f"to {min(means.values()):.1f} to {max(means.values()):.1f} (means of two seeds)" in words
    )
    assert f"it has {min(means.values()):.0f} to {max(means.values()):.0f} then." in words
    assert max(means, key=means.get) == "sac-u16"
    least = min(stats.welch_of(*pair) for pair in itertools.combinations(ends.values(), 2))
    assert f"(p {least:.2f} and more)" in words
    text = " ".join((EXPERIMENTS / "27_few/README.md").read_text().split())
    spans = [f"{x:.0f}" for x in (needs[0][0] / 1e3, needs[-1][0] / 1e3, min(means.values()))]
    most = f"{max(means.values()):.0f}"
    told = (
        f"CrossQ is at 38 after {spans[0]},000 steps (the best setting so far, two tuning seeds), "
    )
    told += (
        f"{times[0]:.1f} times those of `few`, and SAC ends at {spans[2]} to {most}, after 162,000"
    )
    assert told in text
    told = f"at 38 after {spans[0]} to {spans[1]} k), SAC (2; in other settings {spans[2]} to {most} at"
    assert told in text and "9 of 23 settings of CrossQ and SAC have not begun" in text


def test_peers_have_the_task_of_a_config():
    """The robots of SAC, CrossQ and FastTD3: observations, rewards and ends are those of the environment."""
    sac = script("24_off_policy/sac")
    args = types.SimpleNamespace(config="go1:few", set=["physics.impl=c"], gain=1.5)
    trained, evaluated = sac.robots(args)
    assert (trained.observation_size, trained.action_size) == (48, 12)
    assert (
        float(trained._hyper.task.noise.joint_vel)
        > 0
        == float(evaluated._hyper.task.noise.joint_vel)
    )
    state = jax.eval_shape(trained.reset, jax.random.split(jax.random.PRNGKey(0), 3))
    after = jax.eval_shape(trained.step, state, jax.ShapeDtypeStruct((3, 12), jnp.float32))
    assert state.obs.shape == after.obs.shape == after.info["next_obs"].shape == (3, 48)
    assert after.reward.shape == after.done.shape == after.metrics["falls"].shape == (3,)


def test_symmetric_sac_treats_left_and_right_alike():
    """The mirrored observation has the mirrored mean, the spread of the other side, and the same values."""
    sac = script("24_off_policy/sac")
    args = types.SimpleNamespace(config="go1:few", set=["physics.impl=c"], gain=1.5)
    mirrors = sac.robots(args)[0].mirror
    obs, action = (
        jax.random.normal(jax.random.key(1), (5, 48)),
        jnp.linspace(-1, 1, 60).reshape(5, 12),
    )
    image = [
        np.asarray(m.sign) * np.asarray(x)[:, m.index]
        for m, x in zip(mirrors, (obs, action), strict=True)
    ]
    made, plain = sac.networks(mirrors, 48, 12), sac.networks(None, 48, 12)
    key = jax.random.key(0)
    policy, critics = (net.init(key) for net in (made.policy_network, made.q_network))
    logits, other = (
        np.asarray(made.policy_network.apply(None, policy, x)) for x in (obs, image[0])
    )
    np.testing.assert_allclose(
        other[:, :12], mirrors[1].sign * logits[:, :12][:, mirrors[1].index], atol=1e-5
    )
    np.testing.assert_allclose(other[:, 12:], logits[:, 12:][:, mirrors[1].index], atol=1e-5)
    values = [made.q_network.apply(None, critics, *x) for x in ((obs, action), image)]
    np.testing.assert_allclose(*values, atol=1e-5)
    assert np.ptp(logits) > 0.1 and np.ptp(values[0]) > 0.01
    before = [np.asarray(plain.policy_network.apply(None, policy, x)) for x in (obs, image[0])]
    assert np.abs(before[1][:, 12:] - before[0][:, 12:][:, mirrors[1].index]).max() > 0.05
    assert np.abs(before[0] - logits).max() > 0.01


def test_settings_of_other_methods_for_few_robots_are_flags_of_theirs_and_runs_are_whole(
    tmp_path, monkeypatch
):
    """Of two seeds one fails, and leaves what it wrote as a part; one that is there stays."""
    peers, names = script("27_few/peers"), set()
    files = "27_few/peers_tune.txt", "24_off_policy/jobs.txt"
    for line in "".join((EXPERIMENTS / file).read_text() for file in files).splitlines():
        name, method, *given = line.split()
        source = (peers.SCRIPTS / f"{method}.py").read_text()
        flags = [word for word in [*given, *peers.COMMON.split()] if word.startswith("--")]
        assert all(f'add_argument("{flag}"' in source for flag in flags), line
        names.add(name)
    assert len(names) == 23
    assert peers.groups("crossq --mirror", [0, 1]) == [(0, 2)]
    assert peers.groups("sac", [0, 1]) == [(0, 1), (1, 1)]
    with pytest.raises(SystemExit, match=r"--seeds is \[0, 2\], expected seeds that follow"):
        peers.groups("crossq", [0, 2])
    assert peers.command(tmp_path, "crossq --mirror", 5, 3)[-3:] == ["5", "--num-seeds", "3"]
    (tmp_path / "fake.py").write_text(
        "import sys; from pathlib import Path; given = ' '.join(sys.argv[2:])\n"
        "Path(sys.argv[1]).open('a').write(given); sys.exit(given.endswith('--seed 1'))\n"
    )
    (tmp_path / "jobs.txt").write_text("a fake --updates 3\nb fake\n")
    monkeypatch.setattr(peers, "SCRIPTS", tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    (out / "b-0.csv").write_text("before")
    (out / "a-0.csv.part").write_text("cut off")
    words = ["peers.py", str(out), str(tmp_path / "jobs.txt"), "--workers", "2"]
    monkeypatch.setattr(sys, "argv", words)
    peers.main()
    assert (out / "a-0.csv").read_text() == f"{peers.COMMON} --updates 3 --seed 0"
    assert not (out / "a-1.csv").exists() and (out / "a-1.csv.part").exists()
    assert (out / "b-0.csv").read_text() == "before" and not (out / "b-1.csv").exists()


@pytest.mark.slow  # compiles two programs
def test_seeds_of_crossq_side_by_side_are_each_as_alone(tmp_path, monkeypatch):
    """Robots of one number that drifts, and falls at 3; two seeds in one program, and the second alone. After
    a hundred updates more the last bit of a sum would tell."""
    crossq = script("24_off_policy/crossq")

    class Robots:
        observation_size, action_size, mirror = 2, 1, None

        def state(self, x, steps, reward, done, falls, before, truncation):
            metrics = {"falls": falls, "velocity_error_sq": x**2, "yaw_error_sq": x**2}
            info = {"next_obs": before, "steps": steps, "truncation": truncation}
            obs = jnp.stack([x, steps / 10], -1)
            return crossq.sac.envs.State(
                pipeline_state=None, obs=obs, reward=reward, done=done, metrics=metrics, info=info
            )

        def reset(self, keys):
            x = jax.vmap(jax.random.uniform)(keys)
            zero = jnp.zeros_like(x)
            return self.state(x, zero, zero, zero, zero, jnp.stack([x, zero], -1), zero)

        def step(self, state, action):
            x, steps = state.obs[:, 0] + 0.3 * action[:, 0] + 0.1, state.info["steps"] + 1
            falls, late = (abs(x) > 3).astype(float), (steps >= 20).astype(float)
            before, done = jnp.stack([x, steps / 10], -1), jnp.maximum(falls, late)
            x, steps = jnp.where(done > 0, 0.0, x), jnp.where(done > 0, 0.0, steps)
            return self.state(x, steps, -(before[:, 0] ** 2), done, falls, before, late)

    monkeypatch.setattr(crossq.sac, "robots", lambda _: (Robots(), Robots()))
    monkeypatch.setattr(crossq.sac, "LENGTH", 20)
    monkeypatch.setattr(crossq.devices, "own_process", lambda: None)

    def rows(name, *more):
        given = (
            "--config go1:few --robots 4 --updates 3 --batch 16 --width 8 --first 40 --steps 200"
        )
        words = ["crossq.py", str(tmp_path / name), *given.split(), "--evaluations", "2", *more]
        monkeypatch.setattr(sys, "argv", words)
        crossq.main()
        return paper.rows(tmp_path / name)

    both = rows("both.csv", "--seed", "5", "--num-seeds", "2")
    assert [row["seed"] for row in both] == [5, 6, 5, 6]
    assert [row["sim_steps"] for row in both] == [100, 100, 200, 200]
    alone = rows("alone.csv", "--seed", "6")
    for one, other in zip(both[1::2], alone, strict=True):
        assert one["return"] == pytest.approx(other["return"], rel=1e-3)
    assert both[2]["return"] != pytest.approx(both[3]["return"], rel=1e-3)


@pytest.mark.slow  # of an experiment that has been run
def test_crossq_renormalises_batches_and_knows_the_probability_of_its_actions():
    """In training a batch's own moments at first; later, while they are near the running ones, what an
    evaluation gives. The log-probability is that of the change of variables, by a numerical derivative."""
    crossq = script("24_off_policy/crossq")
    norm, rng = crossq.Renorm(), np.random.default_rng(0)
    x = rng.normal(3.0, 2.0, (64, 5)).astype(np.float32)
    start = norm.init(jax.random.key(0), x, False)
    out, after = norm.apply(start, x, True, mutable=["stats"])
    np.testing.assert_allclose(out, (x - x.mean(0)) / np.sqrt(x.var(0) + 1e-3), atol=1e-4)
    after = after["stats"]
    np.testing.assert_allclose(after["mean"], 0.01 * x.mean(0), rtol=1e-4)
    np.testing.assert_allclose(after["var"], 0.99 + 0.01 * x.var(0), rtol=1e-4)
    stats = {"mean": x.mean(0) + 0.3, "var": 1.2 * x.var(0), "steps": jnp.float32(crossq.WARM)}
    late = {"params": start["params"], "stats": stats}
    trained, _ = norm.apply(late, x, True, mutable=["stats"])
    np.testing.assert_allclose(trained, norm.apply(late, x, False), atol=1e-4)

    method = types.SimpleNamespace(actor=crossq.Network((8,), 4))
    obs, key = x[:6], jax.random.key(1)
    actor = method.actor.init(jax.random.key(2), obs, False)
    (action, log_prob), _ = crossq.act(method, actor, obs, key, train=False)
    mean, log_std = np.split(np.asarray(method.actor.apply(actor, obs, False), np.float64), 2, -1)
    std = np.exp(crossq.LOW + 0.5 * (crossq.HIGH - crossq.LOW) * (np.tanh(log_std) + 1))
    raw = np.arctanh(np.asarray(action, np.float64))
    slope = (np.tanh(raw + 1e-6) - np.tanh(raw - 1e-6)) / 2e-6
    density = np.exp(-0.5 * ((raw - mean) / std) ** 2) / (std * np.sqrt(2 * np.pi)) / slope
    np.testing.assert_allclose(log_prob, np.log(density).sum(-1), atol=0.02)

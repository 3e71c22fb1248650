"""22_deploy: policies for hardware."""

import csv
import functools
import json
import lzma
import re

import numpy as np
import pytest
from result_files import (
    DEPLOY,
    EXPERIMENTS,
    HUMANOID,
    ROOT,
    cells,
    column,
    less,
    packed,
    reached_of,
    script,
    shows,
)

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.policy import policy_source, walks
from experiments import paper, stats


def test_the_table_of_feet_lifted_by_and_by_is_that_of_its_runs():
    """22_deploy: falls and returns of tuning.csv.xz, clearance and benchmark of ramp.txt; a laptop's run."""
    folder, runs = EXPERIMENTS / "22_deploy", {}
    with lzma.open(folder / "tuning.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] in ("heights", "ramp"):
                at = runs.setdefault((row["name"], int(row["iteration"])), [])
                at.append((100 * float(row["fall_rate"]), float(row["return"])))
    printed = (folder / "ramp.txt").read_text()
    page = (folder / "feet.md").read_text()
    part = page.split("## Higher feet, by and by")[1].split("\n## ")[0]
    lines = [
        cells(line)
        for line in part.splitlines()
        if line.startswith(("| A", "| -", "| ramp", "| **"))
    ]
    names = "lift0.7h8 lift0.5h10 ramp1h10 ramp1.5h12".split()
    names = [f"{name}-{robot}" for robot in "cd" for name in names]
    for name, line in zip(names, lines, strict=True):
        falls, (back, *rest) = line[1:4], line[4:]
        for at, cell in zip((100, 200, 700), falls, strict=True):
            assert cell == ", ".join(f"{x:.0f}" for x, _ in runs[name, at]), (name, at)
        assert back == ", ".join(f"{x:.1f}" for _, x in runs[name, 700])
        if name.startswith("ramp"):
            of = re.escape(name)
            found = re.findall(rf"{of}\.\d .*clearance cm ([\d.]+)", printed)
            assert (
                rest[0] == ", ".join(f"{float(x):.1f}" for x in found) + " cm" and len(found) == 3
            )
            found = re.findall(rf"{of}\.\d .* return ([\d.]+)", printed)
            assert rest[1] == ", ".join(f"{float(x):.1f}" for x in found)
    with open(folder / "laptop_ramp.csv", newline="") as file:
        told = {(x["clearance_ramp"], x["iteration"]): x for x in csv.DictReader(file)}
    for key, text in (
        (("0.05", "80"), "1.43 of 3.75"),
        (("None", "80"), "-0.19 without"),
        (("0.05", "400"), "2.56 and"),
        (("None", "400"), "2.55 in the end"),
    ):
        assert f"{float(told[key]['episode_return']):.2f}" == text.split()[0] and text in " ".join(
            page.split()
        )
    assert [round(float(told["0.05", at]["share"]), 2) for at in ("30", "370")] == [0.01, 1.0]


def test_the_pages_of_the_bundled_policies_and_of_a_still_robot_have_the_numbers_of_their_files():
    """gait.txt and benchmark.txt are what the scripts of those names printed."""
    page = (EXPERIMENTS / "22_deploy/gait.md").read_text()
    for line in (EXPERIMENTS / "22_deploy/gait.txt").read_text().splitlines():
        name, *values = re.findall(r"^\w+|[\d.]+(?=,|$)", line)
        row = next(cells(one) for one in page.splitlines() if one.startswith(f"| `{name}` |"))[1:]
        for shown, value in zip(row, values, strict=True):
            number = shown.split()[0]
            digits = len(number.partition(".")[2])
            # the file has three digits, so its last one may round either way
            assert abs(float(number) - float(value)) <= 0.51 * 10**-digits + 1e-9, (
                name,
                shown,
                value,
            )
    lines = (EXPERIMENTS / "22_deploy/benchmark.txt").read_text().splitlines()
    found = {line.split()[0]: re.search(r"return ([\d.]+)", line)[1] for line in lines}
    for robot, label in paper.ROBOTS.items():
        full, less = found[robot], found[f"{robot}_deploy"]
        lost = 100 * (1 - float(less) / float(full))
        assert f"| {label.removeprefix('Unitree ')} | {full} | {less} | {lost:.1f} % |" in page
    still = json.loads((EXPERIMENTS / "04_laptop/results/still.json").read_text())
    page = (ROOT / "docs/results.md").read_text()
    best, laptop = still["best"], still["laptop"]
    assert best["fall_rate"] == laptop["fall_rate"] == 0
    row = f"1000 episodes, tracking error {best['tracking_error']:.2f} m/s | "
    assert f"{row}{best['return']:.1f} | {laptop['return']:.1f} |" in page


def tables_of(page):
    """Rows of cells of each table of a page of 22_deploy, the head first."""
    found, last = [], ""
    for line in (DEPLOY / f"{page}.md").read_text().splitlines():
        if line.startswith("|") and "|---" not in line:
            if not last.startswith("|"):
                found.append([])
            found[-1].append([cell.strip() for cell in line.replace("**", "").split("|")[1:-1]])
        last = line
    return found


def test_the_disturbances_of_the_policies_for_hardware_are_those_of_their_files():
    """All of them in disturbances.md; some on the page and in DEPLOY.md; nothing falls, as the page says."""
    table = script("22_deploy/table")
    printed = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in table.table(table.NAMES).splitlines()
        if "|---" not in line
    ]
    (mine,) = tables_of("disturbances")
    assert mine == printed and len(mine) == 26
    rows = {row[0]: dict(zip(printed[0], row, strict=True)) for row in printed}
    head, *short = tables_of("README")[0]
    assert len(short) == 9
    for row in short:
        assert row == [rows[row[0]][name] for name in head], row
    guide = (ROOT / "robots/DEPLOY.md").read_text().split("## Under disturbances")[1]
    lines = [cells(line) for line in guide.split("\n## ")[0].splitlines() if line[:1] == "|"]
    assert len(lines) > 9
    g1 = json.loads((HUMANOID / "results/stress_deploy.json").read_text())["rows"]
    g1 = {row["stress"]: table.cell(row) for row in g1}
    for label, *some in lines[2:]:
        for policy, cell in zip(lines[0], some, strict=True):  # its first cell is empty
            known = g1[label] if policy == "g1_deploy" else rows[label][policy]
            assert cell.replace(" falls", "").replace(" fall", "") == known, (label, policy)
    of_four = [name for name in table.NAMES if name.endswith("_deploy")]
    assert {rows[x][name][:3] for x in rows if x for name in of_four} == {"0; ", ""}
    bare = [float(rows["none"][name].split("; ")[1]) for name in of_four]
    assert max(bare) == 0.06
    text = " ".join((DEPLOY / "README.md").read_text().split())
    assert (
        "any of 16 disturbances, nor in 6 other physics" in text
    )  # and the bare row, and go1's two
    assert len(rows) - 1 == 1 + 16 + 6 + 2


def test_the_steps_of_the_policies_for_hardware_are_those_of_their_runs():
    table = script("21_less/table")
    jobs = table.read(DEPLOY / "deploy.csv.xz")
    full = [row for part in tables_of("steps")[-2:] for row in part]
    for label, name in (
        ("Go1, PPO", "go1-ppo"),
        ("Go1, `deploy`", "go1"),
        ("Go2, `deploy`", "go2"),
        ("ANYmal-C, PPO", "anymal_c-ppo"),
        ("ANYmal-C, `deploy`", "anymal_c"),
        ("ANYmal-D, `deploy`", "anymal_d"),
    ):
        mine = {name: jobs[name]}
        row = cells(table.table(mine, table.best(jobs[name])).splitlines()[2])[1:]
        row = [*row[:7], *row[8:]]  # the highest return is not on the page
        assert [label, *row] in full, label
    assert len(full) == 8
    steps = [
        f"{np.mean([table.first(run, 30) for run in table.seeds(jobs[name])]) / 1e6:.3g}"
        for name in ("go1", "go1-ppo")
    ]
    text = " ".join((DEPLOY / "README.md").read_text().split())
    text_of = "a Go1 is at 30 after {:.1f} M, PPO after {:.0f} ("
    assert text_of.format(*map(float, steps)) in text
    text_of = "a Go1 of `deploy` is at 30 after {:.1f} M steps, PPO after {:.0f}."
    last = (DEPLOY / "steps.md").read_text().split("\n## ")[-1]
    assert last.startswith("The task of 2026-11-23\n")
    assert text_of.format(*map(float, steps)) in " ".join(last.split())
    go2 = column({"503": packed("deploy")["1", "go2"]["503"]}, "fall_rate")[0]
    at = column({"503": packed("deploy")["1", "go2"]["503"]}, "iteration")[0]
    assert not go2[(at >= 200) & (at <= 650)].any() and round(100 * go2[-1]) == 21


def test_the_fresh_seeds_for_hardware_fall_as_their_page_says():
    """With the ramp and in brackets without it, whose seeds that learn late are left out of the end."""
    rows, worst = tables_of("seeds")[1][1:], 0
    assert len(rows) == 4
    for robot, row in zip(paper.ROBOTS, rows, strict=True):
        shown = []
        for batch in "43":
            job = packed("deploy")[batch, f"{robot}-bundled"]
            falls, ends = 100 * column(job, "fall_rate"), column(job, "return")[:, -1]
            assert list(column(job, "iteration")[0]) == [100 * k for k in range(1, 8)]
            late = falls[:, 5] > 50
            shown.append(
                [
                    falls[:, 0].mean(),
                    falls[:, 1].mean(),
                    falls[:, 2:].max(),
                    ends[~late].mean(),
                    late.sum(),
                ]
            )
            worst = max(worst, falls[:, 1].max()) if batch == "4" else worst
            if late.any():
                assert f"{falls[late, -1][0]:.0f}" == {"go2": "12", "anymal_d": "27"}[robot]
                assert f"{falls[late, 4][0]:.0f}" == {"go2": "80", "anymal_d": "78"}[robot]
        for cell, values in zip(row[1:], zip(*shown, strict=True), strict=True):
            assert shows(cell.removesuffix(" of 5"), *values), (robot, cell, values)
    text = " ".join((DEPLOY / "README.md").read_text().split())
    assert f"more than {worst:.1f} % of its episodes after 200 iterations" in text
    job = packed("tuning")["ramped", "ramped1.2h12-c"]
    falls, ends = 100 * column(job, "fall_rate"), column(job, "return")[:, -1]
    told = " ".join((DEPLOY / "seeds.md").read_text().split())
    found = re.search(r"batch `ramped`\): (.*?)\. ##", told)
    assert shows(found[1], falls[:, 0].mean(), falls[:, 1].mean(), falls[:, 2:].max(), ends.mean())


def test_what_was_tried_for_hardware_is_as_its_pages_say():
    """What a policy sees; weights of feet of `best`; clearance and benchmark of the fresh seeds."""
    rows, jobs = tables_of("tried")[0][1:], packed("tuning")
    names = "full full-s h1-o h1-s h3-s h5-s h10-s h5-o h5-s-ppo".split()
    for name, (_, steps, end) in zip(names, rows, strict=True):
        job = jobs["observation", name]
        returns, at = column(job, "return"), column(job, "sim_steps")
        first = [x[y >= 20][0] / 1e6 for x, y in zip(at, returns, strict=True)]
        assert shows(steps, np.mean(first)) and shows(end, returns[:, -1].mean()), name
    with_best = tables_of("feet")[1]
    checked = 0
    for weight, *row in with_best[1:]:
        for letter, cell in zip("ghcd", row, strict=True):
            if cell:
                name = f"best{weight.removesuffix(' (before)').lstrip('-')}-{letter}"
                returns, at = (column(jobs["heights", name], x) for x in ("return", "sim_steps"))
                level = 38 if letter in "gh" else 24
                first = [x[y >= level][0] / 1e3 for x, y in zip(at, returns, strict=True)]
                end, thousand = cell.split(";")[0].split(", ")
                assert shows(end, returns[:, -1].mean()), (name, end, returns[:, -1].mean())
                assert shows(thousand, np.mean(first)), (name, thousand, np.mean(first))
                checked += 1
    assert checked == 12
    printed = (DEPLOY / "fresh.txt").read_text()
    names = "go1-bundled go2-bundled anymal_c-bundled ramped1.2h12-c anymal_d-bundled".split()
    for name, row in zip(names, tables_of("feet")[3][1:], strict=True):
        of = re.escape(name)
        found = re.findall(rf"^{of}\.\d .*clearance cm ([\d.]+)", printed, re.M)
        assert len(found) == 5 and shows(row[1], *map(float, found)), name
        found = re.findall(rf"^{of}\.\d(?:\.npz)? .* return ([\d.]+)", printed, re.M)
        assert sorted(row[2].split(", ")) == sorted(f"{float(x):.1f}" for x in found), name
    # what was asked for, of the bundled policies
    asked = {row[0]: row[2:] for row in tables_of("README")[1]}
    gait = {line.split()[0]: line for line in (DEPLOY / "gait.txt").read_text().splitlines()}
    lost = {row[0]: row[3] for row in tables_of("gait")[4]}
    for k, (robot, label) in enumerate(paper.ROBOTS.items()):
        ahead = {
            name: float(re.search(r"at 0.5 m/s cm ([\d.]+)", gait[name])[1])
            for name in (robot, f"{robot}_deploy")
        }
        printed = re.sub(r"clearance at .*?, ", "", gait[f"{robot}_deploy"])
        found = re.findall(r"([a-z /]+?) (?:cm |m/s )?([\d.]+)(?:,|$)", printed)
        mine = {key.strip(): float(value) for key, value in found}
        assert shows(asked["feet of `deploy`"][k], ahead[f"{robot}_deploy"])
        assert shows(asked["the same, median of seven commands"][k], mine["clearance"])
        assert f"{asked['return lost'][k]} %" == lost[label.removeprefix("Unitree ")]
        assert shows(asked["load of `deploy`, left over right feet"][k], mine["left"])
        fore = asked["front over hind feet (standing)"][k]
        assert shows(fore, mine["front"], mine["front of standing"])
        scuff = asked["feet below 4 mm"][k].removesuffix(" but for 20 ms")
        assert shows(scuff, mine["scuff"], mine["slide"]), scuff
        assert shows(asked["feet of the others: `go1`, `go2`, ..."][k], ahead[robot])


def test_more_of_high_feet_and_the_go2_of_more_changes_are_as_their_files_say():
    """Five seeds a row: clearances and benchmarks of fresh.txt, falls and returns of the batch `solver`."""
    jobs, printed = packed("tuning"), (DEPLOY / "fresh.txt").read_text()
    names = "solver4-c solver10-c ramped1.8h12-c ramped1.8h13-c ramped1.5h14-c solver10-d ramped1.3h12-d"
    last = lambda job, column_: column(job, column_)[:, -1].mean()  # noqa: E731
    for name, row in zip(names.split(), tables_of("feet")[4][1:], strict=True):
        of, job = re.escape(name), jobs["solver", name]
        cm = re.findall(rf"^{of}\.\d .*clearance cm ([\d.]+)", printed, re.M)
        assert len(cm) == 5 and shows(row[1], *map(float, cm)), name
        found = re.findall(rf"^{of}\.(\d) fall_rate .* return ([\d.]+)", printed, re.M)
        told = re.findall(r"([\d.]+) \(7\d(\d)", row[2])
        assert sorted((seed, float(x)) for x, seed in told) == sorted(
            (seed, float(x)) for seed, x in found
        )
        assert shows(row[3], 100 * last(job, "fall_rate")) and shows(row[4], last(job, "return"))
    bundled = json.loads((ROOT / "robots/go2/policy.json").read_text())
    rows = tables_of("seeds")[0][1:]
    for name, row in zip(
        ("best0.2-h-changes", "best0.2-h-long", "best0.2-h-bundled"), rows, strict=False
    ):
        of = re.escape(name)
        falls = dict(re.findall(rf"^{of}\.(\d) falls after (\d+) of 600", printed, re.M))
        cm = dict(re.findall(rf"^{of}\.(\d) .*clearance cm ([\d.]+)", printed, re.M))
        seeds = sorted(falls)
        assert shows(row[1], *(float(falls[seed]) for seed in seeds)), name
        assert shows(row[2], *(float(cm[seed]) for seed in seeds)), name
        batch = "ramped" if name.endswith("bundled") else "solver"
        assert shows(row[3], last(jobs[batch, name], "return")), name
        if name == "best0.2-h-changes":
            assert str(bundled["seed"]) == min(falls, key=lambda seed: int(falls[seed]))
    assert bundled["run_seed"] == 720 + bundled["seed"]


def test_what_makes_a_robot_stand_where_it_should_walk_slowly_is_as_its_file_says():
    with (DEPLOY / "slow.csv").open(newline="") as file:
        robots = list(csv.DictReader(file))
    for robot, row in zip(robots, tables_of("gait")[2][1:], strict=True):
        speeds = [robot[name] or "none" for name in "ahead back left turning_left".split()]
        assert row[1] == ", ".join(speeds)
        assert shows(row[2], float(robot["standing_joint_speed"]))
        falls = [100 * float(robot["fall_rate"])] * ("falls" in row[3])
        assert falls or not float(robot["fall_rate"])
        assert shows(row[3], float(robot["return"]), *falls)
        assert shows(row[4], float(robot["tracking_error"]))


DIRECTIONS = "ahead back left turning_left".split()
SLOWER = {  # jobs of a robot's letter -> their row on gait.md
    "slow40-{}": "two of five, 0.5",
    "slow-{}": "the same, `slow`",
    "slow40-s42-{}": "two of five, 0.42 (ANYmals: to 500)",
    "slow-narrow-{}": "two of five, 0.35",
    "slow25-{}": "one in four, 0.5 (to 400)",
    "narrow-{}": "none, 0.35",
    "stand5-{}": "none, 0.5, one in 20 to stand",
    "stand2-{}": "none, 0.5, one in 50 to stand",
}


@functools.cache
def slowest():
    """`policy -> row` of slowest.csv."""
    with (DEPLOY / "slowest.csv").open(newline="") as file:
        return {row["policy"]: row for row in csv.DictReader(file)}


def followed_by(name):
    """The slowest commands that a policy of slowest.csv follows, in each direction."""
    return [slowest()[name][direction] or "none" for direction in DIRECTIONS]


def test_five_seeds_that_hear_more_slow_commands_are_as_their_files_say():
    """The slowest that all follow, clearance, where runs ended; who moves standing; what seeds fell."""
    shown = {row[0]: row[1:] for row in tables_of("gait")[3][1:]}
    assert [*shown] == [*SLOWER.values()]
    still, jobs = [], packed("tuning")
    for pattern, label in SLOWER.items():
        for letter, cell in zip("ghcd", shown[label], strict=True):
            name = pattern.format(letter)
            seeds = [key for key in slowest() if key.rpartition(".")[0] == name]
            assert len(seeds) == (5 if cell else 0), name
            if not cell:
                continue
            assert cell.split("; ")[0] == max(max(followed_by(seed)) for seed in seeds), name
            heights = [float(slowest()[seed]["clearance"]) for seed in seeds]
            assert shows(cell.split("; ")[1], np.mean(heights), min(heights), max(heights)), name
            end = 400 if "25" in name else 500 if "s42" in name and letter in "cd" else 700
            job = jobs["slow40" if name.startswith(("slow40", "slow25")) else "slow", name]
            assert len(job) == 5 and set(column(job, "iteration")[:, -1]) == {end}, name
            if "stand" not in name and not name.startswith("narrow"):
                still += [float(slowest()[seed]["standing"]) for seed in seeds]
    page = " ".join((DEPLOY / "gait.md").read_text().split())
    *others, most = sorted(still)
    told = f"of the {len(still)} robots with slow commands the joints of one Go2 (0.35) move at"
    assert (
        f"{told} {most:.3f} rad/s" in page
        and f"those of the others at {max(others):.3f} at most" in page
    )
    # seeds that choose.py played, and what narrower kernels are worth on an ANYmal-D
    rows, benchmark = played(), (DEPLOY / "slow_chosen.txt").read_text()
    falls = [total_falls(row) for name, row in rows.items() if re.match(r"slow(40)?-\w\.", name)]
    fell = [count for count in falls if count]
    assert len(falls) == 18 and len(fell) == 12
    narrower = [total_falls(row) for name, row in rows.items() if name.startswith("slow40-s42-g.")]
    assert narrower == [0] * 4
    assert f"played twelve fall, {min(fell):.0f} to {max(fell):.0f} times" in page
    before = [row for name, row in rows.items() if "-bundled." in name]
    assert len(before) == 5 and not sum(map(total_falls, before))
    some = {
        job: [(name, row["error"]) for name, row in rows.items() if name.startswith(f"{job}.")]
        for job in ("slow-narrow-d", "slow40-d")
    }
    back = {
        job: [
            float(re.search(rf"^{re.escape(n)} .*? return ([\d.]+)", benchmark, re.M)[1])
            for n, _ in of
        ]
        for job, of in some.items()
    }
    (narrow, wide), (less, more) = some.values(), back.values()
    assert (len(narrow), len(wide)) == (3, 5)
    assert (
        "{:.3f} to {:.3f} m/s with 0.35 (three seeds), {:.3f} to {:.3f} with 0.5 (five".format(
            *(f(error for _, error in of) for of in (narrow, wide) for f in (min, max))
        )
        in page
    )
    assert f"for {min(less)} to {max(less)} instead of {min(more)} to {max(more)} on" in page
    # what it costs: of one seed each, and of what is bundled
    chosen = "slow40-s42-g.2", "slow-h.1", "slow40-c.1", "slow40-d.0"
    bundled = [f"{robot}_deploy" for robot in paper.ROBOTS]
    first = [
        re.search(rf"^{re.escape(one)} .*? return ([\d.]+)", benchmark, re.M)[1] for one in chosen
    ]
    assert "has {}, {}, {} and {} on the".format(*(f"{float(x):.1f}" for x in first)) in page
    energy = [f"{float(slowest()[one]['cost_of_transport']):.2f}" for one in [*chosen, *bundled]]
    told = "transport is {}, {}, {} and {}, of the bundled ones {}, {}, {} and {}."
    assert told.format(*energy) in page
    errors = [f"{rows[one]['error']:.3f}" for one in chosen]
    assert "track to {}, {}, {} and {} m/s".format(*errors) in page


def played():
    """`policy -> numbers` of choose.txt, and of slow_chosen.txt, by choose.py."""
    rows = {}
    for file in ("choose.txt", "slow_chosen.txt"):
        for line in (DEPLOY / file).read_text().splitlines():
            name, text = line.split(maxsplit=1)
            if " stress" in line:
                rows[name] = {key: float(value) for key, value in map(str.split, text.split(", "))}
    return rows


def total_falls(row):
    return sum(row[kind] for kind in script("22_deploy/choose").FALLS)


def test_more_changes_of_command_did_what_the_page_says():
    """Falls of the headline's seeds in 200 changes each, with and without; first steps at the level."""
    folder, falls = EXPERIMENTS / "21_less/results", {}
    for file, kind in (("changes_lifted.txt", "best"), ("changes_more.txt", "changes")):
        found = re.findall(
            rf"^seed 0 {kind}-(\w)\.\d: falls after (\d+) of 200", (folder / file).read_text(), re.M
        )
        for robot in "ghcd":
            falls[kind, robot] = [int(count) for of, count in found if of == robot]
    page = " ".join((EXPERIMENTS / "21_less/task.md").read_text().split())
    for robot, text in (("h", "on a Go2 ({} to {} in"), ("g", "on a Go1 ({} to {}, p")):
        old, new = falls["best", robot], falls["changes", robot]
        assert len(old) == len(new) == 10
        assert text.format(sum(old), sum(new)) in page
        p = stats.welch_of(old, new)
        assert (f"p {p:.3f})" if robot == "h" else f"p {p:.2f})") in page
    assert len(falls["changes", "c"] + falls["changes", "d"]) == 20
    assert not sum(falls["changes", "c"] + falls["changes", "d"])


BUNDLED = [f"{robot}{end}" for robot in paper.ROBOTS for end in ("", "_deploy")] + ["g1_deploy"]
SECONDS_EACH = pytest.mark.slow  # three; a default test plays one


@pytest.mark.parametrize(
    "name", [name if name == "go1" else pytest.param(name, marks=SECONDS_EACH) for name in BUNDLED]
)
def test_slow_commands_that_a_bundled_policy_follows_are_those_of_the_file(name):
    from dynappo.evaluate import slow

    found = slow.run(policy_source.player(policy_source.load(name)[0])[0])
    assert [f"{x:g}" if x else "none" for x in found.values()] == followed_by(name)


@pytest.mark.parametrize("page", [DEPLOY / "gait.md", ROOT / "robots/DEPLOY.md"])
def test_slow_commands_that_bundled_policies_follow_are_as_the_pages_say(page):
    """A row a policy, or a column."""
    section = page.read_text().split("## Slow commands")[1].split("\n## ")[0]
    head, _, *rows = [cells(line) for line in section.splitlines() if line[:1] == "|"]
    if "ahead" in head:  # a row a policy; the table after it is of runs that are not here
        rows = rows[: [row[0] for row in rows].index("`go1:laptop`")]
        told = {row[0].strip("`"): ", ".join(row[1:]) for row in rows}
    else:
        told = {name: ", ".join(row[k] for row in rows) for k, name in enumerate(head) if k}
    assert len(told) >= 5
    for name, text in told.items():
        assert text == ", ".join(followed_by(name)), name


FEWER = {  # jobs of fewer.txt -> their rows on steps.md
    "deploy": "4096 robots, tails to 150 (`deploy`)",
    "4096-tails": "4096 robots, to 400",
    "1024": "1024 robots, to 150",
    "1024-tails": "1024 robots, to 600",
    "1024-always": "1024 robots, always",
}
LONGER = {"deploy": "deploy", "4096": "4096-tails", "1024": "1024-tails"}  # of fewer_fresh.txt
OF_TAILS = {"g": "Go1", "h": "Go2", "c": "ANYmal-C", "d": "ANYmal-D"}
MILLIONS = 1.7, 4.3, 10.6  # where the rows of tuning seeds have a return
LATE = "4096-tails-c", "1024-tails-c", "1024-always-c"  # cut off first, then run again


@functools.cache
def fewer(name):
    """Rows of a job of fewer.csv.xz."""
    return less("ppo")[0].read(DEPLOY / "fewer.csv.xz")[name]


def fewer_at(name, millions, column="return"):
    """Of each seed after so many M steps, which the runs have."""
    assert millions * 1e6 <= fewer(name)[-1]["sim_steps"]
    return less("ppo")[0].between(fewer(name), millions * 1e6, column)


def fewer_first(name, level):
    """M steps of each seed to a return."""
    return reached_of(fewer(name), level) / 1e6


def fewer_end(name):
    """M steps in all."""
    return fewer(name)[-1]["sim_steps"] / 1e6


def fewer_row(name):
    """Column -> cell of a job in the table of 21_less."""
    table = less("ppo")[0]
    lines = table.table({name: fewer(name)}, table.best(fewer(name))).splitlines()
    return dict(zip(cells(lines[0]), cells(lines[2])[1:], strict=True))


def walks_of(name):
    """M steps of each seed to a walk."""
    table = less("ppo")[0]
    return table.reached(table.seeds(fewer(name)), walks.level(table.best(fewer(name)))).walks / 1e6


def steps_page():
    return " ".join((DEPLOY / "steps.md").read_text().split())


def test_the_tables_of_longer_tails_on_fresh_seeds_are_those_of_their_runs():
    asked = paper.jobs(DEPLOY / "fewer_fresh.txt")
    shown = 0
    for letters, (head, *rows) in zip(("gh", "cd"), tables_of("steps")[:2], strict=True):
        names = [(x, kind) for x in letters for kind in LONGER]
        for (letter, kind), row in zip(names, rows, strict=True):
            name = f"fresh-{kind}-{letter}"
            assert row[0] == f"{OF_TAILS[letter]}, {FEWER[LONGER[kind]]}"
            known = fewer_row(name)
            assert row[1:] == [known[title] for title in head[1:]], name
            about = {(x["batch"], x["device"], x["commit"], x["job"]) for x in fewer(name)}
            assert about == {("fresh", "NVIDIA H200", "94da69b834c4", asked[name])}
            assert {x["seed"] for x in fewer(name)} == set(range(750, 755))
            shown += 1
            assert letter in "gh" or fewer_row(name)["walks: M steps"] == "5 never"
    assert shown == len(asked) == 12


def test_what_longer_tails_save_on_fresh_seeds_is_that_of_their_runs():
    """Ratios of steps by Fieller; errors; PPO beside them."""
    text, short = steps_page(), " ".join((DEPLOY / "README.md").read_text().split())
    levels = {"g": 35, "h": 35, "c": 20, "d": 20}
    first = {
        (kind, x): fewer_first(f"fresh-{kind}-{x}", level)
        for kind in LONGER
        for x, level in levels.items()
    }
    assert not any(np.isnan(x).any() for x in first.values())
    times = {key: stats.ratio(first["deploy", key[1]], x) for key, x in first.items()}
    mean = {key: x.mean() for key, x in first.items()}

    def pair(x):
        return mean["1024", x], mean["deploy", x], *times["1024", x]

    told = (
        "600 a Go1 is at 35 after {:.2f} M steps, with `deploy` after {:.2f} ({:.1f} times as many,"
    )
    told += " {:.1f} to {:.1f}), a Go2 after {:.2f} and {:.2f} ({:.1f} times, {:.1f} to {:.1f})."
    assert told.format(*pair("g"), *pair("h")) in text
    told = "An ANYmal-C is at 20 after {:.2f} and {:.2f} ({:.1f} times, {:.1f} to {:.1f}), an ANYmal-D after"
    told += " {:.2f} and {:.2f} ({:.1f} times, {:.1f} to {:.1f})."
    assert told.format(*pair("c"), *pair("d")) in text
    told = "tails to 400 `deploy` needs {:.1f}, {:.1f}, {:.1f} and {:.1f} times their steps."
    assert told.format(*(times["4096", x].value for x in levels)) in text
    assert all(x.low > 1 for key, x in times.items() if key[0] != "deploy")
    told = "a Go1 is at 35 after {:.1f} M steps (`deploy` {:.1f}), an ANYmal-C at 20 after {:.1f} ({:.1f})"
    assert told.format(*pair("g")[:2], *pair("c")[:2]) in short
    # the lead of steps.md and the bold line
    least, most = (f(times["1024", x].value for x in levels) for f in (min, max))
    assert f"`deploy` needs {least:.1f} to {most:.1f} times as many.**" in text
    assert "all four robots need a seventh to a quarter of the steps" in text
    assert 1 / 8 < 1 / most < 1 / 7 and 1 / 5 < 1 / least < 1 / 4
    # evaluations of `deploy` are far apart
    apart = {
        b["sim_steps"] - a["sim_steps"]
        for x in levels
        for run in [[r for r in fewer(f"fresh-deploy-{x}") if r["seed"] == 750]]
        for a, b in zip(run, run[1:], strict=False)
        if a["iteration"] >= 160
    }
    (apart,) = (x / 1e6 for x in apart)
    left = [
        [(mean["deploy", x] - apart) / mean[kind, x] for x in levels] for kind in ("1024", "4096")
    ]
    told = "iteration 150 those of `deploy` are {:.2f} M steps apart. With that taken off it still needs"
    told += " {:.1f}, {:.1f}, {:.1f} and {:.1f} times the steps of 1024 robots, and {:.1f}, {:.1f}, {:.1f}"
    assert (told + " and {:.1f} times those of 4096.").format(apart, *left[0], *left[1]) in text
    # walks
    counts = [sum(~np.isnan(walks_of(f"fresh-{kind}-h"))) for kind in ("1024", "4096", "deploy")]
    assert counts == [1, 3, 2]
    assert "One of five Go2 with 1024 robots does, three with 4096, two with `deploy`." in text
    both = [walks_of(f"fresh-{kind}-g").mean() for kind in ("1024", "deploy")]
    told = "all five Go1 with 1024 robots walk, after {:.1f} M, and with `deploy`, after {:.1f}."
    assert told.format(*both) in text
    # errors
    error = {
        (kind, row["iteration"]): np.mean(
            [
                x["tracking_error"]
                for x in fewer(f"fresh-{kind}-c")
                if x["iteration"] == row["iteration"]
            ]
        )
        for kind in ("1024", "deploy")
        for row in fewer(f"fresh-{kind}-c")
    }
    late = [x for (kind, at), x in error.items() if kind == "deploy" and at >= 180]
    told = "is {:.3f} m/s off at iteration 440, {:.3f} at 600, where its tails end, and {:.3f} at 1160; with"
    told += " `deploy` {:.3f} to {:.3f} from iteration 180 on."
    at = (error["1024", x] for x in (440, 600, 1160))
    assert told.format(*at, min(late), max(late)) in text
    end = fewer_end("fresh-1024-g")
    off = [
        fewer_at(f"fresh-{kind}-{x}", end, "tracking_error").mean()
        for kind in ("1024", "deploy")
        for x in "gh"
    ]
    told = "A Go1 and a Go2 are {:.3f} and {:.3f} m/s off at their last evaluation, with `deploy` after as"
    assert (told + " many steps {:.3f} and {:.3f}.").format(*off) in text
    # PPO; its fresh seeds are in test_less_ppo_tasks.py
    jobs = less("ppo")[1]
    its = np.concatenate([reached_of(jobs[f"deploy-{n}-c"], 20) / 1e6 for n in (256, 512, 1024)])
    there = its[~np.isnan(its)]
    assert (len(its), len(there)) == (9, 3)
    told = (
        "with these tails all by {:.2f}. In longer runs with settings of another task three of nine"
    )
    told += " ANYmal-C of PPO are there, after {:.1f} to {:.1f} M."
    last = max(first["1024", x].max() for x in "cd")
    assert told.format(last, there.min(), there.max()) in text
    config = config_lib.validate(config_lib.load("go1:deploy"))
    assert (config.schedule.rounds, config.schedule.last_iteration) == (3, 150)
    task, real = config.task, config.rollout.horizon
    paid = round((1 - task.clearance_start) / task.clearance_ramp) * task.episode_length
    rows = real - config.schedule.end_steps
    whole = [
        last + (paid - rows * last) // real for last in (config.schedule.last_iteration, 600, 400)
    ]
    told = "at iteration {} of 700 with `deploy` at the soonest, at {} of 1400 with 1024 robots and at {}"
    assert (paid, rows, real) == (4000, 4, 20) and told.format(*whole) in text
    assert "after 16 episodes without a fall" in text and "which are 4000 real steps" in text
    assert f"tails end at iteration 150 of {config.run.num_iterations}." in text


def test_the_table_of_what_the_tail_saves_is_that_of_fresh_runs():
    """Of the folder's page: steps by the mean and the last seed; feet and error as the rule has them."""
    rule = script("22_deploy/rule")
    jobs = {k: job for k, job in rule.runs.read(rule.RUNS).items() if k in rule.ASKED}
    data = rule.Data(jobs, rule.runs.read(rule.SECONDS), rule.printed([rule.GAIT]))
    _, *rows = tables_of("README")[2]
    lower, further = [], []
    for (letter, robot), row in zip(OF_TAILS.items(), rows, strict=True):
        level = 35 if letter in "gh" else 20
        names = [f"fresh-{kind}-{letter}" for kind in ("deploy", "1024")]
        steps = [fewer_first(name, level) for name in names]
        base, mine = (rule.ended(data, name) for name in names)
        lift = np.subtract(*(rule.means([x], rule.CLEARANCE)[0] for x in (mine, base)))
        error = mine.error[mine.kept].mean() - base.error[base.kept].mean()
        shown = [f"{x.mean():.2f} ({x.max():.2f})" for x in steps]
        ratio = "{:.1f} ({:.1f} to {:.1f})".format(*stats.ratio(*steps))
        assert row == [f"{robot}, {level}", *shown, ratio, f"{lift:+.1f} cm", f"{error:+.3f} m/s"]
        lower.append(-lift)
        further.append(error)
    ends = [f"{fewer_end(f'fresh-{kind}-g'):.1f}" for kind in ("deploy", "1024")]
    assert "{} M steps, and {} with 1024 robots".format(*ends) in " ".join(
        (DEPLOY / "README.md").read_text().split()
    )
    told = f"feet are {min(lower):.1f} to {max(lower):.1f} cm lower at the end, and ANYmals"
    told += f" {min(further[2:]):.2f} to {max(further[2:]):.2f} m/s further off"
    assert told in steps_page()


def test_what_the_rule_for_hardware_found_is_on_its_page():
    """Each cell has the numbers that rule.py has, and is bold where it is met."""
    rule = script("22_deploy/rule")
    jobs = {k: job for k, job in rule.runs.read(rule.RUNS).items() if k in rule.ASKED}
    data = rule.Data(jobs, rule.runs.read(rule.SECONDS), rule.printed([rule.GAIT]))
    part = (DEPLOY / "steps.md").read_text().split("### The rule for fresh seeds")[1]
    lines = [line for line in part.split("###")[0].splitlines() if line[:1] == "|"]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]

    def numbers(text):
        return [float(x) for x in re.findall(r"-?\d+\.\d+", text)]

    def differences(kind, what, digits):
        """Of each robot, of means of the seeds that are kept."""
        both = [
            [
                getattr(x, what)[x.kept].mean()
                for x in (rule.ended(data, f"{k}-{letter}") for letter in OF_TAILS)
            ]
            for k in (kind, rule.BASE)
        ]
        return ", ".join(f"{mine - its:+.{digits}f}" for mine, its in zip(*both, strict=True))

    for k, setting in enumerate(rule.SETTINGS, 2):
        parts = rule.points(data, setting)
        steps, end, gait = parts["1, equal steps"], parts["2, the end"], parts["4, gait"]
        (_, fall), (_, seconds), (_, clearance) = end[8], parts["3, seconds"][0], gait[4]
        gone = re.search(r"(\d+) and (\d+) fall in .* (\d+) became NaN", fall).groups()
        tardy = [
            f"; {text.split(',')[0]}: p {float(re.search('p ([.0-9]+)', text)[1]):.2f}"
            for met, text in end[:4]
            if not met
        ]
        costs = [numbers(text) for _, text in gait[:4]]
        slide, left = (numbers(text.split(":")[1])[:4] for _, text in gait[5:])
        slides = sorted({f"{x:.2f}" for x in (min(slide), max(slide))})
        cell = [
            (
                steps[:4],
                ", ".join(re.search(r", (\+[.0-9]+) \(", text)[1] for _, text in steps[:4]),
            ),
            (steps[4:], steps[4][1].split(": +")[1]),
            (end[:4], differences(setting, "back", 2) + "".join(tardy)),
            (end[4:8], differences(setting, "error", 3)),
            (end[8:], "{} and {} fall; none".format(*gone)),
            (parts["3, seconds"], seconds.split(": ")[1].split(";")[0]),
            (
                gait[:4],
                "{:.2f}, {:.2f}, {:.2f}, {:.2f}".format(*(np.mean(x[:4]) for x in costs))
                + f" times; on one {max(x for each in costs for x in each[:4]):.2f}",
            ),
            (
                gait[4:5],
                ", ".join(f"{x:+.1f}" for x in numbers(clearance.split(":")[1])[:4]) + " cm",
            ),
            (gait[5:], f"{' to '.join(slides)}; {min(left):.2f} to {max(left):.2f}"),
        ]
        assert gone[2] == "0" and len(rows) == 2 + len(cell) + 1
        for row, (some, told) in zip(rows[2:], cell, strict=False):
            bold = all(met for met, _ in some)
            assert row[k] == (f"**{told}**" if bold else told)
        assert {met for met, _ in parts["5, in C MuJoCo"]} == {None} and rows[-1][k] == "not played"
    text, last = steps_page(), rule.told(data)[-1]
    assert last == (
        "`:deploy` stays: fresh-1024 fails 2, the end; 3, seconds; 4, gait,"
        " and fresh-4096 fails 2, the end; 4, gait"
    )
    seconds = [rule.points(data, x)["3, seconds"][0][1] for x in rule.SETTINGS]
    then = [numbers(x.split("return ")[1])[2:] for x in seconds]
    told = "it returns more: {:.1f} than 1024 robots ({:.1f} to {:.1f}), {:.1f} than 4096 ({:.1f} to {:.1f})."
    flat = [abs(then[k][j]) for k in (0, 1) for j in (0, 2, 1)]
    assert told.format(*flat) in text
    assert "after 11.3 s" in seconds[0] and "after 11.3 s" in seconds[1] and "11.3 s, where" in text
    told = "A Go1 lifts them {:.1f} cm less, an ANYmal-C {:.1f}."
    less_ = numbers(rule.points(data, "fresh-1024")["4, gait"][4][1].split(":", 1)[1])
    assert told.format(-less_[0], -less_[2]) in text


def test_the_tables_of_fewer_robots_and_longer_tails_are_those_of_their_runs():
    """Tuning seeds; where a job was cut off, later cells are empty."""
    asked = paper.jobs(DEPLOY / "fewer.txt")
    for letter, (head, *rows) in zip("gc", tables_of("steps")[3:5], strict=True):
        cut = {"1024-always-g"}
        assert head[0] == OF_TAILS[letter]
        assert [row[0] for row in rows] == [
            f"{label}{', cut off' * (f'{name}-{letter}' in cut)}" for name, label in FEWER.items()
        ]
        for kind, row in zip(FEWER, rows, strict=True):
            key = f"{kind}-{letter}"
            name = f"fewer-{key}{'-cut' * (key in cut)}"
            job = fewer(name)
            batch = ("tails", "94da69b834c4") if key in LATE else ("fewer", "6000006171c7")
            about = {(x["batch"], x["commit"], x["device"], x["job"]) for x in job}
            assert about == {(*batch, "NVIDIA H200", asked[f"fewer-{key}"])}
            assert {x["seed"] for x in job} == {0, 1, 2}
            last = float(re.search(r"num_iterations=(\d+)", asked[f"fewer-{key}"])[1])
            assert (job[-1]["iteration"] == last) != (key in cut)
            known = fewer_row(name)
            for title, cell in zip(head[1:], row[1:], strict=True):
                if title.startswith("at ") and title.endswith(" M"):
                    at = float(title.split()[1])
                    assert at in MILLIONS
                    if at > fewer_end(name):
                        assert not cell
                        continue
                    mean, fell = (fewer_at(name, at, x) for x in ("return", "fall_rate"))
                    told = f"{less('ppo')[0].spread(mean)}, {100 * fell.mean():.1f} %"
                    assert cell == told, (name, at)
                else:
                    assert cell == known[title], (name, title)
    text = steps_page()
    assert "seeds 0 to 2, on which the settings were found; 2026-11-29, on an H200" in text
    assert "commit 60000061, batch `fewer`" in text and "commit 94da69b8, batch `tails`" in text


def test_what_fewer_robots_and_longer_tails_are_worth_is_that_of_their_runs():
    """Tuning seeds: differences by Welch, ratios of steps by Fieller; runs that are one at first."""
    text = steps_page()
    tails, more, today, few = (
        f"fewer-{x}-g" for x in ("1024-tails", "4096-tails", "deploy", "1024")
    )

    def gap(one, other, at):
        pair = fewer_at(one, at), fewer_at(other, at)
        return stats.difference(*pair), *(x.mean() for x in pair)

    found, mine, its = gap(tails, few, 4.3)
    told = "With 1024 robots tails to 600 instead of 150 give a Go1 {:.1f} instead of {:.1f}"
    told += " after 4.3 M ({:.1f} more, {:.1f} to {:.1f})."
    assert told.format(mine, its, *found) in text
    end = fewer_end(tails)
    found, mine, its = gap(tails, few, end)
    told = "After {:.1f} M it is {:.1f} and {:.1f}, and no difference is shown ({:.1f} more; {:.1f}"
    told += " less to {:.1f} more)."
    assert told.format(end, mine, its, found.value, -found.low, found.high) in text
    told = "a Go1 with 1024 robots is at 30 after {:.1f} M, `deploy` after {:.1f}."
    assert told.format(*(fewer_first(x, 30).mean() for x in (few, today))) in text
    ratio = stats.ratio(*(fewer_first(x, 35) for x in (more, tails)))
    told = "to 35 4096 robots need {:.1f} times the steps of 1024 ({:.1f} to {:.1f})."
    assert told.format(*ratio) in text
    for one, other, until in (  # where they were computed side by side to the same bits
        (today, more, 150),
        ("fewer-1024-always-g-cut", tails, 600),
    ):
        both = [{(x["seed"], x["iteration"]): x["return"] for x in fewer(y)} for y in (one, other)]
        shared = both[0].keys() & both[1].keys()
        alike = [both[0][key] == both[1][key] for key in shared if key[1] <= until]
        assert len(alike) >= 9 and all(alike)
    told = 'the two with 4096 robots are one until iteration 150, "1024, to 600" and "always" until 600.'
    assert told in text


def test_what_was_predicted_of_fewer_robots_is_judged_by_their_runs():
    """A cell a robot: right, wrong, or open where the run was cut off before it could tell."""
    head, *rows = tables_of("steps")[5]
    assert head[1:] == ["Go1", "ANYmal-C"] and len(rows) == 4
    go1, anymal = zip(*(row[1:] for row in rows), strict=True)
    for shown, letter, level, bounds in ((go1, "g", 30, (5, 6)), (anymal, "c", 20, (9, 11))):
        for cell, kind, by in zip(shown, ("1024-tails", "1024"), bounds, strict=False):
            name = f"fewer-{kind}-{letter}"
            first = fewer_first(name, level)
            ends = sorted(x["return"] for x in fewer(name)[-3:])
            if (first <= by).all():
                assert cell == f"right: by {first.max():.2f} M"
            elif np.isnan(first).all():
                end = f"{fewer_end(name):.1f} M"
                assert cell == f"wrong: none; {ends[0]:.1f} to {ends[-1]:.1f} at {end}"
            else:
                (tardy,) = first[~(first <= by)]
                assert cell == f"wrong: one of three at {tardy:.2f} M"
    assert [row[0] for row in rows] == [
        "1024, tails to 600: all at 30 (20) by 5 M (9 M)",
        "1024, tails to 150: the same by 6 M (11 M)",
        "4096, tails to 400: at 14.9 M at most 1.0 (0.7) above `deploy`",
        "1024, always: at 7.4 M less than tails to 600 at 10.7 M",
    ]
    assert (stats.MARGIN["go1"], stats.MARGIN["anymal_c"]) == (1.0, 0.7)
    for cell, letter, margin in ((go1[2], "g", 1.0), (anymal[2], "c", 0.7)):
        names = f"fewer-4096-tails-{letter}", f"fewer-deploy-{letter}"
        found = stats.difference(*(fewer_at(name, 14.876672) for name in names))
        assert found.value > margin and cell == f"wrong: {found.value:.1f} more"
    always = "fewer-1024-always-g-cut", "fewer-1024-always-c"
    end = [fewer_end(x) for x in always]
    ends = [
        [fewer_at(x, fewer_end(x)) for x in pair]
        for pair in zip(always, ("fewer-1024-tails-g", "fewer-1024-tails-c"), strict=True)
    ]
    told = "open: cut off at {:.1f} M, at {:.1f}, the other ends at {:.1f}"
    assert end[0] < 7.4 and go1[3] == told.format(end[0], *(x.mean() for x in ends[0]))
    found = stats.difference(*ends[1])
    assert found.value < 0 < found.high and f"{end[1]:.1f}" == "7.4"
    told = "right: {:.1f} and {:.1f}, no difference shown"
    assert anymal[3] == told.format(*(x.mean() for x in ends[1]))


def changed_fields(job, fields):
    """Fields of a config other than those of `run` that these change, and the config."""
    mine = config_lib.load(f"configs/{job.replace(':', '.py:')}")
    other = config_lib.flat(config_lib.validate(mine.copy_and_resolve_references()))
    mine.run.log_every = 1
    for name, value in (field.split("=", 1) for field in fields):
        config_lib.override(mine, name, value)
    found = config_lib.flat(config_lib.validate(mine))
    return {name for name, x in found.items() if x != other[name] and name[:4] != "run."}, mine


def test_jobs_of_fewer_steps_for_hardware_change_robots_and_tails_alone():
    """22_deploy/fewer.txt: the task is that of `deploy`, and PPO's and the model's settings are."""
    lines = (EXPERIMENTS / "22_deploy/fewer.txt").read_text().splitlines()
    assert len({line.split()[0] for line in lines}) == len(lines) == 10
    for line in lines:
        _, job, *fields = line.split()
        changed, mine = changed_fields(job, fields)
        assert changed <= {"rollout.num_envs", "schedule.last_iteration"}
        assert bool(changed) != ("-deploy-" in line)  # `deploy` itself
        assert schedule.sim_steps(mine)[-1] < 16e6  # PPO's are up to 20 M
    fresh = paper.jobs(DEPLOY / "fewer_fresh.txt")
    for name, line in paper.jobs(
        DEPLOY / "fewer_ramp.txt"
    ).items():  # tails of the fresh seeds, another ramp
        ramp, robots, letter = name.split("-")
        job, *fields = line.split()
        changed, mine = changed_fields(job, fields)
        *_, its = changed_fields(job, fresh[f"fresh-{robots}-{letter}"].split()[1:])
        assert changed - {"task.clearance_ramp"} <= {"rollout.num_envs", "schedule.last_iteration"}
        assert mine.task.clearance_ramp == int(ramp.removeprefix("ramp")) / 100
        assert (mine.rollout, mine.schedule) == (its.rollout, its.schedule)
        assert (mine.run.seed, mine.run.num_iterations) == (0, its.run.num_iterations)


def test_jobs_of_the_rule_for_fresh_seeds_for_hardware_are_as_the_page_says():
    """fewer_fresh.txt and fewer_seconds.txt: robots, tails, lengths and seeds that nothing was tuned on."""
    text = " ".join((DEPLOY / "steps.md").read_text().split())
    changes, ends = {}, {}
    for name, line in paper.jobs(DEPLOY / "fewer_fresh.txt").items():
        job, *fields = line.split()
        kind, letter = name.rsplit("-", 1)
        assert job == {"g": "go1", "h": "go2", "c": "anymal_c", "d": "anymal_d"}[letter] + ":deploy"
        changed, mine = changed_fields(job, fields)
        asked = {x: config_lib.flat(mine)[x] for x in sorted(changed)}
        assert changes.setdefault((kind, mine.run.num_iterations), asked) == asked
        ends.setdefault(kind, set()).add(schedule.sim_steps(mine)[-1] / 1e6)
        assert (mine.run.seed, mine.run.num_seeds, mine.run.eval_envs) == (750, 5, 200)
        assert mine.run.num_iterations % mine.run.eval_every == 0
    assert changes == {
        ("fresh-deploy", 700): {},
        ("fresh-4096", 600): {"schedule.last_iteration": 400},
        ("fresh-1024", 1400): {"rollout.num_envs": 1024, "schedule.last_iteration": 600},
    }
    assert all(len(x) == 1 for x in ends.values())
    assert [f"{x.pop():.1f}" for x in ends.values()] == ["47.6", "23.1", "18.9"]
    assert "five fresh seeds each (750 to 754), 200 episodes of 20 s an evaluation" in text
    for file in ("deploy", "tuning", "fewer"):
        for (batch, name), job in packed(file).items():
            if (file, batch) == ("fewer", "fresh"):
                continue
            assert ":deploy" not in next(iter(job.values()))[0]["job"] or not {*job} & {
                *map(str, range(750, 758))
            }, name
    read = script("30_row_cost/run").read
    timed = paper.jobs(DEPLOY / "fewer_seconds.txt")
    assert [*timed] == ["deploy-g", "4096-g", "1024-g"]
    for name, line in timed.items():
        job, *fields = line.split()
        its, (kind, _) = read(job, fields), name.rsplit("-", 1)
        assert its.seeds == 3 and its.config.run.seed == 755 and job == "go1:deploy"
        own = [x for x in fields if not x.startswith(("seeds=", "episodes=", "run.log_every="))]
        changed, mine = changed_fields(job, own)
        asked = {x: config_lib.flat(mine)[x] for x in changed}
        assert changes[f"fresh-{kind}", mine.run.num_iterations] == asked
        assert mine.run.num_iterations == its.config.run.num_iterations


def rule_runs():
    """Runs by hand of which each point of the rule is met for both settings, with what was played of them."""
    rule, jobs = script("22_deploy/rule"), {}
    ends = {"fresh-deploy": 47.6, "fresh-4096": 23.1, "fresh-1024": 18.9}
    for name, line in paper.jobs(DEPLOY / "fewer_fresh.txt").items():
        kind, letter = name.rsplit("-", 1)
        last, end = int(re.search(r"num_iterations=(\d+)", line)[1]), ends[kind]
        first = end - 3 if kind != "fresh-deploy" else 17.0
        begin = 35.0 if kind != "fresh-deploy" else 36.0  # of `deploy` it rises by 1.9 to its end
        jobs[name] = [
            {
                **{"job": line, "commit": "one", "seed": 750 + k, "iteration": last + more},
                **{"sim_steps": 1e6 * steps, "return": back + 0.1 * k, "fall_rate": 0.0},
                **{"tracking_error": 0.06 + 0.001 * k, "policy_std": 0.5, "kl": 0.01},
            }
            for k in range(5)
            for more, steps, back in (
                (-60, first, begin),
                *((20 * x, end + x / 4, 37.9) for x in (-2, -1, 0)),
            )
        ]
    timed = {
        name: [
            {
                **{"job": line, "commit": "one", "seed": 755 + k, "return": back + k},
                **{"iteration": last, "seconds": part * (20 + 0.1 * k)},
            }
            for k in range(3)
            for part, last, back in ((0.5, 1, 30), (1, last_iteration(line), 38))
        ]
        for name, line in paper.jobs(DEPLOY / "fewer_seconds.txt").items()
    }
    gait = {"cost of transport": 0.6, "torque N m": 11, "joint speed rad/s": 11}
    gait |= {"change of targets rad/s": 3.6, rule.CLEARANCE: 5.0, "slide m/s": 0.07, "left": 1.0}
    falls = dict.fromkeys(script("22_deploy/choose").FALLS, 0.0)
    played = {
        f"{name}.{k}": {key: x * (1 + 0.01 * (k - 2)) for key, x in gait.items()}
        | falls
        | {"return": 41.0 + 0.1 * k}
        for name in jobs
        for k in range(5)
    }
    return rule.Data(jobs, timed, played)


def last_iteration(line):
    return int(re.search(r"num_iterations=(\d+)", line)[1])


def times(data, name, key, factor, more=0.0):
    """What was played of a job's policies, changed."""
    for k in range(5):
        row = data.played[f"{name}.{k}"]
        row[key] = row[key] * factor + more


def on_all(data, setting, key, factor, more=0.0):
    for letter in "ghcd":
        times(data, f"{setting}-{letter}", key, factor, more)


def rows_of(data, name, seed=None, least=0):
    return [
        row
        for row in data.jobs[name]
        if seed in (None, row["seed"] - 750) and row["sim_steps"] >= 1e6 * least
    ]


def change(rows, **more):
    for row in rows:
        row.update({key: row[key] + x for key, x in more.items()})


def early(data, letter, more):
    """`deploy` returns more before its end, where others end."""
    job = data.jobs[f"fresh-deploy-{letter}"]
    change([row for row in job if row["sim_steps"] < 18e6], **{"return": more})


def seeds_that_fall(data, setting, count):
    for k in range(count):
        change(rows_of(data, f"{setting}-{'ghcd'[k % 4]}", k), fall_rate=0.02)


def policies_that_fall(data, setting, count):
    for k in range(count):
        data.played[f"{setting}-{'ghcd'[k % 4]}.{k // 4}"]["changes"] = 1.0


BROKEN = {  # what breaks, of a setting -> its point, or "" where it still holds
    "`deploy` is better at equal steps on one robot": (
        lambda d, s: early(d, "c", 2.0),
        "1, equal steps",
    ),
    "as good on one": (lambda d, s: early(d, "c", 1.7), ""),
    "nearly as good on all": (lambda d, s: [early(d, x, 1.85) for x in "ghcd"], "1, equal steps"),
    "a return of 0.9 less is not ruled out as 1.0 less": (
        lambda d, s: change(rows_of(d, f"{s}-h"), **{"return": -0.9}),
        "2, the end",
    ),
    "0.5 less is": (lambda d, s: change(rows_of(d, f"{s}-h"), **{"return": -0.5}), ""),
    "but not of an ANYmal": (
        lambda d, s: change(rows_of(d, f"{s}-d"), **{"return": -0.6}),
        "2, the end",
    ),
    "the error": (lambda d, s: change(rows_of(d, f"{s}-g"), tracking_error=0.03), "2, the end"),
    "an error of 0.019 more": (lambda d, s: change(rows_of(d, f"{s}-g"), tracking_error=0.019), ""),
    "three seeds fall": (lambda d, s: seeds_that_fall(d, s, 3), "2, the end"),
    "two seeds fall": (lambda d, s: seeds_that_fall(d, s, 2), ""),
    "a seed that falls returns nothing": (
        lambda d, s: change(rows_of(d, f"{s}-g", 1), **{"return": -30.0, "fall_rate": 0.5}),
        "",
    ),
    "nor does one of deploy": (
        lambda d, s: change(rows_of(d, "fresh-deploy-g", 1), **{"return": -30.0, "fall_rate": 0.5}),
        "",
    ),
    "and walks as it likes": (
        lambda d, s: (
            change(rows_of(d, f"{s}-g", 1), fall_rate=0.5),
            d.played[f"{s}-g.1"].update({"torque N m": 99, "return": 9}),
        ),
        "",
    ),
    "one becomes NaN": (
        lambda d, s: change(rows_of(d, f"{s}-c", 2)[-1:], kl=np.nan),
        "2, the end",
    ),
    "seconds": (
        lambda d, s: change(d.timed[f"{s.removeprefix('fresh-')}-g"], seconds=5.1),
        "3, seconds",
    ),
    "seconds that may be more": (
        lambda d, s: change(d.timed[f"{s.removeprefix('fresh-')}-g"], seconds=4.98),
        "3, seconds",
    ),
    "fewer seconds more": (
        lambda d, s: change(d.timed[f"{s.removeprefix('fresh-')}-g"], seconds=4.5),
        "",
    ),
    **{
        f"{key} on all robots": (lambda d, s, key=key: on_all(d, s, key, 1.06), "4, gait")
        for key in (
            "cost of transport",
            "torque N m",
            "joint speed rad/s",
            "change of targets rad/s",
        )
    },
    "4 % on all robots": (lambda d, s: on_all(d, s, "torque N m", 1.04), ""),
    "on one": (lambda d, s: times(d, f"{s}-d", "torque N m", 1.16), "4, gait"),
    "14 % on one": (lambda d, s: times(d, f"{s}-d", "torque N m", 1.14), ""),
    "clearance on all": (
        lambda d, s: on_all(d, s, "clearance at 0.5 m/s cm", 1, -0.6),
        "4, gait",
    ),
    "clearance on one": (
        lambda d, s: times(d, f"{s}-h", "clearance at 0.5 m/s cm", 1, -1.1),
        "4, gait",
    ),
    "one that lifts no foot has none": (
        lambda d, s: d.played[f"{s}-h.0"].update({"clearance at 0.5 m/s cm": np.nan}),
        "",
    ),
    "slide": (lambda d, s: times(d, f"{s}-c", "slide m/s", 2.2), "4, gait"),
    "left": (lambda d, s: times(d, f"{s}-c", "left", 1.06), "4, gait"),
    "right": (lambda d, s: times(d, f"{s}-c", "left", 0.94), "4, gait"),
    "five policies fall": (lambda d, s: policies_that_fall(d, s, 5), "5, in C MuJoCo"),
    "four policies fall": (lambda d, s: policies_that_fall(d, s, 4), ""),
    "as many of deploy, but all of one robot": (
        lambda d, s: (policies_that_fall(d, "fresh-deploy", 5), times(d, f"{s}-h", "tours", 1, 2)),
        "5, in C MuJoCo",
    ),
    "once each": (
        lambda d, s: (policies_that_fall(d, "fresh-deploy", 5), times(d, f"{s}-h", "tours", 1, 1)),
        "",
    ),
    "the benchmark's task": (lambda d, s: times(d, f"{s}-d", "return", 0.989), "5, in C MuJoCo"),
    "the benchmark's task, less": (lambda d, s: times(d, f"{s}-d", "return", 0.991), ""),
}


@pytest.mark.parametrize("what", BROKEN)
def test_each_point_of_the_rule_for_hardware_can_fail_alone(what):
    """For either setting: then `:deploy` takes the other, or stays where both fail."""
    rule, (broken, point) = script("22_deploy/rule"), BROKEN[what]
    once = point == "1, equal steps"  # it is `deploy` that changes, so for both
    for setting in rule.SETTINGS:
        data = rule_runs()
        broken(data, setting)
        told = rule.told(data)
        found = {
            kind: [
                name
                for name, parts in rule.points(data, kind).items()
                if not all(m for m, _ in parts)
            ]
            for kind in rule.SETTINGS
        }
        other = next(kind for kind in rule.SETTINGS if kind != setting)
        assert found == {setting: [point] * bool(point), other: [point] * once}, told
        text = "".join(told[1 + told.index(f"{setting}:") :])
        assert f"  {point}: not met" in text or not point
        if once:
            assert told[-1] == "`:deploy` stays: " + ", and ".join(
                f"{kind} fails {point}" for kind in rule.SETTINGS
            )
        elif point and setting == "fresh-1024":
            assert told[-1] == "`:deploy` takes fresh-4096"
        else:
            assert told[-1] == "`:deploy` takes fresh-1024"
        assert not re.search(r": open$", "\n".join(told), re.M)


def test_the_rule_for_hardware_says_what_is_open_and_why_deploy_stays():
    rule = script("22_deploy/rule")
    both = "fresh-4096", "fresh-1024"

    def last(change_):
        data = rule_runs()
        change_(data)
        return rule.told(data)[-1]

    assert last(lambda d: d.jobs.pop("fresh-1024-c")) == (
        "open: fresh-1024 lacks 1, equal steps; 2, the end; 4, gait; 5, in C MuJoCo"
    )
    assert last(lambda d: d.jobs.pop("fresh-4096-c")) == "`:deploy` takes fresh-1024"
    for cut in (
        lambda d: [rows_of(d, "fresh-1024-g")[-1].update(iteration=1360)],
        lambda d: d.jobs.update({"fresh-1024-g": rows_of(d, "fresh-1024-g")[:-4]}),  # four seeds
        lambda d: [row.update(job="go1:deploy") for row in d.jobs["fresh-1024-g"]],
    ):
        assert last(cut).startswith("open: fresh-1024 lacks 1, equal steps;")
    assert last(lambda d: d.timed.clear()) == "open: fresh-1024 lacks 3, seconds"
    assert last(lambda d: d.played["fresh-deploy-h.3"].pop("torque N m")) == (
        "open: fresh-1024 lacks 4, gait"
    )
    assert last(lambda d: d.played["fresh-1024-h.3"].pop("tours")) == (
        "open: fresh-1024 lacks 5, in C MuJoCo"
    )
    # one that fails stays so, whatever is open; so does `:deploy`
    seconds_ = [BROKEN["seconds"][0], BROKEN["slide"][0]]
    assert last(lambda d: [seconds_[0](d, s) for s in both]) == (
        "`:deploy` stays: fresh-1024 fails 3, seconds, alone, and fresh-4096 fails 3, seconds, alone"
    )
    assert last(lambda d: [f(d, s) for s in both for f in seconds_]) == (
        "`:deploy` stays: fresh-1024 fails 3, seconds; 4, gait, and fresh-4096 fails 3, seconds; 4, gait"
    )

    def gone(data):
        for setting in both:
            seconds_[0](data, setting)
        data.played.clear()

    assert last(gone) == (
        "`:deploy` stays: fresh-1024 fails 3, seconds, and fresh-4096 fails 3, seconds"
    )


def test_the_rule_for_hardware_reads_what_its_scripts_print(tmp_path, capsys, monkeypatch):
    """Lines of gait.py, choose.py and benchmark.py, and a folder of 30_row_cost, or packed."""
    rule, data = script("22_deploy/rule"), rule_runs()
    files = [DEPLOY / name for name in ("gait.txt", "choose.txt", "slow_chosen.txt")]
    found = rule.printed(files)
    assert found["go1_deploy"][rule.CLEARANCE] == 6.41 and found["go1_deploy"]["left"] == 0.993
    assert {*rule.COSTS, rule.CLEARANCE, *rule.WITHIN} <= found["go2_deploy"].keys()
    assert {*rule.FALLS, "return"} <= found["slow40-d.1"].keys()
    file = tmp_path / "benchmark.txt"
    file.write_text("OUT/fresh-1024-g.0.npz fall_rate 0, return 41.2, return_std nan\n")
    found = rule.printed([file])["fresh-1024-g.0"]
    assert found["return"] == 41.2 and np.isnan(found["return_std"])
    folder = tmp_path / "seconds"
    folder.mkdir()
    for name, rows in data.timed.items():
        with (folder / f"{name}.csv").open("w", newline="") as out:
            writer = csv.DictWriter(out, [*rows[0]])
            writer.writeheader()
            writer.writerows(rows)
    packed_ = tmp_path / "seconds.csv.xz"
    script("27_few/table").pack(packed_, folder)
    for place in (folder, packed_):
        asked = [tmp_path, "--seconds", place, "--gait", file, "--benchmark", file]
        monkeypatch.setattr("sys.argv", ["rule.py", *map(str, asked)])
        rule.main()
        lines = capsys.readouterr().out.splitlines()
        assert (
            "    a whole Go1: 20.1 and 20.1 s, 1.00 times (0.99 to 1.01); after 20.0 s return"
            " 38.92 and 38.92, +0.00 (-2.09 to 2.09): met" in lines
        )
        assert lines[-1].startswith("open: fresh-1024 lacks 1, equal steps; 2, the end; 4, gait;")


def test_the_rule_for_hardware_has_the_numbers_of_its_page():
    rule, page = script("22_deploy/rule"), steps_page()
    assert rule.MARGIN == {"g": 1.0, "h": 1.0, "c": 0.7, "d": 0.7}
    assert "each by its margin (1.0, ANYmals 0.7)" in page
    assert (rule.LAST, rule.SEEDS, rule.POLICIES, rule.ONCE) == (3, 2, 4, 1)
    assert "at most two more of 20 seeds that fall in more than 1 %" in page
    assert "the 600 episodes of its last three evaluations" in page
    assert f"error there at most {rule.ERROR} m/s more" in page
    assert f"alone on a card): at most {rule.SLOWER} times the seconds" in page
    costs, one = (f"{100 * (x - 1):.0f} %" for x in rule.COST)
    assert f"each at most {costs} more in the mean, {one} on one robot" in page
    low, one = rule.LOW
    assert f"clearance at 0.5 m/s: at most {low} cm less in the mean, {one} on one robot" in page
    (_, slide), (left, right) = rule.WITHIN.values()
    assert f"slide at most {slide} m/s, left over right feet {left} to {right}" in page
    assert "at most four more of 20 policies fall at all" in page
    assert "the one of a robot that falls least at most once more" in page
    assert f"{100 * rule.LOSS:.0f} % less return on the benchmark's task" in page
    assert rule.SETTINGS == ("fresh-1024", "fresh-4096")


def test_the_bundled_policies_for_hardware_are_the_best_rows_of_their_file():
    """choose.txt has seeds of the highest returns; deploy.json names the best of them."""
    choose = script("22_deploy/choose")
    rows, ends = {}, {}
    for line in (EXPERIMENTS / "22_deploy/choose.txt").read_text().splitlines():
        name, text = line.split(maxsplit=1)
        rows[name] = {key: float(value) for key, value in map(str.split, text.split(", "))}
    with lzma.open(EXPERIMENTS / "22_deploy/deploy.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            if row["batch"] == "4":  # the last evaluation of a seed stays
                ends[f"{row['name']}.{int(row['seed']) - 710}"] = float(row["return"])
    for robot in paper.ROBOTS:
        mine = [name for name in rows if name.startswith(f"{robot}-bundled.")]
        seeds = sorted((name for name in ends if name.startswith(robot)), key=ends.get)
        assert len(seeds) == 5 and mine == seeds[::-1][: len(mine)]
        bundled = json.loads((ROOT / f"robots/{robot}/deploy.json").read_text())
        chosen = f"{robot}-bundled.{bundled['seed']}"
        assert chosen == choose.best({name: rows[name] for name in mine})[0]
        assert not sum(rows[chosen][kind] for kind in choose.FALLS)
        assert bundled["run_seed"] == 710 + bundled["seed"]


def test_a_seed_is_chosen_by_all_its_falls_and_then_by_its_error(monkeypatch):
    from dynappo.evaluate import changes, stress, trials

    choose = script("22_deploy/choose")
    row = lambda falls, error: {"falls": falls, "tracking_error": error}  # noqa: E731
    monkeypatch.setattr(stress, "run", lambda *_: [row(0, 0.1), row(8, None), row(1, 0.3)])
    walks = [{"fall": None, "tracking_error": 0.16, "yaw_error": 0.25}]
    walks += [{"fall": 0.5, "tracking_error": None, "yaw_error": None}]
    monkeypatch.setattr(trials, "run", lambda policy, player: ({"commands": walks}, None))
    told = {0: (1, 0), 1: (0, 2), 2: (0, 0)}
    monkeypatch.setattr(
        changes, "run", lambda _, seed: dict(zip(("falls", "start_falls"), told[seed], strict=True))
    )
    monkeypatch.setattr(changes, "tours", lambda _: [{"fell_at": []}, {"fell_at": [1.0, 4.0]}])
    found = choose.measure("go1")
    assert found.pop("error") == pytest.approx((0.2 + 0.16) / 2)
    assert found == {"stress": 9, "commands": 1, "worst": 0.25, "changes": 3, "tours": 2}
    rows = {
        name: dict.fromkeys(choose.FALLS, 0) | {kind: falls, "error": error}
        for name, kind, falls, error in (
            ("a", "changes", 1, 0.01),
            ("b", "tours", 1, 0.02),
            ("c", "stress", 0, 0.09),
            ("d", "commands", 2, 0.01),
            ("e", "stress", 0, 0.08),
        )
    }
    assert choose.best(rows) == ["e", "c", "a", "b", "d"]

"""25_humanoid: its tables and seconds."""

import json
import re

import numpy as np
from result_files import HUMANOID, cells, shows

from experiments import stats


def rows_on(page, heading=None):
    """Rows of the tables of a page of 25_humanoid, by their first cell; of a section alone."""
    text = (HUMANOID / f"{page}.md").read_text()
    if heading:
        text = text.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")]
    return {row[0]: row[1:] for row in lines if "---" not in row[0]}


def walks_in(text):
    """Lists of steps in a cell of walks: `2.58, 4.30; 2.70, never`."""
    return [part.split(", ") for part in text.split("; ")]


def test_the_tables_of_the_humanoid_are_those_of_its_runs(humanoid):
    """Ten seeds; what the model, and each part, is worth; how policies walk; the model's errors; what was
    tried before."""
    printed = humanoid.printed
    fresh = {tuple(row[:2]): row[2:] for row in printed["batch"]}
    page = rows_on("README", "Ten seeds")
    for label, key in (
        ("`best`", ("fresh", "`best`")),
        ("`ppo`", ("fresh", "`ppo`")),
        ("seeds 900 to 909: `best`", ("fresh-900", "`best`")),
        ("`ppo` with 8 minibatches", ("fresh-900", "`ppo`")),
    ):
        assert page.pop(label) == fresh[key], label
    assert len(page) == 1  # the head
    warp, own = fresh["fresh-warp", "`best`"], fresh["fresh-900", "`best`"]
    text = " ".join((HUMANOID / "README.md").read_text().split())
    assert f"after {warp[0]} M ({warp[1]}), on our kernel after {own[0].rstrip('0')}" in text
    runs = {row[0]: row[1:] for title in humanoid.table.PARTS for row in printed[title]}

    def agrees(name, walks, numbers):
        """`numbers`: m/s, rad/s and falls of the end; the script has more digits of each."""
        _, each, total, *ends = runs[name]
        bare, _, of = walks.partition(" in ")  # "never in 3.3 M"
        said = "never" if {*each.split(", ")} == {"never"} else each
        ends = [float(end.removesuffix(" %")) for end in ends]
        return bare == said and shows(numbers, *ends) and (not of or shows(of, float(total)))

    page = rows_on("README", "What the model is worth")
    for label, name in (
        ("the model, from the robots' last states", "control-last"),
        ("the simulator, from the last states, not counted", "control-simulator"),
        ("nothing, 5 epochs", "control-real4-5"),
        ("nothing, 15 epochs: as many updates", "control-real4-15"),
        ("24 real rows, 5 epochs", "control-real24-5"),
        ("24 real rows, 15 epochs", "control-real24-15"),
    ):
        assert agrees(name, *page.pop(label)), label
    assert page.pop("the model, from real rows drawn at random (`best`)") == [runs["whole"][1]]
    assert len(page) == 1
    names = [name for name in runs if name.startswith("control-")] + ["whole"]
    seeds = {name: len(runs[name][1].split(", ")) for name in names}
    assert len(seeds) == 7 and seeds.pop("whole") == 3 and {*seeds.values()} == {2}
    more = {name: {*runs[f"control-real{name}-15"][1].split(", ")} for name in (4, 24)}
    assert more == {4: {"never"}, 24: {"never"}}
    perfect, ours = (
        np.mean([float(x) for x in runs[name][1].split(", ")])
        for name in ("control-simulator", "control-last")
    )
    told = "With as many updates a G1 walks neither on 4 real rows, which may be too few by themselves, nor"
    told += " on 24 (two seeds each). That does not tell the model from the number of updates. A perfect"
    told += f" model would save {100 * (1 - perfect / ours):.0f} % more."
    assert told in text
    page = rows_on("parts", "What each part is worth")
    for label, name in (
        ("`best`", "whole"),
        ("8 of 24 rows real", "real8"),
        ("16 real", "real16"),
        ("two rounds", "rounds2"),
        ("one round", "rounds1"),
        ("no clean states, and the critic sees what the actor sees", "no-clean"),
        ("the critic alone", "critic"),
        ("the reward is predicted as a whole", "no-known"),
        ("no symmetry", "no-symmetry"),
    ):
        assert agrees(name, *page.pop(label)), label
    assert page.pop("the model predicts no falls") == ["never", "all fall"]
    assert runs["no-falls"][1:] == ["never, never, never", "1.68", "nan", "nan", "100.0 %"]
    assert len(page) == 1
    errors = {
        row[0].partition(" (")[0]: row[1:] for row in printed["1, 4, 20 predictions in a row"]
    }
    assert rows_on("parts", "The model's error").items() >= errors.items() and len(errors) == 6
    gait = {row[0]: row[1:] for row in printed["policy"]}
    page = rows_on("gait", "Measures")
    assert page.pop("policy")[:2] == ["strides /s", "at 1 m/s"] and page == gait
    before = {row[0]: row[1:] for row in printed["What was tried before"]}
    before |= {"deploy-930": runs["deploy-930"]}
    page = rows_on("tried")
    assert page.pop("run") and page == {k: v for k, v in before.items() if k[:4] != "lap-"}


def test_the_grid_of_ppo_on_the_humanoid_is_that_of_its_runs(humanoid):
    """Each cell of walks, in the table's order: of the left columns, then of the right ones."""
    runs = {row[0]: row[2].split(", ") for row in humanoid.printed["PPO's settings"]}
    names = """r128 base+u-base r512 h12 r1024 r2048 r4096 r8192 mb2 mb8+u-mb8 u-mb12 u-mb16+u-mb24 u-mb8gam97
        v-p512mb8+v-p512mb12 v-p1024mb8+v-p1024mb12 v-p1024h12mb8 v-p2048mb8+v-p2048mb12ep3
        ep3 ep8+u-ep8 ep10+ep15 kl2+kl3+kl6 gam95+gam97 lam9+lam98 ent5 h16+u-h16 h32 u-h16mb8 u-h16gam97
        u-h16lam98 u-mb12ep3 u-mb12ep8 u-mb12kl3+u-mb12kl6 v-p1024mb8kl6+v-p1024mb8g97 v-p1024mb8ep3"""
    names = [
        [name if name[:2] in ("u-", "v-") else f"z-{name}" for name in cell.split("+")]
        for cell in names.split()
    ]
    text = (HUMANOID / "ppo.md").read_text()
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")][2:]
    shown = [row[1] for row in lines] + [row[3] for row in lines]
    assert {len(row) for row in lines} == {4}
    for mine, cell in zip(names, shown, strict=True):
        assert walks_in(cell) == [runs[name] for name in mine], mine
    assert sorted(sum(names, [])) == sorted(runs)
    assert {len(walks) for walks in runs.values()} <= {2, 4}


def test_the_tables_of_the_humanoid_for_hardware_are_those_of_its_files(humanoid):
    """Runs under disturbances by name; `--stress` of g1; what is said of g1_deploy and of five seeds."""
    runs = {row[0]: row[2:] for row in humanoid.printed["For hardware"]}
    checked = 0
    for label, row in rows_on("hardware", "For hardware").items():
        if found := re.match(r"`(\w+)`", label):
            walks, total, *ends = row[3:]
            all_walks, all_steps, *all_ends, _ = runs[found[1]]
            said = "never" if {*all_walks.split(", ")} == {"never"} else all_walks
            assert walks == said and shows(total, float(all_steps)), label
            for mine, value in zip(ends, all_ends, strict=True):
                assert shows(mine, float(value)), label
            checked += 1
    assert checked == 14
    rows = [row for row in humanoid.table.read("tuning.csv.xz") if row["name"] == "deploy-700"]
    steps, errors, yaw_errors, falls = humanoid.table.evaluations(rows)
    walks = stats.reached_by_tracking(steps, errors, yaw_errors, falls).walks
    page = " ".join((HUMANOID / "hardware.md").read_text().split())
    (at,) = {*walks}
    before = steps[steps[:, 0] < at][-1, 0]
    assert (
        f"after {at / 1e6:.1f} M steps, and none does at that before, after {before / 1e6:.1f} M"
        in page
    )
    assert f"{errors[-1].mean():.2f} m/s and {yaw_errors[-1].mean():.2f} rad/s off" in page
    assert not falls[-1].any() and f"tracks worst ({errors[-1].max():.3f} m/s)" in page
    assert errors[-1].argmax() == 2  # seed 702, which is bundled
    told = {}
    for name in ("stress", "stress_deploy"):
        told[name] = json.loads((HUMANOID / f"results/{name}.json").read_text())["rows"]
    mine = {x["stress"]: f"{x['falls']}; {x['tracking_error']:.2f}" for x in told["stress"]}
    text = (HUMANOID / "hardware.md").read_text().split("## Disturbances")[1]
    lines = [cells(line) for line in text.splitlines() if line.startswith("|")][2:]
    shown = {row[k]: row[k + 1] for row in lines for k in (0, 2)}
    seen = []
    for label, names in (
        ("none; steps of 2 ms; other solvers and cones", None),
        ("actions, or sensors, 20 ms late", ["actions 20 ms late", "sensors 20 ms late"]),
        ("actions 0 to 40 ms late", ["actions 0 to 40 ms late"]),
        ("actions 40 ms late; both 20 ms late", ["actions 40 ms late", "both 20 ms late"]),
        ("noise of training", ["noise of training"]),
        ("steps of 10 ms", ["steps of 10 ms"]),
        ("friction 0.15, 0.3, 1.2", ["friction 0.15", "friction 0.3", "friction 1.2"]),
        ("5 kg more, less", ["5 kg more", "5 kg less"]),
        ("motors at 80, 120 %", ["motors at 80 %", "motors at 120 %"]),
        ("pushes of 0.5, 1 m/s", ["pushes of 0.5 m/s", "pushes of 1 m/s"]),
        ("its velocity read as zero, half", ["velocity read as zero", "velocity read as half"]),
        ("all together", ["all together"]),
    ):
        names = names or [
            "none",
            "steps of 2 ms",
            *(n for n in mine if "cone" in n or "solver" in n),
        ]
        asked = ", ".join(mine[name] for name in names)
        one = {mine[name] for name in names}
        assert shown.pop(label) in (asked, *(one if len(one) == 1 else ())), label
        seen += names
    assert not shown and sorted(seen) == sorted(mine)
    ours = {x["stress"]: x["falls"] for x in told["stress_deploy"]}
    assert len(ours) == 23 and {x: n for x, n in ours.items() if n} == {
        "pushes of 1 m/s": 1,
        "steps of 10 ms": 7,
    }
    rest = ours.keys() - {"pushes of 1 m/s", "steps of 10 ms"}
    fell = sum(x["falls"] for x in told["stress"] if x["stress"] in rest)
    assert f"falls {fell} times in these {len(rest)}" in page


def test_the_seconds_of_the_humanoid_are_those_of_its_runs(humanoid):
    """A row a line, from the runs alone on a card: where they walk, seconds, ms an iteration."""
    found = {}
    for engine, robots, seed, walks, seconds, ms in humanoid.printed["engine"]:
        found.setdefault((engine == "kernel", robots), {})[int(seed)] = walks, seconds, ms
    last = {}  # falls of the last evaluation, and after how many steps
    for engine, robots, rows in humanoid.table.runs_alone():
        told = f"{100 * float(rows[-1]['fall_rate']):.1f} %"
        steps = float(rows[-1]["sim_steps"]) / 1e6
        where = {(told, f"{steps:.{k}f} M") for k in (1, 2)} | {(told, "the end")}
        last.setdefault((engine == "kernel", robots), set()).update(where)
    page = rows_on("seconds", "Seconds")
    for label, own, name, seeds in (
        ("`best`, ten seeds (900 to 909)", True, "best", range(900, 910)),
        ("with 3 epochs and KL 0.04, seed 950", True, "best, 3 epochs", [950]),
        ("with 2 minibatches, seeds 950 to 954", True, "best, 2 minibatches", range(950, 955)),
        ("`ppo`, seeds 950, 951", True, "PPO, 256", [950, 951]),
        ("PPO, 8 minibatches, seed 900", True, "PPO, 512", [900]),
        ("PPO, 4 minibatches, seeds 900, 950, 951", True, "PPO, 1024", [900, 950, 951]),
        ("PPO, 12 rows, 8 minibatches, seeds 950 to 952", True, "PPO, 1024 x 12", range(950, 953)),
        ("the same, 3 epochs, seed 950", True, "PPO, 1024 x 12, 3 epochs", [950]),
        ("PPO, 12 rows, 8 minibatches, seed 950", True, "PPO, 2048 x 12", [950]),
        ("PPO, 4 minibatches, seed 900", True, "PPO, 4096", [900]),
        ("with MuJoCo Warp's own step: `best`, seeds 170 to 172", False, "best", range(170, 173)),
    ):
        some = [found[own, name][seed] for seed in seeds]
        _, walks, seconds, ms = page.pop(label)
        for falls, where in re.findall(r"([\d.]+ %) (?:falls )?at (the end|[\d.]+ M)", walks):
            assert (falls, where) in last[own, name], label
        for cell, column in ((walks, 0), (seconds, 1)):
            values = [run[column] for run in some if run[column] not in ("never", "-")]
            bare = re.sub(
                r"[\d.]+ % falls at (the end|[\d.]+ M)|; one falls .*|, -|; -|^-$", "", cell
            )
            bare = bare.strip(" ,;")
            ends = f"{min(values)} to {max(values)}" if values else ""
            once = [*dict.fromkeys(values)]
            assert bare in (ends, ", ".join(values), *(once if len(once) == 1 else ())), label
        assert shows(ms, np.mean([float(run[2]) for run in some])), label
    _, walks, seconds = page.pop("PPO, seed 170, evaluated two to five times: upper bounds")
    some = [found[False, f"PPO, {robots}"][170] for robots in (256, 512, 2048)]
    assert [walks, seconds] == ["; ".join(run[k] for run in some) for k in (0, 1)]
    assert len(page) == 1

"""04_laptop: a Go1 on two CPU cores."""

import json
import re

from result_files import EXPERIMENTS, cells, script

from experiments import paper


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

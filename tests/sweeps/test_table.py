"""What a sweep came to: its words."""

from rich.console import Console

from dynappo import config as config_lib
from dynappo.sweeps import folder, grid, table


def test_a_row_says_what_the_policies_do(tmp_path, monkeypatch, capsys):
    """In the words of a run's own summary; nothing where nothing was evaluated."""
    config = config_lib.validate(config_lib.load("configs/go1.py:laptop"))
    one = grid.Combination("ppo.epochs=3", {"ppo.epochs": 3}, config)
    walks = {"return": [40.0, 26.0], "fall_rate": [0.0, 0.04], "tracking_error": [0.1, 0.8]}
    walks["yaw_error"] = [0.1, 0.6]
    done = {"return": [9.0, 5.0], "seconds": [60.0, 60.0], "sim_steps": 1_720_000}
    rows = []
    for evaluation in ({"evaluation": walks}, {}):
        monkeypatch.setattr(folder, "summary", lambda *_, e=evaluation: done | e)
        rows += table.rows(tmp_path, [one])
    assert [row["return_mean"] for row in rows] == [33, 7]
    assert [row["fall_rate"] for row in rows] == [0.02, None]
    assert [row["policy"] for row in rows] == [
        "1 of 2 seeds walk; return < 38: 1; falls > 1 %: 1",
        "",
    ]
    table.print_table(Console(width=200), rows[:1], ["ppo.epochs"])
    head, line = capsys.readouterr().out.splitlines()
    assert head.strip().endswith("the policy")
    assert line.strip().endswith("1 of 2 seeds walk; return < 38: 1; falls > 1 %: 1")
    table.print_table(Console(width=80), rows[:1], ["ppo.epochs"])
    head, line, words = capsys.readouterr().out.splitlines()
    assert head.split() == "epochs seeds evaluated return falls steps seconds".split()
    assert line.split()[:3] == ["3", "1", "33.00"]
    assert words == "3: 1 of 2 seeds walk; return < 38: 1; falls > 1 %: 1"


def test_a_table_fits_eighty_columns_and_nothing_is_cut(capsys):
    """Also of three fields with long names, two of which end alike; words are lines of their own."""
    swept = ["task.weights.track_linear_velocity", "ppo.learning_rate", "model.learning_rate"]
    row = dict(seeds=10, return_mean=42.51, return_high=43.0, fall_rate=0.005, sim_steps=7.82e6)
    row |= dict(seconds=170.3, return_of="evaluation", policy="stands " * 20, note="")
    row |= dict(ranked_by=grid.BY_ERRORS, tracking_error=0.061)
    values = ((1.5, 3e-4, 1e-3), (9, 1, 1))
    rows = [row | dict(zip(swept, some, strict=True)) for some in values]
    table.print_table(Console(width=80), rows, swept)
    *lines, first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("1.5, 0.0003, 0.001: stands") and second.startswith("9, 1, 1: stands")
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)
    assert any("42.51 ± 0.49" in line and "7.82 M" in line for line in lines)

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
    narrow = capsys.readouterr().out
    assert (
        "evaluated return" in narrow and "seeds" in narrow and "falls" in narrow
    )  # only the words break

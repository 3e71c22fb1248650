"""What a sweep came to: its words."""

import io

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

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


def made_up(name, errors, falls=0.0, returns=(), walking=0, by=grid.BY_RETURN):
    """A row of a table with a number for each seed, as `table.row` makes it."""
    row = {"folder": name, "note": "", "ranked_by": by, "seeds": len(errors), "fall_rate": falls}
    row |= {"walking": walking}
    for what, values in (("tracking_error", errors), ("return", returns or errors)):
        low, high = None, None
        if len(values) > 1:
            low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
        row |= {f"{what}_low": low, f"{what}_high": high}
    return row


def test_a_difference_that_cannot_be_seen_is_not_called_one():
    """One seed each; seeds that mix; seeds that do not. Of errors, only between those that fall as seldom."""
    apart = [
        made_up("a", [0.1] * 3, returns=[40.0, 41.0, 42.0]),
        made_up("b", [0.1] * 3, returns=[9, 10, 11]),
    ]
    mixed = [apart[0], made_up("b", [0.1] * 3, returns=[30.0, 39.0, 44.0]), apart[1]]
    single = [made_up("a", [40.0]), made_up("b", [12.0])]
    said = [table.doubt(rows) for rows in (apart, mixed, single)]
    assert all(
        text.endswith("no seed walks yet, so even the first is not good enough") for text in said
    )
    assert said[0].startswith("no seed walks")
    assert said[1].startswith(
        "no difference can be seen between the first and 1 of the 2 others: the 95 % intervals of the return "
        "overlap; for more seeds: another --workdir with --config.run.num_seeds=6\n"
    )
    assert said[2].startswith("no difference can be seen: it takes two seeds of each, or more; for")
    for walking in (1, None):
        assert table.doubt([apart[0] | {"walking": walking}, apart[1] | {"walking": walking}]) == ""
    blown = {"note": "blew up", "walking": None}
    assert table.doubt([apart[0] | {"walking": 3}, blown]) == ""
    errors = [
        made_up("a", [0.1, 0.2], walking=1, by=grid.BY_ERRORS),
        made_up("b", [0.1, 0.21], 0.5),
    ]
    assert table.doubt(errors) == ""
    errors[1]["fall_rate"] = 0.01
    assert table.doubt(errors).startswith(
        "no difference can be seen between the first and the second: the"
    )


def test_a_row_has_intervals_and_how_many_seeds_walk(tmp_path, monkeypatch):
    """Student's of what combinations are ranked by; nothing of another package's task."""
    config = config_lib.load("configs/go1.py:laptop")
    errors, returns = [0.1, 0.14, 0.3], [40.0, 39.0, 26.0]
    done = {"return": 1.0, "evaluation": {"return": returns, "tracking_error": errors}}
    done["evaluation"] |= {"fall_rate": [0.0, 0.0, 0.2], "yaw_error": errors}
    monkeypatch.setattr(folder, "summary", lambda *_: done)
    (row,) = table.rows(
        tmp_path, [grid.Combination("a", {"ppo.epochs": 3}, config_lib.validate(config))]
    )
    for name, values in (("return", returns), ("tracking_error", errors)):
        low, high = stats.t.interval(0.95, 2, np.mean(values), stats.sem(values))
        assert (row[f"{name}_low"], row[f"{name}_high"]) == pytest.approx((low, high))
    assert row["walking"] == 2
    config.robot, config.env = "", "playground:Go1JoystickFlatTerrain"
    theirs = grid.Combination("a", {"ppo.epochs": 3}, config_lib.validate(config))
    (row,) = table.rows(tmp_path, [theirs])
    assert row["walking"] is None and row["policy"] == ""
    out = Console(width=200, record=True, file=io.StringIO())
    table.print_table(out, [row | {"sim_steps": 1.0}], ["ppo.epochs"])
    assert "the policy" not in out.export_text()


def test_on_rough_ground_the_first_crosses_most(tmp_path, monkeypatch, capsys):
    """A return that is higher because robots do not arrive is behind; of equal shares the return decides."""
    config = config_lib.load("configs/go2.py:rough")
    crossed = {"a": ([0.5, 0.52], 30.0), "b": ([0.9, 0.8], 12.0), "c": ([0.8, 0.9], 13.0)}

    def summary(_, one):
        shares, high = crossed[one.name]
        found = {"return": [high, high], "tracking_error": [0.1, 0.1], "crossed": shares}
        found |= {"fall_rate": [0.1, 0.1], "yaw_error": [0.1, 0.1]}
        return {"return": 1.0, "sim_steps": 1e6, "evaluation": found}

    monkeypatch.setattr(folder, "summary", summary)
    each = [grid.Combination(x, {"ppo.epochs": 3}, config_lib.validate(config)) for x in crossed]
    rows = table.rows(tmp_path, each)
    assert [row["folder"] for row in rows] == ["c", "b", "a"]
    low, high = stats.t.interval(0.95, 1, 0.85, stats.sem([0.8, 0.9]))
    assert (rows[0]["crossed_low"], rows[0]["crossed_high"]) == pytest.approx((low, high))
    assert "the 95 % intervals of the tiles crossed overlap" in table.doubt(rows)
    table.print_table(Console(width=120), rows, ["ppo.epochs"])
    head, first, *_ = capsys.readouterr().out.splitlines()
    assert "crossed" in head.split() and "85.0 %" in first
    # of an older version, which did not say what was crossed: some, then all
    for shares, _ in (crossed["b"], crossed["c"]):
        shares[:] = [None, None]
    some = table.rows(tmp_path, each)
    assert [row["folder"] for row in some][0] == "a" and table.doubt(some).startswith("no seed")
    crossed["a"][0][:] = [None, None]
    old = table.rows(tmp_path, each)
    assert {row["ranked_by"] for row in old} == {grid.BY_RETURN}
    assert [row["return_mean"] for row in old] == [30, 13, 12]


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

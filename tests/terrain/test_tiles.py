"""The rough ground: each kind of tile against plain loops, point by point; seeds, rows, its picture."""

import functools
import re

import numpy as np
import pytest
from answers import mistake, status

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.look import command as look_command
from dynappo.terrain import height_map, tiles

MIDDLE = 40  # the cell in the middle of a tile of 8 m


def group(**fields):
    config = config_lib.load("configs/anymal_c.py:ppo16")
    config.task.tiles.update(fields)
    return config_lib.validate(config).task.tiles


def one(kind, hard, seed=0, **fields):
    """A tile, [81, 81] m."""
    return tiles.tile(group(**fields), kind, hard, np.random.default_rng(seed))


def edge(i, j):
    """Cells from the nearest edge."""
    return min(i, 80 - i, j, 80 - j)


def loop(height):
    """`height(cells from the nearest edge)` of every point."""
    return np.array([[height(edge(i, j)) for j in range(81)] for i in range(81)])


@pytest.mark.parametrize(("kind", "sign"), [("pyramid_stairs", 1), ("pit_stairs", -1)])
@pytest.mark.parametrize(("hard", "step"), [(0.0, 0.05), (0.5, 0.14), (1.0, 0.23)])
def test_stairs_rise_by_a_step_every_tread_up_to_the_platform(kind, sign, hard, step):
    def height(cells):
        stairs = (
            0  # the first riser is 10 cells from the edge, the others 3 cells on; the sixth at 25
        )
        for k in range(6):
            stairs += cells >= 10 + 3 * k
        return sign * stairs * step

    np.testing.assert_allclose(one(kind, hard), loop(height), atol=1e-6)


@pytest.mark.parametrize(("kind", "sign"), [("pyramid_slope", 1), ("pit_slope", -1)])
@pytest.mark.parametrize(("hard", "rise"), [(0.0, 0.0), (1.0, 0.4)])
def test_slopes_rise_from_the_margin_to_the_platform(kind, sign, hard, rise):
    found = one(kind, hard)
    expected = loop(lambda cells: sign * rise * min(max(cells * 0.1 - 0.25, 0), 2.75))
    np.testing.assert_allclose(found, expected, atol=0.0026)  # half of a step of heights


def test_boxes_are_columns_of_one_height_each_around_a_platform():
    found, heights = one("boxes", 1.0), {}
    for i in range(81):
        for j in range(81):
            if edge(i, j) < 3:
                assert found[i, j] == 0
            elif edge(i, j) >= 30:
                assert found[i, j] == pytest.approx(0.2)
            else:
                heights.setdefault((int(i / 4.5), int(j / 4.5)), set()).add(found[i, j])
    assert all(len(values) == 1 for values in heights.values()) and len(heights) > 200
    spread = np.array([*map(min, heights.values())])
    assert -0.2 <= spread.min() < -0.19 and 0.19 < spread.max() <= 0.2 and abs(spread.mean()) < 0.02
    assert abs(one("boxes", 0.0)).max() == pytest.approx(0.05)


def test_random_ground_has_each_of_its_heights_alike_in_every_row():
    found = one("random", 0.3)
    inside = found[loop(lambda cells: cells >= 3).astype(bool)]
    values, counts = np.unique(np.round(inside, 6), return_counts=True)
    np.testing.assert_allclose(values, [0.02, 0.04, 0.06, 0.08, 0.10], atol=1e-6)
    assert abs(counts / inside.size - 0.2).max() < 0.02
    np.testing.assert_array_equal(found, one("random", 1.0))


@pytest.mark.parametrize("kind", tiles.KINDS)
def test_a_tile_is_0_at_its_edges(kind):
    """Also without a margin; else walls a cell wide would stand between tiles. Inside nothing changes."""
    found = one(kind, 1.0, margin=0.0, stairs_border=0.0)
    outer = loop(lambda cells: cells == 0).astype(bool)
    assert (found[outer] == 0).all() and (found[~outer] != 0).mean() > 0.5
    if kind == "pyramid_stairs":
        np.testing.assert_allclose(found[1, 1:-1], 0.23, atol=1e-6)  # the first step


def test_the_map_puts_the_tiles_in_rows_by_difficulty_and_columns_by_kind():
    t = group(rows=3, columns=6, shares=(1.0,) * 6)
    ground, middles = tiles.make(t), tiles.centres(t)
    assert ground.heights.dtype == np.float32 and ground.heights.shape == (281, 521)
    assert ground.corner == (-14.0, -26.0) and tiles.kinds(t).tolist() == [0, 1, 2, 3, 4, 5]
    for row, hard in enumerate((0.0, 0.5, 1.0)):
        for column, kind in enumerate(tiles.KINDS):
            i, j = 20 + 80 * row, 20 + 80 * column
            rng = np.random.default_rng((0, row, column))
            expected = tiles.tile(t, kind, hard, rng)
            np.testing.assert_array_equal(
                ground.heights[i : i + 81, j : j + 81], expected.astype(np.float32)
            )
            x, y = middles[row, column]
            assert (x, y) == (8 * (row - 1), 8 * (column - 2.5))
            at = height_map.height(*ground, np.array(x), np.array(y))
            assert at == pytest.approx(expected[MIDDLE, MIDDLE], abs=1e-6)
    border = ground.heights[:20], ground.heights[-20:], ground.heights[:, :20]
    assert all((part == 0).all() for part in border)


def test_a_map_is_its_seeds_and_a_tile_does_not_depend_on_how_many_there_are():
    make = functools.partial(group, columns=4, shares=(0.0, 0.0, 0.5, 0.5, 0.0, 0.0))
    first, again, other = (tiles.make(make(rows=2, seed=s)).heights for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    # without the last edge, which the next tile shares at height 0 anyway
    np.testing.assert_array_equal(first[:101], tiles.make(make(rows=1)).heights[:101])


def test_isaac_labs_columns_and_rows_are_the_defaults():
    t = group()
    assert np.bincount(tiles.kinds(t)).tolist() == [4, 4, 4, 4, 2, 2]
    np.testing.assert_allclose(tiles.difficulty(t), np.arange(10) / 9)
    ground = tiles.make(t)
    assert ground.heights.shape == (841, 1641)
    assert ground.heights.max() == pytest.approx(6 * 0.23)


@pytest.mark.parametrize(
    ("fields", "rule"),
    [
        (dict(size=8.05), r"task.tiles.size is 8.05, expected a multiple of task.tiles.cell = 0.1"),
        (dict(shares=(0.0,) * 6), "task.tiles.shares is .* one or more above 0"),
        (dict(stairs_platform=7.0), "task.tiles.stairs_platform is 7.0, expected at most 6, "),
        (dict(stairs_border=4.0), "expected at most 0, .* twice task.tiles.stairs_border = 4"),
        (dict(margin=4.0), "task.tiles.platform is 2.0, .* less twice task.tiles.margin = 4"),
        (dict(box_width=1e-9), "task.tiles.box_width is 1e-09, expected 0.01 to 100"),
        (dict(slope=(0.0, 50.0)), "task.tiles.slope is .*, expected 0 to 10"),
        (dict(stairs=(0.2, 0.1)), r"task.tiles.stairs is .*, expected \(low, high\)"),
        (
            dict(random_step=0.03),
            r"random_step is 0.03, expected one that divides .* \(0.02, 0.1\)",
        ),
        (
            dict(random=(0.0, 0.05), random_step=10.0),
            "task.tiles.random_step is 10.0, expected one that",
        ),
        (
            dict(
                cell=0.01,
                rows=1,
                columns=1,
                size=2.0,
                border=100.0,
                stairs_border=0.0,
                stairs_platform=1.0,
                platform=1.0,
            ),
            "task.tiles.cell is 0.01, expected at most 100 million cells: .* its border around all, are 408",
        ),
        (dict(cell=0.01, rows=100, columns=100), "task.tiles.cell is 0.01, expected at most 100 "),
    ],
)
def test_a_ground_that_cannot_be_made_is_refused(fields, rule):
    with pytest.raises(ConfigError, match=rule):
        group(**fields)


def test_look_draws_the_ground(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    out = tmp_path / "ground.png"
    small = ["--config.task.tiles.rows=2", "--config.task.tiles.columns=6"]
    look = functools.partial(status, look_command.main)
    assert look("go2:rough", *small, f"--ground={out}") == 0
    assert re.search("^ground .*: 2 x 6 tiles of 8 m", capsys.readouterr().out, re.M)
    assert out.stat().st_size > 5000
    said = mistake(look_command.main, ["go2", f"--ground={out}"], capsys)
    assert "task.terrain is 'flat'" in said

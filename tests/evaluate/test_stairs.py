"""Stairs made of boxes: where they are, the map that is seen of them, and who climbs."""

import mujoco
import numpy as np
import pytest

from dynappo.evaluate import stairs, tables
from dynappo.evaluate.stress import Stress
from dynappo.policy import policy_source
from dynappo.terrain import height_map


@pytest.fixture(scope="module")
def walker():
    """The bundled Go2, which knows no stairs, before steps of 2 cm."""
    policy, _ = policy_source.load("go2")
    return stairs.player(policy, 0.02)


def test_boxes_and_map_are_the_same_stairs(walker):
    """The highest box at a point is as high as the map says, but at the walls."""
    model = walker.model
    standing = walker.ground & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    assert standing.sum() == 6 and (model.geom_contype[standing] > 0).all()
    boxes = [*zip(model.geom_pos[standing], model.geom_size[standing], strict=True)]
    for x in np.arange(-0.95, 5.9, 0.1):
        here, front = np.floor((x - 1) / 0.3 + 1e-6) + 1, (x - 1) % 0.3
        expected = 0.02 * min(max(here, 0), 6)
        tops = [geom_pos[2] + size[2] for geom_pos, size in boxes if abs(x - geom_pos[0]) < size[0]]
        assert max(tops, default=0.0) == pytest.approx(expected, abs=1e-6)
        if not 0.19 < front < 0.31 or not 0 < here < 6:
            seen = height_map.height(*walker.field, np.array(x), np.array(1.0))
            assert seen == pytest.approx(expected, abs=0.011)


def test_a_robot_climbs_low_steps_falls_on_high_ones_and_is_late_where_it_is_slow(
    walker, monkeypatch
):
    none = Stress("none")
    assert stairs.attempt(walker, none, 0.8, -0.1)[0] == "climbed"
    high = stairs.player(walker.policy, 0.18)
    end, bumped = stairs.attempt(high, none, 0.8, 0.0)
    assert end in ("fell", "late") and bumped
    monkeypatch.setattr(stairs, "SECONDS", 1.0)
    before = walker.model.geom_pos.copy()
    assert stairs.attempt(walker, none, 0.5, -0.2)[0] == "late"
    np.testing.assert_array_equal(walker.model.geom_pos, before)


def test_the_table_has_a_row_a_disturbance_and_no_scan_for_the_blind(walker, monkeypatch, capsys):
    from rich.console import Console

    monkeypatch.setattr(
        stairs,
        "attempt",
        lambda one, case, *how, seed: ("climbed" if seed % 2 else "fell", seed == 1),
    )
    rows = stairs.run(walker.policy)
    assert [row["stress"] for row in rows] == ["none", "actions 20 ms late", "friction 0.4"]
    assert rows[0]["heights"] == [0.05, 0.095, 0.14, 0.185]
    assert rows[0]["climbed"] == rows[0]["falls"] == [3] * 4 and rows[0]["tries"] == 6
    assert rows[0]["bumped"] == [1] * 4
    tables.stairs(Console(width=120), rows)
    out = capsys.readouterr().out
    assert "0.095 m" in out and "3, 3, 1" in out


def test_a_flight_has_steps(walker, monkeypatch, capsys):
    """A biped's range begins at 0 m, which is no step; and where no tile has steps there is no flight."""
    from rich.console import Console

    monkeypatch.setattr(stairs, "attempt", lambda *_, seed: ("climbed", False))
    task = walker.policy.config["task"]

    def run(low, high):
        tiles = task.get("tiles", {}) | {"stairs": [low, high]}
        return stairs.run(walker.policy._replace(config={"task": task | {"tiles": tiles}}))

    rows = run(0.0, 0.15)
    assert rows[0]["heights"] == [0.037, 0.075, 0.112] and rows[0]["climbed"] == [6] * 3
    assert run(0.1, 0.1)[0]["heights"] == [0.1]
    capsys.readouterr()
    tables.stairs(Console(width=120), run(0.0, 0.0))
    assert capsys.readouterr().out == ""


def test_what_ends_a_try_is_the_base_alone(walker):
    model, fatal = walker.model, stairs.base(walker)
    bodies = {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b) for b in model.geom_bodyid[fatal]
    }
    others = {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b)
        for b in model.geom_bodyid[walker.parts & ~fatal]
    }
    assert bodies == {"base"} and {"FL_calf", "RR_thigh"} <= others

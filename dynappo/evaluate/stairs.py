"""Sim-to-sim on stairs: flights of plain boxes in C MuJoCo, where training had a height field.

`COUNT` steps go up ahead of the robot, to a landing. The policy sees the map of them that a height field
would be, whose walls are a cell wide; the walls of the boxes are upright. It is told to walk ahead, at
`SPEEDS` and from `STARTS`, and climbs if it gets onto the landing within `SECONDS` and without a fall. A line
of the table is a disturbance (stress.py), a column a height of the steps, in the range of the policy's
`task.tiles.stairs`.

A fall is the base at the ground, as in Isaac Lab's rough tasks. In training a shank or thigh there ends an
episode too, because the kernels of physics let it through; here the step holds it, so the robot can go on.
Such tries are counted apart: `bumped`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

from dynappo.evaluate import stress
from dynappo.evaluate.stress import Stress
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file, policy_source
from dynappo.policy.episode import Box, Player
from dynappo.policy.policy_file import Policy
from dynappo.tasks.velocity import observe
from dynappo.terrain.height_map import HeightMap

COUNT, FIRST = 6, 1.0  # steps; m, from the start to the first
LANDING, WIDE, OVER = 4.0, 3.0, 0.5  # m: its length, half of the width, how far onto it is climbed
SECONDS, SPEEDS, STARTS = 15.0, (0.5, 0.8), (0.0, -0.1, -0.2)  # s; m/s; m
# shares of the range, whose lower end is 0 for bipeds: those are no steps
HEIGHTS = 0.0, 0.25, 0.5, 0.75
TABLE = (
    Stress("none"),
    Stress("actions 20 ms late", action_delay=0.02),
    Stress("friction 0.4", friction=0.4),
    Stress("scan 5 cm ahead", scan_shift=(0.05, 0.0, 0.0)),
    Stress("scan 5 cm behind", scan_shift=(-0.05, 0.0, 0.0)),
    Stress("scan 5 cm higher", scan_shift=(0.0, 0.0, 0.05)),
    Stress("all together", action_delay=0.02, friction=0.4, scan_shift=(0.05, 0.0, 0.0)),
)


def flight(height: float, tread: float) -> tuple[Box, ...]:
    """The boxes of a flight whose steps are so high and deep (m); each reaches to the end of the landing."""
    end = FIRST + (COUNT - 1) * tread + LANDING
    fronts = FIRST + tread * np.arange(COUNT)
    return tuple(
        Box(
            ((front + end) / 2, 0.0, (k + 0.5) * height),
            ((end - front) / 2, WIDE, height / 2),
        )
        for k, front in enumerate(fronts.tolist())
    )


def seen(height: float, tread: float, cell: float) -> HeightMap:
    """The map of the flight: at each point the height of the highest box there."""
    end = FIRST + (COUNT - 1) * tread + LANDING
    x, y = (np.arange(round(size / cell) + 1) * cell for size in (end + 2, 2 * WIDE))
    steps = np.clip(np.floor((x - 2 - FIRST) / tread + 1e-6) + 1, 0, COUNT)
    heights = np.repeat((height * steps)[:, None], len(y), 1).astype(np.float32)
    return HeightMap(heights, cell, (-2.0, -WIDE))


def player(policy: Policy, height: float) -> Player:
    """The policy's robot before a flight."""
    own, _ = policy_source.robot(policy)
    tiles = policy_source.tiles(policy)
    field, boxes = seen(height, tiles.tread, tiles.cell), flight(height, tiles.tread)
    return episode_lib.load(
        own.xml, policy, policy.timestep, text=own.played, field=field, boxes=boxes
    )


def base(one: Player) -> np.ndarray:
    """[ngeom] bool: the parts of the base alone."""
    return one.parts & (one.model.geom_bodyid == one.base_body)


def run(
    policy: Policy, tell: Callable[[int, int], None] = lambda done, total: None
) -> list[dict[str, Any]]:
    """The rows: `stress`, `heights` (m) and, for each, how many of `tries` were `climbed`, `falls`, and
    `bumped`. None where the policy's tiles have no steps."""
    low, high = policy_source.tiles(policy).stairs
    each = [round(low + (high - low) * share, 3) for share in HEIGHTS]
    heights = [height for height in dict.fromkeys(each) if height > 0]
    if not heights:
        return []
    players, out = [player(policy, height) for height in heights], []
    for case in TABLE:
        if case.scan_shift != (0.0, 0.0, 0.0) and policy.scan == "none":
            continue
        tell(len(out), len(TABLE))
        found = [tries(stress.disturbed(one, case), case) for one in players]
        counts = zip(
            ("climbed", "falls", "bumped"), map(list, zip(*found, strict=True)), strict=True
        )
        tried = len(SPEEDS) * len(STARTS)
        out.append(dict(stress=case.name, heights=heights, tries=tried) | dict(counts))
    tell(len(TABLE), len(TABLE))
    return out


def tries(one: Player, case: Stress) -> tuple[int, int, int]:
    """`(climbed, falls, bumped)` of all speeds and starts."""
    hows = itertools.product(SPEEDS, STARTS)
    ends, bumps = zip(
        *(attempt(one, case, *how, seed=i) for i, how in enumerate(hows)), strict=True
    )
    return ends.count("climbed"), ends.count("fell"), sum(bumps)


def attempt(
    one: Player, case: Stress, speed: float, start: float, seed: int = 0
) -> tuple[str, bool]:
    """How one try ends, "climbed", "fell" or "late", and whether a part but the base touched a step."""
    policy, data = one.policy, mujoco.MjData(one.model)
    act, q = policy_file.actor(policy.params, policy.activation), one.root[0]
    tiles, (low, high) = policy_source.tiles(policy), policy.command_yaw
    w = slice(q + 3, q + 7)
    goal = FIRST + (COUNT - 1) * tiles.tread + OVER - start
    gain = policy.config.get("task", {}).get("heading_gain", 0.5)

    def ahead(t):  # and straight on, as a heading command is
        return np.array(
            [speed, 0.0, np.clip(-gain * float(observe.heading(data.qpos[w])), low, high)]
        )

    field = one.field
    assert field is not None
    # the robot begins at x = 0, so a start is a shift of the stairs
    corner = field.corner[0] - start, field.corner[1]
    shifted = one._replace(field=field._replace(corner=corner), parts=base(one))
    model, limbs, bumped = shifted.model, one.parts & ~shifted.parts, False
    standing = np.flatnonzero(one.ground & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX))
    before = model.geom_pos[standing, 0].copy()
    model.geom_pos[standing, 0] = before - start
    rows: Iterator[Any] = stress.disturbed_rows(shifted, act, ahead, data, case, seed)
    try:
        for row in itertools.islice(rows, round(SECONDS / episode_lib.period(one))):
            pairs = data.contact.geom[data.contact.dist < 0]
            bumped |= bool((limbs[pairs].any(-1) & one.ground[pairs].any(-1)).any())
            if row["fell"]:
                return "fell", bumped
            if np.asarray(row["qpos"])[q] > goal:
                return "climbed", bumped
    except FloatingPointError:
        return "fell", bumped
    finally:
        model.geom_pos[standing, 0] = before
    return "late", bumped

"""`kernels.keep` on ground that is not flat: heights of feet and parts from their probes (contacts.py)."""

# Warp compiles these functions; for Python its arrays cannot be indexed
# pyright: reportIndexIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.description import contacts
from dynappo.physics.warp import arrays, kernels, native

_HEADER = native.code({}, "ground")


# ground: arrays.map_numbers; probes: `table`; k: a row of them; place and turn: of its geom
@wp.func_native(_HEADER + "return probe_above(ground.data, probes.data + 8 * k, turn, place);")
def _part(
    ground: wp.array[float], probes: wp.array2d[float], k: int, place: wp.vec3, turn: wp.mat33
) -> float: ...


@wp.func_native(
    _HEADER
    + """
    const float* g = probes.data + 8 * k;
    vec3 up;
    return nearest(ground.data, probe_point(g, turn, place), g[6], up) - g[6];
    """
)
def _foot(
    ground: wp.array[float], probes: wp.array2d[float], k: int, place: wp.vec3, turn: wp.mat33
) -> float: ...


def table(of: contacts.Probes) -> np.ndarray:
    """[P, 8] place, axis of the ring, radius, ring, in the frame of the geom."""
    axis = np.broadcast_to([0.0, 0.0, 1.0], of.place.shape)
    return np.column_stack([of.place, axis, of.radius, of.ring]).astype(np.float32)


def arguments(mj_model, shape: arrays.Shape) -> list[Any]:
    """The first arguments of `keep` but `every`, `substep` and `last`."""
    feet = contacts.probes(mj_model, shape.feet, between=False)
    parts = contacts.probes(mj_model, shape.parts)
    foot_of = np.searchsorted(shape.first, feet.geom, side="right") - 1
    starts = [
        np.searchsorted(of, np.arange(count + 1))
        for of, count in ((foot_of, len(shape.first) - 1), (parts.geom, len(shape.parts)))
    ]
    assert shape.ground is not None
    return [
        wp.array(arrays.map_numbers(shape.ground), dtype=float),
        *(
            wp.array(x, dtype=kind)
            for probes, geoms, first in (
                (feet, shape.feet, starts[0]),
                (parts, shape.parts, starts[1]),
            )
            for x, kind in ((first, int), (geoms[probes.geom], int), (table(probes), float))
        ),
    ]


@wp.kernel
def keep(
    every: int,  # 1: parts in every physics step, 0: only in the last
    substep: int,
    last: int,
    ground: wp.array[float],
    first: wp.array[int],  # [F + 1] where each foot's probes begin
    feet: wp.array[int],  # the geom of each
    soles: wp.array2d[float],
    first_of_part: wp.array[int],  # [G + 1], and the same of the parts
    parts: wp.array[int],
    probes: wp.array2d[float],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    air_steps: wp.array2d[int],
    contact_steps: wp.array2d[int],
    last_air_steps: wp.array2d[int],
    peak: wp.array2d[float],
    last_peak: wp.array2d[float],
    lowest: wp.array2d[float],
):
    """The feet's timers and heights, and the parts' heights above the ground."""
    robot, i = wp.tid()
    count = first.shape[0] - 1
    height = wp.float32(wp.inf)
    if i < count:
        for k in range(first[i], first[i + 1]):
            sole = _foot(ground, soles, k, geom_xpos[robot, feet[k]], geom_xmat[robot, feet[k]])
            if not (sole >= height):  # not `min`, which would lose what is no number
                height = sole
        kernels.foot(robot, i, height, air_steps, contact_steps, last_air_steps, peak, last_peak)
        return
    if every == 0 and substep < last:
        return
    part = i - count
    for k in range(first_of_part[part], first_of_part[part + 1]):
        at = _part(ground, probes, k, geom_xpos[robot, parts[k]], geom_xmat[robot, parts[k]])
        if not (at >= height):
            height = at
    if every == 0 or substep == 0 or not (height >= lowest[robot, part]):
        lowest[robot, part] = height

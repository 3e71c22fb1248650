"""The ground: a plane at height 0 of the world, or a height map (terrain/height_map.py).

All JAX code of task and engines asks here how high a point is above the ground, and how high to place one.
On flat ground (`None`) the answer is the point's own height, and nothing is computed for it.

On a height map MuJoCo's floor is a `hfield` of the same triangles. What this project measures itself:

- a foot is down where a sphere of it is in the nearest triangle (`height_map.nearest`), as deep as its
  contact; in the air its height is the distance from the nearest triangle of the cells below it. Spheres of a
  capsule are its two ends, and its kernel's contacts; of a box and a cylinder, points
- a part is as high as the lowest of its probes (contacts.py) above the plane of the triangle below each
  (`height_map.gap`)

Both are the lowest point's height where the map is flat.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.description import contacts, motors
from dynappo.description import robot as robot_lib
from dynappo.terrain import height_map, map_file
from dynappo.terrain import tiles as tiles_lib
from dynappo.terrain.height_map import HeightMap

# x and y [..., 2] (m, in the world) of the points; a function, so that flat ground computes nothing
Place = Callable[[], Any]
THICK = 0.2  # m, of MuJoCo's height field below its lowest point
BORDER = 2.0  # m; a robot whose base is still on the map touches nothing that far outside
DRAWN = 300_000  # triangles of a mesh that is drawn in its place
# where it matters that there is a height map, and not which: a model of all tiles takes half a second
SOME = HeightMap(np.zeros((2, 2), np.float32), 1.0, (0.0, 0.0))


def height_above(z, place: Place | None, ground: HeightMap | None = None):
    """Heights [...] (m) above the ground of points at the heights `z` [...] in the world."""
    return z if ground is None else z - _height(place, ground)


def world_height(above, place: Place | None, ground: HeightMap | None = None):
    """Heights [...] (m) in the world of points that are so high `above` [...] the ground."""
    return above if ground is None else above + _height(place, ground)


def _height(place: Place | None, ground: HeightMap):
    assert place is not None
    xy = place()
    return height_map.height(*ground, xy[..., 0], xy[..., 1])


def feet_above(probes: contacts.Probes, ground: HeightMap, place, turn):
    """Heights [..., S] (m) of the feet's shapes at `place` [..., S, 3], with the rotations `turn` [..., S, 3,
    3]: the distance of the lowest of their probes from the nearest triangle; below 0 where it touches."""
    points = contacts.probe_points(probes, place, turn)
    distance, _ = height_map.nearest(*ground, points, probes.radius)
    return _of_geoms(probes, distance - probes.radius)


def parts_above(probes: contacts.Probes, ground: HeightMap, place, turn):
    """As `feet_above`, of parts [..., G]: above the planes of the triangles below their probes."""
    points = contacts.probe_points(probes, place, turn)
    return _of_geoms(probes, height_map.gap(*ground, points, probes.radius))


def _of_geoms(probes: contacts.Probes, heights):
    if not len(probes.geom):
        return heights
    return heights[..., contacts.of_each_foot(probes.geom)].min(-1)


def model(robot: robot_lib.Robot, physics, ground: HeightMap | None) -> mujoco.MjModel:
    """`robot.physics_model` on this ground."""
    if ground is None:
        return robot_lib.physics_model(robot, physics)
    spec = robot_lib.physics_spec(robot.xml, robot.text)
    put(spec, ground)
    made = robot_lib.with_settings(spec.compile(), physics, robot.parts)
    motors.set_armature(made, np.arange(6, made.nv), robot.mj_model.dof_armature[6:])
    return made


def put(spec: mujoco.MjSpec, ground: HeightMap | None) -> None:
    """Make the geom `floor` a height field, with the same friction and all else; nothing for `None`."""
    if ground is None:
        return
    ground = _with_border(ground)
    heights, low = ground.heights, float(ground.heights.min())
    half = [ground.cell * (count - 1) / 2 for count in heights.shape]
    rise = max(float(heights.max()) - low, 1e-3)  # MuJoCo wants one; a flat map has only zeros
    spec.add_hfield(
        name="floor",
        nrow=heights.shape[1],
        ncol=heights.shape[0],
        size=[*half, rise, THICK],
        userdata=heights.T.ravel(),  # rows are along y
    )
    floor = spec.geom("floor")
    floor.type, floor.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, "floor"
    floor.pos = [c + h for c, h in zip(ground.corner, half, strict=True)] + [low]
    floor.quat = [1, 0, 0, 0]


def _with_border(ground: HeightMap) -> HeightMap:
    """`ground` with its edges going on, as `height_map.height` has them: MuJoCo has nothing beyond its height
    field, and tiles may end where the map does. A map that is flat there is left as it is, to the bit: with
    the default border that is outside all tiles."""
    count = int(np.ceil(BORDER / ground.cell - 1e-6))
    outer = ground.heights.copy()  # of it only the outermost heights
    outer[count:-count, count:-count] = first = outer[0, 0]
    if (outer == first).all():
        return ground
    x, y = (c - count * ground.cell for c in ground.corner)
    return HeightMap(np.pad(ground.heights, count, mode="edge"), ground.cell, (x, y))


def draw(spec: mujoco.MjSpec, ground: HeightMap) -> None:
    """As `put`, for pictures alone: the geom `floor` is a mesh of the same surface, without rows and columns
    of the map that change nothing. That halves the time of a frame."""
    points, faces = height_map.triangles(ground)
    if len(faces) > DRAWN:
        return put(spec, ground)
    corners = points[faces].astype(float).ravel()  # each face its own, so that no edge is rounded
    mesh = spec.add_mesh(name="floor", uservert=corners, userface=np.arange(3 * len(faces)))
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it encloses nothing
    floor = spec.geom("floor")
    floor.type, floor.meshname = mujoco.mjtGeom.mjGEOM_MESH, "floor"
    floor.pos, floor.quat, floor.contype, floor.conaffinity = [0, 0, 0], [1, 0, 0, 0], 0, 0


def under(task: Any) -> HeightMap | None:
    """What a robot with the config's group `task` stands on: None on flat ground, else `SOME` height map."""
    return None if task.terrain == "flat" else SOME


def of_tiles(tiles: Any) -> HeightMap:
    """The ground of the config's group `task.tiles`; ConfigError where it has a map that is not there."""
    try:
        return tiles_lib.make(tiles)
    except map_file.BadMap as error:
        raise ConfigError(f"task.tiles.map: {error}") from None


def check(ground: HeightMap) -> None:
    """ConfigError for a map that is none."""
    if not isinstance(ground, HeightMap):
        raise ConfigError(
            f"ground is a {type(ground).__name__}, expected a HeightMap(heights, cell, corner)"
        )
    heights, corner = ground.heights, np.asarray(ground.corner)
    if not isinstance(heights, np.ndarray) or heights.dtype != np.float32:
        found = heights.dtype if isinstance(heights, np.ndarray) else type(heights).__name__
        raise ConfigError(f"ground.heights is {found}, expected an array of NumPy's float32")
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ConfigError(
            f"ground.heights has the shape {heights.shape}, expected [X, Y] of at least 2 x 2"
        )
    if not np.isfinite(heights).all():
        raise ConfigError("ground.heights has some that are not finite, expected m")
    if not isinstance(ground.cell, numbers.Real) or not 0 < ground.cell < np.inf:
        raise ConfigError(f"ground.cell is {ground.cell!r}, expected m above 0")
    if corner.shape != (2,) or corner.dtype.kind not in "fiu" or not np.isfinite(corner).all():
        raise ConfigError(f"ground.corner is {ground.corner!r}, expected x and y in m")


def check_tiles(tiles: Any, ground: HeightMap) -> None:
    """ConfigError where a tile of the config's group `task.tiles` is not on a `ground` of one's own: robots
    would begin beside it."""
    check(ground)
    half, middles = tiles.size / 2, tiles_lib.centres(tiles).reshape(-1, 2)
    there = [(m.min() - half, m.max() + half) for m in middles.T]
    ends = [
        (first, first + ground.cell * (count - 1))
        for first, count in zip(ground.corner, ground.heights.shape, strict=True)
    ]
    for axis, (low, high), (first, last) in zip("xy", there, ends, strict=True):
        if low < first - 1e-6 or high > last + 1e-6:
            raise ConfigError(
                f"task.tiles has {axis} from {low:g} to {high:g} m (rows, columns, size; around the origin), "
                f"the ground from {first:g} to {last:g} m; set task.tiles.rows, columns and size to what fits"
            )

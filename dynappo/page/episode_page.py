"""Writes one HTML file that plays an episode: recording and player, with nothing to download or install.

Writing it needs no OpenGL. `page.js` draws it with WebGL 2 from what `scene` records: shapes and
materials of the MJCF, and the pose of every body at every row.

Why no library's player: viser's recordings (viser 1.1.1) work without a network, but take 1.7 MB for
12 s of a Go1 (this page: 0.23 MB), and an open port to write them. They have no numbers, chart, table or
contact shapes, and `evaluate`'s report could not change the recording in one. brax's page fetches three.js
from a CDN. three.js itself (0.7 MB, MIT) would replace the WebGL calls, a third of `page.js`; chart,
controls and arrows would stay.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo.config import files
from dynappo.policy import render
from dynappo.policy.episode import Player
from dynappo.terrain import height_map

HERE = Path(__file__).parent
ANONYMOUS = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's rgba of a geom that names no colour
DRAWN = "sphere capsule ellipsoid cylinder box mesh".split()
GROUND = 0.66, 0.69, 0.72  # of a height field, whose edges its own texture would hide
PLAIN = dict(specular=0.5, shininess=0.5, emission=0.0)  # MuJoCo's defaults of a material


def write(player: Any, episode: dict[str, np.ndarray], out: Path, heading, subtitle, rows) -> int:
    """Write the page and return its size (bytes); `rows` are (name, value) shown beneath the title.

    Raises OSError if `out` cannot be written.
    """
    text = content(scene(player, episode), heading, subtitle, rows)
    with files.replacing(out) as part:
        return part.write_bytes(
            text.encode(errors="backslashreplace")
        )  # names of files may be no UTF-8


def content(data: dict[str, Any], heading: str, subtitle: str, rows) -> str:
    """The page that plays what `scene` returned. One in a frame takes another recording as a message
    `{scene, subtitle, measures}` (`page.js`, `evaluate/report.html`)."""
    return filled(
        (HERE / "page.html").read_text(encoding="utf-8"),
        TITLE=html.escape(f"{heading}, dynappo"),
        HEADING=html.escape(heading),
        SUBTITLE=html.escape(subtitle),
        MEASURES=cells(rows),
        SECONDS=f"{data['rows'] * data['dt']:.1f}",
        SCENE=json.dumps(data, separators=(",", ":")),  # numbers and base64: no text to escape
        CODE=(HERE / "page.js").read_text(encoding="utf-8"),
    )


def cells(rows) -> str:
    """Rows of a table in HTML; each is its texts."""
    line = "".join
    return line(
        "<tr>" + line(f"<td>{html.escape(text)}</td>" for text in row) + "</tr>" for row in rows
    )


def filled(template: str, **parts: str) -> str:
    """The template with each `{{NAME}}` replaced by its part."""
    pieces = template.split("{{")
    for i, piece in enumerate(pieces[1:], 1):
        name, _, rest = piece.partition("}}")
        pieces[i] = parts[name] + rest
    return "".join(pieces)


def scene(player: Player, episode: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the page draws, as JSON; arrays are base64 of little-endian numbers, row by row.

    `root [T, 3]` float32: positions (m) of the base; `position [T, B, 3]` int16: positions of the
    bodies less that of the base, in units of `unit` m; `rotation [T, B, 4]` int16: their quaternions
    (w, x, y, z) times 32767; `command`, `velocity [T, 3]` float32 as in the episode. A geom's `pos`
    and `quat` are in the frame of its `body`, an index in 0..B-1, or -1: fixed in the world.
    """
    model, dt, fell = player.model, float(episode["dt"]), np.flatnonzero(episode["fell"])
    shown = [*DRAWN, "hfield"]
    geoms = [i for i in range(model.ngeom) if _kind(model, i) in shown and _rgba(model, i)[3] > 0]
    moving = {int(model.geom_bodyid[i]) for i in geoms if not player.ground[i]}
    ids = [player.base_body, *sorted(moving - {player.base_body})]
    if "pose" in episode:
        position, quat = np.split(episode["pose"][:, ids], [3], axis=-1)
    else:
        position, quat = poses(model, episode["qpos"], ids)
    root = position[:, 0].astype(np.float32)
    relative = position - root[:, None]
    unit = max(float(np.abs(relative).max()), 1e-3) / 32767
    data = mujoco.MjData(model)
    data.qpos[:] = episode["qpos"][0]
    mujoco.mj_kinematics(model, data)
    planes = [
        i for i in range(model.ngeom) if player.ground[i] and _kind(model, i) == "plane"
    ]  # one of them is drawn, without end
    meshes = sorted({int(model.geom_dataid[i]) for i in geoms if _kind(model, i) == "mesh"})
    fields = sorted({int(model.geom_dataid[i]) for i in geoms if _kind(model, i) == "hfield"})
    under = [float(data.geom_xpos[i, 2]) for i in geoms if _kind(model, i) == "hfield"]
    reach = np.linalg.norm(relative, axis=-1).max(0)
    robot = [b for b in range(len(ids)) if model.body_rootid[ids[b]] == player.base_body]
    return {
        "rows": len(root),
        "bodies": len(ids),
        "base": 0,
        "dt": dt,
        "unit": unit,
        # a ground of its own has no plane, which would hide what is below it
        "floor": float(data.geom_xpos[planes[0], 2]) if planes else min(under, default=0.05) - 0.05,
        "top": render.lift(
            model, data, player.base_body
        ),  # m above the base, where an arrow is clear of it
        "radius": float(reach[robot].max()) * 1.15,  # m, about that of the robot
        # radians, of the camera: on rough ground above the stairs that lead up to it
        "elevation": 0.56 if fields else 0.2,
        "tile": 0.25,  # m, the side of a field of the floor
        "fall": float((fell[0] + 1) * dt) if len(fell) else None,
        # of a task without commands none are shown
        "asked": getattr(player, "ranges", ()) is not None,
        "geoms": [_geom(model, data, i, ids, meshes, bool(player.ground[i])) for i in geoms],
        "meshes": [_mesh(model, i) for i in meshes] + [_field(model, i) for i in fields],
        "root": _packed(root, "<f4"),
        "position": _packed(np.round(relative / unit), "<i2"),
        "rotation": _packed(np.round(quat * 32767), "<i2"),
        "command": _packed(episode["command"], "<f4"),
        "velocity": _packed(episode["velocity"], "<f4"),
    }


def poses(model, qpos: np.ndarray, ids: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """`(position [T, B, 3], quat [T, B, 4])` of the bodies `ids` at every row of `qpos`."""
    data, position, quat = mujoco.MjData(model), [], []
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        position.append(data.xpos[ids].copy())
        quat.append(data.xquat[ids].copy())
    return np.stack(position), np.stack(quat)


def _packed(values, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, np.dtype(kind)).tobytes()).decode()


def _short(values, digits: int) -> list[float]:
    return np.round(np.asarray(values, np.float64), digits).tolist()


def _kind(model, geom: int) -> str:
    return mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()


def _rgba(model, geom: int) -> np.ndarray:
    """The geom's own colour, or its material's where it has none of its own."""
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    return model.mat_rgba[material] if material >= 0 and np.allclose(own, ANONYMOUS) else own


def _geom(model, data, i: int, ids: list[int], meshes: list[int], fixed: bool) -> dict[str, Any]:
    """A geom as the page draws it; sizes, pose and colours to the digits that can be seen."""
    material = int(model.geom_matid[i])
    finish = PLAIN
    if material >= 0:
        finish = {name: float(getattr(model, f"mat_{name}")[material]) for name in PLAIN}
    pos, quat = model.geom_pos[i], model.geom_quat[i]
    if fixed:
        pos, quat = data.geom_xpos[i], np.zeros(4)
        mujoco.mju_mat2Quat(quat, data.geom_xmat[i])
    kind, shape, colour = _kind(model, i), {}, _rgba(model, i)[:3]
    if kind == "mesh":
        shape = {"mesh": meshes.index(int(model.geom_dataid[i]))}
    elif kind == "hfield":  # a mesh for the page, after the others; there is one at most
        kind, shape, colour = "mesh", {"mesh": len(meshes)}, GROUND
    return shape | {
        "type": kind,
        "size": _short(model.geom_size[i], 5),
        "pos": _short(pos, 5),
        "quat": _short(quat, 6),
        "color": _short(colour, 3),
        **{name: round(value, 3) for name, value in finish.items()},
        "body": -1 if fixed else ids.index(int(model.geom_bodyid[i])),
        "group": int(model.geom_group[i]),
    }


def _field(model, i: int) -> dict[str, Any]:
    """Height field `i`, of which the page makes a mesh: heights [y, x] int16 in units of `unit` m, at `x` and
    `y` (m). Rows and columns that are as those on both of their sides are left out."""
    ny, nx, start = (int(getattr(model, f"hfield_{n}")[i]) for n in ("nrow", "ncol", "adr"))
    half_x, half_y, top, _ = model.hfield_size[i]
    heights = np.round(model.hfield_data[start : start + nx * ny] * 32767).reshape(ny, nx)
    rows, columns = height_map.needed(heights), height_map.needed(heights.T)
    return {
        "heights": _packed(heights[np.ix_(rows, columns)], "<i2"),
        "unit": float(top) / 32767,
        "x": _short(np.linspace(-half_x, half_x, nx)[columns], 5),
        "y": _short(np.linspace(-half_y, half_y, ny)[rows], 5),
    }


def _mesh(model, i: int) -> dict[str, str]:
    """Mesh `i` in the frame of its geoms: points, normals, and three indices of each a face."""
    points = slice(model.mesh_vertadr[i], model.mesh_vertadr[i] + model.mesh_vertnum[i])
    normals = slice(model.mesh_normaladr[i], model.mesh_normaladr[i] + model.mesh_normalnum[i])
    faces = slice(model.mesh_faceadr[i], model.mesh_faceadr[i] + model.mesh_facenum[i])
    return {
        "vertices": _packed(model.mesh_vert[points], "<f4"),
        "normals": _packed(model.mesh_normal[normals], "<f4"),
        "faces": _packed(model.mesh_face[faces], "<u4"),
        "face_normals": _packed(model.mesh_facenormal[faces], "<u4"),
    }

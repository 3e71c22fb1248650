"""The robot in the browser: its shapes, contacts and arrows, the camera, and a hand that pulls it.

mjviser draws what is in the MjModel. While the camera follows, mjviser moves the world and leaves the
robot at the origin, so that each viewer's own view stays as they turned it.
"""

from __future__ import annotations

from dataclasses import dataclass

import mjviser
import mujoco
import numpy as np
import trimesh
import trimesh.visual
import viser

from dynappo.policy import episode as episode_lib
from dynappo.policy import render
from dynappo.policy.task_player import TaskPlayer
from dynappo.terrain.height_map import HeightMap
from dynappo.web import ground_mesh
from dynappo.web import live as live_lib
from dynappo.web.live import Live

GREEN, BLUE = (26, 158, 77), (33, 107, 237)  # command and velocity, as on the page in one file
LINES, ABOVE = (112, 120, 128), 0.003  # colour of lines on rough ground, and m above it
LIFT = (0.0, 0.04)  # m, command and velocity
LONG = 0.5  # m of an arrow for each m/s
SHORTEST = 0.05  # m/s of an arrow that is drawn
NARROW = 0.65  # width over height: a phone held upright, where viser puts its buttons at the bottom
STEEP = 32  # degrees, the camera's elevation on rough ground: above the stairs that lead up to it
NEAR = 1.7  # the camera's distance, times the extent of the model


@dataclass
class Shown:
    """What is in the scene."""

    server: viser.ViserServer
    robot: mjviser.ViserMujocoScene
    arrows: list[viser.ArrowsHandle]
    box: viser.GlbHandle
    follow: bool = True


def show(server: viser.ViserServer, live: Live) -> Shown:
    """Put the robot of `live` into the scene, alone."""
    server.scene.reset()
    player = live.player
    fields = player.model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
    if (field := _field(live)) is not None:
        player.model.geom_rgba[fields, 3] = 0  # mjviser leaves it out: `_ground` draws it
    robot = mjviser.ViserMujocoScene(server, player.model, num_envs=1)
    if field is not None:
        _ground(server, field)
    if render.options(player.model, player.base_body).geomgroup[3]:
        robot.geom_groups_visible[3] = True
        robot.rebuild_visual_handles()
    arrows = [
        server.scene.add_arrows(
            f"/arrows/{name}",
            np.zeros((1, 2, 3)),
            colour,
            shaft_radius=0.012,
            head_radius=0.03,
            head_length=0.06,
        )
        for name, colour in (("command", GREEN), ("velocity", BLUE))
    ]
    shown = Shown(server, robot, arrows, _hand(server, live))
    for client in server.get_clients().values():
        welcome(shown, live, client)
    return shown


def _field(live: Live) -> HeightMap | None:
    return None if isinstance(live.player, TaskPlayer) else live.player.field


def _ground(server: viser.ViserServer, field: HeightMap) -> None:
    """Draw a height map, which moves with the world while the camera follows."""
    points, faces = ground_mesh.triangles(field)
    server.scene.add_mesh_simple(
        "/fixed_bodies/ground",
        points,
        faces,
        color=np.array(episode_lib.PLAIN[:3]),
        flat_shading=True,
        cast_shadow=False,
        receive_shadow=0.2,
    )
    lines = ground_mesh.lines(field)
    lines[..., 2] += ABOVE
    server.scene.add_line_segments("/fixed_bodies/lines", lines, LINES, thickness=0.008)


def _view(live: Live, narrow: bool) -> tuple[np.ndarray, np.ndarray]:
    """`(position, look_at)` of a camera, from the base: ahead, to the right and above.

    On a narrow screen the buttons are at the bottom: there the robot is in the upper part.
    """
    size = live.player.model.stat.extent
    azimuth, elevation = np.deg2rad([-38, STEEP if _field(live) is not None else 18])
    flat = np.cos(elevation)
    away = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    if narrow:
        return away * 2.2 * size, np.array([0, 0, -0.8 * size])
    return away * NEAR * size, np.zeros(3)


def welcome(shown: Shown, live: Live, client: viser.ClientHandle) -> None:
    """Point the camera of a new viewer at the robot."""
    position, look_at = _view(live, client.camera.aspect < NARROW)
    at = np.zeros(3) if shown.follow else live.data.xpos[live.player.base_body].copy()
    client.camera.position, client.camera.look_at = position + at, look_at + at


def _hand(server: viser.ViserServer, live: Live) -> viser.GlbHandle:
    """An invisible box around the base: whoever drags it pulls the robot."""
    model, base = live.player.model, live.player.base_body
    half = np.full(3, 0.05)
    for i in np.flatnonzero(model.geom_bodyid == base):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[i])
        centre, reach = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
        turn = turn.reshape(3, 3)
        far = np.abs(model.geom_pos[i] + turn @ centre) + np.abs(turn) @ reach
        half = np.maximum(half, far)
    # not `add_box`: where that is transparent, it still hides the floor behind it
    unseen = trimesh.visual.material.PBRMaterial(alphaMode="BLEND", baseColorFactor=(0, 0, 0, 0))
    mesh = trimesh.creation.box(2 * half)
    mesh.visual = trimesh.visual.TextureVisuals(material=unseen)
    box = server.scene.add_mesh_trimesh("/hand", mesh, cast_shadow=False, receive_shadow=False)

    @box.on_drag("left")
    async def _(event) -> None:
        pull = np.subtract(event.end_position, event.start_position)
        live_lib.wish(live, _pull, None if event.phase == "end" else pull)

    return box


def _pull(live: Live, pull) -> None:
    live.pull = pull


def update(shown: Shown, live: Live) -> None:
    """Draw the robot as it is now, for all viewers."""
    data, base = live.data, live.player.base_body
    origin = data.xpos[base] if shown.follow else np.zeros(3)
    at = data.xpos[base] - origin
    x, y = data.xmat[base].reshape(3, 3)[:2, 0]
    heading = np.array([[x, -y], [y, x]]) / max(np.hypot(x, y), 1e-6)
    above = render.lift(live.player.model, data, base)
    with shown.server.atomic():
        for arrow, lift, name in zip(shown.arrows, LIFT, ("command", "velocity"), strict=True):
            tip = np.append(heading @ live.row[name][:2] * LONG, 0.0)
            arrow.visible = bool(np.linalg.norm(tip) > SHORTEST * LONG)
            start = at + [0, 0, above + lift]
            arrow.points = np.stack([start, start + tip])[None].astype(np.float32)
        shown.box.position, shown.box.wxyz = at, data.xquat[base]
        shown.robot.update_from_mjdata(data)


def follow(shown: Shown, live: Live, on: bool) -> None:
    """Make the camera follow the robot, or stay where it is."""
    if on == shown.follow:
        return
    shift = live.data.xpos[live.player.base_body] * (-1 if on else 1)
    shown.follow = shown.robot.camera_tracking_enabled = on
    for client in shown.server.get_clients().values():
        with client.atomic():
            look_at = client.camera.look_at + shift
            client.camera.position = client.camera.position + shift
            client.camera.look_at = look_at
    update(shown, live)


def contacts(shown: Shown, points: bool, forces: bool) -> None:
    """Draw contact points and contact forces, or stop."""
    shown.robot.show_contact_points, shown.robot.show_contact_forces = points, forces

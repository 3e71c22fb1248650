"""Draws a robot's looks beside the shapes that physics sees: feet and parts.

Three views in one scene, all in the default pose: looks from the side, shapes from the side, shapes from the
front. Orange shapes are feet, grey-blue ones parts: a part at the ground ends an episode.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco
import numpy as np

from dynappo.description import mjcf
from dynappo.description import robot as robot_lib
from dynappo.description.rotation import matrix, quaternion
from dynappo.policy import render

FEET, PARTS, TILE = (0.95, 0.50, 0.10, 1.0), (0.42, 0.55, 0.70, 1.0), (0.80, 0.82, 0.84, 1.0)
SIZE = 1500, 560  # pixels
LENS = 18.0  # degrees, the vertical field of view
TILT = 8.0  # degrees, how far the camera looks down
APART = 1.25  # of a robot's width, from one middle to the next
MESH, PLANE = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_PLANE


def draw(robot: robot_lib.Robot, out: Path) -> str:
    """Write the picture `out`, a PNG; "", or a line that says why not, as `render.film`."""
    with tempfile.TemporaryDirectory() as folder:
        xml = Path(folder) / "look.xml"
        xml.write_text(scene(robot), encoding="utf-8")
        still = np.zeros((1, 3))
        episode = dict(qpos=np.zeros((1, 0)), command=still, velocity=still, dt=np.array(0.02))
        return render.film(render.Shown(xml, "", 0), episode, out, SIZE)


def scene(robot: robot_lib.Robot) -> str:
    """The MJCF of the scene, without joints: each shape is where the default pose has it."""
    model = robot.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home_qpos
    mujoco.mj_kinematics(model, data)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    shapes = np.concatenate([robot.feet, robot.parts])
    points, reach = data.geom_xpos[shapes], 0.8 * model.geom_rbound[shapes]
    long, wide = (np.abs(points - data.xpos[robot.base_body]) + reach[:, None])[:, :2].max(0)
    looks = _looks(spec, robot)
    places = [(0.0, 0.0)] if not looks else []
    across = APART * 2 * long
    middle = across if looks else 0.0
    front = middle + APART * (long + wide)
    for at, yaw in ((middle, 0.0), (front, -np.pi / 2)):
        places.append((at, yaw))
        for geom in (*robot.feet, *robot.parts):
            colour = FEET if geom in robot.feet else PARTS
            _place(spec, model, data, int(geom), at, yaw, rgba=colour)
    span = front + wide + long
    _stage(spec, span / 2 - long, span, float((points[:, 2] + reach).max()))
    spec.compile()
    return spec.to_xml()


def _looks(spec: mujoco.MjSpec, robot: robot_lib.Robot) -> bool:
    """Add what the file draws; False if that is nothing but the shapes."""
    if robot.text:
        return False
    with mjcf.one_line(robot.xml):
        whole = mujoco.MjSpec.from_file(str(robot.xml))
        model = whole.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(i).name for i in range(model.njnt)]
    data.qpos[model.jnt_qposadr[[joints.index(n) for n in robot.joint_names]]] = robot.default_pose
    base = int(model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE][0])
    data.qpos[:7] = robot.home_qpos[:7]
    mujoco.mj_kinematics(model, data)
    mine = (model.geom_group < 3) & (model.body_rootid[model.geom_bodyid] == base)
    folder = Path(whole.modelfiledir or robot.xml.parent) / whole.meshdir
    for mesh in whole.meshes:
        if mesh.file:
            new = spec.add_mesh(name=mesh.name, file=str((folder / mesh.file).absolute()))
            new.scale, new.refpos, new.refquat = mesh.scale, mesh.refpos, mesh.refquat
            new.inertia, new.smoothnormal = mesh.inertia, mesh.smoothnormal
    for geom in np.flatnonzero(mine):
        colour = model.geom_rgba[geom]
        if model.geom_matid[geom] >= 0:
            colour = model.mat_rgba[model.geom_matid[geom]]
        _place(spec, model, data, int(geom), 0.0, 0.0, rgba=colour)
    return bool(mine.any())


def _place(spec, model, data, geom: int, at: float, yaw: float, **look) -> None:
    """Add a geom of a posed model to the scene, turned by `yaw` about the base's vertical, `at` to the
    right."""
    position, rotation = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    mesh = int(model.geom_dataid[geom])
    more = {}
    if model.geom_type[geom] == MESH:  # as the file has it: MuJoCo centres meshes
        rotation = rotation @ matrix(model.mesh_quat[mesh]).T
        position = position - rotation @ model.mesh_pos[mesh]
        more = dict(meshname=model.mesh(mesh).name)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    spec.worldbody.add_geom(
        type=model.geom_type[geom],
        size=model.geom_size[geom],
        pos=turn @ position + [at, 0, 0],
        quat=quaternion(turn @ rotation),
        contype=0,
        conaffinity=0,
        **more,
        **look,
    )


def _stage(spec: mujoco.MjSpec, middle: float, width: float, height: float) -> None:
    """Floor, light, and a camera from the robots' right that has all of them in its picture."""
    spec.worldbody.add_geom(type=PLANE, size=[0, 0, 0.05], rgba=TILE, contype=0, conaffinity=0)
    lens = np.tan(np.radians(LENS / 2))
    far = max(1.1 * width / 2 / (lens * SIZE[0] / SIZE[1]), 1.2 * height / 2 / lens)
    tilt = np.radians(TILT)
    eye = [middle, -far * np.cos(tilt), height / 2 + far * np.sin(tilt)]
    spec.worldbody.add_camera(
        name="track",
        pos=eye,
        quat=[np.cos(np.pi / 4 - tilt / 2), np.sin(np.pi / 4 - tilt / 2), 0, 0],
        fovy=LENS,
    )
    light = spec.worldbody.add_light(pos=[middle, -3, 6], dir=[0.15, 0.5, -1])
    light.type, light.diffuse = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, [0.5, 0.5, 0.5]
    view = spec.visual
    view.headlight.ambient, view.headlight.diffuse = [0.45, 0.45, 0.45], [0.3, 0.3, 0.3]
    view.global_.offwidth, view.global_.offheight = SIZE
    view.map.znear, view.map.zfar = 0.01, 50
    view.quality.shadowsize, view.quality.offsamples = 4096, 8
    spec.stat.extent, spec.stat.center = max(width, height), [middle, 0, height / 2]
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2, sky.width, sky.height = [0.86, 0.90, 0.94], [0.62, 0.70, 0.80], 64, 384

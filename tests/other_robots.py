"""Robots of other limbs and feet than the bundled ones: bipeds, and a hexapod."""

from pathlib import Path

import mujoco
import numpy as np

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.policy import policy_file

# the shapes of a biped's feet; of a geom: `pos` is from the ankle
BOX = '<geom name="{}_foot" type="box" size=".09 .04 .015" pos=".02 0 -.03" class="foot"/>'
CAPSULES = (
    '<geom name="{}_foot1" type="capsule" size=".012" fromto="-.06 .03 -.03 .1 .025 -.03" class="foot"/>'
    '<geom name="{}_foot2" type="capsule" size=".012" fromto="-.06 -.03 -.03 .1 -.02 -.03" class="foot"/>'
)
MIXED = (
    '<geom name="{}_foot_1" type="cylinder" size=".04 .01" pos="-.03 0 -.03" class="foot"/>'
    '<geom name="{}_foot_2" type="capsule" size=".012" fromto=".02 0 -.03 .1 0 -.03" class="foot"/>'
    '<geom name="{}_foot_3" size=".014" pos=".11 .01 -.03" class="foot"/>'
)
LEG = (0.0, 0.02, -0.4, 0.8, -0.4, -0.02)  # rad, the home pose of a biped's leg
HEXAPOD = dict(FL=(0.3, 0.15), FR=(0.3, -0.15), ML=(0.0, 0.2), MR=(0.0, -0.2))
HEXAPOD |= dict(RL=(-0.3, 0.15), RR=(-0.3, -0.15))
THIGH, CALF = 0.6, -1.2  # rad, the hexapod's home pose


def biped(left=BOX, right=None, arms=False):
    """12 joints and two feet of any shapes, left and right; three of a leg's joints are in one body. The
    arms have a joint each, and hands that touch."""

    def leg(side, y, foot):
        names = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
        yaw, roll, pitch, knee, *ankle = (f"{side}_{name}" for name in names)
        return f"""
        <body name="{side}_thigh" pos="0 {y} -.05">{inertial(1.5, -0.1)}
          <joint name="{yaw}" axis="0 0 1" range="-1 1"/><joint name="{roll}" axis="1 0 0" range="-1 1"/>
          <joint name="{pitch}" axis="0 1 0" range="-2 1"/>
          <geom type="capsule" fromto="0 0 -.05 0 0 -.2" size=".035" class="part"/>
          <body name="{side}_shank" pos="0 0 -.25">{inertial(1.0, -0.1)}
            <joint name="{knee}" axis="0 1 0" range="0 2.3"/>
            <geom type="capsule" fromto="0 0 -.05 0 0 -.18" size=".03" class="part"/>
            <body name="{side}_ankle" pos="0 0 -.25">{inertial(0.4, -0.02)}
              <joint name="{ankle[0]}" axis="0 1 0" range="-1.2 1.2"/>
              <joint name="{ankle[1]}" axis="1 0 0" range="-.6 .6"/>{foot.replace("{}", side)}
            </body></body></body>"""

    def arm(side, y):
        return f"""
        <body name="{side}_arm" pos="0 {y} .25">{inertial(0.4, -0.1)}
          <joint name="{side}_shoulder" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 -.02 0 0 -.25" size=".03" class="part"/></body>"""

    bodies = leg("left", 0.08, left) + leg("right", -0.08, right or left)
    if arms:
        bodies += arm("left", 0.2) + arm("right", -0.2)
    trunk = '<geom type="capsule" fromto="0 0 0 0 0 .25" size=".08" class="part"/>'
    pose = (*LEG, *LEG, *(0.0, 0.0)[: 2 * arms])
    return made("biped", f"{trunk}{inertial(8.0, 0.12)}{bodies}", pose)


def hexapod():
    """18 joints and six feet, a sphere each."""

    def leg(name, x, y):
        link = f'<geom type="capsule" fromto="0 0 0 0 0 -.15" size=".02" class="part"/>{inertial(0.3, -0.05)}'
        return f"""
        <body name="{name}_hip" pos="{x} {y} 0">{inertial(0.3, 0.0)}
          <joint name="{name}_hip" axis="1 0 0" range="-1 1"/>
          <body name="{name}_thigh" pos="0 {np.sign(y) * 0.05} 0">{link}
            <joint name="{name}_thigh" axis="0 1 0" range="-1.5 2"/>
            <body name="{name}_calf" pos="0 0 -.2">{link}
              <joint name="{name}_calf" axis="0 1 0" range="-2.5 -.3"/>
              <geom name="{name}_foot" size=".025" pos="0 0 -.2" class="foot"/>
            </body></body></body>"""

    trunk = '<geom type="box" size=".3 .1 .05" class="part"/>' + inertial(8.0, 0.0)
    legs = "".join(leg(name, x, y) for name, (x, y) in HEXAPOD.items())
    return made("hexapod", trunk + legs, (0.0, THIGH, CALF) * 6)


def inertial(mass, z):
    size = 0.004 * mass
    return f'<inertial pos="0 0 {z}" mass="{mass}" diaginertia="{size} {size} {size}"/>'


def made(name, base, pose):
    """The `Robot` with the content `base` of its base; in the home pose its lowest foot is on the floor."""
    text = f"""<mujoco model="{name}"><compiler angle="radian"/><option timestep="0.005"/><default>
      <geom contype="0" conaffinity="0"/><joint armature=".01" limited="true"/>
      <default class="foot"><geom conaffinity="1" priority="1" friction=".8" condim="3"/></default>
      <default class="part"><geom conaffinity="1" condim="1"/></default></default>
    <worldbody><geom name="floor" type="plane" size="0 0 1" contype="1"/><light pos="0 0 3"/>
    <body name="base" pos="0 0 1"><freejoint/><camera name="track" pos="0 -2 .5" xyaxes="1 0 0 0 .2 1"/>{base}
    </body></worldbody><actuator/></mujoco>"""
    spec = mujoco.MjSpec.from_string(text)
    for joint in spec.joints[1:]:
        spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        ).set_to_motor()
    spec.add_key(name="home", qpos=[0, 0, 1, 1, 0, 0, 0, *pose])
    spec.compile()
    return robot_lib.load_text(spec.to_xml(), name, Path(f"{name}.xml"))


def lowest_points(model, qpos, geoms):
    """[G] m: the lowest of points on each geom's surface, in the pose `qpos`."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return np.array([(data.geom_xpos[i] + surface(model, data, i))[:, 2].min() for i in geoms])


def surface(model, data, geom):
    """[N, 3] m: points among which is the lowest of a geom, from its centre in the axes of the world."""
    turn, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
    down, along = np.array([0, 0, -size[0]]), np.array([0, 0, 1.0])
    if kind == "sphere":
        return down[None]
    if kind == "capsule":
        return np.array([down + turn @ (end * size[1] * along) for end in (-1, 1)])
    if kind == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return corners * size @ turn.T
    assert kind == "cylinder"
    angles = np.linspace(0, 2 * np.pi, 20_000)
    rim = np.stack([size[0] * np.cos(angles), size[0] * np.sin(angles), 0 * angles], -1)
    return np.concatenate([rim + end * size[1] * along for end in (-1, 1)]) @ turn.T


def policy(robot, size=0.0):
    """A policy of Go1's numbers for a robot: its actor gives zero, or moves the joints by `size`."""
    config = config_lib.validate(config_lib.load("configs/default.py"))
    joints, rng = len(robot.joint_names), np.random.default_rng(0)
    layers, wide = {}, 12 + 3 * joints
    for i, out in enumerate((8, joints)):
        kernel = size * rng.normal(size=(wide, out)) / np.sqrt(wide)
        layers[f"Dense_{i}"] = {"kernel": kernel.astype(np.float32), "bias": np.zeros(out, "f4")}
        wide = out
    params = {"actor": {"params": layers}, "std": np.ones(joints, np.float32)}
    return policy_file.describe(config, robot, params)

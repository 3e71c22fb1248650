"""Robot files as other people write them: a biped, a hexapod, a quadruped of a CAD program, a wheeled one."""

import numpy as np


def hexapod_leg(name, x, y):
    inertial = '<inertial pos="0 0 -0.05" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
    link = f'<geom type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02" conaffinity="1"/>{inertial}'
    foot = f'<geom name="{name}_foot" size="0.025" pos="0 0 -0.2" priority="1" conaffinity="1"/>'
    return f"""
    <body name="{name}_hip" pos="{x} {y} 0">{inertial}
      <joint name="{name}_hip" axis="1 0 0" range="-1 1"/>
      <body name="{name}_thigh" pos="0 {np.sign(y) * 0.05} 0">{link}
        <joint name="{name}_thigh" axis="0 1 0" range="-1.5 2"/>
        <body name="{name}_calf" pos="0 0 -0.2">{link}{foot}
          <joint name="{name}_calf" axis="0 1 0" range="-2.5 -0.3"/>
        </body></body></body>"""


HEXAPOD_LEGS = ("FL", 0.3, 0.15), ("FR", 0.3, -0.15), ("ML", 0.0, 0.2)
HEXAPOD_LEGS += ("MR", 0.0, -0.2), ("RL", -0.3, 0.15), ("RR", -0.3, -0.15)
HEXAPOD_POSE = 0.0, 0.6, -1.2  # rad: hip, thigh, calf


def hexapod() -> str:
    """In the form that needs no completion."""
    names = [f"{name}_{joint}" for name, *_ in HEXAPOD_LEGS for joint in ("hip", "thigh", "calf")]
    height = 0.2 * np.cos(HEXAPOD_POSE[1]) + 0.2 * np.cos(sum(HEXAPOD_POSE[1:])) + 0.025
    pose = " ".join(map(str, HEXAPOD_POSE * 6))
    return f"""<mujoco><compiler angle="radian"/><option timestep="0.005"/>
    <default><geom contype="0" conaffinity="0" condim="3"/></default>
    <worldbody><geom name="floor" type="plane" size="0 0 1" contype="1"/><body name="base" pos="0 0 {height}">
    <freejoint/><camera name="track"/><geom type="box" size="0.3 0.1 0.05" conaffinity="1"/>
    <inertial pos="0 0 0" mass="8" diaginertia="0.1 0.3 0.3"/>
    {"".join(hexapod_leg(*one) for one in HEXAPOD_LEGS)}
    </body></worldbody>
    <actuator>{"".join(f'<motor name="{n}" joint="{n}"/>' for n in names)}</actuator>
    <keyframe><key name="home" qpos="0 0 {height} 1 0 0 0 {pose}"/></keyframe></mujoco>"""


def _biped_leg(side, y):
    sign = np.sign(y)
    return f"""
    <body name="{side}_thigh" pos="0 {y} -0.1">
      <joint name="{side}_hip_yaw" axis="0 0 1" range="-0.6 0.6"/>
      <joint name="{side}_hip_roll" axis="1 0 0" range="-0.6 0.6" pos="0 0 -0.02"/>
      <joint name="{side}_hip_pitch" axis="0 1 0" range="-2 2" pos="0 0 -0.05"/>
      <geom type="capsule" fromto="0 0 -0.06 0 0 -0.26" size="0.05" mass="2"/>
      <body name="{side}_shin" pos="0 {sign * 0.01} -0.32" euler="0 0.1 0">
        <joint name="{side}_knee" axis="0 1 0" range="0 2.4"/>
        <geom type="cylinder" fromto="0 0 -0.03 0 0 -0.22" size="0.04" mass="1.5"/>
        <body name="{side}_ankle" pos="0 0 -0.3" euler="0 -0.1 0">
          <joint name="{side}_ankle_pitch" axis="0 1 0" range="-1 1"/>
          <joint name="{side}_ankle_roll" axis="1 0 0" range="-0.5 0.5"/>
          <geom type="box" size="0.02 0.02 0.02" mass="0.1"/>
          <body name="{side}_sole" pos="0.03 0 -0.05">
            <geom type="box" size="0.1 0.04 0.015" mass="0.5"/>
          </body></body></body></body>"""


def _biped_arm(side, y):
    return f"""
    <body name="{side}_arm" pos="0 {y} 0.3">
      <joint name="{side}_shoulder" axis="0 1 0" range="-3 3"/><joint name="{side}_swing" axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.04" mass="1"/>
      <body name="{side}_hand" pos="0 0 -0.3"><joint name="{side}_elbow" axis="0 1 0" range="-2 0"/>
        <geom type="ellipsoid" size="0.03 0.02 0.05" pos="0 0 -0.05" mass="0.4"/></body></body>"""


def biped() -> str:
    """Masses from shapes, MuJoCo's own contact numbers, servos, several hinges in a body, a waist, arms whose
    swing has no range, welded soles; no floor, no keyframe, no camera."""
    legs = _biped_leg("left", 0.1) + _biped_leg("right", -0.1)
    arms = _biped_arm("left", 0.2) + _biped_arm("right", -0.2)
    return f"""<mujoco><compiler angle="radian" autolimits="true"/>
    <default><position kp="60" forcerange="-40 40"/><joint armature="0.02"/></default>
    <worldbody><body name="pelvis" pos="0 0 1"><joint type="free"/>
      <geom type="box" size="0.08 0.12 0.06" mass="5"/>{legs}
      <body name="torso" pos="0 0 0.1"><joint name="waist" axis="0 0 1" range="-1 1"/>
        <geom type="box" size="0.08 0.14 0.15" pos="0 0 0.15" mass="10"/>{arms}</body>
    </body></worldbody>
    <actuator><position joint="waist" armature="0.01" gear="2"/><position joint="left_knee"/></actuator>
    </mujoco>"""


def _turned_leg(name, x, y, turn):
    """A leg whose frames are turned: the hip's by 90 degrees, the shank's upside down."""
    return f"""
    <body name="{name}_hip" pos="{x} {y} 0" euler="0 0 {turn}">
      <inertial pos="0 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
      <joint name="{name}_roll" axis="0 1 0" range="-1 1"/>
      <body name="{name}_mount" pos="0 0 -0.02">
        <inertial pos="0 0 0.01" mass="0.2" diaginertia="2e-4 1e-4 1e-4"/>
        <geom type="cylinder" size="0.03 0.02"/>
        <body name="{name}_thigh" pos="0 0 -0.02" euler="0 0 {-turn}">
          <inertial pos="0 0 -0.1" mass="1" diaginertia="4e-3 4e-3 1e-3"/>
          <joint name="{name}_pitch" axis="0 1 0" range="-1.5 2.5" pos="0 0.01 0" ref="0.7"/>
          <geom type="box" size="0.02 0.02 0.1" pos="0 0 -0.11"/>
          <body name="{name}_shank" pos="0 0 -0.22" euler="3.141592653589793 0 0">
            <inertial pos="0 0 0.1" mass="0.3" diaginertia="2e-3 2e-3 1e-4"/>
            <joint name="{name}_knee" axis="0 -1 0" range="-2.6 -0.3" ref="-1.4"/>
            <geom type="capsule" fromto="0 0 0.02 0 0 0.15" size="0.015"/>
            <body name="{name}_adapter" pos="0.02 0 0.2" euler="0 0.2 0">
              <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
              <body name="{name}_tip" pos="0 0 0.02">
                <inertial pos="0 0 0" mass="0.06" diaginertia="1e-5 1e-5 1e-5"/>
                <geom type="sphere" size="0.025"/></body></body></body></body></body></body>"""


TURNED_LEGS = ("lf", 0.3, 0.12, -1.5707963267948966), ("rf", 0.3, -0.12, -1.5707963267948966)
TURNED_LEGS += ("lh", -0.3, 0.12, -1.5707963267948966), ("rh", -0.3, -0.12, -1.5707963267948966)


def turned() -> str:
    """Frames turned, joints with a place and a `ref`, feet welded on through an adapter; a sloping scene with
    a wall and a table, a keyframe `stand`, and looks whose mesh and picture files are not there."""
    legs = "".join(_turned_leg(*leg) for leg in TURNED_LEGS)
    pose = " ".join(["0.0 0.8 -1.5"] * 4)
    return f"""<mujoco><compiler angle="radian" meshdir="gone"/>
    <asset><mesh file="trunk.stl"/><texture name="skin" type="2d" file="skin.png"/>
      <material name="skin" texture="skin"/></asset>
    <worldbody><geom name="ground" type="plane" size="5 5 1" pos="0 0 -1"/>
    <geom name="wall" type="box" size="1 1 1" pos="9 0 0"/>
    <body name="table" pos="5 0 0"><geom size="0.1"/></body>
    <body name="trunk" pos="0 0 0.6"><freejoint/>
      <inertial pos="0.01 0 0" mass="12" diaginertia="0.1 0.3 0.35"/>
      <geom type="mesh" mesh="trunk" material="skin" contype="0" conaffinity="0" group="1"/>
      <geom type="box" size="0.3 0.1 0.08"/>{legs}</body></worldbody>
    <contact><exclude body1="trunk" body2="lf_mount"/></contact>
    <sensor><framepos objtype="body" objname="lf_tip"/></sensor>
    <keyframe><key name="stand" qpos="0 0 0.5 1 0 0 0 {pose}"/></keyframe></mujoco>"""


def wheeled() -> str:
    """A turned quadruped whose feet are wheels."""
    text = turned()
    for name, *_ in TURNED_LEGS:
        wheel = f'<body name="{name}_tip" pos="0 0 0.02">'
        text = text.replace(wheel, f'{wheel}<joint name="{name}_wheel" axis="0 1 0"/>')
    text = text.replace('<geom type="sphere" size="0.025"/>', '<geom type="sphere" size="0.06"/>')
    pose = " ".join(["0.0 0.8 -1.5"] * 4)
    return text.replace(pose, " ".join(["0.0 0.8 -1.5 0"] * 4))

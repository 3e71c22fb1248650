"""A quadruped as robots are published: position servos, soft feet in bodies of their own, turned frames,
looks."""

from pathlib import Path

CUBE = """\
v -1 -1 -1
v 3 -1 -1
v 3 1 -1
v -1 1 -1
v -1 -1 1
v 3 -1 1
v 2 1 1
v -1 1 1
f 1 3 2
f 1 4 3
f 5 6 7
f 5 7 8
f 1 2 6
f 1 6 5
f 2 3 7
f 2 7 6
f 3 4 8
f 3 8 7
f 4 1 5
f 4 5 8
"""
HEAD = """\
<mujoco model="toy">
  <compiler angle="radian" meshdir="assets"/>
  <option cone="elliptic" impratio="100" integrator="implicitfast"/>
  <default>
    <default class="toy">
      <geom friction="0.6" margin="0.001"/>
      <joint axis="0 1 0" damping="2" armature="0.01" frictionloss="0.2"/>
      <position kp="100" forcerange="-23.7 23.7"/>
      <default class="calf">
        <joint range="-2.8 -0.5"/>
        <position forcerange="-35.5 35.5"/>
      </default>
      <default class="look"><geom type="mesh" contype="0" conaffinity="0" group="2"
      material="dark"/></default>
    </default>
  </default>
  <asset><material name="dark" rgba="0.2 0.2 0.3 1"/><mesh file="cube.obj" scale="0.1 0.05 0.03"/></asset>
  <worldbody>
    <light pos="0 0 2"/>
    <body name="trunk" pos="0 0 0.4" quat="0 0 0 1" childclass="toy">
      <freejoint/>
      <inertial mass="6" pos="0.01 0 0" diaginertia="0.02 0.07 0.08"/>
      <geom type="box" size="0.15 0.06 0.05" group="3"/>
      <geom class="look" mesh="cube" pos="0.02 0.01 0.03" quat="0.9 0.1 0.2 0.3"/>
"""
LEG = """\
      <body name="{n}_hip" pos="{x} {y} 0" quat="{quat}">
        <inertial mass="0.7" pos="0 0 0" diaginertia="0.0005 0.0006 0.0007"/>
        <joint name="{n}_hip_joint" axis="{axis}" range="-0.9 0.9"/>
        <body name="{n}_thigh" pos="{aside}">
          <inertial mass="1" pos="0 0 -0.03" diaginertia="0.005 0.0046 0.0008" quat="0.9 0.1 0.1 0"/>
          <joint name="{n}_thigh_joint" axis="{pitch}" range="-0.7 3"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" group="3"/>
          <geom class="look" mesh="cube" pos="0 0.01 -0.1"/>
          <body name="{n}_calf" pos="0 0 -0.21">
            <inertial mass="0.2" pos="0 0 -0.1" diaginertia="0.0015 0.0015 0.00004"/>
            <joint name="{n}_calf_joint" class="calf" axis="{pitch}"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.21" size="0.01" group="3"/>
            <body name="{n}_end" pos="0 0 -0.21">
              <inertial mass="0.05" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>
              <geom type="sphere" size="0.023" priority="1" condim="6" solimp="0.015 1 0.023" group="3"/>
            </body>
          </body>
        </body>
      </body>
"""
# the hind legs' frames are turned by 90 degrees about z
TURNED = dict(quat="0.7071067811865476 0 0 0.7071067811865476", axis="0 -1 0", pitch="1 0 0")
PLAIN = dict(quat="1 0 0 0", axis="1 0 0", pitch="0 1 0")
LEGS = ("FR", -1, 1), ("FL", 1, 1), ("RR", -1, -1), ("RL", 1, -1)
HOME = '<keyframe><key name="home" qpos="0 0 0.3 1 0 0 0{}"/></keyframe>'.format(" 0 0.8 -1.5" * 4)


def mjcf(home: str = HOME, legs=LEGS) -> str:
    """The text of its file."""
    out = HEAD
    for name, left, ahead in legs:
        frame = PLAIN if ahead > 0 else TURNED
        aside = f"0 {0.08 * left} 0" if ahead > 0 else f"{0.08 * left} 0 0"
        out += LEG.format(n=name, x=0.19 * ahead, y=0.05 * left, aside=aside, **frame)
    out += "    </body>\n  </worldbody>\n  <actuator>\n"
    for name, *_ in legs:
        for joint in ("hip", "thigh", "calf"):
            kind = "calf" if joint == "calf" else "toy"
            out += f'    <position class="{kind}" name="{name}_{joint}" joint="{name}_{joint}_joint"/>\n'
    return out + f"  </actuator>\n  {home}\n</mujoco>\n"


def write(folder: Path, text: str | None = None) -> Path:
    """The file with its mesh and its licence, in `folder`."""
    (folder / "assets").mkdir(parents=True, exist_ok=True)
    (folder / "assets" / "cube.obj").write_text(CUBE)
    (folder / "LICENSE").write_text("BSD-3-Clause, Copyright 2026 Somebody\n")
    file = folder / "toy.xml"
    file.write_text(mjcf() if text is None else text)
    return file


LINK = """\
  <link name="{name}">
    <inertial><origin xyz="{com}"/><mass value="{mass}"/>
      <inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>
  </link>
"""
JOINT = """\
  <joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{link}"/>
    <origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/>
    <limit lower="-2.8" upper="2.8" effort="30" velocity="21"/></joint>
"""


def urdf() -> str:
    """The same robot's sibling as a URDF: no actuators, no pose, a mesh that is not there, a bad inertia."""
    box, rod, ball = (
        '<box size="0.3 0.12 0.1"/>',
        '<cylinder radius="0.015" length="0.15"/>',
        '<sphere radius="0.023"/>',
    )
    out = '<robot name="toy">\n' + LINK.format(
        name="base", mass=6, i=0.06, com="0 0 0", at="0 0 0", shape=box
    )
    out += """\
  <link name="camera"><inertial><mass value="0.1"/>
    <inertia ixx="0" iyy="0" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://toy/meshes/camera.dae"/></geometry></visual></link>
"""
    out += JOINT.format(
        name="on",
        kind="fixed",
        above="base",
        link="camera",
        at="0.2 0 0",
        rpy="0 0 0",
        axis="1 0 0",
    )
    for name, left, ahead in LEGS:
        above = "base"
        chain = [
            ("hip", f"{0.19 * ahead} {0.05 * left} 0", "1 0 0", 0.7, 0.0006),
            ("thigh", f"0 {0.08 * left} 0", "0 1 0", 1.0, 0.005),
            ("calf", "0 0 -0.21", "0 1 0", 0.2, 0.0015),
        ]
        for joint, at, axis, mass, i in chain:
            link = f"{name}_{joint}"
            out += LINK.format(
                name=link, mass=mass, i=i, com="0 0 -0.05", at="0 0 -0.08", shape=rod
            )
            out += JOINT.format(
                name=f"{link}_joint",
                kind="revolute",
                above=above,
                link=link,
                at=at,
                rpy="0 0 0",
                axis=axis,
            )
            above = link
        out += LINK.format(
            name=f"{name}_foot", mass=0.05, i=1e-5, com="0 0 0", at="0 0 0", shape=ball
        )
        out += JOINT.format(
            name=f"{name}_end", kind="fixed", above=above, link=f"{name}_foot", at="0 0 -0.21", rpy="0 0 0",
            axis="1 0 0",
        )  # fmt: skip
    return out + "</robot>\n"

"""What a stranger reads when a robot file breaks the contract: one line, file, expected, found.

Every case edits the text of a shipped file as a person would get it wrong.
"""

import re

import numpy as np
import pytest

from dynappo import config
from dynappo.config import files
from dynappo.physics import robot

GO1 = files.find("robots", "go1/go1.xml").read_text()


def edit(*pairs):
    """`text -> text` that replaces each first `old` by `new`; `old` must be there."""

    def apply(text):
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new, 1)
        return text

    return apply


def cut(pattern):
    """`text -> text` without what the regular expression finds first."""

    def apply(text):
        found, count = re.subn(pattern, "", text, count=1, flags=re.DOTALL)
        assert count, pattern
        return found

    return apply


def chain(*edits):
    def apply(text):
        for one in edits:
            text = one(text)
        return text

    return apply


def swap(first, second):
    return edit((first, "\0"), (second, first), ("\0", second))


def move(geom, body):
    """`text -> text` with the foot of one leg written into another body."""
    line = f'<geom name="{geom}" class="foot"/>'
    return lambda text: re.sub(
        rf'(<body name="{body}"[^>]*>)', rf"\1{line}", text.replace(line, ""), count=1
    )


def message(tmp_path, change):
    """What follows the file's path in the error of go1.xml with `change` applied."""
    path = tmp_path / "mine.xml"
    path.write_text(change(GO1))
    with pytest.raises(config.ConfigError) as caught:
        robot.load_xml(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text
    return text.removeprefix(f"{path}: ")


HIP, THIGH = '<joint name="FL_hip_joint" class="hip"', '<joint name="FL_thigh_joint" class="thigh"'
FOOT = '<geom name="FL_foot" class="foot"'
FLOOR = '<geom name="floor" type="plane" size="0 0 0.05" contype="1" conaffinity="0"'
MOTOR = '<motor name="FL_thigh_joint" joint="FL_thigh_joint"'
LEGS = "the foot geoms in the last body of each leg, in the order of the legs"
CHAIN = "each leg to be a chain of three bodies from the base, hip to knee"
MOTORS = "one motor of gear 1 a joint, named and ordered as the joints"
TREE = {
    "no free joint, although home has its seven numbers": (
        edit(('<freejoint name="root"/>', "")),
        "a free joint on the base, before all other joints, found FL_hip_joint (hinge)",
    ),
    "two top-level bodies": (
        edit(("</worldbody>", '<body name="ball"/></worldbody>')),
        "one top-level body, the base, found trunk, ball",
    ),
    "a slide joint": (
        edit((HIP, f'{HIP} type="slide"')),
        "12 hinge joints after the free one, found FL_hip_joint (slide)",
    ),
    "a missing knee, although home and the motors have it": (
        edit(('<joint name="RR_calf_joint" class="calf"/>', "")),
        "12 hinge joints after the free one, found 11",
    ),
    "joints named part first": (
        lambda text: re.sub(r"(\w\w)_(hip|thigh|calf)_joint", r"\2_joint_\1", text),
        "the three joints LEG_... of each of four legs in turn, found hip_joint_FL thigh_joint_FL "
        "calf_joint_FL hip_joint_FR",
    ),
    "a foot in a body of its own": (
        edit((f"{FOOT}/>", f'<body name="FL_toe"><geom size="0.02"/>{FOOT}/></body>')),
        "links without a joint merged into their parent, found FL_toe",
    ),
    "a missing inertial": (
        cut(r'(?<=<joint name="FL_calf_joint" class="calf"/>)\s*<inertial[^>]*/>'),
        "an inertial in every body, found none in FL_calf",
    ),
    "a knee beside its thigh": (
        chain(
            cut(r'<body name="FL_thigh".*?(?=<body name="FL_calf")'),
            edit(
                (
                    '<body name="FL_hip"',
                    '<body name="FL_thigh"><joint name="FL_thigh_joint" class="thigh"/>'
                    '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body><body name="FL_hip"',
                ),
                ("</body>\n        </body>\n      </body>", "</body>\n      </body>"),
            ),
            edit(
                ("FL_thigh_joint", "\0"), ("FL_hip_joint", "FL_thigh_joint"), ("\0", "FL_hip_joint")
            ),
        ),
        CHAIN + ", found FL_hip in trunk, not in FL_thigh",
    ),
    "a turned thigh": (
        edit(('<body name="FL_thigh"', '<body name="FL_thigh" euler="0 0.1 0"')),
        "leg bodies with frames parallel to the base's (no quat, no euler), found FL_thigh turned",
    ),
    "a joint beside its body's origin": (
        edit((THIGH, f'{THIGH} pos="0 0.01 0"')),
        "joints without pos and ref: at their body's origin, zero where frames are parallel, "
        "found FL_thigh_joint",
    ),
    "a joint with another zero": (
        edit((THIGH, f'{THIGH} ref="0.8"')),
        "joints without pos and ref: at their body's origin, zero where frames are parallel, "
        "found FL_thigh_joint",
    ),
    "a joint without a range, as Menagerie's ANYmal-B": (
        edit((' range="-0.686 4.501"', "")),
        "a range at every joint, found none at FL_thigh_joint",
    ),
}
ACTUATORS = {
    "two motors swapped": (
        swap('"FL_hip_joint" joint="FL_hip_joint"', '"FL_calf_joint" joint="FL_calf_joint"'),
        MOTORS + ", found FL_calf_joint on FL_calf_joint as number 1 where FL_hip_joint should be",
    ),
    "a motor on another joint": (
        edit((MOTOR, '<motor name="FL_thigh_joint" joint="FR_thigh_joint"')),
        MOTORS
        + ", found FL_thigh_joint on FR_thigh_joint as number 2 where FL_thigh_joint should be",
    ),
    "a motor named after its link, as Menagerie's": (
        edit(('<motor name="FL_hip_joint"', '<motor name="FL_hip"')),
        MOTORS + ", found FL_hip on FL_hip_joint as number 1 where FL_hip_joint should be",
    ),
    "the last motor missing": (
        edit(('<motor name="RR_calf_joint" joint="RR_calf_joint"/>', "")),
        MOTORS + ", found none for RR_calf_joint",
    ),
    "a motor too many": (
        edit(("</actuator>", '<motor joint="RR_calf_joint"/></actuator>')),
        MOTORS + ", found 13 actuators",
    ),
    "a motor that pushes at a site": (
        edit((MOTOR, '<motor name="FL_thigh_joint" site="imu"')),
        MOTORS + ", found FL_thigh_joint on no joint as number 2 where FL_thigh_joint should be",
    ),
    "a servo": (
        edit((MOTOR, '<position name="FL_thigh_joint" kp="20" joint="FL_thigh_joint"')),
        MOTORS + ", found FL_thigh_joint of another gear, gain or kind",
    ),
    "a filter": (
        edit(
            (
                MOTOR,
                '<general dyntype="filter" dynprm="1" name="FL_thigh_joint" joint="FL_thigh_joint"',
            )
        ),
        MOTORS + ", found FL_thigh_joint of another gear, gain or kind",
    ),
    "a gear": (
        edit((MOTOR, f'{MOTOR} gear="9"')),
        MOTORS + ", found FL_thigh_joint of another gear, gain or kind",
    ),
    "a limit of the motor": (
        edit((MOTOR, f'{MOTOR} ctrlrange="-1 1"')),
        "motors without limits, which are the config's, found one at FL_thigh_joint",
    ),
    "a limit at the joint": (
        edit((THIGH, f'{THIGH} actuatorfrcrange="-9 9"')),
        "motors without limits, which are the config's, found one at FL_thigh_joint",
    ),
}
GEOMS = {
    "no floor": (
        cut(r'<geom name="floor"[^>]*/>'),
        "a geom named floor, not in group 2, found no plane",
    ),
    "a floor of another name": (
        edit(('<geom name="floor"', '<geom name="ground"')),
        "a geom named floor, not in group 2, found ground",
    ),
    "a floor among the looks": (
        edit((FLOOR, f'{FLOOR} group="2"')),
        "a geom named floor, not in group 2, found no plane",
    ),
    "a floor that is a box": (
        edit((FLOOR, '<geom name="floor" type="box" size="9 9 1" contype="1" conaffinity="0"')),
        "the geom floor to be a plane at height 0 of the world, found type box, pos [0. 0. 0.], "
        "quat [1. 0. 0. 0.]",
    ),
    "a slope": (
        edit((FLOOR, f'{FLOOR} quat="0.8 0.6 0 0"')),
        "the geom floor to be a plane at height 0 of the world, found type plane, "
        "pos [0. 0. 0.], quat [0.8 0.6 0. 0. ]",
    ),
    "a raised floor": (
        edit((FLOOR, f'{FLOOR} pos="0 0 0.1"')),
        "the geom floor to be a plane at height 0 of the world, found type plane, "
        "pos [0. 0. 0.1], quat [1. 0. 0. 0.]",
    ),
    "a floor with MuJoCo's own defaults": (
        edit((FLOOR, '<geom name="floor" type="plane" size="0 0 0.05"')),
        "the geom floor with contype 1 and conaffinity 0, found 1 and 1",
    ),
    "parts that collide with one another": (
        edit(
            (
                '<geom name="base_box" class="collision"',
                '<geom name="base_box" contype="1" class="collision"',
            )
        ),
        "contype 0 at every geom but the floor, found base_box",
    ),
    "a foot of another name": (
        edit(('"FR_foot"', '"FR_toe"')),
        "4 sphere geoms named LEG_foot, found FL_foot, RL_foot, RR_foot",
    ),
    "feet among the looks": (
        edit(
            (
                '<default class="foot">\n        <geom ',
                '<default class="foot">\n        <geom group="2" ',
            )
        ),
        "4 sphere geoms named LEG_foot, found none outside group 2",
    ),
    "a foot that is a cylinder": (
        edit((FOOT, f'{FOOT} type="cylinder" size="0.02 0.02"')),
        "the feet to be spheres, found another FL_foot",
    ),
    "a foot that meets nothing": (
        edit((FOOT, f'{FOOT} conaffinity="0"')),
        "the feet to touch the floor (conaffinity 1), found another FL_foot",
    ),
    "a foot with the floor's friction": (
        edit((FOOT, f'{FOOT} priority="0"')),
        "the feet of higher priority than the floor, found another FL_foot",
    ),
    "two feet with swapped names": (
        swap('"FL_foot"', '"FR_foot"'),
        LEGS + ", found FR_foot in FL_calf where FL_foot should be",
    ),
    "a foot in another leg": (
        move("FL_foot", "FR_calf"),
        LEGS + ", found none in FL_calf where FL_foot should be",
    ),
    "a foot on the thigh": (
        move("RL_foot", "RL_thigh"),
        LEGS + ", found none in RL_calf where RL_foot should be",
    ),
    "an ellipsoid that touches": (
        edit(('class="collision" type="box"', 'class="collision" type="ellipsoid"')),
        "parts of type box, sphere, capsule or cylinder, not base_box",
    ),
    "rolling friction, as Menagerie's feet": (
        edit((FOOT, f'{FOOT} condim="6"')),
        "condim 1 or 3 where something touches the floor, found FL_foot",
    ),
}
POSE = {
    "a keyframe of another name": (
        edit(('<key name="home"', '<key name="stand"')),
        "a keyframe named home, found stand",
    ),
    "no keyframe": (
        cut(r"<keyframe>.*?</keyframe>"),
        "a keyframe named home, found none",
    ),
    "a joint forgotten in home, which MuJoCo fills with a zero at the end": (
        edit(("0.1 0.8 -1.5", "0.1 0.8")),
        "19 numbers in the keyframe home, found 18",
    ),
    "a knee bent the other way": (
        edit(("0.1 0.8 -1.5", "0.1 0.8 1.5")),
        "the keyframe home within the joints' ranges, found FL_calf_joint at 1.5, outside -2.818 "
        "to -0.888",
    ),
    "a base turned round": (
        edit(("0.324767989  1 0 0 0", "0.324767989  0 0 0 1")),
        "the keyframe home upright, found quat [0. 0. 0. 1.]",
    ),
    "a base too high": (
        edit(("0.324767989  1 0 0 0", "0.4  1 0 0 0")),
        "the keyframe home with the lowest foot on the floor, found it at 0.0752 m; the base "
        "belongs at 0.324768 m",
    ),
    "a part under the floor": (
        edit(
            (
                f"{FOOT}/>",
                f'{FOOT}/><geom name="FL_spur" class="collision" type="box" size="0.1 0.1 0.3"/>',
            )
        ),
        "no part but the feet at the floor in the keyframe home, found FL_spur",
    ),
    "a camera of another name": (
        edit(('<camera name="track"', '<camera name="side"')),
        "a camera named track",
    ),
}


@pytest.mark.parametrize("case", [*TREE, *ACTUATORS, *GEOMS, *POSE])
def test_the_message_names_the_rule_and_what_breaks_it(tmp_path, case):
    change, expected = (TREE | ACTUATORS | GEOMS | POSE)[case]
    assert message(tmp_path, change).startswith(f"expected {expected}")


def test_mujocos_own_errors_keep_the_element_and_the_line(tmp_path):
    text = message(tmp_path, edit(('mass="0.195862"', 'mass="0"')))
    assert "mass and inertia of moving bodies" in text and "FL_calf" in text
    assert "line" in message(tmp_path, edit((FLOOR, f'{FLOOR} colour="red"')))


def test_a_file_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(config.ConfigError) as caught:
        robot.load_xml(tmp_path / "none.xml")
    assert str(tmp_path / "none.xml") in str(caught.value) and "\n" not in str(caught.value)


def test_home_need_not_be_the_first_keyframe(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(edit(("<keyframe>", '<keyframe><key name="other"/>'))(GO1))
    expected = robot.load("go1").home_qpos
    np.testing.assert_array_equal(robot.load_xml(path).home_qpos, expected)

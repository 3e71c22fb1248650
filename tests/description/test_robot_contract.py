"""What a stranger reads when a robot's file lacks something: a note a change, or one line that refuses it.

Every case edits the text of a shipped file as a person would get it wrong.
"""

import copy
import re
import warnings

import numpy as np
import pytest

from dynappo import config
from dynappo.config import files
from dynappo.description import robot, robot_contract

GO1 = files.find("robots", "go1/go1.xml").read_text()
DOOR = '<body name="door"><joint/><geom size="1"/><body><joint/><geom size="1"/></body></body>'


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
REPLACED = "{} actuators are replaced by one motor a joint; gains and limits are the config's"
LEVEL = "the floor is made level, at height 0"
REFUSED = {
    "a slide joint": (
        edit((HIP, f'{HIP} type="slide"')),
        "hinge joints after the free one; make hinges of, or fix, all others, found FL_hip_joint (slide)",
    ),
    "a base that is not free, but turns": (
        edit(('<freejoint name="root"/>', '<joint name="root"/>')),
        "a free joint on the base, found root on trunk; give the base a freejoint",
    ),
    "a second robot": (
        edit(("</worldbody>", f"{DOOR}</worldbody>")),
        "one robot, found trunk, door; take the others out of the file",
    ),
    "no joints": (
        lambda text: re.sub(r'<(joint|motor) name="\w\w_[^>]*/>', "", text),
        "hinge joints, found none",
    ),
    "a joint's name that no policy may have": (
        lambda text: text.replace("FL_hip_joint", "FL_" + "hip" * 40),
        "names of joints of at most 100 plain characters, found 'FL_hiphiphip...phiphiphiphip'",
    ),
    "a joint's name of two lines": (
        lambda text: text.replace("FL_hip_joint", "FL&#10;hip"),
        r"names of joints of at most 100 plain characters, found 'FL\nhip'",
    ),
    "a foot in another leg": (
        move("FL_foot", "FR_calf"),
        "one foot in a body, found more in FR_calf",
    ),
    "a foot in the base": (
        move("FL_foot", "trunk"),
        "feet in bodies that joints move, not in the base, found FL_foot",
    ),
    "shapes of a foot in two bodies": (
        edit((f"{FOOT}/>", f'{FOOT}/><geom name="RL_foot2" class="foot"/>')),
        "the shapes of the foot RL in one body; name the others differently, found FL_calf, RL_calf",
    ),
    "a foot of another name": (
        edit(('"FR_foot"', '"FR_toe"')),
        "no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe home, "
        "found FR_toe",
    ),
    "a part under the floor": (
        edit(
            (
                f"{FOOT}/>",
                f'{FOOT}/><geom name="FL_spur" class="collision" type="box" size="0.1 0.1 0.3"/>',
            )
        ),
        "no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe home, "
        "found FL_spur",
    ),
}
# `change, notes, whether it then moves as Go1 does`
COMPLETED = {
    "no free joint": (
        edit(('<freejoint name="root"/>', "")),
        ["trunk moves freely: a free joint is added"],
        True,
    ),
    "no free joint, nor its seven numbers in home": (
        chain(
            edit(('<freejoint name="root"/>', "")),
            edit(("0 0 0.324767989  1 0 0 0", "")),
        ),
        [
            "trunk moves freely: a free joint is added",
            "in the home pose, the base is at 0.3248 m, with the feet on the floor",
        ],
        True,
    ),
    "something beside the robot": (
        edit(("</worldbody>", '<body name="ball"/><geom name="wall" size="1"/></worldbody>')),
        ["the scene is left out: ball, wall"],
        True,
    ),
    "two motors swapped": (
        swap('"FL_hip_joint" joint="FL_hip_joint"', '"FL_calf_joint" joint="FL_calf_joint"'),
        [REPLACED.format(12)],
        True,
    ),
    "a motor on another joint": (
        edit((MOTOR, '<motor name="FL_thigh_joint" joint="FR_thigh_joint"')),
        [REPLACED.format(12)],
        True,
    ),
    "a motor named after its link, as Menagerie's": (
        edit(('<motor name="FL_hip_joint"', '<motor name="FL_hip"')),
        [REPLACED.format(12)],
        True,
    ),
    "the last motor missing": (
        edit(('<motor name="RR_calf_joint" joint="RR_calf_joint"/>', "")),
        [REPLACED.format(11)],
        True,
    ),
    "no motors": (
        cut(r"<actuator>.*?</actuator>"),
        ["there are no actuators, but now one motor a joint; gains and limits are the config's"],
        True,
    ),
    "a motor too many": (
        edit(("</actuator>", '<motor joint="RR_calf_joint"/></actuator>')),
        [REPLACED.format(13)],
        True,
    ),
    "a motor that pushes at a site": (
        edit((MOTOR, '<motor name="FL_thigh_joint" site="imu"')),
        [REPLACED.format(12)],
        True,
    ),
    "a servo": (
        edit((MOTOR, '<position name="FL_thigh_joint" kp="20" joint="FL_thigh_joint"')),
        [REPLACED.format(12)],
        True,
    ),
    "a filter": (
        edit(
            (
                MOTOR,
                '<general dyntype="filter" dynprm="1" name="FL_thigh_joint" joint="FL_thigh_joint"',
            )
        ),
        [REPLACED.format(12)],
        True,
    ),
    "a gear": (edit((MOTOR, f'{MOTOR} gear="9"')), [REPLACED.format(12)], True),
    "a limit of the motor": (
        edit((MOTOR, f'{MOTOR} ctrlrange="-1 1"')),
        [REPLACED.format(12)],
        True,
    ),
    "limits of all motors, as a default": (
        edit(('<motor gear="1"/>', '<motor gear="2" ctrlrange="-1 1"/>')),
        [REPLACED.format(12)],
        True,
    ),
    "no floor": (
        cut(r'<geom name="floor"[^>]*/>'),
        ["there is no plane in the world: a floor is added"],
        False,  # its friction, which does not count
    ),
    "a floor of another name": (
        edit(('<geom name="floor"', '<geom name="ground"')),
        ["the plane ground is the floor"],
        True,
    ),
    "a floor among the looks": (edit((FLOOR, f'{FLOOR} group="2"')), [], True),
    "a floor that is a box": (
        edit((FLOOR, '<geom name="floor" type="box" size="9 9 1" contype="1" conaffinity="0"')),
        ["the scene is left out: floor", "there is no plane in the world: a floor is added"],
        False,
    ),
    "a slope": (edit((FLOOR, f'{FLOOR} quat="0.8 0.6 0 0"')), [LEVEL], True),
    "a raised floor": (edit((FLOOR, f'{FLOOR} pos="0 0 0.1"')), [LEVEL], True),
    "a floor with MuJoCo's own defaults": (
        edit((FLOOR, '<geom name="floor" type="plane" size="0 0 0.05"')),
        ["the floor touches shapes of contype 0 (contype 1, conaffinity 0)"],
        True,
    ),
    "parts that collide with one another": (
        edit(
            (
                '<geom name="base_box" class="collision"',
                '<geom name="base_box" contype="1" class="collision"',
            )
        ),
        ["shapes touch the floor only, not one another"],
        True,
    ),
    "feet among the looks": (
        edit(
            (
                '<default class="foot">\n        <geom ',
                '<default class="foot">\n        <geom group="2" ',
            )
        ),
        [],
        True,
    ),
    "a foot that meets nothing": (
        edit((FOOT, f'{FOOT} conaffinity="0"')),
        ["shapes touch the floor only, not one another"],
        True,
    ),
    "a foot with the floor's friction": (
        edit((FOOT, f'{FOOT} priority="0"')),
        ["the feet's friction holds, not the floor's (priority 1)"],
        True,
    ),
    "rolling friction, as Menagerie's feet": (
        edit((FOOT, f'{FOOT} condim="6"')),
        ["contacts slide, but neither twist nor roll (condim 3): FL_foot"],
        True,
    ),
    "an ellipsoid that touches": (
        edit(('class="collision" type="box"', 'class="collision" type="ellipsoid"')),
        [
            "meshes and ellipsoids collide as primitives around them: base_box: capsule of 0.114 x "
            "0.376 m"
        ],
        False,
    ),
    "a keyframe of another name": (
        edit(('<key name="home"', '<key name="stand"')),
        ["the home pose is the keyframe stand"],
        True,
    ),
    "a base turned round": (
        edit(("0.324767989  1 0 0 0", "0.324767989  0 0 0 1")),
        ["in the home pose, the base is set upright"],
        True,
    ),
    "a base too high": (
        edit(("0.324767989  1 0 0 0", "0.4  1 0 0 0")),
        ["in the home pose, the base is at 0.3248 m, with the feet on the floor"],
        True,
    ),
    "a knee bent the other way": (
        edit(("0.1 0.8 -1.5", "0.1 0.8 1.5")),
        [
            "in the home pose, brought into their range: FL_calf_joint",
            "in the home pose, the base is at 0.3738 m, with the feet on the floor",
        ],
        False,
    ),
    "a joint forgotten in home": (
        edit(("0.1 0.8 -1.5", "0.1 0.8")),
        [
            "the keyframe home is left out: it has 18 numbers, not 19",
            "no keyframe fits: the home pose has all joints at rest",
            "in the home pose, brought into their range: FL_calf_joint, FR_calf_joint, RL_calf_joint, "
            "RR_calf_joint",
            "in the home pose, the base is at 0.3704 m, with the feet on the floor",
        ],
        False,
    ),
    "no camera": (cut(r"<camera[^>]*/>"), ["a camera track is added"], True),
    # what needs no change, and is another robot
    "joints named part first": (
        lambda text: re.sub(r"(\w\w)_(hip|thigh|calf)_joint", r"\2_joint_\1", text),
        [],
        False,
    ),
    "a turned thigh": (
        edit(('<body name="FL_thigh"', '<body name="FL_thigh" euler="0 0.01 0"')),
        [],
        False,
    ),
    "a joint beside its body's origin": (edit((THIGH, f'{THIGH} pos="0 0.01 0"')), [], False),
    "a joint without a range, as Menagerie's ANYmal-B": (
        edit((' range="-0.686 4.501"', "")),
        [],
        False,
    ),
    "a foot that is a cylinder": (
        edit((FOOT, f'{FOOT} type="cylinder" size="0.02 0.02"')),
        [],
        False,
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_the_message_names_the_rule_and_what_breaks_it(tmp_path, case):
    change, expected = REFUSED[case]
    assert message(tmp_path, change).startswith(f"expected {expected}")


SPUR = '<geom name="FL_spur" class="collision" type="box" size="0.1 0.1 0.3"/>'


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    """With the tree: options. Where the tree is right: feet, parts, motors."""
    change = edit(
        (HIP, f'{HIP} type="slide"'),
        ('gravity="0 0 -9.81"', 'gravity="0 0 9.81"'),
        ("<flag eulerdamp", "<flag contact='disable' limit='disable' eulerdamp"),
    )
    assert message(tmp_path, change) == (
        "expected hinge joints after the free one; make hinges of, or fix, all others, found FL_hip_joint "
        "(slide); expected no <flag> in <option> that disables what a robot needs, found contact, limit; "
        "expected gravity that points down (option gravity), found 0 0 9.81"
    )
    change = chain(
        move("FR_foot", "trunk"),
        edit((f"{FOOT}/>", f'{FOOT}/><geom name="RL_foot2" class="foot"/>{SPUR}')),
    )
    assert message(tmp_path, change) == (
        "expected the shapes of the foot RL in one body; name the others differently, found FL_calf, RL_calf"
        "; expected one foot in a body, found more in FL_calf; expected feet in bodies that joints move, not "
        "in the base, found FR_foot; expected no part but the feet at the floor in the home pose; name it "
        "NAME_foot, or give a keyframe home, found FL_spur"
    )


def test_each_thing_that_breaks_a_rule_is_named_and_each_rule_of_a_subject():
    """Motors of four joints and the damping of a fifth; both rules of the home pose, both of parts."""
    model = copy.copy(robot.load("go1").mj_model)
    model.actuator_gear[1:5, 0] = 2
    model.actuator_damping[7] = 0.1
    with pytest.raises(ValueError) as error:
        robot_contract.check(model)
    expected = "expected one motor of gear 1 a joint, named and ordered as the joints, found "
    first = ", ".join(f"{model.joint(i + 1).name} of another gear, gain or kind" for i in (1, 2, 3))
    damped = (
        f"armature and damping at the joints, not at motors, found some at {model.joint(8).name}"
    )
    assert str(error.value) == f"{expected}{first} and 1 more; expected {damped}"
    model = copy.copy(robot.load("go1").mj_model)
    model.key_qpos[0, 2] -= 0.4
    part = robot_contract.parts_of(model)[0]
    model.geom_condim[part], model.geom_bodyid[part] = 6, 0
    with pytest.raises(ValueError) as error:
        robot_contract.check(model)
    rules = str(error.value).split("; expected ")
    assert [rule.split(", found")[0] for rule in rules] == [
        "expected what touches the floor (conaffinity) to be on the robot",
        "condim 1 or 3 where something touches the floor",
        "the keyframe home with the lowest foot on the floor",
        "no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe home",
    ]


@pytest.mark.parametrize("case", COMPLETED)
def test_a_file_is_completed_and_each_change_is_told(tmp_path, case):
    change, notes, same = COMPLETED[case]
    path = tmp_path / "mine.xml"
    path.write_text(change(GO1))
    found, go1 = robot.load_xml(path), robot.load("go1")
    assert list(found.notes) == notes and not go1.notes
    assert robot.same(found, go1) == same
    assert found.foot_names == go1.foot_names and found.mj_model.nv == 18


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


def test_mujocos_warnings_leave_no_file(tmp_path, monkeypatch):
    """Of a mass that a solver cannot take: when it is read, and when `look` computes with it."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.xml"
    path.write_text(edit(('mass="0.195862"', 'mass="1e300"'))(GO1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of MuJoCo's compiler
        robot.damping_rate(robot.load_xml(path), 0.5, 0.005)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.xml"]

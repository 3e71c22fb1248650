"""What a stranger reads when a robot's file lacks something: a note a change, or one line that refuses it.

Every case edits the text of a shipped file as a person would get it wrong.
"""

import copy
import re
import warnings

import mujoco
import numpy as np
import pytest
from answers import refused

from dynappo import config
from dynappo.adopt import source
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
        "one foot in a body; the shapes of a foot are NAME_foot1, NAME_foot2, ..., found more in FR_calf",
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
    assert f"expected {expected}" in message(tmp_path, change)


SPUR = '<geom name="FL_spur" class="collision" type="box" size="0.1 0.1 0.3"/>'


# MuJoCo stops at each of these, some where it reads the file, some where it compiles it
PLUGIN = (
    '<extension><plugin plugin="mujoco.elasticity.cable"><instance name="c"/></plugin></extension>'
)
ROPE = '<flex name="rope" dim="1" body="FL_calf FR_calf" element="0 1" radius="0.01"/>'
EVERY_FAULT = chain(
    move("FR_foot", "trunk"),
    edit(
        ("<worldbody>", f"{PLUGIN}<wrong\n/><worldbody>"),
        ('<camera name="track"', '<plugin instance="c"/><camera name="track"'),
        ("</worldbody>", f"{DOOR}</worldbody><deformable>{ROPE}</deformable>"),
        ("<flag eulerdamp", "<flag contact='disable' limit='disable' eulerdamp"),
        ('gravity="0 0 -9.81"', 'gravity="0 0 9.81"'),
        ('timestep="0.005"', 'timestep="0.5"'),
        ('<freejoint name="root"/>', '<joint name="root"/>'),
        (HIP, f'{HIP} type="slide" colour="red"'),
        (THIGH, f'{THIGH} type="hing" damping="none"'),
        ('<joint name="FR_hip_joint" class="hip"', '<joint name="FR_hip_joint" class="hipp"'),
        ('<joint name="FR_calf_joint"', '<joint axis="0 0 0" name="FR_calf_joint"'),
        ('<joint name="RL_hip_joint"', '<joint name="RL&#10;hip"'),
        (MOTOR, MOTOR.replace('joint="FL', 'joint="XX')),
        (f"{FOOT}/>", f'{FOOT} type="box" size="0.1"/><geom name="RL_foot2" class="foot"/>'),
        ('mass="0.195862"', 'mass="0"'),
    ),
)
SAID_OF_EVERY_FAULT = [
    "Schema violation: unrecognized element: wrong (line ",
    "Schema violation: unrecognized attribute: 'colour': joint (line ",
    "invalid keyword: 'hing': joint (line ",
    "bad format in attribute 'damping': joint (line ",
    "unknown default class name 'hipp': joint (line ",
    "expected one robot, found trunk, door; take the others out of the file",
    "expected a free joint on the base, found root on trunk; give the base a freejoint",
    "expected hinge joints after the free one; make hinges of, or fix, all others, found FL_hip_joint ",
    "expected rigid bodies only, found 1 flex",
    "expected no plugins, found 1",
    "expected no <flag> in <option> that disables what a robot needs, found contact, limit",
    "expected gravity that points down (option gravity), found 0 0 9.81",
    "expected a timestep of 1e-05 to 0.1 s, found 0.5",
    "mass and inertia of moving bodies must be larger than mjMINVAL: FL_calf (line ",
    "axis too small in joint: FR_calf_joint (line ",
    "size 1 must be positive in geom: FL_foot (line ",
    "unknown transmission target 'XX_thigh_joint': FL_thigh_joint (line ",
    "unknown transmission target 'RL_hip_joint': RL_hip_joint (line ",
    "expected the shapes of the foot RL in one body; name the others differently, found FL_calf, RL_calf",
    "expected one foot in a body; the shapes of a foot are NAME_foot1, NAME_foot2, ..., found more in ",
    "expected feet in bodies that joints move, not in the base, found FR_foot",
    r"expected names of joints of at most 100 plain characters, found 'RL\nhip'",
]


def faults_in(text):
    """The faults of a message, each without its number; the number before them is theirs."""
    count, _, rest = text.partition(" faults: ")
    found = re.split(r"(?:^|; )\(\d+\) ", rest)[1:]
    assert len(found) == int(count)
    return found


@pytest.mark.parametrize("load", [robot.load_xml, source.read])
def test_all_that_is_wrong_is_said_at_once(load, tmp_path):
    """Of a file with a fault of every kind, to a run that names it and to `adopt`. Nothing of the default
    pose, which nobody knows."""
    path = tmp_path / "mine.xml"
    path.write_text(EVERY_FAULT(GO1))
    found = faults_in(refused(load, path).removeprefix(f"{path}: "))
    for one in SAID_OF_EVERY_FAULT:
        assert sum(one in fault for fault in found) == 1, one
    assert len(found) == len(SAID_OF_EVERY_FAULT), found
    lines = path.read_text().split("\n")
    for fault in found:  # the lines are the file's
        for name, line in re.findall(r"(\w+) \(line (\d+)\)", fault):
            assert name in lines[int(line) - 1], fault


def test_what_leaves_the_pose_as_it_is_hides_nothing_of_it(tmp_path):
    change = chain(
        move("FR_foot", "trunk"),
        edit(
            ('gravity="0 0 -9.81"', 'gravity="0 0 9.81"'),
            ('mass="0.195862"', 'mass="0"'),
            (f"{FOOT}/>", f"{FOOT}/>{SPUR}"),
        ),
    )
    found = faults_in(message(tmp_path, change))
    assert [one.split(", found")[0] for one in found[:1] + found[2:]] == [
        "expected gravity that points down (option gravity)",
        "expected feet in bodies that joints move, not in the base",
        "expected no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe "
        "home",
    ]
    assert "moving bodies must be larger than mjMINVAL: FL_calf (line " in found[1]
    assert found[1].endswith("); give each an inertial, or shapes that have a mass")


def test_where_there_is_no_robot_that_is_all(tmp_path):
    assert faults_in(
        message(tmp_path, lambda _: "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    ) == [
        "expected a free joint on the base, before all other joints, found no joint",
        "expected hinge joints, found none",
    ]


UNKNOWN_POSE = {
    "a joint of another kind": (THIGH, f'{THIGH} type="slide"'),
    "a class that is not there": (THIGH, THIGH.replace('"thigh"', '"thighs"')),
    "an axis of no length": (THIGH, f'{THIGH} axis="0 0 0"'),
    "a foot of no size": (f"{FOOT}/>", f'{FOOT} type="box" size="0.1"/>'),
}


@pytest.mark.parametrize("case", UNKNOWN_POSE)
def test_where_a_limb_may_be_elsewhere_nothing_is_said_of_the_pose(case, tmp_path):
    foot = '<geom name="FR_foot" class="foot"/>'
    said = message(tmp_path, edit((foot, foot + SPUR), UNKNOWN_POSE[case]))
    assert "pose" not in said and " faults: " not in said


def test_where_nothing_more_can_be_read_mujocos_error_is_all(tmp_path):
    """XML that ends in the middle, here or in a file that is included."""
    change = edit(("</worldbody>", "</worldbdy>"), ('gravity="0 0 -9.81"', 'gravity="0 0 9.81"'))
    assert message(tmp_path, change).startswith("XML parse error 14")
    include = edit(("<compiler", '<include file="more.xml"/><compiler'))
    (tmp_path / "more.xml").write_text('<mujoco><option colour="red"/></mujco>')
    assert "XML parse error 14" in message(tmp_path, include)
    twice = edit(("<compiler", '<include file="more.xml"/>' * 2 + "<compiler"))
    (tmp_path / "more.xml").write_text("<mujoco><option/></mujoco>")
    assert "already included" in message(tmp_path, twice)
    itself = '<mujoco><include file="more.xml"/></mujoco>'
    (tmp_path / "more.xml").write_text(itself)
    assert "already included" in message(tmp_path, include)
    assert "already included" in refused(source.read, tmp_path / "mine.xml")


def test_faults_of_included_files_are_told_with_their_file_and_line(tmp_path):
    """Those of a scene and of two files that it includes, one by the other; MuJoCo tells one, and no line."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "robot.xml").write_text(
        GO1.replace(MOTOR, MOTOR.replace("<motor", '<motor colour="red"'), 1).replace(
            "<compiler", '<include file="parts/more.xml"/> <compiler', 1
        )
    )
    (tmp_path / "parts/more.xml").write_text('<mujoco>\n<option\ncolour="red"/>\n</mujoco>')
    include = '<!-- <include file="no.xml"/> -->\n<include file="robot.xml"/>'
    scene = f'<mujoco>\n{include}\n<size colour="1"/>\n</mujoco>'
    (tmp_path / "scene.xml").write_text(scene)
    motor = 1 + GO1[: GO1.index(MOTOR)].count("\n")
    found = f"option (line 2 of more.xml), motor (line {motor} of robot.xml), size (line 4)"
    for load in (robot.load_xml, source.read):
        said = refused(load, tmp_path / "scene.xml")
        assert said.endswith(f"unrecognized attribute: 'colour': {found}")


@pytest.mark.parametrize("load", [robot.load_xml, source.read])
def test_an_included_file_is_looked_for_where_mujoco_looks(load, tmp_path):
    """In the folder of the first file, else in that of the file that includes it."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "scene.xml").write_text('<mujoco><include file="parts/robot.xml"/></mujoco>')
    (tmp_path / "parts/robot.xml").write_text(
        edit(("<compiler", '<include file="more.xml"/><compiler'))(GO1)
    )
    bad = '<mujoco><option colour="red"/></mujoco>'
    (tmp_path / "parts/more.xml").write_text("<mujoco>\n" + bad.removeprefix("<mujoco>"))
    assert refused(load, tmp_path / "scene.xml").endswith(": option (line 2 of more.xml)")
    (tmp_path / "more.xml").write_text("<mujoco>\n\n" + bad.removeprefix("<mujoco>"))
    assert refused(load, tmp_path / "scene.xml").endswith(": option (line 3 of more.xml)")


def test_what_cannot_be_compiled_is_told_with_the_line_of_its_own_file(tmp_path):
    """Of elements of several kinds in an included file, whose lines come later in the whole text."""
    (tmp_path / "scene.xml").write_text(
        '<mujoco>\n\n\n<include file="robot.xml"/>\n<size colour="1"/>\n</mujoco>'
    )
    line = 1 + GO1[: GO1.index("</worldbody>")].count("\n")
    for bad, name in (
        ('<site name="dot" type="box" size="0"/>', "dot"),
        ('<light name="lamp" texture="no"/>', "lamp"),
    ):
        (tmp_path / "robot.xml").write_text(edit(("</worldbody>", f"{bad}</worldbody>"))(GO1))
        said = refused(robot.load_xml, tmp_path / "scene.xml")
        assert f": {name} (line {line} of robot.xml)" in said
        # where the parser has nothing to say
        (tmp_path / "plain.xml").write_text('<mujoco>\n\n<include file="robot.xml"/></mujoco>')
        for load in (robot.load_xml, source.read):
            assert f": {name} (line {line} of robot.xml)" in refused(load, tmp_path / "plain.xml")


def test_every_rule_for_a_compiled_robot_is_broken_at_once():
    """One model that breaks what `complete` mends, and what it does not: no rule is left out."""
    change = chain(
        move("FR_foot", "trunk"),
        cut(r"<camera[^>]*/>"),
        edit(
            ('gravity="0 0 -9.81"', 'gravity="0 0 9.81"'),
            ("<flag eulerdamp", "<flag contact='disable' eulerdamp"),
            (MOTOR, MOTOR.replace("<motor", '<general dyntype="filter" dynprm="1"')),
            (FLOOR, f'{FLOOR} pos="0 0 1"'),
            (
                "</worldbody>",
                '<geom name="wall" contype="1" conaffinity="1" condim="6" size="1"/></worldbody>',
            ),
            (f"{FOOT}/>", f'{FOOT} priority="0"/><geom name="RL_foot2" class="foot"/>{SPUR}'),
            ('class="collision" type="box"', 'class="collision" type="ellipsoid"'),
            ('<joint name="RL_hip_joint"', '<joint name="RL&#10;hip"'),
            ('joint="RL_hip_joint"', 'joint="RL&#10;hip"'),
        ),
    )
    model = mujoco.MjModel.from_xml_string(change(GO1))
    with pytest.raises(ValueError) as error:
        robot_contract.check(model)
    found = faults_in(str(error.value))
    of_spec = {"_check_all", "_check_joints", "_check_rigid", "_check_timestep"}
    rules = {name for name in vars(robot_contract) if name.startswith("_check_")} - of_spec
    for name in rules:
        texts = [text for text in getattr(robot_contract, name)(model) if text]
        assert texts and set(texts) <= set(found), name


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
    assert faults_in(str(error.value)) == [f"{expected}{first} and 1 more", f"expected {damped}"]
    model = copy.copy(robot.load("go1").mj_model)
    model.key_qpos[0, 2] -= 0.4
    part = robot_contract.parts_of(model)[0]
    model.geom_condim[part], model.geom_bodyid[part] = 6, 0
    with pytest.raises(ValueError) as error:
        robot_contract.check(model)
    assert [rule.split(", found")[0] for rule in faults_in(str(error.value))] == [
        "expected what touches the floor (conaffinity) to be on the robot",
        "expected condim 1 or 3 where something touches the floor",
        "expected the keyframe home with the lowest foot on the floor",
        "expected no part but the feet at the floor in the home pose; name it NAME_foot, or give a keyframe "
        "home",
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

"""Numbers of joints: one for all, by patterns of names, or a tuple; in a file, a flag, JSON and a program."""

import json

import pytest
from answers import refused

from dynappo import config as config_lib
from dynappo.config import fields, per_joint
from dynappo.sweeps import grid

JOINTS = [f"{leg}_{kind}_joint" for leg in ("FL", "FR") for kind in ("hip", "thigh", "calf")]
MOTORS = "action_scale armature effort_limit joint_friction kd kp saturation_effort velocity_limit"
FIELDS = f"{MOTORS} posture_std posture_std_standing"


def load(**task):
    config = config_lib.load("go1:ppo16")
    config.task.update(**task)
    return config


def resolved(**task):
    return per_joint.resolved(config_lib.validate(load(**task)), JOINTS, "go1").task


def test_the_fields_are_those_of_motors_and_postures():
    assert sorted(per_joint.names()) == sorted(FIELDS.split())


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (60, 60.0),
        ({".*": 25}, 25.0),  # one number is the program of one number
        ((7, 7, 7, 7, 7, 7), 7.0),
        ({".*_calf_joint": 35, ".*": 25.0}, (25, 25, 35, 25, 25, 35)),
        ({"FL_calf_joint": 1, ".*calf.*": 2, "F[LR]_(hip|thigh)_joint": 3}, (3, 3, 1, 3, 3, 2)),
        ((1, 2, 3, 4, 5, 6), (1, 2, 3, 4, 5, 6)),
        ([1, 2, 3, 4, 5, 6], (1, 2, 3, 4, 5, 6)),
    ],
    ids=str,
)
def test_a_joint_takes_the_number_of_the_first_pattern_that_matches_its_whole_name(value, expected):
    config = load(kp=value)
    found = per_joint.resolved(config_lib.validate(config), JOINTS, "go1").task.kp
    assert found == expected and type(found) is type(expected)
    flat = [found] if isinstance(found, float) else found
    assert all(type(number) is float for number in flat)


BAD = {  # of task.kp
    "no joint is left out": ({".*_hip_joint": 1}, "no pattern of task.kp matches FL_thigh_joint"),
    "the whole name": (
        {"FL_": 1, ".*": 2},
        "the pattern 'FL_' of task.kp matches no joint of go1",
    ),
    "never the first": ({".*": 1, ".*calf.*": 2}, "'.*calf.*' of task.kp is never the first"),
    "no pattern": ({"*calf": 1, ".*": 2}, "is '*calf', expected a regular expression (nothing"),
    "slow": ({"(.*)*": 1}, "no group repeated"),
    "slow too": ({".*.*.*.*x": 1}, "3 of them * or +"),
    "long": ({"a" * 101: 1}, "at most 100 characters"),
    "a number too few": ((1, 2, 3, 4, 5), "task.kp has 5 numbers, expected 6"),
    "out of bounds": (
        {".*calf.*": -1, ".*": 1},
        "task.kp of '.*calf.*' is -1.0, expected 0 to 100,000",
    ),
    "one of them is": ((1, 2, 3, 4, 5, -6), "-6.0), expected 0 to 100,000"),
    "not finite": ({".*": float("nan")}, "task.kp of '.*' is nan, expected finite numbers"),
    "a comment": ({r"(?#[)(\w+\w+)+!(?#])": 1}, "expected no (? but in (?:"),
    "a flag": ({"(?x)#[\n(\\w+\\w+)+!#]": 1}, "expected no (? but in (?:"),
    "a text": ("stiff", "task.kp is 'stiff', expected float, a dict of floats by patterns"),
    "of texts": ({".*": "stiff"}, "expected float, a dict of floats by patterns"),
    "of truth": ((True,) * 6, "expected float, a dict of floats by patterns"),
    "no names": ({1: 2.0}, "expected float, a dict of floats by patterns"),
    "none": ({}, "expected float, a dict of floats by patterns"),
    "None": (None, "task.kp is None, expected float, a dict"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_one_line_with_field_pattern_and_joint(name):
    value, expected = BAD[name]
    assert expected in refused(resolved, kp=value)


def test_a_pair_is_no_range():
    """A range must rise; a robot of two joints may have any two numbers."""
    config = config_lib.validate(load(kp=(2.0, 1.0)))
    assert per_joint.resolved(config, ("one", "two"), "hopper").task.kp == (2.0, 1.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("60", 60.0),
        ("{'.*calf.*': 60, '.*': 25}", ((".*calf.*", 60.0), (".*", 25.0))),
        ("(1, 2.5)", (1.0, 2.5)),
        ("1,2", (1.0, 2.0)),
    ],
)
def test_a_flag_sets_one_number_or_several(text, value):
    config = load()
    config_lib.override(config, "task.kp", text)
    assert config.task.kp == value
    config_lib.override(config, "task.armature", text)  # None in the file
    assert config.task.armature == value


@pytest.mark.parametrize("text", ["{}", "None", "{'calf'}", "stiff", "{'.*': True}", "()"])
def test_a_flag_that_is_neither_is_refused(text):
    line = refused(config_lib.override, load(), "task.kp", text)
    assert line.startswith(f"--config.task.kp={text!r}: expected float, a dict") or text == "None"


def test_json_keeps_the_order_of_patterns_and_the_kind_of_each_value():
    config = load(kp={".*_calf_joint": 35, ".*": 25}, kd=(1, 2, 3, 4, 5, 6), armature={".*": 0.02})
    config = config_lib.validate(config)
    text = config_lib.to_json(config)
    assert json.loads(text)["task"]["kp"] == [[".*_calf_joint", 35.0], [".*", 25.0]]
    back = config_lib.validate(config_lib.from_json(text))
    assert config_lib.flat(back) == config_lib.flat(config)
    assert config_lib.difference(text, config_lib.to_json(back)) == ""
    assert config_lib.versions_apart(text, back) == ""
    config = load(kp=25.0, kd=(1, 2, 3, 4, 5, 6), armature={".*": 0.02})
    line = config_lib.difference(text, config_lib.to_json(config_lib.validate(config)))
    assert line == "task.kp [['.*_calf_joint', 35.0], ['.*', 25.0]] there, 25.0 here"


def test_a_run_of_before_has_one_number_and_no_armature_of_its_own():
    text = json.loads(config_lib.to_json(config_lib.validate(load())))
    del text["task"]["armature"], text["task"]["joint_friction"]
    found = config_lib.validate(config_lib.from_json(json.dumps(text)))
    assert (found.task.kp, found.task.armature, found.task.joint_friction) == (25.0, None, 0.0)
    assert config_lib.difference(json.dumps(text), config_lib.to_json(found)) == ""
    line = config_lib.versions_apart(json.dumps(text), found)
    assert "task.armature is new, and None" in line and "gone" not in line


def test_a_copy_does_not_share_the_value():
    one, other = load(), load()
    one.task.kp = {".*": 3.0}
    assert other.task.kp == fields.defaults().task.kp == 25.0
    assert fields.copied(one).task.kp == ((".*", 3.0),)


def test_a_program_takes_numbers_and_no_patterns():
    config = config_lib.validate(load(kp={".*calf.*": 35, ".*": 25}, armature=0.01))
    assert refused(config_lib.split, config).startswith("task.kp has a number for each kind")
    static, hyper = config_lib.split(per_joint.resolved(config, JOINTS, "go1"))
    assert hyper.task.kp == (25, 25, 35, 25, 25, 35) and hyper.task.kd == 0.5
    assert static.task.armature == 0.01 and not hasattr(hyper.task, "armature")


def test_a_sweep_of_numbers_is_one_program_and_each_pattern_another():
    swept = grid.read(["task.kp=20,30,{'.*calf.*': 35, '.*': 25},(1,2,3)"])
    assert swept == {"task.kp": ["20", "30", "{'.*calf.*': 35, '.*': 25}", "(1,2,3)"]}
    found = grid.combinations(load(), swept)
    assert [one.name for one in found] == [
        "task.kp=20.0",
        "task.kp=30.0",
        "task.kp=._calf._-35.0x._-25.0",
        "task.kp=1.0x2.0x3.0",
    ]
    groups = grid.groups(found, [0] * 4)
    assert [[one.config.task.kp for one in group] for group in groups] == [
        [20.0, 30.0],
        [((".*calf.*", 35.0), (".*", 25.0))],
        [(1.0, 2.0, 3.0)],
    ]
    for field in ("task.armature", "task.joint_friction"):  # in each model
        assert not grid.by_vmap(field)

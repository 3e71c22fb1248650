"""Kinds of joints, and patterns that give each joint its number again."""

import re

import pytest

from dynappo.description import kinds

LEGS = tuple(
    f"{leg}_{j}_joint" for leg in ("FL", "FR", "RL", "RR") for j in ("hip", "thigh", "calf")
)
BARKOUR = tuple(f"{j}_{leg}" for leg in ("front_left", "hind_right") for j in ("hip", "knee"))
BIPED = "LL_HR", "LL_HAA", "LR_HR", "LR_HAA", "waist_yaw", "left_hip_yaw", "right_hip_yaw"


def test_a_kind_is_a_name_without_its_side():
    assert list(kinds.kinds(LEGS)) == ["hip_joint", "thigh_joint", "calf_joint"]
    assert kinds.kinds(BARKOUR) == {"hip": [0, 2], "knee": [1, 3]}
    assert kinds.kinds(BIPED) == {"HR": [0, 2], "HAA": [1, 3], "waist_yaw": [4], "hip_yaw": [5, 6]}


@pytest.mark.parametrize("names", [LEGS, BARKOUR, BIPED, ("a", "aa", "b_a")])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_the_first_pattern_that_matches_has_the_joint_s_number(names, count):
    """By the words of the config: a pattern is for the whole name, and the first counts."""
    values = [float((7 * i) % count) for i in range(len(names))]
    found = kinds.patterns(names, values)
    if isinstance(found, float):
        assert {found} == set(values)
        return
    for name, value in zip(names, values, strict=True):
        assert next(v for p, v in found.items() if re.fullmatch(p, name)) == value


def test_patterns_are_short():
    assert kinds.patterns(LEGS, [24, 24, 36] * 4) == {".*_calf_joint": 36.0, ".*": 24.0}
    assert kinds.patterns(BARKOUR, [1, 2, 1, 2]) == {"knee_.*": 2.0, ".*": 1.0}

"""A robot that is another one: whatever of its compiled model differs, a run and a policy notice it."""

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
import workdirs
from answers import refused
from toy_policy import GO1
from workdirs import opened

from dynappo.description import robot

TEXT = GO1.xml.read_text()

CHANGES = {  # what is changed in the Go1, and whether it is another robot
    "a mass": ('mass="5.204"', 'mass="5.2041"', False),
    "a joint's range": ('range="-0.863 0.863"', 'range="-0.86 0.863"', False),
    "friction": ('friction="0.8', 'friction="0.9', False),
    "armature": ('armature="0.01"', 'armature="0.011"', False),
    "the default pose": ("0.1 0.8 -1.5", "0.1 0.81 -1.5", False),
    "the solver": ("<option ", '<option impratio="2" ', False),
    "a pair": (
        "</worldbody>",
        '</worldbody><contact><pair geom1="floor" geom2="FL_calf" condim="1"/></contact>',
        False,
    ),
    "a flag": ("<flag ", '<flag sensor="disable" ', False),
    "wind": ("<option ", '<option wind="1 0 0" density="1.2" ', False),
    "a colour": ('rgba="0.85 0.35 0.25 0.5"', 'rgba="0 1 0 1"', True),
    "a comment": ("<worldbody>", "<!-- here --><worldbody>", True),
    "the sky": ('<headlight ambient="0.42', '<headlight ambient="0.5', True),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_moves_otherwise_is_another_robot(tmp_path, name):
    before, after, same = CHANGES[name]
    assert before in TEXT
    (tmp_path / "go1.xml").write_text(TEXT.replace(before, after, 1))
    other = robot.load_xml(tmp_path / "go1.xml")
    assert robot.same(GO1, other) is robot.same(other, GO1) is same


def test_every_number_that_moves_a_robot_is_compared():
    """Of each array of a compiled model one number is changed; but for looks, names and what nobody reads,
    each makes another robot. Arrays that a Go1 has not are those of a robot with them."""
    spec = mujoco.MjSpec.from_string(TEXT)
    spec.add_pair(geomname1="floor", geomname2="FL_calf")
    spec.add_exclude(bodyname1="trunk", bodyname2="FL_calf")
    joint, kind = mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtEq.mjEQ_JOINT
    spec.add_equality(type=kind, objtype=joint, name1="FL_hip_joint", name2="FR_hip_joint")
    spec.add_tendon(name="tied").wrap_joint("FL_hip_joint", 1.0)
    model = spec.compile()
    before = {name: array.copy() for name, array in robot._motion(model).items()}
    same = set()
    for name in (name for name in dir(model) if name[0] != "_"):
        array = getattr(model, name)
        if not isinstance(array, np.ndarray) or not array.size:
            continue
        kept = array.copy()
        array.flat[-1] = not array.flat[-1] if array.dtype == bool else array.flat[-1] + 1
        after = robot._motion(model)
        if all(np.array_equal(before[n], after[n]) for n in before):
            same.add(name)
        array[...] = kept
    ends = ("_rgba", "_group", "_matid", "_user", "_bvhadr", "_bvhnum")
    looks = (
        "bvh_",
        "cam_",
        "light_",
        "mat_",
        "tex",
        "name",
        "numeric_",
        "oct_",
        "sensor_",
        "signature",
    )
    odd = {name for name in same if not name.endswith(ends) and not name.startswith(looks)}
    assert not odd
    some = "body_mass geom_friction pair_friction exclude_signature eq_data wrap_prm qpos0 site_pos"
    assert {*some.split()} <= before.keys() and not same & before.keys()


def test_a_run_does_not_go_on_with_another_robot(whole, config, tmp_path, monkeypatch):
    """Its checkpoints hold the robot; a heavier one of that name is refused, another colour is not."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    before = workdirs.everything(workdir)
    text, folder = GO1.xml.read_text(), tmp_path / "robots" / "go1"
    folder.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    (folder / "go1.xml").write_text(text.replace('mass="5.204"', 'mass="6.5"', 1))
    assert (folder / "go1.xml").read_text() != text
    line = refused(opened, workdir, config)
    assert f"--workdir={workdir}: {folder}/go1.xml is another robot than the run began with" in line
    after = workdirs.everything(workdir)
    assert {p for p in before | after if before.get(p) != after.get(p)} <= {Path("lock")}
    (folder / "go1.xml").write_text(text + "<!-- mine -->")
    opened(workdir, config)
    opened(workdir, config, fresh=True)

"""A policy.npz from anybody: one line that names file and entry, before anything large is allocated."""

import io
import json
import struct
import time
import tracemalloc
import zipfile

import numpy as np
import pytest
from answers import refused
from toy_policy import save

from dynappo.policy import npz_file, policy_file

STD, KERNEL = "std", "actor/params/Dense_1/kernel"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The arrays of a good policy.npz, by name."""
    with np.load(save(tmp_path_factory.mktemp("whole") / "policy.npz")) as file:
        return {name: file[name] for name in file}


def answer(path):
    """What is said of the file: one line that begins with its path, at once, and with little memory."""
    tracemalloc.start()
    start = time.process_time()
    line = refused(policy_file.load, path)
    seconds, (_, peak) = time.process_time() - start, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert line.startswith(f"{path}: ") and line.isprintable()
    assert seconds < 10 and peak < 100e6
    return line


# ---- the container

CENTRAL = {"flags": (8, "<H"), "method": (10, "<H"), "size": (24, "<L")}  # places in a zip's list


def packed(path, entries, change=None, method=zipfile.ZIP_STORED):
    """A zip of `{name: bytes}`; `change` sets numbers in what its list says of the last entry."""
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in entries:
            file.writestr(f"{name}.npy", content)
    if change:
        content = bytearray(path.read_bytes())
        at = content.rindex(b"PK\1\2")
        for name, value in change.items():
            place, kind = CENTRAL[name]
            struct.pack_into(kind, content, at + place, value)
        path.write_bytes(content)


def array(shape, kind="<f4", held=16):
    """An .npy of `held` bytes whose header says `shape` and `kind`."""
    out = io.BytesIO()
    head = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, head)
    return out.getvalue() + b"\0" * held


def entry(content, **change):
    return lambda path: packed(path, [(KERNEL, content)], change)


CONTAINERS = {  # what is written, what the line must say
    "a plain array": (
        lambda path: path.write_bytes(array((4,))),
        "does not end as an npz",
    ),
    "nothing after the list": (
        lambda path: path.write_bytes(b"PK\5\6" + b"\0" * 16 + b"\5\0"),
        "does not end as an npz",
    ),
    "a bomb": (entry(array((4,)), size=0xF0000000), f"`{KERNEL}` brings it to 4026531840 bytes"),
    "4 TB": (entry(array((10**12,))), f"`{KERNEL}` is damaged (shape (1000000000000,)"),
    "2^80 numbers": (entry(array((2**40, 2**40))), "would be 4835703278458516698824704 bytes"),
    "a shape below zero": (entry(array((-2, -2))), f"`{KERNEL}` is damaged (shape (-2, -2)"),
    "fewer numbers than it says": (entry(array((5,))), "would be 20 bytes, it has 16"),
    "encrypted": (entry(array((4,)), flags=1), f"`{KERNEL}` is encrypted"),
    "unknown compression": (entry(array((4,)), method=99), "is compressed by method 99"),
    "twice": (lambda p: packed(p, [(STD, array((4,)))] * 2), "`std` appears twice"),
    "a list of a million": (
        lambda path: path.write_bytes(npz_file.END.pack(b"PK\5\6", 0, 0, 9, 9, 2**26, 0, 0)),
        "a list of entries of 67108864 bytes",
    ),
    "no array": (lambda p: packed(p, [(STD, b"not an array")]), "`std` is damaged"),
    "a header of another version": (
        lambda p: packed(p, [(STD, b"\x93NUMPY\7\0" + b" " * 99)]),
        "`std` is damaged (array format (7, 0))",
    ),
    "a terminal's escape in a name": (
        lambda p: packed(p, [("\x1b[2J", array((4,)))]),
        "an entry is named '\\x1b[2J'",
    ),
    "complex": (entry(array((2,), "<c8")), f"`{KERNEL}` holds complex64, expected real numbers"),
    "integers": (entry(array((4,), "<i4")), f"`{KERNEL}` holds int32"),
    "objects": (entry(array((2,), "|O")), f"`{KERNEL}` holds object"),
    "text": (entry(array((1,), "<U4")), f"`{KERNEL}` holds str128"),
    "about that is a number": (
        lambda p: packed(p, [("about", array((4,)))]),
        "`about` is float32, expected a text",
    ),
    "about of 5 MB": (
        lambda p: packed(p, [("about", array((), "<U1250000", 5_000_000))]),
        "`about` has 5000000 bytes, expected at most",
    ),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_a_hostile_container_is_one_line(tmp_path, name):
    write, expected = CONTAINERS[name]
    write(tmp_path / "mine.npz")
    assert expected in answer(tmp_path / "mine.npz")


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_other_programs_may_pack_it(whole, tmp_path, method):
    """A policy that was unzipped and zipped again, compressed or not, is the same."""
    content = []
    for name, value in whole.items():
        out = io.BytesIO()
        np.save(out, value)
        content.append((name, out.getvalue()))
    packed(tmp_path / "mine.npz", content, method=method)
    found = npz_file.read(tmp_path / "mine.npz")
    assert list(found) == list(whole)
    for name, value in whole.items():
        np.testing.assert_array_equal(found[name], value)


# ---- what is in it

DEEP = "[" * 100_000 + "]" * 100_000
FIELDS = {  # a field of `about` and its value, what the line must say
    "kp as text": ("kp", "25", "kp is '25', expected 0 to 100000 N m/rad"),
    "kp as truth": ("kp", True, "kp is True"),
    "kp below zero": ("kp", -1e9, "kp is -1000000000.0, expected 0 to"),
    "kp that is no number": ("kp", np.nan, "kp is nan"),
    "kd without end": ("kd", np.inf, "kd is inf, expected 0 to 10000 N m s/rad"),
    "a scale without end": ("action_scale", np.inf, "action_scale is inf, expected 1e-06 to 100"),
    "no time": ("timestep", 0, "timestep is 0, expected 1e-05 to 0.1 s"),
    "time backwards": ("timestep", -0.005, "timestep is -0.005"),
    "a billion steps a second": ("timestep", 1e-9, "timestep is 1e-09"),
    "a trillion substeps": ("substeps", 10**12, "substeps is 1000000000000, expected 1 to 1000"),
    "substeps of 4000 digits": ("substeps", 10**4000, "substeps is 100000000000000000...000"),
    "half a substep": ("substeps", 4.5, "substeps is 4.5, expected an integer"),
    "five seconds an action": ("substeps", 1000, "5 s lie between two actions"),
    "a joint twice": ("joint_names", ["FL_hip_joint"] * 12, "a joint more than once"),
    "joints that are numbers": ("joint_names", list(range(12)), "a name is 0"),
    "joints that are a text": ("joint_names", "FL_hip_joint", "found, expected a list"),
    "a long name": ("robot", "a" * 300, "a name is 'aaaaaaaaaaaa"),
    "a path": ("robot", "../../etc/passwd", "robot is '../../etc/passwd', expected a name"),
    "a pose of text": ("default_pose", ["0"] * 12, "default_pose is '0', expected -100 to 100"),
    "a pose of lists": ("default_pose", [[0.0]] * 12, "default_pose is [0.0]"),
    "a pose too far": ("default_pose", [1e9] * 12, "default_pose is 1000000000.0"),
    "damping below zero": ("joint_damping", [-1.0] * 12, "joint_damping is -1.0"),
    "a range upside down": ("command_x", [1, -1], "command_x is [1, -1], expected (low, high)"),
    "a range of one": ("command_y", [1], "command_y is [1], expected (low, high)"),
    "a range without end": ("command_yaw", [-np.inf, 1], "command_yaw is -inf"),
    "an activation that is a list": ("activation", ["elu"], "its activation is ['elu']"),
    "a config that is a list": ("config", [1], "config is [1], expected groups"),
    "NaN in the config": (
        "config",
        {"task": {"noise": {"a": np.nan}}},
        "config.task.noise.a is nan",
    ),
    "a group that is a number": ("config", {"task": 1}, "config.task is 1, expected a group"),
    "noise that is a list": ("config", {"task": {"noise": []}}, "config.task.noise is []"),
    "another kp in the config": ("config", {"task": {"kp": 9.0}}, "but 9.0 in config.task"),
    "other substeps there": ("config", {"physics": {"substeps": 10**9}}, "in config.physics"),
    "params": ("params", {}, "`about` is damaged"),
    "deep JSON": (None, DEEP, "`about` is damaged"),
    "a number of 5000 digits": (None, '{"kp": 1' + "0" * 5000 + "}", "`about` is damaged"),
}


@pytest.mark.parametrize("name", FIELDS)
def test_a_hostile_description_is_one_line(whole, tmp_path, name):
    """Whatever its type or size; an infinite number is one in JSON of Python's kind."""
    field, value, expected = FIELDS[name]
    about = json.loads(str(whole["about"]))
    if field:
        about["config"].update(task={}, physics={})  # where the same is said once more
        about[field] = value
    text = json.dumps(about) if field else value
    np.savez(tmp_path / "mine.npz", allow_pickle=False, **(whole | {"about": np.array(text)}))
    assert expected in answer(tmp_path / "mine.npz")


ARRAYS = {  # arrays that are put in, what the line must say
    "a kernel that does not chain": (
        {KERNEL: np.zeros((15, 16), np.float32)},
        "Dense_1 has a kernel (15, 16) and a bias (16,) after 16 numbers",
    ),
    "a bias that would be spread": (
        {"actor/params/Dense_1/bias": np.zeros(1, np.float32)},
        "Dense_1 has a kernel (16, 16) and a bias (1,)",
    ),
    "a kernel of three axes": ({KERNEL: np.zeros((1, 16, 16), np.float32)}, "kernel (1, 16, 16)"),
    "a layer of no numbers": (
        {KERNEL: np.zeros((16, 0), np.float32), "actor/params/Dense_1/bias": np.zeros(0, "f4")},
        "kernel (16, 0)",
    ),
    "a layer too many": (
        {"actor/params/Dense_9/kernel": np.zeros((2, 2), "f4")},
        "Dense_3 has no kernel",
    ),
    "a layer in a layer": (
        {f"{KERNEL}/more": np.zeros(2, "f4")},
        "lies inside of another, or too deep",
    ),
    "thousands of groups": (
        {"a/" * 40 + "b": np.zeros(2, "f4")},
        "lies inside of another, or too deep",
    ),
    "a critic that is no network": ({"critic/x": np.zeros(2, "f4")}, "not the layers of a critic"),
    "NaN beside the actor": ({"std": np.full(12, np.nan, "f4")}, "std is not finite"),
    "11 standard deviations": ({"std": np.ones(11, "f4")}, "std has the shape (11,)"),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_hostile_arrays_are_one_line(whole, tmp_path, name):
    put, expected = ARRAYS[name]
    np.savez(tmp_path / "mine.npz", allow_pickle=False, **(whole | put))
    assert expected in answer(tmp_path / "mine.npz")

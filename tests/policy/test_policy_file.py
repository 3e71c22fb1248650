"""policy.npz: all that a robot needs, read back without JAX."""

import json
import struct
import zipfile

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import refused
from ml_collections import config_dict
from npy_files import DAMAGED, header
from toy_policy import ROBOTS, actor, described, params_in, save
from toy_runs import assert_same

from dynappo import config as config_lib
from dynappo.config import fields, files
from dynappo.learner import networks
from dynappo.policy import checks, policy_file, policy_source


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The policy.npz of an actor of the Go1."""
    return save(tmp_path_factory.mktemp("saved") / "policy.npz")


@pytest.fixture(scope="module")
def policy(saved):
    return policy_file.load(saved)


# ---- what is in it


def test_a_policy_file_holds_all_that_its_robot_needs(saved, policy):
    """Every field against the config and the MJCF."""
    config, robot = described()
    with np.load(saved) as file:
        about = json.loads(str(file["about"]))
        kernel = file["actor/params/Dense_0/kernel"]
    np.testing.assert_array_equal(kernel, actor()["actor"]["params"]["Dense_0"]["kernel"])
    model = mujoco.MjModel.from_xml_path(str(robot.xml))
    assert about["joint_names"] == [model.joint(i).name for i in range(1, 13)]
    np.testing.assert_array_equal(about["default_pose"], model.key("home").qpos[7:])
    assert (about["robot"], about["format"], about["observation"]) == ("go1", 2, "velocity-48")
    assert about["activation"] == config.ppo.activation
    for field, name in policy_file.TASK.items():
        if field in policy_file.NEWER:  # at their defaults left out, for older readers
            assert name not in about and getattr(policy, name) == policy_file.NEWER[field]
            continue
        value = config.task[field]
        assert about[name] == (list(value) if isinstance(value, tuple) else value), name
    assert (about["timestep"], about["substeps"]) == (0.005, 4)
    assert about["config"] == json.loads(config_lib.to_json(config))
    for name in set(about) - {"format", "default_pose", "config"}:
        value = getattr(policy, name)
        assert (list(value) if isinstance(value, tuple) else value) == about[name], name
    assert about["joint_damping"] == about["joint_friction"] == [0.0] * 12
    np.testing.assert_array_equal(policy.default_pose, robot.default_pose)


def test_saving_replaces_the_whole_file_and_leaves_nothing_else(tmp_path):
    for seed in (1, 2):
        save(tmp_path / "policy.npz", seed)
        assert [p.name for p in tmp_path.iterdir()] == ["policy.npz"]
        for back in (
            policy_file.load(tmp_path / "policy.npz").params,
            params_in(tmp_path / "policy.npz"),
        ):
            jax.tree.map(np.testing.assert_array_equal, back, actor(seed))


@pytest.mark.parametrize("activation", fields.every()["ppo.activation"].choices)
def test_the_actor_in_numpy_is_the_policy_in_jax(settings, activation):
    """Every activation, one observation and a batch, to 1e-5 of the largest action."""
    static, hyper = settings({"ppo.activation": activation, "ppo.hidden": (24, 16)})
    params = networks.init_policy(static, hyper, 48, 12, jax.random.key(1))
    params = jax.tree.map(lambda x: x * 4, params)  # large enough to bend every activation
    obs = np.random.default_rng(0).normal(size=(64, 48)).astype(np.float32) * 3
    obs[0] *= 100  # far out, where an exponential could overflow
    expected = np.asarray(networks.policy(static, params, jnp.asarray(obs)))
    mean = policy_file.actor(jax.device_get(params), activation)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(mean(obs) / scale, expected / scale, atol=1e-5)
    np.testing.assert_allclose(mean(obs[3]) / scale, expected[3] / scale, atol=1e-5)
    assert scale > 1


# ---- a file from anybody: one line that names the file and what is wrong


FIRST, SECOND = (f"actor/params/Dense_{i}/kernel" for i in (0, 1))


def far(name, value):
    """Damage to a file: `value` as its number `name` of how far the run was."""
    return lambda arrays, _: arrays.update({f"trained/{name}": np.asarray(value)})


DAMAGE = {  # what is done to the arrays or to `about`, what the line must say
    "no about": (lambda a, _: a.pop("about"), "no entry `about`"),
    "about is no JSON": (lambda a, _: a.update(about="{robot"), "`about` is damaged"),
    "about is a list": (lambda a, _: a.update(about="[1]"), "`about` is damaged"),
    "deep JSON": (lambda a, _: a.update(about="[" * 10**5 + "]" * 10**5), "`about` is damaged"),
    "a field is missing": (lambda _, about: about.pop("kp"), "kp"),
    "a field too many": (lambda _, about: about.update(mass=1), "mass"),
    "params": (lambda _, about: about.update(params={}), "`about` is damaged"),
    "another format": (lambda _, about: about.update(format=6), "format 6, this dynappo reads 5"),
    "another observation": (lambda _, about: about.update(observation="scan-187"), "'scan-187'"),
    "another observation in its config": (
        lambda _, about: about["config"]["task"].update(observation="onboard"),
        "observation is 'velocity-48', but 'onboard-45' in config.task",
    ),
    "no observation in its config": (
        lambda _, about: about["config"]["task"].update(observation=["full"]),
        "observation is 'velocity-48', but ['full'] in config.task",
    ),
    "another activation": (lambda _, about: about.update(activation="mish"), "'mish'"),
    "an activation that is a list": (lambda _, about: about.update(activation=["elu"]), "['elu']"),
    "a joint too few": (lambda _, about: about["joint_names"].pop(), "joints"),
    "a damping too few": (lambda _, about: about["joint_damping"].pop(), "11 values"),
    "one number is not finite": (lambda a, _: a[FIRST].put(7, np.nan), "not finite"),
    "complex": (lambda a, _: a.update({FIRST: a[FIRST] * 1j}), "holds complex"),
    "integers": (lambda a, _: a.update({FIRST: a[FIRST].astype(int)}), "holds int64"),
    "half an iteration": (far("iteration", 1.5), "trained/iteration is 1.5, expected a whole"),
    "no number of an iteration": (far("iteration", np.nan), "trained/iteration is nan, expected"),
    "an iteration below 0": (far("iteration", -1.0), "iteration is -1, expected a number from 0"),
    "steps in words": (far("sim_steps", "many"), "trained/sim_steps is 'many', expected a whole"),
    "several steps": (far("sim_steps", [1.0, 2.0]), "trained/sim_steps is [1.0, 2.0], expected"),
    "too many steps": (far("sim_steps", 2.0**60), "sim_steps is 1152921504606846976, expected"),
    "another size": (lambda a, _: a.update({FIRST: a[FIRST][:30]}), "48 observations"),
    "a layer is missing": (lambda a, _: a.pop(FIRST), "Dense_0"),
    "a layer too many": (
        lambda a, _: a.update({FIRST.replace("0", "9"): np.ones((2, 2))}),
        "Dense_3 has no",
    ),
    "a kernel that does not chain": (
        lambda a, _: a.update({SECOND: np.zeros((15, 16))}),
        "Dense_1 has a kernel (15, 16) and a bias (16,) after 16 numbers",
    ),
    "a bias that would be spread": (
        lambda a, _: a.update({SECOND.replace("kernel", "bias"): np.zeros(1)}),
        "Dense_1 has a kernel (16, 16) and a bias (1,)",
    ),
    "a layer of no numbers": (lambda a, _: a.update({SECOND: np.zeros((16, 0))}), "kernel (16, 0)"),
    "a layer in a layer": (lambda a, _: a.update({f"{SECOND}/more": np.zeros(2)}), "lies inside"),
    "thousands of groups": (lambda a, _: a.update({"a/" * 2000 + "b": np.zeros(2)}), "too deep"),
    "no actor": (lambda a, _: [a.pop(n) for n in [*a] if n.startswith("actor")], "an actor"),
    "a critic that is no network": (lambda a, _: a.update({"critic/x": np.ones(2)}), "a critic"),
    "11 standard deviations": (lambda a, _: a.update(std=np.ones(11)), "std has the shape (11,)"),
}
FIELDS = (  # a field of `about` and its value, what the line must say
    ("kp", "25", "kp is '25', expected 0 to 100000 N m/rad"),
    ("kp", True, "kp is True"),
    ("kp", -1e9, "kp is -1000000000.0, expected 0 to"),
    ("kp", np.nan, "NaN is no number"),
    ("kd", np.inf, "Infinity is no number"),
    ("timestep", 0, "timestep is 0, expected 1e-05 to 0.1 s"),
    ("substeps", 10**12, "substeps is 1000000000000, expected an integer of 1 to 1000"),
    ("substeps", 4.5, "substeps is 4.5, expected an integer"),
    ("substeps", 1000, "5 s lie between two actions"),
    ("joint_names", ["FL_hip_joint"] * 12, "a joint more than once"),
    ("joint_names", list(range(12)), "a name is 0"),
    ("joint_names", "FL_hip_joint", "found, expected a list"),
    ("robot", "a" * 300, "a name is 'aaaaaaaaaaaa"),
    ("robot", "../../etc/passwd", "robot is '../../etc/passwd', expected a name"),
    ("default_pose", ["0"] * 12, "default_pose is '0', expected -100 to 100"),
    ("default_pose", [[0.0]] * 12, "default_pose is [0.0]"),
    ("joint_damping", [-1.0] * 12, "joint_damping is -1.0"),
    ("command_x", [1, -1], "command_x is [1, -1], expected (low, high)"),
    ("command_y", [1], "command_y is [1], expected (low, high)"),
    ("config", [1], "config is [1], expected groups"),
    ("config", {"task": 1}, "config.task is 1, expected a group"),
    ("config", {"task": {"noise": []}}, "config.task.noise is []"),
    ("config", {"task": {"kp": 9.0}}, "but 9.0 in config.task"),
    ("seed", -1, "seed is -1"),
    ("mjcf", 7, "mjcf is 7, expected a text"),
)


def changed(saved, path, change):
    """A copy of a policy.npz at `path`, after `change(arrays, about)`."""
    with np.load(saved) as file:
        arrays = {entry: file[entry] for entry in file}
    about, whole = json.loads(str(arrays["about"])), arrays["about"]
    change(arrays, about)
    if arrays.get("about") is whole:
        arrays["about"] = json.dumps(about)
    np.savez(path, allow_pickle=False, **arrays)
    return path


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_policy_is_one_line(saved, tmp_path, name):
    change, expected = DAMAGE[name]
    path = changed(saved, tmp_path / "mine.npz", change)
    line = refused(policy_source.load, str(path))
    assert line.startswith(f"{path}: ") and line.isprintable() and expected in line


@pytest.mark.parametrize(("field", "value", "expected"), FIELDS)
def test_a_hostile_description_is_one_line(saved, tmp_path, field, value, expected):
    def change(_, about):
        about["config"].update(task={}, physics={})  # where the same is said once more
        about[field] = value

    path = changed(saved, tmp_path / "mine.npz", change)
    line = refused(policy_file.load, path)
    assert line.startswith(f"{path}: ") and line.isprintable() and expected in line


ENTRIES = DAMAGED | {  # `std.npy` of a zip
    "no array": b"not an array",
    "another version": b"\x93NUMPY\7\0" + b" " * 99,
    "4 TB": header((10**12,)),
    "2^80 numbers": header((2**40, 2**40)),
    "a shape below zero": header((-2, -2)),
    "fewer numbers than it says": header((5,)),
}


@pytest.mark.parametrize("content", ["cut", "text", "empty", "array", *ENTRIES])
def test_a_file_of_another_kind_is_one_line(saved, tmp_path, content):
    path, whole = tmp_path / "mine.npz", saved.read_bytes()
    if content in ENTRIES:
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("std.npy", ENTRIES[content])
    else:
        cut = whole[: len(whole) // 2]
        other = {"cut": cut, "text": b"robot: go1", "empty": b"", "array": header((4,))}
        path.write_bytes(other[content])
    line = refused(policy_source.load, str(path))
    assert line.startswith(f"{path}: ") and any(
        w in line for w in ("damaged", "cannot be read", "not a policy")
    )


def test_a_small_file_of_gigabytes_is_not_unpacked(saved, tmp_path):
    """A gigabyte of zeros is a megabyte in a zip; here its list only says so."""
    content = bytearray(saved.read_bytes())
    struct.pack_into("<L", content, content.rindex(b"PK\1\2") + 24, 0xF0000000)
    (tmp_path / "mine.npz").write_bytes(content)
    line = refused(policy_file.load, tmp_path / "mine.npz")
    assert "bytes unpacked, expected at most 134217728" in line


class Runs:
    """What a pickle of it does when it is read: write a file."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


@pytest.mark.parametrize("entry", ["about", "actor/params/Dense_0/kernel", "std", "another"])
def test_a_pickle_in_it_is_not_run(saved, tmp_path, entry):
    """NumPy reads such an array only where it is told to; so does the Python beside it."""
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file}
    arrays[entry] = np.array([Runs(tmp_path / "ran")], dtype=object)
    np.savez(tmp_path / "mine.npz", **arrays)
    for read in (policy_file.load, policy_file.load_actor):
        assert "not a policy.npz, or damaged" in refused(read, tmp_path / "mine.npz")
    assert not (tmp_path / "ran").exists()
    np.load(tmp_path / "mine.npz", allow_pickle=True)[entry]
    assert (tmp_path / "ran").exists(), "the pickle would have run"


@pytest.mark.parametrize("name", ROBOTS)
def test_a_bundled_policy_is_of_its_robot(name):
    """Each robot's own joints, pose and gains."""
    path = files.find("robots", f"{name}/policy.npz")
    if path is None:
        pytest.skip(f"no policy is bundled with {name}")
    found, (config, robot) = policy_file.load(path), described(name)
    assert found.robot == name and found.joint_names == robot.joint_names
    np.testing.assert_allclose(found.default_pose, robot.default_pose)
    assert (found.kp, found.kd) == (config.task.kp, config.task.kd)


def test_the_actor_of_a_file_acts_as_its_policy_does(saved, policy, tmp_path):
    """Of a robot; what is no policy, or does not say its activation, is one line."""
    obs = np.random.default_rng(0).normal(size=(5, 48))
    expected = policy_file.actor(policy.params, policy.activation)(obs)
    np.testing.assert_array_equal(policy_file.load_actor(saved)(obs), expected)
    bad = tmp_path / "bad.npz"
    for entries in ({"x": np.ones(2)}, {"about": "{}"}, {"about": "5"}):
        np.savez(bad, allow_pickle=False, **entries)
        assert "holds no actor, or does not say which" in refused(policy_file.load_actor, bad)


def test_a_policy_without_a_robot_keeps_its_networks_and_its_config(policy, tmp_path):
    """Of an environment of one's own: it acts, and is told from one that can be played."""
    config, path = config_dict.ConfigDict(described()[0]), tmp_path / "policy.npz"
    config.ppo.activation = "tanh"
    policy_file.save(path, policy.params, config, None)
    act = policy_file.load_actor(path)
    one = policy_file.actor(policy.params, "tanh")(np.ones(48))
    np.testing.assert_array_equal(act(np.ones(48)), one)
    of_workdir = policy_file.load_actor(tmp_path)
    np.testing.assert_array_equal(of_workdir(np.ones(48)), one)
    assert "which is not a robot of dynappo's" in refused(policy_file.load, path)


# ---- how far its run was


def test_a_policy_file_says_how_far_its_run_was_and_older_readers_take_it(saved, policy, tmp_path):
    """These refuse an unknown word in `about`, and take arrays of real numbers for parameters."""
    assert (policy.iteration, policy.sim_steps) == (None, None)
    path, steps = tmp_path / "policy.npz", 2**40 + 1
    policy_file.save(path, actor(), *described(), iteration=400, sim_steps=steps)
    found = policy_file.load(path)
    assert (found.iteration, found.sim_steps) == (400, steps)
    assert_same(found.params, policy.params)
    with np.load(path) as file, np.load(saved) as before:
        arrays = {name: file[name] for name in file.files}
        assert arrays.pop("about") == before["about"]
        assert {*arrays} - {*before.files} == {"trained/iteration", "trained/sim_steps"}
    checks.check_params(checks.nested(arrays), 48, 12)
    obs = np.ones(48)
    np.testing.assert_array_equal(
        policy_file.load_actor(path)(obs), policy_file.load_actor(saved)(obs)
    )


def test_the_policy_of_another_task_says_so_too(tmp_path):
    config, path = config_dict.ConfigDict(described()[0]), tmp_path / "policy.npz"
    config.env = "brax:ant"
    for known in ({}, {"iteration": 7, "sim_steps": 99}):
        policy_file.save(path, actor(), config, None, **known)
        found = policy_file.load_other(path)
        assert found and {"iteration": found.iteration, "sim_steps": found.sim_steps} == {
            "iteration": known.get("iteration"),
            "sim_steps": known.get("sim_steps"),
        }
        assert_same(found.params, actor())
    policy_file.save(path, actor(), config, None, iteration=-1)
    assert "iteration is -1, expected a number from 0 on" in refused(policy_file.load_other, path)


# ---- motors of each joint


def of_joints():
    """`(config, robot)` of a Go1 whose joints differ; as `described`."""
    config = config_lib.load("go1:ppo16")
    config.task.update(kp={".*_calf_joint": 35, ".*": 25}, kd=tuple(0.1 * np.arange(1, 13)))
    config.task.update(armature={".*": 0.02}, joint_friction=0.1)
    return config_lib.validate(config), described()[1]


def test_numbers_of_each_joint_are_in_the_file_which_older_readers_refuse_by_its_format(tmp_path):
    config, robot = of_joints()
    policy_file.save(tmp_path / "a.npz", actor(), config, robot)
    with np.load(tmp_path / "a.npz") as file:
        about = json.loads(str(file["about"]))
    assert about["format"] == 3 and about["kp"] == [25.0, 25.0, 35.0] * 4
    found = policy_file.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.kp, [25.0, 25.0, 35.0] * 4)
    np.testing.assert_array_equal(found.kd, 0.1 * np.arange(1, 13))
    assert (found.effort_limit, found.armature, found.dry_friction) == (23.7, 0.02, 0.1)
    # a tuple is in the order of the robot's file; the policy's may change, so the config has names
    assert found.config["task"]["kd"][1] == ["FL_thigh_joint", 0.2]
    again = tmp_path / "b.npz"
    policy_file.save_params(
        again, found.params, about=policy_file.to_json(policy_file.about(found))
    )
    for name, value in policy_file.load(again)._asdict().items():
        if name != "params":
            np.testing.assert_equal(value, getattr(found, name), name)


@pytest.mark.parametrize(
    "new", [{"armature": 0.01}, {"joint_friction": 0.1}, {"kd": (1.0, 2.0) * 6}]
)
def test_what_the_older_format_cannot_say_has_the_newer(new):
    config = config_lib.load("go1:ppo16")
    config.task.update(new)
    policy = policy_file.describe(config_lib.validate(config), described()[1])
    assert policy_file.about(policy)["format"] == 3
    assert policy_file.about(policy_file.describe(*described()))["format"] == 2


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("kp", [25.0] * 11, "11 values of kp for 12 joints"),
        ("kp", [25.0] * 11 + [-1.0], "kp is -1.0, expected 0 to 100000 N m/rad"),
        ("kp", [25.0] * 11 + ["x"], "kp is 'x', expected 0 to 100000 N m/rad"),
        ("kp", {"a": 1}, "kp is {'a': 1}, expected 0 to"),
        ("kp", [26.0] * 12, "kp is [26.0, 26.0, 26.0"),  # not what it was trained with
        ("armature", "x", "armature is 'x', expected 0 to 10000 kg m2"),
        ("dry_friction", None, "dry_friction is None, expected 0 to 10000 N m"),
        ("dry_friction", 0.2, "dry_friction is 0.2, but 0.1 in config.task"),
        ("effort_limit", [23.7, 3.0] * 6, "effort_limit is [23.7, 3.0"),
    ],
)
def test_wrong_numbers_of_joints_are_one_line(tmp_path, field, value, expected):
    about = json.loads(policy_file.to_json(policy_file.about(policy_file.describe(*of_joints()))))
    policy_file.save_params(
        tmp_path / "a.npz", actor(), about=policy_file.to_json(about | {field: value})
    )
    line = refused(policy_file.load, tmp_path / "a.npz")
    assert "a.npz" in line and expected in line


def test_a_checkpoints_patterns_are_checked_before_they_are_used():
    """Its config comes from a file, with lists."""
    config, robot = of_joints()
    stored = config_dict.ConfigDict(json.loads(config_lib.to_json(config)))
    found, expected = (policy_file.describe(one, robot) for one in (stored, config))
    np.testing.assert_equal(found.kd, expected.kd)
    assert found.config["task"]["kd"] == expected.config["task"]["kd"]
    for value, expected in (
        ([["(a*)*b", 1.0], [".*", 2.0]], "no group repeated"),
        ([["calf", 1.0], [".*", 2.0]], "the pattern 'calf' of task.kp matches no joint of go1"),
        ([[".*", -2.0]], "task.kp of '.*' is -2.0, expected 0 to 100,000"),
        ([[".*"]], "task.kp is [['.*']], expected float, a dict"),
    ):
        tree = json.loads(config_lib.to_json(config))
        tree["task"]["kp"] = value
        line = refused(policy_file.describe, config_dict.ConfigDict(tree), robot)
        assert expected in line


def test_an_actor_is_found_by_name_and_tells_how_many_numbers_it_wants():
    """Not NumPy's error of a product."""
    act = policy_file.load_actor("go1")
    assert act(np.zeros(48)).shape == (12,) and act(np.zeros((3, 48))).shape == (3, 12)
    for obs, found in (
        (np.zeros(47), "47 numbers"),
        (np.zeros((48, 2)), "2 numbers"),
        (1.0, "one number"),
    ):
        with pytest.raises(
            ValueError, match=f"obs has {found}.*, expected 48: what the policy of .*go1"
        ):
            act(obs)

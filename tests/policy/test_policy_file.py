"""policy.npz: all that a robot needs, read back without JAX; and what a name or a path means."""

import json
import shutil
import zipfile
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import refused
from ml_collections import config_dict
from toy_policy import ROBOTS, actor, described, save

from dynappo import config as config_lib
from dynappo.config import fields, files
from dynappo.learner import networks
from dynappo.policy import policy_file, source


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
    for name in policy_file.TASK:
        value = config.task[name]
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
            policy_file.load_params(tmp_path / "policy.npz"),
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


# ---- damaged files


FIRST = "actor/params/Dense_0/kernel"
DAMAGE = {  # what is done to the arrays or to `about`, what the line must say
    "no about": (lambda a, _: a.pop("about"), "no entry `about`"),
    "about is no JSON": (lambda a, _: a.update(about="{robot"), "`about` is damaged"),
    "about is a list": (lambda a, _: a.update(about="[1]"), "`about` is damaged"),
    "a field is missing": (lambda _, about: about.pop("kp"), "kp"),
    "a field too many": (lambda _, about: about.update(mass=1), "mass"),
    "another format": (lambda _, about: about.update(format=3), "format 3, this dynappo reads 2"),
    "another observation": (lambda _, about: about.update(observation="scan-187"), "'scan-187'"),
    "another activation": (lambda _, about: about.update(activation="mish"), "'mish'"),
    "a joint too few": (lambda _, about: about["joint_names"].pop(), "joints"),
    "a damping too few": (lambda _, about: about["joint_damping"].pop(), "11 values"),
    "one number is not finite": (lambda a, _: a[FIRST].put(7, np.nan), "not finite"),
    "another size": (lambda a, _: a.update({FIRST: a[FIRST][:30]}), "48 observations"),
    "a layer without end": (
        lambda a, _: a.update(
            {FIRST: np.zeros((48, 20_000), "f2"), FIRST.replace("kernel", "bias"): np.zeros(20_000)}
        ),
        "a layer of 20000 units, at most 10000",
    ),
    "a layer is missing": (lambda a, _: a.pop(FIRST), "Dense_0"),
    "no actor": (lambda a, _: [a.pop(n) for n in [*a] if n.startswith("actor")], "an actor"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_policy_is_one_line(saved, tmp_path, name):
    """The line names the file and what is wrong with it."""
    change, expected = DAMAGE[name]
    with np.load(saved) as file:
        arrays = {entry: file[entry] for entry in file}
    about = json.loads(str(arrays["about"]))
    whole = arrays["about"]
    change(arrays, about)
    if arrays.get("about") is whole:
        arrays["about"] = json.dumps(about)
    np.savez(tmp_path / "mine.npz", allow_pickle=False, **arrays)
    line = refused(source.find, str(tmp_path / "mine.npz"))
    assert line.startswith(str(tmp_path / "mine.npz")) and expected in line


@pytest.mark.parametrize("content", ["cut", "text", "empty", "zip", "pickle"])
def test_a_file_of_another_kind_is_one_line(saved, tmp_path, content):
    path, whole = tmp_path / "mine.npz", saved.read_bytes()
    if content == "zip":
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("about.npy", "not an array")
    elif content == "pickle":
        np.savez(path, about=np.array({"robot": "go1"}, dtype=object))
    else:
        cut = whole[: len(whole) // 2]
        path.write_bytes({"cut": cut, "text": b"robot: go1", "empty": b""}[content])
    line = refused(source.find, str(path))
    assert line.startswith(f"{path}: ") and ("damaged" in line or "cannot be read" in line)


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
    for read in (policy_file.load, policy_file.load_params, policy_file.load_actor):
        assert f"its entry `{entry}` is damaged" in refused(read, tmp_path / "mine.npz")
    assert not (tmp_path / "ran").exists()
    np.load(tmp_path / "mine.npz", allow_pickle=True)[entry]
    assert (tmp_path / "ran").exists(), "the pickle would have run"


# ---- what a name or a path means


def test_names_files_and_folders_are_told_apart(saved, tmp_path, monkeypatch):
    """The policy of a robot's name first, `./spot` is a folder; a miss says what was expected."""
    monkeypatch.chdir(tmp_path)
    for folder in ("robots/spot", "spot"):
        Path(folder).mkdir(parents=True)
    Path("robots/spot/spot.xml").write_text("<mujoco/>")
    line = refused(source.locate, "spot")
    assert "(robots/spot/policy.npz)" in line and "--policy=zero" in line
    shutil.copy(saved, "robots/spot/policy.npz")
    assert source.locate("spot") == tmp_path / "robots" / "spot" / "policy.npz"
    assert "./spot: holds neither" in refused(source.locate, "./spot")
    shutil.copy(saved, "spot/policy.npz")
    assert source.locate("./spot") == Path("spot/policy.npz")
    line = refused(source.locate, "sptt")
    assert line.startswith("sptt: no such file or folder") and "go2, spot (or" in line


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
    assert "which is not a robot of dynappo's" in refused(policy_file.load, path)

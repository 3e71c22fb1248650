"""Episodes of the task that a policy was trained on: with its own settings, on this machine."""

import json

import jax
import jax.numpy as jnp
import pytest
from answers import refused
from toy_policy import actor, described

from dynappo import config as config_lib
from dynappo import scores
from dynappo.description import motors
from dynappo.evaluate import episodes
from dynappo.policy import policy_file

HIDDEN = (128, 128, 128)  # of the bundled configs


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor(hidden=HIDDEN))


def test_the_settings_are_those_of_training(policy):
    """Every field as it was, but for the device; newer fields have their defaults."""
    for name in ("go1", "anymal_d"):
        trained = described(name)[0].to_dict()
        found = episodes.settings(policy_file.describe(*described(name), actor(hidden=HIDDEN)))
        assert found.to_dict() == trained
    expected = described()[0].to_dict()
    old = json.loads(json.dumps(expected))
    old["run"].update(device="gpu", mesh_env=8)
    old["physics"]["impl"] = "warp"
    old["task"]["kp"] = expected["task"]["kp"] = 33.0
    del old["run"]["video_seconds"], old["task"]["push"], old["model"]
    old["task"]["no_longer_there"] = 1
    assert episodes.settings(policy._replace(config=old)).to_dict() == expected


def test_what_this_version_does_not_know_is_said_and_terms_of_ones_own_are_known(policy):
    """A weight, a noise and a number of one's own are in the episodes where the config names terms."""
    theirs = json.loads(json.dumps(policy.config))
    theirs["task"]["weights"]["motor_work"] = -1e-3
    theirs["task"]["noise"]["base_height"] = 0.02
    theirs["task"]["own"]["min_height"] = 0.15
    named = json.loads(json.dumps(theirs))
    named["task"]["terms"] = "my_terms.py"
    assert episodes.left_out(policy) == episodes.left_out(policy._replace(config=named)) == ""
    named["task"]["no_longer_there"], named["physics"]["off"] = 1, 0.0
    found = episodes.left_out(policy._replace(config=named))
    assert "config has task.no_longer_there = 1, which this dynappo does not know" in found
    found = episodes.left_out(policy._replace(config=theirs))
    assert all(name in found for name in ("motor_work", "base_height", "min_height"))


def test_motors_of_each_joint_are_those_of_the_policy():
    """Not by the patterns of a stranger's config, which nobody matches: they may take for ever."""
    config, robot = described()
    config = config_lib.load("go1")
    config.task.update(kp={".*_calf_joint": 35, ".*": 25}, kd=(1, 2, 3) * 4, armature=0.02)
    trained = policy_file.describe(config_lib.validate(config), robot, actor(hidden=HIDDEN))
    stored = json.loads(policy_file.to_json(policy_file.about(trained)))["config"]
    stored["task"]["kp"][0][0] = "(a*)*b"
    found = episodes.settings(trained._replace(config=stored)).task
    assert (found.kp, found.kd, found.armature) == ((25, 25, 35) * 4, (1, 2, 3) * 4, 0.02)


def test_postures_of_each_joint_are_those_of_the_config():
    """They are no motors: a policy's file has them in its config alone, by the joints' names."""
    config, robot = described()
    config = config_lib.load("go1")
    config.task.update(posture_std={".*_calf_joint": 0.3, ".*": 0.2}, posture_std_standing=0.1)
    trained = policy_file.describe(config_lib.validate(config), robot, actor(hidden=HIDDEN))
    stored = json.loads(policy_file.to_json(policy_file.about(trained)))["config"]
    found = episodes.settings(trained._replace(config=stored))
    found, _ = motors.fitted(found, robot)
    assert found.task.posture_std == (0.2, 0.2, 0.3) * 4 and found.task.posture_std_standing == 0.1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("task.kp", "stiff"),
        ("task.command_x", [1.0]),
        ("task.formulation", "mine"),
        ("task.episode_length", 3_000_000_000),
        ("run.eval_steps", 10**12),
        ("physics.iterations", 10**9),
        ("ppo.hidden", [64, 64]),
        ("run.mesh_seed", True),
    ],
)
def test_a_config_that_does_not_fit_is_one_line(policy, field, value):
    """Of another type, of another network, or of a length that nobody waits for."""
    damaged = json.loads(json.dumps(policy.config))
    group, leaf = field.split(".")
    damaged[group][leaf] = value
    assert field in refused(episodes.settings, policy._replace(config=damaged))


def test_the_policy_is_evaluated_on_its_task(policy, monkeypatch):
    """What `scores.evaluate` gets, and what is handed on; NaN is None."""
    got = {}

    def spy(env, hyper, params, key, **options):
        got.update(env=env, hyper=hyper, params=params, key=key, **options)
        return {"return": jnp.float32(3.5), "tracking_error": jnp.float32(jnp.nan)}

    monkeypatch.setattr(scores, "evaluate", spy)
    lone = policy._replace(params={"actor": policy.params["actor"]})
    found = episodes.run(lone, 7, randomize=True, seed=3)
    static, hyper = config_lib.split(episodes.settings(policy))
    assert (got["num_envs"], got["num_steps"], got["randomize"]) == (7, 1000, True)
    assert got["static"] == static and got["env"].action_size == 12
    assert got["hyper"]._fields == hyper._fields
    assert got["params"]["std"].shape == (12,)
    assert got["params"]["actor"].keys() == policy.params["actor"].keys()
    assert found == {
        "episodes": 7,
        "seconds": 20.0,
        "randomize": True,
        "seed": 3,
        "device": jax.devices()[0].device_kind,
        "impl": {"gpu": "warp", "cpu": "c"}[jax.default_backend()],
        "return": 3.5,
        "tracking_error": None,
    }
    default = {"gpu": 1000, "cpu": 64}[jax.default_backend()]
    assert episodes.run(policy)["episodes"] == default and got["randomize"] is False
    numbers = {"return": 41.0, "tracking_error": 0.1, "yaw_error": 0.1, "fall_rate": 0.02}
    monkeypatch.setattr(scores, "evaluate", lambda *_, **__: numbers)
    assert episodes.run(policy, 200)["policy"] == "almost walks; falls 2.0 % > 1 %"
    few = "almost walks (of 50 episodes); falls 2.0 % > 1 %"  # its run had 1000
    assert episodes.run(policy, 50)["policy"] == few
    assert "policy" not in episodes.run(policy, randomize=True)


@pytest.mark.slow
def test_a_robot_that_stands_is_evaluated(policy):
    """Two seconds of the real task: nobody falls, and the error is the command's size."""
    config = json.loads(json.dumps(policy.config))
    asked = {"command_x": [0.4, 0.4], "command_y": [0.3, 0.3], "command_yaw": [-0.6, -0.6]}
    config["task"].update(asked, episode_length=100)
    stands = policy._replace(config=config, params=actor(size=0.0, hidden=(128, 128, 128)))
    found = episodes.run(stands, 4, seed=5)
    assert (found["episodes"], found["fall_rate"], found["length"]) == (4, 0, 100)
    assert found["tracking_error"] == pytest.approx(0.5, abs=0.05)
    assert found["yaw_error"] == pytest.approx(0.6, abs=0.05)

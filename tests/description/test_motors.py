"""A robot with the motors that its config says, joint by joint; runs with them on every engine."""

import mujoco
import numpy as np
import pytest
from answers import refused

from dynappo import config as config_lib
from dynappo import train
from dynappo.config import files
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.physics import engine
from dynappo.policy import episode, policy_file, policy_source
from dynappo.program import build
from dynappo.tasks.velocity import reward_sum

CALVES = {  # N m, rad/s: limits of the vendor's URDFs (robots/go1/README.md, robots/go2/README.md)
    "go1": (35.55, 20.06),
    "go2": (45.43, 15.7),
}


def load(name="go1", variant="ppo16", **task):
    config = config_lib.load(f"{name}:{variant}")
    config.task.update(**task)
    return config_lib.validate(config)


@pytest.mark.parametrize("name", files.robots())
def test_an_armature_of_the_config_is_that_of_a_file_with_it(name):
    """With what the solver takes from it, but for the last bits; the robot that was given is as it was."""
    given = robot_lib.load(name)
    armature = (0.01 * np.arange(1, 1 + len(given.joint_names))).tolist()
    before = robot_lib.digest(given.mj_model)
    _, robot = motors.fitted(load(name, armature=armature), given)
    spec = robot_lib.physics_spec(given.xml)
    hinges = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    for joint, own in zip(hinges, armature, strict=True):
        joint.armature = own
    expected = spec.compile()
    for field in (
        "dof_armature",
        "dof_invweight0",
        "body_invweight0",
        "dof_M0",
        "body_mass",
        "qpos0",
    ):
        ours, theirs = (getattr(model, field) for model in (robot.mj_model, expected))
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=0, err_msg=field)
    assert robot_lib.digest(robot.mj_model) != before == robot_lib.digest(given.mj_model)
    assert motors.fitted(load(name), given)[1] is given


@pytest.mark.parametrize("name", CALVES)
def test_a_config_says_the_motors_of_every_joint(name):
    """Calves have their own, but not in the paper's variants: there Isaac Lab's one kind."""
    effort, speed = CALVES[name]
    for variant in ("best", "deploy", "laptop", "quick"):
        config, _ = motors.fitted(load(name, variant), robot_lib.load(name))
        assert config.task.effort_limit == config.task.saturation_effort
        assert config.task.effort_limit == (23.7, 23.7, effort) * 4
        assert config.task.velocity_limit == (30.1, 30.1, speed) * 4
        assert config.task.kp == 25.0
    for variant in ("ppo12", "ppo16", "dyna2", "dyna4_noschedule", "dyna4", "fast"):
        config, _ = motors.fitted(load(name, variant), robot_lib.load(name))
        one = 23.7 if name == "go1" else 23.5
        assert (config.task.effort_limit, config.task.velocity_limit) == (one, 30.0)


def test_what_does_not_fit_the_robot_is_told_before_anything_is_compiled():
    config = load("anymal_c", kp={".*_calf_joint": 35, ".*": 25})
    line = refused(build.check, config)
    assert line.startswith("the pattern '.*_calf_joint' of task.kp matches no joint of anymal_c")
    line = refused(build.check, load(kd=(1.0,) * 11))
    assert line.startswith("task.kd has 11 numbers, expected 12: one for each joint of go1")
    config = load(variant="best", kp={"FL.*": 35, ".*": 25})  # it learns from mirror images
    line = refused(build.check, config)
    expected = (
        "task.kp is 35 at FL_hip_joint and 25 at FR_hip_joint, expected the same left and right"
    )
    assert line.startswith(expected)
    build.check(load(kp=(25, 30, 35) * 4))


SMALL = (
    "rollout.num_envs=8 rollout.horizon=8 schedule.end_iteration=0 schedule.start_steps=4 "
    "schedule.end_steps=4 model.hidden=(16,) model.minibatches=2 model.epochs=1 ppo.hidden=(16,) "
    "ppo.shuffle_blocks=1 run.num_iterations=1 run.log_every=1 run.checkpoint_every=0 run.eval_envs=0 "
    "run.video_seconds=0.0 run.tensorboard=False run.device='cpu' physics.threads=1"
).split()


@pytest.mark.slow  # a Go1 on C MuJoCo: train/test_command.py
@pytest.mark.parametrize(("name", "impl"), [("go2", "c"), ("go1", "jax"), ("go2", "jax")])
def test_calves_with_motors_of_their_own_train(name, impl, tmp_path):
    """One iteration; the policy's file holds a number a joint, and plays."""
    config = config_lib.load(f"{name}:laptop")
    for text in [*SMALL, f"physics.impl={impl}"]:
        field, _, value = text.partition("=")
        config_lib.override(config, field, value.strip("'"))
    _, metrics = train.train(config, tmp_path)
    assert np.isfinite(metrics["kl"]).all() and np.isfinite(metrics["model_loss"]).all()
    assert not metrics["blowups"].any()
    policy, _ = policy_source.load(str(tmp_path))
    calf, _ = CALVES[name]
    np.testing.assert_array_equal(policy.effort_limit, [23.7, 23.7, calf] * 4)
    body, _ = policy_source.player(policy)
    episode.play(
        body, policy_file.actor(policy.params, policy.activation), lambda t: np.zeros(3), 0.1
    )
    text = (tmp_path / "config.json").read_text()
    back = config_lib.from_json(text)
    assert back.task.effort_limit == (23.7, 23.7, calf) * 4
    assert config_lib.difference(text, config_lib.to_json(config_lib.validate(config))) == ""


def test_a_reward_term_may_ask_for_the_number_of_each_joint():
    """As an array; one number stays one number, and no array is made in its program."""
    robot = robot_lib.load("go1")
    config, _ = motors.fitted(load(kp=(25, 30, 35) * 4), robot)
    names = reward_sum.known_names(config.task)
    assert {"kp", "kd", "joint_friction"} <= names and not {"armature", "command_x"} & names
    hyper = config_lib.split(config)[1]
    task = engine.per_joint_arrays(hyper)
    np.testing.assert_array_equal(task.kp, [25, 30, 35] * 4)
    assert task.kd is hyper.task.kd and task.command_x is hyper.task.command_x
    plain = config_lib.split(motors.fitted(load(), robot)[0])[1]
    assert engine.per_joint_arrays(plain) is plain.task

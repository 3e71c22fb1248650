"""Whole runs on C MuJoCo, with motors of their own at the calves: the same bits twice, resumed and as seeds;
checkpoints that move to MJX."""

import shutil

import jax
import numpy as np
import pytest
from toy_runs import assert_same, leaves
from workdirs import one_program  # noqa: F401, a fixture

from dynappo import config as config_lib
from dynappo import train
from dynappo.policy import episode, policy_file, policy_source

SMALL = (
    "rollout.num_envs=16 rollout.horizon=8 schedule.end_iteration=1 schedule.end_steps=4 model.hidden=(16,) "
    "model.minibatches=2 ppo.hidden=(16,) run.num_iterations=4 run.log_every=2 run.checkpoint_every=2 "
    "run.eval_envs=4 run.video_seconds=0.0 run.tensorboard=False task.episode_length=40"
).split()

# by default: a first run of a Go1 on C MuJoCo, with such motors (train/test_command.py); resumed, of the toy
pytestmark = pytest.mark.slow
CALF, OTHER = 35.55, 23.7  # N m


def settings(*fields):
    config = config_lib.load("configs/go1.py:laptop")
    limits = {".*_calf_joint": CALF, ".*": OTHER}
    config.task.update(effort_limit=limits, saturation_effort=limits)
    for text in [*SMALL, *fields]:
        config_lib.override(config, *text.split("=", 1))
    return config


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """`(state, metrics, workdir)` of a run without interruption, on one thread."""
    folder = tmp_path_factory.mktemp("whole")
    return *train.train(settings("physics.threads=1"), folder), folder


def test_a_run_on_c_mujoco_learns_from_real_rows_and_evaluates(whole):
    state, metrics, folder = whole
    assert (metrics["n_real"] == 4).all()
    assert all(np.isfinite(metrics[name]).all() for name in ("kl", "value_loss", "model_loss"))
    assert not metrics["blowups"].any()
    assert np.isfinite(state.env_state.qpos).all() and np.ptp(state.env_state.qpos[:, 2]) > 0.01
    assert '"impl": "c"' in (folder / "summary.json").read_text()


def test_its_policy_holds_a_number_a_joint_and_plays(whole):
    policy, _ = policy_source.load(str(whole[2]))
    np.testing.assert_array_equal(policy.effort_limit, [OTHER, OTHER, CALF] * 4)
    body, _ = policy_source.player(policy)
    actor = policy_file.actor(policy.params, policy.activation)
    episode.play(body, actor, lambda t: np.zeros(3), 0.1)
    text = (whole[2] / "config.json").read_text()
    back = config_lib.from_json(text)
    assert back.task.effort_limit == ((".*_calf_joint", CALF), (".*", OTHER))
    given = config_lib.to_json(config_lib.validate(settings("physics.threads=1")))
    assert config_lib.difference(text, given) == ""


@pytest.mark.parametrize("threads", [1, 3])
def test_it_resumes_to_the_bit_and_does_not_depend_on_the_threads(threads, whole, tmp_path):
    """From the checkpoint of half of the run on. Of threads in one step: physics/test_c_mujoco.py."""
    shutil.copytree(whole[2], tmp_path, dirs_exist_ok=True)
    shutil.rmtree(tmp_path / "checkpoints" / "4")
    state, metrics = train.train(settings(f"physics.threads={threads}"), tmp_path)
    assert list(metrics["iteration"]) == [1, 2, 3, 4]
    assert_same(state, whole[0])
    for name in ("episode_return", "model_loss"):  # the first rows come from the CSV
        np.testing.assert_array_equal(metrics[name][2:], whole[1][name][2:])


def test_a_seed_among_several_is_the_run_alone(whole):
    state, _ = train.train(settings("run.num_seeds=2", "run.eval_envs=0"))
    first = jax.tree.map(lambda x: x[0], state.env_state)
    for name, value in leaves(whole[0].env_state).items():
        # batched products of the networks round otherwise
        np.testing.assert_allclose(leaves(first)[name], value, 2e-3, 2e-3, err_msg=name)


def test_a_checkpoint_moves_to_mjx_and_back(whole, tmp_path):
    train.train(settings("run.num_iterations=2"), tmp_path)
    state, _ = train.train(settings("physics.impl=jax"), tmp_path)
    for name in ("qpos", "qvel"):  # far closer to the same robot than robots are to each other
        a, b = (np.asarray(getattr(s.env_state, name)) for s in (state, whole[0]))
        assert np.abs(a - b).mean() < 0.1 * np.abs(b - np.roll(b, 1, 0)).mean(), name
    state, metrics = train.train(settings("run.num_iterations=6"), tmp_path)
    assert metrics["iteration"][-1] == 6 and np.isfinite(state.env_state.qpos).all()

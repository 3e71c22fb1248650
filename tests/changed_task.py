"""Run by tests/tasks/test_change.py in a copy of the project with the differences of docs/task.md applied.

    python changed_task.py traced|trained FLAGS...     # from the folder of the copy

Reward term, observation, command range and termination against C MuJoCo and NumPy, then one iteration with
a tail, which is traced or also compiled and run, and an episode of the policy in NumPy. Any failure is an
AssertionError.
"""

import functools
import os
import sys
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import mujoco
import numpy as np

import dynappo
from dynappo import algorithm, schedule
from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.export import joint_order, onnx_file
from dynappo.physics import actuators, randomize
from dynappo.policy import episode, policy_file
from dynappo.program import build
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import observe, reward_sum

ROBOTS, ROWS = 16, 30
PLACES = observe.slices(12)
SMALL = {
    "rollout": dict(num_envs=ROBOTS, horizon=4),
    "schedule": dict(start_iteration=0, end_iteration=0, start_steps=2, end_steps=2),
    "model": dict(hidden=(16,), epochs=1, late_epochs=None, minibatches=2),
    "ppo": dict(hidden=(16,), epochs=1, minibatches=1, shuffle_blocks=1),
}


def setup(flags):
    """`(config, robot, env, hyper, body)` of a tiny run on C MuJoCo, its robots as their file has them."""
    config = config_lib.load("configs/go1.py:laptop")
    for flag in flags:
        name, _, text = flag.removeprefix("--config.").partition("=")
        config_lib.override(config, name, text)
    for group, fields in SMALL.items():
        config[group].update(fields)
    config = config_lib.validate(config)
    build.check(config)
    robot, hyper = robot_lib.load("go1"), config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    one = np.ones(ROBOTS, np.float32)
    com = robot.mj_model.body_ipos[robot.base_body].astype(np.float32)
    body = randomize.Body(one, np.tile(com, (ROBOTS, 1)), one * 0.8, one, one)
    return config, robot, env, hyper, body


def power_of(model, state, i, action, robot, task):
    """Of the last physics step of a control step, by C MuJoCo: W."""
    data = mujoco.MjData(model)
    for field in ("qpos", "qvel", "qacc_warmstart"):
        getattr(data, field)[:] = getattr(state, field)[i]
    target = robot.default_pose + task.action_scale * action
    names = "effort_limit", "saturation_effort", "velocity_limit"
    limits = {name: np.array(task[name]) for name in names}  # one number, or one a joint
    for _ in range(4):
        qd = data.qvel[6:].copy()
        torque = actuators.clip_dc_motor(
            task.kp * (target - data.qpos[7:]) - task.kd * qd, qd, **limits
        )
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
    return sum(max(float(t) * float(v), 0) for t, v in zip(torque, data.qvel[6:], strict=True))


def walk(config, robot, env, hyper, body):
    """Rows of random actions, each checked; returns the last state, and the batched step."""
    step = jax.jit(jax.vmap(env.step, (None, 0, 0, 0, 0)))
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    state = jax.device_get(jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys))
    assert 0 <= state.command[:, 0].min() and 1 < state.command[:, 0].max() <= 2, "command range"
    rng, model = np.random.default_rng(0), robot_lib.physics_model(robot, config.physics)
    weight, off = config.task.weights.motor_work, []
    for k in range(ROWS):
        action = rng.normal(0, 0.5, (ROBOTS, 12)).astype(np.float32)
        after, outcome = jax.device_get(step(hyper, body, state, action, keys))
        # reward: one number of the last physics step
        found = outcome.metrics["reward_motor_work"]
        for i in range(0, ROBOTS, 5):
            expected = weight * power_of(model, state, i, action[i], robot, config.task)
            off.append(abs(found[i] - expected) / abs(expected))
        parts = [v for name, v in outcome.metrics.items() if name.startswith("reward_")]
        np.testing.assert_allclose(outcome.reward, 0.02 * np.sum(parts, axis=0), atol=1e-5)
        # observation: where the base is, and what the clock says
        np.testing.assert_allclose(after.prop[:, PLACES["base_height"]], after.qpos[:, 2:3])
        angle = 2 * np.pi * (k + 1) / 25
        clock = np.tile([np.sin(angle), np.cos(angle)], (ROBOTS, 1))
        np.testing.assert_allclose(after.obs[:, PLACES["gait_clock"]], clock, atol=1e-5)
        before = state.obs[:, env.prop_size :], state.prop
        known = env.advance(hyper, *before, action, after.prop)  # what the model's tail is given
        np.testing.assert_allclose(known, after.obs[:, env.prop_size :], atol=1e-5)
        state = after
    assert np.median(off) < 1e-3, f"motor work is off by {np.median(off)}"
    return state, lambda hyper, state: step(hyper, body, state, action, keys)[1]


def check_termination(hyper, state, step):
    """Some robots are lower than the height that is asked for: exactly these fall."""

    def at(height):
        return hyper._replace(task=hyper.task._replace(min_height=height))

    before = step(at(0.0), state)
    height = np.float32(np.median(before.next_prop[:, PLACES["base_height"]]))
    after = step(at(height), state)
    low = before.next_prop[:, PLACES["base_height"]][:, 0] < height
    assert low.any() and not low.all() and before.discount.any()
    np.testing.assert_array_equal(after.discount, np.where(low, 0.0, before.discount))
    np.testing.assert_array_equal(after.metrics["falls"], 1 - after.discount)


def check_iteration(how, config, env, hyper):
    """Two real rows and two of the model; returns the parameters of the policy, if "trained" new ones."""
    static = config_lib.split(config)[0]
    begin = jax.jit(functools.partial(algorithm.init, env, static=static))
    state = begin(hyper, jax.random.key(1))
    columns = {name: column[:1] for name, column in schedule.columns(config).items()}
    assert int(columns["n_real"][0]) == 2
    run = functools.partial(algorithm.run, env, static=static)
    expected = ("reward_motor_work", "model_loss", "kl", "model_error_1")
    if how == "traced":
        after, metrics = jax.eval_shape(run, hyper, state, columns)
        assert set(expected[:3]) <= set(metrics), sorted(metrics)
        assert jax.tree.structure(after) == jax.tree.structure(state)
        return jax.device_get(state.learner.params)
    state, metrics = jax.device_get(jax.jit(run)(hyper, state, columns))
    known = [name for name in expected if name in metrics]
    assert set(expected[:3]) <= set(known), sorted(metrics)
    assert all(np.isfinite(metrics[name]).all() for name in known)
    assert metrics["reward_motor_work"][0] < 0
    return state.learner.params


def check_play(config, robot, params):
    """The policy as a file, and an episode of it in NumPy."""
    path = Path("policy.npz")
    policy_file.save(path, params, config, robot)
    policy = policy_file.load(path)
    assert policy.observation == observe.name("full", 12) == "velocity-gait-51"
    act, seen = policy_file.actor(policy.params, policy.activation), []

    def looked(obs):
        seen.append(obs)
        return act(obs)

    body = episode.load(robot.xml, policy, policy.timestep)
    played = episode.play(body, looked, lambda t: np.array([2.0, 0.0, 0.0]), 0.6)
    k = np.arange(len(seen))
    clock = np.stack([np.sin(2 * np.pi * k / 25), np.cos(2 * np.pi * k / 25)], -1)
    np.testing.assert_allclose(np.array(seen)[:, PLACES["gait_clock"]], clock, atol=1e-9)
    heights = np.array(seen)[1:, PLACES["base_height"]][:, 0]
    np.testing.assert_allclose(heights, played["qpos"][:-1, 2])
    high = policy._replace(config=policy.config | {"task": dict(min_height=1.0)})
    fell = [
        episode.play(body._replace(policy=p), act, lambda t: np.zeros(3), 0.02)["fell"].any()
        for p in (policy, high)
    ]
    assert fell == [False, True]
    rows = {row["name"]: row["stop"] - row["start"] for row in onnx_file.observation_table(policy)}
    assert rows["gait_clock"] == 2 and rows["base_height"] == 1 and sum(rows.values()) == 51
    turned = joint_order.permute(policy, policy.joint_names[::-1])
    first = [p.params["actor"]["params"]["Dense_0"]["kernel"] for p in (policy, turned)]
    same = [PLACES[name] for name in ("base_height", "gait_clock")]
    assert all((first[0][rows] == first[1][rows]).all() for rows in same)


def main(how, flags):
    assert how in ("traced", "trained")
    assert Path(dynappo.__file__).is_relative_to(Path.cwd()), dynappo.__file__
    config, robot, env, hyper, body = setup(flags)
    assert (env.obs_size, env.prop_size) == (51, 34)
    index, sign = env.mirror[0]
    assert sign[PLACES["gait_clock"]].tolist() == [-1, -1] and sign[33] == 1
    assert index[33] == 33 and index[-2:].tolist() == [49, 50] and sorted(index) == list(range(51))
    known = reward_sum.known(reward_sum.terms_of(config.task), config.task)
    assert "motor_work" not in known and "action_rate" in known
    state, step = walk(config, robot, env, hyper, body)
    check_termination(hyper, state, step)
    check_play(config, robot, check_iteration(how, config, env, hyper))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])

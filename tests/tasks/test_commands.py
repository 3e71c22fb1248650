"""Commands against Isaac Lab's rules (velocity_command.py) written out for one robot in NumPy."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import commands, observe
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity.state import Goal

PAPER = SimpleNamespace(heading=False, resample_steps=0)
ISAAC = SimpleNamespace(heading=True, resample_steps=500)
RANGES = dict(command_x=(-1.0, 0.5), command_y=(-0.25, 0.75), command_yaw=(-0.8, 1.0))
WHOLE = dict(heading_gain=0.5, slow_commands=None)
HYPER, HALF = (
    SimpleNamespace(task=SimpleNamespace(**RANGES, **WHOLE, standing=standing))
    for standing in (0.0, 0.5)
)
LEVEL = jnp.array([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0])


def draws(task, hyper, count=4000):
    keys = jax.random.split(jax.random.key(0), count)
    return jax.device_get(jax.vmap(lambda k: commands.draw(task, hyper, LEVEL, k))(keys))


def yaw_of(quat):
    """Direction of the base's x axis, by C MuJoCo."""
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, quat)
    return np.arctan2(frame[3], frame[0])


def test_the_papers_command_is_uniform_in_its_ranges_and_never_changes():
    command, goal = draws(PAPER, HYPER)
    for column, (low, high) in zip(command.T, RANGES.values(), strict=True):
        assert low <= column.min() and column.max() <= high
        deciles = np.quantile(column, np.linspace(0.1, 0.9, 9))
        expected = low + (high - low) * np.linspace(0.1, 0.9, 9)
        np.testing.assert_allclose(deciles, expected, atol=0.04 * (high - low))
    assert abs(np.corrcoef(command.T) - np.eye(3)).max() < 0.06
    goal = jax.tree.map(lambda x: x[0], goal)
    turned = jnp.array([3.0, 1.0, 0.3, 0.0, 0.0, 0.0, 1.0])
    after = commands.advance(PAPER, HYPER, command[0], goal, turned, jax.random.key(1))
    np.testing.assert_array_equal(after[0], command[0])
    assert after[1] is goal


def test_the_heading_of_any_attitude_is_that_of_the_x_axis():
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(200, 4))
    quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
    for quat in quats:
        assert observe.heading(quat) == pytest.approx(yaw_of(quat), abs=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_the_yaw_rate_turns_the_shorter_way_to_the_heading_and_fades(tilt):
    rng = np.random.default_rng(1)
    for _ in range(50):
        target, yaw = rng.uniform(-np.pi, np.pi, 2)
        quat = np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
        mujoco.mju_mulQuat(quat, quat.copy(), np.array([np.cos(tilt), np.sin(tilt), 0, 0]))
        qpos = jnp.array([0, 0, 0.3, *quat])
        goal = Goal(jnp.float32(target), jnp.float32(0), jnp.int32(500))
        before = jnp.array([0.4, -0.2, 9.0])
        command = commands.follow(ISAAC, HYPER, before, goal, qpos)
        # the turn between two directions, by complex numbers
        left = np.angle(np.exp(1j * target) / np.exp(1j * yaw_of(quat)))
        if abs(abs(left) - np.pi) > 1e-3:  # either way is as long
            expected = np.clip(0.5 * left, -0.8, 1.0)
            np.testing.assert_allclose(command, [0.4, -0.2, expected], atol=1e-5)
    goal = Goal(jnp.float32(yaw_of(quat)), jnp.float32(0), jnp.int32(500))
    np.testing.assert_allclose(commands.follow(ISAAC, HYPER, before, goal, qpos)[2], 0, atol=1e-6)


def test_a_new_command_comes_every_resample_steps_and_not_before():
    key = jax.random.key(3)
    command, goal = commands.draw(ISAAC, HYPER, LEVEL, key)
    step = jax.jit(lambda c, g, k: commands.advance(ISAAC, HYPER, c, g, LEVEL, k))
    changed = []
    for t in range(1200):
        after, goal = step(command, goal, jax.random.fold_in(key, t))
        if (after != command).any():
            changed.append(t + 1)
            assert goal.steps_left == 500
        command = after
    assert changed == [500, 1000]


def test_standing_robots_get_zeros_until_the_next_draw_and_as_often_as_asked():
    command, goal = draws(ISAAC, HALF)
    stands = goal.standing == 1
    assert abs(stands.mean() - 0.5) < 0.03
    assert (command[stands] == 0).all() and (command[~stands] != 0).all()
    still = Goal(jnp.float32(2.0), jnp.float32(1), jnp.int32(2))
    command, goal = commands.advance(ISAAC, HALF, jnp.zeros(3), still, LEVEL, jax.random.key(0))
    assert (command == 0).all() and goal.steps_left == 1
    fresh = [
        commands.advance(ISAAC, HALF, command, goal, LEVEL, jax.random.key(k))[1].standing
        for k in range(30)
    ]
    assert {float(x) for x in fresh} == {0.0, 1.0}
    assert not draws(ISAAC, HYPER)[1].standing.any()


def test_as_many_commands_as_asked_are_slow_all_of_one_alike():
    """A uniform share from 0 to 0.5 of a command that is uniform in its ranges, whatever that is; with none
    slow the numbers are drawn by another key, with the same distribution."""
    hyper = SimpleNamespace(task=SimpleNamespace(**vars(HYPER.task) | {"slow_commands": 0.3}))
    every = SimpleNamespace(task=SimpleNamespace(**vars(HYPER.task) | {"slow_commands": 1.0}))
    none = SimpleNamespace(task=SimpleNamespace(**vars(HYPER.task) | {"slow_commands": 0.0}))
    whole, mixed, slow = (draws(PAPER, one)[0] for one in (none, hyper, every))
    share = slow / whole  # the same keys: the same commands
    np.testing.assert_allclose(share, share[:, :1] * np.ones(3), rtol=1e-4)
    deciles = np.quantile(share[:, 0], np.linspace(0.1, 0.9, 9))
    np.testing.assert_allclose(deciles, np.linspace(0.05, 0.45, 9), atol=0.02)
    assert abs(np.corrcoef(share[:, 0], whole[:, 0])[0, 1]) < 0.06
    is_slow = (mixed != whole).all(1)
    assert abs(is_slow.mean() - 0.3) < 0.03
    np.testing.assert_array_equal(mixed, np.where(is_slow[:, None], slow, whole))


def test_headings_are_drawn_all_around():
    heading = draws(ISAAC, HYPER)[1].heading
    counts, _ = np.histogram(heading, bins=8, range=(-np.pi, np.pi))
    assert counts.sum() == len(heading) and counts.min() > 400


def test_a_tail_may_hear_another_command_and_nothing_else_is_new():
    """Of Go1's observation the three numbers of the command, drawn in their ranges."""
    config = config_lib.validate(config_lib.load("configs/go1.py:best"))
    robot = robot_lib.load("go1")
    env = env_lib.make(robot, config.task, config.physics)
    hyper = config_lib.split(config)[1]
    assert env.retell is not None
    context = jnp.arange(7.0, 7.0 + env.obs_size - env.prop_size)
    keys = jax.random.split(jax.random.key(0), 200)
    told = np.asarray(jax.vmap(lambda key: env.retell(hyper, context, key))(keys))
    np.testing.assert_array_equal(told[:, 3:], np.broadcast_to(context[3:], told[:, 3:].shape))
    assert np.abs(told[:, :3]).max() <= 1 and (told[:, :3].std(0) > 0.5).all()
    assert env.prop_size == 33  # the command is 33 to 35 of observe.py's table
    follows = config_lib.validate(config_lib.load("configs/go1.py:rough"))
    assert env_lib.make(robot, follows.task, follows.physics).retell is None

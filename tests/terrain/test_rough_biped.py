"""G1 on rough ground in C MuJoCo: its variants, and its feet's heights in the reward, also in a tail."""

import math
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import gait, surroundings, view
from dynappo.terrain import tiles

ROBOTS, STEPS = 8, 10
SMALL = {
    "task.tiles.rows": 3,
    "task.tiles.columns": 6,
    "task.tiles.shares": (1.0,) * 6,
    "task.tiles.stairs": (0.1, 0.15),
    "task.standing": 0.0,
    "physics.impl": "c",
    "physics.threads": 1,
}


def configured(variant, **fields):
    config = config_lib.load(f"configs/g1.py:{variant}")
    for name, value in (SMALL | fields).items():
        config_lib.override(config, name, str(value))
    return config_lib.validate(config)


@pytest.fixture(scope="module")
def world():
    """Rows of G1s that stand or fall on stairs and boxes."""
    config, robot = motors.fitted(configured("rough_blind"), robot_lib.load("g1"))
    hyper = config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    # over the steps around the platform in the middle
    rng = np.random.default_rng(0)
    there = np.asarray(state.qpos).copy()
    there[:, :2] += rng.uniform(1.5, 2.5, (ROBOTS, 2)) * rng.choice([-1, 1], (ROBOTS, 2))
    there[:, 2] += 0.1
    state = state.replace(qpos=jnp.asarray(there))
    step = jax.jit(jax.vmap(partial(env.step, hyper)))
    rows = []
    for t in range(STEPS):
        action = rng.normal(0, 0.2, (ROBOTS, 29)).astype(np.float32)
        after, outcome = step(body, state, action, jax.random.split(jax.random.key(t), ROBOTS))
        rows.append(jax.device_get((state, action, after, outcome)))
        state = after
    return SimpleNamespace(config=config, robot=robot, hyper=hyper, env=env, rows=rows)


@pytest.mark.parametrize("variant", ["rough", "rough_blind", "rough_deploy"])
def test_variants_are_a_bipeds_task_on_rough_ground(variant):
    config, flat = configured(variant), config_lib.load("configs/g1.py:best")
    task = config.task
    assert task.terrain == "rough" and task.heading and task.episode_length == 1000
    assert task.scan == ("none" if variant == "rough_blind" else "grid")
    assert task.weights.feet_phase > 0 and task.gait_frequency == flat.task.gait_frequency
    assert task.weights.vertical_velocity == 0 and task.command_y == (0, 0)
    assert config.model.hidden == flat.model.hidden  # a biped's model, not a quadruped's
    assert (task.observation == "onboard") == (variant == "rough_deploy")
    assert (task.push.velocity > 0) == (variant == "rough_deploy")
    assert config_lib.validate(flat).task.terrain == "flat"


def test_the_gait_clock_measures_feet_above_the_ground_under_them(world):
    """By loops: MuJoCo's places of the feet, and the map's heights at its points around them."""
    ground, data = tiles.make(world.config.task.tiles), mujoco.MjData(world.robot.mj_model)
    size, uneven = world.config.task.gait_foot_height, 0
    for before, _, after, outcome in world.rows:
        for i in range(ROBOTS):
            data.qpos[:] = after.qpos[i]
            mujoco.mj_kinematics(world.robot.mj_model, data)
            above, below = [], []
            for foot in (0, 1):
                middle = data.geom_xpos[world.robot.feet[world.robot.foot_of == foot]].mean(0)
                below.append(under(ground, *middle[:2]))
                above.append(middle[2] - below[-1])
            command = before.command[i].astype(float)
            phase = gait.shown(float(before.gait.angle[i]), command)
            off = np.array(above) - min(above) - gait.target(phase, size)
            expected = 0.0 if not outcome.valid[i] else math.exp(-((off / (size / 1.5)) ** 2).sum())
            weight = world.config.task.weights.feet_phase
            found = outcome.metrics["reward_feet_phase"][i]
            assert found == pytest.approx(weight * expected, rel=2e-3, abs=1e-5)
            uneven += abs(below[0] - below[1]) > 0.04
    assert uneven > 10


def under(ground, x, y):
    """The height of the map at a point, on the triangle of its cell."""
    s, t = (x - ground.corner[0]) / ground.cell, (y - ground.corner[1]) / ground.cell
    i, j = int(s), int(t)
    s, t, h = s - i, t - j, ground.heights.astype(float)
    middle = h[i + 1, j] if s >= t else h[i, j + 1]
    big, small = max(s, t), min(s, t)
    return h[i, j] + (middle - h[i, j]) * big + (h[i + 1, j + 1] - middle) * small


def test_a_tail_knows_the_gait_clocks_reward_on_rough_ground(world):
    """The known share of a row, of what physics makes of it; the feet's heights are a few mm off."""
    env, hyper = world.env, world.hyper
    of_row = jax.jit(jax.vmap(partial(env.known_reward, hyper)))
    names = (
        "track_linear_velocity track_yaw_rate roll_pitch_rate flat_orientation action_rate upright"
    )
    names = [
        *names.split(),
        "vertical_velocity",
        "posture",
        "feet_phase",
        "feet_distance",
        "stand_still",
    ]
    off, worth = [], []
    for before, action, _, outcome in world.rows:
        found = of_row(before.obs, action, outcome.next_prop)
        expected = env.dt * sum(outcome.metrics[f"reward_{name}"] for name in names)
        good = outcome.valid > 0
        off.append((found - expected)[good])
        worth.append(env.dt * outcome.metrics["reward_feet_phase"][good])
    off, worth = np.concatenate(off), np.concatenate(worth)
    # the rest are feet over an edge
    assert np.median(abs(off)) < 1e-5 and np.quantile(abs(off), 0.9) < 3e-4
    assert worth.std() > 3e-3


def test_networks_see_clock_and_ground(world):
    task, robot = world.config.task, world.robot
    around = surroundings.make(robot, task, world.config.physics, tiles.make(task.tiles))
    layout = view.make(task.observation, task.history, 29, clock=True, around=around)
    assert view.size(layout) == world.env.obs_size
    views = view.views(layout)
    # around two feet, and how fast the clock goes
    assert len(views.critic) - len(views.actor) == 2 * 5 + 1

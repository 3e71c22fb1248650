"""The numbers that are drawn for robots: each uniform, and all independent of each other.

Thousands of Go1s with every option that draws, through `algorithm.init`, the policy's action and one
`algorithm.physics_step`. A number is what it changes: noise is the observation less that of the same
call without noise, a push what the velocity differs by, the coin of `carry_on` whether the robot stayed.
"""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from toy_env import configure
from toy_runs import assert_same

from dynappo import algorithm, rollout
from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import observe, view

ROBOTS, BINS = 2048, 4
FIELDS = {
    "rollout.num_envs": ROBOTS,
    "ppo.hidden": (8, 8),
    "model.hidden": (8, 8),
    "task.formulation": "isaaclab_exact",  # headings; commands and robots that stand
    "task.resample_steps": 1,  # a new command in each step
    "task.standing": 0.3,
    "task.random_clock": True,
    "task.carry_on": True,
    "task.start_anew": 0.3,
    "task.keep_command": 0.2,
    "task.history": 3,
    "task.episode_length": 1000,
    "task.command_x": (-1.0, 0.5),
    "task.command_y": (-0.25, 0.75),
    "task.reset.velocity": 0.5,
    "task.reset.joint_scale": (0.98, 1.02),  # inside the joints' limits
    "task.reset.spawn_height": 1.0,  # nothing touches the ground
    "task.noise.joint_vel": 0.5,
    "task.push.velocity": 1.0,
    "physics.contacts": "full",
    "physics.impl": "c",
}


def changed(hyper, **fields):
    return hyper._replace(task=hyper.task._replace(**fields))


@pytest.fixture(scope="module")
def world():
    """Robots at their start, after a step (`on`), and after the same step as their last one (`new`)."""
    config = configure(FIELDS, "configs/go1.py:deploy")
    static, hyper = config_lib.split(config)
    robot = robot_lib.load("go1")
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    quiet = changed(hyper, noise=jax.tree.map(jnp.zeros_like, hyper.task.noise))
    still = changed(hyper, push=hyper.task.push._replace(velocity=0.0))
    init = jax.jit(partial(algorithm.init, env, static=static))

    @jax.jit
    def row(hyper, state, key):
        keys = rollout.row_keys(key, state.robot_index)(0)
        action, mean, *_ = algorithm.policy(static, env, state.learner.params)(
            first.env_state, keys
        )
        step = algorithm.physics_step(env, hyper, state.params_physics)
        return action - mean, *step(state.env_state, action, keys)

    first, clean = init(hyper, jax.random.key(1)), init(quiet, jax.random.key(1))
    key = jax.random.fold_in(first.key, 1)
    due = jnp.ones(ROBOTS, jnp.int32)
    state = first.env_state.replace(push_in=due, clock=due * 0)
    last = state.replace(clock=due * (env.episode_length - 1))
    noise, on, outcome = row(hyper, first.replace(env_state=state), key)
    calm = row(still, first.replace(env_state=state), key)[1]
    _, new, ended = row(hyper, first.replace(env_state=last), key)
    unseen = [row(quiet, first.replace(env_state=s), key)[1].obs for s in (state, last)]
    made = dict(first=first, clean=clean.env_state, on=on, calm=calm, new=new, unseen=unseen)
    made = jax.device_get(made | dict(action=noise, outcome=outcome, ended=ended))
    stays = (made["new"].qpos == made["on"].qpos).all(-1)
    same = stays & (made["new"].goal.heading == made["on"].goal.heading)
    about = dict(stays=stays, same=same, static=static, hyper=hyper, robot=robot, env=env)
    return SimpleNamespace(**made, **about)


CHANCES = {  # of what is or is not; the coin of those that stay, and of these that keep their command
    "stands": FIELDS["task.standing"],
    "coin stays": 1 - FIELDS["task.start_anew"],
    "coin same": FIELDS["task.keep_command"] / (1 - FIELDS["task.start_anew"]),
}


def share(value, low, high):
    """Where in its range a number is, 0 to 1."""
    return (np.asarray(value, float) - low) / (np.asarray(high, float) - low)


def of_body(world):
    """The draws of `randomize`."""
    ranges, body = world.hyper.task.randomize, world.first.params_physics
    base = world.robot.base_body
    mass, com = world.robot.mj_model.body_mass[base], world.robot.mj_model.body_ipos[base]
    out = {"mass": share((body.mass_scale - 1) * mass, *ranges.base_mass)}
    out["com"] = share(body.base_com - com, -np.array(ranges.base_com), np.array(ranges.base_com))
    for name in "friction kp_scale kd_scale strength armature joint_friction delay".split():
        out[name] = share(getattr(body, name), *getattr(ranges, name))
    for name in ("encoder_bias", "imu_tilt"):
        width = getattr(ranges, name)
        out[name] = share(getattr(body, name), -width, width)
    return out


def of_pose(world, state):
    """The draws of a reset, but for its command and noise."""
    reset = world.hyper.task.reset
    yaw = 2 * np.arctan2(state.qpos[:, 6], state.qpos[:, 3])
    return {
        "position": share(state.qpos[:, :2], -reset.position, reset.position),
        "yaw": share(yaw, -reset.yaw, reset.yaw),
        "joints": share(state.qpos[:, 7:] / world.robot.default_pose, *reset.joint_scale),
        "velocity": share(state.qvel[:, :6], -reset.velocity, reset.velocity),
        "wait": of_wait(world, state),
    }


def of_wait(world, state):
    return share(state.push_in * world.env.dt, *world.hyper.task.push.interval)


def of_command(world, state):
    """Those of a command; what a standing robot would be asked is not to be seen."""
    task, stands = world.hyper.task, state.goal.standing == 1
    asked = [share(state.command[:, i], *(task.command_x, task.command_y)[i]) for i in (0, 1)]
    asked = np.where(stands[:, None], np.nan, np.stack(asked, -1))
    return {"asked": asked, "heading": share(state.goal.heading, -np.pi, np.pi), "stands": stands}


def of_noise(world, obs, clean):
    """Those of an observation."""
    width = observe.noise_scale(world.hyper.task.noise, np, 12)[:33]
    return {"noise": share((obs - clean)[:, :33], -width, width)}


@pytest.fixture(scope="module")
def drawn(world):
    """`{name: share [R]}` of each number that is drawn for a robot; NaN where nothing tells it."""
    start, on, new = world.first.env_state, world.on, world.new
    length, velocity = world.env.episode_length, world.hyper.task.push.velocity
    kick = on.qvel[:, :2] - world.calm.qvel[:, :2]
    kick = {"kick": share(kick, -velocity, velocity), "wait": of_wait(world, on)}
    pose = of_pose(world, new).items()
    pose = {name: np.where(world.stays, np.nan, np.transpose(x)).T for name, x in pose}
    told = of_command(world, new).items()  # those that keep their command are told nothing
    told = {name: np.where(world.same, np.nan, np.transpose(x)).T for name, x in told}
    coins = {
        "coin stays": world.stays,
        "coin same": np.where(world.stays, world.same, np.nan),
    }
    groups = {
        "body": of_body(world),
        "start": of_pose(world, start) | {"clock": share(start.clock + 0.5, 0, length)},
        "start's": of_command(world, start) | of_noise(world, start.obs, world.clean.obs),
        "action": {"noise": stats.norm.cdf(world.action / world.hyper.ppo.init_std)},
        "step": kick | of_command(world, on) | of_noise(world, on.obs, world.unseen[0]),
        "new": pose | coins,
        "new's": told | of_noise(world, new.obs, world.unseen[1]),
    }
    out = {}
    for group, parts in groups.items():
        for name, values in parts.items():
            columns = np.reshape(values, (ROBOTS, -1)).T
            out |= {f"{group} {name} {i}": np.asarray(x, float) for i, x in enumerate(columns)}
    return out


def test_each_row_was_what_it_should_be(world):
    """Nobody fell, and the last step ended every episode: `stays` is the coin."""
    assert world.outcome.discount.all() and not world.outcome.truncation.any()
    assert world.ended.truncation.all() and not world.new.clock.any()
    np.testing.assert_array_equal(world.ended.reward, world.outcome.reward)


def test_every_number_fills_its_range_evenly(drawn):
    assert len(drawn) == 199
    for name, values in drawn.items():
        values = values[~np.isnan(values)]
        chance = [p for kind, p in CHANCES.items() if kind in name]
        if chance:
            assert stats.binomtest(int(values.sum()), len(values), *chance).pvalue > 1e-4, name
        else:
            assert stats.kstest(values, "uniform").pvalue > 1e-4, name


def dependent(columns) -> dict[tuple[str, str], float]:
    """Pairs of columns of shares that depend on each other, with the p-value: of chi-square on a table of
    quarters, or of the correlation. NaN belongs to no table."""
    names, x = list(columns), np.stack(list(columns.values()))
    k = len(names)
    place = np.clip(np.floor(x * BINS), 0, BINS - 1)
    hot = (place[:, None] == np.arange(BINS)[:, None]).reshape(k * BINS, -1).astype(float)
    table = (hot @ hot.T).reshape(k, BINS, k, BINS).swapaxes(1, 2)
    rows, columns_ = table.sum(3, keepdims=True), table.sum(2, keepdims=True)
    expected = rows * columns_ / np.maximum(table.sum((2, 3), keepdims=True), 1)
    error = np.where(expected > 0, (table - expected) ** 2 / np.maximum(expected, 1e-9), 0)
    degrees = ((rows > 0).sum((2, 3)) - 1) * ((columns_ > 0).sum((2, 3)) - 1)
    p = stats.chi2.sf(error.sum((2, 3)), np.maximum(degrees, 1))
    both = ~np.isnan(x)
    unit = (x - np.nanmean(x, 1, keepdims=True)) / np.nanstd(x, 1, keepdims=True)
    unit, count = np.where(both, unit, 0), both.astype(float) @ both.T
    p = np.minimum(p, 2 * stats.norm.sf(np.abs(unit @ unit.T) / np.sqrt(np.maximum(count, 1))))
    pairs = np.argwhere(np.triu(p < 1e-9, 1))
    return {(names[i], names[j]): p[i, j] for i, j in pairs}


def test_no_number_depends_on_another(drawn):
    """Of 30,000 pairs; the smallest p-value of as many independent pairs is about 1e-5."""
    assert not dependent(drawn)


def test_those_that_stay_and_those_that_begin_anew_are_asked_alike(world, drawn):
    asked = [name for name in drawn if name.startswith(("new's asked", "new's heading"))]
    assert len(asked) == 3
    for name in asked:
        halves = [
            drawn[name][half & ~np.isnan(drawn[name])] for half in (world.stays, ~world.stays)
        ]
        for half in halves:
            assert len(half) > 400 and stats.kstest(half, "uniform").pvalue > 1e-4, name
        assert stats.ks_2samp(*halves).pvalue > 1e-4, name
    told = drawn["new's asked 0"]
    for name in ("step kick 0", "new's noise 0", "body mass 0", "start clock 0", "start yaw 0"):
        low = drawn[name] < 0.5
        halves = [told[half & ~np.isnan(told)] for half in (low, ~low)]
        assert stats.ks_2samp(*halves).pvalue > 1e-4, name


def test_those_that_keep_their_command_keep_all_of_it_and_the_others_none(world):
    """Command, heading, standing and the steps until the next one; what begins anew is the clock."""
    new, on, same = world.new, world.on, world.same
    assert 300 < same.sum() < world.stays.sum()
    for name in ("command", "goal"):
        kept, had = (jax.tree.map(lambda x: x[same], getattr(s, name)) for s in (new, on))
        assert_same(kept, had)
    assert not (new.goal.heading == on.goal.heading)[~same].any()
    for name in ("clock", "episode_steps", "episode_return"):
        assert not getattr(new, name)[same].any() and getattr(on, name).any(), name


def test_those_that_stay_keep_their_readings_and_the_others_have_the_first_one(world):
    past = slice(48, 48 + 2 * 45)
    now = world.new.obs[:, view.reading(view.make("onboard", 3, 12))]
    stays = world.stays
    np.testing.assert_array_equal(world.new.obs[stays, past], world.on.obs[stays, past])
    np.testing.assert_array_equal(world.new.obs[~stays, past], np.tile(now, 2)[~stays])

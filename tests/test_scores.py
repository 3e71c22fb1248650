"""Deterministic episodes against a NumPy loop, one robot and one step at a time."""

import functools
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import algorithm, scores
from dynappo.learner import ppo
from dynappo.physics import randomize
from dynappo.types import Outcome

ROBOTS, STEPS, LIMIT = 12, 25, 20  # episodes of 25 steps, in training of 20
SETTLED = 10  # steps of the first second, at 0.1 s


@pytest.fixture(scope="module")
def settings():
    """`(static, hyper)` of the toy, with noise and randomised bodies that must not matter."""
    fields = {"task.noise.joint_pos": 0.5, "task.randomize.base_mass": (-5.0, 20.0)}
    return toy_env.settings(fields)[1:]


@pytest.fixture(scope="module")
def params(settings):
    """A policy whose robots do not all fall, and do not all stand."""
    static, hyper = settings
    params = jax.jit(partial(ppo.init, static, hyper, 6, 2))(jax.random.key(6)).params
    last = params["actor"]["params"]["Dense_2"]
    last["kernel"] = last["kernel"] * 3
    return params


@pytest.fixture(scope="module")
def assess(settings):
    """`assess(params, seed, steps, randomize, hyper, **kwargs of toy_env.make)`, compiled once for each."""
    static, default = settings

    @functools.cache
    def program(steps, randomize, kwargs):
        env = toy_env.make(**dict(kwargs))
        run = partial(scores.evaluate, env, static=static, num_envs=ROBOTS, num_steps=steps)
        return jax.jit(partial(run, randomize=randomize))

    def call(params, seed=0, steps=STEPS, randomize=False, hyper=default, **kwargs):
        kwargs = {"episode_length": LIMIT} | kwargs
        run = program(steps, randomize, tuple(kwargs.items()))
        return run(hyper, params, jax.random.key(seed))

    return call


def actor(params, obs):
    """The mean action of one robot, in NumPy."""
    layers = params["actor"]["params"]
    for i in range(len(layers)):
        kernel, bias = (np.asarray(layers[f"Dense_{i}"][k], np.float64) for k in ("kernel", "bias"))
        obs = obs @ kernel + bias
        if i < len(layers) - 1:
            obs = np.where(obs > 0, obs, np.expm1(np.minimum(obs, 0)))
    return obs


def start(settings, seed):
    """`(prop [3], command)` of every robot, from the environment's reset on the nominal task."""
    hyper, env = scores.nominal(settings[1]), toy_env.make()
    key = jax.random.fold_in(jax.random.key(seed), algorithm.EPISODES)
    body_keys, reset_keys, _ = (jax.random.split(k, ROBOTS) for k in jax.random.split(key, 3))
    bodies = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, body_keys)
    np.testing.assert_array_equal(bodies, 1.0)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, bodies, reset_keys)
    return np.asarray(state.prop, np.float64), np.asarray(state.command, np.float64)


def reference(settings, params, seed, steps):
    """Every metric, and how many robots fell, by loops over robots and steps."""
    returns, lengths, falls, errors = [], [], [], []
    for prop, command in zip(*start(settings, seed), strict=True):
        action, total, fell = np.zeros(2), 0.0, False
        for t in range(steps):
            action = actor(params, np.concatenate([prop, [command], action]))
            prop = np.array(toy_env.A) @ prop + np.array(toy_env.B) @ action
            error = (prop[0] - command) ** 2
            total += toy_env.DT * (1 - error - 0.01 * (action**2).sum())
            fell = abs(prop[1]) > toy_env.LIMIT
            if t >= SETTLED and not fell:
                errors.append(error)
            if fell:
                break
        returns.append(total)
        lengths.append(t + 1)
        falls.append(fell)
    return {
        "return": np.mean(returns),
        "return_std": np.std(returns),
        "length": np.mean(lengths),
        "fall_rate": np.mean(falls),
        "tracking_error": np.sqrt(np.mean(errors)),
    }


@pytest.mark.parametrize(
    "seed, steps, limit", [(0, STEPS, LIMIT), (1, STEPS, LIMIT), (0, 15, 1000)]
)
def test_episodes_are_those_of_a_loop(assess, settings, params, seed, steps, limit):
    """Return, its spread, length, falls, and the tracking error after the first second.

    Robots that fell count no more. Episodes may be longer or shorter than those of training.
    """
    metrics = assess(params, seed, steps, episode_length=limit)
    expected = reference(settings, params, seed, steps)
    assert metrics.keys() == expected.keys()
    assert 0 < expected["fall_rate"] < 1
    for name, value in expected.items():
        np.testing.assert_allclose(metrics[name], value, 2e-4, err_msg=name)


def test_totals_are_sums_over_the_episodes_that_count(settings, params):
    """The reward itself as a term of it: its sum is the return, also where robots fell before the end."""
    static, hyper = settings
    env = toy_env.make(episode_length=LIMIT)

    def step(*arguments):
        state, outcome = env.step(*arguments)
        return state, outcome.replace(metrics=outcome.metrics | {"reward_all": outcome.reward})

    told = env._replace(step=step, metrics=(*env.metrics, "reward_all"))
    sizes = {"static": static, "num_envs": ROBOTS, "num_steps": STEPS, "totals": ("reward_all",)}
    metrics = jax.jit(partial(scores.evaluate, told, **sizes))(hyper, params, jax.random.key(0))
    assert 0 < metrics["fall_rate"] < 1
    np.testing.assert_allclose(metrics["total_reward_all"], metrics["return"], 1e-5)


def test_a_robot_crosses_its_tile_once(settings, params):
    """Where it is fast, without a fall. Its episode ends there, and those after it count as little."""
    static, hyper = settings
    env = toy_env.make(episode_length=LIMIT)

    def step(*arguments):
        state, outcome = env.step(*arguments)
        crossed = (abs(outcome.next_prop[0]) > 0.4) * outcome.discount
        told = outcome.metrics | {"crossings": crossed}
        return state, outcome.replace(truncation=crossed, metrics=told)

    told = env._replace(step=step, metrics=(*env.metrics, "crossings"))
    sizes = {"static": static, "num_envs": ROBOTS, "num_steps": STEPS}
    metrics = jax.jit(partial(scores.evaluate, told, **sizes))(hyper, params, jax.random.key(0))
    crossed = 0
    for prop, command in zip(*start(settings, 0), strict=True):
        action, ended = np.zeros(2), False
        for _ in range(STEPS):
            action = actor(params, np.concatenate([prop, [command], action]))
            prop = np.array(toy_env.A) @ prop + np.array(toy_env.B) @ action
            fell = abs(prop[1]) > toy_env.LIMIT
            crossed += (abs(prop[0]) > 0.4) * (not fell and not ended)
            ended |= fell or abs(prop[0]) > 0.4
    assert 0 < crossed < ROBOTS
    np.testing.assert_allclose(metrics["crossed"], crossed / ROBOTS, 1e-6)


def test_an_evaluation_is_deterministic_and_its_commands_are_drawn(assess, params):
    """The same key gives the same bits, another key other commands."""
    one, two, other = assess(params), assess(params), assess(params, 1)
    assert all(one[name] == two[name] for name in one)
    assert one["return"] != other["return"]


def test_an_evaluation_does_not_depend_on_the_noise_of_the_policy(assess, params):
    """Actions are the policy's mean: its standard deviation changes nothing."""
    loud = params | {"std": params["std"] * 10}
    one, other = assess(params), assess(loud)
    assert all(one[name] == other[name] for name in one)


def test_a_randomized_evaluation_is_on_the_task_as_it_trains(assess, settings, params):
    """Noise and bodies of its own matter then: on a task that has none, both are the same to the bit."""
    hyper = jax.tree.map(jnp.float32, settings[1])
    nominal = jax.tree.map(jnp.float32, scores.nominal(hyper))
    plain = assess(params, hyper=hyper)
    same = assess(params, randomize=True, hyper=nominal)
    assert all(plain[name] == same[name] for name in plain)
    for fields in ("noise", "randomize"), ("noise",), ("randomize",):
        task = nominal.task._replace(**{name: getattr(hyper.task, name) for name in fields})
        hard = assess(params, randomize=True, hyper=nominal._replace(task=task))
        assert hard["return"] != plain["return"]
        assert hard["tracking_error"] != plain["tracking_error"]


def test_episodes_start_at_age_zero(assess, params):
    """An environment that starts its robots aged is evaluated over whole episodes."""
    aged, young = assess(params), assess(params, aged=False)
    np.testing.assert_allclose(aged["length"], young["length"])


def test_a_blow_up_is_a_fall_and_leaves_no_nan(assess, settings, params):
    """Every metric is finite where physics diverges in the middle of episodes."""
    hyper = settings[1]
    hyper = hyper._replace(task=hyper.task._replace(effort_limit=0.05))
    calm, wild = assess(params), assess(params, hyper=hyper)
    assert wild["fall_rate"] >= calm["fall_rate"] and wild["length"] < calm["length"] - 0.5
    assert all(np.isfinite(value) for value in wild.values())


def test_no_tracking_error_is_reported_where_nobody_stood_long_enough(assess, params):
    """An error that was never measured is NaN: 0 would read as perfect tracking."""
    metrics = assess(params, 0, SETTLED)
    assert np.isnan(metrics["tracking_error"])


def test_the_nominal_task_has_no_noise_and_one_body():
    """Noise, pushes, added mass and shift 0, gains 1, friction its middle; all else as it was."""
    fields = {
        "task.randomize.friction": (0.4, 1.0),
        "task.randomize.kp_scale": (0.9, 1.1),
        "task.randomize.kd_scale": (0.9, 1.1),
        "task.randomize.base_com": (0.05, 0.05, 0.01),
        "task.randomize.strength": (0.8, 1.2),
        "task.randomize.armature": (0.8, 1.2),
        "task.push.velocity": 0.5,
    }
    hyper = toy_env.settings(fields)[2]
    task, nominal = hyper.task, scores.nominal(hyper)
    assert nominal._replace(task=task) == hyper
    assert jax.tree.structure(nominal) == jax.tree.structure(hyper)
    nominal = nominal.task
    assert all(x == 0 for x in jax.tree.leaves(nominal.noise))
    assert nominal.push.velocity == 0 and nominal.push.interval == task.push.interval
    middle = nominal.randomize
    assert [float(x) for x in middle.base_mass + middle.base_com] == [0.0] * 5
    shares = middle.kp_scale + middle.kd_scale + middle.strength + middle.armature
    assert [float(x) for x in shares] == [1.0] * 8
    np.testing.assert_allclose(middle.friction, (0.7, 0.7), 1e-6)
    kept = nominal._replace(noise=task.noise, randomize=task.randomize, push=task.push)
    assert kept == task and any(x > 0 for x in jax.tree.leaves(task.noise))


def test_a_nominal_robot_is_the_robot_of_its_file():
    """Drawn from the nominal ranges, every robot has the masses, gains, strength and armature of the XML."""
    motors = frozenset(("strength", "armature"))
    fields = {f"task.randomize.{name}": (0.8, 1.2) for name in motors}
    task = scores.nominal(toy_env.settings(fields)[2]).task
    com = jnp.array([0.01, 0.0, -0.02])
    draws = [
        randomize.draw(task.randomize, 5.2, com, jax.random.key(seed), motors) for seed in range(3)
    ]
    for draw in draws[1:]:
        jax.tree.map(np.testing.assert_array_equal, draw, draws[0])
    np.testing.assert_allclose(draws[0].base_com, com, 1e-6)
    for name in ("mass_scale", "kp_scale", "kd_scale", *motors):
        assert getattr(draws[0], name) == 1, name


class Spy(NamedTuple):
    """A robot that remembers the keys of its body and of its start."""

    obs: jax.Array
    prop: jax.Array
    keys: jax.Array
    t: jax.Array


def test_no_random_number_is_used_twice(settings, params):
    """In threefry `split(k)[i]` is `fold_in(k, i)`: a start and the steps after it need keys of their own,
    else a command has the bits of a later noise. Here a step tells whether its key is one of those."""
    static, hyper = settings

    def reset(hyper, body, key):
        zero = jnp.zeros(6)
        return Spy(zero, zero[:3], jnp.stack([body, key]), jnp.zeros((), jnp.int32))

    def step(hyper, body, state, action, key):
        fold = jax.vmap(jax.random.fold_in, (0, None))
        own = fold(fold(state.keys, state.t), algorithm.STEP)
        same = jax.vmap(lambda k: (jax.random.key_data(k) == jax.random.key_data(key)).all())(own)
        same |= (jax.random.key_data(state.keys[0]) == jax.random.key_data(state.keys[1])).all()
        one, zero = jnp.ones(()), jnp.zeros(())
        values = dict(reward=zero, discount=one, truncation=zero, valid=one)
        values |= dict(next_obs=state.obs, next_prop=state.prop)
        values |= dict(episode_return=zero, episode_length=one)
        outcome = Outcome(**values, metrics={"same_error_sq": same.any() * 1.0})
        return state._replace(t=state.t + 1), outcome

    spy = toy_env.make()._replace(
        randomize=lambda hyper, key: key,
        reset=reset,
        step=step,
        autoreset=lambda hyper, body, state, outcome, key: state,
        metrics=("same_error_sq",),
    )
    sizes = dict(static=static, num_envs=ROBOTS, num_steps=STEPS)
    found = scores.evaluate(spy, hyper, params, jax.random.key(0), **sizes)
    assert found["same_error"] == 0


def test_an_evaluation_has_the_floats_that_the_environment_asks_for(assess, settings, params):
    """`Env.evaluated` of commands that are not those of training, as if the config had them."""

    def faster(hyper):
        return hyper._replace(task=hyper.task._replace(command_x=(0.7, 0.8)))

    static, hyper = settings
    env = toy_env.make(episode_length=LIMIT)._replace(evaluated=faster)
    run = partial(scores.evaluate, env, static=static, num_envs=ROBOTS, num_steps=STEPS)
    found = jax.jit(run)(hyper, params, jax.random.key(0))
    expected = assess(params, hyper=faster(hyper))
    assert expected["return"] != assess(params)["return"]
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-6, err_msg=name)

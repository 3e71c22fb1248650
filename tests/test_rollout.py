"""Rows [lo, hi) of a rollout: which are written, with what, and what they depend on."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from toy_runs import assert_same, leaves

from dynappo import algorithm, rollout
from dynappo.types import Outcome

N, R = 8, 6
BLANK = -77.0


def act(state, keys):
    """A noisy linear policy, written without networks."""
    obs = state.obs
    mean = -0.5 * obs[:, :2]
    action = mean + jax.vmap(lambda key: jax.random.normal(key, (2,)))(keys)
    return action, mean, -(action**2).sum(-1), obs.sum(-1)


@pytest.fixture(scope="module")
def env():
    """The toy environment with episodes of four steps, so that rows end some."""
    return toy_env.make(episode_length=4)


@pytest.fixture(scope="module")
def hyper():
    """The floats of the config."""
    return toy_env.settings()[2]


@pytest.fixture(scope="module")
def start(env, hyper):
    """`(bodies, state)` of R robots."""
    keys = jax.random.split(jax.random.key(1), R)
    bodies = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    return bodies, jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, bodies, keys)


@pytest.fixture(scope="module")
def fill(env, hyper):
    """`fill(buffer, lo, hi, bodies, state, robot_index)`, compiled once."""

    def call(buffer, lo, hi, bodies, state, robot_index):
        return rollout.fill(
            buffer,
            lo,
            hi,
            state,
            rollout.row_keys(jax.random.key(5), robot_index),
            act=act,
            step=algorithm.physics_step(env, hyper, bodies),
            metrics=env.metrics,
        )

    return jax.jit(call)


@pytest.fixture(scope="module")
def blank(env):
    """A buffer in which every number is recognisable as not written."""
    return jax.tree.map(lambda x: jnp.full_like(x, BLANK), rollout.allocate(env, N, R))


def test_an_allocated_buffer_has_rows_of_all_robots(env):
    """`[N, R]` in front of every leaf, and the sizes of the environment behind."""
    buffer = rollout.allocate(env, N, R)
    assert {x.shape[:2] for x in jax.tree.leaves(buffer)} == {(N, R)}
    assert buffer.obs.shape[2:] == buffer.next_obs.shape[2:] == (env.obs_size,)
    assert buffer.action.shape[2:] == buffer.action_mean.shape[2:] == (env.action_size,)


@pytest.mark.parametrize("lo, hi", [(0, N), (2, 5), (0, 1), (N - 1, N), (3, 3), (0, 0)])
def test_exactly_the_rows_from_lo_to_hi_are_written(fill, blank, start, lo, hi):
    """Every leaf of every other row keeps its bits; every leaf of these rows is new."""
    buffer, _, _ = fill(blank, lo, hi, *start, jnp.arange(R))
    for name, rows in leaves(buffer).items():
        written = (rows != BLANK).reshape(N, -1)
        expected = (np.arange(N) >= lo) & (np.arange(N) < hi)
        np.testing.assert_array_equal(written.all(1), expected, name)
        np.testing.assert_array_equal(written.any(1), expected, name)


def test_rows_are_those_of_a_loop_over_single_steps(fill, blank, start, env, hyper):
    """Policy, step, reset, one row and one robot at a time, with the documented meanings."""
    buffer, after, _ = fill(blank, 0, N, *start, jnp.arange(R))
    buffer, after = leaves(buffer), leaves(after)
    step, autoreset = jax.jit(env.step), jax.jit(env.autoreset)
    key, ended = jax.random.key(5), 0
    for robot in range(2):
        body, state = jax.tree.map(lambda x, robot=robot: x[robot], start)
        for t in range(N):
            row = jax.random.fold_in(jax.random.fold_in(key, t), robot)
            action, mean, log_prob, value = (x[0] for x in act(OnlyObs(state.obs[None]), row[None]))
            old, (state, outcome) = state, step(hyper, body, state, action, _fold(row, "STEP"))
            expected = {
                ".obs": old.obs,
                ".prop": old.prop,
                ".action": action,
                ".action_mean": mean,
                ".log_prob": log_prob,
                ".value": value,
            } | {f".{k}": v for k, v in vars(outcome).items() if k != "metrics"}
            assert expected.keys() == buffer.keys()
            for name, x in expected.items():
                np.testing.assert_allclose(buffer[name][t, robot], x, 1e-5, 1e-5, err_msg=name)
            ended += bool(outcome.discount == 0) + bool(outcome.truncation == 1)
            state = autoreset(hyper, body, state, outcome, _fold(row, "RESET"))
        for name, x in leaves(state).items():
            np.testing.assert_allclose(after[name][robot], x, 1e-5, 1e-5, err_msg=name)
    assert ended >= 3  # or the resets were not tried


def _fold(key, purpose):
    return jax.random.fold_in(key, getattr(algorithm, purpose))


def test_metrics_are_summed_over_the_rows_written(fill, blank, start):
    """Falls and time-outs of rows [2, 6), counted in the buffer; speed errors from all parts."""
    buffer, _, sums = fill(blank, 2, 6, *start, jnp.arange(R))
    rows = jax.tree.map(lambda x: np.asarray(x)[2:6], buffer)
    assert sums["falls"] == (rows.discount == 0).sum()
    assert sums["timeouts"] == (rows.truncation == 1).sum() > 0
    total = toy_env.DT * (sums["reward_x"] + sums["reward_effort"])
    np.testing.assert_allclose(total, rows.reward.sum(), 1e-5, 1e-5)


def test_a_row_does_not_depend_on_how_many_rows_are_real(fill, blank, start):
    """The first 3 rows of 3 and of 7 have the same bits."""
    short, _, _ = fill(blank, 0, 3, *start, jnp.arange(R))
    long, _, _ = fill(blank, 0, 7, *start, jnp.arange(R))
    assert_same(*(jax.tree.map(lambda x: x[:3], b) for b in (short, long)))


def test_filling_in_two_parts_is_filling_at_once(fill, blank, start):
    """Rows [0, 3) and then [3, 8) from the state that the first part left, to the bit."""
    bodies, state = start
    whole, last, _ = fill(blank, 0, N, bodies, state, jnp.arange(R))
    part, middle, _ = fill(blank, 0, 3, bodies, state, jnp.arange(R))
    part, end, _ = fill(part, 3, N, bodies, middle, jnp.arange(R))
    assert_same(whole, part)
    assert_same(last, end)


def test_permuting_the_robots_permutes_the_rows(fill, blank, start):
    """A row's random numbers belong to the robot's index, not to its place in the batch."""
    order = jnp.array([3, 0, 5, 1, 4, 2])
    buffer, _, _ = fill(blank, 0, N, *start, jnp.arange(R))
    moved, _, _ = fill(blank, 0, N, *jax.tree.map(lambda x: x[order], start), order)
    assert_same(jax.tree.map(lambda x: x[:, order], buffer), moved)


def test_a_key_belongs_to_one_row_and_one_robot():
    """All keys of a rollout differ, and a robot's keys do not depend on who else is there."""
    key = jax.random.key(5)
    data = [
        np.asarray(jax.random.key_data(rollout.row_keys(key, jnp.arange(R))(t))) for t in range(N)
    ]
    data = np.stack(data).reshape(N * R, -1)
    assert len(np.unique(data, axis=0)) == N * R
    alone = rollout.row_keys(key, jnp.array([4]))(3)
    np.testing.assert_array_equal(jax.random.key_data(alone)[0], data[3 * R + 4])


class OnlyObs(NamedTuple):
    """A state in which there is nothing to read but the observation and its predicted part."""

    obs: jax.Array
    prop: jax.Array = jnp.zeros((R, 3))


def test_of_the_state_only_the_observation_is_read(env):
    """A state that has no other field will do; the seam lies at the observation carried in.

    And metrics that nobody asks for are not summed, whatever the outcomes hold.
    """

    def step(state, action, keys):
        obs = state.obs + 1
        one = jnp.ones(R)
        return OnlyObs(obs), Outcome(one, one, one * 0, obs, obs[:, :3], one, one, one, {"x": one})

    call = partial(rollout.fill, act=act, step=step)
    first = OnlyObs(jnp.arange(R * env.obs_size, dtype=jnp.float32).reshape(R, -1))
    keys = rollout.row_keys(jax.random.key(5), jnp.arange(R))
    buffer, after, sums = jax.jit(
        lambda lo, hi: call(rollout.allocate(env, N, R), lo, hi, first, keys)
    )(5, 7)
    np.testing.assert_array_equal(buffer.obs[5], first.obs)
    np.testing.assert_array_equal(buffer.obs[6], buffer.next_obs[5])
    np.testing.assert_array_equal(after.obs, first.obs + 2)
    assert sums == {}

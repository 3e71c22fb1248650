"""The doors to brax: our task under brax's own wrappers, and brax's environments under our trainer."""

from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import random_keys
import toy_env
from brax import envs
from brax.envs.wrappers import training
from brax.training import acting
from toy_runs import assert_close, assert_same

from dynappo import algorithm, schedule, scores
from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.tasks import brax_env as door
from dynappo.tasks.velocity import env as env_lib

LIMIT = 12  # control steps of an episode, where a test sets it


class Cart(envs.Env):
    """A light brax environment with brax's habits.

    A point is pushed by its action and falls beyond 1 m; it gets 1 - |position - target|. The target,
    drawn from a key in `info`, is observed behind position and velocity. `step` writes into the
    dicts that it is given, as brax's do, and an action above 0.95 is a blow-up.
    """

    observation_size = property(lambda self: 3)
    action_size = property(lambda self: 1)
    backend = property(lambda self: "none")
    dt = 0.05

    def reset(self, rng):
        rng, key = jax.random.split(rng)
        target = jax.random.uniform(key, (), minval=-0.3, maxval=0.3)
        x = jax.random.uniform(rng, (2,), minval=-0.1, maxval=0.1)
        obs, zero = jnp.append(x, target), jnp.zeros(())
        info = {"rng": rng, "typed": jax.random.wrap_key_data(rng), "last_act": jnp.zeros(1)}
        return envs.State(
            x, obs, zero, zero, {"reward_near": zero, "pushes": zero, "row": jnp.zeros(2)}, info
        )

    def step(self, state, action):
        position, velocity = state.pipeline_state
        velocity = velocity + 0.2 * action[0] + 0.01 * state.info["last_act"][0]
        x = jnp.stack([position + self.dt * velocity, velocity])
        x = jnp.where(action[0] > 0.95, jnp.nan, x)
        state.info["rng"], _ = jax.random.split(state.info["rng"])
        state.info["typed"], _ = jax.random.split(state.info["typed"])
        state.info["last_act"] = action
        near = 1 - jnp.abs(x[0] - state.obs[2])
        state.metrics.update(reward_near=near, pushes=(action[0] > 0).astype(jnp.int32))
        return state.replace(
            pipeline_state=x,
            obs=jnp.append(x, state.obs[2]),
            reward=near,
            done=jnp.abs(x[0]) > 1,  # a bool where the reset has a float
        )


def copied(hyper, context, prop, action, next_prop):
    """The context of `Cart`: its target."""
    return context


# Our task as a brax environment


@pytest.fixture(scope="module")
def toy():
    """`(env, hyper)`: noise, randomised bodies, falls, and a limit of `LIMIT` steps."""
    fields = {"task.randomize.base_mass": (-3.0, 3.0), "task.episode_length": LIMIT}
    return toy_env.make(episode_length=LIMIT), toy_env.settings(fields)[2]


def test_reset_and_step_are_ours_to_the_bit(toy):
    env, hyper = toy
    brax_env = door.to_brax(env, hyper)
    rng = jax.random.key(3)
    state = brax_env.reset(rng)
    body_key, reset_key, run_key = jax.random.split(rng, 3)
    body = env.randomize(hyper, body_key)
    ours = env.reset(hyper, body, reset_key).replace(clock=jnp.int32(0))
    assert_same(state.pipeline_state, ours)
    assert_same(state.obs, ours.obs)
    assert_same(state.info["body"], body)
    for t in range(LIMIT):
        action = jnp.array([0.3, -0.1 * ours.prop[1]])
        run_key, key = jax.random.split(run_key)
        ours, outcome = env.step(hyper, body, ours, action, key)
        state = brax_env.step(state, action)
        assert_same(state.pipeline_state, ours)
        assert_same(state.obs, outcome.next_obs)
        assert_same(state.reward, outcome.reward)
        assert_same(state.metrics, outcome.metrics)
        assert state.done == 1 - outcome.discount
        assert state.info["truncation"] == outcome.truncation == (t == LIMIT - 1)


def test_sizes_and_labels(toy):
    brax_env = door.to_brax(*toy, backend="toy")
    assert (brax_env.observation_size, brax_env.action_size) == (6, 2)
    assert (brax_env.backend, brax_env.dt) == ("toy", toy_env.DT)
    assert door.to_brax(*toy).backend == "mjx"
    assert isinstance(brax_env, envs.Env) and brax_env.unwrapped is brax_env


def test_raw_and_typed_keys_are_the_same_robot(toy):
    brax_env = door.to_brax(*toy)
    assert_same(brax_env.reset(jax.random.key(5)), brax_env.reset(jax.random.PRNGKey(5)))


def test_a_reset_and_two_steps_use_no_key_twice(toy):
    brax_env = door.to_brax(*toy)

    def steps(rng, action):
        state = brax_env.reset(rng)
        return brax_env.step(brax_env.step(state, action), action)

    action = jax.ShapeDtypeStruct((2,), jnp.float32)
    used, state = random_keys.record(steps, jax.random.PRNGKey(0), action)
    assert not random_keys.faults(used)
    assert (
        len({use.key for use in used if use.how == "drawn from"}) == 8
    )  # body, 3 + 2 of a clock, 1 + 1
    assert np.asarray(state.info["rng"]).dtype == np.uint32  # known: no state has a part in it


def test_a_step_keeps_structure_shapes_and_types(toy):
    brax_env = training.EvalWrapper(training.wrap(door.to_brax(*toy), LIMIT))
    before = jax.eval_shape(brax_env.reset, jax.random.split(jax.random.PRNGKey(0), 4))
    after = jax.eval_shape(brax_env.step, before, jnp.zeros((4, 2)))
    chex.assert_trees_all_equal_shapes_and_dtypes(before, after)
    assert not any(x.weak_type for x in jax.tree.leaves(after))  # would compile a second time
    assert set(toy_env.METRICS) < set(before.metrics)


def test_a_step_changes_nothing_that_it_was_given(toy):
    brax_env = door.to_brax(*toy)
    state = brax_env.reset(jax.random.key(0))
    copy = jax.tree.map(jnp.array, state)
    brax_env.step(state, jnp.ones(2))
    assert_same(state, copy)


@pytest.fixture(scope="module")
def unroll(toy):
    """`(first state, last state, rows)` of brax's own wrappers and unroll: 8 robots, 40 steps."""
    brax_env = training.wrap(door.to_brax(*toy), LIMIT)

    def policy(obs, key):  # noisy enough that some robots fall
        return 1.2 * jax.random.normal(key, (*obs.shape[:-1], 2)), {}

    @jax.jit
    def run(key):
        reset_key, key = jax.random.split(key)
        first = brax_env.reset(jax.random.split(reset_key, 8))
        fields = ("truncation", "steps", "first_obs", "rng")
        return first, *acting.generate_unroll(brax_env, first, policy, key, 40, fields)

    return jax.device_get(run(jax.random.PRNGKey(1)))


def test_brax_unrolls_our_task(unroll):
    first, last, rows = unroll
    assert rows.observation.shape == rows.next_observation.shape == (40, 8, 6)
    assert rows.action.shape == (40, 8, 2)
    assert rows.reward.shape == rows.discount.shape == (40, 8)
    assert np.isfinite(rows.observation).all() and np.isfinite(rows.reward).all()
    np.testing.assert_array_equal(rows.observation[0], first.obs)
    np.testing.assert_array_equal(rows.observation[1:], rows.next_observation[:-1])
    assert len(np.unique(first.info["body"])) == 8  # each robot has its own


def test_time_limits_are_truncations_and_falls_are_not(unroll):
    """The toy's physics in NumPy says who fell, brax's wrappers count the rest."""
    first, _, rows = unroll
    extras, body = rows.extras["state_extras"], first.info["body"]
    start = np.asarray(first.pipeline_state.prop)
    steps, prop, falls, limits = np.zeros(8), start, 0, 0
    for t in range(40):
        push = rows.action[t] @ np.asarray(toy_env.B).T
        prop = prop @ np.asarray(toy_env.A).T + body[:, None] * push
        steps += 1
        fell, limit = np.abs(prop[:, 1]) > toy_env.LIMIT, steps >= LIMIT
        np.testing.assert_array_equal(rows.discount[t], ~(fell | limit))
        np.testing.assert_array_equal(extras["truncation"][t], limit & ~fell)
        np.testing.assert_array_equal(extras["steps"][t], steps)
        falls, limits = falls + fell.sum(), limits + (limit & ~fell).sum()
        again = (fell | limit)[:, None]
        shown = np.where(again, first.obs, rows.next_observation[t])
        np.testing.assert_array_equal(rows.next_observation[t], shown)
        prop, steps = np.where(again, start, prop), np.where(again[:, 0], 0, steps)
        noise = np.abs(rows.next_observation[t][:, :3] - prop)
        assert (noise <= 0.01 + 1e-5).all()
    assert falls > 5 and limits > 5


def test_brax_puts_back_the_whole_episode_but_not_its_noise(toy):
    env, hyper = toy
    brax_env = training.wrap(door.to_brax(env._replace(step=_falls_at(env, 3)), hyper), LIMIT)
    step = jax.jit(brax_env.step)
    state = first = brax_env.reset(jax.random.split(jax.random.PRNGKey(2), 2))
    seen = []
    for t in range(1, 7):
        state = step(state, jnp.full((2, 2), 0.1))
        np.testing.assert_array_equal(state.done, t % 3 == 0)
        np.testing.assert_array_equal(state.info["truncation"], 0)
        np.testing.assert_array_equal(state.pipeline_state.clock, t % 3)
        seen.append(np.asarray(state.obs))
        if t % 3 == 0:
            assert_same(state.pipeline_state, first.pipeline_state)
            assert_same(state.obs, first.obs)
            assert_same(state.info["body"], first.info["body"])
    assert (seen[0][:, :3] != seen[3][:, :3]).all()  # other noise
    np.testing.assert_allclose(seen[0], seen[3], atol=0.05)  # the same robot


def _falls_at(env, steps):
    """`env.step`, with a fall at a given step of the episode."""

    def step(*args):
        state, outcome = env.step(*args)
        return state, outcome.replace(discount=1.0 * (state.episode_steps < steps))

    return step


def test_a_fall_at_the_time_limit_is_a_fall(toy):
    env, hyper = toy
    brax_env = training.wrap(door.to_brax(env._replace(step=_falls_at(env, 3)), hyper), 3)
    reset, step = jax.jit(brax_env.reset), jax.jit(brax_env.step)
    state = reset(jax.random.split(jax.random.PRNGKey(0), 1))
    for _ in range(3):
        state = step(state, jnp.zeros((1, 2)))
    assert state.done == 1 and state.info["truncation"] == 0


def test_brax_evaluates_our_task(toy):
    env, hyper = toy
    evaluator = acting.Evaluator(
        training.wrap(door.to_brax(env, hyper), LIMIT),
        lambda params: lambda obs, key: (jnp.zeros((*obs.shape[:-1], 2)), {}),
        num_eval_envs=8,
        episode_length=LIMIT,
        action_repeat=1,
        key=jax.random.PRNGKey(0),
    )
    found = evaluator.run_evaluation(None, {})
    # without action, a tilt of 0.3 passes 1.5 after more than LIMIT steps of 1.1
    assert found["eval/avg_episode_length"] == LIMIT
    assert found["eval/episode_falls"] == 0 and found["eval/episode_timeouts"] == 1
    terms = found["eval/episode_reward_x"] + found["eval/episode_reward_effort"]
    np.testing.assert_allclose(found["eval/episode_reward"], toy_env.DT * terms, rtol=1e-5)


def of_go1(impl):
    """The velocity task of a Go1 behind brax's wrappers, not compiled."""
    config, _, hyper = toy_env.settings({"task.episode_length": 2}, variant="quick")
    env = env_lib.make(robot_lib.load("go1"), config.task, config.physics, impl=impl)
    return training.wrap(door.to_brax(env, hyper), 2)


def test_a_go1_fits_brax_without_being_run():
    go1 = of_go1("c")  # traced in a third of MJX's time
    assert (go1.observation_size, go1.action_size, go1.backend) == (48, 12, "mjx")
    before = jax.eval_shape(go1.reset, jax.random.split(jax.random.PRNGKey(0), 2))
    after = jax.eval_shape(go1.step, before, jnp.zeros((2, 12)))
    chex.assert_trees_all_equal_shapes_and_dtypes(before, after)


@pytest.mark.slow
def test_brax_unrolls_a_go1():
    go1 = of_go1("jax")

    @jax.jit
    def run(key):
        first = go1.reset(jax.random.split(key, 2))
        policy = lambda obs, key: (jnp.zeros((2, 12)), {})  # noqa: E731
        return first, *acting.generate_unroll(go1, first, policy, key, 4, ("truncation",))

    first, last, rows = jax.device_get(run(jax.random.PRNGKey(0)))
    assert rows.observation.shape == (4, 2, 48) and np.isfinite(rows.observation).all()
    np.testing.assert_array_equal(
        rows.extras["state_extras"]["truncation"], [[0, 0], [1, 1], [0, 0], [1, 1]]
    )
    np.testing.assert_array_equal(rows.next_observation[1], first.obs)
    assert_same(last.pipeline_state, first.pipeline_state)
    assert np.ptp(first.info["body"].mass_scale) > 0


# A brax environment as ours


@pytest.fixture(scope="module")
def cart():
    """`Cart` with a time limit and no aged starts."""
    return door.from_brax(Cart(), 2, LIMIT, advance=copied, random_clock=False)


def begin(env, seed=0):
    """`(body, state)` of one robot."""
    body = env.randomize(None, jax.random.key(seed))
    return body, env.reset(None, body, jax.random.key(seed + 1))


def test_sizes_names_and_time_step(cart):
    assert (cart.obs_size, cart.prop_size, cart.action_size, cart.dt) == (3, 2, 1, 0.05)
    # of brax's metrics, the numbers; `row` is none
    assert cart.metrics == ("pushes", "reward_near", "reward", "falls", "timeouts", "blowups")
    whole = door.from_brax(envs.get_environment("fast"))
    assert (whole.obs_size, whole.prop_size, whole.dt) == (2, 2, 1.0)
    assert door.from_brax(Cart(), 3).advance(None, jnp.zeros(0), *[None] * 3).shape == (0,)


def test_fast_is_what_its_formula_says():
    env = door.from_brax(envs.get_environment("fast"), episode_length=50, random_clock=False)
    body, state = begin(env)
    step = jax.jit(env.step)
    position = velocity = total = 0.0
    for t in range(20):
        action = (-1.0) ** t * 0.5
        state, outcome = step(None, body, state, jnp.array([action]), jax.random.key(0))
        velocity += 0.02 * (action > 0)
        position += 0.02 * velocity
        total += position
        np.testing.assert_allclose(outcome.reward, position, rtol=1e-5)
        np.testing.assert_allclose(outcome.next_obs, [position, velocity], rtol=1e-5)
        np.testing.assert_allclose(outcome.episode_return, total, rtol=1e-5)
        assert outcome.episode_length == t + 1


@pytest.fixture(scope="module")
def pendulum():
    """brax's inverted pendulum; `observe` appends the action, which is copied."""
    brax_env = envs.get_environment("inverted_pendulum")
    env = door.from_brax(
        brax_env,
        prop_size=4,
        episode_length=200,
        advance=lambda hyper, context, prop, action, next_prop: action,
        observe=lambda state, action: jnp.concatenate([state.obs, action]),
    )
    return brax_env, env


@pytest.mark.slow
def test_a_brax_environment_is_brax_stepped_by_hand(pendulum):
    brax_env, env = pendulum
    actions = jnp.asarray(np.random.default_rng(0).normal(0, 0.7, (25, 1)), jnp.float32)

    @jax.jit
    def both(key):
        body = env.randomize(None, key)

        def row(ours, action):  # by hand from the same state: rounding cannot grow
            by_hand = brax_env.step(ours.brax, jnp.clip(action, -1, 1))
            by_hand = by_hand.replace(reward=jnp.asarray(by_hand.reward))
            ours, outcome = env.step(None, body, ours, action, key)
            return ours, (outcome, ours.brax, by_hand)

        return jax.lax.scan(row, env.reset(None, body, key), actions)[1]

    outcome, after, by_hand = jax.device_get(both(jax.random.key(0)))
    assert (np.abs(actions) > 1).any() and by_hand.done.any() and not by_hand.done.all()
    for name in ("q", "qd", "x", "xd"):
        assert_close(*(getattr(s.pipeline_state, name) for s in (after, by_hand)), 1e-5)
    assert_close(outcome.reward, by_hand.reward, 1e-5)
    np.testing.assert_array_equal(outcome.discount, 1 - by_hand.done)
    assert_close(outcome.next_obs[:, :4], by_hand.obs, 1e-5)
    np.testing.assert_array_equal(outcome.next_obs[:, 4:], actions)
    np.testing.assert_array_equal(outcome.metrics["falls"], by_hand.done)
    np.testing.assert_array_equal(outcome.metrics["reward"], outcome.reward)


def test_a_step_never_resets_and_leaves_its_argument_alone(cart):
    body, state = begin(cart)
    copy = jax.tree.map(jnp.array, state)
    after, outcome = cart.step(None, body, state, jnp.array([0.5]), jax.random.key(0))
    assert_same(state, copy)
    chex.assert_trees_all_equal_shapes_and_dtypes(state, after)
    for _ in range(30):  # falls on the way, and goes on falling
        after, outcome = cart.step(None, body, after, jnp.array([0.9]), jax.random.key(0))
    assert outcome.discount == 0 and after.episode_steps == 31 and after.brax.obs[0] > 1


def test_the_limit_truncates_and_a_fall_does_not(cart):
    body, state = begin(cart)
    for t in range(1, LIMIT + 1):
        state, outcome = cart.step(None, body, state, jnp.zeros(1), jax.random.key(t))
        assert outcome.discount == 1
        assert outcome.truncation == outcome.metrics["timeouts"] == (t == LIMIT)
        assert outcome.metrics["falls"] == 0
    state = state.replace(clock=jnp.int32(LIMIT - 1))
    state = state.replace(brax=state.brax.replace(pipeline_state=jnp.array([2.0, 0.0])))
    _, outcome = cart.step(None, body, state, jnp.zeros(1), jax.random.key(0))
    assert outcome.discount == 0 and outcome.truncation == 0
    assert outcome.metrics["falls"] == 1 and outcome.metrics["timeouts"] == 0


def test_a_new_episode_is_one_of_brax_s_own_first_states(cart):
    body, state = begin(cart)
    own = jax.vmap(Cart().reset)(jax.random.key_data(jax.random.split(jax.random.key(0), 4)))
    assert_same(body, own)
    for t in range(5):
        state, outcome = cart.step(None, body, state, jnp.array([0.5]), jax.random.key(t))
    assert_same(cart.autoreset(None, body, state, outcome, jax.random.key(0)), state)
    picked = set()
    for seed in range(20):
        for end in ({"discount": jnp.zeros(())}, {"truncation": jnp.ones(())}):
            ended = outcome.replace(**end)
            new = cart.autoreset(None, body, state, ended, jax.random.key(seed))
            (index,) = np.flatnonzero((np.asarray(own.obs) == np.asarray(new.obs)).all(-1))
            picked.add(int(index))
            start = jax.tree.map(lambda x, i=index: x[i], own)
            assert_same(new.brax.pipeline_state, start.pipeline_state)
            assert_same(new.brax.metrics, start.metrics)
            assert new.brax.info["last_act"] == 0  # nothing of the old episode
            for name in ("rng", "typed"):  # but its random numbers go on
                assert_same(new.brax.info[name], state.brax.info[name])
            assert new.clock == new.episode_steps == new.episode_return == 0
    assert picked == {0, 1, 2, 3}


def test_a_first_and_a_new_episode_use_no_key_twice():
    env, key = door.from_brax(Cart(), 2, LIMIT, advance=copied), jax.random.key(0)
    body = jax.eval_shape(env.randomize, None, key)
    state = jax.eval_shape(env.reset, None, body, key)
    after = jax.eval_shape(env.step, None, body, state, jnp.zeros(1), key)
    for call in ((env.reset, None, body, key), (env.autoreset, None, body, *after, key)):
        used, _ = random_keys.record(*call)
        assert used and not random_keys.faults(used)


def test_first_episodes_may_be_aged(cart):
    aged = door.from_brax(Cart(), 2, LIMIT, advance=copied)
    for env, ages in ((aged, set(range(LIMIT))), (cart, {0})):
        body = env.randomize(None, jax.random.key(0))
        keys = jax.random.split(jax.random.key(1), 300)
        state = jax.vmap(env.reset, (None, None, 0))(None, body, keys)
        assert set(np.asarray(state.clock).tolist()) == ages
        assert not state.episode_steps.any()


def test_a_blow_up_ends_the_episode_and_leaves_no_number(cart):
    body, state = begin(cart)
    after, outcome = cart.step(None, body, state, jnp.ones(1), jax.random.key(0))
    assert np.isnan(after.brax.obs).any()
    assert outcome.discount == 0 and outcome.truncation == 0 and outcome.reward == 0
    assert_same(outcome.next_obs, state.obs)
    assert outcome.metrics["blowups"] == outcome.metrics["falls"] == 1
    new = cart.autoreset(None, body, after, outcome, jax.random.key(0))
    assert all(np.isfinite(x).all() for x in (outcome.metrics["reward_near"], new.obs))
    assert np.isfinite(new.brax.pipeline_state).all()


def test_actions_are_clipped_for_brax_only():
    observe = lambda state, action: jnp.append(state.obs, action)  # noqa: E731
    env = door.from_brax(Cart(), action_limit=0.5, observe=observe)
    body, state = begin(env)
    _, far = env.step(None, body, state, jnp.array([7.0]), jax.random.key(0))
    _, near = env.step(None, body, state, jnp.array([0.5]), jax.random.key(0))
    np.testing.assert_array_equal(far.next_obs[:3], near.next_obs[:3])
    assert far.next_obs[3] == 7 and state.obs[3] == 0


def test_wrong_environments_and_sizes_are_one_line():
    fast = envs.get_environment("fast")
    pixels = envs.get_environment("fast", obs_mode="dict_state")
    wrapped = envs.create("fast")
    too_long = lambda *row: jnp.zeros(2)  # noqa: E731
    cases = (
        (lambda: door.from_brax(wrapped), "AutoResetWrapper .*bare environment"),
        (lambda: door.from_brax(pixels), r"Fast is \{'state': \(2,\)\}, expected one vector"),
        (lambda: door.from_brax(fast, 3), "prop_size is 3, Fast needs 1 to 2"),
        (lambda: door.from_brax(fast, 0), "prop_size is 0"),
        (lambda: door.from_brax(fast, 1), r"advance gives \(0,\), expected \(1,\)"),
        (
            lambda: door.from_brax(fast, 1, advance=too_long),
            r"advance gives \(2,\), expected \(1,\)",
        ),
        (
            lambda: door.from_brax(fast, episode_length=0),
            "episode_length is 0, expected more than 0",
        ),
        (lambda: door.from_brax(fast, starts=0), "starts is 0"),
        (lambda: door.from_brax(fast, action_limit=-1.0), "action_limit is -1.0"),
    )
    for make, message in cases:
        with pytest.raises(ConfigError, match=message) as caught:
            make()
        assert "\n" not in str(caught.value)
    named = door.from_brax(pixels, observe=lambda state, action: state.obs["state"])
    assert named.obs_size == 2


# Trained by our algorithm


def trainer(env, fields):
    """`(config, static, hyper, first state, compiled run)` of `configs/default.py` and `fields`."""
    config, static, hyper = toy_env.settings({"ppo.shuffle_blocks": 4} | fields)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    return static, hyper, state, schedule.columns(config)


def test_a_tail_without_prop_size_is_a_config_error():
    env = door.from_brax(Cart())
    static, hyper, state, columns = trainer(env, toy_env.TAIL)
    with pytest.raises(ConfigError, match="asks for a tail, but from_brax.Cart. was given no prop"):
        jax.eval_shape(partial(algorithm.run, env, static=static), hyper, state, columns)


@pytest.mark.slow
def test_ppo_learns_to_go_fast():
    """All pushes forward give 0.0002 sum(k^2 + k) = 8.84 in 50 steps, half of them half of it."""
    env = door.from_brax(envs.get_environment("fast"), episode_length=50)
    static, hyper, state, columns = trainer(
        env, {"rollout.num_envs": 64, "rollout.horizon": 16, "run.num_iterations": 30}
    )
    worth = jax.jit(
        partial(scores.evaluate, env, static=static, num_envs=16, num_steps=50),
    )
    state, metrics = jax.jit(partial(algorithm.run, env, static=static))(hyper, state, columns)
    after = worth(hyper, state.learner.params, jax.random.key(1))
    np.testing.assert_allclose(after["return"], 8.84, rtol=1e-4)
    assert after["length"] == 50 and after["fall_rate"] == 0
    assert metrics["episode_return"][-1] > 1.4 * 4.42  # with exploration


@pytest.mark.slow
def test_dyna_learns_to_balance_brax_s_pendulum(pendulum):
    _, env = pendulum
    iterations = 30
    static, hyper, state, columns = trainer(
        env,
        {
            "rollout.num_envs": 64,
            "rollout.horizon": 32,
            "run.num_iterations": iterations,
            "schedule.end_iteration": iterations // 2,
            "schedule.end_steps": 4,
            "model.hidden": (64, 64),
            "ppo.epochs": 5,
            "ppo.minibatches": 4,
            "ppo.hidden": (32, 32),
        },
    )
    assert columns["n_real"][0] == 32 and columns["n_real"][-1] == 28
    run = jax.jit(partial(algorithm.run, env, static=static))
    state, metrics = jax.device_get(run(hyper, state, columns))
    assert metrics["episode_return"][0] < 10  # a step upright is 1
    assert metrics["episode_return"][-5:].mean() > 40
    assert metrics["model_loss_before"][-5:].mean() < 0.3 * metrics["model_loss_before"][0]
    assert metrics["falls"][-5:].sum() < 0.3 * metrics["falls"][:5].sum()
    # nothing of brax's goes through the tail: the copied number is the action of the row before
    np.testing.assert_array_equal(state.env_state.obs[:, :4], state.env_state.brax.obs)

"""The model's options beyond the paper: the state without noise, known rewards, falls."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from toy_model import fit_rows, start, that_says
from toy_runs import N, R, assert_close, assert_same, observe, row

from dynappo import algorithm, fast, rollout
from dynappo.learner import ppo
from dynappo.model import dynamics

ON = {f"model.{name}": True for name in ("clean", "known_reward", "falls")}
A, B = np.array(toy_env.A), np.array(toy_env.B)
NOISE, DT, LIMIT = 0.3, toy_env.DT, toy_env.LIMIT


def settings(fields):
    """`(config, static, hyper)` of the toy with a tail, loud noise and `fields`."""
    return toy_env.settings(toy_env.TAIL | {"task.noise.joint_pos": NOISE} | fields)


@pytest.fixture(scope="module")
def env():
    """The toy environment with noise, aged starts, falls and time limits."""
    return toy_env.make()


@pytest.fixture(scope="module")
def iterated(env):
    """`(static, hyper, first state, {n_real: (rollout, state, metrics)})` with every field on."""
    config, static, hyper = settings(ON)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    # some iterations on, the model has seen falls
    call = observe(env, static)
    for i in range(1, 4):
        _, state, _ = call(hyper, state, row(config, first=i, n_real=N))
    out = {n: call(hyper, state, row(config, first=4, n_real=n, epochs=20)) for n in (N, 5, 3)}
    return static, hyper, state, jax.device_get(out)


def moved(body, prop, action):
    """The toy's physics in NumPy, for rows `[N, R]`."""
    return prop @ A.T + np.asarray(body)[:, None] * (action @ B.T)


# ---- the state without noise


def test_real_rows_hold_the_state_without_noise_before_any_reset(iterated):
    """Against the toy's own matrices and reward; the observations around it are off by the noise."""
    _, _, state, out = iterated
    rows = out[N][0]
    expected = moved(state.params_physics, rows.prop, rows.action)
    np.testing.assert_allclose(rows.next_prop, expected, 1e-5, 1e-5)
    error, effort = (rows.next_prop[..., 0] - rows.obs[..., 3]) ** 2, (rows.action**2).sum(-1)
    np.testing.assert_allclose(rows.reward, DT * (1 - error - 0.01 * effort), 1e-4, 1e-5)
    assert (np.abs(rows.next_prop[rows.discount == 0][:, 1]) > LIMIT).all()  # fallen, and not reset
    assert (rows.discount == 0).sum() > 2
    for obs, prop in ((rows.obs, rows.prop), (rows.next_obs, rows.next_prop)):
        noise = obs[..., :3] - prop
        assert (np.abs(noise) <= NOISE + 1e-5).all() and (np.abs(noise) > 0.5 * NOISE).mean() > 0.4


@pytest.mark.parametrize("n_real", [N, 5])
def test_the_model_is_asked_and_told_states_without_noise(iterated, n_real):
    """Moments of the fit: of prop and next prop in all real rows, fallen ones too."""
    static, hyper, first, out = iterated
    rows, state, _ = out[n_real]
    kept = jax.tree.map(lambda x: x[:n_real].reshape(-1, *x.shape[2:]), rows)
    rest = -0.01 * (kept.action**2).sum(-1)  # what no one knows but the toy
    change, fell = kept.next_prop - kept.prop, 1.0 * (kept.discount == 0)
    x = np.concatenate([kept.prop, kept.obs[:, 3:], kept.action], -1)
    y = np.column_stack([change, rest, fell])
    decay = hyper.model.stats_decay
    for before, after, numbers in (
        (first.model.inputs, state.model.inputs, x),
        (first.model.targets, state.model.targets, y),
    ):
        batch = (np.asarray(after.mean) - decay * np.asarray(before.mean)) / (1 - decay)
        np.testing.assert_allclose(batch, numbers.mean(0), 1e-3, 1e-3)


def test_a_tail_carries_the_state_and_shows_the_policy_fresh_noise(iterated, env):
    """Rows after N_r: the model on its own states, noise of the task's width, each row's its own."""
    static, hyper, _, out = iterated
    predict = jax.jit(jax.vmap(partial(dynamics.predict, static, hyper, env), (None, 0, 0)))
    for n in (5, 3):
        rows, state, _ = out[n]
        np.testing.assert_array_equal(rows.obs[n], state.env_state.obs)
        np.testing.assert_array_equal(rows.prop[n], state.env_state.prop)
        np.testing.assert_array_equal(rows.prop[n + 1 :], rows.next_prop[n:-1])
        np.testing.assert_array_equal(rows.obs[n + 1 :], rows.next_obs[n:-1])
        np.testing.assert_array_equal(rows.next_obs[n:, :, 3], rows.obs[n:, :, 3])
        np.testing.assert_array_equal(rows.next_obs[n:, :, 4:], rows.action[n:])
        known = np.concatenate([rows.prop, rows.obs[..., 3:]], -1)
        obs, reward, discount = jax.device_get(predict(state.model, known, rows.action))
        np.testing.assert_allclose(rows.next_prop[n:], obs[n:, :, :3], 1e-4, 1e-5)
        np.testing.assert_allclose(rows.reward[n:], reward[n:], 1e-4, 1e-5)
        np.testing.assert_allclose(rows.discount[n:], discount[n:], 1e-4, 1e-5)
        noise = (rows.next_obs[..., :3] - rows.next_prop)[n:]
        assert np.abs(noise).max() <= NOISE + 1e-5
        assert 0.8 * NOISE**2 / 3 < noise.var() < 1.2 * NOISE**2 / 3
        assert len(np.unique(noise.round(6))) > 0.99 * noise.size


def test_without_noise_the_policy_sees_what_the_model_carries(env, iterated):
    static, _, first, _ = iterated
    config, _, hyper = settings(ON | {"task.noise.joint_pos": 0.0})
    rows, _, _ = observe(env, static)(hyper, first, row(config, n_real=4))
    np.testing.assert_array_equal(rows.next_obs[4:, :, :3], rows.next_prop[4:])


# ---- known rewards


def test_a_predicted_reward_is_that_of_the_predicted_state_and_the_rest(env):
    """Network says next state + (0.2, 0.3, -0.1), rest -0.5, logit 2: numbers by hand."""
    on = {"model.clean": True, "model.known_reward": True, "model.falls": True}
    _, static, hyper = settings(on | {"model.normalize": False})
    model = that_says([0.2, 0.3, -0.1, -0.5, 2.0], start(static, env))
    obs = np.random.default_rng(0).normal(size=(7, 6)).astype(np.float32)
    predict = jax.jit(partial(dynamics.predict, static, hyper, env))
    after, reward, discount = jax.device_get(predict(model, obs, np.ones((7, 2), np.float32)))
    np.testing.assert_allclose(after[:, :3], obs[:, :3] + np.float32([0.2, 0.3, -0.1]), 1e-5)
    known = 1 - (obs[:, 0] + 0.2 - obs[:, 3]) ** 2
    np.testing.assert_allclose(reward, DT * (known - 0.5), 1e-4, 1e-6)
    np.testing.assert_allclose(discount, 1 / (1 + np.exp(2.0 - 4.6)) + 0 * reward, 1e-5)


def test_what_a_fall_pays_is_in_a_predicted_reward_by_its_probability(env):
    """The same numbers: a logit of 2 is a probability of 1 / (1 + exp(2.6)); -3 is not times dt."""
    on = {"model.clean": True, "model.known_reward": True, "model.falls": True}
    _, static, hyper = settings(on | {"model.normalize": False})
    paying = env._replace(fall_reward=lambda hyper: -1.5 * hyper.task.tracking_std)
    hyper = hyper._replace(task=hyper.task._replace(tracking_std=2.0))
    model = that_says([0.2, 0.3, -0.1, -0.5, 2.0], start(static, env))
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(7, 6)), jnp.float32)
    free, paid = (
        dynamics.predict(static, hyper, e, model, obs, jnp.ones((7, 2))) for e in (env, paying)
    )
    np.testing.assert_allclose(paid[1] - free[1], np.full(7, -3 / (1 + np.exp(2.6))), 1e-4, 1e-6)
    for one, other in zip((free[0], free[2]), (paid[0], paid[2]), strict=True):
        np.testing.assert_array_equal(one, other)
    # without falls the model knows of none
    _, static, _ = settings(on | {"model.normalize": False, "model.falls": False})
    model = that_says([0.2, 0.3, -0.1, -0.5], start(static, env))
    free, paid = (
        dynamics.predict(static, hyper, e, model, obs, jnp.ones((7, 2)))[1] for e in (env, paying)
    )
    np.testing.assert_array_equal(free, paid)


def test_a_tail_pays_for_at_most_one_fall(env):
    """Rows that end with probability 0.4, each: what is paid, weighed by getting there, is -5 (1 - 0.6^n)."""
    on = {"model.clean": True, "model.falls": True, "model.known_reward": False}
    _, static, hyper = settings(on | {"model.normalize": False})
    paying = env._replace(fall_reward=lambda hyper: -5.0)
    logit = float(np.log(0.4 / 0.6) + 4.6)
    model = that_says([0.0, 0.0, 0.0, 0.0, logit], start(static, env))
    step = jax.jit(dynamics.step(static, hyper, paying, model))
    keys = jax.random.split(jax.random.key(0), R)
    state, there, paid = dynamics.TailState(obs=jnp.zeros((R, 6)), prop=jnp.zeros((R, 3))), 1.0, 0.0
    for n in range(1, 20):
        state, outcome = step(state, jnp.zeros((R, 2)), keys)
        paid, there = paid + there * outcome.reward, there * outcome.discount
        np.testing.assert_allclose(paid, -5 * (1 - 0.6**n) * np.ones(R), 1e-3)


def test_an_end_that_is_known_is_certain_in_a_tail_and_pays_one_fall(env):
    """Where a coordinate of the next state is above 0, whatever the network says (probability 0.4); with
    `falls` and without."""
    known = env._replace(known_end=lambda hyper, prop, context: 1.0 * (prop[0] > 0))
    paying = known._replace(fall_reward=lambda hyper: -5.0)
    prop = jnp.asarray(np.random.default_rng(0).normal(size=(R, 3)), jnp.float32)
    keys, ends = jax.random.split(jax.random.key(0), R), np.asarray(prop[:, 0] > 0)
    assert ends.any() and not ends.all()
    for falls, lives in ((True, 0.6), (False, 1.0)):
        on = {"model.clean": True, "model.falls": falls, "model.known_reward": False}
        _, static, hyper = settings(on | {"model.normalize": False})
        logit = [float(np.log(0.4 / 0.6) + 4.6)] * falls
        model = that_says([0.0, 0.0, 0.0, 0.0, *logit], start(static, env))
        state = dynamics.TailState(obs=jnp.concatenate([prop, jnp.zeros((R, 3))], 1), prop=prop)
        step = dynamics.step(static, hyper, paying, model)
        _, outcome = step(state, jnp.zeros((R, 2)), keys)
        np.testing.assert_allclose(outcome.discount, np.where(ends, 0.0, lives), atol=1e-5)
        paid = np.where(ends, -5.0, -2.0) if falls else np.zeros(R)
        np.testing.assert_allclose(outcome.reward, paid, atol=1e-3)


# ---- falls and time limits


@pytest.fixture(scope="module")
def fallible(env):
    """`(static, hyper, fit, rows)`: 8 x 512 independent rows, of which about one in 20 falls."""
    _, static, hyper = settings({"model.clean": True, "model.falls": True})
    rng, count = np.random.default_rng(0), 512
    rows = jax.tree.map(np.asarray, rollout.allocate(env, N, count))
    prop, action = (rng.normal(size=(N, count, k)).astype(np.float32) for k in (3, 2))
    prop *= [1.0, 0.6, 1.0]
    after = moved(np.ones(count), prop, action)
    obs = np.concatenate([prop + NOISE, prop * 0], -1)
    discount = (np.abs(after[..., 1]) <= LIMIT) * 1.0
    rows = rows.replace(
        obs=obs,
        prop=prop,
        action=action,
        next_prop=after,
        discount=discount,
        valid=discount * 0 + 1,
    )
    rows = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)

    @jax.jit
    def fit(model, rows, epochs):
        return fit_rows(fast.fit, static, hyper, model, rows, N, epochs, jax.random.key(1), env)

    return static, hyper, fit, rows


def probability(static, hyper, env, model, rows):
    """Predicted probability of a fall in every row."""
    obs = np.concatenate([rows.prop, rows.obs[..., 3:]], -1)
    predict = jax.jit(jax.vmap(partial(dynamics.predict, static, hyper, env), (None, 0, 0)))
    return 1 - np.asarray(predict(model, obs, rows.action)[2])


def test_the_head_learns_which_rows_fall_and_how_many(env, fallible):
    """From 1 % everywhere to sure of most rows; the mean stays the share of falls."""
    static, hyper, fit, rows = fallible
    model = start(static, env)
    fell = np.asarray(rows.discount) == 0
    assert 0.02 < fell.mean() < 0.1
    fitted, _ = fit(model, rows, 1)
    model = model.replace(inputs=fitted.inputs, targets=fitted.targets)  # moments only
    untrained = probability(static, hyper, env, model, rows)
    assert untrained.mean() == pytest.approx(0.01, rel=0.5) and untrained.max() < 0.04
    model, _ = fit(model, rows, 300)
    found = probability(static, hyper, env, model, rows)
    assert found[fell].mean() > 0.75 and found[~fell].mean() < 0.02
    assert found.mean() == pytest.approx(fell.mean(), rel=0.15)


def test_rows_that_blew_up_are_no_falls_and_nothing_of_them_is_learned(env, fallible):
    """Garbage in rows of `valid` 0, which look like falls, changes no bit of the fit."""
    static, _, fit, rows = fallible
    blown = np.random.default_rng(1).random((N, 512)) < 0.2
    rows = rows.replace(
        valid=jnp.asarray(1.0 - blown, jnp.float32), discount=jnp.where(blown, 0.0, rows.discount)
    )
    spoilt = rows.replace(
        next_prop=jnp.where(blown[..., None], jnp.nan, rows.next_prop),
        prop=jnp.where(blown[..., None], 1e30, rows.prop),
    )
    model = start(static, env)
    assert_same(*(fit(model, r, 2) for r in (rows, spoilt)))
    # a fall counts
    fallen = rows.replace(discount=jnp.where(rows.valid == 1, 0.0, rows.discount))
    assert not np.array_equal(
        fit(model, fallen, 2)[0].targets.mean, fit(model, rows, 2)[0].targets.mean
    )


def test_no_row_of_a_tail_times_out_and_each_may_fall(iterated):
    for n in (5, 3):
        rows = iterated[3][n][0]
        np.testing.assert_array_equal(rows.truncation[n:], 0)
        assert ((rows.discount[n:] < 1) & (rows.discount[n:] > 0)).all()
        np.testing.assert_array_equal(rows.valid[n:], 1)


def test_a_summary_of_the_tail_tells_its_falls_and_how_much_better_it_looks(iterated):
    """Rewards a second of synthetic rows above real ones; falls expected; 0 without a tail."""
    for n, (rows, _, metrics) in iterated[3].items():
        bias = (rows.reward[n:].mean() - rows.reward[:n].mean()) / DT if n < N else 0.0
        np.testing.assert_allclose(metrics["tail_bias"], bias, 1e-3, 1e-4)
        np.testing.assert_allclose(metrics["tail_falls"], (1 - rows.discount[n:]).sum(), 1e-3, 1e-4)


# ---- what the policy learns of such a tail


def test_the_policy_learns_from_a_tail_by_what_survives_of_it(iterated, env):
    """The new learner is PPO's update with the product of the discounts before as a row's weight."""
    static, hyper, first, _ = iterated
    layers = dict(first.model.params["params"])
    last = f"Dense_{len(layers) - 1}"
    layers[last] = layers[last] | {"bias": layers[last]["bias"].at[-1].add(3.0)}  # sees falls
    first = first.replace(model=first.model.replace(params={"params": layers}))
    columns = row(settings(ON)[0], first=4, n_real=3, epochs=0)
    rows, state, _ = observe(env, static)(hyper, first, columns)
    weight = np.ones((N, R))
    for t in range(4, N):
        weight[t] = weight[t - 1] * rows.discount[t - 1]
    assert weight.min() < 0.5
    real = np.arange(N)[:, None] < 3
    estimate = jax.jit(partial(algorithm.estimate, static, hyper, env))
    batch = estimate(first.learner.params, rows, real)
    key = jax.random.fold_in(jax.random.fold_in(first.key, 4), algorithm.UPDATE)
    update = jax.jit(partial(ppo.update, static, hyper))
    expected, other = (
        update(first.learner, batch._replace(weight=jnp.asarray(w, jnp.float32)), key)[0].params
        for w in (weight, np.ones((N, R)))
    )
    assert_close(state.learner.params, expected, 1e-4)
    assert np.abs(expected["std"] - other["std"]).max() > 1e-3

"""A tail as good as it can be: the state without noise, known rewards, falls, bounds, weights of rows."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from test_algorithm import N, R, leaves, observe, row

from dynappo import algorithm, rollout
from dynappo.learner import networks, ppo
from dynappo.model import dynamics, examples, moments

ON = {f"model.{name}": True for name in ("clean", "known_reward", "falls", "bounds")}
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
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    # some iterations on, the model has seen falls and its bounds are set
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
    """Against the toy's own matrices; the observations around it are off by the noise."""
    _, _, state, out = iterated
    rows = out[N][0]
    expected = moved(state.params_physics, rows.prop, rows.action)
    np.testing.assert_allclose(rows.next_prop, expected, 1e-5, 1e-5)
    assert (np.abs(rows.next_prop[rows.discount == 0][:, 1]) > LIMIT).all()  # fallen, and not reset
    assert (rows.discount == 0).sum() > 2
    for obs, prop in ((rows.obs, rows.prop), (rows.next_obs, rows.next_prop)):
        noise = obs[..., :3] - prop
        assert (np.abs(noise) <= NOISE + 1e-5).all() and (np.abs(noise) > 0.5 * NOISE).mean() > 0.4


@pytest.mark.parametrize("n_real", [N, 5])
def test_the_model_is_asked_and_told_states_without_noise(iterated, n_real):
    """Moments and bounds of the fit: of prop and next prop in all real rows, fallen ones too."""
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
    numbers = np.column_stack([kept.next_prop, kept.reward])
    low, high = numbers.min(0), numbers.max(0)
    margin = 0.05 * (high - low)
    np.testing.assert_allclose(state.model.bounds, [low - margin, high + margin], 1e-4, 1e-5)


def test_a_tail_carries_the_state_and_shows_the_policy_fresh_noise(iterated, env):
    """Rows after N_r: the model on its own states, noise of the task's width, each row's its own."""
    static, hyper, _, out = iterated
    for n in (5, 3):
        rows, state, _ = out[n]
        np.testing.assert_array_equal(rows.obs[n], state.env_state.obs)
        np.testing.assert_array_equal(rows.prop[n], state.env_state.prop)
        np.testing.assert_array_equal(rows.prop[n + 1 :], rows.next_prop[n:-1])
        np.testing.assert_array_equal(rows.obs[n + 1 :], rows.next_obs[n:-1])
        np.testing.assert_array_equal(rows.next_obs[n:, :, 3], rows.obs[n:, :, 3])
        np.testing.assert_array_equal(rows.next_obs[n:, :, 4:], rows.action[n:])
        known = np.concatenate([rows.prop, rows.obs[..., 3:]], -1)[n:]
        call = partial(dynamics.predict, static.model, env, state.model, task=hyper.task)
        obs, reward, discount = jax.vmap(call)(known, rows.action[n:])
        np.testing.assert_allclose(rows.next_prop[n:], obs[..., :3], 1e-4, 1e-5)
        np.testing.assert_allclose(rows.reward[n:], reward, 1e-4, 1e-5)
        np.testing.assert_allclose(rows.discount[n:], discount, 1e-4, 1e-5)
        noise = (rows.next_obs[..., :3] - rows.next_prop)[n:]
        assert np.abs(noise).max() <= NOISE + 1e-5
        assert 0.8 * NOISE**2 / 3 < noise.var() < 1.2 * NOISE**2 / 3
        assert len(np.unique(noise.round(6))) > 0.99 * noise.size


def test_without_noise_the_policy_sees_what_the_model_carries():
    """And where the model is off, prop is the noisy observation's own part."""
    for fields, noise in ((ON, 0.0), ({}, NOISE)):
        config, static, hyper = settings(fields | {"task.noise.joint_pos": noise})
        env = toy_env.make()
        state = algorithm.init(env, hyper, jax.random.key(0), static=static)
        rows, _, _ = observe(env, static)(hyper, state, row(config, n_real=4))
        np.testing.assert_array_equal(rows.next_obs[4:, :, :3], rows.next_prop[4:])


# ---- known rewards


def test_known_and_learned_reward_make_the_reward(env, iterated):
    """On real rows the learned rest is the effort to the digit, however loud the noise."""
    static, hyper, _, out = iterated
    rows = out[N][0]
    rest = examples.targets(static.model, env, rows, hyper.task)[..., 3]
    np.testing.assert_allclose(rest, -0.01 * (rows.action**2).sum(-1), 1e-3, 1e-5)
    error = (rows.next_prop[..., 0] - rows.obs[..., 3]) ** 2
    np.testing.assert_allclose(rows.reward, DT * (1 - error + rest), 1e-4, 1e-5)


def said(static, model, output):
    """`model` whose network says `output` whatever it is asked, in numbers as they are."""
    layers = dict(model.params["params"])
    last = f"Dense_{len(layers) - 1}"
    kernel = jnp.zeros_like(layers[last]["kernel"])
    layers[last] = {"kernel": kernel, "bias": jnp.asarray(output, jnp.float32)}
    return model.replace(params={"params": layers})


def test_a_predicted_reward_is_that_of_the_predicted_state_and_the_rest(env):
    """Network says next state + (0.2, 0.3, -0.1), rest -0.5, logit 2: numbers by hand."""
    on = {"model.clean": True, "model.known_reward": True, "model.falls": True}
    _, static, hyper = settings(on | {"model.normalize": False})
    model = dynamics.init(static.model, env, jax.random.key(0))
    model = said(static.model, model, [0.2, 0.3, -0.1, -0.5, 2.0])
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(7, 6)), jnp.float32)
    action = jnp.ones((7, 2))
    after, reward, discount = dynamics.predict(static.model, env, model, obs, action, hyper.task)
    np.testing.assert_allclose(after[:, :3], obs[:, :3] + jnp.array([0.2, 0.3, -0.1]), 1e-5)
    known = 1 - (obs[:, 0] + 0.2 - obs[:, 3]) ** 2
    np.testing.assert_allclose(reward, DT * (known - 0.5), 1e-4, 1e-6)
    np.testing.assert_allclose(discount, 1 / (1 + np.exp(2.0 - 4.6)) + 0 * reward, 1e-5)


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
    fit = jax.jit(
        lambda model, rows, epochs: dynamics.fit(
            static.model, hyper.model, env, model, rows, N, epochs, jax.random.key(1), hyper.task
        )
    )
    return static, hyper, fit, rows


def probability(static, env, model, rows):
    """Predicted probability of a fall in every row."""
    obs = jnp.concatenate([rows.prop, rows.obs[..., 3:]], -1)
    call = partial(dynamics.predict, static.model, env, model)
    return 1 - np.asarray(jax.vmap(call)(obs, rows.action)[2])


def test_the_head_learns_which_rows_fall_and_how_many(env, fallible):
    """From 1 % everywhere to sure of most rows; the mean stays the share of falls."""
    static, _, fit, rows = fallible
    model = dynamics.init(static.model, env, jax.random.key(0))
    fell = np.asarray(rows.discount) == 0
    assert 0.02 < fell.mean() < 0.1
    model, _ = fit(model, rows, 0)  # moments only
    np.testing.assert_allclose(probability(static, env, model, rows), 0.01, atol=0.01)
    model, _ = fit(model, rows, 300)
    found = probability(static, env, model, rows)
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
    model = dynamics.init(static.model, env, jax.random.key(0))
    one, other = (leaves(fit(model, r, 2)) for r in (rows, spoilt))
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)
    # a fall counts
    fallen = rows.replace(discount=jnp.where(rows.valid == 1, 0.0, rows.discount))
    assert not np.array_equal(
        fit(model, fallen, 2)[0].targets.mean, fit(model, rows, 2)[0].targets.mean
    )


def test_a_tail_is_cut_where_the_clock_of_the_episode_says_so(iterated, env):
    """Row by row from the age of the robot at the seam; the robot then walks on."""
    _, _, _, out = iterated
    for n in (5, 3):
        rows, state, _ = out[n]
        age = np.asarray(state.env_state.clock) + np.arange(1, N - n + 1)[:, None]
        np.testing.assert_array_equal(rows.truncation[n:], age == env.episode_length)
        assert rows.truncation[n:-1].sum() > 0
        assert ((rows.discount[n:] < 1) & (rows.discount[n:] > 0)).all()
        np.testing.assert_array_equal(rows.valid[n:], 1)


def test_a_summary_of_the_tail_tells_its_falls_and_how_much_better_it_looks(iterated):
    """Rewards a second of synthetic rows above real ones; falls expected; 0 without a tail."""
    for n, (rows, _, metrics) in iterated[3].items():
        bias = (rows.reward[n:].mean() - rows.reward[:n].mean()) / DT if n < N else 0.0
        np.testing.assert_allclose(metrics["tail_bias"], bias, 1e-3, 1e-4)
        np.testing.assert_allclose(metrics["tail_falls"], (1 - rows.discount[n:]).sum(), 1e-3, 1e-4)


def test_advantages_of_a_tail_weigh_falls_stop_at_cuts_and_keep_values_in_range(iterated):
    """`estimate` against a loop: soft discounts, cuts inside the tail, values of real rows as bounds."""
    static, hyper, first, out = iterated
    rows, n = out[5][0], 5
    params, real = first.learner.params, np.arange(N)[:, None] < n
    far = np.where(real[..., None], 1.0, 5.0)  # values that leave the range
    rows = rows.replace(obs=far * rows.obs, next_obs=far * rows.next_obs)
    rows = rows.replace(value=np.asarray(networks.value(static.ppo, params, rows.obs)))
    last = np.array(networks.value(static.ppo, params, rows.next_obs))
    low, high = rows.value[:n].min(), rows.value[:n].max()
    gamma, lambda_ = hyper.ppo.gamma, hyper.ppo.lambda_
    for bounded in (True, False):
        value, end = np.array(rows.value), last.copy()
        if bounded:
            value[n:], end[n:] = np.clip(value[n:], low, high), np.clip(end[n:], low, high)
            assert (value != rows.value).any()
        advantages, later = np.zeros((N, R)), np.zeros(R)
        for t in reversed(range(N)):
            for r in range(R):
                cut = rows.truncation[t, r] == 1
                after = end[t, r] if cut or t == N - 1 else value[t + 1, r]
                alive = gamma * rows.discount[t, r]
                delta = rows.reward[t, r] + alive * after - value[t, r]
                later[r] = delta + alive * lambda_ * (not cut) * later[r]
            advantages[t] = later
        arrays = jax.tree.map(jnp.asarray, rows)
        batch = algorithm.estimate(static.ppo, hyper.ppo, params, arrays, real, bounded)
        np.testing.assert_allclose(batch.advantages, advantages, 1e-3, 1e-4)
        np.testing.assert_allclose(batch.returns, advantages + value, 1e-3, 1e-4)


# ---- bounds


@pytest.mark.parametrize("bounds", [True, False])
def test_a_wild_model_stays_in_the_range_of_real_rows(env, bounds):
    """Weights 30 times too large: with bounds no number of a tail leaves the range, and the learner
    stays finite; without, it does not even do that."""
    config, static, hyper = settings(ON | {"model.bounds": bounds})
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    wild = state.model.replace(params=jax.tree.map(lambda x: 30 * x, state.model.params))
    call = observe(env, static)
    rows, after, metrics = call(hyper, state.replace(model=wild), row(config, n_real=3, epochs=0))
    real = jax.tree.map(lambda x: np.asarray(x[:3]).reshape(3 * R, -1), rows)
    for made, seen in ((rows.next_prop, real.next_prop), (rows.reward[..., None], real.reward)):
        low, high = seen.min(0), seen.max(0)
        margin = 0.0501 * (high - low) + 1e-5
        inside = (made[3:] >= low - margin) & (made[3:] <= high + margin)
        assert inside.all() if bounds else inside.mean() < 0.5
    finite = all(np.isfinite(x).all() for x in jax.tree.leaves(after.learner.params))
    assert finite == bounds and (metrics["value_loss"] < 10) == bounds


def test_without_a_valid_row_the_bounds_stay(env):
    _, static, hyper = settings(ON)
    model = dynamics.init(static.model, env, jax.random.key(0))
    rows = rollout.allocate(env, N, R)
    after, _ = dynamics.fit(
        static.model, hyper.model, env, model, rows, N, 0, jax.random.key(0), hyper.task
    )
    np.testing.assert_array_equal(after.bounds, model.bounds)
    np.testing.assert_array_equal(model.bounds[:, 0], [-np.inf, np.inf])


# ---- the weight of synthetic rows


def batch_of(rows, seed=0):
    """A PPO batch `[N, rows]` of random numbers that a policy could have made."""
    rng = np.random.default_rng(seed)
    sizes = dict(obs=6, action=2, action_mean=2)
    numbers = {
        name: rng.normal(size=(N, rows, sizes[name]) if name in sizes else (N, rows))
        for name in ppo.Batch._fields
        if name != "weight"
    }
    numbers["log_prob"] = -2 + 0.1 * numbers["log_prob"]
    return ppo.Batch(**{name: jnp.asarray(x, jnp.float32) for name, x in numbers.items()})


@pytest.fixture(scope="module")
def learner():
    """`(static, hyper, learner)` of group ppo."""
    _, static, hyper = toy_env.settings()
    return static.ppo, hyper.ppo, ppo.init(static.ppo, hyper.ppo, 6, 2, jax.random.key(0))


def test_weights_of_1_are_no_weights(learner):
    """To rounding: the compiler may order a product's sum otherwise."""
    static, hyper, start = learner
    update = jax.jit(partial(ppo.update, static, hyper))
    batch = batch_of(R)
    one = leaves(update(start, batch._replace(weight=jnp.ones((N, R))), jax.random.key(1)))
    for name, x in leaves(update(start, batch, jax.random.key(1))).items():
        np.testing.assert_allclose(one[name], x, 1e-5, 1e-6, err_msg=name)


def test_a_weight_is_a_share_of_a_row_in_every_mean(learner):
    """Weights 0 and 1: loss, KL, gradient and normalised advantages are those of the rows of weight
    1; weights 1 and 1/2: the mean over two copies of the first rows and one of the others."""
    static, hyper, start = learner
    batch, first = batch_of(R), np.arange(N)[:, None] < 5
    value = jax.value_and_grad(partial(ppo.loss, static, hyper), has_aux=True)
    std = start.params["std"] * 0.9

    def ask(rows):
        return value(start.params, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), rows), std)

    zero = jnp.broadcast_to(1.0 * first, (N, R))
    half = 0.5 + 0.5 * zero
    some = jax.tree.map(lambda x: x[:5], batch)
    twice = jax.tree.map(lambda x: jnp.concatenate([x, x[:5]]), batch)
    for weight, same in ((zero, some), (half, twice)):
        found, expected = leaves(ask(batch._replace(weight=weight))), leaves(ask(same))
        for name in found:
            np.testing.assert_allclose(found[name], expected[name], 1e-4, 1e-5, err_msg=name)
    normal = ppo.normalize(batch.advantages, zero)[:5]
    np.testing.assert_allclose(normal, ppo.normalize(some.advantages), 1e-4, 1e-5)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_rows_of_weight_0_serve_the_advantages_of_real_rows_only(learner, weight):
    """Other numbers in the tail, the same advantages: the same learner, unless its weight is 1."""
    static, hyper, start = learner
    tail = (np.arange(N) >= 5)[:, None]
    batch, other = batch_of(R), batch_of(R, 1)

    def spoil(x, y):
        return jnp.where(tail.reshape(N, 1, *[1] * (x.ndim - 2)), 10 * y, x)

    spoilt = jax.tree.map(spoil, batch, other)
    weights = jnp.broadcast_to(jnp.where(tail, weight, 1.0), (N, R))
    update = jax.jit(partial(ppo.update, static, hyper))
    one, two = (
        update(start, b._replace(weight=weights), jax.random.key(1)) for b in (batch, spoilt)
    )
    close = [
        np.allclose(x, y, 1e-4, 1e-6)
        for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    ]
    assert all(close) if weight == 0 else not any(close[:3])


def test_tail_weight_reaches_the_update_as_weights_of_synthetic_rows(env, iterated):
    """The learner of an iteration is PPO's update with weight 0.25 in rows t >= N_r."""
    static, hyper, first, _ = iterated
    hyper = hyper._replace(ppo=hyper.ppo._replace(tail_weight=0.25))
    rows, state, _ = observe(env, static)(hyper, first, row(settings(ON)[0], first=4, n_real=5))
    real = jnp.arange(N)[:, None] < 5
    batch = algorithm.estimate(static.ppo, hyper.ppo, first.learner.params, rows, real, True)
    weight = jnp.broadcast_to(jnp.where(real, 1.0, 0.25), (N, R))
    key = jax.random.fold_in(jax.random.fold_in(first.key, 4), algorithm.UPDATE)
    update = jax.jit(partial(ppo.update, static.ppo, hyper.ppo))
    expected, _ = update(first.learner, batch._replace(weight=weight), key)
    one, other = leaves(state.learner.params), leaves(expected.params)
    for name in one:
        np.testing.assert_allclose(one[name], other[name], 1e-4, 1e-5, err_msg=name)


# ---- several networks, several steps


def two_that_differ(env):
    """`(static, model)`: of two networks the second says 0.6 more of the first number of prop."""
    static = settings({"model.ensemble": 2, "model.normalize": False})[1].model
    model = dynamics.init(static, env, jax.random.key(0))
    layers = jax.tree.map(lambda x: jnp.stack([x[0], x[0]]), dict(model.params["params"]))
    last = layers[f"Dense_{len(layers) - 1}"]
    last["bias"] = last["bias"].at[1, 0].add(0.6)
    return static, model.replace(params={"params": layers}, spread=jnp.float32(0.2))


def test_an_ensemble_predicts_the_mean_and_trusts_it_where_its_networks_agree(env):
    """They are 0.3 off their mean in one of four numbers: rms 0.15; at 0.2 on real rows a row has
    all its weight, at 0.1 (0.1 / 0.15)^2."""
    static, model = two_that_differ(env)
    one = jax.tree.map(lambda x: x[0], model.params)
    alone = settings({"model.normalize": False})[1].model
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(5, 6)), jnp.float32)
    action = jnp.ones((5, 2))
    expected = dynamics.predict(alone, env, model.replace(params=one), obs, action)[0]
    found = dynamics.predict(static, env, model, obs, action)[0]
    np.testing.assert_allclose(found[:, 0], expected[:, 0] + 0.3, 1e-5)
    np.testing.assert_allclose(found[:, 1:], expected[:, 1:], 1e-5)
    for real, weight in ((0.2, 1.0), (0.1, (0.1 / 0.15) ** 2)):
        trusted = dynamics.trust(static, model.replace(spread=real), obs, action, 3)
        np.testing.assert_allclose(trusted, weight, 1e-4)


def test_networks_of_an_ensemble_start_and_end_apart_and_weigh_the_tail(env):
    config, static, hyper = settings(ON | {"model.ensemble": 3})
    state = algorithm.init(env, hyper, jax.random.key(0), static=static)
    seen = {}
    real = ppo.update

    def update(static, hyper, learner, batch, *rest):
        seen["weight"] = batch.weight
        return real(static, hyper, learner, batch, *rest)

    def call(hyper, state, columns):
        state, metrics = algorithm.iterate(env, hyper, state, columns, static=static)
        return state, metrics, seen["weight"]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ppo, "update", update)
        call = jax.jit(call)
        for i in (1, 2):
            state, metrics, weight = call(hyper, state, row(config, first=i, n_real=5))
    for leaf in jax.tree.leaves(state.model.params):
        assert leaf.shape[0] == 3 and not np.array_equal(leaf[0], leaf[1])
    assert state.model.spread > 0 and np.isfinite(metrics["model_loss"])
    weight = np.asarray(weight)
    np.testing.assert_array_equal(weight[:5], 1)
    assert (weight[5:] > 0).all() and (weight[5:] < 1).any() and weight.max() == 1


def test_the_loss_of_predictions_in_a_row_is_that_of_a_loop(env, fallible):
    """Against predict, carried on by hand row after row, in raw numbers; nothing after an end."""
    _, _, _, rows = fallible
    config = {"model.unroll": 3, "model.huber_delta": 1e9}  # the mean square, halved
    _, static, hyper = settings(config)
    ends = np.random.default_rng(2).random((N, 512)) < 0.2
    obs = np.array(rows.obs)
    obs[1:, :, :3] += 0.1  # rows that do not follow from each other: the drift is large
    rows = rows.replace(discount=jnp.where(ends, 0.0, 1.0), obs=jnp.asarray(obs))
    rows = rows.replace(next_obs=jnp.roll(rows.obs, -1, 0))
    model = dynamics.init(static.model, env, jax.random.key(0))
    key, n_real = jax.random.key(1), jnp.int32(6)
    fit = partial(dynamics.fit, static.model, hyper.model, env)
    model, metrics = jax.jit(fit)(model, rows, n_real, jnp.int32(1), key)

    before = dynamics.init(static.model, env, jax.random.key(0)).replace(
        inputs=model.inputs, targets=model.targets
    )
    drawn = N // static.model.minibatches
    times = jax.random.randint(jax.random.fold_in(key, 0), (drawn, 512, 1), 0, n_real - 2)
    times, robots = np.asarray(times)[..., 0], np.arange(512)
    std = np.asarray(moments.scale(model.targets)[1])
    total, alive, state = 0.0, 1.0, None
    for k in range(3):
        row = jax.tree.map(lambda x, t=times + k: np.asarray(x)[t, robots], rows)
        obs = row.obs if state is None else np.concatenate([state, row.obs[..., 3:]], -1)
        found, reward, _ = jax.vmap(partial(dynamics.predict, static.model, env, before))(
            jnp.asarray(obs), row.action
        )
        state = np.asarray(found)[..., :3]
        wrong = np.concatenate(
            [state - row.next_obs[..., :3], (reward - row.reward)[..., None] / DT], -1
        )
        weight = alive * row.discount
        total += ((0.5 * (wrong / std) ** 2).mean(-1) * weight).sum() / weight.sum() / 3
        alive = alive * row.discount
    np.testing.assert_allclose(metrics["model_loss_before"], total, rtol=1e-3)

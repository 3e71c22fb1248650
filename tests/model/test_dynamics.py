"""The transition model on a made-up linear world: what it learns, and which rows it never sees."""

import re
from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toy_model import (
    ACTIONS,
    DT,
    ENV,
    HORIZON,
    OBS,
    PROP,
    ROBOTS,
    constant_model,
    fit,
    fit_rows,
    linear_rows,
    settings,
    start,
    that_says,
)
from toy_runs import assert_same

from dynappo import fast
from dynappo.learner import networks
from dynappo.model import dynamics, examples, moments
from dynappo.types import Moments


def i32(x):
    """As the columns of the schedule hold it."""
    return jnp.asarray(x, jnp.int32)


def replace_rows(rows, chosen, seed, size=1e3):
    """`rows` with finite garbage in every number of those of `chosen` [N, R]; discounts stay."""
    rng = np.random.default_rng(seed)

    def garbage(x):
        pick = chosen.reshape(chosen.shape + (1,) * (x.ndim - 2))
        return jnp.where(pick, jnp.asarray(size * rng.normal(size=x.shape), x.dtype), x)

    spoilt = jax.tree.map(garbage, rows)
    return spoilt.replace(discount=rows.discount, truncation=rows.truncation)


def rms(x):
    """Root mean square over the first axis."""
    return np.sqrt(np.mean(np.square(x), axis=0))


# learning


@pytest.mark.parametrize(("precision", "allowed"), [("highest", 0.05), ("bfloat16", 0.10)])
def test_a_fit_learns_a_linear_world_and_predicts_rows_it_has_not_seen(precision, allowed):
    static, hyper = settings(stats_decay=0.5, precision=precision)
    model = start(static)
    run = fit(static)
    for i in range(6):  # fresh rows each time, warm-started as in training
        key = jax.random.key(i)
        model, metrics = run(hyper, model, linear_rows(i), i32(HORIZON), i32(50), key)
        if i == 0:
            assert metrics["model_loss"] < 0.2 * metrics["model_loss_before"]
            first = metrics
    assert metrics["model_loss_before"] < 0.2 * first["model_loss_before"]
    assert {x.dtype.name for x in jax.tree.leaves(model)} == {"float32", "int32"}

    rows = jax.tree.map(lambda x: np.reshape(x, (-1, *x.shape[2:])), linear_rows(1000))
    predict = jax.jit(partial(dynamics.predict, static, hyper, ENV))
    next_obs, reward, _ = jax.device_get(predict(model, rows.obs, rows.action))
    assert next_obs.dtype == reward.dtype == jnp.float32
    change = (rows.next_obs - rows.obs)[:, :PROP]
    error = next_obs[:, :PROP] - rows.next_obs[:, :PROP]
    assert (rms(error) < allowed * rms(change)).all()
    assert rms(reward - rows.reward) < allowed * rms(rows.reward)


def test_the_plain_form_learns_the_next_state_itself():
    static, hyper = settings(predict_change=False, normalize=False, learning_rate=1e-3)
    model, rows = start(static), linear_rows(0)
    model, metrics = fit(static)(hyper, model, rows, i32(HORIZON), i32(100), jax.random.key(0))
    assert metrics["model_loss"] < 0.2 * metrics["model_loss_before"]
    rows = jax.device_get(rows)
    predict = jax.jit(partial(dynamics.predict, static, hyper, ENV))
    next_obs, _, _ = jax.device_get(predict(model, rows.obs[0], rows.action[0]))
    error = (next_obs - rows.next_obs[0])[:, :PROP]
    assert rms(error)[0] < 0.5 * rms(rows.next_obs[0])[0]  # of the number around 5


def test_the_first_reported_loss_is_the_huber_loss_of_the_untrained_model():
    static, hyper = settings(normalize=False, huber_delta=0.5)
    model, rows = start(static), linear_rows(0)
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x[:1, :1], x.shape), rows)  # all rows alike
    # no step: the loss of the one row, by hand
    y = np.append(np.asarray(rows.next_obs - rows.obs)[0, 0, :PROP], rows.reward[0, 0] / DT)
    next_obs, reward, _ = dynamics.predict(static, hyper, ENV, model, rows.obs[0], rows.action[0])
    guess = np.append(np.asarray(next_obs - rows.obs[0])[0, :PROP], reward[0] / DT)
    total = 0.0
    for error in np.abs(np.float64(guess) - y):
        total += 0.5 * error**2 if error <= 0.5 else 0.5 * (error - 0.25)
    _, metrics = fit(static)(hyper, model, rows, i32(HORIZON), i32(1), jax.random.key(0))
    np.testing.assert_allclose(metrics["model_loss_before"], total / (PROP + 1), rtol=1e-4)


def test_a_fit_of_no_epochs_changes_nothing_and_has_no_loss():
    """By the program that fits: parameters, Adam and moments to the bit. For two seeds too, by the same
    loop and without a branch: both would be paid for in every iteration."""
    static, hyper = settings()
    fits = jax.vmap(fit(static), (None, 0, 0, None, None, 0))
    rows = jax.tree.map(lambda *x: np.stack(x), linear_rows(1), linear_rows(2))
    keys = jax.random.split(jax.random.key(0))
    models = jax.tree.map(lambda x: np.stack([x, x]), start(static))
    models, losses = fits(hyper, models, rows, i32(HORIZON), i32(2), keys)
    assert all(np.isfinite(loss).all() for loss in losses.values())
    fresh = jax.tree.map(lambda x: 3 * x, rows)  # whose moments are others
    after, losses = fits(hyper, models, fresh, i32(HORIZON), i32(0), keys)
    assert_same(after, models)
    assert losses.keys() == {"model_loss", "model_loss_before"}
    assert all(np.isnan(loss).all() and loss.shape == (2,) for loss in losses.values())
    assert_same(fits(hyper, models, fresh, i32(0), i32(2), keys)[0].inputs, models.inputs)

    jaxpr = str(jax.make_jaxpr(fits)(hyper, models, fresh, i32(HORIZON), i32(0), keys))
    assert " cond[" not in jaxpr
    one, moved = (jax.tree.map(lambda x: x[0], jax.device_get(tree)) for tree in (models, fresh))
    after, _ = fit(static)(hyper, one, moved, i32(HORIZON), i32(0), keys[0])
    assert_same(after, one)
    after, _ = fit(static)(hyper, one, moved, i32(HORIZON), i32(1), keys[0])
    assert not np.array_equal(after.inputs.mean, one.inputs.mean)


@pytest.mark.parametrize("falls", [False, True])
def test_the_loss_is_the_mean_over_rows_and_numbers_of_huber_and_cross_entropy(typed, falls):
    """Of rows of weight 1, against NumPy; an untrained logit says 1 % (-4.6)."""
    static, hyper = settings(falls=falls, huber_delta=0.7)
    rng, size = np.random.default_rng(0), PROP + 1 + falls
    x = jnp.asarray(rng.normal(size=(6, OBS + ACTIONS)), jnp.float32)
    y = 3 * rng.normal(size=(6, size))
    y[:, PROP + 1 :] = rng.random((6, int(falls))) < 0.5
    params, weight = start(static).params, np.array([1.0, 0, 1, 1, 0, 1])
    said = np.float64(networks.apply(dynamics.network(static, PROP), params, x))
    error = np.abs(said - y)
    each = np.where(error <= 0.7, 0.5 * error**2, 0.7 * (error - 0.35))
    if falls:
        p = 1 / (1 + np.exp(4.6 - said[:, -1]))
        each[:, -1] = -np.log(np.where(y[:, -1] == 1, p, 1 - p))
    args = x, jnp.asarray(y, jnp.float32)
    found = typed(dynamics.loss)(static, hyper, params, *args, jnp.asarray(weight))
    np.testing.assert_allclose(found, each[weight == 1].mean(), rtol=1e-5)
    assert dynamics.loss(static, hyper, params, *args, jnp.zeros(6)) == 0  # and not 0 / 0


# which rows count


@pytest.mark.parametrize("n_real", [3, 6])
def test_rows_of_the_tail_never_change_the_fit(n_real):
    static, hyper = settings()
    model, rows = start(static), linear_rows(0)
    tail = np.broadcast_to(np.arange(HORIZON)[:, None] >= n_real, (HORIZON, ROBOTS))
    args = i32(n_real), i32(2), jax.random.key(0)
    spoilt = replace_rows(rows, tail, 1)
    fallen = spoilt.replace(discount=jnp.where(tail, 0.0, 1.0), truncation=1.0 * tail)
    expected = fit(static)(hyper, model, rows, *args)
    assert_same(fit(static)(hyper, model, spoilt, *args), expected)
    assert_same(fit(static)(hyper, model, fallen, *args), expected)
    # the last real row does count
    spoilt = replace_rows(rows, np.roll(tail, -1, 0) & ~tail, 1, 1.0)
    other = fit(static)(hyper, model, spoilt, *args)
    assert not np.array_equal(other[0].targets.mean, expected[0].targets.mean)


@pytest.mark.parametrize(("n_real", "epochs"), [(8, 2), (5, 3), (2, 2), (3, 1)])
def test_an_epoch_has_every_real_row_of_every_robot_once(monkeypatch, n_real, epochs):  # epochs
    """Rows are known by their first number; a loss that is 0 tells which ones it was given."""
    static, hyper = settings(normalize=False)
    rows = linear_rows(0)
    obs = rows.obs.at[..., 0].set(jnp.arange(HORIZON)[:, None])
    seen = []

    def loss(static, hyper, params, x, y, weight):
        jax.debug.callback(lambda *found: seen.append(found), x[..., 0], weight, ordered=True)
        return 0.0 * sum(p.sum() for p in jax.tree.leaves(params))

    monkeypatch.setattr(dynamics, "loss", loss)
    args = start(static), rows.replace(obs=obs), i32(n_real), i32(epochs), jax.random.key(0)
    jax.block_until_ready(jax.jit(partial(fit_rows, fast.fit, static, hyper))(*args))
    jax.effects_barrier()
    assert len(seen) == -(-epochs * n_real // 2)  # two rows of each robot a minibatch
    row, weight = (np.concatenate(part) for part in zip(*seen, strict=True))
    used, rest = np.split(weight, [epochs * n_real])
    assert (used == 1).all() and not rest.any()
    passes = row[: epochs * n_real].reshape(epochs, n_real, ROBOTS)
    assert (np.sort(passes, 1) == np.arange(n_real)[:, None]).all()
    orders = {tuple(order) for one in passes for order in one.T}
    assert len(orders) > min(n_real, 4) - 1  # neither robots nor epochs share one


def test_a_longer_tail_in_the_buffer_gives_the_same_fit():
    model, rows, results = start(settings()[0]), linear_rows(0), []
    for horizon in (8, 6):  # six real rows and two synthetic ones, or none; 64 rows a minibatch
        static, hyper = settings(horizon, minibatches=horizon // 2)
        held = jax.tree.map(lambda x, n=horizon: x[:n], rows)
        results.append(fit(static)(hyper, model, held, i32(6), i32(3), jax.random.key(0)))
    for a, b in zip(*map(jax.tree.leaves, results), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("garbage", [1e3, np.nan, np.inf, 1e30])
@pytest.mark.parametrize("kind", ["fall", "time limit"])
def test_rows_that_ended_an_episode_never_change_the_fit(kind, garbage):
    """However wild their numbers are; the same garbage in other rows does change it."""
    static, hyper = settings()
    model, rows = start(static), linear_rows(0)
    ended = np.random.default_rng(2).random((HORIZON, ROBOTS)) < 0.2
    if kind == "fall":
        rows = rows.replace(discount=jnp.asarray(1.0 - ended, jnp.float32))
    else:
        rows = rows.replace(truncation=jnp.asarray(1.0 * ended, jnp.float32))
    args = i32(HORIZON), i32(2), jax.random.key(0)
    expected = fit(static)(hyper, model, rows, *args)
    assert_same(fit(static)(hyper, model, replace_rows(rows, ended, 3, garbage), *args), expected)
    others = replace_rows(rows, ~ended, 3, 1.0)
    changed = fit(static)(hyper, model, others, *args)[0]
    assert not np.array_equal(changed.targets.mean, expected[0].targets.mean)


def test_a_fit_without_any_valid_row_changes_no_number_by_the_rows():
    static, hyper = settings()
    model, rows = start(static), linear_rows(0)
    model, _ = fit(static)(hyper, model, rows, i32(HORIZON), i32(2), jax.random.key(0))
    fallen = rows.replace(discount=jnp.zeros((HORIZON, ROBOTS)))
    after, _ = fit(static)(hyper, model, fallen, i32(HORIZON), i32(1), jax.random.key(1))
    assert_same((after.inputs, after.targets), (model.inputs, model.targets))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(after))


@pytest.mark.parametrize(("n_real", "epochs"), [(8, 3), (6, 3), (5, 2), (5, 3), (2, 1), (8, 0)])
def test_steps_are_as_many_as_the_epochs_have_minibatches(n_real, epochs):  # epochs
    """The last one may be a part: two rows of each robot make a minibatch."""
    static, hyper = settings()
    model, _ = fit(static)(
        hyper, start(static), linear_rows(0), i32(n_real), i32(epochs), jax.random.key(0)
    )
    assert int(model.opt_state.count) == -(-epochs * n_real // 2)


def test_a_second_fit_goes_on_with_the_weights_and_adam_moments_of_the_first():
    static, hyper = settings()
    rows, args = linear_rows(0), (i32(HORIZON), i32(2))
    first, _ = fit(static)(hyper, start(static), rows, *args, jax.random.key(0))
    second, _ = fit(static)(hyper, first, rows, *args, jax.random.key(1))
    assert int(second.opt_state.count) == 2 * int(first.opt_state.count) == 16
    cold = first.replace(opt_state=start(static).opt_state)
    forgetful, _ = fit(static)(hyper, cold, rows, *args, jax.random.key(1))
    kernels = [m.params["params"]["Dense_0"]["kernel"] for m in (second, forgetful)]
    assert not np.array_equal(*kernels)


def test_minibatches_depend_on_the_key():
    static, hyper = settings()
    args = hyper, start(static), linear_rows(0), i32(HORIZON), i32(1)
    one, same, other = (fit(static)(*args, jax.random.key(k))[0] for k in (1, 1, 2))
    assert_same(one, same)
    assert not np.array_equal(*(m.params["params"]["Dense_0"]["bias"] for m in (one, other)))


def test_one_program_serves_every_number_of_real_rows_epochs_and_learning_rate():
    static, hyper = settings()

    @jax.jit
    @chex.assert_max_traces(1)
    def run(hyper, model, rows, n_real, epochs, key):
        return fit_rows(fast.fit, static, hyper, model, rows, n_real, epochs, key)

    model, rows = start(static), linear_rows(0)
    for n_real, epochs, rate in ((8, 1, 1e-3), (5, 2, 1e-3), (3, 1, 3e-3)):
        hyper = hyper._replace(model=hyper.model._replace(learning_rate=rate))
        model, _ = run(hyper, model, rows, i32(n_real), i32(epochs), jax.random.key(0))


@pytest.mark.parametrize(
    ("precision", "expected"),
    [("highest", "HIGHEST"), ("tf32", "HIGH"), ("bfloat16", "DEFAULT")],
)
def test_fit_and_tail_compute_in_the_precision_of_the_setting(precision, expected):
    static, hyper = settings(precision=precision)
    model, rows = start(static), linear_rows(0)
    args = i32(HORIZON), i32(1), jax.random.key(0)
    predict = jax.make_jaxpr(lambda m, r: dynamics.predict(static, hyper, ENV, m, r.obs, r.action))
    program = str(jax.make_jaxpr(fit(static))(hyper, model, rows, *args))
    for text in (str(predict(model, rows)), program):
        found = set(re.findall(r"Precision\.(\w+)", text))
        assert found <= {expected} and (found or expected == "DEFAULT")
        assert ("bf16[" in text) == (precision == "bfloat16")


# prediction

OUTPUT = np.array([1.0, -2.0, 0.5, 0.0, 3.0])
MEAN, STD = np.array([0.1, 0.2, 0.3, 0.4, -1.0]), np.array([2.0, 0.5, 1.0, 1.0, 4.0])


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("predict_change", [True, False])
def test_a_prediction_is_unscaled_added_to_the_state_and_the_reward_multiplied_by_dt(
    typed, normalize, predict_change
):
    static, hyper = settings(normalize=normalize, predict_change=predict_change)
    model, rows = constant_model(static, OUTPUT, MEAN, STD), linear_rows(0)
    obs, action = rows.obs[0], rows.action[0]
    next_obs, reward, discount = typed(dynamics.predict)(static, hyper, ENV, model, obs, action)
    # outputs 1, -2, 0.5, 0, 3: 2.1, -0.8, 0.8, 0.4 and 11 after scaling
    expected = np.array([2.1, -0.8, 0.8, 0.4, 11.0] if normalize else OUTPUT)
    before = np.asarray(obs[:, :PROP]) if predict_change else 0.0
    np.testing.assert_allclose(
        next_obs[:, :PROP], before + expected[:PROP] + 0 * obs[:, :PROP], rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(reward, np.full(ROBOTS, expected[PROP] * DT), rtol=1e-5)
    np.testing.assert_array_equal(next_obs[:, PROP:-ACTIONS], obs[:, PROP:-ACTIONS])
    np.testing.assert_array_equal(next_obs[:, -ACTIONS:], action)


def test_a_step_of_the_tail_carries_the_prediction_and_ends_no_episode():
    static, hyper = settings()
    model, rows = constant_model(static, OUTPUT, MEAN, STD), linear_rows(0)
    state = dynamics.TailState(obs=rows.obs[0], prop=rows.obs[0, :, :PROP])
    state, outcome = dynamics.step(static, hyper, ENV, model)(state, rows.action[0], None)
    expected = dynamics.predict(static, hyper, ENV, model, rows.obs[0], rows.action[0])
    assert_same((outcome.next_obs, outcome.reward, outcome.discount), expected)
    np.testing.assert_array_equal(state.obs, outcome.next_obs)
    np.testing.assert_array_equal(outcome.discount, 1)
    np.testing.assert_array_equal(outcome.truncation, 0)
    assert outcome.discount.shape == outcome.truncation.shape == (ROBOTS,)
    chex.assert_trees_all_equal_shapes_and_dtypes(outcome.discount, outcome.reward)


def test_an_untrained_model_has_moments_of_weight_0_and_no_step_behind_it():
    model = start(settings()[0])
    assert float(model.inputs.weight) == float(model.targets.weight) == 0
    assert model.inputs.mean.shape == (OBS + ACTIONS,)
    assert model.targets.mean.shape == (PROP + 1,)
    assert int(model.opt_state.count) == 0


def test_without_normalisation_the_moments_do_not_matter():
    static, hyper = settings(normalize=False)
    model, rows = start(static), linear_rows(0)
    other = Moments(mean=jnp.full(OBS + ACTIONS, 3.0), var=jnp.ones(OBS + ACTIONS), weight=1.0)
    args = rows.obs[0], rows.action[0]
    expected = dynamics.predict(static, hyper, ENV, model, *args)
    assert_same(dynamics.predict(static, hyper, ENV, model.replace(inputs=other), *args), expected)
    static, hyper = settings(normalize=True)
    scaled = dynamics.predict(static, hyper, ENV, model.replace(inputs=other), *args)
    assert not np.array_equal(scaled[0], expected[0])


# a bound on what is predicted


def bounded(hyper, bound):
    return hyper._replace(model=hyper.model._replace(bound=bound))


def of_moments(static, hyper, model, rows):
    """`model` with the moments of `rows`, without a fit."""
    of = examples.examples(static, hyper, ENV, rows, i32(HORIZON))
    return dynamics.with_moments_of(hyper, model, of, i32(1))


@pytest.mark.parametrize("normalize", [True, False])
def test_a_predicted_prop_is_at_most_so_many_std_from_the_mean_of_the_inputs(typed, normalize):
    """Against NumPy; the context and the known reward follow from what is left of the prediction."""
    static, hyper = settings(normalize=normalize, known_reward=True)
    rows = linear_rows(0)
    model = that_says([1e4, -1e4, 0.0, 0.0, 0.0], start(static))
    model = of_moments(static, hyper, model, rows)
    action, props = rows.action[0], np.float64(rows.obs[..., :PROP]).reshape(-1, PROP)
    mean, std = props.mean(0), props.std(0)
    least, largest = mean - 1.5 * std, mean + 1.5 * std
    free, _, _ = dynamics.predict(static, hyper, ENV, model, rows.obs[0], action)
    hyper = bounded(hyper, 1.5)
    after, reward, _ = typed(dynamics.predict)(static, hyper, ENV, model, rows.obs[0], action)
    expected = np.clip(free[:, :PROP], least, largest)
    np.testing.assert_allclose(after[:, :PROP], expected, 1e-5, 1e-5)
    np.testing.assert_allclose(expected[:, :2], [[largest[0], least[1]]] * ROBOTS)
    assert (expected[:, 2] != free[:, 2]).any() and (expected[:, 2] == free[:, 2]).any()
    np.testing.assert_array_equal(after[:, PROP:], free[:, PROP:])
    known = ENV.known_reward(hyper, rows.obs[0].T, action.T, expected.T)
    said = float(model.targets.mean[-1]) / float(model.targets.weight) * DT if normalize else 0.0
    np.testing.assert_allclose(reward, known + said, 1e-4, 1e-5)


@pytest.mark.parametrize("module", [dynamics, fast], ids=["plain", "fast"])
def test_a_model_that_diverges_stays_within_the_bound_in_a_tail_of_24_rows(module):
    static, hyper = settings()
    model, rows = start(static), linear_rows(0)
    steep = jax.tree.map(lambda weight: 10 * weight, model.params)
    model = of_moments(static, hyper, model.replace(params=steep), rows)
    first = dynamics.TailState(obs=rows.obs[0], prop=rows.obs[0, :, :PROP])

    @jax.jit
    def tail(hyper):
        step = module.step(static, hyper, ENV, model)
        return jax.lax.scan(lambda state, a: step(state, a, None), first, jnp.ones((24, ROBOTS, 2)))

    mean, std = (np.asarray(x)[:PROP] for x in moments.scale(model.inputs))
    free = np.abs(np.asarray(tail(hyper)[1].next_prop) - mean) / std
    assert not free[-1].max() < 1e10  # or it is not finite
    _, outcome = tail(bounded(hyper, 20.0))
    away = np.abs(np.asarray(outcome.next_prop) - mean) / std
    assert 19.99 < away.max() < 20.01
    np.testing.assert_array_equal(outcome.next_obs[..., :PROP], outcome.next_prop)
    assert np.abs(outcome.reward).max() < 1e3


def test_a_bound_that_nothing_reaches_changes_no_bit():
    static, hyper = settings()
    model, rows = start(static), linear_rows(0)
    model = of_moments(static, hyper, model, rows)
    found, expected = (
        dynamics.predict(static, bounded(hyper, bound), ENV, model, rows.obs[0], rows.action[0])
        for bound in (1e3, None)
    )
    assert_same(found, expected)

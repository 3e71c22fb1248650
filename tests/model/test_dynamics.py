"""The transition model on made-up environments: what it learns, and which rows it never sees."""

import functools
import re

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo import rollout
from dynappo.model import dynamics, errors, examples, moments
from dynappo.types import Env, Moments

PROP, COMMAND, ACTIONS = 4, 2, 2
OBS = PROP + COMMAND + ACTIONS  # predicted part, then the command and the previous action
DT, HORIZON, ROBOTS = 0.02, 8, 32
SETTINGS = {
    "hidden": (32, 32),
    "activation": "elu",
    "learning_rate": 3e-3,
    "minibatches": 4,
    "huber_delta": 1.0,
    "predict_change": True,
    "normalize": True,
    "stats_decay": 0.95,
    "precision": "highest",
}

ENV = Env(
    randomize=None,
    reset=None,
    step=None,
    autoreset=None,
    context=lambda obs, action: jnp.concatenate([obs[..., PROP : PROP + COMMAND], action], -1),
    noise=None,
    known_reward=None,
    metrics=(),
    obs_size=OBS,
    prop_size=PROP,
    action_size=ACTIONS,
    dt=DT,
    episode_length=1000,
)


@pytest.fixture(scope="module")
def model_settings(settings):
    """`f(fields) -> (static, hyper)` of group model: a small network, 4 minibatches."""

    def make(horizon=HORIZON, **fields):
        fields = SETTINGS | fields
        sizes = {"rollout.num_envs": ROBOTS, "rollout.horizon": horizon, "schedule.end_steps": 1}
        static, hyper = settings(sizes | {f"model.{k}": v for k, v in fields.items()})
        return static.model, hyper.model

    return make


@functools.cache
def fit(static):
    """`dynamics.fit` compiled once for each static setting."""
    return jax.jit(
        lambda hyper, model, rows, n_real, epochs, key: dynamics.fit(
            static, hyper, ENV, model, rows, n_real, epochs, key
        )
    )


def linear_rows(seed, horizon=HORIZON):
    """Rows [N, R] of a world whose change of state and reward are linear, of unlike sizes."""
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 10.0, 0.1, 1.0] + [1.0] * (OBS - PROP))
    shift = np.array([5.0, 0.0, 0.0, -3.0] + [0.0] * (OBS - PROP))
    obs = shift + size * rng.normal(size=(horizon, ROBOTS, OBS))
    action = rng.normal(size=(horizon, ROBOTS, ACTIONS))
    world = np.random.default_rng(99)  # the same for every seed
    matrix = world.normal(size=(OBS + ACTIONS, PROP + 1))
    y = (np.concatenate([(obs - shift) / size, action], -1) @ matrix) / 3
    change = 0.1 * size[:PROP] * y[..., :PROP]
    rows = jax.tree.map(np.asarray, rollout.allocate(ENV, horizon, ROBOTS))
    next_obs = np.concatenate([obs[..., :PROP] + change, ENV.context(obs, action)], -1)
    ones = np.ones((horizon, ROBOTS))
    rows = rows.replace(
        obs=obs, action=action, next_obs=next_obs, reward=DT * y[..., PROP], discount=ones
    )
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)


def start(static):
    """An untrained model."""
    return dynamics.init(static, ENV, jax.random.key(0))


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


def assert_same_bits(a, b):
    """Every leaf equal, not only close."""
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def rms(x):
    """Root mean square over the first axis."""
    return np.sqrt(np.mean(np.square(x), axis=0))


# learning


@pytest.mark.parametrize("fields", [{}, {"precision": "tf32"}, {"precision": "bfloat16"}], ids=str)
def test_a_fit_learns_a_linear_world_and_predicts_rows_it_has_not_seen(model_settings, fields):
    static, hyper = model_settings(stats_decay=0.5, **fields)
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

    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), linear_rows(1000))
    next_obs, reward, _ = dynamics.predict(static, ENV, model, rows.obs, rows.action)
    assert next_obs.dtype == reward.dtype == jnp.float32
    change = (rows.next_obs - rows.obs)[:, :PROP]
    error = next_obs[:, :PROP] - rows.next_obs[:, :PROP]
    allowed = 0.10 if fields.get("precision") == "bfloat16" else 0.05
    assert (rms(error) < allowed * rms(change)).all()
    assert rms(reward - rows.reward) < allowed * rms(rows.reward)


def test_the_plain_form_learns_the_next_state_itself(model_settings):
    static, hyper = model_settings(predict_change=False, normalize=False, learning_rate=1e-3)
    model, rows = start(static), linear_rows(0)
    model, metrics = fit(static)(hyper, model, rows, i32(HORIZON), i32(100), jax.random.key(0))
    assert metrics["model_loss"] < 0.2 * metrics["model_loss_before"]
    next_obs, _, _ = dynamics.predict(static, ENV, model, rows.obs[0], rows.action[0])
    error = (next_obs - rows.next_obs[0])[:, :PROP]
    assert rms(error)[0] < 0.5 * rms(rows.next_obs[0])[0]  # of the number around 5


def test_the_first_reported_loss_is_the_huber_loss_of_the_untrained_model(model_settings):
    static, hyper = model_settings(normalize=False, huber_delta=0.5)
    model, rows = start(static), linear_rows(0)
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x[:1, :1], x.shape), rows)  # all rows alike
    # no step: the loss of the one row, by hand
    y = np.append(np.asarray(rows.next_obs - rows.obs)[0, 0, :PROP], rows.reward[0, 0] / DT)
    next_obs, reward, _ = dynamics.predict(static, ENV, model, rows.obs[0], rows.action[0])
    guess = np.append(np.asarray(next_obs - rows.obs[0])[0, :PROP], reward[0] / DT)
    total = 0.0
    for error in np.abs(np.float64(guess) - y):
        total += 0.5 * error**2 if error <= 0.5 else 0.5 * (error - 0.25)
    _, metrics = fit(static)(hyper, model, rows, i32(HORIZON), i32(1), jax.random.key(0))
    np.testing.assert_allclose(metrics["model_loss_before"], total / (PROP + 1), rtol=1e-4)


def test_the_loss_is_the_mean_over_rows_of_weight_1(model_settings, typed):
    static, _ = model_settings()
    rng = np.random.default_rng(0)
    x = jnp.asarray(rng.normal(size=(6, OBS + ACTIONS)), jnp.float32)
    y = jnp.asarray(3 * rng.normal(size=(6, PROP + 1)), jnp.float32)
    params = start(static).params
    weight = jnp.array([1.0, 0, 1, 1, 0, 1])
    chosen = np.array([0, 2, 3, 5])
    some = typed(dynamics.loss)(static, params, [(x, y, weight)], 1.0)
    alone = dynamics.loss(static, params, [(x[chosen], y[chosen], jnp.ones(4))], 1.0)
    np.testing.assert_allclose(some, alone, rtol=1e-5)
    assert dynamics.loss(static, params, [(x, y, jnp.zeros(6))], 1.0) == 0  # and not 0 / 0


# which rows count


@pytest.mark.parametrize("n_real", [3, 6])
def test_rows_of_the_tail_never_change_the_fit(model_settings, n_real):
    static, hyper = model_settings()
    model, rows = start(static), linear_rows(0)
    tail = np.broadcast_to(np.arange(HORIZON)[:, None] >= n_real, (HORIZON, ROBOTS))
    args = i32(n_real), i32(2), jax.random.key(0)
    spoilt = replace_rows(rows, tail, 1)
    fallen = spoilt.replace(discount=jnp.where(tail, 0.0, 1.0), truncation=1.0 * tail)
    expected = fit(static)(hyper, model, rows, *args)
    assert_same_bits(fit(static)(hyper, model, spoilt, *args), expected)
    assert_same_bits(fit(static)(hyper, model, fallen, *args), expected)
    # the last real row does count
    spoilt = replace_rows(rows, np.roll(tail, -1, 0) & ~tail, 1, 1.0)
    other = fit(static)(hyper, model, spoilt, *args)
    assert not np.array_equal(other[0].targets.mean, expected[0].targets.mean)


def test_every_real_row_is_drawn_the_first_and_the_last_among_them(model_settings):
    static, hyper = model_settings(normalize=False)  # else rows also enter by the moments
    model, rows = start(static), linear_rows(0)
    args = i32(6), i32(4), jax.random.key(0)  # 192 rows, each drawn four times on average
    expected = fit(static)(hyper, model, rows, *args)[0].params
    for t in range(HORIZON):
        row = np.broadcast_to(np.arange(HORIZON)[:, None] == t, (HORIZON, ROBOTS))
        params = fit(static)(hyper, model, replace_rows(rows, row, 1, 1.0), *args)[0].params
        same = jax.tree.leaves(jax.tree.map(np.array_equal, params, expected))
        assert all(same) if t >= 6 else not any(same)


def test_a_longer_tail_in_the_buffer_gives_the_same_fit(model_settings):
    hyper = model_settings()[1]
    model, rows, results = start(model_settings()[0]), linear_rows(0), []
    for horizon in (8, 6):  # six real rows and two synthetic ones, or none; 64 rows a minibatch
        static, _ = model_settings(horizon, minibatches=horizon // 2)
        held = jax.tree.map(lambda x, n=horizon: x[:n], rows)
        results.append(fit(static)(hyper, model, held, i32(6), i32(3), jax.random.key(0)))
    for a, b in zip(*map(jax.tree.leaves, results), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", ["fall", "time limit"])
def test_rows_that_ended_an_episode_never_change_the_fit(model_settings, kind):
    static, hyper = model_settings()
    model, rows = start(static), linear_rows(0)
    ended = np.random.default_rng(2).random((HORIZON, ROBOTS)) < 0.2
    if kind == "fall":
        rows = rows.replace(discount=jnp.asarray(1.0 - ended, jnp.float32))
    else:
        rows = rows.replace(truncation=jnp.asarray(1.0 * ended, jnp.float32))
    args = i32(HORIZON), i32(2), jax.random.key(0)
    expected = fit(static)(hyper, model, rows, *args)
    assert_same_bits(fit(static)(hyper, model, replace_rows(rows, ended, 3), *args), expected)
    # the same garbage in rows of weight 1 does change it
    others = replace_rows(rows, ~ended, 3, 1.0)
    changed = fit(static)(hyper, model, others, *args)[0]
    assert not np.array_equal(changed.targets.mean, expected[0].targets.mean)


@pytest.mark.parametrize("garbage", [np.nan, np.inf, 1e30])
def test_no_number_of_a_row_of_weight_0_enters_however_wild(model_settings, garbage):
    static, hyper = model_settings()
    model, rows = start(static), linear_rows(0)
    ended = np.random.default_rng(2).random((HORIZON, ROBOTS)) < 0.2
    rows = rows.replace(discount=jnp.asarray(1.0 - ended, jnp.float32))
    blown = rows.replace(
        next_obs=jnp.where(ended[..., None], garbage, rows.next_obs),
        reward=jnp.where(ended, garbage, rows.reward),
    )
    args = i32(HORIZON), i32(2), jax.random.key(0)
    expected = fit(static)(hyper, model, rows, *args)
    assert_same_bits(fit(static)(hyper, model, blown, *args), expected)


def test_a_fit_without_any_valid_row_changes_no_number_by_the_rows(model_settings):
    static, hyper = model_settings()
    model, rows = start(static), linear_rows(0)
    model, _ = fit(static)(hyper, model, rows, i32(HORIZON), i32(2), jax.random.key(0))
    fallen = rows.replace(discount=jnp.zeros((HORIZON, ROBOTS)))
    after, _ = fit(static)(hyper, model, fallen, i32(HORIZON), i32(1), jax.random.key(1))
    assert_same_bits((after.inputs, after.targets), (model.inputs, model.targets))
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(after))


@pytest.mark.parametrize(("n_real", "epochs"), [(8, 3), (6, 3), (5, 2), (2, 1), (8, 0)])
def test_an_epoch_has_as_many_steps_as_whole_minibatches_of_real_rows(
    model_settings, n_real, epochs
):
    static, hyper = model_settings(minibatches=8)  # 256 / 8 = 32 rows a minibatch
    model, _ = fit(static)(
        hyper, start(static), linear_rows(0), i32(n_real), i32(epochs), jax.random.key(0)
    )
    assert int(model.opt_state.count) == epochs * (n_real * ROBOTS // 32)
    odd, hyper = model_settings(minibatches=2)  # 128 rows: 5 x 32 real rows hold one
    model, _ = fit(odd)(hyper, start(odd), linear_rows(0), i32(5), i32(2), jax.random.key(0))
    assert int(model.opt_state.count) == 2


def test_a_second_fit_goes_on_with_the_weights_and_adam_moments_of_the_first(model_settings):
    static, hyper = model_settings()
    rows, args = linear_rows(0), (i32(HORIZON), i32(2))
    first, _ = fit(static)(hyper, start(static), rows, *args, jax.random.key(0))
    second, _ = fit(static)(hyper, first, rows, *args, jax.random.key(1))
    assert int(second.opt_state.count) == 2 * int(first.opt_state.count) == 16
    cold = first.replace(opt_state=start(static).opt_state)
    forgetful, _ = fit(static)(hyper, cold, rows, *args, jax.random.key(1))
    kernels = [m.params["params"]["Dense_0"]["kernel"] for m in (second, forgetful)]
    assert not np.array_equal(*kernels)


def test_minibatches_depend_on_the_key(model_settings):
    static, hyper = model_settings()
    args = hyper, start(static), linear_rows(0), i32(HORIZON), i32(1)
    one, same, other = (fit(static)(*args, jax.random.key(k))[0] for k in (1, 1, 2))
    assert_same_bits(one, same)
    assert not np.array_equal(*(m.params["params"]["Dense_0"]["bias"] for m in (one, other)))


def test_one_program_serves_every_number_of_real_rows_epochs_and_learning_rate(model_settings):
    static, hyper = model_settings()

    @jax.jit
    @chex.assert_max_traces(1)
    def run(hyper, model, rows, n_real, epochs, key):
        return dynamics.fit(static, hyper, ENV, model, rows, n_real, epochs, key)

    model, rows = start(static), linear_rows(0)
    for n_real, epochs, rate in ((8, 1, 1e-3), (5, 2, 1e-3), (3, 1, 3e-3)):
        hyper = hyper._replace(learning_rate=rate)
        model, _ = run(hyper, model, rows, i32(n_real), i32(epochs), jax.random.key(0))


@pytest.mark.parametrize(
    ("precision", "expected"),
    [("highest", "HIGHEST"), ("tf32", "HIGH"), ("bfloat16", "DEFAULT")],
)
def test_fit_and_tail_compute_in_the_precision_of_the_setting(model_settings, precision, expected):
    static, hyper = model_settings(precision=precision)
    model, rows = start(static), linear_rows(0)
    args = i32(HORIZON), i32(1), jax.random.key(0)
    predict = jax.make_jaxpr(lambda m, r: dynamics.predict(static, ENV, m, r.obs, r.action))
    program = str(jax.make_jaxpr(fit(static))(hyper, model, rows, *args))
    for text in (str(predict(model, rows)), program):
        found = set(re.findall(r"Precision\.(\w+)", text))
        assert found <= {expected} and (found or expected == "DEFAULT")
        assert ("bf16[" in text) == (precision == "bfloat16")


# moments


def test_moments_are_the_weighted_average_of_each_calls_mean_and_variance(typed):
    rng, decay, calls = np.random.default_rng(0), 0.9, 5
    found, means, variances = moments.init(3), [], []
    for k in range(calls):
        x = 2.0 + k + rng.normal(size=(4, 6, 3)).astype(np.float32) * [1, 10, 0.1]
        weight = (rng.random((4, 6)) < 0.7).astype(np.float32)
        kept = [x[t, r] for t in range(4) for r in range(6) if weight[t, r] == 1]
        means.append(np.mean(kept, axis=0))
        variances.append(np.var(kept, axis=0))
        found = typed(moments.update)(
            found, jnp.asarray(x, jnp.float32), jnp.asarray(weight), decay
        )
        share = [decay ** (k - j) for j in range(k + 1)]  # of each call so far, the newest 1
        mean, std = typed(moments.scale)(found)
        np.testing.assert_allclose(mean, np.average(means, 0, share), rtol=1e-5)
        np.testing.assert_allclose(std**2, np.average(variances, 0, share), rtol=1e-4)
    np.testing.assert_allclose(found.weight, 1 - decay**calls, rtol=1e-5)


def test_a_call_without_valid_rows_leaves_the_moments_as_they_are():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6, 3)), jnp.float32)
    before = moments.update(moments.init(3), x, jnp.ones((4, 6)), 0.9)
    after = moments.update(before, 5 * x, jnp.zeros((4, 6)), 0.9)
    assert_same_bits(after, before)


def test_a_number_that_never_changes_is_scaled_by_1e_minus_4_and_not_by_0():
    found = moments.update(moments.init(2), jnp.full((4, 6, 2), 0.5), jnp.ones((4, 6)), 0.9)
    mean, std = moments.scale(found)
    np.testing.assert_allclose(mean, 0.5, rtol=1e-5)
    np.testing.assert_allclose(std, 1e-4, rtol=1e-5)


def test_without_normalisation_the_moments_do_not_matter(model_settings):
    static, _ = model_settings(normalize=False)
    model, rows = start(static), linear_rows(0)
    other = Moments(mean=jnp.full(OBS + ACTIONS, 3.0), var=jnp.ones(OBS + ACTIONS), weight=1.0)
    args = rows.obs[0], rows.action[0]
    expected = dynamics.predict(static, ENV, model, *args)
    assert_same_bits(dynamics.predict(static, ENV, model.replace(inputs=other), *args), expected)
    static, _ = model_settings(normalize=True)
    scaled = dynamics.predict(static, ENV, model.replace(inputs=other), *args)
    assert not np.array_equal(scaled[0], expected[0])


# prediction


def constant_model(static, output, mean, std):
    """A model whose network says `output` whatever it is asked; targets have this mean and std."""
    model = start(static)
    layers = dict(model.params["params"])
    layers["Dense_2"] = {
        "kernel": jnp.zeros_like(layers["Dense_2"]["kernel"]),
        "bias": jnp.asarray(output, jnp.float32),
    }
    targets = Moments(
        mean=0.5 * jnp.asarray(mean), var=0.5 * jnp.asarray(std) ** 2, weight=jnp.float32(0.5)
    )
    return model.replace(params={"params": layers}, targets=targets)


OUTPUT = np.array([1.0, -2.0, 0.5, 0.0, 3.0])
MEAN, STD = np.array([0.1, 0.2, 0.3, 0.4, -1.0]), np.array([2.0, 0.5, 1.0, 1.0, 4.0])


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("predict_change", [True, False])
def test_a_prediction_is_unscaled_added_to_the_state_and_the_reward_multiplied_by_dt(
    model_settings, typed, normalize, predict_change
):
    static, _ = model_settings(normalize=normalize, predict_change=predict_change)
    model, rows = constant_model(static, OUTPUT, MEAN, STD), linear_rows(0)
    obs, action = rows.obs[0], rows.action[0]
    next_obs, reward, discount = typed(dynamics.predict)(static, ENV, model, obs, action)
    # outputs 1, -2, 0.5, 0, 3: 2.1, -0.8, 0.8, 0.4 and 11 after scaling
    expected = np.array([2.1, -0.8, 0.8, 0.4, 11.0] if normalize else OUTPUT)
    before = np.asarray(obs[:, :PROP]) if predict_change else 0.0
    np.testing.assert_allclose(
        next_obs[:, :PROP], before + expected[:PROP] + 0 * obs[:, :PROP], rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(reward, np.full(ROBOTS, expected[PROP] * DT), rtol=1e-5)
    np.testing.assert_array_equal(next_obs[:, PROP:-ACTIONS], obs[:, PROP:-ACTIONS])
    np.testing.assert_array_equal(next_obs[:, -ACTIONS:], action)


def test_targets_are_the_change_of_state_or_the_next_state_and_the_reward_per_second(
    model_settings,
):
    rows = linear_rows(0)
    changes, nexts = (
        examples.targets(model_settings(predict_change=c)[0], ENV, rows) for c in (True, False)
    )
    assert changes.shape == nexts.shape == (HORIZON, ROBOTS, PROP + 1)
    np.testing.assert_array_equal(nexts[..., :PROP], rows.next_obs[..., :PROP])
    for k in range(PROP):
        np.testing.assert_array_equal(changes[..., k], rows.next_obs[..., k] - rows.obs[..., k])
    for y in (changes, nexts):
        np.testing.assert_allclose(y[..., PROP], rows.reward * 50, rtol=1e-6)  # dt = 1/50 s


def test_a_step_of_the_tail_carries_the_prediction_and_ends_no_episode(model_settings):
    static, _ = model_settings()
    model, rows = constant_model(static, OUTPUT, MEAN, STD), linear_rows(0)
    state = dynamics.TailState(obs=rows.obs[0], prop=rows.obs[0, :, :PROP])
    state, outcome = dynamics.step(static, ENV, model, state, rows.action[0])
    expected = dynamics.predict(static, ENV, model, rows.obs[0], rows.action[0])
    assert_same_bits((outcome.next_obs, outcome.reward, outcome.discount), expected)
    np.testing.assert_array_equal(state.obs, outcome.next_obs)
    np.testing.assert_array_equal(outcome.discount, 1)
    np.testing.assert_array_equal(outcome.truncation, 0)
    assert outcome.discount.shape == outcome.truncation.shape == (ROBOTS,)
    chex.assert_trees_all_equal_shapes_and_dtypes(outcome.discount, outcome.reward)


def test_an_untrained_model_has_moments_of_weight_0_and_no_step_behind_it(model_settings):
    model = start(model_settings()[0])
    assert float(model.inputs.weight) == float(model.targets.weight) == 0
    assert model.inputs.mean.shape == (OBS + ACTIONS,)
    assert model.targets.mean.shape == (PROP + 1,)
    assert int(model.opt_state.count) == 0


# --- the error of several steps ---


def test_the_error_of_several_steps_is_that_of_a_loop_over_robots(model_settings):
    """Robots that ended an episode on the way are left out of the number they had not reached."""
    static, hyper = model_settings()
    rows = linear_rows(5)
    model, _ = fit(static)(hyper, start(static), rows, i32(HORIZON), i32(3), jax.random.key(0))
    discount, truncation = np.array(rows.discount), np.array(rows.truncation)
    discount[0, 3] = discount[2, 4] = truncation[1, 5] = 1
    discount[0, 3] = discount[2, 4] = 0
    rows = rows.replace(discount=discount, truncation=truncation)
    found = errors.errors(static, ENV, model, jax.tree.map(jnp.asarray, rows), 4)
    assert found.keys() == {"model_error_1", "model_error_4"}
    std = np.array(moments.scale(model.inputs)[1])[:PROP]
    for steps, left_out in ((1, {3}), (4, {3, 4, 5})):
        wrong, still = 0.0, 0.0
        for i in sorted(set(range(ROBOTS)) - left_out):
            obs = rows.obs[0, i]
            for k in range(steps):
                obs = dynamics.predict(static, ENV, model, obs, rows.action[k, i])[0]
            truth = rows.next_obs[steps - 1, i, :PROP]
            wrong += (((obs[:PROP] - truth) / std) ** 2).sum()
            still += (((rows.obs[0, i, :PROP] - truth) / std) ** 2).sum()
        np.testing.assert_allclose(found[f"model_error_{steps}"], np.sqrt(wrong / still), 1e-4)


def test_a_perfect_model_has_error_0_and_one_that_repeats_the_state_1(model_settings):
    static, _ = model_settings()
    rows = jax.tree.map(jnp.asarray, linear_rows(6))
    repeats = constant_model(static, np.zeros(PROP + 1), np.zeros(PROP + 1), np.ones(PROP + 1))
    assert errors.errors(static, ENV, repeats, rows, 1)["model_error_1"] == pytest.approx(1)
    known = rows.replace(next_obs=rows.next_obs.at[0, :, :PROP].set(rows.obs[0, :, :PROP]))
    assert errors.errors(static, ENV, repeats, known, 1)["model_error_1"] == 0

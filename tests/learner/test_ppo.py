"""The PPO update against the numbers that rsl_rl's own code produced, and its invariants."""

import importlib.util
import pathlib
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import fast
from dynappo.learner import networks, ppo
from dynappo.types import Learner

HORIZON, ROBOTS, OBS, ACTIONS = 8, 32, 48, 12  # of the recorded rollouts
# our field of group ppo -> rsl_rl's name for it
FIELDS = {
    "clip_epsilon": "clip_param",
    "value_coef": "value_loss_coef",
    "entropy_coef": "entropy_coef",
    "learning_rate": "learning_rate",
    "max_grad_norm": "max_grad_norm",
    "desired_kl": "desired_kl",
}
# what the recording states otherwise, and what rsl_rl has no setting for
SETTINGS = {
    "hidden": (32, 32, 32),
    "activation": "elu",
    "precision": "highest",
    "epochs": 5,
    "minibatches": 4,
    "shuffle_blocks": 8,
    "clip_value": True,
    "adaptive": True,
    "min_learning_rate": 1e-5,
    "max_learning_rate": 1e-2,
    "min_std": 0.01,
}


@pytest.fixture(scope="module")
def ppo_settings(settings, peer):
    """`f(fields) -> (static, hyper)`: group ppo is that of the recorded updates, changed."""
    recorded = {ours: float(peer("update")[theirs]) for ours, theirs in FIELDS.items()}

    def make(**fields):
        fields = SETTINGS | recorded | fields
        sizes = {"rollout.num_envs": ROBOTS, "rollout.horizon": HORIZON}
        sizes |= {"schedule.end_iteration": 0, "schedule.end_steps": 0}
        return settings(sizes | {f"ppo.{k}": v for k, v in fields.items()})

    return make


@pytest.fixture(scope="module")
def step(ppo_settings):
    """`ppo.minibatch_step` compiled with the settings of the recorded updates."""
    return jax.jit(partial(ppo.minibatch_step, *ppo_settings()))


@pytest.fixture(scope="module")
def recorded(peer, from_torch, ppo_settings):
    """`f(name) -> (learner, batch, old_std)` as they were when rsl_rl's PPO.update was called."""

    init = jax.jit(partial(ppo.init, *ppo_settings(), OBS, ACTIONS))

    def make(name):
        z = peer(name)
        theirs = {"action_mean": "mean", "advantages": "advantage"}
        # no weight; NumPy's arrays, of which tests take parts without a program for each
        batch = ppo.Batch(**{k: z[theirs.get(k, k)] for k in ppo.Batch._fields[:7]})
        learner = init(jax.random.key(0))
        learner = learner.replace(params=jax.tree.map(jnp.asarray, from_torch(z)))
        return learner, batch, jnp.asarray(z["collect.std"])

    return make


@pytest.fixture(scope="module")
def small_batch():
    """A rollout [8, 32] with three observed numbers; obs[t, r, 0] is the number of the row."""
    rng = np.random.default_rng(0)
    shape = (HORIZON, ROBOTS)
    obs = rng.normal(size=(*shape, 3)).astype(np.float32)
    obs[..., 0] = np.arange(HORIZON * ROBOTS).reshape(shape)
    mean, noise = rng.normal(size=(2, *shape, 2)).astype(np.float32)
    scalars = rng.normal(size=(4, *shape)).astype(np.float32)
    names = ("log_prob", "value", "advantages", "returns")
    batch = ppo.Batch(
        obs=obs, action=mean + noise, action_mean=mean, **dict(zip(names, scalars, strict=True))
    )
    return jax.tree.map(jnp.asarray, batch)


def flat(batch):
    """`[N, R, ...]` as `[N R, ...]`, time first, as rsl_rl flattens it."""
    return jax.tree.map(lambda x: x.reshape(HORIZON * ROBOTS, *x.shape[2:]), batch)


def assert_trees_close(actual, expected, tolerance=1e-5):
    """The same structure, and every leaf equal to `tolerance`."""
    assert jax.tree.structure(actual) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)


# against rsl_rl


def test_losses_and_kl_are_those_of_rsl_rl(peer, recorded, ppo_settings):
    z, (learner, batch, old_std) = peer("update"), recorded("update")
    loss = jax.jit(partial(ppo.loss, *ppo_settings()))
    total, metrics = loss(learner.params, flat(batch), old_std)
    surrogate, value = float(z["step.surrogate"][0]), float(z["step.value_function"][0])
    assert float(metrics["surrogate_loss"]) == pytest.approx(surrogate, abs=1e-5)
    assert float(metrics["value_loss"]) == pytest.approx(value, rel=1e-5)
    assert float(metrics["kl"]) == pytest.approx(float(z["step.kl_mean"][0]), rel=1e-4)
    assert float(metrics["entropy"]) == pytest.approx(float(z["loss.entropy"]), rel=1e-5)
    expected = surrogate + float(z["value_loss_coef"]) * value
    expected -= float(z["entropy_coef"]) * float(z["loss.entropy"])
    assert float(total) == pytest.approx(expected, rel=1e-5)


def test_gradients_are_those_of_rsl_rl(peer, recorded, ppo_settings, from_torch):
    learner, batch, old_std = recorded("update")
    gradient = jax.jit(jax.grad(partial(ppo.loss, *ppo_settings()), has_aux=True))
    grads, _ = gradient(learner.params, flat(batch), old_std)
    assert_trees_close(grads, from_torch(peer("update"), "grad."))


def test_one_step_gives_the_learning_rate_and_parameters_of_rsl_rl(
    peer, recorded, step, from_torch
):
    z, (learner, batch, old_std) = peer("update"), recorded("update")
    after, _ = step(learner, flat(batch), old_std)
    np.testing.assert_allclose(after.learning_rate, z["step.learning_rate"][0], rtol=1e-6)
    assert after.learning_rate < learner.learning_rate  # else the rule was not exercised
    assert_trees_close(after.params, from_torch(z, "after."))


def test_twenty_steps_give_the_learning_rates_kls_and_parameters_of_rsl_rl(
    peer, recorded, step, from_torch
):
    z, (learner, batch, old_std) = peer("updates"), recorded("updates")
    order = z["permutation"].reshape(4, -1)
    rates, metrics = [], []
    for i in range(20):
        rows = jax.tree.map(lambda x, i=i: x[order[i % 4]], flat(batch))
        learner, m = step(learner, rows, old_std)
        rates.append(float(learner.learning_rate))
        metrics.append({k: float(v) for k, v in m.items()})
    assert len(set(z["step.learning_rate"])) > 3  # the rule was exercised
    np.testing.assert_allclose(rates, z["step.learning_rate"], rtol=1e-6)
    names = {"kl": "kl_mean", "surrogate_loss": "surrogate", "value_loss": "value_function"}
    for ours, theirs in names.items():
        actual = [m[ours] for m in metrics]
        np.testing.assert_allclose(actual, z[f"step.{theirs}"], rtol=1e-5, atol=1e-5)
    assert_trees_close(learner.params, from_torch(z, "after."))


def test_normalised_advantages_are_those_of_rsl_rl(peer):
    z = peer("gae")
    ours = ppo.normalize(z["advantage_raw"])
    np.testing.assert_allclose(ours, z["advantage"], rtol=1e-5, atol=1e-5)
    assert abs(float(ours.mean())) < 1e-5
    # the divisor is the sample standard deviation: n - 1, here 191 of 192
    assert float((ours**2).sum()) == pytest.approx(ours.size - 1, rel=1e-5)


def test_equal_advantages_normalise_to_zero_and_not_to_nan():
    np.testing.assert_array_equal(ppo.normalize(jnp.full((4, 4), 2.0)), 0)


def test_the_recorded_values_are_still_those_of_the_installed_rsl_rl(peer):
    for name in ("torch", "tensordict", "rsl_rl"):
        pytest.importorskip(name, exc_type=ImportError)
    path = pathlib.Path(__file__).parents[1] / "peers" / "rsl_rl_reference.py"
    spec = importlib.util.spec_from_file_location("rsl_rl_reference", path)
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    for stem, arrays in reference.generate().items():
        assert arrays.keys() == peer(stem).keys()
        for name, x in arrays.items():
            if name != "versions":
                message = f"{stem}.npz, {name}"
                np.testing.assert_allclose(
                    x, peer(stem)[name], rtol=1e-4, atol=1e-5, err_msg=message
                )


# the loss


@pytest.mark.parametrize("clip_value", [True, False])
def test_the_loss_is_the_mean_over_rows_of_the_larger_of_two_terms(
    recorded, ppo_settings, clip_value
):
    static, hyper = ppo_settings(clip_value=clip_value, clip_epsilon=0.1)
    learner, batch, old_std = recorded("update")
    batch = jax.tree.map(lambda x: x[:64], flat(batch))
    _, metrics = jax.jit(partial(ppo.loss, static, hyper))(learner.params, batch, old_std)
    mean = networks.policy(static, learner.params, batch.obs)
    value = np.float64(networks.value(static, learner.params, batch.obs))
    ratio = np.exp(
        np.float64(networks.log_prob(mean, learner.params["std"], batch.action) - batch.log_prob)
    )
    surrogate, errors, clipped = [], [], 0
    for i in range(64):
        advantage, old, goal = (float(x[i]) for x in (batch.advantages, batch.value, batch.returns))
        limited = sorted((0.9, ratio[i], 1.1))[1]
        surrogate.append(min(ratio[i] * advantage, limited * advantage))
        error = (value[i] - goal) ** 2
        if clip_value:
            near = old + sorted((-0.1, value[i] - old, 0.1))[1]
            clipped += (near - goal) ** 2 > error
            error = max(error, (near - goal) ** 2)
        errors.append(error)
    assert not clip_value or clipped > 3  # the clipped term decided somewhere
    assert float(metrics["surrogate_loss"]) == pytest.approx(-sum(surrogate) / 64, abs=1e-5)
    assert float(metrics["value_loss"]) == pytest.approx(sum(errors) / 64, rel=1e-5)


def test_a_ratio_beyond_the_clip_in_the_direction_of_the_advantage_has_no_gradient(
    recorded, ppo_settings
):
    static, hyper = ppo_settings(value_coef=0.0, entropy_coef=0.0)
    learner, batch, old_std = recorded("update")
    row = jax.tree.map(lambda x: x[:1], flat(batch))
    mean, std = networks.policy(static, learner.params, row.obs), learner.params["std"]
    log_prob = networks.log_prob(mean, std, row.action)

    gradient = jax.jit(partial(jax.grad(ppo.loss, argnums=2, has_aux=True), static, hyper))

    def largest(advantage, ratio):
        rows = row._replace(advantages=jnp.full(1, advantage), log_prob=log_prob - jnp.log(ratio))
        grads, _ = gradient(learner.params, rows, old_std)
        return max(float(jnp.abs(g).max()) for g in jax.tree.leaves(grads))

    assert largest(1.0, 1.5) == 0 and largest(-1.0, 0.5) == 0
    assert largest(1.0, 0.5) > 0 and largest(-1.0, 1.5) > 0 and largest(1.0, 1.1) > 0


# the learning rate


@pytest.mark.parametrize(
    ("rate", "kl", "expected"),
    [
        (1e-3, 0.021, 1e-3 / 1.5),  # above twice the goal of 0.01
        (1e-3, 10.0, 1e-3 / 1.5),
        (1e-3, 0.019, 1e-3),  # between half and twice
        (1e-3, 0.010, 1e-3),
        (1e-3, 0.0051, 1e-3),
        (1e-3, 0.0049, 1.5e-3),  # below half
        (1e-3, 1e-9, 1.5e-3),
        (1e-3, 0.0, 1e-3),  # exactly 0, and below: rsl_rl asks for more than 0
        (1e-3, -1e-6, 1e-3),
        (1.2e-5, 0.021, 1e-5),  # never below min_learning_rate
        (1e-5, 0.021, 1e-5),
        (8e-3, 0.001, 1e-2),  # never above max_learning_rate
        (1e-2, 0.001, 1e-2),
    ],
)
def test_the_learning_rate_follows_the_kl(ppo_settings, rate, kl, expected):
    static, hyper = ppo_settings()
    adapted = ppo.adapt(static, hyper, jnp.float32(rate), jnp.float32(kl))
    assert float(adapted) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("kl", [0.0, 0.001, 10.0])
def test_without_adaptive_the_learning_rate_stays(ppo_settings, kl):
    adapted = ppo.adapt(*ppo_settings(adaptive=False), jnp.float32(1e-3), jnp.float32(kl))
    assert float(adapted) == np.float32(1e-3)


# minibatches


@pytest.mark.parametrize("blocks", [1, 2, 8])
def test_minibatches_hold_every_row_exactly_once_and_equal_shares_of_every_block(
    ppo_settings, small_batch, blocks
):
    static, _ = ppo_settings(shuffle_blocks=blocks)
    small_batch = small_batch._replace(weight=small_batch.value + 1)
    out = jax.jit(partial(ppo.minibatches, static))(small_batch, jax.random.key(3))
    out = jax.device_get(out)
    assert out.value.shape == (4, HORIZON * ROBOTS // 4)
    row = np.asarray(out.obs[..., 0]).astype(int)
    np.testing.assert_array_equal(np.sort(row.reshape(-1)), np.arange(HORIZON * ROBOTS))
    assert (np.diff(row.reshape(-1)) != 1).mean() > 0.9  # it is shuffled
    # all fields of a row travel together
    given = {name: x for name, x in flat(small_batch)._asdict().items() if x is not None}
    assert given.keys() == set(ppo.Batch._fields) - {"critic_obs"}
    for name, x in given.items():
        np.testing.assert_array_equal(getattr(out, name), np.asarray(x)[row], err_msg=name)
    # part b of a minibatch holds rows of the robots of block b only
    block = row % ROBOTS // (ROBOTS // blocks)
    share = HORIZON * ROBOTS // 4 // blocks
    for minibatch in block:
        np.testing.assert_array_equal(minibatch, np.arange(blocks).repeat(share))


def test_blocks_are_permuted_differently_and_independently_of_the_number_of_blocks(
    ppo_settings, small_batch
):
    def place(blocks, robots):
        """(step, robot of the block) of the rows of each block, in their order."""
        static, _ = ppo_settings(shuffle_blocks=blocks)
        batch = jax.tree.map(lambda x: np.asarray(x)[:, :robots], small_batch)
        shuffled = jax.jit(partial(ppo.minibatches, static))(batch, jax.random.key(3))
        row = np.asarray(shuffled.obs)[..., 0].astype(int)
        step, robot = row // ROBOTS, row % ROBOTS % 8
        return (step * 8 + robot).reshape(4, blocks, -1).swapaxes(0, 1).reshape(blocks, -1)

    four = place(4, ROBOTS)
    assert len({tuple(block) for block in four}) == 4
    # as on a device that holds the first half of the robots
    np.testing.assert_array_equal(place(2, ROBOTS // 2), four[:2])


def test_minibatches_depend_on_the_key_alone(ppo_settings, small_batch):
    static, _ = ppo_settings()
    shuffle = jax.jit(partial(ppo.minibatches, static))
    shuffled = [np.asarray(shuffle(small_batch, jax.random.key(k)).obs) for k in (1, 1, 2)]
    np.testing.assert_array_equal(shuffled[0], shuffled[1])
    assert (shuffled[0][..., 0] != shuffled[2][..., 0]).mean() > 0.9


# the update


@pytest.mark.parametrize("module", [ppo, fast], ids=["plain", "fast"])
def test_an_update_is_its_epochs_of_steps_over_the_same_minibatches(
    recorded, step, peer, ppo_settings, module
):
    learner, batch, _ = recorded("updates")
    batch = batch._replace(advantages=3 * batch.advantages + 7)  # raw: update normalises them
    static, hyper = ppo_settings()
    key = jax.random.key(5)
    after, metrics = jax.jit(partial(module.update, static, hyper))(learner, batch, key)

    normal = batch._replace(advantages=(batch.advantages - 7) / 3)
    rows = ppo.minibatches(static, normal, key)
    old_std, by_hand, log = learner.params["std"], learner, []
    for i in range(20):
        by_hand, m = step(by_hand, jax.tree.map(lambda x, i=i: x[i % 4], rows), old_std)
        log.append(m)
    assert_trees_close(after.params, by_hand.params)
    assert float(metrics["learning_rate"]) == pytest.approx(float(by_hand.learning_rate), rel=1e-6)
    assert float(after.learning_rate) == float(metrics["learning_rate"])
    for name in ("kl", "surrogate_loss", "value_loss", "entropy"):
        mean = np.mean([float(m[name]) for m in log])
        assert float(metrics[name]) == pytest.approx(mean, rel=1e-4, abs=1e-5)


def test_the_optimiser_and_learning_rate_start_where_the_last_update_left_them(recorded, step):
    learner, batch, old_std = recorded("updates")
    first, _ = step(learner, flat(batch), old_std)
    second, _ = step(first, flat(batch), old_std)
    counts = [int(s.count) for s in (first.opt_state[1], second.opt_state[1])]
    assert counts == [1, 2]
    forgetful = second.replace(opt_state=learner.opt_state)
    third, fresh = (step(s, flat(batch), old_std)[0] for s in (second, forgetful))
    assert not (third.params["std"] == fresh.params["std"]).all()


@pytest.mark.parametrize(("min_std", "held"), [(0.5, True), (0.1, False)])
def test_no_std_falls_below_min_std(recorded, ppo_settings, min_std, held):
    # entropy_coef < 0 rewards a small std, and Adam's first step has the size of the learning rate
    static, hyper = ppo_settings(
        min_std=min_std,
        entropy_coef=-1.0,
        learning_rate=0.1,
        adaptive=False,
        epochs=1,
        minibatches=1,
    )
    learner, batch, old_std = recorded("updates")
    start = learner.params | {"std": jnp.full(ACTIONS, 0.55)}
    learner = learner.replace(params=start, learning_rate=jnp.float32(0.1))
    after, _ = jax.jit(partial(ppo.minibatch_step, static, hyper))(learner, flat(batch), old_std)
    other, _ = jax.jit(partial(fast.update, static, hyper))(learner, batch, jax.random.key(0))
    for std in (np.asarray(after.params["std"]), np.asarray(other.params["std"])):
        assert (std >= np.float32(min_std)).all()
        assert (std == np.float32(min_std)).any() == held
        assert (std < 0.5).any() != held


def test_a_fresh_learner_has_the_initial_std_learning_rate_and_float32_leaves(ppo_settings):
    static, hyper = ppo_settings(init_std=0.8, learning_rate=2e-3)
    learner = jax.jit(partial(ppo.init, static, hyper, OBS, ACTIONS))(jax.random.key(0))
    assert isinstance(learner, Learner)
    np.testing.assert_allclose(learner.params["std"], np.full(ACTIONS, 0.8), rtol=1e-6)
    assert float(learner.learning_rate) == np.float32(2e-3)
    assert {x.dtype.name for x in jax.tree.leaves(learner)} == {"float32", "int32"}


def test_with_squashed_actions_the_entropy_is_that_of_their_tanh(recorded, ppo_settings):
    """Of the rows' own noise; the rest of the loss stays, and both paths learn the same."""
    learner, batch, old_std = recorded("update")
    rows, (mean, _) = (
        flat(batch),
        networks.actor_critic(ppo_settings()[0], learner.params)(flat(batch).obs),
    )
    noise = (np.float64(rows.action) - rows.action_mean) / old_std
    tanh = np.tanh(mean + learner.params["std"] * noise)
    of_gaussian = 0.5 + 0.5 * np.log(2 * np.pi) + np.log(np.float64(learner.params["std"]))
    expected = (of_gaussian + np.log(1 - np.float64(tanh) ** 2)).sum(-1).mean()
    found = {}
    for squashed in (False, True):
        static, hyper = ppo_settings(squashed=squashed)
        found[squashed] = jax.jit(partial(ppo.loss, static, hyper))(learner.params, rows, old_std)
    (plain, before), (total, after) = found[False], found[True]
    assert float(after["entropy"]) == pytest.approx(expected, rel=1e-4)
    less = float(hyper.ppo.entropy_coef) * (expected - float(before["entropy"]))
    assert float(total) == pytest.approx(float(plain) - less, rel=1e-4)
    of = [jax.jit(partial(m.update, static, hyper)) for m in (ppo, fast)]
    ours, theirs = (update(learner, batch, jax.random.key(5))[0] for update in of)
    assert_trees_close(ours.params, theirs.params)


# weights of rows


def random_batch(seed):
    """A batch [HORIZON, ROBOTS] of random numbers that a policy of the toy could have made."""
    rng = np.random.default_rng(seed)
    sizes = dict(obs=(6,), action=(2,), action_mean=(2,))
    shapes = {name: (HORIZON, ROBOTS, *sizes.get(name, ())) for name in ppo.Batch._fields[:7]}
    numbers = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    numbers["log_prob"] = -2 + np.float32(0.1) * numbers["log_prob"]
    return ppo.Batch(**numbers)


@pytest.fixture(scope="module")
def toy():
    """`(static, hyper, learner, update(batch))` of a small learner."""
    _, static, hyper = toy_env.settings({"rollout.num_envs": ROBOTS})
    learner = jax.jit(partial(ppo.init, static, hyper, 6, 2))(jax.random.key(0))
    update = jax.jit(lambda batch: fast.update(static, hyper, learner, batch, jax.random.key(1)))
    return static, hyper, learner, update


def test_weights_of_1_are_no_weights(toy):
    """To rounding: the compiler may order a product's sum otherwise."""
    batch, update = random_batch(0), toy[-1]
    assert_trees_close(update(batch._replace(weight=jnp.ones((HORIZON, ROBOTS)))), update(batch))


def test_a_weight_is_a_share_of_a_row_in_every_mean(toy):
    """Weights 0 and 1: loss, KL, gradient and normalised advantages are those of the rows of weight
    1; weights 1 and 1/2: the mean over two copies of the first rows and one of the others."""
    static, hyper, learner, _ = toy
    batch, first = random_batch(0), np.arange(HORIZON)[:, None] < 5
    loss = jax.jit(jax.value_and_grad(partial(ppo.loss, static, hyper), has_aux=True))

    def ask(rows):
        rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), rows)
        return loss(learner.params, rows, 0.9 * learner.params["std"])

    zero = jnp.broadcast_to(1.0 * first, (HORIZON, ROBOTS))
    some = jax.tree.map(lambda x: x[:5], batch)
    twice = jax.tree.map(lambda x: np.concatenate([x, x[:5]]), batch)
    for weight, same in ((zero, some), (0.5 + 0.5 * zero, twice)):
        assert_trees_close(ask(batch._replace(weight=weight)), ask(same), 1e-4)
    normal = ppo.normalize(batch.advantages, zero)[:5]
    np.testing.assert_allclose(normal, ppo.normalize(some.advantages), 1e-4, 1e-5)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_of_a_row_of_weight_0_nothing_is_learned(toy, weight):
    """Other numbers in the tail: the same learner, unless its weight is 1."""
    tail = (np.arange(HORIZON) >= 5)[:, None]
    batch, update = random_batch(0), toy[-1]

    def spoil(x, y):
        return np.where(tail.reshape(HORIZON, 1, *[1] * (x.ndim - 2)), 10 * y, x)

    spoilt = jax.tree.map(spoil, batch, random_batch(1))
    weights = jnp.broadcast_to(jnp.where(tail, weight, 1.0), (HORIZON, ROBOTS))
    one, two = (update(b._replace(weight=weights)) for b in (batch, spoilt))
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    close = [np.allclose(x, y, 1e-4, 1e-6) for x, y in pairs]
    assert all(close) if weight == 0 else not any(close[:3])


# rows of weight 0


@pytest.fixture(scope="module")
def absent(recorded):
    """`(learner, batch, the same batch spoilt, old_std)`: a third of the rows have weight 0, and the spoilt
    batch has numbers there that overflow or are none; `batch` has others than recorded."""
    learner, batch, old_std = recorded("update")
    rng = np.random.default_rng(0)
    weight = rng.random((HORIZON, ROBOTS)) * (rng.random((HORIZON, ROBOTS)) > 0.3)
    bad = [np.nan, np.inf, -np.inf, 1e30, -200.0]  # exp(200) is infinite

    def spoil(x, numbers):
        there = weight.reshape(*weight.shape, *[1] * (x.ndim - 2)) > 0
        return np.where(there, x, numbers(x.shape).astype(np.float32))

    batches = [
        jax.tree.map(partial(spoil, numbers=numbers), batch)._replace(weight=np.float32(weight))
        for numbers in (lambda shape: rng.normal(size=shape), lambda shape: rng.choice(bad, shape))
    ]
    return learner, *batches, old_std


def assert_finite_and_same(found, expected):
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert np.isfinite(b).all()
        np.testing.assert_array_equal(a, b)


def test_means_are_of_rows_of_some_weight_whatever_the_others_hold(absent):
    """Against NumPy without these rows."""
    _, _, spoilt, _ = absent
    there = np.asarray(spoilt.weight) > 0
    raw, weight = (np.float64(x)[there] for x in (spoilt.advantages, spoilt.weight))
    mean = (raw * weight).sum() / weight.sum()
    std = np.sqrt((weight * (raw - mean) ** 2).sum() / (weight.sum() - 1))
    normal = np.asarray(ppo.normalize(spoilt.advantages, spoilt.weight))
    np.testing.assert_allclose(normal[there], (raw - mean) / std, 1e-4, 1e-5)
    found = ppo.mean(jnp.stack([flat(spoilt).advantages] * 2), flat(spoilt).weight)
    np.testing.assert_allclose(found, [mean, mean], 1e-4)


@pytest.mark.parametrize(
    "fields", [{}, {"clip_value": False}, {"squashed": True}], ids=["", "unclipped", "squashed"]
)
def test_rows_of_weight_0_have_no_say_in_loss_and_gradients(absent, ppo_settings, fields):
    """To the bit, whatever a tail or a record has led to there."""
    learner, batch, spoilt, old_std = absent
    gradient = jax.jit(jax.value_and_grad(partial(ppo.loss, *ppo_settings(**fields)), has_aux=True))
    spoilt = spoilt._replace(obs=batch.obs, action=batch.action, action_mean=batch.action_mean)
    found, expected = (gradient(learner.params, flat(b), old_std) for b in (spoilt, batch))
    assert_finite_and_same(found, expected)


@pytest.mark.parametrize("module", [ppo, fast], ids=["plain", "fast"])
@pytest.mark.parametrize("critic", ["obs", "state"])
def test_rows_of_weight_0_have_no_say_in_an_update(absent, ppo_settings, module, critic):
    """Whatever is in them: observations and actions too."""
    learner, *batches, _ = absent
    if critic == "state":
        batches = [b._replace(critic_obs=2 * b.obs) for b in batches]
    update = jax.jit(partial(module.update, *ppo_settings(critic=critic)))
    expected, found = (update(learner, b, jax.random.key(5)) for b in batches)
    assert_finite_and_same(found, expected)
    assert np.abs(found[0].params["std"] - learner.params["std"]).max() > 1e-4

"""What the loop calls against the plain functions: the same numbers, but for the order of sums."""

import functools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
import toy_model
from toy_runs import assert_close, assert_same

from dynappo import algorithm, fast, rollout
from dynappo.learner import networks, ppo, symmetry
from dynappo.model import dynamics
from dynappo.types import Mirror, Views

N, R = 8, 32
OBS = Mirror(np.array([0, 2, 1, 3, 5, 4]), np.array([-1.0, 1, 1, 1, -1, -1]))
ACTION = Mirror(np.array([1, 0]), np.array([1.0, 1]))


def settings(**fields):
    """`(static, hyper)` of the toy, with fields of group ppo set."""
    fields = {"hidden": (16, 12), "min_std": 1.001} | fields
    sizes = {"rollout.num_envs": R, "rollout.horizon": N}
    return toy_env.settings(sizes | {f"ppo.{name}": value for name, value in fields.items()})[1:]


def normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


# ---- networks


@pytest.mark.parametrize(
    ("hidden", "precision", "critic"),  # each pair of values once
    [
        pytest.param((24,), "highest", "obs", marks=pytest.mark.slow),
        pytest.param((24,), "bfloat16", "state", marks=pytest.mark.slow),
        ((32, 16, 8), "highest", "state"),
        ((32, 16, 8), "bfloat16", "obs"),
    ],
)
def test_both_networks_at_once_give_what_each_gives_alone(hidden, precision, critic):
    """Outputs for one row, a batch and a rollout, and gradients of both."""
    static, hyper = settings(hidden=hidden, precision=precision, critic=critic)
    same = critic == "obs"
    init = partial(networks.init_policy, static, hyper, 48, 12, critic_size=48 if same else 30)
    params = jax.jit(init)(jax.random.key(0))
    rollout_of = normal(0, 3, 5, 48), None if same else normal(1, 3, 5, 30)
    close = dict(rtol=2e-5, atol=1e-6) if precision == "highest" else dict(rtol=0.05, atol=0.01)

    def call(actor_critic, params, obs):
        return actor_critic(static, params)(*obs)

    def total(actor_critic, params):
        mean, value = call(actor_critic, params, rollout_of)
        return (mean**2).sum() + (value**3).sum()

    for at in ((0, 0), (0,), ()):
        obs = jax.tree.map(lambda x, at=at: x[at], rollout_of)
        apart, together = (
            jax.jit(partial(call, module.actor_critic))(params, obs) for module in (networks, fast)
        )
        for expected, found in zip(apart, together, strict=True):
            assert found.shape == expected.shape and found.dtype == expected.dtype
            np.testing.assert_allclose(found, expected, **close)
    if precision == "highest":
        expected, found = (
            jax.jit(jax.grad(partial(total, module.actor_critic)))(params)
            for module in (networks, fast)
        )
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, 1e-4, 1e-5), found, expected)


def joined(static, params, obs):
    """Whether the layers of both networks are one product."""
    text = str(jax.make_jaxpr(partial(fast.actor_critic(static, params)))(obs))
    return text.count("dot_general") < 2 * (len(static.ppo.hidden) + 1)


@pytest.mark.parametrize("critic_hidden", [None, (16, 12), (32, 12), (16, 12, 8)])
def test_networks_of_two_sizes_are_the_plain_ones(critic_hidden):
    """And those of one size, whoever says so, are joined."""
    static, hyper = settings(critic_hidden=critic_hidden)
    init = jax.jit(partial(networks.init_policy, static, hyper, 48, 12))
    params = init(jax.random.key(0))
    sizes = [len(layer["bias"]) for layer in params["critic"]["params"].values()]
    assert sizes == [*(critic_hidden or (16, 12)), 1]
    assert [len(x["bias"]) for x in params["actor"]["params"].values()] == [16, 12, 12]
    obs = normal(0, 5, 48)
    assert joined(static, params, obs) == (critic_hidden in (None, (16, 12)))
    both = [
        jax.jit(lambda params, m=module: m.actor_critic(static, params)(obs))(params)
        for module in (fast, networks)
    ]
    for found, expected in zip(*both, strict=True):
        np.testing.assert_allclose(found, expected, 2e-5, 1e-6)


# ---- the update of the policy


def updates(static, hyper, batch, env, critic_size=None):
    """`(learner before, plain result, fast result)` of two updates, one after the other."""
    image = symmetry.policy_image(static, env)
    init = partial(ppo.init, static, hyper, 6, 2, critic_size=critic_size, image=image)
    first, out = jax.jit(init)(jax.random.key(0)), []
    for module in (ppo, fast):

        @jax.jit
        def update(learner, key, module=module):
            return module.update(static, hyper, learner, batch, key, image)

        learner, _ = update(first, jax.random.key(0))
        out.append(update(learner, jax.random.key(1)))
    return first, *out


UPDATES = [  # fields of ppo, and whether rows have weights
    ({}, False),
    ({"critic": "state", "symmetry": True, "critic_hidden": (24, 8, 4)}, False),
    ({"clip_value": False, "adaptive": False, "activation": "tanh"}, True),
    ({"shuffle_blocks": 4, "hidden": (24,), "desired_kl": 0.002, "max_grad_norm": 0.1}, False),
]
OTHERS = [(fields, not weighted) for fields, weighted in UPDATES] + [
    (fields, weighted)
    for fields in ({"symmetry": True}, {"critic": "state", "symmetry": True})
    for weighted in (True, False)
]
SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in OTHERS]


@pytest.mark.parametrize(("fields", "weighted"), UPDATES + SLOW, ids=str)
def test_an_update_of_one_vector_is_the_update_of_all_weights(fields, weighted):
    """Networks, Adam's moments, learning rate and metrics, by every option of the plain one."""
    static, hyper = settings(**fields)
    state = fields.get("critic") == "state"
    mean = normal(2, N, R, 2)
    batch = ppo.Batch(
        obs=normal(0, N, R, 6),
        action=mean + normal(1, N, R, 2),
        action_mean=mean,
        log_prob=networks.log_prob(mean, jnp.ones(2), mean + normal(1, N, R, 2)),
        value=normal(3, N, R),
        advantages=normal(4, N, R),
        returns=normal(5, N, R),
        weight=abs(normal(6, N, R)) if weighted else None,
        critic_obs=normal(7, N, R, 6) if state else None,
    )
    views = Views(actor=np.arange(6), critic=np.arange(6), model=np.arange(6)) if state else None
    env = toy_env.make()._replace(mirror=(OBS, ACTION), views=views)
    first, (plain, expected), (quick, found) = updates(static, hyper, batch, env)
    assert_close(quick.params, plain.params, 2e-5)
    assert_close(quick.opt_state, plain.opt_state, 2e-5)
    np.testing.assert_allclose(quick.learning_rate, plain.learning_rate, 1e-6)
    assert_close(found, expected, 1e-4)
    assert jax.tree.structure(quick) == jax.tree.structure(plain) == jax.tree.structure(first)
    # it has moved, by every rule: all weights, the learning rate, the least std (they begin at 1)
    assert (plain.learning_rate != first.learning_rate) == static.ppo.adaptive
    assert np.min(plain.params["std"]) >= np.float32(1.001)
    moved = jax.tree.map(
        lambda a, b: np.abs(np.asarray(a) - b).max(), *jax.device_get((plain.params, first.params))
    )
    assert min(jax.tree.leaves(moved)) > 5e-5


# ---- the model


@functools.cache
def fits(static):
    """Both fits, compiled once for any number of rows and epochs."""
    return [jax.jit(partial(toy_model.fit_rows, module.fit, static)) for module in (dynamics, fast)]


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"falls": True, "clean": True},
        pytest.param({"normalize": False}, marks=pytest.mark.slow),
    ],
    ids=str,
)
@pytest.mark.parametrize(("n_real", "epochs"), [(8, 2), (5, 3), (3, 0)])
def test_a_fit_of_one_vector_is_the_fit_of_all_weights(fields, n_real, epochs):
    """Weights, Adam and moments after two fits, and the losses."""
    static, hyper = toy_model.settings(**fields)
    rows = toy_model.linear_rows(0).replace(valid=jnp.ones((N, toy_model.ROBOTS)))
    rows = rows.replace(discount=rows.discount.at[2, ::3].set(0.0))
    plain, quick = fits(static)
    one = other = toy_model.start(static)
    for i in range(2):
        args = rows, jnp.int32(n_real), jnp.int32(epochs), jax.random.key(i)
        one, expected = plain(hyper, one, *args)
        other, found = quick(hyper, other, *args)
    assert_close(other, one, 1e-5)
    assert_close(found, expected, 1e-4)
    assert np.isfinite(list(expected.values())).all() == (epochs > 0)


@pytest.mark.parametrize("precision", ["highest", "bfloat16"])
def test_a_step_of_rounded_weights_is_a_step(precision):
    """To the bit: they are rounded in each product anyway."""
    static, hyper = toy_model.settings(precision=precision)
    rows, model = toy_model.linear_rows(0), toy_model.start(static)
    state = dynamics.TailState(obs=rows.obs[0], prop=rows.obs[0, :, : toy_model.PROP])
    plain, quick = (
        jax.jit(
            lambda model, module=module: module.step(static, hyper, toy_model.ENV, model)(
                state, rows.action[0], None
            )
        )(model)
        for module in (dynamics, fast)
    )
    assert_same(quick, plain)


# ---- the rows of a rollout


@pytest.fixture(scope="module")
def writers():
    """`f(begin, end)` of the plain and the grouped way, compiled once for any rows."""
    static, hyper = settings()
    env, index = toy_env.make(episode_length=4), jnp.arange(R)
    keys = rollout.row_keys(jax.random.key(3), index)
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, keys(0))
    state = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, keys(1))
    empty = jax.tree.map(lambda x: x - 7.0, rollout.allocate(env, N, R))
    params = networks.init_policy(static, hyper, 6, 2, jax.random.key(0))

    def write(module, begin, end):
        return module.fill(
            empty,
            begin,
            end,
            state,
            keys,
            act=algorithm.policy(static, env, params),
            step=algorithm.physics_step(env, hyper, bodies),
            metrics=env.metrics,
        )

    return [jax.jit(partial(write, module)) for module in (rollout, fast)]


@pytest.mark.parametrize(("begin", "end"), [(0, N), (2, 5), (3, 3)])
def test_rows_written_in_groups_are_the_rows(begin, end, writers):
    """To the bit: every field, rows that were there before, the state and the sums."""
    plain, quick = (write(begin, end) for write in writers)
    assert_same(quick, plain)
    assert (np.asarray(plain[0].reward) != -7.0).sum() == (end - begin) * R

"""`ppo.normalize`: running moments against NumPy's of all rows, and a policy file that needs none of it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from answers import refused

from dynappo import algorithm, fast, schedule
from dynappo import config as config_lib
from dynappo.learner import networks, ppo, scaling, symmetry
from dynappo.policy import policy_file
from dynappo.types import Mirror

N, R, OBS, ACTIONS = 8, 16, 6, 2


def learner(on, critic="obs", seed=0):
    fields = {"rollout.num_envs": R, "rollout.horizon": N, "ppo.critic": critic}
    static, hyper = toy_env.settings(fields | {"ppo.normalize": on}, "ppo16")[1:]
    key, size = jax.random.key(seed), None if critic == "obs" else 5
    made = ppo.init(static, hyper, obs_size=OBS, action_size=ACTIONS, key=key, critic_size=size)
    return static, hyper, made


def rows(seed, size=OBS):
    draw = np.random.default_rng(seed)
    return (draw.normal(size=(N, R, size)) * np.arange(1, size + 1) + 3).astype(np.float32)


def grown(critic="obs"):
    """A learner that has seen two iterations, of which some rows do not count; and the rows that do."""
    static, hyper, made = learner(True, critic)
    seen = []
    for i in range(2):
        x, weight = rows(i), np.ones((N, R), np.float32)
        weight[5:] = 0  # of a tail
        weight[0, 3], x[0, 3] = 0, np.nan  # a blow-up
        other = x if critic == "obs" else x[..., :5]
        made = scaling.updated(made, {"actor": x, "critic": other}, weight)
        seen.append(x[weight > 0])
    return static, hyper, made, np.concatenate(seen)


def test_moments_are_those_of_all_real_rows():
    *_, made, seen = grown()
    of = made.params["inputs"]["actor"]
    assert of["count"] == len(seen)
    np.testing.assert_allclose(of["mean"], seen.mean(0), rtol=1e-4)
    np.testing.assert_allclose(of["m2"] / of["count"], seen.var(0), rtol=1e-4)
    scaled = scaling.scaled(made.params, "actor", seen)
    np.testing.assert_allclose(scaled.mean(0), 0, atol=1e-4)
    np.testing.assert_allclose(scaled.std(0), 1, atol=1e-4)


def test_before_any_row_nothing_is_scaled_and_without_it_nothing_is_there():
    static, _, made = learner(True)
    x = rows(0)
    np.testing.assert_array_equal(scaling.scaled(made.params, "actor", x), x)
    static, _, plain = learner(False)
    assert "inputs" not in plain.params
    np.testing.assert_array_equal(
        networks.policy(static, plain.params, x), networks.policy(static, made.params, x)
    )


@pytest.mark.parametrize("critic", ["obs", "state"])
def test_fast_networks_and_policy_files_see_the_same(critic):
    """One product for both networks; and NumPy on weights that have the scaling in them."""
    static, _, made, seen = grown(critic)
    x, other = seen, None if critic == "obs" else seen[:, :5]
    plain = networks.actor_critic(static, made.params)(x, other)
    for one, same in zip(plain, fast.actor_critic(static, made.params)(x, other), strict=True):
        np.testing.assert_allclose(one, same, atol=1e-5)
    alone = policy_file.scaled(jax.device_get(made.params))
    assert "inputs" not in alone and policy_file.MIN_STD == scaling.MIN_STD
    act = policy_file.actor(alone, static.ppo.activation)
    np.testing.assert_allclose(act(x), plain[0], atol=1e-5)


def test_no_update_changes_the_moments():
    """They get no gradient, so Adam leaves them where they are; the weights move."""
    static, hyper, made, _ = grown()
    draw = np.random.default_rng(5)
    batch = ppo.Batch(
        obs=jnp.asarray(rows(3)),
        action=jnp.asarray(draw.normal(size=(N, R, ACTIONS)), jnp.float32),
        action_mean=jnp.zeros((N, R, ACTIONS)),
        log_prob=jnp.zeros((N, R)) - 2,
        value=jnp.zeros((N, R)),
        advantages=jnp.asarray(draw.normal(size=(N, R)), jnp.float32),
        returns=jnp.ones((N, R)),
    )
    after, _ = jax.jit(lambda made: fast.update(static, hyper, made, batch, jax.random.key(0)))(
        made
    )
    for old, new in zip(
        jax.tree.leaves(made.params["inputs"]), jax.tree.leaves(after.params["inputs"]), strict=True
    ):
        np.testing.assert_array_equal(old, new)
    before = made.params["actor"]["params"]["Dense_0"]["kernel"]
    assert (after.params["actor"]["params"]["Dense_0"]["kernel"] != before).any()


def test_a_number_that_never_changes_is_no_nan():
    """Rounding would make its variance negative: of numbers drawn, about half."""
    *_, made = learner(True)
    x = np.ones((N, R, 1), np.float32) * np.random.default_rng(0).uniform(1, 20, OBS)
    seen = dict.fromkeys(("actor", "critic"), x.astype(np.float32))
    for _ in range(3):
        made = scaling.updated(made, seen, np.ones((N, R), np.float32))
        assert (made.params["inputs"]["actor"]["m2"] >= 0).all()
        assert bool(jnp.isfinite(scaling.scaled(made.params, "actor", x)).all())


def test_with_mirror_images_the_moments_are_their_own():
    """Those of all rows and of their images: what is scaled of an image is the image of what is scaled."""
    mirror = Mirror(np.array([1, 0, 2, 3, 5, 4]), np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0]))
    *_, made = learner(True)
    weight = np.ones((N, R), np.float32)
    weight[6:] = 0
    for i in range(2):
        seen, mirrors = (
            dict.fromkeys(("actor", "critic"), rows(i)),
            dict.fromkeys(("actor", "critic"), mirror),
        )
        made = scaling.updated(made, seen, weight, mirrors)
    x = np.concatenate([rows(i)[:6].reshape(-1, OBS) for i in range(2)])
    image = symmetry.vector(mirror, x)
    of = made.params["inputs"]["critic"]
    np.testing.assert_allclose(of["mean"], np.concatenate([x, image]).mean(0), atol=1e-3)
    one, other = (scaling.scaled(made.params, "actor", y) for y in (x, image))
    np.testing.assert_allclose(symmetry.vector(mirror, one), other, atol=1e-5)


def test_it_goes_with_no_other_scaling():
    config = config_lib.load("configs/go1.py:ppo16")
    config.ppo.update(normalize=True, scale_inputs=True)
    assert "ppo.scale_inputs is True, expected False" in refused(config_lib.validate, config)
    config.ppo.update(scale_inputs=False, symmetry=True)
    config_lib.validate(config)


@pytest.mark.parametrize("fields", [{}, {"ppo.symmetry": True}, {"rollout.imagined": 3}], ids=str)
def test_an_iteration_adds_its_real_rows_once_and_no_row_of_the_model(fields):
    """Two iterations with a tail, against NumPy's mean and variance over the rows that physics wrote, and
    over their mirror images where the policy is symmetric."""
    env = toy_env.make()
    flips = Mirror(np.arange(OBS), np.array([-1, 1, 1, -1, 1, 1]))
    swaps = Mirror(np.array([1, 0]), np.ones(ACTIONS))
    env = env._replace(mirror=(flips, swaps))
    config, static, hyper = toy_env.settings(
        toy_env.TAIL | {"ppo.normalize": True, "schedule.end_iteration": 1} | fields
    )
    state = jax.jit(functools.partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    iterate, collect = (
        jax.jit(functools.partial(f, env, static=static))
        for f in (algorithm.iterate, algorithm.collect)
    )
    seen = []
    for i in range(2):
        counts = {name: column[i] for name, column in schedule.columns(config).items()}
        assert counts["n_real"] < static.rollout.horizon
        key = jax.random.fold_in(state.key, counts["iteration"])
        key = jax.random.fold_in(key, algorithm.ROWS)
        rows, _, _ = collect(hyper, state, n_real=counts["n_real"], key=key)
        seen.append(np.asarray(rows.obs[: counts["n_real"]]).reshape(-1, OBS))
        if static.ppo.symmetry:
            seen.append(seen[-1] * flips.sign)
        state, _ = iterate(hyper, state, counts)
    seen, of = np.concatenate(seen), state.learner.params["inputs"]
    for network in ("actor", "critic"):
        assert of[network]["count"] == len(seen)
        np.testing.assert_allclose(of[network]["mean"], seen.mean(0), rtol=1e-4, atol=1e-5)
        variance = of[network]["m2"] / of[network]["count"]
        np.testing.assert_allclose(variance, seen.var(0), rtol=1e-4, atol=1e-5)

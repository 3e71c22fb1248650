"""Networks that are their own mirror image: the gradient of rows and mirrored rows, for that of the rows."""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from jax.flatten_util import ravel_pytree

from dynappo import fast
from dynappo.learner import networks, ppo, scaling, symmetry
from dynappo.types import Mirror

# of six observed numbers and three actions: pairs, one that turns round and one that stays
OBS = Mirror(np.array([1, 0, 2, 3, 5, 4]), np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0]))
ACTION = Mirror(np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0]))
MIRROR = OBS, ACTION
N, R = 8, 32


def mirrored(mirror, x):
    """The mirror image, one number after the other."""
    x = np.asarray(x)
    return np.stack([s * x[..., i] for i, s in zip(*mirror, strict=True)], -1)


@pytest.fixture(scope="module")
def settings():
    fields = {"ppo.hidden": (16, 12), "ppo.symmetry": True, "rollout.horizon": N}
    return toy_env.settings(fields | {"rollout.num_envs": R, "ppo.shuffle_blocks": 1})[1:]


@pytest.fixture(scope="module")
def image(settings):
    """`symmetry.policy_image` of these mirrors."""
    return symmetry.policy_image(settings[0], SimpleNamespace(mirror=MIRROR, views=None))


@pytest.fixture(scope="module")
def learner(settings, image):
    return jax.jit(partial(ppo.init, *settings, 6, 3, image=image))(jax.random.key(0))


@pytest.fixture(scope="module")
def batch(settings, learner):
    """A rollout [N, R] by another policy than the learner's."""
    draw = np.random.default_rng(0)
    obs, action = draw.normal(size=(N, R, 6)), draw.normal(size=(N, R, 3))
    mean, value = networks.actor_critic(settings[0], learner.params)(jnp.asarray(obs))
    mean = mean + 0.1 * draw.normal(size=mean.shape)
    log_prob = networks.log_prob(mean, 0.9, action)
    advantages, returns = draw.normal(size=(2, N, R))
    rows = ppo.Batch(obs, action, mean, log_prob, value, advantages, value + returns)
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)


def assert_symmetric(static, params):
    """By what the networks say of mirrored observations."""
    obs = np.random.default_rng(1).normal(size=(50, 6)).astype(np.float32)
    says = jax.jit(lambda params, obs: networks.actor_critic(static, params)(obs))
    mean, value = says(params, obs)
    other = says(params, np.float32(mirrored(OBS, obs)))
    np.testing.assert_allclose(other[0], mirrored(ACTION, mean), 1e-5, 1e-6)
    np.testing.assert_allclose(other[1], value, 1e-5, 1e-6)
    np.testing.assert_array_equal(params["std"], np.asarray(params["std"])[[1, 0, 2]])
    assert np.abs(mean).max() > 1e-2 and value.std() > 1e-3


@pytest.mark.parametrize("mirror", [OBS, ACTION], ids=["obs", "action"])
def test_a_mirror_is_its_own_inverse(mirror):
    x = np.random.default_rng(0).normal(size=(4, len(mirror.index)))
    once = symmetry.vector(mirror, jnp.asarray(x))
    np.testing.assert_allclose(once, mirrored(mirror, x), 1e-6)
    np.testing.assert_allclose(symmetry.vector(mirror, once), x, 1e-6)


def test_the_image_of_a_network_is_the_mirrored_network_of_mirrored_inputs(settings, image):
    static, hyper = settings
    init = jax.jit(partial(networks.init_policy, static, hyper, 6, 3))
    params = init(jax.random.key(3))
    obs = np.random.default_rng(1).normal(size=(50, 6)).astype(np.float32)
    says = jax.jit(lambda params, obs: networks.actor_critic(static, params)(obs))
    mean, value = says(params, np.float32(mirrored(OBS, obs)))
    found = says(jax.jit(image)(params), obs)
    np.testing.assert_allclose(found[0], mirrored(ACTION, mean), 1e-5, 1e-6)
    np.testing.assert_allclose(found[1], value, 1e-5, 1e-6)
    assert np.abs(found[0] - says(params, obs)[0]).max() > 0.05


def test_fresh_weights_are_symmetric_and_spread_as_before(settings, learner):
    static, hyper = settings
    assert_symmetric(static, learner.params)
    plain = jax.jit(partial(networks.init_policy, static, hyper, 6, 3))(jax.random.key(0))
    for name in ("actor", "critic"):
        kernel, before = (p[name]["params"]["Dense_1"]["kernel"] for p in (learner.params, plain))
        assert len(np.unique(kernel)) == kernel.size // 2
        np.testing.assert_array_equal(kernel[:8], before[:8])  # the half that is drawn


def test_the_gradient_is_that_of_the_rows_and_their_mirror_images(settings, image, learner, batch):
    """The independent way: twice the rows, every one also mirrored."""
    static, hyper = settings
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
    turned = rows._replace(
        obs=jnp.asarray(mirrored(OBS, rows.obs)),
        action=jnp.asarray(mirrored(ACTION, rows.action)),
        action_mean=jnp.asarray(mirrored(ACTION, rows.action_mean)),
    )
    both = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), rows, turned)
    grad = jax.jit(
        jax.grad(lambda p, rows: ppo.loss(static, hyper, p, rows, learner.params["std"])[0])
    )
    one, expected = grad(learner.params, rows), ravel_pytree(grad(learner.params, both))[0]
    vector = ravel_pytree(one)[0]
    found = ravel_pytree(symmetry.mean(one, image))[0]
    np.testing.assert_allclose(found, expected, 1e-4, 1e-6)
    assert np.abs(found - vector).max() > 1e-3  # without the image it is another one
    assert symmetry.mean(one, None) is one
    # as one vector: the same bits
    np.testing.assert_array_equal(fast.mean_with_image(learner.params, image)(vector), found)
    assert fast.mean_with_image(learner.params, None)(vector) is vector


@pytest.mark.parametrize("module", [ppo, fast], ids=["plain", "fast"])
def test_an_update_stays_symmetric_and_without_the_image_does_not(
    settings, image, learner, batch, module
):
    static, hyper = settings
    update = partial(module.update, static, hyper)
    given = learner, batch, jax.random.key(1)
    after, metrics = jax.jit(partial(update, image=image))(*given)
    assert metrics["kl"] > 1e-4
    assert_symmetric(static, after.params)
    for x, y in zip(
        jax.tree.leaves(after.params), jax.tree.leaves(image(after.params)), strict=True
    ):
        np.testing.assert_array_equal(x, y)  # to the bit: nothing drifts apart
    with pytest.raises(AssertionError):
        params = jax.jit(update)(*given)[0].params
        assert_symmetric(static, params)


def test_an_environment_without_a_mirror_image_is_refused_in_one_line(settings):
    with pytest.raises(ValueError, match="ppo.symmetry is True.* no mirror image"):
        symmetry.policy_image(settings[0], SimpleNamespace(mirror=None, views=None))


def test_a_policy_that_scales_its_inputs_is_symmetric_too(settings, image, batch):
    """`ppo.normalize`: moments of rows and images, which no update changes."""
    static, hyper = settings
    static = static._replace(ppo=static.ppo._replace(normalize=True))
    seen = dict.fromkeys(("actor", "critic"), 3 * batch.obs + jnp.arange(6.0))
    mirrors = dict.fromkeys(("actor", "critic"), OBS)

    @jax.jit
    def begun(key):
        learner = ppo.init(static, hyper, 6, 3, key, image=image)
        return scaling.updated(learner, seen, jnp.ones((N, R)), mirrors)

    learner = begun(jax.random.key(0))
    assert_symmetric(static, learner.params)
    update = partial(fast.update, static, hyper, batch=batch, key=jax.random.key(1), image=image)
    after, _ = jax.jit(update)(learner)
    assert_symmetric(static, after.params)
    np.testing.assert_array_equal(
        after.params["inputs"]["actor"]["mean"], learner.params["inputs"]["actor"]["mean"]
    )

"""The networks against rsl_rl's outputs, the Gaussian against numerical integrals."""

import functools
from functools import partial

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo import fast
from dynappo.learner import networks

OBS, ACTIONS = 48, 12


@pytest.fixture(scope="module")
def make(settings):
    """`make(fields, seed) -> (static, params)`: fresh networks under a config with fields of ppo set."""

    def fresh(fields=None, seed=0):
        fields = {"hidden": (32, 32, 32)} | (fields or {})
        static, hyper = settings({f"ppo.{name}": value for name, value in fields.items()})
        return static, compiled(static)(hyper, OBS, ACTIONS, jax.random.key(seed))

    @functools.cache
    def compiled(static):
        init = partial(networks.init_policy, static)
        return jax.jit(init, static_argnums=(1, 2))

    return fresh


def together(static, params, obs):
    """Both networks, as the loop computes them."""
    return fast.actor_critic(static, params)(obs)


def densities(mean, std, points=4001):
    """`(x, p)`: a fine grid around every mean and the normal density there, float64."""
    mean, std = np.float64(mean)[..., None], np.float64(std)[..., None]
    x = mean + np.linspace(-12, 12, points) * std
    return x, np.exp(-((x - mean) ** 2) / (2 * std**2)) / np.sqrt(2 * np.pi * std**2)


def test_mean_and_value_are_those_of_rsl_rls_networks(make, peer, typed, from_torch):
    static, z = make()[0], peer("update")
    params, obs = from_torch(z, "collect."), jnp.asarray(z["obs"])
    mean, value = networks.policy(static, params, obs), networks.value(static, params, obs)
    np.testing.assert_allclose(mean, z["mean"], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(value, z["value"], rtol=1e-5, atol=1e-6)
    assert mean.shape == (8, 32, ACTIONS) and value.shape == (8, 32)
    typed(networks.policy)(static, params, obs[0, 0])
    typed(networks.value)(static, params, obs)


def test_in_bfloat16_no_output_is_rounded_to_it(make):
    """Values near 5 would be multiples of 1 / 32."""
    static, params = make({"hidden": (64,), "precision": "bfloat16"})
    params["critic"]["params"]["Dense_1"]["bias"] += 5.0
    obs = jax.random.normal(jax.random.key(1), (200, OBS))
    outputs = [networks.policy(static, params, obs), networks.value(static, params, obs)]
    for out in (*outputs, *fast.actor_critic(static, params)(obs)):
        rounded = out.astype(jnp.bfloat16).astype(jnp.float32)
        assert (out != rounded).mean() > 0.9


def test_a_policy_that_feeds_on_its_last_action_stays_within_its_limit(make):
    """By its weights alone it would triple its action in every step."""
    static, params = make({"hidden": (2 * ACTIONS,), "activation": "relu"})
    one, shape = jnp.eye(ACTIONS), (OBS - ACTIONS, 2 * ACTIONS)
    first, last = params["actor"]["params"]["Dense_0"], params["actor"]["params"]["Dense_1"]
    first["kernel"] = jnp.concatenate([jnp.zeros(shape), jnp.concatenate([one, -one], 1)])
    last["kernel"] = 3 * jnp.concatenate([one, -one])
    first["bias"], last["bias"] = first["bias"] * 0, last["bias"] * 0
    action = jnp.linspace(-1, 1, ACTIONS)
    for k in range(40):
        obs = jnp.concatenate([jnp.zeros(OBS - ACTIONS), action])
        together = fast.actor_critic(static, params)(obs)[0]
        action = networks.policy(static, params, obs)
        np.testing.assert_array_equal(together, action)
        if k == 0:
            np.testing.assert_allclose(action, 3 * jnp.linspace(-1, 1, ACTIONS), rtol=1e-5)
    np.testing.assert_array_equal(jnp.abs(action), networks.MAX_MEAN)


def test_log_prob_entropy_and_kl_are_those_of_rsl_rl(peer, typed):
    z = {name: jnp.asarray(x) for name, x in peer("policy").items() if name != "versions"}
    log_prob = typed(networks.log_prob)(z["mean"], z["std"], z["action"])
    np.testing.assert_allclose(log_prob, z["log_prob"], rtol=1e-5)
    np.testing.assert_allclose(typed(networks.entropy)(z["std"]), z["entropy"], rtol=1e-5)
    kl = typed(networks.kl)(z["old_mean"], z["old_std"], z["mean"], z["std"])
    np.testing.assert_allclose(kl, z["kl"], rtol=1e-5)
    np.testing.assert_allclose(kl.mean(), z["kl_mean"], rtol=1e-5)


def test_log_prob_is_the_logarithm_of_the_product_of_normal_densities(peer):
    z = peer("policy")
    mean, std, action = (np.float64(z[name]) for name in ("mean", "std", "action"))
    for i in range(8):
        product = 1.0
        for j in range(ACTIONS):
            z_score = (action[i, j] - mean[i, j]) / std[i, j]
            product *= np.exp(-(z_score**2) / 2) / (np.sqrt(2 * np.pi) * std[i, j])
        ours = networks.log_prob(z["mean"][i], z["std"][i], z["action"][i])
        np.testing.assert_allclose(ours, np.log(product), rtol=1e-5)


def test_entropy_is_the_integral_of_minus_p_log_p(peer):
    z = peer("policy")
    x, p = densities(z["mean"][:4], z["std"][:4])
    integrand = -p * np.log(p)
    expected = (integrand.sum(-1) * (x[..., 1] - x[..., 0])).sum(-1)
    np.testing.assert_allclose(networks.entropy(z["std"][:4]), expected, rtol=1e-5)


def test_squashed_entropy_is_the_integral_of_minus_p_log_p_of_tanh():
    """Of one action y = tanh(x): p(y) = p(x) cosh(x)^2. It has a maximum over the std: 0.87 at mean 0."""
    x = np.linspace(-20, 20, 400_001)
    noise, found = np.random.default_rng(0).normal(size=(400_000, 1)), {}
    for mean, std in [(0.0, 0.3), (0.0, 0.87), (0.0, 3.0), (0.7, 0.7), (-1.5, 0.4)]:
        log_p = -(((x - mean) / std) ** 2) / 2 - np.log(np.sqrt(2 * np.pi) * std)
        expected = -np.sum(np.exp(log_p) * (log_p + 2 * np.log(np.cosh(x)))) * (x[1] - x[0])
        each = networks.squashed_entropy(jnp.float32([mean]), jnp.float32([std]), noise)
        found[mean, std] = each.mean()
        np.testing.assert_allclose(found[mean, std], expected, atol=0.01)
    assert found[0.0, 0.87] > max(found[0.0, 0.3], found[0.0, 3.0])


def test_kl_is_the_integral_of_p_log_p_over_q_from_old_to_new(peer):
    z = {name: x[:4] for name, x in peer("policy").items() if x.ndim == 2}
    x, p = densities(z["old_mean"], z["old_std"])
    mean, std = np.float64(z["mean"])[..., None], np.float64(z["std"])[..., None]
    log_q = -((x - mean) ** 2) / (2 * std**2) - np.log(std) - 0.5 * np.log(2 * np.pi)
    expected = (p * (np.log(p) - log_q) * (x[..., 1:2] - x[..., :1])).sum((-1, -2))
    ours = networks.kl(z["old_mean"], z["old_std"], z["mean"], z["std"])
    # rsl_rl's 1e-5 inside the logarithm adds about 1e-5 an action
    np.testing.assert_allclose(ours, expected, atol=5e-4, rtol=0)


def test_kl_of_a_distribution_from_itself_is_the_1e_minus_5_of_rsl_rl_per_action(peer):
    z = peer("policy")
    kl = networks.kl(z["mean"], z["std"], z["mean"], z["std"])
    np.testing.assert_allclose(kl, ACTIONS * 1e-5, rtol=0.05)


class Flax(nn.Module):
    """The same network of flax's layers."""

    sizes: tuple[int, ...]

    @nn.compact
    def __call__(self, x):
        for size in self.sizes[:-1]:
            x = nn.swish(nn.Dense(size)(x))
        return nn.Dense(self.sizes[-1])(x)


@pytest.mark.parametrize("shape", [(9,), (4, 9), (2, 3, 9)])
@pytest.mark.parametrize("sizes", [(7, 5, 3), (6, 2)])
def test_a_network_and_its_gradient_are_flaxs(sizes, shape):
    model, x = networks.MLP(sizes, "swish"), jax.random.normal(jax.random.key(1), shape)
    params = jax.jit(partial(networks.init, model, 9))(jax.random.key(0))

    def squares(apply):
        return jax.jit(jax.value_and_grad(lambda p: (apply(p, x) ** 2).sum()))(params)

    ours, flaxs = squares(partial(networks.apply, model)), squares(Flax(sizes).apply)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6), ours, flaxs)


def test_initial_weights_are_uniform_within_one_over_the_root_of_fan_in():
    sizes, fan_in = (200, 150, 6), (100, 200, 150)
    own = jax.jit(partial(networks.init, networks.MLP(sizes), 100))(jax.random.key(0))
    flax = jax.eval_shape(Flax(sizes).init, jax.random.key(0), jnp.zeros(100))
    assert jax.tree.structure(own) == jax.tree.structure(flax)
    params, drawn = own["params"], []
    for i, n in enumerate(fan_in):
        bound = n**-0.5
        for name, shape in (("kernel", (n, sizes[i])), ("bias", (sizes[i],))):
            x = np.asarray(params[f"Dense_{i}"][name])
            assert x.shape == shape and x.dtype == np.float32
            assert np.abs(x).max() <= bound
            if x.size >= 800:
                assert np.abs(x).max() > 0.98 * bound
                np.testing.assert_allclose(x.var(), bound**2 / 3, rtol=0.1)
                assert abs(x.mean()) < 0.1 * bound
                # the four quarters of the range are equally full
                counts = np.histogram(x, 4, (-bound, bound))[0] / x.size
                np.testing.assert_allclose(counts, 0.25, atol=0.05)
            assert np.unique(x).size > 0.9 * x.size
            drawn.append(x.ravel() / bound)
    # no number of the draw is in two arrays
    drawn = np.concatenate(drawn)
    assert np.unique(drawn.round(6)).size > 0.95 * drawn.size


def test_weights_depend_on_the_key_and_the_initial_std_is_the_one_asked_for(make):
    first, again, other = (make({"init_std": 0.7}, seed)[1] for seed in (0, 0, 1))
    for a, b, c in zip(*map(jax.tree.leaves, (first, again, other)), strict=True):
        assert (a == b).all()
        assert a.shape == (ACTIONS,) or not (a == c).any()
    np.testing.assert_allclose(first["std"], np.full(ACTIONS, 0.7, np.float32))


def test_actor_and_critic_share_no_weight(make):
    static, params = make()
    obs = jax.random.normal(jax.random.key(1), (3, OBS))
    hidden = [params[name]["params"]["Dense_0"]["kernel"] for name in ("actor", "critic")]
    assert not (hidden[0] == hidden[1]).any()
    outputs = [lambda p, f=f: f(static, p, obs).sum() for f in (networks.policy, networks.value)]
    of_policy, of_value = jax.device_get(
        jax.jit(lambda p: [jax.grad(f)(p) for f in outputs])(params)
    )
    assert not any(g.any() for g in jax.tree.leaves((of_policy["critic"], of_policy["std"])))
    assert not any(g.any() for g in jax.tree.leaves((of_value["actor"], of_value["std"])))
    assert all(g.any() for g in jax.tree.leaves((of_policy["actor"], of_value["critic"])))


@pytest.mark.parametrize("precision", ["highest", "tf32", "bfloat16"])
def test_every_precision_keeps_float32_parameters_and_output(precision):
    model = networks.MLP((32, 4), precision=precision)
    x = np.random.default_rng(0).normal(size=(64, 16)).astype(np.float32)
    params = jax.jit(partial(networks.init, model, 16))(jax.random.key(1))
    out = jax.jit(partial(networks.apply, model))(params, x)
    exact = jax.jit(partial(networks.apply, networks.MLP((32, 4))))(params, x)
    grads = jax.jit(jax.grad(lambda p: networks.apply(model, p, x).sum()))(params)
    assert {a.dtype for a in jax.tree.leaves((params, out, grads))} == {jnp.dtype("float32")}
    np.testing.assert_allclose(out, exact, atol=0.03)
    if precision == "bfloat16":
        assert jnp.abs(out - exact).max() > 1e-4  # it really is less precise


@pytest.mark.parametrize(
    ("setting", "expected"), [("highest", "HIGHEST"), ("tf32", "HIGH"), ("bfloat16", "DEFAULT")]
)
@pytest.mark.parametrize("network", [networks.policy, networks.value, together])
def test_every_matrix_product_has_the_precision_of_the_config(make, network, setting, expected):
    static, params = make({"hidden": (8,), "precision": setting})
    # a global default must not win over the setting
    with jax.default_matmul_precision("bfloat16" if setting == "highest" else "highest"):
        program = jax.make_jaxpr(lambda p, x: network(static, p, x))(params, jnp.zeros(OBS))
    products = [e for e in program.eqns if e.primitive.name == "dot_general"]
    assert len(products) == 2 + (network is together)
    assert {p.name for e in products for p in e.params["precision"]} == {expected}
    kind = "bfloat16" if setting == "bfloat16" else "float32"
    assert {v.aval.dtype.name for e in products for v in e.invars} == {kind}


@pytest.mark.parametrize("activation", ["elu", "relu", "tanh", "swish"])
def test_the_activation_stands_between_layers_and_not_after_the_last(activation):
    functions = {
        "elu": lambda x: x if x > 0 else np.expm1(x),
        "relu": lambda x: max(x, 0.0),
        "tanh": np.tanh,
        "swish": lambda x: x / (1 + np.exp(-x)),
    }
    model = networks.MLP((6, 3), activation)
    x = np.random.default_rng(0).normal(size=5).astype(np.float32)
    params = jax.device_get(jax.jit(partial(networks.init, model, 5))(jax.random.key(2)))
    h = [float(v) for v in x]
    for i in range(2):
        layer = jax.tree.map(np.float64, params["params"][f"Dense_{i}"])
        outputs = []
        for j in range(layer["bias"].size):
            total = layer["bias"][j] + sum(
                v * w for v, w in zip(h, layer["kernel"][:, j], strict=True)
            )
            outputs.append(functions[activation](total) if i == 0 else total)
        h = outputs
    assert min(h) < 0  # else relu after the last layer would pass
    np.testing.assert_allclose(networks.apply(model, params, x), h, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("count", [1, 3, networks.MAX_SLICES, networks.MAX_SLICES + 1])
def test_columns_are_those_asked_for_in_their_order(count):
    rng = np.random.default_rng(count)
    runs = [np.arange(start, start + rng.integers(1, 4)) for start in rng.permutation(count) * 5]
    numbers = np.concatenate(runs)
    x = rng.normal(size=(2, 3, 5 * count + 4)).astype(np.float32)
    found = networks.columns(jnp.asarray(x), numbers)
    np.testing.assert_array_equal(found, [[[row[i] for i in numbers] for row in y] for y in x])
    gathers = "gather" in str(jax.make_jaxpr(lambda x: networks.columns(x, numbers))(x))
    assert gathers == (count > networks.MAX_SLICES)

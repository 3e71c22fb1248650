"""Learning in other units is learning from inputs in these units: first layers, gradients and steps."""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import fast
from dynappo.learner import networks, ppo, units
from dynappo.tasks.velocity import observe, view
from dynappo.types import Views

N, R, OBS, ACTIONS = 8, 16, 6, 2
SCALE = np.array([1.0, 0.05, 0.25, 4.0, 1.0, 0.5], np.float32)
VIEWS = Views(actor=np.array([0, 1, 3, 5]), critic=np.arange(OBS), model=np.arange(OBS))


def settings(on, critic):
    fields = {"rollout.num_envs": R, "rollout.horizon": N, "ppo.critic": critic}
    fields |= {"ppo.max_grad_norm": 0.05, "ppo.scale_inputs": on}  # every gradient is clipped
    return toy_env.settings(fields, "ppo16")[1:]


def environment(views):
    return SimpleNamespace(input_scale=SCALE, views=views)


@pytest.mark.parametrize(
    ("module", "critic", "views"),
    [
        (fast, "obs", None),
        (ppo, "state", VIEWS),
        pytest.param(ppo, "obs", None, marks=pytest.mark.slow),
        pytest.param(fast, "state", VIEWS, marks=pytest.mark.slow),
    ],
)
def test_an_update_in_units_is_one_on_inputs_in_these_units(module, critic, views):
    """The plain update of networks that see s x, against that of networks that see x."""
    of_actor = np.arange(OBS) if views is None else views.actor
    of_critic = of_actor if critic == "obs" else np.arange(OBS)
    rng = np.random.default_rng(0)
    obs = jnp.asarray(rng.normal(size=(N, R, OBS)) / SCALE, jnp.float32)
    numbers = {
        k: jnp.asarray(rng.normal(size=(N, R)), jnp.float32)
        for k in "advantages returns value".split()
    }

    def learned(on):
        static, hyper = settings(on, critic)
        seen = obs if on else obs * SCALE
        own = units.policy_units(static, environment(views))
        sizes = len(of_actor), ACTIONS
        learner = ppo.init(
            static, hyper, *sizes, key=jax.random.key(0), critic_size=len(of_critic), units=own
        )
        mean = networks.policy(static, learner.params, seen[..., of_actor])
        action = mean + 0.3
        batch = ppo.Batch(
            obs=seen[..., of_actor],
            action=action,
            action_mean=mean,
            log_prob=networks.log_prob(mean, learner.params["std"], action),
            critic_obs=seen[..., of_critic] if critic == "state" else None,
            **numbers,
        )
        update = jax.jit(partial(module.update, static, hyper, units=own))
        return learner.params, update(learner, batch, jax.random.key(1))

    (before, (after, metrics)), (plain, (expected, same)) = learned(True), learned(False)
    for name, columns in (("actor", of_actor), ("critic", of_critic)):
        for one, other in ((before, plain), (after.params, expected.params)):
            found, own = one[name]["params"], other[name]["params"]
            kernel = found["Dense_0"]["kernel"] / SCALE[columns][:, None]
            np.testing.assert_allclose(kernel, own["Dense_0"]["kernel"], 1e-3, 2e-5)
            np.testing.assert_allclose(
                found["Dense_1"]["kernel"], own["Dense_1"]["kernel"], 1e-3, 2e-5
            )
        moved = (
            after.params[name]["params"]["Dense_0"]["kernel"]
            - before[name]["params"]["Dense_0"]["kernel"]
        )
        assert np.abs(moved).max() > 1e-3
    for name, value in same.items():
        np.testing.assert_allclose(metrics[name], value, 1e-3, 1e-5)


def test_without_the_option_there_are_no_units_and_without_a_scale_one_line():
    static, _ = settings(False, "obs")
    assert units.policy_units(static, environment(None)) is None
    static, _ = settings(True, "obs")
    with pytest.raises(ValueError, match="no input_scale"):
        units.policy_units(static, SimpleNamespace(input_scale=None, views=None))


def test_the_scale_of_an_observation_is_that_of_its_parts():
    """Of each step's readings, and 1 of a body's numbers."""
    layout = view.make("onboard", 3, 2, frozenset({"friction"}))
    scale, rows = view.scale(layout), observe.slices(2)
    assert scale.shape == (view.size(layout),) and (scale[-layout.body :] == 1).all()
    first = scale[: view.current_size(layout)]
    assert (first[rows["joint_velocity"]] == np.float32(0.05)).all()
    assert (first[rows["angular_velocity"]] == 0.25).all() and (first != 1).sum() == 2 + 3
    seen = len(view.reading(layout))
    before = scale[view.current_size(layout) : view.current_size(layout) + 2 * seen].reshape(
        2, seen
    )
    np.testing.assert_array_equal(before, [first[view.reading(layout)]] * 2)

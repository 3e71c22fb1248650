"""21_less/controls.py: what each control does otherwise."""

import functools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from result_files import script
from toy_runs import assert_close

from dynappo import algorithm, schedule
from dynappo.learner import networks
from dynappo.model import dynamics


def test_the_simulators_tail_is_what_physics_would_have_written():
    """The control `simulator`, from row 3 on, against rows that are all real; `last` starts there, too."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    key, n_real = jax.random.key(1), jnp.int32(3)
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    whole, _, _ = collect(hyper, state, n_real=jnp.int32(static.rollout.horizon), key=key)
    rows, robots, _ = collect(hyper, state, n_real=n_real, key=key)
    now = state.replace(env_state=robots)
    given = dict(rows=rows, n_real=n_real, start=None, key=key)
    imagine = jax.jit(partial(controls.simulated, env, static=static))
    assert_close(imagine(hyper, now, **given), whole, 1e-6)
    model = jax.jit(partial(controls.from_last, env, static=static))(hyper, now, **given)
    np.testing.assert_allclose(model.obs[3], whole.obs[3], atol=1e-6)
    assert abs(model.obs[4] - whole.obs[4]).max() > 1e-3
    with pytest.raises(SystemExit, match="expected one of last, simulator, ensemble"):
        controls.put_in("first")


def test_members_of_an_ensemble_write_a_row_each_and_the_most_doubtful_tails_end():
    """Of three equal models: the row of one, whoever writes it, and nobody is in doubt. Of three others: each
    robot's row is that of one of them, and those that end are the ones in whom they differ most."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    start = dynamics.tail(static, env, state.env_state)
    keys = jax.random.split(jax.random.key(1), len(start.obs))
    action = jax.random.normal(jax.random.key(2), (len(keys), env.action_size))

    def written(model, end=False):
        step = controls.by_members(end, static, hyper, env, model)
        return jax.jit(step)(start, action, keys)[1]

    models = controls.inits(static, env, jax.random.key(3))
    ones = [jax.tree.map(lambda x, k=k: x[k], models) for k in range(controls.MEMBERS)]
    alone = [dynamics.step(static, hyper, env, one)(start, action, keys)[1] for one in ones]
    same = written(jax.tree.map(lambda x: jnp.stack([x[0]] * len(x)), models))
    np.testing.assert_allclose(same.next_prop, alone[0].next_prop, atol=1e-6)
    props = np.stack([row.next_prop for row in alone])
    found = written(models, end=True)
    near = abs(props - np.asarray(found.next_prop)).max(-1).argmin(0)
    np.testing.assert_allclose(found.next_prop, props[near, np.arange(len(near))], atol=1e-6)
    assert len(keys) < 8 or len(set(near)) > 1
    (_, (_, scale)) = dynamics.scales(static, ones[0])
    doubt = (props.std(0) / np.asarray(scale)[: env.prop_size]).mean(-1)
    ends = np.asarray(found.truncation) == 1
    assert ends.any() and doubt[ends].min() >= doubt[~ends].max()


def test_real_rows_learn_nothing_from_a_tail_that_begins_elsewhere():
    """The control `real-again`, 5 real rows of 8: in a later round advantages and returns of real rows are
    those of a rollout that ends with them, and they weigh 1; in the first all is as shipped."""
    controls, env = script("21_less/controls"), toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL | {"schedule.rounds": 2})
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    rows, _, _ = collect(hyper, state, n_real=jnp.int32(8), key=jax.random.key(1))
    real = (jnp.arange(8) < 5)[:, None]
    rows = rows.replace(reward=jnp.where(real, rows.reward, 1e3))
    given = static, hyper, env, state.learner.params
    again, estimate = (
        jax.jit(partial(f, *given)) for f in (controls.of_the_first_round, algorithm.estimate)
    )
    later = again(rows=rows, real=real, of_round=jnp.int32(1))
    alone = estimate(rows=jax.tree.map(lambda x: x[:5], rows), real=real[:5])
    shipped = estimate(rows=rows, real=real, of_round=jnp.int32(1))
    for name in ("advantages", "returns"):
        np.testing.assert_allclose(getattr(later, name)[:5], getattr(alone, name), rtol=1e-5)
        np.testing.assert_array_equal(getattr(later, name)[5:], getattr(shipped, name)[5:])
    assert (abs(shipped.advantages[:5] - alone.advantages).max(0) > 10).any()
    assert (later.weight[:5] == 1).all() and (shipped.weight[:5] == 0).all()
    first = jnp.int32(0)
    one, other = (f(rows=rows, real=real, of_round=first) for f in (again, estimate))
    assert_close(one, other, 1e-6)


def test_three_updates_on_real_rows_are_as_if_the_policy_of_now_had_made_them(monkeypatch):
    """The control `thrice`: the schedule has three rounds and no other column changes; the first round is as
    shipped, a later one has the log_prob, mean and value of other weights, and advantages by that value."""
    controls, env = script("21_less/controls"), toy_env.make()
    config, static, hyper = toy_env.settings()
    shipped, estimate = schedule.columns(config), algorithm.estimate
    for module, function, instead in controls.CONTROLS["thrice"]:
        monkeypatch.setattr(module, function, instead)
    columns = schedule.columns(config)  # as `program` and `seeds` call it
    assert (columns.pop("rounds") == 3).all() and columns.keys() == shipped.keys()
    assert algorithm.estimate is controls.as_if_anew
    with pytest.raises(SystemExit, match="control=thrice has tails, expected schedule.end_steps=0"):
        schedule.columns(toy_env.settings(toy_env.TAIL)[0])
    assert all(np.array_equal(columns[name], shipped[name]) for name in columns)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    rows, _, _ = collect(hyper, state, n_real=jnp.int32(8), key=jax.random.key(1))
    other = jax.tree.map(lambda x: 1.1 * x, state.learner.params)
    real = jnp.ones((8, 1), bool)
    anew, estimate = (
        jax.jit(partial(f, static, hyper, env)) for f in (controls.as_if_anew, estimate)
    )
    first, plain = (f(params=other, rows=rows, real=real, of_round=0) for f in (anew, estimate))
    assert_close(first, plain, 1e-6)
    later = anew(params=other, rows=rows, real=real, of_round=2)
    obs, critic_obs = networks.inputs(static, env, rows.obs, rows.prop)
    mean, value = networks.policy(static, other, obs), networks.value(static, other, critic_obs)
    log_prob = networks.log_prob(mean, other["std"], rows.action)
    for name, expected in (("action_mean", mean), ("log_prob", log_prob), ("value", value)):
        np.testing.assert_allclose(getattr(later, name), expected, rtol=1e-4, atol=1e-4)
        assert not np.allclose(getattr(first, name), expected, rtol=1e-2)
    now = estimate(params=other, rows=rows.replace(value=value), real=real)
    np.testing.assert_allclose(later.advantages, now.advantages, rtol=1e-3, atol=1e-3)
    assert not np.allclose(later.advantages, first.advantages, rtol=1e-2)


def test_a_fit_that_stops_sees_its_own_robots_alone_and_moves_the_moments_once():
    """The control `stopping`: every eighth robot's rows decide, and no weight depends on remembered ones of
    theirs. The moments are those of one update by the other robots."""
    controls, env, rng = script("21_less/controls"), toy_env.make(), np.random.default_rng(0)
    fields = {"model.epochs": 10, "model.memory": 8, "model.remembered": 1, "model.minibatches": 4}
    _, static, hyper = toy_env.settings(toy_env.TAIL | fields)
    model = dynamics.init(static, env, jax.random.key(0))
    sizes = dynamics.examples.input_size(env), env.prop_size + 1 + static.model.falls

    def rows(n):
        x, y = (jnp.float32(rng.normal(2.0, 3.0, (n, 16, size))) for size in sizes)
        return dynamics.examples.Examples(x=x, y=y, weight=jnp.ones((n, 16)), count=jnp.int32(n))

    new, past, unseen = rows(8), rows(2), np.arange(16) % 8 == 0

    def fitted(past):
        draw = lambda key, n: past  # noqa: E731
        return controls.stopped(
            static, hyper, model, new, jnp.int32(10), jax.random.key(1), draw=draw
        )[0]

    fit = jax.jit(fitted)
    found = fit(past)
    far = past._replace(y=past.y + 100.0 * unseen[:, None])
    jax.tree.map(np.testing.assert_array_equal, fit(far), found)
    near = fit(past._replace(y=past.y + 1.0 * ~unseen[:, None])).params
    both = zip(*map(jax.tree.leaves, (near, found.params)), strict=True)
    assert any((a != b).any() for a, b in both)
    shown = np.asarray(new.x[:, ~unseen]).reshape(-1, sizes[0])
    mean, std = dynamics.moments.scale(found.inputs)
    np.testing.assert_allclose(mean, shown.mean(0), rtol=1e-4)
    np.testing.assert_allclose(std, shown.std(0), rtol=1e-4)
    once = 1 - float(hyper.model.stats_decay)
    np.testing.assert_allclose(found.inputs.weight, once, rtol=1e-5)


@functools.cache
def of_one_iteration(name):
    """`(std of the policy, metrics)` after an iteration on the toy environment, under a control or none."""
    env, fields = toy_env.make(), {"schedule.rounds": 2, "model.epochs": 5}
    config, static, hyper = toy_env.settings(toy_env.TAIL | fields)
    counts = {k: jnp.asarray(v[-1]) for k, v in schedule.columns(config).items()}
    with pytest.MonkeyPatch.context() as patch:
        for module, function, other in script("21_less/controls").CONTROLS.get(name, []):
            patch.setattr(module, function, other)
        state = algorithm.init(env, hyper, jax.random.key(0), static=static)
        iterate = jax.jit(partial(algorithm.iterate, env, static=static))
        state, metrics = iterate(hyper, state, counts)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(state.learner.params))
    return state.learner.params["std"], metrics


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ensemble-end", "stopping", "real-again"])
def test_an_iteration_under_a_control_learns_and_is_not_the_shipped_one(name):
    """Finite, and another policy."""
    std, metrics = of_one_iteration(name)
    assert np.isfinite(metrics["model_loss"]) and (std != of_one_iteration("")[0]).any()

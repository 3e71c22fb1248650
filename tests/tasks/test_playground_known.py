"""What a tail computes of a Playground task's reward and end, against the task's own step."""

import functools
import types as python_types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")

from dynappo.tasks.playground import (  # noqa: E402
    c_physics,
    env,
    known,
    loading,
    mirrored,
    parts,
)

SPOT = "SpotFlatTerrainJoystick"


pytestmark = pytest.mark.usefixtures("stand_ins")


@functools.cache
def task(name):
    return loading.load(name).task


LAYOUT = parts.layout


@functools.cache
def explored(name):
    return LAYOUT(task(name))


def made(name, monkeypatch):
    found = explored(name)
    monkeypatch.setattr(parts, "layout", lambda _: found)
    return env.make(task(name), random_clock=False, known_reward=True)


def const(of):
    return of.step.args[0]


def states(name, of, seed):
    """`(obs, action, next prop, context after, reward, ended)` of random states, by the task's own step."""
    layout, found = const(of).layout, const(of).known
    _, probed = explored(name)
    draw = np.random.default_rng(seed)
    before, after = (known._states(task(name).mj_model, layout.home, draw) for _ in range(2))
    action = draw.normal(size=(parts.PROBES, of.action_size)).astype(np.float32)
    asked = probed.ask(probed.raw, np.tanh(action), before, after, before, after)
    _, (exact, *_), reward, terms, ended = jax.device_get(asked)
    rest = np.sum([terms[name] for name in found.rest], axis=0)
    after = np.concatenate([exact, rest[:, None]], -1)[:, layout.source]
    vector = functools.partial(parts.vector, layout.names)
    start = np.asarray(jax.jit(jax.vmap(vector))(probed.raw))
    start = np.concatenate([start, np.zeros((len(start), 1))], -1)[:, layout.source]
    size = layout.prop_size
    return start, action, after[:, :size], after[:, size:], reward, ended


def test_reward_and_end_are_those_of_the_tasks_own_step(monkeypatch):
    """In random states, of which some are falls, and whose reward is often cut off at 0."""
    of = made(SPOT, monkeypatch)
    assert of.known_end is not None
    start, action, after, context, reward, ended = states(SPOT, of, seed=9)
    assert 20 < ended.sum() < 200 and 20 < (reward == 0).sum() < 230
    reward_of = jax.jit(jax.vmap(functools.partial(of.known_reward, None)))
    found = reward_of(start, action, after)
    np.testing.assert_allclose(found, reward, rtol=1e-4, atol=1e-5)
    ends = jax.jit(jax.vmap(functools.partial(of.known_end, None)))
    np.testing.assert_array_equal(ends(after, context), ended)
    # and it follows from what is given: without the rest, and upright, it is another
    other = after.copy()
    other[:, -1] -= 1.0
    wrong = reward_of(start, action, other)
    np.testing.assert_allclose(wrong, np.maximum(found - 0.02, 0), atol=1e-5)
    assert (np.abs(wrong - found) > 0.01).any()


def test_terms_that_read_contacts_or_what_is_not_predicted_are_left_to_the_model(monkeypatch):
    """Of Spot's: slip, height and time of a step, and the velocity in the world."""
    found = const(made(SPOT, monkeypatch)).known
    rest = [f"reward/{name}" for name in "feet_air_time feet_height feet_slip lin_vel_z".split()]
    assert list(found.rest) == rest and not set(found.rest) & set(found.terms)
    scales = task(SPOT)._config.reward_config.scales
    assert {f"reward/{name}" for name in scales} == {*found.rest, *found.terms}
    assert found.factor == pytest.approx(task(SPOT).dt)
    paid = known.find(task(SPOT), *explored(SPOT), fall_paid=True)
    assert paid is not None and set(found.terms) - set(paid.terms) == {known.FALL}


def test_the_rest_is_the_sum_of_the_terms_that_are_left():
    """As the last of what no observation tells."""
    of = task(SPOT)
    data = parts.with_fields(parts.template(of), parts.home(of))
    metrics = {"reward/a": jnp.array(0.5), "reward/b": jnp.array(-2.0), "reward/c": jnp.array(8.0)}
    out = python_types.SimpleNamespace(obs=jnp.zeros(3), info={}, data=data, metrics=metrics)
    plain = parts.after_step(of, out).unseen
    for rest, expected in ((("reward/b", "reward/c"), 6.0), ((), 0.0)):
        unseen = parts.after_step(of, out, rest).unseen
        np.testing.assert_array_equal(unseen, [*plain, expected])


@pytest.mark.slow
def test_a_step_carries_the_rest_and_a_tail_computes_its_reward(monkeypatch):
    """Rows of our step in C MuJoCo: the last of prop is the sum of the terms that are left."""
    of = made(SPOT, monkeypatch)

    def rows(key, actions):
        state, out = env.first(const(of), key), []
        for action in actions:
            before = jnp.concatenate([state.prop, state.obs[of.prop_size :]])
            state, outcome = of.step(None, None, state, action, key)
            out.append((before, action, outcome))
        return jax.tree.map(lambda *x: jnp.stack(x), *out)

    actions = 0.3 * np.random.default_rng(0).normal(size=(2, 12)).astype(np.float32)
    with c_physics.physics(task(SPOT)):
        before, action, outcome = jax.jit(jax.vmap(rows, (0, None)))(
            jax.random.split(jax.random.key(3), 2), actions
        )
    names = [env.column_name(name) for name in const(of).known.rest]
    rest = sum(outcome.metrics[name] for name in names)
    assert np.asarray(rest).any() and (np.asarray(outcome.reward) > 0).all()
    np.testing.assert_allclose(outcome.next_prop[..., -1], rest, atol=1e-5)
    reward = jax.vmap(jax.vmap(functools.partial(of.known_reward, None)))
    np.testing.assert_allclose(reward(before, action, outcome.next_prop), outcome.reward, atol=1e-4)


def test_noise_is_drawn_once_for_what_is_sensed_once(monkeypatch):
    """Spot's joints, and the same in its history; and x, y, z of each foot."""
    of = made(SPOT, monkeypatch)
    prop = jnp.zeros(of.prop_size)
    keys = jax.random.split(jax.random.key(0), 50)
    sensed = np.asarray(jax.jit(jax.vmap(lambda key: of.sense(None, prop, None, key)))(keys))
    joints, newest = sensed[:, 6:18], sensed[:, 18:30]
    np.testing.assert_allclose(joints, newest, atol=1e-6)
    assert np.unique(np.abs(joints)).size == joints.size
    noise = const(of).layout.noise
    feet = (sensed[:, 30:42] / noise[30:42]).reshape(50, 4, 3)
    np.testing.assert_allclose(feet, feet[..., :1] + 0 * feet, rtol=1e-5)
    loud = np.flatnonzero(noise)
    assert len(loud) == 42 and len(np.unique(const(of).layout.draw[loud])) == 6 + 12 + 4


def test_with_the_rest_all_other_numbers_are_where_they_were():
    """By the places of a layout, with numbers of its own for each."""
    layout, _ = explored(SPOT)
    more, size = parts.with_rest(layout), layout.prop_size
    raw = jnp.arange(len(layout.column) + 1.0)
    obs, prop = jax.jit(functools.partial(parts.pack, more))(raw, raw + 0.25)
    pack = jax.jit(functools.partial(parts.pack, layout))
    before, before_prop = pack(raw[:-1], raw[:-1] + 0.25)
    np.testing.assert_array_equal(np.delete(obs, size), before)
    np.testing.assert_array_equal(prop[:-1], before_prop)
    assert obs[size] == raw[-1] and prop[-1] == raw[-1]
    np.testing.assert_array_equal(prop - obs[: size + 1], 0.25 * (more.noise > 0))
    for name in ("actor", "critic"):
        one, other = getattr(layout.views, name), getattr(more.views, name)
        np.testing.assert_array_equal(before[one], obs[other])
    seen = set(np.asarray(obs)[more.views.model].tolist())
    assert seen == {*np.asarray(before)[layout.views.model].tolist(), float(raw[-1])}
    both = parts.unpack(more, obs, prop)
    np.testing.assert_array_equal(both[:-1], parts.unpack(layout, before, before_prop))
    index = np.arange(len(layout.source))
    index[[0, -1]] = index[[-1, 0]]
    sign = np.where(index == 3, -1.0, 1.0)
    mirror = mirrored.Mirror(index, sign)
    image, _ = mirrored.with_rest((mirror, mirror), more)
    image = np.asarray(image.sign * obs[image.index])
    np.testing.assert_array_equal(np.delete(image, size), sign * np.asarray(before)[index])
    assert image[size] == obs[size]


def test_a_reward_that_is_not_the_sum_of_its_terms_is_left_to_the_model():
    total = np.linspace(-1, 2, 50)
    assert known._factor(total, 0.02 * total, False) == pytest.approx(0.02)
    assert known._factor(total, np.maximum(0.02 * total, 0), True) == pytest.approx(0.02)
    assert known._factor(total, np.exp(total), False) is None
    assert known._factor(total, np.maximum(0.02 * total, 0), False) is None
    assert known._factor(-np.abs(total) - 1, 0 * total, True) is None


@pytest.mark.slow
def test_the_model_reads_the_control_that_a_task_adds_up():
    """All of it: how far it is beyond the motors' range says how many steps an action does not move them."""
    layout, probed = explored("Go1Handstand")
    one = jax.tree.map(np.zeros_like, probed.raw)
    ctrl = one._replace(ctrl=np.ones_like(one.ctrl))
    asked = np.asarray(jax.vmap(functools.partial(parts.vector, layout.names))(ctrl))
    asked = asked[0, layout.source] > 0
    assert layout.reads_ctrl and asked.sum() == asked[layout.views.model].sum() == 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "terms", "end"),
    [
        ("Go1JoystickFlatTerrain", 11, True),
        ("Go1Getup", 8, False),
        ("Go1Handstand", 10, False),
        ("G1JoystickFlatTerrain", 16, False),
        ("BerkeleyHumanoidJoystickFlatTerrain", 18, True),
        ("T1JoystickFlatTerrain", 20, True),
        ("Op3Joystick", 7, True),
        ("SpotJoystickGaitTracking", None, False),
    ],
)
def test_what_is_known_of_each_task(name, terms, end, monkeypatch):
    of = made(name, monkeypatch)
    found = const(of).known
    if terms is None:
        assert found is None and of.known_end is None
        return
    assert (len(found.terms), found.end) == (terms, end)
    start, action, after, _, reward, ended = states(name, of, seed=5)
    computed = jax.jit(jax.vmap(functools.partial(of.known_reward, None)))(start, action, after)
    if of.fall_reward is not None:
        computed += ended * of.fall_reward(None)
    np.testing.assert_allclose(computed, reward, rtol=1e-3, atol=1e-3 * np.ptp(reward))

"""A robot's own body: the ranges it is drawn from, and what of the model it changes."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mujoco import mjx

from dynappo import config
from dynappo.description import robot
from dynappo.physics import randomize
from dynappo.tasks.velocity import env

ROBOTS = 512
WIDE = dict(
    base_mass=(-1.0, 3.0),
    base_com=(0.05, 0.04, 0.01),
    friction=(0.4, 1.2),
    kp_scale=(0.8, 1.2),
    kd_scale=(0.5, 2.0),
)
NARROW = dict(
    base_mass=(0.0, 0.0),
    base_com=(0.0, 0.0, 0.0),
    friction=(0.8, 0.8),
    kp_scale=(1.0, 1.0),
    kd_scale=(1.0, 1.0),
)
# of real robots: None in a body unless they are varied
NOMINAL = dict(
    strength=(1.0, 1.0),
    armature=(1.0, 1.0),
    joint_friction=(0.0, 0.0),
    delay=(0.0, 0.0),
    lag=(0.0, 0.0),
    encoder_bias=0.0,
    imu_tilt=0.0,
)
REAL = dict(
    strength=(0.8, 1.2),
    armature=(0.5, 2.0),
    joint_friction=(0.1, 0.3),
    delay=(0.01, 0.04),
    lag=(0.005, 0.02),
    encoder_bias=0.02,
    imu_tilt=0.03,
)
MODEL_FIELDS = dict(
    base_mass={".body_mass", ".body_inertia"},
    base_com={".body_ipos"},
    friction={".geom_friction"},
    kp_scale=set(),
    kd_scale=set(),
)


@pytest.fixture(scope="module")
def go1():
    return robot.load("go1")


@pytest.fixture(scope="module")
def model(go1):
    return mjx.put_model(go1.mj_model, impl="jax")


def ranges(base, **changes):
    return SimpleNamespace(**(NOMINAL | base | changes))


def base_of(go1):
    return go1.mj_model.body_mass[go1.base_body], go1.mj_model.body_ipos[go1.base_body]


def draw(go1, bounds, count=ROBOTS):
    mass, com = base_of(go1)
    keys = jax.random.split(jax.random.key(0), count)
    one = lambda key: randomize.draw(bounds, mass, jnp.asarray(com), key)  # noqa: E731
    return jax.jit(jax.vmap(one))(keys)


@pytest.fixture(scope="module")
def drawn(go1):
    return jax.tree.map(np.asarray, draw(go1, ranges(WIDE)))


def fills(values, low, high):
    """Within [low, high], reaching both ends, with the mean of a uniform distribution."""
    assert values.min() >= low - 1e-6 and values.max() <= high + 1e-6
    width = high - low
    assert values.min() < low + 0.03 * width and values.max() > high - 0.03 * width
    # the mean of n uniform numbers has a deviation of width / sqrt(12 n)
    assert abs(values.mean() - (low + high) / 2) < 4 * width / np.sqrt(12 * values.size)


def test_the_mass_scale_is_one_plus_the_added_mass_over_the_base_mass(go1, drawn):
    mass, _ = base_of(go1)
    assert drawn.mass_scale.shape == (ROBOTS,)
    fills((drawn.mass_scale - 1) * mass, -1.0, 3.0)


def test_the_centre_of_mass_is_drawn_about_the_robots_own_within_each_half_width(go1, drawn):
    offset = drawn.base_com - base_of(go1)[1]
    for axis, half in enumerate(WIDE["base_com"]):
        fills(offset[:, axis], -half, half)


@pytest.mark.parametrize("field", ["friction", "kp_scale", "kd_scale"])
def test_friction_and_gains_are_drawn_uniformly_within_their_range(drawn, field):
    fills(getattr(drawn, field), *WIDE[field])


def test_the_parts_of_a_body_are_drawn_independently_of_one_another(drawn):
    columns = [*drawn.base_com.T, drawn.mass_scale, drawn.friction, drawn.kp_scale, drawn.kd_scale]
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 5 / np.sqrt(ROBOTS)


def test_collapsed_ranges_draw_the_nominal_robot(go1):
    found = draw(go1, ranges(NARROW), count=4)
    np.testing.assert_array_equal(found.mass_scale, 1.0)
    np.testing.assert_allclose(found.base_com, np.tile(base_of(go1)[1], (4, 1)), rtol=1e-6)
    np.testing.assert_allclose(found.friction, 0.8, rtol=1e-6)
    np.testing.assert_array_equal(found.kp_scale, 1.0)
    np.testing.assert_array_equal(found.kd_scale, 1.0)


def test_the_same_key_draws_the_same_robot_and_another_key_another(go1):
    mass, com = base_of(go1)
    first, again, other = (
        randomize.draw(ranges(WIDE), mass, jnp.asarray(com), jax.random.key(k)) for k in (1, 1, 2)
    )
    for a, b, c in zip(*map(jax.tree.leaves, (first, again, other)), strict=True):
        assert (a == b).all() and (a != c).all()


def test_ranges_count_as_varied_unless_collapsed_to_the_value_of_the_file():
    assert randomize.varied(ranges(NARROW)) == frozenset()
    assert randomize.varied(ranges(WIDE)) == set(WIDE)
    for name, bounds in WIDE.items():
        assert randomize.varied(ranges(NARROW, **{name: bounds})) == {name}
    assert randomize.varied(ranges(NARROW, base_com=(0.0, 0.0, 0.01))) == {"base_com"}
    assert randomize.varied(ranges(NARROW, friction=(0.5, 0.5))) == {"friction"}
    assert randomize.varied(ranges(NARROW, base_mass=(2.0, 2.0))) == {"base_mass"}


@pytest.mark.parametrize("name", REAL)
def test_what_a_real_robot_has_is_drawn_where_its_range_says_so_and_changes_no_other_draw(
    go1, name
):
    mass, com = base_of(go1)
    bounds = ranges(WIDE, **{name: REAL[name]})
    varied = randomize.varied(bounds)
    assert varied == set(WIDE) | {name}
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    bodies = jax.vmap(lambda k: randomize.draw(bounds, mass, jnp.asarray(com), k, varied, 12))(keys)
    width = REAL[name]
    fills(
        np.asarray(getattr(bodies, name)), *(width if isinstance(width, tuple) else (-width, width))
    )
    others = bodies.replace(**{name: None})
    for x, y in zip(jax.tree.leaves(others), jax.tree.leaves(draw(go1, ranges(WIDE))), strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_body_as_a_network_sees_it_is_scaled_and_in_the_order_of_its_traits(go1):
    mass, com = base_of(go1)
    bounds = ranges(WIDE, **REAL)
    varied = randomize.varied(bounds)
    body = randomize.draw(bounds, mass, jnp.asarray(com), jax.random.key(1), varied, 12)
    told = np.asarray(randomize.numbers(body, com, varied))
    assert told.shape == (sum(randomize.size_of(name, 12) for name in randomize.traits(varied)),)
    assert np.abs(told).max() < 5  # a network sees numbers of about one
    np.testing.assert_allclose(told[0], 4 * (body.mass_scale - 1), rtol=1e-5)
    np.testing.assert_allclose(told[1:4], 20 * (body.base_com - com), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(told[-15:-3], 20 * body.encoder_bias, rtol=1e-5)
    np.testing.assert_allclose(told[-3:], 20 * body.imu_tilt, rtol=1e-5)


def by_path(model):
    return {jax.tree_util.keystr(p): leaf for p, leaf in jax.tree_util.tree_leaves_with_path(model)}


def one_robot(go1):
    return jax.tree.map(lambda x: x[0], draw(go1, ranges(WIDE), count=1))


@pytest.mark.parametrize("name", WIDE)
def test_collapsed_ranges_leave_the_models_fields_the_very_same_objects(go1, model, name):
    merged = randomize.merge(model, one_robot(go1), go1.base_body, go1.feet, frozenset({name}))
    before, after = by_path(model), by_path(merged)
    assert before.keys() == after.keys()
    changed = {path for path in before if after[path] is not before[path]}
    assert changed == MODEL_FIELDS[name]


def test_with_nothing_varied_the_model_is_the_very_same_object(go1, model):
    merged = randomize.merge(model, one_robot(go1), go1.base_body, go1.feet, frozenset())
    assert merged is model


def test_a_body_is_set_at_the_base_and_the_feet_only(go1, model):
    """Mass and inertia of the base scale together; of friction the sliding part is the feet's own."""
    body, nominal = one_robot(go1), go1.mj_model
    merged = randomize.merge(model, body, go1.base_body, go1.feet, frozenset(WIDE))
    scale = np.ones(model.nbody)
    scale[go1.base_body] = body.mass_scale
    assert abs(body.mass_scale - 1) > 0.01
    com, friction = nominal.body_ipos.copy(), nominal.geom_friction.copy()
    com[go1.base_body], friction[go1.feet, 0] = body.base_com, body.friction
    for name, expected in dict(
        body_mass=nominal.body_mass * scale,
        body_inertia=nominal.body_inertia * scale[:, None],
        body_ipos=com,
        geom_friction=friction,
    ).items():
        np.testing.assert_allclose(getattr(merged, name), expected, rtol=1e-6, err_msg=name)


@pytest.mark.parametrize("names", [(), ("base_mass",), ("base_com", "friction"), tuple(WIDE)])
def test_under_vmap_only_the_varied_fields_get_a_batch(go1, model, names):
    """`out_axes=None` is an error for a batched value, so each field's axis is proved."""
    bodies = draw(go1, ranges(WIDE), count=3)
    batched = set().union(*(MODEL_FIELDS[name] for name in names))
    axes = {path: 0 if path in batched else None for path in by_path(model)}

    def merge(body):
        return by_path(randomize.merge(model, body, go1.base_body, go1.feet, frozenset(names)))

    merged = jax.vmap(merge, out_axes=axes)(bodies)
    for path, value in by_path(model).items():
        expected = (3, *value.shape) if path in batched else value.shape
        assert merged[path].shape == expected, path
    if "base_mass" in names:
        assert len(set(np.asarray(merged[".body_mass"][:, go1.base_body]))) == 3


def test_the_environment_draws_about_the_robots_own_base(go1):
    settings = config.validate(config.load("go1.py"))
    made = env.make(go1, settings.task, settings.physics)
    hyper = config.split(settings)[1]
    found = jax.vmap(made.randomize, (None, 0))(hyper, jax.random.split(jax.random.key(3), 64))
    added = (np.asarray(found.mass_scale) - 1) * base_of(go1)[0]
    assert (-1 <= added).all() and (added <= 3).all() and np.ptp(added) > 3
    np.testing.assert_allclose(found.base_com, np.tile(base_of(go1)[1], (64, 1)), rtol=1e-6)


@pytest.mark.parametrize(("name", "bounds"), [("base_mass", (2.0, 2.0)), ("friction", (0.4, 0.4))])
def test_a_range_collapsed_to_another_value_still_changes_the_model(go1, model, name, bounds):
    one_value = ranges(NARROW, **{name: bounds})
    mass, com = base_of(go1)
    body = randomize.draw(one_value, mass, jnp.asarray(com), jax.random.key(0))
    merged = randomize.merge(model, body, go1.base_body, go1.feet, randomize.varied(one_value))
    before, after = by_path(model), by_path(merged)
    changed = {p for p in before if not np.allclose(before[p], after[p])}
    assert changed == MODEL_FIELDS[name]

"""Heights, normals and nearest points of a height map, against MuJoCo's height field of the same numbers."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.physics import ground as ground_lib
from dynappo.terrain import height_map
from dynappo.terrain.height_map import HeightMap

RADIUS, POINTS = 0.023, 300  # m
HEIGHTS = np.random.default_rng(0).uniform(0.1, 0.4, (7, 9)).astype(np.float32)
GROUND = HeightMap(HEIGHTS, 0.1, (-0.3, -0.5))


@pytest.fixture(scope="module")
def model():
    """The ground, and a ball."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    body = spec.worldbody.add_body(name="ball")
    body.add_freejoint()
    body.add_geom(size=[RADIUS, 0, 0], contype=0, conaffinity=1)
    ground_lib.put(spec, GROUND)
    made = spec.compile()
    made.opt.ccd_tolerance = 1e-12
    return made


@pytest.fixture(scope="module")
def places():
    rng = np.random.default_rng(1)
    return rng.uniform(-0.29, 0.29, POINTS), rng.uniform(-0.49, 0.29, POINTS)


def test_heights_and_normals_are_those_that_rays_meet(model, places):
    data, ids = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    z, n = height_map.height(*GROUND, *places), height_map.normal(*GROUND, *places)
    for x, y, height, up in zip(*places, z, n, strict=True):
        start, down, found = np.array([x, y, 5.0]), np.array([0, 0, -1.0]), np.zeros(3)
        far = mujoco.mj_ray(model, data, start, down, None, 1, 1, ids, found)
        assert 5 - far == pytest.approx(height, abs=1e-6)
        np.testing.assert_allclose(found, up, atol=1e-5)


def test_mujocos_ground_goes_on_beyond_the_edge_of_the_map(model):
    """As far as a robot on the map reaches; one with a border, as tiles have it, gets no more."""
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    x, y = (
        mid + rng.uniform(-1.9 - half, 1.9 + half, 200) for mid, half in ((0, 0.3), (-0.1, 0.4))
    )
    mujoco.mj_forward(model, data)
    for *place, height in zip(x, y, height_map.height(*GROUND, x, y), strict=True):
        start, down, ids = np.array([*place, 5.0]), np.array([0, 0, -1.0]), np.zeros(1, np.int32)
        far = mujoco.mj_ray(model, data, start, down, None, 1, 1, ids, None)
        assert 5 - far == pytest.approx(height, abs=1e-6)
    tiles = config_lib.load("go2:rough").task.tiles
    tiles.update(rows=1, columns=1)
    for border, more in ((2.0, 0), (0.0, 80)):
        tiles.border = border
        spec, made = mujoco.MjSpec(), ground_lib.of_tiles(tiles)
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
        ground_lib.put(spec, made)
        found = spec.compile()
        assert (found.hfield_ncol[0], found.hfield_nrow[0]) == tuple(
            n + more for n in made.heights.shape
        )
        end = -(4 + border + more * tiles.cell / 2)
        assert found.geom_pos[0, 0] - found.hfield_size[0, 0] == pytest.approx(end)


def test_the_nearest_point_is_mujocos_deepest_contact(model, places):
    """Of a ball on slopes, edges and corners, its centre above the ground."""
    data, rng, several = mujoco.MjData(model), np.random.default_rng(2), 0
    z, n = height_map.height(*GROUND, *places), height_map.normal(*GROUND, *places)
    points = np.stack([*places, z], -1) + n * rng.uniform(0.012, 0.024, (POINTS, 1))
    distance, normal = height_map.nearest(*GROUND, points, np.float64(RADIUS))
    above = points[:, 2] > height_map.height(*GROUND, points[:, 0], points[:, 1]) + 0.01
    above &= (abs(points[:, 0]) < 0.3) & (abs(points[:, 1] + 0.1) < 0.4)  # and on the map
    assert above.mean() > 0.8
    for point, d, up in zip(points[above], distance[above], normal[above], strict=True):
        data.qpos[:3] = point
        mujoco.mj_forward(model, data)
        several += data.ncon > 1
        if not data.ncon:
            assert d > RADIUS - 1e-6
            continue
        deepest = data.contact[int(np.argmin(data.contact.dist))]
        assert d - RADIUS == pytest.approx(deepest.dist, abs=1e-6)
        if (data.contact.dist < deepest.dist + 1e-5).sum() == 1:  # else one of two as near
            np.testing.assert_allclose(deepest.frame[:3], up, atol=1e-4)
    assert several > POINTS / 2


def test_under_the_ground_the_distance_is_negative_and_the_way_out_the_nearest(places):
    z = height_map.height(*GROUND, *places)
    points = np.stack([*places, z - 0.02], -1)
    distance, normal = height_map.nearest(*GROUND, points, np.float64(0.03))
    assert (distance < 0).all() and (distance > -0.02 - 1e-9).all()
    out = points - normal * (distance - 1e-7)[:, None]
    np.testing.assert_allclose(out[:, 2], height_map.height(*GROUND, *out[:, :2].T), atol=1e-5)


def test_outside_the_height_is_that_of_the_nearest_edge(places):
    x, y = 5 * places[0], 5 * places[1]
    at = np.clip(x, -0.3, 0.3), np.clip(y, -0.5, 0.3)
    found = height_map.height(*GROUND, x, y)
    np.testing.assert_allclose(found, height_map.height(*GROUND, *at), atol=1e-9)
    corner = height_map.normal(*GROUND, np.array([9.0]), np.array([-9.0]))
    np.testing.assert_allclose(corner, [[0, 0, 1]])


def test_on_a_flat_map_all_are_the_height_itself(places):
    flat = GROUND._replace(heights=np.full((7, 9), 0.2, np.float32))
    points = np.stack([*places, 0.3 + 0 * places[0]], -1)
    distance, normal = height_map.nearest(*flat, points, np.float64(RADIUS))
    np.testing.assert_allclose(distance, 0.1, atol=1e-7)
    np.testing.assert_allclose(normal, np.tile([0, 0, 1], (POINTS, 1)), atol=1e-7)
    np.testing.assert_allclose(height_map.gap(*flat, points, RADIUS), 0.1 - RADIUS, atol=1e-7)


def test_jax_finds_the_same(places):
    z = height_map.height(*GROUND, *places)
    points = np.stack([*places, z + 0.015], -1)
    radius = np.float32(RADIUS)

    @jax.jit
    def all_of(p):
        x, y = p[:, 0], p[:, 1]
        near = height_map.nearest(*GROUND, p, radius)
        height = height_map.height(*GROUND, x, y)
        return *near, height, height_map.normal(*GROUND, x, y), height_map.gap(*GROUND, p, 0.01)

    given = np.float32(points).astype(float)
    x, y = given[:, :2].T
    expected = *height_map.nearest(*GROUND, given, radius), height_map.height(*GROUND, x, y)
    expected = *expected, height_map.normal(*GROUND, x, y), height_map.gap(*GROUND, given, 0.01)
    for one, other in zip(all_of(jnp.asarray(points, jnp.float32)), expected, strict=True):
        off = np.abs(one - other).reshape(POINTS, -1).max(1)
        assert np.quantile(off, 0.98) < 1e-5  # the rest are at an edge, and of its other triangle

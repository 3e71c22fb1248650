"""Rough ground on the live page: its triangles and lines, its end, and that little of it is sent."""

import numpy as np
import pytest
from toy_policy import described

from dynappo.policy import episode, policy_file, policy_source
from dynappo.terrain import height_map
from dynappo.terrain.height_map import HeightMap
from dynappo.terrain.tiles import KINDS
from dynappo.web import ground_mesh, policies
from dynappo.web import live as live_lib

POLICY = policy_file.describe(*described())._replace(mjcf="")
OFFER = policies.Offer("go1", None, None, False, "pit_stairs:1")


def tile(text):
    return policy_source.ground(POLICY, text)


def height(points, faces, x, y):
    """Heights of triangles above points, by a loop over all triangles."""
    found = np.full(len(x), np.nan)
    for a, b, c in points[faces].astype(float):
        side = np.linalg.inv(np.stack([b - a, c - a])[:, :2].T)
        s, t = side @ np.stack([x - a[0], y - a[1]])
        inside = (s >= -1e-6) & (t >= -1e-6) & (s + t <= 1 + 1e-6)
        found[inside] = (a[2] + s * (b - a)[2] + t * (c - a)[2])[inside]
    return found


TWISTED = HeightMap(np.multiply.outer(np.arange(7), np.arange(9)).astype("f4") / 9, 0.2, (-1, 3))
FLAT = HeightMap(np.full((5, 4), 0.3, np.float32), 0.1, (0.0, 0.0))
GROUNDS = {kind: tile(f"{kind}:0.7") for kind in KINDS} | {"twisted": TWISTED, "flat": FLAT}


@pytest.mark.parametrize("name", GROUNDS)
def test_what_is_drawn_is_the_map_itself(name):
    field = GROUNDS[name]
    points, faces = ground_mesh.triangles(field)
    size = field.cell * (np.array(field.heights.shape) - 1)
    middle, half = field.corner + size / 2, np.minimum(size / 2, 4.2)
    x, y = np.random.default_rng(0).uniform(middle - half, middle + half, (300, 2)).T
    expected = height_map.height(*field, x, y)
    np.testing.assert_allclose(height(points, faces, x, y), expected, atol=2e-4)
    a, b, c = points[faces].swapaxes(0, 1)
    up = np.cross(b - a, c - a)[:, 2]
    assert (up > 0).all(), "seen from above"
    assert up.sum() / 2 == pytest.approx(size.prod(), rel=1e-4)


def test_a_flat_ground_is_two_triangles_and_stairs_are_few():
    assert len(ground_mesh.triangles(FLAT)[1]) == 2
    points, faces = ground_mesh.triangles(tile("pit_stairs:1"))
    assert len(points) < 1000 and len(faces) < 2000  # of 103,041 and 204,800


@pytest.mark.parametrize("name", GROUNDS)
def test_lines_lie_on_the_ground(name):
    field = GROUNDS[name]
    lines = ground_mesh.lines(field).astype(float)
    at = lines[:, :1] + (lines[:, 1:] - lines[:, :1]) * np.linspace(0, 1, 9)[:, None]
    off = at[..., 2] - height_map.height(*field, at[..., 0], at[..., 1])
    # what is beside a wall by less than a float's rounding is not on it
    assert (abs(off) < 2e-3).mean() > 0.99 or name == "twisted"
    whole = np.floor(field.cell * (np.array(field.heights.shape) - 1) + 1)
    assert len(lines) >= whole.min()


def test_stairs_have_lines_at_the_edges_of_their_walls():
    """Each wall is a ring around the middle, with an edge above it and one below it."""
    field = tile("pit_stairs:1")
    edges = ground_mesh._edges(field)
    levels = np.unique(field.heights)
    along_x = edges[abs(edges[:, :, 1]).max(1) < 1e-6]  # none is along x through the middle
    assert not len(along_x)
    assert np.unique(edges[..., 2]) == pytest.approx(levels)
    ahead = edges[(edges[:, 0, 0] == edges[:, 1, 0]) & (edges[:, 0, 0] > 0)]
    assert len(np.unique(ahead[:, 0, 0])) == 2 * (len(levels) - 1)
    assert not len(ground_mesh._edges(tile("pit_slope:1")))


def test_no_more_than_the_middle_of_a_large_map_is_taken():
    heights = np.random.default_rng(0).normal(size=(601, 90)).astype(np.float32)
    large = HeightMap(heights, 0.1, (-30.0, -4.45))
    near = ground_mesh.near(large)
    assert near.heights.shape == (401, 90) and near.corner == pytest.approx((-20.0, -4.45))
    x, y = np.random.default_rng(1).uniform([-20, -4], [20, 4], (50, 2)).T
    np.testing.assert_allclose(
        height_map.height(*near, x, y), height_map.height(*large, x, y), atol=1e-9
    )


def standing(field):
    player = policy_source.player(POLICY, field=field)[0]
    return live_lib.Live(player, lambda obs: np.zeros(12))


def put(live, x):
    live.data.qpos[0] = x
    live_lib.step(live)


def test_at_the_end_of_the_map_it_begins_again_in_the_middle():
    live = standing(HeightMap(np.zeros((61, 41), np.float32), 0.1, (-3.0, -2.0)))
    live.stands_up = False  # of falls alone
    put(live, 2.4)
    put(live, 2.4)
    assert live.data.qpos[0] == pytest.approx(2.4, abs=0.05)
    put(live, -2.6)
    assert abs(live.data.qpos[0]) < 0.05 and live.t == pytest.approx(0.02)
    live.data.qpos[1] = 1.6
    live_lib.step(live)
    assert abs(live.data.qpos[1]) < 0.05
    tiny = standing(HeightMap(np.zeros((4, 4), np.float32), 0.1, (-0.15, -0.15)))
    assert tiny.data.qpos[2] > 0.2  # it does not begin again for ever
    endless = standing(None)
    put(endless, 50.0)
    assert endless.data.qpos[0] > 49


def test_another_ground_is_another_robot():
    server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed")
    one, same, other, flat = (
        policies.load(OFFER._replace(ground=text), "go1").player
        for text in ("boxes:1", "boxes:1", "boxes:0.9", None)
    )
    assert server.same_robot(one, same) and server.same_robot(flat, flat)
    for a, b in ((one, other), (one, flat), (flat, one)):
        assert not server.same_robot(a, b)


def test_little_is_sent_and_nothing_of_the_ground_by_mjviser(monkeypatch):
    server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed")
    from dynappo.web import address

    made, _ = server.start(address.Address("127.0.0.1", 8540))
    try:
        sent = {}
        for name in ("add_mesh_simple", "add_line_segments", "add_mesh_trimesh"):
            add = getattr(made.scene, name)

            def spy(path, *values, add=add, **named):
                sent[path] = sum(v.nbytes for v in values if isinstance(v, np.ndarray))
                return add(path, *values, **named)

            monkeypatch.setattr(made.scene, name, spy)
        server.open_page(made, OFFER, policies.load(OFFER, "go1"), None)
        ground = {path: size for path, size in sent.items() if path.startswith("/fixed_bodies")}
        assert set(ground) == {"/fixed_bodies/ground", "/fixed_bodies/lines"}
        assert 10_000 < sum(ground.values()) < 100_000
    finally:
        made.stop()


def test_a_ground_that_there_is_not_is_refused_before_anything_starts():
    with pytest.raises(policies.ConfigError, match="--ground=lava"):
        policies.load(OFFER._replace(ground="lava"), "go1")


def test_the_robot_stands_on_the_stairs():
    player = policies.load(OFFER, "go1").player
    live = live_lib.Live(player, lambda obs: np.zeros(12))
    for _ in range(50):
        live_lib.step(live)
    below = height_map.height(*player.field, *live.data.xpos[player.base_body][:2, None])
    assert below[0] < -1 and not live.row["fell"]
    assert abs(episode.foot_heights(player, live.data) - below).max() < 0.02

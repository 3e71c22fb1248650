"""Robots side by side: each in its lane, all in the picture, in a small GIF."""

import mujoco
import numpy as np
import pytest
from toy_policy import GO1, described

from dynappo.description import mjcf
from dynappo.policy import episode, policy_file, render
from notebooks import side_by_side

LACKS = render.NO_OPENGL, render.LACKS.split("{}")[0]


@pytest.fixture(scope="module")
def walks():
    """Two episodes of 0.4 s: a Go1 that does nothing, and the same one moved by hand, 2 m in all."""
    body = episode.load(GO1.xml, policy_file.describe(*described()), 0.005)
    stands = episode.play(body, lambda obs: np.zeros(12), episode.tour(0.4), 0.4)
    moved = stands["qpos"].copy()
    moved[:, 0] += np.linspace(0, 2, len(moved))
    return [stands, stands | {"qpos": moved}]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_each_robot_has_its_lane_and_all_are_in_the_picture(walks, count):
    episodes = [walks[0], *[walks[1]] * 4][:count]
    robots, rows = side_by_side.together(GO1.xml, episodes)
    model = mjcf.model(robots.xml, robots.text)
    assert model.nq == count * GO1.mj_model.nq and model.nlight == GO1.mj_model.nlight
    assert model.body(robots.base_body).name == GO1.mj_model.body(GO1.base_body).name
    qpos = rows["qpos"].reshape(len(rows["qpos"]), count, -1)
    for i, walk in enumerate(episodes):
        np.testing.assert_allclose(qpos[0, i, :2], [0, i * side_by_side.LANE], atol=1e-12)
        np.testing.assert_allclose(
            np.diff(qpos[:, i], axis=0), np.diff(walk["qpos"], axis=0), atol=1e-12
        )
        np.testing.assert_array_equal(qpos[:, i, 2:], walk["qpos"][:, 2:])
    data, camera = mujoco.MjData(model), model.camera("track").id
    mujoco.mj_forward(model, data)
    for place in qpos[:, :, :3].reshape(-1, 3):  # in the camera's frame: right, up, back
        right, up, back = data.cam_xmat[camera].reshape(3, 3).T @ (place - data.cam_xpos[camera])
        top = np.tan(np.radians(side_by_side.FIELD / 2))
        assert back < 0 and abs(up / back) < top
        assert abs(right / back) < top * side_by_side.SIZE[0] / side_by_side.SIZE[1]


def test_the_second_robot_is_orange_and_the_first_is_as_in_its_file(walks):
    model = mjcf.model(GO1.xml, side_by_side.together(GO1.xml, walks)[0].text)
    file = mujoco.MjModel.from_xml_path(str(GO1.xml))
    np.testing.assert_allclose(model.mat("silver").rgba, file.mat("silver").rgba, atol=1e-5)
    red, green, blue, _ = model.mat("robot1_silver").rgba
    assert red > green > blue
    np.testing.assert_allclose(model.mat("floor").rgba, 1)


@pytest.mark.slow
def test_the_gif_is_small_and_moves(walks, tmp_path):
    Image = pytest.importorskip("PIL.Image")
    out = tmp_path / "walks.gif"
    problem = side_by_side.film(GO1.xml, walks, out)
    if problem.startswith(LACKS):
        pytest.skip(problem)
    assert problem == "" and out.stat().st_size < 60_000
    with Image.open(out) as gif:
        assert gif.size == side_by_side.SIZE and gif.n_frames == 5
        frames = []
        for i in range(gif.n_frames):
            gif.seek(i)
            frames.append(np.asarray(gif.convert("RGB")).astype(int))
    assert len(np.unique(frames[0].reshape(-1, 3), axis=0)) <= side_by_side.COLOURS
    changed = (np.abs(frames[0] - frames[-1]) > 10).any(-1)
    assert 0.005 < changed.mean() < 0.3  # a robot has moved, the floor has not


def test_what_is_missing_is_said(walks, tmp_path, monkeypatch):
    monkeypatch.setattr(render, "film", lambda *_, **__: render.NO_OPENGL)
    assert side_by_side.film(GO1.xml, walks, tmp_path / "walks.gif") == render.NO_OPENGL

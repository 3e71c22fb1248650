"""The film: the same policy in NumPy, an episode on C MuJoCo, and a file, or a line that says why."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.config import validation
from dynappo.learner import networks
from dynappo.physics import robot as robot_lib
from dynappo.policy import render

OBS, ACTIONS = 48, 12


@pytest.fixture(scope="module")
def go1():
    """`(robot, config)` of the Go1."""
    return robot_lib.load("go1"), config_lib.validate(config_lib.load("configs/go1.py"))


@pytest.fixture(scope="module")
def standing(go1):
    """One second of the zero policy."""
    return render.simulate(*go1, lambda obs: np.zeros(ACTIONS), render.tour(1.0), 1.0)


def untrained(settings, activation):
    """`(static, params)` of a policy with weights large enough to bend every activation."""
    static, hyper = settings({"ppo.activation": activation, "ppo.hidden": (24, 16)})
    key = jax.random.key(1)
    params = networks.init_policy(static.ppo, hyper.ppo.init_std, OBS, ACTIONS, key)
    return static.ppo, jax.tree.map(lambda x: x * 4, params)


@pytest.mark.parametrize("activation", validation.CHOICES["ppo.activation"])
def test_the_policy_in_numpy_is_the_policy_in_jax(settings, activation):
    """Every activation, one observation and a batch, to 1e-5 of the largest action."""
    static, params = untrained(settings, activation)
    obs = np.random.default_rng(0).normal(size=(64, OBS)).astype(np.float32) * 3
    obs[0] *= 100  # far out, where an exponential could overflow
    expected = np.asarray(networks.policy(static, params, jnp.asarray(obs)))
    mean = render.policy(params, activation)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(mean(obs) / scale, expected / scale, atol=1e-5)
    np.testing.assert_allclose(mean(obs[3]) / scale, expected[3] / scale, atol=1e-5)
    assert scale > 1


def test_a_policy_comes_back_from_its_file(settings, tmp_path):
    """The same nested names and bits, and a policy that acts on them."""
    _, params = untrained(settings, "elu")
    render.save_params(tmp_path / "policy.npz", params)
    back = render.load_params(tmp_path / "policy.npz")
    assert jax.tree.structure(back) == jax.tree.structure(params)
    jax.tree.map(np.testing.assert_array_equal, back, params)
    with np.load(tmp_path / "policy.npz") as file:
        assert "actor/params/Dense_0/kernel" in file.files and "std" in file.files
    obs = np.ones(OBS)
    one, other = (render.policy(p, "elu")(obs) for p in (params, back))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seconds", [6.0, 12.0, 0.2])
def test_the_tour_covers_the_film(seconds):
    """Each command for its share, from the first instant to the last."""
    command = render.tour(seconds)
    assert sum(share for share, _ in render.TOUR) == pytest.approx(1)
    steps = 1000
    seen = [tuple(command(seconds * (k + 0.5) / steps)) for k in range(steps)]
    begin = 0
    for share, expected in render.TOUR:
        end = begin + round(share * steps)
        assert set(seen[begin:end]) == {expected}
        begin = end
    assert tuple(command(0.0)) == render.TOUR[0][1]
    assert tuple(command(seconds)) == tuple(command(2 * seconds)) == render.TOUR[-1][1]


def test_an_episode_has_a_row_for_every_control_step(go1, standing):
    """50 steps in a second, the commands of the tour, and what the camera needs."""
    robot, _ = go1
    assert standing["qpos"].shape == (50, robot.mj_model.nq)
    assert standing["command"].shape == standing["velocity"].shape == (50, 3)
    assert float(standing["dt"]) == pytest.approx(0.02)
    command = render.tour(1.0)
    np.testing.assert_array_equal(standing["command"][10], command(10 * 0.02))


def test_a_robot_that_does_nothing_stands(standing):
    """With zero actions the Go1 keeps its height and stays where it is, level and still."""
    qpos = standing["qpos"]
    assert np.isfinite(qpos).all()
    assert (np.abs(qpos[:, :2]) < 0.1).all()
    assert (qpos[:, 2] > 0.22).all() and (qpos[:, 2] < 0.4).all()
    upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    assert (upright > 0.95).all()
    assert np.abs(standing["velocity"][-1]).max() < 0.1


def test_the_policy_sees_what_it_was_trained_on(go1):
    """Its observation holds the command, its own last action, and a robot at its default pose."""
    seen = []

    def act(obs):
        seen.append(obs.copy())
        return np.full(ACTIONS, 0.01 * len(seen))

    render.simulate(*go1, act, lambda t: np.array([0.5, -0.25, t]), 0.1)
    seen = np.stack(seen)
    assert seen.shape == (5, OBS)
    np.testing.assert_allclose(seen[:, 33:36], [[0.5, -0.25, 0.02 * k] for k in range(5)])
    np.testing.assert_allclose(seen[:, 36:], np.outer(0.01 * np.arange(5), np.ones(ACTIONS)))
    np.testing.assert_allclose(seen[0, :24], 0, atol=1e-6)
    np.testing.assert_allclose(seen[0, 24:27], [0, 0, -1], atol=1e-6)


def test_a_policy_that_pushes_down_moves_the_robot(go1, standing):
    """Actions reach the joints: large ones give another episode."""
    episode = render.simulate(*go1, lambda obs: np.ones(ACTIONS), render.tour(1.0), 1.0)
    assert np.abs(episode["qpos"][:, 7:] - standing["qpos"][:, 7:]).max() > 0.1


# ---- the file


def probe(path):
    """`(number of frames, width, height, first frame)` of a video, by ffmpeg."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    frame = np.frombuffer(next(reader), np.uint8).reshape(height, width, 3)
    reader.close()
    return count, width, height, frame


@pytest.fixture(scope="module")
def filmed(go1, standing, tmp_path_factory):
    """The mp4 of the first 0.2 s; skips where nothing can render."""
    out = tmp_path_factory.mktemp("film") / "video.mp4"
    short = {name: rows[:10] if rows.ndim else rows for name, rows in standing.items()}
    problem = render.film(go1[0], short, out)
    if problem:
        assert problem in (render.NO_OPENGL, render.NO_FFMPEG) and not out.exists()
        pytest.skip(problem)
    return out


def test_a_film_plays_at_the_speed_of_the_robot(filmed):
    """10 rows of 20 ms are 0.2 s of film: as many frames as its rate asks for, full size."""
    count, width, height, _ = probe(filmed)
    assert count == 0.2 * render.FPS
    assert (width, height) == (render.WIDTH, render.HEIGHT)


def test_a_film_is_not_blank(filmed):
    """A robot, a floor and a sky: many colours, neither black nor one grey."""
    *_, frame = probe(filmed)
    assert frame.std() > 10 and 20 < frame.mean() < 235
    assert len(np.unique(frame.reshape(-1, 3) // 16, axis=0)) > 30
    # the middle of the picture, where the robot is, differs from its edges
    rows, columns = frame.shape[:2]
    middle = frame[rows // 3 : 2 * rows // 3, columns // 3 : 2 * columns // 3].astype(float)
    assert abs(middle.mean() - frame[: rows // 6].astype(float).mean()) > 3


def test_a_gif_has_the_same_pictures(go1, standing, filmed, tmp_path):
    """Half the pictures, three quarters of the size, for ever; the robot in its middle."""
    image = pytest.importorskip("PIL.Image")
    rows = {name: x[:20] if x.ndim else x for name, x in standing.items()}
    assert render.film(go1[0], rows, tmp_path / "walk.gif") == ""
    with image.open(tmp_path / "walk.gif") as film:
        assert film.n_frames == 5 and film.info["duration"] == 80 and film.info["loop"] == 0
        picture = np.asarray(film.convert("RGB")).astype(float)
    assert picture.shape == (270, 480, 3) and picture.std() > 10
    *_, frame = probe(filmed)
    small = frame[: render.HEIGHT // 20 * 20, :].astype(float).mean((0, 1))
    np.testing.assert_allclose(picture.mean((0, 1)), small, atol=12)


def test_a_png_is_readable(tmp_path):
    """Every byte as another reader sees it."""
    from matplotlib import image

    picture = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    render.write_png(tmp_path / "small.png", picture)
    back = np.round(image.imread(tmp_path / "small.png")[..., :3] * 255).astype(np.uint8)
    np.testing.assert_array_equal(back, picture)


def test_a_file_without_a_camera_is_filmed_from_a_distance(go1, standing, filmed, tmp_path):
    """Another MJCF, without `track`: the camera follows the base, so the robot stays in the middle."""
    import mujoco

    robot, _ = go1
    text = robot.xml.read_text()
    start, end = text.index("<camera"), text.index("/>", text.index("<camera")) + 2
    xml = tmp_path / "other.xml"
    xml.write_text(text[:start] + text[end:])
    assert render.camera(mujoco.MjModel.from_xml_path(str(xml)), 1).trackbodyid == 1
    rows = {name: x[-1:].copy() if x.ndim else x for name, x in standing.items()}
    rows["qpos"][:, :2] += 5  # far from where the file has the robot
    other = robot._replace(xml=xml)
    assert render.film(other, rows, tmp_path / "still.png") == ""
    from matplotlib import image

    picture = image.imread(tmp_path / "still.png")[..., :3]
    rows, columns = picture.shape[:2]
    middle = picture[rows // 3 : 2 * rows // 3, columns // 3 : 2 * columns // 3]
    assert middle.std() > 1.5 * picture[2 * rows // 3 :, : columns // 4].std()


def test_a_picture_is_the_last_row(go1, standing, filmed, tmp_path):
    """A PNG instead of an mp4, by the suffix; another last row gives another picture."""
    from matplotlib import image

    pictures = []
    for last in (5, 50):
        out = tmp_path / f"{last}.png"
        rows = {name: x[:last] if x.ndim else x for name, x in standing.items()}
        assert render.film(go1[0], rows, out) == ""
        pictures.append(image.imread(out)[..., :3])
    assert pictures[0].shape == pictures[1].shape and pictures[0].std() > 0.05
    assert np.abs(pictures[0] - pictures[1]).max() > 0.1


def broken(folder, package, error):
    """A package whose import fails, in a folder for the path of the process that renders."""
    (folder / package).mkdir()
    (folder / package / "__init__.py").write_text(f"raise {error}\n")
    return str(folder)


@pytest.mark.parametrize(
    "package, error, expected",
    [
        ("OpenGL", "ImportError('no libEGL.so.1')", render.NO_OPENGL),
        ("OpenGL", "SystemExit(139)", render.NO_OPENGL),
        (
            "imageio_ffmpeg",
            "ModuleNotFoundError(\"No module named 'imageio_ffmpeg'\")",
            render.NO_FFMPEG,
        ),
    ],
    ids=["no backend", "backend dies", "no ffmpeg"],
)
def test_without_its_packages_a_film_is_one_line(
    go1, standing, tmp_path, monkeypatch, package, error, expected
):
    """The line names what to install; no exception, no half-written file."""
    monkeypatch.setenv("PYTHONPATH", broken(tmp_path, package, error), prepend=":")
    rows = {name: x[:2] if x.ndim else x for name, x in standing.items()}
    out = tmp_path / "video.mp4"
    problem = render.film(go1[0], rows, out)
    assert problem == expected and "\n" not in problem and not out.exists()
    assert re.search("libegl1|libosmesa6|pip install", problem)


def test_a_film_that_cannot_be_written_is_not_a_missing_package(go1, standing, filmed, tmp_path):
    """A folder that is not there: the line says so, and names neither OpenGL nor a package."""
    rows = {name: x[:2] if x.ndim else x for name, x in standing.items()}
    problem = render.film(go1[0], rows, tmp_path / "nowhere" / "video.mp4")
    assert problem and "\n" not in problem
    assert problem not in (render.NO_OPENGL, render.NO_FFMPEG)


def test_a_film_needs_no_jax():
    """The process that renders, and play, start without it."""
    code = "import sys, dynappo.render; print(sorted({'jax', 'flax', 'optax'} & set(sys.modules)))"
    from test_console import shell

    done = shell("-c", code)
    assert done.stdout == "[]\n", done.stderr

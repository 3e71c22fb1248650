"""The film: a file with the robot in its middle, or a line that says why not and what to install."""

import itertools
import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from answers import shell
from toy_policy import GO1, described

from dynappo.config import files
from dynappo.config import shell as shell_lib
from dynappo.policy import episode, policy_file, render

image = pytest.importorskip("matplotlib.image")
NO_FFMPEG = render.LACKS.format("imageio-ffmpeg") + shell_lib.install("video")
NO_PILLOW = render.LACKS.format("pillow") + shell_lib.install("video")


@pytest.fixture(scope="module")
def standing():
    """One second of the Go1 under zero actions, as a run films its policy."""
    config, _ = described()
    return render.simulate(GO1, config, lambda obs: np.zeros(12), render.tour(1.0), 1.0)


def rows_of(rows, some):
    """Some rows of an episode."""
    return {name: column[some] if column.ndim else column for name, column in rows.items()}


def read(path):
    """The picture of a PNG, RGB in 0..1."""
    return image.imread(path)[..., :3]


def test_a_run_is_filmed_in_its_own_robot_under_its_own_config(standing):
    """50 rows in a second, of what `episode.play` plays; a robot that does nothing stands still."""
    player = episode.load(GO1.xml, policy_file.describe(*described()), 0.005)
    played = episode.play(player, lambda obs: np.zeros(12), render.tour(1.0), 1.0)
    assert standing["qpos"].shape == (50, GO1.mj_model.nq)
    for name, column in played.items():
        np.testing.assert_array_equal(standing[name], column, name)
    qpos = standing["qpos"]
    assert (np.abs(qpos[:, :2]) < 0.1).all() and (np.abs(qpos[:, 2] - 0.3) < 0.1).all()
    assert np.abs(standing["velocity"][-1]).max() < 0.1


# ---- films


def probe(path):
    """`(number of frames, width, height, first frame)` of a video, by ffmpeg."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    frame = np.frombuffer(next(reader), np.uint8).reshape(height, width, 3)
    reader.close()
    return count, width, height, frame


def lacks():
    """What this machine lacks for a film, found without our own code; "" if nothing."""
    code = "import os; os.environ['MUJOCO_GL'] = '{}'; import mujoco; mujoco.GLContext(8, 8)"
    if all(shell("-c", code.format(backend)).returncode for backend in ("egl", "osmesa")):
        return render.NO_OPENGL
    return NO_FFMPEG if shell("-c", "import imageio_ffmpeg").returncode else ""


@pytest.fixture(scope="module")
def filmed(standing, tmp_path_factory):
    """The mp4 of the first 0.2 s; skips only where this machine cannot make one."""
    out = tmp_path_factory.mktemp("film") / "video.mp4"
    problem = render.film(GO1, rows_of(standing, slice(10)), out)
    if problem and problem == lacks():
        pytest.skip(problem)
    assert problem == "" and out.exists()
    return out


def test_a_film_plays_at_the_speed_of_the_robot_and_is_not_blank(filmed):
    """10 rows of 20 ms are 0.2 s of film; a robot, a floor and a sky have many colours."""
    count, width, height, frame = probe(filmed)
    assert count == 0.2 * 25 and (width, height) == (render.WIDTH, render.HEIGHT)
    assert frame.std() > 10 and 20 < frame.mean() < 235
    assert len(np.unique(frame.reshape(-1, 3) // 16, axis=0)) > 30
    # the middle of the picture, where the robot is, differs from its edge
    rows, columns = frame.shape[:2]
    middle = frame[rows // 3 : 2 * rows // 3, columns // 3 : 2 * columns // 3].astype(float)
    assert abs(middle.mean() - frame[: rows // 6].astype(float).mean()) > 3


def test_a_small_picture_has_less_detail_which_nobody_sees():
    """By half the height: corners by its root, shadows by itself; from the file's height on, as it is."""
    for share, expected in ((1.0, (28, 16, 4096)), (2.0, (28, 16, 4096)), (0.5, (20, 11, 2048))):
        model = mujoco.MjModel.from_xml_path(str(GO1.xml))
        render.coarser(model, share)
        quality = model.vis.quality
        assert (quality.numslices, quality.numstacks, quality.shadowsize) == expected


def test_a_small_picture_looks_as_with_all_detail(standing, filmed, tmp_path):
    """By a file that is for pictures of this size, which keeps its detail: nearly all pixels are the same."""
    whole = GO1.xml.read_text().replace(
        'offwidth="1280" offheight="720"', 'offwidth="640" offheight="360"'
    )
    pictures = []
    for name, text in (("less", GO1.played), ("whole", whole)):
        shown = render.Shown(GO1.xml, text, GO1.base_body)
        assert render.film(shown, standing, tmp_path / f"{name}.png", (640, 360)) == ""
        pictures.append(read(tmp_path / f"{name}.png"))
    off = np.abs(pictures[0] - pictures[1]).max(-1)
    assert off.max() > 0 and off.mean() < 0.004 and (off > 0.1).mean() < 0.005


@pytest.mark.slow
def test_a_gif_has_the_same_pictures(standing, filmed, tmp_path):
    """Half the pictures, three quarters of the size, for ever."""
    pillow = pytest.importorskip("PIL.Image")
    assert render.film(GO1, rows_of(standing, slice(20)), tmp_path / "walk.gif") == ""
    with pillow.open(tmp_path / "walk.gif") as film:
        assert film.n_frames == 5 and film.info["duration"] == 80 and film.info["loop"] == 0
        picture = np.asarray(film.convert("RGB")).astype(float)
    assert picture.shape == (270, 480, 3) and picture.std() > 10
    *_, frame = probe(filmed)
    np.testing.assert_allclose(picture.mean((0, 1)), frame.astype(float).mean((0, 1)), atol=12)


def test_a_picture_is_the_last_row(standing, filmed, tmp_path):
    """By the suffix; another last row is another picture."""
    tipped = rows_of(standing, slice(5))
    tipped["qpos"] = tipped["qpos"].copy()
    tipped["qpos"][-1, 7:] += 0.5
    pictures = []
    for name, rows in (("one", standing), ("other", tipped)):
        assert render.film(GO1, rows, tmp_path / f"{name}.png") == ""
        pictures.append(read(tmp_path / f"{name}.png"))
    assert pictures[0].shape == (720, 1280, 3) and pictures[0].std() > 0.05
    assert np.abs(pictures[0] - pictures[1]).max() > 0.1


def test_a_file_without_a_camera_is_filmed_from_a_distance():
    """Another MJCF, without `track`: the camera follows the base."""
    text = GO1.xml.read_text()
    assert render.camera(mujoco.MjModel.from_xml_string(text), 1).fixedcamid == 0
    start = text.index("<camera")
    text = text[:start] + text[text.index("/>", start) + 2 :]
    view = render.camera(mujoco.MjModel.from_xml_string(text), 1)
    assert view.trackbodyid == 1 and view.type == mujoco.mjtCamera.mjCAMERA_TRACKING


@pytest.mark.slow
def test_a_film_has_the_size_that_is_asked_for_and_tells_how_far_it_is(standing, filmed, tmp_path):
    """Also one that is no multiple of four; a share a picture, up to the whole."""
    shares, rows = [], rows_of(standing, slice(10))
    assert render.film(GO1, rows, tmp_path / "a.mp4", (322, 182), shares.append) == ""
    assert probe(tmp_path / "a.mp4")[:3] == (5, 322, 182)
    np.testing.assert_allclose(shares, np.arange(1, 6) / 5)
    assert render.film(GO1, rows, tmp_path / "a.gif", (322, 182)) == ""
    assert pytest.importorskip("PIL.Image").open(tmp_path / "a.gif").size == (322, 182)
    assert render.film(GO1, rows, tmp_path / "a.png", (64, 66)) == ""
    assert read(tmp_path / "a.png").shape == (66, 64, 3)


def test_bodies_are_drawn_where_an_episode_has_them_not_where_its_joints_would(standing, tmp_path):
    """Of physics whose joints give: a picture of other joints, with these bodies, is that of these joints,
    but for a shift of the camera: it follows the joints' centre of mass, which hardly moves."""
    here = rows_of(standing, slice(-1, None))
    bent = np.outer([1, 1, -1, -1], [0, 0.4, 0]).ravel()
    bowing = here | {"qpos": here["qpos"] + np.r_[np.zeros(7), bent]}
    model, data = GO1.mj_model, mujoco.MjData(GO1.mj_model)
    data.qpos[:] = bowing["qpos"][0]
    mujoco.mj_forward(model, data)
    pose = np.concatenate([data.xpos, data.xquat], -1)[None]
    shown = {}
    for name, rows in (("here", here), ("bowing", bowing), ("posed", here | {"pose": pose})):
        assert render.film(GO1, rows, tmp_path / f"{name}.png", (320, 180)) == ""
        shown[name] = read(tmp_path / f"{name}.png")
    other, same = (
        (np.abs(shown[name] - shown["bowing"]).max(-1) > 0.1).mean() for name in ("here", "posed")
    )
    assert other > 0.02 and same < other / 4


# ---- the legend


def test_the_legend_names_the_colours_of_the_arrows(standing, filmed, tmp_path):
    """In the upper left corner: a line of each colour, and beside it a text; nothing elsewhere changes."""
    pytest.importorskip("PIL")
    walks = np.array([[0.8, 0.0, 0.0]])
    rows = rows_of(standing, slice(-1, None)) | {"command": walks, "velocity": walks}
    colours, opacity = card = render.legend(rows, 640, 360)

    def lines(colours):
        shown = (np.array(rgba[:3]) for rgba in (render.GREEN, render.BLUE))
        return [(np.abs(colours - 255 * rgb).max(-1) < 1).sum() > 50 for rgb in shown]

    assert lines(colours) == [True, True]
    uncommanded, _ = render.legend(rows | {"command": 0 * walks}, 640, 360)
    assert lines(uncommanded) == [False, True] and len(uncommanded) < len(colours)
    texts = (colours.max(-1) < 60) & (opacity[..., 0] > 0.9)
    assert texts[: len(texts) // 2].any() and texts[len(texts) // 2 :].any()
    picture = np.full((360, 640, 3), 99, np.uint8)
    shown = render.with_legend(picture, card)
    changed = np.argwhere((shown != picture).any(-1))
    assert len(changed) > 1000 and (changed.max(0) < np.array([90, 160])).all()
    assert (picture == 99).all() and shown.dtype == np.uint8
    assert render.film(GO1, rows, tmp_path / "a.png", (640, 360)) == ""
    np.testing.assert_allclose(
        255 * read(tmp_path / "a.png")[opacity[..., 0].nonzero()].mean(0), 235, atol=35
    )


def test_without_arrows_or_without_pillow_there_is_no_legend(standing, monkeypatch):
    """A robot that stands and shall stand; and a card that is larger than its picture is cut."""
    still = standing | {name: np.zeros((5, 3)) for name in ("command", "velocity")}
    walking = still | {"command": np.ones((5, 3))}
    picture = np.full((20, 20, 3), 99, np.uint8)
    np.testing.assert_array_equal(
        render.with_legend(picture, render.legend(still, 640, 360)), picture
    )
    assert (render.with_legend(picture, render.legend(walking, 640, 360)) != 99).any()
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert render.legend(walking, 640, 360)[0].size == 0


# ---- what can be missing

MISSING = {  # a package of the process that renders, what its import does, the file, the line
    "no backend": ("OpenGL", "ImportError('no libEGL.so.1')", "a.mp4", render.NO_OPENGL),
    "backend dies": ("OpenGL", "SystemExit(139)", "a.mp4", render.NO_OPENGL),
    "no ffmpeg": ("imageio_ffmpeg", "ModuleNotFoundError('not here')", "a.gif", NO_FFMPEG),
    "no pillow": ("PIL", "ModuleNotFoundError('not here')", "a.png", NO_PILLOW),
}


@pytest.mark.parametrize("name", MISSING)
def test_without_its_packages_a_film_is_one_line(standing, tmp_path, monkeypatch, name):
    """The line names what to install; no exception, no half-written file."""
    package, error, file, expected = MISSING[name]
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text(f"raise {error}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    problem = render.film(GO1, rows_of(standing, slice(2)), tmp_path / file)
    assert problem == expected and "\n" not in problem and not (tmp_path / file).exists()
    assert re.search("apt install|pip install", problem)


def test_a_driver_that_hangs_is_not_waited_for_for_ever(standing, tmp_path, monkeypatch):
    """The limit grows with the film, and here is less than Python needs to start."""
    monkeypatch.setattr(render, "PATIENCE", 1e-3)
    problem = render.film(GO1, rows_of(standing, slice(2)), tmp_path / "a.mp4")
    assert problem == "no video: rendering by egl took more than 0 s"
    assert not list(tmp_path.iterdir())


def stopped():
    raise KeyboardInterrupt


FAILURES = {  # what the process that renders comes to after half a film; the error, what is said
    "slow": (lambda: (None, ""), None, "took more than"),
    "full disk": (
        lambda: (render.CANNOT_WRITE, "No space left\n"),
        OSError,
        "a.mp4 (No space left)",
    ),
    "ctrl-C": (stopped, KeyboardInterrupt, ""),
}


@pytest.mark.parametrize("name", FAILURES)
def test_half_a_film_does_not_stay_and_an_older_one_does(standing, tmp_path, monkeypatch, name):
    """What is rendered by then is no film."""
    end, error, said = FAILURES[name]
    out = tmp_path / "a.mp4"
    out.write_bytes(b"old")

    def half(command, *_):
        Path(command[-4]).write_bytes(b"half")
        return end()

    monkeypatch.setattr(render, "_process", half)
    if error:
        with pytest.raises(error) as caught:
            render.film(GO1, rows_of(standing, slice(2)), out)
        assert said in str(caught.value)
    else:
        assert said in render.film(GO1, rows_of(standing, slice(2)), out)
    assert out.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


def test_a_film_that_ffmpeg_could_not_end_is_none(filmed, tmp_path):
    """As where the disk is full at its end: nothing else tells."""
    cut, count = tmp_path / "a.mp4", probe(filmed)[0]
    for share, pictures, expected in ((1.0, count, True), (0.9, count, False), (1.0, 9, False)):
        cut.write_bytes(filmed.read_bytes()[: round(share * filmed.stat().st_size)])
        assert render.whole_film(cut, pictures) is expected


def test_a_film_that_cannot_be_written_is_not_a_missing_package(standing, filmed, tmp_path):
    """A folder that has its name, or a folder that is none: the line says so."""
    (tmp_path / "video.mp4").mkdir()
    (tmp_path / "file").touch()
    for out in (tmp_path / "video.mp4", tmp_path / "file" / "video.mp4"):
        with pytest.raises(
            OSError, match=r"^cannot write .*/video.mp4 \(.*(s a directory|exists)\)"
        ):
            render.film(GO1, rows_of(standing, slice(2)), out)


def test_without_room_for_its_own_files_a_film_is_one_line(standing, tmp_path, monkeypatch):
    """A disk that is full."""

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(render.np, "savez", full)
    with pytest.raises(OSError, match=r"video.mp4 \(a temporary file: No space left on device\)$"):
        render.film(GO1, rows_of(standing, slice(2)), tmp_path / "video.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["go1", "g1"])
def test_arrows_are_above_the_robot_a_humanoid_s_head_too(name):
    """By the corners of the boxes around all shapes; a Go1's are where they always were."""
    path = files.find("robots", f"{name}/{name}.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = model.key("home").qpos
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 10)
    render.arrows(scene, data, 1, np.array([1.0, 0, 0]), np.array([0.5, 0, 0]))
    top = -np.inf
    for i in range(1, model.ngeom):
        for signs in itertools.product((-1, 1), repeat=3):
            corner = model.geom_aabb[i, :3] + signs * model.geom_aabb[i, 3:]
            top = max(top, data.geom_xpos[i, 2] + data.geom_xmat[i, 6:] @ corner)
    heights = [scene.geoms[k].pos[2] for k in range(2)]
    assert scene.ngeom == 2 and min(heights) > top + 0.05
    if name == "go1":
        assert heights[0] == pytest.approx(data.xpos[1, 2] + 0.14, abs=1e-5)

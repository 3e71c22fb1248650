"""A ground of one's own from a file: what is read, what is refused, and that a run keeps it."""

import io
import os
import re
import struct
import zlib

import jax.numpy as jnp
import numpy as np
import pytest
from npy_files import DAMAGED

from dynappo import config as config_lib
from dynappo.config import ConfigError, flags
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.evaluate import crossing
from dynappo.look import command as look
from dynappo.physics import ground
from dynappo.policy import policy_file, policy_source
from dynappo.tasks.velocity import env as env_lib
from dynappo.terrain import curriculum, height_map, map_file
from dynappo.terrain import tiles as tiles_lib

HEIGHTS = np.random.default_rng(0).uniform(-0.1, 0.2, (91, 171)).astype(np.float32)


@pytest.fixture
def array(tmp_path):
    path = tmp_path / "mine.npy"
    np.save(path, HEIGHTS)
    return path


def picture(path, levels, mode=None):
    image = pytest.importorskip("PIL.Image").fromarray(levels)
    (image.convert(mode) if mode else image).save(path)
    return str(path)


def settled(path, *more, spec="go2:rough"):
    more = ("cell=0.1", *more)
    fields = [f"--config.task.tiles.map={path}", *(f"--config.task.tiles.{one}" for one in more)]
    return flags.load(spec, fields)


def test_an_array_is_the_ground_and_its_middle_the_origin(array):
    found = map_file.load(str(array), 0.005, 0.1)
    np.testing.assert_array_equal(found.heights, HEIGHTS)
    assert found.heights.dtype == np.float32 and found.cell == 0.1
    np.testing.assert_allclose(found.corner, (-4.5, -8.5))
    ground.check(found)


def test_levels_of_a_picture_are_heights(tmp_path):
    levels = np.random.default_rng(0).integers(0, 256, (20, 30), np.uint8)
    expected = 0.01 * levels.astype(float)
    for mode in (None, "RGB", "RGBA"):
        path = picture(tmp_path / "a.png", levels, mode)
        np.testing.assert_allclose(map_file.load(path, 0.01, 0.1).heights, expected, atol=1e-6)
    deep = 200 * levels.astype(np.uint16)
    found = map_file.load(picture(tmp_path / "b.PNG", deep), 0.001, 0.1).heights
    np.testing.assert_allclose(found, 0.2 * levels, atol=1e-5)


def test_a_picture_with_colours_is_no_ground(tmp_path):
    colours = np.zeros((20, 30, 4), np.uint8)
    colours[3, 4, 2] = 1  # one point is not grey
    path = picture(tmp_path / "seen.png", colours)
    with pytest.raises(map_file.BadMap, match="seen.png: a picture with colours, expected levels"):
        map_file.load(path, 0.01, 0.1)


def png(path, depth, kind, bits, size=20):
    """A black PNG of 20 x 20 points, with `bits` each; Pillow writes few kinds. Its header claims `size`."""

    def chunk(name, data):
        check = struct.pack(">I", zlib.crc32(name + data))
        return struct.pack(">I", len(data)) + name + data + check

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", size, size, depth, kind, 0, 0, 0))
    rows = zlib.compress(bytes(20 * (1 + -(-20 * bits // 8))))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
    return str(path)


@pytest.mark.parametrize(
    ("depth", "kind", "bits", "says"),
    [
        (
            16,
            2,
            48,
            "of 16 bits with colours or an alpha channel, expected grey alone; save it without",
        ),
        (16, 4, 32, "of 16 bits with colours or an alpha channel"),
        (16, 6, 64, "of 16 bits with colours or an alpha channel"),
        (1, 0, 1, "of 1 bits, expected 8 or 16"),
        (2, 0, 2, "of 2 bits, expected 8 or 16"),
        (4, 0, 4, "of 4 bits, expected 8 or 16"),
    ],
)
def test_a_picture_whose_levels_would_be_others_is_refused(tmp_path, depth, kind, bits, says):
    """Pillow cuts or stretches these to 8 bits without a word."""
    pytest.importorskip("PIL")
    for good in ((8, 0, 8), (16, 0, 16)):
        assert map_file.load(png(tmp_path / "good.png", *good), 0.01, 0.1).heights.shape == (20, 20)
    with pytest.raises(map_file.BadMap, match=f"a.png: a picture {says}"):
        map_file.load(png(tmp_path / "a.png", depth, kind, bits), 0.01, 0.1)


def test_a_picture_of_another_format_is_refused(tmp_path):
    image = pytest.importorskip("PIL.Image")
    for name in ("TIFF", "JPEG"):
        image.fromarray(np.zeros((20, 20), np.uint8)).save(tmp_path / "a.png", name)
        with pytest.raises(map_file.BadMap, match="expected a picture in the format PNG"):
            map_file.load(str(tmp_path / "a.png"), 0.01, 0.1)


def test_a_picture_that_is_too_large_is_told_its_size(tmp_path):
    """Pillow refuses it before it reads a point: what was found is in the header."""
    pytest.importorskip("PIL")
    path = tmp_path / "a.png"
    png(path, 8, 0, 8, size=20_000)
    says = "a.png: a picture of 20000 x 20000 points, expected at most 100 million"
    with pytest.raises(map_file.BadMap, match=says):
        map_file.load(str(path), 0.01, 0.1)


def zipped(end):
    """An .npz that was renamed, cut at `end`."""
    out = io.BytesIO()
    np.savez(out, heights=HEIGHTS)
    return out.getvalue()[:end]


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.npy", None, "cannot be read (No such file or directory)"),
        ("a.txt", b"", "expected a file that ends in .npy or .png"),
        ("a.npy", b"nonsense", "expected an array of numbers, as numpy.save writes it"),
        ("a.png", b"nonsense", "expected a picture in the format PNG"),
        ("a.npy", np.zeros((3, 4, 5)), "an array of (3, 4, 5), expected two axes of at least 2"),
        ("a.npy", np.zeros((1, 4)), "an array of (1, 4), expected two axes of at least 2 points"),
        (
            "a.npy",
            np.where(np.eye(4)[::-1], np.nan, 0.0),
            "4 of 16 heights are no numbers, first that at [0, 3], expected m from -100 to 100",
        ),
        ("a.npy", np.full((4, 4), -np.inf), "16 of 16 heights are no numbers"),
        ("a.npy", np.eye(4) * 101, "heights from 0 to 101 m, expected m from -100 to 100"),
        ("a.npz", b"nonsense", "expected a file that ends in .npy or .png"),
        ("a.npy", b"", "expected an array of numbers"),
        ("a.npy", np.zeros((0, 4)), "an array of (0, 4), expected two axes of at least 2 points"),
        ("a.npy", zipped(-40), "expected an array of numbers, as numpy.save writes it"),
        ("a.npy", zipped(None), "expected an array of numbers, as numpy.save writes it"),
        *(("a.npy", data, "expected an array of numbers") for data in DAMAGED.values()),
        ("a.npy", np.zeros((90, 90), complex), "expected an array of numbers"),
        ("a.npy", np.array([["a", "b"]]), "expected an array of numbers"),
        ("a.npy", np.array([[{}, 1]]), "expected an array of numbers"),
        ("a.npy", np.zeros((41, 90)), "task.tiles.size is 8, expected at most 4: "),
    ],
)
def test_a_bad_file_is_one_line_that_says_what_was_found_and_expected(
    tmp_path, name, content, says
):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    with pytest.raises(ConfigError, match=re.escape(says)) as error:
        settled(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith("task.tiles.")


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ("cell=-0.1", "cell is -0.1, expected 0.01 to 1"),
        ("cell=0.0", "cell is 0.0, expected 0.01 to 1"),
        ("size=500.0", "size is 500.0, expected 2 to 100"),
        ("size=17.5", "size is 17.5, expected at most 9: "),
        ("map_level=0.0", "map_level is 0.0, expected more than 0"),
    ],
)
def test_a_bad_field_beside_a_good_file_is_named(array, field, says):
    with pytest.raises(ConfigError, match=re.escape(f"task.tiles.{says}")):
        settled(array, field)


def test_a_picture_without_a_height_at_each_point_is_refused(tmp_path):
    """One that is transparent somewhere; and heights that its level makes too high."""
    levels = np.full((90, 90, 4), 255, np.uint8)
    levels[3, 4, 3] = 254
    with pytest.raises(ConfigError, match="1 of 8100 points are transparent, expected a height at"):
        settled(picture(tmp_path / "a.png", levels))
    path = picture(tmp_path / "b.png", levels[..., 0])
    with pytest.raises(ConfigError, match="from 255 to 255 m, .*; a level of its grey is 1 m"):
        settled(path, "map_level=1.0")


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (dict(heights=HEIGHTS.astype(float)), "ground.heights is float64, expected an array of"),
        (dict(heights=HEIGHTS.tolist()), "ground.heights is list, expected an array of NumPy's"),
        (dict(heights=HEIGHTS[:1]), "ground.heights has the shape (1, 171), expected [X, Y]"),
        (dict(heights=HEIGHTS * np.nan), "ground.heights has some that are not finite, expected m"),
        (dict(cell=-0.1), "ground.cell is -0.1, expected m above 0"),
        (dict(cell="0.1"), "ground.cell is '0.1', expected m above 0"),
        (dict(corner=(0.0,)), "ground.corner is (0.0,), expected x and y in m"),
        (dict(corner=(0.0, np.nan)), "ground.corner is (0.0, nan), expected x and y in m"),
        (dict(corner=(-4.0, -8.5)), "task.tiles has x from -4.5 to 4.5 m (rows, columns, size;"),
        (dict(cell=0.05), "the ground from -4.5 to 0 m; set task.tiles.rows, columns and size"),
    ],
)
def test_a_ground_in_python_that_is_none_is_one_line(made, says):
    """Also one that is smaller than its tiles: robots would begin beside it."""
    tiles = config_lib.load("go2:rough").task.tiles
    tiles.update(rows=1, columns=1, size=9.0)
    good = height_map.HeightMap(HEIGHTS, 0.1, (-4.5, -8.5))
    ground.check_tiles(tiles, good)
    ground.check_tiles(tiles, good._replace(cell=np.float32(0.1)))
    with pytest.raises(ConfigError, match=re.escape(says)):
        ground.check_tiles(tiles, good._replace(**made))
    with pytest.raises(ConfigError, match="ground is a ndarray, expected a HeightMap"):
        ground.check_tiles(tiles, HEIGHTS)


def test_a_run_keeps_which_file_it_is_and_its_tiles_are_as_many_as_fit(
    array, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    config = settled("mine.npy", "size=4.0")
    tiles = config.task.tiles
    assert (tiles.rows, tiles.columns) == (2, 4) and tiles.map == str(array)
    assert tiles.map_hash == map_file.digest(str(array))
    kept = config_lib.from_json(config_lib.to_json(config_lib.validate(config)))
    monkeypatch.chdir("/")
    assert config_lib.validate(kept).task.tiles == config_lib.validate(config).task.tiles
    np.testing.assert_array_equal(ground.of_tiles(kept.task.tiles).heights, HEIGHTS)
    flags.set_fields(kept, ["--config.run.num_iterations=3"])  # a run goes on
    assert kept.task.tiles.map_hash == tiles.map_hash and kept.task.tiles.rows == 2
    # moved: beside the one who asks
    (tmp_path / "here").mkdir()
    array.rename(tmp_path / "here" / "mine.npy")
    monkeypatch.chdir(tmp_path / "here")
    np.testing.assert_array_equal(ground.of_tiles(kept.task.tiles).heights, HEIGHTS)
    np.save("mine.npy", HEIGHTS + 0.01)
    with pytest.raises(ConfigError, match="is another file .*expected the one that the run began"):
        ground.of_tiles(kept.task.tiles)
    os.unlink("mine.npy")
    gone = r"task.tiles.map: .*mine.npy cannot be read .*, nor is there a mine.npy here: expected the map"
    with pytest.raises(ConfigError, match=gone):
        ground.of_tiles(kept.task.tiles)
    flags.set_fields(kept, ["--config.task.tiles.map="])  # and back to made tiles
    assert kept.task.tiles.map_hash == ""


def test_a_map_that_no_command_line_set_is_refused(array):
    config = config_lib.load("go2:rough")
    config.task.tiles.map = str(array)
    with pytest.raises(ConfigError, match="expected one that a command line has set"):
        config_lib.validate(config)
    with pytest.raises(ConfigError, match="expected '' where task.terrain is flat"):
        config_lib.validate(settled(array, spec="go2:best"))


def test_the_task_is_on_the_map_and_robots_start_all_over_it(array):
    config = config_lib.validate(settled(array, "size=4.0"))
    config, robot = motors.fitted(config, robot_lib.load("go2"))
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    assert "terrain_row_1" in env.metrics and "terrain_row_2" not in env.metrics
    tiles = config.task.tiles
    assert tiles_lib.centres(tiles).shape == (2, 4, 2)
    draws = jnp.asarray(np.random.default_rng(0).uniform(size=(200, 2)))
    first = [curriculum.start(tiles, draw) for draw in draws]
    assert {int(one.row) for one in first} == {0, 1}
    after = [curriculum.move(tiles, first[0], 9.0, 1.0, draw) for draw in draws[:, 0]]
    assert {int(one.row) for one in after} == {0, 1}


def test_crossings_of_a_map_have_one_kind(array):
    tiles = config_lib.validate(settled(array, "size=4.0")).task.tiles
    found = dict(
        row=np.array([0, 1, 1]),
        column=np.array([0, 3, 2]),
        crossed=np.array([1, 0, 1]),
        fell=np.array([0, 1, 0]),
    )
    numbers = crossing.counted(tiles, found)
    assert numbers["kinds"] == {"map": {"tries": 3, "crossed": 2, "fell": 1}}
    assert numbers["rows"]["map"][1] == {"tries": 2, "crossed": 1, "fell": 1}


def test_look_writes_no_picture_over_a_map(tmp_path):
    """Its --ground is written, where play's is read."""
    path = picture(tmp_path / "ground.png", np.zeros((90, 90), np.uint8))
    before = (tmp_path / "ground.png").read_bytes()
    with pytest.raises(ConfigError, match="ground.png: it could be a map of yours"):
        look.parse(["go2:rough", f"--ground={path}"])
    assert (tmp_path / "ground.png").read_bytes() == before
    colours = np.zeros((9, 9, 3), np.uint8)
    colours[0, 0, 0] = 9
    look.parse(["go2:rough", f"--ground={picture(tmp_path / 'seen.png', colours)}"])


def test_play_and_look_show_it(array, tmp_path, capsys):
    policy = policy_file.load(robot_lib.load("go2").xml.with_name("policy.npz"))
    np.testing.assert_array_equal(policy_source.ground(policy, str(array)).heights, HEIGHTS)
    with pytest.raises(ConfigError, match=r"--ground: .*no.npy cannot be read"):
        policy_source.ground(policy, str(tmp_path / "no.npy"))
    out = tmp_path / "new" / "folder" / "seen.png"
    look.run(
        look.parse(
            [
                "go2:rough",
                f"--config.task.tiles.map={array}",
                "--config.task.tiles.size=4.0",
                f"--ground={out}",
            ]
        )
    )
    assert out.stat().st_size > 1000
    said = capsys.readouterr().out
    steep = max(abs(np.diff(HEIGHTS, axis=k)).max() for k in (0, 1))
    assert "4.5 x 8.5 m, -0.1 to 0.2 m high, two points at most" in said  # cells of 0.05 m
    assert f"at most {steep:.3g} m apart in height, 1 x 2 tiles of 4 m" in said

"""Small files: found in the working directory first, written whole or not at all."""

import json

import pytest

from dynappo.config import files


def test_json_is_written_whole_or_not_at_all(tmp_path):
    """A value that JSON cannot hold leaves the old file, and a good one replaces it."""
    path = tmp_path / "summary.json"
    files.write_json(path, {"return": [1.5, None], "robot": "go1"})
    assert json.loads(path.read_text()) == {"return": [1.5, None], "robot": "go1"}
    with pytest.raises(TypeError):
        files.write_json(path, {"return": object()})
    assert json.loads(path.read_text())["robot"] == "go1"
    files.write_json(path, {"robot": "go2"})
    assert json.loads(path.read_text()) == {"robot": "go2"}
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]


def test_nothing_is_left_of_what_could_not_be_written(tmp_path, monkeypatch):
    """Neither after an error of whoever writes, nor of the disk; what a killed process left is replaced."""
    path = tmp_path / "curves.png"
    (tmp_path / "curves.png.part").write_text("half of one")
    with pytest.raises(KeyboardInterrupt), files.replacing(path) as part:
        part.write_text("a third")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    with files.replacing(path) as part:
        part.write_text("whole")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space"), files.replacing(path) as part:
        part.write_text("another")
    assert [p.read_text() for p in tmp_path.iterdir()] == ["whole"]


def test_ones_own_robot_is_found_before_the_packages(tmp_path, monkeypatch):
    """A folder robots/NAME with NAME.xml in it; another file there makes no robot."""
    monkeypatch.chdir(tmp_path)
    ours = files.robots()
    assert {"go1", "go2", "anymal_c", "anymal_d"} <= set(ours)
    for name in ("spot/spot.xml", "spot/scene.xml", "go1/go1.xml"):
        (tmp_path / "robots" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "robots" / name).touch()
    assert files.robots() == sorted({*ours, "spot"})
    assert files.find("robots", "go1/go1.xml") == tmp_path / "robots" / "go1" / "go1.xml"
    assert files.find("robots", "spot/policy.npz") is None

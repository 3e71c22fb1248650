"""Films that `play` writes: which sizes there are, and who is told how far they are."""

import sys

import pytest
from answers import refused

from dynappo.play import film
from dynappo.policy import render


@pytest.mark.parametrize(
    ("text", "expected"),
    [("640x360", (640, 360)), ("64X64", (64, 64)), ("3840x2160", (3840, 2160))],
)
def test_a_size_is_width_and_height(tmp_path, text, expected):
    for suffix in (".mp4", ".gif", ".png"):
        assert film.size(text, tmp_path / f"a{suffix}") == expected


WRONG = "x 640 640x 640x361 62x64 3842x64 -64x64 6.4x64 64x64x64 \u0666\u0664x64".split(" ")


@pytest.mark.parametrize("text", ["", *WRONG])
def test_no_other_text_is_a_size(tmp_path, text):
    line = refused(film.size, text, tmp_path / "a.mp4")
    assert line.startswith(f"--size={text!r}: expected WIDTHxHEIGHT, even numbers from 64 to 3840")


@pytest.mark.parametrize("terminal", [False, True])
def test_only_a_terminal_is_told_how_far_it_is(tmp_path, monkeypatch, capsys, terminal):
    """One line that is written over, and gone at the end; also after a failure. A log gets one line."""

    def shipped(player, episode, out, pixels, tell=lambda share: None):
        for share in (0.25, 1.0):
            tell(share)
        return f"no video: {pixels}"

    monkeypatch.setattr(render, "film", shipped)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    assert film.write(None, {}, tmp_path / "a.mp4", (64, 66)) == "no video: (64, 66)"
    said = capsys.readouterr()
    assert said.out == ""
    if not terminal:
        assert said.err == "rendering: on two cores about twice as long as the film\n"
        return
    assert "\n" not in said.err
    shown = [part.strip() for part in said.err.split("\r")]
    steps = ["", "rendering:   0%", "rendering:  25%", "rendering: 100%, encoding", "", ""]
    assert shown == steps

"""The pictures of an evaluation, against the numbers they are drawn from."""

import sys

import numpy as np
import pytest
import toy_sweep

from dynappo.config import shell
from dynappo.evaluate import figures


def test_every_cell_of_the_maps_shows_its_command():
    """Colour and both numbers; a fall is said, and has no colour."""
    fell = {(-1.0, 0.5, 0.0), (0.5, 0.0, -1.0)}
    numbers = toy_sweep.numbers(fell)
    panels = figures.tracking("go1", numbers).axes[:2]
    labels = [text.get_text() for text in panels[0].get_yticklabels()]
    assert labels == ["-1", "0", "0.5", "1"]
    for panel, axis in zip(panels, ("vy", "wz"), strict=True):
        across, ahead = numbers["axes"][axis], numbers["axes"]["vx"]
        assert [t.get_text() for t in panel.get_xticklabels()] == [f"{v:g}" for v in across]
        colors = panel.images[0].get_array().filled(np.nan)
        assert colors.shape == (4, 3) and panel.get_ylim()[0] < panel.get_ylim()[1]
        told = {}
        for text in panel.texts:
            x, y = text.get_position()
            told.setdefault((round(y), round(x)), []).append(text.get_text())
        for i, x in enumerate(ahead):
            for j, other in enumerate(across):
                y, turn = (other, 0.0) if axis == "vy" else (0.0, other)
                error = 0.3 + x / 10 + y / 25 + turn / 30
                if (x, y, turn) in fell:
                    assert told[i, j] == ["fell after\n1.5 s"] and np.isnan(colors[i, j])
                else:
                    assert colors[i, j] == pytest.approx(error)
                    assert told[i, j] == [f"{error:.2f}", f"{0.1 + x / 50:.2f}"]


def test_the_bars_of_a_gait_are_the_contacts_of_its_last_two_seconds():
    """Every bar against a loop over the raw contacts, of a long and of a short episode."""
    rng = np.random.default_rng(0)
    recordings = [{"contact": np.repeat(rng.random((n, 4)) < 0.5, 20, 0)} for n in (40, 9)]
    numbers = toy_sweep.numbers()
    found = {tuple(row["command"]): r for row, r in zip(numbers["ahead"], recordings, strict=True)}
    panels, count = figures.gait("go1", numbers, found, 0.005).axes, 0
    for panel, recording in zip(panels, recordings, strict=True):
        shown = recording["contact"][-400:]
        for j, name in enumerate(toy_sweep.FEET):
            bars, begun = [], None
            for p, down in enumerate([*shown[:, j], False]):
                if down and begun is None:
                    begun = p
                if not down and begun is not None:
                    bars.append([begun * 0.005, p * 0.005])
                    begun = None
            paths = panel.collections[2 * j + 1].get_paths()
            drawn = [[path.vertices[:, 0].min(), path.vertices[:, 0].max()] for path in paths]
            np.testing.assert_allclose(drawn, bars)
            heights = [path.vertices[:, 1].mean() for path in paths]
            np.testing.assert_allclose(heights, j, atol=0.2)
            count += len(bars)
            assert panel.get_yticklabels()[j].get_text() == name
            assert f"{0.2 + j / 10:.2f}" in [text.get_text() for text in panel.texts]
    assert count > 20
    titles = [panel.get_title("left") for panel in panels]
    assert "asked for 0.5 m/s" in titles[0] and "asked for 1 m/s" in titles[1]
    assert all("2.50 strides/s" in title and "duty factor 0.50" in title for title in titles)
    # a robot that stands moves so, too
    assert "moves at 0.50 m/s" in titles[0] and not any("walks" in title for title in titles)


def test_no_pictures_without_matplotlib(tmp_path, monkeypatch):
    """The reason is one line, and nothing is written."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    problem = figures.write(tmp_path, "go1", toy_sweep.numbers(), {}, 0.005)
    assert problem == figures.NO_PICTURES + shell.install("video") and not list(tmp_path.iterdir())

"""Curves of a run: the interval against scipy and by counting, the picture against its data."""

import sys

import numpy as np
import pytest
from scipy import stats

from dynappo.config import shell
from dynappo.run import learning_curves, log

# ---- the interval of a mean


@pytest.mark.parametrize("seeds", [2, 3, 5, 10, 40])
def test_it_is_students(seeds):
    """As scipy has it."""
    values = np.random.default_rng(seeds).normal(3.0, 2.0, seeds)
    ends = stats.t.interval(0.95, seeds - 1, values.mean(), stats.sem(values))
    np.testing.assert_allclose(learning_curves.interval(values), ends)
    np.testing.assert_allclose(learning_curves.half_width(values), (ends[1] - ends[0]) / 2)


@pytest.mark.parametrize("seeds", [2, 3, 5, 10])
def test_it_holds_the_true_mean_in_95_of_100_cases(seeds):
    """Counted over 40,000 experiments; bootstrap percentiles would in 50, 76, 84, 90."""
    values = np.random.default_rng(seeds).normal(size=(seeds, 40_000))
    low, high = learning_curves.interval(values)
    assert abs(((low < 0) & (high > 0)).mean() - 0.95) < 0.005


def test_it_takes_any_shape():
    """Every number as if it were alone."""
    values = np.random.default_rng(0).normal(size=(6, 3, 2))
    low, high = learning_curves.interval(values)
    assert low.shape == high.shape == (3, 2) and (low < values.mean(0)).all()
    alone = [learning_curves.interval(values[:, i, j]) for i, j in np.ndindex(3, 2)]
    np.testing.assert_allclose(alone, np.stack([low.ravel(), high.ravel()], 1), rtol=1e-12)


def test_nothing_is_claimed_of_one_seed_or_of_a_seed_without_a_number():
    """NaN, not an interval of width 0; other columns are not touched."""
    assert (
        np.isnan(learning_curves.interval([3.0])).all()
        and np.isnan(learning_curves.interval([])).all()
    )
    assert np.isnan(learning_curves.interval(np.ones((1, 4)))).all()
    values = np.arange(12.0).reshape(4, 3)
    values[2, 1] = np.nan
    low, high = learning_curves.interval(values)
    assert np.isnan(low).tolist() == np.isnan(high).tolist() == [False, True, False]
    np.testing.assert_allclose(low[0], learning_curves.interval(values[:, 0])[0])


# ---- the picture


def run(seeds: int, iterations: int = 40) -> dict[str, np.ndarray]:
    """Metrics as `train.loop` returns them; the first episode of seed s ends in iteration 3 + s."""
    rng = np.random.default_rng(0)
    shape = (iterations, seeds) if seeds > 1 else (iterations,)
    names = [panel.metric for panel in learning_curves.PANELS]
    metrics = {name: rng.uniform(0.1, 1.0, shape).cumsum(0) for name in names}
    for s in range(seeds):
        for name in ("episode_return", "episode_length"):
            metrics[name].reshape(iterations, -1)[: 2 + s, s] = np.nan
    i = np.arange(1, iterations + 1)
    return metrics | {"iteration": i, "sim_steps": 96 * i, "seconds": 0.1 * i}


def lines(axes) -> dict[str, np.ndarray]:
    """`{label: [I, 2]}` of what is drawn."""
    return {line.get_label(): np.stack(line.get_data(), 1) for line in axes.get_lines()}


def test_every_seed_their_mean_and_its_band_are_drawn():
    """The lines of each panel hold the columns; the band's corners are the interval's."""
    metrics = run(seeds=3)
    page = learning_curves.figure(metrics, "three seeds")
    assert len(page.axes) == 5
    for axes, panel in zip(page.axes, learning_curves.PANELS, strict=True):
        drawn, values = lines(axes), metrics[panel.metric]
        assert sorted(drawn) == ["mean", "seed 0", "seed 1", "seed 2"]
        for s in range(3):
            np.testing.assert_array_equal(drawn[f"seed {s}"][:, 1], values[:, s])
        np.testing.assert_allclose(drawn["mean"][:, 1], values.mean(1))
        np.testing.assert_array_equal(drawn["mean"][:, 0], metrics["iteration"])
        low, high = learning_curves.interval(values.T)
        (band,) = axes.collections
        corners = {tuple(corner) for path in band.get_paths() for corner in path.vertices}
        for k in np.flatnonzero(np.isfinite(low)):
            assert {(k + 1.0, low[k]), (k + 1.0, high[k])} <= corners
        assert panel.title == axes.get_title("left") and axes.get_xlabel() == "iteration"
    assert np.isnan(lines(page.axes[0])["mean"][:4, 1]).all()  # seed 2 has no number before row 5
    assert np.isfinite(lines(page.axes[0])["mean"][4:, 1]).all()


def test_the_numbers_at_the_ends_are_those_of_the_last_ten_rows():
    """As the summary's return; each seed is named beside the large panel only."""
    metrics = run(seeds=2)
    page = learning_curves.figure(metrics)
    last = metrics["episode_return"][-10:].mean(0)
    found = [text.get_text() for text in page.axes[0].texts]
    assert found == [
        f"mean {last.mean():.1f}",
        f"seed 0   {last[0]:.1f}",
        f"seed 1   {last[1]:.1f}",
    ]
    assert [t.get_text() for t in page.axes[2].texts] == [
        f"{metrics['velocity_error'][-10:].mean():.2f}"
    ]
    many = {name: np.repeat(v, 8, 1) if v.ndim == 2 else v for name, v in metrics.items()}
    assert (
        len(learning_curves.figure(many).axes[0].texts) == 1
    )  # sixteen names would cover each other


@pytest.mark.parametrize("two_dimensional", [False, True])
def test_of_one_seed_its_line_alone_is_drawn(two_dimensional):
    """[I] and [I, 1] alike."""
    metrics = run(seeds=1)
    returns = metrics["episode_return"]
    if two_dimensional:
        metrics["episode_return"] = returns[:, None]
    axes = learning_curves.figure(metrics).axes[0]
    assert list(lines(axes)) == ["mean"] and not axes.collections
    np.testing.assert_array_equal(lines(axes)["mean"][:, 1], returns)


@pytest.mark.parametrize(("iterations", "last"), [(4, 4), (40, 10)])
def test_numbers_are_said_to_be_of_as_many_iterations_as_there_are(iterations, last):
    axes = learning_curves.figure(run(seeds=1, iterations=iterations)).axes[0]
    assert axes.get_title("right") == f"numbers: last {last} iterations"


def test_what_a_run_lacks_is_left_out():
    """Plain PPO has no model; a run in which no episode ended has no return to show."""
    metrics = run(seeds=2)
    del metrics["model_loss"]
    metrics["episode_return"][:] = metrics["episode_length"][:] = np.nan
    page = learning_curves.figure(metrics)
    assert [a.get_title("left") for a in page.axes] == [
        p.title for p in learning_curves.PANELS[:-1]
    ]
    assert not page.axes[0].texts


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "seeds, iterations", [(1, 40), (3, 1), pytest.param(12, 40, marks=pytest.mark.slow)]
)  # three seeds of 40: the next test
def test_a_png_is_written(tmp_path, seeds, iterations):
    """Without a warning."""
    metrics = run(seeds, iterations)
    assert learning_curves.draw(metrics, tmp_path / "a.png", "a run") == ""
    content = (tmp_path / "a.png").read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n" and len(content) > 20_000
    assert int.from_bytes(content[16:20]) == 1800


def test_the_metrics_of_a_run_and_its_metrics_csv_are_one_picture(tmp_path):
    metrics = run(seeds := 3)
    rounded = {n: np.array([float(f"{x:.6g}") for x in v.flat]) for n, v in metrics.items()}
    rounded = {n: v.reshape(metrics[n].shape) for n, v in rounded.items()}
    log.append_csv(tmp_path / "metrics.csv", log.rows(metrics))
    read = log.read_csv(tmp_path / "metrics.csv", seeds)
    assert learning_curves.draw(read, tmp_path / "b.png", "a run") == ""
    assert learning_curves.draw(rounded, tmp_path / "c.png", "a run") == ""
    assert (tmp_path / "b.png").read_bytes() == (tmp_path / "c.png").read_bytes()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seeds", [3, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("model_loss", lambda x: 0 * x),  # on a log axis
        ("model_loss", lambda x: np.nan * x),
        ("velocity_error", lambda x: 1e30 * x),
        ("episode_length", lambda x: x - 1e6),
    ],
)
def test_every_panel_has_room_whatever_its_last_numbers(seeds, name, change):
    """Matplotlib warned "axes sizes collapsed to zero": a label was far outside, or too wide."""
    metrics = run(seeds)
    metrics[name][20:] = change(metrics[name][20:])
    page = learning_curves.figure(metrics, "a run")
    page.draw_without_rendering()
    assert all(axes.get_window_extent().width > 150 for axes in page.axes)
    places = [text.xy[1] for axes in page.axes for text in axes.texts]
    assert len(places) > 3 and 0 <= min(places) and max(places) <= 1


def test_without_matplotlib_it_says_what_to_install(tmp_path, monkeypatch):
    """One line, and no file."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    said = learning_curves.draw(run(seeds=2), tmp_path / "a.png")
    assert said.endswith(shell.install("video")) and "\n" not in said
    assert not list(tmp_path.iterdir())


def test_labels_are_moved_apart_downwards():
    """Order and gap are kept, none is below the axis, and the highest and what has room stay."""
    heights = np.random.default_rng(0).uniform(0.6, 0.7, 6)
    moved = learning_curves._apart(heights, 0.08)
    assert (np.diff(moved[np.argsort(heights)]) >= 0.08 - 1e-12).all()
    assert moved.max() == heights.max() and (moved <= heights).all()
    assert learning_curves._apart([0.01, 0.0], 0.06).min() == 0
    np.testing.assert_allclose(learning_curves._apart([0.9, 0.1], 0.06), [0.9, 0.1])

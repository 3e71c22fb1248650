"""What the page offers: bundled policies, those of a run, and the newest by itself."""

import os
import threading

import numpy as np
import pytest
from answers import PATIENCE, refused
from toy_policy import GO1, actor, described, save

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.policy import policy_file
from dynappo.web import policies, run_plots


def offer(what, **other):
    return policies.Offer(**(dict(what=str(what), seed=None, xml=None, keep_joints=False) | other))


@pytest.fixture
def run(tmp_path):
    """The folder of a run that has written its config and nothing else."""
    config, _ = described()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(config_lib.to_json(config))
    return tmp_path / "run"


def test_a_bundled_robot_comes_first_and_all_others_after_it():
    names = policies.names(offer("go2"))
    trained = [
        n
        for n in files.bundled()
        if n not in files.robots() or files.find("robots", f"{n}/policy.npz")
    ]
    assert names[0] == "go2" and sorted(names) == trained and len(trained) > 7
    assert offer("go2").run is None
    other = policies.load(offer("go2"), "anymal_d_deploy")
    assert other.player.policy.robot == "anymal_d" and other.text == "robots/anymal_d/deploy.npz"


def test_a_run_without_a_policy_shows_its_robot_with_zero_actions(run):
    found = offer(run)
    assert policies.names(found)[0] == policies.NEWEST and not policies.begun(found)
    chosen = policies.load(found, policies.NEWEST)
    assert chosen.player.policy.robot == "go1" and "no policy yet" in chosen.text
    np.testing.assert_array_equal(chosen.act(np.ones(48)), np.zeros(12))


def test_the_newest_policy_of_a_run_is_the_one_in_its_file(run):
    save(run / "policy.npz", seed=3)
    chosen = policies.load(offer(run), policies.NEWEST)
    expected = policy_file.actor(actor(3), chosen.player.policy.activation)
    obs = np.linspace(-1, 1, 48)
    np.testing.assert_allclose(chosen.act(obs), expected(obs), atol=1e-6)


def test_a_newer_policy_is_seen_and_the_same_one_is_not(run, monkeypatch):
    monkeypatch.setattr(policies, "EVERY", 0.02)
    found, stop, seen = offer(run), threading.Event(), threading.Semaphore(0)
    args = found, policies.stamp(found), seen.release, stop
    thread = threading.Thread(target=policies.watch, args=args)
    thread.start()
    try:
        assert not seen.acquire(timeout=0.2)
        for seed in (1, 2):
            os.utime(save(run / "new.npz", seed), ns=(seed, seed))
            os.replace(run / "new.npz", run / "policy.npz")
            assert seen.acquire(timeout=PATIENCE)
        assert not seen.acquire(timeout=0.2)
    finally:
        stop.set()
        thread.join(PATIENCE)


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda run: run / "nothing", "no such file or folder"),
        (
            lambda run: (run / "config.json").unlink() or run,
            "neither a policy.npz nor checkpoints/; expected a workdir of `dynappo train`, or a policy.npz",
        ),
        (
            lambda run: (run / "config.json").unlink() or (run / "checkpoints").mkdir() or run,
            "neither a policy.npz nor checkpoints/; expected a workdir of `dynappo train`, or a policy.npz",
        ),
        (lambda run: (run / "config.json").write_text("{]") and run, "not the JSON of a config"),
    ],
)
def test_what_cannot_be_played_is_one_line(run, make, expected):
    found = offer(make(run))
    assert expected in refused(lambda: policies.load(found, policies.names(found)[0]))


def test_another_file_of_the_robot_is_only_for_what_was_named(run):
    save(run / "policy.npz")
    found = offer(run, xml=str(GO1.xml))
    assert policies.load(found, policies.NEWEST).player.xml == GO1.xml
    assert policies.load(found, "go2").player.policy.robot == "go2"


# ---- curves

HEADER = "iteration,sim_steps,seconds,episode_return,n_real,eval_return"


def test_curves_are_means_over_seeds_without_the_line_that_is_being_written(tmp_path):
    path = tmp_path / "metrics.csv"
    assert run_plots.read(path) == {}
    path.write_text(f"{HEADER}\n")
    assert run_plots.read(path) == {}
    path.write_text(
        f"{HEADER}\n1,10,0.5,1.0,8,\n1,10,0.5,3.0,8,\n2,20,1.0,,8,\n2,20,1.0,5.0,8,7\n3,30,1.5,2.0,8,1"
    )
    columns = run_plots.read(path)
    np.testing.assert_array_equal(columns["iteration"], [1, 2])
    np.testing.assert_array_equal(columns["episode_return"], [2, 5])
    np.testing.assert_array_equal(columns["eval_return"], [np.nan, 7])
    assert run_plots.line(columns) == "iteration 2, 0.00 M simulator steps, 1 s"


@pytest.mark.parametrize(
    ("change", "rows"),
    [
        (lambda text: "", 0),
        (lambda text: "\n\n\n", 0),
        (lambda text: text.replace("iteration", "iterations", 1), 0),
        (lambda text: text.replace(",seconds", "", 1), 0),
        (lambda text: text.replace(",10,", ",", 1), 1),
        (lambda text: text.replace("1,", "nan,", 1), 1),
        (lambda text: text.replace("1,", "x,").replace("2,", "inf,"), 0),
        (lambda text: text.replace("1.0", "inf"), 2),
        (lambda text: text.replace("1.0", "\0"), 2),
        (lambda text: text.replace("1.0", '"'), 0),
        (lambda text: text.replace("1.0", "y" * 2**18), 0),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_damaged_file_of_metrics_ends_no_page(tmp_path, change, rows):
    """What can be read is shown."""
    path = tmp_path / "metrics.csv"
    path.write_text(change(f"{HEADER}\n1,10,0.5,1.0,8,\n2,20,1.0,2.0,8,7\n"))
    columns = run_plots.read(path)
    assert len(columns.get("iteration", [])) == rows
    if rows:
        assert run_plots.line(columns) and len(run_plots.thinned(columns)["n_real"]) == rows


def test_long_runs_are_thinned_to_means():
    count = 5 * run_plots.MOST
    columns = {"iteration": np.arange(count) * 1.0, "n_real": np.full(count, np.nan)}
    few = run_plots.thinned(columns)
    np.testing.assert_allclose(few["iteration"], 5 * np.arange(run_plots.MOST) + 2)
    assert np.isnan(few["n_real"]).all()
    short = {"iteration": np.arange(3.0), "n_real": np.array([1.0, np.nan, 3.0])}
    np.testing.assert_array_equal(run_plots.thinned(short)["n_real"], [1, np.nan, 3])

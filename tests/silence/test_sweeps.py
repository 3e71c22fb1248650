"""A sweep's table: it ranks by what does not depend on what is swept, or not at all, and says which."""

import csv
import json

import numpy as np
import pytest
import workdirs
from ml_collections import config_dict
from rich.console import Console

from dynappo import config as config_lib
from dynappo.config import fields
from dynappo.config.stop import Stop
from dynappo.program import devices
from dynappo.run import learning_curves, training
from dynappo.sweeps import folder, grid, sweep_picture, table
from dynappo.sweeps import sweep as sweeps

BY = {  # what is swept -> how it is ranked
    "ppo.epochs=1,2": grid.BY_RETURN,
    "run.num_iterations=100,200": grid.BY_RETURN,
    "task.kp=20.0,30.0": grid.BY_RETURN,
    "task.noise.joint_vel=0.5,1.5": grid.BY_RETURN,
    "physics.impl=c,jax": grid.BY_RETURN,
    "task.weights.track_linear_velocity=1.5,15.0": grid.BY_ERRORS,
    "task.tracking_std=0.5,1.0": grid.BY_ERRORS,
    "task.fall_reward=-1.0,-2.0": grid.BY_ERRORS,
    "task.command_x=(-0.5,0.5),(0.2,1.0)": "",
    "task.episode_length=500,1000": "",
    "task.formulation=isaaclab,paper_text": "",
    "physics.timestep=0.004,0.005": "",
    "run.eval_steps=500,1000": "",
    "robot=go1,go2": "",
}


def combinations(*texts, **fields):
    config = config_dict.ConfigDict(workdirs.config(**fields).to_dict())
    return grid.combinations(config, grid.read(list(texts)))


@pytest.mark.parametrize("text", BY)
def test_the_measure_does_not_depend_on_what_is_swept(text):
    """Beside a field of the method, too, which changes nothing of it."""
    assert grid.ranked_by(combinations(text)) == BY[text]
    if not text.startswith("ppo"):
        assert grid.ranked_by(combinations("ppo.entropy_coef=0.1,0.2", text)) == BY[text]


def test_every_field_of_task_and_physics_has_its_place():
    """A new one is ranked by nothing until it is put into a list, and the lists name only fields."""
    names = [n.partition(".")[2] for n in fields.every() if n.startswith("task.")]
    known = {name.partition(".")[0] + "." * ("." in name) for name in names}
    assert {*grid.SAME_TASK, *grid.REWARD} <= known and not {*grid.SAME_TASK} & {*grid.REWARD}


def test_without_evaluations_and_in_ones_own_environment_a_task_is_not_ranked():
    """Returns of training have its noise; what get_env makes of a field nobody knows."""
    text = "task.noise.joint_vel=0.5,1.5"
    assert grid.ranked_by(combinations(text, run__eval_envs=0)) == ""
    own = [one._replace(env=object()) for one in combinations(text)]
    assert grid.ranked_by(own) == ""
    assert grid.ranked_by(combinations("ppo.epochs=1,2", run__eval_envs=0)) == grid.BY_RETURN


def test_on_rough_ground_the_tiles_crossed_are_the_measure():
    """Also where the reward is swept; not where the ground is, nor without an evaluation."""
    rough = {"task__terrain": "rough"}
    for text in ("ppo.epochs=1,2", "task.weights.track_linear_velocity=1.5,15.0"):
        assert grid.ranked_by(combinations(text, **rough)) == grid.BY_CROSSED
    assert (
        grid.ranked_by(combinations("ppo.epochs=1,2", run__eval_envs=0, **rough)) == grid.BY_RETURN
    )
    for text in ("task.terrain=flat,rough", "task.tiles.climb=1,2"):
        assert grid.ranked_by(combinations(text, **rough)) == ""


def of(error, falls, returns):
    return {"return": returns, "fall_rate": falls, "tracking_error": error, "yaw_error": 0.1}


@pytest.fixture
def rows(tmp_path, monkeypatch):
    """`rows(text)`: the table of four combinations, whose returns are the reverse of what they can do."""
    found = [of(0.5, 0.0, 90.0), of(0.1, 0.3, 50.0), of(0.1, 0.0, 30.0), of(0.2, 0.01, 20.0)]

    def rows(text):
        some = combinations(text)
        monkeypatch.setattr(
            folder,
            "summary",
            lambda _, one: {"evaluation": found[some.index(one)], "seconds": 1.0, "sim_steps": 9},
        )
        return table.rows(tmp_path, some)

    return rows


def test_rewards_are_not_compared_with_each_other(rows, capsys):
    """The best return belongs to the worst tracker; who falls comes last."""
    ranked = rows("task.weights.action_rate=-0.01,-0.02,-0.03,-0.04")
    assert [row["return_mean"] for row in ranked] == [30, 20, 90, 50]
    assert {row["ranked_by"] for row in ranked} == {"falls, then tracking error"}
    table.print_table(Console(width=150), ranked, ["task.weights.action_rate"])
    head, first, *_ = capsys.readouterr().out.splitlines()
    assert "error" in head.split() and "0.10 m/s" in first
    assert "changes the reward" in table.ranking(
        ranked[0]["ranked_by"], ["task.weights.action_rate"]
    )
    plain = rows("ppo.entropy_coef=0.1,0.2,0.3,0.4")
    assert [row["return_mean"] for row in plain] == [90, 50, 30, 20]
    assert table.ranking(plain[0]["ranked_by"], ["ppo.entropy_coef"]) == ""


def test_what_is_not_of_one_task_is_not_ranked(rows, tmp_path, monkeypatch):
    """In the order of the grid; the picture says so too."""
    some = rows("task.command_x=(-0.5,0.5),(0.2,1.0),(0.1,0.2),(0.3,0.4)")
    assert [row["return_mean"] for row in some] == [90, 50, 30, 20]
    assert "not ranked: task.command_x may change" in table.ranking("", ["task.command_x"])
    monkeypatch.setattr(
        sweep_picture.log,
        "read_csv",
        lambda *_: {"episode_return": np.ones(1), "sim_steps": np.ones(1)},
    )
    page = sweep_picture.figure(tmp_path, some, ["task.command_x"])
    assert page.get_suptitle() == "task.command_x (not ranked)"


def test_a_sweep_over_the_reward_keeps_the_policy_of_the_best_tracker(
    tmp_path, monkeypatch, capsys, program
):
    """Trained, with the toy environment; over commands it keeps none, not even one of before."""
    monkeypatch.setattr(devices, "own_process", lambda device: None)
    monkeypatch.setattr(learning_curves, "draw", lambda *_: "no picture")
    monkeypatch.setattr(training.merged, "program", lambda configs, *_: program())
    for text, kept in (
        ("task.weights.action_rate=-0.01", True),
        ("task.command_x=(-0.5,0.5)", False),
    ):
        config = config_dict.ConfigDict(workdirs.config().to_dict())
        swept = grid.read([text])
        asked = sweeps.Sweep(swept, config, grid.combinations(config, swept))
        out, stop = Console(width=200), Stop()
        workdir = tmp_path / str(kept)
        workdir.mkdir()
        (workdir / "policy.npz").write_text("of before")
        sweeps.train_all(out, asked, workdir, False, None, None, stop)
        said = capsys.readouterr().out
        assert (workdir / "policy.npz").exists() == kept
        assert ("ranked by falls, then" in said) == kept == ("not ranked" not in said)
        with (workdir / "sweep.csv").open(newline="") as file:
            (row,) = csv.DictReader(file)
        assert bool(row["ranked_by"]) == kept


def test_parts_of_a_program_that_go_on_apart_are_said(tmp_path, capsys, monkeypatch):
    """One has come further than the other: two programs where there was one."""
    some = combinations("ppo.entropy_coef=0.1,0.2")
    done = {some[0].name: 0, some[1].name: 0}
    monkeypatch.setattr(folder, "iterations_saved", lambda _, one: done[one.name])
    for iterations, said in ((0, False), (2, True)):
        done[some[0].name] = iterations
        sweeps._describe(Console(width=300), tmp_path, some)
        assert ("go on in a program" in capsys.readouterr().out.replace("goes", "go")) == said


def test_a_sweep_of_changed_code_is_refused(tmp_path):
    """A value added after the file of get_env has changed would be ranked beside others of the old one."""
    config = config_dict.ConfigDict(workdirs.config().to_dict())
    swept = grid.read(["ppo.epochs=1,2"])
    hold = {"swept": swept, "restore": None}
    for code, fine in (("aa", True), ("aa", True), ("bb", False)):
        config.code = code
        asked = {"config": config, "combinations": grid.combinations(config, swept)}
        try:
            with folder.opened(tmp_path / "sweep", **asked, **hold):
                pass
            assert fine
        except config_lib.ConfigError as error:
            assert not fine and "the file with get_env, or one that it imports, has changed" in str(
                error
            )
    assert json.loads((tmp_path / "sweep" / "sweep.json").read_text())["config"]["code"] == "aa"

"""21_less/run.py, and how jobs are named and told."""

import csv
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from result_files import script

from experiments import paper


def test_a_name_asks_for_its_job_or_for_all_that_begin_so():
    jobs = ["go2-blind-model", "go2-blind", "go2-best", "go1-best"]
    assert paper.chosen(jobs, []) == jobs
    assert paper.chosen(jobs, ["go2-blind"]) == ["go2-blind"]
    assert paper.chosen(jobs, ["go1", "go2-b", "go2-blind"]) == ["go1-best", *jobs[:3]]
    with pytest.raises(SystemExit, match="anymal: no job"):
        paper.chosen(iter(jobs), ["go2", "anymal"])


def test_a_seed_that_blew_up_is_told_with_its_first_iteration():
    """Not a loss in an iteration without a fit, nor returns before the first episode ends."""
    bad, nan = script("21_less/run").blown_up, np.nan
    losses = np.array([[1, 1, nan], [2, nan, nan], [nan, nan, nan]])  # iterations, seeds
    told = {"iteration": np.array([7, 8, 9]), "model_epochs": np.array([1, 1, 0])}
    returns = {"episode_return": np.full((3, 3), nan)}
    assert bad(told | returns | {"model_loss": losses}, 3, 1300) == {
        1: "seed 1301: model_loss is not finite in iteration 8\n",
        2: "seed 1302: model_loss is not finite in iteration 7\n",
    }
    assert bad(told | {"value_loss": np.array([1, nan, nan])}, 1, 0) == {
        0: "seed 0: value_loss is not finite in iteration 8\n"
    }
    assert bad(told | {"value_loss": np.ones((3, 3))}, 3, 0) == {}


def test_a_run_that_was_stopped_goes_on_from_its_last_evaluation(tmp_path, monkeypatch):
    """Stopped after two of four chunks, with a random key in its state: the rows of one that was not, though
    a minute had not gone by and the state is that of the first chunk. At another commit it does not."""
    run, stop_at, ran = script("21_less/run"), [None], []

    def step(hyper, state, columns):
        total, key = state
        if stop_at[0] == len(ran):
            raise KeyboardInterrupt
        ran.append(len(columns["sim_steps"]))
        key, noise = jax.random.split(key)
        return (total + jax.random.uniform(noise, (2,)), key), {"kl": np.ones((5, 2))}

    first = jnp.zeros(2), jax.random.key(7)
    program = types.SimpleNamespace(
        state=first,
        step=step,
        hyper=None,
        device="a card",
        columns={"sim_steps": np.arange(20), "iteration": np.arange(20)},
        evaluate=lambda state: {"return": state[0], "fall_rate": state[0]},
    )
    monkeypatch.setattr(run.build, "program", lambda config: program)
    monkeypatch.setattr(run.overflow, "check", lambda metrics: None)
    monkeypatch.setattr(run.versions, "commit", lambda: commit[0])
    commit = ["abc"]
    fields = "run.num_iterations=20 run.eval_every=5 run.num_seeds=2 run.device=cpu".split()

    def rows(name, states=None):
        run.run(tmp_path / name, "go1:ppo16", fields, states=states)
        text = list(csv.DictReader((tmp_path / f"{name}.csv").open(newline="")))
        return [{k: v for k, v in row.items() if k != "seconds"} for row in text]

    whole = rows("whole")
    assert len(whole) == 8 and ran == [5] * 4
    assert {(row["device"], row["commit"]) for row in whole} == {("a card", "abc")}
    ran.clear()
    stop_at[0] = 2
    with pytest.raises(KeyboardInterrupt):
        rows("cut", tmp_path / "states/cut")
    assert len((tmp_path / "cut.csv.part").read_text().splitlines()) == 5
    stop_at[0] = None
    before = (tmp_path / "states/cut").read_bytes()
    assert rows("cut", tmp_path / "states/cut") == whole and ran == [5] * 5
    assert not (tmp_path / "states/cut").exists()
    monkeypatch.setattr(run, "KEEP", 0.0)  # a minute has gone by at each evaluation
    ran.clear()
    stop_at[0] = 2
    with pytest.raises(KeyboardInterrupt):
        rows("often", tmp_path / "states/often")
    stop_at[0] = None
    assert rows("often", tmp_path / "states/often") == whole and ran == [5] * 4
    (tmp_path / "states/cut").write_bytes(before)
    commit[0] = "abc-dirty"
    with pytest.raises(SystemExit, match="'abc'.*, expected .*'abc-dirty'.*; remove it"):
        rows("cut", tmp_path / "states/cut")
    commit[0] = "abc"
    fields[0] = "run.num_iterations=30"
    with pytest.raises(SystemExit, match="iterations=20.* expected .*iterations=30.*; remove it"):
        rows("cut", tmp_path / "states/cut")


def test_a_run_tells_what_its_task_has():
    """Errors of a task with commands of ours, none of Playground's; on rough ground the curriculum's row."""
    measured, ones = script("21_less/run").measured, np.ones(2)
    evaluated = {"return": 3 * ones, "return_std": ones, "length": ones, "fall_rate": 0 * ones}
    found = measured(evaluated, {"reward": np.ones((4, 2))})
    assert list(found) == ["return", "fall_rate"] and list(found["return"]) == [3, 3]
    errors = {"yaw_error": ones, "tracking_error": ones}
    rows = {"terrain_row": np.array([[0.0, 1.0], [1.0, 4.0]])}
    found = measured(evaluated | errors, rows)
    assert list(found) == ["return", "fall_rate", "tracking_error", "yaw_error", "terrain_row"]
    assert list(found["terrain_row"]) == [0.5, 2.5]
    assert measured({"return": 3.0}, {"terrain_row": np.ones(4)})["terrain_row"].shape == (1,)


def test_a_line_of_changes_has_the_falls_of_the_package(monkeypatch):
    from dynappo.evaluate import changes as package

    script_of = script("21_less/changes")
    assert len(script_of.BUNDLED) == 8 and {"go1", "anymal_d_deploy"} <= set(script_of.BUNDLED)
    tours = [{"tour": "film", "seconds": 12.0, "fell_at": [1.0]}]
    monkeypatch.setattr(package, "tours", lambda body: tours)
    found = {"falls": 3, "start_falls": 1, "walks": 2}
    given = []
    monkeypatch.setattr(package, "run", lambda body, *more: given.append(more) or found)
    assert script_of.line("go1", 16, 5) == (
        "go1: falls after 3 of 16 changes, in 1 of 2 walks before the first, 1 in the tour of the film"
    )
    assert given == [(16, 5)]

"""The loop of a run: what it tells, that it goes on where it was stopped, to the bit."""

import contextlib
import errno
import gc
import json
import logging
import os
import shutil
import signal
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
import workdirs
from answers import refused, shell
from flax import struct
from ml_collections import config_dict
from toy_policy import params_in
from toy_runs import assert_same
from workdirs import N_REAL, loop, table

from dynappo import config as config_lib
from dynappo import schedule, terms, train, types
from dynappo.config import ConfigError
from dynappo.policy import checkpoint_file
from dynappo.program import build
from dynappo.run import checkpoint, finish, learning_curves, log, training
from dynappo.run import loop as loop_lib
from dynappo.run import workdir as workdir_lib

# ---- what it tells


def test_every_iteration_is_a_row_and_every_chunk_is_told(whole):
    """Documented columns first, counts exact; the file holds what `train` returns, to six digits."""
    rows = table(whole.workdir)
    first = "iteration sim_steps episode_return episode_length policy_std learning_rate kl"
    assert list(rows[0])[:7] == first.split()
    assert {"reward_x", "velocity_error", "falls", "value_loss", "model_loss"} <= set(rows[0])
    assert [row["iteration"] for row in rows] == ["1", "2", "3", "4"]
    assert [int(row["n_real"]) for row in rows] == N_REAL
    assert [int(row["n_synthetic"]) for row in rows] == [8 - n for n in N_REAL]
    assert [int(row["sim_steps"]) for row in rows] == list(16 * np.cumsum(N_REAL))
    back = log.read_csv(whole.workdir / "metrics.csv")
    assert back.keys() == whole.metrics.keys()
    for name, column in whole.metrics.items():
        assert column.shape == (4,)
        np.testing.assert_allclose(back[name], column, 1e-5, err_msg=name)
    assert [iteration for iteration, _ in whole.told] == [2, 4]
    for iteration, last in whole.told:
        for name, column in whole.metrics.items():
            np.testing.assert_array_equal(last[name], column[iteration - 1], name)
    seconds = whole.metrics["seconds"]
    assert (np.diff(seconds) > 0).all() and seconds[0] > 0


def test_after_its_last_fit_the_model_stays_and_its_losses_are_blank(config, program, tmp_path):
    """In the file, in what is read back, and in the picture; its error on new rows is still measured."""
    columns = {name: column.copy() for name, column in program().columns.items()}
    columns["model_epochs"][2:] = 0
    states, frozen = [], program()._replace(columns=columns)

    def step(hyper, state, chunk):
        out = program().step(hyper, state, chunk)
        states.append(jax.tree.map(np.array, out[0].model))
        return out

    _, metrics, _ = loop(config, frozen._replace(step=step), tmp_path)
    assert_same(*states)
    rows = table(tmp_path)
    for name in ("model_loss", "model_loss_before"):
        np.testing.assert_array_equal(np.isfinite(metrics[name]), [True, True, False, False])
        assert [bool(row[name]) for row in rows] == [True, True, False, False]
    assert all(float(row["model_error_1"]) > 0 for row in rows)
    back = log.read_csv(tmp_path / "metrics.csv")
    assert learning_curves.draw(back, tmp_path / "curves.png") == ""


def test_what_is_kept_of_a_chunk_is_its_own(config, program):
    """No view into a column of the whole run or a buffer of JAX: a long run would keep all of them."""
    run = training.Run(config)
    history = training.resume_and_loop([run], program()).runs[0].history
    assert [len(chunk["iteration"]) for chunk in history] == [2, 2]
    kept = [(name, column) for chunk in history for name, column in chunk.items()]
    assert [name for name, column in kept if column.base is not None] == []


def test_without_a_folder_nothing_is_written(config, program, whole, tmp_path, monkeypatch):
    """In a notebook: the same numbers, no file."""
    monkeypatch.chdir(tmp_path)
    state, metrics, told = loop(config, program())
    assert_same(state, whole.state)
    np.testing.assert_array_equal(metrics["episode_return"], whole.metrics["episode_return"])
    assert told == [2, 4] and list(tmp_path.iterdir()) == []


def test_evaluations_on_the_way_are_columns_and_say_which_checkpoint_is_best(
    config, program, tmp_path
):
    """Every `run.eval_every` iterations; a checkpoint without an evaluation has no worth."""
    often = config_dict.ConfigDict(config)
    often.run.eval_every = 4
    run = program()._replace(
        evaluate=lambda state: {"return": np.float32(3.5), "fall_rate": np.float32(0.25)}
    )
    _, metrics, _ = loop(often, run, tmp_path)
    np.testing.assert_array_equal(metrics["eval_return"], [np.nan] * 3 + [3.5])
    assert [row["eval_fall_rate"] for row in table(tmp_path)] == ["", "", "", "0.25"]
    with checkpoint.opened(tmp_path) as checkpoints:
        worth = {c.step: c.metrics for c in checkpoints.manager._checkpoints}
    assert worth[4] == {"eval_return": 3.5} and not worth[2]


def test_a_float_can_be_changed_without_compiling(program, config):
    """Another number goes into the same program and gives another policy."""
    run = program()
    hyper = run.hyper._replace(ppo=run.hyper.ppo._replace(clip_epsilon=0.05))
    one, _, _ = loop(config, program())
    other, _, _ = loop(config, run._replace(hyper=hyper))
    kernels = (s.learner.params["actor"]["params"]["Dense_0"]["kernel"] for s in (one, other))
    assert np.abs(np.subtract(*kernels)).max() > 1e-6


def test_a_robot_that_physics_cannot_compute_is_counted_and_training_goes_on(config, program):
    """NaN in one robot: its episode ends, and nothing of it reaches the networks."""
    run = program()
    prop = run.state.env_state.prop.at[3, 1].set(np.nan)
    broken = run.state.replace(env_state=run.state.env_state.replace(prop=prop))
    state, metrics, _ = loop(config, run._replace(state=broken))
    assert metrics["blowups"][0] == 1 and metrics["blowups"][1:].sum() == 0
    leaves = jax.tree.leaves((state.env_state, state.learner.params))
    assert all(np.isfinite(leaf).all() for leaf in leaves)


def test_a_term_of_ones_own_that_is_always_0_is_told_once(config, program, tmp_path):
    """After the first chunk; not one whose weight is 0 or None, nor one that pays somewhere."""
    path, weights = tmp_path / "mine.py", dict(x=1.0, effort=1.0, off=0.0, none=None)
    text = "@terms.reward(weight={})\ndef {}(command): return 0.0\n"
    of = "".join(text.format(weight, name) for name, weight in weights.items())
    path.write_text(f"from dynappo import terms\n{of}")
    config = config_lib.from_json(config_lib.to_json(config))
    terms.use(config, terms.read(path))
    whole, said = program(), []

    def step(*given):
        state, metrics = whole.step(*given)
        return state, metrics | {f"reward_{n}": metrics["reward_x"] * 0 for n in ("x", "off")}

    loop(config, whole._replace(step=step), say=said.append)
    assert [line for line in said if "reward" in line] == [
        "reward_x is 0 in every row so far; docs/task.md has unit and zero of what terms ask for"
    ]


def test_a_termination_of_ones_own_that_ends_every_row_is_told(tmp_path, config):
    path, text = (
        tmp_path / "mine.py",
        "@terms.termination()\ndef {}(command): return command.sum() < 9\n",
    )
    path.write_text("from dynappo import terms\n" + text.format("low") + text.format("rare"))
    config = config_lib.from_json(config_lib.to_json(config))
    terms.use(config, terms.read(path))
    chunk = {"ended_low": np.ones((2, 3), np.float32), "ended_rare": np.array([1.0, 0.9])}
    (line,) = loop_lib.of_own_terms(chunk, config)
    assert line.startswith(
        "ended_low is 1 in every row so far: each episode ends with its first row"
    )


# ---- nothing of the process is changed


@contextlib.contextmanager
def process_as_it_was():
    """JAX's settings, the levels of loggers, signal handlers, environment: all are the user's again."""
    names = "jax_platforms jax_use_shardy_partitioner jax_compilation_cache_dir".split()
    loggers = [logging.getLogger(name) for name in ("absl", "asyncio", "jax", "orbax", None)]
    handled = signal.SIGINT, signal.SIGTERM

    def settings():
        ours = [getattr(jax.config, name) for name in names], dict(os.environ)
        levels = [(logger.level, list(logger.handlers)) for logger in loggers]
        return *ours, levels, [signal.getsignal(number) for number in handled]

    levels = [logger.level for logger in loggers]
    try:
        for level, logger in enumerate(loggers, 21):  # of the user's own
            logger.setLevel(level)
        before = settings()
        yield
        assert settings() == before
    finally:
        for level, logger in zip(levels, loggers, strict=True):
            logger.setLevel(level)


def test_importing_changes_no_setting():
    """Of JAX and of logging; the package says which flags of XLA it sets."""
    code = """
import os
os.environ.pop("XLA_FLAGS", None)
import jax, logging, signal
def settings():
    names = "jax_platforms jax_use_shardy_partitioner jax_compilation_cache_dir".split()
    return [getattr(jax.config, name) for name in names] + [logging.getLogger("absl").level]
before, environment = settings(), dict(os.environ)
import dynappo.bench.command, dynappo.evaluate.command, dynappo.train.command
import dynappo.run.checkpoint, dynappo.program.build, dynappo.seeds
changed = {k for k, v in os.environ.items() if environment.get(k) != v}
print(settings() == before, sorted(changed), signal.getsignal(signal.SIGTERM).name)
"""
    done = shell("-c", code)
    assert done.stdout.splitlines()[-1] == "True ['XLA_FLAGS'] SIG_DFL", done.stdout + done.stderr


# ---- stopped, killed, gone on with


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(config, program, whole, tmp_path):
    """Interrupted after two iterations: every bit of state and every row is the same."""
    workdir = workdirs.opened(tmp_path / "run", config)

    def stop(iteration, last):
        assert iteration == 2
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        loop(config, program(), workdir, stop)
    assert workdirs.steps(workdir) == {"2"}  # waited for
    assert table(workdir) == table(whole.workdir)[:2]
    said = []
    state, metrics, told = loop(config, program(), workdir, say=said.append)
    assert told == [4] and said == [f"goes on from iteration 2 of {workdir}"]
    assert_same(state, whole.state)
    assert table(workdir) == table(whole.workdir)
    for name, column in whole.metrics.items():
        if name != "seconds":
            np.testing.assert_array_equal(metrics[name][2:], column[2:], name)
            np.testing.assert_allclose(metrics[name][:2], column[:2], 1e-5, err_msg=name)
    assert (np.diff(metrics["seconds"]) > 0).all()


def test_a_run_killed_right_after_a_checkpoint_lacks_no_row(
    config, program, whole, tmp_path, monkeypatch
):
    """The rows that a checkpoint covers are in the file before it is; what waits dies with the process."""
    save, said = workdir_lib.save, []

    def killed(*of):
        save(*of)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(workdir_lib, "save", killed)
        loop(config, program(), tmp_path)
    assert table(tmp_path) == table(whole.workdir)[:2] and workdirs.steps(tmp_path) == {"2"}
    state, _, told = loop(config, program(), tmp_path, say=said.append)
    assert told == [4] and said == [f"goes on from iteration 2 of {tmp_path}"]
    assert_same(state, whole.state)
    assert table(tmp_path) == table(whole.workdir)


@pytest.mark.parametrize("lost", ["checkpoints/4", "checkpoints"])
def test_rows_after_the_last_checkpoint_are_written_anew(config, program, whole, tmp_path, lost):
    """A run killed between its rows and their checkpoint repeats these rows, once; or all of them."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    shutil.rmtree(workdir / lost)
    state, _, told = loop(config, program(), workdir)
    assert told == ([4] if lost.endswith("4") else [2, 4])
    assert_same(state, whole.state)
    assert table(workdir) == table(whole.workdir)


def test_a_run_that_is_asked_to_stop_saves_and_returns(config, program, whole, tmp_path):
    """Between two chunks, also where no checkpoint is due; it goes on as if never stopped."""
    seldom = config_dict.ConfigDict(config)
    seldom.run.checkpoint_every = 4
    workdir = workdirs.opened(tmp_path / "run", config)
    _, metrics, _ = loop(seldom, program(), workdir, stop=True)
    assert list(metrics["iteration"]) == [1, 2]
    assert workdirs.steps(workdir) == {"2"} and (workdir / "policy.npz").exists()
    state, _, _ = loop(config, program(), workdir)
    assert_same(state, whole.state)


def test_a_finished_run_is_complete_and_can_be_made_longer(config, program, whole, tmp_path):
    """The rows that are there stay; fewer iterations than are done are refused."""
    workdir, said = tmp_path / "run", []
    shutil.copytree(whole.workdir, workdir)
    _, metrics, told = loop(config, program(), workdir, say=said.append)
    assert told == [] and said == [
        f"the run in {workdir} is complete (4 iterations); it is only evaluated again"
    ]
    np.testing.assert_allclose(metrics["episode_return"], whole.metrics["episode_return"], 1e-5)
    longer = workdirs.config(run__num_iterations=6, run__eval_envs=16)
    workdirs.opened(workdir, longer)
    more = program()._replace(columns=schedule.columns(longer))
    assert loop(longer, more, workdir)[2] == [6]
    rows = table(workdir)
    assert [row["iteration"] for row in rows] == ["1", "2", "3", "4", "5", "6"]
    assert rows[:4] == table(whole.workdir)
    kept = (workdir / "config.json").read_bytes()
    line = refused(workdirs.opened, workdir, config)  # before anything is compiled
    assert f"run.num_iterations is 4, but the run in {workdir} has done 6" in line
    assert (workdir / "config.json").read_bytes() == kept


@pytest.mark.parametrize("damage", ["gone", "columns", "a long cell"])
def test_a_finished_run_whose_metrics_are_lost_is_summed_up(
    config, program, whole, tmp_path, damage
):
    """What is not known is None; the steps are those of the schedule."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    csv = workdir / "metrics.csv"
    text = csv.read_text()
    lost = {
        "gone": None,
        "columns": "iteration,kl\n" + "".join(f"{i},0.01\n" for i in (1, 2, 3, 4)),
        "a long cell": text.replace("\n4,", f"\n4.{'0' * 200_000},", 1),
    }[damage]
    csv.unlink() if lost is None else csv.write_text(lost)
    state, metrics, _ = loop(config, program(), workdir, say=lambda line: None)
    np.testing.assert_array_equal(metrics["sim_steps"], whole.metrics["sim_steps"])
    summary = finish.summarise(config, program(), metrics, {})
    assert summary["iterations"] == 4 and summary["sim_steps"] == whole.metrics["sim_steps"][-1]
    if damage != "a long cell":
        assert summary["return"] is summary["seconds"] is None


@pytest.mark.parametrize("damage", ["gone", "cut"])
def test_a_run_whose_metrics_are_lost_goes_on_with_the_same_numbers(
    config, program, whole, tmp_path, damage
):
    """It says so; the steps are counted on, the rows after are those of the whole run."""
    workdir, said = tmp_path / "run", []
    shutil.copytree(whole.workdir, workdir)
    shutil.rmtree(workdir / "checkpoints" / "4")
    csv = workdir / "metrics.csv"
    csv.unlink() if damage == "gone" else csv.write_text(
        "".join(csv.read_text().splitlines(keepends=True)[:2])
    )
    state, metrics, _ = loop(config, program(), workdir, say=said.append)
    assert_same(state, whole.state)
    np.testing.assert_array_equal(metrics["sim_steps"], whole.metrics["sim_steps"])
    assert "are lost and stay empty" in said[0] and len(said) == 2
    rows, before = table(workdir), table(whole.workdir)
    assert [row["sim_steps"] for row in rows] == [row["sim_steps"] for row in before]
    assert all(rows[i][name] == before[i][name] for i in (2, 3) for name in before[i])


def test_a_run_goes_on_with_chunks_of_another_length(program, whole, tmp_path):
    """Of one iteration, and where it was shorter than a chunk: chunks end where the run stopped."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    for every, number in ((1, 1), (2, 2), (3, 1), (8, 2)):
        longer = workdirs.config(
            run__log_every=every, run__num_iterations=24, run__checkpoint_every=24
        )
        with workdir_lib.open_workdir(workdir, longer):
            assert workdir_lib.chunk_length(longer, workdir) == number


def test_a_damaged_checkpoint_is_moved_aside_and_the_one_before_is_taken(
    config, program, whole, tmp_path, capfd
):
    """A bit of every byte is flipped in the data: told in one line, and nobody else writes of it."""
    workdir, said = tmp_path / "run", []
    shutil.copytree(whole.workdir, workdir)
    for path in (workdir / "checkpoints" / "4" / "state").rglob("*"):
        if path.parent.name == "d":  # some of the bytes are of no array
            path.write_bytes(bytes(b ^ 1 for b in path.read_bytes()))
    state, _, _ = loop(config, program(), workdir, say=said.append)
    assert_same(state, whole.state)
    assert "checkpoint 4 is damaged" in said[0]
    assert said[1:] == [f"goes on from iteration 2 of {workdir}"]
    assert (workdir / "damaged-4").is_dir() and workdirs.steps(workdir) == {"2", "4"}
    gc.collect()  # where asyncio tells of errors that nobody has looked at
    assert capfd.readouterr().err == ""


def test_where_every_checkpoint_is_damaged_the_run_says_so(config, program, whole, tmp_path):
    """Nothing is deleted and nothing starts over by itself."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    for step in ("2", "4"):
        shutil.rmtree(workdir / "checkpoints" / step / "state" / "d")
    for _ in range(2):
        line = refused(loop, config, program(), workdir)
        assert "no checkpoint can be read any more" in line and "--fresh" in line
    assert {"damaged-2", "damaged-4", "metrics.csv"} <= {p.name for p in workdir.iterdir()}


def test_a_full_disk_is_told_and_training_goes_on(config, program, whole, tmp_path, monkeypatch):
    """Checkpoint 2 and the first rows cannot be written: later ones are, and no row is lost."""
    said, failing = [], [checkpoint.save, log._append]
    full = OSError(errno.ENOSPC, "No space left on device")

    def save(checkpoints, iteration, *args, **about):
        if iteration == 2:
            raise full
        return failing[0](checkpoints, iteration, *args, **about)

    def append(path, names, table, header):
        if len(table) == 2:  # of the first chunk; the second time there are four
            raise full
        return failing[1](path, names, table, header)

    monkeypatch.setattr(checkpoint, "save", save)
    monkeypatch.setattr(log, "_append", append)
    state, _, _ = loop(config, program(), tmp_path, say=said.append)
    assert_same(state, whole.state)
    assert [line.split(" could")[0] for line in said] == ["metrics.csv", "checkpoint 2"]
    assert all("No space left on device" in line and "\n" not in line for line in said)
    assert table(tmp_path) == table(whole.workdir)
    assert workdirs.steps(tmp_path) == {"4"}


ANY = "".join(map(chr, range(32, 127))).replace("/", "") + "é☃"


def test_a_run_in_a_folder_of_any_name_goes_on(config, program, whole, tmp_path, monkeypatch):
    """Every printable character in its name: all is written, and it goes on to the same bits."""
    monkeypatch.setattr(build, "program", lambda *_, **__: program())
    workdir, half = tmp_path / ANY, workdirs.config(run__num_iterations=2)
    train.train(half, workdir)
    state, _ = train.train(config, workdir)
    assert_same(state, whole.state)
    assert {p.name for p in workdir.iterdir()} >= whole.files.keys() - {"lock", *events(whole)}
    assert table(workdir) == table(whole.workdir) and list(tmp_path.iterdir()) == [workdir]


def events(whole):
    return [name for name in whole.files if name.startswith("events.")]


def test_a_first_checkpoint_that_cannot_be_read_back_ends_the_run(
    config, program, tmp_path, monkeypatch
):
    """At once, not after all iterations, whether the writer refuses, or fails in silence."""
    flat = checkpoint._flat
    wrong = {
        "zero size": lambda state: flat(state) | {"more": np.zeros((3, 0))},
        "learner/params/std is not in it": lambda state: {
            name: leaf for name, leaf in flat(state).items() if name != "learner/params/std"
        },
        "its numbers are not those": lambda state: flat(state) | {"lengths": np.zeros(100, "f4")},
    }
    for i, (reason, change) in enumerate(wrong.items()):
        told = []
        with monkeypatch.context() as patch:
            patch.setattr(checkpoint, "_flat", change)
            line = refused(
                loop, config, program(), tmp_path / f"{i}", lambda n, _, t=told: t.append(n)
            )
        assert reason in line and "could never be resumed" in line and told == [], line
        with monkeypatch.context() as patch:  # the last one is told, and all else is written before
            patch.setattr(checkpoint, "_flat", change)
            patch.setattr(build, "program", lambda *_, **__: program())
            workdir = tmp_path / f"end {i}"
            with pytest.raises((ConfigError, OSError), match="back: |could not be saved .Cannot"):
                train.train(workdirs.config(run__checkpoint_every=0), workdir)
        assert (workdir / "summary.json").exists()
    loop(config, program(), tmp_path / "good")


def test_a_later_checkpoint_is_not_read_back(config, program, tmp_path, monkeypatch):
    """The first has shown that it can be; that costs no time twice, and later faults are told."""
    reads, read = [], checkpoint_file.read
    monkeypatch.setattr(
        checkpoint_file, "read", lambda folder: reads.append(folder) or read(folder)
    )
    loop(config, program(), tmp_path)
    assert reads == [tmp_path / "checkpoints" / "2"]


def test_a_disk_that_is_full_or_fails_at_the_first_checkpoint_does_not_end_the_run(
    config, program, whole, tmp_path, monkeypatch
):
    """Also as tensorstore tells it, and where it cannot be read back now; the next is checked instead."""
    name = "local file: Failed to write 9 bytes to file 4: .. [os_error_code='28']"
    faults = [OSError(errno.ENOSPC, "x"), ValueError(f"OUT_OF_RANGE: Error: {name}"), MemoryError()]
    for i, fault in enumerate(faults):
        said, left = [], [1]

        def once(real, fault=fault, left=left):
            def call(*args, **about):
                if left:
                    left.pop()
                    raise fault
                return real(*args, **about)

            return call

        with monkeypatch.context() as patch:
            if i == 2:
                patch.setattr(checkpoint, "read_back", once(checkpoint.read_back))
            else:
                patch.setattr(checkpoint, "save", once(checkpoint.save))
            state, _, _ = loop(config, program(), tmp_path / f"{i}", say=said.append)
        assert_same(state, whole.state)
        assert len(said) == 1 and said[0].startswith("checkpoint 2 could not be written (")
        assert i == 2 or "No space left on device" in said[0]
        assert "4" in workdirs.steps(tmp_path / f"{i}")


def test_what_a_run_without_a_checkpoint_has_left_is_kept(config, program, whole, tmp_path):
    """It starts anew, and says so; its rows, its policy and its results are still there."""
    loop(config, program(), tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    for more in ("", ".1"):
        for step in (2, 4):
            shutil.rmtree(tmp_path / "checkpoints" / f"{step}")
        left = ["metrics.csv", "policy.npz"] + ["summary.json"] * (not more)
        there, said = [(tmp_path / name).read_bytes() for name in left], []
        loop(config, program(), tmp_path, say=said.append)
        kept = [f"{name}.old{more}" for name in left]
        assert said == [
            f"there is no checkpoint in {tmp_path}: it starts anew; what was there is now {', '.join(kept)}"
        ]
        assert [(tmp_path / name).read_bytes() for name in kept] == there
        assert table(tmp_path) == table(whole.workdir) and not (tmp_path / "summary.json").exists()


def test_checkpoints_that_may_not_be_listed_are_not_taken_for_none(
    config, program, whole, tmp_path, monkeypatch
):
    """A folder without permission, a disk that fails: nothing starts anew, nothing is changed."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    before, listed, scanned = workdirs.everything(workdir), os.listdir, os.scandir

    def denied(real):
        def call(path="."):
            if str(path).endswith("checkpoints"):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return real(path)

        return call

    with monkeypatch.context() as patch:
        patch.setattr(os, "listdir", denied(listed))
        patch.setattr(os, "scandir", denied(scanned))
        with pytest.raises(ConfigError, match="Permission denied"):
            workdirs.opened(workdir, config)
        with pytest.raises(PermissionError):
            loop(config, program(), workdir)
    after = workdirs.everything(workdir)
    assert {k: v for k, v in after.items() if k.name != "lock"} == {
        k: v for k, v in before.items() if k.name != "lock"
    }


# ---- several seeds, and a run killed by others


@pytest.mark.slow
def test_several_seeds_train_at_once(whole, tmp_path, monkeypatch):
    """A row an iteration and seed; the first seed is the run alone, and the run resumes."""
    workdirs.toy(monkeypatch)
    config, workdir = workdirs.config(run__num_seeds=2), tmp_path / "run"
    state, metrics = train.train(config, workdir)
    rows = table(workdir)
    pairs = [(str(i), str(s)) for i in (1, 2, 3, 4) for s in (0, 1)]
    assert [(row["iteration"], row["seed"]) for row in rows] == pairs
    assert [int(row["sim_steps"]) for row in rows[::2]] == list(16 * np.cumsum(N_REAL))
    returns = metrics["episode_return"]
    assert returns.shape == (4, 2) and metrics["sim_steps"].shape == (4,)
    np.testing.assert_allclose(returns[:, 0], whole.metrics["episode_return"], 1e-3, 1e-3)
    assert (returns[:, 0] != returns[:, 1]).all()
    again, back = train.train(config, workdir)
    assert_same(again, state)
    np.testing.assert_allclose(back["episode_return"], returns, 1e-5)


# ---- an environment of one's own


@pytest.mark.slow  # one of get_env trains in test_environment_page.py
def test_an_environment_that_is_handed_over_trains_to_the_bit_as_in_the_robots_place(
    config, whole, tmp_path
):
    """`train(config, workdir, env=...)`: the same rows and networks; the config names no robot. And a run
    that compiles, trains and is evaluated leaves the process as it was."""
    with process_as_it_was():
        state, metrics = train.train(config, tmp_path, env=toy_env.make())
    assert_same(state, whole.state)
    assert table(tmp_path) == table(whole.workdir)
    assert metrics["sim_steps"][-1] == 16 * sum(N_REAL)
    one, other = (params_in(folder / "policy.npz") for folder in (tmp_path, whole.workdir))
    assert_same(one, other)
    about = json.loads((tmp_path / "config.json").read_text())
    assert about["robot"] == "" and about["task"]["episode_length"] == 20
    again = refused(workdirs.opened, tmp_path, config)  # go1's
    assert "robot" in again and "--fresh" in again


@struct.dataclass
class Odd(toy_env.State):
    """A toy robot with what other engines carry besides."""

    more: Any = None


def odd(key):
    """Arrays of no number, of every kind of type, keys, and names with the marks that paths are made of."""
    return {
        "empty": jnp.zeros((0, 3)),
        "none": None,
        "key": jax.random.fold_in(key, 1),
        "rbg": jax.random.key(3, impl="rbg"),
        "a/b": {"bool": jnp.ones((), bool), "int8": jnp.ones(2, jnp.int8)},
        "a": {"b": {"bool": jnp.zeros(3, jnp.uint8)}, "bfloat16": (jnp.ones(2, jnp.bfloat16),)},
        "metrics": {"reward/x": jnp.ones(()), "reward.x": jnp.zeros(()), "": jnp.ones(2)},
    }


def odd_env():
    """The toy environment with `odd` in its state; what can change of that does so in every step."""
    env = toy_env.make()

    def reset(hyper, body, key):
        return Odd(**vars(env.reset(hyper, body, key)), more=odd(key))

    def step(hyper, body, state, action, key):
        more = dict(state.more, key=jax.random.split(state.more["key"])[0])
        more["a/b"] = jax.tree.map(jnp.logical_not, more["a/b"] | {"int8": jnp.ones(2, bool)})
        more["a"] = jax.tree.map(lambda x: x + 1, more["a"])
        after, outcome = env.step(hyper, body, state, action, key)
        more["a/b"]["int8"] = state.more["a/b"]["int8"] + 1
        return after.replace(more=more), outcome

    return env._replace(reset=reset, step=step, autoreset=types.autoreset(reset))


@pytest.mark.slow  # compiles twice
def test_a_run_that_remembers_goes_on_to_the_bit(tmp_path):
    """Its ring and where that begins, too: rows of the first half are drawn in the second."""
    more = dict(schedule__rounds=2, rollout__imagined=2, model__memory=11)
    more |= dict(model__remembered=2, schedule__anchors=11)
    whole, _ = train.train(workdirs.config(**more), tmp_path / "whole", env=toy_env.make())
    assert whole.memory.weight.any()
    half = workdirs.config(run__num_iterations=2, **more)
    train.train(half, tmp_path / "run", env=toy_env.make())
    state, _ = train.train(workdirs.config(**more), tmp_path / "run", env=toy_env.make())
    assert_same(state, whole)
    assert table(tmp_path / "run") == table(tmp_path / "whole")


@pytest.mark.slow  # 30 s of compiling, twice
def test_a_run_of_an_environment_with_any_state_goes_on_to_the_bit(tmp_path):
    """Its second half, after a stop, is that of the run without one."""
    whole, _ = train.train(workdirs.config(), tmp_path / "whole", env=odd_env())
    assert whole.env_state.more["empty"].size == 0
    half = workdirs.config(run__num_iterations=2)
    train.train(half, tmp_path / "run", env=odd_env())
    state, _ = train.train(workdirs.config(), tmp_path / "run", env=odd_env())
    assert_same(state, whole)
    assert table(tmp_path / "run") == table(tmp_path / "whole")

"""Checkpoints: every bit comes back, the best in an evaluation is kept, damage is one line."""

import errno
import json
import logging
import pathlib
import shutil
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest
import toy_env
import workdirs
from answers import refused
from toy_runs import assert_same
from workdirs import N_REAL

from dynappo import algorithm
from dynappo.train import checkpoint


@pytest.fixture(scope="module")
def state():
    """`state(fields)`: a TrainState of the toy environment, every leaf of it made different."""

    def make(fields):
        _, static, hyper = toy_env.settings(fields)
        state = algorithm.init(toy_env.make(), hyper, jax.random.key(3), static=static)
        leaves, tree = jax.tree.flatten(state)
        new = []
        for i, x in enumerate(leaves):
            is_float = jnp.issubdtype(x.dtype, jnp.floating)
            new.append(x + np.float32(np.pi) * (i + 1) if is_float else x)
        state = jax.tree.unflatten(tree, new)
        return state.replace(returns=state.returns.at[:7].set(jnp.arange(7) / 3))

    return make


FALLS = {"model.clean": True, "model.falls": True}
KINDS = {"plain": {}, "tail": toy_env.TAIL, "falls": toy_env.TAIL | FALLS}


@pytest.fixture(scope="module")
def plain(state):
    """A state without a model."""
    return state(KINDS["plain"])


def save(workdir, some, **how):
    """Save `{iteration: state}` in a workdir, with nobody to tell of problems; the folder they are in."""
    with checkpoint.opened(workdir, pytest.fail) as checkpoints:
        for iteration, state in some.items():
            checkpoint.save(checkpoints, iteration, state, **how)
    return workdir / "checkpoints"


def restore(workdir, like, say=pytest.fail):
    """What a run finds that begins in a workdir."""
    with checkpoint.opened(workdir, say) as checkpoints:
        return checkpoint.newest(checkpoints, like, say)


# ---- every bit comes back


@pytest.mark.parametrize("kind", KINDS)
def test_a_state_comes_back_to_the_bit(tmp_path, state, kind):
    """Weights, moments, physics, rings with NaN and the typed key, with a model and without."""
    there = state(KINDS[kind])
    assert (there.model is None) == (kind == "plain")
    save(tmp_path, {20: there})
    blank = jax.tree.map(
        lambda x: x if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else x * 0, there
    ).replace(key=jax.random.key(99))
    iteration, back = restore(tmp_path, blank)
    assert iteration == 20
    assert_same(back, there)
    np.testing.assert_array_equal(  # and the key works
        jax.random.normal(back.key, (3,)), jax.random.normal(there.key, (3,))
    )


def test_several_seeds_come_back_to_the_bit(tmp_path, plain):
    """A state with a seed axis in front, as `run.num_seeds` makes it."""
    seeds = jax.tree.map(lambda x: jnp.stack([x, x]), plain)
    save(tmp_path, {1: seeds})
    assert_same(restore(tmp_path, seeds)[1], seeds)


def test_a_state_can_be_given_away_while_it_is_saved(tmp_path, plain):
    """`save` has copied the arrays when it returns: the trainer donates them at once."""
    state = jax.tree.map(jnp.copy, plain)
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        checkpoint.save(checkpoints, 1, state)
        gone = jax.jit(lambda s: jax.tree.map(lambda x: x, s), donate_argnums=0)(state)
        jax.tree.map(lambda x: x.delete(), gone)
    assert_same(restore(tmp_path, plain)[1], plain)


def test_what_a_checkpoint_says_about_itself(whole, config):
    """Iteration, exact simulator steps, the config, and a hash that the arrays have."""
    about = json.loads((whole.workdir / "checkpoints" / "4" / "about" / "metadata").read_text())
    assert about["iteration"] == 4 and about["sim_steps"] == 16 * sum(N_REAL)
    assert about["config"] == json.loads(json.dumps(config.to_dict()))
    assert about["sha256"] == checkpoint.digest(whole.state)
    iteration, state = restore(whole.workdir, whole.state)
    assert iteration == 4
    assert_same(state, whole.state)


# ---- which are kept


def test_the_newest_three_are_kept_and_the_newest_is_restored(tmp_path, plain):
    """By iteration, 9 before 10; a save that was killed counts as none; at first there is nothing."""
    assert restore(tmp_path, plain) is None
    states = {i: plain.replace(lengths=jnp.full(100, float(i))) for i in (8, 9, 10, 11)}
    folder = save(tmp_path, states)
    assert workdirs.steps(tmp_path) == {"9", "10", "11"}
    shutil.copytree(folder / "11", folder / "12.orbax-checkpoint-tmp-0")
    iteration, back = restore(tmp_path, plain)
    assert iteration == 11 and (back.lengths == 11).all()


def test_the_best_in_an_evaluation_is_kept_beside_the_newest(tmp_path, plain):
    """One without an evaluation is never the best, whatever its training episodes were worth."""
    worth = {1: 3.0, 2: 9.0, 3: 5.0, 4: None, 5: 1.0, 6: 2.0}
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        for iteration, eval_return in worth.items():
            checkpoint.save(checkpoints, iteration, plain, eval_return)
    assert workdirs.steps(tmp_path) == {"2", "4", "5", "6"}
    assert restore(tmp_path, plain)[0] == 6


def test_without_an_evaluation_no_checkpoint_is_the_best(tmp_path, plain):
    save(tmp_path, dict.fromkeys(range(1, 7), plain))
    assert workdirs.steps(tmp_path) == {"4", "5", "6"}


def test_checkpoints_of_before_with_the_return_of_training_episodes_are_still_good(tmp_path, plain):
    """They can be gone on from, and an evaluated one is better than any of them."""
    args = ocp.args.Composite(
        state=ocp.args.StandardSave(checkpoint._raw(plain)),
        about=ocp.args.JsonSave(
            {
                "iteration": 1,
                "arrays": checkpoint.shapes(plain),
                "sha256": checkpoint.digest(plain),
            }
        ),
    )
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        checkpoints.save(1, args=args, metrics={"episode_return": 99.0}, force=True)
    iteration, state = restore(tmp_path, plain)
    assert iteration == 1
    assert_same(state, plain)
    save(tmp_path, {2: plain}, eval_return=-5.0)
    save(tmp_path, dict.fromkeys((3, 4, 5), plain))
    assert workdirs.steps(tmp_path) == {"2", "3", "4", "5"}


# ---- another run's


@pytest.mark.parametrize(
    ("there", "here", "differs"),
    [
        ({}, {"rollout.num_envs": 32}, "float32[16,3] there, float32[32,3] here"),
        ({}, {"ppo.hidden": (16, 8)}, "Dense_1/bias is float32[16] there, float32[8] here"),
        ({}, toy_env.TAIL, "absent there"),
        (toy_env.TAIL, {}, "absent here"),  # nothing of it is silently left out
    ],
    ids=["robots", "network", "model", "no model"],
)
def test_a_checkpoint_of_another_shape_is_refused_in_one_line(
    tmp_path, state, there, here, differs
):
    """The first array that differs, with both shapes; the checkpoint is not taken for a damaged one."""
    folder = save(tmp_path, {5: state(there)})
    line = refused(restore, tmp_path, state(here))
    assert line.startswith(f"{folder.resolve() / '5'} is not a checkpoint of this run: ")
    assert differs in line and line.endswith("choose another --workdir")
    assert (folder / "5").is_dir()


# ---- damaged


def test_damaged_checkpoints_are_passed_over_one_by_one(tmp_path, plain):
    """The JSON of one, the arrays of another; the third is good, and both can be written again."""
    folder = save(tmp_path, {4: plain, 5: plain, 6: plain}, eval_return=1.0)
    (folder / "6" / "metrics" / "metrics").write_text("{")
    shutil.rmtree(folder / "5" / "state" / "d")
    said = []
    assert restore(tmp_path, plain, said.append)[0] == 4
    assert {p.name for p in tmp_path.glob("damaged-*")} == {"damaged-5", "damaged-6"}
    assert ["checkpoint 6 is damaged" in said[0], "checkpoint 5 is damaged" in said[1]] == [
        True
    ] * 2
    assert all("an older one is taken" in line and "\n" not in line for line in said)
    save(tmp_path, {5: plain})
    assert restore(tmp_path, plain)[0] == 5


@pytest.mark.parametrize("damage", ["empty", "cut", "item"])
def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path, plain, damage):
    """Files of no bytes, files cut in half, or the arrays missing."""
    folder = save(tmp_path, {5: plain})
    if damage == "item":
        shutil.rmtree(folder / "5" / "state")
    else:
        for file in [p for p in pathlib.Path(folder / "5").rglob("*") if p.is_file()]:
            data = file.read_bytes()
            file.write_bytes(data[: len(data) // 2] if damage == "cut" else b"")
    said = []
    line = refused(restore, tmp_path, plain, said.append)
    assert "no checkpoint can be read any more" in line and "--workdir" in line and len(said) == 1
    assert (tmp_path / "damaged-5").is_dir() and not (folder / "5").exists()


FAULTS = [
    OSError(errno.EIO, "Input/output error"),
    OSError(errno.EMFILE, "Too many open files"),
    MemoryError(),
]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda error: str(error) or "memory")
def test_what_cannot_be_read_now_is_not_damaged(tmp_path, plain, monkeypatch, fault):
    """Whichever file it is that the machine does not give: the fault is told, and nothing is moved."""
    folder = save(tmp_path, {4: plain, 5: plain}, eval_return=1.0)
    before, read = workdirs.everything(tmp_path), pathlib.Path.read_bytes
    reads = []

    def counted(path):
        reads.append(path)
        return read(path)

    with monkeypatch.context() as patch:
        patch.setattr(pathlib.Path, "read_bytes", counted)
        assert restore(tmp_path, plain)[0] == 5
    names = [path for path in dict.fromkeys(reads) if tmp_path in path.parents]
    assert len(names) > 8 and any("state" in path.parts for path in names)
    for bad in names:

        def fails(path, bad=bad):
            if path == bad:
                raise fault
            return read(path)

        with monkeypatch.context() as patch, pytest.raises(type(fault)):
            patch.setattr(pathlib.Path, "read_bytes", fails)
            restore(tmp_path, plain)
        assert workdirs.everything(tmp_path) == before
    assert restore(tmp_path, plain)[0] == 5 and (folder / "5").is_dir()


@pytest.mark.parametrize("name", ["about/metadata", "_CHECKPOINT_METADATA", "metrics/metrics"])
@pytest.mark.parametrize(
    "text", ["[]", "{", "", "null", "[" * 100_000, "gone", '{"eval_return": "x"}']
)
def test_a_text_that_is_not_what_was_written_is_damage(tmp_path, plain, name, text):
    """And the next save is kept."""
    folder, said = save(tmp_path, {4: plain, 5: plain}, eval_return=1.0), []
    path = folder / "5" / name
    path.unlink() if text == "gone" else path.write_text(text)
    whole = name == "_CHECKPOINT_METADATA" and text[:2] == '{"'  # of that only orbax reads more
    assert restore(tmp_path, plain, said.append)[0] == (5 if whole else 4)
    assert whole or ("checkpoint 5 is damaged" in said[0] and len(said) == 1)
    save(tmp_path, {6: plain}, eval_return=2.0)
    assert "6" in workdirs.steps(tmp_path)


def test_other_numbers_than_were_saved_are_damage(tmp_path, plain):
    """Found by the hash of all arrays."""
    folder = save(tmp_path, {4: plain, 5: plain})
    workdirs.other_hash(folder / "5")
    said = []
    assert restore(tmp_path, plain, said.append)[0] == 4
    assert "its numbers are not those that were saved" in said[0]


def test_a_disk_that_is_too_full_is_an_error_before_anything_is_written(
    tmp_path, plain, monkeypatch
):
    """The message has both numbers; with room it is saved."""
    size = sum(x.nbytes for x in jax.tree.leaves(plain))
    free = [size, 2 * size]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free[0]))
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        with pytest.raises(OSError, match="No space left on device: .* MB needed, .* MB free"):
            checkpoint.save(checkpoints, 5, plain)
        assert not workdirs.steps(tmp_path)
        del free[0]
        checkpoint.save(checkpoints, 5, plain)
    assert restore(tmp_path, plain)[0] == 5


# ---- the loggers


def test_orbaxs_loggers_are_silent_meanwhile_and_as_they_were_afterwards(tmp_path, caplog):
    """Also where it is interrupted; of asyncio, what is not orbax's is still told."""
    logger, told = logging.getLogger("absl"), sys.unraisablehook
    before = logger.level
    try:
        logger.setLevel(17)
        with pytest.raises(KeyboardInterrupt), checkpoint.opened(tmp_path):
            assert not logger.isEnabledFor(logging.ERROR)
            sys.unraisablehook(SimpleNamespace(exc_value=RuntimeError("Event loop is closed")))
            raise KeyboardInterrupt
        assert logger.level == 17 and sys.unraisablehook is told
    finally:
        logger.setLevel(before)
    caplog.clear()
    for text in ("a task of somebody else's", "future: <Task of site-packages/orbax/x.py>"):
        logging.getLogger("asyncio").error(text)
    assert [record.message for record in caplog.records] == ["a task of somebody else's"]

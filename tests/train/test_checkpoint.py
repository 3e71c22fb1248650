"""Checkpoints: every bit comes back, and one that does not fit is said so in one line."""

import pathlib
import shutil
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env

from dynappo import algorithm
from dynappo.config import ConfigError
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


@pytest.fixture(scope="module")
def plain(state):
    """A state without a model."""
    return state({})


@pytest.fixture(scope="module")
def tail(state):
    """A state with a model."""
    return state(toy_env.TAIL)


@pytest.fixture(scope="module")
def ideas(state):
    """A state with everything that a model may carry beside its networks."""
    on = {"model.clean": True, "model.private": True, "model.history": 2, "model.ensemble": 2}
    return state(toy_env.TAIL | on | {"model.bounds": True, "schedule.by_error": True})


@pytest.fixture
def checkpoints(tmp_path):
    """`checkpoints()` is a manager of the test's own workdir."""
    made = []

    def make():
        made.append(checkpoint.manager(tmp_path))
        return made[-1]

    yield make
    for manager in made:
        manager.close()


def assert_same(one, other):
    """Two states are equal to the bit, keys included, NaN equal to NaN."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for (path, x), y in zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True):
        assert x.dtype == y.dtype and x.shape == y.shape
        if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        np.testing.assert_array_equal(x, y, jax.tree_util.keystr(path))


@pytest.mark.parametrize("kind", ["plain", "tail", "ideas"])
def test_a_state_comes_back_to_the_bit(checkpoints, request, kind):
    """Weights, moments, physics, rings with NaN and the typed key, with a model and without."""
    state = request.getfixturevalue(kind)
    assert (state.model is None) == (kind == "plain")
    first = checkpoints()
    checkpoint.save(first, 20, state)
    first.wait_until_finished()
    blank = jax.tree.map(
        lambda x: x if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else x * 0, state
    ).replace(key=jax.random.key(99))
    iteration, back = checkpoint.restore(checkpoints(), blank)
    assert iteration == 20
    assert_same(back, state)
    np.testing.assert_array_equal(  # and the key works
        jax.random.normal(back.key, (3,)), jax.random.normal(state.key, (3,))
    )


def test_several_seeds_come_back_to_the_bit(checkpoints, plain):
    """A state with a seed axis in front, as `run.num_seeds` makes it."""
    seeds = jax.tree.map(lambda x: jnp.stack([x, x]), plain)
    manager = checkpoints()
    checkpoint.save(manager, 1, seeds)
    manager.wait_until_finished()
    assert_same(checkpoint.restore(manager, seeds)[1], seeds)


def test_a_state_can_be_given_away_while_it_is_saved(checkpoints, plain):
    """`save` has copied the arrays when it returns: the trainer donates them at once."""
    state = jax.tree.map(jnp.copy, plain)
    manager = checkpoints()
    checkpoint.save(manager, 1, state)
    gone = jax.jit(lambda s: jax.tree.map(lambda x: x, s), donate_argnums=0)(state)
    jax.tree.map(lambda x: x.delete(), gone)
    manager.wait_until_finished()
    assert_same(checkpoint.restore(manager, plain)[1], plain)


def test_without_a_checkpoint_there_is_nothing_to_restore(checkpoints, plain):
    """A new workdir gives None."""
    assert checkpoint.restore(checkpoints(), plain) is None


def test_the_newest_of_the_last_three_is_restored(checkpoints, plain):
    """By iteration, 9 before 10; older ones are deleted."""
    manager = checkpoints()
    for iteration in (8, 9, 10, 11):
        state = plain.replace(lengths=jnp.full(100, float(iteration)))
        checkpoint.save(manager, iteration, state)
    manager.wait_until_finished()
    iteration, back = checkpoint.restore(checkpoints(), plain)
    assert iteration == 11 and (back.lengths == 11).all()
    folder = manager.directory
    assert sorted(int(p.name) for p in folder.iterdir()) == [9, 10, 11]


def test_the_best_is_kept_beside_the_newest(checkpoints, plain):
    """By the return it was saved with; one without a return is never the best."""
    manager = checkpoints()
    for iteration, worth in ((1, 3.0), (2, 9.0), (3, 5.0), (4, np.nan), (5, 1.0), (6, 2.0)):
        checkpoint.save(manager, iteration, plain, worth)
    manager.wait_until_finished()
    steps = sorted(int(p.name) for p in manager.directory.iterdir())
    assert steps == [2, 4, 5, 6]
    assert checkpoint.restore(checkpoints(), plain)[0] == 6


def test_damaged_checkpoints_are_passed_over_one_by_one(checkpoints, plain):
    """The JSON of one, the arrays of another; the third is good, and both can be written again."""
    manager = checkpoints()
    for iteration in (4, 5, 6):
        checkpoint.save(manager, iteration, plain)
    manager.wait_until_finished()
    (manager.directory / "6" / "metrics" / "metrics").write_text("{")
    shutil.rmtree(manager.directory / "5" / "state" / "d")
    said, again = [], checkpoints()
    assert checkpoint.restore(again, plain, said.append)[0] == 4
    folder = manager.directory.parent
    assert {p.name for p in folder.glob("damaged-*")} == {"damaged-5", "damaged-6"}
    assert len(said) == 1 and "checkpoint 5 is damaged" in said[0]
    checkpoint.save(again, 5, plain)
    again.wait_until_finished()
    assert checkpoint.restore(checkpoints(), plain)[0] == 5


def assert_one_line(error, folder):
    """The message names the folder, says what to do, and is one line."""
    text = str(error.value)
    assert "\n" not in text and str(folder) in text and "--workdir" in text


@pytest.mark.parametrize(
    "fields",
    [{"rollout.num_envs": 32}, {"ppo.hidden": (16, 8)}, toy_env.TAIL],
    ids=["robots", "network", "model"],
)
def test_a_checkpoint_of_another_shape_is_refused_in_one_line(checkpoints, state, plain, fields):
    """Other robots, another network, or a model where there was none."""
    manager = checkpoints()
    checkpoint.save(manager, 5, plain)
    manager.wait_until_finished()
    with pytest.raises(ConfigError) as error:
        checkpoint.restore(manager, state(fields))
    assert_one_line(error, manager.directory / "5")


def test_a_checkpoint_with_a_model_is_no_checkpoint_of_plain_ppo(checkpoints, plain, tail):
    """Nothing of it is silently left out."""
    manager = checkpoints()
    checkpoint.save(manager, 5, tail)
    manager.wait_until_finished()
    with pytest.raises(ConfigError) as error:
        checkpoint.restore(manager, plain)
    assert_one_line(error, manager.directory / "5")


@pytest.mark.parametrize("damage", ["empty", "cut", "item"])
def test_a_damaged_checkpoint_is_refused_in_one_line(checkpoints, plain, damage):
    """Files of no bytes, files cut in half, or the arrays missing."""
    manager = checkpoints()
    checkpoint.save(manager, 5, plain)
    manager.wait_until_finished()
    folder = manager.directory / "5"
    if damage == "item":
        shutil.rmtree(folder / "state")
    else:
        for file in [p for p in pathlib.Path(folder).rglob("*") if p.is_file()]:
            data = file.read_bytes()
            file.write_bytes(data[: len(data) // 2] if damage == "cut" else b"")
    with pytest.raises(ConfigError, match="no checkpoint can be read") as error:
        checkpoint.restore(checkpoints(), plain)
    assert_one_line(error, manager.directory)
    assert (manager.directory.parent / "damaged-5").is_dir() and not folder.exists()


def test_a_disk_that_is_too_full_is_an_error_before_anything_is_written(
    checkpoints, plain, monkeypatch
):
    """The message has both numbers; with room it is saved."""
    manager = checkpoints()
    size = sum(x.nbytes for x in jax.tree.leaves(plain))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=size))
    with pytest.raises(OSError, match="No space left on device: .* MB needed, .* MB free"):
        checkpoint.save(manager, 5, plain)
    assert not list(manager.directory.iterdir())
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=2 * size))
    checkpoint.save(manager, 5, plain)
    checkpoint.finish(manager)
    assert checkpoint.restore(checkpoints(), plain)[0] == 5


def test_an_unfinished_checkpoint_is_not_taken(checkpoints, plain):
    """A folder that a killed run left with orbax's temporary name counts as none."""
    manager = checkpoints()
    checkpoint.save(manager, 5, plain)
    manager.wait_until_finished()
    finished = manager.directory / "5"
    shutil.copytree(finished, manager.directory / "6.orbax-checkpoint-tmp-0")
    iteration, _ = checkpoint.restore(checkpoints(), plain)
    assert iteration == 5

"""Checkpoints: every bit comes back, the best in an evaluation is kept, damage is one line."""

import errno
import functools
import json
import logging
import pathlib
import shutil
import sys
import tempfile
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest
import tensorstore
import toy_env
import workdirs
from answers import refused
from toy_runs import assert_same
from workdirs import N_REAL

from dynappo import algorithm
from dynappo.config import ConfigError
from dynappo.policy import checkpoint_file
from dynappo.program import distributed
from dynappo.run import checkpoint


@pytest.fixture(scope="module")
def state():
    """`state(fields)`: a TrainState of the toy environment, every leaf of it made different."""

    @functools.cache
    def make(items):
        _, static, hyper = toy_env.settings(dict(items))
        begin = jax.jit(partial(algorithm.init, toy_env.make(), static=static))
        state = begin(hyper, jax.random.key(3))
        leaves, tree = jax.tree.flatten(state)
        for i, x in enumerate(leaves):
            if jnp.issubdtype(x.dtype, jnp.floating):
                leaves[i] = jnp.asarray(np.asarray(x) + np.float32(np.pi) * (i + 1))
        state = jax.tree.unflatten(tree, leaves)
        return state.replace(returns=state.returns.at[:7].set(jnp.arange(7) / 3))

    return lambda fields: make(tuple(fields.items()))


FALLS = {"model.clean": True, "model.falls": True}
REMEMBERS = toy_env.TAIL | {"model.memory": 9, "model.remembered": 1}
KINDS = {
    "plain": {},
    "tail": toy_env.TAIL,
    "falls": toy_env.TAIL | FALLS,
    "memory": REMEMBERS | FALLS,
}


@pytest.fixture(scope="module")
def plain(state):
    """A state without a model."""
    return state(KINDS["plain"])


@pytest.fixture(scope="module")
def small():
    """Three arrays: what a folder goes through is the same with thirty."""
    return {"a": jnp.arange(300.0) ** 2, "b": {"c": jnp.ones((20, 30)), "d": jnp.ones(())}}


@pytest.fixture(scope="module")
def saved(small, tmp_path_factory):
    """A workdir in which `small` was saved and evaluated in iterations 4 and 5."""
    folder = tmp_path_factory.mktemp("saved")
    save(folder, {4: small, 5: small}, evaluation={"return": 1.0})
    return folder


@pytest.fixture
def two(saved, tmp_path):
    """The checkpoints 4 and 5 of `saved`, in the test's own folder."""
    return pathlib.Path(shutil.copytree(saved / "checkpoints", tmp_path / "checkpoints"))


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
    assert (there.memory is None) == (kind != "memory")
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


ODD = {
    "none": lambda: {"a": None, "b": (None, [None, jnp.arange(3.0)], {}), "c": ()},
    "names": lambda: {k: {k: {k: jnp.arange(3) + len(k)}} for k in ["", " ", "..", "é", "\n", "[*?", '""']},
    "one name": lambda: {
        "a.b": jnp.zeros(2),
        "a": {"b": jnp.ones(2), "b/c": jnp.full(2, 2.0), "b+": jnp.full(2, 5.0)},
        "a/b": {"": jnp.full(2, 3.0), "c": jnp.full(2, 4.0)},
    },
    "empty": lambda: {"a": jnp.ones((3, 0)), "b": jnp.ones(0, bool), "c": jnp.ones(())},
    "no keys": lambda: {"a": jax.random.split(jax.random.key(0), 0), "c": jnp.ones(())},
    "key": lambda: {"a": jax.random.split(jax.random.key(0), 4), "b": jax.random.PRNGKey(1)},
    "rbg": lambda: {"a": jax.random.split(jax.random.key(0, impl="rbg"), 4)},
    "nan": lambda: {"a": jnp.array([0x7FC00001, 0xFFFFFFFF, 1 << 31], jnp.uint32).view(jnp.float32)},
} | {
    dtype: lambda dtype=dtype: {"a": jnp.arange(-3, 3).astype(dtype), "b": jnp.ones((), dtype)}
    for dtype in (
        "bool int4 uint4 int8 uint8 int16 uint16 int32 uint32 float16 bfloat16 float32 complex64 "
        "float8_e4m3fn float8_e8m0fnu"
    ).split()
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
def test_every_state_of_an_environment_comes_back_to_the_bit(tmp_path, kind):
    """Whatever its arrays hold, are called and lie in; a state of MJX has empty ones."""
    there = ODD[kind]()
    save(tmp_path, {20: there})
    blank = jax.tree.map(
        lambda x: x if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else jnp.zeros_like(x),
        there,
    )
    _, back = restore(tmp_path, blank)
    assert jax.tree.structure(back) == jax.tree.structure(there)
    for ours, theirs in zip(jax.tree.leaves(back), jax.tree.leaves(there), strict=True):
        assert ours.dtype == theirs.dtype and ours.shape == theirs.shape
        if jax.dtypes.issubdtype(ours.dtype, jax.dtypes.prng_key):
            ours, theirs = jax.random.key_data(ours), jax.random.key_data(theirs)
        assert np.asarray(ours).tobytes() == np.asarray(theirs).tobytes()


# ---- wherever the folder is


PRINTABLE = "".join(map(chr, range(32, 127))).replace("/", "")
NAMES = [
    PRINTABLE,
    *(c for c in PRINTABLE if not c.isalnum()),
    "a\\b",
    "gs:",
    "...",
    "a.",
    "~a~",
    "é☃",
    "x" * 200,
    "\t\n\x7f",
    "\udc80",
]
NAMES.remove(".")


def test_a_folder_of_any_name_holds_its_checkpoints(tmp_path, monkeypatch):
    """They come back, and nothing is written beside it or left among the temporary files."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "runs").mkdir()
    for i, name in enumerate(NAMES):
        workdir, state = tmp_path / "runs" / name, {"a": jnp.full(3, i)}
        assert save(workdir, {1: state}) == workdir / "checkpoints", name
        iteration, back = restore(workdir, {"a": jnp.zeros(3, int)})
        assert iteration == 1 and (back["a"] == i).all(), name
        assert [p.name for p in workdir.iterdir()] == ["checkpoints"], name
        files = {p.name for p in (workdir / "checkpoints" / "1" / "state").iterdir()}
        assert {"manifest.ocdbt", "ocdbt.process_0"} <= files, name
    assert {p.name for p in (tmp_path / "runs").iterdir()} == set(NAMES)
    assert not list((tmp_path / "tmp").iterdir())


def test_a_folder_may_be_a_link_or_long_or_deep(tmp_path):
    """A link with a plain name to a folder without one; a path of three thousand characters."""
    (tmp_path / "[real]").mkdir()
    (tmp_path / "link").symlink_to("[real]")
    (tmp_path / "[link]").symlink_to("link")
    deep = tmp_path.joinpath(*["[" + "x" * 199] * 15)
    deep.mkdir(parents=True)
    for i, workdir in enumerate([tmp_path / "link", tmp_path / "[link]", deep], 1):
        save(workdir, {i: {"a": jnp.full(3, i)}})
        assert (restore(workdir, {"a": jnp.zeros(3, int)})[1]["a"] == i).all()
    assert workdirs.steps(tmp_path / "[real]") == {"1", "2"}


def test_where_no_folder_has_a_plain_name_that_is_one_line(tmp_path, monkeypatch):
    """The folder of temporary files is asked for another."""
    monkeypatch.setattr(checkpoint, "_is_plain", lambda path: False)
    assert "or set TMPDIR" in refused(save, tmp_path, {1: {"a": jnp.ones(3)}})


def test_a_checkpoint_that_orbax_has_not_merged_is_read(tmp_path, plain):
    """As it left them in a folder with a bracket in its name: the arrays lie where process 0 wrote them."""
    folder = save(tmp_path, {5: plain})
    shutil.rmtree(folder / "5" / "state" / "d")
    (folder / "5" / "state" / "manifest.ocdbt").unlink()
    assert_same(restore(tmp_path, plain)[1], plain)


# ---- which are kept


def test_the_newest_three_are_kept_and_the_newest_is_restored(tmp_path, small):
    """By iteration, 9 before 10; a save that was killed counts as none; at first there is nothing."""
    assert restore(tmp_path, small) is None
    states = {i: small | {"a": jnp.full(300, float(i))} for i in (8, 9, 10, 11)}
    folder = save(tmp_path, states)
    assert workdirs.steps(tmp_path) == {"9", "10", "11"}
    shutil.copytree(folder / "11", folder / "12.orbax-checkpoint-tmp-0")
    iteration, back = restore(tmp_path, small)
    assert iteration == 11 and (back["a"] == 11).all()


def test_what_a_killed_save_left_is_gone_at_once_and_no_later_save_is_taken_for_one(tmp_path):
    """Orbax's own thread did so, and could come late: then it removed the save in progress."""
    part = tmp_path / "checkpoints" / "12.orbax-checkpoint-tmp-0"
    for _ in range(5):
        part.mkdir(parents=True)
        with checkpoint.opened(tmp_path, pytest.fail):
            assert not part.exists()
            part.mkdir()  # a save in progress
        assert part.exists()
        part.rmdir()


def test_what_a_failed_save_writes_while_it_is_removed_is_removed_too(tmp_path, monkeypatch):
    """A thread of orbax puts a file into the folder once more: the first attempt leaves it."""
    part, remove, calls = tmp_path / "4.orbax-checkpoint-tmp-0", shutil.rmtree, []

    def busy(path, **options):
        remove(path, **options)
        calls.append(path)
        if len(calls) < 3:
            path.mkdir()
            (path / "late").write_text("x")

    part.mkdir()
    monkeypatch.setattr(shutil, "rmtree", busy)
    checkpoint._remove_unfinished(tmp_path)
    assert calls == [part] * 3 and not part.exists()


@pytest.mark.parametrize(
    ("crossed", "best"),
    [
        ({}, 2),
        ({1: 0.25, 2: 0.5, 3: 0.75, 5: 0.5, 6: 0.0}, 3),  # though its return is smaller
        ({1: 0.75, 2: 0.25, 3: 0.75, 5: 0.75, 6: 0.5}, 3),  # of equals the highest return
        ({1: 0.0, 6: 0.0}, 1),  # evaluated by a version that did not count crossings: 2, 3 and 5
    ],
)
def test_the_best_in_an_evaluation_is_kept_beside_the_newest(tmp_path, small, crossed, best):
    """One without an evaluation is never the best, whatever its training episodes were worth."""
    returns = {1: 3.0, 2: 9.0, 3: 5.0, 4: None, 5: 1.0, 6: 2.0}
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        for iteration, value in returns.items():
            of = {"crossed": crossed[iteration]} if iteration in crossed else {}
            evaluation = None if value is None else {"return": value} | of
            checkpoint.save(checkpoints, iteration, small, evaluation)
    assert workdirs.steps(tmp_path) == {str(best), "4", "5", "6"}
    assert restore(tmp_path, small)[0] == 6


def test_without_an_evaluation_no_checkpoint_is_the_best(tmp_path, small):
    save(tmp_path, dict.fromkeys(range(1, 7), small))
    assert workdirs.steps(tmp_path) == {"4", "5", "6"}


def test_checkpoints_of_before_with_the_return_of_training_episodes_are_still_good(tmp_path, plain):
    """They can be gone on from, and an evaluated one is better than any of them."""
    raw, _ = distributed.raw_keys(plain)  # as a tree, whose names orbax joins with dots
    args = ocp.args.Composite(
        state=ocp.args.StandardSave(raw),
        about=ocp.args.JsonSave(
            {
                "iteration": 1,
                "arrays": checkpoint.shapes(plain),
                "sha256": checkpoint.digest(plain),
            }
        ),
    )
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        checkpoints.manager.save(1, args=args, metrics={"episode_return": 99.0}, force=True)
    iteration, state = restore(tmp_path, plain)
    assert iteration == 1
    assert_same(state, plain)
    save(tmp_path, {2: plain}, evaluation={"return": -5.0})
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


def test_damaged_checkpoints_are_passed_over_one_by_one(tmp_path, small):
    """The JSON of one, the arrays of another; the third is good, and both can be written again."""
    folder = save(tmp_path, {4: small, 5: small, 6: small}, evaluation={"return": 1.0})
    (folder / "6" / "about" / "metadata").write_text("{")
    shutil.rmtree(folder / "5" / "state" / "d")
    said = []
    assert restore(tmp_path, small, said.append)[0] == 4
    assert {p.name for p in tmp_path.glob("damaged-*")} == {"damaged-5", "damaged-6"}
    assert ["checkpoint 6 is damaged" in said[0], "checkpoint 5 is damaged" in said[1]] == [
        True
    ] * 2
    assert all("an older one is taken" in line and "\n" not in line for line in said)
    save(tmp_path, {5: small})
    assert restore(tmp_path, small)[0] == 5


@pytest.mark.parametrize("damage", ["empty", "cut", "item"])
def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path, two, small, damage):
    """Files of no bytes, files cut in half, or the arrays missing."""
    shutil.rmtree(two / "4")
    if damage == "item":
        shutil.rmtree(two / "5" / "state")
    else:
        for file in [p for p in pathlib.Path(two / "5").rglob("*") if p.is_file()]:
            data = file.read_bytes()
            file.write_bytes(data[: len(data) // 2] if damage == "cut" else b"")
    said = []
    line = refused(restore, tmp_path, small, said.append)
    assert "no checkpoint can be read any more" in line and "--workdir" in line
    assert [line.startswith("checkpoint 5 is damaged") for line in said[-1:]] == [True]
    assert (tmp_path / "damaged-5").is_dir() and not (two / "5").exists()


FAULTS = [
    OSError(errno.EIO, "Input/output error"),
    OSError(errno.EMFILE, "Too many open files"),
    MemoryError(),
]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda error: str(error) or "memory")
def test_what_cannot_be_read_now_is_not_damaged(tmp_path, two, small, monkeypatch, fault):
    """Whichever file it is that the machine does not give: the fault is told, and nothing is moved."""
    before, read = workdirs.everything(tmp_path), pathlib.Path.read_bytes
    reads = []

    def counted(path):
        reads.append(path)
        return read(path)

    with monkeypatch.context() as patch:
        patch.setattr(pathlib.Path, "read_bytes", counted)
        assert restore(tmp_path, small)[0] == 5
    names = [path for path in dict.fromkeys(reads) if tmp_path in path.parents]
    assert len(names) > 8 and any("state" in path.parts for path in names)
    for bad in names:

        def fails(path, bad=bad):
            if path == bad:
                raise fault
            return read(path)

        with monkeypatch.context() as patch, pytest.raises(type(fault)):
            patch.setattr(pathlib.Path, "read_bytes", fails)
            restore(tmp_path, small)
        assert workdirs.everything(tmp_path) == before
    assert restore(tmp_path, small)[0] == 5 and (two / "5").is_dir()


UNPROVEN = [
    ValueError("INVALID_ARGUMENT: Error opening zarr driver: codec is not registered"),
    ValueError(
        "DATA_LOSS: Error decoding manifest: Maximum supported version is 0 but received: 1"
    ),
    RuntimeError("UNKNOWN"),
    KeyError("learner"),
    AttributeError("module 'tensorstore' has no attribute 'Context'"),
    ImportError("libtensorstore.so: cannot open shared object file"),
    TypeError(),
]


@pytest.mark.parametrize("where", ["open", "Context", "KvStore"])
@pytest.mark.parametrize("fault", UNPROVEN, ids=repr)
def test_what_proves_no_damage_is_told_and_nothing_is_moved(
    tmp_path, two, small, monkeypatch, fault, where
):
    """A fault that may be ours or a library's, wherever it comes from; later all is read again."""
    before = workdirs.everything(tmp_path)

    def fails(*_, **__):
        raise fault

    with monkeypatch.context() as patch, pytest.raises((ConfigError, type(fault))) as caught:
        name = "open" if where == "KvStore" else where
        patch.setattr(tensorstore.KvStore if where == "KvStore" else tensorstore, name, fails)
        restore(tmp_path, small)
    assert not isinstance(caught.value, checkpoint_file.Damaged)
    if where != "Context":
        assert "which is no proof that it is damaged" in str(caught.value)
        assert "nothing was changed" in str(caught.value)
    assert workdirs.everything(tmp_path) == before
    assert restore(tmp_path, small)[0] == 5


def test_arrays_under_other_names_or_of_other_types_prove_no_damage(tmp_path, two, small):
    """A version of before or after this one may store them so."""
    path = two / "5" / "about" / "metadata"
    text = path.read_text()
    one = f'"b/c": "{checkpoint.shapes(small)["b/c"]}"'
    assert text.count(one) == 1
    for old, new in (("b/c", "b/e"), ("float32", "float64")):
        path.write_text(text.replace(one, one.replace(old, new)))
        before = workdirs.everything(tmp_path)
        with pytest.raises(ConfigError, match="no proof that it is damaged") as caught:
            checkpoint_file.read(two / "5")
        assert not isinstance(caught.value, checkpoint_file.Damaged)
        assert workdirs.everything(tmp_path) == before


def test_memory_that_tensorstore_does_not_get_is_no_damage(tmp_path, two, small, monkeypatch):
    before = workdirs.everything(tmp_path)

    def fails(*_, **__):
        raise ValueError("RESOURCE_EXHAUSTED: 4 GB")

    with monkeypatch.context() as patch, pytest.raises(MemoryError):
        patch.setattr(tensorstore, "open", fails)
        restore(tmp_path, small)
    assert workdirs.everything(tmp_path) == before


def test_any_damage_is_found_or_harmless(two, small):
    """Files cut, emptied, gone, with bits or all bytes changed: never other numbers than were saved."""
    folder, rng, found = two / "5", np.random.default_rng(0), 0
    files = sorted(p.relative_to(folder) for p in (folder / "state").rglob("*") if p.is_file())
    shapes = {"a": "float32[300]", "b/c": "float32[20,30]", "b/d": "float32[]"}
    assert checkpoint.shapes(small) == shapes
    expected = {name: np.asarray(x) for name, x in checkpoint.paths(small).items()}
    for file in files:
        data = (folder / file).read_bytes()
        others = [
            None,
            b"",
            data[: rng.integers(len(data))],
            bytes(len(data)),
            rng.bytes(len(data)),
        ]
        for every in [len(data)] * 30 + [64] * 10:  # one bit, or one in 64 bytes
            flipped = np.frombuffer(data, np.uint8).copy()
            flipped[rng.integers(every) :: every] ^= np.uint8(1 << rng.integers(8))
            others.append(flipped.tobytes())
        for other in others:
            (folder / file).unlink() if other is None else (folder / file).write_bytes(other)
            try:
                arrays = checkpoint_file.read(folder)
            except checkpoint_file.Damaged:
                found += 1
            except checkpoint_file.Unread as error:  # the byte that says which format it is
                assert "version is" in str(error) or "Unsupported" in str(error)
            else:
                jax.tree.map(np.testing.assert_array_equal, arrays, expected)
            (folder / file).write_bytes(data)
    assert found > 50


TEXTS = {
    "about/metadata": "checkpoint 5",
    "metrics/metrics": "metrics of checkpoint 5",
    "_CHECKPOINT_METADATA": "_CHECKPOINT_METADATA of checkpoint 5",
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize(
    "text", ["[]", "{", "", "null", "[" * 100_000, "gone", '{"eval_return": "x"}']
)
def test_a_text_that_is_not_what_was_written_is_damage(tmp_path, two, small, name, text):
    """Of the text alone where the state is good without it. And the next save is kept."""
    path, said = two / "5" / name, []
    path.unlink() if text == "gone" else path.write_text(text)
    assert restore(tmp_path, small, said.append)[0] == (4 if name == "about/metadata" else 5)
    harmless = name == "_CHECKPOINT_METADATA" and text in ("gone", '{"eval_return": "x"}')
    assert [line.partition(" is damaged")[0] for line in said] == [TEXTS[name]] * (not harmless)
    assert len(list(tmp_path.glob("damaged-5*"))) == len(said)
    save(tmp_path, {6: small}, evaluation={"return": 2.0})
    assert "6" in workdirs.steps(tmp_path)


@pytest.mark.parametrize("left", ["state", "about", "metrics", "_CHECKPOINT_METADATA"])
def test_the_remains_of_an_old_one_are_no_damage(tmp_path, small, left):
    """A run was killed while it deleted it: nobody needs it, and the newest is taken without a word."""
    folder = save(tmp_path, {3: small, 4: small, 5: small}, evaluation={"return": 1.0})
    for path in (folder / "3").iterdir():
        if path.name != left:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert restore(tmp_path, small)[0] == 5
    save(tmp_path, {6: small, 7: small}, evaluation={"return": 2.0})
    assert restore(tmp_path, small)[0] == 7 and "3" not in workdirs.steps(tmp_path)
    assert not list(tmp_path.glob("damaged*"))


def test_other_numbers_than_were_saved_are_damage(tmp_path, two, small):
    """Found by the hash of all arrays."""
    workdirs.other_hash(two / "5")
    said = []
    assert restore(tmp_path, small, said.append)[0] == 4
    assert "its numbers are not those that were saved" in said[0]


def test_a_disk_that_is_too_full_is_an_error_before_anything_is_written(
    tmp_path, small, monkeypatch
):
    """The message has both numbers; with room it is saved."""
    size = sum(x.nbytes for x in jax.tree.leaves(small))
    free = [size, 2 * size]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free[0]))
    with checkpoint.opened(tmp_path, pytest.fail) as checkpoints:
        with pytest.raises(OSError, match="No space left on device: .* MB needed, .* MB free"):
            checkpoint.save(checkpoints, 5, small)
        assert not workdirs.steps(tmp_path)
        del free[0]
        checkpoint.save(checkpoints, 5, small)
    assert restore(tmp_path, small)[0] == 5


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

"""The arrays of a checkpoint without JAX: the newest by number, and no other numbers than were saved."""

import json
import re
import shutil
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import tensorstore
from answers import refused, shell
from toy_policy import GO1, actor, save

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.policy import checkpoint_file, policy_source
from dynappo.run import checkpoint
from dynappo.types import Learner


def written(workdir, seeds=1, **more):
    """Checkpoints 9 and 10 of a run, as orbax saves them; `{step: networks of the first seed}`.

    `more` is said beside config and arrays.
    """
    config = config_lib.load("configs/go1.py")
    config.run.num_seeds = seeds
    workdir.mkdir()
    about, networks = {"config": config_lib.validate(config).to_dict()} | more, {}
    with checkpoint.opened(workdir) as checkpoints:
        for step in (9, 10):
            params = [actor(100 * step + s) for s in range(seeds)]
            networks[step] = params[0]
            stacked = jax.tree.map(lambda *x: np.stack(x), *params) if seeds > 1 else params[0]
            rest = dict.fromkeys(Learner.__dataclass_fields__, np.zeros(1))
            learner = Learner(**rest | {"params": stacked})
            checkpoint.save(checkpoints, step, {"learner": learner}, **about)
    return networks


@pytest.mark.parametrize("seeds", [1, 3])
def test_a_checkpoint_is_played_without_a_policy_file(tmp_path, seeds):
    """The newest by number, not by name; of several seeds the first."""
    workdir = tmp_path / "run"
    networks = written(workdir, seeds)
    (workdir / "checkpoints" / "11.orbax-checkpoint-tmp-0").mkdir()  # a save in progress
    (workdir / "checkpoints" / "1²").mkdir()  # digits to Python, but no number
    (workdir / "checkpoints" / "99").write_text("no folder")
    (workdir / "checkpoints" / "98").symlink_to("nowhere")
    assert checkpoint_file.iterations(workdir / "checkpoints") == [10, 9]
    for place, step in (("", 10), ("checkpoints", 10), ("checkpoints/9", 9)):
        found, path = policy_source.load(str(workdir / place))
        assert path == workdir / "checkpoints" / str(step)
        jax.tree.map(np.testing.assert_array_equal, found.params, networks[step])


@pytest.mark.parametrize(
    ("seed", "best", "expected"), [(None, 2, 2), (None, None, 0), (0, 2, 0), (1, 2, 1), (2, 0, 2)]
)
def test_one_of_several_seeds_is_played(tmp_path, seed, best, expected):
    """By its number; else the best in the last evaluation, which its `about` names, or the first."""
    written(tmp_path / "run", 3, **({} if best is None else {"best_seed": best}))
    if seed is not None:  # it is not that of the policy.npz, which holds one seed alone
        save(tmp_path / "run" / "policy.npz", 7)
    found, path = policy_source.load(str(tmp_path / "run"), seed)
    assert path.name == "10" and found.seed == expected
    jax.tree.map(np.testing.assert_array_equal, found.params, actor(1000 + expected))


def test_it_is_told_how_far_the_run_was(tmp_path, monkeypatch):
    """Older checkpoints lack the steps; a hostile number is one line."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "run", 2, sim_steps=1_234_567)
    written(tmp_path / "old")
    none = {"run_seed": None, "robot_xml": None, "terms": None}
    for what, steps, text in (
        (
            "run",
            1_234_567,
            "run/checkpoints/10, seed 0 of 0 to 1, iteration 10, 1,234,567 simulator steps",
        ),
        (
            "run/checkpoints/9",
            1_234_567,
            "run/checkpoints/9, seed 0 of 0 to 1, iteration 9, 1,234,567 simulator steps",
        ),
        ("old", None, "old/checkpoints/10, iteration 10"),
    ):
        policy, _, told = policy_source.of_flags(SimpleNamespace(what=what, **none))
        assert (policy.sim_steps, told) == (steps, text)
    about = tmp_path / "old" / "checkpoints" / "10" / "about" / "metadata"
    about.write_text(json.dumps(json.loads(about.read_text()) | {"sim_steps": "many"}))
    assert "sim_steps is 'many', expected a number" in refused(policy_source.load, "old")


def test_of_a_bundled_policy_its_record_tells_how_far_the_run_was(tmp_path):
    """Their files do not say it. Nothing is said of a copy, and nothing where nothing is recorded."""
    none = {"run_seed": None, "robot_xml": None, "terms": None}
    for name in files.bundled():
        policy, path, told = policy_source.of_flags(SimpleNamespace(what=name, **none))
        known = json.loads(path.with_suffix(".json").read_text())
        far = f", iteration {known['iteration']}, {known['sim_steps']:,} simulator steps"
        if policy.iteration is None:
            far += f" by {path.stem}.json"
        assert told.endswith(far)
    copy = shutil.copy(files.find("robots", "go1/policy.npz"), tmp_path)
    shutil.copy(files.find("robots", "go1/policy.json"), tmp_path)
    assert "iteration" not in policy_source.of_flags(SimpleNamespace(what=copy, **none))[2]


def test_a_seed_that_is_not_there_is_one_line(tmp_path):
    """Past the last one, of a run of one seed, of files with one policy, of claims that do not fit."""
    several, one = tmp_path / "several", tmp_path / "one"
    written(several, 3)
    written(one)
    npz = save(tmp_path / "policy.npz")
    line = refused(policy_source.load, str(several), 3)
    assert line == f"{several}/checkpoints/10: it holds no seed 3; expected 0 to 2"
    assert "holds no seed 1; expected 0: the run has one seed" in refused(
        policy_source.load, str(one), 1
    )
    assert policy_source.load(str(one), 0)[0].seed is None
    for what, path in ((npz, npz), ("go1", "robots/go1/policy.npz")):
        line = refused(policy_source.load, str(what), 0)
        assert line.startswith("--run-seed=0: ") and f"{path} holds one policy" in line
    (tmp_path / "young").mkdir()
    save(tmp_path / "young" / "policy.npz")
    line = refused(policy_source.load, str(tmp_path / "young"), 0)
    assert line == f"{tmp_path}/young: holds no checkpoints/; expected a workdir of `dynappo train`"
    about = several / "checkpoints" / "10" / "about" / "metadata"
    text = json.loads(about.read_text())
    for best in (3, -1, "1", True, 1e9):
        about.write_text(json.dumps(text | {"best_seed": best}))
        assert "it holds no seed" in refused(policy_source.load, str(several))
    text["config"]["run"]["num_seeds"] = 10**6
    about.write_text(json.dumps(text))
    assert "expected 1000000 seeds" in refused(policy_source.load, str(several), 99)


def test_a_checkpoint_carries_its_robot(tmp_path, monkeypatch):
    """It is played where robots/ has none of that name; a hostile one is one line."""
    monkeypatch.chdir(tmp_path)
    config = config_lib.load("configs/go1.py").to_dict() | {"robot": "spot"}
    written(tmp_path / "run", mjcf=GO1.alone)
    about = tmp_path / "run" / "checkpoints" / "10" / "about" / "metadata"
    text = json.loads(about.read_text()) | {"config": config}
    about.write_text(json.dumps(text))
    found, _ = policy_source.load("run")
    assert found.robot == "spot" and found.joint_names == GO1.joint_names
    assert policy_source.robot(found)[0].mj_model.body_mass.sum() == GO1.mj_model.body_mass.sum()
    for wrong, expected in ((7, "holds no config"), ("<mujoco/>", "the robot that it carries: ")):
        about.write_text(json.dumps(text | {"mjcf": wrong}))
        assert expected in refused(policy_source.load, "run")


@pytest.mark.slow  # test_house.py sees every import
def test_it_is_read_without_jax(tmp_path):
    """JAX would take a GPU that trains."""
    written(tmp_path / "run")
    code = "import sys; from dynappo.policy import policy_source; policy_source.load(sys.argv[1]); "
    code += "print(sorted({'jax', 'flax', 'orbax'} & set(sys.modules)))"
    done = shell("-c", code, tmp_path / "run")
    assert done.stdout == "[]\n", done.stderr


def test_damage_is_one_line_and_nothing_is_changed(tmp_path):
    """Arrays that are gone, other numbers than were saved, no config."""
    workdir = tmp_path / "run"
    written(workdir)
    shutil.rmtree(workdir / "checkpoints" / "10" / "state" / "ocdbt.process_0")
    assert "10: not a checkpoint, or damaged" in refused(policy_source.load, str(workdir))
    about = workdir / "checkpoints" / "9" / "about" / "metadata"
    text = json.loads(about.read_text())
    about.write_text(json.dumps(text | {"sha256": text["sha256"][::-1]}))
    line = refused(policy_source.load, str(workdir / "checkpoints" / "9"))
    assert "9: not a checkpoint, or damaged (its numbers are not those that were saved)" in line
    assert checkpoint_file.iterations(workdir / "checkpoints") == [10, 9]
    config = text["config"]
    wrong = ([], {"a.b": 1}, config | {"task": 1}, config | {"robot": {}}, config | {"ppo": [1]})
    for found in wrong:
        about.write_text(json.dumps(text | {"config": found}))
        line = refused(policy_source.load, str(workdir / "checkpoints" / "9"))
        assert line.endswith("9: not a checkpoint of dynappo (it holds no config)")
    del text["config"]
    about.write_text(json.dumps(text))
    assert "it holds no config" in refused(policy_source.load, str(workdir / "checkpoints" / "9"))


def claim(folder, name, shape, chunks):
    """Let the array `name` of a checkpoint say that it has this shape, in pieces of `chunks`."""
    base = f"file://{(folder / 'state').resolve()}/"
    store = tensorstore.KvStore.open({"driver": "ocdbt", "base": base}).result()
    key = f"{name}/.zarray"
    said = json.loads(bytes(store.read(key).result().value)) | {"shape": shape, "chunks": chunks}
    store.write(key, json.dumps(said).encode()).result()


def test_an_array_of_terabytes_is_not_read(tmp_path):
    """Reading it would end the process; `about` knows its size."""
    written(tmp_path / "run")
    folder = tmp_path / "run" / "checkpoints" / "10"
    claim(folder, "learner/params/std", [10**12], [1000])
    expected = re.escape("float32[1000000000000], its `about` says float32[12]")
    with pytest.raises(checkpoint_file.Damaged, match=expected):
        checkpoint_file.read(folder)


def test_a_checkpoint_of_another_name_is_damaged(tmp_path):
    """One that was copied or renamed by hand: the run would count on from there."""
    written(tmp_path / "run")
    folder = tmp_path / "run" / "checkpoints"
    (folder / "10").rename(folder / "15")
    with pytest.raises(checkpoint_file.Damaged, match="it says that it is of iteration 10"):
        checkpoint_file.read(folder / "15")


def test_a_checkpoint_that_has_gone_is_not_damaged(tmp_path, monkeypatch):
    """A run that goes on takes old ones away; it may do so while another command begins to read."""
    written(tmp_path / "run")
    folder = tmp_path / "run" / "checkpoints" / "9"
    known = checkpoint_file.about(folder)
    shutil.rmtree(folder)
    monkeypatch.setattr(checkpoint_file, "about", lambda folder: known)
    line = refused(checkpoint_file.read, folder)
    assert line == f"{folder}: no such checkpoint; a run keeps its newest ones and the best"


@pytest.mark.parametrize(
    "about", ["[]", "{}", '{"arrays": [], "sha256": ""}', '{"arrays": {}}', "[" * 99_999]
)
def test_a_text_that_is_not_ours_is_damage(tmp_path, about):
    """JSON of another form beside the arrays is answered like numbers that have changed."""
    (tmp_path / "about").mkdir()
    (tmp_path / "about" / "metadata").write_text(about)
    with pytest.raises(checkpoint_file.Damaged, match="not a checkpoint, or damaged"):
        checkpoint_file.about(tmp_path)

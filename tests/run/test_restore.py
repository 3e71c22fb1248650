"""`--restore`: a run that starts from the networks of another, in whose folder nothing is changed."""

import json
import pathlib
import shlex
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import workdirs
from answers import refused
from ml_collections import ConfigDict
from toy_runs import assert_same

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.config import flags as flags_lib
from dynappo.description import robot as robot_lib
from dynappo.learner import ppo
from dynappo.policy import checkpoint_file, policy_file
from dynappo.program import build
from dynappo.run import learning_curves, restore, training


def test_another_run_starts_from_the_networks(program, config, whole, tmp_path):
    """Policy, value function, model and its moments are that run's; all else is new."""
    run = program()
    said = []
    fresh = run.state
    state = restore.start_from(whole.workdir, config, fresh, tmp_path, said.append)
    assert said == [f"starts from {whole.workdir}, checkpoint 4"]
    assert_same(state.learner.params, whole.state.learner.params)
    for part in ("params", "inputs", "targets"):
        assert_same(getattr(state.model, part), getattr(whole.state.model, part))
    assert_same(state.learner.opt_state, fresh.learner.opt_state)
    assert_same(state.env_state, fresh.env_state)
    _, plain = restore.weights(whole.workdir, config, fresh.replace(model=None), pytest.fail)
    assert plain.model is None
    assert_same(plain.learner.params, whole.state.learner.params)
    written = (tmp_path / "restored_from").read_text()
    assert written == f"{whole.workdir}\ncheckpoint 4\n"


def test_networks_that_are_not_their_own_mirror_image_start_none_that_must_be(
    program, config, whole, tmp_path
):
    """A policy is refused; a model starts untrained, and that is told."""
    assert not config.ppo.symmetry and not config.model.symmetry
    line = refused(restore.check, whole.workdir, workdirs.config(ppo__symmetry=True))
    assert (
        "ppo.symmetry is False there, True here" in line and "--config.ppo.symmetry=False" in line
    )
    symmetric = workdirs.config(ppo__symmetry=True, model__symmetry=True)
    said, fresh = [], program().state
    state = restore.start_from(whole.workdir, symmetric, fresh, tmp_path, said.append)
    assert_same(state.learner.params, whole.state.learner.params)
    assert_same(state.model, fresh.model)
    assert len(said) == 2 and "model.symmetry is False there, True here" in said[0]


def test_a_run_with_a_source_trains_from_there(config, program, whole, tmp_path, monkeypatch):
    """To the bits of a program whose first state has these networks; where it resumes, the source is past."""
    monkeypatch.setattr(build, "program", lambda *_, **__: program())
    monkeypatch.setattr(learning_curves, "draw", lambda *_: "no picture")
    _, start = restore.weights(whole.workdir, config, program().state, pytest.fail)
    expected, _, _ = workdirs.loop(config, program()._replace(state=start))
    run, said = training.Run(config, tmp_path / "run", source=whole.workdir), []
    callbacks = training.Callbacks(say=said.append)
    for line in (f"starts from {whole.workdir}, checkpoint 4", f"the run in {run.workdir} is comp"):
        trained = training.train_together([run], callbacks)
        assert trained.ended and said.pop().startswith(line) and not said
        assert_same(trained.state, expected)
    assert (run.workdir / "restored_from").read_text() == f"{whole.workdir}\ncheckpoint 4\n"


def test_a_checkpoint_of_it_may_be_named(program, whole, config):
    """Against a run that goes on from that one; what was taken is told."""
    older = whole.workdir / "checkpoints" / "2"
    taken, state = restore.weights(older, config, program().state, pytest.fail)
    arrays = checkpoint_file.read(older)
    np.testing.assert_array_equal(state.learner.params["std"], arrays["learner/params/std"])
    assert (state.learner.params["std"] != whole.state.learner.params["std"]).any()
    assert taken == "checkpoint 2"
    restore.check(older, config)


@pytest.mark.parametrize("seeds", [1, 3])
def test_a_policy_file_is_where_every_seed_may_start(program, seeds):
    """The bundled Go1: its policy in every seed; its value function is not in the file, and stays new."""
    config = config_lib.load("go1:few")  # whose model is symmetric: the file has none
    static, hyper = config_lib.split(config_lib.validate(config))
    keys = jax.random.split(jax.random.key(0), seeds)
    new = jax.jit(jax.vmap(lambda key: ppo.init(static, hyper, 48, 12, key)))(keys)
    new = jax.tree.map(lambda x: x[0], new) if seeds == 1 else new
    like, said = program().state.replace(learner=new), []
    file = pathlib.Path("robots/go1/policy.npz")
    taken, state = restore.weights(file, config, like, said.append)
    learner = state.learner
    expected = policy_file.load(file).params
    for name in ("actor", "std"):
        for ours, theirs in zip(
            jax.tree.leaves(learner.params[name]), jax.tree.leaves(expected[name]), strict=True
        ):
            np.testing.assert_array_equal(ours, np.broadcast_to(theirs, ours.shape))
    assert_same(learner.params["critic"], new.params["critic"])
    assert_same(state.model, like.model)
    (line,) = said
    assert "value function starts untrained" in line and taken == "policy.npz"
    assert line.endswith("the policy learns with it at once: ppo.value_first is 0")
    config.ppo.value_first = 20
    restore.weights(file, config, like, said.append)
    assert said[1].endswith("and learns for 20 iterations (ppo.value_first) before the policy does")


def test_a_policy_of_another_activation_is_refused():
    """Its weights would fit, and mean something else."""
    config = config_lib.load("go1:ppo16")
    activation = policy_file.load(pathlib.Path("robots/go1/policy.npz")).activation
    config.ppo.activation = "tanh"
    line = refused(restore.check, pathlib.Path("robots/go1/policy.npz"), config)
    assert f"ppo.activation is {activation} there, tanh here" in line


def test_networks_of_another_size_or_none_are_refused(program, config, whole, tmp_path):
    """One line with the flag, what was found and what was expected."""
    fresh = program().state
    wide = fresh.learner.params | {"std": jnp.zeros(13)}
    other = fresh.replace(learner=fresh.learner.replace(params=wide))
    line = refused(restore.weights, whole.workdir, config, other)
    assert line.startswith(f"--restore={whole.workdir}: policy std is of shape (2,) there")
    assert "of shape (13,) here" in line
    assert "no checkpoints/ there" in refused(restore.weights, tmp_path, config, fresh)
    (tmp_path / "checkpoints").mkdir()
    assert "it holds no checkpoint yet" in refused(restore.weights, tmp_path, config, fresh)


def test_the_run_that_another_starts_from_is_only_read(program, config, whole, tmp_path):
    """A save of it that is in progress stays, so does a damaged checkpoint; the one before is taken."""
    other, said = tmp_path / "other", []
    shutil.copytree(whole.workdir, other)
    folder = other / "checkpoints"
    for name in ("6.orbax-checkpoint-tmp-0", "6", "5"):
        shutil.copytree(folder / "4", folder / name)
    shutil.rmtree(folder / "6" / "state" / "d")
    about = folder / "5" / "about" / "metadata"
    about.write_text(about.read_text().replace('"iteration": 4', '"iteration": 5'))
    workdirs.other_hash(folder / "5")
    before = workdirs.everything(other)
    _, state = restore.weights(other, config, program().state, said.append)
    assert_same(state.learner.params, whole.state.learner.params)
    assert workdirs.everything(other) == before
    assert [line.split(":")[0] for line in said] == [str(folder / "6"), str(folder / "5")]
    assert all(line.endswith("checkpoint 4 is taken") and "\n" not in line for line in said)
    assert "its numbers are not those that were saved" in said[1]
    for step in ("2", "4"):
        workdirs.other_hash(folder / step)
    line = refused(restore.weights, other, config, program().state)
    assert line.startswith(f"--restore={other}: none of its 4 checkpoints can be read")


SIZES = {  # what differs from the run that is there, what the line says
    "policy": ({"ppo__hidden": (8,)}, "ppo.hidden is "),
    "value": ({"ppo__critic_hidden": (8,)}, "ppo.critic_hidden is None there, (8,) here"),
    "model": ({"model__hidden": (8, 8)}, "model.hidden is "),
    "falls": ({"model__falls": True}, "model.falls is False there, True here"),
    "gait": ({"task__gait_frequency": (1.0, 1.5)}, "task.gait_frequency is None there, "),
    "seeds": ({"run__num_seeds": 2}, "run.num_seeds is 1 there, 2 here"),
    "history": ({"task__history": 3}, "task.history is 1 there, 3 here"),
    "scan": (
        {"task__scan": "grid", "task__terrain": "rough", "task__carry_on": False},
        "task.scan is none there, grid here",
    ),
}


@pytest.mark.parametrize("name", SIZES)
def test_networks_of_another_size_are_refused_before_anything_is_done(whole, config, name):
    """By the config in the checkpoint; the sizes of the run itself are fine."""
    restore.check(whole.workdir, config)
    fields, said = SIZES[name]
    line = refused(restore.check, whole.workdir, workdirs.config(**fields))
    assert line.startswith(f"--restore={whole.workdir}: {said}")
    flags = shlex.split(line.partition("set what that run has: ")[2])
    assert all(flag.startswith("--config.") for flag in flags)
    same = ConfigDict(workdirs.config(**fields).to_dict())
    flags_lib.set_fields(same, flags)
    restore.check(whole.workdir, same)


OTHER_BODIES = {  # the bundled policy, the config, what the line says: no advice on sizes
    (
        "g1",
        "go1:laptop",
    ): "g1 has 29 joints, go1 12, and a policy moves as many as it was trained with; name",
    (
        "go1_rough",
        "go1:laptop",
    ): "its policy sees a scan of rough ground, task.terrain is flat here; try --config=go1:rough",
}


@pytest.mark.parametrize("names", OTHER_BODIES)
def test_a_policy_of_another_body_is_refused_whatever_its_sizes(names):
    """The number of joints, and what only rough ground has, come before the sizes of networks."""
    name, spec = names
    line = refused(restore.check, policy_file.bundled(name), config_lib.load(spec))
    assert line.startswith(f"--restore={name}: {OTHER_BODIES[names]}") and "set what" not in line


def test_a_policy_that_sees_terms_of_ones_own_is_refused_without_them(monkeypatch):
    """Before anything is compiled, with what to name; and the other way round."""
    one = {"name": "base_height", "size": 3, "signs": None, "order": None, "scale": 1.0}
    one |= {"unit": "m", "content": "", "noisy": False, "known": True, "shown": True}
    with_terms = {"task.terms": "A.py", "task.terms_about": json.dumps({"observation": [one]})}
    robot, config = robot_lib.load("go1"), config_lib.load("go1:laptop")
    there = config_lib.flat(config)
    monkeypatch.setattr(restore, "about", lambda source: (there | with_terms, robot))
    line = refused(restore.check, pathlib.Path("run"), config)
    assert (
        "its policy sees base_height [3] of terms of one's own, here nothing; name them: --terms=A.py"
        in line
    )
    monkeypatch.setattr(restore, "about", lambda source: (there, robot))
    restore.check(pathlib.Path("run"), config)
    config.task.update(terms="A.py", terms_about=with_terms["task.terms_about"])
    assert "sees nothing of terms" in refused(restore.check, pathlib.Path("run"), config)


def test_networks_that_do_not_fit_leave_nothing_behind(
    program, whole, config, tmp_path, monkeypatch
):
    """Else the command without --restore would start from the same ones, and be refused too."""
    monkeypatch.setattr(build, "program", lambda *_, **__: program())

    def misfit(*_):
        raise ConfigError("no fit")

    monkeypatch.setattr(restore, "weights", misfit)
    workdir = tmp_path / "run"
    new = training.Run(config, workdir, source=whole.workdir)
    assert refused(training.train_together, [new]) == "no fit"
    assert not workdir.exists()
    workdir.mkdir()
    (workdir / "notes").touch()
    assert refused(training.train_together, [new]) == "no fit"
    assert restore.source(workdir, None) is None


def test_what_is_no_run_says_what_is_meant(tmp_path, monkeypatch):
    """A folder with the name of a bundled policy, and a sweep."""
    monkeypatch.chdir(tmp_path)
    line = refused(restore.saved, pathlib.Path("./go1"))
    assert line.startswith(
        "--restore=./go1: no such file or folder; expected a workdir or a checkpoint; "
    )
    assert "--restore=go1, without ./, is the bundled policy" in line
    folder = tmp_path / "sw"
    (folder / "a=1" / "checkpoints").mkdir(parents=True)
    (folder / "sweep.json").touch()
    line = refused(restore.saved, folder)
    assert line == f"--restore={folder}: a sweep; name one of its runs, such as {folder / 'a=1'}"
    (folder / "policy.npz").touch()
    assert refused(restore.saved, folder).endswith(f", or its best policy, {folder / 'policy.npz'}")


def test_a_bundled_policy_of_another_task_says_which_flags_it_needs(tmp_path):
    """All at once; a file of another kind is told with the flag, and which of its run to take."""
    source = pathlib.Path("robots/go1/deploy.npz")
    config = config_lib.load("go1:laptop")
    line = refused(restore.check, source, config)
    assert line.startswith(f"--restore={source}: task.observation is onboard there, full here; set")
    by_name = refused(restore.check, policy_file.bundled("go1_deploy"), config)
    assert by_name == line.replace(str(source), "go1_deploy")  # as it was given
    flags = shlex.split(line.partition("set what that run has: ")[2])
    assert flags[:2] == ["--config.task.observation=onboard", "--config.task.history=5"]
    flags_lib.set_fields(config, flags)
    restore.check(source, config)
    (tmp_path / "config.json").write_text("{}")
    other = f"--restore={tmp_path}/config.json: not a policy.npz, or damaged; "
    line = refused(restore.check, tmp_path / "config.json", config)
    assert line == f"{other}expected a policy.npz as training writes it"
    (tmp_path / "checkpoints" / "40").mkdir(parents=True)
    line = refused(restore.check, tmp_path / "config.json", config)
    assert line.startswith(f"{other}name {tmp_path}/checkpoints/40, a checkpoint of its run")

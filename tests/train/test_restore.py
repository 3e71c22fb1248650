"""`--restore`: a run that starts from the networks of another, in whose folder nothing is changed."""

import shutil

import jax.numpy as jnp
import pytest
import workdirs
from answers import refused
from toy_runs import assert_same

from dynappo.train import restore


def test_another_run_starts_from_the_networks(program, whole):
    """Policy, value function, model and its moments are that run's; all else is new."""
    run = program()
    fresh, state = run.state, restore.start_from(whole.workdir, run, pytest.fail).state
    assert_same(state.learner.params, whole.state.learner.params)
    for part in ("params", "inputs", "targets"):
        assert_same(getattr(state.model, part), getattr(whole.state.model, part))
    assert_same(state.learner.opt_state, fresh.learner.opt_state)
    assert_same(state.env_state, fresh.env_state)
    plain = restore.weights(whole.workdir, fresh.replace(model=None), pytest.fail)
    assert plain.model is None
    assert_same(plain.learner.params, whole.state.learner.params)


def test_networks_of_another_size_or_none_are_refused(program, whole, tmp_path):
    """One line with the flag, what was found and what was expected."""
    fresh = program().state
    wide = fresh.learner.params | {"std": jnp.zeros(13)}
    other = fresh.replace(learner=fresh.learner.replace(params=wide))
    line = refused(restore.weights, whole.workdir, other)
    assert line.startswith(f"--restore={whole.workdir}: policy std is of shape (2,) there")
    assert "of shape (13,) here" in line
    assert "no checkpoints/ there" in refused(restore.weights, tmp_path, fresh)
    (tmp_path / "checkpoints").mkdir()
    assert "it holds no checkpoint yet" in refused(restore.weights, tmp_path, fresh)


def test_the_run_that_another_starts_from_is_only_read(program, whole, tmp_path):
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
    state = restore.weights(other, program().state, said.append)
    assert_same(state.learner.params, whole.state.learner.params)
    assert workdirs.everything(other) == before
    assert [line.split(":")[0] for line in said] == [str(folder / "6"), str(folder / "5")]
    assert all(line.endswith("checkpoint 4 is taken") and "\n" not in line for line in said)
    assert "its numbers are not those that were saved" in said[1]
    for step in ("2", "4"):
        workdirs.other_hash(folder / step)
    line = refused(restore.weights, other, program().state)
    assert line.startswith(f"--restore={other}: none of its 4 checkpoints can be read")


SIZES = {  # what differs from the run that is there, what the line says
    "policy": ({"ppo__hidden": (8,)}, "ppo.hidden is "),
    "model": ({"model__hidden": (8, 8)}, "model.hidden is "),
    "falls": ({"model__falls": True}, "model.falls is False there, True here"),
    "seeds": ({"run__num_seeds": 2}, "run.num_seeds is 1 there, 2 here"),
}


@pytest.mark.parametrize("name", SIZES)
def test_networks_of_another_size_are_refused_before_anything_is_done(whole, config, name):
    """By the config in the checkpoint; the sizes of the run itself are fine."""
    restore.check(whole.workdir, config)
    fields, said = SIZES[name]
    line = refused(restore.check, whole.workdir, workdirs.config(**fields))
    assert line.startswith(f"--restore={whole.workdir}: {said}") and "set the sizes" in line

"""Numbers that blow up: the first of them is named, and the robot that it came from is kept."""

import jax.numpy as jnp
import numpy as np
import pytest
import workdirs

from dynappo import terms
from dynappo.run import nonfinite


def metrics(shape=(4,)):
    """Of four iterations; before the third no episode has ended."""
    out = {name: np.ones(shape) for name in ("value_loss", "reward_x", "episode_return")}
    out["episode_return"][:2] = np.nan
    return out | {"iteration": np.arange(1, 5)}


def test_the_first_bad_number_is_named_in_the_order_of_computation():
    """A reward before the loss that it spoils; neither an empty mean return nor an evaluation is bad."""
    data = metrics() | {"eval_return": np.full(4, np.nan)}
    assert nonfinite.first_metric(data) is None
    data["value_loss"][1:] = np.nan
    assert nonfinite.first_metric(data) == ("value_loss", 2)
    data["reward_x"][1] = np.inf
    assert nonfinite.first_metric(data) == ("reward_x", 2)
    data = metrics((4, 3))
    data["value_loss"][3, 2] = np.nan
    assert nonfinite.first_metric(data) == ("value_loss", 4)


def test_a_loss_is_missed_only_where_the_model_was_fitted():
    data = metrics() | {"model_loss": np.array([1.0, 1.0, np.nan, np.nan])}
    assert nonfinite.first_metric(data) == ("model_loss", 3)
    assert nonfinite.first_metric(data, np.array([2, 2, 0, 0])) is None
    assert nonfinite.first_metric(data, np.array([2, 2, 0, 1])) == ("model_loss", 4)


def test_the_first_array_with_a_bad_number_is_named_by_its_path():
    """NumPy's and JAX's, integers among them; a second look compiles nothing."""
    tree = {"a": [jnp.ones(3), np.arange(2)], "b": {"w": jnp.zeros((2, 2))}, "none": None}
    assert nonfinite.first_leaf(tree) is None and nonfinite.first_leaf({}) is None
    compiled = nonfinite._finite()._cache_size()
    tree["b"]["w"] = tree["b"]["w"].at[1, 0].set(jnp.inf)
    assert nonfinite.first_leaf(tree) == "b/w"
    tree["a"][0] = tree["a"][0].at[2].set(jnp.nan)
    assert nonfinite.first_leaf(tree) == "a/0"
    assert nonfinite._finite()._cache_size() == compiled


REWARD = "@terms.reward(weight=1.0)\ndef x(command): return command.sum() / 0.0\n"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("reward_x", "The reward term x of mine.py may not be finite"),
        ("value_loss", "A term of mine.py may not be finite"),
    ],
)
def test_where_there_are_terms_of_ones_own_they_are_named_first(name, said, tmp_path, monkeypatch):
    """In the one line, before the learning rates; without terms these alone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(f"from dynappo import terms\n\n{REWARD}")
    data = metrics() | {"nonfinite_robot": np.full(4, -1)}
    data[name][2] = np.nan
    with pytest.raises(FloatingPointError) as error:
        nonfinite.check(dict(data), {}, {}, dict, None, terms.read("mine.py"))
    text = str(error.value)
    assert f"{name} is not finite in iteration 3" in text and "\n" not in text
    assert text.index(said) < text.index("Else lower ppo.desired_kl (where")
    with pytest.raises(FloatingPointError, match=r"\. Lower ppo\.desired_kl") as error:
        nonfinite.check(dict(data), {}, {}, dict, None)
    assert "term" not in str(error.value)


@pytest.mark.parametrize(
    ("iteration", "robot", "environment"), [(1, 5, True), (2, 5, False), (1, -1, False)]
)
def test_no_learning_rate_is_blamed_for_the_first_rows_of_an_environment(
    iteration, robot, environment
):
    data = metrics() | {"nonfinite_robot": np.full(4, robot)}
    data["value_loss"][iteration - 1 :] = np.nan
    with pytest.raises(FloatingPointError) as error:
        nonfinite.check(data, {}, {}, dict, None)
    assert ("it is the environment's own" in str(error.value)) == environment
    assert ("Lower ppo.desired_kl" in str(error.value)) != environment


def poisoned(program, place):
    """The program with a NaN, or an absurd learning rate, at `place`."""
    h, state = program.hyper, program.state
    nan = np.float32(np.nan)
    if place == "model":
        h = h._replace(model=h.model._replace(learning_rate=np.float32(1e30)))
    elif place == "policy":
        h = h._replace(ppo=h.ppo._replace(value_coef=nan))
    elif place == "observation":  # the commands of the episodes to come
        h = h._replace(task=h.task._replace(command_x=(nan, nan)))
    elif place == "parameter":  # no loss: found in the state
        moments = state.model.targets.replace(weight=jnp.float32(np.inf))
        state = state.replace(model=state.model.replace(targets=moments))
    return program._replace(hyper=h, state=state)


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("model", "model_loss is not finite in iteration 1"),
        ("policy", "(value|surrogate)_loss is not finite in iteration 1"),
        ("observation", "(value|surrogate)_loss is not finite in iteration 1"),
        ("parameter", "model.*is not finite in iteration"),
    ],
)
def test_a_training_that_blows_up_names_the_first_bad_number(
    config, program, tmp_path, place, name
):
    """No row of NaN is written, no checkpoint of it is kept; a bad robot is there for replay."""
    bad = poisoned(program(), place)
    with pytest.raises(FloatingPointError, match=name) as error:
        workdirs.loop(config, bad, tmp_path)
    text = str(error.value)
    said = (
        "Lower ppo.desired_kl (where" if place != "observation" else "it is the environment's own"
    )
    assert "\n" not in text and said in text
    assert not (tmp_path / "metrics.csv").exists()
    assert not list((tmp_path / "checkpoints").iterdir())
    dumped = tmp_path / "nonfinite.npz"
    assert dumped.exists() == (place == "observation")
    if place == "observation":
        found = np.load(dumped)
        robot = int(found["robot"])
        assert f"robot {robot}, as it was before, is in {dumped}" in text
        assert f"first a reward or an observation of robot {robot};" in text
        start = program().state
        for name in ("prop", "command"):
            kept = found[f"env_state/{name}"]
            np.testing.assert_array_equal(kept, getattr(start.env_state, name)[robot])
        np.testing.assert_array_equal(found["params_physics"], start.params_physics[robot])

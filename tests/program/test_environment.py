"""An environment of one's own: each thing in which it is not as `types.Env` has it is one line."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
import workdirs
from answers import refused

from dynappo import config as config_lib
from dynappo.program import build, environment
from dynappo.tasks import env_contract
from dynappo.types import Env, Mirror, Outcome, Views, autoreset

TOY = toy_env.make()


def outcome(**fields):
    """The toy's step, with these fields of its outcome."""

    def step(*arguments):
        state, out = TOY.step(*arguments)
        return state, out.replace(**fields)

    return step


def state_of(function, **fields):
    """The toy's reset or step, with these fields of its state."""

    def changed(*arguments):
        out = function(*arguments)
        return (
            (out[0].replace(**fields), out[1]) if isinstance(out, tuple) else out.replace(**fields)
        )

    return changed


def raising(*_):
    raise RuntimeError("no\nluck")


def outcome_that_lacks_a_field(*_):
    return TOY.step, Outcome(reward=1.0, discount=1.0)  # pyright: ignore


class Clocked(NamedTuple):
    """A state that evaluation cannot set the clock of."""

    obs: jax.Array
    prop: jax.Array
    clock: jax.Array


WRONG = {  # what is changed of the toy, what the line says
    "no obs": ({"reset": lambda *_: {"a": jnp.zeros(3)}}, "dict without obs"),
    "obs": ({"obs_size": 7}, r"reset's obs is of shape \(6,\), expected \(7,\) \(obs_size = 7\)"),
    "prop": ({"prop_size": 2}, r"reset's prop is of shape \(3,\), expected \(2,\)"),
    "more predicted than seen": ({"prop_size": 9}, "prop_size is 9, expected at most obs_size = 6"),
    "size": ({"action_size": 0}, "action_size is 0, expected an integer above 0"),
    "time": ({"dt": -1.0}, "dt is -1.0, expected seconds above 0"),
    "length": ({"episode_length": 2.5}, "episode_length is 2.5, expected an integer"),
    "kind of obs": (
        {"reset": state_of(TOY.reset, obs=jnp.zeros(6, jnp.int32))},
        "obs is int32, expected real numbers",
    ),
    "clock": (
        {"reset": lambda *_: Clocked(jnp.zeros(6), jnp.zeros(3), jnp.zeros(()))},
        "Clocked has a clock and no replace, expected a flax.struct.dataclass",
    ),
    "raised": (
        {"step": raising},
        r"step cannot be run \(test_environment.py, line \d+\): RuntimeError: no luck,",
    ),
    "field of Outcome": (
        {"step": outcome_that_lacks_a_field},
        r"\(test_environment.py, line \d+\): TypeError: .*missing 5 required .*'truncation'",
    ),
    "kind of outcome": (
        {"step": lambda *_: (1.0, 2.0, 3)},
        r"step returns \(.*expected \(state, dyn",
    ),
    "reward": (
        {"step": outcome(reward=jnp.zeros(1))},
        r"Outcome.reward is of shape \(1,\), expected \(\)",
    ),
    "next_obs": (
        {"step": outcome(next_obs=jnp.zeros(3))},
        r"next_obs is of shape \(3,\), expected \(6,\)",
    ),
    "next_prop": ({"step": outcome(next_prop=None)}, r"next_prop is None, expected \(3,\)"),
    "metrics": ({"step": outcome(metrics={})}, "Outcome.metrics has no 'reward_x'"),
    "state of step": (
        {"step": state_of(TOY.step, command=jnp.zeros(2))},
        r"step returns a state with \.command float32\[2\], expected float32\[\] as reset's",
    ),
    "kind of state": (
        {"autoreset": lambda *_: jnp.zeros(3)},
        "autoreset returns .*expected a state as reset's, State",
    ),
    "advance": (
        {"advance": lambda h, context, prop, action, next_prop: action},
        r"advance\(hyper, context, .* \(2,\), expected \(3,\)",
    ),
    "sense": (
        {"sense": lambda h, prop, context, key: jnp.zeros(2)},
        r"sense.* \(2,\), expected \(3,\)",
    ),
    "no other command": (
        {"retell": None},
        "retell is None where schedule.new_commands is True, expected a function",
    ),
    "another command": (
        {"retell": lambda h, context, key: context[:2]},
        r"retell.* \(2,\), expected \(3,\)",
    ),
    "views": ({"views": [1, 2]}, "views is list, expected a dynappo.types.Views"),
    "no such column": (
        {"views": Views(*[np.arange(3)] * 2, np.array([0, 6]))},
        "views.model has the column 6, expected 0 to 5",
    ),
    "which are seen": (
        {"views": Views(np.arange(6) < 3, *[np.arange(3)] * 2)},
        r"views.actor is bool of shape \(6,\), expected \[K\] integers",
    ),
    "recorded": (
        {"recorded": lambda state: state.prop},
        r"recorded\(state\) is of shape \(3,\), expected \(2,\)",
    ),
    "evaluated": ({"evaluated": lambda hyper: None}, r"evaluated\(hyper\) is None, expected hyper"),
    "known end": (
        {"known_end": lambda h, prop, context: prop > 0},
        r"known_end\(.* \(3,\), expected \(\) \(one number\)",
    ),
    "reward of a fall": (
        {"fall_reward": lambda h: jnp.ones(2)},
        r"fall_reward\(hyper\) is of shape \(2,\), expected \(\) \(one number\)",
    ),
    "sensed context": (
        {"sense_context": lambda h, context, key: context[:1]},
        r"sense_context\(.* \(1,\), expected \(3,\)",
    ),
    "known reward": (
        {"known_reward": lambda h, obs, action, prop: prop},
        r"known_reward.* \(3,\), expected \(\)",
    ),
}
ASKS = {"model__clean": True, "model__known_reward": True, "model__falls": True}
TELLS = ASKS | {"schedule__new_commands": True, "schedule__rounds": 2}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_not_as_the_contract_has_it_is_one_line(case):
    """What was found and what was expected, before anything is compiled."""
    fields, words = WRONG[case]
    with pytest.raises(config_lib.ConfigError, match=f"the environment: .*{words}") as error:
        env = TOY._replace(**fields)
        build.check(environment.config_for(workdirs.config(**TELLS), env), env)
    text = str(error.value)
    assert "\n" not in text and text.endswith("docs/environment.md has the contract")


def test_a_long_error_is_cut_between_words():
    def step(*_):
        raise ValueError("traced " * 100)

    config = environment.config_for(workdirs.config(**TELLS), TOY)
    line = refused(build.check, config, TOY._replace(step=step))
    assert " traced ..., expected a function" in line


def test_an_environment_that_keeps_the_contract_passes():
    """With a model and without; what only the model asks for is not looked at without it."""
    config = environment.config_for(workdirs.config(**TELLS), TOY)
    build.check(config, TOY)
    plain = workdirs.config(schedule__end_steps=0, **TELLS)
    build.check(plain, TOY._replace(advance=raising, sense=raising, known_reward=raising))
    assert "advance cannot be run" in refused(build.check, config, TOY._replace(advance=raising))


def test_what_is_left_out_has_defaults_that_a_model_can_use():
    """Six fields and two sizes make an environment: no noise, nothing known, no known reward, no bodies."""

    class State(NamedTuple):
        obs: jax.Array
        prop: jax.Array

    def start(hyper, body, key):
        assert body is None
        obs = jax.random.normal(key, (2,))
        return State(obs, obs)

    def step(hyper, body, state, action, key):
        after = State(state.obs + action, state.prop + action)
        told = Outcome(1.0, 1.0, 0.0, after.obs, after.prop, 0.0, 0.0)  # pyright: ignore
        return after, told

    env = Env(start, step, autoreset(start), 2, 2, 2, 0.1, 5)
    build.check(environment.config_for(workdirs.config(**ASKS), env), env)
    assert env.metrics == () and env.known_reward(None, 1, 2, 3) == 0
    assert env.advance(None, np.ones(3), "prop", "action", "next prop").shape == (0,)
    assert env.sense(None, "prop", "context", "key") == "prop"


def test_a_state_starts_anew_where_an_episode_ended_and_only_there():
    """`types.autoreset`: by a fall, or by the time."""
    again = autoreset(lambda hyper, body, key: {"x": jnp.float32(body)})
    zero, one = jnp.zeros(()), jnp.ones(())
    for discount, truncation, expected in ((one, zero, 7), (zero, zero, 3), (one, one, 3)):
        out = Outcome(one, discount, truncation, one, one, one, one)
        assert again(None, 3, {"x": jnp.float32(7)}, out, None)["x"] == expected


def test_symmetry_needs_the_mirror_of_every_number():
    """Of an environment without, or with one of another size, it is one line."""
    config = workdirs.config(ppo__symmetry=True)
    mirror = Mirror(np.arange(6), np.ones(6)), Mirror(np.arange(2), np.ones(2))
    build.check(config, TOY._replace(mirror=mirror))
    assert "mirror is None where ppo.symmetry is True" in refused(build.check, config, TOY)
    wrong = refused(build.check, config, TOY._replace(mirror=mirror[::-1]))
    assert "the mirror's index of obs is of shape (2,), expected (6,)" in wrong


@pytest.mark.parametrize(
    ("action", "says"),
    [
        (Mirror(np.array([0, 9]), np.ones(2)), "the mirror's index of action is [0, 9], expected"),
        (
            Mirror(np.array([1, 1]), np.ones(2)),
            "index of action is [1, 1], expected each of 0 to 1",
        ),
        (Mirror(np.arange(2), np.array([1, 5])), "sign of action is [1, 5], expected each 1 or -1"),
        (Mirror(np.arange(2)[::-1], np.array([1, -1])), "takes number 0 to 1, and that to 0"),
        (2, "mirror is (Mirror, int), expected two dynappo.types.Mirror"),
    ],
)
def test_a_mirror_is_its_own_inverse(action, says):
    """Else a symmetric policy would learn from the wrong image, in silence."""
    config, of_obs = workdirs.config(ppo__symmetry=True), Mirror(np.arange(6), np.ones(6))
    assert says in refused(build.check, config, TOY._replace(mirror=(of_obs, action)))
    turned = of_obs._replace(index=np.array([1, 2, 0, 3, 4, 5]))
    swapped = Mirror(np.array([1, 0]), -np.ones(2))
    build.check(config, TOY._replace(mirror=(of_obs, swapped)))
    wrong = refused(build.check, config, TOY._replace(mirror=(turned, swapped)))
    assert "the mirror of obs takes number 0 to 1, and that to 2, expected its own" in wrong


def test_what_is_optional_passes_where_it_is_right():
    """And a control step may be a number of NumPy's."""
    env = TOY._replace(
        dt=np.float32(0.02),
        views=Views(np.arange(6), [0, 3], jnp.arange(5)),
        recorded=lambda state: state.last_action,
        evaluated=lambda hyper: hyper,
        known_end=lambda h, prop, context: prop[0] > 1,
        fall_reward=lambda hyper: -1.0,
        sense_context=lambda h, context, key: context,
    )
    build.check(environment.config_for(workdirs.config(**TELLS), env), env)


def test_what_is_no_environment_is_named():
    """What a get_env returned that forgot its return, or returned something else."""
    config = workdirs.config()
    nothing = refused(environment.from_file, lambda config: None, own(config))
    assert "it is None, expected a dynappo.types.Env" in nothing
    assert "it is int, expected" in refused(environment.config_for, config, 5)


@pytest.mark.parametrize(("gone", "now"), environment.GONE.items())
def test_a_field_that_an_environment_had_before_is_named(gone, now):
    """`types.Env` refuses it with a TypeError; any other TypeError of a get_env is its own."""

    def get_env(config):
        return Env(**{name: getattr(TOY, name) for name in TOY._fields} | {gone: None})

    line = refused(environment.from_file, get_env, own(workdirs.config()))
    assert f"the field {gone}, expected {now}" in line
    with pytest.raises(TypeError, match="NoneType"):
        environment.from_file(lambda config: None + 1, own(workdirs.config()))


def own(config):
    """The config of an environment of one's own."""
    return environment.config_for(config, TOY)


def test_the_config_says_that_it_is_no_robots():
    """Its name, the length of episodes, no film; without the environment it cannot be run."""
    config = workdirs.config(run__video_seconds=3.0, task__episode_length=77)
    settled = own(config)
    assert settled.robot == "" and settled.run.video_seconds == 0 and settled.physics.impl == "jax"
    assert settled.task.episode_length == TOY.episode_length == 20
    assert environment.config_for(config, None) is config
    for function in (build.check, build.program):
        assert "robot is '': this config is of an environment of your own" in refused(
            function, settled
        )
    assert environment.from_file(None, config) == (config, None)
    assert environment.from_file(lambda config: TOY, settled) == (settled, TOY)
    both = refused(environment.from_file, lambda config: TOY, config)
    assert "robot is 'go1', but the config's file defines get_env" in both


def test_a_start_that_is_not_finite_is_one_line():
    """NaN in the first observation of one copy."""
    good = toy_env.State(*[jnp.zeros((4, 3))] * 7)
    env_contract.check_start(good)
    bad = good.replace(obs=good.obs.at[2, 1].set(jnp.nan))
    assert "reset's obs is not finite" in refused(env_contract.check_start, bad)

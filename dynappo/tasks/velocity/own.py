"""Terms of one's own (config/terms.py) in the velocity task: what each kind may ask for, and its values.

| kind        | may ask for, beside numbers of the config's groups `task` and `task.own`, and `dt`          |
|-------------|---------------------------------------------------------------------------------------------|
| reward, end | what rewards.py may: quantities of the observation, `Feet`, `action`, `Measured`            |
| observation | quantities that are not one's own, as they are now; `Placed`                                |
| known       | predicted quantities as they are now; known ones, its own too, as they were; `action`       |
| command     | `draw`; `command_x`, `command_y`, `command_yaw`; known ones of one's own, curricula          |
| curriculum  | known ones of one's own, curricula; `command`; `Ended`                                      |

A curriculum's number is a known quantity that the policy does not see: the tail has it, and a reward may ask
for it. The code works with NumPy and jax.numpy.
"""

from __future__ import annotations

import difflib
import json
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from dynappo.config import ConfigError, terms
from dynappo.config.terms import Term, Terms
from dynappo.tasks.velocity import observe, reward_sum, rewards

# what terms may ask for, beside quantities and numbers: by size
SCALARS = "timestep height episode_steps episode_return fell timed_out clearance_share".split()
OF_JOINTS = "action torque joint_velocity_before older_action over_limit".split()
OF_FEET = "contact touchdown last_air_time swing_height foot_side foot_height".split()
BOOLS = "contact touchdown fell timed_out".split()
RANGES = "command_x", "command_y", "command_yaw"


class Placed(NamedTuple):
    """What an observation may ask for that is no quantity itself; in training and in play."""

    qpos: Any  # [7 + A] base and joints, as in observe.py
    qvel: Any  # [6 + A]
    height: Any  # m, of the base's frame above the ground
    contact: Any  # [F] bool: the foot is on the ground


class Ended(NamedTuple):
    """What a curriculum may ask for of an episode that has ended."""

    episode_return: Any
    episode_steps: Any  # control steps
    fell: Any  # bool
    timed_out: Any  # bool


class Own(NamedTuple):
    """The terms of a program."""

    terms: Terms = terms.NONE
    seen: observe.Own = ()
    joints: int = 0
    dt: float = 0.0  # s, a control step


NONE = Own()


def make(task, joints: int, dt: float) -> Own:
    """The terms that the config's group `task` names, which have been read; checked (`check`)."""
    found = check(task)
    return Own(found, observe.own(task.terms_about), joints, dt) if found.path else NONE


def played(task: Mapping[str, Any], joints: int, dt: float) -> Own:
    """As `make`, of a policy's `task`, for play. One that sees nothing of its own needs no file for that.

    ConfigError where it sees some, and its terms have not been read.
    """
    seen = observe.own(task.get("terms_about") or "")
    if not task.get("terms_hash"):
        if seen:  # `terms.use` writes both
            raise ConfigError(f"the policy sees {seen[0].name}, and its config names no terms")
        return NONE
    try:
        return Own(terms.of(task), seen, joints, dt)
    except ConfigError as error:
        shown = [each.name for each in seen if each.shown]
        if not shown:
            return Own(terms.NONE, (), joints, dt)
        raise ConfigError(f"the policy sees {', '.join(shown)}: {error}") from None


def told_ends(task: Mapping[str, Any]) -> list[str]:
    """The names of one's own terminations, of a policy's `task`, whose terms may not have been read."""
    found = json.loads(task.get("terms_about") or "{}").get("terminations", [])
    return [name for name in found if isinstance(name, str) and name.isidentifier()]


# ---- checks


def check(task, symmetry: bool = False) -> Terms:
    """The terms of `task`; ConfigError for a name that clashes, or that a term may not ask for, and, with
    `symmetry`, for an observation without a mirror image."""
    found = terms.of(task)
    for term in found.every():
        paid = isinstance(term.how, terms.Reward)
        _check_name(task, term.name, f"the term {term.name} of {term.file}", reward=paid)
        for wrong in sorted(set(terms.parameters(term.function)) - _names(task, found, term)):
            near = difflib.get_close_matches(wrong, _names(task, found, term), 1)
            raise ConfigError(
                f"the term {term.name} of {term.file} asks for {wrong}, which {_kind(term)} cannot have"
                + (f"; did you mean {near[0]}?" if near else "; docs/task.md says what it can")
            )
    for term in found.observations.values():
        if symmetry and term.how.size is not None and term.how.signs is None:
            raise ConfigError(
                f"the observation {term.name} of {term.file} has no signs, expected those of its mirror "
                "image where ppo.symmetry is True: signs=(1, ...), -1 where left and right flip it"
            )
    of_terms = {term.name for term in found.every()} - {*found.curricula}
    for name in task.own:
        _check_name(task, name, f"the number {name} of {found.path}", of_terms)
    declared = {name for term in found.every() for name in term.numbers} | {*found.curricula}
    noisy = {name for name, term in found.observations.items() if term.how.noise is not None}
    _check_declared("own", set(task.own), declared, "no term has that number")
    builtin = {quantity.noise for quantity in observe.QUANTITIES.values()}
    extra = {n for n in task.noise if n not in builtin and not n.startswith("scan")}
    _check_declared("noise", extra, noisy, "no observation of that name has noise")
    return found


def _kind(term: Term) -> str:
    if isinstance(term.how, terms.Observation) and term.how.start is not None:
        return "a known observation"
    name = type(term.how).__name__.lower()
    return f"{'an' if name[0] == 'o' else 'a'} {name}"


def _check_name(
    task, name: str, what: str, others: Iterable[str] = (), reward: bool = False
) -> None:
    used = {*observe.QUANTITIES, *rewards.Feet._fields, *rewards.Measured._fields, *Placed._fields}
    used |= {*Ended._fields, *reward_sum.in_rewards(), *task, "action", "draw", "dt"}
    used |= {"fall"} if reward else set()  # reward_fall is the column of task.fall_reward
    if name in used or name in others:
        by = "a term has" if name in others else "dynappo uses"
        raise ConfigError(f"{what} has a name that {by} already; expected another one")


def _check_declared(group: str, names: set[str], declared: set[str], text: str) -> None:
    for name in sorted(names - declared):
        near = difflib.get_close_matches(name, declared, 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ConfigError(f"task.{group}.{name}: {text}{hint}")


def _names(task, found: Terms, term: Term) -> set[str]:
    """What a term may ask for."""
    own_known = {n for n, t in found.observations.items() if t.how.start is not None}
    own_known |= {*found.curricula}
    own_predicted = {*found.observations} - own_known
    names = reward_sum.numbers_of(task) | {"dt"}
    gait = set(observe.GAIT) if task.gait_frequency is not None else set()
    known, predicted = {*observe.KNOWN, *gait}, {*observe.PREDICTED}
    how = term.how
    if isinstance(how, (terms.Reward, terms.Termination)):
        names |= reward_sum.known_names(task) | own_known | own_predicted
        return names | {*rewards.Measured._fields}
    if isinstance(how, terms.Command):
        return names | own_known | {"draw", *RANGES}
    if isinstance(how, terms.Curriculum):
        return names | own_known | {"command", *Ended._fields}
    if how.start is None:
        return names | known | predicted | {*Placed._fields}
    return names | known | predicted | own_known | own_predicted | {"action"}


# ---- values


def numbers(hyper) -> dict[str, Any]:
    """Those of `task` and `task.own`, of the config's floats."""
    task = hyper.task._asdict()
    own = task.pop("own", None)
    return task | (own._asdict() if own is not None else {})


def numbers_in(task: Mapping[str, Any]) -> dict[str, float]:
    """As `numbers`, of a config's group `task`."""
    every = {**task, **task.get("own", {})}
    return {name: value for name, value in every.items() if type(value) in (int, float)}


def _value(own: Own, term: Term, facts: Mapping[str, Any]) -> Any:
    value, how, shape = terms.call(term, facts), term.how, ()
    if isinstance(how, terms.Observation):
        shape = (own.joints if how.size is None else how.size,)
    elif isinstance(how, terms.Command):
        shape = (3,)
    if fault := terms.fault(type(how), value, shape):
        raise ConfigError(f"the term {term.name} of {terms.place(term.function)} {fault}")
    return value


def tried(own: Own, used: reward_sum.Terms, facts: Mapping[str, Any]) -> None:
    """Call every term, of rewards those that are `used`, with all that they may ask for and an observation
    `obs` that has a gait clock; ConfigError as of `_value`."""
    facts = _of_trial(own, facts)
    for term in _in_use(own, used):
        _value(own, term, facts)


def tried_in_numpy(
    own: Own, used: reward_sum.Terms, several: list[dict[str, Any]], given: Iterable[str]
) -> None:
    """As `tried`, with NumPy arrays: ConfigError for a term that fails with each of `several` made-up facts.
    `given` are the names of numbers that play knows.

    What play does not call may need JAX, as `x.at`. But no index may be too large: JAX takes the last one.
    """
    played = {*own.terms.observations, *ends_in_play(own, given)}
    every = [_of_trial(own, facts) for facts in several]
    for term in _in_use(own, used):
        errors = [error for facts in every if (error := _refused(own, term, facts))]
        if len(errors) < len(every):  # else it is not the made-up numbers
            continue
        if isinstance(errors[0].__context__, IndexError):
            raise ConfigError(f"{errors[0]}; JAX would take the last one")
        if term.name in played:
            raise ConfigError(f"{errors[0]}; play calls it with NumPy arrays")


def _of_trial(own: Own, facts: Mapping[str, Any]) -> dict[str, Any]:
    seen = observe.split(facts["obs"], own.joints, True, own.seen)
    return {**facts, **scalars(own, seen), "dt": own.dt}


def _in_use(own: Own, used: reward_sum.Terms) -> list[Term]:
    return [t for t in own.terms.every() if t.name in used or not isinstance(t.how, terms.Reward)]


def _refused(own: Own, term: Term, facts: Mapping[str, Any]) -> ConfigError | None:
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of made-up numbers
            _value(own, term, facts)
    except ConfigError as error:
        return error
    return None


def check_finite(own: Own, obs) -> None:
    """ConfigError if a quantity of one's own in the first observations [..., O] is not finite."""
    for each in own.seen:
        where = observe.slices(own.joints, own=own.seen)[each.name]
        if not np.isfinite(np.asarray(obs[..., where])).all():
            raise ConfigError(
                f"the term {each.name} of {own.terms.path} is not finite where an episode begins, expected "
                "finite numbers"
            )


def predicted(own: Own, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The predicted quantities, each [size]."""
    return {
        name: _value(own, term, facts)
        for name, term in own.terms.observations.items()
        if term.how.start is None
    }


def following(own: Own, before: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """The known quantities, curricula among them, one control step after they were `before`."""
    facts = {**facts, **scalars(own, before), "dt": own.dt}
    after = {
        name: _value(own, term, facts)
        for name, term in own.terms.observations.items()
        if term.how.start is not None
    }
    return after | {name: before[name] for name in own.terms.curricula}


def starts(own: Own, given: Mapping[str, Any], xp) -> dict[str, Any] | None:
    """The known quantities where an episode begins, of the `given` numbers; None if there are none."""
    out = {
        name: xp.asarray(term.how.start, dtype=xp.float32)
        for name, term in own.terms.observations.items()
        if term.how.start is not None
    }
    out |= {name: xp.asarray(given[name], dtype=xp.float32)[None] for name in own.terms.curricula}
    return out or None


def levels(own: Own, before: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """The curricula's numbers [1] after an episode that has ended."""
    facts = {**facts, **scalars(own, before), "dt": own.dt}
    out = {name: _value(own, term, facts) for name, term in own.terms.curricula.items()}
    return {name: value * 1.0 + 0 * before[name] for name, value in out.items()}


def scalars(own: Own, parts: Mapping[str, Any]) -> dict[str, Any]:
    """The `parts` of an observation, in which a curriculum's number is no longer [1]."""
    return {n: x[..., 0] if n in own.terms.curricula else x for n, x in parts.items()}


def ends(own: Own, facts: Mapping[str, Any], timeout: bool, names=None) -> dict[str, Any]:
    """Whether each termination of a kind ends the episode; of `names`, or of all."""
    facts = {**facts, "dt": own.dt}
    return {
        name: _value(own, term, facts)
        for name, term in own.terms.terminations.items()
        if term.how.timeout == timeout and (names is None or name in names)
    }


def ends_in_play(own: Own, given: Iterable[str]) -> list[str]:
    """The terminations that ask for no more than play knows, beside the numbers `given`."""
    known = {*given, *observe.quantities(True, own.seen), *Placed._fields, "action", "dt"}
    every = own.terms.terminations.items()
    return [name for name, term in every if known.issuperset(terms.parameters(term.function))]


def sampler(own: Own, given: Mapping[str, Any], before: Mapping[str, Any]) -> Any:
    """`(draws, sample)`: `sample(draw [draws])` is a command [3]; None without one of one's own."""
    term = own.terms.command
    if term is None:
        return None
    seen = {each.name for each in own.seen if each.known}
    facts = {**given, **scalars(own, {n: before[n] for n in seen}), "dt": own.dt}
    return term.how.draws, lambda draw: _value(own, term, {**facts, "draw": draw})


def evaluated(own: Own, hyper) -> Any:
    """The floats of an evaluation: curricula begin where they are evaluated."""
    group = hyper.task.own
    ends = {
        name: group._asdict()[name] * 0 + t.how.evaluated for name, t in own.terms.curricula.items()
    }
    return hyper._replace(task=hyper.task._replace(own=group._replace(**ends)))

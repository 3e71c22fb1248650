"""The reward: finds the term of each weight, calls it with its arguments, and sums.

`task.weights.NAME` is the weight of the function `NAME` in rewards.py, and the function's
parameters say what it needs. So a new term takes two changes: the function, and its weight. A term of one's
own, in a file of one's own, brings both (config/terms.py).
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable
from typing import Any

from dynappo.config import ConfigError, per_joint
from dynappo.config import terms as terms_lib
from dynappo.tasks.velocity import observe, rewards

FILE = "dynappo/tasks/velocity/rewards.py"
Terms = dict[str, Callable[..., Any]]  # by the name of the weight, in the order of rewards.py
# a term that replaces another, and the value of task.air_time for which it does
REPLACEMENTS = {"feet_in_air": ("feet_air_time", "indicator")}


def in_rewards() -> Terms:
    """Every public function of rewards.py."""
    return {
        name: value
        for name, value in vars(rewards).items()
        if inspect.isfunction(value) and value.__module__ == rewards.__name__ and name[0] != "_"
    }


def terms_of(task) -> Terms:
    """The term of each weight of the config's group `task`.

    One that is None leaves its term out. ConfigError for a weight without a term, a term without a weight,
    and a term with an unknown parameter or one that is None.
    """
    own = terms_lib.of(task).rewards
    terms, weights = (
        in_rewards() | {n: terms_lib.guarded(t) for n, t in own.items()},
        set(task.weights),
    )
    for name in sorted(weights - terms.keys()):
        close = difflib.get_close_matches(name, terms, 1)
        raise ConfigError(
            f"task.weights.{name} has no term; expected a function {name} in "
            f"{task.terms or FILE}{f', which has {close[0]}' if close else ''}"
        )
    for name in (n for n in terms if n not in weights and n not in REPLACEMENTS):
        raise ConfigError(
            f"task.weights has no weight of the term {name} of {_file(terms[name])}; add "
            f"`{name}: float = 0.0` to Weights in configs/default.py"
        )
    names = {*known_names(task), *rewards.Measured._fields, *per_joint.names()}
    for name, term in terms.items():
        for wrong in sorted(set(parameters(term)) - names):
            close = difflib.get_close_matches(wrong, names, 1)
            raise ConfigError(
                f"the term {name} of {_file(term)} asks for {wrong}, which is not a quantity of the "
                "observation, nor a number of the config's group task, nor a field of Measured"
                + (f"; did you mean {close[0]}?" if close else "")
            )
    for name, (other, air_time) in REPLACEMENTS.items():
        if task.air_time == air_time:
            terms[other] = terms[name]
    used = {name: term for name, term in terms.items() if task.weights.get(name) is not None}
    for name, term in used.items():
        if task.gait_frequency is None and not observe.GAIT.keys().isdisjoint(parameters(term)):
            raise ConfigError(
                f"task.gait_frequency is None, expected (low, high) in Hz where task.weights.{name} is a "
                "number: its term follows the gait clock; set it, as (1.25, 1.5), or the weight to None"
            )
        for missing in (p for p in parameters(term) if p in task and task[p] is None):
            raise ConfigError(
                f"task.{missing} is None, expected numbers where task.weights.{name} is one: its term "
                f"asks for them; set task.{missing}, or the weight to None"
            )
    return used


def _file(term: Callable[..., Any]) -> str:
    """Where a term is, for messages."""
    own = inspect.unwrap(term)
    return FILE if own.__module__ == rewards.__name__ else terms_lib.place(own)


def parameters(term: Callable[..., Any]) -> tuple[str, ...]:
    """What a term asks for: its parameters without a default."""
    return terms_lib.parameters(term)


def numbers_of(task) -> set[str]:
    """The names of the config's single numbers that a term may ask for: of `task` and `task.own`."""
    return {name for name, value in task.items() if type(value) is float} | {*task.get("own", ())}


def known_names(task) -> set[str]:
    """The names that a term may ask for without physics; of `task`, its floats and numbers of joints [A]."""
    of_joints = {name for name in per_joint.names() if isinstance(task[name], tuple)}
    own = {each.name for each in observe.own(task.terms_about)}
    return {
        *observe.QUANTITIES,
        *own,
        *rewards.Feet._fields,
        "action",
        "dt",
        *numbers_of(task),
        *of_joints,
    }


def known(terms: Terms, task, measured: Iterable[str] = ()) -> Terms:
    """Those of `terms` that can be computed without physics, but for the fields `measured` of `Measured`."""
    names = known_names(task).union(measured)
    return {name: term for name, term in terms.items() if names.issuperset(parameters(term))}


def values(terms: Terms, facts: dict[str, Any]) -> dict[str, Any]:
    """Each term of one robot, unweighted; `facts` has the values that terms ask for, by name.

    ConfigError for a term that is not one number.
    """
    out = {name: term(**{p: facts[p] for p in parameters(term)}) for name, term in terms.items()}
    for name, value in out.items():
        if fault := terms_lib.fault(terms_lib.Reward, value, ()):
            raise ConfigError(f"the term {name} of {_file(terms[name])} {fault}")
    return out


def total(terms: dict[str, Any], weights: Any, dt: float) -> tuple[Any, dict[str, Any]]:
    """`(reward, weighted)`: sum of weight x term x `dt` (s), and each weight x term (per second).

    `terms` are values by name; `weights` has a field of each name.
    """
    weighted = {name: getattr(weights, name) * term for name, term in terms.items()}
    return sum(weighted.values()) * dt, weighted

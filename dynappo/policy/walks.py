"""Whether a robot walks: one definition, for what the commands print and for every experiment. NumPy only.

**A robot walks** from the first evaluation on at which its return is at least its level and at most 1 % of
the episodes have a fall, if both hold at every later evaluation, too (`reached` in experiments/stats.py). A
single evaluation, as here, has no later ones. It takes about a thousand episodes to tell 1 % from 2 %.

The level is a share of the return of perfect tracking, `(w_lin + w_yaw) T` in episodes of T seconds
(tasks/velocity/rewards.py): 38 of 45 for the Unitree robots, 24 of 30 for the ANYmals, both in 20 s. It was
measured with the rewards, commands and ends of their own configs (`MEASURED`), and means nothing with others:
a term of one's own pays or costs, and with slow commands a robot that stands earns much. One weight may be
another: `foot_clearance` from `CLEARANCE` to 0, which costs a robot that walks little.

Everywhere else (`by_return` is False) the level is one of errors, root mean squares as in dynappo/scores.py:
at most 0.2 m/s and 0.25 rad/s; of slow commands at most half, of fast ones a fifth, of what a robot that
stands still would have (asked.py). So it is with `run.walks` = "tracking", too: a biped's reward has terms
for posture and uprightness, so its return says little about how it tracks. And so on rough ground, where an
episode ends at the edge of its tile: who crosses it soon has a smaller return than who stands.

Of tasks of other packages, and of environments of one's own, nothing is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dynappo.policy import asked

SECONDS = 20.0  # of an episode
SETTLE = 1.0  # s of it that are left out of the tracking error, as in dynappo/scores.py
MOST_FALLS = 0.01  # share of the episodes
FALLS_OFTEN = 0.1  # that nobody calls almost walking
MOST_ERRORS = 0.2, 0.25  # m/s, rad/s
SLOW, FAST = 1 / 2, 1 / 5  # of the error of a robot that stands still: at most, and always enough
FEW = 100  # episodes, below which words say how many: in fewer, 1 % is less than one
ROUNDING = 1e-6  # of a share of episodes, a mean in float32
SHARES = {2.25: 38 / 45, 1.5: 24 / 30}  # best possible return of a second -> share of it
SHARE = 0.8  # of any other
# The largest cost of foot_clearance with which a return tells the same (experiments/22_deploy, 21_less)
CLEARANCE = -0.3
# What the levels of returns were measured with: weights that are not 0, and all else that decides a return
UNITREE = {
    "track_linear_velocity": 1.5,
    "track_yaw_rate": 0.75,
    "vertical_velocity": -2.0,
    "roll_pitch_rate": -0.05,
    "flat_orientation": -2.5,
    "joint_torques": -2e-4,
    "joint_accelerations": -2.5e-7,
    "action_rate": -0.01,
    "feet_air_time": 0.25,
}
ANYMAL = UNITREE | {
    "track_linear_velocity": 1.0,
    "track_yaw_rate": 0.5,
    "flat_orientation": -5.0,
    "joint_torques": -2.5e-5,
    "feet_air_time": 0.5,
    "undesired_contacts": -1.0,
}
WEIGHTS = {"go1": UNITREE, "go2": UNITREE, "anymal_c": ANYMAL, "anymal_d": ANYMAL}
MEASURED = {
    "terms": ("",),
    "terrain": ("flat",),
    "tracking_std": (0.5, 1.0),
    "air_time": ("touchdown",),
    "fall_reward": (None,),
    "command_x": ((-1.0, 1.0),),
    "command_y": ((-1.0, 1.0),),
    "command_yaw": ((-1.0, 1.0),),
    "heading": (False,),
    "resample_steps": (0,),
    "standing": (0.0,),
    "slow_commands": (None,),
    "termination": ("parts",),
    "undesired": ("parts",),
    "max_tilt": (None,),
    "clearance_height": (0.06,),
}


def best(weights: Mapping[str, float], seconds: float = SECONDS) -> float:
    """The return of perfect tracking for `seconds`, of the config's `task.weights` (1/s)."""
    return (weights["track_linear_velocity"] + weights["track_yaw_rate"]) * seconds


def level(most: float, seconds: float = SECONDS) -> float:
    """The return from which on a robot walks, of the best possible return `most` in `seconds`."""
    return SHARES.get(round(most / seconds, 6), SHARE) * most


def seldom(fall_rates, most: float = MOST_FALLS) -> np.ndarray:
    """Whether a share of episodes with a fall is at most `most`; a NaN is not."""
    return np.asarray(fall_rates, float) <= most + ROUNDING


def at(returns, least: float) -> np.ndarray:
    """Whether a return is at least `least`, but for the rounding of a number of float32; a NaN is not."""
    return np.asarray(returns, float) >= least * (1 - ROUNDING)


def tracks(errors, yaw_errors, most: tuple[float, float] = MOST_ERRORS) -> np.ndarray:
    """Whether errors, m/s and rad/s, are at most `most`. Elementwise; False where one is NaN."""
    pairs = zip((errors, yaw_errors), most, strict=True)
    within, turns = (np.asarray(x, float) <= m * (1 + ROUNDING) for x, m in pairs)
    return within & turns


def by_return(config) -> bool:
    """Whether the return of a validated config tells that its robot walks: what decides it is as measured."""
    task = config.task
    weights = {name: weight for name, weight in task.weights.items() if weight}
    as_measured = all(task[name] in values for name, values in MEASURED.items())
    as_measured = as_measured and CLEARANCE <= weights.pop("foot_clearance", 0.0) <= 0
    return config.run.walks == "return" and as_measured and weights == WEIGHTS.get(config.robot)


def most_errors(config, still: tuple[float, float]) -> tuple[float, float]:
    """The largest errors, m/s and rad/s, of a robot that walks, of those of one that stands `still`; infinite
    where tracking earns nothing, and absolute where nothing is asked."""
    paid = (config.task.weights[n] > 0 for n in ("track_linear_velocity", "track_yaw_rate"))
    linear, yaw = (
        np.inf if not pays else min(SLOW * error or most, max(most, FAST * error))
        for pays, error, most in zip(paid, still, MOST_ERRORS, strict=True)
    )
    return linear, yaw


def evaluated_seconds(config) -> float:
    """How long an episode of the run's evaluations is."""
    steps = config.run.eval_steps or config.task.episode_length
    return steps * config.physics.substeps * config.physics.timestep


def unmeasured(seconds: float) -> str:
    """Why episodes of so many seconds may have no tracking error."""
    too_short = seconds <= SETTLE * (1 + ROUNDING)
    return "not measured in the first second" if too_short else "nobody stood for a second"


class Said(NamedTuple):
    """What a robot does, and how far it is from that."""

    does: str
    several: str
    nearly: str
    begins: str
    stands: str
    fails: str


WALKS = Said(
    "walks",
    "walk",
    "almost walks",
    "begins to walk",
    "stands, does not walk yet",
    "does not walk yet",
)
TURNS = Said(
    "turns on the spot",
    "turn",
    "almost turns",
    "begins to turn",
    "stands, does not turn yet",
    "does not turn yet",
)
STANDS = Said("stands still", "stand still", "", "", "", "does not stand still")


class Found(NamedTuple):
    """What an evaluation tells of each seed, and what it lacks."""

    returns: np.ndarray
    falls: np.ndarray  # share of the episodes
    errors: np.ndarray  # [2, seeds] m/s, rad/s
    low: np.ndarray  # below the level
    often: np.ndarray  # falls so
    least: float | None  # the level of returns; None: it is one of errors
    most: tuple[float, float]  # m/s, rad/s: that level
    still: tuple[float, float]  # errors of a robot that stands; 0: nothing is asked, or paid


def found(config, evaluation: Mapping[str, Any]) -> Found | None:
    """Judge an evaluation as in a summary.json of the run of a validated `config`.

    None where nothing is known of a robot, where tracking earns nothing, where the episodes are too short to
    tell, and where it is not known what is asked.
    """
    names = "return", "fall_rate", "tracking_error", "yaw_error"
    seconds = evaluated_seconds(config)
    if not config.robot or not {*names} <= evaluation.keys() or seconds <= SETTLE * (1 + ROUNDING):
        return None
    still = asked.of(config)
    most = most_errors(config, still) if still else (np.inf, np.inf)
    if still is None or most == (np.inf, np.inf):
        return None
    returns, falls, error, yaw = (np.array(np.ravel(evaluation[name]), float) for name in names)
    least = level(best(config.task.weights, seconds), seconds) if by_return(config) else None
    low = ~(tracks(error, yaw, most) if least is None else at(returns, least))
    paid = (s if np.isfinite(m) else 0.0 for s, m in zip(still, most, strict=True))
    linear, turn = paid
    errors = np.stack([error, yaw])
    return Found(returns, falls, errors, low, ~seldom(falls), least, most, (linear, turn))


def walking(config, evaluation: Mapping[str, Any]) -> int | None:
    """How many of the seeds walk; None where nothing says so (`found`)."""
    judged = found(config, evaluation)
    return None if judged is None else int((~judged.low & ~judged.often).sum())


def in_words(config, evaluation: Mapping[str, Any], episodes: int | None = None) -> str:
    """What evaluated policies do, in words: walk, turn, fall, or lack; of several seeds, how many walk.

    A robot that does not walk yet is judged by the errors of one that stands still. Where no walk or no turn
    is asked for, none is spoken of. Of fewer than `FEW` `episodes` (of a seed; None: those of the run's own
    evaluations) their number is said, as they tell little. "" where nothing can be said (`found`).
    """
    judged = found(config, evaluation)
    if judged is None:
        return ""
    does, *lacks = _said(judged)
    count = config.run.eval_envs if episodes is None else episodes
    each = " each" * (len(judged.returns) > 1)
    few = f" (of {count} episode{'s' * (count > 1)}{each})" if count < FEW else ""
    return "; ".join([does + few, *lacks])


def _said(judged: Found) -> list[str]:
    """What evaluated policies do, and then what they lack."""
    returns, falls, errors, low, often, least, most, (speed, turn) = judged
    said = WALKS if speed else TURNS if turn else STANDS
    if len(returns) > 1:
        units = zip(most, ("m/s", "rad/s"), strict=True)
        limits = ", ".join(_number(m, unit) for m, unit in units if np.isfinite(m))
        lacks = {f"errors > {limits}" if least is None else f"return < {least:g}": low.sum()}
        lacks |= {f"falls > {100 * MOST_FALLS:g} %": often.sum()}
        parts = [f"{what}: {count}" for what, count in lacks.items() if count]
        return [f"{(~low & ~often).sum()} of {len(returns)} seeds {said.several}", *parts]
    (error, yaw), fallen = errors[:, 0], falls[0]
    if not np.isfinite(error):  # nobody stood for the first second
        return ["falls at once"]
    if not low[0] and not often[0]:
        turns = ", turns" if yaw < 0.5 * turn else ", does not turn yet"
        turns = turns if speed and turn else ""
        return [f"{said.does}{turns}, {'seldom falls' if fallen > ROUNDING else 'does not fall'}"]
    does = said.fails
    if speed or turn:
        share, enough = (error / speed, most[0] / speed) if speed else (yaw / turn, most[1] / turn)
        nearly = share < 0.33 if least is not None else share < 1.5 * enough
        does = said.nearly if nearly and fallen <= FALLS_OFTEN else said.begins
        if share > 0.8:
            does = said.fails if fallen > FALLS_OFTEN else said.stands
    lacks = {}
    if least is not None:
        lacks[f"return {returns[0]:.2f} < {least:g}"] = low[0]
    else:
        for name, x, m, unit in (
            ("error", error, most[0], "m/s"),
            ("yaw rate error", yaw, most[1], "rad/s"),
        ):
            lacks[f"{name} {_number(x, unit)} > {_number(m, unit)}"] = x > m * (1 + ROUNDING)
    lacks |= {f"falls {100 * fallen:.1f} % > {100 * MOST_FALLS:g} %": often[0]}
    return [does, *(what for what, true in lacks.items() if true)]


def _number(error: float, unit: str) -> str:
    return f"{error:.{2 if error >= 0.1 else 3}f} {unit}"

"""Whether a robot walks: one definition, for what the commands print and for every experiment. NumPy only.

**A robot walks** from the first evaluation on at which its return is at least its level and at most 1 % of
the episodes have a fall, if both hold at every later evaluation, too (`reached` in experiments/stats.py). A
single evaluation, as here, has no later ones. It takes about a thousand episodes to tell 1 % from 2 %.

The level is a share of the return of perfect tracking, `(w_lin + w_yaw) T` in episodes of T seconds
(tasks/velocity/rewards.py): 38 of 45 with the weights of the Unitree tasks, 24 of 30 with the ANYmals', both
in 20 s. With weights of your own it is the smaller share, 0.8.

With `run.walks` = "tracking" the level is one of errors: at most 0.2 m/s and 0.25 rad/s, root mean squares
as in dynappo/scores.py. A biped's reward has terms for posture and uprightness, so its return says little
about how it tracks. So it is on rough ground, where an episode ends at the edge of its tile: who crosses it
soon has a smaller return than who stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

SECONDS = 20.0  # of an episode
SETTLE = 1.0  # s of it that are left out of the tracking error, as in dynappo/scores.py
MOST_FALLS = 0.01  # share of the episodes
MOST_ERRORS = 0.2, 0.25  # m/s, rad/s
ROUNDING = 1e-6  # of a share of episodes, a mean in float32
SHARES = {2.25: 38 / 45, 1.5: 24 / 30}  # best possible return of a second -> share of it
SHARE = 0.8  # of any other


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


def tracks(errors, yaw_errors) -> np.ndarray:
    """Whether an evaluation is at the level of errors, m/s and rad/s. Elementwise; False where one is NaN."""
    pairs = zip((errors, yaw_errors), MOST_ERRORS, strict=True)
    within, turns = (np.asarray(x, float) <= most * (1 + ROUNDING) for x, most in pairs)
    return within & turns


def evaluated_seconds(config) -> float:
    """How long an episode of the run's evaluations is."""
    steps = config.run.eval_steps or config.task.episode_length
    return steps * config.physics.substeps * config.physics.timestep


def unmeasured(seconds: float) -> str:
    """Why episodes of so many seconds may have no tracking error."""
    too_short = seconds <= SETTLE * (1 + ROUNDING)
    return "not measured in the first second" if too_short else "nobody stood for a second"


def in_words(config, evaluation: Mapping[str, Any]) -> str:
    """What evaluated policies do, in words: walk, turn, fall, or lack; of several seeds, how many walk.

    `config` is the run's, `evaluation` as in its summary.json. A robot that does not walk yet is judged
    by the errors of one that stands still: the root mean square of the commands. "" where nothing is
    known of a robot, or tracking earns nothing, or the episodes are too short to tell.
    """
    names = "return", "fall_rate", "tracking_error", "yaw_error"
    if not {*names} <= evaluation.keys():
        return ""
    task = config.task
    seconds = evaluated_seconds(config)
    # on rough ground an episode ends where the robot leaves its tile, and so its return
    by_errors = config.run.walks == "tracking" or config.task.terrain == "rough"
    least = level(best(task.weights, seconds), seconds)
    if seconds <= SETTLE * (1 + ROUNDING) or not (by_errors or least > 0):
        return ""
    returns, falls, error, yaw = (np.array(np.ravel(evaluation[name]), float) for name in names)
    low, often = ~(tracks(error, yaw) if by_errors else at(returns, least)), ~seldom(falls)
    walking = ~low & ~often
    if len(returns) > 1:
        lacks = {
            f"errors > {_errors(*MOST_ERRORS)}" if by_errors else f"return < {least:g}": low.sum()
        }
        lacks |= {f"falls > {100 * MOST_FALLS:g} %": often.sum()}
        parts = [f"{what}: {count}" for what, count in lacks.items() if count]
        return "; ".join([f"{walking.sum()} of {len(returns)} seeds walk", *parts])
    if not np.isfinite(error[0]):  # nobody stood for the first second
        return "falls at once"
    share, turn = error[0] / still(task.command_x, task.command_y), yaw[0] / still(task.command_yaw)
    if walking[0]:
        turning = "turns" if turn < 0.5 else "does not turn yet"
        return f"walks, {turning}, {'seldom falls' if falls[0] > ROUNDING else 'does not fall'}"
    does = "almost walks" if share < 0.33 else "begins to walk"
    if share > 0.8:
        does = "does not walk yet" if falls[0] > 0.1 else "stands, does not walk yet"
    lacks = {f"return {returns[0]:.2f} < {least:g}": low[0]}
    if by_errors:
        lacks = {f"errors {_errors(error[0], yaw[0])} > {_errors(*MOST_ERRORS)}": low[0]}
    lacks |= {f"falls {100 * falls[0]:.1f} % > {100 * MOST_FALLS:g} %": often[0]}
    return "; ".join([does, *(what for what, true in lacks.items() if true)])


def _errors(error: float, yaw_error: float) -> str:
    return f"{error:.2f} m/s, {yaw_error:.2f} rad/s"


def still(*ranges: tuple[float, float]) -> float:
    """Root mean square of commands drawn uniformly from `ranges`: the error of a robot that stands still."""
    square = sum((low * low + low * high + high * high) / 3 for low, high in ranges)
    return max(square**0.5, 1e-6)

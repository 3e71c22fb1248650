"""How fast a run's task asks its robot to walk and to turn: root mean squares of its commands. NumPy only.

They are the tracking errors of a robot that stands still.
"""

from __future__ import annotations

import numpy as np

from dynappo.config import ConfigError, terms
from dynappo.tasks.velocity import observe
from dynappo.tasks.velocity import own as own_lib

DRAWS = 1000  # of a command of one's own


def of(config) -> tuple[float, float] | None:
    """`(m/s, rad/s)` of a validated config; None where its terms have not been read, or cannot be called."""
    task = config.task
    try:
        drawn = _own(config)
    except ConfigError:
        return None
    if drawn is None:
        speed, turn = uniform(task.command_x, task.command_y), uniform(task.command_yaw)
    else:
        speed, turn = (_root_mean_square(drawn[:, part]) for part in ([0, 1], [2]))
    # of a slow one the share is uniform from 0 to 0.5 (tasks/velocity/commands.py): a mean square of 1/12
    whole = (1 - (task.slow_commands or 0.0) * (1 - 1 / 12)) ** 0.5
    speed, turn = whole * speed, whole * turn
    if task.heading:  # as of a robot that turns to none (tasks/velocity/commands.py)
        angles = np.linspace(-np.pi, np.pi, DRAWS)[:, None]
        turn = _root_mean_square(np.clip(task.heading_gain * angles, *task.command_yaw))
    moving = (1 - task.standing) ** 0.5
    return moving * speed, moving * turn


def uniform(*ranges: tuple[float, float]) -> float:
    """Root mean square of commands drawn uniformly from `ranges`, of the vector that they are."""
    return sum((low * low + low * high + high * high) / 3 for low, high in ranges) ** 0.5


def _own(config) -> np.ndarray | None:
    """Commands [DRAWS, 3] of one's own, with curricula as in an evaluation; None without such a command."""
    task = config.task
    found = terms.of(task)
    if found.command is None:
        return None
    dt = config.physics.substeps * config.physics.timestep
    own = own_lib.Own(found, observe.own(task.terms_about), dt=dt)
    levels = {name: term.how.evaluated for name, term in found.curricula.items()}
    given = {**task, **task.own, **levels}
    count, sample = own_lib.sampler(own, given, own_lib.starts(own, given, np) or {})
    drawn = np.random.default_rng(0).random((DRAWS, count))
    return np.array([sample(one) for one in drawn], float)


def _root_mean_square(vectors: np.ndarray) -> float:
    return float(np.sqrt((vectors**2).sum(-1).mean()))

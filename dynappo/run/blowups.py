"""Physics that an engine cannot compute: told where it is some of the rows; where it is most, a run ends.

Such a row has reward 0 and its robot begins anew, so returns and errors of a run with many are of few rows.
"""

from __future__ import annotations

import numpy as np

SOME, MOST = 0.01, 0.5  # shares of the rows that physics writes
DO = "lower task.kp and task.kd, physics.timestep or ppo.init_std, or raise task.armature"


def share(metrics: dict[str, np.ndarray], num_envs: int) -> float:
    """The share of the real rows of these iterations that blew up; of several seeds the largest."""
    if "blowups" not in metrics:
        return 0.0
    rows = np.asarray(metrics["n_real"], float).sum() * num_envs
    return float(np.max(np.nansum(metrics["blowups"], 0)) / max(rows, 1.0))


def check(metrics: dict[str, np.ndarray], num_envs: int) -> str:
    """A line on the blow-ups of a chunk; "" where they are few. FloatingPointError where they are most of its
    rows."""
    found = share(metrics, num_envs)
    if found < SOME:
        return ""
    first, last = (int(metrics["iteration"][i]) for i in (0, -1))
    text = f"physics blew up in {found:.0%} of the rows of iterations {first} to {last}"
    if found >= MOST:
        raise FloatingPointError(
            f"{text}: nothing can be learned from the others. {DO[0].upper()}{DO[1:]}"
        )
    return f"{text}, which count as falls with reward 0 (blowups in metrics.csv); {DO}"

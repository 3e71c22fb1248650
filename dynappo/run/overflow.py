"""An engine that had no room for some contacts or constraints left them out: the run ends with a line."""

from __future__ import annotations

import numpy as np

PREFIX = "overflow_"  # of metrics: the share of physics' rows in which something had no room


def check(metrics: dict[str, np.ndarray]) -> None:
    """FloatingPointError for the first iteration in which the engine left something out."""
    for name in (name for name in metrics if name.startswith(PREFIX)):
        share = np.asarray(metrics[name])
        bad = np.flatnonzero((share > 0).reshape(len(share), -1).any(1))
        if len(bad):
            what, iteration = name.removeprefix(PREFIX), int(metrics["iteration"][bad[0]])
            raise FloatingPointError(
                f"MuJoCo Warp had no room for all {what} in iteration {iteration}, in "
                f"{share[bad[0]].max():.2%} of the rows, and left some out: these physics are wrong. Use "
                "physics.impl=jax, or raise ROOM in dynappo/tasks/playground/loading.py"
            )

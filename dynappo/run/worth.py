"""Which policy of a run is the best, of its checkpoints and of its seeds: one rule. NumPy only.

The one that crosses the largest share of its tiles in an evaluation (`crossed` in dynappo/scores.py). Of
equals, and where there are no tiles, the one with the highest return. On rough ground an episode ends at the
edge of its tile, so the return falls as a policy learns to cross sooner.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

MEASURES = ("crossed", "return")  # of an evaluation; one counts where those before it are equal


def worth(evaluation: Mapping[str, float]) -> tuple[float, ...]:
    """One number for each of `MEASURES`: the better policy has the larger tuple. What is missing, or NaN, is
    below every number; without a return nothing counts."""
    found = [float(evaluation.get(name, np.nan)) for name in MEASURES]
    if np.isnan(found[-1]):
        return (-np.inf,) * len(MEASURES)
    return tuple(-np.inf if np.isnan(value) else value for value in found)


def best(evaluation: Mapping[str, Any]) -> int:
    """The seed of the best policy, the first of equals; `evaluation` has arrays `[S]`."""
    known = {name: evaluation[name] for name in MEASURES if name in evaluation}
    seeds = range(len(known["return"]))
    return max(seeds, key=lambda seed: worth({name: of[seed] for name, of in known.items()}))

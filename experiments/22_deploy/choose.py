"""Which seed of a policy for hardware is bundled: the one that falls least, then the one that tracks best.

    python experiments/22_deploy/choose.py OUT/go1-bundled.2.npz ... > experiments/22_deploy/choose.txt

Seeds are played in the order of their last return, until one does not fall at all: four minutes a policy on
a core. C MuJoCo. Prints a row a policy:

- stress: falls in the rows of `dynappo evaluate --stress`, eight episodes each
- error: mean tracking error, m/s; half of it is that of these rows, half that of the 45 commands
- commands, worst: falls on the 45 commands of `dynappo evaluate`, and the largest error on one, m/s or rad/s
- changes: falls after 600 changes of command drawn at random (seeds 0 to 2), or before the first of a walk
- tours: falls on those of the film and of the live page

`best` puts them in order: all falls, then the error.
"""

import sys
from pathlib import Path

import numpy as np

from dynappo.evaluate import changes, stress, trials
from dynappo.policy import policy_source

SEEDS = (0, 1, 2)  # of the changes of command
FALLS = ("stress", "commands", "changes", "tours")


def main():
    for name in sys.argv[1:]:
        row = measure(name)
        text = ", ".join(f"{key} {value:.3g}" for key, value in row.items())
        print(f"{Path(name).stem:20s} {text}", flush=True)


def measure(name: str) -> dict[str, float]:
    """The numbers of a policy, by name or file."""
    policy, _ = policy_source.load(name)
    body, _ = policy_source.player(policy)
    disturbed = stress.run(policy, body)
    walks = trials.run(policy, player=body)[0]["commands"]
    told = [changes.run(body, seed=seed) for seed in SEEDS]
    return {
        "stress": sum(row["falls"] for row in disturbed),
        "error": (error(disturbed) + error(walks)) / 2,
        "commands": sum(row["fall"] is not None for row in walks),
        "worst": max(row[e] or 0.0 for row in walks for e in ("tracking_error", "yaw_error")),
        "changes": sum(one["falls"] + one["start_falls"] for one in told),
        "tours": sum(len(tour["fell_at"]) for tour in changes.tours(body)),
    }


def error(rows: list[dict]) -> float:
    """Mean tracking error of the rows that have one."""
    return float(np.nanmean([row["tracking_error"] or np.nan for row in rows]))


def best(rows: dict[str, dict[str, float]]) -> list[str]:
    """Names, the best first."""
    return sorted(rows, key=lambda n: (sum(rows[n][kind] for kind in FALLS), rows[n]["error"]))


if __name__ == "__main__":
    main()

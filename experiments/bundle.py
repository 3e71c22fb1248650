"""Put a trained policy among those that come with a robot, and beside it what it is.

    python experiments/bundle.py OUT/go1-bundled.2.npz robots/go1/deploy.npz

OUT has what 21_less/run.py --policies wrote: the policy of seed K at the last evaluation, NAME.K.npz, and
NAME.csv. Writes the policy without its value function, and a JSON of that name: the job, the seed, the
steps and the last evaluation.
"""

import csv
import json
from pathlib import Path

import numpy as np

from dynappo.policy import policy_file
from experiments import paper


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("policy", type=Path)
    parser.add_argument("to", type=Path)
    args = parser.parse_args()
    name, seed = args.policy.stem.rsplit(".", 1)
    with np.load(args.policy) as arrays:
        kept = {key: arrays[key] for key in arrays if not key.startswith("critic/")}
    with args.to.open("wb") as file:
        np.savez_compressed(file, **kept)
    with (args.policy.parent / f"{name}.csv").open(newline="") as file:
        about = last(list(csv.DictReader(file)), int(seed))
    about = {"seed": int(seed), "robot": policy_file.load(args.to).robot, **about}
    args.to.with_suffix(".json").write_text(json.dumps(about, indent=2) + "\n")


def last(rows: list[dict], seed: int) -> dict:
    """What the last evaluation of the seed (0, 1, ...) of a run says."""
    first = min(int(row["seed"]) for row in rows)
    row = [row for row in rows if int(row["seed"]) == first + seed][-1]
    told = ("return", "fall_rate", "tracking_error", "yaw_error")
    numbers = {key: int(row[key]) for key in ("iteration", "sim_steps")}
    return {
        "job": row["job"],
        "run_seed": first + seed,
        **numbers,
        "evaluation": {key: float(row[key]) for key in told},
    }


if __name__ == "__main__":
    main()

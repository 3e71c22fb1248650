r"""Put trained policies beside their robots: the files that `dynappo play go1` plays.

    python experiments/run.py OUT go1:best go2:best anymal_c:best anymal_d:best \
        --policies --seeds 6 --set run.eval_envs=500
    python experiments/01_four_robots/bundle.py go1=OUT/go1_best.5.npz go2=OUT/go2_best.2.npz ...
    python experiments/01_four_robots/bundle.py go1_deploy=OUT/g.0.npz go2_rough=OUT/go2-best.0.npz ...

Writes robots/ROBOT/policy.npz, of go1_deploy robots/go1/deploy.npz, of go2_rough robots/go2/rough.npz,
without the value function, which only training needs, and a JSON with what is known of it: from
OUT/go1_best.json the numbers of that seed, or from OUT/g.csv (experiments/21_less/run.py) its last
evaluation. A policy that falls on one of the 45 commands of `dynappo evaluate`, or is off by more than
`WORST` on one, is not taken; a humanoid, which walks by its errors, may be off by as much as then counts as
walking (dynappo/policy/walks.py). One for rough ground was told headings, not yaw rates: it must not fall,
and `evaluate --crossing` says what it can do.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np
from ml_collections import config_dict

from dynappo.config import files
from dynappo.description import robot as robot_lib
from dynappo.evaluate import trials
from dynappo.policy import policy_file, walks

KEEP = (
    "robot job return return_max iterations sim_steps seconds device impl versions evaluation set"
)

WORST = 0.2  # m/s and rad/s
EVALUATED = "return fall_rate tracking_error yaw_error crossed fell".split()  # those that a run has


def main():
    for argument in sys.argv[1:]:
        name, source = argument.split("=")
        robot, _, file = (name, "", "policy") if name in files.robots() else name.rpartition("_")
        policy = policy_file.load(Path(source))
        tracks = policy.config["run"].get("walks") == "tracking"
        worst = walks.MOST_ERRORS if tracks else (WORST, WORST)
        worst = (np.inf, np.inf) if file == "rough" else worst
        for row in trials.run(policy)[0]["commands"]:
            off = row["tracking_error"] or 0, row["yaw_error"] or 0
            if row["fall"] is not None or np.greater(off, worst).any():
                raise SystemExit(f"{source} falls, or is off by {off}, at {row['command']}")
        run, seed = source.removesuffix(".npz").rsplit(".", 1)
        known = of_run(Path(run), int(seed))
        params = {part: policy.params[part] for part in ("actor", "std")}
        config = config_dict.ConfigDict(policy.config)
        out = Path("robots") / robot / file
        far = {name: getattr(policy, name) for name in policy_file.TRAINED}
        policy_file.save(out.with_suffix(".npz"), params, config, robot_lib.load(robot), **far)
        files.write_json(out.with_suffix(".json"), {"seed": int(seed), "robot": robot} | known)
        print(name, out.with_suffix(".npz").stat().st_size // 1000, "kB")


def of_run(run: Path, seed: int) -> dict:
    """What RUN.json or RUN.csv tells of one of its seeds."""
    # a name may have a dot in it, as best0.2-h
    summary, table = (run.with_name(run.name + end) for end in (".json", ".csv"))
    if summary.exists():
        found = json.loads(summary.read_text())
        return of_seed({k: found[k] for k in KEEP.split() if k in found}, seed)
    with table.open() as file:
        rows = list(csv.DictReader(file))
    last = [row for row in rows if row["iteration"] == rows[-1]["iteration"]][seed]
    numbers = {name: float(last[name]) for name in EVALUATED if last.get(name)}
    steps = {name: int(last[name]) for name in ("iteration", "sim_steps")}
    return {"job": last["job"], "run_seed": int(last["seed"])} | steps | {"evaluation": numbers}


def of_seed(node, seed: int):
    """`node` with the seed's number in place of a list of one a seed."""
    if isinstance(node, dict):
        return {name: of_seed(value, seed) for name, value in node.items()}
    numbers = isinstance(node, list) and all(isinstance(value, float) for value in node)
    return node[seed] if node and numbers else node


if __name__ == "__main__":
    main()

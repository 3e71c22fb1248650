"""Put trained policies beside their robots: the files that `python -m dynappo.play go1` plays.

    python experiments/run.py OUT go1:best go2:best anymal_c:best anymal_d:best --policies
    python experiments/01_four_robots/bundle.py go1=OUT/go1_best anymal_c=OUT/anymal_c_best ...

Takes NAME.npz and NAME.json of run.py; writes robots/ROBOT/policy.npz without the value function,
which only training needs, and policy.json with what is known of it. Of several seeds it is the one that
run.py chose.
"""

import json
import sys
from pathlib import Path

import numpy as np
from ml_collections import config_dict

from dynappo.config import files
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file

KEEP = (
    "robot job return return_max iterations sim_steps seconds device impl versions evaluation set"
)


def main():
    for argument in sys.argv[1:]:
        name, source = argument.split("=")
        policy = policy_file.load(Path(f"{source}.npz"))
        params = {part: policy.params[part] for part in ("actor", "std")}
        config = config_dict.ConfigDict(policy.config)
        folder = Path("robots") / name
        policy_file.save(folder / "policy.npz", params, config, robot_lib.load(name))
        summary = json.loads(Path(f"{source}.json").read_text())
        # without it, that of the highest return in the end: 0 where there is one seed
        seed = summary.get("policy_seed", int(np.argmax(summary["return"])))
        known = {"seed": seed} | {k: summary[k] for k in KEEP.split() if k in summary}
        files.write_json(folder / "policy.json", of_seed(known, seed))
        print(name, (folder / "policy.npz").stat().st_size // 1000, "kB")


def of_seed(node, seed: int):
    """`node` with the seed's number in place of a list of one a seed."""
    if isinstance(node, dict):
        return {name: of_seed(value, seed) for name, value in node.items()}
    numbers = isinstance(node, list) and all(isinstance(value, float) for value in node)
    return node[seed] if node and numbers else node


if __name__ == "__main__":
    main()

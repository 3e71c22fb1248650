"""Put trained policies beside their robots: the files that `python -m dynappo.play go1` plays.

    python experiments/01_four_robots/bundle.py go1=OUT/go1_ppo16 anymal_c=OUT/anymal_c_ppo16 ...

Takes NAME.npz and NAME.json of run.py; writes robots/ROBOT/policy.npz without the value function,
which only training needs, and policy.json with the evaluation of 1000 episodes.
"""

import json
import sys
from pathlib import Path

from ml_collections import config_dict

from dynappo import log, policy_file
from dynappo import robot as robot_lib

KEEP = "robot return return_max iterations sim_steps seconds device impl versions evaluation set"


def main():
    for argument in sys.argv[1:]:
        name, source = argument.split("=")
        policy = policy_file.load(Path(f"{source}.npz"))
        params = {part: policy.params[part] for part in ("actor", "std")}
        config = config_dict.ConfigDict(policy.config)
        folder = Path("robots") / name
        policy_file.save(folder / "policy.npz", params, config, robot_lib.load(name))
        summary = json.loads(Path(f"{source}.json").read_text())
        log.write_json(
            folder / "policy.json", {k: summary[k] for k in KEEP.split() if k in summary}
        )
        print(name, (folder / "policy.npz").stat().st_size // 1000, "kB")


if __name__ == "__main__":
    main()

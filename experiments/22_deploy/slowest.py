"""From which speed on do policies follow a command from standing, and do they stand still? In C MuJoCo.

    python experiments/22_deploy/slowest.py go1_deploy OUT/slow-h.0.npz ... > slowest.csv

A line a policy:

- ahead, back, left (m/s), turning_left (rad/s): `dynappo.evaluate.slow`; empty where it does not follow 0.5
- standing: speed of the joints where it is asked to stand (rad/s, root mean square, the mean of 4 s)
- clearance (cm, at 0.5 m/s) and cost_of_transport: as gait.py
"""

import csv
import importlib
import sys
from pathlib import Path

import mujoco
import numpy as np

from dynappo.evaluate import slow
from dynappo.policy import episode, policy_file, policy_source

gait = importlib.import_module("experiments.22_deploy.gait")

SECONDS, SETTLE = 6.0, 2.0  # of standing, and what is left out


def main():
    writer = csv.writer(sys.stdout, lineterminator="\n")
    directions = [name.replace(" ", "_") for name in slow.DIRECTIONS]
    writer.writerow(["policy", *directions, "standing", "clearance", "cost_of_transport"])
    for name in sys.argv[1:]:
        writer.writerow([Path(name).stem, *measure(policy_source.load(name)[0])])
        sys.stdout.flush()


def measure(policy) -> list:
    """The numbers of a line."""
    player = policy_source.player(policy)[0]
    found, walk = slow.run(player), gait.measure(policy)
    speeds = [found.get(name) for name in slow.DIRECTIONS]
    others = standing(player), walk["clearance at 0.5 m/s cm"], walk["cost of transport"]
    return ["" if x is None else f"{x:g}" for x in speeds] + [f"{x:.3g}" for x in others]


def standing(player) -> float:
    """Speed of the joints (rad/s) of a robot that is asked to stand; NaN after a fall."""
    act = policy_file.actor(player.policy.params, player.policy.activation)
    data, dt, speeds = mujoco.MjData(player.model), episode.period(player), []
    rows = episode.rows(player, data, act, lambda t: np.zeros(3))
    for k in range(round(SECONDS / dt)):
        if next(rows)["fell"]:
            return np.nan
        if k * dt >= SETTLE:
            speeds.append(np.sqrt(np.mean(np.square(data.qvel[6:]))))
    return float(np.mean(speeds))


if __name__ == "__main__":
    main()

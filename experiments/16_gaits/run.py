"""Figure 9: how PPO-16 and the 4-step tail walk at iterations 300, 400 and 500; Go1, the same seeds.

    python experiments/16_gaits/run.py [--quick] [--out DIR]

Trains both, keeps the actors in DIR/policies (not committed), plays each on C MuJoCo without noise at
0.5 and 1.0 m/s, and writes DIR/results/episodes.csv (a row an episode) and poses.npz (seed 0, for the
film strips). What is there is not made again. Then table, figure and strips, as plot.py.
"""

from pathlib import Path

import gait
import jax
import numpy as np
import plot

from dynappo.policy import policy_file
from experiments import paper, run

SEEDS, SECONDS = 3, 10.0
AT = (300, 400, 500)
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0")


def main():
    args = paper.options(Path(__file__).parent, __doc__)
    at, seeds, settings = ((5, 10), 2, paper.QUICK) if args.quick else (AT, SEEDS, SETTINGS)
    policies, results = args.out / "policies", args.out / "results"
    for variant in plot.VARIANTS:
        if not policy(policies, variant, at[-1], seeds - 1).exists():
            keep(policies, variant, at, seeds, settings, args.lock)
    if not (results / "episodes.csv").exists():
        rows, poses = [], {}
        for variant in plot.VARIANTS:
            for iteration in at:
                for seed in range(seeds):
                    path = policy(policies, variant, iteration, seed)
                    for speed in plot.SPEEDS:
                        seconds = 5.0 if args.quick else SECONDS
                        episode, measures = gait.walk(policy_file.load(path), speed, seconds)
                        row = {"variant": variant, "iteration": iteration, "speed": speed}
                        rows.append(row | {"seed": seed} | measures)
                        if seed == 0:
                            poses[plot.key(variant, iteration, speed)] = gait.strip(episode)
        paper.write(results / "episodes.csv", rows)
        np.savez_compressed(results / "poses.npz", **poses)
    plot.make(args.out)
    plot.strips(args.out)


def policy(folder: Path, variant: str, iteration: int, seed: int) -> Path:
    return folder / f"go1_{variant}_{iteration}_seed{seed}.npz"


def keep(folder: Path, variant: str, at, seeds: int, settings, lock=None) -> None:
    """Train, and write the actor of every seed at the iterations `at`."""
    folder.mkdir(parents=True, exist_ok=True)
    config = run.configure(f"go1:{variant}", seeds, settings)
    for program, done, state, _ in run.chunks(config, lock):
        if done in at:
            actor = jax.device_get(state.learner.params["actor"])
            for s in range(seeds):
                one = {"actor": jax.tree.map(lambda leaf, s=s: leaf[s], actor)}
                policy_file.save(policy(folder, variant, done, s), one, config, program.robot)


if __name__ == "__main__":
    main()

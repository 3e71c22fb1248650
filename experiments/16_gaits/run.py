"""Figure 9: how PPO-16 and the 4-step tail walk while they learn; the same seeds for both.

    python experiments/16_gaits/run.py [--robot go2] [--quick] [--out DIR]

Trains both, keeps the actors of `paper.CHECKPOINTS` in DIR/policies (not committed), plays each on C
MuJoCo without noise at 0.5 and 1.0 m/s, and writes episodes.csv (a row an episode) into
DIR/results/ROBOT. What is there is not made again; policies of the tail may come from
`11_model/run.py --policies`. Then tables and figure, as plot.py.
"""

from pathlib import Path

import gait
import plot

from dynappo.policy import policy_file
from experiments import paper, run

SEEDS, SECONDS = 5, 10.0
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0", "run.seed=500")


def main():
    of = paper.parser(__doc__)
    of.add_argument("--robot", default="go1", choices=paper.ROBOTS)
    args = paper.options(Path(__file__).parent, of)
    at, seeds, settings = paper.CHECKPOINTS, SEEDS, SETTINGS
    if args.quick:
        at, seeds, settings = (5, 10), 2, paper.QUICK
    policies, results = args.out / "policies", args.out / "results" / args.robot
    if not (results / "episodes.csv").exists():
        for variant in plot.VARIANTS:
            job = f"{args.robot}:{variant}"
            if not run.actor(policies, job, at[-1], seeds - 1).exists():
                own = paper.TAILS if variant.startswith("dyna") else ()
                config = run.configure(job, seeds, (*settings, *own))
                for program, done, state, _ in run.chunks(config, args.lock):
                    if done in at:
                        run.keep_actors(policies, job, done, config, program, state)
        play(policies, results, args.robot, at, seeds, 5.0 if args.quick else SECONDS)
    plot.make(args.out)


def play(policies: Path, results: Path, robot: str, at, seeds: int, seconds: float) -> None:
    """Every policy at every speed."""
    rows = []
    for variant in plot.VARIANTS:
        for iteration in at:
            for seed in range(seeds):
                path = run.actor(policies, f"{robot}:{variant}", iteration, seed)
                for speed in plot.SPEEDS:
                    measures = gait.walk(policy_file.load(path), speed, seconds)
                    row = {"variant": variant, "iteration": iteration, "speed": speed}
                    rows.append(row | {"seed": seed} | measures)
    paper.write(results / "episodes.csv", rows)


if __name__ == "__main__":
    main()

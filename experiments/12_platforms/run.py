"""Tables III and V: five variants on four robots, and ours; 5 seeds each.

    python experiments/12_platforms/run.py [--quick] [--out DIR]

The same runs one at a time: python experiments/run.py DIR/results go1:ppo16 go1:dyna4 ... --seeds 5
Runs whose JSON is in DIR/results are skipped. Then tables and figure, as plot.py.
"""

from pathlib import Path

import plot

from experiments import paper, run

SEEDS = 5


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    jobs = [f"{robot}:{variant}" for robot in paper.ROBOTS for variant in paper.variants(robot)]
    seeds, settings = SEEDS, ("run.eval_envs=200", "run.checkpoint_every=0")
    if args.quick:
        jobs, seeds, settings = ["go1:ppo16", "go1:dyna4"], 2, paper.QUICK
    run.batch(args.out / "results", jobs, seeds, settings, lock=args.lock)
    plot.make(args.out)


if __name__ == "__main__":
    main()

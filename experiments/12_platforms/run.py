"""Tables III and V: five variants on four robots, and `fast` on Go1.

    python experiments/12_platforms/run.py [--quick] [--out DIR]

10 fresh seeds of Go1, 5 of the others (and of `fast`), evaluated every 50 iterations. The paper's tails fit
their model in TF32. The same runs one at a time: python experiments/run.py, with the README's settings.
Runs whose JSON is in DIR/results are skipped. Then tables and figure, as plot.py.
"""

from pathlib import Path

import plot

from experiments import paper, run

SEEDS, HEADLINE = 5, 10  # of Go1 in the paper's variants
SETTINGS = (
    "run.seed=400 run.log_every=50 run.eval_every=50 run.eval_envs=200 run.checkpoint_every=0"
).split()


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    results = args.out / "results"
    if args.quick:
        run.batch(results, ["go1:ppo16", "go1:dyna4"], 2, paper.QUICK, lock=args.lock)
    else:
        for robot in paper.ROBOTS:
            for variant in paper.variants(robot):
                seeds = HEADLINE if robot == "go1" and variant != "fast" else SEEDS
                settings = (*SETTINGS, *(paper.TAILS if variant.startswith("dyna") else ()))
                run.batch(results, [f"{robot}:{variant}"], seeds, settings, lock=args.lock)
    plot.make(args.out)


if __name__ == "__main__":
    main()

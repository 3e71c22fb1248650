"""Table I and figure 4: plain PPO on Go1 by number of robots R and rows N; 30 cells, 3 seeds.

    python experiments/10_ablation/run.py [--quick] [--out DIR]

Runs whose JSON is in DIR/results are skipped, and those that 12_platforms has (4096 robots, 12 and 16
rows; 5 seeds). Then table and figure, as plot.py.
"""

from pathlib import Path

import plot

from experiments import paper, run

SEEDS = 3  # as the paper
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0")  # the table needs returns only


def main():
    args = paper.options(Path(__file__).parent, __doc__ or "")
    grid = [(16, 12), (32, 16)] if args.quick else plot.GRID
    seeds, settings = (2, paper.QUICK) if args.quick else (SEEDS, SETTINGS)
    jobs = [plot.job(*cell) for cell in grid if not plot.load(args.out / "results", *cell)]
    run.batch(
        args.out / "results",
        jobs,
        seeds,
        settings,
        thin=5 if args.quick else paper.EVERY,
        lock=args.lock,
    )
    plot.make(args.out, grid)


if __name__ == "__main__":
    main()

"""Table I and figure 4: plain PPO on Go1 by number of robots R and rows N; 30 cells.

    python experiments/10_ablation/run.py [--quick] [--out DIR]

3 seeds, and 5 where the return rises most. Runs whose JSON is in DIR/results are skipped, and those that
other folders have (plot.ELSEWHERE). Then table and figure, as plot.py.
"""

from pathlib import Path

import plot

from experiments import paper, run

SEEDS = 3  # as the paper
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0")  # the table needs returns only
EVALUATED = ("run.eval_envs=200", "run.checkpoint_every=0")  # 17_regimes needs more of plot.FIVE


def main():
    args = paper.options(Path(__file__).parent, __doc__)
    grid = [(16, 12), (32, 16)] if args.quick else plot.GRID
    results, thin = args.out / "results", 5 if args.quick else paper.EVERY
    for cell in grid:
        if not plot.load(results, *cell):
            seeds, settings = (5, EVALUATED) if cell in plot.FIVE else (SEEDS, SETTINGS)
            if args.quick:
                seeds, settings = 2, paper.QUICK
            run.batch(results, [plot.job(*cell)], seeds, settings, thin=thin, lock=args.lock)
    plot.make(args.out, grid)


if __name__ == "__main__":
    main()

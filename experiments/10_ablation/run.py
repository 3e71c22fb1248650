"""Table I and figure 4: plain PPO on Go1 by number of robots R and rows N; 30 cells.

    python experiments/10_ablation/run.py [--more [R ...]] [--quick] [--out DIR]

3 seeds, and 5 where the return rises most. Runs whose JSON is in DIR/results are skipped, and those that
other folders have (plot.ELSEWHERE). --more runs two fresh seeds of each cell that has 3, of all R or of
these: first those whose seeds differ most, where the map is steep. They go to DIR/results/more and count with
the others (experiments/batches.py). Then table and figure, as plot.py.
"""

from pathlib import Path

import plot

from experiments import paper, run

SEEDS, MORE = 3, 2  # 3 as the paper
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0")  # the table needs returns only
EVALUATED = ("run.eval_envs=200", "run.checkpoint_every=0")  # 17_regimes needs more of plot.FIVE


def main():
    of = paper.parser(__doc__)
    of.add_argument("--more", type=int, nargs="*", metavar="R", help="two fresh seeds more")
    args = paper.options(Path(__file__).parent, of)
    grid = [(16, 12), (32, 16)] if args.quick else plot.GRID
    results, thin = args.out / "results", 5 if args.quick else paper.EVERY
    settings = paper.QUICK if args.quick else SETTINGS
    for cell in grid if args.more is None else ():
        if not plot.load(results, *cell):
            seeds, own = (5, EVALUATED) if cell in plot.FIVE else (SEEDS, settings)
            run.batch(results, [plot.job(*cell)], seeds, own, thin=thin, lock=args.lock)
    if args.more is not None:
        jobs = [plot.job(*cell) for cell in few(results, grid, args.more)]
        fresh = (*settings, "run.seed=500")
        run.batch(results / "more", jobs, MORE, fresh, thin=thin, lock=args.lock)
    plot.make(args.out, grid)


def few(results: Path, grid, envs) -> list[tuple[int, int]]:
    """The cells with these numbers of robots, or any, and `SEEDS` seeds; those that differ most first."""
    rows = [row for row in plot.build(results, grid) if row.get("seeds") == SEEDS]
    rows.sort(key=lambda row: -row["max_reward_sd"])
    return [(r["envs"], r["horizon"]) for r in rows if not envs or r["envs"] in envs]


if __name__ == "__main__":
    main()

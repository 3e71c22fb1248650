"""Where a tail helps and where it does not: the paper's tails and ours by number of robots and by task; Go1.

    python experiments/17_regimes/run.py [--quick] [--out DIR]

Trains what no other folder has: runs of 3 seeds, and for cliff.py of 5; those whose JSON is in DIR/results
are skipped. The rest are read from 10_ablation, 12_platforms and 20_tail. Then tables and figures, as
plot.py and cliff.py.
"""

from pathlib import Path

import cliff
import plot

from experiments import paper, run

SEEDS = 3
SETTINGS = ("run.eval_envs=200", "run.checkpoint_every=0")


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    regimes = [plot.Regime("R = 32", 32)] if args.quick else plot.REGIMES
    seeds, settings = (2, paper.QUICK) if args.quick else (SEEDS, SETTINGS)
    results, names = args.out / "results", ("ppo16", "dyna4") if args.quick else plot.VARIANTS
    if not args.quick:
        run.batch(results, cliff.jobs(results), cliff.SEEDS, settings, lock=args.lock)
    cells = [(regime, name) for regime in regimes for name in names]
    jobs = [plot.job(*cell) for cell in cells if not plot.found(results, *cell)]
    run.batch(results, jobs, seeds, settings, lock=args.lock)
    plot.make(args.out, regimes)
    cliff.make(args.out, [regime.envs for regime in regimes if not regime.fields])


if __name__ == "__main__":
    main()

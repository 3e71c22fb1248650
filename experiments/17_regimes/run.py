"""Where a tail helps and where it does not: the paper's tails and ours by number of robots and by task; Go1.

    python experiments/17_regimes/run.py [--quick] [--out DIR]

Trains what no other folder has, with 25 true epochs and evaluated every 50 iterations: 5 seeds each, 10 where
four synthetic rows replace four real ones, and where seeds differ most as many again (results/more). Runs
whose JSON is there are skipped. Tables and figure follow, as table.py and cliff.py make them. 4096 robots are
in 12_platforms, `best` of c27cee7 is in earlier/ and 20_tail.
"""

from pathlib import Path

import cliff
import table

from experiments import paper, run

SEEDS, HEADLINE = 5, 10
SETTINGS = "run.log_every=50 run.eval_every=50 run.eval_envs=200 run.checkpoint_every=0".split()
BATCHES = {".": 700, "more": 600}  # first seed
AGAIN = ("R = 1024", "R = 2048", "R = 1024, less randomness")


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    results, regimes = args.out / "results", table.REGIMES
    if args.quick:
        regimes = [table.Regime("R = 32", 32)]
        jobs = [table.job(regimes[0], name) for name in ("ppo16", "dyna4")]
        run.batch(results, jobs, 2, paper.QUICK, lock=args.lock)
    else:
        for folder, seed in BATCHES.items():
            for cell in table.cells():
                if folder == "." or again(*cell):
                    train(results / folder, seed, *cell, lock=args.lock)
    table.make(args.out, regimes)
    cliff.make(args.out, [regime.envs for regime in regimes if not regime.fields])


def train(folder: Path, seed: int, regime, variant: str, rows: int | None, lock) -> None:
    """A batch of one cell."""
    headline = regime.label == "R = 1024" and (rows == 20 or variant == "ppo16")
    settings = [f"run.seed={seed}", *SETTINGS, *(paper.TAILS if variant in table.TAILS else ())]
    job = table.job(regime, variant, rows)
    run.batch(folder, [job], HEADLINE if headline else SEEDS, settings, lock=lock)


def again(regime, variant: str, rows: int | None) -> bool:
    """Whether seeds of a cell differ so much that it was trained twice."""
    tail, longest = variant in table.TAILS, variant == "ppo24" and regime.envs == 2048
    return regime.label in AGAIN and not (tail and rows == 24) and not longest


if __name__ == "__main__":
    main()

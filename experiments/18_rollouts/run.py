"""Figures 1 to 3: what a rollout with a tail is, from the schedule and from rollouts of the code itself.

    python experiments/18_rollouts/run.py [--quick] [--out DIR]

The bundled Go1 walks by its policy and that policy's noise, `best`'s model is fitted to eight real rows an
iteration; then six iterations are kept as they are, tails included, in
DIR/results (skipped where about.json is). Then figures, as plot.py.
"""

from pathlib import Path

import plot
import record

from experiments import paper


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    if not (args.out / "results" / "about.json").exists():
        robots, fits = (32, 2) if args.quick else (256, 40)
        record.measure(args.out / "results", robots, fits)
    plot.make(args.out)


if __name__ == "__main__":
    main()

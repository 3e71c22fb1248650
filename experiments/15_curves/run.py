"""Figures 7, 8 and 10: return, policy std and learning rate over training, of all variants.

    python experiments/15_curves/run.py [--quick] [--out DIR]

Trains nothing: reads the runs of 12_platforms (with --quick, those that its --quick made). Writes
results.csv, and ROBOT.png of every robot that has a run; Go1's always.
"""

from pathlib import Path

import plot

from experiments import paper


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    plot.make(args.out, Path("runs/quick") if args.quick else plot.HERE.parent)


if __name__ == "__main__":
    main()

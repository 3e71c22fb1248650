"""Table VI: how many simulator steps, iterations and seconds a return takes.

    python experiments/14_efficiency/run.py [--quick] [--out DIR]

Trains nothing: reads the runs of 12_platforms, and the best cell of 10_ablation (with --quick, those
that their --quick made). Writes results.csv and the figure.
"""

from pathlib import Path

import plot

from experiments import paper


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    plot.make(args.out, Path("runs/quick") if args.quick else plot.HERE.parent)


if __name__ == "__main__":
    main()

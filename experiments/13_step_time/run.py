"""Table IV: what a step of physics and of the tail, the model's fit and PPO's update take.

    python experiments/13_step_time/run.py [--quick] [--out DIR]

One seed on one device, as `python -m dynappo.bench --config=configs/go1.py:dyna4 --out FILE`; what is in
DIR/results is not measured again. Then table and figure, as plot.py.
"""

from pathlib import Path

import plot

from dynappo.bench import command as bench_command
from experiments import paper

REPEATS = 9  # medians of so many


def main():
    args = paper.options(Path(__file__).parent, __doc__)
    names, flags = plot.VARIANTS, [f"--repeats={REPEATS}"]
    if args.quick:
        names = ("ppo16", "dyna4")
        flags = ["--repeats=2", *(f"--config.{field}" for field in paper.QUICK)]
    for name in names:
        path = args.out / "results" / f"go1_{name}.json"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            argv = [f"--config=configs/go1.py:{name}", f"--out={path}", *flags]
            bench_command.run(*bench_command.parse(argv))
    plot.make(args.out)


if __name__ == "__main__":
    main()

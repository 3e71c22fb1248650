"""The times of Table I: how long 500 iterations take by number of robots R and rows N, one run at a time.

    python experiments/10_ablation/times.py              # on a GPU that nothing else uses
    python experiments/10_ablation/times.py --table      # the numbers of README.md, from times.csv

Of each cell the program of plot.py's job, `CHUNK` iterations after as many that are not counted, median of
`REPEATS`. A row of `--out` as soon as it is there; cells that it or times.csv has are not measured again.
"""

import time
from pathlib import Path

import jax
import numpy as np
import plot

from dynappo.config import versions
from dynappo.program import build, devices
from dynappo.run import log
from experiments import paper, run

HERE = Path(__file__).parent
CHUNK, REPEATS, ITERATIONS = 20, 3, 500
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0", f"run.log_every={CHUNK}")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--table", action="store_true", help="measure nothing")
    parser.add_argument("--out", type=Path, default=HERE / "times.csv")
    args = parser.parse_args()
    if not args.table:
        devices.own_process()
        measure(args.out, plot.GRID)
    print(table([row for path in known(args.out) for row in paper.rows(path)]))


def measure(out: Path, grid, settings=SETTINGS) -> None:
    """Add the rows that are missing."""
    there = {(row["envs"], row["horizon"]) for path in known(out) for row in paper.rows(path)}
    for envs, horizon in grid:
        if (envs, horizon) in there:
            continue
        program = build.program(run.configure(plot.job(envs, horizon), 1, settings))
        row = {"envs": envs, "horizon": horizon, "ms": f"{iteration(program):.4g}"}
        row |= {"device": program.device, "commit": versions.commit()}
        log.append_csv(out, [row])
        print(*row.values(), flush=True)


def known(out: Path) -> list[Path]:
    """Files of cells: what is kept, and `out`."""
    return list(dict.fromkeys((HERE / "times.csv", out)))


def iteration(program) -> float:
    """ms of an iteration."""
    columns = {name: column[:CHUNK] for name, column in program.columns.items()}
    state, took = program.state, []
    for _ in range(1 + REPEATS):
        began = time.perf_counter()
        state, _ = jax.block_until_ready(program.step(program.hyper, state, columns))
        took.append(1e3 * (time.perf_counter() - began) / CHUNK)
    return float(np.median(took[1:]))


def table(rows: list[dict]) -> str:
    """Seconds of 500 iterations beside the paper's minutes, and how the two go together over all cells."""
    own, minutes = (
        {(row["envs"], row["horizon"]): row[name] for row in some}
        for some, name in ((rows, "ms"), (paper.table("ablation"), "time_min"))
    )
    both = [cell for cell in own if cell in minutes]

    def cell(envs, n):
        seconds = ITERATIONS / 1e3 * own.get((envs, n), np.nan)
        return f"{seconds:.2f} / {minutes[envs, n]:.1f}" if (envs, n) in own else ""

    head = ["seconds here / minutes in the paper", *(f"N = {n}" for n in plot.HORIZONS)]
    lines = [[f"R = {envs}", *(cell(envs, n) for n in plot.HORIZONS)] for envs in plot.ENVS]
    text = paper.markdown(head, lines)
    if len(both) > 2:
        logs = np.log([[of[cell] for cell in both] for of in (own, minutes)])
        text += f"\ncorrelation of logarithms over {len(both)} cells: {np.corrcoef(logs)[0, 1]:.3f}"
    return text


if __name__ == "__main__":
    main()

"""The times of Table I: how long 500 iterations take by number of robots R and rows N, one run at a time.

    python experiments/10_ablation/times.py              # on a GPU that nothing else uses
    python experiments/10_ablation/times.py --table      # the numbers of README.md, from times.csv

Of each cell the program of plot.py's job, `CHUNK` iterations after as many that are not counted, median of
`REPEATS`. A row of times.csv as soon as it is there; those that are there are not measured again.
"""

import csv
import time
from pathlib import Path

import jax
import numpy as np
import plot

from dynappo.config import versions
from dynappo.program import build, devices
from experiments import paper, run

HERE = Path(__file__).parent
CHUNK, REPEATS, ITERATIONS = 20, 3, 500
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0", f"run.log_every={CHUNK}")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--out", type=Path, default=HERE / "times.csv")
    args = parser.parse_args()
    if not args.table:
        devices.own_process()
        measure(args.out, plot.GRID)
    table(read(args.out), paper_times())


def measure(out: Path, grid, settings=SETTINGS) -> None:
    """Add the rows that are missing."""
    rows = read(out) if out.exists() else []
    for envs, horizon in grid:
        if (envs, horizon) in {(int(row["envs"]), int(row["horizon"])) for row in rows}:
            continue
        program = build.program(run.configure(plot.job(envs, horizon), 1, settings))
        ms = iteration(program)
        about = {"device": program.device, "commit": versions.commit()}
        rows.append({"envs": envs, "horizon": horizon, "ms": f"{ms:.4g}"} | about)
        print(*rows[-1].values(), flush=True)
        with out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def iteration(program) -> float:
    """ms of an iteration."""
    columns = {name: column[:CHUNK] for name, column in program.columns.items()}
    state, took = program.state, []
    for _ in range(1 + REPEATS):
        began = time.perf_counter()
        state, _ = jax.block_until_ready(program.step(program.hyper, state, columns))
        took.append(1e3 * (time.perf_counter() - began) / CHUNK)
    return float(np.median(took[1:]))


def read(path: Path) -> list[dict]:
    with path.open(newline="") as file:
        return [*csv.DictReader(file)]


def paper_times() -> dict[tuple[int, int], float]:
    """Minutes of the paper's cells."""
    rows = read(HERE.parent / "paper/ablation.csv")
    return {(int(row["envs"]), int(row["horizon"])): float(row["time_min"]) for row in rows}


def table(rows: list[dict], minutes: dict[tuple[int, int], float]) -> None:
    """Seconds of 500 iterations beside the paper's minutes; how much both grow; the correlation of cells."""
    own = {
        (int(row["envs"]), int(row["horizon"])): float(row["ms"]) * ITERATIONS / 1e3 for row in rows
    }
    print(
        "| seconds here / minutes in the paper | "
        + " | ".join(f"N = {n}" for n in plot.HORIZONS)
        + " |"
    )
    print("|---" * (1 + len(plot.HORIZONS)) + "|")
    for envs in plot.ENVS:
        cells = [
            f"{own[envs, n]:.2f} / {minutes[envs, n]:.1f}" if (envs, n) in own else ""
            for n in plot.HORIZONS
        ]
        print(f"| R = {envs} | " + " | ".join(cells) + " |")
    both = [cell for cell in own if cell in minutes]
    if len(both) > 2:
        logs = np.log([[of[cell] for cell in both] for of in (own, minutes)])
        print(f"correlation of logarithms over {len(both)} cells: {np.corrcoef(logs)[0, 1]:.3f}")


if __name__ == "__main__":
    main()

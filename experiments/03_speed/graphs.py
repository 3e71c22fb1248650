"""What capturing CUDA graphs costs: ms an iteration of each seed of a process, by how a step is captured.

    python experiments/03_speed/graphs.py OUT.csv [--engines mujoco_warp kernel] [--modes WARP WARP_STAGED]
        [--seeds 5] [--iterations 60] [--set FIELD=VALUE]

physics/warp/call.py captures a control step for each set of addresses that JAX passes (`WARP`).
`WARP_STAGED` captures it once, for arrays of Warp's own, and copies in and out within the graph;
`WARP_STAGED_EX` copies outside of it; `JAX` leaves the capture to XLA. Each engine and mode has a process of
its own, in which one program trains seeds of go1:best one after the other, as a user's first run and later
ones would. OUT.csv has a row for each seed and ten iterations: ms an iteration, and how many graphs were
captured since the program began. What OUT.csv has is skipped. Nothing else may use the device.
"""

import csv
import importlib
import itertools
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jax

from experiments import paper

row_cost = importlib.import_module("experiments.30_row_cost.run")
COLUMNS = "engine mode device commit seed iteration ms captures".split()


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    engines, modes = ["mujoco_warp", "kernel"], ["WARP", "WARP_STAGED", "WARP_STAGED_EX", "JAX"]
    parser.add_argument("--engines", nargs="+", default=engines)
    parser.add_argument("--modes", nargs="+", default=modes)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--here", action="store_true", help="one engine and mode, in this process")
    args = parser.parse_args()
    for name, asked, there in (("engines", args.engines, engines), ("modes", args.modes, modes)):
        if other := [x for x in asked if x not in there]:
            raise SystemExit(f"--{name} has {other[0]!r}, expected some of {', '.join(there)}")
    fields = [f"run.num_iterations={args.iterations}", *args.set]
    if args.here:
        rows = train(args.engines[0], args.modes[0], fields, args.seeds)
        with args.out.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS).writerows(rows)
        return
    if not args.out.exists():
        with args.out.open("w", newline="") as file:
            csv.DictWriter(file, COLUMNS).writeheader()
    command = [sys.executable, __file__, args.out, "--here", "--seeds", str(args.seeds)]
    command += ["--iterations", str(args.iterations), *(f"--set={field}" for field in args.set)]
    failed = []
    for engine, mode in itertools.product(args.engines, args.modes):
        if not read(args.out, engine, mode):  # a process writes all of its rows at its end
            words = [*command, "--engines", engine, "--modes", mode]
            done = subprocess.run(words, capture_output=True, text=True)
            if done.returncode:
                failed.append(f"{engine} {mode}")
                print(engine, mode, (done.stderr.strip() or "no line").splitlines()[-1])
                continue
        print(engine, mode, told(read(args.out, engine, mode)), flush=True)
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


def train(engine: str, mode: str, fields: list[str], seeds: int) -> list[dict]:
    """Rows of `seeds` seeds, from 0 on."""
    import warp as wp  # pyright: ignore[reportMissingImports]

    from dynappo import algorithm
    from dynappo.config import versions
    from dynappo.physics.warp import scope
    from dynappo.program import build, devices

    captured, modes = [], wp.JaxCallableGraphMode

    class Counted(wp.ScopedCapture):
        def __enter__(self):
            captured.append(mode)
            return super().__enter__()

    def callable_(*given, graph_mode, _made=wp.jax_callable, **more):
        graph_mode = modes[mode] if graph_mode == modes.WARP else graph_mode  # none on a CPU
        return _made(*given, graph_mode=graph_mode, **more)

    wp.ScopedCapture, wp.jax_callable = Counted, callable_
    config = row_cost.read("go1:best", fields).config
    devices.own_process(config.run.device)
    if engine == "mujoco_warp":
        scope.kernel = lambda *_: ""
    program, rows = build.program(config), []
    init = jax.jit(partial(algorithm.init, program.env, static=program.static))
    about = {"engine": engine, "mode": mode, "device": program.device, "commit": versions.commit()}
    for seed in range(seeds):
        state = program.place(init(program.hyper, jax.random.key(seed)))
        first = 0
        for last in row_cost.ends(config):
            columns = {name: column[first:last] for name, column in program.columns.items()}
            jax.block_until_ready(state)
            began = time.perf_counter()
            state, _ = jax.block_until_ready(program.step(program.hyper, state, columns))
            ms = 1e3 * (time.perf_counter() - began) / (last - first)
            first = last
            row = {"seed": seed, "iteration": last, "ms": f"{ms:.3f}", "captures": len(captured)}
            rows.append(about | row)
    return rows


def read(path: Path, engine: str, mode: str) -> list[dict]:
    """The rows of one process."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [row for row in rows if (row["engine"], row["mode"]) == (engine, mode)]


def told(rows: list[dict]) -> str:
    """Mean ms of each seed, without its first ten iterations, which compile; and captures until then."""
    cells = []
    for seed in dict.fromkeys(row["seed"] for row in rows):
        mine = [row for row in rows if row["seed"] == seed]
        ms = [float(row["ms"]) for row in mine[1:]]
        cells.append(f"{sum(ms) / len(ms):.2f} ({mine[-1]['captures']})")
    return ", ".join(cells)


if __name__ == "__main__":
    main()

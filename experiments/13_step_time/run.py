"""Table IV and the time of Table V: what a step of physics and of the tail, the model's fit and PPO take.

    python experiments/13_step_time/run.py [--quick] [--out DIR]

Three runs a variant, each in a process of its own: `dynappo.bench` with one seed, then 500 iterations on the
clock by the same program. Each writes DIR/results/kernel/go1_VARIANT_RUN.json; what is there is not measured
again. Then tables and figure, as plot.py. Nothing else may use the device.
"""

import multiprocessing
import time
from concurrent import futures
from pathlib import Path

import plot

from dynappo.bench import command as bench_command
from dynappo.config import files
from dynappo.program import build, devices
from experiments import paper, run

RUNS, REPEATS = 3, 3  # processes; in each, medians of so many
SETTINGS = ("run.eval_envs=0", "run.checkpoint_every=0")


def main():
    args = paper.options(Path(__file__).parent, paper.parser(__doc__))
    names, settings = plot.VARIANTS, SETTINGS
    if args.quick:
        names, settings = ("ppo16", "dyna4"), paper.QUICK
    spawn = multiprocessing.get_context("spawn")
    with futures.ProcessPoolExecutor(1, spawn, max_tasks_per_child=1) as fresh:
        for k in range(1 if args.quick else RUNS):
            for name in names:
                path = args.out / "results" / "kernel" / f"go1_{name}_{k}.json"
                if not path.exists():
                    with run.alone(args.lock):
                        own = paper.TAILS if name == "dyna4" else ()
                        fresh.submit(measure, f"go1:{name}", (*settings, *own), path).result()
    plot.make(args.out)


def measure(job: str, settings, path: Path) -> None:
    """One run. The phases are those of the last iteration with a tail, where a schedule has one."""
    devices.own_process()
    config = run.configure(job, 1, settings)
    program = build.program(config)
    last = config.schedule.last_iteration or config.run.num_iterations
    columns = {name: column[:last] for name, column in program.columns.items()}
    report = bench_command.report(config, program._replace(columns=columns), REPEATS)
    began = time.perf_counter()
    for _ in run.chunks(config, program=program):
        pass
    report["training_seconds"] = time.perf_counter() - began
    report |= {"settings": list(settings), "last": {n: int(c[-1]) for n, c in columns.items()}}
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_json(path, {"configs": {job: report}, "versus": None})
    print(path, flush=True)


if __name__ == "__main__":
    main()

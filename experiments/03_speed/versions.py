"""Is this checkout slower than others? An iteration of each, in turns on one GPU.

    python experiments/03_speed/versions.py CHECKOUT[,CHECKOUT ...] go1:ppo16 go1:best --out FILE.json

Each checkout has a process of its own, which compiles its program and then runs one chunk of iterations
whenever it is asked, in turns. FILE.json gets the ms of every call and, for each other checkout, the ratio
this / other of neighbouring calls: median, least, most.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[2]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("other", help="other checkouts, with commas; for a process of one: serve")
    parser.add_argument("jobs", nargs="+", metavar="ROBOT:VARIANT")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument(
        "--iteration", type=int, default=100, help="the one of the schedule that is run"
    )
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.other == "serve":
        return serve(args.jobs[0], args.set, args.iteration)
    found = {}
    checkouts = [*map(Path, args.other.split(",")), HERE]
    for job in args.jobs:
        processes = [start(path.resolve(), job, args) for path in checkouts]
        for process in processes:
            print(job, ask(process), flush=True)  # it has compiled
        turns = [[float(ask(process)) for process in processes] for _ in range(args.repeats + 1)]
        for process in processes:
            process.stdin.close()
            process.wait()
        times = np.array(turns[1:])  # the first warms
        found[job] = {"checkouts": [path.name for path in checkouts], "ms": times.round(3).tolist()}
        *others, here = np.median(times, 0)
        for path, ms, column in zip(checkouts[:-1], others, times.T[:-1], strict=True):
            ratio = times[:, -1] / column
            found[job][path.name] = [float(x) for x in (np.median(ratio), ratio.min(), ratio.max())]
            print(
                f"{job}: {here:.2f} ms here, {ms:.2f} in {path.name}, ratio {np.median(ratio):.4f}"
            )
        if args.out:
            args.out.write_text(json.dumps(found, indent=1) + "\n")


def start(checkout: Path, job: str, args) -> subprocess.Popen:
    """A process of a checkout that serves `job`."""
    path = os.pathsep.join([str(checkout), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, __file__, "serve", job, f"--iteration={args.iteration}"]
    command += [f"--set={s}" for s in args.set]
    environment = os.environ | {"PYTHONPATH": path, "XLA_PYTHON_CLIENT_MEM_FRACTION": "0.1"}
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, env=environment, cwd=checkout, stdin=pipe, stdout=pipe, text=True
    )


def ask(process: subprocess.Popen) -> str:
    """One line in, one line out."""
    assert process.stdin and process.stdout
    process.stdin.write("go\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


def serve(job: str, settings, iteration: int) -> None:
    """Compile `job`, answer the first line with the checkout, every other with ms of an iteration."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Warp prints what it compiles
    import dynappo
    from dynappo import config as config_lib

    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    for setting in settings:
        field, _, value = setting.partition("=")
        config_lib.override(config, field, value)
    config = config_lib.validate(config)
    try:
        from dynappo.program.build import program
    except ImportError:  # a checkout from before the folders
        from dynappo.train import setup as program  # pyright: ignore
    run = chunk(program(config), config.run.log_every, iteration)
    for i, _ in enumerate(sys.stdin):
        print(Path(dynappo.__file__).parent if i == 0 else run(), file=answers, flush=True)


def chunk(program, every: int, iteration: int):
    """A function that runs iteration `iteration` `every` times from the first state: ms of one."""
    import jax
    import jax.numpy as jnp

    columns = {
        name: np.full(every, column[min(iteration, len(column)) - 1], np.int32)
        for name, column in program.columns.items()
    }

    def run():
        copy = jax.block_until_ready(jax.tree.map(jnp.copy, program.state))
        began = time.perf_counter()
        jax.block_until_ready(program.step(program.hyper, copy, columns))
        return (time.perf_counter() - began) / every * 1e3

    return run


if __name__ == "__main__":
    main()

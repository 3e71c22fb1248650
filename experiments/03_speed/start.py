"""Seconds from the command to the first iteration, with less and less left to build.

    python experiments/03_speed/start.py OUT.json [--config configs/go1.py:ppo16] [--cases warm ...]

`cold`: neither JAX's compiled programs nor Warp's kernels are there. `primed`: Warp's kernels are (it
builds them once for a version of MuJoCo MJX). `warm`: both are, as from the second run on. Each case is
a `python -m dynappo.train` of its own; the clock stops when its first row of metrics.csv is there.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from dynappo.config import files
from experiments import paper

FIELDS = dict(
    num_iterations=2,
    log_every=1,
    checkpoint_every=0,
    eval_envs=0,
    video_seconds=0.0,
    tensorboard=False,
)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="configs/go1.py")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--cases", nargs="+", default=["cold", "primed", "warm", "warm"])
    args = parser.parse_args()
    seconds, programs = [], None
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(args.cases):
            if case != "warm":  # the warm ones have what the last of these has built
                programs = Path(folder, f"programs{number}")
            environment = dict(os.environ)
            if programs:
                environment["JAX_COMPILATION_CACHE_DIR"] = str(programs)
            if "cold" in args.cases:  # else the machine's own kernels
                environment["WARP_CACHE_PATH"] = str(Path(folder, "warp"))
            took = first_row(args, Path(folder, f"run{number}"), environment)
            seconds.append({"case": case, "seconds": took})
            print(f"{case:8s} {took:6.1f} s", flush=True)
            files.write_json(args.out, {"config": args.config, "set": args.set, "start": seconds})


def first_row(args, workdir: Path, environment) -> float:
    fields = [f"--config.run.{name}={value}" for name, value in FIELDS.items()]
    fields += [f"--config.{text}" for text in args.set]
    command = [sys.executable, "-m", "dynappo.train", f"--config={args.config}", *fields]
    began = time.perf_counter()
    with (workdir.parent / "log").open("w") as file:
        run = subprocess.Popen(
            [*command, f"--workdir={workdir}"], env=environment, stdout=file, stderr=file
        )
        metrics = workdir / "metrics.csv"
        while not (metrics.exists() and metrics.read_text().count("\n") >= 2):
            if run.poll() is not None and not metrics.exists():
                sys.exit((workdir.parent / "log").read_text())
            time.sleep(0.02)
        took = time.perf_counter() - began
        run.wait()
    return took


if __name__ == "__main__":
    main()

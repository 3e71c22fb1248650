"""Does the estimate of memory hold? What dynappo.memory says, against what the device has used.

    python experiments/02_scaling/memory.py OUT.json [SEEDSxROBOTS ...] \\
        [--config configs/go1.py:ppo16] [--set FIELD=VALUE ...]

Each job sets up one program and runs one chunk, in a process of its own: what a device has used at
most never falls again. On a GPU that is JAX's own figure, and beside it what all have taken of the
device, Warp's scratch and the driver included; on a CPU the arguments and temporaries of the program.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

JOBS = ["1x4096", "4x4096", "1x16384", "8x4096"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="*", default=JOBS)
    parser.add_argument("--config", default="configs/go1.py:ppo16")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--one", action="store_true", help="this process measures (not for people)")
    args = parser.parse_args()
    if args.one:
        return measure(args)
    environment = os.environ | {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    fields = [f"--set={text}" for text in args.set]
    for job in args.jobs:
        command = [sys.executable, __file__, str(args.out), job, f"--config={args.config}", *fields]
        subprocess.run([*command, "--one"], env=environment, check=True)


def measure(args):
    """One job; appends its row to OUT.json."""
    import jax

    from dynappo import config as config_lib
    from dynappo import train
    from dynappo.program import memory

    seeds, robots = (int(n) for n in re.fullmatch(r"(\d+)x(\d+)", args.jobs[0]).groups())
    config = config_lib.load(args.config)
    config.run.update(num_seeds=seeds, eval_envs=0, log_every=2)
    config.rollout.num_envs = robots
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    config = config_lib.validate(config)
    program = train.setup(config)
    columns = {n: column[: config.run.log_every] for n, column in program.columns.items()}
    jax.block_until_ready(program.step(program.hyper, program.state, columns))

    needs = memory.estimate(config, program.impl)
    compiled = program.step.memory_analysis()
    used = compiled.argument_size_in_bytes + compiled.temp_size_in_bytes
    stats = jax.local_devices()[0].memory_stats() or {}
    row = {
        "job": args.jobs[0],
        "config": args.config,
        "set": args.set,
        "impl": program.impl,
        "estimate": memory.total(config, program.impl),
        "parts": memory.phases(config, program.impl) | needs._asdict(),
        "peak": stats.get("peak_bytes_in_use", used),
        "program": used,
        "limit": memory.limit(),
        "taken": taken(program.impl),
        "device": f"{program.device}, jax {jax.__version__}",
    }
    rows = json.loads(args.out.read_text()) if args.out.exists() else []
    files.write_json(args.out, [*rows, row])
    gib = {
        name: row[name] / 2**30 for name in ("estimate", "peak", "program", "taken") if row[name]
    }
    told = "  ".join(f"{name} {value:.2f}" for name, value in gib.items())
    print(f"{row['job']:10s} GiB: {told}  peak / estimate {row['peak'] / row['estimate']:.2f}")


def taken(impl: str) -> int | None:
    """Bytes of the GPU that are not free, whoever has them."""
    if impl != "warp":
        return None
    import warp

    device = warp.get_cuda_device()
    return device.total_memory - device.free_memory


if __name__ == "__main__":
    main()

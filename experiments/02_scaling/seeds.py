"""What more seeds, more robots and more devices cost: ms of an iteration of the compiled program.

    python experiments/02_scaling/seeds.py OUT.json SEEDSxROBOTS[@MESH_SEED,MESH_ENV] ... \\
        [--config configs/go1.py:ppo16] [--repeats 5]

Each job sets up one program, runs a few chunks so that robots are at all stages of falling, and then
times chunks of the last iterations: whole, and without physics (zero real rows). Robots is of one
seed. The jobs of one call share a machine, so their ratios are of one run.
"""

import json
import re
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.program import build, devices
from experiments import paper

WARM = 3  # chunks


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="+")
    parser.add_argument("--config", default="configs/go1.py:ppo16")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    args = parser.parse_args()
    devices.own_process()
    results = json.loads(args.out.read_text()) if args.out.exists() else []
    for job in args.jobs:
        seeds, robots, mesh_seed, mesh_env = (
            int(n or 1) for n in re.fullmatch(r"(\d+)x(\d+)(?:@(\d+),(\d+))?", job).groups()
        )
        config = config_lib.load(args.config)
        config.run.update(
            num_seeds=seeds, mesh_seed=mesh_seed, mesh_env=mesh_env, eval_envs=0, log_every=5
        )
        config.rollout.num_envs = robots
        for text in args.set:
            config_lib.override(config, *text.split("=", 1))
        config = config_lib.validate(config)
        program = build.program(config)
        ms = times(config, program, args.repeats)
        real = int(program.columns["n_real"][-1])
        row = {"job": job, "config": args.config, "set": args.set} | ms
        row["control_steps_per_second"] = seeds * robots * real / ms["iteration"] * 1e3
        row["setup_seconds"] = program.compile_seconds
        stats = jax.devices()[0].memory_stats() or {}
        row |= {"peak_bytes": stats.get("peak_bytes_in_use"), "bytes_needed": program.bytes_needed}
        row["device"] = f"{jax.device_count()} x {program.device}, jax {jax.__version__}"
        results.append(row)
        files.write_json(args.out, results)
        print(
            f"{job:16s} {args.config:24s} iteration {ms['iteration']:8.2f} ms (spread "
            f"{ms['spread']:.2f})  physics {ms['physics']:7.3f} ms a row  "
            f"{row['control_steps_per_second'] / 1e6:6.2f} M control steps/s",
            flush=True,
        )


def times(config, program, repeats):
    """Medians: `iteration` as the schedule ends; `physics`, of one row with the task and the policy."""
    every, horizon = config.run.log_every, config.rollout.horizon
    last = {name: int(column[-1]) for name, column in program.columns.items()}
    state = program.state

    def chunk(state, **changed):
        columns = {n: np.full(every, v, np.int32) for n, v in (last | changed).items()}
        columns["iteration"] = np.arange(1, every + 1, dtype=np.int32)
        began = time.perf_counter()
        state, _ = jax.block_until_ready(program.step(program.hyper, state, columns))
        return state, (time.perf_counter() - began) / every * 1e3

    for _ in range(WARM):
        state, _ = chunk(state)
    kept = {"iteration": [], "real": [], "none": []}
    for _ in range(repeats):
        state, ms = chunk(state)
        kept["iteration"].append(ms)
        for name, rows in (("real", horizon), ("none", 0)):
            copy = jax.tree.map(jnp.copy, state)
            epochs = {"model_epochs": 0} if "model_epochs" in last else {}
            kept[name].append(chunk(copy, n_real=rows, **epochs)[1])
    iteration = np.array(kept["iteration"])
    physics = (np.median(kept["real"]) - np.median(kept["none"])) / horizon
    return {
        "iteration": float(np.median(iteration)),
        "spread": float(np.ptp(iteration)),
        "physics": float(physics),
        "rest": float(np.median(kept["none"])),
    }


if __name__ == "__main__":
    main()

"""Evaluations of one run on a CPU, over the seconds that it trained: what `:laptop` was chosen by.

    taskset -c 0,1 python experiments/04_laptop/walk.py OUT.json go1:laptop [FIELD=VALUE ...]

trains `run.num_iterations` iterations, or `--seconds` of training at most, and evaluates every
`run.eval_every` of them (0: only at the end). The clock stops while it evaluates and compiles.
"""

import os
import time
from pathlib import Path

import jax

from dynappo.config import files
from dynappo.program import devices
from experiments import paper, run


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("job", metavar="ROBOT:VARIANT")
    parser.add_argument("fields", nargs="*", metavar="FIELD=VALUE")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of training")
    args = parser.parse_args()
    devices.own_process("cpu")
    found = walk(args.job, args.fields, args.seconds)
    files.write_json(args.out, found)
    print(line(found), flush=True)


def walk(job: str, fields, seconds: float) -> dict:
    config = run.configure(job, 1, fields)
    every = config.run.eval_every or config.run.num_iterations
    rows, spent, began = [], 0.0, None
    for program, done, state, metrics in run.chunks(config):
        jax.block_until_ready(state)
        if began is not None:  # the first chunk is also compiled
            spent += time.perf_counter() - began
        last = done >= config.run.num_iterations or spent >= seconds
        if last or done % every == 0:
            found = {k: float(v) for k, v in program.evaluate(state).items()}
            steps = int(program.columns["n_real"][:done].sum()) * config.rollout.num_envs
            ring = float(metrics["episode_return"][-1])
            rows.append(
                {"iteration": done, "seconds": spent, "steps": steps, "ring": ring, **found}
            )
        if last:
            break
        began = time.perf_counter()
    cores = len(os.sched_getaffinity(0))
    return {"job": job, "fields": list(fields), "cores": cores, "rows": rows}


def line(found: dict) -> str:
    last = found["rows"][-1]
    return (
        f"{found['job']} {' '.join(found['fields']):60s} {last['iteration']:4d} it {last['seconds']:6.1f} s "
        f"{last['steps'] / 1e6:5.2f} M  return {last['return']:5.1f}  "
        f"falls {100 * last['fall_rate']:5.1f} %  "
        f"{last['tracking_error']:.3f} m/s  {last['yaw_error']:.3f} rad/s"
    )


if __name__ == "__main__":
    main()

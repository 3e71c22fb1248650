"""Evaluations of runs on the way: what a policy is worth after how many simulator steps.

    python experiments/21_less/run.py OUT_FOLDER JOBS.txt [--workers 4] [--policies]

A line of JOBS.txt is `NAME ROBOT:VARIANT [FIELD=VALUE ...]` and becomes OUT_FOLDER/NAME.csv, a row an
evaluation and seed. Five seeds at once from 100 on, 100 episodes of 20 s each every 20 iterations, unless
the line says otherwise (run.seed, run.num_seeds, run.eval_every ...). Jobs whose CSV is there are skipped.
`--policies` writes OUT_FOLDER/NAME.K.npz, the policy of seed K (0, 1, ...), too. `--workers`: so many
processes share the GPU, because compiling takes longer than training; their clocks say nothing then.
`table.py` reads the folder.
"""

import csv
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np

from dynappo import config as config_lib
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.program import devices
from experiments import paper

DEFAULTS = dict(seed=100, num_seeds=5, log_every=20, eval_every=20, eval_envs=100, eval_steps=1000)
NAMES = {"return": "eval_return", "fall_rate": "eval_fall_rate"}
NAMES |= {"tracking_error": "eval_tracking_error", "yaw_error": "eval_yaw_error"}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--policies", action="store_true", help="write each seed's policy")
    parser.add_argument("--only", help="run this job of the file in this process")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = dict(
        line.split(maxsplit=1) for line in args.jobs.read_text().splitlines() if line.strip()
    )
    if args.only:
        devices.own_process()
        to = args.out / args.only if args.policies else None
        write(args.out / f"{args.only}.csv", run(*jobs[args.only].split(), policies=to))
        return

    def start(name):
        command = [sys.executable, __file__, args.out, args.jobs, "--only", name]
        command += ["--policies"] * args.policies
        room = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"} if args.workers > 1 else {}
        done = subprocess.run(command, env=os.environ | room, capture_output=True, text=True)
        said = (done.stderr.strip() or str(done.returncode)).splitlines()[-1]
        print(name, "done" if done.returncode == 0 else said, flush=True)

    with ThreadPoolExecutor(args.workers) as pool:
        list(pool.map(start, [name for name in jobs if not (args.out / f"{name}.csv").exists()]))


def run(job: str, *fields: str, policies: Path | None = None) -> list[dict]:
    """Train, and return a row an evaluation and seed; write the seeds' policies as POLICIES.K.npz."""
    from dynappo import train

    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    config.run.update(checkpoint_every=0, **DEFAULTS)
    for field in fields:
        config_lib.override(config, *field.split("=", 1))
    state, metrics = train.train(config)
    if policies:
        config, params = config_lib.validate(config), jax.device_get(state.learner.params)
        body = robot_lib.load(config.robot)
        for k in range(config.run.num_seeds):
            one = jax.tree.map(lambda x, k=k: x[k] if config.run.num_seeds > 1 else x, params)
            policy_file.save(policies.with_name(f"{policies.name}.{k}.npz"), one, config, body, k)
    many = {name: np.reshape(m, (len(m), -1)) for name, m in metrics.items()}
    rows = []
    for i in np.flatnonzero(np.isfinite(many["eval_return"]).all(1)):
        for s in range(many["eval_return"].shape[1]):
            about = {"job": " ".join([job, *fields]), "seed": config.run.seed + s}
            when = {name: int(many[name][i, 0]) for name in ("iteration", "sim_steps")}
            found = {name: f"{many[column][i, s]:.4g}" for name, column in NAMES.items()}
            rows.append(about | when | {"seconds": f"{many['seconds'][i, 0]:.4g}"} | found)
    return rows


def write(path: Path, rows: list[dict]) -> None:
    """A CSV, whole or not at all."""
    part = path.with_suffix(".part")
    with part.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    part.replace(path)


if __name__ == "__main__":
    main()

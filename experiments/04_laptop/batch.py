"""Many runs of walk.py side by side, each on cores of its own.

    python experiments/04_laptop/batch.py OUT_FOLDER JOBS.txt --cores 2 [--seconds 200]

A line of JOBS.txt is `NAME ROBOT:VARIANT [FIELD=VALUE ...]` and becomes OUT_FOLDER/NAME.json.
"""

import os
import queue
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from experiments import paper


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("--cores", type=int, default=2, help="of each run")
    parser.add_argument("--seconds", default="1e9", help="of training at most")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    mine = sorted(os.sched_getaffinity(0))
    free: queue.SimpleQueue = queue.SimpleQueue()
    for first in range(0, len(mine) - args.cores + 1, args.cores):
        free.put(set(mine[first : first + args.cores]))
    jobs = [text.split() for text in args.jobs.read_text().splitlines() if text.strip()]

    def run(job):
        name, *rest = job
        cores = free.get()
        command = [sys.executable, str(Path(__file__).with_name("walk.py"))]
        command += [str(args.out / f"{name}.json"), *rest, "--seconds", args.seconds]
        pin = lambda: os.sched_setaffinity(0, cores)  # noqa: E731
        done = subprocess.run(command, preexec_fn=pin, capture_output=True, text=True)
        free.put(cores)
        said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
        print(f"{name:24s} {said[-1] if said else done.returncode}", flush=True)

    with ThreadPoolExecutor(free.qsize()) as pool:
        list(pool.map(run, jobs))


if __name__ == "__main__":
    main()

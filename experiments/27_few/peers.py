"""Other methods with 64 robots, many runs at once: settings for few robots, on tuning or fresh seeds.

    python experiments/27_few/peers.py OUT_FOLDER experiments/27_few/peers_tune.txt [NAME ...] [--workers 8]
        [--seeds 0 1] [--best FOLDER]

A line is `NAME SCRIPT ARGUMENTS`, SCRIPT one of 24_off_policy, and becomes OUT_FOLDER/NAME-SEED.csv for each
seed. crossq.py trains many seeds at once, which must follow each other: OUT_FOLDER/NAME-FIRST-LAST.csv.
A file that is there is skipped. A run that was cut off begins again, and the farther of its tries is kept as
.csv.part. `--workers`: so many share the device, so their clocks say nothing. A .log beside a .csv has what
the run said. `--best FOLDER`: the best of each method, by the rule of peers_table.py, of peers_tune.csv and
what this script wrote into FOLDER; a NAME is a method then, crossq or sac. So ran the fresh seeds, 100 to
102, of peers_fresh.csv.
"""

import importlib
import os
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from experiments import paper

table = importlib.import_module("experiments.27_few.peers_table")

TOGETHER = ("crossq",)  # scripts that run all seeds in one program
SCRIPTS = Path(__file__).parent.parent / "24_off_policy"
# what all have: the task of `few`, and 64 robots to nearly five times the steps of `few`
COMMON = "--config go1:few --robots 64 --steps 204800 --evaluations 32"


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("names", nargs="*", help="the job of that name, else those that begin so")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--best", type=Path, metavar="FOLDER", help="choose, with its runs")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = paper.jobs(args.jobs)
    names = args.names
    if args.best:
        names = table.of_each_method(args.best, args.jobs, names)
    chosen = paper.chosen(jobs, names)
    with ThreadPoolExecutor(args.workers) as pool:
        runs = [
            (args.out / f"{name}-{seeds_of(seed, count)}.csv", jobs[name], seed, count)
            for name in chosen
            for seed, count in groups(jobs[name], args.seeds)
        ]
        codes = list(pool.map(lambda run: start(*run, args.workers), runs))
    if failed := [run[0].stem for run, code in zip(runs, codes, strict=True) if code]:
        raise SystemExit(f"failed: {', '.join(failed)}")


def seeds_of(first: int, count: int) -> str:
    return f"{first}-{first + count - 1}" if count > 1 else f"{first}"


def groups(job: str, seeds: list[int]) -> list[tuple[int, int]]:
    """`(first seed, how many)` of each run."""
    if job.split()[0] not in TOGETHER:
        return [(seed, 1) for seed in seeds]
    if seeds != list(range(seeds[0], seeds[0] + len(seeds))):
        raise SystemExit(
            f"--seeds is {seeds}, expected seeds that follow each other, as 100 101 102"
        )
    return [(seeds[0], len(seeds))]


def start(to: Path, job: str, seed: int, count: int, workers: int) -> int:
    """Run it, if it has not run; its exit status. A run that is stopped leaves NAME.csv.new, and
    NAME.csv.part is the farthest of those before."""
    if to.exists():
        return 0
    part, new = (to.with_name(f"{to.name}.{end}") for end in ("part", "new"))
    keep_farther(new, part)  # of a call that was cut; the scripts append
    done = subprocess.run(
        command(new, job, seed, count), env=room(workers), capture_output=True, text=True
    )
    to.with_suffix(".log").write_text(done.stdout + done.stderr)
    if done.returncode == 0:
        new.replace(to)
        part.unlink(missing_ok=True)
    else:
        keep_farther(new, part)
    print(to.stem, "done" if done.returncode == 0 else done.stderr.strip()[-200:], flush=True)
    return done.returncode


def keep_farther(new: Path, part: Path) -> None:
    """Make `new`, if it is there, the part if it got farther, else remove it."""
    if not new.exists():
        return
    if not part.exists() or table.far(table.of_run(new)) > table.far(table.of_run(part)):
        new.replace(part)
    else:
        new.unlink()


def command(out: Path, job: str, seed: int, count: int) -> list[str]:
    script, *given = shlex.split(job)
    return [
        sys.executable,
        str(SCRIPTS / f"{script}.py"),
        str(out),
        *COMMON.split(),
        *given,
        *("--seed", str(seed)),
        *(("--num-seeds", str(count)) if script in TOGETHER else ()),
    ]


def room(workers: int) -> dict[str, str]:
    """JAX takes most of a card at once, unless it is told not to."""
    return os.environ | ({"XLA_PYTHON_CLIENT_PREALLOCATE": "false"} if workers > 1 else {})


if __name__ == "__main__":
    main()

"""Evaluations of runs on the way: what a policy is worth after how many simulator steps.

    python experiments/21_less/run.py OUT_FOLDER JOBS.txt [NAME ...] [--workers 4] [--policies]
        [--late 200 50] [--states FOLDER]

A line of JOBS.txt is `NAME ROBOT:VARIANT [FIELD=VALUE ...]`, or `NAME playground:TASK:VARIANT ...`, and
becomes OUT_FOLDER/NAME.csv, a row an evaluation and seed: return and falls, errors where the task tells them,
and means of training since the evaluation before (`TRAINED`; `terrain_row` is the mean row of the robots on
rough ground). Five seeds at once from 100 on, 100 episodes of 20 s each every 20 iterations, unless the line
says otherwise (run.seed, run.num_seeds, run.eval_every ...). `control=NAME` among the fields is one of
controls.py. With NAMEs, those jobs in their order, or all that begin so. Jobs whose CSV is there are skipped.
A seed whose numbers are no longer finite trains on beside the others; OUT_FOLDER/NAME.log says since when.
OUT_FOLDER/NAME.error says why a job failed; the others run, and then the command fails, too.
While a job runs, its rows so far are in OUT_FOLDER/NAME.csv.part, so one that is stopped loses only what
came after its last evaluation. With `--states` its state is kept there, too, every minute until it is done,
and the same command at the same commit goes on from it; compiling once more is in its `seconds`. `--policies`
writes OUT_FOLDER/NAME.K.npz, the policy of seed K (0, 1, ...) at the last evaluation, too. `--workers`: so
many processes share the GPU, because compiling takes longer than training; their clocks say nothing then.
`--late 200 50`: after iteration 200 evaluate every 50 iterations only.
`table.py` reads the folder.
"""

import csv
import importlib
import math
import os
import pickle
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import versions
from dynappo.description import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.program import build, devices, distributed
from dynappo.run import nonfinite, overflow
from dynappo.terrain import tiles
from experiments import paper

controls = importlib.import_module("experiments.21_less.controls")

DEFAULTS = dict(seed=100, num_seeds=5, eval_every=20, eval_envs=100, eval_steps=1000)
KEEP = 60.0  # s between two states of a job that are kept: one of 20 seeds is a gigabyte
MEASURED = "return", "fall_rate", "tracking_error", "yaw_error"  # those that an evaluation has
MEASURED = *MEASURED, "crossed", "fell", *tiles.KINDS, "map"  # and of 28_rough/run.py
# the same, of training
TRAINED = (
    "terrain_row falls tail_falls tail_bias model_error_1 model_error_4 model_loss_before policy_std "
    "learning_rate kl"
).split()


def main(about=__doc__, script=__file__, evaluation=None):
    """The command; 28_rough/run.py has it, too, with an `evaluation` of its own."""
    parser = paper.parser(about)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("names", nargs="*", help="only jobs whose names begin so")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--policies", action="store_true", help="write each seed's policy")
    parser.add_argument("--late", type=int, nargs=2, metavar=("AFTER", "EVERY"))
    parser.add_argument("--states", type=Path, help="a folder, for runs that are stopped")
    parser.add_argument("--only", help="run this job of the file in this process")
    args = parser.parse_args()
    jobs = paper.jobs(args.jobs)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.only:
        devices.own_process()
        job, *fields = jobs[args.only].split()
        # two folders may have files of one name
        file = args.jobs.resolve()
        states = args.states and args.states / file.parent.name / file.stem / args.only
        run(args.out / args.only, job, fields, args.policies, args.late, evaluation, states)
        return

    def start(name):
        command = [sys.executable, script, args.out, args.jobs, "--only", name]
        command += ["--policies"] * args.policies
        command += ["--late", *map(str, args.late)] if args.late else []
        command += ["--states", args.states] if args.states else []
        room = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"} if args.workers > 1 else {}
        done = subprocess.run(command, env=os.environ | room, capture_output=True, text=True)
        said = (done.stderr.strip() or str(done.returncode)).splitlines()[-1]
        error = args.out / f"{name}.error"
        error.unlink(missing_ok=True)  # of a try before
        if done.returncode:
            error.write_text(done.stderr)
        print(name, "done" if done.returncode == 0 else said, flush=True)
        return done.returncode

    asked = paper.chosen(jobs, args.names)
    left = [name for name in asked if not (args.out / f"{name}.csv").exists()]
    with ThreadPoolExecutor(args.workers) as pool:
        codes = list(pool.map(start, left))
    if failed := [name for name, code in zip(left, codes, strict=True) if code]:
        raise SystemExit(f"failed: {', '.join(failed)}")


def run(
    to: Path,
    job: str,
    fields: list[str],
    policies: bool = False,
    late=None,
    evaluation=None,
    states: Path | None = None,
) -> None:
    """Train, and write TO.csv, a row an evaluation and seed, and with `policies` those of the seeds as
    TO.K.npz. After each evaluation TO.csv.part has the rows so far. `states` has what a run that is stopped
    goes on from: of the first evaluation, and of the first one `KEEP` s after the last that was kept.

    `evaluation(config) -> f(state) -> columns [S]` by name, in place of the program's own.
    """
    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    config.run.update(**DEFAULTS)
    for field in fields:
        name, value = field.split("=", 1)
        if name == "control":
            controls.put_in(value)
        else:
            config_lib.override(config, name, value)
    # an evaluation ends a chunk
    ends = config.run.num_iterations, config.run.eval_every or config.run.num_iterations
    config.run.log_every = math.gcd(*ends, *(late or ()))
    config = config_lib.validate(config)
    build.check(config)
    part = to.with_name(f"{to.name}.csv.part")
    program, seeds = build.program(config), config.run.num_seeds
    evaluate = evaluation(config) if evaluation else program.evaluate
    state, steps, seconds, first, rows = program.state, schedule.sim_steps(config), 0.0, 0, []
    since: dict[int, str] = {}
    about = " ".join([job, *fields]), late, versions.commit()
    kept_at = -math.inf
    if states and states.exists():
        state, seconds, first, rows, since = kept(states, state, about)
        write(part, rows)
    for last in evaluations(config, late):
        if last <= first:  # before it was stopped
            continue
        chunk = {name: column[first:last] for name, column in program.columns.items()}
        began = time.perf_counter()
        state, trained = jax.block_until_ready(program.step(program.hyper, state, chunk))
        seconds, first = seconds + time.perf_counter() - began, last
        overflow.check(trained | chunk)
        since = blown_up(trained | chunk, seeds, config.run.seed) | since
        if since:
            to.with_name(f"{to.name}.log").write_text("".join(since.values()))
        found = measured(evaluate(state), trained)
        for s in range(seeds):
            whose = {"job": about[0], "device": program.device, "commit": about[-1]}
            whose |= {"seed": config.run.seed + s}
            when = {
                "iteration": last,
                "sim_steps": int(steps[last - 1]),
                "seconds": f"{seconds:.4g}",
            }
            rows.append(whose | when | {name: text(x[s]) for name, x in found.items()})
        write(part, rows)
        if policies:
            save_policies(to, state, config, last, int(steps[last - 1]))
        if states and time.monotonic() - kept_at >= KEEP:
            keep(states, state, about, seconds, first, rows, since)
            kept_at = time.monotonic()
    part.replace(to.with_name(f"{to.name}.csv"))
    if states:
        states.unlink(missing_ok=True)


def keep(path: Path, state, about, *rest) -> None:
    """Write the arrays of a state, `about` which job, and what belongs to it, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    raw, _ = distributed.raw_keys(state)
    whole = path.with_name(f"{path.name}.new")
    whole.write_bytes(pickle.dumps((about, jax.device_get(jax.tree.leaves(raw)), *rest)))
    whole.replace(path)


def kept(path: Path, like, about) -> tuple:
    """`(state, *rest)` of `keep`; `like` is a state of the same program. SystemExit if it is another's."""
    raw, wrap = distributed.raw_keys(like)
    found, leaves, *rest = pickle.loads(path.read_bytes())
    if found != about:
        raise SystemExit(
            f"{path} is of {found}, expected {about}; remove it, or choose other --states"
        )
    leaves = [
        jax.device_put(x, old.sharding) for x, old in zip(leaves, jax.tree.leaves(raw), strict=True)
    ]
    return wrap(jax.tree.unflatten(jax.tree.structure(raw), leaves)), *rest


def measured(evaluation: dict, trained: dict) -> dict[str, np.ndarray]:
    """Numbers of each seed: of the evaluation, and means over the iterations since the one before."""
    found = {name: np.ravel(evaluation[name]) for name in MEASURED if name in evaluation}
    means = {name: np.mean(trained[name], 0) for name in TRAINED if name in trained}
    return found | {name: np.ravel(x) for name, x in means.items()}


def text(x) -> str:
    """A cell of the CSV; shares row by row are words already."""
    return x if isinstance(x, str) else f"{x:.4g}"


def blown_up(trained: dict, seeds: int, begin: int) -> dict[int, str]:
    """A line for each of the seeds from `begin` on with a number that is not finite: the first one, and its
    iteration."""
    trained = {name: np.asarray(x) for name, x in trained.items()}
    lines = {}
    for s in range(seeds):
        own = {name: x[:, s] if x.ndim > 1 else x for name, x in trained.items()}
        if found := nonfinite.first_metric(own, own.get("model_epochs")):
            lines[s] = "seed {}: {} is not finite in iteration {}\n".format(begin + s, *found)
    return lines


def save_policies(to: Path, state, config, iteration: int, sim_steps: int) -> None:
    """Write the policy of each seed as TO.K.npz."""
    far = iteration, sim_steps
    robot = robot_lib.load(config.robot) if config.robot else None
    for k, one in enumerate(each_seeds(jax.device_get(state.learner.params), config)):
        policy_file.save(to.with_name(f"{to.name}.{k}.npz"), one, config, robot, k, *far)


def each_seeds(params, config) -> list:
    """Those of each seed."""
    if config.run.num_seeds == 1:
        return [params]
    return [jax.tree.map(lambda x, k=k: x[k], params) for k in range(config.run.num_seeds)]


def evaluations(config, late=None) -> list[int]:
    """Iterations after which to evaluate: every `run.eval_every`, with `late` = (after, every) fewer
    later, and the last."""
    run, (after, every) = config.run, late or (config.run.num_iterations, 1)
    early = range(run.eval_every, min(after, run.num_iterations) + 1, run.eval_every)
    return sorted(
        {*early, *range(after + every, run.num_iterations + 1, every), run.num_iterations}
    )


def write(path: Path, rows: list[dict]) -> None:
    """A CSV, whole or not at all."""
    whole = path.with_name(f"{path.name}.new")
    with whole.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    whole.replace(path)


if __name__ == "__main__":
    main()

"""Seconds of training, one run at a time: nothing else may use the device, or the cores.

    python experiments/30_row_cost/run.py OUT_FOLDER JOBS.txt [PLACE ...] [--ahead 3]

A line of JOBS.txt is `NAME ROBOT:VARIANT [FIELD=VALUE ...]` and becomes OUT_FOLDER/NAME.csv, a row an
evaluation and seed; with PLACEs, those jobs in their order, or all that begin so. Five fields are not of the
config: `seeds=5` trains so many from run.seed on, one after another, by one compiled program; `warmup=2`
trains and evaluates the two seeds before run.seed first, in each process, and writes nothing of them, because
the first of a process are slow; `episodes=500` of `steps=1000` control steps are an evaluation;
`engine=mujoco_warp` simulates by MuJoCo Warp's own step what a kernel of ours would take. A job has a process
of its own, and jobs whose CSV is there are skipped. One that was cut off goes on after the seeds in
OUT_FOLDER/NAME.part, at the same commit. OUT_FOLDER/NAME.log names a seed whose numbers are no longer finite,
and NAME.error says why a job failed; the command fails then, too, when the others have run.

`seconds` are those of training alone: the policies of every `run.log_every` iterations are kept, and
evaluated when the run is over, all at once. Each row also has what a simulated row, one of a tail, a fit and
an update take, in ms (dynappo/bench/phases.py: at the last iteration with a tail).

`--ahead N` first compiles all jobs, N at once, so that the runs find their programs in JAX's cache; on a GPU
that XLA shares it may choose slower kernels, so compare an iteration with one of `--ahead 0`.
`table.py --add` reads the folder.
"""

import csv
import importlib
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dynappo import algorithm, schedule, seeds
from dynappo import config as config_lib
from dynappo.bench import phases
from dynappo.config import versions
from dynappo.physics.warp import scope
from dynappo.program import build, devices
from dynappo.run import overflow
from experiments import paper

less = importlib.import_module("experiments.21_less.run")
rough = importlib.import_module("experiments.28_rough.run")

# the program's own evaluation is not compiled
DEFAULTS = dict(num_seeds=1, log_every=10, eval_envs=0, checkpoint_every=0)
EPISODES, STEPS = 500, 1000  # of an evaluation, and of an episode of it
NAMES = {"physics": "row_ms", "tail": "tail_ms", "fit": "fit_ms", "ppo": "ppo_ms"}  # of a phase


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", type=Path)
    parser.add_argument("places", nargs="*")
    parser.add_argument("--ahead", type=int, default=0, metavar="N")
    parser.add_argument("--only", help="run this job of the file in this process")
    parser.add_argument("--compile", action="store_true", help="with --only: compile it alone")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    lines = [line.split() for line in args.jobs.read_text().splitlines() if line.strip()]
    every = {name: (job, fields) for name, job, *fields in lines}
    jobs = {name: read(*every[name]) for name in paper.chosen(every, args.places)}
    if args.only:
        one(args.out / f"{args.only}.csv", jobs[args.only], args.compile)
        return

    def start(name, *more):
        command = [sys.executable, __file__, args.out, args.jobs, "--only", name, *more]
        room = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"} if more else {}
        began = time.perf_counter()
        done = subprocess.run(command, env=os.environ | room, capture_output=True, text=True)
        error = args.out / f"{name}.error"
        error.unlink(missing_ok=True)  # of a try before
        if done.returncode:
            error.write_text(done.stderr)
        said = (done.stdout if not done.returncode else done.stderr).strip().splitlines()
        took = f"{time.perf_counter() - began:.0f} s in all"
        print(name, *more, said[-1] if said else done.returncode, took, sep="; ", flush=True)
        return done.returncode

    left = [name for name in jobs if not (args.out / f"{name}.csv").exists()]
    if args.ahead:
        with ThreadPoolExecutor(args.ahead) as pool:
            list(pool.map(lambda name: start(name, "--compile"), left))
    if failed := [name for name in left if start(name)]:
        raise SystemExit(f"failed: {', '.join(failed)}")


class Job(NamedTuple):
    """A line of JOBS.txt."""

    text: str
    config: Any  # of its first seed
    seeds: int
    engine: str  # "" or "mujoco_warp"
    episodes: int  # of an evaluation
    steps: int  # of such an episode
    warmup: int = 0  # seeds before the first one, thrown away


def read(job: str, fields) -> Job:
    values = dict(field.split("=", 1) for field in fields)
    count, engine = int(values.pop("seeds", 1)), values.pop("engine", "")
    warmup = int(values.pop("warmup", 0))
    if engine not in ("", "mujoco_warp"):
        raise SystemExit(f"engine is {engine!r}, expected mujoco_warp; others by physics.impl")
    evaluated = int(values.pop("episodes", EPISODES)), int(values.pop("steps", STEPS))
    robot, _, variant = job.partition(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    config.run.update(**DEFAULTS)
    for name, value in values.items():
        config_lib.override(config, name, value)
    if not 0 <= warmup <= config.run.seed:
        raise SystemExit(f"warmup is {warmup}, expected 0 to run.seed = {config.run.seed}")
    text = " ".join([job, *fields])
    return Job(text, config_lib.validate(config), count, engine, *evaluated, warmup)


def one(path: Path, job: Job, compile: bool = False) -> None:
    """Run the seeds of a job, and write its rows after each of them; or compile it alone."""
    config = job.config
    devices.own_process(config.run.device)
    build.check(config)
    if job.engine:
        scope.kernel = lambda *_: ""
    program = build.program(config)
    init = jax.jit(partial(algorithm.init, program.env, static=program.static))
    play, flat = episodes(job, program), config.task.terrain == "flat"
    measure = partial(scores, program, play) if flat else crossings(config)
    if compile:
        first = init(program.hyper, jax.random.key(0)).learner.params
        if flat:
            play.lower(*given(program, [first] * len(ends(config)))).compile()
        return
    about = {"job": job.text, "device": program.device, "commit": versions.commit() or ""}
    part = path.with_suffix(".part")
    rows = finished(part, about)
    there = {int(row["seed"]) for row in rows}
    about |= parts(config, program)
    began = time.perf_counter()
    first = config.run.seed
    left = [seed for seed in range(first, first + job.seeds) if seed not in there]
    for seed in [*range(first - job.warmup, first), *left]:
        state = program.place(init(program.hyper, jax.random.key(seed)))
        trained, policies, lost = train(config, program, state, seed)
        found = measure(policies)
        if seed < first:  # thrown away
            continue
        for k, row in enumerate(trained):
            told = {name: less.text(x[k]) for name, x in found.items()}
            rows.append(about | {"seed": seed} | row | told)
        less.write(part, rows)
        if lost:
            with path.with_suffix(".log").open("a") as file:
                file.write(lost)
    part.replace(path)
    took = time.perf_counter() - began
    ms = 1e3 * float(rows[-1]["seconds"]) / int(rows[-1]["iteration"])
    print(f"{ms:.2f} ms an iteration; {took:.0f} s of {len(left)} seeds")


def finished(part: Path, about: dict[str, str]) -> list[dict]:
    """Rows of `part`, which has the whole seeds of a job that was cut off; SystemExit if they are of another
    job, device or commit."""
    if not part.exists():
        return []
    with part.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if (found := {name: row.get(name) for name in about}) != about:
            raise SystemExit(
                f"{part} is of {found}, expected {about}; remove it, or choose another OUT_FOLDER"
            )
    return rows


def ends(config) -> range:
    """Iterations after which policies are kept."""
    every = config.run.log_every
    return range(every, config.run.num_iterations + 1, every)


def train(config, program, state, seed: int) -> tuple[list[dict], list, str]:
    """`(rows, policies, lost)`: iteration, simulator steps and seconds so far, of each time to evaluate; the
    line that says since when the seed's numbers are not finite, if they are not."""
    steps, seconds, first, rows, policies = schedule.sim_steps(config), 0.0, 0, [], []
    lost = ""
    for last in ends(config):
        columns = {name: column[first:last] for name, column in program.columns.items()}
        jax.block_until_ready(state)
        began = time.perf_counter()
        state, metrics = jax.block_until_ready(program.step(program.hyper, state, columns))
        seconds, first = seconds + time.perf_counter() - began, last
        overflow.check(metrics | columns)
        lost = lost or "".join(less.blown_up(metrics | columns, 1, seed).values())
        policies.append(jax.tree.map(jnp.copy, state.learner.params))
        row = {"iteration": last, "sim_steps": int(steps[last - 1]), "seconds": f"{seconds:.4f}"}
        rows.append(row)
    return rows, policies, lost


def episodes(job: Job, program):
    """The compiled `seeds.evaluate` of all policies of a run at once: each its own, all the same episodes."""
    sizes = dict(static=program.static, num_envs=job.episodes, num_steps=job.steps)
    return jax.jit(partial(seeds.evaluate, program.env, **sizes))


def given(program, policies) -> tuple:
    """Its arguments."""
    together = jax.tree.map(lambda *x: jnp.stack(x), *policies)
    return program.hyper, together, jax.random.key(0)


def scores(program, play, policies) -> dict:
    """Columns `[E]`, a number a policy."""
    found = jax.device_get(play(*given(program, policies)))
    return {name: found[name] for name in less.MEASURED if name in found}


def crossings(config):
    """`f(policies) -> columns [E]` on rough ground, one policy after the other."""
    tries = rough.tries(config)

    def of(policies):
        found = [tries(params) for params in policies]
        return {name: [each[name] for each in found] for name in found[0]}

    return of


def parts(config, program) -> dict[str, str]:
    """ms of each phase, at the last iteration with a tail."""
    last = config.schedule.last_iteration or config.run.num_iterations
    columns = {name: column[:last] for name, column in program.columns.items()}
    ms = phases.measure(config, program._replace(columns=columns), program.state, repeats=3)
    return {name: less.text(ms[phase]) if phase in ms else "" for phase, name in NAMES.items()}


if __name__ == "__main__":
    main()

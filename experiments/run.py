"""Runs of several seeds, one after another in one process: what the experiments' folders are made of.

    python experiments/run.py OUT ROBOT:VARIANT[:FIELD=VALUE[:FIELD=VALUE...]] ... [--seeds 5]

`go1:fast:schedule.end_steps=8` is configs/go1.py:fast with that field set. Each run writes
OUT/NAME.csv.xz, one row an iteration and seed with the columns of `KEPT` (`paper.read` reads it, and so do
xzcat and pandas), and OUT/NAME.json (summary with the evaluation of each seed, the config's
differences, hardware). NAME is the job with `_` for `:` and `=`. A job whose JSON is there is skipped,
so a batch that was cut off goes on with the same command.

To keep 500 iterations of 5 seeds below 40 kB, numbers have four digits, and after the 20th iteration
all columns but those of `EACH` are written in every fifth only. `--thin 10` keeps every
tenth row; best and final return in the JSON are of all rows. `--policies` writes OUT/NAME.K.npz, the policy
of seed K (0, 1, ...), for `play`, `evaluate` and `export` (340 kB each; not to be committed). `--lock FILE`:
of several batches on one GPU only one trains at a time, while the others compile.
"""

import contextlib
import datetime
import lzma
import re
import time
from pathlib import Path

import filelock
import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.policy import policy_file
from dynappo.program import build, devices
from dynappo.run import finish, log, training
from experiments import paper

KEPT = (
    "iteration sim_steps seconds episode_return episode_length velocity_error policy_std "
    "learning_rate kl value_loss model_loss model_error_1 model_error_4 falls "
    "surrogate_loss tail_bias tail_falls eval_return eval_fall_rate eval_tracking_error"
).split()
EACH = ("iteration", "sim_steps", "seconds", "episode_return")  # what thresholds are counted on


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="+", metavar="ROBOT:VARIANT[:FIELD=VALUE]")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="in all")
    parser.add_argument("--thin", type=int, default=1, help="iterations to a row of the CSV")
    parser.add_argument("--policies", action="store_true", help="write each seed's policy")
    parser.add_argument("--lock", type=Path, help="a file that one batch holds while it trains")
    args = parser.parse_args()
    devices.own_process()
    batch(args.out, args.jobs, args.seeds, args.set, args.thin, args.policies, args.lock)


def batch(out: Path, jobs, seeds: int, settings=(), thin=1, policies=False, lock=None) -> None:
    """Run all `jobs` that have no JSON in `out` yet; `settings` are FIELD=VALUE of all of them."""
    out.mkdir(parents=True, exist_ok=True)
    for job in jobs:
        path = out / (name(job) + ".json")
        if path.exists():
            continue
        began = time.perf_counter()
        config = configure(job, seeds, settings)
        training.check(training.Run(config))
        program = build.program(config)
        try:
            with alone(lock):
                trained = training.resume_and_loop([training.Run(config)], program)
        except FloatingPointError as error:  # a result too: this setting diverges
            files.write_json(path, {"job": job, "set": list(settings), "diverged": str(error)})
            print(f"{job:44s} {error}", flush=True)
            continue
        state, metrics = trained.state, trained.runs[0].metrics()
        write_csv(path.with_suffix(".csv"), kept(metrics, thin))
        evaluation = program.evaluate(state) if config.run.eval_envs else {}
        summary = finish.summarise(config, program, metrics, evaluation)
        summary["policy_std"] = np.ravel(metrics["policy_std"][-10:].mean(0)).tolist()
        summary |= {"job": job, "set": list(settings), "date": f"{datetime.date.today()}"}
        if policies:
            params = jax.device_get(state.learner.params)
            for k in range(seeds):
                one = jax.tree.map(lambda leaf, k=k: leaf[k], params) if seeds > 1 else params
                far = dict(iteration=summary["iterations"], sim_steps=summary["sim_steps"])
                policy_file.save(path.with_suffix(f".{k}.npz"), one, config, program.robot, **far)
        files.write_json(path, summary)
        print(row(job, summary), f"{time.perf_counter() - began:6.0f}", flush=True)


def write_csv(path: Path, metrics) -> None:
    """Metrics as a new CSV, packed: `path` and ".xz"."""
    path.unlink(missing_ok=True)
    log.append_csv(path, log.rows(metrics))
    path.with_suffix(".csv.xz").write_bytes(lzma.compress(path.read_bytes(), preset=9))
    path.unlink()


def chunks(config, lock: Path | None = None, program=None):
    """Train, and yield `(program, iterations done, state, metrics)` after each `run.log_every` of them.

    For what `run.loop` keeps to itself: the state. It is given away when the next chunk
    begins. A `program` of this config is not compiled again.
    """
    program = program or build.program(config)
    state, every = program.state, config.run.log_every
    with alone(lock):
        for first in range(0, config.run.num_iterations, every):
            columns = {n: jnp.asarray(c[first : first + every]) for n, c in program.columns.items()}
            state, metrics = program.step(program.hyper, state, columns)
            metrics = jax.device_get(metrics)
            if not np.isfinite(metrics["policy_std"]).all():
                raise FloatingPointError(f"training has blown up before iteration {first + every}")
            yield program, first + every, state, metrics


def keep_actors(folder: Path, job: str, iteration: int, config, program, state) -> None:
    """Write the actor of each seed of a run, to be played: `actor(folder, job, iteration, seed)`."""
    folder.mkdir(parents=True, exist_ok=True)
    actors = jax.device_get(state.learner.params["actor"])
    for s in range(config.run.num_seeds):
        one = {"actor": jax.tree.map(lambda leaf, s=s: leaf[s], actors)}
        to = actor(folder, job, iteration, s)
        policy_file.save(to, one, config, program.robot, iteration=iteration)


def actor(folder: Path, job: str, iteration: int, seed: int) -> Path:
    """The file of a seed's actor after so many iterations."""
    return folder / f"{name(job)}_{iteration}_seed{seed}.npz"


@contextlib.contextmanager
def alone(lock: Path | None):
    """Wait until no other process holds `lock`, and hold it."""
    if lock is None:
        yield
        return
    with filelock.FileLock(lock):
        yield


def name(job: str) -> str:
    """Of a job's files, without suffix."""
    return re.sub(r"[:=]", "_", job)


def configure(job: str, seeds: int, settings=()):
    """The validated config of a job; its own fields come after `settings`."""
    robot, variant, *fields = job.split(":")
    config = config_lib.load(f"configs/{robot}.py:{variant}")
    config.run.num_seeds = seeds
    for text in [*settings, *fields]:
        config_lib.override(config, *text.split("=", 1))
    return config_lib.validate(config)


def kept(metrics, thin: int = 1):
    """The columns and rows of the CSV: NaN, an empty cell, where a number is left out."""
    few = {n: metrics[n][thin - 1 :: thin] for n in KEPT if n in metrics}
    iteration = few["iteration"]
    for n in few.keys() - {"iteration", "sim_steps"}:
        few[n] = np.vectorize(lambda x: float(f"{x:.4g}"), otypes=[float])(few[n])
        if n not in EACH:
            few[n][(iteration > 20) & (iteration % 5 != 0)] = np.nan
    return few


def row(job, summary):
    """Of all seeds: return, its spread, best; evaluated return, falls, tracking; seconds, set-up."""
    numbers = np.array(summary["return"], float), np.array(summary["return_max"], float)
    text = f"{job:44s} {numbers[0].mean():7.2f} +-{numbers[0].std():5.2f} {numbers[1].mean():7.2f}"
    evaluation = summary.get("evaluation", {})
    for name in ("return", "fall_rate", "tracking_error"):
        if name in evaluation:
            text += f" {np.mean(np.array(evaluation[name], float)):7.3f}"
    return text + f" {summary['seconds']:6.1f} {summary['compile_seconds']:6.1f}"


if __name__ == "__main__":
    main()

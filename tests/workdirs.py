"""A finished run over the toy environment: its folder, how it is read, and what can happen to it."""

import csv
import functools
import json
from types import SimpleNamespace

import jax
import pytest
import toy_env
from ml_collections import config_dict
from toy_runs import leaves

from dynappo import schedule, train
from dynappo.program import build
from dynappo.run import training
from dynappo.run import workdir as workdir_lib
from dynappo.tasks.velocity import env as env_lib

SMALL = toy_env.TAIL | {
    "run.num_iterations": 4,
    "run.log_every": 2,
    "run.checkpoint_every": 2,
    "run.eval_envs": 8,
    "run.video_seconds": 0.0,
    "run.device": "cpu",
}
N_REAL = [8, 7, 6, 5]  # of 16 robots


def config(**fields):
    """The config of the run, with `group__field` set."""
    more = {name.replace("__", "."): value for name, value in fields.items()}
    return toy_env.settings(SMALL | more)[0]


def toy(patch: pytest.MonkeyPatch):
    """The toy environment in place of the robot's, for as long as `patch` holds."""
    patch.setattr(env_lib, "make", lambda *_, **__: toy_env.make())


def compiled_once(program):
    """`build.program`, but what it has compiled for the same arguments it hands out again.

    Iterations more or fewer are other columns for the same program.
    """
    made = {}

    @functools.wraps(program)
    def again(config, env=None, each=None, **_):
        alike = config_dict.ConfigDict(config.to_dict())
        alike.run.num_iterations = 0
        of = alike.to_json_best_effort(), env is None, str(leaves(each))
        if of not in made:
            made[of] = program(config, env, each)
        # the first state is donated
        state = jax.tree.map(lambda x: x.copy(), made[of].state)
        return made[of]._replace(state=state, columns=schedule.columns(config))

    return again


@pytest.fixture(scope="module", autouse=True)
def one_program():
    """Of the module that imports it: runs that differ in iterations, or go on, have one compiled program."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "program", compiled_once(build.program))
        yield


class Run:
    """A finished run: its folder, what `train` returned and what it told `progress_fn`."""

    def __init__(self, config, workdir):
        self.workdir, self.told = workdir, []
        with pytest.MonkeyPatch.context() as patch:
            toy(patch)
            self.state, self.metrics = train.train(
                config, workdir, lambda iteration, last: self.told.append((iteration, last))
            )
        self.files = {p.name: p.read_bytes() for p in workdir.iterdir() if p.is_file()}


def loop(config, program, workdir=None, progress=None, stop=False, say=None):
    """`(state, metrics, iterations that were told)` of a run that begins or goes on; `stop`: at once."""
    told = []
    callbacks = training.Callbacks(
        say=say or training.to_stderr,
        progress=progress or (lambda iteration, last: told.append(iteration)),
    )
    asked = SimpleNamespace(status=130 * stop, patient=False)
    run = training.Run(config, workdir)
    trained = training.resume_and_loop([run], program, callbacks, asked)
    return trained.state, trained.runs[0].metrics(), told


def open_run(config, workdir, *chunks):
    """A run with these metrics, whose folder nobody writes into yet."""
    return workdir_lib.OpenRun(config, workdir, None, [], list(chunks))


def table(workdir):
    """The rows of metrics.csv as they stand there, but for the seconds."""
    with (workdir / "metrics.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def steps(workdir):
    """Names of what is in checkpoints/."""
    return {p.name for p in (workdir / "checkpoints").iterdir()}


def opened(workdir, config, **how):
    """The folder of a run, opened and let go of."""
    with workdir_lib.open_workdir(workdir, config, **how) as path:
        return path


def everything(folder):
    """What is in a folder, with the bytes and the time of every file."""
    return {
        p.relative_to(folder): (p.read_bytes(), p.stat().st_mtime_ns) if p.is_file() else None
        for p in folder.rglob("*")
    }


def other_hash(step):
    """Makes the arrays of the checkpoint `step` others than those that were saved."""
    path = step / "about" / "metadata"
    about = json.loads(path.read_text())
    path.write_text(json.dumps(about | {"sha256": about["sha256"][::-1]}))

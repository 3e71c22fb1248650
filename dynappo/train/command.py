"""The command `dynappo train`: its flags, and what stops it.

Without --sweep it trains one run with `run.training.train_together`; with --sweep a list of them with
`sweeps.sweep`, which calls the same. `run` and `sweeps` know nothing of this command: imports go one way,
`run` <- `sweeps` <- `train`.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from dynappo import config as config_lib
from dynappo.config import fields, flags, terms
from dynappo.config.stop import Stop
from dynappo.program import devices, distributed, environment
from dynappo.run import show, training
from dynappo.run import workdir as workdir_lib
from dynappo.sweeps import folder as sweep_folder
from dynappo.sweeps import grid
from dynappo.sweeps import sweep as sweep_lib
from dynappo.web import address, child

GOES_ON = "the same command goes on from {}"
DOES_THE_REST = "all iterations are done, the same command does what is left"
SWEEP_GOES_ON = "the same command goes on with the sweep"
USAGE = """\
examples
  python -m dynappo.train --config=go1
  python -m dynappo.train --config=go1:laptop --workdir=runs/try
  python -m dynappo.train --workdir=runs/try
  python -m dynappo.train --config=go1:logs --logs=walked.npz --restore=runs/go1
  python -m dynappo.train --config=playground:Go1JoystickFlatTerrain:ppo
--config=playground: lists the tasks of MuJoCo Playground, --config=brax: those of brax
variants follow the name: go1:laptop, :ppo16, :dyna4, ... (none: best)
set any field of the config (configs/default.py lists them), as in
  --config.run.num_iterations=200 --config.ppo.desired_kl=0.03
the same command again resumes the run in its workdir, and so does --workdir=DIR alone
a FILE.py with get_env(config) trains an environment of your own: docs/environment.md
"""


class Command(NamedTuple):
    """What a command line asks for."""

    config: Any
    workdir: Path
    fresh: bool = False
    restore: Path | None = None
    processes: tuple[Any, Any, Any] = (None, None, None)  # of distributed.join
    get_env: Any = None  # of the config's file, if it has an environment of its own
    serve: str | None = None  # the address of a page; "": the usual one
    sweep: sweep_lib.Sweep | None = None  # instead of a run; `config` is its first combination's
    given: Mapping[str, str] = {}  # the fields that flags set, with their texts


def parse(argv: list[str] | None) -> Command:
    """The `Command` of a command line; ConfigError if it cannot be understood."""
    parser = flags.parser("train", "Train a legged robot to follow velocity commands.", USAGE)
    parser.add_argument(
        "--config",
        metavar="NAME[:VARIANT]|FILE.py[:VARIANT]",
        help="what to train: a robot, playground:TASK, brax:NAME, or a config file",
    )
    parser.add_argument(
        "--workdir", type=flags.path, help="folder of the run; default: runs/FILE-VARIANT"
    )
    parser.add_argument(
        "--fresh", action="store_true", help="start over; an earlier run is moved aside"
    )
    parser.add_argument(
        "--restore",
        type=_source,
        metavar="SOURCE",
        help="start from the networks of another workdir, a checkpoint, a policy.npz or a bundled policy",
    )
    parser.add_argument(
        "--terms",
        type=flags.path,
        metavar="FILE",
        help="terms of your own, which run as Python (docs/task.md); same as --config.task.terms=FILE",
    )
    parser.add_argument(
        "--logs",
        type=flags.path,
        metavar="FILE",
        help="learn from a robot's recorded rows in place of simulated ones (robots/DEPLOY.md)",
    )
    parser.add_argument(
        "--sweep",
        action="append",
        metavar="FIELD=VALUE,VALUE,...",
        help="a run for each value, in one folder; several make a grid (docs/sweeps.md)",
    )
    parser.add_argument(
        "--serve",
        metavar="PORT",
        nargs="?",
        const="",
        help="watch it learn in a browser; default: port 8080, for this machine alone",
    )
    several = parser.add_argument_group("several processes, where Slurm does not start them")
    several.add_argument("--coordinator", metavar="HOST:PORT", help="of process 0")
    several.add_argument("--processes", type=int, metavar="N")
    several.add_argument("--process", type=int, metavar="I", help="0 to N-1")
    known, rest = flags.read_with_fields(parser, argv)
    rest += [f"--config.task.terms={known.terms}"] if known.terms else []
    here = known.config is None and known.workdir
    swept = grid.read(known.sweep or [])
    if here and not swept and sweep_folder.is_one(known.workdir):
        (config, swept), get_env = sweep_folder.load(known.workdir, rest), None
    elif here and not swept and os.path.isfile(known.workdir / "config.json"):
        config, get_env = flags.load_run(known.workdir, rest), None
    elif here and not swept and (kept := workdir_lib.kept_config(known.workdir)):
        config, get_env = flags.load_run(known.workdir, rest, kept), None
    elif here and not swept:
        raise config_lib.ConfigError(workdir_lib.no_run(known.workdir))
    else:
        config, get_env = flags.load_both(known.config, rest)
    if both := swept.keys() & flags.given(rest).keys():
        field = min(both)
        raise config_lib.ConfigError(
            f"--config.{field}={flags.given(rest)[field]}: {field} is swept over {', '.join(swept[field])}; "
            "expected it in one of them"
        )
    if known.logs:
        environment.set_log(config, os.path.abspath(known.logs))
    name, _, variant = str(known.config).partition(":")
    folder = (
        Path(name).stem
        + (f"-{variant}" if variant else "").replace(":", "-")
        + "-sweep" * bool(swept)
    )
    workdir = known.workdir or Path("runs") / folder
    if not swept and sweep_folder.is_one(workdir):
        raise config_lib.ConfigError(
            f"--workdir={workdir} holds a sweep: --workdir={workdir} alone goes on with it; choose another "
            "folder for a run"
        )
    sweep = None
    if swept:
        sweep = sweep_lib.Sweep(swept, config, grid.combinations(config, swept))
    if known.serve is not None:
        _prepare_page(known.serve, config, sweep)
    config = sweep.combinations[0].config if sweep else config_lib.validate(config)
    processes = (known.coordinator, known.processes, known.process)
    own = known.fresh, known.restore, processes, get_env
    given = flags.given(rest)
    return Command(config, workdir, *own, serve=known.serve, sweep=sweep, given=given)


def _source(text: str) -> Path:
    """`--restore` as a path: `go1_deploy` is the bundled policy of that name, `./go1_deploy` a folder."""
    flags.path(text)  # an empty one, or one that no file can have, ends here
    return workdir_lib.source(text)


def _prepare_page(serve: str, config, sweep) -> None:
    """ConfigError if `--serve` cannot be done. Makes checkpoints frequent: each is a newer policy."""
    address.check(address.read(serve))
    if sweep or not (config.robot or config.env):
        raise config_lib.ConfigError(
            "--serve shows one run of a robot of robots/, of a Playground task or of brax's, not an "
            "environment of your own or a sweep; leave it out"
        )
    if config.run.checkpoint_every == fields.defaults().run.checkpoint_every:
        config.run.checkpoint_every = 2 * config.run.log_every


def main(argv: list[str] | None = None) -> None:
    """The command. Its exit statuses are those of `flags.answer`; 130 on ctrl-C, 143 on SIGTERM, and
    both save first."""
    stop, parsed = Stop(), []

    def action():
        parsed.append(parse(argv))
        (command,) = parsed
        with distributed.watched():
            devices.own_process(command.config.run.device)
            distributed.join(*command.processes)
            devices.begin()
            with stop:
                train_and_show(command, stop)
            distributed.leave()

    def stopped():
        for folder in workdir_lib.new_folders():  # where this process is ended while it compiles
            workdir_lib.remove_made(folder)
        return f"stopped; {afterwards(*parsed)}" if parsed else "stopped"

    stop.ended = stopped

    with distributed.together():
        flags.answer(action, stopped)
    if stop.status:
        sys.exit(stop.status)


def afterwards(command: Command) -> str:
    """What the same command will do after this one was stopped."""
    goes_on = SWEEP_GOES_ON if command.sweep else GOES_ON
    if distributed.several() and not distributed.first():  # which cannot see it
        return f"{goes_on.format('the last checkpoint')}, if there is one"
    if not command.sweep:
        if not (saved := workdir_lib.saved(command.workdir)):
            return "there is no checkpoint yet, the same command starts anew"
        if saved[0] >= command.config.run.num_iterations:
            goes_on = DOES_THE_REST
        goes_on = goes_on.format(f"iteration {saved[0]}")
    return goes_on.replace("command", "command without --fresh") if command.fresh else goes_on


def train_and_show(command: Command, stop: Stop) -> None:
    """Train what a command line asks for, and print the progress."""
    from rich.console import Console

    out = Console(highlight=False, emoji=False, quiet=not distributed.first())
    if command.sweep:
        own = command.fresh, command.restore, command.get_env
        stopped = sweep_lib.train_all(out, command.sweep, command.workdir, *own, stop)
    else:
        stopped = train_run(out, command, stop)
    if stopped and distributed.first():
        print(f"dynappo: {stopped}; {afterwards(command)}", file=sys.stderr)


def train_run(out, command: Command, stop: Stop) -> str:
    """Train one run, and print what will happen, the progress and the results.

    Returns "", or, if `stop` interrupted it, a line on what was saved.
    """
    config, env = environment.from_file(command.get_env, command.config)
    run = training.Run(config, command.workdir, env, command.restore)
    training.check(run, command.fresh)  # before anything is written
    if note := show.of_little_effect(config, command.given):
        show.unusual(out, note)
    with contextlib.ExitStack() as stack, show.live(out, config, command.given) as callbacks:

        def opened():  # nothing is announced that is then refused; the page shows what is in the folder
            out.print(f"dynappo {show.describe(config)}", markup=False, soft_wrap=True)
            callbacks.opened()
            serve = command.serve if distributed.first() else None
            path = terms.of(config.task).path if serve is not None else ""
            stack.enter_context(child.serving(command.workdir, serve, path))

        def finished(*of):
            callbacks.finished(*of)
            show.summary(out, *of)

        own = callbacks._replace(opened=opened, finished=finished)
        trained = training.train_together([run], own, stop, command.fresh)
    if trained.ended:
        return ""
    done = trained.runs[0].iterations()
    if distributed.first() and done not in workdir_lib.saved(command.workdir):
        return f"stopped at iteration {done}, which could not be saved"
    return f"saved at iteration {done} and stopped"

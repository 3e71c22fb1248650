"""The command `dynappo train`: its flags and what it prints. `run.py` does the work."""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from dynappo import config as config_lib
from dynappo.config import fields, flags, shell
from dynappo.program import build, devices, distributed, environment, memory
from dynappo.sweeps import folder as sweep_folder
from dynappo.sweeps import grid
from dynappo.sweeps import run as sweeps
from dynappo.train import finish, show
from dynappo.train import run as run_lib
from dynappo.train import workdir as workdir_lib
from dynappo.web import address, child

# by engine: how long it takes, and what for (experiments/03_speed; README)
WAIT = {
    "warp": "8 s if cached, else 20 to 35 s",
    "jax": "under a minute; half of it when cached",
    "c": "15 s; 5 when cached",
}
GOES_ON = "the same command goes on from the last checkpoint"
USAGE = """\
examples
  python -m dynappo.train --config=go1
  python -m dynappo.train --config=go1:laptop --workdir=runs/try
  python -m dynappo.train --workdir=runs/try
variants follow the name: go1:quick, :ppo16, :dyna4, ... (none: best)
set any field of the config (configs/default.py lists them), as in
  --config.run.num_iterations=200 --config.ppo.learning_rate=3e-4
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
    env: Any = None  # what that returned
    serve: str | None = None  # the address of a page; "": the usual one
    sweep: sweeps.Sweep | None = (
        None  # instead of one run; `config` is then its first combination's
    )


def parse(argv: list[str] | None) -> Command:
    """A command line, understood; ConfigError if it cannot be."""
    parser = flags.parser("train", "Train a quadruped to follow velocity commands.", USAGE)
    parser.add_argument(
        "--config",
        metavar="NAME[:VARIANT]|FILE.py[:VARIANT]",
        help="what to train: a robot, or a config file",
    )
    parser.add_argument(
        "--workdir", type=flags.path, help="folder of the run; default: runs/FILE-VARIANT"
    )
    parser.add_argument(
        "--fresh", action="store_true", help="start over; an earlier run is moved aside"
    )
    parser.add_argument(
        "--restore",
        type=flags.path,
        metavar="SOURCE",
        help="start from the networks of another workdir, a checkpoint or a policy.npz",
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
    known, rest = flags.read_known(parser, argv)
    here = known.config is None and known.workdir
    swept = grid.read(known.sweep or [])
    if here and not swept and sweep_folder.is_one(known.workdir):
        (config, swept), get_env = sweep_folder.load(known.workdir, rest), None
    elif here and not swept and os.path.isfile(known.workdir / "config.json"):
        config, get_env = flags.load_run(known.workdir, rest), None
    else:
        config, get_env = flags.load_both(known.config, rest)
    name, _, variant = str(known.config).partition(":")
    folder = Path(name).stem + (f"-{variant}" if variant else "") + "-sweep" * bool(swept)
    workdir = known.workdir or Path("runs") / folder
    if not swept and sweep_folder.is_one(workdir):
        raise config_lib.ConfigError(
            f"--workdir={workdir} holds a sweep: --workdir={workdir} alone goes on with it; choose another "
            "folder for a run"
        )
    sweep = None
    if swept:
        sweep = sweeps.Sweep(swept, config, grid.combinations(config, swept))
    if known.serve is not None:
        _prepare_page(known.serve, config, sweep)
    config = sweep.combinations[0].config if sweep else config_lib.validate(config)
    processes = (known.coordinator, known.processes, known.process)
    own = known.fresh, known.restore, processes, get_env
    return Command(config, workdir, *own, serve=known.serve, sweep=sweep)


def _prepare_page(serve: str, config, sweep) -> None:
    """ConfigError if `--serve` cannot be done; checkpoints come often, for each is a newer policy."""
    address.read(serve)
    address.check()
    if sweep or not config.robot:
        raise config_lib.ConfigError("--serve shows one run of a robot of robots/; leave it out")
    if config.run.checkpoint_every == fields.defaults().run.checkpoint_every:
        config.run.checkpoint_every = 2 * config.run.log_every


def main(argv: list[str] | None = None) -> None:
    """The command. Its exit statuses are those of `flags.answer`; 130 on ctrl-C, 143 on SIGTERM, and
    both save first."""
    stop, asked = Stop(), []

    def action():
        asked.append(parse(argv))
        (command,) = asked
        with distributed.watched():
            devices.own_process(command.config.run.device)
            distributed.join(*command.processes)
            devices.begin()
            with stop:
                if command.sweep:
                    own = command.fresh, command.restore, command.get_env
                    sweeps.train_and_show(command.sweep, command.workdir, *own, stop)
                else:
                    train_and_show(command, stop)
            distributed.leave()

    def stopped():
        return f"stopped; {afterwards(*asked)}" if asked else "stopped"

    with distributed.together():
        flags.answer(action, stopped)
    if stop.status:
        sys.exit(stop.status)


def afterwards(command: Command) -> str:
    """What the same command will do with what a stopped one has left."""
    if command.sweep:
        return sweeps.afterwards(command.fresh)
    if distributed.several() and not distributed.first():
        return f"{GOES_ON}, if there is one"  # which the first process can see
    if not workdir_lib.saved(command.workdir):
        return "there is no checkpoint yet, the same command starts anew"
    return GOES_ON.replace("command", "command without --fresh") if command.fresh else GOES_ON


class Stop:
    """Catches ctrl-C and SIGTERM while it is entered; the first asks the loop to save and stop, and
    `status` is the exit status it means. Before the loop runs, and at the second, it interrupts."""

    def __init__(self):
        self.status, self.patient = 0, False

    def __enter__(self):
        self.old = {s: signal.signal(s, self._handle) for s in (signal.SIGINT, signal.SIGTERM)}

    def __exit__(self, *_):
        for number, handler in self.old.items():
            signal.signal(number, handler)

    def _handle(self, number, _):
        again, self.status = self.status, 128 + number
        if again or not self.patient:
            raise KeyboardInterrupt(self.status)


def train_and_show(command: Command, stop: Stop) -> None:
    """`train.train`, told to a person: what will happen, how it goes, what came out."""
    from rich.console import Console

    config, env = environment.from_file(command.get_env, command.config)
    command, folder = command._replace(config=config, env=env), command.restore
    out = Console(highlight=False, quiet=not distributed.first())
    out.print(f"dynappo {show.describe(config)}", markup=False, soft_wrap=True)
    run_lib.check(config, env)  # before anything is written
    if folder:
        from dynappo.train import restore

        distributed.on_first(lambda: restore.check(folder, config))
        if command.fresh and folder.resolve() == command.workdir.resolve():
            raise config_lib.ConfigError(
                f"--restore={folder}: --fresh moves that run aside; name the folder of another one"
            )
    text = distributed.on_first(lambda: "" if command.fresh else written(command.workdir))
    say = partial(out.print, style="yellow", markup=False, soft_wrap=True)
    apart = config_lib.versions_apart(text, config)
    if apart:
        say(apart)
    with workdir_lib.open_workdir(command.workdir, config, command.fresh, say):
        with child.beside(command.workdir, command.serve if distributed.first() else None):
            _train_and_show(command, stop, out)


def written(workdir: Path) -> str:
    """The config.json of a run that has begun in `workdir`; "" if there is none."""
    path = workdir / "config.json"
    return (
        path.read_bytes().decode(errors="replace")
        if os.path.isfile(path) and workdir_lib.begun(workdir)
        else ""
    )


def _train_and_show(command: Command, stop: Stop, out) -> None:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    def say(text):
        out.print(text, style="yellow", markup=False, soft_wrap=True)

    config, workdir = command.config, command.workdir
    from dynappo.train import restore

    source = restore.source(workdir, command.restore)
    with out.status(f"compiling ({WAIT[devices.engine(config)]})"):
        config = workdir_lib.in_step(config, workdir)
        program = build.program(config, command.env, meanwhile=run_lib.import_savers)
        if source:
            program = restore.start_from(source, program, workdir, say)
    engine = devices.ENGINES[program.impl]
    out.print(
        f"{program.device}, {engine}; compiled in {program.compile_seconds:.0f} s, "
        f"{memory.text(program.bytes_needed)} of memory"
    )
    if slow := build.slower(program, config):
        say(slow)
    if program.impl == "jax" and program.device == "cpu":
        text = "on a CPU C MuJoCo is more than twice as fast as MJX: --config.physics.impl=c"
        laptop = f"; made for it: {shell.program()} train --config={config.robot}:laptop"
        say(text + laptop * bool(config.robot))
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(16),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("{task.fields[line]}"),
        TimeRemainingColumn(),
        console=out,
        disable=not out.is_terminal,
    )
    begun: list[tuple[float, float]] = []

    def tell(iteration, last):
        begun.append((float(last["seconds"]), float(last["sim_steps"])))
        line = f"{show.progress_line(last, begun)} on {engine}"
        bar.update(task, completed=iteration, line=line)
        if not out.is_terminal and (10 * iteration) % config.run.num_iterations < 10:
            out.print(f"iteration {iteration:4d}  {line}", soft_wrap=True)

    with bar:
        task = bar.add_task("training", total=config.run.num_iterations, line="")
        stop.patient = True
        state, metrics = run_lib.loop(
            config,
            program,
            workdir,
            tell,
            should_stop=lambda: bool(stop.status),
            say=say,
        )
        stop.patient = False
    done = int(metrics["iteration"][-1])
    if distributed.any_of(bool(stop.status)) or done < config.run.num_iterations:
        if distributed.first():
            saved = f"saved at iteration {done} and stopped"
            if done not in workdir_lib.saved(workdir):
                saved = f"stopped at iteration {done}, which could not be saved"
            print(f"dynappo: {saved}; {afterwards(command)}", file=sys.stderr)
        return
    if not out.is_terminal:
        out.print("evaluates and films")
    with out.status("evaluating, filming"):
        summary = finish.finish(config, program, workdir, state, metrics, say)
    if summary:
        show.summary(out, config, workdir, summary)
    finish.check_saved(config, program, workdir, state, metrics, say)

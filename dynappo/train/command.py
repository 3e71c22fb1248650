"""What the command `python -m dynappo.train` reads and prints; the work is `run.py`'s."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Any, NamedTuple

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import flags
from dynappo.program import build, devices, distributed, environment, memory
from dynappo.train import finish
from dynappo.train import run as run_lib
from dynappo.train import workdir as workdir_lib

GOES_ON = "the same command goes on from the last checkpoint"
USAGE = """\
any field of the config (configs/default.py lists them) can be set, as in
  --config.run.num_iterations=200 --config.ppo.learning_rate=3e-4
variants follow the file's name: configs/go1.py:quick, :ppo16, :dyna4, ... (none: best)
the same command again goes on with the run of its workdir
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


def parse(argv: list[str] | None) -> Command:
    """A command line, understood; ConfigError if it cannot be."""
    parser = flags.parser("train", "Train a quadruped to follow velocity commands.", USAGE)
    parser.add_argument("--config", metavar="NAME[:VARIANT]|FILE.py[:VARIANT]")
    parser.add_argument("--workdir", type=flags.path, help="default: runs/FILE-VARIANT")
    parser.add_argument(
        "--fresh", action="store_true", help="start over; a run that is there is moved aside"
    )
    parser.add_argument(
        "--restore",
        type=flags.path,
        metavar="DIR",
        help="start from the networks of another workdir",
    )
    several = parser.add_argument_group("several processes, where Slurm does not start them")
    several.add_argument("--coordinator", metavar="HOST:PORT", help="of process 0")
    several.add_argument("--processes", type=int, metavar="N")
    several.add_argument("--process", type=int, metavar="I", help="0 to N-1")
    known, rest = flags.read_known(parser, argv)
    config, get_env = flags.load_both(known.config, rest)
    name, _, variant = known.config.partition(":")
    folder = Path(name).stem + (f"-{variant}" if variant else "")
    workdir = known.workdir or Path("runs") / folder
    processes = (known.coordinator, known.processes, known.process)
    config = config_lib.validate(config)
    return Command(config, workdir, known.fresh, known.restore, processes, get_env)


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
            with stop:
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

    config, env = environment.made(command.get_env, command.config)
    command, folder = command._replace(config=config, env=env), command.restore
    out = Console(highlight=False, quiet=not distributed.first())
    out.print(f"[bold]dynappo[/bold] {describe(config)}", soft_wrap=True)
    run_lib.check(config, env)  # before anything is written
    if folder:
        from dynappo.train import restore

        distributed.on_first(lambda: restore.check(folder, config))
        if command.fresh and folder.resolve() == command.workdir.resolve():
            raise config_lib.ConfigError(
                f"--restore={folder}: --fresh moves that run aside; name the folder of another one"
            )
    with workdir_lib.open_workdir(command.workdir, config, command.fresh):
        _train_and_show(command, stop, out)


def _train_and_show(command: Command, stop: Stop, out) -> None:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    def say(text):
        out.print(text, style="yellow", markup=False, soft_wrap=True)

    config, workdir = command.config, command.workdir
    from dynappo.train import restore

    source = restore.source(workdir, command.restore)
    with out.status("compiling (under a minute; half of it when cached)"):
        config = workdir_lib.in_step(config, workdir)
        program = build.program(config, command.env)
        if source:
            program = restore.start_from(source, program, say)
    engine = devices.ENGINES[program.impl]
    out.print(
        f"{program.device}, {engine}; compiled in {program.compile_seconds:.0f} s, "
        f"{memory.text(program.bytes_needed)} of memory"
    )
    if program.impl == "jax" and program.device == "cpu":
        say("on a CPU C MuJoCo is more than twice as fast as MJX: --config.physics.impl=c")
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

    def show(iteration, last):
        begun.append((float(last["seconds"]), float(last["sim_steps"])))
        line = f"{progress_line(last, begun)} on {engine}"
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
            show,
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
    with out.status("evaluating, filming"):
        summary = finish.finish(config, program, workdir, state, metrics)
    if summary:
        show_summary(out, config, workdir, summary)
    finish.check_saved(workdir, done)


def describe(config) -> str:
    """Two lines on what a run will do, before anything is compiled."""
    s, r, run = config.schedule, config.rollout, config.run
    seeds = f" x {run.num_seeds} seeds" if run.num_seeds > 1 else ""
    what = f"{config.robot}: {r.num_envs} robots"
    if not config.robot:
        what = f"an environment of your own: {r.num_envs} copies"
    devices = run.mesh_seed * run.mesh_env
    over = f" over {run.mesh_seed} x {run.mesh_env} devices" if devices > 1 else ""
    tail = "plain PPO, no model"
    if schedule.uses_model(config):
        tail = f"tail of {s.end_steps}"
        if s.end_iteration > s.start_iteration:
            tail += f", from {s.start_steps} over iterations {s.start_iteration}-{s.end_iteration}"
    steps = schedule.sim_steps(config)[-1] / 1e6
    return (
        f"trains {what}{seeds}{over}, {r.horizon} rows an iteration, {tail}\n"
        f"{run.num_iterations} iterations, {steps:.2f} M simulator steps"
    )


def progress_line(last: dict, begun: list) -> str:
    """Return, episode length, tracking error, policy std and pace of one iteration."""
    import numpy as np

    (t0, s0), (t1, s1) = begun[max(0, len(begun) - 6)], begun[-1]
    pace = (s1 - s0) / (t1 - t0) if t1 > t0 else s1 / max(t1, 1e-9)
    mean = {name: float(np.mean(value)) for name, value in last.items()}
    error = f"error {mean['velocity_error']:.2f} m/s  " if "velocity_error" in mean else ""
    text = (
        f"return {mean['episode_return']:6.2f}  length {mean['episode_length']:4.0f}  {error}"
        f"std {mean['policy_std']:.2f}  {pace / 1e3:.1f} k steps/s"
    )
    return text.replace("nan", " - ")


def show_summary(out, config, workdir: Path, summary: dict) -> None:
    """The final table, where things are, and what to try next."""
    import numpy as np
    from rich.table import Table

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))

    def mean(value, unit="", scale=1, none="no episode has ended"):
        values = [v * scale for v in np.ravel(value) if v is not None and np.isfinite(v)]
        if not values:
            return none
        text = f"{np.mean(values):.2f}{unit}"
        several = f" ({len(values)} seeds: {min(values):.2f} to {max(values):.2f})"
        return text + several * (len(values) > 1)

    took = "not known" if summary["seconds"] is None else f"{summary['seconds']:.1f} s"
    rows = {
        "return (last 10 iterations)": mean(summary["return"]),
        "best return": mean(summary["return_max"]),
        "simulator steps": f"{summary['sim_steps'] / 1e6:.2f} M on {devices.ENGINES[summary['impl']]}",
        "training": f"{took}, after {summary['compile_seconds']:.0f} s of set-up",
    }
    if config.run.eval_steps and config.run.eval_envs and config.robot:
        dt = config.physics.substeps * config.physics.timestep
        steps = config.task.episode_length, config.run.eval_steps
        rows["episodes"] = "{:g} s in training, {:g} s in the evaluation".format(
            *(dt * n for n in steps)
        )
    for name, label, unit in (
        ("return", "evaluation: return", ""),
        ("fall_rate", "evaluation: episodes with a fall", " %"),
        ("tracking_error", "evaluation: tracking error", " m/s"),
        ("yaw_error", "evaluation: yaw rate error", " rad/s"),
    ):
        if name in summary.get("evaluation", {}):
            scale = 100 if unit == " %" else 1
            value = summary["evaluation"][name]
            rows[label] = mean(value, unit, scale, "nobody stood for a second")
    for label, value in rows.items():
        table.add_row(label, value)
    out.print(table)
    names = "metrics.csv, summary.json, policy.npz, checkpoints/"
    out.print(f"written to {workdir}: {names}", soft_wrap=True)
    if "curves" in summary:
        out.print(str(summary["curves"]), soft_wrap=True)
    if "video" in summary:
        out.print(str(summary["video"]), soft_wrap=True)
    if not config.robot:
        text = (
            f"no film, no play: it is no robot; policy_file.load_actor('{workdir}/policy.npz') acts"
        )
        return out.print(text, soft_wrap=True, markup=False)
    out.print(f"see it: python -m dynappo.play {workdir} --out=walk.html", soft_wrap=True)
    if config.run.num_iterations < 200 or summary["impl"] == "c":
        name = config.robot
        out.print(f"next: python -m dynappo.train --config=configs/{name}.py  (4096 robots, a GPU)")

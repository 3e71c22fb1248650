"""What `dynappo train` prints: what a run will do, its progress, its results, what to do next."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import fields, files, shell, terms
from dynappo.policy import walks
from dynappo.program import build, devices, memory
from dynappo.program.build import Program
from dynappo.run import blowups, log
from dynappo.run.training import Callbacks

# by engine: how long it takes, and what for (experiments/03_speed; README)
COMPILING = {
    "warp": "7 to 10 s if cached, else 20 to 35 s",
    "jax": "under a minute, on a CPU minutes; half of it when cached",
    "c": "15 s, on a slow machine minutes; a third of it when cached",
    "own": "under a minute, on a CPU perhaps minutes",
}
# what only an adaptive learning rate reads
OF_ADAPTIVE = ("ppo.desired_kl", "ppo.late_kl", "ppo.min_learning_rate", "ppo.max_learning_rate")
# what only a tail reads, beside the group `model`
OF_TAIL = ("rollout.imagined", "schedule.rounds", "schedule.anchors", "schedule.new_commands")
# fields of a run that shows within minutes whether all works (docs/environment.md)
SMALL = "--config.rollout.num_envs=64 --config.run.num_iterations=20"
PARTS = 10  # lines of a run where there is no terminal


def describe(config) -> str:
    """Two lines on what a run will do, before anything is compiled."""
    s, r, run = config.schedule, config.rollout, config.run
    seeds = f" x {run.num_seeds} seeds" if run.num_seeds > 1 else ""
    what = f"{config.robot}: {r.num_envs} robots"
    if config.env:
        what = f"{config.env}: {r.num_envs} copies"
    elif not config.robot:
        what = f"an environment of your own: {r.num_envs} copies"
    devices = run.mesh_seed * run.mesh_env
    over = f" over {run.mesh_seed} x {run.mesh_env} devices" if devices > 1 else ""
    tail = "plain PPO, no model"
    if schedule.uses_model(config):
        tail = f"the model writes {s.end_steps} of them"
        if s.end_iteration > s.start_iteration:
            span = f"{s.start_iteration}-{s.end_iteration}"
            tail += f" ({s.start_steps} to {s.end_steps} over iterations {span})"
    steps = f"{count(schedule.sim_steps(config)[-1])} {real_rows(config)}"
    if config.task.terms:
        names = ", ".join(term.name for term in terms.of(config.task).every())
        tail += f"\nwith terms of {config.task.terms}: {names}"
    return (
        f"trains {what}{seeds}{over}, rollouts of {r.horizon} rows, {tail}\n"
        f"{run.num_iterations} iterations, {steps}"
    )


def of_little_effect(config, names: Iterable[str]) -> str:
    """A line on fields among `names` that decide little or nothing as `config` is; "" if there are none."""
    names, notes = list(names), []
    of_tail = [name for name in names if name in OF_TAIL or name.startswith("model.")]
    if of_tail and not schedule.uses_model(config):
        does = "changes" if len(of_tail) == 1 else "change"
        notes.append(
            f"no row is written by the model, so {', '.join(of_tail)} {does} nothing; train a variant "
            "with a tail, such as best, or set schedule.end_steps"
        )
    if config.ppo.adaptive and "ppo.learning_rate" in names:
        notes.append(
            "ppo.learning_rate decides little: the KL changes it at every minibatch (ppo.adaptive is True), "
            "and after an iteration or two it is what ppo.desired_kl makes of it; set or sweep that, or "
            "--config.ppo.adaptive=False too"
        )
    idle = [] if config.ppo.adaptive else [name for name in names if name in OF_ADAPTIVE]
    if idle:
        notes.append(
            f"ppo.adaptive is False, so {', '.join(idle)} changes nothing; set ppo.learning_rate"
        )
    return ". ".join(notes)


def real_rows(config) -> str:
    """What `sim_steps` counts."""
    return "entries of the log, seen again and again" if config.run.logs else "simulator steps"


def count(steps: int) -> str:
    """A number of steps, in words."""
    return f"{steps / 1e6:.2f} M" if steps >= 1e5 else f"{steps:,}"


def unusual(out, text: str) -> None:
    """Print a line on something that a user may not expect."""
    out.print(text, style="yellow", markup=False, soft_wrap=True)


@contextlib.contextmanager
def live(out, config, given: Mapping[str, str] | None = None, runs: int = 1) -> Iterator[Callbacks]:
    """A line on the console `out` that follows a training of `runs` runs at once; yields its callbacks.

    `given` has the texts of fields that the user has set, for commands that are proposed. Where `out` is no
    terminal, some lines instead. It ends with the `with`, or at the callback `finished`.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    total, begun, printed = config.run.num_iterations, [], 0
    engine, program = "", None
    compiles = f"({COMPILING[_engine(config)]})"
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(16),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("{task.fields[line]}"),
        TimeRemainingColumn(),
        console=out,
        disable=not out.is_terminal,
    )
    task = bar.add_task(f"compiling {compiles}", total=total, line="")
    say = partial(unusual, out)

    def opened():
        if slow := on_a_cpu(config, given or {}):
            say(slow)
        if not out.is_terminal:
            out.print(f"compiles for {devices.ENGINES[_engine(config)]} {compiles}", soft_wrap=True)
        shown.enter_context(bar)

    def compiled(made):
        nonlocal engine, program
        program, engine = made, devices.ENGINES[made.impl]
        describe_program(out, config, program)
        bar.update(task, description="training")

    def progress(iteration, last):
        # of several runs: one clock, and the steps of all
        begun.append((float(last[0]["seconds"]), sum(float(one["sim_steps"]) for one in last)))
        numbers = {name: [one[name] for one in last] for name in last[0]}
        where = "of the log" if config.run.logs else f"on {engine}"  # no simulator runs
        line = f"{progress_line(numbers, begun)} {where}"
        bar.update(task, completed=iteration, line=line)
        nonlocal printed
        part = PARTS * iteration // total
        if not out.is_terminal and part > printed:
            printed = part
            out.print(f"iteration {iteration:4d}  {line}", soft_wrap=True)

    def finishing():
        text = at_the_end(config, program, runs)
        bar.update(task, description=text or "writing")
        if text and not out.is_terminal:
            out.print(text, soft_wrap=True)

    def finished(*_):
        bar.update(task, description="trained")
        shown.close()

    with contextlib.ExitStack() as shown:
        yield Callbacks(say, opened, compiled, progress, finishing, finished)


def describe_program(out, config, program: Program) -> None:
    """What was compiled, and what would be faster."""
    out.print(
        f"{program.device}, {devices.ENGINES[program.impl]}; compiled in {program.compile_seconds:.0f} s, "
        f"{memory.text(program.bytes_needed)} of memory",
        soft_wrap=True,
    )
    for note in filter(None, (f(program, config) for f in (build.engine_note, build.spawn_note))):
        unusual(out, note)


def at_the_end(config, program: Program | None, runs: int = 1) -> str:
    """What is done when all iterations of `runs` runs are, and how much of it; "" if nothing is."""
    run, does, each = config.run, [], f" of each of {runs} runs" * (runs > 1)
    if run.eval_envs:
        steps = run.eval_steps or config.task.episode_length
        seeds = f" of each of {run.num_seeds} seeds" if run.num_seeds > 1 else ""
        does.append(f"evaluates {run.eval_envs} episodes of {steps} control steps{seeds}{each}")
        if program:
            does[0] += f" on {devices.ENGINES[program.evaluated_on]}"
            does[0] += "" if program.ready() else ", which compiles first (on a CPU a while)"
    if run.video_seconds and _drawn(config):
        does.append(f"films {run.video_seconds:g} s{each}")
    return "; then ".join(does)


def _engine(config) -> str:
    """A key of `devices.ENGINES`, before anything is built."""
    mujoco = config.robot or config.env.startswith("playground:")
    return devices.engine(config) if mujoco else "own"


def _drawn(config) -> bool:
    """Whether there are films: of all but an environment of your own."""
    return bool(config.robot or config.env)


def on_a_cpu(config, given: Mapping[str, str]) -> str:
    """A line on what would be trained on a CPU, where that is slow: MJX, and brax; else "".

    The command that it proposes has the user's terms, and what is `given` of the task.
    """
    engine = _engine(config)
    if devices.local(config.run.device).platform != "cpu" or engine not in ("jax", "own"):
        return ""
    none = "there is no GPU here, so this will be slow; " if config.run.device == "auto" else ""
    if not config.robot:
        known = {
            "playground": "MJX compiles for minutes",
            "brax": "brax's physics compile for a minute or more",
            "": "",
        }
        if physics := known[config.env.partition(":")[0]]:
            small = f"; a small run: {SMALL}" * (config.rollout.num_envs > 64)
            return f"{none}on a CPU {physics}{small}"
        return ""
    slow = f"{none}on a CPU MJX compiles for minutes, and C MuJoCo is more than twice as fast: "
    slow += "--config.physics.impl=c"
    if config.task.terrain == "rough":
        return f"{slow}; {rough_on_a_cpu(config.robot)}"
    own = [f"--config.{name}={text}" for name, text in given.items() if name.startswith("task.")]
    own = [word for word in own if not word.startswith("--config.task.terms=")]
    laptop = shell.line("train", f"--config={config.robot}:laptop", *terms.flag(config), *own)
    return f"{slow}; made for a CPU: {laptop}"


def rough_on_a_cpu(robot: str) -> str:
    """Words on rough ground without a GPU: `:laptop` is another task, and no variant of this one is made."""
    ready = f"{robot}_rough"
    play = f"; a trained policy: {shell.line('play', ready, '--out=walk.html')}"
    return (
        "no variant of rough ground is made for a CPU: in 22 minutes of two cores a Go2 learned slopes and "
        "low stairs down, none up (docs/terrain.md)"
    ) + play * (ready in files.bundled())


def progress_line(last: dict, begun: list) -> str:
    """Return, episode length, tracking error, policy std and pace of one iteration."""
    (t0, s0), (t1, s1) = begun[max(0, len(begun) - 6)], begun[-1]
    pace = (s1 - s0) / (t1 - t0) if t1 > t0 else s1 / max(t1, 1e-9)
    mean = {name: float(np.mean(value)) for name, value in last.items()}
    error = f"error {mean['velocity_error']:.2f} m/s  " if "velocity_error" in mean else ""
    text = (
        f"return {mean['episode_return']:6.2f}  length {mean['episode_length']:4.0f}  {error}"
        f"std {mean['policy_std']:.2f}  {pace / 1e3:.1f} k steps/s"
    )
    return text.replace("nan", " - ")


def summary(out, config, workdir: Path, summary: dict[str, Any]) -> None:
    """The final table, where things are, and what to try next."""
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
        f"return (last {min(config.run.num_iterations, log.RETURN_ROWS)} iterations)": mean(
            summary["return"]
        ),
        "best return": mean(summary["return_max"]),
        "simulator steps": f"{count(summary['sim_steps'])} on {devices.ENGINES[summary['impl']]}",
        "training": f"{took}, after {summary['compile_seconds']:.0f} s of set-up",
    }
    after = {"evaluation": "evaluation_seconds", "film": "video_seconds"}
    if known := [f"{n} {summary[key]:.1f} s" for n, key in after.items() if key in summary]:
        rows["after training"] = ", ".join(known)
    if config.task.terrain == "rough" and "length" in summary.get("evaluation", {}):
        rows["evaluation: length"] = mean(summary["evaluation"]["length"], " control steps")
        rows["evaluation: length"] += ", until a fall, its tile's edge or the time"
    where = [f"{one['engine']} on {one['device']}" for one in summary.get("origins", [])]
    where = [one for one, _ in itertools.groupby(where)]  # origins may differ in their commit alone
    if len(where) > 1:
        rows["computed by"] = ", then ".join(where)
    if summary.get("blowups", 0) >= blowups.SOME:
        rows["physics blew up"] = f"in {summary['blowups']:.0%} of the rows"
    if config.run.eval_steps and config.run.eval_envs and config.robot:
        dt = config.physics.substeps * config.physics.timestep
        steps = config.task.episode_length, config.run.eval_steps
        rows["episodes"] = "{:g} s in training, {:g} s in the evaluation".format(
            *(dt * n for n in steps)
        )
    none = walks.unmeasured(walks.evaluated_seconds(config))
    for name, label, unit in (
        ("crossed", "evaluation: tiles crossed", " %"),
        ("return", "evaluation: return", ""),
        ("fall_rate", "evaluation: episodes with a fall", " %"),
        ("tracking_error", "evaluation: tracking error", " m/s"),
        ("yaw_error", "evaluation: yaw rate error", " rad/s"),
    ):
        if name in summary.get("evaluation", {}):
            scale = 100 if unit == " %" else 1
            value = summary["evaluation"][name]
            rows[label] = mean(value, unit, scale, none)
    words = walks.in_words(config, summary.get("evaluation", {}))
    rows |= {"the policy": words} if words else {}
    if config.run.logs:
        del rows["simulator steps"]
    for label, value in rows.items():
        table.add_row(label, value)
    out.print(table)
    say = partial(out.print, markup=False, soft_wrap=True)  # names may have brackets
    names = "metrics.csv, summary.json, policy.npz, checkpoints/"
    say(f"written to {workdir}: {names}")
    if "curves" in summary:
        say(str(summary["curves"]))
    if "video" in summary:
        say(str(summary["video"]))
    if not _drawn(config):
        text = (
            f"no film, no play: it is no robot; policy_file.load_actor('{workdir}/policy.npz') acts"
        )
        return say(text)
    if see := how_to_see(config, workdir, summary):
        say(see)
    if not config.robot:
        return None
    short = config.run.num_iterations < 200  # `:laptop` is longer
    small = short or summary["impl"] == "c"
    task = config.task
    # of which `best` is a larger run: the state, on flat ground
    same = not task.terms and (task.terrain, task.observation, task.history) == ("flat", "full", 1)
    if small and same:
        cpu = devices.local(config.run.device).platform == "cpu"
        say(_next(config, workdir, cpu and short))


def _next(config, workdir: Path, on_cpu: bool) -> str:
    """The line with the command for a larger run: a shorter `:laptop` goes on, any other is a new one."""
    name, where = config.robot + ":laptop" * on_cpu, "made for a CPU" if on_cpu else "on a GPU"
    # a robot without a config of its name; fields of `run` that do not fit a longer one
    with contextlib.suppress(config_lib.ConfigError):
        larger = config_lib.validate(config_lib.load(name))
        same = all(config[one] == larger[one] for one in config if one != "run")
        if on_cpu and same and larger.run.num_iterations > config.run.num_iterations:
            longer = {one: larger.run[one] for one in ("num_iterations", "log_every")}
            further = fields.copied(config)
            further.run.update(longer)
            config_lib.validate(further)
            words = [f"--config.run.{one}={value}" for one, value in longer.items()]
            return f"next: {shell.line('train', f'--workdir={workdir}', *words)}  (goes on with this one)"
    folder = free = Path("runs") / name.replace(":", "-")
    for number in itertools.count(2):
        if not free.exists():
            break
        free = folder.with_name(f"{folder.name}-{number}")
    words = [f"--config={name}", *[f"--workdir={free}"] * (free != folder)]
    return f"next: {shell.line('train', *words)}  ({where})"


def how_to_see(config, workdir: Path, summary: dict[str, Any]) -> str:
    """The line with the command that plays a policy of a run; "" where its film has failed as that would."""
    if not summary.get("playable", True):
        return ""
    return f"see it: {shell.line('play', workdir, *terms.flag(config), '--out=walk.html')}"

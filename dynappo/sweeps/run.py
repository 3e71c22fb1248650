"""All combinations of a sweep, one group after the other, told to a person."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from dynappo.config import ConfigError, shell
from dynappo.program import build, devices, distributed, environment, memory
from dynappo.sweeps import folder, grid, picture, table
from dynappo.sweeps.grid import Combination
from dynappo.train import run as run_lib
from dynappo.train import show

GOES_ON = "the same command goes on with the sweep"


class Sweep(NamedTuple):
    """What a command line with --sweep asks for."""

    swept: dict[str, list[str]]  # texts by field
    config: Any  # before values are set; not validated
    combinations: list[Combination]


def train_and_show(
    asked: Sweep, workdir: Path, fresh: bool, source: Path | None, get_env: Any, stop
) -> None:
    """Train every combination, and print the table; `stop` is `train.command.Stop`.

    Everything is checked before anything is written. FloatingPointError at the end where a combination blew
    up.
    """
    from rich.console import Console

    if distributed.several():
        raise ConfigError(
            "--sweep runs in one process, of one machine; give each process a --sweep of its own, with "
            "another --workdir"
        )
    out = Console(highlight=False)
    combinations, swept = _with_environments(asked.combinations, get_env), list(asked.swept)
    _check(combinations)
    held = (asked.config, asked.swept, combinations, source, fresh)
    _check_source(source, combinations)
    with folder.opened(workdir, *held) as source:
        _check_source(source, [c for c in combinations if not folder.reached(workdir, c)])
        _describe(out, workdir, combinations)
        while todo := _todo(workdir, combinations):
            done = [folder.reached(workdir, one) for one in todo]
            group = grid.groups(todo, done)[0]
            _train_group(out, group, len(todo), workdir, source, stop)
            table.write(workdir / "sweep.csv", table.rows(workdir, combinations))
            if stop.status:
                at = max(folder.reached(workdir, one) for one in group)
                text = f"saved at iteration {at} and stopped" if at else "stopped"
                print(f"dynappo: {text}; {afterwards(fresh)}", file=sys.stderr)
                return
        _show(out, workdir, combinations, swept)
    lost = [one.name for one in combinations if folder.blown_up(workdir, one)]
    if lost:
        raise FloatingPointError(
            f"{len(lost)} of {len(combinations)} combinations blew up; {workdir / lost[0] / folder.BLOWN_UP} "
            "says where; to try one again, remove its folder and give the same command"
        )


def afterwards(fresh: bool) -> str:
    """What the same command will do with what a stopped one has left."""
    return GOES_ON.replace("command", "command without --fresh") if fresh else GOES_ON


def _with_environments(combinations: list[Combination], get_env) -> list[Combination]:
    """The combinations with the environment that a config's file may define."""
    found = []
    for one in combinations:
        config, env = environment.from_file(get_env, one.config)
        found.append(one._replace(config=config, env=env))
    return found


def _check(combinations: list[Combination]) -> None:
    """ConfigError where this machine or the robot's file cannot run one of them, or those of a program."""
    for one in combinations:
        try:
            run_lib.check(one.config, one.env)
        except ConfigError as error:
            raise ConfigError(f"--sweep: {error} (the combination {one.name})") from None
    for group in grid.groups(combinations, [0] * len(combinations)):
        try:
            build.check(grid.whole(group), group[0].env)
        except ConfigError as error:
            raise grid.too_many(error, group) from None


def _check_source(source: Path | None, combinations: list[Combination]) -> None:
    """ConfigError where one of them cannot start from the networks of `source`."""
    from dynappo.train import restore  # not above: it starts JAX

    if source:
        for one in combinations:
            restore.check(source, one.config)


def _todo(workdir: Path, combinations: list[Combination]) -> list[Combination]:
    """The combinations that have neither ended nor blown up."""
    return [
        one
        for one in combinations
        if not folder.summary(workdir, one) and not folder.blown_up(workdir, one)
    ]


def _describe(out, workdir: Path, combinations: list[Combination]) -> None:
    """What will happen."""
    todo, count = _todo(workdir, combinations), len(combinations)
    programs = len(grid.groups(todo, [folder.reached(workdir, one) for one in todo]))
    has = f", {count - len(todo)} are done" if len(todo) < count else ""
    ask = f"{programs} program{'s' * (programs != 1)} to compile{has}"
    out.print(f"[bold]dynappo[/bold] sweeps {count} combinations: {ask}", soft_wrap=True)
    if todo:
        out.print(f"the first {show.describe(todo[0].config)}", soft_wrap=True, markup=False)


def _train_group(out, group: list[Combination], todo: int, workdir, source, stop) -> None:
    """`together.train`, with a live line."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from dynappo.sweeps import together  # not above: it starts JAX

    total = group[0].config.run.num_iterations
    names = ", ".join(one.name for one in group[:4]) + ", ..." * (len(group) > 4)
    rest = f" of {todo} to do" if todo > len(group) else ""
    out.print(f"{len(group)}{rest}, at once: {names}", soft_wrap=True, markup=False)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(16),
        TextColumn("{task.completed}/{task.total}"),
        TextColumn("{task.fields[line]}"),
        TimeRemainingColumn(),
        console=out,
        disable=not out.is_terminal,
    )
    task = bar.add_task("compiling", total=total, line="")

    def begin(program) -> Callable[[int, dict], None]:
        engine, begun = devices.ENGINES[program.impl], []
        text = f"{program.device}, {engine}; compiled in {program.compile_seconds:.0f} s, "
        out.print(text + f"{memory.text(program.bytes_needed)} of memory", soft_wrap=True)
        if slow := build.slower(program, group[0].config):
            out.print(slow, style="yellow", markup=False, soft_wrap=True)
        stop.patient = True

        def tell(iteration, last):
            begun.append((float(last["seconds"][0]), float(last["sim_steps"].sum())))
            line = f"{show.progress_line(last, begun)} on {engine}"
            bar.update(task, completed=iteration, line=line, description="training")
            if not out.is_terminal and (10 * iteration) % total < 10:
                out.print(f"iteration {iteration:4d}  {line}", soft_wrap=True)
            if iteration == total:
                stop.patient = False
                bar.update(task, line="", description="evaluating, filming")

        return tell

    def say(text):
        out.print(text, style="yellow", markup=False, soft_wrap=True)

    with bar:
        together.train(group, workdir, source, begin, lambda: bool(stop.status), say)
    stop.patient = False


def _show(out, workdir: Path, combinations: list[Combination], swept: list[str]) -> None:
    """The table, the picture, and where the best is."""
    rows = table.rows(workdir, combinations)
    table.write(workdir / "sweep.csv", rows)
    problem = picture.draw(workdir, rows, swept)
    table.print_table(out, rows, swept)
    if rows[0]["return_high"] is not None:
        out.print("±: Student's 95 % interval of the mean over seeds", soft_wrap=True)
    out.print(f"written to {workdir}: sweep.csv, a run's folder for each", soft_wrap=True)
    out.print(problem or str(workdir / "sweep.png"), soft_wrap=True, markup=False)
    if rows[0]["note"]:
        return
    best = workdir / rows[0]["folder"]
    shutil.copyfile(best / "policy.npz", workdir / "policy.npz")
    out.print(f"best: {best}, its policy is {workdir}/policy.npz too", soft_wrap=True, markup=False)
    if combinations[0].config.robot:
        text = f"see it: {shell.program()} play {workdir} --out=walk.html"
        out.print(text, soft_wrap=True, markup=False)

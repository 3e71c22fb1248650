"""Trains all combinations of a sweep, one group after the other, and reports to the user."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from dynappo.config import ConfigError, files
from dynappo.config.stop import Stop
from dynappo.program import build, distributed, environment
from dynappo.run import merged, show, training
from dynappo.sweeps import folder, grid, sweep_picture, table
from dynappo.sweeps.grid import Combination


class Sweep(NamedTuple):
    """What a command line with --sweep asks for."""

    swept: dict[str, list[str]]  # texts by field
    config: Any  # before values are set; not validated
    combinations: list[Combination]


def train_all(
    out, sweep: Sweep, workdir: Path, fresh: bool, source: Path | None, get_env: Any, stop: Stop
) -> str:
    """Train every combination, and print the table on the console `out`.

    Returns "", or, if `stop` interrupted it, a line on what was saved. Everything is checked before anything
    is written. FloatingPointError at the end if a combination blew up.
    """
    if distributed.several():
        raise ConfigError(
            "--sweep runs in one process, of one machine; give each process a --sweep of its own, with "
            "another --workdir"
        )
    combinations = [_with_environment(one, get_env) for one in sweep.combinations]
    _check(combinations, source)
    held = (sweep.config, sweep.swept, combinations, source, fresh)
    with folder.opened(workdir, *held) as source:
        for run in _runs(workdir, combinations, source):
            training.check_source(run)
        _describe(out, workdir, combinations)
        while todo := _todo(workdir, combinations):
            done = [folder.iterations_saved(workdir, one) for one in todo]
            group = grid.groups(todo, done)[0]
            _train_group(out, group, len(todo), workdir, source, stop)
            table.write(workdir / "sweep.csv", table.rows(workdir, combinations))
            if stop.status:
                at = max(folder.iterations_saved(workdir, one) for one in group)
                return f"saved at iteration {at} and stopped" if at else "stopped"
        _show(out, workdir, combinations, list(sweep.swept))
    lost = [one.name for one in combinations if folder.blown_up(workdir, one)]
    if lost:
        raise FloatingPointError(
            f"{len(lost)} of {len(combinations)} combinations blew up; {workdir / lost[0] / folder.BLOWN_UP} "
            "says where; to try one again, remove its folder and give the same command"
        )
    return ""


def _with_environment(one: Combination, get_env) -> Combination:
    """The combination with the environment that the config's file may define."""
    config, env = environment.from_file(get_env, one.config)
    return one._replace(config=config, env=env)


def _runs(
    workdir: Path, combinations: list[Combination], source: Path | None
) -> list[training.Run]:
    """The combinations as runs; one that has a checkpoint resumes, and needs no source."""
    sources = [None if folder.iterations_saved(workdir, one) else source for one in combinations]
    return [
        training.Run(one.config, workdir / one.name, one.env, of)
        for one, of in zip(combinations, sources, strict=True)
    ]


def _check(combinations: list[Combination], source: Path | None) -> None:
    """ConfigError if one of them cannot be trained (`training.check`), or those of a program not at once."""
    for one in combinations:
        try:
            training.check(training.Run(one.config, env=one.env, source=source))
        except ConfigError as error:
            raise ConfigError(f"--sweep: {error} (the combination {one.name})") from None
    for group in grid.groups(combinations, [0] * len(combinations)):
        configs = [one.config for one in group]
        try:
            build.check(merged.config(configs), group[0].env)
        except ConfigError as error:
            raise merged.too_many(error, configs) from None


def _todo(workdir: Path, combinations: list[Combination]) -> list[Combination]:
    """The combinations that have neither ended nor blown up."""
    return [
        one
        for one in combinations
        if not folder.summary(workdir, one) and not folder.blown_up(workdir, one)
    ]


def _describe(out, workdir: Path, combinations: list[Combination]) -> None:
    """Print what will happen."""
    todo, count = _todo(workdir, combinations), len(combinations)
    programs = len(grid.groups(todo, [folder.iterations_saved(workdir, one) for one in todo]))
    apart = programs > len(grid.groups(todo, [0] * len(todo)))
    has = f", {count - len(todo)} are done" if len(todo) < count else ""
    ask = f"{programs} program{'s' * (programs != 1)} to compile{has}"
    out.print(f"[bold]dynappo[/bold] sweeps {count} combinations: {ask}", soft_wrap=True)
    if apart:
        show.unusual(
            out,
            "some have come further than others of their program: each part goes on in a program of its own, "
            "so their last digits may be others than without the stop",
        )
    notes = (show.of_little_effect(one.config, one.values) for one in todo)
    for note in dict.fromkeys(filter(None, notes)):
        show.unusual(out, note)
    if todo:
        out.print(f"the first {show.describe(todo[0].config)}", soft_wrap=True, markup=False)


def _train_group(out, group: list[Combination], todo: int, workdir, source, stop: Stop) -> None:
    """Train the combinations of a group in one program."""
    names = ", ".join(one.name for one in group[:4]) + ", ..." * (len(group) > 4)
    rest = f" of {todo} to do" if todo > len(group) else ""
    out.print(f"{len(group)}{rest}, at once: {names}", soft_wrap=True, markup=False)
    with show.live(out, group[0].config, runs=len(group)) as callbacks:
        own = callbacks._replace(
            finished=training.nothing, blown_up=partial(_leave_blown_up, callbacks.say)
        )
        training.train_together(_runs(workdir, group, source), own, stop)


def _leave_blown_up(say, run: training.OpenRun, iteration: int, error: FloatingPointError) -> None:
    """Report a combination that blew up, also by a file in its folder, so that it is not trained again."""
    assert run.workdir
    say(f"{run.workdir.name}: {error}; the other combinations go on")
    about = {"iteration": iteration, "problem": str(error)}
    files.write_json(run.workdir / folder.BLOWN_UP, about)


def _show(out, workdir: Path, combinations: list[Combination], swept: list[str]) -> None:
    """Show the table, the picture, and where the best policy is."""
    rows = table.rows(workdir, combinations)
    table.write(workdir / "sweep.csv", rows)
    problem = sweep_picture.draw(workdir, rows, swept)
    table.print_table(out, rows, swept)
    if why := table.ranking(rows[0]["ranked_by"], swept):
        show.unusual(out, why)
    if rows[0]["return_high"] is not None:
        out.print("±: Student's 95 % interval of the mean over seeds", soft_wrap=True)
    out.print(f"written to {workdir}: sweep.csv, a run's folder for each", soft_wrap=True)
    out.print(problem or str(workdir / "sweep.png"), soft_wrap=True, markup=False)
    if rows[0]["note"] or not rows[0]["ranked_by"]:
        (workdir / "policy.npz").unlink(missing_ok=True)  # of a sweep before values were added
        return
    best = workdir / rows[0]["folder"]
    with files.replacing(workdir / "policy.npz") as part:
        shutil.copyfile(best / "policy.npz", part)
    doubt = table.doubt(rows)
    if doubt:
        show.unusual(out, doubt)
    rank = "first" if doubt else "best"
    out.print(
        f"{rank}: {best}, its policy is {workdir}/policy.npz too", soft_wrap=True, markup=False
    )
    config, summary = combinations[0].config, json.loads((best / "summary.json").read_bytes())
    if config.robot and (see := show.how_to_see(config, workdir, summary)):
        out.print(see, soft_wrap=True, markup=False)

"""What a run writes while it trains: metrics.csv, TensorBoard's events, Weights & Biases (host side).

metrics.csv has one row for each iteration; with several seeds, one for each iteration and seed
(column `seed`). Columns are in the order of `FIRST`, then every other metric by name. The other
logs get the same rows.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo.config import ConfigError, files, shell
from dynappo.run import worth

RETURN_ROWS = 10  # the return of a run is the mean of its last rows
FIRST = (
    "iteration sim_steps seconds episode_return episode_length policy_std learning_rate kl "
    "n_real n_synthetic model_loss velocity_error yaw_error falls timeouts blowups"
).split()

LONGEST = 40  # characters of a number
RESULTS = "policy.npz", "summary.json", "curves.png", "video.mp4"  # of a run, beside its rows
SHARED = ("iteration", "sim_steps", "seconds", "n_real", "n_synthetic")


def rows(metrics: dict[str, np.ndarray]) -> list[dict[str, float]]:
    """Metrics `[I]`, or `[I, S]` of S seeds, as one dict an iteration (and seed), columns in order."""
    names = [n for n in FIRST if n in metrics] + sorted(n for n in metrics if n not in FIRST)
    iterations = len(metrics["iteration"])
    seeds = max((m.shape[1] for m in metrics.values() if m.ndim == 2), default=0)
    out = []
    for i in range(iterations):
        for s in range(max(seeds, 1)):
            row = {n: metrics[n][i, s] if metrics[n].ndim == 2 else metrics[n][i] for n in names}
            out.append(row | {"seed": s} if seeds else row)
    return out


def at_the_end(values: np.ndarray) -> np.ndarray:
    """Means of the last `RETURN_ROWS` rows of `values` [I, ...], of those that are numbers: where no episode
    ended in an iteration its return is none. NaN where none is."""
    last = values[-RETURN_ROWS:]
    known = np.isfinite(last)
    total, count = np.where(known, last, 0.0).sum(0), known.sum(0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


class Sink(NamedTuple):
    """Something that takes the rows of every chunk."""

    name: str
    write: Callable[[list[dict]], None]
    close: Callable[[], Any]


@contextlib.contextmanager
def opened(config, workdir: Path, start: int, say):
    """metrics.csv, and what `run.tensorboard` and `run.wandb` ask for; `start` iterations are done."""
    sinks = [csv_sink(workdir / "metrics.csv")]
    if config.run.tensorboard:
        sinks.append(tensorboard_sink(workdir, start))
    if config.run.wandb:
        sinks.append(wandb_sink(config, workdir))
    try:
        yield sinks
    finally:
        for sink in sinks:
            attempt(sink.name, sink.close, say)


def csv_sink(path: Path) -> Sink:
    """Appends to metrics.csv; rows that could not be written are tried again with the next, or at the end."""
    waiting: list[dict] = []

    def write(table):
        waiting.extend(table)
        append_csv(path, waiting)
        waiting.clear()

    return Sink("metrics.csv", write, lambda: write([]) if waiting else None)


def tensorboard_sink(workdir: Path, start: int) -> Sink:
    """Scalars of every row, one event for each row; deletes those after `start`, of a killed run.

    Not tensorboardX's SummaryWriter: its thread dies of a full disk and then waits for ever. After a
    failure it begins a new file, because readers stop at a record that is cut off.
    """
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto.event_pb2 import Event, SessionLog
    from tensorboardX.proto.summary_pb2 import Summary

    files: list[EventsWriter] = []
    waiting: list[dict] = []

    def write(table):
        waiting.extend(table)
        try:
            if not files:
                files.append(EventsWriter(str(workdir / "events")))
                if start:
                    status = SessionLog(status=SessionLog.START)
                    files[0].write_event(Event(step=start + 1, session_log=status))
            for row in waiting:
                values = [Summary.Value(tag=t, simple_value=v) for t, v in scalars(row)]
                event = Event(wall_time=time.time(), step=int(row["iteration"]))
                event.summary.value.extend(values)
                files[0].write_event(event)
            files[0].flush()
        except OSError:
            files.clear()
            raise
        waiting.clear()

    return Sink("TensorBoard's events", write, lambda: [file.close() for file in files])


def wandb_run(config, workdir: Path) -> Any:
    """A run of the project `run.wandb`; the run of a workdir goes on under the same id."""
    check_wandb(config)
    import wandb  # pyright: ignore[reportMissingImports]

    path = workdir / "wandb_id"
    if not path.exists():
        path.write_text(os.urandom(4).hex())
    return wandb.init(
        project=config.run.wandb,
        name=workdir.name,
        id=path.read_text().strip(),
        resume="allow",
        dir=str(workdir),
        config=config.to_dict(),
    )


def wandb_sink(config, workdir: Path) -> Sink:
    """Scalars of every row, a step a row."""
    run = wandb_run(config, workdir)

    def write(table):
        for row in table:
            run.log(dict(scalars(row)), step=int(row["iteration"]))

    return Sink("Weights & Biases", write, run.finish)


def check_wandb(config) -> None:
    """ConfigError if `run.wandb` asks for what is not installed."""
    import importlib.util

    if config.run.wandb and importlib.util.find_spec("wandb") is None:
        raise ConfigError(
            f"run.wandb is {config.run.wandb!r}, but wandb is not installed; "
            f"{shell.install('wandb')}, or leave run.wandb empty"
        )


def scalars(row: dict):
    """`(tag, value)` of a row's finite numbers: reward terms and evaluation in groups of their own."""
    seed = f"/seed{row['seed']}" if "seed" in row else ""
    for name, value in row.items():
        if name in ("iteration", "seed") or not np.isfinite(value):
            continue
        group, _, rest = name.partition("_")
        tag = f"{group}/{rest}" if group in ("reward", "eval", "model") else f"train/{name}"
        yield tag + seed, float(value)


def append_csv(path: Path, table: list[dict]) -> None:
    """Append rows, with a header if the file is new; empty where a number is not yet defined.

    If a column is new, the file is written anew with it. What cannot be written whole (a full disk)
    is taken back.
    """
    names, old = list(dict.fromkeys(name for row in table for name in row)), []
    if path.exists():
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            header = list(reader.fieldnames or [])
            more = [name for name in names if name not in header]
            old = list(reader) if more else []
        names = header + more
        if not old and not more:
            return _append(path, names, table, header=False)
    with files.replacing(path) as part:
        _append(part, names, old + table, header=True)


def _append(path: Path, names, table, header: bool) -> None:
    size = path.stat().st_size if path.exists() else 0
    try:
        with path.open("a", newline="") as file:
            writer = csv.DictWriter(file, names, restval="", lineterminator="\n")
            if header:
                writer.writeheader()
            writer.writerows({k: _number(v) for k, v in row.items()} for row in table)
    except OSError:
        os.truncate(path, size)
        raise


def _number(value):
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    return "" if np.isnan(value) else f"{float(value):.6g}"


def resume_csv(
    path: Path, scheduled: dict[str, np.ndarray], seeds: int, say
) -> dict[str, np.ndarray]:
    """Cut metrics.csv to the iterations that a checkpoint covers, and return their metrics.

    `scheduled` has the columns that follow from the schedule, of these iterations. A row that is missing, or
    holds something other than numbers, is replaced by these and empty cells; then the file as it was is kept
    as `metrics.csv.damaged`, and `say` reports it.
    """
    found, twice = _whole_rows(path)
    if twice:
        say(
            f"{path} has {twice} rows twice, as if two runs had written it; the last of each is kept"
        )
    table, lost = [], []
    for i, iteration in enumerate(scheduled["iteration"]):
        for seed in range(seeds):
            blank = {name: int(column[i]) for name, column in scheduled.items()}
            blank |= {"seed": seed} if seeds > 1 else {}
            table.append(found.get((int(iteration), seed), blank))
            lost += [int(iteration)] if table[-1] is blank else []
    if lost:
        was = "is gone"
        if path.exists():  # copied: if what follows fails, all is as it was
            was = f"is damaged, and kept as {shutil.copyfile(path, _free(path, 'damaged'))}"
        say(
            f"{path} {was}: rows of {len(set(lost))} iterations, from {lost[0]} to {lost[-1]}, are lost and "
            "stay empty; the run itself lacks nothing"
        )
    names = list(dict.fromkeys(name for row in [*found.values(), *table] for name in row))
    with files.replacing(path) as part:
        _append(part, names, table, header=True)
    return read_csv(path, seeds)


def put_aside(path: Path, say) -> None:
    """What a run without a checkpoint has left becomes `metrics.csv.old`, `policy.npz.old`, ...; `say` tells.
    Its policy may be all that is left of a run whose checkpoints were deleted."""
    there = [one for name in (path.name, *RESULTS) if (one := path.with_name(name)).exists()]
    kept = [one.rename(_free(one, "old")).name for one in there]
    if kept:
        say(
            f"there is no checkpoint in {path.parent}: it starts anew; what was there is now "
            f"{', '.join(kept)}"
        )


def _free(path: Path, word: str) -> Path:
    """`PATH.WORD`, or with a number where there is one already."""
    numbers = (f".{n}" if n else "" for n in itertools.count())
    return next(p for n in numbers if not (p := path.with_name(f"{path.name}.{word}{n}")).exists())


def _whole_rows(path: Path) -> tuple[dict[tuple[int, int], dict[str, str]], int]:
    """The rows of a metrics.csv by iteration and seed, as text, only those that are whole; and how many were
    there twice."""
    try:
        text = path.read_bytes().decode(errors="replace").replace("\0", "\ufffd")
    except FileNotFoundError:
        return {}, 0
    lines = [line for line in text.splitlines(keepends=True) if line.endswith("\n")]
    header, *rows = [line.strip("\r\n").split(",") for line in lines] or [[]]
    found, twice = {}, 0
    for cells in rows:
        row = dict(zip(header, cells, strict=False))
        with contextlib.suppress(ValueError):  # a row with a cell that is no number
            numbers = [float(cell or 0) for cell in cells if len(cell) < LONGEST]
            if len(numbers) == len(header) and np.isfinite(numbers).all() and "iteration" in row:
                place = int(row["iteration"]), int(row.get("seed", 0))
                twice += place in found
                found[place] = row
    return found, twice


def read_csv(path: Path, seeds: int = 1) -> dict[str, np.ndarray]:
    """Columns of a metrics.csv, `[I]` or `[I, S]`; NaN where a cell is empty.

    Columns that all seeds share (those the host counts) stay `[I]`.
    """
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        table = list(reader)
    names = reader.fieldnames or []
    columns = {n: np.array([float(row[n] or "nan") for row in table]) for n in names}
    if seeds == 1:
        return columns
    columns = {n: c.reshape(-1, seeds) for n, c in columns.items() if n != "seed"}
    return {n: c[:, 0] if n in SHARED else c for n, c in columns.items()}


def join(history: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The metrics of consecutive chunks as one; NaN where a chunk lacks a column."""
    names = dict.fromkeys(name for chunk in history for name in chunk)
    blank = {n: next(c[n] for c in history if n in c) for n in names}

    def column(chunk, name):
        shape = (len(chunk["iteration"]), *blank[name].shape[1:])
        return chunk[name] if name in chunk else np.full(shape, np.nan)

    return {name: np.concatenate([column(c, name) for c in history]) for name in names}


def last_evaluation(metrics: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the last evaluation says of the policy's worth (`worth.MEASURES`): numbers, or arrays `[S]` of
    several seeds; {} if there was none."""
    found = {n: metrics[f"eval_{n}"] for n in worth.MEASURES if f"eval_{n}" in metrics}
    returns = np.atleast_1d(found.get("return", np.nan))
    there = np.isfinite(returns.reshape(len(returns), -1)).any(1)
    return {name: column[there][-1] for name, column in found.items()} if there.any() else {}


def attempt(what: str, action: Callable[[], Any], say, then: str = "training goes on") -> None:
    """Call `action`; if it fails, report it to `say` in one line and go on."""
    try:
        action()
    except Exception as error:  # OSError, or what orbax makes of it
        say(f"{what} could not be written ({reason(error)}); {then}")


def reason(error: Exception) -> str:
    """Why something could not be written, in a few words."""
    code = errno_of(error)
    return os.strerror(code) if code else str(error).strip().split("\n")[0][:160]


def errno_of(error: Exception) -> int | None:
    """The errno of an OSError, or of the one that tensorstore quotes; None if there is none."""
    code = getattr(error, "errno", None)
    found = re.search(r"(?:os_error_code='|OS error )(\d+)", str(error))
    return code if code is not None or not found else int(found[1])


def of_the_machine(error: Exception) -> bool:
    """Whether the machine (a disk, memory) is the cause, and not what was to be written."""
    return isinstance(error, (OSError, MemoryError)) or errno_of(error) is not None

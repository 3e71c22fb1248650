"""What a run writes: metrics.csv, config.json, summary.json (host side, plain files).

metrics.csv has one row an iteration, and one an iteration and seed (column `seed`) where several
seeds train at once. Columns in the order of `FIRST`, then every other metric by name.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

FIRST = (
    "iteration sim_steps seconds episode_return episode_length policy_std learning_rate kl "
    "n_real n_synthetic model_loss velocity_error yaw_error falls timeouts blowups"
).split()

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


def append_csv(path: Path, table: list[dict]) -> None:
    """Append rows, with a header if the file is new; empty where a number is not yet defined."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(table[0]), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows({k: _number(v) for k, v in row.items()} for row in table)


def _number(value):
    if isinstance(value, (int, np.integer)):
        return int(value)
    return "" if np.isnan(value) else f"{float(value):.6g}"


def cut_csv(path: Path, iteration: int) -> None:
    """Drop the rows after `iteration`: what a run did after the checkpoint it resumes from."""
    if not path.exists():
        return
    header, *lines = path.read_text().splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]  # the last may be cut off
    kept = [line for line in whole if int(line.split(",")[0]) <= iteration]
    temporary = path.with_suffix(".csv.new")
    temporary.write_text(header + "".join(kept))
    temporary.replace(path)


def read_csv(path: Path, seeds: int = 1) -> dict[str, np.ndarray]:
    """Columns of a metrics.csv, `[I]` or `[I, S]`; NaN where a cell is empty.

    Columns that all seeds share (those the host counts) stay `[I]`.
    """
    with path.open(newline="") as file:
        table = list(csv.DictReader(file))
    columns = {n: np.array([float(row[n] or "nan") for row in table]) for n in table[0]}
    if seeds == 1:
        return columns
    columns = {n: c.reshape(-1, seeds) for n, c in columns.items() if n != "seed"}
    return {n: c[:, 0] if n in SHARED else c for n, c in columns.items()}


def write_json(path: Path, value) -> None:
    """Write whole or not at all."""
    temporary = path.with_suffix(path.suffix + ".new")
    temporary.write_text(json.dumps(value, indent=2) + "\n")
    temporary.replace(path)

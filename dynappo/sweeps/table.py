"""The results of a sweep: a row for each combination, best first; on screen and as sweep.csv."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import files
from dynappo.policy import walks
from dynappo.run import learning_curves, show, worth
from dynappo.sweeps import folder, grid
from dynappo.sweeps.grid import Combination

# what combinations are ranked by beside the return: its number in a row, its column, its unit, and
# how many of these it has
MORE = {
    grid.BY_ERRORS: ("tracking_error", "error", "{:.2f} m/s", 1),
    grid.BY_CROSSED: ("crossed", "crossed", "{:.1f} %", 100),
}


def rows(workdir: Path, combinations: list[Combination]) -> list[dict[str, Any]]:
    """A row for each combination: the best first (`grid.ranked_by`), then those without a number, with a
    `note` that says why; in the order of the grid where they cannot be ranked.

    Returns are evaluated ones, or of training (its last 10 iterations) where `run.eval_envs` is 0.
    """
    by, found = grid.ranked_by(combinations), [row(workdir, one) for one in combinations]
    if by == grid.BY_CROSSED and all(one["crossed"] is None for one in found):
        by = grid.BY_RETURN  # runs of an older version
    found = [one | {"ranked_by": by} for one in found]

    def place(one):
        falls, error = (
            np.inf if one[n] is None else one[n] for n in ("fall_rate", "tracking_error")
        )
        if by == grid.BY_ERRORS:
            return not walks.seldom(falls), error, falls
        measures = {"crossed": one["crossed"]} if by == grid.BY_CROSSED else {}
        measures["return"] = one["return_mean"]
        best = worth.worth({name: np.nan if x is None else x for name, x in measures.items()})
        return tuple(-x for x in best)

    return sorted(found, key=place) if by else sorted(found, key=lambda one: bool(one["note"]))


def row(workdir: Path, one: Combination) -> dict[str, Any]:
    """The row of one combination: its values, its numbers over seeds (None without any), its folder."""
    summary = folder.summary(workdir, one)
    problem = folder.blown_up(workdir, one)
    evaluation = summary.get("evaluation", {})
    returns = np.ravel(evaluation.get("return", summary.get("return", [])))
    mean, low, high = _interval(returns)
    _, error_low, error_high = _interval(np.ravel(evaluation.get("tracking_error", [])))
    crossed, crossed_low, crossed_high = _interval(np.ravel(evaluation.get("crossed", [])))
    at = folder.iterations_saved(workdir, one)
    note = "" if summary else "blew up" if problem else f"at iteration {at}"
    numbers = {
        "return_mean": mean,
        "return_low": low,
        "return_high": high,
        "fall_rate": _mean(evaluation.get("fall_rate")),
        "tracking_error": _mean(evaluation.get("tracking_error")),
        "tracking_error_low": error_low,
        "tracking_error_high": error_high,
        "crossed": crossed,
        "crossed_low": crossed_low,
        "crossed_high": crossed_high,
        "sim_steps": summary.get("sim_steps", np.nan),
        "seconds": _mean(summary.get("seconds")),
    }
    return (
        one.values
        | {"seeds": one.config.run.num_seeds}
        | {name: float(v) if np.isfinite(v) else None for name, v in numbers.items()}
        | {
            "returns": " ".join(f"{np.nan if x is None else x:.6g}" for x in returns),
            "return_of": "evaluation" if "return" in evaluation else "training",
            "policy": walks.in_words(one.config, evaluation) if evaluation else "",
            "walking": walks.walking(one.config, evaluation),  # of its seeds
            "folder": one.name,
            "note": note,
        }
    )


def _interval(values) -> tuple[float, float, float]:
    """`(mean, low, high)` of a number of each seed, Student's 95 %; NaN where it cannot be computed."""
    values = np.array([np.nan if x is None else x for x in values], float)
    if not values.size:
        return np.nan, np.nan, np.nan
    mean, around = float(values.mean()), float(learning_curves.half_width(values))
    return mean, mean - around, mean + around


def _mean(values) -> float:
    """Mean over the seeds that have a number."""
    some = [v for v in np.ravel(values) if v is not None and np.isfinite(v)]
    return float(np.mean(some)) if some else np.nan


def doubt(table: list[dict[str, Any]]) -> str:
    """Lines on what the table does not show: that its first row is better than the others, that any walks.

    Two combinations differ where the intervals over their seeds, of what they are ranked by, do not overlap.
    """
    first, *others = [one for one in table if not one["note"]]
    lines = []
    by = first["ranked_by"]
    name = MORE[by][0] if by in MORE else "return"
    said = by if by == grid.BY_CROSSED else name.replace("_", " ")
    if by == grid.BY_ERRORS:  # those that fall too often are behind, whatever their errors are
        seldom = walks.seldom(first["fall_rate"])
        others = [one for one in others if walks.seldom(one["fall_rate"]) == seldom]
    if by == grid.BY_CROSSED:
        others = [one for one in others if one["crossed"] is not None]
    low, high = f"{name}_low", f"{name}_high"
    spread = [one for one in (first, *others) if one[low] is not None]
    if others and len(spread) <= len(others):
        lines.append("no difference can be seen: it takes two seeds of each, or more")
    elif close := sum(one[low] <= first[high] and first[low] <= one[high] for one in spread[1:]):
        which = "the second" if len(others) == 1 else f"{close} of the {len(others)} others"
        lines.append(
            f"no difference can be seen between the first and {which}: the 95 % intervals of the "
            f"{said} overlap"
        )
    if lines:
        lines[0] += (
            f"; for more seeds: another --workdir with --config.run.num_seeds={2 * max(first['seeds'], 2)}"
        )
    known = [one["walking"] for one in table if one["walking"] is not None]
    if known and not any(known):
        lines.append("no seed walks yet, so even the first is not good enough")
    return "\n".join(lines)


def write(path: Path, table: list[dict[str, Any]]) -> None:
    """The rows as a CSV, whole or not at all; empty where there is no number."""
    with files.replacing(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
        writer.writeheader()
        for one in table:
            writer.writerow({k: f"{v:.6g}" if type(v) is float else v for k, v in one.items()})


def print_table(out, table: list[dict[str, Any]], swept: list[str]) -> None:
    """Print the rows as a table. On a narrow console what the policies do is a line each, below it."""
    page = _page(table, swept, "the policy" if any(one["policy"] for one in table) else "")
    if out.measure(page, options=out.options.update(width=1000)).maximum <= out.width:
        return out.print(page)
    out.print(_page(table, swept, ""))
    for one in table:
        if one["policy"]:
            values = ", ".join(str(one[field]) for field in swept)
            out.print(f"{values}: {one['policy']}", markup=False, soft_wrap=True)


def _page(table: list[dict[str, Any]], swept: list[str], words: str):
    """The table; without a column for what the policies do where that has no name in `words`."""
    from rich.table import Table

    page = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    evaluated = all(one["return_of"] == "evaluation" for one in table if not one["note"])
    last = [field.rpartition(".")[2] for field in swept]
    for field, name in zip(swept, last, strict=True):  # a long name breaks, and is not cut
        page.add_column(name if last.count(name) == 1 else field, overflow="fold")
    names = ["seeds", "evaluated return" if evaluated else "return", "falls", "steps", "seconds"]
    by = table[0]["ranked_by"]
    names[3:3] = [MORE[by][1]] if by in MORE else []
    for name in names:
        page.add_column(name, justify="right", no_wrap=True)
    if words:
        page.add_column(words if evaluated else "", overflow="fold")
    for i, one in enumerate(table):
        best = i == 0 and by and not one["note"]
        cells = [*(str(one[field]) for field in swept), *_cells(one)]
        page.add_row(*cells[: len(page.columns)], style="bold" if best else "")
    return page


def ranking(by: str, swept: list[str]) -> str:
    """Why the combinations of a sweep are not ranked by their return; "" where they are."""
    if by == grid.BY_RETURN:
        return ""
    names = ", ".join(swept)
    if by == grid.BY_CROSSED:
        return f"ranked by {by}: on rough ground a return is less the sooner a robot is across its tile"
    if by:
        return f"ranked by {by}: {names} changes the reward, so the returns are not of one scale"
    return (
        f"not ranked: {names} may change what is measured, so neither returns nor errors are of one scale; "
        "dynappo evaluate tells what each does, in its own task"
    )


def _cells(one: dict[str, Any]) -> list[str]:
    """Seeds, return with its interval, falls, perhaps the tracking error or the share of tiles crossed,
    simulator steps, seconds, what the policies do."""
    by = one["ranked_by"]
    if one["note"]:
        return [str(one["seeds"]), one["note"], *[""] * (4 + (by in MORE))]
    more = []
    if by in MORE:
        name, _, written, scale = MORE[by]
        more = ["" if one[name] is None else written.format(scale * one[name])]
    mean, high, falls = one["return_mean"], one["return_high"], one["fall_rate"]
    text = "no episode ended" if mean is None else f"{mean:.2f}"
    return [
        str(one["seeds"]),
        text if high is None else f"{text} ± {high - mean:.2f}",
        "" if falls is None else f"{100 * falls:.1f} %",
        *more,
        show.count(int(one["sim_steps"])),
        "" if one["seconds"] is None else f"{one['seconds']:.1f}",
        one["policy"],
    ]

"""Tables (Table II, loss, errors, claims) and figures 5 and 6 of the robots in results/.

python experiments/11_model/plot.py
"""

from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from experiments import paper, pictures, stats

LOSSES = ("model_loss", "model_loss_before")
STEPS = (1, 2, 4, 8, 16)
SHADES = (*pictures.SHADES[:0:-1], pictures.VERMILION)
AT = (5, 10, 50, 100, 200, 500)  # iterations of the table
LOSS_AT = (1, 2, 3, 5, 10, 30, 50, 100, 150, 200, 300, 400, 500)
LATE = (10, 200)  # from where on the loss is nearly constant, or is not
COLUMNS = "robot group steps iteration rmse_mean rmse_sd share_of_spread_mean status".split()


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    paper.write(out / "settings.csv", settings())
    losses, errors = (
        {robot: load(out / "results" / robot / f"{name}.csv") for robot in paper.ROBOTS}
        for name in ("loss", "errors")
    )
    rows = [row for robot in paper.ROBOTS for row in build(robot, errors[robot])]
    paper.write(out / "results.csv", rows)
    paper.show([r for r in rows if r.get("steps") in (None, 1, 4, 16)], COLUMNS)
    paper.write(out / "loss.csv", [row for r in paper.ROBOTS for row in fits(r, losses[r])])
    paper.write(out / "claims.csv", [row for r in paper.ROBOTS for row in claims(r, errors[r])])
    draw_loss(measured(losses), out / "loss")
    draw_errors(measured(errors), out / "errors")


def measured(tables: dict[str, dict]) -> dict[str, dict]:
    """Robot -> its columns, of robots that have some; Go1's, which are none, if no robot has."""
    return {robot: table for robot, table in tables.items() if table} or {"go1": {}}


def settings() -> list[dict]:
    """Table II beside configs/go1.py:dyna4."""
    model = config_lib.load("configs/go1.py:dyna4").model
    ours = {
        "predictive_network": f"MLP{list(model.hidden)}",
        "learning_rate": model.learning_rate,
        "epochs_per_iteration": model.epochs,
    }
    theirs = {row["setting"]: row["value"] for row in paper.table("model_config")}
    return [{"setting": name, "ours": ours[name], "paper": theirs[name]} for name in theirs]


def load(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV as flat arrays; {} if it is not there."""
    rows = paper.rows(path)
    return {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}


def build(robot: str, errors) -> list[dict]:
    """A row a group, number of predictions and iteration: rmse in the group's unit, and its share of the
    spread over robots."""
    if not errors:
        return [{"robot": robot, "group": "all", "status": "not run"}]
    rows, last = [], int(errors["iteration"].max())
    for group in dict.fromkeys(errors["group"].tolist()):
        for k in STEPS:
            for iteration in sorted({*AT, last} & set(errors["iteration"].astype(int).tolist())):
                at = (errors["iteration"] == iteration) & where(errors, group, k)
                rmse, spread = errors["rmse"][at], errors["spread"][at]
                row = {"robot": robot, "group": group, "steps": k, "iteration": iteration}
                row |= {"seeds": len(rmse)} | stats.spread("rmse", rmse)
                rows.append(row | stats.spread("share_of_spread", rmse / spread))
    return rows


def fits(robot: str, losses) -> list[dict]:
    """A row an iteration of `LOSS_AT`: the loss in the first and the last minibatch of its fit; then the
    lowest and the highest mean over seeds from some iterations on."""
    if not losses:
        return [{"robot": robot, "status": "not run"}]
    rows, everywhere = [], np.ones(len(losses["iteration"]), bool)
    iterations, before = curve(losses, "model_loss_before", everywhere)
    after = curve(losses, "model_loss", everywhere)[1]
    wanted = [("", i) for i in np.flatnonzero(np.isin(iterations, LOSS_AT))]
    for first in LATE:
        late = np.flatnonzero(iterations >= first)
        if len(late):
            means = before[late].mean(1)
            wanted += [(f"lowest from {first}", late[means.argmin()])]
            wanted += [(f"highest from {first}", late[means.argmax()])]
    for which, i in wanted:
        row = {"robot": robot, "which": which, "iteration": int(iterations[i])}
        row |= {"seeds": before.shape[1]} | stats.spread("before", before[i])
        row |= stats.spread("after", after[i])
        rows.append(row | stats.spread("before_by_after", before[i] / after[i]))
    return rows


def claims(robot: str, errors) -> list[dict]:
    """A row a group and number of predictions: do errors fall, and do they grow with the steps?

    Ratios are of one run's own errors, so one a seed. They fall, or grow, if the 95 % t interval of the
    mean ratio lies below, or above, 1.
    """
    if not errors:
        return [{"robot": robot, "status": "not run"}]
    rows, first, last = [], errors["iteration"].min(), errors["iteration"].max()
    for group in dict.fromkeys(errors["group"].tolist()):
        whole = [curve(errors, "rmse", where(errors, group, k)) for k in STEPS]
        (iterations, one), longest = whole[0], np.array([values for _, values in whole]).mean(-1)
        grows = (np.diff(longest, axis=0) > 0).all(0)  # [I] with every doubling, mean over seeds
        for k, (_, values) in zip(STEPS, whole, strict=True):
            row = {"robot": robot, "group": group, "steps": k, "seeds": values.shape[1]}
            for iteration in sorted({100, last} & set(iterations)):
                some = values[iterations == iteration][0] / values[iterations == first][0]
                row |= stats.spread(f"at_{iteration:g}_by_first", some)
            row |= stats.spread("by_one_step", (values / one)[-1])
            row |= {"grows_at": int(grows.sum()), "of": len(grows)}
            rows.append(row)
    return rows


def where(errors, group: str, k: int) -> np.ndarray:
    """Rows of a group and number of predictions."""
    return (errors["group"] == group) & (errors["steps"] == k)


def curve(columns, name: str, at) -> tuple[np.ndarray, np.ndarray]:
    """`(iterations [I], values [I, S])` of the rows `at`."""
    iteration, seeds = columns["iteration"][at], len(set(columns["seed"].tolist()))
    order = np.lexsort((columns["seed"][at], iteration))
    return np.unique(iteration), columns[name][at][order].reshape(-1, seeds)


def seeds_of(tables) -> list[int]:
    """How many seeds each robot has."""
    return [len(set(table["seed"].tolist())) for table in tables.values() if table]


def draw_loss(losses, path: Path) -> None:
    """Figure 5: the loss before and after each fit, over iterations, a panel a robot."""
    page, axes = pictures.figure(1, len(losses), 3.8 if len(losses) == 1 else 3.2, sharey=True)
    looks = (
        ("last minibatch of the fit", pictures.BLUE, "-"),
        ("first minibatch: rows not seen before", pictures.VERMILION, (0, (3, 1.2))),
    )
    for axis, (robot, table) in zip(axes[0], losses.items(), strict=True):
        axis.set_xlabel("iteration")
        axis.set_title(paper.ROBOTS[robot], loc="left")
        if not table:
            pictures.missing(axis)
            continue
        everywhere = np.ones(len(table["iteration"]), bool)
        for name, (label, colour, dash) in zip(LOSSES, looks, strict=True):
            values = curve(table, name, everywhere)
            pictures.band(axis, *values, colour, label, most=500, dash=dash)
        pictures.log(axis, (1, 1.5, 2, 3, 4, 6, 8))
        axis.set_xscale("log")  # the drop takes five iterations of 500
        axis.set_xticks(
            ticks := [i for i in (1, 3, 10, 30, 100, 500) if i <= max(table["iteration"])]
        )
        axis.set_xticklabels(f"{tick}" for tick in ticks)
        axis.minorticks_off()
    axes[0, 0].set_ylabel("Huber loss of the model")
    text = (
        "Fig. 5: loss of the transition model, in units of its targets. Both axes are logarithmic"
    )
    if seeds := seeds_of(losses):
        text += f"\nBand: {pictures.covers(seeds)}"
    pictures.head(page, text)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def draw_errors(errors, path: Path) -> None:
    """Figure 6: error of k predictions in a row over iterations, a column a robot, a row a group."""
    first = next(iter(errors.values()))
    groups = list(dict.fromkeys(first["group"].tolist())) if first else [""]
    page, axes = pictures.figure(len(groups), len(errors), 9.6, sharex=True, sharey="row")
    for row, group in zip(axes, groups, strict=True):
        some = [(axis, table) for axis, table in zip(row, errors.values(), strict=True) if table]
        if lowest := [lines(axis, table, group) for axis, table in some]:
            row[0].set_ylim(bottom=0.6 * min(lowest))
        row[0].set_ylabel(group.replace(" ", "\n", 1))
    for column, (robot, table) in zip(axes.T, errors.items(), strict=True):
        if not table:
            pictures.missing(column[0])
        column[0].set_title(paper.ROBOTS[robot], loc="left")
        column[-1].set_xlabel("iteration")
    text = "Fig. 6: root mean square error of predictions in a row, rows not seen before"
    if seeds := seeds_of(errors):
        text += f"\nBands, of 1 and 16 steps: {pictures.covers(seeds)}"
    pictures.head(page, text)
    pictures.legend(page, axes[0, 0], 6)
    pictures.save(page, path)


def lines(axis, errors, group: str) -> float:
    """A panel: a line a number of predictions, and the spread over robots. Gives the lowest number."""
    lowest = np.inf
    for k, colour in zip(STEPS, SHADES, strict=True):
        label = f"{k} step" + "s" * (k > 1)
        dash = "-" if k < 16 else (0, (4, 1.2))
        x, values = curve(errors, "rmse", where(errors, group, k))
        if k in (STEPS[0], STEPS[-1]):  # five bands would hide each other
            pictures.band(axis, x, values, colour, label, dash=dash)
        else:
            axis.plot(x, values.mean(1), color=colour, linewidth=1.6, label=label)
        lowest = min(lowest, values.mean(1).min())
    x, spread = curve(errors, "spread", where(errors, group, 1))
    style = dict(color="0.4", linestyle=":", linewidth=1.4, label="spread over robots")
    axis.plot(x, spread.mean(1), **style)
    pictures.log(axis)
    axis.set_xlim(0, None)
    return lowest


if __name__ == "__main__":
    main()

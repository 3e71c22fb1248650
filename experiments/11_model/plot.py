"""settings.csv (Table II), results.csv, and figures 5 and 6 of what run.py wrote into results/.

python experiments/11_model/plot.py
"""

import csv
from pathlib import Path

import numpy as np

from dynappo import config as config_lib
from experiments import paper, pictures, stats

LOSSES = ("model_loss", "model_loss_before")
STEPS = (1, 2, 4, 8, 16)
SHADES = (*pictures.SHADES[:0:-1], pictures.VERMILION)
AT = (10, 50, 100, 200, 500)  # iterations of the table
COLUMNS = "group steps iteration rmse_mean rmse_sd share_of_spread_mean status".split()


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    paper.write(out / "settings.csv", settings())
    losses, errors = load(out / "results" / "loss.csv"), load(out / "results" / "errors.csv")
    rows = build(errors)
    paper.write(out / "results.csv", rows)
    paper.show([r for r in rows if r.get("steps") in (None, 1, 4, 16)], COLUMNS)
    draw_loss(losses, out / "loss")
    draw_errors(errors, out / "errors")


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
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    out = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return {n: c if n == "group" else c.astype(float) for n, c in out.items()}


def build(errors) -> list[dict]:
    """A row a group, number of predictions and iteration: rmse in the group's unit, and its share of the
    spread over robots."""
    if not errors:
        return [{"group": "all", "status": "not run"}]
    rows, last = [], int(errors["iteration"].max())
    for group in dict.fromkeys(errors["group"].tolist()):
        for k in STEPS:
            for iteration in sorted({*AT, last} & set(errors["iteration"].astype(int).tolist())):
                at = (errors["iteration"] == iteration) & (errors["steps"] == k)
                at &= errors["group"] == group
                rmse, spread = errors["rmse"][at], errors["spread"][at]
                row = {"group": group, "steps": k, "iteration": iteration}
                row |= stats.spread("rmse", rmse) | stats.spread("share_of_spread", rmse / spread)
                rows.append(row)
    return rows


def curve(columns, name: str, where) -> tuple[np.ndarray, np.ndarray]:
    """`(iterations [I], values [I, S])` of the rows `where`."""
    iteration, seeds = columns["iteration"][where], len(set(columns["seed"].tolist()))
    order = np.lexsort((columns["seed"][where], iteration))
    return np.unique(iteration), columns[name][where][order].reshape(-1, seeds)


def draw_loss(losses, path: Path) -> None:
    """Figure 5: the loss before and after each fit, over iterations."""
    page, ((axis,),) = pictures.figure(1, 1, 3.8)
    if losses:
        everywhere = np.ones(len(losses["iteration"]), bool)
        looks = (
            ("last minibatch of the fit", pictures.BLUE, "-"),
            ("first minibatch: rows not seen before", pictures.VERMILION, (0, (3, 1.2))),
        )
        for name, (label, colour, dash) in zip(LOSSES, looks, strict=True):
            values = curve(losses, name, everywhere)
            pictures.band(axis, *values, colour, label, most=250, dash=dash)
        pictures.log(axis, (1, 2, 3, 4, 5, 6, 8))
        seeds = [len(set(losses["seed"].tolist()))]
        axis.legend(title=f"band: {pictures.covers(seeds)}", alignment="left", frameon=False)
    else:
        pictures.missing(axis)
    axis.set(xlabel="iteration", xlim=(0, None))
    axis.set_ylabel("Huber loss of the model\n(normalised targets, logarithmic)")
    axis.set_title("Fig. 5: loss of the transition model, Go1", loc="left")
    pictures.save(page, path)


def draw_errors(errors, path: Path) -> None:
    """Figure 6: error of k predictions in a row over iterations, a panel a group."""
    groups = list(dict.fromkeys(errors["group"].tolist())) if errors else [""] * 6
    page, axes = pictures.figure(2, 3, 5.8)
    for axis, group in zip(axes.flat, groups, strict=True):
        axis.set_title(group, loc="left")
        if axis in axes[1]:
            axis.set_xlabel("iteration")
        if not errors:
            pictures.missing(axis)
            continue
        lowest = np.inf
        for k, colour in zip(STEPS, SHADES, strict=True):
            where = (errors["group"] == group) & (errors["steps"] == k)
            label = f"{k} step" + "s" * (k > 1)
            dash = "-" if k < 16 else (0, (4, 1.2))
            x, values = curve(errors, "rmse", where)
            if k in (STEPS[0], STEPS[-1]):  # five bands would hide each other
                pictures.band(axis, x, values, colour, label, dash=dash)
            else:
                axis.plot(x, values.mean(1), color=colour, linewidth=1.6, label=label)
            lowest = min(lowest, values.mean(1).min())
        x, spread = curve(errors, "spread", (errors["group"] == group) & (errors["steps"] == 1))
        style = dict(color="0.4", linestyle=":", linewidth=1.4, label="spread over robots")
        axis.plot(x, spread.mean(1), **style)
        pictures.log(axis)
        axis.set(xlim=(0, None), ylim=(0.6 * lowest, None))
    text = "Fig. 6: root mean square error of predictions in a row, Go1, rows not seen before"
    if errors:
        text += (
            f"\nBands, of 1 and 16 steps: {pictures.covers([len(set(errors['seed'].tolist()))])}"
        )
    pictures.head(page, text)
    pictures.legend(page, axes[0, 0], 6)
    pictures.save(page, path)


if __name__ == "__main__":
    main()

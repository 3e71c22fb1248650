"""results.csv, tests.csv and figures (figure 9, as numbers; one a speed) of the robots in results/."""

from pathlib import Path

import numpy as np

from experiments import paper, pictures, stats

VARIANTS, SPEEDS = ("ppo16", "dyna4"), (0.5, 1.0)
MEASURES = {
    "walks": "share that\nwalks",
    "tracking_error": "tracking error\n(m/s)",
    "air_time": "air time of a\nswing (s)",
    "tilt": "tilt of the base\n(degrees, rms)",
}
OF_A_GAIT = ("air_time", "tilt", "swings_per_second")  # of seeds that walk: a stumble has no gait
# differences that do not matter: a tenth of the lower speed; a control step; as one can see it
MARGINS = {"tracking_error": 0.05, "air_time": 0.02, "tilt": 1.0}
COLUMNS = (
    "robot variant speed iteration status seeds walk falls tracking_error_mean air_time_mean tilt_mean"
).split()


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    every = {name: load(out / "results" / name / "episodes.csv") for name in paper.ROBOTS}
    rows = [row for robot, episodes in every.items() for row in build(robot, episodes)]
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)
    paper.write(out / "tests.csv", tests(every))
    found = {robot: some for robot, some in every.items() if some} or {"go1": []}
    for speed, name in zip(SPEEDS, ("measures_slow", "measures"), strict=True):
        draw(found, speed, out / name)


def load(path: Path) -> list[dict]:
    """Rows of episodes.csv, and `walks`, 1.0 or 0.0; [] if it is not there.

    Seeds that walk do not fall, and go ahead with at least half of the speed that they are asked for:
    that can be compared between robots, whose returns cannot. One that falls within the first second
    has no tracking error: it counts as one that stands still, as means would leave it out in silence.
    """
    rows = [{n: np.nan if v is None else v for n, v in row.items()} for row in paper.rows(path)]
    for row in rows:
        if np.isnan(row["tracking_error"]):
            row |= {"tracking_error": row["speed"], "speed_ahead": 0.0}
        row["walks"] = float(np.isnan(row["fall"]) and row["speed_ahead"] >= 0.5 * row["speed"])
    return rows


def at(episodes, variant: str, speed: float, iteration: float) -> list[dict]:
    """Episodes of one variant, speed and iteration, one a seed."""
    wanted = (variant, speed, iteration)
    return [e for e in episodes if (e["variant"], e["speed"], e["iteration"]) == wanted]


def numbers(episodes, name: str) -> list[float]:
    """A number a seed; of `OF_A_GAIT` NaN where it does not walk."""
    return [e[name] if e["walks"] or name not in OF_A_GAIT else np.nan for e in episodes]


def build(robot: str, episodes) -> list[dict]:
    """A row a variant, speed and iteration: mean, deviation and interval over seeds."""
    rows = []
    for variant in VARIANTS:
        for speed in SPEEDS:
            row = {"robot": robot, "variant": variant, "speed": speed}
            row["status"] = "" if episodes else "not run"
            rows += [] if episodes else [row]
            for iteration in sorted({e["iteration"] for e in episodes}):
                some = at(episodes, variant, speed, iteration)
                cells = row | {"iteration": int(iteration), "seeds": len(some)}
                cells["falls"] = sum(np.isfinite(e["fall"]) for e in some)
                cells["walk"] = round(sum(e["walks"] for e in some))
                for name in ("tracking_error", "speed_ahead", *OF_A_GAIT, "yaw_error", "distance"):
                    cells |= stats.spread(name, numbers(some, name))
                rows.append(cells)
    return rows


def tests(every) -> list[dict]:
    """The tail less PPO-16, a row a measure, robot, speed and iteration; then who walks first.

    Welch's tests and intervals; Holm's p is over all comparisons of a measure. The last rows compare
    the first checkpoint at which each seed walks, by ranks: one that never walks comes last.
    """
    rows, cells = [], [(r, some, speed) for r, some in every.items() if some for speed in SPEEDS]
    for name, margin in MARGINS.items():
        family = []
        for robot, some, speed in cells:
            for iteration in sorted({e["iteration"] for e in some}):
                base, tail = (numbers(at(some, v, speed, iteration), name) for v in VARIANTS)
                row = {"measure": name, "robot": robot, "speed": speed, "iteration": int(iteration)}
                for variant, values in zip(VARIANTS, (base, tail), strict=True):
                    row[f"{variant}_mean"], _, row[f"{variant}_seeds"] = stats.moments(values)
                row["margin"] = margin
                family.append(row | stats.compare(tail, base, margin))
        stats.correct(family)
        for row in family:
            row["verdict"] = row["verdict"] if np.isfinite(row["p"]) else "too few seeds"
        rows += family
    first = [walkers(some, robot, speed) for robot, some, speed in cells]
    stats.adjust(first, "p")
    for row in first:
        row["verdict"] = "differs" if row["p_holm"] < stats.ALPHA else "not shown"
    return rows + first


def walkers(episodes, robot: str, speed: float) -> dict:
    """When each seed of both methods first walks, and p of the rank sum test."""
    both = []
    for variant in VARIANTS:
        some = [e for e in episodes if (e["variant"], e["speed"]) == (variant, speed)]
        when = [
            [e["iteration"] for e in some if e["seed"] == s and e["walks"]] for s in seeds(some)
        ]
        both.append([min(found, default=np.nan) for found in when])
    row = {"measure": "first_walk", "robot": robot, "speed": speed, "p": stats.rank_sum(*both)}
    for variant, values in zip(VARIANTS, both, strict=True):
        row[f"{variant}_mean"], _, row[f"{variant}_seeds"] = stats.moments(values)
        row[f"{variant}_first"] = " ".join(f"{x:g}" for x in sorted(values))
    return row


def seeds(episodes) -> list[float]:
    """Of some episodes."""
    return sorted({e["seed"] for e in episodes})


def draw(every, speed: float, path: Path) -> None:
    """The measures at one speed over iterations, a column a robot."""
    page, axes = pictures.figure(len(MEASURES), len(every), 7.6, sharex=True, sharey="row")
    for column, (robot, episodes) in zip(axes.T, every.items(), strict=True):
        for axis, name in zip(column, MEASURES, strict=True):
            if episodes:
                panel(axis, episodes, speed, name)
            else:
                pictures.missing(axis)
        column[0].set_title(paper.ROBOTS[robot], loc="left")
        column[-1].set_xlabel("iteration")
    for axis, label in zip(axes[:, 0], MEASURES.values(), strict=True):
        axis.set(ylabel=label, ylim=(0, None))
    if counts := sorted({len(seeds(some)) for some in every.values() if some}):
        counted = " or ".join(map(str, counts))
        text = f"Asked for {speed} m/s. Small marks: each of {counted} seeds. Lines: their mean, of air time "
        text += "and tilt that of seeds that walk"
        pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def panel(axis, episodes, speed: float, name: str) -> None:
    """A measure of one robot: every seed, and their mean."""
    every = np.array(sorted({e["iteration"] for e in episodes}))
    apart = 0.12 * np.diff(every).min()  # side by side
    for variant, aside in zip(VARIANTS, (-apart, apart), strict=True):
        columns = [numbers(at(episodes, variant, speed, i), name) for i in every]
        style = pictures.mark(variant)
        dots = () if name == "walks" else zip(every + aside, columns, strict=True)
        for place, values in dots:
            axis.plot([place] * len(values), values, ls="", alpha=0.4, ms=3, mew=0, **style)
        mean = [stats.moments(values).mean for values in columns]
        style |= dict(linewidth=1.7, markersize=5, label=paper.VARIANTS[variant])
        axis.plot(every + aside, mean, **style)
    axis.set_xticks([i for i in every if i % 200 == 0] or every)


if __name__ == "__main__":
    main()

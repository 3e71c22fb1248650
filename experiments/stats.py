"""Statistics of means over seeds: every table and picture of the experiments takes them from here.

A seed is one number, so five seeds are five numbers. They are taken as independent and roughly normal,
with a variance of their own in each setting. Seeds are not paired here: MuJoCo Warp is not deterministic.
Where equal seeds are alike all the same, as in five jobs of 13_step_time (in 30_row_cost they are not), these
intervals are wider than they need be.

**Seeds that never reach a level are counted, never dropped in silence.** Means of steps are of the seeds
that get there, beside how many do. A share of PPO-16's steps counts a seed that does not with all steps
of its run, which is less than it needs: so the share says "at least" or "at most". `rank_sum` takes "never"
as later than anything.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import special, stats

from dynappo.policy import walks
from dynappo.run import learning_curves

LEVEL = 0.95
ALPHA = 1 - LEVEL
# a difference of return that does not matter: about 2 % of the best possible (45 and 30)
MARGIN = {"go1": 1.0, "go2": 1.0, "anymal_c": 0.7, "anymal_d": 0.7}
COMPARED = "difference difference_low difference_high p p_holm p_equal p_equal_holm verdict".split()


class Moments(NamedTuple):
    """Of a sample: its mean, its sample standard deviation, how many numbers."""

    mean: float
    sd: float
    n: int


class Around(NamedTuple):
    """An estimate and its 95 % interval."""

    value: float
    low: float
    high: float


NOTHING = Around(math.nan, math.nan, math.nan)


def moments(values) -> Moments:
    """Of the numbers that are finite; NaN where there are too few. Moments stay what they are."""
    if isinstance(values, Moments):
        return values
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    n = len(values)
    mean = float(values.mean()) if n else math.nan
    return Moments(mean, float(values.std(ddof=1)) if n > 1 else math.nan, n)


def half_of(one: Moments) -> float:
    """Half of Student's 95 % interval of a mean that is known by its moments: of printed tables."""
    return float(special.stdtrit(one.n - 1, 0.5 + LEVEL / 2) * one.sd / math.sqrt(one.n))


def spread(prefix: str, values) -> dict[str, Any]:
    """Cells: mean, sample standard deviation and Student's 95 % interval of the mean over seeds.

    mean +- t(0.975, n - 1) sd / sqrt(n), of the seeds that have a number (`dynappo.run.learning_curves`).
    """
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    low, high = learning_curves.interval(values)
    mean, sd, _ = moments(values)
    cells = {"mean": mean, "sd": sd, "low": float(low), "high": float(high)}
    return {f"{prefix}_{name}": value for name, value in cells.items()}


def _error(one: Moments, other: Moments) -> tuple[float, float]:
    """Standard error of a difference of means, and Welch's degrees of freedom (Welch 1947).

    se^2 = a + b, df = (a + b)^2 / (a^2 / (n - 1) + b^2 / (m - 1)), a = sd^2 / n, b = sd_^2 / m.
    """
    if min(one.n, other.n) < 2 or not one.sd + other.sd > 0:
        return math.nan, math.nan
    a, b = one.sd**2 / one.n, other.sd**2 / other.n
    return math.sqrt(a + b), (a + b) ** 2 / (a**2 / (one.n - 1) + b**2 / (other.n - 1))


def welch(one, other) -> tuple[float, float, float]:
    """Welch's test of two means, each `(mean, sample sd, number)`: t, degrees of freedom, p (two-sided)."""
    one, other = Moments(*one), Moments(*other)
    error, df = _error(one, other)
    t = (one.mean - other.mean) / error
    return t, df, float(2 * special.stdtr(df, -abs(t)))


def welch_of(one, other) -> float:
    """p of two lists of numbers, one a seed."""
    return welch(moments(one), moments(other))[2]


def difference(one, other) -> Around:
    """Mean of `one` less that of `other`, lists with a number a seed, and Welch's 95 % interval."""
    one, other = moments(one), moments(other)
    error, df = _error(one, other)
    half, middle = special.stdtrit(df, 0.5 + LEVEL / 2) * error, one.mean - other.mean
    return Around(middle, float(middle - half), float(middle + half))


def spreads(one, other) -> float:
    """p (two-sided) of the F test of two sample variances: small where the deviations differ."""
    one, other = moments(one), moments(other)
    if min(one.n, other.n) < 2 or not min(one.sd, other.sd) > 0:
        return math.nan
    df, times = (one.n - 1, other.n - 1), (one.sd / other.sd) ** 2
    return float(2 * min(special.fdtr(*df, times), special.fdtrc(*df, times)))


def correlation(one, other) -> Around:
    """Pearson's r of pairs, and Fisher's 95 % interval: tanh(artanh r +- 1.96 / sqrt(n - 3)).

    It holds for pairs that are independent; cells of a grid are not quite.
    """
    r = float(np.corrcoef(one, other)[0, 1])
    half = float(special.ndtri(0.5 + LEVEL / 2)) / math.sqrt(len(one) - 3)
    low, high = np.tanh(np.arctanh(r) + np.array([-half, half]))
    return Around(r, float(low), float(high))


def equivalence(one, other, margin: float) -> float:
    """p of two one-sided Welch tests: small where the means are shown to differ by less than `margin`.

    p = max(P(T > (d + margin) / se), P(T < (d - margin) / se)), d the difference of the means. p < 0.05
    exactly where the 90 % interval of d lies within +- margin (Schuirmann 1987; by Welch: Gruman,
    Cribbie and Arpin-Cribbie 2007).
    """
    one, other = moments(one), moments(other)
    error, df = _error(one, other)
    d = one.mean - other.mean
    below = special.stdtr(df, -(d + margin) / error)
    above = special.stdtr(df, (d - margin) / error)
    return float(np.maximum(below, above))


def holm(p) -> np.ndarray:
    """Adjusted p values of a family of tests; a NaN is no test.

    The k-th smallest of m becomes max over j <= k of min(1, (m - j + 1) p_j). Rejecting those below
    alpha errs at all with probability alpha at most, whatever the tests' dependence (Holm 1979).
    """
    p = np.asarray(p, float)
    order = np.argsort(p)[: np.isfinite(p).sum()]  # NaN sorts last
    out = np.full(len(p), np.nan)
    times = np.arange(len(order), 0, -1)
    out[order] = np.minimum(1, np.maximum.accumulate(times * p[order]))
    return out


def ratio(one, other) -> Around:
    """Mean of `one` by that of `other`, and Fieller's 95 % interval without equal variances.

    All r with (x - r y)^2 <= t^2 (a + r^2 b), a and b the squared standard errors of the means x and y
    (Fieller 1954), t with Welch's degrees of freedom at r = x / y (Tamhane and Logan 2004). NaN as
    ends where y is not shown to be different from 0.
    """
    one, other = moments(one), moments(other)
    x, y = one.mean, other.mean
    middle = x / y
    error, df = _error(one, other._replace(sd=abs(middle) * other.sd))
    if not error > 0:
        return Around(middle, math.nan, math.nan)
    t = float(special.stdtrit(df, 0.5 + LEVEL / 2))
    a, b = one.sd**2 / one.n, other.sd**2 / other.n
    square, rest = y**2 - t**2 * b, x**2 - t**2 * a
    if square <= 0:
        return Around(middle, math.nan, math.nan)
    root = math.sqrt(max(0.0, (x * y) ** 2 - square * rest))
    return Around(middle, (x * y - root) / square, (x * y + root) / square)


def share(one, other, most: float, most_other: float) -> dict[str, Any]:
    """Cells: steps of `one` in per cent of `other`'s, NaN for a seed that never gets there.

    With such seeds it has no interval, and `bound` says "at least" or "at most": they count with
    `most`, all that their run had. Nothing where both have some, or none gets there.
    """
    some, others = np.asarray(one, float), np.asarray(other, float)
    gone, gone_ = np.isnan(some), np.isnan(others)
    if gone.all() or gone_.all() or (gone.any() and gone_.any()):
        return {}
    found = ratio(np.where(gone, most, some), np.where(gone_, most_other, others))
    cells: dict[str, Any] = {"pct": 100 * found.value}
    if gone.any() or gone_.any():
        return cells | {"bound": "at least" if gone.any() else "at most"}
    return cells | {"low": 100 * found.low, "high": 100 * found.high}


def rank_sum(one, other) -> float:
    """p (two-sided) of Mann and Whitney's test, exact by all regroupings; NaN means never, so last."""
    pair = [np.nan_to_num(np.asarray(x, float), nan=np.inf) for x in (one, other)]
    if min(map(len, pair)) < 2:
        return math.nan
    ranks = stats.rankdata(np.concatenate(pair))
    n, total = len(pair[0]), len(ranks)
    # counts[k]: sum of k ranks -> in how many ways
    counts: list[dict[float, int]] = [{0.0: 1}, *({} for _ in range(n))]
    for rank in ranks:
        for k in range(n, 0, -1):
            for before, times in counts[k - 1].items():
                counts[k][before + rank] = counts[k].get(before + rank, 0) + times
    sums = np.array(list(counts[n]))
    weights = np.array(list(counts[n].values()), float)
    middle = n * (total + 1) / 2
    far = np.abs(sums - middle) >= abs(ranks[:n].sum() - middle) - 1e-9
    return float(weights[far].sum() / weights.sum())


def compare(one, base, margin: float, prefix: str = "") -> dict[str, Any]:
    """Cells `PREFIX` + name of one comparison of returns with a base: see `COMPARED`; `correct` fills the
    rest in."""
    found, p = difference(one, base), welch_of(one, base)
    cells = {"difference": found.value, "difference_low": found.low, "difference_high": found.high}
    cells |= {"p": p, "p_equal": equivalence(one, base, margin)}
    return {f"{prefix}{name}": value for name, value in cells.items()}


def adjust(rows: list[dict[str, Any]], name: str) -> None:
    """To the rows that have a p called `name`: Holm's over all of them, as NAME_holm."""
    rows = [row for row in rows if name in row]
    for row, p in zip(rows, holm([row[name] for row in rows]), strict=True):
        row[f"{name}_holm"] = float(p)


def correct(rows: list[dict[str, Any]], prefix: str = "") -> None:
    """To rows with `compare`'s cells, named `PREFIX` + name: Holm's p over all of them, and verdicts."""
    rows = [row for row in rows if f"{prefix}p" in row]
    for name in ("p", "p_equal"):
        adjust(rows, f"{prefix}{name}")
    for row in rows:
        differs, equal = (row[f"{prefix}{name}_holm"] < ALPHA for name in ("p", "p_equal"))
        way = "higher" if row[f"{prefix}difference"] > 0 else "lower"
        unequal, alike = (way, f"{way}, within the margin") if differs else ("not shown", "equal")
        row[f"{prefix}verdict"] = alike if equal else unequal


# ---- when a robot walks (dynappo/policy/walks.py)


class Reached(NamedTuple):
    """How many `steps` each seed took, `[...]`; NaN: never."""

    walks: np.ndarray  # from there on at every evaluation: at the level, falls at most 1 %
    level: np.ndarray  # first at the level, whatever came after
    careful: np.ndarray  # first at the level with falls at most 1 %, whatever came after


def reached(steps, returns, fall_rates, least: float, most: float = walks.MOST_FALLS) -> Reached:
    """When each seed walks, by its evaluations `[E, ...]` in order; `steps` is `[E]` or `[E, ...]`.

    `least` is the `level`, `most` the share of episodes with a fall. At an evaluation with a NaN
    the robot does not walk. ValueError where the shapes differ.
    """
    return _reached(steps, returns, walks.at(returns, least), fall_rates, most)


def reached_by_tracking(
    steps, errors, yaw_errors, fall_rates, most: float = walks.MOST_FALLS
) -> Reached:
    """As `reached`, with the level of errors: m/s and rad/s of evaluations `[E, ...]`."""
    if np.shape(errors) != np.shape(yaw_errors):
        shapes = f"errors {np.shape(errors)}, yaw errors {np.shape(yaw_errors)}"
        raise ValueError(f"{shapes}: expected one shape [evaluations, seeds]")
    return _reached(steps, errors, walks.tracks(errors, yaw_errors), fall_rates, most)


def _reached(steps, numbers, level, fall_rates, most: float) -> Reached:
    """`Reached`, where `level` says which evaluations are at the level."""
    numbers, fall_rates = np.asarray(numbers, float), np.asarray(fall_rates, float)
    steps = np.asarray(steps, float)
    if numbers.shape != fall_rates.shape or steps.shape not in (numbers.shape, numbers.shape[:1]):
        raise ValueError(
            f"steps {steps.shape}, evaluations {numbers.shape}, fall rates {fall_rates.shape}: "
            "expected one shape [evaluations, seeds]"
        )
    seeds = (1,) * (numbers.ndim - steps.ndim)
    steps = np.broadcast_to(steps.reshape(steps.shape + seeds), numbers.shape)
    holding = level & walks.seldom(fall_rates, most)
    kept = np.logical_and.accumulate(holding[::-1])[::-1]
    return Reached(*(_first(steps, true) for true in (kept, level, holding)))


def _first(steps: np.ndarray, true: np.ndarray) -> np.ndarray:
    """`steps` at the first True of `true` `[E, ...]`; NaN without one."""
    if not len(true):
        return np.full(true.shape[1:], np.nan)
    found = np.take_along_axis(steps, true.argmax(0)[None], 0)[0]
    return np.where(true.any(0), found, np.nan)

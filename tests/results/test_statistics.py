"""The experiments' statistics against scipy, against numbers by hand and by counting; pooled batches."""

import itertools
import json
import math

import numpy as np
import pytest
from scipy import stats as scipy_stats

from experiments import batches, paper, stats

ONE, OTHER = [1.0, 2.0, 4.0, 5.5], [2.0, 4.5, 6.0, 8.0, 10.0]


# ---- one mean


def test_the_interval_of_a_mean_is_students_and_seeds_without_a_number_are_left_out():
    cells = stats.spread("x", [1.0, 2.0, np.nan, 6.0])
    ends = scipy_stats.t.interval(0.95, 2, 3.0, scipy_stats.sem([1.0, 2.0, 6.0]))
    assert cells["x_mean"] == 3 and cells["x_sd"] == pytest.approx(np.sqrt(7.0))
    assert (cells["x_low"], cells["x_high"]) == pytest.approx(ends)
    half = stats.half_of(stats.moments([1.0, 2.0, 6.0]))
    assert half == pytest.approx((ends[1] - ends[0]) / 2)
    cells = stats.spread("x", [2.0])
    assert cells["x_mean"] == 2 and all(np.isnan(cells[f"x_{n}"]) for n in ("sd", "low", "high"))
    assert np.isnan(stats.spread("x", [np.nan])["x_mean"])


# ---- two means


def test_welch_is_that_of_scipy_and_of_the_paper():
    expected = scipy_stats.ttest_ind(ONE, OTHER, equal_var=False)
    assert stats.welch_of(ONE, OTHER) == pytest.approx(expected.pvalue)
    assert stats.welch_of(OTHER, ONE) == stats.welch_of(ONE, OTHER)
    t, df, p = stats.welch((33.35, 0.54, 3), (12.96, 2.68, 3))  # dyna4 and PPO-12 of Table V
    assert (round(t, 2), round(df, 2), round(p, 4)) == (12.92, 2.16, 0.0044)
    assert np.isnan([stats.welch_of([2.0], [1.0, 3.0]), stats.welch_of([2.0] * 3, [2.0] * 3)]).all()


def test_the_difference_has_the_interval_of_scipy():
    expected = scipy_stats.ttest_ind(ONE, OTHER, equal_var=False).confidence_interval(0.95)
    found = stats.difference(ONE, OTHER)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert found.value == pytest.approx(np.mean(ONE) - np.mean(OTHER))


def test_spreads_and_correlations_are_those_of_scipy():
    """The F test by Welch's moments too; Fisher's interval; NaN of one seed."""
    times = np.var(ONE, ddof=1) / np.var(OTHER, ddof=1)
    tails = scipy_stats.f.cdf(times, 3, 4), scipy_stats.f.sf(times, 3, 4)
    assert stats.spreads(ONE, OTHER) == pytest.approx(2 * min(tails))
    assert stats.spreads(OTHER, ONE) == pytest.approx(2 * min(tails))
    printed = stats.Moments(0, 1.4, 10), stats.Moments(0, 1.0, 10)
    assert stats.spreads(*printed) == pytest.approx(2 * scipy_stats.f.sf(1.96, 9, 9))
    assert np.isnan([stats.spreads([1.0], ONE), stats.spreads([2.0, 2.0], ONE)]).all()
    x, y = np.random.default_rng(0).normal(size=(2, 12))
    expected = scipy_stats.pearsonr(x, x + y)
    ends = expected.confidence_interval(0.95)
    found = (expected.statistic, ends.low, ends.high)
    assert stats.correlation(x, x + y) == pytest.approx(found)


def test_equivalence_is_two_tests_of_scipy_and_the_90_percent_interval_within_the_margin():
    for margin in (0.5, 3.0, 8.0, 12.0):
        below, above = np.array(ONE) + margin, np.array(ONE) - margin
        expected = max(
            scipy_stats.ttest_ind(below, OTHER, equal_var=False, alternative="greater").pvalue,
            scipy_stats.ttest_ind(above, OTHER, equal_var=False, alternative="less").pvalue,
        )
        p = stats.equivalence(ONE, OTHER, margin)
        assert p == pytest.approx(expected)
        ends = scipy_stats.ttest_ind(ONE, OTHER, equal_var=False).confidence_interval(0.9)
        assert (p < 0.05) == (-margin < ends.low and ends.high < margin)


def test_means_a_margin_apart_are_called_equal_in_one_case_of_20_at_most():
    """Counted where the claim is just wrong; a p above 0.05 of Welch's test would say it in most."""
    rng = np.random.default_rng(0)
    pairs = [(rng.normal(0, 0.4, 5), rng.normal(1, 0.4, 5)) for _ in range(3000)]
    wrong = np.mean([stats.equivalence(*pair, 1.0) < 0.05 for pair in pairs])
    assert 0.035 < wrong < 0.065


# ---- many tests


def test_holm_by_hand_and_as_its_steps_reject():
    """0.01 x 4, 0.013 x 3 but no less than before, 0.03 x 2, 0.2 x 1; a NaN is no test."""
    p = [0.03, 0.01, np.nan, 0.2, 0.013]
    np.testing.assert_allclose(stats.holm(p), [0.06, 0.04, np.nan, 0.2, 0.04])
    np.testing.assert_allclose(stats.holm([0.6, 0.7]), [1, 1])
    rng = np.random.default_rng(0)
    for _ in range(50):
        p = rng.uniform(0, 0.1, 6)
        rejected, left = set(), len(p)
        for k in np.argsort(p):  # step down until one is not rejected
            if p[k] > 0.05 / left:
                break
            rejected.add(k)
            left -= 1
        assert set(np.flatnonzero(stats.holm(p) <= 0.05)) == rejected


def test_verdicts_rest_on_holms_p():
    base = [10.0, 10.1, 9.9, 10.05, 9.95]
    rows = [stats.compare(np.add(base, by), base, 1.0) for by in (0.01, 0.5, 5.0, -5.0)]
    rows.append(stats.compare([8.0, 12.0, 9.0, 11.0, 10.5], base, 1.0))
    rows.append({"status": "not run"})
    stats.correct(rows)
    words = [row.get("verdict") for row in rows]
    expected = ["equal", "higher, within the margin", "higher", "lower", "not shown", None]
    assert words == expected
    adjusted = stats.holm([row["p_equal"] for row in rows[:5]])
    np.testing.assert_array_equal([row["p_equal_holm"] for row in rows[:5]], adjusted)


# ---- ratios, and seeds that never get there


def test_a_ratios_interval_solves_fiellers_inequality():
    """Its ends are where |x - r y| is t standard errors; found here by bisection."""
    some, others = [8.1, 7.2, 8.8, 7.9, 8.4], [15.1, 17.3, 16.2, 14.9, 18.0]
    found = stats.ratio(some, others)
    (x, a), (y, b) = ((np.mean(v), np.var(v, ddof=1) / 5) for v in (some, others))
    r = x / y
    df = (a + r**2 * b) ** 2 / ((a**2 + r**4 * b**2) / 4)
    t = scipy_stats.t.ppf(0.975, df)

    def outside(r):
        return (x - r * y) ** 2 - t**2 * (a + r**2 * b)

    for inner, outer, end in ((r, r / 2, found.low), (r, 2 * r, found.high)):
        for _ in range(60):
            middle = (inner + outer) / 2
            inner, outer = (inner, middle) if outside(middle) > 0 else (middle, outer)
        assert end == pytest.approx(inner)
    assert found.value == r


def test_a_ratios_interval_holds_it_in_95_of_100_cases():
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(4000):
        found = stats.ratio(rng.normal(8, 1, 5), rng.normal(16, 3, 5))
        held += found.low < 0.5 < found.high
    assert abs(held / 4000 - 0.95) < 0.015
    assert np.isnan(stats.ratio([1.0, 2.0], [-1.0, 1.2]).low)  # the base may be 0


def test_a_seed_that_never_gets_there_counts_with_all_its_steps():
    nan = np.nan
    whole = stats.share([4.0, 6.0], [9.0, 11.0], 20, 20)
    assert whole["pct"] == 50 and whole["low"] < 50 < whole["high"]
    assert stats.share([4.0, nan], [9.0, 11.0], 20, 30) == {"pct": 120, "bound": "at least"}
    assert stats.share([4.0, 6.0], [9.0, nan], 20, 31) == {"pct": 25, "bound": "at most"}
    for pair in (([4.0, nan], [9.0, nan]), ([nan, nan], [9.0, 9.0]), ([4.0, 6.0], [nan, nan])):
        assert stats.share(*pair, 20, 30) == {}


def test_the_rank_test_is_exact_and_never_is_later_than_anything():
    ours, theirs = [1.0, 2.5, 3.0], [2.0, 4.0, 5.0, 6.0]
    expected = scipy_stats.mannwhitneyu(ours, theirs, method="exact").pvalue
    assert stats.rank_sum(ours, theirs) == pytest.approx(expected)
    ours, theirs = [1.0, 2.0, np.nan], [2.0, np.nan, np.nan, 7.0]
    ranks = scipy_stats.rankdata([1, 2, 99, 2, 99, 99, 7])
    sums = [sum(chosen) for chosen in itertools.combinations(ranks, 3)]
    far = np.abs(np.array(sums) - 12) >= abs(ranks[:3].sum() - 12)
    assert stats.rank_sum(ours, theirs) == pytest.approx(far.mean())


# ---- batches


def test_batches_of_one_setting_are_pooled_and_none_is_left_out():
    """Audit: three batches of PPO-16 with 4096 robots, two with 1024."""
    for name, seeds in (
        ("12_platforms/earlier/go1_ppo16", 15),
        ("20_tail/results/go1_ppo16_1024", 10),
    ):
        folder, run = (batches.EXPERIMENTS / name).parent, name.rpartition("/")[2]
        others = batches.others_of(folder, run)
        each = [paper.load(p.parent, p.name) for p in [folder / run, *others]]
        found = batches.load(folder, run)
        assert len(paper.peak(found)) == found.columns["episode_return"].shape[1] == seeds
        np.testing.assert_array_equal(paper.peak(found), np.concatenate([*map(paper.peak, each)]))
        both = np.concatenate([one.columns["episode_return"] for one in each], 1)
        np.testing.assert_array_equal(found.columns["episode_return"], both)
        assert len(found.summary["evaluation"]["return"]) == seeds
        assert np.isfinite(found.columns["seconds"][-1]).sum() == 5  # of the batch with its own GPU


def test_every_run_of_a_job_that_is_stored_is_in_its_pool():
    """Runs whose job and settings are those of another folder's are named in `MORE`."""
    results = batches.EXPERIMENTS / "20_tail" / "results"
    known = {other for others in batches.MORE.values() for other in others}
    mains = {json.loads(p.read_text()).get("job") for p in results.glob("*.json")}
    mains |= {
        json.loads(p.read_text()).get("job")
        for p in (batches.EXPERIMENTS / "12_platforms" / "earlier").glob("*.json")
    }
    for path in [*results.glob("first/*.json"), *results.glob("second/*.json")]:
        if json.loads(path.read_text()).get("job") in mains:
            assert f"{path.parent.name}/{path.stem}" in known, path
    seeds = {path.stem for path in results.glob("*_seed5.json")}
    assert seeds <= known


# ---- when a robot walks: against a plain loop over evaluations


NAN = math.nan


def by_hand(steps, returns, falls, least):
    """`(walks, level, careful)` of one seed, read as the definition is written."""

    def good(k):
        return returns[k] >= least and falls[k] <= 0.01

    count = range(len(steps))
    return (
        next((steps[k] for k in count if all(good(j) for j in count[k:])), NAN),
        next((steps[k] for k in count if returns[k] >= least), NAN),
        next((steps[k] for k in count if good(k)), NAN),
    )


CASES = {  # returns, fall rates of evaluations after 1, 2, 3, 4 steps -> walks, at the level, with few falls
    "at once": ([40, 40, 40, 40], [0, 0, 0, 0], (1, 1, 1)),
    "exactly": ([30, 38, 38, 38], [0, 0.01, 0.01, 0.01], (2, 2, 2)),
    "falls at first": ([39, 39, 40, 40], [0.05, 0.02, 0.01, 0], (3, 1, 3)),
    "relapse of the return": ([39, 37, 39, 40], [0, 0, 0, 0], (3, 1, 1)),
    "relapse of the falls": ([39, 39, 39, 40], [0, 0, 0.02, 0], (4, 1, 1)),
    "lost at the end": ([39, 39, 39, 37], [0, 0, 0, 0], (NAN, 1, 1)),
    "falls at the end": ([39, 39, 39, 39], [0, 0, 0, 0.011], (NAN, 1, 1)),
    "never at both": ([39, 30, 39, 30], [0.5, 0, 0.5, 0], (NAN, 1, NAN)),
    "never": ([1, 2, 3, 4], [0, 0, 0, 0], (NAN, NAN, NAN)),
    "at the last only": ([1, 2, 3, 38], [1, 1, 1, 0], (4, 4, 4)),
    "nan between": ([39, NAN, 39, 39], [0, 0, 0, 0], (3, 1, 1)),
    "nan falls": ([39, 39, 39, 39], [0, 0, NAN, 0], (4, 1, 1)),
    "all nan": ([NAN] * 4, [NAN] * 4, (NAN, NAN, NAN)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_robot_walks_from_where_it_never_relapses(name):
    returns, falls, expected = CASES[name]
    np.testing.assert_array_equal(stats.reached([1, 2, 3, 4], returns, falls, 38), expected)
    np.testing.assert_array_equal(by_hand([1, 2, 3, 4], returns, falls, 38), expected)


def test_seeds_are_judged_each_by_itself():
    """Random evaluations of 200 seeds, against the loop; steps of each seed, or of all."""
    rng = np.random.default_rng(0)
    returns = rng.choice([30.0, 37.9, 38.0, 41.0, NAN], (6, 200), p=[0.1, 0.1, 0.3, 0.45, 0.05])
    falls = rng.choice([0.0, 0.005, 0.01, 0.02], (6, 200), p=[0.5, 0.3, 0.1, 0.1])
    common, own = np.arange(1, 7) * 10, np.cumsum(rng.integers(1, 9, (6, 200)), 0)
    for steps in (common, own):
        found = stats.reached(steps, returns, falls, 38)
        for s in range(200):
            mine = steps if steps.ndim == 1 else steps[:, s]
            expected = by_hand(mine, returns[:, s], falls[:, s], 38)
            np.testing.assert_array_equal([x[s] for x in found], expected)
    assert 20 < np.isnan(found.walks).sum() < 180 and (found.walks > found.careful).any()


def test_without_evaluations_nobody_walks():
    assert np.isnan(stats.reached([], [], [], 38)).all()
    found = stats.reached([], np.zeros((0, 3)), np.zeros((0, 3)), 38)
    assert np.isnan(found).all() and np.shape(found) == (3, 3)
    for shapes in (((3,), (4,), (4,)), ((4,), (4, 2), (4,)), ((2,), (4, 2), (4, 2))):
        with pytest.raises(ValueError, match="expected one shape"):
            stats.reached(*map(np.zeros, shapes), 38)


def test_a_biped_walks_by_its_errors_and_falls():
    """Against the definition read as it is written; exactly at the level counts, NaN does not."""
    rng, steps = np.random.default_rng(0), [10, 20, 30, 40]
    errors = rng.choice([0.1, 0.2, 0.21, NAN], (4, 300), p=[0.3, 0.5, 0.1, 0.1])
    yaw = rng.choice([0.1, 0.25, 0.26], (4, 300), p=[0.4, 0.5, 0.1])
    falls = rng.choice([0.0, 0.01, 0.011], (4, 300), p=[0.5, 0.4, 0.1])
    found = stats.reached_by_tracking(steps, errors, yaw, falls)
    for s in range(300):
        level = [
            1.0 if e <= 0.2 and y <= 0.25 else 0.0
            for e, y in zip(errors[:, s], yaw[:, s], strict=True)
        ]
        expected = by_hand(steps, level, falls[:, s], 1.0)
        np.testing.assert_array_equal([x[s] for x in found], expected)
    assert 20 < np.isnan(found.walks).sum() < 280
    with pytest.raises(ValueError, match="expected one shape"):
        stats.reached_by_tracking(steps, errors, yaw[:, :1], falls)

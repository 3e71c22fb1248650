"""What the rule for fresh seeds says of its runs (steps.md): each point's numbers, then which setting.

    python experiments/22_deploy/rule.py [FOLDER|FILE.csv.xz] [--seconds FOLDER|FILE.csv.xz]
        [--gait FILE] [--chosen FILE] [--benchmark FILE]

Of the jobs of fewer_fresh.txt, and with `--seconds` of fewer_seconds.txt; the FILEs are what gait.py,
choose.py and benchmark.py printed of the policies NAME.K.npz of the first. Without arguments it reads what
ran; choose.py and benchmark.py did not. A part is open until all that it is of is there, whole. A point is
not met if one part is not, else open if one is. The settings are taken in their order here.
"""

import functools
import importlib
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import special

from dynappo.policy import walks
from experiments import paper, stats

runs = importlib.import_module("experiments.21_less.table")
lost = importlib.import_module("experiments.27_few.rules").lost
FALLS = importlib.import_module("experiments.22_deploy.choose").FALLS

HERE = Path(__file__).parent
RUNS, SECONDS, GAIT = HERE / "fewer.csv.xz", HERE / "seconds", HERE / "fewer_gait.txt"
ASKED = [paper.jobs(HERE / f"fewer{x}.txt") for x in ("_fresh", "_seconds")]
ASKED = {name: line for jobs in ASKED for name, line in jobs.items()}
BASE, SETTINGS = "fresh-deploy", ("fresh-1024", "fresh-4096")
MARGIN = {"g": 1.0, "h": 1.0, "c": 0.7, "d": 0.7}  # of return
LAST, ERROR, SEEDS, SLOWER = 3, 0.02, 2, 1.25  # evaluations; m/s; more that fall; times the seconds
COSTS = "cost of transport", "torque N m", "joint speed rad/s", "change of targets rad/s"
COST, LOW = (1.05, 1.15), (0.5, 1.0)  # times, and cm: mean of the robots, and one
CLEARANCE = "clearance at 0.5 m/s cm"
WITHIN = {"slide m/s": (0, 0.15), "left": (0.95, 1.05)}
POLICIES, ONCE, LOSS = 4, 1, 0.01  # more that fall; falls of the best; share of the return
WORDS = {True: "met", False: "not met", None: "open"}


class Open(Exception):
    """Why a part cannot be judged yet."""


class Data(NamedTuple):
    jobs: dict[str, list[dict]]
    timed: dict[str, list[dict]]
    played: dict[str, dict[str, float]]  # of a policy, what the three scripts printed


class Ended(NamedTuple):
    """A job; of its seeds `[S]` the last return, and return and error of the last three evaluations."""

    name: str
    job: list[dict]
    at: float  # steps of the last evaluation
    last: np.ndarray
    back: np.ndarray
    error: np.ndarray
    kept: np.ndarray  # those that fall in at most 1 %
    lost: int  # became NaN
    policies: list[dict[str, float]]


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path, nargs="?", default=RUNS)
    parser.add_argument("--seconds", type=Path, default=SECONDS)
    parser.add_argument("--gait", type=Path, metavar="FILE", default=GAIT)
    parser.add_argument("--chosen", type=Path, metavar="FILE")
    parser.add_argument("--benchmark", type=Path, metavar="FILE")
    args = parser.parse_args()
    files = [file for file in (args.gait, args.chosen, args.benchmark) if file]
    jobs = {name: job for name, job in runs.read(args.path).items() if name in ASKED}
    print(*told(Data(jobs, runs.read(args.seconds), printed(files))), sep="\n")


def printed(files) -> dict[str, dict[str, float]]:
    """`policy -> numbers` of lines `OUT/POLICY.npz NAME NUMBER, NAME NUMBER`; one with `#` is a remark."""
    rows: dict[str, dict[str, float]] = {}
    for line in "\n".join(file.read_text() for file in files).splitlines():
        if line.strip() and not line.startswith("#"):
            try:
                name, text = line.split(maxsplit=1)
                cells = [cell.rsplit(maxsplit=1) for cell in text.split(",")]
                numbers_ = {key.strip(): float(value) for key, value in cells}
            except ValueError:
                raise SystemExit(f"{line!r}: expected POLICY NAME NUMBER, ...") from None
            rows.setdefault(Path(name).name.removesuffix(".npz"), {}).update(numbers_)
    return rows


def told(data: Data) -> list[str]:
    commits = {row["commit"] for job in (data.jobs | data.timed).values() for row in job}
    lines, verdicts = [f"commits: {', '.join(sorted(commits))}"], {}
    for setting in SETTINGS:
        lines.append(f"{setting}:")
        verdicts[setting] = {}
        for point, parts in points(data, setting).items():
            found = [met for met, _ in parts]
            met = False if False in found else None if None in found else True
            verdicts[setting][point] = met
            lines.append(f"  {point}: {WORDS[met]}")
            lines += [f"    {text}: {WORDS[one]}" for one, text in parts]
    return [*lines, verdict(verdicts)]


def verdict(found: dict[str, dict[str, bool | None]]) -> str:
    """Which setting `:deploy` takes, by the points of each."""
    stays = []
    for setting, of in found.items():
        failed, left = ([point for point, met in of.items() if met is x] for x in (False, None))
        if not failed:
            lacks = f"open: {setting} lacks {'; '.join(left)}"
            return lacks if left else f"`:deploy` takes {setting}"
        alone = failed == ["3, seconds"] and not left
        stays.append(f"{setting} fails {'; '.join(failed)}{', alone' * alone}")
    return f"`:deploy` stays: {', and '.join(stays)}"


def whole(jobs: dict, name: str) -> list[list[dict]]:
    """The seeds of a job that is there as it was asked for, to its end; else Open."""
    if name not in jobs:
        raise Open(f"no {name}")
    line, seeds = ASKED[name], runs.seeds(jobs[name])
    if {row["job"] for row in jobs[name]} != {line}:
        raise Open(f"{name} has other settings than were asked for")
    count, end = map(int, re.findall(r"(?:seeds|num_iterations)=(\d+)", line))
    at = min(run[-1]["iteration"] for run in seeds)
    if len(seeds) != count or at != end:
        raise Open(f"{name} has {len(seeds)} of {count} seeds, to iteration {at:.0f} of {end}")
    return seeds


def ended(data: Data, name: str) -> Ended:
    seeds = whole(data.jobs, name)
    columns = "return", "tracking_error", "fall_rate"
    ends = [[np.mean([r[c] for r in run[-LAST:]]) for run in seeds] for c in columns]
    back, error, fell = map(np.array, ends)
    gone = sum(any(lost(row) for row in run) for run in seeds)
    last, at = np.array([run[-1]["return"] for run in seeds]), seeds[0][-1]["sim_steps"]
    played = [data.played.get(f"{name}.{k}", {}) for k in range(len(seeds))]
    return Ended(name, data.jobs[name], at, last, back, error, walks.seldom(fell), gone, played)


def part(label: str, measure) -> tuple[bool | None, str]:
    """Whether a part is met, None if it is open, and its numbers."""
    try:
        met, text = measure()
        return bool(met), f"{label}: {text}"
    except Open as why:
        return None, f"{label}: {why}"


def points(data: Data, setting: str) -> dict[str, list[tuple[bool | None, str]]]:
    """`point -> parts`."""
    job = functools.cache(lambda name: ended(data, name))

    def each(label, measure):
        def of(x):
            return measure(*(job(f"{kind}-{x}") for kind in (setting, BASE)))

        return [part(f"{robot}, {label}", lambda x=x: of(x)) for x, robot in runs.ROBOTS.items()]

    def all_(label, measure, *more):
        def of():
            kinds = ([job(f"{k}-{x}") for x in runs.ROBOTS] for k in (setting, BASE))
            return measure(*kinds, *more)

        return part(label, of)

    return {
        "1, equal steps": [
            *each("return", equal_steps),
            all_("mean of the robots", steps_of_all),
        ],
        "2, the end": [
            *each("return", end_return),
            *each("error", end_error),
            all_("seeds", end_falls),
        ],
        "3, seconds": [part("a whole Go1", lambda: seconds(data.timed, setting))],
        "4, gait": [
            *(all_(cost, costs, cost) for cost in COSTS),
            all_(CLEARANCE, clearance),
            *(all_(name, within, name) for name in WITHIN),
        ],
        "5, in C MuJoCo": [
            all_("policies", falling),
            *each("falls of the best", fewest),
            *each("on the benchmark's task", benchmark),
        ],
    }


def at_steps(one: Ended, base: Ended) -> list[np.ndarray]:
    """The last return of one, and that of `deploy` after as many steps."""
    return [one.last[one.kept], runs.between(base.job, one.at, "return")[base.kept]]


def equal_steps(one: Ended, base: Ended):
    back = at_steps(one, base)
    return back[0].mean() > back[1].mean(), f"after {one.at / 1e6:.1f} M {beside(*back)}"


def steps_of_all(some: list[Ended], base: list[Ended]):
    """The mean of the robots' differences, each by its margin; an interval as Welch's, of eight variances."""
    pairs = zip(some, base, strict=True)
    back = [[x / MARGIN[one.name[-1]] for x in at_steps(one, its)] for one, its in pairs]
    middle = np.mean([one.mean() - its.mean() for one, its in back])
    each = [(x.var(ddof=1) / len(x) / len(some) ** 2, len(x) - 1) for pair in back for x in pair]
    total = sum(v for v, _ in each)
    df = total**2 / sum(v**2 / n for v, n in each)
    low, high = middle + special.stdtrit(df, np.array([0.025, 0.975])) * np.sqrt(total)
    return low > 0, f"{middle:+.2f} margins ({low:.2f} to {high:.2f})"


def end_return(one: Ended, base: Ended):
    back, margin = (one.back[one.kept], base.back[base.kept]), MARGIN[one.name[-1]]
    t, _, p = stats.welch(stats.moments(back[0] + margin), stats.moments(back[1]))
    p = p / 2 if t > 0 else 1 - p / 2  # one-sided
    return p < stats.ALPHA, f"{beside(*back)}, p {p:.3f} that it is {margin:g} lower"


def end_error(one: Ended, base: Ended):
    mine, its = (x.error[x.kept].mean() for x in (one, base))
    return mine <= its + ERROR, f"{mine:.3f} and {its:.3f} m/s"


def end_falls(some: list[Ended], base: list[Ended]):
    mine, its = (sum((~x.kept).sum() for x in each) for each in (some, base))
    gone = sum(x.lost for x in some)
    text = f"{mine} and {its} fall in more than 1 %, {gone} became NaN"
    return mine <= its + SEEDS and not gone, text


def seconds(timed: dict[str, list[dict]], setting: str):
    names = (f"{kind.removeprefix('fresh-')}-g" for kind in (setting, BASE))
    both = [whole(timed, name) for name in names]
    ends = [[run[-1]["seconds"] for run in each] for each in both]
    found, at = stats.ratio(*ends), min(map(min, ends))

    def then(run):
        return np.interp(at, *([row[c] for row in run] for c in ("seconds", "return")))

    back = beside(*(np.array([then(run) for run in each]) for each in both))
    text = "{:.1f} and {:.1f} s, {:.2f} times ({:.2f} to {:.2f})".format(
        *map(np.mean, ends), *found
    )
    return found.high <= SLOWER, f"{text}; after {at:.1f} s return {back}"


def numbers(one: Ended, key: str) -> np.ndarray:
    """Of each seed's policy, `[S]`."""
    if gone := [str(k) for k, row in enumerate(one.policies) if key not in row]:
        raise Open(f"no {key} of {one.name}.{', .'.join(gone)}")
    return np.array([row[key] for row in one.policies])


def means(some: list[Ended], key: str) -> np.ndarray:
    """Of each robot, of the seeds that are kept; one that lifts no foot has no clearance."""
    each = [numbers(x, key)[x.kept] for x in some]
    return np.array([stats.moments(values).mean for values in each])


def costs(some: list[Ended], base: list[Ended], key: str):
    found = means(some, key) / means(base, key)
    return found.mean() <= COST[0] and found.max() <= COST[1], robots(found, "times")


def clearance(some: list[Ended], base: list[Ended]):
    found = means(some, CLEARANCE) - means(base, CLEARANCE)
    return found.mean() >= -LOW[0] and found.min() >= -LOW[1], robots(found, "more")


def within(some: list[Ended], _, key: str):
    found, (low, high) = means(some, key), WITHIN[key]
    return low <= found.min() and found.max() <= high, robots(found)


def falls(one: Ended) -> np.ndarray:
    return np.sum([numbers(one, kind) for kind in FALLS], 0)


def falling(some: list[Ended], base: list[Ended]):
    mine, its = (sum((falls(x) > 0).sum() for x in each) for each in (some, base))
    return mine <= its + POLICIES, f"{mine} and {its} fall at all"


def fewest(one: Ended, base: Ended):
    mine, its = falls(one).min(), falls(base).min()
    return mine <= its + ONCE, f"{mine:.0f} and {its:.0f}"


def benchmark(one: Ended, base: Ended):
    mine, its = (numbers(x, "return")[x.kept].mean() for x in (one, base))
    return mine >= (1 - LOSS) * its, f"{mine:.2f} and {its:.2f}, {100 * (mine / its - 1):+.2f} %"


def beside(one: np.ndarray, base: np.ndarray) -> str:
    found = stats.difference(one, base)
    more = f"{found.value:+.2f} ({found.low:.2f} to {found.high:.2f})"
    return f"{one.mean():.2f} and {base.mean():.2f}, {more}"


def robots(values: np.ndarray, what: str = "") -> str:
    each = (f"{robot} {x:.3f}" for robot, x in zip(runs.ROBOTS.values(), values, strict=True))
    return f"{', '.join(each)}, mean {values.mean():.3f} {what}".strip()


if __name__ == "__main__":
    main()

"""Simulator steps until robots walk and to fixed evaluated returns, and where runs end, of what run.py wrote.

    python experiments/21_less/table.py FOLDER|FILE.csv.xz [NAME ...] [--batch K]
        [--falls | --at M ... | --beside | --phases | --parts | --model]

`--batch`: of a file only this one. Batches with the same settings are one job else, though a default may
have changed between them.

`--falls`: steps until a robot first reaches its level, the falls then, and steps until it does with few
falls, or stays there with any, at most 3 % and at most 1 % at every later evaluation.

`--at`: return and falls after so many million steps, between two evaluations on a straight line.
`--beside`: `best` against PPO, in steps and at equal steps (headline.csv.xz, low_feet.csv.xz). `--phases`:
per cent of falls while the model writes tails and after.

`--parts`: a line a part that was taken out, a column a robot: steps until it walks, until it is first at the
level, then return and falls at the end. `--model` (ablation.csv.xz): the tables of model.md: what writes a
tail in today's `best`, what these need beside each other, the former in the `best` of 2026-11-26, and the
parts.

What walking is, README.md and dynappo/policy/walks.py say. All are means over seeds, and in brackets the last
seed's; a seed that never gets there is counted as missing. The end is the mean of a seed's last three
evaluations. Intervals are Student's t, 95 %. A return of 10 s (run.eval_steps=500) counts twice.
"""

import csv
import functools
import itertools
import lzma
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from dynappo.run import learning_curves as curves
from experiments import paper, stats

TEXT = ("job", "name", "batch", "device", "commit")
END = ("return", "fall_rate", "tracking_error")
LEVELS = {45: (20, 30, 35, 40), 30: (15, 20, 22, 25)}  # by the best possible return
ROBOTS = {"g": "Go1", "h": "Go2", "c": "ANYmal-C", "d": "ANYmal-D"}
TAILS = {  # jobs of controls.txt and updates.txt -> what writes a tail
    "whole": "the model, from real rows drawn at random (`best`)",
    "last": "the model, from the robots' last states",
    "simulator": "**the simulator**, from the last states, not counted",
    "real4-5": "nothing, 5 epochs",
    "real4-15": "nothing, 15 epochs: as many updates",
    "updates-208-15": "208 robots, 20 real rows, 15 epochs: as many updates",
    "updates-208-5": "208 robots, 20 real rows, 5 epochs",
    "real20-5": "the simulator, counted: 20 real rows, 5 epochs",
    "real20-15": "20 real rows, 15 epochs",
}
PAIRS = {  # jobs of TAILS or of the headline, and what they are beside
    ("simulator", "last"): "the simulator's tails beside the model's from the same states",
    ("simulator", "whole"): "the same beside `best`",
    ("last", "whole"): "the model's tails from the last states beside `best`",
    ("updates-208-15", "whole"): "208 robots, 15 epochs, beside `best`",
    ("updates-208-5", "whole"): "208 robots, 5 epochs, beside `best`",
    ("updates-208-15", "updates-208-5"): "15 epochs beside 5",
    ("updates-208-15", "ppo-level"): "15 epochs beside PPO tuned for the level",
    ("updates-208-5", "ppo-level"): "5 epochs beside PPO tuned for the level",
}
PARTS = {  # jobs of ablation.txt -> what is taken out
    "all": "(all parts)",
    "falls": "predicted falls (`model.falls`)",
    "rounds": "rounds of imagination: 1",
    "robots": "few robots: 4096",
    "rows": "4 simulated rows: 8",
    "ramp": "ramp of 5 iterations: 20",
    "symmetry": "symmetric policy",
    "known": "known reward (`model.known_reward`)",
    "kl": "KL 0.02: 0.01",
    "swish": "swish: ELU",
    "gamma": "gamma 0.98: 0.99",
    "presence": "weights by presence (algorithm.py)",
    "clean": "clean targets (`model.clean`)",
    "episodes": "episodes of 5 s: 20 s",
}
LAST = 300  # iterations of controls.txt
# of ablation.csv.xz -> its table
BATCHES = {"1": "parts", "2": "before", "3": "today", "4": "today"}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--batch")
    parser.add_argument("--parts", action="store_true")
    parser.add_argument("--model", action="store_true")
    parser.add_argument("--falls", action="store_true")
    parser.add_argument("--at", type=float, nargs="+", metavar="M")
    parser.add_argument("--beside", action="store_true")
    parser.add_argument("--phases", action="store_true")
    args = parser.parse_args()
    jobs = read(args.path, args.batch)
    jobs = {name: jobs[name] for name in args.names or jobs}
    for asked, lines in (
        (args.parts, parts),
        (args.model, lambda jobs: model(jobs, read(args.path.with_name("headline.csv.xz")))),
        (args.falls, falls),
        (args.at, lambda jobs: at(jobs, args.at)),
        (args.beside, beside),
        (args.phases, phases),
    ):
        if asked:
            print(lines(jobs))
            return
    for top in LEVELS:
        mine = {name: job for name, job in jobs.items() if top == best(job)}
        if mine:
            print(table(mine, top), end="\n\n")


def read(path: Path, batch: str | None = None) -> dict[str, list[dict]]:
    """`name -> rows`, numbers as such: of a folder of NAME.csv, or of one packed file, or of its `batch`.
    Batches that ran the same settings under one name are one job; of others the later is called
    `NAME of batch K`. SystemExit where there is neither."""
    if not path.exists():
        raise SystemExit(
            f"{path}: there is no such file or folder; expected what run.py or pack.py wrote"
        )
    if path.is_dir():
        return {file.stem: rows(file.open(newline="")) for file in sorted(path.glob("*.csv"))}
    jobs, first = {}, {}
    for row in map(dict, packed(path, path.stat().st_mtime_ns)):  # whose rows stay as they are
        if batch not in (None, row.get("batch")):  # seconds.csv.xz has none
            continue
        name, settings = row["name"], [f for f in row["job"].split() if not f.startswith("run.")]
        if first.setdefault(name, settings) != settings:
            name += f" of batch {row['batch']}"
        jobs.setdefault(name, []).append(row)
    return jobs


@functools.cache
def packed(path: Path, changed: int) -> list[dict]:
    """The rows of a packed file, read once until it is `changed`."""
    del changed
    return rows(lzma.open(path, "rt", newline=""))


def rows(file) -> list[dict]:
    """The rows of an open CSV."""
    with file:
        found = list(csv.DictReader(file))
    found = [{k: v if k in TEXT else float(v or "nan") for k, v in row.items()} for row in found]
    for row in found:
        row["return"] *= 2 if "run.eval_steps=500" in row["job"] else 1
    return found


def best(job) -> int:
    """The best possible return of a job's robot: up to 25 kg with the weights of the Unitree tasks."""
    light = ("go", "a1:", "aliengo:", "mini_cheetah:")
    return 45 if any(word.startswith(light) for word in job[0]["job"].split()) else 30


def seeds(job) -> list[list[dict]]:
    """The rows of each run, in order: of a seed that two batches have, two."""
    runs = {}
    for row in job:
        runs.setdefault((row.get("batch", ""), row["seed"]), []).append(row)
    return [runs[key] for key in sorted(runs)]


def first(run: list[dict], level: float, name: str = "sim_steps") -> float:
    """`name` at the first evaluation of a seed that is at least `level`; NaN if none is."""
    return float(reached([run], level, name).level[0])


def reached(runs, level: float, name: str = "sim_steps", most=walks.MOST_FALLS) -> stats.Reached:
    """`name` where each seed walks, is first at the level, and first there with few falls; `[S]` each."""
    columns = (name, "return", "fall_rate")
    found = [
        stats.reached(*([row[c] for row in run] for c in columns), level, most) for run in runs
    ]
    return stats.Reached(*(np.array(one, float) for one in zip(*found, strict=True)))


def spread(values, digits: int = 1) -> str:
    """Mean and half of its interval."""
    return f"{np.mean(values):.{digits}f} ± {curves.half_width(values):.{digits}f}"


def steps_of(steps) -> str:
    """Million steps: mean over the seeds that get there, the last one's, and how many never do."""
    steps = np.asarray(steps) / 1e6
    gone = int(np.isnan(steps).sum())
    if gone == len(steps):
        return f"{gone} never"
    return f"{np.nanmean(steps):.2f} ({np.nanmax(steps):.2f})" + (f", {gone} never" if gone else "")


def table(jobs, top: int) -> str:
    """In Markdown, a line a job; `top` is the best possible return."""
    least = walks.level(top)
    head = ["", "seeds", "walks: M steps", f"first at {least:g}"]
    head += [f"first at {least:g}, falls at most 1 %", *map(str, LEVELS[top])]
    head += ["M steps in all", "at the end: return, falls", "error, m/s"]
    lines = []
    for name, mine in jobs.items():
        runs = seeds(mine)
        cells = [name, str(len(runs)), *map(steps_of, reached(runs, least))]
        cells += [steps_of([first(run, level) for run in runs]) for level in LEVELS[top]]
        ends = [{k: np.mean([row[k] for row in run[-3:]]) for k in END} for run in runs]
        cells.append(f"{runs[0][-1]['sim_steps'] / 1e6:.1f}")
        falls = 100 * np.mean([end["fall_rate"] for end in ends])
        cells += [f"{spread([end['return'] for end in ends])}, {falls:.1f} %"]
        lines.append([*cells, f"{np.mean([end['tracking_error'] for end in ends]):.3f}"])
    return paper.markdown(head, lines)


def falls(jobs) -> str:
    """In Markdown, a line a job: million steps until it walks by several meanings of that word."""
    head = ["", "first at the level", "falls then", "first with <= 1 %"]
    head, lines = [*head, "stays", "stays, <= 3 %", "stays, <= 1 %"], []
    for name, mine in jobs.items():
        runs, level = seeds(mine), walks.level(best(mine))
        then = np.array([first(run, level, "fall_rate") for run in runs])
        few = reached(runs, level)
        found = [few.careful, *(reached(runs, level, most=most).walks for most in (1, 0.03, 0.01))]
        then = f"{100 * np.nanmean(then):.1f} % (up to {100 * np.nanmax(then):.0f} %)"
        lines.append([name, steps_of(few.level), then, *map(steps_of, found)])
    return paper.markdown(head, lines)


def between(job, steps: float, name: str) -> np.ndarray:
    """`name` of each run after so many steps, `[S]`: linear between two evaluations."""
    ours = ([[r[c] for r in run] for c in ("sim_steps", name)] for run in seeds(job))
    return np.array([np.interp(steps, *columns) for columns in ours])


def at(jobs, millions) -> str:
    """In Markdown, a line a job, a column a number of million steps: return, per cent of falls."""
    lines = []
    for name, job in jobs.items():
        found = [[between(job, m * 1e6, c) for c in ("return", "fall_rate")] for m in millions]
        cells = [f"{spread(total)}, {spread(100 * fell)} %" for total, fell in found]
        lines.append([name, *cells])
    return paper.markdown(["", *(f"{m:.3g} M" for m in millions)], lines)


def beside(jobs) -> str:
    """In Markdown, a line a robot and PPO: how many times the steps of `best` it needs, with Fieller's
    interval; "at least" where some seeds never get there and count with all steps of their runs. Then what
    `best` returns more and, in points of per cent, falls more, at 2 M steps and where the shortest run of PPO
    on that robot ends."""
    runs = ("ppo-task", "ppo", "ppo-level", "ppo-walk")
    head = ["", "to the level", "until it walks", "return at 2 M", "at PPO's end"]
    head, lines = [*head, "p that they are equal", "falls at 2 M", "at PPO's end"], []
    for letter, name in itertools.product("ghcd", runs):
        if f"{name}-{letter}" not in jobs:
            continue
        there = [jobs[f"{run}-{letter}"] for run in runs if f"{run}-{letter}" in jobs]
        mine, ppo = jobs[f"best-{letter}"], jobs[f"{name}-{letter}"]
        end = min(seeds(job)[0][-1]["sim_steps"] for job in there)
        margin = 1.0 if letter in "gh" else 0.7
        one, other = (reached(seeds(job), walks.level(best(mine))) for job in (ppo, mine))
        whole = seeds(ppo)[0][-1]["sim_steps"]
        cells = [f"{name}-{letter}", factor(one.level, other.level, whole)]
        cells.append(factor(one.walks, other.walks, whole))
        for column, scale in (("return", 1), ("fall_rate", 100)):
            for steps in (2e6, end):
                pair = [scale * between(job, steps, column) for job in (mine, ppo)]
                found = stats.difference(*pair)
                cells.append(f"{found.value:+.1f} ({found.low:.1f} to {found.high:.1f})")
            if column == "return":
                cells.append(f"{stats.equivalence(*pair, margin):.1g}")
        lines.append(cells)
    return paper.markdown(head, lines)


def factor(one, other, end: float) -> str:
    """Mean steps of `one` by those of `other`; a NaN of `one` counts with `end`, which is too few.
    No number where `other` has a NaN."""
    if never := np.isnan(other).sum():
        return f"`best`: {never} never"
    if np.isnan(one).any():
        return f"at least {np.mean(np.nan_to_num(one, nan=end)) / np.mean(other):.1f}"
    found = stats.ratio(one, other)
    return f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"


def phases(jobs) -> str:
    """In Markdown, a line a job with a tail: per cent of episodes with a fall, see `phase`."""
    head = ["", "with tails", "their last", "physics alone: 10 iterations", "30", "all later"]
    found = {name: phase(job) for name, job in jobs.items()}
    found = {name: one.mean(0) for name, one in found.items() if np.isfinite(one).all()}
    return paper.markdown(head, [[n, *(f"{x:.2f}" for x in one)] for n, one in found.items()])


def phase(job) -> np.ndarray:
    """Per cent of falls of each run, `[S, 5]`: mean with tails, from iteration 70 on; the last with tails;
    after 10 and 30 iterations of physics alone; the mean of all of these. NaN where there is no such one.

    An evaluation is of physics alone if no iterations have more steps than those before it."""
    out = []
    for run in seeds(job):
        iteration, steps, fell = (
            np.array([r[c] for r in run]) for c in ("iteration", "sim_steps", "fall_rate")
        )
        pace = np.diff(steps, prepend=0) / np.diff(iteration, prepend=0)
        alone = pace == pace[-1]
        with_tails = 100 * fell[~alone & (iteration >= 70)]
        after = 100 * fell[alone]
        if not len(with_tails) or len(after) < 3:
            out.append([np.nan] * 5)
            continue
        out.append([with_tails.mean(), with_tails[-1], after[0], after[2], after.mean()])
    return np.array(out)


def parts(jobs) -> str:
    """In Markdown, a line for the jobs `NAME-g`, `-h`, `-c` and `-d`: Go1, Go2, ANYmal-C and -D."""
    lines = []
    for name in dict.fromkeys(name[:-2] for name in jobs):
        found = [jobs.get(f"{name}-{robot}") for robot in ROBOTS]
        lines.append([name, *(part(job) if job else "" for job in found)])
    return paper.markdown(["", *ROBOTS.values()], lines)


def part(job) -> str:
    """Million steps until the mean seed walks, and to the level; return and falls at the end."""
    runs = seeds(job)
    found = reached(runs, walks.level(best(job)))
    last = [row for run in runs for row in run[-3:]]
    total, falls = (np.mean([row[name] for row in last]) for name in ("return", "fall_rate"))
    return f"**{mean(found.walks)}**; {mean(found.level)}; {total:.1f}, {100 * falls:.1f} %"


def model(jobs, headline) -> str:
    """In Markdown, the tables of model.md: what writes a tail, today and then, and the parts of `best`.

    Today's `best` is the headline's, evaluated as often as the others. A line has all four robots."""
    batches: dict[str, dict[str, list[dict]]] = {name: {} for name in BATCHES.values()}
    for job in jobs.values():
        for row in job:
            mine = batches[BATCHES[row["batch"]]]
            mine.setdefault(row["name"].removeprefix("control-"), []).append(row)
    for robot in ROBOTS:
        best = [row for row in headline[f"best-{robot}"] if row["iteration"] <= LAST]
        batches["today"][f"whole-{robot}"] = best
        batches["today"][f"ppo-level-{robot}"] = headline[f"ppo-level-{robot}"]
    tables = []
    for batch, title in (
        ("today", "what writes 16 of 20 rows, or runs instead"),
        ("before", "in the `best` of 2026-11-26"),
    ):
        found, lines = batches[batch], []
        for name, label in TAILS.items():
            asked = [found.get(f"{name}-{robot}") for robot in ROBOTS]
            if all(asked):
                lines.append([label, *map(to_both, asked)])
        tables.append(paper.markdown([title, *ROBOTS.values()], lines))
    tables.insert(1, times(batches["today"]))
    lines = []
    for name, label in PARTS.items():
        asked = [batches["parts"].get(f"{name}-{robot}") for robot in ROBOTS]
        lines.append([label, *(part(job) if job else "" for job in asked)])
    return "\n\n".join([*tables, paper.markdown(["without", *ROBOTS.values()], lines)])


def times(jobs) -> str:
    """In Markdown, how many times the steps of another: `PAIRS`, to the level and to a walk.

    Ratios of means with Fieller's interval, of the seeds that get there ("*": some do not). Bold: a rank
    test, in which a seed that never does is last, has p below 0.05 by Holm over the four robots."""
    lines = []
    for (one, other), label in PAIRS.items():
        for what in ("level", "walks"):
            pairs = [
                [
                    getattr(reached(seeds(job), walks.level(best(job))), what)
                    for job in (jobs[f"{one}-{robot}"], jobs[f"{other}-{robot}"])
                ]
                for robot in ROBOTS
            ]
            p, cells = stats.holm([stats.rank_sum(*pair) for pair in pairs]), []
            for pair, shown in zip(pairs, p, strict=True):
                value, low, high = stats.ratio(*pair)
                some = "*" if np.isnan(np.concatenate(pair)).any() else ""
                cells.append(f"{value:.2f}{some} ({low:.2f} to {high:.2f})")
                if shown < stats.ALPHA:
                    cells[-1] = f"**{cells[-1]}**"
            lines.append([label if what == "level" else "… to a walk", *cells])
    return paper.markdown(["times the steps, to the level", *ROBOTS.values()], lines)


def to_both(job) -> str:
    """Million steps until it is first at the level; until it walks, and the last seed's."""
    runs = seeds(job)
    found = reached(runs, walks.level(best(job)))
    if np.isnan(found.level).all():
        return f"never in {runs[0][-1]['sim_steps'] / 1e6:.1f}"
    return f"{mean(found.level)}; {steps_of(found.walks)}"


def mean(steps) -> str:
    """Million steps: mean over the seeds that get there, and how many never do."""
    gone = int(np.isnan(steps).sum())
    if gone == len(steps):
        return "never"
    return f"{np.nanmean(steps) / 1e6:.2f}" + (f" ({gone} never)" if gone else "")


if __name__ == "__main__":
    main()

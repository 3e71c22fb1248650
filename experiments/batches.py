"""Runs of the same setting: all of them count, so they are pooled, and each is named.

Some settings were trained more than once: with seeds 5 to 9, or at an earlier commit. `load` gives all
seeds of all batches as one run. Seeds of another batch with the same number are other seeds, because
MuJoCo Warp is not deterministic. A run that has the name of another in the folder `more` beside it is its
next batch. The runs of 12_platforms/results have a later commit and another engine: they are by themselves,
and where a page asks, beside the `earlier` ones. 10_ablation/plot.py alone pools both engines, and says so.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments import paper

EXPERIMENTS = Path(__file__).parent
MORE = {  # FOLDER/run -> other batches of its job, in 20_tail/results
    "12_platforms/earlier/go1_ppo16": ("first/go1_ppo16", "second/go1_ppo16"),
    "12_platforms/earlier/go1_best": ("second/go1_best",),
    "12_platforms/earlier/anymal_c_ppo16": ("anymal_c_ppo16_seed5",),
    "12_platforms/earlier/anymal_d_ppo16": ("anymal_d_ppo16_seed5",),
    "20_tail/results/go1_ppo16_1024": ("second/go1_ppo16_1024",),
    "20_tail/results/go1_best_1024": ("go1_best_1024_seed5",),
}
PER_SEED = ("return", "return_max", "policy_std", "return_of_all")


def load(folder: Path, name: str) -> paper.Run | None:
    """The run NAME of `folder` with all batches of its setting; None if it has not ended."""
    run = paper.load(folder, name)
    others = [paper.load(path.parent, path.name) for path in others_of(folder, name)]
    found = [one for one in others if one and one.columns]
    return pool([run, *found]) if run and run.columns and found else run


def earlier(folder: Path, name: str) -> paper.Run | None:
    """All batches of this setting in the folder `earlier` beside `folder`."""
    return load(folder.resolve().parent / "earlier", name)


def others_of(folder: Path, name: str) -> list[Path]:
    """Where the other batches of a run are, without suffix."""
    others = {EXPERIMENTS / run: batches for run, batches in MORE.items()}
    named = [EXPERIMENTS / "20_tail/results" / o for o in others.get(folder.resolve() / name, ())]
    more = (folder / "more" / f"{name}.json").exists()
    return [*named, *([folder / "more" / name] if more else [])]


def pool(runs: list[paper.Run]) -> paper.Run:
    """One run of all seeds. Seconds are of the first batch alone: others shared their GPU with a run."""
    first, *more = runs
    shared = set.intersection(*(set(run.columns) for run in runs))
    columns = {}
    for name, values in first.columns.items():
        if name == "seconds":
            rest = [np.full(run.columns["sim_steps"].shape, np.nan) for run in more]
        elif name in shared:
            rest = [run.columns[name] for run in more]
        else:
            continue
        columns[name] = np.concatenate([values, *rest], 1)
    steps = [run.columns["sim_steps"][:, 0] for run in runs]
    assert all((one == steps[0]).all() for one in steps), "batches of different schedules"
    summary = first.summary | {"batches": [len(paper.peak(run)) for run in runs]}
    for name in PER_SEED:
        summary.pop(name, None)
        if all(name in run.summary for run in runs):
            summary[name] = [v for run in runs for v in np.atleast_1d(run.summary[name])]
    if "policy_std" not in summary:
        summary["policy_std"] = [v for run in runs for v in paper.policy_std(run)]
    assessed = [run.summary["evaluation"] for run in runs if "evaluation" in run.summary]
    if assessed:  # seeds without an evaluation are in the rest
        names = set.intersection(*map(set, assessed))
        summary["evaluation"] = {n: [v for e in assessed for v in e[n]] for n in sorted(names)}
    return paper.Run(columns, summary)

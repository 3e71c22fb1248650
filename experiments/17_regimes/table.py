"""results.csv, of the runs in results/ and of other folders' runs of the same settings.

    python experiments/17_regimes/table.py

"limit" is 80 % of the mean over seeds of PPO-16's best return: with 4096 robots for Isaac Lab's task, and
with as many as the regime has for another task, whose returns are another number. "p_vs_ppo16_holm" is
Holm's over all of the table's. "ppo12_difference" is what a 4-step tail has more than PPO without these four
rows; "ppo12_p_holm" is over all tails. "ramp_difference" is what the tail without a ramp has more than that
with it, and "evaluated_difference" what a tail has more than PPO-16, by evaluation.

`best`, the default of commit c27cee7, is of the first batch, and so are the PPO-16 and PPO-24 that it is
compared with. "ppo24_limit" is 80 % of that PPO-24's best return; equal to it is meant within 1.0 of return
(`stats.MARGIN`).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import batches, paper, run, stats

PPO = {"ppo12": 12, "ppo16": 16, "ppo24": 24}
TAILS = ("dyna4_noschedule", "dyna4")
OWN_ROWS = PPO | {"dyna4": 16, "dyna4_noschedule": 16, "best": 24}
VARIANTS = ("ppo12", "ppo16", "dyna4_noschedule", "dyna4", "best", "ppo24")
COLUMNS = (
    "regime variant status seeds max_reward_mean max_reward_low max_reward_high p_vs_ppo16 p_vs_ppo16_holm "
    "ppo12_difference ppo12_difference_low ppo12_difference_high ppo12_p ppo12_p_holm "
    "ramp_difference ramp_difference_low ramp_difference_high ramp_p ramp_p_holm evaluated_difference "
    "evaluated_difference_low evaluated_difference_high evaluated_p evaluated_p_holm evaluated_p_equal "
    "evaluated_p_equal_holm "
    "evaluated_return limit success_rate_pct sim_steps_M_mean "
    "share_of_ppo16_pct share_of_ppo16_low share_of_ppo16_high share_of_ppo16_bound policy_std_mean "
    "ppo24_difference ppo24_difference_low ppo24_difference_high ppo24_p ppo24_p_equal "
    "ppo24_limit ppo24_sim_steps_M_mean ppo24_own_sim_steps_M_mean "
    "ppo24_share_pct ppo24_share_low ppo24_share_high"
).split()


class Regime(NamedTuple):
    """A task and a number of robots."""

    label: str
    envs: int
    fields: str = ""  # of the task, as in a job of run.py


ROBOTS = (512, 1024, 2048, 4096)
TASKS = {
    "the paper's words": "task.formulation=paper_text",
    # the mass is the only parameter of a robot that Isaac Lab varies; this noise is the largest by far
    "less randomness": "task.randomize.base_mass=(0.0,0.0):task.noise.joint_vel=0.0",
}
REGIMES = [Regime(f"R = {envs}", envs) for envs in ROBOTS]
REGIMES += [Regime(f"R = 1024, {label}", 1024, fields) for label, fields in TASKS.items()]


def main():
    make(Path(__file__).parent)


def make(out: Path, regimes=REGIMES) -> None:
    rows = build(out / "results", regimes)
    paper.write(out / "results.csv", rows)
    paper.show(rows, COLUMNS)


def cells() -> list[tuple[Regime, str, int | None]]:
    """What this folder trains: regime, variant and rows, where these are not the variant's own."""
    some = [(r, name, None) for r in REGIMES for name in VARIANTS if name != "best"]
    some = [
        one for one in some if one[0].envs != 4096 or one[1] == "ppo24"
    ]  # 12_platforms has the rest
    here = next(r for r in REGIMES if r.envs == 1024)
    return [*some, *((here, name, n) for n in (20, 24) for name in TAILS), (here, "ppo16", 20)]


def job(regime: Regime, variant: str, rows: int | None = None) -> str:
    """As run.py takes it; `rows` of a rollout, if not the variant's; PPO's are named as in 10_ablation."""
    fields, rows = [f"rollout.num_envs={regime.envs}"], rows or OWN_ROWS[variant]
    if variant in PPO or rows != OWN_ROWS[variant]:
        fields.append(f"rollout.horizon={rows}")
    variant = "ppo16" if variant in PPO else variant
    return ":".join(["go1", variant, *fields, *filter(None, [regime.fields])])


def found(folder: Path, regime: Regime, variant: str, rows: int | None = None) -> paper.Run | None:
    """A run with 25 true epochs and physics by our kernel, all its seeds; `best`'s, see `first`."""
    others, places = Path(__file__).parent.parent, [(folder, run.name(job(regime, variant, rows)))]
    if variant == "best":
        return first(regime, variant)
    if not regime.fields and regime.envs == 4096 and rows in (None, OWN_ROWS[variant]):
        places.append((others / "12_platforms" / "results", f"go1_{variant}"))
    if not regime.fields and variant in PPO:  # lengths that are in a picture only
        places.append((others / "10_ablation" / "results", places[0][1]))
    return next((one for path, name in places if (one := batches.load(path, name))), None)


def first(regime: Regime, variant: str, rows: int | None = None) -> paper.Run | None:
    """The first batch of a run, 2026-11-21 to -23: fewer epochs, physics by MuJoCo Warp.

    Runs of 10_ablation have two of their five seeds by our kernel (PPO-24 with 512, 2048 and 4096 robots).
    """
    here = Path(__file__).parent
    own = run.name(job(regime, variant, rows))
    places = [(here / "earlier", own)]
    if not regime.fields:
        if rows in (None, OWN_ROWS[variant]):
            places.append((here.parent / "20_tail" / "results", f"go1_{variant}_{regime.envs}"))
            if regime.envs == 4096:
                places.append((here.parent / "12_platforms" / "earlier", f"go1_{variant}"))
        places.append((here.parent / "10_ablation" / "results", own))
    return next((one for path, name in places if (one := batches.load(path, name))), None)


def build(folder: Path, regimes) -> list[dict]:
    """A row a regime and variant."""
    rows, usual = [], found(folder, Regime("", 4096), "ppo16")
    for regime in regimes:
        runs = {name: found(folder, regime, name) for name in VARIANTS}
        base = runs["ppo16"]
        known = base if regime.fields else usual
        limit = 0.8 * float(paper.peak(known).mean()) if known and known.columns else None
        rows += [row(regime, name, one, runs, limit) for name, one in runs.items()]
    for name in ("p_vs_ppo16", "ppo12_p", "ramp_p", "evaluated_p", "evaluated_p_equal"):
        stats.adjust(rows, name)
    return rows


def row(regime: Regime, variant: str, one, runs, limit: float | None) -> dict:
    """What a variant came to, and what it took to get to `limit`."""
    cells = {"regime": regime.label, "envs": regime.envs, "variant": variant}
    cells["status"] = paper.status(one)
    shortest, base, longest = (runs[name] for name in PPO)
    how = paper.reached
    if variant == "best":  # of the first batch some runs keep every tenth iteration alone
        how, base, longest = paper.tenth, first(regime, "ppo16"), first(regime, "ppo24")
    if not (one and one.columns):
        return cells
    mine = values(one)
    cells |= paper.returns(one)
    if base and base.columns and one is not base:
        cells["p_vs_ppo16"] = stats.welch_of(paper.peak(one), paper.peak(base))
    if variant in TAILS:
        pairs = {"ppo12": (shortest, "best"), "evaluated": (base, "evaluated")}
        if variant == "dyna4_noschedule":
            pairs["ramp"] = (runs["dyna4"], "best")
        for prefix, (other, kind) in pairs.items():
            if kind in mine and kind in (theirs := values(other)):
                pair = mine[kind], theirs[kind]
                cells |= stats.compare(*pair, stats.MARGIN["go1"], f"{prefix}_")
    if "evaluated" in mine:
        cells["evaluated_return"] = float(np.mean(mine["evaluated"]))
    if longest and longest.columns and variant == "best":
        cells |= beside(one, longest)
    if limit is not None:
        cells |= {"limit": limit} | paper.effort(one, limit, how)
        if base and base.columns and one is not base:
            cells |= paper.against(one, base, limit, how)
    return cells | {"device": one.summary["device"], "date": one.summary["date"]}


def values(one: paper.Run | None) -> dict[str, np.ndarray]:
    """Best returns and those of the last evaluation, a seed each; without what a run does not have."""
    if not (one and one.columns):
        return {}
    some = {"best": paper.peak(one)}
    if "evaluation" in one.summary:
        some["evaluated"] = np.array(one.summary["evaluation"]["return"])
    return some


def beside(one, longest) -> dict:
    """Cells: best returns and simulator steps of `best` against PPO-24's, to 80 % of PPO-24's best."""
    cells = stats.compare(paper.peak(one), paper.peak(longest), stats.MARGIN["go1"])
    high = 0.8 * float(paper.peak(longest).mean())
    share = paper.against(one, longest, high, paper.tenth).items()
    cells |= {n.replace("share_of_ppo16", "share"): v for n, v in share if "share_of" in n}
    cells["limit"] = high
    for who, some in (("", one), ("own_", longest)):
        took = paper.effort(some, high, paper.tenth).items()
        cells |= {f"{who}{name}": value for name, value in took if "steps" in name}
    return {f"ppo24_{name}": value for name, value in cells.items()}


if __name__ == "__main__":
    main()

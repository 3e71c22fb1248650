"""How good the model of a G1 is while it learns: errors of k predictions in a row.

    python experiments/25_humanoid/errors.py [--quick]

Writes results/errors.csv, a row a group, iteration and number of predictions, of `g1:best` with seeds 160 to
164. As in experiments/11_model, whose probe this is: beside training, all robots go on for a rollout by
physics, and the model follows with the same actions. A share is that of the spread over robots; with 1 the
model is worth nothing.
"""

import sys
from itertools import groupby
from pathlib import Path

import numpy as np

from experiments import paper, run

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "11_model"))
import probe  # noqa: E402

SEEDS, STEPS, AT = 5, (1, 4, 20), (10, 40, 80, 120, 160)
SETTINGS = ("run.log_every=10", "run.num_iterations=160", "run.eval_envs=0", "run.seed=160")
SETTINGS += ("run.checkpoint_every=0", "schedule.last_iteration=100000")


def main():
    args = paper.parser(__doc__)
    args.add_argument("--quick", action="store_true", help="the least that runs")
    args = args.parse_args()
    seeds, settings, at = SEEDS, SETTINGS, AT
    if args.quick:
        few = ("run.num_iterations=10", "rollout.num_envs=16", "run.num_seeds=2")
        seeds, settings, at = 2, (*SETTINGS, *few), (10,)
    ask, rows = None, []
    for program, done, state, _ in run.chunks(run.configure("g1:best", seeds, settings), None):
        if done in at:
            ask = ask or probe.compiled(program)
            for s, (rmse, spread) in enumerate(zip(*map(np.asarray, ask(state)), strict=True)):
                rows += probe.rows(done, s, rmse, spread, STEPS)
    by = [row for row in mean(rows)]
    if not args.quick:
        paper.write(HERE / "results" / "errors.csv", by)
    paper.show(by, [*by[0]])


def mean(rows) -> list[dict]:
    """Over seeds: root mean square error in the group's unit, and its share of the spread."""

    def key(row):
        return row["group"], row["iteration"], row["steps"]

    out = []
    for (group, iteration, steps), some in groupby(sorted(rows, key=key), key):
        error, spread = np.array([[float(r["rmse"]), float(r["spread"])] for r in some]).T
        share = (error / spread).mean()
        numbers = {"rmse": f"{error.mean():.3g}", "share": f"{share:.3f}"}
        out.append({"group": group, "iteration": iteration, "steps": steps} | numbers)
    return out


if __name__ == "__main__":
    main()

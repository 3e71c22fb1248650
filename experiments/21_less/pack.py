"""Runs of run.py, packed into one file: a batch is appended, one of the same name replaced.

    python experiments/21_less/pack.py results/fresh.csv.xz BATCH OUT_FOLDER

Seconds are left out: these runs share a card. Refused, and nothing written: a batch that has jobs which
OUT_FOLDER lacks, for they would be lost, and a run that another batch has, for it would count twice.
"""

import csv
import io
import lzma
from pathlib import Path

from experiments import paper

COLUMNS = (
    "batch name job device commit seed iteration sim_steps return fall_rate early tracking_error yaw_error"
).split()
# of training; run.py's `TRAINED`
TRAINED = (
    "falls tail_falls tail_bias model_error_1 model_error_4 model_loss_before policy_std "
    "learning_rate kl"
).split()
# of 28_rough/run.py
CROSSINGS = "terrain_row crossed fell pyramid_stairs pit_stairs boxes random pyramid_slope pit_slope".split()


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("batch")
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    had, new = [], []
    if args.path.exists():
        with lzma.open(args.path, "rt", newline="") as file:
            had = list(csv.DictReader(file))
    for path in sorted(args.folder.glob("*.csv")):
        with path.open(newline="") as file:
            new += [{"batch": args.batch, "name": path.stem} | row for row in csv.DictReader(file)]
    kept = [row for row in had if row["batch"] != args.batch]
    refuse(args, {row["name"] for row in had if row["batch"] == args.batch}, kept, new)
    kept += new
    text = io.StringIO(newline="")
    columns = [name for name in COLUMNS + CROSSINGS + TRAINED if any(name in row for row in kept)]
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(kept)
    args.path.write_bytes(lzma.compress(text.getvalue().encode(), preset=9))


def refuse(args, before: set[str], kept: list[dict], new: list[dict]) -> None:
    """SystemExit where jobs `before` of the batch would be lost, or a run is in a batch that is kept."""
    if lost := sorted(before - {row["name"] for row in new}):
        raise SystemExit(
            f"{args.path}: batch {args.batch!r} has {lost[0]}, which {args.folder} lacks; expected all "
            "jobs of that batch, or another name for a new one"
        )
    columns = "name", "commit", "seed", "iteration", "sim_steps", "return"
    there = {tuple(row.get(name) for name in columns): row["batch"] for row in kept}
    for row in new:
        if batch := there.get(tuple(row.get(name) for name in columns)):
            raise SystemExit(
                f"{args.folder}/{row['name']}.csv is in batch {batch!r} of {args.path}; expected runs that "
                "are in none: take it out of the folder"
            )


if __name__ == "__main__":
    main()

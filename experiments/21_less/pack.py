"""Runs of run.py, packed into one file: a batch is appended, one of the same number replaced.

python experiments/21_less/pack.py results/fresh.csv.xz BATCH OUT_FOLDER

Seconds are left out: these runs share a card.
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
    kept = []
    if args.path.exists():
        with lzma.open(args.path, "rt", newline="") as file:
            kept = [row for row in csv.DictReader(file) if row["batch"] != args.batch]
    for path in sorted(args.folder.glob("*.csv")):
        with path.open(newline="") as file:
            kept += [{"batch": args.batch, "name": path.stem} | row for row in csv.DictReader(file)]
    text = io.StringIO(newline="")
    columns = [name for name in COLUMNS + CROSSINGS + TRAINED if any(name in row for row in kept)]
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(kept)
    args.path.write_bytes(lzma.compress(text.getvalue().encode(), preset=9))


if __name__ == "__main__":
    main()

"""Which tiles the policies in a folder cross: a row of a CSV for each policy, kind and row of tiles.

    python experiments/28_rough/crossing.py OUT_FOLDER [--out crossing.csv] [--tries 1000] [--seed 0]

OUT_FOLDER has NAME.K.npz, as experiments/21_less/run.py --policies writes them. Each policy makes its tries
on tiles of another seed (dynappo/evaluate/crossing.py); policies of one config share a compiled program.
Columns:

    policy, kind, row
    size                    of the kind in that row: m, of stairs and boxes; rise over run, of slopes
    tries, crossed, fell    how many

Policies that are in the CSV are not tried again, so a run that was stopped goes on. Then a table, a line a
policy: the share that crossed, of all tries, and of each kind in all rows and in the middle one; then of
stairs, up and down, with steps of at least 0.10 m and 0.18 m.
"""

import csv
import json
from pathlib import Path

from dynappo.evaluate import crossing, episodes
from dynappo.policy import policy_file
from dynappo.program import devices
from dynappo.terrain import tiles as tiles_lib
from experiments import paper

NAMES = "policy kind row size tries crossed fell".split()
HIGH = 0.10, 0.18  # m, of steps
SHORT = {"pyramid": "pyr", "stairs": "st", "slope": "sl"}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="default: FOLDER/crossing.csv")
    parser.add_argument("--tries", type=int, default=1000, help="of each policy")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    policies = sorted(args.folder.glob("*.npz"))
    if not policies:
        parser.error(f"{args.folder} has no NAME.K.npz; write them by 21_less/run.py --policies")
    devices.own_process()
    out = args.out or args.folder / "crossing.csv"
    rows = read(out)
    done, of_config = {row["policy"] for row in rows}, {}
    with out.open("a", newline="") as file:
        writer = csv.DictWriter(file, NAMES, lineterminator="\n")
        if not rows:
            writer.writeheader()
        for path in policies:
            if path.stem in done:
                continue
            found = measure(path, args.tries, args.seed, of_config)
            writer.writerows(found)
            file.flush()
            print(path.stem, "done", flush=True)
            rows += found
    for line in table(rows):
        print(line)


def read(path: Path) -> list[dict]:
    """The rows that are in the CSV, their counts as numbers."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    whole = "row", "tries", "crossed", "fell"
    return [row | {name: int(row[name]) for name in whole} for row in rows]


def measure(path: Path, tries: int, seed: int, of_config: dict) -> list[dict]:
    """The rows of a policy. `of_config` keeps what is compiled for each config."""
    policy = policy_file.load(path)
    key = json.dumps(policy.config | {"run": None}, sort_keys=True, default=str)
    if key not in of_config:
        of_config[key] = crossing.prepared(policy, tries)
    numbers = of_config[key](policy, seed)
    tiles = crossing.on_other_ground(episodes.settings(policy)).task.tiles
    return [
        dict(policy=path.stem, kind=kind, row=row, size=size(tiles, kind, row)) | counts
        for kind, of_rows in numbers["rows"].items()
        for row, counts in enumerate(of_rows)
    ]


def size(tiles, kind: str, row: int) -> str:
    """What grows from row to row, as a text."""
    name = next((n for n in ("stairs", "boxes", "slope") if n in kind), None)
    if name is None:
        return ""
    return f"{tiles_lib.between(tiles[name], float(tiles_lib.difficulty(tiles)[row])):.4g}"


def table(rows: list[dict]) -> list[str]:
    """The lines of the table."""
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    heads = ["policy", "all", "fell", *map(shortened, kinds)]
    heads += [f"stairs>={high:.2f}" for high in HIGH]
    lines = [heads]
    for policy in policies:
        own = [row for row in rows if row["policy"] == policy]
        middle = (1 + max(row["row"] for row in own)) // 2
        cells = [policy, share(own), share(own, "fell")]
        for kind in kinds:
            of_kind = [row for row in own if row["kind"] == kind]
            cells.append(f"{share(of_kind)}/{share([r for r in of_kind if r['row'] == middle])}")
        stairs = [row for row in own if "stairs" in row["kind"]]
        # a rounded quotient must not count as less
        cells += [share([r for r in stairs if float(r["size"]) >= high - 1e-6]) for high in HIGH]
        lines.append(cells)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in lines]
    return [
        "crossed, % (of a kind: in all rows / in the middle row)",
        *(text.rstrip() for text in texts),
    ]


def shortened(kind: str) -> str:
    return "_".join(SHORT.get(part, part) for part in kind.split("_"))


def share(rows: list[dict], name: str = "crossed") -> str:
    """In %; "-" where there was no try."""
    tries = sum(row["tries"] for row in rows)
    return f"{100 * sum(row[name] for row in rows) / tries:.0f}" if tries else "-"


if __name__ == "__main__":
    main()

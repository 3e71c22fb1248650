"""The table of disturbances.md: falls of eight commands, and tracking error in m/s.

dynappo evaluate go1_deploy --stress --out=OUT    # writes OUT/stress.json, here stress/go1_deploy.json
python experiments/22_deploy/table.py [NAME ...]
"""

import json
from pathlib import Path

from experiments import paper

FOLDER = Path(__file__).parent / "stress"
NAMES = "go1_deploy go1_deploy_menagerie go2_deploy anymal_c_deploy anymal_d_deploy go1".split()


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("names", nargs="*")
    print(table(parser.parse_args().names or NAMES))


def table(names: list[str]) -> str:
    """A row a disturbance, a column a policy."""
    found = {}
    for name in names:
        rows = json.loads((FOLDER / f"{name}.json").read_text())["rows"]
        found[name] = {row["stress"]: row for row in rows}
    order = max(found.values(), key=len)
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for stress in order:
        cells = [cell(found[name].get(stress)) for name in names]
        lines.append(f"| {stress} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(row: dict | None) -> str:
    if row is None:
        return ""
    error = row["tracking_error"]
    return f"{row['falls']}; " + ("-" if error is None else f"{error:.2f}")


if __name__ == "__main__":
    main()

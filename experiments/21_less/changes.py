"""Does a policy stay on its feet when its command changes? In C MuJoCo; falls of `dynappo evaluate`.

    python experiments/21_less/changes.py [POLICY.npz | WORKDIR | NAME ...] [--changes 200] [--seed 0]

Prints a line a policy: falls after changes of command drawn at random, and on the tours of the film and of
the live page (dynappo/evaluate/changes.py). Default: the bundled policies, and with each its `_deploy`.
"""

from dynappo.evaluate import changes
from dynappo.policy import policy_source
from experiments import paper

BUNDLED = [name + kind for kind in ("", "_deploy") for name in paper.ROBOTS]


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("policies", nargs="*", metavar="POLICY")
    parser.add_argument("--changes", type=int, default=changes.NUMBER)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for name in args.policies or BUNDLED:
        print(line(name, args.changes, args.seed), flush=True)


def line(name: str, number: int, seed: int) -> str:
    """A line of one policy."""
    body = policy_source.player(policy_source.load(name)[0])[0]
    found = changes.run(body, number, seed)
    tours = (
        f"{len(tour['fell_at'])} in the tour of the {tour['tour']}" for tour in changes.tours(body)
    )
    return (
        f"{name}: falls after {found['falls']} of {number} changes, in {found['start_falls']} of "
        f"{found['walks']} walks before the first, {', '.join(tours)}"
    )


if __name__ == "__main__":
    main()

"""Does a policy stand when its command changes? A new random command every 2.5 s, in C MuJoCo.

    python experiments/01_four_robots/changes.py [POLICY.npz ...] [--episodes 24]

Prints falls and commands given, of 20 s episodes that end at a fall; default: the bundled policies.
"""

import itertools
from pathlib import Path

import mujoco
import numpy as np
import walk

from dynappo.policy import choice, episode, policy_file
from experiments import paper

SECONDS, EVERY = 20.0, 2.5


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--episodes", type=int, default=24)
    args = parser.parse_args()
    for path in args.paths or [Path("robots") / name / "policy.npz" for name in walk.ROBOTS]:
        print("{}: {} falls, {} commands".format(path, *falls(path, args.episodes)), flush=True)


def falls(path: Path, episodes: int) -> tuple[int, int]:
    """`(falls, commands)`."""
    policy = policy_file.load(path)
    body = choice.body(policy, None)[0]
    act, rng = policy_file.actor(policy.params, policy.activation), np.random.default_rng(0)
    fallen = given = 0
    for _ in range(episodes):
        commands = rng.uniform(-1, 1, (round(SECONDS / EVERY), 3))

        def script(t, commands=commands):
            return commands[int((t + 1e-9) / EVERY)]

        walked = episode.rows(body, mujoco.MjData(body.model), act, script)
        steps = round(SECONDS / episode.period(body))
        end = next(
            (k for k, row in enumerate(itertools.islice(walked, steps)) if row["fell"]), None
        )
        fallen += end is not None
        last = steps - 1 if end is None else end
        given += int(last * episode.period(body) / EVERY) + 1
    return fallen, given


if __name__ == "__main__":
    main()

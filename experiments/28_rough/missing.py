"""What a scan with missing points does to a policy that was trained with all of them, in C MuJoCo.

    python experiments/28_rough/missing.py go2_rough --ground pit_stairs:0.3 --tries 12

Robots are told 0.6 m/s ahead, and up to 0.1 m/s to a side, for 8 s: up the stairs of a pit. A line a share of
points that are missing, drawn anew in each control step ("ahead": all that are more than 0.3 m ahead), and
what they read: 0; what `even` ground at the feet would read (at the median of their heights); or what the
`near` point reads, the nearest that is not missing. Falls, and the mean distance of the others (m ahead).
"""

import itertools

import mujoco
import numpy as np

from dynappo.policy import episode, policy_file, policy_source
from dynappo.terrain import scan
from experiments import paper

SPEED, ASIDE, STEPS = 0.6, 0.1, 400  # m/s; m/s; control steps
CASES, READS = (0.0, 0.1, 0.3, 1.0, "ahead"), ("0", "even", "near")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("policy", help="with a height scan, as go2_rough")
    parser.add_argument("--ground", default="pit_stairs:0.3", help="as of `dynappo play`")
    parser.add_argument("--tries", type=int, default=12)
    args = parser.parse_args()
    policy = policy_source.load(args.policy)[0]
    player, _ = policy_source.player(policy, field=policy_source.ground(policy, args.ground))
    for case, reads in itertools.product(CASES, READS):
        if (case == 0.0 and reads != "0") or (case == 1.0 and reads == "near"):
            continue  # nothing to fill, or nothing to fill it with
        ends = [walk(player, case, reads, seed, args.tries) for seed in range(args.tries)]
        stood = [x for x, fell in ends if not fell]
        name = "ahead" if case == "ahead" else f"{100 * case:.0f} %"
        far = np.mean(stood) if stood else np.nan
        print(
            f"{name:6s} {reads:5s} {len(ends) - len(stood)} of {len(ends)} fell; {far:.1f} m",
            flush=True,
        )


def walk(player, case, reads: str, seed: int, tries: int) -> tuple[float, bool]:
    """Where a robot is at its end (m ahead), and whether it fell."""
    rng, data, points = np.random.default_rng(seed), mujoco.MjData(player.model), scan.points()
    act = policy_file.actor(player.policy.params, player.policy.activation)
    between = np.linalg.norm(points[:, None] - points, axis=-1)
    command = np.array([SPEED, ASIDE * np.linspace(-1, 1, tries)[seed], 0.0])

    def blinded(obs):
        lost = points[:, 0] > 0.31 if case == "ahead" else rng.random(len(points)) < case
        level = data.qpos[player.root[0] + 2] - np.median(episode.foot_heights(player, data))
        seen = obs[-len(points) :].copy()
        if reads == "near":
            seen = seen[np.where(lost, np.inf, between).argmin(1)]
        else:
            seen[lost] = level - scan.BELOW if reads == "even" else 0.0
        return act(np.concatenate([obs[: -len(points)], seen]))

    row = {}
    for row in itertools.islice(episode.rows(player, data, blinded, lambda t: command), STEPS):
        if row["fell"]:
            break
    return float(row["qpos"][player.root[0]]), bool(row["fell"])


if __name__ == "__main__":
    main()

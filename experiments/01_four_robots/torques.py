"""Torques against the motors' limits, and how the feet move, from episodes on C MuJoCo.

    python experiments/01_four_robots/torques.py OUT.csv [--policies DIR]

Episodes of 10 s, the first second left out: commands drawn as in training, and straight ahead at 0.5
and 1.0 m/s. Every part of the robot can touch the floor here.
"""

from pathlib import Path

import mujoco
import numpy as np
import solver
import walk

from dynappo.physics import contacts, robot
from dynappo.policy import policy_file
from experiments import paper

SECONDS, SETTLE = 10.0, 1.0


def full(body, config):
    """The robot's own model, whose parts touch the floor, solved until it has converged."""
    model = robot.physics_model(body, walk.settings(body.name, contacts="full").physics)
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    return model


def episode(body, config, params, command):
    """Arrays `[T, ...]`, one row a substep, of an episode under one `command`; and if it fell."""
    model, act = full(body, config), policy_file.actor(params, config.ppo.activation)
    data, rows, action = mujoco.MjData(model), [], np.zeros(12)
    data.qpos[:] = body.home_qpos
    fixed, linear, ring = contacts.floor_distance(model, body.parts)
    for _ in range(round(SECONDS / 0.02)):
        action = act(walk.look(body, data, command, action))
        for asked, torque, speed in walk.substeps(model, data, body, config, action):
            turned = data.geom_xmat[body.parts][:, 6:]
            drop = fixed + (linear * abs(turned)).sum(-1)
            drop += ring * np.sqrt(np.maximum(1 - turned[:, 2] ** 2, 0))
            lowest = (data.geom_xpos[body.parts, 2] - drop).min()
            feet = data.geom_xpos[body.feet].copy()
            rows.append(
                (asked, torque, speed, feet, lowest, data.qvel[:2].copy(), data.qpos.copy())
            )
        if lowest < 0:
            break
    names = ("asked", "torque", "speed", "feet", "lowest", "velocity", "qpos")
    columns = dict(zip(names, map(np.stack, zip(*rows, strict=True)), strict=True))
    return columns, lowest < 0


def phases(down, timestep):
    """Lengths (s) of the whole phases in the air and on the ground, over all feet."""
    air, ground = [], []
    for foot in down.T:
        ends = np.flatnonzero(np.diff(foot)) + 1
        for first, last in zip(ends[:-1], ends[1:], strict=True):
            (ground if foot[first] else air).append((last - first) * timestep)
    return np.array(air), np.array(ground)


def measures(body, config, episodes):
    """One row of the table over `episodes` (see the README)."""
    task, dt = config.task, config.physics.timestep
    skip = round(SETTLE / dt)
    rows = [{n: c[skip:] for n, c in e.items()} for e in episodes if len(e["torque"]) > skip]
    asked, torque, speed = (
        np.concatenate([r[n] for r in rows]) for n in ("asked", "torque", "speed")
    )
    clipped = abs(asked - torque) > 1e-9
    air, ground, slip, height = [], [], [], []
    for r in rows:
        down = r["feet"][..., 2] < body.foot_radius
        a, g = phases(down, dt)
        air, ground = [*air, *a], [*ground, *g]
        moved = np.linalg.norm(np.diff(r["feet"][..., :2], axis=0), axis=-1) / dt
        slip.append(moved[down[1:] & down[:-1]])
        height.append((r["feet"][..., 2] - body.foot_radius).max(0))
    return {
        "clipped": clipped.mean(),  # of joints and substeps
        "clipped_any": clipped.any(-1).mean(),  # of substeps, at one joint or more
        "torque_max": abs(torque).max(),
        "torque_p99": np.quantile(abs(torque), 0.99),
        "effort_limit": task.effort_limit,
        "speed_max": abs(speed).max(),
        "speed_p99": np.quantile(abs(speed), 0.99),
        "velocity_limit": task.velocity_limit,
        "air": np.mean(air) if air else np.nan,  # s
        "ground": np.mean(ground) if ground else np.nan,
        "slip": np.concatenate(slip).mean(),  # m/s of a foot that is down
        "lift": np.mean(height),  # m, highest point of a foot in an episode
        "lowest": min(r["lowest"].min() for r in rows),  # m, of the parts above the floor
    }


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--robots", default=",".join(walk.ROBOTS))
    parser.add_argument("--policies", type=Path, help="folder of run.py; default: the bundled ones")
    parser.add_argument("--episodes", type=int, default=20)
    args = parser.parse_args()
    commands = np.random.default_rng(0).uniform(-1, 1, (args.episodes, 3))
    straight = {f"{v} m/s": [np.array([v, 0.0, 0.0])] for v in (0.5, 1.0)}
    for name in args.robots.split(","):
        config, body, params = walk.load(name, args.policies)
        for label, some in {"drawn": list(commands), **straight}.items():
            episodes, fell = zip(*[episode(body, config, params, c) for c in some], strict=True)
            row = measures(body, config, episodes)
            speed = np.concatenate([e["velocity"][200:] for e in episodes])
            row |= {"base": np.linalg.norm(speed, axis=-1).mean(), "falls": sum(fell)}
            solver.write(args.out, {"robot": name, "command": label} | row)


if __name__ == "__main__":
    main()

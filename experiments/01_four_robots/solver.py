"""How many solver iterations are enough: error against converged C MuJoCo, and cost, a setting.

    python experiments/01_four_robots/solver.py OUT.csv [--impl warp] [--worlds 4096] [--robots ...]

From the same states of a walking robot (random commands, touch-downs among them), each engine does
one control step (20 ms), and then walks on for one second by itself. Errors are differences to C
MuJoCo, float64, Newton 100 / 50; what the last setting has is the rounding of float32.
"""

import time
from pathlib import Path

import mujoco
import numpy as np
import walk

from dynappo.policy import policy_file
from experiments import paper

SETTINGS = ((1, 4), (2, 4), (2, 8), (3, 8), (4, 4), (4, 8), (5, 8), (6, 8), (10, 20))
STEPS = 50  # control steps, 1 s


def reference(body, config, params, start):
    """`(qvel [K, nv] after one control step, base position [K, 3] after 1 s, touch-downs [K])`."""
    model, act = walk.converged(body, config), policy_file.actor(params, config.ppo.activation)
    data, first, last, landed = mujoco.MjData(model), [], [], []
    for row in zip(*start.values(), strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:], command, action = row
        mujoco.mj_kinematics(model, data)
        air = data.geom_xpos[body.feet, 2] > body.foot_radius
        for k in range(STEPS):
            action = act(walk.look(body, data, command, action))
            for _ in walk.substeps(model, data, body, config, action):
                pass
            if k == 0:
                first.append(data.qvel.copy())
                landed.append((air & (data.geom_xpos[body.feet, 2] < body.foot_radius)).any())
        last.append(data.qpos[:3].copy())
    return np.array(first), np.array(last), np.array(landed)


def measure(body, config, params, start, worlds, impl, repeats):
    """`(qvel after one control step, base position after 1 s, ms of a control step)`."""
    import jax
    import jax.numpy as jnp

    from dynappo.physics import engine as engine_lib

    count = len(start["qpos"])
    tiled = {n: jnp.asarray(np.resize(c, (worlds, *c.shape[1:]))) for n, c in start.items()}
    engine = engine_lib.make(body, config.physics, frozenset(), impl)
    run, bodies = walk.on_mjx(engine, config, params, STEPS), walk.nominal(body, worlds)
    qpos, qvel, _ = jax.block_until_ready(run(bodies, tiled))
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(run(bodies, tiled))
        times.append((time.perf_counter() - began) / STEPS * 1e3)
    return np.array(qvel[0, :count]), np.array(qpos[-1, :count, :3]), np.median(times)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--impl", default="jax")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--robots", default=",".join(walk.ROBOTS))
    parser.add_argument("--policies", type=Path, help="folder of run.py; default: the bundled ones")
    args = parser.parse_args()
    for name in args.robots.split(","):
        config, body, params = walk.load(name, args.policies)
        start = walk.states(body, config, params, args.episodes, seconds=2.1, every=10)
        first, last, landed = reference(body, config, params, start)
        change = np.sqrt(((first - start["qvel"])[:, 6:] ** 2).mean())
        print(
            f"{name}: {len(first)} states, {landed.sum()} touch-downs, joints change {change:.3f}",
            flush=True,
        )
        for iterations, ls_iterations in SETTINGS:
            config = walk.settings(name, iterations=iterations, ls_iterations=ls_iterations)
            qvel, base, ms = measure(
                body, config, params, start, args.worlds, args.impl, args.repeats
            )
            error = qvel - first
            row = dict(robot=name, impl=args.impl, worlds=args.worlds)
            row |= dict(iterations=iterations, ls_iterations=ls_iterations)
            row["joint_rms"] = np.sqrt((error[:, 6:] ** 2).mean())  # rad/s
            row["joint_p99"] = np.quantile(np.abs(error[:, 6:]).max(-1), 0.99)
            row["joint_max"] = np.abs(error[:, 6:]).max()
            row["base_rms"] = np.sqrt((error[:, :3] ** 2).sum(-1).mean())  # m/s
            row["base_max"] = np.sqrt((error[:, :3] ** 2).sum(-1)).max()
            apart = np.linalg.norm(base - last, axis=-1)
            row["apart_median"], row["apart_rms"] = np.median(apart), np.sqrt((apart**2).mean())
            row["ms"] = ms
            write(args.out, row)


def write(path: Path, row: dict) -> None:
    """Append one row to a CSV, with a header if it is new, and print it."""
    row = {n: v if isinstance(v, str) else f"{v:.4g}" for n, v in row.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    new = not path.exists()
    with path.open("a") as file:
        file.write(",".join(row) + "\n" if new else "")
        file.write(",".join(row.values()) + "\n")
    print(*row.values(), flush=True)


if __name__ == "__main__":
    main()

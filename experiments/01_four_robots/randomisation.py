"""What varied physics costs, and that each parameter changes the motion.

    python experiments/01_four_robots/randomisation.py OUT [--impl warp] [--worlds 4096]

Writes OUT/randomisation_cost.csv and OUT/randomisation_motion.csv.

Cost: ms of a control step of all robots walking, with 0, 1, ... fields of the model different for
each robot; the programs take turns, medians. Motion: two robots, equal but for one parameter, at
both ends of its range, repeat the actions of a nominal robot for one second.
"""

import time
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import solver
import walk

from dynappo.physics import engine as engine_lib
from dynappo.physics import randomize
from experiments import paper

STEPS = 50
NONE = dict(
    base_mass=(0.0, 0.0),
    base_com=(0.0, 0.0, 0.0),
    friction=(0.8, 0.8),
    kp_scale=(1.0, 1.0),
    kd_scale=(1.0, 1.0),
)
WIDE = dict(  # ranges that the configs leave collapsed
    base_com=(0.05, 0.05, 0.01),
    friction=(0.4, 1.2),
    kp_scale=(0.8, 1.2),
    kd_scale=(0.5, 2.0),
)
FIELDS = ("base_mass", "base_com", "friction", "kp_scale", "kd_scale")


def ranges(config):
    """The ranges of the robot's config; of a collapsed one, that of `WIDE`."""
    varied = randomize.varied(config.task.randomize)
    own = {n: tuple(getattr(config.task.randomize, n)) for n in FIELDS}
    return {n: own[n] if n in varied else WIDE[n] for n in FIELDS}


def draw(body, bounds, count, seed=0):
    """`count` robots with parameters drawn from `bounds`."""
    mass, com = body.mj_model.body_mass[body.base_body], body.mj_model.body_ipos[body.base_body]
    keys = jax.random.split(jax.random.key(seed), count)
    bounds, com = SimpleNamespace(**bounds), jnp.asarray(com, jnp.float32)
    return jax.vmap(lambda key: randomize.draw(bounds, mass, com, key))(keys)


def cost(body, config, params, worlds, impl, repeats):
    """`{fields varied: ms of a control step}`, each field added to those before it."""
    start = walk.states(body, config, params, episodes=8, seconds=2.1, every=10)
    start = {n: jnp.asarray(np.resize(c, (worlds, *c.shape[1:]))) for n, c in start.items()}
    runs, wide = {}, ranges(config)
    for count in range(len(FIELDS)):  # the gains, last, come together
        some = FIELDS[: count if count < 4 else 5]
        engine = engine_lib.make(body, config.physics, frozenset(some), impl)
        bodies = draw(body, NONE | {n: wide[n] for n in some}, worlds)
        runs["+".join(some) or "none"] = walk.on_mjx(engine, config, params, STEPS), bodies
    times = {name: [] for name in runs}
    for repeat in range(repeats + 1):  # the first compiles
        for name, (run, bodies) in runs.items():
            began = time.perf_counter()
            jax.block_until_ready(run(bodies, start))
            if repeat:
                times[name].append((time.perf_counter() - began) / STEPS * 1e3)
    return {name: float(np.median(t)) for name, t in times.items()}


def motion(body, config, params, impl):
    """`{field: (m between the bases, rad between the joints at most)}` after one second."""
    model = walk.converged(body, config)
    data = mujoco.MjData(model)
    data.qpos[:] = body.home_qpos
    for _ in range(25):
        for _ in walk.substeps(model, data, body, config, np.zeros(12)):
            pass
    one = {n: np.array(getattr(data, n)) for n in ("qpos", "qvel", "qacc_warmstart")}
    one |= {"command": np.array([0.5, 0.0, 0.0]), "last_action": np.zeros(12)}
    start = {n: jnp.asarray(np.stack([c, c]), jnp.float32) for n, c in one.items()}
    engine = engine_lib.make(body, config.physics, frozenset(FIELDS), impl)
    run = walk.on_mjx(engine, config, params, STEPS)
    actions = run(walk.nominal(body, 2), start)[2]
    actions = jnp.broadcast_to(actions[:, :1], actions.shape)
    out = {}
    for name in ("nothing", *FIELDS):
        both = draw(body, NONE, 2)
        if name in ("base_mass", "friction", "kp_scale", "kd_scale"):
            ends = [draw(body, NONE | {name: (end, end)}, 1) for end in ranges(config)[name]]
            both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *ends)
        elif name == "base_com":
            width = jnp.asarray(ranges(config)[name])
            both = both.replace(base_com=both.base_com + jnp.stack([-width, width]))
        qpos = np.array(run(both, start, actions)[0][-1])
        out[name] = np.linalg.norm(qpos[0, :3] - qpos[1, :3]), abs(qpos[0] - qpos[1])[7:].max()
    return out


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--impl", default="jax")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--robots", default=",".join(walk.ROBOTS))
    parser.add_argument("--policies", type=Path, help="folder of run.py; default: the bundled ones")
    args = parser.parse_args()
    for name in args.robots.split(","):
        config, body, params = walk.load(name, args.policies)
        about = {"robot": name, "impl": args.impl}
        ms = cost(body, config, params, args.worlds, args.impl, args.repeats)
        for fields, value in ms.items():
            row = {"worlds": args.worlds, "varied": fields}
            row |= {"ms": f"{value:.4g}", "ratio": f"{value / ms['none']:.3f}"}
            solver.write(args.out / "randomisation_cost.csv", about | row)
        for field, (base, joints) in motion(body, config, params, args.impl).items():
            row = {"parameter": field, "base_m": f"{base:.3g}", "joints_rad": f"{joints:.3g}"}
            solver.write(args.out / "randomisation_motion.csv", about | row)


if __name__ == "__main__":
    main()

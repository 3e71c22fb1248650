"""The ceiling: four physics steps of Go1 by MuJoCo Warp alone, without JAX, and by `mjx.step`.

    python experiments/03_speed/raw.py OUT.json [--worlds 4096,8192,16384,32768] [--states FILE.npz]

Same model, solver iterations and contact buffers as dynappo's (`physics/engine.py`), same states (standing
after a reset; or qpos, qvel and qacc_warmstart of FILE) and constant torques (PD towards the default
pose). MuJoCo Warp replays a CUDA graph of the four steps; `mjx.step` runs in a scan that carries its
data. Each measurement starts from the same states and does 64 physics steps; printed are medians,
ms for four steps.
"""

import json
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx

from dynappo import config as config_lib
from dynappo.physics import contacts
from dynappo.physics import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

STEPS, REPLAYS = 4, 16


def start(config, robot, worlds, states):
    """`(qpos, qvel, qacc_warmstart, torque)`, NumPy."""
    if states:
        loaded = np.load(states)
        names = ("qpos", "qvel", "qacc_warmstart")
        rows = np.arange(worlds) % len(loaded["qpos"])
        qpos, qvel, warm = (loaded[name][rows] for name in names)
    else:
        env = env_lib.make(robot, config.task, config.physics, impl="jax")
        hyper = config_lib.split(config)[1]
        keys = jax.random.split(jax.random.key(0), worlds)
        body = jax.vmap(env.randomize, (None, 0))(hyper, keys)
        state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
        qpos, qvel, warm = (
            np.asarray(getattr(state, k)) for k in ("qpos", "qvel", "qacc_warmstart")
        )
    torque = config.task.kp * (robot.default_pose - qpos[:, 7:]) - config.task.kd * qvel[:, 6:]
    return qpos, qvel, warm, np.asarray(torque, np.float32)


def by_warp(config, robot, worlds, first, repeats, conditional=True):
    """ms of each repeat, for four steps."""
    import warp as wp
    from mujoco.mjx.third_party import mujoco_warp as mjw

    model = robot_lib.physics_model(robot, config.physics)
    touching, rows = contacts.most(model)
    m = mjw.put_model(model)
    m.opt.warn_overflow = 0
    m.opt.graph_conditional = conditional
    d = mjw.make_data(model, nworld=worlds, naconmax=worlds * touching, njmax=rows)
    arrays = [wp.array(x, dtype=float) for x in first]

    def begin():
        for own, x in zip((d.qpos, d.qvel, d.qacc_warmstart, d.ctrl), arrays, strict=True):
            wp.copy(own, x)

    begin()
    mjw.step(m, d)  # compiles
    with wp.ScopedCapture() as capture:
        for _ in range(STEPS):
            mjw.step(m, d)
    times, iterations = [], []
    for _ in range(repeats + 1):
        begin()
        wp.synchronize()
        began = time.perf_counter()
        for _ in range(REPLAYS):
            wp.capture_launch(capture.graph)
        wp.synchronize()
        times.append((time.perf_counter() - began) / REPLAYS * 1e3)
        iterations.append(float(d.solver_niter.numpy().mean()))
    return times[1:], iterations[-1]


def by_mjx(config, robot, worlds, first, repeats):
    """ms of each repeat, for four steps."""
    model = robot_lib.physics_model(robot, config.physics)
    touching, rows = contacts.most(model)
    template = mjx.make_data(model, impl="warp", naconmax=worlds * touching, njmax=rows)
    model = mjx.put_model(model, impl="warp").tree_replace({"opt._impl.warn_overflow": 0})
    qpos, qvel, warm, torque = map(jnp.asarray, first)

    @jax.jit
    def run(qpos, qvel, warm, torque):
        data = jax.vmap(lambda _: template)(qpos)
        data = data.replace(qpos=qpos, qvel=qvel, qacc_warmstart=warm, ctrl=torque)

        def step(data, _):
            return jax.vmap(mjx.step, (None, 0))(model, data), None

        data = jax.lax.scan(step, data, None, length=STEPS * REPLAYS)[0]
        return data.qpos, data.qvel, data._impl.solver_niter

    times = []
    for _ in range(repeats + 2):
        began = time.perf_counter()
        out = jax.block_until_ready(run(qpos, qvel, warm, torque))
        times.append((time.perf_counter() - began) / REPLAYS * 1e3)
    return times[2:], float(out[2].mean())


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--worlds", default="4096,8192,16384,32768")
    parser.add_argument("--states")
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    import warp as wp

    config = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
    robot = robot_lib.load(config.robot)
    result = {
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
        "warp": wp.config.version,
        "iterations": config.physics.iterations,
        "ls_iterations": config.physics.ls_iterations,
        "states": args.states or "standing",
        "worlds": {},
    }
    args.out.parent.mkdir(parents=True, exist_ok=True)
    for worlds in map(int, args.worlds.split(",")):
        first = start(config, robot, worlds, args.states)
        row = result["worlds"][worlds] = {}
        for name, function in (
            ("mujoco_warp", by_warp),
            ("mujoco_warp_fixed", lambda *a: by_warp(*a, conditional=False)),
            ("mjx.step", by_mjx),
        ):
            began = time.perf_counter()
            times, iterations = function(config, robot, worlds, first, args.repeats)
            row[name] = {
                "ms": times,
                "median_ms": float(np.median(times)),
                "solver_iterations": iterations,
                "seconds": time.perf_counter() - began,
            }
        args.out.write_text(json.dumps(result, indent=1))
        for name, v in row.items():
            print(
                f"{worlds:6d} {name:18s} {v['median_ms']:7.3f} ms  {min(v['ms']):7.3f}  "
                f"{v['solver_iterations']:.2f} iterations, set-up {v['seconds']:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""How well a tail knows where its robot is, and so the ground: real against imagined, step after step.

    python experiments/28_rough/scan.py go2:rough --iterations 100 --steps 16 [--out FILE.csv]

Trains so many iterations, then has every robot act for `--steps` rows in physics, without noise, and the
model predict these from the first row and the same actions (`dynamics.predict`, one after the other). A line
a step, over the robots whose episode goes on, of what the tail looked up less what there was:

    position (m) and yaw (rad): root mean squares; feet, scan: middle and 95 % quantile of |error| (m); and
    the same of a scan that is kept as it was in the first row (`frozen`)
"""

import csv
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm, fast, rollout, schedule
from dynappo import config as config_lib
from dynappo.model import dynamics
from dynappo.program import build, devices
from dynappo.scores import nominal
from dynappo.tasks.velocity import surroundings
from dynappo.terrain import tiles
from experiments import paper

NAMES = "step seconds robots position yaw feet feet_95 scan scan_95 frozen frozen_95".split()


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("spec", help="ROBOT:VARIANT with task.terrain=rough, task.scan=grid")
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--steps", type=int, default=16)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    devices.own_process()
    config = config_lib.load(args.spec)
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    config.run.update(num_iterations=args.iterations, log_every=args.iterations, num_seeds=1)
    config.run.update(eval_envs=0, eval_every=0, checkpoint_every=0)
    rows = measure(config_lib.validate(config), args.steps)
    with open(args.out, "w", newline="") if args.out else sys.stdout as file:
        writer = csv.DictWriter(file, NAMES, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def measure(config, steps: int) -> list[dict[str, float]]:
    """The rows of the table, after the config's iterations."""
    program = build.program(config)
    columns = schedule.columns(config)
    state, _ = program.step(program.hyper, program.state, columns)
    static, hyper = program.static, nominal(program.hyper)
    around = surroundings.make(
        program.robot, config.task, config.physics, tiles.make(config.task.tiles)
    )
    both = partial(real_and_imagined, program.env, around, static=static, steps=steps)
    real, imagined, alive = jax.device_get(jax.jit(both)(hyper, state, jax.random.key(1)))
    first = program.env.obs_size - surroundings.size(around)
    where = surroundings.places(around)
    out, size = [], program.env.dt
    start = real[0][:, first:][:, where["scan"]]
    for k in range(steps):
        on = alive[k] > 0
        true, found = (x[:, first:][on] for x in (real[k + 1], imagined[k]))
        off = {name: np.abs(found - true)[:, part] for name, part in where.items()}
        off["frozen"] = np.abs(start[on] - true[:, where["scan"]])
        place, yaw = off["pose"][:, :3], off["pose"][:, 3]
        yaw = np.abs((yaw + np.pi) % (2 * np.pi) - np.pi)
        row = dict(step=k + 1, seconds=(k + 1) * size, robots=int(on.sum()))
        row |= dict(position=rms(np.linalg.norm(place, axis=-1)), yaw=rms(yaw))
        for name in ("feet", "scan", "frozen"):
            row |= {name: np.median(off[name]), f"{name}_95": np.quantile(off[name], 0.95)}
        out.append({name: f"{value:.4g}" for name, value in row.items()})
    return out


def rms(x) -> float:
    return float(np.sqrt((x**2).mean()))


def real_and_imagined(env, around, hyper, state, key, *, static, steps: int):
    """`(real [steps + 1, R, O], imagined [steps, R, O], alive [steps, R])` under the same actions."""
    rows, _, _ = fast.fill(
        rollout.allocate(env, steps, static.rollout.num_envs),
        begin=jnp.int32(0),
        end=jnp.int32(steps),
        state=state.env_state,
        keys=rollout.row_keys(key, state.robot_index),
        act=algorithm.policy(static, env, state.learner.params),
        step=algorithm.physics_step(env, hyper, state.params_physics),
    )
    # before the first row there was noise
    at, first = state.env_state, env.obs_size - surroundings.size(around)
    exact = partial(surroundings.exact, around)
    there = jax.vmap(exact)(at.qpos, at.qvel, at.goal, at.scan_shift)
    start = jnp.concatenate([at.prop, at.obs[:, env.prop_size : first], there], -1)

    def predict(obs, action):
        obs = dynamics.predict(static, hyper, env, state.model, obs, action)[0]
        return obs, obs

    _, imagined = jax.lax.scan(predict, start, rows.action)
    alive = jnp.cumprod(rows.discount * (1 - rows.truncation), axis=0)
    return jnp.concatenate([start[None], rows.next_obs]), imagined, alive


if __name__ == "__main__":
    main()

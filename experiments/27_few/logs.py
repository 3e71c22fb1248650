"""Fine-tuning from one robot's log: return before and after, and what the true simulator would give.

    python experiments/27_few/logs.py OUT_FOLDER [FIELD=VALUE ...] [--cases payload motors friction]
        [--seconds 80 200 600] [--seeds 0 1] [--noise 0.2] [--sensors 0.2] [--every 20] [--bound]
        [--deployments 1] [--restore RUN] [--name NAME]

No hardware: the robot is a second simulator, C MuJoCo with all contacts and a solver that converges, in which
`CASES` differ from what the policy trained with. It walks under the bundled go1 policy and `--noise`, the
standard deviation on each action; `--sensors` is the noise on its readings, times that of training. What it
recorded is all that the fine-tuning (`go1:logs`) sees of it. The policy is evaluated in the changed simulator
every `--every` iterations, without noise: the first row is before. With `--bound` the same policy is trained
in the changed simulator itself instead (`go1:best`, or what FIELDs make of it), and no log is read.

With `--deployments N` the fine-tuned policy walks for as long again, its log is added, and it is fine-tuned
on all of it, until it has walked N times. `--restore` is a run whose value function and model are taken, too.

Writes OUT_FOLDER/NAME-CASE-SECONDS-SEED.csv, a row an evaluation; those that are there are skipped.
`model_error` is the model's after one step, on a log of the same robot that it never saw, relative to no
change.
"""

from __future__ import annotations

import csv
import math
import time
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm, schedule, scores
from dynappo import config as config_lib
from dynappo.config import fields
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.evaluate import recording
from dynappo.evaluate.stress import Stress, disturbed
from dynappo.model import errors
from dynappo.policy import policy_source
from dynappo.program import build, devices
from dynappo.run import restore
from dynappo.tasks import of_robots
from experiments import paper

CASES = {  # how the robot differs: kg on its base, share of the torque, friction of its feet
    "payload": Stress("8 kg more", mass=8.0),
    "motors": Stress("motors at 60 %", motors=0.6),
    "friction": Stress("friction 0.4", friction=0.4),
    "none": Stress("nothing changed"),
}
POLICY = "go1"
UNSEEN = 9000  # seed of the log that the model never sees
MEASURED = "return", "fall_rate", "tracking_error", "yaw_error"
SHOWN = (
    "model_loss",
    "model_error_1",
    "tail_bias",
    "tail_falls",
    "policy_std",
    "kl",
    "learning_rate",
)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("fields", nargs="*", metavar="FIELD=VALUE")
    parser.add_argument(
        "--cases",
        nargs="+",
        choices=["payload", "motors", "friction", "none"],
        default=["payload", "motors", "friction"],
    )
    parser.add_argument("--seconds", nargs="+", type=int, default=[80, 200, 600])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--noise", type=float, default=0.2)
    parser.add_argument("--sensors", type=float, default=0.2)
    parser.add_argument("--every", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--bound", action="store_true")
    parser.add_argument("--deployments", type=int, default=1)
    parser.add_argument("--name", default="")
    parser.add_argument(
        "--restore", type=Path, help="a run to start from, in place of the bundled policy"
    )
    args = parser.parse_intermixed_args()
    devices.own_process()
    args.out.mkdir(parents=True, exist_ok=True)
    name = args.name or ("bound" if args.bound else "logs")
    for case in args.cases:
        for seconds in [0] if args.bound else args.seconds:
            for seed in args.seeds:
                to = args.out / f"{name}-{case}-{seconds}-{seed}.csv"
                if not to.exists():
                    run(to, args, case, seconds, seed)


def run(to: Path, args, case: str, seconds: int, seed: int) -> None:
    """Fine-tune once, and write TO."""
    config = config_lib.load(f"{POLICY}:{'best' if args.bound else 'logs'}")
    for field in args.fields:
        config_lib.override(config, *field.split("=", 1))
    log_every = math.gcd(args.every, config.run.num_iterations)
    config.run.update(seed=seed, log_every=log_every, eval_envs=0)
    change, took, done, rows = CASES[case], 0.0, 0, []
    state: Any = None
    if args.bound:
        changed(config, change)
    assess, unseen = evaluator(config, change, args.episodes), lambda model: math.nan
    arrays: dict[str, np.ndarray] = {}

    def look():
        about = dict(job=" ".join([to.stem, *args.fields]), case=case, seed=seed)
        about |= dict(noise=args.noise, sensors=args.sensors, iteration=done)
        about |= dict(log_seconds=len(arrays["time"]) * 0.02 // 1 if arrays else 0)
        about |= dict(sim_steps=int(steps[done - 1]) if done and args.bound else 0)
        found = assess(state.learner.params) | {"model_error": unseen(state.model), "seconds": took}
        about |= {
            name: f"{float(found[name]):.4g}" for name in (*MEASURED, "model_error", "seconds")
        }
        rows.append(about)
        print(", ".join(f"{name} {value}" for name, value in about.items()), flush=True)

    for deployment in range(args.deployments):
        if not args.bound:
            acts = None if state is None else jax.device_get(state.learner.params)
            arrays = joined(arrays, recorded(args, case, seconds, seed + 100 * deployment, acts))
            config.run.logs = str(to.with_suffix(f".{deployment}.npz").resolve())
            recording.save(Path(config.run.logs), the_robot(case), arrays)
        valid = config_lib.validate(config)
        build.check(valid)
        program = build.program(valid)
        if state is None:
            source = args.restore or policy_source.locate(POLICY)
            restore.check(source, valid)
            first = restore.weights(source, valid, program.state)[1]
        else:
            first = program.state.replace(learner=state.learner, model=state.model)
        state, steps = program.place(first), schedule.sim_steps(valid)
        if not args.bound and not deployment:
            unseen = model_error(config, args, case, to.with_suffix(".unseen.npz"))
        if not done:
            look()
        for begin in range(0, config.run.num_iterations, args.every):
            chunk = slice(begin, begin + args.every)
            columns = {name: column[chunk] for name, column in program.columns.items()}
            began = time.perf_counter()
            state, metrics = jax.block_until_ready(program.step(program.hyper, state, columns))
            took += time.perf_counter() - began
            done += len(columns["iteration"])
            print({n: round(float(metrics[n][-1]), 4) for n in SHOWN if n in metrics}, flush=True)
            look()
    with to.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def the_robot(case: str, params=None):
    """The robot of a case, under the bundled policy or another's parameters."""
    policy, _ = policy_source.load(POLICY)
    policy = policy if params is None else policy._replace(params=params)
    return disturbed(policy_source.player(policy)[0], CASES[case])


def recorded(args, case: str, seconds: int, seed: int, params=None) -> dict[str, np.ndarray]:
    """What the robot of a case records."""
    player, strength = the_robot(case, params), CASES[case].motors
    return recording.record(player, seconds, args.noise, args.sensors, seed=seed, strength=strength)


def joined(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Two logs as one, with a gap between them."""
    if not one:
        return other
    later = other | {"time": other["time"] + one["time"][-1] + recording.GAP}
    return {name: np.concatenate([one[name], later[name]]) for name in one}


def changed(config, change: Stress) -> None:
    """Make the config's simulator that of a case, all of whose robots are the same."""
    one = config.task.randomize
    one.update(base_mass=(change.mass, change.mass), strength=(change.motors, change.motors))
    friction = one.friction[0] if change.friction is None else change.friction
    one.friction = (friction, friction)


def evaluator(config, change: Stress, episodes: int):
    """`assess(params) -> metrics` of episodes of 20 s in the changed simulator, without noise."""
    config = fields.copied(config)
    changed(config, change)
    config.run.logs = ""
    config.task.noise.update({name: 0.0 for name in config.task.noise})
    config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(config.robot))
    env = of_robots.make(config, robot, impl=devices.engine(config))
    static, hyper = config_lib.split(config)
    of = partial(
        scores.evaluate, env, static=static, num_envs=episodes, num_steps=1000, randomize=True
    )
    compiled = jax.jit(of)
    return lambda params: jax.device_get(compiled(hyper, params, jax.random.key(0)))


def model_error(config, args, case: str, to: Path):
    """`error(model)` after one step, of the rows of another log, which is written to TO."""
    recording.save(to, the_robot(case), recorded(args, case, 80, UNSEEN))
    config = fields.copied(config)
    config.run.logs = str(to.resolve())
    config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(config.robot))
    impl = devices.engine(config)
    env = of_robots.logged(config, robot, of_robots.make(config, robot, impl=impl))
    static, hyper = config_lib.split(config)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))

    @jax.jit
    def error(state, model):
        rows = algorithm.collect(env, hyper, state, jnp.int32(1), jax.random.key(1), static=static)[
            0
        ]
        return errors.errors(static, hyper, env, model, rows, 1)["model_error_1"]

    return lambda model: error(state, model)


if __name__ == "__main__":
    main()

"""A policy for a robot's sensors, taught by one that sees the state: distillation on the student's own steps.

    python experiments/29_student/student.py student.npz [--teacher go1] [--config go1:best] [--steps 500000]

The student walks in the task of `--config` with the onboard observation: what a robot measures, of the last
five steps. In every state that it meets the teacher says what it would have done there, and the student
learns to say the same, by least squares (DAgger, Ross et al. 2011; the student acts from the first step on).
The teacher sees the state as it is, without noise. `student.npz` is a policy like any other: `dynappo
evaluate`, `play` and `export` take it. One iteration is one call of a compiled program. The page:
docs/student.md.
"""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dynappo import algorithm, scores
from dynappo import config as config_lib
from dynappo.config import ConfigError, flags
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.learner import networks
from dynappo.policy import policy_file, policy_source
from dynappo.program import devices
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import observe
from experiments import paper

ROWS, EPOCHS, BATCHES = (
    24,
    4,
    6,
)  # of an iteration, each robot's; passes over them, minibatches of a pass
ONBOARD = "task.observation=onboard", "task.history=5", "ppo.precision=highest"


class Student(NamedTuple):
    params: Any
    opt_state: Any
    robots: Any


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--teacher", default="go1", help="a policy that sees the whole observation")
    parser.add_argument("--config", default="go1:best", help="of the student's task")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--robots", type=int, default=512)
    parser.add_argument("--steps", type=int, default=500_000, help="of the simulator")
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    flags.answer(lambda: teach(args))


def teach(args) -> None:
    """Distil the teacher of a command line, and write the student; ConfigError before all compiling."""
    for name in ("steps", "robots"):
        flags.whole(name, str(getattr(args, name)), 1)
    config = flags.load(args.config, [f"--config.{text}" for text in (*ONBOARD, *args.set)])
    config = config_lib.validate(config)
    fitted, robot = motors.fitted(config, robot_lib.load(config.robot))
    teacher, _ = policy_source.load(args.teacher)
    check(teacher, args.teacher, config, robot)
    devices.own_process(config.run.device)
    env = env_lib.make(robot, fitted.task, fitted.physics, impl=devices.engine(config))
    static, hyper = config_lib.split(fitted)
    count = max(1, args.steps // (args.robots * ROWS))
    print(
        f"teacher {args.teacher}, student {args.config} ({networks.input_sizes(static, env)[0]} inputs), "
        f"{count} iterations; compiles first",
        flush=True,
    )
    begin, learn = parts(env, static, hyper, teacher, args)
    begin_key, key = jax.random.split(jax.random.key(args.seed))
    student = begin(begin_key)
    evaluate = jax.jit(partial(scores.evaluate, env, static=static, num_envs=200, num_steps=1000))
    for i in range(count):
        student, error = learn(student, jax.random.fold_in(key, i))
        if (i + 1) % max(1, count // 10) == 0:
            found = jax.device_get(evaluate(hyper, student.params, jax.random.key(7)))
            away = float(error) ** 0.5
            print(
                f"{(i + 1) * args.robots * ROWS} steps: within {away:.3f} of the teacher's action,",
                told(found),
                flush=True,
            )
    far = dict(iteration=count, sim_steps=count * args.robots * ROWS)
    policy_file.save(args.out, jax.device_get(student.params), config, robot, **far)


def check(teacher: policy_file.Policy, name: str, config, robot: robot_lib.Robot) -> None:
    """ConfigError where the teacher is of another robot than the student, or sees other numbers than those
    that `labels` gives it: one reading of the whole state."""
    if config.task.terms:
        raise ConfigError(
            f"task.terms is {config.task.terms!r}, expected '': a student has no terms of one's own"
        )
    clock = config.task.gait_frequency is not None
    state = observe.name("full", len(robot.joint_names), clock)
    of = f"--teacher={name}"
    if (teacher.robot, teacher.joint_names) != (robot.name, robot.joint_names):
        raise ConfigError(f"{of} is a policy of {teacher.robot}; expected one of {robot.name}")
    if (teacher.observation, teacher.history, teacher.scan) != (state, 1, "none"):
        inputs = len(teacher.params["actor"]["params"]["Dense_0"]["kernel"])
        sees = f"{inputs} numbers, {teacher.observation}"
        sees += f", {teacher.history} readings" * (teacher.history > 1)
        sees += ", a height scan" * (teacher.scan != "none")
        raise ConfigError(
            f"{of} sees {sees}; expected one that sees the state, 1 reading of {state}"
        )
    check_actions(teacher, of, policy_file.describe(config, robot))


def check_actions(teacher: policy_file.Policy, of: str, student: policy_file.Policy) -> None:
    """ConfigError where an action of the teacher is another motion of the student: another joint angle, other
    gains, another time until the next."""
    for name in ("action_scale", "kp", "kd", "default_pose"):
        theirs, ours = (np.ravel(getattr(policy, name)) for policy in (teacher, student))
        theirs, ours = np.broadcast_arrays(theirs, np.broadcast_to(ours, len(student.joint_names)))
        off = np.flatnonzero(~np.isclose(theirs, ours, 1e-5, 1e-6))
        if len(off):
            joint, pose = student.joint_names[off[0]], name == "default_pose"
            more = f" and at {len(off) - 1} joints more" * (len(off) > 1)
            own = f"{theirs[0]:g}" if (theirs == theirs[0]).all() else "the teacher's"
            cure = "take a teacher of this robot's file" if pose else f"--set task.{name}={own}"
            field = name if pose else f"task.{name}"
            raise ConfigError(
                f"{of} was trained with {field} {theirs[off[0]]:g} at {joint}, and the student has "
                f"{ours[off[0]]:g}{more}: the same action would be another motion; {cure}"
            )
    theirs, ours = (policy.timestep * policy.substeps for policy in (teacher, student))
    if not np.isclose(theirs, ours):
        raise ConfigError(
            f"{of} acts every {theirs:g} s and the student every {ours:g} s, by physics.timestep and "
            "physics.substeps: the same action would be another motion; take the teacher's"
        )


def told(found) -> str:
    error, falls = found["tracking_error"], found["fall_rate"]
    return f"return {found['return']:.1f}, falls {falls:.1%}, error {error:.3f} m/s"


def parts(env, static, hyper, teacher, args):
    """`begin(key) -> Student`, `learn(student, key) -> Student, mean squared error` of the last minibatch."""
    adam = optax.adam(args.rate)
    label = labels(env, static, teacher)

    def begin(key):
        body_key, reset_key, net_key = jax.random.split(key, 3)
        bodies = jax.vmap(env.randomize, (None, 0))(hyper, jax.random.split(body_key, args.robots))
        robots = jax.vmap(env.reset, (None, 0, 0))(
            hyper, bodies, jax.random.split(reset_key, args.robots)
        )
        sizes = networks.input_sizes(static, env)
        params = networks.init_policy(static, hyper, sizes[0], env.action_size, net_key, sizes[1])
        return Student(params, adam.init(params["actor"]), (bodies, robots))

    def learn(student: Student, key):
        bodies, robots = student.robots
        act = scores.mean_actions(env, static, student.params)
        advance = algorithm.physics_step(env, hyper, bodies)

        def row(robots, t):
            keys = jax.random.split(jax.random.fold_in(key, t), args.robots)
            seen, _ = networks.inputs(static, env, robots.obs, robots.prop)
            told = label(robots)
            return advance(robots, act(robots), keys)[0], (seen, told)

        robots, rows = jax.lax.scan(row, robots, jnp.arange(ROWS))
        seen, told = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), rows)

        def loss(actor, batch):
            said = networks.policy(static, student.params | {"actor": actor}, batch[0])
            return ((said - batch[1]) ** 2).mean()

        def minibatch(carry, which):
            actor, opt_state = carry
            error, grads = jax.value_and_grad(loss)(actor, (seen[which], told[which]))
            change, opt_state = adam.update(grads, opt_state)
            return (optax.apply_updates(actor, change), opt_state), error

        orders = [
            jax.random.permutation(jax.random.fold_in(key, ROWS + e), len(seen))
            for e in range(EPOCHS)
        ]
        which = jnp.concatenate(orders).reshape(EPOCHS * BATCHES, -1)
        start = student.params["actor"], student.opt_state
        (actor, opt_state), errors = jax.lax.scan(minibatch, start, which)
        return Student(student.params | {"actor": actor}, opt_state, (bodies, robots)), errors[-1]

    return jax.jit(begin), jax.jit(learn)


def labels(env, static, teacher: policy_file.Policy):
    """`label(robots) -> actions` of the teacher, which sees the exact numbers of observe.py."""
    layers = teacher.params["actor"]["params"]
    sizes = tuple(layers[f"Dense_{i}"]["bias"].shape[-1] for i in range(len(layers)))
    network = networks.MLP(sizes, teacher.activation)
    inputs = layers["Dense_0"]["kernel"].shape[0]

    def label(robots):
        exact = jnp.concatenate([robots.prop, robots.obs[..., env.prop_size : inputs]], -1)
        said = networks.apply(network, {"params": layers}, exact)
        return jnp.clip(said, -networks.MAX_MEAN, networks.MAX_MEAN)

    return label


if __name__ == "__main__":
    main()

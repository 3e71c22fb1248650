"""Whether a robot can learn the velocity task as a config has it. JAX starts only for terms of one's own."""

from __future__ import annotations

import numpy as np

from dynappo.config import per_joint, split
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import gait, observe, own, partners, reward_sum


def check(config, robot: robot_lib.Robot) -> None:
    """ConfigError where the robot's masses, feet or motors do not fit the config's group `task`, or terms
    of the reward their weights. Terms of one's own are traced."""
    task = config.task
    robot_lib.check_base_mass(robot, task.randomize.base_mass)
    gait.check(task.gait_frequency, robot.name, len(robot.foot_names))
    own.check(task, config.ppo.symmetry)
    used = reward_sum.terms_of(task)
    if config.ppo.symmetry:
        partners.check_motors(task, robot)
    if task.terms:
        _try_terms(config, robot, used)


def _try_terms(config, robot: robot_lib.Robot, used: reward_sum.Terms) -> None:
    """ConfigError for a term of one's own that JAX cannot trace or play cannot call, or that returns what
    it should not."""
    import jax

    from dynappo.physics import engine  # they start JAX
    from dynappo.tasks.velocity import env

    joints, feet = len(robot.joint_names), len(robot.foot_names)
    made = own.make(config.task, joints, config.physics.substeps * config.physics.timestep)
    sizes: dict[str, tuple[int, ...]] = dict.fromkeys(own.SCALARS, ())
    sizes |= dict.fromkeys(own.OF_JOINTS, (joints,)) | dict.fromkeys(own.OF_FEET, (feet,))
    sizes |= dict.fromkeys(("foot_position", "foot_velocity"), (feet, 3))
    sizes |= {"qpos": (7 + joints,), "qvel": (6 + joints,)}
    sizes["lowest"] = (len(env.ground_rules(robot, config.task)[1]),)
    sizes["obs"] = (observe.size(joints, True, made.seen),)
    sizes["draw"] = (made.terms.command.how.draws if made.terms.command else 0,)
    kinds = dict.fromkeys(own.BOOLS, np.bool_) | {"episode_steps": np.int32}

    def each(hyper, facts):
        facts |= own.numbers(hyper._replace(task=engine.per_joint_arrays(hyper)))
        own.tried(made, used, facts)

    facts = {n: jax.ShapeDtypeStruct(x, kinds.get(n, np.float32)) for n, x in sizes.items()}
    jax.eval_shape(each, split(config)[1], facts)
    given = {**config.task, **config.task.own}
    given |= {n: np.array(given[n]) for n in per_joint.names() if isinstance(given[n], tuple)}
    several = [
        {n: np.asarray(draw(x), kinds.get(n))[()] for n, x in sizes.items()} | given
        for draw in (np.zeros, np.random.default_rng(0).random)
    ]
    own.tried_in_numpy(made, used, several, own.numbers_in(config.task))

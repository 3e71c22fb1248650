"""The bundled robot walks by its policy and that policy's noise, and a model learns: PPO never runs.

What 18_rollouts and 20_tail/offline.py share.
"""

from functools import partial

import jax
import jax.numpy as jnp

from dynappo import algorithm
from dynappo import config as config_lib
from dynappo.config import files
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import env as env_lib

WARM, EPOCHS = 25, 5  # iterations until the robots walk; passes of a fit


def configure(robots: int, fields=()):
    """`best` in float32 with so many robots, and `fields` (FIELD=VALUE) set."""
    config = config_lib.load("configs/go1.py:best")
    config.rollout.num_envs = robots
    config.model.precision = config.ppo.precision = "highest"
    for text in fields:
        config_lib.override(config, *text.split("=", 1))
    return config_lib.validate(config)


def walker(config, iterate):
    """`walk(seed, iterations)`, which yields what `iterate(env, hyper, state, iteration, epochs, static)`
    finds beside the next state. In the first `WARM` iterations there are no epochs."""
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot_lib.load(config.robot), config.task, config.physics)
    bundled = policy_file.load_params(files.find("robots", f"{config.robot}/policy.npz"))
    bundled = jax.tree.map(jnp.asarray, {name: bundled[name] for name in ("actor", "std")})
    step = jax.jit(partial(iterate, env, static=static))

    def walk(seed: int, iterations: int):
        state = algorithm.init(env, hyper, jax.random.key(seed), static=static)
        params = state.learner.params | bundled
        state = state.replace(learner=state.learner.replace(params=params))
        for i in range(iterations):
            epochs = EPOCHS if i >= WARM else 0
            state, found = step(hyper, state, jnp.int32(i), jnp.int32(epochs))
            yield jax.device_get(found)

    return walk

"""One of brax's environments by its name, on its spring pipeline.

    python -m dynappo.train --config=brax:hopper
    python -m dynappo.train --config=brax:hopper:ppo

All of the observation is predicted. The settings are those of experiments/02_brax, which were not tuned;
`ppo` is the same without a model.
"""

import pathlib
import runpy

from dynappo.tasks import names

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))


def get_config(variant=""):
    """The config of "NAME" or "NAME:ppo"."""
    name, _, variant = variant.partition(":")
    if variant not in ("", "best", "ppo"):
        raise ValueError(f"variant {variant!r} is not one of best, ppo")
    names.check_brax(name)
    config = default["defaults"]()
    config.robot, config.env = "", f"brax:{name}"
    config.physics.impl = "jax"
    config.rollout.update(num_envs=256, horizon=24)
    config.schedule.update(start_iteration=0, end_iteration=40, start_steps=0, end_steps=4)
    config.model.update(hidden=(128, 128), epochs=4, minibatches=8)
    config.ppo.update(entropy_coef=0.0, init_std=0.5)
    config.run.update(num_iterations=150, eval_envs=128)
    if variant == "ppo":
        config.schedule.update(end_iteration=0, end_steps=0)
    return config

"""A locomotion task of MuJoCo Playground 0.2.0, by its name (docs/environment.md).

    python -m dynappo.train --config=playground:Go1JoystickFlatTerrain
    python -m dynappo.train --config=playground:G1JoystickFlatTerrain:ppo

| variant          | robots | rows N | tail N_s | for                                                        |
|------------------|--------|--------|----------|------------------------------------------------------------|
| `best` (default) | 1024   | 24     | 20       | three rounds of imagination; a biped's sizes (`biped.py`)  |
| `ppo`            | 8192   | 20     | none     | Playground's own settings for brax's PPO                   |

All of these tasks share the settings of `best` (experiments/05_playground), except for two fields, by
dynappo/tasks/playground/settings.py. It treats left and right alike (`ppo.symmetry`) where a task has a
mirror image; elsewhere that is refused, with the reason. On the tasks of Go1, Spot, Op3 and Barkour its tails
compute terms of the reward that follow from what the model predicts (`model.known_reward`).

Weights, noise, commands and resets are the task's own: the group `task` has only `episode_length`, which is
the task's. `physics.impl` is its engine: Warp on a GPU that has it, else MJX-JAX.
"""

import pathlib
import runpy

from dynappo.tasks.playground import loading, settings

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))


def get_config(variant=""):
    """The config of "TASK" or "TASK:VARIANT"."""
    task, _, variant = variant.partition(":")
    if variant not in ("", "best", "ppo"):  # before Playground is imported
        loading.check_name(task)
        raise ValueError(f"variant {variant!r} is not one of best, ppo")
    config = default["defaults"]()
    config.robot, config.env = "", f"playground:{task}"
    found = settings.of_task(task)
    config.task.episode_length = found.episode_length
    config.run.eval_envs = 128
    config.ppo.update(found.networks)
    # as brax's policies begin, before the tanh; their entropy, with which noise does not grow for ever
    config.ppo.update(init_std=0.7, squashed=True)
    config.ppo.update(activation="swish", normalize=True)  # and observations scaled as theirs
    if variant == "ppo":
        _ppo(config, found)
    else:
        known = task.startswith(settings.REWARD_KNOWN)
        _best(config, symmetric=task in settings.SYMMETRIC, known_reward=known)
    return config


def _ppo(config, found):
    """Playground's numbers. 0.25: brax halves the value's squared error twice."""
    config.rollout.update(found.rollout)
    config.schedule.update(start_iteration=0, end_iteration=0, start_steps=0, end_steps=0)
    config.ppo.update(found.ppo)
    config.ppo.update(adaptive=False, clip_value=False, value_coef=0.25, shuffle_blocks=1)
    every = config.run.log_every
    config.run.num_iterations = -(-found.iterations // every) * every


def _best(config, symmetric, known_reward):
    """Few robots, five of six rows and two of three updates imagined: `biped.py`'s.

    Physics alone for 50 iterations: some of these rewards are cut off at 0 and are 0 for an untrained robot,
    so a tail learns nothing from them (Go1: a return of 18 without the delay, 29 with it). And after
    iteration 600: fewer falls, and the last of the return.

    A learning rate of at most 0.001: the KL alone lets it grow tenfold. With the ceiling Getup ends at 16.5,
    without at 11.3; Berkeley has 32.7 after 3.5 M steps, without 31.6; Spot loses 1.

    The value function sees the state where Playground's does not, too: Spot ends at 50.5 instead of 44.4, and
    with known rewards as well it is above 46 from 2.3 M steps on, where it was at 32. Spot's other tasks
    have not run. H1 without it is at 41 instead of 63 after 6 M steps, Op3 at 16 instead
    of 20 after 3 M.

    One or two seeds each: experiments/05_playground/parts.md, stalls.md. A guess is the initial noise of 0.7.
    """
    config.rollout.update(num_envs=1024, horizon=24)
    config.schedule.update(start_iteration=50, end_iteration=55, start_steps=0, end_steps=20)
    config.schedule.update(rounds=3, last_iteration=600)
    config.model.update(clean=True, falls=True, known_reward=known_reward)
    config.model.update(minibatches=6, late_epochs=5, late_from=50)
    config.model.update(hidden=(512, 512, 512), activation="swish", precision="bfloat16")
    config.ppo.update(gamma=0.97, desired_kl=0.02, max_learning_rate=0.001)
    config.ppo.update(precision="bfloat16", symmetry=symmetric, critic="state")
    config.run.update(num_iterations=1000)  # 13.4 M steps

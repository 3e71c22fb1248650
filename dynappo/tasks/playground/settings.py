"""Playground's settings of a task for brax's PPO, as fields of our config.

Source: `mujoco_playground.config.locomotion_params.brax_ppo_config`, and brax 0.14.2's defaults where that
says nothing (clipping_epsilon 0.3, lambda 0.95). brax's words and ours:

| brax                       | here                                      |
|----------------------------|-------------------------------------------|
| num_envs, unroll_length    | rollout.num_envs, horizon                 |
| num_minibatches            | ppo.minibatches                           |
| num_updates_per_batch      | ppo.epochs                                |
| discounting, gae_lambda    | ppo.gamma, lambda_                        |
| entropy_cost               | ppo.entropy_coef                          |
| normalize_observations     | ppo.normalize                             |
| value_obs_key              | ppo.critic: "state" is privileged_state   |
| num_timesteps              | run.num_iterations                        |

`batch_size` x `num_minibatches` is `num_envs` in all of them, so an update has one unroll of each robot.
`reward_scaling` is 1 in all of them, and has no field.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from dynappo.tasks.playground import loading

# where mirrored.py finds a mirror image. It says of the others why not: Go1's IMU, whose velocities it sees,
# is 7 cm to the right; G1's hips may leave their pose for commands to the left alone; Apollo's sides differ
SYMMETRIC = (
    "BerkeleyHumanoidJoystickFlatTerrain",
    "SpotGetup",
    "SpotJoystickGaitTracking",
    "T1JoystickFlatTerrain",
    "T1JoystickRoughTerrain",
)
# how names of tasks begin that have computed rewards (known.py): the joysticks of Go1 and Spot, Op3 and
# Barkour learn sooner with them; on Getup and Handstand nothing is shown. Berkeley learns slower, G1, T1 and
# H1 no faster, Apollo not at all (experiments/05_playground/parts.md)
REWARD_KNOWN = ("Go1", "Spot", "Op3", "Barkour")


class Settings(NamedTuple):
    """Fields of the groups of a config."""

    episode_length: int  # control steps
    iterations: int
    rollout: dict[str, Any]
    ppo: dict[str, Any]
    networks: dict[str, Any]  # of ppo: sizes, and what the value function sees


def of_task(name: str) -> Settings:
    """The settings for the task `name`; ConfigError where there is no such task."""
    loading.check_name(name)
    found = loading.ppo_config(name)
    networks = found.network_factory
    policy, value = (tuple(networks[f"{kind}_hidden_layer_sizes"]) for kind in ("policy", "value"))
    privileged = networks.value_obs_key == "privileged_state"
    steps = found.num_envs * found.unroll_length
    return Settings(
        episode_length=int(found.episode_length),
        iterations=-(-int(found.num_timesteps) // steps),
        rollout={"num_envs": found.num_envs, "horizon": found.unroll_length},
        ppo={
            "minibatches": found.num_minibatches,
            "epochs": found.num_updates_per_batch,
            "gamma": found.discounting,
            "lambda_": found.get("gae_lambda", 0.95),
            "learning_rate": found.learning_rate,
            "entropy_coef": found.entropy_cost,
            "clip_epsilon": found.get("clipping_epsilon", 0.3),
            "max_grad_norm": found.get("max_grad_norm", 1e9),
        },
        networks={
            "hidden": policy,
            "critic_hidden": None if value == policy else value,
            "critic": "state" if privileged else "obs",
        },
    )

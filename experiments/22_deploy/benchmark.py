"""What policies for hardware are worth on the benchmark's own task: its weights, no noise, no disturbance.

    python experiments/22_deploy/benchmark.py go1 go1_deploy anymal_c anymal_c_deploy ... [--episodes 200]

Episodes of 20 s in C MuJoCo, evaluated as in training (dynappo/scores.py).
"""

from functools import partial

import jax
import numpy as np

from dynappo import config as config_lib
from dynappo import scores
from dynappo.policy import policy_source
from dynappo.tasks.velocity import env as env_lib
from experiments import paper


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--episodes", type=int, default=200)
    args = parser.parse_args()
    for name in args.names:
        found = measure(name, args.episodes)
        numbers = (f"{key} {value:.3g}" for key, value in found.items())
        print(f"{name:16s} {', '.join(numbers)}", flush=True)


def measure(name: str, episodes: int) -> dict[str, float]:
    """`scores.evaluate` of a bundled policy on ROBOT:best, with the observation that it knows, and with
    Isaac Lab's weights, which pay nothing for high feet."""
    policy, _ = policy_source.load(name)
    config = config_lib.load(f"configs/{policy.robot}.py:best")
    config.task.weights.foot_clearance = 0.0
    task = policy.config["task"]
    for field in ("observation", "history"):
        config.task[field] = task.get(field, config.task[field])
    config.physics.impl = "c"
    config.ppo.activation, config.ppo.hidden = policy.activation, policy.config["ppo"]["hidden"]
    config = config_lib.validate(config)
    static, hyper = config_lib.split(config)
    env = env_lib.make(policy_source.robot(policy)[0], config.task, config.physics, impl="c")
    assess = partial(
        scores.evaluate, env, static=static, num_envs=episodes, num_steps=config.run.eval_steps
    )
    params = {"std": np.ones(12, np.float32)} | policy.params
    found = jax.device_get(jax.jit(assess)(hyper, params, jax.random.key(0)))
    return {key: float(value) for key, value in found.items()}


if __name__ == "__main__":
    main()

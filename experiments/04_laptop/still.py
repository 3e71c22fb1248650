"""What a Go1 earns that only stands still, with the weights of `:best` and of `:laptop`.

    python experiments/04_laptop/still.py [--episodes 1000]      # writes results/still.json

Networks of zeros, so the action is zero in every row; episodes of 20 s in C MuJoCo, evaluated as in training
(dynappo/scores.py).
"""

import json
from functools import partial
from pathlib import Path

import jax

from dynappo import algorithm, scores
from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

VARIANTS = ("best", "laptop")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--episodes", type=int, default=1000)
    args = parser.parse_args()
    found = {name: measure(name, args.episodes) for name in VARIANTS}
    path = Path(__file__).parent / "results" / "still.json"
    path.write_text(json.dumps({"episodes": args.episodes} | found, indent=1) + "\n")
    print(path.read_text())


def measure(variant: str, episodes: int) -> dict[str, float]:
    """The metrics of `scores.evaluate`."""
    config = config_lib.load(f"configs/go1.py:{variant}")
    config.physics.impl, config.run.device = "c", "cpu"
    config = config_lib.validate(config)
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot_lib.load(config.robot), config.task, config.physics, impl="c")
    params = algorithm.init(env, hyper, jax.random.key(0), static=static).learner.params
    assess = partial(
        scores.evaluate, env, static=static, num_envs=episodes, num_steps=config.run.eval_steps
    )
    still = jax.tree.map(jax.numpy.zeros_like, params)
    found = jax.device_get(jax.jit(assess)(hyper, still, jax.random.key(0)))
    return {name: round(float(value), 4) for name, value in found.items()}


if __name__ == "__main__":
    main()

"""How well the transition model writes the tail: its rewards and observations against physics.

    python experiments/01_four_robots/run.py OUT go1:dyna4 ... --model
    python experiments/01_four_robots/tail.py OUT go1 go2 anymal_c anymal_d

Robots that walk under the trained policy, with its exploration and the noise of training, go on for
four steps by physics and by the model, with the same actions. MJX-JAX on the CPU.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import walk

from dynappo import algorithm, rollout
from dynappo import config as config_lib
from dynappo.model import dynamics
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

WARM, ROWS, STARTS = 100, 4, 5  # control steps before the first tail, in a tail; tails of a robot


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("robots", nargs="+")
    parser.add_argument("--variant", default="dyna4")
    parser.add_argument("--worlds", type=int, default=256)
    args = parser.parse_args()
    for name in args.robots:
        files = args.folder / f"{name}_{args.variant}.npz"
        config = walk.settings(name, args.variant)
        static, hyper = config_lib.split(config)
        env = env_lib.make(robot_lib.load(name), config.task, config.physics)
        params = jax.tree.map(jnp.asarray, policy_file.load_params(files))
        model = load_model(static, env, files.with_suffix(".model.npz"))
        rows = compare(env, static, hyper, params, model, args.worlds)
        for k, row in enumerate(rows):
            print(name, k + 1, " ".join(f"{n} {v:.3f}" for n, v in row.items()), flush=True)


def load_model(static, env, path):
    """The `ModelState` whose leaves `run.py --model` wrote."""
    state = dynamics.init(static, env, jax.random.key(0))
    some = (state.params, state.inputs, state.targets)
    file = np.load(path)
    leaves = [jnp.asarray(file[n]) for n in file]
    params, inputs, targets = jax.tree.unflatten(jax.tree.structure(some), leaves)
    return state.replace(params=params, inputs=inputs, targets=targets)


def compare(env, static, hyper, params, model, worlds):
    """A dict for each of the `ROWS` steps, over all robots that did not fall or start anew."""
    key = jax.random.key(0)
    keys = jax.random.split(key, worlds)
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, keys)
    state = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, keys)
    act = algorithm.policy(static, env, params)
    physics = algorithm.physics_step(env, hyper, bodies)
    index = jnp.arange(worlds)

    @jax.jit
    def step(state, t):
        row = rollout.row_keys(jax.random.key(1), index)(t)
        action = act(state, row)[0]
        after, outcome = physics(state, action, row)
        return after, (action, outcome)

    for t in range(WARM):
        state, _ = step(state, t)
    out = [[] for _ in range(ROWS)]
    for s in range(STARTS):
        obs, valid = state.obs, jnp.ones(worlds, bool)
        for k in range(ROWS):
            state, (action, outcome) = step(state, WARM + s * ROWS + k)
            valid &= (outcome.discount == 1) & (outcome.truncation == 0)
            obs, reward, _ = dynamics.predict(static, hyper, env, model, obs, action)
            columns = (outcome.reward / env.dt, reward / env.dt, outcome.next_obs, obs)
            out[k].append([np.array(c)[np.array(valid)] for c in columns])
    return [measure(*[np.concatenate(c) for c in zip(*some, strict=True)]) for some in out]


def measure(true, predicted, true_obs, obs):
    """Share of variance explained: reward, joint velocity, base velocity; bias of the reward (1/s)."""

    def explained(a, b):
        return 1 - ((a - b) ** 2).mean() / a.var(0).mean()

    return {
        "reward_mean": true.mean(),
        "reward_std": true.std(),
        "reward_bias": (predicted - true).mean(),
        "reward_explained": explained(true, predicted),
        "joint_velocity_explained": explained(true_obs[:, 12:24], obs[:, 12:24]),
        "base_velocity_explained": explained(true_obs[:, 27:30], obs[:, 27:30]),
    }


if __name__ == "__main__":
    main()

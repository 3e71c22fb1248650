"""Which commands a policy falls at, and when: deterministic episodes of 20 s on C MuJoCo, as an evaluation.

    python experiments/21_less/where.py ROBOT POLICY.npz [--episodes 768]

A line a fall: control step, command (m/s, m/s, rad/s), the parts at the ground.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo import scores
from dynappo.evaluate import episodes
from dynappo.learner import networks
from dynappo.physics import engine as engine_lib
from dynappo.physics import robot as robot_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

STEPS = 1000


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("robot")
    parser.add_argument("policy", type=Path)
    parser.add_argument("--episodes", type=int, default=768)
    args = parser.parse_args()
    policy = policy_file.load(args.policy)
    found = falls(args.robot, policy, args.episodes)
    for step, command, parts in found:
        print(step, " ".join(f"{x:+.2f}" for x in command), *parts)
    print(f"{len(found)} falls in {args.episodes} episodes of {STEPS} control steps")


def falls(name: str, policy: policy_file.Policy, number: int):
    """`(step, command [3], parts)` of each episode's first fall."""
    config = episodes.settings(policy)
    static, hyper = config_lib.split(config)
    hyper, robot = scores.nominal(hyper), robot_lib.load(name)
    static = static._replace(ppo=static.ppo._replace(precision="highest"))
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    engine = env.step.args[0].engine
    model = robot.mj_model
    names = [f"{model.body(model.geom_bodyid[g]).name}" for g in robot.parts]
    body_keys, reset_keys, keys = (
        jax.random.split(key, number) for key in jax.random.split(jax.random.key(5), 3)
    )
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, body_keys)
    state = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, reset_keys)
    state = state.replace(clock=jnp.full_like(state.clock, -STEPS))  # no time limit
    params, home = policy.params, jnp.asarray(robot.home_qpos, jnp.float32)

    def act(state):
        obs, _ = networks.inputs(static, env, state.obs, state.prop)
        return networks.policy(static, params, obs)

    @jax.jit
    def step(state):
        advance = jax.vmap(env.step, (None, 0, 0, 0, 0))
        state, outcome = advance(hyper, bodies, state, act(state), keys)
        return state, outcome.discount == 0

    @jax.jit
    def lowest(state):
        moved = jax.vmap(lambda *one: engine_lib.simulate(engine, hyper, *one).lowest)
        return moved(bodies, state, act(state))

    alive, found, commands = np.ones(number, bool), [], np.asarray(state.command)
    for t in range(STEPS):
        before = state
        state, fell = step(state)
        new = np.asarray(fell) & alive
        if new.any():
            ground = np.asarray(lowest(before)) < 0
            for i in np.flatnonzero(new):
                parts = sorted({names[k] for k in np.flatnonzero(ground[i])})
                found.append((t, commands[i], parts))
        alive &= ~new
        lying = ~alive[:, None]  # they stand up and do not count any more
        state = state.replace(
            qpos=jnp.where(lying, home, state.qpos), qvel=jnp.where(lying, 0, state.qvel)
        )
    return found


if __name__ == "__main__":
    main()

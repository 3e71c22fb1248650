"""brax's SAC on our task: steps and seconds to evaluated returns.

    python experiments/24_off_policy/sac.py OUT.csv [--config go1:best] [--seed 100] [--steps 3000000]

The task is that of the config: the same commands, noise, pushes, bodies, episodes and rewards that PPO
and the tail get, with our own resets (brax's put a robot back into its first state, with its first
command). Evaluations are ours too: 100 episodes of 20 s without noise, the mean action. OUT.csv has a
row an evaluation, as 21_less/run.py writes it. `seconds` are those of training; brax counts its compilation
too, so the first row has it. The defaults are setting e of five that were tried on Go1 with seed 0, the one
with the highest return (README.md). `--symmetric`: policy and critics treat left and right alike, as those
of `best` do.
"""

import argparse
import dataclasses
import functools
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
from brax import envs
from brax.training.agents.sac import networks as sac_networks
from brax.training.agents.sac import train as sac_train

from dynappo import algorithm, scores
from dynappo import config as config_lib
from dynappo.config import versions
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.learner import symmetry
from dynappo.program import devices
from dynappo.run import log
from dynappo.tasks import of_robots
from experiments import paper

EPISODES, LENGTH = 100, 1000  # of an evaluation
MEASURED = "falls", "velocity_error_sq", "yaw_error_sq"  # by the task, in each step


class Robots(envs.Env):
    """All robots behind brax's protocol; a class because that is one. It holds constants only.

    `gain`: brax's actions end in a tanh, ours do not, and a walking policy's reach 2 to 3. With 3
    SAC did not learn to walk, with 1.5 it does (README.md).
    """

    def __init__(self, env, hyper, gain: float, trained: bool):
        self._env, self._hyper, self._gain, self._trained = env, hyper, gain, trained

    def reset(self, rng):
        keys = jax.random.wrap_key_data(rng)
        body_keys, reset_keys, keys = jax.vmap(functools.partial(jax.random.split, num=3))(keys).T
        bodies = jax.vmap(self._env.randomize, (None, 0))(self._hyper, body_keys)
        state = jax.vmap(self._env.reset, (None, 0, 0))(self._hyper, bodies, reset_keys)
        clock = jnp.full_like(state.clock, min(0, self._env.episode_length - LENGTH))
        if self._trained:  # else all time-outs would come at once
            ages = functools.partial(jax.random.randint, shape=(), minval=0)
            clock = jax.vmap(lambda k: ages(k, maxval=self._env.episode_length))(body_keys)
        state, zero = state.replace(clock=clock), jnp.zeros(len(rng))
        info = {"keys": jax.random.key_data(keys), "body": bodies, "truncation": zero}
        info |= {"next_obs": state.obs}  # before a reset; fast_td3.py asks for it
        return envs.State(
            pipeline_state=state,
            obs=state.obs,
            reward=zero,
            done=zero,
            metrics={name: zero for name in MEASURED},
            info=info | {"steps": zero},
        )

    def step(self, state, action):
        keys = jax.random.wrap_key_data(state.info["keys"])
        keys = jax.vmap(jax.random.fold_in)(keys, state.info["steps"].astype(jnp.int32))
        advance = algorithm.physics_step(self._env, self._hyper, state.info["body"])
        after, outcome = advance(state.pipeline_state, self._gain * action, keys)
        info = {"steps": state.info["steps"] + 1, "truncation": outcome.truncation}
        info |= {"next_obs": outcome.next_obs}
        found = {name: outcome.metrics[name] for name in MEASURED}
        return state.replace(
            pipeline_state=after,
            obs=after.obs,
            reward=outcome.reward,
            done=jnp.maximum(1 - outcome.discount, outcome.truncation),
            metrics={**state.metrics, **found},
            info={**state.info, **info},
        )

    observation_size = property(lambda self: self._env.obs_size)
    action_size = property(lambda self: self._env.action_size)
    mirror = property(lambda self: self._env.mirror)
    backend = property(lambda self: "mjx")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="go1:best")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--evaluations", type=int, default=30)
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--updates", type=int, default=16, help="gradient steps a control step")
    parser.add_argument("--batch", type=int, default=2048, help="transitions a gradient step")
    parser.add_argument("--first", type=int, default=8192, help="transitions with random actions")
    parser.add_argument("--learning-rate", type=float, default=6e-4)
    parser.add_argument("--gamma", type=float, default=0.97)
    parser.add_argument("--reward-scaling", type=float, default=40.0)
    parser.add_argument("--gain", type=float, default=1.5)
    parser.add_argument("--symmetric", action="store_true")
    args = parser.parse_args()
    devices.own_process()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    train(args)


def train(args: argparse.Namespace) -> None:
    """Run brax's trainer; a row of OUT.csv an evaluation, as soon as it is there."""
    trained, evaluated = robots(args)

    def progress(steps, metrics):
        sums = [float(metrics[f"eval/episode_{n}"]) for n in ("reward", *MEASURED)]
        sums.append(float(metrics["eval/avg_episode_length"]))
        found = row("sac", args, steps, metrics.get("training/walltime", 0.0), sums)
        log.append_csv(args.out, [found])
        about = {
            n.removeprefix("training/"): float(metrics[n])
            for n in metrics
            if "loss" in n or n.endswith("alpha")
        }
        print(*found.values(), f"length {sums[-1]:.0f}", about, flush=True)

    factory = functools.partial(networks, trained.mirror if args.symmetric else None)
    first = args.robots * -(-args.first // args.robots)  # whole control steps
    with mock.patch.object(jax, "device_put_replicated", replicated, create=True):
        sac_train.train(
            trained,
            num_timesteps=args.steps,
            episode_length=LENGTH,
            wrap_env_fn=lambda env, **_: env,  # it has its own resets
            num_envs=args.robots,
            num_eval_envs=EPISODES,
            eval_env=evaluated,
            deterministic_eval=True,
            num_evals=args.evaluations + 1,
            learning_rate=args.learning_rate,
            discounting=args.gamma,
            seed=args.seed,
            batch_size=args.batch,
            grad_updates_per_step=args.updates,
            normalize_observations=True,
            reward_scaling=args.reward_scaling,
            min_replay_size=first,
            max_replay_size=args.steps,
            network_factory=factory,
            progress_fn=progress,
        )


def mirror_of_logits(of_action):
    """The mirror of what a policy says: a mean, which changes its sign, then a spread, which does not."""
    return symmetry.beside(of_action, of_action._replace(sign=abs(of_action.sign)))


def networks(mirrors, *sizes, **given) -> sac_networks.SACNetworks:
    """brax's, with the mean of what they say of an observation and of its mirror image, where there are
    `mirrors` of observation and action."""
    made = sac_networks.make_sac_networks(
        *sizes, hidden_layer_sizes=(256, 256), q_network_layer_norm=True, **given
    )
    if mirrors is None:
        return made
    of_obs, of_action = mirrors
    of_logits = mirror_of_logits(of_action)
    policy, critics = made.policy_network.apply, made.q_network.apply

    def logits(moments, params, obs):
        image = policy(moments, params, symmetry.vector(of_obs, obs))
        return (policy(moments, params, obs) + symmetry.vector(of_logits, image)) / 2

    def values(moments, params, obs, action):
        image = symmetry.vector(of_obs, obs), symmetry.vector(of_action, action)
        return (critics(moments, params, obs, action) + critics(moments, params, *image)) / 2

    return made.replace(
        policy_network=dataclasses.replace(made.policy_network, apply=logits),
        q_network=dataclasses.replace(made.q_network, apply=values),
    )


def robots(args: argparse.Namespace) -> tuple[Robots, Robots]:
    """Those that are trained, and those of the evaluation."""
    name, _, variant = args.config.partition(":")
    config = config_lib.load(f"configs/{name}.py:{variant}")
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    config = config_lib.validate(config)
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    env = of_robots.make(config, robot, impl=devices.engine(config))
    _, hyper = config_lib.split(config)
    evaluated = Robots(env, scores.nominal(hyper), args.gain, False)
    return Robots(env, hyper, args.gain, True), evaluated


def row(method: str, args, steps, seconds, sums) -> dict:
    """Of OUT.csv: `sums` of reward, `MEASURED` and steps, means over an evaluation's episodes."""
    reward, falls, error_sq, yaw_error_sq, length = sums
    return {
        "job": f"{method} {args.config}",
        "seed": args.seed,
        "sim_steps": int(steps),
        "seconds": f"{seconds:.4g}",
        "return": f"{reward:.4g}",
        "fall_rate": f"{falls:.4g}",
        "tracking_error": f"{(error_sq / length) ** 0.5:.4g}",
        "yaw_error": f"{(yaw_error_sq / length) ** 0.5:.4g}",
        "device": jax.devices()[0].device_kind,
        "commit": versions.commit(),
    }


def replicated(tree, where):
    """What brax 0.14.2 calls and JAX no longer has: a leading axis of devices."""
    mesh = jax.sharding.Mesh(where, ("devices",))
    sharding = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("devices"))
    return jax.tree.map(lambda x: jax.device_put(jnp.stack([x] * len(where)), sharding), tree)


if __name__ == "__main__":
    main()

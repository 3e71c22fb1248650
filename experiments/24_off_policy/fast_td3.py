"""FastTD3, its authors' own trainer, on our task: steps and seconds to evaluated returns.

    python experiments/24_off_policy/fast_td3.py OUT.csv --code FastTD3/fast_td3 [--seed 100]
        [--config g1:best --settings G1JoystickFlatTerrain --scale 2]

`--code` is the folder fast_td3 of github.com/younggyoseo/FastTD3 (MIT; commit 229ed59). Its train.py runs as
it is, with its settings for Playground's Go1, or for the task of `--settings`, unless `--fast FIELD=VALUE`
changes one. Ours are the task and the evaluations, as in sac.py, and the scale of the rewards: its value
function reaches from -10 to 10 and has gamma 0.97, so a perfect Go1 of 45 in 1000 steps is worth 7.5 with a
scale of 5, and a G1 of 130 8.7 with one of 2. The gain of 1.5 is SAC's: with 3 it did not walk. Needs torch,
tensordict.
"""

import argparse
import dataclasses
import sys
import time
import types
from pathlib import Path

import jax
import jax.numpy as jnp
import sac
import torch  # pyright: ignore[reportMissingImports]

from dynappo.program import devices
from dynappo.run import log
from experiments import paper


class Torch:
    """Robots behind the protocol of FastTD3's Playground environment; a class because that is one."""

    asymmetric_obs = False
    max_episode_steps = sac.LENGTH

    def __init__(self, robots: sac.Robots, count: int, seed: int, scale: float, finish=None):
        self.num_envs, self.num_obs = count, robots.observation_size
        self.num_actions, self.steps = robots.action_size, 0
        self._reset, self._step = jax.jit(robots.reset), jax.jit(robots.step)
        self._keys = jax.random.split(jax.random.PRNGKey(seed), count)
        self._scale, self._finish = scale, finish  # (sums, seconds) at an evaluation's end

    def reset(self):
        self._state, self._began = self._reset(self._keys), time.perf_counter()
        self._sums = jnp.zeros((len(sac.MEASURED) + 2, self.num_envs))
        self._alive = jnp.ones(self.num_envs)
        self._row = 0
        return tensor(self._state.obs)

    def step(self, actions):
        self._state = state = self._step(
            self._state, jnp.from_dlpack(actions.detach().contiguous())
        )
        self.steps += self.num_envs
        if self._finish:
            self._add(state)
        told = {"time_outs": tensor(state.info["truncation"]).bool()}
        told["observations"] = {"raw": {"obs": tensor(state.info["next_obs"])}}
        # an evaluation goes on to its end: theirs would stop when all have fallen
        done = state.done if not self._finish else jnp.zeros_like(state.done)
        return tensor(state.obs), self._scale * tensor(state.reward), tensor(done).bool(), told

    def _add(self, state) -> None:
        """Sums of an evaluation's first episodes; a row when its time is up."""
        found = (state.reward, *(state.metrics[name] for name in sac.MEASURED), 1.0)
        self._sums += jnp.stack([self._alive * x for x in found])
        self._alive *= 1 - state.done
        self._row += 1
        if self._finish and self._row == self.max_episode_steps:
            self._finish(self._sums.mean(1).tolist(), time.perf_counter() - self._began)


def tensor(array):
    """A JAX array as one of torch, without a copy."""
    return torch.from_dlpack(array)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--code", type=Path, required=True)
    parser.add_argument("--config", default="go1:best")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--fast", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--gain", type=float, default=1.5)
    parser.add_argument("--scale", type=float, default=5.0, help="of rewards")
    parser.add_argument("--settings", default="Go1JoystickFlatTerrain", help="a task of theirs")
    args = parser.parse_args()
    devices.own_process()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    train(args)


def train(args: argparse.Namespace) -> None:
    """Run their trainer; a row of OUT.csv an evaluation, as soon as it is there."""
    sys.path.insert(0, str(args.code.resolve()))
    for name in ("tyro", "wandb"):  # of their command line and logging
        sys.modules[name] = types.ModuleType(name)
    import hyperparams  # pyright: ignore[reportMissingImports]

    own = settings(getattr(hyperparams, f"{args.settings}Args")(), args)
    hyperparams.get_args = lambda: own
    trained, evaluated = sac.robots(args)
    began, apart = time.perf_counter(), [0.0]  # seconds of evaluations

    def finish(sums, seconds):
        apart[0] += seconds
        clock = time.perf_counter() - began - apart[0]
        found = sac.row("fasttd3", args, envs.steps, clock, sums)
        log.append_csv(args.out, [found])
        print(*found.values(), flush=True)

    envs = Torch(trained, own.num_envs, args.seed, args.scale)
    tests = Torch(evaluated, sac.EPISODES, 0, 1.0, finish)
    theirs = types.ModuleType("environments.mujoco_playground_env")
    theirs.make_env = lambda *_, **__: (envs, tests, tests)
    sys.modules[theirs.__name__] = theirs
    import train as trainer  # pyright: ignore[reportMissingImports]

    trainer.save_params = lambda *_, **__: None
    trainer.main()


def settings(own, args: argparse.Namespace):
    """Their settings of a task, with those of the command line."""
    own = dataclasses.replace(own, seed=args.seed, use_wandb=False, render_interval=0)
    own = dataclasses.replace(
        own, eval_interval=100, save_interval=0, cuda=torch.cuda.is_available()
    )
    for text in args.fast:
        name, _, value = text.partition("=")
        kind = type(getattr(own, name))
        own = dataclasses.replace(own, **{name: value == "True" if kind is bool else kind(value)})
    # evaluated every 100 steps of all robots, and once more at the end
    rounds = -(-args.steps // own.num_envs // 100) * 100 + 1
    return dataclasses.replace(own, total_timesteps=rounds)


if __name__ == "__main__":
    main()

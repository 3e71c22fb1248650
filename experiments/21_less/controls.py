"""Controls that isolate what the model is worth: an iteration in which one thing is another.

A job of run.py with `control=NAME` runs under `CONTROLS[NAME]`, which puts a function in the place of
`algorithm.imagine`; all else is the shipped code.

- `last`: every round's tails start from where physics left the robots, not from real rows drawn at random
- `simulator`: as `last`, and the simulator writes the tails in the model's place. These rows are not counted
  as simulator steps, and the robots do not keep them: it is what a perfect model would give
"""

import jax.numpy as jnp

from dynappo import algorithm, fast, rollout
from dynappo.model import dynamics, memory

_imagine = algorithm.imagine


def put_in(name: str) -> None:
    """Put a control into `algorithm`, in a process of its own."""
    if name not in CONTROLS:
        raise SystemExit(f"control is {name!r}, expected one of {', '.join(CONTROLS)}")
    algorithm.imagine = CONTROLS[name]


def from_last(env, hyper, state, *, start, static, **given):
    """`algorithm.imagine` from the robots' own states."""
    del start
    start = memory.branches(static, dynamics.tail(static, env, state.env_state), axis=0)
    return _imagine(env, hyper, state, start=start, static=static, **given)


def simulated(env, hyper, state, *, rows, n_real, start, key, static):
    """`algorithm.imagine` by physics, from the robots' own states."""
    del start
    robots, bodies = memory.branches(static, (state.env_state, state.params_physics), axis=0)
    rows, _, _ = fast.fill(
        rows,
        begin=n_real,
        end=jnp.int32(static.rollout.horizon),
        state=robots,
        keys=rollout.row_keys(key, memory.imagined_index(static, state.robot_index)),
        act=algorithm.policy(static, env, state.learner.params),
        step=algorithm.physics_step(env, hyper, bodies),
    )
    return rows


CONTROLS = {"last": from_last, "simulator": simulated}

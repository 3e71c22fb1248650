"""Controls that isolate what the model is worth: an iteration in which one thing is another.

A job of run.py with `control=NAME` runs under `CONTROLS[NAME]`, which puts a function in the place of
`algorithm.imagine`; all else is the shipped code.

- `last`: every round's tails start from where physics left the robots, not from real rows drawn at random
- `simulator`: as `last`, and the simulator writes the tails in the model's place. These rows are not counted
  as simulator steps, and the robots do not keep them: it is what a perfect model would give
"""

import jax.numpy as jnp

from dynappo import algorithm, fast, rollout
from dynappo.model import dynamics

_imagine = algorithm.imagine


def put_in(name: str) -> None:
    """Put a control into `algorithm`, in a process of its own."""
    if name not in CONTROLS:
        raise SystemExit(f"control is {name!r}, expected one of {', '.join(CONTROLS)}")
    algorithm.imagine = CONTROLS[name]


def from_last(env, hyper, state, *, start, static, **given):
    """`algorithm.imagine` from the robots' own states."""
    del start
    start = dynamics.tail(static, env, state.env_state)
    return _imagine(env, hyper, state, start=start, static=static, **given)


def simulated(env, hyper, state, *, rows, n_real, start, key, static):
    """`algorithm.imagine` by physics, from the robots' own states."""
    del start
    rows, _, _ = fast.fill(
        rows,
        begin=n_real,
        end=jnp.int32(static.rollout.horizon),
        state=state.env_state,
        keys=rollout.row_keys(key, state.robot_index),
        act=algorithm.policy(static, env, state.learner.params),
        step=algorithm.physics_step(env, hyper, state.params_physics),
    )
    return rows


CONTROLS = {"last": from_last, "simulator": simulated}

"""A memory: real rows of past iterations, from which the model learns and in which tails begin.

With few robots an iteration has few real rows: 64 robots with 4 rows each have 256, and a model fitted to
these alone forgets the rest. So they are kept.

- **State**: a ring of `model.memory` rows of each robot beside the networks, `TrainState.memory`, [M, R].
  It holds what the model learns from (examples.py) and the states that tails begin in. It lies with its
  robots: on a mesh each device keeps the rows of its own.
- **In**: all real rows of an iteration, over the oldest ones (`remember`). Where the ring begins and how
  many rows it holds follows from the schedule, as columns (schedule.py): a counter in the state would be
  batched over seeds, and with it each index and bound.
- **Fit**: beside each new row, a minibatch has `model.remembered` rows of the ring, drawn at random among
  all (`draw`). So new rows weigh 1 / (1 + remembered), an old row less the more there are, and a fit costs
  the same however many are kept. The ring is written first, so it is never empty.
- **Tails**: those of later rounds begin in the newest `schedule.anchors` rows of a robot (`starts`), with
  `schedule.new_commands` under a new command: 64 robots hear few, and what is asked is known, not predicted.
  With 64 robots no difference is shown (30 pairs). One ANYmal-C needs 29 % more steps without (three seeds),
  and with four one of three seeds never walks (experiments/27_few/parts.md).
- **More imagined robots than real ones**: `rollout.imagined` of them go on from where each real robot is
  (`branches`). Each is a robot of its own in the rollout [N, R x imagined]: the first rows are those of its
  real robot, the tail is its own. So PPO, its weights and its advantages are those of one tail a robot, and
  a real row's advantage is estimated from as many tails. The price: real rows are copied, in later rounds
  with weight 0. It is small where a rollout has more synthetic rows than real ones.

All three are off in the paper's variants: without a memory the state has no ring, and with one imagined
robot the rollout is that of the real ones.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from dynappo.model import dynamics, examples
from dynappo.model.examples import Examples
from dynappo.types import Columns, Env, Hyper, Memory, Static, Transition


def init(static: Static, env: Env) -> Memory:
    """An empty ring."""
    size = static.model.memory, static.rollout.num_envs

    def zeros(*shape):
        return jnp.zeros((*size, *shape))

    return Memory(
        x=zeros(examples.input_size(env)),
        y=zeros(env.prop_size + 1 + static.model.falls),
        weight=zeros(),
        obs=zeros(env.obs_size),
        prop=zeros(env.prop_size),
    )


def remember(memory: Memory, rows: Examples, states: dynamics.TailState, counts: Columns) -> Memory:
    """`memory` with the rows `t < rows.count`, and the states they begin in, in place of the oldest."""
    size, t = len(memory.weight), jnp.arange(len(rows.weight))
    place = (counts["memory_begin"] + t) % size
    place = jnp.where(t < rows.count, place, size)  # out of bounds: dropped
    new = Memory(x=rows.x, y=rows.y, weight=rows.weight, obs=states.obs, prop=states.prop)
    return jax.tree.map(lambda old, one: old.at[place].set(one, mode="drop"), memory, new)


def drawing(static: Static, memory: Memory | None, counts: Columns) -> Callable | None:
    """`draw` of a memory as `dynamics.fit` calls it; None where the fit reads none."""
    if memory is None or not static.model.remembered:
        return None
    return partial(draw, memory, counts)


def draw(memory: Memory, counts: Columns, key: PRNGKeyArray, rows: int) -> Examples:
    """`rows` rows of each robot, each drawn at random from all that the memory holds."""
    count = jnp.maximum(counts["memory_count"], 1)
    t = jax.random.randint(key, (rows, memory.weight.shape[1]), 0, count)
    x, y, weight = (dynamics.pick(a, t) for a in (memory.x, memory.y, memory.weight))
    return Examples(x=x, y=y, weight=weight, count=jnp.int32(rows))


def starts(
    static: Static,
    hyper: Hyper,
    env: Env,
    memory: Memory | None,
    rows: Transition,
    counts: Columns,
    key: PRNGKeyArray,
) -> dynamics.TailState:
    """Where the tails of a later round begin: in `rows` of this iteration (of the imagined robots), or in the
    memory; with `schedule.new_commands` each under a new command."""
    asked = None
    if static.schedule.new_commands:
        key, asked = jax.random.split(key)
    if memory is not None and static.schedule.anchors:
        state = anchors(static, memory, counts, key)
    else:
        state = dynamics.anchors(static, env, rows, n_real=counts["n_real"], key=key)
    if asked is None:
        return state
    assert env.retell is not None, "a config with schedule.new_commands for another environment"
    keys = jax.random.split(asked, len(state.obs))
    before, context = jnp.split(state.obs, [env.prop_size], axis=-1)
    context = jax.vmap(partial(env.retell, hyper))(context, keys)
    return dynamics.TailState(obs=jnp.concatenate([before, context], -1), prop=state.prop)


def anchors(
    static: Static, memory: Memory, counts: Columns, key: PRNGKeyArray
) -> dynamics.TailState:
    """The start of a tail for each imagined robot, from one of its robot's newest rows."""
    size, num_envs = memory.weight.shape
    newest = counts["memory_begin"] + counts["n_real"]  # the place after the last row
    known = jnp.minimum(counts["memory_count"], static.schedule.anchors)
    age = jax.random.randint(key, (static.rollout.imagined, num_envs), 1, jnp.maximum(known, 1) + 1)
    t = (newest - age) % size

    def start(x):  # [imagined, R, ...], as `branches` orders them
        return jnp.swapaxes(dynamics.pick(x, t), 0, 1).reshape(-1, *x.shape[2:])

    return dynamics.TailState(obs=start(memory.obs), prop=start(memory.prop))


def branches(static: Static, tree: Any, axis: int) -> Any:
    """Each robot of `tree`, along `axis`, as often as there are imagined ones for it, side by side."""
    if static.rollout.imagined == 1:
        return tree
    return jax.tree.map(lambda x: jnp.repeat(x, static.rollout.imagined, axis), tree)


def real_robots(static: Static, tree: Any, axis: int) -> Any:
    """The inverse of `branches`, for what is the same of all the imagined ones of a robot."""
    if static.rollout.imagined == 1:
        return tree
    every = (slice(None),) * axis + (slice(None, None, static.rollout.imagined),)
    return jax.tree.map(lambda x: x[every], tree)


def imagined_index(static: Static, robot_index: Int[Array, " R"]) -> Int[Array, " I"]:
    """The global index of each imagined robot, in the order of `branches`."""
    many = static.rollout.imagined
    if many == 1:
        return robot_index
    return (robot_index[:, None] * many + jnp.arange(many)).reshape(-1)

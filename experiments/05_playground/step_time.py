"""What a row of physics costs beside the task's own step alone: the limit is 10 %.

    python experiments/05_playground/step_time.py G1JoystickFlatTerrain 8192 20 warp

Prints milliseconds a row of the task's own `step` under `vmap`, of ours without resets, and of ours, each
the median of 10 runs of so many rows; actions are random, as an untrained policy's.
"""

import statistics
import sys
import time
from functools import partial

import jax
import jax.numpy as jnp

from dynappo import algorithm
from dynappo.program import devices
from dynappo.tasks.playground import env as env_lib
from dynappo.tasks.playground import loading

RUNS = 10


def main(name: str, robots: int, rows: int, impl: str) -> None:
    devices.own_process()
    task = loading.load(name, impl, robots).task
    env = env_lib.make(task)
    keys = jax.random.split(jax.random.key(0), robots)
    actions = 0.7 * jax.random.normal(jax.random.key(1), (rows, robots, task.action_size))
    with_resets = algorithm.physics_step(env, None, None)

    def own(state, actions):
        def row(state, action):
            state = jax.vmap(task.step)(state, jnp.tanh(action))
            return state, (state.reward.sum(), jax.tree.map(jnp.sum, state.obs), state.done.sum())

        return jax.lax.scan(row, state, actions)

    def ours(step, state, actions):
        def row(state, action):
            state, outcome = step(state, action, keys)
            told = outcome.reward.sum(), outcome.next_obs.sum(), outcome.next_prop.sum()
            return state, (told, (1 - outcome.discount).sum())

        return jax.lax.scan(row, state, actions)

    alone = jax.vmap(partial(env.step, None, None))
    state = jax.jit(jax.vmap(partial(env.reset, None, None)))(keys)
    theirs = jax.jit(jax.vmap(task.reset))(jax.vmap(jax.random.key_data)(keys))
    shapes = jax.eval_shape(own, theirs, actions)[0]
    theirs = jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), theirs, shapes)
    programs = {
        "the task's own step": (own, theirs),
        "ours without resets": (partial(ours, alone), state),
        "ours": (partial(ours, with_resets), state),
    }
    compiled = {what: (jax.jit(f), start) for what, (f, start) in programs.items()}
    times: dict[str, list[float]] = {what: [] for what in compiled}
    for turn in range(RUNS + 1):  # in turns; the first compiles
        for what, (function, start) in compiled.items():
            began = time.perf_counter()
            jax.block_until_ready(function(start, actions))
            if turn:
                times[what].append(1e3 * (time.perf_counter() - began) / rows)
    print(f"{name}, {robots} robots, {rows} rows, {impl}, {jax.devices()[0].device_kind}")
    for what, each in times.items():
        print(f"{what:20s} {statistics.median(each):8.3f} ms a row")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])

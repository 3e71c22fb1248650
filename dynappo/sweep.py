"""Many seeds at once by `jax.vmap`, on many devices by a mesh.

    hyper = sweep.vary(hyper, "ppo.learning_rate", [1e-3, 3e-4])    # or not: seeds only
    state = jax.jit(partial(sweep.init, env, static=static))(hyper, sweep.keys(0, 2))
    run = jax.jit(partial(sweep.run, env, static=static))
    state, metrics = run(hyper, state, schedule.columns(config))

On several devices: `env = env._replace(mesh=sweep.mesh(2, 4))`, and `state = jax.device_put(state,
sweep.shardings(env.mesh, state, 2))` before `run`, called in a `with sweep.partitioner(env.mesh)`;
`program.build.program` does that from `run.mesh_*`.

The engine is JAX's own: `jax.jit` splits the program by how its arguments lie (`shardings`), and
puts in the sums over devices where a mean over robots is taken: gradients, normalisers, advantages,
KL. So nothing of the method knows of devices, and E devices with R robots each compute what one
with E R robots computes; no random number depends on where a robot lies. Only physics is told to
stay where its robots are (`algorithm.physics_step`).

Which axis: seeds talk to nobody, so `seed` costs nothing and comes first. Robots of one seed on
`env` sum gradients after each minibatch, which pays where a device has thousands of robots
(experiments/02_scaling).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo import algorithm, evaluation
from dynappo.types import Config, Env, Metrics, TrainState

ROBOTS = ("env_state", "params_physics", "robot_index")  # fields of TrainState with an axis R


def keys(seed: int, num_seeds: int) -> PRNGKeyArray:
    """The keys `[S]` of the runs `seed`, `seed + 1`, ...; each is that of the run alone."""
    return jnp.stack([jax.random.key(seed + s) for s in range(num_seeds)])


def vary(hyper: Config, field: str, values) -> Any:
    """`hyper` with one value of `field` ("ppo.learning_rate") for each seed.

    Several calls vary several fields together, value by value. ValueError if there is no such
    float, or if it is built into the environment (groups run and physics).
    """
    group, _, rest = field.partition(".")
    if group in ("run", "physics"):
        raise ValueError(
            f"{field} is part of the compiled program, expected a field of ppo, model or task"
        )
    return _set(hyper, field, field.split("."), jnp.asarray(values, jnp.float32))


def _set(node, field, path, values):
    name, *rest = path
    if name not in getattr(node, "_fields", ()):
        raise ValueError(f"{field} is no float of the config, expected one like ppo.learning_rate")
    old = getattr(node, name)
    if not rest and jnp.ndim(old) + isinstance(old, tuple):
        raise ValueError(f"{field} has several numbers, expected a field with one")
    return node._replace(**{name: _set(old, field, rest, values) if rest else values})


def axes(hyper: Config) -> Any:
    """For `jax.vmap`: 0 where `hyper` has a value for each seed, None where one serves all."""
    return jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, hyper)


def init(env: Env, hyper: Config, keys: PRNGKeyArray, *, static: Config) -> TrainState:
    """`algorithm.init` of every seed; arrays get an axis S in front."""
    one = partial(algorithm.init, env, static=static)
    return jax.vmap(one, (axes(hyper), 0), spmd_axis_name="seed")(hyper, keys)


def run(
    env: Env,
    hyper: Config,
    state: TrainState,
    columns: dict[str, Int[Array, " I"]],
    *,
    static: Config,
) -> tuple[TrainState, Metrics]:
    """`algorithm.run` of every seed; metrics `[I, S]`. The columns bound loops and stay unbatched."""
    one = partial(algorithm.run, env, static=static)
    over = (axes(hyper), 0, None), (0, 1)
    return jax.vmap(one, *over, spmd_axis_name="seed")(hyper, state, columns)


def evaluate(
    env: Env,
    hyper: Config,
    params: dict,
    key: PRNGKeyArray,
    *,
    static: Config,
    num_envs: int,
    num_steps: int,
) -> dict[str, Float[Array, " S"]]:
    """`evaluation.evaluate` of every seed's policy, in the same episodes."""
    sizes = dict(static=static, num_envs=num_envs, num_steps=num_steps)
    one = partial(evaluation.evaluate, env, **sizes)
    return jax.vmap(one, (axes(hyper), 0, None), spmd_axis_name="seed")(hyper, params, key)


def mesh(seed: int, env: int, devices: Sequence | None = None) -> Mesh:
    """`seed x env` of JAX's devices, or of those given; ValueError if there are not so many."""
    devices = list(devices or jax.devices())
    if seed * env > len(devices):
        raise ValueError(f"a mesh of {seed} x {env} devices, but JAX sees {len(devices)}")
    return jax.make_mesh(
        (seed, env), ("seed", "env"), (AxisType.Auto,) * 2, devices=devices[: seed * env]
    )


@contextlib.contextmanager
def partitioner(over: Mesh):
    """Compile under this where a mesh has several devices; JAX's own setting is put back.

    JAX 0.11.2's other partitioner, Shardy, ends in a segmentation fault where it compiles physics (of
    either engine) under shard_map for GPUs.
    """
    before = jax.config.jax_use_shardy_partitioner
    jax.config.update("jax_use_shardy_partitioner", before and over.size == 1)
    try:
        yield
    finally:
        jax.config.update("jax_use_shardy_partitioner", before)


def shardings(over: Mesh, state: Any, num_seeds: int) -> Any:
    """How every array of a TrainState (or of its shapes) lies: seeds over `seed`, robots over `env`."""
    seeds = ("seed",) if num_seeds > 1 else ()

    def whole(axes):
        return lambda _: NamedSharding(over, PartitionSpec(*axes))

    return state.replace(
        **{
            name: jax.tree.map(whole((*seeds, "env") if name in ROBOTS else seeds), part)
            for name, part in vars(state).items()
        }
    )

"""Trains many seeds at once with `jax.vmap`, and on many devices with a mesh.

    hyper = seeds.vary(hyper, "ppo.entropy_coef", [1e-2, 3e-3])    # optional
    state = jax.jit(partial(seeds.init, env, static=static))(hyper, seeds.keys(0, 2))
    run = jax.jit(partial(seeds.run, env, static=static))
    state, metrics = run(hyper, state, schedule.columns(config))

On several devices: `env = env._replace(mesh=seeds.mesh(2, 4))`, and `state = jax.device_put(state,
seeds.shardings(env.mesh, state, 2))` before `run`, which is called inside a
`with seeds.partitioner(env.mesh)`. `program.build.program` does this from `run.mesh_*`.

JAX does the work: `jax.jit` splits the program by the sharding of its arguments (`shardings`), and
adds sums over devices where the method takes a mean over robots: gradients, normalisers,
advantages, KL. So the method's code knows nothing of devices. E devices with R robots each compute
what one device with E R robots computes, and no random number depends on a robot's device. Only
physics is told to stay on the device of its robots (`algorithm.physics_step`).

Which axis: use `seed` first, because seeds do not communicate. With the robots of one seed over `env`,
devices sum gradients after each minibatch, which pays off with thousands of robots on each device
(experiments/02_scaling).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo import algorithm, scores
from dynappo.config import fields
from dynappo.types import Env, Hyper, Metrics, Static, TrainState

# fields of TrainState with an axis R, and which of a seed's axes it is
ROBOTS = {"env_state": 0, "params_physics": 0, "robot_index": 0, "memory": 1}


def keys(seed: int, num_seeds: int) -> PRNGKeyArray:
    """The keys `[S]` of seeds `seed`, `seed + 1`, ...; the same keys as in single runs."""
    return jnp.stack([jax.random.key(seed + s) for s in range(num_seeds)])


def vary(hyper: Hyper, field: str, values) -> Hyper:
    """`hyper` with one value of `field` ("ppo.entropy_coef") for each seed.

    Call it several times to vary several fields together: seed s takes value s of each. ValueError
    if there is no such float, if it is None, or if it is built into the environment: the groups run and
    physics, and the errors of `task.randomize` that are 0, which no robot of the compiled program has; also
    if `values` are not a list of numbers that the field may hold.
    """
    group, _, rest = field.partition(".")
    if group in ("run", "physics") or field == "task.armature":
        raise ValueError(
            f"{field} is part of the compiled program, expected a field of ppo, model or task"
        )
    found = _numbers(field, values)
    varied = _set(hyper, field, field.split("."), jnp.asarray(found, jnp.float32))
    for value in found.tolist():
        fields.check(field, value)  # as the command line does
    return varied


def _numbers(field: str, values) -> np.ndarray:
    """`values` [S]; ValueError if they are no list of numbers."""
    try:
        found = np.asarray(values, float)
    except (TypeError, ValueError):
        found = np.empty(())
    if found.ndim != 1 or not len(found):
        raise ValueError(f"{field}: {values!r}, expected a list of a number for each seed")
    return found


def _set(node, field, path, values):
    name, *rest = path
    if name not in getattr(node, "_fields", ()):
        raise ValueError(
            f"{field} is not a float of the config; expected one like ppo.entropy_coef"
        )
    old = getattr(node, name)
    if old is None:
        raise ValueError(
            f"{field} is None, so the compiled program does not have it; expected an environment and a "
            f"hyper of a config where it is a number: set config.{field}, then vary it"
        )
    if not rest and (isinstance(old, tuple) or jnp.ndim(old)):
        raise ValueError(
            f"{field} has several numbers, or a value for each seed already; expected a field with one number"
        )
    if not rest and field.startswith(("task.randomize.", "task.joint_friction")) and not old:
        raise ValueError(
            f"{field} is 0, so no robot of the compiled program has this error; expected an environment and "
            f"a hyper of a config with another value: set config.{field}, then vary it"
        )
    return node._replace(**{name: _set(old, field, rest, values) if rest else values})


def axes(hyper: Hyper) -> Any:
    """`in_axes` for `jax.vmap`: 0 where `hyper` has a value for each seed, else None."""
    return jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, hyper)


def init(env: Env, hyper: Hyper, keys: PRNGKeyArray, *, static: Static) -> TrainState:
    """`algorithm.init` of every seed; arrays get a leading axis S."""
    one = partial(algorithm.init, env, static=static)
    return jax.vmap(one, (axes(hyper), 0), spmd_axis_name="seed")(hyper, keys)


def run(
    env: Env,
    hyper: Hyper,
    state: TrainState,
    columns: dict[str, Int[Array, " I"]],
    *,
    static: Static,
) -> tuple[TrainState, Metrics]:
    """`algorithm.run` of every seed; metrics `[I, S]`. Columns are loop bounds, so not batched."""
    one = partial(algorithm.run, env, static=static)
    over = (axes(hyper), 0, None), (0, 1)
    return jax.vmap(one, *over, spmd_axis_name="seed")(hyper, state, columns)


def evaluate(
    env: Env,
    hyper: Hyper,
    params: dict,
    key: PRNGKeyArray,
    *,
    static: Static,
    num_envs: int,
    num_steps: int,
) -> dict[str, Float[Array, " S"]]:
    """`scores.evaluate` of every seed's policy; all get the same episodes."""
    sizes = dict(static=static, num_envs=num_envs, num_steps=num_steps)
    one = partial(scores.evaluate, env, **sizes)
    return jax.vmap(one, (axes(hyper), 0, None), spmd_axis_name="seed")(hyper, params, key)


def mesh(seed: int, env: int, devices: Sequence | None = None) -> Mesh:
    """A mesh of `seed x env` JAX devices, or of those given; ValueError if there are too few."""
    devices = list(devices or jax.devices())
    if seed * env > len(devices):
        raise ValueError(f"a mesh of {seed} x {env} devices, but JAX sees {len(devices)}")
    return jax.make_mesh(
        (seed, env), ("seed", "env"), (AxisType.Auto,) * 2, devices=devices[: seed * env]
    )


@contextlib.contextmanager
def partitioner(over: Mesh):
    """Compile inside this if a mesh has several devices; JAX's own setting is restored afterwards.

    JAX 0.11.2's other partitioner, Shardy, crashes with a segmentation fault when it compiles
    physics (of either engine) under shard_map for GPUs.
    """
    before = jax.config.jax_use_shardy_partitioner  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_use_shardy_partitioner", before and over.size == 1)
    try:
        yield
    finally:
        jax.config.update("jax_use_shardy_partitioner", before)


def shardings(over: Mesh, state: Any, num_seeds: int) -> Any:
    """The sharding of a TrainState's arrays (or shapes): seeds on `seed`, robots on `env`."""
    seeds = ("seed",) if num_seeds > 1 else ()

    def spread(name):
        return (*seeds, *[None] * ROBOTS[name], "env") if name in ROBOTS else seeds

    def whole(axes):
        return lambda _: NamedSharding(over, PartitionSpec(*axes))

    return state.replace(
        **{name: jax.tree.map(whole(spread(name)), part) for name, part in vars(state).items()}
    )

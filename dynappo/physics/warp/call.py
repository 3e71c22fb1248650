"""Calls Warp once a control step, with only the arrays that the step exchanges.

A robot that has no more than the contract allows takes one kernel of ours (quadruped.py, or tree.py); any
other file takes MuJoCo Warp's own step (general.py). scope.py decides.

Why not `mjx.step`: it takes and returns all 168 arrays of mjx.Data, which every physics step fills and
copies for nothing: 0.95 of a row's 4.40 ms with 4096 Go1 on an H100. Why not a call for each physics step:
XLA's loop around it launches the small kernels of motors and feet four times a row (measured in
experiments/03_speed). A call is captured as a CUDA graph for each set of addresses that JAX passes
(`GraphMode.WARP`, MJX's default; the last 32 are kept). Warp's other modes were measured, and by a rule set
before none is faster (experiments/03_speed).

Warp keeps the other arrays itself, on each device of this process: for each model, one set for each
number of robots that a program is traced with (when batching over seeds, also for the robots of one
seed). They are outside JAX's share of a GPU (program/memory.py) and stay until the process ends.
Calls on one device share them; JAX runs a device's programs one after the other.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from dynappo.description import robot as robot_lib
from dynappo.physics.warp import arrays, scope
from dynappo.terrain.height_map import HeightMap

# one per kind of step: Warp keeps what `jax_callable` was given, arrays included, to the end
_TOGETHER: dict[tuple[Any, ...], Callable[..., Sequence]] = {}


@struct.dataclass
class Model:
    """The fields of a model in which robots may differ (`arrays.MODEL`), and its sizes."""

    body_mass: Any
    body_inertia: Any
    body_ipos: Any
    geom_friction: Any
    dof_armature: Any
    nbody: int = struct.field(pytree_node=False)
    ngeom: int = struct.field(pytree_node=False)
    nv: int = struct.field(pytree_node=False)


def model(mj_model) -> Model:
    """What `randomize.merge` may replace; `mjx.put_model` would take seconds to import."""
    fields = {n: jnp.asarray(getattr(mj_model, n), jnp.float32) for n in arrays.MODEL}
    return Model(**fields, nbody=mj_model.nbody, ngeom=mj_model.ngeom, nv=mj_model.nv)


def make(
    mj_model, robot, substeps: int, every_substep: bool, ground: HeightMap | None = None
) -> Callable[..., dict[str, Any]]:
    """`step(mjx model, state, target [n, A], motor)` of one robot, for `jax.vmap`: a control step on the
    `ground`, which `mj_model` has too.

    `state` has the fields `arrays.IN_OUT`; `motor` [1 or A, 8] are the numbers `arrays.MOTOR`. The result
    has `IN_OUT` after the step, `qd_before` and `lowest`.
    """
    shape = arrays.shape(mj_model, robot, substeps, every_substep, ground)
    floor = () if ground is None else (ground.heights, np.array([ground.cell, *ground.corner]))
    key = robot_lib.digest(mj_model), substeps, every_substep
    key = *key, *(x.tobytes() for x in (*shape[2:-1], *floor))
    if key not in _TOGETHER:
        # made when it is traced: until then Warp may still start
        of_many = functools.cache(functools.partial(_of_many, mj_model, shape))
        _TOGETHER[key] = _batched(lambda *given: of_many()(*given))
    together = _TOGETHER[key]

    def step(model, state, target, motor) -> dict[str, Any]:
        state = [getattr(state, name) for name in arrays.IN_OUT]
        args = (*state, target, motor, *(getattr(model, name) for name in arrays.MODEL))
        found = together(*(x[None] for x in args))
        return dict(zip((*arrays.IN_OUT, *arrays.RESULTS), (x[0] for x in found), strict=True))

    return step


def _of_many(mj_model, shape: arrays.Shape) -> Callable[..., Sequence]:
    """`step(*arrays)` of W robots; fields of the model have W rows or one for all."""
    import warp as wp  # pyright: ignore[reportMissingImports]
    from warp._src.jax import ffi  # pyright: ignore[reportMissingImports]

    from dynappo.physics.warp import building

    kernel = scope.kernel(mj_model, shape.feet, shape.every_substep)
    if kernel == "quadruped":
        from dynappo.physics.warp import quadruped as way
    elif kernel == "tree":
        from dynappo.physics.warp import tree as way
    else:
        from dynappo.physics.warp import general as way
    gpu = jax.local_devices()[0].platform == "gpu"
    sizes = arrays.sizes(mj_model, shape)
    own: dict[tuple[str, int], Any] = {}
    builds: list[Callable[[], None]] = []

    def prepare(count: int) -> None:
        """Allocate what Warp keeps for `count` robots, and begin to build the kernels."""
        # the ordinal that the callback gets, in each of several processes
        devices = [wp.get_cuda_device(d.local_hardware_id) for d in jax.local_devices() if gpu]
        devices = devices or [wp.get_device("cpu")]
        for device in devices:
            if (device.alias, count) in own:
                continue
            # the lock: while another thread captures a call, device and stream are that call's
            with ffi._FFI_CALLBACK_LOCK, wp.ScopedDevice(device):
                own[device.alias, count] = way.allocate(mj_model, shape, count)
                if not builds:
                    given = [_example(wp, sizes[n], kind, count) for n, kind in kinds.items()]
                    builds.append(building.start(building.launched(call, *given), devices))
                wp.synchronize_stream(device)  # JAX's does not wait for it

    def call(*given):
        for wait in builds:
            wait()
        buffers = own[given[0].device.alias, given[0].shape[0]]
        way.control_step(buffers, shape, dict(zip(kinds, given, strict=True)))

    kinds = {name: wp.array(dtype=float, ndim=1 + len(size)) for name, size in sizes.items()}
    kinds |= {name: wp.array2d(dtype=int) for name in arrays.COUNTS}
    kinds |= {name: wp.array2d(dtype=wp.vec3) for name in arrays.MODEL if len(sizes[name]) == 2}
    call.__annotations__ = kinds  # how Warp learns the arrays of a function
    call.__signature__ = inspect.Signature(
        [
            inspect.Parameter(n, inspect.Parameter.POSITIONAL_ONLY, annotation=k)
            for n, k in kinds.items()
        ]
    )
    modes = wp.JaxCallableGraphMode
    few = wp.jax_callable(
        call,
        num_outputs=len(arrays.IN_OUT) + len(arrays.RESULTS),
        in_out_argnames=[*arrays.IN_OUT],
        graph_mode=modes.WARP if gpu else modes.NONE,
        vmap_method=None,
    )

    def step(*args):
        prepare(len(args[0]))
        return few(
            *args, output_dims={name: (len(args[0]), *sizes[name]) for name in arrays.RESULTS}
        )

    return step


def _example(wp, size, kind, count: int):
    """An array as a call gets it."""
    return wp.zeros((count, *size[: kind.ndim - 1]), dtype=kind.dtype)


def _batched(step: Callable[..., Sequence]) -> Callable[..., Sequence]:
    """`step` under `jax.vmap`: a new axis means more robots."""

    @jax.custom_batching.custom_vmap
    def together(*args):
        return step(*args)

    @together.def_vmap
    def more(axis, batched, *args):
        count = args[0].shape[int(batched[0])]

        def flat(i, x):
            if i >= arrays.PER_ROBOT and not batched[i] and len(x) == 1:
                return x
            x = x if batched[i] else x[None]
            return jnp.broadcast_to(x, (axis, count, *x.shape[2:])).reshape(-1, *x.shape[2:])

        found = together(*(flat(i, x) for i, x in enumerate(args)))
        return [x.reshape(axis, count, *x.shape[1:]) for x in found], [True] * len(found)

    return together

"""Calls MuJoCo Warp with only the eleven arrays of a robot that a physics step exchanges.

Why not `mjx.step`: it takes and returns all 168 arrays of mjx.Data. A step overwrites them, so they
are filled and copied for nothing. With 4096 Go1 on an H100 that took 0.95 of a row's 4.40 ms, and
still 0.32 when they were filled once per control step (prototypes, experiments/03_speed). The
kernels are MJX's own, and so is the way to call them: `wp.jax_callable`, captured as a CUDA graph
for each set of addresses that JAX passes (`GraphMode.WARP`, MJX's default); the last 32 graphs are
kept.

Warp keeps the other arrays itself, on each device of this process: for each model, one set for each
number of robots that a program is traced with (when batching over seeds, also for the robots of one
seed). They are outside JAX's share of a GPU (program/memory.py) and stay until the process ends.
Calls on one device share them; JAX runs a device's programs one after the other.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from dynappo.physics import robot as robot_lib

# one per model: Warp keeps what `jax_callable` was given, arrays included, until the process ends
_TOGETHER: dict[tuple[str, int, int], Callable[..., list]] = {}
STATE = 4  # a call's first arrays, which differ between robots: qpos, qvel, qacc_warmstart, ctrl


@struct.dataclass
class Moved:
    """What is kept of a physics step, with mjx.Data's names; geoms are those at its start."""

    qpos: Any
    qvel: Any
    qacc_warmstart: Any
    geom_xpos: Any
    geom_xmat: Any


def make(mj_model, contacts: int, rows: int) -> tuple[Moved, Callable[..., Moved]]:
    """A template, and `step(mjx model, Moved, ctrl)` of one robot, for `jax.vmap`.

    All robots share one contact buffer with room for `contacts` each, and each has `rows`
    constraint rows: as many as one robot can need, so that neither can overflow.
    """
    zeros = {name: jnp.zeros(size) for name, size in _sizes(mj_model).items()}
    key = robot_lib.digest(mj_model), contacts, rows
    if key not in _TOGETHER:
        _TOGETHER[key] = _batched(_of_many(mj_model, contacts, rows))
    together = _TOGETHER[key]

    def step(model, at: Moved, ctrl) -> Moved:
        fields = model.body_mass, model.body_inertia, model.body_ipos, model.geom_friction
        fields = *fields, model.dof_armature
        args = (at.qpos, at.qvel, at.qacc_warmstart, ctrl, *fields)
        return Moved(*(x[0] for x in together(*(x[None] for x in args))))

    return Moved(**zeros), step


def _sizes(mj_model) -> dict[str, tuple[int, ...]]:
    nq, nv, geoms = mj_model.nq, mj_model.nv, mj_model.ngeom
    return dict(
        qpos=(nq,), qvel=(nv,), qacc_warmstart=(nv,), geom_xpos=(geoms, 3), geom_xmat=(geoms, 3, 3)
    )


def _of_many(mj_model, contacts: int, rows: int) -> Callable[..., list]:
    """`step(*arrays)` of W robots; fields of the model have W rows or one for all."""
    import warp as wp  # pyright: ignore[reportMissingImports]
    from mujoco.mjx.third_party import mujoco_warp
    from warp._src.jax import ffi  # pyright: ignore[reportMissingImports]

    gpu = jax.local_devices()[0].platform == "gpu"
    own: dict[tuple[str, int], tuple[Any, Any]] = {}

    def prepare(count: int) -> None:
        """Allocate arrays of `count` robots now: a graph that is captured cannot allocate."""
        # the ordinal that the callback gets, in each of several processes
        places = [wp.get_cuda_device(d.local_hardware_id) for d in jax.local_devices() if gpu]
        for place in places or [wp.get_device("cpu")]:
            if (place.alias, count) in own:
                continue
            # the lock: while another thread captures a call, device and stream are that call's
            with ffi._FFI_CALLBACK_LOCK, wp.ScopedDevice(place):
                model = mujoco_warp.put_model(mj_model)
                model.opt.warn_overflow = 0  # else a line per world and step at the solver's limit
                data = mujoco_warp.make_data(
                    mj_model, nworld=count, naconmax=count * contacts, njmax=rows
                )
                wp.synchronize_stream(place)  # JAX's does not wait for it
            own[place.alias, count] = model, data

    def call(qpos, qvel, qacc_warmstart, ctrl, mass, inertia, ipos, friction, armature, xpos, xmat):
        model, data = own[qpos.device.alias, qpos.shape[0]]
        model = dataclasses.replace(
            model,
            body_mass=mass,
            body_inertia=inertia,
            body_ipos=ipos,
            geom_friction=friction,
            dof_armature=armature,
        )
        data = dataclasses.replace(
            data, qpos=qpos, qvel=qvel, qacc_warmstart=qacc_warmstart, ctrl=ctrl
        )
        mujoco_warp.step(model, data)
        wp.copy(xpos, data.geom_xpos)  # a step writes only those of geoms that can move
        wp.copy(xmat, data.geom_xmat)

    kinds = [float] * 5 + [wp.vec3] * 3 + [float, wp.vec3, wp.mat33]
    names = inspect.signature(call).parameters
    call.__annotations__ = {n: wp.array2d(dtype=k) for n, k in zip(names, kinds, strict=True)}
    modes = wp.JaxCallableGraphMode
    few = wp.jax_callable(
        call,
        num_outputs=5,
        in_out_argnames=["qpos", "qvel", "qacc_warmstart"],
        graph_mode=modes.WARP if gpu else modes.NONE,
        vmap_method=None,
    )

    def step(*args):
        prepare(len(args[0]))
        geoms = (len(args[0]), mj_model.ngeom)
        return few(*args, output_dims=dict(xpos=geoms, xmat=geoms))

    return step


def _batched(step: Callable[..., list]) -> Callable[..., list]:
    """`step` under `jax.vmap`: a new axis means more robots."""

    @jax.custom_batching.custom_vmap
    def together(*args):
        return step(*args)

    @together.def_vmap
    def more(axis, batched, *args):
        count = args[0].shape[int(batched[0])]

        def flat(i, x):
            if i >= STATE and not batched[i] and len(x) == 1:
                return x
            x = x if batched[i] else x[None]
            return jnp.broadcast_to(x, (axis, count, *x.shape[2:])).reshape(-1, *x.shape[2:])

        found = together(*(flat(i, x) for i, x in enumerate(args)))
        return [x.reshape(axis, count, *x.shape[1:]) for x in found], [True] * len(found)

    return together

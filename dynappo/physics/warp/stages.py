"""A control step in MuJoCo Warp: motors, physics by its own stages, and what is kept.

Why not `mujoco_warp.step`: with 1024 robots a kernel costs what its launch costs, and 26 of the 71
launches outside the solver's loop do nothing for a robot that keeps the contract (contract.py):
cameras, transmissions of gear 1, springs, a second factorisation for damping that is zero. A file
that has more takes `mujoco_warp.step` itself.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]
from mujoco.mjx.third_party import mujoco_warp as mjw
from mujoco.mjx.third_party.mujoco_warp._src import smooth

from dynappo.physics.warp import arrays, building, kernels

MOST_ROUNDS = 8  # without a loop in the CUDA graph


def plain(model: mujoco.MjModel) -> bool:
    """Whether the stages of this module are all that the model's step does."""
    acts = "dof_dampingpoly", "dof_frictionloss", "jnt_stiffness", "body_gravcomp"
    medium = model.opt.density, model.opt.viscosity, *model.opt.wind
    euler = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    nothing = not any(np.any(getattr(model, name)) for name in acts) and not any(medium)
    flags = model.opt.disableflags | model.opt.enableflags
    return bool(euler and nothing and not flags and not model.opt.noslip_iterations)


class Kept(NamedTuple):
    """What Warp keeps on one device for one number of robots."""

    model: Any
    data: Any
    plain: bool
    damped: bool  # joints with damping, which MuJoCo integrates implicitly
    timestep: float
    feet: Any  # [F] geoms
    radius: Any  # [F] m
    parts: Any  # [G] geoms
    floor: Any  # [G, 5]
    work: dict[int, Any]  # what a physics step would allocate


def kept(model, data, shape, plain: bool) -> Kept:
    """With the arrays of a `warp.arrays.Shape`."""
    if plain:  # nothing reads the site, nor what the base would add up in the world
        model = dataclasses.replace(model, nsite=0, body_tree=model.body_tree[2:])
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    # few rounds of Newton's method one after the other: a graph's loop costs more than it saves
    model.opt.graph_conditional = int(model.opt.iterations) > MOST_ROUNDS
    return Kept(
        model=model,
        data=data,
        plain=plain,
        damped=bool(model.dof_damping.numpy().any()),
        timestep=float(model.opt.timestep.numpy()[0]),
        feet=wp.array(shape.feet, dtype=int),
        radius=wp.array(shape.radius, dtype=float),
        parts=wp.array(shape.parts, dtype=int),
        floor=wp.array(shape.floor, dtype=float),
        work={},
    )


def control_step(kept: Kept, shape, a: dict[str, Any]) -> None:
    """All physics steps of a control step, on the arrays `a` of `warp.arrays.sizes`."""
    count = a["qvel"].shape[0]
    state = {name: a[name] for name in ("qpos", "qvel", "qacc_warmstart")}
    model = dataclasses.replace(kept.model, **{name: a[name] for name in arrays.MODEL})
    data = dataclasses.replace(kept.data, **state, ctrl=a["torque"])
    for substep in range(shape.substeps):
        with _allocated(kept.work):
            _physics_step(kept, model, data, a, substep)
        wp.launch(
            kernels.keep,
            dim=(count, kept.feet.size + kept.parts.size),
            inputs=[
                int(shape.every),
                substep,
                shape.substeps - 1,
                kept.feet,
                kept.radius,
                kept.parts,
                kept.floor,
                data.geom_xpos,
                data.geom_xmat,
            ],
            outputs=[a[name] for name in (*arrays.KEPT[4:], "lowest")],
        )


def _physics_step(kept: Kept, model, data, a: dict[str, Any], substep: int) -> None:
    count, dofs = data.qvel.shape
    if kept.plain:
        _forces(model, data)
    wp.launch(
        kernels.motors,
        dim=(count, dofs),
        inputs=[
            substep,
            a["target"],
            a["motor"],
            model.dof_damping,
            data.qpos,
            data.qvel,
            data.qfrc_bias,
        ],
        outputs=[data.ctrl, a["qd_before"], data.qfrc_smooth],
    )
    if not kept.plain:
        mjw.step(model, data)
        return
    _accelerations(model, data)
    if kept.damped:
        mjw.euler(model, data)
    else:
        wp.launch(
            kernels.integrate,
            dim=(count, dofs - kernels.BASE + 1),
            inputs=[kept.timestep, data.qacc],
            outputs=[data.qpos, data.qvel, data.qacc_warmstart],
        )


@contextlib.contextmanager
def _allocated(work: dict[int, Any]) -> Iterator[None]:
    """Gives arrays of `work` to those who allocate, in the same order in every physics step: a
    graph with allocations of its own is slower, and a first one fails where memory is short."""
    order = itertools.count()
    empty_of_warp = wp.empty

    def empty(shape=None, dtype=float, **_):
        number = next(order)
        if number not in work:
            work[number] = empty_of_warp(shape, dtype=dtype)
        return work[number]

    def zeros(shape=None, dtype=float, **_):
        array = empty(shape, dtype)
        array.zero_()
        return array

    def full(shape=None, value=0, dtype=float, **_):
        array = empty(shape, dtype)
        array.fill_(value)
        return array

    with building.instead(empty=empty, zeros=zeros, full=full):
        yield


def _forces(model, data) -> None:
    """All that depends on positions and velocities: inertia, contacts, limits, bias forces."""
    mjw.kinematics(model, data)
    mjw.com_pos(model, data)
    mjw.crb(model, data)
    mjw.collision(model, data)
    mjw.make_constraint(model, data)
    mjw.com_vel(model, data)
    mjw.rne(model, data)


def _accelerations(model, data) -> None:
    """From `qfrc_smooth` to `qacc`, with the forces of contacts and limits."""
    smooth.factor_solve_i(
        model, data, data.M, data.qLD, data.qLDiagInv, data.qacc_smooth, data.qfrc_smooth
    )
    mjw.solve(model, data)

"""A control step of any file by MuJoCo Warp's own step, where our kernel declines (`scope.declines`): with
dry friction, for example, or contacts of every part.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import mujoco
import warp as wp  # pyright: ignore[reportMissingImports]
from mujoco.mjx.third_party import mujoco_warp as mjw

from dynappo.description import contacts
from dynappo.physics.warp import arrays, kernels, rough

FEW = 8  # rounds of Newton's method that cost less one after the other than a graph's loop does


class Buffers(NamedTuple):
    """What Warp keeps on one device for one number of robots."""

    model: Any
    data: Any
    keep: Any  # the kernel of timers and heights, and its arguments behind the first three
    numbers: list[Any]


def allocate(mj_model: mujoco.MjModel, shape: arrays.Shape, count: int) -> Buffers:
    """Allocate buffers that cannot overflow: one for all contacts that all robots can have, and for each
    robot the constraint rows that it can need."""
    room, rows = contacts.most(mj_model)
    model = mjw.put_model(mj_model)
    model.opt.warn_overflow = 0  # else a line per world and step at the solver's limit
    model.opt.graph_conditional = int(model.opt.iterations) > FEW
    return Buffers(
        model=model,
        data=mjw.make_data(mj_model, nworld=count, naconmax=count * room, njmax=rows),
        keep=kernels.keep if shape.ground is None else rough.keep,
        numbers=_flat(shape) if shape.ground is None else rough.arguments(mj_model, shape),
    )


def _flat(shape: arrays.Shape) -> list[Any]:
    given = (shape.first, int), (shape.feet, int), (shape.soles, float), (shape.parts, int)
    return [wp.array(x, dtype=kind) for x, kind in (*given, (shape.floor, float))]


def control_step(buffers: Buffers, shape: arrays.Shape, a: dict[str, Any]) -> None:
    """All physics steps of a control step, on the arrays `a` of `warp.arrays.sizes`."""
    count, dofs = a["qvel"].shape
    state = {name: a[name] for name in ("qpos", "qvel", "qacc_warmstart")}
    model = dataclasses.replace(buffers.model, **{name: a[name] for name in arrays.MODEL})
    data = dataclasses.replace(buffers.data, **state, ctrl=a["torque"])
    for substep in range(shape.substeps):
        wp.launch(
            kernels.motors,
            dim=(count, dofs - kernels.BASE),
            inputs=[substep, a["target"], a["motor"], data.qpos, data.qvel],
            outputs=[data.ctrl, data.qfrc_applied, a["qd_before"]],
        )
        mjw.step(model, data)
        wp.launch(
            buffers.keep,
            dim=(count, len(shape.first) - 1 + len(shape.parts)),
            inputs=[
                int(shape.every_substep),
                substep,
                shape.substeps - 1,
                *buffers.numbers,
                data.geom_xpos,
                data.geom_xmat,
            ],
            outputs=[a[name] for name in (*arrays.IN_OUT[4:], "lowest")],
        )

"""A control step of a quadruped in one kernel of our own: quadruped.h, and its numbers.

Why our own: MuJoCo Warp takes about 95 launches for a physics step of 1024 robots, most of them 2 to
15 us long, and all robots wait for the one whose solver takes longest. The contract of a robot's
file (robot_contract.py) says nearly all that a kernel must know: a base, four legs of three hinges, feet
that are spheres on a plane. With a thread for each leg, the numbers of a robot never leave its
registers within a control step, and the legs meet only in the base's six equations.

It solves MuJoCo's own problem (soft contacts with a pyramidal cone, joint limits, implicit damping)
by Newton's method with an exact line search; tests compare it with C MuJoCo and `mjx.step`. It reads
`constants` and `arrays.MODEL` of a model; scope.py must know all of these.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.description import contacts
from dynappo.description.rotation import matrix
from dynappo.physics.warp import arrays, native
from dynappo.physics.warp.scope import LEGS, LINKS

THREADS = LEGS  # of a robot on a GPU, one a leg
# where the constants are: of the whole, of a link, of a foot, of a constraint, of a part
WHOLE = dict(TIMESTEP=0, GRAVITY=1, TOLERANCE=2, TRUNK=3, LINKS=12, FEET=12 + LINKS * 28)
LINK_AT = dict(PLACE=0, AXIS=3, TURN=6, LOW=15, HIGH=16, DAMPING=17, LIMIT=18, LINK=28)
FOOT_AT = dict(RADIUS=3, GEOM=4, CONTACT=5, FOOT=15)
PART_AT = dict(PART=18)
MAP = WHOLE["FEET"] + LEGS * FOOT_AT["FOOT"]  # behind them all, arrays.map_numbers
_PLACES = WHOLE | LINK_AT | FOOT_AT | native.CONSTRAINT_AT
_CODE = native.code(_PLACES | PART_AT, "arrow", "quadruped")
_ROUGH = native.code(_PLACES | dict(MAP=MAP, PART=native.PROBE), "arrow", "quadruped", rough=True)


def constants(model: mujoco.MjModel, shape: arrays.Shape) -> np.ndarray:
    """What all robots share, in the order of `WHOLE`."""
    gravity, tolerance = model.opt.gravity[2], model.opt.tolerance
    numbers = [model.opt.timestep, gravity, tolerance, *matrix(model.body_iquat[1]).ravel()]
    for joint in range(1, 1 + LINKS):
        body, dof = model.jnt_bodyid[joint], model.jnt_dofadr[joint]
        numbers += [
            *model.body_pos[body],
            *model.jnt_axis[joint],
            *matrix(model.body_iquat[body]).ravel(),
        ]
        numbers += [*model.jnt_range[joint], model.dof_damping[dof]]
        limit = model.jnt_solref[joint], model.jnt_solimp[joint], model.dof_invweight0[dof]
        numbers += [*native.constraint(model, *limit), 0, 0]
    for foot in shape.feet:
        numbers += [*model.geom_pos[foot], model.geom_size[foot, 0], foot]
        weight = model.body_invweight0[model.geom_bodyid[foot], 0] / model.opt.impratio
        contact = model.geom_solref[foot], model.geom_solimp[foot], weight
        numbers += [*native.constraint(model, *contact), 0, 0]
    return np.array(numbers, np.float32)


def parts(model: mujoco.MjModel, shape: arrays.Shape) -> tuple[np.ndarray, np.ndarray]:
    """`(first [nbody + 1], numbers [G, PART])`: the parts body by body; of each its place, rotation,
    `contacts.floor_distance` and number."""
    body = model.geom_bodyid[shape.parts]
    first = np.searchsorted(np.sort(body), np.arange(model.nbody + 1)).astype(np.int32)
    rows = [
        [*model.geom_pos[g], *matrix(model.geom_quat[g]).ravel(), *shape.floor[i], i]
        for i, g in ((i, shape.parts[i]) for i in np.argsort(body, kind="stable"))
    ]
    return first, np.array(rows, np.float32).reshape(-1, PART_AT["PART"])


def probes(model: mujoco.MjModel, shape: arrays.Shape) -> tuple[np.ndarray, np.ndarray]:
    """As `parts`, of the probes (contacts.py) for ground that is not flat: place, axis of the ring, radius,
    ring, number of the part, and 1 for the part's first."""
    found = contacts.probes(model, shape.parts)
    geom = shape.parts[found.geom]
    order = np.argsort(model.geom_bodyid[geom], kind="stable")
    first = np.searchsorted(model.geom_bodyid[geom][order], np.arange(model.nbody + 1))
    new = np.diff(found.geom, prepend=-1) > 0
    rows = []
    for i in order:
        turn = matrix(model.geom_quat[geom[i]])
        place = model.geom_pos[geom[i]] + turn @ found.place[i]
        rows.append([*place, *turn[:, 2], found.radius[i], found.ring[i], found.geom[i], new[i]])
    return first.astype(np.int32), np.array(rows, np.float32).reshape(-1, native.PROBE)


class Buffers(NamedTuple):
    """What Warp keeps on one device."""

    code: str
    numbers: list[Any]  # the kernel's first arguments
    gpu: bool


def allocate(mj_model: mujoco.MjModel, shape: arrays.Shape, _: int = 0) -> Buffers:
    """On the current device."""
    rough, whole = shape.ground is not None, constants(mj_model, shape)
    first, rows = (probes if rough else parts)(mj_model, shape)
    if shape.ground is not None:
        whole = np.concatenate([whole, arrays.map_numbers(shape.ground)])
    opt, damped = mj_model.opt, bool(mj_model.dof_damping.any())
    numbers = [shape.substeps, int(opt.iterations), int(opt.ls_iterations), int(damped)]
    numbers += [wp.array(whole, dtype=float), wp.array(first, dtype=int)]
    numbers += [wp.array2d(rows, dtype=float)]
    return Buffers(_ROUGH if rough else _CODE, numbers, wp.get_device().is_cuda)


def control_step(buffers: Buffers, _: arrays.Shape, a: dict[str, Any]) -> None:
    """All physics steps of a control step, on the arrays `a` of `warp.arrays.sizes`."""
    native.launch(native.kernel(buffers.code), THREADS if buffers.gpu else 1, buffers.numbers, a)

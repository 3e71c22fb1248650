"""A control step of a quadruped in one kernel of our own: algebra.h, quadruped.h, and their numbers.

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

from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.description.rotation import matrix
from dynappo.physics.actuators import FRICTION_SPEED
from dynappo.physics.warp import arrays
from dynappo.physics.warp.scope import LEGS, LINKS

THREADS = LEGS  # of a robot on a GPU, one a leg
BLOCK = 32  # threads: few, so that 1024 robots are on all processors of a GPU
# where the constants are: of the whole, of a link, of a foot, of a constraint, of a part
WHOLE = dict(TIMESTEP=0, GRAVITY=1, TOLERANCE=2, TRUNK=3, LINKS=12, FEET=12 + LINKS * 28)
LINK_AT = dict(PLACE=0, AXIS=3, TURN=6, LOW=15, HIGH=16, DAMPING=17, LIMIT=18, LINK=28)
FOOT_AT = dict(RADIUS=3, GEOM=4, CONTACT=5, FOOT=15)
CONSTRAINT_AT = dict(B=5, K=6, INVWEIGHT=7)
PART_AT = dict(PART=18)
_NAMES = WHOLE | LINK_AT | FOOT_AT | CONSTRAINT_AT | PART_AT


def _constraint(model, solref, solimp, invweight) -> list[float]:
    """The numbers of `impedance`, then b and k (MuJoCo: mj_makeImpedance), and `invweight`."""
    time, ratio = max(solref[0], 2 * model.opt.timestep), solref[1]
    low, high = np.clip(solimp[:2], 1e-4, 0.9999)
    mid, power = np.clip(solimp[3], 1e-4, 0.9999), max(solimp[4], 1)
    if low == high or solimp[2] <= 1e-15:
        low = high = (low + high) / 2
    top = np.clip(solimp[1], 1e-4, 0.9999)
    b, k = 2 / (top * time), 1 / (top * time * ratio) ** 2
    return [low, high, max(solimp[2], 1e-15), mid, power, b, k, invweight, 0, 0]


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
        weight = model.dof_invweight0[dof]
        numbers += _constraint(model, model.jnt_solref[joint], model.jnt_solimp[joint], weight)
    for foot in shape.feet:
        numbers += [*model.geom_pos[foot], model.geom_size[foot, 0], foot]
        weight = model.body_invweight0[model.geom_bodyid[foot], 0] / model.opt.impratio
        numbers += _constraint(model, model.geom_solref[foot], model.geom_solimp[foot], weight)
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


_SNIPPET = (
    "".join(f"enum {{ {name} = {place} }};\n" for name, place in _NAMES.items())
    + f"const float FRICTION_SPEED = {FRICTION_SPEED!r};\n"
    + "".join(Path(__file__).with_name(name).read_text() for name in ("algebra.h", "quadruped.h"))
)


@wp.func_native(_SNIPPET)
def leg(  # pyright: ignore[reportReturnType]
    thread: int,
    substeps: int,
    rounds: int,
    line_rounds: int,
    damped: int,
    constants: wp.array[float],
    part_of: wp.array[int],
    parts: wp.array2d[float],
    target: wp.array3d[float],  # [W, n, A] rad
    motor: wp.array3d[float],  # [W, 1 or A, 8], arrays.MOTOR
    body_mass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    body_ipos: wp.array2d[wp.vec3],
    geom_friction: wp.array2d[wp.vec3],
    dof_armature: wp.array2d[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc_warmstart: wp.array2d[float],
    torque: wp.array2d[float],
    air_steps: wp.array2d[int],
    contact_steps: wp.array2d[int],
    last_air_steps: wp.array2d[int],
    peak: wp.array2d[float],
    last_peak: wp.array2d[float],
    qd_before: wp.array2d[float],
    lowest: wp.array2d[float],
): ...


@wp.kernel(enable_backward=False)
def step(
    substeps: int,
    rounds: int,
    line_rounds: int,
    damped: int,
    constants: wp.array[float],
    part_of: wp.array[int],
    parts: wp.array2d[float],
    target: wp.array3d[float],
    motor: wp.array3d[float],
    body_mass: wp.array2d[float],
    body_inertia: wp.array2d[wp.vec3],
    body_ipos: wp.array2d[wp.vec3],
    geom_friction: wp.array2d[wp.vec3],
    dof_armature: wp.array2d[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc_warmstart: wp.array2d[float],
    torque: wp.array2d[float],
    air_steps: wp.array2d[int],
    contact_steps: wp.array2d[int],
    last_air_steps: wp.array2d[int],
    peak: wp.array2d[float],
    last_peak: wp.array2d[float],
    qd_before: wp.array2d[float],
    lowest: wp.array2d[float],
):
    """`substeps` physics steps under the motors; a thread a leg on a GPU, a thread a robot else."""
    thread = wp.tid()
    leg(
        thread,
        substeps,
        rounds,
        line_rounds,
        damped,
        constants,
        part_of,
        parts,
        target,
        motor,
        body_mass,
        body_inertia,
        body_ipos,
        geom_friction,
        dof_armature,
        qpos,
        qvel,
        qacc_warmstart,
        torque,
        air_steps,
        contact_steps,
        last_air_steps,
        peak,
        last_peak,
        qd_before,
        lowest,
    )


class Buffers(NamedTuple):
    """What Warp keeps on one device."""

    numbers: list[Any]  # the first arguments of `control_step`
    gpu: bool


def allocate(mj_model: mujoco.MjModel, shape: arrays.Shape, _: int = 0) -> Buffers:
    """On the current device."""
    first, rows = parts(mj_model, shape)
    opt, damped = mj_model.opt, bool(mj_model.dof_damping.any())
    numbers = [shape.substeps, int(opt.iterations), int(opt.ls_iterations), int(damped)]
    numbers += [wp.array(constants(mj_model, shape), dtype=float), wp.array(first, dtype=int)]
    return Buffers([*numbers, wp.array2d(rows, dtype=float)], wp.get_device().is_cuda)


def control_step(buffers: Buffers, _: arrays.Shape, a: dict[str, Any]) -> None:
    """All physics steps of a control step, on the arrays `a` of `warp.arrays.sizes`."""
    robots = a["qpos"].shape[0]
    changed = *arrays.IN_OUT, *arrays.RESULTS
    wp.launch(
        step,
        dim=robots * (THREADS if buffers.gpu else 1),
        inputs=[*buffers.numbers, *(a[name] for name in ("target", "motor", *arrays.MODEL))],
        outputs=[a[name] for name in changed],
        block_dim=BLOCK,
    )

"""A kernel that does a control step, from the C++ that does it for a thread: quadruped.h, or tree.h.

Every kernel is a Warp module of its own, named by its code, so that Warp's cache on disk finds it again.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.physics.actuators import FRICTION_SPEED
from dynappo.physics.warp import arrays

PROBE = 10  # numbers of a part's probe, on ground that is not flat
BLOCK = 32  # threads: few, so that 1024 robots are on all processors of a GPU
CONSTRAINT_AT = dict(B=5, K=6, INVWEIGHT=7)  # of `constraint`


def constraint(model, solref, solimp, invweight) -> list[float]:
    """The numbers of `impedance` in algebra.h, then b and k (MuJoCo: mj_makeImpedance), and `invweight`."""
    time, ratio = max(solref[0], 2 * model.opt.timestep), solref[1]
    low, high = np.clip(solimp[:2], 1e-4, 0.9999)
    mid, power = np.clip(solimp[3], 1e-4, 0.9999), max(solimp[4], 1)
    if low == high or solimp[2] <= 1e-15:
        low = high = (low + high) / 2
    top = np.clip(solimp[1], 1e-4, 0.9999)
    b, k = 2 / (top * time), 1 / (top * time * ratio) ** 2
    return [low, high, max(solimp[2], 1e-15), mid, power, b, k, invweight]


def code(sizes: dict[str, int], *headers: str, rough: bool = False) -> str:
    """The constants `sizes`, then the headers algebra.h and `headers`; `rough`: as for ground that is not
    flat, with ground.h."""
    headers = ("ground", *headers) if rough else headers
    lines = [f"enum {{ {name} = {value} }};\n" for name, value in sizes.items()]
    lines.append(f"const float FRICTION_SPEED = {FRICTION_SPEED!r};\n")
    texts = [Path(__file__).with_name(f"{name}.h").read_text() for name in ("algebra", *headers)]
    text = "".join(lines + texts)
    return f"#define GROUND 1\n{text}\n#undef GROUND\n" if rough else text


@functools.cache
def kernel(snippet: str) -> Any:
    """Of a text of `code`. Warp reads arguments from the source of both functions, so they stand twice."""

    @wp.func_native(snippet)
    def of_thread(  # pyright: ignore[reportReturnType]
        thread: int,
        substeps: int,
        rounds: int,
        line_rounds: int,
        flag: int,
        numbers: wp.array[float],
        tables: wp.array[int],
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

    @wp.kernel(enable_backward=False, module="unique")
    def control_step(
        substeps: int,
        rounds: int,
        line_rounds: int,
        flag: int,
        numbers: wp.array[float],
        tables: wp.array[int],
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
        thread = wp.tid()
        of_thread(
            thread,
            substeps,
            rounds,
            line_rounds,
            flag,
            numbers,
            tables,
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

    return control_step


def launch(step, threads: int, numbers: list[Any], a: dict[str, Any]) -> None:
    """`step` for all robots, with so many threads each; `numbers` are its first arguments, `a` the arrays of
    `arrays.sizes`."""
    wp.launch(
        step,
        dim=a["qpos"].shape[0] * threads,
        inputs=[*numbers, *(a[name] for name in ("target", "motor", *arrays.MODEL))],
        outputs=[a[name] for name in (*arrays.IN_OUT, *arrays.RESULTS)],
        block_dim=BLOCK,
    )

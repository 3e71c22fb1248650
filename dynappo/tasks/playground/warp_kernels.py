"""MJX-Warp for a task: its kernels are built side by side, and it is silent about solvers that stop early.

MJX builds each kernel when it is first launched, one after the other: for a G1 156 s at the first start
(H100). Here MuJoCo Warp's own step runs once without its launches, to see which kernels it has, and threads
build them while JAX traces and XLA compiles. Built kernels are kept on disk by Warp.
"""

from __future__ import annotations

from typing import Any

import jax
import warp as wp  # pyright: ignore[reportMissingImports]
from mujoco.mjx.third_party import mujoco_warp as mjw

from dynappo.physics.warp import building


def quiet(mjx_model: Any) -> Any:
    """The model without a line for each world and step whose solver stops at its limit, as all tasks have
    it; room for contacts or constraints that runs out is still told."""
    kinds = mjw.OverflowType
    told = int(mjx_model.opt._impl.warn_overflow) & ~int(kinds.ITERATIONS | kinds.LS_ITERATIONS)
    return mjx_model.tree_replace({"opt._impl.warn_overflow": told})


def build(task: Any) -> None:
    """Begin to build the kernels of the task's physics; `building.wait` waits for them."""
    wp.config.log_level = wp.LOG_WARNING  # else a line for each kernel that is loaded
    gpu = jax.local_devices()[0].platform == "gpu"
    devices = [wp.get_cuda_device(d.local_hardware_id) for d in jax.local_devices() if gpu]
    devices = devices or [wp.get_device("cpu")]
    with wp.ScopedDevice(devices[0]):
        model = mjw.put_model(task.mj_model)
        model.opt.warn_overflow = (
            task.mjx_model.opt._impl.warn_overflow
        )  # it is part of some kernels
        data = mjw.make_data(task.mj_model, nworld=1, naconmax=64, njmax=task._config.njmax)
        building.start(building.launched(lambda: mjw.step(model, data)), devices)

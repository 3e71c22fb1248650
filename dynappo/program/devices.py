"""Chooses the devices and the engine of a run, and sets up JAX for a command.

Only commands call `own_process`: in a notebook it would override the user's settings.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import threading
import warnings
from pathlib import Path

from dynappo.config import ConfigError, shell

# as printed; "own" is the engine of an environment of your own
ENGINES = {"jax": "MJX-JAX", "warp": "Warp", "c": "C MuJoCo", "own": "JAX"}
# what a shell may set for other programs, and with which ours cannot be traced or mean something else
USUAL = {
    "jax_enable_x64": False,
    "jax_debug_nans": False,
    "jax_debug_infs": False,
    "jax_disable_jit": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_numpy_rank_promotion": "allow",
}


def own_process(device: str = "auto") -> None:
    """Set up JAX for a command: "cpu" touches no GPU, and compiled programs are cached on disk
    unless the user has set a cache. Warnings of libraries become one line."""
    if device == "cpu":  # no alarms of a slow compiler, as in dynappo/__init__.py
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    try:
        import jax
    except ValueError as error:  # a variable JAX_... that is not a number or not a bool
        raise ConfigError(
            f"JAX does not start: {error}; correct that variable of the shell"
        ) from None
    warnings.formatwarning = lambda message, *_, **__: f"dynappo: {str(message).splitlines()[0]}\n"
    warnings.filterwarnings("ignore", "Brax System")  # which is not maintained: docs/environment.md
    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    other = [name for name, usual in USUAL.items() if getattr(jax.config, name) != usual]
    for name in other:
        jax.config.update(name, USUAL[name])
    if other:
        names = ", ".join(map(str.upper, other))
        warnings.warn(f"{names} of the shell: dynappo does not compute so; off here", stacklevel=2)
    cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "dynappo" / "jax"
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache))
    if not os.environ.get("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"):
        # small programs too: a start has a dozen, 0.1 to 0.4 s each
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def begin() -> None:
    """Start JAX's devices in a thread: a GPU takes half a second, and Python imports the rest meanwhile."""
    import jax

    def start():
        with contextlib.suppress(RuntimeError):  # `available` reports it
            jax.devices()

    threading.Thread(target=start, daemon=True).start()


def available(device: str) -> list:
    """The JAX devices that `run.device` means, of all processes; ConfigError if there are none."""
    import jax

    try:
        jax.devices("cpu" if device == "cpu" else None)
    except RuntimeError as error:  # JAX_PLATFORMS and JAX_NUM_CPU_DEVICES can cause it
        raise ConfigError(f"JAX finds no device: {error}") from None
    if device == "cpu":
        return jax.devices("cpu")
    if device == "gpu" and jax.default_backend() != "gpu":
        raise ConfigError(
            f"run.device is gpu, but JAX sees none; {shell.install('cuda')} (cuda12 where nvidia-smi "
            "shows a driver before 580), or set run.device=cpu"
        )
    return jax.devices()


def local(device: str):
    """The first of `available(device)` that belongs to this process."""
    import jax

    return next(d for d in available(device) if d.process_index == jax.process_index())


def engine(config) -> str:
    """The engine for `physics.impl`: "jax", "warp" or "c"; ConfigError if it cannot run here."""
    import jax

    devices, wanted = available(config.run.device), config.run.mesh_seed * config.run.mesh_env
    gpu = devices[0].platform == "gpu"
    warp = importlib.util.find_spec("warp") is not None
    if config.physics.impl == "warp" and not (gpu and warp):
        lack = "warp-lang is not installed" if gpu else "JAX sees no NVIDIA GPU"
        raise ConfigError(
            f"physics.impl is warp, but {lack}; {shell.install('warp' if gpu else 'cuda')}, or set "
            "physics.impl=jax"
        )
    if config.physics.impl == "c" and devices[0].platform != "cpu":
        raise ConfigError(
            "physics.impl is c, which runs on a CPU, but run.device is "
            f"{config.run.device} and JAX sees a {devices[0].platform}; set run.device=cpu or "
            "physics.impl=auto"
        )
    if wanted > len(devices) or (jax.process_count() > 1 and wanted < len(devices)):
        raise ConfigError(
            f"run.mesh_seed x run.mesh_env is {config.run.mesh_seed} x {config.run.mesh_env}, but "
            f"JAX sees {len(devices)} devices in {jax.process_count()} processes"
        )
    if config.physics.impl == "auto":
        return "warp" if gpu and warp else "jax"
    return config.physics.impl

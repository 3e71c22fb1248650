"""Checks that an engine has what a robot's file asks for: `check(robot, physics, impl)`.

NumPy and C MuJoCo. It imports MJX or MuJoCo Warp, which takes seconds, only for files that have more than
every engine can simulate (`PLAIN`).
"""

from __future__ import annotations

import contextlib
import io

import mujoco

from dynappo.config import ConfigError, files
from dynappo.description import contacts
from dynappo.description import robot as robot_lib
from dynappo.physics import ground as ground_lib
from dynappo.physics.warp import scope
from dynappo.terrain.height_map import HeightMap

ENGINES = {"jax": "MJX", "warp": "MuJoCo Warp", "c": "C MuJoCo"}
# What MJX 3.17 takes no notice of and does not refuse, although C MuJoCo and MuJoCo Warp do it.
UNSEEN = (
    "geom_adhesion pair_adhesion geom_surfacevel jnt_stiffnesspoly dof_dampingpoly tendon_stiffnesspoly "
    "tendon_dampingpoly"
).split()
# What is zero in a file that both of them have whole: hinges, primitives on a plane, motors.
PLAIN = (
    "neq ntendon npair nmocap nsensor nplugin nflex nhfield opt.disableflags opt.enableflags "
    "opt.noslip_iterations opt.density opt.viscosity opt.wind body_gravcomp "
    "geom_fluid"
).split() + UNSEEN
INTEGRATORS = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def check(robot: robot_lib.Robot, physics, impl: str, ground: HeightMap | None = None) -> None:
    """ConfigError if the engine `impl` lacks what the robot's file asks for, on a `ground`; `physics` is the
    config's group. What the kernel computes, every engine does."""
    name = _unlike_others(robot.mj_model)
    if impl == "c" and name:
        raise ConfigError(
            f"physics.impl is c, but {robot.xml} has the integrator {name}, with which C MuJoCo's motors are "
            "not those of the other engines; set physics.impl=jax, or take the integrator out of the file"
        )
    if ground is not None:
        ground_lib.check(ground)
    reason = lacks(robot, physics, impl, ground)
    if reason:
        raise ConfigError(
            f"{robot.xml}: {ENGINES[impl]} cannot simulate it ({reason}); take that out of the file, or set "
            f"physics.impl={'jax' if impl == 'warp' else 'c'}"
        )


def lacks(robot: robot_lib.Robot, physics, impl: str, ground: HeightMap | None = None) -> str:
    """What the engine `impl` cannot simulate of the robot's file; "" if nothing."""
    if impl == "c":
        name = _unlike_others(robot.mj_model)
        return name and f"the integrator {name}"
    model = ground_lib.model(robot, physics, None if ground is None else ground_lib.SOME)
    if ground is not None and impl == "jax" and _on_a_map(model):
        return _on_a_map(model)
    if _plain(model) or not scope.declines(model, robot.feet):
        return ""
    try:
        _check_warp(model) if impl == "warp" else _check_mjx(model)
    except NotImplementedError as error:
        return str(error)
    return ""


def _on_a_map(model: mujoco.MjModel) -> str:
    """What MJX has not on a height map: cylinders, which touch nothing else there."""
    touching = model.geom_type[model.geom_conaffinity > 0]
    return "cylinders on a height map" if (touching == contacts.CYLINDER).any() else ""


def coarse(robot: robot_lib.Robot) -> str:
    """A line on a robot whose contacts MJX simplifies; "" if it does not."""
    model = robot.mj_model
    touching = model.geom_conaffinity[robot.feet] > 0
    if not (touching & (model.geom_type[robot.feet] == contacts.BOX)).any():
        return ""
    return (
        f"{robot.xml}: a foot is a box, and MJX lets only its corners within 1 mm of the lowest touch the "
        "floor (C MuJoCo and MuJoCo Warp: all below it), so a policy of another engine may fall there; "
        "physics.impl=c is exact"
    )


def _plain(model: mujoco.MjModel) -> bool:
    def found(name):
        value = getattr(model.opt if name.startswith("opt.") else model, name.removeprefix("opt."))
        return value.any() if hasattr(value, "any") else value

    newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    return newton and model.opt.integrator in INTEGRATORS and not any(map(found, PLAIN))


def _unlike_others(model: mujoco.MjModel) -> str:
    """The name of an integrator with which C MuJoCo would treat the motors' damping implicitly."""
    integrator = mujoco.mjtIntegrator(model.opt.integrator)
    if integrator == mujoco.mjtIntegrator.mjINT_EULER:
        return ""
    return integrator.name.removeprefix("mjINT_").lower()


def _warp():
    """Warp, started; else it prints its version and devices later, and in C++ that there is no GPU."""
    import warp  # pyright: ignore[reportMissingImports]

    with contextlib.redirect_stdout(io.StringIO()), files.without_stderr():
        warp.init()
    return warp


def _check_warp(model: mujoco.MjModel) -> None:
    """NotImplementedError, in MuJoCo Warp's words, for a model that it cannot step."""
    warp = _warp()
    from mujoco.mjx.third_party import mujoco_warp

    with warp.ScopedDevice("cpu"):
        mujoco_warp.put_model(model)


def _check_mjx(model: mujoco.MjModel) -> None:
    """NotImplementedError for a model that MJX cannot step, or would simulate only in part."""
    unseen = [name for name in UNSEEN if getattr(model, name).any()]
    unseen += ["opt.noslip_iterations"] * bool(model.opt.noslip_iterations)
    discrete = model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    unseen += ["the integrator discrete"] * discrete  # it refuses in its step alone
    if unseen:
        raise NotImplementedError(", ".join(unseen))
    with contextlib.redirect_stdout(io.StringIO()):  # it prints two lines where warp-lang is absent
        from mujoco import mjx
    mjx.make_data(mjx.put_model(model, impl="jax"), impl="jax")

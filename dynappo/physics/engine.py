"""Simulates one control step: PD, motor limits, four physics steps, contacts by geometry.

Why kinematics are one physics step old: `mjx.step` computes geom positions from the coordinates it
starts from, so after it they are those of 5 ms before. Foot contacts (a foot's lowest point below the
floor) and the lowest points of parts come from these positions, at no cost; observations and rewards come
from the new qpos and qvel.

On ground that is not flat both are distances from its triangles (ground.py).

Why contact by geometry: it is the same for every engine and needs no contact forces, so the parts
that must not touch the ground need no collision pairs (`physics.contacts = feet`).

Why data are rebuilt from a template in every control step: the state is then small, a reset costs
no physics call, and a checkpoint does not depend on the engine. Why not in every physics step:
filling the 168 arrays of mjx.Data took 0.6 of 4.4 ms (experiments/03_speed). On a GPU a control step is
one call without mjx.Data (warp/call.py).
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.config import per_joint
from dynappo.description import contacts
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators, c_mujoco, engine_contract, randomize
from dynappo.physics import ground as ground_lib
from dynappo.physics.warp import arrays
from dynappo.physics.warp import call as warp_call
from dynappo.terrain.height_map import HeightMap
from dynappo.types import Hyper


class Engine(NamedTuple):
    """A robot in an engine; constants of the compiled program."""

    model: Any  # mjx.Model, or the fields of it that robots may differ in
    data: Any  # mjx.Data, a template; of "jax"
    # "jax": (model, data, ctrl) -> data, a physics step; else a control step of c_mujoco or warp
    step: Callable[..., Any]
    impl: str  # "jax", "warp" or "c"
    robot: robot_lib.Robot
    substeps: int
    timestep: float  # s
    soles: tuple[Any, ...]  # contacts.floor_distance of the feet's shapes
    floor: tuple[Any, ...]  # of the parts
    varied: frozenset[str]  # randomize.varied
    every_substep: (
        bool  # parts at the ground: in any physics step of a control step, or in its last
    )
    lags: bool  # torques follow with the time constant of the body's `lag`
    has_friction: bool  # joints have the friction task.joint_friction
    ground: HeightMap | None  # None: flat
    probes: tuple[
        Any, ...
    ]  # contacts.probes of the feet's shapes, and of the parts; none on flat ground


def make(
    robot: robot_lib.Robot,
    physics,
    varied: frozenset[str],
    impl: str,
    every_substep: bool = False,
    lags: bool = False,
    has_friction: bool = False,
    ground: HeightMap | None = None,
) -> Engine:
    """The engine `impl` ("jax", "warp" or "c") of `robot` on a `ground`, None being a plane; `physics` is the
    config's group."""
    engine_contract.check(robot, physics, impl, ground)
    mj_model, model, data = ground_lib.model(robot, physics, ground), None, None
    if impl == "c":
        step = c_mujoco.make(robot, physics, varied, has_friction, ground)
    elif impl == "warp":
        step = warp_call.make(mj_model, robot, physics.substeps, every_substep, ground)
        model = warp_call.model(mj_model)
    else:
        mjx, step = _mjx(), _mjx_step
        here = next(
            iter(jnp.zeros(()).devices())
        )  # MJX takes the first of all processes' otherwise
        data = mjx.make_data(mj_model, impl=impl, device=here)
        model = mjx.put_model(mj_model, impl=impl, device=here)
    return Engine(
        model=model,
        data=data,
        step=step,
        impl=impl,
        robot=robot,
        substeps=physics.substeps,
        timestep=physics.timestep,
        soles=contacts.floor_distance(mj_model, robot.feet),
        floor=contacts.floor_distance(mj_model, robot.parts),
        varied=varied,
        every_substep=every_substep,
        lags=lags,
        has_friction=has_friction,
        ground=ground,
        probes=() if ground is None else _probes(mj_model, robot),
    )


def _probes(model, robot: robot_lib.Robot):
    return contacts.probes(model, robot.feet, between=False), contacts.probes(model, robot.parts)


def _mjx():
    """MuJoCo MJX; other engines do not wait the seconds that its import takes."""
    with contextlib.redirect_stdout(io.StringIO()):  # it prints two lines where warp-lang is absent
        from mujoco import mjx
    return mjx


def _mjx_step(model, data, ctrl):
    return _mjx().step(model, data.replace(ctrl=ctrl))


class Simulated(Protocol):
    """What a control step reads of a task's state, whatever else the task keeps; A joints, F feet."""

    qpos: Any
    qvel: Any
    qacc_warmstart: Any
    torque: Any  # [A] N m; None unless it lags
    last_action: Any  # [A], and the one before, of motors that are late
    older_action: Any
    air_steps: Any  # [F] physics steps since the foot left the ground; 0 while it is down
    contact_steps: Any  # [F] since it came down; 0 while it is in the air
    last_air_steps: Any  # [F] length of the last finished air phase
    peak: Any  # [F] m, highest that its lowest point was in this air phase
    last_peak: Any  # [F] in the last finished one


class Substeps(NamedTuple):
    """What a control step carries from one physics step to the next."""

    qpos: Any
    qvel: Any
    qacc_warmstart: Any
    air_steps: Any
    contact_steps: Any
    last_air_steps: Any
    peak: Any
    last_peak: Any
    torque: Any  # of the motors in the last physics step
    qd_before: Any  # joint velocities before it
    # [G] m above the ground, lowest point of each part, in all physics steps (`every_substep`) or the last
    lowest: Any


class Motor(NamedTuple):
    """A robot's motors in a control step, its own numbers included: one, or one for each joint [A]."""

    kp: Any  # N m/rad
    kd: Any  # N m s/rad
    effort_limit: Any  # N m
    saturation_effort: Any  # N m
    velocity_limit: Any  # rad/s
    friction: Any  # N m, beside the motor; None: none


def simulate(engine: Engine, hyper: Hyper, body, state: Simulated, action) -> Substeps:
    """`substeps` physics steps under explicit PD towards the action's joint targets."""
    task = per_joint_arrays(hyper)
    default = jnp.asarray(engine.robot.default_pose, jnp.float32)
    target = actuators.target(_arriving(engine, body, state, action), default, task.action_scale)
    if body.encoder_bias is not None:  # the motors hold the angle that they read
        target = target - body.encoder_bias
    motor = Motor(
        kp=task.kp * body.kp_scale,
        kd=task.kd * body.kd_scale,
        effort_limit=task.effort_limit,
        saturation_effort=task.saturation_effort,
        velocity_limit=task.velocity_limit,
        friction=_friction(engine, task.joint_friction, body.joint_friction),
    )
    first = Substeps(
        qpos=state.qpos,
        qvel=state.qvel,
        qacc_warmstart=state.qacc_warmstart,
        air_steps=state.air_steps,
        contact_steps=state.contact_steps,
        last_air_steps=state.last_air_steps,
        peak=state.peak,
        last_peak=state.last_peak,
        torque=state.torque if engine.lags else default * 0,
        qd_before=default * 0,
        lowest=jnp.full(len(engine.robot.parts), jnp.inf),
    )
    with jax.default_matmul_precision("highest"):
        return SIMULATE[engine.impl](engine, body, first, target, motor)


def per_joint_arrays(hyper: Hyper):
    """The group `task` of `hyper` with arrays [A] where it has a number a joint."""
    task = hyper.task
    values = {name: getattr(task, name, None) for name in per_joint.names()}
    several = {name: jnp.stack(x) for name, x in values.items() if isinstance(x, tuple)}
    return task._replace(**several) if several else task


def _friction(engine: Engine, nominal, added):
    """Dry friction (N m) of one joint or of each; None where no joint has any."""
    if not engine.has_friction:
        return added
    return nominal if added is None else nominal + added


def _arriving(engine: Engine, body, state: Simulated, action):
    """The actions [n, A] that the motors follow, a row a physics step; they may be late."""
    steps = np.arange(engine.substeps)
    if body.delay is None:
        return jnp.broadcast_to(action, (engine.substeps, *action.shape))
    late = jnp.round(body.delay / engine.timestep).astype(jnp.int32) - steps
    age = jnp.clip((late + engine.substeps - 1) // engine.substeps, 0, 2)
    return jnp.stack([action, state.last_action, state.older_action])[age]


def _simulate_in_mjx(engine: Engine, body, first: Substeps, target, motor: Motor):
    robot = engine.robot
    model = randomize.merge(engine.model, body, robot.base_body, robot.feet, engine.varied)

    def lowest(distance, geoms, data):
        row = data.geom_xmat[geoms].reshape(-1, 9)[:, 6:]  # third row of the rotation matrix
        return contacts.lowest(distance, data.geom_xpos[geoms, 2], row)

    parts = partial(lowest, engine.floor, robot.parts)
    feet = partial(lowest, engine.soles, robot.feet)
    if engine.ground is not None:
        above = ground_lib.feet_above, ground_lib.parts_above
        feet, parts = (
            partial(_above, *on, engine.ground, geoms)
            for *on, geoms in zip(above, engine.probes, (robot.feet, robot.parts), strict=True)
        )

    def substep(carry, target):
        s, data = carry
        torque = actuators.clip_dc_motor(
            actuators.pd(target, data.qpos[7:], data.qvel[6:], motor.kp, motor.kd),
            data.qvel[6:],
            effort_limit=motor.effort_limit,
            saturation_effort=motor.saturation_effort,
            velocity_limit=motor.velocity_limit,
        )
        if body.strength is not None:
            torque *= body.strength
        if engine.lags:
            torque = actuators.lag(torque, s.torque, body.lag, engine.timestep)
        before, felt = data.qvel[6:], torque
        if motor.friction is not None:
            felt -= actuators.friction(before, motor.friction)
        data = engine.step(model, data, felt)
        s = _feet(engine, s, feet(data))
        s = s._replace(
            torque=torque,
            qd_before=before,
            lowest=jnp.minimum(s.lowest, parts(data)) if engine.every_substep else s.lowest,
        )
        return (s, data), None

    data = engine.data.replace(
        qpos=first.qpos, qvel=first.qvel, qacc_warmstart=first.qacc_warmstart
    )
    (s, data), _ = jax.lax.scan(substep, (first, data), target)
    s = s._replace(qpos=data.qpos, qvel=data.qvel, qacc_warmstart=data.qacc_warmstart)
    return s if engine.every_substep else s._replace(lowest=parts(data))


def _above(found, probes, ground: HeightMap, geoms, data):
    return found(probes, ground, data.geom_xpos[geoms], data.geom_xmat[geoms])


def _simulate_in_warp(engine: Engine, body, first: Substeps, target, motor: Motor):
    robot = engine.robot
    model = randomize.merge(engine.model, body, robot.base_body, robot.feet, engine.varied)
    given = dict(
        kp=motor.kp,
        kd=motor.kd,
        effort=motor.effort_limit,
        saturation=motor.saturation_effort,
        speed=motor.velocity_limit,
        strength=1.0 if body.strength is None else body.strength,
        friction=0.0 if motor.friction is None else motor.friction,
        share=actuators.share(jnp, body.lag, engine.timestep) if engine.lags else 1.0,
    )
    numbers = [jnp.atleast_1d(jnp.asarray(given[n], jnp.float32)) for n in arrays.MOTOR]
    numbers = jnp.stack(jnp.broadcast_arrays(*numbers), -1)  # [1 or A, 8]
    return first._replace(**engine.step(model, first, target, numbers))


def _simulate_in_c(engine: Engine, body, first: Substeps, target, motor: Motor):
    strength = 1.0 if body.strength is None else body.strength
    armature = 1.0 if body.armature is None else body.armature
    own = [body.mass_scale, *body.base_com, body.friction, armature]
    motors = [
        motor.kp * strength,
        motor.kd * strength,
        motor.effort_limit * strength,
        motor.saturation_effort * strength,
        motor.velocity_limit,
        0.0 if motor.friction is None else motor.friction,
    ]
    motors = jnp.stack(jnp.broadcast_arrays(*motors)).ravel()  # of each number 1 or A
    moved = engine.step(
        first.qpos,
        first.qvel,
        first.qacc_warmstart,
        target,
        jnp.concatenate([jnp.stack(jnp.broadcast_arrays(*own)), motors]),
    )
    w, x, y, z = jnp.moveaxis(moved.quat, -1, 0)
    row = jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)
    split = row.shape[1] - len(engine.robot.parts)
    seen, s = slice(None) if engine.every_substep else slice(-1, None), first
    if engine.ground is None:
        soles, row = jnp.split(row, [split], axis=1)
        for shapes in contacts.lowest(engine.soles, moved.feet, soles):
            s = _feet(engine, s, shapes)
        lowest = contacts.lowest(engine.floor, moved.parts[seen], row[seen]).min(0)
    else:
        one = jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1)
        two = jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1)
        feet, parts = jnp.split(jnp.stack([one, two, row], -2), [split], axis=1)
        of_feet, of_parts = engine.probes
        for shapes in ground_lib.feet_above(of_feet, engine.ground, moved.feet, feet):
            s = _feet(engine, s, shapes)
        heights = ground_lib.parts_above(of_parts, engine.ground, moved.parts[seen], parts[seen])
        lowest = heights.min(0)
    told = "qpos", "qvel", "qacc_warmstart", "torque", "qd_before"
    return s._replace(lowest=lowest, **{name: getattr(moved, name) for name in told})


SIMULATE = {"jax": _simulate_in_mjx, "warp": _simulate_in_warp, "c": _simulate_in_c}


def _feet(engine: Engine, s: Substeps, lowest) -> Substeps:
    """The feet's timers and heights after one more physics step, which began with the lowest points of
    their shapes at the heights `lowest` [S] above the ground."""
    of = contacts.of_each_foot(engine.robot.foot_of)
    height = lowest if of.shape[1] == 1 else lowest[of].min(-1)
    contact = height < 0
    landed = contact & (s.air_steps > 0)
    return s._replace(
        air_steps=jnp.where(contact, 0, s.air_steps + 1),
        contact_steps=jnp.where(contact, s.contact_steps + 1, 0),
        last_air_steps=jnp.where(landed, s.air_steps + 1, s.last_air_steps),
        peak=jnp.where(contact, 0.0, jnp.maximum(s.peak, height)),
        last_peak=jnp.where(landed, s.peak, s.last_peak),
    )

"""Ways to write `physics.simulate`, to compare: each takes what physics.simulate takes.

carry:    built once a control step, carried from one physics step to the next.
rows:     carried from row to row (`Rows` is then the state of the loop).
direct:   MuJoCo Warp called with the few arrays that change, all others stay Warp's own.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from dynappo import actuators, physics, randomize
from dynappo.physics import Substeps

mjx = physics.mjx


def simulate(how, engine, hyper, body, state, action, data=None, advance=None):
    model = randomize.merge(
        engine.model, body, engine.robot.base_body, engine.robot.feet, engine.varied
    )
    default = jnp.asarray(engine.robot.default_pose, jnp.float32)
    q_target = actuators.target(action, default, hyper.action_scale)
    kp, kd = hyper.kp * body.kp_scale, hyper.kd * body.kd_scale
    fixed, linear, ring = engine.floor
    ids, feet = engine.robot.parts, engine.robot.feet

    def ground(data):
        row = data.geom_xmat[ids].reshape(-1, 9)[:, 6:]
        drop = fixed + (linear * jnp.abs(row)).sum(-1)
        drop += ring * jnp.sqrt(jnp.maximum(1 - row[:, 2] ** 2, 0))
        return data.geom_xpos[ids, 2] - drop

    def substep(carry, _):
        s, data = carry
        torque = actuators.clip_dc_motor(
            actuators.pd(q_target, s.qpos[7:], s.qvel[6:], kp, kd),
            s.qvel[6:],
            effort_limit=hyper.effort_limit,
            saturation_effort=hyper.saturation_effort,
            velocity_limit=hyper.velocity_limit,
        )
        before = s.qvel[6:]
        if how == "direct":
            data = advance(model, s.qpos, s.qvel, s.qacc_warmstart, torque)
        else:
            data = data.replace(
                qpos=s.qpos, qvel=s.qvel, qacc_warmstart=s.qacc_warmstart, ctrl=torque
            )
            data = mjx.step(model, data)
        contact = data.geom_xpos[feet, 2] < engine.robot.foot_radius
        landed = contact & (s.air_steps > 0)
        return (
            Substeps(
                qpos=data.qpos,
                qvel=data.qvel,
                qacc_warmstart=data.qacc_warmstart,
                air_steps=jnp.where(contact, 0, s.air_steps + 1),
                contact_steps=jnp.where(contact, s.contact_steps + 1, 0),
                last_air_steps=jnp.where(landed, s.air_steps + 1, s.last_air_steps),
                torque=torque,
                qd_before=before,
                lowest=jnp.minimum(s.lowest, ground(data)) if engine.remember else s.lowest,
            ),
            data,
        ), None

    first = Substeps(
        qpos=state.qpos,
        qvel=state.qvel,
        qacc_warmstart=state.qacc_warmstart,
        air_steps=state.air_steps,
        contact_steps=state.contact_steps,
        last_air_steps=state.last_air_steps,
        torque=default * 0,
        qd_before=default * 0,
        lowest=jnp.full(len(ids), jnp.inf),
    )
    if how == "direct":
        geoms = engine.model.ngeom
        data = Few(
            first.qpos,
            first.qvel,
            first.qacc_warmstart,
            jnp.zeros((geoms, 3)),
            jnp.zeros((geoms, 3, 3)),
        )
    elif data is None:
        data = engine.data
    with jax.default_matmul_precision("highest"):
        (out, data), _ = jax.lax.scan(substep, (first, data), None, length=engine.substeps)
    if not engine.remember:
        out = out._replace(lowest=ground(data))
    return out, data


@struct.dataclass
class Few:
    qpos: Any
    qvel: Any
    qacc_warmstart: Any
    geom_xpos: Any
    geom_xmat: Any


@struct.dataclass
class Rows:
    env: Any
    data: Any
    obs: Any


def worlds(engine, count):
    """Data of `count` robots; contact buffers have no axis of robots."""
    return jax.vmap(lambda _: engine.data)(jnp.arange(count))


def direct(mj_model, per_world, conditional=True, mode=None):
    """`advance(model, qpos, qvel, warm, ctrl) -> Few`: a call of MuJoCo Warp with few arrays."""
    import warp as wp
    from mujoco.mjx.third_party import mujoco_warp as mjw

    contacts, rows = per_world
    made: dict = {}

    def prepare(nworld):
        for device in {str(d): d for d in wp.get_devices()}.values():
            if wp.is_cuda_available() and not device.is_cuda:
                continue
            if (str(device), nworld) not in made:
                with wp.ScopedDevice(device):
                    m = mjw.put_model(mj_model)
                    m.opt.warn_overflow = 0
                    m.opt.graph_conditional = conditional
                    d = mjw.make_data(
                        mj_model, nworld=nworld, naconmax=nworld * contacts, njmax=rows
                    )
                made[str(device), nworld] = m, d

    def call(
        qpos: wp.array(dtype=float, ndim=2),
        qvel: wp.array(dtype=float, ndim=2),
        qacc_warmstart: wp.array(dtype=float, ndim=2),
        ctrl: wp.array(dtype=float, ndim=2),
        body_mass: wp.array(dtype=float, ndim=2),
        body_inertia: wp.array(dtype=wp.vec3, ndim=2),
        geom_xpos: wp.array(dtype=wp.vec3, ndim=2),  # output: Warp writes moving geoms only,
        geom_xmat: wp.array(dtype=wp.mat33, ndim=2),  # so its own arrays are copied
    ):
        m, d = made[str(wp.get_device()), qpos.shape[0]]
        m = dataclasses.replace(m, body_mass=body_mass, body_inertia=body_inertia)
        d = dataclasses.replace(
            d,
            qpos=qpos,
            qvel=qvel,
            qacc_warmstart=qacc_warmstart,
            ctrl=ctrl,
        )
        mjw.step(m, d)
        wp.copy(geom_xpos, d.geom_xpos)
        wp.copy(geom_xmat, d.geom_xmat)

    if mode is None:
        mode = "WARP" if wp.is_cuda_available() else "JAX"
    ffi = wp.jax_callable(
        call,
        num_outputs=5,
        graph_mode=getattr(wp.JaxCallableGraphMode, mode),
        in_out_argnames=["qpos", "qvel", "qacc_warmstart"],
        vmap_method=None,
    )

    def batch(mass, inertia, qpos, qvel, warm, ctrl):
        count = qpos.shape[0]
        prepare(count)
        dims = dict(geom_xpos=(count, mj_model.ngeom), geom_xmat=(count, mj_model.ngeom))
        return ffi(qpos, qvel, warm, ctrl, mass, inertia, output_dims=dims)

    @jax.custom_batching.custom_vmap
    def advance(*args):
        return [x[0] for x in batch(*(x[None] for x in args))]

    @advance.def_vmap
    def rule(count, batched, *args):
        args = [x if b else x[None] for x, b in zip(args, batched, strict=True)]
        args[2:] = [jnp.broadcast_to(x, (count, *x.shape[1:])) for x in args[2:]]
        return batch(*args), [True] * 5

    def few(model, qpos, qvel, warm, ctrl):
        return Few(*advance(model.body_mass, model.body_inertia, qpos, qvel, warm, ctrl))

    few.made = made
    return few

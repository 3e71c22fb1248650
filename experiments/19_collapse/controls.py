"""Controls of the paper's claims: what an implementation might do otherwise, and may collapse by.

`control=NAME` in a job of 21_less/run.py puts them in; 21_less/controls.py lists them with the others.

- `cold`: each fit begins with new weights; the running moments stay
- `unmasked`: the model learns across resets. The next observation of a row is what the buffer has in the
  row after it, of a new episode where the robot fell
- `bootstrap-real`: the value behind a rollout's last row is that of the last *observation of physics*, which
  is what the simulator's own `obs` is then, and not that of where the tail ended
- `unanchored`: the next iteration goes on where the model left the robots. After an iteration all take
  N_s steps in the model, and physics begins in the states that these reach. So an error of the model stays,
  and the next one comes on top: the opposite of the paper's anchoring. Flat ground, without a motor's lag
"""

from functools import partial

import jax
import jax.numpy as jnp

from dynappo import algorithm, fast, rollout
from dynappo.description import kinematics
from dynappo.learner import networks, symmetry
from dynappo.model import dynamics, examples
from dynappo.tasks.velocity import observe, view

COLD, ONWARD = 6, 77  # folded into keys of the fit, and of an iteration (algorithm.py has less)

_examples, _estimate, _iterate, _fit = (
    examples.examples,
    algorithm.estimate,
    algorithm.iterate,
    fast.fit,
)


def cold(static, hyper, model, rows, epochs, key, *, mirrors=None, **given):
    """`fast.fit` from new weights."""
    props, inputs = rows.y.shape[-1] - 1 - static.model.falls, rows.x.shape[-1]
    params = networks.init(dynamics.network(static, props), inputs, jax.random.fold_in(key, COLD))
    params = symmetry.tie(params, dynamics.image(mirrors))
    model = model.replace(params=params, opt_state=dynamics.optimizer().init(params))
    return _fit(static, hyper, model, rows, epochs, key, mirrors=mirrors, **given)


def unmasked(static, hyper, env, rows, n_real):
    """`examples.examples` of rows in which no episode ends. The last real row keeps its own `next_obs`."""
    follows = (jnp.arange(len(rows.reward)) + 1 < n_real)[:, None, None]
    after = lambda x, own: jnp.where(follows, jnp.roll(x, -1, axis=0), own)  # noqa: E731
    rows = rows.replace(
        next_obs=after(rows.obs, rows.next_obs),
        next_prop=after(rows.prop, rows.next_prop),
        discount=jnp.ones_like(rows.discount),
        truncation=jnp.zeros_like(rows.truncation),
    )
    return _examples(static, hyper, env, rows=rows, n_real=n_real)


def bootstrap_real(static, hyper, env, *, rows, real, **given):
    """`algorithm.estimate`, whose last value is that of the last real row's `next_obs`."""
    last = real.sum() - 1
    behind = {
        name: getattr(rows, name).at[-1].set(getattr(rows, name)[last])
        for name in ("next_obs", "next_prop")
    }
    return _estimate(static, hyper, env, rows=rows.replace(**behind), real=real, **given)


def unanchored(env, hyper, state, counts, *, static):
    """`algorithm.iterate`, and the robots are where N_s steps of the model take them then."""
    state, metrics = _iterate(env, hyper, state, counts, static=static)
    if state.model is None:
        return state, metrics
    horizon, robots = static.rollout.horizon, state.env_state
    key = jax.random.fold_in(jax.random.fold_in(state.key, counts["iteration"]), ONWARD)
    rows, end, _ = fast.fill(
        rollout.allocate(env, horizon, static.rollout.num_envs),
        begin=counts["n_real"],
        end=jnp.int32(horizon),
        state=dynamics.tail(static, env, robots),
        keys=rollout.row_keys(key, state.robot_index),
        act=algorithm.policy(static, env, state.learner.params),
        step=fast.step(static, hyper, env, state.model),
    )
    there = jax.vmap(partial(arrived, env, hyper))(
        state.params_physics, robots, end.obs, end.prop, rows.action[-1], rows.action[-2]
    )
    moved = counts["n_real"] < horizon
    robots = jax.tree.map(lambda new, old: jnp.where(moved, new, old), there, robots)
    return state.replace(env_state=robots), metrics


def arrived(env, hyper, body, state, obs, prop, action, older):
    """A robot's physics state in which it senses `obs`, and `prop` is so: of `state` it keeps its place and
    heading, how high its lowest foot is, and its timers. The actions are the last and the one before."""
    (const,) = env.step.args  # velocity/env.py
    parts = view.split(const.view, obs.at[: prop.size].set(prop))
    quat = turned(parts["gravity"], observe.heading(state.qpos[3:7]))
    joints = jnp.asarray(const.robot.default_pose, jnp.float32) + parts["joint_position"]
    lower = lowest(const, quat, joints) - lowest(const, state.qpos[3:7], state.qpos[7:])
    angular = parts["angular_velocity"]
    linear = rotate(quat, parts["linear_velocity"] - jnp.cross(angular, body.base_com))
    height = state.qpos[2] - lower
    there = state.replace(
        qpos=jnp.concatenate([state.qpos[:2], height[None], quat, joints]),
        qvel=jnp.concatenate([linear, angular, parts["joint_velocity"]]),
        last_action=action,
        older_action=older,
        obs=obs,
    )
    exact = view.exact(const.view, const.robot, hyper, body, there)
    return there.replace(prop=exact[: prop.size])


def lowest(const, quat, joints):
    """How high (m) the lowest foot is above the base's origin."""
    points = kinematics.feet_in_base(const.legs, joints)
    heights = jax.vmap(lambda point: rotate(quat, point)[2])(points)
    return (heights - jnp.asarray(const.legs.radius, joints.dtype)).min()


def turned(gravity, yaw):
    """The quaternion Rz(yaw) Ry Rx of a base that senses this direction of gravity, and has that heading."""
    up = -gravity / jnp.linalg.norm(gravity)
    roll, pitch = jnp.arctan2(up[1], up[2]), jnp.arcsin(jnp.clip(-up[0], -1.0, 1.0))
    (cr, sr), (cp, sp), (cy, sy) = ((jnp.cos(x / 2), jnp.sin(x / 2)) for x in (roll, pitch, yaw))
    return jnp.stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def rotate(quat, vector):
    """A vector of the base's frame in the world's."""
    return observe.rotate_inverse(quat * jnp.array([1.0, -1.0, -1.0, -1.0]), vector)


CONTROLS = {
    "cold": [(fast, "fit", cold)],
    "unmasked": [(examples, "examples", unmasked)],
    "bootstrap-real": [(algorithm, "estimate", bootstrap_real)],
    "unanchored": [(algorithm, "iterate", unanchored)],
}

"""Controls of the paper's claims: what an implementation might do otherwise, and may collapse by.

`control=NAME` in a job of 21_less/run.py puts them in; 21_less/controls.py lists them with the others.

- `cold`: each fit begins with new weights; the running moments stay
- `unmasked`: the model learns across resets. The next observation of a row is what the buffer has in the
  row after it, of a new episode where the robot fell
- `bootstrap-real`: the value behind a rollout's last row is that of what the *simulator* observes then, the
  state in which the tail began, and not that of where it ended
- `unanchored`: the next iteration goes on where the model leaves the robots. After an iteration all take N_s
  steps more in the model, by the updated policy, and physics begins in the states that these reach. Robots
  for which these are not finite stay where they are. Flat ground, without a motor's lag
- `rebuilt`: the same without a model: physics begins in states that are made from what the robots are. What
  `unanchored` does beyond this is the model's
- `burn4`, `burn16`, `burn64`: a tail begins so many steps of the model behind the real state, in which it has
  errors by then. The robots stay physics'; the last real row is bootstrapped by the value of its `next_obs`
- `cut`: a tail begins in the real state, as shipped; that last row is bootstrapped so all the same
- `branch`: the same, and a tail begins in a real row of this rollout, drawn at random for each robot: what
  off-policy methods do, and the paper says does not suit PPO. What it does beyond `cut` is the branching's
"""

from functools import partial

import jax
import jax.numpy as jnp

from dynappo import algorithm, fast, rollout
from dynappo.description import kinematics
from dynappo.learner import networks, symmetry
from dynappo.model import dynamics, examples
from dynappo.tasks.velocity import observe, view

# folded into keys of the fit and of an iteration: larger than all else that is folded there
COLD, ONWARD, BRANCH = 1 << 30, 1 << 29, 1 << 28
BURNS = 4, 16, 64

_examples, _fit = examples.examples, fast.fit
_estimate, _imagine, _iterate = algorithm.estimate, algorithm.imagine, algorithm.iterate


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
    """`algorithm.estimate`, whose last value is that of the state behind the last real row: of a new episode
    where that row ended one. (Of the first round: in later ones tails begin elsewhere.)"""
    n_real, n = real.sum(), len(rows.reward)
    behind = {}
    for name in ("obs", "prop"):
        began, ended = getattr(rows, name), getattr(rows, f"next_{name}")
        now = jnp.where(n_real < n, began[jnp.minimum(n_real, n - 1)], ended[-1])
        behind[f"next_{name}"] = ended.at[-1].set(now)
    return _estimate(static, hyper, env, rows=rows.replace(**behind), real=real, **given)


def unanchored(env, hyper, state, counts, *, static):
    """`algorithm.iterate`, and the robots are where N_s steps of the model take them then."""
    state, metrics = _iterate(env, hyper, state, counts, static=static)
    if state.model is None:
        return state, metrics
    horizon, robots = static.rollout.horizon, state.env_state
    start = dynamics.tail(static, env, robots)
    key = jax.random.fold_in(state.key, counts["iteration"])
    rows, end = model_rows(
        static, hyper, env, state, start=start, begin=counts["n_real"], end=horizon, key=key
    )
    older = jnp.where(counts["n_real"] < horizon - 1, rows.action[-2], robots.last_action)
    there = jax.vmap(partial(arrived, env, hyper))(
        state.params_physics, robots, end.obs, end.prop, rows.action[-1], older
    )
    moved = (counts["n_real"] < horizon) & finite(there)
    return state.replace(env_state=choose(moved, there, robots)), metrics


def rebuilt(env, hyper, state, counts, *, static):
    """`algorithm.iterate`, and the robots are made anew where they are, in iterations with a tail."""
    state, metrics = _iterate(env, hyper, state, counts, static=static)
    robots = state.env_state
    there = jax.vmap(partial(arrived, env, hyper))(
        state.params_physics,
        robots,
        robots.obs,
        robots.prop,
        robots.last_action,
        robots.older_action,
    )
    moved = (counts["n_real"] < static.rollout.horizon) & finite(there)
    return state.replace(env_state=choose(moved, there, robots)), metrics


def model_rows(static, hyper, env, state, *, start, begin, end: int, key):
    """`(rows, where they end)`: the model's rows `begin <= t < end`, from each robot's `start`."""
    rows, after, _ = fast.fill(
        rollout.allocate(env, end, static.rollout.num_envs),
        begin=jnp.int32(begin),
        end=jnp.int32(end),
        state=start,
        keys=rollout.row_keys(jax.random.fold_in(key, ONWARD), state.robot_index),
        act=algorithm.policy(static, env, state.learner.params),
        step=fast.step(static, hyper, env, state.model),
    )
    return rows, after


def finite(robots):
    """[R]: whether all numbers of a robot are."""
    each = [jnp.isfinite(x).reshape(len(x), -1).all(-1) for x in jax.tree.leaves(robots)]
    return jnp.stack(each).all(0)


def choose(which, one, other):
    """`one` of the robots in `which` [R], `other` of the rest."""

    def pick(a, b):
        return jnp.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return jax.tree.map(pick, one, other)


def burnt(count, env, hyper, state, rows, n_real, start, key, *, static):
    """`algorithm.imagine`, from where `count` steps of the model take each `start`."""
    _, start = model_rows(static, hyper, env, state, start=start, begin=0, end=count, key=key)
    given = dict(rows=rows, n_real=n_real, start=start, key=key, static=static)
    return _imagine(env, hyper, state, **given)


def branched(env, hyper, state, rows, n_real, start, key, *, static):
    """`algorithm.imagine`, from a real row of `rows` drawn at random for each robot."""
    del start
    drawn = jax.random.fold_in(key, BRANCH)
    start = dynamics.anchors(static, env, rows, n_real=n_real, key=drawn)
    given = dict(rows=rows, n_real=n_real, start=start, key=key, static=static)
    return _imagine(env, hyper, state, **given)


def cut_behind_real(static, hyper, env, *, rows, real, **given):
    """`algorithm.estimate`, where no advantage comes from a tail to a real row."""
    last = real & ~jnp.roll(real, -1, axis=0).at[-1].set(False)
    cut = jnp.where(last & (rows.discount > 0), 1.0, rows.truncation)
    return _estimate(static, hyper, env, rows=rows.replace(truncation=cut), real=real, **given)


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
    "rebuilt": [(algorithm, "iterate", rebuilt)],
    "cut": [(algorithm, "estimate", cut_behind_real)],
    "branch": [(algorithm, "imagine", branched), (algorithm, "estimate", cut_behind_real)],
    **{
        f"burn{count}": [
            (algorithm, "imagine", partial(burnt, count)),
            (algorithm, "estimate", cut_behind_real),
        ]
        for count in BURNS
    },
}

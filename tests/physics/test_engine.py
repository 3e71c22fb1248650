"""A control step of the engine against C MuJoCo: what touches the floor in a pose, and motion.

In a pose, `engine.simulate` runs with `mjx.step` replaced by MJX's kinematics: then it moves nothing,
and tells the lowest point of each part and which feet are down in the pose it was given, in the single
precision of training. MuJoCo gets the same numbers and the model in which every part collides.
"""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from dynappo import config
from dynappo.description import robot
from dynappo.physics import engine as engine_lib
from dynappo.physics import randomize
from dynappo.tasks.velocity import env as env_lib

POSES = 3_000
NEAR = 0.02  # m from the floor
ROUNDING = 2e-6  # m, of single precision at the end of a leg; measured 6e-7
WORLDS, STEPS = 8, 100
QUADRUPEDS = "anymal_c", "anymal_d", "go1", "go2"


LATER = "go2", "anymal_c", "anymal_d"  # with `-m slow`: geoms are of the same few shapes


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name in LATER)) for name in QUADRUPEDS],
)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def loaded(name):
    return robot.load(name)


# --- what touches the floor ---


def shipped(loaded, settings):
    """`read(qpos [N, 19]) -> (lowest [N, G], down [N, F])` by `engine_lib.simulate`."""
    engine = engine_lib.make(loaded, settings.physics, frozenset(), "jax")
    hyper = config.split(settings)[1]
    body = randomize.Body(1.0, jnp.zeros(3), 0.8, 1.0, 1.0)
    timers = ("air_steps", "contact_steps", "last_air_steps")
    peaks = dict.fromkeys(("peak", "last_peak"), jnp.zeros(4))

    def read_one(qpos):
        rest = dict.fromkeys(("qvel", "qacc_warmstart"), jnp.zeros(18))
        rest |= dict.fromkeys(timers, jnp.zeros(4, jnp.int32))
        state: Any = SimpleNamespace(qpos=qpos, **rest, **peaks)
        after = engine_lib.simulate(engine, hyper, body, state, jnp.zeros(12))
        return after.lowest, after.contact_steps > 0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mjx, "step", mjx.kinematics)
        shape = jax.ShapeDtypeStruct((POSES, 19), jnp.float32)
        compiled = jax.jit(jax.vmap(read_one)).lower(shape).compile()

    def read(qpos):
        # all at once: a fusion of jaxlib 0.10.2 was wrong in large batches only (dynappo/__init__.py)
        return [np.asarray(found) for found in compiled(qpos)]

    return read


def collisions(model, loaded, poses):
    """By C MuJoCo: `(dist [N, G + F], height [N, F])`, the smallest `dist` of each geom's contacts
    with the floor (inf: none) and the lowest points of the feet."""
    data, geoms = mujoco.MjData(model), [*loaded.parts, *loaded.feet]
    column = np.full(model.ngeom, -1)
    column[geoms] = np.arange(len(geoms))
    dist, height = np.full((POSES, len(geoms)), np.inf), np.empty((POSES, 4))
    for i, pose in enumerate(poses):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        assert (pairs[:, 0] == model.geom("floor").id).all()
        np.minimum.at(dist[i], column[pairs[:, 1]], data.contact.dist)
        height[i] = data.geom_xpos[loaded.feet, 2] - model.geom_size[loaded.feet, 0]
    return dist, height


@pytest.fixture(scope="module")
def seen(loaded, name):
    """How both see `POSES` poses with the lowest part at the floor, and as many with `any` one there.

    Any attitude and any joint angles in their ranges; "at the floor" is within 2 cm of it, and
    `any` is a part or foot drawn anew for each pose.
    """
    settings = config.load(f"{name}.py")
    settings.physics.contacts = "full"
    model = robot.physics_model(loaded, settings.physics)
    assert not model.geom_margin.any()  # contacts are those with dist <= 0
    read, rng = shipped(loaded, settings), np.random.default_rng(0)

    def look(poses):
        (lowest, down), (dist, height) = read(poses), collisions(model, loaded, poses)
        touch = np.concatenate([lowest < 0, down], axis=-1)
        return SimpleNamespace(touch=touch, lowest=np.hstack([lowest, height]), dist=dist)

    def draw(choose):
        quat = rng.normal(size=(POSES, 4))
        poses = np.zeros((POSES, 19), np.float32)
        poses[:, 3:7] = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
        poses[:, 7:] = rng.uniform(*model.jnt_range[1:].T, size=(POSES, 12))
        poses[:, 2] = rng.uniform(-NEAR, NEAR, POSES) - choose(look(poses).lowest)
        return look(poses)

    parts = len(loaded.parts)
    return SimpleNamespace(
        parts=parts,
        geoms=np.array([model.geom(i).name for i in (*loaded.parts, *loaded.feet)]),
        lowest=draw(lambda x: x[:, :parts].min(axis=-1)),
        any=draw(lambda x: x[np.arange(POSES), rng.integers(x.shape[1], size=POSES)]),
    )


def test_every_part_and_foot_is_at_the_floor_in_many_poses(seen):
    """So that the tests below are about it."""
    falls = seen.lowest.touch[:, : seen.parts].any(axis=-1)
    assert 0.45 < falls.mean() < 0.55
    near = (np.abs(seen.any.lowest) < NEAR).sum(axis=0)
    below = ((-NEAR < seen.any.lowest) & seen.any.touch).sum(axis=0)
    few = POSES // 50
    assert (near > 2.5 * few).all() and (below > few).all() and (near - below > few).all()


@pytest.mark.parametrize("kind", ["lowest", "any"])
def test_geometry_and_collision_detection_agree_on_what_touches_the_floor(seen, kind):
    """A pose agrees if each of its parts and feet does. Measured: all poses of all robots; what a
    machine of other rounding may leave is to the micrometre at the floor."""
    view = getattr(seen, kind)
    wrong = view.touch != (view.dist < 0)
    rows, columns = np.nonzero(wrong)
    worst = np.argsort(-np.abs(view.lowest[wrong]))[:5]
    places = zip(columns[worst], view.lowest[wrong][worst], view.dist[wrong][worst], strict=True)
    text = f"{len(set(rows))} of {POSES} poses disagree; geom, lowest point (m), contact (m): "
    text += ", ".join(f"{seen.geoms[i]} {low:.1e} {dist:.1e}" for i, low, dist in places)
    assert len(set(rows)) <= 0.001 * POSES, text
    assert (np.abs(view.lowest[wrong]) < ROUNDING).all(), text


@pytest.mark.parametrize("kind", ["lowest", "any"])
def test_the_lowest_point_is_as_deep_as_the_deepest_contact(seen, kind):
    view = getattr(seen, kind)
    both = view.touch & (view.dist < 0)
    assert both.sum() > POSES / 2
    error = np.where(both, np.abs(view.lowest - np.where(both, view.dist, 0)), 0)
    geom = seen.geoms[error.max(axis=0).argmax()]
    assert error.max() < ROUNDING, f"{geom}: {error.max():.1e} m"


# --- in motion: MJX against C MuJoCo, and random actions; slow, because tests/tasks/test_env.py follows a
# Go1 on MJX with C MuJoCo, and test_c_mujoco.py compares all engines ---


class InC:
    """One robot in C MuJoCo; PD control and the limits of its motors written out in NumPy."""

    def __init__(self, loaded, settings, body, **solver):
        self.task, self.default = settings.task, loaded.default_pose
        self.substeps, base = settings.physics.substeps, loaded.base_body
        self.model = robot.physics_model(loaded, settings.physics)
        for field, value in solver.items():
            setattr(self.model.opt, field, value)
        self.model.body_mass[base] *= float(body.mass_scale)
        self.model.body_inertia[base] *= float(body.mass_scale)
        self.model.body_ipos[base] = body.base_com
        self.model.geom_friction[loaded.feet, 0] = body.friction
        self.kp, self.kd = self.task.kp * float(body.kp_scale), self.task.kd * float(body.kd_scale)
        self.data = mujoco.MjData(self.model)

    def put(self, qpos, qvel, warm):
        self.data.qpos[:], self.data.qvel[:], self.data.qacc_warmstart[:] = qpos, qvel, warm

    def step(self, action):
        data, t = self.data, self.task
        target = self.default + t.action_scale * action.astype(float)
        for _ in range(self.substeps):
            speed = data.qvel[6:] / t.velocity_limit
            most = np.minimum(t.saturation_effort * (1 - speed), t.effort_limit)
            least = np.maximum(-t.saturation_effort * (1 + speed), -t.effort_limit)
            torque = self.kp * (target - data.qpos[7:]) - self.kd * data.qvel[6:]
            data.ctrl[:] = np.minimum(np.maximum(torque, least), most)
            mujoco.mj_step(self.model, data)

    def errors(self, qpos, qvel, _):
        return np.abs(self.data.qpos - qpos).max(), np.abs(self.data.qvel - qvel).max()


@pytest.fixture(scope="module")
def world(loaded, name):
    """`WORLDS` robots of the shipped task, drawn from its ranges, in one program for all tests.

    `run(state, actions [STEPS, WORLDS, 12], seed) -> (state, before, after, outcome)`: for each
    control step the coordinates before and after it (before a reset), and the outcome.
    `in_c(**solver)`: the same robots in C MuJoCo.
    """
    settings = config.validate(config.load(f"{name}.py"))
    env = env_lib.make(loaded, settings.task, settings.physics, impl="jax")
    hyper = config.split(settings)[1]

    @jax.jit
    def begin(keys):
        body = jax.vmap(env.randomize, (None, 0))(hyper, keys)
        return body, jax.vmap(env.reset, (None, 0, 0))(hyper, body, keys)

    def step(body, state, action, keys):
        after, outcome = env.step(hyper, body, state, action, keys[0])
        moved = [(s.qpos, s.qvel, s.qacc_warmstart) for s in (state, after)]
        return env.autoreset(hyper, body, after, outcome, keys[1]), (*moved, outcome)

    @jax.jit
    def scan(state, actions, keys):
        return jax.lax.scan(lambda s, x: jax.vmap(step)(body, s, *x), state, (actions, keys))

    def run(state, actions, seed):
        keys = jax.random.split(jax.random.key(seed), (STEPS, WORLDS, 2))
        end, trace = scan(state, actions, keys)
        return end, *jax.device_get(trace)

    def in_c(**solver):
        leaves, tree = jax.tree.flatten(jax.device_get(body))
        rows = [tree.unflatten(row) for row in zip(*leaves, strict=True)]
        return [InC(loaded, settings, row, **solver) for row in rows]

    body, start = begin(jax.random.split(jax.random.key(0), WORLDS))
    return SimpleNamespace(run=run, in_c=in_c, start=start, scale=settings.task.action_scale)


def sway(scale):
    """Sinusoids of 0.5 to 2 Hz that move every joint's target by 0.025 rad, starting from zero."""
    rng, time = np.random.default_rng(0), np.arange(STEPS)[:, None, None] * 0.02
    pace = 2 * np.pi * rng.uniform(0.5, 2, (WORLDS, 12))
    phase = rng.uniform(0, 2 * np.pi, (WORLDS, 12))
    wave = np.sin(pace * time + phase) - np.sin(phase) * np.exp(-time / 0.1)
    return (0.025 / scale * wave).astype(np.float32)


@pytest.mark.slow
def test_swaying_on_its_feet_mjx_follows_c_mujoco_for_100_steps(world, loaded):
    """No restart in between, C MuJoCo's solver run to convergence, and no foot leaves the ground:
    a foot that lands one substep sooner or later would hide smaller differences. Measured: 9e-7
    and 2e-5 (Go1, Go2), 1.5e-4 and 4e-3 (ANYmals, whose feet slip while they creep apart)."""
    robots = world.in_c(iterations=100, ls_iterations=100)
    for one in robots:  # they stand before they sway
        one.put(loaded.home_qpos, 0, 0)
        for _ in range(50):
            one.step(np.zeros(12))
    fields, feet = ("qpos", "qvel", "qacc_warmstart"), len(loaded.feet)
    standing = {f: np.array([getattr(r.data, f) for r in robots], np.float32) for f in fields}
    actions, start = sway(world.scale), world.start.replace(clock=world.start.clock * 0)
    start = start.replace(**{f: jnp.asarray(x) for f, x in standing.items()})
    _, _, after, outcome = world.run(start, actions, seed=1)
    assert not outcome.metrics["falls"].any()
    errors, contacts = np.zeros((STEPS, WORLDS, 2)), np.zeros((STEPS, WORLDS))
    for i, one in enumerate(robots):
        one.put(*(x[i] for x in standing.values()))
        for t in range(STEPS):
            one.step(actions[t, i])
            errors[t, i] = one.errors(*(x[t, i] for x in after))
            contacts[t, i] = one.data.ncon
    assert (contacts == feet).all()
    assert (np.ptp(after[0][..., 7:], axis=0).max(axis=-1) > 0.05).all()  # rad
    worst = errors.max(axis=(0, 1))
    assert worst[0] < 5e-4 and worst[1] < 1e-2, worst


@pytest.mark.slow
def test_under_random_actions_every_step_of_mjx_is_that_of_c_mujoco(world):
    """100 steps of an untrained policy's actions, with landings, slips and falls; each from MJX's
    state, both solvers stopped where the config says. Measured: median 1e-7 and 4e-6, nine tenths
    below 4e-7 and 3e-5; the rest are feet that land one substep sooner or later."""
    actions = np.random.default_rng(3).normal(size=(STEPS, WORLDS, 12)).astype(np.float32)
    _, before, after, _ = world.run(world.start, actions, seed=0)
    errors = np.zeros((STEPS, WORLDS, 2))
    for i, one in enumerate(world.in_c()):
        for t in range(STEPS):
            one.put(*(x[t, i] for x in before))
            one.step(actions[t, i])
            errors[t, i] = one.errors(*(x[t, i] for x in after))
    median, most = np.quantile(errors, [0.5, 0.9], axis=(0, 1))
    assert median[0] < 1e-6 and median[1] < 2e-5, median
    assert most[0] < 5e-6 and most[1] < 2e-4, most


@pytest.mark.slow
def test_1000_steps_of_random_actions_stay_finite_and_within_what_physics_can_compute(world):
    """As an untrained policy acts, with the task's resets and pushes."""
    rng, state, ended = np.random.default_rng(4), world.start, np.zeros(WORLDS)
    for seed in range(10):
        actions = rng.normal(size=(STEPS, WORLDS, 12)).astype(np.float32)
        state, before, after, outcome = world.run(state, actions, seed)
        for leaf in jax.tree.leaves((state, before, after, outcome)):
            assert np.isfinite(leaf).all(), seed
        assert not outcome.metrics["blowups"].any(), seed
        ended += ((outcome.discount == 0) | (outcome.truncation == 1)).sum(axis=0)
    assert ended.all()  # each robot went through a reset

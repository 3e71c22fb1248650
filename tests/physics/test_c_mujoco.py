"""C MuJoCo in compiled programs: against a plain loop in C MuJoCo and against MJX; its bits.

Its solver starts from the last change of velocity, not from the last acceleration. With joint damping
(ANYmal) these differ, so engines are compared with the solver run to convergence.
"""

import os
from functools import partial
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import contacts, motors
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators, c_mujoco, randomize
from dynappo.physics import engine as engine_lib
from dynappo.tasks.velocity import env as env_lib

ROBOTS, STEPS = 8, 10
QUADRUPEDS = "anymal_c", "anymal_d", "go1", "go2"
ENOUGH, FEW = dict(iterations=20, ls_iterations=20), dict(iterations=4, ls_iterations=8)
HARDWARE = ("strength", "armature", "delay")
VARIED = frozenset(("base_mass", "base_com", "friction", *HARDWARE))
CLOCKS = ("air_steps", "contact_steps", "last_air_steps", "peak", "last_peak")
CARRIED = ("qpos", "qvel", "qacc_warmstart", *CLOCKS)
TOLD = (*CARRIED, "torque", "qd_before", "lowest")
LIMITS = ("effort_limit", "saturation_effort", "velocity_limit")
NUMBERS = len((*c_mujoco.BODY_NUMBERS, *c_mujoco.MOTOR_NUMBERS))  # of a call; the friction's last
# kp, kd and these limits (N m, N m, rad/s)
MOTORS = dict(go1=(25.0, 0.5, 23.7, 23.7, 30.0), anymal=(85.0, 0.6, 80.0, 120.0, 7.5))


def place(name, touching="feet", rubs=False, each=False, **physics):
    """Robots with bodies of their own that come down on the floor, every other one turned any way, and
    random actions; where it `rubs`, with friction in their joints; with `each`, every joint with a motor of
    its own. `run(impl)` makes a control step of all: `(start, action) -> Substeps`."""
    config = config_lib.load(f"configs/{name}.py")
    config.physics.update({"contacts": touching} | ENOUGH | physics)
    if each:
        own = 1 + 0.1 * np.arange(12)
        for field in (*LIMITS, "kp", "kd", "action_scale"):
            config.task[field] = tuple((config.task[field] * own).tolist())
        config.task.update(armature=tuple(0.01 * own[::-1]), joint_friction=tuple(0.05 * own))
    config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(name))
    hyper, rng = config_lib.split(config)[1], np.random.default_rng(0)
    com = robot.mj_model.body_ipos[robot.base_body] + rng.uniform(-0.05, 0.05, (ROBOTS, 3))
    scale, friction, kp, kd = rng.uniform([0.8, 0.4, 0.8, 0.5], [1.4, 1.2, 1.2, 1.5], (ROBOTS, 4)).T
    low, high, more = [0.8, 0.7, 0.0], [1.2, 1.5, 0.04], np.random.default_rng(1)
    drawn = more.uniform(low, high, (ROBOTS, 3)).T.astype(np.float32)
    drawn = zip(HARDWARE, drawn, strict=True)
    bodies = randomize.Body(*map(np.float32, (scale, com, friction, kp, kd)), **dict(drawn))
    if rubs:
        bodies = bodies.replace(joint_friction=np.linspace(0, 0.6, ROBOTS, dtype=np.float32))
    varied = VARIED | ({"joint_friction"} if rubs else set())
    qpos, qvel = np.tile(robot.home_qpos, (ROBOTS, 1)), rng.normal(-0.3, 0.5, (ROBOTS, 18))
    qpos[:, 7:] += rng.normal(0, 0.1, (ROBOTS, 12))
    qpos[::2, 3:7] = rng.normal(size=(ROBOTS // 2, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    data = mujoco.MjData(robot.mj_model)
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(robot.mj_model, data)
        feet = data.geom_xpos[robot.feet, 2] - robot.mj_model.geom_size[robot.feet, 0]
        row[2] -= min(feet.min(), lowest(robot, data).min()) + rng.uniform(-0.01, 0.02)
    clocks = rng.integers(0, 9, (3, ROBOTS, 4), np.int32)
    clocks[1] *= clocks[0] == 0  # a foot is in the air or on the ground
    peaks = more.uniform(0, 0.1, (2, ROBOTS, 4)).astype(np.float32)
    start = [x.astype(np.float32) for x in (qpos, qvel, qvel * 0)]

    def run(impl):
        more = dict(every_substep=touching == "full", has_friction=each)
        engine = engine_lib.make(robot, config.physics, varied, impl, **more)

        simulate = partial(engine_lib.simulate, engine, hyper)
        step = jax.jit(jax.vmap(lambda body, s, a: simulate(body, SimpleNamespace(**s), a)))

        def one(start, action, last=None, older=None):
            """`last` and `older` are the actions before; None: zero."""
            before = [np.zeros_like(action) if a is None else a for a in (last, older)]
            both = dict(zip(("last_action", "older_action"), before, strict=True))
            return jax.device_get(step(bodies, start | both, action))

        return one

    start = dict(zip(CARRIED, (*start, *clocks, *peaks), strict=True))
    actions = rng.normal(0, 2, (STEPS, ROBOTS, 12)).astype(np.float32)
    world = dict(robot=robot, config=config, bodies=bodies, start=start, actions=actions)
    return SimpleNamespace(**world, run=run)


def lowest(robot, data):
    """[G] m, the lowest point of each part."""
    fixed, linear, ring = contacts.floor_distance(robot.mj_model, robot.parts)
    row = data.geom_xmat[robot.parts][:, 6:]
    drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(np.maximum(1 - row[:, 2] ** 2, 0))
    return data.geom_xpos[robot.parts, 2] - drop


def by_hand(world, i):
    """Robot `i` after each control step, by C MuJoCo a physics step at a time, in double precision."""
    robot, task, body = world.robot, world.config.task, jax.tree.map(lambda x: x[i], world.bodies)
    model = robot_lib.physics_model(robot, world.config.physics)
    model.body_mass[robot.base_body] *= body.mass_scale
    model.body_inertia[robot.base_body] *= body.mass_scale
    model.body_ipos[robot.base_body] = body.base_com
    model.geom_friction[robot.feet, 0] = body.friction
    nominal = model.dof_armature[6:] if task.armature is None else np.array(task.armature)
    model.dof_armature[6:] = nominal * body.armature
    kp, kd = np.float32(task.kp) * body.kp_scale, np.float32(task.kd) * body.kd_scale
    limits = {name: np.float32(task[name]) for name in LIMITS}
    data = mujoco.MjData(model)
    qpos, qvel, _, *clocks = (value[i] for value in world.start.values())
    data.qpos[:], data.qvel[:], (air, contact, last, peak, last_peak) = qpos, qvel, clocks
    steps = world.config.physics.substeps
    told = [np.zeros(12)] * 2 + [
        *world.actions[:, i]
    ]  # two that nobody gave, then one a control step
    late = round(float(body.delay) / model.opt.timestep)  # physics steps
    for t in range(len(world.actions)):
        depths = []
        for k in range(steps):
            given = (
                t * steps + k - late
            ) // steps  # the last control step whose action has arrived
            action = told[2 + max(given, t - 2)]
            target = np.float32(robot.default_pose) + np.float32(task.action_scale) * action
            before = data.qvel[6:].copy()
            torque = actuators.pd(target.astype(float), data.qpos[7:], before, kp, kd)
            data.ctrl[:] = body.strength * actuators.clip_dc_motor(torque, before, **limits)
            rubbing = np.float32(task.joint_friction)
            if body.joint_friction is not None:
                rubbing = rubbing + body.joint_friction
            # beside the motor, whose torque is what is reported
            data.qfrc_applied[6:] = -rubbing * np.tanh(before / 0.2)
            mujoco.mj_step(model, data)  # leaves the geoms where it began
            depths.append(lowest(robot, data))
            height = data.geom_xpos[robot.feet, 2] - robot.mj_model.geom_size[robot.feet, 0]
            down = height < 0
            last_peak = np.where(down & (air > 0), peak, last_peak)
            peak = np.where(down, 0, np.maximum(peak, height))
            last = np.where(down & (air > 0), air + 1, last)
            air, contact = np.where(down, 0, air + 1), np.where(down, contact + 1, 0)
        seen = np.min(depths, 0) if world.config.physics.contacts == "full" else depths[-1]
        found = (
            data.qpos,
            data.qvel,
            data.qacc_warmstart,
            air,
            contact,
            last,
            peak,
            last_peak,
            data.ctrl,
            before,
            seen,
        )
        yield dict(zip(TOLD, map(np.copy, found), strict=True))


CASES = {
    "feet": ENOUGH,
    "feet, rubs": ENOUGH | {"rubs": True},
    "feet, each joint": ENOUGH | {"rubs": True, "each": True},
    "feet, each joint, alike": ENOUGH | {"each": True},
    "full": ENOUGH,
    "full, one substep": {"substeps": 1},
    "full, few": FEW,
}
DAMPED = ("anymal_c", "anymal_d")
PAIRS = [(r, c) for r in QUADRUPEDS for c in CASES if CASES[c] != FEW or r not in DAMPED]
PAIRS = [(r, c) for r, c in PAIRS if "each" not in c or r in ("go1", "anymal_c")]


@pytest.mark.parametrize(("robot", "case"), PAIRS)
def test_ten_steps_are_those_of_a_plain_loop_in_c_mujoco(robot, case):
    """Measured after one and ten steps: 6e-8 and 3e-7 m or rad, 9e-7 and 7e-6 rad/s, 4e-6 and 8e-5 N m.
    Without joint damping the solver's start is the acceleration, and few iterations do as well."""
    world = place(robot, case[:4], **CASES[case])
    hands = [list(by_hand(world, i)) for i in range(ROBOTS)]
    run, start, touched = world.run("c"), world.start, np.zeros(2)
    told = [np.zeros_like(world.actions[0])] * 2 + [*world.actions]
    for t, action in enumerate(world.actions):
        after, more = run(start, action, told[t + 1], told[t]), 10 if t else 1
        close = dict(qpos=3e-7, qvel=3e-6, torque=2e-5, qd_before=3e-6, lowest=5e-7)
        close |= dict.fromkeys(CLOCKS[:3], 0) | dict.fromkeys(CLOCKS[3:], 5e-7)
        close |= {} if robot in DAMPED else {"qacc_warmstart": 1e-2}
        for name, atol in close.items():
            hand = np.array([row[t][name] for row in hands])
            np.testing.assert_allclose(getattr(after, name), hand, 1e-6, atol * more, err_msg=name)
        start = {name: getattr(after, name) for name in CARRIED}
        touched += (after.contact_steps > 0).sum(), (after.lowest < 0).sum()
    assert (touched > 5).all(), touched


OTHERS = [(r, c, "jax") for r in QUADRUPEDS for c in ("feet", "full") if (r, c) != ("go1", "feet")]
SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in OTHERS]


@pytest.mark.parametrize(
    ("robot", "touching", "impl"),
    [
        ("go1", "feet, each", "warp"),
        # of both and a loop over C MuJoCo: tasks/test_env.py, and the plain loop above
        pytest.param("go1", "feet, each", "jax", marks=pytest.mark.slow),
        # of Warp and MJX: test_warp_call.py; of MJX and C: tasks/test_env.py
        pytest.param("go1", "feet", "jax", marks=pytest.mark.slow),
        pytest.param("go1", "feet", "warp", marks=pytest.mark.slow),
        pytest.param("go1", "full, each", "warp", marks=pytest.mark.slow),  # general.py
        *SLOW,
    ],
)
def test_every_step_is_that_of_the_other_engines(robot, touching, impl):
    """With friction in the joints, and the motors' torques without it; by default with a motor of its own at
    each joint. Measured: median 1e-7 and 5e-6,
    nine tenths below 3e-7 and 1e-5. With contacts of all parts some of the rest differ by up to 11 rad/s:
    there MJX differs from a plain loop in C MuJoCo as well."""
    pytest.importorskip("warp" if impl == "warp" else "mujoco")
    world = place(robot, touching[:4], rubs=True, each="each" in touching)
    in_c, elsewhere, start = world.run("c"), world.run(impl), world.start
    bounds = dict(qpos=(1e-6, 5e-6), qvel=(2e-5, 2e-4), torque=(1e-4, 1e-3))
    bounds |= dict(qd_before=(2e-5, 2e-4), lowest=(1e-6, 5e-6)) | dict.fromkeys(CLOCKS, (0, 0))
    bounds |= dict.fromkeys(CLOCKS[3:], (1e-6, 5e-6))
    errors = {name: np.zeros((STEPS, ROBOTS)) for name in bounds}
    told = [np.zeros_like(world.actions[0])] * 2 + [*world.actions]
    for t, action in enumerate(world.actions):
        before = told[t + 1], told[t]
        found, expected = in_c(start, action, *before), elsewhere(start, action, *before)
        for name, error in errors.items():
            error[t] = np.abs(getattr(found, name) - getattr(expected, name)).max(-1)
        start = {name: getattr(found, name) for name in CARRIED}
    for name, bound in bounds.items():
        found = np.quantile(errors[name], [0.5, 0.9])
        assert (found <= bound).all(), (name, found)


@pytest.mark.parametrize("name", MOTORS)
def test_the_motor_is_pd_with_the_limits_of_a_dc_motor(name):
    """At standstill, far beyond the speed without load, and braking."""
    robot, physics = robot_lib.load("go1"), config_lib.load("configs/go1.py").physics
    world = c_mujoco._World(robot, c_mujoco._model(robot, physics), 1, 1, frozenset())
    (model,) = world._models(np.float32([[1, 0, 0, 0, 0.8, 1, *MOTORS[name], 0]]))
    kp, kd, *limits = map(float, np.float32(MOTORS[name]))
    limited_by = partial(actuators.clip_dc_motor, **dict(zip(LIMITS, limits, strict=True)))
    data, rng, limited = mujoco.MjData(model), np.random.default_rng(0), 0
    for scale in (0, *np.repeat([0.1, 0.5, 1, 3, 10], 100)):
        data.ctrl[:], data.qpos[7:] = rng.normal(0, 1, (2, 12)) * scale
        data.qvel[6:] = rng.uniform(-1, 1, 12) * scale * MOTORS[name][4]
        mujoco.mj_forward(model, data)
        free = actuators.pd(data.ctrl, data.qpos[7:], data.qvel[6:], kp, kd)
        expected = limited_by(free, data.qvel[6:])
        np.testing.assert_allclose(data.qfrc_actuator[6:], expected, rtol=0, atol=1e-10)
        limited += (free != expected).sum()
    assert 1000 < limited < 5000  # of 6012


@pytest.fixture(scope="module", params=["smooth", "rubs"])
def go1(request):
    """Go1s: `make(threads, varied)` is a step of one, `step` of all by two threads; `inputs`, `expected`.
    Of those that rub, a control step is a call of `mujoco.rollout` for each physics step."""
    own = VARIED | ({"joint_friction"} if request.param == "rubs" else set())
    world, (kp, kd, *motor) = place("go1", "full", **FEW), MOTORS["go1"]
    b = world.bodies
    numbers = [
        b.mass_scale,
        *b.base_com.T,
        b.friction,
        1,
        kp * b.kp_scale,
        kd * b.kd_scale,
        *motor,
        0,
    ]
    numbers = np.stack(np.broadcast_arrays(*numbers), -1).astype(np.float32)
    target = np.float32(world.robot.default_pose + 0.25 * world.actions[:4]).swapaxes(0, 1)

    def make(threads=2, varied=own):
        physics = SimpleNamespace(**(world.config.physics.to_dict() | {"threads": threads}))
        return c_mujoco.make(world.robot, physics, varied)

    inputs = [*(world.start[name] for name in CARRIED[:3]), target, numbers]
    step = jax.jit(jax.vmap(make()))
    expected = jax.device_get(step(*inputs))
    unused = [] if request.param == "rubs" else [NUMBERS - 1]
    kept = dict(world=world, make=make, step=step, inputs=inputs, expected=expected)
    return SimpleNamespace(**kept, unused=unused)


def rows(values, which):
    return jax.tree.map(lambda x: np.asarray(x)[np.asarray(which)], values)


def same(found, expected):
    """Equal bit by bit; where one is NaN, so is the other."""
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def changed(inputs, argument, robot, column, value):
    out = [x.copy() for x in inputs]
    out[argument][robot, ..., column] = value
    return out


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_bits_depend_on_neither_time_nor_threads_nor_neighbours(go1, threads):
    step = jax.jit(jax.vmap(go1.make(threads)))
    for which in (range(ROBOTS), range(ROBOTS), [6, 0, 3, 7, 1, 5, 2, 4], [5, 2, 3], [4]):
        same(step(*rows(go1.inputs, which)), rows(go1.expected, which))


def test_seeds_of_robots_are_as_each_alone(go1):
    """Also with the bodies of one seed for all, and a robot without any axis."""
    step, seeds = go1.make(), rows(go1.inputs, np.arange(ROBOTS).reshape(2, -1))
    same(jax.jit(jax.vmap(jax.vmap(step)))(*seeds), rows(go1.expected, np.arange(8).reshape(2, -1)))
    shared = jax.jit(jax.vmap(jax.vmap(step), (0, 0, 0, 0, None)))(*seeds[:4], seeds[4][0])
    for i in range(2):
        same(rows(shared, i), go1.step(*rows(seeds[:4], i), seeds[4][0]))
    same(jax.jit(step)(*rows(go1.inputs, 3)), rows(go1.expected, 3))


@pytest.mark.parametrize("column", range(NUMBERS))
def test_a_number_changes_its_robot_only_and_going_back_gives_the_old_bits(go1, column):
    rest = np.arange(ROBOTS) != 2
    inputs = changed(go1.inputs, 3, 2, slice(6), 2.0)  # far off, where the motors' limits matter
    before = jax.device_get(go1.step(*inputs))
    after = go1.step(*changed(inputs, 4, 2, column, 0.9 * inputs[4][2, column] + 0.01))
    same(rows(after, rest), rows(go1.expected, rest))
    assert (np.abs(after.qvel[2] - before.qvel[2]).max() > 1e-6) == (column not in go1.unused)
    same(go1.step(*inputs), before)
    same(go1.step(*go1.inputs), go1.expected)


def test_more_fewer_and_equal_robots_share_no_model_by_mistake(go1):
    """All equal numbers are one model for all, other numbers a model each, in any order of calls."""
    equal = [*go1.inputs[:4], np.tile(go1.inputs[4][3], (ROBOTS, 1))]
    each = jax.device_get(go1.step(*equal))
    for count in (ROBOTS, 3, ROBOTS, 1, 5):
        same(go1.step(*rows(go1.inputs, range(count))), rows(go1.expected, range(count)))
        same(go1.step(*equal), each)
        found = go1.step(*changed(equal, 4, 3, 7, count))  # a model each
        same(rows(found, [0, 1, 2, 4, 5, 6, 7]), rows(each, [0, 1, 2, 4, 5, 6, 7]))


def test_a_number_for_each_joint_is_that_for_all_where_they_are_equal(go1):
    """To the bit, by the same models, in any order of programs; one joint's own moves its robot alone."""
    bodies, motors = np.split(go1.inputs[4], [len(c_mujoco.BODY_NUMBERS)], 1)
    wide = [*go1.inputs[:4], np.concatenate([bodies, motors.repeat(12, 1)], 1)]
    for inputs in (wide, go1.inputs, wide):
        same(go1.step(*inputs), go1.expected)
    kp = len(c_mujoco.BODY_NUMBERS) + 4  # of the fifth joint
    found, rest = go1.step(*changed(wide, 4, 2, kp, 3.0)), np.arange(ROBOTS) != 2
    same(rows(found, rest), rows(go1.expected, rest))
    apart = np.abs(found.torque - go1.expected.torque)[2]
    assert apart[4] > 0.1


def test_a_centre_of_mass_moves_from_where_the_body_begins(go1):
    """MuJoCo notes at compile time that both frames are one, and would not look at the centre again."""
    centre, states = np.array([0.03, -0.02, 0.01]), []
    for at in (np.zeros(3), np.full(3, 1e-6)):
        spec = mujoco.MjSpec.from_string(go1.world.robot.alone)
        base = spec.body("trunk")
        base.ipos, base.iquat, base.fullinertia, base.inertia = (
            at,
            [1, 0, 0, 0],
            [np.nan] * 6,
            [0.02, 0.06, 0.07],
        )
        robot = robot_lib.load_text(spec.to_xml(), "go1", go1.world.robot.xml)
        same_frame = robot.mj_model.body_sameframe[robot.base_body]
        assert (same_frame == mujoco.mjtSameFrame.mjSAMEFRAME_BODY) == (not at.any())
        step = jax.vmap(c_mujoco.make(robot, go1.world.config.physics, VARIED))
        inputs = changed(go1.inputs, 4, slice(None), slice(1, 4), centre)
        states.append(jax.device_get(step(*inputs)).qvel)
    np.testing.assert_allclose(*states, atol=2e-5)


def test_what_is_not_varied_is_the_files(go1):
    fixed = jax.jit(jax.vmap(go1.make(varied=frozenset())))
    before = jax.device_get(fixed(*go1.inputs))
    body, motors = (changed(go1.inputs, 4, 0, c, 0.4) for c in (slice(6), slice(6, 8)))
    same(fixed(*body), before)
    assert (fixed(*motors).qvel[0] != before.qvel[0]).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e30, 2e6])
def test_a_robot_that_blew_up_is_nan_and_no_other_differs(go1, bad, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write MUJOCO_LOG.TXT
    rest = np.arange(ROBOTS) != 3
    for argument, column in ((0, 2), (0, 10), (1, 0), (1, 17), (2, 5), (3, 11)):
        found = go1.step(*changed(go1.inputs, argument, 3, column, bad))
        assert all(np.isnan(x).all() for x in rows(found, 3))
        same(rows(found, rest), rows(go1.expected, rest))
    same(go1.step(*go1.inputs), go1.expected)
    assert not os.listdir()


@pytest.mark.parametrize("go1", ["smooth"], indirect=True)
def test_a_robot_that_blew_up_is_counted_and_starts_anew(go1, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config, keys = go1.world.config, jax.random.split(jax.random.key(0), 3)
    hyper = config_lib.split(config)[1]
    env = env_lib.make(go1.world.robot, config.task, config.physics, impl="c")

    def step(body, state, action, key):
        after, outcome = env.step(hyper, body, state, action, key)
        return env.autoreset(hyper, body, after, outcome, key), outcome

    step, body = jax.jit(jax.vmap(step)), rows(go1.world.bodies, range(3))
    start = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    action = np.zeros((3, 12), np.float32)
    good = step(body, start, action, keys)
    bad = start.replace(qvel=start.qvel.at[1, 8].set(np.nan))
    for state, acted in ((bad, action), (start, changed([action], 0, 1, 4, np.inf)[0])):
        after, outcome = step(body, state, acted, keys)
        assert outcome.metrics["blowups"].tolist() == [0, 1, 0] == (1 - outcome.valid).tolist()
        assert all(np.isfinite(x).all() for x in jax.tree.leaves((after, outcome)))
        same(rows((after, outcome), [0, 2]), rows(good, [0, 2]))
    assert not os.listdir()

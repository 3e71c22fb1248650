"""C MuJoCo in compiled programs: against a plain loop in C MuJoCo and MJX, its bits, threads and end.

Its solver starts from the last change of velocity, not from the last acceleration. With joint damping
(ANYmal) these differ, so engines are compared with the solver run to convergence.
"""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import ROOT
from jax.sharding import PartitionSpec

from dynappo import config as config_lib
from dynappo import sweep
from dynappo.config import files
from dynappo.physics import actuators, c_engine, randomize
from dynappo.physics import contacts as contacts_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import robot as robot_lib
from dynappo.task import env as env_lib

ROBOTS, STEPS = 8, 10
ENOUGH, FEW = dict(iterations=20, ls_iterations=20), dict(iterations=4, ls_iterations=8)
WIDE = dict(
    base_mass=(-1.0, 3.0),
    base_com=(0.05, 0.05, 0.01),
    friction=(0.4, 1.2),
    kp_scale=(0.8, 1.2),
    kd_scale=(0.5, 1.5),
)
CLOCKS = ("air_steps", "contact_steps", "last_air_steps")
CARRIED = ("qpos", "qvel", "qacc_warmstart", *CLOCKS)
# what both are compared in: largest differences after one and after ten control steps
ONE = dict(qpos=5e-7, qvel=3e-6, torque=2e-5, qd_before=3e-6, lowest=5e-7)
TEN = dict(qpos=2e-6, qvel=5e-5, torque=5e-4, qd_before=5e-5, lowest=2e-6)
# kp, kd, effort limit, saturation effort (N m), velocity limit (rad/s)
MOTORS = dict(go1=(25.0, 0.5, 23.7, 23.7, 30.0), anymal=(85.0, 0.6, 80.0, 120.0, 7.5))


def place(name, contacts="feet", **physics):
    """`ROBOTS` robots with bodies of their own coming down on the floor, every other one turned any
    way; `STEPS` random actions. `run(impl)` makes a control step of all: `(start, action) -> Substeps`."""
    config = config_lib.load(f"configs/{name}.py")
    config.physics.update({"contacts": contacts} | ENOUGH | physics)
    config.task.randomize.update(WIDE)
    config = config_lib.validate(config)
    robot, hyper, rng = robot_lib.load(name), config_lib.split(config)[1], np.random.default_rng(0)
    base, varied = robot.mj_model.body(robot.base_body), randomize.varied(config.task.randomize)
    draw = jax.vmap(randomize.draw, (None, None, None, 0))
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    bodies = draw(config.task.randomize, base.mass[0], jnp.asarray(base.ipos, jnp.float32), keys)
    qpos, data = np.tile(robot.home_qpos, (ROBOTS, 1)), mujoco.MjData(robot.mj_model)
    qpos[:, 7:] += rng.normal(0, 0.1, (ROBOTS, 12))
    for i, row in enumerate(qpos):
        row[3:7] = rng.normal(size=4) if i % 2 else row[3:7]
        row[3:7] /= np.linalg.norm(row[3:7])
        data.qpos[:] = row
        mujoco.mj_kinematics(robot.mj_model, data)
        feet = data.geom_xpos[robot.feet, 2] - robot.foot_radius
        row[2] -= min(feet.min(), lowest(robot, data).min()) + rng.uniform(-0.01, 0.02)
    clocks = rng.integers(0, 9, (3, ROBOTS, 4), np.int32)
    clocks[1] *= clocks[0] == 0  # a foot is in the air or on the ground
    qvel = rng.normal(0, 0.5, (ROBOTS, 18))
    qvel[:, 2] -= 1
    moving = [x.astype(np.float32) for x in (qpos, qvel, qvel * 0)]

    def run(impl):
        engine = engine_lib.make(robot, config.physics, varied, impl, contacts == "full")

        def one(body, start, action):
            state: Any = SimpleNamespace(**start)
            return engine_lib.simulate(engine, hyper, body, state, action)

        step = jax.jit(jax.vmap(one))
        return lambda start, action: jax.device_get(step(bodies, start, action))

    return SimpleNamespace(
        robot=robot,
        config=config,
        varied=varied,
        bodies=jax.device_get(bodies),
        start=dict(zip(CARRIED, (*moving, *clocks), strict=True)),
        actions=rng.normal(0, 2, (STEPS, ROBOTS, 12)).astype(np.float32),
        run=run,
    )


def lowest(robot, data):
    """[G] m, the lowest point of each part."""
    fixed, linear, ring = contacts_lib.floor_distance(robot.mj_model, robot.parts)
    row = data.geom_xmat[robot.parts][:, 6:]
    drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(np.maximum(1 - row[:, 2] ** 2, 0))
    return data.geom_xpos[robot.parts, 2] - drop


def by_hand(world, i):
    """Robot `i` after each of its control steps, by C MuJoCo a physics step at a time, in double precision."""
    robot, task, body = world.robot, world.config.task, jax.tree.map(lambda x: x[i], world.bodies)
    model = robot_lib.physics_model(robot, world.config.physics)
    model.body_mass[robot.base_body] *= body.mass_scale
    model.body_inertia[robot.base_body] *= body.mass_scale
    model.body_ipos[robot.base_body] = body.base_com
    model.geom_friction[robot.feet, 0] = body.friction
    kp, kd = np.float32(task.kp) * body.kp_scale, np.float32(task.kd) * body.kd_scale
    limits = ("effort_limit", "saturation_effort", "velocity_limit")
    limits = {name: np.float32(task[name]) for name in limits}
    data, start = mujoco.MjData(model), {name: x[i] for name, x in world.start.items()}
    data.qpos[:], data.qvel[:] = start["qpos"], start["qvel"]
    air, contact, last = (start[name].copy() for name in CLOCKS)
    for action in world.actions[:, i]:
        target = np.float32(robot.default_pose) + np.float32(task.action_scale) * action
        depths = []
        for _ in range(world.config.physics.substeps):
            before = data.qvel[6:].copy()
            torque = actuators.pd(target.astype(float), data.qpos[7:], before, kp, kd)
            data.ctrl[:] = actuators.clip_dc_motor(torque, before, **limits)
            mujoco.mj_step(model, data)  # leaves the geoms where it began
            depths.append(lowest(robot, data))
            for f, foot in enumerate(robot.feet):
                if data.geom_xpos[foot, 2] < robot.foot_radius[f]:
                    last[f] = air[f] + 1 if air[f] else last[f]
                    air[f], contact[f] = 0, contact[f] + 1
                else:
                    air[f], contact[f] = air[f] + 1, 0
        seen = np.min(depths, 0) if world.config.physics.contacts == "full" else depths[-1]
        found = (
            data.qpos,
            data.qvel,
            data.ctrl,
            before,
            seen,
            data.qacc_warmstart,
            air,
            contact,
            last,
        )
        names = (*ONE, "qacc_warmstart", *CLOCKS)
        yield {name: x.copy() for name, x in zip(names, found, strict=True)}


CASES = {"feet": ENOUGH, "full": ENOUGH, "full, one substep": {"substeps": 1}, "full, few": FEW}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("robot", files.robots())
def test_ten_steps_are_those_of_a_plain_loop_in_c_mujoco(robot, case):
    """Measured: 6e-8 m and rad, 1e-6 rad/s, 5e-6 N m after one step; 2e-7, 8e-6, 8e-5 after ten. Without
    joint damping the solver's start is the acceleration, so that few iterations do as well."""
    damped = robot.startswith("anymal")
    if case == "full, few" and damped:
        pytest.skip("joint damping: another start of the solver")
    world = place(robot, case[:4], **CASES[case])
    expected = [list(by_hand(world, i)) for i in range(ROBOTS)]
    run, start, contact, most = world.run("c"), world.start, np.zeros(2), 0
    for t, action in enumerate(world.actions):
        after = run(start, action)
        hand = {name: np.array([row[t][name] for row in expected]) for name in expected[0][t]}
        for name, atol in (TEN if t else ONE).items():
            np.testing.assert_allclose(getattr(after, name), hand[name], 0, atol, err_msg=name)
        for name in CLOCKS:
            np.testing.assert_array_equal(getattr(after, name), hand[name], err_msg=name)
        if not damped:
            warm = dict(rtol=1e-4, atol=1e-2, err_msg="qacc_warmstart")
            np.testing.assert_allclose(after.qacc_warmstart, hand["qacc_warmstart"], **warm)
        start = {name: getattr(after, name) for name in CARRIED}
        contact += (after.contact_steps > 0).sum(), (after.lowest < 0).sum()
        most = max(most, np.abs(after.torque).max() / world.config.task.effort_limit)
    assert most > 0.99 and (contact > 20).all(), (most, contact)


OTHERS = [(r, c) for r in files.robots() for c in ("feet", "full") if (r, c) != ("go1", "feet")]
SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in OTHERS]


@pytest.mark.parametrize(("robot", "contacts"), [("go1", "feet"), *SLOW])
def test_every_step_is_that_of_mjx(robot, contacts):
    """Measured: median 1e-7 and 4e-6, nine tenths below 3e-7 and 8e-6; with contacts of all parts one
    step in ten is another, by 2 rad/s at most: MJX finds other contacts of boxes and cylinders."""
    world = place(robot, contacts)
    in_c, in_mjx, start = world.run("c"), world.run("jax"), world.start
    names = (*ONE, *CLOCKS)
    errors = {name: np.zeros((STEPS, ROBOTS)) for name in names}
    for t, action in enumerate(world.actions):
        found, expected = in_c(start, action), in_mjx(start, action)
        for name in names:
            error = np.abs(getattr(found, name) - getattr(expected, name))
            errors[name][t] = error.max(-1)
        start = {name: getattr(found, name) for name in CARRIED}
    most = 0.9 if contacts == "feet" else 0.8
    bounds = dict(qpos=(1e-6, 5e-6), qvel=(2e-5, 2e-4), torque=(1e-4, 1e-3))
    bounds |= dict(qd_before=(2e-5, 2e-4), lowest=(1e-6, 5e-6))
    for name, bound in bounds.items():
        assert (np.quantile(errors[name], [0.5, most]) < bound).all(), (name, errors[name])
    for name in CLOCKS:
        assert (errors[name] > 0).mean() <= 0.05, name


@pytest.mark.parametrize("name", MOTORS)
def test_the_motor_is_pd_with_the_limits_of_a_dc_motor(name):
    """Also at standstill, far beyond the speed without load, and braking."""
    robot, config = robot_lib.load("go1"), config_lib.load("configs/go1.py")
    model = c_engine._model(robot, config.physics)
    world = c_engine._World(robot, model, 1, 1, frozenset())
    kp, kd, effort, stall, speed = map(float, np.float32(MOTORS[name]))
    (model,) = world._models(np.float32([[1, 0, 0, 0, 0.8, *MOTORS[name]]]))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    limits = dict(effort_limit=effort, saturation_effort=stall, velocity_limit=speed)
    bound = 0
    for scale in (0, *np.repeat([0.1, 0.5, 1, 3, 10], 100)):
        target, data.qpos[7:] = rng.normal(0, 1, (2, 12)) * scale
        data.qvel[6:] = rng.uniform(-1, 1, 12) * scale * speed
        data.ctrl[:] = target
        mujoco.mj_forward(model, data)
        free = actuators.pd(target, data.qpos[7:], data.qvel[6:], kp, kd)
        expected = actuators.clip_dc_motor(free, data.qvel[6:], **limits)
        np.testing.assert_allclose(data.actuator_force, expected, rtol=0, atol=1e-10)
        np.testing.assert_array_equal(data.qfrc_actuator[6:], data.actuator_force)
        bound += (free != expected).sum()
    assert 1000 < bound < 5000


# --- the same bits ---


@pytest.fixture(scope="module")
def go1():
    """`make(threads, varied)`: a control step of Go1s; `inputs` of `ROBOTS` of them with bodies of their own."""
    world = place("go1", "full", **FEW)
    task, body = world.config.task, world.bodies
    motor = task.effort_limit, task.saturation_effort, task.velocity_limit
    numbers = [body.mass_scale, *body.base_com.T, body.friction]
    numbers += [task.kp * body.kp_scale, task.kd * body.kd_scale, *motor]
    numbers = np.stack(np.broadcast_arrays(*numbers), -1).astype(np.float32)
    target = np.float32(world.robot.default_pose + 0.25 * world.actions[0])

    def make(threads=2, varied=world.varied):
        physics = SimpleNamespace(**(world.config.physics.to_dict() | {"threads": threads}))
        return c_engine.make(world.robot, physics, varied)

    inputs = [*(world.start[name] for name in CARRIED[:3]), target, numbers]
    return SimpleNamespace(make=make, step=jax.jit(jax.vmap(make())), inputs=inputs, world=world)


@pytest.fixture(scope="module")
def expected(go1):
    return jax.device_get(go1.step(*go1.inputs))


def rows(values, which):
    return jax.tree.map(lambda x: np.asarray(x)[which], values)


def same(found, expected):
    """Equal bit by bit; where one is NaN, so is the other."""
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def changed(inputs, argument, robot, column, value):
    """`inputs` with one number of one robot replaced."""
    out = [x.copy() for x in inputs]
    out[argument][robot, column] = value
    return out


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_bits_depend_on_neither_time_nor_threads_nor_neighbours(go1, expected, threads):
    step = jax.jit(jax.vmap(go1.make(threads)))
    mixed = np.random.default_rng(1).permutation(ROBOTS)
    for which in (slice(None), slice(None), mixed, [5, 2, 3], slice(4, 5)):
        same(step(*rows(go1.inputs, which)), rows(expected, which))


def test_seeds_of_robots_are_as_each_alone(go1, expected):
    """Also with the bodies of one seed for all, and a robot without any axis."""
    step, seeds = go1.make(), rows(go1.inputs, np.arange(ROBOTS).reshape(2, -1))
    same(jax.jit(jax.vmap(jax.vmap(step)))(*seeds), rows(expected, np.arange(8).reshape(2, -1)))
    shared = jax.jit(jax.vmap(jax.vmap(step), (0, 0, 0, 0, None)))(*seeds[:4], seeds[4][0])
    for i in range(2):
        same(rows(shared, i), go1.step(*rows(seeds[:4], i), seeds[4][0]))
    same(jax.jit(step)(*rows(go1.inputs, 3)), rows(expected, 3))


@pytest.mark.skipif(jax.device_count() < 2, reason="one device")
def test_every_device_of_a_mesh_steps_its_own_robots(go1, expected):
    mesh, spec = sweep.mesh(1, 2), PartitionSpec("env")
    step = jax.vmap(go1.make())
    step = jax.shard_map(step, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    same(jax.jit(step)(*go1.inputs), expected)


@pytest.mark.parametrize("column", range(len(c_engine.NUMBERS)), ids=lambda i: f"number {i}")
def test_a_number_changes_its_robot_only_and_going_back_gives_the_old_bits(go1, expected, column):
    """So that no number is ignored, and what is kept of the last call is right."""
    one, rest = 2, np.arange(ROBOTS) != 2
    inputs = changed(go1.inputs, 3, one, slice(6), 2.0)  # far off, where the motors' limits matter
    before = jax.device_get(go1.step(*inputs))
    after = go1.step(*changed(inputs, 4, one, column, 0.9 * inputs[4][one, column] + 0.01))
    same(rows(after, rest), rows(expected, rest))
    assert np.abs(after.qvel[one] - before.qvel[one]).max() > 1e-6
    same(go1.step(*inputs), before)
    same(go1.step(*go1.inputs), expected)


def test_more_and_fewer_robots_and_equal_ones_share_no_model_by_mistake(go1, expected):
    """All equal numbers are one model for all, other numbers a model each, in any order of calls."""
    equal = [*go1.inputs[:4], np.tile(go1.inputs[4][3], (ROBOTS, 1))]
    each = [jax.device_get(go1.step(*rows(equal, [i, i - 1]))) for i in range(ROBOTS)]
    each = jax.tree.map(lambda *x: np.stack([y[0] for y in x]), *each)
    for count in (ROBOTS, 3, ROBOTS, 1, 5):
        same(go1.step(*rows(go1.inputs, slice(count))), rows(expected, slice(count)))
        same(go1.step(*equal), each)
        nearly = changed(equal, 4, count - 1, slice(None), go1.inputs[4][count - 1])
        found = go1.step(*nearly)  # a model each
        same(
            rows(found, np.arange(ROBOTS) != count - 1), rows(each, np.arange(ROBOTS) != count - 1)
        )
        same(rows(found, count - 1), rows(expected, count - 1))


def test_what_is_not_varied_is_the_files(go1):
    """As in `randomize.merge`; the motors' numbers always count."""
    fixed = jax.jit(jax.vmap(go1.make(varied=frozenset())))
    before = jax.device_get(fixed(*go1.inputs))
    body, motors = (changed(go1.inputs, 4, 0, c, 0.4) for c in (slice(5), slice(5, 7)))
    same(fixed(*body), before)
    assert (fixed(*motors).qvel[0] != before.qvel[0]).any()


# --- numbers that MuJoCo cannot compute with, memory, several programs at once ---


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e30, 2e6])
def test_a_robot_that_blew_up_is_nan_and_no_other_differs(
    go1, expected, bad, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write MUJOCO_LOG.TXT
    one, rest = 3, np.arange(ROBOTS) != 3
    for argument, column in ((0, 2), (0, 10), (1, 0), (1, 17), (2, 5), (3, 11)):
        found = go1.step(*changed(go1.inputs, argument, one, column, bad))
        assert all(np.isnan(x).all() for x in rows(found, one))
        same(rows(found, rest), rows(expected, rest))
    same(go1.step(*go1.inputs), expected)
    assert not os.listdir()


def test_a_robot_that_blew_up_is_counted_and_starts_anew(go1, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config, robots = go1.world.config, 3
    env = env_lib.make(go1.world.robot, config.task, config.physics, impl="c")
    hyper, keys = config_lib.split(config)[1], jax.random.split(jax.random.key(0), robots)
    body = jax.vmap(env.randomize, (None, 0))(hyper, keys)
    start = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)

    @jax.jit
    @jax.vmap
    def step(body, state, action, key):
        after, outcome = env.step(hyper, body, state, action, key)
        return env.autoreset(hyper, body, after, outcome, key), outcome

    action = np.zeros((robots, 12), np.float32)
    bad_state = start.replace(qvel=start.qvel.at[1, 8].set(jnp.nan))
    bad_action = changed([action], 0, 1, 4, np.inf)[0]
    good = step(body, start, action, keys)
    for state, acted in ((bad_state, action), (start, bad_action)):
        after, outcome = step(body, state, acted, keys)
        assert outcome.metrics["blowups"].tolist() == [0, 1, 0] == (1 - outcome.valid).tolist()
        assert all(np.isfinite(x).all() for x in jax.tree.leaves((after, outcome)))
        same(rows((after, outcome), [0, 2]), rows(good, [0, 2]))
    assert not os.listdir()


STATM = pathlib.Path("/proc/self/statm")


@pytest.mark.skipif(not STATM.exists(), reason="Linux only")
def test_calls_leave_no_memory_behind(go1):
    other = changed(go1.inputs, 4, slice(None), 6, 0.3)

    def resident():
        return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

    for calls in (200, 500):
        before = resident()
        for _ in range(calls):
            jax.block_until_ready([go1.step(*go1.inputs), go1.step(*other)])
    assert resident() - before < 2


def test_two_programs_at_once_compute_what_each_does_alone(go1):
    """Two engines, and two programs of one engine, from two Python threads; none waits for ever."""

    def loop(step, length):
        def some(qpos, qvel, warm, target, numbers):
            def once(state, _):
                return tuple(step(*state, target, numbers)[:3]), None

            return jax.lax.scan(once, (qpos, qvel, warm), length=length)[0]

        return jax.jit(some).lower(*go1.inputs).compile()

    steps = [jax.vmap(go1.make(*how)) for how in ((2,), (2, frozenset()), (1,))]
    programs = [loop(step, n) for step, n in zip([*steps, steps[0]], (40, 40, 40, 60), strict=True)]
    alone = [jax.device_get(program(*go1.inputs)) for program in programs]
    found: dict[int, list] = {}

    def work(i):
        found[i] = [jax.device_get(programs[i](*go1.inputs)) for _ in range(10)]

    threads = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(len(programs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert len(found) == len(programs)
    for i, several in found.items():
        for one in several:
            same(one, alone[i])

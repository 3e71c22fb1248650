"""Physics on a height map against C MuJoCo with a height field of the same triangles, solved to the end.

Where they differ: C MuJoCo gives a sphere a contact with every triangle (a prism) that it reaches, our
kernels one, with the nearest. Feet on one triangle each are the same in both. For a foot over an edge the
tests take from C MuJoCo all contacts but its deepest, and then the answers are the same again, on slopes,
edges and corners (to 2e-4 of the largest acceleration, 3e-5 in most). With all contacts such a robot has
other accelerations (`test_all_contacts...` says by how much); sliding and walking robots go where C
MuJoCo's do, within what these tests allow. docs/terrain.md has what a second contact would change: little.

A capsule in C MuJoCo has a contact with every triangle too, anywhere along it; our kernel's touches with
its two ends. So the reference has two spheres in its place.

Left out: feet whose centre is in the ground. C MuJoCo pushes some of them out sideways, through a
neighbouring prism.
"""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators, c_mujoco, randomize
from dynappo.physics import engine as engine_lib
from dynappo.physics import ground as ground_lib
from dynappo.policy import policy_file
from dynappo.tasks.velocity import observe
from dynappo.terrain.height_map import HeightMap

pytest.importorskip("warp")

import other_robots  # noqa: E402
import warp as wp  # noqa: E402
from kernel_case import (  # noqa: E402
    MOTOR,
    ROBOTS,
    Case,
    a_physics_step,
    deepest_alone,
    drive,
    load,
    several_steps,
)

from dynappo.physics.warp import arrays, general, quadruped, scope, tree  # noqa: E402

CELL, COUNT = 0.1, 121  # m, points


def grid(shape, cell=CELL):
    """The height map of `shape(x, y)`, around the origin."""
    x = cell * (np.arange(COUNT) - (COUNT - 1) / 2)
    heights = shape(*np.meshgrid(x, x, indexing="ij")).astype(np.float32)
    return HeightMap(heights, cell, (float(x[0]), float(x[0])))


def random(high):
    return grid(lambda x, y: np.random.default_rng(0).uniform(0, high, x.shape))


GROUND = {
    "flat": grid(lambda x, y: 0 * x),
    "slope": grid(lambda x, y: -0.5 * x + 0.2 * y),
    "stairs": grid(lambda x, y: 0.1 * np.floor(x / 0.3)),
    "rough": random(0.06),
    "fine": grid(lambda x, y: 0.03 * np.sin(20 * x) * np.sin(17 * y), 0.02),  # feet over many cells
}
HILL = grid(lambda x, y: 0.2 * x)
EASIER = [name for name in GROUND if name not in ("rough", "stairs", "fine")]
KERNEL = {"quadruped": quadruped, "tree": tree}


@pytest.fixture(scope="module")
def rough():
    return Case("go1", ground=GROUND["rough"])


# --- one physics step ---


@pytest.mark.parametrize(
    ("name", "way", "ground"),
    [
        *(("go1", "quadruped", name) for name in ("rough", "stairs", "fine")),
        ("go2", "tree", "stairs"),
        ("go1", "tree", "fine"),
        *(pytest.param("go1", "quadruped", name, marks=pytest.mark.slow) for name in EASIER),
        pytest.param("anymal_c", "quadruped", "rough", marks=pytest.mark.slow),
        pytest.param("go1", "tree", "rough", marks=pytest.mark.slow),
    ],
)
def test_a_physics_step_is_that_of_c_mujoco_with_the_deepest_contact_of_a_foot(name, way, ground):
    """Feet on slopes, edges, corners; their timers, and the heights of the parts."""
    case = Case(name, ground=GROUND[ground], way=KERNEL[way])
    assert not scope.declines(case.model, case.robot.feet)
    touching, _, feet = a_physics_step(case, deepest_alone)
    assert touching > 40
    assert (feet > 1).sum() > 5


class OnEnds(Case):
    """G1, whose feet are capsules, and the same with two spheres in the place of each."""

    def __init__(self, ground):
        super().__init__("g1", ground=ground, way=tree, calm=0.02)
        robot, model = self.robot, self.model
        spec = robot_lib.physics_spec(robot.xml, robot.text)
        ground_lib.put(spec, ground)
        for foot, shape in zip(robot.feet, [spec.geoms[i] for i in robot.feet], strict=True):
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[foot])
            names = "contype", "conaffinity", "condim", "priority", "friction", "solref", "solimp"
            same = {name: getattr(shape, name) for name in names}
            radius, half = model.geom_size[foot, :2]
            for way in (half, -half):
                place = model.geom_pos[foot] + way * turn[2::3]
                shape.parent.add_geom(size=[radius, 0, 0], pos=place, mass=0, **same)
            shape.conaffinity = 0
        physics_group = SimpleNamespace(
            timestep=model.opt.timestep, iterations=200, ls_iterations=200, contacts="feet"
        )
        parts = np.array([], int)
        self.ends = robot_lib.with_settings(spec.compile(), physics_group, parts)
        first = self.ends.body_geomadr
        self.own = np.concatenate(
            [first[b] + np.arange(n) for b, n in enumerate(model.body_geomnum) if n]
        )
        self.ends.geom_conaffinity[self.own] = model.geom_conaffinity * 0
        self.ends.geom_contype[self.own] = model.geom_contype

    def of_robot(self, i):
        whole, data = super().of_robot(i)
        model = self.ends
        for name in set(self.fields) - {"geom_friction"}:
            getattr(model, name)[:] = getattr(whole, name)
        model.geom_friction[:] = whole.geom_friction[self.robot.feet[0]]  # all of one
        model.opt.tolerance, model.body_sameframe[:], model.dof_simplenum[:] = 0, 0, 0
        found = mujoco.MjData(model)
        found.qpos[:], found.qvel[:] = data.qpos, data.qvel
        return model, found


@pytest.mark.parametrize("ground", ["slope", "rough"])
def test_a_capsule_touches_with_its_ends(ground):
    case = OnEnds(GROUND[ground])
    assert scope.kernel(case.model, case.robot.feet, False) == "tree"
    found, touching = case.step(case.before), 0
    own = mujoco.MjData(case.model)
    for i in range(ROBOTS):
        model, data = case.of_robot(i)
        drive(data, found["torque"][i])
        deepest_alone(model, data)
        touching += data.ncon
        qacc = data.qacc_warmstart
        np.testing.assert_allclose(found["qacc_warmstart"][i], qacc, atol=1e-4 * abs(qacc).max())
        own.qpos[:] = case.before["qpos"][i]
        mujoco.mj_kinematics(case.model, own)
        feet, parts = case.above(own)
        height = np.array([feet[case.robot.foot_of == f].min() for f in (0, 1)])
        np.testing.assert_array_equal(found["contact_steps"][i], height < 0)
        np.testing.assert_allclose(found["lowest"][i], parts, atol=1e-6)
    assert touching > 40


def test_all_contacts_of_c_mujoco_change_robots_with_a_foot_over_an_edge(rough):
    """Half of the robots have none and are equal; of nine tenths the acceleration is off by less than a
    fifth of the largest."""
    found, apart, several = rough.step(rough.before), [], []
    for i in range(ROBOTS):
        model, data = rough.of_robot(i)
        drive(data, found["torque"][i])
        mujoco.mj_step(model, data)
        off = abs(found["qacc_warmstart"][i] - data.qacc_warmstart).max()
        apart.append(off / abs(data.qacc_warmstart).max())
        several.append(np.bincount(data.contact.geom[:, 1], minlength=2).max() > 1)
    apart, several = np.array(apart), np.array(several)
    assert several.sum() > 10 and apart[~several].max() < 3e-5
    assert np.median(apart) < 1e-5 and np.quantile(apart, 0.9) < 0.2


@pytest.mark.parametrize("way", KERNEL)
def test_several_physics_steps_are_one_after_the_other(way):
    """On rough ground; and the parts' lowest points of the last step, or of all."""
    given = dict(ground=GROUND["rough"], way=KERNEL[way])
    every = way == "tree"
    several_steps(Case("go1", **given), Case("go1", substeps=3, every=every, **given))


def test_a_robot_that_blew_up_leaves_the_others_alone(rough):
    before = {name: value.copy() for name, value in rough.before.items()}
    before["qpos"][::3, 0], before["qpos"][1::3, 2] = np.nan, np.inf
    found, expected = rough.step(before), rough.step(rough.before)
    assert np.isnan(found["qpos"][::3]).any(1).all()
    for name in ("qpos", "qvel", "torque", "lowest"):
        np.testing.assert_array_equal(found[name][2::3], expected[name][2::3])


def test_feet_that_are_boxes_are_left_to_mujoco_warp():
    """An edge of the ground could pass between their corners."""
    physics = load_physics("g1")
    for feet, reason in ((other_robots.BOX, "boxes"), (other_robots.CAPSULES, "")):
        robot = other_robots.biped(feet)
        assert not scope.declines(robot_lib.physics_model(robot, physics), robot.feet)
        found = scope.declines(ground_lib.model(robot, physics, GROUND["rough"]), robot.feet)
        assert (reason in found) if reason else not found


def load_physics(name):
    return config_lib.validate(config_lib.load(f"configs/{name}.py")).physics


# --- in motion ---


STIFF = (100.0, 2.0, 80.0, 100.0, 60.0, 0.9, 0.3, 1.0)  # as MOTOR, for twice the robot's weight


def motions(**limits):
    """Grounds, contacts of a foot in C MuJoCo, limits; by default a test is on stairs, with the deepest."""
    steps = {"deepest": deepest_alone, "all": mujoco.mj_step}
    return [
        pytest.param(
            ground, steps[name], *limits[name], id=f"{ground}-{name}",
            marks=[] if (ground, name) == ("stairs", "deepest") else pytest.mark.slow,
        )
        for ground in ("stairs", "slope", "rough") for name in steps
    ]  # fmt: skip


def held(case, calls, mj_step):
    """Robots whose motors hold the home pose, after `calls` control steps: how far their bases went in C
    MuJoCo [ROBOTS, 3], and how far the kernel's are from there (m)."""
    before, home = case.before, case.robot.home_qpos
    before["qpos"][:, 3:], before["target"][:] = home[3:], home[7:]
    on_the_ground(case, before["qpos"])
    after = before
    for _ in range(calls):
        after = case.step(after)
    kp, kd, effort, stall, speed, strength, *_ = case.motors
    limits = dict(effort_limit=effort, saturation_effort=stall, velocity_limit=speed)
    moved, off = [], []
    for i in range(ROBOTS):
        model, data = case.of_robot(i)
        model.opt.iterations, model.opt.tolerance = 30, 1e-8
        for _ in range(calls * case.shape.substeps):
            qd = data.qvel[6:].copy()
            torque = actuators.pd(home[7:], data.qpos[7:], qd, kp, kd)
            drive(data, strength * actuators.clip_dc_motor(torque, qd, **limits), case.motors)
            mj_step(model, data)
        moved.append(data.qpos[:3] - before["qpos"][i, :3])
        off.append(after["qpos"][i, :3] - data.qpos[:3])
    return np.array(moved), np.array(off)


@pytest.mark.parametrize(
    ("ground", "mj_step", "mean", "most"),
    motions(deepest=(0.0003, 0.001), all=(0.008, 0.03)),
)
def test_feet_that_are_pressed_hold_as_those_of_c_mujoco(ground, mj_step, mean, most):
    """Robots with 12 kg more than they have begin level, one foot on the ground: half a second later they
    have tilted onto all feet, on a slope of 0.2, over edges and steps; with little friction some slip.

    With the deepest contact of a foot alone nine of ten bases are within 1 mm (measured: 0.5). With all the
    mean base is off by less than 8 mm (4), nine of ten by less than 30 (19)."""
    field = HILL if ground == "slope" else GROUND[ground]
    case = Case("go1", substeps=20, ground=field, motors=STIFF)
    base, body = case.robot.base_body, case.fields
    more = 1 + 12.0 / body["body_mass"][:, base]
    body["body_mass"][:, base] *= more
    body["body_inertia"][:, base] *= more[:, None]
    for name in ("body_mass", "body_inertia"):
        case.before[name][:] = body[name]
    case.before["qvel"][:] = 0
    moved, off = held(case, 5, mj_step)
    assert moved[:, 2].mean() < -0.03
    assert np.abs(off.mean(0)).max() < mean
    assert np.quantile(np.abs(off).max(1), 0.9) < most


@pytest.mark.parametrize(
    ("ground", "mj_step", "mean", "most"),
    motions(deepest=(0.0003, 0.001), all=(0.008, 0.015)),
)
def test_feet_that_slide_go_where_those_of_c_mujoco_go(ground, mj_step, mean, most):
    """A third of a second from 1 m/s, on slopes, over edges and steps, a way of a third of a metre. With the
    deepest contact of a foot alone nine of ten bases are within 1 mm (measured: 0.7). With all the mean base
    is off by less than 8 mm (1 on the slope, 5 on stairs), nine of ten by less than 15 (11).

    Of all robots, for one alone says nothing: with starts that differ by 1 um some end 14 mm apart."""
    case = Case("go1", substeps=20, ground=GROUND[ground])
    case.before["qvel"][:], case.before["qvel"][:, 0] = 0, 1.0
    moved, off = held(case, 3, mj_step)
    assert np.abs(moved).max() > 0.2 and np.abs(off.mean(0)).max() < mean
    assert np.quantile(np.abs(off).max(1), 0.9) < most


def on_the_ground(case, qpos):
    """Lower or lift robots until the lowest foot of each touches."""
    data = mujoco.MjData(case.model)
    for pose in qpos:
        for _ in range(4):
            data.qpos[:] = pose
            mujoco.mj_kinematics(case.model, data)
            pose[2] -= case.above(data)[0].min()


class Kernel:
    """Robots in our kernel; a control step at a time."""

    def __init__(self, case, policy, qpos):
        sizes, count = case.sizes(), len(qpos)
        p, motor = policy, np.zeros((policy.default_pose.size, 8), np.float32)
        motor[:] = np.stack(
            np.broadcast_arrays(
                p.kp, p.kd, p.effort_limit, p.saturation_effort, p.velocity_limit, 1.0, 0.0, 1.0
            ),
            -1,
        )
        start = {name: np.zeros((count, *size)) for name, size in sizes.items()}
        start |= {name: getattr(case.model, name)[None] for name in arrays.MODEL}
        start |= dict(qpos=qpos, motor=np.broadcast_to(motor, (count, *motor.shape)))
        self.case, self.buffers = case, case.way.allocate(case.model, case.shape, count)
        self.a = {}
        for name, x in start.items():
            kind = wp.vec3 if name in arrays.MODEL and len(sizes[name]) == 2 else float
            kind = int if name in arrays.COUNTS else kind
            self.a[name] = wp.array(np.ascontiguousarray(x, float), dtype=kind)

    def step(self, target):
        shape = self.case.shape
        every = np.broadcast_to(target[:, None], (len(target), shape.substeps, target.shape[1]))
        self.a["target"] = wp.array(np.ascontiguousarray(every), dtype=float)
        self.case.way.control_step(self.buffers, shape, self.a)
        return (self.a[name].numpy().astype(float) for name in ("qpos", "qvel"))


class InC:
    """The same in C MuJoCo, on one height field."""

    def __init__(self, case, policy, qpos):
        self.case, self.policy = case, policy
        self.datas = [mujoco.MjData(case.model) for _ in qpos]
        for data, pose in zip(self.datas, qpos, strict=True):
            data.qpos[:] = pose

    def step(self, target):
        p, model = self.policy, self.case.model
        limits = dict(effort_limit=p.effort_limit, saturation_effort=p.saturation_effort)
        limits |= dict(velocity_limit=p.velocity_limit)
        for data, wanted in zip(self.datas, target, strict=True):
            for _ in range(self.case.shape.substeps):
                qd = data.qvel[6:]
                torque = actuators.pd(wanted, data.qpos[7:], qd, p.kp, p.kd)
                data.ctrl[:] = actuators.clip_dc_motor(torque, qd, **limits)
                mujoco.mj_step(model, data)
        return (np.array([getattr(d, name) for d in self.datas]) for name in ("qpos", "qvel"))


def walk(world, case, policy, qpos, seconds, command):
    """Mean velocity [2] (m/s) of the robots in the world, and how many fell."""
    act = policy_file.actor(policy.params, policy.activation)
    see = [observe.memory(policy.observation, policy.history) for _ in qpos]
    robots, com = world(case, policy, qpos), case.model.body_ipos[case.robot.base_body]
    pose, velocity = qpos.copy(), np.zeros((len(qpos), case.model.nv))
    action, fell = np.zeros((len(qpos), case.model.nu)), np.zeros(len(qpos), bool)
    for _ in range(round(seconds / (policy.timestep * policy.substeps))):
        for i, (q, v) in enumerate(zip(pose, velocity, strict=True)):
            obs = observe.observe(q, v, com, policy.default_pose, command, action[i])
            action[i] = act(see[i](obs))
        target = actuators.target(action, policy.default_pose, policy.action_scale)
        pose, velocity = robots.step(target)
        fell |= 1 - 2 * (pose[:, 4] ** 2 + pose[:, 5] ** 2) < 0.6
    return (pose - qpos)[:, :2].mean(0) / seconds, fell.sum()


WALKS = [("go1", "low rough")]
SLOW = [
    pytest.param(*one, marks=pytest.mark.slow)
    for one in (("go1", "slope"), ("go2", "low rough"), ("go2", "slope"))
]


@pytest.mark.parametrize(("name", "ground"), [*WALKS, *SLOW])
def test_a_policy_of_the_flat_floor_walks_as_in_c_mujoco(name, ground):
    """Ten seconds at 0.5 m/s, up a slope of 0.2 and on random ground of 2 cm: none falls, and the mean speed
    is within 0.02 m/s (measured: 0.006)."""
    policy = policy_file.load(load(name).xml.with_name("policy.npz"))
    ground = HILL if ground == "slope" else random(0.02)
    case, robots = Case(name, substeps=policy.substeps, ground=ground), 3
    qpos = np.tile(case.robot.home_qpos, (robots, 1))
    rng = np.random.default_rng(1)
    qpos[:, :2] = rng.uniform(-0.5, 0.5, (robots, 2)) - [2.5, 0]
    qpos[:, 7:] += rng.uniform(-0.02, 0.02, (robots, case.model.nu))
    on_the_ground(case, qpos)
    speeds = []
    for world in (Kernel, InC):
        speed, fell = walk(world, case, policy, qpos, 10.0, np.array([0.5, 0, 0]))
        assert fell == 0 and speed[0] > 0.2
        speeds.append(speed)
    np.testing.assert_allclose(*speeds, atol=0.02)


# --- engines ---


def simulated(impl, ground, states, every=False):
    """Robots [ROBOTS] after a control step on the engine `impl`."""
    config = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
    hyper, robot = config_lib.split(config)[1], load("go1")
    engine = engine_lib.make(robot, config.physics, frozenset(), impl, every, ground=ground)
    body = randomize.Body(1.0, jnp.zeros(3), 0.8, 1.0, 1.0)

    def step(qpos, qvel):
        count = jnp.zeros(len(robot.foot_names), jnp.int32)
        counts = dict.fromkeys(("air_steps", "contact_steps", "last_air_steps"), count)
        peaks = dict.fromkeys(("peak", "last_peak"), count.astype(float))
        state = SimpleNamespace(
            qpos=qpos, qvel=qvel, qacc_warmstart=qvel * 0, torque=jnp.zeros(12), **counts, **peaks
        )
        return engine_lib.simulate(engine, hyper, body, state, jnp.zeros(12))

    with jax.default_device(jax.devices("cpu" if impl == "c" else None)[0]):
        return jax.device_get(jax.jit(jax.vmap(step))(*states))


@pytest.fixture(scope="module")
def states(rough):
    return np.float32(rough.before["qpos"][:16]), np.float32(0.3 * rough.before["qvel"][:16])


@pytest.mark.parametrize("impl", ["warp", pytest.param("jax", id="mjx", marks=pytest.mark.slow)])
def test_engines_agree(states, impl):
    """Four physics steps on rough ground: a foot that is over an edge has one contact in our kernel, and
    of several MJX keeps four; most robots have none, and all have the same feet down at first."""
    expected, found = (simulated(of, GROUND["rough"], states) for of in ("c", impl))
    for name, atol in dict(qpos=5e-4, lowest=1e-3, peak=1e-3, qvel=0.02).items():
        off = np.abs(getattr(found, name) - getattr(expected, name)).max(1)
        assert np.median(off) < atol, name
    feet = found.contact_steps == expected.contact_steps
    assert feet.mean() > 0.9 and (expected.contact_steps > 0).mean() > 0.1


def test_the_map_is_where_it_says_and_engines_measure_from_it(states):
    """The same robots, on the map that is lifted with them."""
    up, map_ = np.float32([0.3, -0.7, 1.5]), GROUND["rough"]
    corner = (map_.corner[0] + 0.3, map_.corner[1] - 0.7)
    moved = HeightMap(map_.heights + up[2], map_.cell, corner)
    qpos, qvel = states
    there = qpos.copy()
    there[:, :3] += up
    for impl in ("c", "warp"):
        here = simulated(impl, map_, states, every=True)
        found = simulated(impl, moved, (there, qvel), every=True)
        np.testing.assert_allclose(found.lowest, here.lowest, atol=1e-5)
        np.testing.assert_allclose(found.peak, here.peak, atol=1e-5)
        np.testing.assert_array_equal(found.contact_steps, here.contact_steps)


def test_robots_take_turns_where_a_model_is_large(states):
    """Each has a model of its own, with the whole map; C MuJoCo then keeps some of them at a time."""
    robot, group = load("go1"), load_physics("go1")
    model = c_mujoco._model(robot, group, GROUND["rough"])
    count, steps = len(states[0]), 2
    numbers = np.tile([1, 0, 0, 0, 0.8, 1, *MOTOR[:5], 0], (count, 1)).astype(np.float32)
    numbers[:, 4] = np.linspace(0.2, 1.5, count)  # friction
    target = np.tile(robot.default_pose, (count, steps, 1)).astype(np.float32)
    args = [*states, states[1] * 0, target, numbers]
    shapes = (model.nq,), (model.nv,), (model.nv,), (model.nu,), (model.nu,)
    feet, parts = len(robot.feet), len(robot.parts)
    shapes += (steps, feet, 3), (steps, parts, 3), (steps, feet + parts, 4)
    found = []
    for most in (100, 3):
        world = c_mujoco._World(robot, model, steps, 1, {"friction"})
        world.most = most
        found.append([np.zeros((count, *shape), np.float32) for shape in shapes])
        world.step(args, found[-1])
        assert len(world.models) <= most
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_mujoco_warps_own_step_is_that_of_c_mujoco(rough):
    """With up to four contacts of a foot; heights and timers are those of our kernels."""
    found, kernel = rough.step(rough.before, general), rough.step(rough.before)
    off = []
    for i in range(ROBOTS):
        model, data = rough.of_robot(i)
        drive(data, found["torque"][i])
        mujoco.mj_step(model, data)
        off.append(abs(found["qacc_warmstart"][i] - data.qacc_warmstart).max())
        off[-1] /= abs(data.qacc_warmstart).max()
    assert np.median(off) < 1e-5 and np.quantile(off, 0.75) < 1e-3
    for name in ("lowest", "peak"):  # each is within 1e-6 of C MuJoCo
        np.testing.assert_allclose(found[name], kernel[name], atol=2e-6)
    np.testing.assert_array_equal(found["contact_steps"], kernel["contact_steps"])

"""Terms, falls and ends of episodes of bipeds, on a G1: against plain loops and C MuJoCo's velocities."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import robot_files

from dynappo import config as config_lib
from dynappo.config import per_joint
from dynappo.description import kinematics, motors
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import reward_sum, rewards

ROBOTS, DT, MOST, PAID = 24, 0.02, 0.7, -2.5
TERMS = "upright posture foot_slip feet_distance feet_phase".split()
KNOWN = {*TERMS} - {"foot_slip"}
LENGTHS = dict(gait_foot_height=0.12, clearance_height=0.07, feet_apart=0.23)  # m
STD = {".*_knee_joint": 0.4, "waist_.*": 0.1, ".*": 0.2}


def settings(robot, **task):
    """A config of all terms, each of weight 1, without noise."""
    config = config_lib.load("configs/g1.py:laptop")
    config.physics.threads = 1
    config.task.update(posture_std=STD, posture_std_standing=0.1, max_tilt=MOST, fall_reward=PAID)
    config.task.update(tracking_std=0.5, gait_frequency=(1.0, 2.0), **LENGTHS, **task)
    for group, value in ((config.task.weights, 1.0), (config.task.noise, 0.0)):
        group.update(dict.fromkeys(group, value))
    return motors.fitted(config_lib.validate(config), robot)


@pytest.fixture(scope="module")
def g1():
    return robot_lib.load("g1")


@pytest.fixture(scope="module")
def world(g1):
    """One step of robots about their default pose, some in the air and some told to stand; the next state."""
    config, robot = settings(g1)
    hyper = config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys, rng = jax.random.split(jax.random.key(0), ROBOTS), np.random.default_rng(0)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    qpos, qvel = np.array(state.qpos, float), rng.normal(size=state.qvel.shape) * 0.7
    qpos[:, 7:] += rng.normal(size=(ROBOTS, 29)) * 0.15
    data, air = mujoco.MjData(robot.mj_model), rng.integers(1, 200, (ROBOTS, 2))
    for i in range(ROBOTS):
        turn = rng.normal(size=3) * [0.2, 0.2, 2.0]
        mujoco.mju_euler2Quat(qpos[i, 3:7], turn, "xyz")
        qpos[i, 2] = 2.0
        data.qpos[:] = qpos[i]
        mujoco.mj_kinematics(robot.mj_model, data)
        heights = data.geom_xpos[robot.feet, 2]
        qpos[i, 2] -= heights.min() + (0.004 if i >= 4 else -0.3)
        air[i, robot.foot_of[heights.argmin()]] *= i < 4  # the lower foot is on the ground, of most
    command = np.where(rng.random((ROBOTS, 1)) < 0.3, 0.0, rng.uniform(-1, 1, (ROBOTS, 3)))
    numbers = dict(qpos=qpos, qvel=qvel, command=command)
    before = state.replace(
        **{name: jnp.asarray(x, jnp.float32) for name, x in numbers.items()},
        air_steps=jnp.asarray(air, jnp.int32),
        contact_steps=jnp.asarray((air == 0) * rng.integers(1, 200, (ROBOTS, 2)), jnp.int32),
        clock=state.clock * 0,
    )
    action = jnp.asarray(rng.normal(size=(ROBOTS, 29)) * 0.3, jnp.float32)
    step = jax.jit(jax.vmap(env.step, (None, 0, 0, 0, 0)))
    after, outcome = jax.device_get(step(hyper, body, before, action, keys))
    return SimpleNamespace(
        env=env, robot=robot, config=config, hyper=hyper, body=body, keys=keys, step=step,
        before=before, action=action, after=after, outcome=outcome,
    )  # fmt: skip


def feet_in_mujoco(robot, qpos, qvel):
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    places, velocities, heights = [], [], []
    for foot in range(2):
        shapes = robot.feet[robot.foot_of == foot]
        body, middle, six = (
            model.geom_bodyid[shapes[0]],
            data.geom_xpos[shapes].mean(0),
            np.zeros(6),
        )
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, six, 0)
        velocities.append(six[3:] + np.cross(six[:3], middle - data.xpos[body]))
        heights.append(middle[2])
        base = robot.base_body
        places.append(data.xmat[base].reshape(3, 3).T @ (middle - data.xpos[base]))
    return np.array(places), np.array(velocities), heights


def phases(world, i):
    """rad, of each foot before the step; None where it is to stand."""
    angle, moves = float(world.before.gait.angle[i]), np.linalg.norm(world.before.command[i]) > 0.1
    return (angle, angle + math.pi) if moves else None


def swing(phase, height):
    """m: Playground's gait.get_rz."""
    x = (phase + math.pi) % (2 * math.pi) / (2 * math.pi)
    up, down = (t**3 + 3 * t**2 * (1 - t) for t in (2 * x, 2 * x - 1))
    return height * up if x <= 0.5 else height - height * down


def by_loops(world, i):
    """The terms of robot `i` after the step, a number at a time."""
    robot, after = world.robot, world.after
    qpos, command = after.qpos[i].astype(float), np.asarray(world.before.command[i], float)
    places, velocities, heights = feet_in_mujoco(robot, qpos, after.qvel[i].astype(float))
    down = after.contact_steps[i] > 0
    moves = math.sqrt(sum(c**2 for c in command)) > 0.1
    std = per_joint.numbers("", tuple(STD.items()), robot.joint_names, "g1")
    off = [(qpos[7 + j] - robot.default_pose[j]) / (std[j] if moves else 0.1) for j in range(29)]
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), qpos[3:7])
    swings = [swing(phase, 0.12) for phase in phases(world, i) or ()] or [0.0, 0.0]
    return dict(
        upright=math.exp(-(1 - up[2] ** 2) / 0.45**2),
        posture=math.exp(-sum(x**2 for x in off) / 29),
        foot_slip=sum(math.hypot(*v[:2]) for v, d in zip(velocities, down, strict=True) if d),
        feet_distance=max(0.0, 0.23 - (places[0, 1] - places[1, 1])),
        feet_phase=math.exp(
            -sum(
                (z - min(heights) - (up - min(swings))) ** 2
                for z, up in zip(heights, swings, strict=True)
            )
            / 0.08**2
        ),
    )


def test_every_term_of_a_step_is_that_of_plain_loops_and_of_c_mujocos_velocities(world):
    found, rows = world.outcome.metrics, [by_loops(world, i) for i in range(ROBOTS)]
    for name in TERMS:
        expected = [row[name] for row in rows]
        np.testing.assert_allclose(found[f"reward_{name}"], expected, 2e-4, 2e-5, err_msg=name)
    assert sum(row["foot_slip"] > 0.1 for row in rows) > ROBOTS / 2
    assert sum(0.1 < row["feet_phase"] < 0.9 for row in rows) > ROBOTS / 2
    assert (
        sum(row["feet_distance"] > 0.01 for row in rows)
        > 3
        < sum(row["feet_distance"] == 0 for row in rows)
    )


def test_what_follows_from_joints_and_velocities_is_known_to_the_model(world):
    """The known share of the reward is that of these terms, and not of a fall."""
    terms = reward_sum.terms_of(world.config.task)
    known = reward_sum.known(terms, world.config.task)
    assert known.keys() & set(TERMS) == KNOWN
    of_row = jax.vmap(world.env.known_reward, (None, 0, 0, 0))
    # the state was set by hand: of its observation only the context counts
    phase = [(phases(world, i) or [None])[0] for i in range(ROBOTS)]
    phase = [[0, 0] if x is None else [math.sin(x), math.cos(x)] for x in phase]
    obs = world.before.obs.at[:, world.env.prop_size : world.env.prop_size + 3].set(
        world.before.command
    )
    obs = obs.at[:, -3:-1].set(np.array(phase))
    found = of_row(world.hyper, obs, world.action, jnp.asarray(world.outcome.next_prop))
    expected = DT * sum(world.outcome.metrics[f"reward_{name}"] for name in known)
    np.testing.assert_allclose(found, expected, 1e-4, 1e-5)


def test_crossed_feet_have_a_distance_below_zero():
    def term(left, right, sides=(1, -1)):
        place = np.array([[0.1, left, -0.7], [-0.2, right, -0.7]])
        return rewards.feet_distance(place, np.array(sides), 0.2)

    assert term(0.1, -0.1) == term(0.3, -0.1) == 0 and term(0.05, -0.05) == pytest.approx(0.1)
    assert term(-0.1, 0.1) == pytest.approx(0.4) and term(0.1, -0.1, (-1, 1)) == pytest.approx(0.4)


def test_a_foot_that_is_off_by_the_same_share_of_its_step_earns_the_same_at_any_size():
    """Of 0.15 m as Playground's G1, whose squared heights are over 0.01 m^2."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        place, angle = rng.normal(0, 0.1, (2, 3)), rng.uniform(0, 2 * math.pi)
        targets = [swing(angle, 0.15), swing(angle + math.pi, 0.15)]
        above = place[:, 2] - place[:, 2].min() - (np.array(targets) - min(targets))
        phase = np.array([math.sin(angle), math.cos(angle)])
        for size in (1.0, 0.35, 1.3):
            found = rewards.feet_phase(place[:, 2] * size, phase, 0.15 * size)
            assert found == pytest.approx(math.exp(-(above**2).sum() / 0.01), rel=1e-6)


def test_where_a_foot_is_and_how_fast_on_feet_of_every_kind(tmp_path):
    """A sole of three shapes and a leg that is shorter: middles against MuJoCo's points."""
    sole = '<geom type="box" size="0.1 0.04 0.015" mass="0.5"/>'
    more = sole + '<geom type="capsule" fromto="0.1 -0.04 0 0.1 0.04 0.03" size="0.02" mass="0.1"/>'
    path = tmp_path / "mine.xml"
    path.write_text(robot_files.biped().replace(sole, more))
    robot = robot_lib.load_xml(path)
    model, rng = robot.mj_model, np.random.default_rng(0)
    assert len(robot.feet) == 4
    middles = kinematics.middles(model, robot.feet, robot.foot_of)
    data, joints = mujoco.MjData(model), rng.normal(size=len(robot.joint_names)) * 0.4
    data.qpos[:] = [0, 0, 2, 1, 0, 0, 0, *joints]
    mujoco.mj_kinematics(model, data)
    for foot, found in enumerate(kinematics.feet_in_base(middles, joints)):
        weight = {mujoco.mjtGeom.mjGEOM_BOX: 8, mujoco.mjtGeom.mjGEOM_CAPSULE: 2}
        shapes = robot.feet[robot.foot_of == foot]
        count = [weight[mujoco.mjtGeom(model.geom_type[g])] for g in shapes]
        expected = np.average(data.geom_xpos[shapes], axis=0, weights=count) - [0, 0, 2]
        np.testing.assert_allclose(found, expected, atol=1e-9)


def fallen(world, tilts):
    """Robots in the air at rest, tilted by so many rad about x, y, x, ..."""
    qpos = np.array(world.before.qpos, float)
    qpos[:, 2], qpos[:, 7:] = 3.0, world.robot.default_pose
    for i, tilt in enumerate(np.resize(tilts, ROBOTS)):
        quat = np.zeros(4)
        mujoco.mju_euler2Quat(quat, [tilt * (i % 2 == 0), tilt * (i % 2), 0.0], "xyz")
        qpos[i, 3:7] = quat
    still = world.before.replace(qpos=jnp.asarray(qpos, jnp.float32), qvel=world.before.qvel * 0)
    args = world.hyper, world.body, still, world.action * 0, world.keys
    return jax.device_get(world.step(*args))[1]


def test_a_base_that_is_tilted_too_far_has_fallen_and_pays_once(world):
    out = fallen(world, [MOST - 0.02, -MOST + 0.02, MOST + 0.02, -MOST - 0.02, 3.0, 0.0])
    expected = np.resize([0, 0, 1, 1, 1, 0], ROBOTS)
    np.testing.assert_array_equal(out.metrics["falls"], expected)
    np.testing.assert_array_equal(out.discount, 1 - expected)
    np.testing.assert_allclose(out.metrics["reward_fall"], PAID / DT * expected, 1e-6)
    terms = sum(out.metrics[f"reward_{name}"] for name in reward_sum.terms_of(world.config.task))
    np.testing.assert_allclose(out.reward, terms * DT + PAID * expected, 1e-4, 1e-5)


def test_a_blow_up_pays_what_a_fall_does_and_nothing_else(world):
    qvel = world.before.qvel.at[:, 6].set(jnp.where(jnp.arange(ROBOTS) % 2, jnp.nan, 0.0))
    args = world.hyper, world.body, world.before.replace(qvel=qvel), world.action, world.keys
    out = jax.device_get(world.step(*args))[1]
    blown = out.metrics["blowups"] == 1
    assert blown[1::2].all() and (out.reward[blown] == np.float32(PAID)).all()
    assert np.isfinite(out.reward).all()


def test_what_is_none_is_not_in_the_program(g1):
    config = config_lib.load("configs/go1.py:laptop")
    for name in TERMS:
        assert config.task.weights[name] is None
    config = config_lib.validate(config)
    env = env_lib.make(robot_lib.load("go1"), config.task, config.physics, impl="c")
    assert not {f"reward_{name}" for name in [*TERMS, "fall"]} & set(env.metrics)
    assert env.fall_reward is None


def test_a_posture_without_numbers_is_one_line(g1):
    config = config_lib.load("configs/g1.py")
    config.task.posture_std_standing = None
    config, _ = motors.fitted(config_lib.validate(config), g1)
    with pytest.raises(config_lib.ConfigError, match=r"task.posture_std_standing is None.*posture"):
        reward_sum.terms_of(config.task)


@pytest.mark.parametrize("variant", ["best", "ppo", "deploy", "quick", "laptop", "dyna4"])
def test_every_variant_of_a_g1_is_valid_and_the_same_left_and_right(g1, variant):
    from dynappo.tasks.velocity import partners

    config, robot = motors.fitted(config_lib.validate(config_lib.load(f"g1:{variant}")), g1)
    partners.check_motors(config.task, robot)
    reward_sum.terms_of(config.task)
    config_lib.split(config)
    assert config.run.walks == "tracking" and config.task.fall_reward < 0

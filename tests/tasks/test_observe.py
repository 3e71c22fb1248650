"""The observation against C MuJoCo's own kinematics, its layout, and its symmetries."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo.description import robot
from dynappo.tasks.velocity import observe

ROWS = observe.slices(12)
STATES = 20


@pytest.fixture(scope="module")
def go1():
    return robot.load("go1")


def rotation(yaw):
    """Quaternion (w, x, y, z) of a turn about the world's vertical."""
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def random_states(go1, count=STATES):
    """Any attitude, position and speed, with a random centre of mass of the base."""
    rng = np.random.default_rng(3)
    for _ in range(count):
        quat = rng.normal(size=4)
        yield SimpleNamespace(
            qpos=np.concatenate(
                [rng.normal(size=3), quat / np.linalg.norm(quat), rng.normal(size=12)]
            ),
            qvel=rng.normal(size=18) * 2,
            com=rng.uniform(-0.1, 0.1, 3),
            command=rng.uniform(-1, 1, 3),
            last_action=rng.normal(size=12),
        )


def mujoco_motion(go1, s):
    """Gravity, velocity of the base's centre of mass and angular velocity by C MuJoCo."""
    model = go1.mj_model.__copy__()
    model.body_ipos[go1.base_body] = s.com
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = s.qpos, s.qvel
    mujoco.mj_forward(model, data)
    frame = data.xmat[go1.base_body].reshape(3, 3)
    velocity = np.zeros(6)  # angular, linear, of the inertial frame, in world axes
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, go1.base_body, velocity, 0)
    gravity = model.opt.gravity / np.linalg.norm(model.opt.gravity)
    return frame.T @ gravity, frame.T @ velocity[3:], frame.T @ velocity[:3]


def all_numbers(go1, s, xp=np):
    arrays = (s.qpos, s.qvel, s.com, go1.default_pose, s.command, s.last_action)
    return observe.observe(*(xp.asarray(a) for a in arrays))


@pytest.mark.parametrize("part", ["gravity", "linear", "angular"])
def test_base_motion_is_that_of_mujoco_in_any_attitude(go1, part):
    index = ["gravity", "linear", "angular"].index(part)
    for s in random_states(go1):
        found = observe.base_motion(s.qpos, s.qvel, s.com)[index]
        np.testing.assert_allclose(found, mujoco_motion(go1, s)[index], atol=1e-12)


def test_linear_velocity_is_the_change_of_the_centre_of_mass_over_a_small_time(go1):
    """By finite differences of the position, which know nothing of velocity conventions."""
    model, eps = go1.mj_model.__copy__(), 1e-6
    data = mujoco.MjData(model)
    for s in random_states(go1, 5):
        model.body_ipos[go1.base_body] = s.com
        ends = []
        for step in (-eps, eps):
            data.qpos[:] = s.qpos
            mujoco.mj_integratePos(model, data.qpos, s.qvel, step)
            mujoco.mj_kinematics(model, data)
            ends.append(data.xipos[go1.base_body].copy())
        data.qpos[:] = s.qpos
        mujoco.mj_kinematics(model, data)
        frame = data.xmat[go1.base_body].reshape(3, 3)
        expected = frame.T @ (ends[1] - ends[0]) / (2 * eps)
        found = observe.base_motion(s.qpos, s.qvel, s.com)[1]
        np.testing.assert_allclose(found, expected, atol=1e-7)


def test_an_upright_robot_sees_gravity_straight_down():
    qpos = np.zeros(19)
    qpos[3] = 1.0
    gravity, linear, angular = observe.base_motion(qpos, np.zeros(18), np.zeros(3))
    assert (gravity == [0, 0, -1]).all() and not linear.any() and not angular.any()


def test_the_projected_gravity_is_a_unit_vector(go1):
    for s in random_states(go1):
        assert np.linalg.norm(observe.base_motion(s.qpos, s.qvel, s.com)[0]) == pytest.approx(1)


def test_the_layout_is_joints_gravity_velocities_then_command_and_action(go1):
    for s in random_states(go1, 3):
        obs = all_numbers(go1, s)
        gravity, linear, angular = mujoco_motion(go1, s)
        pose = dict(zip(go1.joint_names, go1.default_pose, strict=True))
        expected = [
            *(s.qpos[7 + i] - pose[name] for i, name in enumerate(go1.joint_names)),
            *s.qvel[6:],
            *gravity,
            *linear,
            *angular,
            *s.command,
            *s.last_action,
        ]
        assert obs.shape == (48,)
        np.testing.assert_allclose(obs, expected, atol=1e-12)


def test_the_slices_name_the_parts_and_cover_every_number_once(go1):
    s = next(random_states(go1))
    obs, (gravity, linear, angular) = all_numbers(go1, s), mujoco_motion(go1, s)
    parts = [
        (ROWS["joint_position"], s.qpos[7:] - go1.default_pose),
        (ROWS["joint_velocity"], s.qvel[6:]),
        (ROWS["gravity"], gravity),
        (ROWS["linear_velocity"], linear),
        (ROWS["angular_velocity"], angular),
        (ROWS["command"], s.command),
        (ROWS["previous_action"], s.last_action),
    ]
    for where, expected in parts:
        np.testing.assert_allclose(obs[where], expected, atol=1e-12)
    covered = [i for where, _ in parts for i in range(*where.indices(48))]
    assert covered == list(range(48))


def test_33_numbers_of_a_robot_of_12_joints_are_predicted_and_15_known():
    assert (observe.prop_size(12), observe.size(12)) == (33, 48)
    assert ROWS["angular_velocity"].stop == 33 == ROWS["command"].start


@pytest.mark.parametrize("joints", [12, 18, 29])
def test_sizes_and_names_follow_from_the_robots_joints(joints):
    """A hexapod, a humanoid: three numbers a joint, and twelve that every robot has."""
    rng = np.random.default_rng(joints)
    qpos, qvel, pose = rng.normal(size=7 + joints), rng.normal(size=6 + joints), np.ones(joints)
    obs = observe.observe(qpos, qvel, np.zeros(3), pose, np.full(3, 7.0), np.full(joints, 8.0))
    assert obs.shape == (12 + 3 * joints,) and observe.size(joints) == len(obs)
    parts = observe.split(obs, joints)
    np.testing.assert_array_equal(parts["joint_velocity"], qvel[6:])
    np.testing.assert_array_equal(parts["previous_action"], np.full(joints, 8.0))
    assert observe.prop_size(joints) == len(obs) - 3 - joints
    full, onboard = (observe.name(kind, joints) for kind in ("full", "onboard"))
    assert (full, onboard) == (f"velocity-{len(obs)}", f"onboard-{len(obs) - 3}")
    np.testing.assert_array_equal(observe.columns(full), np.arange(len(obs)))
    left_out = set(range(len(obs))) - set(observe.columns(onboard).tolist())
    assert left_out == set(range(2 * joints + 3, 2 * joints + 6))  # the linear velocity
    assert observe.reading(onboard)["previous_action"] == slice(len(obs) - 3 - joints, len(obs) - 3)


@pytest.mark.parametrize(
    "name", ["velocity-49", "velocity-12", "onboard-46", "other-48", "velocity"]
)
def test_a_name_that_no_robot_has_is_refused(name):
    with pytest.raises(ValueError, match=name):
        observe.columns(name)


def test_the_context_of_the_next_row_is_this_command_and_this_action(go1):
    rng = np.random.default_rng(0)
    for s in random_states(go1, 3):
        obs, action = all_numbers(go1, s), rng.normal(size=12)
        s.last_action = action
        s.qpos, s.qvel = s.qpos + 1.0, s.qvel + 1.0
        next_obs = all_numbers(go1, s)
        assert (observe.advance(obs[33:], action) == next_obs[33:]).all()


def test_the_context_takes_any_batch_of_rows():
    context, action = np.random.default_rng(0).normal(size=(2, 5, 3, 15))
    action = action[..., :12]
    found = observe.advance(context, action)
    assert found.shape == (5, 3, 15)
    np.testing.assert_array_equal(found[..., :3], context[..., :3])
    np.testing.assert_array_equal(found[..., 3:], action)
    in_jax = observe.advance(jnp.asarray(context), jnp.asarray(action))
    np.testing.assert_allclose(in_jax, found, rtol=1e-6)


def test_the_observation_does_not_change_with_position_and_heading(go1):
    for s in random_states(go1):
        expected = all_numbers(go1, s)
        turn = rotation(2.1)
        s.qpos[:3] += [3.0, -2.0, 0.5]
        quat, linear = np.zeros(4), np.zeros(3)
        mujoco.mju_mulQuat(quat, turn, s.qpos[3:7])
        mujoco.mju_rotVecQuat(linear, s.qvel[:3], turn)
        s.qpos[3:7], s.qvel[:3] = quat, linear
        np.testing.assert_allclose(all_numbers(go1, s), expected, atol=1e-12)


def test_the_observation_does_change_with_roll(go1):
    s = next(random_states(go1))
    expected = all_numbers(go1, s)
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, np.array([np.cos(0.1), np.sin(0.1), 0, 0]), s.qpos[3:7])
    s.qpos[3:7] = quat
    assert np.abs(all_numbers(go1, s) - expected)[ROWS["gravity"]].max() > 0.01


def test_opposite_quaternions_are_the_same_attitude(go1):
    for s in random_states(go1, 5):
        expected = all_numbers(go1, s)
        s.qpos[3:7] *= -1
        np.testing.assert_allclose(all_numbers(go1, s), expected, atol=1e-12)


def test_numpy_and_jax_see_the_same(go1):
    in_jax = jax.jit(lambda s: all_numbers(go1, SimpleNamespace(**s), jnp))
    for s in random_states(go1):
        np.testing.assert_allclose(in_jax(vars(s)), all_numbers(go1, s), atol=5e-6)


@pytest.mark.parametrize("xp", [np, jnp])
def test_the_noise_is_that_of_each_part_and_none_on_command_and_action(xp):
    noise = SimpleNamespace(
        joint_pos=0.01, joint_vel=1.5, gravity=0.05, linear_velocity=0.1, angular_velocity=0.2
    )
    found = observe.noise_scale(noise, xp, 12)
    expected = [0.01] * 12 + [1.5] * 12 + [0.05] * 3 + [0.1] * 3 + [0.2] * 3 + [0.0] * 15
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_rotating_into_the_frame_is_the_transposed_rotation_matrix():
    rng = np.random.default_rng(2)
    for _ in range(10):
        quat, vector, matrix = rng.normal(size=4), rng.normal(size=3), np.zeros(9)
        quat /= np.linalg.norm(quat)
        mujoco.mju_quat2Mat(matrix, quat)
        expected = matrix.reshape(3, 3).T @ vector
        np.testing.assert_allclose(observe.rotate_inverse(quat, vector), expected, atol=1e-12)

"""PD and the DC-motor limit against scalar formulas, and what a motor can and cannot do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo.physics import actuators

# kp, kd, effort limit, saturation effort (N m), velocity limit (rad/s)
MOTORS = dict(
    go1=(25.0, 0.5, 23.7, 23.7, 30.0),
    go2=(25.0, 0.5, 23.5, 23.5, 30.0),
    anymal=(85.0, 0.6, 80.0, 120.0, 7.5),
)


def limits(name):
    _, _, effort, saturation, velocity = MOTORS[name]
    return dict(effort_limit=effort, saturation_effort=saturation, velocity_limit=velocity)


def clip_by_hand(torque, qd, effort, saturation, velocity):
    """Isaac Lab's DC motor for one joint: class DCMotor, since 2025-07."""
    v_max = velocity * (1 + effort / saturation)
    v = min(max(qd, -v_max), v_max)
    upper = min(saturation * (1 - v / velocity), effort)
    lower = max(saturation * (-1 - v / velocity), -effort)
    return min(max(torque, lower), upper)


def random_joints(name, count=500):
    """Torques and speeds far beyond the limits on both sides."""
    rng = np.random.default_rng(7)
    _, _, effort, _, velocity = MOTORS[name]
    torque = rng.uniform(-3, 3, (count, 12)) * effort
    return torque, rng.uniform(-3, 3, (count, 12)) * velocity


def test_the_target_is_the_default_pose_plus_the_scaled_action():
    rng = np.random.default_rng(0)
    action, default = rng.normal(size=12), rng.normal(size=12)
    found = actuators.target(action, default, 0.25)
    assert found == pytest.approx([d + a / 4 for a, d in zip(action, default, strict=True)])
    assert (actuators.target(np.zeros(12), default, 0.5) == default).all()


@pytest.mark.parametrize("name", MOTORS)
def test_pd_torque_is_stiffness_times_error_minus_damping_times_speed(name):
    kp, kd, *_ = MOTORS[name]
    rng = np.random.default_rng(1)
    target, q, qd = rng.normal(size=(3, 12))
    expected = [kp * (target[i] - q[i]) - kd * qd[i] for i in range(12)]
    np.testing.assert_allclose(actuators.pd(target, q, qd, kp, kd), expected, rtol=1e-12)


def test_pd_pulls_towards_the_target_and_against_the_motion():
    zero = np.zeros(12)
    assert (actuators.pd(zero + 1, zero, zero, 25.0, 0.5) == 25.0).all()
    assert (actuators.pd(zero, zero, zero + 1, 25.0, 0.5) == -0.5).all()


@pytest.mark.parametrize("name", MOTORS)
def test_the_clip_is_that_of_the_scalar_formula_everywhere(name):
    torque, qd = random_joints(name)
    found = actuators.clip_dc_motor(torque, qd, **limits(name))
    expected = np.vectorize(clip_by_hand)(torque, qd, *MOTORS[name][2:])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", MOTORS)
def test_numpy_and_jax_give_the_same_torques(name):
    kp, kd, effort, *_ = MOTORS[name]
    torque, qd = (x.astype(np.float32) for x in random_joints(name))
    target = torque / kp

    def both(target, qd):
        return actuators.clip_dc_motor(
            actuators.pd(target, target * 0.1, qd, kp, kd), qd, **limits(name)
        )

    found, expected = jax.jit(both)(jnp.asarray(target), jnp.asarray(qd)), both(target, qd)
    assert expected.dtype == np.float32
    np.testing.assert_allclose(found / effort, expected / effort, atol=1e-6)


@pytest.mark.parametrize("name", MOTORS)
def test_at_standstill_the_effort_limit_holds_alike_in_both_directions(name):
    effort = MOTORS[name][2]
    torque = np.array([-1e3, -effort, -0.5 * effort, 0.0, 0.5 * effort, effort, 1e3])
    found = actuators.clip_dc_motor(torque, torque * 0, **limits(name))
    np.testing.assert_allclose(found, np.clip(torque, -effort, effort))


@pytest.mark.parametrize("name", MOTORS)
def test_mirrored_torque_and_speed_give_mirrored_torque(name):
    torque, qd = random_joints(name)
    found = actuators.clip_dc_motor(torque, qd, **limits(name))
    mirrored = actuators.clip_dc_motor(-torque, -qd, **limits(name))
    np.testing.assert_allclose(mirrored, -found, atol=1e-12)


@pytest.mark.parametrize("name", MOTORS)
def test_beyond_the_velocity_limit_a_motor_can_only_brake(name):
    torque, qd = random_joints(name)
    velocity = MOTORS[name][4]
    fast = np.abs(qd) > velocity
    found = actuators.clip_dc_motor(torque, qd, **limits(name))
    assert fast.sum() > 1000
    assert (found[fast] * np.sign(qd[fast]) < 0).all()
    at_limit = actuators.clip_dc_motor(np.array([1e3]), np.array([velocity]), **limits(name))
    assert at_limit == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", MOTORS)
def test_no_torque_exceeds_the_effort_limit_at_any_speed(name):
    torque, qd = random_joints(name)
    found = actuators.clip_dc_motor(torque, qd * 10, **limits(name))
    assert np.abs(found).max() <= MOTORS[name][2] * (1 + 1e-12)


@pytest.mark.parametrize("name", MOTORS)
def test_a_braking_motor_has_its_full_effort_at_every_speed(name):
    _, _, effort, _, velocity = MOTORS[name]
    speeds = np.linspace(0, 3, 7) * velocity
    brake = actuators.clip_dc_motor(np.full(7, -1e3), speeds, **limits(name))
    np.testing.assert_allclose(brake, -effort)


def test_unitree_motors_weaken_from_standstill_and_anymal_motors_only_from_a_third_of_their_speed():
    full = np.full(4, 1e3)
    speeds = np.array([0.0, 1 / 6, 1 / 3, 2 / 3])
    go1 = actuators.clip_dc_motor(full, speeds * 30.0, **limits("go1"))
    anymal = actuators.clip_dc_motor(full, speeds * 7.5, **limits("anymal"))
    np.testing.assert_allclose(go1, 23.7 * (1 - speeds))
    np.testing.assert_allclose(anymal, [80.0, 80.0, 80.0, 40.0])

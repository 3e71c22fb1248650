"""From a policy's action to joint torques: PD control and the limits of a DC motor.

The code works with NumPy and jax.numpy; units are rad, rad/s and N m. The formula of the limit is
that of Isaac Lab 2.2.1 (isaaclab/actuators/actuator_pd.py, class DCMotor, since 2025-07).
"""

FRICTION_SPEED = 0.2  # rad/s, from which on dry friction has its full size


def target(action, default_pose, scale):
    """Joint position target (rad) of an action `[A]`: default pose plus `scale` x action."""
    return default_pose + scale * action


def pd(q_target, q, qd, kp, kd):
    """Torque of an explicit PD controller with zero target velocity, before any limit."""
    return kp * (q_target - q) - kd * qd


def friction(qd, size):
    """Torque (N m) by which dry friction of `size` (N m) slows a joint: size tanh(qd / 0.2 rad/s).

    Smooth, because a sign would chatter in steps of 5 ms. Every engine applies this to the joint, beside
    the motor: a motor's torque, limits and lag know nothing of it. MuJoCo's own frictionloss, which a file
    may have, is another thing: a constraint.
    """
    return size * qd.__array_namespace__().tanh(qd / FRICTION_SPEED)


def lag(wanted, torque, time_constant, timestep):
    """A motor's torque after `timestep` (s): `wanted`, approached from `torque` with a `time_constant` (s).

    tau' = (wanted - tau) / T,  so  tau + (1 - exp(-dt / T)) (wanted - tau)
    """
    return torque + share(wanted.__array_namespace__(), time_constant, timestep) * (wanted - torque)


def share(xp, time_constant, timestep):
    """How much of the way to the wanted torque `lag` goes in a `timestep`; of NumPy or jax.numpy."""
    return 1 - xp.exp(-timestep / xp.maximum(xp.asarray(time_constant), 1e-6))


def clip_dc_motor(torque, qd, *, effort_limit, saturation_effort, velocity_limit):
    """Torque that a DC motor can give at joint speed `qd`.

    With v = qd clipped to +-vmax (1 + effort / sat):
    upper = min(sat (1 - v / vmax), effort), lower = max(sat (-1 - v / vmax), -effort).
    A motor that turns faster than vmax can only brake.
    """
    xp = qd.__array_namespace__()
    v_max = velocity_limit * (1 + effort_limit / saturation_effort)
    slope = xp.clip(qd, -v_max, v_max) / velocity_limit
    upper = xp.clip(saturation_effort * (1 - slope), None, effort_limit)
    lower = xp.clip(saturation_effort * (-1 - slope), -effort_limit, None)
    return xp.clip(torque, lower, upper)

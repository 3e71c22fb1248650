"""The reward of the velocity task: one function a term, and their weighted sum.

Terms are those of the paper's appendix and of Isaac Lab's flat velocity tasks (isaaclab_tasks
.../velocity/mdp/rewards.py and isaaclab/envs/mdp/rewards.py, 2.2.1). Every term is a function of
one robot's arrays and is at least 0, `feet_air_time` excepted; the weight carries the sign, and
`total` multiplies by the control step. Written once for NumPy and jax.numpy.

`track_*` is the only source of a positive return: an episode of T seconds that tracks perfectly
earns (w_lin + w_yaw) T, 45 on Go1. While the robot can do nothing yet, the penalties outweigh it
and a fall ends them, so early in training episodes get shorter before they get longer.
"""


def track_linear_velocity(linear, command, std):
    """exp(-|v_xy - c_xy|^2 / std^2), base frame, m/s. Isaac Lab: std 0.5; as printed: std 1."""
    return _exp(-((linear[:2] - command[:2]) ** 2).sum() / std**2)


def track_yaw_rate(angular, command, std):
    """exp(-(w_z - c_yaw)^2 / std^2), base frame, rad/s."""
    return _exp(-((angular[2] - command[2]) ** 2) / std**2)


def vertical_velocity(linear):
    """v_z^2 in the base frame, (m/s)^2."""
    return linear[2] ** 2


def roll_pitch_rate(angular):
    """w_x^2 + w_y^2 in the base frame, (rad/s)^2."""
    return (angular[:2] ** 2).sum()


def flat_orientation(gravity):
    """g_x^2 + g_y^2 of the unit gravity direction in the base frame: sin^2 of the tilt."""
    return (gravity[:2] ** 2).sum()


def joint_torques(torque):
    """Sum of squared torques, (N m)^2, as applied in the last physics step after all limits."""
    return (torque**2).sum()


def joint_accelerations(qd, qd_before, timestep):
    """Sum of squared joint accelerations, (rad/s^2)^2, over the last physics step (s)."""
    return (((qd - qd_before) / timestep) ** 2).sum()


def action_rate(action, last_action):
    """Sum of squared changes of the raw action."""
    return ((action - last_action) ** 2).sum()


def feet_air_time(last_air_time, touchdown, command, threshold=0.5):
    """Sum over feet of (last air time - threshold), s, at touch-down; 0 for a slow command.

    Negative for steps shorter than `threshold` (s); "slow" is a planar command of at most 0.1 m/s.
    """
    moving = (command[:2] ** 2).sum() > 0.1**2
    return ((last_air_time - threshold) * touchdown).sum() * moving


def feet_in_air(contact):
    """Number of feet in the air: `feet_air_time` as the paper prints it."""
    return (1.0 - contact).sum()


def undesired_contacts(lowest):
    """Number of non-foot parts at the ground, from their `lowest` points (m above the floor)."""
    return (lowest < 0).sum() * 1.0


def total(terms: dict, weights: dict, dt: float):
    """`(reward, weighted)`: sum of weight x term x dt, and each weight x term (per second).

    Raises ValueError if a term has no weight or a weight no term.
    """
    if set(terms) != set(weights):
        raise ValueError(
            f"reward terms without a weight: {sorted(set(terms) - set(weights))}; "
            f"weights without a term: {sorted(set(weights) - set(terms))} (task.weights)"
        )
    weighted = {name: weights[name] * term for name, term in terms.items()}
    return sum(weighted.values()) * dt, weighted


def _exp(x):
    return x.__array_namespace__().exp(x)
